"""The pursuit from above, and names beside points."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from desim.analysis.drawing.palette import EVADER_MARKS, HUES
from desim.analysis.drawing.plots import COLUMN, styled
from desim.view.pictures.paths import EvaderStyle, Paths, draw_pursuit, label_handovers, label_points
from tests.drawn import described, text_of, without_layout
from tests.golden import golden
from tests.view.by_hand import MS, history, pair


def drawn(result):
    """Return the axes of a pursuit with the labels of takeovers."""
    with styled((COLUMN, COLUMN), font=7) as figure:
        axes = figure.add_subplot()
        draw_pursuit(axes, result)
        figure.draw_without_rendering()
        label_handovers(axes, result)
    return axes


def test_pursuits_by_hand_are_golden():
    """A single chaser is bold; a numbered square is where a pursuer becomes the only chaser.

    Sampled at 0, 0.5 and 1 s, so that pursuer 0 is at 4 m at 0.5 s and half way on the line at 0.25 s. Of two evaders
    each has a number, a mark and a hue, shared by its chasers; it rests where it was captured.
    """
    with without_layout():
        golden("paths.txt", {each.scenario.name: described(drawn(each).figure) for each in (history(), pair())})


@pytest.mark.slow
def test_the_looks_differ_without_colour():
    """In width, dash, or marker."""
    looks = [
        (line.get_linewidth() if line.get_linestyle() != "None" else 0, line.is_dashed(), line.get_marker())
        for line in drawn(history()).lines
        if not line.get_label().startswith("_")
    ]
    assert len(set(looks)) == len(looks) == 6


def test_many_evaders_share_hues_and_marks_in_turn():
    looks = [EvaderStyle.of(evader, 5) for evader in (1, 2, 3, 4, 5)]
    assert [each.alone for each in looks] == [*HUES, *HUES[:2]]
    assert [each.mark for each in looks] == [*EVADER_MARKS, EVADER_MARKS[0]]


def test_paths_are_straight_between_samples_and_end_where_they_are_asked_to():
    found = Paths(history())
    assert found.of(0, 250 * MS, 750 * MS).tolist() == [[2, 0], [4, 0], [4, 0]]
    assert found.of_evader(1, 0, 500 * MS).tolist() == [[5, 5], [5, 5.5]]
    assert found.at(0, np.array([125 * MS, 250 * MS])).tolist() == [[1, 0], [2, 0]]


def test_without_recorded_positions_the_error_explains_how_to_record_them():
    with pytest.raises(ValueError, match=r"record\.trajectory"):
        drawn(history(samples=()))


def boxes(axes):
    axes.figure.draw_without_rendering()
    return [text.get_window_extent() for text in axes.texts]


@pytest.mark.slow
def test_names_of_crowded_places_lie_neither_over_each_other_nor_over_places():
    """Forty places in a column's width. If names did not give way to each other, three pairs would overlap here."""
    rng = np.random.default_rng(4)
    places = [tuple(place) for place in rng.uniform(0.0, 20.0, (40, 2)).tolist()]
    with styled((COLUMN, COLUMN), font=7) as figure:
        axes = figure.add_subplot()
        axes.set(xlim=(-1, 21), ylim=(-1, 21))
        axes.plot(*np.transpose(places), "o", ms=4)
        figure.draw_without_rendering()
        label_points(axes, places, [str(k) for k in range(40)])
    found = boxes(axes)
    assert not [1 for k, one in enumerate(found) for other in found[k + 1 :] if one.overlaps(other)]
    markers = axes.transData.transform(np.array(places))
    assert not [1 for box in found for x, y in markers if box.x0 < x < box.x1 and box.y0 < y < box.y1]


@pytest.mark.slow
def test_a_name_at_the_edge_stays_inside():
    with styled((COLUMN, COLUMN), font=7) as figure:
        axes = figure.add_subplot()
        axes.set(xlim=(0, 1), ylim=(0, 1))
        corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
        figure.draw_without_rendering()
        label_points(axes, corners, ["10", "11", "12", "13"])
    for box in boxes(axes):
        assert axes.bbox.x0 - 1 <= box.x0 < box.x1 <= axes.bbox.x1 + 1
        assert axes.bbox.y0 - 1 <= box.y0 < box.y1 <= axes.bbox.y1 + 1


@pytest.mark.parametrize("dpi", [72, 200])
def test_labels_of_crowded_places_are_golden_at_any_resolution(dpi):
    """Each of eight positions is taken by some label; offsets are in points, and no larger than a label."""
    axes = Figure(figsize=(2.0, 2.0), dpi=dpi).add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, 100.0), ylim=(0.0, 100.0))
    places = [(50 + 4.3 * i + 0.7 * j, 50 + 3.9 * j - 0.4 * i) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    places += [(0.5, 0.5), (99.5, 0.5), (0.5, 99.5), (99.5, 99.5), (20.0, 20.0)]
    texts = label_points(axes, places, [str(k) for k in range(14)], avoid=[(22.0, 22.0), (22.0, 20.0)], color="red")
    golden("labels.txt", "\n".join(map(text_of, texts)) + "\n")


def test_labels_do_not_move_the_axes():
    axes = Figure().add_subplot()
    texts = label_points(axes, [(0.0, 0.0), (1.0, 1.0)], ["1", "2"])
    assert [text.get_text() for text in texts] == ["1", "2"]
    assert not any(text.get_in_layout() for text in texts)


@pytest.mark.slow
def test_a_label_avoids_the_given_places():
    """Alone, it is to the upper right; with something there, elsewhere."""

    def offset(**avoid):
        with styled((COLUMN, COLUMN), font=7) as figure:
            axes = figure.add_subplot()
            axes.set(xlim=(0, 1), ylim=(0, 1))
            figure.draw_without_rendering()
            label_points(axes, [(0.5, 0.5)], ["7"], **avoid)
        return axes.texts[0].xyann

    assert min(offset()) > 0
    assert min(offset(avoid=[(0.53, 0.53)])) <= 0

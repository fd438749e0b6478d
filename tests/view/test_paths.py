"""The pursuit from above, and names beside points."""

import numpy as np
import pytest

from desim.analysis.plots import COLUMN, styled
from desim.view.labels import label_points
from desim.view.paths import Look, Paths, draw_pursuit, label_takeovers
from tests.view.by_hand import MS, history, pair


def drawn(result):
    """Return the axes of a pursuit with the names of those who took over."""
    with styled((COLUMN, COLUMN), font=7) as figure:
        axes = figure.add_subplot()
        draw_pursuit(axes, result)
        figure.draw_without_rendering()
        label_takeovers(axes, result)
    return axes


def paths(axes, label):
    """Return the paths drawn like the one with a label."""
    (one,) = [line for line in axes.lines if line.get_label() == label]
    look = (one.get_color(), one.get_linewidth(), one.get_marker())
    alike = [line for line in axes.lines if (line.get_color(), line.get_linewidth(), line.get_marker()) == look]
    return [line.get_xydata().tolist() for line in alike]


def test_who_chases_alone_is_bold_and_who_chases_with_others_is_thin():
    """Sampled at 0, 0.5 and 1 s, so that pursuer 0 is at 4 m at 0.5 s and half way on the line at 0.25 s."""
    axes = drawn(history())
    assert paths(axes, "active with others") == [[[10, 0], [10, 0]], [[0, 0], [pytest.approx(1.2), 0]]]
    assert paths(axes, "active alone") == [
        [[pytest.approx(1.2), 0], [pytest.approx(3.2), 0]],
        [[0, 10], [0, 10]],
    ]
    width = {line.get_label(): line.get_linewidth() for line in axes.lines}
    assert width["active alone"] >= 2 * width["active with others"]


def test_a_diamond_is_where_somebody_comes_to_be_alone_and_its_number_beside_it():
    axes = drawn(history())
    assert paths(axes, "takes over") == [[[pytest.approx(1.2), 0], [0, 10]]]
    assert [(each.get_text(), each.xy) for each in axes.texts] == [("0", (pytest.approx(1.2), 0.0)), ("2", (0.0, 10.0))]


def test_the_evader_is_dashed_from_a_square_to_the_star_of_its_capture():
    axes = drawn(history())
    assert paths(axes, "evader") == [[[5, 5], [5, 5.5], [5, 6]]]
    assert paths(axes, "capture") == [[[5, 6]]]
    (line,) = [line for line in axes.lines if line.get_label() == "evader"]
    assert line.is_dashed()


def test_the_looks_differ_without_colour():
    """In width, dash, or marker."""
    looks = [
        (line.get_linewidth() if line.get_linestyle() != "None" else 0, line.is_dashed(), line.get_marker())
        for line in drawn(history()).lines
        if not line.get_label().startswith("_")
    ]
    assert len(set(looks)) == len(looks) == 6


def test_of_two_evaders_each_has_a_path_a_mark_and_a_number_and_rests_where_it_was_captured():
    axes = drawn(pair())
    (one,), (other,) = ([line for line in axes.lines if line.get_label() == f"evader {k}"] for k in (1, 2))
    assert one.get_xydata()[[0, -1]].tolist() == [[5, 5], [5, pytest.approx(5.4)]]
    assert other.get_xydata()[[0, -1]].tolist() == [[8, 2], [9, 2]]
    assert one.get_marker() != other.get_marker()
    assert one.get_markerfacecolor() != other.get_markerfacecolor()
    assert one.is_dashed()
    assert paths(axes, "capture") == [[[5, pytest.approx(5.4)], [9, 2]]]
    numbers = [(each.get_text(), each.xy) for each in axes.texts if each.get_weight() == "bold"]
    assert numbers == [("1", (5.0, 5.0)), ("2", (8.0, 2.0))]


def test_who_chases_one_of_two_evaders_has_its_hue():
    """Pursuer 0 is at 0.6 m after 150 ms, at 1.6 m after 400 ms, at 2.8 m after 700 ms and at 4 m in the end."""
    axes = drawn(pair())
    hues = [Look.of(evader, 2).alone for evader in (1, 2)]
    found = [
        [line.get_xdata()[[0, -1]].round(9).tolist() for line in axes.lines if is_stint(line, hue, wide)]
        for hue in hues
        for wide in (True, False)
    ]
    assert found == [
        [[0.6, 1.6]],
        [[10, 10], [0, 0.6]],
        [[0, 0], [10, 10], [2.8, 4.0]],
        [[0, 0], [10, 10], [10, 10], [1.6, 2.8]],
    ]
    names = [(each.get_text(), each.get_color()) for each in axes.texts if each.get_weight() == "normal"]
    assert names == [("2", hues[1]), ("0", hues[0]), ("1", hues[1]), ("0", hues[1])]


def is_stint(line, hue, wide):
    """Return whether a line is the path of a pursuer in a hue, and as wide as that of who is alone, or not."""
    return line.get_color() == hue and line.get_marker() == "None" and (line.get_linewidth() > 2) == wide


def test_paths_are_straight_between_samples_and_end_where_they_are_asked_to():
    found = Paths(history())
    assert found.of(0, 250 * MS, 750 * MS).tolist() == [[2, 0], [4, 0], [4, 0]]
    assert found.of_evader(1, 0, 500 * MS).tolist() == [[5, 5], [5, 5.5]]
    assert found.at(0, np.array([125 * MS, 250 * MS])).tolist() == [[1, 0], [2, 0]]


def test_without_recorded_positions_it_is_said_how_to_record_them():
    with pytest.raises(ValueError, match=r"record\.trajectory"):
        drawn(history(samples=()))


def boxes(axes):
    axes.figure.draw_without_rendering()
    return [text.get_window_extent() for text in axes.texts]


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


def test_a_name_avoids_what_it_is_told_to():
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

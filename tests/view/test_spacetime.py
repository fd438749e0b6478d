"""Space-time diagrams: what is drawn where; not pixels."""

import re

import numpy as np
import pytest
from matplotlib.quiver import Quiver

from desim import load, run
from desim.analysis.plots import save
from desim.kernel.faults import Began, Partition
from desim.view.passages import passages
from desim.view.spacetime import MOST, spacetime
from scenarios.study import SCENARIOS
from tests.view.by_hand import MS, history, pair


@pytest.fixture(scope="module")
def crowded():
    return run(load(SCENARIOS / "faults.toml"))


def arrows(figure):
    """Return (send, row, arrival, row) of every arrow."""
    (axes,) = figure.axes
    found = [
        (x, y, x + u, y + v)
        for each in axes.collections
        if isinstance(each, Quiver)
        for (x, y), u, v in zip(each.XY.tolist(), each.U.tolist(), each.V.tolist(), strict=True)
    ]
    return sorted(found)


def lines(figure, label):
    """Return the points of the lines with a label."""
    (axes,) = figure.axes
    return [line.get_xydata().tolist() for line in axes.lines if line.get_label() == label and len(line.get_xdata())]


def dotted(figure):
    """Return the ends of each dotted line."""
    (axes,) = figure.axes
    found = [line.get_xydata() for line in axes.lines if line.get_linestyle() == ":" and len(line.get_xdata())]
    return [tuple(map(tuple, each[:2].round(9).tolist())) for line in found for each in line.reshape(-1, 3, 2)]


def test_an_arrow_leads_from_send_to_arrival_also_if_that_is_after_the_run():
    assert arrows(spacetime(history())) == [
        pytest.approx((0.1, 0, 0.2, 1)),
        pytest.approx((0.9, 1, 1.2, 0)),
        pytest.approx((0.9, 1, 1.2, 2)),
    ]


def test_a_lost_message_ends_where_it_is_lost_and_before_its_receiver_if_that_is_known_at_once():
    """Those that arrive take (0.1 + 0.3 + 0.3) / 3 s, and a quarter of a line before the receiver it is lost."""
    latency = 0.7 / 3
    assert dotted(spacetime(history())) == [
        ((0.1, 0.0), (pytest.approx(0.1 + latency * 1.75 / 2), 1.75)),
        ((0.3, 2.0), (0.5, 0.0)),
        ((0.75, 1.0), (pytest.approx(0.75 + latency * 0.75), 0.25)),
        ((0.75, 1.0), (pytest.approx(0.75 + latency * 0.75), 1.75)),
    ]
    (axes,) = spacetime(history()).axes
    (crosses,) = [line for line in axes.lines if line.get_marker() == "x" and line.get_linestyle() == "None"]
    assert len(crosses.get_xdata()) == 4


def test_the_actions_and_decisions_are_on_the_line_of_their_pursuer():
    figure = spacetime(history())
    assert lines(figure, "active") == [[[0.0, 0], [0.4, 0]], [[0.0, 1], [0.15, 1]], [[0.8, 2], [1.0, 2]]]
    assert lines(figure, "starts") == [[[0.8, 2]]]
    assert lines(figure, "stops") == [[[0.15, 1]]]
    assert lines(figure, "decides as before") == [[[0.16, 1]]]


def test_of_two_evaders_it_is_told_which_is_chased_turned_to_and_captured():
    figure = spacetime(pair())
    (axes,) = figure.axes
    assert lines(figure, "chases 1") == [[[0.0, 0], [0.4, 0]], [[0.0, 1], [0.15, 1]]]
    assert lines(figure, "chases 2") == [[[0.4, 0], [1.0, 0]], [[0.15, 1], [0.7, 1]], [[0.0, 2], [0.3, 2]]]
    assert lines(figure, "turns to another") == [[[0.15, 1]]]
    assert lines(figure, "starts") == [[[0.4, 0]]]
    assert lines(figure, "stops") == [[[0.3, 2], [0.7, 1]]]
    assert lines(figure, "captures") == [[[0.4, 0]], [[1.0, 0]]]
    numbers = [(each.get_text(), each.xy) for each in axes.texts if "captured" not in each.get_text()]
    assert numbers == [("1", (0.0, 0)), ("1", (0.0, 1)), ("2", (0.4, 0)), ("2", (0.15, 1)), ("2", (0.0, 2))]
    assert [each.get_text() for each in axes.texts if "captured" in each.get_text()] == ["1 captured", "2 captured"]
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert [name for name in names if name.startswith("says")] == ["says: chases 2", "says: inactive"]


def test_rows_are_the_pursuers_asked_for_from_top_to_bottom_and_only_messages_among_them():
    figure = spacetime(history(), pursuers=(2, 1))
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.get_yticklabels()] == ["2", "1"]
    assert axes.get_ylim()[0] > axes.get_ylim()[1]
    assert arrows(figure) == [pytest.approx((0.9, 1, 1.2, 0))]
    assert lines(figure, "starts") == [[[0.8, 0]]]


def test_a_window_has_what_happens_in_it_and_what_is_on_its_way_at_its_edges():
    figure = spacetime(history(), 0.15, 0.25)
    (axes,) = figure.axes
    assert axes.get_xlim() == (0.15, 0.25)
    assert arrows(figure) == [pytest.approx((0.1, 0, 0.2, 1))]
    assert lines(figure, "active") == [[[0.15, 0], [0.25, 0]], [[0.15, 1], [0.15, 1]]]
    assert not lines(figure, "starts")
    assert not [each for each in axes.texts if each.get_text() == "jamming"]


def test_faults_are_shaded_on_their_line_or_over_the_whole_height():
    (axes,) = spacetime(history()).axes
    (crash,) = [each for each in axes.collections if each.get_label() == "broken down"]
    box = crash.get_paths()[0].get_extents()
    assert box.extents.tolist() == pytest.approx([0.4, -0.3, 0.6, 0.3])
    (jamming,) = axes.patches
    assert [jamming.get_x(), jamming.get_width()] == pytest.approx([0.7, 0.3])
    assert [each.get_text() for each in axes.texts] == ["jamming"]


def test_a_fault_that_is_longer_than_the_window_is_cut_at_its_edges():
    (axes,) = spacetime(history(), 0.45, 0.55).axes
    (crash,) = [each for each in axes.collections if each.get_label() == "broken down"]
    assert crash.get_paths()[0].get_extents().extents.tolist() == pytest.approx([0.45, -0.3, 0.55, 0.3])
    assert axes.get_xlim() == (0.45, 0.55)


def test_the_names_of_two_faults_at_once_are_below_each_other():
    figure = spacetime(history(Began(700 * MS, Partition(groups=((0,),), at=0.7))))
    figure.draw_without_rendering()
    one, other = (text.get_window_extent() for text in figure.axes[0].texts)
    assert not one.overlaps(other)


def test_the_axes_have_names_with_units_and_the_legend_each_thing_once():
    figure = spacetime(history())
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title()) == ("time (s)", "pursuer", "by hand, seed 3")
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(set(names)) == len(names)
    assert set(names) == {
        *("active", "broken down", "says: active", "says: inactive", "lost message"),
        *("decides as before", "starts", "stops"),
    }


def test_the_title_says_if_not_everybody_is_drawn(crowded):
    size = crowded.scenario.team.count
    (axes,) = spacetime(crowded, 1.9, 2.1, pursuers=(0, 5, 9)).axes
    assert axes.get_title().endswith(f", 3 of {size} pursuers")
    (axes,) = spacetime(crowded, 1.9, 1.91, pursuers=range(size)).axes
    assert "pursuers" not in axes.get_title()


@pytest.mark.parametrize("width", [8.5, 17.0])
def test_no_text_lies_over_another_or_outside_of_the_picture(crowded, width):
    figure = spacetime(crowded, 1.9, 2.1, width=width, pursuers=(0, 5, 9))
    (axes,) = figure.axes
    figure.draw_without_rendering()
    said = [*axes.texts, axes.title, axes.xaxis.label, axes.yaxis.label, *axes.get_yticklabels()]
    said += [tick for tick in axes.get_xticklabels() if tick.get_text()]
    boxes = [text.get_window_extent() for text in said] + [figure.legends[0].get_window_extent()]
    for k, one in enumerate(boxes):
        assert figure.bbox.x0 <= one.x0 < one.x1 <= figure.bbox.x1 + 1
        assert figure.bbox.y0 <= one.y0 < one.y1 <= figure.bbox.y1 + 1
        assert not any(one.overlaps(other) for other in boxes[k + 1 :])
    assert figure.get_size_inches()[0] == pytest.approx(width / 2.54)


def test_too_many_messages_are_refused_and_the_advice_helps(crowded):
    """As it says when the window could end, and how many fit."""
    with pytest.raises(ValueError, match="fewer pursuers") as refused:
        spacetime(crowded, 1.0, 4.0)
    until = float(re.search(r"end the window at ([\d.]+) s", str(refused.value))[1])
    assert f"the {round(MOST * 17)} that" in str(refused.value)
    figure = spacetime(crowded, 1.0, until)
    shown = len(arrows(figure)) + len(dotted(figure))
    assert 0.8 * MOST * 17 < shown <= MOST * 17
    spacetime(crowded, 1.0, 4.0, pursuers=(0, 9))


@pytest.mark.parametrize("width", [8.5, 17.0])
def test_if_nothing_is_asked_for_there_is_something_to_see_and_not_too_much(crowded, width):
    figure = spacetime(crowded, width=width)
    (axes,) = figure.axes
    assert 0.4 * MOST * width < len(arrows(figure)) + len(dotted(figure)) <= MOST * width
    assert axes.get_xlim()[0] == 0.0
    assert len(axes.get_yticks()) == 10


def test_of_a_large_team_the_six_that_changed_action_most_are_shown():
    result = run(load(SCENARIOS / "relay.toml", ["record.messages=true", "horizon=0.5"]))
    own = np.zeros(20, int)
    active = [True] * 20
    for event in result.trace:
        if type(event).__name__ == "Decided" and event.active != active[event.pursuer]:
            active[event.pursuer] = event.active
            own[event.pursuer] += 1
    (axes,) = spacetime(result).axes
    shown = [int(text.get_text()) for text in axes.get_yticklabels()]
    assert len(shown) == 6
    assert shown == sorted(shown)
    assert own[shown].min() >= np.delete(own, shown).max()
    assert own.max() > own.min()


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"begin": 1.0}, "the run lasted 1 s"),
        ({"begin": 0.5, "end": 0.5}, "from 0.5 s to 0.5 s is empty"),
        ({"pursuers": (0, 3)}, r"no pursuer 3: they are 0 \.\. 2"),
        ({"pursuers": (-1,)}, "no pursuer -1"),
        ({"pursuers": (1, 1)}, "once each"),
        ({"pursuers": ()}, "at least one"),
    ],
)
def test_what_cannot_be_drawn_is_said(asked, says):
    with pytest.raises(ValueError, match=says):
        spacetime(history(), **asked)


def test_without_messages_lines_and_decisions_remain():
    silent = load(SCENARIOS / "relay.toml", ["announce.trigger=never", "horizon=0.3"])
    figure = spacetime(run(silent))
    assert not passages(run(silent))
    assert not arrows(figure)
    assert lines(figure, "active")


def test_a_picture_drawn_twice_is_the_same_bytes(tmp_path):
    once, twice = (save(spacetime(history()), tmp_path / name) for name in ("once", "twice"))
    assert [path.read_bytes() for path in once] == [path.read_bytes() for path in twice]
    other = save(spacetime(history(name="another")), tmp_path / "other")
    assert once[0].read_bytes() != other[0].read_bytes()

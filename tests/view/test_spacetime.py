"""Space-time diagrams: what is drawn where; not pixels."""

import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from desim.analysis.deliveries import deliveries
from desim.analysis.drawing.palette import COLLISION_MARK, LOST, LOST_MARK
from desim.kernel.core.events import Broadcast, Lost, Queued
from desim.kernel.models.faults import Partition
from desim.kernel.models.traced_faults import FaultStarted, Misbehaviour
from desim.pursuit.core.events import Decided
from desim.simulation.run import Result
from desim.view.pictures import spacetime as spacetime_module
from desim.view.pictures.spacetime import MAX_DENSITY, _busiest, spacetime
from tests.view.by_hand import ACTIVE, MS, history


@pytest.fixture(scope="module")
def crowded(run_of):
    return run_of("faults.toml")


def count(figure):
    """Return how many messages are drawn."""
    (axes,) = figure.axes
    dotted = [line for line in axes.lines if line.get_linestyle() == ":"]
    return sum(len(each.U) for each in axes.collections if isinstance(each, Quiver)) + sum(
        len(line.get_xdata()) // 3 for line in dotted
    )


def test_a_diagram_is_drawn_on_given_axes_with_the_legend_above():
    figure = Figure(figsize=(8, 3))
    left, right = figure.subplots(1, 2)
    assert spacetime(history(), ax=left) is figure
    assert not right.has_data()
    assert "active" in [text.get_text() for text in left.get_legend().get_texts()]
    assert left.get_legend().get_window_extent().y0 >= left.get_window_extent().y1


@pytest.mark.slow
def test_a_collision_is_an_asterisk_on_the_line_of_its_receiver_also_if_it_was_acknowledged():
    """0 sends to 1 from 0.2 to 0.3 s; 2 gives up a message to 1 at 0.6 s; neither mark is that of other losses."""
    collided = [
        Broadcast(200 * MS, 8, 0, 9, (1,), (300 * MS,), 200 * MS, 24, ACTIVE),
        Lost(300 * MS, 8, 0, 1, "collision"),
        Queued(590 * MS, 9, 2, (1,), 24),
        Lost(600 * MS, 9, 2, 1, "collision"),
    ]
    (axes,) = spacetime(history(*collided)).axes
    drawn = {str(line.get_marker()): line for line in axes.lines if line.get_color() == LOST and len(line.get_xdata())}
    asterisks, crosses = drawn[str(COLLISION_MARK)].get_xydata(), drawn[LOST_MARK].get_xydata()
    assert asterisks.tolist() == [[0.3, 1.0], [0.6, 1.0]]
    assert len(crosses) == 4
    assert not (crosses[:, 1] == 1.0).any()


@pytest.mark.slow
def test_a_liar_that_is_not_drawn_is_no_shade():
    liars = history(FaultStarted(500 * MS, Misbehaviour(number=0, model="liar", node=1, start=0.5)))
    shown = [text.get_text() for text in spacetime(liars, pursuers=(0, 1)).axes[0].texts]
    hidden = [text.get_text() for text in spacetime(liars, pursuers=(0, 2)).axes[0].texts]
    assert "liar 1" in shown
    assert "liar 1" not in hidden


@pytest.mark.parametrize(("limit", "rows"), [(3, 3), (2, 1)])
def test_of_more_pursuers_than_the_limit_only_the_busiest_are_drawn(limit, rows, monkeypatch):
    """The run has 3 pursuers."""
    monkeypatch.setattr(spacetime_module, "MAX_SHOWN", limit)
    monkeypatch.setattr(spacetime_module, "BUSIEST", 1)
    assert len(_busiest(history())) == rows


def test_a_title_says_which_part_of_the_run_is_drawn():
    assert spacetime(history(), 0.2, 0.3).axes[0].get_title().endswith("seed 3, 0.2 to 0.3 s of 1 s")
    assert spacetime(history(), 0.0, 1.0).axes[0].get_title().endswith("seed 3")


@pytest.mark.slow
def test_a_long_title_with_dollars_is_wrapped_within_the_picture():
    result = history()
    name = "costs of $5$ and a_b in $ which no line of the picture can hold " * 3
    figure = spacetime(Result(result.scenario.model_copy(update={"name": name}), result.seed, result.trace))
    figure.draw_without_rendering()
    extent, window = figure.axes[0].title.get_window_extent(), figure.bbox
    assert extent.height > 2 * figure.axes[0].title.get_fontsize()
    assert window.x0 <= extent.x0 < extent.x1 <= window.x1


@pytest.mark.slow
def test_the_names_of_two_faults_at_once_are_below_each_other():
    figure = spacetime(history(FaultStarted(700 * MS, Partition(groups=((0,),), start=0.7))))
    figure.draw_without_rendering()
    one, other = (text.get_window_extent() for text in figure.axes[0].texts if text.get_text() != "captured")
    assert not one.overlaps(other)


@pytest.mark.slow
@pytest.mark.parametrize("width", [8.5, pytest.param(17.0, marks=pytest.mark.slow)])
def test_no_text_lies_over_another_or_outside_of_the_picture(crowded, width):
    figure = spacetime(crowded, 1.9, 2.1, size=f"{width}cm", pursuers=(0, 5, 9))
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


@pytest.mark.slow
def test_too_many_messages_are_refused_and_the_advice_helps(crowded):
    """The message names a possible end of the window, and how many fit."""
    with pytest.raises(ValueError, match="fewer pursuers") as refused:
        spacetime(crowded, 1.0, 4.0)
    until = float(re.search(r"end the window at ([\d.]+) s", str(refused.value))[1])
    assert f"the {round(MAX_DENSITY * 17)} that" in str(refused.value)
    assert 0.8 * MAX_DENSITY * 17 < count(spacetime(crowded, 1.0, until)) <= MAX_DENSITY * 17
    spacetime(crowded, 1.0, 4.0, pursuers=(0, 9))


@pytest.mark.parametrize(
    ("most", "begin", "end", "says"),
    [
        (
            0.1,
            0.0,
            1.0,
            r"7 messages .* from 0 s to 1 s are more than the 2 .*: end the window at 0.100000000 s, or ch",
        ),
        (0.06, 0.9, 1.0, r"more than the 1 that can be told apart: choose fewer pursuers or a wider figure"),
    ],
)
def test_the_advice_is_the_last_time_up_to_which_all_messages_fit(most, begin, end, says, monkeypatch):
    """Two are sent at 100 ms, one at 300 ms, two each at 750 and 900 ms."""
    monkeypatch.setattr("desim.view.pictures.spacetime.MAX_DENSITY", most)
    with pytest.raises(ValueError, match=says):
        spacetime(history(), begin, end)


@pytest.mark.slow
@pytest.mark.parametrize("width", [8.5, 17.0])
def test_the_default_selection_is_neither_empty_nor_too_large(crowded, width):
    figure = spacetime(crowded, size=f"{width}cm")
    (axes,) = figure.axes
    assert 0.4 * MAX_DENSITY * width < count(figure) <= MAX_DENSITY * width
    assert axes.get_xlim()[0] == 0.0
    assert len(axes.get_yticks()) == 10


@pytest.mark.slow
def test_of_a_large_team_the_six_that_changed_action_most_are_shown(run_of):
    result = run_of("relay.toml", "horizon=1.0", "record.messages=true")
    own, active = np.zeros(20, int), [True] * 20
    for event in result.trace.of(Decided):
        own[event.pursuer] += event.active != active[event.pursuer]
        active[event.pursuer] = event.active
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
def test_a_run_that_cannot_be_drawn_is_reported(asked, says):
    with pytest.raises(ValueError, match=says):
        spacetime(history(), **asked)


@pytest.mark.slow
def test_without_messages_lines_and_decisions_remain(run_of):
    result = run_of("relay.toml", "announce.trigger=never", "announce.start=known", "horizon=0.3")
    assert not deliveries(result)
    figure = spacetime(result)
    assert not count(figure)
    assert "active" in {line.get_label() for line in figure.axes[0].lines}


@pytest.mark.slow
def test_without_an_end_the_window_ends_after_half_of_the_messages_that_fit(monkeypatch):
    """Of seven messages two are sent at 100 ms, one at 300 ms, two each at 750 and 900 ms; those of one time stay."""
    for most, until in ((2, 0.1), (4, 0.3), (6, 0.75), (12, 0.9), (14, 1.0)):
        monkeypatch.setattr("desim.view.pictures.spacetime.MAX_DENSITY", most / 17.0)
        (axes,) = spacetime(history(), size="17cm").axes
        assert axes.get_xlim()[1] == pytest.approx(until, abs=0.02)

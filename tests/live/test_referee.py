"""The referee of a live run, without processes: what it does for each word of a pursuer, and how it ends a run."""

import asyncio

import pytest

from desim import Scenario
from desim.kernel.core.events import TransportCounts
from desim.kernel.core.units import SECOND
from desim.kernel.models.faults import Crash
from desim.kernel.models.traced_faults import FaultStarted
from desim.live.frames import WorldFrame
from desim.live.link import Drops
from desim.live.lobby import LiveError
from desim.live.referee import FRAME, LINGER, STALL, Referee
from desim.live.result import REFEREE
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Ended, Sampled
from tests.golden import golden

MS = 1_000_000
COUNTS = TransportCounts(1, 2, 3, 1, {}, 4, 2, 1, 0, 0, 9)


class Room:
    """A lobby and a clock, which note what is told and met; `missing` are those that do not report."""

    def __init__(self, missing=(), errors=()):
        self.told, self.errors, self.lateness, self._missing = [], list(errors), [], list(missing)

    def tell_all(self, *words, may_skip=False):
        self.told.append((words, may_skip))

    async def reports(self, limit):
        assert limit == LINGER
        return self._missing

    def meet(self, act):
        act()


def judge(room=None, **changes):
    """Return a referee whose world has begun, with its lobby."""
    parts = {"team": {"count": 2, "speeds": 1.0}, "horizon": 1.0, "motion": {"step": 0.01}}
    experiment = Scenario(**parts | changes)
    told = []
    referee, room = Referee(experiment, 4, tell=told.append), room or Room()
    referee._prepare(experiment)
    referee._lobby = referee._clock = room
    room.sentences = told
    return referee, room


def pass_time(referee, to):
    """Let the clock of a referee go on to a time, ns."""
    while referee._env.peek() <= to and not referee._end.over.processed:
        referee._env.advance(int(referee._env.peek()), referee._end.over)
    referee._env.advance(to, referee._end.over)


def frames(room):
    """Return the frames that were told, which may all be skipped."""
    assert all(may_skip for words, may_skip in room.told if words[0] == "frame")
    return [WorldFrame(*words[1:]) for words, _ in room.told if words[0] == "frame"]


@pytest.mark.parametrize("step", [0.01, 0.08])
def test_a_frame_is_sent_each_20th_of_a_second_or_each_motion_step(step):
    referee, room = judge(motion={"step": step})
    pass_time(referee, 400 * MS)
    period = max(FRAME, round(step * SECOND))
    assert [frame.t for frame in frames(room)] == list(range(0, 400 * MS + 1, period))
    assert FRAME == 50 * MS


def test_the_last_frame_is_planned_at_the_end_of_the_run_or_after_it():
    referee, room = judge(horizon=0.12)
    assert len(list(referee._frames(50 * MS))) == 4
    assert [words[0] for words, _ in room.told] == ["frame"] * 4


@pytest.mark.parametrize(
    ("event", "shows"),
    [(Captured(0, 1, 1), True), (BrokeDown(0, 1), True), (Decided(0, 1, 1), False), (Ended(0, "horizon", None), False)],
)
def test_what_a_pursuer_cannot_foresee_is_shown_at_once(event, shows):
    referee, room = judge()
    pass_time(referee, 20 * MS)
    room.told.clear()
    referee._watch(event)
    assert not room.told
    pass_time(referee, 30 * MS)
    assert [frame.t for frame in frames(room)] == [20 * MS] * shows


def test_an_order_is_obeyed_and_counted_and_shown_if_it_changes_an_action():
    referee, room = judge()
    pass_time(referee, 20 * MS)
    room.told.clear()
    for action, decided in ((0, 15), (0, 16), (1, 30), (0, 20)):
        referee._hear(1, "order", decided * MS, action)
    pass_time(referee, 30 * MS)
    shown = frames(room)
    assert [frame.t for frame in shown] == [20 * MS] * 3
    assert shown[0].profile == [1, 0]
    assert shown[0].obeyed == [0, 4]
    assert referee._conduct.orders == [5 * MS, 0, 0]


def test_the_words_of_a_pursuer_are_taken():
    referee, _ = judge()
    taken = []
    referee._logs.take = lambda *words: taken.append(words)
    referee._hear(1, "report", [1], [2], [3])
    referee._hear(1, "done", [*COUNTS], [1, 0, 2], [5 * MS], [7 * MS], 0.25)
    referee._hear(0, "done", None, [0, 0, 0], [], [], 0.5)
    referee._hear(0, "nonsense")
    assert taken == [(1, [1], [2], [3])]
    assert referee._logs.transports == [COUNTS]
    conduct = referee._conduct
    assert (conduct.drops, conduct.cpu) == ({1: Drops(1, 0, 2), 0: Drops(0, 0, 0)}, {1: 0.25, 0: 0.5})
    assert (conduct.timers, conduct.deliveries) == ([5 * MS], [7 * MS])
    assert conduct.lateness[1].worst == 0.005


def test_before_the_clock_runs_an_order_and_a_loss_have_no_effect():
    referee, _ = judge()
    referee._clock = None
    referee._hear(1, "order", 0, 1)
    referee._lose(1, "was lost")
    assert (referee._obeyed, referee._conduct.ends) == ([0, 0], {})


def test_a_lost_process_crashes_its_pursuer():
    referee, room = judge()
    pass_time(referee, 20 * MS)
    referee._lose(1, "was lost")
    assert referee._trace.of(FaultStarted) == [FaultStarted(20 * MS, Crash(start=0.02, node=1))]
    assert referee._state.broken.tolist() == [False, True]
    assert (referee._logs.crashed, referee._conduct.ends) == ({1: 20 * MS}, {1: "was lost"})
    assert room.sentences == ["pursuer 1 was lost at 0.02 s"]
    assert referee._end.outcome is None


@pytest.mark.parametrize("lost", [20 * MS, 200 * MS])
def test_a_lost_process_stays_down_when_a_scheduled_crash_ends(lost):
    fault = {"kind": "crash", "start": 0.1, "end": 0.3, "node": 1}
    referee, _ = judge(fault=[fault, fault | {"node": 0}])
    pass_time(referee, lost)
    referee._lose(1, "was lost")
    assert referee._state.broken.tolist() == [lost > 100 * MS, True]
    pass_time(referee, 400 * MS)
    assert referee._state.broken.tolist() == [False, True]


def test_an_exception_of_a_protocol_stops_the_run_without_a_crash():
    referee, room = judge(Room(errors=["pursuer 1: ValueError: no way"]))
    pass_time(referee, 20 * MS)
    referee._lose(1, "ended with exit code 1")
    assert referee._end.outcome == Ended(20 * MS, "stopped", None)
    assert not referee._state.broken.any()
    assert room.sentences == []
    with pytest.raises(LiveError, match=r"^pursuer 1: ValueError: no way$"):
        asyncio.run(referee._last_reports())


def test_all_are_told_that_the_run_is_over_and_who_does_not_report_is_noted():
    referee, room = judge(Room(missing=[1]), horizon=0.1)
    pass_time(referee, 200 * MS)
    samples = len(referee._trace.of(Sampled))
    assert asyncio.run(referee._last_reports()) == [1]
    assert len(referee._trace.of(Sampled)) == samples + 1
    assert room.told[-1] == (("over", 100 * MS), False)


@pytest.mark.parametrize(("late", "note"), [(STALL, []), (0.62, ["the referee stalled for 0.6 s"])])
def test_a_result_says_how_late_each_process_was_and_who_has_not_reported(late, note):
    referee, room = judge(horizon=0.1)
    pass_time(referee, 200 * MS)
    for pursuer in (1, 0):
        referee._hear(pursuer, "done", None, [0, 0, 0], [pursuer * MS], [], 0.0)
    room.lateness = [MS, round(late * SECOND)]
    result = referee._result(room, [1])
    assert list(result.conduct.lateness) == [0, 1, REFEREE]
    assert [of.worst for of in result.conduct.lateness.values()] == [0.0, 0.001, late]
    assert result.conduct.notes == ["pursuer 1 has not reported within 2 s of the end", *note]
    assert (result.seed, result.trace.events[-1]) == (4, Ended(100 * MS, "horizon", None))


def test_what_a_conduct_says_as_json_is_golden():
    referee, room = judge(horizon=0.1)
    pass_time(referee, 200 * MS)
    referee._hear(1, "order", 99 * MS, 0)
    for pursuer in (1, 0):
        referee._hear(pursuer, "done", None, [pursuer, 0, 2], [pursuer * MS, 3 * MS], [5 * MS], 0.25)
    referee._conduct.ends[1] = "was lost"
    document = referee._result(room, [1]).conduct.document()
    golden("live/conduct.txt", "\n".join(f"{key}: {value}" for key, value in document.items()) + "\n")

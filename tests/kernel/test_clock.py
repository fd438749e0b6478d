"""The clock: whole nanoseconds, no drift, and a stated order at one instant."""

import gc
import re
from contextlib import nullcontext
from importlib.metadata import version
from pathlib import Path

import pytest
import simpy

from desim.kernel.core.clock import GC_THRESHOLDS, Clock, FirstOf, Instant, NodeClock, Phase, Timer, parts_of
from desim.kernel.core.units import SECOND, nanoseconds, seconds

SOURCE = Path(__file__).parents[2] / "desim"


def test_a_time_in_seconds_is_the_nearest_nanosecond():
    """In floats 3 * 0.1 = 0.30000000000000004 is not 30 * 0.01 = 0.3, and 1.001 * 10^9 = 1000999999.9999999."""
    assert nanoseconds(3 * 0.1) == nanoseconds(30 * 0.01) == 300_000_000
    assert seconds(300_000_000) == 0.3
    assert nanoseconds(1.001) == 1_001_000_000


def test_a_million_ticks_of_a_tenth_do_not_drift():
    """sum of 0.1 s as floats is off by 1e-6 s after 10^6 ticks; k x period is not."""
    clock = Clock()
    period = nanoseconds(0.1)
    Instant(clock, 1_000_000 * period, Phase.MOTION)
    clock.run()
    assert clock.now == 100_000 * 10**9


@pytest.mark.parametrize("reverse", [False, True])
def test_phases_of_one_instant_happen_in_order_however_they_were_registered(reverse):
    clock = Clock()
    order = []
    wanted = [*Phase, Phase.DECISION + 3, Phase.DECISION + 1]
    for priority in sorted(wanted, reverse=reverse):
        Instant(clock, 5, priority).callbacks.append(lambda _, p=priority: order.append(p))
    clock.run()
    assert order == sorted(wanted)
    names = ["FAULT", "DELIVERY", "RELAY", "CAPTURE", "DECISION", "HEARTBEAT", "MOTION", "SAMPLE", "ACCESS"]
    assert [phase.name for phase in sorted(Phase)] == names


def test_an_event_made_in_a_late_phase_still_precedes_what_belongs_to_a_later_one():
    """A zero-latency delivery caused by decision 1 comes before decision 2 of the same instant."""
    clock = Clock()
    order = []

    def decide(_):
        order.append("decision 1")
        Instant(clock, clock.now, Phase.DELIVERY).callbacks.append(lambda _: order.append("delivery"))

    Instant(clock, 0, Phase.DECISION + 2).callbacks.append(lambda _: order.append("decision 2"))
    Instant(clock, 0, Phase.DECISION + 1).callbacks.append(decide)
    clock.run()
    assert order == ["decision 1", "delivery", "decision 2"]


def test_an_instant_in_the_past_is_refused():
    clock = Clock()
    Instant(clock, 10, Phase.MOTION)
    clock.run()
    with pytest.raises(ValueError, match="the instant 9 ns has passed, it is 10 ns"):
        Instant(clock, 9, Phase.MOTION)


def test_a_clock_error_is_an_offset_and_a_drift_from_the_true_time():
    """It shows 2 + 1.5 t: 5 s at 2 s, and 3 s of its own are 2 true ones."""
    env = Clock()
    Instant(env, 2 * SECOND, Phase.SAMPLE)
    env.run()
    clock = NodeClock(env, offset=2.0, rate=1.5)
    assert (clock.now, clock.true) == (5.0, 2 * SECOND)
    assert clock.when(8.0) == 4 * SECOND
    assert clock.span(3.0) == 2 * SECOND


@pytest.mark.parametrize("fails", [False, True])
def test_the_garbage_collector_looks_rarely_during_a_run_and_as_before_after_it(fails):
    """Also after a run that fails."""
    usual, clock, seen = gc.get_threshold(), Clock(), []

    def process():
        yield Instant(clock, SECOND, Phase.MOTION)
        seen.append(gc.get_threshold())
        if fails:
            raise ArithmeticError

    clock.process(process())
    with pytest.raises(ArithmeticError) if fails else nullcontext():
        clock.run()
    assert seen == [GC_THRESHOLDS]
    assert gc.get_threshold() == usual != GC_THRESHOLDS


def test_an_exception_of_a_process_is_raised_unchanged():
    class ParticularError(Exception):
        def __init__(self, code, *, reason="none"):
            super().__init__(code)
            self.reason = reason

    def process():
        yield Instant(env, 5, 0)
        error = ParticularError(7, reason="rust")
        error.add_note("a note")
        raise error

    env = Clock()
    env.process(process())
    with pytest.raises(ParticularError) as raised:
        env.run()
    assert raised.value.reason == "rust"
    assert raised.value.__notes__ == ["a note"]


def test_a_clock_that_follows_another_one_processes_what_is_due_and_leaves_no_event_behind():
    env, seen = Clock(), []
    for when in (3, 5, 5, 9):
        Instant(env, when, 0).callbacks.append(lambda _, when=when: seen.append((when, env.now)))
    env.advance(2)
    assert (env.now, seen) == (2, [])
    env.advance(7)
    assert (env.now, seen) == (7, [(3, 3), (5, 5), (5, 5)])
    assert env.peek() == 9
    env.advance(6)  # the other clock has gone back: time does not
    assert env.now == 7
    over = Instant(env, 8, 0)
    env.advance(20, over)
    assert (env.now, env.peek()) == (8, 9)


def test_an_exception_is_raised_unchanged_while_a_clock_follows_another_one():
    def process():
        yield Instant(env, 5, 0)
        error = ValueError("why")
        error.add_note("a note")
        raise error

    env = Clock()
    env.process(process())
    with pytest.raises(ValueError, match="why") as raised:
        env.advance(6)
    assert raised.value.__notes__ == ["a note"]


def test_an_exception_is_not_replaced_by_its_cause():
    def process():
        yield Instant(env, 5, 0)
        try:
            raise KeyError("first")
        except KeyError as error:
            raise ValueError("second") from error

    env = Clock()
    env.process(process())
    with pytest.raises(ValueError, match="second") as raised:
        env.run()
    assert isinstance(raised.value.__cause__, KeyError)


def test_the_private_parts_of_simpy_are_as_the_clock_uses_them():
    """A failure names what another version of SimPy has changed; `desim.kernel.core.clock` is the only user."""
    env = simpy.Environment()
    which = f"SimPy {version('simpy')}: "
    timeout = env.timeout(3)
    process = env.process(each for each in [timeout])
    for owner, name in [
        (env, "_now"),
        (env, "_queue"),
        (env, "_eid"),
        (timeout, "_ok"),
        (timeout, "_value"),
        (process, "_generator"),
        (timeout | process, "_events"),
    ]:
        assert hasattr(owner, name), f"{which}{type(owner).__name__} has no {name}"
    entries = [entry for entry in env._queue if entry[-1] is timeout]
    assert [len(entry) for entry in entries] == [4], f"{which}an entry of the queue is not (time, priority, id, event)"
    assert entries[0][0] == 3, f"{which}an entry of the queue does not begin with its time"
    assert env._queue == sorted(env._queue, key=lambda entry: entry[:3]), f"{which}the queue is not a heap of entries"
    assert next(env._eid) < next(env._eid), f"{which}the ids of events do not grow"


PRIVATE = re.compile(
    r"\b(env|event|timeout|process|target|queue)\w*\._(now|queue|eid|ok|value|generator|events|target)\b"
)


@pytest.mark.slow
def test_no_other_module_uses_private_parts_of_simpy():
    users = [path.name for path in SOURCE.rglob("*.py") if PRIVATE.search(path.read_text(encoding="utf-8"))]
    assert users == ["clock.py"]


def test_a_timer_acts_at_the_earliest_of_its_times_and_only_once():
    """Set to 5, 9, 3: it acts at 3; set again to 4 by what it does, and to 9 in vain once it is stopped."""
    env, acted = Clock(), []

    def act():
        acted.append(env.now)
        if env.now == 3:
            timer.set(4)
        else:
            timer.set(9)
            timer.stop()

    timer = Timer(env, Phase.DECISION, act)
    for when in (5, 9, 3):
        timer.set(when)
    env.run(20)
    assert acted == [3, 4]
    timer.set(7)  # has passed
    env.run(21)
    assert acted == [3, 4, 20]


@pytest.mark.parametrize("alarm", [0, 2, 3, 5])
@pytest.mark.parametrize("interrupt", [None, 1, 4])
def test_the_first_of_two_events_happens_as_their_condition_does(alarm, interrupt):
    """At the same times, in the same order among other events, also if an event has happened or a wait is given up."""

    def waits(combine):
        clock, seen = Clock(), []

        def process():
            once = Instant(clock, 3, Phase.DECISION)
            ring = Instant(clock, alarm, Phase.DECISION)
            for event in (once, ring):
                event.callbacks.append(lambda _: seen.append("another waits, too"))
            for _ in range(4):
                try:
                    yield combine(once, ring)
                    seen.append((clock.now, once.processed, ring.processed))
                    yield Instant(clock, clock.now + 1, Phase.MOTION)
                except simpy.Interrupt:
                    seen.append("interrupted")

        waiting = clock.process(process())
        for now in range(8):
            for phase in (Phase.DELIVERY, Phase.DECISION, Phase.MOTION):
                Instant(clock, now, phase).callbacks.append(lambda _, phase=phase: seen.append((clock.now, phase)))
        if interrupt is not None:
            Instant(clock, interrupt, Phase.FAULT).callbacks.append(lambda _: waiting.interrupt())
        clock.run()
        return seen

    assert waits(FirstOf) == waits(lambda one, other: one | other)
    one, other = Instant(Clock(), 1, Phase.DECISION), Instant(Clock(), 2, Phase.DECISION)
    assert list(parts_of(FirstOf(one, other))) == [one, other]


def test_the_first_of_two_events_is_a_part_of_the_one_that_happens():
    """It takes no event of its own, and who waits for it goes on before those that began to wait for it later."""
    clock, seen = Clock(), []
    once, other = Instant(clock, 1, Phase.DECISION), Instant(clock, 2, Phase.DECISION)
    FirstOf(once, other).callbacks.append(lambda event: seen.append(("first", event.processed, event.ok)))
    once.callbacks.append(lambda _: seen.append("later"))
    clock.step()
    assert seen == [("first", True, True), "later"]
    clock.run()
    assert len(seen) == 2


def test_a_correction_is_a_step_of_the_clock_and_replaces_the_last():
    """2 + 1.5 t at 1 s: 3.5 s, then 3 s with -0.5 s, 3.75 s with 0.25 s, and exact again where all is undone."""
    env = Clock()
    clock, right = NodeClock(env, offset=2.0, rate=1.5), NodeClock(env)
    env.run(SECOND)
    shown = [clock.now]
    for correction in (-SECOND // 2, SECOND // 4):
        clock.correct(correction)
        shown.append(clock.now)
        assert clock.uncorrected == 3_500_000_000
        assert clock.when(clock.now) == SECOND
    assert shown == [3.5, 3.0, 3.75]
    right.correct(5)
    assert right.stamp == SECOND + 5
    right.correct(0)
    assert right.stamp == SECOND

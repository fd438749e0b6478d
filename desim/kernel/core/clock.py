"""The clock of a simulation, in integer nanoseconds, and the order of simultaneous events.

Seconds (float) are used only at the interfaces. With integers, 3 x 0.1 s and 30 x 0.01 s are the same instant, so
rounding never separates simultaneous events. Simultaneous events of different phases happen in the order of `Phase`.

No other module of `desim` uses private parts of SimPy.
"""

import gc
from contextlib import contextmanager
from enum import IntEnum
from heapq import heappush
from operator import attrgetter
from threading import Lock
from typing import TYPE_CHECKING, Any, ClassVar

import simpy
from simpy.events import Condition, EventPriority

from desim.kernel.core.units import SECOND, nanoseconds, seconds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from simpy.core import SimTime

GC_THRESHOLDS = 100_000, 50, 100
"""The thresholds of the garbage collector during a run; see `gc.set_threshold`."""
NEVER = (1 << 63) - 1
"""A time that no run reaches, ns; the largest 64-bit integer."""


class _RareCollection:
    """Makes garbage collection less frequent in the whole process while at least one run lasts, in any thread."""

    def __init__(self) -> None:
        self._lock, self._runs, self._previous = Lock(), 0, gc.get_threshold()
        """The lock, the number of runs, and the thresholds before the first of them."""

    def __enter__(self) -> None:
        with self._lock:
            if not self._runs:
                self._previous = gc.get_threshold()
                gc.set_threshold(*GC_THRESHOLDS)
            self._runs += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._runs -= 1
            if not self._runs:
                gc.set_threshold(*self._previous)


RARE_COLLECTION = _RareCollection()
"""The context of a run: garbage collection is less frequent in the whole process."""


class Phase(IntEnum):
    """The order of simultaneous events, as SimPy priorities: the lowest number comes first.

    An event at which a node acts, such as a decision, has the priority of its phase plus the id of the node, so the
    lowest id acts first. SimPy's own events (priorities 0 and 1), such as a condition that is met, come before all
    phases. A process that waits for a condition therefore resumes in the phase of the event that met the condition.
    """

    FAULT = 1 << 32
    """Faults start and end."""
    DELIVERY = 2 << 32
    """Messages reach their inboxes."""
    RELAY = 3 << 32
    """Nodes forward received messages."""
    CAPTURE = 4 << 32
    """Evaders are captured; a run that reaches its horizon ends after these captures."""
    DECISION = 5 << 32
    """Nodes decide and announce their decisions."""
    HEARTBEAT = 6 << 32
    """Nodes send periodic announcements and reports; processes that wait for all decisions of the instant resume."""
    MOTION = 7 << 32
    """Velocities are recomputed."""
    SAMPLE = 8 << 32
    """Positions are recorded."""
    ACCESS = 9 << 32
    """Nodes that contend for a channel sense it, and start to transmit."""


@contextmanager
def _as_raised() -> "Iterator[None]":
    """Raise the exception of a process as it was raised, and not the copy that SimPy makes of it."""
    try:
        yield
    except BaseException as error:
        original = error.__cause__
        if type(original) is type(error) and original.args == error.args:  # as in a copy by SimPy
            raise original from original.__cause__
        raise


class Clock(simpy.Environment):
    """A SimPy environment whose time is an integer number of nanoseconds and starts at 0.

    Attributes:
        now: the time, ns.
    """

    __slots__ = ("_now",)  # SimPy sets the time here, and `now` is another name of the slot
    now: int

    def run(self, until: "SimTime | simpy.Event | None" = None) -> Any:
        """Run as `simpy.Environment.run` does, with less frequent garbage collection.

        Most objects of a simulation stay alive. With the usual thresholds, repeated scans of these objects take a third
        of the time of a large run.

        Raises:
            BaseException: the exception that a process raised, with its notes; SimPy itself raises a copy without them.
        """
        with RARE_COLLECTION, _as_raised():
            return super().run(until)

    def advance(self, time: int, until: simpy.Event | None = None) -> None:
        """Process all events up to and including a time, ns, which is then the present; see also `run`.

        Use it for a clock that follows another one. Unlike `run`, it leaves no event behind.

        Args:
            time: the time.
            until: an event after which the clock stops; None: there is none.

        Raises:
            BaseException: as `run`.
        """
        queue = self._queue
        if queue and queue[0][0] <= time:
            with _as_raised():
                while queue and queue[0][0] <= time:
                    if until is not None and until.processed:
                        return
                    self.step()
        if until is None or not until.processed:
            self._now = max(self._now, time)

    def scheduled(self) -> dict[int, int]:
        """Return the time (ns) of each scheduled event, by the `id` of the event."""
        return {id(event): int(when) for when, _, _, event in self._queue}

    def trigger(self, event: simpy.Event, priority: int) -> None:
        """Trigger an event now, with the value None and a SimPy priority among simultaneous events."""
        event._ok, event._value = True, None
        self.schedule(event, EventPriority(priority))


Clock.now = vars(Clock)["_now"]  # read in an eighth of the time of a property


def generator_of(process: simpy.Process) -> Any:
    """Return the generator that a process runs."""
    return process._generator


def parts_of(event: simpy.Event) -> "Sequence[simpy.Event]":
    """Return the events that a condition combines; for any other event, a list with only this event."""
    if isinstance(event, FirstOf):
        return event.events
    return event._events if isinstance(event, Condition) else [event]


class Instant(simpy.Event):
    """An event at a given time (ns) with a given priority, usually a `Phase`; its value is None.

    Unlike `simpy.Timeout` it takes an absolute time, so the k-th tick of a period is at k x period, without drift.

    Raises:
        ValueError: if the time is in the past.
    """

    _ok = True
    _value: Any = None

    def __init__(self, env: Clock, when: int, priority: int):
        if when < env._now:
            raise ValueError(f"the instant {when} ns has passed, it is {env.now} ns")
        self.env = env
        self.callbacks: list[Callable[[simpy.Event], None]] = []
        heappush(env._queue, (when, priority, next(env._eid), self))  # type: ignore[misc]  # `schedule`, inlined


class FirstOf(simpy.Event):
    """An event that happens as soon as one of several events has happened; its value is None.

    It replaces `first | second` of SimPy, without a table of the events and their values, and is not scheduled itself:
    it happens as a part of the first of the events. So a process that waits for it resumes before processes that begin
    to wait for the same event later; with SimPy, it resumes after them. None of the events may fail.

    Kept equal to the condition of SimPy by
    `tests/kernel/test_clock.py::test_the_first_of_two_events_happens_as_their_condition_does`.

    Args:
        events: the events.
    """

    _ok = True
    _value: Any = None

    def __init__(self, *events: simpy.Event):
        self.env, self.events = events[0].env, events
        self.callbacks: list[Callable[[simpy.Event], None]] = []
        if [event for event in events if event.processed]:
            self.env.schedule(self)
            return
        for event in events:
            event.callbacks.append(self._happen)

    def _happen(self, _: simpy.Event) -> None:
        for event in self.events:
            if event.callbacks:  # None if the event has happened
                event.callbacks.remove(self._happen)
        callbacks, self.callbacks = self.callbacks, None  # type: ignore[assignment]  # SimPy's mark: it has happened
        for callback in callbacks:
            callback(self)


class Timer:
    """Calls a function once, at the earliest of the times to which the timer has been set.

    Setting the timer to a later time has no effect: the function can set it again when it is called. If the timer is
    set to an earlier time, the event that was scheduled for the later time has no effect.

    Args:
        env: the clock.
        priority: the SimPy priority of the call, usually a `Phase`.
        act: the function.
    """

    __slots__ = ("_act", "_env", "_priority", "_when")

    def __init__(self, env: Clock, priority: int, act: "Callable[[], object]"):
        self._env, self._priority, self._act = env, priority, act
        self._when = NEVER

    def set(self, when: int) -> None:
        """Call the function at a time, ns, or now if it has passed, unless it is called earlier anyway."""
        if when < self._when and (when := max(when, self._env.now)) < self._when:
            self._when = when
            Instant(self._env, when, self._priority).callbacks.append(self._ring)

    def stop(self) -> None:
        """Do not call the function until the timer is set again."""
        self._when = NEVER

    def _ring(self, _: simpy.Event) -> None:
        if self._env.now == self._when:  # else it has been stopped, or set to an earlier time
            self._when = NEVER
            self._act()


class NodeClock:
    """The local clock of a node: at the true time t, s, it shows offset + correction + rate * t, s.

    Attributes:
        wanders: whether the true duration of a local duration depends on when it begins.
        correction: the present correction by synchronisation, s.
    """

    wanders: ClassVar[bool] = False
    true: int = property(attrgetter("_env._now"), doc="The true time, ns.")  # type: ignore[assignment]  # as in `Clock`

    def __init__(self, env: Clock, offset: float = 0.0, rate: float = 1.0):
        self._env, self._offset, self._rate = env, offset, rate
        self._is_exact = offset == 0.0 and rate == 1.0
        self._first_offset = offset
        self.correction = 0.0

    @property
    def now(self) -> float:
        """The local time, s."""
        return self._offset + self._rate * (self._env._now / SECOND)

    @property
    def stamp(self) -> int:
        """The local time, ns."""
        return self._env.now if self._is_exact else round(self.now * SECOND)

    @property
    def uncorrected(self) -> int:
        """The local time without the correction, ns."""
        return round((self._first_offset + self._rate * (self._env._now / SECOND)) * SECOND)

    def correct(self, correction: int) -> None:
        """Replace the correction, ns; the local time steps by its change."""
        self.correction = seconds(correction)
        self._offset = self._first_offset + self.correction
        self._is_exact = self._offset == 0.0 and self._rate == 1.0

    def at(self, true: int) -> float:
        """Return the local time (s) at a true time (ns), with the present correction."""
        return self._offset + self._rate * seconds(true)

    def when(self, time: float) -> int:
        """Return the true time (ns) at a local time (s), with the present correction."""
        return round((time - self._offset) / self._rate * SECOND)

    def span(self, duration: float) -> int:
        """Return the true duration (ns) of a local duration (s), which may be negative."""
        return nanoseconds(duration / self._rate)

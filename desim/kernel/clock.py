"""The clock of a simulation: integer nanoseconds, and what comes first among the events of one instant.

Seconds (float) exist only at the edges. Integers make 3 x 0.1 s and 30 x 0.01 s the same instant, so that
ties are decided by the `Phase` they belong to and never by rounding or by who was registered first.
"""

import gc
from enum import IntEnum
from heapq import heappush
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import simpy

if TYPE_CHECKING:
    from collections.abc import Callable

    from simpy.core import SimTime

RARELY = 100_000, 50, 100
"""The thresholds of the garbage collector during a run; see `gc.set_threshold`."""
SECOND = 1_000_000_000
"""Nanoseconds in a second."""


class Phase(IntEnum):
    """What happens first among the events of one instant: the SimPy priority of each kind of event.

    Decisions add the node's id to their priority: the lowest id decides first. SimPy's own bookkeeping
    (priorities 0 and 1) precedes everything, so a process resumes within the phase of the event it waited for.
    """

    FAULT = 1 << 32
    """Faults and changes of topology."""
    DELIVERY = 2 << 32
    """Messages reach their inboxes."""
    RELAY = 3 << 32
    """Word that has arrived is passed on."""
    CAPTURE = 4 << 32
    """The motion that led up to this instant is judged: capture, then the horizon."""
    DECISION = 5 << 32
    """Nodes decide and speak."""
    HEARTBEAT = 6 << 32
    """Nodes repeat what they said."""
    MOTION = 7 << 32
    """Headings are recomputed."""
    SAMPLE = 8 << 32
    """Positions are written to the record."""


def nanoseconds(seconds: float) -> int:
    """Return a duration in seconds as the nearest whole number of nanoseconds."""
    return round(seconds * SECOND)


def seconds(nanoseconds: int) -> float:
    """Return a duration in nanoseconds as seconds."""
    return nanoseconds / SECOND


class Clock(simpy.Environment):
    """A SimPy environment whose time is a whole number of nanoseconds, from 0 on."""

    now: int = property(attrgetter("_now"), doc="The time, ns.")  # type: ignore[assignment]  # half of a method's time

    def run(self, until: "SimTime | simpy.Event | None" = None) -> Any:
        """Run as SimPy does, but let the garbage collector look less often meanwhile.

        What a simulation keeps is no garbage: to look at all of it time and again takes a third of a large one's time.

        Raises:
            BaseException: what a process raised, with what was noted on it; SimPy itself raises a copy.
        """
        usual = gc.get_threshold()
        gc.set_threshold(*RARELY)
        try:
            return super().run(until)
        except BaseException as error:
            first = error.__cause__
            if type(first) is type(error) and first.args == error.args:
                raise first from first.__cause__
            raise
        finally:
            gc.set_threshold(*usual)


class Instant(simpy.Event):
    """An event that happens at a given nanosecond, in a given phase; its value is None.

    Unlike `simpy.Timeout` it takes an absolute time, so that the k-th tick of a period is at k x period and
    does not drift.

    Raises:
        ValueError: if the instant has passed.
    """

    _ok = True
    _value: Any = None

    def __init__(self, env: Clock, when: int, priority: int):
        if when < env._now:
            raise ValueError(f"the instant {when} ns has passed, it is {env.now} ns")
        self.env = env
        self.callbacks: list[Callable[[simpy.Event], None]] = []
        heappush(env._queue, (when, priority, next(env._eid), self))  # type: ignore[misc]  # env.schedule


class NodeClock:
    """The clock of one node, which may be wrong: it shows offset + rate * t at the time t, s."""

    def __init__(self, env: Clock, offset: float = 0.0, rate: float = 1.0):
        self._env, self._offset, self._rate = env, offset, rate
        self._right = offset == 0.0 and rate == 1.0

    @property
    def now(self) -> float:
        """What it shows, s."""
        return self._offset + self._rate * (self._env._now / SECOND)

    @property
    def stamp(self) -> int:
        """What it shows, ns."""
        return self._env.now if self._right else round(self.now * SECOND)

    @property
    def true(self) -> int:
        """The true time, ns."""
        return self._env.now

    def at(self, true: int) -> float:
        """Return what it shows at a true time (ns), s."""
        return self._offset + self._rate * seconds(true)

    def when(self, time: float) -> int:
        """Return the true time at which it shows a time (s), ns."""
        return round((time - self._offset) / self._rate * SECOND)

    def span(self, duration: float) -> int:
        """Return the true time that passes while it shows that a duration (s) passes, ns."""
        return nanoseconds(duration / self._rate)

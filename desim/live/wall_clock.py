"""A clock of SimPy that follows the wall clock, and the lateness of its timers."""

import asyncio
from collections.abc import Callable, Sequence
from time import monotonic_ns
from typing import TYPE_CHECKING, NamedTuple

from desim.kernel.core.clock import Clock
from desim.kernel.core.units import SECOND

if TYPE_CHECKING:
    import simpy

MAX_KEPT = 1_000_000
"""Largest number of timers whose lateness is kept."""


class Lateness(NamedTuple):
    """How late the timers of a process were, s."""

    number: int
    median: float
    """The lateness that half of them do not exceed."""
    p99: float
    """The lateness that 99 % of them do not exceed; of fewer than 100, the greatest."""
    worst: float

    def __str__(self) -> str:
        return f"{1e3 * self.median:.2f}, {1e3 * self.p99:.1f} and {1e3 * self.worst:.1f} ms"

    @classmethod
    def of(cls, nanoseconds: Sequence[int]) -> "Lateness":
        """Return the lateness of timers, given that of each one, ns."""
        late = [time / SECOND for time in sorted(nanoseconds)] or [0.0]
        count = len(late)
        return cls(len(nanoseconds), late[(count - 1) // 2], late[(99 * count - 1) // 100], late[-1])


class WallClock:
    """Lets a clock of SimPy follow the wall clock until an event; created in a coroutine.

    By the clock, an event happens at its planned time; by the wall clock, a little later. Between two events the clock
    shows the time of the last one. Input from outside is processed by `meet`, at the time of the wall clock. Nothing
    here is a task of asyncio: a timer of the loop waits for the next event.

    Args:
        env: the clock.
        over: the event after which the clock stops.
        now: returns the time of the wall clock, ns; None: the time since now, by the monotonic clock.
        before: called each time before the clock goes on.

    Attributes:
        lateness: how late each timer was, ns.
        ended: is done when the clock has stopped; raises the exception of a process of the clock, if there was one.
    """

    def __init__(
        self,
        env: Clock,
        over: "simpy.Event",
        now: Callable[[], int] | None = None,
        before: Callable[[], object] = lambda: None,
    ):
        begin = monotonic_ns()
        self._env, self._over, self._before = env, over, before
        self.now: Callable[[], int] = now or (lambda: monotonic_ns() - begin)
        self.lateness: list[int] = []
        self._loop = asyncio.get_running_loop()
        self.ended: asyncio.Future[None] = self._loop.create_future()
        self._timer: asyncio.TimerHandle | None = None
        self._due: float = -1.0
        """When the timer rings, ns."""
        self._is_busy = False
        self.wake()

    def advance(self) -> None:
        """Let all events happen that are due, and let the clock show the present time."""
        env, over, now = self._env, self._over, self.now()
        while (due := env.peek()) <= now and not over.processed:
            if due > env.now and len(self.lateness) < MAX_KEPT:  # simultaneous events count once
                self.lateness.append(int(now - due))
            env.advance(int(due), over)
            now = self.now()
        env.advance(now, over)

    def wake(self) -> None:
        """Perform or await the events that the caller has planned, once the caller has returned."""
        self._loop.call_soon(self.meet)

    def meet(self, act: Callable[[], object] | None = None) -> None:
        """Perform the events that are due, and then call a function; do nothing if the clock has stopped."""
        if self._is_busy and act is not None:  # an event of the clock is the caller: the clock shows the present
            act()
        if self._is_busy or self.ended.done():
            return
        self._is_busy = True
        try:
            self._before()
            self.advance()
            if act is not None and not self._over.processed:
                act()
                self.advance()
        except BaseException as error:
            self.ended.set_exception(error)
        else:
            self._wait()
        finally:
            self._is_busy = False

    def _wait(self) -> None:
        """Set the timer to the next event, or tell that the clock has stopped."""
        due = self._env.peek()
        if self._timer is not None and (due != self._due or self._over.processed):
            self._timer.cancel()
            self._timer = None
        if self._over.processed:
            self.ended.set_result(None)
        elif self._timer is None and due < float("inf"):
            self._timer = self._loop.call_later((due - self.now()) / SECOND, self._ring)
        self._due = due

    def _ring(self) -> None:
        self._timer = None
        self.meet()

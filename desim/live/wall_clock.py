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
"""Number of latenesses that are kept."""


class Lateness(NamedTuple):
    """How late the timers of a process were, s."""

    number: int
    median: float
    p99: float
    worst: float

    def __str__(self) -> str:
        return f"{1e3 * self.median:.2f}, {1e3 * self.p99:.1f} and {1e3 * self.worst:.1f} ms"

    @classmethod
    def of(cls, nanoseconds: Sequence[int]) -> "Lateness":
        """Return the lateness of timers, given that of each one, ns."""
        late = [time / SECOND for time in sorted(nanoseconds)] or [0.0]
        last = len(late) - 1
        return cls(len(nanoseconds), late[last // 2], late[round(0.99 * last)], late[last])


class WallClock:
    """Lets a clock of SimPy follow the wall clock.

    An event happens at the time for which it was planned, by the clock, and a little later by the wall clock. Between
    two events the clock stands at the last one; `advance` lets it catch up, so that what arrives from outside arrives
    at the time of the wall clock.

    Args:
        env: the clock, at time 0.
        over: the event after which the clock stops.
        now: returns the time of the wall clock, ns; None: the time since now, by the monotonic clock.

    Attributes:
        lateness: how late each timer was, ns.
    """

    def __init__(self, env: Clock, over: "simpy.Event", now: Callable[[], int] | None = None):
        begin = monotonic_ns()
        self._env, self._over, self.now = env, over, now or (lambda: monotonic_ns() - begin)
        self.lateness: list[int] = []
        self._woken = asyncio.Event()

    def advance(self) -> None:
        """Let all events happen that are due, and let the clock show the present time."""
        env, over = self._env, self._over
        while not over.processed and (due := env.peek()) <= (now := self.now()):
            if len(self.lateness) < MAX_KEPT and due > env.now:
                self.lateness.append(int(now - due))
            env.advance(int(due), over)
        env.advance(self.now(), over)

    def wake(self) -> None:
        """End the wait of `follow`, because something was planned or the clock is to stop."""
        self._woken.set()

    async def follow(self, take: Callable[[], bool], caught_up: Callable[[], object] = lambda: None) -> None:
        """Follow the wall clock until the clock stops.

        Args:
            take: called when the clock has caught up; takes what has arrived from outside, and returns whether there
                was anything.
            caught_up: called after that, before the clock waits.

        Raises:
            BaseException: what a process of the clock raises.
        """
        while True:
            self._woken.clear()
            self.advance()
            while not self._over.processed and take():
                self.advance()
            caught_up()
            if self._over.processed:
                return
            due = self._env.peek()
            wait = None if due == float("inf") else (due - self.now()) / SECOND
            if wait is not None and wait <= 0.0:
                await asyncio.sleep(0)
                continue
            try:
                async with asyncio.timeout(wait):
                    await self._woken.wait()
            except TimeoutError:
                pass

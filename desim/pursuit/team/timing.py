"""The events for which the protocol of a pursuer waits: times on its local clock, and arriving messages."""

from collections.abc import Callable

import simpy

from desim.config.python_numbers import real
from desim.kernel.core.clock import Clock, Instant, NodeClock, Phase
from desim.kernel.network import Network

RETURN_HINT = " (a protocol that has nothing left to wait for should return)"
"""Hint in error messages about an infinite, nan or negative waiting time."""


class Timing:
    """Creates the events for which one pursuer waits; see `desim.pursuit.team.agent.Agent`.

    A protocol waits by yielding an event that `at`, `sleep`, `arrival` or `after_decisions` returns. No method waits
    when it is called. Simultaneous events are ordered by phase, and events of one phase by pursuer id.

    Attributes:
        id: its id.
        restarts: number of restarts without memory after a crash.

    Args:
        pursuer: its id.
        env: the clock of the simulation.
        clock: its local clock.
        network: the network that delivers its messages.
    """

    def __init__(self, pursuer: int, env: Clock, clock: NodeClock, network: Network):
        self.id = pursuer
        self.restarts = 0
        self._env, self._clock, self._network = env, clock, network

    def at(self, time: float, phase: Phase = Phase.DECISION) -> simpy.Event:
        """Return an event at a time (s) on the local clock, rounded to nanoseconds; a time in the past counts as now.

        Raises:
            ValueError: if the time is infinite, nan or not a number.
        """
        if type(time) is not float:
            time = real(time, f"pursuer {self.id}: at: the time")
        try:
            return Instant(self._env, max(self._clock.when(time), self._env.now), phase + self.id)
        except (OverflowError, ValueError) as error:
            raise ValueError(f"pursuer {self.id}: at({time}): the time should be finite, s{RETURN_HINT}") from error

    def sleep(self, duration: float, phase: Phase = Phase.DECISION) -> simpy.Event:
        """Return an event that happens after a duration (s) on the local clock.

        Raises:
            ValueError: if the duration is negative, infinite, nan or not a number.
        """
        if type(duration) is not float:
            duration = real(duration, f"pursuer {self.id}: sleep: the duration")
        try:
            return Instant(self._env, self._env.now + self._clock.span(duration), phase + self.id)
        except (OverflowError, ValueError) as error:
            text = f"pursuer {self.id}: sleep({duration}): the duration should be finite and at least 0 s{RETURN_HINT}"
            raise ValueError(text) from error

    def after(self, duration: float, act: Callable[[], object], phase: Phase = Phase.DECISION) -> None:
        """Call a function after a duration (s) on the local clock, unless the pursuer restarts without memory before.

        Raises:
            ValueError: if the duration is negative, infinite, nan or not a number.
        """
        restarts_before = self.restarts

        def happen(_: simpy.Event) -> None:
            if self.restarts == restarts_before:
                act()

        self.sleep(duration, phase).callbacks.append(happen)

    def after_decisions(self) -> simpy.Event:
        """Return an event that happens at the present instant, after all decisions of this instant."""
        return self.sleep(0.0, Phase.HEARTBEAT)

    def arrival(self, port: str = "", phase: Phase = Phase.DECISION) -> simpy.Event:
        """Return an event that happens as soon as the inbox of a port is not empty.

        `Agent.mail` returns the messages.
        """
        return self._network.inbox(self.id, port).arrival(phase + self.id)

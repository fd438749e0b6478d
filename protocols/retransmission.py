"""Patience: how long schedules wait for an answer before they ask again.

The first time-out is 5/4 of a round trip without queues. Each later one allows messages to be on the air for 3/2 as
long as the one before, for the channel may be busy.
"""

from collections.abc import Generator
from typing import Any

from desim.pursuit.agent import Agent

BACKOFF = 1.5
"""How much longer messages are expected to be on the air at each time-out than at the one before."""
MAX_GROWTH = 100
"""How often it grows at most."""
Waiting = Generator[Any, Any, bool]
"""A part of a process that finds out whether something is so."""


class RetransmissionTimer:
    """How long one pursuer waits for answers: `time_out(attempt)`.

    Args:
        me: who asks.
        on_air: how long the channel is busy with a question, its answer and what may wait in front of them, s.
        floor: the least time-out, s.
    """

    def __init__(self, me: Agent, on_air: float, floor: float):
        self._on_air = 1.25 * on_air
        self._first = max(2.5 * me.latency + self._on_air, floor)

    def __call__(self, attempt: int = 0) -> float:
        """Return how long an answer is awaited, s, after so many attempts in vain."""
        return self._first + self._on_air * (BACKOFF ** min(attempt, MAX_GROWTH) - 1.0)


def wait_for_mail(me: Agent, port: str, until: float) -> Waiting:
    """Wait for mail at a port, at most until a time on the own clock, s; return whether that has come."""
    alarm = me.at(max(until, me.now))
    yield me.arrival(port) | alarm
    return bool(alarm.processed)

"""Retransmission time-outs with exponential back-off, for the schedules that exchange messages.

A round trip takes two latencies plus the sending times of the request, its answer and the messages that may be queued
in front of them. The sending time of a message is the time for which it keeps its sender from sending the next one: its
airtime, or more with a duty cycle or TDMA (`Agent.interval`). The first time-out is 5/4 of a round trip, so that an
answer may be late by a quarter, and at least `min_timeout`. In each later time-out the sending time counts 1.5 times as
much as in the one before, because the channel may be busy.
"""

from collections.abc import Generator
from typing import Any

from desim.kernel.core.clock import FirstOf
from desim.kernel.transport.sender import MAX_GROWTH, first_timeout
from desim.pursuit.team.agent import Agent

BACKOFF = 1.5
"""Factor by which the sending time in the time-out grows from one attempt to the next."""
Waiting = Generator[Any, Any, bool]
"""A part of a process that waits and returns true or false."""


class RetransmissionTimer:
    """The time-outs of one pursuer's requests; call the timer with the number of attempts without an answer so far.

    Args:
        me: the sender of the requests.
        sending_time: total sending time, s, of a request, its answer, and the messages that may be queued in front of
            them.
        min_timeout: the least time-out, s.
    """

    def __init__(self, me: Agent, sending_time: float, min_timeout: float):
        self._growing_part = 1.25 * sending_time  # the part of the first time-out that grows
        self._first = first_timeout(me.latency, sending_time, min_timeout)

    def __call__(self, attempt: int = 0) -> float:
        """Return the time-out, s, of a transmission after a number of attempts without an answer."""
        return self._first + self._growing_part * (BACKOFF ** min(attempt, MAX_GROWTH) - 1.0)


def arrival_or_timeout(me: Agent, port: str, until: float) -> Waiting:
    """Wait for a message at a port, at most until a time on the local clock, s; return whether that time is reached."""
    alarm = me.at(until)
    yield FirstOf(me.arrival(port), alarm)
    return bool(alarm.processed)

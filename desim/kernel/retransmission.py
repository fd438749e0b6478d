"""Retransmission time-outs: the time for which a sender waits for an answer before it repeats a message."""

MAX_GROWTH = 100
"""Number of attempts after which a time-out stops growing."""


def first_timeout(latency: float, airtime: float, min_timeout: float) -> float:
    """Return the time-out of a first attempt, s: 5/4 of a round trip, at least `min_timeout`.

    Args:
        latency: the one-way latency, s.
        airtime: total airtime, s, of the message, its answers, and the messages that may be queued in front of them.
        min_timeout: the least time-out, s.
    """
    return max(2.5 * latency + 1.25 * airtime, min_timeout)

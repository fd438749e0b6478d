"""Retransmission time-outs: the time for which a sender waits for an answer before it repeats a message."""

MAX_GROWTH = 100
"""Number of attempts after which a time-out stops growing."""


def first_timeout(latency: float, sending_time: float, min_timeout: float) -> float:
    """Return the time-out of a first attempt, s: 5/4 of a round trip, at least `min_timeout`.

    Args:
        latency: the one-way latency, s.
        sending_time: the time, s, for which the message, its answers, and the messages that may be queued in front of
            them keep their senders from sending.
        min_timeout: the least time-out, s.
    """
    return max(2.5 * latency + 1.25 * sending_time, min_timeout)

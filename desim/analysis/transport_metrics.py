"""Metrics of transports: the share of messages that were delivered, the attempts and the delay.

A broadcast counts as one message per receiver. If no message needed a transport (`has_transport`), all these metrics
raise ValueError.
"""

from math import nan

from desim.analysis.trace_index import transport
from desim.kernel.core.events import TransportCounts
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.units import seconds
from desim.simulation.run import Result


def has_transport(result: Result) -> bool:
    """Return whether some message needed a transport."""
    return transport(result) is not None


def _counts(result: Result) -> TransportCounts:
    """Return the counts of the transports; raise ValueError if no message needed one."""
    counts = transport(result)
    if counts is None:
        raise ValueError("no message needed a transport: see network.transport and announce.dissemination")
    return counts


def share_delivered(result: Result) -> float:
    """Return the share of the messages given to a transport that were delivered by the end, in [0, 1]; nan without any.

    Raises:
        ValueError: if no message needed a transport.
    """
    counts = _counts(result)
    return counts.delivered / counts.submitted if counts.submitted else nan


def mean_attempts(result: Result) -> float:
    """Return the mean number of transmissions of a message, or of its pieces, to each receiver; nan without messages.

    An attempt counts when it is handed to the transmitter, even if it then waits or is lost in a queue.

    Raises:
        ValueError: if no message needed a transport.
    """
    counts = _counts(result)
    return counts.attempts / counts.submitted if counts.submitted else nan


def delivery_delay(result: Result) -> float:
    """Return the mean time from the sending to the delivery of a message, s; nan if none was delivered."""
    counts = _counts(result)
    return seconds(counts.delay) / counts.delivered if counts.delivered else nan


def retransmissions(result: Result) -> int:
    """Return the number of repeated transmissions of messages."""
    return _counts(result).retransmissions


def acknowledgements(result: Result) -> int:
    """Return the number of acknowledgements that receivers sent, even if they waited or were lost in a queue."""
    return _counts(result).acknowledgements


def given_up(result: Result) -> int:
    """Return the number of messages that their senders gave up before a receiver acknowledged them."""
    return portable_sum(_counts(result).given_up.values())


def deadlines_missed(result: Result) -> int:
    """Return the number of deadlines that receivers missed."""
    return _counts(result).deadlines_missed


def liveliness_lost(result: Result) -> int:
    """Return the number of times that a node lost the liveliness of another."""
    return _counts(result).lives_lost

"""Reading a finished run: how it began and ended, and what is derived from it for several metrics, each thing once."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from desim.kernel.events import MESSAGES, MessageCounts
from desim.pursuit.events import Captured, Ended, Sampled, Started
from desim.simulation.run import Result

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]
Derived = TypeVar("Derived")
NO_POSITIONS = "positions were not recorded: set record.trajectory to a time greater than 0 s"
"""What is said of a run of which nobody knows where everyone was."""


@dataclass(frozen=True)
class TraceIndex(Result):
    """A result to whose trace nothing is added any more, with what has been derived from it."""

    derived: dict[Callable[[Result], Any], Any] = field(default_factory=dict, repr=False, compare=False)


def trace_index(result: Result) -> TraceIndex:
    """Return a result as one that remembers what is derived from it."""
    return TraceIndex(result.scenario, result.seed, result.trace)


def remembered(derive: Callable[[Result], Derived]) -> Callable[[Result], Derived]:
    """Let a function of a result be called once for each `TraceIndex`; what it returns must not be changed."""

    @wraps(derive)
    def once(result: Result) -> Derived:
        if not isinstance(result, TraceIndex):
            return derive(result)
        if derive not in result.derived:
            result.derived[derive] = derive(result)
        found: Derived = result.derived[derive]
        return found

    return once


@remembered
def started(result: Result) -> Started:
    """Return how the run began."""
    return result.trace.of(Started)[0]


@remembered
def ended(result: Result) -> Ended:
    """Return how the run ended."""
    return result.trace.of(Ended)[0]


@remembered
def captures(result: Result) -> list[Captured]:
    """Return when which evader was captured, and by whom, in order; where there is one, that is the end."""
    if has_several(result):
        return result.trace.of(Captured)
    end = ended(result)
    return [] if end.capturer is None else [Captured(end.t, 1, end.capturer)]


def has_several(result: Result) -> bool:
    """Return whether there were several evaders."""
    return len(started(result).evaders) > 1


@remembered
def positions_known(result: Result) -> bool:
    """Return whether it is on record where everyone was: positions were sampled, or nobody moved."""
    return result.scenario.motion.static or any(isinstance(event, Sampled) for event in result.trace)


@remembered
def samples(result: Result) -> list[Started | Sampled]:
    """Return all that is known of where everyone was: at the start and, unless nobody moved, at each sample."""
    return [started(result), *(() if result.scenario.motion.static else result.trace.of(Sampled))]


def sampled(result: Result) -> list[Sampled]:
    """Return the samples of positions.

    Raises:
        ValueError: if there are none.
    """
    found = result.trace.of(Sampled)
    if not found:
        raise ValueError(NO_POSITIONS)
    return found


@remembered
def messages_recorded(result: Result) -> bool:
    """Return whether the trace of a run has its messages."""
    return result.scenario.record.messages is True or any(isinstance(event, MESSAGES) for event in result.trace)


def lacks_messages(result: Result) -> bool:
    """Return whether messages were sent that the trace does not have."""
    return bool(messages(result).sent) and not messages_recorded(result)


def require_messages(result: Result) -> None:
    """Refuse a run whose messages are to be read, and cannot be.

    Raises:
        ValueError: if messages were sent and not recorded.
    """
    if lacks_messages(result):
        raise ValueError("messages were sent and not recorded: set record.messages = true")


@remembered
def messages(result: Result) -> MessageCounts:
    """Return how many messages there were, each receiver of a broadcast counted as one."""
    return result.trace.of(MessageCounts)[0]

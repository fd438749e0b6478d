"""Reading a finished run: how it began and ended, and what is derived from it for several metrics, each thing once."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, TypeVar

from desim.kernel.events import Tally
from desim.pursuit.events import Captured, Ended, Started
from desim.simulation import Result

Derived = TypeVar("Derived")


@dataclass(frozen=True)
class Reading(Result):
    """A result to whose trace nothing is added any more, with what has been derived from it."""

    derived: dict[Callable[[Result], Any], Any] = field(default_factory=dict, repr=False, compare=False)


def reading(result: Result) -> Reading:
    """Return a result as one that remembers what is derived from it."""
    return Reading(result.scenario, result.seed, result.trace)


def remembered(derive: Callable[[Result], Derived]) -> Callable[[Result], Derived]:
    """Let a function of a result be called once for each `Reading`; what it returns must not be changed."""

    @wraps(derive)
    def once(result: Result) -> Derived:
        if not isinstance(result, Reading):
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
def messages(result: Result) -> Tally:
    """Return how many messages there were, each receiver of a broadcast counted as one."""
    return result.trace.of(Tally)[0]

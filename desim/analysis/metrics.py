"""Metrics: functions from the result of a run to a number, computed from its trace alone.

n(t) is the number of active pursuers; integrals run from 0 to the end of the run.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desim.kernel.clock import SECOND, seconds
from desim.kernel.events import Tally
from desim.pursuit.events import Decided, Ended, Started
from desim.simulation import Result


@dataclass(frozen=True, slots=True)
class Summary:
    """The numbers of one run that a table shows; times in s."""

    seed: int
    captured: bool
    capture_time: float | None
    """None if the evader was not captured."""
    capturer: int | None
    end_time: float
    active_time: float
    idle_time: float
    crowded_time: float
    excess_time: float
    decisions: int
    switches: int
    messages_sent: int
    messages_delivered: int
    messages_lost: int
    messages_in_flight: int


def summary(result: Result) -> Summary:
    """Return the numbers of one run."""
    end, tally = ending(result), messages(result)
    captured = end.reason == "captured"
    return Summary(
        seed=result.seed,
        captured=captured,
        capture_time=seconds(end.t) if captured else None,
        capturer=end.capturer,
        end_time=seconds(end.t),
        active_time=active_time(result),
        idle_time=idle_time(result),
        crowded_time=crowded_time(result),
        excess_time=excess_time(result),
        decisions=len(result.trace.of(Decided)),
        switches=switches(result),
        messages_sent=tally.sent,
        messages_delivered=tally.delivered,
        messages_lost=tally.lost,
        messages_in_flight=tally.in_flight,
    )


def ending(result: Result) -> Ended:
    """Return how the run ended."""
    return result.trace.of(Ended)[0]


def messages(result: Result) -> Tally:
    """Return how many messages there were, each receiver of a broadcast counted as one."""
    return result.trace.of(Tally)[0]


def activity(result: Result) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return n(t) as a step function: n is counts[k] for durations[k] seconds, in order of time."""
    active = list(result.trace.of(Started)[0].active)
    times, counts = [0], [sum(active)]
    for change in changes(result):
        times.append(change.t)
        counts.append(counts[-1] + (1 if change.active else -1))
    times.append(ending(result).t)
    return np.diff(times) / SECOND, np.array(counts)


def changes(result: Result) -> list[Decided]:
    """Return the decisions by which a pursuer's action changed."""
    active = list(result.trace.of(Started)[0].active)
    changed = []
    for decision in result.trace.of(Decided):
        if decision.active != active[decision.pursuer]:
            active[decision.pursuer] = decision.active
            changed.append(decision)
    return changed


def active_time(result: Result) -> float:
    """Return the sum of the pursuers' active times, int n dt (Lee & Bakolas, Table I), s."""
    durations, counts = activity(result)
    return float(durations @ counts)


def idle_time(result: Result) -> float:
    """Return how long nobody was active, int 1{n = 0} dt, s."""
    durations, counts = activity(result)
    return float(durations[counts == 0].sum())


def crowded_time(result: Result) -> float:
    """Return how long more than one pursuer was active, int 1{n > 1} dt, s."""
    durations, counts = activity(result)
    return float(durations[counts > 1].sum())


def excess_time(result: Result) -> float:
    """Return the active time in excess of one pursuer, int (n - 1)+ dt, s."""
    durations, counts = activity(result)
    return float(durations @ np.maximum(counts - 1, 0))


def switches(result: Result) -> int:
    """Return how often a pursuer changed its action."""
    return len(changes(result))

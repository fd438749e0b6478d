"""Metrics: functions from the result of a run to a number, computed from its trace alone.

n(t) is the number of active pursuers; integrals run from 0 to the end of the run.
"""

from dataclasses import dataclass
from math import isnan

import numpy as np
from numpy.typing import NDArray

from desim.analysis.knowledge import ended, knowledge
from desim.analysis.word import ages, belief_error, over_pairs
from desim.kernel.clock import SECOND, seconds
from desim.kernel.events import Cause, Tally
from desim.pursuit.events import Decided, Halted, Started
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
    messages_lost_by: dict[Cause, int]
    transmissions: int
    """How many times something was put on the air, whatever the number of receivers."""
    bytes_sent: int
    """Put on the air."""
    utilisation: float
    """Share of the time in which the channels were busy, in [0, 1]."""
    age_mean: float | None
    """Age of information, averaged over time and pairs; None, like the rest, if not measured."""
    age_peak: float | None
    """Just before something newer came."""
    age_at_decision: float | None
    belief_error: float | None
    """Share of pairs of which one has last heard what the other is not doing, in [0, 1]."""


def summary(result: Result) -> Summary:
    """Return the numbers of one run."""
    end, tally = ended(result), messages(result)
    captured = end.reason == "captured"
    age_mean, age_peak, age_at_decision, error = _word(result)
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
        messages_lost_by=tally.lost_by,
        transmissions=tally.transmissions,
        bytes_sent=tally.bytes_sent,
        utilisation=tally.utilisation,
        age_mean=age_mean,
        age_peak=age_peak,
        age_at_decision=age_at_decision,
        belief_error=error,
    )


def _word(result: Result) -> tuple[float | None, ...]:
    """Return the three ages of information and the belief error, as far as there is something to measure."""
    if not result.scenario.record.messages:
        return None, None, None, None
    known = knowledge(result)
    age = ages(result, known)
    pairs = (over_pairs(each) for each in (age.mean, age.peak, age.at_decision))
    return tuple(None if isnan(each) else each for each in (*pairs, belief_error(result, known)))


def messages(result: Result) -> Tally:
    """Return how many messages there were, each receiver of a broadcast counted as one."""
    return result.trace.of(Tally)[0]


def activity(result: Result) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return n(t) as a step function: n is counts[k] for durations[k] seconds, in order of time."""
    active = list(result.trace.of(Started)[0].active)
    times, counts = [0], [sum(active)]
    for change in changes(result):
        times.append(change.t)
        counts.append(counts[-1] + (1 if _chases(change) else -1))
    times.append(ended(result).t)
    return np.diff(times) / SECOND, np.array(counts)


def changes(result: Result) -> list[Decided | Halted]:
    """Return the decisions, and the breakdowns, by which a pursuer's action changed."""
    active = list(result.trace.of(Started)[0].active)
    changed = []
    for event in result.trace:
        if isinstance(event, Decided | Halted) and _chases(event) != active[event.pursuer]:
            active[event.pursuer] = _chases(event)
            changed.append(event)
    return changed


def _chases(event: Decided | Halted) -> bool:
    """Return whether a pursuer is active from then on."""
    return isinstance(event, Decided) and event.active


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
    """Return how often a pursuer changed its action by a decision."""
    return sum(isinstance(change, Decided) for change in changes(result))

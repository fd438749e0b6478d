"""What the pursuers knew of each other: the age of their information, and how often it was wrong.

The age of information of a reader about a source is the time since the newest record that has reached the reader was
announced: a sawtooth (Kaul, Yates & Gruteser 2012, "Real-Time Status: How Often Should One Update?"). The instants at
which it falls, and what was heard then, are those of `desim.analysis.knowledge`.

All this needs the messages of a run: `record.messages = true`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import nan

import numpy as np
from numpy.typing import NDArray

from desim.analysis.activity import chases
from desim.analysis.knowledge import Integers, Pieces, knowledge
from desim.analysis.reading import ended, remembered, started
from desim.kernel.clock import SECOND
from desim.pursuit.events import Decided, Halted
from desim.simulation import Result

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ages:
    """Ages of information, (N, N) s: row = reader, column = source; nan where there is none to measure."""

    mean: Floats
    """Averaged over time, from the first reception on."""
    peak: Floats
    """Averaged over the instants just before something newer came."""
    at_decision: Floats
    """Averaged over the decisions of the reader, from the first reception on."""


@remembered
def ages(result: Result) -> Ages:
    """Return how old what each pursuer had heard of each other was.

    A pair does not count before its first reception, nor while its reader has forgotten all.

    Raises:
        ValueError: if messages were sent and not recorded.
    """
    known = knowledge(result)
    heard, size = known[~known["presumed"]], len(started(result).active)
    pair, created = heard["reader"] * size + heard["source"], heard["created"]

    def averaged(total: Floats, weight: NDArray[np.generic]) -> Floats:
        """Return total over weight of each pair."""
        totals, weights = (np.bincount(pair, each, minlength=size * size) for each in (total, weight))
        averages: Floats = np.divide(totals, weights, out=np.full(size * size, nan), where=weights > 0)
        return averages.reshape(size, size)

    duration = (heard["until"] - heard["begin"]) / SECOND
    middle = (heard["begin"] + heard["until"] - 2 * created) / (2 * SECOND)
    last = (heard["until"] - created) / SECOND * heard["superseded"]
    total, count = _at_decisions(result, heard)
    return Ages(averaged(duration * middle, duration), averaged(last, heard["superseded"]), averaged(total, count))


def over_pairs(age: Floats) -> float:
    """Return the mean over the pairs for which there is something to measure, nan if there are none."""
    measured = age[~np.isnan(age)]
    return float(measured.mean()) if measured.size else nan


def age_mean(result: Result) -> float:
    """Return the age of information, averaged over time and then over pairs, s."""
    return over_pairs(ages(result).mean)


def age_peak(result: Result) -> float:
    """Return the age of information just before something newer came, averaged over updates, then over pairs, s."""
    return over_pairs(ages(result).peak)


def age_at_decision(result: Result) -> float:
    """Return the age of information at the decisions of its reader, averaged over these and then over pairs, s."""
    return over_pairs(ages(result).at_decision)


def belief_error(result: Result) -> float:
    """Return the share of ordered pairs of pursuers of which one has last heard what the other is not doing.

    It is averaged over time, in [0, 1]; nan if there are no pairs or no time passed. At first everyone knows who is
    active or, after a cold start, takes nobody for active. Whether silence is taken for inactivity
    (`announce.forget_after`) plays no part: this is about word, and not what is made of it.

    Raises:
        ValueError: if messages were sent and not recorded.
    """
    wrong, size, end = 0, len(started(result).active), ended(result).t
    for active_by, about in zip(_active_times(result), _split(knowledge(result), "source", size), strict=True):
        active = active_by(about["until"]) - active_by(about["begin"])
        inactive = about["until"] - about["begin"] - active
        wrong += int(np.where(about["active"], inactive, active).sum())
    return wrong / (size * (size - 1) * end) if size > 1 and end else nan


def believed_leaders(result: Result) -> float:
    """Return how many pursuers are active and have last heard of all others that they are not, averaged over time.

    nan if no time passed; see `belief_error` for what is believed at first.

    Raises:
        ValueError: if messages were sent and not recorded.
    """
    alone, size, end = 0, len(started(result).active), ended(result).t
    for active_by, others in zip(_active_times(result), _split(knowledge(result), "reader", size), strict=True):
        others = others[others["active"]]
        times = np.concatenate([[0], others["begin"], others["until"], [end]])
        changes = np.repeat([0, 1, -1, 0], [1, len(others), len(others), 1])
        order = np.argsort(times, kind="stable")
        nobody = np.cumsum(changes[order])[:-1] == 0
        alone += int(np.diff(active_by(times[order]))[nobody].sum())
    return alone / end if end else nan


def _split(known: Pieces, role: str, size: int) -> Iterator[Pieces]:
    """Yield the pieces of each reader, or about each source, in order of these."""
    ordered = known[np.argsort(known[role], kind="stable")]
    edges = np.searchsorted(ordered[role], np.arange(size + 1))
    yield from (ordered[first:last] for first, last in pairwise(edges))


@dataclass(frozen=True, slots=True)
class _ActiveTime:
    """How long a pursuer had been active by a time: `active_by(t)`, (k,) ns of (k,) ns."""

    changed: Integers
    total: Integers
    active: NDArray[np.bool_]

    def __call__(self, t: Integers) -> Integers:
        k = np.searchsorted(self.changed, t, side="right") - 1
        return self.total[k] + self.active[k] * (t - self.changed[k])


def _active_times(result: Result) -> Iterator[_ActiveTime]:
    """Yield for each pursuer how long it had been active by a time."""
    actions = [[(0, active)] for active in started(result).active]
    for event in result.trace:
        if isinstance(event, Decided | Halted):
            actions[event.pursuer].append((event.t, chases(event)))
    for own in actions:
        changed, active = np.array([t for t, _ in own]), np.array([action for _, action in own])
        yield _ActiveTime(changed, np.append(0, np.cumsum(np.diff(changed) * active[:-1])), active)


def _at_decisions(result: Result, heard: Pieces) -> tuple[Floats, Integers]:
    """Return for each piece the sum of its ages at the decisions that its reader took by it, s, and their number."""
    decisions: list[list[tuple[int, int]]] = [[] for _ in started(result).active]
    for place, event in enumerate(result.trace):
        if isinstance(event, Decided):
            decisions[event.pursuer].append((event.t, place))
    total, count = np.zeros(len(heard)), np.zeros(len(heard), np.int64)
    edges = np.searchsorted(heard["reader"], np.arange(len(decisions) + 1))
    for own, first, last in zip(decisions, edges[:-1], edges[1:], strict=True):
        times, places = np.array(own, np.int64).reshape(-1, 2).T
        mine = heard[first:last]
        since = _earlier(times, places, mine["begin"], mine["after"])
        until = _earlier(times, places, mine["until"], mine["before"])
        sums = np.append(0, np.cumsum(times))
        count[first:last] = until - since
        total[first:last] = (sums[until] - sums[since] - (until - since) * mine["created"]) / SECOND
    return total, count


def _earlier(times: Integers, places: Integers, t: Integers, place: Integers) -> Integers:
    """Return how many events come before a time or, among those of the same time, before a place in the trace."""
    low, high = (np.searchsorted(times, t, side=side) for side in ("left", "right"))
    return np.clip(np.searchsorted(places, place), low, high)

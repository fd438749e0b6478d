"""What the pursuers knew of each other: the age of their information, and how often it was wrong.

Of each other pursuer, a reader knows the newest record that has reached it: from the source itself or through others,
whatever the order in which records came. The age of information at t is t minus when that record was announced (Kaul,
Yates & Gruteser, INFOCOM 2012, "Real-time status: how often should one update?").

All functions need the messages of a run: `record.messages = true`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from desim.kernel.clock import SECOND
from desim.kernel.events import LOST, Broadcast, Lost, Queued, Sent, Tally
from desim.kernel.faults import Crash, Over
from desim.kernel.records import Record
from desim.pursuit.events import Decided, Ended, Started
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


def ages(result: Result, pieces: Pieces | None = None) -> Ages:
    """Return how old what each pursuer knew of each other was.

    A pair does not count before the first reception, nor from when its reader forgot all until the next one.

    Args:
        result: of a run whose messages were recorded.
        pieces: what `known` returns for it, if it is there already.

    Raises:
        ValueError: if messages were not recorded.
    """
    pieces = known(result) if pieces is None else pieces
    heard = pieces[~pieces["presumed"]]
    size = len(_start(result).active)
    pair, created = heard["reader"] * size + heard["source"], heard["created"]

    def mean(total: Floats, weight: NDArray[np.generic]) -> Floats:
        """Return total over weight of each pair."""
        sums, weights = (np.bincount(pair, each, minlength=size * size) for each in (total, weight))
        mean = np.full(size * size, np.nan)
        return np.divide(sums, weights, out=mean, where=weights > 0).reshape(size, size)

    duration = (heard["until"] - heard["begin"]) / SECOND
    middle = (heard["begin"] - created + heard["until"] - created) / (2 * SECOND)
    last = np.where(heard["superseded"], heard["until"] - created, 0) / SECOND
    total, count = _at_decisions(result, heard)
    return Ages(mean(duration * middle, duration), mean(last, heard["superseded"]), mean(total, count))


def over_pairs(pairs: Floats) -> float:
    """Return the mean over the pairs that have a value, nan if none has."""
    return float(np.mean(pairs[~np.isnan(pairs)])) if not np.isnan(pairs).all() else float("nan")


def belief_error(result: Result, pieces: Pieces | None = None) -> float:
    """Return the share of ordered pairs of pursuers of which one's newest word of the other's action is wrong.

    It is averaged over time, in [0, 1], and nan if there are no pairs or no time passed. At first everyone knows who
    is active, or, after a cold start, believes that nobody is. That silence may be taken for inactivity
    (`announce.forget_after`) is not considered: this is about word, and not what is made of it.

    Args:
        result: of a run whose messages were recorded.
        pieces: what `known` returns for it, if it is there already.

    Raises:
        ValueError: if messages were not recorded.
    """
    pieces = known(result) if pieces is None else pieces
    wrong, end = 0, _end(result)
    for source, active_time in enumerate(_active_times(result)):
        about = pieces[pieces["source"] == source]
        active = active_time(about["until"]) - active_time(about["begin"])
        inactive = about["until"] - about["begin"] - active
        wrong += int(np.where(about["active"], inactive, active).sum())
    size = len(_start(result).active)
    return wrong / (size * (size - 1) * end) if size > 1 and end else float("nan")


def believed_leaders(result: Result, pieces: Pieces | None = None) -> float:
    """Return how many pursuers are active and have heard of nobody else who is, averaged over time; nan without time.

    Args:
        result: of a run whose messages were recorded.
        pieces: what `known` returns for it, if it is there already.

    Raises:
        ValueError: if messages were not recorded.
    """
    pieces = known(result) if pieces is None else pieces
    alone, end = 0, _end(result)
    for reader, active_time in enumerate(_active_times(result)):
        others = pieces[(pieces["reader"] == reader) & pieces["active"]]
        times = np.concatenate([[0], others["begin"], others["until"], [end]])
        changes = np.repeat([0, 1, -1, 0], [1, len(others), len(others), 1])
        order = np.argsort(times, kind="stable")
        nobody = np.cumsum(changes[order])[:-1] == 0
        alone += int(np.diff(active_time(times[order]))[nobody].sum())
    return alone / end if end else float("nan")


# What was done when.


@dataclass(frozen=True, slots=True)
class _ActiveTime:
    """How long a pursuer had been active by a time: `active_time(t)`, (k,) ns of (k,) ns."""

    changed: Integers
    total: Integers
    active: NDArray[np.bool_]

    def __call__(self, t: Integers) -> Integers:
        k = np.searchsorted(self.changed, t, side="right") - 1
        return self.total[k] + self.active[k] * (t - self.changed[k])


def _active_times(result: Result) -> Iterator[_ActiveTime]:
    """Yield of each pursuer how long it had been active by a time."""
    orders = [[(0, active)] for active in _start(result).active]
    for decision in result.trace.of(Decided):
        orders[decision.pursuer].append((decision.t, decision.active))
    for own in orders:
        changed, active = np.array([t for t, _ in own]), np.array([active for _, active in own])
        total = np.concatenate([[0], np.cumsum(np.diff(changed) * active[:-1])])
        yield _ActiveTime(changed, total, active)


def _at_decisions(result: Result, heard: Pieces) -> tuple[Floats, Integers]:
    """Return of each piece the sum of its ages at the decisions that its reader based on it, s, and their number."""
    decisions: list[list[tuple[int, int]]] = [[] for _ in _start(result).active]
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
        sums = np.concatenate([[0], np.cumsum(times)])
        count[first:last] = until - since
        total[first:last] = (sums[until] - sums[since] - (until - since) * mine["created"]) / SECOND
    return total, count


def _earlier(times: Integers, places: Integers, t: Integers, place: Integers) -> Integers:
    """Return how many events come before a time or, among those of the same time, before a place in the trace."""
    low, high = (np.searchsorted(times, t, side=side) for side in ("left", "right"))
    return np.clip(np.searchsorted(places, place), low, high)


def _start(result: Result) -> Started:
    return result.trace.of(Started)[0]


def _end(result: Result) -> int:
    return result.trace.of(Ended)[0].t

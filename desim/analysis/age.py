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

from desim.analysis.activity import action, changes
from desim.analysis.knowledge import Pieces, knowledge
from desim.analysis.trace_index import Floats, Integers, ended, remembered, started
from desim.kernel.clock import SECOND
from desim.pursuit.events import Decided
from desim.simulation.run import Result


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

    It is averaged over time, in [0, 1]; nan if there are no pairs or no time passed. At first everyone knows what all
    do or, after a cold start, takes nobody for active. Whether silence is taken for inactivity
    (`announce.belief_timeout`) plays no part: this is about word, and not what is made of it. So it is with several
    evaders, where word of another evader than the one that is chased is wrong, as is word of one captured since.

    Raises:
        ValueError: if messages were sent and not recorded.
    """
    wrong, size, end = 0, len(started(result).active), ended(result).t
    for doing, about in zip(_doings(result), _split(knowledge(result), "source", size), strict=True):
        right = doing.time(about["active"], about["until"]) - doing.time(about["active"], about["begin"])
        wrong += int((about["until"] - about["begin"] - right).sum())
    return wrong / (size * (size - 1) * end) if size > 1 and end else nan


def believed_leaders(result: Result) -> float:
    """Return how many pursuers are active and have last heard of all others that they are not, averaged over time.

    With several evaders: that they do not chase the same one. nan if no time passed; see `belief_error` for what is
    believed at first.

    Raises:
        ValueError: if messages were sent and not recorded.
    """
    alone, size, end = 0, len(started(result).active), ended(result).t
    for doing, heard in zip(_doings(result), _split(knowledge(result), "reader", size), strict=True):
        for evader in set(doing.did.tolist()) - {0}:
            others = heard[heard["active"] == evader]
            times = np.concatenate([[0], others["begin"], others["until"], [end]])
            steps = np.repeat([0, 1, -1, 0], [1, len(others), len(others), 1])
            order = np.argsort(times, kind="stable")
            nobody = np.cumsum(steps[order])[:-1] == 0
            alone += int(np.diff(doing.time(evader, times[order]))[nobody].sum())
    return alone / end if end else nan


def _split(known: Pieces, role: str, size: int) -> Iterator[Pieces]:
    """Yield the pieces of each reader, or about each source, in order of these."""
    ordered = known[np.argsort(known[role], kind="stable")]
    edges = np.searchsorted(ordered[role], np.arange(size + 1))
    yield from (ordered[first:last] for first, last in pairwise(edges))


@dataclass(frozen=True, slots=True)
class _TrueActions:
    """What a pursuer did, and how long in all."""

    began: Integers
    """(k,) when its actions began, ns; the first at 0."""
    did: Integers
    """(k,) which they were: the number of an evader, or 0."""
    total: Integers
    """(M + 1, k) how long it had done each action by then, ns."""

    def time(self, action: int | Integers, t: Integers) -> Integers:
        """Return how long it had done an action, one or (n,), by (n,) times, ns."""
        k = np.searchsorted(self.began, t, side="right") - 1
        found: Integers = self.total[action, k] + (self.did[k] == action) * (t - self.began[k])
        return found


def _doings(result: Result) -> Iterator[_TrueActions]:
    """Yield what each pursuer did."""
    actions = [[(0, active)] for active in started(result).active]
    for change in changes(result):
        actions[change.pursuer].append((change.t, action(change)))
    options = np.arange(len(started(result).evaders) + 1)[:, None]
    for own in actions:
        began, did = np.array(own, np.int64).T
        spent = np.cumsum(np.diff(began) * (did[:-1] == options), axis=1)
        yield _TrueActions(began, did, np.pad(spent, ((0, 0), (1, 0))))


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

"""Age of information and errors of beliefs.

The age of information of a reader about a source is the time since the source announced the newest record that the
reader has received (Kaul, Yates & Gruteser 2012, "Real-Time Status: How Often Should One Update?"). The age grows at
rate 1 and drops at each reception of a newer record, so it is a sawtooth. `desim.analysis.knowledge` defines records,
sources and readers. A piece is a period in which a reader has the same newest record of a source.

These metrics need the messages of a run: `record.messages = true`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import nan

import numpy as np
from numpy.typing import NDArray

from desim.analysis.activity import action, changes
from desim.analysis.knowledge import Pieces, knowledge
from desim.analysis.trace_index import ended, remembered, started
from desim.config.arrays import Floats, Integers
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Decided
from desim.simulation.run import Result


@dataclass(frozen=True, slots=True)
class Ages:
    """Ages of information, (N, N) s: row = reader, column = source; nan for a pair without a measurement."""

    mean: Floats
    """Averaged over time, from the first reception on."""
    peak: Floats
    """Averaged over the instants just before a newer record arrived."""
    at_decision: Floats
    """Averaged over the decisions of the reader, from the first reception on."""


@remembered
def ages(result: Result) -> Ages:
    """Return the ages of information of all pairs of a reader and a source.

    A pair counts from its first reception on. After a reader has lost its memory, its pairs count again from their next
    reception on.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    all_pieces = knowledge(result)
    pieces, size = all_pieces[~all_pieces["presumed"]], len(started(result).active)
    pair, created = pieces["reader"] * size + pieces["source"], pieces["created"]

    def averaged(total: Floats, weight: NDArray[np.generic]) -> Floats:
        """Return the sum of `total` over the sum of `weight` for each pair, (N, N); nan if the weights sum to 0."""
        totals, weights = (np.bincount(pair, values, minlength=size * size) for values in (total, weight))
        averages: Floats = np.divide(totals, weights, out=np.full(size * size, nan), where=weights > 0)
        return averages.reshape(size, size)

    duration = (pieces["until"] - pieces["begin"]) / SECOND
    middle = (pieces["begin"] + pieces["until"] - 2 * created) / (2 * SECOND)
    last = (pieces["until"] - created) / SECOND * pieces["superseded"]
    total, count = _at_decisions(result, pieces)
    return Ages(averaged(duration * middle, duration), averaged(last, pieces["superseded"]), averaged(total, count))


def over_pairs(age: Floats) -> float:
    """Return the mean over the pairs with a measurement, or nan without any."""
    measured = age[~np.isnan(age)]
    return float(measured.mean()) if measured.size else nan


def age_mean(result: Result) -> float:
    """Return the age of information, s, averaged over time and then over pairs; nan without a measurement.

    Pairs of which the reader never heard the source are left out. Where much is lost, the mean is
    therefore too small: such pairs have the greatest ages.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    return over_pairs(ages(result).mean)


def age_peak(result: Result) -> float:
    """Return the age of information, s, just before a newer record arrived, averaged over arrivals and then over pairs.

    The result is nan without a measurement.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    return over_pairs(ages(result).peak)


def age_at_decision(result: Result) -> float:
    """Return the age of information, s, at the decisions of the reader, averaged over decisions and then over pairs.

    The result is nan without a measurement.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    return over_pairs(ages(result).at_decision)


def belief_error(result: Result) -> float:
    """Return the share of ordered pairs in which the source's action differs from that in the reader's newest record.

    The share, in [0, 1], is averaged over time; it is nan if there are no pairs or no time passed. Until its first
    record of a source arrives, a reader takes the source for inactive, unless all know the initial actions
    (`announce.start`); so it does after a loss of memory. The time-out of beliefs (`announce.belief_timeout`) has no
    effect, because this metric compares records only. With several evaders, a record is also wrong if it names an
    evader that the source does not chase, such as an evader captured since. Pursuers that only relay (`team.relay`) are
    neither readers nor sources: they never act, so all records of them are right, and their beliefs decide nothing.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    wrong, size, end = 0, len(started(result).active), ended(result).t
    relays = list(result.scenario.team.relays)
    acting, pieces = size - len(relays), knowledge(result)
    pieces = pieces[~np.isin(pieces["reader"], relays) & ~np.isin(pieces["source"], relays)]
    for actual, about in zip(_true_actions(result), _split(pieces, "source", size), strict=True):
        right = actual.time(about["active"], about["until"]) - actual.time(about["active"], about["begin"])
        wrong += int((about["until"] - about["begin"] - right).sum())
    return wrong / (acting * (acting - 1) * end) if acting > 1 and end else nan


def believed_leaders(result: Result) -> float:
    """Return the number of active pursuers whose newest records show no other active pursuer, averaged over time.

    With several evaders, a pursuer counts if its records show no other pursuer of the evader that it chases. The result
    is nan if no time passed. For the beliefs at the start see `belief_error`.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    alone, size, end = 0, len(started(result).active), ended(result).t
    for actual, pieces in zip(_true_actions(result), _split(knowledge(result), "reader", size), strict=True):
        for evader in set(actual.did.tolist()) - {0}:
            on_target = pieces[pieces["active"] == evader]
            times = np.concatenate([[0], on_target["begin"], on_target["until"], [end]])
            steps = np.repeat([0, 1, -1, 0], [1, len(on_target), len(on_target), 1])
            order = np.argsort(times, kind="stable")
            no_other = np.cumsum(steps[order])[:-1] == 0
            alone += int(np.diff(actual.time(evader, times[order]))[no_other].sum())
    return alone / end if end else nan


def _split(pieces: Pieces, role: str, size: int) -> Iterator[Pieces]:
    """Yield the pieces of each reader, or of each source, in order of id."""
    ordered = pieces[np.argsort(pieces[role], kind="stable")]
    edges = np.searchsorted(ordered[role], np.arange(size + 1))
    yield from (ordered[first:last] for first, last in pairwise(edges))


@dataclass(frozen=True, slots=True)
class _TrueActions:
    """The successive actions of one pursuer, and the cumulative time of each action."""

    began: Integers
    """(k,) start times of the actions, ns; the first is 0."""
    did: Integers
    """(k,) the actions: the number of an evader, or 0."""
    total: Integers
    """(M + 1, k) cumulative time of each action at the start times, ns, for M evaders."""

    def time(self, action: int | Integers, t: Integers) -> Integers:
        """Return the cumulative time, ns, of one action, or of each of (n,) actions, at each of (n,) times, ns."""
        k = np.searchsorted(self.began, t, side="right") - 1
        total: Integers = self.total[action, k] + (self.did[k] == action) * (t - self.began[k])
        return total


def _true_actions(result: Result) -> Iterator[_TrueActions]:
    """Yield the true actions of each pursuer, in order of id."""
    actions = [[(0, active)] for active in started(result).active]
    for change in changes(result):
        actions[change.pursuer].append((change.t, action(change)))
    options = np.arange(len(started(result).evaders) + 1)[:, None]
    for timed in actions:
        began, did = np.array(timed, np.int64).T
        spent = np.cumsum(np.diff(began) * (did[:-1] == options), axis=1)
        yield _TrueActions(began, did, np.pad(spent, ((0, 0), (1, 0))))


def _at_decisions(result: Result, pieces: Pieces) -> tuple[Floats, Integers]:
    """Return the sum of the ages, s, at the reader's decisions during each piece, and the number of these decisions."""
    decisions: list[list[tuple[int, int]]] = [[] for _ in started(result).active]
    for place, event in enumerate(result.trace):
        if isinstance(event, Decided):
            decisions[event.pursuer].append((event.t, place))
    total, count = np.zeros(len(pieces)), np.zeros(len(pieces), np.int64)
    edges = np.searchsorted(pieces["reader"], np.arange(len(decisions) + 1))
    for timed, first, last in zip(decisions, edges[:-1], edges[1:], strict=True):
        times, places = np.array(timed, np.int64).reshape(-1, 2).T
        mine = pieces[first:last]
        since = _earlier(times, places, mine["begin"], mine["after"])
        until = _earlier(times, places, mine["until"], mine["before"])
        sums = np.append(0, np.cumsum(times))
        count[first:last] = until - since
        total[first:last] = (sums[until] - sums[since] - (until - since) * mine["created"]) / SECOND
    return total, count


def _earlier(times: Integers, places: Integers, t: Integers, place: Integers) -> Integers:
    """Return the number of events before time t, plus those at t that precede a position in the trace."""
    low, high = (np.searchsorted(times, t, side=side) for side in ("left", "right"))
    return np.clip(np.searchsorted(places, place), low, high)

"""Age of information and errors of beliefs.

The age of information of a reader about a source is the time since the source announced the newest record that the
reader has received (Kaul, Yates & Gruteser 2012, "Real-Time Status: How Often Should One Update?"). The age grows at
rate 1 and drops at each reception of a newer record, so it is a sawtooth. `desim.analysis.knowledge` defines records,
sources and readers. A piece is a period in which a reader has the same newest record of a source.

These metrics need the messages of a run: `record.messages = true`.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import nan
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from desim.analysis.activity import action, changes, decisions
from desim.analysis.knowledge import Pieces, knowledge
from desim.analysis.trace_index import ended, places_of, remembered, started
from desim.config.arrays import Floats, Integers
from desim.kernel.core.portable_math import portable_sum
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
    pieces, size = knowledge(result), len(started(result).active)
    pair, is_received = pieces["reader"] * size + pieces["source"], ~pieces["presumed"]
    begin, until, created = pieces["begin"], pieces["until"], pieces["created"]

    def averaged(total: Floats, weight: NDArray[np.generic]) -> Floats:
        """Return the sum of `total` over the sum of `weight` for each pair, (N, N); nan if the weights sum to 0."""
        totals, weights = (np.bincount(pair, values, minlength=size * size) for values in (total, weight))
        averages: Floats = np.divide(totals, weights, out=np.full(size * size, nan), where=weights > 0)
        return averages.reshape(size, size)

    # Initial beliefs get the weight 0: leaving out their rows would copy all other rows.
    duration = (until - begin) / SECOND * is_received
    mean_age = (begin + until - 2 * created) / (2 * SECOND)  # during the piece
    is_replaced = pieces["superseded"] & is_received
    last_age = (until - created) / SECOND * is_replaced
    total, count = _at_decisions(result, pieces)
    mean, peak = averaged(duration * mean_age, duration), averaged(last_age, is_replaced)
    return Ages(mean, peak, averaged(total * is_received, count * is_received))


def over_pairs(age: Floats) -> float:
    """Return the mean over the pairs with a measurement, or nan without any."""
    measured = age[~np.isnan(age)]
    return float(measured.mean()) if measured.size else nan


def age_mean(result: Result) -> float:
    """Return the age of information, s, averaged over time and then over pairs; nan without a measurement.

    A pair without any reception is left out. Such pairs have the greatest ages, so the mean is too small if many
    messages are lost.

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
    (`announce.start`). After a loss of memory, it takes every source for inactive. The time-out of beliefs
    (`announce.belief_timeout`) has no effect, because this metric compares records only. With several evaders, a record
    is also wrong if it names an evader that the source does not chase, such as an evader captured since. Pursuers that
    only relay (`team.relay`) are neither readers nor sources, because they never act.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    size, end, relays = len(started(result).active), ended(result).t, list(result.scenario.team.relays)
    acting, beliefs, actions = size - len(relays), _beliefs(result), _true_actions(result)
    beliefs = beliefs.of(~np.isin(beliefs.reader, relays) & ~np.isin(beliefs.source, relays))
    time_by_end = actions.time_spent(beliefs.source, beliefs.active, beliefs.until)
    right_time = time_by_end - actions.time_spent(beliefs.source, beliefs.active, beliefs.begin)
    wrong_time = portable_sum((beliefs.until - beliefs.begin - right_time).tolist())
    return wrong_time / (acting * (acting - 1) * end) if acting > 1 and end else nan


def believed_leaders(result: Result) -> float:
    """Return the number of active pursuers whose newest records show no other active pursuer, averaged over time.

    With several evaders, a pursuer counts if its records show no other pursuer of the evader that it chases. The result
    is nan if no time passed. For the beliefs at the start see `belief_error`.

    Raises:
        ValueError: if the trace lacks messages that were sent.
    """
    end, beliefs, actions = ended(result).t, _beliefs(result), _true_actions(result)
    chases = beliefs.of(beliefs.active > 0)
    # A step is the begin (1) or the end (-1) of a belief that a source chases an evader. The sum of the steps is the
    # number of other pursuers that the reader believes to chase the evader; after the last step of each pair, it is 0.
    reader, evader = np.tile(chases.reader, 2), np.tile(chases.active, 2)
    times, steps = np.append(chases.begin, chases.until), np.repeat([1, -1], len(chases.begin))
    order = np.lexsort((times, evader, reader))
    # From each of these steps to the next, the reader knows of other pursuers of the evader.
    begins = np.flatnonzero(np.cumsum(steps[order]))
    spent = actions.time_spent(reader, evader, times)[order]
    active_time = int(actions.duration[actions.action > 0].sum())
    alone = active_time - portable_sum((spent[begins + 1] - spent[begins]).tolist())
    return alone / end if end else nan


@dataclass(frozen=True, slots=True)
class _Beliefs:
    """The columns of a table of beliefs: periods in which the newest records of a source show a reader one action."""

    reader: Integers
    source: Integers
    active: Integers
    """The action of the source as the reader knows it: the evader that it chases, or 0."""
    begin: Integers
    """ns"""
    until: Integers
    """ns"""

    def of(self, rows: NDArray[np.generic]) -> "_Beliefs":
        """Return some rows, given their indices or a mask."""
        return _Beliefs(*(column[rows] for column in (self.reader, self.source, self.active, self.begin, self.until)))


@remembered
def _beliefs(result: Result) -> _Beliefs:
    """Return the beliefs of all readers: successive pieces with the same action, as most pieces are, become one."""
    pieces = knowledge(result)
    active, superseded = pieces["active"], pieces["superseded"]
    first = np.flatnonzero(np.append(True, ~superseded[:-1] | (active[1:] != active[:-1]))[: len(pieces)])
    last = np.append(first[1:], len(pieces))[: len(first)] - 1
    begin, until = pieces["begin"][first], pieces["until"][last]
    return _Beliefs(pieces["reader"][first], pieces["source"][first], active[first], begin, until)


@dataclass(frozen=True, slots=True)
class _TrueActions:
    """The columns of a table of the successive actions of all pursuers, in order of pursuer and time."""

    pursuer: Integers
    start: Integers
    """Start time, ns; 0 for the first action of a pursuer."""
    action: Integers
    """The number of an evader, or 0."""
    duration: Integers
    """ns"""
    total: Integers
    """(M + 1, k) time of each action in all earlier rows, ns, for M evaders and k rows."""

    def time_spent(self, pursuer: Integers, action: Integers, t: Integers) -> Integers:
        """Return the (n,) times, ns, that (n,) pursuers spent on (n,) actions up to (n,) times, ns.

        Each result has a constant added that depends only on the pursuer and the action; only differences are useful.
        """
        # A row is found by its pursuer and the rank of its start: a key of the time itself might exceed 64 bits.
        instants = np.unique(self.start)

        def keys(pursuers: Integers, times: Integers) -> Integers:
            return pursuers * (len(instants) + 1) + np.searchsorted(instants, times, side="right")

        k = np.searchsorted(keys(self.pursuer, self.start), keys(pursuer, t), side="right") - 1
        total: Integers = self.total[action, k] + (self.action[k] == action) * (t - self.start[k])
        return total


@remembered
def _true_actions(result: Result) -> _TrueActions:
    """Return the true actions of all pursuers."""
    actions = [(pursuer, 0, active) for pursuer, active in enumerate(started(result).active)]
    actions += [(change.pursuer, change.t, action(change)) for change in changes(result)]
    pursuer, start, evader = np.array(sorted(actions, key=itemgetter(0)), np.int64).T
    is_last = np.append(np.diff(pursuer) > 0, True)
    duration = np.where(is_last, ended(result).t, np.append(start[1:], 0)) - start
    by_action = duration * (evader == np.arange(len(started(result).evaders) + 1)[:, None])
    return _TrueActions(pursuer, start, evader, duration, np.cumsum(by_action, axis=1) - by_action)


def _at_decisions(result: Result, pieces: Pieces) -> tuple[Floats, Integers]:
    """Return the sum of the ages, s, at the reader's decisions during each piece, and the number of these decisions."""
    size = len(started(result).active)
    decided: list[list[tuple[int, int]]] = [[] for _ in range(size)]
    for decision, place in zip(decisions(result), places_of(result, Decided), strict=True):
        decided[decision.pursuer].append((decision.t, place))
    edges = np.searchsorted(pieces["reader"], np.arange(size + 1)).tolist()
    total, count = np.zeros(len(pieces)), np.zeros(len(pieces), np.int64)
    names = ("begin", "after", "until", "before", "superseded", "created")
    for of_reader, (first, last) in zip(decided, pairwise(edges), strict=True):
        times, places = np.array(of_reader, np.int64).reshape(-1, 2).T.copy()
        begin, after, until, before, superseded, created = (pieces[name][first:last] for name in names)
        by_begin = _count_earlier(times, places, begin, after)
        # A piece that is superseded lasts until the begin of the next row.
        by_end = np.append(by_begin[1:], 0)[: len(by_begin)]
        ends = np.flatnonzero(~superseded)
        by_end[ends] = _count_earlier(times, places, until[ends], before[ends])
        sums, number = np.append(0, np.cumsum(times)), by_end - by_begin
        count[first:last] = number
        total[first:last] = (sums[by_end] - sums[by_begin] - number * created) / SECOND
    return total, count


def _count_earlier(times: Integers, places: Integers, t: Integers, place: Integers) -> Integers:
    """Return how many decisions, at `times` and `places`, are before time t, or at t before a position in the trace."""
    earlier = np.searchsorted(times, t)
    at_once = np.flatnonzero(np.append(times, -1)[earlier] == t)  # the position matters only for these few
    if len(at_once):
        last = np.searchsorted(times, t[at_once], side="right")
        earlier[at_once] = np.clip(np.searchsorted(places, place[at_once]), earlier[at_once], last)
    return earlier

"""Hindsight: how the profile compares with what the game asked for, at the true times of capture.

S(t) is the set of active pursuers, phi_i(t) the time of capture of pursuer i, r(t) the time that is left, and i*(t)
the relay pursuer: that of least (phi, id) among those that are not broken; nobody ({i*} is empty) if its phi >= r.
The potential of the game is Phi(S) = r - mean of phi over S, Phi(empty) = 0; it is greatest for S = {i*}. Integrals
run from 0 to the end.

With several evaders each that is at large is such a game, S_j is the set of those that chase it, and Phi the sum of
their potentials (`desim.pursuit.assignment`). It is greatest for a profile that sends at most one pursuer to each: to
each its own relay pursuer, if these are different; if not, those of `optimal_assignment`.

All this needs positions: `record.trajectory` > 0, or a frozen game. Between two samples everybody is taken to be on a
straight line, and phi is taken in the middle of each piece (`desim.analysis.timeline`); in a frozen game that is exact.
Sampled every 0.05 s and every 0.002 s, 12 seeds of scenarios/relay.toml have the same misassigned time and time to
relay, and potential gaps and regrets that differ by 0.01 % and 0.02 %. There i* never changes. With all speeds 1.1 m/s
it may change at every motion step, when the evader runs between two pursuers that are equally near: the misassigned
time is then 1.244 s where it should be 1.234 s (in one run it is off by 0.16 s), and the time to relay, which such a
change restarts, 1.25 s where it should be 1.34 s. If that matters, sample as often as the motion steps.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import fsum

import numpy as np

from desim.analysis.activity import decisions
from desim.analysis.timeline import Timeline, timeline
from desim.analysis.trace_index import Bools, Floats, Integers, ended, remembered, started
from desim.kernel.clock import SECOND, nanoseconds, seconds
from desim.kernel.graphs import Complete
from desim.kernel.links import Links
from desim.kernel.propagation import TYPICAL_SIZE, LinkSampler
from desim.pursuit.assignment import optimal_assignment
from desim.simulation.run import Result, run

ALIKE = 20
"""Nodes of a complete graph whose links stand for those of all others."""
NO_PURSUER = -1


@dataclass(frozen=True, slots=True)
class Hindsight:
    """What each piece of the course looks like in hindsight."""

    times: Integers
    """(k + 1,) breakpoints, ns."""
    relayed: Bools
    """(k,) whether S = {i*}: the relay pursuer chases alone, or nobody does and nobody should; so on each evader."""
    gap: Floats
    """(k,) what the potential lacks to its maximum, Phi* - Phi(S), s."""
    regret: Floats
    """(N,) external regret of each pursuer over the whole run, s^2."""

    @property
    def durations(self) -> Floats:
        """(k,) lengths of the pieces, s."""
        return np.diff(self.times) / SECOND


@remembered
def hindsight(result: Result) -> Hindsight:
    """Return what the course of a run looks like in hindsight.

    Raises:
        ValueError: if positions were not recorded.
    """
    evaders, size = len(started(result).evaders), len(started(result).active)
    times, relayed, gap = [np.zeros(1, np.int64)], [np.zeros(0, bool)], [np.zeros(0)]
    fixed, played = np.zeros((evaders, size)), np.zeros(size)
    for parts in zip(*(timeline(result, j + 1) for j in range(evaders)), strict=True):
        best = _best(parts)
        times.append(parts[0].times[1:])
        relayed.append(np.all([_relayed(part, own) for part, own in zip(parts, best, strict=True)], axis=0))
        most = np.sum([_worth(part, own) for part, own in zip(parts, best, strict=True)], axis=0)
        gap.append(most - np.sum([_potential(part) for part in parts], axis=0))
        for part, worth in zip(parts, fixed, strict=True):
            gain = gains(part)
            pieces = part.durations[:, None] * gain  # (k, N) s^2
            worth += pieces.sum(axis=0)
            played += np.where(part.active, pieces, 0.0).sum(axis=0)
    regret = np.maximum(fixed.max(axis=0), 0.0) - played
    return Hindsight(np.concatenate(times), np.concatenate(relayed), np.concatenate(gap), regret)


def gains(part: Timeline) -> Floats:
    """Return what chasing the evader was worth to each pursuer in each piece, given what the others did, (k, N) s.

    U_i(active) - U_i(inactive) for the wonderful-life utility, as `desim.pursuit.game.gain`; 0 for a pursuer that
    cannot capture, which has no choice.
    """
    able = np.isfinite(part.phi)
    phi = np.where(able, part.phi, 0.0)
    counted = part.active & able
    chased = np.where(counted, phi, 0.0)
    n = counted.sum(axis=1)[:, None] - counted
    others = (chased.sum(axis=1)[:, None] - chased) / np.maximum(n, 1)
    return np.where(able, np.where(n > 0, (others - phi) / (n + 1), part.left[:, None] - phi), 0.0)


def _best(parts: Sequence[Timeline]) -> Integers:
    """Return which pursuer each evader had best be chased by, (M, k), or `NO_PURSUER`; of one, the relay pursuer."""
    best = np.array([part.phi.argmin(axis=1) for part in parts])
    best[np.array([_worth(part, own) for part, own in zip(parts, best, strict=True)]) == 0.0] = NO_PURSUER
    ordered = np.sort(best, axis=0)
    for k in np.flatnonzero(((ordered[1:] == ordered[:-1]) & (ordered[1:] != NO_PURSUER)).any(axis=0)):
        chosen = optimal_assignment(np.transpose([part.phi[k] for part in parts]), parts[0].left[k])
        best[:, k] = NO_PURSUER
        for pursuer, evader in chosen.items():
            best[evader - 1, k] = pursuer
    return best


def _worth(part: Timeline, chaser: Integers) -> Floats:
    """Return the (k,) potential if one pursuer chased alone, s, given who in each piece; 0 if it would be late."""
    found: Floats = np.maximum(part.left - part.phi[np.arange(len(chaser)), chaser], 0.0)
    return np.where(chaser == NO_PURSUER, 0.0, found)


def _relayed(part: Timeline, best: Integers) -> Bools:
    """Return (k,) whether the best pursuer chases alone, or nobody does and nobody should."""
    number, alone = part.active.sum(axis=1), part.active[np.arange(len(best)), best]
    found: Bools = np.where(best == NO_PURSUER, number == 0, (number == 1) & alone)
    return found


def _potential(part: Timeline) -> Floats:
    """Return the (k,) potential of who chases the evader, s; as `desim.pursuit.game.potential`."""
    counted = part.active & np.isfinite(part.phi)
    n = counted.sum(axis=1)
    mean = np.where(counted, part.phi, 0.0).sum(axis=1) / np.maximum(n, 1)
    return np.where(n > 0, part.left - mean, 0.0)


def misassigned_time(result: Result) -> float:
    """Return how long another set than the relay pursuer alone was active, int 1{S != {i*}} dt, s.

    With several evaders: how long there was another profile than the best one, one set or another.

    Raises:
        ValueError: if positions were not recorded.
    """
    found = hindsight(result)
    return fsum(found.durations[~found.relayed].tolist())


def potential_gap(result: Result) -> float:
    """Return what the profile lacked to the best one, int (Phi* - Phi(S)) dt with Phi* = max(0, r - phi_min), s^2.

    With several evaders Phi* is the worth of an optimal assignment of pursuers to them.

    Raises:
        ValueError: if positions were not recorded.
    """
    found = hindsight(result)
    return fsum((found.durations * found.gap).tolist())


def regret(result: Result) -> float:
    """Return the external regret of the pursuers, averaged over them and over time, s; 0 if no time passed.

    That of pursuer i is what its better fixed action would have brought beyond what it did, given what the others did:

        max over a of int U_i(a, S_-i) dt - int U_i(S) dt

    with the wonderful-life utility U_i (Hannan 1957, "Approximation to Bayes Risk in Repeated Play"), over the M + 1
    actions that there are with M evaders. It is negative for one that did better than any action throughout. To chase
    who cannot be captured by it, for now or any more, is worth nothing to a pursuer.

    Raises:
        ValueError: if positions were not recorded.
    """
    duration = seconds(ended(result).t)
    return float(hindsight(result).regret.mean() / duration) if duration else 0.0


def time_to_relay(result: Result, window: float | None = None) -> float | None:
    """Return the first time from which S = {i*} for a window, or to the end of the run, s; None if there is none.

    With several evaders: from which the best profile is played so long.

    Args:
        result: of a run whose positions were recorded.
        window: s; W = 2 (L + N delta) if None, see `settling_window`.

    Raises:
        ValueError: if positions were not recorded.
    """
    found = hindsight(result)
    window = settling_window(result) if window is None else window
    least = nanoseconds(window) if window < np.inf else np.inf
    edges = np.flatnonzero(np.diff(found.relayed, prepend=False, append=False))
    for begin, end in found.times[edges].reshape(-1, 2).tolist():
        if end - begin >= least or end == found.times[-1]:
            return seconds(begin)
    return None


def settling_window(result: Result) -> float:
    """Return the time after which a profile would have changed if it were going to, W = 2 (L + N delta), s.

    L is the mean latency of the scenario's links, with the airtime of a message, but without what waits; N delta the
    time between two decisions of one pursuer: the `slot` or `period` of its protocol or, of one with a schedule, the
    mean in this run. inf if nobody decided.
    """
    protocol = result.scenario.protocol
    between = getattr(protocol, "slot", getattr(protocol, "period", None))
    if between is None:
        size, number = len(started(result).active), len(decisions(result))
        between = size * seconds(ended(result).t) / number if number else np.inf
    return 2.0 * (_latency(result) + between)


def _latency(result: Result) -> float:
    links, places = result.scenario.network, np.array(started(result).pursuers)
    size = len(places)
    if isinstance(links.graph, Complete) and not links.link:
        size = min(size, ALIKE)
    travel = LinkSampler(links, links.graph(size), result.seed, lambda: places)
    return travel.typical_latency() + links.medium(TYPICAL_SIZE)


def network_regret(result: Result, metric: Callable[[Result], float] = potential_gap) -> float:
    """Return what a metric is beyond that of the same scenario and seed with an ideal network, which it runs.

    Ideal: everybody hears everybody at once (the default `Links`), and nothing breaks.

    Args:
        result: of a run.
        metric: which.
    """
    ideal = result.scenario.model_copy(update={"network": Links(), "fault": ()})
    return metric(result) - metric(run(ideal, result.seed))

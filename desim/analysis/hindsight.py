"""Hindsight: the actions of the pursuers compared with the optimum of the game, at the true capture times.

S(t) is the set of active pursuers, and r(t) the time left, which is constant in a static game. phi_i(t) is the capture
time of pursuer i: the time that it needs for a capture from now on (`desim.pursuit.motion.capture`), or inf if it
cannot capture the evader. The relay pursuer i*(t) is the pursuer with the least phi among those that have not broken
down; ties go to the lowest id. If its phi is at least r, there is no relay pursuer, and {i*} is empty. The potential of
the game is Phi(S) = r - mean of phi over S, with Phi(empty) = 0; members of S with phi = inf do not count. Phi(S) is
largest for S = {i*}. Integrals run from 0 to the end of the run.

With several evaders, there is one such game for each evader that is not yet captured. S_j is the set of the pursuers
that chase evader j, and Phi is the sum of the potentials of the games (`desim.pursuit.game.game`). Phi is largest
for a profile (the actions of all pursuers) with at most one pursuer on each evader. These are the relay pursuers of the
evaders if they all differ, otherwise the pursuers that `optimal_assignment` gives.

These metrics need positions: `record.trajectory` > 0, or a static game. Positions are interpolated linearly between two
samples, and phi is evaluated in the middle of each piece of the timeline (`desim.analysis.timeline`). In a static game
that is exact; in other games the error depends on the interval between samples. For example, take 12 seeds of
scenarios/relay.toml, where i* never changes. Sampling every 0.05 s instead of every 0.002 s does not change the
misassigned time or the time to relay. It changes the potential gap by 0.01 % and the regret by 0.02 %. With all speeds
1.1 m/s, i* may change at every motion step, when the evader runs between two equally near pursuers. Sampling every
0.05 s then gives a misassigned time of 1.244 s instead of 1.234 s; in one of the runs the error is 0.16 s. After a
change of i*, S differs from {i*} until S follows, so the times of these changes also determine the time to relay, which
is 1.25 s instead of 1.34 s. If such errors matter, sample at every motion step.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import fsum

import numpy as np

from desim.analysis.activity import decisions
from desim.analysis.timeline import Timeline, timeline
from desim.analysis.trace_index import ended, remembered, started
from desim.config.arrays import Bools, Floats, Integers
from desim.config.model import MAX_TIME
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.kernel.link_layer.propagation import TYPICAL_SIZE, LinkSampler
from desim.kernel.models.links import Links
from desim.kernel.models.medium import airtime_of
from desim.pursuit.game.game import optimal_assignment
from desim.simulation.run import Result, run

NO_PURSUER = -1
"""In place of the optimal pursuer of an evader, if none can gain by chasing it."""


@dataclass(frozen=True, slots=True)
class Hindsight:
    """The comparison with the optimum for each piece of the timeline."""

    times: Integers
    """(k + 1,) breakpoints, ns."""
    relayed: Bools
    """(k,) whether only the optimal pursuer, if any, chases each evader; with one evader, whether S = {i*}."""
    gap: Floats
    """(k,) difference of the potential from its maximum, Phi* - Phi(S), s."""
    regret: Floats
    """(N,) external regret of each pursuer over the whole run, s^2."""

    @property
    def durations(self) -> Floats:
        """(k,) lengths of the pieces, s."""
        return np.diff(self.times) / SECOND


@remembered
def hindsight(result: Result) -> Hindsight:
    """Return the comparison of a run with the optimum.

    Raises:
        ValueError: if positions were not recorded.
    """
    evaders, size = len(started(result).evaders), len(started(result).active)
    times, relayed, gap = [np.zeros(1, np.int64)], [np.zeros(0, bool)], [np.zeros(0)]
    # Integrals of the gains, s^2: (M, N) from chasing one evader throughout, and (N,) from the actions taken.
    of_fixed, of_taken = np.zeros((evaders, size)), np.zeros(size)
    for parts in zip(*(timeline(result, j + 1) for j in range(evaders)), strict=True):
        best = _optimal_pursuers(parts)
        times.append(parts[0].times[1:])
        relayed.append(np.all([_relayed(part, chaser) for part, chaser in zip(parts, best, strict=True)], axis=0))
        optimum = np.sum([_single_potential(part, chaser) for part, chaser in zip(parts, best, strict=True)], axis=0)
        gap.append(optimum - np.sum([_potential(part) for part in parts], axis=0))
        for part, of_chasing in zip(parts, of_fixed, strict=True):
            integrals = part.durations[:, None] * gains(part)  # (k, N) s^2
            of_chasing += integrals.sum(axis=0)
            of_taken += np.where(part.active, integrals, 0.0).sum(axis=0)
    regret = np.maximum(of_fixed.max(axis=0), 0.0) - of_taken  # 0 for never chasing
    return Hindsight(np.concatenate(times), np.concatenate(relayed), np.concatenate(gap), regret)


def gains(part: Timeline) -> Floats:
    """Return the (k, N) gain, s, of each pursuer from chasing the evader in each piece, given the others' actions.

    The gain is U_i(active) - U_i(inactive) for the wonderful-life utility, as in `desim.pursuit.game.game.gain`, but 0
    for a pursuer that cannot capture the evader (phi = inf), because it can only be inactive.
    """
    is_able = np.isfinite(part.phi)
    phi = np.where(is_able, part.phi, 0.0)
    counted = part.active & is_able
    counted_phi = np.where(counted, phi, 0.0)
    others = counted.sum(axis=1)[:, None] - counted
    mean_of_others = (counted_phi.sum(axis=1)[:, None] - counted_phi) / np.maximum(others, 1)
    gain = np.where(others > 0, (mean_of_others - phi) / (others + 1), part.left[:, None] - phi)
    return np.where(is_able, gain, 0.0)


def _optimal_pursuers(parts: Sequence[Timeline]) -> Integers:
    """Return the (M, k) optimal pursuer of each evader in each piece, or `NO_PURSUER`; see the top of this module."""
    best = np.array([part.phi.argmin(axis=1) for part in parts])
    potentials = np.array([_single_potential(part, chaser) for part, chaser in zip(parts, best, strict=True)])
    best[potentials == 0.0] = NO_PURSUER
    ordered = np.sort(best, axis=0)
    # In these pieces, one pursuer is the best for several evaders.
    for k in np.flatnonzero(((ordered[1:] == ordered[:-1]) & (ordered[1:] != NO_PURSUER)).any(axis=0)):
        chosen = optimal_assignment(np.transpose([part.phi[k] for part in parts]), parts[0].left[k])
        best[:, k] = NO_PURSUER
        for pursuer, evader in chosen.items():
            best[evader - 1, k] = pursuer
    return best


def _single_potential(part: Timeline, chaser: Integers) -> Floats:
    """Return the (k,) potential, s, if `chaser` chased the evader alone; 0 if it would be late or is `NO_PURSUER`."""
    potential: Floats = np.maximum(part.left - part.phi[np.arange(len(chaser)), chaser], 0.0)
    return np.where(chaser == NO_PURSUER, 0.0, potential)


def _relayed(part: Timeline, best: Integers) -> Bools:
    """Return (k,) whether the optimal pursuer chases the evader alone; without one, whether no pursuer chases it."""
    number, alone = part.active.sum(axis=1), part.active[np.arange(len(best)), best]
    is_relayed: Bools = np.where(best == NO_PURSUER, number == 0, (number == 1) & alone)
    return is_relayed


def _potential(part: Timeline) -> Floats:
    """Return the (k,) potential, s, of the pursuers that chase the evader, as `game.potential` does."""
    counted = part.active & np.isfinite(part.phi)
    n = counted.sum(axis=1)
    mean = np.where(counted, part.phi, 0.0).sum(axis=1) / np.maximum(n, 1)
    return np.where(n > 0, part.left - mean, 0.0)


def misassigned_time(result: Result) -> float:
    """Return the time, s, for which the relay pursuer was not the only active pursuer: int 1{S != {i*}} dt.

    With several evaders, it is the time for which S_j differed from the optimum for at least one evader.

    Raises:
        ValueError: if positions were not recorded.
    """
    view = hindsight(result)
    return fsum(view.durations[~view.relayed].tolist())


def potential_gap(result: Result) -> float:
    """Return the gap to the largest potential, s^2: int (Phi* - Phi(S)) dt with Phi* = max(0, r - phi_min).

    With several evaders, Phi* is the potential of an optimal assignment of pursuers to evaders.

    Raises:
        ValueError: if positions were not recorded.
    """
    view = hindsight(result)
    return fsum((view.durations * view.gap).tolist())


def regret(result: Result) -> float:
    """Return the external regret, s, averaged over time and the pursuers that may chase; 0 if no time passed.

    The external regret of pursuer i (Hannan 1957, "Approximation to Bayes Risk in Repeated Play") is the utility of its
    best fixed action minus the utility of the actions that it took, given the others' actions:

        max over a of int U_i(a, S_-i) dt - int U_i(S) dt

    U_i is the wonderful-life utility; with M evaders, a is one of M + 1 actions. The regret is negative for a pursuer
    that did better than any fixed action. The utility of chasing an evader that the pursuer cannot capture, or that has
    been captured, is 0. Pursuers that only relay (`team.relay`) have no choice, and are left out.

    Raises:
        ValueError: if positions were not recorded.
    """
    duration = seconds(ended(result).t)
    acting = np.delete(hindsight(result).regret, list(result.scenario.team.relays))
    return float(acting.mean() / duration) if duration and len(acting) else 0.0


def time_to_relay(result: Result, window: float | None = None) -> float | None:
    """Return the first time, s, from which S = {i*} holds for a window or until the end of the run; None if never.

    With several evaders, S = {i*} stands for an optimal profile.

    Args:
        result: the result of a run whose positions were recorded.
        window: the time, s, for which S = {i*} has to hold; if None, the result of `settling_window`.

    Raises:
        ValueError: if positions were not recorded.
    """
    view = hindsight(result)
    window = settling_window(result) if window is None else window
    least = nanoseconds(window) if window <= MAX_TIME else np.inf
    edges = np.flatnonzero(np.diff(view.relayed, prepend=False, append=False))
    for begin, end in view.times[edges].reshape(-1, 2).tolist():
        if end - begin >= least or end == view.times[-1]:
            return seconds(begin)
    return None


def settling_window(result: Result) -> float:
    """Return the time W = 2 (L + N delta), s, after which an unchanged profile counts as settled.

    L is the mean latency of the scenario's links, with processing delays and the airtime of a message, but without
    queueing. delta is the mean time between two decisions of the team, so N delta is the mean time between two
    decisions of one pursuer. If the protocol has a `slot` or a `period`, N delta is the `slot` or, without one, the
    `period`, because each pursuer decides once in this time. For any other protocol, N delta is the mean in this run,
    and W is inf if there were no decisions.
    """
    protocol = result.scenario.protocol_traits
    between = protocol.period if protocol.slot is None else protocol.slot
    if between is None:
        size, number = len(started(result).active), len(decisions(result))
        between = size * seconds(ended(result).t) / number if number else np.inf
    return 2.0 * (_latency(result) + between)


def _latency(result: Result) -> float:
    """Return L, s; see `settling_window`."""
    links, places = result.scenario.network, np.array(started(result).pursuers)
    sampler = LinkSampler(links, links.make_graph(len(places)), result.seed, lambda: places)
    return sampler.typical_latency() + airtime_of(links.medium, TYPICAL_SIZE, len(places))


def network_regret(result: Result, metric: Callable[[Result], float] = potential_gap) -> float:
    """Return the excess of a metric over its value for the same scenario and seed with an ideal network.

    The reference is a new run with the default `Links` (complete, without delay or loss) and without faults.

    Args:
        result: the result of a run.
        metric: the metric; it should have a value in both runs. For example, the capture time has none in a run without
            a capture.

    Raises:
        ValueError: if the metric is None in one of the runs.
    """
    value = value_of(metric, result, "the run")
    ideal = result.scenario.model_copy(update={"network": Links(), "fault": ()})
    return value - value_of(metric, run(ideal, result.seed), "the run on an ideal network")


def value_of(metric: Callable[[Result], float | None], result: Result, which: str) -> float:
    """Return the value of a metric; raise ValueError if it is None."""
    value = metric(result)
    if value is None:
        raise ValueError(f"{getattr(metric, '__name__', metric)} has no value in {which} with seed {result.seed}")
    return value

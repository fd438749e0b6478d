"""Metrics that need only the actions of the pursuers: active times, changes of action, handovers.

The action of a pursuer is the number of the evader that it chases, or 0; a pursuer that chases is active. n(t) is the
number of active pursuers. Integrals, written "int", run from 0 to the end of the run. With several evaders n_j(t) is
the number of pursuers that chase evader j, and n the sum of all n_j. Sums over j are over the evaders at large (not yet
captured), so the integral of an n_j ends at the capture of j.

Kept equal to a loop over the trace by
`tests/analysis/test_metrics.py::test_energy_and_handovers_equal_those_of_a_plain_loop_over_the_trace`.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import fsum
from typing import NamedTuple

import numpy as np

from desim.analysis.trace_index import captures, ended, places_of, remembered, started, traced_events
from desim.config.arrays import Bools, Floats, Integers
from desim.kernel.core.portable_math import inner_product, portable_sum
from desim.kernel.core.units import SECOND, nanoseconds
from desim.pursuit.core.events import BrokeDown, Captured, Decided
from desim.simulation.run import Result

Steps = tuple[Floats, Integers]
"""A step function of time as (durations, counts): the value is counts[k] for durations[k] seconds."""


class Released(NamedTuple):
    """A pursuer becomes inactive because the evader that it chased was captured."""

    t: int
    pursuer: int


Change = Decided | BrokeDown | Released
"""The events that may change an action."""


@dataclass(frozen=True, slots=True)
class EvaderPursuit:
    """The pursuers of one evader over time."""

    start: tuple[bool, ...]
    """(N,) whether each pursuer chased the evader at the start."""
    steps: list[tuple[int, int, int]]
    """(time (ns), pursuer, 1 or -1) for each change: 1 if the pursuer joined, -1 if it left."""
    end: int
    """Time, ns, of the capture of the evader, or of the end of the run if there was no capture."""


@remembered
def decisions(result: Result) -> list[Decided]:
    """Return the decisions, in order, whether or not they changed an action."""
    return traced_events(result, Decided)


@remembered
def changes(result: Result) -> list[Change]:
    """Return the changes of action in order; a capture yields one `Released` for each pursuer of the evader.

    A capture at the end of the run yields none: the pursuers of that evader stay active up to the end.
    """
    actions, end = list(started(result).active), ended(result).t
    changed: list[Change] = []
    events = result.trace.events
    for place in places_of(result, Decided, BrokeDown, Captured):
        event = events[place]
        if isinstance(event, Decided | BrokeDown):
            if action(event) != actions[event.pursuer]:
                actions[event.pursuer] = action(event)
                changed.append(event)
        elif isinstance(event, Captured) and event.t < end:
            for pursuer in [i for i, chased in enumerate(actions) if chased == event.evader]:
                actions[pursuer] = 0
                changed.append(Released(event.t, pursuer))
    return changed


def action(event: Change) -> int:
    """Return the action of a pursuer after a change: the number of the evader that it chases, or 0."""
    return event.active if isinstance(event, Decided) else 0


def chases(event: Change) -> bool:
    """Return whether a pursuer is active after a change."""
    return bool(action(event))


def changes_with_previous(result: Result) -> Iterator[tuple[Change, int]]:
    """Yield each change of action, and the previous action of its pursuer."""
    actions = list(started(result).active)
    for change in changes(result):
        yield change, actions[change.pursuer]
        actions[change.pursuer] = action(change)


@remembered
def evader_pursuits(result: Result) -> list[EvaderPursuit]:
    """Return the pursuers of each of the M evaders over time."""
    start = started(result)
    ends = dict.fromkeys(range(1, len(start.evaders) + 1), ended(result).t)
    ends |= {capture.evader: capture.t for capture in captures(result)}
    pursuits = [
        EvaderPursuit(tuple(action == evader for action in start.active), [], end) for evader, end in ends.items()
    ]
    for change, before in changes_with_previous(result):
        if before:
            pursuits[before - 1].steps.append((change.t, change.pursuer, -1))
        if chases(change):
            pursuits[action(change) - 1].steps.append((change.t, change.pursuer, 1))
    return pursuits


@remembered
def activity(result: Result) -> Steps:
    """Return n(t), the number of active pursuers."""
    steps = ((change.t, chases(change) - bool(before)) for change, before in changes_with_previous(result))
    return _step_function(sum(map(bool, started(result).active)), steps, ended(result).t)


@remembered
def pressure(result: Result) -> list[Steps]:
    """Return n_j(t), the number of pursuers of each evader j, up to its capture or the end of the run."""
    return [
        _step_function(portable_sum(pursuit.start), ((t, step) for t, _, step in pursuit.steps), pursuit.end)
        for pursuit in evader_pursuits(result)
    ]


def _step_function(start: int, steps: Iterable[tuple[int, int]], end: int) -> Steps:
    """Return the step function of a count, given its value at the start and (time (ns), increment) of each change."""
    times, counts = [0], [start]
    for t, increment in steps:
        times.append(t)
        counts.append(counts[-1] + increment)
    return np.diff([*times, end]) / SECOND, np.array(counts)


def _integral(functions: Iterable[Steps], of: Callable[[Integers], Integers | Bools]) -> float:
    """Return the integral of `of(counts)` over time, s, summed over the step functions."""
    return fsum(time for durations, counts in functions for time in (durations * of(counts)).tolist())


def active_time(result: Result) -> float:
    """Return the active time summed over the pursuers, int n dt (Lee & Bakolas, Table I), s."""
    return _integral([activity(result)], lambda counts: counts)


def idle_time(result: Result) -> float:
    """Return the time, s, without an active pursuer, summed over the evaders: int sum_j 1{n_j = 0} dt.

    Active time minus excess time plus idle time is the time for which an evader is at large, summed over the evaders:
    n_j - max(n_j - 1, 0) + 1{n_j = 0} = 1.
    """
    return _integral(pressure(result), lambda counts: counts == 0)


def crowded_time(result: Result) -> float:
    """Return the time, s, with more than one active pursuer, summed over the evaders: int sum_j 1{n_j > 1} dt."""
    return _integral(pressure(result), lambda counts: counts > 1)


def excess_time(result: Result) -> float:
    """Return the active time, s, in excess of one pursuer per evader: int sum_j max(n_j - 1, 0) dt."""
    return _integral(pressure(result), lambda counts: np.maximum(counts - 1, 0))


def energy(result: Result) -> float:
    """Return the energy of the chase, (m/s)^p s: int sum_i v_i^p a_i dt with a_i = 1{i is active}.

    v_i is the speed of pursuer i through its medium, and p is `team.power_exponent`. A drive that needs the force
    c v^(p-1) at the speed v spends c times this integral, in J: p = 1 is dry friction, 2 viscous friction, 3 the drag
    of air or water. The consumption at rest and that of accelerations do not count. An active robot with inertia counts
    with its full speed even while it is slower, and an inactive one not at all, even while it brakes. In a static game,
    where no pursuer moves, the result is the energy that pursuers with the same actions would need to move.
    """
    end = ended(result).t
    chasing = [end * bool(active) for active in started(result).active]  # active times, ns: integers, so sums are exact
    for change, before in changes_with_previous(result):
        chasing[change.pursuer] += (end - change.t) * (chases(change) - bool(before))
    exponent = result.scenario.team.power_exponent
    powers = [speed**2 if exponent == 2.0 else speed**exponent for speed in started(result).speeds]
    return inner_product(powers, chasing) / SECOND


def switches(result: Result) -> int:
    """Return the number of decisions that changed an action; a change from one evader to another counts, too."""
    return sum(isinstance(change, Decided) for change in changes(result))


def relays(result: Result, evader: int = 1) -> list[tuple[int, int]]:
    """Return the pursuers that chased an evader alone, in order of time, as (start (ns), pursuer).

    A period of length 0 does not count. Successive periods of one pursuer, between which no other pursuer chased alone,
    count as one.
    """
    return _relays(result)[evader - 1]


@remembered
def _relays(result: Result) -> list[list[tuple[int, int]]]:
    """Return the `relays` of each evader."""
    return [_relays_of(pursuit) for pursuit in evader_pursuits(result)]


def _relays_of(pursuit: EvaderPursuit) -> list[tuple[int, int]]:
    """Return the `relays` of one evader."""
    active = {pursuer for pursuer, chasing in enumerate(pursuit.start) if chasing}
    times = [0, *(t for t, _, _ in pursuit.steps), pursuit.end]
    chain: list[tuple[int, int]] = []
    for step, (begin, end) in zip([None, *pursuit.steps], pairwise(times), strict=True):
        if step is not None:
            active ^= {step[1]}  # the pursuer joins or leaves
        if len(active) == 1 and begin < end and (not chain or chain[-1][1] not in active):
            chain.append((begin, min(active)))
    return chain


def handovers(result: Result) -> int:
    """Return the number of handovers: changes of the only pursuer of an evader (n_j = 1), over all evaders.

    Between two such pursuers, the evader may have no pursuer or several for a time.
    """
    return portable_sum(max(len(chain) - 1, 0) for chain in _relays(result))


def ping_pongs(result: Result, within: float = 1.0) -> int:
    """Return the number of handovers i -> j less than `within` s after the handover j -> i.

    The term comes from cellular networks (3GPP TR 36.839, in which the minimum time of stay, here `within`, is 1 s).
    """
    return sum(
        1
        for chain in _relays(result)
        for (_, before), (handed_over, _), (handed_back, after) in zip(chain, chain[1:], chain[2:], strict=False)
        if before == after and handed_back - handed_over < nanoseconds(within)
    )

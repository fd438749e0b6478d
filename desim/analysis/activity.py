"""Who was active when: metrics of the actions alone.

S(t) is the set of active pursuers and n(t) their number; integrals run from 0 to the end of the run.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from desim.analysis.reading import ended, remembered, started
from desim.kernel.clock import SECOND, nanoseconds
from desim.pursuit.events import Decided, Halted
from desim.simulation import Result


@remembered
def decisions(result: Result) -> list[Decided]:
    """Return the decisions, in order, whether or not they changed an action."""
    return result.trace.of(Decided)


@remembered
def changes(result: Result) -> list[Decided | Halted]:
    """Return the decisions, and the breakdowns, by which a pursuer's action changed."""
    active = list(started(result).active)
    changed = []
    for event in result.trace:
        if isinstance(event, Decided | Halted) and chases(event) != active[event.pursuer]:
            active[event.pursuer] = chases(event)
            changed.append(event)
    return changed


def chases(event: Decided | Halted) -> bool:
    """Return whether a pursuer is active from then on."""
    return isinstance(event, Decided) and event.active


@remembered
def activity(result: Result) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return n(t) as a step function: n is counts[k] for durations[k] seconds, in order of time."""
    times, counts = [0], [sum(started(result).active)]
    for change in changes(result):
        times.append(change.t)
        counts.append(counts[-1] + (1 if chases(change) else -1))
    times.append(ended(result).t)
    return np.diff(times) / SECOND, np.array(counts)


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


def energy(result: Result) -> float:
    """Return what the chase costs, int sum_i v_i^2 a_i dt with a_i = 1{i is active}, m^2/s.

    In a frozen game, where nobody moves, it is what the same actions would cost.
    """
    end = ended(result).t
    own = [end * active for active in started(result).active]  # ns, whole numbers
    for change in changes(result):
        own[change.pursuer] += (end - change.t) * (1 if chases(change) else -1)
    return float(sum(speed**2 * time for speed, time in zip(started(result).speeds, own, strict=True)) / SECOND)


def switches(result: Result) -> int:
    """Return how often a pursuer changed its action by a decision."""
    return sum(isinstance(change, Decided) for change in changes(result))


@remembered
def relays(result: Result) -> list[tuple[int, int]]:
    """Return who was active alone from when on, (ns, pursuer), as often as it was another than the last such one.

    Who is alone for no time, between simultaneous changes, is not meant.
    """
    active = {pursuer for pursuer, chasing in enumerate(started(result).active) if chasing}
    times = [0, *(change.t for change in changes(result)), ended(result).t]
    found: list[tuple[int, int]] = []
    for change, (begin, end) in zip([None, *changes(result)], pairwise(times), strict=True):
        if change is not None:
            active ^= {change.pursuer}
        if len(active) == 1 and begin < end and (not found or found[-1][1] not in active):
            found.append((begin, min(active)))
    return found


def handovers(result: Result) -> int:
    """Return how often the single active pursuer (n = 1) was another than the last single active one."""
    return max(len(relays(result)) - 1, 0)


def ping_pongs(result: Result, within: float = 1.0) -> int:
    """Return how many hand-overs undo the one before, i -> j after j -> i, less than a time (s) after it.

    The term is that of cellular networks (3GPP TR 36.839, where that time of stay is 1 s).
    """
    chain = relays(result)
    return sum(
        before == after and back - there < nanoseconds(within)
        for (_, before), (there, _), (back, after) in zip(chain, chain[1:], chain[2:], strict=False)
    )

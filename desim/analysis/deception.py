"""Pursuers with Byzantine faults: when teammates detect them, how often honest ones are suspected, what they cost."""

from collections.abc import Callable
from math import inf, nan

from desim.analysis.hindsight import value_of
from desim.analysis.trace_index import captures, traced_events
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.units import seconds
from desim.kernel.models.traced_faults import FaultStarted, Misbehaviour
from desim.pursuit.core.events import Distrusted
from desim.pursuit.team.trust import may_distrust
from desim.simulation.run import Result, run


def first_lies(result: Result) -> dict[int, int]:
    """Return the time, ns, at which the first Byzantine fault of a pursuer begins, by pursuer, without honest ones."""
    lies: dict[int, int] = {}
    for event in traced_events(result, FaultStarted):
        if isinstance(event.fault, Misbehaviour):
            lies.setdefault(event.fault.node, event.t)
    return lies


def checks_announcements(result: Result) -> bool:
    """Return whether pursuers may distrust each other: whether `announce.trust` is not "none"."""
    return may_distrust(result.scenario.announce.trust)


def false_accusations(result: Result) -> int:
    """Return the number of times that a pursuer began to distrust a teammate without a Byzantine fault up to then.

    A pursuer that has a Byzantine fault at any time of the run does not count as an accuser.
    """
    lies = first_lies(result)
    return sum(
        1
        for event in traced_events(result, Distrusted)
        if event.distrusted and lies.get(event.suspect, inf) > event.t and event.pursuer not in lies
    )


def time_to_detect(result: Result) -> float:
    """Return the mean time, s, from the first Byzantine fault of a pursuer until an honest teammate distrusts it.

    The mean is over the pursuers that are distrusted before the end of the run; nan if there are none.
    """
    lies, detections = first_lies(result), dict[int, int]()
    for event in traced_events(result, Distrusted):
        start = lies.get(event.suspect)
        if event.distrusted and event.pursuer not in lies and start is not None and event.t >= start:
            detections.setdefault(event.suspect, event.t - start)
    return seconds(portable_sum(detections.values())) / len(detections) if detections else nan


def damage_per_liar(result: Result, metric: Callable[[Result], float | None]) -> float:
    """Return by how much the Byzantine faults raise a metric, divided by the number of pursuers that have them.

    The reference is a new run with the same seed and without Byzantine faults; all other random draws are the same.

    Args:
        result: the result of a run.
        metric: the metric; it should have a value in both runs.

    Raises:
        ValueError: if no pursuer has a Byzantine fault, or the metric is None in one of the runs.
    """
    liars = len(first_lies(result))
    if not liars:
        raise ValueError(f"no pursuer has a Byzantine fault in the run with seed {result.seed}")
    return (value_of(metric, result, "the run") - value_of(metric, honest_run(result), "the honest run")) / liars


def captures_lost(result: Result) -> int:
    """Return how many fewer evaders are captured than in a run with the same seed and without Byzantine faults."""
    return len(captures(honest_run(result))) - len(captures(result))


def honest_run(result: Result) -> Result:
    """Run the scenario with the same seed and without Byzantine faults, and return the result."""
    honest = result.scenario.model_copy(update={"fault": result.scenario.network_faults})
    return run(honest, result.seed)

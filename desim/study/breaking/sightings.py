"""Events that should occur in the runs of a search: without a handover or a lost message, a search has tried little.

The idea is that of "sometimes" assertions, which tell whether a test has reached the states that matter.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from desim.analysis.activity import action, handovers, idle_time, relays
from desim.analysis.deliveries import outages
from desim.analysis.trace_index import captures, messages, trace_index
from desim.config.traits import kind_of
from desim.kernel.core.events import LOST
from desim.kernel.models.faults import nodes_of
from desim.kernel.models.traced_faults import FaultStarted, TracedFault
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Started
from desim.simulation.run import Result
from desim.study.breaking.copies import copies, looks, readings


def _handed_over_during_a_fault(result: Result) -> bool:
    evaders = range(1, len(result.scenario.evaders) + 1)
    times = [start for evader in evaders for start, _ in relays(result, evader)[1:]]  # the first chase is no handover
    return any(window.begin <= t <= window.end for t in times for _, window in outages(result))


def _chaser_down(result: Result) -> bool:
    (start,) = result.trace.of(Started)
    actions = [*start.active]
    for event in result.trace:
        if isinstance(event, Decided | BrokeDown):
            actions[event.pursuer] = action(event)
        elif isinstance(event, Captured):  # its pursuers are free
            actions = [0 if chased == event.evader else chased for chased in actions]
        elif isinstance(event, FaultStarted) and kind_of(event.fault) == "crash" and _chases(actions, event.fault):
            return True
    return False


def _chases(actions: list[int], fault: TracedFault) -> bool:
    """Return whether a pursuer that a fault names chases an evader."""
    return any(actions[node] for nodes in nodes_of(fault).values() for node in nodes)


def _lost_at_a_look(result: Result) -> bool:
    return any(
        reading.copy.arrival == LOST and reading.is_read() for reading in readings(copies(result), looks(result))
    )


SIGHTINGS: Mapping[str, Callable[[Result], bool]] = MappingProxyType(
    {
        "an evader was captured": lambda result: bool(captures(result)),
        "a chase was handed over": lambda result: handovers(result) > 0,
        "an evader was not chased": lambda result: idle_time(result) > 0.0,
        "a message was lost": lambda result: messages(result).lost > 0,
        "a message was lost that its receiver would have read": _lost_at_a_look,
        "a fault began": lambda result: bool(result.trace.of(FaultStarted)),
        "a pursuer that chased crashed": _chaser_down,
        "a chase was handed over during a fault": _handed_over_during_a_fault,
    }
)
"""The conditions that are looked for in each run, by a sentence."""


def seen_in(result: Result) -> list[str]:
    """Return what was seen in a run; its messages must be in its trace."""
    result = trace_index(result)
    return [sentence for sentence, holds in SIGHTINGS.items() if holds(result)]

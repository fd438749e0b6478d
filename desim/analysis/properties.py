"""Judge properties of a run: the margin of a property, and a watcher that ends a run that violates it."""

from collections import deque
from math import nan
from typing import NamedTuple

from desim.analysis.quantities import RISING, WATCHED, Level, Tally, cut, key_of, pieces_of
from desim.analysis.trace_index import trace_index
from desim.config.arguments import naming_arguments, run_argument
from desim.config.errors import ArgumentError
from desim.kernel.core.events import Event
from desim.kernel.core.units import seconds
from desim.scenario.properties import Property, PropertyPiece, Worst, property_of, recording
from desim.scenario.property_misfits import misfits_of
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.simulation.run import Result, run

Stated = Property | str
"""A property, or its text."""


class Judgement(NamedTuple):
    """How far a run is from violating a property."""

    margin: float
    """At least 0 if the run keeps the property. In s or, for `always`, in the unit of the quantity."""
    measure: float
    """The worst value of what the property bounds: a time, s, or for `always` the largest violation."""
    at: float
    """When this worst value began, s."""
    reference: float | None = None
    """The measure of the run under the protocol `against`; None without one."""

    @property
    def holds(self) -> bool:
        """Whether the run keeps the property."""
        return self.margin >= 0.0


def worst_of(prop: Property, result: Result) -> Worst:
    """Return the worst value of what a property bounds in a run, from one pass over the run; a reference is ignored.

    Raises:
        ValueError: if the trace lacks positions or messages that a quantity needs.
    """
    worst = Worst(prop.least, 0)
    for latest in prop.worst(pieces_of(prop.conditions, result)):
        worst = latest
    return worst


def reference_scenario(prop: Property, scenario: Scenario) -> Scenario | None:
    """Return the scenario with the protocol that a property is against; None if the property has no reference.

    Parameters that both protocols have, such as a schedule, are kept.

    Raises:
        ValueError: if the protocol is its own reference.
    """
    if prop.against is None:
        return None
    if scenario.protocol_name == prop.against:
        raise ValueError(f"{prop.against} is its own reference: a run never differs from itself")
    return under_protocol(scenario, prop.against)


def under_protocol(scenario: Scenario, kind: str) -> Scenario:
    """Return a scenario under another installed protocol, with the parameters that both protocols have."""
    return scenario.with_({"protocol.kind" if PROTOCOLS.holds(scenario.protocol) else "protocol": kind})


@naming_arguments
def judge(prop: Stated, result: Result) -> Judgement:
    """Return how far a run is from violating a property. A property with a reference costs one more run.

        judge("idle never longer than 2", desim.run(scenario)).margin

    Args:
        prop: the property, or its text.
        result: the run.

    Raises:
        TypeError: if `result` is not the result of a run.
        ValueError: if the text states no property, the property does not fit the scenario, the protocol is its own
            reference, or the trace lacks positions or messages that a quantity needs.
    """
    if isinstance(prop, Result):
        raise TypeError("judge takes the property first: judge('idle at most 2 in total', result)")
    run_argument(Result).check(result, "judge")
    prop = stated(prop, result.scenario)
    worst, reference = worst_of(prop, trace_index(result)), reference_scenario(prop, result.scenario)
    reference_measure = None
    if reference is not None:
        reference_measure = worst_of(prop, trace_index(run(recording(reference, [prop]), result.seed))).measure
    return Judgement(prop.margin(worst.measure, reference_measure), worst.measure, seconds(worst.at), reference_measure)


def stated(prop: Stated, scenario: Scenario) -> Property:
    """Return the property that a text states, checked against a scenario.

    Raises:
        ValueError: if the text states no property, or it names an evader or a protocol that does not exist.
    """
    prop = property_of(prop)
    for place, why in misfits_of(prop, scenario):
        raise ArgumentError("property", f"{prop.text!r}: {'.'.join(map(str, place))}: {why}")
    return prop


class PropertyWatcher:
    """A watcher that ends a run as soon as it violates a property: `desim.run(scenario, seed, watcher)`.

    The property is judged at each event, so also at each sample of the trajectory (`record.trajectory`).

    Args:
        prop: the property, or its text; without a reference. All its quantities are in `WATCHED`, because others need
            the whole trace.
        scenario: the scenario of the run.

    Attributes:
        margin: the margin up to the last event.
        violated_at: the time, s, at which the watcher found the property violated; None if it holds.

    Raises:
        ValueError: if the text states no property, or the property cannot be judged while a run lasts.
    """

    def __init__(self, prop: Stated, scenario: Scenario):
        self.property = stated(prop, scenario)
        conditions = self.property.conditions
        self._comparisons = [comparison for condition in conditions for comparison in condition.comparisons]
        unwatched = [comparison.quantity for comparison in self._comparisons if comparison.quantity not in WATCHED]
        if unwatched or self.property.against:
            what = unwatched[0] if unwatched else f"the reference {self.property.against}"
            raise ArgumentError(
                "property",
                f"{self.property.text!r}: {what} is known only after a run; quantities that are known"
                f" during it are {', '.join(sorted(WATCHED))}",
            )
        self.margin = self.property.margin(self.property.least)
        self.violated_at: float | None = None
        self._tally, self._now, self._levels = Tally(), 0, list[Level]()
        self._pieces = deque[PropertyPiece]()
        # A generator over the pieces still to come: each `next` takes the piece that was just appended.
        self._worst = self.property.worst(iter(self._pieces.popleft, None))

    def __call__(self, event: Event) -> bool:
        """Process an event; return whether the property is violated."""
        if event.t > self._now:
            for piece in cut(self.property.conditions, self._levels, self._now, event.t):
                self._pieces.append(piece)
                self.margin = self.property.margin(next(self._worst).measure)
            self._now = event.t
            if self.margin < 0.0 and self.violated_at is None:
                self.violated_at = seconds(event.t)
        if self._tally(event):
            self._levels = [
                Level(event.t, self._tally.value(*key_of(comparison), event.t), comparison.quantity in RISING)
                for comparison in self._comparisons
            ]
        return self.violated_at is not None


def margin(result: Result, name: str) -> float:
    """Return the margin of a property that the scenario of a run has, by its name: the metric `margin:NAME`.

    It is nan if the protocol of the run is the reference of the property: a run never differs from itself.

    Raises:
        ValueError: if the scenario has no property of this name; see also `judge`.
    """
    named = {prop.label: prop for prop in result.scenario.properties}
    if name not in named:
        raise ValueError(f"the scenario has no property {name!r}; it has {', '.join(named) or 'none'}")
    prop = named[name]
    return nan if prop.against == result.scenario.protocol_name else judge(prop, result).margin

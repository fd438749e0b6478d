"""Properties that runs should keep, such as "no evader is idle for longer than 2 s": formulas on step functions.

A property compares quantities of the trace (`QUANTITIES`) with numbers and says when these comparisons should hold. It
is written as a text or as a table:

    properties = ["covered: idle never longer than 2 against centralised"]

    [[properties]]
    name = "covered"
    kind = "never_longer"
    condition = "idle"
    limit = 2.0
    against = "centralised"

Each property has a margin, its robustness in the sense of Fainekos & Pappas (2009, "Robustness of Temporal Logic
Specifications for Continuous-Time Signals"): at least 0 if the run keeps the property, and the larger the further the
run is from violating it. The margin of `always` has the unit of the quantity; those of the others are times, s (time
robustness: Donze & Maler 2010, "Robust Satisfaction of Temporal Logic over Real-Valued Signals").

Nothing here knows a trace: `desim.analysis.properties` computes the pieces of the step functions.
"""

import re
from collections.abc import Iterable, Iterator
from math import inf
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import BeforeValidator, Field, ValidationError

from desim.config.arguments import value_text
from desim.config.choice import OneOf
from desim.config.error_texts import text_of
from desim.config.errors import ArgumentError, cause_in
from desim.config.model import Time, Value
from desim.config.number_texts import exact_text
from desim.kernel.core.units import seconds
from desim.scenario.conditions import NUMBER, QUANTITIES, AnyScenario, Condition, ConditionText

SAMPLES = 0.05
"""Time between samples of positions, s, if a property needs them and the scenario records none."""


PropertyName = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class PropertyPiece(NamedTuple):
    """A time of positive length, ns, in which no condition of a property begins or ceases to hold."""

    begin: int
    end: int
    margins: tuple[float, ...]
    """The least margin of each condition during the piece; it holds if the margin is at least 0."""


class Worst(NamedTuple):
    """The worst part of a run so far, as a property sees it."""

    measure: float
    """What the property bounds: smaller is better; see `Property.bound`."""
    at: int
    """The time at which this part began, ns."""


class Property(Value):
    """Base of the properties: what a run should keep."""

    name: PropertyName | None = None
    """The name in tables and of its metric, `margin:NAME`; if absent, it is made from the text."""
    against: str | None = None
    """The kind of a protocol that is run in the same scenario with the same seed, as a reference. A time may then
    exceed that of the reference by the limit; `always` counts only if the reference keeps it. Without a reference, a
    search finds scenarios in which no protocol can do any better.

    If in doubt, use "centralised", which knows all and decides at once.
    """

    form: ClassVar[str]
    """The text of the kind, with the names of its keys in braces."""
    unit: ClassVar[str] = "s"
    """The unit of the margin."""
    least: ClassVar[float] = 0.0
    """The least measure there is: that of a run which ends as it begins."""

    condition: ConditionText
    """What the property is about, such as "idle" or "active <= 2"."""

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The conditions, in the order of `PropertyPiece.margins`."""
        return (self.condition,)

    @property
    def bound(self) -> float:
        """The largest measure (`Worst`) that keeps the property."""
        raise NotImplementedError

    def worst(self, pieces: Iterable[PropertyPiece]) -> Iterator[Worst]:
        """Yield the worst so far after each of the successive pieces of a run, in constant time for each."""
        raise NotImplementedError

    def margin(self, measure: float, reference: float | None = None) -> float:
        """Return the margin of a run, given its measure and, for a property against a reference, the reference's."""
        return self.bound - measure if reference is None else self.bound + reference - measure

    def can_fail(self, scenario: AnyScenario) -> bool:
        """Return whether a run of a scenario might violate the property."""
        raise NotImplementedError

    @property
    def text(self) -> str:
        """The property as a text without its name; `property_of` reads such texts."""
        parts = {key: exact_text(part, 6) if isinstance(part, float) else part for key, part in self}
        return self.form.format(**parts) + (f" against {self.against}" if self.against else "")

    @property
    def label(self) -> str:
        """The name, or a name made from the text."""
        return self.name or re.sub(r"\W+", "_", re.sub(r"\[(\d+)\]", r"_\1", self.text)).strip("_").lower()


class Always(Property):
    """A condition holds throughout the run."""

    kind: Literal["always"] = "always"

    form: ClassVar[str] = "always {condition}"
    unit: ClassVar[str] = ""
    least: ClassVar[float] = -inf

    @property
    def bound(self) -> float:
        """0: the measure is the margin of the condition, with the other sign."""
        return 0.0

    def worst(self, pieces: Iterable[PropertyPiece]) -> Iterator[Worst]:
        """Yield the largest violation of the condition so far."""
        worst = Worst(self.least, 0)
        for begin, _, (margin,) in pieces:
            if -margin > worst.measure:
                worst = Worst(-margin, begin)
            yield worst

    def margin(self, measure: float, reference: float | None = None) -> float:
        """Return the margin of the run or, if that is larger, the amount by which the reference violates the property.

        This is the robustness of "if the reference keeps the property, the run does".
        """
        return -measure if reference is None else max(-measure, reference)

    def can_fail(self, scenario: AnyScenario) -> bool:
        """Return whether the condition may be violated."""
        return bool(self.condition.can(scenario, hold=False))


class LimitedTime(Property):
    """Base of the properties that bound a time."""

    limit: Time
    """s"""

    @property
    def bound(self) -> float:
        """The limit, s."""
        return self.limit

    def can_fail(self, scenario: AnyScenario) -> bool:
        """Return whether the condition may hold for longer than the limit."""
        return bool(self.limit < scenario.horizon and self.condition.can(scenario, hold=True))


class Eventually(LimitedTime):
    """A condition holds for the first time within a limit; if it never holds, the end of the run counts."""

    kind: Literal["eventually"] = "eventually"

    form: ClassVar[str] = "eventually {condition} within {limit}"

    def worst(self, pieces: Iterable[PropertyPiece]) -> Iterator[Worst]:
        """Yield the time, s, for which the condition has not held."""
        waited, is_met = 0.0, False
        for _, end, (margin,) in pieces:
            is_met = is_met or margin >= 0.0
            waited = waited if is_met else seconds(end)
            yield Worst(waited, 0)

    def can_fail(self, scenario: AnyScenario) -> bool:
        """Return whether the condition may be violated for longer than the limit."""
        return bool(self.limit < scenario.horizon and self.condition.can(scenario, hold=False))


class LeadsTo(LimitedTime):
    """Whenever a condition holds, a second one holds within a limit; the end of the run counts as the second one."""

    kind: Literal["leads_to"] = "leads_to"
    then: ConditionText
    """The condition that should follow."""

    form: ClassVar[str] = "{condition} leads to {then} within {limit}"

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """Both conditions."""
        return self.condition, self.then

    def worst(self, pieces: Iterable[PropertyPiece]) -> Iterator[Worst]:
        """Yield the longest time, s, from an instant at which the first condition held to the second one."""
        worst, since = Worst(0.0, 0), None
        for begin, end, (first, then) in pieces:
            if then >= 0.0:
                since = None
            elif since is not None or first >= 0.0:
                since = begin if since is None else since
                if seconds(end - since) > worst.measure:
                    worst = Worst(seconds(end - since), since)
            yield worst

    def can_fail(self, scenario: AnyScenario) -> bool:
        """Return whether the second condition may be violated for longer than the limit after the first."""
        may = self.condition.can(scenario, hold=True) and self.then.can(scenario, hold=False)
        return bool(self.limit < scenario.horizon and may)


class NeverLonger(LimitedTime):
    """A condition never holds for longer than a limit at a stretch."""

    kind: Literal["never_longer"] = "never_longer"

    form: ClassVar[str] = "{condition} never longer than {limit}"

    def worst(self, pieces: Iterable[PropertyPiece]) -> Iterator[Worst]:
        """Yield the longest time, s, for which the condition has held at a stretch."""
        worst, since = Worst(0.0, 0), None
        for begin, end, (margin,) in pieces:
            if margin < 0.0:
                since = None
            else:
                since = begin if since is None else since
                if seconds(end - since) > worst.measure:
                    worst = Worst(seconds(end - since), since)
            yield worst


class InTotal(LimitedTime):
    """A condition holds for at most a limit in total."""

    kind: Literal["in_total"] = "in_total"

    form: ClassVar[str] = "{condition} at most {limit} in total"

    def worst(self, pieces: Iterable[PropertyPiece]) -> Iterator[Worst]:
        """Yield the time, s, for which the condition has held, and the beginning of the longest piece."""
        total, at, longest = 0, 0, 0
        for begin, end, (margin,) in pieces:
            if margin >= 0.0:
                total += end - begin
                if end - begin > longest:
                    at, longest = begin, end - begin
            yield Worst(seconds(total), at)


_KINDS = Always, Eventually, LeadsTo, NeverLonger, InTotal
KINDS = OneOf(*_KINDS, is_closed=True)
"""The kinds of properties."""


def _filled(form: str, **texts: str) -> str:
    """Return the form of a kind with other texts in place of its keys."""
    return re.sub(r"{(\w+)}", lambda key: texts[key[1]], form)


_PATTERNS = {
    kind.model_fields["kind"].default: re.compile(
        _filled(
            kind.form,
            condition="(?P<condition>.+?)",
            then="(?P<then>.+?)",
            limit=rf"(?P<limit>{NUMBER})(?:\s*s)?",
        )
    )
    for kind in _KINDS
}
*_FIRST, _LAST = (
    f'"{_filled(kind.form, condition="CONDITION", then="CONDITION", limit="SECONDS")}"' for kind in _KINDS
)
TEXTS = (
    f'{", ".join(_FIRST)} or {_LAST}, after "NAME: " if it has a name, and before "against PROTOCOL" if it has a'
    " reference"
)


def as_table(text: Any) -> Any:
    """Return the table that the text of a property stands for; return any other value unchanged.

    Raises:
        ValueError: if the text is not that of a property.
    """
    if not isinstance(text, str):
        return text
    whole = " ".join(text.split())
    name = re.match(r"([A-Za-z_]\w*): ", whole)
    reference = re.search(r" against (\S+)$", whole)
    statement = whole[name.end() if name else 0 : reference.start() if reference else None].strip()
    for kind, pattern in _PATTERNS.items():
        if match := pattern.fullmatch(statement):
            parts: dict[str, Any] = {key: part for key, part in match.groupdict().items() if part is not None}
            if "limit" in parts:
                parts["limit"] = float(parts["limit"])
            named = {"name": name[1]} if name else {}
            return {"kind": kind, **named, **parts, **({"against": reference[1]} if reference else {})}
    raise ValueError(f"should be {TEXTS} (got {text!r})")


PropertyField = Annotated[Any, KINDS, BeforeValidator(as_table)]
"""A property: its table, or its text."""


class _One(Value):
    """A property alone, to be validated without a scenario."""

    one: PropertyField


def property_of(value: Any, *, folder: Any = None) -> Property:
    """Return the property that a text or a table states, which may name functions; return a property unchanged.

        property_of("idle never longer than 2 against centralised")

    Args:
        value: the text, the table or the property.
        folder: the folder in which modules are looked up.

    Raises:
        ValueError: if the value is not the text or the table of a property.
    """
    if value is None or isinstance(value, int | float):
        raise ValueError(f"a property should be a text, such as 'idle at most 2 in total' (got {value_text(value)})")
    try:
        made: Property = _One.model_validate({"one": value}, context={"allow_import": True, "folder": folder}).one
    except ValidationError as error:
        why = "; ".join(map(text_of, error.errors()))
        raise ArgumentError("property", f"{value_text(value)}: {why}") from cause_in(error)
    return made


def recording(scenario: AnyScenario, properties: Iterable[Property]) -> AnyScenario:
    """Return a scenario that records what some properties need: messages, and positions every 0.05 s or as given."""
    conditions = (condition for prop in properties for condition in prop.conditions)
    quantities = {comparison.quantity for condition in conditions for comparison in condition.comparisons}
    needs = {QUANTITIES[name].needs for name in quantities & QUANTITIES.keys()}
    record = scenario.record
    changes: dict[str, Any] = {"messages": True} if "messages" in needs and record.messages is not True else {}
    if "trajectory" in needs and not record.trajectory:
        changes["trajectory"] = SAMPLES
    return scenario.model_copy(update={"record": record.model_copy(update=changes)}) if changes else scenario


CANNOT_FAIL = "no run of this scenario can violate it: its condition cannot turn, or its limit is not below the horizon"
"""Why a property says nothing."""

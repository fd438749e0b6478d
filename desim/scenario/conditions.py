"""Conditions on quantities of a run, such as "active <= 2 and not idle": what a property is about.

Nothing here knows a trace: `desim.analysis.quantities` computes the quantities of a run.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, isnan, nextafter
from operator import eq, ge, gt, le, lt, ne
from types import FunctionType, MappingProxyType
from typing import Annotated, Any, NamedTuple

from pydantic import PlainSerializer, PlainValidator, ValidationInfo, WithJsonSchema

from desim.config.arguments import value_text
from desim.config.calls import check_argument
from desim.config.named_code import import_name, named_in_file
from desim.config.suggestion import did_you_mean

AnyScenario = Any
"""A `desim.scenario.scenario.Scenario`, whose module imports this one."""


class Quantity(NamedTuple):
    """A step function of time that a property may compare with a number."""

    text: str
    """What it is, as the end of a sentence that begins with its name."""
    most: Callable[[AnyScenario], float] = lambda _: inf
    """Returns its largest possible value in a scenario; the least is 0."""
    by_evader: bool = False
    """Whether a property may also have `name[j]`, the same quantity for evader j alone."""
    needs: str = ""
    """The key of `record` without which a trace does not have it."""


def _pursuers(scenario: AnyScenario) -> float:
    return float(scenario.team.count)


def _evaders(scenario: AnyScenario) -> float:
    return float(len(scenario.evaders))


QUANTITIES: Mapping[str, Quantity] = MappingProxyType(
    {
        "active": Quantity("the number of pursuers that chase an evader", _pursuers, by_evader=True),
        "idle": Quantity("the number of evaders at large that no pursuer chases", _evaders, by_evader=True),
        "crowded": Quantity(
            "the number of evaders at large that more than one pursuer chases", _evaders, by_evader=True
        ),
        "captured": Quantity("the number of captured evaders", _evaders, by_evader=True),
        "down": Quantity("the number of pursuers whose robot is down", _pursuers),
        "waiting": Quantity("the time since the last decision of any pursuer, s"),
        "misassigned": Quantity(
            "1 while not the relay pursuer alone chases each evader, else 0", lambda _: 1.0, needs="trajectory"
        ),
        "wrong_beliefs": Quantity(
            "the number of pairs of pursuers of which one has a wrong record of the action of the other",
            lambda scenario: _pursuers(scenario) * (_pursuers(scenario) - 1.0),
            needs="messages",
        ),
        "disagreements": Quantity(
            "the number of pursuers of whose action two teammates have unlike records", _pursuers, needs="messages"
        ),
        "age": Quantity(
            "the greatest age of the newest record that a pursuer has of another, s; 0 for one pursuer alone",
            needs="messages",
        ),
    }
)
"""The quantities by name; a function of a user is named "module:name"."""
COMPARISONS: Mapping[str, Callable[[Any, Any], bool]] = MappingProxyType(
    {"<=": le, ">=": ge, "==": eq, "!=": ne, "<": lt, ">": gt}
)
JUST_BELOW_0 = nextafter(0.0, -inf)
"""The margin of "<", ">" and "!=" between equal numbers; not 0, because a margin of 0 means that a comparison holds."""
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_COMPARISON = re.compile(
    rf"(?P<negation>not\s+)?(?P<quantity>[A-Za-z_][\w.]*(?::\w+)?)(?:\[(?P<evader>\d+)\])?"
    rf"(?:\s*(?P<sign><=|>=|==|!=|<|>)\s*(?P<number>{NUMBER}))?"
)
CONDITION_FORM = 'comparisons such as "idle", "not idle", "active[1] <= 1" or "idle == 0 and crowded == 0"'


@dataclass(frozen=True)
class QuantityComparison:
    """A quantity compared with a number."""

    quantity: str
    """The name of the quantity, "module:name" for a function of a user."""
    evader: int | None
    """The evader, 1 .. M; None: all."""
    sign: str
    number: float
    of: Callable[[Any], Any] | None = None
    """The function of a user; None for one of `QUANTITIES`."""

    def holds(self, value: float) -> bool:
        """Return whether a value of the quantity satisfies the comparison."""
        return COMPARISONS[self.sign](value, self.number)

    def margin(self, value: float) -> float:
        """Return how far a value is from the other side: at least 0 if and only if it satisfies the comparison."""
        signed = {
            "<": self.number - value,
            ">": value - self.number,
            "=": -abs(value - self.number),
            "!": abs(value - self.number),
        }[self.sign[0]]
        holds = self.holds(value)
        if isnan(signed):  # a function of a user returned nan, or both numbers are infinite
            return 0.0 if holds else -inf
        return signed if (signed >= 0.0) == holds else JUST_BELOW_0

    def can(self, scenario: AnyScenario, *, hold: bool) -> bool:
        """Return whether some value of the quantity in a scenario satisfies the comparison; if not `hold`, violates it.

        A comparison changes at its number only, so five values suffice: the least and the greatest, the number, and one
        on each side of it.
        """
        most = QUANTITIES[self.quantity].most(scenario) if self.of is None else inf
        if self.evader is not None and self.quantity != "active":  # of one evader, the quantity is 0 or 1
            most = 1.0
        least = 0.0 if self.of is None else -inf
        near = (value for value in (self.number - 1.0, self.number, self.number + 1.0) if least <= value <= most)
        return any(self.holds(value) == hold for value in (least, most, *near))


@dataclass(frozen=True)
class Condition:
    """Comparisons that hold together."""

    text: str
    comparisons: tuple[QuantityComparison, ...]

    def __str__(self) -> str:
        return self.text

    def can(self, scenario: AnyScenario, *, hold: bool) -> bool:
        """Return whether the condition may be satisfied or, if not `hold`, violated in a scenario."""
        return (all if hold else any)(comparison.can(scenario, hold=hold) for comparison in self.comparisons)


def _condition(value: Any, info: ValidationInfo) -> Condition:
    """Return the condition that a text states.

    Raises:
        ValueError: if the text is no condition, or names a quantity that does not exist or code that is not trusted.
    """
    if isinstance(value, Condition):
        return value
    if isinstance(value, FunctionType):  # a function of Python stands for the comparison "it is positive"
        name = import_name(value)
        check_argument(value, ("result",), repr(name))
        return Condition(name, (QuantityComparison(name, None, ">", 0.0, value),))
    if not isinstance(value, str):
        raise ValueError(f"should be {CONDITION_FORM} (got {value_text(value)})")
    text = " ".join(value.split())
    return Condition(text, tuple(_comparison(part, info) for part in re.split(r"\s+and\s+", text)))


def _comparison(text: str, info: ValidationInfo) -> QuantityComparison:
    match = _COMPARISON.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"should be {CONDITION_FORM} (got {text!r})")
    name, sign = match["quantity"], match["sign"] or ("==" if match["negation"] else ">")
    if match["negation"] and match["sign"]:
        raise ValueError(f"not belongs before a quantity alone, as in not idle (got {text!r})")
    evader = None if match["evader"] is None else int(match["evader"])
    of = None
    if ":" in name:
        of = named_in_file(name, info)
        check_argument(of, ("result",), repr(name))
    elif name not in QUANTITIES:
        raise ValueError(
            f"there is no quantity {name!r}{did_you_mean(name, QUANTITIES)}; there are {', '.join(QUANTITIES)},"
            ' and functions of a result as "module:name"'
        )
    if evader is not None and (of is not None or not QUANTITIES[name].by_evader):
        by_evader = ", ".join(quantity for quantity, note in QUANTITIES.items() if note.by_evader)
        raise ValueError(f"only {by_evader} may be of one evader (got {text!r})")
    return QuantityComparison(name, evader, sign, float(match["number"] or 0.0), of)


ConditionText = Annotated[
    Any,
    PlainValidator(_condition),
    PlainSerializer(lambda condition: condition.text, return_type=str),
    WithJsonSchema({"type": "string"}),
]
"""A condition, as a text."""

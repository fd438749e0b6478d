"""Metrics that a scenario names, beside the built-in ones: a user's functions, and the margins of its properties."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from keyword import iskeyword
from types import FunctionType
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, PlainSerializer, PlainValidator, ValidationInfo, WithJsonSchema

from desim.config.arguments import value_text
from desim.config.calls import check_argument
from desim.config.named_code import import_name, load_named, named_in_file
from desim.config.packages import MARGINS
from desim.config.suggestion import did_you_mean

GROUP = "desim.metrics"
"""The entry point group of installed metrics."""


MARGIN = "margin:"
"""The beginning of the name of a metric that is the margin of a property."""


@dataclass(frozen=True)
class PropertyMargin:
    """The margin of a property of the scenario of a run, by the name of the property."""

    name: str

    def __call__(self, result: Any) -> float:
        """Return the margin; see `desim.analysis.properties.margin`."""
        return MARGINS["margin"](result, self.name)


class NamedMetric(BaseModel):
    """A function of the result of a run, and its name."""

    model_config = ConfigDict(frozen=True)

    name: str
    """The name of the metric in tables."""
    given: str
    """The name in scenario files: "module:name", the name of an installed metric, or "margin:NAME"."""
    of: Callable[[Any], Any]


def installed_metrics() -> Mapping[str, EntryPoint]:
    """Return the entry points of the installed metrics by name."""
    return {point.name: point for point in sorted(entry_points(group=GROUP), key=lambda point: point.name)}


def _named(value: Any, info: ValidationInfo) -> NamedMetric:
    """Return the metric given as a function or a name.

    An untrusted scenario may name only listed code; see `desim.config.named_code.is_unlisted_import`.

    Raises:
        ValueError: if the value is neither a function of one argument nor the name of such a function, or if the code
            is not trusted or cannot be imported.
    """
    if isinstance(value, NamedMetric):
        return value
    if isinstance(value, FunctionType):
        _check_called(value.__name__, value)
        check_metric_name(value.__name__)
        return NamedMetric(name=value.__name__, given=import_name(value), of=value)
    if not isinstance(value, str):
        also = "; `sweep` and `summary` take any callable as metrics={NAME: callable}" if callable(value) else ""
        raise ValueError(
            f'should be a function, "module:name" or the name of an installed metric{also} (got {value_text(value)})'
        )
    if value.startswith(MARGIN):
        name = value.removeprefix(MARGIN)
        check_metric_name(name)
        return NamedMetric(name=name, given=value, of=PropertyMargin(name))
    if ":" in value:
        name, of = value.rpartition(":")[2], named_in_file(value, info)
    elif value in (installed := installed_metrics()):
        name, of = value, load_named(f"{installed[value].module}:{installed[value].attr}", None)
    else:
        names = ", ".join(['"module:name"', '"margin:NAME" of a property', *installed])
        raise ValueError(
            f"there is no installed metric {value!r}{did_you_mean(value, installed)}; allowed: {names}; the built-in"
            " metrics are in every summary"
        )
    _check_called(value, of)
    check_metric_name(name)
    return NamedMetric(name=name, given=value, of=of)


def check_metric_name(name: Any) -> None:
    """Raise ValueError if a metric cannot have a name, because it could be no column of a table.

    A lambda has such a name: give it another one in `metrics={NAME: callable}` of `sweep` and `summary`.
    """
    if not (isinstance(name, str) and name.isascii() and name.isidentifier()) or iskeyword(name):
        is_lambda = name == "<lambda>"
        hint = ": define it with def, or give it a name, metrics={'late': lambda result: ...}" if is_lambda else ""
        raise ValueError(f"the name of a metric should be a Python identifier in ASCII, got {value_text(name)}{hint}")


def _check_called(name: str, of: Any) -> None:
    """Raise ValueError if an object cannot be called with one argument, or is a class."""
    if isinstance(of, type):
        raise ValueError(f"{name!r} should be a function of a result (got {value_text(of)})")
    check_argument(of, ("result",), repr(name))


MetricName = Annotated[
    Any,
    PlainValidator(_named),
    PlainSerializer(lambda metric: metric.given, return_type=str),
    WithJsonSchema({"type": "string"}),
]
"""A metric that a scenario names: a function, or a text of a form of `NamedMetric.given`."""

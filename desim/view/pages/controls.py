"""The controls with which `desim play` changes the keys of a scenario, made from the models of scenario files."""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from math import inf, isinf
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from desim.config.choice import OneOf, choices_of
from desim.config.field_docs import fields_of, unit_in
from desim.config.model_parts import markers_of, models_in
from desim.config.named_code import definition_of, import_name
from desim.scenario.named_metrics import NamedMetric
from desim.scenario.scenario import Scenario

Form = Literal["kind", "choice", "flag", "integer", "number", "text"]
"""The form of a control; see `Control.form`."""
FIRST = (
    "network.latency",
    "network.loss",
    "network.range",
    "team.count",
    "announce.heartbeat",
    "protocol",
    "protocol.schedule",
    "evader.strategy",
    "seed",
)
"""The keys that come first, in this order.

If the value of a key is a model with a kind, the parameters of the model follow the key; `protocol` is an exception.
"""
BY_UNIT: Mapping[str, tuple[float, float]] = {"s": (0.001, 10.0), "1/s": (0.1, 100.0), "m": (0.1, 100.0)}
"""The ends of the logarithmic slider of a key, by its unit."""
LINEAR: Mapping[str, tuple[float, float]] = {"team.count": (1.0, 60.0)}
"""The ends of the linear sliders of keys that have no upper bound."""
WIDEST = 1000.0
"""A number whose bounds differ by at most this much has a linear slider."""

BARE = re.compile(r"(?!(?:inf|nan|true|false)$)[A-Za-z_][\w:. -]*")
"""A text that needs no quotes in `--set`."""


@dataclass(frozen=True)
class Slider:
    """A slider for a number."""

    low: float
    high: float
    is_log: bool = False
    """Whether the slider is logarithmic: equal distances are equal ratios."""
    at_low: float | None = None
    """The value at the lower end if it is not `low`, namely 0 on a logarithmic slider; None = `low`."""
    at_high: float | None = None
    """The value at the upper end if it is not `high`, namely inf; None = `high`."""


@dataclass(frozen=True)
class Control:
    """The control of one key."""

    key: str
    """The dotted key, as in `--set`."""
    form: Form
    """kind: the kind of a model; choice: one of several texts; flag: true or false; integer, number: a number; text:
    any other value."""
    value: str
    """The present value as in `--set`; "" for none."""
    help: str
    unit: str = ""
    options: tuple[str, ...] = ()
    """The possible values of a kind or a choice; for a text, suggestions."""
    needs_file: tuple[str, ...] = ()
    """The kinds that need a file, or its content, so that a page cannot choose them."""
    example: str = ""
    """An example of a value that is no number, text or kind; "" if there is none."""
    low: float | None = None
    """The lower bound of a number, which may itself be excluded; None if there is none."""
    high: float | None = None
    """The upper bound of a number, which may itself be excluded; None if there is none."""
    slider: Slider | None = None
    first: int | None = None
    """The position in `FIRST` of the key, or of the model whose parameter it is; None for all others."""


def controls(scenario: Scenario | Mapping[str, Any]) -> list[Control]:
    """Return a control for each key of a scenario except its sweep, first the controls of `FIRST`.

    The scenario is given as a model or, if it is not valid, as tables.
    """
    unsorted = _controls(Scenario, dict(scenario) if isinstance(scenario, Scenario) else scenario, ())
    return sorted(unsorted, key=lambda control: len(FIRST) if control.first is None else control.first)


def _controls(model: type[BaseModel], values: Mapping[str, Any], above: tuple[str, ...]) -> Iterator[Control]:
    """Yield the controls of the fields of a model, given their values, and the place of the model in the file."""
    for name, field in fields_of(model).items():
        if name in {"kind", "sweep"}:
            continue
        default = None if field.is_required() else field.get_default(call_default_factory=True)
        value = values.get(name, default)
        if isinstance(value, list | tuple):
            value = [metric.given if isinstance(metric, NamedMetric) else metric for metric in value]
        has_tables = isinstance(value, list) and value and all(isinstance(entry, BaseModel | dict) for entry in value)
        for k, entry in enumerate(value) if has_tables else [(None, value)]:
            place = (*above, name) if k is None else (*above, name, str(k))
            yield from _of_value(field, entry, place)


def _of_value(field: FieldInfo, value: Any, place: tuple[str, ...]) -> Iterator[Control]:
    """Yield the controls of one value of a field.

    A model has a control of its kind, if it has one, and then the controls of its keys. Any other value has one
    control. There is no control for None in a field that takes kinds, and none for a text of several lines.
    """
    choice, only_model = next(iter(choices_of(field)), None), next(models_in(field.annotation), None)
    inner: type[BaseModel] | None = type(value) if isinstance(value, BaseModel) else only_model
    if isinstance(value, str) and "\n" in value:  # a field of a page has one line
        return
    if isinstance(value, list | tuple):
        yield _control(place, "text", as_text(value), field)
        return
    if choice is not None:
        if value is None:
            return
        kind, inner = _kind(choice, value)
        kinds = tuple(choice.choices())
        needs_file = tuple(name for name in kinds if name != kind and _needs_file(choice.choice(name)))
        yield _control(place, "kind", kind, field, options=kinds, needs_file=needs_file)
        if not isinstance(value, BaseModel | dict) and choice.number is not None and not isinstance(value, str):
            value = {choice.number[1]: value}
    elif not isinstance(value, BaseModel | dict) or {*_types(field.annotation)} <= {bool, int, float, str, NoneType}:
        yield _scalar(place, field, value)  # the value may be a table that was typed in place of a number
        return
    if inner is not None:
        yield from _controls(inner, dict(value) if isinstance(value, BaseModel | dict) else {}, place)


def _kind(choice: OneOf, value: Any) -> tuple[str, type[BaseModel] | None]:
    """Return the kind of a value, and the class of the model of this kind; None if there is no such class.

    The value is a model, a table, a bare kind, a bare number, or a user's function or callable object.
    """
    if isinstance(value, BaseModel):
        kind = dict(value).get("kind")
        return (kind if isinstance(kind, str) else import_name(type(value))), type(value)
    if isinstance(value, dict | str):
        kind = str(value.get("kind", "")) if isinstance(value, dict) else value
        return kind, choice.choice(kind)
    if choice.number is not None and isinstance(value, int | float):
        return choice.number[0], choice.choice(choice.number[0])
    return import_name(definition_of(value)), None


@cache
def _needs_file(model: type[BaseModel] | None) -> bool:
    """Return whether a model reads a file, or takes its content as a parameter, and has no default for it."""
    if model is None or "file" not in model.model_fields:
        return False
    try:
        model()
    except ValueError:
        return True
    return False


def _example(field: FieldInfo) -> str:
    """Return an example of a pair of numbers, or of a list of pairs or numbers; "" for other values."""
    for kind in _types(field.annotation):
        items = get_args(kind) if get_origin(kind) is tuple else ()
        if list(map(_is_number, items)) == [True, True]:
            return "[0, 20]"
        if len(items) == 2 and items[1] is Ellipsis:
            inner = get_args(items[0]) if get_origin(items[0]) is tuple else ()
            if list(map(_is_number, inner)) == [True, True]:
                return "[[0, 0], [10, 5]]"
            if _is_number(items[0]):
                return "[1, 2.5]"
    return ""


def _is_number(annotation: Any) -> bool:
    return annotation is not Ellipsis and any(kind in (int, float) for kind in _types(annotation))


def _scalar(place: tuple[str, ...], field: FieldInfo, value: Any) -> Control:
    """Return the control of a value that is no model."""
    types = [kind for kind in _types(field.annotation) if kind is not NoneType]
    options = tuple(as_text(text) for kind in types if get_origin(kind) is Literal for text in get_args(kind))
    if types == [bool]:
        return _control(place, "flag", as_text(value), field)
    if options or types not in ([int], [float]):
        is_choice = all(get_origin(kind) is Literal for kind in types)
        return _control(place, "choice" if is_choice else "text", as_text(value), field, options=options)
    low, high, may_be_low = _bounds(field)
    slider = _slider(".".join(place), unit_in(field), low, high, value, may_be_low=may_be_low)
    bounds = {"low": None if isinf(low) else low, "high": None if isinf(high) else high}
    return _control(place, "integer" if types == [int] else "number", as_text(value), field, slider=slider, **bounds)


def _bounds(field: FieldInfo) -> tuple[float, float, bool]:
    """Return the bounds of a number (-inf and inf if it has none), and whether it may equal the lower bound."""
    low, high, may_be_low = -inf, inf, True
    for marker in markers_of(field):
        if isinstance(marker, Ge | Gt):
            low, may_be_low = float(marker.ge if isinstance(marker, Ge) else marker.gt), isinstance(marker, Ge)  # type: ignore[arg-type]
        elif isinstance(marker, Le | Lt):
            high = float(marker.le if isinstance(marker, Le) else marker.lt)  # type: ignore[arg-type]
    return low, high, may_be_low


def _types(annotation: Any) -> list[Any]:
    """Return the types that the value of an annotation may have, without the item types of tuples, lists and dicts."""
    if get_origin(annotation) in {None, tuple, list, dict, Literal}:
        return [annotation]
    if get_origin(annotation) is Annotated:
        return _types(get_args(annotation)[0])
    return [kind for inner in get_args(annotation) for kind in _types(inner)]


def _slider(key: str, unit: str | None, low: float, high: float, value: Any, *, may_be_low: bool) -> Slider | None:
    """Return the slider of a number; None if it has none, or if the value is not on it."""
    if key in LINEAR:
        slider = Slider(*LINEAR[key])
    elif high - low <= WIDEST:
        slider = Slider(low, high)
    elif unit is not None and unit in BY_UNIT and low >= 0.0:
        at_low, at_high = 0.0 if low == 0.0 and may_be_low else None, inf if isinf(high) else None
        slider = Slider(*BY_UNIT[unit], is_log=True, at_low=at_low, at_high=at_high)
    else:
        return None
    is_number = isinstance(value, int | float) and not isinstance(value, bool)  # a user may type any TOML value
    is_on_slider = is_number and (slider.low <= value <= slider.high or value in {slider.at_low, slider.at_high})
    return slider if is_on_slider else None


def _control(place: tuple[str, ...], form: Form, value: str, field: FieldInfo, **options: Any) -> Control:
    """Return a control of a value as text, with further fields of `Control`."""
    text = " ".join((field.description or "").split())
    if form == "text":
        options = {"example": _example(field)} | options
    return Control(".".join(place), form, value, text, unit_in(field) or "", first=_first(place), **options)


def _first(place: tuple[str, ...]) -> int | None:
    """Return the position of a place among the keys that come first; see `Control.first`."""
    key = ".".join(part for part in place if not part.isdigit())
    above = key.rpartition(".")[0]
    return FIRST.index(key) if key in FIRST else FIRST.index(above) if above in FIRST and above != "protocol" else None


def as_text(value: Any) -> str:
    """Return a value as in `--set`; "" for None."""
    if value is None:
        return ""
    if isinstance(value, str):
        return value if BARE.fullmatch(value) else json.dumps(value)
    if isinstance(value, bool | list | tuple):
        return json.dumps(value).replace("Infinity", "inf")
    return f"{value:g}" if isinstance(value, float) and value == float(f"{value:g}") else str(value)

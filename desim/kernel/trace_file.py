"""Trace files: one line of JSON per event, with times in seconds instead of integer nanoseconds.

Numbers that are not finite are written as in Python's `json`: Infinity, -Infinity and NaN.
"""

import json
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from keyword import iskeyword
from math import isfinite
from pathlib import Path
from types import MappingProxyType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Self, Union, get_args, get_origin, get_type_hints
from unicodedata import is_normalized

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError

from desim.config.json_numbers import field_names, has_plain
from desim.kernel.clock import SECOND, nanoseconds
from desim.kernel.events import LOST, Arrival, Body, Event, Nanoseconds

Limits = Mapping[str, Any]
"""Additional pydantic constraints by mark (see `desim.kernel.events`), for instance {"node": Field(lt=5)}."""


class TraceFile:
    """A watcher that writes each event to a file as it happens, messages included, and stores none in memory.

        with TraceFile("trace.jsonl") as file:
            run(scenario, seed, file)

    The events are written to trace.jsonl.part, which is renamed to trace.jsonl at the end. After an error the .part
    file remains, and an older trace.jsonl is not replaced.

    Args:
        path: the path of the file.
    """

    def __init__(self, path: str | Path):
        self._path = Path(path)
        self._part = self._path.with_name(self._path.name + ".part")

    def __enter__(self) -> Self:
        self._file = self._part.open("w", encoding="utf-8", newline="\n")
        return self

    def __call__(self, event: Event) -> None:
        """Write an event."""
        self._file.write(line_of(event))

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        self._file.close()
        if error is None:
            self._part.replace(self._path)


def line_of(event: Event) -> str:
    """Return an event as one line of JSON (with Infinity and NaN): its type and its fields, with times in seconds.

    The arrival time of a lost message, `LOST`, is written as null.
    """
    text, fields = _line_layout(type(event))
    for value, (key, write) in zip(event, fields, strict=True):
        text += key + write(value)
    return text + "}\n"


def events_of(
    lines: Iterable[str], kinds: Iterable[type[Any]], limits: Limits = MappingProxyType({}), first: int = 1
) -> Iterator[Event]:
    """Yield the events of a trace file line by line, so that a long trace need not fit in memory.

    Each value is validated against the annotation of its field. A list becomes a tuple. An object in a body becomes a
    named tuple if its keys are valid field names. A named tuple that was sent as a body equals the one that is read,
    although their types differ.

    Args:
        lines: the lines of the file.
        kinds: the allowed types of events.
        limits: additional constraints by mark, such as an upper bound of the node ids.
        first: the number of the first line.

    Raises:
        ValueError: if a line is not an event; the error message contains the number of the line.
    """
    types = {kind.__name__: kind for kind in kinds}
    readers: dict[str, Callable[[Any], Event]] = {}
    for number, line in enumerate(lines, start=first):
        try:
            fields = json.loads(line)
            name = fields.pop("event", None) if isinstance(fields, dict) else None
            if not (isinstance(name, str) and name in types):
                raise ValueError(f"should be an object whose key event is one of {', '.join(types)}")
            if name not in readers:
                readers[name] = _reader(types[name], limits)
            event = readers[name](fields)
        except (ValueError, RecursionError) as error:
            raise ValueError(f"line {number} is not an event: {_reason(error)}") from error
        yield event


_json = json.JSONEncoder(default=repr).encode
_number = float.__repr__
Written = tuple[str, Callable[[Any], str]]
"""The text before the value of a field, and the function that writes the value."""


@cache
def _line_layout(kind: Any) -> tuple[str, tuple[Written, ...]]:
    """Return the layout of the lines of an event type: the start of a line, and its fields."""
    hints = get_type_hints(kind, include_extras=True)
    fields = ((f", {_json(name)}: ", _writer(hints[name])) for name in kind._fields)
    return f'{{"event": {_json(kind.__name__)}', tuple(fields)


def _writer(hint: Any) -> Callable[[Any], str]:
    """Return the function that converts the value of a field to JSON, given the type of the field."""
    is_time = any(each in {Nanoseconds, Arrival} for each in (hint, *get_args(hint)))
    return _time_json if is_time else _body_json if hint is Body else _as_json


def _time_json(time: Any) -> str:
    if isinstance(time, tuple):
        if LOST in time:
            return f"[{', '.join(map(_time_json, time))}]"
        return str([each / SECOND for each in time])  # the same text as JSON, twice as fast
    return "null" if time == LOST else _number(time / SECOND)


def _as_json(value: Any) -> str:
    """Return a value as JSON; an object without a JSON form is written as its `repr`, infinity as Infinity."""
    if type(value) is int:
        return repr(value)
    return _json(value.plain() if has_plain(value.__class__) else value)


def _body_json(value: Any) -> str:
    """Return a body as JSON."""
    return _as_json(value) if has_plain(value.__class__) else _nested(value)


def _nested(value: Any) -> str:
    """Return a value as JSON, with named tuples as objects."""
    if isinstance(value, dict):
        return f"{{{', '.join([f'{_key_json(key)}: {_nested(each)}' for key, each in value.items()])}}}"
    if isinstance(value, tuple | list):
        names = field_names(value.__class__)
        if names is None:
            return f"[{', '.join(map(_nested, value))}]"
        return f"{{{', '.join([f'{_json(name)}: {_nested(each)}' for name, each in zip(names, value, strict=True)])}}}"
    if value is True or value is False:
        return "true" if value else "false"
    return _number(value) if type(value) is float and isfinite(value) else _json(value)


def _key_json(key: Any) -> str:
    """Return the key of a dict as JSON, a string: a key without a JSON form is written as its `repr`."""
    if isinstance(key, str):
        return _json(key)
    return _json(_json(key) if isinstance(key, int | float | None) else repr(key))


def _reader(kind: Any, limits: Limits) -> Callable[[Any], Event]:
    """Return a function that validates the fields of a JSON object and creates an event of a type."""
    fields = [(name, _as_read(hint, limits)) for name, hint in get_type_hints(kind, include_extras=True).items()]
    make: Any = NamedTuple
    validate = TypeAdapter(make(kind.__name__, fields)).validator.validate_python
    return lambda values: kind._make(validate(values))


def _as_read(hint: Any, limits: Limits) -> Any:
    """Return the pydantic type that reads the JSON value of a field, given the type of the field."""
    if hint in _NUMBERS:
        return _NUMBERS[hint]
    if get_origin(hint) is Annotated:
        inner, mark = get_args(hint)
        if not isinstance(mark, str):
            return Annotated[_as_read(inner, limits), mark]
        own = _MARKED.get(mark) or _as_read(inner, limits)
        return Annotated[own, limits[mark]] if mark in limits else own
    if get_origin(hint) in {None, Literal}:
        return hint
    parts = tuple(_as_read(each, limits) for each in get_args(hint))
    return Union[parts] if get_origin(hint) in {Union, UnionType} else get_origin(hint)[parts]  # noqa: UP007


def _reason(error: Exception) -> str:
    """Return the message of an error; for a validation error, its first problem on one line."""
    if not isinstance(error, ValidationError):
        return str(error)
    fault = error.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}"


def _with_named_tuples(value: Any) -> Any:
    """Return a JSON value with lists as tuples; an object whose keys are valid field names becomes a named tuple."""
    if isinstance(value, list):
        return tuple(map(_with_named_tuples, value))
    if not isinstance(value, dict):
        return value
    fields = {name: _with_named_tuples(each) for name, each in value.items()}
    return _body_type(tuple(fields))(**fields) if all(map(_is_field_name, fields)) else fields


def _is_field_name(name: str) -> bool:
    """Return whether a key can be a field of a named tuple; Python reads a name that is not in NFKC as another one."""
    return name.isidentifier() and not name.startswith("_") and not iskeyword(name) and is_normalized("NFKC", name)


@cache
def _body_type(names: tuple[str, ...]) -> Callable[..., Any]:
    """Return the named tuple type of bodies with these fields."""
    make: Any = namedtuple
    kind: Callable[..., Any] = make("Body", names)
    return kind


def _arrival(time: float | None) -> int:
    return LOST if time is None else nanoseconds(time)


_SECONDS = Annotated[float, Field(strict=True, ge=0.0, le=9e9, allow_inf_nan=False)]  # ns fit in 64 bits
_NUMBERS: Mapping[Any, Any] = {
    int: Annotated[int, Field(strict=True)],
    float: Annotated[float, Field(strict=True, ge=-1e30, le=1e30, allow_inf_nan=False)],  # its square is finite
}
_MARKED: Mapping[str, Any] = {
    "time": Annotated[_SECONDS, AfterValidator(nanoseconds)],
    "arrival": Annotated[_SECONDS | None, AfterValidator(_arrival)],
    "node": Annotated[int, Field(strict=True, ge=0)],
    "count": Annotated[int, Field(strict=True, ge=0, le=1 << 48)],
    "body": Annotated[Any, AfterValidator(_with_named_tuples)],
}
"""The pydantic type that validates the JSON value of a field, by the mark of the field's type."""

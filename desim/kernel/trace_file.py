"""A trace as a file: a line of JSON for each event, with times in seconds where memory has integer nanoseconds."""

import json
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from keyword import iskeyword
from math import isfinite
from pathlib import Path
from typing import Any, Self

from desim.kernel.clock import SECOND, nanoseconds
from desim.kernel.events import LOST, Event

Kinds = Mapping[str, Callable[..., Event]]
"""What makes an event of its fields, by the name of its type."""


class TraceFile:
    """A watcher that writes every event to a file as it happens, and keeps none: the lines of a trace with messages.

        with TraceFile("trace.jsonl") as file:
            run(scenario, seed, file)

    Until it is complete the file is called NAME.part; one that was never completed stays, and what had that name does.

    Args:
        path: of the file.
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
    """Return an event as one line of JSON: its type, then its fields with times in seconds (null: never).

    A field that has its default is left out.
    """
    text, fields = _form(type(event))
    for value, (key, write, default) in zip(event, fields, strict=True):
        if default is _REQUIRED or value != default:
            text += key + write(value)
    return text + "}\n"


def events_of(lines: Iterable[str], kinds: Kinds) -> Iterator[Event]:
    """Yield the events of which these are the `lines`, one by one, so that a long trace need not fit in memory.

    Lists come back as tuples, and a body with fields as a named tuple of them: equal to that which was sent, but of
    another type.

    Args:
        lines: of JSON.
        kinds: of events that there may be.

    Raises:
        ValueError: with the number of the line that is no event.
    """
    for number, line in enumerate(lines, start=1):
        try:
            fields = json.loads(line)
            kind = kinds[fields.pop("event")]
            event = kind(**{name: _read(name, value) for name, value in fields.items()})
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise ValueError(f"line {number} is no event: {error}") from error
        yield event


_TIMES = frozenset({"t", "arrival", "created"})
_REQUIRED = object()
"""In place of the default of a field that has none."""
_json = json.JSONEncoder(default=repr).encode
_number = float.__repr__
Field = tuple[str, Callable[[Any], str], Any]
"""What stands before the value of a field, how it is written, and its default."""


@cache
def _form(kind: Any) -> tuple[str, tuple[Field, ...]]:
    """Return how events of a type are written: how a line begins, and its fields."""
    defaults = kind._field_defaults
    fields = ((f", {_json(name)}: ", _writer(name), defaults.get(name, _REQUIRED)) for name in kind._fields)
    return f'{{"event": {_json(kind.__name__)}', tuple(fields)


def _writer(name: str) -> Callable[[Any], str]:
    """Return what writes a field of an event."""
    return _time if name in _TIMES else _body if name == "body" else _plain


def _time(time: Any) -> str:
    if isinstance(time, tuple):
        if LOST in time:
            return f"[{', '.join(map(_time, time))}]"
        return str([each / SECOND for each in time])  # as JSON, and twice as fast
    return "null" if time == LOST else _number(time / SECOND)


def _plain(value: Any) -> str:
    """Return a value as JSON; one that JSON does not know as its `repr`."""
    if type(value) is int:
        return repr(value)
    return _json(value.plain() if hasattr(value, "plain") else value)


def _body(value: Any) -> str:
    """Return a body as JSON."""
    return _plain(value) if hasattr(value, "plain") else _said(value)


def _said(value: Any) -> str:
    """Return a value as JSON, with the named tuples in it as tables."""
    if isinstance(value, tuple | list):
        names = getattr(value, "_fields", None)
        if names is None:
            return f"[{', '.join(map(_said, value))}]"
        return f"{{{', '.join([f'{_json(name)}: {_said(each)}' for name, each in zip(names, value, strict=True)])}}}"
    if value is True or value is False:
        return "true" if value else "false"
    return _number(value) if type(value) is float and isfinite(value) else _json(value)


def _read(name: str, value: Any) -> Any:
    """Return a field of an event from what JSON has."""
    if name in _TIMES:
        return _nanoseconds(value)
    return _named(value) if name == "body" else _tuples(value)


def _nanoseconds(time: Any) -> Any:
    if isinstance(time, list):
        return tuple(map(_nanoseconds, time))
    return LOST if time is None else nanoseconds(time)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _named(value: Any) -> Any:
    """Return a value with named tuples for the tables in it, if their keys can be names, and tuples for lists."""
    if isinstance(value, list):
        return tuple(map(_named, value))
    if not isinstance(value, dict):
        return value
    fields = {name: _named(each) for name, each in value.items()}
    if all(name.isidentifier() and not name.startswith("_") and not iskeyword(name) for name in fields):
        return _body_type(tuple(fields))(**fields)
    return fields


@cache
def _body_type(names: tuple[str, ...]) -> Callable[..., Any]:
    """Return the type of bodies that have these fields."""
    make: Any = namedtuple
    kind: Callable[..., Any] = make("Body", names)
    return kind

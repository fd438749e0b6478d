"""Trace files: one line of JSON per event, with times in seconds instead of integer nanoseconds.

Numbers that are not finite are written as in Python's `json`: Infinity, -Infinity and NaN.

Kept equal to the fields of each event by
`tests/kernel/test_trace_file.py::test_a_line_equals_the_fields_of_its_event`.
"""

import json
import os
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator, Mapping
from errno import EAGAIN, EISDIR, ELOOP
from functools import cache, lru_cache
from keyword import iskeyword
from math import isfinite
from os import PathLike
from os.path import samestat
from pathlib import Path
from types import MappingProxyType, UnionType
from typing import IO, Annotated, Any, Literal, NamedTuple, Self, Union, get_args, get_origin, get_type_hints
from unicodedata import is_normalized

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError
from pydantic_core import to_json

from desim.config.arguments import value_text
from desim.config.error_texts import text_of
from desim.config.interrupts import deferred
from desim.config.json_numbers import field_names, has_plain
from desim.config.whole_files import open_no_link
from desim.kernel.core.body_content import JSON_ATOMS, Fields, content, converts_itself, in_json_types
from desim.kernel.core.events import LOST, ArrivalTime, Body, Broadcast, Count, Event, Nanoseconds, NodeId
from desim.kernel.core.units import SECOND, nanoseconds

try:
    import fcntl

    HAS_LOCKS = True
except ImportError:  # Windows
    HAS_LOCKS = False

Limits = Mapping[str, Any]
"""Additional pydantic constraints by mark (see `desim.kernel.core.events`), for instance {"node": Field(lt=5)}."""

BLOCK = 256
"""Number of events that are written together; a run with events written one by one takes 1.1 times as long."""
_WRITTEN: set[Path] = set()
"""The files that this process writes now."""
LONG = 1000
"""Number of receivers above which a broadcast is written at once, to bound the memory of a block."""


class TraceFile:
    """A watcher that writes each event to a file as it happens, messages included, and stores none in memory.

        with TraceFile("trace.jsonl") as file:
            run(scenario, seed, file)

    The events are written to trace.jsonl.part, which is renamed to trace.jsonl at the end. After an error the .part
    file remains, and an older trace.jsonl is not replaced. If the process is killed, the last events are missing, and
    the file stays locked until the processes that it forked during the run have ended, too.

    Args:
        path: the path of the file.

    Raises:
        ValueError: if the path is not one of a file; at the beginning of the block, if another `TraceFile` of this
            process writes the file.
        BlockingIOError: at the beginning of the block, if another process writes the file.
        OSError: at the beginning of the block, if the path is a folder, or the .part file cannot be opened or is a
            symbolic link.
    """

    def __init__(self, path: str | Path):
        argument: Any = path
        if not isinstance(argument, str | PathLike) or not Path(argument).name:
            raise ValueError(f"TraceFile takes the path of a file (got {value_text(path)})")
        self._path = Path(path)
        self._part = self._resolved = self._path.with_name(self._path.name + ".part")
        self._block: list[Event] = []
        self._file: Any = None
        """The file that is written; None outside of the `with` block."""
        self._last = 0
        """The time of the last event, ns."""

    def __enter__(self) -> Self:
        resolved = self._part.resolve()
        if self._path.is_dir():
            raise IsADirectoryError(EISDIR, "is a folder, not a file", str(self._path))
        if resolved in _WRITTEN:
            raise ValueError(f"{self._path} is written already by a TraceFile: each run needs a file of its own")
        self._file, self._last = _open_alone(self._part, self._path), 0
        self._resolved = resolved
        _WRITTEN.add(resolved)
        return self

    def __call__(self, event: Event) -> None:
        """Write an event.

        Raises:
            ValueError: outside of the `with` block, or if an event is earlier than the one before, because it is of
                another run.
        """
        block, t = self._block, event.t
        if t < self._last or self._file is None:
            raise self._misused(t)
        self._last = t
        block.append(event)
        if len(block) >= BLOCK or (type(event) is Broadcast and len(event.dst) > LONG):
            self._write()

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        try:
            self._write()
            self._file.flush()
            if error is None and HAS_LOCKS:  # renamed while it is locked, so that no other process opens and empties it
                self._part.replace(self._path)
        finally:
            if HAS_LOCKS:
                _lock(self._file, fcntl.LOCK_UN)  # closing is not enough: forked processes would keep it locked
            self._file.close()
            self._file = None
            _WRITTEN.discard(self._resolved)
        if error is None and not HAS_LOCKS:  # Windows renames no file that is open
            self._part.replace(self._path)

    def _misused(self, t: int) -> ValueError:
        """Return the error about an event at a time, ns, that cannot be written."""
        if self._file is None:
            example = f"with TraceFile({str(self._path)!r}) as file: run(scenario, seed, file)"
            return ValueError(f"a TraceFile is written in a with block: {example}")
        return ValueError(
            f"{self._path}: an event at {t / SECOND:g} s comes after one at {self._last / SECOND:g} s: a TraceFile is"
            " of one run, so each run needs its own"
        )

    def _write(self) -> None:
        """Write the events of the block; if one cannot be written, only the events before it are written."""
        block, self._block = self._block, []
        self._file.writelines(map(line_of, block))


def _open_alone(part: Path, path: Path) -> IO[str]:
    """Open a file to write it anew, and lock it against other processes if the system has `fcntl`.

    Raises:
        BlockingIOError: if another process has locked it; the message names the path.
        OSError: if it cannot be opened, or is a symbolic link.
    """
    while True:
        if part.is_symlink():
            raise OSError(ELOOP, f"{part.name} is a symbolic link, which is not followed: remove it", str(path))
        # It is opened to append, and emptied only when it is locked: another process may be writing it.
        file = open(part, "a", encoding="utf-8", newline="\n", opener=open_no_link)  # noqa: SIM115 closed by the caller
        try:
            if HAS_LOCKS:
                _lock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if not part.exists() or not samestat(os.fstat(file.fileno()), part.stat()):
                    file.close()  # another process has renamed it meanwhile, so open a new one
                    continue
            file.truncate(0)
        except BlockingIOError:
            file.close()
            why = "is written by another process: each run needs a file of its own"
            raise BlockingIOError(EAGAIN, why, str(path)) from None
        return file


def _lock(file: IO[str], operation: int) -> None:
    """Lock or unlock a file; do nothing on file systems that cannot lock, such as some network file systems."""
    try:
        fcntl.flock(file, operation)
    except BlockingIOError:
        raise
    except OSError:
        pass


def line_of(event: Event) -> str:
    """Return an event as one line of JSON (with Infinity and NaN): its type and its fields, with times in seconds.

    The arrival time of a lost message, `LOST`, is written as null.
    """
    template, conversions = _line_layout(type(event))
    values = list(event)
    for k, convert in conversions:
        values[k] = convert(values[k])
    return template % tuple(values)


def events_of(
    lines: Iterable[str], kinds: Iterable[type[Any]], limits: Limits = MappingProxyType({})
) -> Iterator[Event]:
    """Yield the events of a trace file line by line, so that a long trace need not fit in memory.

    Each value is validated against the annotation of its field. A list becomes a tuple. An object in a body becomes a
    named tuple if its keys are valid field names. A named tuple that was sent as a body equals the one that is read,
    although their types differ.

    Args:
        lines: the lines of the file.
        kinds: the allowed types of events.
        limits: additional constraints by mark, such as an upper bound of the node ids.

    Raises:
        ValueError: if a line is not an event; the error message contains the number of the line.
    """
    types = {kind.__name__: kind for kind in kinds}
    readers: dict[str, Callable[[Any], Event]] = {}
    for number, line in enumerate(lines, start=1):
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


_json = json.JSONEncoder(default=in_json_types).encode
_number = float.__repr__
Conversion = tuple[int, Callable[[Any], str]]
"""The index of a field, and the function that converts its value to JSON."""


@cache
def _line_layout(kind: Any) -> tuple[str, tuple[Conversion, ...]]:
    """Return the layout of the lines of an event type: a template for `%`, and the conversions of the other fields.

    The template converts node ids and counts itself.
    """
    hints = get_type_hints(kind, include_extras=True)
    parts = [f'"event": {_json(kind.__name__)}', *(f"{_json(name)}: %s" for name in kind._fields)]
    conversions = [(k, _CONVERSIONS.get(hints[name], value_json)) for k, name in enumerate(kind._fields)]
    return f"{{{', '.join(parts)}}}\n", tuple((k, convert) for k, convert in conversions if convert is not str)


def _time_json(time: int) -> str:
    return "null" if time == LOST else _number(time / SECOND)


def _times_json(times: tuple[int, ...]) -> str:
    """Return times as JSON.

    The serializer of pydantic writes a float in a sixth of the time of Python, and in the same way, except that Python
    writes less than 100 us with an exponent.
    """
    text = to_json([None if time == LOST else time / SECOND for time in times]).decode()
    if "0.0000" in text or "e" in text:
        return f"[{', '.join(map(_time_json, times))}]"
    return text.replace(",", ", ")


@lru_cache(maxsize=256)  # a sender often has the same receivers
def _nodes_json(nodes: tuple[int, ...]) -> str:
    return to_json(nodes).decode().replace(",", ", ")  # twice as fast as `json`


def value_json(value: Any) -> str:
    """Return a value as JSON; an object without a JSON form is written by its content, infinity as Infinity."""
    if type(value) is int:
        return repr(value)
    return _json(value.plain() if has_plain(value.__class__) else value)


def body_json(value: Any) -> str:
    """Return a body as JSON; see `desim.kernel.core.body_content.content`."""
    return _nested(value.plain() if converts_itself(value.__class__) else value)


def _nested(value: Any) -> str:
    """Return a value as JSON, by its content; announcements take a third of the time of `in_json_types`."""
    kind: Any = type(value)
    if kind is int:
        return _integer(value)
    if kind is tuple or kind is list:
        return f"[{', '.join(map(_nested, value))}]"
    if kind is float:
        return _number(value) if isfinite(value) else _json(value)
    if kind in JSON_ATOMS:
        return _json(value)
    # Lists, because `join` converts a generator to a list first, and a trace has millions of these texts.
    if kind is Fields:
        return f"{{{', '.join([f'{_json(name)}: {_nested(field)}' for name, field in value.items()])}}}"
    keys = _keys_json(kind)
    if keys is None:
        return _nested(content(value))
    return f"{{{', '.join([key + _nested(field) for key, field in zip(keys, value, strict=True)])}}}"


def _integer(number: int) -> str:
    """Return an integer as JSON; one with thousands of digits, which Python refuses to write, as a hexadecimal text."""
    try:
        return repr(number)
    except ValueError:
        return _json(hex(number))


@cache
def _keys_json(kind: type) -> tuple[str, ...] | None:
    """Return the keys of the JSON objects of a type of named tuples, each with its colon; None for any other type.

    None also for a type whose objects may have attributes beside their fields.
    """
    names = None if kind.__dictoffset__ else field_names(kind)
    return names and tuple(f"{_json(name)}: " for name in names)


_CONVERSIONS: Mapping[Any, Callable[[Any], str]] = {
    Nanoseconds: _time_json,
    ArrivalTime: _time_json,
    tuple[ArrivalTime, ...]: _times_json,
    NodeId: str,
    Count: str,
    tuple[NodeId, ...]: _nodes_json,
    Body: body_json,
}
"""The function that converts the value of a field to JSON, by the type of the field; for other types, `value_json`."""


def _reader(kind: Any, limits: Limits) -> Callable[[Any], Event]:
    """Return a function that validates the fields of a JSON object and creates an event of a type."""
    fields = [(name, _as_read(hint, limits)) for name, hint in get_type_hints(kind, include_extras=True).items()]
    make: Any = NamedTuple
    with deferred():  # see `Value.model_rebuild`
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
        marked = _MARKED.get(mark) or _as_read(inner, limits)
        return Annotated[marked, limits[mark]] if mark in limits else marked
    if get_origin(hint) in {None, Literal}:
        return hint
    parts = tuple(_as_read(argument, limits) for argument in get_args(hint))
    return Union[parts] if get_origin(hint) in {Union, UnionType} else get_origin(hint)[parts]  # noqa: UP007


def _reason(error: Exception) -> str:
    """Return the message of an error; for a validation error, its first problem on one line."""
    if not isinstance(error, ValidationError):
        return str(error)
    problem = error.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(map(str, problem['loc']))}: {text_of(problem)}"


def _with_named_tuples(value: Any) -> Any:
    """Return a JSON value with lists as tuples; an object whose keys are valid field names becomes a named tuple."""
    if isinstance(value, list):
        return tuple(map(_with_named_tuples, value))
    if not isinstance(value, dict):
        return value
    fields = {name: _with_named_tuples(member) for name, member in value.items()}
    return _body_type(tuple(fields))(**fields) if all(map(_is_field_name, fields)) else fields


def _is_field_name(name: str) -> bool:
    """Return whether a key can be a field of a named tuple; Python reads a name that is not in NFKC as another one."""
    return name.isidentifier() and not name.startswith("_") and not iskeyword(name) and is_normalized("NFKC", name)


@cache
def _body_type(names: tuple[str, ...]) -> Callable[..., Any]:
    """Return the named tuple type of bodies with these fields; its objects can be pickled, which its name cannot."""
    make: Any = namedtuple
    kind: Any = make("Body", names)
    kind.__reduce__ = lambda body: (_restored_body, (names, tuple(body)))
    return kind  # type: ignore[no-any-return]


def _restored_body(names: tuple[str, ...], values: tuple[Any, ...]) -> Any:
    """Return a body from its pickle."""
    return _body_type(names)(*values)


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

"""Scenario files: TOML in, a `Scenario` or all that is wrong with the file out, each fault with its line."""

import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any, get_args

import tomli_w
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from desim.scenario import Scenario
from desim.value import OneOf

Place = tuple[str | int, ...]
"""Where a value stands in a file: keys and positions in lists, from the top."""


class ScenarioError(ValueError):
    """A scenario is not valid; the text has one line per fault."""


@dataclass(frozen=True)
class Source:
    """A scenario as it was written: its tables, and where each key came from."""

    name: str
    tables: dict[str, Any]
    lines: dict[Place, int]
    overrides: dict[Place, str] = field(default_factory=dict)

    def where(self, place: Place) -> str:
        """Return where a key was set: `file:line`, or the override that set it."""
        within = [place[:end] for end in range(len(place), 0, -1)]
        for each in within:
            if each in self.overrides:
                return f"--set {self.overrides[each]}"
        for each in within:
            if each in self.lines:
                return f"{self.name}:{self.lines[each]}"
        return f"{self.name}:1"


def load(file: str | Path, overrides: Sequence[str] = ()) -> Scenario:
    """Return the scenario in a TOML file.

    Args:
        file: its path.
        overrides: "key.key=value" each, the value in TOML; they win over the file.

    Raises:
        ScenarioError: with every fault in the file, one a line.
        OSError: if it cannot be read.
    """
    return validate(read(file, overrides))


def read(file: str | Path, overrides: Sequence[str] = ()) -> Source:
    """Return what a TOML file says, with overrides, not yet validated."""
    text = _text(Path(file))
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(_syntax_fault(file, str(error), text)) from error
    source = Source(str(file), tables, key_lines(text))
    for override in overrides:
        _apply(override, source)
    return source


def validate(source: Source) -> Scenario:
    """Return the scenario that a source describes; raise ScenarioError with all its faults, sorted by place."""
    try:
        return Scenario.model_validate(source.tables)
    except ValidationError as error:
        faults = [_explain(each, source) for each in error.errors()]
        raise ScenarioError("\n".join(text for _, text in sorted(faults))) from error


def dump(scenario: Scenario) -> str:
    """Return a scenario as TOML with every default filled in."""
    return tomli_w.dumps(scenario.model_dump(exclude_none=True))


def key_lines(text: str) -> dict[Place, int]:
    """Return the line on which each key of a TOML text is set, and that of each table's header.

    The parser itself tells statements apart: one ends with the first line at which what has been read parses.
    """
    lines: dict[Place, int] = {}
    lengths: dict[Place, int] = {}  # of arrays of tables
    header: Place = ()
    statement: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        statement.append(line)
        try:
            tables = tomllib.loads("\n".join(statement))
        except tomllib.TOMLDecodeError:
            continue
        first, opening = number - len(statement) + 1, statement[0].lstrip()
        statement = []
        if opening.startswith("["):
            header = _header(tables, opening.startswith("[["), lengths)
            lines.setdefault(header, first)
        else:
            for place in _places(tables):
                lines.setdefault(header + place, first)
    return lines


def _header(tables: dict[str, Any], is_array: bool, lengths: dict[Place, int]) -> Place:
    """Return where a table header leads: below the newest table of each array on the way."""
    place: Place = ()
    node: Any = tables
    while node:
        key, node = next(iter(node.items()))
        place += (key,)
        if isinstance(node, list):
            node = node[0]
        if node and place in lengths:
            place += (lengths[place] - 1,)
    if is_array:
        lengths[place] = lengths.get(place, 0) + 1
        place += (lengths[place] - 1,)
    return place


def _places(value: Any, place: Place = ()) -> Iterator[Place]:
    """Yield the place of everything inside a value."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, each in inner:
        yield (*place, key)
        yield from _places(each, (*place, key))


def _apply(override: str, source: Source) -> None:
    """Set one key of a source to another value."""
    name, equals, text = override.partition("=")
    keys: Place = tuple(int(key) if key.isdigit() else key for key in name.strip().split("."))
    if not equals or "" in keys:
        raise ScenarioError(f"--set {override}: should be KEY=VALUE, for instance network.latency.value=0.05")
    node: Any = source.tables
    for key in keys[:-1]:
        if isinstance(node, dict):
            node.setdefault(key, {})
        node = node[key] if _holds(node, key) else None
    if not isinstance(node, dict) and not _holds(node, keys[-1]):
        raise ScenarioError(f"--set {override}: {name} is not a key of a table")
    node[keys[-1]] = _parsed(text.strip())
    source.overrides[keys] = override


def _holds(node: Any, key: Any) -> bool:
    """Return whether a table has a key, or a list a position."""
    return key in node if isinstance(node, dict) else isinstance(node, list) and key in range(len(node))


def _parsed(text: str) -> Any:
    """Return a TOML value; a bare word is a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{file}:1: not TOML: not UTF-8 text ({error.reason} at byte {error.start})") from error


def _syntax_fault(file: str | Path, message: str, text: str) -> str:
    """Return the fault of a text that is not TOML, with its line in front."""
    found = re.search(r" \(at (?:line (\d+), column \d+|end of document)\)$", message)
    line = found[1] if found and found[1] else text.count("\n") + 1
    return f"{file}:{line}: not TOML: {message[: found.start()] if found else message}"


def _explain(error: ErrorDetails, source: Source) -> tuple[tuple[int, str], str]:
    """Return a fault as text, after what it is sorted by: its line."""
    place = _place_of(error, source.tables)
    owner, description = _field(place, source.tables)
    what = _what_is_wrong(error, str(place[-1]) if place else "", owner)
    where = source.where(place)
    note = f"; {description}" if description else ""
    line = re.search(r":(\d+)$", where)
    return (int(line[1]) if line else 0, where), f"{where}: {_dotted(place)}: {what}{note}{_got(error)}"


def _place_of(error: ErrorDetails, tables: dict[str, Any]) -> Place:
    """Return where a fault is in the file; pydantic's own path also names the kind of table it tried."""
    place: Place = ()
    node: Any = tables
    for part in error["loc"]:
        if _holds(node, part):
            place, node = (*place, part), node[part]
    if error["type"] == "missing":
        place += (error["loc"][-1],)
    if error["type"] == "union_tag_invalid":
        place += ("kind",)
    return place


def _field(place: Place, tables: dict[str, Any]) -> tuple[type[BaseModel] | None, str]:
    """Return the model a key belongs to and the description of the key."""
    owner: type[BaseModel] | None = None
    inner: type[BaseModel] | None = Scenario
    description = ""
    node: Any = tables
    for part in place:
        if isinstance(part, str):
            owner, info = inner, inner.model_fields.get(part) if inner else None
            description = (info.description or "").split("\n")[0].rstrip(".") if info else ""
        node = node[part] if _holds(node, part) else None
        if isinstance(part, str):
            inner = _model_of(info, node) if info else None
    return owner, description


def _model_of(info: FieldInfo, value: Any) -> type[BaseModel] | None:
    """Return the model that the value of a field should be."""
    kinds = next((each.choices() for each in info.metadata if isinstance(each, OneOf)), {})
    if kinds:
        return kinds.get(str(value.get("kind"))) if isinstance(value, dict) else None
    models = [each for each in (info.annotation, *get_args(info.annotation)) if _is_model(each)]
    return models[0] if models else None


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _what_is_wrong(error: ErrorDetails, key: str, owner: type[BaseModel] | None) -> str:
    """Return what is wrong in words, with what is allowed."""
    kind, context = error["type"], error.get("ctx", {})
    if kind == "extra_forbidden":
        allowed = sorted(owner.model_fields) if owner else []
        return f"unknown key{_suggestion(key, allowed)}; allowed: {', '.join(allowed)}"
    if kind == "union_tag_invalid":
        allowed = re.findall(r"'([^']*)'", context["expected_tags"])
        return f"there is no {context['tag']!r}{_suggestion(context['tag'], allowed)}; allowed: {', '.join(allowed)}"
    if kind == "union_tag_not_found":
        return "should be a table with a kind"
    if kind == "literal_error":
        return f"should be {context['expected']}"
    if kind == "missing":
        return "is missing"
    if kind in {"model_type", "model_attributes_type"}:
        return "should be a table"
    text = error["msg"]
    for machine, human in (
        ("Input should be", "should be"),
        ("a valid tuple", "a list"),
        ("valid ", ""),
        ("Value error, ", ""),
    ):
        text = text.replace(machine, human)
    return text.strip()


def _suggestion(word: str, allowed: Sequence[str]) -> str:
    close = get_close_matches(word, allowed, n=1)
    return f", did you mean {close[0]!r}?" if close else ""


def _got(error: ErrorDetails) -> str:
    if error["type"] in {"extra_forbidden", "union_tag_invalid", "missing", "value_error"}:
        return ""
    got = repr(error["input"])
    return f" (got {got if len(got) < 60 else got[:57] + '...'})"


def _dotted(place: Place) -> str:
    return ".".join(str(part) for part in place) or "the file"

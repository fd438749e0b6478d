"""Scenario files: from TOML to a `Scenario`, or to a list of all errors in the file, each with its line."""

import os
import re
import tomllib
from codecs import BOM_UTF8
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import BaseModel, Tag, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from desim.config.choice import OneOf, choices_of
from desim.config.model import fields_of, markers_of
from desim.config.trust import path_in, regular_or_missing
from desim.scenario.key_index import homes_of
from desim.scenario.overrides import ScenarioError, Source, holds, model_of, value_at
from desim.scenario.scenario import Scenario
from desim.scenario.toml_lines import MAX_PARTS, KeyPath, deep_key, key_lines, unreadable


def load(file: str | Path, overrides: Sequence[str] = (), *, allow_import: bool = False) -> Scenario:
    """Return the scenario in a TOML file.

    Use it for a scenario file, optionally with a few keys changed. To build a scenario in Python, use `Scenario(...)`.

    Args:
        file: the path of the file.
        overrides: strings "key.key=value" that set keys and take precedence over the file; the value is in TOML.
        allow_import: whether the file may name code to be run ("module:name") and files outside of its folder. Leave
            it off for files that you do not trust.

    Raises:
        ScenarioError: if the file, one of its bases or an override is not valid; the message has one line per error.
        OSError: if the file cannot be read.
    """
    return validate(read(file, overrides, allow_import=allow_import))


def read(file: str | Path, overrides: Sequence[str] = (), *, allow_import: bool = False) -> Source:
    """Return the source of a TOML file before validation, merged with its bases and overrides; see `load`.

    A base is another scenario file, which the key `base` names.
    """
    sources = list(_with_bases(Path(file), allow_import))
    source = sources.pop()
    while sources:
        source = sources.pop().over(source)
    _relocate(source, source.tables, ())
    for override in overrides:
        source.override(override)
    return source


BASE = "base"
"""The key of a scenario file that names its base; it is no field of `Scenario`."""
BASE_DESCRIPTION = (
    "Path of another scenario file, in the folder of this file or below, whose keys this file overrides: tables are"
    " merged, any other value is replaced. Only in scenario files."
)


def _with_bases(file: Path, allow_import: bool) -> Iterator[Source]:
    """Yield the source of a file without its key `base`, then the source of its base, and so on up the chain of bases.

    Raises:
        ScenarioError: if a file is not valid TOML, a base is not allowed or cannot be read, or the bases form a cycle.
        OSError: if the first file cannot be read.
    """
    source = _parsed(file, allow_import)
    seen = {file.resolve()}
    while BASE in source.tables:
        where, given = f"{source.where((BASE,))}: {BASE}", source.tables.pop(BASE)
        yield source
        if not isinstance(given, str):
            raise ScenarioError(f"{where}: should be the path of a scenario file (got {given!r})")
        try:
            base = path_in(file.parent, given, is_trusted=allow_import)
            source = _parsed(base, allow_import)
        except OSError as error:
            raise ScenarioError(f"{where}: {error.filename} cannot be read: {error.strerror}") from error
        except ScenarioError:
            raise
        except ValueError as error:
            raise ScenarioError(f"{where}: {error}") from error
        if base.resolve() in seen:
            raise ScenarioError(f"{where}: {file} and {base} are bases of each other, directly or through others")
        seen.add(base.resolve())
        file = base
    yield source


def _relocate(source: Source, node: Any, above: KeyPath) -> None:
    """Convert the paths of data files in bases: make each relative to the folder of the file that uses the bases.

    Such a path is the value of the key `file` in a table, or one of the values of such a key in the grid of a sweep.
    Only tables whose kind is the name of an installed model are converted, because the key `file` may mean anything
    else in a table of the kind "module:name". The kind and the path may be set in different files.

    Args:
        source: the source of the file, merged with its bases.
        node: a value in its tables.
        above: the place of this value: the keys and list indices that lead to it.
    """
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, each in inner:
        place = (*above, key)
        _relocate(source, each, place)
        *parts, last = ".".join(map(str, place)).split(".")  # a key of the grid is dotted
        if last != "file" or place not in source.files:
            continue
        folder = os.path.relpath(Path(source.files[place]).parent, Path(source.name).parent)
        if isinstance(each, str) and _has_installed_kind(node):
            node[key] = str(Path(folder, each))
        elif isinstance(each, list) and parts[:2] == ["sweep", "grid"] and _has_installed_kind(source.at(parts[2:])):
            node[key] = [str(Path(folder, path)) if isinstance(path, str) else path for path in each]


def _has_installed_kind(table: Any) -> bool:
    kind = table.get("kind") if isinstance(table, dict) else table  # a bare string stands for a kind
    return isinstance(kind, str) and ":" not in kind


def _parsed(file: Path, allow_import: bool) -> Source:
    """Return the source of one file.

    Raises:
        ScenarioError: if the file is not valid TOML.
        OSError: if the file cannot be read.
    """
    text = _read_text(file)
    if (deep := deep_key(text)) is not None:
        line = text.count("\n", 0, deep) + 1
        raise ScenarioError(f"{file}:{line}: not TOML: a key of more than {MAX_PARTS} parts")
    try:
        tables = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also if a number is too long or tables are nested too deeply
        raise ScenarioError(_syntax_error(file, str(error), text)) from error
    return Source(str(file), tables, key_lines(text), allow_import=allow_import)


def validate(source: Source) -> Scenario:
    """Return the scenario of a source; raise ScenarioError with all errors of the source, sorted by line."""
    folder = Path(source.name).parent if source.folder is None else source.folder
    try:
        return Scenario.model_validate(source.tables, context={"folder": folder, "allow_import": source.allow_import})
    except ValidationError as error:
        problems = [problem for each in error.errors() for problem in _explain(each, source, Scenario, ())]
        raise ScenarioError("\n".join(text for _, text in sorted(problems))) from error


def dump(scenario: Scenario) -> str:
    """Return a scenario as TOML, defaults included; keys with the value None are left out, because TOML has no null."""
    tables = scenario.model_dump(exclude_none=True)
    text = tomli_w.dumps(tables)
    # A reader of TOML changes the line ends \r\n of a text that is written in several lines.
    return text if "\\r" in text else tomli_w.dumps(tables, multiline_strings=True)


def _read_text(file: Path) -> str:
    content = regular_or_missing(file).read_bytes().removeprefix(BOM_UTF8)  # editors on Windows may add it
    try:
        return content.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ScenarioError(f"{file}:{line}: not TOML: not UTF-8 text ({error.reason})") from error


def _syntax_error(file: str | Path, message: str, text: str) -> str:
    """Return the error message for a text that is not TOML, with file and line, given the message of `tomllib`."""
    found = re.search(r" \(at (?:line (\d+), column \d+|end of document)\)$", message)
    last = text.rstrip().count("\n") + 1
    if not found and (unread := unreadable(text)):  # a message without a line
        return f"{file}:{unread}: not TOML that can be read: {message}"
    line = min(int(found[1]), last) if found and found[1] else last
    return f"{file}:{line}: not TOML: {message[: found.start()] if found else message}"


Problem = tuple[tuple[int, str], str]
"""An error in a file: its sort key (line and place), and its text."""


def _explain(error: ErrorDetails, source: Source, model: type[Any], above: KeyPath) -> Iterator[Problem]:
    """Yield the problems that a pydantic error describes.

    Args:
        error: an error in the table of a model.
        source: the source of the scenario.
        model: the model, possibly a user's class.
        above: the place of the table.
    """
    if error["type"] == "misfits":
        for place, why in error["ctx"]["misfits"]:
            yield _problem(source, place, why)
        return
    place, owner, info = _locate(error, value_at(source.tables, above), model, above)
    if error["type"] == "user_model":
        for each in error["ctx"]["errors"]:
            yield from _explain(each, source, error["ctx"]["model"], place)
        return
    description = " ".join((info.description or "").split()).rstrip(".") if info else ""
    note = f"; {description}" if description and error["type"] != "import_refused" else ""
    more = [BASE] if owner is Scenario and source.line(place) else []
    yield _problem(source, place, f"{_reason(error, place, owner, info, more)}{note}{_input_text(error)}")


def _problem(source: Source, place: KeyPath, what: str) -> Problem:
    where = source.where(place)
    name = ".".join(map(str, place)) or "the file"
    return (source.line(place), where), f"{where}: {name}: {what}"


def _locate(
    error: ErrorDetails, node: Any, model: type[Any], above: KeyPath
) -> tuple[KeyPath, type[BaseModel] | None, FieldInfo | None]:
    """Return the place of the key with an error, the model of the table that contains it, and the field of the key.

    The path in a pydantic error also contains the kind of each table that has one; the place does not. `node` is the
    table at the place `above`, in which pydantic found the error; for the other arguments see `_explain`.
    """
    place = above
    owner: type[BaseModel] | None = None
    inner: type[BaseModel] | None = model if issubclass(model, BaseModel) else None
    info: FieldInfo | None = None
    path = list(error["loc"])
    while path:
        part = path.pop(0)
        place += (part,)
        node = node[part] if holds(node, part) else None
        if isinstance(part, str):
            owner, info = inner, fields_of(inner).get(part) if inner else None
        inner = model_of(info, node) if info else None
        if info is not None and path and path[0] in _tags(info):
            path.pop(0)
    if error["type"] in {"union_tag_invalid", "import_refused"}:
        place += ("kind",)
    return place, owner, info


def _tags(info: FieldInfo) -> set[str]:
    """Return the kinds and the union tags of a field.

    In the path of an error, pydantic inserts them after the name of the field or the index of an item.
    """
    markers = markers_of(info)
    kinds = {kind for each in markers if isinstance(each, OneOf) for kind in each.choices()}
    return kinds | {each.tag for each in markers if isinstance(each, Tag)}


def _one_of(info: FieldInfo) -> OneOf | None:
    return next(iter(choices_of(info)), None)


def _reason(
    error: ErrorDetails, place: KeyPath, owner: type[BaseModel] | None, info: FieldInfo | None, more: Sequence[str]
) -> str:
    """Return the text of an error, with the allowed values.

    `owner` is the model of the table that contains the key; `more` are keys that are allowed in addition to its fields.
    """
    kind, context = error["type"], error.get("ctx", {})
    one_of = _one_of(info) if info else None
    kinds = list(one_of.choices()) if one_of else []
    if kind == "extra_forbidden":
        if place == (BASE,):
            return "is a key of scenario files only: it cannot be set, and a recorded scenario is complete without it"
        allowed = context.get("allowed") or (sorted([*owner.model_fields, *more]) if owner else [])
        return f"unknown key{_other_key(place, allowed)}; allowed: {', '.join(allowed)}"
    if kind == "union_tag_invalid":
        return f"there is no {context['tag']!r}{_suggestion(context['tag'], kinds)}; allowed: {', '.join(kinds)}"
    if kind == "union_tag_not_found" or (kind in NOT_A_TABLE and kinds):
        return f'should be a table with a kind, {{ kind = "{kinds[0]}" }} for instance; allowed: {", ".join(kinds)}'
    if kind == "import_refused":
        return f"{error['msg']}; allowed without --allow-import: {', '.join(kinds)}"
    if kind == "literal_error":
        return f"should be {context['expected']}"
    if kind == "missing":
        return "is missing"
    if kind in NOT_A_TABLE:
        return "should be a table"
    if kind in {"too_long", "too_short"}:
        most = kind == "too_long"
        limit = context["max_length" if most else "min_length"]
        return f"should have at {'most' if most else 'least'} {limit} items, has {context['actual_length']}"
    text = error["msg"]
    for machine, human in WORDS.items():
        text = text.replace(machine, human)
    return text


NOT_A_TABLE = {"model_type", "model_attributes_type"}
WORDS = {
    "Input should be": "should be",
    "a valid tuple": "a list",
    "a valid integer": "an integer",
    "a valid boolean": "true or false",
    "valid ": "",
    "Value error, ": "",
}
"""Phrases of pydantic messages and their replacements."""


RENAMED = {
    "at": "start",
    "floor": "min_timeout",
    "forget_after": "belief_timeout",
    "frozen": "static",
    "heeds": "flees_from",
    "hold": "holding_time",
    "lost_after": "track_timeout",
    "needed": "captures_to_end",
    "of": "schedule",
    "otherwise": "normally",
    "pass_on": "relay",
    "patience": "winner_timeout",
    "q": "participation",
    "reach": "reception",
    "reaction": "reaction_delay",
    "sight": "sensing_range",
    "spread": "dissemination",
    "surprises": "reheat_on",
    "then": "during_handover",
    "together": "synchronous",
    "until": "end",
    "when_lost": "on_lost",
}
"""Keys and kinds that are not valid, and the valid ones to suggest."""


def _suggestion(word: str, allowed: Sequence[str]) -> str:
    close = _similar(word, allowed)
    return f", did you mean {close[0]!r}?" if close else ""


def _similar(word: str, allowed: Sequence[str]) -> list[str]:
    """Return a list with the allowed word to suggest for an invalid one; an empty list if none is similar."""
    return [RENAMED[word]] if RENAMED.get(word) in allowed else get_close_matches(word, allowed, n=1)


def _other_key(place: KeyPath, allowed: Sequence[str]) -> str:
    """Return a hint for an unknown key: a similar key of its table, or the same key in another table or kind."""
    word = str(place[-1]).split(".")[-1]
    close = _similar(word, allowed)
    homes = homes_of(word) or homes_of(RENAMED.get(word, word))
    if close:  # then suggest other tables only for a key of exactly this name, and none for a renamed key
        homes = [key for key in homes if key.place[-1] == word and close != [RENAMED.get(word)]]
    here = [each for each in place if isinstance(each, str)]
    same = [key for key in homes if [each for each in key.place if each != "0"] == here]
    if kinds := list(dict.fromkeys(key.owner for key in same if key.owner)):
        return f", it is one of the kind {' or '.join(kinds)}"
    places = dict.fromkeys(key.dotted if len(key.place) > 1 else f"{key.dotted} at the top" for key in homes)
    found = [*map(repr, close), *list(places)[:MAX_HOMES]]
    return f", did you mean {' or '.join(found)}?" if found else ""


MAX_HOMES = 3
"""The largest number of tables that an error message suggests for a key."""


def _input_text(error: ErrorDetails) -> str:
    if error["type"] in {"extra_forbidden", "union_tag_invalid", "import_refused", "missing", "value_error"}:
        return ""
    got = str(error["input"]).lower() if isinstance(error["input"], bool) else repr(error["input"])
    return f" (got {got if len(got) < 60 else got[:57] + '...'})"

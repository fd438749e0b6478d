"""Scenario files: from TOML to a `Scenario`, or to a list of all errors in the file, each with its line."""

import os
import re
from codecs import BOM_UTF8
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import date, time
from decimal import Decimal
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import tomli_w

from desim.config.arguments import Argument, naming_arguments, value_text
from desim.config.choice import choices_of
from desim.config.errors import Problem
from desim.config.model_parts import models_in
from desim.config.own_modules import CodeName
from desim.config.parameters import as_jsonable
from desim.config.suggestion import close_to
from desim.config.tables import nested, value_at
from desim.config.traits import kind_of
from desim.config.trust import path_in, regular_or_missing
from desim.scenario.examples import examples
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.scenario import Scenario
from desim.scenario.toml_errors import BASE, validated
from desim.scenario.toml_hints import what_was_meant
from desim.scenario.toml_lines import MAX_PARTS, deep_key, key_lines, tables_of, unreadable

INSTEAD_OF_PATH = {"dict": "Scenario(**keys)", "Scenario": "use it as it is, or scenario.with_({{key: value}})"}
PATH = Argument("the path of a scenario file", (str, PathLike), MappingProxyType(INSTEAD_OF_PATH))
"""What `load` takes."""


@naming_arguments
def load(file: str | PathLike[str], overrides: Sequence[str] = (), *, allow_import: bool = False) -> Scenario:
    """Return the scenario in a TOML file.

    Use it for a scenario file, optionally with a few keys changed. To build a scenario in Python, use `Scenario(...)`.

    Args:
        file: the path of the file.
        overrides: strings "key.key=value" that set keys and take precedence over the file; the value is in TOML.
        allow_import: whether the file may name code to be run ("module:name") and files outside of its folder. Leave
            it off for files that you do not trust.

    Raises:
        TypeError: if `file` is not a path; the message says what to write instead.
        ScenarioError: if the file, one of its bases or an override is not valid; the message has one line per error.
        OSError: if the file cannot be read.
    """
    PATH.check(file, "load")
    if isinstance(overrides, str):
        overrides = [overrides]
    if isinstance(overrides, Mapping):
        instead = f"load({str(file)!r}).with_({value_text(dict(overrides))})"
        raise TypeError(f"load takes overrides as texts, ['team.count=8'] for instance; values by key: {instead}")
    try:
        source = read_source(file, overrides, allow_import=allow_import)
    except FileNotFoundError as error:
        if (name := Path(file).stem) in examples():
            why: str | None = f"{error.strerror}; load(examples()[{name!r}]) reads the example"
        else:
            path = Path(file)
            close = close_to(path.name, [other.name for other in path.parent.glob("*.toml")], cutoff=0.8)
            why = f"{error.strerror}, did you mean {close[0]!r}?" if close else str(error.strerror)
        raise FileNotFoundError(error.errno, why, str(file)) from None
    except IsADirectoryError as error:
        why = f"{error.strerror}: a scenario is one file, NAME.toml; results are read by desim.open"
        raise IsADirectoryError(error.errno, why, str(file)) from None
    return validate(source)


def read_source(file: str | PathLike[str], overrides: Sequence[str] = (), *, allow_import: bool = False) -> Source:
    """Return the source of a TOML file before validation, merged with its bases and overrides; see `load`.

    A base is another scenario file, which the key `base` names.
    """
    sources = list(_with_bases(Path(file), allow_import))
    source = sources.pop()
    while sources:
        source = sources.pop().over(source)
    _relocate(source)
    for override in overrides:
        source.override(override)
    return source


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
        where, base_path = f"{source.where((BASE,))}: {BASE}", source.tables.pop(BASE)
        yield source
        if not isinstance(base_path, str):
            raise ScenarioError(Problem(f"should be the path of a scenario file (got {base_path!r})", where=where))
        try:
            base = path_in(file.parent, base_path, is_trusted=allow_import)
            source = _parsed(base, allow_import)
        except OSError as error:
            raise ScenarioError(Problem(f"{error.filename} cannot be read: {error.strerror}", where=where)) from error
        except ScenarioError:
            raise
        except ValueError as error:
            raise ScenarioError(Problem(str(error), where=where)) from error
        if base.resolve() in seen:
            raise ScenarioError(
                Problem(f"{file} and {base} are bases of each other, directly or through others", where=where)
            )
        seen.add(base.resolve())
        file = base
    yield source


def looked_up_in(source: Source, folder: Path) -> Source:
    """Return a source whose code and files are looked up in another folder than that of its file."""
    return replace(source, tables=_in_folder(source.tables, folder), folder=folder)


def _in_folder(node: Any, folder: Path) -> Any:
    """Return tables in which each name of code says the folder where its module is looked up."""
    if isinstance(node, dict):
        return {key: _in_folder(value, folder) for key, value in node.items()}
    if isinstance(node, list):
        return [_in_folder(value, folder) for value in node]
    return CodeName(node, folder) if isinstance(node, str) and ":" in node else node


def _relocate(source: Source) -> None:
    """Convert the paths of data files in bases: make each relative to the folder of the file that uses the bases.

    Such a path is the value of the key `file` in a table, or one of the values of such a key in the grid of a sweep.
    In a table of the kind "module:name", the key `file` may mean anything, so its value is kept. The kind and the path
    may be set in different files.
    """
    for place, value in list(nested(source.tables)):
        *parts, last = ".".join(map(str, place)).split(".")  # a key of the grid is dotted
        if last != "file" or place not in source.files:
            continue
        node, key = value_at(source.tables, place[:-1]), place[-1]
        folder = os.path.relpath(Path(source.files[place]).parent, Path(source.name).parent)
        is_of_grid = parts[:2] == ["sweep", "grid"]
        table_parts = parts[2:] if is_of_grid else parts
        if isinstance(value, str) and _has_data_file(node, table_parts):
            node[key] = str(Path(folder, value))
        elif isinstance(value, list) and is_of_grid and _has_data_file(source.at(table_parts), table_parts):
            node[key] = [str(Path(folder, path)) if isinstance(path, str) else path for path in value]


def _has_data_file(table: Any, parts: Sequence[str]) -> bool:
    """Return whether the key `file` of a table is the path of a data file; `parts` are those of the table's key."""
    kind = table.get("kind") if isinstance(table, dict) else table  # a bare string stands for a kind
    if kind is not None:
        return isinstance(kind, str) and ":" not in kind
    model: Any = Scenario
    for part in (part for part in parts if not part.isdecimal()):
        info = model.model_fields.get(part) if model is not None else None
        model = None if info is None or choices_of(info) else next(models_in(info.annotation), None)
    return model is not None and "file" in model.model_fields


_PRINTED = "import sys, tomli_w, {0}; print(tomli_w.dumps({0}.{1}(open(sys.argv[1]))))"
CONVERSIONS = {
    ".json": _PRINTED.format("json", "load"),
    ".yaml": _PRINTED.format("yaml", "safe_load"),
    ".yml": _PRINTED.format("yaml", "safe_load"),
}
"""By suffix of a file that is not TOML, the program that prints its content as TOML."""


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
        tables = tables_of(text)
    except (ValueError, RecursionError) as error:  # also if a number is too long or tables are nested too deeply
        if file.suffix == ".py":
            beside = file.with_suffix(".toml")
            scenario = f", and the scenario beside it is {beside}" if beside.is_file() else ""
            raise ScenarioError(f"{file}: is Python, not a scenario file: python {file} runs it{scenario}") from None
        if how := CONVERSIONS.get(file.suffix.lower()):
            raise ScenarioError(f"{file}: scenario files are TOML; convert it: python -c '{how}' {file}") from None
        raise ScenarioError(_syntax_error(file, str(error), text)) from error
    tables = _in_folder(tables, file.parent)  # the values of a grid are validated later, without the file
    return Source(str(file), tables, Scenario, key_lines(text), allow_import=allow_import)


def validate(source: Source) -> Scenario:
    """Return the scenario of a source; raise ScenarioError with all errors of the source, sorted by line."""
    return validated(source, Scenario)


def dump(scenario: Scenario) -> str:
    """Return a scenario as TOML, defaults included; keys with the value None are left out, because TOML has no null."""
    tables = _in_toml(scenario.model_dump(exclude_none=True))
    text = tomli_w.dumps(tables)
    # A text with the line ends \r\n stays on one line: in a text of several lines, a reader of TOML may change them.
    return text if "\\r" in text else tomli_w.dumps(tables, multiline_strings=True)


def brief(scenario: Scenario, folder: Path | None = None, **texts: Any) -> str:
    """Return a scenario as TOML without the keys that have their defaults; with all keys if it could not be read back.

    Args:
        scenario: the scenario.
        folder: the folder in which the code that it names is looked up; None: no code is looked up.
        texts: other forms of the values of some keys, such as properties as texts.
    """
    tables = _differing(scenario.model_dump(exclude_none=True), Scenario().model_dump(exclude_none=True))
    if scenario.fault:
        tables["fault"] = [
            {"kind": kind_of(fault)} | fault.model_dump(exclude_defaults=True, exclude_none=True)
            for fault in scenario.fault
        ]
    tables |= texts
    try:
        is_complete = validate(Source("", tables, Scenario, folder=folder, allow_import=folder is not None)) == scenario
    except ScenarioError:  # files or code of the scenario are looked up elsewhere
        is_complete = False
    return tomli_w.dumps(_in_toml(tables)) if is_complete else dump(scenario)


def _in_toml(value: Any) -> Any:
    """Return a value in which the types that TOML lacks are as in JSON; a model's parameter may have any type."""
    if isinstance(value, dict):
        return {str(key): _in_toml(member) for key, member in value.items()}
    if isinstance(value, list | tuple):
        return [_in_toml(member) for member in value]
    if isinstance(value, TOML_TYPES):
        return value
    return "none" if value is None else _in_toml(as_jsonable(value))


def _differing(tables: dict[str, Any], defaults: dict[str, Any]) -> dict[str, Any]:
    """Return the keys whose values differ from the defaults; a table of another kind is kept whole."""
    differing: dict[str, Any] = {}
    for key, value in tables.items():
        default = defaults.get(key)
        if key in defaults and value == default:
            continue
        is_alike = isinstance(value, dict) and isinstance(default, dict) and value.get("kind") == default.get("kind")
        kind = {"kind": value["kind"]} if is_alike and "kind" in value else {}
        differing[key] = kind | _differing(value, default) if is_alike else value  # type: ignore[arg-type]
    return differing


def _read_text(file: Path) -> str:
    content = regular_or_missing(file).read_bytes().removeprefix(BOM_UTF8)  # editors on Windows may add it
    try:
        return content.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        if packed := next((name for start, name in COMPRESSED.items() if content.startswith(start)), None):
            raise ScenarioError(f"{file}: not TOML: it is compressed by {packed}; decompress it first") from error
        line = content.count(b"\n", 0, error.start) + 1
        raise ScenarioError(f"{file}:{line}: not TOML: not UTF-8 text ({error.reason})") from error


def _syntax_error(file: str | PathLike[str], message: str, text: str) -> str:
    """Return the error message for a text that is not TOML, with file and line, given the message of `tomllib`."""
    match = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)$", message)
    last = text.rstrip().count("\n") + 1
    if not match and (unread := unreadable(text)):  # a message without a line
        return f"{file}:{unread}: not TOML that can be read: {message}"
    line = min(int(match[1]), last) if match and match[1] else last
    problem = message[: match.start()] if match else message
    if problem in UNCLOSED:
        return f"{file}:{line}: not TOML: a text is not closed by a quote{_opened(text, line)}"
    if meant := what_was_meant(text.split("\n")[line - 1]):
        return f"{file}:{line}: not TOML: {meant}"
    if problem.startswith("Cannot declare"):
        problem = re.sub(r"\('(.*?)',?\)", lambda head: f"[{head[1].replace(DOT, '.')}]", problem)
        problem += ": a table has one head, below which all its keys are"
    column = f" (column {match[2]})" if match and match[2] else ""
    return f"{file}:{line}: not TOML: {problem}{column}"


COMPRESSED = {b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"\x28\xb5\x2f\xfd": "zstd", b"PK\3\4": "zip"}
"""The first bytes of compressed files, and the program that reads them."""
TOML_TYPES = (str, bool, int, float, Decimal, date, time)
"""The types of values without parts that TOML has."""
DOT = "', '"
"""What `tomllib` writes between the parts of a key."""
UNCLOSED = {r"Illegal character '\n'", "Unterminated string", """Expected "'\"""", "Expected '\"'"}
"""The messages of `tomllib` for a text without a closing quote."""


def _opened(text: str, line: int) -> str:
    """Return the column of the last quote on a line, as the end of a message; "" if the line has none."""
    column = max(map(text.split("\n")[line - 1].rfind, "\"'")) + 1
    return f" (opened in column {column})" if column else ""

"""The source of a scenario before validation: its tables, overrides of keys, and the origin of each key."""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Self, cast

from pydantic import BaseModel, BeforeValidator
from pydantic.fields import FieldInfo

from desim.config.arguments import value_text
from desim.config.choice import OneOf, choices_of
from desim.config.errors import KeyedError, KeyPath, Problem, problems_of
from desim.config.field_docs import fields_of
from desim.config.key_errors import model_of
from desim.config.model import Value
from desim.config.model_parts import markers_of
from desim.config.parameters import not_kept, parameters_of
from desim.config.python_numbers import as_python
from desim.config.suggestion import did_you_mean
from desim.config.tables import holds, value_at
from desim.kernel.models.presets import PRESETS
from desim.scenario.override_texts import key_and_value, key_and_values

_QUOTED = re.compile(r"""(["'])([^"']+)\1""")
"""Matches a part of a key in quotes."""
MAX_INDEX_DIGITS = 18
"""Number of digits up to which a part of a key is an index; Python refuses to read thousands of digits."""


class ScenarioError(KeyedError):
    """A scenario is not valid; the text has one line per problem, and `problems` has them as fields."""


@dataclass(frozen=True)
class Source:
    """A scenario as given, before validation: its tables and the origin of each key."""

    name: str
    """The path of the file, or a description of another source."""
    tables: dict[str, Any]
    model: type[Value]
    """The class of the scenario."""
    lines: dict[KeyPath, int] | None = None
    """The line of each key; None if the source is not a text."""
    origins: dict[KeyPath, str] = field(default_factory=dict)
    """For each key that was overridden, a description of the override."""
    folder: Path | None = None
    """The folder in which files and modules that the scenario names are looked up; None: the folder of the file."""
    allow_import: bool = False
    """Whether the scenario may name code to be run, and files outside of `folder`."""
    files: dict[KeyPath, str] = field(default_factory=dict)
    """For each key whose value is from a base (a file that the key `base` names), the path of this base."""
    is_program: bool = False
    """Whether a program has given it; then warnings tell the program how files are read that it names."""

    @classmethod
    def of(cls, scenario: Value) -> Self:
        """Return the source of a scenario that was constructed in Python: the arguments given, without defaults."""
        return cls("the scenario", _tables(scenario), type(scenario), allow_import=True, is_program=True)

    def where(self, place: KeyPath) -> str:
        """Return the place where a key was set: `file:line`, or the description of the last override.

        In a source without lines, the place of a key without an override is the name of the source.
        """
        origin, line = self._set_at(place)
        return f"{origin}:{line}" if line else origin

    def line(self, place: KeyPath) -> int:
        """Return the line where a key was set; 0 if it was set by an override, or the source has no lines."""
        return self._set_at(place)[1]

    def _set_at(self, place: KeyPath) -> tuple[str, int]:
        """Return (origin, line) of a key.

        If the key was overridden, the origin is the description of the last override and the line is 0. Otherwise, they
        are the file and the line where the key was set; in a source without lines, the name of the source and 0.
        """
        lines = self.lines or {}
        dotted = tuple(part for key in place for part in (key.split(".") if isinstance(key, str) else [key]))
        places = lines.keys() | self.origins.keys()
        if place not in places and dotted in places:  # an unquoted dotted key of the grid, which TOML reads as tables
            place = dotted
        around = [place[:end] for end in range(len(place), 0, -1)]  # the place and those that contain it
        set_by = [text for key, text in self.origins.items() if key in around]
        if not set_by and place not in lines:  # the override of an inner key has created the table
            set_by = [text for key, text in self.origins.items() if key[: len(place)] == place]
        if set_by:
            return set_by[-1], 0
        if self.lines is None:
            return self.name, 0
        nearest = next((outer for outer in around if outer in lines), ())
        return self.files.get(nearest, self.name), lines.get(nearest, 1)

    def copy(self) -> Self:
        """Return a copy that can be changed independently."""
        return replace(self, tables=_copied(self.tables), origins=dict(self.origins))

    def over(self, base: Self) -> Self:
        """Return this source with the keys that it lacks taken from a base; neither may have overrides.

        Tables are merged key by key; a bare text or number in the base counts as the table that it stands for. Any
        other value replaces the value of the base. When the kind of a table changes, the keys of the base that the new
        kind does not have are left out.
        """
        lines, files = dict(base.lines or {}), dict.fromkeys(base.lines or {}, base.name) | base.files
        merged = replace(self, tables=_copied(base.tables), lines=lines, files=files)
        for place in merged._merge(self.tables, ()):
            for inner in [key for key in lines if key[: len(place)] == place]:
                del lines[inner]  # the base's line of a value that is replaced
        for place, line in (self.lines or {}).items():
            lines[place] = line
            files.pop(place, None)
        return merged

    def _merge(self, tables: dict[str, Any], above: KeyPath) -> Iterator[KeyPath]:
        """Merge tables into the table of this source at `above`, and yield the place of every value that is set."""
        table = value_at(self.tables, above)
        lines, files = cast("dict[KeyPath, int]", self.lines), self.files
        if "kind" in tables and tables["kind"] != table.get("kind"):
            self._remove_misfits(above, tables["kind"])
            table["kind"] = tables["kind"]  # first, because it determines the models of nested tables
        for key, value in tables.items():
            place = *above, key
            if isinstance(value, dict) and isinstance(table.get(key), str | int | float):
                with suppress(ValueError):  # a text that stands for no table is replaced
                    table[key] = self._as_table(place)
                for inner in table[key] if isinstance(table[key], dict) else ():  # keys on the line of the bare value
                    lines[*place, inner], files[*place, inner] = lines[place], files[place]
            if isinstance(value, dict) and isinstance(table.get(key), dict):
                yield from self._merge(value, place)
            else:
                table[key] = _copied(value)
                yield place

    def at(self, parts: Sequence[str]) -> Any:
        """Return the value at a dotted key, given as its parts; None if there is none."""
        node: Any = self.tables
        for part in parts:
            key = _key(part, node)
            node = node[key] if holds(node, key) else None
        return node

    def override(self, text: str, origin: str | None = None) -> None:
        """Set a key to a value: "key.key=value", the value in TOML.

        `origin` says in errors where the value is set; None: by --set with this text.

        Raises:
            ScenarioError: if the text does not have this form, or the key cannot be set to this value; see `set`.
        """
        self._set_read(origin or f"--set {text}", lambda: key_and_value(text))

    def vary(self, text: str) -> None:
        """Add a key to the grid of the sweep, or replace its values: "key.key=value,value,...", each value in TOML.

        Raises:
            ScenarioError: if the text does not have this form, or the key cannot be set; see `set`.
        """
        self._set_read(f"--grid {text}", lambda: key_and_values(text), above="sweep.grid.")

    def change(self, name: Any, value: Any) -> None:
        """Set a key to a value of Python.

        Raises:
            ScenarioError: if the name is not a dotted key, or the key cannot be set to this value; see `set`.
        """

        def read() -> tuple[str, Any]:
            if not isinstance(name, str) or not all(name.split(".")):
                raise ValueError(f"a dotted key is for instance network.latency.value (got {value_text(name)})")
            return name, as_python(value)

        self._set_read("with_", read)

    def _set_read(self, origin: str, read: Callable[[], tuple[str, Any]], above: str = "") -> None:
        """Set a key to a value, which `read` returns; the text `above` is put before the key."""
        try:
            name, value = read()
            self.set(above + name, value, origin)
        except ValueError as error:
            raise ScenarioError(*(problem._replace(where=origin) for problem in problems_of(error))) from None

    def set(self, name: str, value: Any, origin: str) -> None:
        """Set a dotted key to a value; missing tables get their default kind, missing lists their default items.

        A bare string or number in place of a table becomes the table that it stands for: "cbba", for instance, stands
        for { kind = "cbba" }.

        When the kind of a table changes, the keys that the new kind does not have are removed, except overridden keys.

        Raises:
            ScenarioError: if the name is not a key of a table or leads into an empty list, or if a model that was
                constructed in Python rejects the value.
        """
        place: KeyPath = ()
        node: Any = self.tables
        default: Any = _defaults(self.model, self.tables)
        *parents, last = parts = self._parts(name)
        for depth, part in enumerate(parents, start=1):
            key = _key(part, node)
            default = default.get(key) if isinstance(default, dict) else None
            if isinstance(default, tuple) and not holds(node, key):  # the name leads into a list that is not given
                if not default or not isinstance(node, dict):
                    raise ScenarioError(Problem(_empty_list(".".join(map(str, (*place, key)))), name))
                node[key] = [*default]
            if isinstance(node, dict) and key not in node:
                node[key] = {"kind": default["kind"]} if isinstance(default, dict) and "kind" in default else {}
            if holds(node, key) and (isinstance(node[key], Value) or callable(node[key])):  # a model made in Python
                try:
                    node[key] = _replaced(node[key], parts[depth:], value)
                except ScenarioError as error:
                    above = ".".join(map(str, (*place, key)))
                    raise ScenarioError(*(problem.below(above) for problem in error.problems)) from None
                self.origins[*place, key] = origin
                return
            if holds(node, key) and isinstance(node[key], str | int | float):
                node[key] = self._as_table((*place, key))
            if holds(node, key) and type(node[key]) is tuple:
                node[key] = list(node[key])
            node = node[key] if holds(node, key) else None
            place += (key,)
        key = _key(last, node)
        if not isinstance(node, dict) and not holds(node, key):
            raise ScenarioError(f"{name} is not a key of a table")
        if key == "kind" and node.get("kind") != value:
            self._remove_misfits(place, value)
        node[key] = _copied(value)  # a later override may change tables in the value
        self.origins.pop((*place, key), None)  # moves the key to the end: the last override counts
        self.origins[*place, key] = origin

    def _as_table(self, place: KeyPath) -> Any:
        """Return the table that a bare string or number at a place stands for; return any other value unchanged.

        Raises:
            ValueError: if a text is no short form of a table.
        """
        info, value = _field_at(self.model, self.tables, place), value_at(self.tables, place)
        for marker in reversed(markers_of(info)) if info else ():  # pydantic applies the last marker first
            if isinstance(marker, OneOf):
                value = marker.as_table(value)
            elif isinstance(marker, BeforeValidator) and isinstance(value, str):  # that of a property or a design
                read: Any = marker.func
                table = read(value)
                value = table if isinstance(table, dict) else value
        return value

    def _remove_misfits(self, place: KeyPath, kind: Any) -> None:
        """Remove the keys of a table that a new kind does not have, except overridden keys."""
        info = _field_at(self.model, self.tables, place)
        models = [one_of.choice(kind) for one_of in choices_of(info)] if info and isinstance(kind, str) else []
        for model in filter(None, models):
            table = value_at(self.tables, place)
            for key in table.keys() - model.model_fields.keys():
                if not any(overridden[: len(place) + 1] == (*place, key) for overridden in self.origins):
                    del table[key]

    def _parts(self, name: str) -> list[str]:
        """Return the parts of a dotted name, without the quotes that TOML allows around a part.

        What follows `sweep.grid` is one part, such as "team.count", unless the source has nested tables for it.
        """
        name = _QUOTED.sub(r"\2", name)
        parts = name.split(".")
        if parts[:2] != ["sweep", "grid"] or not parts[2:] or self.at(parts) is not None:
            return parts
        return ["sweep", "grid", name.removeprefix("sweep.grid.")]


def _field_at(whole: type[BaseModel], tables: dict[str, Any], place: KeyPath) -> FieldInfo | None:
    """Return the model field of a place in the tables of a scenario; for a list item, the field of the list.

    Return None if no model has such a field.
    """
    model: type[BaseModel] | None = whole
    info: FieldInfo | None = None
    for end, key in enumerate(place, start=1):
        if isinstance(key, str):
            info = fields_of(model).get(key) if model is not None else None
        model = model_of(info, value_at(tables, place[:end])) if info is not None else None
    return info


def _tables(model: Value) -> dict[str, Any]:
    """Return the arguments given to a model as tables; a nested model whose kind is not installed stays a model."""
    fields, names = type(model).model_fields, {"kind", *model.own_fields()}
    return {name: _table(value, fields[name]) for name, value in model if name in names}


def _table(value: Any, info: FieldInfo) -> Any:
    """Return the value of a field, with its models as tables and its tuples as lists."""
    if isinstance(value, tuple) and not callable(value):  # a model of a user may be a named tuple
        return [_table(item, info) for item in value]
    choices = choices_of(info)
    is_installed = not choices or any(choice.holds(value) for choice in choices)
    return _tables(value) if isinstance(value, Value) and is_installed else _copied(value)


def _replaced(model: Any, parts: list[str], value: Any) -> Any:
    """Return a copy of a model with a new value at a dotted key, given as its parts.

    Raises:
        ScenarioError: if the model has no such key or rejects the value.
    """
    name, *rest = parts
    parameters = dict(model) if isinstance(model, BaseModel) else parameters_of(model)
    class_name = type(model).__name__
    if parameters is None:
        text = f"{class_name} has no key {name!r}"
        raise ScenarioError(f"{text}: give another one, or make it a dataclass" if callable(model) else text)
    try:
        if rest and name in parameters:
            value = _replaced(parameters[name], rest, value)
    except ScenarioError as error:
        raise ScenarioError(*(problem.below(name) for problem in error.problems)) from None
    try:
        if isinstance(model, Value):
            return model.model_copy(update={name: value})
        if name not in parameters:
            hint = did_you_mean(name, parameters)
            raise ScenarioError(Problem(f"unknown key{hint}; allowed: {', '.join(sorted(parameters))}", name))
        if missing := not_kept(model):
            text = f"cannot be set: {class_name} does not keep {', '.join(missing)} (InitVar)"
            raise ScenarioError(Problem(text, name))
        return type(model)(**parameters | {name: value})
    except KeyedError as error:
        raise ScenarioError(*(problem._replace(where="") for problem in error.problems)) from None
    except ScenarioError:
        raise
    except (TypeError, ValueError) as error:
        raise ScenarioError(Problem(f"cannot be set: {class_name}: {error}", name)) from error


def _copied(tables: Any) -> Any:
    """Return a copy of nested tables and lists; all other values, such as models, are shared with the original."""
    if callable(tables):  # a model of a user may be a list, too
        return tables
    if isinstance(tables, dict):
        return {key: _copied(value) for key, value in tables.items()}
    return type(tables)(map(_copied, tables)) if type(tables) in {list, tuple} else tables


def _defaults(model: type[Value], tables: dict[str, Any]) -> dict[str, Any]:
    """Return the defaults of missing keys: those of the model, with the values of the network's preset, if any."""
    default = _tables_of_defaults(model)
    network = tables.get("network")
    preset = PRESETS.get(str(network.get("preset"))) if isinstance(network, dict) else None
    return default if preset is None else default | {"network": default["network"] | preset}


@cache
def _tables_of_defaults(model: type[Value]) -> dict[str, Any]:
    """Return the defaults of a model as tables, which callers only read; a sweep asks for them at every point."""
    return model().model_dump()


def _empty_list(name: str) -> str:
    """Return the message about an item of an empty list."""
    example = f"'{name}=[{{ kind = \"crash\", node = 3, start = 1.0 }}]'" if name == "fault" else f"{name}=[...]"
    return f"the list {name} is empty: set it as a whole, {example}"


def _key(part: str, node: Any) -> str | int:
    """Return a part of a dotted name as a key of a table or an index of a list."""
    is_index = isinstance(node, list) and part.isascii() and part.isdigit() and len(part) <= MAX_INDEX_DIGITS
    return int(part) if is_index else part

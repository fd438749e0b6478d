"""The errors of pydantic in sentences: which key is wrong, what is allowed there, and what may have been meant.

A scenario file and a call such as `Team(count=8)` have the same sentences. They differ only in how they say where a key
was set, and how a value is written.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, Tag, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from desim.config.arguments import abridged, with_article, without_addresses
from desim.config.choice import FILE_NAME, choices_of
from desim.config.error_texts import OF_EXCEPTIONS, text_of
from desim.config.errors import KeyedError, KeyPath, Problem
from desim.config.field_docs import fields_of, unit_in
from desim.config.key_suggestions import other_key, suggestion
from desim.config.model import Value
from desim.config.model_parts import markers_of, models_in
from desim.config.number_texts import counted, number_instead_of
from desim.config.python_numbers import Refused, as_python
from desim.config.tables import holds, value_at


def problems_of_call(error: ValidationError, model: type[BaseModel], values: Mapping[str, Any]) -> tuple[Problem, ...]:
    """Return the problems of a call of a model, given the error of pydantic and the values by key."""
    wording = Wording(values, model, written=repr, is_call=True)
    return tuple(
        Problem(reason, ".".join(map(str, place)), model.__name__) for place, reason in wording.all_problems(error)
    )


@dataclass(frozen=True)
class Wording:
    """How the errors of a table are put into sentences."""

    tables: Any
    """The table, with all its inner tables."""
    whole: type[BaseModel]
    """The model of the table."""
    written: Callable[[Any], str] = repr
    """Returns a value as the user writes it."""
    more: Callable[[KeyPath], Sequence[str]] | None = None
    """Returns the keys that are allowed beside an unknown key at the top, in addition to the fields of the model."""
    is_call: bool = False
    """Whether the table is the arguments of a call, in which objects may stand for tables."""
    model: type[Any] | None = None
    """The model of the table in which pydantic found the error, possibly a user's class; None: `whole`."""
    above: KeyPath = ()
    """The place of that table."""

    def all_problems(self, error: ValidationError) -> list[tuple[KeyPath, str]]:
        """Return the place and the reason of each problem, once: several members of a union may have the same one."""
        return list(dict.fromkeys(problem for detail in error.errors() for problem in self.problems(detail)))

    def problems(self, error: ErrorDetails) -> Iterator[tuple[KeyPath, str]]:
        """Yield the place and the reason of each problem that a pydantic error describes."""
        context = error.get("ctx", {})
        if error["type"] == "misfits":
            yield from context["misfits"]
            return
        place, owner, info = self._locate(error)
        if _is_of_another_member(error, owner, info):
            return
        if error["type"] == "user_model":
            inner = replace(self, model=context["model"], above=place)
            for detail in context["errors"]:
                yield from inner.problems(detail)
            return
        if isinstance(cause := context.get("error"), KeyedError):  # from a model that a validator constructed
            for problem in cause.problems:
                yield (*place, *problem.key.split(".")) if problem.key else place, problem.reason
            return
        # The first paragraph says what the key is; the next ones advise what to choose, too much for an error message.
        description = " ".join((info.description or "").partition("\n\n")[0].split()).rstrip(".") if info else ""
        note = f"; {description}" if description and error["type"] not in SAYS_ENOUGH else ""
        yield place, f"{self._reason(error, place, owner, info)}{note}{self._input_text(error)}"

    def _locate(self, error: ErrorDetails) -> tuple[KeyPath, type[BaseModel] | None, FieldInfo | None]:
        """Return the place of the key with an error, the model of the table that contains it, and its field.

        The path in a pydantic error also contains the tags of unions; the place does not.
        """
        model = self.model or self.whole
        place, node = self.above, value_at(self.tables, self.above)
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
            if info is not None and path and _is_tag(path, info, node, is_missing=error["type"] == "missing"):
                path.pop(0)
        if error["type"] in {"union_tag_invalid", "import_refused"}:  # pydantic reports these at the table
            key = str(error.get("ctx", {}).get("discriminator", "kind")).strip("'")
            place += (key if key.isidentifier() else "kind",)
        return place, owner, info

    def _reason(
        self, error: ErrorDetails, place: KeyPath, owner: type[BaseModel] | None, info: FieldInfo | None
    ) -> str:
        """Return the text of an error, with the allowed values; `owner` is the model of the table with the key."""
        error_type, context = error["type"], error.get("ctx", {})
        one_of = next(iter(choices_of(info)), None) if info else None
        kinds = list(one_of.choices()) if one_of else []
        if error_type == "extra_forbidden":
            return self._unknown_key(place, owner, context.get("allowed"))
        if error_type == "union_tag_invalid" and kinds:
            tag = without_addresses(str(context["tag"]))
            code = f", write '{tag[:-3]}:NAME' for what {tag} defines" if tag.endswith(".py") else ""
            hint = code or suggestion(tag, kinds)
            return f"there is no {tag!r}{hint}; allowed: {', '.join(kinds)}"
        if kinds and error_type in {"union_tag_not_found", *NOT_A_TABLE}:
            if self.is_call:
                what = f"a kind, {kinds[0]!r} for instance, a built-in model or an object that can be called"
                return f"should be {what}; allowed: {', '.join(kinds)}"
            return f'should be a table with a kind, {{ kind = "{kinds[0]}" }} for instance; allowed: {", ".join(kinds)}'
        if error_type == "missing":
            return "is missing"
        if error_type in NOT_A_TABLE:
            return self._no_table(error, place, info)
        if error_type == "tuple_type" and isinstance(error["input"], dict) and info and _holds_models(info):
            written = "in [...]" if self.is_call else f"headed by [[{place[-1]}]] instead of [{place[-1]}]"
            return f"should be a list of tables, {written}"
        if error_type == "tuple_type" and isinstance(file := error["input"], str) and FILE_NAME.search(file):
            return f"should be a list{_with_file(file, place, owner, info)}"
        if error_type in {"too_long", "too_short"}:
            bound, key = ("most", "max_length") if error_type == "too_long" else ("least", "min_length")
            return f"should have at {bound} {counted(context[key], 'item')}, has {context['actual_length'] or 'none'}"
        return (_no_number(error["input"], info) if error_type in NUMBERS else None) or text_of(error)

    def _unknown_key(self, place: KeyPath, owner: type[BaseModel] | None, allowed: Sequence[str] | None) -> str:
        """Return the text about a key that its table does not have; `allowed` are the keys of a user's class."""
        key = str(place[-1])
        if self.is_call and "." in key:
            outer, _, inner = key.partition(".")
            return f"a call has nested tables, {outer}={{{inner!r}: ...}}, and Scenario.with_ takes dotted keys"
        more = self.more(place) if self.more and owner is self.whole else ()
        allowed = allowed or (sorted([*owner.model_fields, *more]) if owner else [])
        hint = owner._replaced.get(key) if owner and issubclass(owner, Value) else None
        return f"unknown key{hint or other_key(place, allowed, self.whole)}; allowed: {', '.join(allowed)}"

    def _no_table(self, error: ErrorDetails, place: KeyPath, info: FieldInfo | None) -> str:
        """Return the text about a value in place of a table."""
        value = error["input"]
        if self.is_call:
            if (name := error.get("ctx", {}).get("class_name")) is None:  # of a union that a user's model has
                return "should be a table"
            if isinstance(value, type):
                return f"should be {with_article(name)}, not a class: {name}()"
            return f"should be {with_article(name)} or a table of its keys{_wrapped(value, info)}"
        if isinstance(value, list) and isinstance(place[-1], str):
            return f"should be one table, headed by [{place[-1]}] instead of [[{place[-1]}]]"
        return "should be a table"

    def _input_text(self, error: ErrorDetails) -> str:
        if error["type"] in {"extra_forbidden", "union_tag_invalid", "import_refused", "missing", "value_error"}:
            return ""
        is_text = error["type"] in NUMBERS and isinstance(error["input"], str)
        if is_text and (INFINITE.fullmatch(error["input"]) or number_instead_of(error["input"])):
            return ""
        value = error["input"]
        return f" (got {value if isinstance(value, Refused) else abridged(self.written(value))})"


NUMBERS = {"float_type", "int_type"}
"""Types of errors about a value in place of a number."""
INFINITE = re.compile(r"\+?inf(inite|inity)?", re.IGNORECASE)
"""Matches a text that stands for an infinite number."""
RANGE = re.compile(r"[\d.]*\d(\.\.+|-)\d[\d.]*")
"""Matches a range as other programs write it, 0..1 or 0-1 for instance."""
NOT_A_TABLE = {"model_type", "model_attributes_type"}
"""Types of errors about a value in place of a table."""
SAYS_ENOUGH = OF_EXCEPTIONS | {"union_tag_invalid", "import_refused"}
"""Types of errors whose texts say what the key is for, or list what is allowed."""


def _no_number(value: Any, info: FieldInfo | None) -> str | None:
    """Return the text about a value in place of a number, if it shows what is meant; None otherwise."""
    if RANGE.fullmatch(str(value)):
        return "should be a number; a range in a grid is written FIRST:LAST:STEP, 0:1:0.1 for instance"
    if INFINITE.fullmatch(str(value)):
        return f"should be inf without quotes instead of the text {value!r}"
    return number_instead_of(value, {(info and unit_in(info)) or "1"}) if isinstance(value, str) else None


def _with_file(file: str, place: KeyPath, owner: type[BaseModel] | None, info: FieldInfo | None) -> str:
    """Return how to give a file, named in place of a list, as the end of a message; "" if no model reads a file."""
    if owner and "file" in fields_of(owner):
        return f'; a file is another key: file = "{file}"'
    for model in models_in(info.annotation) if info else ():
        fields = fields_of(model)
        if "file" in fields and "kind" in fields:
            return f' or a table: {{ kind = "{fields["kind"].default}", file = "{file}" }}'
        if "file" in fields:
            return f': [[{place[-1]}]] with file = "{file}"'
    return ""


def _holds_models(info: FieldInfo) -> bool:
    """Return whether the items of a field are tables of models."""
    return bool([*choices_of(info), *models_in(info.annotation)])


def _wrapped(value: Any, info: FieldInfo | None) -> str:
    """Return how to put a model into the table in whose place it is given, as the end of a message; else "".

    An evasion strategy, for example, is a key of an evader: Evader(strategy=Still()).
    """
    if not isinstance(value, BaseModel) or info is None:
        return ""
    for outer in models_in(info.annotation):
        for name, field in fields_of(outer).items():
            if any(type(value) in one_of.choices().values() for one_of in choices_of(field)):
                return f": {outer.__name__}({name}={type(value).__name__}(...))"
    return ""


def model_of(info: FieldInfo, value: Any) -> type[BaseModel] | None:
    """Return the model class of the value of a field, or of its items; None if there is none."""
    for one_of in choices_of(info):
        with suppress(ValueError):  # numbers of numpy and others are bare numbers, too
            value = as_python(value)
        table = one_of.as_table(value) if type(value) in {int, float, str} else value
        return one_of.choice(str(table.get("kind"))) if isinstance(table, dict) else None
    models = [*models_in(info.annotation)]
    return next((model for model in models if _has_literals(model, value)), models[0] if models else None)


def _has_literals(model: type[BaseModel], table: Any) -> bool:
    """Return whether the keys of a table that select one of several models select this one."""
    literals = {name: get_args(field.annotation) for name, field in model.model_fields.items() if _is_literal(field)}
    return isinstance(table, dict) and all(table.get(name, values[0]) in values for name, values in literals.items())


def _is_literal(field: FieldInfo) -> bool:
    return get_origin(field.annotation) is Literal


def _is_tag(path: Sequence[str | int], info: FieldInfo, value: Any, *, is_missing: bool) -> bool:
    """Return whether the first part of the rest of a path stands for a member of a union, and is no key of its value.

    pydantic inserts such parts after a name or an index: the tag, or the name of the type.
    """
    part = path[0]
    if any(isinstance(marker, Tag) and marker.tag == part for marker in markers_of(info)):
        return True
    is_key = not isinstance(part, str) or holds(value, part) or (is_missing and len(path) == 1) or part == OF_KEY
    return not is_key and _has_union(info.annotation)


def _is_of_another_member(error: ErrorDetails, owner: type[BaseModel] | None, info: FieldInfo | None) -> bool:
    """Return whether an error is of a member of a union that the keys of the table, whose model is `owner`, exclude."""
    if error["type"] == "literal_error" and info is not None and _is_literal(info):
        return error["input"] in get_args(info.annotation)
    return error["type"] == "extra_forbidden" and owner is not None and error["loc"][-1] in owner.model_fields


OF_KEY = "[key]"
"""The last part of the path of an error about a key of a dict itself."""


def _has_union(annotation: Any) -> bool:
    """Return whether there is a union in an annotation, other than with None."""
    inner = [argument for argument in get_args(annotation) if argument is not type(None)]
    is_union = get_origin(annotation) in {Union, UnionType} and len(inner) > 1
    return is_union or (get_origin(annotation) is not Literal and any(map(_has_union, inner)))

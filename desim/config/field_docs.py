"""The descriptions of fields: the string below each, parsed from the source of its module on demand.

With pydantic's `use_attribute_docstrings`, parsing when each class is created would take longer than a short run.
"""

import ast
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from inspect import cleandoc, getsource
from itertools import pairwise
from types import MappingProxyType

from pydantic import BaseModel
from pydantic.fields import FieldInfo

if sys.version_info >= (3, 14):
    from annotationlib import Format, get_annotations
else:
    from inspect import get_annotations

UNIT = re.compile(r", (1/s|m/s|rad/s|rad/sqrt\(s\)|bit/s|Hz|kHz|dB|dBm|rad|s|m)(?=[;:,.]|$)")
"""Finds the unit in a description, such as "Mean one-way latency, s."."""


def unit_in(field: FieldInfo) -> str | None:
    """Return the unit in the description of a field; None if it has none."""
    match = UNIT.search(field.description or "")
    return match[1] if match else None


def fields_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model by name, after setting the descriptions that are missing."""
    fields = model.model_fields
    if not all(field.description for field in fields.values()):
        docs = docs_of(model)
        for name, field in fields.items():
            field.description = field.description or docs.get(name)
    return fields


Docs = Mapping[str, str]
"""The descriptions of the fields of a class, by name; fields without a string below them are absent."""


@cache  # one error asks for the fields of all models around its key
def docs_of(model: type) -> Docs:
    """Return the string below each field of a class and of its base classes, by name.

    A class that annotates a field anew, without a string, drops the inherited string.
    """
    docs: dict[str, str] = {}
    for base in reversed(model.__mro__):
        own_docs = _docs(base.__module__).get(base.__qualname__, {})
        docs = {**{name: text for name, text in docs.items() if name not in annotated(base)}, **own_docs}
    return MappingProxyType(docs)


def annotated(model: type) -> list[str]:
    """Return the names annotated in a class, without those of its base classes; the annotations are not evaluated."""
    if sys.version_info >= (3, 14):
        return [*get_annotations(model, format=Format.FORWARDREF)]
    return [*get_annotations(model)]


@cache
def _docs(module: str) -> Mapping[str, Docs]:
    """Return the strings below the fields of each class of a module; empty if its source is not available."""
    try:
        tree = ast.parse(getsource(sys.modules[module]))
    except (KeyError, OSError, TypeError):
        return MappingProxyType({})
    return MappingProxyType(dict(_classes(tree, "")))


def _classes(node: ast.AST, prefix: str) -> Iterator[tuple[str, Docs]]:
    """Yield the qualified name of each class within a syntax tree node, and the strings below its fields."""
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, ast.ClassDef):
            yield prefix + inner.name, dict(_strings(inner))
            yield from _classes(inner, f"{prefix}{inner.name}.")
        else:
            within = f"{prefix}{inner.name}.<locals>." if isinstance(inner, ast.FunctionDef) else prefix
            yield from _classes(inner, within)


def _strings(node: ast.ClassDef) -> Iterator[tuple[str, str]]:
    for field, below in pairwise(node.body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, cleandoc(text)

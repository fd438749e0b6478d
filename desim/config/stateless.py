"""Which objects have no state, so that a run uses them as they are; see `desim.config.fresh`."""

import csv
import re
import sys
from collections.abc import Iterator
from functools import lru_cache
from io import BytesIO, IOBase, StringIO
from os import SEEK_END
from struct import Struct
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, ModuleType, NoneType
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel

from desim.config.code_variables import COLLECTIONS, defaults_of
from desim.config.python_numbers import ATOMS
from desim.config.traits import OURS, module_of

CONSTANTS = ATOMS | {complex, bytes}
"""The types of values that hold nothing else and never change."""
NEVER_CHANGED = OURS | {
    *("networkx", "pydantic_core", "pathlib", "threading", "_thread", "queue", "_queue", "_contextvars"),
}
"""The packages and modules whose objects a copy shares: they do not change while a model holds them, or connect
threads, such as locks."""

UNCOPIED = (Struct, re.Match, np.ufunc)
"""Types whose objects never change, and which pickle cannot copy."""
CSV_WRITER = type(csv.writer(StringIO()))
"""The type of what `csv.writer` returns."""


def is_output(value: Any) -> bool:
    """Return whether an object is a stream to which code only writes, such as a log file: it reports to the caller.

    A buffer in memory is one while its position is at its end, also if it is empty; otherwise code reads it.
    """
    if value is sys.stdout or value is sys.stderr or type(value) is CSV_WRITER:
        return True
    if not isinstance(value, IOBase) or value.closed or not value.writable():
        return False
    if not isinstance(value, BytesIO | StringIO):
        return not value.readable()
    position = value.tell()
    end = value.seek(0, SEEK_END)
    value.seek(position)
    return position == end


def is_stateless_module(name: str) -> bool:
    """Return whether copies share the objects of the classes of a module, given its name; not those of graphs.

    A function that pydantic validates has an object of an internal class, which cannot be copied.
    """
    is_shared = name.partition(".")[0] in NEVER_CHANGED or name.startswith("pydantic._internal.")
    return is_shared and not name.startswith("networkx.classes.")


@lru_cache(maxsize=256)
def _form(kind: type) -> Literal["constant", "model", "items", "values", "object"]:
    """Return how `users_objects` goes through a value of a type."""
    if kind in {tuple, list}:
        return "items"
    if kind is dict:
        return "values"
    if not is_stateless_module(module_of(kind)):
        return "constant" if kind in {*CONSTANTS, np.ndarray} else "object"
    if issubclass(kind, tuple):  # a named tuple, such as a metric with its unit
        return "items"
    return "model" if issubclass(kind, BaseModel) else "constant"


def _is_ours(value: Any) -> bool:
    """Return whether a value is a function of desim at the top level, which has no state."""
    return type(value) is FunctionType and value.__closure__ is None and is_stateless_module(module_of(value))


def users_objects(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted key and the value of each object in a model that is neither a built-in model nor a constant."""
    kind: type = type(value)
    form = _form(kind)
    if form == "object":
        if not _is_ours(value):
            yield key, value
    elif form != "constant":
        inner = enumerate(value) if form == "items" else (vars(value) if form == "model" else value).items()
        for name, item in inner:
            inner_kind: type = type(item)
            if _form(inner_kind) != "constant":  # most items are constants, and a call for each adds half to the time
                yield from users_objects(item, f"{key}.{name}" if key else str(name))


def is_stateless(value: Any, *, with_collections: bool = False) -> bool:
    """Return whether a value is a constant, or a function, class or module without state; see `fresh_copy`."""
    kind = type(value)
    if kind is FunctionType:
        variables = *defaults_of(value), *(value.__closure__ or ())
        return _is_ours(value) or all(
            (not with_collections and is_collection(item)) or _is_constant(item) for item in variables
        )
    if kind is BuiltinFunctionType:
        return isinstance(value.__self__, ModuleType | NoneType)
    return kind in CONSTANTS or isinstance(value, (type, ModuleType, CodeType, *UNCOPIED))


def _is_constant(value: Any) -> bool:
    """Return whether a default of a function cannot change."""
    if type(value) in {tuple, frozenset}:
        return all(map(_is_constant, value))
    return not (isinstance(value, (*COLLECTIONS, FunctionType)) or any(True for _ in users_objects(value)))


def is_collection(variable: Any) -> bool:
    """Return whether a default, or a variable of an enclosing function, is a collection that the caller may read.

    A method of a collection, such as `calls.append`, counts as the collection.
    """
    try:
        value = variable.cell_contents if type(variable) is CellType else variable
    except ValueError:  # the variable has no value yet
        return False
    return isinstance(value.__self__ if type(value) is BuiltinFunctionType else value, COLLECTIONS)

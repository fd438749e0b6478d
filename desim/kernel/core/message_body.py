"""The bodies of messages: which objects can be sent, when they are copied, and when two of them differ.

A body is what its sender wrote into it when it was sent. A body that consists of immutable objects is shared by all
receivers and the trace. Any other body is copied at sending, and once more for each receiver.
"""

import datetime
import functools
import types
import uuid
from collections import deque
from collections.abc import Callable, Iterable
from copy import deepcopy
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from pathlib import PosixPath, PurePosixPath, PureWindowsPath, WindowsPath
from typing import Any

import numpy as np
from pydantic import BaseModel

from desim.config.arguments import value_text
from desim.kernel.core.body_content import (
    JSON_ATOMS,
    Fields,
    check_depth,
    computed_names,
    content,
    in_json_types,
    is_missing,
    stored_parts,
)

ATOMS = JSON_ATOMS | {
    *(complex, bytes, range, type(Ellipsis), Decimal, Fraction, uuid.UUID),
    *(datetime.date, datetime.time, datetime.datetime, datetime.timedelta, datetime.timezone),
    *(PurePosixPath, PureWindowsPath, PosixPath, WindowsPath),
    *(set(np.sctypeDict.values()) - {np.void, np.object_}),
}
"""Types without parts whose objects never change. Derived types do not count, because their objects may have
attributes."""
COMPARED = (int, float, complex, np.generic, tuple)
"""Types whose objects may equal an object of another one of these types, as 1 equals 1.0."""
SHARED = (list, dict, set, bytearray, deque, np.ndarray)
"""Types of collections that can be changed, so that a sender and its receivers must not share them."""
COPIED = {
    "generator": "a list, or what a method returns,",
    "mappingproxy": "a dict",
    "dict_keys": "a list",
    "dict_values": "a list",
    "dict_items": "a list",
}
"""What to send instead of an object that Python cannot copy, by the name of its type."""
Parts = Callable[[Any], Iterable[Any]]
"""A function that returns the objects of which an object consists."""


def as_sent(body: Any) -> Any:
    """Return the body as it is sent: changes that the sender makes later do not affect it.

    A body that is known to be immutable (`is_immutable`) is returned as it is. Any other body is copied deeply, once,
    and each receiver gets a copy of this copy (`own_copy`).

    Raises:
        ValueError: if the body cannot be copied or recorded, contains itself, or is nested more than `MAX_DEPTH` levels
            deep.
    """
    try:
        if is_immutable(body):
            return body
        if isinstance(body, memoryview):
            return memoryview(body.tobytes())  # `deepcopy` cannot copy it
        copied = deepcopy(body)
        _check_copy(body, copied)
    except Exception as error:
        reason = f"it is nested too deeply{_probable_reason(body)}" if isinstance(error, RecursionError) else str(error)
        reason += next((f": send {other} instead" for kind, other in COPIED.items() if f"'{kind}'" in reason), "")
        raise ValueError(f"a body of type {type(body).__name__} cannot be sent: {reason}") from error
    return copied


def own_copy(body: Any) -> Any:
    """Return the copy of a sent body for one of its receivers, whose changes affect no other node."""
    return body if is_immutable(body) else deepcopy(body)


def _check_copy(value: Any, copied: Any, depth: int = 0) -> None:
    """Check that a deep copy of an object has its class and its content, and shares no collection with it.

    A class can define how it is copied. pandas, for instance, does not copy the lists in a series. An object that is
    its own copy, such as a symbol of an algebra system, counts as immutable, unless its class defines `__deepcopy__`
    and the object holds a collection.

    Raises:
        ValueError: if the copy differs in one of these, or is nested more than `MAX_DEPTH` levels deep.
    """
    check_depth(depth)
    if type(copied) is not type(value):
        raise ValueError(f"its copy is of another class, {type(copied).__name__}{_probable_reason(value)}")
    if is_missing(copied):
        return
    if type(copied) in ATOMS:
        if copied is not value and copied != value and copied == copied:  # nan differs from itself
            raise ValueError(f"its copy has {value_text(copied)} where it has {value_text(value)}")
        return
    if copied is value and isinstance(value, SHARED):
        raise ValueError(f"its copies would share a {type(value).__name__}")
    if isinstance(copied, np.ndarray) and copied.dtype.kind in "biufc":
        return
    if copied is value:
        in_json_types(value)  # raises if the content is unknown
        if isinstance(value, tuple):  # a tuple is its own copy if each of its items is
            for item in value:
                _check_copy(item, item, depth + 1)
        if hasattr(type(value), "__deepcopy__"):
            for part in stored_parts(value):
                if isinstance(part, SHARED):
                    raise ValueError(f"its copies would share a {type(part).__name__}")
        return
    parts, copies = content(value), content(copied)
    if isinstance(copies, Fields):
        for name, copied_part in copies.items():  # a copy may lack attributes that are computed from others
            if name in parts and (name[0] != "_" or copied_part is not None):
                _check_copy(parts[name], copied_part, depth + 1)
    elif isinstance(copies, list):
        for part, copied_part in zip(parts, copies, strict=True):
            _check_copy(part, copied_part, depth + 1)
    else:
        _check_copy(parts, copies, depth + 1)


def _probable_reason(value: Any) -> str:
    """Return the probable reason why an object cannot be copied, after a colon; "" if it is not known."""
    passes_on = hasattr(type(value), "__getattr__") and not hasattr(type(value), "__deepcopy__")
    return ": its __getattr__ should pass on no names that begin with __" if passes_on else ""


def is_immutable(value: Any, depth: int = 0) -> bool:
    """Return whether an object is known to be immutable, and so are all objects that it consists of.

    Raises:
        ValueError: if it is nested more than `MAX_DEPTH` levels deep.
    """
    kind: Any = type(value)
    if kind in ATOMS:
        return True
    parts = _immutable_parts(kind)
    if parts is None:
        return False
    if depth > 0:  # the outermost level needs no check
        check_depth(depth)
    for part in parts(value):  # noqa: SIM110  # a loop takes a third of the time of `all`
        if type(part) not in ATOMS and not is_immutable(part, depth + 1):
            return False
    return True


@functools.cache
def _immutable_parts(kind: Any) -> Parts | None:
    """Return the function that returns the parts of an object of an immutable type; None for any other type."""
    is_missing_number = kind is type(np.ma.masked) or (kind.__name__ == "NAType" and kind.__module__[:7] == "pandas.")
    if is_missing_number or issubclass(kind, Enum | type):
        return lambda _: ()
    if kind is frozenset or (issubclass(kind, tuple) and not kind.__dictoffset__):  # 0: without attributes
        return iter
    if kind is memoryview:
        return lambda octets: (octets.obj,)
    if issubclass(kind, types.FunctionType):
        return _variables
    if issubclass(kind, types.BuiltinFunctionType):
        return lambda function: () if isinstance(function.__self__, types.ModuleType | None) else (function.__self__,)
    return _attributes_of_frozen if _is_frozen(kind) else None


def _is_frozen(kind: type) -> bool:
    """Return whether a type is a frozen dataclass or pydantic model, without attributes that are computed later.

    A class that is derived from a frozen dataclass, and is none itself, lets its objects have other attributes.
    """
    if computed_names(kind):
        return False
    if issubclass(kind, BaseModel):
        return bool(kind.model_config.get("frozen"))
    parameters: Any = vars(kind).get("__dataclass_params__")
    return parameters is not None and bool(parameters.frozen)


def _attributes_of_frozen(value: Any) -> list[Any]:
    if isinstance(value, BaseModel):
        hidden = value.model_extra, value.__pydantic_private__
        return [part for table in (vars(value), *hidden) for part in (table or {}).values()]
    return stored_parts(value)


def _variables(function: types.FunctionType) -> list[Any]:
    """Return the objects to which a function refers, except itself and global variables."""
    cells = [cell.cell_contents for cell in function.__closure__ or () if cell != types.CellType()]  # not an empty one
    defaults = *(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()
    return [referent for referent in (*cells, *defaults, *vars(function).values()) if referent is not function]


def differs(value: Any, other: Any) -> bool:
    """Return whether two objects are unequal.

    Objects of different types are unequal, unless both are numbers or tuples. Objects whose comparison gives no
    boolean, such as arrays, are unequal if their contents are.

    Raises:
        ValueError: if the content is needed and not known.
    """
    if type(value) is not type(other) and not (isinstance(value, COMPARED) and isinstance(other, COMPARED)):
        return True
    try:
        is_unequal = value != other
    except ValueError:  # an array in a collection is neither equal nor unequal
        is_unequal = None
    if isinstance(is_unequal, bool | np.bool_):
        return bool(is_unequal)
    return repr(in_json_types(value)) != repr(in_json_types(other))  # as texts, in which nan equals nan


@content.register(types.FunctionType)
@content.register(types.BuiltinFunctionType)
def _function(function: Any) -> str:
    if not is_immutable(function):  # a deep copy of a function is the function itself
        raise ValueError(f"the function {function.__qualname__} refers to objects that may change")
    return str(function.__qualname__)

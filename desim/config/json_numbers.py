"""Conversion of values to and from JSON: infinity and NaN, which JSON lacks, become strings.

The protocol `Plain` marks values that convert themselves; the functions of this module do not call `plain`.
"""

from collections.abc import Mapping
from functools import cache
from math import isfinite, isnan
from typing import Any, Protocol, runtime_checkable

UNCHANGED = frozenset({bool, int, str, type(None)})
"""Types of values that JSON has."""


@runtime_checkable
class Plain(Protocol):
    """A value with a method `plain` that converts it to JSON types."""

    def plain(self) -> Any:
        """Return the value in JSON types."""
        ...


@cache
def has_plain(kind: type) -> bool:
    """Return whether the objects of a type are `Plain`."""
    return issubclass(kind, Plain)


@cache
def field_names(kind: type) -> tuple[str, ...] | None:
    """Return the names of the fields of a type of named tuples; None for any other type."""
    named = (vars(base)["_fields"] for base in kind.__mro__ if "_fields" in vars(base))
    return next(named, None) if issubclass(kind, tuple) else None


def to_json(value: Any) -> Any:
    """Return a value with strings in place of infinity and NaN, and lists in place of tuples."""
    if type(value) in UNCHANGED:  # the next check is slow: without this line a summary takes 3 times as long
        return value
    if type(value) is float:
        return value if isfinite(value) else _name_of(value)
    if isinstance(value, Mapping):
        return {key: to_json(member) for key, member in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(element) for element in value]
    return _name_of(value) if isinstance(value, float) and not isfinite(value) else value


def _name_of(value: float) -> str:
    """Return infinity or NaN as a string."""
    return "NaN" if isnan(value) else "Infinity" if value > 0.0 else "-Infinity"


def json_number(value: Any) -> Any:
    """Return None for NaN (the mean of no values), and `to_json(value)` for any other value."""
    return None if isinstance(value, float) and isnan(value) else to_json(value)


def from_json(value: Any) -> Any:
    """Return a JSON value with the strings "Infinity", "-Infinity" and "NaN" replaced by numbers."""
    if isinstance(value, dict):
        return {key: from_json(member) for key, member in value.items()}
    if isinstance(value, list):
        return [from_json(element) for element in value]
    return float(value) if value in ("Infinity", "-Infinity", "NaN") else value

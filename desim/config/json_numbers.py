"""Conversion of infinity and NaN, which JSON lacks, to the strings "Infinity", "-Infinity" and "NaN" and back."""

from collections.abc import Mapping
from math import isfinite, isnan
from typing import Any


def to_json(value: Any) -> Any:
    """Return a value with infinity and NaN replaced by strings and tuples by lists."""
    if isinstance(value, Mapping):
        return {key: to_json(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(each) for each in value]
    if not isinstance(value, float) or isfinite(value):
        return value
    return "NaN" if isnan(value) else "Infinity" if value > 0.0 else "-Infinity"


def from_json(value: Any) -> Any:
    """Return a JSON value with the strings that `to_json` writes replaced by numbers."""
    if isinstance(value, dict):
        return {key: from_json(each) for key, each in value.items()}
    if isinstance(value, list):
        return [from_json(each) for each in value]
    return float(value) if value in ("Infinity", "-Infinity", "NaN") else value

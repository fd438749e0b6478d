"""What a scenario is made of that is not desim's: classes and functions of scripts, notebooks and other packages."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from pydantic import BaseModel

from desim.value import home_of

OURS = {"desim", "protocols", "builtins", "functools"}
"""The packages whose classes and functions are no strangers."""


def parts(value: Any, seen: set[int] | None = None) -> Iterator[Any]:
    """Yield what is called in a value, or in what it is made of, once each.

    Args:
        value: a model, a list, a tuple, a partial call, or anything that is made of nothing.
        seen: the `id` of what has been looked into, for many runs are of one scenario.
    """
    seen = set() if seen is None else seen
    if id(value) in seen:
        return
    seen.add(id(value))
    inner: Any = ()
    if isinstance(value, BaseModel):
        inner = [getattr(value, name) for name in type(value).model_fields]
    elif isinstance(value, tuple | list):
        inner = value
    elif isinstance(value, partial):
        inner = [value.func, *value.args, *value.keywords.values()]
    if callable(value):
        yield value
    for each in inner:
        yield from parts(each, seen)


def strangers(value: Any) -> Iterator[Any]:
    """Yield the functions, and the classes of models, that are called in a value and do not belong to desim."""
    for each in parts(value):
        if is_strange(each):
            yield home_of(each)


def is_strange(value: Any) -> bool:
    """Return whether a function, or the class of an object, does not belong to desim."""
    return str(home_of(value).__module__).partition(".")[0] not in OURS

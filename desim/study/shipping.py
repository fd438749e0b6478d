"""How calls travel to other processes: by value, with all that is not installed there."""

import os
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import FunctionType
from typing import Any

import cloudpickle
from pydantic import BaseModel

Call = partial[Any]
"""A function and its arguments."""


class Shipped:
    """A call that travels by value, whatever the executor pickles with.

    So what is defined in a script, in a cell of a notebook or in a module beside a scenario file works on all.
    """

    def __init__(self, call: Call):
        self._call = call

    def __call__(self) -> Any:
        """Make the call."""
        return self._call()

    def __reduce__(self) -> tuple[Any, ...]:
        own = {sys.modules[each.__module__] for each in strangers(self._call.args) if _is_own(each.__module__)}
        for module in own:
            cloudpickle.register_pickle_by_value(module)
        try:
            return cloudpickle.loads, (cloudpickle.dumps(self._call),)
        finally:
            for module in own:
                cloudpickle.unregister_pickle_by_value(module)


def strangers(value: Any) -> Iterator[Any]:
    """Yield the classes and functions in a value, or in what it is made of, that do not belong to desim."""
    home = value if isinstance(value, FunctionType) else type(value)
    if home.__module__.partition(".")[0] not in {"desim", "protocols", "builtins"}:
        yield home
    inner: Any = ()
    if isinstance(value, BaseModel):
        inner = (getattr(value, name) for name in type(value).model_fields)
    elif isinstance(value, tuple | list):
        inner = value
    for each in inner:
        yield from strangers(each)


def _is_own(name: str) -> bool:
    """Return whether a module is not installed, but lies somewhere."""
    file = getattr(sys.modules.get(name), "__file__", None)
    if name == "__main__" or file is None:  # what is defined there travels by value anyway
        return False
    installed = {"site-packages", "dist-packages"} & set(Path(file).parts)
    return not installed and not Path(file).is_relative_to(Path(os.__file__).parent)

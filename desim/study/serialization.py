"""Serialization of calls for other processes: as bytes, with user code by value.

Functions and classes that are defined in a script, a notebook or a module beside a scenario file therefore work in any
worker. They also work with any executor, because its pickler sees only bytes and the function `called`.
"""

import os
import pickle
import sys
from functools import cache, partial
from pathlib import Path
from typing import Any

import cloudpickle

from desim.study.fingerprint import OURS, user_code

Call = partial[Any]
"""A function and its arguments."""


def packed(call: Call) -> bytes:
    """Return a call as bytes, with the modules of its user code that are not installed."""
    own = [sys.modules[name] for name in _own_modules(call) - set(cloudpickle.list_registry_pickle_by_value())]
    for module in own:
        cloudpickle.register_pickle_by_value(module)
    try:
        return bytes(cloudpickle.dumps(call))
    finally:
        for module in own:
            cloudpickle.unregister_pickle_by_value(module)


def called(call: bytes) -> bytes:
    """Perform a call given as bytes, and return its result as bytes."""
    return bytes(cloudpickle.dumps(pickle.loads(call)()))


def _own_modules(call: Call) -> set[str]:
    """Return the names of the imported modules in or below the folders of a call's user code, except installed ones."""
    homes = {_home(each.__module__) for each in user_code(call)} - {None}
    if not homes:
        return set()
    return {
        name
        for name in tuple(sys.modules)
        if name != "__main__"  # cloudpickle always serializes its content by value
        and (home := _home(name)) is not None
        and not homes.isdisjoint((home, *home.parents))
    }


@cache
def _home(name: str) -> Path | None:
    """Return the folder of a module; None if the module is installed or has no file."""
    file = getattr(sys.modules.get(name), "__file__", None)
    if file is None:
        return Path.cwd() if name == "__main__" else None  # a notebook
    path = Path(file).absolute()
    installed = {"site-packages", "dist-packages"} & set(path.parts) or path.is_relative_to(Path(os.__file__).parent)
    return None if installed or name.partition(".")[0] in OURS else path.parent

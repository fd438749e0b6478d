"""How work travels to other processes: as bytes, by value, with all that is not installed there.

So what is defined in a script, in a cell of a notebook or in a module beside a scenario file works everywhere, and
whatever an executor pickles with: it sees nothing but bytes and `called`.
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
    """Return a call as bytes, with the modules that its arguments come from if those are not installed."""
    own = [sys.modules[name] for name in _own_modules(call) - set(cloudpickle.list_registry_pickle_by_value())]
    for module in own:
        cloudpickle.register_pickle_by_value(module)
    try:
        return bytes(cloudpickle.dumps(call))
    finally:
        for module in own:
            cloudpickle.unregister_pickle_by_value(module)


def called(call: bytes) -> bytes:
    """Make a call and return what it returns, both as bytes."""
    return bytes(cloudpickle.dumps(pickle.loads(call)()))


def _own_modules(call: Call) -> set[str]:
    """Return the names of the modules that are not installed and lie where a call's own classes and functions do."""
    homes = {_home(each.__module__) for each in user_code(call)} - {None}
    if not homes:
        return set()
    return {
        name
        for name in tuple(sys.modules)
        if name != "__main__"  # what is defined there travels by value anyway
        and (home := _home(name)) is not None
        and not homes.isdisjoint((home, *home.parents))
    }


@cache
def _home(name: str) -> Path | None:
    """Return the folder in which a module lies; None if it is installed."""
    file = getattr(sys.modules.get(name), "__file__", None)
    if file is None:
        return Path.cwd() if name == "__main__" else None  # a notebook
    path = Path(file).absolute()
    installed = {"site-packages", "dist-packages"} & set(path.parts) or path.is_relative_to(Path(os.__file__).parent)
    return None if installed or name.partition(".")[0] in OURS else path.parent

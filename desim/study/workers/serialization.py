"""Serialization of calls for other processes, as bytes that include the user code of the call.

Functions and classes that are defined in a script, a notebook or a module beside a scenario file therefore work in any
worker. They also work with any executor, because the executor pickles only bytes and the function `called`.
"""

import io
import marshal
import pickle
import sys
from collections import ChainMap
from collections.abc import Mapping
from functools import cache, cached_property, lru_cache, partial, singledispatch
from importlib import import_module
from pathlib import Path
from struct import Struct
from threading import RLock
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any, ClassVar

import cloudpickle

from desim.config.code_variables import CACHED, DISPATCHING
from desim.config.copier import passes_on_attributes, with_state_setter
from desim.config.own_modules import is_installed
from desim.config.traits import OURS

Call = partial[Any]
"""A function and its arguments."""
_REGISTERING = RLock()
"""Held while user modules are registered, so that no other thread finds them registered, or registers them, too."""


class CallPickler(cloudpickle.Pickler):  # type: ignore[misc]
    """A pickler whose code objects keep the names of their files, so that tracebacks are the same in any process.

    The code objects of cloudpickle 3.1.3 have no file. This class can also pickle wrappers that forward attributes,
    modules of classes of their own, such as that of mpmath, and what functools and struct make of user code. Functions
    that share a variable of an enclosing function share it in the other process, too, where cloudpickle separates them.
    """

    dispatch_table: ClassVar = ChainMap(
        {
            CodeType: lambda code: (marshal.loads, (marshal.dumps(code),)),
            Struct: lambda struct: (Struct, (struct.format,)),
            cached_property: lambda item: (cached_property, (item.func,), {"attrname": item.attrname}),  # has a lock
        },
        cloudpickle.Pickler.dispatch_table,
    )

    def __init__(self, file: Any):
        super().__init__(file)
        self._empty: dict[int, tuple[CellType, CellType]] = {}

    def _function_getnewargs(self, func: Any) -> tuple[Any, ...]:
        """Return how to create a function, with an empty cell for each variable, which the state fills."""
        *parts, closure = super()._function_getnewargs(func)
        if closure is not None:
            closure = tuple(self._empty.setdefault(id(cell), (cell, CellType()))[1] for cell in func.__closure__)
        return *parts, closure

    def reducer_override(self, value: Any) -> Any:
        """Return how to make an object again in another process; NotImplemented for the usual way."""
        if isinstance(value, ModuleType) and sys.modules.get(value.__name__) is value and type(value) is not ModuleType:
            return import_module, (value.__name__,)
        kind = type(value)
        if kind is CACHED and _is_by_value(value):
            return _cached, (value.__wrapped__, value.cache_parameters())
        if kind is FunctionType and value.__code__ is DISPATCHING and _is_by_value(value):
            return _dispatching, (value.__wrapped__, dict(value.registry))
        reduced = super().reducer_override(value)
        if reduced is NotImplemented and passes_on_attributes(type(value)):
            return with_state_setter(value.__reduce_ex__(5))
        return reduced


def _cached(function: Any, parameters: Mapping[str, Any]) -> Any:
    """Return a function with an empty cache."""
    return lru_cache(**parameters)(function)


def _dispatching(function: Any, registry: Mapping[type, Any]) -> Any:
    """Return a function that calls another one by the type of its first argument."""
    made = singledispatch(function)
    for kind, implementation in registry.items():
        made.register(kind, implementation)
    return made


def _is_by_value(function: Any) -> bool:
    """Return whether another process may not be able to import a function, so that it needs its code."""
    module: str = function.__module__
    return module == "__main__" or "<" in function.__qualname__ or module in cloudpickle.list_registry_pickle_by_value()


def packed(call: Call) -> bytes:
    """Return a call as bytes, which include the functions and classes of user modules that the call refers to."""
    buffer = io.BytesIO()
    with _REGISTERING:  # cloudpickle registers modules for the whole process
        modules = [sys.modules[name] for name in _user_modules() - set(cloudpickle.list_registry_pickle_by_value())]
        for module in modules:
            cloudpickle.register_pickle_by_value(module)
        try:
            CallPickler(buffer).dump(call)
        finally:
            for module in modules:
                cloudpickle.unregister_pickle_by_value(module)
    return buffer.getvalue()


def called(call: bytes) -> bytes:
    """Perform a call given as bytes, and return its result as bytes."""
    return bytes(cloudpickle.dumps(pickle.loads(call)()))


def _user_modules() -> set[str]:
    """Return the names of the imported user modules; not `__main__`, which cloudpickle includes by itself."""
    return {name for name in tuple(sys.modules) if name != "__main__" and _is_user_module(name)}


@cache
def _is_user_module(name: str) -> bool:
    """Return whether a module is a Python source file that is neither installed nor part of `desim` or `protocols`."""
    file = getattr(sys.modules[name], "__file__", None) or ""
    is_ours = name.partition(".")[0] in OURS
    return file.endswith(".py") and not is_ours and not is_installed(Path(file).absolute())

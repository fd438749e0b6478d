"""State that a model shares with other runs: what its code changes in classes, in functions and in global variables."""

import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dis import get_instructions
from functools import lru_cache, partial
from itertools import pairwise
from types import CellType, CodeType, FunctionType
from typing import Any
from warnings import warn
from weakref import WeakKeyDictionary

import numpy as np

COLLECTIONS = (list, set, dict, deque, np.ndarray)
ADDING = {"append", "extend", "add", "update"}
"""The methods that add to a collection and return nothing."""
Read = Callable[[], Any]
"""Reads a variable; None if it has no value."""


class StateWarning(UserWarning):
    """Warns of state in a class, a function or a module, where the next run finds it as this run has left it."""


@contextmanager
def changes(objects: Iterable[Any], snapshot: Callable[[Any], Any]) -> Iterator[None]:
    """Warn at the end of the block of each variable that classes and functions share between runs and that has changed.

    Args:
        objects: the classes and functions, perhaps among other objects.
        snapshot: returns what differs if a value has changed; None if that cannot be found out.
    """
    reads = dict(_shared(objects))
    before = {name: snapshot(read()) for name, read in reads.items()}
    yield
    changed = [name for name, read in reads.items() if before[name] is not None and before[name] != snapshot(read())]
    if changed:
        text = (
            f"{', '.join(sorted(changed))}: changed during the run, so a second run would start from another state;"
            " what a model remembers should be in its instance (self), of which each run gets a copy"
        )
        warn(text, StateWarning, stacklevel=6)


_found: WeakKeyDictionary[FunctionType, dict[str, Any]] = WeakKeyDictionary()
"""The collections that the first run of each function found, by name."""


def warn_of_collections(objects: Iterable[Any]) -> None:
    """Warn of each collection that a function among some objects reads, and whose items an earlier run has changed."""
    for function in objects:
        if isinstance(function, FunctionType):
            now = {name: _items_of(value, 4) for name, value in _collections(function)}
            first = _found.setdefault(function, now)
            if changed := [name for name, items in now.items() if name in first and items != first[name]]:
                warn(
                    f"{', '.join(changed)} of {function.__qualname__}: has changed since the first run with this"
                    " function, so this run starts from another state; what a model remembers should be in its"
                    " instance (self), of which each run gets a copy",
                    StateWarning,
                    stacklevel=5,
                )


def _collections(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield the name and the value of each collection that a function holds and does more with than to add to it."""
    code = function.__code__
    arguments = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    defaults = function.__defaults__ or ()
    held = dict(zip(arguments[code.co_argcount - len(defaults) :], defaults, strict=False))
    held |= function.__kwdefaults__ or {}
    held |= {name: _contents(cell) for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True)}
    for name, value in held.items():
        if isinstance(value, COLLECTIONS) and not only_adds(code, name):
            yield name, value


def defaults_of(function: FunctionType) -> list[Any]:
    """Return the defaults of the arguments of a function."""
    return [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]


def _items_of(value: Any, depth: int) -> Any:
    """Return what is equal for equal numbers and texts in a collection, and for the same other objects."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if depth and isinstance(value, dict):
        return [(_items_of(key, depth - 1), _items_of(item, depth - 1)) for key, item in value.items()]
    if depth and isinstance(value, COLLECTIONS):
        return [_items_of(item, depth - 1) for item in value]
    return value if isinstance(value, int | float | str) else id(value)


def _shared(objects: Iterable[Any]) -> Iterator[tuple[str, Read]]:
    """Yield the name of each variable that code of a user may change, with a function that reads it."""
    functions = []
    for item in objects:
        function = getattr(item, "__func__", item)
        if isinstance(function, FunctionType):
            functions.append(function)
            yield from _items(function.__qualname__, vars(function))
        for base in item.__mro__ if isinstance(item, type) else type(item).__mro__:
            if base.__module__.partition(".")[0] in _FOREIGN:
                continue
            for method in tuple(vars(base).values()):  # pydantic may still complete the class
                method = getattr(method, "__func__", method)
                if isinstance(method, FunctionType):
                    functions.append(method)
                    for name, cell in zip(method.__code__.co_freevars, method.__closure__ or (), strict=True):
                        if not only_adds(method.__code__, name):
                            yield f"{name} of {method.__qualname__}", partial(_contents, cell)
            yield from _items(base.__qualname__, vars(base))
    for function in functions:
        for name in written_globals(function.__code__):
            yield f"{function.__module__}.{name}", partial(function.__globals__.get, name)


def _items(owner: str, place: Any) -> Iterator[tuple[str, Read]]:
    """Yield the attributes in the namespace of a class or function, without methods and other descriptors."""
    for name, value in tuple(place.items()):
        if not (name.startswith("__") or name == "_abc_impl" or hasattr(type(value), "__get__")):
            yield f"{owner}.{name}", partial(place.get, name)


def _contents(cell: CellType) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # the variable has no value yet
        return None


_FOREIGN = {*sys.stdlib_module_names, "desim", "protocols", "numpy", "pydantic", "networkx"}
"""The packages whose classes are not looked at."""


@lru_cache(maxsize=256)
def only_adds(code: CodeType, name: str) -> bool:
    """Return whether a function and the functions inside it use a variable only to add to it, or to set items of it.

    In all versions of Python, the method is loaded by the instruction after the one that loads the variable.
    """
    for instruction, after in pairwise(get_instructions(code)):
        names = instruction.argval if isinstance(instruction.argval, tuple) else (instruction.argval,)
        is_loaded = name in names and "LOAD_" in instruction.opname and "CLOSURE" not in instruction.opname
        if is_loaded and after.argval not in ADDING:
            return False
    inner = [item for item in code.co_consts if isinstance(item, CodeType) and name in item.co_freevars]
    return all(only_adds(item, name) for item in inner)


@lru_cache(maxsize=256)
def written_globals(code: CodeType) -> frozenset[str]:
    """Return the names of the global variables that a function and the functions inside it assign or delete."""
    names = {item.argval for item in get_instructions(code) if item.opname in {"STORE_GLOBAL", "DELETE_GLOBAL"}}
    return frozenset(names).union(*(written_globals(item) for item in code.co_consts if isinstance(item, CodeType)))

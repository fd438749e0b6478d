"""State that a model shares with other runs: what its code changes in classes, functions, collections and globals."""

import random
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dis import get_instructions
from functools import lru_cache, partial
from itertools import pairwise
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any
from warnings import warn
from weakref import WeakKeyDictionary

import numpy as np

COLLECTIONS = (list, set, dict, deque, np.ndarray)
ADDING = {"append", "extend", "add", "update"}
"""The methods that add to a collection and return nothing."""
Read = Callable[[], Any]
"""Reads a variable; None if it has no value."""
_FOREIGN = {*sys.stdlib_module_names, "desim", "protocols", "numpy", "pydantic", "networkx"}
"""The packages whose classes and functions are not looked at."""


class StateWarning(UserWarning):
    """Warns of state in a class, a function, a module or a collection that an earlier run has left."""


_runs: WeakKeyDictionary[Any, dict[str, tuple[Any, Any]]] = WeakKeyDictionary()
"""By function or class, what its variables were before and after the last run that used it, by name."""


@contextmanager
def shared_changes(objects: Iterable[Any], snapshot: Callable[[Any], Any]) -> Iterator[None]:
    """Warn of each variable that an earlier block has changed, and that this block finds as it was left there.

    These are the attributes of classes and functions, and the defaults, the variables of enclosing functions and the
    global variables that code of a user reads or writes. A collection to which the code only adds may change: it
    reports to the caller. A first run is never warned of, nor one before which the caller has reset the variable. But
    even a first run is warned of if the global generators of `random` and `numpy.random` have advanced.

    Args:
        objects: the classes and functions, perhaps among other objects.
        snapshot: returns what differs if a value has changed; None if that cannot be found out.
    """
    objects = _reached(objects)
    reads = list(_shared(objects))
    before = [snapshot(read()) for _, _, read in reads]
    carried = set()
    for (owner, name, _), now in zip(reads, before, strict=True):
        first, last = _runs.get(owner, {}).get(name, (None, None))
        if None not in (first, last) and first != last == now:
            carried.add(name)
    if carried:
        text = (
            f"{', '.join(sorted(carried))}: an earlier run has changed it, so this run starts from another state;"
            " what a model remembers should be in its instance (self), of which each run gets a copy; what it reports"
            " may be appended to a list that it does not read"
        )
        warn(text, StateWarning, stacklevel=6)
    generators = _global_generators()
    yield
    if drawn_from := [name for name, state in _global_generators().items() if state != generators[name]]:
        text = (
            f"{' and '.join(drawn_from)}: the run has drawn from the global generator, so another run gives other"
            " results; a protocol should draw from `me.rng`, any other model from the `rng` that it is called with"
        )
        warn(text, StateWarning, stacklevel=6)
    for (owner, name, read), first in zip(reads, before, strict=True):
        _runs.setdefault(owner, {})[name] = first, snapshot(read())
    for owner, name, read in _shared(objects):
        if name not in _runs.get(owner, {}):  # the run has created it
            _runs.setdefault(owner, {})[name] = (), snapshot(read())


def _global_generators() -> dict[str, Any]:
    """Return the states of the random generators that all code of a process shares, by the names of their modules."""
    state = np.random.get_state(legacy=False)  # noqa: NPY002
    return {"random": random.getstate(), "numpy.random": (bytes(state["state"]["key"]), state["state"]["pos"])}


def _shared(objects: Iterable[Any]) -> Iterator[tuple[Any, str, Read]]:
    """Yield function or class, name and a function that reads it of each variable that code of a user may change."""
    for item in objects:
        function = getattr(item, "__func__", item)
        if isinstance(function, FunctionType) and not _is_of_package(function):
            yield from ((function, *variable) for variable in _items(function.__qualname__, vars(function)))
            yield from ((function, *variable) for variable in _variables(function))
        for base in item.__mro__ if isinstance(item, type) else type(item).__mro__:
            if _is_foreign(base):
                continue
            for method in tuple(vars(base).values()):  # pydantic may still complete the class
                method = getattr(method, "__func__", method)
                if isinstance(method, FunctionType):
                    yield from ((base, *variable) for variable in _variables(method))
            yield from ((base, *variable) for variable in _items(base.__qualname__, vars(base)))


def _is_foreign(definition: Any) -> bool:
    return (definition.__module__ or "").partition(".")[0] in _FOREIGN


def _items(owner: str, place: Any) -> Iterator[tuple[str, Read]]:
    """Yield the attributes in the namespace of a class or function, without methods and other descriptors."""
    for name, value in tuple(place.items()):
        if not (name.startswith("__") or name == "_abc_impl" or hasattr(type(value), "__get__")):
            yield f"{owner}.{name}", partial(place.get, name)


def _variables(function: FunctionType) -> Iterator[tuple[str, Read]]:
    """Yield the variables outside of a function that it may change, without collections to which it only adds."""
    if _is_foreign(function):
        return
    code, places = function.__code__, function.__globals__
    arguments = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    defaults = function.__defaults__ or ()
    held: dict[str, Read] = {}
    for name, value in zip(arguments[code.co_argcount - len(defaults) :], defaults, strict=False):
        held[name] = partial(_itself, value)
    for name, value in (function.__kwdefaults__ or {}).items():
        held[name] = partial(_itself, value)
    for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        held[name] = partial(_contents, cell)
    for name, read in held.items():
        if not only_adds(code, name):
            yield f"{name} of {function.__qualname__}", read
    for name in _globals_of(code):
        if name in places and not only_adds(code, name):
            yield f"{function.__module__}.{name}", partial(places.get, name)


def _reached(objects: Iterable[Any]) -> list[Any]:
    """Return objects, and the functions and classes of users that their code calls or reads by name."""
    reached, seen = list(objects), set[int]()
    for item in reached:
        functions = [getattr(item, "__func__", item)]
        for base in item.__mro__ if isinstance(item, type) else type(item).__mro__:
            if not _is_foreign(base):  # pydantic may still complete the class
                functions += [getattr(value, "__func__", value) for value in tuple(vars(base).values())]
        for function in functions:
            if not isinstance(function, FunctionType) or _is_foreign(function) or id(function) in seen:
                continue
            seen.add(id(function))
            names = _globals_of(function.__code__)
            values = [function.__globals__[name] for name in names if name in function.__globals__]
            for module in [value for value in values if isinstance(value, ModuleType) and not _is_installed(value)]:
                values += [vars(module)[name] for name in _attributes_of(function.__code__) if name in vars(module)]
            for value in values:
                value = getattr(value, "__wrapped__", value)
                if isinstance(value, FunctionType | type) and not _is_of_package(value) and id(value) not in seen:
                    seen.update([id(value)] if isinstance(value, type) else [])
                    reached.append(value)
    return reached


def _is_installed(module: ModuleType) -> bool:
    """Return whether a module is not of a user: of desim, of Python, or of an installed package."""
    file = getattr(module, "__file__", None) or ""
    return module.__name__.partition(".")[0] in _FOREIGN or "site-packages" in file


def _is_of_package(definition: Any) -> bool:
    """Return whether a function or class is defined in such a module; what it remembers is a matter of its authors."""
    module = sys.modules.get(definition.__module__ or "")
    return _is_foreign(definition) or (module is not None and _is_installed(module))


@lru_cache(maxsize=256)
def _attributes_of(code: CodeType) -> frozenset[str]:
    """Return the names of the attributes that a function and the functions inside it use."""
    return frozenset(code.co_names).union(*map(_attributes_of, _inner(code)))


def defaults_of(function: FunctionType) -> list[Any]:
    """Return the defaults of the arguments of a function."""
    return [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]


def _itself(value: Any) -> Any:
    return value


def _contents(cell: CellType) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # the variable has no value yet
        return None


@lru_cache(maxsize=256)
def only_adds(code: CodeType, name: str) -> bool:
    """Return whether a function and the functions inside it use a variable only to call methods that add to it.

    In all versions of Python, the method is loaded by the instruction after the one that loads the variable.
    """
    for instruction, after in pairwise(get_instructions(code)):
        names = instruction.argval if isinstance(instruction.argval, tuple) else (instruction.argval,)
        is_used = name in names and instruction.opname.startswith(("LOAD_", "STORE_", "DELETE_"))
        if is_used and "CLOSURE" not in instruction.opname and after.argval not in ADDING:
            return False
    return all(only_adds(inner, name) for inner in _inner(code) if name in (*inner.co_freevars, *inner.co_names))


@lru_cache(maxsize=256)
def _globals_of(code: CodeType) -> frozenset[str]:
    """Return the names of the global variables that a function and the functions inside it use."""
    names = {item.argval for item in get_instructions(code) if item.opname.endswith("_GLOBAL")}
    return frozenset(names).union(*map(_globals_of, _inner(code)))


def _inner(code: CodeType) -> list[CodeType]:
    """Return the code of the functions inside a function."""
    return [item for item in code.co_consts if isinstance(item, CodeType)]

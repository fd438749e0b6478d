"""State that a model shares with other runs: what its code changes in classes, functions, collections and globals."""

import random
import re
import sys
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dis import get_instructions
from functools import cached_property, lru_cache, partial, partialmethod, singledispatchmethod
from gc import get_referents
from itertools import pairwise
from types import CellType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any
from warnings import warn
from weakref import WeakKeyDictionary

import numpy as np

from desim.config.outside import Outside, inner_code, outside_sources
from desim.config.own_modules import plain_name
from desim.config.traits import module_of

COLLECTIONS = (list, set, dict, deque, np.ndarray)
ADDING = {"append", "extend", "add", "update", "put", "put_nowait"}
"""The methods that add to a collection and return nothing."""
Read = Callable[[], Any]
"""Reads a variable; None if it has no value."""
BY_TEXT = {"globals", "vars", "getattr", "setattr", "delattr", "__dict__", "__globals__", "modules", "import_module"}
"""What finds a variable of a module by a text."""
CACHED = type(lru_cache(int))
"""The type of functions with a cache."""
CODE = (
    *(FunctionType, MethodType, staticmethod, classmethod, property),
    *(cached_property, partialmethod, singledispatchmethod, CACHED),
)
"""The objects of Python that are functions or have some inside."""
INNER = ("__func__", "__self__", "__wrapped__", "fget", "fset", "fdel", "func", "dispatcher")
"""The attributes in which they have functions and objects."""
TABLE = 100
"""Number of items up to which a table is searched for functions."""
DEPTH = 8
"""Number of wrappers inside each other through which functions are looked for; a table counts as half of them."""
_FOREIGN = {*sys.stdlib_module_names, "desim", "protocols", "numpy", "pydantic", "networkx"}
"""The packages whose classes and functions are not looked at."""


class StateWarning(UserWarning):
    """Warns of state in a class, a function, a module or a collection that an earlier run has left.

    The clock of the computer is such state, too, and so are random numbers without a seed, and variables of the
    process.
    """


_collected: ContextVar[list[str] | None] = ContextVar("collected", default=None)
"""The texts of the warnings in the block of `collected_warnings`."""


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """Yield a list to which the texts of `StateWarning`s are added: nobody reads what is warned of in a worker."""
    texts: list[str] = []
    token = _collected.set(texts)
    try:
        yield texts
    finally:
        _collected.reset(token)


def _warn(text: str) -> None:
    texts = _collected.get()
    if texts is None:
        warn(text, StateWarning, stacklevel=7)
    else:
        texts.append(text)


_runs: WeakKeyDictionary[Any, dict[str, tuple[Any, Any]]] = WeakKeyDictionary()
"""By function or class, what its variables were before and after the last run that used it, by name."""


@contextmanager
def shared_changes(objects: Iterable[Any], snapshot: Callable[[Any], Any]) -> Iterator[None]:
    """Warn of each variable that an earlier block has changed, and that this block finds as it was left there.

    These are the attributes of classes and functions, and the defaults, the variables of enclosing functions and the
    global variables that code of a user reads or writes. A collection to which the code only adds may change: it
    reports to the caller. A first run is never warned of, nor one before which the caller has reset the variable. But
    even a first run is warned of if the global generators of `random` and `numpy.random` have advanced; beside other
    threads, only if its code names functions of theirs.

    Args:
        objects: the classes and functions, perhaps among other objects.
        snapshot: returns what differs if a value has changed; None if that cannot be found out.
    """
    objects = reached_code(objects)
    outside = Outside.of_all(map(_outside, objects))
    for text in _warnings_of(outside):
        _warn(text)
    reads = list(shared_variables(objects))
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
        _warn(text)
    caches = [item for item in objects if isinstance(item, CACHED)]
    cached = [_cached(item, snapshot) for item in caches]
    generators, imported = _global_generators(), set(sys.modules)
    yield
    for item, values in zip(caches, cached, strict=True):
        now_cached = _cached(item, snapshot) if values else {}
        if any(now_cached.get(number, state) != state for number, state in values.items()):
            text = (
                f"{plain_name(module_of(item))}.{item.__qualname__}: the run has changed what its cache has from an"
                " earlier one, so another run starts from another state; what a model remembers should be in its"
                " instance (self)"
            )
            _warn(text)
    is_alone = threading.active_count() == 1  # else another thread may have drawn, one of a cluster for instance
    drawn = [name for name, state in _global_generators().items() if state != generators[name]]
    if drawn_from := [name for name in drawn if is_alone or name in outside.generators]:
        text = (
            f"{' and '.join(drawn_from)}: the run has drawn from the global generator, so another run gives other"
            " results; a protocol should draw from `me.rng`, any other model from the `rng` that it is called with"
        )
        _warn(text)
    for (owner, name, read), first in zip(reads, before, strict=True):
        _runs.setdefault(owner, {})[name] = first, snapshot(read())
    new_modules = {plain_name(module) for module in sys.modules.keys() - imported}
    for owner, name, read in shared_variables(objects):
        if name.rpartition(".")[0] not in new_modules and name not in _runs.get(owner, {}):  # the run has created it
            _runs.setdefault(owner, {})[name] = (), snapshot(read())


@contextmanager
def followed_changes(objects: Iterable[Any], snapshot: Callable[[Any], Any]) -> Iterator[None]:
    """Follow what a block that is no run changes of what the last run has left: its caller has not reset that.

    Metrics, for instance, call models of links. For the arguments see `shared_changes`.
    """
    if not _runs:
        yield
        return
    reads = [item for item in shared_variables(reached_code(objects)) if item[1] in _runs.get(item[0], {})]
    before = [snapshot(read()) for _, _, read in reads]
    yield
    for (owner, name, read), state in zip(reads, before, strict=True):
        first, last = _runs[owner][name]
        if last == state is not None:
            _runs[owner][name] = first, snapshot(read())


def _cached(function: Any, snapshot: Callable[[Any], Any]) -> dict[int, Any]:
    """Return what differs if a value in the cache of a function has changed, by the number of the object.

    All are left out if there are many.
    """
    if not 0 < function.cache_info().currsize <= TABLE:
        return {}
    held = [item for item in get_referents(function) if item is not vars(function) and not callable(item)]
    if function.cache_parameters()["maxsize"] is None:  # then the dict of the cache has the values
        held = [value for item in held if type(item) is dict for value in item.values()]
    else:  # the dict of the cache has the links of a list, whose items the function lists, too
        held = [item for item in held if not (type(item) is dict and item and all(map(_is_link, item.values())))]
    return {id(item): snapshot(item) for item in held}


def _is_link(value: Any) -> bool:
    return type(value).__name__ == "_lru_list_elem"


def _global_generators() -> dict[str, Any]:
    """Return the states of the random generators that all code of a process shares, by the names of their modules."""
    state = np.random.get_state(legacy=False)  # noqa: NPY002
    return {"random": random.getstate(), "numpy.random": (bytes(state["state"]["key"]), state["state"]["pos"])}


def shared_variables(objects: Iterable[Any]) -> Iterator[tuple[Any, str, Read]]:
    """Yield function or class, name and a function that reads it of each variable that code of a user may change."""
    for item in objects:
        if isinstance(item, FunctionType | CACHED):
            yield from ((item, *variable) for variable in _items(item.__qualname__, vars(item)))
        if isinstance(item, FunctionType):
            yield from ((item, *variable) for variable in _variables(item))
        elif isinstance(item, type):
            for function in _functions_in(vars(item).values()):
                yield from ((item, *variable) for variable in _variables(function))
            yield from ((item, *variable) for variable in _items(item.__qualname__, vars(item)))


def is_foreign(definition: Any) -> bool:
    """Return whether a function or class is one of desim, of Python or of a package that desim needs.

    A function that `functools` makes of a user's has the module of the latter, and the variables of `functools`.
    """
    places = definition.__globals__ if isinstance(definition, FunctionType) else {}
    return (places.get("__name__") or module_of(definition)).partition(".")[0] in _FOREIGN


def _items(owner: str, place: Any) -> Iterator[tuple[str, Read]]:
    """Yield the attributes in the namespace of a class or function, without methods and descriptors of Python."""
    for name, value in tuple(place.items()):  # pydantic may still complete the class
        is_method = hasattr(type(value), "__get__") and is_foreign(type(value))
        if not (name.startswith("__") or name == "_abc_impl" or is_method):
            yield f"{owner}.{name}", partial(place.get, name)


def _variables(function: FunctionType) -> Iterator[tuple[str, Read]]:
    """Yield the variables outside of a function that it may change, without collections to which it only adds."""
    if is_foreign(function):
        return
    code = function.__code__
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
    for module, place, names in _modules_of(function):
        for name in names:
            if name in place and not (name in _names_of(code) and only_adds(code, name)):
                yield f"{plain_name(module)}.{name}", partial(place.get, name)


def _modules_of(function: FunctionType) -> Iterator[tuple[str, dict[str, Any], Collection[str]]]:
    """Yield the name and the namespace of each module of users that a function refers to, and the names that it uses.

    A function that finds variables by texts, as in `globals()["calls"]`, uses the names that are among its constants.
    """
    code, place = function.__code__, function.__globals__
    globals_, names, texts = _globals_of(code), _names_of(code), _texts_of(code)
    by_text = texts | names if names & BY_TEXT else frozenset()
    if names & {"exec", "eval"}:
        by_text |= {word for text in texts for word in re.findall(r"\w+", text)}
    yield module_of(function), place, globals_ | (by_text & place.keys())
    held = [place.get(name) for name in globals_] + [_contents(cell) for cell in function.__closure__ or ()]
    held += [sys.modules.get(name) for name in _imports_of(code) | by_text]
    modules = {id(value): value for value in held if isinstance(value, ModuleType) and not _is_installed(value)}
    for module in modules.values():
        yield module.__name__, vars(module), (names | by_text) & vars(module).keys()


def reached_code(objects: Iterable[Any]) -> list[Any]:
    """Return the functions and classes of users among some objects, and those that their code calls or reads by name.

    Each is there once.
    """
    reached: dict[int, Any] = {}
    held = list(objects)
    for value in held:
        for definition in _definitions_of(value):
            if id(definition) in reached or _is_of_package(definition):
                continue
            reached[id(definition)] = definition
            if isinstance(definition, CACHED):
                continue
            if isinstance(definition, FunctionType):
                held += [_contents(cell) for cell in definition.__closure__ or ()]
                held += [*defaults_of(definition), *vars(definition).values()]
                for _, place, names in _modules_of(definition):
                    held += [place[name] for name in names if name in place]
            else:
                held += vars(definition).values()  # pydantic may still complete the class
    return [*reached.values()]


def _definitions_of(value: Any, depth: int = 0) -> Iterator[Any]:
    """Yield the functions, classes and caches that an object is, wraps, is an instance of, or has as items."""
    if depth > DEPTH:
        return
    if isinstance(value, type):
        metaclass: type = type(value)
        yield from (base for base in (*value.__mro__, *metaclass.__mro__) if not is_foreign(base))
    elif isinstance(value, CODE):
        if isinstance(value, FunctionType | CACHED):
            yield value
        for name in INNER:
            yield from _definitions_of(getattr(value, name, None), depth + 1)
    elif isinstance(value, dict) and "__builtins__" in value:
        return  # the variables of a module, of which code reads some by name
    elif isinstance(value, list | tuple | dict):
        for item in (value.values() if isinstance(value, dict) else value) if len(value) <= TABLE else ():
            yield from _definitions_of(item, depth + DEPTH // 2)
    elif isinstance(value, partial):
        yield from _definitions_of(value.func, depth + 1)
        yield from _definitions_of((*value.args, *value.keywords.values()), depth + 1)
    elif not is_foreign(type(value)):
        yield from _definitions_of(type(value))


def _functions_in(values: Iterable[Any]) -> Iterator[FunctionType]:
    """Yield the functions among the attributes of a class."""
    for value in tuple(values):  # pydantic may still complete the class
        if isinstance(value, CODE):
            yield from (item for item in _definitions_of(value) if isinstance(item, FunctionType))


def _outside(item: Any) -> Outside:
    """Return what a function, or the methods of a class, take from outside of a run."""
    functions = [getattr(item, "__func__", item)]
    for base in item.__mro__ if isinstance(item, type) else type(item).__mro__:
        functions += [] if is_foreign(base) else [getattr(value, "__func__", value) for value in [*vars(base).values()]]
    return Outside.of_all(
        outside_sources(code) for code in functions if isinstance(code, FunctionType) and not is_foreign(code)
    )


def _warnings_of(outside: Outside) -> Iterator[str]:
    """Yield the warnings of clocks, random numbers without the run's seed, and what differs from process to process."""
    if outside.clocks:
        yield (
            f"{' and '.join(sorted(outside.clocks))}: the clock of the computer is not the one of the simulation; a"
            " protocol reads the time with `me.now` and waits with `yield me.sleep(0.1)`, and a model has the times in"
            " its arguments"
        )
    if outside.entropy:
        yield (
            f"{' and '.join(sorted(outside.entropy))}: these random numbers do not follow from the seed, so another run"
            " gives other results; a protocol should draw from `me.rng`, any other model from the `rng` that it is"
            " called with"
        )
    if outside.process:
        yield (
            f"{' and '.join(sorted(outside.process))}: what a process has is no part of the scenario, and may differ in"
            " another one, so another run may give other results; give parameters as fields of a model, and hash texts"
            " with zlib.crc32"
        )


def _is_installed(module: ModuleType) -> bool:
    """Return whether a module is not of a user: of desim, of Python, or of an installed package."""
    file = getattr(module, "__file__", None) or ""
    is_library = not {"site-packages", "dist-packages"}.isdisjoint(re.split(r"[/\\]", file))
    return module.__name__.partition(".")[0] in _FOREIGN or is_library


def _is_of_package(definition: Any) -> bool:
    """Return whether a function or class is defined in such a module; what it remembers is a matter of its authors."""
    module = sys.modules.get(module_of(definition))
    return is_foreign(definition) or (module is not None and _is_installed(module))


@lru_cache(maxsize=256)
def _names_of(code: CodeType) -> frozenset[str]:
    """Return the names of the global variables and attributes that a function and the functions inside it use."""
    return frozenset(code.co_names).union(*map(_names_of, inner_code(code)))


@lru_cache(maxsize=256)
def _texts_of(code: CodeType) -> frozenset[str]:
    """Return the texts that are constants of a function and of the functions inside it."""
    return frozenset(item for item in code.co_consts if isinstance(item, str)).union(*map(_texts_of, inner_code(code)))


@lru_cache(maxsize=256)
def _imports_of(code: CodeType) -> frozenset[str]:
    """Return the names of the modules that a function and the functions inside it import."""
    names = {item.argval for item in get_instructions(code) if item.opname == "IMPORT_NAME"}
    return frozenset(names).union(*map(_imports_of, inner_code(code)))


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
    return all(only_adds(inner, name) for inner in inner_code(code) if name in (*inner.co_freevars, *inner.co_names))


@lru_cache(maxsize=256)
def _globals_of(code: CodeType) -> frozenset[str]:
    """Return the names of the global variables that a function and the functions inside it use."""
    names = {item.argval for item in get_instructions(code) if item.opname.endswith("_GLOBAL")}
    return frozenset(names).union(*map(_globals_of, inner_code(code)))

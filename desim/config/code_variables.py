"""The code of users that a run reaches, and the variables outside of functions that this code may change.

The code is not run: its instructions are read, and the names in them are looked up.
"""

import queue
import re
import sys
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from dis import get_instructions
from functools import cached_property, lru_cache, partial, partialmethod, singledispatch, singledispatchmethod
from itertools import chain, pairwise
from pathlib import Path
from types import CellType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from desim.config.outside import inner_code
from desim.config.own_modules import is_installed, plain_name
from desim.config.traits import module_of

COLLECTIONS = (list, set, dict, deque, np.ndarray)
ADDING = {"append", "extend", "add", "update", "put", "put_nowait"}
"""The methods that add to a collection and return nothing."""
TAKING = {"get_nowait", "qsize", "empty", "full"}
"""The methods of a queue, besides `get`, whose answers depend on what it holds."""
Read = Callable[[], Any]
"""Returns the value of a variable; None if it has no value."""
BY_TEXT = {"globals", "vars", "getattr", "setattr", "delattr", "__dict__", "__globals__", "modules", "import_module"}
"""The names in code that finds variables by texts, as in `globals()["calls"]`."""
CACHED = type(lru_cache(int))
"""The type of functions with a cache."""
DISPATCHING = getattr(singledispatch(len), "__code__")  # noqa: B009 - a type checker does not know that it is a function
"""The code of all functions that `singledispatch` makes; their caches are weak, and cannot be pickled."""
CODE = (
    *(FunctionType, MethodType, staticmethod, classmethod, property),
    *(cached_property, partialmethod, singledispatchmethod, CACHED),
)
"""The types of functions and of Python's wrappers around functions."""
INNER = ("__func__", "__self__", "__wrapped__", "fget", "fset", "fdel", "func", "dispatcher")
"""The attributes in which objects of these types hold functions and other objects."""
BOOKKEEPING = {"_abc_impl", "_value2member_map_"}
"""The attributes in which abstract classes and flags of Python keep what they have computed."""
MAX_SEARCHED = 100
"""Number of items up to which a list, a dict or a cache is searched."""
MAX_DEPTH = 8
"""Largest depth of nested wrappers in which functions are looked for; a list or a dict adds half of it."""
_FOREIGN = {*sys.stdlib_module_names, "desim", "protocols", "numpy", "pydantic", "networkx"}
"""The packages whose classes and functions are not searched."""


def shared_variables(objects: Iterable[Any]) -> Iterator[tuple[Any, str, Read]]:
    """Yield each variable that code of a user may change: its owner, its name, and what reads its value.

    The owner is the module of a global variable, which several functions may read, and else the function or class.
    """
    for item in objects:
        if isinstance(item, FunctionType | CACHED):
            yield from ((item, *variable) for variable in _attributes(item.__qualname__, vars(item)))
        if isinstance(item, FunctionType):
            yield from _variables(item, item)
        elif isinstance(item, type):
            for function in _functions_in(vars(item).values()):
                yield from _variables(function, item)
            yield from ((item, *variable) for variable in _attributes(item.__qualname__, vars(item)))


def shared_queues(objects: Iterable[Any], code: Iterable[Any]) -> Iterator[tuple[Any, str, Read]]:
    """Yield the queues among some objects as variables if code reads queues: its owner, its name, and what reads it.

    If all code only puts something into queues, it reports to the caller.
    """
    functions = chain.from_iterable(
        _functions_in(vars(item).values()) if isinstance(item, type) else [item] for item in code
    )
    if any(isinstance(function, FunctionType) and _takes_items(function.__code__) for function in functions):
        for item in objects:
            if isinstance(item, queue.Queue | queue.SimpleQueue):
                name = f"a {type(item).__name__} that a model holds (runs share it; a deque is copied)"
                yield item, name, partial(_itself, item)


@lru_cache(maxsize=1024)
def _takes_items(code: CodeType) -> bool:
    """Return whether code may read a queue; `get` of a dict has a first argument that is no boolean, and no keyword."""
    if not TAKING.isdisjoint(code.co_names):
        return True
    if "get" in code.co_names:
        if any(isinstance(item, tuple) and not {"block", "timeout"}.isdisjoint(item) for item in code.co_consts):
            return True
        instructions = [item for item in get_instructions(code) if item.opname not in {"PUSH_NULL", "PRECALL"}]
        for item, following in pairwise(instructions):
            is_call = following.opname == "CALL" and following.arg == 0
            if item.argval == "get" and (is_call or isinstance(following.argval, bool)):
                return True
    return any(map(_takes_items, inner_code(code)))


def is_foreign(definition: Any) -> bool:
    """Return whether a function or class is one of desim, of Python or of a package that desim needs.

    The module of a function's globals decides: wrappers by `functools` have the `__module__` of the user's function.
    """
    variables = definition.__globals__ if isinstance(definition, FunctionType) else {}
    return str(variables.get("__name__") or module_of(definition)).partition(".")[0] in _FOREIGN


def _attributes(owner: str, namespace: Any) -> Iterator[tuple[str, Read]]:
    """Yield the attributes in the namespace of a class or function, without methods and descriptors of Python."""
    for name, value in tuple(namespace.items()):  # a copy, because pydantic may still complete the class
        is_method = hasattr(type(value), "__get__") and is_foreign(type(value))
        if not (name.startswith("__") or name in BOOKKEEPING or is_method):
            yield f"{owner}.{name}", partial(namespace.get, name)


def _variables(function: FunctionType, owner: Any) -> Iterator[tuple[Any, str, Read]]:
    """Yield the variables outside of a function that it may change, without collections to which it only adds."""
    if is_foreign(function):
        return
    code = function.__code__
    arguments = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    defaults = function.__defaults__ or ()
    named_defaults = dict(zip(arguments[code.co_argcount - len(defaults) :], defaults, strict=False))
    named_defaults |= function.__kwdefaults__ or {}
    cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
    variables = {name: partial(_itself, value) for name, value in named_defaults.items()}
    variables |= {name: partial(_contents, cell) for name, cell in cells}
    for name, read in variables.items():
        if not only_adds(code, name):
            yield owner, f"{name} of {function.__qualname__}", read
    for module, namespace, names in _modules_of(function):
        imported = sys.modules.get(module)
        is_owner = isinstance(imported, ModuleType) and vars(imported) is namespace
        for name in names:
            if name in namespace and not (name in _words_of(code).names and only_adds(code, name)):
                yield imported if is_owner else owner, f"{plain_name(module)}.{name}", partial(namespace.get, name)


def _modules_of(function: FunctionType) -> Iterator[tuple[str, dict[str, Any], Collection[str]]]:
    """Yield the modules of users that a function is in or refers to: name, namespace, and the names that it uses there.

    A function that finds variables by texts, as in `globals()["calls"]`, uses the names that are among its constants.
    """
    code, namespace = function.__code__, function.__globals__
    names, texts, imports, globals_ = _words_of(code)
    by_text = texts | names if names & BY_TEXT else frozenset()
    if names & {"exec", "eval"}:
        by_text |= {word for text in texts for word in re.findall(r"\w+", text)}
    yield module_of(function), namespace, globals_ | (by_text & namespace.keys())
    values = [namespace.get(name) for name in globals_] + [_contents(cell) for cell in function.__closure__ or ()]
    values += [sys.modules.get(name) for name in imports | by_text]
    modules = {id(value): value for value in values if isinstance(value, ModuleType) and not _is_installed(value)}
    for module in modules.values():
        yield module.__name__, vars(module), (names | by_text) & vars(module).keys()


def reached_code(objects: Iterable[Any]) -> list[Any]:
    """Return the code of users that is among some objects or in their reach: functions, classes and caches, each once.

    The code of a function reaches what it calls or reads by name.
    """
    reached: dict[int, Any] = {}
    values = list(objects)
    for value in values:  # the list grows meanwhile
        for definition in _definitions_of(value):
            if id(definition) in reached or _is_of_package(definition):
                continue
            reached[id(definition)] = definition
            if isinstance(definition, CACHED):
                continue
            if isinstance(definition, FunctionType):
                values += [_contents(cell) for cell in definition.__closure__ or ()]
                values += [*defaults_of(definition), *vars(definition).values()]
                for _, namespace, names in _modules_of(definition):
                    values += [namespace[name] for name in names if name in namespace]
            else:
                values += vars(definition).values()
    return [*reached.values()]


def _definitions_of(value: Any, depth: int = 0) -> Iterator[Any]:
    """Yield the functions, classes and caches that an object is, wraps, is an instance of, or has as items."""
    if depth > MAX_DEPTH:
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
        return  # the variables of a module; `_modules_of` yields those that code reads
    elif isinstance(value, list | tuple | dict):
        for item in (value.values() if isinstance(value, dict) else value) if len(value) <= MAX_SEARCHED else ():
            yield from _definitions_of(item, depth + MAX_DEPTH // 2)
    elif isinstance(value, partial):
        yield from _definitions_of(value.func, depth + 1)
        yield from _definitions_of((*value.args, *value.keywords.values()), depth + 1)
    elif not is_foreign(type(value)):
        yield from _definitions_of(type(value))


def _functions_in(values: Iterable[Any]) -> Iterator[FunctionType]:
    """Yield the functions among the attributes of a class."""
    for value in tuple(values):  # a copy, because pydantic may still complete the class
        if isinstance(value, CODE):
            yield from (item for item in _definitions_of(value) if isinstance(item, FunctionType))


def _is_installed(module: ModuleType) -> bool:
    """Return whether a module is not of a user: of desim, of Python, or of an installed package.

    `__main__` is of a user, wherever its file lies: in a worker process it has the file of the worker's package, and
    the functions of the user's script.
    """
    if module.__name__ == "__main__":
        return False
    file = getattr(module, "__file__", None)
    return module.__name__.partition(".")[0] in _FOREIGN or (isinstance(file, str) and is_installed(Path(file)))


def _is_of_package(definition: Any) -> bool:
    """Return whether a function or class is of desim, of Python or of an installed package, not of a user."""
    module = sys.modules.get(module_of(definition))
    return is_foreign(definition) or (module is not None and _is_installed(module))


class CodeWords(NamedTuple):
    """The words in the instructions of a function and of the functions inside it."""

    names: frozenset[str]
    """The names of global variables and attributes."""
    texts: frozenset[str]
    """The texts that are constants."""
    imports: frozenset[str]
    """The names of imported modules."""
    globals: frozenset[str]
    """The names of global variables alone."""


@lru_cache(maxsize=256)
def _words_of(code: CodeType) -> CodeWords:
    """Return the words in a function and in the functions inside it."""
    instructions = [(item.opname, item.argval) for item in get_instructions(code)]
    outer = CodeWords(
        frozenset(code.co_names),
        frozenset(item for item in code.co_consts if isinstance(item, str)),
        frozenset(name for operation, name in instructions if operation == "IMPORT_NAME"),
        frozenset(name for operation, name in instructions if operation.endswith("_GLOBAL")),
    )
    return CodeWords(
        *(part.union(*inner) for part, *inner in zip(outer, *map(_words_of, inner_code(code)), strict=True))
    )


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
    for instruction, next_instruction in pairwise(get_instructions(code)):
        names = instruction.argval if isinstance(instruction.argval, tuple) else (instruction.argval,)
        is_used = name in names and instruction.opname.startswith(("LOAD_", "STORE_", "DELETE_"))
        if is_used and "CLOSURE" not in instruction.opname and next_instruction.argval not in ADDING:
            return False
    return all(only_adds(inner, name) for inner in inner_code(code) if name in (*inner.co_freevars, *inner.co_names))

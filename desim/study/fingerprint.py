"""Content hashes of objects: of all their parts, recursively, code included.

An object is decomposed as in pickling. An importable class or function is hashed by its name and the source of its
module. If it belongs to desim, to Python or to a library whose version is recorded, its name alone is hashed. One that
is defined in a script, at a prompt or within a function is hashed by its compiled code and all values that it reads.
"""

import copyreg
import hashlib
import inspect
import pickle
import sys
from collections.abc import Iterable, Iterator
from dis import get_instructions
from functools import cache, cached_property, partial
from types import CellType, CodeType, FunctionType, MappingProxyType, ModuleType, NoneType
from typing import Any

import numpy as np
from pydantic import BaseModel

from desim.config.choice import home_of
from desim.results.environment import NUMERICS

ATOMS = {NoneType, bool, int, float, complex, str, bytes}
"""Types whose `repr` determines the value."""
OURS = {"desim", "protocols", "builtins", "functools"}
"""The packages whose classes and functions are not user code."""
KNOWN = {*OURS, *NUMERICS, *sys.stdlib_module_names}
"""The packages whose classes and functions are hashed by name only."""
WRAPPERS = {staticmethod: "__func__", classmethod: "__func__", cached_property: "func"}
"""Types that wrap a method, and the attribute that holds the method."""


class UnstableHashError(ValueError):
    """Raised when an object has no stable content hash."""


class Fingerprint:
    """The content hashes of the objects of one scenario: `fingerprint(value)`.

    A list that holds one mutable object twice and a list of two equal objects have different hashes.

    Raises:
        UnstableHashError: if a part of an object cannot be decomposed, such as a lock, a file or a generator.
    """

    def __init__(self) -> None:
        self._seen: dict[int, tuple[int, Any]] = {}  # holds the object, so that its id is not reused
        self._module_source = cache(
            _module_source
        )  # one cache per Fingerprint: modules may change before the next is made

    def __call__(self, value: Any) -> str:
        """Return the hash of an object, 16 hexadecimal digits; O(n) in the number and size of its parts."""
        try:
            return self._digest(value).hex()[:16]
        except RecursionError as error:
            raise UnstableHashError(f"{type(value).__qualname__!r} objects are nested too deeply") from error

    def _digest(self, value: Any) -> bytes:
        kind = type(value)
        if kind in ATOMS:
            return _hash("atom", repr(value))
        if kind is tuple:
            return self._digest_all("tuple", value)
        if isinstance(value, ModuleType):
            return _hash("module", value.__name__)
        if isinstance(value, type | FunctionType) and _is_importable(value):
            return _hash("name", value.__module__, value.__qualname__, self._module_source(value.__module__))
        if id(value) in self._seen:
            return _hash("met", str(self._seen[id(value)][0]))
        self._seen[id(value)] = len(self._seen), value
        return self._digest_parts(value)

    def _digest_all(self, kind: str, values: Iterable[Any]) -> bytes:
        return _hash(kind, *map(self._digest, values))

    def _digest_parts(self, value: Any) -> bytes:
        """Return the hash of a compound object at its first occurrence."""
        kind = type(value)
        if kind in {dict, MappingProxyType}:
            return self._digest_all(kind.__name__, (each for item in value.items() for each in item))
        if kind is list:
            return self._digest_all("list", value)
        if kind in {set, frozenset}:
            return _hash(kind.__name__, *sorted(map(self._digest, value)))
        if kind is np.ndarray and not value.dtype.hasobject:
            return _hash("array", repr(value.dtype), repr(value.shape), value.tobytes())
        if kind in WRAPPERS:
            return self._digest_all(kind.__name__, [getattr(value, WRAPPERS[kind])])
        if kind is property:
            return self._digest_all("property", [value.fget, value.fset, value.fdel])
        if isinstance(value, FunctionType):
            return self._function(value)
        if isinstance(value, CodeType):
            return self._code(value)
        if isinstance(value, type):
            return self._class(value)
        if isinstance(value, BaseModel):
            own = value.__pydantic_extra__, value.__pydantic_private__
            return self._digest_all("model", [kind, _without_cached(kind, vars(value)), *own])
        return self._object(value)

    def _function(self, function: FunctionType) -> bytes:
        """Return the hash of a function that cannot be imported by name."""
        code = function.__code__
        cells = {
            name: held
            for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True)
            for held in _cell_value(cell)
        }
        space = function.__globals__ if function.__module__ == "__main__" else {}  # else the module's text is hashed
        reads = {name: space[name] for name in sorted(_globals_read(code)) if name in space}
        given = function.__defaults__, function.__kwdefaults__, vars(function)
        return self._digest_all(
            "function", [function.__qualname__, self._module_source(function.__module__), code, cells, reads, *given]
        )

    def _code(self, code: CodeType) -> bytes:
        return self._digest_all("code", [code.co_code, code.co_names, code.co_freevars, code.co_consts])

    def _class(self, home: type) -> bytes:
        """Return the hash of a class that cannot be imported by name, without attributes that are generated for it."""
        own = {
            name: each
            for name, each in vars(home).items()
            if isinstance(each, FunctionType | staticmethod | classmethod | property)
            or not (name.startswith("__") or name == "_abc_impl")
        }
        return self._digest_all("class", [home.__qualname__, self._module_source(home.__module__), home.__bases__, own])

    def _object(self, value: Any) -> bytes:
        """Return the hash of an object, decomposed by `__reduce_ex__` as in pickling."""
        kind = type(value)
        reduce = copyreg.dispatch_table.get(kind)
        try:
            made: Any = value.__reduce_ex__(4) if reduce is None else reduce(value)
        except Exception as error:  # code of the object may raise anything
            raise UnstableHashError(f"{kind.__qualname__!r} objects have no stable hash ({error})") from error
        if isinstance(made, str):
            return self._global(value, made)
        make, args, state, *rest = (*made, None)[:5]
        return self._digest_all(
            "object", [kind, make, args, _without_cached(kind, state), *(each and list(each) for each in rest)]
        )

    def _global(self, value: Any, name: str) -> bytes:
        """Return the hash of an object that pickling refers to by its name."""
        if (wrapped := getattr(value, "__wrapped__", None)) is not None:  # a function with a cache
            return self._digest_all("wrapped", [wrapped])
        module: str = pickle.whichmodule(value, name)  # type: ignore[attr-defined]
        if _lookup(module, name) is not value:
            raise UnstableHashError(
                f"{type(value).__qualname__!r} objects have no stable hash ({name!r} is in no module)"
            )
        return _hash("global", module, name, self._module_source(module))


def _hash(*parts: str | bytes) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        content = part.encode() if isinstance(part, str) else part
        digest.update(f"{len(content)}:".encode() + content)
    return digest.digest()


def _without_cached(kind: type, state: Any) -> Any:
    """Return the state of an object without its cached properties."""
    if not isinstance(state, dict):
        return state
    return {
        name: each
        for name, each in state.items()
        if not (isinstance(name, str) and isinstance(getattr(kind, name, None), cached_property))
    }


def _cell_value(cell: CellType) -> Iterator[Any]:
    """Yield the value of a variable of an enclosing function; nothing if it is not assigned yet."""
    try:
        yield cell.cell_contents
    except ValueError:
        return


def _globals_read(code: CodeType) -> set[str]:
    """Return the names of the globals that a function reads, functions inside it included."""
    own = {each.argval for each in get_instructions(code) if each.opname in {"LOAD_GLOBAL", "LOAD_NAME"}}
    return own.union(*(_globals_read(each) for each in code.co_consts if isinstance(each, CodeType)))


def _lookup(module: str, name: str) -> Any:
    """Return the object with a dotted name in a module; None if there is none."""
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    return found


def _is_importable(home: type | FunctionType) -> bool:
    return home.__module__ != "__main__" and _lookup(home.__module__, home.__qualname__) is home


def _module_source(module: str) -> str:
    """Return the source of a module; "" if its package is in `KNOWN`, it is a script, or it has no source."""
    if module == "__main__" or module.partition(".")[0] in KNOWN:
        return ""
    try:
        return inspect.getsource(sys.modules[module])
    except (KeyError, OSError, TypeError):
        return ""


def parts(value: Any, seen: set[int] | None = None) -> Iterator[Any]:
    """Yield each callable object inside a value once.

    Args:
        value: a model, a list, a tuple or a partial call, whose parts are visited; any other object has none.
        seen: the `id`s of objects to skip; the same set serves several values that share objects, such as runs.
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


def user_code(value: Any) -> Iterator[Any]:
    """Yield the user code inside a value: functions, and the classes of callable objects."""
    for each in parts(value):
        if is_user_code(each):
            yield home_of(each)


def is_user_code(value: Any) -> bool:
    """Return whether a function, or the class of an object, is user code: it belongs to no package in `OURS`."""
    return str(home_of(value).__module__).partition(".")[0] not in OURS

"""Fresh copies of models with state, so that each run starts from the state that the objects of its caller have.

A built-in model and a plain function never change, and a run uses them as they are. Any other object may remember
something between calls. A run therefore calls a copy, with copies of all that the object holds: its attributes, the
variables of enclosing functions, mutable defaults, random generators. What a module or a class holds is not copied.
"""

import pickle
import queue
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from hashlib import sha256
from io import BytesIO
from itertools import count, repeat
from types import (
    BuiltinFunctionType,
    CellType,
    CodeType,
    FunctionType,
    GeneratorType,
    MappingProxyType,
    MethodType,
    ModuleType,
    NoneType,
)
from typing import Any, Literal, TypeVar
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np
from pydantic import BaseModel

from desim.config.python_numbers import ATOMS
from desim.config.shared_state import (
    ADDING,
    CACHED,
    COLLECTIONS,
    defaults_of,
    followed_changes,
    is_foreign,
    shared_changes,
)
from desim.config.traits import OURS, module_of, name_of

Model = TypeVar("Model")
CONSTANTS = ATOMS | {complex, bytes}
"""The types of values that hold nothing else and never change."""
NEVER_CHANGED = OURS | {"networkx", "pathlib", "threading", "_thread", "queue", "_queue"}
"""The packages and modules whose objects a copy shares: they do not change while a model holds them, or connect
threads, such as locks."""
FUNCTION_STATE = ("__kwdefaults__", "__module__", "__qualname__", "__doc__")
"""The attributes of a function that a copy takes over, besides those that its users set."""


class StateError(ValueError):
    """Raised when an object cannot be copied, so that a second run would not start from the same state."""


@contextmanager
def fresh_copy(model: Model, *, alone: bool = False, is_run: bool = False) -> Iterator[Model]:
    """Yield a copy of a model in which the objects that may have state are copies; the model itself if it has none.

    An object to which the model refers twice is copied once. A collection in a variable of an enclosing function, such
    as a list to which the function appends what it sees, is shared with the caller, who reads it after the run.

    If the block is a run, a `StateWarning` names what is not copied and what an earlier run has changed: attributes of
    classes, collections and global variables.

    Args:
        model: the model.
        alone: whether nobody reads collections after the run, so that they are copied, too, if they can be.
        is_run: whether the block is a run.

    Raises:
        StateError: if an object cannot be copied, such as a generator or an open file; the text names its key.
    """
    if is_all_built_in(model):  # as a rule
        yield model
        return
    users = dict(users_objects(model))
    copied, kept, functions = model, [], []
    if not all(is_stateless(value, alone=alone) for value in users.values()):
        copier, content = _written(model, users, alone=alone)
        reader = CopyReader(content, copier.kept)
        copied, kept, functions = reader.load(), copier.kept, copier.functions
    watched = shared_changes if is_run else followed_changes
    with watched([*kept, *functions, *users.values()], _snapshot):
        yield copied


def _written(model: Any, users: Mapping[str, Any], *, alone: bool) -> "tuple[Copier, BytesIO]":
    """Return a copier that has written a model, and what it has written; see `fresh_copy`."""
    content = BytesIO()
    copier = Copier(content, alone=alone)
    try:
        copier.dump(model)
    except Exception as error:  # code of an object may raise anything
        if alone:  # perhaps what a function has reported to its caller: it is shared then
            return _written(model, users, alone=False)
        raise _refusal(users, error) from error
    return copier, content


def _refusal(users: Mapping[str, Any], error: Exception) -> StateError:
    """Return the error for a model that cannot be copied, with the key of the first object that cannot."""
    for key, value in users.items():
        try:
            Copier(BytesIO()).dump(value)
        except Exception as reason:
            return StateError(
                f"{key}: {name_of(value)} may remember something, so each run calls a copy of it, but it cannot be"
                f" copied ({reason}): create what changes in the first call during the run, or leave it out in the"
                " __getstate__ of its class"
            )
    return StateError(f"cannot be copied: {error}")


def never_changes(name: str) -> bool:
    """Return whether the objects of a module, given its name, are shared; a similar name is that of another module.

    A graph of networkx is not.
    """
    return name.partition(".")[0] in NEVER_CHANGED and not name.startswith("networkx.classes.")


@lru_cache(maxsize=256)
def _form(kind: type) -> Literal["constant", "model", "items", "values", "object"]:
    """Return how the values of a type are looked through."""
    if kind in {tuple, list}:
        return "items"
    if kind is dict:
        return "values"
    if not never_changes(module_of(kind)):
        return "constant" if kind in {*CONSTANTS, np.ndarray} else "object"
    if issubclass(kind, tuple):  # a named tuple, such as a metric with its unit
        return "items"
    return "model" if issubclass(kind, BaseModel) else "constant"


def _is_ours(value: Any) -> bool:
    """Return whether a value is a function of desim at the top level, which has no state."""
    return type(value) is FunctionType and value.__closure__ is None and never_changes(module_of(value))


def is_all_built_in(model: Any) -> bool:
    """Return whether a model and all that it holds are built-in models and constants, which have no state."""
    values = [model]
    for value in values:
        kind: type = type(value)
        form = _form(kind)
        if form == "object":
            if not _is_ours(value):
                return False
        elif form != "constant":
            values += value if form == "items" else (vars(value) if form == "model" else value).values()
    return True


def users_objects(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted key and the value of each object in a model that is neither a built-in model nor a constant."""
    kind: type = type(value)
    form = _form(kind)
    if form == "object":
        if not _is_ours(value):
            yield key, value
    elif form != "constant":
        inner = enumerate(value) if form == "items" else (vars(value) if form == "model" else value).items()
        for name, item in inner:
            yield from users_objects(item, f"{key}.{name}" if key else str(name))


def is_stateless(value: Any, *, alone: bool = False) -> bool:
    """Return whether a value is a constant, or a function, class or module without state; see `fresh_copy`."""
    kind = type(value)
    if kind is FunctionType:
        held = *defaults_of(value), *(value.__closure__ or ())
        return _is_ours(value) or all((not alone and is_collection(item)) or _is_constant(item) for item in held)
    if kind is BuiltinFunctionType:
        return isinstance(value.__self__, ModuleType | NoneType)
    return kind in CONSTANTS or isinstance(value, type | ModuleType | CodeType)


def _is_constant(value: Any) -> bool:
    """Return whether a default of a function cannot change."""
    if type(value) in {tuple, frozenset}:
        return all(map(_is_constant, value))
    return is_all_built_in(value) and not isinstance(value, COLLECTIONS) and type(value) is not FunctionType


def is_collection(held: Any) -> bool:
    """Return whether a default, or a variable of an enclosing function, is a collection that its caller may read.

    Or a method of one, such as `seen.append`.
    """
    try:
        value = held.cell_contents if type(held) is CellType else held
    except ValueError:  # the variable has no value yet
        return False
    return isinstance(value.__self__ if type(value) is BuiltinFunctionType else value, COLLECTIONS)


LARGE = 10_000
"""Number of items of a collection from which on its changes are not looked for, because this would take long."""


def _snapshot(value: Any) -> Any:
    """Return what differs if a value has changed; None if that cannot be found out.

    Objects that are shared by all runs count by their identity.
    """
    if isinstance(value, COLLECTIONS) and (value.size if isinstance(value, np.ndarray) else len(value)) >= LARGE:
        return None
    if type(value) is BuiltinFunctionType and value.__name__ in ADDING:  # its collection cannot be read by it
        return None
    if is_stateless(value) and not isinstance(value, np.ndarray):
        return [value]
    content = BytesIO()
    copier = Describer(content)
    try:
        copier.dump(value)
    except Exception:  # code of an object may raise anything
        return None
    return sha256(content.getvalue()).digest(), [id(item) for item in copier.kept]


class Remembered:
    """Tells whether an object that is used again has changed since it was used first; it is told once.

    It is for an object of the caller that is not copied, because the caller may read it, or want it to learn.
    """

    def __init__(self) -> None:
        self._states: list[Any] = []

    def has_changed(self, value: Any) -> bool:
        """Return whether the object has changed between the first and this, the second, call; later False."""
        if len(self._states) > 1:
            return False
        self._states.append(_snapshot(value))
        return len(self._states) == 2 and None not in self._states and self._states[0] != self._states[1]


class _Kept:
    """Stands for an object to which a copy refers."""

    def __init__(self, value: Any):
        self.value = value


class Copier(pickle.Pickler):
    """Pickles a model for this process, where the copy can refer to what is not copied.

    Attributes:
        kept: the objects to which the copy refers, by their number.
        functions: the functions in the model.
    """

    def __init__(self, content: BytesIO, *, alone: bool = False):
        super().__init__(content, 5)
        self._alone = alone
        self.kept: list[Any] = []
        self.functions: list[FunctionType] = []

    def persistent_id(self, value: Any) -> int | None:
        """Return the number of an object to which the copy refers; None for an object that is copied."""
        kind = type(value)
        if kind in CONSTANTS:
            return None
        if kind is FunctionType:
            self.functions.append(value)
        if kind is _Kept:
            value = value.value
        elif kind is np.ndarray:
            if value.flags.writeable:
                return None
        elif never_changes(module_of(kind)):
            if not all(is_stateless(item, alone=self._alone) for _, item in users_objects(value)):
                return None
        elif not is_stateless(value, alone=self._alone):
            return None
        self.kept.append(value)
        return len(self.kept) - 1

    def reducer_override(self, value: Any) -> Any:
        """Return how to copy functions, methods, their variables and caches; NotImplemented for any other object."""
        kind = type(value)
        if kind is FunctionType:
            cells = tuple(map(self._shared, value.__closure__ or ()))
            parts = _Kept(value.__code__), _Kept(value.__globals__), value.__name__, None, cells
            state = {name: getattr(value, name) for name in FUNCTION_STATE}
            state["__defaults__"] = value.__defaults__ and tuple(map(self._shared, value.__defaults__))
            if keywords := value.__kwdefaults__:
                state["__kwdefaults__"] = {name: self._shared(item) for name, item in keywords.items()}
            return FunctionType, parts, (state, vars(value)), None, None, _complete
        if kind is CellType:
            try:
                return CellType, (), (value.cell_contents,), None, None, _fill
            except ValueError:  # it is empty
                return CellType, ()
        if kind is MethodType:
            return MethodType, (_Kept(value.__func__), value.__self__)
        if kind in {MappingProxyType, WeakKeyDictionary, WeakValueDictionary}:
            return kind, (dict(value),)
        if kind is CACHED:
            return _cached, (value.__wrapped__, value.cache_parameters())
        if passes_on_attributes(kind):
            return with_state_setter(value.__reduce_ex__(5))
        if kind.__module__ == "itertools":  # Python 3.14 cannot copy them, and 3.12 warns of it
            raise TypeError(f"cannot pickle {kind.__qualname__!r} object of itertools")
        return NotImplemented

    def _shared(self, held: Any) -> Any:
        """Return what stands for a default or variable of a function; it is copied unless its caller may read it."""
        return _Kept(held) if is_collection(held) and not self._alone else held


class Describer(Copier):
    """Pickles what a value consists of, also if it cannot be copied, to tell whether it has changed.

    An iterator whose state cannot be read counts as changed when it is described again: code uses it to advance it.
    """

    def persistent_id(self, value: Any) -> int | None:
        """Return a number also for a function of Python, and None for objects that copies share but that change."""
        if isinstance(value, SHARED):
            return None
        is_of_python = isinstance(value, FunctionType) and is_foreign(value)
        return super().persistent_id(_Kept(value) if is_of_python else value)

    def reducer_override(self, value: Any) -> Any:
        """Return what describes an object."""
        if isinstance(value, threading.local):
            return dict, (vars(value),)
        if isinstance(value, ContextVar):
            return list, ([value.name, value.get(None)],)
        if isinstance(value, queue.Queue):
            return list, ([*value.queue],)
        if isinstance(value, queue.SimpleQueue):
            return int, (value.qsize(),)
        if isinstance(value, GeneratorType):
            frame = value.gi_frame
            return list, ([id(value), frame and frame.f_lasti, repr(frame and frame.f_locals)],)
        if type(value) in {count, repeat}:  # their texts have what they return next
            return str, (repr(value),)
        try:
            reduced = super().reducer_override(value)
            if reduced is NotImplemented:
                value.__reduce_ex__(5)
        except Exception:  # code of an object may raise anything
            is_again = not isinstance(value, Iterator) or id(value) in _described
            _described.add(id(value))
            return list, ([id(value), is_again],)
        return reduced


SHARED = (threading.local, ContextVar, queue.Queue, queue.SimpleQueue)
"""The types of objects that copies share, although they hold something."""
_described: set[int] = set()
"""The numbers of the iterators that were described."""


class CopyReader(pickle.Unpickler):
    """Reads what a `Copier` has written."""

    def __init__(self, content: BytesIO, kept: list[Any]):
        content.seek(0)
        super().__init__(content)
        self._kept = kept

    def persistent_load(self, number: int) -> Any:
        """Return the object of a number."""
        return self._kept[number]


def passes_on_attributes(kind: Any) -> bool:
    """Return whether objects of a class would look for `__setstate__` in an object that they wrap, and do not have yet.

    This is so if they pass on what they lack by `__getattr__`; the look-up then never ends.
    """
    if not hasattr(kind, "__getattr__") or hasattr(kind, "__setstate__") or issubclass(kind, type):
        return False
    return not never_changes(module_of(kind))


def with_state_setter(reduced: Any) -> Any:
    """Return how to make an object again, with a function that sets its state as pickle does by default."""
    if not isinstance(reduced, tuple) or len(reduced) < 3 or reduced[2] is None:
        return reduced
    parts = (*reduced, None, None, None)[:6]
    return parts if parts[5] is not None else (*parts[:5], _set_state)


def _set_state(value: Any, state: Any) -> None:
    attributes, slots = state if isinstance(state, tuple) and len(state) == 2 else (state, None)
    if attributes:
        vars(value).update(attributes)
    for name, item in (slots or {}).items():
        object.__setattr__(value, name, item)


def _complete(function: FunctionType, state: tuple[dict[str, Any], dict[str, Any]]) -> None:
    """Set the attributes of a copied function."""
    for name, value in state[0].items():
        setattr(function, name, value)
    vars(function).update(state[1])


def _fill(cell: CellType, contents: tuple[Any]) -> None:
    """Set the value of a variable of an enclosing function."""
    (cell.cell_contents,) = contents


def _cached(function: Any, parameters: dict[str, Any]) -> Any:
    """Return a function with an empty cache."""
    return lru_cache(**parameters)(function)

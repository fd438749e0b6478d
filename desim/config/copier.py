"""Copies of objects with state for each run, and descriptions that tell whether a run has changed an object.

Pickle makes both. Code, objects without state, and collections that the caller may read after a run are not copied: the
copy and the original share them. See `desim.config.fresh`.
"""

import pickle
import queue
import random
import threading
from collections.abc import Iterator
from contextvars import ContextVar
from functools import cached_property, lru_cache
from hashlib import sha256
from io import BytesIO
from itertools import count, repeat
from types import CellType, FunctionType, GeneratorType, MappingProxyType, MethodType
from typing import Any
from weakref import WeakKeyDictionary, WeakValueDictionary, finalize

import numpy as np

from desim.config.code_variables import CACHED, is_foreign
from desim.config.stateless import CONSTANTS, is_collection, is_output, is_stateless, is_stateless_module, users_objects
from desim.config.traits import module_of

FUNCTION_STATE = ("__kwdefaults__", "__module__", "__qualname__", "__doc__")
"""The attributes of a function that a copy takes over, besides those that its users set."""


class _Shared:
    """Wraps an object that the copy shares with the original."""

    def __init__(self, value: Any):
        self.value = value


class Copier(pickle.Pickler):
    """Pickles a model for this process, where the copy can refer to objects that it shares with the original.

    Args:
        content: the stream for the pickle.
        with_collections: whether collections are copied, too, because nobody reads them after the run.

    Attributes:
        shared: the shared objects; the pickle has their indices.
        functions: the functions in the model.
    """

    def __init__(self, content: BytesIO, *, with_collections: bool = False):
        super().__init__(content, 5)
        self._with_collections = with_collections
        self.shared: list[Any] = []
        self.functions: list[FunctionType] = []

    def persistent_id(self, value: Any) -> int | None:
        """Return the index of an object that the copy shares; None for an object that is copied."""
        kind = type(value)
        if kind in CONSTANTS:  # the pickle holds the value, so that a description tells values apart
            return None
        if kind is FunctionType:
            self.functions.append(value)
        if kind is _Shared:
            value = value.value
        elif kind is np.ndarray:
            if value.flags.writeable:
                return None
        elif is_stateless_module(module_of(kind)):  # a built-in model, for example, if it holds no state of users
            if not all(is_stateless(item, with_collections=self._with_collections) for _, item in users_objects(value)):
                return None
        elif not is_output(value) and not is_stateless(value, with_collections=self._with_collections):
            return None
        self.shared.append(value)
        return len(self.shared) - 1

    def reducer_override(self, value: Any) -> Any:
        """Return how to copy functions, methods, their variables and caches; NotImplemented for any other object."""
        kind = type(value)
        if kind is FunctionType:
            cells = tuple(map(self._variable, value.__closure__ or ()))
            parts = _Shared(value.__code__), _Shared(value.__globals__), value.__name__, None, cells
            state = {name: getattr(value, name) for name in FUNCTION_STATE}
            state["__defaults__"] = value.__defaults__ and tuple(map(self._variable, value.__defaults__))
            if keywords := value.__kwdefaults__:
                state["__kwdefaults__"] = {name: self._variable(item) for name, item in keywords.items()}
            return FunctionType, parts, (state, vars(value)), None, None, _complete
        if kind is CellType:
            try:
                return CellType, (), (value.cell_contents,), None, None, _fill
            except ValueError:  # it is empty
                return CellType, ()
        if kind is MethodType:
            return MethodType, (_Shared(value.__func__), value.__self__)
        if kind in {MappingProxyType, WeakKeyDictionary, WeakValueDictionary}:
            return kind, (dict(value),)
        if kind is CACHED:
            return _cached, (value.__wrapped__, value.cache_parameters())
        if passes_on_attributes(kind):
            return with_state_setter(value.__reduce_ex__(5))
        if kind.__module__ == "itertools":  # Python 3.14 cannot copy such iterators, and 3.12 warns of it
            raise TypeError(f"cannot pickle {kind.__qualname__!r} object of itertools")
        return NotImplemented

    def _variable(self, variable: Any) -> Any:
        """Return a default or a variable of a function, wrapped if it is a collection that the caller may read."""
        return _Shared(variable) if is_collection(variable) and not self._with_collections else variable


class Describer(Copier):
    """Pickles what a value consists of, also if it cannot be copied, to tell whether it has changed.

    An iterator whose state cannot be read has one description before the first run, and another one afterwards, because
    the run may have advanced it.
    """

    owners: frozenset[int] = frozenset()
    """The `id` of each object of which this describes a cached property."""

    def persistent_id(self, value: Any) -> int | None:
        """Return an index also for a function of a library, which never changes; None if a shared object may change."""
        if isinstance(value, SHARED_TYPES):
            return None
        is_of_library = isinstance(value, FunctionType) and is_foreign(value)
        return super().persistent_id(_Shared(value) if is_of_library else value)

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
        if type(value) in {count, repeat}:  # their texts show the next item
            return str, (repr(value),)
        try:
            reduced = super().reducer_override(value)
            if reduced is NotImplemented:
                reduced = self._without_cached(value, value.__reduce_ex__(5))  # raises if it cannot be copied
        except Exception:  # code of an object may raise anything
            is_first = isinstance(value, Iterator) and id(value) not in _described
            if is_first:
                _described[id(value)] = value
                if len(_described) > MAX_DESCRIBED:
                    del _described[next(iter(_described))]
            return list, ([id(value), is_first],)
        return reduced

    def _without_cached(self, value: Any, reduced: Any) -> Any:
        """Return how to describe an object without its cached properties, which are computed from the rest.

        Graphs of networkx have some. What advances when it is read, such as a random generator, stays. In place of any
        other value of a user's property, it is described how often it has changed since it was first described.
        NotImplemented if the object has no cached property.
        """
        kind = type(value)
        attributes = reduced[2] if isinstance(reduced, tuple) and len(reduced) > 2 else None
        if not isinstance(attributes, dict):
            return NotImplemented
        properties = {
            name: member for name in attributes if type(member := getattr(kind, name, None)) is cached_property
        }
        cached = {name: attributes[name] for name in properties if not isinstance(attributes[name], ADVANCING)}
        if not cached:
            return NotImplemented
        rest = {name: item for name, item in attributes.items() if name not in cached}
        computed = {name: item for name, item in cached.items() if not is_foreign(properties[name].func)}
        if computed and id(value) not in self.owners and (changes := self._changes(value, computed)):
            rest[""] = changes
        return (*reduced[:2], rest or None, *reduced[3:])

    def _changes(self, owner: Any, computed: dict[str, Any]) -> list[tuple[str, int]]:
        """Return the names of the cached values of an object that have changed, and how often, sorted."""
        if id(owner) not in _computed:
            finalize(owner, _computed.pop, id(owner), None)
            _computed[id(owner)] = {}
        states = _computed[id(owner)]
        for name, item in computed.items():
            describer = Describer(content := BytesIO())
            describer.owners = self.owners | {id(owner)}
            describer.dump(item)
            state = sha256(content.getvalue()).digest(), [id(shared) for shared in describer.shared]
            last, changes = states.get(name, (state, 0))
            states[name] = state, changes + (state != last)
        return sorted((name, changes) for name, (_, changes) in states.items() if name in computed and changes)


ADVANCING = (Iterator, random.Random, np.random.Generator, np.random.RandomState)
"""The types of objects of which each reading changes the next one."""
SHARED_TYPES = (threading.local, ContextVar, queue.Queue, queue.SimpleQueue)
"""The types of objects that copies share, although what they hold changes."""
MAX_DESCRIBED = 10_000
"""Number of iterators that are kept after their description, the newest ones.

An iterator that is no longer kept has the description of a new one again. So a run that describes more iterators than
these before it ends does not warn of the oldest of them.
"""
_computed: dict[int, dict[str, tuple[Any, int]]] = {}
"""By `id` of an object and cached property: its last description, and how often it has changed."""
_described: dict[int, Any] = {}
"""The iterators that were described, by `id`; they are kept, so that no other object gets the `id` of one of them."""


class CopyReader(pickle.Unpickler):
    """Reads what a `Copier` has written."""

    def __init__(self, content: BytesIO, shared: list[Any]):
        content.seek(0)
        super().__init__(content)
        self._shared = shared

    def persistent_load(self, number: int) -> Any:
        """Return the shared object of an index."""
        return self._shared[number]


def passes_on_attributes(kind: Any) -> bool:
    """Return whether objects of a class look for `__setstate__` in an object that they wrap, by `__getattr__`.

    While such an object is unpickled, it does not have the wrapped object yet, and the look-up never ends.
    """
    if not hasattr(kind, "__getattr__") or hasattr(kind, "__setstate__") or issubclass(kind, type):
        return False
    return not is_stateless_module(module_of(kind))


def with_state_setter(reduced: Any) -> Any:
    """Return a result of `__reduce_ex__` with a function that sets the state, so `__setstate__` is not looked up."""
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

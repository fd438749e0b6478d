"""State that a model shares with other runs: what its code changes in classes, functions, collections and globals."""

import pickle
import random
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from gc import get_referents
from types import FunctionType
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from desim.config.caller_warnings import warn_caller
from desim.config.code_variables import (
    CACHED,
    MAX_SEARCHED,
    Read,
    is_foreign,
    reached_code,
    shared_queues,
    shared_variables,
)
from desim.config.outside import Outside, outside_sources
from desim.config.own_modules import plain_name
from desim.config.traits import module_of


class StateWarning(UserWarning):
    """Warns that a run depends on something outside of it, so that another run may give other results.

    It depends on state that an earlier run has left in a class, a function, a module or a collection; on the clock of
    the computer; on random numbers without a seed; or on variables of the process.
    """


_collected: ContextVar[list[str] | None] = ContextVar("collected", default=None)
"""The texts of the warnings in the block of `collected_warnings`."""


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """Yield a list of the texts of `StateWarning`s, which are then not given: nobody reads the warnings of a worker."""
    texts: list[str] = []
    token = _collected.set(texts)
    try:
        yield texts
    finally:
        _collected.reset(token)


def _warn(text: str) -> None:
    texts = _collected.get()
    if texts is None:
        warn_caller(text, StateWarning)
    else:
        texts.append(text)


_runs: WeakKeyDictionary[Any, dict[str, tuple[Any, Any]]] = WeakKeyDictionary()
"""By function, class or module, then by variable: snapshots before and after the last run that used the variable."""


@contextmanager
def shared_changes(objects: Iterable[Any], snapshot: Callable[[Any], Any]) -> Iterator[None]:
    """Warn of each variable that an earlier run has changed and that nobody has reset since; the block is a run.

    The variables are the attributes of classes and functions, and the defaults, the variables of enclosing functions
    and the global variables that code of a user reads or writes. A collection to which the code only adds may change:
    it reports to the caller.

    Even a first run gives a warning if it draws from the global generators of `random` or `numpy.random`. Other threads
    may draw, too: while any runs, there is a warning only if the code of the run names functions of these generators.

    Args:
        objects: the classes and functions, perhaps among other objects.
        snapshot: returns a description that differs after a value has changed; None if changes cannot be found.
    """
    held = list(objects)
    objects = reached_code(held)
    outside = Outside.of_all(map(_outside, objects))
    for text in _warnings_of(outside):
        _warn(text)
    reads = [*shared_variables(objects), *shared_queues(held, objects)]
    before = [snapshot(read()) for _, _, read in reads]
    if carried := _carried(reads, before):
        text = (
            f"{', '.join(sorted(carried))}: an earlier run has changed it, so this run starts from another state;"
            " what a model remembers should be in its instance (self), of which each run gets a copy; what it reports"
            " may be appended to a list that it does not read"
        )
        _warn(text)
    caches = [item for item in objects if isinstance(item, CACHED)]
    cached = [_cached(item, snapshot) for item in caches]
    generators, imported = _global_generators(), set(sys.modules)
    try:
        yield
    finally:  # a run that raises leaves its state, too
        for (owner, name, read), first in zip(reads, before, strict=True):
            _runs.setdefault(owner, {})[name] = first, snapshot(read())
        new_modules = {plain_name(module) for module in sys.modules.keys() - imported}
        for owner, name, read in shared_variables(objects):
            is_created = name not in _runs.get(owner, {})
            if is_created and name.rpartition(".")[0] not in new_modules:  # an import creates variables, too
                _runs.setdefault(owner, {})[name] = (), snapshot(read())
    for text in (*_cache_warnings(caches, cached, snapshot), *_generator_warnings(generators, outside)):
        _warn(text)


def _carried(reads: Sequence[tuple[Any, str, Read]], before: Sequence[Any]) -> set[str]:
    """Return the names of the variables that the last run has changed and that nobody has reset since."""
    carried = set()
    for (owner, name, _), state in zip(reads, before, strict=True):
        first, last = _runs.get(owner, {}).get(name, (None, None))
        if None not in (first, last) and first != last == state:
            carried.add(name)
    return carried


@contextmanager
def followed_changes(objects: Iterable[Any], snapshot: Callable[[Any], Any]) -> Iterator[None]:
    """Count the changes by a block that is no run as changes by the last run.

    Metrics, for instance, call models of links. If their changes did not count, the next run would take them for a
    reset by the caller, and give no warning. For the arguments see `shared_changes`.
    """
    if not _runs:
        yield
        return
    reads = [item for item in shared_variables(reached_code(objects)) if item[1] in _runs.get(item[0], {})]
    before = [snapshot(read()) for _, _, read in reads]
    try:
        yield
    finally:
        for (owner, name, read), state in zip(reads, before, strict=True):
            first, last = _runs[owner][name]
            if state is not None and state == last:
                _runs[owner][name] = first, snapshot(read())


def _cache_warnings(
    caches: Sequence[Any], cached: Sequence[Mapping[int, Any]], snapshot: Callable[[Any], Any]
) -> Iterator[str]:
    """Yield a warning of each cache in which a run has changed a value; `cached` are the snapshots before the run."""
    for item, before in zip(caches, cached, strict=True):
        after = _cached(item, snapshot) if before else {}
        if any(after.get(identity, state) != state for identity, state in before.items()):
            yield (
                f"{plain_name(module_of(item))}.{item.__qualname__}: the run has changed what its cache has from an"
                " earlier one, so another run starts from another state; what a model remembers should be in its"
                " instance (self)"
            )


def _cached(function: Any, snapshot: Callable[[Any], Any]) -> dict[int, Any]:
    """Return a snapshot of each value in the cache of a function, by its `id`; none if there are too many values."""
    if not 0 < function.cache_info().currsize <= MAX_SEARCHED:
        return {}
    values = [item for item in get_referents(function) if item is not vars(function) and not callable(item)]
    if function.cache_parameters()["maxsize"] is None:  # the function refers to a dict of the values
        values = [value for item in values if type(item) is dict for value in item.values()]
    else:  # the function refers to the values, and to a dict of the links of their linked list
        values = [item for item in values if not (type(item) is dict and item and all(map(_is_link, item.values())))]
    return {id(item): snapshot(item) for item in values}


def _is_link(value: Any) -> bool:
    return type(value).__name__ == "_lru_list_elem"


def _global_generators() -> dict[str, Any]:
    """Return the states of the random generators that all code of a process shares, by the names of their modules."""
    return {"random": random.getstate(), "numpy.random": pickle.dumps(np.random.get_state(legacy=False))}  # noqa: NPY002


def _generator_warnings(before: Mapping[str, Any], outside: Outside) -> Iterator[str]:
    """Yield a warning if a run has drawn from global generators; `before` are their states at its beginning."""
    is_alone = threading.active_count() == 1  # otherwise another thread, of a cluster for instance, may have drawn
    drawn = [name for name, state in _global_generators().items() if state != before[name]]
    if drawn_from := [name for name in drawn if is_alone or name in outside.generators]:
        yield (
            f"{' and '.join(drawn_from)}: the run has drawn from the global generator, so another run gives other"
            " results; a protocol should draw from `me.rng`, any other model from the `rng` that it is called with"
        )


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

"""Fresh copies of models with state, so that each run starts from the state that the objects of its caller have.

A built-in model and a plain function never change, and a run uses them as they are. Any other object may remember
something between calls. A run therefore calls a copy, with copies of all that the object holds: its attributes, the
variables of enclosing functions, mutable defaults, random generators. What a module or a class holds is not copied.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from io import BytesIO
from types import BuiltinFunctionType
from typing import Any, TypeVar

import numpy as np

from desim.config.code_variables import ADDING, COLLECTIONS
from desim.config.copier import Copier, CopyReader, Describer
from desim.config.shared_state import followed_changes, shared_changes
from desim.config.stateless import is_stateless, users_objects
from desim.config.traits import name_of

Model = TypeVar("Model")


class StateError(ValueError):
    """Raised when an object cannot be copied, so that a second run would not start from the same state."""


@contextmanager
def fresh_copy(model: Model, *, with_collections: bool = False, is_run: bool = False) -> Iterator[Model]:
    """Yield a copy of a model in which the objects that may have state are copies; the model itself if it has none.

    An object to which the model refers twice is copied once. A collection in a variable of an enclosing function, such
    as a list to which the function appends what it sees, is shared with the caller, who reads it after the run.

    If the block is a run, a `StateWarning` names what is not copied and what an earlier run has changed: attributes of
    classes, collections and global variables.

    Args:
        model: the model.
        with_collections: whether collections are copied, too, because nobody reads them after the run. If one of them
            cannot be copied, all are shared.
        is_run: whether the block is a run.

    Raises:
        StateError: if an object cannot be copied, such as a generator; the text names its key.
    """
    users = dict(users_objects(model))
    if not users:  # most models hold no objects of users
        yield model
        return
    copied, shared, functions = model, [], []
    if not all(is_stateless(value, with_collections=with_collections) for value in users.values()):
        copied, copier = _copied(model, users, with_collections=with_collections)
        shared, functions = copier.shared, copier.functions
    watch = shared_changes if is_run else followed_changes
    with watch([*shared, *functions, *users.values()], _snapshot):
        yield copied


def _copied(model: Any, users: Mapping[str, Any], *, with_collections: bool) -> tuple[Any, Copier]:
    """Return a copy of a model, and the copier that has made it; see `fresh_copy`."""
    try:
        return _copy(model, with_collections=with_collections)
    except Exception as error:  # code of an object may raise anything
        if with_collections:  # perhaps a collection of the caller cannot be copied; then it is shared
            return _copied(model, users, with_collections=False)
        raise _refusal(users, error) from error


def _copy(value: Any, *, with_collections: bool = False) -> tuple[Any, Copier]:
    content = BytesIO()
    copier = Copier(content, with_collections=with_collections)
    copier.dump(value)
    reader = CopyReader(content, copier.shared)
    return reader.load(), copier


def _refusal(users: Mapping[str, Any], error: Exception) -> StateError:
    """Return the error for a model that cannot be copied, with the key of the first object that cannot."""
    for key, value in users.items():
        try:
            _copy(value)
        except Exception as reason:
            place = f"{key}: " if key else ""
            return StateError(
                f"{place}{name_of(value)} may remember something, so each run calls a copy of it, but it cannot be"
                f" copied ({reason}): create what changes in the first call during the run, or leave it out in the"
                " __getstate__ of its class"
            )
    return StateError(f"cannot be copied: {error}")


LARGE = 10_000
"""A collection of at least this many items is not searched for changes, because the search would take long."""


def _snapshot(value: Any) -> Any:
    """Return a description that differs after the value has changed; None if changes cannot be found.

    Objects that are shared by all runs count by their identity.
    """
    if isinstance(value, COLLECTIONS) and (value.size if isinstance(value, np.ndarray) else len(value)) >= LARGE:
        return None
    if type(value) is BuiltinFunctionType and value.__name__ in ADDING:  # its holder cannot read the collection
        return None
    if is_stateless(value) and not isinstance(value, np.ndarray):
        return [value]
    content = BytesIO()
    copier = Describer(content)
    try:
        copier.dump(value)
    except Exception:  # code of an object may raise anything
        return None
    return sha256(content.getvalue()).digest(), [id(item) for item in copier.shared]


class Remembered:
    """Tells, at the second use of an object, whether it has changed since the first.

    Use it for an object of the caller that is not copied, because the caller may read it, or want it to learn.
    """

    def __init__(self) -> None:
        self._states: list[Any] = []

    def has_changed(self, value: Any) -> bool:
        """Return whether the object has changed since the first call, at the second call; False at any other."""
        if len(self._states) > 1:
            return False
        self._states.append(_snapshot(value))
        return len(self._states) == 2 and None not in self._states and self._states[0] != self._states[1]

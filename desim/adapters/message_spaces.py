"""Spaces of gymnasium for messages: spaces with more keys, masks, and the element that stands for no message."""

from functools import singledispatch
from typing import Any

import numpy as np
from gymnasium import spaces

from desim.config.arguments import value_text

UNHEARD = -1.0
"""The age of a message that has not arrived."""


class ActionSpace(spaces.Dict):
    """The space of an action with a message. A mask of the environment masks the action.

    Args:
        env_space: the space of the action.
        message: the space of the message.

    Attributes:
        keeps_keys: whether the action is a dict, which keeps its keys; else it has the key `action`.
    """

    def __init__(self, env_space: spaces.Space[Any], message: spaces.Space[Any]):
        super().__init__(with_entries(env_space, "action", {"message": message}))
        self.keeps_keys = isinstance(env_space, spaces.Dict)

    def sample(self, mask: Any = None, probability: Any = None) -> dict[str, Any]:
        """Draw an action and a message; a mask without a part for the message is that of the action."""
        return super().sample(mask=self._parts(mask), probability=self._parts(probability))

    def _parts(self, mask: Any) -> Any:
        if mask is None or (isinstance(mask, dict) and "message" in mask):
            return mask
        return {**(mask if self.keeps_keys else {"action": mask}), "message": None}


def with_entries(value: Any, name: str, more: dict[str, Any]) -> dict[str, Any]:
    """Return a dict of the entries of `value`, a dict or a Dict space, and of `more`.

    Any other value becomes the entry `name`.

    Raises:
        ValueError: if the value has a key of `more`.
    """
    entries = dict(value) if isinstance(value, dict | spaces.Dict) else {name: value}
    if shared := sorted(entries.keys() & more.keys()):
        raise ValueError(f"the {name} of this environment has the key {value_text(shared[0])} already")
    return entries | more


@singledispatch
def blank(space: Any) -> Any:
    """Return an element of a space: zeros, or the numbers closest to 0 that the space has.

    Raises:
        ValueError: if it is a space of another kind.
    """
    raise ValueError(
        f"the elements of a {type(space).__name__} have no zero: messages, and actions without idle=, should be of a"
        " Box, Discrete, MultiDiscrete or MultiBinary, or of a Dict or Tuple of these"
    )


@blank.register
def _box(space: spaces.Box) -> Any:
    return np.clip(np.zeros(space.shape, space.dtype), space.low, space.high)


@blank.register
def _discrete(space: spaces.Discrete) -> Any:
    return space.start.dtype.type(np.clip(0, space.start, space.start + space.n - 1))


@blank.register
def _multi_discrete(space: spaces.MultiDiscrete) -> Any:
    return np.clip(0, space.start, space.start + space.nvec - 1).astype(space.dtype)


@blank.register
def _binary(space: spaces.MultiBinary) -> Any:
    return np.zeros(space.shape, space.dtype)


@blank.register
def _dict(space: spaces.Dict) -> Any:
    return {key: blank(part) for key, part in space.items()}


@blank.register(spaces.Tuple)
def _tuple(space: Any) -> Any:
    return tuple(blank(part) for part in space)

"""How many bytes a message takes: the layout from which all of them are counted.

    4  sender
    4  sequence number
    8  time, s
    8  each number or truth in the body

A record that is passed on inside a body takes what it takes by itself. So an action takes 24 bytes, an action with its
time of capture 32, and one with a position and a speed 48.
"""

from copy import deepcopy
from typing import Any

import numpy as np

from desim.kernel.records import Record

HEADER = 16
"""Bytes of sender, sequence number and time."""
NUMBER = 8
"""Bytes of a number."""
SCALARS = frozenset({int, float, bool})
COLLECTIONS = (tuple, list, set, frozenset)


def as_sent(body: Any) -> Any:
    """Return what the receivers of a message get, which does not change when the sender changes the body later.

    What is hashable counts as immutable and is not copied: a number, a text, a named tuple of such. A list, a dict or
    an array, or a tuple that holds one, is copied, once for all receivers.
    """
    try:
        hash(body)
    except TypeError:
        return deepcopy(body)
    return body


def size_of(body: Any) -> int:
    """Return the bytes of a message with this body: a number, a text, None, or a collection or array of such."""
    return HEADER + _size(body)


def _size(body: Any) -> int:
    if type(body) in SCALARS:
        return NUMBER
    if isinstance(body, Record):
        return size_of(body.body)
    if isinstance(body, COLLECTIONS):
        return NUMBER * len(body) if SCALARS.issuperset(map(type, body)) else sum(map(_size, body))
    if body is None:
        return 0
    if isinstance(body, str | bytes):
        return len(body.encode() if isinstance(body, str) else body)
    if isinstance(body, dict):
        return sum(_size(key) + _size(each) for key, each in body.items())
    if isinstance(body, np.ndarray):
        return NUMBER * body.size * (2 if np.iscomplexobj(body) else 1)
    return 2 * NUMBER if isinstance(body, complex) else NUMBER

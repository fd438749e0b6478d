"""The size of messages in bytes, computed from a fixed layout.

    4  sender
    4  sequence number
    8  time, s
    8  each number or boolean in the body; 16 if it is complex
    1  each byte of a string (in UTF-8) or of a bytes object in the body
    0  None

The size of a collection or an array is the sum of the sizes of its items, that of a dict the sum of the sizes of its
keys and values. A record inside a body, for instance a forwarded one, includes its own header. Any other object counts
as one number.

For example, a message takes 24 bytes if its body is an action (one number), 32 if it is an action and a capture time,
and 48 if it is an action, a position (two numbers) and a speed.
"""

from copy import deepcopy
from typing import Any

import numpy as np

from desim.config.python_numbers import whole
from desim.kernel.portable_math import portable_sum
from desim.kernel.records import Record

HEADER = 16
"""Size of sender, sequence number and time, bytes."""
NUMBER = 8
"""Size of a number, bytes."""
SCALARS = frozenset({int, float, bool})
COLLECTIONS = (tuple, list, set, frozenset)


def as_sent(body: Any) -> Any:
    """Return the body as the receivers of a message get it: changes that the sender makes later do not affect it.

    A hashable body, such as a number, a string or a named tuple of numbers, counts as immutable and is not copied. Any
    other body, such as a list, a dict, an array or a tuple that contains one of them, is copied once for all receivers.
    """
    try:
        hash(body)
    except TypeError:
        return deepcopy(body)
    return body


def size_of(body: Any) -> int:
    """Return the size (bytes) of a message with a body."""
    return HEADER + _size(body)


def checked_size(size: int) -> int:
    """Return the size (bytes) that a sender gives for a message, an integer of any kind, as an `int`.

    Raises:
        ValueError: if the size is negative or not an integer.
    """
    size = whole(size, "the size of a message, in bytes,")
    if size < 0:
        raise ValueError(f"the size of a message should be at least 0 bytes (got {size})")
    return size


def _size(body: Any) -> int:
    if type(body) in SCALARS:
        return NUMBER
    if isinstance(body, Record):
        return size_of(body.body)
    if isinstance(body, COLLECTIONS):
        return NUMBER * len(body) if SCALARS.issuperset(map(type, body)) else portable_sum(map(_size, body))
    if body is None:
        return 0
    if isinstance(body, str | bytes):
        return len(body.encode() if isinstance(body, str) else body)
    if isinstance(body, dict):
        return portable_sum(_size(key) + _size(each) for key, each in body.items())
    if isinstance(body, np.ndarray):
        return NUMBER * body.size * (2 if np.iscomplexobj(body) else 1)
    return 2 * NUMBER if isinstance(body, complex | np.complexfloating) else NUMBER

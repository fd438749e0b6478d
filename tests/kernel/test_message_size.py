"""Bytes of messages."""

import ctypes
from collections import namedtuple

import numpy as np
import pytest

from desim.kernel.core.message_size import MAX_SIZE, checked_size, size_of


def test_an_action_takes_24_bytes_with_its_time_32_with_position_and_speed_48():
    """16 of header and 8 for each number or truth."""
    assert size_of(True) == size_of((True,)) == 16 + 8
    assert size_of((True, 3.2)) == 16 + 2 * 8
    assert size_of((True, 1.0, 2.0, 0.9)) == 16 + 4 * 8


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (None, 0),
        (7, 8),
        (7.5, 8),
        (np.float64(7.5), 8),
        (np.bool_(True), 8),
        (3.0 + 4.0j, 16),
        ((True, np.complex128(1.0j)), 24),
        (np.complex64(1.0j), 16),
        (np.zeros(2, complex), 32),
        (np.zeros(2, np.complex64), 32),
        ("", 0),
        ("order", 5),
        ("für", 4),
        (b"\x00\x01", 2),
        ((), 0),
        ([1, [2, (3, None)]], 24),
        ({1, 2}, 16),
        (frozenset({"ab", "c"}), 3),
        ({"who": 3, 4: (5, 6)}, 3 + 8 + 8 + 16),
        (np.zeros(2), 16),
        (np.zeros((3, 2)), 48),
        ((True, np.arange(4)), 40),
    ],
)
def test_the_size_of_a_body_is_that_of_its_contents(body, expected):
    assert size_of(body) == 16 + expected


class Pose(ctypes.LittleEndianStructure):
    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (("x", ctypes.c_double), ("y", ctypes.c_float), ("robot", ctypes.c_int16), ("name", ctypes.c_char * 4))


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (Pose(1.0, 2.0, 3, b"uav"), 8 + 4 + 2 + 4),
        ((Pose * 2)(), 36),
        ({"id": 1, "pose": Pose()}, 2 + 8 + 4 + 18),
        (ctypes.c_uint16(5), 2),
        (memoryview(Pose()), 18),
    ],
)
def test_a_structure_of_ctypes_has_its_bytes(body, expected):
    assert size_of(body) == 16 + expected


def test_the_names_of_a_named_tuple_are_not_sent():
    assert size_of(namedtuple("Word", "active position")(True, (0.0, 1.0))) == 16 + 24


def test_the_size_that_a_sender_tells_is_an_integer():
    assert [checked_size(each) for each in (0, np.int64(40), np.uint8(7), MAX_SIZE)] == [0, 40, 7, MAX_SIZE]
    assert type(checked_size(np.int64(40))) is int


@pytest.mark.parametrize("size", [40.0, 40.5, np.float64(40), "40", True, np.True_, None, [40], np.array([4, 0])])
def test_a_size_that_is_no_integer_is_refused(size):
    with pytest.raises(ValueError, match="the size of a message, in bytes, should be an integer"):
        checked_size(size)


@pytest.mark.parametrize("size", [-1, np.int8(-1), MAX_SIZE + 1])
def test_a_size_that_no_message_can_have_is_refused(size):
    with pytest.raises(ValueError, match=r"should be at (least 0|most 281474976710656) bytes"):
        checked_size(size)

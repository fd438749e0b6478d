"""Bytes of messages."""

from collections import namedtuple

import numpy as np
import pytest

from desim.kernel.wire import size_of


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
def test_a_body_takes_what_is_in_it(body, expected):
    assert size_of(body) == 16 + expected


def test_the_names_of_a_named_tuple_are_not_sent():
    assert size_of(namedtuple("Word", "active position")(True, (0.0, 1.0))) == 16 + 24

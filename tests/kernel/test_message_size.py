"""Bytes of messages."""

from collections import namedtuple
from copy import deepcopy

import networkx as nx
import numpy as np
import pytest

from desim.kernel.clock import Clock
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.kernel.message_size import as_sent, size_of
from desim.kernel.network import Network
from desim.kernel.units import SECOND


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


def test_the_names_of_a_named_tuple_are_not_sent():
    assert size_of(namedtuple("Word", "active position")(True, (0.0, 1.0))) == 16 + 24


@pytest.mark.parametrize("body", [None, 7, "order", (1, (2.0, None)), namedtuple("Word", "active")(True)])
def test_immutable_bodies_are_sent_without_a_copy(body):
    assert as_sent(body) is body


@pytest.mark.parametrize("way", ["send", "publish", "set_initial_belief"])
@pytest.mark.parametrize("body", [[1, [2]], {"who": [3]}, (4, [5])])
def test_a_body_that_is_changed_later_arrives_as_it_was_sent(way, body):
    """Also if it is changed deep inside, and after it was read: the received body does not change either."""
    clock, before = Clock(), deepcopy(body)
    network = Network(clock, nx.complete_graph(3), Links(latency=Constant(value=1.0)))
    getattr(network, way)(0, *([None] if way == "send" else []), body)
    inner = next(each for each in (body.values() if isinstance(body, dict) else body) if isinstance(each, list))
    inner.append("changed on the way")
    clock.run(until=2 * SECOND)
    heard = network.inbox(1).drain()[0] if way == "send" else network.latest_records(1)[0][1]
    inner.append("changed after it came")
    assert heard.body == before

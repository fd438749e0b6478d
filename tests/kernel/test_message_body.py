"""Bodies of all kinds arrive as they were sent, in every way, and are recorded by their content."""

import json
import re
import subprocess
import sys
import threading
import weakref
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import partial
from io import StringIO
from logging import StreamHandler, getLogger
from pathlib import Path
from types import MappingProxyType
from zoneinfo import ZoneInfo

import networkx as nx
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.kernel.core.body_content import MAX_DEPTH, content, content_fields, in_json_types
from desim.kernel.core.clock import Clock
from desim.kernel.core.events import Broadcast, Delivered, Sent, Trace
from desim.kernel.core.message_body import as_sent, differs, is_immutable
from desim.kernel.core.message_size import HEADER, size, size_of
from desim.kernel.core.records import Record
from desim.kernel.core.trace_file import body_json, events_of, line_of
from desim.kernel.core.units import SECOND
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.transport import Coded, Reliable
from desim.kernel.network import Network
from desim.pursuit.team.announcements import Forwarded
from tests.message_bodies import BODIES, IMMUTABLE, MUTABLE, Bid, ByIdentity, Computed, Mean, Named, Plan, Slotted

ROOT = Path(__file__).parents[2]
each_body = pytest.mark.parametrize("name", BODIES)


@each_body
def test_a_body_is_recorded_by_its_content(name):
    body, expected, _ = BODIES[name]
    assert in_json_types(body) == expected
    assert repr(in_json_types(body)) == repr(expected)
    assert json.loads(body_json(body)) == expected
    assert json.loads(body_json([{"x": body}])) == [{"x": expected}]


@each_body
def test_the_size_of_a_body_is_that_of_its_content(name):
    body, _, expected = BODIES[name]
    if expected is not None:
        assert size_of(body) == HEADER + expected
        assert size_of((body, [body])) == HEADER + 2 * expected
        return
    with pytest.raises(ValueError, match=r"an object of type .+ has no size: send it with size="):
        size_of([body])


def test_all_registered_types_are_among_the_bodies():
    """A kind of content, or of size, that is added later is in the table, and so in all tests of this file."""

    def in_all(value):
        yield value
        parts = content(value)
        for part in parts.values() if isinstance(parts, dict) else parts if isinstance(parts, list) else ():
            yield from in_all(part)

    bodies = [part for body, *_ in BODIES.values() for part in in_all(body)]
    for verb in (content, size):
        used = {verb.dispatch(type(body)) for body in bodies}
        missing = {kind for kind, way in verb.registry.items() if way not in used}
        assert missing <= {weakref.ref}, verb


@pytest.mark.parametrize("name", IMMUTABLE)
def test_immutable_bodies_are_sent_without_a_copy(name):
    body = IMMUTABLE[name][0]
    assert as_sent(body) is body
    assert as_sent(nested := (body, frozenset({(body,)}))) is nested


@pytest.mark.parametrize("name", MUTABLE)
def test_other_bodies_are_copied(name):
    body, expected, _ = MUTABLE[name]
    for sent in (as_sent(body), as_sent((1, body))[1], as_sent(Named(0, body)).path):
        assert in_json_types(sent) == expected
        assert type(sent) is type(body)
        assert sent is not body


def appending(path):
    path.append(99)


def setting(array):
    array[...] = 99


CHANGES = {
    "list": (lambda: [1], appending),
    "tuple": (lambda: (4, [1]), lambda body: body[1].append(99)),
    "named tuple": (lambda: Named(0, [1]), lambda body: body.path.append(99)),
    "dict": (lambda: {"who": [1]}, lambda body: body["who"].append(99)),
    "set": (lambda: {1}, lambda body: body.add(99)),
    "bytearray": (lambda: bytearray(b"a"), appending),
    "memoryview": (lambda: memoryview(bytearray(2)), lambda body: body.readonly or body.__setitem__(0, 99)),
    "array": (lambda: np.zeros(2), setting),
    "view": (
        lambda: np.broadcast_to(np.zeros(1), (2,)),
        lambda body: setting(body if body.base is None else body.base),
    ),
    "structured scalar": (lambda: np.zeros(1, "i4,f8")[0], lambda body: body.__setitem__("f0", 99)),
    "series": (lambda: pd.Series([1.0]), lambda body: body.__setitem__(0, 99.0)),
    "plain object": (lambda: Plan(1), lambda body: body.path.append(99)),
    "object in slots": (Slotted, lambda body: body.path.append(99)),
    "dataclass": (lambda: Bid(1, 2.0, [1]), lambda body: setattr(body, "price", 99.0)),
    "dataclass by identity": (lambda: ByIdentity([1]), lambda body: body.path.append(99)),
    "tuple of an object": (lambda: (1, Plan(1)), lambda body: body[1].path.append(99)),
    "frozen set of an object": (lambda: frozenset({Plan(1)}), lambda body: next(iter(body)).path.append(99)),
    "relayed record": (
        lambda: Forwarded((Record(0, 1, 0, Plan(1)),)),
        lambda body: body.records[0].body.path.append(99),
    ),
    "partial": (lambda: partial(appending, [1]), lambda body: body()),
}
"""By name: a function that creates a body, and one that changes it."""
WAYS = {
    "send": lambda network, body: network.send(0, 1, body, size=24),
    "to all": lambda network, body: network.send(0, None, body, size=24),
    "publish": lambda network, body: network.publish(0, body, 24),
    "initial belief": lambda network, body: network.set_initial_belief(0, body),
    "reliable": lambda network, body: network.send(0, None, body, size=24, transport=Reliable()),
    "retransmitted": lambda network, body: network.send(0, None, body, size=24, transport=Reliable(timeout=0.6)),
    "coded": lambda network, body: network.send(0, None, body, size=24, transport=Coded(pieces=4, needed=2)),
    "relayed": lambda network, body: network.insert(1, Record(0, 7, 0, body)),
}
IS_RECORD = {"publish", "initial belief", "relayed"}


def received(network, node, way):
    if way in IS_RECORD:
        return network.latest_records(node)[0][1].body
    (message,) = network.inbox(node).drain()
    return message.body


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", CHANGES)
def test_a_body_arrives_as_it_was_sent(way, name):
    """Whatever its sender changes on the way and after that, and whatever another receiver changes."""
    create, change = CHANGES[name]
    body, before, after = create(), in_json_types(create()), create()
    change(after)
    trace, clock = Trace(), Clock()
    network = Network(clock, nx.complete_graph(3), Links(latency=Constant(value=1.0)), trace=trace)
    WAYS[way](network, body)
    change(body)
    if name != "partial":
        assert in_json_types(after) != before
    clock.run(until=4 * SECOND)
    change(body)
    first = received(network, 1, way)
    assert in_json_types(first) == before
    change(first)
    if way in IS_RECORD:
        assert in_json_types(received(network, 1, way)) == before
    if way not in {"send", "relayed"}:
        assert in_json_types(received(network, 2, way)) == before
    bodies = [
        getattr(event.body, "body", event.body) for event in trace if isinstance(event, Broadcast | Sent | Delivered)
    ]
    told = [in_json_types(each) for each in bodies if not hasattr(each, "expected")]
    assert told == [before] * len(told)
    assert len(told) >= (0 if way in {"initial belief", "relayed"} else 1)


@pytest.mark.parametrize("way", sorted(IS_RECORD))
def test_a_reader_of_matching_records_changes_only_a_copy(way):
    clock = Clock()
    network = Network(clock, nx.complete_graph(3), Links(latency=Constant(value=1.0)), predicate=lambda _: True)
    WAYS[way](network, [1])
    clock.run(until=4 * SECOND)
    for _ in range(2):
        body = network.matching(1)[0][1].body
        assert body == [1]
        body.append(99)
    assert network.latest_records(1)[0][1].body == [1]


class Cell:
    """Refers to itself."""

    def __init__(self):
        self.me = self


def nested(value, levels):
    for _ in range(levels):
        value = (value,)
    return value


def cyclic():
    body = [1]
    body.append(body)
    return body


def logger():
    made = getLogger(__name__)
    made.handlers = [StreamHandler()]
    return made


def closure():
    seen = []
    return lambda: seen.append(1)


def generator():
    yield


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (
            generator(),
            "a body of type generator cannot be sent: cannot pickle 'generator' object: send a list, or what",
        ),
        ({"a": [generator()]}, "a body of type dict cannot be sent: cannot pickle 'generator' object"),
        ((1, threading.Lock()), "a body of type tuple cannot be sent: cannot pickle '_thread.lock' object"),
        (
            iter([1]),
            "a body of type list_iterator cannot be sent: an object of type list_iterator can be read only once",
        ),
        (
            [enumerate("a")],
            "a body of type list cannot be sent: an object of type enumerate can be read only once: send a list of its",
        ),
        (
            map(abs, [1]),
            "a body of type map cannot be sent: an object of type map can be read only once: send a list of its items",
        ),
        (StringIO("a"), "a body of type StringIO cannot be sent: an object of type StringIO can be read only once"),
        (sys.stdout, f"a body of type {type(sys.stdout).__name__} cannot be sent: "),
        ({1: property()}, "a body of type dict cannot be sent: the content of an object of type property is not known"),
        (logger(), "a body of type Logger cannot be sent: the content of an object of type RLock is not known"),
        (
            {}.keys(),
            "a body of type dict_keys cannot be sent: cannot pickle 'dict_keys' object: send a list instead",
        ),
        (
            [MappingProxyType({})],
            "a body of type list cannot be sent: cannot pickle 'mappingproxy' object: send a dict instead",
        ),
        (cyclic(), "a body of type list cannot be sent: it is nested more than 100 levels deep, or contains itself"),
        (Cell(), "a body of type Cell cannot be sent: it is nested more than 100 levels deep, or contains itself"),
        (nested(1, MAX_DEPTH + 2), "a body of type tuple cannot be sent: it is nested more than 100 levels deep"),
        (nested([], 5000), "a body of type tuple cannot be sent: it is nested"),
        (closure(), "a body of type function cannot be sent: the function closure.<locals>.<lambda> refers to objects"),
        ([].append, "a body of type builtin_function_or_method cannot be sent: the function list.append refers to"),
        ([weakref.ref(generator)], "a body of type list cannot be sent: a weak reference refers to an object that may"),
        (pd.Series([[1], [2]]), "a body of type Series cannot be sent: its copies would share a list"),
        (
            pd.DataFrame([[1, 2]], columns=["a", "a"]),
            "a body of type DataFrame cannot be sent: it has several columns of",
        ),
        (
            pa.table([[1, 2], [3, 4]], names=["a", "a"]),
            "a body of type Table cannot be sent: it has several columns of one name",
        ),
    ],
)
@pytest.mark.parametrize("way", WAYS)
def test_what_cannot_be_copied_or_recorded_is_refused_at_sending(way, body, told):
    network = Network(Clock(), nx.complete_graph(3), trace=Trace())
    with pytest.raises(ValueError) as refusal:
        WAYS[way](network, body)
    assert str(refusal.value).startswith(told)


class CopiesItself:
    """Says how it is copied; each of the functions below is such a rule."""

    def __init__(self):
        self.numbers, self.sent_as = [1], 1

    def remembers(self, memo):
        return self

    def shares(self, memo):
        copied = type(self)()
        copied.numbers = self.numbers
        return copied

    def becomes(self, memo):
        return self.numbers

    def counts(self, memo):
        copied = type(self)()
        copied.sent_as = self.sent_as + 1
        return copied

    def forgets(self, memo):
        copied = type(self)()
        copied.numbers = [5]
        return copied


class Stamped:
    """Passes on what it lacks from its value, which knows how it is copied."""

    def __init__(self, value):
        self.value, self.stamp = value, 3

    def __getattr__(self, name):
        return getattr(self.value, name)


@pytest.mark.parametrize("around", [lambda body: body, lambda body: [body], lambda body: {"a": (body,)}])
@pytest.mark.parametrize(
    ("rule", "told"),
    [
        (CopiesItself.remembers, "its copies would share a list"),
        (CopiesItself.shares, "its copies would share a list"),
        (CopiesItself.becomes, "its copy is of another class, list"),
        (CopiesItself.counts, "its copy has 2 where it has 1"),
        (CopiesItself.forgets, "its copy has 5 where it has 1"),
    ],
)
def test_a_body_that_its_class_does_not_copy_is_refused(rule, told, around):
    """It would arrive with other content than it was sent with, or with what its sender changes later."""
    body = around(type("Own", (CopiesItself,), {"__deepcopy__": rule})())
    with pytest.raises(ValueError, match=f"cannot be sent: .*{told}"):
        as_sent(body)


@pytest.mark.parametrize(
    ("kind", "sent", "other"), [(int, 5, 0), (float, 0.5, 0.0), (str, "a", "b"), (bytearray, b"a", b"b")]
)
def test_a_number_or_text_that_is_copied_as_another_one_is_refused(kind, sent, other):
    own = type("Own", (kind,), {})
    assert as_sent(own(sent)) == kind(sent)
    own.__deepcopy__ = lambda _, __: own(other)
    with pytest.raises(ValueError, match=r"cannot be sent: its copy has .* where it has"):
        as_sent(own(sent))


@pytest.mark.parametrize("value", [np.arange(3), pd.Series([1, 2]), Links()], ids=lambda value: type(value).__name__)
def test_a_wrapper_whose_copy_would_be_what_it_wraps_is_refused(value):
    with pytest.raises(ValueError, match=f"another class, {type(value).__name__}: its __getattr__ should pass on no"):
        as_sent(Stamped(value))


def test_a_wrapper_that_looks_for_itself_is_refused_and_one_that_does_not_is_copied():
    with pytest.raises(ValueError, match="its __getattr__ should pass on no names that begin with __"):
        as_sent(Stamped((1, 2)))

    class Copied(Stamped):
        def __getattr__(self, name):
            if name.startswith("__"):
                raise AttributeError(name)
            return super().__getattr__(name)

    copied = as_sent(Copied(np.arange(3)))
    assert (type(copied), copied.stamp, copied.sum()) == (Copied, 3, 3)


def test_the_content_of_a_body_does_not_depend_on_who_has_looked_at_it():
    """Nor does its size: networkx, and a `cached_property`, keep what was read in the object itself."""
    for create, look in (
        (partial(nx.path_graph, 3), lambda graph: (list(graph.nodes), list(graph.edges), graph.degree(1))),
        (partial(Computed, 1, 2), lambda body: body.total),
        (partial(Mean, [1, 2]), lambda body: body.mean),
    ):
        fresh, seen = create(), create()
        look(seen)
        assert in_json_types(seen) == in_json_types(fresh) == in_json_types(as_sent(seen))
        assert size_of(seen) == size_of(fresh)


def test_missing_numbers_are_null_and_as_long_as_numbers():
    for body in ([pd.NA], [np.ma.masked], (pd.NA,), np.array([pd.NA], object)):
        assert in_json_types(as_sent(body)) == [None]
        assert size_of(body) == HEADER + 8
    assert as_sent(np.ma.masked) is np.ma.masked


def test_a_class_may_have_no_module():
    body = type("Bare", (), {"__module__": None})()
    assert type(as_sent(body)) is type(body)


def test_objects_with_hidden_state_differ_in_their_content():
    """Also those whose attributes say nothing, such as generators of random numbers, patterns and types of arrays."""
    for one, other in (
        (np.random.default_rng(1), np.random.default_rng(2)),
        (np.random.PCG64(1), np.random.PCG64(2)),
        (re.compile("a"), re.compile("b")),
        (np.dtype("f4"), np.dtype("f8")),
        (ZoneInfo("UTC"), ZoneInfo("Europe/Rome")),
        (np.sin, np.cos),
    ):
        as_sent([one])
        assert in_json_types(one) != in_json_types(other)
        assert differs(one, other)


def test_a_body_without_size_needs_one():
    network = Network(Clock(), nx.complete_graph(3), trace=Trace())
    for send in (partial(network.send, 0, 1), partial(network.publish, 0)):
        with pytest.raises(ValueError, match="an object of type function has no size: send it with size="):
            send(generator)
        send(generator, size=np.int64(40))
    network.send(0, 1, generator, size=np.int16(40), transport=Reliable())


def test_a_content_is_nested_at_most_100_levels_deep():
    assert in_json_types(nested(1, MAX_DEPTH)) == nested_list(MAX_DEPTH)
    for body in (nested(1, MAX_DEPTH + 1), cyclic(), Cell()):
        with pytest.raises(ValueError, match="nested more than 100 levels deep, or contains itself"):
            in_json_types(body)


def nested_list(depth):
    return [nested_list(depth - 1)] if depth else 1


@pytest.mark.parametrize("body", [cyclic(), nested(1, 5000)])
def test_a_body_that_contains_itself_has_no_size(body):
    with pytest.raises(ValueError, match="has no size: it is nested too deeply, or contains itself"):
        size_of(body)


def test_the_nodes_and_the_size_of_a_message_may_be_numbers_of_numpy():
    trace = Trace()
    network = Network(Clock(), nx.complete_graph(3), trace=trace)
    network.send(np.int64(0), np.int64(1), "x", size=np.int64(40))
    network.publish(np.int8(0), "x", np.uint8(24))
    for event, expected in zip(trace, (40, 24), strict=True):
        assert (type(event.src), type(event.size), event.size) == (int, int, expected)
        json.loads(line_of(event))
    assert type(trace.events[0].dst) is int
    for node in (1.0, True, "1", np.float64(1)):
        with pytest.raises(ValueError, match="a node should be an integer"):
            network.send(0, node, "x")


def test_an_integer_with_thousands_of_digits_is_recorded_in_hexadecimal_digits():
    assert json.loads(body_json([16**5000])) == ["0x1" + "0" * 5000]


def test_a_function_is_sent_as_it_is():
    def counting():
        return counting

    assert is_immutable(counting)
    assert as_sent(counting) is counting


SETS = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 5) | st.floats() | st.text(max_size=2) | st.binary(max_size=1),
    lambda inner: st.frozensets(inner, max_size=3) | st.tuples(inner, inner),
    max_leaves=6,
)


@pytest.mark.slow
@given(st.lists(SETS, max_size=6), st.randoms())
def test_a_set_is_recorded_in_one_order(items, random):
    """Whatever the order in which it was filled; equal numbers of several types are one item."""
    items = list({repr(each): each for each in set(items)}.values())
    shuffled = list(items)
    random.shuffle(shuffled)
    assert body_json(set(items)) == body_json(set(shuffled)) == body_json(frozenset(shuffled))


@each_body
def test_a_recorded_body_is_read_again(name):
    """The text stays the same: a list and a tuple are one, and fields are again fields."""
    event = Sent(0, 0, 0, 1, 5, 0, 24, BODIES[name][0])
    (again,) = events_of([line_of(event)], (Sent,))
    assert line_of(again) == line_of(event)


WRITTEN = """
import desim.kernel.network
from desim.kernel.core.trace_file import body_json
from tests.message_bodies import BODIES
for name, (body, *_) in BODIES.items():
    print(name, body_json(body), body_json({frozenset({"a", "b", 1, (2, "c")}): {"uav1", "uav2", "uav3"}}))
"""


@pytest.mark.whole
def test_bodies_are_recorded_alike_under_every_hash_seed_and_print_option():
    """In this process, whose hash seed is another one in each run of the tests, and in a process with a fixed one."""
    environment = {"PYTHONHASHSEED": "1", "PYTHONPATH": "."}
    program = [sys.executable, "-c", WRITTEN]
    other = subprocess.run(program, env=environment, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    with np.printoptions(precision=3, threshold=3), redirect_stdout(StringIO()) as one:
        exec(WRITTEN, {})
    assert one.getvalue() == other
    assert " at 0x" not in other
    assert other.count("\n") == len(BODIES)


def test_an_attribute_in_a_slot_beside_the_fields_counts():
    """Objects without attributes beside their fields are told by these, which is faster."""

    class Noted:
        __slots__ = ("note",)

    @dataclass
    class Body(Noted):
        a: float

    body = Body(1.0)
    assert content_fields(body) == {"a": 1.0}
    body.note = 2.0
    assert content_fields(body) == {"a": 1.0, "note": 2.0}

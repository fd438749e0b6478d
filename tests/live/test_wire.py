"""Datagrams have the bytes that are counted, say what was sent, and cannot stop a node."""

import contextlib
import struct
from dataclasses import dataclass, field
from functools import cached_property, partial, reduce
from inspect import getmembers, isclass
from math import inf, nan
from random import Random
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.kernel.clock_sync import SIZE, TimeAnswer, TimeRequest
from desim.kernel.core.message_size import size_of
from desim.kernel.core.records import Record
from desim.kernel.state.inbox import Message
from desim.kernel.transport.frames import SKIP_SIZE, Acknowledgement, CodedPiece, Segment, Skip, acknowledgement_size
from desim.kernel.transport.layer import PORT as FRAMES
from desim.live import wire as wire_module
from desim.live.layouts import WireError, _form_of
from desim.live.own_bodies import OwnBodies
from desim.live.wire import ADMITTED, ANNOUNCED, BODIES, PORTS, Kind, Wire, datagram_number
from desim.pursuit.team import announcements
from desim.pursuit.team.announcements import Assignment, Forwarded, LocatedAssignment, MovingAssignment, TimedAssignment
from desim.pursuit.team.judges import Accusation
from protocols.cbaa import Claim
from protocols.cbba import StampedClaim
from protocols.dissemination import PORT as ANNOUNCEMENTS
from protocols.schedules import mutex, token_messages
from protocols.schedules.mutex import Deferred, Reply, Request
from protocols.schedules.token_messages import Token, TokenNotice, TokenReceipt
from protocols.server import PORT as SERVER
from protocols.server import TeamOrder

NODES, EVADERS = 5, 2


def record(body, src=1):
    return Record(src, 3, 77, body)


EXAMPLES = [
    Assignment(2),
    TimedAssignment(0, inf),
    LocatedAssignment(1, 2.0, 3.0, 1.5),
    MovingAssignment(1, 2.0, 3.0, 1.0, 0.0, 0.1),
    Claim(1, (0, -1), (-2.0, -inf)),
    StampedClaim(1, (1, -1), (-3.0, -inf), (0.0, 1.0, 2.0, -inf, 4.0)),
    Forwarded((record(Assignment(1)), record(StampedClaim(0, (-1, -1), (-inf, -inf), (0.0,) * 5), 2)), 3),
    Token((1, 2, 0.5), 4, (1, 2, 3, 4, 5), (2, 4), (record(Assignment(1)), record(Assignment(0), 2))),
    Token((1, 2, 0.5), 4, (1, 2, 3, 4, 5), (), ()),
    TokenReceipt((1, 2, 0.5), 3),
    TokenNotice((1, -1, 0.5), 3, asks=True),
    Request((1, 2)),
    Reply((1, 2), (record(Assignment(1)),)),
    Deferred((3, 4)),
    TeamOrder(12, (None, 3)),
    Accusation((1, 2)),
]
"""A body of each class with a layout, but those of clock synchronisation."""


@pytest.fixture
def wire():
    return Wire(NODES, EVADERS, OwnBodies(None))


def port_of(body):
    return next((PORTS[k] for k in range(1, len(PORTS)) if type(body) in ADMITTED[k]), "")


@pytest.mark.parametrize("body", EXAMPLES, ids=lambda body: type(body).__name__)
@pytest.mark.parametrize("to_one", [True, False])
def test_a_message_has_the_bytes_that_are_counted_and_arrives_as_it_was_sent(wire, body, to_one):
    message, port = Message(4, 123_456, body), port_of(body)
    datagram = wire.encode(message, port, size_of(body), to_one=to_one)
    assert len(datagram) == size_of(body)
    parcel = wire.decode(datagram)
    assert parcel.content == message
    assert type(parcel.content.body) is type(body)
    assert (parcel.src, parcel.to_one) == (4, to_one)
    assert parcel.port is port
    if type(body) in ANNOUNCED:
        datagram = wire.encode(record(body), "", size_of(body), to_one=False)
        assert len(datagram) == size_of(body)
        assert wire.decode(datagram).content == record(body)


def at_port(datagram, kind, port_number):
    """Return a datagram with another kind, and as if it was sent to another port."""
    (word,) = struct.unpack_from("!I", datagram)
    word = word & ~(0x1F << 17 | 7 << 13) | port_number << 17 | kind << 13
    return struct.pack("!I", word) + datagram[4:]


@pytest.mark.parametrize("body", EXAMPLES, ids=lambda body: type(body).__name__)
def test_a_body_arrives_at_the_ports_that_admit_it_and_as_a_record_if_it_is_announced(wire, body):
    datagram = wire.encode(Message(4, 123_456, body), port_of(body), size_of(body), to_one=True)
    for port_number, admitted in enumerate(ADMITTED):
        sent = at_port(datagram, Kind.MESSAGE, port_number)
        if type(body) in admitted:
            assert wire.decode(sent).content.body == body
        else:
            with pytest.raises(WireError, match="a body at a wrong port"):
                wire.decode(sent)
    sent = at_port(datagram, Kind.RECORD, 0)
    if type(body) in ANNOUNCED:
        assert wire.decode(sent).content.body == body
    else:
        with pytest.raises(WireError, match="a body at a wrong port"):
            wire.decode(sent)


def test_every_body_of_desim_that_is_sent_has_a_layout():
    examples = {type(body) for body in EXAMPLES} | {TimeRequest, TimeAnswer}
    assert examples == set(BODIES)
    payloads = set(announcements.PAYLOADS.values())
    modules = (token_messages, mutex)
    sent = {kind for module in modules for _, kind in getmembers(module, isclass) if hasattr(kind, "_fields")}
    assert payloads | sent - {Record} <= set(BODIES)


@pytest.mark.slow
@given(
    st.integers(0, EVADERS),
    st.floats(allow_nan=False),
    st.integers(0, NODES - 1),
    st.integers(1, 2**32 - 1),
    st.integers(-(2**62), 2**62),
)
def test_any_announcement_arrives_as_it_was_sent(active, phi, src, seq, stamp):
    wire = Wire(NODES, EVADERS, OwnBodies(None))
    sent = Record(src, seq, stamp, TimedAssignment(active, phi))
    assert wire.decode(wire.encode(sent, "", 32, to_one=False)).content == sent


def test_a_body_with_nan_is_malformed_where_it_arrives():
    wire = Wire(NODES, EVADERS, OwnBodies(None))
    datagram = wire.encode(Record(0, 1, 0, TimedAssignment(1, nan)), "", 32, to_one=False)
    with pytest.raises(WireError, match="not a number"):
        wire.decode(datagram)


FRAME_EXAMPLES = [
    (Segment(ANNOUNCEMENTS, False, 0, 9, 3, 7, Forwarded((record(Assignment(1)),), 2)), None),
    (Segment(token_messages.PORT, False, 0, 9, 3, 7, TokenReceipt((1, 2, 0.5), 3)), None),
    (Segment(ANNOUNCEMENTS, True, 0, 3, 3, 1, Forwarded((Record(4, 3, 77, Assignment(1)),))), 24 + 8),
    (CodedPiece(ANNOUNCEMENTS, True, 0, 3, 2, Forwarded((Record(4, 3, 77, Assignment(1)),))), 24 + 8),
    (Skip(SERVER, True, 0, 12), SKIP_SIZE),
    (Acknowledgement(ANNOUNCEMENTS, True, 0, 12, ()), acknowledgement_size(1)),
    (Acknowledgement(ANNOUNCEMENTS, False, 0, 12, (14, 15, 75)), acknowledgement_size(64)),
]


@pytest.mark.parametrize(("frame", "size"), FRAME_EXAMPLES, ids=lambda frame: type(frame).__name__)
def test_a_frame_of_a_transport_has_the_bytes_that_are_counted(wire, frame, size):
    size = size or size_of(frame.body) + 8
    message = Message(4, 77, frame)
    datagram = wire.encode(message, FRAMES, size, to_one=not frame.to_all)
    assert len(datagram) == size
    parcel = wire.decode(datagram)
    assert parcel.content == message
    assert parcel.port is FRAMES


def test_two_attempts_are_two_datagrams(wire):
    segments = [Segment(ANNOUNCEMENTS, True, 0, 3, 3, k, Forwarded((Record(4, 3, 77, Assignment(1)),))) for k in (1, 2)]
    first, second = (wire.encode(Message(4, 77, segment), FRAMES, 32, to_one=False) for segment in segments)
    assert wire.decode(first).number != wire.decode(second).number


def test_an_attempt_is_not_that_of_256_attempts_before(wire):
    segments = [
        Segment(ANNOUNCEMENTS, True, 0, 3, 3, k, Forwarded((Record(4, 3, 77, Assignment(1)),))) for k in (1, 257)
    ]
    datagrams = [
        wire.encode(Message(4, 77, segment), FRAMES, 32, to_one=False, now=77 + 10**9 * k)
        for k, segment in enumerate(segments)
    ]
    assert datagrams[0][:8] == datagrams[1][:8]
    assert len(set(map(datagram_number, datagrams))) == 2
    assert [wire.decode(datagram).number for datagram in datagrams] == [*map(datagram_number, datagrams)]


@pytest.mark.parametrize(("frame", "size"), FRAME_EXAMPLES, ids=lambda frame: type(frame).__name__)
def test_a_frame_says_when_it_was_transmitted_and_not_only_when_its_message_was_sent(wire, frame, size):
    message, later = Message(4, 77, frame), 300_000_500
    datagram = wire.encode(message, FRAMES, size or size_of(frame.body) + 8, to_one=not frame.to_all, now=later)
    parcel = wire.decode(datagram)
    assert parcel.content == message
    assert 0 <= parcel.start - later < 1000  # never before it was transmitted
    after = {"size": len(datagram), "to_one": not frame.to_all, "now": later + wire_module.CYCLE}
    again = wire.decode(wire.encode(message, FRAMES, **after))  # 71 min later, the time counts from 0 again
    assert (again.content, again.start) == (message, parcel.start)


def test_an_answer_about_the_time_carries_the_clock_at_its_transmission():
    asking, answering = (Wire(NODES, EVADERS, OwnBodies(None)) for _ in range(2))
    answering.answered[TimeAnswer(6, 99)] = 1234
    datagram = answering.encode(Message(0, 5, TimeAnswer(6, 99)), wire_module.CLOCKS, SIZE, to_one=True)
    assert len(datagram) == SIZE
    assert asking.decode(datagram).content.body == TimeAnswer(6, 99)
    assert asking.answered == {TimeAnswer(6, 99): 1234}
    request = asking.encode(Message(1, 5, TimeRequest(7)), wire_module.CLOCKS, SIZE, to_one=True)
    assert len(request) == SIZE
    assert answering.decode(request).content.body == TimeRequest(7)


# Bodies of users.


class Plan(NamedTuple):
    active: int
    route: tuple[tuple[float, float], ...]
    note: str | None = None


@dataclass(frozen=True)
class Load:
    kilograms: float
    parts: dict


def protocol(me):
    yield me.sleep(1.0)


@dataclass(kw_only=True)
class ByName:
    price: float
    rank: int = field(init=False, default=5)


@dataclass
class Doubling:
    """A class that would change its fields once more if a receiver called it."""

    price: float

    def __post_init__(self):
        self.price *= 2.0

    @cached_property
    def half(self):
        return self.price / 2.0


@dataclass(init=False, frozen=True, slots=True)
class OwnInit:
    low: int
    high: int

    def __init__(self, both):
        object.__setattr__(self, "low", both)
        object.__setattr__(self, "high", both)


class Tripling(NamedTuple("Tripling", [("price", float)])):
    def __new__(cls, price):
        return super().__new__(cls, price * 3.0)


def computed():
    body = Doubling(1.0)
    assert body.half == 1.0
    return body


class NamedWithMore(NamedTuple("Priced", [("price", float)])):
    """A named tuple whose objects may have attributes."""


NAMED_WITH_MORE = NamedWithMore(1.0)
NAMED_WITH_MORE.twice = 2.0


@dataclass
class WithMore:
    price: float

    def __post_init__(self):
        self.twice = 2.0 * self.price


@dataclass(init=False)
class Empty:
    price: float


OWN = [ByName(price=2.0), Doubling(3.0), computed(), OwnInit(4), Tripling(1.0)]
OWN += [Plan(1, ((1.0, 2.0),), "x"), Load(2.5, {"a": [1, None], 3: (True, 1j)}), {"x": 1}, 3, "text", (1, 2), None]


@pytest.mark.parametrize("body", OWN, ids=repr)
def test_a_body_of_a_user_arrives_as_it_was_sent(body):
    pytest.importorskip("msgspec")
    wire = Wire(NODES, EVADERS, OwnBodies(protocol))
    message = Message(2, 5, body)
    datagram = wire.encode(message, "plans", size_of(body), to_one=False)
    parcel = wire.decode(datagram)
    assert parcel.content == message
    assert type(parcel.content.body) is type(body)
    assert parcel.port == "plans"


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (WithMore(1.0), "WithMore cannot be sent live: it has the attribute twice, which is no field"),
        (NAMED_WITH_MORE, "NamedWithMore cannot be sent live: it has the attribute twice, which is no field"),
        (Empty(), "Empty cannot be sent live: its field price has no value"),
        (2**70, "int cannot be sent live: can't serialize ints"),
        ("a\ud800", "str cannot be sent live: 'utf-8' codec"),
        (reduce(lambda inner, _: [inner], range(3000), 1), "list cannot be sent live: it is nested too deeply"),
    ],
    ids=["attribute", "attribute of a named tuple", "no value", "large", "half of a character", "deep"],
)
def test_a_body_that_would_not_arrive_as_it_is_is_refused_when_it_is_sent(body, why):
    pytest.importorskip("msgspec")
    with pytest.raises(WireError, match=f"a body of type {why}"):
        OwnBodies(protocol).pack("", body)


@pytest.mark.parametrize(
    ("number", "plain"),
    [
        *[(np.float64(0.1), 0.1), (np.float32(0.5), 0.5), (np.int64(-3), -3), (np.uint8(7), 7), (np.True_, True)],
        *[(np.str_("a"), "a"), (np.array([0.5, 1.5])[1], 1.5), ([np.float64(0.5), {"a": np.int8(1)}], [0.5, {"a": 1}])],
    ],
)
def test_numbers_of_numpy_are_sent_as_those_of_python(number, plain):
    """A protocol that computes with numpy runs live as it runs simulated."""
    pytest.importorskip("msgspec")
    bodies = OwnBodies(None)
    port, body = bodies.unpack(bodies.pack("port", number))
    assert (port, body) == ("port", plain)
    assert type(body) is type(plain)


def test_the_classes_of_a_protocol_with_parameters_are_those_of_its_function():
    pytest.importorskip("msgspec")
    bodies = OwnBodies(partial(protocol, 1))
    assert bodies.unpack(bodies.pack("x", Plan(1, ()))) == ("x", Plan(1, ()))


THEIRS = """
from dataclasses import dataclass

@dataclass
class Bid:
    price: float

d = Alias = Bid

def talk(me):
    yield me.send(None, Bid(1.0))

class Talking:
    def __call__(self, me):
        yield me.send(None, Bid(1.0))

class Louder(Talking):
    pass
"""


@pytest.mark.parametrize("name", ["talk", "Louder"])
def test_the_classes_of_a_protocol_are_known_where_its_module_is_not_imported(name):
    """As in the process of a pursuer, to which the protocol is sent with the names that it uses, and no others."""
    pytest.importorskip("msgspec")
    here, there = ({"__name__": "theirs"}, {"__name__": "theirs"})
    for names in (here, there):
        exec(THEIRS, names)
    del there["Alias"], there["d"], there["dataclass"]
    protocols = [names[name] if name == "talk" else names[name]() for names in (here, there)]
    sender, receiver = (OwnBodies(theirs) for theirs in protocols)
    assert receiver.unpack(sender.pack("x", here["Bid"](2.0))) == ("x", there["Bid"](2.0))
    assert sender.unpack(receiver.pack("x", there["Bid"](2.0))) == ("x", here["Bid"](2.0))


NO_BODIES = {
    "a port that is no text": [1, 2],
    "one part": ["x"],
    "three parts": ["x", 1, 2],
    "no list": 7,
    "an empty list": ["x", []],
    "an unknown tag": ["x", ["z", 1]],
    "no class": ["x", ["o"]],
    "a class of another protocol": ["x", ["o", "Nothing", 1]],
    "a class that is no text": ["x", ["o", 1, 1]],
    "too many fields": ["x", ["o", "Load", 1.0, ["d"], 2]],
    "too few fields": ["x", ["o", "Plan", 1, ["t"]]],
    "a key without a value": ["x", ["d", [1]]],
    "a key that has no hash": ["x", ["d", [["l"], 1]]],
    "a complex number of texts": ["x", ["c", "1", "2"]],
}


@pytest.mark.parametrize("content", NO_BODIES.values(), ids=NO_BODIES)
def test_a_datagram_that_holds_no_body_is_malformed(content):
    msgpack = pytest.importorskip("msgspec").msgpack
    bodies = OwnBodies(protocol)
    right = msgpack.encode(["x", ["o", "Load", 1.0, ["d"]]])
    assert bodies.unpack(len(right).to_bytes(4, "big") + right + b"rest") == ("x", Load(1.0, {}))
    data = msgpack.encode(content)
    with pytest.raises(ValueError, match=r"."):
        bodies.unpack(len(data).to_bytes(4, "big") + data)


@pytest.mark.parametrize("depth", [500, 20_000])
def test_a_datagram_that_nests_without_end_is_malformed(depth):
    pytest.importorskip("msgspec")
    data = b"\x92\xa1x" + b"\x92\xa1l" * depth + b"\xc0"
    with pytest.raises(ValueError, match="recursion depth"):
        OwnBodies(None).unpack(len(data).to_bytes(4, "big") + data)


def test_a_body_of_an_unknown_class_is_refused_when_it_is_sent():
    pytest.importorskip("msgspec")
    wire = Wire(NODES, EVADERS, OwnBodies(protocol))
    with pytest.raises(WireError, match=r"of type Random cannot be sent live: send numbers, texts"):
        wire.encode(Message(2, 5, Random(3)), "", 100, to_one=False)


def test_a_body_that_is_larger_than_a_datagram_is_refused():
    pytest.importorskip("msgspec")
    wire = Wire(NODES, EVADERS, OwnBodies(protocol))
    with pytest.raises(WireError, match=r"str has 70,\d+ bytes; a datagram has at most 65507"):
        wire.encode(Message(2, 5, "x" * 70_000), "", 100, to_one=False)


def test_without_msgspec_a_body_of_a_user_names_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "msgspec", None)
    wire = Wire(NODES, EVADERS, OwnBodies(protocol))
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'pursuit-desim\[live\]'"):
        wire.encode(Message(2, 5, Plan(1, ())), "", 100, to_one=False)


# Malformed datagrams.


def flipped(rng, datagram):
    octets = bytearray(datagram)
    for _ in range(rng.randint(1, 3)):
        octets[rng.randrange(len(octets))] = rng.randrange(256)
    return bytes(octets[: rng.randint(0, len(octets))] if rng.random() < 0.3 else octets)


def test_whatever_bytes_arrive_they_are_read_or_malformed(wire):
    rng = Random(7)
    datagrams = [wire.encode(Message(4, 5, body), port_of(body), size_of(body), to_one=True) for body in EXAMPLES]
    for _ in range(4000):
        octets = rng.randbytes(rng.choice([0, 3, 16, 24, 32, 48, 64, 200])) if rng.random() < 0.3 else b""
        with contextlib.suppress(WireError):
            wire.decode(octets or flipped(rng, rng.choice(datagrams)))


@pytest.mark.parametrize(
    "change",
    [
        lambda octets: octets[:-1],
        lambda octets: octets + b"\0",
        lambda octets: b"\0" + octets[1:],  # without the mark
        lambda octets: octets[:16] + (3).to_bytes(8, "big"),  # an evader that does not exist
        lambda octets: bytes([octets[0] | 0x7F]) + octets[1:],  # a node that does not exist
        lambda octets: octets[:8] + ((1 << 62) + 1).to_bytes(8, "big") + octets[16:],  # a time of no clock
    ],
)
def test_a_wrong_datagram_is_malformed(wire, change):
    octets = wire.encode(record(Assignment(1)), "", 24, to_one=False)
    wire.decode(octets)
    with pytest.raises(WireError):
        wire.decode(change(octets))


def test_more_nodes_than_a_header_can_name_are_refused():
    with pytest.raises(WireError, match=r"at most 512 nodes can run live \(got 513\)"):
        Wire(513, 1, OwnBodies(None))


@pytest.mark.parametrize("body", [Assignment(2**70), Request((2**64, 1)), Request((0.5, 1))], ids=repr)
def test_a_number_that_its_layout_cannot_hold_is_refused_when_it_is_sent(wire, body):
    with pytest.raises(WireError, match=f"{type(body).__name__} .* cannot be sent: "):
        wire.encode(Message(4, 123_456, body), port_of(body), size_of(body), to_one=True)


FORWARDED = Forwarded((record(Assignment(1)),), 3)
UNSENT = {
    "a node without its memory": (
        Message(4, 77, Segment(ANNOUNCEMENTS, True, 1, 3, 3, 1, Assignment(1))),
        FRAMES,
        32,
        "a node that has lost its memory cannot number its messages anew live",
    ),
    "too few bytes": (record(Assignment(1)), "", 23, "Assignment counts 23 bytes, and has 24"),
    "too many bytes": (record(Assignment(1)), "", 25, "Assignment counts 25 bytes, and has 24"),
    **{
        f"a record of another {what}": (
            Message(4, 77, Segment(ANNOUNCEMENTS, True, 0, 3, 3, 1, Forwarded((other,)))),
            FRAMES,
            32,
            "a record whose number or time is not that of its message cannot be sent live",
        )
        for what, other in {
            "source": Record(3, 3, 77, Assignment(1)),
            "number": Record(4, 2, 77, Assignment(1)),
            "time": Record(4, 3, 78, Assignment(1)),
        }.items()
    },
}


@pytest.mark.parametrize(("content", "port", "size", "why"), UNSENT.values(), ids=UNSENT)
def test_what_cannot_be_a_datagram_is_refused_with_a_reason(wire, content, port, size, why):
    with pytest.raises(WireError, match=f"^{why}$"):
        wire.encode(content, port, size, to_one=False)


WRONG_RECORDS = {
    "of a node that does not exist": lambda head: bytes([head[0] | 0x7F, head[1] | 0xC0]) + head[2:],
    "without a body": lambda head: head[:2] + bytes([head[2] & ~0x1F | 0x1F]) + head[3:],
    "of records": lambda head: head[:2] + bytes([head[2] & ~0x1F | BODIES.index(Forwarded)]) + head[3:],
}


@pytest.mark.parametrize("change", WRONG_RECORDS.values(), ids=WRONG_RECORDS)
def test_a_wrong_record_within_a_datagram_is_malformed(wire, change):
    datagram = wire.encode(Message(4, 77, FORWARDED), ANNOUNCEMENTS, size_of(FORWARDED), to_one=False)
    begin = len(datagram) - 24
    assert wire.decode(datagram).content.body == FORWARDED
    with pytest.raises(WireError, match=r"(not a record|a record within a record)$"):
        wire.decode(datagram[:begin] + change(datagram[begin:]))


def test_an_announcement_of_a_class_of_a_user_arrives_as_a_record():
    pytest.importorskip("msgspec")
    wire = Wire(NODES, EVADERS, OwnBodies(protocol))
    sent = record(Plan(1, ((0.5, 1.0),), "x"))
    parcel = wire.decode(wire.encode(sent, "", 60, to_one=False))
    assert (parcel.content, parcel.src, parcel.port) == (sent, 1, "")


def test_the_oldest_answers_about_the_time_are_forgotten(monkeypatch):
    monkeypatch.setattr(wire_module, "MAX_ANSWERED", 2)
    asking, answering = (Wire(NODES, EVADERS, OwnBodies(None)) for _ in range(2))
    for number in (6, 7, 8):
        answering.answered[TimeAnswer(number, 9)] = 100 + number
        asking.decode(answering.encode(Message(0, 5, TimeAnswer(number, 9)), wire_module.CLOCKS, SIZE, to_one=True))
    assert asking.answered == {TimeAnswer(7, 9): 107, TimeAnswer(8, 9): 108}


def test_without_msgspec_a_body_of_a_user_is_malformed_where_it_arrives(monkeypatch):
    pytest.importorskip("msgspec")
    data = OwnBodies(protocol).pack("x", Plan(1, ()))
    monkeypatch.setitem(__import__("sys").modules, "msgspec", None)
    with pytest.raises(ValueError, match=r"^a body of a user, without msgspec$"):
        OwnBodies(protocol).unpack(data)


@pytest.mark.parametrize("hint", [complex, list[int], dict[str, int], tuple])
def test_a_field_without_a_form_has_no_layout(hint):
    with pytest.raises(TypeError, match=r"^no layout for "):
        _form_of(hint, None)

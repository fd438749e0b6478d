"""Datagrams: messages as the bytes that `desim.kernel.core.message_size` counts, no more and no fewer.

    4  sender: a set bit, then the node (9 bits), the port (5), the kind (4), the body (5) and the attempt (8)
    4  sequence number
    8  time, ns
    8  session and base of a segment, session and expected number of an acknowledgement (4 bytes each), else nothing
    n  the body: 8 bytes a number, in the order of its fields; the lists whose length varies come last

All numbers are big-endian. Integers have a sign, and booleans are 0 or 1. A record inside a body has a header of its
own, which begins with a set bit, and so cannot be taken for a number of the list before it. An item of a list that may
be missing has its place in the upper 16 bits of its number. The kind tells a record from a message, a broadcast from a
message to one node, and the frames of a transport; see `Kind`.

Bodies of users have no such layout (`desim.live.own_bodies`). Nothing of a datagram is executed: it names an entry of
the tables below, or is malformed.
"""

from collections.abc import Container, Iterator
from enum import IntEnum
from itertools import count
from struct import Struct, error
from typing import Any, NamedTuple

from desim.kernel.clock_sync import PORT as CLOCKS
from desim.kernel.clock_sync import TimeAnswer, TimeRequest
from desim.kernel.core.message_size import HEADER, NUMBER
from desim.kernel.core.records import Record
from desim.kernel.state.inbox import Message
from desim.kernel.transport.frames import Acknowledgement, CodedPiece, Segment, Skip
from desim.kernel.transport.layer import PORT as FRAMES_PORT
from desim.live.layouts import MAX_COUNT, Layout, WireError
from desim.live.own_bodies import OwnBodies
from desim.pursuit.team.announcements import (
    Assignment,
    Forwarded,
    LocatedAssignment,
    MovingAssignment,
    TimedAssignment,
)
from desim.pursuit.team.trust import PORT as ACCUSATIONS
from desim.pursuit.team.trust import Accusation
from protocols.cbaa import Claim
from protocols.cbba import StampedClaim
from protocols.dissemination import PORT as ANNOUNCEMENTS
from protocols.schedules.mutex import PORT as MUTEX
from protocols.schedules.mutex import Deferred, Reply, Request
from protocols.schedules.token_messages import PORT as TOKENS
from protocols.schedules.token_messages import Token, TokenNotice, TokenReceipt
from protocols.server import PORT as SERVER
from protocols.server import TeamOrder

BODIES: tuple[type[Any], ...] = (
    *(Assignment, TimedAssignment, LocatedAssignment, MovingAssignment, Claim, StampedClaim, Forwarded),
    *(Token, TokenReceipt, TokenNotice, Request, Reply, Deferred),
    *(TeamOrder, Accusation, TimeRequest, TimeAnswer),
)
"""The bodies with a layout, by their numbers in a header."""
NOTHING, OWN = 30, 31
"""The numbers of None, and of a body of a user."""
PORTS = ("", ANNOUNCEMENTS, TOKENS, MUTEX, SERVER, ACCUSATIONS, CLOCKS)
"""The ports, by their numbers in a header."""
ADMITTED: tuple[Container[type[Any]], ...] = (
    BODIES,
    {Forwarded},
    {Token, TokenReceipt, TokenNotice},
    {Request, Reply, Deferred},
    {TeamOrder, Forwarded},
    {Accusation},
    {TimeRequest, TimeAnswer},
)
"""The bodies that are sent at each port."""
ANNOUNCED = {Assignment, TimedAssignment, LocatedAssignment, MovingAssignment, Claim, StampedClaim}
"""The bodies of records."""
MAX_NODES = 1 << 9
MARK = 1 << 31
"""The set bit with which a header begins."""
MAX_INTEGER = 1 << 62
_HEADER, _PAIR = Struct(">IIq"), Struct(">II")


class Kind(IntEnum):
    """The kind of a datagram."""

    RECORD = 0
    TO_ALL = 1
    TO_ONE = 2
    SEGMENT_TO_ALL = 3
    SEGMENT_TO_ONE = 4
    SEGMENT_OF_RECORD = 5
    """A segment whose body is one record of its sender, with the header of the segment for its own."""
    SKIP_TO_ALL = 6
    SKIP_TO_ONE = 7
    ACKNOWLEDGEMENT_TO_ALL = 8
    """Of a segment to all."""
    ACKNOWLEDGEMENT_TO_ONE = 9
    PIECE_TO_ALL = 10
    PIECE_TO_ONE = 11
    PIECE_OF_RECORD = 12


FRAMES = frozenset(Kind) - {Kind.RECORD, Kind.TO_ALL, Kind.TO_ONE}
OF_SEGMENT = {Kind.SEGMENT_TO_ALL, Kind.SEGMENT_TO_ONE, Kind.SEGMENT_OF_RECORD}
OF_PIECE = {Kind.PIECE_TO_ALL, Kind.PIECE_TO_ONE, Kind.PIECE_OF_RECORD}
OF_RECORD = {Kind.SEGMENT_OF_RECORD, Kind.PIECE_OF_RECORD}
ONE = {Kind.TO_ONE, Kind.SEGMENT_TO_ONE, Kind.SKIP_TO_ONE, Kind.ACKNOWLEDGEMENT_TO_ONE, Kind.PIECE_TO_ONE}


class Parcel(NamedTuple):
    """What a datagram carries."""

    number: int
    """The first eight bytes: unique for the sender, its receiver and the run."""
    src: int
    content: Record | Message
    port: str
    to_one: bool


class Wire:
    """The datagrams of one game.

    Args:
        nodes: number of nodes, N.
        evaders: number of evaders, M.
        bodies: the bodies of users.

    Raises:
        WireError: if there are more nodes than a header can tell apart.
    """

    def __init__(self, nodes: int, evaders: int, bodies: OwnBodies):
        if nodes > MAX_NODES:
            raise WireError(f"at most {MAX_NODES} nodes can run live (got {nodes})")
        self._nodes, self._own = nodes, bodies
        limits = {"active": (0, evaders), "winners": (-1, nodes - 1), "hop": (0, MAX_COUNT), "hops": (1, MAX_COUNT)}
        limits |= dict.fromkeys(("absent", "accused", "chasers"), (0, nodes - 1))
        lengths = {"winners": evaders, "amounts": evaders, "chasers": evaders, "stamps": nodes, "visits": nodes}
        self._layouts = [Layout(body, lengths, limits, nodes) for body in BODIES]
        self._number_of = {body: number for number, body in enumerate(BODIES)}
        self._sent = count(1)
        self.answered: dict[int, int] = {}
        """t3 of the answers of clock synchronisation, ns, by number; see `desim.kernel.clock_sync.Synchroniser`."""

    def encode(self, content: Record | Message, port: str, size: int, *, to_one: bool) -> bytes:
        """Return the datagram of a record or a message, which has `size` bytes.

        Only the datagram of a body of a user has another number of bytes.

        Raises:
            WireError: if its body has no layout, or not the layout that was counted.
        """
        src, body = content.src, content.body
        if isinstance(content, Record):
            return self._pack(src, Kind.RECORD, 0, content.seq, content.stamp, b"", body, "", size)
        stamp = content.stamp
        if port is not FRAMES_PORT:
            kind = Kind.TO_ONE if to_one else Kind.TO_ALL
            return self._pack(src, kind, 0, next(self._sent), stamp, b"", body, port, size)
        to_all = int(not body.to_all)  # the kinds of one frame follow each other
        if isinstance(body, Segment):
            head = _PAIR.pack(_session(body.session), body.base)
            return self._carry(Kind.SEGMENT_TO_ALL + to_all, content, body, body.attempt, head, size)
        if isinstance(body, CodedPiece):
            head = _PAIR.pack(_session(body.session), body.part)
            return self._carry(Kind.PIECE_TO_ALL + to_all, content, body, body.part, head, size)
        if isinstance(body, Skip):
            head = _PAIR.pack(_session(body.session), body.base)
            kind = Kind(Kind.SKIP_TO_ALL + to_all)
            return self._pack(src, kind, 0, next(self._sent), stamp, head, None, body.port, size)
        head = _PAIR.pack(_session(body.session), body.expected) + _bits(body, size - HEADER - NUMBER)
        kind = Kind(Kind.ACKNOWLEDGEMENT_TO_ALL + to_all)
        return self._pack(src, kind, 0, next(self._sent), stamp, head, None, body.port, size)

    def _carry(
        self, kind: int, content: Message, frame: Segment | CodedPiece, attempt: int, head: bytes, size: int
    ) -> bytes:
        """Return the datagram of a frame with a body."""
        body = frame.body
        if isinstance(body, Forwarded) and len(body.records) == 1:
            (record,) = body.records
            packed = self._body_of(record.body)
            if packed is not None and HEADER + len(head) + len(packed[1]) == size:
                if (record.src, record.seq, record.stamp) != (content.src, frame.seq, content.stamp):
                    raise WireError("a record whose number or time is not that of its message cannot be sent live")
                kind, body = (Kind.SEGMENT_OF_RECORD if kind < Kind.PIECE_TO_ALL else Kind.PIECE_OF_RECORD), record.body
        return self._pack(content.src, Kind(kind), attempt, frame.seq, content.stamp, head, body, frame.port, size)

    def _pack(
        self, src: int, kind: Kind, attempt: int, seq: int, stamp: int, head: bytes, body: Any, port: str, size: int
    ) -> bytes:
        place = next((k for k, other in enumerate(PORTS) if other is port or (not k and port == "")), None)
        packed = None if place is None else self._body_of(body)
        if packed is not None and packed[0] != NOTHING:
            admitted = ANNOUNCED if kind is Kind.RECORD or kind in OF_RECORD else ADMITTED[place or 0]
            packed = packed if type(body) in admitted else None
        if packed is None:
            number, data = OWN, self._own.pack(port, body)
            size = max(size, HEADER + len(head) + len(data))
        else:
            number, data = packed
        word = MARK | src << 22 | (place or 0) << 17 | kind << 13 | number << 8 | attempt & 0xFF
        datagram = _HEADER.pack(word, seq, stamp) + head + data
        if len(datagram) > size or (len(datagram) < size and number != OWN):
            raise WireError(f"{type(body).__name__} counts {size} bytes, and has {len(datagram)}")
        return datagram.ljust(size, b"\0")

    def _body_of(self, body: Any) -> tuple[int, bytes] | None:
        """Return the number and the bytes of a body; None if it has no layout."""
        if body is None:
            return NOTHING, b""
        number = self._number_of.get(type(body))
        if number is None:
            return None
        numbers, records = self._layouts[number].flat(body)
        if isinstance(body, TimeRequest | TimeAnswer):
            numbers += [0] * (2 - len(numbers)) + [self.answered.get(body.number, 0)]
        data = self._layouts[number].pack(numbers)
        for record in records:
            inner = self._body_of(record.body)
            if inner is None:
                return None
            data += _HEADER.pack(MARK | record.src << 22 | inner[0] << 8, record.seq, record.stamp) + inner[1]
        return number, data

    # Reading.

    def decode(self, datagram: bytes) -> Parcel:
        """Return what a datagram carries.

        Raises:
            WireError: if it is malformed.
        """
        try:
            return self._decode(datagram)
        except (error, ValueError, IndexError, OverflowError, RecursionError) as problem:
            raise WireError(f"malformed: {problem}") from problem

    def _decode(self, datagram: bytes) -> Parcel:
        word, seq, stamp = _HEADER.unpack_from(datagram)
        src, place, kind = word >> 22 & 0x1FF, word >> 17 & 0x1F, Kind(word >> 13 & 0xF)
        if not word & MARK or src >= self._nodes or abs(stamp) > MAX_INTEGER:
            raise ValueError("not a header")
        number, attempt, port, at = word >> 8 & 0x1F, word & 0xFF, PORTS[place], HEADER
        admitted = ANNOUNCED if kind is Kind.RECORD or kind in OF_RECORD else ADMITTED[place]
        if number < NOTHING and BODIES[number] not in admitted:
            raise ValueError("a body at a wrong port")
        first = second = 0
        if kind in FRAMES:
            first, second = _PAIR.unpack_from(datagram, at)
            at += NUMBER
        if kind in {Kind.ACKNOWLEDGEMENT_TO_ALL, Kind.ACKNOWLEDGEMENT_TO_ONE}:
            frame: Any = Acknowledgement(port, kind not in ONE, _ns(first), second, _received(second, datagram[at:]))
            return Parcel(word << 32 | seq, src, Message(src, stamp, frame), FRAMES_PORT, to_one=True)
        if number == OWN:
            port, body = self._own.unpack(datagram[at:])
        else:
            body = self._read(number, datagram[at:])
        return self._parcel(word << 32 | seq, src, kind, seq, stamp, port, body, attempt, first, second)

    def _parcel(
        self,
        number: int,
        src: int,
        kind: Kind,
        seq: int,
        stamp: int,
        port: str,
        body: Any,
        attempt: int,
        first: int,
        second: int,
    ) -> Parcel:
        if kind is Kind.RECORD:
            return Parcel(number, src, Record(src, seq, stamp, body), "", to_one=False)
        to_one = kind in ONE
        if kind not in FRAMES:
            return Parcel(number, src, Message(src, stamp, body), port, to_one)
        if kind in OF_RECORD:
            body = Forwarded((Record(src, seq, stamp, body),))
        frame: Any = Skip(port, not to_one, _ns(first), second)
        if kind in OF_SEGMENT:
            frame = Segment(port, not to_one, _ns(first), seq, second, attempt, body)
        elif kind in OF_PIECE:
            frame = CodedPiece(port, not to_one, _ns(first), seq, second, body)
        return Parcel(number, src, Message(src, stamp, frame), FRAMES_PORT, to_one)

    def _read(self, number: int, data: bytes) -> Any:
        if number == NOTHING:
            if data:
                raise ValueError("bytes after the end")
            return None
        layout = self._layouts[number]
        if layout.body in {TimeRequest, TimeAnswer}:
            first, second, third = Struct(">qqq").unpack(data)
            if layout.body is TimeRequest:
                return TimeRequest(first)
            self.answered[first] = third
            return TimeAnswer(first, second)
        return layout.read(data, self._records)

    def _records(self, data: bytes) -> Iterator[Record]:
        """Yield the records in the rest of a datagram."""
        while data:
            word, seq, stamp = _HEADER.unpack_from(data)
            src, number = word >> 22 & 0x1FF, word >> 8 & 0x1F
            if not word & MARK or src >= self._nodes or number >= NOTHING:
                raise ValueError("not a record")
            layout = self._layouts[number]
            if layout.has_rest:
                raise ValueError("a record within a record")
            end = HEADER + layout.size
            yield Record(src, seq, stamp, self._read(number, data[HEADER:end]))
            data = data[end:]


def _session(session: int) -> int:
    """Return the number of a session in a header: 0, the only one that a live node has."""
    if session:
        raise WireError("a node that has lost its memory cannot number its messages anew live")
    return 0


def _ns(session: int) -> int:
    if session:
        raise ValueError("not a session")
    return 0


def _bits(frame: Acknowledgement, size: int) -> bytes:
    """Return the numbers that an acknowledgement lists, as a bit each beyond the expected number."""
    field = 0
    for seq in frame.received:
        field |= 1 << (seq - frame.expected)
    return field.to_bytes(size, "big")


def _received(expected: int, data: bytes) -> tuple[int, ...]:
    field = int.from_bytes(data, "big")
    return tuple(expected + k for k in range(field.bit_length()) if field >> k & 1)

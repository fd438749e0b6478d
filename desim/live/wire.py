"""Datagrams: messages as the bytes that `desim.kernel.core.message_size` counts, no more and no fewer.

    4  sender: a set bit, then the node (9 bits), the port (5), whether it is to one node (1), the kind (3), the body
       (5) and the attempt (8)
    4  sequence number
    8  time, ns
    8  of a frame of a transport: how long after this time it was transmitted, us; and the base of a segment or a skip,
       the number of a piece, or the expected number of an acknowledgement (4 bytes each)
    n  the body: 8 bytes a number, in the order of its fields; the lists whose length varies come last

All numbers are big-endian. Integers have a sign, and booleans are 0 or 1. A record inside a body has a header of its
own. The set bit with which a header begins distinguishes it from the numbers of the list before it. If items of a list
may be missing, the upper 16 bits of a number hold the place of its item.

A frame carries the time of the message that it repeats. The session of a frame is always 0 in a live run: its 4 bytes
hold the delay from this time to the transmission, to which the receiver adds the latency. The delay counts modulo
2^32 us, 71 min (`CYCLE`), and the attempt modulo 256.

Bodies of users have no such layout (`desim.live.own_bodies`). Nothing of a datagram is executed: it names an entry of
the tables below, or is malformed.
"""

from collections.abc import Container, Iterator
from enum import IntEnum
from itertools import count
from struct import Struct, error
from typing import Any, NamedTuple, Self

from desim.config.number_texts import counted
from desim.kernel.clock_sync import PORT as CLOCKS
from desim.kernel.clock_sync import TimeAnswer, TimeRequest
from desim.kernel.core.message_size import HEADER, NUMBER
from desim.kernel.core.records import Record
from desim.kernel.state.inbox import Message
from desim.kernel.transport.frames import Acknowledgement, CodedPiece, Segment, Skip, TransportFrame
from desim.kernel.transport.layer import PORT as FRAMES
from desim.live.layouts import MAX_COUNT, Layout, NumberRange, WireError
from desim.live.own_bodies import OwnBodies
from desim.pursuit.team.announcements import Assignment, Forwarded, LocatedAssignment, MovingAssignment, TimedAssignment
from desim.pursuit.team.judges import PORT as ACCUSATIONS
from desim.pursuit.team.judges import Accusation
from desim.scenario.scenario import Scenario
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
"""The bodies that are sent at each port, in the order of `PORTS`."""
ANNOUNCED = {Assignment, TimedAssignment, LocatedAssignment, MovingAssignment, Claim, StampedClaim}
"""The bodies of records."""
MAX_NODES = 1 << 9
MARK = 1 << 31
"""The set bit with which a header begins."""
MAX_INTEGER = 1 << 62
LARGEST = 65_507
"""Bytes of the largest datagram."""
MICROSECOND = 1_000
CYCLE = MICROSECOND << 32
"""Time, ns, after which the time between a message and its frame counts from 0 again."""
MAX_ANSWERED = 4096
"""Number of answers of clock synchronisation whose t3 is remembered until they are delivered."""
_new = tuple.__new__  # creates a named tuple in a third of the time
_HEADER, _PAIR = Struct(">IIq"), Struct(">II")
_PORT_NUMBERS = {port: number for number, port in enumerate(PORTS)}
_BODY_NUMBERS = {body: number for number, body in enumerate(BODIES)}


class Kind(IntEnum):
    """The kind of a datagram."""

    RECORD = 0
    MESSAGE = 1
    SEGMENT = 2
    PIECE = 3
    SKIP = 4
    ACKNOWLEDGEMENT = 5
    SEGMENT_OF_RECORD = 6
    """A segment whose body is one record of its sender; its header serves as the header of the record, too."""
    PIECE_OF_RECORD = 7


KINDS = tuple(Kind)
OF_RECORD = frozenset({Kind.RECORD, Kind.SEGMENT_OF_RECORD, Kind.PIECE_OF_RECORD})


class Parcel(NamedTuple):
    """The content of a datagram."""

    number: int
    """Unique for the sender, its receiver and the run; see `datagram_number`."""
    src: int
    start: int
    """The time of transmission, ns; for a frame, it may be too early by a multiple of `CYCLE`."""
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
        self._nodes, self._own_bodies = nodes, bodies
        limits: dict[str, tuple[NumberRange, ...]] = {
            **{"active": ((0, evaders),), "winners": ((-1, nodes - 1),)},
            **{"hop": ((0, MAX_COUNT),), "hops": ((1, MAX_COUNT),)},
            **dict.fromkeys(("absent", "accused", "chasers"), ((0, nodes - 1),)),
            **dict.fromkeys(("epoch", "stamp"), ((0, MAX_COUNT), (-1, nodes - 1))),
        }
        lengths = {"winners": evaders, "amounts": evaders, "chasers": evaders, "stamps": nodes, "visits": nodes}
        self._layouts = [Layout(body, lengths, limits) for body in BODIES]
        self._announced = {number: self._layouts[number] for number, body in enumerate(BODIES) if body in ANNOUNCED}
        self._sent = count(1)
        self.answered: dict[TimeAnswer, int] = {}
        """t3 of answers of clock synchronisation, ns; see `desim.kernel.clock_sync.Synchroniser`."""

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Return the datagrams of a scenario."""
        protocol, announce = scenario.protocol, scenario.announce
        models = protocol, scenario.protocol_traits.schedule, announce.dissemination, announce.trust
        return cls(scenario.team.count, len(scenario.evaders), OwnBodies(*models))

    def encode(self, content: Record | Message, port: str, size: int, *, to_one: bool, now: int = 0) -> bytes:
        """Return the datagram of a record or a message that is transmitted now, ns.

        The datagram has `size` bytes, or more if the body is one of a user. A node can number 2^32 messages.

        Raises:
            WireError: if the body has no layout, or its layout has another size.
        """
        body, head, attempt = content.body, b"", 0
        if isinstance(content, Record):
            kind, seq = Kind.RECORD, content.seq
        elif port is not FRAMES:
            kind, seq = Kind.MESSAGE, next(self._sent)
        else:
            frame: TransportFrame = body
            if frame.session:
                raise WireError("a node that has lost its memory cannot number its messages anew live")
            kind, seq, attempt, second, body = self._carried(frame, content, size)
            head = _PAIR.pack((now - content.stamp + MICROSECOND - 1) // MICROSECOND % (1 << 32), second)
            if isinstance(frame, Acknowledgement):
                head += _bits(frame, size - HEADER - NUMBER)
            port, to_one = frame.port, not frame.to_all
        port_number, packed = _PORT_NUMBERS.get(port), self._body_of(body)
        admitted = ANNOUNCED if kind in OF_RECORD else ADMITTED[port_number or 0]
        if port_number is None or packed is None or (body is not None and type(body) not in admitted):
            body_number, data = OWN, self._own_bodies.pack(port, body)
            size = max(size, HEADER + len(head) + len(data))
        else:
            body_number, data = packed
        word = MARK | content.src << 22 | (port_number or 0) << 17 | to_one << 16 | kind << 13
        word |= body_number << 8 | attempt & 0xFF
        datagram = _HEADER.pack(word, seq, content.stamp) + head + data
        if len(datagram) > size or (len(datagram) < size and body_number != OWN):
            raise WireError(f"{type(body).__name__} counts {counted(size, 'byte')}, and has {len(datagram)}")
        if size > LARGEST:
            raise WireError(f"{type(body).__name__} has {counted(size, 'byte')}; a datagram has at most {LARGEST}")
        return datagram.ljust(size, b"\0")

    def _carried(self, frame: TransportFrame, content: Message, size: int) -> tuple[Kind, int, int, int, Any]:
        """Return the kind, the sequence number, the attempt, the second number and the body of a frame."""
        if isinstance(frame, Acknowledgement):
            return Kind.ACKNOWLEDGEMENT, next(self._sent), 0, frame.expected, None
        if isinstance(frame, Skip):
            return Kind.SKIP, next(self._sent), 0, frame.base, None
        if isinstance(frame, Segment):
            kinds, attempt, second = (Kind.SEGMENT, Kind.SEGMENT_OF_RECORD), frame.attempt, frame.base
        else:
            kinds, attempt, second = (Kind.PIECE, Kind.PIECE_OF_RECORD), frame.part, frame.part
        record = self._only_record(frame.body, size - HEADER - NUMBER)
        if record is None:
            return kinds[0], frame.seq, attempt, second, frame.body
        if (record.src, record.seq, record.stamp) != (content.src, frame.seq, content.stamp):
            raise WireError("a record whose number or time is not that of its message cannot be sent live")
        return kinds[1], frame.seq, attempt, second, record.body

    def _only_record(self, body: Any, size: int) -> Record | None:
        """Return the only record of a forwarded body if the layout of the record's body has `size` bytes; else None."""
        if isinstance(body, Forwarded) and len(body.records) == 1:
            packed = self._body_of(body.records[0].body)
            if packed is not None and len(packed[1]) == size:
                return body.records[0]
        return None

    def _body_of(self, body: Any) -> tuple[int, bytes] | None:
        """Return the number and the bytes of a body; None if it has no layout."""
        if body is None:
            return NOTHING, b""
        number = _BODY_NUMBERS.get(type(body))
        if number is None:
            return None
        numbers, records = self._layouts[number].flat(body)
        if isinstance(body, TimeRequest):
            numbers += [0, 0]  # a request has as many bytes as its answer
        elif isinstance(body, TimeAnswer):
            numbers.append(self.answered.get(body, 0))
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
        src, port_number = word >> 22 & 0x1FF, word >> 17 & 0x1F
        to_one, kind = bool(word >> 16 & 1), KINDS[word >> 13 & 7]
        if not word & MARK or src >= self._nodes or abs(stamp) > MAX_INTEGER:
            raise ValueError("not a header")
        unique, body_number, port = word << 32 | seq, word >> 8 & 0x1F, PORTS[port_number]
        if kind is Kind.RECORD and body_number in self._announced:  # a shortcut for most datagrams
            body = self._announced[body_number].read(datagram, HEADER, self._records)
            return _new(Parcel, (unique, src, stamp, _new(Record, (src, seq, stamp, body)), "", to_one))
        admitted = ANNOUNCED if kind in OF_RECORD else ADMITTED[port_number]
        if body_number < NOTHING and BODIES[body_number] not in admitted:
            raise ValueError("a body at a wrong port")
        delay, second, at = 0, 0, HEADER
        if kind > Kind.MESSAGE:
            delay, second = _PAIR.unpack_from(datagram, at)
            at += NUMBER
        body = None
        if body_number == OWN:
            port, body = self._own_bodies.unpack(datagram[at:])
        elif kind is not Kind.ACKNOWLEDGEMENT:
            body = self._read(body_number, datagram, at)
        if kind is Kind.RECORD:
            return Parcel(unique, src, stamp, Record(src, seq, stamp, body), "", to_one)
        if kind is Kind.MESSAGE:
            return Parcel(unique, src, stamp, Message(src, stamp, body), port, to_one)
        if kind in OF_RECORD:
            body = Forwarded((Record(src, seq, stamp, body),))
        numbers = seq, second, word & 0xFF
        frame = _frame_of(kind, port, body, numbers, datagram[at:], to_all=not to_one)
        unique = unique << 64 | delay << 32 | second
        return Parcel(unique, src, stamp + delay * MICROSECOND, Message(src, stamp, frame), FRAMES, to_one)

    def _read(self, number: int, data: bytes, at: int) -> Any:
        """Return the body of the kind `number` that begins at the index `at` of the data."""
        if number == NOTHING:
            if len(data) > at:
                raise ValueError("bytes after the end")
            return None
        layout = self._layouts[number]
        if layout.body in {TimeRequest, TimeAnswer}:
            first, second, third = Struct(">qqq").unpack(data[at:])
            if layout.body is TimeRequest:
                return TimeRequest(first)
            answer = TimeAnswer(first, second)
            self.answered[answer] = third
            if len(self.answered) > MAX_ANSWERED:
                del self.answered[next(iter(self.answered))]
            return answer
        return layout.read(data, at, self._records)

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
            yield Record(src, seq, stamp, self._read(number, data[:end], HEADER))
            data = data[end:]


def datagram_number(datagram: bytes) -> int:
    """Return the number of a datagram: its first eight bytes and, of a frame, the eight that a frame adds.

    Without the eight of a frame, attempts whose numbers are equal modulo 256 would have one number.
    """
    is_frame = datagram[2] >> 5 > Kind.MESSAGE
    return int.from_bytes(datagram[:8] + datagram[HEADER : HEADER + NUMBER] if is_frame else datagram[:8], "big")


def is_record(datagram: bytes) -> bool:
    """Return whether a datagram carries a record, by its kind."""
    return len(datagram) >= HEADER and datagram[2] >> 5 == Kind.RECORD


def _frame_of(
    kind: Kind, port: str, body: Any, numbers: tuple[int, int, int], rest: bytes, *, to_all: bool
) -> TransportFrame:
    """Return the frame of a kind, given its sequence number, its second number and its attempt."""
    seq, second, attempt = numbers
    if kind in {Kind.SEGMENT, Kind.SEGMENT_OF_RECORD}:
        return Segment(port, to_all, 0, seq, second, attempt, body)
    if kind in {Kind.PIECE, Kind.PIECE_OF_RECORD}:
        return CodedPiece(port, to_all, 0, seq, second, body)
    if kind is Kind.SKIP:
        return Skip(port, to_all, 0, second)
    return Acknowledgement(port, to_all, 0, second, _received(second, rest))


def _bits(frame: Acknowledgement, size: int) -> bytes:
    """Return the numbers that an acknowledgement lists, as one bit for each number from the expected one on."""
    field = 0
    for seq in frame.received:
        field |= 1 << (seq - frame.expected)
    return field.to_bytes(size, "big")


def _received(expected: int, data: bytes) -> tuple[int, ...]:
    """Return the numbers that `_bits` has packed."""
    field = int.from_bytes(data, "big")
    return tuple(expected + k for k in range(field.bit_length()) if field >> k & 1)

"""The receivers of transports: they remove duplicates, restore the order, decode, and watch deadlines and leases."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from desim.kernel.core.clock import Clock, Timer
from desim.kernel.state.inbox import Message
from desim.kernel.transport.frames import CodedPiece, Segment, Skip

_new = tuple.__new__  # creates a named tuple in a third of the time
REMEMBERED = 64
"""Number of messages of a flow whose pieces a receiver remembers."""


class Arrived(NamedTuple):
    """A message that has reached a receiver."""

    seq: int
    message: Message
    attempt: int
    """Number of the attempt, or of the piece, with which it arrived, from 1 on."""


class ReliableReceiver:
    """The messages of a flow that have reached one receiver.

    All messages before the number `expected` have been received, or are not expected any more.

    Args:
        session: the session of the sender.
        base: the first number to be expected.
        ordered: whether messages are delivered in the order of their numbers.
    """

    def __init__(self, session: int, base: int, *, ordered: bool):
        self.session, self.expected, self._ordered = session, base, ordered
        self._beyond: dict[int, Arrived] = {}
        """By number, the messages received beyond `expected`; if ordered, they wait for the messages before them."""

    def receive(self, src: int, stamp: int, frame: Segment | Skip) -> list[Arrived]:
        """Process a frame with its time stamp, ns; return the messages to be delivered now, in order."""
        new: list[Arrived] = []
        if isinstance(frame, Segment) and frame.seq >= self.expected and frame.seq not in self._beyond:
            arrived = _new(Arrived, (frame.seq, _new(Message, (src, stamp, frame.body)), frame.attempt))
            self._beyond[frame.seq] = arrived
            new.append(arrived)
        passed = self._advance(frame.base)
        return passed if self._ordered else new

    def beyond(self) -> tuple[int, ...]:
        """Return the numbers of the messages received beyond `expected`, ascending."""
        return tuple(sorted(self._beyond)) if self._beyond else ()

    def _advance(self, base: int) -> list[Arrived]:
        """Raise `expected` to `base` or further, past received messages; return the messages that it passes."""
        beyond = self._beyond
        passed: list[Arrived] = []
        if base > self.expected:
            passed = [beyond.pop(seq) for seq in sorted(beyond) if seq < base]
            self.expected = base
        while self.expected in beyond:
            passed.append(beyond.pop(self.expected))
            self.expected += 1
        return passed


class CodedReceiver:
    """The pieces of a flow that have reached one receiver.

    Args:
        session: the session of the sender.
        needed: the number of pieces that suffice to decode a message.
    """

    def __init__(self, session: int, needed: int):
        self.session, self._needed = session, needed
        self._newest = 0
        self._pieces: dict[int, set[int]] = {}
        """The numbers of the pieces received, by number of the message."""

    def receive(self, src: int, stamp: int, piece: CodedPiece) -> Iterator[Arrived]:
        """Process a piece with its time stamp, ns; yield its message if this piece completes it."""
        self._newest = max(self._newest, piece.seq)
        if piece.seq <= self._newest - REMEMBERED:  # its message may have been delivered, and is forgotten
            return
        pieces = self._pieces.setdefault(piece.seq, set())
        count_before = len(pieces)
        pieces.add(piece.part)
        if len(self._pieces) > REMEMBERED:
            self._pieces = {seq: parts for seq, parts in self._pieces.items() if seq > self._newest - REMEMBERED}
        if count_before < self._needed == len(pieces):
            yield Arrived(piece.seq, Message(src, stamp, piece.body), piece.part)


class Expectation:
    """An event that a node expects to happen again within a time.

    Args:
        env: the clock.
        priority: the priority of the event at which it is missed.
        span: returns the time, ns; it may change, as the clock of the node may wander.
        miss: called when the event has not happened for that time.
        repeats: whether `miss` is called again after each further such time without the event.
    """

    def __init__(
        self, env: Clock, priority: int, span: Callable[[], int], miss: Callable[[], object], *, repeats: bool
    ):
        self._env, self._span, self._miss, self._repeats = env, span, miss, repeats
        self._due = 0
        self._timer = Timer(env, priority, self._check)

    def meet(self) -> None:
        """Note that the event happens now; from now on, it is expected again."""
        self._due = self._env.now + self._span()
        self._timer.set(self._due)

    def drop(self) -> None:
        """Expect the event no longer."""
        self._timer.stop()

    def _check(self) -> None:
        if self._env.now >= self._due:
            self._miss()
            if not self._repeats:
                return
            self._due = self._env.now + self._span()
        self._timer.set(self._due)

"""Dissemination: how the announcements of a pursuer spread to its teammates.

A dissemination has a method `broadcast`, which sends an announcement of the agent. Called with an agent, the
dissemination returns a process that handles the announcements of teammates. In flooding, the process forwards them. If
`broadcast` uses `Agent.publish`, announcements are received without this process, which then does nothing.

Paper: Flooding: in the paper, each receiver of a new announcement rebroadcasts it once, after a random delay (Ni,
    Tseng, Chen & Sheu 1999, "The Broadcast Storm Problem"). Gossip: each broadcast carries all known records
    (anti-entropy of Demers et al. 1987). Reliable: automatic repeat request, see `desim.kernel.models.transport`.
Parameters: hops (largest number of hops of a flooded announcement), jitter (longest random delay); for reliable and
    coded, the parameters of the transport.
Assumes: nothing; one hop is enough on a complete graph.
Messages: one broadcast per announcement; in flooding, about one per pursuer and announcement. A gossip message carries
    all known records. Reliable: also one acknowledgement per receiver, and the repetitions. Coded: one broadcast per
    piece.
Robust to loss: yes, with heartbeats; flooding also without them where there are several paths, and reliable without
    them if a receiver stays in range.
"""

from functools import partial
from math import inf
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from desim.config.model import Time, Value
from desim.kernel.core.clock import Phase
from desim.kernel.core.message_size import size_of
from desim.kernel.core.ports import ReservedPort
from desim.kernel.core.records import Record
from desim.kernel.models.transport import Coded, Depth, Reliable, SendWindow, Transport
from desim.kernel.state.inbox import Message
from desim.pursuit.team.agent import Agent, Process, merge_relayed
from desim.pursuit.team.announcements import Forwarded

PORT = ReservedPort("announcements", __name__)
"""The port of announcements that are sent as messages, by all disseminations but `OneHop`."""


class OneHop(Value):
    """Announcements reach the neighbours only; they are not forwarded."""

    kind: Literal["one_hop"] = "one_hop"
    hops: ClassVar[int] = 1

    def broadcast(self, me: Agent, announcement: Any) -> None:
        """Publish the announcement."""
        me.publish(announcement)

    def __call__(self, me: Agent) -> Process:
        """Do nothing."""
        yield from ()


class Flooding(Value):
    """Each receiver of a new announcement rebroadcasts it, up to a number of hops; duplicates are dropped.

    A duplicate with more hops left than the copy that was rebroadcast is not dropped, but rebroadcast, too. Messages:
    at most one transmission per pursuer and announcement, and one more for each such duplicate. Robust to loss where
    there are several paths.
    """

    kind: Literal["flooding"] = "flooding"
    hops: Annotated[int, Field(ge=1, strict=True)] = 5
    """Largest number of hops that an announcement travels.

    With fewer hops than the diameter of the network, some pursuers hear nothing; more cost nothing, because duplicates
    are dropped.

    If in doubt, use the diameter and one or two hops more.
    """
    jitter: Time = 0.005
    """Longest random delay J before a rebroadcast, s; the delay keeps neighbours from transmitting simultaneously.

    With a short delay, neighbours that received together also transmit together; a long one is added at each hop.

    If in doubt, use the airtime of an announcement times the number of neighbours.
    """

    @property
    def forwarding_jitter(self) -> float:
        """The longest random delay before a rebroadcast, s."""
        return self.jitter

    def broadcast(self, me: Agent, announcement: Any) -> None:
        """Send the announcement to the neighbours."""
        me.send(None, Forwarded((me.record(announcement),), self.hops), PORT)

    def __call__(self, me: Agent) -> Process:
        """Rebroadcast each new announcement after a random delay."""
        rng = me.stream("flooding")
        merged: dict[int, float] = {me.id: inf}  # by source: the greatest sequence number of a record received
        # By source: sequence number and hops of the last copy rebroadcast; inf, so that `me` repeats none of its own.
        forwarded: dict[int, tuple[float, int]] = {me.id: (inf, 0)}

        def is_forwarded(record: Record, hops: int) -> bool:
            # Pairs are compared: a newer record is always forwarded, a copy of the same one only if it has more hops.
            return hops > 1 and (record.seq, hops) > forwarded.get(record.src, (0, 0))

        def take(messages: list[Message]) -> None:
            for message in messages:
                (record,), hops = message.body
                if record.seq > merged.get(record.src, -1):
                    merged[record.src] = record.seq
                    me.merge_records([record])
                if is_forwarded(record, hops):
                    forwarded[record.src] = (record.seq, hops)
                    rebroadcast = partial(me.send, None, Forwarded((record,), hops - 1), PORT)
                    me.after(self.jitter * rng.random(), rebroadcast, Phase.RELAY)  # `uniform` takes 8 times as long

        def is_copy(message: Message) -> bool:
            (record,), hops = message.body
            return record.seq <= merged.get(record.src, -1) and not is_forwarded(record, hops)

        # Most messages are copies, and an event for each would take too long.
        yield me.listen(take, PORT, Phase.RELAY, is_copy)


class Gossip(Value):
    """Each announcement carries the newest known records of all pursuers; receivers keep the newest of each source.

    Robust to loss: yes, with heartbeats, which repeat all records. Messages: their length grows with the team.
    """

    kind: Literal["gossip"] = "gossip"

    def broadcast(self, me: Agent, announcement: Any) -> None:
        """Send the announcement with all known records to the neighbours."""
        records = me.latest_records().values()
        me.send(None, Forwarded((me.record(announcement), *records)), PORT)

    def __call__(self, me: Agent) -> Process:
        """Merge the records that arrive."""
        yield from merge_relayed(me, PORT)


class SentByTransport:
    """A dissemination that is itself the transport of announcements to the neighbours, which do not forward them."""

    hops: ClassVar[int] = 1

    @property
    def transport(self) -> Any:
        """The transport of announcements."""
        return self

    def broadcast(self, me: Agent, announcement: Any) -> None:
        """Send the announcement to the neighbours."""
        send_record(me, announcement, self.transport)

    def __call__(self, me: Agent) -> Process:
        """Merge the records that arrive."""
        yield from merge_relayed(me, PORT)


class ReliableOneHop(SentByTransport, Reliable):
    """Each announcement is transmitted again to the neighbours that have not acknowledged it; none is forwarded.

    By default a newer announcement replaces one that is not acknowledged yet (`depth` is 1), because announcements are
    state. Robust to loss: yes, also without heartbeats. Messages: per announcement a broadcast, and for each neighbour
    an acknowledgement of 24 bytes and p / (1 - p) repetitions at a probability p of loss.
    """

    kind: Literal["reliable"] = "reliable"
    window: SendWindow = 1
    """Largest number of successive messages to a receiver, from the oldest unacknowledged one on; 1 = stop-and-wait.

    If in doubt, use 1: only the newest announcement matters, and `keep_last` keeps no other.
    """
    depth: Depth = 1
    """Number of messages that `keep_last` keeps."""

    @property
    def retransmits(self) -> bool:
        """Whether an announcement is transmitted again until it is acknowledged, or a newer one replaces it."""
        return not self.gives_up


class CodedOneHop(SentByTransport, Coded):
    """Each announcement is broadcast in coded pieces, of which some suffice; none is acknowledged or forwarded.

    Robust to loss: more than `one_hop`, at the cost of the bytes of all pieces.
    """

    kind: Literal["coded"] = "coded"


def send_record(me: Agent, announcement: Any, transport: Transport) -> None:
    """Send an announcement to all neighbours as a record; its bytes are those of the announcement and the transport."""
    record = me.record(announcement)  # a liar's record has another body than the announcement
    me.send(None, Forwarded((record,)), PORT, transport=transport, size=size_of(record.body))

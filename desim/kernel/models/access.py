"""Models of channel access: when a node may transmit a frame on a channel that it shares with other nodes.

A model is immutable. `desim.kernel.channel.access_methods` has its state in one run.

All nodes contend for one channel. A node transmits one frame at a time and cannot receive meanwhile. Frames that
overlap at a receiver interfere, see `desim.kernel.models.interference`. A node senses the frames of the nodes that are
linked to it and within range. If the model has a carrier-sense range, a node senses all frames from within that range.
"""

from collections.abc import Sequence
from math import inf
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from desim.config.choice import OneOf
from desim.config.errors import KeyedError, Problem
from desim.config.model import MAX_TIME, Extent, FirstError, Limit, NotEmpty, Period, Time, Value
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.graphs import Node

ContentionWindow = Annotated[int, Field(ge=1, le=1_000_000, strict=True)]


class Channel(NamedTuple):
    """How frames that are created at one instant overlap on a channel."""

    vulnerable: float
    """Time between the starts of two frames, s, up to which they overlap even if their senders hear each other."""
    hidden: float
    """The same time if the senders do not hear each other, s."""
    chance: float = 1.0
    """Probability that two frames whose starts are that close overlap."""


def _slots_of(time: float, slot: float) -> int:
    """Return the number of slots that a time takes, rounded up. Both are in s; the channel counts nanoseconds."""
    return -(-nanoseconds(time) // nanoseconds(slot))


def _both_transmit(p: float) -> float:
    """Return the probability that two nodes transmit in one slot if at least one does: p^2 / (1 - (1 - p)^2)."""
    return p / (2.0 - p)


class _Access(Value):
    """Base of all models of channel access."""

    def interval(self, time: float, nodes: int) -> float:
        """Return the least time, s, between the starts of two frames of one of `nodes` nodes.

        `time` is the airtime of the first frame plus the silence after it, s.
        """
        return time

    def occupancy(self, airtime: float, *, to_one: bool) -> float:
        """Return the airtime, s, of a frame with what the access adds to it; see `Radio.occupancy`."""
        return airtime

    def channel(self, airtime: float) -> Channel | None:
        """Return how frames of an airtime (s) overlap; None if they do not."""
        return None


class Ideal(_Access):
    """An ideal queue: a message waits until its transmitter, or the shared channel, is free; nothing collides."""

    kind: Literal["ideal"] = "ideal"


class Aloha(_Access):
    """Pure ALOHA (Abramson 1970, "The ALOHA System"): a node transmits a frame as soon as its radio is free."""

    kind: Literal["aloha"] = "aloha"

    def channel(self, airtime: float) -> Channel:
        """Return how frames of an airtime (s) overlap."""
        return Channel(airtime, airtime)


class SlottedAloha(_Access):
    """Slotted ALOHA (Roberts 1975, "ALOHA Packet System with and without Slots and Capture").

    A node starts to transmit at the beginning of a slot only. In each slot it transmits a waiting frame with
    probability p. A frame that is longer than a slot extends into the following slots. Nodes read the slots from their
    own clocks. If half of the nodes are half a slot off, a frame overlaps two slots of theirs: at a load of one frame
    per slot, the throughput is e^(-3/2) instead of e^(-1). A fast clock shortens the slots of its node.
    """

    kind: Literal["slotted_aloha"] = "slotted_aloha"
    slot: Period
    """Length of a slot, s; usually the airtime of a frame.

    If in doubt, the airtime of the longest frame: a frame that is longer than a slot also spoils the next one, and a
    longer slot is idle at its end.
    """
    p: Annotated[float, Field(gt=0, le=1, strict=True)] = 1.0
    """Probability of transmitting in a slot, in (0, 1].

    If in doubt, 1 / (number of nodes that have a frame at once): a larger p causes collisions, a smaller one leaves
    slots empty.
    """

    def occupancy(self, airtime: float, *, to_one: bool) -> float:
        """Return the time of the whole slots that a frame takes, s."""
        return _slots_of(airtime, self.slot) * self.slot

    def channel(self, airtime: float) -> Channel:
        """Return how frames of an airtime (s) overlap."""
        longest = max(self.slot, airtime)
        return Channel(longest, longest, _both_transmit(self.p))


class CarrierSensing(_Access):
    """The fields of all access models that sense the channel."""

    sensing_delay: Time = 0.0
    """Time from the start or end of a frame until other nodes sense it, s; it includes the propagation delay."""
    sensing_range: Extent | None = None
    """Carrier-sense range, m, regardless of the graph; if None, a node senses the frames that it could receive.

    If in doubt, leave it out. Twice the communication range silences most hidden nodes, and also nodes that would
    disturb nobody.
    """

    def channel(self, airtime: float) -> Channel:
        """Return how frames of an airtime (s) overlap."""
        return Channel(self.sensing_delay, airtime)


class Csma(CarrierSensing):
    """Carrier-sense multiple access (Kleinrock & Tobagi 1975, "Packet Switching in Radio Channels: Part I").

    A node senses the channel before it transmits. If the channel is busy, a nonpersistent node senses again after a
    random time. A p-persistent node waits until the channel is idle; it then transmits with probability p, and
    otherwise senses again after a slot.
    """

    kind: Literal["csma"] = "csma"
    persistence: Literal["nonpersistent", "p_persistent"] = "nonpersistent"
    """Whether a node waits for the end of a frame (p_persistent), or senses again after a random time."""
    backoff: Period = 0.01
    """Mean of the exponential time until a nonpersistent node senses a busy channel again, s.

    If in doubt, the airtime of a frame times the number of nodes: with a shorter time, waiting nodes often collide; a
    longer one leaves the channel idle.
    """
    attempts: Annotated[Limit, Field(ge=1)] = inf
    """Number of times a nonpersistent node senses a busy channel before it drops the frame; inf = unlimited.

    If in doubt, inf; set it where a late frame is worth nothing.
    """
    p: Annotated[float, Field(gt=0, le=1, strict=True)] = 1.0
    """Probability p of transmitting on an idle channel, in (0, 1]; for p_persistent.

    If in doubt, 1 / (number of nodes that wait for the channel at once): with p = 1 any two that wait collide at the
    end of a frame.
    """
    slot: Period = 0.001
    """Time until a p-persistent node that did not transmit senses the channel again, s.

    If in doubt, a little more than `sensing_delay`: in a shorter slot a node cannot hear who has begun, and a longer
    one is wasted.
    """

    def channel(self, airtime: float) -> Channel:
        """Return how frames of an airtime (s) overlap."""
        chance = _both_transmit(self.p) if self.persistence == "p_persistent" else 1.0
        return super().channel(airtime)._replace(chance=chance)

    @property
    def unused_fields(self) -> dict[str, str]:
        """The fields of the other persistence."""
        unused = ("p", "slot") if self.persistence == "nonpersistent" else ("backoff", "attempts")
        return dict.fromkeys(unused, f"persistence {self.persistence!r}")


class CsmaCa(CarrierSensing):
    """The distributed coordination function of IEEE 802.11 (Bianchi 2000; for broadcast, Ma & Chen 2007).

    A node transmits after the channel has been idle for DIFS and a random number of slots. While it senses a frame, it
    keeps the number of slots that are left. After each frame it draws a new number. Broadcasts are not acknowledged.
    Messages to one node are acknowledged. If the frame of such a message is lost, the sender doubles its window, draws
    a new back-off and transmits the frame again. Not modelled: RTS/CTS.

    By default acknowledgements are always received, and a sender knows of a loss at the end of its frame. With
    `ack_timeout`, an acknowledgement is a frame that can collide, fade or be lost as any other. A sender that misses it
    transmits the frame again; the receiver delivers it only once. A node that receives a frame for another one is
    silent until the end of that frame's acknowledgement (network allocation vector). With `eifs`, a node that senses a
    frame without receiving it is silent for long enough not to disturb the acknowledgement of the frame.

    The default times are those of 802.11g without protection.
    """

    kind: Literal["csma_ca"] = "csma_ca"
    slot: Period = 9e-6
    """Length of a slot, s."""
    sifs: Time = 10e-6
    """Short interframe space between a frame and its acknowledgement, s; less than `difs`."""
    difs: Time = 28e-6
    """Distributed interframe space: time for which the channel must be idle before slots are counted, s."""
    window: ContentionWindow = 16
    """Smallest contention window W: the number of slots is uniform on 0 .. W - 1.

    If in doubt, 16. Broadcasts never double the window: for them, about twice the number of nodes that have a frame at
    once.
    """
    doublings: Annotated[int, Field(ge=0, le=16, strict=True)] = 6
    """Number of times that failed attempts can double the window."""
    retries: Annotated[int, Field(ge=0, le=1000, strict=True)] = 7
    """Number of times that an unacknowledged frame is transmitted again before it is dropped.

    If in doubt, 7, the default of 802.11: with fewer, frames are lost in a crowd, with more, frames to a node that is
    gone occupy the channel.
    """
    ack: Time = 34e-6
    """Airtime of an acknowledgement, s; the default is that of 14 bytes at 24 Mbit/s."""
    ack_timeout: Time | None = None
    """Time after its frame at which a sender without an acknowledgement transmits again, s; at least `sifs` + `ack`. If
    None, acknowledgements are always received."""
    eifs: Time | None = None
    """Extended interframe space, s, at least `difs`: time for which the channel must be idle after a frame that the
    node senses but does not receive; usually `sifs` + `ack` + `difs`. If None, it is `difs`. A frame lost by
    `network.loss` counts as received."""

    def occupancy(self, airtime: float, *, to_one: bool) -> float:
        """Return the airtime, s, of a frame with the space before it and, to one node, its acknowledgement."""
        return self.difs + airtime + (self.sifs + self.ack if to_one else 0.0)

    @model_validator(mode="after")
    def _has_order(self) -> Self:
        if not self.sifs < self.difs:
            raise ValueError(f"sifs should be less than difs, {self.difs:g} s (got {self.sifs:g})")
        if not self.sensing_delay < min(self.slot, self.difs):
            shortest = min(self.slot, self.difs)
            raise ValueError(
                f"sensing_delay should be less than slot and difs, {shortest:g} s (got {self.sensing_delay:g})"
            )
        least = nanoseconds(self.sifs) + nanoseconds(self.ack)
        if self.ack_timeout is not None and nanoseconds(self.ack_timeout) < least:
            raise ValueError(
                f"ack_timeout should be at least sifs + ack, {self.sifs + self.ack:g} s (got {self.ack_timeout:g})"
            )
        if self.eifs is not None and self.eifs < self.difs:
            raise ValueError(f"eifs should be at least difs, {self.difs:g} s (got {self.eifs:g})")
        longest = (self.window << self.doublings) * self.slot
        if longest > MAX_TIME:
            raise ValueError(
                f"window * 2^doublings * slot, the longest back-off, should be at most {MAX_TIME:g} s (got {longest:g})"
            )
        return self


class Tdma(_Access):
    """Time division multiple access: each slot belongs to one node, which may transmit one frame at its beginning.

    Nodes read the slots from their own clocks. If the clocks of two nodes differ by more than the guard time, frames in
    neighbouring slots may overlap. A node transmits one frame per slot. A message that takes longer than a slot without
    its guard time is lost (cause "access").
    """

    kind: Literal["tdma"] = "tdma"
    slot: Period = 0.01
    """Length of a slot, s, with its guard time.

    If in doubt, the airtime of the longest message plus `guard`: a longer message is lost, and a longer slot delays the
    turn of every node.
    """
    guard: Time = 0.0
    """Time at the end of a slot in which no node transmits, s; less than `slot`.

    If in doubt, the largest difference of two clocks during the run; with `clock_sync`, the difference after a
    correction plus the drift until the next one.
    """
    slots: Annotated[tuple[Node, ...], FirstError(), NotEmpty()] | None = None
    """The owners of the slots of one round, which is repeated; if None, the nodes take turns by id."""

    @model_validator(mode="after")
    def _has_room(self) -> Self:
        if not nanoseconds(self.guard) < nanoseconds(self.slot):
            raise ValueError(f"guard should be less than slot, {self.slot:g} s (got {self.guard:g})")
        return self

    def interval(self, time: float, nodes: int) -> float:
        """Return the time, s, of the whole rounds of slots, at least one, for a frame and the silence after it."""
        period = len(self.owners(nodes)) * self.slot
        return max(_slots_of(time, period), 1) * period

    def owners(self, size: int) -> Sequence[int]:
        """Return the owners of the slots of a round for `size` nodes.

        Raises:
            KeyedError: if a node has no slot, or an owner is no node.
        """
        if self.slots is None:
            return range(size)
        if idle := sorted({*range(size)}.difference(self.slots)):
            raise KeyedError(Problem(f"node {idle[0]} of 0 .. {size - 1} has no slot", "slots"))
        if unknown := sorted({*self.slots}.difference(range(size))):
            raise KeyedError(Problem(f"there is no node {unknown[0]}: the nodes are 0 .. {size - 1}", "slots"))
        return self.slots


Access = Ideal | Aloha | SlottedAloha | Csma | CsmaCa | Tdma
ACCESSES = OneOf(Ideal, Aloha, SlottedAloha, Csma, CsmaCa, Tdma, is_closed=True)

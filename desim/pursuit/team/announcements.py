"""Announcements of pursuers: their payload, when they are sent, and how long they are believed."""

from cmath import phase, rect
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from math import inf
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self, get_args

import numpy as np
from pydantic import Field, Tag

from desim.config.choice import OneOf
from desim.config.model import Period, Timeout, Value, in_forms
from desim.kernel.core.events import Broadcast, Delivered, Sent
from desim.kernel.core.message_size import HEADER, NUMBER
from desim.kernel.core.records import Record
from desim.kernel.state.inbox import Message
from desim.kernel.transport.frames import carried
from desim.pursuit.core.traits import DisseminationTraits
from desim.pursuit.motion.dead_reckoning import MotionState
from desim.pursuit.motion.dynamics import Course
from desim.pursuit.sensing.views import View
from desim.pursuit.team.trust import TRUSTS, Credulous, Trust


class Assignment(NamedTuple):
    """Payload "action": the action of a pursuer. 24 bytes."""

    active: int
    """The evader that it chases, 1 .. M, or 0."""

    @classmethod
    def announced_by(cls, pursuer: int, view: View) -> Self:
        """Return the announcement of a pursuer now, given its view of the world."""
        return cls(view.state.profile[pursuer])


class TimedAssignment(NamedTuple):
    """Payload "time": the action of a pursuer and its capture time at sending. 32 bytes."""

    active: int
    capture_time: float
    """Capture time, s, for the evader that the pursuer chases; if it is inactive, the least one over the uncaptured
    evaders, or inf if all are captured."""

    @classmethod
    def announced_by(cls, pursuer: int, view: View) -> Self:
        """Return the announcement of a pursuer now, given its view of the world."""
        action = view.state.profile[pursuer]
        evaders = [action] if action else view.state.at_large
        phi = [view.capture_times_of([pursuer], evader)[0] for evader in evaders]
        return cls(action, min(phi, default=inf))


class LocatedAssignment(NamedTuple):
    """Payload "state": the action of a pursuer, its position at sending and its speed while it chases. 48 bytes."""

    active: int
    x: float
    """m"""
    y: float
    """m"""
    speed: float
    """m/s"""

    @classmethod
    def announced_by(cls, pursuer: int, view: View) -> Self:
        """Return the announcement of a pursuer now, given its view of the world."""
        state, place = view.state, view.state.position(pursuer)
        return cls(state.profile[pursuer], place.real, place.imag, state.speed(pursuer))

    @property
    def motion(self) -> MotionState:
        """Its motion at sending, without a course."""
        return MotionState(complex(self.x, self.y))


class MovingAssignment(NamedTuple):
    """Payload "course": as "state", and the velocity and the heading at sending. 64 bytes."""

    active: int
    x: float
    """m"""
    y: float
    """m"""
    speed: float
    """Speed while it chases, m/s."""
    pace: float
    """Present speed, m/s."""
    heading: float
    """Present heading, rad from the x axis to the left."""

    @classmethod
    def announced_by(cls, pursuer: int, view: View) -> Self:
        """Return the announcement of a pursuer now, given its view of the world."""
        located, (velocity, heading) = LocatedAssignment.announced_by(pursuer, view), view.state.players.course(pursuer)
        return cls(*located, abs(velocity), phase(heading))

    @property
    def motion(self) -> MotionState:
        """Its motion at sending."""
        return MotionState(complex(self.x, self.y), Course(rect(self.pace, self.heading), rect(1.0, self.heading)))


Located = LocatedAssignment | MovingAssignment
"""An announcement with a position."""
Announcement = Assignment | TimedAssignment | Located
"""A standard announcement."""
PAYLOADS: dict[str, type[Announcement]] = {
    "action": Assignment,
    "time": TimedAssignment,
    "state": LocatedAssignment,
    "course": MovingAssignment,
}
"""The class of each payload (`Announcements.payload`)."""


class Forwarded(NamedTuple):
    """A message that relays records of its sender or of other pursuers."""

    records: tuple[Record, ...]
    hops: int = 1
    """Number of hops that it may still travel, the present one included."""


Start = Literal["announced", "known", "silent"]
"""How pursuers learn the initial actions; see `Announcements.start`."""
STARTS: tuple[Start, ...] = get_args(Start)
MAX_SEQ = 1 << 40
"""Largest sequence number of a record."""
MAX_STAMP = 1 << 62
"""Largest time stamp of a record, ns."""
INTEGERS = (int, np.integer, np.bool_)
"""The types of an action."""


def announced_action(body: Any) -> int | None:
    """Return `body.active`, the action that a message announces: an evader or 0; None if there is no action."""
    try:
        action: int | None = body.active
    except AttributeError:
        return None
    return action if isinstance(action, INTEGERS) else None


def action_in_game(body: Any, evaders: int) -> int | None:
    """Return the action that a message announces, given the number of evaders; None if there is no action.

    A protocol of a user may give an attribute `active` another meaning, so a number outside of the game is no action.
    The keys of a dict count as attributes, because in a trace file objects and dicts look alike.
    """
    action = body.get("active") if _is_mapping(body) else announced_action(body)
    return int(action) if isinstance(action, INTEGERS) and 0 <= action <= evaders else None


def relayed_records(body: Any) -> Sequence[Record] | None:
    """Return `body.records`, the records that a message relays; None if the message is not a relay.

    The items are checked, because a protocol of a user may give an attribute `records` another meaning. Records of a
    trace that was read from a file have another type, with the same fields.
    """
    records: Any = getattr(body, "records", None)
    if records is None and _is_mapping(body):
        records = body.get("records")
    return records if type(records) in {tuple, list} and all(map(_is_record, records)) else None


def _is_record(value: Any) -> bool:
    """Return whether a value has the fields of a record, and its numbers are valid for a record."""
    if getattr(value, "_fields", None) != Record._fields:
        return False
    if not all(isinstance(number, INTEGERS) for number in (value.src, value.seq, value.stamp)):
        return False
    return bool(value.src >= 0 and 0 <= value.seq <= MAX_SEQ and abs(value.stamp) <= MAX_STAMP)


def _is_mapping(body: Any) -> bool:
    """Return whether a message is a mapping."""
    # Most messages are tuples, and the check of the abstract class takes five times as long.
    return not isinstance(body, tuple) and isinstance(body, Mapping)


def with_records(body: Any, records: Iterable[Record]) -> Any:
    """Return a copy of a message that relays other records."""
    if isinstance(body, Mapping):
        return {**body, "records": tuple(records)}
    if isinstance(body, tuple):
        return body._replace(records=tuple(records))  # type: ignore[attr-defined]  # a named tuple
    changed = copy(body)
    object.__setattr__(changed, "records", tuple(records))  # the object may be frozen
    return changed


def own_records(event: Broadcast | Sent | Delivered) -> Sequence[Record]:
    """Return the record, in a sequence, of a broadcast that relays no records; empty for other events.

    The records in a frame of a transport (`desim.kernel.transport.frames`) count when they are delivered.
    """
    return (Record(event.src, event.seq, event.created, event.body),) if isinstance(event, Broadcast) else ()


class Eavesdropper:
    """A listener of the network that knows when an announcement of a change of action is in flight.

    An announcement is overheard when its transmission begins, not while it is queued. If a central server orders the
    actions, its orders are not announcements; a change of action is then overheard in the next report of the pursuer.

    Args:
        profile: the initial action of each pursuer.
    """

    def __init__(self, profile: Sequence[int]):
        self._actions = dict(enumerate(profile))
        self._changed: dict[int, int] = {}  # the sequence number of the last change of action, by pursuer
        self._last_arrival = 0  # of all announcements of a change, ns

    def __call__(self, content: Record | Message, last_arrival: int) -> None:
        """Overhear a transmission at its start; `last_arrival` is the time of its last arrival, ns, or `LOST`."""
        records = (content,) if isinstance(content, Record) else relayed_records(carried(content.body))
        for record in records or ():
            self._overhear(record, last_arrival)

    def hands_over(self, now: int) -> bool:
        """Return whether an announcement of a change of action is in flight at `now` (ns)."""
        return now < self._last_arrival

    def _overhear(self, record: Record, last_arrival: int) -> None:
        action, is_newer = announced_action(record.body), record.seq > self._changed.get(record.src, 0)
        if is_newer and action is not None and action != self._actions.get(record.src, 0):
            self._actions[record.src], self._changed[record.src] = action, record.seq
        if self._changed.get(record.src) == record.seq:  # the change itself, or a teammate that relays it
            self._last_arrival = max(self._last_arrival, last_arrival)


DISSEMINATIONS = OneOf(
    group="desim.disseminations", needs=("broadcast(me, announcement)",), takes=("me",), traits=DisseminationTraits
)
"""The installed ways to disseminate announcements."""


def one_hop() -> Any:
    """Create the default dissemination."""
    dissemination: Any = DISSEMINATIONS.choice("one_hop")
    return dissemination()


class Announcements(Value):
    """The content of announcements, when they are sent, and how long they are believed."""

    _replaced: ClassVar[Mapping[str, str]] = {
        "warm_start": ', use start: "known" instead of true, "silent" instead of false, or the default "announced"'
    }
    payload: Literal["action", "time", "state", "course"] = "action"
    """action: only the action is announced, positions are sensed (the paper); time: the action and the capture time at
    sending; state: the action, the position and the speed at sending; course: as state, and the velocity and the
    heading at sending, with which the motion of a teammate with inertia (`team.dynamics`) can be extrapolated."""
    reckoning: Literal["exact", "straight_line"] = "exact"
    """Dead reckoning of a moving teammate from its announced state. exact: along its path of pursuit if sensing is
    unlimited, else as straight_line; straight_line: straight towards the present position of the evader."""
    trigger: Literal["change", "heartbeat", "both", "revision", "never"] = "both"
    """When an action is announced after the start. change: when it changes; heartbeat: at every heartbeat; both: at
    either; revision: after every decision, even if the action has not changed; never."""
    start: Start = "announced"
    """How pursuers learn the initial actions. announced: each announces its first action at time 0, over the network,
    whatever the trigger; known: all know them at time 0 without a message; silent: the trigger decides when a pursuer
    announces its first action, and the others do not know the action until then.

    If in doubt, use announced: with known, initial knowledge crosses any network for free.
    """
    heartbeat: Period = 0.1
    """Time between two heartbeats of a pursuer, s.

    With a long time, teammates notice a lost announcement or a crash late, because beliefs last three heartbeats by
    default. A short time loads the channel with N messages per heartbeat.

    If in doubt, use half the mean time between two decisions of a pursuer.
    """
    jitter: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.0
    """Largest share by which the time between two heartbeats is longer or shorter than `heartbeat`, in [0, 1). Without
    jitter, heartbeats of two pursuers that overlap once on a contended channel overlap each time. On such a channel,
    the first announcement (`start`) is sent after a random time of up to this share of `heartbeat`.

    If in doubt, use 0.25 where nodes contend for a channel, as OLSR does (RFC 3626), and else 0.
    """
    belief_timeout: Annotated[
        Annotated[Timeout, Tag("number")] | Annotated[Literal["auto", "affordable"], Tag("text")],
        in_forms("text", "number"),
    ] = "auto"
    """Time for which an announcement is believed after its arrival, s; "auto" is 3 * heartbeat + 2 * (typical
    latency + airtime of an announcement), or inf without heartbeats. It is longer if a duty cycle or the slots of a
    TDMA keep a pursuer from sending every heartbeat. "affordable": as "auto", but no longer than the receiver can wait
    and still capture in time, and at least "auto" with one heartbeat in place of three. So a slow pursuer takes the
    place of a crashed one before it is too late. At worst, it chases beside a pursuer that is up.

    If in doubt, use auto; use affordable if pursuers may crash and hardly any other pursuer could be in time.
    """
    dissemination: Annotated[Any, DISSEMINATIONS] = Field(default_factory=one_hop)
    """How announcements spread beyond the first receivers."""
    trust: Annotated[Trust, TRUSTS] = Credulous()
    """Which announcements of its teammates a pursuer believes."""

    @property
    def payload_size(self) -> int:
        """Size of an announcement, header included, bytes.

        A protocol with its own payload declares the size as `claim_size` instead.
        """
        return HEADER + NUMBER * len(PAYLOADS[self.payload]._fields)

    @property
    def is_located(self) -> bool:
        """Whether an announcement contains the position of its sender."""
        return self.payload in {"state", "course"}

    @property
    def has_heartbeats(self) -> bool:
        """Whether the trigger includes heartbeats."""
        return self.trigger in {"heartbeat", "both"}

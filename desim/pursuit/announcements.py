"""What pursuers tell each other: what an announcement says, when it is made, and when it is no longer believed."""

from math import inf
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import Discriminator, Field, Tag

from desim.config.choice import OneOf
from desim.config.model import Flag, Period, Timeout, Value
from desim.kernel.events import Broadcast, Sent
from desim.kernel.message_size import HEADER, NUMBER
from desim.kernel.records import Record
from desim.pursuit.views import PursuerView


class Assignment(NamedTuple):
    """Payload "action": what a pursuer does. 24 bytes."""

    active: int
    """Which evader it chases, 1 .. M, or 0."""

    @classmethod
    def said_by(cls, pursuer: int, world: PursuerView) -> Self:
        """Return what a pursuer says now, by what it senses."""
        return cls(world.action(pursuer))


class TimedAssignment(NamedTuple):
    """Payload "time": what it does, and its time of capture as it says so. 32 bytes."""

    active: int
    capture_time: float
    """Of the evader it chases or, if it stays, of the one it would capture first, s."""

    @classmethod
    def said_by(cls, pursuer: int, world: PursuerView) -> Self:
        """Return what a pursuer says now, by what it senses."""
        action = world.action(pursuer)
        phi = [world.capture_times_of([pursuer], evader)[0] for evader in ([action] if action else world.evaders())]
        return cls(action, min(phi, default=inf))


class LocatedAssignment(NamedTuple):
    """Payload "state": what it does, where it is as it says so, and how fast it moves if it does. 48 bytes."""

    active: int
    x: float
    """m"""
    y: float
    """m"""
    speed: float
    """m/s"""

    @classmethod
    def said_by(cls, pursuer: int, world: PursuerView) -> Self:
        """Return what a pursuer says now, by what it senses."""
        place = world.place(pursuer)
        return cls(world.action(pursuer), place.real, place.imag, world.speed(pursuer))


PAYLOADS: dict[str, type[Assignment | TimedAssignment | LocatedAssignment]] = {
    "action": Assignment,
    "time": TimedAssignment,
    "state": LocatedAssignment,
}
"""What can be announced (`Announcements.payload`)."""


class Forwarded(NamedTuple):
    """Word of others, or of oneself, that is passed on."""

    records: tuple[Record, ...]
    hops: int = 1
    """How many more hops it may take, this one included."""


def tells_of_chase(body: Any) -> bool:
    """Return whether it is the word of one that chases; what protocols publish beside announcements is not."""
    return bool(getattr(body, "active", False))


def records_in(event: Broadcast | Sent) -> tuple[Record, ...]:
    """Return the records that a transmission carries: those it relays, or its own if it is an announcement."""
    relayed: tuple[Record, ...] | None = getattr(event.body, "records", None)
    if relayed is not None:
        return relayed
    return (Record(event.src, event.seq, event.created, event.body),) if isinstance(event, Broadcast) else ()


DISSEMINATIONS = OneOf(group="desim.disseminations", needs=("broadcast",))
"""The ways to spread word that are installed."""


def one_hop() -> Any:
    """Return the dissemination that is the default."""
    made: Any = DISSEMINATIONS.choice("one_hop")
    return made()


def _form(value: Any) -> str:
    return "word" if isinstance(value, str) and value != "Infinity" else "number"


class Announcements(Value):
    """What pursuers announce, when, and how long it is believed."""

    payload: Literal["action", "time", "state"] = "action"
    """action: positions are sensed, the action is heard (the paper); time: the action and the time of capture as of
    sending; state: the action, the position and the speed as of sending."""
    reckoning: Literal["exact", "straight_line"] = "exact"
    """How a moving teammate is extrapolated from its state: along its pursuit of the evader, or straight to it."""
    trigger: Literal["change", "heartbeat", "both", "revision", "never"] = "both"
    """When an action is announced: as it changes, every heartbeat, both, at every revision, or never."""
    heartbeat: Period = 0.1
    """Time between two heartbeats of a pursuer, s."""
    belief_timeout: Annotated[
        Annotated[Timeout, Tag("number")] | Annotated[Literal["auto"], Tag("word")], Discriminator(_form)
    ] = "auto"
    """How long after its last word arrived a teammate is believed active, s; "auto" is 3 heartbeats and twice the
    typical latency and airtime of an announcement, or inf without heartbeats."""
    warm_start: Flag = True
    """Whether everyone knows at first who is active; if not, nobody has heard of anybody."""
    dissemination: Annotated[Any, DISSEMINATIONS] = Field(default_factory=one_hop)
    """How word spreads beyond those who hear it first."""

    @property
    def payload_size(self) -> int:
        """Bytes of a payload; what an auction announces in its place takes `claim_size`."""
        return HEADER + NUMBER * len(PAYLOADS[self.payload]._fields)

    @property
    def beats(self) -> bool:
        """Whether there are heartbeats."""
        return self.trigger in {"heartbeat", "both"}

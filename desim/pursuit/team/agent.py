"""The agent: the interface through which a protocol controls one pursuer.

An agent senses its own position, the evaders within `sensing.radius` and, if `announce.payload` is "action", the
positions of its teammates. It learns the actions of teammates only from delivered messages; with `announce.start` =
"known" it knows the initial actions without messages.
"""

from collections.abc import Callable, Generator, Iterable
from functools import cached_property
from itertools import count
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
import simpy

from desim.config.arguments import HintedItems, value_text
from desim.kernel.core.clock import Clock, NodeClock, Phase
from desim.kernel.core.message_body import as_sent, differs
from desim.kernel.core.records import Record
from desim.kernel.core.seeds import stream
from desim.kernel.models.transport import Transport
from desim.kernel.network import Network
from desim.kernel.state.inbox import Message
from desim.pursuit.sensing.views import GlobalState, View
from desim.pursuit.team.announcements import PAYLOADS, Announcements, Located, LocatedAssignment, MovingAssignment
from desim.pursuit.team.beliefs import Beliefs
from desim.pursuit.team.judges import Judge
from desim.pursuit.team.timing import Timing

Process = Generator[simpy.Event, Any, None]
"""A running protocol: a generator that yields the SimPy events it waits for."""


class Voice(Protocol):
    """The operations with which a pursuer sends; the methods are those of `Network`."""

    def publish(self, src: int, body: Any, size: int | None = None, stamp: int | None = None) -> None:
        """Broadcast the state of a pursuer as a record."""

    def next_record(self, src: int, body: Any, stamp: int | None = None) -> Record:
        """Return a new record of a pursuer."""

    def send(
        self,
        src: int,
        dst: int | None,
        body: Any,
        port: str = "",
        *,
        size: int | None = None,
        transport: Transport | None = None,
    ) -> None:
        """Send a message to a pursuer, or to all neighbours."""


_TRIED = {
    "assign(action)": "act chase set_action",
    "evader()": "target",
    "id": "index number",
    "mail()": "get inbox messages receive recv",
    "now": "clock time",
    "position()": "pos xy",
    "position().imag": "y",
    "position().real": "x",
    "rng": "random",
    "sleep(duration)": "delay timeout wait",
    "speed": "velocity",
}
MEANT = MappingProxyType({name: instead for instead, names in _TRIED.items() for name in names.split()})
"""Names that users try on an agent, and what it has instead."""


class Agent(Beliefs, Timing, HintedItems):
    """The interface of a protocol to one pursuer.

    Its methods return what the pursuer knows (`Knowledge`) and believes (`Beliefs`), and the events that the protocol
    waits for (`Timing`); they set the action of the pursuer, and send and receive messages. A protocol waits by
    yielding an event that `at`, `sleep`, `arrival` or `after_decisions` returns. No method waits when it is called.

    Attributes:
        restarts: number of restarts without memory after a crash.
        global_state: the true state of the world and the actions of all pursuers, bypassing sensing and network; for
            omniscient benchmarks only.

    Args:
        pursuer: the id of the pursuer.
        env: the clock of the simulation.
        view: its view of the world.
        global_state: see the attribute; `assign` also sets the action of this pursuer through it.
        network: the network that carries its messages.
        seed: seed of its random streams.
        announcements: the content and the times of its announcements.
        clock: its local clock.
        voice: sends its messages; None: the network, which sends them unchanged.
        judge: decides which announcements it believes; None: it believes all.
    """

    def __init__(
        self,
        pursuer: int,
        env: Clock,
        view: View,
        global_state: GlobalState,
        network: Network,
        seed: int,
        announcements: Announcements,
        clock: NodeClock,
        voice: Voice | None = None,
        judge: Judge | None = None,
    ):
        Beliefs.__init__(self, pursuer, view, network, clock, announcements, self.announcement, judge)
        Timing.__init__(self, pursuer, env, clock, network)
        self.global_state, self._voice = global_state, voice or network
        self._seed, self._trigger = seed, announcements.trigger
        # The body set by `set_payload`; None: the standard body, which depends on `announce.payload`.
        self._payload: Any = None
        # The result of `_news` at the last announcement; None: the next announcement is due in any case. Used with the
        # triggers "change" and "both" only.
        self._announced: Any = None if announcements.start == "silent" else (self.action,)
        self._streams: dict[str, np.random.Generator] = {}

    def _instead_of(self, name: str) -> str:
        """Return what to write instead of an attribute that an agent does not have."""
        if name in MEANT:
            return f"write me.{MEANT[name]}"
        names = [other for other in dir(type(self)) if not other.startswith("_")]
        return f"it has {', '.join(f'{other}()' if callable(getattr(type(self), other)) else other for other in names)}"

    def recovered(self, *, restarted: bool) -> None:
        """Register the end of a crash. An announcement is then due, because the crash may have suppressed the last one.

        Args:
            restarted: whether the pursuer restarts without memory.
        """
        self._announced = None
        if restarted:
            self._payload = None
            self.restarts += 1
            self._stop_listening()
            if self._judge is not None:
                self._judge.forget()

    def stream(self, name: str) -> np.random.Generator:
        """Return the random stream of this pursuer with this name.

        Later calls with the same name return the same stream, which continues, also after a restart.

        Raises:
            ValueError: if the name is no text.
        """
        self._check_stream(name)
        if name not in self._streams:
            self._streams[name] = stream(self._seed, name, self.id)
        return self._streams[name]

    @cached_property
    def rng(self) -> np.random.Generator:
        """The random stream of the decisions of this pursuer."""
        return self.stream("decisions")

    def shared_stream(self, name: str) -> np.random.Generator:
        """Create a random stream that yields the same draws for every pursuer that uses this name.

        Raises:
            ValueError: if the name is no text.
        """
        self._check_stream(name)
        return stream(self._seed, f"shared {name}")

    def _check_stream(self, name: Any) -> None:
        """Raise ValueError if the name of a stream is no text; the text of an object may differ from run to run."""
        if not isinstance(name, str):
            raise ValueError(
                f"pursuer {self.id}: the name of a random stream should be a text (got {value_text(name)})"
            )

    # Actions and announcements.

    @property
    def action(self) -> int:
        """The evader that it chases, 1 .. M, or 0 if it is inactive."""
        return self._state.profile[self.id]

    @action.setter
    def action(self, action: int) -> None:
        raise AttributeError(f"the action of an agent is set by a call: me.assign({value_text(action)})")

    def assign(self, action: int) -> None:
        """Chase an evader (its number) or be inactive (0) from now on.

        Call it after each decision, then call `announce`. A pursuer that is down or may not chase this evader
        (`may_chase`) becomes inactive.

        Raises:
            ValueError: if there is no such evader.
        """
        self.global_state.set_action(self.id, action)

    def announce(self) -> None:
        """Announce the action of the pursuer after a decision, if an announcement is due (`announce.trigger`).

        Call it after every `assign`. Use `broadcast` to announce in any case.
        """
        trigger = self._trigger
        if trigger == "revision" or (trigger in {"change", "both"} and differs(self._news(), self._announced)):
            self.broadcast()

    def broadcast(self) -> None:
        """Announce the action of the pursuer through `announce.dissemination`, even if the action has not changed."""
        self._announced = None
        if self._trigger in {"change", "both"}:
            # The protocol may change the news of its own payload later, so these are copied.
            self._announced = self._news() if self._payload is None else as_sent(self._news())
        self._announcements.dissemination.broadcast(self, self.announcement())

    def _news(self) -> Any:
        """Return the value whose change makes an announcement due."""
        if self._payload is None:
            return (self._state.profile[self.id],)
        try:
            return self._payload.news
        except AttributeError as error:
            if hasattr(type(self._payload), "news"):
                raise
            raise ValueError(
                f"pursuer {self.id}: the payload should have an attribute news, since announce.trigger is"
                f" {self._announcements.trigger!r}, and a change of the news makes an announcement due (got"
                f" {value_text(self._payload)})"
            ) from error

    def set_payload(self, body: Any) -> None:
        """Set the body of all announcements from now on, in place of the standard payload; nothing is sent yet.

        Each announcement has the content that the body has when it is sent, see `send`. The attribute `active` of the
        body should be the action. With the trigger "change" or "both", the body should also have an attribute `news`:
        `announce` sends the body if `news` differs from that of the last announcement.
        """
        self._payload = body

    def announcement(self) -> Any:
        """Return the body that it would announce now."""
        if self._payload is not None:
            return self._payload
        return PAYLOADS[self._announcements.payload].announced_by(self.id, self._view)

    def located(self) -> Located:
        """Return the body that it would announce now if the payload were "state" or, with inertia, "course"."""
        payload = LocatedAssignment if self._view.state.dynamics.is_simple else MovingAssignment
        return payload.announced_by(self.id, self._view)

    def record(self, body: Any) -> Record:
        """Create its next record, with this body, for a dissemination model that does not use `publish`."""
        return self._voice.next_record(self.id, body, self._clock.stamp)

    def publish(self, body: Any, *, size: int | None = None) -> None:
        """Publish a record to all neighbours; a receiver reads the newest one at its next decision.

        Use it for state, of which only the newest value matters, and `send` for messages that must each be processed.
        `body` and `size` are as in `send`.

        Raises:
            ValueError: as `send`, because of the size or the body.
        """
        self._voice.publish(self.id, body, size, self._clock.stamp)

    def merge_records(self, records: Iterable[Record]) -> None:
        """Merge records received inside a message into this pursuer's table, which keeps the newest of each source.

        Raises:
            ValueError: if one is no record.
        """
        if not isinstance(records, Iterable):
            raise ValueError(f"pursuer {self.id}: merge_records takes a list of records (got {value_text(records)})")
        for record in records:
            if not isinstance(record, Record):
                raise ValueError(
                    f"pursuer {self.id}: merge_records takes records, as of me.record(body) (got {value_text(record)})"
                )
            self._network.insert(self.id, record)

    def send(
        self,
        dst: int | None,
        body: Any,
        port: str = "",
        *,
        size: int | None = None,
        transport: Transport | None = None,
    ) -> None:
        """Send a message to a teammate, or to all neighbours (None), into the inbox of a port.

        Use it for events: each message wakes a receiver that waits at this port (`arrival`) and then reads the message
        (`mail`). A body may be any object that can be copied. It is copied at sending, and for each receiver, unless
        all its parts are immutable (`desim.kernel.core.message_body`): later changes by the sender or by a receiver
        affect neither other messages nor the trace.

        Args:
            dst: the receiver; None: all neighbours.
            body: what is sent.
            port: the port of the inbox.
            size: the size of the message, bytes; None: computed from the body, see `desim.kernel.core.message_size`.
            transport: how the message is carried, for example retransmitted until it is acknowledged; None: as
                `network.transport` says. All messages at a port should have the same transport.

        Raises:
            ValueError: if the receiver is the sender, there is no such teammate, the size is not an integer of at least
                0, the body has no size or cannot be copied, the port is no text, `transport` is no transport, or
                messages at the port have another transport.
        """
        self._voice.send(self.id, dst, body, port=port, size=size, transport=transport)

    def mail(self, port: str = "") -> list[Message]:
        """Remove and return the unread messages of a port, without waiting."""
        return self._network.inbox(self.id, port).drain()


def repeat(me: Agent, act: Callable[[], object], period: float, name: str, jitter: float = 0.0) -> Process:
    """Return a process that calls a function once per period (s, local clock), after all decisions of the instant.

    The first call happens after a random fraction of the period, drawn from the stream `name` of the agent. Each later
    wait is longer or shorter than the period by a random share of up to `jitter`.
    """
    rng = me.stream(name)
    first = due = me.now + rng.uniform(0.0, period)
    for k in count(1):
        yield me.at(due, Phase.HEARTBEAT)
        act()
        # Without jitter, rounding errors do not add up.
        due = due + period * rng.uniform(1.0 - jitter, 1.0 + jitter) if jitter else first + k * period


def merge_relayed(me: Agent, port: str) -> Process:
    """Return a process that merges the records in all messages that arrive at a port."""
    while True:
        yield me.arrival(port, Phase.RELAY)
        for message in me.mail(port):
            me.merge_records(message.body.records)


Behaviour = Callable[[Agent], Process]
"""A protocol: a function that returns the process of a pursuer, given its agent."""

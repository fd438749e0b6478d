"""The messages of a team of which some members misbehave: what they say replaces what their protocols say.

An agent sends through a `Voice`, which in an honest team is the network (`desim.pursuit.voice`). Otherwise it is a
`LyingTeam`, which replaces the messages of the pursuers whose Byzantine faults (`desim.pursuit.lies`) are active.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import simpy

from desim.config.model import MAX_TIME
from desim.kernel.clock import Clock, Instant, Phase
from desim.kernel.events import Trace
from desim.kernel.faults import FaultEnded, FaultStarted, Misbehaviour
from desim.kernel.message_body import as_sent
from desim.kernel.message_size import size_of
from desim.kernel.network import Network
from desim.kernel.records import Record
from desim.kernel.seeds import stream
from desim.kernel.transport import Transport
from desim.kernel.units import nanoseconds
from desim.pursuit.agent import Agent, Process
from desim.pursuit.announcements import PAYLOADS, Announcements, Forwarded, relayed_records
from desim.pursuit.lies import ByzantineFault, ReplayAttack, Silent, Speaker
from desim.pursuit.trust import PORT as ACCUSATIONS
from desim.pursuit.views import View

PORT = "forged announcements"
"""The port at which announcements arrive that are not broadcast in the name of their sender."""
Lie = tuple[Misbehaviour, ByzantineFault]
SetAction = Callable[[int, int], None]
"""A function that sets the action of a pursuer."""


class LyingTeam:
    """The voice of a team of which some members misbehave.

    Args:
        env: the clock of the simulation.
        network: the network that carries all messages.
        views: (N,) the view of each pursuer.
        announcements: the content of announcements.
        seed: the seed of the run.
        set_action: sets the action of a pursuer in the world.
        lies: the Byzantine faults; see `desim.pursuit.lies.draw_lies`.
        trace: receives the events `FaultStarted` and `FaultEnded`.
    """

    def __init__(
        self,
        env: Clock,
        network: Network,
        views: Sequence[View],
        announcements: Announcements,
        seed: int,
        set_action: SetAction,
        lies: Sequence[Lie],
        trace: Trace,
    ):
        self._env, self._network, self._views, self._trace = env, network, views, trace
        self._payload, self._seed, self._set_action = PAYLOADS[announcements.payload], seed, set_action
        self._active: defaultdict[int, list[Lie]] = defaultdict(list)
        self._rng = {one.node: stream(seed, "words", one.node) for one, _ in lies}
        replaying = {one.node for one, model in lies if isinstance(model, ReplayAttack)}
        self._history: dict[int, list[tuple[int, Any]]] = {pursuer: [] for pursuer in replaying}
        for lie in lies:
            self._at(lie[0].start, partial(self._begin, lie))
            if lie[0].end <= MAX_TIME:
                self._at(lie[0].end, partial(self._end, lie))

    # What the pursuers do.

    def set_action(self, pursuer: int, action: int) -> None:
        """Set the action of a pursuer, or 0 if it should chase and a Byzantine fault lets it stay."""
        self._set_action(pursuer, 0 if self._stays(pursuer) else action)

    def publish(self, src: int, body: Any, size: int | None = None, stamp: int | None = None) -> None:
        """Broadcast the state of a pursuer, or what it says instead."""
        self._remember(src, body)
        self._accuse(src)
        if not self._active[src]:
            self._network.publish(src, body, size, stamp)
        elif not self._is_silent(src):
            name, said = self._says(src, body)
            told = self._says_to(src, said)
            if told is not None:
                for dst, each in told.items():
                    self._forge(src, dst, name, each, stamp)
            elif name == src:
                self._network.publish(src, said, size, stamp)
            else:
                self._forge(src, None, name, said, stamp)

    def next_record(self, src: int, body: Any, stamp: int | None = None) -> Record:
        """Return a new record of a pursuer, or of the teammate in whose name it speaks."""
        self._remember(src, body)
        self._accuse(src)
        name, said = self._says(src, body) if self._active[src] else (src, body)
        return self._network.next_record(name, said, stamp)

    def send(
        self,
        src: int,
        dst: int | None,
        body: Any,
        *,
        port: str = "",
        size: int | None = None,
        transport: Transport | None = None,
    ) -> None:
        """Send a message of a pursuer, or what it sends instead."""
        for to, said in self._messages(src, dst, body) if self._active[src] else [(dst, body)]:
            self._network.send(src, to, said, port=port, size=size, transport=transport)

    def unless_silent(self, pursuer: int, act: Callable[[], object]) -> Callable[[], object]:
        """Return a function that calls another one unless the pursuer is silent."""
        return lambda: None if self._is_silent(pursuer) else act()

    def receive(self, agent: Agent) -> Process:
        """Merge the records in forged announcements that an agent receives."""
        while True:
            yield agent.arrival(PORT, Phase.RELAY)
            for message in agent.mail(PORT):
                agent.merge_records(message.body.records)

    # What becomes of a message.

    def _says(self, src: int, body: Any) -> tuple[int, Any]:
        """Return what a pursuer announces in place of a body: in whose name, and the body."""
        name = src
        for _, model in self._active[src]:
            name, body = model.says(self._speaker(src), body)
        return name, body

    def _says_to(self, src: int, body: Any) -> dict[int, Any] | None:
        """Return the body that a pursuer announces to each neighbour; None if all get the same."""
        neighbours = self._network.topology.neighbours(src).tolist()
        told = (model.says_to(self._speaker(src), body, neighbours) for _, model in self._active[src])
        return next((each for each in told if each is not None), None)

    def _messages(self, src: int, dst: int | None, body: Any) -> Iterator[tuple[int | None, Any]]:
        """Yield the receiver and the body of each message that a pursuer sends in place of one."""
        if self._is_silent(src):
            return
        records = relayed_records(body)
        body = body if records is None else self._forwarded(src, body, records)
        if body is None:
            return
        own = next((record for record in relayed_records(body) or () if record.src == src), None)
        told = None if own is None else self._says_to(src, own.body)
        if own is None or told is None:
            yield dst, body
            return
        for to, said in told.items():
            if dst in {None, to}:
                mine = own._replace(body=said)
                yield to, body._replace(records=tuple(mine if each is own else each for each in body.records))

    def _forwarded(self, src: int, body: Any, records: tuple[Record, ...]) -> Any:
        """Return a message without the records of others that a pursuer withholds; None if nothing is left.

        A message that is more than its records, such as a token, is withheld as a whole.
        """
        if not isinstance(body, Forwarded):
            relays = any(record.src != src for record in records)
            return None if relays and self._drops(src) else body
        kept = tuple(record for record in records if record.src == src or not self._drops(src))
        return body._replace(records=kept) if kept else None

    def _forge(self, src: int, dst: int | None, name: int, body: Any, stamp: int | None) -> None:
        """Send an announcement as a message, with a record in the name of any pursuer."""
        record = self._network.next_record(name, body, stamp)
        self._network.send(src, dst, Forwarded((record,)), port=PORT, size=size_of(body))

    def _accuse(self, src: int) -> None:
        """Send the false accusations of a pursuer."""
        for _, model in self._active[src]:
            accusation = model.accuses()
            if accusation is not None:
                self._network.send(src, None, accusation, port=ACCUSATIONS)

    def _speaker(self, src: int) -> Speaker:
        history = self._history.get(src, ())
        return Speaker(src, self._views[src], self._payload, self._seed, self._rng[src], self._env.now, history)

    def _remember(self, src: int, body: Any) -> None:
        if src in self._history:
            self._history[src].append((self._env.now, as_sent(body)))

    def _is_silent(self, pursuer: int) -> bool:
        return any(isinstance(model, Silent) for _, model in self._active[pursuer])

    def _stays(self, pursuer: int) -> bool:
        return any(model.acts == "stay" for _, model in self._active[pursuer])

    def _drops(self, pursuer: int) -> bool:
        return any(model.drops(self._speaker(pursuer)) for _, model in self._active[pursuer])

    # When the faults begin and end.

    def _at(self, time: float, change: Callable[[simpy.Event], None]) -> None:
        Instant(self._env, nanoseconds(time), Phase.FAULT).callbacks.append(change)

    def _begin(self, lie: Lie, _: simpy.Event) -> None:
        self._trace.append(FaultStarted(self._env.now, lie[0]))
        self._active[lie[0].node].append(lie)
        if self._stays(lie[0].node) and self._views[lie[0].node].state.profile[lie[0].node]:
            self._set_action(lie[0].node, 0)

    def _end(self, lie: Lie, _: simpy.Event) -> None:
        self._trace.append(FaultEnded(self._env.now, lie[0]))
        self._active[lie[0].node].remove(lie)

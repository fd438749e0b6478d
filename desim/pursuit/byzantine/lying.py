"""The messages of a team of which some members misbehave: their false messages replace those of their protocols.

An agent sends through a `Voice`, which in an honest team is the network (`desim.pursuit.team.agent`). Otherwise it is a
`LyingTeam`, which replaces the messages of the pursuers whose Byzantine faults (`desim.pursuit.byzantine.lies`) are
active.
"""

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from operator import index
from typing import Any

import simpy

from desim.config.answers import wrong_answer
from desim.config.model import MAX_TIME
from desim.config.python_numbers import as_python
from desim.config.traits import is_ours
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Trace
from desim.kernel.core.message_body import as_sent
from desim.kernel.core.message_size import size_of
from desim.kernel.core.ports import ReservedPort
from desim.kernel.core.records import Record
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import nanoseconds
from desim.kernel.fault_injection import Targets
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.kernel.models.transport import BestEffort, Transport
from desim.kernel.network import Network
from desim.pursuit.byzantine.lies import ByzantineFault, Lie
from desim.pursuit.byzantine.speaker import Speaker
from desim.pursuit.sensing.views import View
from desim.pursuit.team.announcements import Forwarded, relayed_records, with_records
from desim.pursuit.team.judges import PORT as ACCUSATIONS
from desim.pursuit.team.judges import TRUTH, Accusation

PORT = ReservedPort("forged announcements", __name__)
"""The port of announcements that are in the name of a teammate, or that differ from neighbour to neighbour."""
AS_PUBLISHED = BestEffort()
"""The transport of forged announcements: like honest ones, which are published, they are transmitted once."""
SetAction = Callable[[int, int], None]
"""A function that sets the action of a pursuer."""
Version = tuple[Collection[int], Any]
"""What a pursuer announces to some neighbours: (the neighbours, the body)."""
Replacement = tuple[int | None, Collection[int] | None, Any]
"""A message that replaces another one: (receiver, or None: all; the neighbours that it is for, or None: all; body)."""


class LyingTeam:
    """The voice of a team of which some members misbehave.

    Args:
        env: the clock of the simulation.
        network: the network that carries all messages.
        views: (N,) the view of each pursuer.
        seed: the seed of the run.
        set_action: sets the action of a pursuer in the world.
        lies: the Byzantine faults; see `desim.pursuit.byzantine.lies.draw_lies`.
        targets: returns the pursuers that chase, in the order in which they would capture.
        trace: receives the events `FaultStarted` and `FaultEnded`.
    """

    def __init__(
        self,
        env: Clock,
        network: Network,
        views: Sequence[View],
        seed: int,
        set_action: SetAction,
        lies: Sequence[Lie],
        targets: Targets,
        trace: Trace,
    ):
        self._env, self._network, self._views, self._trace = env, network, views, trace
        self._seed, self._set_action = seed, set_action
        self._targets = targets
        self._active: defaultdict[int, list[ByzantineFault]] = defaultdict(list)
        self._rng = {pursuer: stream(seed, "words", pursuer) for lie in lies for pursuer in self._possible(lie)}
        replaying = {pursuer for lie in lies if lie.model.reads_history for pursuer in self._possible(lie)}
        self._history: dict[int, list[tuple[int, Any]]] = {pursuer: [] for pursuer in replaying}
        for lie in lies:
            self._at(lie.model.start, partial(self._begin, lie))

    # What the pursuers do.

    def set_action(self, pursuer: int, action: int) -> None:
        """Set the action of a pursuer; while one of its Byzantine faults makes it stay, the action is 0."""
        self._set_action(pursuer, 0 if self._stays(pursuer) else action)

    def publish(self, src: int, body: Any, size: int | None = None, stamp: int | None = None) -> None:
        """Broadcast the state of a pursuer, or what it says instead."""
        self._remember(src, body)
        if not self._active[src]:
            self._network.publish(src, body, size, stamp)
        elif not self._is_silent(src):
            name, announced = self._says(src, body)
            versions = self._says_to(src, announced)
            if versions is None and name == src:
                self._network.publish(src, announced, size, stamp)
            else:
                record = self._network.next_record(name, announced, stamp)
                for only, version in [(None, announced)] if versions is None else versions:
                    self._forge(src, only, record._replace(body=version), size)

    def next_record(self, src: int, body: Any, stamp: int | None = None) -> Record:
        """Return a new record of a pursuer, or of the teammate in whose name it speaks."""
        self._remember(src, body)
        name, announced = self._says(src, body) if self._active[src] else (src, body)
        return self._network.next_record(name, announced, stamp)

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
        """Send a message of a pursuer, or what it sends instead."""
        replacements = self._replacements(src, dst, body) if self._active[src] else [(dst, None, body)]
        for to, only, replacement in replacements:
            self._network.send(src, to, replacement, port=port, size=size, transport=transport, only=only)

    def unless_silent(self, pursuer: int, act: Callable[[], object]) -> Callable[[], object]:
        """Return a function that calls another one unless the pursuer is silent."""
        return lambda: None if self._is_silent(pursuer) else act()

    def accusing(self, pursuer: int, report: Callable[[], object]) -> Callable[[], object]:
        """Return a function that sends the false accusations of a pursuer or, without any, calls `report`."""

        def act() -> None:
            accusations = filter(None, map(_accusation, self._active[pursuer]))
            accused = {suspect for accusation in accusations for suspect in accusation.accused}
            if accused:
                self.send(pursuer, None, Accusation(tuple(sorted(accused))), port=ACCUSATIONS)
            else:
                report()

        return act

    # What becomes of a message.

    def _says(self, src: int, body: Any) -> tuple[int, Any]:
        """Return the pursuer in whose name a pursuer announces, and the body that it announces in place of `body`."""
        name = src
        for model in self._active[src]:
            answer: Any = model.says(self._speaker(src), body)
            if not is_ours(type(model)):
                _check_answer(answer, body, model)
            name, body = answer
        return name, body

    def _says_to(self, src: int, body: Any) -> list[Version] | None:
        """Return each body that a pursuer announces, with the nodes that it tells; None: all get the same."""
        linked = self._network.topology.linked(src)
        answers = (_versions(model, self._speaker(src), body, linked) for model in self._active[src])
        return next((versions for versions in answers if versions is not None), None)

    def _replacements(self, src: int, dst: int | None, body: Any) -> Iterator[Replacement]:
        """Yield each message that a pursuer sends in place of one."""
        if self._is_silent(src):
            return
        records = relayed_records(body)
        body = body if records is None else self._forwarded(src, body, records)
        if body is None:
            return
        original = next((record for record in relayed_records(body) or () if record.src == src), None)
        versions = None if original is None else self._says_to(src, original.body)
        if original is None or versions is None:
            yield dst, None, body
            return
        for only, version in versions:
            if dst is None or dst in only:
                forged = [
                    original._replace(body=version) if record is original else record
                    for record in relayed_records(body) or ()
                ]
                yield dst, only if dst is None else None, with_records(body, forged)

    def _forwarded(self, src: int, body: Any, records: Sequence[Record]) -> Any:
        """Return a message without the records of others that a pursuer withholds; None if nothing is left.

        A message that is more than its records, such as a token, is withheld as a whole.
        """
        if not isinstance(body, Forwarded):
            relays = any(record.src != src for record in records)
            return None if relays and self._drops(src) else body
        kept = tuple(record for record in records if record.src == src or not self._drops(src))
        return body._replace(records=kept) if kept else None

    def _forge(self, src: int, only: Collection[int] | None, record: Record, size: int | None) -> None:
        """Broadcast a record in the name of any pursuer, as the network broadcasts published records."""
        size = size_of(record.body) if size is None else size
        self._network.send(src, None, Forwarded((record,)), port=PORT, size=size, transport=AS_PUBLISHED, only=only)

    def _speaker(self, src: int) -> Speaker:
        history = self._history.get(src, ())
        return Speaker(src, self._views[src], self._seed, self._rng[src], self._env.now, history)

    def _remember(self, src: int, body: Any) -> None:
        if src in self._history:
            self._history[src].append((self._env.now, as_sent(body)))

    def _is_silent(self, pursuer: int) -> bool:
        return any(model.is_silent for model in self._active[pursuer])

    def _stays(self, pursuer: int) -> bool:
        return any(model.acts == "stay" for model in self._active[pursuer])

    def _drops(self, pursuer: int) -> bool:
        return any(_drops(model, self._speaker(pursuer)) for model in self._active[pursuer])

    # When the faults begin and end.

    def _at(self, time: float, change: Callable[[simpy.Event], None]) -> None:
        Instant(self._env, nanoseconds(time), Phase.FAULT).callbacks.append(change)

    def _possible(self, lie: Lie) -> Collection[int]:
        """Return the pursuers that a fault may concern."""
        return range(len(self._views)) if lie.pursuer is None else (lie.pursuer,)

    def _begin(self, lie: Lie, _: simpy.Event) -> None:
        pursuer = next(iter(self._targets()), None) if lie.pursuer is None else lie.pursuer
        if pursuer is None:
            return
        misbehaviour = lie.misbehaviour(pursuer)
        self._trace.append(FaultStarted(self._env.now, misbehaviour))
        self._active[pursuer].append(lie.model)
        if self._stays(pursuer) and self._views[pursuer].state.profile[pursuer]:
            self._set_action(pursuer, 0)

        def end(_: simpy.Event) -> None:
            self._trace.append(FaultEnded(self._env.now, misbehaviour))
            self._active[pursuer].remove(lie.model)

        if misbehaviour.end <= MAX_TIME:
            self._at(misbehaviour.end, end)


def _versions(model: ByzantineFault, speaker: Speaker, body: Any, neighbours: Sequence[int]) -> list[Version] | None:
    """Return each body that a fault announces to some neighbours, or None; see `ByzantineFault.says_to`.

    Raises:
        AnswerError: if a fault of a user returns anything else, or a body of another type.
    """
    answer: list[Version] | None = model.says_to(speaker, body, neighbours)
    if answer is None or is_ours(type(model)):
        return answer
    cause = None
    try:
        versions: list[Version] = [(frozenset(map(index, told)), version) for told, version in answer]
    except (TypeError, ValueError) as error:
        versions, cause = [((), None)], error
    if all(isinstance(version, type(body)) for _, version in versions):
        return versions
    form = f"pairs of neighbours and a body of the type {type(body).__name__}, [([1, 2], body)] for instance, or None"
    raise wrong_answer(f"says_to(me, body, neighbours) should return {form}", answer, model) from cause


def _drops(model: ByzantineFault, speaker: Speaker) -> bool:
    """Return whether a fault withholds what a pursuer should forward; see `ByzantineFault.drops`.

    Raises:
        AnswerError: if a fault of a user returns no boolean.
    """
    withheld: Any = model.drops(speaker)
    if not isinstance(withheld, TRUTH):
        raise wrong_answer("drops(me) should return True or False", withheld, model)
    return bool(withheld)


def _accusation(model: ByzantineFault) -> Accusation | None:
    """Return the accusation of a fault, or None; see `ByzantineFault.accuses`.

    Raises:
        AnswerError: if a fault of a user returns anything else.
    """
    answer: Any = model.accuses()
    if answer is None:
        return None
    try:
        return Accusation(tuple(map(index, answer.accused)))
    except (AttributeError, TypeError) as error:
        form = "accuses() should return an Accusation of teammates, Accusation((1, 2)) for instance, or None"
        raise wrong_answer(form, answer, model) from error


def _check_answer(answer: Any, body: Any, model: ByzantineFault) -> None:
    """Check what a fault of a user says in place of a body; a body of another type would count as an inactive pursuer.

    Raises:
        AnswerError: if the answer is not a pursuer and a body of the same type.
    """
    is_pair = isinstance(answer, tuple | list) and len(answer) == 2 and type(as_python(answer[0])) is int
    if not is_pair or not isinstance(answer[1], type(body)):
        form = f"says(me, body) should return a pursuer and a body of the type {type(body).__name__}"
        raise wrong_answer(form, answer, model)

"""Byzantine faults: pursuers whose messages are false, forged, old or withheld.

The term is that of Lamport, Shostak & Pease (1982, "The Byzantine Generals Problem"). A Byzantine fault names its
pursuers or a random share of the team. While it lasts, the messages of such a pursuer are replaced; its protocol,
beliefs and motion are not changed, except that with `acts = "stay"` it does not chase. `desim.pursuit.byzantine.lying`
applies these models in a run.
"""

from bisect import bisect_right
from cmath import isfinite
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from math import inf, isnan
from operator import itemgetter
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self, TypeGuard

import numpy as np
from pydantic import model_validator

from desim.config.answers import wrong_answer
from desim.config.choice import OneOf
from desim.config.model import AnyOrder, Duration, Extent, FirstError, Flag, NotEmpty, Probability, Rate, Value
from desim.config.python_numbers import as_complex, as_real
from desim.config.traits import check_inherited_flag, kind_of
from desim.kernel.core.seeds import pair_uniform, stream
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.fault_plans import FAULTS, MIN_FAULT_DURATION, PLANNED_WITH
from desim.kernel.models.faults import NamedNodes, Window
from desim.kernel.models.graphs import Node
from desim.kernel.models.traced_faults import Misbehaviour
from desim.kernel.models.traits import FaultTraits
from desim.pursuit.byzantine.falsehoods import FALSE_POSITIONS, FALSE_TIMES
from desim.pursuit.byzantine.speaker import CHASE_OR_STAY, Falsifiable, Said, Speaker
from desim.pursuit.core.traits import AssumptionName
from desim.pursuit.team.announcements import Announcement, Assignment, Located, TimedAssignment
from desim.pursuit.team.judges import Accusation
from desim.pursuit.team.targeted_faults import TARGETED


class ByzantineFault(Window):
    """Base of the Byzantine faults: the pursuers concerned, and how they act.

    A class of a user derives from it, or from one of its kinds, and is then a kind "module:Name". The methods below say
    what such a pursuer sends; each that is not overridden is honest. A plan of such faults derives from `RandomLies`.
    """

    is_silent: ClassVar[bool] = False
    """Whether a pursuer sends nothing."""
    reads_history: ClassVar[bool] = False
    """Whether it needs the `history` of a speaker."""

    node: Node | None = None
    """The number of the pursuer; give this, `chaser` or `share`."""
    chaser: Flag = False
    """Whether the fault concerns the pursuer that chases when it begins; of several, the one that would capture first.
    Its lies do most harm, because the others rely on it. If no pursuer chases, the fault has no effect."""
    share: Probability | None = None
    """The share of the team, in [0, 1], drawn at random per seed; a larger share adds pursuers to a smaller one."""
    acts: Literal["protocol", "stay"] = "protocol"
    """Actions of these pursuers. protocol: those of their protocol; stay: they never chase."""

    @model_validator(mode="after")
    def _names_pursuers(self) -> Self:
        if (self.node is not None) + (self.share is not None) + self.chaser != 1:
            raise ValueError("should have one of these: a node, chaser = true, or a share of the team")
        return self

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterator["ByzantineFault"]:
        """Yield the fault itself."""
        yield self

    def liars(self, size: int, rng: np.random.Generator) -> Sequence[int | None]:
        """Return the pursuers concerned, in a team of some size; None: the chaser, known when the fault begins."""
        if self.share is None:
            return [self.node]
        drawn: list[int] = rng.permutation(size)[: round(self.share * size)].tolist()
        return sorted(drawn)

    def named(self) -> NamedNodes:
        """Return the pursuers that it names, by key."""
        return {} if self.node is None else {"node": [self.node]}

    def says(self, me: Speaker, body: Any) -> tuple[int, Any]:
        """Return the pursuer in whose name a pursuer announces, and the body that it announces in place of `body`."""
        return me.id, body

    def says_to(self, me: Speaker, body: Any, neighbours: Sequence[int]) -> list[tuple[Collection[int], Any]] | None:
        """Return each body that a pursuer announces, with the neighbours that it tells; None: all get the same."""
        return None

    def drops(self, me: Speaker) -> bool:
        """Return whether a pursuer withholds a record, or a token, of others that it should forward."""
        return False

    def accuses(self) -> Accusation | None:
        """Return the accusation that a pursuer sends in place of its own, once per `Trust.period`; None: its own."""
        return None


class Silent(ByzantineFault):
    """A pursuer sends nothing, but still receives and decides."""

    kind: Literal["silent"] = "silent"

    is_silent: ClassVar[bool] = True


class FalseAnnouncements(ByzantineFault):
    """Base of the Byzantine faults whose announcements have a false capture time or a false position.

    A lie has an effect if the announcement contains what it falsifies: the payload "time" has a capture time, "state" a
    position, and each payload the action. The claims of auctions have the action and, as a bid, the capture time.
    """

    phi: Annotated[Any, FALSE_TIMES] | None = None
    """The capture time that is announced; if absent, the true one."""
    position: Annotated[Any, FALSE_POSITIONS] | None = None
    """The position that is announced; if absent, the true one."""

    def falsified(self, me: Speaker, body: Any, action: int) -> Any:
        """Return an announcement with this action and with a false capture time and position."""
        if isinstance(body, Falsifiable):
            return body.falsified(me.id, action, self._announced_phi(me, action, me.phi(action)))
        if isinstance(body, TimedAssignment):
            truth = body.capture_time if action == body.active else me.phi(action)
            return TimedAssignment(action, self._announced_phi(me, action, truth))
        if isinstance(body, Located):
            place = complex(body.x, body.y)
            place = place if self.position is None else self._announced_place(place, me)
            return body._replace(active=action, x=place.real, y=place.imag)
        return Assignment(action) if isinstance(body, Assignment) else body

    def _announced_phi(self, me: Speaker, action: int, truth: float) -> float:
        if self.phi is None:
            return truth
        answer: Any = self.phi(truth, me.least_phi(action), me.rng)
        phi = as_real(answer)
        if isnan(phi):
            raise wrong_answer("a false capture time, in s, should be a number or inf", answer, self.phi)
        return phi

    def _announced_place(self, truth: complex, me: Speaker) -> complex:
        answer: Any = self.position(truth, me.rng)  # type: ignore[misc]  # the caller knows that there is one
        place = as_complex(answer)
        if not isfinite(place):
            expected = "a false position should be a finite complex number, x + yj in m"
            raise wrong_answer(expected, answer, self.position)
        return place


class Liar(FalseAnnouncements):
    """A pursuer announces a false action, capture time or position."""

    kind: Literal["liar"] = "liar"
    action: Said = "truth"
    """The action that it announces."""

    def says(self, me: Speaker, body: Any) -> tuple[int, Any]:
        """Return the false announcement of a pursuer."""
        return me.id, self.falsified(me, body, me.action(self.action))


class Spoof(FalseAnnouncements):
    """A pursuer announces in the name of a teammate, and nothing in its own name.

    Nothing in the message shows the forgery. The forged record takes the next sequence number of the victim, so it
    replaces what the victim has announced, until the victim announces again.
    """

    kind: Literal["spoof"] = "spoof"
    victim: Node | None = None
    """The teammate; if absent, a random one for each announcement."""
    action: Said = "opposite"
    """The action that is announced; "truth" and "opposite" refer to the action of the teammate."""

    def named(self) -> NamedNodes:
        """Return the pursuers that it names, by key."""
        return {**super().named(), **({} if self.victim is None else {"victim": [self.victim]})}

    def says(self, me: Speaker, body: Any) -> tuple[int, Any]:
        """Return the forged announcement."""
        size, victim = me.view.state.size, self.victim
        if victim is None:
            victim = (me.id + int(me.rng.integers(1, size))) % size if size > 1 else me.id
        as_victim = replace(me, id=victim)
        if isinstance(body, Announcement):
            body = type(body).announced_by(victim, me.view)
        return victim, self.falsified(as_victim, body, as_victim.action(self.action))


class Equivocate(FalseAnnouncements):
    """A pursuer tells some neighbours that it chases, and the others that it stays.

    It broadcasts two messages, and each neighbour ignores one of them. Which one is drawn for each neighbour, once per
    seed.
    """

    kind: Literal["equivocate"] = "equivocate"

    def says_to(self, me: Speaker, body: Any, neighbours: Sequence[int]) -> list[tuple[Collection[int], Any]]:
        """Return the two bodies, each with the neighbours that are told it."""
        chase, stay = (self.falsified(me, body, me.action(says)) for says in CHASE_OR_STAY)
        drawn = pair_uniform(me.seed, "equivocation", me.id, np.array(neighbours, int), symmetric=False).tolist()
        told_chase = {j for j, draw in zip(neighbours, drawn, strict=True) if draw < 0.5}
        versions = (told_chase, chase), (set(neighbours) - told_chase, stay)
        return [(told, version) for told, version in versions if told]


class ReplayAttack(ByzantineFault):
    """A pursuer announces again what it announced some time ago, as if it were new."""

    kind: Literal["replay"] = "replay"
    delay: Duration = 5.0
    """Age of the repeated announcements, s. Until an announcement is this old, the pursuer repeats its first one."""

    reads_history: ClassVar[bool] = True

    def says(self, me: Speaker, body: Any) -> tuple[int, Any]:
        """Return the old announcement."""
        latest = bisect_right(me.history, me.now - nanoseconds(self.delay), key=itemgetter(0)) - 1
        return me.id, me.history[max(latest, 0)][1] if me.history else body


class Selective(ByzantineFault):
    """A pursuer withholds what it should forward: records of others, and tokens; its own announcements are honest."""

    kind: Literal["selective"] = "selective"
    drop: Probability = 1.0
    """Probability that a record or a token is withheld, in [0, 1]."""

    def drops(self, me: Speaker) -> bool:
        """Return whether a record or a token is withheld."""
        return bool(me.rng.random() < self.drop)


class Slander(ByzantineFault):
    """A pursuer accuses given teammates in place of those that it distrusts (`announce.trust` "accusations")."""

    kind: Literal["slander"] = "slander"
    accused: Annotated[tuple[Node, ...], FirstError(), NotEmpty(), AnyOrder()]
    """The teammates that it accuses."""

    def named(self) -> NamedNodes:
        """Return the pursuers that it names, by key."""
        return {**super().named(), "accused": self.accused}

    def accuses(self) -> Accusation | None:
        """Return the false accusation."""
        return Accusation(self.accused)


class RandomLies(Value):
    """Random Byzantine faults with random parameters, for soak tests."""

    kind: Literal["random_lies"] = "random_lies"
    rate: Rate = 1.0
    """Rate of faults, 1/s."""
    mean_duration: Duration = 1.0
    """Mean duration of a fault, s."""
    end: Extent = inf
    """Time by which all faults have ended, s."""

    def __call__(self, size: int, horizon: float, rng: np.random.Generator) -> Iterator[ByzantineFault]:
        """Yield the faults that start before `end` and the horizon, s, ordered by start time."""
        t, end = 0.0, min(self.end, horizon)
        while (t := t + rng.exponential(1.0 / self.rate)) < end - MIN_FAULT_DURATION:
            until = min(t + max(rng.exponential(self.mean_duration), MIN_FAULT_DURATION), self.end)
            yield self._lie(int(rng.integers(size)), {"start": t, "end": until}, rng)

    def _lie(self, pursuer: int, window: dict[str, float], rng: np.random.Generator) -> ByzantineFault:
        acts: Any = ("protocol", "stay")[rng.integers(2)]
        action: Any = ("truth", "chase", "stay", "opposite")[rng.integers(4)]
        phi = (None, "constant", "scaled", "random", "plausible")[rng.integers(5)]
        position = (None, "shifted", "random")[rng.integers(3)]
        kind = LIES[rng.integers(len(LIES))]
        parameters = {"action": action, "phi": phi, "position": position, "delay": 0.5, "drop": 0.5}
        parameters["accused"] = (int(rng.integers(pursuer + 1)),)
        accepted = {key: value for key, value in parameters.items() if key in kind.model_fields}
        return kind(node=pursuer, acts=acts, **window, **accepted)


class PursuerFaultTraits(FaultTraits):
    """The optional attributes of a fault in a pursuit; `breaks` names assumptions of protocols."""

    breaks: frozenset[AssumptionName] = frozenset()

    @classmethod
    def check(cls, value: Any) -> None:
        """Raise ValueError if `is_silent` is inherited as true, so that methods of the class are never called."""
        super().check(value)
        check_inherited_flag(value, "is_silent", ("says", "says_to", "drops", "accuses"), "a pursuer sends nothing")


LIES: tuple[type[ByzantineFault], ...] = (Liar, Silent, ReplayAttack, Spoof, Equivocate, Selective, Slander)
"""The Byzantine faults."""
PURSUER_FAULTS = OneOf(*FAULTS.models, *TARGETED, *LIES, RandomLies, takes=PLANNED_WITH, traits=PursuerFaultTraits)
"""The kinds of `[[fault]]` in a scenario: faults of the network, faults of chasers, and the Byzantine faults."""


def is_lie(fault: object) -> TypeGuard[ByzantineFault | RandomLies]:
    """Return whether a fault of a scenario is a Byzantine fault, or a plan of them."""
    return isinstance(fault, ByzantineFault | RandomLies)


class Lie(NamedTuple):
    """A Byzantine fault of one pursuer in a run."""

    pursuer: int | None
    """None: the pursuer that chases when the fault begins."""
    model: ByzantineFault
    number: int
    """Its number in the run, from 0 on."""

    def misbehaviour(self, pursuer: int) -> Misbehaviour:
        """Return the record of the fault in a trace, given the pursuer concerned."""
        model = self.model
        return Misbehaviour(node=pursuer, start=model.start, end=model.end, model=kind_of(model), number=self.number)


def draw_lies(faults: Sequence[object], size: int, horizon: float, seed: int) -> list[Lie]:
    """Draw the Byzantine faults of a run, one for each pursuer concerned.

    Each model has a random stream of its own; faults of the network are left out.
    """
    drawn: list[Lie] = []
    for number, fault in enumerate(faults):
        if is_lie(fault):
            rng = stream(seed, "faults of word", number)
            for model in fault(size, horizon, rng):
                if not isinstance(model, ByzantineFault):
                    raise wrong_answer("a plan of lies should return or yield Byzantine faults", model, fault)
                for pursuer in model.liars(size, rng):
                    drawn.append(Lie(pursuer, model, len(drawn)))
    return drawn

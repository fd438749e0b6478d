"""A scenario: a whole experiment as one frozen, validated value, the same from a script and from a file."""

from collections.abc import Iterator
from math import inf
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from desim.config.choice import OneOf
from desim.config.model import (
    MIN_PERIOD,
    RESOLUTION,
    Box,
    Coordinate,
    Flag,
    Horizon,
    Length,
    Limit,
    Period,
    Probability,
    Recurring,
    Speed,
    Time,
    Value,
)
from desim.kernel.faults import FAULTS
from desim.kernel.links import Links
from desim.kernel.seeds import stream
from desim.kernel.topology import Topology
from desim.pursuit.agent import Behaviour
from desim.pursuit.announcements import Announcements
from desim.pursuit.evader import EvaderController
from desim.pursuit.evasion import STRATEGIES, PureEvasion, Strategy
from desim.pursuit.guidance import ConstantBearing, Guidance, PurePursuit
from desim.pursuit.sensing import Sensing
from desim.scenario.sweep_table import Sweep


def _never_or_period(time: float) -> float:
    if 0.0 < time < MIN_PERIOD:
        raise ValueError(f"should be 0 or at least {MIN_PERIOD:g} s (got {time:g})")
    return time


def _not_over_at_once(horizon: float) -> float:
    if 0.0 < horizon < RESOLUTION:
        raise ValueError(f"should be at least {RESOLUTION:g} s (got {horizon:g})")
    return horizon


Point = tuple[Coordinate, Coordinate]
PROTOCOLS = OneOf(group="desim.protocols", takes=("me",))
"""The protocols that are installed."""


class Speeds(Value):
    """One speed for all but the last pursuer, another for the last."""

    default: Speed = 1.0
    """Speed of all pursuers but the last, m/s."""
    last: Speed = 2.0
    """Speed of the last pursuer, m/s."""


def _form_of_speeds(value: Any) -> str:
    if isinstance(value, dict | Speeds):
        return "table"
    return "list" if isinstance(value, list | tuple) else "number"


class Team(Value):
    """The pursuers: how many, from where, how fast, and who chases at first."""

    count: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] = 20
    """Number of pursuers N; follows from `positions` if they are given."""
    positions: tuple[Point, ...] | None = None
    """Initial positions, one [x, y] per pursuer, m; if absent they are drawn from `box`, anew for every seed."""
    box: Box = (0.0, 20.0)
    """Lower and upper bound of both initial coordinates, m."""
    speeds: Annotated[
        Annotated[Speed, Tag("number")] | Annotated[tuple[Speed, ...], Tag("list")] | Annotated[Speeds, Tag("table")],
        Discriminator(_form_of_speeds),
    ] = Speeds()
    """Speeds, m/s: one number, one per pursuer, or a table { default, last }."""
    active_at_start: Probability = 1.0
    """Probability p0 with which each pursuer is active at first, in [0, 1]; who has no choice (`prune`) stays."""
    guidance: Annotated[Guidance, OneOf(PurePursuit, ConstantBearing, takes=("gaps", "aims", "flight", "speeds"))] = (
        PurePursuit()
    )
    """How who chases heads for the evader."""

    @model_validator(mode="before")
    @classmethod
    def _count_positions(cls, given: Any) -> Any:
        positions = given.get("positions") if isinstance(given, dict) else None
        if isinstance(positions, list | tuple) and positions and "count" not in given:
            return given | {"count": len(positions)}
        return given

    @field_validator("positions", "speeds")
    @classmethod
    def _one_per_pursuer(cls, given: Any, info: ValidationInfo) -> Any:
        count = info.data.get("count")
        if isinstance(given, tuple) and count is not None and len(given) != count:
            raise ValueError(f"should be one per pursuer: count is {count}, there are {len(given)}")
        return given

    def all_speeds(self) -> list[float]:
        """Return the (N,) speeds, m/s."""
        if isinstance(self.speeds, Speeds):
            return [self.speeds.default] * (self.count - 1) + [self.speeds.last]
        return list(self.speeds) if isinstance(self.speeds, tuple) else [self.speeds] * self.count

    def start(self, seed: int) -> NDArray[np.float64]:
        """Return the (N, 2) initial positions, m."""
        if self.positions is not None:
            return np.array(self.positions)
        return stream(seed, "pursuers").uniform(*self.box, size=(self.count, 2))

    def start_profile(self, seed: int) -> NDArray[np.bool_]:
        """Return (N,) who is active at first."""
        return stream(seed, "start").random(self.count) < self.active_at_start


class Evader(Value):
    """An evader, or several that are alike: from where, how fast, and by what strategy they flee."""

    count: Annotated[int, Field(ge=1, le=1_000, strict=True)] = 1
    """Number of such evaders."""
    position: Point | None = None
    """Initial position [x, y], m; if absent it is drawn from `box`, anew for every seed."""
    box: Box = (8.0, 12.0)
    """Lower and upper bound of both initial coordinates, m."""
    speed: Speed = 0.9
    """Speed v_e, m/s."""
    strategy: Annotated[Strategy, STRATEGIES] = PureEvasion()
    """How it flees."""
    sensing_range: Limit = inf
    """Distance up to which it sees pursuers, m."""
    reaction_delay: Time = 0.0
    """Time by which it is late, s: it sees where pursuers were, and who chased, that long ago."""

    def start(self, seed: int, index: int = 0) -> NDArray[np.float64]:
        """Return the (2,) initial position, m, of the evader with this index among all of the scenario."""
        if self.position is not None:
            return np.array(self.position)
        return stream(seed, "evader", index).uniform(*self.box, size=2)

    @property
    def listens(self) -> bool:
        """Whether it hears the pursuers' radio."""
        return bool(getattr(self.strategy, "listens", False))

    def controller(self, rng: np.random.Generator, speeds: NDArray[np.float64], radius: float) -> EvaderController:
        """Return what one such evader perceives and chooses in a run.

        Args:
            rng: its own.
            speeds: (N,) of the pursuers, m/s.
            radius: distance at which it is captured, m.
        """
        return EvaderController(
            self.strategy,
            rng,
            speed=self.speed,
            speeds=speeds,
            radius=radius,
            sight=self.sensing_range,
            reaction_delay=self.reaction_delay,
        )


def _some(evaders: tuple[Evader, ...]) -> tuple[Evader, ...]:
    if not evaders:  # `min_length` would count only the valid ones
        raise ValueError("should have at least one table")
    return evaders


def _form_of_evaders(value: Any) -> str:
    return "list" if isinstance(value, list | tuple) else "table"


class Capture(Value):
    """When the evader is captured."""

    radius: Length = 0.1
    """Distance eps at which the evader is captured, m."""
    test: Literal["segment", "sample"] = "segment"
    """segment: at the very instant the distance falls to the radius; sample: judged at motion steps only."""
    captures_to_end: Annotated[int, Field(ge=1, strict=True)] | None = None
    """Number of captures that end the run; if absent, all evaders."""


class Motion(Value):
    """How motion is integrated."""

    step: Period = 0.01
    """Time h between two headings, s."""
    order: Literal["evader_first", "simultaneous"] = "evader_first"
    """Whether pursuers head for where the evader will be at the end of the step (the paper), or for where it was
    at its beginning."""
    static: Flag = False
    """Nobody moves and the time left stays at the horizon: the game of t = 0 is negotiated for the whole run."""


class Recording(Value):
    """What is recorded beside decisions."""

    trajectory: Annotated[Time, AfterValidator(_never_or_period), Recurring] = 0.05
    """Time between samples of all positions, s; 0 = none."""
    messages: Literal[False, True, "file"] = False
    """Whether every message is recorded, or only their number; file: in the trace of an output folder alone, as it
    happens, for more than fit in memory; ages and beliefs are not measured then."""


def _default_protocol() -> Any:
    sap = PROTOCOLS.choice("sap")
    if sap is None:
        raise ValueError("no protocols are installed: pip install -e . in the folder of desim")
    return sap()


class Scenario(Value):
    """A whole experiment; the default is the scenario of Lee & Bakolas with 20 pursuers and an ideal network."""

    name: str = "unnamed"
    """What it is called in tables and pictures."""
    seed: Annotated[int, Field(ge=0, strict=True)] = 0
    """Seed of every random stream of the run."""
    horizon: Annotated[Horizon, AfterValidator(_not_over_at_once)] = 30.0
    """Time t_f at which the pursuit ends if the evader has not been captured, s."""
    prune: Literal["none", "inf", "infeasible"] = "inf"
    """Who has no choice but to stay, whatever the protocol: nobody; who can never capture (phi = inf); or also who
    would be late (phi >= r). It holds from the start, whatever `team.active_at_start` draws."""
    team: Team = Team()
    evader: Annotated[
        Annotated[Evader, Tag("table")] | Annotated[tuple[Evader, ...], AfterValidator(_some), Tag("list")],
        Discriminator(_form_of_evaders),
    ] = Evader()
    """Who flees: a table or, for evaders that differ, a list of tables."""
    sensing: Sensing = Sensing()
    """What the pursuers see of it."""
    capture: Capture = Capture()
    motion: Motion = Motion()
    protocol: Annotated[Behaviour, PROTOCOLS] = Field(default_factory=_default_protocol)
    """How the pursuers negotiate; `desim protocols` lists the kinds."""
    announce: Announcements = Field(default_factory=Announcements)
    """What the pursuers tell each other, and when."""
    network: Links = Links()
    fault: tuple[Annotated[Any, FAULTS], ...] = ()
    """What breaks."""
    record: Recording = Recording()
    sweep: Sweep = Sweep()

    @property
    def evaders(self) -> tuple[Evader, ...]:
        """(M,) what each evader is like; evader j of an action is number j - 1 of them."""
        kinds = self.evader if isinstance(self.evader, tuple) else (self.evader,)
        return tuple(kind for kind in kinds for _ in range(kind.count))

    @property
    def protocol_name(self) -> str:
        """The kind of its protocol, or its name if it has none."""
        protocol = self.protocol
        return str(getattr(protocol, "kind", None) or getattr(protocol, "__name__", type(protocol).__name__))

    @property
    def speaks(self) -> bool:
        """Whether pursuers announce what they do: with some protocols never, or only if positions are not sensed."""
        announces = getattr(self.protocol, "announces", True)
        return self.announce.payload != "action" if announces == "unseen" else bool(announces)

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        found = list(self._misfits())
        if found:
            text = "; ".join(f"{'.'.join(map(str, place))}: {why}" for place, why in found)
            raise PydanticCustomError("misfits", "{text}", {"text": text, "misfits": found})
        return self

    def _misfits(self) -> Iterator[tuple[tuple[str | int, ...], str]]:
        """Yield what does not fit the team: where it is, and why."""
        count = self.team.count
        nobody = f"there is no pursuer {{}}: they are 0 .. {count - 1}"
        graph = None
        try:
            made = self.network.graph(count)
            if len(made) != count or made.is_multigraph():
                raise ValueError(f"should be a simple graph of {count} nodes, got {made}")
            Topology(made)
            graph = made
        except (ValueError, TypeError, AttributeError) as error:
            yield ("network", "graph"), str(error)
        seen: dict[tuple[int, int], int] = {}
        for k, link in enumerate(self.network.link):
            strangers = [end for end in ("src", "dst") if getattr(link, end) >= count]
            yield from ((("network", "link", k, end), nobody.format(getattr(link, end))) for end in strangers)
            twice = [way for way in link.ways() if seen.setdefault(way, k) != k]
            for src, dst in twice[:1]:
                yield ("network", "link", k), f"the link from {src} to {dst} is network.link.{seen[src, dst]} already"
            for src, dst in link.ways() if not strangers else ():
                if graph is not None and not graph.has_edge(src, dst):
                    yield ("network", "link", k), f"there is no link from {src} to {dst} in the graph"
        if (needed := self.capture.captures_to_end) is not None and needed > (number := len(self.evaders)):
            yield (
                ("capture", "captures_to_end"),
                f"there {'is' if number == 1 else 'are'} only {number} to capture (got {needed})",
            )
        if isinstance(host := getattr(self.protocol, "host", None), int) and host >= count:
            yield ("protocol", "host"), nobody.format(host)
        for k, fault in enumerate(self.fault):
            if (node := getattr(fault, "node", None)) is not None and node >= count:
                yield ("fault", k, "node"), nobody.format(node)
            for node in (node for group in getattr(fault, "groups", ()) for node in group if node >= count):
                yield ("fault", k, "groups"), nobody.format(node)

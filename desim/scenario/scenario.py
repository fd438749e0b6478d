"""A scenario: a complete experiment as one immutable, validated object, from Python or from a file."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from desim.config.arguments import naming_arguments, value_text
from desim.config.choice import OneOf
from desim.config.html import html_properties
from desim.config.key_index import outermost
from desim.config.model import (
    MIN_PERIOD,
    RESOLUTION,
    Flag,
    Horizon,
    Length,
    NotEmpty,
    Period,
    Recurring,
    Time,
    Value,
    in_forms,
)
from desim.config.packages import ENVIRONMENTS
from desim.config.traits import kind_of
from desim.kernel.clock_sync import CLOCK_SYNCS, ClockSync, Unsynchronised
from desim.kernel.models.graphs import names_of
from desim.kernel.models.links import Links
from desim.kernel.models.medium import airtime_of
from desim.kernel.walls.wall import Wall
from desim.pursuit.byzantine.lies import PURSUER_FAULTS, is_lie
from desim.pursuit.core.traits import ProtocolTraits, ScheduleTraits, size_by
from desim.pursuit.motion.dynamics import Dynamics, Simple
from desim.pursuit.motion.environment import Environment
from desim.pursuit.paths.space import Plane, space_among
from desim.pursuit.sensing.sensing import Sensing
from desim.pursuit.team.agent import Behaviour
from desim.pursuit.team.announcements import Announcements
from desim.scenario.misfits import misfits
from desim.scenario.named_metrics import MetricName
from desim.scenario.overrides import Source
from desim.scenario.players import Evader, Team
from desim.scenario.properties import PropertyField
from desim.scenario.sweep_table import Sweep
from desim.scenario.toml_errors import validated


def _never_or_period(time: float) -> float:
    if 0.0 < time < MIN_PERIOD:
        raise ValueError(f"should be 0 or at least {MIN_PERIOD:g} s (got {time:g})")
    return time


def _not_over_at_once(horizon: float) -> float:
    if 0.0 < horizon < RESOLUTION:
        raise ValueError(f"should be at least {RESOLUTION:g} s (got {horizon:g})")
    return horizon


PROTOCOLS = OneOf(group="desim.protocols", takes=("me",), traits=ProtocolTraits)
"""The installed protocols."""


class Capture(Value):
    """The condition of a capture, and the number of captures that end a run."""

    radius: Length = 0.1
    """Capture radius eps, m.

    If the radius is small, pursuers of limited acceleration or turn rate may circle around an evader for ever, see
    `desim.pursuit.motion.turning.least_capture_radius`.

    If in doubt, use 0.1 for speeds of about 1 m/s.
    """
    test: Literal["segment", "sample"] = "segment"
    """When a capture is detected. segment: at the exact instant at which the distance falls to the radius; sample: only
    at the ends of motion steps."""
    captures_to_end: Annotated[int, Field(ge=1, strict=True)] | None = None
    """Number of captures that end the run; if absent, the number of evaders."""


class Motion(Value):
    """The motion of all players."""

    step: Period = 0.01
    """Motion step h, the time between two headings, s.

    The computing time of a run grows with 1/h. With long steps, players react late to each other, and an evader flees
    in the wrong direction for a whole step. An evader that moves by more than the capture radius in a step may let
    pursuers run past it for ever.

    If in doubt, use at most a fifth of the time in which the fastest player covers the capture radius.
    """
    order: Literal["evader_first", "simultaneous"] = "evader_first"
    """Whether pursuers aim at the position of the evader at the end of the step (evader_first, the paper) or at the
    beginning of the step (simultaneous)."""
    static: Flag = False
    """Whether all players stand still and the time left stays at the horizon, so that the game never changes."""


class Clocks(Value):
    """The clocks of the pursuers; the fault `clock_skew` makes them wrong."""

    sync: Annotated[ClockSync, CLOCK_SYNCS] = Unsynchronised()
    """How the pursuers correct their clocks."""


class Recording(Value):
    """The recordings of a run in addition to decisions and captures."""

    trajectory: Annotated[Time, AfterValidator(_never_or_period), Recurring] = 0.05
    """Time between samples of all positions, s; 0 = none.

    Short times make traces and pages large, and long ones make replays jerky.

    If in doubt, use 0.05, which is 20 pictures a second, or 0 in sweeps whose metrics need no positions.
    """
    messages: Literal[False, True, "file"] = False
    """Whether every message is recorded (true) or only the numbers of messages (false); file: every message is written
    to the trace in an output folder during the run and not kept in memory; ages and beliefs are then not measured."""
    estimates: Flag = False
    """Whether the estimates of the evaders by all pursuers, with their covariances, are recorded at each sample, too;
    only `sensing.estimator` kalman has covariances."""
    metrics: tuple[MetricName, ...] = ()
    """Metrics beside the built-in ones (`desim metrics`): functions of a result as "module:name", installed ones, and
    "margin:NAME", the margin of a property of the scenario."""


def _default_protocol() -> Any:
    sap: Any = PROTOCOLS.choice("sap")
    return sap()


class Scenario(Value):
    """A complete experiment; the default is the scenario of Lee & Bakolas with 20 pursuers and an ideal network."""

    name: str = "unnamed"
    """Name in tables and figures."""
    seed: Annotated[int, Field(ge=0, strict=True)] = 0
    """Seed of every random stream of the run; of several runs, run k has the seed 1,000,000 `seed` + k."""
    horizon: Annotated[Horizon, AfterValidator(_not_over_at_once)] = 30.0
    """Time t_f at which the pursuit ends at the latest, s.

    It is also the reward at the start: a pursuer whose capture time is longer gains nothing from chasing.

    If in doubt, use a few times the capture time of a pursuer at the far end of the team's box; a longer one takes no
    more computation if the evaders are captured.
    """
    prune: Literal["none", "inf", "infeasible"] = "inf"
    """Pursuers that may not chase an evader under any protocol. none: all may chase; inf: those that can never capture
    the evader (phi = inf) may not; infeasible: nor may those that would be late (phi >= r, the time left). This
    overrides `team.active_at_start`."""
    team: Team = Team()
    evader: Annotated[
        Annotated[Evader, Tag("table")] | Annotated[tuple[Evader, ...], NotEmpty(), Tag("list")],
        in_forms("list", "table"),
    ] = Evader()
    """The evaders: a table or, for evaders with different parameters, a list of tables."""
    sensing: Sensing = Sensing()
    """Sensing of the evaders by the pursuers."""
    capture: Capture = Capture()
    motion: Motion = Motion()
    environment: Environment = Environment()
    wall: tuple[Wall, ...] = ()
    """Walls, which block radio, sight and motion."""
    protocol: Annotated[Behaviour, PROTOCOLS] = Field(default_factory=_default_protocol)
    """Negotiation protocol of the pursuers; `desim protocols` lists the kinds."""
    announce: Announcements = Field(default_factory=Announcements)
    """Content and times of the pursuers' announcements."""
    network: Links = Links()
    clocks: Clocks = Clocks()
    fault: tuple[Annotated[Any, PURSUER_FAULTS], ...] = ()
    """Faults of pursuers, of their messages, of clocks and of the network."""
    record: Recording = Recording()
    properties: tuple[PropertyField, ...] = ()
    """What a run should keep: tables, or texts such as "idle never longer than 2 against centralised". The margin of a
    property is the metric "margin:NAME"; nothing in a run depends on it."""
    sweep: Sweep = Sweep()

    @naming_arguments
    def with_(self, changes: Mapping[str, Any]) -> "Scenario":
        """Return the scenario with other values of some keys, checked as a scenario file with `--set` is.

        Use it to vary a scenario in a script:

            late = scenario.with_({"network.latency.value": 0.5, "team.count": 8})
            lossy = scenario.with_({"network.loss": GilbertElliott(share=0.1), "fault.0.start": 2.0})

        Args:
            changes: dotted keys, with the index of an item of a list as in "fault.0.start", and their new values: a
                number, a text, a list, an array, a table, a model or a function. With a new `kind`, a table loses the
                keys that this kind does not have.

        Raises:
            ScenarioError: if there is no such key, or the scenario would not be valid; the message has a line per
                error, with what is allowed.
        """
        keys: Any = changes
        if not isinstance(keys, Mapping):
            form = "{'network.latency.value': 0.5}"
            raise TypeError(f"with_ takes values by key, {form} for instance (got {value_text(changes)})")
        source = Source.of(self)
        for name, value in sorted(changes.items(), key=lambda change: str(change[0]).count(".")):
            source.change(name, value)  # a table is set before the keys in it
        return validated(source, Scenario)

    def _instead_of(self, name: str) -> str:
        """Return what to write instead of an attribute that a scenario does not have: a key, or a function."""
        if nearest := [key.dotted for key in outermost(name, Scenario)]:
            return " or ".join(f"scenario.{key}" for key in dict.fromkeys(nearest[:2]))
        of_run = {"plot", "replay", "summary", "export"}
        others = ["plot(run(scenario))", "sweep(scenario, grid)", "play(scenario)", "scenario.with_({key: value})"]
        first = f"{name}(run(scenario))" if name in of_run else "run(scenario)"
        return f"functions take it, such as {', '.join(dict.fromkeys([first, *others]))}; {super()._instead_of(name)}"

    def env(self, seed: int | None = None, **options: Any) -> Any:
        """Return an environment of PettingZoo in which one pursuer at a time decides; see `desim.env`."""
        return ENVIRONMENTS["env"](self, seed, **options)

    def parallel_env(self, seed: int | None = None, **options: Any) -> Any:
        """Return an environment of PettingZoo in which all pursuers decide at once; see `desim.parallel_env`."""
        return ENVIRONMENTS["parallel_env"](self, seed, **options)

    def _repr_html_(self) -> str:
        """Return a table for notebooks: the main keys, and all others that differ from their defaults."""
        main = {"name": self.name, "seed": self.seed, "horizon": self.horizon, "team.count": self.team.count}
        rows = main | {"protocol": self.protocol_name} | dict(_given(self))
        return html_properties({key: value if isinstance(value, str) else repr(value) for key, value in rows.items()})

    @property
    def evaders(self) -> tuple[Evader, ...]:
        """The parameters of each of the M evaders; evader j has index j - 1."""
        return tuple(table for _, table in self.evader_tables for _ in range(table.count))

    @property
    def evader_tables(self) -> list[tuple[tuple[str | int, ...], Evader]]:
        """The place and the parameters of each table of evaders; one table may stand for several evaders."""
        if isinstance(self.evader, tuple):
            return [(("evader", k), table) for k, table in enumerate(self.evader)]
        return [(("evader",), self.evader)]

    @property
    def space(self) -> Plane:
        """The space in which the players move: the plane among the walls that block motion."""
        return space_among(self.wall)

    @property
    def sight_is_limited(self) -> bool:
        """Whether pursuers may not see an evader: the sensing radius is finite, or walls block sight."""
        return self.sensing.limited or self.space.blocks_sight

    @property
    def sight_is_perfect(self) -> bool:
        """Whether all pursuers see all evaders exactly."""
        return not (self.sight_is_limited or self.sensing.is_noisy)

    @property
    def pursuer_dynamics(self) -> Dynamics:
        """The dynamics of the pursuers: `team.dynamics`, or simple motion in a static game."""
        return Simple() if self.motion.static else self.team.dynamics

    @property
    def players_environment(self) -> Environment:
        """The medium of the players: `environment`, or one at rest in a static game."""
        return Environment() if self.motion.static else self.environment

    @property
    def network_faults(self) -> tuple[Any, ...]:
        """The faults that are not Byzantine: those of robots, radios, clocks and the network."""
        return tuple(fault for fault in self.fault if not is_lie(fault))

    @property
    def protocol_name(self) -> str:
        """The kind of the protocol, or the name of its function or class if it has no kind."""
        return kind_of(self.protocol)

    @property
    def protocol_traits(self) -> ProtocolTraits:
        """The optional attributes of the protocol, with defaults."""
        return ProtocolTraits.of(self.protocol)

    @property
    def schedule_traits(self) -> ScheduleTraits:
        """The optional attributes of the schedule of the protocol; the defaults if the protocol has no schedule."""
        return ScheduleTraits.of(self.protocol_traits.schedule)

    @property
    def announces(self) -> bool:
        """Whether pursuers announce their actions; some protocols never do, or only if positions are not sensed."""
        announces = self.protocol_traits.announces
        return self.announce.payload != "action" if announces == "unseen" else announces

    @property
    def announcement_size(self) -> int:
        """Size of an announcement, bytes."""
        claim_size = self.protocol_traits.claim_size
        return size_by(claim_size, self.team.count, len(self.evaders)) if claim_size else self.announce.payload_size

    @property
    def announcement_airtime(self) -> float:
        """Longest airtime of an announcement, s."""
        return airtime_of(self.network.medium, self.announcement_size, self.team.count)

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        self._number_by_names()
        conflicts = list(misfits(self))
        if conflicts:
            text = "; ".join(f"{'.'.join(map(str, place))}: {why}" for place, why in conflicts)
            raise PydanticCustomError("misfits", "{text}", {"text": text, "misfits": conflicts})
        return self

    def _number_by_names(self) -> None:
        """Give a named node one number in all tables: that in the graph, else the positions, else measurements."""
        names = names_of(self.network.graph) or self.team.names or self.network.node_names
        self.__dict__["network"] = self.network.numbered(names)
        self.__dict__["team"] = self.team.numbered(names)


def _given(model: Value, above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted key and the value of each field that differs from its default, also within tables."""
    for name, value in model.given().items():
        default = type(model).model_fields[name].get_default(call_default_factory=True)
        if isinstance(value, Value) and type(value) is type(default):
            yield from _given(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def without_metrics(scenario: Scenario) -> Scenario:
    """Return a scenario without `record.metrics`, which select measurements and are not part of a run's identity."""
    if not scenario.record.metrics:
        return scenario
    return scenario.model_copy(update={"record": scenario.record.model_copy(update={"metrics": ()})})

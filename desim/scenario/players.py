"""The players of a scenario: the team of pursuers, and the evaders."""

from collections.abc import Set
from functools import cached_property
from math import inf
from typing import Annotated, Any, Self, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    Field,
    ModelWrapValidatorHandler,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from desim.config.choice import OneOf
from desim.config.model import MAX_COORDINATE, Box, FirstError, Limit, Probability, Speed, Time, Value, in_forms
from desim.config.python_numbers import as_python
from desim.kernel.core.seeds import stream
from desim.pursuit.core.state import complex_points
from desim.pursuit.core.traits import StrategyTraits
from desim.pursuit.evaders.evader import EvaderController
from desim.pursuit.evaders.evasion import STRATEGIES, PureEvasion, Strategy
from desim.pursuit.evaders.recorded import Point, RecordedMotion, RecordedPositions, RelayNode, Starts
from desim.pursuit.motion.dynamics import DYNAMICS, Dynamics, Simple, headings_with
from desim.pursuit.motion.guidance import ConstantBearing, Guidance, GuidanceTraits, PurePursuit
from desim.pursuit.paths.space import PLANE, Plane


class Speeds(Value):
    """One speed for all pursuers but the last, and one for the last."""

    default: Speed = 1.0
    """Speed of all pursuers but the last, m/s."""
    last: Speed = 2.0
    """Speed of the last pursuer, m/s."""


def _with_nodes(schema: dict[str, Any]) -> None:
    """Add the table from nodes to positions, which becomes a list, to the schema of positions."""
    of_list = schema["oneOf"][0]
    schema["oneOf"].append({"type": "object", "additionalProperties": of_list["items"]})


class Team(Value):
    """The pursuers: number, initial positions, speeds, initial actions and guidance."""

    count: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] = 20
    """Number of pursuers N; with `positions`, it must be the number of positions, or be absent."""
    positions: (
        Annotated[
            Annotated[tuple[Point, ...], FirstError(), Tag("list")] | Annotated[RecordedPositions, Tag("table")],
            in_forms("table", "list"),
            Field(json_schema_extra=_with_nodes),
        ]
        | None
    ) = None
    """Initial positions, one [x, y] per pursuer, m; a table from nodes to positions, such as a layout of networkx; or a
    table of the kind recorded: those of a mobility file. If absent, uniform random draws from `box` per seed."""
    box: Box = (0.0, 20.0)
    """Lower and upper bound of both initial coordinates, m."""
    speeds: Annotated[
        Annotated[Speed, Tag("number")]
        | Annotated[tuple[Speed, ...], FirstError(), Tag("list")]
        | Annotated[Speeds, Tag("table")],
        in_forms("table", "list", "number"),
    ] = Speeds()
    """Speeds, m/s: one number, one per pursuer, or a table { default, last }."""
    active_at_start: Probability = 1.0
    """Probability p0 that a pursuer is active at the start, in [0, 1]; one that may not chase (`prune`) never is."""
    guidance: Annotated[
        Guidance,
        OneOf(
            PurePursuit,
            ConstantBearing,
            takes=("gaps", "aims", "evader_velocity", "speeds"),
            traits=GuidanceTraits,
        ),
    ] = PurePursuit()
    """Guidance law of active pursuers."""
    dynamics: Annotated[Dynamics, DYNAMICS] = Simple()
    """How a pursuer follows the velocity that the guidance commands."""
    power_exponent: Annotated[float, Field(ge=0, le=10, strict=True)] = 2.0
    """Exponent p of the power that a drive needs at a speed v, v^p, for the metric `energy`: 1 against dry friction, as
    of wheels; 2 against viscous friction; 3 against the drag of air or water.

    If in doubt, use 2.
    """
    relay: tuple[RelayNode, ...] = ()
    """Pursuers that never chase and move along a record, whatever their `positions` and `speeds` are."""

    @model_validator(mode="wrap")
    @classmethod
    def _count_positions(cls, data: Any, make: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        """Set `count` to the number of positions if it is absent, and keep the record that the positions are from."""
        starts = positions = None
        if isinstance(data, dict) and "positions" in data:
            positions = as_python(data["positions"])
            data = data | {"positions": positions}
        if isinstance(positions, dict):
            try:
                starts = RecordedPositions.read(positions, info)
            except ValueError:
                pass  # `_of_record` raises the same error, with the place of the field
            else:
                positions = starts.positions
                data = data | {"positions": positions}
        if isinstance(positions, list | tuple) and positions and "count" not in data:
            data = data | {"count": len(positions)}
        team = make(data)
        if starts is not None:
            team.__dict__["record"] = starts  # no field, because the record is no part of the team's identity
        return team

    @field_validator("positions", mode="before")
    @classmethod
    def _of_record(cls, positions: Any, info: ValidationInfo) -> Any:
        return RecordedPositions.read(positions, info).positions if isinstance(positions, dict) else positions

    @cached_property
    def record(self) -> Starts | None:
        """The starts in the file of the positions, set by `_count_positions`; None if the positions have no file."""
        return None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the pursuers, if the file of the positions had names."""
        return self.record.names if self.record is not None else ()

    def numbered(self, names: tuple[str, ...]) -> "Team":
        """Return the team with its positions in the order of the names of a graph, if both have the same names.

        Positions whose `nodes` the user gives keep their order.
        """
        record = self.record
        if record is None or not record.is_in_file_order or self.names == names or set(self.names) != set(names):
            return self
        by_name = dict(zip(self.names, cast("tuple[Point, ...]", self.positions), strict=True))
        copy = self.model_copy()
        copy.__dict__.update(positions=tuple(by_name[name] for name in names), record=record._replace(names=names))
        return copy

    def _derived(self) -> Set[str]:
        """Return `count` if it follows from the positions."""
        return super()._derived() if self.positions is None else {"count"}

    @field_validator("relay")
    @classmethod
    def _are_pursuers(cls, relays: tuple[RelayNode, ...], info: ValidationInfo) -> tuple[RelayNode, ...]:
        count, pursuers = info.data.get("count"), [relay.pursuer for relay in relays]
        for pursuer in pursuers:
            if count is not None and pursuer >= count:
                raise ValueError(f"there is no pursuer {pursuer}: they are 0 .. {count - 1}")
            if pursuers.count(pursuer) > 1:
                raise ValueError(f"pursuer {pursuer} is named twice")
        return relays

    @field_validator("positions", "speeds")
    @classmethod
    def _one_per_pursuer(cls, values: Any, info: ValidationInfo) -> Any:
        count = info.data.get("count")
        if isinstance(values, tuple) and count is not None and len(values) != count:
            raise ValueError(f"should be one per pursuer: count is {count}, there are {len(values)}")
        return values

    @field_validator("dynamics")
    @classmethod
    def _can_move(cls, dynamics: Dynamics, info: ValidationInfo) -> Dynamics:
        speeds: Any = info.data.get("speeds")
        values = dict(speeds).values() if isinstance(speeds, Speeds) else np.atleast_1d(speeds)
        if not dynamics.is_simple and speeds is not None and not any(values):
            raise ValueError("has no effect, because all speeds (team.speeds) are 0")
        return dynamics

    @property
    def has_inertia(self) -> bool:
        """Whether the pursuers' motion is not simple."""
        return not self.dynamics.is_simple

    def headings(self, seed: int) -> list[complex]:
        """Return the (N,) initial headings, of length 1."""
        return headings_with(self.dynamics, stream(seed, "headings"), self.count)

    @property
    def relays(self) -> dict[int, RecordedMotion]:
        """The motion of each pursuer in `relay`, by its number."""
        return {relay.pursuer: relay.motion for relay in self.relay}

    def all_speeds(self) -> list[float]:
        """Return the (N,) speeds of pursuers that chase, m/s; 0 for relays."""
        if isinstance(self.speeds, Speeds):
            speeds = [self.speeds.default] * (self.count - 1) + [self.speeds.last]
        else:
            speeds = list(self.speeds) if isinstance(self.speeds, tuple) else [self.speeds] * self.count
        for pursuer in self.relays:
            speeds[pursuer] = 0.0
        return speeds

    @property
    def top_speed(self) -> float:
        """The greatest speed of any pursuer, m/s, relays included."""
        return max(*self.all_speeds(), *(motion.top_speed for motion in self.relays.values()), 0.0)

    def start(self, seed: int, space: Plane = PLANE) -> NDArray[np.float64]:
        """Return the (N, 2) initial positions, m, in a space: random ones are outside of walls."""
        if self.positions is not None:
            places = np.array(self.positions)
        else:
            places = random_places(stream(seed, "pursuers"), self.box, self.count, space)
        for pursuer, motion in self.relays.items():
            places[pursuer] = motion.start.real, motion.start.imag
        return places

    def start_profile(self, seed: int) -> NDArray[np.bool_]:
        """Return the (N,) initial profile, whether each pursuer is active."""
        return stream(seed, "start").random(self.count) < self.active_at_start


class Evader(Value):
    """An evader, or several with the same parameters: initial position, speed, strategy and sensing."""

    count: Annotated[int, Field(ge=1, le=1_000, strict=True)] = 1
    """Number of evaders with these parameters."""
    position: Point | None = None
    """Initial position [x, y], m; if absent, that of the record, or a uniform random draw from `box` per seed."""
    box: Box = (8.0, 12.0)
    """Lower and upper bound of both initial coordinates, m."""
    speed: Speed = 0.9
    """Speed v_e, m/s.

    An evader as fast as a pursuer can flee from it for ever, and captures of nearly as fast evaders take long.

    If in doubt, use nine tenths of the speed of the slowest pursuer.
    """
    strategy: Annotated[Strategy, STRATEGIES] = PureEvasion()
    """Evasion strategy."""
    sensing_range: Limit = inf
    """Distance up to which it senses pursuers, m."""
    reaction_delay: Time = 0.0
    """Delay of its observations of the pursuers' positions and actions, s.

    If in doubt, use 0; persons and animals take 0.1 to 0.3.
    """
    motion_interval: Time = 0.0
    """Time between two looks from which the evader infers which pursuers chase, s; 0: it knows their actions at any
    distance. A pursuer counts as active if it seems to have moved by more than half of what its speed allows.

    In a short interval, errors of the positions look like motion; after a long one, the evader learns late who chases.

    If in doubt, use 0, or with errors the time in which the slowest pursuer moves by ten times `motion_error`.
    """
    motion_error: Annotated[float, Field(ge=0, le=MAX_COORDINATE, allow_inf_nan=False, strict=True)] = 0.0
    """Standard deviation of each coordinate of the pursuers' positions at these looks, m."""
    dynamics: Annotated[Dynamics, DYNAMICS] = Simple()
    """How it follows the velocity that its strategy chooses."""

    @field_validator("dynamics")
    @classmethod
    def _can_follow(cls, dynamics: Dynamics, info: ValidationInfo) -> Dynamics:
        if not dynamics.is_simple and isinstance(info.data.get("strategy"), RecordedMotion):
            raise ValueError("has no effect, because the record determines the motion")
        if not dynamics.is_simple and info.data.get("speed") == 0.0:
            raise ValueError("has no effect, because the speed is 0")
        return dynamics

    @field_validator("motion_error")
    @classmethod
    def _has_looks(cls, motion_error: float, info: ValidationInfo) -> float:
        if motion_error > 0.0 and info.data.get("motion_interval") == 0.0:
            raise ValueError("has no effect without a motion_interval: the evader knows who chases")
        return motion_error

    @field_validator("strategy")
    @classmethod
    def _agrees_with_its_record(cls, strategy: Strategy, info: ValidationInfo) -> Strategy:
        if isinstance(strategy, RecordedMotion):
            if info.data.get("position") is not None:
                raise ValueError("the record determines the initial position: leave out `position`")
            if info.data.get("count", 1) > 1:
                raise ValueError("a record is of one evader: with several, give each a table of its own")
            strategy.check_speed(info.data.get("speed", inf))
        return strategy

    @property
    def record(self) -> RecordedMotion | None:
        """Its record, if its motion is recorded."""
        return self.strategy if isinstance(self.strategy, RecordedMotion) else None

    def start(self, seed: int, index: int = 0, space: Plane = PLANE) -> NDArray[np.float64]:
        """Return the (2,) initial position, m, in a space; `index` counts all evaders of the scenario from 0."""
        if self.record is not None:
            return np.array([self.record.start.real, self.record.start.imag])
        if self.position is not None:
            return np.array(self.position)
        place: NDArray[np.float64] = random_places(stream(seed, "evader", index), self.box, 1, space)[0]
        return place

    @property
    def has_inertia(self) -> bool:
        """Whether its motion is not simple."""
        return not self.dynamics.is_simple

    def heading(self, seed: int, index: int) -> complex:
        """Return the initial heading, of length 1; `index` counts all evaders of the scenario from 0."""
        (heading,) = headings_with(self.dynamics, stream(seed, "evader heading", index), 1)
        return heading

    @property
    def turns_at_once(self) -> bool:
        """Whether its velocity may jump."""
        return not self.has_inertia and self.speed > 0.0 and StrategyTraits.of(self.strategy).turns_at_once

    @property
    def listens(self) -> bool:
        """Whether its strategy overhears the pursuers' radio."""
        return StrategyTraits.of(self.strategy).listens

    def controller(
        self, rng: np.random.Generator, speeds: NDArray[np.float64], radius: float, space: Plane = PLANE
    ) -> EvaderController:
        """Return the controller of one evader with these parameters in a run.

        Args:
            rng: the random stream of the evader.
            speeds: (N,) speeds of the pursuers, m/s.
            radius: capture radius, m.
            space: the space in which the players move.
        """
        return EvaderController(
            self.strategy,
            rng,
            speed=self.speed,
            speeds=speeds,
            radius=radius,
            sensing_range=self.sensing_range,
            reaction_delay=self.reaction_delay,
            motion_interval=self.motion_interval,
            motion_error=self.motion_error,
            space=space,
        )


MAX_DRAWS = 1_000
"""Number of times that a random place inside a wall is drawn anew."""


def random_places(rng: np.random.Generator, box: tuple[float, float], count: int, space: Plane) -> NDArray[np.float64]:
    """Return (count, 2) uniform random places in a box, m; those inside a wall or on one are drawn anew.

    Raises:
        ValueError: if walls fill the box.
    """
    places = rng.uniform(*box, size=(count, 2))
    for _ in range(MAX_DRAWS):
        blocked = ~space.may_start(complex_points(places))
        if not blocked.any():
            return places
        places[blocked] = rng.uniform(*box, size=(np.count_nonzero(blocked), 2))
    raise ValueError(f"the walls leave no place in the box from {box[0]:g} to {box[1]:g} m")

"""Recorded motion: an evader, or a pursuer that only relays messages, moves along given waypoints.

Pursuers that chase can begin at the first positions of the nodes of a record.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from math import ceil
from numbers import Integral
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    ModelWrapValidatorHandler,
    Tag,
    ValidationInfo,
    model_validator,
)

from desim.config.arguments import abridged
from desim.config.caller_warnings import warn_reader
from desim.config.choice import OneOf
from desim.config.model import MAX_COORDINATE, Coordinate, FirstError, Length, Limit, Time, Value
from desim.config.python_numbers import as_complex, check_times
from desim.config.traits import Follows, Traits, name_of
from desim.config.trust import resolve_path
from desim.kernel.core.units import nanoseconds, seconds
from desim.kernel.models.graphs import Node
from desim.pursuit.evaders.observation import EvaderObservation
from desim.pursuit.mobility.mobility_file import read_mobility

DROPS_HEIGHTS = "the heights in the file are dropped: motion is in the plane, and so are all distances"
"""The warning about a file with heights."""
SPEED_ROUNDING = 1e-9
"""Share by which a speed that is computed from a record may exceed a limit."""
Point = tuple[Coordinate, Coordinate]
"""A position [x, y], m."""
NodeKey = Annotated[
    Annotated[Node, Tag("number")] | Annotated[Annotated[str, Field(min_length=1)], Tag("name")],
    Discriminator(lambda value: "name" if isinstance(value, str) else "number"),
]
"""The number or the name of a node in a mobility file."""
Waypoints = Sequence[tuple[float, float, float]]
"""Waypoints [t, x, y] (s, m, m)."""


class _Record(Value):
    """Base of the models that read a record: how its times and positions become those of the simulation."""

    dimensions: Literal[2, 3] | None = None
    """Number of coordinates of each waypoint in a file of BonnMotion: 2 (t x y) or 3 (t x y z, and z is dropped). The
    key is needed only if the file does not show this number."""
    start_time: Time = 0.0
    """Time in the record at which the simulation starts, s; earlier motion is cut off.

    If in doubt, use 0; traces of setdest and SUMO often begin to move after hundreds of seconds.
    """
    scale: Length = 1.0
    """Factor by which the positions of the record are multiplied, to have them in m: 1 for m, 1000 for km."""
    offset: Point = (0.0, 0.0)
    """Displacement [x, y] that is added to the positions after scaling, m: the negative of the position that becomes
    the origin."""

    def placed(self, waypoints: Waypoints) -> tuple[Waypoints, int]:
        """Return the waypoints in times and positions of the simulation, and the number of those cut off.

        The first waypoint is at time 0 if the record begins before `start_time`.

        Raises:
            ValueError: if the record ends before `start_time`.
        """
        (dx, dy), begin = self.offset, nanoseconds(self.start_time)
        if (self.start_time, self.scale, self.offset) == (0.0, 1.0, (0.0, 0.0)):
            return waypoints, 0
        # In ns, the times of the simulation, so that no waypoint is a rounding error before the start.
        moved = [(nanoseconds(t) - begin, self.scale * x + dx, self.scale * y + dy) for t, x, y in waypoints]
        cut = max(sum(t <= 0 for t, _, _ in moved) - 1, 0)  # keeps the last waypoint before the start
        if moved[-1][0] < 0:
            end = waypoints[-1][0]
            raise ValueError(
                f"start_time should be at most the time of the last waypoint, {end:g} s (got {self.start_time:g})"
            )
        if moved[cut][0] < 0:
            (t, x, y), (t_after, x_after, y_after) = moved[cut : cut + 2]
            share = -t / (t_after - t)
            moved[cut] = 0, x + share * (x_after - x), y + share * (y_after - y)
        return [(seconds(t), x, y) for t, x, y in moved[cut:]], cut


class RecordedMotion(_Record):
    """Move along recorded waypoints, whatever the pursuers do: straight, and at constant speed from each to the next.

    The node stands still before the time of the first waypoint, and after that of the last. A motion step ends at each
    waypoint, so that the motion is straight within every step, and captures stay exact.
    """

    kind: Literal["recorded"] = "recorded"
    waypoints: Annotated[tuple[Annotated[tuple[Time, Coordinate, Coordinate], FirstError()], ...], FirstError()] = ()
    """Waypoints [t, x, y] (s, m, m), in order of time."""
    file: str | None = None
    """Instead of waypoints: path of a file of BonnMotion, ns-2 or SUMO, or of a table with the columns t, x and y,
    relative to the scenario file. The file is read once, when the model is created."""
    node: NodeKey = 0
    """The node of the file: in a file of BonnMotion, the number of its line, from 0; in one of ns-2, its number; in a
    table or a file of SUMO, its number or name, or the index of a name, from 0."""

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, data: Any, make: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        if not isinstance(data, dict):
            return make(data)
        has_file = data.get("file") is not None
        if has_file and "waypoints" in data:
            raise ValueError("should have waypoints or a file of waypoints, not both")
        check_times(data.get("waypoints"), "waypoints")
        # With a file, the other keys are validated first, because they determine how it is read.
        checked = make(data | {"file": None, "waypoints": [(0.0, 0.0, 0.0)]} if has_file else data)
        waypoints: Waypoints = checked.waypoints
        if has_file:
            file = resolve_path(data["file"], info)
            track = read_mobility(file, checked.dimensions, is_scaled=checked.scale != 1.0).track(checked.node)
            waypoints = [waypoint[:3] for waypoint in track.waypoints]
        elif checked.node:
            raise ValueError(f"waypoints are of one node: node {checked.node} needs a file")
        elif checked.dimensions is not None:
            raise ValueError("dimensions are of a file: waypoints are [t, x, y]")
        else:
            checked._check_order()
        placed, cut = checked.placed(waypoints)
        applied = {"file", "node", "dimensions", "start_time", "scale", "offset"}  # their effect is in the waypoints
        motion = make({key: value for key, value in data.items() if key not in applied} | {"waypoints": placed})
        if has_file:  # set as attributes: equality and hashes do not depend on lines and heights
            motion.__dict__["places"] = tuple(f"{file}, line {waypoint.line}" for waypoint in track.waypoints[cut:])
            motion.__dict__["has_heights"] = track.has_heights
            if track.has_heights:
                warn_reader(f"{file}: {DROPS_HEIGHTS}", info)
        motion.check_speed(MAX_COORDINATE)
        return motion

    def _check_order(self) -> None:
        """Raise ValueError unless there are waypoints, and their times increase."""
        if not self.waypoints:
            raise ValueError("should have waypoints, or a file of waypoints")
        for k, (before, after) in enumerate(pairwise(self._times)):
            if not before < after:
                t_before, t = self.waypoints[k][0], self.waypoints[k + 1][0]
                raise ValueError(f"the times of waypoints should increase; after {t_before:g} s comes {t:g} s")

    @cached_property
    def has_heights(self) -> bool:
        """Whether the file had heights, which were dropped."""
        return False

    @cached_property
    def places(self) -> tuple[str, ...]:
        """Where each waypoint is given, for error messages: its number or, in a file, the file and the line."""
        return tuple(f"waypoints.{k}" for k in range(len(self.waypoints)))

    @cached_property
    def _times(self) -> tuple[int, ...]:
        """The time of each waypoint, ns."""
        return tuple(nanoseconds(t) for t, _, _ in self.waypoints)

    @property
    def start(self) -> complex:
        """The initial position, m."""
        return complex(*self.waypoints[0][1:])

    @cached_property
    def leg_speeds(self) -> tuple[float, ...]:
        """The speed between each waypoint and the next, m/s."""
        return tuple(
            abs(complex(x, y) - complex(x_before, y_before)) / (t - t_before)
            for (t_before, x_before, y_before), (t, x, y) in pairwise(self.waypoints)
        )

    @cached_property
    def top_speed(self) -> float:
        """The greatest speed, m/s."""
        return max(self.leg_speeds, default=0.0)

    def next_waypoint(self, now: int) -> int | None:
        """Return the time, ns, of the first waypoint after an instant, ns; None if there is none."""
        k = bisect_right(self._times, now)
        return self._times[k] if k < len(self._times) else None

    def velocity(self, now: int, position: complex) -> complex:
        """Return the velocity, m/s, with which a node at a position (m) now (ns) reaches the next waypoint in time.

        It is at most the top speed, and 0 before the first and after the last waypoint.
        """
        k = bisect_right(self._times, now)
        if k in {0, len(self._times)}:
            return 0j
        velocity = (complex(*self.waypoints[k][1:]) - position) / seconds(self._times[k] - now)
        # Next to a waypoint, the rounding error of the position is divided by a short time, hence the bound.
        return velocity * min(self.top_speed / abs(velocity), 1.0) if velocity else 0j

    def check_speed(self, limit: float) -> None:
        """Raise ValueError if a speed of the record exceeds a limit, m/s."""
        for k, speed in enumerate(self.leg_speeds):
            if speed > limit * (1.0 + SPEED_ROUNDING):
                raise ValueError(
                    f"{self.places[k + 1]}: the record moves at {speed:.6g} m/s from {self.waypoints[k][0]:g} to"
                    f" {self.waypoints[k + 1][0]:g} s, faster than the speed of {limit:g} m/s; the whole record needs a"
                    f" speed of at least {ceil(1000.0 * self.top_speed) / 1000.0:.10g} m/s"
                )

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading to the next waypoint; its length is the share of the speed that is needed, 0 at rest."""
        velocity = self.velocity(state.stamp, state.evader)
        return velocity / max(state.speed, abs(velocity)) if velocity else 0j


def _place(value: Any) -> complex:
    """Return a position, m; raise ValueError if it is none, for example a text, although `complex` would read it."""
    place = as_complex(value)
    if not (abs(place.real) <= MAX_COORDINATE and abs(place.imag) <= MAX_COORDINATE):
        raise ValueError("should be a position x + iy, m")
    return place


class RelayTraits(Traits):
    """The attributes of the motion of a relay that must be valid, or agree with its `__call__`."""

    start: Annotated[complex, BeforeValidator(_place)] = 0j
    """The initial position, m."""
    top_speed: Limit = 0.0
    """The greatest speed, m/s."""
    velocity: Annotated[Callable[[int, complex], complex] | None, Follows("__call__")] = None

    @classmethod
    def check(cls, value: Any) -> None:
        """Raise ValueError if a class overrides `__call__`, which moves an evader, but not `velocity`, for a relay."""
        super().check(value)
        model: type = type(value)
        if "velocity" in cls.outdated(model) | cls.passed_on(value):
            raise ValueError(
                f"{name_of(value)} has its own __call__, which moves an evader: a relay moves with"
                " velocity(now, position), so it should have its own, too"
            )


class RecordedPositions(_Record):
    """The positions at which the nodes of a mobility file begin.

    Pursuers that begin there chase; to move along the record instead, see `team.relay`.
    """

    kind: Literal["recorded"] = "recorded"
    file: str
    """Path of a file of BonnMotion, ns-2 or SUMO, or of a table with the columns x and y, and perhaps node and t,
    relative to the scenario file. The file is read once, when the model is created."""
    nodes: tuple[NodeKey, ...] | None = None
    """The node of each pursuer, see `node` of recorded motion; if absent, all nodes in the order of the file."""

    @classmethod
    def read(cls, table: dict[str, Any], info: ValidationInfo) -> "Starts":
        """Return the starts that a table with these keys describes, or one with a position for each node.

        Raises:
            ValueError: if a key is not valid or the file cannot be read.
        """
        if (
            table
            and not cls.model_fields.keys() & table.keys()
            and all(isinstance(place, list | tuple) for place in table.values())
        ):
            return _starts_of_nodes(table)
        record = cls.model_validate(table, context=info.context)
        file = resolve_path(record.file, info)
        mobility = read_mobility(file, record.dimensions, is_scaled=record.scale != 1.0, needs_times=False)
        nodes = mobility.nodes if record.nodes is None else record.nodes
        tracks = [mobility.track(node) for node in nodes]
        first_waypoints = [record.placed([waypoint[:3] for waypoint in track.waypoints])[0][0] for track in tracks]
        names = tuple(node for node in nodes if isinstance(node, str))
        has_heights = any(track.has_heights for track in tracks)
        if has_heights:
            warn_reader(f"{file}: {DROPS_HEIGHTS}", info)
        return Starts([(x, y) for _, x, y in first_waypoints], names, record.nodes is None, has_heights)


def _starts_of_nodes(table: dict[Any, Any]) -> "Starts":
    """Return the starts in a table from nodes to positions, as the layouts of networkx are.

    Integers are in ascending order, as those of a graph are.

    Raises:
        ValueError: if the nodes are neither all names nor all integers.
    """
    if all(isinstance(node, str) for node in table):
        return Starts([*table.values()], tuple(table), is_in_file_order=True, has_heights=False)
    if not all(isinstance(node, Integral) for node in table):
        raise ValueError(f"the nodes of the positions should be names, or integers (got {abridged(repr([*table]))})")
    return Starts([table[node] for node in sorted(table)], (), is_in_file_order=True, has_heights=False)


class Starts(NamedTuple):
    """Where the nodes of a record begin."""

    positions: list[tuple[float, float]]
    """(N,) positions, m."""
    names: tuple[str, ...]
    """The names of the nodes, if they have names."""
    is_in_file_order: bool
    """Whether the order is that of a file or a table of nodes, and not of pursuers that the scenario names."""
    has_heights: bool
    """Whether the file had heights, which were dropped."""


class RelayNode(Value):
    """A pursuer that never chases: it moves along a record, and relays messages.

    It forwards announcements if `announce.dissemination` or `sensing.relay` says so. Its speed as a chaser is 0. Like
    any pursuer, it captures an evader that comes within the capture radius. A crash does not stop its motion.
    """

    pursuer: Node
    """The number of the pursuer."""
    motion: Annotated[
        RecordedMotion,
        OneOf(
            RecordedMotion,
            needs=("start", "top_speed", "next_waypoint", "velocity"),
            takes=("state", "rng"),
            traits=RelayTraits,
        ),
    ]
    """Its motion."""

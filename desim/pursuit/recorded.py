"""Recorded motion: an evader, or a pursuer that only relays messages, moves along given waypoints."""

from bisect import bisect_right
from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from math import ceil
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import ModelWrapValidatorHandler, ValidationInfo, model_validator

from desim.config.choice import OneOf
from desim.config.model import Coordinate, Time, Value
from desim.config.traits import Follows, Traits, name_of
from desim.config.trust import resolve_path
from desim.kernel.graphs import Node
from desim.kernel.mobility_file import read_waypoints
from desim.kernel.units import nanoseconds, seconds
from desim.pursuit.observation import EvaderObservation

SPEED_ROUNDING = 1e-9
"""Share by which a speed that is computed from a record may exceed a limit."""


class RecordedMotion(Value):
    """Move along recorded waypoints, whatever the pursuers do: straight, and at constant speed from each to the next.

    The node stands at the first waypoint until its time, and at the last one from its time on. A motion step ends at
    each waypoint, so that the motion is straight within every step, and captures stay exact.
    """

    kind: Literal["recorded"] = "recorded"
    waypoints: tuple[tuple[Time, Coordinate, Coordinate], ...] = ()
    """Waypoints [t, x, y] (s, m, m), in order of time."""
    file: str | None = None
    """Instead of waypoints: path of a file of BonnMotion or ns-2, relative to the scenario file. The file is read once,
    when the model is created."""
    node: Node = 0
    """The node of the file: in a file of BonnMotion, the number of its line, from 0; in one of ns-2, its number."""

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, given: Any, make: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        if not isinstance(given, dict) or given.get("file") is None:
            return make(given)
        if "waypoints" in given:
            raise ValueError("should have waypoints or a file of waypoints, not both")
        node = given.get("node", 0)
        if type(node) is not int or node < 0:
            return make(given)  # which raises the error
        file = resolve_path(given["file"], info)
        found = read_waypoints(file, node)
        made = make(given | {"file": None, "node": 0, "waypoints": [each[:3] for each in found]})
        made.__dict__["places"] = tuple(f"{file}, line {each.line}" for each in found)  # not a part of its identity
        return made

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.waypoints:
            raise ValueError("should have waypoints, or a file of waypoints")
        if self.node:
            raise ValueError(f"waypoints are of one node: node {self.node} needs a file")
        for k, (before, after) in enumerate(pairwise(self._times)):
            if not before < after:
                t_before, t = self.waypoints[k][0], self.waypoints[k + 1][0]
                raise ValueError(f"the times of waypoints should increase; after {t_before:g} s comes {t:g} s")
        return self

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
        # Next to a waypoint, the rounding error of the position is divided by a short time.
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
        """Return the heading to the next waypoint, as long as the share of the speed that is needed; 0 at rest."""
        velocity = self.velocity(state.stamp, state.evader)
        return velocity / max(state.speed, abs(velocity)) if velocity else 0j


class RelayTraits(Traits):
    """The method of the motion of a relay that must agree with its `__call__`."""

    velocity: Annotated[Callable[[int, complex], complex] | None, Follows("__call__")] = None

    @classmethod
    def check(cls, value: Any) -> None:
        """Raise ValueError if only `__call__` is overridden, which moves an evader, and not a relay."""
        super().check(value)
        if "velocity" in cls.outdated(type(value)):
            raise ValueError(
                f"{name_of(value)} has its own __call__, which moves an evader: a relay moves with"
                " velocity(now, position), so it should have its own, too"
            )


class RelayNode(Value):
    """A pursuer that never chases: it moves along a record, and relays messages.

    It forwards announcements if `announce.dissemination` or `sensing.relay` says so. Its speed counts as 0. Like any
    pursuer, it captures an evader that comes within the capture radius. A crash does not stop its motion.
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

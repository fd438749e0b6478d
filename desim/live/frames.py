"""Frames: the state of the world as the referee sends it to the pursuers, in JSON."""

from typing import Any, NamedTuple

import numpy as np

from desim.config.arrays import Points
from desim.pursuit.motion.dead_reckoning import TrackSegment
from desim.pursuit.motion.dynamics import Courses
from desim.pursuit.motion.inertia import InertialKinematics
from desim.pursuit.sensing.world_state import WorldState

NUMBERS = "<c16"
"""The numpy type of the complex numbers in a frame, little-endian on every machine."""


class WorldFrame(NamedTuple):
    """The state of the world at one time; positions and velocities are those of all pursuers, then evaders.

    They are hexadecimal digits of complex numbers: reading them as numbers of JSON takes ten times as long.
    """

    t: int
    """ns"""
    places: str
    commands: str
    """Commanded velocities relative to the flow, m/s."""
    drifts: str | None
    """Velocities of the flow, m/s; None: there is none."""
    courses: list[str] | None
    """Velocities and headings of all players; None: players have no inertia."""
    profile: list[int]
    """Actions of the pursuers."""
    obeyed: list[int]
    """Number of orders of each pursuer that have taken effect."""
    broken: list[int]
    """Pursuers that are down."""
    captured: dict[str, int]
    """When each captured evader was captured, ns, by its number."""
    segments: list[list[Any]]
    """The present motion step of each evader, as the fields of `TrackSegment`; empty before the first."""


def frame_of(state: WorldState, obeyed: list[int]) -> WorldFrame:
    """Return the frame of the present state of a world."""
    players, everybody = state.players, range(state.size + state.evader_count)
    courses = players.courses(everybody) if isinstance(players, InertialKinematics) else None
    segments = [getattr(body.path, "last", None) for body in state.bodies]
    return WorldFrame(
        state.now,
        hex_digits(players.positions()),
        hex_digits(players.commands),
        None if players.drifts is None else hex_digits(players.drifts),
        None if courses is None else [hex_digits(courses.velocities), hex_digits(courses.headings)],
        state.profile,
        obeyed,
        state.broken.nonzero()[0].tolist(),
        {str(body.number): body.captured for body in state.bodies if body.captured is not None},
        [segment_list(segment) for segment in segments],
    )


class Mirror:
    """The state of the world in the process of a pursuer, which follows the frames of the referee.

    Between two frames all players go on as they were commanded. While an order of the pursuer is on its way to the
    referee, its action is the one that it ordered, not that of the frame.

    Args:
        state: the state of the world, which is kept up to date.
        pursuer: the number of the pursuer.
    """

    def __init__(self, state: WorldState, pursuer: int):
        self.state, self._pursuer = state, pursuer
        self.orders = 0
        """Number of orders that the pursuer has given."""
        self._last = -1

    def follow(self, frame: WorldFrame) -> None:
        """Set the world to the state in a frame, unless the frame is older than the last one."""
        if frame.t < self._last:
            return
        state, self._last = self.state, frame.t
        courses = Courses(*(points_of(part) for part in frame.courses or ("", "")))
        drifts = None if frame.drifts is None else points_of(frame.drifts)
        for number, when in frame.captured.items():
            body = state.body(int(number))
            if body.captured is None:
                state.capture(body)
                body.captured = when
        state.players.observe(frame.t, points_of(frame.places), courses, points_of(frame.commands), drifts)
        state.broken[:] = False
        state.broken[frame.broken] = True
        for body, segment in zip(state.bodies, frame.segments, strict=True):
            last = segment_list(getattr(body.path, "last", None))
            if segment and segment != last and segment[:1] >= last[:1]:  # a new step, not an earlier one
                body.path.see(*_segment_of(segment))
        self._act(frame)

    def set_action(self, action: int) -> None:
        """Let the pursuer itself perform an action from now on."""
        profile = list(self.state.profile)
        profile[self._pursuer] = action
        self._replace(profile)

    def _act(self, frame: WorldFrame) -> None:
        """Take over the actions of a frame, but not that of the pursuer while its last order is under way."""
        profile = list(frame.profile)
        if frame.obeyed[self._pursuer] != self.orders and self._pursuer not in frame.broken:
            profile[self._pursuer] = self.state.profile[self._pursuer]
        self._replace(profile)

    def _replace(self, profile: list[int]) -> None:
        """Set the actions of all pursuers, and the start of those that change."""
        for pursuer, (old_action, new_action) in enumerate(zip(self.state.profile, profile, strict=True)):
            if old_action != new_action:
                self.state.acting_since[pursuer] = self.state.now
        if profile != self.state.profile:
            self.state.set_actions(np.array(profile, dtype=np.int64))


def hex_digits(points: Points) -> str:
    """Return complex numbers as hexadecimal digits."""
    return points.astype(NUMBERS).tobytes().hex()


def points_of(digits: str) -> Points:
    """Return the complex numbers in hexadecimal digits."""
    return np.frombuffer(bytes.fromhex(digits), NUMBERS)


def segment_list(segment: TrackSegment | None) -> list[Any]:
    """Return a motion step of an evader as JSON types; None: there is none."""
    if segment is None:
        return []
    begun, evader, aim, velocity, end = segment
    return [begun, evader.real, evader.imag, aim.real, aim.imag, velocity.real, velocity.imag, end]


def _segment_of(fields: list[Any]) -> TrackSegment:
    begun, x, y, aim_x, aim_y, velocity_x, velocity_y, end = fields
    return TrackSegment(begun, complex(x, y), complex(aim_x, aim_y), complex(velocity_x, velocity_y), end)

"""Dynamics: the motion of a player that has been commanded a velocity.

A player with simple motion takes any commanded velocity at once. Robots with inertia need time to change their
velocity: their acceleration or their turn rate is limited. In each case the motion until the next command has a closed
form, a curve and then a straight line: a `Piece`.
"""

from cmath import isfinite, phase, rect
from math import pi, sin
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from pydantic import Field

from desim.config.answers import wrong_answer
from desim.config.arrays import Floats, Points, array_of
from desim.config.choice import OneOf
from desim.config.model import Flag, Value
from desim.config.python_numbers import as_complex, as_real
from desim.config.traits import Follows, Traits, check_inherited_flag, is_ours
from desim.pursuit.core.geometry import SMALLEST
from desim.pursuit.core.state import lengths
from desim.pursuit.motion.capture import RadialTime, accelerated_capture_times
from desim.pursuit.motion.turning import turning_capture_times


class Course(NamedTuple):
    """The velocity and the heading of a player; a player that stands still also has a heading."""

    velocity: complex = 0j
    """m/s"""
    heading: complex = 1.0 + 0j
    """of length 1"""


class Piece(NamedTuple):
    """A piece of motion between two commands: a curve, and then a straight line at the velocity at its end.

    The curve is a parabola, of constant acceleration, or an arc of a circle, of constant turn rate.
    """

    position: complex
    """Position at the start, m."""
    course: Course
    """Course at the start."""
    curved: float = 0.0
    """Duration of the curve, s; 0: the piece is straight."""
    acceleration: complex = 0j
    """Acceleration in the curve, m/s^2."""
    turn_rate: float = 0.0
    """Turn rate in the curve, rad/s, positive to the left."""
    drift: complex = 0j
    """Velocity of the flow, m/s. The course is relative to the flow."""

    def at(self, t: float) -> complex:
        """Return the position, m, at a time t >= 0 after the start, s."""
        curve_time = min(t, self.curved)
        velocity = self.course.velocity
        if self.turn_rate:
            angle = self.turn_rate * curve_time
            # The chord of the arc, which is turned by half of the angle.
            place = self.position + velocity * rect(2.0 * sin(angle / 2.0) / self.turn_rate, angle / 2.0)
            if t > curve_time:
                place += velocity * rect(1.0, angle) * (t - curve_time)
        else:
            place = self.position + velocity * curve_time + self.acceleration * (0.5 * curve_time * curve_time)
            if t > curve_time:
                place += (velocity + self.acceleration * curve_time) * (t - curve_time)
        return place + self.drift * t

    def course_at(self, t: float) -> Course:
        """Return the course at a time t >= 0 after the start, s."""
        curve_time = min(t, self.curved)
        velocity, heading = self.course
        if self.turn_rate:
            turned = rect(1.0, self.turn_rate * curve_time)
            return Course(velocity * turned, heading * turned)
        velocity = velocity + self.acceleration * curve_time
        return Course(velocity, velocity / abs(velocity) if velocity else heading)

    def velocity_at(self, t: float) -> complex:
        """Return the velocity over ground, m/s, at a time t >= 0 after the start, s."""
        return self.course_at(t).velocity + self.drift

    @property
    def moves(self) -> bool:
        """Whether the position changes."""
        return bool(self.curved or self.course.velocity or self.drift)

    @property
    def curvature(self) -> float:
        """The magnitude of the acceleration in the curve, m/s^2."""
        return abs(self.turn_rate * self.course.velocity) + abs(self.acceleration)


class Dynamics(Protocol):
    """The dynamics of a player: how it follows commanded velocities."""

    is_simple: ClassVar[bool]
    """Whether a commanded velocity is taken at once."""

    def __call__(self, position: complex, course: Course, command: complex) -> Piece:
        """Return the motion that begins at a position (m) with a course, if a velocity (m/s) is commanded."""

    def headings(self, rng: np.random.Generator, count: int) -> list[complex]:
        """Return the initial headings, of length 1, of several players."""

    def steered(self, command: complex, course: Course, aim: complex, radius: float) -> complex:
        """Return the velocity, m/s, that a pursuer commands, given the velocity that its guidance commands.

        Args:
            command: the velocity that the guidance commands, m/s.
            course: the course of the pursuer.
            aim: the vector from the pursuer to the point at which it aims, m.
            radius: capture radius, m.
        """

    def capture_times(
        self, offsets: Points, courses: "Courses", speeds: Floats, evader_speed: float, radius: float
    ) -> Floats:
        """Return the (k,) capture times, s, of pursuers with these dynamics for an evader that flees straight.

        The evader flees at its full speed in the direction of `offsets`.

        Args:
            offsets: (k,) vectors from each pursuer to the evader, m.
            courses: the courses of the k pursuers.
            speeds: (k,) speeds of the pursuers while they chase, m/s.
            evader_speed: speed of the evader, m/s.
            radius: capture radius, m.
        """


def coasts(dynamics: Dynamics) -> bool:
    """Return whether a moving player that is commanded to stand still goes on moving, for instance while it brakes."""
    return dynamics(0j, Course(1.0 + 0j), 0j).at(1.0) != 0j


@runtime_checkable
class Limited(Protocol):
    """Dynamics with a limit; `desim.testing.pursuits` checks that the positions in a run respect it."""

    @property
    def limits(self) -> Literal["acceleration", "turn rate"]:
        """What is limited: the acceleration, or the turn rate."""

    @property
    def limit(self) -> float:
        """The limit, m/s^2 or rad/s."""


class Courses(NamedTuple):
    """The courses of several players."""

    velocities: Points
    """(k,) m/s"""
    headings: Points
    """(k,) of length 1"""


class _WithoutHeading(Value):
    """Common part of dynamics for which the heading has no effect."""

    def headings(self, rng: np.random.Generator, count: int) -> list[complex]:
        """Return equal headings."""
        return [1.0 + 0j] * count

    def steered(self, command: complex, course: Course, aim: complex, radius: float) -> complex:
        """Return the command of the guidance."""
        return command


class Simple(_WithoutHeading):
    """Take each commanded velocity at once (Lee & Bakolas: simple motion, x' = u)."""

    is_simple: ClassVar[bool] = True
    kind: Literal["simple"] = "simple"

    def __call__(self, position: complex, course: Course, command: complex) -> Piece:
        """Return a straight line."""
        return Piece(position, Course(command, command / abs(command) if command else course.heading))

    def capture_times(
        self, offsets: Points, courses: Courses, speeds: Floats, evader_speed: float, radius: float
    ) -> Floats:
        """Return the (k,) capture times, s."""
        return RadialTime(speeds, evader_speed, radius)(lengths(offsets))


class Acceleration(_WithoutHeading):
    """Change the velocity with an acceleration of limited magnitude: x'' = a, |a| <= limit and |x'| <= v.

    A player begins at rest. It accelerates at the limit in the direction of the difference between the commanded
    velocity and its own, until both are equal. A player that is commanded to stand still brakes.

    A pursuer assumes that it and the evader move along the line of sight. Their distance is a parabola in
    time, and then a line. The capture time is when the distance has fallen to the capture radius: see
    `desim.pursuit.motion.capture.accelerated_capture_times`.
    """

    is_simple: ClassVar[bool] = False
    limits: ClassVar[Literal["acceleration"]] = "acceleration"
    kind: Literal["acceleration"] = "acceleration"
    limit: Annotated[float, Field(ge=1e-6, le=1e9, allow_inf_nan=False, strict=True)] = 1.0
    """Greatest acceleration, m/s^2.

    A player needs speed / limit to reach its speed from rest.

    If in doubt, use the speed divided by 1 s. If speed / limit is below the motion step, simple motion does as well.
    """

    def __call__(self, position: complex, course: Course, command: complex) -> Piece:
        """Return a parabola and a line."""
        change = command - course.velocity
        if abs(change) < SMALLEST:
            return Piece(position, course)
        return Piece(position, course, abs(change) / self.limit, change / abs(change) * self.limit)

    def capture_times(
        self, offsets: Points, courses: Courses, speeds: Floats, evader_speed: float, radius: float
    ) -> Floats:
        """Return the (k,) capture times, s."""
        return accelerated_capture_times(offsets, courses.velocities, speeds, evader_speed, radius, self.limit)


class TurnRate(Value):
    """Turn at a limited rate, and move forwards only: a unicycle with the least turning radius v / limit.

    A player takes the speed of a commanded velocity at once, and turns to its direction along the shorter arc.
    A pursuer whose aim is within its turning circle turns away first.
    A player that is commanded to stand still stops at once and keeps its heading.

    A pursuer computes its capture time along the shortest path of bounded curvature with a free final heading
    (Boissonnat & Bui 1994), towards an evader that flees straight along the present line of sight: see
    `desim.pursuit.motion.turning`. An evader that turns aside in time can escape a pursuer that turns too slowly,
    however fast it is (Isaacs 1965, the homicidal chauffeur): see `desim.pursuit.motion.turning.least_capture_radius`.
    """

    is_simple: ClassVar[bool] = False
    limits: ClassVar[Literal["turn rate"]] = "turn rate"
    kind: Literal["turn_rate"] = "turn_rate"
    limit: Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False, strict=True)] = 1.0
    """Greatest turn rate, rad/s.

    The least turning radius is speed / limit.

    If in doubt, choose it so that this radius is a few capture radii; if the radius is much smaller, simple motion does
    as well.
    """
    heading: Annotated[float, Field(ge=-2 * pi, le=2 * pi, allow_inf_nan=False, strict=True)] | None = None
    """Initial heading, rad from the x axis to the left; if absent, a uniform random draw per player and seed."""

    def headings(self, rng: np.random.Generator, count: int) -> list[complex]:
        """Return the initial headings, of length 1, of several players."""
        angles = rng.uniform(-pi, pi, count).tolist() if self.heading is None else [self.heading] * count
        return [rect(1.0, angle) for angle in angles]

    def steered(self, command: complex, course: Course, aim: complex, radius: float) -> complex:
        """Return the command of the guidance or, while the aim is within the turning circle, a turn away from the aim.

        Otherwise the pursuer would circle around its aim. Turning away is the first arc of the shortest path.
        """
        speed, ahead = abs(command), aim / course.heading  # ahead: the aim in axes with the heading along x
        side, turning_radius = 1j if ahead.imag >= 0.0 else -1j, speed / self.limit
        within = abs(ahead - side * turning_radius) < turning_radius - radius
        return -side * course.heading * speed if within else command

    def __call__(self, position: complex, course: Course, command: complex) -> Piece:
        """Return an arc and a line."""
        speed, heading = abs(command), course.heading
        if not speed:
            return Piece(position, Course(0j, heading))
        angle = phase(command / heading)
        start = Course(speed * heading, heading)
        return Piece(position, start, abs(angle) / self.limit, turn_rate=self.limit if angle > 0.0 else -self.limit)

    def capture_times(
        self, offsets: Points, courses: Courses, speeds: Floats, evader_speed: float, radius: float
    ) -> Floats:
        """Return the (k,) capture times, s."""
        return turning_capture_times(offsets, courses.headings, speeds, evader_speed, radius, self.limit)


CALLED_WITH_INERTIA = ("__call__", "steered", "headings", "capture_times")
"""The methods of dynamics that are called only if `is_simple` is false."""


class DynamicsTraits(Traits):
    """The attribute of dynamics that must agree with their methods."""

    is_simple: Annotated[Flag, Follows(*CALLED_WITH_INERTIA)] = False

    @classmethod
    def check(cls, value: Any) -> None:
        """Raise ValueError if `is_simple` is inherited as true, so that methods of the class are never called."""
        super().check(value)
        check_inherited_flag(value, "is_simple", CALLED_WITH_INERTIA, "commanded velocities are taken at once")


def piece_with(dynamics: Dynamics, position: complex, course: Course, command: complex) -> Piece:
    """Return the motion with some dynamics if a velocity is commanded; see `Dynamics`.

    Raises:
        ValueError: if the dynamics of a user return no piece, or a piece with anything but finite numbers.
    """
    answer: Any = dynamics(position, course, command)
    if is_ours(type(dynamics)):
        return answer  # type: ignore[no-any-return]
    try:
        velocity, heading = answer.course
        vectors = [
            as_complex(vector) for vector in (answer.position, velocity, heading, answer.acceleration, answer.drift)
        ]
        curved, turn_rate = as_real(answer.curved), as_real(answer.turn_rate)
    except (AttributeError, TypeError, ValueError) as error:
        raise wrong_answer("dynamics should return a Piece", answer, dynamics) from error
    if not all(map(isfinite, (*vectors, turn_rate))) or not curved >= 0.0:
        raise wrong_answer("dynamics should return a Piece of finite numbers", answer, dynamics)
    start, velocity, heading, acceleration, drift = vectors
    return Piece(start, Course(velocity, heading), curved, acceleration, turn_rate, drift)


def capture_times_with(
    dynamics: Dynamics, offsets: Points, courses: Courses, speeds: Floats, evader_speed: float, radius: float
) -> Floats:
    """Return the (k,) capture times, s, with some dynamics; see `Dynamics.capture_times`.

    Raises:
        ValueError: if the dynamics of a user return anything else.
    """
    times = dynamics.capture_times(offsets, courses, speeds, evader_speed, radius)
    if is_ours(type(dynamics)):
        return times
    array = array_of(times)
    if array.shape != speeds.shape or array.dtype.kind not in "iuf" or not (array >= 0.0).all():
        expected = f"a time >= 0 s, or inf, for each of {len(speeds)} pursuers"
        raise wrong_answer(f"capture_times of dynamics should return {expected}", times, dynamics)
    return array.astype(float)


def steered_with(dynamics: Dynamics, command: complex, course: Course, aim: complex, radius: float) -> complex:
    """Return the command, m/s, that a pursuer with some dynamics follows; see `Dynamics.steered`.

    Raises:
        ValueError: if the dynamics of a user return no finite complex number.
    """
    steered: Any = dynamics.steered(command, course, aim, radius)
    if is_ours(type(dynamics)):
        return steered  # type: ignore[no-any-return]
    velocity = as_complex(steered)
    if not isfinite(velocity):
        raise wrong_answer("steered of dynamics should return a finite complex number, in m/s", steered, dynamics)
    return velocity


def headings_with(dynamics: Dynamics, rng: np.random.Generator, count: int) -> list[complex]:
    """Return the initial headings, of length 1, of several players; see `Dynamics.headings`.

    Raises:
        ValueError: if the dynamics of a user return anything else.
    """
    headings = dynamics.headings(rng, count)
    array = array_of(headings)
    if array.shape != (count,) or array.dtype.kind not in "iufc" or not np.allclose(np.abs(array), 1.0):
        expected = f"a complex number of length 1 for each of {count} players"
        raise wrong_answer(f"headings of dynamics should return {expected}", headings, dynamics)
    return array.astype(complex).tolist()  # type: ignore[no-any-return]


DYNAMICS = OneOf(
    *(Simple, Acceleration, TurnRate),
    needs=(
        "is_simple",
        "headings(rng, count)",
        "steered(command, course, aim, radius)",
        "capture_times(offsets, courses, speeds, evader_speed, radius)",
    ),
    takes=("position", "course", "command"),
    traits=DynamicsTraits,
)
"""The kinds of dynamics."""

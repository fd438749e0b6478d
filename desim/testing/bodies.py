"""The check of dynamics, the models of how the body of a player follows commanded velocities: `check_body`."""

from cmath import phase, rect
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from math import inf, pi
from typing import Any, NamedTuple

import numpy as np

from desim.config.arguments import naming_arguments, value_text
from desim.pursuit.core.state import lengths
from desim.pursuit.motion.capture import RadialTime
from desim.pursuit.motion.dynamics import DYNAMICS, Course, Courses, Piece, coasts
from desim.pursuit.motion.inertia import first_contact_of_pieces
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Scenario
from desim.testing.judging import Subject, subject, twice

STEP = 1e-5
"""Time over which velocities and accelerations are computed as differences, s."""
TOLERANCE = 1e-6
"""Tolerance of positions, m, of velocities, m/s, and relative tolerance of times."""
EVADER_SPEED = 0.9
"""Speed of the evader for which capture times are compared, m/s."""
CAPTURE_RADIUS = 0.1
"""Capture radius, m."""


class _Call(NamedTuple):
    """A call of dynamics."""

    position: complex
    course: Course
    command: complex

    def __str__(self) -> str:
        velocity, heading = self.course
        return f"body({self.position:.3g}, Course({velocity:.3g}, {heading:.3g}), {self.command:.3g})"


def _calls() -> Iterator[_Call]:
    """Yield calls: at rest and moving, commanded to stand still, to move on, to turn, to slow down."""
    rng = np.random.default_rng(1)
    for command in (0.0, 2.0, 2.0, 1.0):  # twice 2 m/s, in different directions
        for speed in (0.0, 1.0, 2.0, 3.0):
            heading, ahead = (rect(1.0, angle) for angle in rng.uniform(-pi, pi, 2))
            position = complex(*rng.uniform(-5.0, 5.0, 2))
            yield _Call(position, Course(speed * heading, heading), command * ahead)


class _Body:
    """Dynamics that are being checked."""

    def __init__(self, tested: Subject, model: Any):
        self.tested, self.model = tested, model

    def piece(self, call: _Call) -> Piece:
        """Return the motion that a call returns; require that it is valid, and equal when the call is repeated."""
        with self.tested.blaming(str(call)):
            first, second = self.model(*call), self.model(*call)
        if not isinstance(first, Piece):
            self.tested.fail(f"{call} returns {value_text(first)}, expected a Piece")
        self.tested.require(first == second, f"{call} returns another Piece when it is repeated: it may not remember")
        self.tested.require(first.curved >= 0.0, f"{call}: curved is {first.curved}, expected a duration >= 0 s")
        self.tested.require(
            not (first.turn_rate and first.acceleration),
            f"{call} has a turn rate and an acceleration; a curve has one of them, and the acceleration has no effect",
        )
        self.tested.require(not first.drift, f"{call} has a drift of {first.drift}; the flow of the scenario is added")
        return first

    def check_motion(self, call: _Call) -> None:
        """Compare the positions of a piece with its velocities, and the velocities with the limits."""
        piece = self.piece(call)
        require, command = self.tested.require, call.command
        require(
            not self.model.is_simple
            or (piece.velocity_at(0.0) == command and piece.at(1.0) == call.position + command),
            f"is_simple is True, so that no piece is asked for, but {call} does not move at its command",
        )
        start = piece.at(0.0)
        require(
            abs(start - call.position) <= TOLERANCE, f"{call} begins at {start:.6g}, expected the position of the call"
        )
        end = min(piece.curved, 5.0)
        bound = max(abs(command), abs(call.course.velocity))
        for t in (*np.linspace(0.0, end, 9)[1:-1].tolist(), end + 0.5, end + 1.0):
            if abs(t - piece.curved) <= STEP or t <= STEP:  # a difference across a kink is no derivative
                continue
            before, velocity, after = piece.velocity_at(t - STEP), piece.velocity_at(t), piece.velocity_at(t + STEP)
            moved = (piece.at(t + STEP) - piece.at(t - STEP)) / (2.0 * STEP)
            require(
                abs(moved - velocity) <= 1e-3 * (1.0 + bound),
                f"{call}: after {t:.3g} s the position moves at {moved:.6g} m/s, and velocity_at says {velocity:.6g}",
            )
            require(
                abs(velocity) <= bound * (1.0 + TOLERANCE),
                f"{call}: after {t:.3g} s the speed is {abs(velocity):.6g} m/s, expected at most {bound:.6g} m/s: the"
                " greater of those of the course and of the command",
            )
            rate = abs(after - before) / (2.0 * STEP)
            curvature = piece.curvature if t < piece.curved else 0.0
            require(
                rate <= curvature * (1.0 + 1e-3) + 1e-3,
                f"{call}: after {t:.3g} s the acceleration is {rate:.4g} m/s^2, expected at most its curvature"
                f" {curvature:.4g} m/s^2, on which the search for contacts relies",
            )
            self._check_limit(call, piece, t, rate)
        jump = abs(piece.at(piece.curved + 1e-9) - piece.at(max(piece.curved - 1e-9, 0.0))) if end < 5.0 else 0.0
        require(jump <= TOLERANCE, f"{call}: the position jumps by {jump:.3g} m where the curve ends")

    def _check_limit(self, call: _Call, piece: Piece, t: float, rate: float) -> None:
        """Require that a piece keeps the limit that the dynamics name."""
        limits, limit = getattr(self.model, "limits", None), getattr(self.model, "limit", inf)
        initial = piece.course_at(0.0)
        if limits == "acceleration":
            self.tested.require(
                abs(initial.velocity - call.course.velocity) <= TOLERANCE and rate <= limit * (1.0 + 1e-3),
                f"{call}: the velocity begins with {initial.velocity:.4g} m/s and changes by {rate:.4g} m/s^2, expected"
                f" the velocity of the course and at most the limit, {limit:.4g} m/s^2",
            )
        elif limits == "turn rate":
            turned = abs(phase(piece.course_at(t + STEP).heading / piece.course_at(t - STEP).heading)) / (2.0 * STEP)
            self.tested.require(
                abs(initial.heading - call.course.heading) <= TOLERANCE and turned <= limit * (1.0 + 1e-3),
                f"{call}: the heading begins with {initial.heading:.4g} and turns by {turned:.4g} rad/s, expected the"
                f" heading of the course and at most the limit, {limit:.4g} rad/s",
            )

    def check_joint(self, call: _Call) -> None:
        """Require that a repeated command changes nothing: the motion calls the dynamics again at each motion step."""
        piece = self.piece(call)
        for when in (0.0, 0.3, 0.7):
            cut = _Call(piece.at(when), piece.course_at(when), call.command)
            remainder = self.piece(cut)
            for t in (0.1, 1.0):
                expected, actual = piece.at(when + t), remainder.at(t)
                self.tested.require(
                    abs(actual - expected) <= TOLERANCE * (1.0 + abs(expected)),
                    f"{call}: if the command is given again after {when:g} s, the position {t:g} s later is"
                    f" {actual:.6g}, expected {expected:.6g} as without it, because every piece is cut at each motion"
                    " step",
                )

    def check_rest(self) -> None:
        """Require that a player comes to rest if its command is 0, and then stays at rest."""
        may_coast = coasts(self.model)
        for call in _calls():
            if call.command:
                continue
            piece = self.piece(call)
            distance, final = abs(piece.at(1.0) - call.position), piece.velocity_at(piece.curved)
            self.tested.require(
                call.course.velocity or distance <= TOLERANCE,
                f"{call} moves by {distance:.3g} m in 1 s: expected to stay at rest",
            )
            self.tested.require(
                abs(final) <= TOLERANCE, f"{call} goes on at {final:.4g} m/s for ever, expected to come to rest"
            )
            self.tested.require(
                may_coast or distance <= TOLERANCE,
                f"{call} moves by {distance:.3g} m, expected to stop at once as from 1 m/s: a body that coasts does so"
                " from any speed",
            )

    def check_contacts(self) -> None:
        """Compare the first contact of two pieces with the positions at many instants."""
        times = np.linspace(0.0, 4.0, 4_001).tolist()
        for call, other in pairwise(_calls()):
            first, second = self.piece(call), self.piece(other)
            gaps = [abs(first.at(t) - second.at(t)) for t in times]
            # Halfway between the least and the first gap: at the least gap, the circles would only touch.
            radius = (min(gaps) + gaps[0]) / 2.0
            sampled = next(t for t, gap in zip(times, gaps, strict=True) if gap <= radius * (1.0 + 1e-9))
            contact = first_contact_of_pieces(first, second, radius, 0.0, 5.0)
            self.tested.require(
                contact is not None and contact <= sampled + TOLERANCE and sampled - contact <= 1e-3 + TOLERANCE,
                f"{call} and {other} come within {radius:.4g} m at {sampled:.4g} s, and the search finds {contact}",
            )

    def check_headings(self) -> None:
        """Check the initial headings."""
        with self.tested.blaming("headings(rng, 5)"):
            first, second = (self.model.headings(np.random.default_rng(1), 5) for _ in range(2))
        array = np.asarray(first)
        is_valid = array.shape == (5,) and array.dtype.kind in "iufc" and bool(np.allclose(np.abs(array), 1.0))
        self.tested.require(
            is_valid, f"headings(rng, 5) returns {value_text(first)}, expected 5 complex numbers of length 1"
        )
        self.tested.require(
            np.array_equal(array, second), "headings(rng, 5) returns others for an equal rng; draw from rng only"
        )

    def check_steering(self, call: _Call) -> None:
        """Require that `steered` replaces the command of the guidance by one that is no faster."""
        aim = 3.0 * rect(1.0, abs(call.position))
        text = f"steered({call.command:.3g}, {call.course}, {aim:.3g}, {CAPTURE_RADIUS})"
        with self.tested.blaming(text):
            steered = complex(self.model.steered(call.command, call.course, aim, CAPTURE_RADIUS))
        self.tested.require(
            abs(steered) <= abs(call.command) * (1.0 + TOLERANCE),
            f"{text} returns {steered}, expected a velocity of at most {abs(call.command):.4g} m/s",
        )

    def check_capture_times(self) -> None:
        """Check the shape and the lower bounds of capture times, alone and together, and those of a head-on chase."""
        rng = np.random.default_rng(2)
        count = 8
        offsets = rng.uniform(0.5, 8.0, count) * np.exp(1j * rng.uniform(-pi, pi, count))
        offsets[0] = 0.05  # within the capture radius
        headings = np.exp(1j * rng.uniform(-pi, pi, count))
        speeds = np.array([2.0, 0.5, 0.9, 2.0, 3.0, 1.5, 2.0, 1.0])
        courses = Courses(headings * speeds * (np.arange(count) % 2), headings)  # every second pursuer is at rest
        original = [array.tobytes() for array in (offsets, *courses, speeds)]
        times = self._times(offsets, courses, speeds)
        call = "capture_times(offsets, courses, speeds, evader_speed, radius)"
        is_unchanged = original == [array.tobytes() for array in (offsets, *courses, speeds)]
        self.tested.require(is_unchanged, f"{call} changes one of its arrays; copy it")
        least = RadialTime(speeds, EVADER_SPEED, CAPTURE_RADIUS)(lengths(offsets))
        for k, (time, bound) in enumerate(zip(times.tolist(), least.tolist(), strict=True)):
            where = f"{call} of a pursuer of {speeds[k]} m/s at {abs(offsets[k]):.4g} m is {time:.6g} s"
            self.tested.require(
                bound * (1.0 - TOLERANCE) <= time,
                f"{where}, expected at least {bound:.6g} s: so long takes a body that is at full speed at once",
            )
            self.tested.require(bound > 0.0 or time == 0.0, f"{where}, expected 0 within the capture radius")
            alone = self._times(offsets[[k]], Courses(*(array[[k]] for array in courses)), speeds[[k]]).item()
            self.tested.require(
                alone == time or abs(alone - time) <= TOLERANCE * time,
                f"{where} among {count}, and {alone:.6g} s alone: expected equal times",
            )
        self._check_head_on()

    def _check_head_on(self) -> None:
        """Compare a capture time with the motion: a pursuer at rest that faces the evader, 5 m away."""
        offset, speed = 5.0 + 0j, 2.0
        at_rest = Course(0j, 1.0 + 0j)
        courses = Courses(np.array([at_rest.velocity]), np.array([at_rest.heading]))
        time = self._times(np.array([offset]), courses, np.array([speed])).item()
        piece = self.piece(_Call(0j, at_rest, speed + 0j))
        evader = Piece(offset, Course(EVADER_SPEED + 0j))
        moved = first_contact_of_pieces(evader, piece, CAPTURE_RADIUS, 0.0, 1e4)
        reached = inf if moved is None else moved
        self.tested.require(
            reached == time or abs(reached - time) <= 0.01 * reached,
            f"capture_times of a pursuer of {speed} m/s at rest that faces an evader of {EVADER_SPEED} m/s at"
            f" {abs(offset):g} m is {time:.4g} s, and its motion takes {reached:.4g} s",
        )

    def _times(self, offsets: Any, courses: Courses, speeds: Any) -> Any:
        call = f"capture_times(offsets, courses, speeds, evader_speed, radius) of {len(speeds)} pursuers"
        with self.tested.blaming(call):
            reply = self.model.capture_times(offsets, courses, speeds, EVADER_SPEED, CAPTURE_RADIUS)
        times = np.asarray(reply)
        is_valid = times.shape == speeds.shape and times.dtype.kind in "iuf" and not np.isnan(times).any()
        self.tested.require(
            is_valid, f"{call} returns {value_text(reply)}, expected as many times in s, or inf, in an array"
        )
        return times


@naming_arguments
def check_body(body: Any, *, limit: float = 10.0) -> None:
    """Check the dynamics of a player; if you are unsure whether your body is right, run this.

    It checks that a call returns a piece of motion that begins where the player is; that positions are continuous and
    are the integral of the velocities; that no speed is above those of the course and the command; that the limit named
    by the dynamics is kept; that a repeated command changes nothing, so that pieces join; that the player comes to
    rest; that contacts are found; that initial headings, steering and capture times are valid, and the capture time of
    a head-on chase is that of the motion; and that two runs of a scenario, with this body for pursuers and for an
    evader, are equal.

    Args:
        body: an object, a class that needs no parameters, a kind, or "module:name".
        limit: the time that each part may take, s of wall time.

    Raises:
        ContractError: an AssertionError; if the model is wrong, with the call, the input and what is expected.
    """
    tested = subject(body, DYNAMICS, "body")
    with tested.judged("body(position, course, command)", limit), tested.fresh() as model:
        checked = _Body(tested, model)
        for call in _calls():
            checked.check_motion(call)
            checked.check_joint(call)
            checked.check_steering(call)
        checked.check_rest()
        checked.check_contacts()
        checked.check_headings()
        checked.check_capture_times()
    for where, parts in (
        ("a run of pursuers with it", {"team": Team(count=4, speeds=3.0, dynamics=tested.model)}),
        ("a run of an evader with it", {"evader": Evader(dynamics=tested.model), "team": Team(count=4)}),
    ):
        twice(tested, where, partial(Scenario, horizon=1.0, **parts), limit=limit)

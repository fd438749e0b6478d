"""Dead reckoning: computing where a pursuer is now from a known earlier position, if it has chased an evader since.

During a motion step, all pursuers observe the same motion of the evader: a straight line from its position at the start
of the step. Guidance depends only on this motion and on the position and speed of the pursuer that chases. A pursuer
that has observed the evader can therefore retrace the path of a teammate.

This is exact for simple motion. A teammate with inertia follows, up to the end of the motion step, the command that it
was given at the start of the step or when its action changed. From an announcement at any other instant, the command is
computed anew, with a small error.

A query goes on from the cached state of the last query of the same chase. Kept equal to a path from its beginning by
`tests/pursuit/test_dead_reckoning.py::test_an_incremental_query_equals_a_fresh_one`.
"""

from bisect import bisect_left, bisect_right
from typing import NamedTuple

from desim.kernel.core.units import seconds
from desim.pursuit.motion.dynamics import Course, Dynamics, piece_with, steered_with
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.guidance import Guidance, guided_velocity
from desim.pursuit.paths.space import PLANE, Plane

_new = tuple.__new__  # creates a named tuple in a third of the time
MAX_RETRACINGS = 10_000
"""Maximum number of retraced paths in the cache."""


class TrackSegment(NamedTuple):
    """The evader as pursuers observe it during one motion step."""

    begun: int
    """Start of the step, ns."""
    evader: complex
    """Position of the evader at the start of the step, m."""
    aim: complex
    """The point that pursuers aim at, m."""
    velocity: complex
    """The observed velocity of the evader, m/s."""
    end: int
    """End of the step, ns."""

    def at(self, t: int) -> complex:
        """Return the observed position, m, of the evader at an instant, ns."""
        return self.evader + self.velocity * seconds(t - self.begun)


class MotionState(NamedTuple):
    """The position and the course of a pursuer at one instant."""

    position: complex
    """m"""
    course: Course | None = None
    """None: unknown; the motion of the pursuer is then assumed to be simple."""


class EvaderTrack:
    """The observed path of an evader: the present motion step and, if `remembers`, all steps before it.

    Calls of `see` must be in order of time, and so must calls of `retrace` for the same chase (see there).

    Args:
        law: the guidance law of the pursuers.
        dynamics: the dynamics of the pursuers.
        environment: the medium.
        radius: capture radius, m.
        remembers: whether paths can be retraced.
        space: the space in which the players move.

    Attributes:
        last: the present step.
    """

    last: TrackSegment

    def __init__(
        self,
        law: Guidance,
        dynamics: Dynamics,
        environment: Environment,
        radius: float,
        *,
        remembers: bool = True,
        space: Plane = PLANE,
    ):
        self._law, self._dynamics, self._remembers, self._environment = law, dynamics, remembers, environment
        self._radius, self._walled, self._has_flow = radius, space.walled, not environment.is_still
        self._segments: list[TrackSegment] = []
        self._starts: list[int] = []
        """The starts of the segments, ns; a list of numbers is searched in a fraction of the time."""
        self._retracings: dict[tuple[MotionState, float, int], tuple[int, MotionState]] = {}

    def see(self, t: int, evader: complex, aim: complex, velocity: complex, end: int) -> None:
        """Append a motion step at its start; the arguments are those of `TrackSegment`."""
        self.last = _new(TrackSegment, (t, evader, aim, velocity, end))
        if self._remembers:
            self._segments.append(self.last)
            self._starts.append(t)

    def retrace(self, start: MotionState, speed: float, since: int, now: int) -> MotionState:
        """Return the motion at time `now` of a pursuer that began to chase from `start` at time `since`.

        Times are in ns. The first three arguments identify a chase. For each chase, the motion at the start of the last
        retraced motion step is cached, so the cost is O(motion steps since the previous call). A `since` before time 0
        counts as 0, because nothing moves before time 0.
        """
        assert self._remembers
        chase = (start, speed, since)
        began, origin = self._retracings.pop(chase, (max(since, 0), start))
        t, motion = began, origin
        first = bisect_right(self._starts, t) - 1
        last = bisect_left(self._starts, now)  # `now` is in the past if the chase has ended
        ends = [*self._starts[first + 1 : last], now]
        segments = self._segments[first : first + len(ends)]
        for segment, end in zip(segments, ends, strict=False):  # at time 0 there may be no segment yet
            began, origin = t, motion
            motion = self._chase(motion, segment, speed, t, end)
            t = end
        # The start of the last step is kept and not its end: the next call may ask for a later time in the same step,
        # and the course within a step follows from its start. Inserting it again makes it the most recently used.
        self._retracings[chase] = (began, origin)
        if len(self._retracings) > MAX_RETRACINGS:
            del self._retracings[next(iter(self._retracings))]  # the least recently used
        return motion

    def _chase(self, motion: MotionState, segment: TrackSegment, speed: float, begin: int, end: int) -> MotionState:
        """Return the motion at the end of an interval (ns) within a motion step."""
        place, course = motion
        if self._walled is not None:
            return MotionState(self._walled.advance(place, segment.aim, speed, begin, end, segment.end))
        step, duration = seconds(segment.end - begin), seconds(end - begin)
        flow = self._drift(place, 0j, segment, begin)
        # Guidance is relative to the medium: it aims upstream by the drift of the pursuer in this step.
        gap, aim = segment.at(begin) - place, segment.aim - place - flow * step
        command = guided_velocity(self._law, gap, aim, segment.velocity - flow, speed)
        if course is not None:
            command = steered_with(self._dynamics, command, course, aim, self._radius)
        drift = self._drift(place, command, segment, begin)
        if course is None:
            return MotionState(place + (command + drift) * duration)
        piece = piece_with(self._dynamics, place, course, command)
        piece = piece._replace(drift=drift) if drift else piece
        return MotionState(piece.at(duration), piece.course_at(duration))

    def _drift(self, place: complex, command: complex, segment: TrackSegment, now: int) -> complex:
        """Return the mean velocity of the flow, m/s, along the path of a pursuer in the rest of a motion step."""
        if not self._has_flow:
            return 0j
        return self._environment.drift_within(place, command, begun=segment.begun, now=now, until=segment.end)

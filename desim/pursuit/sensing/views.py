"""Views: what a pursuer knows of the evaders without a sensing limit; `sensing` has the limited view."""

from cmath import isnan
from collections.abc import Callable, Collection, Sequence
from math import inf
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Floats, Points
from desim.config.python_numbers import whole
from desim.kernel.core.units import seconds
from desim.pursuit.evaders.evader import MAX_SCALAR_SIZE
from desim.pursuit.motion.dead_reckoning import MotionState
from desim.pursuit.motion.dynamics import piece_with
from desim.pursuit.paths.space import PLANE, Plane
from desim.pursuit.sensing.noise import Covariance, expected_distance
from desim.pursuit.sensing.world_state import WorldState

if TYPE_CHECKING:
    from desim.kernel.core.records import Record

Prune = Literal["none", "inf", "infeasible"]
"""Which pursuers may not chase an evader; see `Scenario.prune`."""
NOWHERE = complex(np.nan, np.nan)
"""Position of an evader of which nothing is known, m."""


class EvaderEstimate(NamedTuple):
    """The estimated position of an evader."""

    position: complex
    """m"""
    velocity: complex = 0j
    """m/s"""
    uncertainty: float = 0.0
    """Upper bound, m, of the distance of the evader from `position`; 0 if this kind of estimate gives no bound."""
    deviation: float = 0.0
    """Standard deviation of each coordinate of `position`, m; 0 if unknown."""
    covariance: Covariance = Covariance(0.0, 0.0, 0.0)
    """Covariance of the error of `position` or, without a filter, of the newest sighting, m^2; 0 without noise."""

    def distance(self, position: complex, space: Plane = PLANE) -> float:
        """Return the distance, m, from a position to the evader: the mean given `deviation`, plus `uncertainty`."""
        distance = space.distance(position, space.free_place(self.position))
        return expected_distance(distance, self.deviation) + self.uncertainty

    def distances(self, positions: Points, space: Plane = PLANE) -> Floats:
        """Return the (N,) distances, m, from positions to the evader; see `distance`."""
        distances = space.distances(positions, space.free_place(self.position))
        if self.deviation:
            distances = np.array([expected_distance(distance, self.deviation) for distance in distances.tolist()])
        return distances + self.uncertainty


class ReckonedTeam(NamedTuple):
    """The positions and capture times of a team, extrapolated from its records at one instant."""

    instant: tuple[int, int, int | None]
    """True time, time by the clock of the pursuer that extrapolates, and time of the capture of the evader, ns."""
    records: "list[Record | None]"
    """(N,) the record from which each row follows."""
    positions: Points
    """(N,) m"""
    capture_times: Floats
    """(N,) s"""


class View:
    """The knowledge of a pursuer about the evaders; this view sees all of them at any distance.

    A view with limited sensing redefines `sees`, `estimate` and `unlimited`, on which the other methods are based. The
    positions, speeds and actions of pursuers are in `state`.

    Args:
        state: the true state of the world.
        prune: which pursuers may not chase an evader.

    Attributes:
        reckoned_teams: by evader, what was last extrapolated from records of the whole team; used by
            `desim.pursuit.team.beliefs`.
        reckonings: by pursuer, what was last extrapolated from a record of it: the record, the instant (ns, of true
            time and by the clock of the pursuer that extrapolated), and the motion. If the instant is None, the motion
            holds at any, because the pursuer stands still. Used by `desim.pursuit.team.beliefs`.
    """

    unlimited: ClassVar[bool] = True
    """Whether it always sees all evaders."""

    def __init__(self, state: WorldState, prune: Prune):
        self.state, self._prune = state, prune
        self._has_flow = not state.environment.is_still
        keeps_distances = state.environment.keeps_distances and state.space.is_open
        self._knows_slow = prune == "inf" and keeps_distances  # whether the speeds alone decide who may chase
        # Whether options change at captures only.
        self._options_last = self.unlimited and prune != "infeasible" and keeps_distances
        self._options: dict[int, tuple[int, ...]] = {}
        self._options_at: Sequence[int] | None = None  # the evaders at large when these options were computed
        self.reckoned_teams: dict[int, ReckonedTeam] = {}
        self.reckonings: dict[int, tuple[Record, tuple[int, int] | None, MotionState]] = {}

    def sees(self, evader: int) -> bool:
        """Return whether the pursuer sees an evader now."""
        return True

    def estimate(self, evader: int) -> EvaderEstimate | None:
        """Return the estimate of an evader; None if it is unknown."""
        return EvaderEstimate(self.state.body(evader).position, self.state.velocity(evader))

    def evader(self, evader: int) -> complex:
        """Return the estimated position of an evader, m; nan if unknown."""
        if self.unlimited:
            return self.state.body(evader).position
        estimate = self.estimate(evader)
        return NOWHERE if estimate is None else estimate.position

    def capture_times(self, evader: int) -> tuple[float, ...]:
        """Return the capture time, s, of each pursuer for an evader at its estimated position.

        All are inf if the evader has been captured or is unknown.
        """
        state, body = self.state, self.state.body(evader)
        if self.unlimited or body.captured is not None or self.sees(evader):
            return body.capture_times(state.now)
        estimate = self.estimate(evader)
        if estimate is None:
            return (inf,) * state.size
        places = state.positions()
        return body.capture_times_at(estimate.position, places, estimate.distances(places, state.space))

    def capture_times_of(self, pursuers: Collection[int], evader: int) -> list[float]:
        """Return the capture times of some pursuers, s; like `capture_times`, and faster for a few.

        Kept equal to the capture times of all by
        `tests/pursuit/test_kinematics.py::test_times_of_capture_of_some_are_those_of_all`. Kept equal to the capture
        times of all at an estimate by
        `tests/pursuit/test_sensing.py::test_capture_times_of_some_at_an_estimate_are_those_of_all`.
        """
        state = self.state
        if self.unlimited or self.sees(evader):
            now = state.now
            if now == state.step_end:  # cache all positions, which the motion step that begins now needs anyway
                state.players.positions()
            return state.body(evader).capture_times_of(pursuers, now)
        if len(pursuers) <= MAX_SCALAR_SIZE and state.body(evader).is_radial:
            motions = [MotionState(state.position(pursuer)) for pursuer in pursuers]
            return self.capture_times_from(list(pursuers), motions, evader)
        times = self.capture_times(evader)
        return [times[pursuer] for pursuer in pursuers]

    def capture_times_from(self, pursuers: Sequence[int], motions: Sequence[MotionState], evader: int) -> list[float]:
        """Return the capture times, s, of k pursuers for an evader, given a hypothetical motion of each.

        They are inf if the evader has been captured or is unknown.
        """
        body, space = self.state.body(evader), self.state.space
        if body.captured is not None:
            return [inf] * len(pursuers)
        if self.unlimited:
            place = body.position
            distances = [space.distance(motion.position, place) for motion in motions]
        else:
            estimate = self.estimate(evader)
            if estimate is None:
                return [inf] * len(pursuers)
            place, distances = estimate.position, [estimate.distance(motion.position, space) for motion in motions]
        return body.capture_times_from(pursuers, motions, place, distances)

    def may_chase(self, pursuer: int, evader: int) -> bool:
        """Return whether a pursuer may choose to chase an evader.

        The evader must be at large, its position must be known or estimated, and `prune` must not exclude the pursuer.
        A relay may chase no evader.
        """
        body = self.state.body(evader)
        if (
            pursuer in self.state.relays
            or body.captured is not None
            or not (self.unlimited or self.estimate(evader) is not None)
        ):
            return False
        if self._knows_slow or self._prune == "none":
            return self._prune == "none" or not body.slow[pursuer]
        (time,) = self.capture_times_of([pursuer], evader)
        return time < (inf if self._prune == "inf" else self.state.time_left(self.state.now))

    def options(self, pursuer: int) -> Sequence[int]:
        """Return the actions that a pursuer may choose: 0, and each evader that it may chase."""
        at_large = self.state.at_large
        if not self._options_last or self._options_at is not at_large:
            self._options, self._options_at = {}, at_large
        options = self._options.get(pursuer)
        if options is None:
            options = (0, *(evader for evader in at_large if self.may_chase(pursuer, evader)))
            self._options[pursuer] = options
        return options

    def reckoned(
        self, start: MotionState, speed: float, age: int, evader: int, *, exact: bool, ended: int = 0
    ) -> MotionState:
        """Return the present motion of a pursuer whose chase of an evader began with `start`, `age` ago.

        If nothing moves, or the position of the evader is unknown, this is `start`.

        Args:
            start: its motion at the start of the chase.
            speed: its speed, m/s.
            age: time since the start of the chase, ns.
            evader: the evader that it chased.
            exact: whether to retrace the pursuer's path, possible only in an unlimited view; otherwise the pursuer is
                assumed to head straight for the evader's present position, as estimated, and to have simple motion.
            ended: time since the chase ended, at most `age`, ns; 0 if the chase continues. The pursuer is assumed to
                have been inactive since then. A later call with the same start must not give an earlier end of the
                chase, because `EvaderTrack.retrace` goes on from the last call.
        """
        state, body = self.state, self.state.body(evader)
        if state.static or age == ended:
            return start
        now, captured = state.now, body.captured
        # The capture of its evader ends a chase, at once if the evader was captured before the chase began.
        end = now - ended if captured is None else min(now - ended, max(captured, now - age))
        if exact and self.unlimited:
            reached = body.path.retrace(start, speed, now - age, end)
        else:
            aim = body.position if captured is not None else self.evader(evader)
            # The flow carries the pursuer during the chase; its own motion is added to this drift.
            drifted = self.idle(MotionState(start.position), age, now - end).position
            length = speed * seconds(end - now + age)
            reached = start if isnan(aim) else MotionState(state.space.along(drifted, aim, length))
        return self.idle(reached, now - end, ended)

    def stands(self, motion: MotionState) -> bool:
        """Return whether a pursuer with this motion stays where it is while it is inactive."""
        state = self.state
        return state.static or (motion.course is None and not self._has_flow)

    def idle(self, motion: MotionState, age: int, until: int = 0) -> MotionState:
        """Return the motion of a pursuer that was inactive from `age` to `until` (both in ns) ago.

        It stands still, or brakes, and the flow carries it.
        """
        if age == until or self.stands(motion):
            return motion
        state, course = self.state, motion.course
        now, place = state.now, motion.position
        if course is not None:
            piece, duration = piece_with(state.dynamics, place, course, 0j), seconds(age - until)
            place, course = piece.at(duration), piece.course_at(duration)
        if self._has_flow:
            place = state.environment.carried(place, now - age, now - until)
        return MotionState(place, course)


class GlobalState(View):
    """The true state of the world and the actions of all pursuers, for omniscient benchmarks.

    Args:
        state, prune: see `View`.
        set_action: a function that sets the action of a pursuer from this instant on. Its arguments are the pursuer and
            the action, the number of an evader or 0.
    """

    def __init__(self, state: WorldState, prune: Prune, set_action: Callable[[int, int], None]):
        super().__init__(state, prune)
        self.set_action = set_action

    def action(self, pursuer: int) -> int:
        """Return the evader that a pursuer chases, or 0.

        Raises:
            ValueError: if there is no such pursuer.
        """
        if not 0 <= (pursuer := whole(pursuer, "a pursuer")) < self.state.size:
            raise ValueError(f"there is no pursuer {pursuer}: they are 0 .. {self.state.size - 1}")
        return self.state.profile[pursuer]

    def profile(self) -> list[int]:
        """Return the action of each pursuer."""
        return self.state.profile.copy()

    def broken(self) -> NDArray[np.bool_]:
        """Return the (N,) mask of the pursuers that are down."""
        return self.state.broken.copy()

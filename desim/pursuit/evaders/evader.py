"""An evader in a run: its body, its controller and its delayed perception."""

from collections import deque
from collections.abc import Collection, Iterable, Sequence
from itertools import repeat
from math import inf

import numpy as np
from numpy.typing import NDArray

from desim.config.answers import wrong_answer
from desim.config.arrays import Floats, Points
from desim.config.python_numbers import as_complex
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.pursuit.core.geometry import SMALLEST
from desim.pursuit.core.state import State, lengths
from desim.pursuit.evaders.evasion import PureEvasion, Strategy, away
from desim.pursuit.evaders.observation import EvaderObservation
from desim.pursuit.motion.capture import RadialTime
from desim.pursuit.motion.dead_reckoning import EvaderTrack, MotionState
from desim.pursuit.motion.dynamics import Courses, Dynamics, TurnRate, capture_times_with
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.flow_capture import capture_times_in_flow
from desim.pursuit.motion.kinematics import CaptureTest, Kinematics
from desim.pursuit.motion.turning import turning_capture_time
from desim.pursuit.paths.space import PLANE, Plane, Walled


class EvaderController:
    """The perception and the decisions of one evader in one run.

    Pure evasion with full and immediate perception is computed from the state, without an observation. Kept equal to an
    observation for the strategy by
    `tests/pursuit/test_perception.py::test_full_and_immediate_perception_gives_exactly_the_heading_of_the_strategy`.

    Args:
        strategy: the evasion strategy, which chooses the heading.
        rng: random stream of the evader's decisions, used by nothing else.
        speed: speed of the evader, m/s.
        speeds: (N,) speeds of the pursuers, m/s.
        radius: capture radius, m.
        sensing_range: range up to which the evader senses pursuers, m.
        reaction_delay: delay, s, with which the evader perceives the positions and actions of pursuers.
        motion_interval: time, s, between two looks from which the evader infers who chases it; 0: it knows the actions.
        motion_error: standard deviation, m, of the error of each coordinate that it observes in a look.
        space: the space in which the players move.
    """

    def __init__(
        self,
        strategy: Strategy,
        rng: np.random.Generator,
        *,
        speed: float,
        speeds: Floats,
        radius: float,
        sensing_range: float = inf,
        reaction_delay: float = 0.0,
        motion_interval: float = 0.0,
        motion_error: float = 0.0,
        space: Plane = PLANE,
    ):
        self._strategy, self._rng = strategy, rng
        self._speed, self._speeds, self._radius, self._sensing_range = speed, speeds, radius, sensing_range
        self._memory = DelayedState(nanoseconds(reaction_delay)) if nanoseconds(reaction_delay) else None
        period = nanoseconds(motion_interval)
        self._inference = InferredActivity(period, motion_error, speeds, rng.spawn(1)[0]) if period else None
        self._space = space
        flees_all = type(strategy) is PureEvasion and strategy.flees_from == "all"
        self._is_pure_evasion = flees_all and sensing_range == inf and self._memory is None and space is PLANE
        self._heading = 0j
        self._heading_stamp: int | None = None

    def heading(self, state: State, handover: bool = False) -> complex:
        """Return the heading of the evader, of length at most 1; calls must be in order of time.

        Args:
            state: the true state.
            handover: whether an announcement of a change of action is in flight.

        Raises:
            ValueError: if the strategy returns no number, or one that is longer than 1 or nan.
        """
        if self._is_pure_evasion:  # the evader of the paper: the same result, several times faster
            return away(state)
        perceived = self._memory(state) if self._memory else state
        if self._inference is not None:
            perceived = self._inference(perceived)
        observation = EvaderObservation(
            perceived,
            self._speeds,
            self._speed,
            self._radius,
            self._heading,
            0.0 if self._heading_stamp is None else seconds(state.stamp - self._heading_stamp),
            handover,
        )
        if self._sensing_range < inf:
            observation = observation.only(observation.distances <= self._sensing_range)
        if self._space.blocks_sight:
            observation = observation.only(self._space.visible(observation.pursuers, observation.evader))
        if self._space is not PLANE:
            observation = observation.within(self._space)
        answer = self._strategy(observation, self._rng)
        heading = as_complex(answer)
        if not abs(heading) <= 1.0 + 1e-9:
            raise wrong_answer("a heading should be a complex number of length at most 1", answer, self._strategy)
        self._heading, self._heading_stamp = heading, state.stamp
        return heading


class DelayedState:
    """Delayed perception: a call returns the present state, but with the pursuers as they were `delay` (ns) earlier.

    Positions are interpolated linearly between the two states around that time; the actions are those of the earlier
    state. The first state also stands for all times before it.
    """

    def __init__(self, delay: int):
        self._delay = delay
        self._states: deque[State] = deque()

    def __call__(self, state: State) -> State:
        """Append a state, not earlier than the last, and return the perceived state."""
        states, perceived = self._states, state.stamp - self._delay
        states.append(state)
        while len(states) > 1 and states[1].stamp <= perceived:
            states.popleft()
        pursuers = states[0].pursuers
        if states[0].stamp < perceived:
            fraction = (perceived - states[0].stamp) / (states[1].stamp - states[0].stamp)
            pursuers = pursuers + fraction * (states[1].pursuers - pursuers)
        return State(state.stamp, pursuers, state.evader, states[0].active)


class InferredActivity:
    """Activity that is inferred from motion: a call returns a state in which the pursuers that seem to move are active.

    The evader looks at the pursuers in intervals. A pursuer that seems to have moved between two looks by more than
    half of what its speed allows counts as active until the next look. The evader therefore notices a change after
    0.5 to 1.5 intervals. Before the second look, all pursuers count as active.

    A pursuer of speed v that stands still counts as active after a look with the probability exp(-(v T / 4 s)^2), where
    T is the interval and s the standard deviation of errors: the difference of two observed positions has the deviation
    sqrt(2) s per coordinate, so its length has a Rayleigh distribution.

    Args:
        interval: T, ns; the next look is at the first state that is at least T later than the last look.
        error: s, the standard deviation of each observed coordinate, m.
        speeds: (N,) the speeds of the pursuers, m/s.
        rng: the random stream of the errors.
    """

    def __init__(self, interval: int, error: float, speeds: Floats, rng: np.random.Generator):
        self._interval, self._error, self._speeds, self._rng = interval, error, speeds, rng
        self._last_look: tuple[int, Points] | None = None
        self._active: NDArray[np.bool_] = np.ones(len(speeds), dtype=bool)

    def __call__(self, state: State) -> State:
        """Return a state, not earlier than the last, with the inferred activity."""
        last_stamp, last_positions = self._last_look or (-self._interval, None)
        if state.stamp >= last_stamp + self._interval:
            x_errors, y_errors = self._rng.standard_normal((2, len(self._speeds)))
            positions = state.pursuers + self._error * (x_errors + 1j * y_errors)
            if last_positions is not None:
                reach = self._speeds * seconds(state.stamp - last_stamp)
                self._active = lengths(positions - last_positions) > 0.5 * reach
            self._last_look = state.stamp, positions
        return State(state.stamp, state.pursuers, state.evader, self._active)


MAX_SCALAR_SIZE = 16
"""Up to this number of pursuers, scalar computations are faster than array operations over the team."""


class EvaderBody:
    """An evader in the world: its position and velocity, the capture times of the pursuers, and its capture.

    It is at large until `captured` is set. From then on it stands still, and its `capture_times` are inf.

    Args:
        number: its number, 1 .. M; a pursuer that chases it has this number as its action.
        speed: its speed, m/s.
        controller: its controller, which chooses its heading.
        path: the record of its motion, from which pursuers observe it.
        players: positions and velocities of all players: the N pursuers, then the evaders in order.
        speeds: (N,) speeds of the pursuers, m/s.
        radius: capture radius, m.
        top_speed: the greatest speed of any pursuer, m/s.
        dynamics: the dynamics of the pursuers.
        environment: the medium, whose flow may carry the players.
        space: the space in which the players move.
        is_recorded: whether a record determines its motion.
        relays: the pursuers that never chase; their capture times are inf, wherever the evader is.

    Attributes:
        slow: (N,) whether each pursuer is no faster than the evader.
        is_radial: whether capture times are functions of the distances alone.
        captured: time of its capture, ns; None while it is at large.
        player: its index among the players.
    """

    def __init__(
        self,
        number: int,
        speed: float,
        controller: EvaderController,
        path: EvaderTrack,
        *,
        players: Kinematics,
        speeds: Floats,
        radius: float,
        top_speed: float,
        dynamics: Dynamics,
        environment: Environment,
        space: Plane = PLANE,
        is_recorded: bool = False,
        relays: Collection[int] = (),
    ):
        self.number, self.speed, self.path = number, speed, path
        self._size, self._radius, self._speeds, self._dynamics = len(speeds), radius, speeds, dynamics
        self._environment, self.is_radial = environment, dynamics.is_simple and environment.keeps_distances
        self._space, self._walled, self._is_recorded = space, space.walled, is_recorded
        self._relays = tuple(relays)
        self._has_single_times = self.is_radial or type(dynamics) is TurnRate
        """Whether capture times are computed pursuer by pursuer, and not in arrays over all pursuers."""
        self.player = self._size + number - 1
        self._controller, self._players = controller, players
        self._radial_time = RadialTime(speeds, speed, radius)
        self.slow: list[bool] = self._radial_time.slow.tolist()
        self._closing_bound = max(top_speed + speed, 1e-9)  # bound on the closing speed, m/s
        self.captured: int | None = None
        self._chasers: NDArray[np.bool_] = np.zeros(self._size, dtype=bool)
        self._safe_until = -1  # no capture is possible up to this time, ns
        self._state: State | None = None
        self._state_positions: Points | None = None  # the positions from which _state was computed
        self._times: tuple[float, ...] | None = None
        # The position of the evader, and the lengths of paths to it by the position of the pursuer.
        self._lengths_to: tuple[complex, dict[complex, float]] | None = None

    @property
    def position(self) -> complex:
        """Its present position, m."""
        return self._players.position(self.player)

    def set_chasers(self, chasers: NDArray[np.bool_]) -> None:
        """Set the (N,) mask of the pursuers that chase it from now on."""
        chasers.setflags(write=False)
        self._chasers, self._state_positions = chasers, None

    def state(self, now: int) -> State:
        """Return the state of the pursuit of this evader at `now` (ns)."""
        places = self._players.positions()
        if self._state is None or places is not self._state_positions:
            self._state = State(now, places[: self._size], places.item(self.player), self._chasers)
            self._state_positions, self._times = places, None
        return self._state

    def capture_times(self, now: int) -> tuple[float, ...]:
        """Return the capture time, s, of each pursuer at `now` (ns); inf once the evader has been captured."""
        if self.captured is not None:
            return (inf,) * self._size
        state = self.state(now)
        if self._times is None:
            distances = state.distances
            if self._walled is not None:
                distances = self._walled.distances(state.pursuers, state.evader)
            self._times = self.capture_times_at(state.evader, state.pursuers, distances)
        return self._times

    def capture_times_of(self, pursuers: Collection[int], now: int) -> list[float]:
        """Return the capture times, s, of some pursuers at `now` (ns); inf once the evader has been captured.

        Kept equal to the capture times of all by
        `tests/pursuit/test_kinematics.py::test_times_of_some_are_those_of_all_with_inertia`.
        """
        if len(pursuers) > MAX_SCALAR_SIZE or self.captured is not None or not self._has_single_times:
            times = self.capture_times(now)
            return [times[pursuer] for pursuer in pursuers]
        players = self._players
        if self._walled is None:
            distances = players.distances(self.player, pursuers)
        else:
            distances = self._path_lengths(self._walled, pursuers)
        motions: list[MotionState] = []
        if not self.is_radial:
            motions = [MotionState(players.position(pursuer), players.course(pursuer)) for pursuer in pursuers]
        return self.capture_times_from(pursuers, motions, self.position, distances)

    def _path_lengths(self, walled: Walled, pursuers: Iterable[int]) -> list[float]:
        """Return the lengths of the paths from some pursuers to the evader's present position, m, with a cache."""
        place, cached = self.position, self._lengths_to
        if cached is None or cached[0] != place:
            cached = self._lengths_to = place, {}
        length_from = cached[1]
        positions = list(map(self._players.position, pursuers))
        missing = [position for position in positions if position not in length_from]
        if missing:
            length_from.update(zip(missing, walled.distances(np.array(missing), place).tolist(), strict=True))
        return [length_from[position] for position in positions]

    def capture_times_at(self, place: complex, pursuers: Points, distances: Floats) -> tuple[float, ...]:
        """Return the capture time, s, of each pursuer for this evader at an assumed position; it must be at large.

        Args:
            place: the assumed position, m.
            pursuers: (N,) positions of the pursuers, m.
            distances: (N,) distances from the pursuers to the evader, m; among walls, lengths of paths. If the position
                is uncertain, a caller passes greater distances, so that capture times are cautious.
        """
        if self.is_radial:
            times = self._radial_time(distances)
        else:
            courses = None if self._dynamics.is_simple else self._players.courses(range(self._size))
            times = self._planar_times(place, pursuers, distances, courses, self._speeds)
        for relay in self._relays:
            times[relay] = inf
        return tuple(times.tolist())

    def capture_times_from(
        self, pursuers: Collection[int], motions: Sequence[MotionState], place: complex, distances: Sequence[float]
    ) -> list[float]:
        """Return the capture times, s, of k pursuers with assumed motions; see `capture_times_at`.

        If the capture times depend on distances alone (`is_radial`), the motions may be empty.
        """
        if self.is_radial:
            times = list(map(self._radial_time.of, pursuers, distances))
        else:
            times = list(map(self._capture_time_from, pursuers, motions, repeat(place), distances))
        if self._relays:
            return [inf if pursuer in self._relays else time for pursuer, time in zip(pursuers, times, strict=True)]
        return times

    def _capture_time_from(self, pursuer: int, motion: MotionState, place: complex, distance: float) -> float:
        course = motion.course
        if course is None and not self._dynamics.is_simple:
            return self._radial_time.of(pursuer, distance)
        if type(self._dynamics) is TurnRate and course is not None:  # the same result as below, three times as fast
            offset, speed = place - motion.position, self._speeds.item(pursuer)
            stretched = offset * (distance / max(abs(offset), SMALLEST))
            limit = self._dynamics.limit
            return turning_capture_time(stretched, course.heading, speed, self.speed, self._radius, limit)
        courses = None if course is None else Courses(np.array([course.velocity]), np.array([course.heading]))
        positions, distances = np.array([motion.position]), np.array([distance])
        speeds = self._speeds[pursuer : pursuer + 1]
        return float(self._planar_times(place, positions, distances, courses, speeds)[0])

    def _planar_times(
        self, place: complex, pursuers: Points, distances: Floats, courses: Courses | None, speeds: Floats
    ) -> Floats:
        """Return the (k,) capture times, s, of pursuers with inertia, or in a flow; see `capture_times_at`."""
        if self._dynamics.is_simple or courses is None:
            return capture_times_in_flow(
                self._environment, place, pursuers, distances, speeds, self.speed, self._radius, self._players.now
            )
        offsets = place - pursuers
        stretched = offsets * (distances / np.maximum(lengths(offsets), SMALLEST))
        return capture_times_with(self._dynamics, stretched, courses, speeds, self.speed, self._radius)

    def choose_velocity(self, state: State, *, handover: bool) -> complex:
        """Return the velocity, m/s, that the evader chooses in the present state; 0 once it has been captured.

        Args:
            state: the present state, from the method `state`.
            handover: whether an announcement of a change of action is in flight.
        """
        if self.captured is not None:
            return 0j
        return self.speed * self._controller.heading(state, handover)

    def slid(self, velocity: complex, duration: float) -> complex:
        """Return the velocity, m/s, of the evader in a motion step of a duration (s), given the velocity it chooses.

        Walls that it would meet in the step deflect it. They do not deflect a recorded motion.
        """
        if self._walled is None or self._is_recorded:
            return velocity
        return self._walled.slide(self.position, velocity * duration) / duration

    def contact(self, now: int, until: int, broken: NDArray[np.bool_], test: CaptureTest) -> tuple[float, int] | None:
        """Return the first capture that `test` finds up to `until` if no motion changes, or None.

        Args:
            now: the present, ns.
            until: end of the interval, ns.
            broken: (N,) mask of pursuers that are down and capture nothing.
            test: see `desim.scenario.scenario.Capture`.

        Returns:
            (time from now to the capture, s; id of the capturer).
        """
        if until <= self._safe_until:
            return None
        state = self.state(now)
        gap = state.distances.item(state.nearest) - self._radius
        # Whatever the velocities, no capture is possible up to this time; the factor 0.999 is a margin for rounding.
        # The time is in the past if a pursuer is within the radius.
        self._safe_until = now - 1 + int(0.999 * gap / self._closing_bound * SECOND)
        if until <= self._safe_until:
            return None
        duration = seconds(until - now)
        if self._walled is not None:
            return self._contact_among_walls(state, broken, duration, test)
        return self._players.contact(self.player, state.offsets, broken, self._radius, duration, test)

    def _contact_among_walls(
        self, state: State, broken: NDArray[np.bool_], duration: float, test: CaptureTest
    ) -> tuple[float, int] | None:
        """Return the first capture on a path that no wall crosses, as `contact` does."""
        assert self._walled is not None
        players, radius = self._players, self._radius
        evader, evader_velocity = state.evader, players.velocity(self.player)
        contacts: list[tuple[float, int]] = []  # (time, s; pursuer), or (distance at the end of the step, m; pursuer)
        near = state.distances <= radius + self._closing_bound * duration
        for pursuer in (near & ~broken).nonzero()[0].tolist():
            position, velocity = players.position(pursuer), players.velocity(pursuer)
            if test == "segment":
                time = self._walled.contact(evader, evader_velocity, position, velocity, radius, duration)
                contacts += [(time, pursuer)] if time is not None else []
            else:
                distance = self._walled.distance(position + velocity * duration, evader + evader_velocity * duration)
                contacts += [(distance, pursuer)] if distance <= radius else []
        first = min(contacts, default=None)
        return first if first is None or test == "segment" else (duration, first[1])

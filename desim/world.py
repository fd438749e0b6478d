"""The world: where everyone is and what they do, moved by a process of its own on a clock of its own."""

from collections.abc import Callable, Generator
from itertools import count
from typing import Literal

import numpy as np
import simpy

from desim.kernel.clock import Clock, Instant, Phase, nanoseconds, seconds
from desim.kernel.events import Trace
from desim.kernel.seeds import stream
from desim.pursuit.capture import RadialTime
from desim.pursuit.events import Decided, Ended, Halted, Sampled, Started
from desim.pursuit.guidance import ConstantBearing, PurePursuit
from desim.pursuit.motion import first_contact, within
from desim.pursuit.reckoning import Sightings, nearer
from desim.pursuit.state import Floats, Points, State, complex_points, coordinates
from desim.scenario import Scenario
from desim.value import FARTHEST


class World:
    """The only thing that changes during a run, beside the network.

    Everyone moves in straight pieces that all began at one instant: the last motion step, or the last order inside
    it. Capture is foreseen from the pieces and happens at its instant, unless an order comes first.
    """

    def __init__(self, env: Clock, scenario: Scenario, seed: int, trace: Trace):
        self._env, self._trace = env, trace
        self._capture, self._motion = scenario.capture, scenario.motion
        self._horizon = nanoseconds(scenario.horizon)
        self._flee, self._evader_speed = scenario.evader.strategy, scenario.evader.speed
        self._evader_rng = stream(seed, "evader strategy")
        self._speeds = np.array(scenario.team.all_speeds())
        self._guidance = scenario.team.guidance
        self._radial_time = RadialTime(self._speeds, self._evader_speed, self._capture.radius)
        self._slow: list[bool] = self._radial_time.slow.tolist()
        self._prune = scenario.prune
        self._closing_bound = float(self._speeds.max()) + self._evader_speed
        self._sampling = scenario.record.trajectory
        self.size = scenario.team.count
        self.over = env.event()
        self.end: Ended | None = None

        self._origins = complex_points(np.vstack([scenario.team.start(seed), scenario.evader.start(seed)]))
        self._since = 0
        self._velocities = np.zeros_like(self._origins)
        self._step_end = 0
        self._capture_ahead: simpy.Event | None = None
        self._broken = np.zeros(self.size, dtype=bool)
        self._seen = Sightings(self._guidance, remembers=_reckons(scenario))
        self._active = scenario.team.start_profile(seed)
        self._state = State(0, self._origins, self._active)
        self._capture_times: tuple[float, ...] | None = None
        self._active = self._active & [self.may_chase(pursuer) for pursuer in range(self.size)]
        self._enter(State(0, self._origins, self._active))
        self._paces = self._speeds * self._active

    def begin(self) -> None:
        """Record the start and set motion, record and horizon going."""
        evader, pursuers = _points(self.state())
        self._trace.append(Started(0, evader, pursuers, tuple(self._speeds.tolist()), self.profile()))
        self._at(self._horizon, Phase.CAPTURE + 1, lambda _: self.finish("horizon"))
        self._at(0, Phase.CAPTURE, lambda _: self._foresee_capture())
        if not self._motion.frozen:
            self._env.process(self._move(nanoseconds(self._motion.step)))
        if self._sampling:
            self._env.process(self._samples(nanoseconds(self._sampling)))

    # What can be sensed.

    def state(self) -> State:
        """Return where everyone is now, and who chases."""
        now = self._env.now
        if self._state.t != now and not self._motion.frozen:
            elapsed = seconds(now - self._since)
            self._enter(State(now, self._origins + self._velocities * elapsed, self._active))
        return self._state

    def capture_times(self) -> tuple[float, ...]:
        """Return every pursuer's time of capture now, s."""
        state = self.state()
        if self._capture_times is None:
            self._capture_times = tuple(self._radial_time(state.distances).tolist())
        return self._capture_times

    def time_left(self, now: int) -> float:
        """Return the time from an instant (ns) to the horizon, r, s; in a frozen game it does not run."""
        return seconds(self._horizon if self._motion.frozen else self._horizon - now)

    def may_chase(self, pursuer: int) -> bool:
        """Return whether a pursuer has the choice to chase (`Scenario.prune`)."""
        if self._prune == "infeasible":
            return self.capture_times()[pursuer] < self.time_left(self._env.now)
        return self._prune == "none" or not self._slow[pursuer]

    def capture_time_from(self, pursuer: int, position: complex) -> float:
        """Return the time of capture of a pursuer if it were at a position (m), s."""
        return self._radial_time.of(pursuer, abs(self.state().evader - position))

    def place(self, pursuer: int) -> complex:
        """Return the position of a pursuer, m."""
        return complex(self.state().players[pursuer])

    def places(self) -> Points:
        """Return the (N,) positions of the pursuers, m."""
        return self.state().pursuers

    def evader(self) -> complex:
        """Return the position of the evader, m."""
        return self.state().evader

    @property
    def radius(self) -> float:
        """Return the distance at which the evader is captured, m."""
        return self._capture.radius

    def speed(self, pursuer: int) -> float:
        """Return how fast a pursuer moves if it does, m/s."""
        return float(self._speeds[pursuer])

    def reckoned(self, position: complex, speed: float, age: int, *, exact: bool) -> complex:
        """Return where a pursuer is that was at a position (m) an age (ns) ago and has chased since, m.

        Exact: along its pursuit of the evader, whose path everybody has seen; else straight towards where the evader
        is now.
        """
        if self._motion.frozen or not age:
            return position
        if not exact:
            return nearer(position, self.state().evader, speed * seconds(age))
        now = self._env.now
        return self._seen.place(position, speed, now - age, now)

    def obeys(self, pursuer: int) -> bool:
        """Return whether a pursuer would follow an order: it is not broken."""
        return not self._broken[pursuer]

    def active(self, pursuer: int) -> bool:
        """Return whether a pursuer chases."""
        return bool(self._active[pursuer])

    def profile(self) -> tuple[bool, ...]:
        """Return who chases."""
        return tuple(self._active.tolist())

    # What changes it.

    def order(self, pursuer: int, active: bool) -> None:
        """Let a pursuer chase or stay from this very instant on; one that may not chase stays.

        Raises:
            ValueError: if there is no such pursuer.
        """
        if not 0 <= pursuer < self.size:
            raise ValueError(f"there is no pursuer {pursuer}: they are 0 .. {self.size - 1}")
        active = bool(active) and not self._broken[pursuer] and self.may_chase(pursuer)
        self._trace.append(Decided(self._env.now, pursuer, active))
        self._set(pursuer, active)

    def halt(self, pursuer: int) -> None:
        """Let a pursuer break down: it stays where it is, whatever it is ordered, and captures nobody."""
        self._broken = self._broken.copy()
        self._broken[pursuer] = True
        if self._active[pursuer]:
            self._trace.append(Halted(self._env.now, pursuer))
            self._set(pursuer, active=False)
        self._foresee_capture()

    def repair(self, pursuer: int) -> None:
        """Let a pursuer that broke down obey again; it stays until it is ordered to chase."""
        self._broken = self._broken.copy()
        self._broken[pursuer] = False
        self._foresee_capture()

    def _set(self, pursuer: int, active: bool) -> None:
        """Let a pursuer chase or stay from this instant on."""
        if self._active[pursuer] == active:
            return
        now, state = self._env.now, self.state()
        self._active = self._active.copy()
        self._active[pursuer] = active
        self._paces = self._speeds * self._active
        self._enter(State(now, state.players, self._active))
        if now < self._step_end:  # inside a step; at its end everyone is about to get a new heading anyway
            sight, place = self._seen.last, state.players[[pursuer]]
            velocities = self._velocities.copy()
            velocities[[pursuer]] = self._courses(
                sight.at(now) - place, sight.aim - place, sight.flight, self._paces[[pursuer]]
            )
            self._break(velocities)

    def sample(self) -> None:
        """Record where everyone is, if positions are wanted."""
        if self._sampling:
            self._trace.append(Sampled(self._env.now, *_points(self.state())))

    def finish(self, reason: Literal["captured", "horizon", "stopped"], capturer: int | None = None) -> None:
        """End the pursuit at this instant; only the first end counts."""
        if self.end is None:
            self.end = Ended(self._env.now, reason, capturer)
            self.over.succeed()

    def stop(self) -> None:
        """End the pursuit when all that happens at this instant has happened."""
        self._at(self._env.now, Phase.SAMPLE + 1, lambda _: self.finish("stopped"))

    def _move(self, step: int) -> Generator[simpy.Event, None, None]:
        """Give everyone a new heading at every motion step."""
        for end in count(step, step):
            yield Instant(self._env, self._step_end, Phase.MOTION)
            state = self.state()
            self._step_end = min(end, self._horizon)
            heading = self._flee(state, self._evader_rng)
            if not abs(heading) <= 1.0 + 1e-9:
                raise ValueError(f"an evader's heading should be at most 1 long, got {heading} from {self._flee!r}")
            flight = self._evader_speed * heading
            first = self._motion.order == "evader_first"
            ahead = flight * seconds(self._step_end - state.t) if first else 0j
            seen = flight if first else complex(self._velocities[-1])
            self._seen.see(state.t, state.evader, state.evader + ahead, seen)
            velocities = np.empty_like(state.players)
            velocities[:-1] = self._courses(state.offsets, state.offsets + ahead, seen, self._paces)
            velocities[-1] = flight
            self._break(velocities)

    def _courses(self, gaps: Points, aims: Points, flight: complex, speeds: Floats) -> Points:
        """Return the velocities that the law of guidance gives, m/s; see `desim.pursuit.guidance.Guidance`."""
        law = self._guidance
        velocities = law(gaps, aims, flight, speeds)
        if not isinstance(law, PurePursuit | ConstantBearing) and not (abs(velocities) <= speeds * (1.0 + 1e-9)).all():
            raise ValueError(f"nobody should be led faster than at {speeds} m/s, got {velocities} from {law!r}")
        return velocities

    def _break(self, velocities: Points) -> None:
        """Begin new straight pieces here and now."""
        self._origins, self._since = self.state().players, self._env.now
        self._velocities = velocities
        self._foresee_capture()

    def _foresee_capture(self) -> None:
        """Find out whether the present pieces lead to a capture before the step ends; if so, let it happen then."""
        self._capture_ahead = None
        if self._motion.frozen:
            return
        state, radius = self.state(), self._capture.radius
        duration = seconds(self._step_end - state.t)
        if state.distances[state.nearest] - radius > self._closing_bound * duration:
            return
        approach = self._velocities[-1] - self._velocities[:-1]
        offsets = np.where(self._broken, FARTHEST, state.offsets) if self._broken.any() else state.offsets
        if self._capture.test == "segment":
            contact = first_contact(offsets, approach, radius, duration)
        else:
            row = within(offsets + approach * duration, radius)
            contact = None if row is None else (duration, row)
        if contact is not None:
            after, capturer = contact
            self._capture_ahead = self._at(
                min(state.t + nanoseconds(after), self._step_end),
                Phase.CAPTURE,
                lambda event: self._seize(event, capturer),
            )

    def _seize(self, foreseen: simpy.Event, capturer: int) -> None:
        if foreseen is self._capture_ahead:
            self.finish("captured", capturer)

    def _samples(self, period: int) -> Generator[simpy.Event, None, None]:
        """Record positions at every multiple of a period."""
        for when in count(0, period):
            yield Instant(self._env, when, Phase.SAMPLE)
            self.sample()

    def _at(self, when: int, priority: int, act: Callable[[simpy.Event], None]) -> simpy.Event:
        event = Instant(self._env, when, priority)
        event.callbacks.append(act)
        return event

    def _enter(self, state: State) -> None:
        self._state = state
        self._capture_times = None


def _points(state: State) -> tuple[tuple[float, float], tuple[tuple[float, float], ...]]:
    """Return the positions of the evader and of the pursuers as [x, y]."""
    *pursuers, evader = ((x, y) for x, y in coordinates(state.players).tolist())
    return evader, tuple(pursuers)


def _reckons(scenario: Scenario) -> bool:
    """Return whether the path of the evader has to be remembered."""
    located = scenario.announce.payload == "state" or getattr(scenario.protocol, "reckons", False)
    return located and scenario.announce.reckoning == "exact"

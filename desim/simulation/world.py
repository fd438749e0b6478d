"""The world: positions and actions of all players, and their motion in simulated time."""

from collections.abc import Callable, Collection, Generator, Sequence
from itertools import count
from typing import Literal

import numpy as np
import simpy
from numpy.typing import NDArray

from desim.kernel.clock import SECOND, Clock, Instant, Phase, nanoseconds, seconds
from desim.kernel.events import Trace
from desim.kernel.seeds import stream
from desim.pursuit.dead_reckoning import EvaderTrack, nearer
from desim.pursuit.evader import Eavesdropper, EvaderBody
from desim.pursuit.events import BrokeDown, Captured, Decided, Ended, Sampled, Started
from desim.pursuit.kinematics import Kinematics
from desim.pursuit.sensing import TeamSensor
from desim.pursuit.state import Floats, Points, State, complex_points, coordinates, lengths
from desim.pursuit.steering import Actions, Steering
from desim.pursuit.views import PursuerView
from desim.scenario.scenario import Scenario


class World:
    """The physical state of a run: positions, velocities and actions of pursuers and evaders.

    All players move on straight pieces that begin at a common instant: the last motion step, or the last change of an
    action within it. A capture is predicted from the pieces and scheduled at its instant; a change of an action before
    then replaces the prediction.

    The action of a pursuer is the number of the evader that it chases, 1 .. M, or 0 if it stays. A pursuer is up or
    down (from `crash` until `recover`); while down it stands still, and afterwards it stays until its action is set. An
    evader is at large or captured. The pursuit is running until `over` happens: by a capture, at the horizon, or by
    `stop`.

    Args:
        env: the clock of the simulation.
        scenario: the experiment.
        seed: seed of its random streams.
        trace: receives its events.
        radio: the eavesdropper of evaders that listen; None if none do.

    Attributes:
        size: number of pursuers, N.
        players: kinematics of the pursuers, then the evaders.
        over: SimPy event that happens when the pursuit ends.
        end: outcome of the pursuit; None while it is running.
    """

    def __init__(self, env: Clock, scenario: Scenario, seed: int, trace: Trace, radio: Eavesdropper | None = None):
        self._env, self._trace, self._radio = env, trace, radio
        self._capture, self._motion, self._prune = scenario.capture, scenario.motion, scenario.prune
        self._sampling = scenario.record.trajectory
        self._horizon = nanoseconds(scenario.horizon)
        self.size = scenario.team.count
        self.over = env.event()
        self.end: Ended | None = None

        evaders = [evader.start(seed, index) for index, evader in enumerate(scenario.evaders)]
        start = complex_points(np.vstack([scenario.team.start(seed), *evaders]))
        self.players = Kinematics(env, start, static=scenario.motion.static)
        self._speeds = np.array(scenario.team.all_speeds())
        radius = scenario.capture.radius
        self._targets = [
            EvaderBody(
                number,
                evader.speed,
                evader.controller(stream(seed, "evader strategy", number - 1), self._speeds, radius),
                EvaderTrack(scenario.team.guidance, remembers=_needs_whole_paths(scenario)),
                players=self.players,
                speeds=self._speeds,
                radius=radius,
            )
            for number, evader in enumerate(scenario.evaders, start=1)
        ]
        first = scenario.motion.order == "evader_first"
        self._steering = Steering(self.players, self._targets, scenario.team.guidance, self._speeds, evader_first=first)
        self._at_large = list(self._targets)
        self._uncaptured: Sequence[int] = range(1, len(self._targets) + 1)
        self._options: dict[int, tuple[int, ...]] = {}
        self._single = len(self._targets) == 1
        self._choices = range(len(self._targets) + 1)
        self._needed = scenario.capture.captures_to_end or len(self._targets)
        self._step, self._step_end = nanoseconds(scenario.motion.step), 0
        self._capture_ahead: simpy.Event | None = None
        self._broken = np.zeros(self.size, dtype=bool)
        self._sensor: TeamSensor | None = None
        chased: Actions = scenario.team.start_profile(seed).astype(np.int64)
        if not self._single:
            chased = chased * stream(seed, "start targets").integers(1, len(self._targets) + 1, size=self.size)
        self._act(chased)
        self._prune_actions()

    def attach_sensing(self, sensor: TeamSensor) -> None:
        """Limit the sensing of pursuers, so that they chase the estimated positions of unseen evaders."""
        self._sensor = self._steering.sensor = sensor
        sensor.look(self._env.now)
        self._prune_actions()

    def _prune_actions(self) -> None:
        """Set the action of each pursuer that may not chase its evader to 0."""
        able = [action and self._may_choose(pursuer, action) for pursuer, action in enumerate(self._profile)]
        self._act(self._actions * np.array(able, dtype=bool))

    def begin(self) -> None:
        """Record the start, and start motion, sampling and the horizon."""
        evader, others = self._evaders()
        speeds = tuple(self._speeds.tolist())
        self._trace.append(Started(0, evader, _points(self.positions()), speeds, tuple(self._profile), others))
        self._at(self._horizon, Phase.CAPTURE + 1, lambda _: self.finish("horizon"))
        self._at(0, Phase.CAPTURE, lambda _: self._foresee_capture())
        if not self._motion.static:
            self._at(0, Phase.MOTION, self._move)
        if self._sampling:
            self._env.process(self._samples(nanoseconds(self._sampling)))

    # Observation.

    def state(self, evader: int) -> State:
        """Return the state of the pursuit of one evader now."""
        return self._targets[evader - 1].state(self._env.now)

    def capture_times(self, evader: int) -> tuple[float, ...]:
        """Return the capture time of each pursuer for an evader now, s; inf if the evader has been captured."""
        return self._targets[evader - 1].capture_times(self._env.now)

    def capture_times_of(self, pursuers: Collection[int], evader: int) -> list[float]:
        """Return the capture times of some pursuers, s; like `capture_times`, and faster for a few."""
        if self._env.now == self._step_end:  # all positions will be needed at this instant
            self.players.positions()
        return self._targets[evader - 1].capture_times_of(pursuers, self._env.now)

    def time_left(self, now: int) -> float:
        """Return the time r from an instant (ns) to the horizon, s; constant if `motion.static`."""
        return (self._horizon if self._motion.static else self._horizon - now) / SECOND

    def may_chase(self, pursuer: int, evader: int, view: PursuerView | None = None) -> bool:
        """Return whether a pursuer may choose to chase an evader (`Scenario.prune`).

        The test uses the true capture times, or those of a view if given.
        """
        target = self._targets[evader - 1]
        if target.captured is not None:
            return False
        if self._prune == "infeasible":
            (time,) = (view or self).capture_times_of([pursuer], evader)
            return time < self.time_left(self._env.now)
        return self._prune == "none" or not target.slow[pursuer]

    def options(self, pursuer: int) -> Sequence[int]:
        """Return the actions that a pursuer may choose: 0, and each evader that it may chase."""
        known = self._options.get(pursuer)
        if known is None:
            known = (0, *(evader for evader in self._uncaptured if self.may_chase(pursuer, evader)))
            if self._prune != "infeasible":  # options change with captures only
                self._options[pursuer] = known
        return known

    def _may_choose(self, pursuer: int, evader: int) -> bool:
        """Return whether a pursuer may choose to chase an evader, by its own view of the world."""
        view = self if self._sensor is None else self._sensor.views[pursuer]
        return view.may_chase(pursuer, evader)

    def capture_time_from(self, pursuer: int, position: complex, evader: int) -> float:
        """Return the capture time of a pursuer from a hypothetical position (m), s."""
        return self.capture_time_over(pursuer, abs(self.evader(evader) - position), evader)

    def capture_times_at(self, position: complex, uncertainty: float, evader: int) -> tuple[float, ...]:
        """Return the capture time of each pursuer for an evader at a position (m), each distance increased (m), s."""
        return self._targets[evader - 1].capture_times_over(lengths(position - self.positions()) + uncertainty)

    def capture_time_over(self, pursuer: int, distance: float, evader: int) -> float:
        """Return the capture time of a pursuer at a distance (m), s."""
        return self._targets[evader - 1].capture_time_over(pursuer, distance)

    def distances(self, evader: int) -> Floats:
        """Return the (N,) distances of the pursuers to an evader now, m."""
        return self.state(evader).distances

    def velocity(self, evader: int) -> complex:
        """Return the velocity of an evader now, m/s."""
        return self.players.velocities.item(self._targets[evader - 1].player)

    def evader_speed(self, evader: int) -> float:
        """Return the speed of an evader, m/s."""
        return self._targets[evader - 1].speed

    @property
    def static(self) -> bool:
        """Whether all players stand still for the whole run."""
        return self._motion.static

    def position(self, pursuer: int) -> complex:
        """Return the position of a pursuer, m."""
        return self.players.position(pursuer)

    def positions(self) -> Points:
        """Return the (N,) positions of the pursuers, m."""
        return self.players.positions()[: self.size]

    def evader(self, evader: int) -> complex:
        """Return the position of an evader, m."""
        return self._targets[evader - 1].position

    @property
    def evader_count(self) -> int:
        """Number of evaders at the start, M."""
        return len(self._targets)

    def evaders(self) -> Sequence[int]:
        """Return the numbers of the evaders that have not been captured."""
        return self._uncaptured

    @property
    def radius(self) -> float:
        """The capture radius, m."""
        return self._capture.radius

    def speed(self, pursuer: int) -> float:
        """Return the speed of a pursuer while it chases, m/s."""
        return float(self._speeds[pursuer])

    def reckoned(
        self, position: complex, speed: float, age: int, evader: int, *, exact: bool, ended: int = 0
    ) -> complex:
        """Return the present position of a pursuer that has chased an evader from `position` (m) since `age` ns ago, m.

        Args:
            position: its position at that time, m.
            speed: its speed, m/s.
            age: time since it was at that position, ns.
            evader: the evader that it chased.
            exact: whether to retrace its pursuit of the evader's path; if not, it is extrapolated straight towards the
                present position of the evader.
            ended: time since the chase ended, at most `age`, ns; the end must not move back in later calls with the
                same start.
        """
        if self._motion.static or age == ended:
            return position
        target, now = self._targets[evader - 1], self._env.now
        end = now - ended if target.captured is None else min(now - ended, max(target.captured, now - age))
        if not exact:
            return nearer(position, self.evader(evader), speed * seconds(end - now + age))
        return target.path.position(position, speed, now - age, end)

    def broken(self) -> NDArray[np.bool_]:
        """Return the (N,) mask of the pursuers that are down and follow no action."""
        return self._broken

    def action(self, pursuer: int) -> int:
        """Return the evader that a pursuer chases, or 0."""
        return self._profile[pursuer]

    def profile(self) -> list[int]:
        """Return the action of each pursuer."""
        return self._profile.copy()

    # Changes of state.

    def set_action(self, pursuer: int, action: int) -> None:
        """Let a pursuer chase an evader, or stay (0), from this instant on.

        A pursuer that is down, or may not chase this evader, stays.

        Raises:
            ValueError: if there is no such pursuer or evader.
        """
        if not 0 <= pursuer < self.size:
            raise ValueError(f"there is no pursuer {pursuer}: they are 0 .. {self.size - 1}")
        if action not in self._choices:
            raise ValueError(f"an action should be 0 or an evader, 1 .. {len(self._targets)}, got {action}")
        able = action and not self._broken[pursuer] and self._may_choose(pursuer, action)
        action = int(action) if able else 0
        self._trace.append(Decided(self._env.now, pursuer, action))
        self._change_action(pursuer, action)

    def crash(self, pursuer: int) -> None:
        """Take a pursuer down: it stands still, whatever its action is set to, and captures no evader."""
        self._broken[pursuer] = True
        if self._profile[pursuer]:
            self._trace.append(BrokeDown(self._env.now, pursuer))
            self._change_action(pursuer, 0)
        self._foresee_capture()

    def recover(self, pursuer: int) -> None:
        """Bring a pursuer up again; it stays until its action is set."""
        self._broken[pursuer] = False
        self._foresee_capture()

    def _change_action(self, pursuer: int, action: int) -> None:
        """Change the action of one pursuer from this instant on."""
        if self._profile[pursuer] == action:
            return
        actions = self._actions.copy()
        actions[pursuer] = action
        self._act(actions)
        now = self._env.now
        if now < self._step_end:  # within a step; at its end all players get new velocities
            self._steering.turn(pursuer, now, self._step_end)
            self._foresee_capture()

    def _act(self, actions: Actions) -> None:
        """Set the (N,) actions of all pursuers, without new velocities."""
        self._actions = actions
        self._profile: list[int] = actions.tolist()
        self._steering.set_actions(actions)
        for target in self._targets:
            target.set_chasers(np.equal(actions, target.number))

    def sample(self) -> None:
        """Record all positions, if `record.trajectory` is not 0."""
        if self._sampling:
            evader, others = self._evaders()
            self._trace.append(Sampled(self._env.now, evader, _points(self.positions()), others))

    def finish(self, reason: Literal["captured", "horizon", "stopped"], capturer: int | None = None) -> None:
        """End the pursuit at this instant; later calls have no effect."""
        if self.end is None:
            self.end = Ended(self._env.now, reason, capturer)
            self.over.succeed()

    def stop(self) -> None:
        """End the pursuit after all other events of this instant."""
        self._at(self._env.now, Phase.SAMPLE + 1, lambda _: self.finish("stopped"))

    def _move(self, _: simpy.Event) -> None:
        """Set new velocities for a motion step and schedule the next one, up to the horizon."""
        now = self._env.now
        if now == self._horizon:
            return
        self._step_end = min(now + self._step, self._horizon)
        handover = self._radio is not None and self._radio.hands_over(now)
        self._steering.step(now, self._step_end, handover=handover)
        self._foresee_capture()
        if self._sensor is not None:
            self._sensor.look(now)
        self._at(self._step_end, Phase.MOTION, self._move)

    def _foresee_capture(self) -> None:
        """Schedule the first capture before the end of the step, predicted from the present velocities."""
        self._capture_ahead = None
        if self._motion.static:
            return
        now, end = self._env.now, self._step_end
        first: tuple[float, int] | None = None
        for target in self._at_large:
            contact = target.contact(now, end, self._broken, self._capture.test)
            if contact is not None and (first is None or contact[0] < first[0]):
                first, captured = contact, target
        if first is not None:
            after, capturer = first
            self._capture_ahead = self._at(
                min(now + nanoseconds(after), end),
                Phase.CAPTURE,
                lambda event: self._capture_evader(event, captured, capturer),
            )

    def _capture_evader(self, foreseen: simpy.Event, target: EvaderBody, capturer: int) -> None:
        if foreseen is not self._capture_ahead:
            return
        if not self._single:
            self._trace.append(Captured(self._env.now, target.number, capturer))
            self._remove(target)
        if self._single or len(self._targets) - len(self._at_large) >= self._needed:
            self.finish("captured", capturer)

    def _remove(self, target: EvaderBody) -> None:
        """Capture an evader: it stands still, and its pursuers stay until they decide again."""
        target.captured = self._env.now
        self._at_large.remove(target)
        self._uncaptured = tuple(each.number for each in self._at_large)
        self._options.clear()
        velocities = self.players.velocities.copy()
        velocities[target.player] = 0.0
        velocities[: self.size][self._actions == target.number] = 0.0
        self._act(np.where(self._actions == target.number, 0, self._actions))
        self.players.go(velocities)
        self._foresee_capture()

    def _samples(self, period: int) -> Generator[simpy.Event, None, None]:
        """Record positions at every multiple of a period."""
        for when in count(0, period):
            yield Instant(self._env, when, Phase.SAMPLE)
            self.sample()

    def _at(self, when: int, priority: int, act: Callable[[simpy.Event], None]) -> simpy.Event:
        event = Instant(self._env, when, priority)
        event.callbacks.append(act)
        return event

    def _evaders(self) -> tuple[tuple[float, float], tuple[tuple[float, float], ...]]:
        """Return the positions of the first evader and of the others as [x, y]."""
        first, *others = _points(self.players.positions()[self.size :])
        return first, tuple(others)


def _points(points: Points) -> tuple[tuple[float, float], ...]:
    """Return positions as [x, y]."""
    return tuple((x, y) for x, y in coordinates(points).tolist())


def _needs_whole_paths(scenario: Scenario) -> bool:
    """Return whether dead reckoning needs the whole paths of the evaders."""
    located = scenario.announce.payload == "state" or getattr(scenario.protocol, "reckons", False)
    return located and scenario.announce.reckoning == "exact"

"""The world: where everyone is and what they do, moved on a clock of its own."""

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
    """The only thing that changes during a run, beside the network.

    Everyone moves in straight pieces that all began at one instant: the last motion step, or the last order inside
    it. Capture is foreseen from the pieces and happens at its instant, unless an order comes first.

    The action of a pursuer is the number of the evader that it chases, 1 .. M, or 0 if it stays.

    Args:
        env: the clock of the simulation.
        scenario: what the world is like.
        seed: of its random streams.
        trace: where its events go.
        radio: what evaders that listen hear; nothing if None.

    Attributes:
        size: how many pursuers there are, N.
        players: where everyone is: the pursuers, then the evaders.
        over: happens when the pursuit ends.
        end: how it ended; None as long as it has not.
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
                EvaderTrack(scenario.team.guidance, remembers=_reckons(scenario)),
                players=self.players,
                speeds=self._speeds,
                radius=radius,
            )
            for number, evader in enumerate(scenario.evaders, start=1)
        ]
        first = scenario.motion.order == "evader_first"
        self._steering = Steering(self.players, self._targets, scenario.team.guidance, self._speeds, evader_first=first)
        self._at_large = list(self._targets)
        self._free: Sequence[int] = range(1, len(self._targets) + 1)
        self._options: dict[int, tuple[int, ...]] = {}
        self._lone = len(self._targets) == 1
        self._choices = range(len(self._targets) + 1)
        self._needed = scenario.capture.captures_to_end or len(self._targets)
        self._step, self._step_end = nanoseconds(scenario.motion.step), 0
        self._capture_ahead: simpy.Event | None = None
        self._broken = np.zeros(self.size, dtype=bool)
        self._watch: TeamSensor | None = None
        chased: Actions = scenario.team.start_profile(seed).astype(np.int64)
        if not self._lone:
            chased = chased * stream(seed, "start targets").integers(1, len(self._targets) + 1, size=self.size)
        self._act(chased)
        self._prune_actions()

    def attach_sensing(self, watch: TeamSensor) -> None:
        """Let pursuers see no more than they do, and chase the evaders where they believe them to be."""
        self._watch = self._steering.watch = watch
        watch.look(self._env.now)
        self._prune_actions()

    def _prune_actions(self) -> None:
        """Let those stay that may not do what they do."""
        able = [action and self._may(pursuer, action) for pursuer, action in enumerate(self._profile)]
        self._act(self._actions * np.array(able, dtype=bool))

    def begin(self) -> None:
        """Record the start and set motion, record and horizon going."""
        evader, others = self._evaders()
        speeds = tuple(self._speeds.tolist())
        self._trace.append(Started(0, evader, _points(self.places()), speeds, tuple(self._profile), others))
        self._at(self._horizon, Phase.CAPTURE + 1, lambda _: self.finish("horizon"))
        self._at(0, Phase.CAPTURE, lambda _: self._foresee_capture())
        if not self._motion.static:
            self._at(0, Phase.MOTION, self._move)
        if self._sampling:
            self._env.process(self._samples(nanoseconds(self._sampling)))

    # What can be sensed.

    def state(self, evader: int) -> State:
        """Return where everyone and an evader are now, and who chases it."""
        return self._targets[evader - 1].state(self._env.now)

    def capture_times(self, evader: int) -> tuple[float, ...]:
        """Return every pursuer's time of capture of an evader now, s; inf if that has been captured."""
        return self._targets[evader - 1].capture_times(self._env.now)

    def capture_times_of(self, pursuers: Collection[int], evader: int) -> list[float]:
        """Return the times of capture of some pursuers, s; as `capture_times`, and faster for a few."""
        if self._env.now == self._step_end:  # everybody's position will be asked for at this instant
            self.players.places()
        return self._targets[evader - 1].capture_times_of(pursuers, self._env.now)

    def time_left(self, now: int) -> float:
        """Return the time from an instant (ns) to the horizon, r, s; in a frozen game it does not run."""
        return (self._horizon if self._motion.static else self._horizon - now) / SECOND

    def may_chase(self, pursuer: int, evader: int, view: PursuerView | None = None) -> bool:
        """Return whether a pursuer has the choice to chase an evader (`Scenario.prune`).

        By the true times of capture, or by those of a view.
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
            known = (0, *(evader for evader in self._free if self.may_chase(pursuer, evader)))
            if self._prune != "infeasible":  # they change with captures only
                self._options[pursuer] = known
        return known

    def _may(self, pursuer: int, evader: int) -> bool:
        """Return whether a pursuer has the choice to chase an evader, as far as it knows."""
        view = self if self._watch is None else self._watch.sights[pursuer]
        return view.may_chase(pursuer, evader)

    def capture_time_from(self, pursuer: int, position: complex, evader: int) -> float:
        """Return the time of capture of a pursuer if it were at a position (m), s."""
        return self.capture_time_over(pursuer, abs(self.evader(evader) - position), evader)

    def capture_times_at(self, place: complex, slack: float, evader: int) -> tuple[float, ...]:
        """Return every pursuer's time of capture of an evader were that at a place, and so much farther away (m), s."""
        return self._targets[evader - 1].capture_times_over(lengths(place - self.places()) + slack)

    def capture_time_over(self, pursuer: int, distance: float, evader: int) -> float:
        """Return the time of capture of a pursuer over a distance (m), s."""
        return self._targets[evader - 1].capture_time_over(pursuer, distance)

    def distances(self, evader: int) -> Floats:
        """Return the (N,) distances of the pursuers to an evader now, m."""
        return self.state(evader).distances

    def velocity(self, evader: int) -> complex:
        """Return how an evader moves now, m/s."""
        return self.players.velocities.item(self._targets[evader - 1].player)

    def evader_speed(self, evader: int) -> float:
        """Return how fast an evader can move, m/s."""
        return self._targets[evader - 1].speed

    @property
    def static(self) -> bool:
        """Whether nobody moves."""
        return self._motion.static

    def place(self, pursuer: int) -> complex:
        """Return the position of a pursuer, m."""
        return self.players.place(pursuer)

    def places(self) -> Points:
        """Return the (N,) positions of the pursuers, m."""
        return self.players.places()[: self.size]

    def evader(self, evader: int) -> complex:
        """Return the position of an evader, m."""
        return self._targets[evader - 1].place

    @property
    def evader_count(self) -> int:
        """How many evaders there were at first, M."""
        return len(self._targets)

    def evaders(self) -> Sequence[int]:
        """Return the evaders that have not been captured."""
        return self._free

    @property
    def radius(self) -> float:
        """The distance at which an evader is captured, m."""
        return self._capture.radius

    def speed(self, pursuer: int) -> float:
        """Return how fast a pursuer moves if it does, m/s."""
        return float(self._speeds[pursuer])

    def reckoned(
        self, position: complex, speed: float, age: int, evader: int, *, exact: bool, ended: int = 0
    ) -> complex:
        """Return the position of a pursuer that set out at a position (m) an age (ns) ago to chase an evader, m.

        Exact: along its pursuit of the evader, whose path everybody has seen; else straight towards where the evader
        is now.

        Args:
            position: where it was, m.
            speed: m/s.
            age: how long ago it was there, ns.
            evader: which one it chased.
            exact: whether along its pursuit.
            ended: how long ago it stopped, at most `age`, ns; asked for again with the same start, no longer ago.
        """
        if self._motion.static or age == ended:
            return position
        target, now = self._targets[evader - 1], self._env.now
        end = now - ended if target.captured is None else min(now - ended, max(target.captured, now - age))
        if not exact:
            return nearer(position, self.evader(evader), speed * seconds(end - now + age))
        return target.path.place(position, speed, now - age, end)

    def broken(self) -> NDArray[np.bool_]:
        """Return (N,) who is broken, and so follows no order."""
        return self._broken

    def action(self, pursuer: int) -> int:
        """Return which evader a pursuer chases, or 0."""
        return self._profile[pursuer]

    def profile(self) -> list[int]:
        """Return what everybody does."""
        return self._profile.copy()

    # What changes it.

    def set_action(self, pursuer: int, action: int) -> None:
        """Let a pursuer chase an evader or stay from this very instant on; one that may not chase it stays.

        Raises:
            ValueError: if there is no such pursuer, or no such evader.
        """
        if not 0 <= pursuer < self.size:
            raise ValueError(f"there is no pursuer {pursuer}: they are 0 .. {self.size - 1}")
        if action not in self._choices:
            raise ValueError(f"an action should be 0 or an evader, 1 .. {len(self._targets)}, got {action}")
        able = action and not self._broken[pursuer] and self._may(pursuer, action)
        action = int(action) if able else 0
        self._trace.append(Decided(self._env.now, pursuer, action))
        self._set(pursuer, action)

    def crash(self, pursuer: int) -> None:
        """Let a pursuer break down: it stays where it is, whatever it is ordered, and captures nobody."""
        self._broken[pursuer] = True
        if self._profile[pursuer]:
            self._trace.append(BrokeDown(self._env.now, pursuer))
            self._set(pursuer, 0)
        self._foresee_capture()

    def recover(self, pursuer: int) -> None:
        """Let a pursuer that broke down obey again; it stays until it is ordered to chase."""
        self._broken[pursuer] = False
        self._foresee_capture()

    def _set(self, pursuer: int, action: int) -> None:
        """Let a pursuer do something from this instant on."""
        if self._profile[pursuer] == action:
            return
        actions = self._actions.copy()
        actions[pursuer] = action
        self._act(actions)
        now = self._env.now
        if now < self._step_end:  # inside a step; at its end everyone is about to get a new heading anyway
            self._steering.turn(pursuer, now, self._step_end)
            self._foresee_capture()

    def _act(self, actions: Actions) -> None:
        """Let everybody do something, as far as others ask for it."""
        self._actions = actions
        self._profile: list[int] = actions.tolist()
        self._steering.set_actions(actions)
        for target in self._targets:
            target.set_chasers(np.equal(actions, target.number))

    def sample(self) -> None:
        """Record where everyone is, if positions are wanted."""
        if self._sampling:
            evader, others = self._evaders()
            self._trace.append(Sampled(self._env.now, evader, _points(self.places()), others))

    def finish(self, reason: Literal["captured", "horizon", "stopped"], capturer: int | None = None) -> None:
        """End the pursuit at this instant; only the first end counts."""
        if self.end is None:
            self.end = Ended(self._env.now, reason, capturer)
            self.over.succeed()

    def stop(self) -> None:
        """End the pursuit when all that happens at this instant has happened."""
        self._at(self._env.now, Phase.SAMPLE + 1, lambda _: self.finish("stopped"))

    def _move(self, _: simpy.Event) -> None:
        """Give everyone a new heading, and do so at every motion step up to the horizon."""
        now = self._env.now
        if now == self._horizon:
            return
        self._step_end = min(now + self._step, self._horizon)
        handover = self._radio is not None and self._radio.hands_over(now)
        self._steering.step(now, self._step_end, handover=handover)
        self._foresee_capture()
        if self._watch is not None:
            self._watch.look(now)
        self._at(self._step_end, Phase.MOTION, self._move)

    def _foresee_capture(self) -> None:
        """Find out whether the present pieces lead to a capture before the step ends; if so, let it happen then."""
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
        if not self._lone:
            self._trace.append(Captured(self._env.now, target.number, capturer))
            self._remove(target)
        if self._lone or len(self._targets) - len(self._at_large) >= self._needed:
            self.finish("captured", capturer)

    def _remove(self, target: EvaderBody) -> None:
        """Let an evader be captured: it is still, and who chased it stays until it decides anew."""
        target.captured = self._env.now
        self._at_large.remove(target)
        self._free = tuple(each.number for each in self._at_large)
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
        first, *others = _points(self.players.places()[self.size :])
        return first, tuple(others)


def _points(points: Points) -> tuple[tuple[float, float], ...]:
    """Return positions as [x, y]."""
    return tuple((x, y) for x, y in coordinates(points).tolist())


def _reckons(scenario: Scenario) -> bool:
    """Return whether the paths of the evaders have to be remembered."""
    located = scenario.announce.payload == "state" or getattr(scenario.protocol, "reckons", False)
    return located and scenario.announce.reckoning == "exact"

"""The world of a run: it sets the actions of pursuers, and moves all players in simulated time."""

from collections.abc import Callable, Generator, Sequence
from itertools import count

import numpy as np
import simpy

from desim.config.arguments import value_text
from desim.config.python_numbers import as_python, whole
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Trace
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import nanoseconds
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Sampled, Started, TracePoint
from desim.pursuit.core.state import complex_points
from desim.pursuit.evaders.evader import EvaderBody
from desim.pursuit.motion.dead_reckoning import EvaderTrack
from desim.pursuit.motion.dynamics import Simple
from desim.pursuit.motion.inertia import InertialKinematics
from desim.pursuit.motion.kinematics import Kinematics
from desim.pursuit.sensing.noisy_sensing import NoisySensor, Sensor
from desim.pursuit.sensing.views import View
from desim.pursuit.sensing.world_state import Actions, WorldState
from desim.pursuit.team.announcements import Eavesdropper
from desim.scenario.scenario import Scenario
from desim.simulation.capture_forecast import CaptureForecast
from desim.simulation.run_end import RunEnd
from desim.simulation.steering import Steering

_new = tuple.__new__  # creates a named tuple in a third of the time


class World:
    """The physics of a run: it sets actions, moves players, captures evaders and records these events.

    The path of each player is a sequence of pieces in closed form: a line or, with inertia, a curve and then a line.
    All players have the same breakpoints: the start of each motion step, each change of an action and each capture.
    Motion steps start at multiples of `motion.step` and at the waypoints of recorded motions. The next capture is
    predicted from the present motions. It is predicted again at each breakpoint, and when a pursuer goes down or up.

    The action of a pursuer is the number of the evader that it chases, 1 .. M, or 0 if it is inactive. A pursuer is up
    or down (from `crash` until `recover`). While down it is commanded to stand still; with inertia it brakes, the flow
    carries it, and a relay continues along its record. Afterwards it is inactive until its action is set. An evader is
    at large or captured.

    Args:
        env: the clock of the simulation.
        scenario: the experiment.
        state: the true state of the world at the start; see `initial_state`.
        views: (N,) the view of each pursuer, which determines the evaders that it may chase.
        trace: receives the events of the world.
        end: the end of the run.
        sensor: the sensors of a team with limited sensing; None for any other team.

    Attributes:
        state: the true state of the world.
        eavesdropper: overhears the network for evaders that listen; None if no evader listens.
    """

    def __init__(
        self,
        env: Clock,
        scenario: Scenario,
        state: WorldState,
        views: Sequence[View],
        trace: Trace,
        end: RunEnd,
        sensor: Sensor | None = None,
    ):
        self._env, self._trace, self._end = env, trace, end
        self.state, self._views, self._sensor = state, views, sensor
        self._sample_period = scenario.record.trajectory
        self._estimate_source = sensor if isinstance(sensor, NoisySensor) and scenario.record.estimates else None
        self._step_length = nanoseconds(scenario.motion.step)
        recorded = [evader.record for evader in scenario.evaders if evader.record]
        self._recorded_motions = [*recorded, *state.relays.values()]
        self._captures_to_end = scenario.capture.captures_to_end or state.evader_count
        self._steering = make_steering(scenario, state, sensor)
        self._next_turn: simpy.Event | None = None
        self._forecast = CaptureForecast(env, state, scenario.capture.test, self._capture)
        may_act = [action and views[j].may_chase(j, action) for j, action in enumerate(state.profile)]
        self._set_actions(state.actions * np.array(may_act, dtype=bool))
        listens = any(evader.listens for evader in scenario.evaders)
        self.eavesdropper = Eavesdropper(state.profile) if listens else None

    def begin(self) -> None:
        """Record the start, start motion and sampling, and schedule the end of the run at the horizon."""
        state = self.state
        self._trace.append(Started(0, *self._places(), tuple(state.speeds.tolist()), tuple(state.profile)))
        # After the captures of the same instant, so that a capture at the horizon counts.
        self._at(state.horizon, Phase.CAPTURE + 1, lambda _: self._end.finish("horizon"))
        self._at(0, Phase.CAPTURE, lambda _: self._forecast.update())
        if not state.static:
            self._at(0, Phase.MOTION, self._move)
        if self._sample_period:
            self._env.process(self._samples(nanoseconds(self._sample_period)))

    def set_action(self, pursuer: int, action: int) -> None:
        """Let a pursuer chase an evader, or be inactive (0), from this instant on.

        If the pursuer is down, or may not chase this evader, its action becomes 0.

        Raises:
            ValueError: if there is no such pursuer or evader.
        """
        state = self.state
        if type(pursuer) is not int:
            pursuer = whole(pursuer, "a pursuer")
        if not 0 <= pursuer < state.size:
            raise ValueError(f"there is no pursuer {pursuer}: they are 0 .. {state.size - 1}")
        action = possible_action(self._views[pursuer], pursuer, action)
        self._trace.append(_new(Decided, (self._env.now, pursuer, action)))
        if action != state.profile[pursuer]:
            self._change_action(pursuer, action)

    def crash(self, pursuer: int) -> None:
        """Take a pursuer down: until `recover` its action is 0 and it captures no evader."""
        self.state.broken[pursuer] = True
        if self.state.profile[pursuer]:
            self._trace.append(BrokeDown(self._env.now, pursuer))
            self._change_action(pursuer, 0)
        self._forecast.update()

    def recover(self, pursuer: int) -> None:
        """Bring a pursuer up again; it is inactive until its action is set."""
        self.state.broken[pursuer] = False
        self._forecast.update()

    def sample(self) -> None:
        """Record all positions, if `record.trajectory` is not 0, and all estimates, if `record.estimates`."""
        if self._sample_period:
            self._trace.append(Sampled(self._env.now, *self._places()))
            for estimated in self._estimate_source.estimates() if self._estimate_source is not None else ():
                self._trace.append(estimated)

    def _change_action(self, pursuer: int, action: int) -> None:
        """Change the action of one pursuer from this instant on."""
        state = self.state
        actions = state.actions.copy()
        actions[pursuer] = action
        state.acting_since[pursuer] = self._env.now
        self._set_actions(actions)
        now = self._env.now
        if now < state.step_end:  # within a step; at its end all players get new velocities
            self._steering.redirect(pursuer, now, state.step_end)
            self._plan_turn()
            self._forecast.update()

    def _set_actions(self, actions: Actions) -> None:
        """Set the actions of all pursuers; their velocities stay the same."""
        self.state.set_actions(actions)
        self._steering.set_actions(actions)

    def _move(self, _: simpy.Event) -> None:
        """Set new velocities for a motion step and schedule the next step; do nothing at the horizon."""
        now, state = self._env.now, self.state
        if now == state.horizon:
            return
        state.step_end = self._step_end(now)
        handover = self.eavesdropper is not None and self.eavesdropper.hands_over(now)
        self._steering.step(now, state.step_end, handover=handover)
        self._plan_turn()
        self._forecast.update()
        if self._sensor is not None:
            self._sensor.look(now)
        self._at(state.step_end, Phase.MOTION, self._move)

    def _plan_turn(self) -> None:
        """Schedule the next turn of a pursuer at a corner of a wall, in place of the turn scheduled before."""
        self._next_turn = None
        if self._steering.turns:
            self._next_turn = Instant(self._env, min(self._steering.turns.values()), Phase.MOTION)
            self._next_turn.callbacks.append(self._turn)

    def _turn(self, event: simpy.Event) -> None:
        """Redirect the pursuers that are at a corner of a wall, unless another turn has replaced this one."""
        if event is not self._next_turn:
            return
        now, turns = self._env.now, self._steering.turns
        for pursuer in [pursuer for pursuer, when in turns.items() if when == now]:
            self._steering.redirect(pursuer, now, self.state.step_end)
        self._plan_turn()
        self._forecast.update()

    def _step_end(self, now: int) -> int:
        """Return the end, ns, of the motion step that begins now.

        It is the next multiple of the motion step or, if earlier, the horizon or the next recorded waypoint.
        """
        waypoints = filter(None, [record.next_waypoint(now) for record in self._recorded_motions])
        return min((now // self._step_length + 1) * self._step_length, self.state.horizon, *waypoints)

    def _capture(self, body: EvaderBody, capturer: int) -> None:
        """Capture an evader; end the run if enough evaders are captured (`capture.captures_to_end`)."""
        self._trace.append(Captured(self._env.now, body.number, capturer))
        self.state.capture(body)
        self._steering.set_actions(self.state.actions)
        self._forecast.update()
        if self.state.evader_count - len(self.state.at_large) >= self._captures_to_end:
            self._end.finish("captured", capturer)

    def _samples(self, period: int) -> Generator[simpy.Event, None, None]:
        """Record positions at every multiple of a period (ns)."""
        for when in count(0, period):
            yield Instant(self._env, when, Phase.SAMPLE)
            self.sample()

    def _at(self, when: int, priority: int, act: Callable[[simpy.Event], None]) -> None:
        Instant(self._env, when, priority).callbacks.append(act)

    def _places(self) -> tuple[tuple[TracePoint, ...], tuple[TracePoint, ...]]:
        """Return the positions of the evaders and of the pursuers as (x, y), m."""
        positions = self.state.players.positions()
        places = tuple(zip(positions.real.tolist(), positions.imag.tolist(), strict=True))
        return places[self.state.size :], places[: self.state.size]


def possible_action(view: View, pursuer: int, action: int) -> int:
    """Return the action of a pursuer that is to take `action`: 0 if it is down, or may not chase this evader.

    Raises:
        ValueError: if there is no such action.
    """
    state = view.state
    number = action if type(action) is int or type(action) is bool else as_python(action)
    if type(number) not in {int, bool, float} or number not in range(state.evader_count + 1):
        raise ValueError(f"an action should be 0 or an evader, 1 .. {state.evader_count}, got {value_text(action)}")
    action = int(number)
    return action if action and not state.broken[pursuer] and view.may_chase(pursuer, action) else 0


def make_steering(scenario: Scenario, state: WorldState, sensor: Sensor | None = None) -> Steering:
    """Return the steering of the players of a scenario; see `Steering`."""
    carries_evaders = scenario.environment.on == "all"
    carried = [pursuer not in state.relays for pursuer in range(state.size)]
    carried += [carries_evaders and evader.record is None for evader in scenario.evaders]
    evader_first = scenario.motion.order == "evader_first"
    return Steering(state, scenario.team.guidance, sensor, np.array(carried), evader_first=evader_first)


def initial_state(env: Clock, scenario: Scenario, seed: int) -> WorldState:
    """Create the state of the world at the start of a run.

    A pursuer may be assigned an evader here that it may not chase; `World` makes such a pursuer inactive.
    """
    team, radius, space = scenario.team, scenario.capture.radius, scenario.space
    players = _kinematics(env, scenario, seed)
    speeds = np.array(team.all_speeds())
    speeds.setflags(write=False)  # protocols get this array as a part of their estimates
    bodies = [
        EvaderBody(
            number,
            evader.speed,
            evader.controller(stream(seed, "evader strategy", number - 1), speeds, radius, space),
            EvaderTrack(
                team.guidance,
                scenario.pursuer_dynamics,
                scenario.players_environment,
                radius,
                remembers=_needs_whole_paths(scenario),
                space=space,
            ),
            players=players,
            speeds=speeds,
            radius=radius,
            top_speed=team.top_speed + scenario.players_environment.relative_speed,
            dynamics=scenario.pursuer_dynamics,
            environment=scenario.players_environment,
            space=space,
            is_recorded=evader.record is not None,
            relays=team.relays,
        )
        for number, evader in enumerate(scenario.evaders, start=1)
    ]
    actions: Actions = team.start_profile(seed).astype(np.int64)
    if len(bodies) > 1:
        actions = actions * stream(seed, "start targets").integers(1, len(bodies) + 1, size=team.count)
    horizon = nanoseconds(scenario.horizon)
    return WorldState(
        env,
        players,
        bodies,
        speeds,
        scenario.pursuer_dynamics,
        scenario.players_environment,
        space,
        actions,
        radius=radius,
        horizon=horizon,
        static=scenario.motion.static,
        relays=team.relays,
    )


def _kinematics(env: Clock, scenario: Scenario, seed: int) -> Kinematics:
    """Create the kinematics of all players, at their initial positions."""
    team, evaders = scenario.team, scenario.evaders
    space = scenario.space
    starts = [evader.start(seed, index, space) for index, evader in enumerate(evaders)]
    places, static = complex_points(np.vstack([team.start(seed, space), *starts])), scenario.motion.static
    if static or not (team.has_inertia or any(evader.has_inertia for evader in evaders)):
        return Kinematics(env, places, static=static)
    dynamics = [Simple() if pursuer in team.relays else team.dynamics for pursuer in range(team.count)]
    headings = [*team.headings(seed), *(evader.heading(seed, index) for index, evader in enumerate(evaders))]
    return InertialKinematics(env, places, [*dynamics, *(evader.dynamics for evader in evaders)], np.array(headings))


def _needs_whole_paths(scenario: Scenario) -> bool:
    """Return whether dead reckoning needs the whole paths of the evaders."""
    located = scenario.announce.is_located or scenario.protocol_traits.reckons
    return located and scenario.announce.reckoning == "exact"

"""Steering: the velocities of all players, set at each motion step and when an action changes within a step.

Kept equal to a team led at once by
`tests/pursuit/test_kinematics.py::test_pursuers_led_one_by_one_run_as_a_team_led_at_once`.
"""

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Points
from desim.kernel.core.units import seconds
from desim.pursuit.evaders.evader import MAX_SCALAR_SIZE, EvaderBody
from desim.pursuit.motion.dynamics import steered_with
from desim.pursuit.motion.guidance import Guidance, guided_velocities, guided_velocity
from desim.pursuit.sensing.noisy_sensing import Sensor
from desim.pursuit.sensing.world_state import Actions, WorldState


class Steering:
    """Sets the velocities of all players.

    A guidance law gives those of pursuers, a strategy those of each evader, and recorded paths those of relays. A relay
    is a pursuer that never chases.

    Args:
        state: the true state of the world.
        law: the guidance law.
        sensor: the sensors of the team; None if sensing is unlimited.
        carried: (N + M,) whether the flow carries each player: the pursuers, then the evaders.
        evader_first: whether pursuers aim at the evader's position at the end of the motion step; if not, at its
            position at the start.

    Attributes:
        turns: by pursuer, the time (ns) within this motion step at which it reaches a corner of a wall and is to be
            redirected.
    """

    def __init__(
        self,
        state: WorldState,
        law: Guidance,
        sensor: Sensor | None,
        carried: NDArray[np.bool_],
        *,
        evader_first: bool,
    ):
        self._players, self._targets, self._law = state.players, state.bodies, law
        self._speeds, self._speed_of = state.speeds, state.speeds.tolist()
        self._evader_first, self._sensor, self._relays = evader_first, sensor, state.relays
        self._dynamics, self._radius, self._has_inertia = state.dynamics, state.radius, not state.dynamics.is_simple
        self._environment, self._carried, self._has_flow = state.environment, carried, not state.environment.is_still
        self._walled = state.space.walled
        self._is_plain = not (self._has_inertia or self._has_flow or self._walled is not None)
        self.turns: dict[int, int] = {}
        self._step_start: int | None = None
        """The start of the present motion step, ns; None before the first."""
        self._no_velocities: Points = np.zeros(state.size + state.evader_count, dtype=complex)

    def set_actions(self, actions: Actions) -> None:
        """Set the actions of all pursuers from now on."""
        self._actions, self._commanded_speeds = actions, self._speeds * (actions > 0)
        chasing = actions.nonzero()[0]
        # (pursuer, evader); None if many chase, because arrays are faster then.
        self._chases: list[tuple[int, EvaderBody]] | None = None
        if len(chasing) <= MAX_SCALAR_SIZE or not self._is_plain:
            self._chases = [(pursuer, self._targets[actions.item(pursuer) - 1]) for pursuer in chasing.tolist()]

    def step(self, now: int, until: int, *, handover: bool) -> None:
        """Set the velocity of each player for a motion step.

        Args:
            now: start of the step, ns.
            until: end of the step, ns.
            handover: whether an announcement of a change of action is in flight.
        """
        duration, players, law = seconds(until - now), self._players, self._law
        velocities, self._step_start = self._no_velocities.copy(), now
        self.turns.clear()
        for target in self._targets:
            state = target.state(now)
            evader_velocity, place = target.choose_velocity(state, handover=handover), state.evader
            if self._walled is not None:
                evader_velocity = target.slid(evader_velocity, duration)
            drift = self._drift(target.player, evader_velocity, now, until)
            if self._evader_first:
                aim, observed_velocity = players.advance(target.player, evader_velocity, duration, drift)
            else:  # simultaneous: pursuers do not know the new velocity of the evader
                aim, observed_velocity = place + drift * duration, players.course(target.player).velocity + drift
            target.path.see(now, place, aim, observed_velocity, until)
            velocities[target.player] = evader_velocity
        if self._chases is None:
            velocities[: len(self._actions)] = self._all_velocities()
        else:
            position_of, speed_of = players.positions().item, self._speed_of
            for pursuer, target in self._chases:
                position, (_, place, aim, evader_velocity, _) = position_of(pursuer), target.path.last
                if self._walled is not None:
                    velocities[pursuer] = self._course(pursuer, aim, now, until)
                elif self._is_plain:  # the same result as below, faster
                    velocities[pursuer] = guided_velocity(
                        law, place - position, aim - position, evader_velocity, speed_of[pursuer]
                    )
                else:
                    geometry = place - position, aim - position, evader_velocity, speed_of[pursuer]
                    velocities[pursuer] = self._command(pursuer, *geometry, now, until)
        for pursuer in self._sensor.blind(self._actions) if self._sensor is not None else ():
            velocities[pursuer] = self._blind_velocity(pursuer, now, until)
        for relay, motion in self._relays.items():
            velocities[relay] = motion.velocity(now, players.position(relay))
        drifts = None
        if self._has_flow:
            drifts = self._environment.drifts(players.positions(), velocities, now, duration) * self._carried
        players.command(velocities, drifts)

    def redirect(self, pursuer: int, now: int, until: int) -> None:
        """Set the velocity of a pursuer whose action changes within a step.

        Args:
            pursuer: its id.
            now: the present, ns.
            until: end of the step, ns.
        """
        velocities, evader = self._players.commands.copy(), self._actions.item(pursuer)
        self.turns.pop(pursuer, None)
        if not evader:
            velocities[pursuer] = 0j
        elif self._sensor is not None and not self._sensor.views[pursuer].sees(evader):
            velocities[pursuer] = self._blind_velocity(pursuer, now, until)
        else:
            segment = self._targets[evader - 1].path.last
            velocities[pursuer] = self._towards(pursuer, segment.at(now), segment.aim, segment.velocity, now, until)
        drifts = self._players.drifts
        if drifts is not None:
            drifts = drifts.copy()
            drifts[pursuer] = self._drift(pursuer, velocities.item(pursuer), now, until)
        self._players.command(velocities, drifts)

    def chasing_velocity(self, pursuer: int, evader: int, now: int, until: int) -> complex:
        """Return the velocity relative to the flow, m/s, with which a pursuer chases an evader from where both are now.

        It aims at the present place of the evader, whatever `evader_first` is.

        Args:
            pursuer: its id.
            evader: the number of the evader.
            now: the present, ns.
            until: the time up to which it keeps the velocity, ns.
        """
        target = self._targets[evader - 1]
        place, velocity = target.position, self._players.velocity(target.player)
        if self._walled is not None:  # a robot may keep the velocity until then, and is to stop before a wall
            here, speed = self._players.position(pursuer), self._speed_of[pursuer]
            return self._walled.course(here, place, speed, now, until, stops=False, turns=False)[0]
        aim = place + self._drift(target.player, velocity, now, until) * seconds(until - now)
        return self._towards(pursuer, place, aim, velocity, now, until)

    def _towards(
        self, pursuer: int, place: complex, aim: complex, evader_velocity: complex, now: int, until: int
    ) -> complex:
        """Return the velocity relative to the flow, m/s, with which a pursuer chases an evader at a place (m)."""
        if self._walled is not None:
            return self._course(pursuer, aim, now, until)
        position = self._players.position(pursuer)
        geometry = place - position, aim - position, evader_velocity, self._speed_of[pursuer]
        return self._command(pursuer, *geometry, now, until)

    def _course(self, pursuer: int, aim: complex, now: int, until: int, *, stops: bool = False) -> complex:
        """Return the velocity, m/s, with which a pursuer follows the shortest path to where it aims (m)."""
        assert self._walled is not None
        here, speed = self._players.position(pursuer), self._speed_of[pursuer]
        velocity, turn = self._walled.course(here, aim, speed, now, until, stops=stops)
        if turn < until:
            self.turns[pursuer] = turn
        return velocity

    def _command(
        self,
        pursuer: int,
        gap: complex,
        aim: complex,
        evader_velocity: complex,
        speed: float,
        now: int,
        until: int,
    ) -> complex:
        """Return the velocity relative to the flow, m/s, that a pursuer commands.

        Args:
            pursuer: its id.
            gap: the vector from the pursuer to its evader, m.
            aim: the vector from the pursuer to the point at which it aims, m.
            evader_velocity: velocity of the evader, m/s.
            speed: its speed, m/s.
            now: the present, ns.
            until: the time up to which it keeps the command, ns.
        """
        drift = self._drift(pursuer, 0j, now, until)
        aim = aim - drift * seconds(until - now)
        command = guided_velocity(self._law, gap, aim, evader_velocity - drift, speed)
        if not self._has_inertia:
            return command
        return steered_with(self._dynamics, command, self._players.course(pursuer), aim, self._radius)

    def _drift(self, player: int, command: complex, now: int, until: int) -> complex:
        """Return the mean velocity of the flow, m/s, along the path of a player between two times, ns."""
        if not (self._has_flow and self._carried[player]):
            return 0j
        step_start = now if self._step_start is None else self._step_start
        return self._environment.drift_within(self._players.position(player), command, step_start, now, until)

    def _all_velocities(self) -> Points:
        """Return the (N,) velocities, m/s, of the pursuers at the start of a step, as if they sensed all evaders."""
        actions, segments = self._actions, [target.path.last for target in self._targets]
        pursuers, speeds = self._players.positions()[: len(actions)], self._commanded_speeds
        if len(segments) == 1:
            _, place, aim, evader_velocity, _ = segments[0]
            return guided_velocities(self._law, place - pursuers, aim - pursuers, evader_velocity, speeds)
        chased = np.maximum(actions, 1) - 1  # any index serves for an inactive pursuer, whose commanded speed is 0
        places, aims, evader_velocities = (np.array([segment[k] for segment in segments])[chased] for k in (1, 2, 3))
        return guided_velocities(self._law, places - pursuers, aims - pursuers, evader_velocities, speeds)

    def _blind_velocity(self, pursuer: int, now: int, until: int) -> complex:
        """Return the velocity, m/s, of a pursuer whose evader is out of sensing range; 0 without an estimate.

        The speed is limited so that up to a time `until` (ns) the pursuer does not overshoot the estimated position of
        the evader.
        """
        assert self._sensor is not None
        estimate = self._sensor.views[pursuer].estimate(self._actions.item(pursuer))
        if estimate is None:
            return 0j
        duration = seconds(until - now)
        if self._walled is not None:
            ahead = estimate.velocity * duration if self._evader_first else 0j
            return self._course(pursuer, self._walled.free_place(estimate.position + ahead), now, until, stops=True)
        gap = estimate.position - self._players.position(pursuer)
        aim = gap + (estimate.velocity * duration if self._evader_first else 0j)
        speed = min(self._speed_of[pursuer], abs(aim - self._drift(pursuer, 0j, now, until) * duration) / duration)
        return self._command(pursuer, gap, aim, estimate.velocity, speed, now, until)

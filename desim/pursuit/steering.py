"""Steering: which velocity everybody takes, at each motion step and when an order comes inside one."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from desim.kernel.clock import seconds
from desim.pursuit.evader import SINGLY, EvaderBody
from desim.pursuit.guidance import Guidance, guided_velocities, guided_velocity
from desim.pursuit.kinematics import Kinematics
from desim.pursuit.state import Floats, Points

if TYPE_CHECKING:
    from desim.pursuit.sensing import TeamSensor

Actions = NDArray[np.int64]
"""(N,) which evader each pursuer chases, 1 .. M, or 0."""


class Steering:
    """Leads the pursuers by a law of guidance, and lets the evaders flee.

    Args:
        players: whom it leads: the N pursuers, then the evaders.
        targets: the evaders.
        law: of guidance.
        speeds: (N,) of the pursuers, m/s.
        evader_first: whether pursuers head for where the evader will be at the end of the step, or for where it was.

    Attributes:
        watch: what pursuers see, if they do not see everything.
    """

    def __init__(
        self, players: Kinematics, targets: Sequence[EvaderBody], law: Guidance, speeds: Floats, *, evader_first: bool
    ):
        self._players, self._targets, self._law = players, targets, law
        self._speeds, self._speed = speeds, speeds.tolist()
        self._evader_first = evader_first
        self._stillness: Points = np.zeros(len(speeds) + len(targets), dtype=complex)
        self.watch: TeamSensor | None = None

    def set_actions(self, actions: Actions) -> None:
        """Take note of what everybody does from now on."""
        self._actions, self._paces = actions, self._speeds * (actions > 0)
        moving = actions.nonzero()[0]
        self._chases: list[tuple[int, EvaderBody]] | None = None  # who chases whom, if they are few
        if len(moving) <= SINGLY:
            self._chases = [(pursuer, self._targets[actions.item(pursuer) - 1]) for pursuer in moving.tolist()]

    def step(self, now: int, until: int, *, handover: bool) -> None:
        """Give everyone the velocity that it keeps for a motion step.

        Args:
            now: when the step begins, ns.
            until: when it ends, ns.
            handover: whether word of a change of action is in flight.
        """
        duration, players, law = seconds(until - now), self._players, self._law
        velocities = self._stillness.copy()
        for target in self._targets:
            state = target.state(now)
            flight, place = target.flight(state, handover=handover), state.evader
            if self._evader_first:
                target.path.see(now, place, place + flight * duration, flight)
            else:
                target.path.see(now, place, place, players.velocities.item(target.player))
            velocities[target.player] = flight
        if self._chases is None:
            velocities[: len(self._actions)] = self._all_velocities()
        else:
            where, speed = players.places().item, self._speed
            for pursuer, target in self._chases:
                here, (_, place, aim, flight) = where(pursuer), target.path.last
                velocities[pursuer] = guided_velocity(law, place - here, aim - here, flight, speed[pursuer])
        for pursuer in self.watch.blind(self._actions) if self.watch is not None else ():
            velocities[pursuer] = self._blind_velocity(pursuer, duration)
        players.go(velocities)

    def turn(self, pursuer: int, now: int, until: int) -> None:
        """Give one pursuer another velocity inside a step, for it does something else from now on.

        Args:
            pursuer: who.
            now: ns.
            until: when the step ends, ns.
        """
        velocities, evader = self._players.velocities.copy(), self._actions.item(pursuer)
        if not evader:
            velocities[pursuer] = 0j
        elif self.watch is not None and not self.watch.sights[pursuer].sees(evader):
            velocities[pursuer] = self._blind_velocity(pursuer, seconds(until - now))
        else:
            here, leg = self._players.place(pursuer), self._targets[evader - 1].path.last
            gap, speed = leg.at(now) - here, self._speed[pursuer]
            velocities[pursuer] = guided_velocity(self._law, gap, leg.aim - here, leg.flight, speed)
        self._players.go(velocities)

    def _all_velocities(self) -> Points:
        """Return the (N,) velocities of the pursuers at the beginning of a step, each chasing what it sees, m/s."""
        actions, legs = self._actions, [target.path.last for target in self._targets]
        pursuers, paces = self._players.places()[: len(actions)], self._paces
        if len(legs) == 1:
            _, place, aim, flight = legs[0]
            return guided_velocities(self._law, place - pursuers, aim - pursuers, flight, paces)
        chased = np.maximum(actions, 1) - 1
        places, aims, flights = (np.array([leg[k] for leg in legs])[chased] for k in (1, 2, 3))
        return guided_velocities(self._law, places - pursuers, aims - pursuers, flights, paces)

    def _blind_velocity(self, pursuer: int, duration: float) -> complex:
        """Return the velocity of a pursuer that chases an evader which it does not see, m/s.

        It does not go beyond where the evader is believed to be at the end of the step, in so many s.
        """
        assert self.watch is not None
        estimate = self.watch.sights[pursuer].estimate(self._actions.item(pursuer))
        if estimate is None:
            return 0j
        gap = estimate.place - self._players.place(pursuer)
        aim = gap + (estimate.velocity * duration if self._evader_first else 0j)
        return guided_velocity(self._law, gap, aim, estimate.velocity, min(self._speed[pursuer], abs(aim) / duration))

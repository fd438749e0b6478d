"""The true state of a pursuit: positions and velocities of all players, and the actions of the pursuers.

The views of the pursuers (`desim.pursuit.sensing.views`) read the state; the world (`desim.simulation.world`) changes
it.
"""

from collections.abc import Mapping, Sequence
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Bools, Floats, Points
from desim.config.python_numbers import whole
from desim.kernel.core.clock import Clock
from desim.kernel.core.units import SECOND
from desim.pursuit.evaders.evader import EvaderBody
from desim.pursuit.evaders.recorded import RecordedMotion
from desim.pursuit.motion.dead_reckoning import MotionState
from desim.pursuit.motion.dynamics import Dynamics
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.kinematics import Kinematics
from desim.pursuit.paths.space import Plane

Actions = NDArray[np.int64]
"""(N,) the evader that each pursuer chases, 1 .. M, or 0."""


class WorldState:
    """The true state of all players now.

    Args:
        env: the clock of the simulation.
        players: kinematics of the N pursuers, then the M evaders.
        bodies: the evaders, in order.
        speeds: (N,) speeds of the pursuers while they chase, m/s.
        dynamics: the dynamics of the pursuers.
        environment: the medium.
        space: the space in which the players move.
        actions: initial actions.
        radius: capture radius, m.
        horizon: latest end of the run, ns.
        static: whether all players stand still for the whole run.
        relays: the motion of each pursuer that never chases and moves along a record.

    Attributes:
        size: number of pursuers, N.
        evader_count: number of evaders at the start, M.
        top_speed: upper bound of the speed of a chasing pursuer, relative to the medium in which the evaders move, m/s.
        at_large: numbers of the evaders that have not been captured, ascending.
        actions: see `Actions`; replaced by `set_actions`, never changed in place.
        profile: `actions` as a list.
        broken: (N,) mask of the pursuers that are down.
        acting_since: by pursuer, the time, ns, at which its present action began.
        step_end: end of the present motion step, ns.
    """

    now: int = property(attrgetter("_env.now"), doc="The present, ns.")  # type: ignore[assignment]  # as in `Clock`

    def __init__(
        self,
        env: Clock,
        players: Kinematics,
        bodies: Sequence[EvaderBody],
        speeds: Floats,
        dynamics: Dynamics,
        environment: Environment,
        space: Plane,
        actions: Actions,
        *,
        radius: float,
        horizon: int,
        static: bool,
        relays: Mapping[int, RecordedMotion],
    ):
        self._env = env
        self.players, self.bodies, self.speeds, self.dynamics = players, bodies, speeds, dynamics
        self.environment, self.space = environment, space
        self._visible_now: dict[int, Bools] = {}
        """By evader, what `_visible` has returned at `_visible_at`, ns."""
        self._visible_at = -1
        self.radius, self.horizon, self.static, self.relays = radius, horizon, static, relays
        self.size, self.evader_count = len(speeds), len(bodies)
        self.top_speed = float(speeds.max(initial=0.0)) + environment.relative_speed
        self.at_large: Sequence[int] = range(1, len(bodies) + 1)
        self.broken: NDArray[np.bool_] = np.zeros(self.size, dtype=bool)
        self.acting_since, self.step_end = [0] * self.size, 0
        self.set_actions(actions)

    def body(self, evader: int) -> EvaderBody:
        """Return an evader, 1 .. M.

        Raises:
            ValueError: if there is no such evader.
        """
        if type(evader) is not int:  # with one evader, an action may be a truth value
            evader = whole(int(evader) if isinstance(evader, bool) else evader, "an evader")
        if not 1 <= evader <= self.evader_count:
            raise ValueError(f"there is no evader {evader}: they are 1 .. {self.evader_count}")
        return self.bodies[evader - 1]

    def position(self, pursuer: int) -> complex:
        """Return the position of a pursuer, m."""
        return self.players.position(pursuer)

    def motion(self, pursuer: int) -> MotionState:
        """Return the position and the course of a pursuer."""
        return MotionState(self.players.position(pursuer), self.players.course(pursuer))

    def positions(self) -> Points:
        """Return the (N,) positions of the pursuers, m."""
        return self.players.positions()[: self.size]

    def speed(self, pursuer: int) -> float:
        """Return the speed of a pursuer while it chases, m/s."""
        return self.speeds.item(pursuer)

    def velocity(self, evader: int) -> complex:
        """Return the velocity of an evader, m/s."""
        return self.players.velocity(self.body(evader).player)

    def in_sight(self, evader: int, radius: float) -> Bools:
        """Return which pursuers see an evader now, (N,): it is within a radius, m, and no wall is between them."""
        near: Bools = self.body(evader).state(self.now).distances <= radius
        if self.space.blocks_sight:
            near &= self._visible(evader)
        return near

    def sees(self, pursuer: int, evader: int, radius: float) -> bool:
        """Return whether one pursuer sees an evader now, in a tenth of the time of `in_sight`.

        Kept equal to the sight of all by
        `tests/pursuit/test_sensing.py::test_the_sight_of_one_is_that_of_all`.
        """
        (distance,) = self.players.distances(self.body(evader).player, [pursuer])
        if distance > radius:
            return False
        return not self.space.blocks_sight or bool(self._visible(evader)[pursuer])

    def _visible(self, evader: int) -> Bools:
        """Return the (N,) mask of the pursuers that no wall hides from an evader now."""
        if self._visible_at != self.now:
            self._visible_now, self._visible_at = {}, self.now
        visible = self._visible_now.get(evader)
        if visible is None:
            visible = self._visible_now[evader] = self.space.visible(self.positions(), self.body(evader).position)
        return visible

    def time_left(self, now: int) -> float:
        """Return the time r, s, from an instant (ns) to the horizon; in a static game, always the whole horizon."""
        return (self.horizon if self.static else self.horizon - now) / SECOND

    def set_actions(self, actions: Actions) -> None:
        """Set the actions of all pursuers from now on."""
        self.actions = actions
        self.profile: list[int] = actions.tolist()
        for body in self.bodies:
            body.set_chasers(np.equal(actions, body.number))

    def capture(self, body: EvaderBody) -> None:
        """Mark an evader as captured: it stands still, and its chasers stop and become inactive."""
        body.captured = self.now
        self.at_large = tuple(evader for evader in self.at_large if evader != body.number)
        chasing = self.actions == body.number
        for pursuer in chasing.nonzero()[0].tolist():
            self.acting_since[pursuer] = self.now
        commands = self.players.commands.copy()
        commands[body.player] = 0.0
        commands[: self.size][chasing] = 0.0
        self.set_actions(np.where(chasing, 0, self.actions))
        self.players.command(commands, self.players.drifts)

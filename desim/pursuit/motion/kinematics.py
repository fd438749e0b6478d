"""Kinematics: the positions of all players (pursuers and evaders), on paths of pieces with common breakpoints.

A piece is the motion of a player between two breakpoints. Its position is given in closed form, for simple motion as
origin + velocity * (t - since), without numerical integration. The position of one player is computed without the
positions of the others. `desim.pursuit.motion.inertia` has players with inertia, whose pieces are curved.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Integers, Points
from desim.config.model import MAX_COORDINATE
from desim.kernel.core.clock import Clock
from desim.kernel.core.units import SECOND
from desim.pursuit.core.geometry import first_contact
from desim.pursuit.core.state import lengths
from desim.pursuit.motion.dynamics import Course, Courses

CaptureTest = Literal["segment", "sample"]
"""When a capture is detected; see `desim.scenario.scenario.Capture`."""


class Kinematics:
    """The positions and velocities of K players with simple motion, which take commanded velocities at once.

    Kept equal to motion with inertia of players that are all simple by
    `tests/pursuit/test_inertia.py::test_players_that_are_all_simple_move_as_without_inertia`.

    Args:
        env: the clock of the simulation.
        start: (K,) initial positions, m.
        static: whether all players stand still for the whole run.

    Attributes:
        commands: (K,) commanded velocities, m/s, relative to the flow; replaced by `command`, never changed in place.
        drifts: (K,) velocities of the flow at the players, m/s; None without a flow.
    """

    def __init__(self, env: Clock, start: Points, *, static: bool = False):
        self._env, self._static = env, static
        self.commands: Points = np.zeros_like(start)
        self.drifts: Points | None = None
        self._velocities = self.commands  # over ground
        self._origins, self._since = start, env.now
        self._positions, self._cached_at = start, env.now
        self._before_change: list[Callable[[], object]] = []
        start.setflags(write=False)

    @property
    def now(self) -> int:
        """The present, ns."""
        return self._env.now

    def positions(self) -> Points:
        """Return the (K,) positions now, m; read-only."""
        now = self._env.now
        if self._cached_at != now and not self._static:
            self._positions = self._origins + self._velocities * ((now - self._since) / SECOND)
            self._positions.setflags(write=False)
            self._cached_at = now
        return self._positions

    def position(self, player: int) -> complex:
        """Return the position of one player now, m."""
        now = self._env.now
        if self._cached_at == now or self._static:
            return self._positions.item(player)
        return self._origins.item(player) + self._velocities.item(player) * ((now - self._since) / SECOND)

    def distances(self, player: int, others: Iterable[int]) -> list[float]:
        """Return the present distances of other players from one player, m."""
        now, start, velocity = self._env.now, self._origins.item, self._velocities.item
        if self._cached_at == now or self._static:
            position = self._positions.item
            origin = position(player)
            return [abs(origin - position(other)) for other in others]
        elapsed = (now - self._since) / SECOND  # calls of `position` instead make runs with radio some 3 % slower
        origin = start(player) + velocity(player) * elapsed
        return [abs(origin - (start(other) + velocity(other) * elapsed)) for other in others]

    def positions_of(self, players: Sequence[int] | NDArray[np.intp]) -> Points:
        """Return the (k,) positions of some players now, m."""
        if self._cached_at == self._env.now or self._static:
            return self._positions[players]
        return self._origins[players] + self._velocities[players] * ((self._env.now - self._since) / SECOND)

    def positions_at(self, players: NDArray[np.intp], times: int | Integers) -> Points:
        """Return the (k,) positions of some players, m, at times (ns) of the present piece: one for all, or (k,)."""
        if self._static:
            return self._positions[players]
        return self._origins[players] + self._velocities[players] * ((times - self._since) / SECOND)

    def before_change(self, act: Callable[[], object]) -> None:
        """Register a function to call before a new piece begins."""
        self._before_change.append(act)

    def velocity(self, player: int) -> complex:
        """Return the velocity of one player over ground now, m/s."""
        return self._velocities.item(player)

    def course(self, player: int) -> Course:
        """Return the course of one player now, relative to the flow."""
        command = self.commands.item(player)
        return Course(command, command / abs(command) if command else 1.0 + 0j)

    def courses(self, players: Iterable[int]) -> Courses:
        """Return the courses of some players now, relative to the flow."""
        velocities, headings = zip(*map(self.course, players), strict=True)
        return Courses(np.array(velocities), np.array(headings))

    def advance(self, player: int, command: complex, duration: float, drift: complex = 0j) -> tuple[complex, complex]:
        """Return where a velocity (m/s) that is commanded now would take a player.

        Args:
            player: the player.
            command: the velocity relative to the flow, m/s.
            duration: the time for which it is commanded, s.
            drift: the velocity of the flow at the player, m/s.

        Returns:
            (the position after this time, m; the mean velocity over ground, m/s).
        """
        velocity = command + drift if drift else command
        return self.position(player) + velocity * duration, velocity

    def contact(
        self, target: int, offsets: Points, broken: NDArray[np.bool_], radius: float, duration: float, test: CaptureTest
    ) -> tuple[float, int] | None:
        """Return the first contact of one of the first N players with a target in the present pieces, or None.

        Args:
            target: the other player.
            offsets: (N,) present vectors from each of the first N players to the target, m.
            broken: (N,) mask of players that make no contact.
            radius: distance of a contact, m.
            duration: length of the interval from now on, s.
            test: whether a contact may be at any instant (segment), or only at the end of the interval (sample).

        Returns:
            (time from now to the contact, s; index of the player).
        """
        approach = self._velocities[target] - self._velocities[: len(offsets)]
        # Players that make no contact are put too far away for one.
        offsets = np.where(broken, MAX_COORDINATE, offsets) if broken.any() else offsets
        if test == "segment":
            return first_contact(offsets, approach, radius, duration)
        distances = lengths(offsets + approach * duration)
        nearest = int(distances.argmin())
        return (duration, nearest) if distances[nearest] <= radius else None

    def observe(self, since: int, places: Points, courses: Courses, commands: Points, drifts: Points | None) -> None:
        """Replace all motions by an observation of the same players in another process, made a moment ago.

        Args:
            since: the time of the observation, ns.
            places: (K,) the observed positions, m.
            courses: (K,) the observed courses; only players with inertia need them.
            commands: (K,) commanded velocities relative to the flow, m/s.
            drifts: (K,) velocities of the flow at the players, m/s; None: there is no flow.
        """
        for act in self._before_change:
            act()
        places.setflags(write=False)
        self._origins, self._since, self._cached_at = places, since, -1
        self._positions = places  # a static world computes no others
        self.commands, self.drifts = commands, drifts
        self._velocities = commands if drifts is None else commands + drifts

    def command(self, velocities: Points, drifts: Points | None = None) -> None:
        """Begin a new piece of each path, at the present position and instant.

        Args:
            velocities: (K,) commanded velocities relative to the flow, m/s.
            drifts: (K,) velocities of the flow at the players, m/s; None: there is no flow.
        """
        for act in self._before_change:
            act()
        self._origins, self._since = self.positions(), self._env.now
        self.commands, self.drifts = velocities, drifts
        self._velocities = velocities if drifts is None else velocities + drifts

"""Kinematics of players with inertia, whose paths consist of curves and straight lines."""

from collections.abc import Iterable, Sequence
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from desim.config.arrays import Integers, Points
from desim.config.traits import is_ours
from desim.kernel.core.clock import Clock
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.units import SECOND
from desim.pursuit.motion.dynamics import Course, Courses, Dynamics, Piece, piece_with
from desim.pursuit.motion.kinematics import CaptureTest, Kinematics

MAX_STEPS = 1_000
"""Maximum number of steps towards a contact; a head-on contact takes some 5 steps, a grazing one some 30."""
ROUNDING = 1e-12
"""Gap that counts as a contact, in m and as a share of the distance."""


class InertialKinematics(Kinematics):
    """The positions and velocities of K players, each with its dynamics.

    A player that stands still and is commanded to do so keeps its piece.

    Kept equal to a new piece at each command by
    `tests/pursuit/test_inertia.py::test_players_that_stand_still_keep_their_piece_as_if_it_began_anew`.

    Args:
        env: the clock of the simulation.
        start: (K,) initial positions, m.
        dynamics: (K,) the dynamics of each player.
        headings: (K,) initial headings, of length 1.
    """

    def __init__(self, env: Clock, start: Points, dynamics: Sequence[Dynamics], headings: Points):
        super().__init__(env, start)
        self._dynamics, self._stays = dynamics, [is_ours(type(model)) for model in dynamics]
        """`_stays`: by player, whether it surely stays in place if commanded to stand still, unlike a user's model."""
        self._pieces = [
            Piece(place, Course(0j, heading)) for place, heading in zip(start.tolist(), headings.tolist(), strict=True)
        ]

    def positions(self) -> Points:
        """Return the (K,) positions now, m; read-only."""
        if self._cached_at != self._env.now:
            elapsed = self._elapsed
            self._positions = np.array([piece.at(elapsed) for piece in self._pieces])
            self._positions.setflags(write=False)
            self._cached_at = self._env.now
        return self._positions

    def position(self, player: int) -> complex:
        """Return the position of one player now, m."""
        if self._cached_at == self._env.now:
            return self._positions.item(player)
        return self._pieces[player].at(self._elapsed)

    def distances(self, player: int, others: Iterable[int]) -> list[float]:
        """Return the present distances of other players from one player, m."""
        origin = self.position(player)
        return [abs(origin - self.position(other)) for other in others]

    def positions_of(self, players: Sequence[int] | NDArray[np.intp]) -> Points:
        """Return the (k,) positions of some players now, m."""
        return self.positions()[players]

    def positions_at(self, players: NDArray[np.intp], times: int | Integers) -> Points:
        """Return the (k,) positions of some players, m, at times (ns) of the present piece: one for all, or (k,)."""
        elapsed = np.broadcast_to((np.asarray(times) - self._since) / SECOND, len(players)).tolist()
        return np.array([self._pieces[j].at(t) for j, t in zip(players.tolist(), elapsed, strict=True)], dtype=complex)

    def velocity(self, player: int) -> complex:
        """Return the velocity of one player over ground now, m/s."""
        return self._pieces[player].velocity_at(self._elapsed)

    def course(self, player: int) -> Course:
        """Return the course of one player now, relative to the flow."""
        return self._pieces[player].course_at(self._elapsed)

    def advance(self, player: int, command: complex, duration: float, drift: complex = 0j) -> tuple[complex, complex]:
        """Return where a velocity (m/s) that is commanded now would take a player."""
        piece = self._piece(player, command, drift)
        end = piece.at(duration)
        return end, (end - piece.position) / duration

    def contact(
        self, target: int, offsets: Points, broken: NDArray[np.bool_], radius: float, duration: float, test: CaptureTest
    ) -> tuple[float, int] | None:
        """Return the first contact of one of the first N players with a target in the present pieces, or None."""
        begin, working = self._elapsed, np.flatnonzero(~broken).tolist()
        end, piece = begin + duration, self._pieces[target]
        if test == "sample":
            gaps = [(abs(piece.at(end) - self._pieces[player].at(end)), player) for player in working]
            distance, nearest = min(gaps, default=(inf, 0))
            return (duration, nearest) if distance <= radius else None
        times = [
            (first_contact_of_pieces(piece, self._pieces[player], radius, begin, end), player) for player in working
        ]
        return min(((time, player) for time, player in times if time is not None), default=None)

    def observe(self, since: int, places: Points, courses: Courses, commands: Points, drifts: Points | None) -> None:
        """Replace all motions by an observation of the same players in another process, made a moment ago."""
        super().observe(since, places, courses, commands, drifts)
        flow = [0j] * len(places) if drifts is None else drifts.tolist()
        observed_courses = map(Course, *(part.tolist() for part in courses))
        motions = zip(self._dynamics, places.tolist(), observed_courses, commands.tolist(), flow, strict=True)
        self._pieces = [
            piece_with(dynamics, place, course, command)._replace(drift=drift)
            for dynamics, place, course, command, drift in motions
        ]

    def command(self, velocities: Points, drifts: Points | None = None) -> None:
        """Begin a new piece of each path, at the present position and instant."""
        for act in self._before_change:
            act()
        flow = [0j] * len(self._pieces) if drifts is None else drifts.tolist()
        players = zip(range(len(flow)), self._stays, self._pieces, velocities.tolist(), flow, strict=True)
        self._pieces = [
            piece if stays and not (command or drift or piece.moves) else self._piece(player, command, drift)
            for player, stays, piece, command, drift in players
        ]
        self._since, self.commands, self.drifts = self._env.now, velocities, drifts

    @property
    def _elapsed(self) -> float:
        """The time since the present pieces began, s."""
        return (self._env.now - self._since) / SECOND

    def _piece(self, player: int, command: complex, drift: complex) -> Piece:
        """Return the piece of a player if a velocity (m/s) is commanded now."""
        piece = piece_with(self._dynamics[player], self.position(player), self.course(player), command)
        return piece._replace(drift=drift) if drift else piece


def first_contact_of_pieces(target: Piece, player: Piece, radius: float, begin: float, end: float) -> float | None:
    """Return the time from `begin` to the first contact of two players on their pieces up to `end`, s, or None.

    While the curves of both pieces last, the second derivative of the distance is at least -A, where A is the sum of
    their accelerations. From a gap f and its derivative f', the contact is therefore not before the root of
    f + f' t - A t^2 / 2. Steps from root to root approach the contact from before, quadratically if the gap closes. No
    step leads beyond the end of a curve, where A falls.

    Args:
        target: the piece of one player.
        player: the piece of the other, which began at the same time.
        radius: distance of a contact, m.
        begin: start of the interval, s after the start of the pieces.
        end: end of the interval, s after the start of the pieces.
    """
    t = begin
    for _ in range(MAX_STEPS):
        offset = target.at(t) - player.at(t)
        distance = abs(offset)
        gap = distance - radius
        if gap <= ROUNDING * (1.0 + distance):
            return t - begin
        curves = [piece for piece in (target, player) if t < piece.curved]
        bound = portable_sum(curve.curvature for curve in curves)
        stop = min((curve.curved for curve in curves), default=inf)
        velocity = target.velocity_at(t) - player.velocity_at(t)
        rate = (offset.real * velocity.real + offset.imag * velocity.imag) / distance
        # The root is 2 f / (sqrt(...) - f'), in which nothing cancels while the gap closes (f' < 0).
        closing = sqrt(rate * rate + 2.0 * bound * gap) - rate
        t = min(t + 2.0 * gap / closing, stop) if closing > 0.0 else stop
        if t > end:
            return None
    return t - begin

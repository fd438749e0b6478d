"""Sensing of evaders by pursuers with a limited range, and estimation from past sightings.

Within the sensing radius a pursuer sees the true position of an evader. Beyond it, the pursuer extrapolates the newest
sighting it knows, its own or a reported one (`Sensing.estimate`). It decides by this estimate and chases it. The
limit applies to evaders only: positions of teammates are sensed or announced over any distance, and all pursuers know
which evaders are captured.
"""

from cmath import rect
from collections.abc import Collection, Iterable
from math import inf, pi, sqrt
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from desim.config.model import Flag, Limit, Period, Timeout, Value
from desim.kernel.clock import NodeClock, seconds
from desim.kernel.network import Network
from desim.pursuit.dead_reckoning import nearer
from desim.pursuit.views import GlobalState

if TYPE_CHECKING:
    from desim.pursuit.state import Points

PORT = "sightings"
"""The port of sighting reports."""
NEVER = -1
"""Time of the last sighting of an evader that was never seen, ns."""
NOWHERE = complex(np.nan, np.nan)
"""Position of an evader without any sighting, m."""


class Sensing(Value):
    """The sensing of evaders, and the estimation of the positions of unseen ones."""

    radius: Limit = inf
    """Sensing radius R_s up to which a pursuer sees an evader, m."""
    estimate: Literal["hold", "constant_velocity", "worst_case"] = "constant_velocity"
    """Estimated position of an unseen evader. hold: that of the last sighting; constant_velocity: extrapolated with the
    velocity at the last sighting; worst_case: anywhere within the distance v_e a of the last sighting of age a, so
    that with equal clocks phi is an upper bound: (d + v_e a - eps) / (v_i - v_e)."""
    period: Period = 0.1
    """Time between two reports of a pursuer, s. It repeats its own last sighting, because reports may be lost, until
    the sighting is `track_timeout` old or a newer one is reported to it."""
    relay: Flag = False
    """Whether a pursuer also relays the newest reported sighting, so that it spreads over several hops."""
    track_timeout: Timeout = 5.0
    """Age T_lost of the newest sighting at which the evader is lost, s."""
    on_lost: Literal["stay", "search"] = "search"
    """Action on a lost evader. stay: it may not be chased; search: follow a spiral around its last estimated position,
    with turns 2 R_s apart, rotated for each pursuer. The spiral begins when the evader is lost, wherever the pursuer
    is. A pursuer without any sighting stays."""

    @property
    def limited(self) -> bool:
        """Whether the sensing radius is finite."""
        return self.radius < inf


class Sighting(NamedTuple):
    """A past observation of an evader."""

    evader: int
    """1 .. M"""
    seen: float
    """Time of the sighting by the clock of the observer, s."""
    x: float
    """m"""
    y: float
    """m"""
    velocity_x: float
    """m/s"""
    velocity_y: float
    """m/s"""

    @property
    def position(self) -> complex:
        """Position of the evader at the sighting, m."""
        return complex(self.x, self.y)

    @property
    def velocity(self) -> complex:
        """Velocity of the evader at the sighting, m/s."""
        return complex(self.velocity_x, self.velocity_y)


class EvaderEstimate(NamedTuple):
    """The estimated position of an evader."""

    position: complex
    """m"""
    velocity: complex = 0j
    """m/s"""
    uncertainty: float = 0.0
    """Upper bound of the distance of the evader from `position`, m; 0 if the estimate gives none."""


class TeamSensor:
    """The sensors of the whole team, sampled once every motion step for all pursuers and evaders together.

    Attributes:
        views: (N,) the sensed view of each pursuer.
    """

    def __init__(self, sensing: Sensing, world: GlobalState, network: Network, clocks: Iterable[NodeClock]):
        self.sensing, self._world = sensing, world
        shape = world.evader_count, world.size
        self._seen: NDArray[np.int64] = np.full(shape, NEVER, dtype=np.int64)
        self._positions: Points = np.full(shape, NOWHERE)
        self._velocities: Points = np.zeros(shape, dtype=complex)
        self.views = [SensedView(pursuer, self, world, network, clock) for pursuer, clock in enumerate(clocks)]

    def look(self, now: int) -> None:
        """Record the evaders in the sensing range of each pursuer that is not down, at an instant, ns."""
        able = ~self._world.broken()
        for evader in self._world.evaders():
            seeing = able & (self._world.distances(evader) <= self.sensing.radius)
            row = evader - 1
            self._seen[row, seeing] = now
            self._positions[row, seeing] = self._world.evader(evader)
            self._velocities[row, seeing] = self._world.velocity(evader)

    def blind(self, actions: NDArray[np.int64]) -> list[int]:
        """Return the pursuers whose evader is out of sensing range now, given the (N,) actions."""
        unseen = np.zeros(self._world.size, dtype=bool)
        for evader in self._world.evaders():
            unseen |= (actions == evader) & (self._world.distances(evader) > self.sensing.radius)
        found: list[int] = np.flatnonzero(unseen).tolist()
        return found

    def last(self, pursuer: int, evader: int) -> tuple[int, complex, complex]:
        """Return the last sighting of an evader by a pursuer: time (ns, or `NEVER`), position (m), velocity (m/s)."""
        cell = evader - 1, pursuer
        return int(self._seen[cell]), complex(self._positions[cell]), complex(self._velocities[cell])

    def forget(self, pursuer: int) -> None:
        """Delete all sightings by a pursuer itself."""
        self._seen[:, pursuer] = NEVER


class SensedView:
    """The world as sensed by one pursuer: the `PursuerView` of its agent.

    An evader is seen, tracked (its newest sighting is at most `track_timeout` old), lost (the sighting is older), or
    unknown (there is no sighting).

    Args:
        pursuer: its id.
        sensor: the sensors of the team, with its own sightings.
        world: the true state of the world.
        network: the network that delivers reports.
        clock: its own clock.
    """

    def __init__(self, pursuer: int, sensor: TeamSensor, world: GlobalState, network: Network, clock: NodeClock):
        self._id, self._sensor, self._sensing = pursuer, sensor, sensor.sensing
        self._world, self._network, self._clock = world, network, clock
        self.size, self.evader_count, self.radius = world.size, world.evader_count, world.radius
        self.speed, self.position, self.positions = world.speed, world.position, world.positions
        self.action, self.set_action = world.action, world.set_action
        self.evaders, self.time_left = world.evaders, world.time_left
        self._reported: dict[int, Sighting] = {}

    # Sightings and estimates of an evader.

    def sees(self, evader: int) -> bool:
        """Return whether an evader is within its sensing radius now."""
        return bool(self._world.distances(evader)[self._id] <= self._sensing.radius)

    def newest(self, evader: int) -> Sighting | None:
        """Return the newest sighting of an evader, its own or a reported one; None if there is none."""
        self._read_reports()
        reported = self._reported.get(evader)
        if self.sees(evader):
            return _sighting(evader, self._clock.now, self._world.evader(evader), self._world.velocity(evader))
        when, place, velocity = self._sensor.last(self._id, evader)
        if when == NEVER:
            return reported
        own = self._clock.at(when)
        return reported if reported is not None and reported.seen > own else _sighting(evader, own, place, velocity)

    def estimate(self, evader: int) -> EvaderEstimate | None:
        """Return the estimate of an evader; None if it is unknown, or lost and not searched for (`on_lost`)."""
        if self.sees(evader):
            return EvaderEstimate(self._world.evader(evader), self._world.velocity(evader))
        sighting, sensing = self.newest(evader), self._sensing
        if sighting is None:
            return None
        age = max(self._clock.now - sighting.seen, 0.0)
        worst = sensing.estimate == "worst_case"
        uncertainty = self._world.evader_speed(evader) * age if worst else 0.0
        velocity = sighting.velocity if sensing.estimate == "constant_velocity" else 0j
        if age <= sensing.track_timeout:
            return EvaderEstimate(sighting.position + velocity * age, velocity, uncertainty)
        if sensing.on_lost == "stay":
            return None
        apart = 2.0 * max(sensing.radius, self._world.radius)
        arm = rect(1.0, 2.0 * pi * self._id / self.size)  # pursuers of equal speed search in different directions
        off = arm * spiral(self.speed(self._id) * (age - sensing.track_timeout), apart)
        return EvaderEstimate(
            sighting.position + velocity * sensing.track_timeout + off, 0j, uncertainty + abs(off) if worst else 0.0
        )

    def report(self) -> None:
        """Send the neighbours the sightings that have not expired: its own and, with `relay`, reported ones."""
        oldest = self._clock.now - self._sensing.track_timeout
        newest = [each for each in map(self.newest, self._world.evaders()) if each is not None and each.seen >= oldest]
        reports = tuple(each for each in newest if self._sensing.relay or each is not self._reported.get(each.evader))
        if reports:
            self._network.send(self._id, None, reports, port=PORT)

    def forget(self, *, heard_only: bool) -> None:
        """Delete the reported sightings, and its own as well unless `heard_only`."""
        self._read_reports()
        self._reported.clear()
        if not heard_only:
            self._sensor.forget(self._id)

    def _read_reports(self) -> None:
        """Process the reports that have arrived."""
        for message in self._network.inbox(self._id, PORT).drain():
            for sighting in message.body:
                known = self._reported.get(sighting.evader)
                if known is None or sighting.seen > known.seen:
                    self._reported[sighting.evader] = sighting

    # The view of its agent.

    def evader(self, evader: int) -> complex:
        """Return the estimated position of an evader, m; nan if unknown."""
        estimate = self.estimate(evader)
        return NOWHERE if estimate is None else estimate.position

    def capture_times(self, evader: int) -> tuple[float, ...]:
        """Return the capture time of each pursuer for an evader at its estimated position, s; inf if unknown."""
        if self.sees(evader) or evader not in self._world.evaders():
            return self._world.capture_times(evader)
        estimate = self.estimate(evader)
        if estimate is None:
            return (inf,) * self.size
        return self._world.capture_times_at(estimate.position, estimate.uncertainty, evader)

    def capture_times_of(self, pursuers: Collection[int], evader: int) -> list[float]:
        """Return the capture times of some pursuers, s; see `capture_times`."""
        times = self.capture_times(evader)
        return [times[pursuer] for pursuer in pursuers]

    def capture_time_from(self, pursuer: int, position: complex, evader: int) -> float:
        """Return the capture time of a pursuer from a hypothetical position (m), s."""
        estimate = self.estimate(evader)
        if estimate is None:
            return inf
        return self._world.capture_time_over(pursuer, abs(estimate.position - position) + estimate.uncertainty, evader)

    def may_chase(self, pursuer: int, evader: int) -> bool:
        """Return whether a pursuer may choose to chase an evader, which requires an estimate of its position."""
        return self.estimate(evader) is not None and self._world.may_chase(pursuer, evader, self)

    def options(self, pursuer: int) -> tuple[int, ...]:
        """Return the actions that a pursuer may choose: 0, and each evader that it may chase."""
        return (0, *(evader for evader in self.evaders() if self.may_chase(pursuer, evader)))

    def reckoned(
        self, position: complex, speed: float, age: int, evader: int, *, exact: bool, ended: int = 0
    ) -> complex:
        """Return the present position of a pursuer that has chased an evader from `position` (m) since `age` ns ago, m.

        It is extrapolated straight towards the estimated position of the evader, because no pursuer has observed the
        whole path of the evader.
        """
        if evader not in self._world.evaders():
            return self._world.reckoned(position, speed, age, evader, exact=False, ended=ended)
        estimate = self.estimate(evader)
        if estimate is None or self._world.static:
            return position
        return nearer(position, estimate.position, speed * seconds(age - ended))


def spiral(length: float, apart: float) -> complex:
    """Return the point at an arc length (m) along an Archimedean spiral from the origin, turns `apart` (m) apart, m.

    From r = apart angle / 2 pi and the arc length r angle / 2, which holds approximately after many turns.
    """
    if apart == 0.0:
        return 0j
    angle = sqrt(4.0 * pi * length / apart)
    return rect(apart * angle / (2.0 * pi), angle)


def _sighting(evader: int, seen: float, place: complex, velocity: complex) -> Sighting:
    return Sighting(evader, seen, place.real, place.imag, velocity.real, velocity.imag)

"""Sensing of evaders by pursuers with a limited range or behind walls, and estimation from past sightings.

Within the sensing radius a pursuer sees the true position of an evader, unless a wall that blocks sight is between
them. Otherwise, the pursuer estimates the position from the newest sighting that it knows, its own or a reported one
(`Sensing.estimate`). Its decisions and its guidance use this estimate. The sensing radius applies to evaders only:
teammates are sensed at any distance or announce their positions, and all pursuers know which evaders are captured.
"""

from cmath import rect
from collections.abc import Iterable
from math import asinh, hypot, inf, pi, sqrt
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import model_validator

from desim.config.model import MAX_COORDINATE, Flag, Limit, Period, Timeout, Value
from desim.kernel.core.clock import NodeClock
from desim.kernel.core.ports import ReservedPort
from desim.kernel.network import Network
from desim.pursuit.sensing.fusion import Fusion
from desim.pursuit.sensing.noise import NOISES, Noise, Noiseless
from desim.pursuit.sensing.tracking import ESTIMATORS, Estimator, Kalman, Unfiltered
from desim.pursuit.sensing.views import NOWHERE, EvaderEstimate, Prune, View

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from desim.config.arrays import Points
    from desim.pursuit.sensing.world_state import Actions, WorldState

PORT = ReservedPort("sightings", __name__)
"""The port of sighting reports."""
NEVER = -1
"""Stands for the time of the last sighting, ns, of an evader that was never seen."""


class Sensing(Value):
    """The sensing of evaders, and the estimation of the positions of unseen ones."""

    radius: Limit = inf
    """Sensing radius R_s up to which a pursuer sees an evader, m."""
    estimate: Literal["hold", "constant_velocity", "worst_case"] = "constant_velocity"
    """Estimated position of an unseen evader. hold: the position of the last sighting; constant_velocity: this position
    extrapolated with the velocity at the last sighting; worst_case: the position of the last sighting, with the capture
    time phi = (d + v_e a - eps) / (v_i - v_e), where d is the distance to this position and a the age of the sighting.
    If all clocks are equal, this phi is an upper bound. worst_case is refused with a flow, and for pursuers with
    inertia."""
    period: Period = 0.1
    """Time between two reports of a pursuer, s. A pursuer repeats its own last sighting, because reports may be lost,
    until the sighting is `track_timeout` old or a newer one is reported to it.

    An estimate may be wrong by the distance that the evader covers in this time; short periods load a contended
    channel.

    If in doubt, use the heartbeat of the announcements.
    """
    relay: Flag = False
    """Whether a pursuer also relays the newest reported sighting, so that sightings spread over several hops."""
    track_timeout: Timeout = 5.0
    """Time T_lost, s: an evader is lost if its newest sighting is older than this.

    With a short time, pursuers give up an evader whose estimate is still good; with a long time, they chase a place
    that the evader has left.

    If in doubt, use the time in which the evader crosses the sensing radius, and at least ten periods of reports.
    """
    on_lost: Literal["stay", "search"] = "search"
    """Reaction to a lost evader. stay: it may not be chased; search: its estimated position moves along a spiral at
    the speed of the pursuer, from the last estimated position. The spiral starts when the evader is lost, even if the
    pursuer is still far away. Its turns are 2 R_s apart, at least 2 eps; if only walls limit the sight, R_s is the
    distance that the evader covers in the time T_lost. The spiral of each pursuer is rotated by another angle. A
    pursuer without any sighting of an evader may not chase it."""
    noise: Annotated[Noise, NOISES] = Noiseless()
    """Noise of sightings."""
    interval: Period = 0.05
    """Time between two noisy sightings of a pursuer, s; without noise it sees at every motion step.

    If in doubt, use the interval of the real sensor; the time of a run grows with the number of sightings.
    """
    estimator: Annotated[Unfiltered | Estimator, ESTIMATORS] = Unfiltered()
    """Filter of noisy sightings; without one, the newest sighting is the estimate (`estimate`)."""
    fusion: Fusion = "by_stamp"
    """How reports are combined. by_stamp: reports contain the newest sighting of a pursuer, and the filter of a
    receiver processes all sightings in the order of their time stamps. With the other values, reports contain
    tracks with their covariances. naive: tracks are fused as if they were independent; covariance_intersection: the
    fused track is consistent, whatever sightings the tracks have in common."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        has_filter = not isinstance(self.estimator, Unfiltered)
        if has_filter and not self.is_noisy:
            raise ValueError("estimator: there is nothing to estimate without noise (sensing.noise)")
        if self.is_noisy and not has_filter and self.estimate == "constant_velocity":
            raise ValueError(
                "estimate: noisy sightings have no velocity; choose an estimator (alpha_beta, kalman), or the estimate"
                " hold or worst_case"
            )
        if self.fusion != "by_stamp" and not self.has_covariances:
            raise ValueError("fusion: tracks have a covariance with the estimator kalman only")
        return self

    @property
    def limited(self) -> bool:
        """Whether the sensing radius is finite."""
        return self.radius < inf

    @property
    def is_noisy(self) -> bool:
        """Whether sightings have errors."""
        return not isinstance(self.noise, Noiseless)

    @property
    def has_covariances(self) -> bool:
        """Whether estimates have covariances."""
        return isinstance(self.estimator, Kalman)


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


class Sensors:
    """The base of the sensors of a team, exact or noisy.

    Args:
        sensing: the parameters.
        state: the true state of the world.
        prune: which pursuers may not chase an evader.
        network: the network that delivers reports.
    """

    def __init__(self, sensing: Sensing, state: "WorldState", prune: Prune, network: Network):
        self.sensing, self.state, self.prune, self.network = sensing, state, prune, network


class TeamSensor(Sensors):
    """The sensors of the whole team, sampled once every motion step for all pursuers and evaders together.

    Attributes:
        views: (N,) the sensed view of each pursuer.
    """

    def __init__(
        self, sensing: Sensing, state: "WorldState", prune: Prune, network: Network, clocks: Iterable[NodeClock]
    ):
        super().__init__(sensing, state, prune, network)
        shape = state.evader_count, state.size
        self._stamps: NDArray[np.int64] = np.full(shape, NEVER, dtype=np.int64)  # of the last sightings
        self._positions: Points = np.full(shape, NOWHERE)
        self._velocities: Points = np.zeros(shape, dtype=complex)
        self.views = [SensedView(self, pursuer, clock) for pursuer, clock in enumerate(clocks)]
        self.look(state.now)

    def look(self, now: int) -> None:
        """Record, for each pursuer that is not down, a sighting at `now` (ns) of each evader in its sensing range."""
        state, working = self.state, ~self.state.broken
        for evader in state.at_large:
            seeing = working & state.in_sight(evader, self.sensing.radius)
            row = evader - 1
            self._stamps[row, seeing] = now
            self._positions[row, seeing] = state.body(evader).position
            self._velocities[row, seeing] = state.velocity(evader)

    def blind(self, actions: "Actions") -> list[int]:
        """Return the pursuers that do not see their evader now, given the (N,) actions."""
        unseen = np.zeros(self.state.size, dtype=bool)
        for evader in self.state.at_large:
            unseen |= (actions == evader) & ~self.state.in_sight(evader, self.sensing.radius)
        pursuers: list[int] = np.flatnonzero(unseen).tolist()
        return pursuers

    def last(self, pursuer: int, evader: int) -> tuple[int, complex, complex]:
        """Return the last sighting of an evader by a pursuer: time (ns, or `NEVER`), position (m), velocity (m/s)."""
        cell = evader - 1, pursuer
        return int(self._stamps[cell]), complex(self._positions[cell]), complex(self._velocities[cell])

    def forget(self, pursuer: int) -> None:
        """Delete all sightings that a pursuer has made itself."""
        self._stamps[:, pursuer] = NEVER


class LimitedView(View):
    """Base of the views of pursuers that do not always know the true position of an evader.

    Args:
        sensor: the sensors of the team.
        pursuer: the id of the pursuer.
        clock: the local clock of the pursuer.
    """

    unlimited: ClassVar[bool] = False

    def __init__(self, sensor: Sensors, pursuer: int, clock: NodeClock):
        super().__init__(sensor.state, sensor.prune)
        self._id, self._sensing, self._network, self._clock = pursuer, sensor.sensing, sensor.network, clock

    def newest(self, evader: int) -> Sighting | None:
        """Return the newest sighting of an evader, the pursuer's own or a reported one; None if there is none."""
        raise NotImplementedError

    def report(self) -> None:
        """Broadcast what the pursuer knows of the evaders."""
        raise NotImplementedError

    def forget(self, *, heard_only: bool) -> None:
        """Delete the reported sightings and, unless `heard_only`, the pursuer's own."""
        raise NotImplementedError

    def _estimate_from_sighting(self, evader: int) -> EvaderEstimate | None:
        """Return the estimate that follows from the newest sighting (`sensing.estimate`); None if there is none."""
        sighting, sensing = self.newest(evader), self._sensing
        if sighting is None:
            return None
        age = max(self._clock.now - sighting.seen, 0.0)
        is_worst_case = sensing.estimate == "worst_case"
        uncertainty = self.state.body(evader).speed * age if is_worst_case else 0.0
        place, velocity = complex(sighting.x, sighting.y), 0j
        if sensing.estimate == "constant_velocity":
            velocity = complex(sighting.velocity_x, sighting.velocity_y)
        if age <= sensing.track_timeout:
            return EvaderEstimate(place + velocity * age, velocity, uncertainty)
        if sensing.on_lost == "stay":
            return None
        offset = self._search(age, evader)
        lost_at = place + velocity * sensing.track_timeout
        return EvaderEstimate(lost_at + offset, 0j, uncertainty + abs(offset) if is_worst_case else 0.0)

    def _search(self, age: float, evader: int) -> complex:
        """Return the offset of the search, m, from the position at which the evader was lost.

        The newest sighting is `age` s old.
        """
        reach = self._sensing.radius
        if reach == inf:  # only walls limit the sight
            reach = self.state.body(evader).speed * self._sensing.track_timeout
        apart = 2.0 * max(min(reach, MAX_COORDINATE), self.state.radius)  # the bound keeps twice the radius finite
        # Pursuers of equal speed search in different directions.
        rotation = rect(1.0, 2.0 * pi * self._id / self.state.size)
        return rotation * spiral(self.state.speed(self._id) * (age - self._sensing.track_timeout), apart)


class SensedView(LimitedView):
    """The view of one pursuer with limited sensing.

    An evader is seen, tracked (its newest sighting is at most `track_timeout` old), lost (the sighting is older), or
    unknown (there is no sighting). The sensors of the team keep the pursuer's own sightings.
    """

    def __init__(self, sensor: TeamSensor, pursuer: int, clock: NodeClock):
        super().__init__(sensor, pursuer, clock)
        self._sensor = sensor
        self._reported: dict[int, Sighting] = {}

    def sees(self, evader: int) -> bool:
        """Return whether an evader is within the sensing radius of the pursuer now, and not behind a wall."""
        return self.state.sees(self._id, evader, self._sensing.radius)

    def newest(self, evader: int) -> Sighting | None:
        """Return the newest sighting of an evader, the pursuer's own or a reported one; None if there is none."""
        self._read_reports()
        reported = self._reported.get(evader)
        if self.sees(evader):
            seen, place, velocity = self._clock.now, self.state.body(evader).position, self.state.velocity(evader)
        else:
            stamp, place, velocity = self._sensor.last(self._id, evader)
            if stamp == NEVER or (reported is not None and reported.seen > self._clock.at(stamp)):
                return reported
            seen = self._clock.at(stamp)
        return Sighting(evader, seen, place.real, place.imag, velocity.real, velocity.imag)

    def estimate(self, evader: int) -> EvaderEstimate | None:
        """Return the estimate of an evader; None if it is unknown, or lost and not searched for (`on_lost`)."""
        return super().estimate(evader) if self.sees(evader) else self._estimate_from_sighting(evader)

    def report(self) -> None:
        """Broadcast the newest sightings that are at most `track_timeout` old, those of teammates only with `relay`."""
        oldest = self._clock.now - self._sensing.track_timeout
        reports = tuple(
            sighting
            for sighting in map(self.newest, self.state.at_large)
            if sighting is not None
            and sighting.seen >= oldest
            and (self._sensing.relay or sighting is not self._reported.get(sighting.evader))
        )
        if reports:
            self._network.send(self._id, None, reports, port=PORT)

    def forget(self, *, heard_only: bool) -> None:
        """Delete the reported sightings and, unless `heard_only`, the pursuer's own."""
        self._read_reports()  # so that reports that have arrived unread are forgotten, too
        self._reported.clear()
        if not heard_only:
            self._sensor.forget(self._id)

    def _read_reports(self) -> None:
        """Read the reports that have arrived, and keep the newest reported sighting of each evader."""
        for message in self._network.inbox(self._id, PORT).drain():
            for sighting in message.body:
                previous = self._reported.get(sighting.evader)
                if previous is None or sighting.seen > previous.seen:
                    self._reported[sighting.evader] = sighting


def spiral(length: float, apart: float) -> complex:
    """Return the point (m) of an Archimedean spiral at an arc length (m) from its start, the origin.

    The distance between two turns is `apart` (m): the radius is b angle, with b = apart / (2 pi), and the arc length
    is b (angle sqrt(1 + angle^2) + asinh(angle)) / 2.
    """
    if apart == 0.0:
        return 0j
    scaled = 2.0 * pi * length / apart
    # The arc length over b is convex in the angle, and at least angle and angle^2 / 2. So Newton's method begins above
    # the root and descends to it. After four steps only rounding errors are left, at any length.
    angle = min(scaled, sqrt(2.0 * scaled))
    for _ in range(4):
        slope = hypot(1.0, angle)
        angle -= (0.5 * (angle * slope + asinh(angle)) - scaled) / slope
    return rect(apart * angle / (2.0 * pi), angle)

"""Sensing: what pursuers see of the evaders if they do not see far, and what they make of what they have seen.

Within the sensing radius a pursuer sees an evader as it is. Else it goes by the newest sighting it knows of, its own or
one that was reported to it, and by how old that is (`Sensing.estimate`). Everything it decides then rests on that
estimate, and it is the estimate that it chases. Teammates are sensed, or say where they are, as ever; and everybody
knows which evaders have been captured.
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
"""Where reports of sightings come in."""
NEVER = -1
"""When an evader was last seen that never was."""
NOWHERE = complex(np.nan, np.nan)
"""Where an evader is of which nothing is known, m."""


class Sensing(Value):
    """What pursuers see of the evaders, and what they make of what they have seen."""

    radius: Limit = inf
    """Distance R_s up to which a pursuer sees an evader, m."""
    estimate: Literal["hold", "constant_velocity", "worst_case"] = "constant_velocity"
    """Where an evader is that is not seen: where it was last seen (hold); where it would be had it kept the velocity it
    had then; or somewhere within v_e age of where it was, so that with equal clocks phi is a bound:
    (d + v_e age - eps) / (v_i - v_e)."""
    period: Period = 0.1
    """Time between two reports of a pursuer, s. It tells the last sighting of its own until that is `track_timeout` old
    or it hears of a newer one, again and again, for reports are lost as other messages are."""
    relay: Flag = False
    """Whether the newest that others have reported is told, too, so that it spreads over several hops."""
    track_timeout: Timeout = 5.0
    """Age T_lost of a sighting from which on the evader is lost, s."""
    on_lost: Literal["stay", "search"] = "search"
    """What to do about an evader that is lost: nothing; or to look for it along a spiral about where it was believed to
    be, with turns 2 R_s apart, each pursuer in a direction of its own. The spiral begins as the evader is lost,
    wherever the pursuer is by then. Who has never heard of it stays."""

    @property
    def limited(self) -> bool:
        """Whether there is anything that is not seen."""
        return self.radius < inf


class Sighting(NamedTuple):
    """Where an evader was seen."""

    evader: int
    """1 .. M"""
    seen: float
    """When, by the clock of who saw it, s."""
    x: float
    """m"""
    y: float
    """m"""
    velocity_x: float
    """m/s"""
    velocity_y: float
    """m/s"""

    @property
    def place(self) -> complex:
        """Where it was, m."""
        return complex(self.x, self.y)

    @property
    def velocity(self) -> complex:
        """How it moved, m/s."""
        return complex(self.velocity_x, self.velocity_y)


class EvaderEstimate(NamedTuple):
    """Where an evader is believed to be."""

    place: complex
    """m"""
    velocity: complex = 0j
    """m/s"""
    uncertainty: float = 0.0
    """How much farther it may be from anywhere, m."""


class TeamSensor:
    """What the whole team sees; looked at once every motion step, for all pursuers and evaders at a time.

    Attributes:
        sights: (N,) what each pursuer makes of it.
    """

    def __init__(self, sensing: Sensing, world: GlobalState, network: Network, clocks: Iterable[NodeClock]):
        self.sensing, self._world = sensing, world
        shape = world.evader_count, world.size
        self._seen: NDArray[np.int64] = np.full(shape, NEVER, dtype=np.int64)
        self._places: Points = np.full(shape, NOWHERE)
        self._velocities: Points = np.zeros(shape, dtype=complex)
        self.sights = [SensedView(pursuer, self, world, network, clock) for pursuer, clock in enumerate(clocks)]

    def look(self, now: int) -> None:
        """Let everybody that is not broken remember the evaders that it sees at an instant, ns."""
        able = ~self._world.broken()
        for evader in self._world.evaders():
            seeing = able & (self._world.distances(evader) <= self.sensing.radius)
            row = evader - 1
            self._seen[row, seeing] = now
            self._places[row, seeing] = self._world.evader(evader)
            self._velocities[row, seeing] = self._world.velocity(evader)

    def blind(self, actions: NDArray[np.int64]) -> list[int]:
        """Return who does not see now what it chases, given what everybody chases."""
        unseen = np.zeros(self._world.size, dtype=bool)
        for evader in self._world.evaders():
            unseen |= (actions == evader) & (self._world.distances(evader) > self.sensing.radius)
        found: list[int] = np.flatnonzero(unseen).tolist()
        return found

    def last(self, pursuer: int, evader: int) -> tuple[int, complex, complex]:
        """Return when a pursuer last saw an evader (ns, or `NEVER`), where (m), and its velocity (m/s)."""
        cell = evader - 1, pursuer
        return int(self._seen[cell]), complex(self._places[cell]), complex(self._velocities[cell])

    def forget(self, pursuer: int) -> None:
        """Let a pursuer forget what it has seen."""
        self._seen[:, pursuer] = NEVER


class SensedView:
    """The world as one pursuer sees it: the `PursuerView` of its agent.

    Args:
        pursuer: whose it is.
        watch: what it sees with its own eyes.
        world: as it is.
        network: which brings reports.
        clock: its own.
    """

    def __init__(self, pursuer: int, watch: TeamSensor, world: GlobalState, network: Network, clock: NodeClock):
        self._id, self._watch, self._sensing = pursuer, watch, watch.sensing
        self._world, self._network, self._clock = world, network, clock
        self.size, self.evader_count, self.radius = world.size, world.evader_count, world.radius
        self.speed, self.place, self.places = world.speed, world.place, world.places
        self.action, self.set_action = world.action, world.set_action
        self.evaders, self.time_left = world.evaders, world.time_left
        self._heard: dict[int, Sighting] = {}

    # What it knows of an evader.

    def sees(self, evader: int) -> bool:
        """Return whether it sees an evader now."""
        return bool(self._world.distances(evader)[self._id] <= self._sensing.radius)

    def newest(self, evader: int) -> Sighting | None:
        """Return the newest sighting it knows of, its own or one it heard of; None if there is none."""
        self._listen()
        heard = self._heard.get(evader)
        if self.sees(evader):
            return _sighting(evader, self._clock.now, self._world.evader(evader), self._world.velocity(evader))
        when, place, velocity = self._watch.last(self._id, evader)
        if when == NEVER:
            return heard
        own = self._clock.at(when)
        return heard if heard is not None and heard.seen > own else _sighting(evader, own, place, velocity)

    def estimate(self, evader: int) -> EvaderEstimate | None:
        """Return where it believes an evader to be; None if it has never heard of it, or has lost it and stays."""
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
            return EvaderEstimate(sighting.place + velocity * age, velocity, uncertainty)
        if sensing.on_lost == "stay":
            return None
        apart = 2.0 * max(sensing.radius, self._world.radius)
        arm = rect(1.0, 2.0 * pi * self._id / self.size)  # so that who is equally fast goes another way
        off = arm * spiral(self.speed(self._id) * (age - sensing.track_timeout), apart)
        return EvaderEstimate(
            sighting.place + velocity * sensing.track_timeout + off, 0j, uncertainty + abs(off) if worst else 0.0
        )

    def report(self) -> None:
        """Tell the neighbours the newest sightings that are not too old."""
        oldest = self._clock.now - self._sensing.track_timeout
        news = [each for each in map(self.newest, self._world.evaders()) if each is not None and each.seen >= oldest]
        told = tuple(each for each in news if self._sensing.relay or each is not self._heard.get(each.evader))
        if told:
            self._network.send(self._id, None, told, port=PORT)

    def forget(self, *, heard_only: bool) -> None:
        """Forget what has been reported to it, or all sightings."""
        self._listen()
        self._heard.clear()
        if not heard_only:
            self._watch.forget(self._id)

    def _listen(self) -> None:
        """Take note of what has been reported to it."""
        for message in self._network.inbox(self._id, PORT).drain():
            for sighting in message.body:
                known = self._heard.get(sighting.evader)
                if known is None or sighting.seen > known.seen:
                    self._heard[sighting.evader] = sighting

    # What it makes of that, as its agent's surroundings.

    def evader(self, evader: int) -> complex:
        """Return where it believes an evader to be, m; nan if it does not know."""
        estimate = self.estimate(evader)
        return NOWHERE if estimate is None else estimate.place

    def capture_times(self, evader: int) -> tuple[float, ...]:
        """Return every pursuer's time of capture of an evader where it is believed to be, s; inf if that is unknown."""
        if self.sees(evader) or evader not in self._world.evaders():
            return self._world.capture_times(evader)
        estimate = self.estimate(evader)
        if estimate is None:
            return (inf,) * self.size
        return self._world.capture_times_at(estimate.place, estimate.uncertainty, evader)

    def capture_times_of(self, pursuers: Collection[int], evader: int) -> list[float]:
        """Return the times of capture of some pursuers, s; as `capture_times`."""
        times = self.capture_times(evader)
        return [times[pursuer] for pursuer in pursuers]

    def capture_time_from(self, pursuer: int, position: complex, evader: int) -> float:
        """Return the time of capture of a pursuer if it were at a position (m), s."""
        estimate = self.estimate(evader)
        if estimate is None:
            return inf
        return self._world.capture_time_over(pursuer, abs(estimate.place - position) + estimate.uncertainty, evader)

    def may_chase(self, pursuer: int, evader: int) -> bool:
        """Return whether a pursuer has the choice to chase an evader, for which it has to be known where that is."""
        return self.estimate(evader) is not None and self._world.may_chase(pursuer, evader, self)

    def options(self, pursuer: int) -> tuple[int, ...]:
        """Return the actions that a pursuer may choose: 0, and each evader that it may chase."""
        return (0, *(evader for evader in self.evaders() if self.may_chase(pursuer, evader)))

    def reckoned(
        self, position: complex, speed: float, age: int, evader: int, *, exact: bool, ended: int = 0
    ) -> complex:
        """Return the position of a pursuer that set out at a position (m) an age (ns) ago to chase an evader, m.

        Straight towards where the evader is believed to be, for nobody has seen its whole path.
        """
        if evader not in self._world.evaders():
            return self._world.reckoned(position, speed, age, evader, exact=False, ended=ended)
        estimate = self.estimate(evader)
        if estimate is None or self._world.static:
            return position
        return nearer(position, estimate.place, speed * seconds(age - ended))


def spiral(length: float, apart: float) -> complex:
    """Return the point at an arc length (m) along an Archimedean spiral from the origin with turns so far apart, m.

    From r = apart angle / 2 pi and the arc length r angle / 2 that follows for many turns.
    """
    if apart == 0.0:
        return 0j
    angle = sqrt(4.0 * pi * length / apart)
    return rect(apart * angle / (2.0 * pi), angle)


def _sighting(evader: int, seen: float, place: complex, velocity: complex) -> Sighting:
    return Sighting(evader, seen, place.real, place.imag, velocity.real, velocity.imag)

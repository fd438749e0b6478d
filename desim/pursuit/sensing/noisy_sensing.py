"""Sight with errors: pursuers measure the positions of evaders, filter the sightings, and exchange them.

A pursuer measures each evader in its sensing range once per `sensing.interval`. Without an estimator the newest
sighting, its own or a reported one, is its estimate. Otherwise a filter (`desim.pursuit.sensing.tracking`) keeps a
track of each evader. Captures follow the true positions.
"""

from collections import defaultdict
from collections.abc import Generator, Iterable, Iterator
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

from desim.config.answers import wrong_answer
from desim.config.python_numbers import as_complex
from desim.kernel.core.clock import Clock, Instant, NodeClock, Phase
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.kernel.network import Network
from desim.pursuit.core.events import Estimated
from desim.pursuit.sensing.correction import StateVector, Upper
from desim.pursuit.sensing.fusion import InformedTrack, fused, informed
from desim.pursuit.sensing.noise import Covariance, Noiseless, covariance_of
from desim.pursuit.sensing.sensing import PORT, LimitedView, Sensing, Sensors, Sighting, TeamSensor
from desim.pursuit.sensing.tracking import Filter, Measurement, Track, Unfiltered
from desim.pursuit.sensing.views import EvaderEstimate, Prune

if TYPE_CHECKING:
    import simpy

    from desim.pursuit.sensing.world_state import Actions, WorldState


class Sighted(NamedTuple):
    """A report of a sighting."""

    evader: int
    """1 .. M"""
    measurement: Measurement


class Tracked(NamedTuple):
    """A report of a track."""

    evader: int
    """1 .. M"""
    stamp: int
    """Time of the track by the clock of its sender, ns."""
    state: StateVector
    covariance: Upper


class NoisySensor(Sensors):
    """The sensors of a team whose sightings have errors; it takes the place of `sensing.TeamSensor`.

    Args:
        sensing, state, prune, network: see `Sensors`.
        clocks: (N,) the local clocks.
        env: the clock of the simulation.
        seed: the seed of the run.

    Attributes:
        views: (N,) the view of each pursuer.
    """

    def __init__(
        self,
        sensing: Sensing,
        state: "WorldState",
        prune: Prune,
        network: Network,
        clocks: Iterable[NodeClock],
        env: Clock,
        seed: int,
    ):
        assert not isinstance(sensing.noise, Noiseless)
        super().__init__(sensing, state, prune, network)
        self._env, self._noise = env, sensing.noise
        self._covariance_at = partial(covariance_of, sensing.noise)
        self._streams = [stream(seed, "sight", j) for j in range(state.evader_count)]
        self._predicted: dict[int, tuple[Tracked, InformedTrack]] = {}
        """By `id` of a report: the report, which keeps its `id` from being reused, and its track at `_predicted_at`."""
        self._predicted_at: int | None = None  # ns
        self.views = [TrackingView(self, pursuer, clock) for pursuer, clock in enumerate(clocks)]
        self._measure()
        env.process(self._measurements())

    def look(self, now: int) -> None:
        """Do nothing: sightings have times of their own, not those of motion steps."""

    def blind(self, actions: "Actions") -> list[int]:
        """Return the pursuers that chase: none knows the true position of its evader."""
        chasing: list[int] = actions.nonzero()[0].tolist()
        return chasing

    def estimates(self) -> Iterator[Estimated]:
        """Yield the present estimates, with covariances, of all evaders at large by the pursuers that are up.

        No reports are read, so that recording the estimates changes nothing.
        """
        if not self.sensing.has_covariances:
            return
        for pursuer in (~self.state.broken).nonzero()[0].tolist():
            for evader in self.state.at_large:
                track = self.views[pursuer].track(evader)
                if track is not None and track.covariance is not None:
                    (x, y, _, _), (xx, xy, _, _, yy, *_) = track.state, track.covariance
                    yield Estimated(self._env.now, pursuer, evader, x, y, xx, xy, yy)

    def predicted(self, reports: Iterable[Tracked], now: int) -> list[InformedTrack]:
        """Return reported tracks at a time, ns; pursuers that have the same report share its prediction.

        Kept equal to a prediction by each pursuer by
        `tests/pursuit/test_noisy_sensing.py::test_predictions_that_are_shared_are_those_of_each_pursuer`.
        """
        assert not isinstance(self.sensing.estimator, Unfiltered)
        if self._predicted_at != now:
            self._predicted, self._predicted_at = {}, now
        shared, predict = self._predicted, self.sensing.estimator.predict
        tracks: list[InformedTrack] = []
        for report in reports:
            entry = shared.get(id(report))  # faster than a hash of all its numbers
            if entry is None:
                entry = shared[id(report)] = report, informed(predict(Track(*report[1:]), now))
            tracks.append(entry[1])
        return tracks

    def _measurements(self) -> "Generator[simpy.Event, None, None]":
        period = nanoseconds(self.sensing.interval)
        while True:
            # After messages of the instant have arrived, and before captures.
            yield Instant(self._env, self._env.now + period, Phase.CAPTURE - 1)
            self._measure()

    def _measure(self) -> None:
        """Let each pursuer that is up measure each evader in its range.

        Random numbers are drawn for all pursuers, so they do not depend on who measures.
        """
        state, radius = self.state, self.sensing.radius
        for evader, rng in enumerate(self._streams, start=1):
            draws = rng.standard_normal((state.size, 2)).tolist()
            if evader not in state.at_large:
                continue
            offsets = (state.body(evader).position - state.positions()).tolist()
            seeing = (state.in_sight(evader, radius) & ~state.broken).tolist()
            for view, offset, (first, second), sees in zip(self.views, offsets, draws, seeing, strict=True):
                if sees:
                    answer: Any = self._noise(offset, first, second)
                    measured = as_complex(answer)
                    if measured != measured:
                        expected = "a noise should return the measured vector, a complex number in m"
                        raise wrong_answer(expected, answer, self._noise)
                    view.measure(evader, measured, self._covariance_at(measured))


Sensor = TeamSensor | NoisySensor
"""The sensors of a team, exact within a radius or with errors."""


class TrackingView(LimitedView):
    """The view of one pursuer whose sightings have errors."""

    def __init__(self, sensor: NoisySensor, pursuer: int, clock: NodeClock):
        super().__init__(sensor, pursuer, clock)
        self._sensor = sensor
        self._track_timeout = nanoseconds(min(self._sensing.track_timeout, 1e9))  # inf has no nanoseconds
        self._last_own: dict[int, Measurement] = {}
        """By evader, the newest sighting of its own."""
        self._newest: dict[int, Measurement] = {}
        """By evader, the newest sighting, its own or a reported one."""
        self._filters: dict[int, Filter] = {}
        self._tracks: defaultdict[int, dict[int, Tracked]] = defaultdict(dict)
        """By evader and sender, the newest reported track."""
        self._fused: dict[int, Track | None] = {}
        """By evader, the track at the time `_fused_at`, ns, until a new sighting or report."""
        self._fused_at: int | None = None

    def sees(self, evader: int) -> bool:
        """Return False: it never knows the true position of an evader."""
        return False

    def measure(self, evader: int, offset: complex, covariance: Covariance) -> None:
        """Process a sighting of its own: the measured vector to an evader, m."""
        origin = self.state.position(self._id)
        place = origin + offset
        self._last_own[evader] = Measurement(
            self._clock.stamp, self._id, place.real, place.imag, covariance, origin.real, origin.imag
        )
        self._add(evader, self._last_own[evader])

    def estimate(self, evader: int) -> EvaderEstimate | None:
        """Return the estimate of an evader; None if it is unknown, or lost and not searched for (`on_lost`)."""
        self._read_reports()
        if isinstance(self._sensing.estimator, Unfiltered):
            estimate = self._estimate_from_sighting(evader)
            return None if estimate is None else estimate._replace(covariance=self._newest[evader].covariance)
        track, now, sensing = self.track(evader), self._clock.stamp, self._sensing
        if track is None or self.state.body(evader).captured is not None:
            return None
        newest = self._newest_stamp(evader)
        age = max(now - newest, 0) / SECOND
        if age <= sensing.track_timeout:
            return EvaderEstimate(track.position, track.velocity, 0.0, track.deviation, track.position_covariance)
        if sensing.on_lost == "stay":
            return None
        lost_at = track.position - track.velocity * (age - sensing.track_timeout)
        place = lost_at + self._search(age, evader)
        return EvaderEstimate(place, 0j, 0.0, track.deviation, track.position_covariance)

    def newest(self, evader: int) -> Sighting | None:
        """Return the newest sighting of an evader, its own or a reported one, without a velocity; None without any."""
        self._read_reports()
        sighting = self._newest.get(evader)
        return None if sighting is None else Sighting(evader, seconds(sighting.stamp), sighting.x, sighting.y, 0.0, 0.0)

    def track(self, evader: int) -> Track | None:
        """Return the track of an evader now, fused with those of teammates; None without any."""
        now = self._clock.stamp
        if self._fused_at != now:
            self._fused, self._fused_at = {}, now
        if evader not in self._fused:
            self._fused[evader] = self._fuse(evader, now)
        return self._fused[evader]

    def _fuse(self, evader: int, now: int) -> Track | None:
        """Return the track of an evader at `now` (ns, local clock)."""
        track = self._filters[evader].at(now) if evader in self._filters else None
        reports = self._tracks[evader]
        if not reports:
            return track
        # In order of sources: the fusion of three tracks depends on their order, and reports arrive in any order.
        others = self._sensor.predicted((report for _, report in sorted(reports.items())), now)
        return fused(others if track is None else [informed(track), *others], self._sensing.fusion)

    def report(self) -> None:
        """Broadcast sightings or tracks that are at most `track_timeout` old, those of teammates only with `relay`."""
        reports = tuple(filter(None, map(self._report_of, self.state.at_large)))
        if reports:
            self._network.send(self._id, None, reports, port=PORT)

    def forget(self, *, heard_only: bool) -> None:
        """Delete the reported sightings and tracks and, unless `heard_only`, the pursuer's own."""
        self._network.inbox(self._id, PORT).drain()
        # A filter does not tell own sightings from reported ones, so it begins anew with the last own sighting.
        sightings = self._last_own if heard_only else {}
        self._last_own, self._newest, self._filters = dict(sightings), dict(sightings), {}
        self._tracks.clear()
        self._fused_at = None
        for evader, sighting in sightings.items():
            self._add(evader, sighting)

    def _report_of(self, evader: int) -> Sighted | Tracked | None:
        """Return the report of this pursuer about an evader; None if its sighting or track is too old, or missing."""
        self._read_reports()
        oldest = self._clock.stamp - self._track_timeout
        if self._sensing.fusion == "by_stamp":
            sighting = (self._newest if self._sensing.relay else self._last_own).get(evader)
            return None if sighting is None or sighting.stamp < oldest else Sighted(evader, sighting)
        if self._sensing.relay:
            track = self.track(evader)
            return None if track is None or self._newest_stamp(evader) < oldest else _packed(evader, track)
        track = self._filters[evader].track if evader in self._filters else None
        return None if track is None or track.stamp < oldest else _packed(evader, track)

    def _add(self, evader: int, sighting: Measurement) -> None:
        """Process a sighting, its own or a reported one."""
        self._fused_at = None
        newest = self._newest.get(evader)
        if newest is None or sighting.stamp > newest.stamp:
            self._newest[evader] = sighting
        model = self._sensing.estimator
        if not isinstance(model, Unfiltered):
            if evader not in self._filters:
                environment = self.state.environment
                flow_speed = environment.top_speed if environment.on == "all" and environment.top_speed < inf else 0.0
                speed = self.state.body(evader).speed + flow_speed  # over ground, as sightings are
                covariance_at = partial(covariance_of, self._sensing.noise)
                self._filters[evader] = Filter(model, self._track_timeout, covariance_at, speed=speed)
            self._filters[evader].add(sighting)

    def _newest_stamp(self, evader: int) -> int:
        """Return the time of the newest sighting or reported track of an evader, ns; -1 without any."""
        newest = self._newest[evader].stamp if evader in self._newest else -1
        for report in self._tracks[evader].values():
            newest = max(newest, report.stamp)
        return newest

    def _read_reports(self) -> None:
        """Process the reports that have arrived."""
        for message in self._network.inbox(self._id, PORT).drain():
            for report in message.body:
                if isinstance(report, Sighted):
                    self._add(report.evader, report.measurement)
                else:
                    tracks = self._tracks[report.evader]
                    if message.src not in tracks or tracks[message.src].stamp < report.stamp:
                        tracks[message.src], self._fused_at = report, None


def _packed(evader: int, track: Track) -> Tracked:
    """Return a track as a report."""
    assert track.covariance is not None
    return Tracked(evader, track.stamp, track.state, track.covariance)

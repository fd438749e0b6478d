"""The timeline of a run: the active pursuers and the capture times, piece by piece.

A piece is the time between two successive breakpoints. The breakpoints are the start and the end of the run, changes of
action, samples of positions, crashes and recoveries of robots, and captures. No action changes within a piece, so
metrics of the actions alone are exact. The capture time phi of a pursuer is the time that it needs for a capture from
now on (`desim.pursuit.motion.capture`), in a flow as the pursuers compute it (`desim.pursuit.motion.flow_capture`). It
is evaluated in the middle of a piece, at positions interpolated between the samples, and for pursuers with inertia with
the mean courses between the samples. It is exact in a static game; for other games `desim.analysis.hindsight` gives
examples of the error. Each evader has its own timeline; the timelines of all evaders have the same pieces.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desim.analysis.activity import changes, evader_pursuits
from desim.analysis.trace_index import NO_POSITIONS, captures, ended, places_of, positions_known, samples, started
from desim.config.arrays import Bools, Floats, Integers, Points
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.kernel.models.faults import Crash
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.pursuit.core.events import Sampled, Started
from desim.pursuit.core.geometry import SMALLEST
from desim.pursuit.core.state import complex_points, lengths
from desim.pursuit.motion.capture import RadialTime
from desim.pursuit.motion.dynamics import Courses
from desim.pursuit.motion.flow import displacement, is_uniform
from desim.pursuit.motion.flow_capture import capture_times_in_flow
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result


class RelativePlaces:
    """The positions of all players relative to the medium, if its flow is the same everywhere; otherwise over ground.

    Args:
        scenario: the scenario of the run.

    Attributes:
        are_known: (N + M,) whether the position relative to the medium is known; always for players that the flow does
            not carry.
        error: upper bound of the error of a position, m, because the simulated flow is constant within a motion step.
    """

    def __init__(self, scenario: Scenario):
        on_all = scenario.environment.on == "all"
        self._flow = scenario.players_environment.flow
        carried = [pursuer not in scenario.team.relays for pursuer in range(scenario.team.count)]
        self._carried = np.array([*carried, *(on_all and evader.record is None for evader in scenario.evaders)])
        self.are_known = ~self._carried if not is_uniform(self._flow) else np.ones_like(self._carried)
        change = self._flow.top_acceleration if is_uniform(self._flow) else 0.0  # m/s^2
        self.error = change * scenario.motion.step**2

    def __call__(self, event: Started | Sampled) -> Points:
        """Return the (N + M,) positions, m."""
        places = complex_points([*event.pursuers, *event.evaders])
        if is_uniform(self._flow):
            places = places - self._carried * displacement(self._flow, 0.0, seconds(event.t))
        return places


ROUNDING = 1e-9
"""Displacement between two samples, m, up to which a pursuer counts as standing still."""
PART = 1 << 18
"""Largest number of capture times in one part of a timeline; a part with a single piece may have more."""


@dataclass(frozen=True, slots=True)
class Timeline:
    """A part of the timeline of one evader: k successive pieces, each of positive length."""

    times: Integers
    """(k + 1,) breakpoints, ns."""
    active: Bools
    """(k, N) whether each pursuer chases the evader."""
    phi: Floats
    """(k, N) capture times, s, at the middle of the piece; inf for a relay, for a robot that is down, and after the
    capture."""
    left: Floats
    """(k,) time left r, s, at the middle of the piece; in a static game, always the horizon."""

    @property
    def durations(self) -> Floats:
        """(k,) lengths of the pieces, s."""
        return np.diff(self.times) / SECOND


def timeline(result: Result, evader: int = 1) -> Iterator[Timeline]:
    """Yield the timeline of a run in successive parts; O(N) for each sample and change of action.

    Args:
        result: the result of a run whose positions were recorded.
        evader: the number of the evader, 1 .. M; the parts for all evaders have the same pieces.

    Raises:
        ValueError: if positions were not recorded.
    """
    if not positions_known(result):
        raise ValueError(NO_POSITIONS)
    start, end, scenario = started(result), ended(result).t, result.scenario
    pursuit = evader_pursuits(result)[evader - 1]
    horizon, static = nanoseconds(scenario.horizon), scenario.motion.static
    path, size = _Path(result, evader), len(start.active)
    capture_times = _capture_times(result, evader, path)
    active = _Counts(pursuit.start, pursuit.steps)
    broken = _Counts((False,) * size, list(_breakdowns(result)))
    event_times = [event.t for event in [*changes(result), *captures(result)]]
    times = np.unique(np.concatenate([[0, end], path.t, np.array(event_times, np.int64), broken.t]))
    step = max(PART // size, 1)
    for first in range(0, len(times) - 1, step):
        instants = times[first : first + step + 1]
        middle = (instants[:-1] + instants[1:]) / 2
        phi = capture_times(middle)
        phi[broken.during(instants)] = np.inf
        phi[:, list(scenario.team.relays)] = np.inf  # a relay may not chase, even if an evader comes near
        phi[instants[:-1] >= pursuit.end] = np.inf
        left = (horizon - (np.zeros_like(middle) if static else middle)) / SECOND
        yield Timeline(instants, active.during(instants), phi, left)


def _capture_times(result: Result, evader: int, path: "_Path") -> Callable[[Floats], Floats]:
    """Return a function from (k,) times, ns, to the (k, N) capture times, s, of an evader."""
    scenario, speeds = result.scenario, np.array(started(result).speeds)
    dynamics, environment = scenario.pursuer_dynamics, scenario.players_environment
    evader_speed, radius = scenario.evaders[evader - 1].speed, scenario.capture.radius
    radial_time = RadialTime(speeds, evader_speed, radius)

    def with_inertia(t: Floats) -> Floats:
        states = zip(path.gaps(t), path.courses(t), strict=True)
        return np.array([dynamics.capture_times(*state, speeds, evader_speed, radius) for state in states])

    def in_flow(t: Floats) -> Floats:
        states = zip(path.gaps(t), path.pursuers(t), t.tolist(), strict=True)
        phi = [
            capture_times_in_flow(
                environment, places[0] + gaps[0], places, lengths(gaps), speeds, evader_speed, radius, int(now)
            )
            for gaps, places, now in states
        ]
        return np.array(phi)

    def among_walls(t: Floats) -> Floats:
        space, phi = scenario.space, []
        for gaps, at in zip(path.gaps(t), path.pursuers(t), strict=True):
            places = np.append(at, at[0] + gaps[0])
            free = space.are_free(places)
            if not free.all():  # between two samples, a straight line may cut a corner of a wall
                places = np.where(free, places, [space.free_place(place) for place in places.tolist()])
            phi.append(radial_time(space.distances(places[:-1], complex(places[-1]))))
        return np.array(phi)

    if not dynamics.is_simple:
        return with_inertia
    if not environment.keeps_distances:
        return in_flow
    if not scenario.space.is_open:
        return among_walls
    return lambda t: radial_time(lengths(path.gaps(t)))


def _breakdowns(result: Result) -> Iterator[tuple[int, int, int]]:
    """Yield (time (ns), pursuer, increment) for the start (increment 1) and the end (-1) of each crash of a robot."""
    for place in places_of(result, FaultStarted, FaultEnded):
        event: Any = result.trace.events[place]
        if isinstance(event.fault, Crash) and event.fault.scope == "robot":
            yield event.t, event.fault.node, 1 if isinstance(event, FaultStarted) else -1


class _Counts:
    """One integer counter per pursuer as a step function of time.

    Args:
        start: (N,) initial values.
        steps: the (time (ns), pursuer, increment) of each step.
    """

    def __init__(self, start: tuple[bool, ...], steps: list[tuple[int, int, int]]):
        self._start = np.array(start, np.int32)
        self.t, self._pursuer, self._increment = np.array(steps, np.int64).reshape(-1, 3).T

    def during(self, times: Integers) -> Bools:
        """Return (k, N) whether each counter is positive in each of the k pieces between the (k + 1,) times (ns)."""
        piece = np.searchsorted(times, self.t)  # for each step, the first piece that begins at its time or later
        rows = np.zeros((len(times), len(self._start)), np.int32)
        rows[0] = self._start
        np.add.at(rows, (np.minimum(piece, len(times) - 1), self._pursuer), self._increment)
        during: Bools = np.cumsum(rows[:-1], axis=0) > 0  # the last row holds the steps after the last piece
        return during


class _Path:
    """The positions of the pursuers and of one evader, interpolated linearly; the first sample is the start."""

    def __init__(self, result: Result, evader: int):
        self._result, self._samples = result, samples(result)
        self.t = np.array([sample.t for sample in self._samples])
        # Number by number: `np.array` of the nested tuples takes eight times as long.
        coordinates = chain.from_iterable(chain.from_iterable(sample.pursuers for sample in self._samples))
        pursuers = np.fromiter(coordinates, float).reshape(len(self._samples), -1, 2)
        gaps = np.array([sample.evaders[evader - 1] for sample in self._samples])[:, None] - pursuers
        self._gaps = gaps[..., 0] + 1j * gaps[..., 1]  # (samples, N) from each pursuer to the evader
        self._pursuers = pursuers[..., 0] + 1j * pursuers[..., 1]

    def gaps(self, t: Floats) -> Points:
        """Return the (k, N) vectors from each pursuer to the evader at (k,) times (ns), m; constant after the last."""
        return self._interpolated(self._gaps, t)

    def pursuers(self, t: Floats) -> Points:
        """Return the (k, N) positions of the pursuers at (k,) times (ns), m; constant after the last."""
        return self._interpolated(self._pursuers, t)

    def _interpolated(self, values: Points, t: Floats) -> Points:
        """Return the (k, N) values at (k,) times (ns), given those at the samples."""
        before, after = self._samples_around(t)
        share = (t - self.t[before]) / np.maximum(self.t[after] - self.t[before], 1)
        points: Points = values[before] + share[:, None] * (values[after] - values[before])
        return points

    def courses(self, t: Floats) -> list[Courses]:
        """Return the mean courses of the pursuers between the samples around each of (k,) times (ns).

        Courses are relative to the flow. A pursuer that stands still keeps its heading.
        """
        scenario, seed = self._result.scenario, self._result.seed
        relative = RelativePlaces(scenario)
        places = np.array([relative(sample)[: scenario.team.count] for sample in self._samples])
        displacements = np.diff(places, axis=0, append=places[-1:])
        headings, noise = np.empty_like(displacements), ROUNDING + 2.0 * relative.error
        heading = np.array(scenario.team.headings(seed))
        for row, step in enumerate(displacements):
            heading = np.where(lengths(step) <= noise, heading, step / np.maximum(lengths(step), SMALLEST))
            headings[row] = heading
        durations = np.diff(self.t, append=self.t[-1] + 1) / SECOND  # the last duration may be any but 0
        before, _ = self._samples_around(t)
        return [Courses(displacements[row] / durations[row], headings[row]) for row in before.tolist()]

    def _samples_around(self, t: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the indices of the samples before and after each of (k,) times (ns)."""
        before = np.searchsorted(self.t, t, side="right") - 1
        return before, np.minimum(before + 1, len(self.t) - 1)

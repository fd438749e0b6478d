"""Invariants of motion among walls: no path crosses a wall, and no evader is captured through one."""

import numpy as np

from desim.kernel.core.events import Event
from desim.kernel.core.units import seconds
from desim.kernel.walls.crossings import crossings
from desim.kernel.walls.wall import blocking
from desim.pursuit.core.events import Captured, Sampled, Started
from desim.pursuit.core.state import complex_points, coordinates
from desim.scenario.scenario import Scenario

ROUNDING = 1e-6
"""Tolerance for rounding errors, m."""


class PathWatcher:
    """A watcher that checks that no player crosses a wall that blocks motion.

    - Between two samples, each player goes straight without crossing a wall, or can go around walls at its speed: the
      shortest path is not longer than its speed times the time. Evaders with recorded motions may cross walls.
    - At a capture that ends the run, the shortest path from the capturer is not longer than the capture radius.

    Without walls that block motion it checks nothing.

    Args:
        scenario: the scenario of the run.

    Attributes:
        judged: the number of paths around walls that were compared.
    """

    def __init__(self, scenario: Scenario):
        self._space, self._radius = scenario.space, scenario.capture.radius
        self._segments = blocking(scenario.wall, "motion")
        relays = scenario.team.relays
        self._speeds = [relays[j].top_speed if j in relays else v for j, v in enumerate(scenario.team.all_speeds())]
        self._speeds += [evader.speed if evader.record is None else np.inf for evader in scenario.evaders]
        self._before: Started | Sampled | None = None
        self._capture: Captured | None = None
        self.judged = 0

    def __call__(self, event: Event) -> None:
        """Process an event."""
        if self._space.is_open:
            return
        if isinstance(event, Captured):
            self._capture = event
        elif isinstance(event, Started | Sampled):
            if self._before is not None:
                self._check_paths(self._before, event)
            if self._capture is not None and self._capture.t == event.t:
                self._check_capture(self._capture, event)
            self._before = event

    def _check_paths(self, before: Started | Sampled, after: Started | Sampled) -> None:
        """Check the path of each player between two samples."""
        begin, end = (complex_points([*event.pursuers, *event.evaders]) for event in (before, after))
        duration = seconds(after.t - before.t)
        for player in (begin != end).nonzero()[0].tolist():
            source, target = begin[player : player + 1], end[player : player + 1]
            if not crossings(coordinates(source), coordinates(target), self._segments, ROUNDING).any():
                continue
            length = self._space.distance(complex(source[0]), complex(target[0]))
            reach = self._speeds[player] * duration
            self.judged += 1
            if not length <= reach + ROUNDING * (1.0 + reach):
                raise AssertionError(
                    f"no path crosses a wall: up to {seconds(after.t)} s player {player} of {len(begin)} (the"
                    f" {len(after.pursuers)} pursuers come first) came from {source[0]:g} to {target[0]:g} in"
                    f" {duration} s, but the shortest path around walls is {length} m long, and it can go {reach} m"
                )

    def _check_capture(self, capture: Captured, event: Started | Sampled) -> None:
        """Check the path of the capturer to the evader, at a sample at the time of the capture."""
        pursuer, evader = complex(*event.pursuers[capture.capturer]), complex(*event.evaders[capture.evader - 1])
        length = self._space.distance(pursuer, evader)
        if not length <= self._radius + ROUNDING * (1.0 + self._radius):
            raise AssertionError(
                f"no evader is captured through a wall: at {seconds(event.t)} s pursuer {capture.capturer} is {length}"
                f" m of path from evader {capture.evader}, and the capture radius is {self._radius} m"
            )

"""Headings of players with inertia, from the samples of their positions.

A player heads in the direction of its last motion relative to the medium. Before it first moves, it has its initial
heading.
"""

import numpy as np

from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Sampled, Started
from desim.pursuit.motion.flow import displacement, is_uniform
from desim.scenario.scenario import Scenario

ROUNDING = 1e-9
"""A displacement of at most this share of the distance from the origin (m, plus 1) is a rounding error."""
SLOW = 1e-3
"""A player whose motion relative to the flow is at most this share of its drift may be at rest in the flow."""


class Headings:
    """The headings of the players with inertia in a run, sample by sample.

    Args:
        scenario: the experiment.
        seed: the seed of the run.

    Attributes:
        players: the indices of the players with inertia among all players, pursuers first.
    """

    def __init__(self, scenario: Scenario, seed: int):
        team, evaders = scenario.team, scenario.evaders
        pursuers = [k for k in range(team.count) if team.has_inertia and k not in team.relays]
        headings = dict(zip(pursuers, [team.headings(seed)[k] for k in pursuers], strict=True))
        headings |= {team.count + k: evader.heading(seed, k) for k, evader in enumerate(evaders) if evader.has_inertia}
        self.players = tuple(headings)
        self._headings = list(headings.values())
        self._places: list[complex] = []
        """The positions of `players` at the last sample, m; empty before the first sample."""
        self._t = 0
        self._environment, self._size = scenario.environment, team.count

    def at(self, sample: Started | Sampled) -> list[complex]:
        """Return the headings, of length 1, of `players` at a sample, given the samples in order."""
        positions = [complex(x, y) for x, y in (*sample.pursuers, *sample.evaders)]
        places = [positions[k] for k in self.players]
        for k, (before, place) in enumerate(zip(self._places, places, strict=False)):
            if place == before:  # a captured player stays, so subtracting the drift would turn it
                continue
            drift = self._drift(self.players[k], (before + place) / 2.0, sample.t)
            motion = place - before - drift
            if abs(motion) > ROUNDING * (abs(place) + 1.0) + SLOW * abs(drift):
                self._headings[k] = motion / abs(motion)
        self._places, self._t = places, sample.t
        return list(self._headings)

    def _drift(self, player: int, middle: complex, t: int) -> complex:
        """Return the displacement, m, of a player by the flow since the last sample, by the midpoint rule."""
        flow, begin, end = self._environment.flow, self._t / SECOND, t / SECOND
        if player >= self._size and self._environment.on == "pursuers":
            return 0j
        if is_uniform(flow):
            return displacement(flow, begin, end)
        return complex(flow(np.array([middle]), (begin + end) / 2.0)[0]) * (end - begin)

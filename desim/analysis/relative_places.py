"""The positions in a trace relative to the medium, whose flow carries the players."""

import numpy as np

from desim.config.arrays import Points
from desim.kernel.core.units import seconds
from desim.pursuit.core.events import Sampled, Started
from desim.pursuit.core.state import complex_points
from desim.pursuit.motion.flow import NoFlow, is_uniform
from desim.scenario.scenario import Scenario


class RelativePlaces:
    """The positions of all players relative to the medium, if its flow is the same everywhere; otherwise over ground.

    Args:
        scenario: the scenario of the run.

    Attributes:
        are_known: (N + M,) whether the position of each player is known relative to the medium, or the flow does
            not carry it.
        error: upper bound of the error of a position, m: within a motion step, the simulated flow is constant.
    """

    def __init__(self, scenario: Scenario):
        on_all = scenario.environment.on == "all"
        self._flow = NoFlow() if scenario.motion.static else scenario.environment.flow
        carried = [pursuer not in scenario.team.relays for pursuer in range(scenario.team.count)]
        self._carried = np.array([*carried, *(on_all and evader.record is None for evader in scenario.evaders)])
        self.are_known = ~self._carried if not is_uniform(self._flow) else np.ones_like(self._carried)
        change = self._flow.top_acceleration if is_uniform(self._flow) else 0.0  # m/s^2
        self.error = change * scenario.motion.step**2

    def __call__(self, event: Started | Sampled) -> Points:
        """Return the (N + M,) positions, m."""
        places = complex_points([*event.pursuers, *event.evaders])
        if is_uniform(self._flow):
            places = places - self._carried * self._flow.displacement(0.0, seconds(event.t))
        return places

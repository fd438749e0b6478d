"""The positions of the pursuers, for the network."""

from collections.abc import Callable

from desim.config.arrays import Floats, Integers
from desim.kernel.core.positions import Nodes, PositionSource
from desim.pursuit.core.state import coordinates
from desim.pursuit.sensing.world_state import WorldState


class PursuerPositions(PositionSource):
    """The positions of the pursuers for the network; see `desim.kernel.core.positions.PositionSource`."""

    looks_back = True

    def __init__(self, state: WorldState, top_speed: float):
        self._state = state
        self.max_speed = 0.0 if state.static else top_speed

    def __call__(self) -> Floats:
        """Return the (N, 2) positions now, m."""
        return coordinates(self._state.positions())

    def of(self, nodes: Nodes) -> Floats:
        """Return the (k, 2) positions of some pursuers now, m."""
        return coordinates(self._state.players.positions_of(nodes))

    def distance(self, node: int, other: int) -> float:
        """Return the present distance between two pursuers, m.

        Kept equal to that between their positions by
        `tests/simulation/test_world.py::test_the_distance_of_two_pursuers_is_that_between_their_positions`.
        """
        return self._state.players.distances(node, [other])[0]

    def at(self, nodes: Nodes, times: int | Integers) -> Floats:
        """Return the (k, 2) positions of some pursuers, m, at times of the present piece, ns."""
        return coordinates(self._state.players.positions_at(nodes, times))

    def before_change(self, act: Callable[[], object]) -> None:
        """Register a function to call before the motion of a player changes."""
        self._state.players.before_change(act)

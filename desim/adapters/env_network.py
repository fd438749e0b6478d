"""A network that begins and steps with an environment."""

import secrets
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

from desim.kernel.core.seeds import seed_of, stream
from desim.kernel.stepped_network import SteppedNetwork


class EnvNetwork:
    """A network beside an environment, whose episodes and steps it shares.

    Args:
        env: the environment, for `positions`.
        agents: the agents, in the order of the rows of positions.
        links: as in `SteppedNetwork`.
        dt: duration of a step, s.
        positions: function of the environment that returns the positions of its agents: (n, 2), or a dict; or None.
        graph: a networkx graph whose nodes are the agents; the nodes of the network are their numbers if None.
        seed: the seed of the network until `reset` is given one.
        **arguments: further arguments of `SteppedNetwork`, except a trace, which is of one episode.

    Raises:
        ValueError: if an argument is not valid.
    """

    def __init__(
        self,
        env: Any,
        agents: Sequence[Hashable],
        links: Any,
        *,
        dt: float = 0.1,
        positions: Callable[[Any], Any] | None = None,
        graph: Any = None,
        seed: int | None = None,
        **arguments: Any,
    ):
        if positions is not None and not callable(positions):
            raise ValueError("positions should be a function of the environment, which is called after each step of it")
        self._env, self._agents, self._dt, self._positions_of = env, tuple(agents), dt, positions
        self._root = None if seed is None else seed_of(seed)
        self._episodes = 0
        if graph is not None and set(graph) != set(self._agents):
            raise ValueError(f"the nodes of the graph should be the agents {list(self._agents)} (got {list(graph)})")
        self.network = SteppedNetwork(len(self._agents) if graph is None else graph, links, **arguments)
        self.network.step(dt)  # a wrong duration is refused now, not in the first step
        self.network.reset(0)
        self.node = {agent: k if graph is None else agent for k, agent in enumerate(self._agents)}
        """The node of each agent."""
        self._places: dict[Any, Any] = {}
        """The last place of each node in this episode."""

    def reset(self, seed: int | None) -> None:
        """Begin an episode.

        Args:
            seed: the seed of the network; None: another episode of the seed that was given last, or of none.
        """
        if seed is not None:
            self._root, self._episodes = seed_of(seed), 0
        if self._root is None:
            drawn = secrets.randbits(63)
        elif self._episodes:
            drawn = int(stream(self._root, "episode", self._episodes).integers(2**63))
        else:
            drawn = self._root
        self._episodes += 1
        self._places = {}
        self.network.reset(drawn, positions=self._read_positions())

    def step(self) -> None:
        """Let the duration of a step pass, in which the agents have moved to where they are now."""
        self.network.step(self._dt, self._read_positions())

    def _read_positions(self) -> Any:
        """Return the positions of the nodes now, by node; None if there is no function for them."""
        if self._positions_of is None:
            return None
        places = self._positions_of(self._env)
        if not isinstance(places, Mapping):
            if len(places) != len(self._agents):
                raise ValueError(f"positions should have {len(self._agents)} rows, one per agent (got {len(places)})")
            places = dict(zip(self._agents, places, strict=True))
        self._places |= {self.node[agent]: place for agent, place in places.items()}
        return self._places

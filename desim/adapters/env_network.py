"""A network that begins and steps with an environment."""

import secrets
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

from desim.config.arguments import value_text
from desim.config.arrays import array_of, array_text
from desim.config.caller_warnings import warn_caller
from desim.config.calls import check_argument
from desim.config.model import MAX_COORDINATE
from desim.config.python_numbers import whole
from desim.kernel.core.seeds import seed_of, stream
from desim.kernel.models.graphs import is_networkx
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.medium import MANY, channel_of
from desim.kernel.stepped_arguments import links_argument
from desim.kernel.stepped_network import SteppedNetwork

CAPACITY = 100
"""Default number of nodes for agents that are not known in advance."""
NOWHERE = (MAX_COORDINATE / 2, MAX_COORDINATE / 2)
"""The place of a node that no agent has yet, m: beyond the range of all others."""


class EnvNetwork:
    """A network beside an environment, with the same episodes and steps.

    Args:
        env: the environment, for `positions`.
        agents: the agents, in the order of the rows of positions; None if they are known only when they appear.
        links: as in `SteppedNetwork`.
        dt: duration of a step, s.
        positions: function of the environment that returns the positions of its agents: (n, 2), or a dict; or None.
        graph: a networkx graph whose nodes are the agents; if None, the nodes are the rows of the agents.
        capacity: the number of nodes, if the agents are not known: each agent that appears in an episode takes one.
        seed: the seed of the network until `reset` is given one.
        at_once: whether all agents transmit at the same instant of a step; if so, a warning is given for a channel on
            which most of their frames overlap.
        **arguments: further arguments of `SteppedNetwork`, except a trace, which belongs to a single episode.

    Raises:
        ValueError: if an argument is not valid.
    """

    def __init__(
        self,
        env: Any,
        agents: Sequence[Hashable] | None,
        links: Any,
        *,
        dt: float = 0.1,
        positions: Callable[[Any], Any] | None = None,
        graph: Any = None,
        capacity: int = CAPACITY,
        seed: int | None = None,
        at_once: bool = True,
        **arguments: Any,
    ):
        if positions is not None and not callable(positions):
            raise ValueError("positions should be a function of the environment, which is called after each step of it")
        if positions is not None:
            check_argument(positions, ("env",), "positions")
        if graph is not None and not is_networkx(graph):
            raise ValueError(
                f"graph should be a graph of networkx whose nodes are the agents (got {value_text(graph)})"
            )
        if (capacity := whole(capacity, "capacity")) < 1:
            raise ValueError(f"capacity should be at least 1 (got {capacity})")
        self._env, self._dt, self._positions_of, self._has_graph = env, dt, positions, graph is not None
        self._root_seed, links = None if seed is None else seed_of(seed), links_argument(links)
        self._episodes, self._is_open = 0, agents is None  # open: agents are known only when they appear
        self.row = {agent: row for row, agent in enumerate(agents or ())}
        """The row of each agent that has appeared."""
        self.size = capacity if self._is_open else len(self.row)
        if graph is not None and set(graph) != set(self.row):
            raise ValueError(f"the nodes of the graph should be the agents {list(self.row)} (got {list(graph)})")
        self.network = SteppedNetwork(self.size if graph is None else graph, links, **arguments)
        if at_once and self.size > 1:
            _check_overlap(links, self.size)
        self.network.step(dt)  # a wrong duration is refused now, not in the first step
        self.network.reset(0)
        self._places: dict[Any, Any] = {}
        """The last place of each node in this episode."""

    def node(self, agent: Hashable) -> Any:
        """Return the node of an agent.

        Raises:
            ValueError: if more agents have appeared than there are nodes.
        """
        if self._has_graph:
            return agent
        if self._is_open and agent not in self.row:
            if len(self.row) == self.size:
                raise ValueError(f"more than {self.size} agents have appeared in an episode: raise capacity=")
            self.row[agent] = len(self.row)
        return self.row[agent]

    def reset(self, seed: int | None) -> None:
        """Begin an episode.

        Args:
            seed: the seed of the network. None: the next episode of the last seed, or a random seed if there is none.
        """
        if seed is not None:
            self._root_seed, self._episodes = seed_of(seed), 0
        if self._root_seed is None:
            episode_seed = secrets.randbits(63)
        elif self._episodes:
            episode_seed = int(stream(self._root_seed, "episode", self._episodes).integers(2**63))
        else:
            episode_seed = self._root_seed
        self._episodes += 1
        self._places = {}
        if self._is_open:
            self.row.clear()
            self._places = dict.fromkeys(self.network.nodes, NOWHERE)
        self.network.reset(episode_seed, positions=self._read_positions())

    def step(self) -> None:
        """Let the duration of a step pass, during which the agents have moved to their present positions."""
        self.network.step(self._dt, self._read_positions())

    def _read_positions(self) -> Any:
        """Return the positions of the nodes now, by node; None without the function `positions`."""
        if self._positions_of is None:
            return None
        places = self._positions_of(self._env)
        if not isinstance(places, Mapping):
            if hasattr(places, "loc") and {*places.index} == {*self.row}:  # a table of pandas by agent
                places = places.loc[[*self.row]].reset_index(drop=True)
            rows = array_of(places)
            if rows.ndim == 0 or len(rows) != len(self.row) or self._is_open:
                expected = "be a dict by agent" if self._is_open else f"have {len(self.row)} rows, one per agent"
                raise ValueError(f"positions should {expected} (got {array_text(rows)})")
            places = dict(zip(self.row, rows, strict=True))
        unknown = [] if self._is_open else [agent for agent in places if agent not in self.row]
        if unknown:
            raise ValueError(
                f"positions has {value_text(unknown[0])}, which is no agent: they are {value_text(list(self.row))}"
            )
        self._places |= {self.node(agent): place for agent, place in places.items()}
        return self._places


def _check_overlap(links: Links, senders: int) -> None:
    """Warn if most of the frames that nodes create at one instant overlap; random delays separate frames."""
    channel = channel_of(links.medium, 0.0)
    if channel is None or type(links.processing.sender) is not Constant:
        return
    overlapping = 1.0 - (1.0 - channel.chance) ** (senders - 1)
    if overlapping >= MANY:
        text = (
            f"network.medium: all agents speak at the same instant of a step, and {100.0 * overlapping:.0f} % of their"
            " frames overlap on this channel: a random delay, such as `network.processing.sender`, should separate them"
        )
        warn_caller(text)

"""Many independent networks of one configuration, stepped together, with arrays in and out."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from desim.config.arrays import Floats, array_of, array_text
from desim.config.python_numbers import whole
from desim.kernel.core.seeds import run_seed, seed_of
from desim.kernel.stepped_arguments import LARGEST_NETWORK
from desim.kernel.stepped_network import ReceivedMessage, SteppedNetwork
from desim.kernel.stepped_positions import copy_of_positions

if TYPE_CHECKING:
    import networkx as nx

MAX_NETWORKS = 100_000
"""The greatest number of networks; each takes some 12 kB before its first message."""


class SteppedNetworks:
    """Independent networks of one configuration, for environments that are simulated side by side.

    Each is a `SteppedNetwork` with its own seed: network e has the seed `run_seed(seed, e)` of
    `desim.kernel.core.seeds`, like run e of a sweep, and equals a single network with this seed byte for byte. The
    networks are the items of this object, for example `networks[3].lost()`.

    Args:
        count: the number of networks, E, at most 100,000.
        nodes: as in `SteppedNetwork`; all networks together have at most 1,000,000.
        links: as in `SteppedNetwork`.
        seed: the root of the seeds of all networks.
        positions: (E, n, 2) positions at the start, m.
        **arguments: further arguments of `SteppedNetwork`, except a trace.

    Raises:
        ValueError: if an argument is not valid.
    """

    def __init__(
        self,
        count: int,
        nodes: "int | nx.Graph[Any]",
        links: Any = None,
        *,
        seed: int = 0,
        positions: Any = None,
        **arguments: Any,
    ):
        if "trace" in arguments:
            raise ValueError("a trace is of one network: step single ones, each with a trace")
        count = whole(count, "the number of networks")
        if not 1 <= count <= MAX_NETWORKS:
            raise ValueError(f"there should be at least 1 network and at most {MAX_NETWORKS:,} (got {count:,})")
        root = seed_of(seed)
        self._shape: tuple[int, ...] | None = None
        """The shape of the published bodies of this episode; None before the first."""
        # An iterator is converted to a list, because the first network would exhaust it.
        arguments = {name: [*value] if isinstance(value, Iterator) else value for name, value in arguments.items()}
        first = SteppedNetwork(nodes, links, seed=run_seed(root, 0), **arguments)
        if (total := count * len(first.nodes)) > LARGEST_NETWORK:
            raise ValueError(
                f"all networks together should have at most {LARGEST_NETWORK:,} nodes (got {count:,} of"
                f" {len(first.nodes):,}: {total:,})"
            )
        others = [SteppedNetwork(nodes, links, seed=run_seed(root, e), **arguments) for e in range(1, count)]
        self._networks = [first, *others]
        self._array: Any = None
        """The positions that were given last, which are read at each step."""
        if positions is not None:
            self.reset(root, positions=positions)

    def send(self, bodies: Any) -> None:
        """Let every node broadcast a row of an array (E, n) or (E, n, k) as a message; see `SteppedNetwork.send`."""
        for network, rows in zip(self._usable(), self._bodies(bodies), strict=True):
            for node, body in zip(network.nodes, rows, strict=True):
                network.send(node, None, body)

    def publish(self, bodies: Any) -> None:
        """Let every node publish a row of an array (E, n) or (E, n, k) as its state; see `SteppedNetwork.publish`."""
        rows_of_networks, shape = self._bodies(bodies), np.shape(bodies)[2:]
        if self._shape not in {None, shape}:
            raise ValueError(f"the bodies of an episode should have one shape, first {self._shape}, now {shape}")
        self._shape = shape
        for network, rows in zip(self._usable(), rows_of_networks, strict=True):
            for node, body in zip(network.nodes, rows, strict=True):
                network.publish(node, body)

    def step(self, dt: float, positions: Any = None) -> list[list[ReceivedMessage]]:
        """Let time pass in all networks; return the messages that have arrived in each, see `SteppedNetwork.step`.

        Args:
            dt: the duration, s.
            positions: (E, n, 2) the positions at the end, m; None: those that the array given last contains now.
        """
        by_network = self._rows(positions)
        return [network.step(dt, rows) for network, rows in zip(self._usable(), by_network, strict=True)]

    def latest(self) -> Floats:
        """Return the newest numbers that have arrived, (E, receivers, sources) or (E, receivers, sources, k).

        Where no number has arrived, and where receiver and source are the same node, they are nan. k is as in
        `publish`.
        """
        tables = [[network.latest(node) for node in network.nodes] for network in self._networks]
        size = len(self._networks[0].nodes)
        latest = np.full((len(self), size, size, *(self._shape or ())), np.nan)
        number_of = {node: number for number, node in enumerate(self._networks[0].nodes)}
        for e, tables_of_nodes in enumerate(tables):
            for dst, table in enumerate(tables_of_nodes):
                for src, message in table.items():
                    latest[e, dst, number_of[src]] = message.body
        return latest

    def ages(self) -> Floats:
        """Return the (E, receivers, sources) ages of the newest states that have arrived, s."""
        return np.array([network.ages() for network in self._networks])

    @property
    def now(self) -> float:
        """The time, s."""
        return self._networks[0].now

    def reset(self, seed: int, *, positions: Any = None) -> None:
        """Begin all networks anew, exactly as new ones with this seed would; see `SteppedNetwork.reset`."""
        root, by_network, self._shape = seed_of(seed), self._rows(positions), None
        for e, network in enumerate(self._networks):
            network.reset(run_seed(root, e), positions=by_network[e])

    def close(self) -> None:
        """Close all networks."""
        for network in self._networks:
            network.close()

    def __len__(self) -> int:
        return len(self._networks)

    def __getitem__(self, index: int) -> SteppedNetwork:
        return self._networks[index]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _usable(self) -> Sequence[SteppedNetwork]:
        """Return the networks; raise RuntimeError if one is closed or has failed, before any of them changes."""
        for network in self._networks:
            network.check_usable()
        return self._networks

    def _rows(self, positions: Any) -> Sequence[Any]:
        """Return the positions for each network, None without any; raise ValueError before any network changes."""
        last = self._array if positions is None else positions
        if last is None:
            return [None] * len(self)
        copy_of_positions(last, (len(self), len(self[0].nodes), 2))
        self._array = last
        return array_of(last)  # type: ignore[return-value]  # indexing gives views, not copies

    def _bodies(self, bodies: Any) -> list[list[Any]]:
        """Return the bodies of each network and node: a number, or a tuple of numbers.

        A frame whose columns have the labels of the nodes may have them in any order.
        """
        nodes = self._networks[0].nodes
        columns = [*getattr(bodies, "columns", ())]
        if len(columns) == len(nodes) and {*columns} == {*nodes}:
            bodies = bodies[[*nodes]]
        array, size = array_of(bodies), len(nodes)
        if array.ndim not in {2, 3} or array.shape[:2] != (len(self), size) or array.dtype.kind not in "biuf":
            raise ValueError(
                f"bodies should be numbers of the shape ({len(self)}, {size}) or ({len(self)}, {size}, k)"
                f" (got {array_text(array)})"
            )
        rows: list[list[Any]] = array.tolist()
        return [[tuple(body) for body in row] for row in rows] if array.ndim == 3 else rows

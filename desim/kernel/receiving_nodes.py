"""The receiving side of a network: the records and the messages that have arrived at its nodes."""

from typing import Any

from desim.config.python_numbers import whole
from desim.kernel.core.message_body import as_sent, own_copy
from desim.kernel.core.records import Record, Table
from desim.kernel.link_layer.arrivals import Arrivals
from desim.kernel.state.inbox import Inbox
from desim.kernel.state.network_state import NetworkState


class ReceivingNodes:
    """Nodes 0 .. n - 1 with the records and messages that they have received.

    `desim.kernel.network.Network` adds the sending side. All methods raise ValueError for a node that does not exist.

    Args:
        state: the state of the network.
        arrivals: the arrivals whose outcome is not decided yet.
    """

    def __init__(self, state: NetworkState, arrivals: Arrivals):
        self._env, self._size = state.env, state.topology.size
        self._records, self._inboxes = state.records, state.inboxes
        self._arrivals, self._first_kept = arrivals, arrivals.kept.first
        self._has_mutable = False
        """Whether a record may have a mutable body, of which each reader gets its own copy."""

    def set_initial_belief(self, src: int, body: Any, stamp: int | None = None) -> None:
        """Give each node without a record of `src` an initial record, without a message.

        `body` and `stamp` are as in `Network.publish`.
        """
        if not 0 <= src < self._size:
            raise self._unknown(src)
        stamp = self._env.now if stamp is None else stamp
        self._records.set_initial_belief(Record(src, 0, stamp, self._own(body)))

    def insert(self, node: int, record: Record) -> None:
        """Insert a record received by other means than `Network.publish` into the table of a node.

        The record is ignored if the node is its source, or has this or a newer record of the same source.
        """
        if not 0 <= node < self._size:
            raise self._unknown(node)
        if record.src != node:
            self._records.relay(node, record._replace(body=self._own(record.body)))

    def latest_records(self, node: int) -> Table:
        """Return the newest received record of each other node, by source; cost O(new records + sources)."""
        if not 0 <= node < self._size:
            raise self._unknown(node)
        if self._first_kept[node] <= self._env.now:
            self._arrivals.settle_for_reader(node)
        records = self._records.latest_records(node)
        return _with_own_bodies(records) if self._has_mutable else records

    def matching(self, node: int) -> Table:
        """Return the latest records whose body satisfies the predicate; cost O(new records + matches)."""
        if not 0 <= node < self._size:
            raise self._unknown(node)
        if self._first_kept[node] <= self._env.now:
            self._arrivals.settle_for_reader(node)
        records = self._records.matching(node)
        return _with_own_bodies(records) if self._has_mutable else records

    def inbox(self, node: int, port: str = "") -> Inbox:
        """Return the inbox of a node at a port."""
        if not 0 <= node < self._size:
            raise self._unknown(node)
        return self._inboxes.at(port)[node]

    def _own(self, body: Any) -> Any:
        """Return the body of a record as it is kept: nothing outside changes it later."""
        kept = as_sent(body)
        self._has_mutable |= kept is not body
        return kept

    def _forget(self, node: int) -> None:
        """Delete the received records and the unread messages of a node."""
        self._records.forget(node)
        self._inboxes.drain(node)

    def _node(self, node: Any) -> int:
        """Return the id of a node, an integer of any kind, as an `int`.

        Raises:
            ValueError: if it is not an integer, or there is no such node.
        """
        number = node if type(node) is int else whole(node, "a node")
        if not 0 <= number < self._size:
            raise self._unknown(number)
        return number

    def _unknown(self, node: int) -> ValueError:
        """Return the error about a node that does not exist."""
        return ValueError(f"there is no node {node}: the nodes are 0 .. {self._size - 1}")


def _with_own_bodies(records: Table) -> Table:
    """Return records whose reader may change their bodies."""
    return {src: (arrival, record._replace(body=own_copy(record.body))) for src, (arrival, record) in records.items()}

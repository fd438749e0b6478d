"""The newest record of each source that has arrived at each node.

A record holds the state of its source at one time. A record whose arrival is certain needs no SimPy event. It is stored
at transmission with its arrival time; `latest_records` and `matching` ignore it until that time. A record that can
still be lost on arrival is stored when its outcome is decided (`Records.insert`, `Records.receive`).
"""

from collections.abc import Collection, Sequence

from desim.kernel.core.clock import Clock
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.records import Arrival, Predicate, Record, Table
from desim.kernel.state.own_tables import OwnTables, SharedTable

MAX_UNREAD = 2048
"""Length above which a list of unread records is merged into its table; a flat list has two items per record."""


class Records:
    """The tables of received records of all nodes.

    Args:
        env: the clock of the simulation.
        size: number of nodes.
        predicate: selects, by their bodies, the records that `matching` returns; if None, `matching` returns none.
        repeats: whether a record may be stored twice; the first arrival counts.
    """

    def __init__(self, env: Clock, size: int, predicate: Predicate | None, *, repeats: bool = False):
        self._env, self._size = env, size
        self._shared = SharedTable(predicate)
        self._own = OwnTables(size, predicate, self._shared)
        if repeats:
            self._own.relayed.update(range(size))
        self._all_but_one = -1 if repeats else size - 1  # number of receivers of a record that may be shared
        self._scheduled, self._merge_interval = 0, max(4096, size)

    def set_initial_belief(self, record: Record) -> None:
        """Give all nodes an initial record now, unless they already have a record of the same source."""
        self._shared.set_initial_belief((self._env.now, record))

    def schedule(self, record: Record, receivers: list[int], arrival: Arrival, unreached: Collection[int] = ()) -> None:
        """Store a record with its arrival times.

        The cost is O(unreached nodes) if the record is shared (`share`), else O(receivers).

        Args:
            record: newer than every record of its source that was scheduled before.
            receivers: the nodes that the record reaches.
            arrival: the arrival times, ns.
            unreached: the nodes that the record does not reach.
        """
        if not isinstance(arrival, int):
            times = arrival
        elif self.share(record, len(receivers) + len(unreached), arrival, unreached):
            return
        else:
            times = [arrival] * len(receivers)
        unread = self._own.unread
        for node, when in zip(receivers, times, strict=True):
            pending = unread[node]
            pending.append(when)  # two calls of `append` are faster than one of `extend`
            pending.append(record)
        self._note_unread()

    def share(self, record: Record, transmitted: int, arrival: int, unreached: Collection[int]) -> bool:
        """Store a record once for all nodes, as `schedule`, if it reaches most of all nodes at one instant.

        Args:
            record: as for `schedule`.
            transmitted: the number of nodes to which it was transmitted.
            arrival: its arrival time at all nodes that it reaches, ns.
            unreached: those of the nodes that it does not reach.

        Returns:
            Whether it has been stored.
        """
        if transmitted != self._all_but_one or 3 * len(unreached) > self._size:
            return False
        self._shared.schedule((arrival, record), unreached)
        if len(self._shared.waiting) > MAX_UNREAD:
            self._shared.apply_arrived(self._env.now)
        return True

    def relay(self, node: int, record: Record) -> None:
        """Store a record that a node has received by other means than a scheduled arrival; see `insert`."""
        self._own.relayed.add(node)
        self.insert([node], record)

    def insert(self, nodes: list[int], record: Record) -> None:
        """Store a transmitted record at nodes now; a node that has this or a newer record of its source ignores it."""
        now, unread = self._env.now, self._own.unread
        for node in nodes:
            unread[node] += now, record
        self._own.out_of_order.update(nodes)
        self._note_unread()

    def receive(self, nodes: list[int], times: list[int], records: Sequence[Record]) -> None:
        """Store transmitted records, in any order: record k reached node `nodes[k]` at `times[k]`, ns; see `insert`."""
        unread = self._own.unread
        for node, when, record in zip(nodes, times, records, strict=True):
            pending = unread[node]
            pending.append(when)
            pending.append(record)
        self._own.out_of_order.update(nodes)
        self._note_unread(len(nodes))

    def latest_records(self, node: int) -> Table:
        """Return the newest received record of each other node, by source; cost O(new records + sources)."""
        self._apply_arrived(node)
        own, shared = self._own.tables[node], self._shared
        if not shared.table:
            return own.copy()
        known = shared.table_of(node)
        if own:
            known |= own if shared.only_initial else self._not_older_than_shared(node, own)
        return known

    def matching(self, node: int) -> Table:
        """Return the latest records whose body satisfies the predicate; cost O(new records + matches)."""
        self._apply_arrived(node)
        own, matching, shared = self._own.tables[node], self._own.matching[node], self._shared
        if not shared.table:
            return matching.copy()
        known = shared.matching_of(node)
        if own:
            known = {src: each for src, each in known.items() if src not in own or own[src][1].seq < each[1].seq}
            known |= self._not_older_than_shared(node, matching)
        return known

    def forget(self, node: int) -> None:
        """Delete all records that a node has received, initial beliefs included."""
        self._apply_arrived(node)
        self._shared.forget(node)
        self._own.forget(node)

    def in_flight(self) -> int:
        """Return the number of records in flight, counted once per receiver."""
        now = self._env.now
        shared = [record for arrival, record in self._shared.waiting if arrival > now]
        not_arrived = portable_sum(self._size - 1 - self._shared.unreached(record) for record in shared)
        return self._own.in_flight(now) + not_arrived

    def _apply_arrived(self, node: int) -> None:
        """Move arrived records to the shared table and to the table of a node."""
        if self._shared.waiting:
            self._shared.apply_arrived(self._env.now)
        own = self._own
        if own.unread[node] or node in own.still_in_flight:
            own.merge(node, self._env.now)

    def _not_older_than_shared(self, node: int, own: Table) -> Table:
        """Return the records of a node's own table that are not older than its record in the shared table."""
        shared = self._shared.table_of(node) if node in self._shared.exceptions else self._shared.table
        return {src: each for src, each in own.items() if src not in shared or each[1].seq >= shared[src][1].seq}

    def _note_unread(self, count: int = 1) -> None:
        """Now and then, merge long lists of unread records, to bound the memory of nodes that do not read."""
        self._scheduled += count
        if self._scheduled >= self._merge_interval:
            self._scheduled, now = 0, self._env.now
            self._shared.apply_arrived(now)
            for node, unread in enumerate(self._own.unread):
                if len(unread) > MAX_UNREAD:
                    self._own.merge(node, now)

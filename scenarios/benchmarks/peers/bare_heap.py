"""Deliver the broadcasts of a workload in a bare loop over a heap, with one entry per broadcast and no simulator.

The nodes take turns: at each turn, one node reads its messages and broadcasts (see `workloads`). Each pass
of the loop is one turn, except the last, which is at the end of the run. A pass delivers the messages that have arrived
since the previous pass, and then sends the broadcast of its turn. The last pass sends a broadcast that never arrives.
Nodes read only at turns. A pass therefore takes the broadcast at the top of the heap and writes all its arrivals until
now at once. If later arrivals of this broadcast remain, it goes back into the heap with the time of the next arrival.
"""

from heapq import heappop, heappush, heapreplace

from desim.kernel.models.latency import Constant
from scenarios.benchmarks.peers.workloads import TICK, Arrivals, Outcome, Table, Workload


class BareHeap:
    """The loop over the turns of a workload."""

    def __init__(self, workload: Workload):
        self.work = workload
        self.tables: list[Table] = [{} for _ in range(workload.size)]
        self.reached = [[self.tables[node] for node in neighbours] for neighbours in workload.neighbours()]
        self.times = [*(number * TICK for number in range(workload.turns)), workload.end]
        self.delivered = 0

    def run(self) -> None:
        """Run to the end; the benchmark times this call."""
        latency = self.work.latency
        if isinstance(latency, Constant):
            self.together(latency.value)
        else:
            self.one_by_one()

    def together(self, latency: float) -> None:
        """Deliver broadcasts that all have the same latency, s; their messages cannot overtake each other."""
        heap: list[tuple[float, int, list[Table]]] = []
        size, reached, delivered = self.work.size, self.reached, 0
        for turn, now in enumerate(self.times):
            while heap and heap[0][0] <= now:
                _, number, tables = heappop(heap)
                src = number % size
                for table in tables:
                    table[src] = number
                delivered += len(tables)
            heappush(heap, (now + latency, turn, reached[turn % size]))  # the last broadcast stays in flight
        self.delivered = delivered

    def one_by_one(self) -> None:
        """Deliver broadcasts with a different latency for each receiver."""
        heap: list[tuple[float, int, int, zip[tuple[float, int]]]] = []
        size, tables, arrivals, delivered = self.work.size, self.tables, Arrivals(self.work), 0
        for turn, now in enumerate(self.times):
            while heap and heap[0][0] <= now:
                _, number, node, later = heap[0]
                src, table = number % size, tables[node]
                if table.get(src, -1) < number:
                    table[src] = number
                delivered += 1
                for when, node in later:
                    if when > now:
                        heapreplace(heap, (when, number, node, later))
                        break
                    table = tables[node]
                    if table.get(src, -1) < number:
                        table[src] = number
                    delivered += 1
                else:
                    heappop(heap)
            later = arrivals(turn % size, now)
            when, node = next(later)
            heappush(heap, (when, turn, node, later))
        self.delivered = delivered

    def outcome(self) -> Outcome:
        """Return the outcome of the run."""
        return Outcome(self.delivered, self.tables)

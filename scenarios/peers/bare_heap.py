"""The broadcasts of a workload in a bare loop over a heap, with one entry per broadcast: no simulator at all.

A turn is a pass of the loop. Between two turns nobody reads, so a broadcast that comes to the top of the heap enters in
the tables of its receivers all that arrives before the next turn, and goes back to wait for its next arrival.
"""

from heapq import heappop, heappush, heapreplace

from desim.kernel.latency import Constant
from scenarios.peers.workloads import TICK, Arrivals, Outcome, Table, Workload


class BareHeap:
    """The loop."""

    def __init__(self, workload: Workload):
        self.work = workload
        self.tables: list[Table] = [{} for _ in range(workload.size)]
        self.reached = [[self.tables[node] for node in each] for each in workload.neighbours()]
        self.times = [*(number * TICK for number in range(workload.turns)), workload.end]
        self.delivered = 0

    def run(self) -> None:
        """Run to the end; this is what is timed."""
        latency = self.work.latency
        if isinstance(latency, Constant):
            self.together(latency.value)
        else:
            self.one_by_one()

    def together(self, latency: float) -> None:
        """Deliver broadcasts that reach all receivers after the same latency (s); nothing overtakes."""
        heap: list[tuple[float, int, list[Table]]] = []
        size, reached, delivered = self.work.size, self.reached, 0
        for turn, now in enumerate(self.times):
            while heap and heap[0][0] <= now:
                _, number, tables = heappop(heap)
                src = number % size
                for table in tables:
                    table[src] = number
                delivered += len(tables)
            heappush(heap, (now + latency, turn, reached[turn % size]))  # after the end, one that nobody hears
        self.delivered = delivered

    def one_by_one(self) -> None:
        """Deliver broadcasts that reach each receiver after a latency of its own."""
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
        """Return what the run came to."""
        return Outcome(self.delivered, self.tables)

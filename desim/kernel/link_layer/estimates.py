"""Estimates of the delays and the density of a network, from which protocols derive their time-outs."""

from functools import cached_property
from typing import Any

from desim.kernel.core.message_size import size_of
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.models.medium import Medium, Radio, airtime_of
from desim.kernel.topology.topology import Topology


class Estimates:
    """Estimates of the properties of one network.

    Args:
        topology: the links of the graph, and which of them are within range.
        medium: the model of the medium.
        sampler: estimates latencies.
    """

    def __init__(self, topology: Topology, medium: Medium, sampler: LinkSampler):
        self._topology, self._medium, self._sampler = topology, medium, sampler
        self._sending_times: dict[int, float] = {}
        """By size, the results of `sending_time`, which protocols ask for again and again."""

    @cached_property
    def mean_degree(self) -> float:
        """The mean number of neighbours of a node at the first access; later accesses return the same number."""
        return self._topology.mean_degree

    @cached_property
    def latency(self) -> float:
        """An estimate of the mean one-way latency, s, with processing delays but without airtime and queueing."""
        return self._sampler.typical_latency()

    def airtime(self, body: Any) -> float:
        """Return the longest airtime, s, of a message with this body."""
        return airtime_of(self._medium, size_of(body), self._topology.size)

    def interval(self, body: Any) -> float:
        """Return the `sending_time`, s, of a message with this body."""
        return self.sending_time(size_of(body))

    def sending_time(self, size: int) -> float:
        """Return the time, s, for which a message of a size, bytes, keeps its sender from sending the next one."""
        if size not in self._sending_times:
            medium, nodes = self._medium, self._topology.size
            # With a silence after the frame (duty cycle), or a wait for the next slot, it is longer than the airtime.
            self._sending_times[size] = (
                medium.interval(size, nodes) if isinstance(medium, Radio) else airtime_of(medium, size, nodes)
            )
        return self._sending_times[size]

"""The receivers of a transmission, and the losses that are known when it starts."""

from itertools import compress
from typing import TYPE_CHECKING

from desim.kernel.core.events import Cause
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.state.network_state import NetworkState
from desim.kernel.state.transmission import Transmission

if TYPE_CHECKING:
    from collections.abc import Callable

ACKNOWLEDGEMENT_SIZE = 14
"""Size of an acknowledgement of IEEE 802.11, bytes; its airtime is `CsmaCa.ack`."""


class Departure:
    """Draws the losses of the transmissions that start.

    Args:
        state: the state of the network.
        sampler: draws losses.
        checks_range: whether a receiver must be within range when a transmission starts.

    Attributes:
        receivers: returns the receivers of a new broadcast, ascending, given its sender and number.
    """

    def __init__(self, state: NetworkState, sampler: LinkSampler, *, checks_range: bool):
        self._env, self._fault_state = state.env, state.fault_state
        self._topology = topology = state.topology
        self._sampler, self._checks_range = sampler, checks_range and not topology.is_static
        self.receivers: Callable[[int, int], list[int]] = (
            topology.hearers if checks_range else lambda src, _: topology.linked(src)
        )

    def reachable(self, src: int, dst: int, number: int) -> bool:
        """Return whether a new message to one node can reach it."""
        topology = self._topology
        return topology.are_linked(src, dst) and (not self._checks_range or topology.reaches(src, [dst], number)[0])

    def losses(self, transmission: Transmission) -> dict[int, Cause]:
        """Draw the losses of a transmission at its start; return the cause of each loss by receiver."""
        src, receivers, causes = transmission.src, transmission.receivers, self._drawn(transmission)
        has_waited = transmission.created < self._env.now
        if has_waited and self._checks_range:  # its receivers were within range when it was created, and may have moved
            reaches = self._topology.reaches(src, receivers, transmission.number)
            causes |= {node: "out_of_range" for node, reached in zip(receivers, reaches, strict=True) if not reached}
        return causes if transmission.reachable else dict.fromkeys(receivers, "out_of_range")

    def attempt(self, transmission: Transmission, draw: int) -> Cause | None:
        """Return the cause if an attempt to transmit to one node, which ends now, is lost; `draw` numbers its draws."""
        (node,), faults = transmission.receivers, self._fault_state
        if faults is not None and (down := faults.down_cause(node) or faults.down_cause(transmission.src)) is not None:
            return down
        if faults is not None and (jammed := faults.jammed([node], self._env.now)) is not None and jammed[0]:
            return jammed[0]
        src, topology = transmission.src, self._topology
        if not (topology.are_linked(src, node) and topology.reaches(src, [node], draw)[0]):
            return "out_of_range"
        return self._drawn(transmission).get(node)

    def acknowledgement(self, transmission: Transmission, draw: int) -> Cause | None:
        """Return the cause if the acknowledgement of a transmission to one node is lost; see `attempt`."""
        (node,) = transmission.receivers
        acknowledgement = transmission._replace(src=node, receivers=[transmission.src], size=ACKNOWLEDGEMENT_SIZE)
        return self.attempt(acknowledgement, draw)

    def _drawn(self, transmission: Transmission) -> dict[int, Cause]:
        """Draw the random losses, and add those by partitions and interceptions; return each cause by receiver."""
        src, receivers = transmission.src, transmission.receivers
        causes: dict[int, Cause] = {}
        lost = self._sampler.losses(src, receivers, self._env.now, transmission.size)
        if lost is not None and True in lost:
            causes = {node: self._sampler.cause(src, node) for node in compress(receivers, lost)}
        faults = self._fault_state
        if faults is not None and (separated := faults.separated(src, receivers)) is not None:
            causes |= {node: cause for node, cause in zip(receivers, separated, strict=True) if cause is not None}
        if faults is not None:
            causes |= faults.intercepted(transmission.number)
        return causes

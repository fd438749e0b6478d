"""Delivery: the arrivals of a transmission at the nodes that it reaches.

Records and messages whose arrival is certain at transmission are stored at once, with their arrival times. An arrival
is not certain if a fault, a range check on arrival or half duplex can still prevent it;
`desim.kernel.link_layer.arrivals` then decides it when it is due.

A range check cannot prevent an arrival as long as, at the bounded speed of the nodes, no receiver can have crossed the
border of the sender's range (`desim.kernel.topology.kept_receivers`). With lognormal latencies and 40 nodes that stay
far within range, a run takes 0.4 of the time that it takes with decisions on arrival.

With planned faults, an arrival at a node that is up is certain if it is due before the next fault begins or ends. The
exception is a jamming disc: nodes may move into it.

Kept equal to decisions on arrival by
`tests/kernel/test_contract.py::test_planned_faults_are_observationally_equal_to_decisions_on_arrival`.
"""

from collections.abc import Callable, Collection, Mapping
from itertools import compress

from desim.kernel.core.events import Cause
from desim.kernel.core.records import Arrival, Record, per_receiver
from desim.kernel.link_layer.arrivals import Arrivals
from desim.kernel.models.links import Links
from desim.kernel.state.network_state import NetworkState
from desim.kernel.state.transmission import Transmission


class MessageDelivery:
    """Schedules the arrivals of transmissions in the records and inboxes of their receivers.

    Args:
        state: the state of the network; its records and inboxes receive what arrives.
        links: the models of the links.
        arrivals: the arrivals whose outcome is not certain at transmission.
        contends: whether nodes contend for the medium.

    Attributes:
        arrivals: as given.
        is_certain: whether each arrival is certain when it is scheduled.
    """

    def __init__(self, state: NetworkState, links: Links, arrivals: Arrivals, *, contends: bool):
        self._records, self._inboxes, self._fault_state = state.records, state.inboxes, state.fault_state
        self._topology, self.arrivals = state.topology, arrivals
        self._checks_range = links.range_check != "send"
        # If nodes contend, arrivals are scheduled at the end of a frame, and a fault may have begun since its losses
        # were drawn. If not, half duplex loses a message at a receiver that transmits when it arrives.
        self._decides_on_arrival = state.fault_state is not None if contends else links.medium.half_duplex
        self.is_certain = not (self._checks_range or self._decides_on_arrival) and state.fault_state is None

    def in_flight(self) -> int:
        """Return the number of messages in flight, after all arrivals up to now have been decided."""
        self.arrivals.settle_for_reader()
        self.arrivals.count_losses()
        return self.arrivals.in_flight() + self._records.in_flight() + self._inboxes.in_flight()

    def schedule(
        self,
        transmission: Transmission,
        reached: list[int],
        arrival: Arrival,
        causes: Mapping[int, Cause],
        airtime: int,
    ) -> None:
        """Schedule the arrivals of a transmission.

        Args:
            transmission: the transmission.
            reached: the nodes that it reaches.
            arrival: the arrival times at these nodes, ns.
            causes: the causes of the losses up to now, by receiver.
            airtime: the airtime that begins now, ns.
        """
        content = transmission.content
        if self._decides_on_arrival:
            self.arrivals.schedule(transmission, reached, arrival, airtime)
            return
        if self._checks_range:
            reached, arrival = self._in_range(transmission, reached, arrival, airtime)
            if not reached:
                return
        unreached: Collection[int] = causes
        if self._fault_state is not None:
            reached, arrival, down = self._not_blocked(transmission, reached, arrival, airtime)
            unreached = {*causes, *down}
        if isinstance(content, Record):
            self._records.schedule(content, reached, arrival, unreached)
        elif reached:
            self._inboxes.deliver(content, transmission.port, reached, arrival, transmission.number)

    def _in_range(
        self, transmission: Transmission, reached: list[int], arrival: Arrival, airtime: int
    ) -> tuple[list[int], Arrival]:
        """Return the receivers that will certainly be within range at their arrival times (ns), and these times.

        The other arrivals are scheduled, and decided when they are due. Arrivals at one instant share one event: if one
        of them is uncertain, all are decided then.

        Kept equal to arrivals that are all decided when they are due by
        `tests/kernel/test_contract.py::test_arrivals_certain_to_be_in_range_are_observationally_equal_to_decisions`.
        """
        within, until = self._topology.steady_receivers(transmission.src)
        last = arrival if isinstance(arrival, int) else max(arrival, default=0)
        if last < until and within.issuperset(reached):
            return reached, arrival
        uncertain, uncertain_times = reached, arrival
        if isinstance(arrival, int) or min(arrival, default=0) >= until:
            reached, arrival = [], []
        else:
            reached, arrival, uncertain, uncertain_times = _split(
                reached, arrival, lambda node, when: when < until and node in within
            )
        self.arrivals.schedule(transmission, uncertain, uncertain_times, airtime)
        return reached, arrival

    def _not_blocked(
        self, transmission: Transmission, reached: list[int], arrival: Arrival, airtime: int
    ) -> tuple[list[int], Arrival, list[int]]:
        """Return the receivers that certainly get a transmission, its arrival times (ns), and those that are down.

        Before the next change of the faults, an arrival succeeds if and only if the radio of the receiver is up now.
        Later arrivals are scheduled, and decided when they are due.
        """
        assert self._fault_state is not None
        until, down = self._fault_state.constant_until, self._fault_state.down_nodes
        # Late arrivals are scheduled first, because a receiver that is down now may be up when they are due.
        if (arrival if isinstance(arrival, int) else max(arrival, default=0)) >= until:
            reached, arrival, late, late_times = _split(reached, arrival, lambda _, when: when < until)
            self.arrivals.schedule(transmission, late, late_times, airtime)
        lost: list[int] = []
        if down:
            reached, arrival, lost, loss_times = _split(reached, arrival, lambda node, _: node not in down)
            self.arrivals.lose_at(transmission, lost, loss_times)
        return reached, arrival, lost


def _split(
    nodes: list[int], arrival: Arrival, holds: Callable[[int, int], bool]
) -> tuple[list[int], Arrival, list[int], Arrival]:
    """Return the nodes for which a predicate of node and arrival time holds, with their times, and the other nodes."""
    holding = [holds(node, when) for node, when in zip(nodes, per_receiver(arrival, len(nodes)), strict=True)]
    not_holding = [not is_holding for is_holding in holding]
    parts: list[list[int]] = [list(compress(nodes, holding)), list(compress(nodes, not_holding))]
    if isinstance(arrival, int):
        return parts[0], arrival, parts[1], arrival
    return parts[0], list(compress(arrival, holding)), parts[1], list(compress(arrival, not_holding))

"""The losses that faults, distance and half duplex cause on arrival.

The losses that are known when a transmission starts are drawn by `desim.kernel.link_layer.departure`.
"""

from collections.abc import Iterator, Sequence
from itertools import repeat

import numpy as np

from desim.config.arrays import Integers
from desim.kernel.channel.transmitter import Transmitter
from desim.kernel.core.events import Cause
from desim.kernel.state.network_state import NetworkState
from desim.kernel.state.transmission import Flight


class ArrivalLosses:
    """Decides which arrivals are lost.

    Args:
        state: the state of the network.
        transmitter: knows which nodes transmit, for half duplex; None: nodes transmit without airtime, or contend.
        processing: processing delay of a message at sender and receiver together, ns.
        checks_range: whether a receiver must be within range on arrival.
    """

    def __init__(
        self,
        state: NetworkState,
        transmitter: Transmitter | None,
        *,
        processing: int,
        checks_range: bool,
    ):
        self._env, self._topology, self._fault_state = state.env, state.topology, state.fault_state
        self._transmitter, self._processing, self._checks_range = transmitter, processing, checks_range
        self._on_air: dict[int, tuple[list[int], int]] = {}
        """By sender: the numbers of its last transmission and of its copies, and the end of the airtime, ns."""
        self._cut_short: dict[int, Cause] = {}
        """By number, the cause of the loss of each transmission, or copy, whose sender crashed while it transmitted."""

    def start(self, flight: Flight) -> None:
        """Note that a transmission with an airtime starts now, or a copy of one that its sender has just started."""
        transmission, airtime = flight
        numbers, end = self._on_air.get(transmission.src, ([], 0))
        if end <= self._env.now:  # if not, it is a copy, because a node transmits one message at a time
            numbers, end = [], self._env.now + airtime
        numbers.append(transmission.number)
        self._on_air[transmission.src] = numbers, end

    def crash(self, node: int, cause: Cause) -> None:
        """Note that the radio of a node goes down now: its transmission on the air, if any, is lost on arrival."""
        numbers, end = self._on_air.get(node, ((), 0))
        if self._env.now < end:
            self._cut_short |= dict.fromkeys(numbers, cause)

    def causes(self, nodes: list[int], times: int | list[int], flights: Flight | list[Flight]) -> dict[int, Cause]:
        """Return the cause of the loss of each of k arrivals that is lost, by its index.

        If an arrival has several causes, the last in this order counts: half duplex, range, jamming, partition, crash.

        Args:
            nodes: (k,) the receivers.
            times: the times of the arrivals, ns: now for all, or (k,).
            flights: the transmission that arrives at all of them now, or (k,).
        """
        causes: dict[int, Cause] = {}
        if self._transmitter is not None:
            causes = dict.fromkeys(self._while_transmitting(nodes, times, flights), "half_duplex")
        if not self._checks_range and self._fault_state is None:
            return causes
        src: int | Integers
        number: int | Integers
        when: int | Integers
        if isinstance(flights, Flight):
            src, number, when = flights.transmission.src, flights.transmission.number, self._env.now
        else:
            src = np.array([transmission.src for transmission, _ in flights])
            number = np.array([transmission.number for transmission, _ in flights])
            when = np.array(times)
        losses: list[Sequence[Cause | None] | None] = []
        if self._checks_range:
            reached = self._topology.reaches(src, nodes, number, None if isinstance(when, int) else when)
            if False in reached:
                losses.append([None if in_range else "out_of_range" for in_range in reached])
        if (faults := self._fault_state) is not None:
            losses += [faults.jammed(nodes, when), faults.separated(src, nodes), self._crashed(nodes, number)]
        for lost in losses:
            if lost is not None:
                causes |= {k: cause for k, cause in enumerate(lost) if cause is not None}
        return causes

    def _while_transmitting(
        self, nodes: list[int], times: int | list[int], flights: Flight | list[Flight]
    ) -> Iterator[int]:
        """Yield the index of each arrival whose receiver transmitted during the reception; see `causes`."""
        assert self._transmitter is not None
        lag = self._processing  # a reception ends this long before the arrival
        earliest, latest = (times, times) if isinstance(times, int) else (min(times), max(times))
        transmissions = self._transmitter.during(set(nodes), earliest - lag, latest - lag)
        if not transmissions:
            return
        for k in [k for k, node in enumerate(nodes) if node in transmissions]:
            end = (times if isinstance(times, int) else times[k]) - lag
            flight = flights if isinstance(flights, Flight) else flights[k]
            if any(begin < end < until + flight.airtime for begin, until in transmissions[nodes[k]]):
                yield k

    def _crashed(self, nodes: list[int], number: int | Integers) -> list[Cause | None] | None:
        """Return (k,) causes: of the crash of a receiver, or of a sender while it transmitted; None: no such crash."""
        assert self._fault_state is not None
        down_cause, cut_short = self._fault_state.down_cause, self._cut_short
        if not self._fault_state.down_nodes and not cut_short:
            return None
        numbers = repeat(number) if isinstance(number, int) else number.tolist()
        return [down_cause(node) or cut_short.get(number) for node, number in zip(nodes, numbers, strict=False)]

"""The counts of the messages of a network, and their events in the trace."""

from collections import Counter
from collections.abc import Iterator, Mapping

from desim.kernel.core.clock import Clock
from desim.kernel.core.events import LOST, Broadcast, Cause, Event, Lost, MessageCounts, Queued, Sent, Trace
from desim.kernel.core.records import Arrival, Record, per_receiver
from desim.kernel.state.transmission import Transmission


class MessageLog:
    """Counts messages, and appends their events to the trace.

    Args:
        env: the clock of the simulation.
        trace: receives the events; None if they are not needed.

    Attributes:
        sent: number of messages, one for each receiver of a transmission.
    """

    def __init__(self, env: Clock, trace: Trace | None):
        self._env, self._trace = env, trace
        self.sent = self._transmissions = self._bytes_sent = 0
        self._lost: Counter[Cause] = Counter()

    def queue(self, transmission: Transmission) -> None:
        """Record that a transmission waits at its host, for its transmitter, or for the channel."""
        if self._trace is not None:
            number, src, _, size, receivers, *_ = transmission
            self._trace.append_message(Queued(self._env.now, number, src, tuple(receivers), size))

    def start(self, transmission: Transmission) -> None:
        """Count the start of a transmission, or of an attempt of it."""
        self._transmissions += 1
        self._bytes_sent += transmission.size

    def leave(self, transmission: Transmission, causes: Mapping[int, Cause], arrival: Arrival) -> None:
        """Append a transmission with the times of its arrivals, ns, and the receivers for which it is already lost."""
        assert self._trace is not None
        for event in _events(transmission, causes, arrival, self._env.now):
            self._trace.append_message(event)

    def lose(self, transmission: Transmission, causes: Mapping[int, Cause]) -> None:
        """Count and record losses of a transmission now, given the cause of each loss by receiver."""
        for cause in causes.values():  # faster than `Counter.update` for up to a dozen losses
            self._lost[cause] += 1
        if self._trace is not None:
            for node, cause in causes.items():
                self._trace.append_message(Lost(self._env.now, transmission.number, transmission.src, node, cause))

    def give_up(self, transmission: Transmission, cause: Cause = "queue") -> None:
        """Count and record that all messages of a transmission are lost now."""
        self.lose(transmission, dict.fromkeys(transmission.receivers, cause))

    def counts(self, in_flight: int, utilisation: float) -> MessageCounts:
        """Return all counts up to now, given the number of messages in flight and the utilisation of the channels."""
        lost = self._lost.total()
        by_cause = {cause: self._lost[cause] for cause in sorted(+self._lost)}  # + drops causes without losses
        fates = self.sent, self.sent - lost - in_flight, lost, in_flight
        return MessageCounts(self._env.now, *fates, by_cause, self._transmissions, self._bytes_sent, utilisation)


def _events(transmission: Transmission, causes: Mapping[int, Cause], arrival: Arrival, now: int) -> Iterator[Event]:
    """Yield the events of a transmission in the trace; a message lost at transmission has the arrival time `LOST`."""
    number, src, created, size, receivers, content = transmission[:6]
    fates = arrival
    if causes:
        arrivals = iter(per_receiver(arrival, len(receivers)))
        fates = [LOST if node in causes else next(arrivals) for node in receivers]
    if isinstance(content, Record):
        fate = (fates,) * bool(receivers) if isinstance(fates, int) else tuple(fates)
        yield Broadcast(now, number, src, content.seq, tuple(receivers), fate, created, size, content.body)
        return
    for node, arrives in zip(receivers, per_receiver(fates, len(receivers)), strict=True):
        yield Sent(now, number, src, node, arrives, created, size, content.body)

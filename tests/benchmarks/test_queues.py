"""Time of messages that wait or are in flight, by their number: twice as many should take twice as long."""

import gc

import networkx as nx
import pytest

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.units import SECOND
from desim.kernel.models.latency import Uniform
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Bitrate
from desim.kernel.network import Network

GAP = 0.001
"""Time between two messages of `TRICKLES`, s."""
BURSTS = {
    "queue": Links(medium=Bitrate(bitrate=1e6)),
    "limited queue": Links(medium=Bitrate(bitrate=1e6, queue_limit=500.0)),
    "shared queue": Links(medium=Bitrate(bitrate=1e6, shared=True)),
    "limited shared queue": Links(medium=Bitrate(bitrate=1e6, shared=True, queue_limit=500.0)),
    "half duplex": Links(medium=Bitrate(bitrate=1e6, half_duplex=True)),
}
"""Links over which all messages are sent at once."""
TRICKLES = {"in flight": Links(latency=Uniform(low=0.0, high=50.0))}
"""Links over which a message is sent after the other, and read on arrival."""


def ready(links, number, gap):
    """Return a clock at which a number of messages between two nodes wait to be sent, and the network."""
    clock = Clock()
    network = Network(clock, nx.complete_graph(2), links)

    def send():
        for k in range(number):
            network.send(k % 2, 1 - k % 2, None, size=100)
            if gap:
                yield Instant(clock, clock.now + round(gap * SECOND), Phase.DECISION)
        yield clock.timeout(0)

    def read(node):
        while True:
            yield network.inbox(node).arrival()
            network.inbox(node).drain()

    clock.process(send())
    for node in range(2):
        clock.process(read(node))
    return clock, network


@pytest.mark.parametrize("number", [1000, 2000, 4000, 8000])
@pytest.mark.parametrize("name", [*BURSTS, *TRICKLES])
def test_messages_that_wait(benchmark, name, number):
    benchmark.group = name
    links, gap = (BURSTS[name], 0.0) if name in BURSTS else (TRICKLES[name], GAP)

    def setup():
        clock, network = ready(links, number, gap)
        gc.collect()
        return (clock, network), {}

    def run(clock, network):
        clock.run(until=200 * SECOND)
        counts = network.message_counts()
        assert counts.delivered + counts.lost == counts.sent == number

    benchmark.pedantic(run, setup=setup, rounds=3)

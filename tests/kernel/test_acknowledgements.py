"""Acknowledgements that can be lost, the extended interframe space, and hidden nodes, against a simulation of plain loops."""

from dataclasses import replace
from math import sqrt

import networkx as nx
import numpy as np
import pytest

from desim.kernel.access import CsmaCa
from desim.kernel.clock import Clock
from desim.kernel.links import Links
from desim.kernel.medium import Bitrate
from desim.kernel.network import Network
from desim.kernel.units import SECOND
from tests.kernel.dcf import Timing, saturated

TIMING = Timing()


def access(timing, **changes):
    """Return the access model with the times of a reference."""
    times = {key: getattr(timing, key) * 1e-6 for key in ("slot", "sifs", "difs", "ack", "ack_timeout", "eifs")}
    counts = {key: getattr(timing, key) for key in ("window", "doublings", "retries")}
    return CsmaCa(**times | counts | changes)


def of_desim(graph, flows, horizon, seed, model, airtime=300, **links):
    """Return the messages that each flow delivers, and the number of attempts, in a time of `horizon` us."""
    clock, delivered = Clock(), dict.fromkeys(flows, 0)
    medium = Bitrate(bitrate=8e6, access=model)
    net = Network(clock, graph, Links(medium=medium, **links), seed=seed)

    def feed(src, dst):
        """Keep two messages in the queue of a node."""
        net.send(src, dst, src, size=airtime)
        while True:
            net.send(src, dst, src, size=airtime)
            yield net.inbox(dst, "").arrival(0)
            for message in net.inbox(dst, "").drain():
                delivered[message.body] += 1

    for src, dst in flows.items():
        for _ in range(400):
            net.send(src, dst, src, size=airtime)
    clock.run(until=horizon * 1000)
    for src, dst in flows.items():
        for message in net.inbox(dst, "").drain():
            delivered[message.body] += 1
    return delivered, net.message_counts()

"""Steps of a `SteppedNetwork` per second: twenty nodes that all hear each other, and a thousand with radios."""

import numpy as np
import pytest

from desim import Links, Lognormal, SteppedNetwork

LATENCY = Lognormal(mean=0.05, cv=0.5)
STEPS = 100


def send(network, step):
    for node in network.nodes:
        network.send(node, None, step)


def publish(network, step):
    for node in network.nodes:
        network.publish(node, step)


def read(network, step):
    publish(network, step)
    for node in network.nodes:
        network.latest(node)


WAYS = {"send": send, "publish": publish, "publish and read": read}


@pytest.mark.parametrize("way", WAYS)
def test_twenty_nodes_at_50_hz(benchmark, way):
    """The time of 100 steps; below 0.067 s with `send`, and 0.05 s with `publish`, on one core."""

    def steps():
        with SteppedNetwork(20, Links(latency=LATENCY), seed=1) as network:
            for step in range(STEPS):
                WAYS[way](network, step)
                network.step(0.02)

    benchmark.pedantic(steps, rounds=5)


@pytest.mark.parametrize("degree", [10, 31, 100])
@pytest.mark.parametrize("way", WAYS)
def test_a_thousand_moving_nodes_at_10_hz(benchmark, way, degree):
    """The time of a simulated second, by the mean number of neighbours."""
    benchmark.group = f"a thousand nodes, {way}"
    rng, side = np.random.default_rng(0), 10.0 * np.sqrt(1000 * np.pi / degree)
    start, velocity = rng.uniform(0.0, side, (1000, 2)), rng.normal(0.0, 1.0, (1000, 2))

    def second():
        links = Links(latency=LATENCY, range=10.0)
        with SteppedNetwork(1000, links, seed=1, positions=start) as network:
            for step in range(10):
                WAYS[way](network, step)
                network.step(0.1, start + velocity * 0.1 * (step + 1))

    benchmark.pedantic(second, rounds=3)

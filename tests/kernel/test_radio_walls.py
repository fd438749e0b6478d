"""Radio through walls: ranges, channels with interference, carrier sense, and networks whose nodes move."""

from math import inf, log10

import networkx as nx
import numpy as np
import pytest
from scipy.stats import norm

from desim.kernel.core.clock import Clock
from desim.kernel.core.events import Broadcast, Trace
from desim.kernel.core.positions import PositionSource
from desim.kernel.core.units import SECOND
from desim.kernel.models.access import Aloha, Csma
from desim.kernel.models.graphs import Complete
from desim.kernel.models.interference import CaptureEffect, LoRaInterference, Sinr
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Bitrate, LoRa
from desim.kernel.models.reception import RECEPTION_MODELS, Disk, LogDistance, Nakagami, QuasiUnitDisk, Rice
from desim.kernel.network import Network
from desim.kernel.stepped_network import SteppedNetwork
from desim.kernel.topology.radio_walls import RadioWalls, range_factor
from desim.kernel.topology.topology import Topology
from desim.kernel.walls.wall import Wall

MODELS = {"disk": Disk(), "quasi": QuasiUnitDisk(), "log": LogDistance(), "nakagami": Nakagami(), "rice": Rice()}


def wall(loss=inf, at=1.0):
    """Return a wall across the x axis."""
    return Wall(line=[[at, -1000.0], [at, 1000.0]], loss=loss)


class Places(PositionSource):
    """Positions that a test sets; `max_speed` 0 promises that it does not."""

    def __init__(self, places, max_speed=inf):
        self.places, self.max_speed = np.array(places, dtype=float), max_speed

    def __call__(self):
        return self.places


def line(*xs):
    return [[x, 0.0] for x in xs]


# Ranges.


@pytest.mark.parametrize(("exponent", "factor"), [(3.0, 0.6012), (2.0, 0.4661)])
def test_a_wall_shortens_the_range_of_a_disk(exponent, factor):
    """A brick wall of 24 cm, 6.63 dB at 2.4 GHz: 10^(-A / (10 n))."""
    assert range_factor(6.63, exponent) == pytest.approx(factor, abs=5e-5)
    places = Places(line(0.0, 10.0 * factor - 0.01, 10.0 * factor + 0.01, 9.99))
    topology = Topology(nx.complete_graph(4), 10.0, places, Disk(exponent=exponent), walls=[wall(6.63)])
    assert topology.neighbours(0).tolist() == [1]
    assert Topology(nx.complete_graph(4), 10.0, places, walls=[]).neighbours(0).tolist() == [1, 2, 3]


@pytest.mark.parametrize("name", MODELS)
def test_a_lossy_wall_stands_for_a_longer_distance_in_every_model(name):
    model, rng = MODELS[name], np.random.default_rng(2)
    places = rng.uniform(-10.0, 10.0, size=(30, 2))
    walls = [wall(4.0, at=0.0), wall(3.0, at=2.0)]
    graph = nx.complete_graph(30)
    topology = Topology(graph, 9.0, lambda: places, model, walls=walls, seed=1)
    exponent = getattr(model, "exponent", 3.0)
    for node in range(0, 30, 7):
        loss = 4.0 * (places[:, 0] * places[node, 0] < 0.0) + 3.0 * ((places[:, 0] > 2.0) != (places[node, 0] > 2.0))
        apart = np.hypot(*(places - places[node]).T) * 10.0 ** (loss / (10.0 * exponent))
        others = np.delete(np.arange(30), node)
        elsewhere = np.zeros((30, 2))
        elsewhere[:, 0] = apart
        free = Topology(graph, 9.0, lambda at=elsewhere: at, model, seed=1)
        assert topology.neighbours(node).tolist() == free.neighbours(node).tolist()
        assert topology.reaches(node, others.tolist()) == free.reaches(node, others.tolist())
    assert name == "disk" or Topology(graph, 9.0, lambda: places, model, seed=1).mean_degree > topology.mean_degree


def test_every_kind_of_reception_has_an_exponent_for_walls():
    assert set(RECEPTION_MODELS.choices()) == {model.kind for model in MODELS.values()}
    for model in MODELS.values():
        walled = Topology(nx.complete_graph(2), 1.0, Places(line(0, 1)), model, walls=[wall()])
        assert walled._range_check.exponent == 3.0


def test_lognormal_shadowing_loses_a_wall_from_its_margin():
    """P(d) = NormalCDF((10 n log10(R / d) - A) / sigma), by the share of many pairs with draws of their own."""
    count, model = 2001, LogDistance(exponent=3.0, shadowing=6.0)
    places = Places([[0.0, 0.0], *([[8.0, 0.0]] * (count - 1))])
    margin = 30.0 * log10(10.0 / 8.0)
    for walls, loss in (([], 0.0), ([wall(6.63)], 6.63)):
        topology = Topology(Complete()(count), 10.0, places, model, walls=walls, seed=3)
        expected = norm.cdf((margin - loss) / 6.0)
        error = (expected * (1.0 - expected) / (count - 1)) ** 0.5
        assert abs(len(topology.neighbours(0)) / (count - 1) - expected) < 3.0 * error
        assert abs(norm.cdf((margin - loss + 1.5) / 6.0) - expected) > 5.0 * error  # 1.5 dB more would be seen


@pytest.mark.parametrize("reach", [inf, 50.0])
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("check", ["send", "delivery", "both"])
def test_nothing_is_received_over_an_opaque_wall(reach, name, check):
    places = Places(line(-1.0, 0.0, 2.0, 3.0))
    trace, clock = Trace(), Clock()
    links = Links(range=reach, reception=MODELS[name], range_check=check, latency=0.1)
    network = Network(clock, Complete()(4), links, positions=places, trace=trace, walls=[wall()], seed=1)
    for src in range(4):
        network.send(src, None, src)
        network.send(src, (src + 2) % 4, "alone")
        network.publish(src, src)
    clock.run(until=SECOND)
    heard = {(message.src, node) for node in range(4) for message in network.inbox(node).drain()}
    assert heard == {(0, 1), (1, 0), (2, 3), (3, 2)}
    assert all(set(network.latest_records(node)) == {node ^ 1} for node in range(4))
    assert network.message_counts().lost == (20 if check == "delivery" else 4)
    assert network.topology.component(0) == {0, 1}


def test_a_lossy_wall_has_no_effect_on_an_unlimited_range():
    topology = Topology(nx.complete_graph(3), inf, Places(line(0, 5, 900)), walls=[wall(80.0)])
    assert topology.neighbours(0).tolist() == [1, 2]


def test_walls_that_do_not_block_radio_change_nothing():
    blind = Wall(line=[[1.0, -9.0], [1.0, 9.0]], blocks=("sight", "motion"))
    assert Topology(nx.complete_graph(2), walls=[blind]).walls is None
    with pytest.raises(ValueError, match="walls that block radio need positions"):
        Topology(nx.complete_graph(2), walls=[wall()])


def test_each_face_of_a_solid_block_counts():
    block = Wall(polygon=[[1, -1], [2, -1], [2, 1], [1, 1]], loss=3.0)
    walls = RadioWalls([block, wall(1.0, at=5.0)], 2, 3.0)
    ends = np.array([[0.5, 0.0], [1.5, 0.0], [3.0, 0.0], [6.0, 0.0], [3.0, 5.0]])
    assert walls.decibels(np.zeros((1, 2)), ends).tolist() == [0.0, 3.0, 6.0, 7.0, 0.0]


def test_a_large_loss_is_a_large_distance_and_an_opaque_wall_an_infinite_one():
    walls = RadioWalls([wall(30.0), wall(1e6, at=2.0), wall(at=3.0)], 5, 3.0)
    ends = np.array(line(0.5, 1.5, 2.5, 3.5, 0.0))
    apart = walls.stretched(0, np.arange(5), np.zeros((1, 2)), ends, ends[:, 0])
    assert apart[:2].tolist() == [0.5, pytest.approx(15.0)]
    assert 1e200 < apart[2] < inf
    assert apart[3:].tolist() == [inf, 0.0]
    assert walls.with_exponent(2.0).stretched(0, np.array([1]), np.zeros((1, 2)), ends[1:2], ends[1:2, 0]) == [
        pytest.approx(1.5 * 10.0**1.5)
    ]


@pytest.mark.parametrize("kind", [np.float32, int])
def test_a_function_may_return_positions_of_any_type_of_numbers(kind):
    places = np.array(line(0, 4, 6), dtype=kind)
    topology = Topology(nx.complete_graph(3), 5.0, lambda: places, walls=[wall(at=5.0)])
    assert [topology.hearers(node) for node in range(3)] == [[1], [0], []]
    assert topology.reaches(1, [0, 2]) == [True, False]


@pytest.mark.parametrize("graph", [nx.complete_graph(12), nx.gnp_random_graph(12, 0.5, seed=2, directed=True)])
def test_losses_are_kept_until_an_end_moves(graph):
    rng = np.random.default_rng(4)
    source, walls = Places(rng.uniform(-9.0, 9.0, size=(12, 2))), [wall(2.0), Wall(line=[[-9, -9], [9, 9]], loss=4.0)]
    kept = Topology(graph, 6.0, source, LogDistance(), walls=walls)
    for step in range(40):
        fresh = Topology(graph, 6.0, source, LogDistance(), walls=walls)
        node = step % 12
        assert kept.hearers(node, 3) == fresh.hearers(node, 3)
        assert kept.reaches(node, [k for k in range(12) if k != node]) == fresh.reaches(
            node, [k for k in range(12) if k != node]
        )
        source.places = source.places.copy()
        source.places[rng.integers(12, size=2)] += rng.uniform(-3.0, 3.0, size=2)


def test_a_loss_is_not_computed_again_if_nobody_has_moved(monkeypatch):
    source = Places(np.random.default_rng(4).uniform(-9.0, 9.0, size=(12, 2)))
    topology = Topology(nx.complete_graph(12), 60.0, source, walls=[wall(2.0)])
    computed = []
    plain = RadioWalls.decibels
    monkeypatch.setattr(RadioWalls, "decibels", lambda walls, a, b: computed.append(len(b)) or plain(walls, a, b))
    for moved in (None, None, 3, None, 0):
        if moved is not None:
            source.places = source.places.copy()
            source.places[moved] += 0.5
        topology.hearers(0)
    assert computed == [12, 1, 12]


@pytest.mark.parametrize("message", [5, None])
def test_many_nodes_hear_what_few_would(message):
    from desim.kernel.topology import topology as module

    rng = np.random.default_rng(5)
    places, walls = Places(rng.uniform(0.0, 40.0, size=(60, 2))), [wall(6.0, at=20.0), Wall(line=[[0, 0], [40, 40]])]
    few = Topology(Complete()(60), 9.0, places, QuasiUnitDisk(), walls=walls, seed=1)
    size, module.SMALL_NETWORK = module.SMALL_NETWORK, 10
    try:
        many = Topology(Complete()(60), 9.0, places, QuasiUnitDisk(), walls=walls, seed=1)
    finally:
        module.SMALL_NETWORK = size
    assert [many.neighbours(k).tolist() for k in range(60)] == [few.neighbours(k).tolist() for k in range(60)]


# Channels.


def channel(reception, places, *, access=None, walls=(), **keys):
    clock, trace = Clock(), Trace()
    medium = Bitrate(bitrate=800_000.0, access=access or Aloha(), reception=reception)
    network = Network(
        clock, nx.complete_graph(len(places)), Links(medium=medium, **keys), trace=trace, positions=Places(places),
        walls=walls,
    )  # fmt: skip
    return clock, network, trace


@pytest.mark.parametrize("reception", [CaptureEffect(), Sinr(fading="none"), CaptureEffect(lock=True)])
@pytest.mark.parametrize(("loss", "is_received"), [(0.0, False), (inf, True), (10.0, True), (4.0, False)])
def test_interference_is_weaker_behind_a_wall(reception, loss, is_received):
    """Nodes 0 and 1 transmit at once. Node 2 is 10 m from 0, and 11 m from 1, behind the wall: 1.2 dB, and 6 needed."""
    places = [[0.0, 0.0], [21.0, 0.0], [10.0, 0.0]]
    clock, network, _ = channel(reception, places, walls=[wall(loss, at=15.0)] if loss else ())
    for src in (0, 1):
        network.send(src, None, src, size=100)
    clock.run(until=SECOND)
    heard = [message.src for message in network.inbox(2).drain()]
    assert heard == ([0] if is_received else [])


def test_lora_frames_do_not_interfere_through_an_opaque_wall():
    medium = LoRa(access=Aloha(), reception=LoRaInterference())
    for walls, heard in (([], []), ([wall(at=15.0)], [0])):
        clock = Clock()
        network = Network(clock, Complete()(3), Links(medium=medium), positions=Places(line(0, 20, 10)), walls=walls)
        for src in (0, 1):
            network.send(src, None, src, size=20)
        clock.run(until=9 * SECOND)
        assert [message.src for message in network.inbox(2).drain()] == heard


@pytest.mark.parametrize("sensing", [None, 30.0])
def test_a_node_behind_a_wall_is_a_hidden_terminal(sensing):
    """Nodes 0 and 1 sense each other, so node 2 hears both frames; with a wall between them, they collide there."""
    places = [[0.0, 1.0], [20.0, 1.0], [10.0, -9.0]]
    barrier = Wall(line=[[10.0, 0.0], [10.0, 9.0]])
    for walls, heard in (([], {0, 1}), ([barrier], set())):
        clock, network, _ = channel(
            CaptureEffect(), places, access=Csma(sensing_range=sensing), walls=walls, range=25.0
        )
        network.send(0, None, 0, size=100)
        clock.run(until=100_000)
        network.send(1, None, 1, size=100)
        clock.run(until=SECOND)
        assert {message.src for message in network.inbox(2).drain()} == heard


# Motion.


def test_a_node_that_moves_behind_a_wall_is_not_heard():
    for check, heard in (("send", True), ("delivery", False)):
        network = SteppedNetwork(
            2, Links(latency=0.5, range_check=check), positions=line(0.0, 0.5), walls=[{"line": [[1, -1], [1, 1]]}]
        )
        network.send(0, 1, "a")
        assert [message.body for message in network.step(1.0, line(0.0, 2.0))] == (["a"] if heard else [])
        network.send(0, 1, "b")
        assert network.step(1.0, line(0.0, 2.0)) == []
        assert network.lost()[-1].cause == "out_of_range"


def test_broadcasts_over_walls_are_no_messages_to_those_behind():
    clock, network, trace = channel(Sinr(fading="none"), line(0, 2, 3), walls=[wall(at=1.0)])
    network.publish(1, "x", size=100)
    clock.run(until=SECOND)
    (broadcast,) = trace.of(Broadcast)
    assert [node for node, _ in broadcast.fates()] == [2]

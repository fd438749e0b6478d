"""A node: what it draws for a datagram, what it drops, and how a program embeds it."""

import asyncio
import json
import subprocess
import sys
import time
from math import nan, sqrt
from random import Random
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

import desim
from desim import Bernoulli, Crash, Fault, Partition, Scenario, Uniform, load
from desim.kernel.core.events import LOST
from desim.kernel.core.records import Record
from desim.kernel.core.units import nanoseconds
from desim.kernel.state.inbox import Message
from desim.kernel.transport.frames import Segment
from desim.kernel.transport.layer import PORT as FRAMES
from desim.live import Node, NotLiveError, compare, sockets
from desim.live.frames import _segment_of, frame_of, hex_digits, segment_list
from desim.live.node import _CrashingRobot
from desim.live.own_bodies import OwnBodies
from desim.live.pursuer import _Pursuer
from desim.live.refusals import reasons
from desim.live.sockets import Mailbox, udp_socket
from desim.live.wire import Wire
from desim.pursuit.core.events import Sampled
from desim.pursuit.core.traits import DisseminationTraits
from desim.pursuit.motion.dead_reckoning import TrackSegment
from desim.pursuit.motion.flow import is_uniform
from desim.pursuit.team.announcements import Assignment, Forwarded, LocatedAssignment
from protocols.dissemination import PORT as ANNOUNCEMENTS
from scenarios.studies.study import SCENARIOS
from tests.live.test_runs import scenario

LOCAL = "127.0.0.1"


WIRE = Wire(3, 1, OwnBodies(None))


def node_with(**links) -> Node:
    experiment = scenario()
    return Node(experiment.model_copy(update={"network": experiment.network.model_copy(update=links)}), 1, 5)


def announcement(seq, src=0, stamp=0):
    return WIRE.encode(Record(src, seq, stamp, Assignment(1)), "", 24, to_one=False)


def share_lost(node, count=20_000):
    node._env.advance(200_000_000)  # so that nothing stays in flight
    for seq in range(1, count + 1):
        node.link.receive(announcement(seq), 0)
    assert len({outcome.number for outcome in node.link.outcomes}) == count
    return sum(outcome.arrival == LOST for outcome in node.link.outcomes) / count


@pytest.mark.slow
def test_the_share_of_lost_datagrams_is_that_of_the_model():
    p, count = 0.1, 20_000
    error = sqrt(p * (1 - p) / count)  # 0.0021
    share = share_lost(node_with(loss=Bernoulli(p=p)))
    assert abs(share - p) < 3 * error
    wrong = share_lost(node_with(loss=Bernoulli(p=1.2 * p)))
    assert abs(wrong - p) > 3 * error  # the control


def test_a_copy_is_drawn_and_lost_independently_of_its_original():
    p, count = 0.5, 2000
    error = sqrt(p**2 * (1 - p**2) / count)  # 0.0097
    node = node_with(loss=Bernoulli(p=p), duplicate=Bernoulli(p=1.0))
    for seq in range(1, count + 1):
        node.link.receive(announcement(seq), 0)
    arrived = {outcome.number for outcome in node.link.outcomes if outcome.arrival != LOST}
    assert abs(1 - len(arrived) / count - p**2) < 3 * error
    assert abs(1 - len(arrived) / count - p) > 3 * error  # if a lost message had no copy


def test_a_copy_arrives_at_the_stamp_plus_the_latency_as_its_original():
    node = node_with(latency=Uniform(low=0.2, high=0.3), duplicate=Bernoulli(p=1.0))
    node._env.advance(60_000_000)
    for seq in range(1, 101):
        node.link.receive(announcement(seq, stamp=50_000_000), 0)
    arrivals = [outcome.arrival for outcome in node.link.outcomes if outcome.arrival != LOST]
    assert len(set(arrivals)) == len(arrivals) > 150
    assert all(250_000_000 <= arrival <= 350_000_000 for arrival in arrivals)


def test_a_node_whose_links_are_real_draws_nothing_and_does_not_take_their_latency_for_lateness():
    node = Node(scenario(), 1, 5, draws=False)
    node._env.advance(70_000_000)
    node.link.receive(announcement(1), 0)
    assert [outcome.arrival for outcome in node.link.outcomes] == [70_000_000]
    assert not node.link.errors


def test_datagrams_arrive_at_the_stamp_plus_the_latency_and_nodes_draw_independently():
    nodes = [Node(scenario(), k, 5) for k in (1, 2)]
    latency = Uniform(low=0.1, high=0.3)
    drawn = []
    for k in (1, 2):
        experiment = scenario()
        network = experiment.network.model_copy(update={"latency": latency, "loss": Bernoulli()})
        node = Node(experiment.model_copy(update={"network": network}), k, 5)
        for seq in range(1, 201):
            node.link.receive(announcement(seq), 0)
        drawn.append([outcome.arrival for outcome in node.link.outcomes])
        assert all(100_000_000 <= arrival <= 300_000_000 for arrival in drawn[-1])
    assert len(set(drawn[0]) & set(drawn[1])) < 5
    nodes[0].link.receive(announcement(1), 0)
    assert [outcome.arrival for outcome in nodes[0].link.outcomes] == [100_000_000]


def test_foreign_replayed_and_malformed_datagrams_are_dropped_and_counted():
    node = node_with(loss=Bernoulli())
    node.link.receive(announcement(1), 0)
    node.link.receive(announcement(1), 0)
    assert node.link.drops == (0, 0, 1)
    node.link.receive(announcement(2), 2)  # from the address of another node
    node.link.receive(announcement(2), None)  # from an address of none
    node.link.receive(announcement(2, src=1), 1)  # its own
    assert node.link.drops == (0, 3, 1)
    node.link.receive(b"\x80", 0)
    late = Wire(3, 1, OwnBodies(None)).encode(Message(0, 10**11, None), "", 16, to_one=True)
    node.link.receive(late, 0)  # from the future
    assert node.link.drops == (2, 3, 1)
    assert len(node.link.outcomes) == 1


def test_a_replay_is_known_among_the_last_datagrams_of_a_sender(monkeypatch):
    monkeypatch.setattr("desim.live.link.REMEMBERED", 3)
    node = node_with(loss=Bernoulli())
    replayed = []
    for seq in (1, 2, 3, 1, 4, 2, 1, 3):
        node.link.receive(announcement(seq), 0)
        replayed.append(node.link.drops.replayed)
    assert replayed == [0, 0, 0, 1, 1, 2, 2, 3]  # 4 takes the place of 1, and 1 that of 2


def test_a_stamp_that_is_ahead_delays_a_message_by_the_latency_only():
    """The clock of another host may be ahead; the latency is 0.1 s."""
    node = node_with(loss=Bernoulli())
    node._env.advance(200_000_000)
    early = WIRE.encode(Message(0, 1_200_000_000, None), "", 16, to_one=True)
    node.link.receive(early, 0)
    assert [outcome.arrival for outcome in node.link.outcomes] == [300_000_000]


def test_a_pursuer_keeps_its_action_until_its_order_is_obeyed_or_it_is_down():
    node = Node(scenario(), 1, 5)
    before = frame_of(node._state, [0] * 3)._replace(profile=[0, 0, 0])
    node.follow(before)
    node._set_action(1, 1)
    for frame, profile in (
        (before, [0, 1, 0]),  # the referee does not know of the order yet
        (before._replace(broken=[1]), [0, 0, 0]),
        (before._replace(obeyed=[0, 1, 0], profile=[1, 1, 1]), [1, 1, 1]),
        (before._replace(obeyed=[0, 1, 0]), [0, 0, 0]),  # the evader was captured, for instance
    ):
        node.follow(frame)
        assert node._state.profile == profile


def test_messages_of_a_sender_keep_their_order_if_its_link_does():
    """Latencies are drawn between 0 and 2 s."""
    arrivals = {}
    for order in ("overtaking", "fifo"):
        node = node_with(loss=Bernoulli(), latency=Uniform(low=0.0, high=2.0), order=order)
        for seq in range(1, 41):
            node.link.receive(announcement(seq), 0)
        arrivals[order] = [outcome.arrival for outcome in node.link.outcomes]
    assert arrivals["fifo"] == sorted(arrivals["fifo"])
    assert arrivals["overtaking"] != sorted(arrivals["overtaking"])


def test_a_frame_that_another_has_overtaken_changes_nothing():
    node = Node(scenario(), 1, 5)
    frame = frame_of(node._state, [0] * 3)
    places = [hex_digits(np.full(4, k + 0j)) for k in (1.0, 2.0)]
    for when, digits in zip((20, 10), places, strict=True):
        node.follow(frame._replace(t=when, places=digits))
    assert node._state.position(1) == 1.0


def test_a_record_that_another_has_overtaken_does_not_cross_a_partition():
    cut = Partition(start=0.05, end=0.5, groups=((0,), (1, 2)))
    node = Node(scenario(fault=[cut]), 1, 5)
    for seq in (2, 1):
        node.link.receive(announcement(seq), 0)  # transmitted at 0 s, to arrive at 0.1 s
    node._env.advance(200_000_000)
    assert 0 not in node._network.latest_records(1)
    fates = {outcome.number: outcome for outcome in node.link.outcomes}
    assert [(fate.arrival, fate.cause) for fate in fates.values()] == [(100_000_000, "partition")] * 2


def test_a_datagram_that_is_read_late_meets_the_faults_that_began_since_it_was_sent():
    cut = Partition(start=0.05, end=0.5, groups=((0,), (1, 2)))
    node = Node(scenario(fault=[cut]), 1, 5)
    node._env.advance(120_000_000)
    node.link.receive(announcement(1), 0)
    node._env.advance(200_000_000)
    assert 0 not in node._network.latest_records(1)
    assert node.link.outcomes[-1].cause == "partition"


@pytest.mark.parametrize("order", [(2, 1, 3), (2, 3, 1)])
def test_the_newest_record_counts_whatever_the_order_in_which_datagrams_arrive(order):
    node = node_with()
    for seq in order:
        node.link.receive(announcement(seq), 0)
    node._env.advance(200_000_000)
    assert node._network.latest_records(1)[0][1].seq == 3


def test_a_repetition_arrives_at_its_own_transmission_plus_the_latency():
    node = node_with()
    segment = Segment(ANNOUNCEMENTS, True, 0, 1, 1, 2, Forwarded((Record(0, 1, 0, Assignment(1)),)))
    repeated = WIRE.encode(Message(0, 0, segment), FRAMES, 32, to_one=False, now=200_000_000)
    node._env.advance(200_000_000)
    node.link.receive(repeated, 0)
    assert [outcome.arrival for outcome in node.link.outcomes] == [300_000_000]
    assert list(node.link.errors) == [0]


@pytest.mark.parametrize("kind", ["reliable", "coded", "one_hop"])
def test_a_node_takes_announcements_under_their_transport_before_it_has_sent_any(kind):
    experiment = scenario().with_({"announce.dissemination": kind})
    announced = DisseminationTraits.of(experiment.announce.dissemination).transport
    transports = Node(experiment, 1, 5)._network._transport_layer._transports
    assert transports == ({} if announced is None else {ANNOUNCEMENTS: announced})
    assert (announced is None) == (kind == "one_hop")


@pytest.mark.parametrize("hours", [1, 3, 40])
def test_a_repetition_hours_after_its_message_arrives_at_its_own_transmission_plus_the_latency(hours):
    """The time between a message and its frame counts modulo 71 min."""
    node, now = node_with(loss=Bernoulli()), hours * 3600 * 10**9
    segment = Segment(ANNOUNCEMENTS, True, 0, 1, 1, 2, Forwarded((Record(0, 1, 0, Assignment(1)),)))
    repeated = WIRE.encode(Message(0, 0, segment), FRAMES, 32, to_one=False, now=now)
    node.link.receive(repeated, 0, now + 1000)
    assert [outcome.arrival for outcome in node.link.outcomes] == [now + 100_000_000]
    ahead = WIRE.encode(Message(0, 0, segment), FRAMES, 32, to_one=False, now=now + 10**9)  # by a clock that is
    node.link.receive(ahead, 0, now + 1000)
    assert node.link.outcomes[-1].arrival == now + 1000 + 100_000_000


@pytest.mark.slow
def test_random_datagrams_do_not_stop_a_node():
    rng, node = Random(3), node_with()
    for _ in range(100_000):
        node.link.receive(rng.randbytes(rng.choice([0, 8, 16, 24, 32, 40, 48, 64])), rng.randrange(3))
        if node.link.outcomes:
            node.link.outcomes.clear()
    node._env.advance(10**9)
    assert sum(node.link.drops) >= 99_900


def test_a_pursuer_leaves_as_its_last_report_has_been_read():
    async def leave():
        told, ended = [], asyncio.get_running_loop().create_future()
        lines = SimpleNamespace(
            ended=ended, tell=lambda what, *_: told.append(what), close=lambda: told.append("close")
        )
        pursuer = object.__new__(_Pursuer)
        pursuer._lines, pursuer._node = lines, node_with()
        leaving = asyncio.create_task(pursuer._leave(0.0))
        await asyncio.sleep(0.01)
        assert (leaving.done(), told) == (False, ["report", "done", "close"])
        ended.set_result(None)
        await leaving

    asyncio.run(leave())


def test_a_crash_of_a_robot_is_that_of_its_own_node():
    node = Node(scenario(), 1, 5)
    robot = _CrashingRobot(node)
    node._mirror.set_action(1)
    robot.crash(0)
    assert not node._state.broken.any()
    robot.crash(1)
    assert node._state.broken.tolist() == [False, True, False]
    assert node._state.profile[1] == 0
    robot.recover(1)
    assert not node._state.broken.any()


def test_a_socket_that_is_closed_is_watched_no_more():
    async def watched():
        bound = udp_socket((LOCAL, 0))
        number, loop = bound.fileno(), asyncio.get_running_loop()
        datagrams = sockets.Datagrams(bound, lambda *_: None)
        datagrams.close()
        return loop.remove_reader(number)

    assert asyncio.run(watched()) is False


def test_a_motion_step_arrives_as_it_was_sent():
    segment = TrackSegment(1, 2.0 + 3.0j, 4.0 - 5.0j, -6.0 + 7.0j, 8)
    assert _segment_of(json.loads(json.dumps(segment_list(segment)))) == segment
    assert segment_list(None) == []


def test_a_program_of_ones_own_puts_positions_in_and_gets_commands_out():
    async def play():
        experiment = scenario(team={"count": 2, "speeds": 2.0}, latency=0.02, horizon=5.0)
        nodes = [Node(experiment, k, 5) for k in range(2)]
        start = time.monotonic_ns()

        def now():
            return time.monotonic_ns() - start

        addresses = [(LOCAL, port) for port in await free_ports(2)]
        async with nodes[0].open(addresses[0], addresses, now), nodes[1].open(addresses[1], addresses, now):
            for _ in range(100):
                for k, node in enumerate(nodes):
                    node.sense([3.0 * k + 1.0, 7.0], [[2.0, 7.0]], [[1.0, 7.0], [4.0, 7.0]], [[0.5, 0.0]])
                if {node.action for node in nodes} == {0, 1} and nodes[0].now > 0.3:
                    break
                await asyncio.sleep(0.02)
            assert [node.action for node in nodes] == [1, 0]  # the nearer one goes on
            assert nodes[0].velocity() == pytest.approx([2.0, 0.0])
            assert nodes[1].velocity() == [0.0, 0.0]
            nodes[0].captured(1)
            assert nodes[0].action == 0
            with pytest.raises(
                ValueError,
                match=r"position should be finite numbers of shape \(2,\), at most 1e\+09 from 0 \(got \[1.0\]\)",
            ):
                nodes[0].sense([1.0], [[1.0, 0.0]])
            with pytest.raises(
                ValueError,
                match=r"evaders should be finite numbers of shape \(1, 2\), at most 1e\+09 from 0 \(got 'far'\)",
            ):
                nodes[0].sense([1.0, 0.0], "far")
        assert all(node.is_over for node in nodes)
        assert nodes[0].lateness().number > 0
        assert sum(node.link.drops.malformed for node in nodes) == 0

    asyncio.run(play())


def test_what_a_robot_tells_holds_from_the_time_at_which_it_tells_it():
    """No event happens between its first announcement, at 0 s, and 0.1 s."""

    async def play():
        node, time = node_with(), [0]
        running = asyncio.create_task(node.run(lambda: time[0]))
        await asyncio.sleep(0)
        time[0] = 30_000_000
        node.sense([0.0, 0.0], [[5.0, 0.0]], [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]], [[0.0, 10.0]])
        evader = node._state.body(1)
        assert (evader.position, node.now) == (5.0, 0.03)
        node._mirror.set_action(1)
        time[0] = 50_000_000
        assert node.velocity() == pytest.approx([2.0 * 5.0 / sqrt(25.04), 2.0 * 0.2 / sqrt(25.04)])
        time[0] = 60_000_000
        node.captured(1)
        assert (evader.captured, node.action) == (60_000_000, 0)
        node.stop()
        await running

    asyncio.run(play())


@pytest.mark.slow_cases("walls")
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"wall": [{"line": [[2.0, -9.0], [2.0, 4.0]], "blocks": ["motion"]}]},
        {"environment": {"flow": {"kind": "uniform", "velocity": [0.4, -0.3]}}},
        {"team.guidance": "constant_bearing", "environment": {"flow": {"kind": "uniform", "velocity": [0.4, -0.3]}}},
        {"environment": {"flow": {"kind": "harmonic", "amplitude": [0.4, -0.3], "period": 0.5}}},
        {"environment": {"flow": {"kind": "affine", "rotation": 0.3, "centre": [1.0, 2.0]}}},
    ],
    ids=("plane", "walls", "flow", "constant bearing in a flow", "harmonic flow", "affine flow"),
)
def test_a_robot_commands_what_a_pursuer_in_a_simulation_does(changes):
    experiment = scenario().with_(
        {
            **{"team.active_at_start": 1.0, "motion.step": 0.05, "motion.order": "simultaneous"},
            **{"record.trajectory": 0.05, "protocol.schedule": {"kind": "rounds", "period": 1.0}, **changes},
        }
    )
    environment, results = experiment.environment, [desim.run(experiment, seed) for seed in (1, 2, 3)]
    for seed, result in enumerate(results, start=1):
        sampled = result.trace.of(Sampled)[:3]  # no pursuer decides before the third
        evaders, pursuers = (np.array([getattr(event, name) for event in sampled]) for name in ("evaders", "pursuers"))
        for pursuer in range(3):
            node = Node(experiment, pursuer, seed)
            node.sense(pursuers[1, pursuer], evaders[1], pursuers[1], (evaders[1] - evaders[0]) / 0.05)
            node._mirror.set_action(1)
            moved = complex(*(pursuers[2, pursuer] - pursuers[1, pursuer])) / 0.05
            velocity = complex(*node.velocity())
            carried = environment.drift(complex(*pursuers[1, pursuer]), velocity, nanoseconds(0.05), 0.05)
            # Where the flow varies in space, the evader's own velocity is known up to its changes within a step.
            assert velocity + carried == pytest.approx(moved, abs=1e-6 if is_uniform(environment.flow) else 1e-3)


@pytest.mark.parametrize("tells", [False, True])
@pytest.mark.parametrize("links", [{"range": 5.0}, {"latency": {"kind": "propagation", "speed": 10.0}}], ids=str)
def test_a_robot_whose_teammates_are_anywhere_does_not_take_them_for_where_a_simulation_begins(links, tells):
    """Without positions they would be where the seed puts them."""
    node = Node(scenario().with_({"network": links, "announce.payload": "state"}), 1, 5)
    places = [[0.0, 0.0], [3.0, 0.0], [20.0, 0.0]]
    node.sense(places[1], [[1.0, 1.0]], places if tells else None)

    def hear():
        for seq, src in ((1, 0), (2, 2)):
            node.link.receive(
                WIRE.encode(Record(src, seq, 0, LocatedAssignment(0, 0.0, 0.0, 1.0)), "", 48, to_one=False), src
            )
        node._network.topology.neighbours(1)
        return [outcome.arrival for outcome in node.link.outcomes]

    if tells:
        assert hear() == ([0, 0] if "range" in links else [300_000_000, 1_700_000_000])
        return
    with pytest.raises(ValueError, match=r"^pursuer 1: sense was given no teammates, and the network depends on where"):
        hear()


@pytest.mark.parametrize("static", [False, True])
def test_positions_that_are_told_may_jump_and_lie_in_memory_as_they_like(static):
    node = Node(Scenario().with_({"team.count": 3, "network.range": 2.0, "motion.static": static}), 0)
    for x, y, heard in ((1.0, 90.0, [1]), (80.0, 1.0, [2])):
        places = np.array([[0.0, x, y], [0.0, 0.0, 0.0]]).T  # not contiguous
        node.sense(places[0], np.array([[50.0], [50.0]]).T, places)
        assert [list(node._network.topology.hearers(0)) for _ in range(2)] == [heard] * 2


def test_an_evader_that_is_sensed_twice_at_one_instant_is_where_it_was_last():
    node = Node(scenario().with_({"announce.payload": "state"}), 1, 5)
    for place in (3.0, 4.0, 4.0):
        node.sense([0.0, 0.0], [[place, 1.0]])
        (body,) = node._state.bodies
        assert body.path.last.evader == node._agent.evader(1) == place + 1.0j
    assert len(body.path._segments) == 2  # a frame that has the same step again adds none


def test_a_robot_that_should_sense_its_teammates_is_asked_for_them():
    node = Node(scenario(), 1, 5)
    with pytest.raises(ValueError, match=r"^teammates should be the positions of all pursuers: with announce.payload"):
        node.sense([0.0, 0.0], [[1.0, 1.0]])
    Node(scenario().with_({"announce.payload": "time"}), 1, 5).sense([0.0, 0.0], [[1.0, 1.0]])


@pytest.mark.parametrize("key", ["team", "evader"])
def test_a_robot_of_a_scenario_with_inertia_is_told_that_it_cannot_say_how_fast_it_is(key):
    node = Node(scenario().with_({f"{key}.dynamics": {"kind": "acceleration", "limit": 3.0}}), 1, 5)
    with pytest.raises(ValueError, match=rf"^{key}.dynamics: capture times with inertia follow from how fast"):
        node.sense([0.0, 0.0], [[1.0, 0.0]])


def test_a_node_runs_once_and_one_that_is_not_opened_keeps_no_socket():
    async def play():
        (port,) = await free_ports(1)
        node, address = node_with(), (LOCAL, port)
        for peers in ([address], [address, (LOCAL, 1), ("no host", 2)]):
            with pytest.raises((ValueError, OSError), match=r"peers should be|not known"):
                async with node.open(address, peers):
                    pass
        with udp_socket(address):
            pass
        async with node.open(address):
            assert not node.is_over
        with pytest.raises(RuntimeError, match="a node runs once"):
            async with node.open(address):
                pass

    asyncio.run(play())


@pytest.mark.parametrize(("end", "last"), [(900_000_000, 800_000_000), (0, -1)])
def test_a_node_that_is_late_performs_what_is_due_before_the_end(end, last):
    async def play():
        node, time = node_with(), [-1]
        running = asyncio.create_task(node.run(lambda: time[0]))
        await asyncio.sleep(0)
        time[0] = 950_000_000
        node.stop(end)  # its own clock still stands at 0
        await running
        return [sent.t for sent in node.link.departures]

    times = asyncio.run(play())
    assert last < max(times) <= end  # an announcement at 0 s, and a heartbeat each 0.1 s


def test_a_record_is_read_later_as_if_at_its_arrival_and_a_message_at_once():
    async def play():
        node, time = node_with(loss=Bernoulli()), [0]
        node.connect([(LOCAL, 1), (LOCAL, 2), (LOCAL, 3)])
        running = asyncio.create_task(node.run(lambda: time[0]))
        await asyncio.sleep(0)
        time[0] = 30_000_000
        node.arrived(announcement(1), (LOCAL, 1))
        assert not node.link.outcomes
        time[0] = 120_000_000
        node.arrived(WIRE.encode(Message(0, 70_000_000, None), "", 16, to_one=True), (LOCAL, 1))
        assert [outcome.arrival for outcome in node.link.outcomes] == [100_000_000, 170_000_000]
        assert list(node.link.errors) == [0, 0]
        node.arrived(announcement(2), (LOCAL, 9))  # of a stranger
        node.stop()
        await running
        assert node.link.drops.foreign == 1

    asyncio.run(play())


def test_a_record_that_comes_before_a_clock_begins_arrives_as_it_begins():
    async def play():
        node, time = Node(scenario().with_({"fault": [Crash(node=2, start=0.5)]}), 1, 5), [-500_000_000]
        node.connect([(LOCAL, 1), (LOCAL, 2), (LOCAL, 3)])
        running = asyncio.create_task(node.run(lambda: time[0]))
        await asyncio.sleep(0)
        time[0] = -400_000_000
        node.arrived(announcement(1), (LOCAL, 1))
        time[0] = 100_000_000
        node.stop(50_000_000)
        await running
        return [outcome.arrival for outcome in node.link.outcomes]

    assert asyncio.run(play()) == [100_000_000]  # after its latency


@pytest.mark.skipif(sockets.TIMESTAMP is None, reason="the system does not stamp datagrams")
def test_a_mailbox_tells_how_long_ago_each_datagram_arrived(monkeypatch):
    box, sender = Mailbox(udp_socket((LOCAL, 0))), udp_socket((LOCAL, 0))
    begin = time.monotonic_ns()
    while not any(age >= 1_000_000 for *_, age in box.read()):  # Linux begins to stamp a moment after it is asked to
        sender.sendto(b"early", box.address)
        time.sleep(0.002)
    for datagram in (b"first", b"second"):
        sender.sendto(datagram, box.address)
        time.sleep(0.02)
    (first, whence, older), (second, _, newer) = box.read()
    assert (first, second, whence) == (b"first", b"second", sender.getsockname())
    assert 20_000_000 <= newer < older - 20_000_000 < time.monotonic_ns() - begin
    assert box.read() == []
    sender.sendto(b"third", box.address)
    monkeypatch.setattr(sockets.time, "time_ns", lambda: 1 << 62)  # the clock of the day has been set
    ((_, _, age),) = box.read()
    assert age <= time.monotonic_ns() - begin
    sender.close()
    box.close()


@pytest.mark.skipif(sockets.TIMESTAMP is None, reason="the system does not stamp datagrams")
def test_records_that_may_have_to_wake_a_process_do_not_wait_in_a_mailbox():
    fault = Partition(start=0.1, groups=[[0], [1, 2]])
    experiment = scenario()
    for faults in ((), (fault,)):
        node = Node(experiment.model_copy(update={"fault": faults}), 1, 5)
        address = node.bind_mailbox(bound := udp_socket((LOCAL, 0)))
        assert (address is None) == (bound.fileno() == -1) == bool(faults)
        bound.close()


@pytest.mark.slow
def test_records_in_a_mailbox_are_read_as_if_at_their_arrival():
    async def play():
        node, sender = node_with(loss=Bernoulli()), udp_socket((LOCAL, 0))
        begin = time.monotonic_ns()
        box = node.bind_mailbox(udp_socket((LOCAL, 0)))
        node.connect([sender.getsockname(), (LOCAL, 2), (LOCAL, 3)], [None, box, None])
        running = asyncio.create_task(node.run(lambda: time.monotonic_ns() - begin))
        await asyncio.sleep(0)
        sent = time.monotonic_ns() - begin
        sender.sendto(announcement(1), box)
        sender.sendto(announcement(1), box)
        await asyncio.sleep(0.15)  # its heartbeats are each 0.1 s
        node.stop()
        await running
        sender.close()
        (outcome,), (late,) = node.link.outcomes, node.link.errors
        assert outcome.arrival == 100_000_000  # at the time stamp plus the latency
        assert late == 0
        assert sent < 50_000_000
        assert node.link.drops.replayed == 1

    asyncio.run(play())


@pytest.mark.slow
def test_walls_block_the_radio_of_a_node_as_in_a_simulation():
    tables = scenario(team={"positions": [[1.0, 1.0], [3.0, 1.0], [3.0, 2.0]]}).plain()
    tables["network"]["range"] = 10.0
    wall = {"line": [[2.0, -5.0], [2.0, 5.0]], "blocks": ["radio", "motion"]}
    reached = []
    for walls in ([], [wall]):
        node = Node(Scenario.model_validate(tables | {"wall": walls}), 1, 5)
        node._env.advance(0)  # its first announcement
        reached.append(node.link.departures[0].dst)
    assert reached == [(0, 2), (2,)]


async def free_ports(count):
    loop, ports = asyncio.get_running_loop(), []
    transports = []
    for _ in range(count):
        transport, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, local_addr=(LOCAL, 0))
        transports.append(transport)
        ports.append(transport.get_extra_info("sockname")[1])
    for transport in transports:
        transport.close()
    await asyncio.sleep(0.01)
    return ports


@pytest.mark.slow
def test_the_example_with_a_server_of_toy_robots_captures_its_evader():
    command = [sys.executable, "-m", "scenarios.live_robots"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60, cwd=SCENARIOS.parent)
    assert shown.stdout.startswith("captured after")


# What cannot run live.


class Late(Fault):
    """A fault that looks at the run."""

    def begin(self, site):
        return site.intercept(lambda src, receivers, body: dict.fromkeys(receivers, 1.0))


class Flash(Crash):
    """A crash with a cause of its own."""

    cause: ClassVar[str] = "lightning"


def test_a_fault_of_a_user_runs_live_if_it_begins_as_a_built_in_one():
    assert not dict(reasons(scenario(fault=[Flash(start=0.1, node=1)])))


REFUSED = [
    ("protocol.kind", {"protocol": {"kind": "centralised"}}),
    ("team.count", {"team": {"count": 513}}),
    ("sensing", {"sensing": {"radius": 3.0}}),
    pytest.param("sensing", {"wall": [{"line": [[2, 0], [2, 5]]}]}, marks=pytest.mark.slow),  # blocks sight
    ("evader.0.strategy", {"evader": {"strategy": {"kind": "listener"}}}),
    ("network.medium", {"network": {"medium": {"kind": "bitrate", "bitrate": 1e6}}}),
    (
        "network.processing.sender",
        {"network": {"processing": {"sender": {"kind": "uniform", "low": 0.0, "high": 0.1}}}},
    ),
    ("network.transport", {"network": {"transport": {"kind": "best_effort", "lifespan": 0.4}}}),
    ("network.transport.needed", {"network": {"transport": {"kind": "coded", "pieces": 4, "needed": 2}}}),
    (
        "announce.dissemination",
        {"announce": {"dissemination": {"kind": "reliable"}}, "fault": [{"kind": "clock_skew", "offset": 0.1}]},
    ),
    ("announce.dissemination", {"announce": {"dissemination": "reliable"}, "clocks": {"sync": "two_way"}}),
    *(
        (
            "announce.dissemination",
            {"announce": {"dissemination": {"kind": "reliable"}}, "protocol": {"schedule": {"kind": schedule}}},
        )
        for schedule in ("token_ring", "token_walk", "local_mutex")
    ),
    ("announce.dissemination.needed", {"announce": {"dissemination": {"kind": "coded", "pieces": 4, "needed": 2}}}),
    ("fault.0", {"fault": [{"kind": "random", "kinds": ["crash", Late]}]}),
    ("fault.0", {"fault": [{"kind": "chaser_crash", "start": 1.0}]}),
    (
        "fault.0.memory",
        {
            "fault": [{"kind": "crash", "node": 1, "start": 0.5, "memory": False}],
            "network": {"transport": {"kind": "reliable"}},
        },
    ),
]


@pytest.mark.parametrize(
    "changes", [{"fault": [{"kind": "clock_skew", "offset": 0.1}]}, {"clocks": {"sync": "two_way"}}]
)
def test_stamps_of_clocks_that_differ_are_not_taken_for_the_true_time(changes):
    """Those of clocks without errors differ, too, as soon as they are corrected by latencies that are drawn."""
    assert Node(scenario(), 1, 5).link.trusts_stamps
    assert not Node(scenario().with_(changes), 1, 5).link.trusts_stamps


@pytest.mark.parametrize(("key", "changes"), REFUSED)
def test_what_cannot_run_live_is_refused_with_a_reason(key, changes):
    tables = scenario().plain()
    for table, keys in changes.items():
        tables[table] = keys if isinstance(keys, list) or "kind" in keys else (tables[table] or {}) | keys
    experiment = Scenario.model_validate(tables)
    assert key in dict(reasons(experiment))
    with pytest.raises(NotLiveError, match=f"^{key} cannot run live: "):
        Node(experiment, 0)


def test_a_live_run_has_as_many_pursuers_as_a_datagram_can_name():
    told = {count: dict(reasons(scenario(team={"count": count}))).get("team.count") for count in (511, 512, 513)}
    assert told == {511: None, 512: None, 513: "a datagram can name 512 pursuers"}


@pytest.mark.slow
def test_the_examples_that_can_run_live_are_these():
    files = sorted(SCENARIOS.glob("*.toml"))
    live = {file.stem for file in files if not any(reasons(load(file, allow_import=True)))}
    assert {"relay", "auction", "faults", "flooding", "inertia", "server", "token_ring", "wind"} <= live
    assert not {"contention", "lora", "liars", "noisy", "search"} & live


def test_a_pursuer_that_does_not_exist_and_too_few_addresses_are_refused():
    with pytest.raises(ValueError, match=r"there is no pursuer 3: they are 0 \.\. 2"):
        Node(scenario(), 3)
    with pytest.raises(TypeError, match=r"Node takes a scenario, not a path: Node\(load\('relay.toml'\)\)"):
        Node("relay.toml", 3)
    with pytest.raises(ValueError, match=r"pursuer should be an integer \(got '3'\)"):
        Node(scenario(), "3")
    with pytest.raises(ValueError, match=r"an address should be a host and a port \(got '127.0.0.1:1'\)"):
        Node(scenario(), 0).connect(["127.0.0.1:1"] * 3)
    with pytest.raises(OSError, match=r"the host 'no host' is not known: "):
        Node(scenario(), 0).connect([(LOCAL, 1), ("no host", 2), (LOCAL, 3)])
    with udp_socket((LOCAL, 0)) as taken, pytest.raises(OSError, match=r"127\.0\.0\.1, port \d+: .*in use"):
        udp_socket(taken.getsockname())
    with pytest.raises(ValueError, match=r"peers should be the addresses of 3 pursuers \(got 1\)"):
        Node(scenario(), 0).connect([(LOCAL, 1)])
    with pytest.raises(ValueError, match=r"peers should be different addresses \(got \[\('127.0.0.1', 1\), "):
        Node(scenario(), 0).connect([(LOCAL, 1), (LOCAL, 2), (LOCAL, 2)])


WRONG_RUNS = {
    "seeds should be a list of integers": [{"seeds": 3}, {"seeds": "12"}, {"seeds": None}],
    "the seed should be": [{"seeds": [1.5]}, {"seeds": [-1]}],
    "at_once should be": [{"at_once": 0}, {"at_once": "1"}, {"at_once": 1.5}, {"at_once": nan}],
    "links should be 'drawn', 'namespaces', 'netem'": [{"links": "real"}, {"links": None}, {"links": 1}],
    "tell and finished should be functions": [{"tell": None}, {"finished": 3}, {"finished": 0}],
    "hosts should be the names or addresses of 3 hosts": [
        *({"hosts": hosts} for hosts in ("abc", 3, [1, 2, 3], [None] * 3, [""] * 3, ["127.0.0.1"]))
    ],
}


@pytest.mark.parametrize("sentence", WRONG_RUNS)
def test_arguments_of_live_runs_of_another_type_are_refused_before_a_process_starts(sentence):
    for given in WRONG_RUNS[sentence]:
        with pytest.raises(ValueError, match=sentence):
            desim.live.runs(scenario(), **{"seeds": [1]} | given)


@pytest.mark.parametrize("action", [3, lambda: None, "print"])
def test_a_node_refuses_what_takes_no_action(action):
    with pytest.raises(ValueError, match="on_action should"):
        Node(scenario(), 0, 1, on_action=action)
    with pytest.raises(ValueError, match="draws should be True or False"):
        Node(scenario(), 0, 1, draws="no")


@pytest.mark.parametrize("now", [3, lambda: 0.5, lambda: None, lambda time: time])
def test_a_node_refuses_another_time_before_its_block_begins(now):
    async def runs():
        async with Node(scenario(), 0, 1).open((LOCAL, 0), now=now):
            begun.append(now)

    begun = []
    with pytest.raises(ValueError, match=r"now (should|returns, the time since the start of the run in ns)"):
        asyncio.run(runs())
    assert not begun


@pytest.mark.parametrize("evader", ["1", 1.0, None])
def test_an_evader_of_another_type_is_not_captured(evader):
    with pytest.raises(ValueError, match="an evader should be an integer"):
        Node(scenario(), 0, 1).captured(evader)


def test_only_scenarios_are_compared():
    for wrong in ({"scenario": []}, {"scenario": scenario(), "simulated": 3}):
        with pytest.raises(TypeError, match="compare takes a scenario"):
            compare(**wrong)
    with pytest.raises(ValueError, match="a comparison needs at least 2 runs"):
        compare(scenario(), 0)


@pytest.mark.parametrize("place", [1e300, 2e9, nan])
def test_places_and_velocities_beyond_those_of_a_scenario_are_refused(place):
    node = Node(scenario(), 0, 1)
    for wrong in (([place, 0.0], [[1.0, 1.0]]), ([0.0, 0.0], [[place, 1.0]])):
        with pytest.raises(ValueError, match="should be finite numbers"):
            node.sense(*wrong)
    with pytest.raises(ValueError, match="velocities should be finite numbers"):
        node.sense([0.0, 0.0], [[1.0, 1.0]], velocities=[[place, 0.0]])


@pytest.mark.parametrize("address", [(LOCAL, True), (LOCAL, 0.0), (LOCAL, "0"), LOCAL])
def test_an_address_whose_port_is_no_number_is_refused(address):
    with pytest.raises(ValueError, match="an address should be a host and a port"):
        sockets.checked_address(address)

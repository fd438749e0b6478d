"""Each imperfection is removed, and nothing else."""

from dataclasses import dataclass, field
from itertools import permutations
from math import inf
from typing import Literal

import networkx as nx
import pytest

from desim import Scenario, load, run
from desim.config.model import Value
from desim.kernel.core.events import Broadcast, MessageCounts, Queued, Sent
from desim.kernel.models.access import Csma, SlottedAloha
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.coherence import Coherence
from desim.kernel.models.fault_plans import RandomCrashes, RandomFaults
from desim.kernel.models.faults import Crash, Jamming, Partition
from desim.kernel.models.graphs import Edge, Edges, Grid, Link, Ring, Star
from desim.kernel.models.interference import CaptureEffect, LoRaInterference
from desim.kernel.models.latency import Constant, Lognormal
from desim.kernel.models.links import Links, Processing
from desim.kernel.models.loss import Bernoulli, GilbertElliott
from desim.kernel.models.medium import Bitrate, LoRa, Unlimited
from desim.kernel.models.reception import Disk, QuasiUnitDisk, Rice
from desim.kernel.models.transport import Coded
from desim.kernel.walls.wall import Wall
from desim.pursuit.byzantine.lies import Silent
from desim.pursuit.core.events import Started
from desim.pursuit.game.utility import Component
from desim.pursuit.motion.dynamics import Acceleration, TurnRate
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.flow import SteadyFlow
from desim.pursuit.sensing.noise import PositionNoise
from desim.pursuit.sensing.sensing import Sensing
from desim.pursuit.sensing.tracking import Kalman
from desim.pursuit.team.announcements import Announcements
from desim.pursuit.team.targeted_faults import ChaserCut, NewsFault
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording
from desim.scenario.sweep_table import Sweep
from desim.study.ablation.imperfections import (
    IMPERFECTIONS,
    with_perfect_network,
    without_contention,
    without_faults,
    without_latency,
    without_lies,
    without_loss,
    without_messages,
    without_range,
    without_serial_decisions,
    without_staleness,
    without_transport,
)
from desim.study.store.properties import flat
from protocols.cbba import CBBA
from protocols.centralised import Centralised
from protocols.dissemination import CodedOneHop, Gossip, ReliableOneHop
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.mutex import LocalMutex
from protocols.schedules.periodic import Periodic, Poisson, Rounds, SharedSeed
from protocols.schedules.synchronous import Synchronous
from protocols.schedules.token import TokenRing, TokenWalk
from protocols.server import Server
from scenarios.studies.study import SCENARIOS

FILES = sorted(SCENARIOS.glob("*.toml"))
LATE, LOSSY = Constant(value=0.5), Bernoulli(p=0.25)
LIE = Silent(node=2, start=2.0)
RING = TokenRing(holding_time=0.03, attempts=2)
WORST = Scenario(
    name="worst",
    seed=7,
    horizon=9.0,
    prune="infeasible",
    team=Team(count=4, dynamics=TurnRate(limit=0.5)),
    evader=(Evader(count=2, dynamics=Acceleration(limit=0.5)), Evader(speed=0.5)),
    motion=Motion(step=0.05),
    environment=Environment(flow=SteadyFlow(velocity=(0.5, 0.0))),
    protocol=SpatialAdaptivePlay(schedule=RING, utility=Component()),
    network=Links(
        preset="acoustic",
        graph=Edges(
            edges=(
                Edge(src=0, dst=1, latency=LATE, loss=LOSSY, order="fifo"),
                Edge(src=0, dst=2, loss=LOSSY),
                Edge(src=1, dst=2, latency=LATE),
                Edge(src=1, dst=0),
                Edge(src=2, dst=3),
                Edge(src=3, dst=0, order="overtaking"),
            ),
            nodes=4,
            directed=True,
        ),
        range=5.0,
        reception=Rice(k=2.0),
        fading="correlated",
        coherence=Coherence(doppler=5.0),
        range_check="both",
        latency=Lognormal(mean=0.1, cv=0.5),
        order="fifo",
        processing=Processing(sender=0.1, receiver=0.2),
        loss=GilbertElliott(share=0.2, burst=1.0),
        duplicate=LOSSY,
        medium=LoRa(
            half_duplex=True,
            queue_limit=3,
            duty_cycle=0.5,
            spreading_factors=(7, 8, 9, 9),
            access=SlottedAloha(slot=0.5),
            reception=CaptureEffect(),
        ),
        transport=Coded(pieces=3, needed=2),
        link=(Link(src=0, dst=1, latency=LATE, loss=LOSSY, both_ways=True), Link(src=1, dst=2, order="fifo")),
    ),
    announce=Announcements(
        payload="time",
        reckoning="straight_line",
        trigger="heartbeat",
        heartbeat=0.7,
        belief_timeout=inf,
        start="silent",
        dissemination=Gossip(),
    ),
    fault=(
        Crash(node=1, start=0.5),
        Partition(start=1.0, groups=((0, 1),)),
        Jamming(start=1.0, centre=(5.0, 5.0), radius=3.0),
        ClockSkew(offset=0.1),
        RandomCrashes(),
        RandomFaults(),
        LIE,
    ),
    sensing=Sensing(
        radius=3.0, estimate="hold", track_timeout=1.0, noise=PositionNoise(deviation=0.2), estimator=Kalman()
    ),
    record=Recording(trajectory=0.0, messages=True),
    wall=(Wall(line=((-9.0, 0.0), (-9.0, 9.0)), blocks=("radio", "sight")),),  # players with inertia pass walls
    sweep=Sweep(reps=5),
)
GONE = "gone"


def below(table, *keys):
    """Return dotted keys below a table that are gone."""
    return {f"{table}.{key}": GONE for key in keys}


LATENCY = {"latency": None, **below("latency", "kind", "value")}
LOSS = {"loss": None, **below("loss", "kind", "p")}
"""What becomes of those of an edge: a table of keys becomes a key without a value."""
CHANGES = {
    "latency": {
        "network.preset": None,
        "network.latency.kind": "constant",
        "network.latency.value": 0.0,
        **below("network.latency", "mean", "cv", "offset"),
        "network.processing.sender.value": 0.0,
        "network.processing.receiver": 0.0,
        **{
            f"network.{where}.{key}": each
            for where in ("graph.edges.0", "graph.edges.2", "link.0")
            for key, each in LATENCY.items()
        },
    },
    "contention": {
        "network.preset": None,
        "network.medium.shared": True,
        "network.medium.duty_cycle": None,
        "network.medium.spreading_factors": None,
        **below("network.medium.spreading_factors", *"0123"),
        "network.medium.access.kind": "ideal",
        **below("network.medium.access", "slot", "p"),
        "network.medium.reception.kind": "collision",
        **below("network.medium.reception", "threshold", "exponent", "lock", "fading", "m", "k", "shadowing"),
    },
    "loss": {
        "network.preset": None,
        "network.loss.kind": "bernoulli",
        "network.loss.p": 0.0,
        **below("network.loss", "share", "burst", "loss_good", "loss_bad", "advance", "common"),
        **{
            f"network.{where}.{key}": each
            for where in ("graph.edges.0", "graph.edges.1", "link.0")
            for key, each in LOSS.items()
        },
    },
    "duplicates": {"network.preset": None, "network.duplicate.p": 0.0},
    "transport": {
        "network.preset": None,
        "network.transport.kind": "best_effort",
        **below("network.transport", "pieces", "needed", "spacing"),
    },
    "range limit": {
        "network.preset": None,
        "network.range": "Infinity",
        "network.reception.kind": "disk",
        **below("network.reception", "k"),
    },
    "channel memory": {
        "network.preset": None,
        "network.fading": "message",
        "network.coherence.doppler": None,
    },
    "faults": {key: GONE for key in flat(WORST.plain()) if key.startswith("fault.") and key != "fault.0.end"}
    | {f"fault.0.{key}": each for key, each in LIE.plain().items() if key not in {"start", "end"}}
    | {"fault.0.start": 2.0, "fault.0.memory": GONE, "fault.0.scope": GONE},
    "lies": {key: GONE for key in flat(WORST.plain()) if key.startswith("fault.6.")},
    "serial decisions": {
        "protocol.schedule.kind": "synchronous",
        "protocol.schedule.schedule.kind": "token_ring",
        "protocol.schedule.schedule.holding_time": 0.03,
        "protocol.schedule.schedule.attempts": 2,
        **below("protocol.schedule", "holding_time", "attempts"),
        "announce.trigger": "both",
    },
    "unknown start": {"announce.start": "known"},
    "stale knowledge": {
        "announce.payload": "action",
        "announce.trigger": "both",
        "announce.belief_timeout": "auto",
    },
    "limited sight": {"sensing.radius": "Infinity"},
    "noise": {
        "sensing.noise.kind": "none",
        "sensing.noise.deviation": GONE,
        "sensing.estimator.kind": "none",
        "sensing.estimator.velocity_diffusion": GONE,
    },
    "inertia": {
        "team.dynamics.kind": "simple",
        "evader.0.dynamics.kind": "simple",
        **below("team.dynamics", "limit", "heading"),
        **below("evader.0.dynamics", "limit"),
    },
    "flow": {"environment.flow.kind": "none", **below("environment.flow", "velocity.0", "velocity.1")},
    "walls (radio)": {"wall.0.blocks.0": "sight", "wall.0.blocks.1": GONE},
    "walls (sight)": {"wall.0.blocks.1": GONE},
    "walls (motion)": {},
}
"""What each removal makes of the worst scenario: every key that changes, and what it is then."""


def removed(scenario, names=tuple(IMPERFECTIONS)):
    for name in names:
        scenario = IMPERFECTIONS[name](scenario)
    return scenario


def changes(before, after):
    """Return each key in which two scenarios differ, and what it is in the second."""
    old, new = flat(before.plain()), flat(after.plain())
    return {key: new.get(key, GONE) for key in old.keys() | new.keys() if old.get(key, GONE) != new.get(key, GONE)}


def test_walls_that_block_nothing_any_longer_are_removed_and_starts_stay_outside_of_those_that_blocked_motion():
    """The worst scenario has no walls that block motion, which it cannot have beside inertia and a flow."""
    both, motion = (
        Wall(line=((-9.0, 0.0), (-9.0, 9.0)), blocks=blocks) for blocks in (("sight", "motion"), ("motion",))
    )
    among = Scenario(wall=(both, motion), sensing=Sensing(track_timeout=1.0))
    sighted, start = (Wall(line=both.line, blocks=blocks) for blocks in (("sight", "start"), ("start",)))
    assert removed(among, ["walls (motion)"]) == Scenario(wall=(sighted, start), sensing=Sensing(track_timeout=1.0))
    assert removed(among, ["walls (motion)", "walls (sight)"]) == Scenario(wall=(start, start))
    radio = Wall(line=both.line, blocks=("radio",))
    assert removed(Scenario(wall=(radio,)), ["walls (radio)"]) == Scenario()


@pytest.mark.slow
def test_players_start_among_walls_as_where_these_have_become_places_without_starts():
    """Of 20 pursuers some would start inside the wall, which is half of the box."""
    walls = Wall(polygon=((0.0, 0.0), (10.0, 0.0), (10.0, 20.0), (0.0, 20.0)), blocks=("motion",))
    among = Scenario(wall=(walls,), team=Team(box=(0.0, 20.0)))
    start, free = (changed.team.start(1, changed.space) for changed in (removed(among), Scenario(team=among.team)))
    assert (start == among.team.start(1, among.space)).all()
    assert (start[:, 0] > 10.0).all()
    assert not (free[:, 0] > 10.0).all()  # the control


@pytest.mark.parametrize("name", IMPERFECTIONS)
def test_only_the_given_imperfection_is_removed(name):
    assert changes(WORST, removed(WORST, [name])) == CHANGES[name]


WITHOUT_EFFECT = {"sensing.estimate", "sensing.track_timeout"}
"""Settings of sightings that mean nothing, and have their defaults, where all evaders are always seen."""


@pytest.mark.slow
@pytest.mark.parametrize("names", [*permutations(("limited sight", "noise", "walls (sight)"), 2)], ids=" then ".join)
def test_what_limits_and_blurs_the_sight_is_removed_alone(names):
    """How much of the settings of sightings can go depends on which limits are left."""
    kept = removed(WORST, names)
    found = {key for key in changes(WORST, kept) if not key.startswith("wall")}
    assert found - WITHOUT_EFFECT == {key for name in names for key in CHANGES[name] if not key.startswith("wall")}


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize("scenario", [WORST, *FILES], ids=lambda each: getattr(each, "stem", "worst"))
def test_removing_all_imperfections_in_any_order_leaves_none(scenario):
    scenario = without_contention(scenario if isinstance(scenario, Scenario) else load(scenario))
    ideal = removed(scenario)
    assert ideal == removed(scenario, reversed(IMPERFECTIONS))
    assert all(remove(ideal) == ideal for remove in IMPERFECTIONS.values())
    assert Scenario.model_validate(ideal.plain()).plain() == ideal.plain()


@pytest.mark.parametrize("scenario", [WORST, *(path for path in FILES if path.stem in ("contention", "lora"))], ids=str)
def test_if_nodes_contend_the_channel_is_an_ideal_queue_at_last(scenario):
    """It takes time, which is no imperfection of a channel for which nodes contend."""
    scenario = scenario if isinstance(scenario, Scenario) else load(scenario)
    queue = without_contention(scenario).network.medium
    ideal = removed(scenario)
    assert ideal.network.medium == queue
    assert queue.shared
    assert without_latency(ideal) == removed(without_contention(scenario))


THERE = {
    "auction": "latency, loss, faults",
    "bursts": "latency, loss, stale knowledge",
    "contention": "contention, range limit",
    "cooling": "latency, faults",
    "faults": "latency, faults",
    "cornered": "latency, walls (motion)",
    "evasive": "latency",
    "fading": "latency, loss, transport, range limit, channel memory",
    "flooding": "latency, range limit, stale knowledge",
    "forest": "latency, range limit, limited sight, walls (radio), walls (sight), walls (motion)",
    "recorded": "latency, range limit, stale knowledge",
    "inertia": "latency, stale knowledge, inertia",
    "hiding": "latency, walls (sight), walls (motion)",
    "imperfect": "latency, loss, range limit, faults, serial decisions, stale knowledge",
    "learning": "latency, loss",
    "liars": "latency, loss, lies, stale knowledge",
    "many": "latency",
    "lora": "contention",
    "measured": "latency, loss",
    "named": "latency, loss, serial decisions",
    "netem": "latency, loss, duplicates",
    "noisy": "latency, noise",
    "news": "latency, faults, lies, serial decisions, stale knowledge",
    "office": "latency, range limit, walls (radio), walls (sight), walls (motion)",
    "properties": "latency, loss, faults",
    "radio": "latency, range limit",
    "reckoning": "latency, stale knowledge",
    "relay": "latency, loss",
    "reliable": "latency, loss, transport, faults, stale knowledge, limited sight",
    "rooms": "latency, range limit, walls (radio), walls (sight), walls (motion)",
    "search": "latency, limited sight",
    "server": "latency",
    "shadowing": "contention, loss, channel memory",
    "soak": "latency, loss, faults, serial decisions",
    "table1_20": "serial decisions",
    "table1_40": "serial decisions",
    "token_ring": "latency, loss, serial decisions, stale knowledge",
    "voronoi": "latency, stale knowledge",
    "wind": "latency, flow",
    "wired": "latency, loss",
}
"""The imperfections of each file, as one reads it; that the start is not known for free comes on top."""


@pytest.mark.slow_cases("forest", "table1_40")
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_an_imperfection_is_present_if_the_file_has_it(path):
    scenario = load(path)
    present = [name for name, remove in IMPERFECTIONS.items() if remove(scenario) != scenario]
    assert "unknown start" in present
    assert ", ".join(name for name in present if name != "unknown start") == THERE[path.stem]


def unideal(result):
    """Return how many transmissions of a run had to wait or arrived later than they left, and how many were lost."""
    left = [*result.trace.of(Sent), *result.trace.of(Broadcast)]
    arrivals = [event.arrival if isinstance(event, Broadcast) else (event.arrival,) for event in left]
    late = sum(not {event.created, *at} <= {event.t} for event, at in zip(left, arrivals, strict=True))
    (tally,) = result.trace.of(MessageCounts)
    assert tally.sent == tally.delivered + tally.lost + tally.in_flight
    return late + len(result.trace.of(Queued)), tally.lost, tally.in_flight


@pytest.mark.whole_but_one
@pytest.mark.slow_but_one
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_it_starts_as_it_would_and_no_message_is_late_or_lost(path):
    """Where messages take time, some are late or have to wait, so that it means something if none is.

    Only a pursuer that does not see the evader, or has no path to it, does not begin to chase it. On a channel for
    which nodes contended, messages still have an airtime.
    """
    scenario = load(path, ["horizon=0.3", "record.messages=true"])
    before, after = run(scenario), run(removed(scenario))
    began, would = before.trace.of(Started)[0], after.trace.of(Started)[0]
    hidden = any(name in THERE[path.stem] for name in ("limited sight", "walls (sight)", "walls (motion)"))
    assert would == began or (hidden and would == began._replace(active=would.active))
    contended = "contention" in THERE[path.stem]
    assert unideal(after)[1:] == (0, 0) or (contended and unideal(after)[1] == 0)
    assert unideal(after)[0] == 0 or contended
    assert (unideal(before)[0] > 0) is (contended or "latency" in THERE[path.stem])


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_on_a_perfect_network_all_arrives_at_once_and_without_messages_nothing(path):
    """Also where nodes contend. All else is kept: the players, what they announce, and whose robots break down."""
    scenario = load(path, ["horizon=0.3", "record.messages=true"])
    perfect, silent = with_perfect_network(scenario), without_messages(scenario)
    robots_down = any("no_crashes" in getattr(fault, "breaks", ()) for fault in perfect.fault)
    assert unideal(run(perfect)) == (0, 0, 0) or robots_down
    (tally,) = run(silent).trace.of(MessageCounts)
    assert tally.delivered == 0
    assert {key.partition(".")[0] for key in changes(scenario, perfect)} <= {"network", "fault", "announce", "wall"}
    assert {key.partition(".")[0] for key in changes(scenario, silent)} <= {"network", "announce"}
    same = {"dissemination": scenario.announce.dissemination}
    assert perfect.announce.model_copy(update=same) == silent.announce.model_copy(update=same) == scenario.announce


@pytest.mark.slow
def test_a_perfect_network_keeps_broken_robots_lies_and_clocks():
    radio, plan = Crash(node=1, start=0.5, scope="radio"), RandomFaults(kinds=("partition", "jamming"))
    faults = (*WORST.fault, radio, RandomCrashes(scope="radio"), plan, ChaserCut(start=1.0), NewsFault())
    crash, _, _, skew, crashes, mixed, lie = WORST.fault
    assert with_perfect_network(WORST.with_({"fault": faults})).fault == (crash, skew, crashes, mixed, lie)


@pytest.mark.parametrize("processing", [Processing(sender=0.05), Processing(receiver=0.05)])
def test_nor_does_anything_take_time_at_the_ends(processing):
    """Announcements are sent every 0.1 s, and the run ends at 0.52 s: with 0.05 s more, the last is on its way then."""
    scenario = Scenario(
        horizon=0.52, team=Team(count=3), network=Links(processing=processing), record=Recording(messages=True)
    )
    assert unideal(run(scenario))[2] > 0
    assert unideal(run(without_latency(scenario))) == (0, 0, 0)


def test_the_default_scenario_has_turns_and_a_start_that_is_announced():
    present = [name for name, remove in IMPERFECTIONS.items() if remove(Scenario()) != Scenario()]
    assert present == ["serial decisions", "unknown start"]


@pytest.mark.parametrize("dissemination", [ReliableOneHop(), CodedOneHop()])
def test_announcements_that_are_repeated_or_coded_reach_the_neighbours_once(dissemination):
    scenario = Scenario(announce=Announcements(dissemination=dissemination, trigger="change"))
    assert without_transport(scenario) == Scenario(announce=Announcements(trigger="change"))


@pytest.mark.parametrize("remove", [without_latency, without_loss, without_transport, without_range])
def test_a_network_without_an_imperfection_keeps_its_preset(remove):
    """A named network that has none of the four, by other values than those it is named for."""
    named = Links(preset="wifi", latency=Constant())
    scenario = Scenario(network=named)
    assert remove(scenario) is scenario


def test_links_of_their_own_lose_what_is_removed_and_keep_the_rest():
    """And one of which nothing is left is none of its own: it is like the rest then."""
    both = Link(src=0, dst=1, latency=LATE, loss=LOSSY, both_ways=True)
    slow, lossy, fifo = (
        Link(src=1, dst=2, latency=LATE),
        Link(src=2, dst=3, loss=LOSSY),
        Link(src=3, dst=0, order="fifo"),
    )
    scenario = Scenario(team=Team(count=4), network=Links(link=(both, slow, lossy, fifo)))

    def bare(key):
        return both.model_copy(update={key: None})

    assert without_latency(scenario).network == Links(link=(bare("latency"), lossy, fifo))
    assert without_loss(scenario).network == Links(link=(bare("loss"), slow, fifo))
    assert without_loss(without_latency(scenario)).network == Links(link=(fifo,))
    assert without_range(scenario) is scenario


def edges(scenario):
    return {(a, b): data for a, b, data in scenario.network.graph(3).edges(data=True)}


@pytest.mark.parametrize("kind", [nx.Graph, nx.DiGraph])
@pytest.mark.parametrize("as_value", [True, False], ids=["value", "function"])
def test_edges_of_a_user_graph_keep_the_remaining_imperfections(kind, as_value):
    """A directed one stays directed: 0 -> 1 and 1 -> 0 are two edges."""
    own = kind()
    own.add_nodes_from(range(3))
    own.add_edge(0, 1, latency=LATE, order="fifo")
    own.add_edge(1, 2, loss=LOSSY)
    expected = {(0, 1): {"latency": LATE, "order": "fifo"}, (1, 2): {"loss": LOSSY}}
    if own.is_directed():
        own.add_edge(1, 0, latency=LATE, loss=LOSSY)
        expected[1, 0] = {"latency": LATE, "loss": LOSSY}
    scenario = Scenario(team=Team(count=3), network=Links(graph=Edges.of(own) if as_value else lambda size: own.copy()))

    def without(*keys):
        return {edge: {key: each for key, each in data.items() if key not in keys} for edge, data in expected.items()}

    assert edges(scenario) == expected
    assert edges(without_latency(scenario)) == without("latency")
    assert edges(without_loss(scenario)) == without("loss")
    assert edges(without_loss(without_latency(scenario))) == without("latency", "loss")
    assert without_latency(scenario).network.graph.directed is own.is_directed()
    assert without_range(scenario) is scenario


def test_a_graph_that_a_function_hands_out_again_and_again_is_left_alone():
    """What is removed from the scenario without latency is not removed from the scenario as it is."""
    own = nx.path_graph(3)
    own.edges[0, 1]["latency"] = 0.5
    scenario = Scenario(team=Team(count=3), network=Links(graph=lambda size: own))
    assert edges(without_latency(scenario)) == {(0, 1): {}, (1, 2): {}}
    assert edges(scenario) == {(0, 1): {"latency": 0.5}, (1, 2): {}}


@pytest.mark.parametrize("graph", [Ring(), Star(centre=2), Grid(columns=2), Edges(edges=(Edge(src=0, dst=1),))])
def test_the_graph_is_no_imperfection(graph):
    scenario = Scenario(team=Team(count=4), network=Links(graph=graph, range=3.0, latency=LATE, loss=LOSSY))
    assert removed(scenario).network == Links(graph=graph)


@pytest.mark.parametrize("network", [Links(range=3.0), Links(reception=QuasiUnitDisk())], ids=["range", "reach"])
def test_range_and_reach_are_each_removed(network):
    assert without_range(Scenario(network=network)).network == Links(range=inf, reception=Disk())


@pytest.mark.parametrize("medium", [Bitrate(bitrate=1000.0), LoRa(shared=True)])
def test_a_medium_takes_time_and_so_belongs_to_latency(medium):
    scenario = Scenario(network=Links(medium=medium))
    assert without_latency(scenario).network == Links(medium=Unlimited())
    assert without_loss(scenario) is scenario


@pytest.mark.parametrize("medium", [Unlimited(), Bitrate(bitrate=1000.0), LoRa(shared=True)])
def test_a_channel_for_which_nobody_contends_is_unchanged(medium):
    scenario = Scenario(network=Links(medium=medium))
    assert without_contention(scenario) is scenario


@pytest.mark.parametrize("medium", [Bitrate(bitrate=1000.0, header=3), LoRa(queue_limit=2)], ids=lambda each: each.kind)
def test_without_contention_the_channel_is_an_ideal_queue(medium):
    contended = type(medium).model_validate(dict(medium) | {"access": Csma(), "duty_cycle": 0.5})
    shared = type(medium).model_validate(dict(medium) | {"shared": True})
    assert without_contention(Scenario(network=Links(medium=contended))).network == Links(medium=shared)


@pytest.mark.parametrize("medium", [Bitrate(bitrate=1000.0, shared=True), LoRa()], ids=lambda each: each.kind)
def test_without_latency_a_channel_for_which_nobody_contends_is_unlimited(medium):
    contended = type(medium).model_validate(dict(medium) | {"access": Csma(), "shared": False})
    assert without_latency(Scenario(network=Links(medium=medium))).network == Links()
    assert without_latency(Scenario(network=Links(medium=contended))).network == Links(medium=contended)


def test_without_contention_all_lora_nodes_transmit_alike():
    own = LoRa(access=Csma(), reception=LoRaInterference(), spreading_factors=(7, 12), frequencies=(868e6, 869e6))
    scenario = Scenario(team=Team(count=2), network=Links(medium=own))
    assert without_contention(scenario).network == Links(medium=LoRa(shared=True))


class Own(Value):
    """A schedule of a user: twice a second."""

    kind: Literal["own"] = "own"

    def mean_slot(self, me):
        return 0.5

    def __call__(self, me, revise):
        while True:
            yield me.sleep(0.5)
            revise()


class OwnTurns(Own):
    """One that knows how it is without turns."""

    def without_serial_decisions(self):
        return {"kind": "rounds", "period": 0.25}


class Narrow(SpatialAdaptivePlay):
    """A rule of a user that runs under one schedule only."""

    schedule: SharedSeed = SharedSeed()


@dataclass
class NoModel:
    """A protocol of a user that has a schedule, but is no model."""

    schedule: SharedSeed = field(default_factory=SharedSeed)

    def __call__(self, me):
        yield from self.schedule(me, lambda: None)


@pytest.mark.parametrize(
    "protocol",
    [
        Centralised(),
        Server(),
        lambda me: iter(()),
        NoModel(),
        *(
            SpatialAdaptivePlay(schedule=each)
            for each in (Rounds(period=0.2), Poisson(), Periodic(), Synchronous(schedule=RING), Own())
        ),
    ],
    ids=lambda each: getattr(getattr(each, "schedule", each), "kind", type(each).__name__),
)
def test_a_protocol_without_turns_is_unchanged(protocol):
    scenario = Scenario(protocol=protocol, announce=Announcements(trigger="never"))
    assert without_serial_decisions(scenario) is scenario


def test_a_rule_that_accepts_no_other_schedule_keeps_its_turns():
    """`synchronous` is none that it takes."""
    scenario = Scenario(protocol=Narrow())
    assert without_serial_decisions(scenario) == scenario


ANNOUNCED = Announcements(trigger="change", heartbeat=0.7, start="silent")


@pytest.mark.parametrize(
    ("schedule", "free", "trigger"),
    [
        (SharedSeed(slot=0.25), Synchronous(schedule=SharedSeed(slot=0.25)), "change"),
        (RING, Synchronous(schedule=RING), "both"),
        (TokenWalk(holding_time=0.2), Synchronous(schedule=TokenWalk(holding_time=0.2)), "both"),
        (LocalMutex(rate=3.0, attempts=2), Poisson(rate=3.0), "both"),
        (OwnTurns(), Rounds(period=0.25), "change"),
    ],
    ids=lambda each: getattr(each, "kind", each),
)
def test_without_turns_a_protocol_announces_what_schedule_messages_carried(schedule, free, trigger):
    """Nothing else of the rule or of what is announced changes."""
    scenario = Scenario(protocol=CBBA(schedule=schedule, winner_timeout=7.0), announce=ANNOUNCED)
    found = without_serial_decisions(scenario)
    assert found.protocol == CBBA(schedule=free, winner_timeout=7.0)
    assert found.announce == ANNOUNCED.model_copy(update={"trigger": trigger})
    assert found == scenario.model_copy(update={"protocol": found.protocol, "announce": found.announce})
    assert without_serial_decisions(found) == found


@pytest.mark.parametrize("schedule", [SharedSeed(), RING, TokenWalk(), LocalMutex()], ids=lambda each: each.kind)
def test_a_single_pursuer_waits_for_no_other(schedule):
    scenario = Scenario(team=Team(count=1), protocol=SpatialAdaptivePlay(schedule=schedule), announce=ANNOUNCED)
    assert without_serial_decisions(scenario) is scenario
    two = scenario.model_copy(update={"team": Team(count=2)})
    assert without_serial_decisions(two) != two


@pytest.mark.parametrize("trigger", ["change", "heartbeat", "both", "revision", "never"])
@pytest.mark.parametrize("payload", ["action", "time", "state"])
def test_without_staleness_every_change_is_announced_at_once_and_repeated(trigger, payload):
    scenario = Scenario(announce=Announcements(trigger=trigger, payload=payload, heartbeat=0.3, dissemination=Gossip()))
    assert without_staleness(scenario).announce == Announcements(heartbeat=0.3, dissemination=Gossip())


@pytest.mark.parametrize("fault", WORST.fault, ids=lambda each: each.kind)
def test_removing_faults_leaves_none(fault):
    scenario = Scenario(fault=(fault,))
    assert without_lies(without_faults(scenario)) == Scenario()


@pytest.mark.slow
def test_without_latency_frames_of_one_instant_still_do_not_collide():
    """Rounds over the preset wifi: the random delay of the hosts belongs to the channel, and goes with it.

    The control is a constant delay, which separates nothing and is latency.
    """
    rounds = {"kind": "cbba", "schedule": {"kind": "rounds"}}
    scenario = Scenario(
        horizon=0.5,
        team={"count": 8},
        protocol=rounds,
        announce={"trigger": "revision"},
        network={"preset": "wifi"},
        record={"messages": True},
    )
    counts = [run(each).trace.of(MessageCounts)[0] for each in (scenario, without_latency(scenario))]
    assert all(each.delivered > 0.5 * each.sent for each in counts)
    for order in (["latency", "contention"], ["contention", "latency"]):
        assert removed(scenario, order).network.processing == Processing()
    still = scenario.with_({"network": {"preset": "wifi", "processing": {"sender": 0.001}}})
    assert without_latency(still).network.processing == Processing()


@pytest.mark.parametrize(
    "other",
    [
        {"link": (Link(src=0, dst=1, latency=LATE),)},
        {"graph": Edges.of(nx.Graph([(0, 1, {"latency": 0.5}), (1, 2, {}), (0, 2, {})]))},
        {"latency": 0.5},
        {"processing": Processing(sender=0.1, receiver=0.2)},
        None,
    ],
    ids=["a link", "an edge", "all links", "receivers", "nothing"],
)
def test_processing_stays_if_something_else_has_a_latency(other):
    """Without contention, latency at the sender alone is that of the medium; see `without_contention`."""
    links = {"medium": Bitrate(bitrate=1e5, access=Csma()), "processing": Processing(sender=0.1)} | (other or {})
    processing = without_contention(Scenario(team=Team(count=3), network=Links(**links))).network.processing
    assert processing == (Processing() if other is None else links["processing"])

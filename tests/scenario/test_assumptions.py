"""Assumptions: where each holds and where it does not, and the messages for violated ones."""

from typing import ClassVar, Literal, get_args

import networkx as nx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, run
from desim.config.errors import KeyedError
from desim.kernel.core.events import LOST, Broadcast
from desim.kernel.models.access import CsmaCa, Tdma
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.fault_plans import RandomCrashes, RandomFaults
from desim.kernel.models.faults import Crash, Jamming, Partition
from desim.kernel.models.graphs import Edge, Edges, Link, Ring
from desim.kernel.models.interference import INTERFERENCES, Sinr
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli, GilbertElliott
from desim.kernel.models.medium import Bitrate
from desim.kernel.models.reception import QuasiUnitDisk
from desim.pursuit.core.traits import AssumptionName
from desim.pursuit.game.utility import Component, EdgePenalty, LocalMean
from desim.pursuit.team.announcements import Announcements
from desim.scenario.assumptions import (
    ASSUMPTIONS,
    announcements_repeated,
    component_heard,
    connected,
    equal_clocks,
    equal_speeds,
    everyone_heard,
    host_in_range,
    initial_graph,
    messages_get_through,
    no_crashes,
    one_at_a_time,
    positions_known,
    times_known,
    violations,
)
from desim.scenario.checks import warnings
from desim.scenario.players import Evader, Speeds, Team
from desim.scenario.scenario import PROTOCOLS, Motion, Recording
from protocols.best_response import BestResponse, BetterReply
from protocols.dissemination import CodedOneHop, Flooding, Gossip, ReliableOneHop
from protocols.fictitious_play import FictitiousPlay
from protocols.local_min import ArgminKnown, LocalMin
from protocols.rule import Rule
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.mutex import LocalMutex
from protocols.schedules.periodic import Periodic, Poisson, Rounds, SharedSeed
from protocols.schedules.token import TokenRing, TokenWalk

FOUR = Team(positions=[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0)])
"""On a line, 1 m apart."""
HALVES = Partition(start=1.0, end=2.0, groups=((0, 1),))
TWO_PAIRS = nx.Graph([(0, 1), (2, 3)])
FLOODED = Announcements(dissemination=Flooding())


def four(graph=None, **given):
    """Return a scenario of four on a line, linked as by a networkx graph if one is given."""
    network = {"network": Links(graph=Edges.of(graph))} if graph is not None else {}
    return Scenario(**({"team": FOUR, "protocol": BetterReply(schedule=Poisson())} | network | given))


@pytest.mark.parametrize(
    ("scenario", "why"),
    [
        (four(), None),
        (four(nx.path_graph(4)), None),
        (four(network=Links(range=1.0)), None),
        (four(network=Links(range=0.99)), "cannot reach all others"),
        (four(TWO_PAIRS), "cannot reach all others"),
        (four(nx.DiGraph([(0, 1), (1, 2), (2, 3)])), "cannot reach all others"),
        (four(nx.DiGraph([(0, 1), (1, 2), (2, 3), (3, 0)])), None),
        (four(fault=[HALVES]), "partition"),
        (four(fault=[Jamming(start=0.0, centre=(0.0, 0.0), radius=1.0)]), None),
    ],
)
def test_all_are_connected_over_any_number_of_hops_or_not(scenario, why):
    """In both directions: along a one-way path no other receives from the last."""
    assert_reason(connected(scenario), why)


def assert_reason(found, why):
    """Check that there is a reason iff there should be one, and that it is the right one."""
    assert (found is None) == (why is None), found
    assert why is None or why in found


@pytest.mark.parametrize(
    ("scenario", "why"),
    [
        (four(), None),
        (four(network=Links(range=3.0)), None),
        (four(network=Links(range=2.99)), "not all pursuers hear each other"),
        (four(network=Links(range=2.99), announce=FLOODED), None),
        (four(network=Links(range=2.99), announce=Announcements(dissemination=Gossip())), None),
        (four(nx.path_graph(4)), "not all pursuers hear each other"),
        (four(nx.path_graph(4), announce=Announcements(dissemination=ReliableOneHop())), "not all pursuers hear"),
        (four(nx.path_graph(4), announce=Announcements(dissemination=CodedOneHop())), "not all pursuers hear"),
        (four(TWO_PAIRS, announce=FLOODED), "cannot reach all others"),
        (four(fault=[HALVES], announce=FLOODED), "partition"),
        (four(nx.path_graph(4), protocol=BetterReply(schedule=TokenRing())), None),
        (four(nx.path_graph(4), protocol=BetterReply(schedule=TokenWalk())), None),
        (four(nx.path_graph(4), protocol=BetterReply(schedule=LocalMutex())), "not all pursuers hear each other"),
        (Scenario(team=Team(count=1)), None),
    ],
)
def test_all_pursuers_are_reached_directly_or_by_forwarding_or_not(scenario, why):
    assert_reason(everyone_heard(scenario), why)


@pytest.mark.parametrize(
    ("scenario", "why"),
    [
        (four(), None),
        (four(TWO_PAIRS), None),
        (four(nx.Graph([(0, 1), (1, 2), (0, 2), (0, 3)])), "several hops"),
        (four(nx.path_graph(4)), "several hops"),
        (four(nx.path_graph(4), announce=FLOODED), None),
        (four(nx.path_graph(4), protocol=BetterReply(schedule=TokenRing())), None),
        (four(network=Links(range=1.5)), "several hops"),
        (four(network=Links(range=0.5)), None),
        (four(nx.DiGraph([(0, 1), (1, 0), (2, 3)])), None),
        (four(nx.DiGraph([(0, 1), (2, 1), (3, 1)])), None),
        (four(nx.DiGraph([(0, 1), (1, 2), (0, 2), (0, 3)])), None),
        (four(nx.DiGraph([(0, 1), (1, 2), (3, 2)])), "several hops"),
        (four(nx.DiGraph([(0, 1), (1, 0), (1, 2), (3, 2)])), "several hops"),
        (four(nx.DiGraph([(0, 1), (1, 2), (2, 0), (3, 2)])), "several hops"),
    ],
)
def test_the_component_is_reached_if_it_is_complete_or_records_are_forwarded_or_not(scenario, why):
    assert_reason(component_heard(scenario), why)


@pytest.mark.slow
@given(st.sets(st.tuples(st.integers(0, 3), st.integers(0, 3)).filter(lambda link: link[0] != link[1])))
def test_the_component_is_heard_if_each_pursuer_hears_all_whose_messages_can_reach_it(links):
    """In a graph with one-way links, as `Topology.component` has it."""
    graph = nx.DiGraph(links)
    graph.add_nodes_from(range(4))
    hears_all = all(nx.ancestors(graph, pursuer) == {*graph.predecessors(pursuer)} for pursuer in range(4))
    assert (component_heard(four(graph)) is None) == hears_all


LOSSY = Links(loss=Bernoulli(p=0.1))
ONE_LOSSY = Links(link=[Link(src=0, dst=1, loss=Bernoulli(p=0.1))])
LOSSY_EDGE = Links(
    graph=Edges(edges=[Edge(src=0, dst=1), Edge(src=1, dst=2), Edge(src=2, dst=3, loss=Bernoulli(p=0.1))])
)
LOSSLESS_LINKS = Links(
    graph=Edges(edges=[Edge(src=k, dst=k + 1, loss=Bernoulli()) for k in range(3)]),
    link=[Link(src=0, dst=1, loss=Bernoulli(p=0.0))],
)
ONE_LATE = Links(link=[Link(src=0, dst=1, latency={"kind": "constant", "value": 0.1})])


@pytest.mark.slow_but_one
@pytest.mark.parametrize("trigger", ["change", "never", "heartbeat", "both", "revision"])
@pytest.mark.parametrize(
    ("given", "lost"),
    [
        ({}, False),
        ({"network": LOSSY}, True),
        ({"network": Links(loss=GilbertElliott())}, True),
        ({"network": ONE_LOSSY}, True),
        ({"network": LOSSY_EDGE}, True),
        ({"network": LOSSLESS_LINKS}, False),
        ({"network": ONE_LATE}, False),
        ({"fault": [HALVES]}, True),
        ({"network": Links(medium=Bitrate(bitrate=1e6))}, False),
        ({"network": Links(medium=Bitrate(bitrate=1e6, half_duplex=True))}, True),
        ({"network": Links(medium=Bitrate(bitrate=1e6, queue_limit=4))}, True),
        ({"network": Links(medium=Bitrate(bitrate=1e6, access=CsmaCa()))}, True),
        *(
            (
                {"network": Links(medium=Bitrate(bitrate=1e6, access=Tdma(), reception=INTERFERENCES.choice(kind)()))},
                False,
            )
            for kind in ("collision", "capture")
        ),
        ({"network": Links(medium=Bitrate(bitrate=1e6, access=Tdma(), reception=Sinr(noise=1e-9)))}, True),
        ({"network": Links(medium=Bitrate(bitrate=1e6, access=Tdma())), "fault": [ClockSkew(offset=0.1)]}, True),
        ({"network": Links(range=50.0), "motion": Motion(static=True)}, False),
        ({"network": Links(range=50.0, reception=QuasiUnitDisk()), "motion": Motion(static=True)}, False),
        ({"network": Links(range=50.0, fading="message"), "motion": Motion(static=True)}, False),
        (
            {"network": Links(range=50.0, reception=QuasiUnitDisk(), fading="message"), "motion": Motion(static=True)},
            True,
        ),
    ],
)
def test_information_gets_through_without_loss_or_with_heartbeats(trigger, given, lost):
    found = messages_get_through(four(announce=Announcements(trigger=trigger), **given))
    if trigger == "never":
        assert_reason(found, "nothing but the first action is ever announced")
        silent = four(announce=Announcements(trigger=trigger, start="silent"), **given)
        assert_reason(messages_get_through(silent), "nothing is ever announced")
    else:
        assert_reason(found, "never repeated" if lost and trigger == "change" else None)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("fading", ["message", "per_link"])
def test_the_initial_graph_has_the_links_over_which_messages_travel_while_nobody_moves(fading):
    links = Links(range=3.0, reception=QuasiUnitDisk(certain=0.0), fading=fading)
    scenario = four(network=links, motion=Motion(static=True), horizon=5.0, record=Recording(messages=True))
    graph, broadcasts = initial_graph(scenario), run(scenario).trace.of(Broadcast)
    heard = {(broadcast.src, dst) for broadcast in broadcasts for dst, arrival in broadcast.fates() if arrival != LOST}
    assert heard == {*graph.edges}
    assert (len(heard) == 12) == (fading == "message")


def test_a_pursuer_that_comes_into_range_has_missed_earlier_announcements():
    found = messages_get_through(four(announce=Announcements(trigger="change"), network=Links(range=50.0)))
    assert_reason(found, "comes into range")
    assert messages_get_through(four(network=Links(range=50.0))) is None


@pytest.mark.parametrize(
    ("dissemination", "fault", "why"),
    [
        (ReliableOneHop(), [], None),
        (ReliableOneHop(), [HALVES], None),
        (ReliableOneHop(), [Crash(start=0.0, node=0)], "may forget what it has acknowledged"),
        (ReliableOneHop(max_repeats=5), [], "never repeated"),
        (ReliableOneHop(lifespan=1.0), [], "never repeated"),
        (CodedOneHop(pieces=5), [], "never repeated"),
    ],
)
def test_information_gets_through_if_it_is_repeated_until_it_is_acknowledged(dissemination, fault, why):
    announce = Announcements(trigger="change", dissemination=dissemination)
    assert_reason(messages_get_through(four(network=LOSSY, announce=announce, fault=fault)), why)


@pytest.mark.parametrize("trigger", ["change", "never"])
@pytest.mark.parametrize("schedule", [TokenRing(), TokenWalk(), LocalMutex()], ids=lambda each: each.kind)
def test_information_gets_through_if_schedule_messages_carry_it(trigger, schedule):
    announce = Announcements(trigger=trigger)
    assert messages_get_through(four(network=LOSSY, announce=announce, protocol=BetterReply(schedule=schedule))) is None


@pytest.mark.parametrize(
    ("scenario", "why"),
    [
        (four(protocol=BestResponse(schedule=Rounds())), "the same instant"),
        (four(protocol=BestResponse(schedule=Rounds(participation=0.5))), "the same instant"),
        (Scenario(team=Team(count=2), protocol=BestResponse(schedule=Rounds())), "the same instant"),
        (Scenario(team=Team(count=1), protocol=BestResponse(schedule=Rounds())), None),
        *((four(protocol=BestResponse(schedule=s)), None) for s in (SharedSeed(), Poisson(), Periodic(), TokenRing())),
        (four(protocol=lambda me: iter(())), None),
    ],
)
def test_pursuers_decide_one_at_a_time_or_all_at_once(scenario, why):
    assert_reason(one_at_a_time(scenario), why)


@pytest.mark.parametrize(
    ("fault", "crashes", "skewed"),
    [
        ([], False, False),
        ([HALVES], False, False),
        ([Crash(start=0.0, node=0)], True, False),
        ([RandomCrashes()], True, False),
        ([RandomFaults()], True, False),
        ([ClockSkew(offset=0.1)], False, True),
        ([HALVES, ClockSkew(offset=0.1), Crash(start=0.0, node=0)], True, True),
    ],
)
def test_pursuers_break_down_and_clocks_differ_or_not(fault, crashes, skewed):
    assert_reason(no_crashes(four(fault=fault)), "break down" if crashes else None)
    assert_reason(equal_clocks(four(fault=fault)), "clocks differ" if skewed else None)


@pytest.mark.parametrize(
    ("team", "why"),
    [
        (Team(count=3, speeds=1.5), None),
        (Team(count=3, speeds=(1.0, 2.5, 1.0)), "speeds are 1 to 2.5 m/s"),
        (Team(count=3), "speeds are 1 to 2 m/s"),
        (Team(count=1), None),
        (Team(count=3, speeds=Speeds(default=2.0, last=2.0)), None),
    ],
)
def test_all_are_equally_fast_or_not(team, why):
    assert_reason(equal_speeds(Scenario(team=team)), why)


class Served(Rule):
    """A rule with a server on one of the pursuers."""

    host: int = 0


@pytest.mark.parametrize(
    ("scenario", "why"),
    [
        (four(protocol=Served(host=3)), None),
        (four(nx.star_graph(3), protocol=Served()), None),
        (four(nx.star_graph(3), protocol=Served(host=1)), "2 of 3 are out of reach of pursuer 1"),
        (four(nx.DiGraph([(0, 1), (0, 2), (0, 3)]), protocol=Served()), "3 of 3 are out of reach of pursuer 0"),
        (four(nx.DiGraph([(1, 0), (2, 0), (3, 0), (0, 3)]), protocol=Served()), "2 of 3 are out of reach"),
        (four(protocol=Served(), fault=[HALVES]), "partition"),
        (four(nx.star_graph(3)), None),
    ],
)
def test_the_host_of_a_server_is_in_reach_of_all_both_ways_or_not(scenario, why):
    """Without a host it is pursuer 0."""
    assert_reason(host_in_range(scenario), why)


@pytest.mark.parametrize(
    ("payload", "given", "times", "places"),
    [
        ("action", {"network": Links(range=1.0)}, None, None),
        ("time", {}, None, "contain no positions"),
        ("state", {}, None, None),
        ("time", {"network": Links(range=1.0)}, "not all pursuers hear", "contain no positions"),
        ("state", {"network": Links(range=1.0)}, "not all pursuers hear", "not all pursuers hear"),
        ("state", {"network": LOSSY, "trigger": "change"}, "never repeated", "never repeated"),
        ("action", {"evader": Evader(count=2)}, None, None),
        ("time", {"evader": Evader(count=2)}, "one evader only", "contain no positions"),
        ("state", {"evader": Evader(count=2)}, None, None),
    ],
)
def test_times_and_positions_are_known_if_sensed_or_announced_or_not(payload, given, times, places):
    trigger = given.get("trigger", "both")
    network = {key: each for key, each in given.items() if key != "trigger"}
    scenario = four(announce=Announcements(payload=payload, trigger=trigger), **network)
    assert_reason(times_known(scenario), times)
    assert_reason(positions_known(scenario), places)


# Messages.


def test_every_assumption_has_its_own_name_and_description():
    assert all(name == each.__name__ and each.__doc__ for name, each in ASSUMPTIONS.items())
    with pytest.raises(TypeError):
        ASSUMPTIONS["wishful"] = no_crashes


def test_a_violated_assumption_is_reported_with_its_protocol_and_reason():
    """The rule, its schedule and its utility each break one; all are warned of under their own key."""
    scenario = four(
        nx.path_graph(4),
        protocol=SpatialAdaptivePlay(schedule=Rounds()),
        fault=[ClockSkew(offset=0.1)],
    )
    hops = "not all pursuers hear each other at the start, and announcements are not forwarded"
    hops += " (`announce.dissemination`: flooding and gossip forward)"
    found = [
        ("protocol", "sap assumes one_at_a_time, but several pursuers may decide at the same instant"),
        ("protocol.schedule", "rounds assumes equal_clocks, but clocks differ"),
        ("protocol.utility", f"mean assumes everyone_heard, but {hops}"),
    ]
    assert list(violations(scenario)) == found
    assert [each for each in warnings(scenario) if " assumes " in each[1]] == found


@pytest.mark.parametrize(
    ("protocol", "assumes"),
    [
        (LocalMin(schedule=Poisson()), []),
        (ArgminKnown(schedule=Poisson()), ["everyone_heard"]),
        (BetterReply(schedule=Poisson()), ["everyone_heard"]),
        (FictitiousPlay(schedule=Poisson()), ["everyone_heard"]),
        (BetterReply(schedule=Poisson(), utility=EdgePenalty()), []),
        (BetterReply(schedule=Poisson(), utility=LocalMean()), []),
        (BetterReply(schedule=Poisson(), utility=Component()), ["component_heard"]),
    ],
    ids=repr,
)
def test_on_a_ring_protocols_that_need_more_than_their_neighbours_give_a_warning(protocol, assumes):
    scenario = Scenario(team=FOUR, network=Links(graph=Ring()), protocol=protocol)
    assert [why.split(",")[0].split()[-1] for _, why in violations(scenario)] == assumes


@pytest.mark.parametrize("kind", sorted(PROTOCOLS.choices()))
def test_no_protocol_breaks_anything_in_the_default_scenario(kind):
    """But for equal speeds, and the rounds of auctions."""
    protocol = PROTOCOLS.choices()[kind]()
    in_turns = [f"{kind} assumes rounds"] * (kind in {"cbaa", "cbba"})
    for speeds, of_speeds in ((Speeds(), ["voronoi assumes equal_speeds"] * (kind == "voronoi")), (2.0, [])):
        found = violations(Scenario(team=Team(speeds=speeds), protocol=protocol))
        assert [why.split(", but")[0] for _, why in found] == of_speeds + in_turns


class Wishful(Rule):
    assumes = ("good_weather",)


def test_an_unknown_assumption_is_an_error_that_lists_the_known_ones():
    assert get_args(AssumptionName) == tuple(ASSUMPTIONS)
    with pytest.raises(KeyedError, match=r"assumes of Wishful: should be 'undivided', .* \(got 'good_weather'\)"):
        four(protocol=Wishful())


def test_a_function_may_assume_something_too():
    """It has no kind, and is called the protocol; a function without a declaration assumes nothing."""

    def mine(me):
        yield from ()

    assert not list(violations(four(fault=[Crash(start=0.0, node=0)], protocol=mine)))
    mine.assumes = ("no_crashes",)
    scenario = four(fault=[Crash(start=0.0, node=0)], protocol=mine)
    assert list(violations(scenario)) == [("protocol", "the protocol assumes no_crashes, but pursuers break down")]


def test_a_dissemination_may_assume_something_too():
    """Its key is its own, and it is called by its kind."""

    class Tree(Flooding):
        kind: Literal["tree"] = "tree"
        assumes: ClassVar[tuple[str, ...]] = ("no_crashes",)

    announce = Announcements(dissemination=Tree())
    assert not list(violations(four(announce=announce)))
    found = list(violations(four(announce=announce, fault=[Crash(start=0.0, node=0)])))
    assert found == [("announce.dissemination", "tree assumes no_crashes, but pursuers break down")]


@pytest.mark.parametrize("trigger", ["change", "never", "heartbeat", "both"])
def test_announcements_are_repeated_by_heartbeats_only(trigger):
    reason = announcements_repeated(Scenario(announce=Announcements(trigger=trigger)))
    assert (reason is None) == (trigger in {"heartbeat", "both"})


def test_announcements_that_travel_too_few_hops_do_not_reach_a_component():
    """Of four on a path, the ends are three hops apart."""
    for hops, expected in (
        (2, "some pursuers are 3 hops apart at the start, but announcements travel at most 2"),
        (3, None),
    ):
        scenario = four(nx.path_graph(4), announce=Announcements(dissemination=Flooding(hops=hops)))
        assert component_heard(scenario) == expected

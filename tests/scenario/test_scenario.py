"""Scenarios as a script constructs them."""

import json
from math import inf

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim.config.choice import OneOf, kind_of
from desim.config.errors import KeyedError
from desim.kernel.models.latency import Constant as ConstantLatency
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.core.events import Decided, Ended
from desim.pursuit.team.announcements import Announcements
from desim.scenario.checks import warnings
from desim.scenario.players import Evader, Speeds, Team
from desim.scenario.scenario import PROTOCOLS, Recording, Scenario
from desim.simulation.run import run
from protocols.centralised import Centralised
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import SharedSeed
from protocols.temperature import PaperTau

SEEDS = st.integers(0, 2**63)
SHARES = st.floats(0, 1)


@pytest.mark.parametrize("speeds", [0.5, [0.25, 0.5, 0.0]])
def test_the_top_speed_of_a_team_is_that_of_its_fastest_pursuer(speeds):
    assert Team(count=3, speeds=speeds).top_speed == 0.5
    assert Team(count=1, speeds=0.0).top_speed == 0.0


def test_a_team_with_the_names_of_a_graph_has_its_order(tmp_path):
    (tmp_path / "starts.csv").write_text("t,node,x,y\n0,a,1,2\n0,b,3,4\n")
    team = Team(positions={"kind": "recorded", "file": str(tmp_path / "starts.csv")})
    numbered = team.numbered(("b", "a"))
    assert (numbered.names, numbered.positions) == (("b", "a"), ((3.0, 4.0), (1.0, 2.0)))
    for names in (("a", "b"), ("a", "c"), ("a",), ("a", "b", "c")):
        assert team.numbered(names) is team
    for other in (Team(positions=[(0.0, 1.0), (2.0, 3.0)]), Team(count=2)):
        assert other.numbered(("b", "a")) is other


PLACES = {"b": (3.0, 4.0), "a": (1.0, 2.0), "c": (5.0, 6.0)}


@pytest.mark.parametrize("order", ["abc", "cba", "bca"])
def test_positions_may_be_a_table_of_nodes_as_a_layout_of_networkx_is(order):
    graph = nx.Graph([("c", "a"), ("c", "b")])  # numbers them c, a, b
    team = Team(positions={name: np.array(PLACES[name]) for name in order})
    assert (team.count, team.names, team.positions) == (3, tuple(order), tuple(PLACES[name] for name in order))
    scenario = Scenario(team=team, network={"graph": graph})
    assert scenario.team.positions == tuple(PLACES[name] for name in scenario.network.graph.names)
    assert Scenario(**json.loads(scenario.model_dump_json())).team.positions == scenario.team.positions
    assert Scenario().with_({"team.positions": {name: PLACES[name] for name in order}}).team == team


@pytest.mark.parametrize("nodes", [(0, 1, 2), (2, 0, 1), (3, 1, 2), (30, 10, 20), np.array([3, 1, 2])])
def test_positions_of_numbered_nodes_are_in_ascending_order(nodes):
    places = dict(zip(nodes, PLACES.values(), strict=True))
    assert Team(positions=places).positions == tuple(places[node] for node in sorted(nodes))


@pytest.mark.parametrize(
    ("positions", "why"),
    [
        ({"a": (0, 1), 1: (2, 3)}, r"the nodes of the positions should be names, or integers \(got \['a', 1\]\)"),
        ({0.5: (0, 1)}, "should be names, or integers"),
        ({"a": (0, 1), "b": (0, 1, 2)}, r"positions\.1: should have at most 2 items, has 3"),
        ({"fil": "starts.csv"}, r"positions\.fil: unknown key, did you mean"),
        ({}, r"positions\.file: is missing"),
        ({"file": (0, 1)}, r"positions\.file: should be a string"),
    ],
)
def test_a_table_of_positions_that_is_neither_of_nodes_nor_of_a_file_is_refused(positions, why):
    with pytest.raises(KeyedError, match=why):
        Team(positions=positions)


def test_the_default_is_the_scenario_of_the_paper():
    """Lee & Bakolas, section "Simulation": 20 pursuers in 20 m x 20 m, one twice as fast, ideal network, t_f = 30 s."""
    scenario = Scenario()
    assert scenario.team.count == 20
    assert scenario.team.all_speeds() == [1.0] * 19 + [2.0]
    assert (scenario.horizon, scenario.evader.speed, scenario.capture.radius) == (30.0, 0.9, 0.1)
    assert scenario.protocol == SpatialAdaptivePlay(tau=PaperTau(scale=10.0), schedule=SharedSeed(slot=0.01))
    assert scenario.network == Links(range=inf, latency=ConstantLatency(value=0.0), loss=Bernoulli(p=0.0))
    assert list(warnings(scenario)) == []


@pytest.mark.parametrize("part", [(), ("team",), ("team", "speeds"), ("evader", "strategy"), ("protocol", "tau")])
def test_a_scenario_is_frozen_in_all_its_parts(part):
    scenario = Scenario()
    model = scenario
    for name in part:
        model = getattr(model, name)
    for field in type(model).model_fields:
        with pytest.raises(KeyedError, match="immutable"):
            setattr(model, field, getattr(model, field))
    assert scenario == Scenario()


def test_the_lists_that_a_script_gives_are_copied():
    positions, speeds = [[0.0, 0.0], [1.0, 1.0]], [1.0, 2.0]
    team = Team(positions=positions, speeds=speeds)
    positions[0][0] = speeds[0] = 9.0
    assert (team.positions, team.speeds) == (((0.0, 0.0), (1.0, 1.0)), (1.0, 2.0))


@pytest.mark.parametrize("positions", [((0, 0), (1, 1), (2, 2)), [[0, 0], [1, 1], [2, 2]]], ids=["tuples", "lists"])
def test_the_positions_of_a_team_determine_its_size(positions):
    team = Team(positions=positions)
    assert team.count == 3
    assert team == Team(count=3, positions=positions)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"count": 2, "positions": ((0, 0),)}, "count is 2, there are 1"),
        ({"count": 2, "speeds": (1, 2, 3)}, "count is 2, there are 3"),
        ({"positions": ((0, 0),), "speeds": (1, 2)}, "count is 1, there are 2"),
        ({"speeds": ()}, "count is 20, there are 0"),
    ],
)
def test_positions_and_speeds_that_disagree_with_the_count_are_refused_with_both_numbers(wrong, says):
    with pytest.raises(ValueError, match=says):
        Team(**wrong)


@pytest.mark.parametrize(
    ("speeds", "each"),
    [
        (1.5, [1.5, 1.5, 1.5]),
        ((1, 0, 3), [1.0, 0.0, 3.0]),
        (Speeds(default=1.0, last=2.0), [1.0, 1.0, 2.0]),
        ({"last": 4}, [1.0, 1.0, 4.0]),
        ({}, [1.0, 1.0, 2.0]),
    ],
)
def test_speeds_are_a_number_a_list_or_a_table(speeds, each):
    assert Team(count=3, speeds=speeds).all_speeds() == each


def test_a_team_of_one_has_the_speed_of_the_last():
    assert Team(count=1).all_speeds() == [2.0]


def test_given_positions_do_not_depend_on_the_seed():
    team, evader = Team(positions=((1, 2), (3, 4))), Evader(position=(5, 6))
    for seed in (0, 1):
        np.testing.assert_array_equal(team.start(seed), [[1.0, 2.0], [3.0, 4.0]])
        np.testing.assert_array_equal(evader.start(seed), [5.0, 6.0])


@settings(deadline=None)
@given(SEEDS)
def test_positions_are_drawn_in_the_box_for_each_seed(seed):
    team, evader = Team(count=7, box=(-3.0, -1.0)), Evader(box=(8.0, 9.0))
    assert team.start(seed).shape == (7, 2)
    assert ((team.start(seed) >= -3.0) & (team.start(seed) < -1.0)).all()
    assert ((evader.start(seed) >= 8.0) & (evader.start(seed) < 9.0)).all()
    for one in (team, evader):
        np.testing.assert_array_equal(one.start(seed), one.start(seed))
        assert (one.start(seed) != one.start(seed + 1)).all()


def test_evader_and_pursuers_start_apart_with_the_same_seed_and_box():
    pursuers, evader = Team(box=(0.0, 1.0)).start(3), Evader(box=(0.0, 1.0)).start(3)
    assert (pursuers != evader).all()


@settings(deadline=None)
@given(SEEDS, st.integers(1, 20), st.integers(1, 20))
def test_a_larger_team_begins_with_the_pursuers_of_a_smaller_one(seed, one, other):
    """The streams do not depend on what is swept, so two counts share their random numbers."""
    common = min(one, other)
    np.testing.assert_array_equal(Team(count=one).start(seed)[:common], Team(count=other).start(seed)[:common])


@settings(deadline=None)
@given(SEEDS, SHARES, SHARES)
def test_pursuers_active_at_a_small_share_are_active_at_a_larger_one(seed, one, other):
    """u_i < p0 with the same u_i for both; the share itself is 0, 1 or, over 4000 pursuers, p0 +- 5 s.e."""
    few, many = (Team(count=4000, active_at_start=p).start_profile(seed) for p in sorted((one, other)))
    assert not (few & ~many).any()
    assert abs(many.mean() - max(one, other)) <= 5 * np.sqrt(0.25 / 4000)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_no_pursuer_is_active_at_share_0_and_every_pursuer_at_share_1(share):
    assert (Team(count=4000, active_at_start=share).start_profile(3) == bool(share)).all()


def test_plain_is_strict_json_of_which_the_same_scenario_can_be_made():
    scenario = Scenario(name="relay", team=Team(positions=((0, 0),)), network=Links(range=3.0))
    plain = scenario.plain()
    assert Scenario.model_validate(json.loads(json.dumps(plain, allow_nan=False))) == scenario
    assert Scenario().plain()["network"]["range"] == "Infinity"


def test_the_protocols_that_come_with_it_are_installed():
    installed = PROTOCOLS.choices()
    assert installed["centralised"] is Centralised
    assert installed["sap"] is SpatialAdaptivePlay
    assert all(kind_of(model) == kind for kind, model in installed.items())


# What a script may pass beside models: anything that can be called.


def chase_at_once(me):
    """Begin to chase at 0.1 s, and never think again."""
    yield me.at(0.1)
    me.assign(True)
    me.announce()


def upwards(state, rng):
    """Flee along y."""
    return 1j


def half_a_second(context, rng):
    return 0.5


def to_even_nodes(context, rng):
    return context.dst % 2 == 0


@pytest.fixture(scope="module")
def own() -> Scenario:
    """Return a scenario in which everything that can be a function is one."""
    return Scenario(
        horizon=1.0,
        team=Team(positions=((0, 0), (0, -5), (0, -6)), speeds=2.0, active_at_start=0.0),
        evader=Evader(position=(0, 1), speed=0.5, strategy=upwards),
        protocol=chase_at_once,
        network=Links(latency=half_a_second, loss=to_even_nodes),
        announce=Announcements(trigger="revision", start="known"),
        record=Recording(messages=True),
    )


def test_functions_are_accepted_for_protocol_strategy_latency_and_loss(own):
    assert own.protocol is chase_at_once
    assert own.evader.strategy is upwards
    assert own.network.latency is half_a_second
    assert own.network.loss is to_even_nodes


def test_functions_take_effect_in_a_run(own):
    """Until 0.1 s the gap grows to 1.05 m; it closes at 2 - 0.5 m/s to 0.1 m, 0.95 / 1.5 s later.

    Of the three broadcasts at 0.1 s, those from 0 reach 1 alone, from 1 none, from 2 again 1 alone.
    """
    trace = run(own).trace
    assert [(each.t, each.active) for each in trace.of(Decided)] == [(100_000_000, True)] * 3
    (end,) = trace.of(Ended)
    assert (end.reason, end.capturer) == ("captured", 0)
    assert end.t == pytest.approx(1e9 * (0.1 + 0.95 / 1.5), abs=2)
    arrivals = [(each.src, each.dst, each.arrival) for each in trace if type(each).__name__ == "Broadcast"]
    lost, late = -1, 600_000_000
    assert arrivals == [(0, (1, 2), (late, lost)), (1, (0, 2), (lost, lost)), (2, (0, 1), (lost, late))]


@pytest.mark.parametrize(
    "wrong",
    [
        {"protocol": "sop"},
        {"protocol": {"kind": "sop"}},
        {"network": {"latency": True}},
        {"evader": {"strategy": None}},
    ],
    ids=str,
)
def test_a_value_that_is_neither_a_model_nor_callable_is_refused(wrong):
    with pytest.raises(KeyedError):
        Scenario(**wrong)


class Called:
    """Something that can be called, and has these attributes and no others."""

    def __init__(self, **attributes):
        vars(self).update(attributes)

    def __call__(self, *given):
        return 0.0

    def __repr__(self):
        return "<mine>"


@pytest.mark.parametrize(
    ("make", "place", "says"),
    [
        (
            lambda: Announcements(dissemination=Called()),
            "dissemination",
            "should have broadcast; <mine> (",
        ),
        (lambda: SpatialAdaptivePlay(schedule=Called()), "schedule", "should have mean_slot; <mine> ("),
        (
            lambda: Links(medium=Called(half_duplex=False, queue_limit=inf)),
            "medium",
            "should have shared, half_duplex, queue_limit; <mine> ",
        ),
        (lambda: Links(medium=Called()), "medium", "lacks shared, half_duplex, queue_limit"),
        (lambda: Links(latency=object()), "latency", "a built-in model or an object that can be called"),
    ],
    ids=["dissemination", "schedule", "medium without shared", "medium without anything", "latency without a call"],
)
def test_a_user_model_that_lacks_an_attribute_is_refused_at_once_with_its_name(make, place, says):
    with pytest.raises(KeyedError) as refused:
        make()
    (problem,) = refused.value.problems
    assert problem.key == place
    assert says in problem.reason


def needed_values():
    """Yield each attribute, other than a method, that the models of a family need, with a model of the family."""
    for family in OneOf.families:
        for name in family.needs:
            kinds = family.choices().values()
            if not any(callable(getattr(kind, name, None)) for kind in kinds):
                yield pytest.param(family, name, id=f"{next(iter(kinds)).__name__}.{name}")


@pytest.mark.parametrize("wrong", ["no", None, object(), lambda self: True], ids=["text", "None", "object", "method"])
@pytest.mark.parametrize(("family", "name"), [*needed_values()])
def test_a_needed_attribute_of_a_wrong_type_is_refused_in_every_family(family, name, wrong):
    """A text, or a method in place of its value, would count as true, or as the last of several names."""
    if wrong is None and name == "period":  # None: no reports
        return
    defaults = {key: field.default for key, field in family.traits.model_fields.items() if key in family.needs}
    model = type("Theirs", (), {"__call__": lambda self, *given: 0.0} | defaults | {name: wrong})()
    with pytest.raises(ValueError, match=rf"{name} of Theirs: should be"):
        family.traits.of(model)


@pytest.mark.parametrize("size", [-1, 2.5, None, True, float("nan")])
def test_a_size_that_is_no_number_of_bytes_is_refused(size):
    protocol = type("Theirs", (), {"__call__": lambda self, me: iter(()), "claim_size": lambda self, n, m: size})()
    with pytest.raises(KeyedError, match="protocol: the size of a message should be a number of bytes"):
        Scenario(protocol=protocol)


def test_a_complete_user_model_is_accepted():
    dissemination, schedule = Called(broadcast=print), Called(mean_slot=print)
    medium = Called(shared=False, half_duplex=False, queue_limit=inf)
    assert Announcements(dissemination=dissemination).dissemination is dissemination
    assert SpatialAdaptivePlay(schedule=schedule).schedule is schedule
    assert Links(medium=medium).medium is medium


@pytest.mark.parametrize(
    ("graph", "says"),
    [
        (lambda size: nx.complete_graph(size + 1), "simple graph of 3 nodes, got Graph with 4 nodes"),
        (lambda size: nx.complete_graph(size - 1), "simple graph of 3 nodes, got Graph with 2 nodes"),
        (lambda size: None, "NoneType"),
        (lambda size: [0, 1, 2], "list"),
        (lambda size: nx.MultiGraph(nx.complete_graph(size)), "simple graph of 3 nodes, got MultiGraph"),
        (lambda size: nx.path_graph(["a", "b", "c"]), "0 .. 2"),
    ],
    ids=["too large", "too small", "none", "list", "multigraph", "names"],
)
def test_a_user_graph_that_does_not_fit_the_team_is_refused(graph, says):
    with pytest.raises(KeyedError) as refused:
        Scenario(team=Team(count=3), network=Links(graph=graph))
    (problem,) = refused.value.problems
    assert problem.key == "network.graph"
    assert says in problem.reason

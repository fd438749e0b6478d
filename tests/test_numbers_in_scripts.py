"""Scripts give numbers of numpy and others to the functions of the package: a run is the same, or is refused."""

from datetime import timedelta
from decimal import Decimal
from fractions import Fraction

import networkx as nx
import numpy as np
import pandas as pd
import pytest

import desim
from desim import Announcements, Edges, Links, Recording, Scenario, Team, explain, run, summary, sweep
from desim.kernel.core.clock import Clock
from desim.kernel.core.seeds import stream
from desim.kernel.core.trace_file import line_of
from desim.kernel.core.units import SECOND
from desim.kernel.network import Network
from desim.results import run_folder

SHORT = Scenario(team=Team(count=3), horizon=0.3)
SEEDS = {"numpy": np.int64(3), "unsigned": np.uint8(3), "an array": np.array(3)}
NO_SEEDS = {"a float": 3.0, "a float of numpy": np.float64(3), "a text": "3", "true": True, "true of numpy": np.True_}


def takes_seed(seed):
    """Yield the functions that take a seed."""
    yield lambda: run(SHORT, seed)
    yield lambda: sweep(SHORT, {"horizon": [0.1]}, reps=1, seed=seed)
    yield lambda: explain(SHORT, 2, seed=seed)
    yield lambda: Network(Clock(), nx.path_graph(2), seed=seed)
    yield lambda: stream(seed, "x")


@pytest.mark.parametrize("seed", SEEDS)
def test_a_seed_is_an_integer_of_any_kind(seed):
    result = run(SHORT, SEEDS[seed])
    assert type(result.seed) is int
    assert list(result.trace) == list(run(SHORT, 3).trace)
    assert stream(SEEDS[seed], "x").random() == stream(3, "x").random()


@pytest.mark.parametrize("seed", NO_SEEDS)
def test_a_seed_that_is_not_an_integer_is_refused(seed):
    for act in takes_seed(NO_SEEDS[seed]):
        with pytest.raises(ValueError, match=r"^the seed should be an integer \(got "):
            act()


@pytest.mark.slow
def test_a_negative_seed_is_refused_and_a_huge_one_is_not(tmp_path):
    for act in takes_seed(np.int64(-1)):
        with pytest.raises(ValueError, match=r"^the seed should be at least 0, got -1$"):
            act()
    result = run(SHORT, 2**70)
    run_folder.write(result, tmp_path / "a")
    assert result.seed == 2**70


@pytest.mark.parametrize("reps", [2.0, "2", True])
def test_a_number_of_runs_or_of_workers_that_is_not_an_integer_is_refused(reps):
    with pytest.raises(ValueError, match=r"^reps should be an integer"):
        sweep(SHORT, {"horizon": [0.1]}, reps=reps)
    with pytest.raises(ValueError, match=r"^runs should be an integer"):
        explain(SHORT, reps)
    with pytest.raises(ValueError, match=r"^executor should be a number of processes"):
        sweep(SHORT, {"horizon": [0.1]}, 1, executor=reps if reps != "2" else [2])
    with pytest.raises(ValueError, match=r"^the half width of end_time should be a number"):
        sweep(SHORT, {"horizon": [0.1]}, 1, until=("end_time", "2"))
    with pytest.raises(ValueError, match=r"^a time limit, in s, should be a number"):
        sweep(SHORT, {"horizon": [0.1]}, 1, timeout="2")


@pytest.mark.slow
def test_a_sweep_takes_what_numpy_and_pandas_have():
    grid = {"horizon": np.array([0.1, 0.2]), "team.count": range(3, 5), "network.latency": pd.Series([0, 1])}
    found = sweep(SHORT, grid, reps=np.int8(1), seed=np.uint8(1), executor=np.int64(1), timeout=np.float32(60))
    plain = {"horizon": [0.1, 0.2], "team.count": [3, 4], "network.latency": [0, 1]}
    assert found.to_frame().equals(sweep(SHORT, plain, reps=1, seed=1).to_frame())


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(
    "value", [0.25, np.float32(0.25), np.float16(0.25), Fraction(1, 4), Decimal("0.25"), np.array(0.25)]
)
def test_an_edge_has_a_latency_and_a_loss_of_any_kind_of_number(value):
    def graph(size):
        made = nx.path_graph(size)
        made.edges[0, 1]["latency"], made.edges[1, 2]["loss"] = value, value
        return made

    links = Links(graph=Edges.of(graph(3)))
    first, second = links.graph.edges
    assert (repr(first.latency), repr(second.loss)) == ("Constant(value=0.25)", "Bernoulli(p=0.25)")
    runs = [run(SHORT.model_copy(update={"network": each}), 1) for each in (links, Links(graph=graph))]
    assert list(runs[0].trace) == list(runs[1].trace)


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("latency", "10 km", "should be a number without a unit"),
        ("latency", True, "should be a (table with a )?kind"),
        ("latency", [0.1], "should be a (table with a )?kind"),
        ("latency", -1.0, "should be greater than or equal to 0"),
        ("loss", np.float32(1.5), "should be less than or equal to 1"),
        ("loss", np.timedelta64(1, "s"), "should be a (table with a )?kind"),
    ],
)
def test_a_wrong_attribute_of_an_edge_is_refused_before_a_run(name, value, why):
    def graph(size):
        made = nx.path_graph(size)
        made.edges[0, 1][name] = value
        return made

    with pytest.raises(ValueError, match=f"network.graph: the {name} of the edge from 0 to 1: .*{why}"):
        SHORT.model_copy(update={"network": Links(graph=graph)})
    with pytest.raises(ValueError, match=f"the {name} of the edge from 0 to 1: .*{why}"):
        Network(Clock(), graph(2))
    with pytest.raises(ValueError, match=why):
        Edges.of(graph(3))


def protocol_of(number):
    """Return a protocol whose numbers are of one kind."""

    def protocol(me):
        if me.id == 0:
            me.send(number(1), "to one", size=number(40))
            me.send(None, "to all", size=number(50))
            yield me.sleep(number(0))
            me.assign(number(1))
            me.announce()
        yield me.at(number(1))

    return protocol


@pytest.mark.parametrize("number", [np.int8, np.uint64, np.array])
def test_a_protocol_may_use_integers_of_numpy_and_its_trace_is_the_same(number):
    scenario = Scenario(team=Team(count=3), horizon=2.0, record=Recording(messages=True), announce=Announcements())
    lines = []
    for kind in (int, number):
        result = run(scenario.model_copy(update={"protocol": protocol_of(kind)}), 1)
        lines.append([line_of(event) for event in result.trace])
    assert lines[0] == lines[1]


@pytest.mark.parametrize("number", [np.float32, np.float64, np.longdouble, Fraction, Decimal])
def test_a_protocol_may_wait_for_any_kind_of_number(number):
    def waits(kind):
        def protocol(me):
            yield me.sleep(kind(0.125))
            me.assign(me.id == 0)
            yield me.at(kind(0.25))
            me.assign(0)

        return protocol

    traces = [run(SHORT.model_copy(update={"protocol": waits(kind)}), 1).trace for kind in (float, number)]
    assert list(traces[0]) == list(traces[1])


@pytest.mark.parametrize(
    ("act", "why"),
    [
        (lambda me: me.sleep("0.1"), r"^pursuer 0: sleep: the duration should be a number \(got '0\.1'\)"),
        (lambda me: me.sleep(None), r"^pursuer 0: sleep: the duration should be a number \(got None\)"),
        (lambda me: me.at("0.1"), r"^pursuer 0: at: the time should be a number \(got '0\.1'\)"),
        (
            lambda me: me.send(1, "x", size=40.5),
            r"^the size of a message, in bytes, should be an integer",
        ),
        (
            lambda me: me.send(1, "x", size=np.int64(-1)),
            r"^the size of a message should be at least 0 bytes",
        ),
        (lambda me: me.send(1.0, "x"), r"^a node should be an integer \(got 1\.0\)"),
        (lambda me: me.send(np.int64(9), "x"), r"^there is no node 9: the nodes are 0 \.\. 2"),
    ],
)
def test_what_is_no_number_is_refused_with_a_sentence(act, why):
    def protocol(me):
        yield act(me)

    with pytest.raises(ValueError, match=why):
        run(SHORT.model_copy(update={"protocol": protocol}), 1)


NUMBERS = {
    "max_cycles": (2, lambda value: desim.parallel_env(SHORT, 1, max_cycles=value).max_cycles),
    "most": (1, lambda value: desim.fatal_losses(SHORT, IDLE, most=value, limit=99, jobs=1).most),
    "delay": (0.5, lambda value: desim.fatal_losses(SHORT, IDLE, delay=value, limit=99, jobs=1).delay),
    "zone": (0.5, lambda value: race(zone=value).zone),
    "confidence": (0.875, lambda value: race(zone=0.5, confidence=value).confidence),
    "first": (4, lambda value: race(zone=0.5, first=value).first),
    "horizon": (2.5, lambda value: desim.SteppedNetwork(3, horizon=value)._horizon / SECOND),
    "wait": (2.5, lambda value: len(desim.fates([(0.0, 0, 1, 8)], 2, wait=value)) * 2.5),
}
"""By argument of a function: a number that it takes, and a function that returns what becomes of it."""
IDLE = "idle at most 0.2 in total"


def race(**numbers):
    """Return a race whose result says how many runs a procedure of two stages would take."""
    brief = SHORT.with_({"horizon": 0.02})
    result = desim.race(brief, {"team.count": [3, 4]}, "messages_sent", maximise=True, most=8, **{"first": 4} | numbers)
    assert result.document()
    return result


@pytest.mark.slow
@pytest.mark.parametrize("name", NUMBERS)
def test_a_number_in_a_call_is_one_of_any_kind_or_refused(name):
    value, outcome = NUMBERS[name]
    kinds = (np.int8, np.array) if type(value) is int else (np.float32, Decimal)
    for kind in kinds:
        assert outcome(kind(value)) == value
        assert type(outcome(kind(value))) in {int, float}
    for wrong in (str(value), timedelta(seconds=value), True):
        with pytest.raises(ValueError, match=r"should be (a number|an integer)"):
            outcome(wrong)
    if type(value) is float:
        with pytest.raises(ValueError, match=r"should be a number up to 1\.8e308 \(got one of 401 digits\)"):
            outcome(10**400)


def test_a_node_of_a_network_is_an_integer_of_any_kind():
    network = Network(Clock(), nx.path_graph(3))
    network.publish(np.int64(0), "a", size=np.uint8(30))
    network.send(np.int8(0), np.array(1), "b")
    assert [record.src for _, record in network.latest_records(1).values()] == [0]
    assert [message.src for message in network.inbox(1).drain()] == [0]
    for node in (1.0, "1", True):
        with pytest.raises(ValueError, match=r"^a node should be an integer"):
            network.publish(node, "a")


def test_a_metric_may_return_any_kind_of_number():
    metrics = {"a": lambda result: Fraction(1, 4), "b": lambda result: np.array(2), "c": lambda result: Decimal("0.5")}
    numbers = summary(run(SHORT, 1), metrics)
    assert [(numbers[name], type(numbers[name])) for name in metrics] == [(0.25, float), (2, int), (0.5, float)]


PARTS = nx.Graph([(0, 3), (1, 2)])
UNORDERED = {
    "sets of networkx": nx.connected_components(PARTS),
    "a list of sets": [{3, 0}, {2, 1}],
    "frozen sets": (frozenset({3, 0}), frozenset({1, 2})),
    "integers of numpy": [{np.int64(3), np.int64(0)}, {np.int64(1), 2}],
}


@pytest.mark.parametrize("groups", UNORDERED)
def test_the_groups_of_a_partition_may_be_sets(groups):
    partition = desim.Partition(groups=UNORDERED[groups], start=0.1, end=0.2)
    assert partition == desim.Partition(groups=[[0, 3], [1, 2]], start=0.1, end=0.2)
    assert SHORT.with_({"team.count": 4, "fault": [partition]}).fault == (partition,)


def test_an_iterator_of_too_many_groups_is_refused_and_not_cut_off(monkeypatch):
    monkeypatch.setattr("desim.config.python_numbers.MAX_ITEMS", 3)
    assert len(desim.Partition(groups=({node} for node in range(3)), start=0.1, end=0.2).groups) == 3
    with pytest.raises(ValueError, match="an iterator without an end"):
        desim.Partition(groups=({node} for node in range(4)), start=0.1, end=0.2)


def test_nodes_whose_order_has_no_effect_may_be_a_set():
    assert desim.Slander(node=0, start=0.0, accused={2, 1}).accused == (1, 2)
    assert desim.LoRa(gateways={2, 0}, access="aloha").gateways == (0, 2)
    assert SHORT.with_({"fault": [{"kind": "partition", "groups": [{0}, {2, 1}], "start": 0.1, "end": 0.2}]})
    for wrong in ({"a", 1}, {1.5}, {(0, 1)}):
        with pytest.raises(ValueError, match="which has no order"):
            desim.Slander(node=0, start=0.0, accused=wrong)


def test_a_list_whose_order_counts_is_no_set():
    with pytest.raises(ValueError, match="which has no order"):
        desim.Tdma(slots={2, 1})

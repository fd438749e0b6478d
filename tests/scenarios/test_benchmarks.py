"""The benchmarks: every implementation delivers what it should, failures are reported, and costs are correct."""

import json
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from click.testing import CliRunner

from desim import run
from desim.analysis.metrics import end_time
from desim.kernel.core.clock import Clock
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND
from desim.kernel.models.access import CsmaCa
from desim.kernel.models.latency import Constant
from scenarios.benchmarks import __main__ as benchmarks
from scenarios.benchmarks import costs, learning_costs, measuring, rates, sweep_costs
from scenarios.benchmarks.peers import elsewhere, ways
from scenarios.benchmarks.peers.bare_loop import bare_loop
from scenarios.benchmarks.peers.elsewhere import PROGRAMS, Peer, UnavailableError
from scenarios.benchmarks.peers.simpy_ways import PerMessage
from scenarios.benchmarks.peers.workloads import LOGNORMAL, TICK, Outcome, Workload
from scenarios.studies.table1_runs import configuration, decentralised
from tests.scenarios.patching import patch_study

TINY = [
    Workload("T1: complete, constant", nx.complete_graph(5), 60, Constant(value=0.0151)),
    Workload("T2: star, constant", nx.star_graph(4), 60, Constant(value=0.0033)),
    Workload("T3: complete, lognormal", nx.complete_graph(6), 100, LOGNORMAL),
    Workload("T4: ladder, lognormal", nx.ladder_graph(4), 100, LOGNORMAL, seed=1),
]
PRINTS = "import sys; head, *lines = sys.stdin.read().splitlines(); print('noise'); print({!r})"
"""A program that reads its input and prints a line."""


def truth(work):
    """Return what a workload comes to, worked out message by message without any order of events."""
    rng, tables, delivered = stream(work.seed, "latency"), [{} for _ in work.graph], 0
    for number in range(work.turns):
        src = number % work.size
        for node in sorted(work.graph.adj[src]):
            constant = isinstance(work.latency, Constant)
            latency = work.latency.value if constant else float(work.latency.draw(1, rng)[0])
            if number * TICK + latency < work.end:
                delivered += 1
                tables[node][src] = max(number, tables[node].get(src, -1))
    return Outcome(delivered, tables)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", ways.WAYS)
@pytest.mark.parametrize("work", TINY, ids=lambda work: work.name[:2])
def test_every_implementation_has_delivered_all_arrived_messages_at_any_time(work, name):
    for turns in range(1, work.turns + 1, 7):
        part = replace(work, turns=turns)
        way = ways.WAYS[name](part)
        way.run()
        assert way.outcome() == truth(part), turns


@pytest.fixture
def few(monkeypatch, tmp_path):
    """Run the study with tiny workloads and return its document."""
    monkeypatch.setattr(benchmarks, "workloads", lambda: [replace(work, name="W" + work.name[1:]) for work in TINY])

    def study(*words):
        done = CliRunner().invoke(benchmarks.main, ["--runs", "1", "--out", str(tmp_path), "--json", *words])
        assert done.exit_code == 0, done.output
        return json.loads(done.stdout)

    return study


@pytest.mark.whole
def test_the_study_measures_all_ways_on_all_workloads(few, tmp_path):
    document = few("--parts", "broadcasts", "--no-peers", "--workloads", "W1,W4")
    measured = document["broadcasts"]
    assert [(each["workload"][:2], each["way"]) for each in measured] == [
        (work, way) for work in ("W1", "W4") for way in ways.WAYS
    ]
    assert document["missing"] == {}
    for each in measured:
        work = next(work for work in TINY if work.name[1:] == each["workload"][1:])
        assert each["deliveries"] == truth(replace(work, seed=0)).delivered
    text = (tmp_path / "benchmarks.txt").read_text()
    found = {(each["workload"][:2], each["way"]): each["per_second"] for each in measured}
    assert re.search(rf"^heapq +{found['W1', 'heapq'] / 1e3:,.0f} ", text, re.MULTILINE)
    ratios = [found[work, own] / found[work, "heapq"] for work in ("W1", "W4") for own in rates.DESIM_WAYS]
    assert re.search(r"^heapq +" + " +".join(f"{ratio:,.2f}" for ratio in ratios) + "$", text, re.MULTILINE)
    picture = (tmp_path / "benchmarks.svg").read_text()
    assert all(picture.count(f">{way}</text>") == 2 for way in ways.WAYS)


@pytest.mark.slow
def test_ways_and_workloads_can_be_chosen(few):
    rates = few("--parts", "broadcasts", "--only", "send,heapq", "--workloads", "W3")["broadcasts"]
    assert [(each["workload"][:2], each["way"]) for each in rates] == [("W3", "send"), ("W3", "heapq")]
    done = CliRunner().invoke(benchmarks.main, ["--only", "send,pigeon"])
    assert done.exit_code == 2
    assert "there is no 'pigeon'" in done.output


@pytest.mark.whole
def test_a_simulator_that_cannot_be_had_is_reported_and_the_rest_goes_on(few, monkeypatch, tmp_path):
    peer = Peer("peer_ns3.cpp", ("there-is-no-such-package",))
    monkeypatch.setattr(elsewhere, "PEERS", {"ns-3": peer})
    patch_study(monkeypatch, (benchmarks, rates), "PEERS", {"ns-3": peer})
    document = few("--parts", "broadcasts", "--only", "ns-3,publish", "--workloads", "W1")
    assert [each["way"] for each in document["broadcasts"]] == ["publish"]
    assert "apt-get" in document["missing"]["ns-3"]
    assert f"without ns-3: {document['missing']['ns-3']}" in (tmp_path / "benchmarks.txt").read_text()


@pytest.mark.slow
def test_an_implementation_with_other_deliveries_is_an_error(monkeypatch):
    class Forgetful(PerMessage):
        def outcome(self):
            delivered, tables = super().outcome()
            return Outcome(delivered, [{}, *tables[1:]])

    patch_study(monkeypatch, (benchmarks, rates), "WAYS", {"simpy-message": PerMessage, "forgetful": Forgetful})
    laps = rates.Laps(TINY[0], {}, {})
    laps.lap("simpy-message")
    with pytest.raises(RuntimeError, match="the final tables of forgetful differ"):
        laps.lap("forgetful")


def test_a_long_lap_is_not_repeated(monkeypatch):
    peers = {"slow": Peer("peer_mesa.py", ()), "fast": Peer("peer_mesa.py", ())}
    patch_study(monkeypatch, (benchmarks, rates), "PEERS", peers)
    commands = {
        name: [sys.executable, "-c", PRINTS.format(f'{{"deliveries": 240, "seconds": {seconds}}}')]
        for name, seconds in (("slow", rates.SLOW_LAP + 1.0), ("fast", 0.5))
    }
    laps = rates.Laps(TINY[0], commands, {})
    laps.lap("slow")
    laps.lap("fast")
    commands |= {name: [sys.executable, "-c", "raise SystemExit('again')"] for name in commands}
    laps.lap("slow")
    laps.lap("fast")
    assert [(each.way, each.per_second) for each in laps.rates()] == [("slow", 240 / (rates.SLOW_LAP + 1.0))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("says", "reason"),
    [
        (PRINTS.format('{"deliveries": 239, "seconds": 0.5}'), "239 deliveries instead of 240"),
        ("raise SystemExit('no such model')", "no such model"),
    ],
)
def test_a_simulator_that_fails_is_left_out_and_the_rest_goes_on(monkeypatch, says, reason):
    """60 turns to 4 neighbours each are 240 deliveries."""
    patch_study(monkeypatch, (benchmarks, rates), "PEERS", {"other": Peer("peer_mesa.py", ())})
    missing = {}
    laps = rates.Laps(TINY[0], {"other": [sys.executable, "-c", says]}, missing)
    for _ in range(2):
        for name in ("publish", "other", "heapq"):
            laps.lap(name)
    assert [each.way for each in laps.rates()] == ["publish", "heapq"]
    assert list(missing) == ["other"]
    assert reason in missing["other"]


def test_a_simulator_takes_its_share_of_the_turns_and_reports_their_duration():
    """A star of 5: the centre, whose turn comes first, reaches 4, the others 1 each; 30 turns are 6 x 8 deliveries."""
    says = [sys.executable, "-c", PRINTS.format('{"deliveries": 48, "seconds": 0.5}')]
    assert Peer("peer_mesa.py", (), share=0.5).run(says, TINY[1]) == (48, 0.5)
    with pytest.raises(UnavailableError, match="instead of 96"):
        Peer("peer_mesa.py", ()).run(says, TINY[1])


def test_simulators_receive_the_workload():
    assert elsewhere.text(TINY[1]) == "60 0.001 0.0033 0.0 0\n1 2 3 4\n0\n0\n0\n0\n"
    assert elsewhere.text(TINY[3]).startswith("100 0.001 0.02 0.5 1\n1 4\n")


def test_programs_of_other_simulators_stand_alone():
    for peer in elsewhere.PEERS.values():
        source = (PROGRAMS / peer.program).read_text()
        assert not re.search(r"^\s*(from|import) (desim|scenarios|protocols|\.)", source, re.MULTILINE)
        if peer.program.endswith(".py"):
            compile(source, peer.program, "exec")


@pytest.mark.slow
def test_the_bare_loop_is_the_pursuit():
    """Capture comes in about the same slot, whatever the draws: within 3 % for each of 20 seeds."""
    scenario = decentralised(configuration(40), 0.001)
    assert bare_loop(scenario, 0, 0.001) == pytest.approx(end_time(run(scenario, 0)) / 0.001, rel=0.05)


def test_nodes_drift_in_their_square_no_faster_than_their_stated_speed():
    clock = Clock()
    places = costs.Drifting(clock, 50, side=0.3, seed=0)
    before = places()
    path = np.zeros(50)
    for second in range(1, 41):
        clock.run(until=second * SECOND)
        here = places()
        assert (here >= 0.0).all()
        assert (here <= 0.3).all()
        assert np.array_equal(places.of(np.array([3, 17])), here[[3, 17]])
        step = np.hypot(*(here - before).T)
        assert (step <= places.max_speed + 1e-12).all()
        path += step
        before = here
    assert (path > 0.3).any()  # some node has been thrown back


@pytest.mark.slow
def test_a_large_team_is_not_captured_and_many_messages_are_as_many_as_asked():
    assert end_time(run(costs.large_team(30, 0.5), 0)) == 0.5
    scenario = costs.many_messages(20_000)
    count = costs.sent(run(scenario, 0))
    assert count == pytest.approx(20_000, rel=0.05)
    assert costs.kept(scenario, 0) == costs.streamed(scenario, 0) == count


def test_excessive_costs_are_marked():
    found = {
        "part": [
            measuring.Cost("much", 2.5, "s", 2.0),
            measuring.Cost("little", 1.5, "s", 2.0),
            measuring.Cost("any", 9, ""),
        ]
    }
    much, little, anything = measuring.table(found).splitlines()[2:]
    assert much.split() == ["much", "2.500", "2", "s", "MISSED"]
    assert little.split() == ["little", "1.500", "2", "s"]
    assert anything.split() == ["any", "9.000"]


@pytest.mark.slow
def test_the_study_measures_other_costs(few, monkeypatch):
    monkeypatch.setattr(costs, "SIZES", (20, 30, 50))
    monkeypatch.setattr(costs, "LARGE_TEAM", 20)
    monkeypatch.setattr(costs, "HORIZON", 0.2)
    monkeypatch.setattr(costs, "STREAMED", (2_000, 20_000))
    monkeypatch.setattr(costs, "apart", lambda function, *given: function(*given))
    found = few("--parts", "disk_graphs,complete,recording")["costs"]
    measured = {part: {each["what"]: each["measured"] for each in each_part} for part, each_part in found.items()}
    disks = measured["disk_graphs"]
    assert disks["N = 50 / N = 30"] == pytest.approx(disks["a message, N = 50"] / disks["a message, N = 30"])
    assert measured["complete"]["peak memory"] == pytest.approx(measuring.memory("VmHWM") / 1e6, rel=0.5)
    assert 0.5 < measured["recording"]["all kept / none"] < 10.0


@pytest.mark.whole
def test_the_study_measures_environments(few, monkeypatch):
    """An environment is slower than a run: here it runs twice."""

    def twice(env, _, seed):
        run(env.scenario, seed)
        return run(env.scenario, seed)

    for name, value in {"SIMULATED": 1.0, "TEAMS": (3,), "RULES": ("sap",), "play": twice}.items():
        monkeypatch.setattr(learning_costs, name, value)
    costs = few("--parts", "environments")["costs"]["environments"]
    relative = [cost["measured"] for cost in costs if cost["limit"] == learning_costs.RELATIVE_LIMIT]
    assert len(relative) == 8
    assert 1.3 < np.median(relative) < 3.0
    assert len(costs) == 18


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, pytest.param(2, marks=pytest.mark.whole)])
def test_the_study_measures_sweeps_and_large_stores(few, monkeypatch, processes):
    """In one process, which takes as much of a core as it can get; the case of two is seldom worth its time."""
    if processes == 1:
        swept = sweep_costs.sweep
        monkeypatch.setattr(sweep_costs, "ProcessPoolExecutor", lambda count, **_: ThreadPoolExecutor(count))
        monkeypatch.setattr(
            sweep_costs, "sweep", lambda base, grid, runs, _, **more: swept(base, grid, runs, 1, **more)
        )
    monkeypatch.setattr(sweep_costs, "SWEPT", 16)
    monkeypatch.setattr(sweep_costs, "STORED", 2_000)
    monkeypatch.setattr(sweep_costs, "GRID", {"network.latency.value": [0.0, 0.01], "team.count": [5, 6]})
    monkeypatch.setattr(sweep_costs, "apart", lambda function, *given: function(*given))
    found = few("--parts", "sweeps,large_store")["costs"]
    measured = {each["what"]: each["measured"] for part in found.values() for each in part}
    assert 0.0 < measured["driver, share of a core"] < (1.0 if processes == 2 else 2.0)
    assert min(measured.values()) > 0.0
    assert len(measured) == 10


@pytest.mark.whole
def test_a_process_of_its_own_has_memory_and_time_of_its_own():
    held = bytearray(200_000_000)
    assert 0.0 < measuring.apart(measuring.memory, "VmHWM") < measuring.memory("VmRSS") - 0.5 * len(held)
    assert 0.0 < measuring.command("-S", "-c", "pass") < measuring.command("-S", "-c", "import time; time.sleep(0.5)")


@pytest.mark.whole
def test_contention_has_the_same_results_in_plain_simpy(monkeypatch):
    """The share of messages that are delivered, in 5 runs each; the control is a window of 4 slots."""

    def shares(deliver):
        return np.array([delivered / sent for sent, delivered in (deliver(work, seed) for seed in range(5))])

    monkeypatch.setattr(costs, "AIRTIME", 0.0009)
    work = Workload("", nx.complete_graph(20), 400, LOGNORMAL)
    ours, plain = shares(costs.contended), shares(costs.contended_in_simpy)
    error = np.hypot(ours.std(ddof=1), plain.std(ddof=1)) / 5**0.5
    assert abs(ours.mean() - plain.mean()) < 3 * error
    monkeypatch.setattr(costs, "CsmaCa", lambda: CsmaCa(window=4))
    assert shares(costs.contended).mean() < plain.mean() - 3 * error

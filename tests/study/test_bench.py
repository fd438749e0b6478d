"""The benchmark: frozen files, scores by hand, intervals, and a protocol of a user beside the built-in ones."""

import json
import re
from functools import cached_property
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

from desim import Links, Motion, Recording, Scenario, Team, bench, run
from desim.analysis.drawing.palette import BLUE
from desim.analysis.metrics import active_time, idle_time
from desim.cli import main
from desim.study.ablation.imperfections import without_messages
from desim.study.comparing.bench import Entrants, frozen_matches
from desim.study.comparing.scores import APART, OMNISCIENT, Benchmark, Ratio
from desim.study.comparing.suite import AS_IT_IS, PERFECT, REFERENCE, SILENT, Suite, cost_of_runs, frozen_text
from desim.study.sweeps.sweep import RunError
from desim.study.workers.batch import seeds_from
from desim.study.workers.executors import workers_for
from scenarios.freeze import differences

SUITE = Suite.of()
DIGEST = "67e6167e6fe8cc84396091e82b9bd41afeb18c1275f5dcd1235a6ccb6a4160e7"
"""Of the scenarios and the protocols of version 1: whoever changes them makes version 2."""
DIGEST_OF_COSTS = "175142756a7fc78d7e0b19111b51526ae84b70f03176089dd95d3706805f9d9f"
"""Of the costs of version 1, and so of its table."""

# Frozen.


def test_the_files_and_the_costs_of_a_version_never_change():
    assert SUITE.digest == DIGEST
    assert SUITE.digest_of_costs == DIGEST_OF_COSTS
    assert frozen_text(SUITE.costs).encode() == (SUITE.folder / "costs.json").read_bytes()


def test_every_scenario_of_a_version_is_one_in_which_the_network_matters():
    frozen = bench()
    assert frozen.kept == tuple(SUITE.scenarios)
    assert min(frozen.apart(name) for name in SUITE.scenarios) > APART
    assert set(frozen.totals) == set(SUITE.protocols)
    assert frozen.runs == SUITE.runs


def test_the_reference_repeats_its_first_frozen_runs():
    """Also a digest of the simulator: a change of traces is a change of the table."""
    assert frozen_matches(SUITE, ["partition", "latency"])
    other = Suite.of()
    costs = {name: {REFERENCE: {AS_IT_IS: SUITE.costs[name][REFERENCE][AS_IT_IS] + 1e-6}} for name in SUITE.costs}
    vars(other)["costs"] = costs
    assert not frozen_matches(other, ["latency"])


@pytest.mark.parametrize("asked", [None, ["latency", "partition"], []])
def test_the_runs_that_are_repeated_are_those_of_all_scenarios_or_of_some(asked, monkeypatch):
    ran = []
    suite = SimpleNamespace(
        scenarios={name: SimpleNamespace(seed=k, name=name) for k, name in enumerate(["latency", "partition", "loss"])},
        costs={name: {REFERENCE: {AS_IT_IS: [2.0]}} for name in ("latency", "partition", "loss")},
    )
    monkeypatch.setattr("desim.simulation.run.run", lambda scenario, seed: ran.append((scenario.name, seed)))
    monkeypatch.setattr("desim.analysis.measuring.summary", lambda _: SimpleNamespace(active_time=1.0, idle_time=2.0))
    monkeypatch.setattr("desim.study.comparing.bench.cost_of_runs", lambda _, active, idle: active * idle)
    assert frozen_matches(suite, asked)
    names = list(suite.scenarios) if asked is None else asked
    assert ran == [(name, seeds_from(suite.scenarios[name].seed, 1)[0]) for name in names]


def test_few_runs_are_scored_in_the_same_scenarios():
    """A scenario is kept or not by all runs of the version; by two runs alone, the bounds are too close together."""
    few = bench(runs=2)
    assert few.kept == tuple(SUITE.scenarios)
    assert few.runs == 2
    assert "distance in standard errors of all runs of the version" in few.table()
    assert not re.search(r"\+- 0\.000\b", few.table())  # a half width is shown, however small
    assert Benchmark("1", few.costs).kept != few.kept


def test_pursuers_know_of_each_other_only_what_is_announced():
    assert all(scenario.announce.is_located for scenario in SUITE.scenarios.values())


@pytest.mark.slow
@pytest.mark.parametrize("name", SUITE.scenarios)
def test_a_rule_that_compares_positions_needs_messages_as_the_others_do(name):
    """Without messages nobody knows of the others, so all chase. The control: of teammates that are seen, one does."""
    silent = without_messages(SUITE.scenarios[name])
    unheard = silent.with_({"protocol": SUITE.protocols["argmin"]})
    seen = unheard.with_({"announce.payload": "action"})
    alone, compared, best = (active_time(run(scenario)) for scenario in (silent, unheard, seen))
    assert compared == pytest.approx(alone, rel=0.1)
    assert best < alone / 3.0


@pytest.mark.whole
def test_the_first_runs_of_all_protocols_have_their_frozen_costs(tmp_path):
    """`python -m scenarios.freeze` compares all."""
    assert list(differences(bench(runs=2, again=True, folder=tmp_path), SUITE)) == []


# By hand.


def benchmark_of(*, perfect, silent, **costs):
    """Return a benchmark of one scenario, given the costs of the bounds, and of each protocol on both networks."""
    reference = {PERFECT: np.array(perfect), SILENT: np.array(silent), AS_IT_IS: np.array(perfect)}
    others = {name: dict(zip((AS_IT_IS, PERFECT), map(np.array, pair), strict=True)) for name, pair in costs.items()}
    return Benchmark("1", {"one": {REFERENCE: reference, **others}})


def test_scores_are_between_the_bounds_and_a_bad_protocol_does_not_look_robust():
    """Bounds 10 and 50 s. `deaf` costs 40 s on every network: it loses nothing, and has a score of 1/4 all the same."""
    made = benchmark_of(
        perfect=[10.0, 10.1, 9.9],
        silent=[50.0, 50.1, 49.9],
        good=([20.0, 20.2, 19.8], [8.0, 8.1, 7.9]),
        deaf=([40.0, 40.1, 39.9], [40.0, 40.1, 39.9]),
    )
    assert made.kept == ("one",)
    values = {name: [part.value for part in (*total, total.loss)] for name, total in made.totals.items()}
    assert values == {
        REFERENCE: pytest.approx([1.0, 1.0, 0.0]),
        "good": pytest.approx([0.75, 1.05, 0.3]),
        "deaf": pytest.approx([0.25, 0.25, 0.0], abs=1e-12),
    }
    assert list(values) == [REFERENCE, "good", "deaf"]
    assert (made.best, made.is_behind("good"), made.is_behind(REFERENCE)) == (REFERENCE, True, False)


def test_a_benchmark_has_the_scores_of_each_scenario_in_its_document():
    made = benchmark_of(
        perfect=[10.0, 10.1, 9.9], silent=[50.0, 50.1, 49.9], good=([20.0, 20.1, 19.9], [8.0, 8.1, 7.9])
    )
    for name, protocol in made.document()["protocols"].items():
        assert protocol["scenarios"].keys() == {"one"}
        assert protocol["scenarios"]["one"].keys() == protocol["total"].keys()
        assert protocol["behind"] == made.is_behind(name)
    equal = benchmark_of(perfect=[10.0] * 3, silent=[50.0] * 3)
    assert equal.document()["scenarios"] == {"one": {"distance": "Infinity", "kept": True}}


@pytest.mark.slow
def test_the_figure_has_the_totals_and_the_scores():
    made = benchmark_of(
        perfect=[10.0, 10.1, 9.9], silent=[50.0, 50.1, 49.9], good=([20.0, 20.1, 19.9], [8.0, 8.1, 7.9])
    )
    totals, scores = made.plot().axes
    (quality, score), *_ = zip(*[iter(totals.containers)] * 2, strict=True)
    assert [drawn[0].get_xdata()[0] for drawn in (quality, score)] == pytest.approx([1.0, 1.0])
    assert {drawn[0].get_markerfacecolor() for drawn in totals.containers} == {"white", BLUE}
    assert [text.get_text() for text in scores.texts] == ["1.00", "0.75"]
    assert [text.get_text().partition(":")[0] for text in totals.get_legend().get_texts()] == ["quality", "score"]


@pytest.mark.parametrize(("factor", "is_behind"), [(0.99, False), (1.01, True)])
def test_a_protocol_is_behind_from_a_bound_for_all_ordered_pairs_on(factor, is_behind):
    """Of 16 pairs, t at 1 - 0.05 / 6 with 15 degrees of freedom: three protocols have six ordered pairs."""
    noise = np.array([1.0, -1.0] * 8)
    least = factor * stats.t.ppf(1.0 - 0.05 / 6, 15) * noise.std(ddof=1) / 4.0
    behind = 10.0 + least + noise
    made = benchmark_of(perfect=[10.0] * 16, silent=[50.0] * 16, worse=(behind, behind), bad=([40.0] * 16, [40.0] * 16))
    assert made.best == REFERENCE
    assert (made.is_behind("worse"), made.is_behind("bad")) == (is_behind, True)


@pytest.mark.slow
def test_equal_protocols_are_seldom_said_to_be_behind_the_one_that_looks_best():
    """In at most 5 % of all benchmarks, within 3 standard errors; a bound for pairs with a known best has 20 %."""
    rng, count = np.random.default_rng(5), 150
    wrong = 0
    for _ in range(count):
        pairs = {f"p{k}": ((costs := rng.normal(20.0, 1.0, 16)), costs) for k in range(12)}
        made = benchmark_of(perfect=[30.0] * 16, silent=[60.0] * 16, **pairs)
        wrong += any(made.is_behind(name) for name in pairs)
    assert wrong / count <= 0.05 + 3.0 * (0.05 * 0.95 / count) ** 0.5


def test_without_a_difference_of_the_bounds_nothing_is_scored():
    """The control of the rule: here the network cannot matter, by as much as a run varies."""
    made = benchmark_of(perfect=[10.0, 12.0, 11.0], silent=[10.1, 11.9, 11.0], good=([9.0] * 3, [9.0] * 3))
    assert made.apart("one") == pytest.approx(0.0, abs=1e-9)
    assert (made.kept, made.totals, made.best) == ((), {}, None)
    assert "left out: one: the bounds are not more than 10 standard errors apart" in made.table()
    assert benchmark_of(perfect=[1.0, 2.0], silent=[1.0, 2.0]).kept == ()
    with pytest.raises(ValueError, match="too few runs for a figure"):
        made.plot()


class Own(Suite):
    """A suite of one small scenario."""

    @cached_property
    def scenarios(self):
        return {"small": SMALL}

    @cached_property
    def protocols(self):
        return {REFERENCE: SMALL.protocol, "argmin": {"kind": "argmin", "slot": 0.2}}


SMALL = Scenario(
    name="small",
    horizon=20.0,
    team=Team(count=4, speeds=3.0, box=(0.0, 5.0)),
    motion=Motion(step=0.1),
    protocol={"kind": REFERENCE, "schedule": {"kind": "poisson", "rate": 5.0}},
    network=Links(latency=0.5),
    record=Recording(trajectory=0.0),
)


def measured(suite, count=3, **protocols):
    with workers_for(1) as workers:
        return Entrants(suite, protocols, again=True).carry_out(count, workers)


@pytest.mark.slow
def test_a_scenario_stays_only_if_the_network_matters_in_it(monkeypatch):
    """With one pursuer there is nothing to agree on: its bounds are equal in every run."""
    made = measured(Own("1"), 6)
    assert made.apart("small") > 3.0
    assert (np.diff(made.costs["small"]["argmin"][PERFECT] - made.costs["small"]["argmin"][AS_IT_IS]) == 0.0).all()
    monkeypatch.setitem(globals(), "SMALL", SMALL.with_({"team.count": 1}))
    alone = measured(Own("1"))
    assert alone.apart("small") == 0.0
    assert alone.kept == ()


def test_a_cost_counts_a_second_without_a_pursuer_as_one_in_which_all_chase():
    assert list(cost_of_runs(SMALL, np.array([3.0, 0.0]), np.array([0.5, 2.0]))) == [5.0, 8.0]


# Intervals.

STUDIES = 2000


@pytest.mark.slow
def test_the_interval_of_a_score_covers_it_as_often_as_it_says():
    """24 seeds, costs that share a gamma factor; the interval that takes both means as independent is too wide."""
    rng = np.random.default_rng(0)
    covered = np.zeros((STUDIES, 2))
    for k in range(STUDIES):
        length = rng.gamma(8.0, 1.0, 24)
        perfect, silent, costs = (factor * length * rng.gamma(40.0, 1 / 40.0, 24) for factor in (1.0, 7.0, 2.5))
        made = Ratio.of(silent - costs, silent - perfect).estimate
        width = silent - perfect
        apart = np.hypot(np.std(silent - costs) / width.mean(), made.mean * np.std(width) / width.mean())
        covered[k] = np.abs(made.mean - 0.75) <= (made.half_width, 2.07 * apart / np.sqrt(24))
    error = np.sqrt(0.95 * 0.05 / STUDIES)
    share, unpaired = covered.mean(axis=0)
    assert share == pytest.approx(0.95, abs=0.01 + 3.0 * error)
    assert unpaired > 0.95 + 3.0 * error


# A protocol of a user.


@pytest.mark.slow
def test_a_protocol_that_is_a_built_in_one_has_its_frozen_costs_exactly():
    made = bench({"mine": SUITE.protocols["argmin"]}, runs=2)
    for scenario in SUITE.scenarios:
        for network in (AS_IT_IS, PERFECT):
            mine, theirs = (made.costs[scenario][name][network] for name in ("mine", "argmin"))
            assert mine.tolist() == theirs.tolist(), (scenario, network)


def idle(me):
    """Leave the evader alone."""
    me.assign(False)
    yield me.sleep(1e3)


def failing(me):
    """Fail."""
    yield me.sleep(0.1)
    raise RuntimeError("for good")


@pytest.mark.slow
def test_a_protocol_that_does_nothing_is_worse_than_one_without_messages(monkeypatch, tmp_path):
    """It costs as much as if all chased up to the horizon, and stands in the table beside the others."""
    monkeypatch.setattr(Suite, "scenarios", {name: SUITE.scenarios[name] for name in ("latency", "partition")})
    monkeypatch.setattr(Suite, "costs", {name: SUITE.costs[name] for name in ("latency", "partition")})
    made = bench(idle, folder=tmp_path)
    assert set(made.costs["latency"]["idle"][AS_IT_IS]) == {8 * 30.0}
    assert list(made.totals)[-1] == "idle"
    assert made.totals["idle"].score.value < 0.0
    assert "\n> idle" in made.table()
    assert {path.name for path in tmp_path.glob("*.sqlite")} == {"latency.sqlite", "partition.sqlite"}
    told = r"the run of scenario = latency, protocol = failing, network = as it is with seed 1\d+ failed: .*for good \("
    with pytest.raises(RunError, match=told):
        bench(failing, runs=2)


def test_a_benchmark_of_one_short_scenario_has_the_costs_of_its_runs(monkeypatch, tmp_path):
    """The tests above take seconds."""
    short = Scenario(horizon=0.3, team=Team(count=2))
    monkeypatch.setattr(Suite, "scenarios", {"short": short})
    monkeypatch.setattr(Suite, "protocols", {"argmin": "argmin"})
    made = bench([idle, {"kind": "argmin"}], runs=2, again=True, folder=tmp_path)
    costs = made.costs["short"]
    assert {name: [*networks] for name, networks in costs.items()} == {
        **{name: [AS_IT_IS, PERFECT] for name in ("argmin", "idle", "argmin (2)")},
        REFERENCE: [SILENT],
    }
    assert costs["idle"][AS_IT_IS].tolist() == [2 * 0.3] * 2
    runs = [run(short.with_({"protocol": "argmin"}), seed) for seed in seeds_from(short.seed, 2)]
    assert costs["argmin"][AS_IT_IS].tolist() == [active_time(result) + 2 * idle_time(result) for result in runs]
    assert costs["argmin (2)"][PERFECT].tolist() == costs["argmin"][PERFECT].tolist()
    assert [path.name for path in tmp_path.iterdir()] == ["short.sqlite"]
    with pytest.raises(ValueError, match=r"sapp takes part in no scenario: protocol\.kind: there is no 'sapp'"):
        bench("sapp", runs=2, again=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("protocols", "why"),
    [
        ("sapp", r"sapp takes part in no scenario: protocol.kind: there is no 'sapp', did you mean 'sap'\?"),
        ({"mine": "sapp"}, "mine takes part in no scenario: protocol.kind: there is no"),
        (Own, r"Own takes part in no scenario: protocol: should be an instance: Own\(\) instead of Own"),
        (3, "protocol: should be a table with a kind"),
        ([{"knd": "sap"}], "protocol: should be a table with a kind"),
        ({"kind": "sap", "tauu": 1}, "protocol.tauu: unknown key, did you mean 'tau'"),
    ],
)
def test_what_is_no_protocol_is_told(protocols, why):
    with pytest.raises(ValueError, match=why):
        bench(protocols, runs=2)


@pytest.mark.parametrize("timeout", ["soon", 0.0, -1.0])
def test_a_time_limit_that_is_none_is_told_even_if_nothing_runs(timeout):
    with pytest.raises(ValueError, match="a time limit"):
        bench(timeout=timeout)


def test_names_that_are_there_already_get_a_number():
    made = Entrants(SUITE, {})
    assert made.runs(16) == 1
    from desim.study.comparing.bench import _by_name

    assert list(_by_name(["sap", {"kind": "sap"}, idle], SUITE)) == ["sap (2)", "sap (3)", "idle"]
    assert list(_by_name({"kind": "sap"}, SUITE)) == ["sap (2)"]
    assert list(_by_name({"mine": idle}, SUITE)) == ["mine"]


# The command.


def command(*arguments):
    return CliRunner().invoke(main, ["bench", *map(str, arguments)])


@pytest.mark.slow
def test_the_command_prints_the_table_of_the_version():
    result = command()
    assert result.exit_code == 0
    assert result.stdout == f"{bench()}\n"
    assert json.loads(command("--json").stdout)["protocols"].keys() == SUITE.protocols.keys()
    assert f"({OMNISCIENT})" in result.stdout


@pytest.mark.slow
def test_the_table_of_the_version_is_written_into_a_folder_that_is_asked_for(tmp_path):
    assert command("-n", 2, "-o", tmp_path / "new").exit_code == 0
    written = json.loads((tmp_path / "new" / "bench.json").read_text())
    assert written["protocols"].keys() == SUITE.protocols.keys()
    assert (tmp_path / "new" / "bench.txt").read_text() == f"{bench(runs=2)}\n"


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--version", "2"], "there is no version 2 of the benchmark; allowed: 1"),
        (["-n", 1000], "-n should be 2 to 16"),
        (["--runs", 1000], "--runs should be 2 to 16"),
        (["-n", 1], "1 should be a whole number of at least 2"),
        (["--protocol", "sapp"], "--protocol sapp: protocol.kind: there is no 'sapp', did you mean 'sap'?"),
        (["--protocol", "my_rules:Mine"], "allow-import"),
        (["--protocol", "{ kind = 'sap', tauu = 1 }"], "tau"),
    ],
)
def test_the_command_says_what_is_wrong(arguments, why, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = command(*arguments)
    assert result.exit_code == 2
    assert why in result.output
    assert list(tmp_path.iterdir()) == []


RULE = """
def nearest(me):
    while True:
        yield me.sleep(0.2)
        others = [me.time_left(), *me.believed_chasers().values()]
        me.assign(all(me.capture_time() <= phi for phi in others))
        me.announce()
"""


def test_the_command_keeps_the_runs_of_a_protocol_in_its_folder(tmp_path, monkeypatch):
    asked, made = (
        [],
        benchmark_of(perfect=[10.0, 10.1, 9.9], silent=[50.0, 50.1, 49.9], good=([20.0, 20.1, 19.9], [8.0, 8.1, 7.9])),
    )

    def measured(entered, runs, executor, **options):
        asked.append((options["folder"], options["again"]))
        return made

    monkeypatch.setattr("desim.study.comparing.bench.bench", measured)
    assert command("--again", "-o", tmp_path / "out").exit_code == 0
    assert command().exit_code == 0
    assert asked == [(tmp_path / "out", True), (None, False)]
    assert json.loads((tmp_path / "out" / "bench.json").read_text()) == made.document()


BAD = """
def late(me):
    yield me.sleep(0.2)
    raise RuntimeError("no idea")

def wrong(me):
    yield me.sleep(0.2)
    me.assign("chase")

def plain(me):
    return 3

def nothing():
    yield 1

THREE = 3
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "code", "why"),
    [
        ("late", 3, "protocol = late, network = as it is with seed 1000000 failed: RuntimeError: no idea ("),
        ("wrong", 3, "protocol = wrong, network = as it is with seed 1000000 failed:"),
        ("plain", 3, "protocol = plain, network = as it is with seed 1000000 failed:"),
        ("nothing", 2, "--protocol bad.py:nothing: protocol: should accept a call with (me)"),
        ("THREE", 2, "--protocol bad.py:THREE: protocol: 'bad:THREE' should be callable (got 3)"),
        ("none", 2, "--protocol bad.py:none: protocol"),
    ],
)
def test_a_protocol_that_fails_is_told_in_a_sentence(tmp_path, monkeypatch, name, code, why):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("desim.study.comparing.bench.frozen_matches", lambda _: True)
    (tmp_path / "bad.py").write_text(BAD)
    result = command("--protocol", f"bad.py:{name}", "-n", 2, "--allow-import", "-o", "x")
    assert result.exit_code == code
    assert why in result.stderr
    assert "Traceback" not in result.output
    assert (result.stderr.splitlines()[-1] == "the finished runs are in x") == (code == 3)


@pytest.mark.whole
def test_a_protocol_in_a_file_is_entered_by_one_argument(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rules").mkdir()
    (tmp_path / "rules/my.py").write_text(RULE)
    result = command("--protocol", "rules/my.py:nearest", "-n", 8, "--allow-import")
    assert result.exit_code == 0, result.output
    assert "\n> nearest" in result.stdout
    assert {"bench.txt", "bench.json", "bench.svg"} <= {path.name for path in (tmp_path / "out/bench/v1").iterdir()}
    before = (tmp_path / "out/bench/v1/bench.txt").read_text()
    assert command("--protocol", "rules/my.py:nearest", "-n", 8, "--allow-import").stdout == before


def test_the_committed_table_is_that_of_the_version():
    assert (SUITE.folder / "table.txt").read_text(encoding="utf-8") == f"{bench()}\n"

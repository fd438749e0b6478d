"""Studies: what they measure is what the simulator does, and what they print is what they measured."""

import json
from math import inf, nan

import numpy as np
import pytest
from click.testing import CliRunner

from desim import Scenario, load, run, summary
from desim.analysis.metrics import active_time, network_regret
from desim.kernel.core.events import Broadcast, Sent, Trace
from desim.kernel.core.units import nanoseconds
from desim.pursuit.core.events import Decided, Ended, Started
from desim.pursuit.core.state import complex_points
from desim.scenario.players import Team
from desim.scenario.scenario import PROTOCOLS, Recording
from desim.simulation.run import Result
from desim.study.workers.batch import run_many, seeds_from
from protocols.local_min import LocalMin
from scenarios import (
    bodies,
    boids,
    breaking,
    coherence,
    contention,
    delay,
    evaders,
    figures,
    find_table1,
    first_picture,
    freeze,
    learning,
    liars,
    many,
    rivals,
    start,
    table1,
    transport,
    two_clocks,
    walls,
)
from scenarios import range as ranges
from scenarios.benchmarks import __main__ as benchmarks
from scenarios.studies import (
    bodies_runs,
    coherence_runs,
    contention_runs,
    liars_runs,
    range_runs,
    rivals_runs,
    start_runs,
    transport_runs,
)
from scenarios.studies.study import SCENARIOS, Options, expected_time
from tests.command import strict_json
from tests.scenarios.patching import patch_study
from tests.summaries import changed

STUDIES = (
    benchmarks,
    bodies,
    boids,
    coherence,
    contention,
    delay,
    evaders,
    figures,
    find_table1,
    learning,
    liars,
    many,
    ranges,
    rivals,
    start,
    table1,
    transport,
    two_clocks,
    walls,
)


def test_each_study_tells_first_how_long_it_takes():
    """From the time of one run of each cell, and of what is done once."""
    assert expected_time(2.0, 30, 2, once=60.0) == "takes about 2 min of CPU time, 1 min on 2 idle cores"
    assert expected_time(6.0, 10, 1) == "takes about 1 min of CPU time, 1 min on 1 idle core"
    assert expected_time(6.0, 1800, 2) == "takes about 3 h of CPU time, 1.5 h on 2 idle cores"
    texts = [file.read_text(encoding="utf-8") for file in SCENARIOS.glob("*.py")]
    studies = [text.partition("@study(")[2].partition("def main")[0] for text in texts if "@study(" in text]
    assert len(studies) > 15
    assert all("seconds=" in options for options in studies)


@pytest.mark.parametrize("module", STUDIES, ids=lambda module: module.__name__)
def test_a_study_has_a_description(module):
    done = CliRunner().invoke(module.main, ["--help"])
    assert done.exit_code == 0
    assert module.__doc__.split()[0] in done.output


MAX_TIME = ("decentralised", 40, 0.001)


@pytest.fixture(scope="module")
def cells(tmp_path_factory):
    """Run Table I but for its longest cell, and return its cells and its table."""
    folder, kept = tmp_path_factory.mktemp("table1"), {k: v for k, v in table1.PUBLISHED.items() if k != MAX_TIME}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table1, "PUBLISHED", kept)
        done = CliRunner().invoke(table1.main, ["--runs", "2", "--jobs", "1", "--out", str(folder), "--json"])
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)["cells"], (folder / "table1.txt").read_text()


@pytest.mark.whole
def test_table_1_has_every_cell_and_both_starts(cells):
    found = {(c["algorithm"], c["pursuers"], c["delta"], c["start"]) for c in cells[0]}
    assert found == {
        (algorithm, count, delta, start)
        for algorithm, count, delta in table1.PUBLISHED.keys() - {MAX_TIME}
        for start in (["any"] if algorithm == "centralised" else table1.STARTS)
    }
    assert len(found) == 16
    for cell in cells[0]:
        assert f"{cell['measured']:.4f}" in cells[1]
        assert f"{cell['published']:.4f}" in cells[1]


@pytest.mark.slow
def test_the_centralised_cells_of_table_1_are_within_1_percent(cells):
    central = [cell for cell in cells[0] if cell["algorithm"] == "centralised"]
    assert all(cell["ratio"] == pytest.approx(1.0, abs=0.01) for cell in central)
    assert {(cell["runs"], cell["standard_error"]) for cell in central} == {(1, 0.0)}


@pytest.mark.slow
@pytest.mark.parametrize("count", [20, 40])
def test_the_centralised_cells_of_table_1_depend_on_neither_seed_nor_start(count):
    def found(scenario, seed):
        share = scenario.model_copy(update={"team": scenario.team.model_copy(update={"active_at_start": 0.5})})
        return [active_time(run(each, seed)) for each in (scenario, share)]

    base = table1.configuration(count)
    central, other = table1.centralised(base, 0.1), table1.decentralised(base, 0.1)
    assert len({time for seed in range(3) for time in found(central, seed)}) == 1
    assert len({time for seed in range(3) for time in found(other, seed)}) > 1


@pytest.mark.slow
def test_the_decentralised_cells_of_table_1_are_near_if_all_start_active_and_far_if_not(cells):
    """Two runs: a standard deviation of at most 14 % of the mean gives 10 %; the mean over five cells 4.4 %.

    The random start, the control, is 26 % lower on the average.
    """
    ratios = {start: np.mean([cell["ratio"] for cell in cells[0] if cell["start"] == start]) for start in table1.STARTS}
    assert ratios["all active"] == pytest.approx(1.0, abs=3 * 0.044)
    assert ratios["random"] < 1.0 - 3 * 0.044


@pytest.mark.slow
def test_heartbeats_that_table_1_does_without_would_change_nothing_but_the_number_of_messages():
    base = table1.configuration(20)
    without = table1.decentralised(base, 0.01, 0.5)
    beating = without.model_copy(update={"announce": base.announce})
    silent, repeated = (summary(run(each, 4)) for each in (without, beating))
    assert (silent.active_time, silent.switches) == (repeated.active_time, repeated.switches)
    assert silent.messages_sent < repeated.messages_sent / 2


@pytest.mark.slow
def test_a_cell_of_table_1_is_the_mean_of_the_runs_it_names():
    scenario = table1.decentralised(table1.configuration(20), 0.1, 0.5)
    times = [summary(run(scenario, seed)).active_time for seed in (4, 5, 6)]
    cell = table1._cell("decentralised", 20, 0.1, "random", times)
    assert cell.measured == pytest.approx(np.mean(times))
    assert cell.standard_error == pytest.approx(np.std(times, ddof=1) / np.sqrt(3))
    assert cell.ratio == pytest.approx(np.mean(times) / 55.59)


@pytest.mark.parametrize("count", [20, 40])
def test_the_configurations_of_table_1_are_from_the_papers_boxes(count):
    """x_i in [0, 20]^2, x_e in [8, 12]^2, v_i = 1, v_N = 2, v_e = .9, eps = .1, t_f = 30."""
    scenario = table1.configuration(count)
    at, evader = np.array(scenario.team.positions), np.array(scenario.evader.position)
    assert at.shape == (count, 2)
    assert ((at >= 0) & (at <= 20)).all()
    assert ((evader >= 8) & (evader <= 12)).all()
    assert scenario.team.all_speeds() == [1.0] * (count - 1) + [2.0]
    assert (scenario.evader.speed, scenario.capture.radius, scenario.horizon) == (0.9, 0.1, 30.0)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("delta", [0.1, 0.01])
def test_the_search_judges_configurations_as_the_simulator_does(delta):
    """Its loop over many configurations at once gives the active times of Algorithm 3 in the simulator."""
    base = table1.configuration(20)
    rng = np.random.default_rng(0)
    team, evader = rng.uniform(0, 20, (5, 20, 2)), rng.uniform(8, 12, (5, 2))
    fast = find_table1.centralised_times(
        np.array([complex_points(each) for each in team]), complex_points(evader), base, delta
    )
    for points, point, time in zip(team.tolist(), evader.tolist(), fast, strict=True):
        scenario = table1.centralised(find_table1._placed(base, points, point), delta)
        assert summary(run(scenario)).active_time == pytest.approx(time, abs=1e-9)


@pytest.mark.parametrize(
    ("option", "value", "why"),
    [
        ("--team", "30", "'30' is not one of '20', '40'"),
        ("--most", "0", "0 should be a whole number of at least 1"),
        ("--draws", "0", "0 should be a whole number of at least 1"),
        ("--seed", "-1", "-1 should be a whole number of at least 0"),
    ],
)
def test_an_option_of_the_search_out_of_range_is_refused(option, value, why, monkeypatch):
    monkeypatch.setattr(find_table1, "fitting", lambda *_: pytest.fail("it searched"))
    done = CliRunner().invoke(find_table1.main, [option, value])
    assert (done.exit_code, why in done.stderr) == (2, True), done.output


@pytest.mark.parametrize(
    ("module", "option", "value", "why"),
    [
        (table1, "--out", __file__, "File exists"),
        (table1, "--out", f"{__file__}/folder", "Not a directory"),
        (evaders, "--latency", "nan", "nan should be a number"),
        (breaking, "--minutes", "nan", "nan should be a number"),
        (freeze, "--version", "0", "'0' is not '1'"),
    ],
    ids=str,
)
def test_an_option_of_a_study_is_refused_before_its_runs(module, option, value, why, monkeypatch):
    monkeypatch.setattr(table1, "measure", lambda _: pytest.fail("it ran"))
    done = CliRunner().invoke(module.main, [option, value])
    assert done.exit_code == 2
    assert why in done.stderr


def test_infinity_and_nan_are_strings_in_the_document_of_a_study(tmp_path, capsys):
    Options("numbers", 1, 1, 0, tmp_path, as_json=True).show({"found": [inf, nan, 1.0]}, "table")
    for text in (capsys.readouterr().out, (tmp_path / "numbers.json").read_text()):
        assert strict_json(text)["found"] == ["Infinity", "NaN", 1.0]


def test_a_found_configuration_is_written_as_it_was_found(tmp_path):
    chosen = table1.configuration(20)
    (tmp_path / "found.toml").write_text(find_table1.as_file(chosen, "a command"))
    assert load(tmp_path / "found.toml") == chosen


@pytest.mark.whole
def test_two_clocks_reports_that_table_1_depends_on_the_slot(study, monkeypatch):
    """From slots of 0.01 s to 0.1 s, of which the paper has 11.7 s and 55.6 s of active time."""
    monkeypatch.setattr(two_clocks, "VALUES", (0.01, 0.03, 0.1))
    document, text, picture = study(two_clocks.main, "--runs", "1")
    assert document["spread_along_slot"] > 3.0
    assert document["spread_along_step"] < 1.1
    assert "Table I is about the negotiation slot." in text
    for label in ("negotiation slot", "motion step h (s)", "sum of active times (s)"):
        assert label in picture


def test_the_spread_is_the_greatest_ratio_along_one_clock():
    """Active time 1 / slot on the grid, but for one cell that is doubled along the step."""
    cells = [
        two_clocks.Cell(slot, step, (2.0 if (slot, step) == (0.01, 0.1) else 1.0) / slot, 0.0)
        for slot in two_clocks.VALUES
        for step in two_clocks.VALUES
    ]
    assert two_clocks.spread(cells, "slot") == pytest.approx(100.0)
    assert two_clocks.spread(cells, "step") == pytest.approx(2.0)
    assert two_clocks.table(list(cells), 1).count("+-") == 26


def test_the_first_picture_counts_the_active_until_the_end(run_of):
    result = run_of("relay.toml", "horizon=0.1")
    counts = first_picture.active_pursuers(result)
    assert counts[0] == 20
    assert np.isnan(counts[5:]).all()
    assert not np.isnan(counts[:5]).any()


@pytest.fixture
def few(monkeypatch):
    """The studies of rivals and of range, cut down to what a test has time for."""
    patch_study(monkeypatch, (rivals, rivals_runs), "N", 8)
    patch_study(monkeypatch, (rivals, rivals_runs), "WORLDS", {"paper": Scenario(name="paper", team=Team(count=8))})
    patch_study(monkeypatch, (rivals, rivals_runs), "LATENCIES", (0.0, 0.2))
    patch_study(monkeypatch, (ranges, range_runs), "RANGES", (0.5, 8.0, 30.0))
    patch_study(monkeypatch, (ranges, range_runs), "N", 6)
    small = {name: team.model_copy(update={"count": 6}) for name, team in range_runs.TEAMS.items()}
    patch_study(monkeypatch, (ranges, range_runs), "TEAMS", small)


@pytest.mark.whole
def test_all_rivals_are_compared_in_the_same_runs(few, study, shortened):
    cut = shortened(1.0)
    document, text, picture = study(rivals.main, "--runs", "1")
    cells = {(cell["protocol"], cell["latency"]): cell for cell in document["cells"]}
    assert {protocol for protocol, _ in cells} == {*PROTOCOLS.choices(), rivals_runs.SILENT} - {rivals_runs.LEARNED}
    assert all(cell["difference"]["mean"] == 0.0 for cell in cells.values() if cell["protocol"] == "sap")
    for latency in rivals_runs.LATENCIES:
        alone = summary(run(cut(rivals_runs.scenario("paper", "cbaa", latency)), 0))
        assert cells["cbaa", latency]["active_time"]["mean"] == pytest.approx(alone.active_time)
    speaking = set(PROTOCOLS.choices()) - {"centralised", "voronoi", "argmin"}
    for protocol, latency in cells:
        rate = cells[protocol, latency]["transmissions"]
        assert (
            rate == pytest.approx(rivals_runs.N / rivals_runs.PERIOD, rel=0.1) if protocol in speaking else rate == 0.0
        )
    assert cells["centralised", 0.0]["active_time"]["mean"] < cells["sap", 0.0]["active_time"]["mean"]
    regret = network_regret(run(cut(rivals_runs.scenario("paper", "sap", 0.2)), 0))
    assert cells["sap", 0.2]["network_regret"] == pytest.approx(regret)
    assert all(cell["kilobytes"] == 0.0 for cell in cells.values() if cell["protocol"] == rivals_runs.SILENT)
    assert text.count("\ncbba ") == 3
    assert "one-way latency L (s)" in picture


def test_a_rival_is_compared_with_spatial_adaptive_play_and_with_itself_without_delay_on_the_same_seeds():
    """Active times 4 and 6 s; of SAP 3 and 3 s, so 1 and 3 s more; without delay 2 and 2 s."""

    def runs(*times):
        base = summary(run(rivals_runs.scenario("paper", "cbaa", 0.0).model_copy(update={"horizon": 0.1})))
        sent = {"transmissions": 20, "bytes_sent": 1000, "end_time": 4.0}
        return [(changed(base, active_time=t, potential_gap=2 * t, **sent), t if t < 5.0 else None) for t in times]

    others = {"reference": runs(3.0, 3.0), "prompt": runs(2.0, 2.0)}
    cell = rivals_runs.cell(("paper", "cbaa", 0.2), runs(4.0, 6.0), **others)
    assert (cell.relayed, cell.time_to_relay) == (0.5, 4.0)
    assert cell.network_regret == (8.0 + 12.0 - 2 * 4.0) / 2
    assert (cell.active_time.mean, cell.difference.mean) == (5.0, 2.0)
    assert (cell.transmissions, cell.kilobytes) == (5.0, 0.25)
    assert cell.difference.half_width == pytest.approx(12.706 * np.std([1.0, 3.0], ddof=1) / np.sqrt(2), rel=1e-4)


@pytest.mark.whole
def test_the_range_study_pairs_runs_and_enumerates_games(few, study, shortened, monkeypatch):
    shortened(1.0)
    patch_study(monkeypatch, (ranges, range_runs), "GAMES_PER_RUN", 200)
    document, _, picture = study(ranges.main, "--runs", "1")
    static = {(each["team"], each["range"]): each for each in document["games"]}
    for team in range_runs.TEAMS:
        near, middle, far = (static[team, radius] for radius in range_runs.RANGES)
        assert near["games"] == range_runs.GAMES_PER_RUN
        assert (far["components"], far["unsettled"]["mean"], far["independent"]) == (
            1.0,
            0.0,
            pytest.approx(1.0, abs=0.2),
        )
        assert near["components"] > middle["components"] > far["components"]
    assert static["all able", 8.0]["unsettled"]["mean"] == pytest.approx(0.125, abs=3 * 0.023)
    assert all(
        each["difference"]["mean"] == 0.0 for each in document["pursuits"] if each["protocol"] == range_runs.REFERENCE
    )
    for label in ("range R (m)", "without equilibrium (%)", "sum of active times (s)"):
        assert label in picture


@pytest.mark.whole
def test_the_contention_study_compares_channels_in_the_same_runs_and_measures_ages(monkeypatch, study, shortened):
    shortened(1.5)
    fewer = {"LOADS": (0.1, 2.0), "TEAM_SIZES": (5,), "FACTORS": (0.5, 1.0, 4.0), "SPREADING_FACTORS": (7, 12)}
    for name, few in fewer.items():
        patch_study(monkeypatch, (contention, contention_runs), name, few)
    document, table, picture = study(contention.main, "--runs", "1")
    cells = {(each["protocol"], each["access"], each["load"]): each for each in document["pursuits"]}
    assert len(cells) == 4 * 4 * 2
    assert all(cells[name, "ideal queue", 0.1]["difference"]["mean"] == 0.0 for name in contention.NAMES)
    assert cells["SAP", "ALOHA", 2.0]["lost"] > 0.5 > cells["SAP", "ALOHA", 0.1]["lost"]
    assert cells["SAP", "TDMA", 0.1]["lost"] == 0.0
    ages = {(each["access"], each["heartbeat"]): each["age"]["mean"] for each in document["ages"]}
    often, best, seldom = (ages["ALOHA", factor * 8 * contention.AIRTIME] for factor in (0.5, 1.0, 4.0))
    assert best < min(often, seldom)
    assert [each["interval"] for each in document["lora"]] == pytest.approx([6.2, 148.3], abs=0.05)
    assert "over before the second" in table
    assert "mean age of information (s)" in picture


@pytest.mark.whole
def test_the_transport_study_spends_the_same_bytes_on_each_way_to_repeat(monkeypatch, study, shortened):
    """In a game at rest, where many announcements are averaged; with few pursuits the bytes are about the same."""
    shortened(2.0)
    patch_study(monkeypatch, (transport, transport_runs), "SWEEPS", {"loss": (0.0, 0.5), "distance": (20.0,)})
    document, table, picture = study(transport.main, "--runs", "2")
    cells = {(each["swept"], each["value"], each["way"]): each for each in document["cells"]}
    assert len(cells) == 3 * 5
    rates = [cells["loss", 0.5, way]["age_rate"] for way in ("reliable", "heartbeats", "coded")]
    assert rates == pytest.approx([rates[0]] * 3, rel=0.1)
    assert cells["loss", 0.0, "once"]["difference"]["mean"] == 0.0
    assert cells["loss", 0.5, "heartbeats"]["age"]["mean"] < cells["loss", 0.5, "reliable"]["age"]["mean"]
    assert cells["distance", 20.0, "coded"]["age"] is None
    assert "bytes/s, coded" in table
    assert "mean age of information (s)" in picture


@pytest.mark.whole
def test_the_coherence_study_compares_channels_with_one_probability_of_reception(monkeypatch, study, shortened):
    """Whoever is announced to once fares alike on a channel that changes fast and on one without memory: ages."""
    d = np.linspace(0.5, 30.0, 60)
    of = [coherence_runs.links(channel) for channel in coherence_runs.CHANNELS]
    assert all((links.reception(d, links.range) == of[0].reception(d, of[0].range)).all() for links in of)
    assert [links.fading for links in of] == ["correlated"] * 3 + ["message"]
    shortened(2.0)
    patch_study(monkeypatch, (coherence, coherence_runs), "CHANNELS", {"10": 10.0, "no memory": None})
    document, table, picture = study(coherence.main, "--runs", "2")
    cells = {(each["channel"], each["way"]): each for each in document["cells"]}
    assert len(cells) == 2 * 4
    assert cells["10", "reliable"]["rate"] > 2.0 * cells["10", "once"]["rate"]
    assert cells["10", "heartbeats"]["age"]["mean"] < cells["10", "once"]["age"]["mean"]
    assert "bytes/s, coded" in table
    assert "mean age of information (s)" in picture


@pytest.mark.whole
def test_the_study_of_liars_shows_harm_and_defence(monkeypatch, study, shortened):
    """In a run of 6 s: a liar leaves all idle, trimming holds against F liars, and evidence against more.

    Of protocols, lies and defences there are those that are asked about; the scenarios of all others are valid, too.
    """
    everything = {liars_runs.scenario_of(*key).model_dump_json() for key in liars_runs.keys()}  # noqa: SIM118
    assert len(everything) > 100
    shortened(6.0)
    fewer = {
        "NUMBERS": (0, 1, 2),
        "OFFSETS": (0.0, 0.5),
        "LATENCIES": (0.2,),
        "PROTOCOLS": {"local_min": liars_runs.PROTOCOLS["local_min"], "sap": liars_runs.PROTOCOLS["sap"]},
        "LIES": {name: liars_runs.LIES[name] for name in (liars_runs.HONEST, liars_runs.WORST)},
        "DEFENCES": {name: liars_runs.DEFENCES[name] for name in ("none", "trimmed, F = 1", "plausible")},
        "OBSERVING": ("plausible",),
    }
    for name, few in fewer.items():
        patch_study(monkeypatch, (liars, liars_runs), name, few)
    document, table, picture = study(liars.main, "--runs", "1", "--seed", "2")
    cells = {(each["part"], each["lie"], each["defence"], each["value"]): each for each in document["cells"]}
    active = {
        defence: [cells["numbers", "there at once", defence, n]["active_time"]["mean"] for n in (0.0, 1.0, 2.0)]
        for defence in ("none", "trimmed, F = 1", "plausible")
    }
    honest = active["none"][0]
    assert max(active["none"][1:]) < honest / 2
    assert active["trimmed, F = 1"][2] < honest / 2 < min(active["trimmed, F = 1"][:2])
    assert min(active["plausible"]) > honest / 2
    assert cells["lies", "honest", "none", 1.0]["delay"]["mean"] == 0.0
    accused = [cells["clocks", "honest", "plausible", offset]["false_accusations"]["mean"] for offset in (0.0, 0.5)]
    assert accused[0] == 0.0 < accused[1]
    assert "there at once" in table
    assert "false accusations per run" in picture


@pytest.mark.whole
def test_the_study_of_bodies_compares_motions_and_rules_in_the_same_runs(monkeypatch, study):
    """One run of each cell: means are taken by `estimate`, which has tests of its own. Two cells are run once more."""
    patch_study(monkeypatch, (bodies, bodies_runs), "LATENCIES", (0.0, 0.5))
    few = {name: bodies_runs.MOTIONS[name] for name in ("simple", "radius 1 m")}
    patch_study(monkeypatch, (bodies, bodies_runs), "MOTIONS", few)
    runs = []

    def run_noted(tasks, *rest):
        measured = run_many(tasks, *rest)
        runs.extend(zip(tasks, measured, strict=True))
        return measured

    monkeypatch.setattr("scenarios.studies.study.run_many", run_noted)
    document, table, picture = study(bodies.main, "--runs", "1", "--seed", "1")
    cells = {(each["rule"], each["motion"], each["latency"]): each for each in document["cells"]}
    assert len(cells) == 2 * 2 * 2
    (seed,) = seeds_from(1, 1)
    times = {}
    for key in cells:
        (time,) = (active for task, (active, *_) in runs if task == (bodies_runs.pursuit(*key), seed))
        times[key] = np.array([time])
    for key in [*cells][::5]:
        assert times[key] == active_time(run(bodies_runs.pursuit(*key), seed))
    for (rule, motion, latency), cell in cells.items():
        late = {each: times[rule, each, latency] - times[rule, each, 0.0] for each in few}
        assert cell["active_time"]["mean"] == pytest.approx(times[rule, motion, latency].mean())
        assert cell["of_latency"]["mean"] == pytest.approx(late[motion].mean())
        assert cell["of_inertia"]["mean"] == pytest.approx((late[motion] - late["simple"]).mean())
        difference = times[rule, motion, latency] - times["one at a time", motion, latency]
        assert cell["of_rule"]["mean"] == pytest.approx(difference.mean())
        assert f"{cell['active_time']['mean']:.2f}" in table
    assert sum(cells["one at a time", motion, 0.5]["of_latency"]["mean"] for motion in few) > 3.0
    for label in ("radius 1 m", "excess active time per handover (s)"):
        assert label in picture


def test_robots_of_the_study_of_bodies_have_the_radii_and_accelerations_of_their_names():
    for name, dynamics in bodies_runs.MOTIONS.items():
        if name.startswith("radius"):
            assert bodies_runs.SPEED / dynamics.limit == pytest.approx(float(name.split()[1]))
        elif name != "simple":
            assert dynamics.limit == float(name.split()[0])


def decided(*decisions):
    """Return the result of 6 s in which 0 of three pursuers chases at first, given (time (s), pursuer, action)."""
    trace = Trace()
    trace.append(Started(0, ((9.0, 0.0),), ((0.0, 0.0),) * 3, (2.0,) * 3, (1, 0, 0)))
    for t, pursuer, action in decisions:
        trace.append(Decided(nanoseconds(t), pursuer, action))
    trace.append(Ended(nanoseconds(6.0), "horizon", None))
    return Result(Scenario(), 0, trace)


@pytest.mark.own_trace
def test_the_excess_of_a_handover_is_counted_from_the_last_lone_chase_to_the_next():
    """All for .5 s, 0 and 1 for .5 s, 0 alone again; 0 and 1 and 2 for .25 s, nobody for .75 s, then 2 alone."""
    joins, hands_over = [(1.0, 1, 1), (1.0, 2, 1), (1.5, 2, 0), (2.0, 1, 0)], [(4.0, 1, 1), (4.0, 2, 1)]
    gone = [(4.25, pursuer, 0) for pursuer in range(3)]
    assert bodies_runs.handovers(decided(*joins)) == (0, 0.0)
    assert bodies_runs.handovers(decided(*joins, *hands_over)) == (0, 0.0)
    assert bodies_runs.handovers(decided(*joins, *hands_over, *gone, (5.0, 2, 1))) == (1, 0.5)


@pytest.mark.slow
def test_the_handovers_of_the_study_of_bodies_are_those_of_the_metric():
    scenario = bodies_runs.pursuit("one at a time", "simple", 0.25)
    results = [run(scenario, seed) for seed in range(2, 6)]
    found, numbers = [bodies_runs.handovers(each) for each in results], [summary(each) for each in results]
    assert [each.number for each in found] == [each.handovers for each in numbers]
    assert all(each.excess <= number.excess_time + 1e-9 for each, number in zip(found, numbers, strict=True))
    assert sum(each.number for each in found) > 0


@pytest.mark.slow
def test_the_error_of_a_ratio_is_the_deviation_of_ratios_of_new_samples():
    """The number of handovers, and the excess of each, vary; 2000 samples of 40 runs give the error to 2 %."""
    rng = np.random.default_rng(1)

    def drawn():
        counts = rng.poisson(1.5, 40)
        return bodies_runs.ratio([rng.exponential(2.0, count).sum() for count in counts], counts.tolist())

    found = [drawn() for _ in range(2000)]
    means, errors = [each.mean for each in found], [each.standard_error for each in found]
    assert np.mean(means) == pytest.approx(2.0, abs=0.03)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.std(means), rel=0.1)
    naive = np.sqrt(40 * 1.5) * 2.0 / (40 * 1.5)  # of a sum of as many values as are expected, each of deviation 2
    assert np.std(means) == pytest.approx(naive, rel=0.1)
    assert np.isnan(bodies_runs.ratio([0.0, 0.0], [0, 0]).mean)


def test_the_best_heartbeat_has_the_least_age_in_theory(monkeypatch):
    """Also by search; if the waits vary as those of a Poisson process do, it is 2 (N - 1) T."""

    def age(period, size):
        success = np.exp(-2 * (size - 1) * contention_runs.AIRTIME / period)
        return period * ((1 + contention_runs.JITTER**2 / 3) / 2 + 1 / success - 1)

    for size in (5, 20):
        periods = np.linspace(0.05, 2.0, 20_000)
        assert contention_runs.best_heartbeat(size) == pytest.approx(periods[age(periods, size).argmin()], abs=2e-4)
    monkeypatch.setattr(contention_runs, "JITTER", 3**0.5)
    assert contention_runs.best_heartbeat(20) == pytest.approx(2 * 19 * contention_runs.AIRTIME)


def test_a_channel_on_which_no_age_is_finite_has_no_best_heartbeat():
    assert contention._best([]).splitlines()[1].split() == ["5", "0.10", "s", "-", "-", "-", "-"]


@pytest.mark.slow
def test_no_message_of_the_contention_study_is_longer_than_the_slots_are_made_for():
    for name, longest in contention_runs.LONGEST.items():
        scenario = contention_runs.pursuit(name, "ideal queue", 0.5)
        trace = run(scenario.model_copy(update={"record": Recording(messages=True), "horizon": 5.0}), 1).trace
        assert max(each.size for each in [*trace.of(Sent), *trace.of(Broadcast)]) == longest


def test_the_games_of_the_range_study_are_those_of_the_runs():
    """The links are the disk graph of the initial positions."""
    base = range_runs.scenario("all able", 6.0, "local mean")
    phi, hearing, graph = range_runs.game(base, 5)
    start = run(base.model_copy(update={"horizon": 0.01}), 5).trace.of(Started)[0]
    places = np.array(start.pursuers)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    assert [sorted(each) for each in hearing] == [
        [j for j in np.flatnonzero(row <= 6.0) if apart[i, j]] for i, row in enumerate(apart)
    ]
    gaps = np.linalg.norm(places - np.array(start.evaders[0]), axis=1)
    assert phi == pytest.approx((gaps - 0.1) / (1.2 - 0.9))
    assert len(graph) == range_runs.N


@pytest.mark.slow
def test_active_times_are_divided_by_who_could_capture_in_time():
    """Their sum is that of the team. With a horizon of 1e6 s, all could."""
    for horizon, some_late in ((5.0, True), (1e6, False)):
        result = run(start_runs.pursuit("few in time", LocalMin(), "known", 0.1).with_({"horizon": horizon}), 3)
        times = start_runs.times_by_ability(result)
        assert sum(times) == pytest.approx(active_time(result))
        assert (times[0] > 0.0) is some_late


@pytest.mark.whole
def test_the_study_of_the_start_prints_what_it_measured(study, shortened):
    shortened(0.3)
    document, table, _ = study(start.main, "--runs", "1")
    assert len(document["costs"]) == 18
    assert len(document["who"]) == 6
    assert f"{document['costs'][0]['prompt']['mean']:.3f}" in table
    law, table, _ = study(start.main, "--runs", "1", "--law")
    assert [extra["expected"] for extra in law["law"]] == 2 * [0.0, 0.95, 3.8, 15.2]
    assert law["law"][0]["difference"]["mean"] == 0.0


@pytest.mark.whole
def test_boids_that_hear_each_other_fly_alike_and_others_do_not(tmp_path, monkeypatch):
    """Of N random headings, the mean has the length sqrt(pi / (4 N)) in the mean, here 0.20."""
    bounds = {name: boids.NETWORKS[name] for name in ("everything at once", "nothing ever")}
    monkeypatch.setattr(boids, "NETWORKS", bounds)
    monkeypatch.setattr(boids, "DURATION", 5.0)
    done = CliRunner().invoke(boids.main, ["--runs", "1", "--out", str(tmp_path), "--json"])
    assert done.exit_code == 0, done.output
    order = json.loads(done.stdout)["order"]
    assert order["everything at once"][-1] > 0.8
    assert order["nothing ever"][-1] < 0.4
    assert (tmp_path / "boids.svg").exists()

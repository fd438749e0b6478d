"""Studies: what they measure is what the simulator does, and what they print is what they measured."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from desim import load, run, summary
from desim.pursuit.state import complex_points
from desim.warnings import warnings
from scenarios import find_table1, first_picture, table1, two_clocks
from scenarios.study import SCENARIOS

FILES = sorted(SCENARIOS.glob("*.toml"))


def call(command, *words):
    """Return the JSON document that a study prints, asserting that nothing else is on stdout."""
    done = CliRunner().invoke(command, [*words, "--json"])
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_every_scenario_file_runs_without_a_warning(file):
    scenario = load(file)
    assert not list(warnings(scenario))
    numbers = summary(run(scenario))
    assert numbers.messages_sent == numbers.messages_delivered + numbers.messages_lost + numbers.messages_in_flight > 0


@pytest.fixture(scope="module")
def cells(tmp_path_factory):
    folder = tmp_path_factory.mktemp("table1")
    return call(table1.main, "--runs", "3", "--jobs", "2", "--out", str(folder))["cells"], folder


@pytest.mark.slow
def test_table_1_has_every_cell_and_both_starts(cells):
    found = {(c["algorithm"], c["pursuers"], c["delta"], c["start"]) for c in cells[0]}
    assert found == {
        (algorithm, count, delta, start)
        for algorithm, count, delta in table1.PUBLISHED
        for start in (["any"] if algorithm == "centralised" else table1.STARTS)
    }
    assert len(found) == 18


@pytest.mark.slow
def test_the_centralised_cells_of_table_1_are_within_1_percent(cells):
    """Nothing is drawn: the runs of a cell are equal."""
    central = [cell for cell in cells[0] if cell["algorithm"] == "centralised"]
    assert all(cell["ratio"] == pytest.approx(1.0, abs=0.01) and cell["standard_error"] == 0.0 for cell in central)


@pytest.mark.slow
def test_the_decentralised_cells_of_table_1_are_near_if_all_start_active_and_far_if_not(cells):
    """Three runs: a standard deviation of at most 14 % of the mean gives 8 %; the mean over six cells 3.3 %.

    The random start, the control, is 26 % lower on the average.
    """
    ratios = {start: np.mean([cell["ratio"] for cell in cells[0] if cell["start"] == start]) for start in table1.STARTS}
    assert ratios["all active"] == pytest.approx(1.0, abs=3 * 0.033)
    assert ratios["random"] < 1.0 - 3 * 0.033


@pytest.mark.slow
def test_a_study_writes_what_it_prints(cells):
    document = json.loads((cells[1] / "table1.json").read_text())
    assert document["cells"] == cells[0]
    text = (cells[1] / "table1.txt").read_text()
    for cell in cells[0]:
        assert f"{cell['measured']:.4f}" in text
        assert f"{cell['published']:.4f}" in text


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


def test_a_found_configuration_is_written_as_it_was_found(tmp_path):
    chosen = table1.configuration(20)
    (tmp_path / "found.toml").write_text(find_table1.as_file(chosen, "a command"))
    assert load(tmp_path / "found.toml") == chosen


@pytest.mark.slow
def test_two_clocks_says_that_table_1_is_about_the_slot(tmp_path):
    document = call(two_clocks.main, "--runs", "1", "--jobs", "2", "--out", str(tmp_path))
    assert document["spread_along_slot"] > 5.0
    assert document["spread_along_step"] < 1.1
    assert "Table I is about the negotiation slot." in (tmp_path / "two_clocks.txt").read_text()
    for label in ("negotiation slot", "motion step h (s)", "sum of active times (s)"):
        assert label in (tmp_path / "two_clocks.svg").read_text()


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


def test_the_first_picture_counts_the_active_until_the_end():
    result = run(load(SCENARIOS / "relay.toml", ["horizon=0.1"]))
    counts = first_picture.active_pursuers(result)
    assert counts[0] == 20
    assert np.isnan(counts[5:]).all()
    assert not np.isnan(counts[:5]).any()

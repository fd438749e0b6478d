"""The folder of a run."""

import json
import sys
from pathlib import Path

import pytest

from desim import provenance
from desim.analysis.folder import can_plot, read, write, write_below
from desim.analysis.metrics import plain, summary
from desim.pursuit.events import Captured
from desim.scenario import Recording, Scenario, Team
from desim.scenario_file import dump, load
from desim.simulation import run

DATA = {"trace.jsonl", "summary.json", "scenario.toml", "run.json"}
PICTURES = {"trajectory.svg", "trajectory.png"}
SCENARIO = Scenario(name="caf\u00e9", seed=1, horizon=0.2, team=Team(count=3), record=Recording(trajectory=0.0))


def names(folder) -> set[str]:
    return {each.name for each in folder.iterdir()}


@pytest.fixture(scope="module")
def result():
    return run(SCENARIO, 5)


def test_a_folder_is_made_with_all_above_it_and_the_numbers_are_returned(result, tmp_path):
    assert write(result, tmp_path / "a" / "b") == summary(result)
    assert names(tmp_path / "a" / "b") == DATA


def test_the_numbers_in_the_folder_are_those_of_the_summary(result, tmp_path):
    write(result, tmp_path)
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8")) == plain(summary(result))


def test_the_trace_in_the_folder_is_that_of_the_run(result, tmp_path):
    write(result, tmp_path)
    assert (tmp_path / "trace.jsonl").read_bytes() == "".join(result.trace.lines()).encode()


def test_the_scenario_in_the_folder_has_the_seed_of_the_run(result, tmp_path):
    write(result, tmp_path)
    assert load(tmp_path / "scenario.toml") == SCENARIO.model_copy(update={"seed": 5})
    assert result.scenario.seed == 1


def test_runs_are_written_below_a_folder_by_their_seed(result, tmp_path):
    assert write_below(tmp_path, result) == summary(result)
    assert names(tmp_path) == {"seed-5"}
    assert names(tmp_path / "seed-5") == DATA


def test_the_folder_says_where_the_run_of_a_script_comes_from(result, tmp_path):
    write(result, tmp_path)
    assert provenance.read(tmp_path / "run.json") == provenance.document("run", SCENARIO, seed=5)


def test_the_folder_of_one_of_several_runs_says_where_that_run_comes_from(result, tmp_path):
    made = provenance.document("run", SCENARIO, seed=4, runs=3, folder=tmp_path) | {"argv": ["desim", "run", "x"]}
    write_below(tmp_path, result, made)
    written = provenance.read(tmp_path / "seed-5" / "run.json")
    assert written == made | {"seed": 5, "runs": 1, "scenario": SCENARIO.plain() | {"seed": 5}}


@pytest.fixture
def seen() -> Scenario:
    return SCENARIO.model_copy(update={"record": Recording(trajectory=0.1)})


def test_there_are_pictures_if_positions_were_recorded(seen, tmp_path):
    write(run(seen), tmp_path)
    assert names(tmp_path) == DATA | PICTURES


def test_there_are_no_pictures_without_matplotlib(seen, tmp_path, monkeypatch):
    assert can_plot()
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # importing it now raises ImportError
    assert not can_plot()
    write(run(seen), tmp_path)
    assert names(tmp_path) == DATA


def test_a_picture_of_an_earlier_run_does_not_stay_beside_the_trace_of_a_later_one(seen, result, tmp_path):
    write(run(seen), tmp_path)
    write(result, tmp_path)
    assert names(tmp_path) == DATA


def test_what_others_keep_in_the_folder_stays(seen, tmp_path):
    (tmp_path / "trajectory.csv").write_text("precious")
    (tmp_path / "notes.txt").write_text("precious")
    write(run(seen), tmp_path)
    assert names(tmp_path) == DATA | PICTURES | {"trajectory.csv", "notes.txt"}


FILES = ("relay", "faults", "radio", "soak", "auction", "flooding", "token_ring", "server", "reckoning")


@pytest.mark.parametrize(("name", "evaders"), [*((name, 1) for name in FILES), ("relay", 3), ("reckoning", 3)])
def test_a_run_that_was_written_is_read_again(name, evaders, tmp_path):
    """The same events, and the same numbers from them: beliefs too, which come from what was relayed."""
    file = Path(__file__).parents[2] / "scenarios" / f"{name}.toml"
    pack = [f"evader.count={evaders}", "evader.box=[1, 19]", "team.speeds=4.0"] if evaders > 1 else []
    result = run(load(file, ["horizon=1.5", "record.messages=true", *pack]), seed=8)
    assert bool(result.trace.of(Captured)) == (evaders > 1)
    numbers = write(result, tmp_path)
    again = read(tmp_path)
    assert again.seed == 8
    assert again.trace.events == result.trace.events
    assert [type(event) for event in again.trace] == [type(event) for event in result.trace]
    assert json.dumps(plain(summary(again))) == json.dumps(plain(numbers))
    assert dump(again.scenario) == (tmp_path / "scenario.toml").read_text()


def test_half_a_trace_is_not_read(result, tmp_path):
    write(result, tmp_path)
    trace = (tmp_path / "trace.jsonl").read_text()
    (tmp_path / "trace.jsonl").write_text(trace[: trace.rindex("{")])
    with pytest.raises(ValueError, match=r"trace.jsonl: is not of a whole run"):
        read(tmp_path)

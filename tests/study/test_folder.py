"""`desim.open`: a run or a sweep from its folder, and what is said of other folders."""

import re
from pathlib import Path

import pytest

import desim
from desim.results.run_folder import write
from desim.scenario.players import Team
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result, run
from desim.study.results.result import SweepResult
from desim.study.sweeps.sweep import sweep
from tests.command import accepted

SCENARIO = Scenario(name="small", horizon=0.1, team=Team(count=2))
GRID = {"network.latency.value": [0.0, 0.1]}


@pytest.mark.slow
def test_a_run_is_read_without_its_scenario_file(tmp_path):
    written = run(SCENARIO, 5)
    write(written, tmp_path)
    for path in (tmp_path, str(tmp_path), tmp_path / "trace.jsonl"):
        found = desim.open(path)
        assert isinstance(found, Result)
        assert (found.scenario, found.seed) == (SCENARIO.model_copy(update={"seed": 5}), 5)
        assert list(found.trace) == list(written.trace)


def test_a_sweep_is_read_without_its_scenario_file(tmp_path):
    made = sweep(SCENARIO, GRID, 2, store=tmp_path / "sweep.sqlite")
    for path in (tmp_path, tmp_path / "sweep.sqlite"):
        found = desim.open(path)
        assert isinstance(found, SweepResult)
        assert found.table() == made.table()


def runs_below(folder):
    for seed in (3, 1):
        write(run(SCENARIO, seed), folder / f"seed-{seed}")


def both(folder):
    write(run(SCENARIO), folder)
    sweep(SCENARIO, GRID, 1, store=folder / "sweep.sqlite")


def both_below(folder):
    (folder / "one").mkdir()
    both(folder / "one")


def parts(folder):
    for part in ("1-of-2", "2-of-2"):
        (folder / f"sweep.{part}.sqlite").touch()


def study(folder):
    write(run(SCENARIO), folder)
    (folder / "trace.jsonl").unlink()


@pytest.mark.whole_but_one
@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda folder: None, "has no result of desim: neither trace.jsonl nor sweep.sqlite"),
        (runs_below, r"has no result itself, but its folders have (seed-1, seed-3): give one of them"),
        (both_below, "has no result itself, but its folders have (one): give one of them"),
        (parts, "has parts of a sweep (sweep.1-of-2.sqlite, sweep.2-of-2.sqlite): merge them first: desim merge"),
        (both, "has a run and a sweep: give"),
        (study, "has the run.json of 'run', but neither trace.jsonl nor sweep.sqlite"),
    ],
)
def test_a_folder_without_one_result_is_described(tmp_path, make, says):
    make(tmp_path)
    with pytest.raises(ValueError, match=re.escape(says)) as caught:
        desim.open(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path}: ")


def test_a_file_that_is_no_result_is_refused(tmp_path):
    (tmp_path / "f.toml").touch()
    with pytest.raises(ValueError, match=r"f\.toml: is not a result.*desim sweep .*and load\(.*reads it"):
        desim.open(tmp_path / "f.toml")
    with pytest.raises(OSError, match="absent"):
        desim.open(tmp_path / "absent")


@pytest.mark.slow
def test_code_named_in_a_folder_is_imported_only_if_that_is_allowed(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("def rest(agent):\n    yield agent.sleep(1.0)\n")
    (tmp_path / "f.toml").write_text('horizon = 0.1\nteam = { count = 2 }\nprotocol = { kind = "mine:rest" }\n')
    monkeypatch.chdir(tmp_path)
    accepted("run", "f.toml", "-o", "out", "--allow-import")
    with pytest.raises(ValueError, match="'mine:rest' names code"):
        desim.open(Path("out"))
    assert desim.open(Path("out"), allow_import=True).scenario.protocol_name == "rest"

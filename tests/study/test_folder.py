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
from desim.study.store import connection
from desim.study.sweeps.sweep import sweep
from desim.view.pages.report import Study
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


@pytest.mark.slow
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


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Return the folder of a sweep, and of one with the two parts of another."""
    base = tmp_path_factory.mktemp("kept")
    file = 'horizon = 0.02\nteam.count = 2\n[sweep]\nreps = 2\ngrid = { "network.loss.p" = [0.0, 0.5] }\n'
    (base / "small.toml").write_text(file)
    for part in ("1/2", "2/2"):
        accepted("sweep", base / "small.toml", "-o", base / "parts", "--shard", part, "-j", 1)
    (base / "whole").mkdir()
    sweep(SCENARIO, {"network.loss.p": [0.0, 0.5]}, 2, store=base / "whole" / "sweep.sqlite")
    return base


READERS = {
    "open": lambda base: desim.open(base / "whole"),
    "compare": lambda base: desim.compare(base / "whole", base / "whole"),
    "ls": lambda base: accepted("ls", base),
    "status": lambda base: accepted("status", base / "parts"),
    "desim compare": lambda base: accepted("compare", base / "whole", base / "whole"),
    "crossover": lambda base: accepted("crossover", base / "whole", "network.loss.p", "--over", "10%"),
    "report": lambda base: Study.read(base / "whole"),
    "export a table": lambda base: accepted("export", base / "whole", base / "made" / "table.md"),
    "export runs": lambda base: accepted("export", base / "whole", base / "made" / "runs.csv"),
    "merge": lambda base: accepted("merge", base / "parts", "-o", base / "made"),
}


@pytest.mark.parametrize("reader", READERS)
def test_what_reads_results_opens_their_stores_for_reading_only(kept, monkeypatch, reader):
    """Another process may be writing to them, or the folder may be one that nobody may write to."""
    opened = []

    def connected(path, read_only=False, network=""):
        opened.append((path, read_only))
        return connection.connected(path, read_only, network)

    monkeypatch.setattr("desim.study.store.file.connected", connected)
    (kept / "made").mkdir(exist_ok=True)
    READERS[reader](kept)
    read = [read_only for path, read_only in opened if path is not None and path.parent != kept / "made"]
    assert read
    assert all(read)

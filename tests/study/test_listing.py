"""A folder of results as a list."""

import json
import os
import shutil
import sqlite3
from contextlib import closing

import pytest

import desim
from desim.study.sweeps.listing import _modified, ls
from tests.command import accepted, refused, strict_json
from tests.conftest import undraw

FILE = """\
name = "relay"
horizon = 0.2
team.count = 2
sweep.reps = 2
sweep.grid."network.loss.p" = [0.0, 0.3]
network.loss = { kind = "bernoulli", p = 0.0 }
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return a folder with a run, three runs, a sweep, a sweep with a shard only, and what is no result."""
    folder = tmp_path_factory.mktemp("results")
    file = folder / "relay.toml"
    file.write_text(FILE)
    with pytest.MonkeyPatch.context() as patch:
        undraw(patch)
        accepted("run", file, "-o", folder / "one")
        accepted("run", file, "-n", 2, "-o", folder / "two")
        accepted("sweep", file, "-o", folder / "swept")
        accepted("sweep", file, "-o", folder / "parts", "--shard", "1/2")
    (folder / ".hidden").mkdir()
    (folder / ".hidden" / "trace.jsonl").write_text("")
    (folder / "empty").mkdir()
    return folder


def states(folder):
    return {str(entry.folder.relative_to(folder)): (entry.kind, entry.runs, entry.state) for entry in ls(folder)}


def test_each_result_has_a_line_with_its_state(results):
    found = states(results)
    assert found["one"] == ("run", 1, "complete")
    assert found["swept"] == ("sweep", 4, "complete")
    assert found["parts"][1:] == (2, "parts of a sweep: merge them; unfinished: 2 of 4")
    assert [name for name in found if name.startswith("two")] == ["two/seed-0", "two/seed-1"]
    assert set(found) == {"one", "swept", "parts", "two/seed-0", "two/seed-1"}
    assert {entry.scenario for entry in ls(results)} == {"relay"}


def test_the_runs_of_all_parts_are_counted_and_a_run_that_two_have_is_done_once(results, tmp_path):
    parts = shutil.copytree(results / "parts", tmp_path / "parts")
    shutil.copy(parts / "sweep.1-of-2.sqlite", parts / "sweep.2-of-2.sqlite")
    with closing(sqlite3.connect(parts / "sweep.2-of-2.sqlite")) as store, store:
        store.execute("DELETE FROM runs WHERE rowid = 1")
    assert states(tmp_path)["parts"][1:] == (3, "parts of a sweep: merge them; unfinished: 2 of 4")


def test_a_store_of_a_script_is_listed_with_its_file(tmp_path):
    """And can be opened by what is listed; another file of SQLite is no result."""
    mine = tmp_path / "mine.sqlite"
    desim.sweep(
        desim.Scenario(horizon=0.1, team=desim.Team(count=2)), {"network.loss.p": [0.0, 0.3]}, reps=1, store=mine
    )
    sqlite3.connect(tmp_path / "other.sqlite").execute("CREATE TABLE things (name TEXT)").connection.close()
    (tmp_path / "broken.sqlite").write_text("no database")
    (entry,) = ls(tmp_path)
    assert (entry.folder, entry.kind, entry.runs, entry.state) == (mine, "sweep", 2, "complete")
    assert len(desim.open(entry.folder).groups) == 2


def test_the_date_is_that_of_the_newest_file(results):
    os.utime(results / "one" / "trace.jsonl", (1e9, 1e9))
    os.utime(results / "one" / "run.json", (1e9, 1e9))
    (entry,) = (entry for entry in ls(results) if entry.folder.name == "one")
    assert entry.modified == 1e9
    assert entry.date.startswith("2001-09-0")


def test_what_is_unfinished_or_damaged_says_so(results, tmp_path):
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / "trace.jsonl").write_text('{"event": "Started"}\n')
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "sweep.sqlite").write_text("no database at all" * 100)
    (tmp_path / "broken" / "run.json").write_text("{")
    found = states(tmp_path)
    assert found["cut"] == ("run", 1, "no run.json; unfinished")
    assert found["broken"][1] is None
    assert "file is not a database" in found["broken"][2]


@pytest.mark.slow
@pytest.mark.usefixtures("_undrawn")
def test_links_to_nothing_are_listed_as_such(tmp_path):
    for folder, name in (("run", "trace.jsonl"), ("swept", "sweep.sqlite"), ("told", "run.json")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).symlink_to("nowhere")
    states = {entry.folder.name: entry.state for entry in ls(tmp_path)}
    assert states["run"] == "trace.jsonl: No such file or directory"
    assert "sweep.sqlite: is a symbolic link to nowhere, which is no store" in states["swept"]
    assert states["told"] == "no run.json; no runs recorded"
    assert all(entry.modified > 0.0 for entry in ls(tmp_path))
    assert _modified(tmp_path / "gone") == 0.0


def test_runs_of_another_grid_are_not_those_of_the_last_sweep(results, tmp_path):
    """Three runs of one configuration and two of another, of which one is then missing."""
    for loss, runs in ((0.0, 3), (0.3, 2)):
        accepted("sweep", results / "relay.toml", "-g", f"network.loss.p={loss}", "-n", runs, "-o", tmp_path / "out")
    assert "relay: 2 of 2 runs are done" in accepted("status", tmp_path / "out").stdout
    assert states(tmp_path)["out"] == ("sweep", 5, "complete")
    made = strict_json((tmp_path / "out" / "run.json").read_text())
    with closing(sqlite3.connect(tmp_path / "out" / "sweep.sqlite")) as store, store:
        (key,) = store.execute("SELECT configuration FROM configurations ORDER BY place LIMIT 1").fetchone()
        store.execute("DELETE FROM runs WHERE configuration = ? AND replication = 1", [key])
    assert "relay: 1 of 2 runs are done" in accepted("status", tmp_path / "out").stdout
    assert states(tmp_path)["out"] == ("sweep", 4, "unfinished: 1 of 2")
    with closing(sqlite3.connect(tmp_path / "out" / "sweep.sqlite")) as store, store:  # as a script with another grid
        store.execute("UPDATE configurations SET place = -place")
    assert "relay: 4 runs are done" in accepted("status", tmp_path / "out").stdout
    assert states(tmp_path)["out"] == ("sweep", 4, "has runs of another grid than that of run.json")
    del made["configurations"], made["reps"]  # as an older version wrote it: no 4 of 2
    (tmp_path / "out" / "run.json").write_text(json.dumps(made))
    assert "relay: 4 runs are done" in accepted("status", tmp_path / "out").stdout


@pytest.mark.whole
@pytest.mark.usefixtures("_undrawn")
def test_a_sweep_that_is_precise_enough_is_complete(results, tmp_path):
    """It plans 10,000 runs at most, and takes 100."""
    options = ("--set", "horizon=0.01", "-g", "network.loss.p=0.3", "--until", "end_time:0.1", "-o", tmp_path / "out")
    accepted("sweep", results / "relay.toml", *options)
    assert "relay: 100 of 100 runs are done" in accepted("status", tmp_path / "out").stdout
    assert states(tmp_path)["out"] == ("sweep", 100, "complete")
    made = strict_json((tmp_path / "out" / "run.json").read_text())
    (tmp_path / "out" / "run.json").write_text(json.dumps(made | {"runs": 10_000, "until": ["end_time", 0.1]}))
    assert "relay: 100 runs are done" in accepted("status", tmp_path / "out").stdout
    assert states(tmp_path)["out"] == ("sweep", 100, "unfinished: 100 of at most 10,000")


def test_the_command_prints_it(results, tmp_path):
    lines = accepted("ls", results).stdout.splitlines()
    assert lines[0].split() == ["folder", "kind", "scenario", "date", "runs", "state"]
    assert len(lines) == 6
    made = strict_json(accepted("ls", results, "--json").stdout)
    assert made == json.loads(json.dumps([entry.document() for entry in desim.ls(results)]))
    assert accepted("ls", tmp_path).stdout == "no results\n"
    assert "is not a folder" in refused("ls", results / "relay.toml")
    assert "<table>" in desim.ls(results)._repr_html_()

"""The store: invalid ones are reported by file, finished runs are kept, and parts make a whole."""

import json
import os
import random
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import traceback
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic_core import core_schema

import desim.study.store.file as module
from desim.analysis.measuring import summary
from desim.analysis.metrics import Summary
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.results import environment
from desim.scenario.scenario import Scenario
from desim.scenario.toml import load, read_source
from desim.simulation.run import run
from desim.study.ablation.explain import explain
from desim.study.results.result import SweepResult
from desim.study.store import connection as store_connection
from desim.study.store.file import StoreError
from desim.study.store.run_table import Row
from desim.study.store.store import Store
from desim.study.sweeps.sweep import sweep
from desim.study.sweeps.sweep_plan import SweepPlan
from desim.view.pages.report import Study, report
from tests.conftest import undraw
from tests.study import sweeps
from tests.study.test_workers import command

pytestmark = pytest.mark.usefixtures("_undrawn")
WRONG_INPUT = 2


@pytest.fixture
def file(tmp_path):
    """Return a scenario of 2 x 6 runs."""
    return sweeps.write(tmp_path / "in", reps=6)


def refused(*args):
    """Return the refusal of a command."""
    made = command(*args)
    assert (made.exit_code, made.stdout) == (WRONG_INPUT, "")
    assert "Traceback" not in made.stderr
    return made.stderr.strip()


def exported(out):
    """Return the table of a store as it is exported."""
    assert command("export", out, out / "runs.csv").exit_code == 0
    return (out / "runs.csv").read_bytes()


def failing(error):
    raise error


ERRORS = {
    "ValueError: plain": ValueError("plain"),
    "ValueError: bad:": ValueError("bad:\n  row 1\nend of table"),
    "ExceptionGroup: both (2 sub-exceptions)": ExceptionGroup("both", [ValueError("a"), TypeError("b")]),
    "SyntaxError: invalid syntax": SyntaxError("invalid syntax", ("f.py", 1, 1, "x y")),
}


@pytest.mark.parametrize("line", ERRORS)
def test_the_error_of_a_run_is_the_first_line_after_its_calls(line):
    try:
        failing(ERRORS[line])
    except Exception as error:
        text = "".join(traceback.format_exception(error))
    assert Row(0, 0, "error", traceback=text).error.startswith(line)


@pytest.mark.slow
def test_a_file_that_is_not_a_store_is_named(tmp_path, file):
    folder, text = tmp_path / "folder", tmp_path / "text"
    (folder / "sweep.sqlite").mkdir(parents=True)
    text.mkdir()
    (text / "sweep.sqlite").write_text("all work and no play " * 99)
    told = refused("sweep", file, "--allow-import", "-o", folder)
    assert told == f"{folder / 'sweep.sqlite'}: is a folder, and a store is a file (.sqlite)"
    told = refused("sweep", file, "--allow-import", "-o", text)
    assert told.startswith(f"{text / 'sweep.sqlite'}: file is not a database, and is left as it is: give")
    assert (text / "sweep.sqlite").read_text().startswith("all work")
    told = refused("sweep", file, "--allow-import", "-o", file)
    assert told == f"{file}: File exists: a file, where --out should name a folder"
    told = refused("sweep", file, "--allow-import", "-o", file / "below")
    assert told == f"--out {file / 'below'}: Not a directory"


def test_a_database_of_something_else_is_refused_and_left_alone(tmp_path, file):
    path = tmp_path / "sweep.sqlite"
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE cats (name TEXT)")
    before = path.read_bytes()
    assert (
        refused("sweep", file, "--allow-import", "-o", tmp_path)
        == f"{path}: is a database, but not the store of a sweep"
    )
    assert path.read_bytes() == before


@pytest.mark.parametrize("read_only", [True, False])
def test_a_folder_is_no_store(tmp_path, read_only):
    (tmp_path / "sweep.sqlite").mkdir()
    with pytest.raises(StoreError, match=r"sweep\.sqlite: is a folder, and a store is a file"):
        Store(tmp_path / "sweep.sqlite", read_only=read_only)


@pytest.mark.parametrize("content", [None, b""])
def test_no_store_is_made_through_a_symbolic_link(tmp_path, content):
    target, link = tmp_path / "target", tmp_path / "sweep.sqlite"
    if content is not None:
        target.write_bytes(content)
    link.symlink_to(target)
    with pytest.raises(StoreError, match=r"sweep\.sqlite: is a symbolic link to .*target, which is no store"):
        Store(link)
    assert (target.read_bytes() if target.exists() else None) == content
    assert {path.name for path in tmp_path.iterdir()} <= {"target", "sweep.sqlite"}


def test_a_store_may_be_on_another_disk(tmp_path):
    target, link = tmp_path / "target", tmp_path / "sweep.sqlite"
    link.symlink_to(target)
    with Store(target):
        pass
    with Store(link) as store:
        store.note_command("folder", ["sweep"])
    with Store(link, read_only=True) as store:
        assert store.commands == [("folder", ["sweep"])]


ANOTHER = {
    "desim.study.store.store.FORMAT": "0",
    "desim.study.store.file.TABLES": f"{module.TABLES} CREATE TABLE more (name TEXT);",
}


@pytest.mark.parametrize("name", ANOTHER)
def test_a_store_of_another_version_is_refused(tmp_path, file, name, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(name, ANOTHER[name])
        with Store(tmp_path / "sweep.sqlite"):
            pass
    told = refused("sweep", file, "--allow-import", "-o", tmp_path)
    assert told.startswith(f"{tmp_path / 'sweep.sqlite'}: was made by another version of desim")
    assert told.endswith("; remove it, or choose another folder (-o, in Python store=)")


def test_an_export_of_no_store_or_an_empty_one_is_refused(tmp_path):
    missing = tmp_path / "none"
    told = refused("export", missing, tmp_path / "a.csv")
    assert told == f"{missing}: there is no such store; `desim sweep FILE -o DIR` makes one in DIR"
    missing.mkdir()
    assert (
        refused("export", missing, tmp_path / "a.csv")
        == f"{missing}: has no result of desim: neither trace.jsonl nor sweep.sqlite"
    )
    assert not (missing / "sweep.sqlite").exists()
    with Store(missing / "sweep.sqlite"):
        pass
    assert refused("export", missing, tmp_path / "a.csv") == f"{missing / 'sweep.sqlite'}: is empty"
    assert not (tmp_path / "a.csv").exists()


@pytest.mark.whole
def test_a_full_disk_is_reported_and_finished_runs_are_kept(tmp_path, file, monkeypatch):
    """A store that may have 16 pages of 4 kB holds the configurations, and not all of 60 runs."""
    begin = Store._open

    def small(self, *args):
        begin(self, *args)
        self.database.execute("PRAGMA max_page_count = 16")

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(Store, "_open", small)
        assert (
            refused("sweep", file, "--allow-import", "-n", 30, "-o", out)
            == f"{out / 'sweep.sqlite'}: database or disk is full"
        )
    _, runs = sweeps.rows(out / "sweep.sqlite")
    assert 10 < len(runs) < 60
    assert command("sweep", file, "--allow-import", "-n", 30, "-o", out).exit_code == 0
    assert command("sweep", file, "--allow-import", "-n", 30, "-o", tmp_path / "whole").exit_code == 0
    assert exported(out) == exported(tmp_path / "whole")


@pytest.mark.whole
@pytest.mark.parametrize("limit", [0, 4, 60])
def test_a_file_size_limit_is_reported(tmp_path, file, limit):
    """The process may write files of some kB at most, as where a quota ends: run.json, the store or its journal."""
    out, mark = tmp_path / "out", str(tmp_path)
    driver = sweeps.start(
        *("sweep", file, "--allow-import", "-n", 200, "-o", out),
        mark=mark,
        prepare=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit * 1024, limit * 1024)),
    )
    stdout, stderr = driver.communicate()
    assert (driver.returncode, stdout) == (WRONG_INPUT, ""), stderr
    (line,) = stderr.splitlines()
    assert line.startswith(f"{out}")
    if sweeps.count(out / "sweep.sqlite"):
        _, runs = sweeps.rows(out / "sweep.sqlite")
        assert 0 < len(runs) < 400


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sweep.txt", "means-active_time.svg", "run.json"])
def test_files_that_cannot_be_written_beside_a_store_are_reported(tmp_path, file, name, pictures):
    (tmp_path / name).mkdir()
    made = command("sweep", file, "--allow-import", "-o", tmp_path)
    assert made.exit_code == WRONG_INPUT
    assert made.stderr.splitlines()[-1] == f"--out {tmp_path / name}: Is a directory"


@cache
def numbers():
    return summary(run(Scenario(horizon=0.1, team={"count": 2})))


def run_of(number, status="ok", text=""):
    return Row(number, number, status, numbers() if status == "ok" else None, text)


def statuses(store, plan):
    return {(row.replication, row.status, row.traceback) for row in store.runs(plan.configurations[0].key, 0)}


def test_configurations_stand_before_those_that_were_there(file):
    plan = SweepPlan.of(load(file, allow_import=True))
    with Store() as store:
        for cell in reversed(plan.configurations):
            store.register([cell])
        assert [key for key, _ in store.configurations()] == [cell.key for cell in plan.configurations]
        assert len(plan.configurations) > 1


def test_a_failed_run_is_replaced_by_any_and_a_successful_one_by_none(file):
    """So the slower of two drivers cannot spoil what the faster has."""
    plan = SweepPlan.of(load(file, allow_import=True))
    with Store() as store:
        plan.register(store)
        for status, text in (("error", "one"), ("crashed", "two"), ("ok", "three"), ("error", "four")):
            store.add(plan.configurations[0].key, 0, run_of(0, status, text))
            expected = "three" if text == "four" else text
            assert {each[2] for each in statuses(store, plan)} == {expected}


def test_the_runs_of_the_first_configurations_are_counted_below_a_replication():
    with Store() as store:
        plan = SweepPlan.of(Scenario(), {"team.count": [3, 2]}, 3)
        plan.register(store)
        store.add_all(0, [(plan.configurations[c].key, Row(k, k, "error")) for c in (0, 1) for k in range(2 + c)])
        assert [store.count(*first) for first in ((1, 1), (2, 1), (1, None), (2, None), (2, 2))] == [1, 2, 2, 5, 4]


def test_a_run_that_is_repeated_receives_only_the_metrics_that_it_lacks():
    with Store() as store:
        plan = SweepPlan.of(Scenario(), {"team.count": [3]}, 1)
        plan.register(store)
        for values in ({"end_time": 1.0}, {"end_time": 2.0, "active_time": 3.0}):
            store.add(plan.configurations[0].key, 0, Row(0, 0, "ok", Summary(values)))
        (row,) = store.runs(plan.configurations[0].key, 0)
    assert dict(row.summary) == {"end_time": 1.0, "active_time": 3.0}


@pytest.mark.whole
def test_shards_make_the_whole_in_any_order_and_whatever_they_share(tmp_path, file):
    assert command("sweep", file, "--allow-import", "-o", tmp_path / "whole").exit_code == 0
    paths = []
    for k in (1, 2, 3):
        assert command("sweep", file, "--allow-import", "-o", tmp_path / "parts", "--shard", f"{k}/3").exit_code == 0
        paths.append(tmp_path / "parts" / f"sweep.{k}-of-3.sqlite")
    for name, parts in {"a": paths, "b": [*paths[::-1], *paths], "c": [tmp_path / "parts"]}.items():
        made = command("merge", *parts, "-o", tmp_path / name)
        assert made.stdout == f"12 runs are in {tmp_path / name / 'sweep.sqlite'}\n"
        assert exported(tmp_path / name) == exported(tmp_path / "whole")
        assert sweeps.rows(tmp_path / name / "sweep.sqlite") == sweeps.rows(tmp_path / "whole" / "sweep.sqlite")
    again = command("sweep", file, "--allow-import", "-o", tmp_path / "a")
    assert again.stderr.startswith("0 runs in ")
    assert again.stdout == command("sweep", file, "--allow-import", "-o", tmp_path / "whole").stdout


@pytest.mark.slow
def test_shards_can_be_merged_in_their_own_folder_twice(tmp_path, file):
    for k in (1, 2):
        assert command("sweep", file, "--allow-import", "-o", tmp_path / "out", "--shard", f"{k}/2").exit_code == 0
    for _ in range(2):
        made = command("merge", tmp_path / "out", "-o", tmp_path / "out")
        assert made.output == f"12 runs are in {tmp_path / 'out' / 'sweep.sqlite'}\n"


RUNS = st.tuples(st.integers(0, 3), st.sampled_from(["ok", "error", "crashed"]), st.sampled_from(["", "a", "b"]))


@pytest.mark.slow
@given(st.lists(st.lists(RUNS, max_size=6), max_size=4))
def test_runs_that_are_added_together_are_those_added_one_by_one(batches):
    """The model: the first success of a run, otherwise its last failure."""
    expected = {}
    with Store() as together, Store() as single:
        for store in (together, single):
            store.register_metrics(dict.fromkeys(numbers(), ("", "")))
        for batch in batches:
            runs = [("key", run_of(k, status, "" if status == "ok" else text)) for k, status, text in batch]
            together.add_all(0, runs)
            for _, row in runs:
                single.add("key", 0, row)
                if not (row.replication in expected and expected[row.replication].ok):
                    expected[row.replication] = row
        assert together.runs("key", 0) == single.runs("key", 0) == [expected[k] for k in sorted(expected)]
        assert list(together.run_table("key", 0)) == together.runs("key", 0)
        assert together.added == single.added == sum(map(len, batches))


def test_of_runs_that_are_added_together_those_before_the_first_that_fails_are_stored(tmp_path, file):
    plan = SweepPlan.of(load(file, allow_import=True))
    with Store(tmp_path / "sweep.sqlite") as store:
        plan.register(store)
        key = plan.configurations[0].key
        store.add_all(0, [(key, run_of(0)), (key, run_of(1))])
        with pytest.raises(StoreError, match="CHECK constraint failed"):
            store.add_all(0, [(key, run_of(2)), (key, Row(3, 3, "strange")), (key, run_of(4))])
        assert [row.replication for row in store.runs(key, 0)] == [0, 1, 2]
        assert store.added == 3


@pytest.mark.slow
def test_a_store_merged_into_itself_stays_as_it_is(tmp_path, good):
    shutil.copytree(good[1], tmp_path / "out")
    path = tmp_path / "out" / "sweep.sqlite"
    before = sweeps.rows(path)
    with Store(path) as store, Store(path, read_only=True) as same:
        store.merge(same)
    assert sweeps.rows(path) == before


@pytest.mark.slow
def test_a_run_that_failed_in_one_shard_and_not_in_another_did_not_fail(tmp_path, file):
    plan = SweepPlan.of(load(file, allow_import=True))
    stores = [tmp_path / f"{k}.sqlite" for k in range(2)]
    for path, status in zip(stores, (("ok", "error"), ("crashed", "ok")), strict=True):
        with Store(path) as store:
            plan.register(store)
            for number, each in enumerate(status):
                store.add(plan.configurations[0].key, 0, run_of(number, each, path.name))
    for name, order in {"a": stores, "b": stores[::-1]}.items():
        assert command("merge", *order, "-o", tmp_path / name).exit_code == 0
        with Store(tmp_path / name / "sweep.sqlite") as store:
            assert statuses(store, plan) == {(0, "ok", "0.sqlite"), (1, "ok", "1.sqlite")}


def test_of_a_run_that_failed_in_two_shards_the_first_failure_is_kept(tmp_path, file):
    plan = SweepPlan.of(load(file, allow_import=True))
    failures = [("error", "one"), ("crashed", "two")]
    stores = [Store(tmp_path / f"{text}.sqlite") for _, text in failures]
    for store, failure in zip(stores, failures, strict=True):
        plan.register(store)
        store.add(plan.configurations[0].key, 0, run_of(0, *failure))
    for order in (1, -1):
        with Store() as merged:
            for store in stores[::order]:
                merged.merge(store)
            assert statuses(merged, plan) == {(0, *failures[::order][0])}
    for store in stores:
        store.close()


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--set", "horizon=0.9"), "horizon was 1.0, is 0.9"),
        (("-s", 1), "root seed was 0, is 1"),
        (("--set", "sweep.seeds=independent"), 'seeds was "common", is "independent"'),
    ],
)
def test_stores_of_other_sweeps_are_not_merged(tmp_path, file, options, told):
    assert command("sweep", file, "--allow-import", "-o", tmp_path / "one").exit_code == 0
    assert command("sweep", file, "--allow-import", "-o", tmp_path / "other", *options).exit_code == 0
    assert told in refused("merge", tmp_path / "one", tmp_path / "other", "-o", tmp_path / "both")
    assert not (tmp_path / "both" / "sweep.sqlite").exists()
    assert told in refused("sweep", file, "--allow-import", "-o", tmp_path / "one", *options)


@pytest.mark.whole
def test_two_drivers_may_work_on_one_store(tmp_path, file):
    """Both make it, both do all runs, and the table is that of one."""
    out = tmp_path / "out"
    drivers = [sweeps.start("sweep", file, "--allow-import", "-n", 20, "-o", out, mark=str(tmp_path)) for _ in range(2)]
    (one, error_one), (other, error_other) = [driver.communicate() for driver in drivers]
    assert [driver.returncode for driver in drivers] == [0, 0], error_one + error_other
    assert one == other == command("sweep", file, "--allow-import", "-n", 20, "-o", tmp_path / "whole").stdout
    assert sweeps.rows(out / "sweep.sqlite") == sweeps.rows(tmp_path / "whole" / "sweep.sqlite")


@pytest.mark.slow
def test_a_store_can_be_made_by_many_at_the_same_moment(tmp_path):
    barrier = threading.Barrier(8)

    def make(lap):
        barrier.wait()
        with Store(tmp_path / f"{lap}.sqlite") as store:
            return store.check()

    with ThreadPoolExecutor(8) as threads:
        for lap in range(8):
            assert list(threads.map(make, [lap] * 8)) == ["ok"] * 8


@pytest.mark.slow
def test_the_view_has_a_column_per_metric_and_a_row_per_run(tmp_path, file):
    found = sweep(read_source(file, allow_import=True), store=tmp_path / "store.sqlite")
    with closing(sqlite3.connect(tmp_path / "store.sqlite")) as database:
        times = [time for (time,) in database.execute("SELECT active_time FROM results")]
    assert times == [time for group in found.groups for time in group.values("active_time")]


def test_a_merged_store_tells_of_the_merge_and_a_missing_part_is_not_made(tmp_path, monkeypatch):
    sweep(Scenario(horizon=0.1), {"team.count": [2]}, reps=1, store=tmp_path / "part.sqlite")
    words = ["desim", "merge", "part.sqlite", "-o", "all"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", words)
    assert command(*words[1:]).exit_code == 0
    with Store(tmp_path / "all" / "sweep.sqlite", read_only=True) as store:
        assert store.commands[-1] == (str(tmp_path), words)
        assert len(store) == 1
    assert "none.sqlite" in refused("merge", "none.sqlite", "-o", "all")
    assert not (tmp_path / "none.sqlite").exists()


@pytest.mark.slow
def test_a_merged_store_lists_its_sources(tmp_path, file):
    parts = [tmp_path / "1", tmp_path / "2"]
    for k, part in enumerate(parts, start=1):
        assert command("sweep", file, "--allow-import", "--shard", f"{k}/2", "-o", part).exit_code == 0
    assert command("merge", *parts, "-o", tmp_path / "all").exit_code == 0
    made = json.loads((tmp_path / "all" / "run.json").read_text())
    stores = [str(part / f"sweep.{k}-of-2.sqlite") for k, part in enumerate(parts, start=1)]
    assert (made["what"], made["stores"]) == ("merge", stores)
    with Store(tmp_path / "all" / "sweep.sqlite") as store:
        assert made["runs"] == len(store) > 0


@pytest.mark.slow
def test_a_store_does_not_return_the_results_of_another_model(tmp_path):
    """Evaders that stand and that flee, by the same code and a table of which `repr` shows the ends only."""

    def times(heading, store):
        table = np.zeros(2000)
        table[1000] = heading
        scenario = Scenario(horizon=1.0, evader={"strategy": lambda state, rng: table[1000]})
        (group,) = sweep(scenario, {"team.count": [4]}, reps=2, store=store).groups
        return group.values("potential_gap")

    standing, fleeing = (times(heading, None) for heading in (0.0, 1.0))
    assert standing != fleeing
    store = tmp_path / "one.sqlite"
    assert [times(0.0, store), times(1.0, store), times(0.0, store)] == [standing, fleeing, standing]
    with Store(store) as kept:
        assert len(kept) == 4


@pytest.mark.parametrize("releases", [True, False])
def test_a_store_that_another_process_is_about_to_make_is_waited_for(tmp_path, monkeypatch, releases):
    """While another connection is about to write, SQLite refuses to change the journal at once, whatever its timeout.

    The other lets go in the third pause or, where retries are off, never.
    """
    path, pauses = tmp_path / "sweep.sqlite", []
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")

        def pause(seconds):
            pauses.append(seconds)
            if len(pauses) == 3:
                other.execute("ROLLBACK")

        monkeypatch.setattr(store_connection.time, "sleep", pause)
        if releases:
            with Store(path) as store:
                assert (store.check(), len(pauses)) == ("ok", 3)
        else:
            monkeypatch.setattr(store_connection, "LOCK_TIMEOUT", 0.0)
            with pytest.raises(StoreError, match=r"sweep\.sqlite: database is locked"):
                Store(path)


@pytest.mark.parametrize("why", ["the file system cannot", "memory cannot be shared"])
def test_without_a_write_ahead_log_there_is_a_rollback_journal_and_a_warning(tmp_path, monkeypatch, why):
    """SQLite locks with a file of its own, which leaves nothing to share; or the file to be shared cannot be made."""
    path, address = tmp_path / "sweep.sqlite", store_connection.address_of
    if why == "the file system cannot":
        monkeypatch.setattr(store_connection, "address_of", lambda *args: address(*args) + "&vfs=unix-dotfile")
    else:
        (tmp_path / "sweep.sqlite-shm").mkdir()
    with pytest.warns(UserWarning, match=f"{path}: .* no write-ahead log"), Store(path) as store:
        store.register([])
    with Store(path) as store:
        assert store.database.execute("PRAGMA journal_mode").fetchone() == ("delete",)
    with Store(path, read_only=True) as store:
        assert (store.check(), len(store)) == ("ok", 0)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Return a folder with a finished sweep of 2 x 4 runs, below that of its scenario, and the table of its runs."""
    folder = tmp_path_factory.mktemp("good")
    file = sweeps.write(folder, reps=4)
    with pytest.MonkeyPatch.context() as patch:
        undraw(patch)
        assert command("sweep", file, "--allow-import", "-o", folder / "out").exit_code == 0
    table = exported(folder / "out")
    (folder / "out" / "runs.csv").unlink()
    return file, folder / "out", table


def without_rights(program, *args):
    """Run a program to which file permissions apply, even as root."""
    prefix = [] if os.geteuid() else ["setpriv", "--bounding-set", "-dac_override,-dac_read_search"]
    environment = {**os.environ, "PYTHONPATH": str(sweeps.ROOT)}
    made = subprocess.run(
        [*prefix, sys.executable, "-c", program, *map(str, args)], env=environment, capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr
    return made.stdout


COMMANDS = """
import sys
from desim.cli import main
from desim.view.pages import report
report._inline = lambda *_: ""  # no pictures, which take most of the time
for here in sys.argv[1:]:
    for words in (["export", here, f"{here}-mine/runs.csv"], ["report", here, "-o", f"{here}-mine/r.html"],
                  ["merge", here, "-o", f"{here}-mine/all"]):
        main(words, standalone_mode=False)
"""


@pytest.mark.whole
@pytest.mark.skipif(not (os.geteuid() or shutil.which("setpriv")), reason="permissions do not bind root")
def test_a_store_that_may_not_be_written_is_read(tmp_path, good):
    """Its file, or its folder, too. Nothing appears beside it, and its own file stays as it is."""
    folders = file, folder = tmp_path / "a # b?", tmp_path / "b"
    for each in folders:
        shutil.copytree(good[1], each)
        (tmp_path / f"{each.name}-mine").mkdir()
        (each / "sweep.sqlite").chmod(0o444)
    before = {each.name for each in file.iterdir()}
    folder.chmod(0o555)
    without_rights(COMMANDS, *folders)
    folder.chmod(0o755)
    for each in folders:
        there = tmp_path / f"{each.name}-mine"
        assert {other.name for other in each.iterdir()} == before
        assert (there / "runs.csv").read_bytes() == good[2] == exported(there / "all")
        assert (there / "r.html").exists()


@pytest.mark.whole
@pytest.mark.skipif(not (os.geteuid() or shutil.which("setpriv")), reason="permissions do not bind root")
def test_the_journal_of_a_read_only_store_is_read(tmp_path, file):
    """As of a driver that was killed: without the shared memory beside it the journal cannot be read, which is
    reported.
    """
    (tmp_path / "live").mkdir()
    with Store(tmp_path / "live" / "sweep.sqlite") as store:
        SweepPlan.of(load(file, allow_import=True)).register(store)
        shutil.copytree(tmp_path / "live", tmp_path / "killed", ignore=shutil.ignore_patterns("*-shm"))
    path = tmp_path / "killed" / "sweep.sqlite"
    assert path.with_name("sweep.sqlite-wal").stat().st_size > 0
    path.parent.chmod(0o555)
    program = (
        "import sys; from desim.cli import main\ntry: main(sys.argv[1:])\nexcept SystemExit as end: print(end.code)"
    )
    assert without_rights(f"{program}", "export", path, tmp_path / "a.csv").strip() == "2"


def edited(good, folder, *statements):
    """Return a copy of a store in a folder that was changed by SQL."""
    shutil.copytree(good[1], folder)
    path = folder / "sweep.sqlite"
    with closing(sqlite3.connect(path)) as database, database:
        for statement in statements:
            database.execute(statement)
    return path


FIRST_RUN = "runs: configuration .*, replication 0, root_seed 0, seed 0: "
EDITS = {
    "UPDATE runs SET summary = x'00ff'": f"{FIRST_RUN}summary: ",
    "UPDATE runs SET traceback = CAST(x'ff' AS TEXT)": "Could not decode to UTF-8 column 'traceback'",
    "DELETE FROM configurations": "is damaged: it has runs of a configuration that is missing",
    "CREATE TRIGGER t AFTER INSERT ON runs BEGIN DELETE FROM runs; END": "was made by another version",
    "DROP VIEW results": "was made by another version of desim, or edited",
    "UPDATE runs SET root_seed = 1 WHERE rowid = 1": "runs: .*, root_seed 1, seed 0: should have the root seed 0",
    "UPDATE runs SET summary = NULL": f"{FIRST_RUN}should have a summary if its status is ok",
    "UPDATE runs SET summary = '{'": f"{FIRST_RUN}summary: Invalid JSON",
    "UPDATE runs SET summary = json_set(summary, '$.new', 1)": f"{FIRST_RUN}summary.new: is no metric of this store",
    "UPDATE metrics SET name = 'x' WHERE name = 'energy'": f"{FIRST_RUN}summary.energy: is no metric of this store",
    "UPDATE runs SET summary = json_set(summary, '$.active_time', 'x')": f"{FIRST_RUN}summary.active_time: should be a",
    "UPDATE runs SET summary = json_set(summary, '$.active_time', '2')": f"{FIRST_RUN}summary.active_time: should be a",
    "UPDATE runs SET summary = json_set(summary, '$.captured', 'true')": f"{FIRST_RUN}summary.captured: ",
    "UPDATE runs SET seed = 'x'": "runs: .*, seed x: seed: String should match pattern",
    "UPDATE configurations SET settings = '[1]'": "configurations: configuration .*: settings: should be a table",
    "UPDATE configurations SET settings = '{}'": "configuration .*: should have the settings network.loss.p",
    "UPDATE about SET value = '{' WHERE name = 'grid'": "about: name grid: value: Invalid JSON",
    "UPDATE about SET value = '7' WHERE name = 'grid'": "about: name grid: value: should be a list",
    "DELETE FROM about WHERE name = 'seeds'": "is damaged: seeds is missing in about",
}


@pytest.mark.parametrize("statement", EDITS)
def test_a_store_that_was_edited_is_refused_and_the_row_is_named(tmp_path, good, statement):
    path, told = edited(good, tmp_path / "out", statement), EDITS[statement]
    with pytest.raises(StoreError, match=f"^{path}: {told}"), Store(path, read_only=True) as store:
        SweepResult.of(store)


def test_tables_that_are_views_are_refused_before_they_are_read(tmp_path, good):
    """The recursive query would never end."""
    endless = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) SELECT k FROM n"
    path = edited(good, tmp_path / "out", "DROP TABLE runs", f"CREATE VIEW runs AS {endless}")
    with pytest.raises(StoreError, match="was made by another version of desim, or edited"):
        Store(path)


def damaged(rng, whole):
    """Return the bytes of a file with some damage."""
    found, size = bytearray(whole), len(whole)
    kind = rng.choice(["bits", "cut", "page", "digit", "bytes"])
    if kind == "bits":
        for _ in range(rng.randint(1, 8)):
            found[rng.randrange(size)] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del found[rng.randrange(size) :]
    elif kind == "page":
        first = rng.randrange(size // 4096) * 4096
        found[first : first + 4096] = bytes(4096)
    elif kind == "digit":
        place = rng.choice([k for k, each in enumerate(whole) if chr(each).isdigit()])
        found[place] = rng.choice([each for each in b"0123456789" if each != whole[place]])
    else:
        first = rng.randrange(size - 64)
        found[first : first + 64] = rng.randbytes(64)
    return bytes(found)


@pytest.mark.parametrize("seed", [*range(2), pytest.param(None, marks=pytest.mark.slow)])
def test_a_damaged_store_is_refused_or_read(tmp_path, good, seed):
    """Bits, bytes, a digit, a page or the end are others: no command ends with a traceback."""
    file, folder, _ = good
    whole, outcomes = (folder / "sweep.sqlite").read_bytes(), set()
    for each in range(1000, 1010) if seed is None else [seed]:
        damage, out, merged = damaged(random.Random(each), whole), tmp_path / "out", tmp_path / "merged"
        for words in (
            ("export", out, tmp_path / "a.csv"),
            ("report", out, "-o", tmp_path / "r.html"),
            ("merge", out, "-o", merged),
            ("sweep", file, "--allow-import", "-o", out),
        ):
            for each_folder in (out, merged):
                shutil.rmtree(each_folder, ignore_errors=True)
            shutil.copytree(folder, out)
            (out / "sweep.sqlite").write_bytes(damage)
            made = command(*words)
            outcomes.add(made.exit_code)
            assert made.exit_code in {0, WRONG_INPUT}, (each, words, made.exception)
            if made.exit_code:
                assert f"{out / 'sweep.sqlite'}: " in made.stderr
    assert seed is not None or outcomes == {0, WRONG_INPUT}


def test_an_interrupt_while_an_adapter_is_built_is_raised_afterwards():
    """Pydantic drops one that is raised while it compiles a pattern, and builds an adapter that refuses everything."""
    built = []

    class Interrupting:
        @classmethod
        def __get_pydantic_core_schema__(cls, *_):
            signal.raise_signal(signal.SIGINT)
            built.append(cls)
            return core_schema.any_schema()

    with pytest.raises(KeyboardInterrupt):
        module.adapter_of(Interrupting)
    assert built == [Interrupting]


# Versions.

OTHER = {"python": "3.99", "numpy": "0.1"}


@pytest.fixture
def elsewhere(monkeypatch):
    """Let runs be computed by another Python and another numpy, as the store sees it."""
    here = environment.computing_versions()
    with monkeypatch.context() as patch:
        patch.setattr(environment, "computing_versions", lambda: here | OTHER)
        yield patch


def test_runs_of_other_versions_are_refused_unless_mixed(tmp_path, elsewhere):
    path, scenario, grid = tmp_path / "sweep.sqlite", Scenario(horizon=0.1), {"team.count": [2]}
    there = environment.computing_versions()
    sweep(scenario, grid, reps=1, store=path)
    elsewhere.undo()
    here = environment.computing_versions()
    told = f"numpy 0.1, and this is python {here['python']}, numpy {here['numpy']}, so last digits may differ: mix them"
    with pytest.raises(StoreError, match=f"has runs of python 3.99, {told} with --mix-versions"):
        sweep(scenario, grid, reps=2, store=path)
    assert len(sweep(scenario, grid, reps=2, store=path, mix_versions=True).groups[0].rows) == 2
    assert len(sweep(scenario, grid, reps=3, store=path).groups[0].rows) == 3  # both are in the store now
    with Store(path, read_only=True) as store:
        assert store.versions == [there, here]


@pytest.mark.slow
def test_an_explanation_is_computed_by_one_version_too(tmp_path, elsewhere):
    path, scenario = tmp_path / "explain.sqlite", Scenario(horizon=0.1, network=Links(latency=Constant(value=0.01)))
    explain(scenario, runs=2, store=path)
    elsewhere.undo()
    with pytest.raises(StoreError, match=r"has runs of python 3\.99, numpy 0\.1, and this is python"):
        explain(scenario, runs=2, store=path)
    assert explain(scenario, runs=2, store=path, mix_versions=True).costs


def test_versions_are_those_of_python_and_of_the_packages_that_compute(monkeypatch):
    """A bug-fix release of Python changes no arithmetic; one of a package may."""
    found = environment.computing_versions()
    assert list(found) == ["python", "numpy", "scipy", "simpy", "networkx"]
    assert found["numpy"] == np.__version__
    monkeypatch.setattr(environment.platform, "python_version_tuple", lambda: ("3", "12", "7"))
    assert environment.computing_versions()["python"] == "3.12"


@pytest.mark.slow
def test_stores_of_other_versions_are_merged_only_if_they_may_be_mixed(tmp_path, file, elsewhere):
    for part in ("1/2", "2/2"):
        assert command("sweep", file, "--allow-import", "-n", 1, "--shard", part, "-o", tmp_path / "in").exit_code == 0
        elsewhere.undo()
    told = refused("merge", tmp_path / "in", "-o", tmp_path / "out")
    here = environment.computing_versions()["python"]
    assert f"has runs of python 3.99, numpy 0.1, and {tmp_path / 'in' / 'sweep.2-of-2.sqlite'} has those of" in told
    assert f"python {here}" in told
    assert not (tmp_path / "out" / "sweep.sqlite").exists()
    assert command("merge", tmp_path / "in", "-o", tmp_path / "out", "--mix-versions").exit_code == 0
    with Store(tmp_path / "out" / "sweep.sqlite", read_only=True) as store:
        assert [each["python"] for each in store.versions] == ["3.99", here]
        with Store() as merged:
            merged.merge(store)  # mixed already
            assert merged.versions == store.versions


@pytest.mark.slow
def test_a_sweep_is_planned_and_continued_on_the_command_line_only_with_its_versions(tmp_path, file, elsewhere):
    words = ("sweep", file, "--allow-import", "-n", 1, "-o", tmp_path / "out")
    assert command(*words).exit_code == 0
    elsewhere.undo()
    assert "has runs of python 3.99" in refused(*words)
    assert "has runs of python 3.99" in refused(*words, "--dry-run")
    assert command(*words, "--mix-versions", "--dry-run").exit_code == 0
    assert "has runs of python 3.99" in refused(*words)
    assert command(*words, "--mix-versions").exit_code == 0
    page = report(Study.read(tmp_path / "out"))
    assert "runs computed by" in page
    assert "python 3.99, numpy 0.1" in page


LOG, ROLLBACK, NO_JOURNAL = "-wal", "-journal", ""


@pytest.mark.parametrize(
    ("journal", "writable", "network", "mode"),
    [
        (NO_JOURNAL, True, "", "rw"),
        (NO_JOURNAL, False, "", "ro&immutable=1"),
        (NO_JOURNAL, True, "NFS", "ro"),
        (LOG, True, "", "rw"),
        (LOG, False, "", "ro"),
        (ROLLBACK, False, "", "ro"),
        (LOG, True, "NFS", "ro"),
    ],
)
def test_a_file_is_read_as_its_journal_and_its_place_allow(tmp_path, monkeypatch, journal, writable, network, mode):
    """An immutable file is read without its journal, whose content would be missing."""
    path = tmp_path / "a.sqlite"
    path.write_bytes(bytes(18) + b"\1\1")
    if journal:
        path.with_name(path.name + journal).write_bytes(b"content")
    monkeypatch.setattr(store_connection, "is_writable", lambda _: writable)
    monkeypatch.setattr(store_connection, "has_locks", lambda _: True)
    assert store_connection.address_of(path, True, network) == f"{path.as_uri()}?mode={mode}"
    assert store_connection.address_of(path, False, network) == f"{path.as_uri()}?mode=rwc"


@pytest.mark.parametrize(("header", "mode"), [(b"\1\1", "ro"), (b"\2\2", "ro&immutable=1")])
def test_a_settled_file_with_a_log_is_immutable_on_a_network_file_system(tmp_path, monkeypatch, header, mode):
    path = tmp_path / "a.sqlite"
    path.write_bytes(bytes(18) + header)
    monkeypatch.setattr(store_connection, "has_locks", lambda _: False)
    assert store_connection.address_of(path, True, "NFS") == f"{path.as_uri()}?mode={mode}&vfs=unix-none"


@pytest.mark.slow
def test_stores_without_runs_are_merged_into_one_without_a_root_seed(tmp_path):
    for name in ("a.sqlite", "b.sqlite"):
        with Store(tmp_path / name):
            pass
    made = command("merge", tmp_path / "a.sqlite", tmp_path / "b.sqlite", "-o", tmp_path / "all")
    assert made.exit_code == 0
    assert json.loads((tmp_path / "all" / "run.json").read_text())["seed"] == 0

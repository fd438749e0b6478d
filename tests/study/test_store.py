"""The store: what cannot be one is told of by its file, what was done is kept, and parts make a whole."""

import json
import resource
import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import numpy as np
import pytest

from desim.scenario import Scenario
from desim.scenario_file import load, read
from desim.study.store import Row, Store
from desim.study.sweep import Plan, sweep
from tests.study import sweeps
from tests.study.test_workers import command

WRONG_INPUT = 2


@pytest.fixture
def file(tmp_path):
    """Return a scenario of 2 x 6 runs."""
    return sweeps.write(tmp_path / "in", reps=6)


def refused(*args):
    """Return what a command says that it does not do."""
    made = command(*args)
    assert (made.exit_code, made.stdout) == (WRONG_INPUT, "")
    assert "Traceback" not in made.stderr
    return made.stderr.strip()


def exported(out):
    """Return the table of a store as it is exported."""
    assert command("export", out, out / "runs.csv").exit_code == 0
    return (out / "runs.csv").read_bytes()


def test_what_is_no_store_is_named(tmp_path, file):
    folder, text = tmp_path / "folder", tmp_path / "text"
    (folder / "sweep.sqlite").mkdir(parents=True)
    text.mkdir()
    (text / "sweep.sqlite").write_text("all work and no play " * 99)
    assert (
        refused("sweep", file, "--allow-import", "-o", folder)
        == f"{folder / 'sweep.sqlite'}: unable to open database file"
    )
    assert refused("sweep", file, "--allow-import", "-o", text) == f"{text / 'sweep.sqlite'}: file is not a database"
    assert (text / "sweep.sqlite").read_text().startswith("all work")
    assert refused("sweep", file, "--allow-import", "-o", file) == f"{file}: File exists"
    assert refused("sweep", file, "--allow-import", "-o", file / "below") == f"{file / 'below'}: Not a directory"


def test_a_database_of_something_else_is_refused_and_left_alone(tmp_path, file):
    path = tmp_path / "sweep.sqlite"
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE cats (name TEXT)")
    before = path.read_bytes()
    assert (
        refused("sweep", file, "--allow-import", "-o", tmp_path)
        == f"{path}: is a database, but not of the runs of a sweep"
    )
    assert path.read_bytes() == before


@pytest.mark.parametrize("name", ["format", "metrics"])
def test_a_store_of_another_version_is_refused(tmp_path, file, name):
    with Store(tmp_path / "sweep.sqlite"):
        pass
    with closing(sqlite3.connect(tmp_path / "sweep.sqlite")) as database, database:
        database.execute("UPDATE about SET value = '[0]' WHERE name = ?", (name,))
    told = refused("sweep", file, "--allow-import", "-o", tmp_path)
    hint = "remove it, or choose another folder (-o)"
    assert told == f"{tmp_path / 'sweep.sqlite'}: was made by another version of desim; {hint}"


def test_an_export_of_no_store_or_an_empty_one_is_refused(tmp_path):
    missing = tmp_path / "none"
    assert refused("export", missing, tmp_path / "a.csv") == f"{missing}: there is no such store"
    missing.mkdir()
    assert refused("export", missing, tmp_path / "a.csv") == f"{missing / 'sweep.sqlite'}: there is no such store"
    assert not (missing / "sweep.sqlite").exists()
    with Store(missing / "sweep.sqlite"):
        pass
    assert refused("export", missing, tmp_path / "a.csv") == f"{missing / 'sweep.sqlite'}: is empty"
    assert not (tmp_path / "a.csv").exists()


def test_a_full_disk_is_told_of_and_what_was_done_is_kept(tmp_path, file, monkeypatch):
    """A store that may have 16 pages of 4 kB holds the configurations, and not all of 200 runs."""
    begin = Store._open

    def small(self, path):
        begin(self, path)
        self._database.execute("PRAGMA max_page_count = 16")

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(Store, "_open", small)
        assert (
            refused("sweep", file, "--allow-import", "-n", 100, "-o", out)
            == f"{out / 'sweep.sqlite'}: database or disk is full"
        )
    _, runs = sweeps.rows(out / "sweep.sqlite")
    assert 10 < len(runs) < 200
    assert command("sweep", file, "--allow-import", "-n", 100, "-o", out).exit_code == 0
    assert command("sweep", file, "--allow-import", "-n", 100, "-o", tmp_path / "whole").exit_code == 0
    assert exported(out) == exported(tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0, 4, 60, 200])
def test_files_that_may_not_grow_are_told_of(tmp_path, file, limit):
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


@pytest.mark.parametrize("name", ["sweep.txt", "sweep.svg", "run.json"])
def test_what_cannot_be_written_beside_a_store_is_told_of(tmp_path, file, name):
    (tmp_path / name).mkdir()
    made = command("sweep", file, "--allow-import", "-o", tmp_path)
    assert made.exit_code == WRONG_INPUT
    assert made.stderr.splitlines()[-1] == f"{tmp_path / name}: Is a directory"


def run_of(number, status="ok", text=""):
    return Row(number, number, status, traceback=text)


def statuses(store, plan):
    return {(row.replication, row.status, row.traceback) for row in store.runs(plan.cells[0].key, 0)}


def test_configurations_stand_before_those_that_were_there(file):
    plan = Plan.of(load(file, allow_import=True))
    with Store() as store:
        for cell in reversed(plan.cells):
            store.enter([cell])
        assert [key for key, _ in store.configurations()] == [cell.key for cell in plan.cells]
        assert len(plan.cells) > 1


def test_a_failed_run_gives_way_to_any_and_a_good_one_to_none(file):
    """So the slower of two drivers cannot spoil what the faster has."""
    plan = Plan.of(load(file, allow_import=True))
    with Store() as store:
        plan.enter(store)
        for status, text in (("error", "one"), ("crashed", "two"), ("ok", "three"), ("error", "four")):
            store.add(plan.cells[0].key, 0, run_of(0, status, text))
            expected = "three" if text == "four" else text
            assert {each[2] for each in statuses(store, plan)} == {expected}


def test_shards_make_the_whole_in_any_order_and_whatever_they_share(tmp_path, file):
    assert command("sweep", file, "--allow-import", "-o", tmp_path / "whole").exit_code == 0
    paths = []
    for k in (1, 2, 3):
        assert command("sweep", file, "--allow-import", "-o", tmp_path / "parts", "--shard", f"{k}/3").exit_code == 0
        paths.append(tmp_path / "parts" / f"sweep.{k}-of-3.sqlite")
    for name, given in {"a": paths, "b": [*paths[::-1], *paths], "c": [tmp_path / "parts"]}.items():
        made = command("merge", *given, "-o", tmp_path / name)
        assert made.stdout == f"12 runs are in {tmp_path / name / 'sweep.sqlite'}\n"
        assert exported(tmp_path / name) == exported(tmp_path / "whole")
        assert sweeps.rows(tmp_path / name / "sweep.sqlite") == sweeps.rows(tmp_path / "whole" / "sweep.sqlite")
    again = command("sweep", file, "--allow-import", "-o", tmp_path / "a")
    assert again.stderr.startswith("0 runs in ")
    assert again.stdout == command("sweep", file, "--allow-import", "-o", tmp_path / "whole").stdout


def test_shards_can_be_merged_in_their_own_folder_twice(tmp_path, file):
    for k in (1, 2):
        assert command("sweep", file, "--allow-import", "-o", tmp_path / "out", "--shard", f"{k}/2").exit_code == 0
    for _ in range(2):
        made = command("merge", tmp_path / "out", "-o", tmp_path / "out")
        assert made.output == f"12 runs are in {tmp_path / 'out' / 'sweep.sqlite'}\n"


def test_a_run_that_failed_in_one_shard_and_not_in_another_did_not_fail(tmp_path, file):
    plan = Plan.of(load(file, allow_import=True))
    stores = [tmp_path / f"{k}.sqlite" for k in range(2)]
    for path, status in zip(stores, (("ok", "error"), ("crashed", "ok")), strict=True):
        with Store(path) as store:
            plan.enter(store)
            for number, each in enumerate(status):
                store.add(plan.cells[0].key, 0, run_of(number, each, path.name))
    for name, order in {"a": stores, "b": stores[::-1]}.items():
        assert command("merge", *order, "-o", tmp_path / name).exit_code == 0
        with Store(tmp_path / name / "sweep.sqlite") as store:
            assert statuses(store, plan) == {(0, "ok", "0.sqlite"), (1, "ok", "1.sqlite")}


def test_of_a_run_that_failed_in_two_shards_the_first_failure_is_kept(tmp_path, file):
    plan = Plan.of(load(file, allow_import=True))
    failures = [("error", "one"), ("crashed", "two")]
    stores = [Store(tmp_path / f"{text}.sqlite") for _, text in failures]
    for store, failure in zip(stores, failures, strict=True):
        plan.enter(store)
        store.add(plan.cells[0].key, 0, run_of(0, *failure))
    for order in (1, -1):
        with Store() as merged:
            for store in stores[::order]:
                merged.take(store)
            assert statuses(merged, plan) == {(0, *failures[::order][0])}
    for store in stores:
        store.close()


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


@pytest.mark.slow
def test_two_drivers_may_work_on_one_store(tmp_path, file):
    """Both make it, both do all runs, and the table is that of one."""
    out = tmp_path / "out"
    drivers = [sweeps.start("sweep", file, "--allow-import", "-n", 50, "-o", out, mark=str(tmp_path)) for _ in range(2)]
    (one, error_one), (other, error_other) = [driver.communicate() for driver in drivers]
    assert [driver.returncode for driver in drivers] == [0, 0], error_one + error_other
    assert one == other == command("sweep", file, "--allow-import", "-n", 50, "-o", tmp_path / "whole").stdout
    assert sweeps.rows(out / "sweep.sqlite") == sweeps.rows(tmp_path / "whole" / "sweep.sqlite")


@pytest.mark.slow
def test_a_store_can_be_made_by_many_at_the_same_moment(tmp_path):
    barrier = threading.Barrier(8)

    def make(lap):
        barrier.wait()
        with Store(tmp_path / f"{lap}.sqlite") as store:
            return store.check()

    with ThreadPoolExecutor(8) as threads:
        for lap in range(20):
            assert list(threads.map(make, [lap] * 8)) == ["ok"] * 8


def test_the_view_has_a_column_per_metric_and_a_row_per_run(tmp_path, file):
    found = sweep(read(file, allow_import=True), store=tmp_path / "store.sqlite")
    with closing(sqlite3.connect(tmp_path / "store.sqlite")) as database:
        times = [time for (time,) in database.execute("SELECT active_time FROM results")]
    assert times == [time for group in found.groups for time in group.values("active_time")]


def test_a_merged_store_says_what_it_was_made_of(tmp_path, file):
    parts = [tmp_path / "1", tmp_path / "2"]
    for k, part in enumerate(parts, start=1):
        assert command("sweep", file, "--allow-import", "--shard", f"{k}/2", "-o", part).exit_code == 0
    assert command("merge", *parts, "-o", tmp_path / "all").exit_code == 0
    made = json.loads((tmp_path / "all" / "run.json").read_text())
    stores = [str(part / f"sweep.{k}-of-2.sqlite") for k, part in enumerate(parts, start=1)]
    assert (made["what"], made["stores"]) == ("merge", stores)
    with Store(tmp_path / "all" / "sweep.sqlite") as store:
        assert made["runs"] == len(store) > 0


def test_a_store_does_not_return_the_results_of_another_model(tmp_path):
    """Evaders that stand and that flee, by the same code and a table of which `repr` shows the ends only."""

    def times(heading, store):
        table = np.zeros(2000)
        table[1000] = heading
        scenario = Scenario(horizon=1.0, evader={"strategy": lambda outlook, rng: table[1000]})
        (group,) = sweep(scenario, {"team.count": [4]}, reps=2, store=store).groups
        return group.values("potential_gap")

    standing, fleeing = (times(heading, None) for heading in (0.0, 1.0))
    assert standing != fleeing
    store = tmp_path / "one.sqlite"
    assert [times(0.0, store), times(1.0, store), times(0.0, store)] == [standing, fleeing, standing]
    with Store(store) as kept:
        assert len(kept) == 4

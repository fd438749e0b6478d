"""Sweeps: which runs are done with which seeds, how many are needed, and what a store may be continued with."""

import html
import importlib
import re
import sqlite3
import subprocess
import sys
from contextlib import closing, nullcontext
from functools import partial
from io import StringIO
from math import inf, nan
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from desim import run, summary
from desim import sweep as sweep_of_package
from desim.analysis.looks import runs_needed
from desim.analysis.statistics import estimate, paired
from desim.config.model import Value
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.pursuit.team.announcements import STARTS
from desim.scenario.overrides import ScenarioError
from desim.scenario.players import Team
from desim.scenario.scenario import Recording, Scenario
from desim.scenario.sweep_table import Sweep
from desim.scenario.toml import read_source
from desim.study.results.result import SweepResult
from desim.study.store.file import StoreError
from desim.study.store.store import Store
from desim.study.sweeps import sweep as module
from desim.study.sweeps.sweep import RunError, sweep
from desim.study.sweeps.sweep_plan import MAX_RUNS, SweepPlan
from desim.study.workers.batch import run_many, seeds_from
from desim.study.workers.executors import workers_for
from protocols.rule import Rule

# Chance in positions, slots and decisions; about 3 ms each.
BASE = Scenario(name="coins", seed=5, horizon=0.5, team=Team(count=3, box=(9.0, 11.0)), motion={"step": 0.05})
GRID = {"network.latency.value": [0.0, 0.2], "capture.radius": [0.05, 0.2]}


class Moody(Rule):
    """Refuses to work with every third seed."""

    kind: str = "moody"

    def actions(self, me):
        if me.rng.bit_generator.seed_seq.entropy % 3 == 0:
            raise ValueError("not today")
        while True:
            yield int(me.rng.random() < 0.5)


def by_hand(seeds, **change):
    """Return the summary of each run, done one by one."""
    return [summary(run(BASE.model_copy(update=change), seed=seed)) for seed in seeds]


# Seeds.


@pytest.mark.slow
def test_run_k_of_every_configuration_has_the_same_seed():
    found = sweep(BASE, GRID, 3)
    assert [[row.seed for row in group.rows] for group in found.groups] == [[5_000_000, 5_000_001, 5_000_002]] * 4
    assert [[row.seed for row in group.rows] for group in sweep(BASE, GRID, 2, seed=40).groups] == [
        [40_000_000, 40_000_001]
    ] * 4


@pytest.mark.slow
def test_every_run_is_that_which_one_would_do_by_hand():
    found = sweep(BASE, {"network.latency.value": [0.0, 0.2]}, 3)
    for value, group in zip([0.0, 0.2], found.groups, strict=True):
        assert [row.summary for row in group.rows] == by_hand(
            seeds_from(5, 3), network=Links(latency=Constant(value=value))
        )


@pytest.mark.slow
def test_paired_differences_are_those_of_runs_by_hand():
    metric = "active_time"
    found = sweep(BASE, {"network.latency.value": [0.0, 0.2]}, 8).differences(metric)
    without, with_latency = (
        [getattr(each, metric) for each in by_hand(seeds_from(5, 8), network=Links(latency=Constant(value=value)))]
        for value in (0.0, 0.2)
    )
    assert found[1] == paired(with_latency, without)
    assert found[1].mean != 0.0
    assert (found[0].mean, found[0].half_width) == (0.0, 0.0)


def independent(seed=5, reps=4, grid=GRID):
    plan = SweepPlan.of(BASE.model_copy(update={"sweep": Sweep(seeds="independent")}), grid, reps, seed)
    return [plan.seed(cell, k) for cell in plan.configurations for k in range(reps)]


def test_independent_seeds_are_all_different_and_the_same_every_time():
    """4 configurations x 4 runs x 3 roots: 48 of 2^56, stable however many runs and configurations there are."""
    seeds = [each for root in (5, 6, 7) for each in independent(root)]
    assert len(set(seeds)) == 48
    assert independent() == independent()
    assert set(independent(reps=2)) < set(independent())
    assert set(independent(grid={**GRID, "capture.radius": [0.2]})) < set(independent())


@pytest.mark.whole
def test_independent_seeds_are_the_same_in_another_process():
    """Or a store could not be continued by another process."""
    scenario = BASE.model_copy(update={"sweep": Sweep(seeds="independent")})
    plan = SweepPlan.of(scenario, GRID)
    script = (
        "from desim.scenario.scenario import Scenario\n"
        "from desim.study.sweeps.sweep_plan import SweepPlan\n"
        f"plan = SweepPlan.of(Scenario.model_validate_json({scenario.model_dump_json()!r}), {GRID}, 4, 5)\n"
        "print([plan.seed(cell, k) for cell in plan.configurations for k in range(4)])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={"PYTHONHASHSEED": "3", "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == str(independent())
    assert not plan.common


@pytest.mark.slow
def test_independent_runs_are_no_pairs():
    found = sweep(BASE.model_copy(update={"sweep": Sweep(seeds="independent")}), GRID, 2)
    with pytest.raises(ValueError, match="cannot be paired"):
        found.differences("active_time")
    assert "difference" not in found.table()
    assert found.document()["configurations"][1]["difference"] == {}


@pytest.mark.whole
def test_common_seeds_make_differences_precise():
    """Of active time, between latencies of 0 and 0.02 s: var + var' of unpaired runs over the variance of pairs.

    1245 with 50 pairs, and at least 11 with five other sets, for few seeds make most of the difference. The
    control, run k paired with run k + 1, has 1 up to chance: 0.74 to 1.20.
    """
    found = sweep(BASE.model_copy(update={"horizon": 2.0}), {"network.latency.value": [0.0, 0.02]}, 50, seed=0)
    one, other = (np.array(group.values("active_time")) for group in found.groups)
    unpaired = one.var(ddof=1) + other.var(ddof=1)
    assert unpaired / (other - one).var(ddof=1) > 10.0
    assert 0.7 < unpaired / (np.roll(other, 1) - one).var(ddof=1) < 1.4


# How many runs.


@pytest.fixture
def looks(monkeypatch):
    """Let sweeps take their first look at 10 runs instead of 100; return that stopping rule."""
    monkeypatch.setattr(module, "runs_needed", partial(runs_needed, first_look=10))
    return module.runs_needed


@pytest.mark.slow
def test_a_precision_takes_as_many_runs_as_the_stopping_rule_requires(looks):
    target = ("active_time", 0.035)
    found = sweep(BASE, {"capture.radius": [0.05, 0.2]}, 30, until=target)
    for group in found.groups:
        values = group.values("active_time")
        assert len(values) == looks(values, 0.035, at_most=30)
        assert [row.replication for row in group.rows] == list(range(len(values)))
    counts = [len(group.rows) for group in found.groups]
    assert 10 < max(counts) <= 30
    assert all(estimate(g.values("active_time")).half_width <= 0.035 for g in found.groups if len(g.rows) < 30)


@pytest.mark.slow
def test_truths_are_as_precise_as_wilsons_interval(looks):
    (group,) = sweep(BASE, {"capture.radius": [0.2]}, until=("captured", 0.2)).groups
    values = group.values("captured")
    assert {type(each) for each in values} == {bool}
    assert len(values) == looks(values, 0.2, at_most=MAX_RUNS) < MAX_RUNS


@pytest.mark.slow
def test_at_most_as_many_runs_as_are_asked_for_are_done():
    found = sweep(BASE, {"capture.radius": [0.2]}, 33, until=("active_time", 1e-9))
    assert [len(group.rows) for group in found.groups] == [33]


@pytest.mark.slow
def test_a_sweep_of_several_rounds_calls_on_start_once(monkeypatch):
    """The first round has 100 runs, the second three more."""
    rounds, calls, perform = [], [], module.perform_jobs

    def performed(jobs, *args, **options):
        rounds.append(len(jobs))
        return perform(jobs, *args, **options)

    monkeypatch.setattr(module, "perform_jobs", performed)
    short = BASE.model_copy(update={"horizon": 0.1, "record": Recording(trajectory=0.0)})
    plan = SweepPlan.of(short, {"capture.radius": [0.2]}, 103)
    with Store() as store, workers_for(1) as workers:
        plan.register(store)
        target = ("active_time", 1e-9)
        module.carry_out(plan, store, workers, until=target, on_start=lambda: calls.append(len(rounds)))
    assert (rounds, calls) == ([100, 3], [0])


@pytest.mark.whole
@pytest.mark.usefixtures("looks")
def test_the_number_of_runs_is_the_same_with_two_workers_and_after_an_interruption(tmp_path, monkeypatch):
    grid, target = {"team.count": [2, 4]}, {"reps": 30, "until": ("active_time", 0.07)}
    whole = sweep(BASE, grid, **target)
    assert len({len(group.rows) for group in whole.groups}) > 1
    assert sweep(BASE, grid, executor=2, **target) == whole
    drive_batches = module.drive_batches

    def interrupted(tasks, workers, measure):
        """Do five runs, the last first, and leave."""
        tasks = list(tasks)
        last = drive_batches(tasks[::-1][:5], workers, measure)
        yield from ([(len(tasks) - 1 - k, outcome) for k, outcome in batch] for batch in last)
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "drive_batches", interrupted)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            sweep(BASE, grid, store=tmp_path / "s.sqlite", **target)
    monkeypatch.setattr(module, "drive_batches", drive_batches)
    assert sweep(BASE, grid, store=tmp_path / "s.sqlite", **target) == whole


@pytest.mark.slow
def test_runs_beyond_a_gap_are_not_looked_at(tmp_path):
    """Of 50 runs ten are lost: 10 are there in order, so that there should be 100 before the first look."""
    path, grid = tmp_path / "s.sqlite", {"capture.radius": [0.2]}
    short = BASE.model_copy(update={"horizon": 0.1})
    sweep(short, grid, 50, store=path)
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("DELETE FROM runs WHERE replication BETWEEN 10 AND 19")
    with Store(path) as store:
        assert len(module._jobs_until(SweepPlan.of(short, grid, 200), store, "active_time", 1e-6, ())) == 100


@pytest.mark.slow
def test_failed_runs_count_as_runs_but_not_towards_the_mean(looks):
    """A third of the seeds fail: to have 10 values takes more than 13 runs."""
    scenario = BASE.model_copy(update={"protocol": Moody()})
    (group,) = sweep(scenario, {"capture.radius": [0.1]}, 30, until=("active_time", 10.0), seed=1).groups
    values = [None if row.summary is None else row.summary.active_time for row in group.rows]
    assert [row.ok for row in group.rows] == [row.seed % 3 != 0 for row in group.rows]
    assert len(values) == looks(values, 10.0, at_most=30) > 13
    assert len([each for each in values if each is not None]) >= 10


@pytest.mark.parametrize(
    "until", [("aktive_time", 0.1), ("seed", 0.1), ("messages_lost_by", 1.0), ("active_time", 0.0)]
)
def test_a_precision_that_cannot_be_reached_is_refused_before_anything_is_written(tmp_path, until):
    with pytest.raises(ValueError, match=r"there is no numeric metric|should be positive"):
        sweep(BASE, GRID, 40, store=tmp_path / "s.sqlite", until=until)
    assert not (tmp_path / "s.sqlite").exists()


@pytest.mark.parametrize("timeout", [0, -1.0, nan, inf])
def test_a_time_limit_that_no_run_can_have_is_refused_before_anything_is_written(tmp_path, timeout):
    """Each run would fail otherwise."""
    with pytest.raises(ValueError, match=r"a time limit should be > 0 s and at most .* \(got "):
        sweep(BASE, GRID, 1, store=tmp_path / "s.sqlite", timeout=timeout)
    assert not (tmp_path / "s.sqlite").exists()


@pytest.mark.parametrize("wrong", [{"reps": 0}, {"reps": -1}, {"seed": -1}, {"reps": 0, "until": ("active_time", 1.0)}])
def test_no_runs_and_negative_seeds_are_refused(wrong):
    with pytest.raises(ValueError, match="at least"):
        sweep(BASE, GRID, **wrong)


@pytest.mark.slow
def test_numbers_of_runs_and_seeds_may_be_numpys(tmp_path):
    found = sweep(BASE, GRID, np.int64(2), seed=np.int64(4), store=tmp_path / "s.sqlite")
    assert found == sweep(BASE, GRID, 2, seed=4, store=tmp_path / "s.sqlite")
    with pytest.raises(ValueError, match=re.escape("reps should be an integer (got 2.5)")):
        sweep(BASE, GRID, 2.5)


@pytest.mark.slow
def test_options_that_are_not_given_are_those_of_the_scenario():
    scenario = BASE.model_copy(update={"sweep": Sweep(reps=2, grid={"capture.radius": [0.1, 0.2]})})
    assert sweep_of_package(scenario) == sweep(BASE, {"capture.radius": [0.1, 0.2]}, 2)


# Failures.


@pytest.mark.slow
def test_a_run_that_raises_is_a_row_and_ends_nothing():
    found = sweep(BASE, {"protocol": [Moody(), BASE.protocol]}, 4)
    assert [[row.status for row in group.rows] for group in found.groups] == [["ok", "error", "ok", "ok"], ["ok"] * 4]
    (row,) = found.failed
    assert (row.seed, row.error, row.summary) == (5_000_001, "ValueError: not today", None)


@pytest.mark.slow
def test_runs_that_failed_are_tried_again_and_only_those(tmp_path, monkeypatch):
    scenario = BASE.model_copy(update={"protocol": Moody()})
    before = sweep(scenario, {"capture.radius": [0.1]}, 6, store=tmp_path / "s.sqlite")
    done, drive_batches = [], module.drive_batches
    monkeypatch.setattr(
        module,
        "drive_batches",
        lambda tasks, *rest, **options: done.extend(tasks) or drive_batches(tasks, *rest, **options),
    )
    monkeypatch.setattr(Moody, "actions", lambda self, me: iter(lambda: 1, None))
    after = sweep(scenario, {"capture.radius": [0.1]}, 6, store=tmp_path / "s.sqlite")
    assert [seed for _, seed in done] == [5_000_001, 5_000_004]
    assert after.failed == []
    (old,), (new,) = before.groups, after.groups
    assert [row for row in new.rows if row.seed % 3] == [row for row in old.rows if row.ok]


def test_the_first_failure_ends_the_sweep_if_it_should(tmp_path):
    scenario = BASE.model_copy(update={"protocol": Moody()})
    with pytest.raises(
        RunError, match=r"capture\.radius = 0\.1 with seed 5000001 failed: ValueError: not today"
    ) as raised:
        sweep(scenario, {"capture.radius": [0.1]}, 9, store=tmp_path / "s.sqlite", fail_fast=True)
    assert "\n" not in str(raised.value)
    assert raised.value.__notes__[0].startswith("Traceback")


class Terminal(StringIO):
    def isatty(self):
        return True


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    "do", [lambda: sweep(BASE, {"capture.radius": [0.1, 0.2]}, 2), lambda: run_many([(BASE, k) for k in range(4)])]
)
def test_a_terminal_shows_how_many_runs_are_done(monkeypatch, do):
    monkeypatch.setattr(sys, "stderr", shown := Terminal())
    do()
    first, *_, last = shown.getvalue().strip().split("\r")
    assert "| 0/4 [" in first
    assert "| 4/4 [" in last


# What a store may be continued with.


@pytest.mark.slow
def test_a_grid_with_more_values_and_more_runs_continues(tmp_path, monkeypatch):
    """2 x 2 of 3 x 3 x ... runs are there; of 6 configurations x 3 runs the other 18 - 8 are done."""
    store = tmp_path / "s.sqlite"
    sweep(BASE, GRID, 2, store=store)
    done, drive_batches = [], module.drive_batches
    monkeypatch.setattr(
        module,
        "drive_batches",
        lambda tasks, *rest, **options: done.extend(tasks) or drive_batches(tasks, *rest, **options),
    )
    more = {"network.latency.value": [0.0, 0.1, 0.2], "capture.radius": [0.05, 0.2]}
    found = sweep(BASE, more, 3, store=store)
    assert len(done) == 18 - 8
    assert found == sweep(BASE, more, 3)
    done.clear()
    assert sweep(BASE, more, 3, store=store) == found
    assert done == []
    fewer = sweep(BASE, {key: values[:1] for key, values in GRID.items()}, 1, store=store)
    assert [dict(group.settings) for group in fewer.groups] == [{"network.latency.value": 0.0, "capture.radius": 0.05}]


@pytest.mark.slow
def test_the_order_of_a_grid_is_no_part_of_what_a_store_belongs_to(tmp_path, monkeypatch):
    """Neither that of its keys nor that of the values of a key; tables follow the grid that is given."""
    done, drive_batches = [], module.drive_batches
    monkeypatch.setattr(
        module, "drive_batches", lambda tasks, *rest, **more: done.extend(tasks) or drive_batches(tasks, *rest, **more)
    )
    store, (one, other) = tmp_path / "s.sqlite", GRID.items()
    sweep(BASE, GRID, 1, store=store)
    done.clear()
    turned = {other[0]: other[1][::-1], one[0]: [one[1][0], 0.05, one[1][1]]}
    found = sweep(BASE, turned, 1, store=store)
    assert len(done) == 2
    assert found == sweep(BASE, turned, 1)
    assert found.table() == sweep(BASE, turned, 1).table()
    with Store(store, read_only=True) as kept:
        assert {str(group.settings): group for group in SweepResult.of(kept).groups} == {
            str(group.settings): group for group in found.groups
        }
    assert sweep(BASE, GRID, 1, store=store) == sweep(BASE, GRID, 1)
    with Store(store, read_only=True) as kept:
        assert SweepResult.of(kept).keys == tuple(GRID)
        assert len({tuple(group.settings) for group in SweepResult.of(kept).groups}) == 1


@pytest.mark.parametrize("parts", [2, 3])
def test_a_shard_has_the_same_runs_for_every_order_of_the_grid(parts):
    turned = {key: values[::-1] for key, values in reversed(GRID.items())}
    for part in range(1, parts + 1):
        one, other = (
            {(cell.key, k) for cell, k in SweepPlan.of(BASE, grid, 3).shard(part, parts)} for grid in (GRID, turned)
        )
        assert one == other


CHANGED = {
    "field": ({"horizon": 0.6}, {}, {}, r"by another scenario: horizon was 0\.5, is 0\.6$"),
    "two": (
        {"horizon": 0.6, "prune": "none"},
        {},
        {},
        r"by another scenario: horizon was 0\.5, is 0\.6; prune was inf, is none$",
    ),
    "inside": ({"network": Links(range=3.0)}, {}, {}, r"network\.range was Infinity, is 3\.0$"),
    "seed": ({"seed": 6}, {}, {}, r"by another sweep: root seed was 5, is 6$"),
    "seed given": ({}, {}, {"seed": 6}, r"by another sweep: root seed was 5, is 6$"),
    "keys": ({}, {"horizon": [0.5]}, {}, r"by another "),
    "mode": ({"sweep": Sweep(seeds="independent")}, {}, {}, r'by another sweep: seeds was "common", is "independent"$'),
}


@pytest.mark.slow
@pytest.mark.parametrize(("change", "grid", "options", "why"), CHANGED.values(), ids=CHANGED)
def test_a_store_of_another_sweep_is_refused_with_the_differences(tmp_path, change, grid, options, why):
    store = tmp_path / "s.sqlite"
    sweep(BASE, GRID, 1, store=store)
    with pytest.raises(
        StoreError, match=why.replace("$", r"; remove it, or choose another folder \(-o, in Python store=\)$")
    ):
        sweep(BASE.model_copy(update=change), GRID | grid, 1, store=store, **options)
    with closing(sqlite3.connect(store)) as database:
        assert database.execute("SELECT count(*) FROM runs").fetchone() == (4,)


class Tuned(Value):
    """A protocol with a table that may be missing or empty."""

    announces: ClassVar[bool] = False
    table: dict[str, float] | None = None

    def __call__(self, me):
        return iter(())


@pytest.mark.parametrize(
    ("one", "other", "why"),
    [
        (None, {}, r"protocol\.table was None, is \{\}"),
        ({}, {"a": 1.0}, r"protocol\.table was \{\}, is not there; protocol\.table\.a was not there, is 1\.0"),
    ],
)
def test_a_table_that_is_empty_in_one_scenario_is_a_difference(tmp_path, one, other, why):
    first, second = (BASE.model_copy(update={"protocol": Tuned(table=each)}) for each in (one, other))
    sweep(first, {"team.count": [2]}, 1, store=tmp_path / "s.sqlite")
    with pytest.raises(StoreError, match=f"by another scenario: {why}; remove it"):
        sweep(second, {"team.count": [2]}, 1, store=tmp_path / "s.sqlite")


@pytest.mark.slow
def test_values_of_swept_keys_in_the_scenario_do_not_matter(tmp_path):
    """They are replaced by those of the grid."""
    store = tmp_path / "s.sqlite"
    first = sweep(BASE, GRID, 1, store=store)
    other = BASE.model_copy(update={"network": Links(latency=Constant(value=9.0))})
    assert sweep(other, GRID, 1, store=store) == first


def test_a_store_is_not_continued_with_other_code_of_a_rule(tmp_path, monkeypatch):
    """Or a table would have runs of both, and nothing would tell them apart."""
    monkeypatch.syspath_prepend(tmp_path)
    module_file = tmp_path / "mine_of_sweep.py"
    file = tmp_path / "f.toml"
    file.write_text(
        'horizon = 0.1\nteam.count = 2\n[sweep.grid]\nprotocol = [{ kind = "mine_of_sweep:mine" }, { kind = "sap" }]\n'
    )

    def swept(number):
        module_file.write_text(f"def mine(me):\n    return iter(({number},)[1:])\n")
        sys.modules.pop("mine_of_sweep", None)
        importlib.invalidate_caches()
        return sweep(read_source(file, allow_import=True), reps=1, store=tmp_path / "s.sqlite")

    assert swept(1) == swept(1)
    with pytest.raises(StoreError, match=r"by another version: the code of mine_of_sweep was"):
        swept(22)


DELAYS = """
import json
from functools import cached_property
from pathlib import Path
from typing import ClassVar
import numpy as np
from desim import open_data
from desim.config.model import Value
from {helper} import FACTOR
TABLE = np.loadtxt(open_data(Path(__file__).with_name("opened.txt")))

class Measured(Value):
    kind: str = "measured"
    file: str = "declared.txt"
    lazy: str = ""
    @cached_property
    def table(self):
        return FACTOR * np.loadtxt(Path(__file__).with_name(self.file))
    def depends_on(self):
        return (Path(__file__).with_name(self.file),)
    def __call__(self, context, rng):
        if self.lazy:
            open_data(self.lazy)
        return rng.choice([*TABLE, *self.table], len(context.dst))
"""


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """Return a function that sweeps over a model that reads two files, with a store, after it has written some."""
    monkeypatch.syspath_prepend(tmp_path)
    texts = {"opened.txt": "0.0 0.1", "declared.txt": "0.2 0.3", "delay_factor.py": "FACTOR = 1.0"}
    texts["delay_of_sweep.py"] = DELAYS.format(helper="delay_factor")

    def swept(grid=None, *, lazy="", changed=None):
        for name, text in (texts if changed is None else changed).items():
            (tmp_path / name).write_text(text)
        for name in ("delay_of_sweep", "delay_factor"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        file = tmp_path / "f.toml"
        file.write_text(
            "horizon = 1.0\nteam.count = 4\n"
            f'network.latency = {{ kind = "delay_of_sweep:Measured", lazy = "{lazy}" }}\n'
        )
        grid = grid or {"network.range": [9.0]}
        return sweep(read_source(file, allow_import=True), grid, reps=1, store=tmp_path / "s.sqlite")

    yield swept
    for name in ("delay_of_sweep", "delay_factor"):
        sys.modules.pop(name, None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("declared.txt", "0.7 0.9", r"the content of .*declared\.txt was"),
        ("opened.txt", "0.7 0.9", r"the content of .*opened\.txt was"),
        ("delay_factor.py", "FACTOR = 3.0", r"the code of delay_factor was"),
    ],
)
def test_a_store_is_not_continued_with_another_data_file_or_imported_module(measured, name, text, why):
    before = measured()
    assert measured() == before
    with pytest.raises(StoreError, match=f"by another version: {why}"):
        measured(changed={name: text})


@pytest.mark.slow
def test_of_swept_data_files_only_the_runs_of_a_new_one_are_done(measured, monkeypatch):
    done, drive_batches = [], module.drive_batches
    monkeypatch.setattr(
        module, "drive_batches", lambda tasks, *rest, **more: done.extend(tasks) or drive_batches(tasks, *rest, **more)
    )
    grid = {"network.latency.file": ["declared.txt", "opened.txt"]}
    measured(grid)
    measured({"network.latency.file": ["declared.txt", "third.txt", "opened.txt"]}, changed={"third.txt": "0.5 0.6"})
    assert [scenario.network.latency.file for scenario, _ in done] == ["declared.txt", "opened.txt", "third.txt"]


def test_a_run_that_opens_a_data_file_fails_for_it_was_identified_before(measured, tmp_path):
    """But a file that the module opened as it was imported may be opened by the workers as they import it."""
    (group,) = measured(lazy=tmp_path / "opened.txt").groups
    assert re.search(r"opened\.txt: is opened during a run", group.rows[0].error)


@pytest.mark.parametrize("edit", ["1.0", "0.3"])
def test_a_store_is_not_continued_with_another_file_of_a_built_in_model(tmp_path, edit):
    (tmp_path / "f.toml").write_text(
        'horizon = 0.1\nteam.count = 2\nnetwork.latency = { kind = "empirical", file = "delays.txt" }\n'
    )
    (tmp_path / "delays.txt").write_text("0.3 0.3")
    options = {"grid": {"network.range": [9.0]}, "reps": 1, "store": tmp_path / "s.sqlite"}
    sweep(read_source(tmp_path / "f.toml"), **options)
    (tmp_path / "delays.txt").write_text(f"0.3 {edit}")
    refused = pytest.raises(StoreError, match=r"network\.latency\.values\.1 was 0\.3, is 1\.0")
    with nullcontext() if edit == "0.3" else refused:
        sweep(read_source(tmp_path / "f.toml"), **options)


EDITED = r"network\.latency\.table was a text with the hash [0-9a-f]{16}, is a text with the hash [0-9a-f]{16};"


@pytest.mark.slow
def test_a_store_is_not_continued_with_an_edited_table_of_measurements(tmp_path):
    (tmp_path / "f.toml").write_text(
        'horizon = 0.1\nteam.count = 2\nnetwork.latency = { kind = "trace", file = "rtt.csv" }\n'
    )
    options = {"grid": {"network.range": [9.0]}, "reps": 1, "store": tmp_path / "s.sqlite"}
    for second, refused in (("0.3", nullcontext()), ("0.4", pytest.raises(StoreError, match=EDITED))):
        (tmp_path / "rtt.csv").write_text(f"t,value\n0,0.001\n1,{second}\n")
        with refused:
            sweep(read_source(tmp_path / "f.toml"), **options)


@pytest.mark.slow
def test_more_user_protocols_may_be_added(tmp_path):
    store = tmp_path / "s.sqlite"
    sweep(BASE, {"protocol": [Moody()]}, 2, store=store)
    found = sweep(BASE, {"protocol": [Moody(), chases]}, 2, store=store)
    assert [group.settings["protocol"] for group in found.groups] == ["moody", "chases"]


@pytest.mark.slow
def test_more_lambdas_may_be_added(tmp_path):
    """They have one name, and each its own code."""
    one, other = lambda me: iter(()), lambda me: iter((1,)[1:])
    one.__name__, other.__name__ = "one", "other"
    sweep(BASE, {"protocol": [one]}, 1, store=tmp_path / "s.sqlite")
    found = sweep(BASE, {"protocol": [one, other]}, 1, store=tmp_path / "s.sqlite")
    assert [group.settings["protocol"] for group in found.groups] == ["one", "other"]


def chases(me):
    me.assign(True)
    yield from ()


def test_errors_in_a_grid_are_reported_before_a_store_is_created(tmp_path):
    with pytest.raises(ScenarioError, match=r"^the grid: sweep\.grid: horizn: unknown key"):
        sweep(BASE, {"horizn": [1.0]}, store=tmp_path / "s.sqlite")
    assert not (tmp_path / "s.sqlite").exists()


def test_a_store_has_the_scenario_of_each_configuration(tmp_path):
    sweep(BASE, {"network.range": [3.0, inf]}, 1, store=tmp_path / "s.sqlite")
    with Store(tmp_path / "s.sqlite") as store:
        texts = [text for (text,) in store.database.execute("SELECT scenario FROM configurations ORDER BY place")]
    assert [Scenario.model_validate_json(each).network.range for each in texts] == [3.0, inf]


# Parts.


@pytest.mark.slow_but_one
@pytest.mark.parametrize("parts", [1, 3, 5, 20])
def test_the_parts_of_a_plan_are_all_of_it_and_share_nothing(parts):
    plan = SweepPlan.of(BASE, GRID, 4)
    jobs = [[(cell.key, k) for cell, k in plan.shard(part, parts)] for part in range(1, parts + 1)]
    assert sorted(each for part in jobs for each in part) == sorted(
        (cell.key, k) for cell in plan.configurations for k in range(4)
    )
    assert max(map(len, jobs)) - min(map(len, jobs)) <= 1


def test_a_part_has_every_nth_run_so_that_each_has_some_of_every_configuration():
    plan = SweepPlan.of(BASE, GRID, 3)
    for part in (1, 2, 3):
        found = {(cell.key, k) for cell, k in plan.shard(part, 3)}
        assert found == {(cell.key, part - 1) for cell in plan.configurations}


@pytest.mark.parametrize("part", [0, 4])
def test_a_part_that_there_is_not_is_refused(part):
    with pytest.raises(ValueError, match="1/3 to 3/3"):
        SweepPlan.of(BASE, GRID, 4).shard(part, 3)


def test_parts_and_a_precision_exclude_each_other(tmp_path):
    plan = SweepPlan.of(BASE, GRID, 4)
    with Store() as store, pytest.raises(ValueError, match="exclude each other"):
        module.carry_out(plan, store, None, until=("active_time", 1.0), shard=(1, 3))


# What pursuers know at the start.


@pytest.mark.slow
@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("key", ["network.latency.value", "network.loss.p", "team.count", "announce.start"])
def test_a_sweep_over_properties_of_the_network_names_the_start(key, start):
    """In the table, on the page of a notebook and as JSON; not if it is varied itself, or nothing of the network is."""
    values = {"team.count": [2, 3], "announce.start": [*STARTS]}.get(key, [0.0, 0.2])
    found = sweep(BASE.with_({"announce.start": start}), {key: values}, 2)
    sentence = f'announce.start = "{start}": '
    assert (sentence in found.table()) is (sentence in html.unescape(found._repr_html_())) is key.startswith("network.")
    assert found.document()["start"] == (None if key == "announce.start" else start)
    assert (found.start_rule is not None) is key.startswith("network.")


@pytest.mark.parametrize("until", [("aktive_time", 0.1), ("active_time", 0.0)])
def test_no_run_of_a_plan_is_begun_for_a_precision_that_cannot_be_reached(until):
    began = []
    with Store() as store, workers_for(1) as workers, pytest.raises(ValueError, match=r"no numeric metric|be positive"):
        module.carry_out(SweepPlan.of(BASE, GRID, 1), store, workers, until=until, on_start=lambda: began.append(1))
    assert began == []

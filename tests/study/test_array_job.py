"""`desim submit` and `desim status`: the scripts of an array job, and how far it is, without and with a real Slurm."""

import json
import os
import shutil
import signal
import subprocess
from dataclasses import asdict

import pytest

from desim import Scenario, run, status, summary
from desim.cli import main
from desim.study.store.run_table import Row
from desim.study.store.store import Store
from desim.study.sweeps import array_job
from desim.study.sweeps.array_job import ArrayJob, _ranges
from desim.study.sweeps.planned import PlannedRuns, entries
from desim.study.sweeps.status import SweepStatus
from desim.study.sweeps.sweep_plan import SweepPlan
from tests.command import accepted, refused
from tests.study import slurm
from tests.study.sweeps import count, rows

GRID = ("--grid", "network.latency.value=0.0,0.1")
WORDS = ("relay.toml", "-n", 3, "--set", "horizon=0.2", *GRID)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a working folder with an example, on whose path there are no commands of Slurm."""
    monkeypatch.chdir(tmp_path)
    accepted("examples", "relay")
    (tmp_path / "bin").mkdir()
    for name in ("bash", "kill"):
        (tmp_path / "bin" / name).symlink_to(shutil.which(name) or "/bin/true")
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    return tmp_path


def stub(place, name, text):
    """Write a command of Slurm that does something else."""
    file = place / "bin" / name
    file.write_text(f"#!/bin/bash\n{text}\n")
    file.chmod(0o755)


@pytest.mark.parametrize(
    ("numbers", "text"), [([1], "1"), ([1, 2, 3], "1-3"), ([1, 3], "1,3"), ([2, 3, 7, 9, 10], "2-3,7,9-10")]
)
def test_parts_are_written_as_slurm_writes_them(numbers, text):
    assert _ranges(numbers) == text


def test_the_parts_have_all_runs_together():
    job = ArrayJob(name="a", runs=10, parts=3)
    assert [job.planned(part) for part in (1, 2, 3)] == [4, 3, 3]


def test_scripts_are_written_and_say_what_submits_them(place):
    told = accepted(
        "submit", *WORDS, "--array", 3, "--time", "00:10:00", "--cpus", 2, "--sbatch=--partition=short"
    ).output
    assert "wrote the scripts of 3 parts of 3" in told
    out = place / "out" / "relay"
    script = (out / "parts.sbatch").read_text()
    for line in ("--array=1-3", "--time=00:10:00", "--cpus-per-task=2", "--requeue", "--signal=B:USR1@60"):
        assert f"#SBATCH {line}\n" in script
    assert "#SBATCH --partition=short\n" in script
    assert "--dependency=afterany:" in told
    assert subprocess.run(["bash", "-n", out / "parts.sbatch"], check=False).returncode == 0
    document = json.loads(accepted("status", out, "--json").output)
    assert (document["planned"], document["done"]) == (6, 0)
    assert [part["state"] for part in document["parts"]] == ["not begun"] * 3


def test_a_folder_with_blanks_and_percent_signs_is_one_word_of_a_script_and_no_pattern(place):
    accepted("submit", *WORDS, "--array", 3, "-o", "a b 5%/c")
    script = (place / "a b 5%/c/parts.sbatch").read_text()
    assert f"#SBATCH '--output={place}/a b 5%%/c/logs/%A-%a.log'\n" in script
    assert f"-o '{place}/a b 5%/c'/" in script


def test_bad_input_of_submit_and_status_is_refused(place):
    assert "there are only 6 runs: give a part at least one" in refused("submit", *WORDS, "--array", 7)
    assert "sbatch: there is no Slurm on this machine" in refused("submit", *WORDS, "--array", 2, "--run")
    assert "was submitted with --array 2, whose parts have other runs" in refused("submit", *WORDS, "--array", 3)
    assert "has no sweep: neither sweep.sqlite nor parts of one" in refused("status", place)
    assert "relay.toml: is no folder" in refused("status", "relay.toml")
    record = place / "out" / "relay" / "submit.json"
    record.write_text('{"name": "a", "runs": "many", "parts": 2}')
    assert "submit.json: is damaged: runs cannot be read; remove the file" in refused("status", record.parent)
    for key, fields in {"runs": '"runs": "6", "parts": 2', "parts": '"runs": 6, "parts": 2.0'}.items():
        record.write_text(f'{{"name": "a", {fields}}}')
        assert f"submit.json: is damaged: {key} cannot be read" in refused("status", record.parent)


@pytest.mark.parametrize("content", [b"", b"no store"])
def test_the_status_of_a_store_that_cannot_be_read_names_no_sweep(tmp_path, content):
    (tmp_path / "sweep.sqlite").write_bytes(content)  # empty as on a full disk
    head, _, part = str(status(tmp_path)).splitlines()
    assert head == "0 runs are done"
    assert str(tmp_path / "sweep.sqlite") in part


def run_part(place, part, **options):
    """Start the script of a part as Slurm would."""
    variables = {"SLURM_ARRAY_TASK_ID": str(part), "SLURM_CPUS_PER_TASK": "1", "SLURM_ARRAY_JOB_ID": "7", **options}
    script = place / "out" / "relay" / "parts.sbatch"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(["bash", script], env=os.environ | variables, start_new_session=True, **pipes)


@pytest.mark.slow
def test_a_folder_with_parts_of_another_sweep_is_refused_before_they_wait_in_a_queue(place):
    accepted("submit", *WORDS, "--array", 3)
    accepted("sweep", *WORDS, "--shard", "1/3", "-o", "out/relay/part-1")
    other = refused("submit", *WORDS, "--set", "name=other", "-o", "out/relay", "--array", 3)
    assert "sweep.1-of-3.sqlite: was made by another sweep" in other


@pytest.mark.slow
def test_only_the_parts_that_are_not_done_are_submitted_again(place):
    """Part 2 runs in Slurm at first, says a stub of squeue."""
    accepted("submit", *WORDS, "--array", 3)
    out = place / "out" / "relay"
    part = run_part(place, 1)
    part.communicate(timeout=300)
    assert part.returncode == 0
    stub(place, "sbatch", 'echo "$@" >> submitted; echo 8')
    stub(place, "squeue", "echo '2 RUNNING'")
    ArrayJob(name="relay", runs=6, parts=3, jobs=("7",)).write(out)
    assert "submitted 1 part of 3 as job 8" in accepted("submit", *WORDS, "--array", 3, "--run").output
    assert "#SBATCH --array=3\n" in (out / "parts.sbatch").read_text()
    submitted = (place / "submitted").read_text().splitlines()
    assert submitted == [f"--parsable {out}/parts.sbatch", f"--parsable --dependency=afterany:8 {out}/merge.sbatch"]
    told = accepted("status", out).output
    assert told.startswith("relay: 2 of 6 runs are done, 1 part running\n")
    stub(place, "squeue", "exit 1")
    for part in (2, 3):
        accepted("sweep", *WORDS, "--shard", f"{part}/3", "-o", out / f"part-{part}")
    assert "all parts are done; to merge them: desim merge" in accepted("submit", *WORDS, "--array", 3).output
    assert "6 of 6 runs are done" in accepted("status", out).output


@pytest.mark.slow
@pytest.mark.parametrize(("number", "restarts"), [(signal.SIGUSR1, 0), (signal.SIGUSR1, 20), (signal.SIGTERM, 0)])
def test_a_part_whose_time_is_up_keeps_its_runs_and_asks_to_be_run_again(place, number, restarts):
    """SIGTERM is what `scancel` sends: then it is not run again, nor after twenty times."""
    long = ("relay.toml", "-n", 1000, "--set", "horizon=0.2", *GRID)
    accepted("submit", *long, "--array", 2)
    stub(place, "scontrol", 'echo "$@" > requeued')
    part = run_part(place, 1, SLURM_RESTART_COUNT=str(restarts))
    store = place / "out" / "relay" / "part-1" / "sweep.1-of-2.sqlite"
    slurm.wait_for(lambda: count(store) > 0, place, 300.0)
    part.send_signal(number)
    _, told = part.communicate(timeout=300)
    requeued = place / "requeued"
    assert "the same command resumes" in told
    assert 0 < count(store) < 1000
    if number == signal.SIGUSR1 and not restarts:
        assert (part.returncode, requeued.read_text()) == (0, "requeue 7_1\n")
    else:
        assert part.returncode == (1 if restarts else 143)
        assert not requeued.exists()


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.skipif(slurm.WHY_NOT != "", reason=f"NO SLURM: {slurm.WHY_NOT}")
@pytest.mark.timeout(900)
def test_a_sweep_that_slurm_performs_in_parts_is_the_serial_sweep(tmp_path, monkeypatch):
    """A part is told that its time is up, and requeued; the store of another is lost; then all is done with claims."""
    monkeypatch.chdir(tmp_path)
    accepted("examples", "relay")
    words = ("relay.toml", "-n", 12, "--set", "horizon=1.0", *GRID, "--memory", "100M")
    (tmp_path / "slurm").mkdir()
    with slurm.slurm(tmp_path / "slurm") as found:
        for name, value in found.items():
            monkeypatch.setenv(name, value)
        assert "submitted 2 parts of 2" in accepted("submit", *words, "--array", 2, "--run").output
        out = tmp_path / "out" / "relay"
        slurm.wait_for(lambda: count(out / "part-1" / "sweep.1-of-2.sqlite") > 0, tmp_path / "slurm", 300.0)
        job = ArrayJob.read(out).jobs[0]
        array_job.slurm("scancel", "--batch", "--signal=USR1", f"{job}_1")
        slurm.wait_for(lambda: array_job.states([job]).get(1) == "PENDING", tmp_path / "slurm", 300.0)
        # Slurm waits two minutes, because a node refuses a job in the second in which it ended it.
        array_job.slurm("scontrol", "update", f"JobId={job}_1", "StartTime=now+3")
        merged = out / "sweep.sqlite"
        slurm.wait_for(lambda: count(merged) == 24, tmp_path / "slurm", 600.0)
        assert "24 of 24 runs are done" in accepted("status", out).output
        shutil.rmtree(out / "part-2")
        assert "submitted 1 part of 2" in accepted("submit", *words, "--array", 2, "--run").output
        slurm.wait_for(lambda: "24 of 24" in accepted("status", out).output, tmp_path / "slurm", 600.0)
        accepted("submit", *words, "--array", 3, "--claim", "--run", "-o", "out/claimed")
        slurm.wait_for(lambda: count(tmp_path / "out/claimed/sweep.sqlite") == 24, tmp_path / "slurm", 600.0)
    accepted("sweep", *words[:-2], "-o", "serial")
    assert rows(tmp_path / "serial" / "sweep.sqlite") == rows(merged) == rows(tmp_path / "out/claimed/sweep.sqlite")


def test_a_slurm_that_does_not_answer_is_told(monkeypatch):
    def run(words, **options):
        assert options == {"capture_output": True, "text": True, "timeout": array_job.SLURM_TIMEOUT, "check": False}
        raise subprocess.TimeoutExpired(words, 1.0)

    monkeypatch.setattr(array_job.subprocess, "run", run)
    with pytest.raises(
        array_job.SlurmError, match=rf"^squeue: Slurm does not answer within {array_job.SLURM_TIMEOUT:g} s$"
    ):
        array_job.slurm("squeue")


@pytest.mark.parametrize(("planned", "done", "ended"), [(None, 3, False), (4, 3, False), (3, 3, True), (3, 4, True)])
def test_a_sweep_has_ended_with_all_its_planned_runs(planned, done, ended):
    assert SweepStatus("name", planned, done, 0, ()).is_complete is ended


def test_the_command_and_the_scripts_ask_for_the_same_resources_by_default():
    defaults = {option.name: option.default for option in main.commands["submit"].params}
    asked = asdict(array_job.Resources())
    assert {name: defaults[name] for name in ("time", "cpus", "memory")} == {
        name: value for name, value in asked.items() if name != "options"
    }


# Runs in several stores.


def stored(folder, *parts):
    """Write a store for each part of a sweep, given the state of its runs by replication; return the sweep."""
    plan = SweepPlan.of(Scenario(horizon=0.1, team={"count": 2}), {"team.count": [2]}, 3)
    numbers = summary(run(plan.configurations[0].scenario, 0))
    for number, states in enumerate(parts, start=1):
        with Store(folder / f"sweep.{number}-of-{len(parts)}.sqlite") as store:
            plan.register(store)
            for k, state in states.items():
                store.add(plan.configurations[0].key, 0, Row(k, k, state, numbers if state == "ok" else None))
    return plan


@pytest.mark.slow
def test_a_run_that_failed_in_one_store_and_ended_in_another_is_done(tmp_path):
    stored(tmp_path, {0: "error", 1: "ok", 2: "error"}, {0: "ok", 1: "ok"})
    counted = status(tmp_path)
    assert (counted.done, counted.failed, counted.planned) == (2, 1, None)
    assert [(part.done, part.failed) for part in counted.parts] == [(1, 2), (2, 0)]


@pytest.mark.slow
def test_a_plan_of_fewer_runs_than_are_done_is_that_of_another_sweep(tmp_path, monkeypatch):
    stored(tmp_path, {0: "ok", 1: "ok"})
    for number, known in ((1, None), (2, 2), (3, 3)):
        monkeypatch.setattr("desim.study.sweeps.status._planned", lambda _, number=number: PlannedRuns(number))
        assert status(tmp_path).planned == known


def test_a_sweep_planned_the_runs_below_its_number_of_the_configurations_it_had():
    document = {"what": "sweep", "runs": 4} | entries(["a", "b"], 2, None)
    includes = PlannedRuns.of(document).includes([["c", "a"], ["b", "a", "c"]])
    assert [includes((key, k)) for key in "abc" for k in (1, 2)] == [True, False, True, False, False, False]
    assert PlannedRuns.of(document).includes([["a", "c"]]) is None

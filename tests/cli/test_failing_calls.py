"""What a command says, and its exit code, where a call to the packages below it fails, are golden."""

import shlex
import subprocess
import sys
from dataclasses import replace
from errno import EACCES, ENOSPC
from os import strerror
from pathlib import Path

import pytest

import desim
from desim.config.errors import Problem
from desim.config.packages import HiddenPackageError
from desim.kernel.measured.playback import TraceEndError
from desim.live.lobby import LiveError
from desim.live.namespaces import NamespaceError
from desim.live.refusals import NotLiveError
from desim.results.run_folder import WriteError, write
from desim.scenario.overrides import ScenarioError
from desim.simulation.watchdog import TimedOut
from desim.study.ablation.explain import Variants
from desim.study.sweeps.metric_values import NoMeanError
from desim.study.sweeps.sweep import RunError
from tests.command import desim as command
from tests.golden import golden


def denied(file):
    return PermissionError(EACCES, strerror(EACCES), file)


FULL = OSError(ENOSPC, strerror(ENOSPC))
GRID = "plain.toml -g team.count=2,3 -n 1 -o made"
CALLS = [
    ("compare swept swept", "study.sweeps.folder.compare", denied("swept/sweep.sqlite")),
    ("compare swept swept", "study.sweeps.folder.compare", TypeError("swept: is no sweep")),
    ("crossover swept team.count --over 10%", "study.sweeps.folder.open", denied("swept/sweep.sqlite")),
    ("crossover swept team.count --over 10%", "study.sweeps.folder.open", OSError("no such device")),
    ("export swept x.csv", "study.results.result.SweepResult.write", ImportError("needs pandas")),
    ("export swept x.csv", "study.results.result.SweepResult.write", denied("x.csv")),
    ("export one x.csv", "view.formats.export.export", denied("one/trace.jsonl")),
    ("export one x.csv", "view.formats.export.export", denied("x.csv")),
    ("export one x.csv", "view.formats.export.export", FULL),
    ("export one x.csv", "view.formats.export.export", ImportError("needs mcap")),
    ("plot one -o x.svg", "view.pictures.run_figure.plot", FULL),
    ("replay one -o x.html", "cli.output.write_whole", FULL),
    ("report swept -o x.html", "cli.output.write_whole", denied("x.html")),
    ("live plain.toml -o made", "live.live_runs.runs", LiveError("pursuer 1 was lost")),
    ("live plain.toml -o made", "live.live_runs.runs", NotLiveError("walls cannot be in a live run")),
    ("live plain.toml -o made", "live.live_runs.runs", NamespaceError("ip: permission denied")),
    ("live plain.toml -o made", "live.live_runs.runs", ValueError("no such host")),
    ("run plain.toml", "simulation.run.run", TimedOut("is not over after 2 s")),
    ("run plain.toml -o made", "results.run_folder.write", WriteError(EACCES, strerror(EACCES), "made/run.json")),
    ("run plain.toml -o made", "results.run_folder.write", WriteError(ENOSPC, strerror(ENOSPC))),
    ("run plain.toml", "simulation.run.run", HiddenPackageError("another package protocols is in the way")),
    ("run plain.toml", "simulation.run.run", TraceEndError("the trace of losses ends at 2 s")),
    ("run plain.toml", "simulation.run.run", MemoryError()),
    ("run --from one/run.json -o made", "results.provenance.read", denied("one/run.json")),
    (f"sweep {GRID}", "study.sweeps.sweep.carry_out", RunError("2 of 2 runs failed")),
    (f"sweep {GRID} --cluster nowhere", "study.workers.executors.workers_for", ValueError("address")),
    (f"sweep {GRID} --cluster tcp://h:1", "study.workers.executors.workers_for", ConnectionError("tcp://h:1: silent")),
    (
        "explain plain.toml -n 2 -o explained",
        "study.ablation.explain.Variants.carry_out",
        NoMeanError("captured has no mean"),
    ),
    (f"submit {GRID} --array 2", "study.sweeps.array_job.ArrayJob.read", ValueError("made/job.json: no such key")),
    (f"submit {GRID} --array 2", "study.sweeps.array_job.ArrayJob.write", FULL),
    (
        f"submit {GRID} --array 2",
        "study.sweeps.sweep_plan.SweepPlan.of",
        ScenarioError(Problem("is too large", "team.count")),
    ),
    ("status swept", "study.sweeps.status.status", ValueError("swept/job.json: no such key")),
    ("merge swept -o made", "study.store.store.Store.merge", FULL),
    ("merge swept -o made", "study.store.store.Store.merge", denied("made/sweep.sqlite")),
    ("merge swept -o made", "study.store.store.Store.merge", denied("elsewhere/sweep.sqlite")),
    ("fates log.csv plain.toml -o x.csv", "cli.output.write_whole", FULL),
]
"""The words of a command, the function that fails, and what it raises."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("failing")
    (made / "plain.toml").write_text(
        "horizon = 0.01\nteam.count = 2\nannounce.heartbeat = 0.01\nrecord.trajectory = 0\n"
    )
    (made / "log.csv").write_text("t,src,dst,size\n0.0,0,1,100\n")
    (made / "swept").mkdir()
    short = desim.Scenario(name="short", horizon=0.01, team={"count": 2})
    desim.sweep(short, {"team.count": [2, 3]}, 1, store=made / "swept" / "sweep.sqlite")
    write(desim.run(short, 1), made / "one", drawn=False)
    return made


@pytest.mark.slow
def test_what_a_command_says_where_a_call_fails_is_golden(folder, monkeypatch):
    monkeypatch.chdir(folder)
    parts = {}
    for words, place, error in CALLS:

        def fail(*_args, _error=error, **_named):
            raise _error

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(f"desim.{place}", fail)
            result = command(*shlex.split(words))
        assert result.stdout == ""
        told = result.stderr.replace(str(folder), "FOLDER").strip()
        raised = f"{error!r} of {error.filename}" if getattr(error, "filename", None) else repr(error)
        parts[f"desim {words}, where {place} raises {raised}"] = f"{told}\nexit {result.exit_code}"
    golden("failing_calls.txt", parts)


@pytest.mark.slow
def test_an_error_of_the_program_itself_is_not_told_as_a_mistake(folder, monkeypatch):
    def fail(*_args, **_named):
        raise ValueError("none of ours")

    monkeypatch.setattr("desim.simulation.run.run", fail)
    with pytest.raises(ValueError, match="none of ours"):
        command("run", folder / "plain.toml")


@pytest.mark.slow
def test_seeds_whose_runs_failed_are_told_with_the_way_to_retry_them(folder, monkeypatch):
    monkeypatch.chdir(folder)
    explained = Variants.carry_out

    def carry_out(*args, **named):
        return replace(explained(*args, **named), failed=2)

    monkeypatch.setattr(Variants, "carry_out", carry_out)
    result = command("explain", "plain.toml", "-n", "2", "-o", "explained again", "--json")
    assert result.stderr.endswith("for 2 seeds a run failed; the same command retries them\n")
    assert result.exit_code == 3


@pytest.mark.slow
def test_an_array_job_of_which_no_part_is_left_to_submit_says_why(folder, monkeypatch):
    """Its parts wait or run, or all are done."""
    monkeypatch.chdir(folder)
    words = shlex.split("submit plain.toml -g team.count=2,3 -n 1 -o job --array 2")
    assert command(*words).exit_code == 0
    monkeypatch.setattr("desim.study.sweeps.array_job.states", lambda _: {1: "RUNNING", 2: "PENDING"})
    waiting = command(*words)
    assert waiting.stdout == (
        f"all parts that are not done wait or run; `desim status {folder / 'job'}` says how far they are\n"
    )
    assert waiting.exit_code == 0


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
def test_where_messages_cannot_be_written_results_and_the_exit_code_remain():
    program = "from desim.cli.output import echo; echo('a', err=True); echo('b', err=True); echo('result')"
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run([sys.executable, "-c", program], stderr=full, stdout=subprocess.PIPE, check=False)
    assert (ended.returncode, ended.stdout) == (0, b"result\n")

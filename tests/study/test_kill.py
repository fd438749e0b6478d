"""Drivers that are killed or interrupted: no process is left, and what was done is not lost."""

import os
import random
import re
import signal
import time

import pytest

from desim.config.interrupts import Terminated, raising
from tests.study import sweeps
from tests.study.test_workers import command

pytestmark = [
    pytest.mark.timeout(300),  # a cluster takes its time to replace a worker
    pytest.mark.usefixtures("_undrawn", "default_signals"),
]


def finish(file, out, *options):
    """Resume a sweep until its end; return its output, its exported table, and the rows of its store."""
    made = command("sweep", file, "--allow-import", "-o", out, *options)
    assert made.exit_code == 0, made.output
    assert command("export", out, out / "runs.csv").exit_code == 0
    return made.stdout, (out / "runs.csv").read_bytes(), sweeps.rows(out / "sweep.sqlite")


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """Return the file of a sweep of 50 runs that pause for 50 ms, and what comes of it."""
    folder = tmp_path_factory.mktemp("unbroken")
    file = sweeps.write(folder, pause=0.05, reps=25)
    return file, finish(file, folder / "out", "-j", 1)


def wait_for(condition, within=60.0):
    """Wait until something is true, s."""
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.02)  # a look at all processes is work


@pytest.mark.slow
@pytest.mark.parametrize("lives", ["1", pytest.param("01", marks=pytest.mark.whole)])
def test_a_sweep_whose_driver_is_killed_ends_with_the_table_of_an_unbroken_one(tmp_path, unbroken, lives):
    """In its life 0 it is killed while workers start, in life 1 when they have just ended a run, at seeded moments.

    50 runs that pause for 50 ms take 1.25 s with two workers; a life has 0.2 s from its first run on.
    """
    (file, whole), moments = unbroken, random.Random(1)
    out, counts = tmp_path / "out", [0]
    store = out / "sweep.sqlite"
    for life in map(int, lives):
        mark = f"{tmp_path}/{life}"
        driver = sweeps.start("sweep", file, "--allow-import", "-o", out, "-j", 2, mark=mark)
        if life == 0:
            wait_for(store.exists)
        else:
            wait_for(lambda: sweeps.count(store) > counts[-1])
        time.sleep(moments.uniform(0.0, 0.2))
        os.kill(driver.pid, signal.SIGKILL)
        driver.communicate()
        assert sweeps.survivors(mark) == {}
        counts.append(sweeps.count(store))
    assert counts == sorted(counts)
    assert 0 < counts[-1] < 50, "it was killed too late to be of any use"
    assert finish(file, out, "-j", 1) == whole


def interrupted(process, mark, number=signal.SIGINT, send=os.killpg):
    """Send what a terminal sends at Ctrl-C, or another signal, to all processes of a driver; return what they print."""
    send(process.pid, number)
    stdout, stderr = process.communicate(timeout=60)
    assert sweeps.survivors(mark) == {}
    assert process.returncode == 128 + number, stderr
    assert stdout == ""
    return stderr


@pytest.mark.whole
@pytest.mark.parametrize(
    ("jobs", "number", "send", "how"),
    [
        (2, signal.SIGINT, os.killpg, ""),
        (1, signal.SIGHUP, os.killpg, " by SIGHUP"),
    ],
)
def test_an_interrupted_sweep_reports_it_in_one_line_and_keeps_its_runs(tmp_path, unbroken, jobs, number, send, how):
    (file, (*_, (configurations, runs))), out, mark = unbroken, tmp_path / "out", str(tmp_path)
    driver = sweeps.start("sweep", file, "--allow-import", "-o", out, "-j", jobs, mark=mark)
    wait_for(lambda: sweeps.count(out / "sweep.sqlite") >= 5)
    told = interrupted(driver, mark, number, send)
    kept, done = sweeps.rows(out / "sweep.sqlite")
    assert kept == configurations
    assert 5 <= len(done) < 50
    assert set(done) < set(runs)
    end = f"{len(done)} finished runs are in {out / 'sweep.sqlite'}; the same command resumes\n"
    within_a_run = r"(at \S+ s of simulated time, in .*; )?"
    assert re.fullmatch(f"interrupted{how}: {within_a_run}{re.escape(end)}", told)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.2, pytest.param(0.0, marks=pytest.mark.whole)])
def test_a_sweep_can_be_interrupted_while_its_workers_start(tmp_path, delay):
    """They are there as soon as there are three processes: the driver and what looks after their semaphores, too.

    Only the last line is compared: a library may have warned of something before.
    """
    file = sweeps.write(tmp_path / "in", pause=0.05, reps=60)
    mark = str(tmp_path)
    driver = sweeps.start("sweep", file, "--allow-import", "-o", tmp_path / "out", "-j", 2, mark=mark)
    wait_for(lambda: len(sweeps.marked(mark)) >= 3)
    time.sleep(delay)
    told = interrupted(driver, mark)
    assert told.splitlines()[-1].startswith("interrupted: "), told


@pytest.mark.slow
@pytest.mark.parametrize(
    ("program", "number", "send", "told"),
    [
        ("desim", signal.SIGINT, os.killpg, "interrupted: 0 of 100 runs have ended; to keep each run and resume"),
        pytest.param(
            *("scenarios.delay", signal.SIGTERM, os.killpg, "interrupted by SIGTERM\n"), marks=pytest.mark.whole
        ),
    ],
)
def test_many_runs_of_one_scenario_and_studies_are_interrupted_in_the_same_way(tmp_path, program, number, send, told):
    mark = str(tmp_path)
    if program == "desim":
        file = sweeps.write(tmp_path / "in", pause=0.1)
        driver = sweeps.start("run", file, "--allow-import", "-n", 100, "-j", 2, mark=mark)
    else:
        driver = sweeps.start("--runs", 1000, "--jobs", 2, "--out", tmp_path, mark=mark, program=program)
    wait_for(lambda: len(sweeps.marked(mark)) >= 5)
    time.sleep(0.5)
    assert told in interrupted(driver, mark, number, send)


def test_a_handled_interrupt_is_not_repeated_and_an_ignored_one_has_no_effect():
    """`timeout` and terminals send their signal to a process and to its group; `nohup` lets it be ignored."""

    def end():
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGTERM)
            cleaned.append("up")

    cleaned = []
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with pytest.raises(Terminated, match=r"^by SIGTERM$"), raising():
        end()
    with raising():
        signal.raise_signal(signal.SIGHUP)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert cleaned == ["up"]


def test_ctrl_c_is_left_as_it_is():
    """Python gives SIGINT its handler, so that a program without one has chosen to be ended at once."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    with raising():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL


@pytest.mark.whole
def test_a_sweep_on_a_cluster_is_interrupted_in_the_same_way_and_can_be_continued(tmp_path, unbroken, cluster):
    (file, whole), out, mark = unbroken, tmp_path / "out", str(tmp_path)
    driver = sweeps.start("sweep", file, "--allow-import", "-o", out, "--cluster", cluster, mark=mark)
    wait_for(lambda: sweeps.count(out / "sweep.sqlite") >= 5)
    told = interrupted(driver, mark)
    assert "desim/study/" not in told  # no traceback of ours; the loop of Dask may log one of its own
    *_, line = told.splitlines()
    assert line.startswith("interrupted: ")
    assert finish(file, out, "--cluster", cluster) == whole

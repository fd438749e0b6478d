"""Drivers that are killed, and Ctrl-C: no process is left, and what was done is not lost."""

import os
import random
import signal
import time

import pytest

from tests.study import sweeps
from tests.study.test_workers import command

INTERRUPTED = 130

pytestmark = pytest.mark.timeout(300)  # a cluster takes its time to replace a worker


def exported(out):
    """Return the table of a sweep as exported, and all that its store has, if it is sound."""
    assert command("export", out, out / "runs.csv").exit_code == 0
    return (out / "runs.csv").read_bytes(), sweeps.rows(out / "sweep.sqlite")


def finish(file, out, *options):
    """Let a sweep go on to its end; return what it prints."""
    made = command("sweep", file, "--allow-import", "-o", out, *options)
    assert made.exit_code == 0, made.output
    return made.stdout


def wait_for(condition, within=60.0):
    """Wait until something is true, s."""
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.005)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_sweep_whose_driver_is_killed_five_times_ends_with_the_table_of_an_unbroken_one(tmp_path, seed):
    """It is killed while workers start, run or have just ended a run, at seeded moments.

    80 runs that pause for 50 ms take 2 s with two workers; a life has 0.2 s from its first run on.
    """
    file = sweeps.write(tmp_path / "in", pause=0.05, reps=40)
    out, moments = tmp_path / "out", random.Random(seed)
    store, counts = out / "sweep.sqlite", [0]
    for life in range(5):
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
    assert 0 < counts[-1] < 80, "it was killed too late to be of any use"
    assert finish(file, out, "-j", 2) == finish(file, tmp_path / "whole", "-j", 2)
    assert exported(out) == exported(tmp_path / "whole")


def interrupted(process, mark):
    """Send what a terminal sends at Ctrl-C to all processes of a driver; return what they print."""
    os.killpg(process.pid, signal.SIGINT)
    stdout, stderr = process.communicate(timeout=20)
    assert sweeps.survivors(mark) == {}
    assert process.returncode == INTERRUPTED, stderr
    assert stdout == ""
    return stderr


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_sweep_that_is_interrupted_says_so_in_a_line_and_goes_on(tmp_path, jobs):
    file = sweeps.write(tmp_path / "in", pause=0.05, reps=30)
    out, mark = tmp_path / "out", str(tmp_path)
    driver = sweeps.start("sweep", file, "--allow-import", "-o", out, "-j", jobs, mark=mark)
    wait_for(lambda: sweeps.count(out / "sweep.sqlite") >= 5)
    told = interrupted(driver, mark)
    done = sweeps.count(out / "sweep.sqlite")
    assert 5 <= done < 60
    assert told == f"interrupted: {done} runs are in {out / 'sweep.sqlite'}; the same command goes on\n"
    assert finish(file, out, "-j", 2) == finish(file, tmp_path / "whole", "-j", 2)
    assert exported(out) == exported(tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.1, 0.3])
def test_a_sweep_can_be_interrupted_while_its_workers_start(tmp_path, delay):
    """They are there as soon as there are three processes: the driver and what looks after their semaphores, too."""
    file = sweeps.write(tmp_path / "in", pause=0.05, reps=60)
    mark = str(tmp_path)
    driver = sweeps.start("sweep", file, "--allow-import", "-o", tmp_path / "out", "-j", 2, mark=mark)
    wait_for(lambda: len(sweeps.marked(mark)) >= 3)
    time.sleep(delay)
    (line,) = interrupted(driver, mark).splitlines()
    assert line.startswith("interrupted: ")


@pytest.mark.slow
def test_many_runs_of_one_scenario_are_interrupted_in_the_same_way(tmp_path):
    file = sweeps.write(tmp_path / "in", pause=0.1)
    mark = str(tmp_path)
    driver = sweeps.start("run", file, "--allow-import", "-n", 100, "-j", 2, mark=mark)
    wait_for(lambda: len(sweeps.marked(mark)) >= 5)
    time.sleep(0.5)
    assert interrupted(driver, mark) == "interrupted\n"


@pytest.mark.slow
def test_a_sweep_on_a_cluster_is_interrupted_in_the_same_way(tmp_path, cluster):
    file = sweeps.write(tmp_path / "in", pause=0.05, reps=30)
    out, mark = tmp_path / "out", str(tmp_path)
    driver = sweeps.start("sweep", file, "--allow-import", "-o", out, "--cluster", cluster, mark=mark)
    wait_for(lambda: sweeps.count(out / "sweep.sqlite") >= 5)
    (line,) = interrupted(driver, mark).splitlines()
    assert line.startswith("interrupted: ")
    assert finish(file, out, "--cluster", cluster) == finish(file, tmp_path / "whole", "-j", 2)

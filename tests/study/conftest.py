"""A cluster for the tests of many runs."""

import os
import subprocess
import sys

import pytest

from tests.study.sweeps import ROOT, await_workers

CLUSTER = """\
import sys
from distributed import LocalCluster

if __name__ == "__main__":
    with LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", scheduler_port=0, dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


@pytest.fixture
def cluster(scheduler, monkeypatch):
    """Return the address of a Dask scheduler with two workers, which know desim, but none of the folders of a test.

    Of those that died in an earlier test, one at least has been replaced; replacing takes long on a busy machine.
    """
    monkeypatch.setattr("desim.study.workers.executors.START_TIMEOUT", 900.0)
    await_workers(scheduler, 1)
    return scheduler


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """Yield the address of a Dask scheduler that replaces its workers."""
    folder = tmp_path_factory.mktemp("cluster")
    program = folder / "cluster.py"
    program.write_text(CLUSTER)
    process = subprocess.Popen(
        [sys.executable, program],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
            "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
            "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__INTERVAL": "10s",
        },
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with process:
        yield process.stdout.readline().strip()
        process.stdin.close()
        process.wait(30)

"""Where runs are done: the same table wherever, whatever is defined wherever."""

import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from multiprocessing import resource_tracker
from types import SimpleNamespace

import cloudpickle
import pytest
from click.testing import CliRunner

import desim
from desim.cli import main
from desim.scenario.toml import load
from desim.study.workers import executors
from desim.study.workers import workers as places
from desim.study.workers.batch import run_many
from desim.study.workers.executors import workers_for
from desim.study.workers.serialization import called, packed
from desim.study.workers.workers import InProcess, Processes
from tests.digests import LONG
from tests.study import sweeps

pytestmark = pytest.mark.usefixtures("_undrawn")


def command(*args):
    """Call the command in this process."""
    return CliRunner().invoke(main, [str(each) for each in args], catch_exceptions=False)


def output_of_a_sweep(out, *options):
    """Return all output of a sweep: what it prints, exports and stores."""
    file = sweeps.write(out.parent / "in", reps=4)
    made = command("sweep", file, "--allow-import", "-o", out, *options)
    assert made.exit_code == 0, made.output
    assert command("export", out, out / "runs.csv").exit_code == 0
    return made.stdout, (out / "runs.csv").read_bytes(), sweeps.rows(out / "sweep.sqlite")


@pytest.mark.slow
@pytest.mark.parametrize("where", ["processes", pytest.param("cluster", marks=pytest.mark.whole)])
def test_a_sweep_has_the_same_output_wherever_it_is_run(request, tmp_path, where):
    """Its rule is of a module beside the file that imports another; all that happens in it is random."""
    options = ("-j", 2) if where == "processes" else ("--cluster", request.getfixturevalue("cluster"))
    here = output_of_a_sweep(tmp_path / "here", "-j", 1)
    assert output_of_a_sweep(tmp_path / "there", *options) == here
    _, table, (configurations, runs) = here
    assert len(configurations) == 2
    assert len(runs) == len(table.splitlines()) - 1 == 8
    assert len({run[5] for run in runs}) == 8  # no two runs are the same
    assert (
        command("sweep", tmp_path / "in" / "coins.toml", "--allow-import", "-o", tmp_path / "other", "-s", 1).stdout
        != here[0]
    )


@pytest.mark.whole
def test_a_long_run_has_the_same_numbers_wherever_it_is_done(tmp_path, cluster):
    """So long that BLAS would divide its sums among threads, of which Dask allows a worker one."""
    stores = [tmp_path / f"{k}.sqlite" for k in range(3)]
    for store, executor in zip(stores, (1, 2, cluster), strict=True):
        desim.sweep(LONG, {"team.count": [2]}, reps=1, executor=executor, store=store)
    here, *there = map(sweeps.rows, stores)
    assert there == [here] * 2
    assert len(here[1]) == 1


@pytest.mark.slow
def test_a_sweep_has_the_same_rows_with_user_executors(tmp_path):
    scenario = load(sweeps.write(tmp_path / "in", reps=3), allow_import=True)
    here = desim.sweep(scenario)
    with ThreadPoolExecutor(2) as threads, ProcessPoolExecutor(2) as processes:
        assert desim.sweep(scenario, executor=threads) == here
        assert desim.sweep(scenario, executor=processes) == here
        assert threads.submit(int, 3).result() == processes.submit(int, 3).result() == 3  # they stay open


SCRIPT = """\
import sys

import desim
from desim.scenario.players import Team
from desim.scenario.scenario import Motion, Recording, Scenario
from my_trouble import WAYS
from protocols.rule import Rule
from protocols.schedules.periodic import Poisson

BIAS = 0.5


class Coin(Rule):
    bias: float = 0.0

    def actions(self, me):
        assert WAYS
        while True:
            yield int(me.rng.random() < self.bias + BIAS)


if __name__ == "__main__":
    scenario = Scenario(
        horizon=1.0,
        team=Team(count=3),
        motion=Motion(step=0.1),
        record=Recording(trajectory=0.0),
        protocol=Coin(schedule=Poisson(rate=5.0)),
    )
    for where in (1, 2, sys.argv[1]):
        found = desim.sweep(scenario, {"protocol.bias": [-0.2, 0.0, 0.2]}, 5, where)
        print(*found.records(), sep="\\n")
"""


@pytest.mark.whole
def test_a_script_may_define_a_rule_and_import_modules_that_lie_beside_it(tmp_path, cluster):
    sweeps.write(tmp_path)
    (tmp_path / "script.py").write_text(SCRIPT)
    made = subprocess.run(
        [sys.executable, tmp_path / "script.py", cluster],
        env={**os.environ, "PYTHONPATH": str(sweeps.ROOT)},
        cwd=tmp_path.parent,
        check=True,
        capture_output=True,
        text=True,
    )
    here = made.stdout.splitlines()[:15]
    assert made.stdout.splitlines() == here * 3
    assert all("'ok'" in line for line in here)


def test_modules_beside_a_file_are_sent_to_workers_and_installed_ones_are_not(tmp_path, monkeypatch):
    """In a process that has neither module, the call can be made; and the pickler is as it was."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "outer_module.py").write_text("import inner_module\n\ndef ten():\n    return inner_module.ten()\n")
    (tmp_path / "inner_module.py").write_text("import math\n\ndef ten():\n    return math.sqrt(100)\n")
    import outer_module

    call = packed(partial(outer_module.ten))
    assert cloudpickle.list_registry_pickle_by_value() == set()
    monkeypatch.undo()
    for name in ("outer_module", "inner_module"):
        del sys.modules[name]
        with pytest.raises(ModuleNotFoundError):
            import_module(name)
    assert pickle.loads(called(call)) == 10.0
    assert len(packed(partial(desim.run, None, 1))) < 200


@pytest.mark.parametrize(("given", "kind", "count"), [(1, InProcess, 1), (3, Processes, 3), (0, Processes, 5)])
def test_a_number_is_of_processes_and_0_of_one_per_core(monkeypatch, given, kind, count):
    monkeypatch.setattr(os, "cpu_count", lambda: 5)
    monkeypatch.setattr(places, "_pool", lambda count, *, kept: None)
    found = workers_for(given)
    assert type(found) is kind
    assert found.count == count


def test_there_are_no_more_processes_than_calls(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 5)
    monkeypatch.setattr(places, "_pool", lambda count, *, kept: None)
    assert [workers_for(given, calls).count for given, calls in ((60, 2), (3, 9), (0, 4))] == [2, 3, 4]
    assert {type(workers_for(60, calls)) for calls in (0, 1)} == {InProcess}


def test_a_negative_number_of_workers_is_refused():
    with pytest.raises(ValueError, match="at least 0, got -1"):
        workers_for(-1)


def test_the_number_of_workers_is_that_of_the_executor_or_of_the_cores(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 5)
    with ThreadPoolExecutor(3) as executor:
        assert workers_for(executor).count == 3
        del executor._max_workers
        assert workers_for(executor).count == 5
        executor._max_workers = 3


def test_here_a_ctrl_c_is_not_taken_for_a_failure():
    def interrupt():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        InProcess().submit(partial(interrupt))


@pytest.mark.slow
def test_a_worker_ignores_ctrl_c():
    with workers_for(2) as found:
        future = found.submit(partial(signal.getsignal, signal.SIGINT))
        blocked = found.submit(partial(signal.pthread_sigmask, signal.SIG_BLOCK, ()))
        assert found.result(future) is signal.SIG_IGN
        assert signal.SIGINT in found.result(blocked)  # since before it could ignore it
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.fixture
def silent_port():
    """Yield a port that accepts and sends nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


@pytest.fixture
def closed_port(silent_port):
    """Return a port without a listener."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["silent_port", "closed_port"])
def test_an_unresponsive_scheduler_is_reported_in_time(request, tmp_path, monkeypatch, name):
    monkeypatch.setattr(executors, "START_TIMEOUT", 1.0)
    address = f"tcp://127.0.0.1:{request.getfixturevalue(name)}"
    begin = time.monotonic()
    made = command("sweep", sweeps.write(tmp_path), "--allow-import", "-o", tmp_path / "out", "--cluster", address)
    assert time.monotonic() - begin < 25.0  # it would go on for Dask's own 30 s
    assert made.exit_code == 2
    assert made.stdout == ""
    (line,) = made.stderr.splitlines()
    assert line.startswith(f"{address}: no scheduler answers within 1 s")


@pytest.mark.slow
@pytest.mark.parametrize("address", ["nonsense", "tcp://", "ftp://127.0.0.1:1", "tcp://127.0.0.1:port"])
def test_a_malformed_address_is_reported(tmp_path, monkeypatch, address):
    monkeypatch.setattr(executors, "START_TIMEOUT", 0.2)
    made = command("sweep", sweeps.write(tmp_path), "--allow-import", "-o", tmp_path / "out", "--cluster", address)
    assert made.exit_code == 2
    (line,) = made.stderr.splitlines()
    assert line.startswith(f"{address}: no scheduler answers")


@contextmanager
def dask(program, *options):
    """Run a part of a cluster of one's own, and end it, also if the test fails."""
    with subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{program}", *map(str, options), "--no-dashboard"],
        env={**os.environ, "PYTHONPATH": str(sweeps.ROOT)},
        stderr=subprocess.DEVNULL,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def scheduler_alone(tmp_path):
    """Yield the process of a scheduler without workers, and its address."""
    note = tmp_path / "scheduler.json"
    with dask("scheduler", "--host", "127.0.0.1", "--port", 0, "--scheduler-file", note) as process:
        while not note.exists():
            time.sleep(0.05)
        yield process, json.loads(note.read_text())["address"]


def test_a_cluster_whose_workers_or_scheduler_have_gone_is_reported():
    """The first is asked whether it has workers while nothing ends; the calls of the second are cancelled."""

    class Idle:
        def wait_for_workers(self, count, timeout):
            raise TimeoutError

    cluster = object.__new__(places.Cluster)
    cluster._client, cluster._address, cluster._patience, cluster._name = Idle(), "tcp://x", 0.05, "tcp://x"
    with pytest.raises(ConnectionError, match=r"^tcp://x: has no workers within 0\.05 s$"):
        cluster.done([Future()])
    lost = Future()
    lost.cancel()
    with pytest.raises(ConnectionError, match=r"^tcp://x: disconnected before the runs were done$"):
        cluster.result(lost)


@pytest.mark.whole
def test_a_cluster_without_workers_and_the_loss_of_its_scheduler_are_reported(tmp_path, monkeypatch, scheduler_alone):
    """Never had, or left with exit code 0, so that no other is started. What was done by then is kept."""
    monkeypatch.setattr(executors, "START_TIMEOUT", 2.0)
    scheduler, address = scheduler_alone

    def swept(name, **given):
        file = sweeps.write(tmp_path / f"in {name}", losses=(0.2,), reps=40, **given)
        made = command("sweep", file, "--allow-import", "-o", tmp_path / name, "--cluster", address)
        assert (made.exit_code, made.stdout) == (2, "")
        return made.stderr, sweeps.count(tmp_path / name / "sweep.sqlite")

    assert swept("none") == (f"{address}: has no workers within 2 s\n", 0)
    options = (address, "--nthreads", 1, "--no-nanny", "--death-timeout", 1)
    with dask("worker", *options):
        sweeps.await_workers(address, 1)
        said, done = swept("left", bad=(6,), how="leave")
    assert said == f"{address}: has no workers within 2 s\n"
    assert 1 <= done < 40

    def kill():
        while sweeps.count(tmp_path / "lost" / "sweep.sqlite") < 5:
            time.sleep(0.02)
        scheduler.kill()

    with dask("worker", *options):
        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        sweeps.await_workers(address, 1)
        said, done = swept("lost", pause=0.05)
        killer.join()
    assert said == f"{address}: disconnected before the runs were done\n"
    assert 5 <= done < 40


def test_a_request_has_a_result_an_error_or_no_answer_in_time():
    assert places._within(1.0, lambda: "answer") == "answer"
    with pytest.raises(KeyError, match="refused"):
        places._within(1.0, partial({}.__getitem__, "refused"))
    with pytest.raises(TimeoutError):
        places._within(0.01, partial(threading.Event().wait, 0.2))


@pytest.fixture
def interruptible():
    """Let Ctrl-C be what it is at a prompt, whatever ran in this process before."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.slow
@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_waits_until_workers_have_started_whichever_thread_receives_it():
    """That of a progress bar, say, has not blocked it; an interrupt half-way leaves a worker without tasks."""
    over = threading.Event()
    threading.Thread(target=over.wait, daemon=True).start()
    reached = []

    def start():
        with places._block_signals():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.05)
            reached.append("the end")

    with pytest.raises(KeyboardInterrupt):
        start()
    over.set()
    assert reached == ["the end"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_where_the_number_of_cores_is_unknown_there_is_one_worker(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: None)
    assert places.Workers(object()).count == 1


# A cluster, and processes, without a process.


class Client:
    """A client of a scheduler without one; `fails` has what its calls raise."""

    def __init__(self, fails=None, cores=(2, 3)):
        self.fails, self.cores, self.calls, self.is_closed = fails or {}, cores, [], False

    def __call__(self, address, **options):
        self.calls.append(("Client", address, options))
        if "Client" in self.fails:
            raise self.fails["Client"]
        return self

    def wait_for_workers(self, count, timeout):
        self.calls.append(("wait", count, timeout))
        if "wait" in self.fails:
            raise self.fails["wait"]

    def get_executor(self, **options):
        self.calls.append(("executor", options))
        return ThreadPoolExecutor(1)

    def nthreads(self):
        return dict(enumerate(self.cores))

    def close(self):
        self.is_closed = True


@pytest.fixture
def client(monkeypatch):
    """Return the client that clusters have."""
    made = Client()
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(Client=made))
    return made


def test_a_cluster_asks_its_scheduler_and_has_the_threads_of_all_workers(client):
    with places.Cluster("tcp://h:1", 0.5) as cluster:
        assert (cluster.count, cluster.max_pending) == (5, 10)
        future = cluster.submit(partial(abs, -3))
        assert cluster.done([future]) == {future}
        assert cluster.result(future) == 3
        cluster.renew()
        assert not client.is_closed
    assert client.is_closed
    assert client.calls == [
        ("Client", "tcp://h:1", {"timeout": 0.5, "set_as_default": False}),
        ("wait", 1, 0.5),
        ("executor", {"pure": False}),
    ]


@pytest.mark.parametrize(
    ("call", "error", "told"),
    [
        ("Client", OSError("no way"), "tcp://h:1: no scheduler answers within 0.5 s (no way)"),
        ("Client", TimeoutError(), "tcp://h:1: no scheduler answers within 0.5 s"),
        ("Client", ValueError("scheme"), "tcp://h:1: no scheduler answers within 0.5 s (scheme)"),
        ("wait", TimeoutError(), "tcp://h:1: has no workers within 0.5 s"),
    ],
)
def test_a_cluster_that_cannot_be_used_is_told_and_left(call, error, told, client):
    client.fails[call] = error
    with pytest.raises(ConnectionError) as failed:
        places.Cluster("tcp://h:1", 0.5)
    assert str(failed.value) == told
    assert client.is_closed == (call == "wait")


def test_calls_that_no_worker_can_end_are_told(client):
    with places.Cluster("tcp://h:1", 0.01) as cluster:
        client.fails["wait"] = TimeoutError()
        with pytest.raises(ConnectionError, match=r"^tcp://h:1: has no workers within 0\.01 s$"):
            cluster.done([Future()])


def test_a_call_that_is_cancelled_is_a_lost_connection(client):
    with places.Cluster("tcp://h:1", 0.5) as cluster:
        future = Future()
        future.cancel()
        with pytest.raises(ConnectionError, match=r"^tcp://h:1: disconnected before the runs were done$"):
            cluster.result(future)


def test_a_call_that_cannot_be_sent_fails_as_one_that_raises():
    with ThreadPoolExecutor(1) as executor:
        future = places.Workers(executor).submit(partial(abs, threading.Lock()))
    assert isinstance(future.exception(), TypeError)


def test_a_call_in_this_process_that_raises_has_failed():
    future = InProcess().submit(partial(int, "x"))
    assert isinstance(future.exception(), ValueError)


def test_an_executor_of_a_user_is_not_replaced():
    with pytest.raises(BrokenExecutor, match="a worker died, so theirs accepts no more calls: pass a number"):
        places.Workers(ThreadPoolExecutor(1), 1, "theirs").renew()


@pytest.mark.parametrize("kept", [True, False])
def test_processes_are_made_anew_as_they_were(kept, monkeypatch):
    made = []
    monkeypatch.setattr(places, "_pool", lambda count, *, kept: made.append((count, kept)) or len(made))
    workers = Processes(3, kept=kept)
    workers.renew()
    assert made == [(3, kept)] * 2
    assert workers.executor == 2


def test_copies_with_another_time_out_share_the_pool_that_replaces_a_broken_or_stopped_one(monkeypatch):
    pools = [SimpleNamespace(shutdown=lambda **_: None) for _ in range(3)]
    made = iter(pools)
    monkeypatch.setattr(places, "_pool", lambda count, *, kept: next(made))
    workers = Processes(3, kept=True)
    first, second = workers_for(workers), workers_for(workers, timeout=2.0)
    assert first.executor is second.executor is workers.executor is pools[0]
    first.renew()
    assert second.executor is workers.executor is pools[1]
    second.stop()
    assert first.executor is workers.executor is pools[2], "who stops a run leaves workers that can be used"
    workers.stop()
    workers.stop()


def fails(scenario, seed):
    raise ValueError("no")


@pytest.mark.whole
def test_processes_of_the_caller_can_be_used_after_a_run_that_failed():
    tasks = [(desim.Scenario(team={"count": 2}, horizon=0.5), 0)]
    workers = Processes(2, kept=True)
    try:
        with pytest.raises(ValueError, match="no"):
            run_many(tasks, workers, simulate=fails)
        assert run_many(tasks, workers) == run_many(tasks, 1)
    finally:
        workers.stop()


@pytest.mark.parametrize("kept", [True, False])
def test_a_pool_imports_nothing_from_the_working_folder_and_knows_its_driver(kept, monkeypatch):
    import loky

    made = []
    for name in ("ProcessPoolExecutor", "get_reusable_executor"):
        monkeypatch.setattr(loky, name, lambda name=name, **options: made.append((name, options)))
    tracked = []
    monkeypatch.setattr(resource_tracker, "ensure_running", lambda: tracked.append(True))
    places._pool(3, kept=kept)
    assert tracked == [True]
    options = {"max_workers": 3, "initializer": places._init_worker, "initargs": (os.getpid(),)}
    assert made == [
        ("ProcessPoolExecutor" if kept else "get_reusable_executor", options | {"env": places.NO_CWD_IMPORT})
    ]


def test_a_worker_ignores_signals_and_ends_with_its_driver(monkeypatch):
    ignored, parents, ends = [], iter([7, 7, 1]), []
    monkeypatch.setattr(places.signal, "signal", lambda *words: ignored.append(words))
    monkeypatch.setattr(places.os, "getppid", lambda: next(parents))
    monkeypatch.setattr(places.os, "_exit", ends.append)
    monkeypatch.setattr(places, "WATCH", 0.0)
    threads = []
    thread = SimpleNamespace(start=lambda: threads.append("started"))
    monkeypatch.setattr(places.threading, "Thread", lambda **options: threads.append(options) or thread)
    places._init_worker(7)
    assert ignored == [(number, signal.SIG_IGN) for number in places.SIGNALS]
    options, was_started = threads
    assert was_started == "started"
    assert options["daemon"] is True
    options["target"]()
    assert ends == [1]


def test_signals_are_blocked_where_the_system_can_and_until_processes_have_started(monkeypatch):
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    with places._block_signals():
        assert signal.pthread_sigmask(signal.SIG_BLOCK, []) >= set(places.SIGNALS)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before
    monkeypatch.delattr(signal, "pthread_sigmask")
    with places._block_signals():
        pass

"""The driver: each task has one outcome, whatever becomes of it and of its worker."""

import pickle
import sys
import threading
from collections import Counter
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing
from functools import partial
from warnings import catch_warnings, simplefilter

import pytest

import desim
from desim.analysis.measuring import summary
from desim.config.shared_state import StateWarning, shared_changes
from desim.scenario.toml import load
from desim.simulation.run import run
from desim.simulation.watchdog import OUT_OF_MEMORY
from desim.study.store.run_table import Row
from desim.study.workers import dispatch
from desim.study.workers.dispatch import CRASHED, INNERMOST, drive, drive_batches
from desim.study.workers.executors import workers_for
from desim.study.workers.workers import InProcess, Workers
from tests.study import sweeps
from tests.study.test_workers import command

pytestmark = pytest.mark.usefixtures("_undrawn")
FAILED = 3
WAYS = ("raise", "stubborn", "wild", "quit", "recursion", "memory", "huge")
"""Ways in which a run raises."""
PASSED = ("raise", "picky", "quit", "stubborn")
"""Exceptions that can be pickled, or not."""


@pytest.fixture
def scenario(tmp_path):
    """Return a scenario in which nothing goes wrong yet."""
    return load(sweeps.write(tmp_path / "in", losses=(0.2,), reps=40), allow_import=True)


def wrong(scenario, how, *bad):
    """Return a scenario that goes wrong in a way if the seed is one of some."""
    return scenario.model_copy(update={"protocol": scenario.protocol.model_copy(update={"how": how, "bad": bad})})


def outcomes(tasks, workers, measure=summary):
    """Return what becomes of tasks, in their order, each once."""
    found = list(drive(tasks, workers, measure))
    assert sorted(k for k, _ in found) == list(range(len(tasks)))
    return [outcome for _, outcome in sorted(found, key=lambda each: each[0])]


class Counting(InProcess):
    """Notes how many runs it is handed at once."""

    def __init__(self, took=0.0):
        super().__init__()
        self.lots, self.took = [], took

    def submit(self, call):
        self.lots.append(len(call.args[0]))
        future = Future()
        future.set_result(([dispatch.Outcome("ok", task) for task in call.args[0]], self.took))
        return future


@pytest.mark.parametrize("count", [0, 1, 2, 3, 1000])
@pytest.mark.parametrize("took", [1e-6, 0.01, 10.0])
def test_each_task_is_handed_out_once_in_its_order_and_the_first_alone(count, took):
    workers = Counting(took)
    assert list(drive(range(count), workers)) == [(k, dispatch.Outcome("ok", k)) for k in range(count)]
    assert sum(workers.lots) == count
    assert workers.lots[:1] == [1][:count]
    most = {1e-6: Workers.batch_size, 0.01: 25, 10.0: 1}[took]  # in 0.25 s
    assert max(workers.lots, default=0) == (most if count == 1000 else min(count, 1))


def test_towards_the_end_batches_become_small_so_that_all_workers_end_together():
    workers = Counting(1e-6)
    workers.count = 4
    list(drive(range(200), workers))
    assert workers.lots[-8:] == [1] * 8
    assert max(workers.lots) <= 200 // 8


def test_a_batch_that_a_broken_worker_did_not_take_is_submitted_again_in_order():
    class Broken(Counting):
        renewed = 0

        def submit(self, call):
            if len(call.args[0]) > 2 and not self.renewed:
                raise BrokenExecutor
            return super().submit(call)

        def renew(self):
            self.renewed += 1

    workers = Broken(1e-6)
    assert [k for k, _ in drive(range(100), workers)] == list(range(100))
    assert workers.renewed == 1


def test_the_time_of_a_run_is_its_share_of_the_time_of_its_batch(monkeypatch):
    now = 3.0

    def simulate(scenario, seed):
        nonlocal now
        now += 0.5
        return seed

    monkeypatch.setattr(dispatch, "perf_counter", lambda: now)
    outcomes, took = dispatch.perform([(None, k) for k in range(10)], lambda result: result, simulate)
    assert [outcome.value for outcome in outcomes] == list(range(10))
    assert took == 0.5


def remembering():
    """Stand for a model with a number that each run changes."""


remembering.calls = 0


def simulate(scenario, seed):
    """Stand for a run that changes it."""
    with shared_changes([remembering], lambda value: value):
        remembering.calls += 1
    return seed


@pytest.mark.slow
def test_what_runs_warn_of_in_workers_is_told_once_here():
    """Whoever performs them: in a process nobody would read the warning."""

    class Copying(InProcess):
        def result(self, future):
            return pickle.loads(pickle.dumps(super().result(future)))

    for workers in (InProcess(), Copying()):
        with catch_warnings(record=True) as caught:
            simplefilter("always")
            assert len([*drive([(None, 1)] * 300, workers, lambda result: result, simulate)]) == 300
        assert [warning.category for warning in caught] == [StateWarning]
        assert str(caught[0].message).startswith("remembering.calls: an earlier run has changed it")


def test_what_a_run_warns_of_is_told_if_it_is_repeated_alone_or_fails():
    """The first run ends its worker while the others are under way, so all of them are repeated."""
    remembering.calls = 0
    tasks = [(None, seed) for seed in range(4)]

    def measured(seed):
        return 1 / (seed - 1)

    expected = partial(pytest.warns, StateWarning, match=r"^remembering\.calls: ")
    with expected() as of_repeated:
        repeated = dict(drive(tasks, Mortal(0), measured, simulate))
    assert [repeated[k].status for k in range(4)] == ["crashed", "error", "ok", "ok"]
    assert len(of_repeated) == 1
    with expected():
        ((_, failed),) = drive(tasks[1:2], InProcess(), measured, simulate)
    assert (failed.status, len(failed.warnings)) == ("error", 1)


def test_a_warning_of_runs_has_the_place_where_their_outcomes_are_asked_for():
    with pytest.warns(StateWarning) as caught:
        list(drive_batches([(None, 1)] * 2, InProcess(), lambda result: result, simulate))
    assert {warning.filename for warning in caught} == {__file__}


class Mortal(InProcess):
    """Workers in this process that die at some seeds, with all that has been submitted."""

    def __init__(self, *deadly):
        super().__init__()
        self.max_pending, self.deadly, self.pending, self.renewed = 4, deadly, [], 0

    def submit(self, call):
        if any(future.done() for future, _ in self.pending):
            raise BrokenExecutor
        self.pending.append((Future(), call))
        return self.pending[-1][0]

    def done(self, futures):
        (future, call), *others = self.pending
        if any(seed in self.deadly for _, seed in call.args[0]):
            for lost, _ in self.pending:
                lost.set_exception(BrokenExecutor())
        else:
            future.set_result(call())
            self.pending = others
        return {future for future in futures if future.done()}

    def renew(self):
        self.pending, self.renewed = [], self.renewed + 1


@pytest.mark.parametrize("deadly", [(0,), (3, 4), (11, 12), (0, 6, 12), range(13)])
def test_of_runs_that_were_lost_with_their_workers_only_the_deadly_have_crashed(deadly):
    """Whatever shared a batch with one, or was under way beside it, is repeated alone."""
    workers = Mortal(*deadly)
    outcomes = sorted(drive([(None, seed) for seed in range(13)], workers, lambda seed: -seed, lambda _, seed: seed))
    assert [k for k, _ in outcomes] == [*range(13)]  # each once
    for k, outcome in outcomes:
        expected = ("crashed", None, CRASHED) if k in deadly else ("ok", -k, "")
        assert (outcome.status, outcome.value, outcome.traceback) == expected
    assert workers.renewed > len(deadly)  # once for those that died together, and for each that dies alone


@pytest.mark.whole
def test_a_run_that_ends_its_worker_costs_no_other_run(scenario):
    """The first is killed; of the last two, at once, each leaves with exit code 0."""
    ways = {0: "kill", 11: "leave", 12: "leave"}
    tasks = [(wrong(scenario, ways.get(seed, ""), *ways), seed) for seed in range(13)]
    with workers_for(2) as workers:
        found = outcomes(tasks, workers)
    assert {k for k, each in enumerate(found) if each.status == "crashed"} == ways.keys()
    for k, each in enumerate(found):
        assert each.traceback == (CRASHED if k in ways else "")
        assert each.value == (None if k in ways else summary(run(*tasks[k])))


@pytest.mark.whole
def test_the_crashes_of_the_first_and_seventh_of_ten_runs_are_rows_of_the_same_table_everywhere(tmp_path, cluster):
    file = sweeps.write(tmp_path / "in", losses=(0.2,), reps=10, bad=(0, 6), how="exit")
    told = []
    for name, options in {"processes": ("-j", 2), "cluster": ("--cluster", cluster)}.items():
        made = command("sweep", file, "--allow-import", "-o", tmp_path / name, *options)
        assert made.exit_code == FAILED, made.output
        assert "2 runs failed; the same command retries them" in made.stderr
        assert command("export", tmp_path / name, tmp_path / name / "runs.csv").exit_code == 0
        table = (tmp_path / name / "runs.csv").read_text()
        told.append((made.stdout, table, sweeps.rows(tmp_path / name / "sweep.sqlite")))
    assert told[0] == told[1]
    _, table, (_, runs) = told[0]
    assert [row.split(",")[1:3] for row in table.splitlines()[1:]] == [
        [str(k), "crashed" if k in (0, 6) else "ok"] for k in range(10)
    ]
    assert CRASHED.strip() in table.splitlines()[7]
    assert Counter(run[4] for run in runs) == {"ok": 8, "crashed": 2}


def test_a_run_without_memory_says_what_to_do(scenario):
    def measure(_):
        raise MemoryError

    ((_, outcome),) = drive([(scenario, 1)], InProcess(), measure)
    assert str(outcome.error) == OUT_OF_MEMORY
    assert Row(0, 0, "error", traceback=outcome.traceback).error == f"MemoryError: {OUT_OF_MEMORY}"


@pytest.mark.whole
def test_an_exception_of_a_run_has_the_same_text_wherever_it_runs(scenario, cluster):
    """Two good runs stand between the bad ones, so that some share a lot with others."""
    tasks = [task for how in WAYS for task in ((wrong(scenario, how, 0), 0), (scenario, 1), (scenario, 2))]
    here = outcomes(tasks, InProcess())
    assert [each.status for each in here] == ["error", "ok", "ok"] * len(WAYS)
    texts = dict(zip(WAYS, (each.traceback for each in here[::3]), strict=True))
    last = {how: Row(0, 0, "error", traceback=text).error for how, text in texts.items()}
    assert last["raise"] == "ValueError: seventh heaven"
    assert last["stubborn"] == "my_trouble.StubbornError: no pickle"
    assert last["wild"] == "my_trouble.WildError: whoa"
    assert last["quit"].startswith("RuntimeError: the protocol called exit(4) (pursuer 0, at ")
    assert last["recursion"].startswith("RecursionError: ")
    assert last["memory"].startswith("MemoryError")
    assert last["huge"].startswith(("MemoryError", "OverflowError"))
    for how, text in texts.items():
        assert text.startswith("Traceback (most recent call last):")
        assert text.count("File ") <= 2 * INNERMOST  # what a process raised, and where its simulator did
        assert 'my_rules.py", line' in text or how == "recursion"
    with ThreadPoolExecutor(2) as threads, ProcessPoolExecutor(2) as processes:
        for where in (threads, processes, 2, cluster):
            with workers_for(where) as workers:
                there = outcomes(tasks, workers)
            assert [(each.status, each.value, each.traceback) for each in there] == [
                (each.status, each.value, each.traceback) for each in here
            ]


def test_a_traceback_keeps_the_innermost_calls(scenario):
    def fail():
        raise ValueError("deep")

    def measure(_, depth=2 * INNERMOST):
        return measure(_, depth - 1) if depth else fail()

    ((_, outcome),) = drive([(scenario, 1)], InProcess(), measure)
    assert ", in fail\n" in outcome.traceback
    assert ", in _outcome\n" not in outcome.traceback


class CountsCalls:
    """A protocol with state, of which each run has a copy."""

    def __init__(self):
        self.calls = 0

    def __call__(self, me):
        self.calls += 1
        yield me.sleep(1.0)


def test_the_result_of_a_run_has_the_scenario_of_the_caller():
    """Not that with copies of its objects, whose state the run has changed."""
    scenario = desim.Scenario(protocol=CountsCalls(), horizon=1.0)
    ((_, outcome),) = drive([(scenario, 1)], InProcess(), lambda result: (result.scenario.protocol.calls, result))
    calls, result = outcome.value
    assert (calls, scenario.protocol.calls) == (0, 0)
    assert result.scenario is scenario


@pytest.mark.whole
def test_an_exception_is_passed_on_if_it_can_be_pickled(scenario):
    def fail(how, _):
        next(module for name, module in sys.modules.items() if name.startswith("my_trouble")).trouble(how)

    def fail_there(how, _):  # where it has not been imported
        trouble(how)

    trouble = next(module for name, module in sys.modules.items() if name.startswith("my_trouble")).trouble
    for workers, measure in ((InProcess(), fail), (workers_for(2), fail_there)):
        found = {how: outcomes([(scenario, 0)], workers, partial(measure, how))[0] for how in PASSED}
        assert {each.status for each in found.values()} == {"error"}
        assert repr(found["raise"].error) == "ValueError('seventh heaven')"
        assert repr(found["quit"].error) == "SystemExit(4)"
        assert repr(found["picky"].error) in {"None", "PickyError('this and that')"}  # Dask's pickler knows a way
        assert found["picky"].traceback.endswith("my_trouble.PickyError: this and that\n")
        assert found["stubborn"].error is None


def test_a_ctrl_c_in_a_run_is_no_failure_of_it(scenario):
    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(drive([(scenario, 0)], InProcess(), simulate=interrupt))


@pytest.mark.whole
def test_an_object_that_cannot_be_pickled_is_an_error_of_each_run_that_needs_it(scenario, cluster):
    """A measure that returns a lock, and one that has a lock."""
    lock = threading.Lock()

    def give(_):
        return threading.Lock()

    def have(_):
        return lock

    tasks = [(scenario, seed) for seed in range(6)]
    with ProcessPoolExecutor(2) as processes:
        for where in (2, cluster, processes):
            with workers_for(where) as workers:
                for measure in (give, have):
                    found = outcomes(tasks, workers, measure)
                    assert {(each.status, each.traceback) for each in found} == {
                        ("error", "TypeError: cannot pickle '_thread.lock' object\n")
                    }
    assert [each.status for each in outcomes(tasks, InProcess(), give)] == ["ok"] * 6  # it never leaves


@pytest.mark.whole
def test_an_executor_that_breaks_ends_the_sweep_and_what_was_done_is_kept(tmp_path):
    scenario = load(sweeps.write(tmp_path / "in", losses=(0.2,), bad=(30,), how="exit", reps=40), allow_import=True)
    with (
        ProcessPoolExecutor(2) as executor,
        pytest.raises(BrokenExecutor, match=r"ProcessPoolExecutor.* accepts no more calls: pass a number of workers"),
    ):
        desim.sweep(scenario, executor=executor, store=tmp_path / "store.sqlite")
    _, runs = sweeps.rows(tmp_path / "store.sqlite")
    assert 4 <= len(runs) < 40
    assert {row[4] for row in runs} == {"ok"}


class Lazy(Executor):
    """Makes the first call and no other."""

    def __init__(self):
        self.futures = []

    def submit(self, fn, /, *args, **kwargs):
        self.futures.append(Future())
        if len(self.futures) == 1:
            self.futures[0].set_result(fn(*args, **kwargs))
        return self.futures[-1]


def test_runs_that_are_no_longer_needed_are_cancelled(scenario):
    executor = Lazy()
    with closing(drive([(scenario, k) for k in range(9)], Workers(executor, 2))) as found:
        assert next(found)[0] == 0
        assert not any(future.cancelled() for future in executor.futures)
    assert len(executor.futures) == 4  # two for each worker
    assert [future.cancelled() for future in executor.futures] == [False, True, True, True]


def test_only_a_memory_error_without_a_text_gets_one():
    for error, args in (
        (MemoryError(), (OUT_OF_MEMORY,)),
        (MemoryError("own"), ("own",)),
        (ValueError(), ()),
        (ValueError("own"), ("own",)),
    ):
        dispatch._explain(error)
        assert error.args == args


@pytest.mark.parametrize("error", [ConnectionError("gone"), ValueError("no way")])
def test_a_run_alone_that_fails_is_an_outcome_unless_the_workers_are_gone(error):
    class Failing(InProcess):
        def result(self, future):
            raise error

    workers = Failing()
    if isinstance(error, ConnectionError):
        with pytest.raises(ConnectionError, match="gone"):
            dispatch._run_alone(0, lambda _: workers.submit(partial(int)), workers)
    else:
        outcome = dispatch._run_alone(0, lambda _: workers.submit(partial(int)), workers)
        assert (outcome.status, outcome.error, outcome.traceback) == ("error", error, "ValueError: no way\n")


def test_workers_that_are_gone_end_all_runs():
    class Gone(InProcess):
        stopped = False

        def result(self, future):
            raise ConnectionError("gone")

        def stop(self):
            self.stopped = True

    workers = Gone()
    with pytest.raises(ConnectionError, match="gone"):
        list(drive([(None, 0), (None, 1)], workers))
    assert workers.stopped


class LockedInError(Exception):
    """Cannot be pickled."""

    def __init__(self):
        super().__init__("locked")
        self.lock = threading.Lock()


class OfTwoError(Exception):
    """Is pickled, and cannot be read again: its arguments are not those of its class."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


def test_an_exception_is_sent_by_a_worker_if_it_survives():
    plain, caused = ValueError("x"), ValueError("y")
    caused.__context__ = LockedInError()
    assert dispatch._picklable(plain) is plain
    assert dispatch._picklable(caused) is caused
    assert [dispatch._picklable(error) for error in (LockedInError(), OfTwoError(1, 2))] == [None, None]

"""Many runs: the same list, in the same order, from any number of workers."""

import os
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.analysis.measuring import summary
from desim.analysis.metrics import active_time
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.scenario.players import Team
from desim.scenario.scenario import Motion, Recording, Scenario
from desim.simulation.run import run
from desim.study.workers.batch import run_many, seeds_from
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson

SMALL = Scenario(
    horizon=0.5,
    team=Team(count=3, active_at_start=0.5),
    motion=Motion(step=0.1),
    protocol=SpatialAdaptivePlay(schedule=Poisson(rate=5.0)),
    network=Links(loss=Bernoulli(p=0.2)),
    record=Recording(trajectory=0.0),
)
LONGER = SMALL.model_copy(update={"horizon": 2.0})


class BrokenRunError(RuntimeError):
    """What a run of these tests dies of."""


def broken_protocol(me):
    """Fail at 0.1 s."""
    yield me.at(0.1)
    raise BrokenRunError(f"pursuer {me.id}")


BROKEN = SMALL.model_copy(update={"protocol": broken_protocol})


def test_run_k_of_the_root_seed_s_has_the_seed_s_million_and_k():
    assert list(seeds_from(0, 3)) == [0, 1, 2]
    assert list(seeds_from(7, 3)) == [7_000_000, 7_000_001, 7_000_002]
    assert list(seeds_from(7, 0)) == []
    assert seeds_from(2, 1_000_000)[-1] < seeds_from(3, 1)[0]


@pytest.mark.slow
@given(
    st.lists(st.tuples(st.integers(0, 2**70), st.integers(1, 1_000_000)), min_size=2, unique_by=lambda each: each[0])
)
def test_two_root_seeds_share_no_run(batches):
    """Control: with the seeds s + k, the root seeds 0 and 1 share 29 of 30."""
    ranges = sorted((seeds_from(*each) for each in batches), key=lambda each: each[0])
    assert all(one[-1] < other[0] for one, other in pairwise(ranges))
    assert len({*range(30)} & {*range(1, 31)}) == 29


@pytest.mark.parametrize(("seed", "runs"), [(0, 1_000_001), (-1, 1)])
def test_a_root_seed_without_such_a_run_is_refused(seed, runs):
    with pytest.raises(ValueError, match="seed"):
        seeds_from(seed, runs)


@pytest.mark.slow
def test_each_task_is_run_with_its_own_scenario_and_seed_in_the_order_given():
    tasks = [(SMALL, 5), (LONGER, 2), (SMALL, 2), (SMALL, 5)]
    assert run_many(tasks, jobs=1) == [summary(run(*task)) for task in tasks]


def test_measured_values_are_returned():
    tasks = [(SMALL, seed) for seed in range(3)]
    assert run_many(tasks, jobs=1, measure=active_time) == [active_time(run(*task)) for task in tasks]


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(("jobs", "count"), [(2, 1), (2, 60), (0, 3)])
def test_the_number_of_workers_changes_neither_order_nor_value(jobs, count):
    """60 tasks on two workers go out in chunks of more than one, and long runs come back after short ones."""
    tasks = [(LONGER if seed < 2 else SMALL, seed) for seed in range(count)]
    assert run_many(tasks, jobs) == run_many(tasks, jobs=1)


@pytest.mark.slow
def test_the_work_is_done_in_other_processes_and_that_of_one_job_in_this():
    tasks = [(SMALL, seed) for seed in range(4)]
    assert set(run_many(tasks, jobs=1, measure=lambda _: os.getpid())) == {os.getpid()}
    others = set(run_many(tasks, jobs=2, measure=lambda _: os.getpid()))
    assert os.getpid() not in others
    assert 1 <= len(others) <= 2


@pytest.mark.parametrize("jobs", [0, 1, 2])
def test_no_tasks_have_no_results(jobs):
    assert run_many([], jobs) == []


@pytest.mark.slow
@pytest.mark.parametrize("with_dask", [False, True])
def test_an_exception_of_a_run_is_raised(with_dask):
    """Also once Dask has exceptions pickled with their tracebacks, which hold more than can be pickled."""
    if with_dask:
        pytest.importorskip("tblib.pickling_support").install(BrokenRunError)
    with pytest.raises(BrokenRunError, match="pursuer 0"):
        run_many([(SMALL, 0), (BROKEN, 1), (SMALL, 2)], jobs=1)


@pytest.mark.whole
def test_an_exception_of_a_run_in_a_worker_is_raised_here_and_the_next_batch_runs():
    tasks = [(SMALL, seed) for seed in range(4)]
    with pytest.raises(BrokenRunError, match="pursuer 0"):
        run_many([*tasks, (BROKEN, 1)], jobs=2)
    assert run_many(tasks, jobs=2) == run_many(tasks, jobs=1)


def test_an_exception_of_a_measure_is_raised():
    def divide(_):
        return 1 / 0

    with pytest.raises(ZeroDivisionError):
        run_many([(SMALL, 0)], jobs=1, measure=divide)


def test_no_bar_is_drawn_where_there_is_no_terminal(capfd):
    run_many([(SMALL, 0), (SMALL, 1)], jobs=1)
    assert capfd.readouterr() == ("", "")

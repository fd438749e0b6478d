"""What a user may hold can be pickled and copied, and holds no simulation in memory."""

import copy
import gc
import multiprocessing
import pickle
import subprocess
import sys
import weakref
from itertools import cycle

import numpy as np
import pytest

import desim
from desim import Evader, Links, Scenario, Team, load, run, summary, sweep
from desim.config.fresh import StateError
from desim.config.shared_state import StateWarning
from desim.kernel.core.clock import Clock
from desim.kernel.core.events import Trace
from desim.kernel.core.trace_file import line_of
from desim.results import run_folder
from desim.scenario.overrides import ScenarioError
from desim.simulation.watchdog import TimedOut, within
from desim.study.store.run_table import Column
from scenarios.studies.study import SCENARIOS

FILES = sorted(file.name for file in SCENARIOS.glob("*.toml"))


def circling(state, rng):
    return 1j


def chase(me):
    yield me.sleep(0.1)
    me.assign(True)


def test_a_pickle_of_an_older_version_has_the_defaults_of_new_keys():
    scenario, expected = (small(network=Links(latency=0.1)) for _ in range(2))
    del scenario.__dict__["wall"], scenario.network.__dict__["coherence"]
    restored = pickle.loads(pickle.dumps(scenario))
    assert restored == expected
    assert summary(run(restored, 1)) == summary(run(expected, 1))


def test_a_pickle_with_a_key_that_is_gone_is_refused():
    scenario = small()
    scenario.__dict__["reckoning"] = "cheap"
    with pytest.raises(ValueError, match="a Scenario cannot be unpickled: it has no key reckoning any more"):
        pickle.loads(pickle.dumps(scenario))


def test_columns_of_a_pickled_sweep_have_the_attributes_of_older_versions():
    """Slots have no defaults: with another name for one of them, a pickle of an older version could not be read."""
    _, slots = Column([1, {}]).__reduce_ex__(5)[2]
    assert sorted(slots) == ["_kinds", "_numbers", "_places", "_texts"]


def small(**changes):
    return Scenario(**({"team": Team(count=3), "horizon": 0.3} | changes))


def lines(result):
    return "".join(map(line_of, result.trace))


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize(
    ("file", "copied"),
    [*zip(FILES, cycle([copy.deepcopy, lambda held: pickle.loads(pickle.dumps(held))]), strict=False)],
)
def test_a_result_of_any_scenario_can_be_copied(file, copied):
    """By pickle and by deepcopy in turn: both ask the same objects what they consist of."""
    result = run(load(SCENARIOS / file, ["horizon=0.05", "record.messages=true"]), 3)
    again = copied(result)
    assert lines(again) == lines(result)
    assert again.scenario == result.scenario
    assert summary(again) == summary(result)
    assert str(again) == str(result)


def copies_of(held):
    """Return what pickle and deepcopy make of an object."""
    return [pickle.loads(pickle.dumps(held)), copy.deepcopy(held)]


def held_by_users():
    """Yield each kind of object that a public function returns, or that it raises."""
    result = run(small(protocol=chase, evader=Evader(strategy=circling)), 1)
    swept = sweep(small(), {"team.count": [2, 3]}, reps=2)
    yield from (result, result.trace, result.scenario, summary(result), desim.replay(result), swept)
    yield from (swept.estimates("end_time"), desim.explain(small(network={"latency": 0.1}), runs=2), desim.examples())
    for broken in (
        lambda: Scenario(team=-1),
        lambda: load("nowhere.toml"),
        lambda: load(SCENARIOS / "relay.toml", ["x=1"]),
    ):
        with pytest.raises((ValueError, OSError)) as caught:
            broken()
        yield caught.value
    with pytest.raises(TimedOut) as late, within(0.01):
        run(small(horizon=1e6, evader=Evader(speed=9.0), team=Team(count=3, speeds=1.0)))
    yield from (late.value, ScenarioError("text"), StateError("text"), StateWarning("text"))


def test_a_time_limit_that_is_caught_inside_its_block_can_be_pickled():
    with pytest.raises(TimedOut, match="too late"), within(0.01), pytest.raises(TimedOut) as inner:  # noqa: PT012
        while True:
            pass
    assert [(type(again), str(again)) for again in copies_of(inner.value)] == [(TimedOut, str(inner.value))] * 2


@pytest.mark.slow
def test_a_run_that_is_read_from_its_folder_can_be_copied(tmp_path):
    """Its messages have bodies of types that are made when it is read."""
    run_folder.write(
        run(small(record={"messages": True}, announce={"dissemination": "gossip"}), 1), tmp_path, drawn=False
    )
    result = run_folder.read(tmp_path)
    for again in copies_of(result):
        assert lines(again) == lines(result)
        assert [*map(repr, again.trace)] == [*map(repr, result.trace)]


@pytest.mark.slow
def test_all_that_a_user_may_hold_can_be_pickled_and_copied():
    for held in held_by_users():
        for again in copies_of(held):
            assert type(again) is type(held)
            assert str(again) == str(held) or not isinstance(held, BaseException)


POOL = """
from multiprocessing import get_context
from desim import Scenario, run
from desim.kernel.core.trace_file import line_of
if __name__ == "__main__":
    scenario = Scenario(team={"count": 3}, horizon=0.3)
    with get_context("METHOD").Pool(2) as pool:
        results = pool.starmap(run, [(scenario, seed) for seed in range(3)])
    there, here = ([[*map(line_of, result.trace)] for result in made] for made in (
        results, [run(scenario, seed) for seed in range(3)]
    ))
    assert there == here
"""


@pytest.mark.whole
@pytest.mark.parametrize("method", multiprocessing.get_all_start_methods())
def test_a_pool_of_multiprocessing_performs_runs(method):
    """In a process of its own: a test has threads, from which no process should be forked."""
    subprocess.run([sys.executable, "-c", POOL.replace("METHOD", method)], check=True, timeout=120)


@pytest.mark.slow
@pytest.mark.parametrize("raises", [False, True])
def test_a_result_holds_no_simulation(monkeypatch, raises):
    """Neither do the traces that are left of a run that raised."""
    clocks, begin = [], Clock.__init__
    monkeypatch.setattr(Clock, "__init__", lambda self: clocks.append(weakref.ref(self)) or begin(self))
    traces = []
    start = Trace.__init__
    monkeypatch.setattr(
        Trace, "__init__", lambda self, *args, **kinds: traces.append(self) or start(self, *args, **kinds)
    )

    def stop(event):
        if raises and event.t > 0:
            raise LookupError

    try:
        run(small(), 1, stop)
    except LookupError:
        assert raises
    gc.collect()
    assert len(clocks) == len(traces) == 1
    assert clocks[0]() is None
    assert len(traces[0]) > 1


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(("count", "size"), [(200, 0.15e6), (1000, 0.6e6)])
def test_a_result_takes_no_more_memory_than_its_events(count, size):
    result = run(Scenario(team=Team(count=count), network={"range": 5.0}, horizon=1.0, record={"trajectory": 0.0}), 1)
    assert len(pickle.dumps(result)) < size
    assert np.isfinite(summary(result).end_time)


EXECUTED = """
import numpy as np
from desim import Links, Scenario, Team

def protocol(me):
    me.assign(1)
    yield me.sleep(9.0)

class Late:
    def __call__(self, context, rng):
        return np.full(len(context.dst), 0.1)

scenario = Scenario(team=Team(count=2), horizon=0.2, protocol=protocol, network=Links(latency=Late()))
"""


@pytest.mark.slow
@pytest.mark.parametrize("names", [{}, {"__name__": None}, {"__name__": 3}, {"__name__": "<cell>"}], ids=repr)
def test_code_without_a_module_can_be_swept_and_recorded(tmp_path, names):
    """Code that `exec` runs has the module that its dict names, often none."""
    places = dict(names)
    exec(EXECUTED, places)
    scenario = places["scenario"]
    assert scenario.model_dump(mode="json")["protocol"]["kind"].endswith(":protocol")
    result = sweep(scenario, {"team.count": [2, 3]}, reps=1, store=tmp_path / "sweep.sqlite")
    assert len(result.to_frame()) == 2
    run_folder.write(run(scenario, 1), tmp_path / "run")

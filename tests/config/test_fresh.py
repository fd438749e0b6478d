"""Fresh copies: what a run may remember is copied at its start, in every field of every model that holds an object."""

import csv
import enum
import functools
import importlib
import io
import itertools
import os
import pkgutil
import queue
import random
import re
import struct
import sys
import threading
import weakref
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextvars import ContextVar
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, ClassVar
from warnings import catch_warnings, simplefilter

import networkx
import numpy as np
import pytest
from pydantic import BaseModel, validate_call

import desim
import protocols
from desim import Evader, Scenario, Team, run, summary, sweep
from desim.analysis.metrics import Metric
from desim.config import copier
from desim.config.choice import choices_of
from desim.config.code_variables import shared_queues
from desim.config.fresh import Remembered, StateError, _snapshot, fresh_copy
from desim.config.shared_state import StateWarning, _cached
from desim.kernel.models.graphs import Ring
from desim.kernel.models.links import Links
from desim.scenario.checks import warnings
from desim.scenario.scenario import Motion
from desim.study.workers.batch import run_many
from desim.study.workers.workers import Workers


class Remembering:
    """An object that remembers how often it was called."""

    def __init__(self):
        self.calls = 0

    def __call__(self, *_):
        self.calls += 1
        return self.calls

    def turn(self, *_):
        return self()


def models():
    """Return all models of desim and protocols."""
    for package in (desim, protocols):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            for item in vars(importlib.import_module(module.name)).values():
                if isinstance(item, type) and issubclass(item, BaseModel) and item.__module__ == module.name:
                    yield item


FIELDS = [(model, name) for model in models() for name, field in model.model_fields.items() if choices_of(field)]


@pytest.mark.parametrize(("model", "name"), FIELDS, ids=lambda item: getattr(item, "__name__", item))
def test_an_object_with_state_in_any_field_is_copied_alone_and_in_a_list(model, name):
    held = Remembering()
    for value in (held, (held, held), functools.partial(held), held.turn):
        whole = model.model_construct(**{name: value})
        with fresh_copy({"table": whole}) as copied:
            inner = getattr(copied["table"], name)
            for item in inner if isinstance(inner, tuple) else [inner]:
                item()
            assert not isinstance(inner, tuple) or inner[0] is inner[1]
        assert held.calls == 0
        assert getattr(whole, name) is value


def test_there_are_families_enough():
    assert len(FIELDS) > 30


def nonlocal_counter():
    calls = 0

    def count():
        nonlocal calls
        calls += 1
        return calls

    return count


def recursive():
    calls = 0

    def count(*, again=True):
        nonlocal calls
        calls += 1
        return count(again=False) if again else calls

    return count


def over(value, read):
    return lambda: read(value)


def with_attribute():
    def count():
        count.calls += 1
        return count.calls

    count.calls = 0
    return count


def sharing():
    """Return two functions in one: the first counts, the second tells."""
    calls = 0

    def count():
        nonlocal calls
        calls += 1

    def tell():
        return calls

    return lambda: (count(), tell())


class Slots:
    __slots__ = ("calls",)

    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return self.calls


class Drawing:
    def __init__(self):
        self.rng = np.random.default_rng(1)

    def __call__(self):
        return self.rng.random()


class Model(BaseModel):
    _calls: int = 0

    def __call__(self):
        self._calls += 1
        return self._calls


class Weak:
    """Remembers something of an object for as long as that exists."""

    def __init__(self):
        self.key = Remembering()
        self.calls = weakref.WeakKeyDictionary({self.key: 0})

    def __call__(self):
        self.calls[self.key] += 1
        return self.calls[self.key]


class Passing:
    """Passes on what it lacks from an object, also `__setstate__` while it is made anew, if it is asked."""

    def __init__(self, inner):
        self.inner = inner

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def __call__(self, *given):
        return self.inner(*given)


class PassingSlots:
    __slots__ = ("inner",)
    __init__, __getattr__, __call__ = Passing.__init__, Passing.__getattr__, Passing.__call__


def unbound(held):
    """Return a function that reads a variable which is deleted."""
    late = None

    def act():
        try:
            return late
        except NameError:
            return held()

    del late
    return act


STATEFUL = {
    "wrapper that passes on attributes": lambda: Passing(Remembering()),
    "wrapper with slots": lambda: PassingSlots(Remembering()),
    "weak keys": Weak,
    "instance": Remembering,
    "method": lambda: Remembering().turn,
    "partial": lambda: functools.partial(Remembering()),
    "partial over a closure": lambda: functools.partial(nonlocal_counter()),
    "nonlocal": nonlocal_counter,
    "recursive": recursive,
    "closure over an instance": lambda: over(Remembering(), lambda held: held()),
    "closure over a generator of numbers": lambda: over(np.random.default_rng(1), lambda rng: rng.random()),
    "method of a generator of numbers": lambda: np.random.default_rng(1).random,
    "closure over a name without a value": lambda: unbound(Remembering()),
    "closure over an iterator": lambda: over(iter([1, 2, 3]), next),
    "attribute of a local function": with_attribute,
    "two closures": sharing,
    "cache": lambda: functools.lru_cache(nonlocal_counter()),
    "slots": Slots,
    "numpy": Drawing,
    "pydantic": Model,
}


@pytest.mark.parametrize("make", STATEFUL.values(), ids=STATEFUL)
def test_every_copy_starts_from_the_state_of_the_caller(make):
    held = Scenario.model_construct(protocol=make())
    found = []
    for _ in range(2):
        with fresh_copy(held) as copied:
            found.append([copied.protocol(), copied.protocol()])
    assert found[0] == found[1]
    assert found[0][0] == held.protocol()


def generator():
    yield 1


@pytest.mark.parametrize(
    "held", [generator(), itertools.count(), itertools.cycle([1]), open], ids=lambda held: type(held).__name__
)
def test_an_object_that_cannot_be_copied_is_refused_with_its_key(held, tmp_path):
    (tmp_path / "table").write_text("1\n")
    opened = held(tmp_path / "table") if held is open else held
    scenario = Scenario(evader=Evader(strategy=lambda state, rng: next(opened)))
    with pytest.raises(StateError, match=r"^evader.strategy: <lambda> may remember something.*cannot pickle"):
        run(scenario)
    if held is open:
        opened.close()


class Created:
    """An object that pickle writes, and cannot create again, because its class needs an argument."""

    def __new__(cls, number):
        return super().__new__(cls)

    def __call__(self, state, rng):
        return 1j


def test_an_object_whose_copy_cannot_be_created_is_refused_with_its_key():
    with pytest.raises(StateError, match=r"^evader.strategy: Created may remember something.*missing 1 required"):
        run(brief(Created(1)))


OUTPUTS = {
    "a text": io.StringIO,
    "bytes": io.BytesIO,
    "a file": functools.partial(Path(os.devnull).open, "w"),
    "a binary file": functools.partial(Path(os.devnull).open, "wb"),
    "stdout": lambda: sys.stdout,
    "csv": lambda: csv.writer(io.StringIO()),
}


def written_by(stream, how):
    """Return a strategy that writes to a stream, which it has as a variable, a default, an attribute or an argument."""

    def write(stream):
        if hasattr(stream, "writerow"):
            stream.writerow([1])
        else:
            stream.write("x" if isinstance(stream, io.TextIOBase) else b"x")
        return 1j

    def defaulting(state, rng, stream=stream):
        return write(stream)

    class Writing:
        def __init__(self):
            self.stream = stream

        def __call__(self, state, rng):
            return write(self.stream)

    return {
        "variable": lambda state, rng: write(stream),
        "global": lambda state, rng: write(OUTPUT[0]),
        "default": defaulting,
        "attribute": Writing(),
        "argument": functools.partial(lambda stream, state, rng: write(stream), stream),
    }[how]


OUTPUT = {0: None}


@pytest.mark.parametrize("how", ["variable", "global", "default", "attribute", "argument"])
@pytest.mark.parametrize("make", OUTPUTS.values(), ids=OUTPUTS)
def test_a_stream_to_which_a_model_writes_reports_to_the_caller(make, how, monkeypatch):
    stream = make()
    monkeypatch.setitem(OUTPUT, 0, stream)
    lengths = []
    for _ in range(3):  # a warning is an error
        run(brief(written_by(stream, how)), 1)
        lengths.append(len(stream.getvalue()) if hasattr(stream, "getvalue") else 0)
    if lengths[0] or isinstance(stream, io.BytesIO | io.StringIO):
        assert lengths == [lengths[0], 2 * lengths[0], 3 * lengths[0]] > [0, 0, 0]
    if stream is not sys.stdout and hasattr(stream, "close"):
        stream.close()


def test_a_text_that_a_model_reads_is_copied():
    lines = io.StringIO("1.0\n0.5\n")
    scenario = brief(lambda state, rng: 1j * float(lines.readline() or 0.25))
    assert run(scenario, 1).trace.events == run(scenario, 1).trace.events
    assert lines.tell() == 0


@pytest.mark.parametrize(
    "constant", [struct.Struct("<d"), re.match("1", "1"), ContextVar("held"), np.frompyfunc(abs, 1, 1)], ids=type
)
def test_what_never_changes_and_cannot_be_pickled_is_shared(constant):
    held = Scenario.model_construct(protocol=functools.partial(int, constant))
    with fresh_copy(held) as copied:
        assert copied.protocol.args[0] is constant


def idle(me):
    yield me.sleep(1.0)


def test_built_in_models_and_plain_functions_are_not_copied():
    scenario = Scenario(protocol=idle, network=Links(graph=Ring()))
    with fresh_copy(scenario) as copied:
        assert copied is scenario
    constants = np.zeros(3)
    constants.setflags(write=False)
    scenario = Scenario.model_construct(protocol=functools.partial(max, constants), network=Links(graph=Ring()))
    with fresh_copy(scenario) as copied:
        assert copied is not scenario
        assert copied.network is scenario.network
        assert copied.protocol.args[0] is constants


# Runs.


def up_then_down(calls):
    return 1j if calls < 100 else -1j


class Strategy(Remembering):
    def __call__(self, state, rng):
        return up_then_down(super().__call__())

    def direct(self, state, rng):
        return self(state, rng)


def counting():
    calls = 0

    def strategy(state, rng):
        nonlocal calls
        calls += 1
        return up_then_down(calls)

    return strategy


def in_a_list():
    calls = [0]

    def strategy(state, rng):
        calls[0] += 1
        return up_then_down(calls[0])

    return strategy


STRATEGIES = {
    "instance": Strategy,
    "method": lambda: Strategy().direct,
    "partial": lambda: functools.partial(Strategy()),
    "nonlocal": counting,
    "wrapper": lambda: Passing(Strategy()),
    "nested": lambda: {"kind": "listener", "during_handover": Strategy(), "normally": Strategy()},
}


def game(strategy):
    return Scenario(team=Team(count=3, speeds=2.0), evader=Evader(strategy=strategy), horizon=3.0)


class Growing(Remembering):
    """A latency, s, that is greater at each call."""

    def __call__(self, context, rng):
        return 0.01 * super().__call__()


@pytest.mark.slow
def test_a_second_summary_equals_the_first_and_the_object_of_the_caller_stays_as_it_was():
    latency = Growing()
    result = run(Scenario(team=Team(count=3), network=Links(latency=latency), horizon=0.5), 1)
    assert summary(result) == summary(result)
    assert latency.calls == 0


@pytest.mark.parametrize("module", ["queueing", "pathlib2", "threading_models", "desim_models", "protocols2"])
def test_an_object_of_a_module_with_a_name_like_that_of_another_one_is_copied(module):
    model = type("Model", (Remembering,), {"__module__": module})()
    with fresh_copy({"table": model}, with_collections=True) as copied:
        assert copied["table"] is not model


@pytest.mark.slow_but_one
@pytest.mark.parametrize("make", STRATEGIES.values(), ids=STRATEGIES)
def test_a_second_run_equals_the_first_and_the_object_of_the_caller_stays_as_it_was(make):
    scenario = game(make())
    first, second = run(scenario, 1), run(scenario, 1)
    assert first.trace.events == second.trace.events
    assert first.scenario is scenario


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("make", [*STRATEGIES.values(), in_a_list])
def test_runs_are_equal_whoever_performs_them(make):
    tasks = [(game(make()), seed) for seed in (1, 1, 2)]
    shared = [(tasks[0][0], seed) for _, seed in tasks]
    measured = run_many(shared, jobs=1)
    assert measured == run_many(shared, jobs=2) == run_many(tasks, jobs=1)
    assert measured[0] == measured[1]


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(
    ("pool", "name"),
    # Each way to remember is tried in processes above.
    [(pool, name) for pool in (ThreadPoolExecutor, ProcessPoolExecutor) for name in ("instance", "nonlocal")],
)
def test_runs_of_the_executor_of_a_caller_start_from_the_state_of_the_caller(pool, name):
    def frame(executor):
        swept = sweep(game(STRATEGIES[name]()), {"team.count": [3]}, reps=2, executor=executor)
        return [[(cell.mean, cell.count) for cell in swept.estimates(name)] for name in ("end_time", "energy")]

    with pool(2) as executor:
        assert frame(executor) == frame(1)


@pytest.mark.whole
def test_a_sweep_in_processes_warns_of_state_as_one_in_this_process_does(monkeypatch):
    monkeypatch.setattr(Workers, "batch_time", 1e9)  # several runs in a batch, however slow this machine is
    monkeypatch.setitem(globals(), "CALLS", 0)  # and set back for other tests, which are not warned of it then
    for executor in (1, 2):
        with pytest.warns(StateWarning, match=rf"^{__name__}\.CALLS: an earlier run has changed it") as caught:
            sweep(brief(global_counter), {"team.count": [2]}, reps=20, executor=executor)
        assert len(caught) == 1


REPORTED = []


def reporting(state, rng):
    REPORTED.append(state)
    return 1j


@pytest.mark.slow
def test_a_function_may_report_to_its_caller_as_often_as_it_is_run():
    seen = []
    scenario = game(lambda state, rng: seen.append(state) or 1j)
    for _ in range(2):
        run(scenario, 1)
        run(game(reporting), 1)
    assert len(REPORTED) == len(seen) > 100


def test_a_function_with_a_memory_may_report_by_a_method_of_a_list():
    def reporting_steps(note):
        steps = 0

        def strategy(state, rng):
            nonlocal steps
            steps += 1
            note(steps)
            return 1j

        return strategy

    seen = []
    strategy = reporting_steps(seen.append)
    for _ in range(2):
        run(game(strategy), 1)
    assert len(seen) > 100
    assert seen == [*range(1, len(seen) // 2 + 1)] * 2


def test_a_function_may_report_what_cannot_be_copied():
    """The metrics of a run copy its models, with what they have reported if that is possible."""
    seen = []

    def strategy(state, rng):
        seen.append(number for number in range(3))
        return 1j

    for _ in range(2):
        summary(run(brief(strategy), 1))
    assert next(seen[-1]) == 0


def test_a_caller_may_change_what_a_function_reads_between_runs():
    speed = [1.0]
    scenario = game(lambda state, rng: 1j * speed[0])
    first = run(scenario, 1)
    speed[0] = 0.5
    assert run(scenario, 1).trace.events != first.trace.events


class Counter:
    calls = 0

    def __call__(self, state, rng):
        Counter.calls += 1
        return 1j


class Tally:
    calls = 0

    def __call__(self, state, rng):
        Tally.calls += 1
        return 1j


def global_counter(state, rng):
    global CALLS
    CALLS += 1
    return 1j


CALLS = 0


def attributed(state, rng):
    attributed.calls += 1
    return 1j


attributed.calls = 0


def in_a_default(state, rng, calls=[0]):  # noqa: B006
    calls[0] += 1
    return 1j


def in_a_keyword(state, rng, *, calls=[0]):  # noqa: B006
    calls[0] += 1
    return 1j


MEMORY = {"calls": 0}
DRAWS = np.random.default_rng(1)
HELD = Remembering()
LATENCY = Remembering()


def in_a_global_collection(state, rng):
    MEMORY["calls"] += 1
    return 1j


def drawing(state, rng):
    return 1j ** (lambda: DRAWS.random())()


def calling(state, rng):
    return 1j * np.sign(HELD())


SEEN = []


def rereading(state, rng):
    SEEN.append(state)
    return 1j * min(len(SEEN), 1)


def creating(state, rng):
    creating.calls = getattr(creating, "calls", 0) + 1
    return 1j


def counting(state, rng):
    next(NUMBERS)
    return 1j


NUMBERS = itertools.count()
HEADINGS = (heading for heading in itertools.repeat(1j))


class Store:
    calls = 0


def in_another_class(state, rng):
    Store.calls += 1
    return 1j


def helped(state, rng):
    return 1j * count_up()


def count_up():
    global CALLED
    CALLED += 1
    return 1


CALLED = 0


def generating(state, rng):
    return next(HEADINGS)


# State that is found by text, in descriptors, tables and caches, or that cannot be copied.

STATE = ModuleType("state_of_a_user")
STATE.calls = STATE.other = 0
STATE.seen = [0]
CYCLE = itertools.cycle([1j, -1j])
CHAIN = itertools.chain([1j], itertools.repeat(-1j))
SLICE = itertools.islice(itertools.count(), 10**6)
MAPPED = map(float, range(10**6))
BY_TEXT = BY_CODE = BY_MODULE = 0
IN_PROPERTY, IN_CACHED_PROPERTY, IN_STATIC, DISPATCHED = [0], [0], [0], [0]
CONTEXT = ContextVar("CONTEXT", default=0)
THREAD = threading.local()
THREAD.calls = 0
QUEUE = queue.Queue()
GRAPH = networkx.path_graph(2)
STEP = Remembering().turn
PART = functools.partial(Remembering())


class Total:
    """A descriptor that keeps one number for all instances."""

    def __init__(self):
        self.value = 0

    def __get__(self, owner, kind=None):
        return self.value

    def __set__(self, owner, value):
        self.value = value


class WithDescriptor:
    calls = Total()

    def __call__(self, state, rng):
        self.calls += 1
        return 1j


class WithProperty:
    @property
    def calls(self):
        IN_PROPERTY[0] += 1
        return IN_PROPERTY[0]

    def __call__(self, state, rng):
        return 1j * np.sign(self.calls)


class WithCachedProperty:
    @functools.cached_property
    def calls(self):
        IN_CACHED_PROPERTY[0] += 1
        return IN_CACHED_PROPERTY[0]

    def __call__(self, state, rng):
        return 1j * np.sign(self.calls)


class WithStatic:
    @staticmethod
    def count():
        IN_STATIC[0] += 1
        return IN_STATIC[0]

    @classmethod
    def sign(cls):
        return np.sign(cls.count())

    def __call__(self, state, rng):
        return 1j * self.sign()


class Meta(type):
    calls = 0


class WithMeta(metaclass=Meta):
    def __call__(self, state, rng):
        Meta.calls += 1
        return 1j


class Holding:
    """An object with something that cannot be copied."""

    def __init__(self):
        self.numbers = (number for number in itertools.count())
        self.call = lambda: next(self.numbers)


HOLDING = Holding()


def counted(function):
    calls = 0

    @functools.wraps(function)
    def counting():
        nonlocal calls
        calls += 1
        return function(calls)

    return counting


@counted
def decorated(calls):
    return calls


@functools.cache
def memory():
    return {"calls": 0}


@functools.lru_cache(maxsize=2)
def bounded_memory(number):
    return [number]


@functools.singledispatch
def dispatched(number):
    DISPATCHED[0] += 1
    return DISPATCHED[0]


@functools.cache
def table(number):
    return [1j] * number


def by_text():
    globals()["BY_TEXT"] += 1


def by_code():
    exec("BY_CODE += 1", globals())


def by_module():
    sys.modules[__name__].BY_MODULE += 1


def in_a_module():
    STATE.calls += 1


def by_name_in_a_module():
    setattr(STATE, "other", STATE.other + 1)  # noqa: B010


def in_an_imported_module():
    from state_of_a_user import seen

    seen[0] += 1


def in_a_cache():
    memory()["calls"] += 1


def in_a_bounded_cache():
    bounded_memory(1)[0] += 1


def in_a_context():
    CONTEXT.set(CONTEXT.get() + 1)


def in_a_thread():
    THREAD.calls += 1


def in_a_queue():
    QUEUE.put(0)
    return QUEUE.qsize()


def in_a_graph():
    GRAPH.nodes[0]["calls"] = GRAPH.nodes[0].get("calls", 0) + 1


TABLE = {"a": {"b": lambda: next(IN_TABLE)}}
IN_TABLE = itertools.count()


def doing(act):
    """Return a strategy that acts at each step and flies up."""

    def strategy(state, rng):
        act()
        return 1j

    return strategy


@functools.lru_cache
def numbered(number):
    numbered.calls = getattr(numbered, "calls", 0) + 1
    return numbered.calls


HIDDEN = {
    "numbered.calls": lambda: numbered(object()),
    "CYCLE": lambda: next(CYCLE),
    "CHAIN": lambda: next(CHAIN),
    "SLICE": lambda: next(SLICE),
    "MAPPED": lambda: next(MAPPED),
    "BY_TEXT": by_text,
    "BY_CODE": by_code,
    "BY_MODULE": by_module,
    "state_of_a_user.calls": in_a_module,
    "state_of_a_user.other": by_name_in_a_module,
    "state_of_a_user.seen": in_an_imported_module,
    "memory": in_a_cache,
    "bounded_memory": in_a_bounded_cache,
    "CONTEXT": in_a_context,
    "THREAD": in_a_thread,
    "QUEUE": in_a_queue,
    "GRAPH": in_a_graph,
    "STEP": lambda: STEP(),
    "PART": lambda: PART(),
    "IN_TABLE": lambda: TABLE["a"]["b"](),
    "HOLDING": lambda: HOLDING.call(),
    "calls of decorated": lambda: decorated(),
    "DISPATCHED": lambda: dispatched(1),
    "WithDescriptor.calls": WithDescriptor(),
    "IN_PROPERTY": WithProperty(),
    "IN_CACHED_PROPERTY": WithCachedProperty(),
    "IN_STATIC": WithStatic(),
    "Meta.calls": WithMeta(),
}


def brief(strategy):
    return Scenario(team=Team(count=2), evader=Evader(strategy=strategy), horizon=0.1)


@pytest.mark.parametrize(("name", "act"), HIDDEN.items(), ids=HIDDEN)
def test_hidden_state_is_warned_of(name, act, monkeypatch):
    monkeypatch.setitem(sys.modules, "state_of_a_user", STATE)
    scenario = brief(doing(act) if isinstance(act, FunctionType) else act)
    with catch_warnings(record=True) as caught:
        simplefilter("always")
        for _ in range(2):
            run(scenario, 1)
    texts = [str(warning.message) for warning in caught if warning.category is StateWarning]
    assert len(texts) == 1
    assert re.search(
        rf"\b{re.escape(name)}\b.*: (an earlier run has changed it|the run has changed what its cache)", texts[0]
    )


def test_a_memo_and_a_report_are_not_warned_of():
    """A cache of a function that always returns the same, and a queue into which the run only puts."""
    seen = queue.Queue()

    def strategy(state, rng):
        seen.put(state.stamp)
        return table(3)[0]

    scenario = brief(strategy)
    for _ in range(3):
        run(scenario, 1)
    assert seen.qsize() > 0


class Delayed:
    """An object whose headings are what its queue has."""

    def __init__(self, kind):
        self.queue = kind()
        for _ in range(1000):
            self.queue.put(1)

    def __call__(self, state, rng):
        return 1j * self.queue.get()


class Told:
    """An object that tells its caller by its queue."""

    def __init__(self, kind):
        self.queue = kind()
        self.headings = {"east": 1.0}

    def __call__(self, state, rng):
        self.queue.put(state.stamp)
        return 1j * self.headings.get("north", 1.0)


@pytest.mark.parametrize(
    ("is_read", "function"),
    [
        (True, lambda items: items.get()),
        (True, lambda items: items.get(False)),
        (True, lambda items: items.get(timeout=1.0)),
        (True, lambda items: [1 for _ in range(3) if not items.empty()]),
        (False, lambda items: items.put(1)),
        (False, lambda items: items.get("a")),
        (False, lambda items: items.get(0, None)),
    ],
)
def test_code_that_reads_a_queue_is_told_from_code_that_looks_up_a_key(is_read, function):
    items = queue.Queue()
    assert len([*shared_queues([items], [function])]) == is_read


@pytest.mark.parametrize("kind", [queue.Queue, queue.SimpleQueue, queue.PriorityQueue])
def test_a_queue_of_an_object_is_warned_of_if_the_run_reads_it(kind):
    """Runs share it, because threads do."""
    for model, is_read in ((Delayed(kind), True), (Told(kind), False)):
        with catch_warnings(record=True) as caught:
            simplefilter("always")
            for _ in range(2):
                run(brief(model), 1)
        texts = [str(warning.message) for warning in caught if warning.category is StateWarning]
        assert [f"a {kind.__name__} that a model holds" in text for text in texts] == [True] * is_read


class Computing:
    """An object that computes a table when it is first read, and a generator that is drawn from."""

    @functools.cached_property
    def table(self):
        return [1j]

    @functools.cached_property
    def generator(self):
        return np.random.default_rng(1)

    @functools.cached_property
    def itself(self):
        return self


COMPUTING, DRAWING, REMEMBERING = Computing(), Computing(), Computing()
READ_GRAPH = networkx.path_graph(3)
READS = {
    "a cached property": lambda: COMPUTING.table[0],
    "nodes": lambda: READ_GRAPH.nodes[1],
    "neighbours": lambda: READ_GRAPH.adj[1],
    "degrees": lambda: READ_GRAPH.degree[1],
    "edges": lambda: READ_GRAPH.edges[0, 1],
}


@pytest.mark.parametrize("read", READS.values(), ids=READS)
def test_what_an_object_computes_when_it_is_read_is_not_warned_of(read):
    for _ in range(3):  # a warning is an error
        run(brief(doing(read)), 1)


def test_a_function_that_pydantic_validates_is_a_model():
    @validate_call
    def strategy(state: Any, rng: Any) -> complex:
        return 1j

    for _ in range(2):
        assert run(brief(strategy), 1).trace.events == run(brief(lambda state, rng: 1j), 1).trace.events


def test_what_runs_change_in_a_cached_property_is_warned_of():
    """The first run computes it: only changes that later runs make are told from that."""
    scenario = brief(doing(lambda: REMEMBERING.table.append(len(REMEMBERING.table))))
    run(scenario, 1)
    run(scenario, 1)
    with pytest.warns(StateWarning, match=r"\.REMEMBERING: an earlier run has changed it"):
        run(scenario, 1)


def test_a_cached_property_may_refer_to_its_object():
    for _ in range(3):  # a warning is an error
        run(brief(doing(lambda: COMPUTING.itself.table)), 1)


def test_a_generator_in_a_cached_property_is_warned_of():
    scenario = brief(lambda state, rng: 1j * DRAWING.generator.uniform())
    run(scenario, 1)
    with pytest.warns(StateWarning, match=r"\.DRAWING: an earlier run has changed it"):
        run(scenario, 1)


class Compiled(type):
    """The type of a class whose module is no text, as that of a class that Cython has compiled."""

    @property
    def __module__(cls):
        return "compiled"


class Steering(metaclass=Compiled):
    def __call__(self, state, rng):
        return 1j if isinstance(Steering, Compiled) else -1j


def test_the_module_of_a_class_need_not_be_a_text():
    assert not isinstance(Compiled.__module__, str)
    for strategy in (Steering(), lambda state, rng: Steering()(state, rng), functools.partial(Steering())):
        for _ in range(2):
            run(brief(strategy), 1)


@pytest.mark.parametrize("folder", ["site-packages", "dist-packages"])
def test_state_of_an_installed_package_is_a_matter_of_its_authors(folder, monkeypatch):
    """Also of one of Debian, Ubuntu or ROS, whose packages are in the folder dist-packages."""
    library = ModuleType("library_of_others")
    library.__file__ = f"/usr/lib/python3/{folder}/library_of_others.py"
    exec("calls = 0\ndef turn():\n    global calls\n    calls += 1\n    return 1j", vars(library))
    monkeypatch.setitem(sys.modules, "library_of_others", library)
    scenario = brief(lambda state, rng: library.turn())
    for _ in range(2):
        run(scenario, 1)
    library.__file__ = "/home/me/library_of_others.py"
    run(scenario, 1)
    with pytest.warns(StateWarning, match="library_of_others.calls"):
        run(scenario, 1)


def test_a_package_that_lacks_what_code_names_is_no_error(monkeypatch):
    """It imports its parts when they are first named, and the code names them only if they are there."""
    lazy = ModuleType("lazy_library")
    exec("def __getattr__(name):\n    raise ModuleNotFoundError(f'{name} needs torch')", vars(lazy))
    lazy.__file__ = "/home/me/lazy_library.py"
    monkeypatch.setitem(sys.modules, "lazy_library", lazy)

    def strategy(state, rng):
        return lazy.Tensor.new() if state is None else 1j

    for _ in range(2):
        run(brief(strategy), 1)


class Signs(enum.Flag):
    NORTH = 1
    EAST = 2


def test_flags_that_are_combined_are_no_state():
    """Python keeps each combination in the class."""
    for _ in range(2):
        run(brief(lambda state, rng: 1j if Signs.NORTH | Signs.EAST else -1j), 1)


def test_state_of_a_users_script_is_warned_of_in_a_worker_process(monkeypatch):
    """There, the main module is one of the installed package of the workers, and the script came by pickle."""
    main = ModuleType("__main__")
    main.__file__ = "/usr/lib/python3/site-packages/loky/backend/popen_loky_posix.py"
    script = {"__name__": "__main__"}
    exec("calls = 0\ndef turn(state, rng):\n    global calls\n    calls += 1\n    return 1j", script)
    monkeypatch.setitem(sys.modules, "__main__", main)
    run(brief(script["turn"]), 1)
    with pytest.warns(StateWarning, match="calls: an earlier run has changed it"):
        run(brief(script["turn"]), 1)


def test_state_that_a_function_imports_is_watched(monkeypatch):
    """As in a strategy that imports where it is called, so that its module has no such variable."""
    library = ModuleType("library_of_mine")
    library.__file__, library.calls = "/home/me/library_of_mine.py", []
    monkeypatch.setitem(sys.modules, "library_of_mine", library)

    def count(_state, _rng):
        from library_of_mine import calls

        calls.append(1)
        return 1j

    run(brief(count), 1)
    with pytest.warns(StateWarning, match="library_of_mine.calls"):
        run(brief(count), 1)


class Counting:
    """A latency that counts, in its class, how often it is called: by runs, and by metrics."""

    calls: ClassVar[list[int]] = []

    def __call__(self, context, rng):
        self.calls.append(1)
        return 1e-4 * len(self.calls)


class Measuring(Remembering):
    def __call__(self, result):
        return super().__call__()

    def is_first(self, result):
        return super().__call__() == 1


MEASURED = {
    "instance": lambda: (lambda count: lambda result: count())(Remembering()),
    "method": lambda: (lambda held: functools.partial(lambda count, result: count(), held.turn))(Remembering()),
    "with a unit": lambda: Metric(Measuring(), "s"),
    "in what decides whether it is given": lambda: Metric(lambda result: 1.0, given=Measuring().is_first),
    "nonlocal": lambda: (lambda count: lambda result: count())(nonlocal_counter()),
}
"""Metrics that remember earlier calls."""


@pytest.mark.slow_cases("method", "with a unit", "in what decides whether it is given", "nonlocal")
@pytest.mark.parametrize("make", MEASURED.values(), ids=MEASURED)
def test_a_metric_starts_afresh_at_each_measurement(make):
    """Alone, in each run of a sweep, and in the next one: it could otherwise depend on the number of workers."""
    metric, result = {"mine": make()}, run(Scenario(team=Team(count=2), horizon=0.1), 1)
    first, second = (summary(result, metric)["mine"] for _ in range(2))
    assert first == second
    for _ in range(2):
        swept = sweep(result.scenario, {"team.count": [2, 3]}, reps=2, executor=1, metrics=metric)
        values = [row.summary["mine"] for group in swept.groups for row in group.rows]
        assert values == [first] * 4


def test_a_metric_that_reads_a_list_of_its_earlier_values_is_warned_of():
    """It shares the list with the caller, who may read what it reports."""
    seen, reported = [], []

    def measured_so_far(result):
        seen.append(1)
        return len(seen)

    def reports(result):
        reported.append(result.seed)
        return 1

    result = run(Scenario(team=Team(count=2), horizon=0.1), 1)
    for _ in range(2):
        summary(result, {"mine": reports})
    assert reported == [1, 1]
    summary(result, {"mine": measured_so_far})
    with pytest.warns(StateWarning, match="seen of .*measured_so_far: an earlier run has changed it"):
        summary(result, {"mine": measured_so_far})


@pytest.mark.slow
def test_state_that_metrics_change_between_runs_is_warned_of():
    Counting.calls.clear()  # as other tests of this process may have left it
    scenario = Scenario(team=Team(count=2), network=Links(latency=Counting()), horizon=0.3)
    result = run(scenario, 1)
    calls = len(Counting.calls)
    summary(result)
    assert len(Counting.calls) > calls > 0
    with pytest.warns(StateWarning, match=r"^Counting\.calls: an earlier run has changed it"):
        run(scenario, 1)


def test_state_that_a_run_leaves_when_it_raises_is_warned_of():
    class Turns:
        taken = 0

        def __call__(self):
            Turns.taken += 1
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError), fresh_copy(Turns(), is_run=True) as turns:
        turns()
    warned = pytest.warns(StateWarning, match=r"Turns\.taken: an earlier run has changed it")
    with warned, fresh_copy(Turns(), is_run=True):
        pass


@pytest.mark.slow
def test_state_that_the_caller_changes_between_runs_is_not_warned_of():
    scenario = Scenario(team=Team(count=2), network=Links(latency=Counting()), horizon=0.3)
    for _ in range(2):
        Counting.calls.clear()
        summary(run(scenario, 1))


def test_an_iterator_at_the_address_of_one_that_is_gone_counts_as_changed_too():
    for _ in range(5):
        turns, remembered = itertools.cycle([1j]), Remembered()
        assert [remembered.has_changed(turns) for _ in range(3)] == [False, True, False]


def test_only_so_many_iterators_are_kept_after_their_description(monkeypatch):
    monkeypatch.setattr(copier, "MAX_DESCRIBED", 3)
    monkeypatch.setattr(copier, "_described", {})
    turns = [itertools.cycle([k]) for k in range(5)]
    remembered = [Remembered() for _ in turns]
    assert not any(memory.has_changed(turn) for memory, turn in zip(remembered, turns, strict=True))
    assert [*copier._described.values()] == turns[2:]
    assert all(memory.has_changed(turn) for memory, turn in zip(remembered[2:], turns[2:], strict=True))


def test_a_function_that_dispatches_by_type_is_one_like_others():
    count = nonlocal_counter()

    @functools.singledispatch
    def up(state, rng):
        return 1j

    @functools.singledispatch
    def counting_up(state, rng):
        return 1j * np.sign(count())

    for _ in range(2):
        run(brief(up), 1)
    run(brief(counting_up), 1)
    with pytest.warns(StateWarning, match="an earlier run has changed it"):
        run(brief(counting_up), 1)


def test_a_graph_that_a_function_holds_is_copied():
    held = networkx.path_graph(2)
    held.nodes[0]["calls"] = 0

    def graph(size):
        held.nodes[0]["calls"] += 1
        return held

    scenario = Scenario(team=Team(count=2), network=Links(graph=graph), horizon=0.1)
    for _ in range(2):
        run(scenario, 1)
    assert held.nodes[0]["calls"] == 0
    run(Scenario(team=Team(count=3), network=Links(graph=networkx.cycle_graph), horizon=0.1), 1)


@pytest.mark.whole_but_one
@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("strategy", "name"),
    [
        (creating, "creating.calls"),
        (counting, f"{__name__}.NUMBERS"),
        (Counter(), "Counter.calls"),
        (functools.partial(Tally()), "Tally.calls"),
        (global_counter, f"{__name__}.CALLS"),
        (attributed, "attributed.calls"),
        (in_a_list(), "calls of in_a_list.<locals>.strategy"),
        (in_a_default, "calls of in_a_default"),
        (in_a_keyword, "calls of in_a_keyword"),
        (in_a_global_collection, f"{__name__}.MEMORY"),
        (drawing, f"{__name__}.DRAWS"),
        (calling, f"{__name__}.HELD"),
        (rereading, f"{__name__}.SEEN"),
        (in_another_class, "Store.calls"),
        (helped, f"{__name__}.CALLED"),
        (generating, f"{__name__}.HEADINGS"),
    ],
)
def test_state_in_a_class_a_function_or_a_module_is_warned_of(strategy, name):
    run(game(strategy), 1)
    with pytest.warns(StateWarning, match=f"^{name}: an earlier run has changed it, so this run starts from another"):
        run(game(strategy), 1)


OF_TWO = [0]


def test_a_global_variable_that_another_function_has_changed_is_warned_of():
    """As by a lambda of another scenario, or a function whose cell in a notebook was run again."""

    def made():
        def strategy(state, rng):
            OF_TWO[0] += 1
            return 1j ** OF_TWO[0]

        return strategy

    run(game(made()), 1)
    with pytest.warns(StateWarning, match=f"^{__name__}.OF_TWO: an earlier run has changed it"):
        run(game(made()), 1)
    OF_TWO[0] = 0
    run(game(made()), 1)


GLOBALLY = [
    (lambda: random.random(), "random"),
    (lambda: np.random.normal(), "numpy.random"),  # noqa: NPY002
    (lambda: 1.0, None),
]


def generators_warned_of(draw):
    """Return the modules whose generators a run is warned of in which a strategy draws."""

    def strategy(state, rng):
        return np.exp(1j * draw())

    with catch_warnings(record=True) as caught:
        simplefilter("always")
        run(game(strategy), 1)
    texts = [str(warning.message) for warning in caught if warning.category is StateWarning]
    assert all(": the run has drawn from the global generator" in text for text in texts)
    return [text.partition(":")[0] for text in texts]


@pytest.mark.slow_but_one
@pytest.mark.parametrize(("draw", "module"), GLOBALLY)
def test_a_first_run_that_draws_from_a_global_generator_is_warned_of(draw, module):
    assert generators_warned_of(draw) == ([] if module is None else [module])


def test_the_global_generator_may_be_any_of_numpy():
    usual = np.random.get_bit_generator()
    np.random.set_bit_generator(np.random.PCG64(3))
    try:
        assert generators_warned_of(lambda: np.random.normal()) == ["numpy.random"]  # noqa: NPY002
        assert generators_warned_of(lambda: 1.0) == []
    finally:
        np.random.set_bit_generator(usual)


@pytest.mark.slow
@pytest.mark.parametrize(("draw", "module"), GLOBALLY)
def test_draws_of_another_thread_are_not_those_of_the_run(draw, module):
    """The threads of a cluster draw, too, so that a run beside them is warned of what its code names."""
    over, expected = threading.Event(), [] if module is None else [module]

    def other():
        while not over.wait(1e-4):
            random.random()

    threading.Thread(target=other, daemon=True).start()
    try:
        assert generators_warned_of(draw) == expected
    finally:
        over.set()


def with_a_global_on_its_edges(size):
    graph = networkx.complete_graph(size)
    networkx.set_edge_attributes(graph, LATENCY, "latency")
    return graph


@pytest.mark.slow
def test_a_global_model_that_a_graph_function_puts_on_edges_is_warned_of():
    scenario = Scenario(team=Team(count=3), horizon=0.1, network=Links(graph=with_a_global_on_its_edges))
    run(scenario, 1)
    with pytest.warns(StateWarning, match=rf"^{__name__}\.LATENCY: an earlier run has changed it"):
        run(scenario, 1)


class Graph(Remembering):
    def __call__(self, size):
        assert super().__call__() == 1
        return Ring()(size)


def test_a_graph_that_remembers_is_called_once_by_the_scenario_and_by_each_run():
    graph = Graph()
    scenario = Scenario(team=Team(count=3), motion=Motion(static=True), horizon=0.1, network=Links(graph=graph))
    for _ in range(2):
        run(scenario)
        list(warnings(scenario))
    assert graph.calls == 0


def test_watchers_belong_to_the_caller_and_are_not_copied():
    class Count:
        events = 0

        def __call__(self, event):
            self.events += 1

    watcher = Count()
    result = run(Scenario(team=Team(count=3), horizon=0.1), 1, watcher)
    assert watcher.events >= len(result.trace) > 0


@pytest.mark.parametrize(
    ("maxsize", "count", "kept"),
    [(size, *counts) for size in (None, 500) for counts in ((0, 0), (1, 1), (100, 100), (101, 0))],
)
def test_up_to_a_hundred_values_of_a_cache_are_compared(maxsize, count, kept):
    @functools.lru_cache(maxsize=maxsize)
    def squares(number):
        return [number**2]

    for number in range(count):
        squares(number)
    values = [value for value in _cached(squares, lambda value: value).values() if isinstance(value, list)]
    assert sorted(values) == [[number**2] for number in range(kept)]


LARGE = {
    "list": lambda count: [0.5] * count,
    "dict": lambda count: dict.fromkeys(range(count), 0.5),
    "array": np.zeros,
    "rows": lambda count: np.zeros((count // 3, 3)),
}


@pytest.mark.parametrize("kind", LARGE)
def test_collections_of_less_than_10_000_items_are_searched_for_changes(kind):
    assert _snapshot(LARGE[kind](9_999)) is not None
    assert _snapshot(LARGE[kind](10_002 if kind == "rows" else 10_000)) is None

"""What holds in every test: no history of a network breaks its invariants; and runs that tests share."""

import gc
import signal
import sys
from contextlib import suppress
from functools import cache
from importlib import import_module
from inspect import isfunction
from itertools import takewhile
from pathlib import Path
from pkgutil import walk_packages

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import settings
from xdist import is_xdist_controller, is_xdist_worker

import desim
import protocols
from desim.kernel.core.events import Trace
from desim.testing.messages import Conservation

# The same cases every time, however slow the machine; new and more ones with --hypothesis-profile=explore.
settings.register_profile("steady", deadline=None, derandomize=True, max_examples=24)
settings.register_profile("explore", deadline=None, max_examples=400)
settings.load_profile("steady")
TESTS = Path(__file__).parent
SCENARIOS = TESTS.parent / "scenarios"
BENCHMARKS = TESTS / "benchmarks"
WATCHERS = pytest.StashKey[list[Conservation]]()
"""The watchers of the traces that are made in a test."""

# Nearly all that is imported and collected stays, and searches for garbage in it would take a tenth of that time.
gc.disable()

# A shell ignores interrupts in what a script starts in the background, and Python then has no handler for them.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser):
    """Offer the large cases, and all cases of the tests that have several `parametrize`."""
    what = "all combinations, not each value at least once, and the tests marked whole"
    parser.addoption("--whole-products", action="store_true", help=what)


def values_of(item):
    """Return the value of a case on each axis: of each `parametrize` of the test, and of each fixture with cases."""
    params = item.callspec.params if hasattr(item, "callspec") else {}
    axes = [mark.args[0] for mark in item.iter_markers("parametrize")]
    names = [axis.replace(" ", "").split(",") if isinstance(axis, str) else list(axis) for axis in axes]
    names += [[name] for name in params if not any(name in axis for axis in names)]
    return {(k, *(id(params[name]) for name in axis if name in params)) for k, axis in enumerate(names)}


def covering(cases):
    """Return some cases of a product, the first among them, in which each value of each axis occurs."""
    values = {case: values_of(case) for case in cases}
    missing, chosen = set().union(*values.values()), set()
    while missing:
        case = max(cases, key=lambda case: len(values[case] & missing))  # of several the first
        missing -= values[case]
        chosen.add(case)
    return chosen


def whole_are_asked_for(config):
    """Return whether all combinations and the tests marked whole are run: by their option, or a test by its name."""
    return config.option.whole_products or any("::" in argument for argument in config.args)


def pytest_ignore_collect(collection_path, config):
    """Leave out the benchmarks where they would be skipped: their workloads take long to make."""
    return True if collection_path == BENCHMARKS and config.option.benchmark_skip else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session):
    """Import all modules, if tests run in this process; let each of several workers begin with another file of tests.

    A module that is first imported while a test has patched another would keep the patch for the rest of the process.
    Workers share the work of compiling.
    """
    if is_xdist_controller(session):
        gc.freeze()
        return
    for package in (desim, protocols):
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            import_module(module.name)
    if session.config.args_source is not session.config.ArgsSource.TESTPATHS or not is_xdist_worker(session):
        return
    names = sorted(".".join(path.relative_to(TESTS.parent).with_suffix("").parts) for path in TESTS.rglob("test_*.py"))
    worker = session.config.workerinput
    first = len(names) * int(worker["workerid"].removeprefix("gw")) // worker["workercount"]
    for name in [*names[first:], *names[:first]]:
        if not name.startswith("tests.benchmarks."):
            with suppress(Exception, pytest.skip.Exception):  # is told when the file is collected
                import_module(name)


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(collector, obj):
    """Make no cases of a test that would all be left out afterwards: of half of the tests, unless one is named."""
    if not isfunction(obj) or whole_are_asked_for(collector.config):
        return None
    left_out = {"slow", "whole"} if collector.config.option.markexpr == "not slow" else {"whole"}
    return [] if any(mark.name in left_out for mark in getattr(obj, "pytestmark", ())) else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark the slow and the whole cases of a test, leave out `whole` ones, and thin products."""
    asked_for = whole_are_asked_for(config)
    tests = {}
    for item in items:
        tests.setdefault((item.parent, getattr(item, "originalname", item.name)), []).append(item)
    for cases in tests.values():
        for rank in ("slow", "whole"):
            if cases[0].get_closest_marker(f"{rank}_but_one"):
                for item in cases[1:]:
                    item.add_marker(rank)
        if mark := cases[0].get_closest_marker("slow_cases"):
            for item in cases:
                if item.callspec.id in mark.args:
                    item.add_marker("slow")
    for item in items:
        if item.get_closest_marker("whole"):
            item.add_marker("slow")
    kept = {item for item in items if asked_for or not item.get_closest_marker("whole")}
    # A test of several `parametrize` asks one question in all corners. Each value is met here, not each combination.
    if not asked_for:
        short = [[item for item in cases if item in kept] for cases in tests.values()]
        kept = set().union(*(covering(cases) if len(values_of(cases[0])) > 1 else cases for cases in short if cases))
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = [item for item in items if item in kept]


def pytest_collection_finish():
    """Keep what has been imported and collected, nearly all of which stays, out of every search for garbage."""
    gc.enable()
    gc.freeze()


def _no_modules_left(tmp_path_factory):
    """Forget the folders that are added to `sys.path`, and the modules that are imported from folders of tests."""
    path, latest = [*sys.path], next(reversed(sys.modules))
    yield
    sys.path[:] = path
    for name in [*takewhile(lambda name: name != latest, reversed(sys.modules))]:  # in order of their import
        file = getattr(sys.modules[name], "__file__", None)
        if file is not None and Path(file).is_relative_to(tmp_path_factory.getbasetemp()):
            del sys.modules[name]


_after_each_test = pytest.fixture(_no_modules_left, autouse=True)
_after_each_file = pytest.fixture(_no_modules_left, autouse=True, scope="module")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item):
    """Let every trace that is made in the process of a fast test be watched, unless it is made by hand.

    Slow tests measure laws over many runs, of kinds that fast tests and the soak test watch. A fixture would take as
    long as half of the tests.
    """
    unwatched = any(item.get_closest_marker(name) for name in ("own_trace", "slow"))
    if unwatched or BENCHMARKS in item.path.parents:
        return (yield)
    begin = Trace.__init__

    def watched(self, watchers=(), **options):
        item.stash[WATCHERS].append(Conservation())
        begin(self, (*watchers, item.stash[WATCHERS][-1]), **options)

    item.stash[WATCHERS] = []
    Trace.__init__ = watched
    try:
        return (yield)
    finally:
        Trace.__init__ = begin
        del item.stash[WATCHERS]


@pytest.hookimpl(specname="pytest_runtest_protocol")
def pytest_runtest_protocol_in_worker(item, nextitem):
    """Let a worker tell of a test only how it ended, and of its fixtures only what is slow or went wrong.

    The six messages that a worker sends of each test take a tenth of the time of all tests.
    """
    if not is_xdist_worker(item.session) or item.config.getoption("xmlpath", None):  # which needs all reports
        return None
    for report in runtestprotocol(item, log=False, nextitem=nextitem):
        if report.when == "call" or not report.passed or report.duration >= item.config.option.durations_min:
            item.ihook.pytest_runtest_logreport(report=report)
    return True


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Let a test fail whose traces break an invariant."""
    answer = yield
    for watcher in item.stash.get(WATCHERS, ()):
        watcher.judge()
    return answer


@pytest.fixture
def default_signals():
    """Handle signals as Python does at its start, also where a parent such as `nohup` lets them be ignored."""
    handlers = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: signal.SIG_DFL,
        signal.SIGHUP: signal.SIG_DFL,
    }
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="session")
def run_of():
    """Return a function from a scenario file, overrides and a seed to the result of that run, simulated only once.

    For tests that only read the result: `run_of("relay.toml", "horizon=1.0", "record.messages=true", seed=3)`.
    """

    @cache
    def ran(file, *overrides, seed=None):
        return desim.run(desim.load(SCENARIOS / file, list(overrides)), seed, Conservation())

    return ran


@pytest.fixture
def pictures():
    """Let pictures be written, for a test that looks at them in a module that writes none else."""


@pytest.fixture
def _undrawn(request, monkeypatch):
    """Draw and write no pictures, unless the test asks for `pictures`."""
    if "pictures" not in request.fixturenames:
        undraw(monkeypatch)


def undraw(patch):
    """Let a run and a sweep draw and write no pictures, and a report have none, which takes a second each."""
    for name in (
        "analysis.drawing.plots.save",
        "analysis.drawing.trajectory.trajectory",
        "study.results.figures.means",
    ):
        patch.setattr(f"desim.{name}", lambda *_, **__: [])
    for name in ("figures.legend", "figures.multiples", "heat_maps.phase", "waterfalls.waterfall"):
        patch.setattr(f"desim.study.results.{name}", lambda *_, **__: None)
    patch.setattr("desim.view.pages.report._inline", lambda *_: "")

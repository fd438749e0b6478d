"""Time-outs: a run that takes too long is ended, and the error names what each pursuer waits for."""

import gc
import os
import random
import re
import signal
import subprocess
import sys
import time
import warnings
import weakref
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import field, make_dataclass, replace
from math import inf
from pathlib import Path
from threading import Barrier, Event, Thread
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from pydantic import BaseModel, field_serializer
from pydantic_core import PydanticSerializationError

from desim.cli import main
from desim.config.interrupts import deferred
from desim.kernel.core.trace_file import line_of
from desim.results import provenance, run_folder
from desim.scenario.players import Team
from desim.scenario.scenario import Motion, Scenario
from desim.simulation import run as run_module
from desim.simulation import watchdog
from desim.simulation.run import run
from desim.simulation.watchdog import TimedOut, code_place_of, within
from desim.study.sweeps.sweep import sweep


def spin(me):
    """Loop without end at the first turn of pursuer 1; the others sleep, or wait for mail that never comes."""
    yield me.sleep(0.5)
    while me.id == 1:
        pass
    yield from mail(me)


def mail(me):
    yield me.arrival("never")


def endless(me):
    """Let no time pass."""
    while True:
        yield me.sleep(0.0)


def scenario(protocol):
    return Scenario(team=Team(count=3), protocol=protocol, motion=Motion(static=True), horizon=9.0)


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf"), 1e300])
def test_a_limit_is_a_time(limit):
    with pytest.raises(ValueError, match="a time limit should be > 0 s"), within(limit):
        pass


@pytest.mark.slow
def test_a_run_that_ends_in_time_is_not_interrupted():
    """Also if the time is over in the very moment in which it ends: it notices that at once, or never."""
    for _ in range(200):
        start = time.monotonic()
        try:
            with within(0.001):
                while time.monotonic() - start < 0.001:
                    pass
        except TimedOut as error:
            told = str(error)
            assert not told or told.startswith("took longer than 0.001 s: ")
    for _ in range(100_000):
        pass


TRACED = """
import sys
from desim.simulation.watchdog import TimedOut, within
sys.setprofile(lambda *_: None)
for limit in (99.0, 0.01):
    try:
        with within(limit):
            while limit < 1.0:
                pass
    except TimedOut:
        assert limit == 0.01
"""


@pytest.mark.slow
def test_a_limit_ends_under_a_profiler():
    """In Python 3.11 a traced call never begins once an asynchronous exception was withdrawn, so none is."""
    subprocess.run([sys.executable, "-c", TRACED], check=True, timeout=120)


@pytest.fixture
def look(monkeypatch):
    """Return a function that lets 9 s pass at once and the timer ring; if the limit is reached, it does not return."""
    now = [0.0]
    monkeypatch.setattr(watchdog, "monotonic", lambda: now[0])

    def once():
        now[0] = 9.0
        signal.raise_signal(signal.SIGALRM)

    return once


def test_a_swallowed_time_out_is_raised_again_and_never_while_it_propagates(look):
    told = []

    def lose():
        for k in range(5):
            try:
                look()
            except TimedOut:
                look()
                told.append(k)
        try:
            look()
        finally:
            look()
            told.append("clean-up")

    with (
        pytest.raises(TimedOut, match=r"^took longer than 9 s: simulation/test_watchdog.py:\d+ \(once\)$"),
        within(9.0),
    ):
        lose()
    assert told == [0, 1, 2, 3, 4, "clean-up"]


def test_a_time_out_that_python_drops_is_raised_again(look, monkeypatch):
    """Python drops exceptions of `__del__` and hands them to a hook."""
    dropped = []
    monkeypatch.setattr(sys, "unraisablehook", dropped.append)
    usual = sys.unraisablehook

    class Closed:
        def __init__(self, act):
            self.act = act

        def __del__(self):
            self.act()

    def lose():
        Closed(look)
        Closed(lambda: [][0])
        look()

    with pytest.raises(TimedOut, match=r"^took longer than 9 s: .*:\d+ \(once\)$"), within(9.0):
        lose()
    assert [issubclass(each.exc_type, TimedOut) for each in dropped] == [True, False]
    assert sys.unraisablehook is usual


class Late(BaseModel):
    """Is late when it is serialised: pydantic turns whatever is raised there into an error of its own."""

    look: Any

    @field_serializer("look")
    def _written(self, look):
        look()


def test_an_error_that_it_is_turned_into_is_taken_for_what_it_is(look):
    with pytest.raises(TimedOut, match=r"^took longer than 9 s: ") as caught, within(9.0):
        Late(look=look).model_dump_json()
    assert isinstance(caught.value.__cause__, PydanticSerializationError)


def test_code_that_swallows_the_time_out_until_its_end_is_still_reported(look):
    with (
        pytest.raises(TimedOut, match=r"^took longer than 9 s: it ended by itself"),
        within(9.0),
        suppress(PydanticSerializationError),
    ):
        Late(look=look).model_dump_json()


def state():
    """Return what runs and limits may change in the process."""
    handlers = [signal.getsignal(each) for each in signal.valid_signals()]
    hooks = sys.unraisablehook, sys.excepthook, sys.gettrace(), sys.getprofile(), sys.getswitchinterval()
    whole = gc.get_threshold(), gc.isenabled(), warnings.filters[:], dict(os.environ), Path.cwd(), [*sys.path]
    drawn = random.getstate(), str(np.random.get_state())  # noqa: NPY002
    return handlers, hooks, whole, drawn, np.geterr(), np.get_printoptions()


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_runs_in_threads_leave_the_process_as_it_was(count):
    """They overlap: each begins before any ends, and the first to begin is the first to end."""
    begun, before, found = Barrier(count), state(), {}

    def act(number):
        def meet(me):
            if me.id == 0:
                begun.wait(60.0)
                Event().wait(0.05 * number)  # a protocol that calls time.sleep is warned of
            yield me.sleep(0.1)

        with within(60.0):
            found[number] = [line_of(event) for event in run(scenario(meet), 1).trace]

    threads = [Thread(target=act, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [found[number] for number in range(count)] == [found[0]] * count
    assert state() == before


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 4])
def test_an_endless_loop_in_any_thread_is_ended(count):
    told = []

    def act():
        for _ in range(3):
            try:
                with within(0.1):
                    run(scenario(spin))
            except TimedOut as error:
                told.append(str(error))
        for _ in range(100_000):  # nothing is raised later
            pass

    threads = [Thread(target=act) for _ in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert len(told) == 3 * count
    assert all(text.startswith("took longer than 0.1 s: ") for text in told)


@pytest.mark.parametrize(("outer", "inner"), [(0.05, 9.0), (9.0, 0.05)])
def test_the_shorter_of_nested_limits_ends_the_block(outer, inner):
    before, shorter = state()[:2], min(outer, inner)
    ended = []

    def act():
        try:
            with within(inner):
                while True:
                    pass
        finally:
            ended.append(True)

    with pytest.raises(TimedOut, match=f"^took longer than {shorter:g} s: "), within(outer):
        act()
    assert ended == [True]
    assert state()[:2] == before


def test_a_timer_of_the_caller_goes_on():
    rung = []
    usual = signal.signal(signal.SIGALRM, lambda *_: rung.append(time.monotonic()))
    left = signal.setitimer(signal.ITIMER_REAL, 0.1)
    try:
        start = time.monotonic()
        with within(9.0):
            while not rung:
                pass
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with within(9.0):
            pass
        assert 0.0 < signal.getitimer(signal.ITIMER_REAL)[0] <= 0.2
        assert rung[0] - start >= 0.09
    finally:
        signal.signal(signal.SIGALRM, usual)
        signal.setitimer(signal.ITIMER_REAL, *left)


@pytest.mark.parametrize(("interval", "rings"), [(0.0, 1), (0.05, 4)])
def test_a_timer_of_the_caller_rings_at_its_own_times(interval, rings):
    """Once, or at its interval, not at that at which the exception is raised again; and not when the block ends."""
    rung = []
    usual = signal.signal(signal.SIGALRM, lambda *_: rung.append(time.monotonic()))
    left = signal.setitimer(signal.ITIMER_REAL, 0.05, interval)
    try:
        start = time.monotonic()
        with within(9.0), within(9.0):
            while time.monotonic() < start + 0.225:
                pass
        assert signal.getitimer(signal.ITIMER_REAL)[1] == pytest.approx(interval, abs=1e-3)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        assert len(rung) <= rings  # a busy machine may skip some
        assert rung[0] - start >= 0.049
    finally:
        signal.signal(signal.SIGALRM, usual)
        signal.setitimer(signal.ITIMER_REAL, *left)


def test_an_interrupt_is_not_taken_for_it(look):
    def interrupted():
        try:
            look()
        finally:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), within(9.0):
        interrupted()


@pytest.mark.slow
def test_the_place_of_an_instruction_without_a_line_is_the_begin_of_its_function():
    def interrupted():
        raise ValueError

    code = interrupted.__code__
    for table, line in ((code.co_linetable, code.co_firstlineno + 1), (b"", code.co_firstlineno)):
        with pytest.raises(ValueError) as caught:
            FunctionType(code.replace(co_linetable=table), {})()
        assert code_place_of(caught.value) == f"simulation/test_watchdog.py:{line} (interrupted)"


def test_the_place_is_never_in_generated_code_which_has_no_file():
    kind = make_dataclass("Generated", [("count", int, field(default_factory=next, init=False))])
    with pytest.raises(TypeError) as caught:
        replace(object.__new__(kind))
    assert caught.traceback[-1].frame.code.raw.co_filename == "<string>"
    of_libraries = caught.value.with_traceback(caught.tb.tb_next)
    assert re.fullmatch(r"[^/]+/dataclasses\.py:\d+ \(_?replace\)", code_place_of(of_libraries))


@pytest.mark.slow
def test_no_limit_is_lost_in_a_serialiser():
    """Of 87 limits raised once 15 were lost here, and 69 became a PydanticSerializationError."""

    def write_on():
        while True:
            model.model_dump_json()

    model, before = Scenario(), signal.getsignal(signal.SIGINT)
    for _ in range(25):
        with pytest.raises(TimedOut, match=r"^took longer than 0.02 s: "), within(0.02):
            write_on()
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.slow
def test_an_endless_loop_is_ended_and_the_state_of_every_pursuer_reported():
    """Pursuer 1 never comes back from its turn at 0.5 s; 0 has gone on to wait for mail, 2 has its turn yet to come."""
    with pytest.raises(TimedOut) as caught, within(0.3):
        run(scenario(spin))
    first, *others = str(caught.value).splitlines()
    assert first.startswith("took longer than 0.3 s: at 0.5 s of simulated time, in simulation/test_watchdog.py:")
    assert first.endswith("(spin): while me.id == 1:; 2 processes wait")
    own = [line.strip() for line in others]
    assert len(own) == 2
    assert own[0].startswith("pursuer 0: simulation/test_watchdog.py:")
    assert own[0].endswith('(mail): yield me.arrival("never")')
    assert own[1].startswith("pursuer 2: ")
    assert own[1].endswith("yield me.sleep(0.5), at 0.5 s")


@pytest.mark.slow
def test_a_run_in_which_no_time_passes_is_ended():
    with pytest.raises(TimedOut, match=r"(?s)at 0 s of simulated time, in .*pursuer"), within(0.05):
        run(scenario(endless))


def waits_together(me):
    """Wait for one instant, all but pursuer 0, which never comes back."""
    yield me.sleep(0.5)
    while me.id == 0:
        abs(me.id)
    yield me.sleep(1.0)


@pytest.mark.slow
def test_processes_that_wait_at_one_line_are_one_line():
    with pytest.raises(TimedOut) as caught, within(0.2):
        run(scenario(waits_together).with_({"team.count": 12}))
    first, *others = str(caught.value).splitlines()
    assert re.search(r"test_watchdog.py:\d+ \(waits_together\): (while me.id == 0:|abs\(me.id\)); 11 processes", first)
    assert [line.partition(" at ")[0] for line in others] == ["  11 processes wait"]
    assert others[0].endswith("yield me.sleep(0.5), at 0.5 s (pursuers 1, 2, 3, 4, 5, 6, 7, 8, ...)")


def test_an_interrupt_is_told_where_the_run_was():
    def interrupted(me):
        yield me.sleep(0.25)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        run(scenario(interrupted))
    (note,) = caught.value.__notes__
    assert note.startswith("at 0.25 s of simulated time, in simulation/test_watchdog.py:")
    assert note.endswith("(interrupted): raise KeyboardInterrupt")


@pytest.mark.slow
def test_the_command_ends_with_1_and_reports_the_time_out(tmp_path, monkeypatch):
    monkeypatch.setattr(run_folder, "can_plot", lambda: False)  # to find out takes its time
    file = tmp_path / "long.toml"
    file.write_text("horizon = 1e9\nevader.speed = 9.0\nteam.count = 2\nrecord.trajectory = 0.0\n")
    command = ["run", str(file), "--timeout"]
    assert CliRunner().invoke(main, [*command, "99", "--set", "horizon=0.1"]).exit_code == 0  # imports what is needed
    made = CliRunner().invoke(main, [*command, "0.5", "-o", str(tmp_path / "out")])
    assert made.exit_code == 1
    assert "\n--timeout: took longer than 0.5 s: at " in made.stderr
    assert re.search(r"\n  pursuer [01]: ", made.stderr), made.stderr  # the other one may be at its turn
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize(("options", "limits"), [([], [9.0]), (["-n", "1"], [9.0]), (["-n", "2"], [])])
def test_the_time_limit_of_one_run_covers_the_whole_command(tmp_path, monkeypatch, options, limits):
    """Also with -n 1; each of several runs has its own limit."""
    found = []
    monkeypatch.setattr(watchdog, "within", lambda limit: nullcontext(found.append(limit)))
    file = tmp_path / "short.toml"
    file.write_text("horizon = 0.01\nteam.count = 2\n")
    made = CliRunner().invoke(main, ["run", str(file), "--timeout", "9", "-j", "1", *options])
    assert made.exit_code == 0, made.output
    assert found == limits


@pytest.mark.slow
@pytest.mark.parametrize(("runs", "during"), [(1, [True]), (2, [False, False])])
def test_the_time_limit_of_a_recorded_batch_ends_before_its_first_run(tmp_path, monkeypatch, runs, during):
    """How many runs there are is known only when the file is read, within the limit; one run is within it, too."""
    active, found = [], []

    @contextmanager
    def limit(_):
        active.append(True)
        yield
        active.pop()

    monkeypatch.setattr(watchdog, "within", limit)
    monkeypatch.setattr(run_module, "run", lambda *task: found.append(bool(active)) or run(*task))
    scenario = Scenario(horizon=0.01, team=Team(count=2))
    provenance.write(tmp_path, provenance.document(provenance.RUN, scenario, seed=0, runs=runs, folder=tmp_path))
    made = CliRunner().invoke(main, ["run", "--from", str(tmp_path / "run.json"), "--timeout", "9", "-j", "1"])
    assert made.exit_code == 0, made.output
    assert found == during


@pytest.mark.parametrize("text", ["0", "nan", "soon"])
def test_the_command_refuses_what_is_no_time(tmp_path, text):
    made = CliRunner().invoke(main, ["run", str(tmp_path / "x.toml"), "--timeout", text])
    assert made.exit_code == 2
    assert "Invalid value for '--timeout'" in made.stderr


@pytest.mark.slow
def test_a_run_of_a_sweep_that_takes_too_long_has_failed_and_the_others_go_on():
    swept = sweep(scenario(endless), {"horizon": [1e-9, 1.0]}, reps=1, timeout=0.1)
    assert len(swept.failed) == 2


def collected(phase, info):
    """Be a callback of the garbage collector, which needs not be a function of Python."""


def frames(*codes):
    """Return the innermost of some frames, the codes of which are given from the outermost on."""
    frame = None
    for code in codes:
        frame = SimpleNamespace(f_code=code, f_back=frame)
    return frame


FREE = frames.__code__
HELD = [
    *((weakref.WeakKeyDictionary()._remove.__code__,), (FREE, collected.__code__)),
    *((type(deferred()).__exit__.__code__,), (watchdog.DEFERRING,), (FREE, watchdog.DEFERRING, FREE, FREE)),
]


@pytest.mark.parametrize("codes", HELD, ids=range(len(HELD)))
def test_an_alarm_waits_for_the_end_of_what_it_would_break(codes, monkeypatch):
    """In a callback Python would print the exception and go on; `deferred` would not put the handlers back."""
    monkeypatch.setattr(gc, "callbacks", [*gc.callbacks, print, collected])
    alarm = watchdog._Alarm(0.001)
    alarm._begin, alarm._other_due, alarm._handler = time.monotonic() - 1.0, inf, None
    alarm._ring(signal.SIGALRM, frames(*codes))
    assert alarm.is_late
    for frame in (None, frames(FREE, FREE), frames(collected.__code__, FREE)):
        with pytest.raises(TimedOut):
            alarm._ring(signal.SIGALRM, frame)

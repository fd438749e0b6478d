"""The process that forks pursuers, without a process: what it asks of the system, call by call, is golden."""

import asyncio
import os
import pickle
import subprocess
import sys
from contextlib import suppress
from functools import partial
from types import SimpleNamespace

import cloudpickle
import pytest

from desim import Scenario
from desim.live import node as node_module
from desim.live import nursery, pursuer
from desim.live.nursery import GRACE, POLL, Nursery, serve
from desim.live.start import PursuerStart
from tests.golden import golden

STARTS = [PursuerStart(("127.0.0.1", 4000), "secret", k, 9, "127.0.0.1") for k in range(2)]


class ChildEndedError(BaseException):
    """Raised where a child would end."""


class System:
    """The calls of the system that a nursery makes.

    `tasks` is what standard input has, in the pieces in which it comes; `child` is the number of the fork in which this
    process is the child; `ends` has, for each look for children that have ended, a child and its status.
    """

    def __init__(self, patch, tasks, ends, child=None):
        self.lines, self._pieces, self._ends, self._child = [], list(tasks), list(ends), child
        self._forks, self._now = 0, 100.0
        for owner, name in (
            *((os, name) for name in ("read", "fork", "waitpid", "kill", "close", "_exit")),
            *((nursery.select, "select"), (nursery.signal, "signal"), (nursery, "monotonic")),
        ):
            patch.setattr(owner, name, getattr(self, name.strip("_")))
        patch.setattr(nursery, "print", self.print, raising=False)
        patch.setattr(nursery.ctypes, "CDLL", lambda name: SimpleNamespace(prctl=partial(self._note, "prctl", name)))

    def _note(self, *words):
        self.lines.append(" ".join(str(getattr(word, "name", word)) for word in words))

    def print(self, *words, flush=False):
        self._note("print", *words, *["at once"] * flush)

    def signal(self, number, handler):
        self._note("signal", number, handler)

    def select(self, readable, _writable, _wrong, patience):
        self._note("select", readable, patience)
        if not readable:
            self._now += patience
        return ([0] if readable and self._pieces else []), [], []

    def read(self, file, length):
        piece = self._pieces[0][:length]
        self._pieces[0] = self._pieces[0][length:]
        if not self._pieces[0] and len(self._pieces) > 1:
            self._pieces.pop(0)
        self._note("read", file, "all" if len(piece) == length else "some" if piece else "none")
        return piece

    def fork(self):
        self._forks += 1
        self._note("fork")
        return 0 if self._forks == self._child else 1000 + self._forks

    def waitpid(self, child, options):
        ended = self._ends.pop(0) if self._ends else (0, 0)
        self._note("waitpid", child, options, "->", *ended)
        return ended

    def kill(self, child, number):
        self._note("kill", child, number)
        self._ends += [(child, 9), (0, 0)]

    def close(self, file):
        self._note("close", file)

    def exit(self, code):
        self._note("exit", code)
        raise ChildEndedError

    def monotonic(self):
        return self._now


def task(run=5, starts=STARTS, path=("here",)):
    """Return the bytes of a task."""
    content = pickle.dumps((run, list(path), cloudpickle.dumps(partial(tuple, (Scenario(), starts)))))
    return len(content).to_bytes(8, "big") + content


def fails(*_):
    raise ValueError("no way")


END = [b""]
SCRIPTS = {
    "both end by themselves": {"tasks": [task(), *END], "ends": [(1002, 0), (1001, 4 << 8), (0, 0)]},
    "a task in pieces": {"tasks": [task()[:5], task()[5:90], task()[90:], *END], "ends": [(1002, 0), (1001, 9)]},
    "no task": {"tasks": END, "ends": []},
    "half a task": {"tasks": [task()[:-1], *END], "ends": []},
    "half a length": {"tasks": [task()[:7], *END], "ends": []},
    "a second task, of which half comes": {
        "tasks": [task(), task()[:-1], *END],
        "ends": [(0, 0), (1002, 0), (1001, 0)],
    },
    "one hangs": {"tasks": [task(), *END], "ends": [(0, 0), (1001, 0), (0, 0)]},
    "the child": {"tasks": [task(), *END], "ends": [], "child": 2},
    "a child that raises": {"tasks": [task(), *END], "ends": [], "child": 1, "play": fails},
}


@pytest.mark.parametrize("name", SCRIPTS)
def test_the_calls_of_a_nursery_are_golden(name, monkeypatch, capsys):
    script = dict(SCRIPTS[name])
    play = script.pop("play", lambda scenario, start: 40 + start.pursuer * isinstance(scenario, Scenario))
    made = []
    with monkeypatch.context() as patch:
        patch.setattr(sys, "path", list(sys.path))
        patch.setattr(sys, "platform", "linux")
        patch.setattr(nursery, "POLL", 0.75)
        patch.setattr(node_module, "Node", lambda *args: made.append(args))
        patch.setattr(pursuer, "play", play)
        system = System(patch, **script)
        with suppress(ChildEndedError):
            serve()
        if made:
            assert sys.path == ["here"]
            assert [args[1:] for args in made] == [(0, 9)]
    err = capsys.readouterr().err
    assert ("ValueError: no way" in err) == (name == "a child that raises")
    golden(f"live/nursery/{name.replace(' ', '_')}.txt", "\n".join(system.lines) + "\n")


def test_children_have_some_time_to_end_and_are_looked_for_often():
    assert POLL <= 0.1 < 1.0 <= GRACE <= 5.0


def test_a_node_that_cannot_be_made_is_left_to_the_pursuers(monkeypatch, capsys):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(node_module, "Node", fails)
    system = System(monkeypatch, [task(), *END], [(1002, 0), (1001, 0)])
    serve()
    assert system.lines.count("fork") == 2
    told = [line for line in system.lines if line.startswith("print")]
    assert told == ["print 5 1 0 at once", "print 5 0 0 at once"]
    assert capsys.readouterr().err == ""


# The caller of the nursery.


class Process:
    """The process of a nursery that prints lines; `is_gone` says whether its standard input is broken."""

    def __init__(self, is_gone=False):
        self.stdout, self.stdin, self.written = asyncio.StreamReader(), self, b""
        self.is_closed, self.was_waited_for, self._is_gone, self.drained = False, False, is_gone, 0

    def write(self, data):
        self.written += data

    async def drain(self):
        self.drained += 1
        await asyncio.sleep(0)
        if self._is_gone:
            raise ConnectionResetError

    def close(self):
        self.is_closed = True
        self.stdout.feed_eof()

    async def wait(self):
        assert self.is_closed
        self.was_waited_for = True


def begun(monkeypatch, process):
    """Return the arguments with which the process of a nursery is started from now on."""
    calls = []

    async def create(*words, **options):
        calls.append((words, options))
        return process

    monkeypatch.setattr(asyncio, "create_subprocess_exec", create)
    return calls


def test_a_caller_hands_over_tasks_and_hears_of_each_end_once(monkeypatch):
    ends = []

    async def play():
        process = Process()
        calls = begun(monkeypatch, process)
        async with Nursery() as nurse:
            await nurse.start(Scenario(), STARTS, lambda *end: ends.append(("first", *end)))
            await nurse.start(Scenario(seed=3), STARTS[:1], lambda *end: ends.append(("second", *end)))
            process.stdout.feed_data(b"1 0 -9\n0 1 4\n")
            await asyncio.sleep(0.001)
            assert ends == [("second", 0, -9), ("first", 1, 4)]
        assert process.was_waited_for
        assert process.drained == 2
        assert ends[2:] == [("first", 0, None)]
        return calls, process.written

    ((words, options),), written = asyncio.run(play())
    assert words == (sys.executable, "-m", "desim.live.nursery")
    assert options == {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "start_new_session": True}
    runs = []
    while written:
        length = int.from_bytes(written[:8], "big")
        run, path, packed = pickle.loads(written[8 : 8 + length])
        assert path == sys.path
        runs.append((run, *pickle.loads(packed)()))
        written = written[8 + length :]
    assert runs == [(0, Scenario(), STARTS), (1, Scenario(seed=3), STARTS[:1])]


def test_a_nursery_that_has_ended_loses_all_pursuers(monkeypatch):
    ends = []

    async def play():
        process = Process(is_gone=True)
        begun(monkeypatch, process)
        async with Nursery() as nurse:
            process.stdout.feed_eof()
            await asyncio.sleep(0.001)
            await nurse.start(Scenario(), STARTS, lambda *end: ends.append(end))
            assert ends == [(0, None), (1, None)]

    asyncio.run(play())
    assert len(ends) == 2


def test_a_system_that_cannot_fork_is_told(monkeypatch):
    monkeypatch.delattr(os, "fork")
    with pytest.raises(OSError, match=r"^desim live needs a system with fork, such as Linux or macOS$"):
        asyncio.run(Nursery().__aenter__())

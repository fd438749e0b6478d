"""Small sweeps, their failures and workers: what the tests of many runs share."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

from desim.config.interrupts import SIGNALS

ROOT = Path(__file__).parents[2]
MARK = "SWEEP_OF_A_TEST"
"""A variable of the environment by which all processes of a test are known."""
LONG_ENOUGH = 60.0
"""How long a process may outlive what it works for, s."""

# Chance in the positions, the start, the slots, the decisions, the losses and the latencies.
SCENARIO = """\
name = "coins"
horizon = 1.0
team = {{ count = 3, active_at_start = 0.5 }}
motion.step = 0.1
record.trajectory = 0.0

[protocol]
kind = "my_rules:Coin"
schedule = {{ kind = "poisson", rate = 5.0 }}
pause = {pause}
bad = {bad}
how = "{how}"

[network]
latency = {{ kind = "lognormal", mean = 0.05, cv = 0.5 }}
loss = {{ kind = "bernoulli", p = 0.1 }}

[sweep]
reps = {reps}
grid = {{ "network.loss.p" = {losses} }}
"""
RULES = '''\
"""A rule of one's own, which takes its time and goes wrong with some seeds."""

import time
from threading import Event

from my_trouble import trouble
from protocols.rule import Rule


class Coin(Rule):
    """Chases by the toss of a coin."""

    pause: float = 0.0
    bad: tuple[int, ...] = ()
    how: str = ""

    def actions(self, me):
        """Pause and go wrong at the first turn of the first pursuer, s of wall time."""
        if me.id == 0:
            Event().wait(self.pause)  # a rule that calls time.sleep is warned of
            if me.rng.bit_generator.seed_seq.entropy in self.bad:
                trouble(self.how)
        while True:
            yield int(me.rng.random() < 0.5)
'''
TROUBLE = '''\
"""Ways to go wrong, in a module that the rule imports."""

import os
import signal
import sys
import threading


class PickyError(Exception):
    """Cannot be made again from its arguments."""

    def __init__(self, one, other):
        super().__init__(f"{one} and {other}")


class StubbornError(Exception):
    """Cannot be pickled."""

    def __init__(self, text):
        super().__init__(text)
        self.lock = threading.Lock()


class WildError(BaseException):
    """Is no Exception."""


def deeper():
    """Call itself without end."""
    return deeper()


def throw(error):
    """Raise what cannot be raised in an expression."""
    raise error


WAYS = {
    "exit": lambda: os._exit(7),
    "leave": lambda: os._exit(0),
    "kill": lambda: signal.raise_signal(signal.SIGKILL),
    "raise": lambda: throw(ValueError("seventh heaven")),
    "picky": lambda: throw(PickyError("this", "that")),
    "stubborn": lambda: throw(StubbornError("no pickle")),
    "wild": lambda: throw(WildError("whoa")),
    "quit": lambda: sys.exit(4),
    "recursion": deeper,
    "memory": lambda: throw(MemoryError()),
    "huge": lambda: bytearray(1 << 60),
}


def trouble(how):
    """Go wrong in one of the ways."""
    WAYS[how]()
'''


def write(folder, pause=0.0, bad=(), how="", reps=20, losses=(0.0, 0.3)):
    """Write a scenario and its modules to a folder; return the file."""
    folder.mkdir(exist_ok=True)
    (folder / "my_rules.py").write_text(RULES)
    (folder / "my_trouble.py").write_text(TROUBLE)
    file = folder / "coins.toml"
    file.write_text(SCENARIO.format(pause=pause, bad=list(bad), how=how, reps=reps, losses=list(losses)))
    return file


def rows(path, root=None):
    """Return all runs and configurations of a store, in their order."""
    with closing(sqlite3.connect(path)) as database:
        (sound,) = database.execute("PRAGMA integrity_check").fetchone()
        assert sound == "ok"
        order = "ORDER BY configuration, root_seed, replication"
        configurations = database.execute("SELECT * FROM configurations ORDER BY place").fetchall()
        return configurations, database.execute(f"SELECT * FROM runs {order}").fetchall()


def count(path):
    """Return how many runs there are in a store that someone writes, 0 if there is none."""
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
            return database.execute("SELECT count(*) FROM runs").fetchone()[0]
    except sqlite3.Error:
        return 0


def start(*args, mark, program="desim", prepare=lambda: None, **options):
    """Start a program in a process group of its own, all of whose processes bear a mark.

    In it interrupts are enabled, which background processes inherit as ignored.
    """

    def begin():
        for number in SIGNALS:
            signal.signal(number, signal.SIG_DFL)
        prepare()

    return subprocess.Popen(
        [sys.executable, "-m", program, *map(str, args)],
        env={**os.environ, MARK: mark, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=begin,
        **options,
    )


def await_workers(address, count):
    """Wait until a Dask scheduler has some workers, be they new or in place of others that died."""
    from distributed import Client

    with Client(address) as client:
        client.wait_for_workers(count, timeout=900)


def marked(mark):
    """Return the processes that bear a mark and are no zombies: number and command line."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                found[int(folder.name)] = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:  # it is gone, or belongs to no driver
            continue
    return {number: line for number, line in found.items() if line}


def survivors(mark, within=LONG_ENOUGH):
    """Return the marked processes that are still there after some time; none as soon as there are none, s."""
    end = time.monotonic() + within
    while (found := marked(mark)) and time.monotonic() < end:
        time.sleep(0.05)
    return found

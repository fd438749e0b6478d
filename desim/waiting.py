"""What the pursuers of a simulation wait for: why it is stuck, or takes so long."""

from collections.abc import Mapping, Sequence
from linecache import getline
from types import GeneratorType
from typing import Any

import simpy

from desim.kernel.clock import Clock, seconds
from desim.timeout import TimedOut, place_of, short

MOST = 100
"""How many processes are told of."""


def stuck(env: Clock, error: TimedOut, processes: Mapping[int, Sequence[simpy.Process]]) -> TimedOut:
    """Return the error of a simulation that took too long: where it was, and what each pursuer waits for.

    Args:
        env: its clock.
        error: as it was raised.
        processes: of each pursuer; one may run another by hand, its `behaviour`.
    """
    due = {id(event): int(when) for when, _, _, event in env._queue}
    alive = [(pursuer, each) for pursuer, several in processes.items() for each in several if each.is_alive]
    head = f"at {seconds(env.now):.9g} s of simulated time, in {place_of(error)}; {len(alive):,} processes wait"
    lines = [f"pursuer {pursuer}: {_line(each)}{_until(each, due)}" for pursuer, each in alive[:MOST]]
    more = [f"... and {len(alive) - MOST:,} more"] if len(alive) > MOST else []
    return TimedOut("\n  ".join([head, *lines, *more]))


def _line(process: simpy.Process) -> str:
    """Return where a process is, in the innermost of what it runs, and what is written there."""
    at: Any = process._generator
    inner = getattr(process, "behaviour", None) or at.gi_yieldfrom
    while isinstance(inner, GeneratorType) and inner.gi_frame is not None:
        at, inner = inner, inner.gi_yieldfrom
    file, line = at.gi_code.co_filename, at.gi_frame.f_lineno
    return f"{short(file)}:{line} ({at.gi_code.co_qualname}): {getline(file, line).strip()}"


def _until(process: simpy.Process, due: Mapping[int, int]) -> str:
    """Return when what a process waits for comes, if that is known: the first of several events."""
    target = process.target
    times = [due[id(each)] for each in getattr(target, "_events", [target]) if id(each) in due]
    return f", at {seconds(min(times)):.9g} s" if times else ""

"""Functions that measure time and memory, and a table of the results.

`per_unit` runs variants of a function in turn and returns their CPU times, `memory` returns the memory of this process,
`apart` calls a function in a new process, and `command` times a Python command.
"""

import gc
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from math import nan
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import TypeVar

from desim.analysis.tables import aligned, number

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Cost:
    """A measured cost and its upper limit; without a limit, `limit` is None."""

    what: str
    measured: float
    unit: str
    limit: float | None = None


def table(parts: Mapping[str, Sequence[Cost]]) -> str:
    """Return all costs as text, a section per part.

    A cost with a limit is marked if it is above the limit or nan.
    """
    rows = [("", "measured", "at most", "", "")]
    for part, costs in parts.items():
        rows.append((part, "", "", "", ""))
        for cost in costs:
            limit = "" if cost.limit is None else f"{cost.limit:g}"
            missed = "MISSED" if cost.limit is not None and not cost.measured <= cost.limit else ""
            rows.append((f"  {cost.what}", number(cost.measured), limit, cost.unit, missed))
    return aligned(rows)


def apart(function: Callable[..., Answer], *arguments: object) -> Answer:
    """Call a module-level function in a new process and return its result."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
        return fresh.submit(function, *arguments).result()


def memory(field: str) -> float:
    """Return the current ("VmRSS") or peak ("VmHWM") resident memory, B, of this process; nan unless on Linux."""
    status = Path("/proc/self/status")
    if not status.exists():
        return nan
    (line,) = (line for line in status.read_text().splitlines() if line.startswith(field))
    return 1024.0 * int(line.split()[1])


def per_unit(variants: Mapping[str, Callable[[int], int]], seeds: Sequence[int]) -> dict[str, float]:
    """Run the variants in turn, each once per seed, and return the median CPU time per unit, s, of each variant.

    A variant is called with a seed and returns the number of units that it processed, for example messages.
    """
    laps: dict[str, list[float]] = {name: [] for name in variants}
    for seed in seeds:
        for name, variant in variants.items():
            gc.collect()
            begin = time.process_time()
            units = variant(seed)
            laps[name].append((time.process_time() - begin) / units)
    return {name: median(times) for name, times in laps.items()}


def command(*arguments: str) -> float:
    """Run Python with these arguments and return the wall time, s.

    Raises:
        CalledProcessError: if the exit code of Python is not 0.
    """
    begin = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
    return time.perf_counter() - begin

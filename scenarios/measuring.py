"""How the costs are measured and shown: by laps in turn, in a process of their own, or as a command."""

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
class MessageCost:
    """Something that was measured, and what it may be at most."""

    what: str
    measured: float
    unit: str
    most: float | None = None


def table(found: Mapping[str, Sequence[MessageCost]]) -> str:
    """Return all costs as text."""
    rows = [("", "measured", "at most", "", "")]
    for part, costs in found.items():
        rows.append((part, "", "", "", ""))
        for each in costs:
            most = "" if each.most is None else f"{each.most:g}"
            missed = "MISSED" if each.most is not None and not each.measured <= each.most else ""
            rows.append((f"  {each.what}", number(each.measured), most, each.unit, missed))
    return aligned(rows)


def apart(function: Callable[..., Answer], *given: object) -> Answer:
    """Call a function of a module in a fresh process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
        return fresh.submit(function, *given).result()


def memory(what: str) -> float:
    """Return the resident memory of this process now (VmRSS) or at its peak (VmHWM), B; nan where Linux is not."""
    status = Path("/proc/self/status")
    if not status.exists():
        return nan
    (line,) = (line for line in status.read_text().splitlines() if line.startswith(what))
    return 1024.0 * int(line.split()[1])


def per_unit(ways: Mapping[str, Callable[[int], int]], seeds: Sequence[int]) -> dict[str, float]:
    """Return the time that each way takes for each of the units of which it returns the number, s; the ways in turn."""
    laps: dict[str, list[float]] = {name: [] for name in ways}
    for seed in seeds:
        for name, way in ways.items():
            gc.collect()
            begin = time.process_time()
            units = way(seed)
            laps[name].append((time.process_time() - begin) / units)
    return {name: median(found) for name, found in laps.items()}


def command(*words: str) -> float:
    """Return how long Python takes to run something, s."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, *words], check=True, capture_output=True)
    return time.perf_counter() - begin

"""Metrics of captures and of the end of a run: when, and by whom."""

from math import nan

from desim.analysis.trace_index import captures, ended
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.units import seconds
from desim.simulation.run import Result


def captured(result: Result) -> bool:
    """Return whether enough evaders were captured to end the run (`capture.captures_to_end`, by default all)."""
    return ended(result).reason == "captured"


def capture_time(result: Result) -> float | None:
    """Return the time, s, of the capture that ended the run; None if the run ended otherwise."""
    return end_time(result) if captured(result) else None


def end_time(result: Result) -> float:
    """Return the time, s, at which the run ended: by a capture, at the horizon, or by a watcher."""
    return seconds(ended(result).t)


def mean_capture_time(result: Result) -> float:
    """Return the time of capture, s, averaged over the captured evaders; nan if none was captured."""
    times = [seconds(capture.t) for capture in captures(result)]
    return portable_sum(times) / len(times) if times else nan


def capture_times(result: Result) -> dict[str, float]:
    """Return the capture time, s, of each captured evader by its number (a string), in order of time."""
    return {str(capture.evader): seconds(capture.t) for capture in captures(result)}


def capturers(result: Result) -> dict[str, int]:
    """Return the pursuer that made each capture, by the number of the evader (a string), in order of time."""
    return {str(capture.evader): capture.capturer for capture in captures(result)}

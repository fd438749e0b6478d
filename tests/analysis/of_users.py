"""Metrics as a user writes them in a module."""

from desim.analysis.metrics import Metric, active_time


def half(result):
    """Return half of the active time, s."""
    return active_time(result) / 2.0


def of_two(result, more):
    """Is called with too many arguments to be a metric."""


def wrong(result):
    """Fail for seeds that are a multiple of 3."""
    if result.seed % 3 == 0:
        raise ValueError("not today")
    return 1.0


speed = Metric(half, "m/s", "fast", label="my speed")

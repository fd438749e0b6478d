"""Units of time: the kernel counts integer nanoseconds, and its interfaces have seconds."""

from math import floor, log10

SECOND = 1_000_000_000
"""Nanoseconds in a second."""


def nanoseconds(seconds: float) -> int:
    """Return a duration in seconds as the nearest whole number of nanoseconds."""
    return round(seconds * SECOND)


def seconds(nanoseconds: int) -> float:
    """Return a duration in nanoseconds as seconds."""
    return nanoseconds / SECOND


def time_text(nanoseconds: int, span: int | None = None) -> str:
    """Return a time in s as text: with two decimals, and below 0.1 s with more, so that it has two significant digits.

    For example 2.05, 0.05 as 0.050 and 200 us as 0.00020. With a span (ns), it has the decimals of the span instead:
    give the end of a run for all times of the run.
    """
    size = seconds(nanoseconds if span is None else span)
    return f"{seconds(nanoseconds):.{max(2, 1 - floor(log10(size))) if size > 0.0 else 2}f}"

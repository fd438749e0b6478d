"""Units of time: the kernel counts integer nanoseconds, and its interfaces have seconds."""

SECOND = 1_000_000_000
"""Nanoseconds in a second."""


def nanoseconds(seconds: float) -> int:
    """Return a duration in seconds as the nearest whole number of nanoseconds."""
    return round(seconds * SECOND)


def seconds(nanoseconds: int) -> float:
    """Return a duration in nanoseconds as seconds."""
    return nanoseconds / SECOND

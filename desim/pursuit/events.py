"""What can happen in a pursuit; the events of the network are in `desim.kernel.events`."""

from typing import Literal, NamedTuple


class Started(NamedTuple):
    """The pursuit began."""

    t: int
    evader: tuple[float, float]
    """m"""
    pursuers: tuple[tuple[float, float], ...]
    """m"""
    speeds: tuple[float, ...]
    """m/s"""
    active: tuple[int, ...]
    """What each pursuer does, as in `Decided`."""
    others: tuple[tuple[float, float], ...] = ()
    """The evaders 2 .. M, m."""

    @property
    def evaders(self) -> tuple[tuple[float, float], ...]:
        """(M,) positions of the evaders, m."""
        return self.evader, *self.others


class Decided(NamedTuple):
    """A pursuer revised its action, whether or not it changed."""

    t: int
    pursuer: int
    active: int
    """Which evader it chases, 1 .. M, or 0."""


class Halted(NamedTuple):
    """A pursuer that was active broke down."""

    t: int
    pursuer: int


class Sampled(NamedTuple):
    """Where everyone was."""

    t: int
    evader: tuple[float, float]
    """m"""
    pursuers: tuple[tuple[float, float], ...]
    """m"""
    others: tuple[tuple[float, float], ...] = ()
    """The evaders 2 .. M, m; who has been captured is where that happened."""

    @property
    def evaders(self) -> tuple[tuple[float, float], ...]:
        """(M,) positions of the evaders, m."""
        return self.evader, *self.others


class Captured(NamedTuple):
    """One of several evaders was captured, and who chased it stays until it decides anew."""

    t: int
    evader: int
    """1 .. M"""
    capturer: int


class Ended(NamedTuple):
    """The pursuit was over."""

    t: int
    reason: Literal["captured", "horizon", "stopped"]
    capturer: int | None
    """Who captured the evader, or the last of several, if anybody did."""

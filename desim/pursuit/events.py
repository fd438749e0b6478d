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
    active: tuple[bool, ...]


class Decided(NamedTuple):
    """A pursuer revised its action, whether or not it changed."""

    t: int
    pursuer: int
    active: bool


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


class Ended(NamedTuple):
    """The pursuit was over."""

    t: int
    reason: Literal["captured", "horizon", "stopped"]
    capturer: int | None
    """Who captured the evader, if anybody did."""

"""What can happen in a pursuit; the events of the network are in `desim.kernel.events`."""

from typing import Annotated, Literal, NamedTuple

from desim.kernel.events import Nanoseconds, NodeId

Point = tuple[float, float]
"""m"""
Evader = Annotated[int, "evader"]
"""The number of an evader, 1 .. M."""
Action = Annotated[int, "action"]
"""Which evader a pursuer chases, 1 .. M, or 0."""
# Tuples of one entry for each pursuer, and of the places of the evaders 2 .. M.
Points = Annotated[tuple[Point, ...], "pursuers"]
Speeds = Annotated[tuple[float, ...], "pursuers"]
Actions = Annotated[tuple[Action, ...], "pursuers"]
Others = Annotated[tuple[Point, ...], "others"]


class Started(NamedTuple):
    """The pursuit began."""

    t: Nanoseconds
    evader: Point
    """m"""
    pursuers: Points
    """m"""
    speeds: Speeds
    """m/s"""
    active: Actions
    """What each pursuer does, as in `Decided`."""
    others: Others = ()
    """The evaders 2 .. M, m."""

    @property
    def evaders(self) -> tuple[Point, ...]:
        """(M,) positions of the evaders, m."""
        return self.evader, *self.others


class Decided(NamedTuple):
    """A pursuer revised its action, whether or not it changed."""

    t: Nanoseconds
    pursuer: NodeId
    active: Action
    """Which evader it chases, 1 .. M, or 0."""


class BrokeDown(NamedTuple):
    """A pursuer that was active broke down."""

    t: Nanoseconds
    pursuer: NodeId


class Sampled(NamedTuple):
    """Where everyone was."""

    t: Nanoseconds
    evader: Point
    """m"""
    pursuers: Points
    """m"""
    others: Others = ()
    """The evaders 2 .. M, m; who has been captured is where that happened."""

    @property
    def evaders(self) -> tuple[Point, ...]:
        """(M,) positions of the evaders, m."""
        return self.evader, *self.others


class Captured(NamedTuple):
    """One of several evaders was captured, and who chased it stays until it decides anew."""

    t: Nanoseconds
    evader: Evader
    """1 .. M"""
    capturer: NodeId


class Ended(NamedTuple):
    """The pursuit was over."""

    t: Nanoseconds
    reason: Literal["captured", "horizon", "stopped"]
    capturer: NodeId | None
    """Who captured the evader, or the last of several, if anybody did."""

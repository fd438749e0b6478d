"""Events of a pursuit in the trace; the events of the network are in `desim.kernel.core.events`."""

from typing import Annotated, Literal, NamedTuple

from desim.kernel.core.events import Nanoseconds, NodeId

TracePoint = tuple[float, float]
"""m"""
# The string in an annotation is a mark, by which trace files are validated; see `desim.kernel.core.events`.
EvaderNumber = Annotated[int, "evader"]
"""The number of an evader, 1 .. M."""
Action = Annotated[int, "action"]
"""The evader that a pursuer chases, 1 .. M, or 0 if it is inactive."""
# Tuples with one entry for each pursuer, or for each evader.
PursuerPoints = Annotated[tuple[TracePoint, ...], "pursuers"]
PursuerSpeeds = Annotated[tuple[float, ...], "pursuers"]
PursuerActions = Annotated[tuple[Action, ...], "pursuers"]
EvaderPoints = Annotated[tuple[TracePoint, ...], "evaders"]
FORMAT = 2
"""The format number of traces. It changes when the fields of an event change."""


class Started(NamedTuple):
    """The pursuit began."""

    t: Nanoseconds
    evaders: EvaderPoints
    """m"""
    pursuers: PursuerPoints
    """m"""
    speeds: PursuerSpeeds
    """m/s"""
    active: PursuerActions
    """The action of each pursuer, as in `Decided`."""
    format: Annotated[int, "format"] = FORMAT


class Decided(NamedTuple):
    """A pursuer revised its action; the new action may equal the old one."""

    t: Nanoseconds
    pursuer: NodeId
    active: Action
    """The new action: the evader that it chases, 1 .. M, or 0."""


class BrokeDown(NamedTuple):
    """An active pursuer broke down."""

    t: Nanoseconds
    pursuer: NodeId


class Sampled(NamedTuple):
    """A sample of all positions."""

    t: Nanoseconds
    evaders: EvaderPoints
    """m; a captured evader stays where it was captured."""
    pursuers: PursuerPoints
    """m"""


class Estimated(NamedTuple):
    """A sample of the position of an evader as a pursuer estimates it, from the reports that it has read."""

    t: Nanoseconds
    pursuer: NodeId
    evader: EvaderNumber
    x: float
    """m"""
    y: float
    """m"""
    xx: float
    """Variance of x, m^2."""
    xy: float
    """Covariance of x and y, m^2."""
    yy: float
    """Variance of y, m^2."""


class Captured(NamedTuple):
    """An evader was captured; the pursuers that chased it are inactive until they decide again."""

    t: Nanoseconds
    evader: EvaderNumber
    """1 .. M"""
    capturer: NodeId


class Distrusted(NamedTuple):
    """A pursuer began, or stopped, to distrust the announcements of a teammate."""

    t: Nanoseconds
    pursuer: NodeId
    suspect: NodeId
    distrusted: bool
    """Whether it began."""


class Ended(NamedTuple):
    """The pursuit ended."""

    t: Nanoseconds
    reason: Literal["captured", "horizon", "stopped"]
    capturer: NodeId | None
    """The pursuer whose capture ended the pursuit; None if the pursuit ended otherwise."""

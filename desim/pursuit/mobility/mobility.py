"""The recorded motion of nodes, as a mobility file of any format describes it; see `mobility_file`."""

from collections.abc import Iterable
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import NamedTuple

from desim.config.model import MAX_COORDINATE, MAX_TIME
from desim.config.number_files import converted, is_fill, number_of
from desim.config.suggestion import did_you_mean
from desim.kernel.core.units import nanoseconds
from desim.kernel.measured.measurements import LIKE_NUMBER, Unit, hint_of_zones, time_of

MAX_NAMES = 10
"""Maximum number of nodes listed in an error message."""
NodeName = int | str
"""The number or the name of a node in a file."""


class Waypoint(NamedTuple):
    """A position that a node has at a time."""

    t: float
    """s"""
    x: float
    """m"""
    y: float
    """m"""
    line: int
    """The line of the file that it is from."""


class NodeTrack(NamedTuple):
    """The recorded motion of one node."""

    waypoints: list[Waypoint]
    """The waypoints; their times increase."""
    has_heights: bool
    """Whether the file says that the node is not at height 0."""


class MobilityFile:
    """The nodes of a mobility file.

    Args:
        file: the path.
        nodes: the nodes in the order of the file, ascending if they are numbers.
    """

    def __init__(self, file: Path, nodes: Iterable[NodeName]):
        self.file = file
        self.nodes = tuple(nodes)

    def track(self, node: NodeName) -> NodeTrack:
        """Return the motion of a node: one of `nodes` or, if these are names, also the index of a name.

        Raises:
            ValueError: if there is no such node, or a line about the node is not valid; the message names the file and
                the line.
        """
        names = [name for name in self.nodes if isinstance(name, str)]
        if isinstance(node, int) and node < len(names):
            if len(names) > 1 and any(map(LIKE_NUMBER.fullmatch, names)):
                shown = ", ".join(repr(name) for name in names[:MAX_NAMES])
                raise ValueError(f"{self.file}: node {node} is not clear, because names look like numbers: {shown}")
            node = names[node]
        if node not in self.nodes:
            raise ValueError(self._lacks(node))
        return self._track(node)

    def _track(self, node: NodeName) -> NodeTrack:
        raise NotImplementedError

    def _lacks(self, node: NodeName) -> str:
        """Return the message that the file has no such node."""
        names, count = list(map(str, self.nodes)), len(self.nodes)
        hint = did_you_mean(node, names) if isinstance(node, str) else ""
        if self.nodes == tuple(range(count)) and count > 1:
            which = f"nodes 0 to {count - 1}"
        else:
            which = (
                f"node{'s' if count > 1 else ''} {', '.join(names[:MAX_NAMES])}{', ...' if count > MAX_NAMES else ''}"
            )
        return f"{self.file} has no node {node}{hint}: it has {which if names else 'no nodes'}"


def append(waypoints: list[Waypoint], new: Waypoint, place: str) -> None:
    """Append a waypoint, unless it repeats the last one.

    Raises:
        ValueError: if its time is not later, or its position stands for a missing one.
    """
    if new.x == new.y and is_fill(new.x):
        raise ValueError(f"{place}: ({new.x:g}, {new.y:g}) probably stands for a missing position: leave it out")
    if waypoints and nanoseconds(new.t) <= nanoseconds(waypoints[-1].t):
        if new[:3] == waypoints[-1][:3]:
            return
        raise ValueError(f"{place}: the times of a node should increase; after {waypoints[-1].t:g} s comes {new.t:g} s")
    waypoints.append(new)


def time(text: str, place: str, start: Decimal = Decimal(0), unit: Unit = "s") -> float:
    """Return the simulation time, s, for a time in a file; the simulation begins at the time `start` of the file, s.

    Raises:
        ValueError: if the text is not a time, or is not from 0 to `MAX_TIME`.
    """
    elapsed = float(converted(partial(time_of, unit=unit), text, place) - start)
    return _within(elapsed, text, place, "a time", 0.0, MAX_TIME, "s", hint_of_zones([text]))


def coordinate(text: str, place: str) -> float:
    """Return a coordinate, m; raise ValueError if the text is none."""
    return _within(converted(number_of, text, place), text, place, "a coordinate", -MAX_COORDINATE, MAX_COORDINATE, "m")


def speed(text: str, place: str) -> float:
    """Return a speed, m/s; raise ValueError if the text is none."""
    return _within(converted(number_of, text, place), text, place, "a speed", 0.0, MAX_COORDINATE, "m/s")


def _within(
    number: float, text: str, place: str, quantity: str, low: float, high: float, unit: str, hint: str = ""
) -> float:
    if not low <= number <= high:
        raise ValueError(f"{place}: {quantity} should be from {low:g} to {high:g} {unit} (got {text}){hint}")
    return number

"""Mobility files: the recorded motion of one node, from a file of BonnMotion or ns-2.

A file of BonnMotion (Aschenbruck et al. 2010, "BonnMotion: A Mobility Scenario Generation and Analysis Tool") has one
line for each node. The node is at (x1, y1) at time t1, and moves straight and at constant speed from each position to
the next; a pause is a repeated position. Lines that begin with `#` are comments.

    t1 x1 y1 t2 x2 y2 ...

A file of ns-2 (Fall & Varadhan 2011, "The ns Manual", "Mobile Networking in ns") is a Tcl script. Two statements are
read, with numbers only; statements about anything else are ignored, and so is the coordinate Z_. At time 2.0, the node
of the example begins to move towards (50, 20) at 5 m/s. After its arrival it stands there. Another `setdest` replaces
this one, also before the arrival, and a speed of 0 stops the node.

    $node_(0) set X_ 10.0
    $ns_ at 2.0 "$node_(0) setdest 50.0 20.0 5.0"
"""

import re
from collections.abc import Iterator, Sequence
from math import hypot
from pathlib import Path
from typing import NamedTuple

from desim.config.model import MAX_COORDINATE, MAX_TIME
from desim.config.number_files import number_of, text_of_file
from desim.kernel.units import nanoseconds


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


def read_waypoints(file: Path, node: int) -> list[Waypoint]:
    """Return the waypoints of a node in a mobility file; their times increase.

    Raises:
        ValueError: if the file cannot be read, has no such node, or a line of the node is not valid; the message names
            the file and the line.
    """
    lines = text_of_file(file).split("\n")
    read = _ns2 if any("$node_(" in line for line in lines) else _bonnmotion
    return read(file, lines, node)


def _bonnmotion(file: Path, lines: Sequence[str], node: int) -> list[Waypoint]:
    """Return the waypoints of a node in the lines of a file of BonnMotion."""
    own = [(number, row) for number, line in enumerate(lines, 1) if (row := line.split()) and row[0][0] != "#"]
    if node >= len(own):
        raise ValueError(_no_node(file, node, range(len(own))))
    line, row = own[node]
    place = f"{file}, line {line}"
    if len(row) % 3:
        raise ValueError(f"{place}: should be t1 x1 y1 t2 x2 y2 ..., three numbers each; there are {len(row)}")
    found: list[Waypoint] = []
    for k in range(0, len(row), 3):
        new = Waypoint(_time(row[k], place), _coordinate(row[k + 1], place), _coordinate(row[k + 2], place), line)
        if found and nanoseconds(new.t) <= nanoseconds(found[-1].t):
            if new == found[-1]:
                continue
            raise ValueError(f"{place}: the times of a node should increase; after {found[-1].t:g} s comes {new.t:g} s")
        found.append(new)
    return found


START = re.compile(r"\$node_\((\d+)\)\s+set\s+([XYZ])_\s+(\S+?)\s*;?")
MOVE = re.compile(r'\$ns_?\s+at\s+(\S+)\s+"\s*\$node_\((\d+)\)\s+setdest\s+(\S+)\s+(\S+)\s+(\S+?)\s*"\s*;?')
MOTION = re.compile(r"\bsetdest\b|\bset\s+[XYZ]_")
"""Matches a statement about the motion of a node, of whatever form."""


class _Move(NamedTuple):
    """A statement `setdest`: at a time (s), a node heads for a position (m) at a speed (m/s)."""

    t: float
    x: float
    y: float
    speed: float
    line: int


def _ns2(file: Path, lines: Sequence[str], node: int) -> list[Waypoint]:
    """Return the waypoints of a node in the lines of a file of ns-2."""
    starts: dict[int, dict[str, tuple[float, int]]] = {}
    moves: list[_Move] = []
    for number, line in enumerate(map(str.strip, lines), 1):
        if line.startswith("#") or not MOTION.search(line):
            continue
        place = f"{file}, line {number}"
        if start := START.fullmatch(line):
            starts.setdefault(int(start[1]), {})[start[2]] = _coordinate(start[3], place), number
        elif move := MOVE.fullmatch(line):
            target = _coordinate(move[3], place), _coordinate(move[4], place)
            if int(move[2]) == node:
                moves.append(_Move(_time(move[1], place), *target, _speed(move[5], place), number))
        else:
            forms = '$node_(0) set X_ 10.0, or $ns_ at 2.0 "$node_(0) setdest 50.0 20.0 5.0", with numbers only'
            raise ValueError(f"{place}: should have the form {forms}")
    if node not in starts:
        raise ValueError(_no_node(file, node, sorted(starts)))
    if lacking := [axis for axis in "XY" if axis not in starts[node]]:
        raise ValueError(f"{file}: node {node} has no initial position: $node_({node}) set {lacking[0]}_ is missing")
    (x, _), (y, line_of_start) = starts[node]["X"], starts[node]["Y"]
    return list(_legs(Waypoint(0.0, x, y, line_of_start), sorted(moves, key=lambda move: move.t)))


def _legs(start: Waypoint, moves: Sequence[_Move]) -> Iterator[Waypoint]:
    """Yield the waypoints of a node that begins at `start` and makes some moves, in order of time."""
    yield start
    last, target = start, None
    for move in moves:
        now = nanoseconds(move.t)
        if target is not None and nanoseconds(target.t) <= now:
            yield target
            last, target = target, None
        here = Waypoint(move.t, *_position(last, target, move.t), move.line)
        if nanoseconds(last.t) < now:
            yield here
        last, target = here, _target(here, move)
    if target is not None:
        yield target


def _position(last: Waypoint, target: Waypoint | None, t: float) -> tuple[float, float]:
    """Return the position, m, at a time (s), of a node that moves from one waypoint to another or stays at it."""
    if target is None:
        return last.x, last.y
    share = (t - last.t) / (target.t - last.t)
    return last.x + share * (target.x - last.x), last.y + share * (target.y - last.y)


def _target(here: Waypoint, move: _Move) -> Waypoint | None:
    """Return the waypoint at which a move ends; None if the move takes less than a nanosecond, or has no speed."""
    if move.speed == 0.0:
        return None
    arrival = move.t + hypot(move.x - here.x, move.y - here.y) / move.speed
    is_there = nanoseconds(arrival) == nanoseconds(move.t)
    return None if is_there else Waypoint(arrival, move.x, move.y, move.line)


def _time(text: str, place: str) -> float:
    return _number(text, place, "a time", 0.0, MAX_TIME, "s")


def _coordinate(text: str, place: str) -> float:
    return _number(text, place, "a coordinate", -MAX_COORDINATE, MAX_COORDINATE, "m")


def _speed(text: str, place: str) -> float:
    return _number(text, place, "a speed", 0.0, MAX_COORDINATE, "m/s")


def _number(text: str, place: str, what: str, low: float, high: float, unit: str) -> float:
    """Return the number in a text; raise ValueError unless it is from `low` to `high`."""
    try:
        found = number_of(text)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error
    if not low <= found <= high:
        raise ValueError(f"{place}: {what} should be from {low:g} to {high:g} {unit} (got {text})")
    return found


def _no_node(file: Path, node: int, nodes: Sequence[int]) -> str:
    """Return the error message for a node that a file lacks, given the nodes that it has, in ascending order."""
    which = f"nodes {nodes[0]} to {nodes[-1]}" if len(nodes) > 1 else f"node {nodes[0]}" if nodes else "no nodes"
    return f"{file} has no node {node}: it has {which}"

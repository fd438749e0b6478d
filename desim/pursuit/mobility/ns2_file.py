"""Mobility files of ns-2, Tcl scripts (Fall & Varadhan 2011, "The ns Manual", "Mobile Networking in ns").

Two statements are read, with numbers only; statements about anything else are ignored, and Z_ is dropped. At time 2.0,
the node of the example begins to move towards (50, 20) at 5 m/s. After its arrival it stands there. Another `setdest`
replaces this one, also before the arrival, and a speed of 0 stops the node. The array may have another name.

    $node_(0) set X_ 10.0
    $ns_ at 2.0 "$node_(0) setdest 50.0 20.0 5.0"
"""

import re
from collections.abc import Iterator, Sequence
from math import hypot
from pathlib import Path
from typing import NamedTuple

from desim.config.model import MAX_TIME
from desim.config.number_files import converted
from desim.kernel.core.units import nanoseconds
from desim.kernel.measured.measurements import start_of, time_of
from desim.pursuit.mobility.mobility import MobilityFile, NodeName, NodeTrack, Waypoint, coordinate, speed, time

NODE = r"\$([A-Za-z_]\w*?)(?:\((\d+)\)|(\d+))"
"""Matches a node, its array and its number: $node_(0), $mnode_(0) or $n0."""
START = re.compile(rf"{NODE}\s+set\s+([XYZ])_\s+(\S+)")
"""Matches an initial coordinate; its groups are array, number in brackets or without, axis and coordinate."""
MOVE = re.compile(rf'\$\w+\s+at\s+(\S+)\s+["{{]\s*{NODE}\s+setdest\s+([^"}}]*?)\s*["}}]')
"""Matches a move; its groups are time, array, number in brackets or without, and the numbers of the move."""
MOTION = re.compile(r"\bsetdest\b|\bset\s+[XYZ]_(?!\w)")
"""Matches a statement about the motion of a node, of whatever form."""
OF_CLASS = re.compile(r"\w+(?:/\w+)+\s+set\b")
"""Matches a statement about all objects of a class, as in `Antenna/OmniAntenna set X_ 0`."""
STATEMENT = re.compile(r'(?:"[^"]*"|[^;"])+')
"""Matches a statement of a line; a semicolon ends it."""
FORMS = '$node_(0) set X_ 10.0, or $ns_ at 2.0 "$node_(0) setdest 50.0 20.0 5.0", with numbers only'


def is_ns2(lines: Sequence[str]) -> bool:
    """Return whether a file has statements about the motion of nodes."""
    return any(MOTION.search(line) or line.lstrip().startswith("$") for line in lines)


class Move(NamedTuple):
    """A statement `setdest`: at a time (s), a node heads for a position (m) at a speed (m/s)."""

    t: float
    x: float
    y: float
    speed: float
    line: int


class _Motion(NamedTuple):
    """What a script says about one node."""

    name: str
    """The node as the script writes it, for example $node_(0)."""
    start: dict[str, tuple[float, int]]
    """The initial coordinates, m, and the line of each, by axis."""
    moves: list[tuple[str, Move]]
    """The moves, each with the text of its time; their times are not yet known."""


class Ns2File(MobilityFile):
    """A file of ns-2."""

    def __init__(self, file: Path, lines: Sequence[str]):
        self._motions: dict[int, _Motion] = {}
        self._array = ""
        self.file = file
        for number, statement in _statements(lines):
            self._read(statement, number)
        super().__init__(file, sorted(self._motions))
        moves = [entry for motion in self._motions.values() for entry in motion.moves]
        self._zero = start_of((converted(time_of, text, f"{file}, line {move.line}") for text, move in moves), file)
        for motion in self._motions.values():
            for text, move in motion.moves:
                time(text, f"{file}, line {move.line}", self._zero)

    def _read(self, statement: str, number: int) -> None:
        """Add a statement about the motion of a node."""
        place = f"{self.file}, line {number}"
        if start := START.fullmatch(statement):
            motion, axis = self._motion(start, 1, place), start[4]
            if axis in motion.start:
                node, line = start[2] or start[3], motion.start[axis][1]
                raise ValueError(f"{place}: sets {axis}_ of node {node} again; line {line} has set it")
            motion.start[axis] = coordinate(start[5], place), number
        elif (move := MOVE.fullmatch(statement)) and len(numbers := move[5].split()) in {3, 4}:
            if len(numbers) == 4:
                raise ValueError(
                    f"{place}: a setdest with a height (x y z speed) is not read: motion is in the plane, and without"
                    " the height the speed is another one"
                )
            x, y = coordinate(numbers[0], place), coordinate(numbers[1], place)
            converted(time_of, move[1], place)  # an invalid time is refused here, because its line is known
            self._motion(move, 2, place).moves.append((move[1], Move(0.0, x, y, speed(numbers[2], place), number)))
        else:
            raise ValueError(f"{place}: should have the form {FORMS}")

    def _motion(self, match: re.Match[str], group: int, place: str) -> _Motion:
        """Return the motion of the node that a statement names; its name begins at a group of the match."""
        array, number = match[group], match[group + 1] or match[group + 2]
        name = f"${array}({number})" if match[group + 1] else f"${array}{number}"
        if self._array and array != self._array:
            raise ValueError(f"{place}: names nodes ${array}, and the lines above ${self._array}: one name is read")
        self._array = array
        return self._motions.setdefault(int(number), _Motion(name, {}, []))

    def _track(self, node: NodeName) -> NodeTrack:
        name, start, moves = self._motions[int(node)]
        if lacking := [axis for axis in "XY" if axis not in start]:
            raise ValueError(f"{self.file}: node {node} has no initial position: {name} set {lacking[0]}_ is missing")
        (x, _), (y, line) = start["X"], start["Y"]
        timed = [move._replace(t=time(text, f"line {move.line}", self._zero)) for text, move in moves]
        waypoints = list(legs(Waypoint(0.0, x, y, line), sorted(timed, key=lambda move: move.t)))
        return NodeTrack(waypoints, start.get("Z", (0.0, 0))[0] != 0.0)


def _statements(lines: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of each statement about the motion of a node, without comments."""
    for number, line in enumerate(lines, 1):
        if not MOTION.search(line):
            continue
        for statement in map(str.strip, STATEMENT.findall(line)):
            if statement.startswith("#"):
                break
            if MOTION.search(statement) and not OF_CLASS.match(statement):
                yield number, statement


def legs(start: Waypoint, moves: Sequence[Move]) -> Iterator[Waypoint]:
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


def _target(here: Waypoint, move: Move) -> Waypoint | None:
    """Return the waypoint at which a move ends; None if the move takes less than a nanosecond, or has no speed.

    If a move takes longer than any run can last, this is the position of the node at the end of the longest run.
    """
    if move.speed == 0.0:
        return None
    arrival = move.t + hypot(move.x - here.x, move.y - here.y) / move.speed
    if arrival > MAX_TIME:
        share = (MAX_TIME - move.t) / (arrival - move.t)
        x, y = here.x + share * (move.x - here.x), here.y + share * (move.y - here.y)
        arrival, move = MAX_TIME, move._replace(x=x, y=y)
    is_there = nanoseconds(arrival) == nanoseconds(move.t)
    return None if is_there else Waypoint(arrival, move.x, move.y, move.line)

"""Mobility files of BonnMotion.

A file of BonnMotion (Aschenbruck et al. 2010, "BonnMotion: A Mobility Scenario Generation and Analysis Tool") has one
line for each node. The node is at (x1, y1) at time t1, and moves straight and at constant speed from each position to
the next; a pause is a repeated position. Lines that begin with `#` are comments.

    t1 x1 y1 t2 x2 y2 ...

With heights, each waypoint has four numbers, t x y z. BonnMotion then writes `#3D` in the first line. INET, which reads
such files, does not need it.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Literal

from desim.config.number_files import number_of
from desim.kernel.measured.measurements import start_of, time_of
from desim.pursuit.mobility.mobility import MobilityFile, NodeName, NodeTrack, Waypoint, append, coordinate, time

Dimensions = Literal[2, 3]
"""The number of coordinates of each waypoint of BonnMotion."""
MARKER_3D = re.compile(r"#\s*3D\b", re.IGNORECASE)
"""Matches the first line of a file of BonnMotion with heights."""
MANY = 10
"""From this number of lines on, a file of integers has no waypoints, unless all lines begin, or end, at one time."""


class BonnMotionFile(MobilityFile):
    """A file of BonnMotion: a node is a line that is no comment."""

    def __init__(self, file: Path, lines: Sequence[str], dimensions: Dimensions | None):
        self._rows = [
            (number, row) for number, line in enumerate(lines, 1) if (row := line.split()) and row[0][0] != "#"
        ]
        super().__init__(file, range(len(self._rows)))
        self._is_marked = bool(MARKER_3D.match(lines[0])) if lines else False
        if self._is_marked and dimensions == 2:
            raise ValueError(f"{file}, line 1: {lines[0].strip()} says that dimensions should be 3")
        self._check_is_no_table(dimensions)
        self._width = dimensions + 1 if dimensions is not None else self._likely_width()

    def _check_is_no_table(self, dimensions: Dimensions | None) -> None:
        """Raise ValueError if the lines seem to be the rows of a table that lacks a header.

        This is so in three cases. All lines, except one at most, are one waypoint each, and their times differ: nodes
        that stand still would have equal times. Or all lines are equally long, and with either number of coordinates
        some are no waypoints in order of time. Or at least `MANY` such lines consist of integers and neither begin nor
        end at one time, like lines of contacts. If `dimensions` are given, integers may be coordinates.
        """
        possible = [4] if self._is_marked else [3, 4] if dimensions is None else [dimensions + 1]
        single = [row for row in self._rows if len(row[1]) in possible]
        is_table = len(single) > 2 and len(single) >= len(self._rows) - 1 and len(set(_first_times(single))) > 1
        wrong, advice = single[0] if is_table else None, ""
        lengths = {len(row) for _, row in self._rows}
        if wrong is None and len(self._rows) > 2 and len(lengths) == 1:
            widths = [width for width in possible if not max(lengths) % width]
            unordered = [[row for row in self._rows if not _increase(row[1][::width])] for width in widths]
            if all(unordered):
                wrong = min((rows[0] for rows in unordered), default=self._rows[0])
            elif dimensions is None and not self._is_marked and self._are_integers_apart(widths):
                wrong, advice = self._rows[0], "; if they are waypoints, set dimensions = 2"
        if wrong is not None:
            hint = "; if each line is one waypoint of a table, the first line should name its columns, t, x and y"
            raise ValueError(f"{self.file}, line {wrong[0]}: {SHOULD_BE_TRIPLES}, in order of time{hint}{advice}")

    def _are_integers_apart(self, widths: Iterable[int]) -> bool:
        """Return whether the file is many lines of integers that neither begin nor end at one time.

        Args:
            widths: the possible lengths of a waypoint.
        """
        rows = [row for _, row in self._rows]
        if len(rows) < MANY or not all(cell.isdecimal() for row in rows for cell in row):
            return False
        return all(len({row[k] for row in rows}) > 1 for k in (0, *(-width for width in widths)))

    def _likely_width(self) -> int:
        """Return how many numbers a waypoint has, 3 or 4; raise ValueError if both are possible."""
        if self._is_marked:
            return 4
        if uneven := [(line, len(row)) for line, row in self._rows if len(row) % 3]:
            if not any(len(row) % 4 for _, row in self._rows):
                line, count = uneven[0]
                raise ValueError(f"{self.file}, line {line}: {SHOULD_BE_TRIPLES}; there are {count}{SET_3}")
            return 3
        if any(len(row) % 4 for _, row in self._rows) or not self._rows:
            return 3
        likely = [width for width in (3, 4) if all(_increase(row[::width]) for _, row in self._rows)]
        if len(likely) > 1:
            raise ValueError(
                f"{self.file} can be read with two and with three coordinates for each waypoint: set dimensions = 2"
                " (t x y) or dimensions = 3 (t x y z)"
            )
        return likely[0] if likely else 3

    def _track(self, node: NodeName) -> NodeTrack:
        line, row = self._rows[int(node)]
        place, width = f"{self.file}, line {line}", self._width
        if len(row) % width:
            form = SHOULD_BE_TRIPLES if width == 3 else "should be t1 x1 y1 z1 t2 ..., four numbers each"
            raise ValueError(f"{place}: {form}; there are {len(row)}{SET_3 if width == 3 and not len(row) % 4 else ''}")
        start = start_of(_first_times(self._rows), self.file)
        has_heights, waypoints = False, list[Waypoint]()
        for k in range(0, len(row), width):
            t, x, y = time(row[k], place, start), coordinate(row[k + 1], place), coordinate(row[k + 2], place)
            if width == 4:
                has_heights |= coordinate(row[k + 3], place) != 0.0
            append(waypoints, Waypoint(t, x, y, line), place)
        return NodeTrack(waypoints, has_heights)


SHOULD_BE_TRIPLES = "should be t1 x1 y1 t2 x2 y2 ..., three numbers each"
SET_3 = "; 4 numbers per waypoint? Then set dimensions = 3"


def _first_times(rows: Iterable[tuple[int, Sequence[str]]]) -> Iterator[Decimal]:
    """Yield the first time of each row that begins with a valid one."""
    for _, row in rows:
        try:
            yield time_of(row[0])
        except ValueError:
            continue


def _increase(times: Sequence[str]) -> bool:
    """Return whether texts may be the times of waypoints, of which some may be repeated."""
    try:
        numbers = list(map(number_of, times))
    except ValueError:
        return True  # which says nothing about the number of coordinates
    return (
        numbers[0] >= 0.0
        and all(before <= after for before, after in pairwise(numbers))
        and (len(numbers) == 1 or numbers[0] < numbers[-1])
    )

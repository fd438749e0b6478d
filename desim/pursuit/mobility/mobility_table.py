"""Mobility files that are tables: a header, which names at least the columns t, x and y, and a waypoint in each row.

t,node,x,y
0.0,uav1,10.0,20.0
2.5,uav1,12.0,20.0
"""

import re
from collections.abc import Iterator, Sequence
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import cast

from desim.config.column_names import (
    COLUMNS,
    DEGREES,
    FRACTIONS,
    OF_OTHERS,
    SAME_UNIT,
    TIME_UNITS,
    WHOLE_SECONDS,
    Header,
    header_of,
    joined,
)
from desim.config.number_files import converted, number_of
from desim.config.number_texts import counted
from desim.kernel.measured.csv_tables import rows_of, separator_in, with_points
from desim.kernel.measured.measurements import Unit, clock_unit, start_of, time_of
from desim.pursuit.mobility.mobility import MobilityFile, NodeName, NodeTrack, Waypoint, append, coordinate, time

NUMBER = re.compile(r"[+-]?\d+(?:[.,]\d+)*(?:e[+-]?\d+)?", re.IGNORECASE)
"""Matches a number between spaces, perhaps with commas."""
UNIT_APART = re.compile(r"\s+(?=[\[(])")
"""Matches the space before a unit in brackets; the unit is no cell of its own."""
NO_UNIT = "utc|gmt|date|iso ?8601"
"""Words in brackets after the name of a time that are no unit."""


def header_in(lines: Sequence[str]) -> tuple[int, str, Header] | None:
    """Return the line of a header, from 0, the delimiter of its table ("": white space), and the header.

    The header is a comment, as numpy writes it, or the first line that is no comment. Return None if neither is one.
    """
    for number, line in enumerate(lines):
        text = line.strip()
        if not text:
            continue
        is_comment = text.startswith("#")
        text = text.lstrip("#").strip()
        delimiter = separator_in(text)
        header = header_of(text.split(delimiter) if delimiter else UNIT_APART.sub("", text).split())
        count = sum(bool(header.columns(key)) for key in COLUMNS) + len(DEGREES & set(header.names))
        if count >= (3 if is_comment else 2):
            return number, delimiter, header
        if not is_comment:
            # A line with commas or semicolons may be a header that lacks columns: `MobilityTable` names those it has.
            is_bonnmotion = len(text.split()) > 2 and all(map(NUMBER.fullmatch, text.split()))  # refused by its reader
            return (number, delimiter, header) if delimiter in {",", ";"} and not is_bonnmotion else None
    return None


class MobilityTable(MobilityFile):
    """A table with a waypoint in each row.

    Args:
        file: the path.
        lines: its lines.
        first: the line of the header, from 0; -1 if there is none.
        delimiter: the sign between cells; "": white space.
        header: the header.
        needs_times: whether the table should have times; if not, and it has none, each row is a node at time 0.
    """

    def __init__(
        self,
        file: Path,
        lines: Sequence[str],
        first: int,
        delimiter: str,
        header: Header,
        *,
        needs_times: bool = True,
    ):
        self.file, width = file, len(header.names)
        if not (needs_times or header.columns("t")):
            header = header.extended("t", *([] if header.columns("node") else ["node"]))
        self._header, self._header_line = header, f"{file}, line {first + 1}"
        self._columns = {key: self._column(key) for key in COLUMNS}
        self._check_columns()
        self._t, self._x, self._y = (self._columns[key] or 0 for key in "txy")
        self._check_time_column()
        units = [header.units[k] for k in (self._t, self._x, self._y)]
        rows: list[tuple[int, list[str]]] = []
        for line, cells in self._points(_cells(file, lines, first, delimiter), delimiter):
            if len(cells) != width:
                raise ValueError(f"{file}, line {line}: has {counted(len(cells), 'cell')}, but the header {width}")
            if not rows and self._t < width and cells[self._t].strip().lower() in TIME_UNITS:  # a second line of units
                units = [cells[k].strip() for k in (self._t, self._x, self._y)]
                continue
            # The columns t and node that the header lacks: each row is a node at time 0.
            rows.append((line, [*cells, *["0", str(len(rows))][: len(header.names) - width]]))
        if not rows:
            raise ValueError(f"{file} has no rows below its header")
        self._check_names(rows)
        self._rows = dict[str, list[tuple[int, list[str]]]]()
        for line, cells in rows:
            node = "0" if self._columns["node"] is None else cells[self._columns["node"]].strip()
            self._rows.setdefault(node, []).append((line, cells))
        super().__init__(file, sorted(map(int, self._rows)) if all(map(_is_number, self._rows)) else self._rows)
        self._unit = self._unit_of(units[0], rows[0][1][self._t])
        self._check_units_of_places(units[1:])
        self._check_nodes_have_tracks()

    def _column(self, key: str) -> int | None:
        """Return the index of a column; None if the table lacks it."""
        indices = self._header.columns(key)
        if len(indices) > 1 and key != "z":
            names = [self._header.names[k] for k in indices]
            which = f"several columns {names[0]!r}" if len(set(names)) == 1 else f"columns {' and '.join(names)}"
            raise ValueError(f"{self.file} has {which}: which of them is {key}? Leave out the others")
        return indices[0] if indices else None

    def _points(self, rows: Iterator[tuple[int, list[str]]], delimiter: str) -> Iterator[tuple[int, list[str]]]:
        """Yield rows with decimal points; if no comma separates the cells, these may have decimal commas."""
        if delimiter not in {";", "\t"}:
            return rows
        used = [column for column in self._columns.values() if column is not None]
        return with_points(rows, lambda cells: [cells[k] for k in used if k < len(cells)], str(self.file))

    def _check_columns(self) -> None:
        """Raise ValueError if a column is missing."""
        missing = [key for key in ("t", "x", "y") if self._columns[key] is None]
        if not missing:
            return
        names = self._header.names
        if DEGREES & set(names):
            raise ValueError(f"{self.file} has positions in degrees; project them to m, as columns x and y")
        raise ValueError(
            f"{self._header_line}: has no column {missing[0]}; the first line should name the columns, t, x and y (s,"
            f" m), and those of several nodes also node; it has {', '.join(filter(None, names))}"
        )

    def _check_time_column(self) -> None:
        """Raise ValueError if the column of times has whole seconds, and another one the rest."""
        names = self._header.names
        if (rest := sorted(FRACTIONS & set(names))) and names[self._t] in WHOLE_SECONDS:
            both = f"{names[self._t]} and {rest[0]}"
            raise ValueError(f"{self._header_line}: columns {both} have the time together: give it in one, in s")

    def _check_names(self, rows: Sequence[tuple[int, list[str]]]) -> None:
        """Raise ValueError if it is not clear which column names the nodes; a column that is called node does."""
        names = self._header.names
        if "node" in names:
            return
        candidates = [k for k, name in enumerate(names) if joined(name) in COLUMNS["node"]]
        node_columns = [k for k in candidates if len({cells[k] for _, cells in rows}) > 1]  # equal cells name none
        # Columns agree if each of them alone tells the nodes apart.
        groups = {tuple(cells[k] for k in node_columns) for _, cells in rows}
        if any(len({group[k] for group in groups}) < len(groups) for k in range(len(node_columns))):
            listed = " and ".join(names[k] for k in node_columns)
            raise ValueError(f"{self.file}: the columns {listed} may name the nodes, and differ: leave out all but one")
        if self._columns["node"] is None and (name := _column_of_names(self._header, [cells for _, cells in rows])):
            raise ValueError(
                f"{self.file}: column {name!r} has several texts: if they name the nodes, call it node, else leave it"
                " out"
            )

    def _check_units_of_places(self, units: Sequence[str]) -> None:
        """Raise ValueError if x or y have another unit than m."""
        for k, unit in zip((self._x, self._y), units, strict=True):
            if unit and not re.fullmatch(SAME_UNIT["m"], unit, re.IGNORECASE):
                name = self._header.names[k]
                hint = "name it without its unit, and set scale"
                raise ValueError(f"{self.file}: column {name!r} is in {unit}, and should be in m; {hint}")

    def _check_nodes_have_tracks(self) -> None:
        """Raise ValueError if each row has another node, and times differ: the column of nodes may count the rows."""
        is_single = len(self._rows) > 1 and all(len(rows) == 1 for rows in self._rows.values())
        if is_single and len({self._time(rows[0]) for rows in self._rows.values()}) > 1:
            name = self._header.names[self._columns["node"] or 0]
            raise ValueError(f"{self.file}: column {name!r} is different in each row, so it does not name the nodes")

    def _unit_of(self, name: str, first: str) -> Unit:
        """Return the unit of the times, given the unit in the header ("" if none) and the text of the first time."""
        for unit, names in TIME_UNITS.items():
            if re.fullmatch(names, name, re.IGNORECASE):
                return cast("Unit", unit)
        if name and not re.fullmatch(NO_UNIT, name, re.IGNORECASE):
            allowed = f"{', '.join(TIME_UNITS)}, or dates"
            raise ValueError(f"{self.file}: the times are in {name}, and should be in {allowed}")
        return clock_unit(first)

    def _time(self, row: tuple[int, list[str]]) -> Decimal:
        line, cells = row
        return converted(partial(time_of, unit=self._unit), cells[self._t], f"{self.file}, line {line}")

    def _track(self, node: NodeName) -> NodeTrack:
        start = start_of((self._time(row) for rows in self._rows.values() for row in rows), self.file)
        z = self._columns["z"]
        waypoints, has_heights = list[Waypoint](), False
        for line, cells in self._rows[str(node)]:
            place = f"{self.file}, line {line}"
            t = time(cells[self._t], place, start, self._unit)
            waypoint = Waypoint(t, coordinate(cells[self._x], place), coordinate(cells[self._y], place), line)
            has_heights |= z is not None and cells[z].strip() != "" and coordinate(cells[z], place) != 0.0
            try:
                append(waypoints, waypoint, place)
            except ValueError as error:
                hint = "; if the file has several nodes, name them in a column node"
                raise ValueError(f"{error}{hint if self._columns['node'] is None else ''}") from error
        return NodeTrack(waypoints, has_heights)


def _column_of_names(header: Header, rows: Sequence[Sequence[str]]) -> str | None:
    """Return the name of a column that may name nodes: it has several texts, and at least one of them repeatedly."""
    for name, words, cells in zip(header.names, header.words, zip(*rows, strict=True), strict=True):
        if not OF_OTHERS.isdisjoint(words):  # such as a covariance, a list of numbers in a cell
            continue
        texts = {cell.strip() for cell in cells} - {""}
        if 1 < len(texts) < len(cells) and not any(map(_is_numeric, texts)) and name not in COLUMNS["t"]:
            return name
    return None


def _is_numeric(cell: str) -> bool:
    """Return whether a cell is a number, with a decimal point or comma."""
    try:
        number_of(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _is_number(name: str) -> bool:
    return name.isascii() and name.isdecimal() and name == str(int(name))


def _cells(file: Path, lines: Sequence[str], first: int, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of each row below the header."""
    below = lines[first + 1 :]
    if delimiter:  # the lines above are left blank, so that each row is on its line
        yield from rows_of("\n" * (first + 1) + "\n".join(below), str(file), delimiter)
        return
    for line, text in enumerate(below, first + 2):
        if (row := text.split()) and not row[0].startswith("#"):
            yield line, row

"""Text files of latencies: numbers in one line or one column, the output of ping, and matrices.

Numbers are separated by white space, commas or semicolons; `#` begins a comment.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from desim.config.column_names import TIME_UNITS, unit_in_label
from desim.config.number_files import check_comments, is_number_text, number_of, text_of_file, words_of
from desim.config.number_texts import counted
from desim.kernel.measured.csv_tables import DECIMAL, plain_rows
from desim.kernel.measured.measurements import MISSING, number_or_nan
from desim.kernel.measured.ping import probes_of

AMBIGUOUS = re.compile(
    r"[+-]?(\d*,\d+|\d{1,3}(,\d{3})+(\.\d*)?|\d{1,3}(\.\d{3})+,\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE
)
"""Matches a word that may be several numbers, or one with a decimal comma or separators of thousands."""
INF = float("inf")
PAIRS_OF_3 = [{frozenset((first + i, first + j)) for i, j in ((0, 1), (0, 2), (1, 2))} for first in (0, 1)]
"""The pairs of the nodes 0 to 2, and of 1 to 3: a list of such pairs with latencies looks like a 3 x 3 matrix."""


def latencies_of(file: Path) -> list[float]:
    """Return the latencies, s, in a text file; for the output of ping, half of each round-trip time.

    Raises:
        ValueError: if the file cannot be read, contains no numbers or anything but times >= 0 s, has several numbers in
            one of several lines, a comma that may be a decimal comma, or a comment that names another unit.
    """
    text = text_of_file(file)
    if probes := probes_of(text, str(file)):
        latencies = [probe.rtt / 2.0 for probe in probes if probe.rtt is not None]
        if not latencies:
            raise ValueError(f"{file}: ping had no reply, so there is no latency")
        return latencies
    check_comments(text, file, "s")
    rows = [(line, items) for line, row in enumerate(text.split("\n"), 1) if (items := _items(row, file, line))]
    numbers: list[float] = []
    for line, items in rows:
        for item in items:
            try:
                numbers.append(number_of(item))
            except ValueError as error:
                hint = "" if numbers else "; a header should begin with #"
                raise ValueError(f"{file}, line {line}: {error}{hint}") from error
            if not 0.0 <= numbers[-1] < INF:
                raise ValueError(f"{file}, line {line}: a latency should be a time >= 0 s (got {item})")
    if not numbers:
        raise ValueError(f"{file} contains no numbers")
    if len(rows) > 1 and (longer := next(((line, len(items)) for line, items in rows if len(items) > 1), None)):
        why = "it should have one, because the file has several lines: latencies in one line or in one column"
        raise ValueError(f"{file}, line {longer[0]}: has {longer[1]} numbers; {why}")
    return numbers


def _items(row: str, file: Path, line: int) -> list[str]:
    """Return the numbers, as text, in a line; between semicolons they may have decimal commas.

    Raises:
        ValueError: if a comma may be a decimal comma.
    """
    words = words_of(row.partition("#")[0].replace(";", " "))
    signs = {match[1] or match[2] for word in words if (match := DECIMAL.fullmatch(word))}
    if ";" in row.partition("#")[0]:
        if len(signs) > 1:
            raise ValueError(f"{file}, line {line}: numbers should have either decimal points or decimal commas")
        return [word.replace(",", ".") if DECIMAL.fullmatch(word) else word for word in words]
    for word in words:
        if re.search(r",0\d", word) or AMBIGUOUS.fullmatch(word):
            reason = "may be one number or several: write decimal points, and white space between numbers"
            raise ValueError(f"{file}, line {line}: {word!r} {reason}")
    return words_of(" ".join(words).replace(",", " "))


class UnclearNamesError(ValueError):
    """The first line and the first column of a matrix may be names, or numbers of the matrix."""


def names_beside(rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the names in the first line and the first column of a square matrix; an empty tuple if it has no names.

    The first cell is empty or a text. Names may be numbers only if they are different integers. The first cell is also
    empty in a matrix without names that lacks its diagonal. In a matrix that lacks the diagonal, numbers are therefore
    names only if they are 0 .. n - 1: as values, they would have a latency of 0 beside the diagonal.

    Raises:
        UnclearNamesError: if the first line and the first column may also be numbers of a symmetric matrix.
        ValueError: if the first line and the first column have different names, or an empty one.
    """
    if len(rows) < 3 or not rows[0] or is_number_text(rows[0][0]):
        return ()
    names, line_names = tuple(rows[0][1:]), tuple(row[0] for row in rows[1:])
    if names == line_names:
        if not all(names):
            raise ValueError("a node has no name in the first line and in the first column")
        if not all(map(is_number_text, names)):
            return names
        if not all(map(str.isdecimal, names)) or len({*names}) < len(names):
            return ()
        numbers, counts = [*map(int, names)], counts_of(len(names))
        lacks_diagonal = all(len(row) > k and row[k].lower() in MISSING for k, row in enumerate(rows))
        if lacks_diagonal and (numbers == counts[1] or sorted(numbers) not in counts):
            return ()
        inner = [row[1:] for row in rows[1:]]
        is_symmetric = [*map(list, zip(*inner, strict=False))] == inner
        if numbers not in counts and (lacks_diagonal or (rows[0][0].lower() in MISSING and is_symmetric)):
            raise UnclearNamesError(
                f"{', '.join(names)[:40]} may be the names of the nodes, or numbers of a matrix whose first cell is"
                " empty: write a text into it if they are names, and 0 if not"
            )
        return names
    if len(names) == len(line_names) and not any(map(is_number_text, names + line_names)):
        raise ValueError("the names of the first line and of the first column should be equal")
    return ()


def counts_of(size: int) -> list[list[int]]:
    """Return the `size` integers from 0 on, and those from 1 on."""
    return [[*range(begin, begin + size)] for begin in (0, 1)]


class NamedMatrix(NamedTuple):
    """A square matrix of numbers in a file."""

    names: tuple[str, ...]
    """The names of the nodes, in the order of the rows; none if the file has none, or if they are 0 .. n - 1."""
    rows: list[list[float]]
    """A row per sender; nan where a cell is empty or nan."""


def matrix_of(file: Path, *, unit_is_given: bool = False) -> NamedMatrix:
    """Return the square matrix of numbers in a text file, perhaps with names in its first line and column.

    Nodes whose names are integers are in their order, so names that are 0 .. n - 1 are the numbers of the nodes.

    Args:
        file: the file.
        unit_is_given: whether the caller knows the unit; if not, comments may name no unit but s.

    Raises:
        ValueError: if the file cannot be read, is empty, has a cell that is not a number, or is no square.
    """
    text = text_of_file(file)
    if not unit_is_given:
        check_comments(text, file, "s")
    cells = [(line, [cell.strip() for cell in row]) for line, row in plain_rows(text, str(file))]
    try:
        names = names_beside([row for _, row in cells])
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    if names:
        line, (corner, *_) = cells[0]
        if (
            not unit_is_given
            and (unit := unit_in_label(corner))
            and not re.fullmatch(TIME_UNITS["s"], unit, re.IGNORECASE)
        ):
            raise ValueError(
                f"{file}, line {line}: the first cell says {unit!r}, and numbers are read in s: give the unit"
            )
        cells = [(line, row[1:]) for line, row in cells[1:]]
    rows = [_numbers(row, file, line, is_first=not k) for k, (line, row) in enumerate(cells)]
    if not rows:
        raise ValueError(f"{file} contains no numbers")
    first = cells[0][0]
    if not names and {frozenset(row[:2]) for row in rows} in PAIRS_OF_3:
        reason = "each line may be two nodes and a latency: a matrix has a line for each sender"
        raise ValueError(f"{file}, line {first}: {reason}, with a number for each receiver")
    column, numbers = [row[0] for row in rows[1:]], list(range(len(rows)))
    if not names and len(rows) > 2 and rows[0][1:] == column and column in (numbers[:-1], numbers[1:]):
        raise ValueError(f"{file}, line {first}: numbers the nodes, and so does the first column: leave both out")
    for (line, _), row in zip(cells, rows, strict=True):
        if len(row) != len(rows):
            in_row, in_file = counted(len(row), "number"), counted(len(rows), "line")
            reason = f"has {in_row}, but the file has {in_file} of numbers: one per node"
            raise ValueError(f"{file}, line {line}: {reason}; with decimal commas, separate numbers by ;")
    if names and all(map(str.isdecimal, names)):
        order = sorted(range(len(names)), key=lambda node: int(names[node]))
        names, rows = tuple(names[node] for node in order), [[rows[src][dst] for dst in order] for src in order]
    return NamedMatrix(() if names == tuple(map(str, range(len(rows)))) else names, rows)


def _numbers(cells: Sequence[str], file: Path, line: int, *, is_first: bool) -> list[float]:
    try:
        return [number_or_nan(cell) for cell in cells]
    except ValueError as error:
        hint = "; a header should begin with #, or name the nodes, as the first column does" if is_first else ""
        raise ValueError(f"{file}, line {line}: {error}{hint}") from error

"""Tables of measurements as CSV text, which is read from CSV or Parquet files.

The cells of a file are separated by commas, semicolons or tabs, whichever its header has most of. Where commas do not
separate cells, numbers may have decimal commas, as the spreadsheets of half of Europe write them.

A model keeps its table as CSV text, with commas and decimal points, that has only the columns in use. Each row stays on
its line of the file, so that an error message can name the line.
"""

import csv
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from io import StringIO
from itertools import repeat
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from desim.config.number_files import check_comments, is_plain, number_of, text_of_file
from desim.config.number_texts import counted
from desim.kernel.measured.ping import ping_table

MAX_CELLS = 20_000_000
"""Maximum number of cells that are read of a Parquet file: about 400 MB of text."""
CACHED_TABLES = 8
"""Number of tables that stay in memory, so that the configurations of a sweep do not read their common tables again."""
SEPARATORS = ";\t,"
"""The separators of cells; among those of which a header has equally many, the first one counts."""
QUOTED = re.compile(r'"[^"]*"')
DECIMAL = re.compile(r"[+-]?(?:\d*([.,])\d+|\d+([.,]))(?:e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
"""Matches a number with a decimal sign."""


class Cells(NamedTuple):
    """The cells of a table."""

    table: str
    """The name of the table."""
    lines: list[int]
    """The line of each row."""
    columns: dict[str, Sequence[str]]
    """The cells of each column, without the header."""

    def numbers(
        self, column: str, convert: Callable[[str], Any] = number_of, quick: Callable[[str], Any] | None = None
    ) -> list[Any]:
        """Return the converted cells of a column.

        Args:
            column: the name of the column.
            convert: converts a cell; raises ValueError if it is not valid.
            quick: a faster `convert` for ASCII cells without _; if it raises ValueError, `convert` is used.

        Raises:
            ValueError: if a cell is not valid, with its line.
        """
        cells = self.columns[column]
        if quick is not None and is_plain("".join(cells)):  # once for all cells, which takes a third of the time
            with suppress(ValueError):
                return list(map(quick, cells))
        converted: list[Any] = []
        try:
            converted.extend(map(convert, cells))
        except ValueError as error:
            raise self.error(len(converted), f"{column}: {error}") from error
        return converted

    def place(self, row: int) -> str:
        """Return the place of a row in the file."""
        return row_place(self.lines[row], self.table)

    def error(self, row: int, text: str) -> ValueError:
        """Return an error about a row."""
        return ValueError(f"{self.table}, {self.place(row)}: {text}")


def cells_of(table: str, name: str) -> Cells:
    """Return the cells of CSV text whose rows are all as long as its header.

    Raises:
        ValueError: if the table has no rows.
    """
    lines, flat, header = list[int](), list[str](), csv_header(table, name)
    for line, row_cells in rows_of(table, name):  # one flat list: a list per row takes twice as long
        lines.append(line)
        flat += row_cells
    if len(lines) < 2:
        raise ValueError(f"{name} has no rows")
    width = len(header)
    return Cells(name, lines[1:], {column: flat[width + k :: width] for k, column in enumerate(header)})


def csv_text(path: Path, columns: Collection[str] | None, *, units: Collection[str] = ("s",)) -> str:
    """Return the text of a CSV file, or a file of another format as CSV.

    The other formats are Parquet (*.parquet) and the output of ping, see `desim.kernel.measured.ping`.

    Args:
        path: the file.
        columns: the names of the columns of a Parquet file to read, the cells of others are empty; None: all.
        units: the units, "s" and "m", that comments may not contradict; see `check_comments`.

    Raises:
        ValueError: if the file cannot be read, or if it is a Parquet file and pyarrow is not installed.
    """
    if path.suffix.lower() != ".parquet":
        text = text_of_file(path)
        for unit in units:
            check_comments(text, path, unit)
        return ping_table(text, str(path)) or text
    try:
        return _csv_of(path.read_bytes(), None if columns is None else tuple(columns))
    except ModuleNotFoundError as error:
        raise ValueError(f"{path} needs {error.name}: pip install 'pursuit-desim[parquet]'") from None
    except (OSError, ValueError, NotImplementedError) as error:  # those of pyarrow are of these types, too
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise ValueError(f"{path} cannot be read: {reason}") from error


@lru_cache(maxsize=CACHED_TABLES)
def _csv_of(parquet: bytes, columns: tuple[str, ...] | None) -> str:
    from pyarrow import BufferReader
    from pyarrow.parquet import ParquetFile

    file = ParquetFile(BufferReader(parquet))
    names = file.schema_arrow.names
    used = [name for name in names if columns is None or name.strip() in columns]  # `csv_header` strips names, too
    # A file of a few kB can hold any number of equal rows, so the number of cells is bounded, not the size of the file.
    if (size := file.metadata.num_rows * len(used)) > MAX_CELLS:
        raise ValueError(
            f"{file.metadata.num_rows:,} rows of {len(used)} columns are {size:,} cells, above {MAX_CELLS:,}"
        )
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for batch in file.iter_batches(columns=used) if used else ():
        cells = batch.to_pydict()
        writer.writerows(zip(*(cells.get(name, repeat(None)) for name in names), strict=False))
    return text.getvalue()


def csv_header(text: str, name: str) -> list[str]:
    """Return the names of the columns of CSV text; see `select`.

    Raises:
        ValueError: if the text is empty or is not CSV.
    """
    for _, cells in rows_of(text, name):
        return [cell.strip() for cell in cells]
    raise ValueError(f"{name} is empty: its first line should have the names of its columns")


@lru_cache(maxsize=CACHED_TABLES)
def select(text: str, columns: tuple[str, ...], name: str) -> str:
    """Return CSV text reduced to some columns, separated by commas, with each row on the same line.

    Args:
        text: a header and rows; blank lines, and lines that begin with `#`, are ignored.
        columns: the names of the columns to keep, two or more.
        name: the name of the table, for error messages.

    Raises:
        ValueError: if the text is empty or is not CSV, a column is missing or occurs twice, a row is too short or too
            long, or numbers have both decimal commas and decimal points.
    """
    header = csv_header(text, name)
    for column in columns:
        if header.count(column) != 1:
            problem = "no column" if column not in header else "several columns"
            raise ValueError(
                f"{name} has {problem} {column!r}; its columns are {', '.join(header)}{_headless_hint(header)}"
            )
    cells_in_use = itemgetter(*(header.index(column) for column in columns))
    has_commas = separator_of(text) == ","
    rows, selected = _rows_as_long_as(header, rows_of(text, name), name, has_commas=has_commas), StringIO()
    if not has_commas:
        rows = with_points(rows, cells_in_use, name)
    writer = csv.writer(selected, lineterminator="\n")
    header_line, _ = next(rows)
    selected.write("\n" * (header_line - 1))
    writer.writerow(columns)
    next_line = header_line + 1
    for line, cells in rows:
        if line > next_line:
            selected.write("\n" * (line - next_line))
        writer.writerow(cells_in_use(cells))
        next_line = line + 1
    return selected.getvalue()


def _rows_as_long_as(
    header: Sequence[str], rows: Iterator[tuple[int, list[str]]], name: str, *, has_commas: bool
) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of each row.

    Raises:
        ValueError: if a row is too short or too long.
    """
    for line, cells in rows:
        if len(cells) != len(header):
            hint = "; with decimal commas, separate cells by ;" if has_commas and len(cells) > len(header) else ""
            problem = f"has {counted(len(cells), 'cell')}, but the table has {counted(len(header), 'column')}"
            raise ValueError(f"{name}, {row_place(line, name)}: {problem}{hint}")
        yield line, cells


def _headless_hint(header: Sequence[str]) -> str:
    """Return the probable reason why a column is missing, after a semicolon; "" if the header has names."""
    try:
        [number_of(cell) for cell in header]
    except ValueError:
        return ""
    return "; a header should have names, and not begin with #"


def plain_rows(text: str, name: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of each row of a table without a header, whose separator may be white space.

    Raises:
        ValueError: if the text is not CSV, or numbers have both decimal commas and decimal points.
    """
    text = re.sub(r"(?m)#.*", "", text)
    separator = separator_in(text)
    if not separator:
        text, separator = re.sub(r"(?m)(?<=\S) +(?=\S)", "\t", text), "\t"
    rows = rows_of(text, name, separator)
    return rows if separator == "," else with_points(rows, list, name)


def with_points(
    rows: Iterator[tuple[int, list[str]]], cells_in_use: Callable[[list[str]], Sequence[str]], name: str
) -> Iterator[tuple[int, list[str]]]:
    """Yield rows with decimal points instead of decimal commas.

    Raises:
        ValueError: if some cells in use have decimal commas and others decimal points, because one of the two may
            separate thousands.
    """
    first_by_sign: dict[str, tuple[int, str]] = {}
    for line, cells in rows:
        for cell in cells_in_use(cells) if len(cells) > 1 else ():
            if match := DECIMAL.fullmatch(cell.strip()):
                first_by_sign.setdefault(match[1] or match[2], (line, cell.strip()))
        if len(first_by_sign) > 1:
            (_, first), (other_line, other) = sorted(first_by_sign.values(), key=lambda place: place[0])
            reason = f"numbers should have either decimal points or decimal commas (got {first} and {other})"
            raise ValueError(f"{name}, {row_place(other_line, name)}: {reason}")
        yield line, [cell.replace(",", ".") if DECIMAL.fullmatch(cell.strip()) else cell for cell in cells]


def separator_in(text: str) -> str:
    """Return the sign that separates the cells of a table of numbers and names; "" if it is white space.

    Semicolons and tabs take precedence, because commas may then be decimal commas.
    """
    return next((sign for sign in ";\t," if sign in text), "")


def separator_of(text: str) -> str:
    """Return the separator of the cells of CSV text: the one that its first line has most of."""
    for line in text.split("\n"):
        if line.strip() and not line.lstrip().startswith("#"):
            return max(SEPARATORS, key=QUOTED.sub("", line).count)
    return ","


def rows_of(text: str, name: str, separator: str = "") -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of each row of CSV text, the header included; cells may end in white space.

    A cell in quotes with several lines, as a spreadsheet writes the long name of a column, has spaces between them.

    Args:
        text: the text.
        name: the name of the table, for error messages.
        separator: the separator of the cells; if it is empty, see `separator_of`.
    """
    lines = text.split("\n")
    if "#" in text:
        lines = ["" if line.lstrip().startswith("#") else line for line in lines]
    if has_quotes := '"' in text:  # a cell in quotes may have several lines
        lines = [f"{line}\n" for line in lines]
    reader = csv.reader(lines, delimiter=separator or separator_of(text), strict=True, skipinitialspace=True)
    try:
        for cells in reader:
            if any(cells):
                yield reader.line_num, [cell.replace("\n", " ") for cell in cells] if has_quotes else cells
    except csv.Error as error:
        raise ValueError(f"{name}, line {reader.line_num}: {error}") from error


def row_place(line: int, table: str) -> str:
    """Return the place of a line in a table, given the name of the table; a Parquet file has no lines."""
    return f"row {line - 1}" if table.lower().endswith(".parquet") else f"line {line}"

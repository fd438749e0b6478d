"""Tables of measurements as CSV text, which is read from CSV or Parquet files.

A model keeps its table as CSV text that has only the columns in use. Each row stays on its line of the file, so that an
error message can name the line.
"""

import csv
from collections.abc import Iterator
from functools import lru_cache
from io import StringIO
from itertools import repeat
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

MAX_CELLS = 20_000_000
"""Maximum number of cells that are read of a Parquet file: about 400 MB of text."""
KEPT = 8
"""Number of tables that stay in memory, so that the configurations of a sweep do not read their common tables again."""


class Columns(NamedTuple):
    """The names of the columns of a table."""

    time: str
    src: str | None
    """The sender; None, as is `dst`: the measurements hold for all links."""
    dst: str | None
    value: str

    def used(self) -> list[str]:
        """Return the names of the columns that the table has."""
        return [name for name in self if name is not None]


def text_of(path: Path, columns: Columns) -> str:
    """Return the text of a CSV file, or some columns of a Parquet file (*.parquet) as CSV; its other cells are empty.

    Raises:
        ValueError: if the file cannot be read, or if it is a Parquet file and pyarrow is not installed.
    """
    try:
        content = path.read_bytes()
        if path.suffix.lower() == ".parquet":
            return _csv_of(content, columns)
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except ModuleNotFoundError as error:
        raise ValueError(f"{path} needs {error.name}: pip install 'pursuit-desim[parquet]'") from error
    except (OSError, ValueError, NotImplementedError) as error:  # those of pyarrow are of these types, too
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise ValueError(f"{path} cannot be read: {reason}") from error


@lru_cache(maxsize=KEPT)
def _csv_of(parquet: bytes, columns: Columns) -> str:
    from pyarrow import BufferReader
    from pyarrow.parquet import ParquetFile

    file = ParquetFile(BufferReader(parquet))
    names = file.schema_arrow.names
    read = [name for name in names if name in columns]
    # A few kB can hold as many equal rows as their writer likes, so the bound is on what they say, not on their size.
    if (size := file.metadata.num_rows * len(read)) > MAX_CELLS:
        raise ValueError(
            f"{file.metadata.num_rows:,} rows of {len(read)} columns are {size:,} cells, above {MAX_CELLS:,}"
        )
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for batch in file.iter_batches(columns=read) if read else ():
        cells = batch.to_pydict()
        writer.writerows(zip(*(cells.get(name, repeat(None)) for name in names), strict=False))
    return text.getvalue()


def header_of(text: str, name: str) -> list[str]:
    """Return the names of the columns of CSV text; see `select`.

    Raises:
        ValueError: if the text is empty or is not CSV.
    """
    for _, cells in rows_of(text, name):
        return [cell.strip() for cell in cells]
    raise ValueError(f"{name} is empty: its first line should have the names of its columns")


@lru_cache(maxsize=KEPT)
def select(text: str, columns: Columns, name: str) -> str:
    """Return CSV text reduced to some columns, with each row on the same line.

    Args:
        text: a header and rows; blank lines, and lines that begin with `#`, are ignored.
        columns: the columns to keep.
        name: the name of the table, for error messages.

    Raises:
        ValueError: if the text is empty or is not CSV, a column is missing or occurs twice, or a row is too short or
            too long.
    """
    header = header_of(text, name)
    for column in columns.used():
        if header.count(column) != 1:
            what = "no column" if column not in header else "several columns"
            raise ValueError(f"{name} has {what} {column!r}; its columns are {', '.join(header)}")
    chosen = itemgetter(*(header.index(column) for column in columns.used()))
    rows, kept = rows_of(text, name), StringIO()
    writer = csv.writer(kept, lineterminator="\n")
    first, _ = next(rows)
    kept.write("\n" * (first - 1))
    writer.writerow(columns.used())
    below = first + 1
    for line, cells in rows:
        if len(cells) != len(header):
            raise ValueError(f"{name}, line {line}: has {len(cells)} cells, but the table has {len(header)} columns")
        if line > below:
            kept.write("\n" * (line - below))
        writer.writerow(chosen(cells))
        below = line + 1
    return kept.getvalue()


def rows_of(text: str, name: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of each row of CSV text, the header included; cells may end in white space."""
    lines = text.split("\n")
    if "#" in text:
        lines = ["" if line.lstrip().startswith("#") else line for line in lines]
    reader = csv.reader(lines, strict=True, skipinitialspace=True)
    try:
        for cells in reader:
            if any(cells):
                yield reader.line_num, cells
    except csv.Error as error:
        raise ValueError(f"{name}, line {reader.line_num}: {error}") from error


def place_of(line: int, table: str) -> str:
    """Return the place of a line in a table, given the name of the table; a Parquet file has no lines."""
    return f"row {line - 1}" if table.lower().endswith(".parquet") else f"line {line}"

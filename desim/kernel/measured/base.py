"""The base of the models that follow measurements of links: the table, and how it is replayed.

A message that is sent at time t has the value of the measurement at time t + `start`; see
`desim.kernel.measured.playback`.
"""

import re
from collections.abc import Collection, Iterable
from itertools import chain
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, ModelWrapValidatorHandler, Tag, ValidationInfo, model_validator

from desim.config.arrays import Floats
from desim.config.caller_warnings import warn_reader
from desim.config.choice import FILE_NAME
from desim.config.column_names import LINK_END_WORDS, TIME_UNITS, columns_of_ends, unit_in_label, words_of_name
from desim.config.model import Flag, Time, Value, in_forms
from desim.config.traits import is_ours, positions
from desim.config.trust import resolve_path
from desim.kernel.core.units import SECOND
from desim.kernel.measured.csv_tables import csv_header, csv_text, row_place, select
from desim.kernel.measured.measurements import Columns, Meaning, Measurements, Unit, measurements_of

UNIT_AT_END = re.compile(r".*[_\s\[(](ms|us|ns|s|sec|min|h|%|pct|percent)[\])]?", re.IGNORECASE)
"""Matches the unit at the end of the name of a column, such as rtt_ms or time [s]."""
MINIMA = re.compile(r".*[_\s]min", re.IGNORECASE)
"""Matches the name of a column of minima, such as rtt_min; min means minutes only in a column of times."""
OF_NODES = frozenset(
    {
        *chain.from_iterable(LINK_END_WORDS),
        *("id", "node", "name", "no", "number", "index", "idx", "ip", "mac", "addr", "address", "eth", "wlan", "host"),
        *("device", "robot", "agent", "uav", "drone", "vehicle", "station", *"12abijuv"),
    }
)
"""Words in the names of columns of senders and receivers."""
UNCLEAR_ENDS = frozenset({("tx", "rx"), ("a", "b"), ("i", "j"), ("u", "v")})
"""Names of two columns that may be senders and receivers, or have numbers of other things."""
Name = Annotated[str, Field(min_length=1)]
SHOWN = 20
"""Number of names in a warning."""
TABLE = "the table"
"""The name of a table that was not read from a file, in error messages."""


def unit_of_column(column: str) -> str:
    """Return the unit that the name of a column ends in, "" if it has none."""
    if match := UNIT_AT_END.fullmatch(column.strip()):
        return {"sec": "s", "pct": "%", "percent": "%"}.get(match[1].lower(), match[1].lower())
    label = unit_in_label(column).lower()
    short = next((unit for unit, names in TIME_UNITS.items() if re.fullmatch(names, label)), "")
    return short or (label if label in {"minutes", "hours"} else "")


class NamedTable(Value):
    """Base of the models with a table of measurements, in which nodes may have names."""

    @property
    def name(self) -> str:
        """What the table is called in error messages."""
        raise NotImplementedError

    @property
    def node_order(self) -> tuple[str, ...] | None:
        """The names of the nodes in the order of their numbers; None if they have no names."""
        raise NotImplementedError

    def numbered(self, names: tuple[str, ...]) -> Self:
        """Return the table numbered as a network numbers the names of its nodes; unchanged if it is numbered so.

        Raises:
            ValueError: if it has a name that the network does not have.
        """
        raise NotImplementedError


def _csv_of_frame(table: Any) -> str | None:
    """Return a frame of pandas or polars as CSV text; None for any other value.

    The index of pandas counts if it has a name, or consists of dates, which are the times.
    """
    if hasattr(table, "write_csv"):
        return str(table.write_csv())
    if not hasattr(table, "to_csv") or not hasattr(table, "columns"):
        return None
    has_dates = str(table.index.dtype).startswith("datetime64")
    names = [name or ("t" if has_dates else f"index_{k}") for k, name in enumerate(table.index.names)]
    return str(table.to_csv(index=has_dates or any(table.index.names), index_label=names))


class LinkTrace(NamedTable):
    """Base of the models that follow measurements: the table, its columns, and how it is replayed."""

    NOUN: ClassVar[str] = "a value"
    """What a value of the table is called in error messages."""
    LIMITS: ClassVar[tuple[float, float]] = (-np.inf, np.inf)
    """The smallest and the largest value that the table may have, unless they depend on the model."""

    kind: str = "trace"
    file: str | None = None
    """Path of a CSV file with a header, or of a Parquet file (*.parquet), relative to the scenario file. The file is
    read once, when the model is created; `table` then has its columns in use."""
    time: Name = "t"
    """Column of the times; the earliest is time 0 of the simulation."""
    time_unit: Unit = "s"
    """Unit of the times: s, ms, us or ns."""
    src: Name | None = "src"
    """Column of the senders; usual names such as source_id or from are understood, too. Without this column and that of
    the receivers, the measurements hold for all links."""
    dst: Name | None = "dst"
    """Column of the receivers."""
    nodes: Annotated[tuple[Name, ...], Field(min_length=2)] | None = None
    """Names of the nodes in the columns of senders and receivers, in the order of their numbers. Without it, these
    columns have numbers, or names: those of the graph, else of the file of the positions, else in the order of the
    table."""
    value: Name = "value"
    """Column of the values. A message that is sent while the value is missing (empty or nan) is lost."""
    both_ways: Flag = False
    """Whether a row also holds for the link from its receiver to its sender."""
    between: Literal["hold", "linear"] = "hold"
    """The value between two measurements: hold, that of the earlier one; linear, interpolated."""
    after: Literal["repeat", "hold", "error"] = "repeat"
    """Continuation after the last measurement. repeat: the first one again, so that the trace is periodic; hold: the
    last value; error: a message that is sent then ends the run with an error."""
    start: Annotated[
        Annotated[Time, Tag("number")] | Annotated[Literal["random"], Tag("text")], in_forms("text", "number")
    ] = 0.0
    """Time in the trace at which the simulation starts, s; "random": drawn once per seed for all links, which requires
    after = "repeat"."""
    table: str | None = None
    """Instead of a file: its content as CSV text. In Python, it may be a frame of pandas or polars."""
    read_from: Name | None = None
    """Name of the file that the table was read from, for error messages."""

    @model_validator(mode="wrap")  # outside of the conversion to Python's lists, which drops the names of columns
    @classmethod
    def _from_frame(cls, data: Any, make: ModelWrapValidatorHandler[Self]) -> Self:
        """Replace a frame by its content as CSV text."""
        if isinstance(data, dict) and (text := _csv_of_frame(data.get("table"))) is not None:
            data = data | {"table": text}
        return make(data)

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any, info: ValidationInfo) -> Any:
        """Replace a file by the table in it, and reduce the table to the columns in use."""
        if not isinstance(data, dict) or not _has_table(cls, data):
            return data
        names = Columns(*(data.get(key, cls.model_fields[key].default) for key in Columns._fields))
        text, read_from = data.get("table"), data.get("read_from")
        if text is not None and "\n" not in text and FILE_NAME.search(text):
            raise ValueError(f'table should be CSV text; a file is another key: file = "{text}"')
        if data.get("file") is not None:
            if text is not None:
                raise ValueError("should have a file or a table, not both")
            path = resolve_path(data["file"], info)
            units = ("s",) if {"unit", "time_unit"}.isdisjoint(data) else ()  # comments may explain the given units
            text, read_from = csv_text(path, names.used(), units=units), path.name
        name = read_from or TABLE
        columns = _columns_in(csv_header(str(text), name), names, data, name)
        reduced = {"table": select(str(text), columns.used(), name), "src": columns.src, "dst": columns.dst}
        parameters = {key: value for key, value in data.items() if key not in {"file", "read_from"}}
        return parameters | reduced | ({"read_from": read_from} if read_from else {})

    @model_validator(mode="after")
    def _is_valid(self) -> Self:
        if self.table is None:
            raise ValueError("should have a file, or a table")
        if self.nodes is not None and len(set(self.nodes)) < len(self.nodes):
            raise ValueError("nodes should have each name once")
        if self.nodes is not None and self.src is None:
            raise ValueError("nodes are the names in the columns src and dst, which the table does not have")
        for key, column, unit in self._units():
            has_minima = key != "time_unit" and MINIMA.fullmatch(column.strip())
            if (column_unit := unit_of_column(column)) and column_unit != unit and not has_minima:
                raise ValueError(f"{key}: column {column!r} is in {column_unit}, and should be in {unit}")
        end = self.measurements.end / SECOND
        if self.start == "random" and self.after != "repeat":
            raise ValueError(f'start = "random" requires after = "repeat" (got {self.after!r})')
        if self.after == "error" and self.start != "random" and self.start >= end:
            raise ValueError(f"start should be before the end of the trace at {end:g} s (got {self.start:g})")
        return self

    def _units(self) -> list[tuple[str, str, str]]:
        """Return key, column and unit for each key about a unit; a column named by another unit is refused."""
        return [("time_unit", self.time, self.time_unit)]

    @model_validator(mode="wrap")
    @classmethod
    def _tells_doubt(cls, data: Any, make: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        trace = make(data)
        if isinstance(data, dict) and data.get("file") is not None and trace.doubt is not None:
            warn_reader(f"{trace.name}: {trace.doubt[1]}", info)
        return trace

    @property
    def doubt(self) -> tuple[str, str] | None:
        """The key that is probably wrong, judging by the name of a column or its values, and why; None if none is."""
        return None

    def given(self) -> dict[str, Any]:
        """Return the fields that differ from their defaults, see `Value.given`; instead of the table, its length."""
        rows = len(self.measurements.values) // (2 if self.both_ways and self.src is not None else 1)
        return super().given() | {"table": f"{rows} rows"}

    @property
    def name(self) -> str:
        """The name of the table, for error messages."""
        return self.read_from or TABLE

    @property
    def limits(self) -> tuple[float, float]:
        """The smallest and the largest value that the table may have."""
        return self.LIMITS

    @property
    def measurements(self) -> Measurements:
        """The measurements.

        Raises:
            ValueError: if the table is not valid.
        """
        columns = Columns(self.time, self.src, self.dst, self.value)
        meaning = Meaning(self.NOUN, *self.limits, self.time_unit, self.both_ways, self.nodes)
        return measurements_of(self.table or "", columns, meaning, self.name)

    @property
    def span(self) -> float:
        """The time from the start of the simulation to the end of the trace, or the period of a repeated trace, s."""
        end = self.measurements.end / SECOND
        return end if self.start == "random" or self.after == "repeat" else max(end - self.start, 0.0)

    @property
    def named_nodes(self) -> str | None:
        """A text with the number and the name of each node; None if the columns have numbers, or `nodes` was given."""
        names = self.measurements.names
        if names is None:
            return None
        numbers = [f"{number} is {name}" for number, name in enumerate(names)]
        shown = numbers if len(numbers) <= SHOWN else [*numbers[: SHOWN - 1], "...", numbers[-1]]
        return ", ".join(shown)

    @property
    def node_order(self) -> tuple[str, ...] | None:
        """The names of the nodes in the order of their numbers; None if the columns have numbers."""
        return self.nodes or self.measurements.names

    def numbered(self, names: tuple[str, ...]) -> Self:
        """Return the trace with the numbers that a network gives to the names of its nodes.

        The trace is returned unchanged if it gives the same numbers by itself, has `nodes`, or has columns with
        numbers. But if all names are numbers, as in a graph of the nodes 1 .. n, then numbers in the columns are names,
        too.

        Raises:
            ValueError: if the table has another name.
        """
        if not names or self.nodes is not None or self.src is None:
            return self
        order = self.measurements.names
        if order == names or (order is None and not all(map(str.isdecimal, names))):
            return self
        return self.model_copy(update={"nodes": names})

    @property
    def is_replayed(self) -> bool:
        """Whether links have the values of the table in a run; a user's class may override how it is replayed."""
        definers = (positions(type(self), name)[:1] for name in ("__call__", "start_run", "draw"))
        return all(is_ours(type(self).__mro__[position]) for definer in definers for position in definer)

    def scaled(self, values: Floats) -> Floats:
        """Return values of the table in the unit of the model."""
        return values

    def check_links(self, size: int, links: Iterable[tuple[int, int]]) -> None:
        """Check that the table has a row for each of the links (sender, receiver) of a network of `size` nodes.

        A table that is not replayed (`is_replayed`) need not have them.

        Raises:
            ValueError: if a link has no row, or a row is about a node that does not exist.
        """
        if self.src is None or not self.is_replayed:
            return
        measured = self.measurements
        nodes = np.maximum(measured.src, measured.dst)
        if nodes.max() >= size:
            link = int((nodes >= size).argmax())
            where = f"{self.name}, {row_place(int(measured.line[link]), self.name)}"
            raise ValueError(f"{where}: there is no node {nodes[link]}: the nodes are 0 .. {size - 1}")
        measured_links = set(zip(measured.src.tolist(), measured.dst.tolist(), strict=True))
        for src, dst in links:
            if (src, dst) not in measured_links:
                hint = (
                    "; with both_ways = true, a row also holds for the way back" if (dst, src) in measured_links else ""
                )
                raise ValueError(f"{self.name} has no row for the link from {src} to {dst}{hint}")


def _has_table(model: type[LinkTrace], data: dict[str, Any]) -> bool:
    """Return whether the arguments of a model name a table and its columns; a wrong type is left to the validation."""
    texts = [data.get("table"), data.get("read_from"), data.get("src"), data.get("dst")]
    texts += [data.get(key, model.model_fields[key].default) for key in ("time", "value")]
    has_texts = all(text is None or isinstance(text, str) for text in texts) and None not in texts[-2:]
    return has_texts and (data.get("file") is not None or data.get("table") is not None)


def _columns_in(header: Collection[str], names: Columns, keys: Collection[str], table: str) -> Columns:
    """Return the columns that a table has; those of senders and receivers may be absent unless they are given."""
    ends = {key: getattr(names, key) for key in ("src", "dst")}
    used = [key for key, name in ends.items() if name is not None and (key in keys or name in header)]
    if len(used) == 2:
        return names
    if {"src", "dst"}.isdisjoint(keys) and (usual := _usual_ends(header, names, table)):
        return names._replace(src=usual[0], dst=usual[1])
    if not used:
        return names._replace(src=None, dst=None)
    raise ValueError(f"src and dst should both be columns of {table}, or neither; its columns are {', '.join(header)}")


def _usual_ends(header: Collection[str], names: Columns, table: str) -> tuple[str, str] | None:
    """Return the columns with usual names of senders and receivers, such as from and to; None if it has none.

    Words of numbers, as in tx_power and rx_power, do not count.

    Raises:
        ValueError: if the names may be of senders and receivers, or of other things, as tx and rx.
    """
    others = [name for name in header if name not in {names.time, names.value}]
    columns = [name for name in others if OF_NODES.issuperset(words_of_name(name))]
    if (ends := columns_of_ends(columns)) is None:
        return None
    src, dst = columns[ends[0]], columns[ends[1]]
    if (src.lower(), dst.lower()) in UNCLEAR_ENDS:
        raise ValueError(
            f"the columns {src} and {dst} of {table} may be the senders and the receivers: say src = {src!r} and"
            f" dst = {dst!r}, or leave them out"
        )
    return src, dst

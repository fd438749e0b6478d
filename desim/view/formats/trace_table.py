"""The trace of a run as one table, for pandas, R or a spreadsheet: rows in Python, or a CSV or Parquet file.

An event has one row, or one row for each of its players (Started, Sampled) or receivers (Queued, Broadcast). All rows
have the columns `line`, `event` and `t`; a column that an event lacks is empty. Times are in s, as in trace files. A
table is written row by row, so that a long trace need not fit in memory.
"""

import csv
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import AfterValidator

from desim.config.escaping import csv_cell
from desim.config.model import Value
from desim.kernel.core.events import LOST, Broadcast, Event, Sent
from desim.kernel.core.trace_file import body_json, value_json
from desim.kernel.core.units import seconds
from desim.pursuit.core.events import Sampled, Started
from desim.results.run_folder import EVENTS, StreamedResult
from desim.simulation.run import Result

Row = dict[str, Any]
"""A row: the values of its columns by name, without empty ones."""
KINDS = tuple(kind.__name__ for kind in EVENTS)
"""The names of all types of events."""


def _checked_name(name: str) -> str:
    if name not in KINDS:
        raise ValueError(f"there are no events {name}; there are {', '.join(KINDS)}")
    return name


EventName = Annotated[str, AfterValidator(_checked_name)]
"""The name of a type of events."""


class Column(NamedTuple):
    """A column of the table."""

    type: Literal["int64", "float64", "string"]
    """The type of its values; any value may be missing, except in the first three columns."""
    description: str
    """Its meaning, with the unit."""


COLUMNS: Mapping[str, Column] = MappingProxyType(
    {
        "line": Column("int64", "Line of the event in `trace.jsonl`, from 1; the rows of one event have the same"),
        "event": Column("string", "Type of the event"),
        "t": Column("float64", "Time of the event, s"),
        "pursuer": Column("int64", "Pursuer, 0 .. N - 1"),
        "evader": Column("int64", "Evader, 1 .. M"),
        "x": Column("float64", "Position of this pursuer or evader, or its estimate (Estimated), m"),
        "y": Column("float64", "Position of this pursuer or evader, or its estimate (Estimated), m"),
        "xx": Column("float64", "Variance of the estimate of x, m^2"),
        "xy": Column("float64", "Covariance of the estimates of x and y, m^2"),
        "yy": Column("float64", "Variance of the estimate of y, m^2"),
        "speed": Column("float64", "Speed of this pursuer while it chases, m/s"),
        "active": Column("int64", "Action of this pursuer: the evader that it chases, 1 .. M, or 0"),
        "suspect": Column("int64", "Pursuer whose announcements this pursuer begins or stops to distrust"),
        "distrusted": Column("int64", "Whether this pursuer begins, 1, or stops, 0, to distrust the suspect"),
        "transmission": Column("int64", "Number of the transmission, the same for all its receivers"),
        "src": Column("int64", "Sender"),
        "seq": Column("int64", "Sequence number of a broadcast record; greater ones are newer"),
        "dst": Column("int64", "Receiver"),
        "arrival": Column("float64", "Time of arrival at the receiver, s; empty if the message is lost before"),
        "created": Column("float64", "Time at which the message was handed to the transmitter, s"),
        "size": Column("int64", "Size of the message, bytes"),
        "body": Column("string", "Content of the message, JSON as in `trace.jsonl`"),
        "cause": Column("string", "Cause of the loss"),
        "capturer": Column("int64", "Pursuer that captured the evader, or whose capture ended the run"),
        "reason": Column("string", "Reason of the end of the run: captured, horizon or stopped"),
        "sent": Column("int64", "Messages sent up to the end, one for each receiver of a transmission"),
        "delivered": Column("int64", "Messages delivered"),
        "lost": Column("int64", "Messages lost"),
        "in_flight": Column("int64", "Messages neither delivered nor lost at the end"),
        "lost_by": Column("string", "Messages lost by cause, JSON"),
        "transmissions": Column("int64", "Transmissions, whatever the number of receivers"),
        "bytes_sent": Column("int64", "Bytes of all transmissions"),
        "utilisation": Column("float64", "Share of time for which the channel was busy, in [0, 1]"),
        "port": Column("string", "Port of the message, of a transport"),
        "to_all": Column("int64", "Whether the message was sent to all neighbours, 1, or to this receiver, 0"),
        "attempt": Column("int64", "Number of the attempt, or of the piece, from 1 on"),
        "submitted": Column("int64", "Messages given to a transport up to the end, one for each receiver"),
        "expired": Column("int64", "Messages dropped by their receivers because of the lifespan"),
        "given_up": Column("string", "Messages given up by their senders by cause, JSON"),
        "attempts": Column("int64", "Transmissions of messages, or of pieces, to each of their receivers"),
        "retransmissions": Column("int64", "Transmissions of messages that were not the first"),
        "acknowledgements": Column("int64", "Acknowledgements"),
        "deadlines_missed": Column("int64", "Deadlines missed"),
        "lives_lost": Column("int64", "Times that a node lost the liveliness of another"),
        "delay": Column("float64", "Sum of the times from sending to delivery over all delivered messages, s"),
        "node": Column("int64", "Node that corrected its clock"),
        "correction": Column("float64", "Sum of all corrections of its clock since the start, s"),
        "fault": Column("string", "Fault that started or ended, JSON as in `trace.jsonl`"),
    }
)
"""The columns of a table of all types of events, in order."""
PARTS: Mapping[str, Sequence[str]] = MappingProxyType(
    {"pursuers": ("pursuer", "x", "y"), "evaders": ("evader", "x", "y"), "speeds": ("speed",), "format": ()}
)
"""The columns of each field of an event, except of fields that are one column of the same name."""
BATCH = 1 << 15
"""Number of rows of a row group of Parquet, which are in memory together."""


def columns_of(kinds: Collection[str] = KINDS) -> list[str]:
    """Return the names of the columns of a table with these types of events, in order."""
    fields = {field for kind in EVENTS if kind.__name__ in kinds for field in kind._fields}
    shown = {"line", "event"} | {column for field in fields for column in PARTS.get(field, (field,))}
    return [column for column in COLUMNS if column in shown]


def rows(events: Iterable[Event], kinds: Collection[str] = KINDS) -> Iterator[Row]:
    """Yield the rows of the events of some types; `pandas.DataFrame(rows(result.trace))` is the table."""
    for line, event in enumerate(events, start=1):
        if (name := type(event).__name__) in kinds:
            head = {"line": line, "event": name, "t": seconds(event.t)}
            yield from ({**head, **columns} for columns in _other_columns(event))


class _Table(Value):
    """Base of the exporters of tables."""

    events: tuple[EventName, ...] = KINDS
    """The types of events in the table, which has only their columns."""

    items: ClassVar[str] = "rows"
    streams: ClassVar[bool] = True


class Csv(_Table):
    """A table as CSV: one row per event and receiver or player."""

    kind: Literal["csv"] = "csv"

    suffix: ClassVar[str] = ".csv"

    def __call__(self, result: Result | StreamedResult, file: Path) -> int:
        """Write the table, and return the number of rows."""
        count, columns = 0, columns_of(self.events)
        with file.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(columns)
            for row in rows(result.trace, self.events):
                writer.writerow(csv_cell(row.get(name)) for name in columns)
                count += 1
        return count


class Parquet(_Table):
    """A table as Parquet."""

    kind: Literal["parquet"] = "parquet"

    suffix: ClassVar[str] = ".parquet"
    requires: ClassVar[tuple[str, str]] = "pyarrow", "parquet"

    def __call__(self, result: Result | StreamedResult, file: Path) -> int:
        """Write the table, and return the number of rows.

        Raises:
            ImportError: if pyarrow is not installed.
        """
        import pyarrow as pa
        from pyarrow.parquet import ParquetWriter

        types = {"int64": pa.int64(), "float64": pa.float64(), "string": pa.string()}
        schema = pa.schema([(name, types[COLUMNS[name].type]) for name in columns_of(self.events)])
        count, remaining = 0, rows(result.trace, self.events)
        with file.open("wb") as stream, ParquetWriter(stream, schema) as writer:
            while batch := list(islice(remaining, BATCH)):
                columns = {name: [_in_unicode(row.get(name)) for row in batch] for name in schema.names}
                writer.write_table(pa.table(columns, schema=schema))
                count += len(batch)
        return count


def _in_unicode(value: Any) -> Any:
    """Return a value; a lone surrogate in a text, such as the name of a port, is escaped as in JSON."""
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


def _other_columns(event: Event) -> Iterator[Row]:
    """Yield the rows of an event without the columns that all events have."""
    if isinstance(event, Started | Sampled):
        yield from _players(event)
        return
    fields = zip(event._fields, event, strict=True)
    row = {name: _value(name, value) for name, value in fields if name not in {"t", "dst", "arrival"}}
    yield from ({**row, **receiver} for receiver in _receivers(event) or [{}])


def _players(event: Started | Sampled) -> Iterator[Row]:
    """Yield the rows of the pursuers, then those of the evaders."""
    for pursuer, (x, y) in enumerate(event.pursuers):
        row: Row = {"pursuer": pursuer, "x": x, "y": y}
        if isinstance(event, Started):
            row |= {"speed": event.speeds[pursuer], "active": event.active[pursuer]}
        yield row
    for evader, (x, y) in enumerate(event.evaders, start=1):
        yield {"evader": evader, "x": x, "y": y}


def _receivers(event: Event) -> list[Row]:
    """Return the receivers of a message event and the times of arrival there; an empty list for any other event."""
    if isinstance(event, Broadcast | Sent):
        return [{"dst": dst, "arrival": None if t == LOST else seconds(t)} for dst, t in event.fates()]
    receivers = getattr(event, "dst", ())
    return [{"dst": dst} for dst in (receivers if isinstance(receivers, tuple) else [receivers])]


def _value(name: str, value: Any) -> Any:
    """Return the value of a field as that of its column."""
    if name in {"created", "delay"}:
        return seconds(value)
    if name in {"to_all", "distrusted"}:
        return int(value)
    if name == "body":
        return body_json(value)
    return value_json(value) if name in {"lost_by", "given_up", "fault"} else value

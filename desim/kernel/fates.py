"""The fates of messages that a program has logged: what a network would have done to each of them."""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from math import isnan, nan
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, NamedTuple

from desim.config.arguments import naming_arguments, value_text
from desim.config.column_names import are_out_of_order
from desim.config.model import MAX_TIME
from desim.config.number_files import number_of
from desim.config.python_numbers import as_python, real
from desim.kernel.core.body_content import is_missing
from desim.kernel.core.units import nanoseconds
from desim.kernel.measured.csv_tables import cells_of, csv_header, csv_text, select
from desim.kernel.measured.measurements import start_of, time_of
from desim.kernel.models.links import Links
from desim.kernel.stepped_network import SteppedNetwork

if TYPE_CHECKING:
    import networkx as nx

NONE = "none"
"""The fate of a message to one node that has neither arrived nor been lost: it is still in flight, its transport has
given it up, or its sender was down."""
WAIT = 60.0
"""How long a network is observed after the last message, s."""
STEP = 1.0
"""Duration of a step of the network after the last message, s."""
COLUMNS = ("t", "src", "dst", "size")
ALL = ("", "*")
"""The cells of the column `dst` that stand for all neighbours."""


class LoggedMessage(NamedTuple):
    """A message of a log."""

    t: float
    """When it was sent, s."""
    src: Any
    dst: Any
    """The receiver; None: all neighbours."""
    size: int
    """Bytes."""


class Fate(NamedTuple):
    """What happened to a message at one receiver."""

    row: int
    """The number of the message in the log, from 0 on."""
    t: float
    """When it was sent, s."""
    src: Any
    dst: Any
    size: int
    """Bytes."""
    fate: str
    """"delivered", the cause of its loss, or "none"; see `NONE`."""
    arrived: float
    """When it arrived, s; nan if it did not."""


@naming_arguments
def fates(
    messages: Iterable[Sequence[Any]],
    nodes: "int | nx.Graph[Any]",
    links: Links | Mapping[str, Any] | None = None,
    *,
    wait: float = WAIT,
    **arguments: Any,
) -> list[Fate]:
    """Send the messages of a log over a network, and return what happens to each at each of its receivers.

    The fates are in the order of the log, then of the receivers. Of a message that is transmitted twice
    (`Links.duplicate`), the first arrival counts. A message to all neighbours has a fate for each node at which it has
    arrived or been lost.

    Args:
        messages: rows of the time, s, the sender, the receiver (None: all neighbours) and the size, bytes, ascending in
            time. A frame, or rows that are dicts or named tuples, have the columns t, src, dst and size in any order,
            and may have others; a dst that is missing in a frame is None.
        nodes: as in `SteppedNetwork`.
        links: as in `SteppedNetwork`.
        wait: how long the network is observed after the last message, s.
        **arguments: further arguments of `SteppedNetwork`, such as faults, seed and positions.

    Raises:
        ValueError: if a row is not such a message (the error names its number), or an argument is not valid.
    """
    duration = real(wait, "wait")
    if not 0 <= duration <= MAX_TIME:
        raise ValueError(f"wait should be a time from 0 to {MAX_TIME:g} s (got {value_text(wait)})")
    log: list[LoggedMessage] = []
    arrivals: dict[tuple[int, Hashable], float] = {}
    losses: dict[tuple[int, Hashable], str] = {}
    with SteppedNetwork(nodes, links, **arguments) as network:

        def step(duration: float) -> None:
            if nanoseconds(duration):
                for received in network.step(duration):
                    arrivals.setdefault((received.body, received.dst), received.arrived)
                losses.update(((lost.body, lost.dst), lost.cause) for lost in network.lost())

        for row, values in enumerate(_rows(messages)):
            try:
                message = _logged(values)
                time = real(message.t, "t")
                if not (log[-1].t if log else 0.0) <= time <= MAX_TIME:
                    raise ValueError("t should be ascending, from 0 s on")
                step(time - network.now)
                log.append(message)
                network.send(message.src, message.dst, row, size=message.size)
            except (TypeError, ValueError) as error:
                shown = tuple(values) if isinstance(values, tuple) else values  # a named tuple without its names
                raise ValueError(f"message {row} {value_text(shown)}: {error}") from error
        remaining = min(duration, MAX_TIME - network.now)
        while remaining > 0.0 and (network.counts().in_flight or network.transport_counts() is not None):
            step(min(STEP, remaining))
            remaining -= STEP
        step(1e-9)  # so that `lost` includes messages that were lost when they were sent, after the last step
        number_of = {node: number for number, node in enumerate(network.nodes)}
    keys = {*arrivals, *losses, *((row, message.dst) for row, message in enumerate(log) if message.dst is not None)}
    return [
        Fate(
            row,
            log[row].t,
            log[row].src,
            dst,
            log[row].size,
            "delivered" if (row, dst) in arrivals else losses.get((row, dst), NONE),
            arrivals.get((row, dst), nan),
        )
        for row, dst in sorted(keys, key=lambda key: (key[0], number_of[key[1]]))
    ]


def _rows(messages: Any) -> Iterable[Any]:
    """Return the rows of messages, which may be a frame of pandas or polars, or an array with named fields.

    Raises:
        ValueError: if the messages are not rows, but for instance the name of a file.
    """
    if isinstance(messages, str | bytes | PurePath) or not isinstance(messages, Iterable):
        raise ValueError(
            f"messages should be rows of {', '.join(COLUMNS)} (got {value_text(messages)}); `desim fates` reads files"
        )
    names = getattr(getattr(messages, "dtype", None), "names", None)
    order = _order(getattr(messages, "columns", ()) if names is None else names)
    table: Any = messages if order is None else messages[order]  # type: ignore[index]
    if names is not None:
        return list(table.tolist())
    rows: Iterable[Any] = table
    if hasattr(table, "itertuples"):  # of pandas
        rows = table.itertuples(index=False, name=None)
    elif hasattr(table, "iter_rows"):  # of polars
        rows = table.iter_rows()
    return iter(rows)


def _order(names: Iterable[Any]) -> list[Any] | None:
    """Return the names by which a table has `COLUMNS`, in capitals or not; None if the table names no columns.

    Raises:
        ValueError: if the table names columns, and lacks one of `COLUMNS`: their order does not tell what they are.
    """
    names = [*names]
    if are_out_of_order(names):
        raise ValueError(f"columns should be {', '.join(COLUMNS)}: the numbers {value_text(names)} are not in order")
    by_column = {name.lower(): name for name in names if isinstance(name, str)}
    if missing := [column for column in COLUMNS if column not in by_column]:
        if by_column:
            raise ValueError(
                f"columns should be {', '.join(COLUMNS)}: no {missing[0]} among {', '.join(by_column.values())}"
            )
        return None
    return [by_column[column] for column in COLUMNS]


def _logged(values: Any) -> LoggedMessage:
    """Return the message of a row.

    Raises:
        ValueError: if the row is not a message.
    """
    if isinstance(values, Mapping):
        values = [values[name] for name in _order(values) or values]
    elif fields := getattr(values, "_fields", ()):
        values = [getattr(values, name) for name in _order(fields) or fields]
    row = tuple(values) if isinstance(values, Iterable) and not isinstance(values, str) else ()
    if len(row) != len(COLUMNS):
        raise ValueError(f"a message should be {', '.join(COLUMNS)}")
    t, src, dst, size = row
    if is_missing(dst):
        dst = None
    elif isinstance(dst, float):  # pandas stores integers as floats if one is missing
        dst = None if isnan(dst) else int(dst) if dst.is_integer() else dst
    return LoggedMessage(*map(as_python, (t, src, dst, size)))


def read_log(file: Path, node_of: Callable[[str], Any]) -> list[LoggedMessage]:
    """Return the messages of a CSV or Parquet file with the columns t, src, dst and size.

    Args:
        file: the path of the file. An empty cell or * in the column `dst` stands for all neighbours. Dates, and seconds
            since 1970, count from the earliest.
        node_of: returns the node that a cell names; raises ValueError if there is none.

    Raises:
        ValueError: if the file is not such a table; the error names the line.
    """
    text, name = csv_text(file, COLUMNS), str(file)
    if set(COLUMNS) - set(header := csv_header(text, name)):
        raise ValueError(f"{name}: a log has the columns {', '.join(COLUMNS)}; this one has {', '.join(header)}")
    cells = cells_of(select(text, COLUMNS, name), name)
    times = cells.numbers("t", time_of)
    start = start_of(times, f"{name}, column t")
    senders, sizes = cells.numbers("src", node_of), cells.numbers("size", _bytes)
    receivers = cells.numbers("dst", lambda cell: None if cell.strip() in ALL else node_of(cell))
    seconds = (float(time - start) for time in times)
    return [LoggedMessage(*row) for row in zip(seconds, senders, receivers, sizes, strict=True)]


def _bytes(cell: str) -> int:
    """Return the size in a cell; a table with empty cells may contain 24.0 for 24."""
    size = number_of(cell)
    if not size.is_integer():
        raise ValueError(f"{cell!r} is not a whole number of bytes")
    return int(size)

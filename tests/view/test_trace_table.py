"""The trace of a run as a table: it holds all events, and is read again with the types of its columns."""

import csv
import json
from itertools import groupby
from types import SimpleNamespace

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, Team, run
from desim.kernel.core.events import (
    Broadcast,
    ClockCorrected,
    DeadlineMissed,
    Delivered,
    Expired,
    GivenUp,
    LivelinessLost,
    Lost,
    MessageCounts,
    Queued,
    Retransmitted,
    TransportCounts,
)
from desim.kernel.core.trace_file import events_of, line_of
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.models.faults import Crash
from desim.kernel.models.traced_faults import FaultStarted
from desim.kernel.models.transport import Reliable
from desim.pursuit.core.events import FORMAT, Captured, Decided, Distrusted, Ended, Estimated, Sampled, Started
from desim.results.run_folder import EVENTS
from desim.view.formats import trace_table
from desim.view.formats.export import export
from desim.view.formats.trace_table import COLUMNS, KINDS, Csv, Parquet, columns_of, rows
from tests.kernel.test_trace_file import EVENTS as MESSAGE_EVENTS
from tests.kernel.test_trace_file import NODES, TIMES
from tests.view.by_hand import MS, history, pair

pytestmark = pytest.mark.own_trace

numbers = st.floats(-1e30, 1e30)
points = st.lists(st.tuples(numbers, numbers), max_size=3).map(tuple)
teams = st.integers(0, 3).flatmap(
    lambda size: st.builds(
        Started,
        TIMES,
        points,
        *(st.tuples(*[each] * size) for each in (st.tuples(numbers, numbers), numbers, NODES)),
        format=st.just(FORMAT),
    )
)
EVERYTHING = (
    MESSAGE_EVENTS
    | teams
    | st.builds(Sampled, TIMES, points, points)
    | st.builds(Decided, TIMES, NODES, NODES)
    | st.builds(Captured, TIMES, NODES, NODES)
    | st.builds(Ended, TIMES, st.sampled_from(["captured", "horizon"]), st.none() | NODES)
    | st.builds(FaultStarted, TIMES, st.builds(Crash, start=st.floats(0.0, 9.0), node=NODES))
)


def parsed(name, text):
    """Return the value of a cell of a CSV file with the type of its column; None if it is empty."""
    kind = COLUMNS[name].type
    if text == "":
        return None
    return int(text) if kind == "int64" else float(text) if kind == "float64" else text


def read_csv(file):
    """Return the rows of a CSV file, without empty cells."""
    with file.open(encoding="utf-8", newline="") as stream:
        found = [{name: parsed(name, text) for name, text in row.items()} for row in csv.DictReader(stream)]
    return [{name: value for name, value in row.items() if value is not None} for row in found]


def line_from(table):
    """Return the line of the trace file of an event, given its rows."""
    first = dict(table[0])
    del first["line"]
    if "to_all" in first:
        first["to_all"] = bool(first["to_all"])
    for name in ("body", "lost_by", "given_up", "fault"):
        if name in first:
            first[name] = json.loads(first[name])
    kind = first["event"]
    if kind in {"Started", "Sampled"}:
        pursuers = [row for row in table if "pursuer" in row]
        event = {"event": kind, "t": first["t"]}
        event["evaders"] = [[row["x"], row["y"]] for row in table if "evader" in row]
        event["pursuers"] = [[row["x"], row["y"]] for row in pursuers]
        if kind == "Started":
            event |= {"speeds": [row["speed"] for row in pursuers], "active": [row["active"] for row in pursuers]}
            event["format"] = FORMAT
        return json.dumps(event)
    if kind == "Broadcast":
        first["arrival"] = [row.get("arrival") for row in table if "dst" in row]
    if kind in {"Broadcast", "Queued"}:
        first["dst"] = [row["dst"] for row in table if "dst" in row]
    if kind == "Sent":
        first.setdefault("arrival", None)
    if kind == "Ended":
        first.setdefault("capturer", None)
    return json.dumps(first)


def from_table(table):
    """Return the events in the rows of a table."""
    lines = [line_from(list(own)) for _, own in groupby(table, key=lambda row: row["line"])]
    return list(events_of(lines, EVENTS))


def plain(events):
    """Return events as they are read from a trace file, with an arrival for each receiver of a broadcast."""
    found = events_of(map(line_of, events), EVENTS)
    return [
        event._replace(arrival=tuple(t for _, t in event.fates())) if isinstance(event, Broadcast) else event
        for event in found
    ]


def fits(event):
    """Return whether a broadcast has an arrival for each receiver, or one for all; and players have places."""
    if isinstance(event, Started | Sampled):
        return bool(event.pursuers or event.evaders)
    return not isinstance(event, Broadcast) or len(event.arrival) in {1, len(event.dst)}


@pytest.mark.slow
@given(st.lists(EVERYTHING.filter(fits), max_size=8))
def test_a_table_holds_all_of_a_trace(tmp_path_factory, events):
    """The events can be made again from the rows, and from a CSV file."""
    file = tmp_path_factory.mktemp("tables") / "trace.csv"
    table = [{name: value for name, value in row.items() if value is not None} for row in rows(events)]
    assert Csv()(SimpleNamespace(trace=events), file) == len(table)
    assert read_csv(file) == table
    assert from_table(table) == plain(events)


def test_the_rows_of_a_run_that_has_all_kinds_of_events(tmp_path):
    way = (600 * MS, 0, 1, "port")
    transported = [
        Delivered(*way, False, 1, 500 * MS, 2, {"active": 1}),
        Retransmitted(*way, True, 1, 2),
        GivenUp(*way, False, 1, "repeats"),
        Expired(*way, False, 1),
        DeadlineMissed(*way),
        LivelinessLost(*way),
        TransportCounts(600 * MS, 4, 1, 1, {"repeats": 1}, 5, 1, 1, 1, 1, 100 * MS),
        ClockCorrected(600 * MS, 1, 0.25),
        Distrusted(600 * MS, 1, 0, True),
        Estimated(600 * MS, 1, 1, 2.0, 3.0, 0.5, 0.1, 0.25),
    ]
    events = history(*transported).trace.events
    assert {type(event).__name__ for event in events} == set(KINDS)
    Csv()(SimpleNamespace(trace=events), tmp_path / "x.csv")
    again = read_csv(tmp_path / "x.csv")
    assert from_table(again) == plain(events)
    assert again[9] == {
        **{"line": 3, "event": "Broadcast", "t": 0.1, "transmission": 0, "src": 0, "seq": 1, "dst": 2},
        **{"created": 0.1, "size": 24, "body": '{"active": 1}'},
    }
    assert [row["line"] for row in again] == sorted(row["line"] for row in again)


def test_parquet_has_the_same_rows_with_the_types_of_the_columns(tmp_path, monkeypatch):
    """Also in several row groups: three of 16 rows."""
    monkeypatch.setattr(trace_table, "BATCH", 16)
    events = history().trace.events
    file = tmp_path / "x.parquet"
    assert Parquet()(SimpleNamespace(trace=events), file) == 39
    frame = pd.read_parquet(file, dtype_backend="numpy_nullable")
    kinds = {"int64": "Int64", "float64": "Float64", "string": "string"}
    assert {name: str(kind) for name, kind in frame.dtypes.items()} == {
        name: kinds[column.type] for name, column in COLUMNS.items()
    }
    found = [{name: value for name, value in row.items() if not pd.isna(value)} for row in frame.to_dict("records")]
    assert found == [{name: value for name, value in row.items() if value is not None} for row in rows(events)]


def test_a_table_of_one_kind_has_only_its_columns():
    assert columns_of(["Decided"]) == ["line", "event", "t", "pursuer", "active"]
    assert columns_of(["Sampled"]) == ["line", "event", "t", "pursuer", "evader", "x", "y"]
    assert columns_of() == list(COLUMNS)
    decided = [event for event in history().trace if isinstance(event, Decided)]
    table = list(rows(history().trace, ["Decided"]))
    assert [(row["t"] * SECOND, row["pursuer"], row["active"]) for row in table] == decided


def test_every_field_has_a_column_or_columns():
    assert {name for kind in KINDS for name in columns_of([kind])} == set(COLUMNS)


@given(TIMES)
def test_a_time_in_seconds_is_still_a_whole_number_of_nanoseconds(t):
    (row,) = rows([Decided(t, 0, 1)])
    assert nanoseconds(row["t"]) == t


def test_events_are_not_held_in_memory(tmp_path):
    """The rows of an event are written before the next event is read, but for those that a file buffers."""
    file = tmp_path / "x.csv"
    sizes = []

    def many():
        for k in range(2_000):
            sizes.append(file.stat().st_size)
            yield (Lost(k, k, 0, 1, "loss"), Queued(k, k, 0, (1, 2), 24))[k % 2]
        yield MessageCounts(2_000, 0, 0, 0, 0, {}, 0, 0, 0.0)

    assert Csv()(SimpleNamespace(trace=many()), file) == 3_001
    assert sizes[-1] > 0.9 * file.stat().st_size


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_port_of_any_text_is_in_a_table(suffix, tmp_path):
    """Also half a surrogate pair, which UTF-8 cannot write."""

    def protocol(me):
        me.send(1 - me.id, "hello", "half \udcff", transport=Reliable())
        yield me.sleep(1.0)

    made = run(Scenario(team=Team(count=2), protocol=protocol, horizon=0.1, record={"messages": True}), 1)
    file = tmp_path / f"a.{suffix}"
    export(made, file)
    table = pd.read_csv(file) if suffix == "csv" else pd.read_parquet(file)
    assert set(table["port"].dropna()) == {"half \\udcff"}


def test_rows_number_pursuers_from_0_and_evaders_from_1():
    events = [event for event in pair().trace if isinstance(event, Started | Sampled)][:2]
    players = [(row.get("pursuer"), row.get("evader"), row["x"], row["y"]) for row in rows(events)]
    pursuers = [(0, None, 0.0, 0.0), (1, None, 10.0, 0.0), (2, None, 0.0, 10.0)]
    assert players == [*pursuers, (None, 1, 5.0, 5.0), (None, 2, 8.0, 2.0)] * 2

"""Tables of measurements: what a file may hold, and what is refused with its name and the line."""

import re
import sys
from contextlib import nullcontext
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal

import networkx as nx
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from desim import (
    Environment,
    Evader,
    LatencyTrace,
    LossTrace,
    RecordedFlow,
    RecordedMotion,
    Scenario,
    SignalTrace,
)
from desim.config.errors import KeyedError
from desim.config.model import Value
from desim.kernel.core.clock import Clock
from desim.kernel.measured.csv_tables import _csv_of
from desim.kernel.measured.measurements import LAST_CLOCK, PER_SECOND, start_of, time_of
from desim.kernel.measured.playback import Playback
from desim.kernel.models.latency import Empirical
from desim.kernel.models.latency_by_link import LatencyMatrix
from desim.kernel.models.links import Links
from desim.kernel.network import Network
from desim.scenario.checks import warnings

PER_LINK = "t,src,dst,value\n0,0,1,0.1\n0,1,0,0.3\n1,0,1,0.2\n"


@pytest.fixture
def read(tmp_path):
    """Return a function that creates the trace in a file with some text."""

    def made(text, model=LatencyTrace, **options):
        (tmp_path / "rtt.csv").write_text(text, encoding="utf-8")
        return model.model_validate({"file": "rtt.csv"} | options, context={"folder": tmp_path, "is_program": False})

    return made


def test_comments_blank_lines_and_other_columns_are_left_out_and_each_row_stays_on_its_line(read):
    text = '\ufeff# by, hand "\n\nx,t , rtt,note\r\n1, 0,40,"a, b"\n\n2,0.5,,\n3,1.0,nan,\n'
    trace = read(text, value="rtt", unit="ms")
    assert trace.table == "\n\nt,rtt\n0,40\n\n0.5,\n1.0,nan\n"
    assert (trace.file, trace.src, trace.dst, trace.read_from) == (None, None, None, "rtt.csv")
    assert trace.measurements.values.tolist() == [40.0] * 3
    assert trace.measurements.is_missing.tolist() == [False, True, True]


def test_a_trace_no_longer_needs_its_file(read):
    trace = read(PER_LINK, start="random")
    assert LatencyTrace.model_validate(trace.plain()) == trace
    assert LatencyTrace.model_validate(trace.model_dump(exclude_none=True)) == trace
    assert LatencyTrace(table=PER_LINK, start="random", read_from="rtt.csv") == trace
    assert repr(trace) == "LatencyTrace(start='random', table='3 rows', read_from='rtt.csv')"


@pytest.mark.slow
def test_a_parquet_file_means_the_same_as_a_csv_file(tmp_path):
    import pyarrow as pa
    from pyarrow import parquet

    def read(**columns):
        parquet.write_table(pa.table(columns), tmp_path / "rtt.parquet")
        return LatencyTrace(file=tmp_path / "rtt.parquet")

    ends = {"src": [0, 1, 0], "dst": [1, 0, 1]}
    found = read(t=[0, 0, 1], **ends, value=[0.1, 0.3, None], x=[[1], [2], [3]])
    assert found.table == PER_LINK.replace("0.2", "")
    assert found.read_from == "rtt.parquet"
    assert read(**{"t": [0, 1], " value ": [0.1, 0.2]}).measurements.values.tolist() == [0.1, 0.2]
    refused = {
        "row 2: a latency should be at least 0 (got -1.0)": {"t": [0, 1], "value": [0.0, -1.0]},
        "row 3: there is no node 7": {"t": [0, 0, 0], "src": [0, 1, 7], "dst": [1, 0, 0], "value": [1, 1, 1]},
        "has no column 'value'; its columns are t, rtt": {"t": [0, 1], "rtt": [0.0, -1.0]},
        "has no rows": {"t": pa.array([], pa.float64()), "value": pa.array([], pa.float64())},
    }
    for complaint, columns in refused.items():
        with pytest.raises(ValueError, match=rf"rtt\.parquet,? {re.escape(complaint)}"):
            Scenario(team={"count": 2}, network={"latency": read(**columns)})
    (tmp_path / "rtt.parquet").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"rtt\.parquet cannot be read: .*Parquet"):
        LatencyTrace(file=tmp_path / "rtt.parquet")


def test_the_cells_of_a_parquet_file_are_bounded_before_they_are_read(tmp_path, monkeypatch):
    """Equal values take next to no room in the file, however many they are."""
    import pyarrow as pa
    from pyarrow import parquet

    rows = 10_000
    table = pa.table({"t": range(rows), "value": [0.1] * rows})
    parquet.write_table(table, tmp_path / "long.parquet")
    assert LatencyTrace(file=tmp_path / "long.parquet").read_from == "long.parquet"
    monkeypatch.setattr("desim.kernel.measured.csv_tables.MAX_CELLS", 2 * rows - 1)
    _csv_of.cache_clear()
    with pytest.raises(ValueError, match="10,000 rows of 2 columns are 20,000 cells, above 19,999"):
        LatencyTrace(file=tmp_path / "long.parquet")


def test_parquet_needs_pyarrow(tmp_path, monkeypatch):
    (tmp_path / "rtt.parquet").write_bytes(b"PAR1")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ValueError, match=r"rtt\.parquet needs pyarrow: pip install 'pursuit-desim\[parquet\]'"):
        LatencyTrace(file=tmp_path / "rtt.parquet")


@pytest.mark.parametrize(
    ("unit", "times"),
    [
        ("s", ["1700000000.1", "1700000000.2", "1700000000.3"]),
        ("ms", ["1700000000100", "1700000000200.0", "1.7000000003e12"]),
        ("us", ["-100000", "0", "100000"]),
        ("ns", ["1700000000100000001", "1700000000200000001", "1700000000300000001"]),
    ],
)
def test_times_count_from_the_first_and_are_exact(unit, times):
    """As binary numbers, 1700000000.2 - 1700000000.1 is 0.10000014 s, and the last times are equal."""
    rows = "".join(f"{time},1\n" for time in times)
    trace = LatencyTrace(table=f"t,value\n{rows}", time_unit=unit)
    assert trace.measurements.times.tolist() == [0, 100_000_000, 200_000_000]
    assert trace.span == 0.3


DATES = {
    "in UTC": ["2024-05-17T12:30:00.100000001Z", "2024-05-17 12:30:00.2Z", "2024/05/17 12:30:00,300 UTC"],
    "in two zones": ["2024-05-17T14:30:00+02:00", "2024-05-17T12:30:00.1Z", "2024-05-17T08:00:00.2-0430"],
    "without a zone": ["2024-05-17T12:30:00.1", "2024-05-17T12:30:00.2", "2024-05-17T12:30:00.3"],
    "across midnight": ["2024-02-28T23:59:59.9", "2024-02-29", "2024-02-29 00:00:00.1"],
    "with numbers since 1970": ["1715949000", "2024-05-17T12:30:00.1Z", "1715949000.2"],
}


@pytest.mark.parametrize("times", DATES.values(), ids=DATES)
def test_times_may_be_dates(times):
    """The time of the first is 0, and nanoseconds count."""
    table = "t,value\n" + "".join(f'"{time}",1\n' for time in times)
    first = 1 if times[0].endswith("1Z") else 0
    assert LatencyTrace(table=table).measurements.times.tolist() == [0, 100_000_000 - first, 200_000_000 - first]


@given(st.datetimes(datetime(1975, 1, 1), datetime(2200, 1, 1)), st.integers(-23 * 60, 23 * 60))
def test_a_date_is_the_time_that_python_says(date, east):
    aware = date.replace(tzinfo=timezone(timedelta(minutes=east)))
    seconds = (aware - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(microseconds=1)
    assert time_of(aware.isoformat()) == Decimal(round(seconds)) / 10**6
    assert start_of([time_of(date.isoformat())], "") == time_of(date.isoformat()) > LAST_CLOCK / 2


@pytest.mark.parametrize(
    ("times", "complaint"),
    [
        (["2024-05-17T12:30:00", "2024-05-17T12:30:01Z"], "at most 1e.09 s after the earliest time"),
        (["1715949000", "2024-05-17T12:30:01"], "at most 1e.09 s after the earliest time"),
        (["17.05.2024 12:30"], "neither a number nor a date"),
        (["12:30:00"], "neither a number nor a date"),
        (["2024-13-01"], "'2024-13-01' is not a date: month"),
        (["2024-05-17T24:00"], "is not a date: hour"),
        (["0001-01-01T00:00+02:00"], ""),
        (["1715949000123"], "'1715949000123' is too great for a time in s; numbers since 1970 may be in ms"),
    ],
)
def test_what_is_no_date_or_another_clock_is_refused(times, complaint):
    table = "t,value\n" + "".join(f"{time},1\n" for time in times)
    with pytest.raises(ValueError, match=complaint) if complaint else nullcontext():
        LatencyTrace(table=table)


def test_times_that_count_from_a_date_start_with_the_earliest_and_others_with_0():
    assert start_of([], "") == start_of([time_of("10"), time_of("5")], "") == 0
    assert start_of([time_of("1715949000500", "ms"), time_of("1715949000")], "") == 1_715_949_000
    assert start_of([time_of("1970-01-01T00:00:05Z")], "") == 5


def test_a_time_in_ns_may_look_like_a_date():
    assert [time_of("201012152359", "ns"), time_of("20101215235900", "us")] == [
        Decimal("201.012152359"),
        Decimal("20101215.2359"),
    ]


TIMES_OF_NOTHING = {
    "one number for a date and a time": (
        ["20240517120000", "20240517120001"],
        "'20240517120000' is probably a date: write 2024-05-17T12:00:00 instead",
    ),
    "one number for a date and minutes": (["202405171200", "202405171201"], "write 2024-05-17T12:00:00 instead"),
    "one number for a date": (["20240517", "20240518"], "probably dates: write 2024-05-17 instead of 20240517"),
    "microseconds": (["150000000", "150100000"], "the times begin at 1500*e?.*: they are probably in ms, us or ns"),
    "microseconds before 2001": (["999999999"], "they are probably in ms, us or ns"),
    "milliseconds in the year 2635": (["20999999999999"], "is too great for a time in s"),
}


@pytest.mark.parametrize(("times", "why"), TIMES_OF_NOTHING.values(), ids=TIMES_OF_NOTHING)
@pytest.mark.parametrize("form", ["trace", "flow", "table", "ns-2", "BonnMotion"])
def test_a_number_that_is_neither_a_time_nor_a_date_is_refused_in_every_file(tmp_path, times, why, form):
    rows = [f"{time},1,2" for time in times]
    texts = {
        "trace": "t,value\n" + "".join(f"{time},0.1\n" for time in times),
        "ns-2": "$node_(0) set X_ 1\n$node_(0) set Y_ 1\n"
        + "".join(f'$ns_ at {time} "$node_(0) setdest 2 2 1"\n' for time in times),
        "BonnMotion": " ".join(f"{time} 1 2" for time in times) + "\n",
    }
    file = tmp_path / ("f.tcl" if form == "ns-2" else "f.movements" if form == "BonnMotion" else "f.csv")
    file.write_text(texts.get(form, "t,x,y\n" + "\n".join(rows) + "\n"))
    model = {"trace": LatencyTrace, "flow": RecordedFlow}.get(form, RecordedMotion)
    with pytest.raises(ValueError, match=why):
        model(file=str(file))


def test_dates_of_the_last_century_and_long_logs_in_small_units_are_read():
    table = "t,value\n1990-05-01T00:00:00Z,0.1\n1990-05-01T00:00:01Z,0.1\n"
    assert LatencyTrace(table=table).measurements.times.tolist() == [0, 10**9]
    table = "t,value\n20240517,0.1\n20240518,0.1\n"
    assert LatencyTrace(table=table, time_unit="ms").measurements.times.tolist() == [0, 10**6]


def test_a_record_of_which_only_the_first_row_counts_is_warned_of():
    """Relative times in us, for instance, are taken for s."""
    slow, fast = ((0.0, 1.0, 1.0), (2e6, 2.0, 2.0)), ((0.0, 1.0, 1.0), (2.0, 2.0, 2.0))
    table = "t,value\n1500000000,0.1\n1500020000,0.1\n"
    scenario = Scenario(
        horizon=10.0,
        network=Links(latency=LatencyTrace(table=table)),
        environment=Environment(flow=RecordedFlow(velocities=slow)),
        evader=Evader(strategy=RecordedMotion(waypoints=slow)),
    )
    told = dict(warnings(scenario))
    for key in ("network.latency.time_unit", "environment.flow.velocities", "evader.strategy.waypoints"):
        assert "the second is at 2" in told[key]
    good = scenario.with_(
        {
            "network.latency.table": "t,value\n0,0.1\n2,0.1\n",
            "environment.flow.velocities": fast,
            "evader.strategy.waypoints": fast,
        }
    )
    assert not any("only the first" in why for _, why in warnings(good))


@pytest.mark.parametrize(("step", "is_told"), [(0.02, False), (1.0, False), (20.0, True)], ids=["s", "1 Hz", "ms"])
def test_a_table_of_which_few_rows_count_is_warned_of(step, is_told):
    """Measurements at 50 Hz whose times are in ms, without a name that says so, are 20 s apart."""
    rows = [(step * k, 1.0 + 0.001 * k, 1.0) for k in range(100)]
    scenario = Scenario(
        horizon=60.0,
        network=Links(latency=LatencyTrace(table="t,value\n" + "".join(f"{t},0.1\n" for t, _, _ in rows))),
        environment=Environment(flow=RecordedFlow(velocities=tuple(rows))),
        evader=Evader(strategy=RecordedMotion(waypoints=tuple(rows))),
    )
    told = {key: why for key, why in warnings(scenario) if "another unit" in why}
    keys = {"network.latency.time_unit", "environment.flow.velocities", "evader.strategy.waypoints"}
    assert set(told) == (keys if is_told else set())
    assert all("only 4 of 100 " in why and "the last is at 1980 s" in why for why in told.values())


FILLS = ["-9999", "-9999.0", "-999", "99999", "-32768", "9.96921e+36", "1e20", "--", "nan"]


@pytest.mark.parametrize("fill", FILLS)
def test_a_value_that_stands_for_a_missing_one_is_no_velocity_and_no_place(tmp_path, fill):
    """Grids of ESRI, files of netCDF and masked arrays of numpy have them; a table of links leaves its cells empty."""
    file = tmp_path / "f.csv"
    file.write_text(f"t,x,y\n0,1,2\n1,{fill},{fill}\n2,1,1\n")
    for model in (RecordedFlow, RecordedMotion):
        with pytest.raises(ValueError, match=r"f\.csv, line 3: "):
            model(file=str(file))
    file.write_text("t,x,y\n0,1,-999\n1,-9999,99999\n")  # a place that is far away
    assert len(RecordedMotion(file=str(file)).waypoints) == 2


def test_a_latency_that_stands_for_no_answer_is_refused_or_told():
    with pytest.raises(ValueError, match=r"at least 0 \(got -9999\); if it is missing, leave its cell empty"):
        LatencyTrace(table="t,value\n0,1\n1,-9999\n")
    capped = LatencyTrace(table="t,value\n0,1\n1,9999\n", unit="ms")
    told = dict(warnings(Scenario(network=Links(latency=capped))))
    assert told["network.latency.value"] == "9999 ms may stand for a message without an answer: leave its cells empty"
    answerless = {"network.latency.values": "9999 may stand for a message without an answer: leave it out"}
    for latency in (Empirical(values=[0.1, 9999.0]), LatencyMatrix(values=[[0, 9999], [20, 0]], unit="ms")):
        assert answerless.items() <= dict(warnings(Scenario(team={"count": 2}, network=Links(latency=latency)))).items()
    plain = LatencyMatrix(values=[[0, 10], [20, 0]], unit="ms")
    assert not dict(warnings(Scenario(team={"count": 2}, network=Links(latency=plain))))
    for cell in ("", "--", "*", "#N/A"):
        assert LatencyTrace(table=f"t,value\n0,1\n1,{cell}\n").measurements.is_missing.tolist() == [False, True]


def of_links(*times):
    """Return the rows of links to node 9, one from each of the nodes 0, 1, ... with some times."""
    return "".join(f"{t},{src},9,1\n" for src, of_link in enumerate(times) for t in of_link)


@pytest.mark.parametrize(
    ("rows", "end"),
    [
        ("0,0,1,1\n", 1.0),
        ("5,0,1,1\n5,1,0,1\n", 1.0),
        ("0,0,1,1\n3,0,1,1\n4,0,1,1\n", 6.0),  # a mean interval of 2 s
        ("0,0,1,1\n0.5,1,0,1\n1,0,1,1\n1.5,1,0,1\n", 2.0),  # by turns, each link has an interval of 1 s
        ("0,0,1,1\n0.5,1,0,1\n1,0,1,1\n1.5,1,0,1\n9,2,1,1\n", 11.25),  # the last time, and a mean interval of 2.25 s
        (of_links([0, 10], [0, 5, 10], [0, 10]), 20.0),  # the median link lasts as long, with an interval of 10 s
        (of_links([0, 10], [0, 5, 10], [0, 5, 10]), 15.0),  # the longest link is not the median
    ],
)
def test_the_last_measurement_holds_for_a_mean_interval(rows, end):
    assert LatencyTrace(table=f"t,src,dst,value\n{rows}").span == end


@pytest.mark.parametrize(
    ("text", "options", "complaint"),
    [
        ("", {}, r"rtt\.csv is empty: its first line should have the names of its columns"),
        ("# a comment\n\n,,\n", {}, r"rtt\.csv is empty"),
        ("t,value\n", {}, r"rtt\.csv has no rows"),
        ("time,rtt\n0,1\n", {}, r"rtt\.csv has no column 't'; its columns are time, rtt \["),
        (
            "0,1\n1,2\n",
            {},
            r"has no column 't'; its columns are 0, 1; a header should have names, and not begin with # \[",
        ),
        ("t,value\n1_000,1\n", {}, r"line 2: t: '1_000' is not a number; a number has the digits 0 to 9"),
        ("t,value,value\n0,1,1\n", {}, r"rtt\.csv has several columns 'value'; its columns are t, value, value"),
        ("t,value\n0,1,5\n", {}, r"line 2: has 3 cells, but the table has 2 columns"),
        ("value;t\n0,1;5\n0,2\n", {}, r"line 3: has 1 cell, but the table has 2 columns"),
        ("a;t;value\n0;1;0,5\n0;2\n", {}, r"line 3: has 2 cells, but the table has 3 columns"),
        ('t,value\n0,"1\n', {}, r"rtt\.csv, line 3: unexpected end of data"),
        ("# c\nt,value\n0,1\n\n1,x\n", {}, r"rtt\.csv, line 5: value: 'x' is not a number"),
        ("t,value\n,1\n", {}, r"line 2: t: '' is neither a number nor a date such as 2024-05-17T12:30:00\.25Z"),
        ("t,value\nnan,1\n", {}, r"line 2: t: 'nan' is neither a number nor a date"),
        ("t,value\n1e99,1\n", {}, r"line 2: t: '1e99' is too great for a time in s"),
        ("t,value\n0,1\n2e9,1\n", {}, r"line 3: t should be at most 1e\+09 s after the earliest time"),
        ("t,value\n0,-3\n", {}, r"line 2: a latency should be at least 0 \(got -3\)"),
        ("t,value\n0,inf\n", {}, r"line 2: a latency should be at most 1e\+09 \(got inf\)"),
        ("t,value\n0,3e12\n", {"unit": "ms", "rtt": True}, r"line 2: a latency should be at most 2e\+12 \(got 3e12\)"),
        (
            "t,value\n0,1\n2,1\n2,1\n",
            {},
            r"line 4: t should increase; .* line 3, of the same link; if the rows are of several links, src and dst",
        ),
        (
            "t,src,dst,value\n3,0,1,1\n2,1,0,1\n2,0,1,1\n1,1,0,1\n",
            {},
            r"line 4: t should increase; it is not later than in line 2, of the same link(?!;)",
        ),
        (
            "t,src,value\n0,0,1\n",
            {},
            r"src and dst should both be columns of rtt\.csv, or neither; its columns are t, src",
        ),
        ("t,value\n0,1\n", {"src": "from", "dst": "to"}, r"rtt\.csv has no column 'from'; its columns are t, value"),
        ("t,src,dst,value\n0,0,0,1\n", {}, r"line 2: a link should join two nodes \(got 0 and 0\)"),
        ("t,src,dst,value\n0,0,1.0,1\n", {}, r"line 2: dst: '1\.0' is not an integer"),
        ("t,src,dst,value\n0,-1,0,1\n", {}, r"line 2: src should be the number of a node, 0 or more \(got '-1'\)"),
        (
            PER_LINK,
            {"both_ways": True},
            r"line 4: with both_ways, only one direction should have rows; 0 and 1 have both",
        ),
        ("t,value\n0,1\n", {"table": "t,value\n0,1\n"}, r"should have a file or a table, not both"),
        ("t,value\n0,1\n", {"start": "random", "after": "hold"}, r'start = "random" requires after = "repeat"'),
        ("t,value\n0,1\n", {"start": 1.0, "after": "error"}, r"start should be before the end of the trace at 1 s"),
    ],
)
def test_a_faulty_file_is_refused_with_its_name_and_the_line(read, text, options, complaint):
    with pytest.raises(ValueError, match=complaint):
        read(text, **options)


@pytest.mark.parametrize(
    ("model", "cell", "complaint"),
    [
        (LossTrace, "1.5", r"line 2: a probability of loss should be at most 1 \(got 1\.5\)"),
        (LossTrace, "-1", r"line 2: a probability of loss should be at least 0 \(got -1\)"),
        (SignalTrace, "2147483647", r"line 2: a signal strength in dB should be at most 1000 \(got 2147483647\)"),
    ],
)
def test_a_loss_is_a_probability_and_a_signal_is_in_decibels(read, model, cell, complaint):
    with pytest.raises(ValueError, match=complaint):
        read(f"t,value\n0,{cell}\n", model)


@pytest.mark.parametrize("column", ["src", "dst"])
def test_the_largest_number_of_a_node_is_that_of_32_bits(read, column):
    """The number of a link is made of two such numbers, in 64 bits."""
    text = "t,src,dst,value\n0,{},{},0.5\n"
    numbers = {"src": 0, "dst": 1}
    read(text.format(*(numbers | {column: 2**31 - 1}).values()))
    for number in (2**31, 2**31 + 1):
        with pytest.raises(ValueError, match=rf"{column} should be the number of a node, 0 or more \(got '{number}'\)"):
            read(text.format(*(numbers | {column: number}).values()))


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("none.csv", "No such file"),
        ("binary.csv", "it is not text in UTF-8"),
        (".", "Is a directory"),
    ],
)
def test_an_unreadable_file_is_reported_by_its_name(tmp_path, name, why):
    (tmp_path / "binary.csv").write_bytes(b"\xff\x00\x01")
    with pytest.raises(ValidationError, match=f"{name} cannot be read: .*{why}"):
        LatencyTrace.model_validate({"file": name}, context={"folder": tmp_path})


def test_a_trace_needs_a_file_or_a_table():
    for options in ({}, {"file": None}):
        with pytest.raises(ValueError, match="should have a file, or a table"):
            LatencyTrace(**options)
    with pytest.raises(ValueError, match="the table is empty"):
        LatencyTrace(table="")
    with pytest.raises(ValueError, match="a path"):
        LatencyTrace(file=3)


NAMED = "t,src,dst,value\n0,uav10,gateway,0.1\n0,uav2,gateway,0.2\n1,gateway,uav2,0.3\n"


def ways(trace):
    return list(zip(trace.measurements.src.tolist(), trace.measurements.dst.tolist(), strict=True))


def test_named_nodes_are_numbered_in_the_order_of_the_table_or_in_the_order_given(read):
    trace = read(NAMED)
    assert trace.named_nodes == "0 is uav10, 1 is gateway, 2 is uav2"
    assert ways(trace) == [(0, 1), (1, 2), (2, 1)]
    header, *rows = NAMED.splitlines()
    assert ways(read("\n".join([header, rows[2], rows[0]]), start="random")) == [(0, 1), (2, 0)]
    chosen = read(NAMED, nodes=["uav2", "uav10", "gateway"])
    assert chosen.named_nodes is None
    assert ways(chosen) == [(0, 2), (1, 2), (2, 0)]
    assert LatencyTrace.model_validate(chosen.plain()) == chosen
    assert ways(read(NAMED.replace("uav10", "7"), nodes=["uav2", "7", "gateway"])) == ways(chosen)
    macs = read("t,src,dst,value\n0,00:11:22:33:44:55,10.0.0.1,1\n1,0x1f,10.0.0.1,1\n")
    assert macs.named_nodes == "0 is 00:11:22:33:44:55, 1 is 10.0.0.1, 2 is 0x1f"


@pytest.mark.parametrize(
    ("text", "options", "complaint"),
    [
        (NAMED.replace("uav10", "3"), {}, r"line 3: src: 'uav2' is not an integer; give the names of nodes in `nodes`"),
        (NAMED.replace("uav10", ""), {}, r"line 2: src: '' is not an integer; give the names"),
        (NAMED, {"nodes": ["uav2", "gateway"]}, r"line 2: src: 'uav10' is not in nodes"),
        (NAMED, {"nodes": ["uav2", "uav2"]}, r"nodes should have each name once"),
        ("t,value\n0,1\n", {"nodes": ["a", "b"]}, r"nodes are the names in the columns src and dst"),
        (NAMED.replace("uav10", "gateway"), {}, r"line 2: a link should join two nodes \(got gateway and gateway\)"),
    ],
)
def test_names_that_are_numbers_or_not_known_are_refused(read, text, options, complaint):
    with pytest.raises(ValueError, match=complaint):
        read(text, **options)


def test_the_numbers_of_named_nodes_are_shown():
    table = NAMED.replace("uav10", "uav1")
    network = {"loss": {"kind": "trace", "table": table, "received": True}}
    graph = {"kind": "edges", "edges": [{"src": 0, "dst": 1}, {"src": 2, "dst": 1}, {"src": 1, "dst": 2}]}
    scenario = Scenario(team={"count": 3}, network=network | {"graph": graph | {"directed": True}})
    shown = "the nodes of the table are numbered in its order: 0 is uav1, 1 is gateway, 2 is uav2"
    assert ("network.loss.nodes", shown) in list(warnings(scenario))
    many = "t,src,dst,value\n" + "".join(f"{k},a{k},b{k},1\n" for k in range(50))
    assert LatencyTrace(table=many).named_nodes.endswith("18 is a9, ..., 99 is b49")


def test_the_numbers_of_named_nodes_in_the_trace_of_an_edge_are_shown_once():
    trace = {"kind": "trace", "table": "t,src,dst,value\n0,b,a,1\n0,a,b,1\n"}
    graph = {"kind": "edges", "edges": [{"src": 0, "dst": 1, "latency": trace}]}
    shown = ("network.graph", "the nodes of the table are numbered in its order: 0 is b, 1 is a")
    assert list(warnings(Scenario(team={"count": 2}, network={"graph": graph}))).count(shown) == 1


@pytest.mark.parametrize("between", ["hold", "linear"])
def test_a_reception_ratio_is_one_minus_a_loss(between):
    rows = "t,value\n0,{}\n1,{}\n2,\n3,{}\n"
    loss = LossTrace(table=rows.format(0.25, 1, 0), between=between)
    ratio = LossTrace(table=rows.format(0.75, 0, 1), between=between, received=True)
    assert Playback(ratio).mean() == Playback(loss).mean()
    assert ratio.scaled(np.array([0.75, 1.0])).tolist() == [0.25, 0.0]


def test_the_line_of_a_link_has_one_row_at_time_0_and_one_at_the_end():
    trace = LatencyTrace(table="t,src,dst,value\n0,0,1,0.5\n1,1,0,0.25\n")
    lines = [
        (times.tolist(), values.tolist(), is_missing.any()) for times, values, is_missing in Playback(trace).lines()
    ]
    assert lines == [([0.0, 2.0], [0.5, 0.5], False), ([0.0, 1.0, 2.0], [0.25] * 3, False)]


@pytest.mark.parametrize("cell", ["", " ", "-", "nan", "NaN", "NA", "n/a", "NULL", "none"])
def test_a_missing_value_may_be_written_in_several_ways(cell):
    assert LossTrace(table=f"t,value\n0,1\n1,{cell}\n").measurements.is_missing.tolist() == [False, True]


# The links of the network.

TRACE = {"kind": "trace", "table": PER_LINK}
ONE_WAY = TRACE | {"table": PER_LINK.replace("0,1,0,0.3\n", "")}
FAR = TRACE | {"table": f"{PER_LINK}2,0,3,0.1\n"}
OWN = {"src": 1, "dst": 2, "both_ways": True}


@pytest.mark.parametrize(
    ("network", "complaint"),
    [
        ({"latency": TRACE}, "network.latency: the table has no row for the link from 0 to 2"),
        ({"loss": TRACE}, "network.loss: the table has no row for the link from 0 to 2"),
        ({"duplicate": TRACE}, "network.duplicate: the table has no row for the link from 0 to 2"),
        ({"latency": FAR}, r"network.latency: the table, line 5: there is no node 3: the nodes are 0 \.\. 2"),
        (
            {"link": [OWN | {"order": "fifo"}, {"src": 0, "dst": 2, "loss": TRACE}]},
            "network.link.1.loss: .*from 0 to 2",
        ),
        (
            {"graph": {"kind": "edges", "edges": [{"src": 0, "dst": 2, "latency": TRACE}]}},
            "network.graph: .*from 0 to 2",
        ),
        (
            {"graph": {"kind": "edges", "edges": [{"src": 0, "dst": 1}]}, "latency": ONE_WAY},
            "the link from 1 to 0; with both_ways = true, a row also holds for the way back",
        ),
    ],
)
def test_a_link_without_a_row_is_refused_with_the_key_of_its_model(network, complaint):
    with pytest.raises(ValueError, match=complaint):
        Scenario(team={"count": 3}, network=network)


@pytest.mark.parametrize(
    "network",
    [
        {"graph": {"kind": "edges", "edges": [{"src": 0, "dst": 1}]}, "latency": TRACE},
        {"graph": {"kind": "edges", "edges": [{"src": 0, "dst": 1}]}, "latency": ONE_WAY | {"both_ways": True}},
        {"graph": {"kind": "edges", "edges": [{"src": 0, "dst": 1}], "directed": True}, "loss": ONE_WAY},
        {
            "graph": {"kind": "edges", "edges": [{"src": 0, "dst": 1}, {"src": 1, "dst": 2}]},
            "latency": TRACE,
            "link": [OWN | {"latency": 0.5}],
        },
    ],
)
def test_a_link_that_does_not_exist_or_has_a_model_of_its_own_needs_no_row(network):
    Scenario(team={"count": 3}, network=network)


def test_a_network_refuses_a_link_without_a_row():
    with pytest.raises(ValueError, match="latency: the table has no row for the link from 0 to 2"):
        Network(Clock(), nx.complete_graph(3), Links(latency=LatencyTrace(table=PER_LINK)))


@pytest.mark.parametrize("named", [*PER_SECOND, "min", "%"])
@pytest.mark.parametrize("form", ["x_{}", "x ({})", "X [{}]"])
@pytest.mark.parametrize(
    ("model", "key", "column"),
    [(model, "time_unit", "time") for model in (LatencyTrace, LossTrace, SignalTrace)]
    + [(LatencyTrace, "unit", "value"), (LossTrace, None, "value")],
)
def test_a_column_named_after_another_unit_is_refused(named, form, model, key, column):
    name = form.format(named)
    columns = {"time": "t", "value": "v", column: name}
    table = f"{columns['time']},{columns['value']}\n0,0\n1,0\n"
    for unit in PER_SECOND if key else ["s"]:
        keys = columns | ({key: unit} if key else {})
        is_least = name == "x_min" and column == "value"
        if (key and named == unit) or is_least:
            model(table=table, **keys)
        else:
            with pytest.raises(ValueError, match=f"column {re.escape(repr(name))} is in {named}, and should be in"):
                model(table=table, **keys)


@pytest.mark.parametrize(
    ("model", "column", "keys", "key"),
    [
        (LatencyTrace, "rtt", {}, "latency.rtt"),
        (LatencyTrace, "rtt", {"rtt": True}, None),
        (LossTrace, "prr", {}, "loss.received"),
        (LossTrace, "Delivery ratio", {}, "loss.received"),
        (LossTrace, "prr", {"received": True}, None),
        (LossTrace, "packet_loss", {"received": True}, "loss.received"),
        (LossTrace, "packet_loss", {}, None),
    ],
)
def test_a_column_named_after_its_opposite_gives_a_warning(model, column, keys, key):
    trace = model(table=f"t,{column}\n0,0\n1,0.5\n", value=column, **keys)
    scenario = Scenario(network=Links(**{"latency" if model is LatencyTrace else "loss": trace}))
    assert [k for k, text in warnings(scenario) if "seems to have" in text] == ([f"network.{key}"] if key else [])


def test_dates_with_and_without_a_time_zone_are_refused_with_the_reason():
    with pytest.raises(ValueError, match="dates should all have a time zone, or none"):
        LatencyTrace(table="t,value\n2024-05-17T12:30:00Z,0.1\n2024-05-17T12:30:01,0.2\n")


@pytest.mark.parametrize(
    ("column", "value", "is_told"),
    [("rssi_dbm", 127, True), ("RSRP", 0, True), ("rssi", -40, False), ("snr", 12, False), ("lqi", 255, False)],
)
def test_a_power_that_no_radio_receives_gives_a_warning(column, value, is_told):
    """802.15.4 radios log 127, and others 0, where they have received nothing."""
    trace = SignalTrace(table=f"t,{column}\n0,-80\n1,{value}\n", value=column)
    scenario = Scenario(network=Links(loss=trace))
    assert [key for key, text in warnings(scenario) if "stands for no signal" in text] == [
        "network.loss.value"
    ] * is_told


def test_a_link_that_never_received_has_no_power_of_0_dbm():
    assert SignalTrace(table="t,src,dst,rssi\n0,0,1,-80\n0,1,0,\n1,1,0,nan\n", value="rssi").doubt is None
    assert SignalTrace(table="t,rssi\n0,\n", value="rssi").doubt is None


def test_the_least_value_is_not_in_minutes_and_a_time_is():
    table = "t,rtt_min\n0,50\n1,40\n"
    assert LatencyTrace(table=table, value="rtt_min", unit="ms").mean_latency() == pytest.approx(0.045)
    for names in ({"value": "rtt [min]"}, {"value": "rtt_min", "time": "t_min"}):
        text = table.replace("rtt_min", names["value"]).replace("t,", f"{names.get('time', 't')},", 1)
        with pytest.raises(ValueError, match="is in min, and should be in"):
            LatencyTrace(table=text, unit="ms", **names)


@pytest.mark.parametrize("table", ["t,value\n0,0.1\n1,0.2\n", "t,src,dst,value\n0,0,1,0.1\n1,0,1,0.2\n"])
def test_a_table_is_shown_by_the_number_of_its_rows(table):
    assert LatencyTrace(table=table, both_ways=True).given()["table"] == "2 rows"


class Listed(Value):
    """A user's latency with rows of different lengths."""

    values: tuple[tuple[float, ...], ...] = ((0.1, 9999.0), (0.2,))

    def __call__(self, context, rng):
        return 0.1


def test_rows_of_different_lengths_in_a_users_model_give_no_warning_and_no_error():
    assert "network.latency.values" not in dict(warnings(Scenario(team={"count": 2}, network=Links(latency=Listed()))))


class OfPolars:
    """A frame with the method of polars that writes a table."""

    columns = ("t", "value")

    def write_csv(self):
        return "t,value\n0.0,0.1\n0.5,\n"


FRAME = pd.DataFrame({"t": [0.0, 0.5], "value": [0.1, np.nan]})
DATES = FRAME.assign(t=pd.date_range("2024-05-01", periods=2, freq="500ms", tz="Europe/Berlin"))


@pytest.mark.parametrize("model", [LatencyTrace, LossTrace])
@pytest.mark.parametrize(
    "frame",
    [
        *(FRAME, FRAME[["value", "t"]], FRAME.set_index("t"), DATES, DATES.set_index("t").rename_axis(None)),
        *(FRAME.set_axis([7, 5]), FRAME.assign(note="a,b"), OfPolars()),
    ],
    ids=["frame", "columns", "index", "dates", "index of dates", "labels", "more columns", "polars"],
)
def test_a_frame_is_read_as_its_csv_text(model, frame):
    trace = model(table=frame)
    assert trace == model(table="t,value\n0.0,0.1\n0.5,\n") or trace.table.startswith(
        "t,value\n2024-05-01 00:00:00.000"
    )
    assert trace.measurements.times.tolist() == [0, 500_000_000]
    assert trace.measurements.values[~trace.measurements.is_missing].tolist() == [0.1]


def test_a_frame_without_the_columns_is_refused_as_its_text_is():
    for frame, why in (
        (FRAME.rename(columns={"value": "rtt"}), "the table has no column 'value'; its columns are t, rtt"),
        (FRAME["value"], "table: should be a string"),
        (FRAME.to_numpy(), "table: should be a string"),
        (pd.DataFrame(), "the table is empty"),
    ):
        with pytest.raises(KeyedError, match=re.escape(why)):
            LatencyTrace(table=frame)


ENDS = [
    *[("Src", "Dst"), ("sender", "receiver"), ("from", "to"), ("source", "target"), ("source", "destination")],
    *[("src_id", "dst_id"), ("node_a", "node_b"), ("src_ip", "dst_ip"), ("ip.src", "ip.dst"), ("id1", "id2")],
    *[("src", "dest"), ("SRC NODE", "DST NODE"), ("tx_id", "rx_id"), ("fromNode", "toNode"), ("origin", "destination")],
]
"""Usual names of the columns of senders and receivers."""


@pytest.mark.parametrize(("src", "dst"), ENDS, ids="-".join)
def test_usual_names_of_senders_and_receivers_are_understood(src, dst):
    """Without them, the rows of both links would be one trace of all links."""
    rows = "0,0,1,0.1,7\n0.5,1,0,0.3,7\n1,0,1,0.2,7\n"
    expected = LatencyTrace(table=f"t,src,dst,value,size\n{rows}")
    read = LatencyTrace(table=f"t,{src},{dst},value,size\n{rows}")
    assert (read.src, read.dst) == (src, dst)
    for column in ("src", "dst", "times", "values"):
        assert getattr(read.measurements, column).tolist() == getattr(expected.measurements, column).tolist()
    assert LatencyTrace(table=f"t,{src},{dst},value,size\n0,0,1,0.1,7\n", src=None, dst=None).src is None


@pytest.mark.parametrize(
    "names", ["tx_power,rx_power", "tx_bytes,rx_bytes", "start,end", "src_port,dst_port", "to,size"]
)
def test_columns_that_are_no_nodes_are_left_out(names):
    assert LatencyTrace(table=f"t,{names},value\n0,3,5,0.1\n1,3,5,0.2\n").src is None


@pytest.mark.parametrize("names", ["tx,rx", "TX,RX", "a,b", "i,j", "u,v"])
def test_columns_that_may_be_nodes_are_refused(names):
    src, dst = names.split(",")
    table = f"t,{names},value\n0,0,1,0.1\n"
    with pytest.raises(KeyedError, match=f"{src} and {dst} of the table may be the senders and the receivers: say src"):
        LatencyTrace(table=table)
    assert LatencyTrace(table=table, src=src, dst=dst).src == src
    assert LatencyTrace(table=table, src=None, dst=None).src is None


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        *(("rtt [msec]", "ms"), ("rtt/ms", "ms"), ("rttMs", "ms"), ("rtt_µs", "us"), ("rtt (milliseconds)", "ms")),
        *(
            ("rtt, ms", "ms"),
            ("rtt usec", "us"),
            ("rtt_nanoseconds", "ns"),
            ("rtt in seconds", "s"),
            ("rtt_millis", "ms"),
        ),
    ],
)
def test_a_unit_may_be_written_in_any_usual_way(name, unit):
    for column, key in (("time", "time_unit"), ("value", "unit")):
        columns = {"time": "t", "value": "v", column: name}
        table = f"{columns['time']};{columns['value']}\n0;0\n1;0\n"
        LatencyTrace(table=table, **columns, **{key: unit})
        with pytest.raises(ValueError, match=f"is in {unit}, and should be in"):
            LatencyTrace(table=table, **columns, **{key: "us" if unit != "us" else "ms"})
    with pytest.raises(KeyedError, match=r"unit: column 'wait \(hours\)' is in hours, and should be in s"):
        LatencyTrace(table="t;wait (hours)\n0;0\n", value="wait (hours)")


@pytest.mark.parametrize("words", [("True", "False"), ("true", "false"), ("TRUE", "FALSE")])
def test_a_loss_may_be_a_truth_value_and_a_latency_may_not(words):
    table = "t,value\n0,{}\n1,{}\n2,\n".format(*words)
    for received, losses in ((False, [1.0, 0.0]), (True, [0.0, 1.0])):
        trace = LossTrace(table=table, received=received)
        assert trace.scaled(trace.measurements.values[:2]).tolist() == losses
    for model in (LatencyTrace, SignalTrace):
        with pytest.raises(KeyedError, match=f"line 2: value: '{words[0]}' is not a number"):
            model(table=table)
    assert LossTrace(table=pd.DataFrame({"t": [0.0, 1.0], "value": [True, False]})).measurements.values.tolist() == [
        1,
        0,
    ]

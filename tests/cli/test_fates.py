"""`desim fates`, and `desim.fates`: what a network does to the messages of a log."""

import csv
import json
from math import isnan, nan
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest

from desim import Crash, Links, Lognormal, Reliable, SteppedNetwork, fates
from desim.config.model import MAX_TIME
from tests.command import accepted, refused

SCENARIO = (
    '[team]\ncount = 3\n\n[network]\nlatency = 0.1\n\n[[fault]]\nkind = "crash"\nnode = 2\nstart = 1.0\nend = 2.0\n'
)
LOG = "t;src;dst;size\n0,5;0;1;24\n0.95;1;*;100\n# pause\n3.0;2;0;8\n"


@pytest.fixture
def files(tmp_path):
    (tmp_path / "net.toml").write_text(SCENARIO)
    (tmp_path / "log.csv").write_text(LOG.replace("0,5", "0.5"))
    return tmp_path


def test_a_log_goes_in_and_a_table_of_fates_comes_out(files):
    printed = accepted("fates", files / "log.csv", files / "net.toml").stdout
    rows = list(csv.reader(printed.splitlines()))
    assert rows == [
        ["row", "t", "src", "dst", "size", "fate", "arrived"],
        ["0", "0.5", "0", "1", "24", "delivered", "0.6"],
        ["1", "0.95", "1", "0", "100", "delivered", "1.05"],
        ["1", "0.95", "1", "2", "100", "crash", ""],
        ["2", "3.0", "2", "0", "8", "delivered", "3.1"],
    ]
    accepted("fates", files / "log.csv", files / "net.toml", "-o", files / "fates.csv")
    assert (files / "fates.csv").read_text() == printed


def test_a_message_that_is_transmitted_twice_has_its_first_arrival():
    links = Links(latency=Lognormal(mean=1.0, cv=1.0), duplicate=1.0)
    with SteppedNetwork(2, links, seed=3) as network:
        for row in range(5):
            network.send(0, 1, row, size=10)
        arrived = network.step(60.0)
    first = {row: min(message.arrived for message in arrived if message.body == row) for row in range(5)}
    assert len(arrived) == 10
    assert [fate.arrived for fate in fates([(0.0, 0, 1, 10)] * 5, 2, links, seed=3)] == list(first.values())


@pytest.mark.parametrize(
    ("log", "why"),
    [
        ("t,src,dst,size\n0.0,0,9,8\n", "log.csv, line 2: dst: there is no node 9: the nodes are 0 .. 2"),
        ("t,src,dst,size\n0.0,a,1,8\n", "log.csv, line 2: src: there is no node a"),
        ("t,src,dst\n0.0,0,1\n", "log.csv: a log has the columns t, src, dst, size; this one has t, src, dst"),
        ("t,src,dst,size\n1.0,0,1,8\n0.5,0,1,8\n", "message 1 (0.5, 0, 1, 8): t should be ascending"),
        ("t,src,dst,size\n0.0,0,1,-8\n", "at least 0 bytes"),
        ("t,src,dst,size\n0.0,1,1,8\n", "to itself"),
        ("t,src,dst,size\n0.0,0,1,8.5\n", "log.csv, line 2: size: '8.5' is not a whole number of bytes"),
        ("t,src,dst,size\n0.0,0,1,1_0\n", "log.csv, line 2: size: '1_0' is not a number"),
        ("t,src,dst,size\n0.0,0,1,\u0663\n", "is not a number"),
        ("t,src,dst,size\n20240517,0,1,8\n", "log.csv, column t: the times are probably dates"),
        ("t,src,dst,size\n2024-05-17,0,1,8\n1.0,0,1,8\n", "t should be ascending"),
        ("t,src,dst,size\nx,0,1,8\n", "log.csv, line 2: t: "),
        ("t,src,dst,size\nnan,0,1,8\n", "t"),
        ("t,src,dst,size\n", "has no rows"),
    ],
)
def test_a_wrong_log_is_refused_with_its_line(files, log, why):
    (files / "log.csv").write_text(log)
    assert why in refused("fates", files / "log.csv", files / "net.toml")


@pytest.mark.parametrize(
    "log",
    [
        "t,src,dst,size\n2024-05-17T12:30:00,0,1,24\n2024-05-17T12:30:00.45,1,*,100\n",
        "t,src,dst,size\n1700000000.0,0,1,24.0\n1700000000.45,1,,100\n",
    ],
)
def test_the_times_of_a_log_may_be_dates(files, log):
    (files / "log.csv").write_text("t,src,dst,size\n0.0,0,1,24\n0.45,1,*,100\n")
    expected = accepted("fates", files / "log.csv", files / "net.toml").stdout
    (files / "log.csv").write_text(log)
    assert accepted("fates", files / "log.csv", files / "net.toml").stdout == expected


def test_fates_say_what_is_lost_late_or_not_there_yet():
    log = [(0.0, 0, None, 8), (1.0, 1, 0, 8)]
    alike = fates(log, 3, Links(latency=0.2), faults=[Crash(start=0.9, node=0)])
    assert [(row.row, row.dst, row.fate) for row in alike] == [
        (0, 1, "delivered"), (0, 2, "delivered"), (1, 0, "crash"),
    ]  # fmt: skip
    assert isnan(alike[-1].arrived)
    late = fates(log, 3, Links(latency=5.0), wait=4.5)
    assert [row[4:6] for row in late] == [(8, "delivered"), (8, "delivered"), (8, "none")]
    assert [row.fate for row in fates(log, 3, {"loss": 1.0})] == ["loss"] * 3
    with pytest.raises(ValueError, match="wait should be"):
        fates(log, 3, wait=nan)


def test_fates_do_not_depend_on_the_time_nor_on_parts_of_nanoseconds():
    """After 1e8 s, 1 ns is less than the distance of two floats; the horizon ends the observation."""
    for t in (0.0, 1e8, MAX_TIME - 0.5):
        assert [row.fate for row in fates([(t, 0, 1, 10)], 2, {"loss": 1.0})] == ["loss"]
        assert [row.fate for row in fates([(t, 0, 1, 10)], 2, {"latency": 2.0}, wait=1.0 + 1e-10)] == ["none"]


def test_a_transport_repeats_a_logged_message_until_it_arrives():
    links = Links(latency=0.01, loss=0.5, transport=Reliable(timeout=0.1, history="keep_all"))
    log = [(0.1 * k, 0, 1, 8) for k in range(30)]
    rows = fates(log, 2, links, seed=1)
    assert {row.fate for row in rows} == {"delivered"}
    assert len(rows) == 30
    assert any(row.arrived - row.t > 0.05 for row in rows)


def test_fates_of_numbers_of_numpy_can_be_written_as_json():
    rows = [(np.float32(0.5), np.int64(0), np.int8(1), np.uint16(8)), (np.float64(1.0), np.int64(1), None, np.int64(9))]
    made = fates(rows, 2, {"latency": 0.1})
    assert made == fates([(0.5, 0, 1, 8), (1.0, 1, None, 9)], 2, {"latency": 0.1})
    assert json.loads(json.dumps(made)) == [list(fate) for fate in made]


def test_the_rows_of_a_log_may_be_a_frame_of_pandas():
    """Its column of receivers has floats if one is missing, and so has the rest of a row."""
    frame = pd.DataFrame({"t": [0.0, 0.5], "src": [0, 1], "dst": [1, None], "size": [8, 9]})
    expected = fates([(0.0, 0, 1, 8), (0.5, 1, None, 9)], 3, Links(latency=0.1))
    assert fates(frame, 3, Links(latency=0.1)) == expected
    assert fates(frame.convert_dtypes(), 3, Links(latency=0.1)) == expected  # then it is pandas.NA


@pytest.mark.parametrize("rows", [[(0.0, 0, 1)], [3], ["abcd"], [(0.0, 0, 1, 8, 9)]])
def test_a_row_that_is_no_message_is_refused(rows):
    with pytest.raises(ValueError, match=r"message 0 .*: a message should be t, src, dst, size"):
        fates(rows, 3)


class Logged(NamedTuple):
    """A message of a user's log, with its fields in another order."""

    dst: int
    src: int
    size: int
    t: float
    robot: str = "a"


def test_names_of_columns_and_fields_count_and_not_their_order():
    """Senders and receivers are integers both, so an exchange would not be noticed."""
    rows = [(0.0, 0, 2, 24), (1.0, 2, 1, 24)]
    expected = fates(rows, 3, Links(latency=0.5))
    messages = [Logged(dst, src, size, t) for t, src, dst, size in rows]
    frame = pd.DataFrame(messages)
    for others in (messages, [message._asdict() for message in messages], frame, frame.to_records(index=False)):
        assert fates(others, 3, Links(latency=0.5)) == expected
    assert fates(frame[["t", "src", "dst", "size"]].rename(columns=str.upper), 3, Links(latency=0.5)) == expected


@pytest.mark.parametrize("names", [("t_ms", "src", "dst", "size"), ("from", "to", "bytes", "time")])
def test_columns_with_other_names_are_refused_whatever_names_them(names):
    """Taken in their order, they would be read in a wrong unit or as one another."""
    frame = pd.DataFrame([(500, 0, 1, 24)], columns=names)
    named = NamedTuple("Row", [(f"{name}_", int) for name in names])
    for rows in (frame, Polars(frame), frame.to_records(index=False), frame.to_dict("records"), [named(500, 0, 1, 24)]):
        with pytest.raises(ValueError, match="columns should be t, src, dst, size: no "):
            fates(rows, 3)
    assert fates(frame.set_axis(range(4), axis=1), 3) == fates([(500, 0, 1, 24)], 3)  # none is named
    with pytest.raises(ValueError, match=r"the numbers \[1, 0, 2, 3\] are not in order"):
        fates(frame.set_axis([1, 0, 2, 3], axis=1), 3)


def test_columns_may_be_written_large():
    rows = [(0.0, 1, 0, 24)]
    frame = pd.DataFrame(rows, columns=["T", "Src", "Dst", "SIZE"])
    assert fates(frame[["SIZE", "Dst", "Src", "T"]], 2) == fates(rows, 2)


@pytest.mark.parametrize(("names", "cells"), [("123", ("0", "3")), ("012", ("0", "2")), ("abc", ("0", "c"))])
def test_a_number_is_the_name_of_a_node_where_names_are_numbers(files, names, cells):
    """Among nodes 1 .. 3, a log that counts from 0 would be read as one that counts from 1, but for its 0."""
    graph = "\n".join(f"{a} {b}" for a, b in zip(names, names[1:] + names[0], strict=True))
    (files / "ring.txt").write_text(graph)
    (files / "net.toml").write_text('team.count = 3\nnetwork.graph = { kind = "edges", file = "ring.txt" }\n')
    (files / "log.csv").write_text(f"t,src,dst,size\n0.0,{cells[0]},{cells[1]},8\n")
    arguments = "fates", files / "log.csv", files / "net.toml"
    if cells[0] in names or names == "abc":
        assert "delivered" in accepted(*arguments).stdout
    else:
        assert "there is no node 0: the nodes are 1 .. 3" in refused(*arguments)


class Polars:
    """A frame as that of polars."""

    def __init__(self, frame):
        self._frame, self.columns = frame, list(frame.columns)

    def __getitem__(self, columns):
        return Polars(self._frame[columns])

    def __iter__(self):
        raise AssertionError("its items are columns")

    def iter_rows(self):
        return self._frame.itertuples(index=False, name=None)


def test_a_frame_may_be_one_of_polars():
    frame = pd.DataFrame({"size": [24], "t": [0.0], "src": [0], "dst": [1]})
    assert fates(Polars(frame), 2) == fates([(0.0, 0, 1, 24)], 2)


@pytest.mark.parametrize("messages", ["log.csv", Path("log.csv"), None, 3])
def test_what_has_no_rows_is_refused(messages):
    with pytest.raises(ValueError, match="messages should be rows of t, src, dst, size"):
        fates(messages, 2)


def test_the_walls_of_a_scenario_stand_between_the_nodes(files):
    wall = "team.positions = [[0.0, 0.0], [4.0, 0.0], [8.0, 0.0]]\n[[wall]]\nline = [[6.0, -9.0], [6.0, 9.0]]\n"
    (files / "net.toml").write_text("network = { latency = 0.1, range = 99.0 }\nteam.count = 3\n" + wall)
    (files / "log.csv").write_text("t,src,dst,size\n0.0,0,1,8\n0.0,0,2,8\n")
    printed = accepted("fates", files / "log.csv", files / "net.toml").stdout
    assert [row["fate"] for row in csv.DictReader(printed.splitlines())] == ["delivered", "out_of_range"]


def test_nodes_with_names_are_read_and_written_by_name(files):
    (files / "links.edgelist").write_text("b 7\n")
    (files / "named.toml").write_text('team.count = 2\nnetwork.graph = { kind = "edges", file = "links.edgelist" }\n')
    (files / "named.csv").write_text("t,src,dst,size\n0.5,b,7,24\n1.0,7,b,8\n")
    printed = accepted("fates", files / "named.csv", files / "named.toml").stdout
    assert [row[2:4] for row in csv.reader(printed.splitlines())] == [["src", "dst"], ["b", "7"], ["7", "b"]]
    (files / "named.csv").write_text("t,src,dst,size\n0.5,0,1,24\n")
    assert "there is no node 0" in refused("fates", files / "named.csv", files / "named.toml")

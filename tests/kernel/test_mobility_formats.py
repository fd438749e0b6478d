"""Mobility files of all formats: any record comes back from each, in every encoding, and other meanings are refused."""

import gzip
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from math import hypot

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from desim import RecordedMotion, Team
from desim.config.column_names import header_of
from desim.pursuit.mobility.mobility import Waypoint
from desim.pursuit.mobility.mobility_file import read_mobility
from tests.kernel.test_mobility_file import interpolated

NAMES = ["uav3", "base", "n0"]
NAMED = {"csv", "header with units", "commented header", "semicolons", "decimal commas", "tabs", "dates", "since 1970"}
NAMED |= {"since 1970 in us", "milliseconds", "a line of units", "FCD"}
"""The formats in which nodes have names."""


def bonnmotion(tracks, z=""):
    return "".join(" ".join(f"{t!r} {x!r} {y!r}{z}" for t, x, y, _ in track) + "\n" for track in tracks)


def ns2(tracks, array="$node_({})", start=0.0):
    lines = []
    for k, track in enumerate(tracks):
        node, (_, x, y, _) = array.format(k), track[0]
        lines += [f"{node} set X_ {x!r}; {node} set Y_ {y!r} ;# node {k}", f"{node} set Z_ 0.0"]
        for (t, x, y, _), (t_after, x_after, y_after, _) in pairwise(track):
            speed = hypot(x_after - x, y_after - y) / (t_after - t)
            lines.append(f'$ns_ at {start + t!r} "{node} setdest {x_after!r} {y_after!r} {speed!r}" ;# leg')
    return "\n".join(lines) + "\n"


def table(tracks, mark=",", header="t,node,x,y", names=NAMES, when=repr):
    rows = sorted((t, k, x, y) for k, track in enumerate(tracks) for t, x, y, _ in track)
    return "\n".join([header, *(mark.join([when(t), names[k], repr(x), repr(y)]) for t, k, x, y in rows)]) + "\n"


def fcd(tracks):
    """Each row of SUMO has a time step of its own here; nodes that share a time are in several steps of that time."""
    rows = sorted((t, k, x, y) for k, track in enumerate(tracks) for t, x, y, _ in track)
    steps = (
        f'<timestep time="{t!r}">\n<vehicle id="{NAMES[k]}" x="{x!r}" y="{y!r}" z="0"/></timestep>'
        for t, k, x, y in rows
    )
    return "\n".join(["<?xml version='1.0'?>", "<!-- made --><fcd-export>", *steps, "</fcd-export>"])


def ros(tracks):
    """Rows as `rostopic echo -p` writes them: nanoseconds since 1970, and positions among other vectors."""
    header = (
        "%time,id,field.pose.pose.position.x,field.pose.pose.position.y,field.pose.pose.orientation.x,field.twist.x"
    )
    lines = table(tracks, header=header, names="012", when=lambda t: str(17 * 10**17 + round(t * 1e9))).splitlines()
    return "\n".join([lines[0], *(f"{line},0.7,9" for line in lines[1:])])


def date(t):
    return (datetime(2024, 5, 1, tzinfo=UTC) + timedelta(seconds=t)).isoformat()


FORMATS = {
    "BonnMotion": bonnmotion,
    "BonnMotion with heights": lambda tracks: f"#3D\n{bonnmotion(tracks, ' 7.5')}",
    "BonnMotion since 1970": lambda tracks: bonnmotion(
        [[each._replace(t=1.7e9 + each.t) for each in track] for track in tracks]
    ),
    "ns-2": ns2,
    "ns-2 of SUMO": lambda tracks: ns2(tracks, "$mnode_({})"),
    "ns-2 with variables": lambda tracks: ns2(tracks, "$n{}"),
    "ns-2 since 1970": lambda tracks: ns2(tracks, start=1.7e9),
    "csv": table,
    "csv with numbers": lambda tracks: table(tracks, names="012"),
    "header with units": lambda tracks: table(tracks, header="Time [s],ID,X [m],Y [m]"),
    "commented header": lambda tracks: table(tracks, " ", "# t node x y"),
    "semicolons": lambda tracks: table(tracks, ";", "t;node;x;y"),
    "decimal commas": lambda tracks: table(tracks, ";", "t;node;x;y").replace(".", ","),
    "tabs": lambda tracks: table(tracks, "\t", "time\tid\tx\ty"),
    "dates": lambda tracks: table(tracks, when=date),
    "since 1970": lambda tracks: table(tracks, when=lambda t: repr(1.7e9 + t)),
    "since 1970 in us": lambda tracks: table(tracks, when=lambda t: repr(1.7e15 + t * 1e6)),
    "milliseconds": lambda tracks: table(tracks, header="time_ms,id,X / m,Y / m", when=lambda t: repr(t * 1e3)),
    "a line of units": lambda tracks: table(tracks, header="time,id,x,y\nus,,m,m", when=lambda t: repr(t * 1e6)),
    "vectors": ros,
    "FCD": fcd,
}
ENCODINGS = {
    "plain": str.encode,
    "gzip": lambda text: gzip.compress(text.encode()),
    "BOM": lambda text: text.encode("utf-8-sig"),
    "UTF-16": lambda text: text.encode("utf-16"),
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
}
numbers = st.integers(-800, 800).map(lambda number: number / 8.0)


@st.composite
def tracks(draw):
    """Draw the waypoints of up to three nodes; all begin at time 0, and times are multiples of 1/8 s."""
    made = []
    for _ in range(draw(st.integers(1, 3))):
        times = sorted(draw(st.sets(st.integers(1, 400), max_size=4)))
        made.append([Waypoint(t / 8.0, draw(numbers), draw(numbers), 0) for t in (0, *times)])
    return made


def read(folder, content, node=0, **keys):
    (folder / "motion.txt").write_bytes(content)
    return read_mobility(folder / "motion.txt", **keys).track(node)


def check_comes_back(folder, name, encoding, tracks, t):
    """Check that at a time each node is where the record says."""
    dimensions = 2 if name in {"BonnMotion", "BonnMotion since 1970"} else None
    for k, right in enumerate(tracks):
        node = NAMES[k] if name in NAMED else k
        found = read(folder, ENCODINGS[encoding](FORMATS[name](tracks)), node, dimensions=dimensions)
        assert abs(interpolated(found.waypoints, t) - interpolated(right, t)) < 1e-6
        assert found.has_heights == (name == "BonnMotion with heights")


@pytest.mark.slow_but_one
@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", FORMATS)
@settings(max_examples=4, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(tracks=tracks(), t=st.floats(0.0, 60.0))
def test_any_record_comes_back_from_every_format(tmp_path, name, encoding, tracks, t):
    check_comes_back(tmp_path, name, encoding, tracks, t)


@pytest.mark.parametrize("name", FORMATS)
def test_a_record_comes_back_from_every_format(tmp_path, name):
    """Two nodes on the move at 2 s, of which one has begun with a pause."""
    walks = [[(0.0, 1.0, 2.0), (4.0, 3.0, 40.0)], [(0.0, 5.0, -6.0), (1.5, 5.0, -6.0), (9.0, -7.0, 80.0)]]
    check_comes_back(tmp_path, name, "plain", [[Waypoint(*each, 0) for each in walk] for walk in walks], 2.0)


HEIGHTS = {
    "marked": ("#3D\n0 10 12 5 6 12 12 12 16 14 12 18\n", None),
    "told": ("0 10 12 5 6 12 12 12 16 14 12 18\n", 3),
    "times increase in one reading only": ("0 10 12 50 6 12 12 12 16 14 12 18\n", None),
}


@pytest.mark.parametrize("name", HEIGHTS)
def test_heights_are_dropped_if_it_is_clear_that_they_are_heights(tmp_path, name):
    """INET's example of a drone, once with a greater first height, which cannot be a time."""
    text, dimensions = HEIGHTS[name]
    track = read(tmp_path, text.encode(), dimensions=dimensions)
    assert [each[:3] for each in track.waypoints] == [(0.0, 10.0, 12.0), (6.0, 12.0, 12.0), (16.0, 14.0, 12.0)]
    assert track.has_heights


def test_triples_stay_triples(tmp_path):
    """Twelve numbers, of which every fourth decreases; and a line beside of another length."""
    text = b"0 50 2 5 10 40 16 5 2 31 1 1\n"
    assert [each[0] for each in read(tmp_path, text).waypoints] == [0.0, 5.0, 16.0, 31.0]
    text = b"0 5 2 5 6 40 10 15 22 31 1 1\n0 1 1\n"
    assert [each[0] for each in read(tmp_path, text).waypoints] == [0.0, 5.0, 10.0, 31.0]


def test_dates_share_one_clock_and_rows_of_several_nodes_may_alternate(tmp_path):
    text = b"id,t,x,y,z\nb,2024-05-01T12:00:00Z,1,2,\na,2024-05-01T12:00:02.5Z,7,8,\nb,2024-05-01T12:00:04Z,3,4,9\n"
    assert [each[:3] for each in read(tmp_path, text, "a").waypoints] == [(2.5, 7.0, 8.0)]
    assert [each[:3] for each in read(tmp_path, text, "b").waypoints] == [(0.0, 1.0, 2.0), (4.0, 3.0, 4.0)]
    assert read(tmp_path, text, 0).has_heights
    assert not read(tmp_path, text, 1).has_heights


START = "$node_(0) set X_ 1.0\n$node_(0) set Y_ 2.0\n"
REFUSED = {
    "dates with and without a zone": (
        "t,x,y\n2024-05-01T12:00:00Z,1,2\n2024-05-01T12:00:01,2,2\n",
        r"line 3: a time should be .*; dates should all have a time zone, or none",
    ),
    "quadruples": (
        "0 10 12 5 6 12 12 12\n",
        r"line 1: .*there are 8; 4 numbers per waypoint\? Then set dimensions = 3",
    ),
    "either": ("0 10 12 5 6 12 12 12 16 14 12 18\n", r"with two and with three coordinates .*: set dimensions = 2"),
    "cut quadruples": (
        "#3D\n0 1 2 3 1 2\n",
        r"line 2: should be t1 x1 y1 z1 t2 \.\.\., four numbers each; there are 6",
    ),
    "only moves": ('$ns_ at 1.0 "$node_(0) setdest 5 5 1"\n', r"node 0 has no initial position: \$node_\(0\) set X_"),
    "only moves of n0": (
        '$ns_ at 1.0 "$n0 setdest 5 5 1"\n',
        r"node 0 has no initial position: \$n0 set X_ is missing",
    ),
    "twice": (f"{START}$node_(0) set X_ 3\n", r"line 3: sets X_ of node 0 again; line 1 has set it"),
    "two arrays": (f"{START}$mnode_(0) set X_ 1\n", r"line 3: names nodes \$mnode_, and the lines above \$node_"),
    "height": (f'{START}$ns_ at 1 "$node_(0) setdest 1 2 3 4"\n', r"line 3: a setdest with a height .* is not read"),
    "move to a point without a speed": (f'{START}$ns_ at 1 "$node_(0) setdest 1 2"\n', r"line 3: should have the form"),
    "move without a time": (f"{START}$node_(0) setdest 1 2 3\n", r"line 3: should have the form"),
    "time with a unit": (
        f'{START}$ns_ at 1s "$node_(0) setdest 1 2 3"\n',
        r"line 3: '1s' is neither a number nor a date",
    ),
    "word": ("0 10 x 5 6 12\n", r"line 1: 'x' is not a number"),
    "commas": ("0,0 10,5 12,0 5,0 1,0 2,0\n", r"line 1: '0,0' is .*; the decimal sign is a point"),
    "commas in a table": ("t,x,y\n0,1,5,2\n", r"line 2: has 4 cells, but the header 3"),
    "both signs": ("t;x;y\n0;1,5;2.5\n", r"numbers should have either decimal points or decimal commas"),
    "commas of ns-2": ("$node_(0) set X_ 1,5\n", r"line 1: '1,5' is not a number; the decimal sign is a point"),
    "underscore": ("0 1_0 2\n", r"line 1: '1_0' is not a number"),
    "degrees": ("t,lat,lon\n0,48.1,11.5\n", r"has positions in degrees; project them to m"),
    "kilometres": ("t,x [km],y [km]\n0,1,2\n", r"column 'x' is in km, and should be in m; .* set scale"),
    "minutes": ("time [min],x,y\n0,1,2\n", r"the times are in min, and should be in s, ms, us, ns, or dates"),
    "a line of units": ("t,x,y\ns,mm,mm\n0,1,2\n", r"column 'x' is in mm, and should be in m; .* set scale"),
    "decimal commas": ("0 1,5 2,5 3 2,5 3,5\n", r"line 1: '1,5' is not a number; the decimal sign is a point"),
    "no time in any unit": ("t,x,y\n171456480025,1,2\n", r"line 2: '171456480025' is too great for a time in s"),
    "no header": ("0,1,2\n1,2,3\n", r"line 1: has no column t; the first line should name the columns, t, x and y"),
    "no y": ("t,x,why\n0,1,2\n", r"line 1: has no column y"),
    "no header in a table": ("0 1 2\n1 2 3\n2 3 4\n", r"line 1: .* the first line should name its columns"),
    "no header in a table of two nodes": ("0 1 2\n0 5 6\n1 1 3\n1 5 7\n", r"the first line should name its columns"),
    "no header in a table with a frame and a node": ("7 1 8 3\n8 1 9 3\n8 2 1 1\n", r"the first line should name its"),
    "no header in a table of six columns": (
        "0 1 2 .5 .1 0\n1 1 3 .5 .1 0\n2 1 4 .5 .1 0\n",
        r"line 2: .*first line should name",
    ),
    "no header but a first line of another length, as of the ONE": (
        "0 9 0 5 0 5 0 0\n0 1 2 9\n0 2 3 9\n1 1 2 8\n",
        r"line 2: .*first line should name its columns",
    ),
    "contacts": (
        "".join(f"{k // 3} 13 {601 + k} {650 + 2 * k} 1 0\n" for k in range(12)),
        r"line 1: .*first line should name its columns.*; if they are waypoints, set dimensions = 2",
    ),
    "several vectors": (
        "t,a.position.x,b.position.x,y\n0,1,2,3\n",
        r"columns a\.position\.x and b\.position\.x: which",
    ),
    "velocities": ("t,vx,vy\n0,1,2\n", r"has no column x"),
    "identifiers of rows": ("id;t;x;y\n1;0;1,5;2\n2;9;2,5;3\n3;4;3,5;4\n", r"column 'id' is different in each row"),
    "two nodes in one": (
        "t,x,y,kind\n0,1,2,5\n0,5,6,7\n",
        r"after 0 s comes 0 s; if the file has several nodes, name them",
    ),
    "FCD without a position": (
        '<fcd-export><timestep time="0">\n<vehicle id="a" x="1"/>',
        r"line 2: <vehicle> has no y",
    ),
    "NMEA": ("$GPGGA,1,1929.0,S,2410.5,E,1\n", r"NMEA has positions in degrees; project them to m"),
    "trips of SUMO": ("<tripinfos>\n</tripinfos>", r"the trips of SUMO have no positions; its option --fcd-output"),
    "FCD that is cut": ('<fcd-export><timestep time="0">', r"is not valid XML"),
    "FCD with a document type": ("<!DOCTYPE a>\n<fcd-export/>", r"should declare no document type"),
    "FCD in degrees that stands still": (
        '<!-- <fcd-output.geo value="true"/> --><fcd-export><timestep time="0"><vehicle id="a" x="11.5" y="48.1"/>'
        "</timestep></fcd-export>",
        r"has positions in degrees: SUMO wrote it with fcd-output\.geo",
    ),
    "FCD in degrees": (
        '<fcd-export><timestep time="0"><vehicle id="a" x="11.5" y="48.1" speed="9"/></timestep>\n'
        '<timestep time="1"><vehicle id="a" x="11.5001" y="48.1" speed="9"/></timestep></fcd-export>',
        r"has positions in degrees \(fcd-output\.geo\): vehicles move by 0\.0001 in all, and their speeds say 9 m",
    ),
    "two columns": ("t,x,X,y\n0,1,2,3\n", r"has several columns 'x'"),
    "cells": ("t,x,y\n0,1\n", r"line 2: has 2 cells, but the header 3"),
    "nodes in a column of another name": (
        "t,boat,x,y\n0,a,0,0\n1,a,1,0\n2,b,5,5\n",
        r"column 'boat' has several texts: if they name the nodes, call it node, else leave it out",
    ),
    "time in two columns": (
        "sec,nanosec,x,y\n0,500000000,1,2\n1,0,2,3\n",
        r"line 1: columns sec and nanosec have the time",
    ),
    "timestamp in two columns": ("timestamp,nsec,x,y\n0,5,1,2\n1,0,2,3\n", r"columns timestamp and nsec have the time"),
    "row numbers": ("id,t,x,y\n0,0,1,2\n1,1,2,3\n2,2,3,4\n", r"column 'id' is different in each row"),
    "order": ("t,x,y\n1,1,2\n0,1,2\n", r"line 3: the times of a node should increase; after 1 s comes 0 s"),
    "no rows": ("t,x,y\n", r"has no rows below its header"),
    "missing": ("t,x,y\n0,,2\n", r"line 2: '' is not a number"),
    "GPX": ('<?xml version="1.0"?>\n<gpx>', r"GPX has positions in degrees"),
    "JSON": ("{}", r"JSON is not read; write it as a table with the columns t, node, x, y"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_record_that_may_mean_something_else_is_refused(tmp_path, name):
    text, why = REFUSED[name]
    with pytest.raises(ValueError, match=rf"motion\.txt.*{why}"):
        read(tmp_path, text.encode())


@pytest.mark.parametrize("encoding", ["UTF-16", "ISO-8859-1", "UTF-8"])
def test_the_encoding_of_a_file_counts_and_not_the_one_it_declares(tmp_path, encoding):
    """A file that is saved anew in UTF-8 may still declare another one."""
    text = f'<?xml version="1.0" encoding="{encoding}"?>\n{fcd([[Waypoint(0.0, 1.0, 2.0, 0)]])}'
    text = text.replace("<?xml version='1.0'?>", "").replace(NAMES[0], "grün")
    content = text.encode("utf-16" if encoding == "UTF-16" else "utf-8")
    assert read(tmp_path, content, "grün").waypoints[0][:3] == (0.0, 1.0, 2.0)


def test_nodes_that_are_seen_once_may_stand_beside_nodes_that_move(tmp_path):
    text = "0 0 0 9 5 5\n0 1 1 9 6 6\n3 7 7\n5 8 8\n7 9 9\n"
    assert [len(read(tmp_path, text.encode(), node).waypoints) for node in range(5)] == [2, 2, 1, 1, 1]


@pytest.mark.parametrize(
    "header",
    [
        *("#Time(s), Device ID, X,Y", "time_from_start,uav-id,pos_x,pos_y", "elapsed,node,x,y", "Elapsed Time,Car,x,y"),
        *("time since start,animal id,x,y", "SimTime,VesselID,x [m],y [m]"),
    ],
)
def test_words_in_the_names_of_columns_may_be_apart(tmp_path, header):
    text = f"{header}\n0, a, 1, 2\n3, a, 4, 5\n0, b, 6, 7\n"
    assert [waypoint[:3] for waypoint in read(tmp_path, text.encode(), node="a").waypoints] == [(0, 1, 2), (3, 4, 5)]


def test_a_covariance_as_text_does_not_name_nodes(tmp_path):
    text = 't,x,y,pose.covariance\n0,1,2,"(0.1, 0)"\n1,3,4,"(0.1, 0)"\n2,5,6,"(0.2, 0)"\n'
    assert len(read(tmp_path, text.encode()).waypoints) == 3


@pytest.mark.parametrize(
    ("row", "dimensions"),
    [("0 {k} 2 9{k} 3 4", None), ("{k} {k} 2 99 3 4", None), ("{k} {k} .5 9{k} 3 4", None), ("{k} {k} 2 9{k} 3 4", 2)],
    ids=["begin together", "end together", "no integers", "said"],
)
def test_nodes_with_as_many_waypoints_are_no_contacts(tmp_path, row, dimensions):
    text = "\n".join(row.format(k=k) for k in range(10))
    assert len(read(tmp_path, text.encode(), 9, dimensions=dimensions).waypoints) == 2


def test_dimensions_are_of_bonnmotion_and_agree_with_its_mark(tmp_path):
    with pytest.raises(ValueError, match=r"line 1: #3D says that dimensions should be 3"):
        read(tmp_path, b"#3D\n0 1 2 3\n", dimensions=2)
    with pytest.raises(ValueError, match="dimensions are of a file of BonnMotion, which this is not"):
        read(tmp_path, b"t,x,y\n0,1,2\n", dimensions=3)


def test_an_unknown_node_is_refused_with_those_that_there_are(tmp_path):
    with pytest.raises(ValueError, match=r"has no node uav4, did you mean 'uav3'\?: it has nodes uav3, base"):
        read(tmp_path, b"t,node,x,y\n0,uav3,1,2\n0,base,1,2\n", "uav4")
    with pytest.raises(ValueError, match="has no node 2: it has nodes 3, 7"):
        read(tmp_path, b"t,node,x,y\n0,7,1,2\n0,3,1,2\n", 2)


def test_the_index_of_a_name_that_looks_like_a_number_is_refused(tmp_path):
    """Node 1 would be the second, which is named 02."""
    file = tmp_path / "walk.csv"
    file.write_text("t,node,x,y\n0,01,1,2\n0,02,3,4\n")
    with pytest.raises(
        ValueError, match=r"walk\.csv: node 1 is not clear, because names look like numbers: '01', '02'"
    ):
        read_mobility(file).track(1)
    assert read_mobility(file).track("01").waypoints[0][1:3] == (1.0, 2.0)


@pytest.mark.parametrize("values", ["auto auto auto", ".5 .5 .7", "0,5 0,5 0,7", "a b c", " a "])
def test_other_columns_that_name_no_nodes_are_ignored(tmp_path, values):
    """Equal texts, numbers, texts of which none repeats, and empty cells."""
    cells = (*values.split(" "), "", "")
    file = tmp_path / "walk.csv"
    file.write_text("t;x;y;other\n" + "".join(f"{k};{k};0;{cells[k]}\n" for k in range(3)))
    assert read_mobility(file).track(0).waypoints[-1][:3] == (2.0, 2.0, 0.0)


@pytest.mark.parametrize("others", ["xS,yS", "xM,yM", "xH,yH", "tS,camM", "xMax,yMax", "x_goal,y_goal", "timeMs,temp"])
def test_columns_with_a_further_letter_or_word_are_others(tmp_path, others):
    (tmp_path / "a.csv").write_text(f"t,x,y,{others}\n0,1,2,7,8\n1,2,3,7,8\n")
    waypoints = read_mobility(tmp_path / "a.csv").track(0).waypoints
    assert [point[:3] for point in waypoints] == [(0.0, 1.0, 2.0), (1.0, 2.0, 3.0)]


def test_a_column_called_node_names_the_nodes_whatever_others_there_are(tmp_path):
    """A pursuer with two devices, each of which reports where it is."""
    file = tmp_path / "walk.csv"
    file.write_text("t,node,x,y,device\n0,a,1,2,gps\n1,a,2,3,uwb\n0,b,5,5,gps\n1,b,6,6,gps\n")
    mobility = read_mobility(file)
    assert [mobility.track(node).waypoints[-1][:3] for node in range(2)] == [(1.0, 2.0, 3.0), (1.0, 6.0, 6.0)]


@pytest.mark.parametrize("names", ["id,vehicle", "vehicle,agent", "uav,name"])
def test_two_columns_that_name_the_nodes_differently_are_refused(tmp_path, names):
    first, second = names.split(",")
    file = tmp_path / "walk.csv"
    file.write_text(f"{first},t,x,y,{second}\n0,0,1,2,a\n1,1,2,3,a\n2,0,5,5,b\n3,1,6,6,b\n")
    with pytest.raises(ValueError, match=f"the columns {first} and {second} may name the nodes, and differ"):
        RecordedMotion(file=str(file))
    file.write_text(f"{first},t,x,y,{second}\n0,0,1,2,a\n0,1,2,3,a\n1,0,5,5,b\n1,1,6,6,b\n")
    assert len(RecordedMotion(file=str(file)).waypoints) == 2
    file.write_text(f"{first},t,x,y\n0,0,1,2\n1,1,2,3\n")
    with pytest.raises(ValueError, match="is different in each row"):
        RecordedMotion(file=str(file))


def test_a_column_of_equal_cells_names_no_nodes_beside_one_that_does(tmp_path):
    file = tmp_path / "walk.csv"
    file.write_text("node,t,x,y,device\n0,0,1,2,gps\n0,1,2,3,gps\n1,0,5,5,gps\n1,1,6,6,gps\n")
    assert len(RecordedMotion(file=str(file)).waypoints) == 2


@pytest.mark.parametrize("name", ["VehicleID", "drone", "track_id", "robot_id", "AgentId", "uav_id"])
def test_a_column_of_numbers_of_robots_is_not_one_track(tmp_path, name):
    """Without its name the file would be one node that jumps from the end of a track to the beginning of the next."""
    file = tmp_path / "walk.csv"
    file.write_text(f"{name},t,x,y\n1,0,0,0\n1,1,1,0\n2,2,50,0\n2,3,51,0\n")
    assert len(RecordedMotion(file=str(file), node=2).waypoints) == 2
    with pytest.raises(ValueError, match="node"):
        RecordedMotion(file=str(file))


def test_a_whole_time_beside_its_parts_is_read(tmp_path):
    file = tmp_path / "walk.csv"
    file.write_text("t,sec,nanosec,x,y\n0.5,0,500000000,1,2\n1.25,1,250000000,2,3\n")
    assert [waypoint[0] for waypoint in RecordedMotion(file=str(file)).waypoints] == [0.5, 1.25]


def test_a_date_may_be_written_as_loggers_of_radios_write_it(tmp_path):
    text = b"t,x,y\n2019.11.25_15.34.34,1,2\n2019/11/25 15:34:36.5,3,4\n"
    assert [each[:3] for each in read(tmp_path, text).waypoints] == [(0.0, 1.0, 2.0), (2.5, 3.0, 4.0)]


def test_poses_without_a_header_are_times_positions_and_quaternions(tmp_path):
    """As the TUM RGB-D benchmark has them; with another quaternion they are no poses."""
    text = b"# made by hand\n5.5 1 2 3 0 0 0.6 0.8\n6.5 4 5 6 0 0 0 1\n"
    track = read(tmp_path, text)
    assert ([each[:3] for each in track.waypoints], track.has_heights) == ([(5.5, 1.0, 2.0), (6.5, 4.0, 5.0)], True)
    named = b"# timestamp tx ty tz qx qy qz qw\n" + text
    assert read(tmp_path, named) == track._replace(
        waypoints=[each._replace(line=each.line + 1) for each in track.waypoints]
    )
    for other in (text.replace(b"0.8", b"0.9"), text.replace(b"6.5", b"5.5")):
        with pytest.raises(ValueError, match=r"should be t1 x1 y1 .*there are 8"):
            read(tmp_path, other)


def test_nodes_of_bonnmotion_with_as_many_waypoints_are_no_table(tmp_path):
    """Nodes that stand still from time 0 on, and vehicles that enter a road one after the other."""
    assert len(read(tmp_path, b"0 1 2\n0 3 4\n0 5 6\n", 2).waypoints) == 1
    assert len(read(tmp_path, b"0 0 0 9 90 0\n1 0 0 10 90 0\n2 0 0 11 90 0\n", 2).waypoints) == 2


def test_statements_of_ns2_about_a_class_are_ignored(tmp_path):
    text = f"Antenna/OmniAntenna set X_ 0\nAntenna/OmniAntenna set Z_ 1.5\n{START}"
    assert [each[:3] for each in read(tmp_path, text.encode()).waypoints] == [(0.0, 1.0, 2.0)]


@pytest.mark.parametrize(
    ("text", "nodes"),
    [
        ("mac,x,y,z\n14-15,4.25,27.5,2\n14-16,5,27,0\n", ["14-15", "14-16"]),
        ("x;y\n4,25;27,5\n5,0;27\n", [0, 1]),
        ("name,y,x\nb,27.5,4.25\na,27,5\n", ["b", "a"]),
        ("# id x y\n3 5 27\n2 4.25 27.5\n", [2, 3]),
    ],
)
@pytest.mark.filterwarnings("ignore:.*the heights in the file are dropped")
def test_places_without_times_are_those_of_nodes_that_begin_there(tmp_path, text, nodes):
    (tmp_path / "places.csv").write_text(text)
    made = read_mobility(tmp_path / "places.csv", needs_times=False)
    assert list(made.nodes) == nodes
    assert [made.track(node).waypoints[0][:3] for node in nodes] == [(0.0, 4.25, 27.5), (0.0, 5.0, 27.0)]
    team = Team.model_validate({"positions": {"kind": "recorded", "file": str(tmp_path / "places.csv")}})
    assert team.positions == ((4.25, 27.5), (5.0, 27.0))
    with pytest.raises(ValueError, match="has no column t"):
        RecordedMotion(file=str(tmp_path / "places.csv"), node=nodes[0])


@pytest.mark.slow
def test_a_table_may_be_a_parquet_file(tmp_path):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    times = pandas.to_datetime(["2024-05-01T12:00:00.0Z", "2024-05-01T12:00:02.5Z"])
    pandas.DataFrame({"time": times, "track_id": [4, 4], "x": [1.0, 2.0], "y": [3.0, 4.0]}).to_parquet(
        tmp_path / "a.parquet"
    )
    waypoints = read_mobility(tmp_path / "a.parquet").track(4).waypoints
    assert [each[:3] for each in waypoints] == [(0.0, 1.0, 3.0), (2.5, 2.0, 4.0)]


NOUNS = "vehicle agent robot uav drone track trajectory traj pedestrian ped person object obj user tag target node"
WORDS = {
    "t": "t time timestamp sec seconds date datetime",
    "x": "x pos_x posx position_x east easting tx",
    "y": "y pos_y posy position_y north northing ty",
    "z": "z pos_z posz position_z height altitude alt tz",
    "node": "node name id mac vehicle agent robot uav drone track pedestrian person"
    + "".join(f" {noun}_id {noun}id" for noun in NOUNS.split()),
}
ENDINGS = {
    "t": "t time timestamp stamp",
    "x": "x px east easting",
    "y": "y py north northing",
    "z": "z pz height altitude",
}
OF_POSITIONS = "p pos pose position positions translation location point coord coordinate"
OF_OTHERS = (
    "v vel velocity speed twist linear angular acc acceleration orientation q quat quaternion rotation rot gyro cov"
    " covariance std error goal target"
)


def test_a_column_is_known_by_its_name_or_by_its_last_word():
    for key, words in WORDS.items():
        for word in words.split():
            assert header_of(["other", word.upper()]).columns(key) == [1], word
    for key, words in ENDINGS.items():
        for word in words.split():
            assert header_of(["other", f"some.{word}"]).columns(key) == [1], word
    for word in OF_POSITIONS.split():
        assert header_of(["some.x", f"{word}.x"]).columns("x") == [1], word
    for word in OF_OTHERS.split():
        assert header_of([f"{word}.x"]).columns("x") == [], word
    assert header_of(["UTM_northPos12.x3"]).words == [["utm", "north", "pos", "12", "x", "3"]]

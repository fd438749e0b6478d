"""Files of numbers that people bring: every reader reads them rightly, or refuses them with the file and the line."""

import ast
import importlib
import pkgutil
import sys
from pathlib import Path

import pytest

import desim
from desim import (
    Edges,
    Empirical,
    LatencyMatrix,
    LatencyTrace,
    LossTrace,
    Netem,
    RecordedFlow,
    RecordedMotion,
    SignalTrace,
)
from desim.config.model import Value
from desim.config.number_files import text_of_file
from desim.kernel.graph_files.graph_file import read_graph
from desim.kernel.measured.latency_file import latencies_of
from desim.kernel.walls.wall import Wall
from desim.pursuit.evaders.recorded import RecordedPositions
from desim.pursuit.mobility.mobility_file import read_mobility


def measured(trace):
    return trace.measurements.times.tolist(), trace.measurements.values.tolist(), trace.measurements.src.tolist()


TRACE = "t,src,dst,value\n0,0,1,{}\n1,0,1,0.25\n"
READERS = {
    "empirical": (Empirical, "{}\n0.25\n", lambda model: model.values),
    "empirical, a line": (Empirical, "{} 0.25\n", lambda model: model.values),
    "latency trace": (LatencyTrace, TRACE, measured),
    "loss trace": (LossTrace, TRACE, measured),
    "signal trace": (SignalTrace, TRACE, measured),
    "time of a trace": (LatencyTrace, "t,value\n{},1\n5,2\n", measured),
    "flow": (RecordedFlow, "t,x,y\n0,{},1\n1,2,3\n", lambda model: model.velocities),
    "time of a flow": (RecordedFlow, "t,x,y\n{},1,1\n1,2,3\n", lambda model: model.velocities),
    "matrix": (LatencyMatrix, "0,{}\n0.25,0\n", lambda model: model.values),
    "matrix with spaces": (LatencyMatrix, "0 {}\n0.25 0\n", lambda model: model.values),
    "BonnMotion": (RecordedMotion, "0 {} 1 5 2 3\n", lambda model: model.waypoints),
    "ns-2": (RecordedMotion, "$node_(0) set X_ {}\n$node_(0) set Y_ 1\n", lambda model: model.waypoints),
    "table of netem": (Netem, "{}\n" + "1 2 3 4 5 6 7\n" * 585, lambda model: model.table),
}
"""The model, a file with a place for a number, and what is read, of each reader of files of numbers."""
NUMBER = {"table of netem": "7"}
OTHERS = {
    Edges: "graphs, in other formats",
    RecordedPositions: "reads as RecordedMotion does",
    Wall: "shapes, in other formats",
}
"""Models that read other files, and why they are not here."""
MODULES = {
    "desim/config/data_files.py": "opens bytes for models of users, and hashes files",
    "desim/config/exports.py": "reads the source of packages of desim",
    "desim/config/number_files.py": "reads text for all readers",
    "desim/config/own_modules.py": "reads the lists of files of installed packages",
    "desim/config/whole_files.py": "writes",
    "desim/kernel/measured/csv_tables.py": "reads Parquet files, which have numbers, and CSV text",
    "desim/kernel/graph_files/edge_lists.py": "splits text that config/number_files has read",
    "desim/kernel/core/trace_file.py": "writes",
}
"""The modules that open files or split CSV text by themselves, below those of commands and results."""


def read(name, text, folder, encoding="utf-8"):
    """Return what a reader reads in a text."""
    model, _, reading = READERS[name]
    (folder / "numbers.txt").write_bytes(text.encode(encoding))
    options = {"delay": 0.1, "jitter": 0.1} if model is Netem else {}
    return reading(model.model_validate({"file": "numbers.txt"} | options, context={"folder": folder}))


def plain(name, number=None):
    """Return a file with a number that is valid for a reader."""
    return READERS[name][1].format(NUMBER.get(name, "0.5") if number is None else number)


def test_every_model_that_reads_a_file_is_here():
    for module in pkgutil.walk_packages(desim.__path__, "desim."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    models, pending = set(), [Value]
    while pending:
        model = pending.pop()
        pending += model.__subclasses__()
        kinds = [kind for kind in model.__subclasses__() if kind.__module__.startswith("desim.")]  # tests derive, too
        is_defined = (
            getattr(sys.modules.get(model.__module__), model.__name__, None) is model
        )  # others were made by a test
        if "file" in model.model_fields and model.__module__.startswith("desim.") and is_defined and not kinds:
            models.add(model)
    assert models == {model for model, _, _ in READERS.values()} | OTHERS.keys()


@pytest.mark.slow
def test_no_other_module_opens_files():
    """A reader added later uses `config/number_files` or `kernel/csv_tables`, and is in `READERS` above."""
    root, openers = Path(desim.__file__).parent.parent, set()
    names = {"open", "read_text", "read_bytes", "loadtxt", "genfromtxt", "fromfile", "reader", "DictReader"}
    for package in ("desim/config", "desim/kernel", "desim/pursuit", "protocols"):
        files = list((root / package).rglob("*.py"))
        assert len(files) > 10
        for file in files:
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                called = getattr(node, "func", None)
                if getattr(called, "attr", getattr(called, "id", None)) in names:
                    openers.add(file.relative_to(root).as_posix())
    assert openers == MODULES.keys()


WRONG = [
    "0,5",
    "1_0",
    "0x10",
    "1 0.5 ms",
    "12ms",
    "12 ms",
    "1,234.5",
    "1.234,5",
    "1'000",
    "\u0661",
    "1\u00a0000",
    "x",
    "--1",
    "1e",
]


@pytest.mark.parametrize("cell", WRONG)
@pytest.mark.parametrize("name", READERS)
def test_what_is_no_number_is_refused_with_file_and_line(name, cell, tmp_path):
    with pytest.raises(ValueError, match=r"numbers\.txt, line 1?\d"):
        read(name, plain(name, cell), tmp_path)


@pytest.mark.parametrize("number", ["+0.5", ".5", "5e-1", "0.50", "00.5", "5.E-1"])
@pytest.mark.parametrize("name", sorted(READERS.keys() - NUMBER.keys()))
def test_a_number_may_have_any_usual_form(name, number, tmp_path):
    assert read(name, plain(name, number), tmp_path) == read(name, plain(name), tmp_path)


FORMS = {
    "BOM": lambda text: "\ufeff" + text,
    "CRLF": lambda text: text.replace("\n", "\r\n"),
    "CR": lambda text: text.replace("\n", "\r"),
    "no end of line": lambda text: text.rstrip("\n"),
    "comments": lambda text: f"# 1,2 3;4\n{text}# 5\n",
    "empty lines": lambda text: f"\n{text}\n\n",
    "white space at ends": lambda text: text.replace("\n", "  \n"),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", READERS)
def test_the_form_of_a_text_does_not_matter(name, form, tmp_path):
    assert read(name, FORMS[form](plain(name)), tmp_path) == read(name, plain(name), tmp_path)


COMMENTS = {
    "s": [
        "# latency [ms]",
        "#latency_ms",
        "# all in milliseconds",
        "# unit: µs",
        "# ms",
        "# RTT ms",
        "# by ping\n# (us)",
        "# one-way latencies, ms",
        "# rtt/ms",
        "# units = ms",
        "# values are milliseconds",
        "# round trip time ms",
        "# one-way latency - us",
        "# latency {ns}",
        "# latency=millis",
    ],
    "m": ["# places, cm", "# places [cm]", "# x, y in feet", "# units: px", "# in cm/s", "# in km, or km/h"],
}
UNITS = {"table of netem": "", **dict.fromkeys(("BonnMotion", "ns-2", "flow", "time of a flow"), "sm")}
"""The units of readers that read others than times, in s."""


@pytest.mark.parametrize("name", READERS)
def test_a_comment_that_names_another_unit_is_refused(name, tmp_path):
    for unit in UNITS.get(name, "s"):
        for comment in COMMENTS[unit]:
            with pytest.raises(ValueError, match=rf"numbers.txt, line \d: the comment says .*read in {unit}: convert"):
                read(name, f"{comment}\n{plain(name)}", tmp_path)


FREE = [
    "# [s], [m]",
    "# t in s, x in m; RTT in ms, width in cm",
    "# columns, ms or cm",
    "# sums of links in us",
    "# a_msg",
    "# by bob, us, and others",
    "# one-way latencies, s",
    "# mean: 10 ms",
    "# ms, from a log",
]


@pytest.mark.parametrize("name", READERS)
def test_a_comment_may_name_the_right_unit_and_have_any_words(name, tmp_path):
    for comment in FREE[:3] + FREE[4:]:
        assert read(name, f"{comment}\n{plain(name)}", tmp_path) == read(name, plain(name), tmp_path)
    text = plain(name) + "# the end of what was measured in ms and cm\n"
    assert read(name, text, tmp_path) == read(name, plain(name), tmp_path)


@pytest.mark.parametrize("comment", ["# ms", "#[ms]", "# in ms", "# RTT ms"])
def test_a_comment_beside_the_first_number_counts_too(comment, tmp_path):
    with pytest.raises(ValueError, match=r"line 2: the comment says 'ms'"):
        read("empirical", f"# measured\n100 {comment}\n200\n", tmp_path)


@pytest.mark.parametrize("comment", ["# 100 ms", "# s", "# first", "# not in the lab", "# s, not ms"])
def test_a_comment_beside_a_number_may_say_anything_else(comment, tmp_path):
    assert read("empirical", f"0.1 {comment}\n0.2\n", tmp_path) == read("empirical", "0.1\n0.2\n", tmp_path)


def test_a_comment_may_explain_the_unit_or_the_scale_that_a_key_sets(tmp_path):
    for name, text, made, expected in (
        ("t.csv", "# in ms\nt,value\n0,50\n", lambda file: LatencyTrace(file=file, unit="ms").unit, "ms"),
        ("m.txt", "# in ms\n0 50\n50 0\n", lambda file: LatencyMatrix(file=file, unit="ms").unit, "ms"),
        (
            "f.csv",
            "# t in ms\nt,x,y\n0,1,1\n",
            lambda f: RecordedFlow(file=f, time_unit="ms").velocities,
            ((0.0, 1, 1),),
        ),
        ("b.movements", "# in cm\n0 50 70\n", lambda f: RecordedMotion(file=f, scale=0.5).waypoints, ((0, 25, 35),)),
        ("w.txt", "# in cm\n0 0\n50 70\n", lambda file: Wall(file=file, scale=0.01).shapes[0].corners[1][0], 0.5),
    ):
        (tmp_path / name).write_text(text)
        assert made(str(tmp_path / name)) == expected
    for name, model in (("w.txt", Wall), ("b.movements", RecordedMotion)):
        with pytest.raises(ValueError, match="line 1: the comment says 'cm'"):
            model(file=str(tmp_path / name))
    (tmp_path / "g.csv").write_text("# latency in ms\nsource,target,latency\n0,1,50\n")
    with pytest.raises(ValueError, match="line 1: the comment says 'ms'"):
        Edges(file=str(tmp_path / "g.csv"))


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("name", READERS)
def test_utf_16_is_read_with_a_byte_order_mark_and_refused_without(name, encoding, tmp_path):
    assert read(name, "\ufeff" + plain(name), tmp_path, encoding) == read(name, plain(name), tmp_path)
    with pytest.raises(ValueError, match=r"numbers\.txt cannot be read: it is not text in UTF-8"):
        read(name, plain(name), tmp_path, encoding)


TABLES = {name: READERS[name][1] for name in READERS if READERS[name][1].startswith("t,") or name == "matrix"}


@pytest.mark.parametrize("separator", [";", "\t", " ; "])
@pytest.mark.parametrize("sign", [".", ","])
@pytest.mark.parametrize("name", TABLES)
def test_tables_may_have_other_separators_and_then_decimal_commas(name, sign, separator, tmp_path):
    """As spreadsheets of half of Europe write them."""
    text = plain(name).replace(",", separator).replace(".", sign)
    assert read(name, text, tmp_path) == read(name, plain(name), tmp_path)


@pytest.mark.parametrize("name", sorted(TABLES.keys() - {"time of a trace", "time of a flow"}))
def test_decimal_commas_beside_decimal_points_are_refused(name, tmp_path):
    """Either the points or the commas may separate thousands."""
    text = plain(name, "1.234").replace(",", ";") + "3;0,5;1;2\n"
    with pytest.raises(ValueError, match=r"numbers\.txt, line \d"):
        read(name, text, tmp_path)


@pytest.mark.parametrize("name", sorted(TABLES.keys() - {"matrix"}))
def test_rows_of_other_lengths_and_repeated_headers_are_refused(name, tmp_path):
    header, *_ = plain(name).split("\n")
    for end in ("9", "9,1,2,3,4", header):
        with pytest.raises(ValueError, match=r"numbers\.txt, line 4"):
            read(name, f"{plain(name)}{end}\n", tmp_path)


LISTS = {
    "0.041, 0.2,\n0.3": (0.041, 0.2, 0.3),
    "0.041,0.2": (0.041, 0.2),
    "1,2,3": (1.0, 2.0, 3.0),
    "0,041;0,2;1\n": (0.041, 0.2, 1.0),
    "0,041 ; 0,2 ; 1": (0.041, 0.2, 1.0),
    "0.1;0.2": (0.1, 0.2),
    "0,5;\n0,25;\n": (0.5, 0.25),
}
REFUSED_LISTS = {
    "41,2\n40\n52,7\n": "line 1: '41,2' may be one number or several",
    "0,041": "line 1: '0,041' may be",
    "1\n0,041": "line 2: '0,041' may be",
    "0 0.1\n1 0.2\n2\n": "line 1: has 2 numbers; it should have one",
    "0.1\n0.2 0.3\n": "line 2: has 2 numbers",
    "1.234;0,5": "line 1: numbers should have either decimal points or decimal commas",
    "0.1 ms\n0.2 ms": "line 1: 'ms' is not a number",
    "nan\n0.1": "line 1: a latency should be a time >= 0 s",
}


@pytest.mark.parametrize("text", LISTS)
def test_lists_of_latencies_have_one_line_or_one_column(text, tmp_path):
    assert read("empirical", text.replace("\n0.3", " 0.3"), tmp_path) == LISTS[text]


@pytest.mark.parametrize("text", REFUSED_LISTS)
def test_lists_that_may_mean_something_else_are_refused(text, tmp_path):
    with pytest.raises(ValueError, match=rf"numbers\.txt, {REFUSED_LISTS[text]}"):
        read("empirical", text, tmp_path)


def test_a_flow_may_count_from_any_date(tmp_path):
    for unit, times in {
        "s": ["2024-05-17T12:00:00Z", "2024-05-17T12:00:01.5Z"],
        "ms": ["1715949000000", "1715949001500"],
        "us": ["1715949000000000", "1715949001500000"],
    }.items():
        (tmp_path / "wind.csv").write_text("t,x,y\n" + "".join(f"{time},1,2\n" for time in times))
        flow = RecordedFlow(file=str(tmp_path / "wind.csv"), time_unit=unit)
        assert flow == RecordedFlow(velocities=((0.0, 1.0, 2.0), (1.5, 1.0, 2.0)))
    with pytest.raises(ValueError, match="line 2: t: '1715949000000000' is too great for a time in s"):
        RecordedFlow(file=str(tmp_path / "wind.csv"))
    (tmp_path / "wind.csv").write_text("t,x,y\n5,1,2\n-1,1,2\n")
    with pytest.raises(ValueError, match=r"line 3: t should be from 0 to 1e\+09 s"):
        RecordedFlow(file=str(tmp_path / "wind.csv"))


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (
            b"P5\n540 587\n255\n\xff\xfe",
            "a picture of pixels: draw or trace its lines in an editor, and save them as SVG",
        ),
        (b"PK\x03\x04\x14\x00\xff", "a zip archive or a spreadsheet: unpack it, or save its table as CSV"),
        (b"\x93NUMPY\x01\x00v\x00", r"an array of numpy: numpy\.savetxt writes it as text"),
        (b"SQLite format 3\x00", "a database of SQLite: export a table as CSV"),
        (b"ULog\x01\x12\x35\x00\xff", "a log of PX4: ulog2csv exports its tables as CSV"),
        (b"#ROSBAG V2.0\n\x45\x00\x00", "a bag of ROS: rostopic echo -b FILE -p TOPIC exports"),
        (b"\x80PK\x03\x04", r"not text in UTF-8 \(invalid start byte at byte 0\)"),
    ],
)
def test_a_file_that_is_no_text_is_refused_with_what_makes_text_of_it(tmp_path, content, why):
    file = tmp_path / "table.csv"
    file.write_bytes(content)
    for read in (text_of_file, read_mobility, read_graph, latencies_of):
        with pytest.raises(ValueError, match=rf"table\.csv cannot be read: it is {why}"):
            read(file)

"""A trace as a file: how events are written, and that they are read again as they were."""

import json
import os
import subprocess
import sys
import tracemalloc
from math import inf, nan
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from desim import Scenario, Team, run
from desim.kernel.core.events import LOST, Broadcast, Lost, MessageCounts, Queued, Sent, Trace
from desim.kernel.core.records import Record
from desim.kernel.core.trace_file import BLOCK, LONG, TraceFile, _open_alone, events_of, line_of
from desim.kernel.core.units import SECOND
from desim.kernel.models.faults import Crash
from desim.kernel.models.traced_faults import FaultStarted
from desim.pursuit.core.events import Decided, Ended, Started

pytestmark = pytest.mark.own_trace


def test_times_are_written_in_seconds_and_never_is_null():
    left = Broadcast(1_500_000_000, 7, 0, 1, (1, 2), (2_000_000_000, LOST), 1_000_000_000, 24, [True])
    assert json.loads(line_of(left)) == {
        "event": "Broadcast",
        "t": 1.5,
        "transmission": 7,
        "src": 0,
        "seq": 1,
        "dst": [1, 2],
        "arrival": [2.0, None],
        "created": 1.0,
        "size": 24,
        "body": [True],
    }
    tally = MessageCounts(2_000_000_000, 2, 1, 1, 0, {"loss": 1}, 1, 24, 0.25)
    assert json.loads(line_of(tally)) == {
        "event": "MessageCounts",
        "t": 2.0,
        "sent": 2,
        "delivered": 1,
        "lost": 1,
        "in_flight": 0,
        "lost_by": {"loss": 1},
        "transmissions": 1,
        "bytes_sent": 24,
        "utilisation": 0.25,
    }


class Payload(NamedTuple):
    active: bool
    place: tuple[float, ...]


class ForwardedPayloads(NamedTuple):
    records: tuple[Record, ...]


ROOT = Path(__file__).parents[2]
KINDS = (Queued, Broadcast, Sent, Lost, MessageCounts)
TIMES = st.integers(0, 2**51) | st.integers(0, 200_000)
"""Up to 26 days: half a nanosecond is more than what a float of seconds is off; below 100 us there is an exponent."""
NODES = st.integers(0, 50)
NUMBERS = st.floats(-1e30, 1e30)
PAYLOADS = st.builds(Payload, st.booleans(), st.lists(NUMBERS, max_size=3).map(tuple))
RECORDS = st.builds(Record, NODES, NODES, TIMES, PAYLOADS)
BODIES = st.one_of(
    st.none(),
    st.text(),
    NUMBERS,
    PAYLOADS,
    st.builds(ForwardedPayloads, st.lists(RECORDS, max_size=3).map(tuple)),
    st.tuples(PAYLOADS),
)
ARRIVALS = st.lists(st.just(LOST) | TIMES, max_size=4).map(tuple) | st.lists(TIMES, max_size=4).map(tuple)
EVENTS = st.one_of(
    st.builds(Queued, TIMES, NODES, NODES, st.lists(NODES).map(tuple), NODES),
    st.builds(Broadcast, TIMES, NODES, NODES, NODES, st.lists(NODES).map(tuple), ARRIVALS, TIMES, NODES, BODIES),
    st.builds(Sent, TIMES, NODES, NODES, NODES, st.just(LOST) | TIMES, TIMES, NODES, BODIES),
    st.builds(Lost, TIMES, NODES, NODES, NODES, st.sampled_from(["loss", "out_of_range"])),
    st.builds(MessageCounts, TIMES, *[NODES] * 4, st.just({"loss": 3}), NODES, NODES, NUMBERS),
)


@pytest.mark.slow
@given(st.lists(EVENTS))
def test_a_trace_that_was_written_is_read_again(events):
    lines = list(map(line_of, events))
    again = list(events_of(lines, KINDS))
    assert again == events
    assert [type(event) for event in again] == [type(event) for event in events]
    assert list(map(line_of, again)) == lines


class Unknown:
    """A value that JSON cannot represent."""

    def __init__(self):
        self.path = {3, 1}


class WithPlain(NamedTuple):
    content: object
    payload: Payload

    def plain(self):
        return {"says": repr(self.content)}


KEYS = st.text(max_size=3) | st.integers() | st.floats() | st.sampled_from([True, None, (1, "b"), b"x", np.int64(3)])
NASTY = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text()
    | st.sampled_from(
        [nan, inf, -inf, 1e300, -0.0, np.float64(0.1), np.float64(nan), np.int64(3), np.bool_(True), np.arange(2)]
    )
    | st.sampled_from([Unknown(), {1}, b"x", 1j, Crash(node=1, start=2.0), (), [], {}]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(KEYS, inner, max_size=3)
        | st.builds(ForwardedPayloads, st.lists(inner, max_size=3).map(tuple))
        | st.builds(Record, NODES, NODES, TIMES, inner)
        | st.builds(WithPlain, inner, PAYLOADS)
    ),
    max_leaves=8,
)
WRITTEN = st.one_of(
    EVENTS,
    st.builds(Sent, TIMES, NODES, NODES, NODES, st.just(LOST) | TIMES, TIMES, NODES, NASTY),
    st.builds(FaultStarted, TIMES, st.just(Crash(node=1, start=2.0))),
    st.builds(Started, TIMES, st.tuples(st.floats(), st.floats()), st.just(()), st.just((1.0,)), st.just((True, 2))),
    st.builds(Started, TIMES, st.just((0.0, 1.0)), st.just(()), st.just(()), st.just(()), st.just(((nan, 2.0),))),
    st.builds(Decided, TIMES, NODES, st.booleans() | NODES),
    st.builds(Ended, TIMES, st.just("captured"), st.none() | NODES),
)


TABLED = {
    Unknown: lambda _: {"class_name": "Unknown", "path": [1, 3]},
    set: sorted,
    bytes: bytes.hex,
    complex: lambda number: [number.real, number.imag],
    np.generic | np.ndarray: lambda value: value.tolist(),
}
"""The content of other values, by type."""


def straightforward(event):
    """Return an event as a line of JSON, from tables of tables."""

    def tabled(value):
        if hasattr(value, "_asdict"):
            return {name: tabled(each) for name, each in value._asdict().items()}
        if isinstance(value, dict):
            keys = [each if isinstance(each, str) else json.dumps(tabled(each)) for each in value]
            if len(set(keys)) < len(keys):
                return [[tabled(key), tabled(each)] for key, each in value.items()]
            return {key: tabled(each) for key, each in zip(keys, value.values(), strict=True)}
        if isinstance(value, tuple | list):
            return [tabled(each) for each in value]
        if isinstance(value, Crash):
            return {name: tabled(getattr(value, name)) for name in Crash.model_fields}
        for kind, table in TABLED.items():
            if isinstance(value, kind):
                return table(value)
        return value

    def in_seconds(time):
        if isinstance(time, tuple):
            return [in_seconds(each) for each in time]
        return None if time == LOST else time / 1e9

    def plain(name, value):
        if name in {"t", "arrival", "created"}:
            return in_seconds(value)
        if hasattr(value, "plain") and not (name == "body" and isinstance(value, Crash)):
            return value.plain()
        return tabled(value) if name == "body" else value

    fields = {name: plain(name, value) for name, value in event._asdict().items()}
    return json.dumps({"event": type(event).__name__} | fields) + "\n"


@pytest.mark.slow
@given(st.lists(WRITTEN, max_size=4))
def test_a_line_equals_the_fields_of_its_event(events):
    assert list(map(line_of, events)) == list(map(straightforward, events))


def beating(count, begin=0):
    """Yield so many messages, no two alike, from a time on."""
    return (Sent(k, k, 0, 1, k + 5, k, 24, Payload(True, (k / 7,))) for k in range(begin, begin + count))


def test_a_file_has_the_lines_of_a_trace_and_the_events_come_back_one_by_one(tmp_path):
    path, trace = tmp_path / "trace.jsonl", Trace()
    with TraceFile(path) as file:
        watched = Trace([file], messages=False)
        for event in beating(3):
            trace.append_message(event)
            watched.append_message(event)
    lines = list(map(line_of, trace))
    assert path.read_bytes() == "".join(lines).encode()
    assert list(watched) == []
    found = events_of(iter([*lines, "broken"]), KINDS)
    assert [next(found) for _ in range(3)] == trace.events
    with pytest.raises(ValueError, match="line 4 is not an event"):
        next(found)


EDGES = [0, 1, 999, 1_000, 9_999, 10_000, 12_345, 99_999, 100_000, 100_001, SECOND - 1, SECOND, 10**13 + 1, 2**51]
"""Times, ns, around those at which the text of a float changes its form."""


@pytest.mark.parametrize("times", [*((each,) for each in EDGES), (SECOND, LOST), tuple(EDGES), (*EDGES, LOST)])
def test_arrival_times_are_written_like_floats(times):
    dst, seconds = tuple(range(len(times))), [None if each == LOST else each / SECOND for each in times]
    line = line_of(Broadcast(0, 0, 0, 1, dst, times, 0, 24, None))
    assert f', "dst": {json.dumps(dst)}, "arrival": {json.dumps(seconds)}, "created"' in line


def broadcast(receivers):
    """Return a broadcast to so many receivers, which it reaches at once."""
    return Broadcast(0, 0, 0, 1, tuple(range(1, receivers + 1)), (5,), 0, 24, None)


def written(path, events):
    """Write events to a file and return the bytes of the file."""
    with TraceFile(path) as file:
        for event in events:
            file(event)
    return path.read_bytes()


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, 2 * BLOCK + 3])
@pytest.mark.parametrize("receivers", [2, LONG, LONG + 1])
def test_a_file_has_all_events_in_order_whatever_is_written_together(tmp_path, count, receivers):
    last = [event._replace(t=event.t + count) for event in beating(2)]
    events = [*beating(count), broadcast(receivers)._replace(t=count), *last]
    assert written(tmp_path / "trace.jsonl", events) == "".join(map(line_of, events)).encode()


def test_a_trace_file_is_of_one_run_and_is_written_in_its_block(tmp_path):
    scenario = Scenario(team=Team(count=2), horizon=0.1)
    with pytest.raises(ValueError, match=r"a TraceFile is written in a with block: with TraceFile\(.*\) as file: run"):
        run(scenario, 1, TraceFile(tmp_path / "trace.jsonl"))
    file = TraceFile(tmp_path / "trace.jsonl")
    with pytest.raises(ValueError, match=r"an event at 0 s comes after one at 0\.1 s: a TraceFile is of one run"), file:
        _ = [run(scenario, seed, file) for seed in (1, 2)]
    assert not (tmp_path / "trace.jsonl").exists()
    with file:
        run(scenario, 1, file)
    assert (tmp_path / "trace.jsonl").exists()
    with pytest.raises(ValueError, match="a TraceFile is written in a with block"):
        run(scenario, 1, file)


def test_a_file_is_written_by_one_trace_file_at_a_time(tmp_path, monkeypatch):
    path, same = tmp_path / "trace.jsonl", tmp_path / ".." / tmp_path.name / "trace.jsonl"
    monkeypatch.chdir(tmp_path)
    with TraceFile(path) as file:
        for other in (file, TraceFile(path), TraceFile(same), TraceFile("trace.jsonl")):
            with (
                pytest.raises(ValueError, match=r"trace\.jsonl is written already by a TraceFile: each run needs"),
                other,
            ):
                pass
        for event in beating(2):
            file(event)
        with TraceFile(tmp_path / "other.jsonl"):
            pass
    assert path.read_text() == "".join(map(line_of, beating(2)))
    with pytest.raises(ArithmeticError), file:  # again, once it is written
        raise ArithmeticError
    with file:  # also after an error
        pass
    assert path.read_text() == ""


OTHER = """
import sys
from desim import TraceFile
from tests.kernel.test_trace_file import beating
with TraceFile(sys.argv[1]) as file:
    for event in beating(2):
        file(event)
"""


@pytest.mark.whole
def test_a_file_is_written_by_one_process_at_a_time(tmp_path):
    pytest.importorskip("fcntl")
    path = tmp_path / "trace.jsonl"

    def other():
        return subprocess.run([sys.executable, "-c", OTHER, str(path)], capture_output=True, text=True, check=False)

    with TraceFile(path) as file:
        file(next(beating(2)))
        done = other()
        assert "trace.jsonl" in done.stderr
        assert "is written by another process: each run needs a file of its own" in done.stderr
    assert path.read_text() == line_of(next(beating(2)))
    with pytest.raises(ArithmeticError), TraceFile(path) as file:
        raise ArithmeticError
    assert not other().stderr
    assert path.read_text() == "".join(map(line_of, beating(2)))


def test_a_trace_file_of_a_forked_process_is_not_locked_by_its_child(tmp_path):
    """Workers that are forked while a trace is written inherit its file."""
    if not hasattr(os, "fork"):
        pytest.skip("no process is forked here")
    reading, writing = os.pipe()
    file = TraceFile(tmp_path / "trace.jsonl").__enter__()
    if not (child := os.fork()):
        os.read(reading, 1)
        os._exit(0)
    file.__exit__(ArithmeticError)  # the .part file remains
    with TraceFile(tmp_path / "trace.jsonl"):
        pass
    os.write(writing, b"x")
    os.waitpid(child, 0)


KILLED = """
import os, sys
from desim import TraceFile
from tests.kernel.test_trace_file import beating
with TraceFile(sys.argv[1]) as file:
    for event in beating(2000):
        file(event)
    os._exit(3)
"""


@pytest.mark.whole
def test_a_program_that_is_killed_leaves_the_first_lines(tmp_path):
    """A line takes about 150 B; at most the last block and a buffer of 8 kB are missing."""
    path = tmp_path / "trace.jsonl"
    assert subprocess.run([sys.executable, "-c", KILLED, path], check=False, cwd=ROOT).returncode == 3
    lines = list(map(line_of, beating(2000)))
    left = (tmp_path / "trace.jsonl.part").read_text()
    assert "".join(lines).startswith(left)
    assert left.count("\n") > 2000 - BLOCK - 100


def test_a_part_that_is_a_symbolic_link_is_not_followed(tmp_path, monkeypatch):
    """Also if it has become one after the question: the second time, it is asked as if there were none."""
    secret, path = tmp_path / "secret", tmp_path / "trace.jsonl"
    secret.write_text("kept")
    (tmp_path / "trace.jsonl.part").symlink_to(secret)
    with pytest.raises(OSError, match=r"trace\.jsonl\.part is a symbolic link, which is not followed: remove it"):
        written(path, beating(3))
    monkeypatch.setattr(Path, "is_symlink", lambda _: False)
    with pytest.raises(OSError, match="symbolic links"):
        written(path, beating(3))
    assert secret.read_text() == "kept"


def test_a_folder_is_refused_before_the_run(tmp_path):
    with pytest.raises(IsADirectoryError, match="is a folder, not a file"), TraceFile(tmp_path):
        raise AssertionError("the run should not begin")


def test_a_broadcast_to_many_is_not_kept_in_memory(tmp_path):
    with TraceFile(tmp_path / "trace.jsonl") as file:
        file(broadcast(LONG))
        assert (tmp_path / "trace.jsonl.part").stat().st_size == 0
        file(broadcast(20 * LONG))
        assert (tmp_path / "trace.jsonl.part").stat().st_size > 20 * LONG


class Indescribable:
    """A value whose content cannot be recorded."""

    def plain(self):
        raise ZeroDivisionError


def test_the_events_before_one_that_cannot_be_written_are_in_the_file(tmp_path):
    events = [*beating(3), Sent(9, 9, 0, 1, 9, 9, 24, Indescribable())]
    with pytest.raises(ZeroDivisionError):
        written(tmp_path / "trace.jsonl", events)
    assert (tmp_path / "trace.jsonl.part").read_text() == "".join(map(line_of, events[:3]))


def interrupted(path):
    with TraceFile(path) as file:
        file(next(beating(1)))
        assert path.read_text() == "of an earlier run"
        raise KeyboardInterrupt


def test_a_file_bears_its_name_only_when_it_is_complete(tmp_path):
    path = tmp_path / "trace.jsonl"
    path.write_text("of an earlier run")
    with pytest.raises(KeyboardInterrupt):
        interrupted(path)
    assert path.read_text() == "of an earlier run"
    assert (tmp_path / "trace.jsonl.part").read_text().count("\n") == 1
    with TraceFile(str(path)):
        pass
    assert [each.name for each in tmp_path.iterdir()] == ["trace.jsonl"]
    assert path.read_text() == ""


def test_a_file_whose_last_lines_cannot_be_written_does_not_bear_its_name(tmp_path):
    """A disk that is full is seen only when the lines leave the buffer."""
    resource = pytest.importorskip("resource")
    path, before = tmp_path / "trace.jsonl", resource.getrlimit(resource.RLIMIT_FSIZE)
    path.write_text("of an earlier run")
    file = TraceFile(path).__enter__()
    for event in beating(2):
        file(event)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            file.__exit__(None)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_text() == "of an earlier run"


@pytest.mark.slow
def test_a_file_keeps_nothing_in_memory(tmp_path):
    """Eight times as many messages take no more of it, where a trace takes eight times as much."""

    def peak(watch, count, begin=0):
        tracemalloc.start()
        for event in beating(count, begin):
            watch(event)
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    with TraceFile(tmp_path / "trace.jsonl") as file:
        peak(file, 2 * BLOCK)  # a block, the buffer, and how such events are written
        few, many = peak(file, 2 * BLOCK, 2 * BLOCK), peak(file, 16 * BLOCK, 4 * BLOCK)
        assert many < 1.1 * few + 10_000
    few, many = (peak(Trace().append, count) for count in (300, 2400))
    assert many > 6 * few


def test_the_fields_of_a_body_keep_their_names_at_every_depth():
    sent = Sent(0, 0, 0, 1, 5, 0, 24, ForwardedPayloads((Record(3, 1, 7, Payload(True, (1.0, 2.0))),)))
    (record,) = next(events_of([line_of(sent)], KINDS)).body.records
    assert (record.src, record.seq, record.stamp) == (3, 1, 7)
    assert (record.body.active, record.body.place) == (True, (1.0, 2.0))


def test_the_fields_of_a_body_keep_their_names_within_a_dict():
    sent = Sent(0, 0, 0, 1, 5, 0, 24, {"to 3": [Payload(True, (1.0, 2.0))]})
    (payload,) = next(events_of([line_of(sent)], KINDS)).body["to 3"]
    assert (payload.active, payload.place) == (True, (1.0, 2.0))


@pytest.mark.parametrize(
    ("key", "written"),
    [((1, "b"), '[1, "b"]'), (np.int64(3), "3"), (b"x", "78"), (3, "3"), (0.5, "0.5"), (None, "null"), (True, "true")],
)
def test_a_key_of_a_body_becomes_a_string(key, written):
    assert json.loads(line_of(Sent(0, 0, 0, 1, 5, 0, 24, [{key: {key: 1}}])))["body"] == [{written: {written: 1}}]


@pytest.mark.parametrize("name", ["a b", "class", "_c", "\ufb01"])
def test_a_table_with_a_key_that_is_no_name_stays_one(name):
    sent = Sent(0, 0, 0, 1, 5, 0, 24, {"a": 1, name: [3]})
    assert next(events_of([line_of(sent)], KINDS)).body == {"a": 1, name: (3,)}


SENT = json.loads(line_of(Sent(0, 7, 1, 2, 5, 0, 24, None)))
BROADCAST = json.loads(line_of(Broadcast(0, 7, 0, 1, (1, 2), (5, LOST), 0, 24, None)))
TALLY = json.loads(line_of(MessageCounts(0, 1, 1, 0, 0, {}, 1, 24, 0.0)))
BAD = {
    "{": "Expecting property name",
    "7": "should be an object",
    "[]": "should be an object",
    "{}": "should be an object whose key event is one of Queued, Broadcast",
    '{"event": [], "t": 0}': "should be an object whose key event is one of",
    '{"event": "Eaten", "t": 0}': "should be an object whose key event is one of",
    '{"event": "Queued", "t": 0.0}': "transmission: (Field required|Missing required argument)",
    json.dumps(SENT | {"new": 1}): "new: ",
    json.dumps(SENT | {"t": "x"}): "t: should be a number",
    json.dumps(SENT | {"t": True}): "t: should be a number",
    json.dumps(SENT | {"t": -1.0}): "t: should be greater than or equal to 0",
    json.dumps(SENT | {"t": 10**400}): "t: ",
    json.dumps(SENT | {"t": inf}): "t: should be",
    json.dumps(SENT | {"t": nan}): "t: should be",
    json.dumps(SENT | {"t": None}): "t: should be a number",
    json.dumps(SENT | {"arrival": "x"}): "arrival: should be a number",
    json.dumps(SENT | {"src": "x"}): "src: should be an integer",
    json.dumps(SENT | {"src": 1.5}): "src: should be an integer",
    json.dumps(SENT | {"src": 10**400}): "src: should be less than 3",
    json.dumps(SENT | {"src": 3}): "src: should be less than 3",
    json.dumps(SENT | {"dst": -1}): "dst: should be greater than or equal to 0",
    json.dumps(SENT | {"transmission": True}): "transmission: should be an integer",
    json.dumps(SENT | {"size": -1}): "size: should be greater than or equal to 0",
    json.dumps(BROADCAST | {"dst": 1}): "dst: should be a list",
    json.dumps(BROADCAST | {"dst": [1, 3]}): "dst.1: should be less than 3",
    json.dumps(BROADCAST | {"arrival": [0.0, "x"]}): "arrival.1: should be a number",
    json.dumps(TALLY | {"lost_by": {"": 1}}): "lost_by..*: String should have at least 1 character",
    json.dumps(TALLY | {"utilisation": nan}): "utilisation: should be",
}


@pytest.mark.parametrize(("line", "told"), BAD.items(), ids=BAD)
def test_a_line_that_is_no_event_is_named_with_what_is_wrong(line, told):
    lost = Lost(0, 0, 0, 1, "loss")
    with pytest.raises(ValueError, match=f"^line 2 is not an event: {told}"):
        list(events_of([line_of(lost), line], KINDS, {"node": Field(lt=3)}))


@pytest.mark.skipif(sys.platform == "win32", reason="files are locked by `fcntl` only")
def test_a_file_that_one_process_writes_is_refused_to_another(tmp_path):
    part, path = tmp_path / "trace.jsonl.part", tmp_path / "trace.jsonl"
    with _open_alone(part, path) as file:
        with pytest.raises(BlockingIOError, match="is written by another process: each run needs a file of its own"):
            _open_alone(part, path)
        assert file.writable()
    _open_alone(part, path).close()

"""The trace: what is kept, what is shown, how it is written."""

import json
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.kernel.events import LOST, Broadcast, Lost, Queued, Sent, Tally, Trace
from desim.kernel.records import Record

pytestmark = pytest.mark.own_trace


def test_times_are_written_in_seconds_and_never_is_null():
    trace = Trace()
    trace.append(Broadcast(1_500_000_000, 7, 0, 1, (1, 2), (2_000_000_000, LOST), 1_000_000_000, 24, [True]))
    trace.append(Tally(2_000_000_000, 2, 1, 1, 0, {"loss": 1}, 1, 24, 0.25))
    first, last = map(json.loads, trace.lines())
    assert first == {
        "event": "Broadcast",
        "t": 1.5,
        "flight": 7,
        "src": 0,
        "seq": 1,
        "dst": [1, 2],
        "arrival": [2.0, None],
        "created": 1.0,
        "size": 24,
        "body": [True],
    }
    assert last == {
        "event": "Tally",
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


def test_watchers_see_messages_that_are_not_kept():
    seen = []
    trace = Trace([seen.append], messages=False)
    message, tally = Sent(0, 0, 0, 1, 5, 0, 24, None), Tally(9, 1, 1, 0, 0, {}, 1, 24, 0.0)
    trace.append_message(message)
    trace.append(tally)
    assert seen == [message, tally]
    assert list(trace) == [tally]


def test_only_a_watcher_that_returns_true_stops_the_run():
    stops = []
    trace = Trace([lambda event: event.t, lambda event: event.t == 2], stop=lambda: stops.append(len(trace)))
    for t in (1, 2, 3):
        trace.append(Tally(t, 0, 0, 0, 0, {}, 0, 0, 0.0))
    assert stops == [2]


def test_a_trace_that_nobody_wants_messages_of_says_so():
    assert not Trace(messages=False).wants_messages
    assert Trace([print], messages=False).wants_messages


class Word(NamedTuple):
    active: bool
    place: tuple[float, ...]


class Words(NamedTuple):
    records: tuple[Record, ...]


KINDS = {kind.__name__: kind for kind in (Queued, Broadcast, Sent, Lost, Tally)}
TIMES = st.integers(0, 2**51)  # 26 days: half a nanosecond is more than what a float of seconds is off
NODES = st.integers(0, 50)
NUMBERS = st.floats(allow_nan=False)
WORDS = st.builds(Word, st.booleans(), st.lists(NUMBERS, max_size=3).map(tuple))
RECORDS = st.builds(Record, NODES, NODES, TIMES, WORDS)
BODIES = st.one_of(
    st.none(), st.text(), NUMBERS, WORDS, st.builds(Words, st.lists(RECORDS, max_size=3).map(tuple)), st.tuples(WORDS)
)
ARRIVALS = st.lists(st.just(LOST) | TIMES, max_size=4).map(tuple)
EVENTS = st.one_of(
    st.builds(Queued, TIMES, NODES, NODES, st.lists(NODES).map(tuple), NODES),
    st.builds(Broadcast, TIMES, NODES, NODES, NODES, st.lists(NODES).map(tuple), ARRIVALS, TIMES, NODES, BODIES),
    st.builds(Sent, TIMES, NODES, NODES, NODES, st.just(LOST) | TIMES, TIMES, NODES, BODIES),
    st.builds(Lost, TIMES, NODES, NODES, NODES, st.sampled_from(["loss", "reach"])),
    st.builds(Tally, TIMES, *[NODES] * 4, st.just({"loss": 3}), NODES, NODES, NUMBERS),
)


@given(st.lists(EVENTS))
def test_a_trace_that_was_written_is_read_again(events):
    trace = Trace()
    for event in events:
        trace.append(event)
    again = Trace.read(trace.lines(), KINDS)
    assert again.events == events
    assert [type(event) for event in again] == [type(event) for event in events]
    assert list(again.lines()) == list(trace.lines())


def test_what_a_body_says_has_its_names_also_inside_of_it():
    trace = Trace()
    trace.append(Sent(0, 0, 0, 1, 5, 0, 24, Words((Record(3, 1, 7, Word(True, (1.0, 2.0))),))))
    (record,) = Trace.read(trace.lines(), KINDS).events[0].body.records
    assert (record.src, record.seq, record.sent) == (3, 1, 7)
    assert (record.body.active, record.body.place) == (True, (1.0, 2.0))


@pytest.mark.parametrize("name", ["a b", "class", "_c"])
def test_a_table_with_a_key_that_is_no_name_stays_one(name):
    trace = Trace()
    trace.append(Sent(0, 0, 0, 1, 5, 0, 24, {"a": 1, name: [3]}))
    assert Trace.read(trace.lines(), KINDS).events[0].body == {"a": 1, name: (3,)}


@pytest.mark.parametrize(
    "line",
    [
        "{",
        "7",
        "[]",
        "{}",
        '{"event": "Eaten", "t": 0}',
        '{"event": "Queued", "t": 0.0}',
        '{"event": "Queued", "t": "x"}',
    ],
)
def test_a_line_that_is_no_event_is_named(line):
    trace = Trace()
    trace.append(Lost(0, 0, 0, 1, "loss"))
    with pytest.raises(ValueError, match=r"^line 2 is no event: "):
        Trace.read([*trace.lines(), line], KINDS)

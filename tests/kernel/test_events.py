"""The trace: what is kept, what is shown, how it is written."""

import json

import pytest

from desim.kernel.events import LOST, Broadcast, Sent, Tally, Trace

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

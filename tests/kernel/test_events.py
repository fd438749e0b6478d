"""The trace: recording, watchers, and the fields of message events."""

import pytest

from desim.kernel.core.events import LOST, Broadcast, MessageCounts, Sent, Trace
from desim.kernel.stepped_network import SteppedNetwork

pytestmark = pytest.mark.own_trace


@pytest.mark.parametrize(
    ("dst", "arrival", "fates"),
    [
        ((1, 2), (5, LOST), [(1, 5), (2, LOST)]),
        ((1, 2), (5,), [(1, 5), (2, 5)]),
        ((1,), (5,), [(1, 5)]),
        ((), (), []),
    ],
)
def test_a_broadcast_event_has_the_arrival_time_of_each_receiver_even_if_all_are_equal(dst, arrival, fates):
    assert list(Broadcast(0, 0, 0, 1, dst, arrival, 0, 24, None).fates()) == fates


def test_a_broadcast_without_a_time_for_each_receiver_is_refused():
    with pytest.raises(ValueError, match="shorter"):
        list(Broadcast(0, 0, 0, 1, (1, 2, 3), (5, 6), 0, 24, None).fates())


def test_a_unicast_event_has_the_arrival_time_of_its_receiver():
    assert list(Sent(0, 0, 0, 1, 5, 0, 24, None).fates()) == [(1, 5)]
    assert list(Sent(0, 0, 0, 1, LOST, 0, 24, None).fates()) == [(1, LOST)]


def test_watchers_see_messages_that_are_not_kept():
    seen = []
    trace = Trace([seen.append], messages=False)
    message, tally = Sent(0, 0, 0, 1, 5, 0, 24, None), MessageCounts(9, 1, 1, 0, 0, {}, 1, 24, 0.0)
    trace.append_message(message)
    trace.append(tally)
    assert seen == [message, tally]
    assert list(trace) == [tally]


def test_a_class_that_overrides_how_events_are_stored_gets_all_that_are():
    stored = []

    class Theirs(Trace):
        def append(self, event):
            stored.append(event)
            super().append(event)

    seen = []
    for trace in (Theirs([seen.append]), Theirs([seen.append], messages=False)):
        with SteppedNetwork(3, {"latency": 0.1, "loss": 0.5}, trace=trace) as network:
            network.send(0, None, "x")
            network.step(1.0)
        assert stored == trace.events
        assert len(seen) == 4  # a broadcast, a loss, a delivery and the counts
        stored.clear(), seen.clear()


def test_only_a_watcher_that_returns_true_stops_the_run():
    stops = []
    trace = Trace([lambda event: event.t, lambda event: event.t == 2], stop=lambda: stops.append(len(trace)))
    for t in (1, 2, 3):
        trace.append(MessageCounts(t, 0, 0, 0, 0, {}, 0, 0, 0.0))
    assert stops == [2]


def test_a_trace_reports_whether_any_watcher_needs_messages():
    assert not Trace(messages=False).wants_messages
    assert Trace([print], messages=False).wants_messages

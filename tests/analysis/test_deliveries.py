"""Deliveries, chases, outages and handovers: every message, chase and fault of a run, each once and in full."""

from collections import Counter

import pytest

from desim import summary
from desim.analysis.deliveries import Chase, Delivery, Interval, chasing, deliveries, handover_events, outages
from desim.analysis.trace_index import ended
from desim.kernel.core.events import Broadcast, Lost, Queued, Sent
from desim.kernel.core.units import SECOND
from desim.kernel.models.faults import Crash, Jamming
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.pursuit.core.events import Decided
from desim.pursuit.team.announcements import announced_action
from desim.view.pictures.paths import active_periods
from tests.view.by_hand import ACTIVE, CRASH, INACTIVE, JAMMING, MS, history, pair

SHORT = ("horizon=1.0", "record.messages=true")
SLOW = (("faults.toml",), *((f"{name}.toml", *SHORT) for name in ("radio", "lora", "contention", "token_ring")))
RUNS = [("soak.toml", *SHORT), *(pytest.param(each, marks=pytest.mark.slow) for each in SLOW)]


@pytest.fixture(params=RUNS, ids=lambda asked: asked[0])
def ran(request, run_of):
    return run_of(*request.param)


def in_a_loop(result):
    """Return the deliveries as one event after the other makes them."""
    found, never = {}, ended(result).t + 1
    for event in result.trace:
        if isinstance(event, Queued):
            for dst in event.dst:
                begun = (event.transmission, event.src, dst, event.t, never, never, None, event.size, None)
                found[event.transmission, dst] = Delivery(*begun)
        elif isinstance(event, Broadcast | Sent):
            for dst, arrival in event.fates():
                begun = (event.transmission, event.src, dst, event.created, event.t, arrival, None)
                found[event.transmission, dst] = Delivery(*begun, event.size, event.body)
        elif isinstance(event, Lost):
            lost = found[event.transmission, event.dst]
            left = min(lost.left, event.t)
            found[event.transmission, event.dst] = lost._replace(left=left, until=event.t, cause=event.cause)
    return sorted(found.values(), key=lambda each: (each.left, each.transmission, each.dst))


@pytest.mark.parametrize("by_hand", [history, pair])
def test_the_table_of_deliveries_equals_a_loop_over_the_events_by_hand(by_hand):
    assert deliveries(by_hand()) == in_a_loop(by_hand())


def test_the_table_of_deliveries_equals_a_loop_over_the_events(ran):
    assert deliveries(ran) == in_a_loop(ran)


def test_each_message_to_each_receiver_is_one_delivery_in_order_of_transmission():
    token = ("token", float("inf"))
    assert deliveries(history()) == [
        Delivery(0, 0, 1, 100 * MS, 100 * MS, 200 * MS, None, 24, ACTIVE),
        Delivery(0, 0, 2, 100 * MS, 100 * MS, 100 * MS, "loss", 24, ACTIVE),
        Delivery(1, 2, 0, 250 * MS, 300 * MS, 500 * MS, "crash", 32, token),
        Delivery(2, 1, 0, 650 * MS, 750 * MS, 750 * MS, "queue", 24, None),
        Delivery(2, 1, 2, 650 * MS, 750 * MS, 750 * MS, "queue", 24, None),
        Delivery(3, 1, 0, 900 * MS, 900 * MS, 1200 * MS, None, 24, INACTIVE),
        Delivery(3, 1, 2, 900 * MS, 900 * MS, 1200 * MS, None, 24, INACTIVE),
        Delivery(4, 0, 1, 950 * MS, 1000 * MS + 1, 1000 * MS + 1, None, 24, None),
    ]


@pytest.mark.slow
def test_deliveries_match_the_counts_of_sent_delivered_and_lost_messages(ran):
    """What waits as the run ends is in flight: it has no body and no cause."""
    numbers, found, end = summary(ran), deliveries(ran), ran.trace.events[-1].t
    delivered = [each for each in found if each.cause is None and each.body is not None and each.until <= end]
    assert len(found) == numbers.messages_sent
    assert Counter(each.cause for each in found if each.cause) == numbers.messages_lost_by
    assert len(delivered) == numbers.messages_delivered
    assert all(each.created <= each.left <= each.until for each in found)
    assert [each.left for each in found] == sorted(each.left for each in found)


def test_without_recorded_messages_the_error_explains_how_to_record_them():
    with pytest.raises(ValueError, match=r"record\.messages = true"):
        deliveries(history(messages=False))


def test_a_message_carries_an_action_or_none():
    assert (
        announced_action(ACTIVE),
        announced_action(INACTIVE),
        announced_action(("token", 1)),
        announced_action(None),
    ) == (1, 0, None, None)
    assert [announced_action(each.body) for each in deliveries(pair())] == [2, 2, 0, 0]


def test_chase_intervals_begin_with_the_run_and_end_by_decision_breakdown_or_end():
    assert chasing(history()) == [[Chase(0, 400 * MS, 1)], [Chase(0, 150 * MS, 1)], [Chase(800 * MS, 1000 * MS, 1)]]


def test_a_chase_interval_ends_with_a_change_of_evader_or_a_capture():
    assert chasing(pair()) == [
        [Chase(0, 400 * MS, 1), Chase(400 * MS, 1000 * MS, 2)],
        [Chase(0, 150 * MS, 1), Chase(150 * MS, 700 * MS, 2)],
        [Chase(0, 300 * MS, 2)],
    ]


def test_handovers_are_listed_per_evader_in_order_of_time():
    assert handover_events(pair()) == [(0, 2, 2), (150 * MS, 0, 1), (300 * MS, 1, 2), (700 * MS, 0, 2)]
    assert handover_events(history()) == [(150 * MS, 0, 1), (800 * MS, 2, 1)]


def test_a_fault_without_an_end_lasts_until_the_end_of_the_run():
    assert outages(history()) == [(CRASH, Interval(400 * MS, 600 * MS)), (JAMMING, Interval(700 * MS, 1000 * MS))]


def test_two_equal_faults_at_once_are_two():
    extra = [event for event in history().trace if getattr(event, "fault", None) == CRASH]
    assert outages(history(*extra))[:2] == [(CRASH, Interval(400 * MS, 600 * MS))] * 2


def test_of_faults_that_overlap_each_ends_at_its_own_time():
    early = Jamming(centre=(0.0, 0.0), radius=1.0, start=0.35, end=0.5)
    found = outages(history(FaultStarted(350 * MS, early), FaultEnded(500 * MS, early)))
    assert found[:2] == [(early, Interval(350 * MS, 500 * MS)), (CRASH, Interval(400 * MS, 600 * MS))]
    other = Crash(node=1, start=0.35, end=0.65)
    found = outages(history(FaultStarted(350 * MS, other), FaultEnded(650 * MS, other)))
    assert found[:2] == [(other, Interval(350 * MS, 650 * MS)), (CRASH, Interval(400 * MS, 600 * MS))]


def test_active_periods_alone_have_a_positive_length():
    """At 850 ms pursuer 1 starts and stops; at 900 ms 2 stops before 1 starts, and at 950 ms 2 starts after 1 stops."""
    at = [(850, 1, True), (850, 1, False), (900, 2, False), (900, 1, True), (950, 2, True), (950, 1, False)]
    found = active_periods(history(*(Decided(t * MS, pursuer, active) for t, pursuer, active in at)))
    assert found[3:] == [
        (2, 800 * MS, 900 * MS, True, 1),
        (1, 900 * MS, 950 * MS, True, 1),
        (2, 950 * MS, 1000 * MS, True, 1),
    ]
    both = active_periods(history(Decided(850 * MS, 1, True), Decided(900 * MS, 2, False), Decided(900 * MS, 0, True)))
    assert [each for each in both if each.begin >= 850 * MS] == [
        (2, 850 * MS, 900 * MS, False, 1),
        (1, 850 * MS, 1000 * MS, False, 1),
        (0, 900 * MS, 1000 * MS, False, 1),
    ]


def test_active_periods_are_split_where_a_pursuer_becomes_the_only_active_one():
    assert active_periods(history()) == [
        (1, 0, 150 * MS, False, 1),
        (0, 0, 150 * MS, False, 1),
        (0, 150 * MS, 400 * MS, True, 1),
        (2, 800 * MS, 1000 * MS, True, 1),
    ]


def test_being_the_only_active_pursuer_is_per_evader():
    assert active_periods(pair()) == [
        (1, 0, 150 * MS, False, 1),
        (0, 0, 150 * MS, False, 1),
        (0, 150 * MS, 400 * MS, True, 1),
        (2, 0, 150 * MS, True, 2),
        (2, 150 * MS, 300 * MS, False, 2),
        (1, 150 * MS, 300 * MS, False, 2),
        (1, 300 * MS, 400 * MS, True, 2),
        (1, 400 * MS, 700 * MS, False, 2),
        (0, 400 * MS, 700 * MS, False, 2),
        (0, 700 * MS, 1000 * MS, True, 2),
    ]


def test_chase_intervals_and_active_periods_sum_to_the_active_time(ran):
    """Their sum is int n dt; those of the only active one are int 1{n = 1} dt, what is neither idle nor crowded."""
    numbers = summary(ran)
    spells = sum(end - begin for own in chasing(ran) for begin, end, _ in own) / SECOND
    found = active_periods(ran)
    assert spells == pytest.approx(numbers.active_time, abs=1e-8)
    assert sum(each.end - each.begin for each in found) / SECOND == pytest.approx(numbers.active_time, abs=1e-8)
    alone = ran.trace.events[-1].t / SECOND - numbers.idle_time - numbers.crowded_time
    assert sum(each.end - each.begin for each in found if each.alone) / SECOND == pytest.approx(alone, abs=1e-8)

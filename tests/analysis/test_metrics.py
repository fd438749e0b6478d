"""Metrics, integrated by hand."""

import json
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim.analysis import transport_metrics as transport
from desim.analysis.measuring import summary
from desim.analysis.metrics import (
    METRICS,
    Summary,
    active_time,
    activity,
    believed_leaders,
    changes,
    crowded_time,
    energy,
    excess_time,
    handovers,
    idle_time,
    messages,
    ping_pongs,
    plain,
    switches,
    words,
)
from desim.analysis.trace_index import ended, remembered, trace_index
from desim.kernel.core.events import Broadcast, MessageCounts, Sent, Trace, TransportCounts
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.models.faults import Jamming
from desim.kernel.models.traced_faults import FaultStarted
from desim.pursuit.core.events import BrokeDown, Decided, Ended, Started
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Team
from desim.scenario.scenario import Recording, Scenario
from desim.simulation.run import Result, run
from tests.golden import golden

pytestmark = pytest.mark.own_trace
TIMES = (active_time, idle_time, crowded_time, excess_time)


def by_hand(active, decisions, end, reason="captured", capturer=0, tally=(0, 0, 0, 0, {}, 0, 0, 0.0)) -> Result:
    """Return a result with this start, these (time, pursuer, action) and this end; times in s."""
    trace = Trace()
    places = tuple((float(i), 0.0) for i in range(len(active)))
    trace.append(Started(0, ((9.0, 0.0),), places, (2.0,) * len(active), active))
    for time, pursuer, action in decisions:
        trace.append(Decided(nanoseconds(time), pursuer, action))
    trace.append(MessageCounts(nanoseconds(end), *tally))
    trace.append(Ended(nanoseconds(end), reason, capturer))
    return Result(Scenario(seed=1), 5, trace)


@pytest.fixture
def relay() -> Result:
    """Return a relay of three pursuers over 4 s.

    from     0   1   1.5   2   2.5   3   to 4
    n        2   1   1     0   1     3
    event        0-  0-    1-  2+    0+ 1+
    """
    decisions = [(1.0, 0, False), (1.5, 0, False), (2.0, 1, False), (2.5, 2, True), (3.0, 0, True), (3.0, 1, True)]
    tally = (12, 7, 3, 2, {"loss": 3}, 6, 144, 0.25)
    return by_hand((True, True, False), decisions, 4.0, capturer=2, tally=tally)


def test_the_times_of_a_relay_are_integrals_of_the_number_of_active_pursuers(relay):
    """Active: 2 x 1 + 1 x 1 + 0 x 0.5 + 1 x 0.5 + 3 x 1. Idle: 2 to 2.5 s. Crowded: 0 to 1 s and 3 to 4 s.

    In excess of one: (2 - 1) x 1 + (3 - 1) x 1.
    """
    assert [metric(relay) for metric in TIMES] == [6.5, 0.5, 2.0, 3.0]


def test_decisions_that_repeat_an_action_are_no_switches(relay):
    """Of six decisions the one at 1.5 s changes nothing."""
    assert switches(relay) == 5
    assert [(each.t / SECOND, each.pursuer) for each in changes(relay)] == [(1, 0), (2, 1), (2.5, 2), (3, 0), (3, 1)]


def test_activity_is_a_step_function_with_a_piece_of_no_length_between_simultaneous_changes(relay):
    durations, counts = activity(relay)
    assert durations.tolist() == [1.0, 1.0, 0.5, 0.5, 0.0, 1.0]
    assert counts.tolist() == [2, 1, 0, 1, 2, 3]


def test_a_pursuer_that_leaves_and_returns_at_one_instant_switches_twice_and_no_time_passes():
    result = by_hand((True,), [(1.0, 0, False), (1.0, 0, True)], 2.0)
    assert switches(result) == 2
    assert [metric(result) for metric in TIMES] == [2.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("active", "expected"),
    [
        ((False, False), [0.0, 3.0, 0.0, 0.0]),
        ((True, False), [3.0, 0.0, 0.0, 0.0]),
        ((True, True), [6.0, 0.0, 3.0, 3.0]),
    ],
    ids=["nobody", "one", "both"],
)
def test_without_a_decision_everything_stays_as_it_began(active, expected):
    result = by_hand(active, [], 3.0)
    assert [metric(result) for metric in TIMES] == expected
    assert switches(result) == 0


@pytest.mark.parametrize("active", [True, False])
def test_decisions_that_only_repeat_the_start_change_nothing(active):
    result = by_hand((active, True), [(0.0, 0, active), (1.0, 1, True), (2.0, 0, active)], 3.0)
    assert switches(result) == 0
    assert active_time(result) == 3.0 + 3.0 * active
    assert summary(result).decisions == 3


def test_a_decision_at_the_end_is_a_switch_that_costs_no_time():
    result = by_hand((False,), [(3.0, 0, True)], 3.0)
    assert (switches(result), active_time(result), idle_time(result)) == (1, 0.0, 3.0)


def test_a_pursuer_that_breaks_down_is_no_longer_active_and_that_is_no_switch():
    """Pursuer 0 chases for 1 s and breaks down, it is ordered to chase at 3 s: 1 + 1 s, and one switch."""
    result = by_hand((True,), [], 4.0)
    result.trace.events[1:1] = [BrokeDown(SECOND, 0), Decided(2 * SECOND, 0, False), Decided(3 * SECOND, 0, True)]
    assert (active_time(result), idle_time(result), switches(result)) == (2.0, 2.0, 1)
    assert changes(result) == [BrokeDown(SECOND, 0), Decided(3 * SECOND, 0, True)]


def test_energy_is_the_integral_of_the_squared_speeds_of_the_active():
    """At 2, 1 and 3 m/s for 2, 3 and 1 s: 4 x 2 + 1 x 3 + 9 x 1; repeated, halted and late activity adds nothing."""
    result = by_hand((True, False, False), [(1.0, 1, True), (1.5, 1, True), (2.0, 0, False), (3.0, 2, True)], 4.0)
    result.trace.events[0] = result.trace.events[0]._replace(speeds=(2.0, 1.0, 3.0))
    assert energy(result) == 20.0
    result.trace.events[-2:-2] = [BrokeDown(3 * SECOND, 2)]
    assert energy(result) == 11.0


def exchange(*relays, start=(True, False, False), end=20.0):
    """Return a result in which the first pursuer of each (time, from, to) leaves and the other joins it."""
    return by_hand(start, [each for t, i, j in relays for each in ((t, i, False), (t, j, True))], end)


def test_a_handover_is_a_change_of_the_single_active_pursuer():
    """0 -> 1 at 1 s, 1 -> 2 at 2 s."""
    assert handovers(exchange((1.0, 0, 1), (2.0, 1, 2))) == 2


def test_phases_with_none_or_several_active_do_not_affect_handovers():
    """0, none, 0 again: no handover. 0, then 0 and 1, then 1: one. Then 1, all, none, 1: no handover."""
    acts = [(1.0, 0, False), (2.0, 0, True)]
    assert handovers(by_hand((True, False, False), acts, 9.0)) == 0
    acts += [(3.0, 1, True), (4.0, 0, False)]
    assert handovers(by_hand((True, False, False), acts, 9.0)) == 1
    acts += [(5.0, 0, True), (5.0, 2, True), (6.0, 0, False), (6.0, 1, False), (6.0, 2, False), (7.0, 1, True)]
    assert handovers(by_hand((True, False, False), acts, 9.0)) == 1


def test_being_the_only_active_pursuer_for_zero_time_is_no_handover():
    """Between simultaneous changes, {0, 1} -> {1} -> {1, 2}, and at the end."""
    acts = [(1.0, 1, True), (2.0, 0, False), (2.0, 2, True), (3.0, 2, False), (3.0, 1, False), (3.0, 0, True)]
    assert handovers(by_hand((True, False, False), acts, 9.0)) == 0
    assert handovers(by_hand((True, False, False), [(9.0, 1, True), (9.0, 0, False)], 9.0)) == 0
    assert handovers(by_hand((True, False, False), [(0.0, 1, True), (0.0, 0, False)], 9.0)) == 0


def test_the_first_single_active_pursuer_and_a_run_without_one_are_no_handover():
    assert handovers(by_hand((True, True, True), [(1.0, 0, False), (2.0, 2, False)], 9.0)) == 0
    assert handovers(by_hand((False, False), [], 9.0)) == 0


def test_a_ping_pong_is_a_handover_that_reverts_the_previous_one_within_a_second():
    """0 -> 1 at 1 s, back after 0.75 s (yes), there after 1 s (no), 1 -> 2 and 2 -> 0 at once (no), back (yes)."""
    result = exchange((1.0, 0, 1), (1.75, 1, 0), (2.75, 0, 1), (3.0, 1, 2), (3.25, 2, 0), (3.5, 0, 2))
    assert (handovers(result), ping_pongs(result)) == (6, 2)
    assert ping_pongs(result, within=1.25) == 3
    assert ping_pongs(result, within=0.75) == 1
    assert ping_pongs(result, within=0.25) == 0


def test_a_ping_pong_is_timed_from_handover_to_handover():
    """0 -> 1 at 2 s after a second with none; 1 leaves at 2.5 s; 0 is alone again at 2.75 s, 0.75 s after 2 s."""
    acts = [(1.0, 0, False), (2.0, 1, True), (2.5, 1, False), (2.75, 0, True)]
    result = by_hand((True, False), acts, 9.0)
    assert ping_pongs(result, within=0.8) == 1
    assert ping_pongs(result, within=0.75) == 0


def test_the_summary_of_a_run_whose_messages_are_recorded_has_ages_and_errors():
    """Each of 20 pursuers receives from the others at once: no belief is wrong, and records arrive fresh."""
    result = run(Scenario(horizon=0.5, record=Recording(messages=True)))
    numbers = summary(result)
    assert numbers.belief_error == 0.0
    assert numbers.believed_leaders == believed_leaders(result)
    assert 0.0 < numbers.age_mean < numbers.age_peak < 0.5
    assert 0.0 < numbers.age_at_decision < 0.5
    assert numbers.bytes_sent == 24 * numbers.transmissions > 0


def test_a_single_pursuer_has_no_ages_or_belief_errors():
    numbers = summary(run(Scenario(horizon=0.1, team=Team(count=1), record=Recording(messages=True))))
    assert (numbers.age_mean, numbers.age_peak, numbers.age_at_decision, numbers.belief_error) == (None,) * 4


def test_the_summary_of_a_capture_is_golden(relay):
    golden("summary.json", json.dumps(plain(summary(relay)), indent=1) + "\n")


@pytest.mark.parametrize("reason", ["horizon", "stopped"])
def test_the_summary_of_a_run_that_was_not_captured_has_none_for_time_and_capturer(reason):
    numbers = summary(by_hand((True,), [], 30.0, reason, None))
    assert (numbers.captured, numbers.capture_time, numbers.capturer) == (False, None, None)
    assert numbers.end_time == 30.0


def test_a_capture_at_the_start_has_a_time_of_0_and_not_none():
    numbers = summary(by_hand((True, False), [], 0.0, capturer=1))
    assert (numbers.captured, numbers.capture_time, numbers.capturer) == (True, 0.0, 1)


def test_events_that_do_not_concern_a_metric_do_not_change_it(relay):
    before = summary(relay)
    relay.trace.append(FaultStarted(0, Jamming(start=0.0, centre=(0.0, 0.0), radius=1.0)))
    assert summary(relay) == before


def test_ending_and_messages_are_the_last_events_of_a_trace(relay):
    assert [messages(relay), ended(relay)] == relay.trace.events[-2:]


@st.composite
def histories(draw) -> Result:
    """Draw decisions of up to five pursuers at whole multiples of 1/8 s, which float sums hold exactly."""
    count = draw(st.integers(1, 5))
    times = sorted(draw(st.lists(st.integers(0, 80), max_size=30)))
    decisions = [(time / 8, draw(st.integers(0, count - 1)), draw(st.booleans())) for time in times]
    return by_hand(tuple(draw(st.lists(st.booleans(), min_size=count, max_size=count))), decisions, 10.0)


@pytest.mark.slow
@settings(deadline=None)
@given(histories())
def test_active_time_is_the_sum_over_the_pursuers_of_how_long_each_was_active(result):
    (start,), total = result.trace.of(Started), 0.0
    for pursuer, active in enumerate(start.active):
        since = 0.0
        for each in result.trace.of(Decided):
            if each.pursuer == pursuer:
                total += active * (each.t / SECOND - since)
                since, active = each.t / SECOND, each.active
        total += active * (10.0 - since)
    assert active_time(result) == total


@pytest.mark.parametrize(("exponent", "power"), [(0.0, 2.0), (1.0, 4.0), (2.0, 10.0), (3.0, 28.0)])
def test_energy_is_that_of_the_drive_with_the_exponent(exponent, power):
    """Two pursuers of 1 and 3 m/s are active for a whole second: 1^p + 3^p."""
    team = {"count": 2, "speeds": [1.0, 3.0], "power_exponent": exponent}
    scenario = Scenario(horizon=1.0, team=team, motion={"static": True}, protocol=lambda me: iter(()))
    assert energy(run(scenario)) == power


@pytest.mark.slow
@settings(deadline=None)
@given(histories())
def test_energy_and_handovers_equal_those_of_a_plain_loop_over_the_trace(result):
    """Tick by tick of 1/8 s, on whose grid everything happens; speeds 1, 2, 3, ... m/s."""
    (start,) = result.trace.of(Started)
    start = start._replace(speeds=tuple(1.0 + i for i in range(len(start.active))))
    result.trace.events[0] = start
    active, spent, alone = list(start.active), 0.0, []
    for tick in range(80):
        for each in result.trace.of(Decided):
            if each.t * 8 == tick * SECOND:
                active[each.pursuer] = each.active
        spent += sum((1.0 + i) ** 2 for i, a in enumerate(active) if a) / 8
        if sum(active) == 1 and (not alone or alone[-1][1] != active.index(True)):
            alone.append((tick / 8, active.index(True)))
    assert energy(result) == spent
    assert handovers(result) == max(len(alone) - 1, 0)
    back = [c - b for (_, i), (b, _), (c, j) in zip(alone, alone[1:], alone[2:], strict=False) if i == j]
    for within in (0.25, 1.0, 3.0):
        assert ping_pongs(result, within) == sum(each < within for each in back)


@pytest.mark.slow
@settings(deadline=None)
@given(histories())
def test_idle_single_and_excess_active_time_cover_the_run(result):
    """n - (n - 1)+ + 1{n = 0} = 1, and crowding is where there is excess."""
    assert active_time(result) - excess_time(result) + idle_time(result) == 10.0
    assert crowded_time(result) <= excess_time(result)
    assert (crowded_time(result) > 0) == (excess_time(result) > 0)


@pytest.mark.slow
@settings(deadline=None)
@given(histories())
def test_the_changes_of_one_pursuer_alternate_and_begin_by_leaving_its_first_action(result):
    (start,) = result.trace.of(Started)
    for pursuer, active in enumerate(start.active):
        own = [each.active for each in changes(result) if each.pursuer == pursuer]
        assert own == [(active + k) % 2 == 0 for k in range(len(own))]


def test_the_summary_of_a_run_agrees_with_its_trace():
    result = run(Scenario(horizon=0.3, announce=Announcements(trigger="revision", start="known")))
    numbers = summary(result)
    assert numbers.seed == result.seed == 0
    assert numbers.end_time == 0.3
    assert numbers.messages_sent == numbers.decisions * 19
    assert numbers.messages_sent == numbers.messages_delivered + numbers.messages_lost + numbers.messages_in_flight
    durations, counts = activity(result)
    assert durations.sum() == pytest.approx(0.3)
    assert counts.min() >= 0
    assert counts.max() <= 20
    assert np.abs(np.diff(counts)).tolist() == [1] * numbers.switches


# The summary and its entries.


def test_every_field_of_a_summary_is_one_entry_that_measures_it(relay):
    numbers = summary(relay)
    assert list(METRICS) == list(numbers) == [name for name in Summary.__annotations__ if name in METRICS]
    assert {name: metric(relay) for name, metric in METRICS.items()} == {
        name: getattr(numbers, name) for name in METRICS
    }
    assert list(plain(numbers)) == list(METRICS)


OF_TRANSPORTS = (
    *("share_delivered", "mean_attempts", "delivery_delay", "retransmissions", "acknowledgements"),
    *("given_up", "deadlines_missed", "liveliness_lost"),
)


def test_what_transports_achieved_is_measured_if_there_are_any():
    """Of 10 messages 8 arrived, in 15 attempts and 0.4 s together."""
    counts = TransportCounts(9, 10, 8, 1, {"repeats": 2, "lifespan": 1}, 15, 5, 9, 3, 4, 400_000_000)
    told = Result(Scenario(), 0, Trace())
    told.trace.append(counts)
    assert [getattr(transport, name)(told) for name in OF_TRANSPORTS] == [0.8, 1.5, 0.05, 5, 9, 3, 3, 4]
    silent = Result(Scenario(), 0, Trace())
    assert not transport.has_transport(silent)
    with pytest.raises(ValueError, match=r"no message needed a transport: see network.transport"):
        transport.share_delivered(silent)


def test_a_summary_is_plain_numbers_that_survive_json_and_pickle():
    numbers = summary(run(Scenario(horizon=0.5, record=Recording(messages=True))))
    assert {name for name, value in plain(numbers).items() if value is None} <= {
        "capture_time",
        "capturer",
        "mean_capture_time",
        "time_to_relay",
        "false_accusations",
        "time_to_detect",
        *OF_TRANSPORTS,
    }
    assert Summary(json.loads(json.dumps(dict(numbers)))) == numbers
    assert pickle.loads(pickle.dumps(numbers)) == numbers


def test_a_metric_that_a_stored_run_lacks_is_no_attribute():
    numbers = Summary({"seed": 3})
    assert (numbers.seed, hasattr(numbers, "energy"), getattr(numbers, "energy", None)) == (3, False, None)
    with pytest.raises(AttributeError, match="the run has no 'energy': it was stored before this metric existed"):
        _ = numbers.energy


def test_cached_values_are_derived_once_per_trace_index_and_again_for_a_result(relay):
    calls = []

    @remembered
    def derived(result):
        calls.append(result)
        return len(calls)

    index = trace_index(relay)
    assert repr(index) == repr(relay).replace("Result", "TraceIndex")
    assert [derived(index), derived(index), derived(trace_index(relay)), derived(relay), derived(relay)] == [
        1,
        1,
        2,
        3,
        4,
    ]


def test_a_summary_does_not_hide_what_is_added_to_a_trace_afterwards(relay):
    """One more decision at the end."""
    before = summary(relay)
    relay.trace.events.insert(-2, Decided(4 * SECOND, 2, False))
    assert (summary(relay).decisions, summary(relay).switches) == (before.decisions + 1, before.switches + 1)


def test_a_summary_goes_through_the_trace_once(monkeypatch):
    """Its beginning, its end and the events of each kind are found by one pass, however many metrics need them."""
    result = run(Scenario(horizon=0.2, record=Recording(messages=True)))
    passes = []

    def watched(self):
        passes.append(self)
        return iter(self.events)

    monkeypatch.setattr(Trace, "__iter__", watched)
    monkeypatch.setattr(Trace, "of", lambda self, _: passes.append(self))
    summary(result)
    assert passes == [result.trace]


def test_a_summary_as_text_has_a_line_for_each_number_that_there_is(relay):
    lines = str(summary(relay)).splitlines()
    assert f"active time: {active_time(relay):.6g} s" in lines
    there = [name for name in METRICS if getattr(summary(relay), name) not in (None, {})]
    assert [line.split(": ")[0] for line in lines] == [words(name) for name in there]
    assert len(there) < len(METRICS)


# What counters say, from the messages in the trace.

CHANNEL = {"kind": "bitrate", "bitrate": 1e5, "header": 4}
TRAFFIC = {
    "reliable": {"announce": {"dissemination": {"kind": "reliable"}}},
    "coded": {"announce": {"dissemination": {"kind": "coded"}}},
    "server": {"protocol": {"kind": "server"}, "network": {"transport": {"kind": "reliable"}}},
    "shared": {
        "protocol": {"kind": "server"},
        "network": {"transport": {"kind": "reliable"}, "medium": {"shared": True, "bitrate": 1e6}},
    },
    "flooding": {"announce": {"dissemination": {"kind": "flooding", "hops": 2}}, "network": {"range": 4.0}},
}
"""Scenarios whose messages need time on a channel; some need transports."""


def traffic(name) -> Result:
    given = TRAFFIC[name]
    network = {"loss": 0.3, "latency": 0.05} | given.get("network", {})
    network["medium"] = CHANNEL | network.get("medium", {})
    table = {"team": {"count": 6}, "horizon": 2.0, "record": {"messages": True}} | given | {"network": network}
    return run(Scenario(**table), 1)


def frames(result) -> dict[int, tuple[int, int]]:
    """Return when each transmission with a receiver began, ns, and its size, bytes."""
    sent = [*result.trace.of(Sent), *result.trace.of(Broadcast)]
    return {event.transmission: (event.t, event.size) for event in sent}


@pytest.mark.parametrize("name", TRAFFIC)
def test_the_utilisation_is_the_share_of_airtime_in_the_trace(name):
    result = traffic(name)
    (counts,) = result.trace.of(MessageCounts)
    in_trace = frames(result).values()
    bitrate = result.scenario.network.medium.bitrate
    airtimes = [(begin, round(8.0 * (size + 4) / bitrate * SECOND)) for begin, size in in_trace]
    busy = sum(min(airtime, counts.t - begin) for begin, airtime in airtimes)
    unheard, size = counts.transmissions - len(in_trace), counts.bytes_sent - sum(size for _, size in in_trace)
    busy += round(8.0 * (size + 4 * unheard) / bitrate * SECOND)  # broadcasts that reach nobody leave no event
    channels = 1 if name == "shared" else 6
    assert summary(result).utilisation == pytest.approx(
        (busy + unheard) / (channels * counts.t), rel=1e-3 if unheard else 1e-9
    )
    assert (name == "flooding") == (unheard > 0)


@pytest.mark.parametrize("name", ["reliable", "coded", "server", "shared"])
def test_the_mean_attempts_are_the_frames_per_message_and_receiver_in_the_trace(name):
    result = traffic(name)
    data = [event for event in result.trace.of(Sent) if type(event.body).__name__ in {"Segment", "CodedPiece"}]
    messages = {(event.src, event.dst, event.body.port, event.body.to_all, event.body.seq) for event in data}
    (counts,) = result.trace.of(TransportCounts)
    waiting = counts.submitted - len(messages)  # behind a full window
    assert 0 <= waiting <= 0.1 * counts.submitted
    assert summary(result).mean_attempts == pytest.approx(len(data) / (len(messages) + waiting), rel=1e-12)
    assert summary(result).retransmissions == sum(
        event.body.attempt > 1 for event in data if hasattr(event.body, "attempt")
    )

"""The search for what breaks a protocol."""

import json
import time
from collections import Counter
from dataclasses import replace
from functools import partial
from itertools import count, islice
from math import inf, nan
from pathlib import Path
from types import SimpleNamespace

import networkx as nx
import numpy as np
import pytest

from desim import (
    Announcements,
    Constant,
    Crash,
    Links,
    MessageFault,
    Recording,
    Scenario,
    Team,
    fatal_losses,
    find_violation,
    judge,
    load,
    run,
)
from desim.analysis.properties import Judgement
from desim.analysis.trace_index import messages
from desim.kernel.core.clock import Clock
from desim.kernel.core.events import LOST, Broadcast, MessageCounts
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.kernel.fault_injection import inject
from desim.kernel.link_layer.link_layer import FIRST_COPY
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from desim.pursuit.core.events import Decided
from desim.scenario.properties import Always, property_of
from desim.simulation.watchdog import TimedOut, within
from desim.study.breaking import judging, losses
from desim.study.breaking.case_log import FAILED, CaseLog, CaseRun
from desim.study.breaking.copies import ReadingTime, copies, looks, readings
from desim.study.breaking.features import FEATURES, applied, drawn
from desim.study.breaking.found import case_text, command_for, protocols_text, scenario_text, search_text
from desim.study.breaking.judging import CaseJudge, JudgementError, Planned, failure_of
from desim.study.breaking.loss_table import FatalLosses, LossTable
from desim.study.breaking.losses import hides_old_news
from desim.study.breaking.search import Search, Violation, _Cases
from desim.study.breaking.shrinking import Tried, _simplifications, shrunk
from desim.study.breaking.sightings import SIGHTINGS, seen_in
from desim.study.workers.dispatch import Outcome
from desim.study.workers.workers import InProcess
from scenarios.studies.study import SCENARIOS
from tests.golden import golden
from tests.view.by_hand import MS, history, pair

IDLE = "idle at most 2 in total against centralised"
SHORT = IDLE.replace("2 in", "1.9 in")
SMALL = Scenario(
    team=Team(count=3),
    network=Links(latency=0.1),
    announce=Announcements(trigger="change"),
    horizon=2.0,
    record=Recording(messages=True),
)


# Messages by number.

NETWORKS = {
    "plain": {},
    "random latency": {"network.latency": {"kind": "gamma", "offset": 0.01, "shape": 2.0, "scale": 0.02}},
    "loss and duplicates": {"network.loss": 0.2, "network.duplicate": 0.3},
    "in order": {
        "network.latency": {"kind": "gamma", "offset": 0.01, "shape": 2.0, "scale": 0.02},
        "network.order": "fifo",
    },
    "airtime": {"network.medium": {"kind": "bitrate", "bitrate": 20000.0}},
    "contention": {
        "network.medium": {"kind": "bitrate", "bitrate": 250000.0, "access": "csma"},
        "announce.jitter": 0.01,
    },
    "hosts": {"network.processing": {"sender": 0.002, "receiver": 0.001}},
    "token": {"protocol": {"kind": "sap", "schedule": {"kind": "token_ring"}}},
    "server": {"protocol": "server"},
    "flooding": {"announce.dissemination": "flooding"},
}


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize(
    "name", [*islice(NETWORKS, 2), *(pytest.param(name, marks=pytest.mark.slow) for name in islice(NETWORKS, 2, None))]
)
def test_a_message_fault_loses_the_message_with_its_number(name):
    """Up to it the run is the same; its copies are numbered alike by the fault and by `copies`."""
    scenario = SMALL.with_({"horizon": 1.0, "announce.trigger": "revision", **NETWORKS[name]})
    before = copies(run(scenario, 2))
    assert [copy.number for copy in before] == [*range(1, len(before) + 1)]
    for copy in [copy for copy in before if copy.arrival != LOST][2:40:12]:
        result = run(scenario.with_({"fault": [MessageFault(messages=(copy.number,))]}), 2)
        after = copies(result)
        assert after[copy.number - 1].arrival == LOST
        assert after[copy.number - 1][:4] == copy[:4]
        assert [(one.src, one.dst, one.sent) for one in after[: copy.number]] == [
            (one.src, one.dst, one.sent) for one in before[: copy.number]
        ]


def test_a_message_fault_delays_the_message_with_its_number():
    before = copies(run(SMALL, 2))
    late = copies(run(SMALL.with_({"fault": [MessageFault(messages=(4,), delay=0.25)]}), 2))
    assert late[3].arrival == before[3].arrival + 250_000_000
    assert late[:3] == before[:3]


def test_messages_are_counted_from_the_start_of_the_fault():
    scenario = SMALL.with_({"announce.trigger": "revision"})
    before = copies(run(scenario, 2))
    first = next(copy for copy in before if copy.sent >= 500_000_000)
    after = copies(run(scenario.with_({"fault": [MessageFault(start=0.5, messages=(1,))]}), 2))
    assert next(copy.number for copy in after if copy.arrival == LOST) == first.number


def without_copies(result):
    """Return the events of a run without those of copies and of the fault that makes them."""
    return [
        event._replace(arrival=tuple(event.fates())) if isinstance(event, Broadcast) else event
        for event in result.trace
        if getattr(event, "transmission", 0) < FIRST_COPY
        and not isinstance(event, FaultStarted | FaultEnded | MessageCounts)
    ]


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize(
    "name", ["plain", *(pytest.param(name, marks=pytest.mark.slow) for name in NETWORKS if name != "plain")]
)
def test_a_copy_of_a_record_changes_nothing_else(name):
    """Its second arrival is ignored, whether the record is still the newest or not; no number or draw is another."""
    scenario = SMALL.with_({"horizon": 1.0, "announce.trigger": "revision", **NETWORKS[name]})
    plain = run(scenario, 2)
    arrived = [copy for copy in copies(plain) if copy.arrival != LOST and copy.seq is not None]
    for copy in arrived[2:40:12]:
        for delay in (0.005, 0.4):
            fault = MessageFault(messages=(copy.number,), delay=delay, duplicate=True)
            twice = run(scenario.with_({"fault": [fault]}), 2)
            assert without_copies(twice) == without_copies(plain)
            (second,) = [event for event in twice.trace if getattr(event, "transmission", 0) >= FIRST_COPY]
            assert [*second.fates()] == [(copy.dst, copy.arrival + nanoseconds(delay))]
            assert copies(twice) == copies(plain)
            counts, before = messages(twice), messages(plain)
            assert counts.sent == before.sent + 1 == counts.delivered + counts.lost + counts.in_flight


def test_a_copy_of_a_message_wakes_its_receiver_again():
    clock = Clock()
    faults, heard = FaultState(), []
    network = Network(clock, nx.complete_graph(2), Links(latency=0.1), fault_state=faults)
    inject([MessageFault(messages=(1,), delay=0.3, duplicate=True)], clock, network)

    def listen():
        while True:
            yield network.inbox(1).arrival()
            heard.extend((seconds(clock.now), message.body) for message in network.inbox(1).drain())

    def speak():
        yield clock.timeout(nanoseconds(0.5))
        network.send(0, 1, "first")
        network.send(0, 1, "second")

    clock.process(listen())
    clock.process(speak())
    clock.run(until=nanoseconds(2.0))
    assert heard == [(0.6, "first"), (0.6, "second"), (0.9, "first")]


def test_a_copy_should_arrive():
    with pytest.raises(ValueError, match="duplicate: a copy should arrive: set a finite delay"):
        MessageFault(messages=(1,), duplicate=True)
    assert MessageFault(messages=(2, 1), delay=0.1, duplicate=True).label == "twice: message 1, 2"


@pytest.mark.slow
@pytest.mark.parametrize(
    "latency", [0.1, {"kind": "gamma", "shape": 0.5, "scale": 0.5}], ids=["in order", "overtaking"]
)
def test_a_message_is_read_in_time_if_its_receiver_looks_before_a_newer_one_arrives(latency):
    result = run(SMALL.with_({"announce.trigger": "revision", "network.latency": latency}), 2)
    sent, seen = copies(result), looks(result)
    expected = {}
    for copy in sent:
        newer = [c.arrival for c in sent if (c.src, c.dst) == (copy.src, copy.dst) and c.seq > copy.seq]
        times = [t for t in seen[copy.dst] if t <= min(newer, default=10**12)]
        expected[copy] = any(copy.arrival <= t for t in times), max(times, default=-inf)
    assert {one.copy: (one.is_read(), one.last_look()) for one in readings(sent, seen)} == expected
    assert 0 < sum(is_read for is_read, _ in expected.values()) < len(sent)


# All choices of lost messages.

TOKEN = {"kind": "sap", "schedule": {"kind": "token_ring"}}
MIXED = {"fates": ("lost", "late", "twice"), "delay": 0.3}


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("protocol", "horizon", "choices"),
    [(TOKEN, 0.5, MIXED), ("best_response", 1.0, {}), ("best_response", 1.0, {"delay": 0.25})],
    ids=["mixed", "lost", "late"],
)
def test_no_choice_of_one_message_is_left_out(protocol, horizon, choices):
    """The quickest case has all kinds of fates, some that matter, some that do not, and some that are symmetric."""
    table = _compare_with_all(protocol, 1, horizon, **choices)
    assert table.skipped > 0
    assert (table.symmetric > 0, len(table.fatal) > 0) == (choices == MIXED,) * 2


@pytest.mark.whole
@pytest.mark.parametrize(
    ("protocol", "most", "choices"),
    [
        ("sap", 2, {}),
        ("cbaa", 2, {}),
        ("fictitious_play", 2, {}),
        ("fictitious_play", 2, {"delay": 0.25}),
        (TOKEN, 2, {"fates": ("twice",), "delay": 0.25}),
        (TOKEN, 1, MIXED),
        ("server", 1, MIXED),
        ("best_response", 2, MIXED),
    ],
)
def test_no_choice_of_several_messages_is_left_out(protocol, most, choices):
    table = _compare_with_all(protocol, most, **choices)
    assert table.skipped > 0
    assert (table.symmetric > 0) == (choices == MIXED)


def _compare_with_all(protocol, most, horizon=1.0, **choices):
    scenario = SMALL.with_({"protocol": protocol, "horizon": horizon})
    prop = "crowded at most 0.4 in total"
    told: list[None] = []
    table = fatal_losses(scenario, prop, seeds=[1], most=most, jobs=1, on_run=lambda: told.append(None), **choices)
    assert len(told) == table.runs
    every = fatal_losses(scenario, prop, seeds=[1], most=most, jobs=1, prune=False, **choices)
    assert _numbers(table) == _numbers(every)
    if most == 1:
        assert table.runs + table.skipped + table.symmetric == every.runs
    assert table.runs < every.runs
    return table


def _numbers(table):
    return sorted((tuple(copy.number for copy in one.messages), one.fates, one.verdict) for one in table.fatal)


@pytest.mark.whole
def test_a_choice_that_matters_is_missed_if_a_late_message_is_taken_for_a_lost_one():
    """The control: with wrong times of the last looks, the table is another."""
    scenario = SMALL.with_({"protocol": "fictitious_play"})
    prop = "crowded at most 0.4 in total"
    every = fatal_losses(scenario, prop, seeds=[1], jobs=1, prune=False, **MIXED)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ReadingTime, "last_look", lambda reading: -inf)
        wrong = fatal_losses(scenario, prop, seeds=[1], jobs=1, **MIXED)
    assert _numbers(wrong) != _numbers(every)


@pytest.mark.whole
def test_the_table_of_one_lost_message_of_four_pursuers():
    """Values of an independent loop: one message costs best_response its agreement, and none of local_min matters."""
    scenario = Scenario(
        team=Team(count=4),
        network=Links(latency=0.1),
        announce=Announcements(start="known", trigger="change"),
        protocol="best_response",
    )
    prop = "crowded at most 1.5 in total"
    table = fatal_losses(scenario, prop, seeds=[1], jobs=1)
    (fatal,) = table.fatal
    assert (table.messages, fatal.messages[0].number) == ({1: 9}, 5)
    broken = run(scenario.with_({"fault": fatal.faults}), 1)
    assert judge(prop, broken) == fatal.verdict
    other = fatal_losses(scenario.with_({"protocol": "local_min"}), prop, seeds=[1], most=2, jobs=1)
    assert other.text() == f"no violation with at most 2 lost messages ({other.runs} runs, seed 1)"


def test_a_table_that_would_be_too_long_is_refused():
    with pytest.raises(ValueError, match="choices of 1 messages, more than the limit of 5 runs"):
        fatal_losses(SMALL, "crowded at most 0.4 in total", limit=5, jobs=1)


@pytest.mark.slow
def test_the_limit_of_a_table_is_that_of_each_seed():
    small = SMALL.with_({"horizon": 0.3})
    most = max(fatal_losses(small, "crowded at most 0.1 in total", seeds=[seed], jobs=1).runs for seed in (1, 2))
    both = fatal_losses(small, "crowded at most 0.1 in total", seeds=[1, 2], limit=most, jobs=1)
    assert both.runs > most


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"most": 0}, "most should be at least 1"),
        ({"seeds": []}, "seeds should not be empty"),
        ({"seeds": 3}, "seeds should be a list of seeds"),
        ({"seeds": [-3]}, "the seed should be at least 0, got -3"),
        ({"delay": 0.0}, "delay should be positive"),
        ({"delay": -1.0}, "delay should be positive"),
        ({"delay": nan}, "delay should be positive"),
        ({"fates": ["lots"]}, "fates should be lost, late, twice"),
        ({"fates": "lost"}, "fates should be a list of lost, late, twice"),
        ({"fates": ["lost", "late"]}, "'late' needs a delay, in s"),
    ],
)
def test_bad_choices_are_told(choices, message):
    with pytest.raises(ValueError, match=message):
        fatal_losses(SMALL, "crowded at most 0.4 in total", **choices)


# Cases.


@pytest.mark.slow
def test_each_feature_makes_a_valid_scenario_and_is_in_half_of_the_cases():
    number = 200
    cases = [drawn(FEATURES, stream(k, "break"), SMALL) for k in range(number)]
    for name in FEATURES:
        share, error = sum(name in case for case in cases) / number, 0.5 / np.sqrt(number)
        assert abs(share - 0.5) < 4 * error, (name, share)
        changed = [case[name] for case in cases if name in case]
        assert applied(SMALL.with_({"team.count": 12}), {name: changed[0]}) != SMALL


def test_a_case_with_a_parent_keeps_most_of_it():
    parent = drawn(FEATURES, stream(0, "break"), SMALL)
    children = [drawn(FEATURES, stream(k, "break"), SMALL, parent) for k in range(1, 50)]
    kept = [sum(child.get(name) == parent.get(name) for name in FEATURES) / len(FEATURES) for child in children]
    assert 0.6 < np.mean(kept) < 0.9


# Shrinking.


class Verdict:
    """A judgement of a case that needs some features."""

    at = 0.5

    def __init__(self, holds):
        self.holds = holds


def test_the_smallest_case_has_only_what_the_violation_needs():
    case = {
        "latency": {"network.latency": 0.123},
        "loss": {"network.loss": 0.3},
        "heartbeat": {"announce.heartbeat": 0.34},
        "silent start": {"announce.start": "silent"},
    }
    asked = []

    def judged(scenario, seed):
        asked.append(scenario)
        slow = getattr(scenario.network.latency, "value", 0.0) > 0.11
        return CaseRun(Verdict(holds=not (slow and scenario.announce.heartbeat == 0.34)), [])

    best, runs = shrunk(SMALL, Tried(case, 1, Verdict(holds=False)), judged)
    assert {name: changes for name, changes in best.case.items() if name in FEATURES} == {
        "latency": {"network.latency": 0.12},
        "heartbeat": {"announce.heartbeat": 0.34},
    }
    assert runs == len(asked) <= 60
    assert len({repr(one) for one in asked}) == runs
    assert shrunk(SMALL, Tried(case, 1, Verdict(holds=False)), judged, budget=3)[1] == 3


def test_a_feature_that_another_one_overrides_is_left_out_without_a_run():
    case = {"latency": {"network.latency": 0.5}, "random latency": {"network.latency": 0.3}}
    best, runs = shrunk(SMALL, Tried(case, 1, Verdict(holds=False)), lambda *_: CaseRun(Verdict(holds=True), []))
    assert best.case == {"random latency": {"network.latency": 0.3}}
    assert runs == 3, "without any latency, and with two shorter horizons"


@pytest.mark.slow
def test_a_case_that_is_broken_otherwise_is_not_smaller():
    """The search has found an exception; without the latency, the run only violates the property."""
    case = {"latency": {"network.latency": 0.5}}
    failed = Tried(case, 1, Verdict(holds=False), "KeyError: 3")
    for other, is_kept in (("", True), ("ValueError: 3", True), ("KeyError: 4", False)):
        told = CaseRun(Verdict(holds=False), [], failure=other)
        best, _ = shrunk(SMALL, failed, lambda *_, told=told: told)
        assert ("latency" in best.case) == is_kept


# The search.


def talks(times):
    """Return a rule that chases if no one nearer is known to chase, and falls silent after some announcements."""

    def rule(me):
        for k in count():
            rivals = me.believed_chasers(1)
            me.assign(1 if me.capture_time(1) <= min(rivals.values(), default=inf) else 0)
            if k < times:
                me.announce()
            yield me.sleep(0.1)

    return rule


def test_a_search_keeps_the_cases_that_it_has_tried_in_their_order():
    scenario = Scenario(team=Team(count=2), horizon=0.02, record={"trajectory": 0})
    search = find_violation(scenario, "crowded at most 0.0199 in total", runs=4, seed=1, jobs=1, features=["latency"])
    assert (len(search.tried), search.runs, search.violation) == (4, 4, None)
    assert [tried.seed for tried in search.tried] == sorted({tried.seed for tried in search.tried})
    assert all(tried.verdict.margin > 0.0 and not tried.failure for tried in search.tried)
    assert sum("latency" in tried.case for tried in search.tried) == search.featured["latency"]


@pytest.mark.whole
@pytest.mark.parametrize(("times", "is_found"), [(3, True), (1000, False)])
def test_a_rule_that_falls_silent_is_found(times, is_found):
    scenario = Scenario(
        team=Team(count=4, speeds=2.5),
        protocol=talks(times),
        horizon=4.0,
        announce=Announcements(trigger="revision", belief_timeout=0.5),
    )
    features = ["latency", "silent start"]
    prop = "crowded at most 1.5 in total against centralised"
    search = find_violation(scenario, prop, runs=100 if is_found else 30, seed=1, jobs=1, features=features)
    assert (search.violation is not None) == is_found


def raises(me):
    """Fail as soon as a teammate was not heard for 0.9 s, which only happens without heartbeats."""
    while True:
        me.assign(me.capture_time() <= min(me.believed_chasers().values(), default=inf))
        me.announce()
        if any(belief.age > 0.9 for belief in me.beliefs().values()):
            raise ZeroDivisionError("planted\nin a rule")
        yield me.sleep(0.1)


def hangs(me):
    yield me.sleep(0.5)
    while me.id == 0:
        pass


FAILING = SMALL.with_({"announce.trigger": "revision"})


@pytest.mark.whole
def test_a_run_that_raises_is_a_violation_and_is_made_small_as_such():
    scenario = FAILING.with_({"protocol": raises, "horizon": 4.0})
    features = ["latency", "duplicates", "changes only", "chaser crash"]
    search = find_violation(scenario, IDLE, runs=20, seed=1, jobs=1, features=features)
    violation = search.violation
    assert violation.failure == "ZeroDivisionError: planted"
    assert violation.case.keys() - {"horizon", "team"} in ({"changes only"}, {"chaser crash"})
    assert 0.2 <= violation.scenario.horizon < 4.0
    with pytest.raises(ZeroDivisionError, match="planted"):
        run(violation.scenario, violation.seed)
    verdicts = violation.protocols(jobs=1)
    assert next(iter(verdicts.items())) == ("raises", "ZeroDivisionError: planted")
    assert isinstance(verdicts["sap"], Judgement)
    calm = find_violation(scenario, IDLE, runs=20, seed=1, jobs=1, features=["duplicates"])
    assert calm.violation is None


@pytest.mark.slow
def test_a_lost_message_that_makes_a_run_raise_is_fatal():
    scenario = FAILING.with_(
        {"protocol": raises, "horizon": 1.6, "announce.trigger": "both", "announce.heartbeat": 0.6}
    )
    table = fatal_losses(scenario, IDLE.replace("2 in", "0.5 in"), seeds=[1], jobs=1)
    assert table.fatal
    assert {fatal.failure for fatal in table.fatal} == {"ZeroDivisionError: planted"}
    assert "seed 1: fails (ZeroDivisionError: planted) if these are lost:" in table.text()
    with pytest.raises(ValueError, match="seed 1: the run fails without any loss: ZeroDivisionError: planted"):
        fatal_losses(scenario.with_({"announce.trigger": "change"}), IDLE.replace("2 in", "0.5 in"), seeds=[1], jobs=1)


@pytest.mark.whole
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_run_that_never_ends_is_a_violation_if_there_is_a_limit(jobs):
    features = {"runs": 2, "features": ["latency"], "shrinking": 1, "jobs": jobs}
    search = find_violation(FAILING.with_({"protocol": hangs}), SHORT, **features, timeout=1.0)
    assert search.violation.failure.startswith("TimedOut")
    with pytest.raises(TimedOut), within(2.0):
        find_violation(FAILING.with_({"protocol": hangs}), SHORT, **features | {"jobs": 1})


@pytest.mark.whole
def test_what_no_protocol_can_win_is_not_reported():
    """Only the last pursuer is fast enough, and it is down: the reference is idle, too."""
    scenario = Scenario(
        team=Team(count=4, speeds=(0.5, 0.5, 0.5, 2.0)),
        horizon=6.0,
        fault=(Crash(node=3, start=0.2),),
        network=Links(latency=0.1),
    )
    quick = {"runs": 16, "seed": 1, "jobs": 1, "features": ["heartbeat", "loss"]}
    assert find_violation(scenario, IDLE, **quick).violation is None
    control = find_violation(scenario, "idle at most 2 in total", **quick)
    assert control.violation is not None


@pytest.mark.whole
def test_the_crash_of_the_chaser_is_found_and_made_small():
    scenario = load(SCENARIOS / "relay.toml", ["network.latency=0.1", "announce.heartbeat=0.34"])
    search = find_violation(scenario.with_({"protocol": "cbaa"}), IDLE, runs=100, seed=1, jobs=1)
    violation = search.violation
    added = {name for name in violation.case if name not in {"team", "horizon"}}
    assert "chaser crash" in added
    assert len(added) <= 2
    assert violation.shrunk <= 60
    again = judge(IDLE, run(violation.scenario, violation.seed))
    assert again == violation.verdict
    assert not again.holds
    verdicts = violation.protocols()
    assert verdicts["cbaa"] == again
    assert "centralised" not in verdicts


@pytest.mark.whole
def test_a_token_that_is_stuck_is_found():
    token = {"kind": "sap", "schedule": {"kind": "token_ring", "attempts": 1}}
    scenario = Scenario(team=Team(count=5), protocol=token, network=Links(latency=0.1), horizon=10.0)
    search = find_violation(scenario, "crowded at most 3 in total against centralised", runs=60, seed=1, jobs=1)
    assert search.violation is not None


def is_first(me, times):
    """Return whether a pursuer would be in time, and before all others with these capture times, s."""
    return me.capture_time() < me.time_left() and all(me.capture_time() <= time for time in times)


def deaf_to_one(me):
    """Chase if no believed chaser is faster, but for pursuer 2, whom nobody heeds."""
    while True:
        yield me.sleep(0.1 * me.rng.uniform(0.5, 1.5))
        me.assign(is_first(me, [time for j, time in me.believed_chasers().items() if j != 2]))
        me.announce()


def never_forgets(me):
    """Chase if no chaser is faster, and take a pursuer for one until it says that it stays."""
    chasers = {}
    while True:
        yield me.sleep(0.1 * me.rng.uniform(0.5, 1.5))
        for j, belief in me.beliefs().items():
            chasers |= {j: belief.capture_time if belief.active else inf}
        me.assign(is_first(me, chasers.values()))
        me.announce()


def sends_its_token_once(me):
    """Decide while it has the token, which is lost with the first holder that crashes."""
    if me.id == 0:
        me.send(1, "token")
    while True:
        yield me.arrival()
        me.mail()
        yield me.sleep(0.02)
        me.assign(is_first(me, me.believed_chasers().values()))
        me.announce()
        me.send((me.id + 1) % me.team_size, "token")


def obeys_odd_orders(me):
    """Report to pursuer 0, and obey every second of its orders, of which there is one for each new chaser."""
    times, orders, told = {}, 0, None
    while True:
        yield me.sleep(0.1)
        if me.id:
            me.send(0, me.capture_time())
        for message in me.mail():
            if message.src:
                times[message.src] = message.body
            elif (orders := orders + 1) % 2:
                me.assign(message.body == me.id)
        if me.id == 0 and len(times) == me.team_size - 1:
            times[0] = me.capture_time()
            best = min(times, key=times.get)
            me.assign(best == 0)
            if best != told:
                me.send(None, best)
                told = best


@pytest.mark.whole
@pytest.mark.parametrize(
    ("rule", "prop", "needs"),
    [
        (deaf_to_one, "crowded never longer than 2 against local_min", set()),
        (never_forgets, "idle never longer than 2 against centralised", {"chaser crash"}),
        (sends_its_token_once, "idle leads to not idle within 2 against centralised", {"chaser crash"}),
        (obeys_odd_orders, "idle never longer than 2 against centralised", {"chaser crash"}),
    ],
)
def test_a_planted_fault_is_found_and_nothing_else_is_left(rule, prop, needs):
    """The first is seen in any game; the others need that the chaser crashes."""
    scenario = Scenario(team=Team(count=5, speeds=2.5), horizon=12.0, network=Links(latency=0.05), protocol=rule)
    violation = find_violation(scenario, prop, runs=100, seed=1, jobs=1).violation
    assert {*violation.case} - {"team", "horizon"} == needs
    sound = judge(prop, run(violation.scenario.with_({"protocol": "sap"}), violation.seed))
    assert sound.holds


def toggles(me):
    """Pursuer 0 tells all but the best one to change what they do: told twice, one chases again."""
    if me.id:
        me.send(0, me.capture_time())
    times = {0: me.capture_time()}
    while True:
        yield me.arrival()
        for message in me.mail():
            if me.id:
                me.assign(not me.action)
            else:
                times[message.src] = message.body
        if me.id == 0 and len(times) == me.team_size:
            best = min(times, key=times.get)
            me.assign(best == 0)
            for j in times.keys() - {0, best}:
                me.send(j, "change")


@pytest.mark.whole
def test_a_message_that_must_not_come_twice_is_found():
    """Two reports and an order: without a report no order comes, a repeated one makes another, late ones do no harm."""
    scenario = Scenario(
        team=Team(count=3, speeds=2.5),
        horizon=2.0,
        network=Links(latency=0.05),
        announce=Announcements(start="known", trigger="change"),
        protocol=toggles,
    )
    table = fatal_losses(scenario, "crowded at most 1 in total", fates=("lost", "late", "twice"), delay=0.3, jobs=1)
    fatal = [(one.messages[0].number, one.messages[0].src, *one.fates) for one in table.fatal]
    assert fatal == [(number, src, fate) for number, src in enumerate((1, 2, 0), start=1) for fate in ("lost", "twice")]
    assert table.runs == 10, "the run without faults, and each message with each fate"


QUICK = {"runs": 20, "seed": 3, "features": ["latency", "loss", "chaser crash"]}


def log_of(file, text=SHORT):
    return CaseLog(file, property_of(text))


def test_two_searches_that_found_the_same_are_equal_however_long_they_took():
    assert Search(runs=2, seconds=1.0) == Search(runs=2, seconds=2.0) != Search(runs=3, seconds=2.0)


@pytest.mark.whole
def test_a_search_does_not_depend_on_what_was_run_before(tmp_path):
    file = tmp_path / "cases.jsonl"
    first = find_violation(SMALL, SHORT, **QUICK, jobs=1, log=log_of(file))
    lines = file.read_text().splitlines()
    assert len(lines) == 20
    file.write_text("\n".join([*lines[:7], lines[7][:40]]))
    again = find_violation(SMALL, SHORT, **QUICK, jobs=1, log=log_of(file))
    assert again == first
    assert len(log_of(file)) == 20
    assert len(log_of(file, IDLE)) == 0


@pytest.mark.slow
def test_a_budget_counts_the_time_of_earlier_runs(tmp_path):
    """A greater one goes on where a smaller one ended; the runs in the log are not made again."""
    file = tmp_path / "cases.jsonl"
    quick = {"seed": 3, "features": ["latency"], "jobs": 1}
    first = find_violation(SMALL, SHORT, **quick, runs=16, log=log_of(file))
    assert first.seconds > 0.0
    stopped = find_violation(SMALL, SHORT, **quick, runs=32, budget=0.5 * first.seconds, log=log_of(file))
    assert (stopped.runs, stopped.stopped) == (16, True)
    assert stopped.seconds == pytest.approx(first.seconds)
    further = find_violation(SMALL, SHORT, **quick, runs=32, budget=1e3, log=log_of(file))
    assert (further.runs, further.stopped) == (32, False)
    assert further.margins[:16] == first.margins


@pytest.mark.slow
def test_no_log_is_written_through_a_symbolic_link(tmp_path, monkeypatch):
    """Also if it has become one after the question: the second time, it is asked as if there were none."""
    target, link = tmp_path / "target", tmp_path / "cases.jsonl"
    target.write_text("kept")
    link.symlink_to(target)
    with pytest.raises(OSError, match="is a symbolic link, which is not followed: remove it"):
        log_of(link)
    monkeypatch.setattr(Path, "is_symlink", lambda _: False)
    with pytest.raises(OSError, match="symbolic links"):
        log_of(link).add(SMALL, 1, CaseRun(FAILED, []))
    assert target.read_text() == "kept"


def test_a_log_knows_runs_by_scenario_seed_and_the_code_of_the_user(tmp_path):
    log = log_of(tmp_path / "cases.jsonl")
    told = CaseRun(Judgement(1.0, 0.9, 0.0, 0.0), ["a fault began"], 0.1)
    log.add(SMALL, 3, told)
    assert log_of(tmp_path / "cases.jsonl").find(SMALL.with_({"name": "another"}), 3) == told
    for other, seed in ((SMALL, 4), (SMALL.with_({"team.count": 4}), 3), (SMALL.with_({"protocol": talks(3)}), 3)):
        assert log.find(other, seed) is None
    always = CaseLog(tmp_path / "cases.jsonl", Always(condition=first_pursuer))
    assert len(always) == 0
    always.add(SMALL, 3, told)
    assert len(CaseLog(tmp_path / "cases.jsonl", Always(condition=first_pursuer))) == 1


def first_pursuer(result):
    return [(0.0, 1.0)]


def test_a_run_is_in_the_log_as_soon_as_it_has_ended(tmp_path, monkeypatch):
    """Also if a later one of its batch is interrupted, or cannot be judged; models among the changes have a text."""

    def interrupted(*_):
        yield 1, Outcome("ok", CaseRun(Judgement(1.0, 0.9, 0.0), []))
        yield 0, Outcome("error", error=JudgementError("property", "is unknown"))

    monkeypatch.setattr(judging, "drive", interrupted)
    case = {"vary": {"network.latency": Constant(value=0.2), "team.count": np.int64(3)}}
    cases = [Planned(case, seed, SMALL) for seed in (1, 2)]
    with pytest.raises(JudgementError):
        CaseJudge(property_of(SHORT), InProcess(), log_of(tmp_path / "cases.jsonl")).judge_all(cases)
    (line,) = (tmp_path / "cases.jsonl").read_text().splitlines()
    told = json.loads(line)
    assert told["seed"] == 2
    assert told["case"] == {"vary": {"network.latency": {"kind": "constant", "value": 0.2}, "team.count": 3}}
    assert case_text(case) == 'network.latency = { kind = "constant", value = 0.2 }, team.count = 3'


@pytest.mark.parametrize(("limit", "is_kept"), [(0.001, True), (0.0015, False), (None, False)])
def test_a_run_that_took_too_long_is_made_again_if_the_limit_is_another(tmp_path, monkeypatch, limit, is_kept):
    """Another failure is that of the run, whatever its text."""
    with pytest.raises(TimedOut) as late, within(0.001):
        time.sleep(0.5)
    own = type("TimedOut", (RuntimeError,), {})("took longer than the rule allows")
    outcomes = [Outcome("error", error=late.value), Outcome("error", error=own)]

    def judged(timeout):
        def drive(tasks, *_):
            return ((k, outcomes[tasks[k][1] - 1]) for k in range(len(tasks)))

        monkeypatch.setattr(judging, "drive", drive)
        workers = InProcess()
        workers.timeout = timeout
        judge_run = CaseJudge(property_of(SHORT), workers, log_of(tmp_path / "cases.jsonl"))
        return [judge_run(SMALL, seed).failure for seed in (1, 2)]

    too_long, failed = judged(0.001)
    assert too_long.startswith("TimedOut: took longer than 0.001 s")
    outcomes[:] = [Outcome("ok", CaseRun(Judgement(1.0, 0.9, 0.0), []))] * 2
    assert judged(limit) == [too_long if is_kept else "", failed]


@pytest.mark.parametrize(("module", "function"), [(judging, "seen_in"), (losses, "copies")])
def test_an_exception_after_a_run_is_not_its_protocols(module, function, monkeypatch):
    monkeypatch.setattr(module, function, lambda _: {}["missing"])
    prop = property_of("crowded at most 1 in total")
    judge_run = (
        partial(losses._report, prop, ("lost",), 0, True) if module is losses else partial(judging._case_run, prop)
    )
    with pytest.raises(JudgementError, match="cannot be judged: KeyError: 'missing'"):
        judge_run(history())


@pytest.mark.whole
def test_a_search_tells_what_it_has_seen():
    search = find_violation(SMALL, SHORT, **QUICK, jobs=1)
    assert search.featured.keys() == {"latency", "loss", "chaser crash"}
    assert 0 < search.seen["a message was lost"] <= search.featured["loss"] + search.featured["chaser crash"]
    quiet = find_violation(SMALL, SHORT, runs=4, vary={"seed": [1]}, features=[], jobs=1)
    assert "never seen: a fault began" in quiet.warnings(property_of(IDLE))


@pytest.mark.slow
def test_what_is_seen_in_a_run():
    busy = SMALL.with_({"horizon": 8.0, "team.count": 5, "announce.trigger": "revision"})
    scenario = busy.with_({"fault": [{"kind": "chaser_crash", "start": 1.0}]})
    assert {"a fault began", "a pursuer that chased crashed", "a message was lost"} <= {*seen_in(run(scenario, 3))}
    calm = seen_in(run(busy, 3))
    assert not {"a fault began", "a pursuer that chased crashed", "a message was lost"} & {*calm}
    assert {*calm} <= {*SIGHTINGS}


@pytest.mark.parametrize(("node", "t", "chases"), [(0, 300, True), (0, 500, False), (1, 500, True), (2, 500, False)])
def test_a_pursuer_whose_evader_was_captured_does_not_chase_until_it_decides(node, t, chases):
    """By hand, 0 captures at 400 ms and decides no more; 1 chases the other evader, and 2 has stopped."""
    result = pair()
    crash = FaultStarted(t * MS, Crash(node=node, start=t / 1000))
    events = [event for event in result.trace if event != Decided(400 * MS, 0, 2)]
    result.trace.events[:] = sorted([*events, crash], key=lambda event: event.t)
    assert ("a pursuer that chased crashed" in seen_in(result)) == chases


def test_margins_have_their_unit():
    """A time has seconds, and a number of pursuers none."""
    told = Tried({}, 3, Judgement(-1.5, 3.5, 0.0))
    fatal = FatalLosses(3, (), (), inf, told.verdict)
    for text, unit in (("idle at most 2 in total", " s"), ("always active <= 2", "")):
        prop = property_of(text)
        nothing = search_text(Search(runs=1, tried=[told]), prop)
        assert nothing.startswith(f"no violation in 1 case; the least margin is -1.5{unit}\n")
        assert f"margin -1.5{unit} if" in LossTable(1, (3,), unit=prop.unit, fatal=[fatal]).text()
    table = fatal_losses(SMALL, "crowded at most 1.9 in total", seeds=[1], jobs=1)
    assert table.unit == "s"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"prop": "always active >= 0"}, "says nothing"),
        ({"prop": "idle at most 1 in total against sap"}, "its own reference"),
        ({"prop": "idle at most 1 in total against sapp"}, "there is no protocol 'sapp'"),
        ({"prop": "idel at most 1 in total"}, "there is no quantity 'idel'"),
        ({"features": ["latencies"]}, "features: there is no 'latencies', did you mean .*; there are team, latency"),
        ({"features": []}, "a search needs a feature"),
        ({"vary": {"network.loss": [0.1, 1.5]}}, "network.loss"),
        ({"vary": {"network.los": [0.1]}}, "network.los"),
    ],
)
def test_bad_use_is_told(arguments, message):
    with pytest.raises(ValueError, match=message):
        find_violation(SMALL, **{"prop": "idle at most 1 in total"} | arguments)


def test_the_changes_of_a_case_are_one_line_in_the_form_of_a_file():
    case = {"far": {"network.range": [1.0, 2.5], "fault": [{"kind": "crash", "node": 1}]}, "slow": {"team.count": 3}}
    assert case_text(case) == 'network.range = [1.0, 2.5], fault = [{ kind = "crash", node = 1 }]; team.count = 3'
    assert case_text({}) == "nothing changed"


def test_a_protocol_of_a_user_is_the_first_of_those_that_are_compared(monkeypatch):
    """The run of the violation is not repeated."""

    def rule(me):
        yield me.sleep(1.0)

    scenario, verdict, limits = Scenario(protocol=rule), Judgement(-1.0, 2.0, 0.5, None), []
    monkeypatch.setattr("desim.study.breaking.search.PROTOCOLS", SimpleNamespace(choices=dict))
    monkeypatch.setattr("desim.study.breaking.search.workers_for", lambda *given: limits.append(given) or InProcess())
    violation = Violation(scenario, 1, property_of(SHORT), verdict, case={}, first={}, searched=1, shrunk=0)
    assert violation.protocols(1, timeout=2.5) == {scenario.protocol_name: verdict}
    assert limits == [(1, 0, 2.5)], "the others have the time that the search gave them"


def test_a_search_is_about_a_scenario():
    with pytest.raises(TypeError, match="find_violation"):
        find_violation("relay.toml", IDLE)
    with pytest.raises(TypeError, match="fatal_losses"):
        fatal_losses(run(SMALL, 1), IDLE)


@pytest.mark.parametrize(("runs", "is_refused"), [(1, True), (2, False)])
def test_a_search_ends_where_hardly_any_case_makes_a_valid_scenario(runs, is_refused, monkeypatch):
    """Sixteen cases for each run may make none."""
    monkeypatch.setattr("desim.study.breaking.search.changed_or_none", lambda *_: None)
    cases = _Cases(SMALL, {"loss": FEATURES["loss"]}, 1, runs)
    assert cases.generation(16, []) == []
    if is_refused:
        with pytest.raises(ValueError, match="17 cases made no valid scenario, and 0 did"):
            cases.generation(1, [])
    else:
        assert cases.generation(16, []) == []
        assert cases.refused == 32


# What people read.

FOUND = {
    "team": {"team.count": 5},
    "crash": {"fault": {"kind": "crash", "node": 1, "memory": True, "start": 0.123, "end": 1.5}},
    "bursts": {"network.loss": {"kind": "gilbert_elliott", "share": 0.123, "burst": 0.5, "advance": "time"}},
    "range": {"network.range": inf},
    "horizon": {"horizon": 1.7},
}


def features():
    """Yield two cases of each feature, and cases with and without a parent."""
    for name, draw in FEATURES.items():
        cases = [{name: draw(np.random.default_rng(seed), SMALL)} for seed in (3, 4)]
        yield "\n".join(f"{name}: {case_text(case)}" for case in cases)
    parent = drawn(FEATURES, np.random.default_rng(1), SMALL)
    yield f"parent: {case_text(parent)}"
    yield f"child: {case_text(drawn(FEATURES, np.random.default_rng(2), SMALL, parent))}"


def smaller():
    """Yield the cases that are tried to make one smaller, the first that save most."""
    tried = Tried(FOUND, 1, Judgement(-0.5, 2.5, 0.4))
    for simplify in _simplifications(SMALL, tried):
        case = simplify(tried)
        yield "nothing to leave out" if case is None else case_text(case)
    for size in (1, 2, 3, 4):
        tried = tried._replace(case=dict([*FOUND.items()][:size]))
        cases = [simplify(tried) for simplify in islice(_simplifications(SMALL, tried), size + 2)]
        yield "\n".join(["nothing" if case is None else case_text(case) or "the scenario" for case in cases])


def searches():
    """Yield the texts of searches: nothing found and little seen, a violation, and an exception."""
    prop, against = property_of("idle at most 2 in total"), property_of(SHORT)
    judgement = Judgement(-0.4567, 3.4567, 1.25, 1.1)
    seen = Counter({sentence: k for k, sentence in enumerate(SIGHTINGS)})
    found = Violation(SMALL, 7, against, judgement, FOUND, FOUND, searched=12, shrunk=34)
    failed = replace(found, verdict=FAILED, failure="KeyError: 'x'", case={}, scenario=SMALL)
    tried = [Tried({}, 1, Judgement(2.0, 0.0, 0.0)), Tried({}, 2, Judgement(3.5, 0.0, 0.0))]
    yield search_text(
        Search(runs=2, refused=1234, tried=tried, stopped=True, featured=Counter({"loss": 1, "crash": 2})), prop
    )
    yield search_text(Search(found, runs=1200, seen=seen, tried=tried), against)
    yield search_text(Search(failed, runs=1, seen=seen), against)
    yield protocols_text({"sap": judgement, "cbba": Judgement(0.0, 2.0, 0.0), "cbaa": "ValueError: no"}, against)
    yield scenario_text(found, "a b.toml", "desim break a b.toml")
    yield command_for("run", "x.toml", SMALL, None)


def performed():
    """Yield the text of a search that is performed: what is found in the second case is made smaller."""
    short = SMALL.with_({"horizon": 0.5})
    chosen = {"features": ["loss", "crash", "heartbeat"], "vary": {"network.latency": [0.05, 0.2]}}
    search = find_violation(short, "idle at most 0.46 in total", runs=8, jobs=1, shrinking=8, **chosen)
    yield search_text(search, search.violation.prop)
    yield "\n".join(f"{tried.seed}: {case_text(tried.case)}: {tried.verdict.margin:.4g}" for tried in search.tried)


def seen():
    """Yield what is known of the messages of runs made by hand, and what is seen in these."""
    chased = Decided(690 * MS, 2, 1), FaultStarted(695 * MS, Crash(node=2, start=0.695))
    stayed = Decided(390 * MS, 0, 0), Decided(610 * MS, 0, 1)
    for result in (history(), pair(), history(*chased), history(*stayed)):
        sent, looked = copies(result), looks(result)
        yield "\n".join(
            [
                *(f"{copy}, arrives at {copy.arrival / SECOND:g} s, record {copy.seq}" for copy in sent),
                *(f"{pursuer} looks at {[t // MS for t in times]} ms" for pursuer, times in looked.items()),
                *(f"{reading.copy.number}: {reading.is_read()}" for reading in readings(sent, looked)),
                *seen_in(result),
            ]
        )


@pytest.mark.parametrize("part", [features, smaller, searches, performed, seen], ids=lambda part: part.__name__)
def test_cases_and_texts_are_golden(part):
    golden(f"breaking/{part.__name__}.txt", "\n\n".join(part()) + "\n")


CALLED = 'Traceback (most recent call last):\n  File "theirs.py", line 1, in rule\n    raise error\n'


@pytest.mark.parametrize(
    ("outcome", "timeout", "told"),
    [
        (Outcome("ok", value=1), None, ""),
        (Outcome("error", error=ValueError("no\nmore")), None, "ValueError: no"),
        (Outcome("error", error=TimedOut("took longer than 1 s")), 1.0, "TimedOut: took longer than 1 s"),
        (Outcome("crashed", traceback="ended by signal 9\n"), None, "RuntimeError: ended by signal 9"),
        (Outcome("error", traceback=f"{CALLED}theirs.OddError: boom: 1\n"), None, "OddError: boom: 1"),
        (Outcome("error", traceback=f"{CALLED}OddError: first: 1\nsecond\n"), None, "OddError: first: 1"),
    ],
)
def test_a_run_fails_by_its_exception_or_its_limit(outcome, timeout, told):
    assert failure_of(outcome, timeout) == told


@pytest.mark.parametrize("error", [TimedOut("late"), KeyboardInterrupt(), JudgementError("property", "is unknown")])
def test_what_is_no_failure_of_a_run_ends_the_search(error):
    with pytest.raises(type(error)):
        failure_of(Outcome("error", error=error), None)


class Theirs(type(SMALL.protocol)):
    """A protocol of a user, which may read whenever it wants."""


NEWS = {
    "a protocol of a user": {"protocol": Theirs()},
    "a protocol that is a function": {"protocol": lambda me: iter(())},
    "records that are forwarded": {"announce.dissemination": "flooding"},
    "judges": {"announce.trust": "plausible"},
    "order": {"network.order": "fifo"},
    "an evader that overhears": {"evader.strategy": "listener"},
}


@pytest.mark.parametrize("name", NEWS)
def test_old_news_that_nobody_reads_may_matter(name):
    prop = property_of(IDLE)
    assert hides_old_news(SMALL, prop)
    assert not hides_old_news(SMALL.with_(NEWS[name]), prop)


def test_old_news_matters_for_a_property_about_messages():
    assert not hides_old_news(SMALL, property_of("age at most 3 in total"))


def test_a_log_has_what_was_run_for_its_property_and_nothing_that_was_cut_off(tmp_path):
    file, prop, other = tmp_path / "cases.jsonl", property_of("idle at most 1 in total"), property_of("always idle")
    scenario = Scenario(horizon=0.1, team=Team(count=2))
    verdict, failed = Judgement(0.5, 0.5, 3), CaseRun(FAILED, [], 2.0, "of the rule")
    log = CaseLog(file, prop)
    assert len(log) == 0
    log.add(scenario, 1, CaseRun(verdict, ["lost"], 0.25), {"loss": {"network.loss": 0.5}})
    log.add(scenario, 2, failed)
    CaseLog(file, other).add(scenario, 1, CaseRun(FAILED, [], 1.0))
    with file.open("a") as lines:
        lines.write('{"search": "cut o')
    again = CaseLog(file, prop)
    assert len(again) == len(log) == 2
    for known in (log, again):
        assert known.find(scenario, 1) == CaseRun(verdict, ["lost"], 0.25)
        assert known.find(scenario, 2) == failed
        assert known.find(scenario, 3) is known.find(scenario.with_({"horizon": 0.2}), 1) is None
    again.add(scenario, 3, CaseRun(verdict, ["crash"], 0.5))
    assert [CaseLog(file, prop).find(scenario, seed).seen for seed in (1, 2, 3)] == [["lost"], [], ["crash"]]
    assert len(CaseLog(file, other)) == 1

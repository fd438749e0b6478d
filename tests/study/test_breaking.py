"""The search for what breaks a protocol."""

from itertools import count, islice
from math import inf

import numpy as np
import pytest

from desim import (
    Announcements,
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
from desim.kernel.core.events import LOST
from desim.kernel.core.seeds import stream
from desim.study.breaking.case_log import CaseLog
from desim.study.breaking.copies import copies, looks, read_in_time
from desim.study.breaking.features import FEATURES, applied, drawn
from desim.study.breaking.shrinking import Tried, shrunk
from desim.study.breaking.sightings import SIGHTINGS, seen_in
from scenarios.studies.study import SCENARIOS

IDLE = "idle at most 2 in total against centralised"
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


def test_a_message_is_read_in_time_if_its_receiver_looks_before_a_newer_one_arrives():
    result = run(SMALL.with_({"announce.trigger": "revision"}), 2)
    sent, seen = copies(result), looks(result)
    expected = {}
    for copy in sent:
        newer = [c.arrival for c in sent if (c.src, c.dst) == (copy.src, copy.dst) and c.seq > copy.seq]
        expected[copy] = any(copy.arrival <= t <= min(newer, default=10**12) for t in seen[copy.dst])
    assert dict(read_in_time(sent, seen)) == expected
    assert 0 < sum(expected.values()) < len(sent)


# All choices of lost messages.


@pytest.mark.parametrize("protocol", ["best_response"])
def test_no_choice_of_lost_messages_is_left_out(protocol):
    _compare_with_all(protocol, seeds=[1], most=1)


@pytest.mark.whole
@pytest.mark.parametrize("protocol", ["sap", "cbaa", "fictitious_play"])
def test_no_choice_of_two_lost_messages_is_left_out(protocol):
    _compare_with_all(protocol, seeds=[1], most=2)


def _compare_with_all(protocol, seeds, most):
    scenario = SMALL.with_({"protocol": protocol, "horizon": 1.0})
    prop = "crowded at most 0.4 in total"
    table = fatal_losses(scenario, prop, seeds=seeds, most=most, jobs=1)
    every = fatal_losses(scenario, prop, seeds=seeds, most=most, jobs=1, prune=False)
    assert sorted(one[:2] for one in table.fatal) == sorted(one[:2] for one in every.fatal)
    assert table.runs + table.skipped == every.runs if most == 1 else table.runs < every.runs


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
    broken = run(scenario.with_({"fault": [fatal.fault]}), 1)
    assert judge(prop, broken) == fatal.verdict
    other = fatal_losses(scenario.with_({"protocol": "local_min"}), prop, seeds=[1], most=2, jobs=1)
    assert other.text() == f"no violation with at most 2 lost messages ({other.runs} runs, seed 1)"


def test_a_table_that_would_be_too_long_is_refused():
    with pytest.raises(ValueError, match="choices of 1 messages, more than the limit of 5 runs"):
        fatal_losses(SMALL, "crowded at most 0.4 in total", limit=5, jobs=1)
    with pytest.raises(ValueError, match="most should be at least 1"):
        fatal_losses(SMALL, "crowded at most 0.4 in total", most=0)


# Cases.


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
        return Verdict(holds=not (slow and scenario.announce.heartbeat == 0.34))

    best, runs = shrunk(SMALL, Tried(case, 1, Verdict(holds=False)), judged)
    assert {name: changes for name, changes in best.case.items() if name in FEATURES} == {
        "latency": {"network.latency": 0.12},
        "heartbeat": {"announce.heartbeat": 0.34},
    }
    assert runs == len(asked) <= 60
    assert len({repr(one) for one in asked}) == runs
    assert shrunk(SMALL, Tried(case, 1, Verdict(holds=False)), judged, budget=3)[1] == 3


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


QUICK = {"runs": 20, "seed": 3, "features": ["latency", "loss", "chaser crash"]}


@pytest.mark.whole
def test_a_search_does_not_depend_on_what_was_run_before(tmp_path):
    file = tmp_path / "cases.jsonl"
    first = find_violation(SMALL, IDLE.replace("2 in", "1.9 in"), **QUICK, jobs=1, log=CaseLog(file, SMALL, "x"))
    lines = file.read_text().splitlines()
    assert len(lines) == 20
    file.write_text("\n".join([*lines[:7], lines[7][:40]]))
    again = find_violation(SMALL, IDLE.replace("2 in", "1.9 in"), **QUICK, jobs=1, log=CaseLog(file, SMALL, "x"))
    assert again == first
    assert len(CaseLog(file, SMALL, "x")) == 20
    assert len(CaseLog(file, SMALL, "y")) == 0
    assert len(CaseLog(file, SMALL.with_({"team.count": 4}), "x")) == 0


@pytest.mark.whole
def test_a_search_tells_what_it_has_seen():
    search = find_violation(SMALL, IDLE.replace("2 in", "1.9 in"), **QUICK, jobs=1)
    assert search.featured.keys() == {"latency", "loss", "chaser crash"}
    assert 0 < search.seen["a message was lost"] <= search.featured["loss"] + search.featured["chaser crash"]
    quiet = find_violation(SMALL, IDLE.replace("2 in", "1.9 in"), runs=4, vary={"seed": [1]}, features=[], jobs=1)
    assert "never seen: a fault began" in quiet.warnings(quiet_property())


def quiet_property():
    from desim.scenario.properties import property_of

    return property_of(IDLE)


def test_what_is_seen_in_a_run():
    busy = SMALL.with_({"horizon": 8.0, "team.count": 5, "announce.trigger": "revision"})
    scenario = busy.with_({"fault": [{"kind": "chaser_crash", "start": 1.0}]})
    assert {"a fault began", "a pursuer that chased crashed", "a message was lost"} <= {*seen_in(run(scenario, 3))}
    calm = seen_in(run(busy, 3))
    assert not {"a fault began", "a pursuer that chased crashed", "a message was lost"} & {*calm}
    assert {*calm} <= {*SIGHTINGS}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"prop": "always active >= 0"}, "says nothing"),
        ({"prop": "idle at most 1 in total against sap"}, "its own reference"),
        ({"prop": "idle at most 1 in total against sapp"}, "there is no protocol 'sapp'"),
        ({"prop": "idel at most 1 in total"}, "there is no quantity 'idel'"),
        ({"features": ["latencies"]}, "there is no feature 'latencies'; there are team, latency"),
        ({"features": []}, "a search needs a feature"),
        ({"vary": {"network.loss": [0.1, 1.5]}}, "network.loss"),
        ({"vary": {"network.los": [0.1]}}, "network.los"),
    ],
)
def test_bad_use_is_told(arguments, message):
    with pytest.raises(ValueError, match=message):
        find_violation(SMALL, **{"prop": "idle at most 1 in total"} | arguments)


def test_a_search_is_about_a_scenario():
    with pytest.raises(TypeError, match="find_violation"):
        find_violation("relay.toml", IDLE)
    with pytest.raises(TypeError, match="fatal_losses"):
        fatal_losses(run(SMALL, 1), IDLE)

"""Live runs: processes over UDP do what the simulation does, and how they end is told."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from math import inf, sqrt
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import desim
from desim import Constant, Evader, Scenario, Team, load
from desim.analysis.statistics import mean, paired
from desim.config.model import Value
from desim.kernel.core.events import LOST, Broadcast, ClockCorrected, Delivered, Lost, MessageCounts, Sent
from desim.kernel.models.traced_faults import FaultStarted
from desim.live.agreement import FALSE_ALARMS, GATE, SHOWN, Agreement, Row, compare
from desim.live.live_runs import run, runs
from desim.live.lobby import LiveError
from desim.live.namespaces import NamespaceError
from desim.live.result import Conduct, LiveResult
from desim.pursuit.core.events import Sampled
from desim.results import run_folder
from desim.scenario.toml import dump
from desim.testing.messages import Conservation, DeliveredOnce
from desim.testing.pursuits import ActiveTimeWatcher, MotionWatcher
from scenarios.studies.study import SCENARIOS

DESIM = [str(Path(sys.executable).with_name("desim"))]
SMALL = {"count": 3, "box": (0.0, 6.0), "speeds": {"default": 2.0, "last": 3.0}, "active_at_start": 1.0}


def scenario(**changes) -> Scenario:
    """Return three fast pursuers, 10 heartbeats a second each, over a latency of 0.1 s."""
    relay = load(SCENARIOS / "relay.toml")
    latency = changes.pop("latency", 0.1)
    network = relay.network.model_copy(update={"latency": Constant(value=latency)})
    team = Team(**SMALL | changes.pop("team", {}))
    return relay.model_copy(update={"team": team, "network": network, "horizon": 1.0} | changes)


def parent(pid: str) -> int:
    """Return the parent of a process; -1 if it is gone."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return -1


def processes() -> list[str]:
    """Return the numbers of all processes of this machine."""
    return [path.name for path in Path("/proc").iterdir() if path.name.isdigit()]


def no_process_is_left() -> bool:
    """Return whether no nursery is left among the children of this process."""
    if sys.platform != "linux":
        return True
    lines = [Path(f"/proc/{pid}/cmdline") for pid in processes() if parent(pid) == os.getpid()]
    return not any("desim.live.nursery" in line.read_text(errors="replace") for line in lines if line.exists())


def test_three_processes_play_for_a_second_and_leave_a_trace_that_all_invariants_hold_for(tmp_path):
    slow = {"speeds": {"default": 0.1, "last": 0.2}}
    experiment = scenario(team=slow)
    result = run(experiment, 4)
    conservation = Conservation()
    for event in result.trace:
        conservation(event)
    (counts,) = result.trace.of(MessageCounts)
    # 3 pursuers x (a first announcement and 10 heartbeats, besides changes) x 2 receivers
    assert 60 <= counts.sent <= 120
    assert counts.lost_by.keys() <= {"loss"}
    assert counts.bytes_sent == 24 * counts.transmissions  # Assignment
    assert result.conduct.dropped == (0, 0, 0)
    assert set(result.conduct.lateness) == {0, 1, 2, "referee"}
    assert not (result.conduct.ends)
    assert not (result.conduct.notes)
    assert {event.src for event in result.trace.of(Broadcast)} == {0, 1, 2}
    late = [
        arrival - event.t
        for event in result.trace.of(Broadcast)
        for _, arrival in event.fates()
        if arrival not in (LOST, result.trace.events[-1].t + 1)
    ]
    assert min(late) == 100_000_000  # never before the stamp plus the latency
    run_folder.write(result, tmp_path, drawn=False)
    read = run_folder.read(tmp_path)
    assert desim.summary(read) == desim.summary(result)
    assert no_process_is_left()


@pytest.mark.slow
def test_messages_positions_and_ranges_of_live_traces_are_those_of_one_world():
    near = 4.0
    network = scenario().network.model_copy(update={"range": near})
    experiment = scenario(network=network, team={"count": 5, "speeds": {"default": 0.7, "last": 1.5}}, horizon=2.0)
    for result in runs(experiment, range(2), at_once=2):
        for watch in (Conservation(), DeliveredOnce(), MotionWatcher(experiment), ActiveTimeWatcher()):
            for event in result.trace:
                watch(event)
        samples = result.trace.of(Sampled)
        times = np.array([sample.t for sample in samples])
        places = np.array([sample.pursuers for sample in samples])
        for event in result.trace.of(Broadcast):
            here = places[np.searchsorted(times, event.t) - 1]
            distances = np.hypot(*(here - here[event.src]).T)
            # Both may have moved since the sample of 0.05 s ago.
            assert max(distances[list(event.dst)], default=0.0) <= near + 2 * 1.5 * 0.05


VARIANTS = {
    "flooding": {"announce": {"dissemination": {"kind": "flooding"}}, "network": {"graph": {"kind": "ring"}}},
    "gossip": {"announce": {"dissemination": {"kind": "gossip"}}},
    "reliable": {"announce": {"dissemination": {"kind": "reliable"}}, "network": {"loss": 0.2}},
    "coded": {"announce": {"dissemination": {"kind": "coded"}}},
    "coded, with duplicates": {"announce": {"dissemination": {"kind": "coded"}}, "network": {"duplicate": 0.3}},
    "coded transport": {
        "protocol": {"schedule": {"kind": "token_ring"}},
        "network": {"transport": {"kind": "coded"}, "duplicate": 0.3},
    },
    "token": {"protocol": {"schedule": {"kind": "token_ring"}}},
    "token over a transport": {
        "protocol": {"schedule": {"kind": "token_ring"}},
        "network": {"transport": {"kind": "reliable"}, "loss": 0.2},
    },
    "mutex": {"protocol": {"schedule": {"kind": "local_mutex"}}},
    "server": {"protocol": {"kind": "server"}},
    "cbaa": {"protocol": {"kind": "cbaa"}},
    "cbba": {"protocol": {"kind": "cbba"}},
    "trust": {"announce": {"trust": {"kind": "accusations"}}},
    "inertia": {"team": {"dynamics": {"kind": "acceleration", "limit": 3.0}}, "announce": {"payload": "course"}},
    "duplicates in order": {"network": {"duplicate": 0.3, "order": "fifo"}, "announce": {"payload": "time"}},
    "clocks": {
        "clocks": {"sync": {"kind": "two_way", "interval": 0.05, "exchanges": 4}},
        "fault": [{"kind": "clock_skew", "node": 2, "offset": 0.5}],
    },
    "crash": {
        "fault": [
            {"kind": "crash", "node": 1, "start": 0.3, "end": 0.6},
            {"kind": "partition", "groups": [[0, 1]], "start": 0.2, "end": 0.7},
        ]
    },
}
"""What can be set beside the scenario above: each message of desim, and each part of the network that runs live."""


def variant(changes) -> Scenario:
    tables = scenario(team={"speeds": {"default": 0.1, "last": 0.2}}, latency=0.05).plain()
    for table, keys in changes.items():
        tables[table] = keys if isinstance(keys, list) or "kind" in keys else tables[table] | keys
    return Scenario.model_validate(tables)


@pytest.mark.slow
def test_each_message_and_each_model_that_runs_live_runs_as_it_is_simulated():
    """Numbers of messages are those of the simulation to a fifth, because each timer is at the same time."""
    experiments = [variant(changes) for changes in VARIANTS.values()]
    with ThreadPoolExecutor(3) as pool:
        results = list(pool.map(run, experiments, repeat(5)))
    for name, experiment, result in zip(VARIANTS, experiments, results, strict=True):
        conservation, once = Conservation(), DeliveredOnce()
        for event in result.trace:
            conservation(event)
            once(event)
        simulated = desim.run(experiment, 5).trace
        for kind in (Broadcast, Sent):
            here, there = len(result.trace.of(kind)), len(simulated.of(kind))
            assert 0.5 * there - 10 <= here <= 2.0 * there + 10, (name, kind)
        assert bool(result.trace.of(Delivered)) == bool(simulated.of(Delivered)), name
        assert result.conduct.dropped == (0, 0, 0), name
        (counts,) = result.trace.of(MessageCounts)
        assert counts.lost_by.keys() <= {"loss", "crash", "partition"}, name


@pytest.mark.slow
def test_a_clock_that_is_ahead_is_corrected_live():
    result = run(variant(VARIANTS["clocks"]), 5)
    corrections = [event for event in result.trace.of(ClockCorrected) if event.node == 2]
    # The latency is constant, so the error is that of the transport between processes, and of the timers.
    assert corrections[-1].correction == pytest.approx(-0.5, abs=0.05)


class Raising(Value):
    """A protocol that raises an exception."""

    kind: Literal["raising"] = "raising"

    def __call__(self, me):
        yield me.sleep(0.2)
        raise ZeroDivisionError(f"of {me.id}")


@pytest.mark.slow
def test_an_exception_of_a_protocol_ends_the_run_and_is_told_with_its_pursuer():
    where = rf"pursuer (\d): *\n.*{Path(__file__).name}\", line \d+, in __call__\n.*\n"
    with pytest.raises(LiveError, match=rf"{where}ZeroDivisionError: of \1 \(pursuer \1, at 0.2"):
        run(scenario(protocol=Raising()), 1, tell=lambda _: None)
    assert no_process_is_left()


def live(path, *options, **more):
    """PursuerStart `desim live`."""
    return subprocess.Popen(
        [*DESIM, "live", str(path), *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more
    )


@pytest.fixture
def file(tmp_path):
    """The file of a run of 4 s in which nothing is captured."""
    path = tmp_path / "calm.toml"
    path.write_text(dump(scenario(team={"speeds": {"default": 0.1, "last": 0.2}}, horizon=4.0)))
    return path


def children_of(pid: int) -> list[int]:
    return [int(child) for child in processes() if parent(child) == pid]


def pursuers_of(command: subprocess.Popen) -> list[int]:
    """Return the processes of the pursuers, once they play."""
    for _ in range(1200):
        for nursery in children_of(command.pid):
            if len(children := children_of(nursery)) == 3:
                time.sleep(1.0)  # until they have joined
                return sorted(children)
        time.sleep(0.05)
    raise AssertionError(f"no pursuers: {command.communicate()}")


def are_gone(pids: list[int]) -> bool:
    for _ in range(100):
        if not any(Path(f"/proc/{pid}").exists() for pid in pids):
            return True
        time.sleep(0.05)
    return False


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_killed_pursuer_is_a_crash_and_the_others_go_on(file, tmp_path):
    command = live(file, "-o", str(tmp_path / "out"), "--json")
    os.kill(pursuers_of(command)[1], signal.SIGKILL)
    out, err = command.communicate(timeout=60)
    assert command.returncode == 3
    assert "pursuer 1 was ended by SIGKILL at" in err
    assert json.loads(out)["runs"][0]["live"]["ends"] == {"1": "was ended by SIGKILL"}
    result = run_folder.read(tmp_path / "out")
    (crash,) = result.trace.of(FaultStarted)
    assert crash.fault.node == 1
    after = {event.src for event in result.trace.of(Broadcast) if event.t > crash.t + 1e9}
    assert after == {0, 2}
    assert {event.cause for event in result.trace.of(Lost) if event.t > crash.t and event.dst == 1} == {"crash"}
    conservation = Conservation()
    for event in result.trace:
        conservation(event)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_an_interrupt_ends_all_processes_with_the_exit_code_of_shells(file):
    command = live(file)
    pids = pursuers_of(command)
    command.send_signal(signal.SIGINT)
    _, err = command.communicate(timeout=30)
    assert command.returncode == 130, err
    assert "interrupted" in err
    assert are_gone(pids)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_no_process_outlives_a_killed_referee(file):
    command = live(file)
    pids = [*pursuers_of(command), *children_of(command.pid)]
    command.kill()
    command.communicate(timeout=30)
    assert are_gone(pids)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_pursuers_that_will_never_join_are_told_at_once(file):
    command = live(file)
    while not (nursery := children_of(command.pid)):
        time.sleep(0.05)
    os.kill(nursery[0], signal.SIGKILL)  # before it has started the pursuers
    _, err = command.communicate(timeout=30)  # and not after the minute in which they should join
    assert command.returncode == 1
    assert "pursuer 0 was lost; pursuer 1 was lost; pursuer 2 was lost" in err


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_referee_that_stalls_is_told_by_the_pursuers_and_by_itself(file):
    command = live(file)
    pursuers_of(command)
    command.send_signal(signal.SIGSTOP)
    time.sleep(1.6)
    command.send_signal(signal.SIGCONT)
    _, err = command.communicate(timeout=60)
    assert command.returncode == 0, err
    assert re.search(r"pursuer \d: no frame of the referee for 1\.\d s", err)
    assert re.search(r"warning: seed 3: the referee stalled for 1\.\d s", err)


@pytest.mark.slow
def test_pursuers_run_at_other_addresses_of_this_machine_and_on_invitation(tmp_path, monkeypatch, file):
    from desim.live import lobby

    experiment = load(file).model_copy(update={"horizon": 1.0})
    (tmp_path / "short.toml").write_text(dump(experiment))
    experiment = load(tmp_path / "short.toml")
    is_local, started = lobby._is_local, []
    monkeypatch.setattr(lobby, "_is_local", lambda host: host != "127.0.0.4" and is_local(host))

    def tell(text):
        if match := re.search(r"on 127.0.0.4: desim live FILE --join (\S+)", text):
            started.append(live(tmp_path / "short.toml", "--join", match[1]))

    result = run(experiment, 3, hosts=["127.0.0.2", "127.0.0.3", "127.0.0.4"], tell=tell)
    told = started[0].communicate(timeout=10)
    assert started[0].returncode == 0, told
    assert {event.src for event in result.trace.of(Broadcast)} == {0, 1, 2}
    assert result.conduct.dropped == (0, 0, 0)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="network namespaces need root")
def test_pursuers_run_in_network_namespaces_and_netem_is_used_where_there_is_one():
    experiment = scenario()
    try:
        result = run(experiment, 2, links="namespaces")
    except NamespaceError as error:
        pytest.skip(str(error))
    assert result.trace.of(MessageCounts)[0].delivered
    assert "desim-" not in subprocess.run(["ip", "netns"], capture_output=True, text=True, check=True).stdout
    try:
        delivered = run(experiment, 2, links="netem").trace.of(MessageCounts)[0].delivered
    except NamespaceError as error:
        why, delivered = str(error), 0
    assert delivered or "CONFIG_NET_SCH_NETEM; without --netem the receivers draw the links" in why


# Agreement.


@pytest.mark.parametrize(
    ("others", "margin", "errors"),
    [
        ([3.0, 4.0, 5.0], 0.0, 0.0),
        ([2.0, 3.0, 4.0], 0.0, inf),  # by the same in each pair
        ([4.0, 5.0, 6.0], 0.5, -inf),
        ([4.0, 5.0, 6.0], 1.0, 0.0),
        ([2.0, 3.5, 3.5], 0.0, sqrt(12.0)),
        ([2.0, 3.5, 3.5], 0.5, sqrt(3.0)),
    ],
)
def test_a_difference_is_told_in_standard_errors_beyond_the_margin(others, margin, errors):
    values = [3.0, 4.0, 5.0]
    row = Row("end_time", "s", mean(values), mean(others), paired(values, others), margin)
    assert row.errors == pytest.approx(errors)
    assert row.agrees  # three runs tell nothing apart


@pytest.mark.parametrize(
    ("differences", "agrees"),
    [([1.0] * 8, True), ([1.0] * 9, False), ([1.0, 1.2], True), ([1.0, 1.2] * 10, False), ([-1.0, 1.2] * 10, True)],
)
def test_a_difference_is_told_apart_beyond_the_margin(differences, agrees):
    """Eight equal differences have one sign by chance in one of 128 cases, and so in one of 18 for seven metrics."""
    zeros = [0.0] * len(differences)
    for margin, sign in ((0.0, 1.0), (0.5, 1.0), (0.5, -1.0)):
        values = [sign * value for value in differences]
        assert Row("end_time", "s", mean(values), mean(zeros), paired(values, zeros), margin).agrees == agrees
    assert Row("end_time", "s", mean(values), mean(zeros), paired(values, zeros), 1.2).agrees


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 5, 20])
def test_live_runs_that_are_simulated_ones_seldom_differ(count):
    """The share of false alarms in 2000 comparisons has a standard error of at most 0.5 %."""
    draws = np.random.default_rng(count).normal(size=(2000, len(SHOWN), count))
    zeros = [0.0] * count
    rows = [[_difference(values, zeros) for values in comparison] for comparison in draws.tolist()]
    false_alarms = mean([not all(row.agrees for row in comparison) for comparison in rows])
    assert 0.6 * FALSE_ALARMS < false_alarms.mean < FALSE_ALARMS + 3.0 * false_alarms.standard_error
    uncorrected = mean([any(abs(row.errors) > 3.0 for row in comparison) for comparison in rows])
    assert count == 20 or uncorrected.mean > 2.0 * FALSE_ALARMS


def _difference(values: list[float], zeros: list[float]) -> Row:
    difference = paired(values, zeros)
    return Row("end_time", "s", difference, difference, difference, 0.0)


@pytest.mark.slow
def test_late_actions_explain_differences_of_times_only():
    simulated = [desim.run(game("sap"), seed) for seed in (1, 2)]
    late = Conduct(orders=[500_000_000])
    live = [LiveResult(result.scenario, result.seed, result.trace, late) for result in simulated]
    margins = {row.metric: row.margin for row in Agreement(game("sap"), live, simulated).rows}
    assert {name for name, margin in margins.items() if margin} == {name for name in SHOWN if name.endswith("_time")}


def test_one_run_is_no_comparison():
    with pytest.raises(ValueError, match=r"at least 2 runs of each kind \(got 1\)"):
        compare(game("sap"), 1)


def agrees(agreement) -> bool:
    if not agreement.is_on_time:
        pytest.skip(f"timers were late: 99 % by up to {1e3 * agreement.p99:.0f} ms, more than {1e3 * GATE:g} ms")
    print(agreement.table())
    row = next(row for row in agreement.rows if row.metric == "active_time")
    return row.agrees


def game(protocol) -> Scenario:
    """Return a pursuit of about a second, of six pursuers with periods of 0.2 s in the mean."""
    rule = {"kind": protocol, "schedule": {"kind": "poisson", "rate": 5.0}}
    experiment = scenario(team={"count": 6}, horizon=6.0, evader=Evader(box=(2.0, 4.0), speed=1.0))
    return Scenario.model_validate(experiment.plain() | {"protocol": rule})


@pytest.mark.slow
def test_live_runs_agree_with_simulated_ones():
    agreement = compare(game("sap"), 8)
    assert agrees(agreement)
    assert agreement.late("deliveries").median < 2e6 / 1e9


@pytest.mark.whole
@pytest.mark.parametrize("protocol", ["sap", "local_min", "cbba"])
def test_live_runs_of_a_protocol_agree_with_simulated_ones(protocol):
    assert agrees(compare(game(protocol), 20))


@pytest.mark.whole
def test_live_runs_with_four_times_the_latency_differ():
    slow = game("sap")
    network = slow.network.model_copy(update={"latency": Constant(value=0.4)})
    assert not agrees(compare(slow.model_copy(update={"network": network}), 20, simulated=slow))

"""The replay: the page has the data of the trace, and a browser shows it."""

import json
import os
import re
import subprocess
import sys
from base64 import b64decode
from dataclasses import replace
from functools import cache
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, load, run
from desim.analysis.age import belief_error
from desim.analysis.trace_index import ended, messages, started
from desim.cli import main
from desim.kernel.core.events import LOST, Broadcast, Lost, MessageCounts, Queued, Sent, Trace
from desim.kernel.core.units import SECOND
from desim.kernel.models.access import Tdma
from desim.kernel.models.faults import Crash, Jamming, Partition
from desim.kernel.models.graphs import Edge, Edges, Link, Ring
from desim.kernel.models.interference import CaptureEffect
from desim.kernel.models.latency import Constant, Lognormal
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Bitrate
from desim.kernel.models.reception import LogDistance, QuasiUnitDisk
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.kernel.topology.topology import Topology
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Ended, Estimated, Sampled
from desim.pursuit.evaders.evasion import Still
from desim.pursuit.motion.flow import GyreFlow, SteadyFlow
from desim.pursuit.sensing.sensing import Sensing
from desim.pursuit.team.announcements import Announcements
from desim.results.run_folder import write
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording
from desim.view.headings import Headings
from desim.view.pages.headline import conditions
from desim.view.pages.replay import missing_recordings, replay, replay_page, size_warning, with_recordings
from desim.view.pages.replay_columns import DIFFERENCES, MAX_REPLAY_TIME, RUNS, Ticks, packed_column
from desim.view.pages.replay_data import replay_data
from desim.view.pages.replay_plane import FLOW_MARGIN, FLOW_POINTS, FLOW_TIMES, all_places, flow_data
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from tests.golden import golden
from tests.view.browser import in_chromium
from tests.view.by_hand import ACTIVE, MS, chase, history, pair
from tests.view.elements import Elements

SCENARIOS = Path(__file__).parents[2] / "scenarios"
HOSTILE = "</script><script>window.hurt = 1</script><!-- & \u2028 {{ name }} <b>Bold</b>"
ALL = Recording(messages=True)
# 40 pursuers, whose evader is too far away to be captured within 30 s: some 10,000 messages.
FORTY = Scenario(
    name=HOSTILE,
    team=Team(count=40, speeds=0.95),
    evader=Evader(position=(30.0, 22.0)),
    protocol=SpatialAdaptivePlay(schedule=Poisson(rate=1.0)),
    announce=Announcements(start="known", heartbeat=5.5),
    network=Links(latency=Constant(value=0.5), loss=Bernoulli(p=0.05)),
    record=ALL,
)
# Two messages a second and node, of 24 bytes each: 192 ms at 1000 bit/s on a channel that all share, so most wait, and
# some are dropped.
CROWDED = FORTY.model_copy(
    update={
        "name": "crowded",
        "horizon": 4.0,
        "team": Team(count=5, speeds=0.95),
        "announce": Announcements(heartbeat=0.5),
        "network": Links(medium=Bitrate(bitrate=1000.0, shared=True, queue_limit=2)),
    }
)
SHORT = ("horizon=1.0", "record.messages=true")
COLD = FORTY.model_copy(
    update={
        "name": "cold",
        "horizon": 2.0,
        "team": Team(count=8, speeds=0.95),
        "announce": Announcements(heartbeat=0.5, start="silent"),
    }
)
FILES = {"relay": ("relay.toml", *SHORT), "soak": ("soak.toml", *SHORT), "faults": ("faults.toml",)} | {
    "radio": ("radio.toml", *SHORT), "many": ("many.toml",), "contention": ("contention.toml", *SHORT)
}  # fmt: skip
OWN = {"crowded": CROWDED, "cold": COLD}


STAYS, CHASES, UNHEARD = range(3)  # the believed action of a pursuer, with one evader


@pytest.fixture(scope="module")
def result_of(run_of):
    """Return a function from the name of a case to its run, made once."""

    @cache
    def own(name):
        return run(OWN[name])

    return lambda name: run_of(*FILES[name]) if name in FILES else own(name)


# Two pursuers at one place, so that what they see is one disc, in the middle of all that is shown; nothing else is.
SEEING = Scenario(
    name="seeing",
    team=Team(positions=[(5.0, 5.0), (5.0, 5.0)], speeds=1.0, active_at_start=0.0),
    evader=tuple(Evader(position=(x, x), speed=0.0, strategy=Still()) for x in (0.0, 10.0)),
    sensing=Sensing(radius=2.0),
    motion=Motion(static=True),
    horizon=0.1,
    announce=Announcements(trigger="never"),
)


def unpacked_column(column, kind):
    """Return the integers of a column, as the page decodes them."""
    content = np.frombuffer(b64decode(column), "u1")
    form, groups = int(content[0]), content[1:].astype(np.int64)
    last = groups < 128
    number = np.cumsum(last) - last  # to which each byte belongs
    first = np.flatnonzero(np.append(True, last[:-1]))[: last.sum()]
    codes = np.zeros(len(first), np.int64)
    np.add.at(codes, number, (groups & 127) << 7 * (np.arange(len(groups)) - first[number]))
    if form & RUNS:
        codes = np.repeat(codes[::2], codes[1::2])
    signed = (codes >> 1) ^ -(codes & 1)
    return (np.cumsum(signed) if form & DIFFERENCES else signed).astype(kind)


def column(text, kind):
    return np.frombuffer(b64decode(text), kind) if "f" in kind else unpacked_column(text, kind)


def spans(result):
    """Return when each message was sent, and when it arrived or was lost (inf: neither), by number and receiver; ns."""
    begun, over = {}, {}
    for event in result.trace:
        if isinstance(event, Queued):
            begun |= dict.fromkeys(((event.transmission, dst) for dst in event.dst), event.t)
        elif isinstance(event, Broadcast | Sent):
            dst = event.dst if isinstance(event, Broadcast) else (event.dst,)
            arrival = event.arrival if isinstance(event, Broadcast) else (event.arrival,)
            arrival = arrival * len(dst) if len(arrival) < len(dst) else arrival
            for node, when in zip(dst, arrival, strict=True):
                begun.setdefault((event.transmission, node), event.t)
                over[event.transmission, node] = np.inf if when == LOST else when
        elif isinstance(event, Lost):
            over[event.transmission, event.dst] = event.t
    return np.array([(begun[key], over.get(key, np.inf)) for key in begun], float).reshape(-1, 2)


def in_flight(result, t):
    """Return how many messages the trace has in flight at a time, ns."""
    begin, end = spans(result).T
    return int(((begin <= t) & (t < end)).sum())


def wrong_now(result, t):
    """Return how many ordered pairs there are of which one has a wrong belief about the other at a time, ns.

    Only for runs in which each announces its own action and none forgets.
    """
    size = len(started(result).active)
    does = np.array(started(result).active, int)
    heard = np.tile(does * (result.scenario.announce.start == "known"), (size, 1))
    newest = np.zeros((size, size), int)
    lost = {(event.transmission, event.dst) for event in result.trace.of(Lost)}
    for event in result.trace:
        if event.t > t:
            break
        if isinstance(event, Decided):
            does[event.pursuer] = event.active
        if isinstance(event, Captured) and event.t < result.trace.of(Ended)[0].t:
            does[does == event.evader] = 0
        if isinstance(event, Broadcast):
            arrival = event.arrival if len(event.arrival) == len(event.dst) else event.arrival * len(event.dst)
            for node, when in zip(event.dst, arrival, strict=True):
                if when <= t and (event.transmission, node) not in lost and event.seq > newest[node, event.src]:
                    newest[node, event.src], heard[node, event.src] = event.seq, event.body.active
    wrong = heard != does
    return int(wrong[~np.eye(size, dtype=bool)].sum())


# What the page holds.


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", ["soak", "faults", "crowded", "radio", "contention"])
def test_the_page_has_as_many_messages_in_flight_as_the_trace_at_any_time(name, result_of):
    """At ticks of nanoseconds, nothing is rounded in runs of up to 2.1 s; else the times between events are judged."""
    result = result_of(name)
    document, of_trace = replay_data(result), spans(result)
    said, tick = document["messages"], document["tick"] * SECOND
    begin = np.repeat(column(said["begin"], "<u4"), column(said["count"], "<u2"))
    end, fate = column(said["end"], "<u4"), column(said["fate"], "u1")
    edges = np.unique(of_trace[of_trace <= ended(result).t])
    for t in (edges[:-1] + edges[1:])[np.diff(edges) > 2 * tick] / 2:
        assert ((begin <= t / tick) & (t / tick < end)).sum() == ((of_trace[:, 0] <= t) & (t < of_trace[:, 1])).sum()
    tally, last = messages(result), document["end"]
    assert len(end) == tally.sent
    assert ((begin <= last) & (last < end)).sum() == tally.in_flight
    assert {said["causes"][k - 1].replace(" ", "_"): int((fate == k).sum()) for k in np.unique(fate[fate > 0])} == (
        tally.lost_by
    )


def test_a_message_that_waits_for_its_transmitter_is_in_flight_and_has_not_left(result_of):
    result = result_of("crowded")
    document = replay_data(result)
    said = document["messages"]
    begin, left = column(said["begin"], "<u4"), column(said["left"], "<u4")
    assert result.trace.of(Queued)
    assert {"queue"} == set(said["causes"])
    assert (left > begin).any()
    assert (left >= begin).all()
    dropped = {event.transmission for event in result.trace.of(Lost)}
    gone = {event.transmission for event in result.trace.of(Broadcast)}
    waiting = {event.transmission for event in result.trace.of(Queued)} - gone
    assert dropped & waiting
    first = np.cumsum(column(said["count"], "<u2"), dtype=int) - column(said["count"], "<u2")
    assert (left == column(said["end"], "<u4")[first]).sum() == len(waiting), "latency is never 0 here"
    assert (left > document["end"]).sum() == len(waiting - dropped) > 0


def test_headings_estimates_and_the_flow_are_in_the_page_only_where_there_are_any(result_of):
    document = replay_data(result_of("relay"))
    assert (document["headings"], document["estimates"], document["flow"]) == (None, None, None)


@pytest.mark.slow
def test_the_flow_is_that_at_the_points_of_the_grid():
    """Row by row from the lower left; a gyre depends on x, on y and on time, and a steady flow has one time."""
    gyre = GyreFlow(speed=0.5, size=6.0, shift=1.0, period=4.0)
    for flow, times in ((gyre, FLOW_TIMES), (SteadyFlow(velocity=(0.1, 0.2)), 1)):
        scenario = Scenario(horizon=0.2, team=Team(count=2), environment={"flow": flow}, record={"trajectory": 0.1})
        result = run(scenario, 1)
        shown, places = flow_data(result, lambda t: t.tolist()), all_places(result)
        velocities = column(shown["velocities"], "<f4").reshape(times, -1, shown["columns"], 2)
        assert shown["t"][-1] == (ended(result).t if times > 1 else 0)
        (left, low), edge = shown["start"], shown["edge"]
        assert (left, low) == tuple(places.min(axis=(0, 1)) - FLOW_MARGIN)
        grid = np.add.outer(
            1j * (low + edge * np.arange(velocities.shape[1])), left + edge * np.arange(shown["columns"])
        )
        assert (grid[-1, -1].real, grid[-1, -1].imag) >= tuple(places.max(axis=(0, 1)))
        assert edge * FLOW_POINTS == pytest.approx((np.ptp(places, axis=(0, 1)) + 2.0 * FLOW_MARGIN).max())
        for t, shown_then in zip(shown["t"], velocities, strict=True):
            wanted = flow(grid.ravel(), t / SECOND).reshape(grid.shape) + np.zeros(grid.shape)
            assert shown_then @ [1.0, 1j] == pytest.approx(wanted, abs=1e-6)
        assert shown["top"] == pytest.approx(np.abs(velocities @ [1.0, 1j]).max(), abs=1e-6)


def test_headings_are_within_a_half_unit_of_those_of_the_samples(run_of):
    result = run_of("inertia.toml", "horizon=1.0")
    given, headings = replay_data(result)["headings"], Headings(result.scenario, result.seed)
    assert given["players"] == list(range(13))
    stored = np.exp(2j * np.pi / given["turn"] * column(given["values"], "u1").reshape(-1, 13))
    wanted = np.array([headings.at(each) for each in (started(result), *result.trace.of(Sampled))])
    assert np.abs(np.angle(stored / wanted)).max() <= np.pi / given["turn"] + 1e-9
    assert len(np.unique(stored)) > 20


def test_estimates_are_the_ellipses_of_the_recorded_covariances(run_of):
    result = run_of("noisy.toml", "horizon=0.5")
    given, found = replay_data(result)["estimates"], result.trace.of(Estimated)
    long, short = column(given["semi_axes"], "<i4").reshape(-1, 2).T / 1000.0
    axis = np.exp(2j * np.pi / given["turn"] * column(given["angles"], "u1"))
    squared = (long**2 + short**2) / 2.0 + (long**2 - short**2) / 2.0 * axis**2
    assert squared.real == pytest.approx([each.xx for each in found], abs=0.02)
    assert ((long**2 - short**2) / 2.0 * axis**2).imag == pytest.approx([each.xy for each in found], abs=0.02)
    centres = column(given["centres"], "<i4").reshape(-1, 2) / 1000.0
    assert np.abs(centres - [[each.x, each.y] for each in found]).max() <= 0.0005 + 1e-9
    assert column(given["pursuer"], "<u2").tolist() == [each.pursuer for each in found]


@in_chromium
@pytest.mark.slow
def test_the_page_shows_headings_estimates_and_the_flow(shown):
    """The flow is linear between the points of its grid, so in the middle of cells it is nearly right."""
    flow = "environment.flow={kind='gyre', speed=0.5, size=6.0, shift=1.0, period=4.0}"
    result = run(
        with_recordings(load(SCENARIOS / "noisy.toml", ["horizon=1.5", flow, "evader.dynamics.kind='acceleration'"]))
    )
    opened, environment = shown(result), result.scenario.environment
    samples = [started(result), *result.trace.of(Sampled)]
    headings = Headings(result.scenario, result.seed)
    known = {sample.t: headings.at(sample)[0] for sample in samples}
    for sample in samples[9:-1:7]:
        opened.value(f"replay.seek({(sample.t - 1e6) / SECOND})")
        found = opened.value("replay.headings")
        assert found[:8] == [None] * 8
        assert abs(np.angle(np.exp(1j * found[8]) / known[sample.t])) < 0.02
        opened.value(f"replay.seek({sample.t / SECOND})")
        estimates = {each.pursuer: (each.x, each.y) for each in result.trace.of(Estimated) if each.t == sample.t}
        active = [k for k, action in enumerate(opened.value("replay.truth")) if action]
        assert opened.value("replay.estimates.map(each => each[0]).sort()") == active
        opened.value("replay.choose(3)")
        assert opened.value("replay.estimates") == [[3, 1, *(pytest.approx(c, abs=6e-4) for c in estimates[3])]]
        opened.value("replay.choose(-1)")
        for place in (8 + 8j, 11 + 6.5j):
            wanted = environment.flow(np.array([place]), sample.t / SECOND)[0]
            assert complex(*opened.value(f"replay.flowAt({place.real}, {place.imag})")) == pytest.approx(
                wanted, abs=0.1
            )
    assert opened.value("replay.flowAt(1e3, 0)") is None
    for box, key in (("flow", "f"), ("ellipses", "u")):
        opened.value(f"document.body.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}', bubbles: true}}))")
        assert opened.value(f"document.getElementById('{box}').checked") is False


KINDS = dict.fromkeys(("t", "begin", "left", "end"), "<u4") | {"start": "<i4", "shifts": "<i4"}
KINDS |= dict.fromkeys(("src", "dst", "count", "who", "evader", "reader", "source"), "<u2")


def page_text(result):
    """Return the text of a page, and its data, column by column."""
    lines = Elements(replay_page(result)).lines
    for part, value in replay_data(result).items():
        is_table = isinstance(value, dict) and part != "reception"
        for name, each in value.items() if is_table else [("", value)]:
            packed_column = is_table and isinstance(each, str)
            lines.append(
                f"{part} {name}: {json.dumps(column(each, KINDS.get(name, 'u1')).tolist() if packed_column else each)}"
            )
    return "\n".join(lines)


def test_pages_of_runs_by_hand_are_golden():
    """A message sent at 950 ms waits as the run ends, and so is in flight to the end, 10^9 ns, and has not left.

    A chaser of a captured evader stays from then on, unless it decides at the same instant.
    """
    cut = Partition(start=0.2, end=0.5, groups=((0,), (1, 2)))
    parted = history(FaultStarted(200 * MS, cut), FaultEnded(500 * MS, cut))
    golden("replay.txt", {each.scenario.name: page_text(each) for each in (parted, pair())})


def test_a_message_in_flight_at_the_end_stays_so_even_if_it_arrives_within_the_tick():
    """At ticks of 10 ns, 4,000,000,004 ns is the last tick, as is the end."""
    ticks = Ticks.fit(4 * SECOND)
    assert column(ticks([4 * SECOND, 4 * SECOND + 4, 10**15]), "<u4").tolist() == [
        4 * 10**8,
        4 * 10**8 + 1,
        MAX_REPLAY_TIME,
    ]


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", ["soak", "cold", "faults", "many"])
def test_the_belief_error_of_the_page_equals_that_of_the_analysis(name, result_of):
    """The integral of the wrong pairs, by counting them between any two changes, is the belief error x N (N - 1) T."""
    result = result_of(name)
    document, size = replay_data(result), len(started(result).active)
    beliefs, own = document["beliefs"], document["decisions"]
    changes = [(int(t), 0, k) for k, t in enumerate(column(own["t"], "<u4"))]
    changes += [(int(t), 1, k) for k, t in enumerate(column(beliefs["t"], "<u4"))]
    who, active = column(own["who"], "<u2"), column(own["active"], "u1")
    reader, source, value = (
        column(beliefs["reader"], "<u2"),
        column(beliefs["source"], "<u2"),
        column(beliefs["value"], "u1"),
    )
    unheard = len(started(result).evaders) + 1
    does, heard = np.array(document["active"]), np.full((size, size), unheard)
    others, total, before = ~np.eye(size, dtype=bool), 0, 0
    for t, kind, k in [*sorted(changes), (document["end"], 2, 0)]:
        total += int(((np.where(heard == unheard, STAYS, heard) != does) & others).sum()) * (t - before)
        before = t
        if kind == 0:
            does[who[k]] = active[k]
        elif kind == 1:
            heard[reader[k], source[k]] = value[k]
    last = np.full((size, size), -1)
    for i, j, now in zip(reader, source, value, strict=True):
        assert now != last[i, j] or now == unheard, "only what changed"
        last[i, j] = now
    assert total / (size * (size - 1) * document["end"]) == pytest.approx(belief_error(result), abs=1e-6)
    assert total > 0


def test_a_pursuer_without_records_has_no_belief_that_teammates_are_inactive(result_of):
    """After a silent start all is unheard of at 0 s; after a known one, nothing."""
    cold = replay_data(result_of("cold"))["beliefs"]
    known = replay_data(run(load(SCENARIOS / "relay.toml", ['announce.start="known"', "horizon=0.5"])))["beliefs"]
    at_first = [column(beliefs["value"], "u1")[column(beliefs["t"], "<u4") == 0] for beliefs in (cold, known)]
    assert at_first[0].tolist() == [UNHEARD] * (8 * 7)
    assert at_first[1].tolist() == [CHASES] * (20 * 19)
    assert STAYS in column(cold["value"], "u1")


def test_a_pursuer_that_lost_its_memory_has_no_records():
    """Robot 1 breaks down for 0.1 s and forgets: afterwards it has no records, until the next heartbeats."""
    crash = Crash(node=1, start=0.5, end=0.6, memory=False)
    scenario = COLD.model_copy(update={"fault": (crash,), "announce": Announcements(heartbeat=0.5), "horizon": 1.0})
    beliefs = replay_data(run(scenario))["beliefs"]
    then = column(beliefs["t"], "<u4") == 0.6 * SECOND
    assert set(column(beliefs["value"], "u1")[then]) == {UNHEARD}
    assert set(column(beliefs["reader"], "<u2")[then]) == {1}
    assert len(column(beliefs["source"], "<u2")[then]) == 7


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", ["soak", "many"])
def test_positions_are_exact_to_the_millimetre(name, result_of):
    result = result_of(name)
    path = replay_data(result)["path"]
    shifts = column(path["shifts"], "<i4").reshape(-1, 2 * (len(started(result).active) + len(started(result).evaders)))
    places = column(path["start"], "<i4") + np.vstack([np.zeros(shifts.shape[1], int), np.cumsum(shifts, axis=0)])
    known = [started(result), *result.trace.of(Sampled)]
    there = np.array([[*each.pursuers, *each.evaders] for each in known]).reshape(len(known), -1)
    assert np.abs(places / path["per_metre"] - there).max() <= 0.0005 + 1e-9
    assert len(column(path["t"], "<u4")) == len(known)


def test_steps_of_more_than_33_metres_are_kept():
    """A pursuer at 1000 m/s, sampled every 0.05 s, moves by 50,000 mm, which 16 bits do not hold."""
    fast = Scenario(team=Team(positions=[(0.0, 0.0)], speeds=1000.0), evader=Evader(position=(600.0, 0.0)), horizon=1.0)
    path = replay_data(run(fast))["path"]
    assert column(path["shifts"], "<i4").max() == 50_000


@pytest.mark.slow
def test_actions_on_more_than_255_evaders_are_stored():
    """Actions 0 .. 300, and 301 for no record, are more than a byte has room for."""
    team, evaders = Team(count=2, box=(9.0, 10.0)), Evader(count=300, box=(2.0, 3.0))
    protocol = SpatialAdaptivePlay(schedule=Poisson(rate=0.1))
    result = run(Scenario(team=team, evader=evaders, protocol=protocol, horizon=0.05, record=ALL), seed=2)
    beliefs = replay_data(result)["beliefs"]
    assert column(beliefs["value"], "<u2").tolist() == [started(result).active[k] for k in (1, 0)]
    assert max(started(result).active) > 255


def test_a_finite_sensing_radius_is_shown():
    assert replay_data(run(SEEING))["sensing_range"] == 2.0


@pytest.mark.parametrize(("far", "per_metre"), [(1e6, 1000.0), (2e6, 100.0), (9e8, 1.0)])
def test_places_far_away_are_in_a_coarser_unit_and_none_is_wrong(far, per_metre):
    """2^31 mm are 2147 km; half of it is kept free for the differences."""
    team = Team(positions=[(far, 0.0), (-far, 3.0)], speeds=1.0)
    evader = Evader(position=(0.0, -far))
    result = run(Scenario(team=team, evader=evader, motion=Motion(static=True), horizon=0.1))
    path = replay_data(result)["path"]
    assert path["per_metre"] == per_metre
    assert (column(path["start"], "<i4") / per_metre).tolist() == [far, 0.0, -far, 3.0, 0.0, -far]


def test_a_column_has_no_number_that_it_does_not_hold():
    with pytest.raises(ValueError, match="cannot store 65536"):
        packed_column([1, 65536], "<u2")


@pytest.mark.slow
@given(st.lists(st.integers(-(2**31), 2**31 - 1) | st.integers(-2, 2), max_size=40), st.integers(1, 300))
def test_a_column_holds_the_numbers_that_were_packed(numbers, times):
    numbers = np.repeat(numbers, times)
    assert unpacked_column(packed_column(numbers, "<i4"), "<i4").tolist() == numbers.tolist()


@pytest.mark.parametrize(
    ("numbers", "form", "size"),
    [
        ([7, -300, 7, -300], 0, 1 + 2 * (1 + 2)),
        ([70000, 70001, 70003, 70006], DIFFERENCES, 1 + 3 + 3 * 1),
        ([5] * 1000, RUNS, 1 + 1 + 2),
        ([*range(1000)], DIFFERENCES | RUNS, 1 + 2 + 1 + 2),
    ],
)
def test_a_column_has_the_shortest_form(numbers, form, size):
    content = b64decode(packed_column(numbers, "<i4"))
    assert (content[0], len(content)) == (form, size)


def test_the_graph_is_stored_by_sender_and_receiver_unless_it_is_complete():
    def arcs(graph):
        given = load(SCENARIOS / "relay.toml", [f"network.graph={graph}", "team.count=3", "horizon=0.1"])
        found = replay_data(run(given))["arcs"]
        return found and column(found, "<u2").reshape(-1, 2).tolist()

    assert arcs("{kind='star'}") == [[0, 1], [0, 2], [1, 0], [2, 0]]
    one_way = "{kind='edges', directed=true, edges=[{src=2, dst=0}, {src=0, dst=1}]}"
    assert arcs(one_way) == [[0, 1], [2, 0]]
    assert arcs("{kind='complete'}") is None
    every = ", ".join(f"{{src={i}, dst={j}}}" for i in range(3) for j in range(3) if i != j)
    assert arcs(f"{{kind='edges', directed=true, edges=[{every}]}}") is None


LOG = LogDistance(exponent=3.0, shadowing=6.0)


@pytest.mark.parametrize(
    ("links", "radius"),
    [
        (Links(), None),
        (Links(reception=LOG), None),
        (Links(range=15.0), 15.0),
        (Links(range=15.0, reception=LOG, fading="message"), pytest.approx(15.0, rel=1e-12)),
        (Links(range=15.0, reception=QuasiUnitDisk(certain=0.5, p=0.4), fading="message"), 7.5),
    ],
)
def test_with_a_disk_all_pairs_are_linked_up_to_one_distance(links, radius):
    """With independent fading per message, up to where every second one is received."""
    reach = replay_data(run(FORTY.model_copy(update={"network": links, "horizon": 0.1})))["reception"]
    chance = links.fading == "message"
    assert reach == {"known": True, "chance": chance, "radius": radius, "radii": None}


@pytest.mark.slow
@pytest.mark.parametrize("reach", [LOG, QuasiUnitDisk(certain=0.5, p=0.4)])
def test_with_per_link_fading_each_pair_is_linked_up_to_its_own_distance(reach):
    """At each pair's distance its messages are received, 1e-9 m beyond they are not; judged by the network's own
    topology.
    """
    links, size = Links(range=10.0, reception=reach), 12
    scenario = FORTY.model_copy(update={"network": links, "horizon": 0.1, "team": Team(count=size)})
    result = run(scenario, seed=5)
    radii = column(replay_data(result)["reception"]["radii"], "<f8")
    pairs = np.transpose(np.triu_indices(size, 1))
    for (i, j), radius in zip(pairs.tolist(), radii.tolist(), strict=True):
        places = np.zeros((size, 2))
        topology = Topology(nx.complete_graph(size), 10.0, lambda at=places: at, reach, seed=5)
        for apart in (radius, radius + 1e-9):
            places[j] = apart, 0.0
            assert (j in topology.audible(i)) == (i in topology.audible(j)) == (apart == radius)
    assert len(set(radii.tolist())) > 1


def test_a_reception_that_does_not_fall_with_distance_is_reported_as_not_shown():
    links = Links(range=10.0, reception=lambda distances, range: ((distances > 5) & (distances < range)) * 1.0)  # noqa: A006
    result = run(FORTY.model_copy(update={"network": links, "horizon": 0.1}))
    assert not replay_data(result)["reception"]["known"]
    assert any("Links are not shown" in each for each in missing_recordings(result))


@given(st.integers(0, 10**18))
def test_the_tick_is_the_shortest_that_fits(end):
    length = Ticks.fit(end).length
    assert end // length < 2**31
    assert length == 1 or end // (length // 10) >= 2**31
    assert set(str(length)) <= {"0", "1"}


def test_ticks_round_to_the_nearest():
    ticks = column(Ticks(10, 10**6)([0, 4, 5, 14, 15]), "<u4")
    assert ticks.tolist() == [0, 0, 1, 1, 2]


# The ghost: another run in the same plane.


def test_the_data_of_a_ghost_are_its_positions_and_its_number_of_active_pursuers():
    """By hand: 3 are active, 2 after 300 ms; at 400 ms a capture releases 0, which decides at once; 1 after 700 ms."""
    ghost = replay_data(history(), pair())["ghost"]
    assert (ghost["pursuers"], ghost["evaders"], ghost["end"]) == (3, 2, SECOND)
    assert ghost["path"] == replay_data(pair())["path"]
    times = [t * MS for t in (0, 150, 300, 400, 400, 700)]
    assert column(ghost["active"]["t"], "<u4").tolist() == times
    assert column(ghost["active"]["count"], "<u4").tolist() == [3, 3, 2, 1, 2, 1]
    assert ghost["name"] == "pair, seed 3, captured 2 of 2, the last by 0 after 1.00 s"


SHORT_GHOST = Scenario(name="short", team=Team(count=5), evader=Evader(position=(60.0, 60.0)), horizon=0.5)


@pytest.mark.slow
def test_a_run_and_its_ghost_have_the_same_ticks_which_fit_the_longer_of_them():
    """5 s are more than 2^31 ns, so a tick is 10 ns; of two short runs it is 1 ns."""
    long = run(SHORT_GHOST.model_copy(update={"horizon": 5.0}))
    for result, ghost in ((history(), long), (long, history())):
        document = replay_data(result, ghost)
        assert document["tick"] == 1e-8
        assert document["end"] == ended(result).t // 10
        assert document["ghost"]["end"] == ended(ghost).t // 10
        assert column(document["ghost"]["path"]["t"], "<u4")[-1] == document["ghost"]["end"]
    assert replay_data(history(), run(SHORT_GHOST))["tick"] == 1e-9


@pytest.mark.slow
def test_a_page_without_a_ghost_does_not_mention_any():
    page = replay_page(history())
    assert page == replay_page(history(), None) == replay(history()).page
    assert replay_data(history())["ghost"] is None
    words = ("the other run, faint", "; other run: pair", 'id="other"')
    assert not [each for each in words if each in page]
    assert not [each for each in words if each not in replay(history(), pair()).page]


@pytest.mark.slow
def test_the_name_of_a_ghost_is_text():
    found = Elements(replay_page(history(), run(SHORT_GHOST.model_copy(update={"name": HOSTILE}))))
    assert len(found.scripts) == 2
    assert json.loads(found.scripts[0])["ghost"]["name"].startswith(HOSTILE)
    assert "hurt" not in found.scripts[1]


def test_a_ghost_without_positions_is_reported():
    ghost = run(SHORT_GHOST.model_copy(update={"record": Recording(trajectory=0.0)}))
    (said,) = missing_recordings(history(), ghost)
    assert said.startswith("Positions of the other run were not recorded")
    assert said in replay_page(history(), ghost)


# The page.


@pytest.mark.slow
def test_forty_pursuers_and_ten_thousand_messages_take_less_than_a_megabyte():
    """Measured: 330 kB."""
    result = run(FORTY)
    assert 9_000 < messages(result).sent < 11_000
    assert ended(result).t == 30 * SECOND
    assert len(replay_page(result).encode()) / messages(result).sent < 100.0


@pytest.mark.whole
def test_a_page_is_the_same_bytes_whatever_the_hash_seed(run_of):
    program = (
        "import sys; from desim import load, run; from desim.view.pages.replay import replay_page;"
        f"sys.stdout.buffer.write(replay_page(run(load({str(SCENARIOS / 'faults.toml')!r}, {[*SHORT]}))).encode())"
    )
    environment = os.environ | {"PYTHONHASHSEED": "1"}
    other = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, check=True)
    assert other.stdout == replay_page(run_of("faults.toml", *SHORT)).encode()
    assert len(other.stdout) > 10_000


def test_a_hostile_name_is_text():
    """The page has two scripts, its data and its program, whatever the name; the title is the name."""
    found = Elements(replay_page(run(FORTY.model_copy(update={"horizon": 0.1}))))
    assert found.title == HOSTILE
    assert len(found.scripts) == 2
    assert json.loads(found.scripts[0])["active"] == [1] * 40
    assert not any("hurt" in script for script in found.scripts)


@pytest.mark.slow
def test_a_page_lists_what_was_not_recorded():
    dull = COLD.model_copy(update={"horizon": 0.6, "record": Recording(trajectory=0.0)})
    text = replay_page(run(dull))
    assert "Positions were not recorded" in text
    assert f"Messages were not recorded: neither the {messages(run(dull)).sent:,} messages sent nor" in text
    assert "were not recorded" not in replay_page(run(dull.model_copy(update={"record": ALL})))
    frozen = dull.model_copy(update={"motion": Motion(static=True), "record": Recording(trajectory=0, messages=True)})
    assert "were not recorded" not in replay_page(run(frozen))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, "latency 0.5 s, loss 5 %, unlimited range, heartbeat 5.5 s"),
        (
            {"announce": Announcements(trigger="change")},
            "latency 0.5 s, loss 5 %, unlimited range, announced on change",
        ),
        (
            {"network": Links(range=8.0, reception=QuasiUnitDisk(), graph=Ring(), latency=Lognormal())},
            "latency lognormal (mean 0.05, cv 0.5), loss 0 %, range 8 m, heartbeat 5.5 s, "
            "reception quasi unit disk (certain 0.5, p 0.5, exponent 3), graph ring",
        ),
        (
            {
                "network": Links(
                    latency=lambda context, rng: 0.0,
                    medium=Bitrate(bitrate=1e4),
                    link=(Link(src=0, dst=1, order="fifo"),),
                )
            },
            "latency <lambda>, loss 0 %, unlimited range, heartbeat 5.5 s, medium bitrate (bitrate 10,000), "
            "1 link with other models",
        ),
        (
            {
                "network": Links(
                    medium=Bitrate(bitrate=1e4, access=Tdma(slot=0.03, guard=0.002), reception=CaptureEffect())
                )
            },
            "latency 0 s, loss 0 %, unlimited range, heartbeat 5.5 s, medium bitrate (bitrate 10,000), "
            "access tdma (slot 0.03, guard 0.002), interference capture (threshold 6, exponent 3)",
        ),
    ],
    ids=["constant", "without heartbeats", "models", "own", "contention"],
)
def test_the_header_names_the_conditions_of_the_network(change, said):
    assert conditions(FORTY.model_copy(update=change)) == said


@pytest.mark.slow
def test_the_key_has_only_what_the_run_contains():
    """By hand: a crash and jamming. With two evaders: neither fault nor loss."""
    one, two = ([line.removeprefix(": ") for line in Elements(replay_page(each)).lines] for each in (history(), pair()))
    assert {"crashed pursuer", "jammed area", "lost message", "evader"} <= set(one)
    assert "group of a partition" not in one
    assert not {"crashed pursuer", "jammed area", "lost message", "evader"} & set(two)
    assert "evader 2, captured" in two


@pytest.mark.slow
def test_the_key_tells_collisions_from_other_losses():
    """By hand: losses by chance, in the crash and from the queue; then a collision at 1, too."""
    sent = Broadcast(200 * MS, 9, 0, 9, (1,), (300 * MS,), 200 * MS, 24, ACTIVE)
    lost = Lost(300 * MS, 9, 0, 1, "collision")
    entries = {"lost message", "collision at its receiver"}
    shown = [
        {line.removeprefix(": ") for line in Elements(replay_page(each)).lines}
        for each in (history(), history(sent, lost))
    ]
    assert [entries & each for each in shown] == [{"lost message"}, entries]


def test_a_run_without_messages_lacks_none():
    mute = FORTY.model_copy(
        update={
            "horizon": 0.5,
            "record": Recording(),
            "announce": Announcements(trigger="never", start="silent"),
            "team": Team(count=2),
        }
    )
    assert messages(run(mute)).sent == 0
    assert "were not recorded" not in replay_page(run(mute))


# The command.


def invoke(*arguments):
    return CliRunner().invoke(main, ["replay", *map(str, arguments)])


@pytest.mark.whole
def test_the_page_of_a_folder_is_that_of_the_run(tmp_path, result_of):
    result = result_of("faults")
    write(result, tmp_path)
    done = invoke(tmp_path)
    assert done.exit_code == 0, done.output
    assert (tmp_path / "replay.html").read_text(encoding="utf-8") == replay_page(result)
    assert done.stdout.startswith(f"{tmp_path / 'replay.html'}: 10 pursuers, 10.13 s, ")
    assert not done.stderr


def test_a_scenario_file_is_run_with_all_that_can_be_looked_at(tmp_path):
    (tmp_path / "a.toml").write_text(
        "horizon = 0.2\nteam.count = 3\nrecord.trajectory = 0.0\nevader.position = [60.0, 60.0]\n"
    )
    done = invoke(tmp_path / "a.toml", "-o", tmp_path / "b.html", "-s", 4, "--set", "name=x")
    assert done.exit_code == 0, done.output
    assert not done.stderr
    page_of_it = (tmp_path / "b.html").read_text(encoding="utf-8")
    assert "<h1>x</h1>" in page_of_it
    assert "3 pursuers, sap, seed 4: not captured within 0.2 s" in page_of_it
    assert "<p>latency 0 s, loss 0 %, unlimited range, heartbeat 0.1 s</p>" in page_of_it
    document = json.loads(Elements(page_of_it).scripts[0])
    assert len(column(document["path"]["t"], "<u4")) == 1 + 4 + 1  # start; 0, 0.05, 0.1, 0.15 s; end
    assert document["messages"]["begin"]


@pytest.mark.slow
def test_the_page_of_a_trace_is_beside_it(tmp_path, monkeypatch):
    """As a picture of it is, wherever the command is called; the page of two is named after their folders."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("desim.results.run_folder.can_plot", lambda: False)  # a picture takes its time
    result = run(COLD.model_copy(update={"horizon": 0.1}))
    for name in ("one", "other"):
        write(result, tmp_path / name)
    done = invoke(Path("one", "trace.jsonl"))
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith(f"{Path('one', 'replay.html')}: ")
    done = invoke(Path("one", "trace.jsonl"), "other")
    assert done.stdout.startswith("one-other.html: ")
    assert sorted(each.name for each in tmp_path.rglob("*.html")) == ["one-other.html", "replay.html"]


@pytest.mark.slow
def test_data_that_cannot_be_shown_are_reported_on_stderr(tmp_path):
    write(run(COLD.model_copy(update={"horizon": 0.1, "record": Recording()})), tmp_path)
    done = invoke(tmp_path)
    assert done.exit_code == 0
    assert done.stderr.startswith("warning: Messages were not recorded: neither the ")


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("prepare", "words"),
    [
        (
            lambda folder: (folder / "trace.jsonl").unlink(),
            "has the run.json of 'run', but neither trace.jsonl nor sweep.sqlite",
        ),
        (lambda folder: (folder / "run.json").unlink(), "run.json: cannot be read: No such file"),
        (lambda folder: (folder / "trace.jsonl").write_text('{"event": "Eaten", "t": 0}\n'), "line 1 is not an event"),
        (lambda folder: (folder / "trace.jsonl").write_text(""), "is not complete"),
    ],
    ids=["no trace", "no run.json", "no event", "empty"],
)
def test_a_folder_that_is_not_of_a_run_is_refused(prepare, words, tmp_path):
    write(history(samples=()), tmp_path)
    prepare(tmp_path)
    done = invoke(tmp_path)
    assert done.exit_code == 2
    assert words in done.stderr
    assert "Traceback" not in done.output


def test_a_folder_of_several_runs_names_them(tmp_path):
    for seed in range(5):
        (tmp_path / f"seed-{seed}").mkdir()
        (tmp_path / f"seed-{seed}" / "trace.jsonl").touch()
    done = invoke(tmp_path)
    assert done.exit_code == 2
    assert "has no result itself, but its folders have (seed-0, seed-1, seed-2 ...): give one of them" in done.stderr


def test_a_recorded_run_cannot_be_shown_with_another_seed(tmp_path):
    for option in (("-s", 3), ("--set", "horizon=1.0")):
        done = invoke(tmp_path, *option)
        assert done.exit_code == 2
        assert "the results in a DIR are recorded" in done.stderr


def test_without_jinja_the_command_names_the_package_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    done = invoke(SCENARIOS / "relay.toml", "--set", "horizon=0.1", "-o", tmp_path / "x.html")
    assert done.exit_code == 2
    assert "no replay: jinja2 is missing: pip install" in done.stderr


@pytest.mark.slow
def test_a_page_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "no").touch()
    done = invoke(SCENARIOS / "relay.toml", "--set", "horizon=0.1", "-o", tmp_path / "no" / "x.html")
    assert done.exit_code == 2
    assert "x.html: cannot be written: " in done.stderr


# In a browser.


@pytest.fixture
def shown(browser, tmp_path):
    """Return what opens the page of a run, and judge in the end that nothing went wrong and nothing left the page."""
    path = tmp_path / "replay.html"

    def show(result, ghost=None, **window):
        path.write_text(replay_page(result, ghost), encoding="utf-8")
        browser.open(path, **window)
        return browser

    yield show
    assert browser.errors == []
    assert browser.requests == [path.resolve().as_uri()]


AMBER = """(() => {
  const copy = new OffscreenCanvas(arena.width, arena.height), hue = [0xe6, 0x9f, 0];
  const context = copy.getContext("2d", { willReadFrequently: true });
  context.drawImage(arena, 0, 0);
  const { data } = context.getImageData(0, 0, copy.width, copy.height);
  let count = 0;
  for (let k = 0; k < data.length; k += 4)
    if (hue.every((each, c) => Math.abs(each - data[k + c]) < 3) && data[k + 3] > 250) count++;
  return count;
})()"""
"""How many pixels of the plane have the colour of messages in flight."""


AT = """(t => {
  slider.value = t;
  slider.dispatchEvent(new Event("input"));
  replay.draw();
  return [replay.drawn.flying, flying.textContent, replay.drawn.lost];
})"""
"""Seeks a tick, as a hand would, and returns how many messages are drawn, are said to be in flight, and fade."""


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize("name", ["many", "soak", "crowded"])
def test_as_many_messages_are_drawn_as_the_trace_has_in_flight(name, shown, result_of):
    """Between the instants of the trace and, where a tick is a nanosecond, at some of them."""
    result = result_of(name)
    opened, tick = shown(result), round(replay_data(result)["tick"] * SECOND)
    edges = np.unique(spans(result))
    edges = edges[edges <= ended(result).t][:: max(len(edges) // 10, 1)]
    times = [*((edges[:-1] + edges[1:]) / 2).tolist(), ended(result).t, *(edges.tolist() if tick == 1 else [])]
    assert len(times) > 9
    drawn = opened.value(f"{json.dumps([t / tick for t in times])}.map({AT})")
    expected = [in_flight(result, t) for t in times]
    assert [found[:2] for found in drawn] == [[count, f"{count:,}"] for count in expected]
    assert max(expected) > 0
    fade = opened.value("Math.min(0.5 * speed.value, 1)") * SECOND
    lost = np.array([event.t for event in result.trace.of(Lost)])
    assert [found[2] for found in drawn] == [int(((lost <= t) & (t < lost + fade)).sum()) for t in times]


@in_chromium
@pytest.mark.slow
def test_counted_messages_are_visible(shown):
    """Nothing amber is on the plane while nothing flies; a dot has a radius of 2.8 px, 24 pixels, some at its rim."""
    one = Scenario(
        team=Team(positions=[(0.0, 0.0), (9.0, 9.0)], speeds=1.0, active_at_start=0.0),
        evader=Evader(position=(9.0, 0.0), speed=0.0),
        motion=Motion(static=True),
        horizon=2.0,
        announce=Announcements(heartbeat=1.5, trigger="heartbeat"),
        network=Links(latency=Constant(value=0.4)),
        protocol=SpatialAdaptivePlay(schedule=Poisson(rate=0.1)),
        record=ALL,
    )
    result = run(one)
    opened = shown(result)
    pixels = {}
    for t in np.arange(0.05, 2.0, 0.1).tolist():
        flying = opened.value(f"(replay.seek({t}), replay.drawn.flying)")
        assert flying == in_flight(result, t * SECOND)
        pixels.setdefault(flying, []).append(opened.value(AMBER))
    assert set(pixels[0]) == {0}
    assert min(pixels[max(pixels)]) >= 8 * max(pixels) > 0


@in_chromium
@pytest.mark.slow
def test_the_page_has_the_message_counts_of_the_trace(shown, result_of):
    for name in ("faults", "crowded"):
        tally = messages(result_of(name))
        opened = shown(result_of(name))
        opened.until("(replay.draw(), replay.scale > 1)")  # laid out
        found = opened.value("(replay.seek(1e9), replay.draw(), [replay.sent, replay.lost, replay.drawn.flying])")
        assert found == [tally.sent, tally.lost, tally.in_flight]


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize(("arrived", "said"), [(0, "250 (100 %)"), (1, "249 (99.6 %)"), (2, "248 (99 %)")])
def test_only_if_all_messages_are_lost_the_page_says_100_percent(arrived, said, shown):
    """Of 250 messages that are sent at once, some arrive."""
    sent = [Sent(k, k, 0, 1, LOST if k >= arrived else MS, k, 24, None) for k in range(250)]
    losses = [Lost(k, k, 0, 1, "loss") for k in range(arrived, 250)]
    events = [*chase(2, 1000).trace.events]
    events[1:1] = sorted([*sent, *losses], key=lambda event: event.t)
    events[-2] = MessageCounts(1000 * MS, 250, arrived, 250 - arrived, 0, {"loss": 250 - arrived}, 250, 6000, 0.0)
    trace = Trace()
    trace.events += events
    opened = shown(replace(chase(2, 1000), trace=trace))
    assert opened.value("(replay.seek(1), lost.textContent)") == said


@in_chromium
@pytest.mark.slow
def test_the_beliefs_of_the_page_match_the_trace_forwards_and_backwards(shown, result_of):
    """A tick is a nanosecond here, so that the exact instants of arrival are tested."""
    result = result_of("cold")
    opened = shown(result)
    lost = {(event.transmission, event.dst) for event in result.trace.of(Lost)}
    news = [
        event.arrival[-1]
        for event in result.trace.of(Broadcast)
        if event.arrival[-1] != LOST and (event.transmission, event.dst[-1]) not in lost and event.body.active
    ]
    stops = next(event.t for event in result.trace.of(Decided) if not event.active)
    for t in (3e8, 9e8, stops, news[0], news[5], news[0] - 1, 16e8, 2e8, 2e9, 0):
        opened.value(f"{AT}({t})")
        assert opened.value("wrong.textContent") == f"{wrong_now(result, t)} of 56"
    assert opened.value("replay.heard.filter((each, k) => k % 9 > 0 && each !== 2).length") == 0


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize(
    ("trust", "told"),
    [("none", "It lies; 11 teammates believe it."), ("plausible", "It lies; no teammate believes it.")],
)
def test_the_page_says_who_lies_and_how_many_believe_it(shown, trust, told):
    scenario = load(SCENARIOS / "liars.toml", [f"announce.trust.kind='{trust}'", "horizon=2.0"])
    result = run(scenario, 3)
    opened = shown(result)
    opened.value("(replay.seek(1.5), replay.choose(4), replay.draw())")
    opened.until(f"said.textContent.endsWith({json.dumps(told)})")
    assert replay_data(result)["faults"][0] == {
        "kind": "misbehaviour",
        "label": "liar 4",
        "begin": 0,
        "end": 2 * SECOND,
        "node": 4,
        "model": "liar",
    }


@in_chromium
@pytest.mark.slow
def test_the_page_shows_chases_and_captures_per_evader_as_in_the_trace(shown, result_of):
    """Just after decisions, just before and after captures, the latest first; a tick is 10 ns."""
    result = result_of("many")
    opened, tick = shown(result), round(replay_data(result)["tick"] * SECOND)
    seized = result.trace.of(Captured)
    decided = [event.t for event in result.trace.of(Decided)]
    times = [0, *(t + 2 * tick for t in decided[::25]), *(each.t + way * tick for each in seized for way in (-2, 2))]
    samples = [started(result), *result.trace.of(Sampled)]
    known = np.array([[*each.pursuers, *each.evaders] for each in samples])
    assert len(seized) == 3
    for t in sorted(times, reverse=True):
        opened.value(f"{AT}({t / tick})")
        actions, captured = profile(result, t)
        assert opened.value("[replay.truth, replay.captured]") == [actions, captured]
        there = [[np.interp(t, [each.t for each in samples], known[:, k, c]) for c in (0, 1)] for k in range(9)]
        assert opened.value("replay.players") == [pytest.approx(each, abs=2e-3) for each in there]
        assert opened.value("wrong.textContent") == f"{wrong_now(result, t)} of 30"
        assert opened.value("caught.textContent") == f"{len(captured)} of 3"
    assert {len(profile(result, t)[1]) for t in times} == {0, 1, 2, 3}


def profile(result, t):
    """Return the actions at a time (ns), and the captured evaders with their capturers.

    The pursuers of an evader that is captured at the end of the run chase it until then.
    """
    actions, captured, end = list(started(result).active), [], result.trace.of(Ended)[0].t
    for event in result.trace:
        if event.t > t:
            break
        if isinstance(event, Decided):
            actions[event.pursuer] = event.active
        elif isinstance(event, Captured):
            actions = [0 if each == event.evader and event.t < end else each for each in actions]
            captured.append([event.evader, event.capturer])
    return actions, captured


@in_chromium
@pytest.mark.slow
def test_with_two_evaders_the_texts_name_the_evader(shown):
    opened = shown(pair())
    text = "(t => (replay.seek(t), [caught, chasing, said, document.getElementById('event')].map(e => e.textContent)))"
    opened.value("replay.choose(0)")
    assert opened.value(f"{text}(0.25)") == [
        "0 of 2",
        "1: 0\n2: 1, 2",
        "0 chases 1 (1 m/s), receives from 2 teammates and believes that 1, 2 chase 2.",
        "0.150 s: 1 chases 2; 0 is active alone on 1",
    ]
    assert opened.value(f"{text}(0.12)")[2].endswith("believes that 1 chases 1 and 2 chases 2.")
    assert opened.value(f"{text}(0.401)") == [
        "1 of 2",
        "1: captured by 0\n2: 0, 1",
        "0 chases 2 (1 m/s), receives from 2 teammates and believes that 1 chases 2.",
        "0.400 s: 0 chases 2; 0 captures evader 1",
    ]
    assert opened.value(f"{text}(0.701)")[3] == "0.700 s: 1 is inactive; 1 hands over 2 to 0"
    assert opened.value(f"{text}(2)") == [
        "2 of 2",
        "1: captured by 0\n2: captured by 0",
        "0 chases 2 (1 m/s), receives from 2 teammates and believes that 1 chases 2.",
        "1.000 s: 0 captures evader 2",
    ]
    for key in ("Home", "e", "ArrowRight"):
        opened.press(key)
    assert opened.value("[kind.value, replay.time]") == ["captures", pytest.approx(0.4)]


HUE = """((x, y, up) => {
  const [left, top] = replay.pixel(x, y).map(each => Math.round(each * devicePixelRatio));
  const copy = new OffscreenCanvas(1, 1), context = copy.getContext("2d");
  context.drawImage(arena, -left, up - top);
  return [...context.getImageData(0, 0, 1, 1).data].slice(0, 3);
})"""
"""The colour of the plane so many pixels above a place."""


@in_chromium
@pytest.mark.slow
def test_an_evader_is_a_diamond_and_after_its_capture_a_star_where_it_rests(shown):
    """6 px above its middle there is no number, and the capture circle is smaller."""
    opened = shown(pair())
    opened.until("(replay.draw(), replay.scale > 1)")
    vermilion, ink = [0xD5, 0x5E, 0x00], [0x1C, 0x20, 0x24]
    for t, one, other, hues in (
        (0.3, 5.3, 8.3, [vermilion] * 2),
        (0.6, 5.4, 8.6, [ink, vermilion]),
        (2, 5.4, 9, [ink] * 2),
    ):
        opened.value(f"replay.seek({t})")
        assert [opened.value(f"{HUE}(5, {one}, 6)"), opened.value(f"{HUE}({other}, 2, 6)")] == hues


@in_chromium
@pytest.mark.slow
def test_a_line_leads_from_a_pursuer_to_the_evader_that_it_chases(shown):
    """Half way from 0, which runs along x at 4 m/s, to evader 1 and, from 400 ms on, to evader 2; the other is free."""
    opened = shown(pair())
    opened.until("(replay.draw(), replay.scale > 1)")
    for t, expected in ((0.2, [True, False]), (0.6, [False, True]), (2.0, [False, True])):
        opened.value(f"replay.seek({t})")
        drawn = []
        for x, y in ((5, 5 + min(t, 0.4)), (8 + min(t, 1.0), 2)):
            begin = 4 * min(t, 1.0)
            way = [(begin + share * (x - begin), share * y) for share in np.linspace(0.4, 0.6, 21).tolist()]
            hues = [opened.value(f"{HUE}({left}, {high}, 0)") for left, high in way]
            drawn.append(sum(hue[0] > 150 and hue[2] < 120 for hue in hues) > 3)
        assert drawn == expected


TINTED = """(() => {
  const copy = new OffscreenCanvas(arena.width, arena.height), context = copy.getContext("2d");
  context.drawImage(arena, 0, 0);
  const { data } = context.getImageData(0, 0, copy.width, copy.height);
  let count = 0;
  for (let k = 3; k < data.length; k += 4) if (Math.abs(data[k] - 0.13 * 255) < 2) count++;
  return count / replay.scale ** 2;
})()"""
"""On how many square metres of the plane there is nothing but what is seen."""


@in_chromium
@pytest.mark.slow
def test_the_sensing_range_is_a_disc_to_scale_that_can_be_hidden(shown):
    """Of a radius of 2 m, 4 pi square metres less what lines and pursuers cover; twice seen is not darker."""
    opened = shown(run(SEEING))
    opened.until(f"(replay.draw(), {TINTED} > 0)")
    assert opened.value(f"(replay.draw(), {TINTED})") == pytest.approx(4 * np.pi, rel=0.08)
    assert "sensing range of a pursuer" in opened.value("document.querySelector('.key').textContent")
    opened.press("s")
    assert opened.value(f"(replay.draw(), {TINTED})") < 0.01


@in_chromium
@pytest.mark.slow
def test_with_one_always_visible_evader_no_text_mentions_others_or_sensing(shown, result_of):
    opened = shown(result_of("relay"))
    said = opened.value("document.body.innerText + document.querySelector('#keys').textContent")
    assert not {"Captured", "sensing", "evader 2", "captures"} & set(re.findall(r"evader \d|\w+", said))
    assert opened.value("['sight', 'caught'].map(id => document.getElementById(id))") == [None, None]


# Without latency the receivers of a broadcast are those linked to its sender at that instant; the pursuers move and
# are sampled at every step. Edges are one-way from each node to the next three.
AT_ONCE = Scenario(
    name="at once",
    horizon=2.0,
    team=Team(count=8, speeds=3.0),
    evader=Evader(position=(30.0, 22.0)),
    protocol=SpatialAdaptivePlay(schedule=Poisson(rate=2.0)),
    announce=Announcements(heartbeat=0.15),
    record=Recording(messages=True, trajectory=0.01),
)
ONE_WAY = Edges(directed=True, edges=tuple(Edge(src=k, dst=(k + step) % 8) for k in range(8) for step in (1, 2, 3)))
JAM = Jamming(centre=(10.0, 10.0), radius=6.0, start=0.5, end=1.5)
DOWN = Crash(node=3, start=0.4, end=1.2, scope="radio"), Crash(node=5, start=0.8)
LINKED = {
    "ring": {"network": Links(graph=Ring())},
    "frozen luck": {"network": Links(range=8.0, reception=LOG)},
    "all": {
        "network": Links(graph=ONE_WAY, range=12.0, reception=QuasiUnitDisk(), range_check="delivery"),
        "fault": (JAM, *DOWN, Partition(start=1.0, end=1.6, groups=((0, 1, 4), (5, 6)))),
    },
}


@pytest.mark.whole_but_one
@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize("name", LINKED)
def test_the_page_shows_the_links_of_the_network(name, shown):
    """A broadcast is received, at that instant, by the pursuers that the page shows as linked from its sender."""
    result = run(AT_ONCE.model_copy(update=LINKED[name]))
    lost = {(event.transmission, event.dst) for event in result.trace.of(Lost)}
    spoke = result.trace.of(Broadcast)
    heard = [sorted(dst for dst in event.dst if (event.transmission, dst) not in lost) for event in spoke]
    opened = shown(result)
    asked = json.dumps([(event.t / SECOND, event.src) for event in spoke])
    hearers = "all.flatMap((sources, i) => sources.includes(src) ? [i] : [])"
    assert opened.value(f"{asked}.map(([t, src]) => (replay.seek(t), (all => {hearers})(replay.hears)))") == heard
    assert len({len(each) for each in heard}) > (name != "ring")


@in_chromium
@pytest.mark.slow
def test_a_pursuer_with_a_broken_radio_has_no_links(shown):
    """3 is down from 0.4 s to 1.2 s, 5 from 0.8 s on."""
    opened = shown(run(AT_ONCE.model_copy(update={"fault": DOWN})))
    for t, deaf in ((0.39, set()), (0.4, {3}), (0.8, {3, 5}), (1.2, {5}), (2.0, {5})):
        hears = opened.value(f"(replay.seek({t}), replay.hears)")
        up = set(range(8)) - deaf
        assert hears == [sorted(up - {k}) if k in up else [] for k in range(8)]


@in_chromium
@pytest.mark.slow
def test_one_way_and_two_way_links_are_drawn_differently(shown):
    """Pursuer 3 receives from 0 to 2 and is received by 4 to 6; the plane differs from that of links of both ways."""
    planes = []
    for graph in (ONE_WAY, Edges(edges=ONE_WAY.edges)):
        change = {"network": Links(graph=graph), "announce": Announcements(trigger="never"), "horizon": 0.1}
        opened = shown(run(AT_ONCE.model_copy(update=change)))
        planes.append(opened.value("(replay.choose(3), document.getElementById('arena').toDataURL())"))
        said = "receives from 3 teammates, reaches 3 and" if graph is ONE_WAY else "receives from 6 teammates and"
        assert said in opened.value("document.getElementById('said').textContent")
    assert planes[0] != planes[1]


@in_chromium
@pytest.mark.slow
def test_random_links_are_labelled_as_such(shown):
    opened = shown(run(AT_ONCE.model_copy(update={"network": Links(range=8.0, reception=LOG, fading="message")})))
    assert "reception probability 0.5 or more" in opened.value("document.querySelector('.key').textContent")
    assert "with probability 0.5 or more" in opened.value("(replay.choose(3), said.textContent)")


@in_chromium
@pytest.mark.slow
def test_messages_fly_between_where_they_were_sent_and_where_they_arrive(shown):
    """By hand: from (1, 0) at 100 ms to (10, 0) at 200 ms; at 160 ms it is at 6.4 m, though its sender has gone on.

    A message that waits is at its sender, one that is lost is just before its receiver.
    """
    opened = shown(history(samples=range(0, 1001, 100)))
    opened.until("(replay.draw(), replay.scale > 1)")

    def places(t):
        """Return where the messages are at a time, s, and the radius of a player, both at the present scale."""
        found = opened.value(f"(replay.seek({t}), [replay.places, 9 / replay.scale])")
        return *(found[0][kind] for kind in ("flying", "lost")), found[1]

    def between(source, target, share, rim):
        way = np.subtract(target, source)
        unit = way / np.hypot(*way)
        return pytest.approx(np.add(source, unit * rim + share * (way - 2 * rim * unit)).tolist(), abs=1e-6)

    flying, lost, rim = places(0.16)
    assert flying == [between((1, 0), (10, 0), 0.6, rim)]
    assert lost == [between((1, 0), (0, 10), 1.0, rim)]
    flying, _, rim = places(0.28)
    assert flying == [between((0, 10), (4, 0), 0.0, rim)]
    flying, _, rim = places(0.45)
    assert flying == [between((0, 10), (4, 0), 0.75, rim)]
    _, lost, rim = places(0.55)
    assert lost == [between((0, 10), (4, 0), 1.0, rim)]
    flying, _, rim = places(1.0)
    assert flying[-1] == between((4, 0), (10, 0), 0.0, rim)


@in_chromium
@pytest.mark.slow
def test_the_players_of_a_ghost_are_where_they_were_and_stay_where_it_ended(shown, result_of):
    """A ghost of other players, of 2 s, in a run of 10 s; the positions of its trace are linear between samples."""
    ghost = result_of("cold")
    opened = shown(result_of("faults"), ghost)
    known = [started(ghost), *ghost.trace.of(Sampled)]
    places = np.array([[*each.pursuers, *each.evaders] for each in known])
    assert len(started(ghost).active) == 8
    for t in (0.0, 0.5, 1.234, 2.0, 3.0, 9.0):
        there = [[np.interp(t * SECOND, [each.t for each in known], places[:, k, c]) for c in (0, 1)] for k in range(9)]
        found = opened.value(f"(replay.seek({t}), replay.ghost)")
        assert found == [pytest.approx(each, abs=2e-3) for each in there]
    assert opened.value("replay.players.length") == 11


SHADOW = """((canvas) => {
  const look = () => {
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
    replay.draw();
    copy.drawImage(canvas, 0, 0);
    return copy.getImageData(0, 0, canvas.width, canvas.height).data;
  };
  const shown = look(), width = canvas.width, found = [];
  other.click();
  const hidden = look();
  other.click();
  replay.draw();
  for (let k = 0; k < shown.length; k++)
    if (shown[k] !== hidden[k]) found.push([(k >> 2) % width, Math.floor((k >> 2) / width)]);
  return found;
})"""
"""The pixels of a canvas that change if the ghost is hidden."""


def settle(opened):
    """Wait until the canvases have their sizes, which follow those of the lanes of faults and evaders."""
    opened.until("(replay.draw(), replay.scale > 1)")
    opened.value("""new Promise(done => {
      let left = 10;
      const wait = () => left-- ? requestAnimationFrame(wait) : done();
      wait();
    })""")


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_ghost_is_drawn_as_hollow_marks_and_thin_trails(shown, theme):
    """By hand: a pursuer of the ghost has gone from (20, -3) to (20, 3), and its evader from (20, 15) to (20, 20).

    A circle has a radius of 4.5 px, a diamond of 7 px; a trail, a straight line here, is a pixel wide, or two.
    """
    opened = shown(history(), chase(1, 1000), theme=theme)
    settle(opened)
    opened.value("replay.seek(1)")
    pixels = opened.value("[[20, 3], [20, 20], [20, -3], [20, 15]].map(([x, y]) => replay.pixel(x, y))")
    assert opened.value("replay.ghost") == [[20.0, pytest.approx(y, abs=2e-3)] for y in (3, 20)]
    circle, diamond, *start = np.array(pixels)
    opened.value("trails.click()")
    changed = np.array(opened.value(f"{SHADOW}(arena)")) + 0.5
    from_circle, from_diamond = np.hypot(*(changed - circle).T), np.abs(changed - diamond).sum(axis=1)
    on_circle, on_diamond = np.abs(from_circle - 4.5) < 1.5, np.abs(from_diamond - 7.0) < 2.0
    assert (on_circle | on_diamond).all()
    assert min(on_circle.sum(), on_diamond.sum()) > 20
    opened.value("trails.click()")
    trails = np.array(opened.value(f"{SHADOW}(arena)")) + 0.5
    new = np.array([each for each in trails.tolist() if each not in changed.tolist()])
    assert (np.abs(new[:, 0] - circle[0]) < 1.6).all()
    spans = [range(*sorted((int(a[1]), int(b[1])))) for a, b in zip((circle, diamond), start, strict=True)]
    rows = {int(y) for y in np.concatenate([new, changed])[:, 1]}
    assert rows >= {y for span in spans for y in span}
    assert all(min(map(min, spans)) - 9 <= y <= max(map(max, spans)) + 9 for y in rows)
    opened.press("o")
    assert opened.value("other.checked") is False


@in_chromium
@pytest.mark.slow
def test_the_last_number_of_a_long_time_axis_is_not_cut(shown):
    """The number at the end of the axis is centred 8 px before the edge of the canvas, so a long one is moved."""
    ends = """(() => {
      const ends = {}, write = CanvasRenderingContext2D.prototype.fillText;
      CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
        if (this.textAlign === "center") ends[text] = x + this.measureText(text).width / 2;
        write.call(this, text, x, y);
      };
      document.getElementById("theme").click();  // draws the axis anew
      replay.draw();
      CanvasRenderingContext2D.prototype.fillText = write;
      return ends;
    })()"""
    opened = shown(chase(1, 5_000_000))
    edge, ends_of = opened.value("axis.clientWidth"), opened.value(ends)
    assert {"0 s", "5000"} <= ends_of.keys()
    assert edge - 1 <= ends_of["5000"] <= edge


@in_chromium
@pytest.mark.slow
def test_the_active_pursuers_of_a_ghost_are_dashed_in_the_scale_of_both(shown):
    """By hand: 2 are active in the run from 400 ms to 700 ms, always in one ghost of 0.5 s; in the other, 5 are."""
    texts = """(() => {
      const said = [], write = CanvasRenderingContext2D.prototype.fillText;
      CanvasRenderingContext2D.prototype.fillText = function (...given) {
        said.push(`${given[0]}`);
        write.apply(this, given);
      };
      other.click(); other.click(); replay.draw();
      CanvasRenderingContext2D.prototype.fillText = write;
      return said;
    })()"""
    opened = shown(pair(), chase(2, 500))
    settle(opened)
    assert "3" in opened.value(texts)
    xs, ys = np.array(opened.value(f"{SHADOW}(axis)")).T
    first, last = opened.value("[slider.offsetLeft + 8, axis.clientWidth - 8]")
    middle = (first + last) / 2
    assert first - 1 <= xs.min() <= first + 1
    assert abs(xs.max() - middle) <= 1
    level = np.bincount(ys).argmax()
    dashes = np.diff(np.unique(xs[ys == level]))  # 4 px each, and 3 px between them
    assert (dashes > 1).sum() == pytest.approx((middle - first) / 7, abs=3)
    top = opened.value(f"""(() => {{  // of the strip at 0.643 s, between grid lines
      const {{ data }} = axis.getContext("2d").getImageData({round(first + 0.643 * (last - first))}, 0, 1, 60);
      return [...Array(60).keys()].find(y => data[4 * y + 3] > 100 && data[4 * (y + 2) + 3] > 100);
    }})()""")
    assert abs(top - level) <= 2  # of some 12 px for one pursuer
    opened = shown(pair(), chase(5, 500))
    settle(opened)
    assert "5" in opened.value(texts)


@in_chromium
@pytest.mark.slow
def test_a_page_around_the_replay_controls_speed_and_theme(shown, result_of):
    opened = shown(result_of("relay"))
    assert opened.value("[replay.end, replay.chosen, replay.ghost]") == [1.0, -1, None]
    assert opened.value("(replay.choose(4), replay.chosen)") == 4
    assert opened.value("(replay.speed = 0.5, [replay.speed, +speed.value])") == [0.5, 0.5]
    assert opened.value("(replay.speed = 30, replay.speed)") == 10
    for theme in ("dark", "light"):
        assert opened.value(f"(replay.setTheme('{theme}'), replay.theme)") == theme
        assert opened.value("document.documentElement.dataset.theme") == theme


@in_chromium
@pytest.mark.slow
def test_play_goes_on_pause_stops_and_the_end_is_the_end(shown, result_of):
    opened = shown(result_of("relay"))
    assert opened.value("[replay.time, replay.playing]") == [0, False]
    opened.value("document.getElementById('play').click()")
    opened.until("replay.time > 0.02 && replay.frames > 3")
    opened.value("document.getElementById('play').click()")
    there = opened.value("replay.time")
    assert 0.02 < there < 1.0
    opened.value("new Promise(done => setTimeout(done, 100))")
    assert opened.value("[replay.time, replay.playing]") == [there, False]
    opened.value("(replay.seek(0.99), replay.play())")
    opened.until("!replay.playing")
    assert opened.value("replay.time") == 1.0


@in_chromium
@pytest.mark.slow
def test_the_plane_is_saved_as_a_picture_named_after_the_run_and_the_time(shown, result_of):
    opened = shown(result_of("relay"))
    opened.value("""
      HTMLAnchorElement.prototype.click = function () { window.saved = [this.download, this.href]; };
      replay.seek(0.5); save.click()
    """)
    name, address = opened.value("saved")
    assert name == "relay-0.500s.png"
    assert b64decode(address.removeprefix("data:image/png;base64,")).startswith(b"\x89PNG")


@in_chromium
@pytest.mark.slow
def test_the_slider_seeks(shown, result_of):
    opened = shown(result_of("relay"))
    slide = "(s => { s.value = 0.5 * s.max; s.dispatchEvent(new Event('input')); })(document.getElementById('slider'))"
    opened.value(slide)
    assert opened.value("replay.time") == 0.5
    opened.until("document.getElementById('clock').textContent.startsWith('0.500')")
    before = opened.value("document.getElementById('arena').toDataURL()")
    opened.value("replay.seek(0.7)")
    assert opened.value("document.getElementById('arena').toDataURL()") != before
    assert opened.value("+document.getElementById('slider').value * 1e-9") == pytest.approx(0.7)
    x, y = opened.value("(({ x, y, width }) => [x + 8 + 0.25 * (width - 16), y + 20])(slider.getBoundingClientRect())")
    for kind in ("mousePressed", "mouseReleased"):
        opened.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    assert opened.value("replay.time") == pytest.approx(0.25, abs=0.01)


@in_chromium
@pytest.mark.slow
def test_the_address_names_the_time_and_the_selected_pursuer(shown, result_of):
    """The address follows when the page has rested, and leads to the same state; a senseless one is ignored."""
    opened = shown(result_of("relay"))
    opened.value("new Promise(done => setTimeout(done, 400))")
    assert opened.value("location.hash") == ""
    opened.value("replay.seek(0.5)")
    opened.until("location.hash === '#t=0.5'")
    for address, t in (("t=0.75&p=4", 0.75), ("t=99", 1.0), ("t=x&p=99", 1.0), ("p=3", 1.0), ("t=-1", 1.0)):
        opened.value(f"new Promise(done => {{ onhashchange = done; location.hash = {address!r}; }})")
        assert opened.value("replay.time") == t
    assert opened.value("(replay.draw(), said.textContent)").startswith("3 is ")
    opened.value("location.hash = 't=0.25&p=4'")
    opened.until("Math.abs(replay.time - 0.25) < 1e-9")
    opened.send("Page.reload")
    opened.until("Math.abs(window.replay?.time - 0.25) < 1e-9 && said.textContent.startsWith('4 is ')")
    opened.errors.clear()
    opened.requests[:] = opened.requests[:1]


@in_chromium
@pytest.mark.slow
def test_steps_lead_from_event_to_event(shown, result_of):
    """By key: the right arrow to where an action changed, the left one back; E to another kind of event."""
    result = result_of("faults")
    opened = shown(result)
    active, changed = list(started(result).active), []
    for event in result.trace:
        if isinstance(event, Decided | BrokeDown):
            now = isinstance(event, Decided) and event.active
            if active[event.pursuer] != now:
                active[event.pursuer] = now
                changed.append(event.t / SECOND)
    changed = sorted(set(changed))
    for t in changed[:5]:
        opened.press("ArrowRight")
        assert opened.value("replay.time") == pytest.approx(t, abs=1e-8)
    opened.press("ArrowLeft")
    assert opened.value("replay.time") == pytest.approx(changed[3], abs=1e-8)
    opened.press("Home")
    for _ in range(3):
        opened.press("e")
    assert opened.value("document.getElementById('kind').value") == "faults"
    opened.press("ArrowRight")
    assert opened.value("replay.time") == pytest.approx(result.trace.of(FaultStarted)[0].t / SECOND, abs=1e-8)
    for focus in ("document.body", "play", "theme", "speed", "slider", "links", "kind"):
        opened.value(f"(element => element.focus())({focus})")
        before = opened.value("[document.documentElement.dataset.theme, links.checked, speed.value, kind.value]")
        for playing in (True, False):
            opened.press(" ", " ")
            assert opened.value("replay.playing") is playing, focus
        assert before == opened.value(
            "[document.documentElement.dataset.theme, links.checked, speed.value, kind.value]"
        )
    opened.value("links.focus()")
    opened.press("Enter", "\r")
    assert not opened.value("links.checked")


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "height", "theme"),
    [(1280, 800, "light"), (1280, 800, "dark"), (1000, 700, "light"), (360, 800, "light")],
)
def test_a_page_fits_its_window_and_the_light(width, height, theme, shown, result_of):
    """On a desktop nothing scrolls, and the bar covers nothing; the key is beside the plane, or opens above it."""
    opened = shown(result_of("faults"), width=width, height=height, theme=theme)
    assert opened.value("document.documentElement.scrollWidth") <= width
    assert opened.value("key.hidden") is (width < 900)
    if width < 900:
        opened.press("k")
    bottom = "document.querySelector('footer').getBoundingClientRect().top"
    opened.value("replay.seek(2)")
    opened.until(f"Math.max(...[key, stage].map(each => each.getBoundingClientRect().bottom)) <= {bottom}")
    if width > 860:
        assert opened.value("document.documentElement.scrollHeight") <= height
        assert opened.value(f"said.getBoundingClientRect().bottom <= {bottom}")
    if width >= 1200:
        assert opened.value("key.scrollHeight <= key.clientHeight")
    assert opened.value("document.documentElement.dataset.theme") == theme
    opened.press("t")
    assert opened.value("document.documentElement.dataset.theme") != theme
    small = "[...document.querySelectorAll('button, select')].filter(b => b.offsetHeight && b.offsetHeight < 40)"
    assert opened.value(f"{small}.length") == 0


@in_chromium
@pytest.mark.slow
def test_a_tap_chooses_a_pursuer(shown, result_of):
    """The legend below the matrix shows its beliefs; a second tap lets it go."""
    opened = shown(result_of("faults"), width=390, height=844)
    opened.value("document.getElementById('matrix').scrollIntoView()")
    left, top, size = opened.value("(({ x, y, width }) => [x, y, width])(matrix.getBoundingClientRect())")
    x, y = left + 60, top + 18 + (size - 18) * 0.75
    for said in ("7 is active (1 m/s), receives from 9 teammates", "Point at a cell"):
        for kind in ("mousePressed", "mouseReleased"):
            opened.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        opened.send("Input.dispatchMouseEvent", type="mouseMoved", x=2, y=2)
        opened.until(f"document.getElementById('said').textContent.startsWith({said!r})")


@in_chromium
@pytest.mark.slow
def test_a_browser_shows_a_hostile_name_as_text(shown):
    opened = shown(run(FORTY.model_copy(update={"horizon": 0.2})))
    assert opened.value("document.querySelector('h1').textContent") == HOSTILE
    assert opened.value("window.hurt") is None


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        {"record": Recording(trajectory=0.0)},
        {"team": Team(count=1)},
        {"team": Team(positions=[(1.0, 1.0)]), "evader": Evader(position=(1.0, 1.0))},
        {"announce": Announcements(trigger="never")},
        {"motion": Motion(static=True)},
    ],
    ids=["nothing recorded", "alone", "captured at once", "nobody speaks", "frozen"],
)
def test_a_page_works_also_if_there_is_little_to_show(change, shown):
    opened = shown(run(COLD.model_copy(update={"horizon": 0.7} | change)))
    opened.value("(replay.seek(0.5), replay.play())")
    opened.until("!replay.playing || replay.time > 0.6")
    for key in ("ArrowRight", "ArrowLeft", "+", "-", "l", "r", "End"):
        opened.press(key)
    assert opened.value("document.querySelectorAll('.warning:not(noscript *)').length") == 2 * ("record" in change)


@in_chromium
@pytest.mark.slow
def test_a_page_with_errors_or_external_requests_would_be_detected(browser, tmp_path):
    path = tmp_path / "bad.html"
    path.write_text(
        "<img src='http://127.0.0.1:9/x.png'>"
        "<script>console.error('no'); setTimeout(() => { throw Error('no') })</script>"
    )
    browser.open(path)
    browser.until("document.readyState === 'complete'")
    assert len(browser.errors) >= 2
    assert "http://127.0.0.1:9/x.png" in browser.requests


CROWD = Scenario(
    name="crowd",
    horizon=0.3,
    team=Team(count=90, speeds=0.95),
    evader=Evader(position=(30.0, 22.0)),
    protocol=SpatialAdaptivePlay(schedule=Poisson(rate=1.0)),
    network=Links(latency=Constant(value=0.1), loss=Bernoulli(p=0.05)),
    record=ALL,
)


@pytest.mark.slow
def test_messages_that_arrive_alike_take_less_than_two_bytes_each():
    data = replay_data(run(CROWD))
    assert len(json.dumps([data["messages"], data["beliefs"]])) / messages(run(CROWD)).sent < 2.0


@pytest.mark.parametrize(("count", "is_large"), [(999, False), (1000, True)])
def test_a_replay_of_a_thousand_pursuers_is_announced_as_large(count, is_large):
    warning = size_warning(Scenario(team=Team(count=count)))
    assert ("999 messages" in warning) if is_large else warning is None


def test_the_command_warns_of_a_large_replay_before_the_run(monkeypatch, tmp_path):
    def stop(*_):
        raise RuntimeError("the run has begun")

    monkeypatch.setattr("desim.cli.pages.result_of", stop)
    command = ["replay", str(SCENARIOS / "relay.toml"), "--set", "team.count=1000", "-o", str(tmp_path / "r.html")]
    done = CliRunner().invoke(main, command)
    assert done.stderr.startswith(f"warning: {SCENARIOS / 'relay.toml'}: 1,000 pursuers")
    assert "the run has begun" in str(done.exception)


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize(("scenario", "few"), [(CROWD, True), (COLD, False)], ids=["90 pursuers", "8 pursuers"])
def test_labels_of_a_crowd_are_those_of_the_selected_and_of_few_active_ones(scenario, few, shown):
    opened = shown(run(scenario))
    opened.value("replay.seek(0.05); 0")
    labels = opened.value("replay.drawn.labels")
    assert labels == 0 if few else labels > 4
    opened.value("replay.choose(3)")
    assert opened.value("replay.drawn.labels") == (1 if few else labels)


@in_chromium
@pytest.mark.slow
def test_the_state_of_a_crowd_is_that_of_the_trace_forwards_and_backwards(shown):
    result = run(CROWD)
    opened = shown(result)
    for t in (0.25, 0.05, 0.0, 0.15, 0.3):
        opened.value(f"replay.seek({t}); 0")
        wrong = int(opened.value("wrong.textContent").split()[0].replace(",", ""))
        assert wrong == wrong_now(result, round(t * SECOND))
        assert opened.value("replay.drawn.flying") == in_flight(result, round(t * SECOND))


@in_chromium
@pytest.mark.slow
def test_thousands_of_messages_are_set_as_pixels_in_their_colour(shown):
    opened = shown(run(CROWD))
    opened.value("replay.seek(0.05); 0")
    assert opened.value("replay.drawn.flying") > 1500
    assert opened.value(AMBER) > 1500


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize("motion", ["reduce", "no-preference"])
def test_a_replay_begins_to_play_unless_the_system_wishes_for_little_motion(motion, shown):
    opened = shown(run(COLD), motion=motion)
    assert opened.value("replay.playing") is (motion == "no-preference")
    if motion == "no-preference":
        opened.until("replay.time > 0")


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize(("width", "height", "open_"), [(962, 640, True), (880, 1200, False), (1280, 800, True)])
def test_the_key_is_open_where_the_height_limits_the_plane_anyway(width, height, open_, shown):
    opened = shown(run(COLD), width=width, height=height)
    assert opened.value("!document.getElementById('key').hidden") is open_


@pytest.mark.parametrize(
    ("end", "shortest", "length"), [(10**9, 1, 1), (10**9, 10_000, 10_000), (10**14, 10_000, 100_000)]
)
def test_a_tick_is_not_shorter_than_asked(end, shortest, length):
    assert Ticks.fit(end, 0, shortest).length == length


def test_a_transmission_without_receivers_hides_no_other():
    """The first of a run has nobody in its range, so the numbers of those that are shown begin at 1."""
    more = [Broadcast(10 * MS, 1, 0, 1, (1, 2), (20 * MS, 30 * MS), 10 * MS, 24, ACTIVE)]
    empty = Broadcast(5 * MS, 0, 0, 1, (), (), 5 * MS, 24, ACTIVE)
    messages = replay_data(history(empty, *more, messages=False))["messages"]
    assert column(messages["count"], "<u2").tolist() == [2]


def test_the_causes_of_losses_are_words():
    lost = Lost(100 * MS, 0, 0, 2, "half_duplex")
    sent = Broadcast(100 * MS, 0, 0, 1, (1, 2), (200 * MS, LOST), 100 * MS, 24, ACTIVE)
    assert "half duplex" in replay_data(history(sent, lost, messages=False))["messages"]["causes"]

"""Recorded motion of evaders and relays: they are where the record says, and captures stay exact."""

from math import inf, isclose

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from desim import Evader, Motion, RecordedMotion, Recording, RelayNode, Scenario, Team, load, run, summary
from desim.config.errors import KeyedError
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Captured, Decided, Sampled
from desim.scenario.checks import warnings
from desim.study.plan.config_hash import identify
from desim.testing.pursuits import watched
from tests.kernel.test_mobility_file import Waypoint, interpolated

times = st.lists(st.floats(0.0, 3.0), min_size=1, max_size=5, unique_by=lambda t: round(t * 1e6)).map(sorted)
places = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))


@st.composite
def records(draw):
    return RecordedMotion(waypoints=[(t, *draw(places)) for t in draw(times)])


def path_of(record):
    """Return the waypoints of a record, from time 0 on."""
    waypoints = [Waypoint(*each, 0) for each in record.waypoints]
    return [*([waypoints[0]._replace(t=0.0)] if waypoints[0].t > 0.0 else []), *waypoints]


@pytest.mark.whole
@settings(max_examples=20)
@given(records(), records(), st.sampled_from([0.01, 0.07, 5.0]), st.sampled_from(["evader_first", "simultaneous"]))
def test_an_evader_and_a_relay_are_where_their_records_say(record, other, step, order):
    """Whatever the motion step; within 1 ns of motion, as times are whole nanoseconds."""
    assume(max(record.top_speed, other.top_speed) < 1e8)
    scenario = Scenario(
        horizon=4.0,
        prune="none",
        team=Team(count=3, box=(100.0, 110.0), relay=[RelayNode(pursuer=1, motion=other)]),
        evader=Evader(speed=max(record.top_speed, 0.1), strategy=record),
        motion=Motion(step=step, order=order),
        record=Recording(trajectory=0.11),
    )
    result = watched(scenario, 1)
    assert not [each for each in result.trace.of(Decided) if each.pursuer == 1 and each.active]
    if not result.trace.of(Captured):
        for sample in result.trace.of(Sampled):
            for found, own in ((sample.evaders[0], record), (sample.pursuers[1], other)):
                off = abs(complex(*found) - interpolated(path_of(own), sample.t / SECOND))
                assert off <= 1e-9 * (1.0 + own.top_speed)


def chased(turn, step):
    """Return a pursuit along the x axis: an evader at 1 m/s from 0 turns round at a time (s)."""
    waypoints = [(0.0, 0.0, 0.0), (turn, turn, 0.0), (2.0 * turn, 0.0, 0.0)]
    return Scenario(
        horizon=2.0 * turn,
        team=Team(positions=[(-3.0, 0.0)], speeds=1.5),
        evader=Evader(speed=1.0, strategy=RecordedMotion(waypoints=waypoints)),
        motion=Motion(step=step, order="simultaneous"),
        protocol="best_response",
        record=Recording(trajectory=0.0),
    )


@pytest.mark.parametrize("step", [0.01, 0.3, 10.0])
def test_a_capture_between_waypoints_is_exact(step, monkeypatch):
    """The gap is 3 m; it closes at 0.5 m/s until the turn at 3.123456789 s, and at 2.5 m/s from then on.

    That holds for any motion step because steps end at waypoints; without this it is off by a part of a step.
    """
    turn = 3.123456789
    scenario = chased(turn, step)
    wanted = turn + (3.0 - 0.1 - 0.5 * turn) / 2.5
    assert isclose(summary(run(scenario, 0)).capture_time, wanted, abs_tol=2e-9)
    monkeypatch.setattr(RecordedMotion, "next_waypoint", lambda self, now: None)
    assert not isclose(summary(run(scenario, 0)).capture_time or 0.0, wanted, abs_tol=1e-5)


def test_a_relay_never_chases_and_still_captures_what_it_meets():
    """At 5 m/s it comes within 0.1 m of the evader that stands at 0 after 0.58 s; every pursuer may chase."""
    relay = RelayNode(pursuer=0, motion=RecordedMotion(waypoints=[(0.0, -3.0, 0.0), (1.0, 2.0, 0.0)]))
    scenario = Scenario(
        prune="none",
        team=Team(positions=[(9.0, 9.0), (0.0, 5.0)], speeds=1.0, relay=[relay]),
        protocol="best_response",
        evader=Evader(position=(0.0, 0.0), speed=0.5, strategy="still"),
    )
    result = run(scenario, 0)
    assert scenario.team.all_speeds() == [0.0, 1.0]
    assert result.trace.of(Captured) == [(580_000_000, 1, 0)]
    assert {each.pursuer for each in result.trace.of(Decided) if each.active} == {1}


@pytest.mark.parametrize(
    "world",
    [
        {"motion": {"static": True}, "capture": {"radius": 5.0}},
        {"environment": {"flow": {"kind": "uniform", "velocity": [2.0, 0.0]}, "on": "pursuers"}},
        {
            "environment": {
                "flow": {"kind": "harmonic", "velocity": [2.0, 0.0], "amplitude": [0.5, 0.0], "period": 1.0},
                "on": "pursuers",
            }
        },
    ],
    ids=["within the radius", "flow", "changing flow"],
)
def test_nobody_waits_for_a_relay_to_capture_an_evader(world):
    """1 is a relay, within the capture radius or upstream of the evader: it may not chase, so 0 is the best pursuer."""
    relay = {"pursuer": 1, "motion": {"kind": "recorded", "waypoints": [[0.0, 5.0, 0.0]]}}
    team = {"positions": [(0.0, 0.0), (5.0, 0.0)], "speeds": 1.5, "active_at_start": 0.0, "relay": [relay]}
    table = {
        "horizon": 9.0,
        "evader": {"position": (9.0, 0.0), "speed": 0.1, "strategy": "still"},
        "protocol": "centralised",
        "team": team,
        **world,
    }
    times = []

    def protocol(me):
        times.append((me.id, me.capture_time(), me.global_state.capture_times(1)[me.id]))
        yield me.sleep(9.0)

    run(Scenario.model_validate(table | {"protocol": protocol}), 1)
    assert [time for pursuer, *both in times if pursuer == 1 for time in both] == [inf, inf]
    found = summary(run(Scenario.model_validate(table), 1))
    assert (found.idle_time, found.misassigned_time, found.time_to_relay, found.potential_gap) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.slow
def test_a_relay_carries_announcements_between_pursuers_out_of_range():
    """Three in a row with 10 m between neighbours and a range of 11 m: only through the one in the middle."""

    def delivered(*waypoints):
        relay = [RelayNode(pursuer=1, motion=RecordedMotion(waypoints=waypoints))]
        scenario = Scenario(
            horizon=1.0,
            team=Team(positions=[(0.0, 0.0), (0.0, 0.0), (20.0, 0.0)], speeds=0.1, relay=relay),
            evader=Evader(position=(10.0, 100.0), speed=0.01),
            announce={"dissemination": {"kind": "flooding"}, "heartbeat": 0.2},
            network={"range": 11.0},
            record=Recording(messages=True),
        )
        return {
            (record.src, message.dst)
            for message in run(scenario, 0).trace
            if hasattr(message, "arrival")
            for record in getattr(message.body, "records", ())
        }

    middle = delivered((0.0, 10.0, 0.0))
    assert middle
    assert not delivered((0.0, 10.0, 50.0))
    assert delivered((0.0, 10.0, 50.0), (0.5, 10.0, 0.0))  # it comes there after 0.5 s


@pytest.fixture
def written(tmp_path):
    """Return a function that writes a scenario with a record on line 2, and loads it."""

    def write(text, record="0 1 2 1 1 2.8\n0 5 5 2 5 6\n"):
        (tmp_path / "walk.txt").write_text(record)
        (tmp_path / "s.toml").write_text(f'name = "s"\n{text}\n')
        return load(tmp_path / "s.toml")

    return write


RECORDED = 'evader.strategy = { kind = "recorded", file = "walk.txt" }'


def test_a_file_means_the_same_as_its_waypoints(written):
    """Also in the identity of a run, in which the content counts and not the name."""
    scenario = written(RECORDED)
    same = RecordedMotion(waypoints=[(0.0, 1.0, 2.0), (1.0, 1.0, 2.8)])
    assert scenario.evader.strategy == same == RecordedMotion.model_validate(same.plain())
    plain = 'evader.strategy = { kind = "recorded", waypoints = [[0, 1, 2], [1, 1, 2.8]] }'
    assert identify(scenario).key == identify(written(plain)).key
    assert identify(scenario).key != identify(written(RECORDED, "0 1 2 1 1 2.7\n")).key
    assert scenario.evader.start(7).tolist() == [1.0, 2.0]
    assert not [key for key, _ in warnings(scenario) if key.startswith("evader")]


def test_the_node_of_a_file_is_chosen_and_the_file_is_beside_the_scenario_or_its_base(written, tmp_path):
    assert written(RECORDED.replace(" }", ", node = 1 }")).evader.start(0).tolist() == [5.0, 5.0]
    relay = '[[team.relay]]\npursuer = 3\nmotion = { kind = "recorded", file = "walk.txt" }'
    written(relay)
    (tmp_path / "s.toml").rename(tmp_path / "base.toml")
    (tmp_path / "above").mkdir()
    above = tmp_path / "top.toml"
    above.write_text('base = "base.toml"\n')
    assert load(above).team.relays[3].start == 1 + 2j


REFUSED = {
    "fast": (
        f"evader.speed = 0.5\n{RECORDED}",
        r"s\.toml:3: evader\.strategy: .*walk\.txt, line 1: the record moves at 1 m/s from 0\.5 to 1 s, faster than the"
        r" speed of 0\.5 m/s; the whole record needs a speed of at least 1 m/s",
    ),
    "bad line": (RECORDED.replace("walk", "bad"), r"s\.toml:2: evader\.strategy: .*bad\.txt, line 2: 'x' is not a num"),
    "no node": (RECORDED.replace(" }", ", node = 2 }"), r"walk\.txt has no node 2: it has nodes 0 to 1"),
    "bad node": (RECORDED.replace(" }", ", node = -1 }"), r"evader\.strategy\.node: should be greater than or equal"),
    "half a node": (RECORDED.replace(" }", ", node = 1.5 }"), r"evader\.strategy\.node: should be an integer"),
    "no name": (RECORDED.replace(" }", ', node = "" }'), r"evader\.strategy\.node: .*at least 1"),
    "both": (RECORDED.replace(" }", ", waypoints = [[0, 1, 2]] }"), r"should have waypoints or a file"),
    "neither": (RECORDED.replace(', file = "walk.txt"', ""), r"should have waypoints, or a file of waypoints"),
    "node without a file": (
        RECORDED.replace('file = "walk.txt"', "waypoints = [[0, 1, 2]], node = 1"),
        r"1 needs a file",
    ),
    "position": (f"evader.position = [1, 2]\n{RECORDED}", r"evader\.strategy: the record determines the initial pos"),
    "several": (f"evader.count = 2\n{RECORDED}", r"evader\.strategy: a record is of one evader"),
    "order": (
        'evader.strategy = { kind = "recorded", waypoints = [[1, 1, 2], [1, 2, 2]] }',
        r"the times of waypoints should increase; after 1 s comes 1 s",
    ),
    "outside": (RECORDED.replace("walk", "../walk"), r"leads out of the folder"),
    "no pursuer": (
        '[[team.relay]]\npursuer = 20\nmotion = { kind = "recorded", waypoints = [[0, 1, 2]] }',
        r"team\.relay: there is no pursuer 20: they are 0 \.\. 19",
    ),
    "twice": (
        'team.relay = [{ pursuer = 2, motion = { kind = "recorded", waypoints = [[0, 1, 2]] } },'
        ' { pursuer = 2, motion = { kind = "recorded", waypoints = [[0, 1, 2]] } }]',
        r"team\.relay: pursuer 2 is named twice",
    ),
    "other motion": (
        '[[team.relay]]\npursuer = 0\nmotion = { kind = "orbit" }',
        r"team\.relay\.0\.motion\.kind: there is no 'orbit'; allowed: recorded",
    ),
}


@pytest.mark.parametrize(("text", "why"), REFUSED.values(), ids=REFUSED)
def test_a_record_that_does_not_fit_is_refused_with_the_place(written, tmp_path, text, why):
    (tmp_path / "bad.txt").write_text("# t x y\n0 x 2\n")
    with pytest.raises(ValueError, match=why):
        written(text, "0 1 2 0.5 1 2.2 1 1 2.7\n0 5 5\n")


PLACED = {
    "scale": ({"scale": 1000.0}, [(1.0, 0.0, 4000.0), (3.0, 2000.0, 4000.0), (4.0, 2000.0, 6000.0)]),
    "offset": ({"offset": [-2.0, 1.0]}, [(1.0, -2.0, 5.0), (3.0, 0.0, 5.0), (4.0, 0.0, 7.0)]),
    "offset of 1": ({"offset": [1.0, 0.0]}, [(1.0, 1.0, 4.0), (3.0, 3.0, 4.0), (4.0, 3.0, 6.0)]),
    "offset of 0, 1": ({"offset": [0.0, 1.0]}, [(1.0, 0.0, 5.0), (3.0, 2.0, 5.0), (4.0, 2.0, 7.0)]),
    "scale of 2": ({"scale": 2.0}, [(1.0, 0.0, 8.0), (3.0, 4.0, 8.0), (4.0, 4.0, 12.0)]),
    "both": ({"scale": 0.5, "offset": [1.0, 0.0]}, [(1.0, 1.0, 2.0), (3.0, 2.0, 2.0), (4.0, 2.0, 3.0)]),
    "before the first": ({"start_time": 0.5}, [(0.5, 0.0, 4.0), (2.5, 2.0, 4.0), (3.5, 2.0, 6.0)]),
    "at the first": ({"start_time": 1.0}, [(0.0, 0.0, 4.0), (2.0, 2.0, 4.0), (3.0, 2.0, 6.0)]),
    "between two": ({"start_time": 1.5}, [(0.0, 0.5, 4.0), (1.5, 2.0, 4.0), (2.5, 2.0, 6.0)]),
    "1 ns before the second": (
        {"start_time": 2.999999999},
        [(0.0, 1.999999999, 4.0), (1e-9, 2.0, 4.0), (1.000000001, 2.0, 6.0)],
    ),
    "at the second": ({"start_time": 3.0}, [(0.0, 2.0, 4.0), (1.0, 2.0, 6.0)]),
    "at the last": ({"start_time": 4.0}, [(0.0, 2.0, 6.0)]),
}


@pytest.mark.parametrize(("keys", "right"), PLACED.values(), ids=PLACED)
def test_a_record_is_scaled_moved_and_cut(written, keys, right):
    """The record is at (0, 4) at 1 s, at (2, 4) at 3 s and at (2, 6) at 4 s; between them it moves straight."""
    waypoints = [(1.0, 0.0, 4.0), (3.0, 2.0, 4.0), (4.0, 2.0, 6.0)]
    made = RecordedMotion(waypoints=waypoints, **keys)
    assert made.waypoints == tuple(right)
    assert made == RecordedMotion(waypoints=right)
    values = ", ".join(f"{key} = {value}" for key, value in keys.items())
    text = f"evader.speed = 1e6\n{RECORDED.replace(' }', f', {values} }}')}"
    assert written(text, "1 0 4 3 2 4 4 2 6\n").evader.strategy == made


@pytest.mark.slow
@given(records(), st.floats(0.0, 4.0), st.floats(0.1, 10.0), places, st.floats(0.0, 4.0))
def test_a_cut_record_is_where_the_whole_one_is(record, start_time, scale, offset, t):
    """x(t) of the new record is scale x(t + start_time) + offset."""
    assume(start_time <= record.waypoints[-1][0] and record.top_speed < 1e4)
    keys = {"start_time": start_time, "scale": scale, "offset": offset}
    made = RecordedMotion(waypoints=record.waypoints, **keys)
    right = scale * interpolated(path_of(record), t + start_time) + complex(*offset)
    assert abs(interpolated(path_of(made), t) - right) < 1e-4


def test_a_record_that_has_ended_or_is_impossibly_fast_is_refused():
    with pytest.raises(KeyedError, match=r"start_time should be at most the time of the last waypoint, 1 s"):
        RecordedMotion(waypoints=[(0, 0, 0), (1, 2, 0)], start_time=1.5)
    with pytest.raises(KeyedError, match=r"waypoints\.1: the record moves at 1e\+11 m/s from 0 to 1e-08 s"):
        RecordedMotion(waypoints=[(0, 0, 0), (1e-8, 1000, 0)])
    with pytest.raises(KeyedError, match="dimensions are of a file"):
        RecordedMotion(waypoints=[(0, 0, 0)], dimensions=3)
    with pytest.raises(KeyedError, match="scale"):
        RecordedMotion(waypoints=[(0, 0, 0)], scale=0.0)


HIGH = "#3D\n0 10 12 5 6 12 12 12\n0 1 2 0 9 3 4 0\n"
LEVELS = {
    "evader.strategy": 'evader.speed = 9.0\nevader.strategy = { kind = "recorded", file = "walk.txt" }',
    "evader.0.strategy": '[[evader]]\nspeed = 9.0\nstrategy = { kind = "recorded", file = "walk.txt" }',
    "team.relay.0.motion": '[[team.relay]]\npursuer = 0\nmotion = { kind = "recorded", file = "walk.txt" }',
    "team.positions": 'team.positions = { kind = "recorded", file = "walk.txt" }',
}


@pytest.mark.parametrize(("key", "text"), LEVELS.items(), ids=LEVELS)
def test_dropped_heights_give_a_warning_wherever_a_record_is_used(written, key, text):
    found = [(name, why) for name, why in warnings(written(text, HIGH)) if "heights" in why]
    assert found == [(key, "the heights in the file are dropped: motion is in the plane, and so are all distances")]
    flat = written(text, HIGH.replace("12 5 6", "12 0 6").replace("12 12 12", "12 12 0"))
    assert not [why for _, why in warnings(flat) if "heights" in why]


POSITIONS = 'team.positions = { kind = "recorded", file = "walk.txt" }'


@pytest.mark.slow
def test_pursuers_begin_where_a_record_does_and_chase(written):
    """Their number is that of the nodes, and the file is not needed to repeat the run."""
    scenario = written(f'{POSITIONS}\nprune = "none"\nteam.speeds = 2.0')
    assert scenario.team.count == 2
    assert scenario.team.start(7).tolist() == [[1.0, 2.0], [5.0, 5.0]]
    assert scenario == Scenario.model_validate(scenario.plain())
    trace = run(scenario, 0).trace
    assert trace.of(Captured)
    assert [complex(*each) for each in trace.of(Sampled)[0].pursuers] == [1 + 2j, 5 + 5j]
    moved = POSITIONS.replace(" }", ", nodes = [1, 0, 1], scale = 2.0, offset = [1, 0], start_time = 0.5 }")
    right = [[11.0, 11.0], [3.0, 4.8], [11.0, 11.0]]
    found = written(moved, "0 1 2 1 1 2.8\n0 5 5 1 5 6\n").team.start(0).tolist()
    assert [tuple(map(round, each, (9, 9))) for each in found] == [tuple(each) for each in right]


def test_the_record_of_positions_may_be_beside_a_base_and_have_names(written, tmp_path):
    table = "t,node,x,y\n0,b,1,2\n0,a,3,4\n"
    written(POSITIONS, table)
    (tmp_path / "s.toml").rename(tmp_path / "base.toml")
    (tmp_path / "above").mkdir()
    (tmp_path / "walk.txt").rename(tmp_path / "above" / "walk.txt")
    (tmp_path / "base.toml").rename(tmp_path / "above" / "base.toml")
    (tmp_path / "top.toml").write_text('base = "above/base.toml"\n')
    scenario = load(tmp_path / "top.toml")
    assert scenario.team.start(0).tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert scenario.team.names == ("b", "a")


BAD_POSITIONS = {
    "count": (f"team.count = 3\n{POSITIONS}", r"team\.positions: should be one per pursuer: count is 3, there are 2"),
    "no file": (POSITIONS.replace("walk", "none"), r"s\.toml:2: team\.positions: .*none\.txt cannot be read: No such"),
    "no node": (POSITIONS.replace(" }", ", nodes = [2] }"), r"team\.positions: .*has no node 2: it has nodes 0 to 1"),
    "negative": (POSITIONS.replace(" }", ", nodes = [-1] }"), r"nodes\.0: should be greater than or equal to 0"),
    "key": (POSITIONS.replace(" }", ", scal = 2 }"), r"team\.positions\.scal: unknown key, did you mean 'scale'"),
    "scale": (POSITIONS.replace(" }", ", scale = -2 }"), r"team\.positions\.scale: should be greater than 0"),
    "outside": (POSITIONS.replace("walk", "../walk"), r"leads out of the folder"),
    "late": (POSITIONS.replace(" }", ", start_time = 5 }"), r"start_time should be at most the time of the last"),
}


@pytest.mark.parametrize(("text", "why"), BAD_POSITIONS.values(), ids=BAD_POSITIONS)
def test_positions_that_do_not_fit_are_refused_with_the_place(written, text, why):
    with pytest.raises(ValueError, match=why):
        written(text)


GRAPH = 'network.graph = { kind = "edges", file = "graph.csv" }'
TRACE = 'network.{} = {{ kind = "trace", file = "{}.csv" }}'
STARTS = "t,node,x,y\n0,a,1,2\n0,b,3,4\n"
ROWS = {"trace": "t,src,dst,value\n0,a,b,0.1\n0,b,a,0.2\n", "other": "t,src,dst,value\n0,b,a,0.4\n0,a,b,0.3\n"}


@pytest.fixture
def named(written, tmp_path):
    """Return a function that returns the scenario with some lines, beside files about the nodes a and b."""
    (tmp_path / "graph.csv").write_text("source,target\nb,a\n")
    for name, rows in ROWS.items():
        (tmp_path / f"{name}.csv").write_text(rows)
    return lambda *lines: written("\n".join(lines), STARTS)


def values(trace):
    """Return the value of each link of a trace."""
    links = zip(trace.measurements.src.tolist(), trace.measurements.dst.tolist(), strict=True)
    return dict(zip(links, trace.measurements.values.tolist(), strict=True))


def test_a_graph_numbers_the_names_in_all_files(named):
    """The graph begins with b, and the positions and one of the traces with a."""
    traces = [TRACE.format("latency", "trace"), TRACE.format("loss", "other")]
    scenario = named(GRAPH, POSITIONS, *traces)
    assert scenario.network.graph.names == scenario.team.names == ("b", "a")
    assert scenario.team.positions == ((3.0, 4.0), (1.0, 2.0))
    assert values(scenario.network.latency) == {(0, 1): 0.2, (1, 0): 0.1}
    assert values(scenario.network.loss) == {(0, 1): 0.4, (1, 0): 0.3}
    assert Scenario.model_validate(scenario.plain()) == scenario


def test_the_first_file_with_names_numbers_them_if_there_is_no_graph(named):
    """Positions are asked before traces, and latencies before losses."""
    traces = [TRACE.format("latency", "other"), TRACE.format("loss", "trace")]
    scenario = named(POSITIONS, *traces)
    assert values(scenario.network.latency) == {(0, 1): 0.3, (1, 0): 0.4}
    scenario = named("team.count = 2", *traces)
    assert values(scenario.network.latency) == {(0, 1): 0.4, (1, 0): 0.3}
    assert values(scenario.network.loss) == {(0, 1): 0.2, (1, 0): 0.1}
    assert scenario.network.latency.nodes is None  # and so a warning shows the numbers


@pytest.mark.parametrize("key", ["network.link", "network.graph.edges"])
def test_a_trace_of_one_link_has_the_numbers_of_the_others(named, key):
    edge = 'src = 0, dst = 1, latency = { kind = "trace", file = "trace.csv" }'
    own = {
        "network.link": f"[[network.link]]\n{edge.replace(', ', chr(10), 2)}\nboth_ways = true",
        "network.graph.edges": f'[network.graph]\nkind = "edges"\nedges = [{{ {edge} }}]',
    }[key]
    network = named("team.count = 2", TRACE.format("loss", "other"), own).network
    model = network.link[0].latency if network.link else network.graph.edges[0].latency
    assert network.loss.measurements.names == ("b", "a")
    assert values(model) == {(0, 1): 0.2, (1, 0): 0.1}


def test_the_nodes_of_a_graph_from_1_are_names_in_a_trace(named, tmp_path):
    (tmp_path / "graph.csv").write_text("1,2\n")
    (tmp_path / "trace.csv").write_text(ROWS["trace"].replace("a,b", "1,2").replace("b,a", "2,1"))
    scenario = named("team.count = 2", GRAPH, TRACE.format("latency", "trace"))
    assert values(scenario.network.latency) == {(0, 1): 0.1, (1, 0): 0.2}


def test_nodes_in_another_order_than_the_graph_are_refused(named, tmp_path):
    nodes = ', nodes = ["a", "b"] }'
    trace = TRACE.format("latency", "trace")
    with pytest.raises(ValueError, match=r"team\.positions: the nodes of the file are a, b, and .* graph b, a"):
        named(GRAPH, POSITIONS.replace(" }", nodes))
    with pytest.raises(ValueError, match=r"network\.latency: trace\.csv numbers the nodes a, b, and .* b, a"):
        named(GRAPH, trace.replace(" }", nodes), "team.count = 2")
    (tmp_path / "trace.csv").write_text(ROWS["trace"].replace("a,b", "c,b"))
    with pytest.raises(
        ValueError, match=r"latency: .*trace\.csv, line 2: src: 'c' is not in nodes: the nodes are b, a"
    ):
        named(GRAPH, trace, "team.count = 2")


def test_a_script_is_told_the_number_of_the_waypoint():
    with pytest.raises(KeyedError, match=r"waypoints\.1: the record moves at 2 m/s from 0 to 1 s"):
        Evader(strategy=RecordedMotion(waypoints=[(0, 0, 0), (1, 2, 0)]))

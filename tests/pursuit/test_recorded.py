"""Recorded motion of evaders and relays: they are where the record says, and captures stay exact."""

from math import isclose

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from desim import Evader, Motion, RecordedMotion, Recording, RelayNode, Scenario, Team, load, run, summary
from desim.analysis.invariants import watched
from desim.kernel.units import SECOND
from desim.pursuit.events import Captured, Decided, Sampled
from desim.scenario.checks import warnings
from desim.study.config_hash import identify
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


@pytest.mark.slow
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


def test_a_script_is_told_the_number_of_the_waypoint():
    with pytest.raises(ValidationError, match=r"waypoints\.1: the record moves at 2 m/s from 0 to 1 s"):
        Evader(strategy=RecordedMotion(waypoints=[(0, 0, 0), (1, 2, 0)]))

"""Dead reckoning without a simulator: legs are made by hand, and chases have closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.pursuit.core.geometry import moved_towards, toward
from desim.pursuit.motion.dead_reckoning import MAX_RETRACINGS, EvaderTrack, MotionState, TrackSegment
from desim.pursuit.motion.dynamics import Simple
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.guidance import ConstantBearing, PurePursuit

LAWS = [PurePursuit(), ConstantBearing()]
STEP = nanoseconds(0.25)
numbers = st.floats(-10.0, 10.0).map(lambda x: round(x, 6))
plane = st.builds(complex, numbers, numbers)


def place(path, start, speed, since, now):
    """Return the retraced position of a pursuer with simple motion."""
    return path.retrace(MotionState(start), speed, since, now).position


def straight_run(law, evader, evader_velocity, until, *, ahead=True):
    """Return what is seen in steps of 0.25 s of an evader that keeps its velocity; aimed at is where a step ends."""
    path = EvaderTrack(law, Simple(), Environment(), 0.1)
    for t in range(0, until + 1, STEP):
        at = evader + evader_velocity * seconds(t)
        path.see(t, at, at + (evader_velocity * seconds(STEP) if ahead else 0.0), evader_velocity, t + STEP)
    return path


def turning(seed, until):
    """Yield what is seen at each step of an evader that turns at every step, far from all pursuers."""
    rng = np.random.default_rng(seed)
    at = 50.0 + 50.0j
    for t in range(0, until + 1, STEP):
        evader_velocity = complex(np.exp(1j * rng.uniform(-1.0, 2.0)))
        yield t, at, at + evader_velocity * seconds(STEP), evader_velocity, t + STEP
        at += evader_velocity * seconds(STEP)


def fresh(law, seed, question, now):
    """Return the answer of a fresh track."""
    path = EvaderTrack(law, Simple(), Environment(), 0.1)
    for leg in turning(seed, now):
        path.see(*leg)
    return place(path, *question, now)


def test_a_leg_goes_on_straight():
    """From (1, 2) at 1 s with (4, -2) m/s: (2, 1.5) a quarter of a second later."""
    leg = TrackSegment(SECOND, 1.0 + 2.0j, 5.0j, 4.0 - 2.0j, SECOND + STEP)
    assert leg.at(SECOND) == 1.0 + 2.0j
    assert leg.at(SECOND + STEP) == 2.0 + 1.5j


@pytest.mark.parametrize("remembers", [True, False])
def test_the_current_step_is_the_latest_observation(remembers):
    path = EvaderTrack(PurePursuit(), Simple(), Environment(), 0.1, remembers=remembers)
    path.see(0, 1j, 2j, 1.0, STEP)
    assert path.last == (0, 1j, 2j, 1.0, STEP)
    path.see(STEP, 3j, 4j, 5.0, 2 * STEP)
    assert path.last == (STEP, 3j, 4j, 5.0, 2 * STEP)


def test_a_track_without_history_keeps_only_the_last_step():
    path = EvaderTrack(PurePursuit(), Simple(), Environment(), 0.1, remembers=False)
    for k in range(100):
        path.see(k, 0j, 0j, 0j, k + 1)
    assert not path._segments
    assert path.last.begun == 99
    with pytest.raises(AssertionError):
        place(path, 1j, 1.0, 0, 5)


# Closed forms.


@pytest.mark.parametrize("law", LAWS)
@given(plane, plane, st.integers(0, 3 * SECOND), st.integers(0, SECOND))
def test_an_evader_that_stands_still_is_approached_on_a_straight_line(law, evader, position, since, age):
    """x = p + (x_e - p) t / 16 at a speed of |x_e - p| / 16, over as many steps as there are between."""
    speed = abs(evader - position) / 16.0
    found = place(straight_run(law, evader, 0j, since + age), position, speed, since, since + age)
    assert found == pytest.approx(position + (evader - position) * (age / SECOND / 16.0), abs=1e-9)


@pytest.mark.parametrize("ahead", [True, False])
@given(st.integers(0, 3 * SECOND), st.integers(0, SECOND))
def test_an_evader_that_runs_straight_is_met_on_one_course(ahead, since, age):
    """Constant bearing, v = 5, w = 3 across the line of sight: 4 along it and 3 across it, whatever the boundaries.

    When the chase begins the evader is 10 m to the east, running north.
    """
    path = straight_run(ConstantBearing(), 10.0 + 0j, 3j, since + age, ahead=ahead)
    start = 3j * (since / SECOND)
    expected = start + (4.0 + 3.0j) * (age / SECOND)
    assert place(path, start, 5.0, since, since + age) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("ahead", [True, False])
def test_a_tail_chase_is_a_straight_line(law, ahead):
    """Behind an evader that runs away at 1 m/s, 5 m ahead: 2 m/s for 3.1 s are 6.2 m, under both laws."""
    now = nanoseconds(3.1)
    path = straight_run(law, 5.0 + 0j, 1.0 + 0j, now, ahead=ahead)
    assert place(path, 0j, 2.0, 0, now) == pytest.approx(6.2, abs=1e-9)


def test_pure_pursuit_updates_its_aim_at_every_step():
    """The evader runs from (3, 0) north at 4 m/s, the pursuer from (0, 0) at 4 m/s, so 1 m a step, from 0.125 s on.

    The first half step leads 0.5 m towards (3, 1), the second step 1 m towards (3, 2), and 0.06 s of the third 0.24 m
    towards (3, 3).
    """
    now = nanoseconds(0.56)
    path = straight_run(PurePursuit(), 3.0 + 0j, 4j, now)
    expected = 0j
    for length, aim in [(0.5, 3.0 + 1.0j), (1.0, 3.0 + 2.0j), (0.24, 3.0 + 3.0j)]:
        expected += length * (aim - expected) / abs(aim - expected)
    assert place(path, 0j, 4.0, STEP // 2, now) == pytest.approx(expected, abs=1e-12)
    assert abs(expected - 1.74 * (3.0 + 3.0j) / abs(3.0 + 3.0j)) > 0.1


@pytest.mark.parametrize("law", LAWS)
def test_a_turn_of_the_evader_inside_the_age_turns_the_pursuer(law):
    """It stands still at (4, 0) for a step and then, as if it had jumped, at (1, 3): 1 m east, then 1 m north."""
    for position, since in [(0j, 0), (0.5 + 0j, STEP // 2), (1.0 + 0j, STEP)]:
        path = EvaderTrack(law, Simple(), Environment(), 0.1)
        path.see(0, 4.0 + 0j, 4.0 + 0j, 0j, STEP)
        path.see(STEP, 1.0 + 3.0j, 1.0 + 3.0j, 0j, 2 * STEP)
        assert place(path, position, 4.0, since, 2 * STEP) == pytest.approx(1.0 + 1.0j, abs=1e-12)


def test_a_guidance_law_receives_the_evader_as_observed_at_the_start_of_each_segment():
    """At 0.125 s and 0.25 s: the evader runs from (3, 0) north at 4 m/s and is aimed at where a step ends, 1 m on."""
    told = []

    def law(gaps, aims, evader_velocity, speeds):
        told.append((gaps.tolist(), aims.tolist(), evader_velocity, speeds.tolist()))
        return toward(gaps, speeds) * 0.0 + speeds

    now = 2 * STEP - 1
    path = straight_run(law, 3.0 + 0j, 4j, now)
    assert place(path, 1j, 2.0, STEP // 2, now) == pytest.approx(0.75 + 1.0j, abs=1e-8)
    assert told == [([3.0 - 0.5j], [3.0 + 0j], 4j, [2.0]), ([2.75 + 0j], [2.75 + 1j], 4j, [2.0])]


@pytest.mark.parametrize("law", LAWS)
def test_positions_are_unchanged_before_the_start_and_after_zero_time(law):
    """A clock that is ahead lets a record seem older than the pursuit: 1 s of chase, not 3."""
    assert place(EvaderTrack(law, Simple(), Environment(), 0.1), 3j, 1.0, -SECOND, 0) == 3j
    path = straight_run(law, 9.0 + 0j, 0j, SECOND)
    assert place(path, 3j, 1.0, SECOND, SECOND) == 3j
    assert place(path, 0j, 1.0, -2 * SECOND, SECOND) == pytest.approx(1.0, abs=1e-12)


# Going on from the last question.


@pytest.mark.slow_but_one
@pytest.mark.parametrize("law", [*LAWS, lambda gaps, aims, w, v: toward(gaps + w, v)])
@settings(max_examples=40)
@given(st.integers(0, 10**6), st.integers(0, 3 * SECOND), st.lists(st.integers(0, 3 * SECOND), min_size=1, max_size=6))
def test_an_incremental_query_equals_a_fresh_one(law, seed, since, later):
    """Bit by bit: it goes on from the beginning of a step, so that no piece of a path is ever cut in two."""
    path, legs, question = (
        EvaderTrack(law, Simple(), Environment(), 0.1),
        list(turning(seed, 3 * SECOND)),
        (1j, 1.5, since),
    )
    for now in sorted(t for t in [*later, STEP, 2 * STEP, 3 * SECOND] if t >= since):
        while legs and legs[0][0] <= now:
            path.see(*legs.pop(0))
        assert place(path, *question, now) == fresh(law, seed, question, now)


def test_an_incremental_query_reads_no_completed_step():
    """Twelve steps the first time, one the second, in the same step, and two in the next: the last and the new one."""
    asked = []

    def law(gaps, aims, evader_velocity, speeds):
        asked.append(1)
        return toward(aims, speeds)

    path, (*legs, newest) = EvaderTrack(law, Simple(), Environment(), 0.1), turning(0, 12 * STEP)
    for leg in legs:
        path.see(*leg)
    pieces = []
    for steps in (11.2, 11.7, 12.5):
        if steps > 12:
            path.see(*newest)
        asked.clear()
        place(path, 0j, 1.0, 0, round(steps * STEP))
        pieces.append(len(asked))
    assert pieces == [12, 1, 2]


def test_paths_that_differ_in_place_or_speed_or_beginning_are_kept_apart():
    for question in [(1j, 1.0, 0), (2j, 1.0, 0), (1j, 2.0, 0), (1j, 1.0, STEP + 7)]:
        path = EvaderTrack(PurePursuit(), Simple(), Environment(), 0.1)
        for leg in turning(3, 5 * STEP):
            path.see(*leg)
        place(path, 1j, 1.0, 0, 5 * STEP)
        assert place(path, *question, 5 * STEP + 9) == fresh(PurePursuit(), 3, question, 5 * STEP + 9)


@pytest.mark.slow
def test_the_cache_of_paths_is_bounded_and_evicts_the_least_recently_used():
    """One more than the bound, the first asked for again before the last: the second goes, and is retraced anew."""
    path, (now, *later) = EvaderTrack(PurePursuit(), Simple(), Environment(), 0.1), turning(4, 5 * STEP)
    path.see(*now)
    questions = [(complex(k), 1.0, 0) for k in range(MAX_RETRACINGS + 1)]
    for question in [*questions[:-1], questions[0], questions[-1]]:
        place(path, *question, STEP // 2)
    assert len(path._retracings) == MAX_RETRACINGS
    assert (MotionState(questions[0][0]), *questions[0][1:]) in path._retracings
    assert (MotionState(questions[1][0]), *questions[1][1:]) not in path._retracings
    for leg in later:
        path.see(*leg)
    assert place(path, *questions[1], 5 * STEP) == fresh(PurePursuit(), 4, questions[1], 5 * STEP)
    assert len(path._retracings) == MAX_RETRACINGS


# Without the path of the evader.


def test_straight_line_reckoning_ends_at_the_evader():
    """From (3, 4) to the evader at (0, 0) it is 5 m: 2 m lead to (1.8, 2.4), 5 or 7 there; at the evader it stays."""
    assert moved_towards(3.0 + 4.0j, 0j, 2.0) == pytest.approx(1.8 + 2.4j)
    assert moved_towards(3.0 + 4.0j, 0j, 0.0) == pytest.approx(3.0 + 4.0j)
    assert moved_towards(3.0 + 4.0j, 0j, 5.0) == moved_towards(3.0 + 4.0j, 0j, 7.0) == 0j
    assert moved_towards(1.0 + 1.0j, 1.0 + 1.0j, 3.0) == 1.0 + 1.0j

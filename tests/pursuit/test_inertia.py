"""Players with inertia: first contacts against dense sampling, and positions, which all methods give alike."""

from cmath import rect
from math import inf, pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from desim.kernel.core.clock import Clock
from desim.kernel.core.units import SECOND, seconds
from desim.pursuit.motion.dynamics import Acceleration, Course, Piece, Simple, TurnRate
from desim.pursuit.motion.inertia import InertialKinematics, first_contact_of_pieces
from desim.pursuit.motion.kinematics import Kinematics

seeds = st.integers(0, 2**32 - 1)


def piece_of(rng):
    """Return a piece: straight, a parabola or an arc, of any limit; some carried by a flow."""
    place, velocity, command = (complex(*rng.normal(size=2)) for _ in range(3))
    dynamics = [Simple(), *(kind(limit=float(10.0 ** rng.uniform(-1, 4))) for kind in (Acceleration, TurnRate))]
    drift = complex(*rng.normal(size=2)) * rng.choice([0.0, 0.3])
    return dynamics[rng.integers(3)](place, Course(velocity, velocity / abs(velocity)), command)._replace(drift=drift)


def check_contact(target, player, radius, begin, end):
    """Check a first contact against 1500 samples of the distance: never late, never early, never missed."""

    def gap(t):
        return abs(target.at(t) - player.at(t)) - radius

    found = first_contact_of_pieces(target, player, radius, begin, end)
    times = np.linspace(begin, end, 1_501)
    gaps = np.array([gap(t) for t in times.tolist()])
    before = times < (inf if found is None else begin + found - 1e-12)
    assert (gaps[before] > -1e-9).all(), "late or missed"
    if found is None:
        return None
    assert 0.0 <= found <= end - begin
    assert gap(begin + found) <= 1e-9, "early"
    within = np.flatnonzero(gaps < 0.0)
    if len(within) and within[0]:  # crossed between two samples: there, by bisection
        exact = brentq(gap, times[within[0] - 1], times[within[0]], xtol=1e-13)
        assert begin + found <= exact + 1e-9
    return found


# First contacts.


@pytest.mark.slow
@settings(max_examples=25)
@given(seeds, st.sampled_from([0.05, 0.4, 1.5]))
def test_contacts_are_neither_late_nor_early(seed, radius):
    """Lines, parabolas and arcs against each other, some with curves that end within the interval."""
    rng = np.random.default_rng(seed)
    for _ in range(4):
        begin = float(rng.choice([0.0, 0.01, 0.6]))
        check_contact(piece_of(rng), piece_of(rng), radius, begin, begin + float(rng.uniform(0.0, 4.0)))


def test_of_random_pairs_some_meet():
    """So the property above is not one of pairs that never meet: of 300, 23 meet, and 8 are within the radius."""
    rng = np.random.default_rng(1)
    found = [first_contact_of_pieces(piece_of(rng), piece_of(rng), 0.4, 0.0, 3.0) for _ in range(300)]
    assert (sum(each is not None for each in found), found.count(0.0)) == (31, 8)


@pytest.mark.parametrize("limit", [1e2, 1e4, 1e6])
def test_contacts_are_exact_however_sharp_the_curve(limit):
    """A head-on contact after the turn or the acceleration, 2 m ahead at 1 m/s: the bound of the curve ends with it."""
    target = Piece(2.0 + 0j, Course())
    turned = TurnRate(limit=limit)(0j, Course(0j, 1j), 1.0 + 0j)
    pushed = Acceleration(limit=limit)(0j, Course(0j, 1.0 + 0j), 1.0 + 0j)
    assert first_contact_of_pieces(target, pushed, 0.5, 0.0, 9.0) == pytest.approx(1.5 + 0.5 / limit, rel=1e-12)
    found = check_contact(target, turned, 0.5, 0.0, 9.0)
    assert found == pytest.approx(1.5 + (pi / 2 - 1.0) / limit, abs=1e-12 + 2.0 / limit**2)


def test_contacts_by_hand():
    """On a circle of 1 m about 1j from the origin, a point 2 m to the right of the start comes within
    |e^(i (t - pi/2)) + 1j - 2|; at the end of a half turn, at 2j, it is within eps of 2j + eps."""
    turning = TurnRate(limit=1.0)(0j, Course(0j, 1.0 + 0j), rect(1.0, 3.1))
    assert check_contact(Piece(2j + 0.5j, Course()), turning, 0.5, 0.0, 4.0) == pytest.approx(pi, abs=0.05)
    assert check_contact(Piece(1j, Course()), turning, 1.0, 0.0, 4.0) == 0.0  # always at 1 m
    assert check_contact(Piece(1j, Course()), turning, 0.9, 0.0, 3.0) is None
    braking = Acceleration(limit=0.5)(0j, Course(2.0 + 0j, 1.0 + 0j), 0j)
    assert check_contact(Piece(5.0 + 0j, Course()), braking, 1.0 + 1e-7, 0.0, 9.0) == pytest.approx(4.0, abs=1e-3)
    assert check_contact(Piece(5.0 + 0j, Course()), braking, 1.0 - 1e-7, 0.0, 9.0) is None
    assert check_contact(Piece(5.0 + 0j, Course()), braking, 4.0, 1.0, 9.0) == 0.0


@pytest.mark.slow
@given(seeds, st.sampled_from([-1e-3, -1e-6, 1e-6, 1e-3]))
def test_grazing_contacts(seed, beyond):
    """A radius a little shorter than the least distance is never reached; a little longer, it is."""
    rng = np.random.default_rng(seed)
    target, player = piece_of(rng), piece_of(rng)
    times = np.linspace(0.0, 3.0, 1_001)
    gaps = np.array([abs(target.at(t) - player.at(t)) for t in times.tolist()])
    if gaps[0] < gaps.min() + 0.1 or gaps.min() < 0.05:
        return
    found = check_contact(target, player, float(gaps.min()) + beyond, 0.0, 3.0)
    assert beyond < 0.0 or found is not None


def test_two_that_turn_side_by_side_do_not_touch():
    """In circles of one centre, 1e-3 m apart from a contact for 10 s."""
    inner, outer = (
        TurnRate(limit=0.3)(place, Course(0j, 1.0 + 0j), rect(v, 3.1)) for place, v in ((1j, 0.6), (0j, 0.9))
    )
    assert check_contact(inner, outer, 0.999, 0.0, 10.0) is None


def moving(dynamics, start=(0j, 4.0 + 0j, 4j), headings=(1.0, 1.0, 1j)):
    """Return a clock, and three players of these dynamics."""
    env = Clock()
    return env, InertialKinematics(env, np.array(start, complex), dynamics, np.array(headings, complex))


def test_a_sampled_capture_is_tested_at_the_end_only():
    """A pursuer that passes within 0.5 m of a target, and is 1 m away at the end of the step."""
    env, players = moving([TurnRate(), Acceleration(limit=1.0), Simple()], start=(0j, 9.0 + 0j, 1.0 + 0.4j))
    players.command(np.array([2.0 + 0j, 0j, 0j]))
    free, offsets = np.zeros(2, bool), players.positions()[2] - players.positions()[:2]
    time, player = players.contact(2, offsets, free, 0.5, 1.0, "segment")
    assert (time, player) == (pytest.approx((1.0 - 0.3) / 2.0), 0)
    assert players.contact(2, offsets, free, 0.5, 1.0, "sample") is None
    assert players.contact(2, offsets, free, 0.5, 0.5, "sample") == (0.5, 0)
    assert players.contact(2, offsets, ~free, 0.5, 1.0, "segment") is None
    assert players.contact(2, offsets, ~free, 0.5, 0.5, "sample") is None
    assert players.contact(2, offsets, np.array([True, False]), 0.5, 1.0, "segment") is None
    env.run(until=SECOND // 5)  # within the piece: times count from now on
    assert players.contact(2, offsets, free, 0.5, 1.0, "segment") == (pytest.approx(0.15), 0)


def test_the_earliest_contact_counts_and_the_lowest_number_among_equals():
    _, players = moving([TurnRate()] * 4, start=(-2.0, 2.0, -1.5, 0j), headings=(1.0, 1.0, 1.0, 1.0))
    places = players.positions()
    players.command(np.array([1.0, 0.0, 1.0, 0.0], complex))
    assert players.contact(3, places[3] - places[:3], np.zeros(3, bool), 0.5, 9.0, "segment") == (1.0, 2)
    assert players.contact(3, places[3] - places[:3], np.array([0, 0, 1], bool), 0.5, 9.0, "segment") == (1.5, 0)
    _, players = moving([TurnRate()] * 3, start=(-2.0, -2j, 0j), headings=(1.0, 1j, 1.0))
    places = players.positions()
    players.command(np.array([1.0, 1j, 0.0], complex))
    assert players.contact(2, places[2] - places[:2], np.zeros(2, bool), 0.5, 9.0, "segment") == (1.5, 0)


# Positions.


@pytest.mark.slow
@given(seeds)
def test_all_methods_give_the_same_positions(seed):
    """Alone, together, of some, at other times of the piece, and by distance; known or not."""
    rng = np.random.default_rng(seed)
    kinds = [Simple(), Acceleration(limit=0.7), TurnRate(limit=1.1), Acceleration(limit=9.0)]
    env = Clock()
    players = InertialKinematics(env, rng.normal(size=4) + 1j * rng.normal(size=4), kinds, np.full(4, 1j))
    told = []
    players.before_change(lambda: told.append(env.now))
    for start in (SECOND // 3, SECOND):
        env.run(until=start)
        commands = rng.normal(size=4) + 1j * rng.normal(size=4)
        drifts = [None, rng.normal(size=4) + 0j][rng.integers(2)]
        before = players.positions().tolist(), [players.course(k) for k in range(4)]
        players.command(commands, drifts)
        assert players.positions().tolist() == before[0]  # positions are continuous,
        assert players.course(1).velocity == pytest.approx(before[1][1].velocity)  # the velocity with an acceleration,
        assert players.course(2).heading == pytest.approx(before[1][2].heading)  # and the heading with a turn rate
        for after in (1, 123_456_789, SECOND // 2):
            env.run(until=start + after)
            ahead = players.positions_at(np.arange(4), env.now)
            assert [players.position(k) for k in range(4)] == pytest.approx(ahead.tolist(), abs=1e-12)
            assert [players.positions_of([k])[0] for k in range(4)] == [players.position(k) for k in range(4)]
            assert players.positions().tolist() == ahead.tolist()
            others = [1, 0, 2]
            assert players.distances(3, others) == [abs(players.position(3) - players.position(k)) for k in others]
            velocities, headings = players.courses(range(4))
            assert velocities.tolist() == [players.course(k).velocity for k in range(4)]
            assert headings.tolist() == [players.course(k).heading for k in range(4)]
            assert np.abs(headings) == pytest.approx(1.0)
            flow = np.zeros(4) if drifts is None else drifts
            assert [players.velocity(k) for k in range(4)] == pytest.approx((velocities + flow).tolist())
    times = np.array([SECOND, SECOND + 5, 2 * SECOND])
    for player in range(4):
        assert players.positions_at(np.full(3, player), times).tolist() == [
            players.positions_at(np.array([player]), int(t))[0] for t in times
        ]
    assert told == [SECOND // 3, SECOND]
    with pytest.raises(ValueError, match="read-only"):
        players.positions()[0] = 0j


@given(seeds)
def test_a_velocity_is_the_derivative_of_the_position(seed):
    rng = np.random.default_rng(seed)
    for piece in (piece_of(rng) for _ in range(10)):
        for t in (0.1, 0.5, piece.curved + 0.1):
            if abs(t - piece.curved) > 1e-4:
                slope = (piece.at(t + 1e-6) - piece.at(t - 1e-6)) / 2e-6
                assert piece.velocity_at(t) == pytest.approx(slope, abs=1e-4 * (1.0 + piece.curvature))


def test_what_a_command_leads_to_is_told_in_advance():
    """`advance` gives the end of a motion step and the mean velocity, over ground; it commands nothing."""
    for drift in (0j, 0.2 - 0.1j):
        env, players = moving([Simple(), Acceleration(limit=1.0), TurnRate(limit=1.0)])
        told = [players.advance(k, 1.0 + 1j, 0.5, drift) for k in range(3)]
        assert players.commands.tolist() == [0j] * 3
        begun = players.positions().tolist()
        players.command(np.full(3, 1.0 + 1j), np.full(3, drift))
        env.run(until=SECOND // 2)
        assert [end for end, _ in told] == pytest.approx(players.positions().tolist())
        means = [(end - start) / 0.5 for start, end in zip(begun, players.positions().tolist(), strict=True)]
        assert [mean for _, mean in told] == pytest.approx(means)


@given(seeds)
def test_players_that_stand_still_keep_their_piece_as_if_it_began_anew(seed):
    """Some stop at once, some brake, and some go on after they have stood; to the last bit."""
    rng, env = np.random.default_rng(seed), Clock()
    dynamics = [Simple(), Acceleration(limit=4.0), TurnRate(limit=2.0)]
    starts, headings = rng.normal(size=3) + 1j * rng.normal(size=3), np.exp(1j * rng.normal(size=3))
    kept, anew = (InertialKinematics(env, starts.copy(), dynamics, headings) for _ in range(2))
    anew._stays = [False] * 3
    for k in range(1, 9):
        commands = (rng.normal(size=3) + 1j * rng.normal(size=3)) * rng.choice([0.0, 0.0, 1.0], size=3)
        for players in (kept, anew):
            players.command(commands)
        env.run(until=k * SECOND // 3)
        assert kept.positions().tolist() == anew.positions().tolist()
        assert kept.courses(range(3)).headings.tolist() == anew.courses(range(3)).headings.tolist()
        assert kept.courses(range(3)).velocities.tolist() == anew.courses(range(3)).velocities.tolist()


@given(seeds)
def test_players_that_are_all_simple_move_as_without_inertia(seed):
    """The two kinematics give the same positions, courses and contacts."""
    rng = np.random.default_rng(seed)
    env, starts = Clock(), rng.normal(size=3) + 1j * rng.normal(size=3)
    plain, general = Kinematics(env, starts), InertialKinematics(env, starts, [Simple()] * 3, np.ones(3, complex))
    for k in range(1, 4):
        velocities = rng.normal(size=3) + 1j * rng.normal(size=3)
        for players in (plain, general):
            players.command(velocities)
        env.run(until=k * SECOND // 3)
        assert plain.positions() == pytest.approx(general.positions(), abs=1e-12)
        for player in range(3):
            assert plain.course(player) == pytest.approx(general.course(player))
            assert plain.velocity(player) == general.velocity(player)
        offsets = plain.positions()[2] - plain.positions()[:2]
        for test in ("segment", "sample"):
            given = 2, offsets, np.zeros(2, bool), 0.7, seconds(SECOND), test
            assert plain.contact(*given) == (
                pytest.approx(general.contact(*given)) if general.contact(*given) else None
            )

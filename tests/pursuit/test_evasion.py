"""Evader strategies."""

from cmath import phase, rect
from itertools import pairwise
from math import inf, pi, sqrt

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from desim.config.choice import kind_of
from desim.kernel.walls.wall import Wall
from desim.pursuit.core.state import State, complex_points, coordinates
from desim.pursuit.evaders.evasion import (
    STRATEGIES,
    ConstantHeading,
    Diffusion,
    Hide,
    Listener,
    MaxGeodesic,
    MaxMin,
    PureEvasion,
    Still,
    VoronoiVertex,
    WeightedFlee,
    Zigzag,
    first_captures,
)
from desim.pursuit.evaders.observation import EvaderObservation
from desim.pursuit.paths.space import space_among
from desim.scenario.players import Evader
from desim.scenario.toml import load

ARENA = (-10.0, 10.0)
FLEEING = [
    *(PureEvasion(), WeightedFlee(), MaxMin(), MaxGeodesic(), Hide(), Zigzag()),
    VoronoiVertex(arena=ARENA),
]
WANDERING = [Diffusion(), ConstantHeading(), ConstantHeading(angle=1.0)]
ALL = [*FLEEING, *WANDERING, Still(), Listener(), Listener(during_handover=WeightedFlee(), normally=Diffusion())]
WITH = {"flees_from": "active"}


def named(strategy):
    return strategy.kind


def observation(*pursuers, evader=0j, active=True, speeds=1.5, t=0, **knowledge):
    """Return what an evader of speed 1 m/s knows; the radius of capture is 0.1 m."""
    count = len(pursuers)
    state = State(t, np.array(pursuers, dtype=complex), complex(evader), np.broadcast_to(active, count).copy())
    return EvaderObservation(state, np.broadcast_to(float(speeds), count).copy(), 1.0, 0.1, **knowledge)


def heading_of(strategy, *pursuers, seed=0, **knowledge):
    return strategy(observation(*pursuers, **knowledge), np.random.default_rng(seed))


def walk(strategy, step, duration, *pursuers, evader=0j, seed=0):
    """Yield the place of an evader of speed 1 m/s and its heading at each step of a walk among pursuers that stay."""
    rng = np.random.default_rng(seed)
    heading, elapsed = 0j, 0.0
    for k in range(round(duration / step)):
        now = observation(*pursuers, evader=evader, t=round(k * step * 1e9), heading=heading, elapsed=elapsed)
        heading, elapsed = strategy(now, rng), step
        yield evader, heading
        evader += heading * step


def turns(path):
    """Return how many headings of a path are by more than a right angle off from the one before."""
    headings = [heading for _, heading in path]
    return sum((new * old.conjugate()).real < 0.0 for old, new in pairwise(headings))


coordinate = st.floats(-20.0, 20.0).map(lambda x: round(x, 3))
points = st.builds(complex, coordinate, coordinate)
teams = st.lists(points, max_size=6)
crowds = st.lists(points, min_size=1, max_size=6)
angles = st.floats(-pi, pi)
headings = st.just(0j) | angles.map(lambda angle: rect(1.0, angle))


# What holds of all of them.


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ALL, ids=named)
@settings(max_examples=25)
@given(teams, points, headings, st.floats(0.0, 5.0), st.booleans(), st.integers(0, 10**10), st.data())
def test_a_heading_is_1_long_or_0(strategy, team, evader, heading, elapsed, handover, t, data):
    active = data.draw(st.lists(st.booleans(), min_size=len(team), max_size=len(team)))
    known = {"evader": evader, "heading": heading, "elapsed": elapsed, "handover": handover, "t": t}
    for each in (strategy, type(strategy)(**dict(strategy) | WITH) if strategy in FLEEING else strategy):
        chosen = heading_of(each, *team, active=np.array(active, dtype=bool), **known)
        assert isinstance(chosen, complex)
        assert chosen == 0j or abs(chosen) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("strategy", FLEEING, ids=named)
def test_an_evader_that_flees_stands_still_without_pursuers(strategy):
    active_only = type(strategy)(**dict(strategy) | WITH)
    assert heading_of(strategy) == 0j
    assert heading_of(active_only, 1j, 2 + 0j, active=False) == 0j
    assert heading_of(strategy, 1j, 2 + 0j, active=False) != 0j


@pytest.mark.parametrize("strategy", WANDERING, ids=named)
def test_a_wandering_evader_moves_with_and_without_pursuers(strategy):
    assert heading_of(strategy) == heading_of(strategy, 1j, 2 + 0j) != 0j


@pytest.mark.slow
@pytest.mark.parametrize("strategy", FLEEING, ids=named)
@settings(max_examples=25)
@given(crowds, st.data())
def test_an_evader_that_flees_active_pursuers_ignores_the_others(strategy, team, data):
    active = data.draw(st.lists(st.booleans(), min_size=len(team), max_size=len(team)))
    alone = [place for place, chases in zip(team, active, strict=True) if chases]
    active_only = type(strategy)(**dict(strategy) | WITH)
    assert heading_of(active_only, *team, active=np.array(active)) == heading_of(strategy, *alone)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", [PureEvasion(), WeightedFlee(), Zigzag()], ids=named)
@settings(max_examples=50)
@given(crowds, points, points, angles)
def test_a_turned_and_moved_pursuit_has_a_turned_heading(strategy, team, evader, shift, angle):
    """Where nothing is a tie: a second pursuer as near as the nearest, or pushes that cancel."""
    distances = np.sort(np.abs(np.array(team) - evader))
    assume(distances[0] > 1e-3 and (len(team) == 1 or distances[1] > distances[0] * (1 + 1e-6)))
    turn = rect(1.0, angle)
    here = observation(*team, evader=evader)
    if isinstance(strategy, WeightedFlee):
        assume(abs((here.offsets / here.distances**3).sum()) * distances[0] ** 2 > 1e-3)
    there = observation(*(turn * (place - shift) for place in team), evader=turn * (evader - shift))
    rng = np.random.default_rng(0)
    assert strategy(there, rng) == pytest.approx(turn * strategy(here, rng), abs=1e-8)


@pytest.mark.slow
@given(crowds, points, points, st.integers(0, 3))
def test_a_vertex_is_at_the_same_place_of_an_arena_that_is_moved_and_turned_by_right_angles(team, evader, shift, k):
    """The headings may differ where two vertices are equally far; how far it can go may not."""
    low, high = ARENA
    moved = VoronoiVertex(arena=(low + shift.real, high + shift.real))
    shift = complex(shift.real, shift.real)
    here = heading_of(VoronoiVertex(arena=ARENA), *team, evader=evader)
    turned = [1j**k * place + shift for place in team]
    there = heading_of(moved, *turned, evader=1j**k * evader + shift)
    assume(low <= min(evader.real, evader.imag) and max(evader.real, evader.imag) <= high)
    assume(min(abs(place - evader) for place in team) > 0.01)
    reach = safe_length(evader, here, team, ARENA)
    assert reach == pytest.approx(safe_length(1j**k * evader + shift, there, turned, moved.arena), abs=1e-6)


# Each of them.


@pytest.mark.parametrize("active", [True, False])
def test_pure_evasion_flees_the_nearest_whether_it_chases_or_not(active):
    """Pursuers at 5 m and 2 m below and left: the heading is straight away from the one to the left."""
    assert heading_of(PureEvasion(), -5j, -2 + 0j, active=active) == 1 + 0j


def test_pure_evasion_from_active_pursuers_ignores_idle_ones():
    """The one to the left is nearest and stays; it flees from the one below."""
    assert heading_of(PureEvasion(flees_from="active"), -5j, -2 + 0j, active=[True, False]) == 1j


def test_pure_evasion_flees_the_lowest_of_several_nearest():
    assert heading_of(PureEvasion(), -2j, 2j) == 1j


@pytest.mark.parametrize("strategy", FLEEING[:-1], ids=named)
def test_an_evader_at_the_position_of_a_pursuer_stands_still(strategy):
    assert heading_of(strategy, 0j) == 0j


def test_a_weighted_flight_adds_up_unit_vectors_weighted_by_distance():
    """From -1 and from -2j: (1, 1), (1, 1/2) and (1, 1/4) for p = 0, 1, 2."""
    for power, across in ((0.0, 1.0), (1.0, 0.5), (2.0, 0.25)):
        expected = (1 + across * 1j) / abs(1 + across * 1j)
        assert heading_of(WeightedFlee(power=power), -1 + 0j, -2j) == pytest.approx(expected)


@pytest.mark.slow
@given(crowds, points)
def test_a_weighted_flight_tends_to_pure_evasion(team, evader):
    """With p = 200 a pursuer a fifth farther than the nearest weighs less than 1.2^-200 = 2e-16."""
    distances = np.sort(np.abs(np.array(team) - evader))
    assume(distances[0] > 1e-3 and (len(team) == 1 or distances[1] > 1.2 * distances[0]))
    pure = heading_of(PureEvasion(), *team, evader=evader)
    assert heading_of(WeightedFlee(power=200.0), *team, evader=evader) == pytest.approx(pure, abs=1e-12)
    assert heading_of(WeightedFlee(power=inf), *team, evader=evader) == pytest.approx(pure, abs=1e-12)


def test_pushes_that_cancel_leave_it_where_it_is():
    assert heading_of(WeightedFlee(), *(rect(3.0, 2 * pi * k / 5) for k in range(5))) == 0j


@pytest.mark.slow
@given(crowds, points, st.floats(0.0, 3.0))
def test_max_min_is_at_least_as_good_as_pure_evasion_by_its_own_measure(team, evader, speed):
    """And than any of its candidates: the grid begins with pure evasion."""
    here = observation(*team, evader=evader, speeds=speed)
    rng = np.random.default_rng(0)
    pure, best = PureEvasion()(here, rng), MaxMin()(here, rng)
    assume(pure)
    found, others = first_captures(here, np.array([best])), pure * np.exp(2j * pi * np.arange(72) / 72)
    assert found >= first_captures(here, np.array([pure]))
    assert found >= first_captures(here, others).max() * (1 - 1e-6)


@pytest.mark.slow
@given(points, points, st.floats(0.0, 3.0))
def test_max_min_of_one_pursuer_is_pure_evasion(pursuer, evader, speed):
    assume(pursuer != evader)
    known = {"evader": evader, "speeds": speed}
    assert heading_of(MaxMin(), pursuer, **known) == heading_of(PureEvasion(), pursuer, **known)


def test_max_min_escapes_between_two_pursuers():
    """Of those at -3 and 3, pure evasion runs into the second; across, both need the longest."""
    assert heading_of(PureEvasion(), -3 + 0j, 3 + 0j) == 1 + 0j
    assert abs(heading_of(MaxMin(), -3 + 0j, 3 + 0j).imag) == pytest.approx(1.0)


@pytest.mark.parametrize("strategy", [MaxMin(), MaxGeodesic()], ids=named)
def test_of_two_equally_good_headings_the_one_to_the_left_is_chosen_wherever_the_pursuit_is(strategy):
    """One pursuer is behind, the other ahead: as many degrees to the left as to the right of the line are as good."""
    rng = np.random.default_rng(2)
    for _ in range(50):
        ahead, place = rect(1.0, rng.uniform(-pi, pi)), complex(*rng.uniform(-9.0, 9.0, 2))
        behind = rng.uniform(0.5, 1.0)
        heading = heading_of(strategy, place - behind * ahead, place + 2.0 * behind * ahead, evader=place) / ahead
        assert heading.imag > 0.2, (ahead, place)


def test_first_captures_are_those_of_the_first():
    """Towards a pursuer of 1.5 m/s at 5 m, at 1 m/s: 4.9 / 2.5 s; away from it 4.9 / 0.5 s; the other is far."""
    times = first_captures(observation(5 + 0j, 1e3 + 0j), np.array([1 + 0j, -1 + 0j]))
    assert times == pytest.approx([4.9 / 2.5, 4.9 / 0.5])


def test_max_geodesic_looks_at_all_pursuers_that_may_come_near():
    """Against the candidates of a team in the plane, each with the distance of the nearest pursuer after the way."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        team = rng.uniform(-4.0, 4.0, (4, 2)) @ (1.0, 1.0j)
        heading = heading_of(MaxGeodesic(look_ahead=2.0), *team)
        ends = 2.0 * heading_of(PureEvasion(), *team) * np.exp(2j * pi * np.arange(16) / 16)
        nearest = abs(ends[:, np.newaxis] - team).min(axis=1)
        assert abs(2.0 * heading - team).min() == pytest.approx(nearest.max())


@pytest.mark.parametrize(("share", "heads_for"), [(0.2, -1.0), (0.999, -1.0), (1.001, 1.0), (9.0, 1.0)])
def test_a_place_to_which_a_pursuer_could_come_first_hides_nobody(share, heads_for):
    """All hiding places are on the left of a wall, and the pursuer is between it and the evader.

    With the speed of which it has a share it comes first to all of them.
    """
    space = space_among((Wall(line=((0.0, -1.0), (0.0, 1.0)), blocks=("sight",)),))
    places = space.hiding_places(0.5)
    places = places[space.hidden(places, np.array([1 + 0j]))]
    speed = share * (abs(places - 1.0) / abs(places - 2.0)).max()
    seen = observation(1 + 0j, evader=2 + 0j, speeds=speed).within(space)
    heading = Hide()(seen, np.random.default_rng(0))
    assert heading.real * heads_for > 0.5


def test_places_that_it_cannot_reach_hide_nobody():
    """In a closed room, which the places on its outside are hidden from, it flees; a pursuer may be unable to move."""
    room = ((0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (0.0, 6.0), (0.0, 0.0))
    space = space_among((Wall(line=room, blocks=("motion", "sight")),))
    seen = observation(1 + 1j, evader=3 + 3j, speeds=0.0)
    assert Hide()(seen.within(space), np.random.default_rng(0)) == pytest.approx(rect(1.0, pi / 4.0))
    assert seen.space is not space


def test_a_zigzag_goes_left_and_right_of_straight_away_by_the_clock():
    """With a period of 0.2 s it turns at 0.1 s, 0.2 s, 0.3 s .. to the nanosecond, however often it is asked."""
    strategy = Zigzag(period=0.2, amplitude=0.5)
    for k in range(40):
        for t, half in ((k * 10**8, k), ((k + 1) * 10**8 - 1, k)):
            expected = 1j * rect(1.0, -0.5 if half % 2 else 0.5)
            assert heading_of(strategy, -2j, t=t) == pytest.approx(expected)


@pytest.mark.parametrize(("strategy", "same"), [(Zigzag(period=0.4), True), (None, False)], ids=["zigzag", "control"])
def test_a_zigzag_leads_to_the_same_place_whatever_the_step(strategy, same):
    """From a pursuer so far that its direction does not change; the control turns whenever it is asked."""

    def turns_when_asked(state, rng):
        return rect(1.0, -0.7 if round(phase(state.heading) + 0.7) else 0.7) if state.heading else rect(1.0, -0.7)

    paths = [list(walk(strategy or turns_when_asked, h, 1.0, -1e9 + 0j)) for h in (0.1, 0.01)]
    coarse, fine = ([place for place, _ in path] for path in paths)
    assert (fine[::10] == pytest.approx(coarse, abs=1e-7)) == same


def turned(strategy, step, walkers=500, duration=0.5):
    """Return by what variance the heading has turned after a time, rad^2, and its standard error."""
    angles = []
    for seed in range(walkers):
        taken = [heading for _, heading in walk(strategy, step, duration + step, seed=seed)]
        angles.append(sum(phase(new / old) for old, new in pairwise(taken)))
    variance = float(np.var(angles, ddof=1))
    return variance, variance * sqrt(2 / (walkers - 1))


@pytest.mark.whole
def test_a_heading_diffuses_by_sigma_squared_t_whatever_the_step():
    """0.6^2 0.5 s = 0.18 rad^2, to 4 standard errors of 0.011; the control turns by as much at every step."""

    def control(state, rng):
        return state.heading * rect(1.0, rng.normal(0.0, 0.6 * sqrt(0.1))) if state.heading else 1 + 0j

    for step in (0.1, 0.01):
        variance, error = turned(Diffusion(sigma=0.6), step)
        assert abs(variance - 0.18) < 4 * error
    variance, error = turned(control, 0.01, walkers=50)
    assert abs(variance - 0.18) > 4 * error


@pytest.mark.parametrize("strategy", [Diffusion(), ConstantHeading()], ids=named)
def test_a_drawn_heading_is_uniform_over_all_directions(strategy):
    """The mean of 400 unit vectors has a standard deviation of 1 / sqrt(800) in each coordinate."""
    mean = np.mean([heading_of(strategy, seed=seed) for seed in range(400)])
    assert max(abs(mean.real), abs(mean.imag)) < 4 / sqrt(800)


def test_a_constant_heading_is_the_angle_or_drawn_once():
    assert heading_of(ConstantHeading(angle=pi / 2)) == pytest.approx(1j)
    headings = [heading for _, heading in walk(ConstantHeading(), 0.1, 1.0)]
    assert headings == pytest.approx([headings[0]] * 10)
    assert heading_of(ConstantHeading(), seed=1) != heading_of(ConstantHeading(), seed=2)


def test_a_stationary_evader_draws_no_random_numbers():
    assert heading_of(Still(), 1j) == 0j


@pytest.mark.parametrize("handover", [True, False])
def test_a_listener_switches_strategy_while_a_handover_is_in_flight(handover):
    assert heading_of(Listener(), -1j, handover=handover) == (1j if handover else 0j)
    other = Listener(during_handover=ConstantHeading(angle=0.0), normally=PureEvasion())
    assert heading_of(other, -1j, handover=handover) == (1 + 0j if handover else 1j)


# The farthest vertex.


def safe_length(evader, heading, team, arena):
    """Return how far it can go on a heading inside an arena and nearer to it than to all of a team, m.

    A point s u away is nearer to the evader than to x_i as long as 2 s u.(x_i - x_e) <= |x_i - x_e|^2.
    """
    limits = [inf]
    for z in np.array(team) - evader:
        along = 2.0 * (z * heading.conjugate()).real
        limits.append(abs(z) ** 2 / along if along > 0.0 else inf)
    for place, way in ((evader.real, heading.real), (evader.imag, heading.imag)):
        limits.append((arena[1] - place) / way if way > 1e-12 else inf)
        limits.append((arena[0] - place) / way if way < -1e-12 else inf)
    return min(limits)


@pytest.mark.slow
@given(crowds, points, headings, st.sampled_from([0.0, 0.1, 0.5]))
def test_the_vertex_is_the_farthest_point_of_the_voronoi_cell(team, evader, heading, hysteresis):
    """By brute force: of a grid of points, those in the cell are no farther than it goes, but for the hysteresis."""
    low, high = ARENA
    assume(low <= min(evader.real, evader.imag) and max(evader.real, evader.imag) <= high)
    strategy = VoronoiVertex(arena=ARENA, hysteresis=hysteresis)
    chosen = heading_of(strategy, *team, evader=evader, heading=heading)
    side = np.linspace(low, high, 41)
    grid = (side[:, np.newaxis] + 1j * side).ravel()
    own = abs(grid - evader)
    own = own[(own < np.abs(grid - np.array(team)[:, np.newaxis])).all(axis=0)]
    assert safe_length(evader, chosen, team, ARENA) * (1 + hysteresis) >= own.max(initial=0.0) - 1e-6


def test_the_vertex_is_known_in_a_small_case():
    """One pursuer 8 m below the middle of a square of 20 m: the upper corners are 14.1 m away, the lower end 10.8 m."""
    chosen = heading_of(VoronoiVertex(arena=ARENA), -8j)
    assert (abs(chosen.real), chosen.imag) == pytest.approx((sqrt(0.5), sqrt(0.5)))


@pytest.mark.parametrize(("evader", "nearest"), [(13 + 5j, 10 + 5j), (-11 - 14j, -10 - 10j)])
def test_from_outside_it_goes_to_the_nearest_point_of_the_arena(evader, nearest):
    way = nearest - evader
    assert heading_of(VoronoiVertex(arena=ARENA), 0j, evader=evader) == pytest.approx(way / abs(way))


@pytest.mark.slow
def test_between_two_vertices_it_turns_as_often_whatever_the_step():
    """One pursuer below, so that both upper corners are equally far, for 12 s; without hysteresis it chatters."""

    def count(hysteresis, step):
        return turns(walk(VoronoiVertex(arena=ARENA, hysteresis=hysteresis), step, 12.0, -8j, evader=5j))

    coarse, fine = count(0.1, 0.05), count(0.1, 0.005)
    assert 2 <= fine <= 30
    assert abs(coarse - fine) <= 1
    assert count(0.0, 0.05) > 100


# In files.


@pytest.fixture
def written(tmp_path):
    """Return a function that writes a scenario whose evader has a strategy on line 4."""

    def write(text):
        (tmp_path / "s.toml").write_text(f'name = "s"\n\n[evader]\n{text}\n')
        return tmp_path / "s.toml"

    return write


REQUIRED = {"voronoi_vertex": ", arena = [0.0, 20.0]", "recorded": ", waypoints = [[0, 10, 10]]"}
"""The keys that a kind of strategy cannot do without."""


@pytest.mark.parametrize("kind", STRATEGIES.choices())
def test_a_file_may_ask_for_each_kind(written, kind):
    strategy = load(written(f'strategy = {{ kind = "{kind}"{REQUIRED.get(kind, "")} }}')).evader.strategy
    assert kind_of(type(strategy)) == kind
    assert Evader.model_validate(Evader(strategy=strategy).plain()).strategy == strategy


def test_every_strategy_is_tested():
    """Recorded motion, whose heading is not 1 long, in tests/pursuit/test_recorded.py."""
    assert {strategy.kind for strategy in ALL} == set(STRATEGIES.choices()) - {"recorded"}


def test_a_listener_holds_strategies_of_its_own(written):
    file = written('strategy = { kind = "listener", during_handover = { kind = "zigzag", amplitude = 0.5 } }')
    assert load(file).evader.strategy == Listener(during_handover=Zigzag(amplitude=0.5), normally=Still())


# Points.


def test_points_are_complex_numbers_inside_and_coordinates_outside():
    at = np.array([[1.0, 2.0], [3.0, -4.0]])
    assert complex_points(at).tolist() == [1 + 2j, 3 - 4j]
    assert coordinates(complex_points(at)).tolist() == at.tolist()

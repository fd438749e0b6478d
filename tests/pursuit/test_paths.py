"""Shortest paths among walls: against other libraries, closed forms, and the rules of touching."""

import json
from cmath import rect
from itertools import pairwise
from math import acos, inf, pi, sqrt
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.kernel.walls.crossings import WallShape, crossings, segments_of
from desim.kernel.walls.wall import Wall
from desim.pursuit.core.state import complex_points, coordinates
from desim.pursuit.paths.obstacles import Obstacles
from desim.pursuit.paths.shortest_paths import ShortestPaths
from desim.pursuit.paths.space import PLANE, Walled, space_among

ORACLE = json.loads((Path(__file__).parent / "shortest_paths.json").read_text())


def lines(*corners):
    return [[WallShape(np.array(line, dtype=float), closed=False)] for line in corners]


def polygons(*corners):
    return [[WallShape(np.array(polygon, dtype=float), closed=True)] for polygon in corners]


def paths(walls):
    return ShortestPaths(Obstacles(walls))


def length(path):
    return sum(abs(end - begin) for begin, end in pairwise(path))


@pytest.mark.slow
@pytest.mark.parametrize("world", range(5))
def test_lengths_are_those_of_another_library(world):
    shapes, queries = ORACLE["polygons"][world].values()
    shortest = paths(polygons(*shapes))
    assert len(queries) == 220  # with the other worlds, 1,100
    for x, y, u, v, expected in queries:
        source, target = complex(x, y), complex(u, v)
        assert shortest.distance(source, target) == pytest.approx(expected, abs=1e-12)
        assert length(shortest.path(source, target)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("world", range(20))
def test_walls_that_meet_cross_and_coincide_leave_no_gap(world):
    """Random walls and boxes on a grid: nearly all share corners, end on each other, cross or coincide."""
    walls, boxes, queries = ORACLE["meeting"][world].values()
    shortest = paths(lines(*walls) + polygons(*boxes))
    for x, y, u, v, expected in queries:
        there, back = shortest.distance(complex(x, y), complex(u, v)), shortest.distance(complex(u, v), complex(x, y))
        assert there == pytest.approx(inf if expected is None else expected, abs=5e-5)
        assert back == pytest.approx(there, abs=1e-12)


@pytest.mark.parametrize(("corners", "expected"), [(8, 4.477985), (16, 4.505555), (64, 4.510893)])
def test_paths_round_a_polygon_approach_the_path_round_its_circle_from_below(corners, expected):
    polygon = [[z.real, z.imag] for z in (rect(1.0, 2.0 * pi * k / corners) for k in range(corners))]
    distance = paths(polygons(polygon)).distance(-2.0 + 0j, 2.0 + 0j)
    assert distance == pytest.approx(expected, abs=5e-7)
    disc = 2.0 * sqrt(3.0) + pi - 2.0 * acos(0.5)
    assert distance < disc == pytest.approx(4.511299, abs=5e-7)


def test_a_path_round_a_wall_of_10_m():
    shortest = paths(lines([[0, -5], [0, 5]]))
    assert shortest.distance(-0.5 + 0j, 0.5 + 0j) == pytest.approx(2.0 * sqrt(25.25), abs=1e-12)
    assert shortest.distance(-0.5 + 0j, 0.5 + 0j) == pytest.approx(10.049876, abs=5e-7)
    assert shortest.distance(-0.5 + 6j, 0.5 + 6j) == 1.0


Z = [[0, 2], [1, 1], [3, 1], [4, 0]]
"""A wall whose middle piece is horizontal, with an arm up on the left and one down on the right."""


@pytest.mark.parametrize(
    ("walls", "source", "target", "expected"),
    [
        pytest.param(lines([[0, 0], [4, 0]]), -1, 5, 6.0, id="slides along a wall"),
        pytest.param(lines([[0, 0], [4, 0]]), 2 - 1j, 2 - 0j, 1.0, id="ends on a wall"),
        pytest.param(lines([[0, 0], [0, 4]], [[0, 0], [0, -4]]), -1, 1, 2.0 * sqrt(17), id="shared end"),
        pytest.param(lines([[0, 0], [0, 4]], [[-3, 0], [3, 0]]), -1 + 1j, 1 + 1j, None, id="ends on another"),
        pytest.param(lines([[0, 0.1 + 0.2], [0, 4]], [[-3, 0.3], [3, 0.3]]), -1 + 1j, 1 + 1j, None, id="rounded"),
        pytest.param(lines([[0, -1], [0, 4]], [[-3, 0], [3, 0]]), -1 + 1j, 1 - 1j, None, id="crossing walls"),
        pytest.param(lines(Z), -1 + 1j, 5 + 1j, None, id="collinear with a piece, other side"),
        pytest.param(lines(Z), 0.5 + 1j, 2.5 + 0.5j, abs(2 - 0.5j), id="collinear with a piece, same side"),
        pytest.param(lines([[0, 0], [2, 2], [4, 0]]), 2 + 1j, 2 + 2j, None, id="a corner from within"),
        pytest.param(polygons([[0, 0], [2, 0], [2, 2], [0, 2]]), 0j, 2 + 2j, 4.0, id="from corner to corner"),
        pytest.param(polygons([[0, 0], [2, 0], [2, 2], [0, 2]]), 1 + 0j, 1 + 2j, 4.0, id="from side to side"),
        pytest.param(polygons([[0, 0], [2, 0], [2, 2], [0, 2]]), 0.5 + 0j, 1.5 + 0j, 1.0, id="along a side"),
        pytest.param(
            polygons([[0, 0], [2, 0], [2, 2], [0, 2]], [[2, 0], [4, 0], [4, 2], [2, 2]]),
            *(2 - 1j, 2 + 3j, 2.0 * sqrt(5) + 2.0),
            id="between two boxes that touch",
        ),
    ],
)
def test_paths_touch_and_slide_and_never_cross(walls, source, target, expected):
    shortest = paths(walls)
    path = shortest.path(complex(source), complex(target))
    if expected is None:
        assert length(path) > abs(target - source) + 0.3
    else:
        assert length(path) == pytest.approx(expected, abs=1e-9)
    assert shortest.distance(complex(target), complex(source)) == pytest.approx(length(path), abs=1e-12)


def test_a_hole_is_free_and_closed():
    """A room: the hole of a polygon, which no path leaves; and a place in the wall itself."""
    outer, inner = [[0, 0], [9, 0], [9, 9], [0, 9]], [[1, 1], [8, 1], [8, 8], [1, 8]]
    obstacles = Obstacles([[WallShape(np.array(ring, dtype=float), closed=True) for ring in (outer, inner)]])
    assert obstacles.are_free(np.array([5 + 5j, 0.5 + 5j, 1 + 5j, -1 + 5j])).tolist() == [True, False, False, True]
    shortest = ShortestPaths(obstacles)
    assert shortest.distance(2 + 2j, 7 + 7j) == pytest.approx(5 * sqrt(2))
    assert shortest.distance(5 + 5j, -1 + 5j) == inf
    assert shortest.path(5 + 5j, -1 + 5j) == []
    assert shortest.distance(-1 + 4j, 10 + 4j) == pytest.approx(2.0 * sqrt(17) + 9.0)


@pytest.mark.parametrize("ring", [[[0, 0], [4, 0], [4, 2], [0, 2]], [[0, 0], [0, 2], [4, 2], [4, 0]]])
def test_a_place_on_a_side_of_a_box_is_seen_from_outside_of_this_side_only(ring):
    """Along the side and from below, but not from within, from another side, or from above."""
    obstacles = Obstacles(polygons(ring))
    others, seen = [3 + 0j, 2 - 1j, 2 + 1j, 3 + 2j, 0 + 1j, 2 + 5j], [True, True, False, False, False, False]
    assert obstacles.clear(1 + 0j, np.array(others)).tolist() == seen
    assert [obstacles.clear(other, np.array([1 + 0j])).item() for other in others] == seen


@pytest.mark.parametrize("reverse", [False, True])
def test_a_corner_sees_all_to_which_no_line_leads_through_a_box(reverse):
    """From each corner of two boxes, to places on a grid, many of which lie behind a side or a corner.

    Between two boxes, and along their sides, lines are free; samples of a line lie strictly within a box if it crosses
    the box.
    """
    boxes = [(0.0, 0.0, 4.0, 2.0), (8.0, 4.0, 10.0, 6.0)]
    rings = [[[a, b], [c, b], [c, d], [a, d]] for a, b, c, d in boxes]
    obstacles = Obstacles(polygons(*(ring[::-1] if reverse else ring for ring in rings)))
    grid = [complex(x, y) for x in range(-4, 15, 2) for y in range(-4, 11, 2)]
    places = [each for each in grid if not any(a < each.real < c and b < each.imag < d for a, b, c, d in boxes)]
    shares = np.linspace(0.0, 1.0, 401)[1:-1]
    for corner in (complex(x, y) for ring in rings for x, y in ring):
        targets = [each for each in places if each != corner]
        lines_to = corner + shares * (np.array(targets)[:, None] - corner)
        crossed = [
            (a < lines_to.real) & (lines_to.real < c) & (b < lines_to.imag) & (lines_to.imag < d)
            for a, b, c, d in boxes
        ]
        free = (~np.any(crossed, axis=(0, 2))).tolist()
        assert obstacles.clear(corner, np.array(targets)).tolist() == free
        assert [obstacles.clear(target, np.array([corner])).item() for target in targets] == free


BOXES = [[[x, y], [x + 2, y], [x + 2, y + 2], [x, y + 2]] for x in (1, 6, 11, 16) for y in (1, 7, 13)]


@pytest.mark.slow
def test_a_query_with_48_corners_takes_less_than_a_millisecond():
    shortest = paths(polygons(*BOXES))
    assert len(shortest.obstacles.bends) == 48
    ends = np.random.default_rng(0).uniform(0.0, 20.0, (400, 2))
    places = complex_points(ends)
    places = places[shortest.obstacles.are_free(places)].tolist()
    begin = process_time()
    for source, target in pairwise(places):
        shortest.distance(source, target)
    assert (process_time() - begin) / len(places) < 1e-3


def test_distances_of_many_are_those_of_each():
    shortest = paths(polygons(*BOXES))
    places = complex_points(np.random.default_rng(1).uniform(0.0, 20.0, (60, 2)))
    places = places[shortest.obstacles.are_free(places)]
    target = 9.5 + 11j
    assert shortest.distances(target, places).tolist() == [
        pytest.approx(shortest.distance(place, target), abs=1e-12) for place in places.tolist()
    ]


@given(seed=st.integers(0, 10_000))
def test_whoever_slides_crosses_no_wall_and_keeps_off_it(seed):
    """Random ways among walls and boxes that meet, against the crossings that radio and sight use."""
    rng = np.random.default_rng(seed)
    world = ORACLE["meeting"][seed % 20]
    walls = lines(*world["lines"]) + polygons(*world["polygons"])
    obstacles, segments = Obstacles(walls), segments_of((0, shape) for wall in walls for shape in wall)
    place = complex(*rng.uniform(-1.0, 6.0, 2))
    if not obstacles.are_free(np.array([place]))[0]:
        return
    for _ in range(30):
        way = rect(rng.uniform(0.0, 1.5), rng.uniform(0.0, 2.0 * pi))
        slid = obstacles.slide(place, way)
        assert abs(slid) <= abs(way) + 1e-9
        ends = coordinates(np.array([place, place + slid]))
        assert not crossings(ends[:1], ends[1:], segments).any()
        assert obstacles.are_free(np.array([place + slid]))[0] or abs(slid) < 1e-9
        place += slid


def test_a_way_into_a_wall_becomes_one_along_it():
    obstacles = Obstacles(lines([[-5, 0], [5, 0]]))
    end = 1j + obstacles.slide(1j, 2.0 - 3.0j)
    assert end == pytest.approx(2.0 + 0j, abs=1e-8)
    assert end.imag > 0.0
    assert obstacles.slide(1j, 2.0 + 3.0j) == 2.0 + 3.0j
    corner = Obstacles(lines([[-5, 0], [5, 0], [5, 5]]))
    stuck = 4.9 + 0.1j + corner.slide(4.9 + 0.1j, 1.0 - 1.0j)
    assert stuck == pytest.approx(5.0 + 0j, abs=1e-8)


def test_a_player_on_the_line_of_a_wall_goes_along_one_of_its_sides():
    """Otherwise it would be on a line without thickness, and leave it to either side."""
    obstacles = Obstacles(lines([[0, 0], [5, 0]]))
    place = -1 + 0j
    for _ in range(10):
        place += obstacles.slide(place, 0.37 + 0j)
    assert place.real == pytest.approx(2.7)
    assert obstacles.are_free(np.array([place]))[0]
    sides = {(place + obstacles.slide(place, way)).imag > 0.0 for way in (1j, -1j)}
    assert len(sides) == 1
    assert obstacles.slide(-1 + 0j, -1 + 0j) == -1
    assert obstacles.slide(6 + 0j, -0.5 + 0j) == -0.5
    for box in ([[0, 0], [5, 0], [5, 5], [0, 5]], [[0, 0], [5, 0], [5, -5], [0, -5]]):
        solid, place = Obstacles(polygons(box)), -1 + 0j
        for _ in range(10):
            place += solid.slide(place, 0.37 + 0j)
        assert place.real == pytest.approx(2.7)
        assert solid.are_free(np.array([place]))[0]


def test_a_place_inside_a_wall_is_replaced_by_the_nearest_outside():
    space = Walled([Wall(polygon=((0, 0), (4, 0), (4, 4), (0, 4)))])
    assert space.free_place(5 + 1j) == 5 + 1j
    assert space.free_place(3.5 + 2j) == pytest.approx(4 + 2j, abs=1e-8)
    assert space.are_free(np.array([space.free_place(3.5 + 2j)]))[0]


def test_a_player_that_follows_a_path_turns_beside_its_corners():
    """Its way is the shortest path up to the resolution of time and the clearance, and it stays off the walls."""
    space = Walled([Wall(line=((0, -5), (0, 50)))])
    source, target, speed = -0.5 + 0j, 0.5 + 0j, 2.0
    total = 2.0 * sqrt(25.25)
    for share in (0.1, 0.5, 0.9, 1.0):
        now = round(share * total / speed * 1e9)
        place = space.advance(source, target, speed, 0, now, now)
        assert space.distance(source, place) == pytest.approx(share * total, abs=1e-7)
        assert space.along(source, target, share * total) == pytest.approx(place, abs=1e-7)


def test_a_player_stands_at_an_aim_before_a_wall():
    """It does not come to the wall, whenever it is asked; if it cannot turn within the step, it comes later."""
    space, aim, step = Walled([Wall(line=((0, -5), (0, 5)))]), -0.01 + 0.7j, 200_000_000
    for here in (-0.2 + 0.5j, -0.1 + 1j, -0.3 + 0.71j):
        velocity, turn = space.course(here, aim, 2.0, 0, step, stops=False)
        assert abs(velocity) == pytest.approx(2.0)
        assert turn == pytest.approx(abs(aim - here) / 2.0 * 1e9, abs=1)
        for now in (turn, turn + 1, step):
            place = space.advance(here, aim, 2.0, 0, now, step)
            assert place == pytest.approx(aim, abs=3e-9)
            assert space.are_free(np.array([place]))[0]
        kept, until = space.course(here, aim, 2.0, 0, step, stops=False, turns=False)
        assert (here + kept * 0.2, until) == (pytest.approx(aim), step)
    aside = -0.3 + 0.69j  # no wall within a step
    assert space.course(-0.3 + 0.4j, aside, 2.0, 0, step, stops=False) == (pytest.approx(2j), step)
    assert space.course(-0.3 + 0.4j, aside, 2.0, 0, step, stops=True) == (pytest.approx(1.45j), step)


def test_walls_that_do_not_block_motion_leave_the_plane():
    line = ((0.0, -5.0), (0.0, 5.0))
    assert space_among(()) is PLANE
    assert space_among((Wall(line=line, blocks=("radio",)),)) is PLANE
    sight = space_among((Wall(line=line, blocks=("sight",)),))
    assert sight.is_open
    assert sight.distance(-1 + 0j, 1 + 0j) == 2.0
    assert sight.hidden(np.array([1 + 0j, -2 + 0j, 1 + 12j]), np.array([-1 + 0j])).tolist() == [True, False, False]
    walled = space_among((Wall(line=line),))
    assert walled is space_among((Wall(line=line),))  # corners are compared once
    assert walled is not space_among((Wall(line=line, blocks=("motion",)),))


def test_walls_that_block_starts_alone_let_players_through():
    box = Wall(polygon=((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)), blocks=("start",))
    line = Wall(line=((5.0, -5.0), (5.0, 5.0)), blocks=("motion",))
    places = np.array([0.5 + 0.5j, 3 + 3j, 5 + 0j])
    for walls, free, start in [
        ((box,), [True, True, True], [False, True, True]),
        ((box, line), [True, True, False], [False, True, False]),
        ((line,), [True, True, False], [True, True, False]),
    ]:
        space = space_among(walls)
        assert space.are_free(places).tolist() == free
        assert space.may_start(places).tolist() == start
        assert space.distance(-1 + 0.5j, 2 + 0.5j) == 3.0


@pytest.mark.parametrize("flight", [0.0, 0.9, 0.99])
def test_a_contact_round_a_corner_is_found_however_slowly_the_path_shortens(flight):
    """A pursuer 0.2 m from the end of a wall comes at 1 m/s, and an evader 0.1 m beyond it flees: 0.3 - (1 - v) t m."""
    space = Walled([Wall(line=((-9.0, 0.0), (0.0, 0.0)))])
    away, towards = (-1 + 1j) / sqrt(2.0), (1 + 1j) / sqrt(2.0)
    players = 0.1 * away, flight * away, -0.2 * towards, towards
    for early in (0.0, 1e-5, 5e-4):
        found = space.contact(*players, 0.3 - early, 0.1)
        assert found == pytest.approx(early / (1.0 - flight), abs=2e-9)


def test_the_vector_of_an_arrival_is_as_long_as_the_path():
    space = Walled([Wall(line=((0, -5), (0, 50))), Wall(line=((9, 9), (9, 7), (7, 7), (7, 9), (9, 9)))])
    offsets = space.arrivals(0.5 + 0j, np.array([-0.5 + 0j, 3 + 4j, 8 + 8j]))
    assert offsets[0] == pytest.approx((0.5 + 5j) * 2.0, abs=1e-8)
    assert offsets[1] == 0.5 - (3 + 4j)
    assert abs(offsets[2]) == inf


def test_an_arrival_comes_from_the_last_corner_of_the_path_and_not_from_the_first():
    """Among boxes many paths have several corners; from the target to the source the first corner is another one."""
    space, rng = Walled([Wall(polygon=tuple(map(tuple, box))) for box in BOXES]), np.random.default_rng(2)
    places = rng.uniform(0.0, 19.0, 80) + 1j * rng.uniform(0.0, 16.0, 80)
    target, *sources = places[space.are_free(places)].tolist()
    several = 0
    for source, offset in zip(sources, space.arrivals(target, np.array(sources)).tolist(), strict=True):
        path = space.paths.path(source, target)
        last_leg = target - path[-2]
        assert offset == pytest.approx(last_leg / abs(last_leg) * space.distance(source, target), abs=1e-6)
        several += len(path) > 3
    assert several > 10

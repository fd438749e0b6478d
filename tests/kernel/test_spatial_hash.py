"""Spatial hash: all near nodes are among those found, however the nodes move."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim.kernel.core.positions import PositionSource, as_position_source
from desim.kernel.topology.spatial_hash import MIN_SIDE, VERLET_SKIN, CellList


def near(at, node, radius):
    return set(np.flatnonzero(np.hypot(*(at - at[node]).T) <= radius).tolist())


def line(count, apart):
    return np.column_stack([apart * np.arange(count), np.zeros(count)])


class Flying(PositionSource):
    """Every node moves straight; counts how often all positions were read."""

    def __init__(self, origins, velocities, fastest):
        self.origins, self.velocities, self.max_speed = origins, velocities, fastest
        self.now = 0.0
        self.looks = 0

    def __call__(self):
        self.looks += 1
        return self.origins + self.velocities * self.now

    def of(self, nodes):
        return self()[nodes]


def test_far_nodes_are_not_found():
    """A hundred nodes 1 m apart: within 10 m there are 20, three cells of 12.5 m have at most 39."""
    cells = CellList(as_position_source(lambda: line(100, 1.0) - 50.0), 10.0)
    assert {len(cells.around(node)) for node in range(30, 70)} <= set(range(21, 40))


def test_found_nodes_are_ascending_and_include_the_node_itself():
    at = np.random.default_rng(1).uniform(-30.0, 30.0, (200, 2))
    cells = CellList(as_position_source(lambda: at), 5.0)
    for node in range(200):
        found = cells.around(node).tolist()
        assert found == sorted(set(found))
        assert {node} <= near(at, node, 5.0) <= set(found)


def test_only_nodes_near_a_cell_change_are_searched_again():
    """Node 0 flies over to node 50; what was found around node 99 is still there, the same array."""
    at = line(100, 10.0)
    cells = CellList(as_position_source(lambda: at), 10.0)
    before = [cells.around(node) for node in range(100)]
    at[0] = at[50]
    assert 0 in cells.around(50)
    assert 0 not in cells.around(1)
    assert all(cells.around(node) is before[node] for node in range(60, 100))


def test_no_positions_are_read_until_a_node_can_have_moved_half_the_skin():
    """At 2 m/s two nodes are 10 SKIN m nearer after 10 SKIN / 4 s; cells are by a thousandth larger."""
    flying = Flying(line(100, 1.0), np.tile([2.0, 0.0], (100, 1)), 2.0)
    cells = CellList(flying, 10.0, lambda: flying.now)
    for flying.now in (0.0, 1.0 * VERLET_SKIN, 2.499 * VERLET_SKIN):
        cells.around(7)
        assert flying.looks == 1
    flying.now = 2.51 * VERLET_SKIN
    cells.around(7)
    assert flying.looks == 2
    cells.around(8)
    assert flying.looks == 2


def test_without_a_time_all_positions_are_read():
    flying = Flying(line(100, 1.0), np.zeros((100, 2)), 2.0)
    cells = CellList(flying, 10.0)
    flying.origins[99] = [0.0, 0.0]
    assert 99 in cells.around(0)


@pytest.mark.parametrize("view", [False, True])
def test_an_array_is_assumed_unchanged_only_if_it_is_not_writable(view):
    """The same array is handed out again; one that is a view of another may change although it is read-only itself."""
    at = line(100, 10.0)
    shown = at[:] if view else at
    cells = CellList(as_position_source(lambda: shown), 10.0)
    shown.setflags(write=False)
    assert 99 not in cells.around(0)
    at.setflags(write=True)
    if not view:
        shown.setflags(write=True)
    at[99] = [1.0, 1.0]
    assert 99 in cells.around(0)


def test_a_new_read_only_array_is_read():
    history = [line(100, 10.0), line(100, 10.0)]
    history[1][99] = [1.0, 1.0]
    for at in history:
        at.setflags(write=False)
    turn = [0, 0, 1, 1, 0]
    cells = CellList(as_position_source(lambda: history[turn[0]]), 10.0)
    found = []
    while len(turn) > 1:
        turn.pop(0)
        found.append(99 in cells.around(0))
    assert found == [False, True, True, False]


def test_the_smallest_of_cells_is_large_enough_for_the_farthest_of_coordinates():
    at = np.array([[1e9, -1e9], [1e9, -1e9], [np.nextafter(1e9, 0.0), -1e9], [-1e9, 1e9]])
    cells = CellList(as_position_source(lambda: at), 1e-12)
    assert set(cells.around(0).tolist()) >= {0, 1}
    assert 3 not in cells.around(0)
    assert MIN_SIDE < 1e-3


RADII = st.sampled_from([0.0, 5e-324, 1e-9, 1e-3, 1.0, 7.3, 1e6, 1e9, 1e300, 1.7e308])


@st.composite
def crowds(draw, size, radius):
    """Return (size, 2) coordinates: anywhere, on the borders of cells, a radius apart, at one place."""
    unit = draw(st.sampled_from([radius, 1.001 * (1.0 + VERLET_SKIN) * radius, MIN_SIDE, 1.0, 1e8]))
    unit = unit if unit <= 1e8 else 1.0
    random_heading = st.one_of(
        st.integers(-9, 9).map(lambda k: k * unit),
        st.integers(-3, 3).map(lambda k: float(np.nextafter(k * unit, 1e9))),
        st.floats(-9.0 * unit, 9.0 * unit),
        st.sampled_from([0.0, -0.0, 1e9, -1e9]),
    )
    return np.array(draw(st.lists(random_heading, min_size=2 * size, max_size=2 * size))).reshape(size, 2)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.data(), st.integers(1, 6), RADII, st.booleans())
def test_all_near_nodes_are_found_with_arbitrary_jumps(data, size, radius, in_place):
    at = data.draw(crowds(size, radius))
    shown = [at]
    cells = CellList(as_position_source(lambda: shown[0]), radius)
    for _ in range(3):
        for node in range(size):
            assert near(shown[0], node, radius) <= set(cells.around(node).tolist())
        new = data.draw(crowds(size, radius))
        keep = data.draw(st.lists(st.booleans(), min_size=size, max_size=size))
        new[keep] = shown[0][keep]
        if in_place:
            shown[0][:] = new
        else:
            shown[0] = new
            new.setflags(write=False)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.data(), st.integers(2, 6), st.sampled_from([1e-3, 1.0, 7.3, 1e6]), st.sampled_from([0.0, 1e-3, 1.0, 30.0]))
def test_all_near_nodes_are_found_with_bounded_speeds(data, size, radius, fastest):
    speed = st.sampled_from([-1.0, 0.0, 1.0, 0.6])
    pace = fastest * radius
    drawn = data.draw(st.lists(speed, min_size=size, max_size=size))
    velocities = pace * np.column_stack([drawn, np.zeros(size)])
    flying = Flying(data.draw(crowds(size, radius)), velocities, pace)
    cells = CellList(flying, radius, lambda: flying.now)
    step = st.sampled_from([0.0, 1e-9, 0.1, VERLET_SKIN / 2.0, VERLET_SKIN, 1.0, 50.0])
    for _ in range(6):
        for node in range(size):
            assert near(flying(), node, radius) <= set(cells.around(node).tolist())
        flying.now += data.draw(step) / max(fastest, 1e-3)

"""Evader strategies."""

import numpy as np
import pytest

from desim.pursuit.evasion import PureEvasion
from desim.pursuit.state import State, complex_points, coordinates


def state(*pursuers, evader=0j, active=True):
    return State(0, np.array([*pursuers, evader]), np.full(len(pursuers), active))


@pytest.mark.parametrize("active", [True, False])
def test_pure_evasion_flees_the_nearest_whether_it_chases_or_not(active):
    """Pursuers at 5 m and 2 m below and left: the heading is straight away from the one to the left."""
    assert PureEvasion()(state(-5j, -2 + 0j, active=active), np.random.default_rng()) == 1 + 0j


def test_pure_evasion_flees_the_lowest_of_several_nearest():
    assert PureEvasion()(state(-2j, 2j), np.random.default_rng()) == 1j


def test_pure_evasion_of_a_pursuer_right_here_stands_still():
    assert PureEvasion()(state(0j), np.random.default_rng()) == 0j


def test_points_are_complex_numbers_inside_and_coordinates_outside():
    at = np.array([[1.0, 2.0], [3.0, -4.0]])
    assert complex_points(at).tolist() == [1 + 2j, 3 - 4j]
    assert coordinates(complex_points(at)).tolist() == at.tolist()

"""Motion in straight pieces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.pursuit.core.geometry import first_contact, toward

numbers = st.floats(-10.0, 10.0).map(lambda x: round(x, 6))
plane = st.builds(complex, numbers, numbers)


def test_headings_have_the_speed_asked_for_and_none_at_distance_0():
    velocities = toward(np.array([3 + 4j, 0j, 2j]), np.array([2.0, 5.0, 0.0]))
    assert velocities == pytest.approx([1.2 + 1.6j, 0j, 0j])


@given(st.lists(st.tuples(plane, plane), min_size=1, max_size=4), st.floats(0.01, 1.0), st.floats(0.01, 5.0))
def test_first_contact_is_the_first_time_within_the_radius(motions, radius, duration):
    """At the contact the distance is the radius; before it, sampled finely, no pursuer is within."""
    p, q = np.array([m[0] for m in motions]), np.array([m[1] for m in motions])
    contact = first_contact(p, q, radius, duration)
    until = duration if contact is None else contact[0]
    samples = np.linspace(0.0, until, 300)[:-1]
    assert not samples.size or (np.abs(p[:, None] + q[:, None] * samples) > radius - 1e-7).all() or until == 0.0
    if contact is None:
        assert np.abs(p + q * duration).min() > radius - 1e-7
    else:
        time, row = contact
        assert 0.0 <= time <= duration
        apart = abs(p[row] + q[row] * time)
        assert apart <= radius if time == 0.0 else apart == pytest.approx(radius, abs=1e-6)


def test_contact_between_two_samples_is_seen():
    """A player that crosses the disc of 0.1 m at 2 m/s is inside for 0.1 s only."""
    assert first_contact(np.array([-1 + 0j]), np.array([2 + 0j]), 0.1, 1.0) == (pytest.approx(0.45), 0)


def test_a_tangent_misses_and_a_secant_meets():
    assert first_contact(np.array([-1 + 0.1001j]), np.array([1 + 0j]), 0.1, 5.0) is None
    assert first_contact(np.array([-1 + 0.0999j]), np.array([1 + 0j]), 0.1, 5.0) is not None


def test_moving_away_is_caught_at_once_from_inside_and_never_from_outside():
    assert first_contact(np.array([0.05 + 0j]), np.array([1 + 0j]), 0.1, 1.0) == (0.0, 0)
    assert first_contact(np.array([0.2 + 0j]), np.array([1 + 0j]), 0.1, 1.0) is None


@pytest.mark.parametrize("speed", [5e-324, 1e-300, 1e-150])
def test_an_approach_at_next_to_no_speed_takes_longer_than_any_run(speed):
    assert first_contact(np.array([1 + 0j]), np.array([-speed + 0j]), 0.1, 1e9) is None


def test_ties_go_to_the_lowest_row():
    assert first_contact(np.array([1 + 0j, 1j]), np.array([-1 + 0j, -1j]), 0.1, 2.0) == (pytest.approx(0.9), 0)

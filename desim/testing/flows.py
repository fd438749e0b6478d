"""The check of flows: `check_flow`."""

from functools import partial
from math import inf
from typing import Any

import numpy as np

from desim.config.arguments import naming_arguments
from desim.config.arrays import Points
from desim.pursuit.core.state import lengths
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.flow import FLOWS, FlowTraits, UniformFlow
from desim.scenario.players import Team
from desim.scenario.scenario import Scenario
from desim.testing.judging import SEED, Subject, subject, twice

TIMES = (0.0, 0.1, 7.3, 1000.0)
"""Times at which the flow is asked, s."""
EXTENT = 60.0
"""Largest coordinate of the places, m."""
PLACES = 400
"""Number of places."""
ROUNDING = 1e-9
"""Relative tolerance of speeds, and of velocities at one place, asked alone and together with others."""
STEPS = 2000
"""Number of steps of an integral over time."""


@naming_arguments
def check_flow(flow: Any, *, limit: float = 10.0) -> None:
    """Check a flow; if you are unsure whether yours is right, run this.

    It checks that the flow returns a finite complex number for each place; that the velocity at a place is the same
    whether it is asked alone or with others, and when it is asked again; that no speed is above `top_speed`; that no
    input is changed; and that two runs of scenarios, with the flow on all players and on pursuers, are equal. Of a flow
    that derives from `UniformFlow`, the displacement is compared with the integral of the velocity.

    Args:
        flow: an object, a class that needs no parameters, a kind, or "module:name".
        limit: the time that each part may take, s of wall time.

    Raises:
        ContractError: an AssertionError; if the flow is wrong, with the call, the input and what is expected.
    """
    tested = subject(flow, FLOWS, "flow")
    with tested.judged("flow(places, t)", limit):
        for t in TIMES:
            _check(tested, t)
    if isinstance(tested.model, UniformFlow):
        with tested.judged("displacement(begin, end)", limit):
            _check_displacement(tested)
    sides: tuple[Any, ...] = ("pursuers", "all")
    for on in sides:
        parts = {"team": Team(count=3, speeds=2.0), "environment": Environment(flow=tested.model, on=on)}
        twice(tested, f'a run with the flow on "{on}"', partial(Scenario, horizon=1.0, **parts), limit=limit)


def _velocities(tested: Subject, places: Points, t: float) -> Points:
    """Return the velocities at some places, and require that they are valid and the places unchanged."""
    call = f"flow(places, {t:g}) with {len(places)} places"
    original = places.copy()
    with tested.blaming(call), tested.fresh() as model:
        velocities = Environment(flow=model).velocities(places, t)
    tested.require(np.array_equal(places, original), f"{call} changes the places; copy them")
    return np.asarray(velocities, dtype=complex)


def _check(tested: Subject, t: float) -> None:
    """Check the flow at one time."""
    x, y = np.random.default_rng(SEED).uniform(-EXTENT, EXTENT, (2, PLACES))
    places = x + 1j * y
    together, again = (_velocities(tested, places.copy(), t) for _ in range(2))
    tested.require(np.array_equal(together, again), f"flow(places, {t:g}) returns others when it is asked again")
    for k in (0, 1):
        alone = complex(_velocities(tested, places[k : k + 1].copy(), t)[0])
        tested.require(
            abs(alone - together[k]) <= ROUNDING * (1.0 + abs(alone)),
            f"flow(places, {t:g}) at {places[k]:.3g} m is {alone:.4g} m/s alone and {together[k]:.4g} m/s together with"
            " others: the velocity should depend on the place and the time only",
        )
    top_speed = FlowTraits.of(tested.model).top_speed
    fastest = int(np.argmax(lengths(together)))
    speed = abs(together[fastest])
    tested.require(
        top_speed == inf or speed <= top_speed * (1.0 + ROUNDING) + ROUNDING,
        f"flow(places, {t:g}) at {places[fastest]:.3g} m has a speed of {speed:.4g} m/s, expected at most top_speed ="
        f" {top_speed:g} m/s, by which the network bounds how far nodes move",
    )


def _check_displacement(tested: Subject) -> None:
    """Compare the displacement of a flow that is the same everywhere with the integral of its velocity."""
    for begin, end in ((0.0, 1.0), (0.7, 5.0)):
        times = begin + (np.arange(STEPS) + 0.5) * (end - begin) / STEPS
        velocities = [complex(tested.model.velocity_at(float(t))) for t in times]
        expected = complex(np.mean(velocities)) * (end - begin)
        displacement = complex(tested.model.displacement(begin, end))
        tested.require(
            abs(displacement - expected) <= 1e-3 * (1.0 + abs(expected)),
            f"displacement({begin:g}, {end:g}) is {displacement:.5g} m, and the integral of velocity_at(t) is"
            f" {expected:.5g} m",
        )

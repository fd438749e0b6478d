"""The homicidal chauffeur (Isaacs 1965): whether an evader escapes a pursuer that is faster, but turns too slowly.

The evader flees straight, and dodges when the pursuer is near: it runs on in a constant direction, while the pursuer
turns as fast as it can. It passes the pursuer at a distance that depends on when and where it dodges. The last dodge
that is early enough lies on the barrier, the trajectory that ends tangentially on the capture circle.
"""

from cmath import rect
from math import acos, asin, cos, inf, pi, sin

import pytest
from scipy.optimize import brentq

from desim import Scenario, run
from desim.pursuit.core.events import Ended
from desim.pursuit.motion.dynamics import TurnRate
from desim.pursuit.motion.turning import least_capture_radius
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Capture, Motion, Recording

RATIOS = (0.3, 0.5, 0.9)
"""Speeds of the evader as shares of that of the pursuer, which is 1 m/s; it turns at 1 rad/s, so that rho = 1 m."""


def barrier(ratio, passing):
    """Return the distance (m) and the direction, relative to the line of sight, of a dodge that passes at a distance.

    While the pursuer turns by phi, the evader runs g rho phi. At the end its distance is least, so the evader is at an
    angle of acos g from the heading of the pursuer, and its velocity is along the line of sight. At the start it is
    straight ahead of the pursuer.
    """
    side = acos(ratio)

    def beside(turned):
        return 1.0 - cos(turned) + (passing - ratio * turned) * sin(turned + side)

    turned = brentq(beside, 0.0, asin(ratio))
    return sin(turned) + (passing - ratio * turned) * cos(turned + side), turned + side


class Dodger:
    """An evader that dodges at a distance (m) in a direction (rad), and flees straight before and afterwards.

    Attributes:
        distances: the distance at each step of the last run (m).
        dodges: the distances at which it dodged (m).
    """

    def __init__(self, distance, direction):
        self.distances, self.dodges = [], []
        self.strategy = self._strategy(distance, rect(1.0, direction), self.distances.append, self.dodges.append)

    @staticmethod
    def _strategy(distance, turn, note, note_dodge):
        aside, last = None, inf

        def strategy(observation, rng):
            nonlocal aside, last
            now = observation.distances.item(0)
            away = observation.offsets.item(0) / now
            approached, last = now < last, now
            note(now)
            if not approached:
                aside = None
            elif aside is None and now <= distance:
                aside = away * turn
                note_dodge(now)
            return away if aside is None else aside

        return strategy


def chase(me):
    """Chase from the start on."""
    yield me.at(0.0)
    me.assign(True)


def pursuit(ratio, share, dodger, horizon=60.0):
    """Return the reason of the end, with a capture radius of a share of the critical one, from behind the evader."""
    scenario = Scenario(
        horizon=horizon,
        team=Team(positions=[(0.0, 0.0)], speeds=1.0, dynamics=TurnRate(limit=1.0, heading=0.0)),
        evader=Evader(position=(1.5, 0.0), speed=ratio, strategy=dodger.strategy),
        capture=Capture(radius=share * least_capture_radius(1.0, ratio)),
        motion=Motion(step=0.005),
        protocol=chase,
        record=Recording(trajectory=0.0),
    )
    return run(scenario, 0).trace.of(Ended)[0].reason


@pytest.mark.parametrize(("ratio", "radius"), [(0.3, 0.04535), (0.5, 0.12782), (0.9, 0.44368)])
def test_the_critical_radius_by_numbers(ratio, radius):
    """sqrt(1 - g^2) + g asin g - 1; at this radius, the dodge is at right angles, at the distance g rho."""
    assert least_capture_radius(1.0, ratio) == pytest.approx(radius, abs=5e-6)
    assert least_capture_radius(3.0, ratio) == pytest.approx(3.0 * least_capture_radius(1.0, ratio))
    critical = least_capture_radius(1.0, ratio) * (1.0 - 1e-12)
    assert barrier(ratio, critical) == pytest.approx((ratio, pi / 2), abs=1e-4)


def test_the_critical_radius_at_the_ends():
    assert least_capture_radius(1.0, 0.0) == 0.0
    assert least_capture_radius(1.0, 1.0 - 1e-12) == pytest.approx(pi / 2 - 1.0, abs=1e-5)
    for ratio in (1.0, 2.0, -0.1):
        with pytest.raises(ValueError, match=f"slower than the pursuer, got {ratio:g} of its speed"):
            least_capture_radius(1.0, ratio)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("ratio", RATIOS)
def test_below_the_barrier_the_evader_escapes_for_ever(ratio):
    """With 10 % less, it dodges in time at each approach, by 5 % less than the critical radius, to 1 %."""
    dodger = Dodger(*barrier(ratio, 0.95 * least_capture_radius(1.0, ratio)))
    assert pursuit(ratio, 0.9, dodger) == "horizon"
    assert len(dodger.dodges) >= 2
    assert min(dodger.distances) == pytest.approx(0.95 * least_capture_radius(1.0, ratio), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", RATIOS)
def test_above_the_barrier_the_pursuer_captures_it_at_the_first_dodge(ratio):
    """With 10 % more, no dodge on the barrier is in time, and no other at any distance."""
    critical = least_capture_radius(1.0, ratio)
    best = [barrier(ratio, passing * critical) for passing in (0.9, 0.95, 0.999)]
    for distance, direction in [*best, *((share * ratio, pi / 2) for share in (0.6, 1.0, 1.2, 1.5))]:
        dodger = Dodger(distance, direction)
        assert pursuit(ratio, 1.1, dodger, 40.0) == "captured"
        assert len(dodger.dodges) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("ratio", RATIOS)
def test_below_the_barrier_an_evader_that_does_not_dodge_or_dodges_late_is_captured(ratio):
    """The control: what saves it is the dodge in time."""
    distance, direction = barrier(ratio, 0.95 * least_capture_radius(1.0, ratio))
    for dodger in (Dodger(0.0, direction), Dodger(0.8 * distance, direction), Dodger(distance, direction - 0.3)):
        assert pursuit(ratio, 0.9, dodger, 40.0) == "captured"

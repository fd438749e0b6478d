"""Headings from samples of positions: those of the motion in closed form, for any motion relative to the medium."""

from cmath import phase, rect
from math import pi

import pytest

from desim import Scenario
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Sampled
from desim.pursuit.evaders.recorded import RecordedMotion, RelayNode
from desim.pursuit.motion.dynamics import Acceleration, Course, TurnRate
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.flow import AffineFlow, GyreFlow, HarmonicFlow, SteadyFlow
from desim.scenario.players import Evader, Team
from desim.view.headings import Headings

PERIOD = 50_000_000
"""Time between two samples, ns."""
TURNING = Team(count=2, speeds=1.0, dynamics=TurnRate(limit=2.0))


def sample(k, pursuers, evader=1 + 1j):
    """Return the k-th sample, given the positions of the players."""
    return Sampled(k * PERIOD, ((evader.real, evader.imag),), tuple((each.real, each.imag) for each in pursuers))


def test_players_with_simple_motion_have_no_heading():
    assert Headings(Scenario(team=Team(count=3), evader=Evader(dynamics=Acceleration())), 1).players == (3,)
    assert Headings(Scenario(team=TURNING), 1).players == (0, 1)
    relay = RelayNode(pursuer=0, motion=RecordedMotion(waypoints=((0.0, 1.0, 1.0), (9.0, 2.0, 1.0))))
    assert Headings(Scenario(team=TURNING.model_copy(update={"relay": (relay,)})), 1).players == (1,)


@pytest.mark.parametrize(
    "flow", [None, SteadyFlow(velocity=(1.0, -3.0)), HarmonicFlow(amplitude=(2.0, 1.0), period=0.7)]
)
def test_the_heading_is_that_of_the_motion_in_the_middle_between_two_samples(flow):
    """The chord of an arc has the direction of its middle, in any uniform flow; a player at rest keeps its heading."""
    environment = Environment(flow=flow) if flow else Environment()
    headings, initial = Headings(Scenario(team=TURNING, environment=environment), 5), TURNING.headings(5)
    piece = TurnRate(limit=2.0)(3 - 2j, Course(0j, initial[0]), rect(1.0, phase(initial[0]) + 2.5))

    def drifted(k):
        return environment.carried(0j, 0, k * PERIOD)

    assert headings.at(sample(0, [3 - 2j, 5j])) == initial
    for k in range(1, 40):
        moved, rested = headings.at(sample(k, [piece.at(k * PERIOD / SECOND) + drifted(k), 5j + drifted(k)]))
        middle = (k - 0.5) * PERIOD / SECOND
        if not (k - 1) * PERIOD / SECOND < piece.curved < k * PERIOD / SECOND:
            assert abs(phase(moved / piece.course_at(middle).heading)) < 1e-6
        assert rested == initial[1]
    assert abs(phase(moved / initial[0])) == pytest.approx(2.5)


def test_a_captured_player_which_the_flow_does_not_carry_keeps_its_heading():
    flow = Environment(flow=SteadyFlow(velocity=(1.0, 0.0)))
    evader = Evader(dynamics=TurnRate(heading=pi / 2))
    headings = Headings(Scenario(team=Team(count=1), evader=evader, environment=flow), 1)
    found = [headings.at(sample(k, [0j], place)) for k, place in enumerate((1 + 1j, 1.05 + 1.1j, 1.05 + 1.1j))]
    assert found[1][0] == pytest.approx(1j)
    assert found[2] == found[1]


@pytest.mark.parametrize(
    "flow", [AffineFlow(rotation=1.0, expansion=-0.3), GyreFlow(speed=1.0, size=4.0, shift=1.0, period=3.0)]
)
def test_an_evader_at_rest_in_a_flow_that_varies_in_space_keeps_its_heading(flow):
    """The control moves at 2 % of the speed of the flow, to the left."""
    environment = Environment(flow=flow)
    for own, expected in ((0j, 1j), (-0.02 + 0j, -1 + 0j)):
        scenario = Scenario(
            team=Team(count=1), evader=Evader(dynamics=TurnRate(heading=pi / 2)), environment=environment
        )
        headings, place = Headings(scenario, 1), 1.5 + 0.4j
        for k in range(20):
            (found,) = headings.at(sample(k, [0j], place))
            place += (environment.drift(place, own, k * PERIOD, PERIOD / SECOND) + own) * PERIOD / SECOND
        assert abs(phase(found / expected)) < 0.1


def test_on_pursuers_only_the_flow_does_not_carry_the_evader():
    environment = Environment(flow=SteadyFlow(velocity=(0.0, 5.0)), on="pursuers")
    scenario = Scenario(team=Team(count=1), evader=Evader(dynamics=Acceleration()), environment=environment)
    headings = Headings(scenario, 1)
    found = [headings.at(sample(k, [0j], place)) for k, place in enumerate((1 + 1j, 1.05 + 1j))]
    assert found[-1] == [pytest.approx(1.0)]

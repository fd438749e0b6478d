"""Spatial Adaptive Play over networks that are not ideal."""

import numpy as np
import pytest

from desim import Scenario, run, summary
from desim.analysis.metrics import active_time
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.core.events import Decided, Started
from desim.pursuit.game.game import relay_profile
from desim.pursuit.motion.capture import capture_time
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Team
from desim.scenario.scenario import Motion
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from protocols.temperature import PaperTau


def final_profile(result):
    active = list(result.trace.of(Started)[0].active)
    for decision in result.trace.of(Decided):
        active[decision.pursuer] = decision.active
    return tuple(active)


def frozen(network, count=8, p0=0.5):
    return Scenario(
        horizon=30.0,
        team=Team(count=count, active_at_start=p0),
        motion=Motion(static=True),
        protocol=SpatialAdaptivePlay(schedule=Poisson(rate=20.0)),
        network=network,
        record={"trajectory": 0.0},
    )


@pytest.mark.slow
@pytest.mark.parametrize("p0", [0.0, 1.0])
@pytest.mark.parametrize(
    "network",
    [Links(), Links(latency=Constant(value=0.3)), Links(latency=Constant(value=0.1), loss=Bernoulli(p=0.3))],
)
def test_the_relay_profile_is_reached_on_a_complete_graph_in_spite_of_latency_and_loss(network, p0):
    """As tau -> 0 delay and loss only slow the static game (Nisan, Schapira & Zohar 2008): for 15 s, r is 30 s."""
    for seed in range(2):
        result = run(frozen(network, p0=p0), seed, lambda event: event.t > 15e9)
        start = result.trace.of(Started)[0]
        phi = capture_time(start.evaders[0], start.pursuers, start.speeds, 0.9, 0.1).tolist()
        assert final_profile(result) == relay_profile(phi, 30.0)


@pytest.mark.slow
@pytest.mark.parametrize("deaf", [Links(loss=Bernoulli(p=1.0)), Links(range=1e-9)])
def test_without_a_network_every_pursuer_that_can_be_in_time_chases(deaf):
    """The control: without messages and with no pursuer active at the start, each believes itself alone."""
    result = run(frozen(deaf, p0=0.0).model_copy(update={"team": Team(count=8, speeds=3.0, active_at_start=0.0)}), 1)
    assert final_profile(result) == (True,) * 8


@pytest.mark.whole
def test_latency_costs_active_time():
    """Paired over 8 seeds: half a second costs some 5 s, more than 5 standard errors; no latency costs nothing."""

    def times(latency, seeds=8):
        late = Links(latency=Constant(value=latency))
        scenario = Scenario(protocol=SpatialAdaptivePlay(), announce=Announcements(start="known"), network=late)
        return np.array([active_time(run(scenario, seed)) for seed in range(seeds)])

    prompt = times(0.0)
    cost = times(0.5) - prompt
    assert cost.mean() > 5 * cost.std(ddof=1) / np.sqrt(len(cost)) > 0
    assert times(1e-9, 3) - prompt[:3] == pytest.approx(0.0, abs=0.01)


def test_a_team_that_cannot_capture_stays_and_announces_it():
    each_time = Announcements(trigger="revision", start="known")
    result = run(Scenario(team=Team(count=3, speeds=0.5), horizon=2.0, announce=each_time), 0)
    numbers = summary(result)
    assert (numbers.captured, numbers.active_time, numbers.idle_time) == (False, 0.0, 2.0)
    assert numbers.messages_sent == 2 * numbers.decisions > 0


@pytest.mark.slow
def test_a_clock_that_is_behind_does_not_count_slots_below_zero():
    """Clocks 3 s slow show -3 s to 3 s: as long as they are below 0 the temperature is that of 0, and chance decides.

    (-3)^2 would be as cold as 3^2.
    """
    seen = []

    class Spied:
        def __call__(self, eta):
            seen.append(eta)
            return PaperTau()(eta)

    skews = tuple(ClockSkew(node=node, offset=-3.0) for node in range(8))
    scenario = frozen(Links()).model_copy(update={"horizon": 6.0, "fault": skews})
    play = SpatialAdaptivePlay(schedule=Poisson(rate=20.0), tau=Spied())
    decisions = run(scenario.model_copy(update={"protocol": play}), 0)
    slots = len(seen)
    early = sum(eta == 0.0 for eta in seen)
    assert decisions.trace.of(Decided)
    assert seen == sorted(seen)
    assert abs(early - slots / 2) < 5 * np.sqrt(slots) / 2
    assert seen[0] == 0.0
    assert 0.9 * 3.0 * 8 * 20.0 < seen[-1] <= 3.0 * 8 * 20.0

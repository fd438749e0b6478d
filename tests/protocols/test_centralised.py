"""The centralised benchmark."""

from desim import Scenario, run, summary
from desim.kernel.links import Links
from desim.kernel.loss import Bernoulli
from desim.pursuit.events import Decided
from desim.scenario import Evader, Team
from protocols.centralised import Centralised


def test_exactly_one_pursuer_chases_at_any_time_whatever_the_start():
    for p0 in (0.0, 0.5, 1.0):
        for seed in range(4):
            numbers = summary(run(Scenario(team=Team(active_at_start=p0), protocol=Centralised()), seed))
            assert numbers.captured
            assert numbers.idle_time == numbers.crowded_time == 0.0
            assert numbers.active_time == numbers.capture_time
            assert numbers.messages_sent == 0


def test_the_network_does_not_matter_to_it():
    ideal, deaf = (
        run(Scenario(protocol=Centralised(), network=Links(loss=Bernoulli(p=p))), 3).trace.of(Decided)
        for p in (0.0, 1.0)
    )
    assert ideal == deaf


def test_nobody_is_sent_who_would_be_late():
    """phi = (5 - 0.1) / 0.1 = 49 s, and 30 s are left."""
    scenario = Scenario(
        team=Team(positions=[(0.0, 0.0), (0.0, 0.1)], speeds=1.0),
        evader=Evader(position=(5.0, 0.0)),
        protocol=Centralised(),
    )
    assert summary(run(scenario)).active_time == 0.0

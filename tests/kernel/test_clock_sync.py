"""Clock synchronisation against its theory, and what it saves those that pay for wrong clocks."""

from math import sqrt

import networkx as nx
import numpy as np
import pytest

from desim import Scenario, run, summary
from desim.config.errors import KeyedError
from desim.kernel.clock_sync import REMEMBERED, Synchroniser, TwoWay
from desim.kernel.core.clock import Clock, NodeClock
from desim.kernel.core.events import ClockCorrected, Sent, Trace
from desim.kernel.core.units import SECOND
from desim.kernel.models.access import Tdma
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.graphs import Link
from desim.kernel.models.latency import Constant, Uniform
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Bitrate
from desim.kernel.network import Network
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Team
from desim.scenario.scenario import Clocks, Motion, Recording


def errors(links, model, *, size=2, seconds=2.0, seed=0, **skew):
    """Return the errors of the clocks at the end, s, and the trace; all but that of the reference begin 0.3 s fast."""
    env, trace = Clock(), Trace()
    clocks = [NodeClock(env), *(NodeClock(env, 0.3, skew.get("rate", 1.0)) for _ in range(size - 1))]
    net = Network(env, nx.star_graph(size - 1).to_directed(), links, seed=seed, trace=trace, clocks=clocks)
    Synchroniser(env, net, clocks, model, seed, trace)
    env.run(round(seconds * SECOND))
    return np.array([clock.now - env.now / SECOND for clock in clocks[1:]]), trace


@pytest.mark.parametrize(("there", "back"), [(0.1, 0.1), (0.3, 0.1), (0.0, 0.02)])
def test_the_error_is_half_the_asymmetry_of_the_latencies(there, back):
    """A request that takes longer than the answer makes the clock fast."""
    link = [
        Link(src=1, dst=0, latency=Constant(value=there), both_ways=False),
        Link(src=0, dst=1, latency=Constant(value=back), both_ways=False),
    ]
    found, trace = errors(Links(link=link), TwoWay(interval=0.4, exchanges=2))
    assert found[0] == pytest.approx((there - back) / 2, abs=1e-9)
    corrected = trace.of(ClockCorrected)
    assert {each.node for each in corrected} == {1}
    assert corrected[-1].correction == pytest.approx((there - back) / 2 - 0.3, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("exchanges", [1, 4, 16])
def test_the_mean_of_m_exchanges_has_an_error_of_s_over_the_root_of_2_m(exchanges):
    """Latencies uniform in 0 .. 0.1 s, s = 0.1 / sqrt(12); 300 nodes: a deviation has a standard error of 4.1 %.

    The control has m + 1 exchanges, or 2 for 1.
    """
    model = TwoWay(interval=0.2, exchanges=exchanges)
    found, _ = errors(Links(latency=Uniform(high=0.1)), model, size=301, seconds=0.2 * exchanges + 0.4)
    theory = 0.1 / sqrt(12 * 2 * exchanges)
    assert abs(found.mean()) < 3 * theory / sqrt(300)
    assert abs(found.std() - theory) < 3 * theory / sqrt(2 * 300)
    other = 0.1 / sqrt(12 * 2 * 2 * exchanges)
    assert abs(found.std() - other) > 3 * other / sqrt(2 * 300)


def test_the_drift_of_a_clock_accumulates_between_corrections():
    """A clock that is 1 % fast is averaged over 4 requests 0.1 s apart, and read up to 0.4 s after a correction."""
    found, _ = errors(Links(), TwoWay(interval=0.1, exchanges=4), seconds=9.0, rate=1.01)
    assert 0.0 < found[0] < 0.01 * (0.15 + 0.4)


def test_lost_messages_delay_a_correction_and_do_not_spoil_it():
    found, trace = errors(Links(loss=Bernoulli(p=0.5), latency=Constant(value=0.2)), TwoWay(exchanges=2), seconds=9.0)
    assert found[0] == pytest.approx(0.0, abs=1e-9)
    assert 5 < len(trace.of(ClockCorrected)) < 40


def test_a_request_that_arrives_twice_has_two_answers_with_their_own_times():
    """The copy of a message follows it 10 ms later, so the second answer begins before the first has arrived."""
    links = Links(duplicate=Bernoulli(p=1.0), medium=Bitrate(bitrate=32_000.0), latency=Constant(value=0.05))
    found, _ = errors(links, TwoWay(interval=0.2, exchanges=2))
    assert found[0] == pytest.approx(0.0, abs=1e-9)


def test_requests_and_answers_that_are_lost_are_forgotten():
    env = Clock()
    net = Network(env, nx.path_graph(2), Links(link=(Link(src=0, dst=1, loss=Bernoulli(p=1.0)),)))
    synchroniser = Synchroniser(env, net, [NodeClock(env), NodeClock(env)], TwoWay(interval=0.01), 0)
    env.run(2 * SECOND)
    assert (len(synchroniser._asked[1]), len(synchroniser.answered)) == (REMEMBERED, 2 * REMEMBERED)


def test_waiting_for_the_channel_is_no_error_and_messages_are_counted():
    """Fifty nodes share a channel on which a message of 40 bytes takes 10 ms, so that requests and answers queue."""
    links = Links(medium=Bitrate(bitrate=32_000.0, shared=True), latency=Constant(value=0.05))
    found, trace = errors(links, TwoWay(interval=1.5, exchanges=2), size=51, seconds=6.0)
    assert np.abs(found).max() < 1e-8
    assert {each.size for each in trace.of(Sent)} == {40}
    assert any(each.t > each.created for each in trace.of(Sent))


# In a run.


@pytest.mark.slow
def test_frames_of_a_tdma_collide_no_more_once_clocks_agree():
    """The clock of pursuer 2 is 4 ms fast in slots of 5 ms. In the last three of six seconds nothing collides."""
    medium = Bitrate(bitrate=100_000.0, access=Tdma(slot=0.005, guard=0.001))
    scenario = Scenario(
        horizon=6.0,
        team=Team(count=6),
        motion=Motion(static=True),
        protocol=lambda me: iter(()),
        network=Links(medium=medium),
        announce=Announcements(trigger="heartbeat", heartbeat=0.1, jitter=0.5),
        fault=[ClockSkew(node=2, offset=0.004)],
        record=Recording(trajectory=0.0, messages=True),
    )

    def collisions(given):
        lost = [each for each in run(given, 3).trace if getattr(each, "cause", "") == "collision"]
        return sum(each.t < 3 * SECOND for each in lost), sum(each.t >= 3 * SECOND for each in lost)

    assert min(collisions(scenario)) > 10
    synced = scenario.model_copy(update={"clocks": Clocks(sync=TwoWay(interval=0.4, exchanges=2))})
    early, late = collisions(synced)
    assert early > 0 == late


def test_a_protocol_without_robots_needs_no_clocks():
    scenario = Scenario(horizon=0.5, protocol="centralised", clocks=Clocks(sync=TwoWay()))
    assert summary(run(scenario)).messages_sent == 0


def test_the_reference_is_one_of_the_team():
    with pytest.raises(KeyedError, match=r"clocks\.sync\.reference: there is no pursuer 4: they are 0 \.\. 3"):
        Scenario(team=Team(count=4), clocks=Clocks(sync=TwoWay(reference=4)))

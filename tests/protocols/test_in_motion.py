"""Every protocol in pursuits in motion under latency: captures and times without a chaser.

The game is the one that depends most on the negotiation: 20 pursuers as fast as each other and hardly faster than the
evader, at first no pursuer active. A pursuer that chases in vain for a while is too late for the rest of the run.
"""

from typing import NamedTuple

import numpy as np
import pytest

from desim import Scenario, run, summary
from desim.kernel.models.latency import Constant, Uniform
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Team
from desim.scenario.scenario import PROTOCOLS, Motion, Recording
from protocols.server import Server
from tests.omniscient import RoundTrip

GEOMETRIC = {"argmin", "voronoi"}
"""Rules that need no messages where positions are sensed; the network is of no use to them."""


class Outcome(NamedTuple):
    """The means over some seeds."""

    captured: float
    active: float
    """s"""
    idle: float
    """s"""


def stress(protocol, **given):
    """Return the game."""
    team = Team(speeds=1.0, active_at_start=0.0)
    unrecorded, coarse = Recording(trajectory=0.0), Motion(step=0.05)
    settings = {"horizon": 60.0, "team": team, "protocol": protocol, "record": unrecorded, "motion": coarse}
    return Scenario(**(settings | given))


def late(latency):
    return {"network": Links(latency=Constant(value=latency))}


def outcome(seeds, protocol, **given):
    runs = [summary(run(stress(protocol, **given), seed)) for seed in range(seeds)]
    return Outcome(
        *(float(np.mean([getattr(each, name) for each in runs])) for name in ("captured", "active_time", "idle_time"))
    )


class Forgetful(Server):
    """A server that forgets its orders: it takes each pursuer to go on as it reported."""

    def _chasers(self, me, orders, delay, present):
        return super()._chasers(me, {pursuer: [] for pursuer in orders}, 0.0, present)


@pytest.mark.whole
def test_the_server_keeps_the_evader_although_orders_are_late_and_lost():
    """Latency 1 s, uniform by 5 %, a tenth lost, and pursuers that would be late may not chase: captured.

    The active time is that of a centre that sees everything and whose orders are 2 L late, within 2 s. (In 1 of 48
    seeds, which is not this one, the evader has fled too far by 2 L = 2 s: then that centre gives up as well.)
    """
    rough = {
        "network": Links(latency=Uniform(low=0.95, high=1.05), loss=Bernoulli(p=0.1)),
        "prune": "infeasible",
        "announce": Announcements(start="silent"),
    }
    server = outcome(1, Server(), **rough)
    centre = outcome(1, RoundTrip(down=2.0), prune="infeasible")
    assert server.captured == centre.captured == 1.0
    assert server.active < centre.active + 2.0
    assert server.idle < 2.5


@pytest.mark.whole
def test_a_server_that_forgets_its_orders_loses_the_evader():
    """Orders go to and fro between several pursuers until all are too late, and for 32 s none chases."""
    forgetful = outcome(1, Forgetful(), **late(1.0))
    assert forgetful.captured == 0.0
    assert forgetful.idle > 20.0


@pytest.mark.whole
@pytest.mark.parametrize("kind", sorted({*PROTOCOLS.choices()} - GEOMETRIC - {"server"}))
def test_no_protocol_loses_the_evader_to_latency(kind):
    """A second of latency; positions are announced. The centralised benchmark captures all in these seeds."""
    found = outcome(2, {"kind": kind}, announce=Announcements(payload="state"), **late(1.0))
    assert found.captured == 1.0
    assert found.idle < 3.0


@pytest.mark.whole
def test_a_token_that_takes_long_is_as_bad_as_one_that_is_held_as_long_and_no_worse():
    """Up to N L = 20 s pass until the token comes to a pursuer that could be in time: that is what loses the evader.

    The same token without latency is held for a second instead.
    """
    slow, held = (
        outcome(12, {"kind": "best_response", "schedule": {"kind": "token_ring"} | hold}, **late(latency))
        for latency, hold in ((1.0, {}), (0.0, {"holding_time": 1.0}))
    )
    assert abs(slow.captured - held.captured) < 0.1
    assert abs(slow.idle - held.idle) < 4.0
    assert abs(slow.active - held.active) < 2.0

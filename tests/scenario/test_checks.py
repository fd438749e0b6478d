"""Warnings: each where it is due and where it just is not, and none for the default."""

from math import inf
from typing import Literal

import networkx as nx
import pytest

from desim import Scenario, run
from desim.kernel.clock_sync import TwoWay
from desim.kernel.core.events import Broadcast
from desim.kernel.models.access import Aloha, Csma, CsmaCa, SlottedAloha, Tdma
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.coherence import Coherence
from desim.kernel.models.fault_plans import RandomCrashes
from desim.kernel.models.faults import Crash
from desim.kernel.models.graphs import Ring
from desim.kernel.models.interference import CaptureEffect
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.reception import Disk, QuasiUnitDisk, Rice
from desim.kernel.models.transport import Reliable
from desim.pursuit.byzantine.lies import Liar, ReplayAttack, Selective, Silent, Slander
from desim.pursuit.evaders.evasion import ConstantHeading
from desim.pursuit.motion.dynamics import Acceleration, TurnRate
from desim.pursuit.sensing.noise import PositionNoise
from desim.pursuit.sensing.sensing import Sensing
from desim.pursuit.sensing.tracking import AlphaBeta, Kalman
from desim.pursuit.team.announcements import Announcements
from desim.pursuit.team.trust import Accusations, Reputation, Trimmed
from desim.scenario.checks import latency_warnings, warnings
from desim.scenario.players import Evader, Team
from desim.scenario.properties import SAMPLES, property_of, recording
from desim.scenario.scenario import Capture, Clocks, Motion, Recording
from desim.study.sweeps.sweep_plan import SweepPlan
from protocols.cbaa import CBAA
from protocols.cbba import CBBA
from protocols.centralised import Centralised
from protocols.dissemination import CodedOneHop, Flooding, ReliableOneHop
from protocols.geometric import Argmin, Voronoi
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Periodic, Rounds
from protocols.schedules.token import TokenRing
from protocols.server import Server

JITTER = {"jitter": 0.1}
BITS = {"kind": "bitrate", "bitrate": 8 * 240.0}
"""240 bytes a second: an announcement of 24 bytes takes a tenth of a second."""


FAST = {"kind": "bitrate", "bitrate": 8 * 24e3}
"""An announcement of 24 bytes takes a millisecond."""
SPREAD = {"sender": {"kind": "shifted_exponential", "mean": 0.01}}
"""The frames of one instant are separated."""
WIND = {"kind": "uniform", "velocity": (0.0, 0.3)}
RELIABLE = Links(transport=Reliable())
SHORT_WALL = {"line": [[5.0, 5.0], [5.5, 5.0]]}
CONCRETE = SHORT_WALL | {"material": "concrete"}
LORA = {"kind": "lora", "access": Aloha()}
SELDOM = {"jitter": 0.1, "heartbeat": 9.0}

AT_CORNERS = {"team": Team(positions=[[0.0, 0.0], [40.0, 20.0]], speeds=2.0), "evader": Evader(position=(9.0, 9.0))}
"""Players that come to x = 100 m at most in 30 s."""


def users_own(me):
    """Send or announce what it likes: a protocol of a user."""
    yield from ()


def warned(**given):
    """Return what a scenario is warned of, as a list of key and reason."""
    return list(warnings(Scenario(**given)))


def test_the_default_is_not_warned_of():
    assert warned() == []


@pytest.mark.parametrize(
    ("network", "liars", "heard"),
    [
        ({"graph": {"kind": "ring"}}, 1, "needs at least 2 F + 1 = 3 of them, and pursuer 0 hears 2"),
        ({"graph": {"kind": "ring"}}, 0, None),
        ({"graph": nx.circulant_graph(20, [1, 2])}, 1, None),
        ({"graph": nx.circulant_graph(20, [1, 2])}, 2, "= 5 of them, and pursuer 0 hears 4"),
        ({"range": 0.01}, 1, "hears 0 at the start"),
        ({}, 3, None),
    ],
)
def test_trimming_needs_enough_neighbours(network, liars, heard):
    """A ring has degree 2, its square 4; a (2F + 1)-robust graph has at least 2F + 1. Flooded claims reach all."""
    trust = {"trust": Trimmed(liars=liars)}
    found = dict(warned(network=network, announce=trust)).get("announce.trust.liars")
    assert (found is None) if heard is None else heard in found
    flooded = trust | {"dissemination": "flooding"}
    assert "announce.trust.liars" not in dict(warned(network=network, announce=flooded))


@pytest.mark.parametrize(
    ("on", "flow", "guidance", "is_warned_of"),
    [
        ("pursuers", WIND, "pure_pursuit", True),
        ("pursuers", WIND, "constant_bearing", False),
        ("pursuers", {"kind": "none"}, "pure_pursuit", False),
        ("all", WIND, "pure_pursuit", False),
    ],
)
def test_a_wind_on_the_pursuers_needs_a_guidance_that_allows_for_it(on, flow, guidance, is_warned_of):
    """The times of each guidance are those of `tests/pursuit/test_flow.py`."""
    environment = {"on": on, "flow": flow}
    assert ("team.guidance" in dict(warned(environment=environment, team={"guidance": guidance}))) == is_warned_of


@pytest.mark.parametrize("order", ["evader_first", "simultaneous"])
@pytest.mark.parametrize(
    ("parts", "is_warned_of"),
    [
        ({}, False),
        ({"evader": {"strategy": "zigzag"}}, True),
        ({"evader": {"strategy": "zigzag"}, "motion": {"step": 0.1}, "capture": {"radius": 0.09}}, False),
        ({"evader": {"strategy": "zigzag"}, "motion": {"step": 0.1}, "capture": {"radius": 0.0899}}, True),
        ({"evader": {"strategy": "zigzag"}, "motion": {"static": True}}, False),
        ({"evader": {"strategy": "zigzag", "speed": 3.0}}, False),
        ({"evader": {"strategy": "zigzag", "speed": 0.0}}, False),
        ({"evader": [{"strategy": "zigzag", "speed": 0.5}, {}]}, False),
        ({"evader": [{"strategy": "zigzag", "speed": 0.6}, {}]}, True),
        *(({"evader": {"strategy": kind}}, True) for kind in ("constant_heading", "diffusion", "max_geodesic")),
        ({"evader": {"strategy": lambda state, rng: 1.0}}, True),
        ({"evader": {"strategy": "still"}}, False),
        ({"evader": {"reaction_delay": 0.2}}, True),
        ({"sensing": {"noise": 0.05, "estimate": "hold"}}, True),
        ({"team": {"guidance": "constant_bearing"}}, "simultaneous"),
        ({"team": {"guidance": "constant_bearing"}, "evader": {"strategy": "zigzag"}}, "simultaneous"),
        ({"team": {"guidance": "constant_bearing", "dynamics": "acceleration"}}, True),
    ],
)
def test_a_pursuer_may_run_past_an_evader_that_moves_by_more_than_the_radius_in_a_step(parts, order, is_warned_of):
    motion = {"step": 0.2, "order": order} | parts.get("motion", {})
    found = dict(warned(**parts | {"motion": motion}))
    assert ("may run past the evader" in found.get("motion.step", "")) == (is_warned_of in {True, order})


@pytest.mark.parametrize(
    ("order", "strategy", "step", "text"),
    [
        ("evader_first", "zigzag", 0.1, None),
        ("evader_first", "zigzag", 0.101, "step x speed = 0.202 m"),
        ("simultaneous", "zigzag", 0.0689, None),
        ("simultaneous", "zigzag", 0.07, "step x sum of both speeds = 0.203 m is more than 2 x radius = 0.2 m"),
        ("simultaneous", "pure_evasion", 0.1, None),
        ("simultaneous", "pure_evasion", 0.101, "step x speed = 0.202 m"),
    ],
)
def test_between_two_samples_both_players_move_if_all_move_at_once(order, strategy, step, text):
    """The pursuer is at most (v + v_e) h - eps from the evader after a step in which it comes to its aim."""
    motion, capture = {"step": step, "order": order}, {"test": "sample"}
    found = dict(warned(motion=motion, capture=capture, evader={"strategy": strategy}, team={"speeds": 2.0}))
    assert (text or "") in found.get("motion.step", "")
    assert ("motion.step" in found) == (text is not None)


@pytest.mark.parametrize(("speed", "radius"), [(0.9, 0.1), (0.6, 0.1), (1.1, 0.07)])
def test_the_step_that_a_warning_proposes_gives_none(speed, radius):
    parts = {"evader": {"strategy": "zigzag", "speed": speed}, "capture": {"radius": radius}}
    why = dict(warned(motion={"step": 0.2}, **parts))["motion.step"]
    assert f"step x speed = {0.2 * speed:g} m, more than the capture radius of {radius:g} m" in why
    step = float(why.split("at most ")[1].split()[0])
    assert 0.9 * radius / speed < step
    assert "motion.step" not in dict(warned(motion={"step": step}, **parts))


class Swerve(ConstantHeading):
    """Turns, whatever the class that it derives from does."""

    kind: Literal["swerve"] = "swerve"

    def __call__(self, state, _):
        return 1j if state.elapsed > 1.0 else 1.0


@pytest.mark.parametrize(
    ("evader", "diffusion", "is_warned_of"),
    [
        ({}, 0.1, True),
        ({}, 0.3, False),
        ({"speed": 3.0}, 0.3, True),
        ({"speed": 0.0}, 0.1, False),
        ({"strategy": {"kind": "constant_heading"}}, 0.1, False),
        ({"strategy": Swerve()}, 0.1, True),
        ({"dynamics": {"kind": "turn_rate", "limit": 1.0}}, 0.1, False),
    ],
)
@pytest.mark.parametrize("estimator", ["alpha_beta", "kalman"])
def test_a_filter_is_compared_with_an_evader_that_turns_at_once(evader, diffusion, is_warned_of, estimator):
    """Turns once in T seconds are a diffusion of v_e / sqrt(T): .9 m/s and .1 m/s per sqrt(s) are 81 s."""
    sensing = {"noise": 0.5, "estimator": {"kind": estimator, "velocity_diffusion": diffusion}}
    found = dict(warned(evader=evader, sensing=sensing))
    assert ("sensing.estimator.velocity_diffusion" in found) == is_warned_of


@pytest.mark.parametrize(
    ("parts", "is_warned_of"),
    [
        ({"fault": [{"kind": "clock_skew", "offset": 0.3}]}, True),
        ({"fault": [{"kind": "clock_skew", "offset": -0.3, "node": 1}]}, True),
        ({"fault": [{"kind": "clock_skew", "drift": 0.01}]}, True),
        ({"fault": [{"kind": "clock_skew", "offset_walk": 0.055}]}, True),
        ({"fault": [{"kind": "clock_skew", "drift_walk": 0.0032}]}, True),
        ({"fault": [{"kind": "clock_skew", "offset_walk": 0.048}]}, False),
        ({"fault": [{"kind": "clock_skew", "drift_walk": 0.0027}]}, False),
        ({"fault": [{"kind": "clock_skew", "offset": 0.3}], "sensing": {"noise": "range_bearing"}}, True),
        ({"fault": [{"kind": "clock_skew", "offset": 0.25}]}, False),
        ({"fault": [{"kind": "clock_skew", "offset": 0.3}], "team": {"count": 1, "speeds": 2.0}}, False),
        ({"fault": [{"kind": "clock_skew", "offset": 0.3}], "clocks": {"sync": "two_way"}}, False),
        ({"fault": [{"kind": "clock_skew", "offset": 0.3}], "sensing": {"estimator": "none"}}, False),
        ({}, False),
    ],
)
def test_a_filter_that_takes_wrong_time_stamps_for_exact_is_warned_of(parts, is_warned_of):
    """In 0.28 s an evader of 0.9 m/s moves half of the deviation of a sighting; the horizon is 30 s."""
    sensing = {"noise": 0.5, "estimator": "kalman", "estimate": "hold"} | parts.get("sensing", {})
    found = dict(warned(**parts | {"sensing": sensing}))
    assert ("a filter takes time stamps for exact" in found.get("sensing.estimator", "")) == is_warned_of


def test_a_slot_that_an_announcement_just_fills_is_long_enough():
    assert Scenario(network=Links(medium=FAST | {"access": Tdma(slot=0.0011, guard=0.0001)}))
    with pytest.raises(ValueError, match=r"an announcement of 24 bytes takes 0\.001 s .* at least 0\.0011 s"):
        Scenario(network=Links(medium=FAST | {"access": Tdma(slot=0.001099, guard=0.0001)}))


class Sonar:
    def __init__(self, variance):
        self.variance = variance

    def __call__(self, offset, first, second):
        return offset + complex(first, second)

    def covariance(self, offset):
        return self.variance, 0.0, 9.0


@pytest.mark.parametrize(("variance", "is_warned_of"), [(0.25, True), (0.250001, True), (0.36, False)])
def test_wrong_time_stamps_are_compared_with_the_noise_of_a_user(variance, is_warned_of):
    """In 0.3 s an evader of 0.9 m/s moves 0.27 m: half of a deviation of 0.54 m along the line of sight."""
    sensing = {"noise": Sonar(variance), "estimator": "kalman"}
    found = dict(warned(fault=[{"kind": "clock_skew", "offset": 0.3}], sensing=sensing))
    assert ("a sighting has an error of 0.5 m" in found.get("sensing.estimator", "")) == is_warned_of


class FarSonar(Sonar):
    def covariance(self, offset):
        return (1.0 / max(abs(offset) - 0.5, 0.0),) * 3


def test_a_noise_that_is_not_defined_close_to_a_pursuer_gives_no_warning():
    sensing = {"noise": FarSonar(0.0), "estimator": "kalman"}
    assert "sensing.estimator" not in dict(warned(fault=[{"kind": "clock_skew", "offset": 0.3}], sensing=sensing))


@pytest.mark.parametrize("speeds", [(1.0, 3.0), (3.0, 1.0)])
def test_of_several_players_the_fastest_counts(speeds):
    """An evader at 3 m/s beside one at 1 m/s, and such pursuers; steps of 1 s are more than a disc of 0.2 m."""
    noisy = {"noise": 0.5, "estimator": {"kind": "kalman", "velocity_diffusion": 0.1}}
    sampled = {"motion": {"step": 1.0}, "capture": {"test": "sample"}}
    evaders = [{"speed": speed, "position": (5.0, speed)} for speed in speeds]
    found = dict(warned(evader=evaders, sensing=noisy, team={"count": 2, "speeds": 2.0}, **sampled))
    assert "2 v_e = 6 m/s" in found["sensing.estimator.velocity_diffusion"]
    assert "step x speed = 3 m" in found["motion.step"]
    assert "than 1 of the 2 evaders: the fastest moves at 2.0 m/s, the slowest of these at 3.0" in found["team.speeds"]
    found = dict(warned(evader={"speed": 1.0}, team={"count": 2, "speeds": list(speeds)}, **sampled))
    assert "step x speed = 3 m" in found["motion.step"]
    assert "team.speeds" not in found


@pytest.mark.parametrize(
    ("given", "key", "why"),
    [
        ({"team": Team(count=2, speeds=(0.5, 0.9))}, "team.speeds", "the fastest moves at 0.9 m/s, the evader at 0.9"),
        ({"sensing": Sensing(estimate="hold")}, "sensing.estimate", "no effect while the radius is inf"),
        ({"sensing": Sensing(radius=0.1)}, "sensing.radius", "no pursuer sees an evader before it captures it"),
        ({"network": Links(reception=QuasiUnitDisk())}, "network.reception", "no effect while the range is inf"),
        ({"network": Links(coherence=Coherence(doppler=1.0))}, "network.coherence", "no effect with fading 'per_link'"),
        ({"network": Links(range=9.0, fading="correlated")}, "network.fading", "the power of no message varies"),
        (
            {
                "network": Links(
                    range=9.0, reception=Rice(), fading="correlated", coherence=Coherence(frequency=2.4e9)
                ),
                "motion": Motion(static=True),
            },
            "network.fading",
            "the channel never changes",
        ),
        (
            {"network": Links(preset="lte", latency={"kind": "constant"})},
            "network.latency",
            "overrides the value of the preset 'lte'",
        ),
        (
            {"announce": Announcements(trigger="never", start="known", dissemination=Flooding())},
            "announce.dissemination",
            "nothing is ever announced",
        ),
        ({"network": Links(range=9.0, reception=Disk(exponent=2.5))}, "network.reception.exponent", "no wall weakens"),
        (
            {"network": Links(range=9.0, reception=QuasiUnitDisk(exponent=2.5)), "wall": [SHORT_WALL]},
            "network.reception.exponent",
            "no wall weakens radio without blocking it",
        ),
        (
            {"network": Links(range=9.0, reception=Disk(exponent=4.1)), "wall": [SHORT_WALL | {"loss": 3.0}]},
            "network.reception.exponent",
            "an exponent of 4.1 probably has walls in it",
        ),
        ({"wall": [SHORT_WALL, SHORT_WALL | {"loss": 3.0}]}, "wall.1", "no effect while network.range is inf"),
        (
            {"network": Links(range=9.0), "wall": [CONCRETE | {"frequency": 0.99e9}]},
            "wall.0.frequency",
            "the properties of concrete are extrapolated: they begin at 1 GHz",
        ),
        (
            {"network": Links(medium=LORA | {"gateways": [0]}), "announce": SELDOM},
            "network.medium.gateways",
            "without `spreading_factors` and `frequencies` all nodes are tuned to each other",
        ),
        ({"environment": {"flow": WIND}, "motion": Motion(static=True)}, "environment.flow", "because nothing moves"),
        ({"environment": {"on": "pursuers"}}, "environment.on", "it has no effect without a flow"),
        ({"fault": [Crash(start=1.0, node=0), Crash(start=30.0, node=0)]}, "fault.1.start", "starts after the horizon"),
        (
            {"network": Links(medium=BITS), "announce": Announcements(heartbeat=0.08)},
            "announce.heartbeat",
            "heartbeats of 24 bytes alone need 1.2 times the capacity of the channel",
        ),
        (
            {"network": Links(medium=BITS | {"shared": True}), "team": Team(count=3), "announce": {"heartbeat": 0.2}},
            "announce.heartbeat",
            "need 1.5 times the capacity",
        ),
        (
            {"network": Links(medium=BITS), "team": Team(count=20), "protocol": CBBA()},
            "announce.heartbeat",
            "heartbeats of 200 bytes alone need 8.3 times the capacity of the channel",
        ),
        (
            {"network": Links(medium=BITS | {"shared": True}), "team": Team(count=3), "protocol": Server(period=0.5)},
            "protocol.period",
            "reports of 72 bytes alone need 1.2 times the capacity of the channel",
        ),
        (
            {"protocol": SpatialAdaptivePlay(schedule=Periodic(period=0.2, jitter=0.0)), "motion": Motion(step=0.05)},
            "protocol.schedule.jitter",
            "4 motion steps",
        ),
        (
            {"network": Links(medium=BITS | {"bitrate": 1e13})},
            "network.medium",
            "the airtime of 24 bytes, 2e-11 s, rounds to 0",
        ),
        (
            {
                "network": Links(medium=BITS | {"access": Aloha()}),
                "team": Team(count=3),
                "announce": {"heartbeat": 0.2, "jitter": 0.5},
            },
            "announce.heartbeat",
            "need 1.5 times the capacity of the channel: queues grow without bound, or messages collide or are dropped",
        ),
        (
            {"network": Links(medium=FAST | {"access": Aloha(), "duty_cycle": 0.005}), "announce": JITTER},
            "announce.heartbeat",
            "shorter than the time for which 24 bytes keep a pursuer from sending again, 0.2 s, because of its duty",
        ),
        (
            {"network": Links(medium=FAST | {"access": Tdma(slot=0.06)}), "team": Team(count=2)},
            "announce.heartbeat",
            "sending again, 0.12 s, because of the slots of the TDMA",
        ),
        (
            {"network": Links(medium=FAST | {"access": Tdma(slot=0.05)}), "team": Team(count=2)},
            None,
            "",
        ),
        (
            {
                "network": Links(medium=FAST | {"access": Aloha(), "duty_cycle": 0.005}, processing=SPREAD),
                "team": Team(count=3),
                "protocol": Server(period=0.5),
            },
            "protocol.period",
            "shorter than the time for which 72 bytes keep a pursuer from sending again, 0.6 s, because of its duty",
        ),
        (
            {
                "network": Links(medium=FAST | {"access": CsmaCa(ack=0.002)}, processing=SPREAD),
                "team": Team(count=11),
                "protocol": Server(period=0.045),
            },
            "protocol.period",
            "reports of 72 bytes alone need 1.1 times the capacity of the channel",
        ),
        (
            {
                "network": Links(medium=FAST | {"access": CsmaCa(ack=0.0)}, processing=SPREAD),
                "team": Team(count=11),
                "protocol": Server(period=0.045),
            },
            None,
            "",
        ),
        *(
            (
                {
                    "network": Links(medium=FAST | {"shared": True}),
                    "team": Team(count=8),
                    "protocol": Server(period=9.0),
                    "sensing": {"noise": 0.5, "period": period, "estimator": "kalman", "fusion": fusion},
                },
                why and "sensing.period",
                why,
            )
            for fusion, period, why in (
                ("by_stamp", 0.025, "reports of sightings of 96 bytes alone need 1.3 times the capacity"),
                ("naive", 0.045, "reports of sightings of 144 bytes alone need 1.1 times the capacity"),
                ("by_stamp", 0.045, None),
            )
        ),
        (
            {"network": Links(medium=FAST | {"access": Csma(p=0.1)}), "announce": JITTER},
            "network.medium.access.p",
            "no effect with persistence 'nonpersistent'",
        ),
        (
            {
                "network": Links(medium=FAST | {"access": Csma(persistence="p_persistent", attempts=3)}),
                "announce": JITTER,
            },
            "network.medium.access.attempts",
            "no effect with persistence 'p_persistent'",
        ),
        (
            {"network": Links(medium=FAST | {"reception": CaptureEffect()})},
            "network.medium.reception",
            "no frames overlap with access.kind 'ideal'",
        ),
        (
            {"network": Links(medium=FAST | {"access": Aloha(), "half_duplex": True}), "announce": JITTER},
            "network.medium.half_duplex",
            "nodes that contend never receive while they transmit",
        ),
        (
            {"network": Links(medium=FAST | {"access": Aloha()}), "announce": {"jitter": 0.0, "start": "silent"}},
            "announce.jitter",
            "overlap",
        ),
        (
            {"network": Links(medium=FAST | {"access": Aloha()}), "announce": {"trigger": "change"}},
            "announce.start",
            "pursuers announce their first actions at the same instant",
        ),
        (
            {"network": Links(medium=FAST | {"access": SlottedAloha(slot=0.999e-3)}), "announce": JITTER},
            "network.medium.access.slot",
            "an announcement of 24 bytes takes 0.001 s on the air, longer than a slot of 0.000999 s",
        ),
        ({"clocks": Clocks(sync=TwoWay())}, "clocks.sync", "it costs messages, and all clocks are right"),
        (
            {"announce": Announcements(trigger="never", start="silent", dissemination=ReliableOneHop())},
            "announce.dissemination",
            "nothing is ever announced",
        ),
        (
            {"network": Links(transport=Reliable(window=4, depth=3)), "protocol": users_own},
            "network.transport.window",
            "no more than depth = 3 messages are kept, so a window of 4 is never full",
        ),
        (
            {"announce": Announcements(dissemination=ReliableOneHop(window=2))},
            "announce.dissemination.window",
            "no more than depth = 1 messages are kept, so a window of 2 is never full",
        ),
        ({"network": RELIABLE}, "network.transport", "it has no effect on announcements, which are published as state"),
        (
            {"network": RELIABLE, "announce": Announcements(dissemination=CodedOneHop())},
            "network.transport",
            "it has no effect: announcements have their own",
        ),
        ({"fault": [Liar(start=0.0, node=0)]}, "fault.0.action", "the announcements are true"),
        (
            {"fault": [Crash(start=0.0, node=1), Liar(start=0.0, node=0, action="chase", phi=0.0)]},
            "fault.1.phi",
            "announcements do not contain it",
        ),
        (
            {"fault": [Liar(start=0.0, node=0, action="chase", position="random")], "announce": {"payload": "time"}},
            "fault.0.position",
            "announcements do not contain it",
        ),
        ({"fault": [Silent(start=30.0, node=0)]}, "fault.0.start", "starts after the horizon"),
        ({"fault": [Selective(start=0.0, node=0)]}, "fault.0", "pursuers forward nothing"),
        ({"fault": [ReplayAttack(start=0.0, node=0)], "protocol": Argmin()}, "fault.0", "pursuers announce nothing"),
        (
            {"fault": [Liar(start=0.0, node=0, action="chase", phi=0.0)], "protocol": Server()},
            "fault.0.phi",
            "announcements do not contain it",
        ),
        ({"fault": [Slander(start=0.0, node=0, accused=(1,))]}, "fault.0", "`announce.trust` reads no accusations"),
        ({"announce": {"trust": "plausible"}, "protocol": Argmin()}, "announce.trust", "pursuers announce nothing"),
        ({"announce": {"trust": "trimmed"}, "protocol": CBAA()}, "announce.trust", "cbaa compares bids"),
        ({"announce": {"trust": Trimmed(liars=5)}}, "announce.trust.liars", "20 pursuers is robust against 4 liars"),
        (
            {"announce": {"trust": "reputation"}, "motion": Motion(static=True)},
            "announce.trust",
            "no motion refutes an announcement",
        ),
        (
            {"team": Team(dynamics=TurnRate()), "motion": Motion(static=True)},
            "team.dynamics",
            "capture times follow simple motion, because nothing moves",
        ),
        (
            {"team": Team(dynamics=Acceleration()), "announce": Announcements(payload="state")},
            "announce.payload",
            "the motion of a teammate with inertia is extrapolated as if it were simple",
        ),
        (
            {"motion": Motion(step=0.11), "capture": Capture(test="sample"), "team": Team(count=2, speeds=1.0)},
            None,
            "",
        ),
        (
            {"motion": Motion(step=0.11), "capture": Capture(test="sample")},
            "motion.step",
            "step x speed = 0.22 m is more than 2 x radius = 0.2 m",
        ),
        ({"wall": [{"line": [[13.4012, 52.5034], [13.4013, 52.5039]]}]}, "wall", "it lies within 0.0005 m: are its"),
        ({"wall": [{"line": [[391545.0, 5820012.0], [391560.0, 5820030.0]]}]}, "wall", "where no player can come"),
        ({"wall": [{"line": [[100.1, 0.0], [100.1, 20.0]]}], **AT_CORNERS}, "wall", "where no player can come"),
        ({"evader": Evader(position=(391545.0, 5820012.0))}, "evader", "could reach it in 10 horizons"),
        ({"evader": [Evader(), Evader(position=(0.0, 1400.0))]}, "evader.1", "could reach it in 10 horizons"),
        (
            {
                "motion": Motion(step=0.11),
                "capture": Capture(test="sample"),
                "team": Team(count=2, speeds=1.0),
                "evader": Evader(speed=2.0),
            },
            "team.speeds",
            "every capture time is inf",
        ),
    ],
)
def test_probably_unintended_values_are_named_with_key_and_reason(given, key, why):
    """The last jumps because the *evader* is fast: it is warned of that as well."""
    found = [(where, text) for where, text in warned(**given) if " assumes " not in text]
    assert [where for where, _ in found][:1] == [key] * (key is not None)
    assert key is None or why in found[0][1]
    assert len(found) == (0 if key is None else 2 if key == "team.speeds" and "motion" in given else 1)


@pytest.mark.parametrize(
    "given",
    [
        {"team": Team(count=2, speeds=(0.5, 0.91))},
        {"team": Team(count=2), "horizon": 0.1},
        {"network": Links(range=1e6, reception=QuasiUnitDisk())},
        {"sensing": Sensing(radius=0.11, estimate="hold")},
        {"network": Links(range=9.0, reception=Disk(exponent=4.0)), "wall": [SHORT_WALL | {"loss": 3.0}]},
        {"network": Links(range=9.0), "wall": [CONCRETE | {"frequency": 1e9}]},
        {
            "wall": [{"line": [[100.1, 0.0], [100.1, 20.0]], "blocks": ["sight"]}],
            "environment": {"flow": {"kind": "uniform", "velocity": [0.01, 0.0]}},
            **AT_CORNERS,
        },
        {"network": Links(medium=LORA | {"gateways": [0], "spreading_factors": [7, 8] * 10}), "announce": SELDOM},
        {"network": Links(preset="lte")},
        {"network": Links(preset="lte", range=1e6)},
        {"announce": Announcements(trigger="revision", dissemination=Flooding())},
        {"announce": Announcements(dissemination=Flooding())},
        {"fault": [Crash(start=29.9, node=0), RandomCrashes()]},
        {"network": Links(medium=BITS), "announce": Announcements(heartbeat=0.1)},
        {"network": Links(medium=BITS), "announce": Announcements(heartbeat=0.05, trigger="revision")},
        {"network": Links(medium=BITS | {"shared": True}), "team": Team(count=2), "announce": {"heartbeat": 0.2}},
        {"protocol": SpatialAdaptivePlay(schedule=Periodic(period=0.2)), "motion": Motion(step=0.05)},
        {"protocol": SpatialAdaptivePlay(schedule=Periodic(period=0.15, jitter=0.0)), "motion": Motion(step=0.05)},
        {
            "network": Links(medium=BITS | {"access": Aloha()}, range=9.0),
            "team": Team(count=3),
            "announce": {"jitter": 0.1},
        },
        {
            "network": Links(medium=BITS | {"access": Aloha()}, graph=Ring()),
            "team": Team(count=3),
            "announce": {"jitter": 0.1},
        },
        {
            "network": Links(medium=BITS | {"access": Aloha()}),
            "team": Team(count=2),
            "announce": {"heartbeat": 0.2, "jitter": 0.1},
        },
        {
            "network": Links(medium=FAST | {"access": Aloha(), "reception": CaptureEffect()}),
            "announce": {"jitter": 0.1},
        },
        {"network": Links(medium=FAST | {"access": SlottedAloha(slot=1e-3)}), "announce": JITTER},
        {"network": Links(medium=FAST | {"access": SlottedAloha(slot=1e-4)}), "protocol": Centralised()},
        {"network": RELIABLE, "announce": Announcements(dissemination=Flooding())},
        {"network": RELIABLE, "protocol": SpatialAdaptivePlay(schedule=TokenRing())},
        {"network": RELIABLE, "protocol": Server()},
        {"clocks": Clocks(sync=TwoWay()), "fault": [ClockSkew(offset=0.1)]},
        {"network": RELIABLE, "protocol": users_own},
        {"network": RELIABLE, "sensing": Sensing(radius=9.0)},
        {"network": Links(transport=Reliable(window=9, history="keep_all")), "protocol": Server()},
        {"fault": [Liar(start=0.0, node=0, action="chase"), Liar(start=0.0, share=0.1, acts="stay", action="stay")]},
        {"fault": [Liar(start=0.0, node=0, phi=0.0)], "announce": {"payload": "time", "trust": "trimmed"}},
        {"fault": [Liar(start=0.0, node=0, phi=0.0)], "protocol": CBAA()},
        {"fault": [Liar(start=0.0, node=0, position="random")], "protocol": Server()},
        {"fault": [Selective(start=0.0, node=0)], "announce": Announcements(dissemination=Flooding())},
        {"fault": [Selective(start=0.0, node=0)], "protocol": SpatialAdaptivePlay(schedule=TokenRing())},
        {"fault": [Slander(start=0.0, node=0, accused=(1,))], "announce": {"trust": "accusations"}},
        {"announce": {"trust": Trimmed(liars=4)}},
        {"announce": {"trust": "trimmed"}, "protocol": Server()},
        {"announce": {"trust": "plausible"}, "protocol": Server()},
        {"fault": [ReplayAttack(start=0.0, node=0)], "protocol": Server()},
        {
            "fault": [Slander(start=0.0, node=0, accused=(1,))],
            "announce": {"trust": Accusations(quorum=1)},
            "motion": Motion(static=True),
        },
        {"announce": {"trust": Reputation(threshold=0.9)}, "motion": Motion(static=True)},
        {"network": RELIABLE, "announce": {"trust": "accusations"}},
        {"team": Team(dynamics=TurnRate()), "announce": Announcements(payload="course")},
        {"team": Team(dynamics=TurnRate()), "announce": Announcements(payload="action")},
        {"team": Team(dynamics=TurnRate()), "announce": Announcements(payload="state"), "protocol": Centralised()},
        {"evader": Evader(dynamics=TurnRate()), "announce": Announcements(payload="state")},
        {"evader": Evader(dynamics=TurnRate()), "motion": Motion(static=True)},
        {"announce": Announcements(payload="course")},
        {"fault": [Liar(start=0.0, node=0, position="random")], "announce": {"payload": "course"}},
        {"motion": Motion(step=1.0), "horizon": 1.0},
        {"wall": [{"line": [[99.9, 0.0], [99.9, 20.0]]}], **AT_CORNERS},
        {"wall": [{"line": [[5.0, 5.0], [5.5, 5.0]]}]},
        {"wall": [{"line": [[5.0, 5.0], [5.1, 5.0]]}, {"line": [[9.0, 5.0], [9.1, 5.0]]}]},
        {"evader": Evader(position=(0.0, 1200.0))},
        {"motion": Motion(step=0.1), "capture": Capture(test="sample")},
        {"motion": Motion(step=0.11)},
        {
            "network": Links(range=99.0, reception=Rice(), fading="correlated", coherence=Coherence(doppler=1.0)),
            "motion": Motion(static=True),
            "announce": Announcements(heartbeat=0.3),
        },
    ],
)
def test_barely_compatible_values_give_no_warning(given):
    assert [each for each in warned(**given) if " assumes " not in each[1]] == []


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("protocol", "payload", "speaks"),
    [
        (SpatialAdaptivePlay(), "action", True),
        (Centralised(), "action", False),
        (Centralised(), "state", False),
        (Server(), "action", False),
        (Server(), "state", False),
        (Voronoi(), "action", False),
        (Voronoi(), "state", True),
        (Argmin(), "action", False),
        (Argmin(), "time", True),
    ],
)
def test_only_scenarios_with_heartbeats_can_fill_the_channel_with_them(protocol, payload, speaks):
    """20 pursuers of at least 24 bytes every 0.1 s are at least 4800 bytes a second, and the channel carries 240."""
    given = {
        "protocol": protocol,
        "network": Links(medium=BITS | {"shared": True}),
        "announce": Announcements(payload=payload),
    }
    assert ("announce.heartbeat" in dict(warned(**given))) == speaks
    result = run(Scenario(**given, horizon=0.5, record=Recording(messages=True)))
    assert bool(result.trace.of(Broadcast)) == speaks


@pytest.mark.parametrize(
    ("speeds", "said"),
    [
        ((0.5, 0.8), None),
        ((0.5, 1.0), "faster than 1 of the 2 evaders: the fastest moves at 0.9 m/s, the slowest of these at 1.0 m/s"),
        ((2.0, 0.9), "faster than 2 of the 2 evaders: the fastest moves at 0.9 m/s, the slowest of these at 0.9 m/s"),
    ],
)
def test_each_of_several_evaders_should_be_slower_than_some_pursuer(speeds, said):
    evaders = tuple(Evader(speed=speed) for speed in speeds)
    whys = [why for key, why in warned(team=Team(count=2, speeds=(0.5, 0.9)), evader=evaders) if key == "team.speeds"]
    assert len(whys) == (said is not None)
    assert all(f"no pursuer is {said}, so every capture time of theirs is inf and no pursuer" in why for why in whys)
    free = warned(team=Team(count=2, speeds=0.4), evader=evaders, prune="none")
    assert [why.endswith("of theirs is inf") for key, why in free if key == "team.speeds"] == [True]


@pytest.mark.parametrize("first", [True, False])
def test_the_fastest_of_several_evaders_may_jump(first):
    evaders = (Evader(speed=2.0), Evader(speed=0.5))
    given = {"motion": Motion(step=0.11), "capture": Capture(test="sample"), "team": Team(count=2, speeds=1.0)}
    found = dict(warned(**given, evader=evaders if first else evaders[::-1]))
    assert "step x speed = 0.22 m" in found["motion.step"]


SHORT = [
    ("network.latency.value", {"network": {"latency": {"kind": "constant", "value": 0.5e-9}}}),
    ("network.latency.values.1", {"network": {"latency": {"kind": "empirical", "values": [0.51e-9, 0.5e-9, 0.0]}}}),
    (
        "network.link.0.latency.scale",
        {"network": {"link": [{"src": 0, "dst": 1, "latency": {"kind": "gamma", "scale": 0.5e-9}}]}},
    ),
    ("network.processing.sender.value", {"network": {"processing": {"sender": 0.5e-9}}}),
    ("announce.belief_timeout", {"announce": {"belief_timeout": 0.5e-9}}),
    ("evader.reaction_delay", {"evader": {"reaction_delay": 0.5e-9}}),
]


@pytest.mark.parametrize(("key", "given"), SHORT)
def test_a_time_that_rounds_to_0_is_warned_of(key, given):
    assert [each for each in warned(**given) if each[0] == key] == [
        (key, "5e-10 s rounds to 0, because time is counted in nanoseconds")
    ]


def test_the_shortest_times_that_do_not_round_to_0_are_not_warned_of():
    assert warned(network={"latency": Constant(value=0.51e-9), "processing": {"receiver": 1e-9}}) == []


PERIODS = [
    ("motion.step", {"motion": {"step": 1.5}}),
    ("record.trajectory", {"record": {"trajectory": 1.5}}),
    ("announce.heartbeat", {"announce": {"heartbeat": 1.5}}),
    ("sensing.period", {"sensing": {"period": 1.5, "radius": 3.0}}),
    ("protocol.slot", {"protocol": {"kind": "centralised", "slot": 1.5}}),
    ("protocol.schedule.slot", {"protocol": {"kind": "sap", "schedule": {"kind": "shared_seed", "slot": 1.5}}}),
    (
        "protocol.schedule.holding_time",
        {"protocol": {"kind": "sap", "schedule": {"kind": "token_ring", "holding_time": 1.5}}},
    ),
    ("evader.1.strategy.period", {"evader": [{}, {"strategy": {"kind": "zigzag", "period": 1.5}}]}),
]


@pytest.mark.parametrize(("key", "given"), PERIODS)
@pytest.mark.parametrize(("horizon", "warned_of"), [(1.5, False), (1.499, True)])
def test_a_period_beyond_the_horizon_is_warned_of(key, given, horizon, warned_of):
    expected = [(key, "1.5 s is longer than the horizon of 1.499 s")] * warned_of
    assert [each for each in warned(**given, horizon=horizon) if "longer than" in each[1]] == expected


def test_a_period_that_nothing_has_may_be_beyond_the_horizon():
    """Without heartbeats, without a limit of sight, and for faults, whose mean duration is no period."""
    silent = Announcements(heartbeat=99.0, trigger="change")
    assert warned(announce=silent, sensing=Sensing(period=0.1), horizon=0.5) == []
    assert [why for _, why in warned(fault=[RandomCrashes(mean_downtime=99.0)]) if "longer than" in why] == []


@pytest.mark.parametrize(
    ("options", "span"), [({}, 4.5), ({"start": 1.0}, 3.5), ({"after": "hold"}, None), ({"after": "repeat"}, None)]
)
def test_a_trace_that_may_end_with_an_error_before_the_run_is_warned_of(options, span):
    trace = {"kind": "trace", "table": "t,value\n0,0\n1,0\n3,0\n", "after": "error"} | options
    link = {"src": 0, "dst": 1, "loss": trace}
    found = warned(network={"latency": trace, "link": [link]}, horizon=5.0)
    why = f"a message that is sent later than {span} s ends the run with an error, and the horizon is 5 s"
    assert found == ([] if span is None else [("network.latency.after", why), ("network.link.0.loss.after", why)])
    assert warned(network={"latency": trace, "link": [link]}, horizon=span or 1.0) == []


LONG = [
    ("network.latency", {"network": {"latency": 3.1}}, 3.1),
    ("network.latency", {"network": {"latency": {"kind": "uniform", "low": 0.2, "high": 6.0}}}, 3.1),
    ("network.latency", {"network": {"latency": {"kind": "shifted_exponential", "offset": 3.0, "mean": 0.1}}}, 3.1),
    ("network.latency", {"network": {"latency": {"kind": "gamma", "offset": 0.1, "shape": 3.0, "scale": 1.0}}}, 3.1),
    ("network.latency", {"network": {"latency": {"kind": "lognormal", "offset": 0.1, "mean": 3.0, "cv": 9.0}}}, 3.1),
    ("network.latency", {"network": {"latency": {"kind": "empirical", "values": [0.1, 6.1]}}}, 3.1),
    ("network.latency", {"network": {"latency": {"kind": "propagation", "fixed": 3.1}}}, 3.1),
    (
        "network.latency",
        {
            "network": {
                "latency": {
                    "kind": "per_pair",
                    "base": {"kind": "constant", "value": 3.0},
                    "jitter": {"kind": "constant", "value": 0.1},
                }
            }
        },
        3.1,
    ),
    ("network.link.0.latency", {"network": {"link": [{"src": 0, "dst": 1, "latency": 5.0}]}}, 5.0),
    ("network.processing", {"network": {"processing": {"sender": 2.0, "receiver": 2.0}}}, 4.0),
]


@pytest.mark.parametrize(
    ("mean", "share"), [(29.9, "more than a tenth of"), (30.0, "not less than"), (31.0, "not less than")]
)
def test_a_mean_latency_is_compared_with_the_horizon(mean, share):
    why = f"the mean latency of {mean:g} s is {share} the horizon of 30 s: times are in s, not ms"
    assert warned(network={"latency": mean}) == [("network.latency", why)]


@pytest.mark.parametrize(("key", "given", "mean"), LONG)
def test_a_mean_latency_above_a_tenth_of_the_horizon_is_warned_of(key, given, mean):
    """The default horizon is 30 s; the same latency is not warned of in a run that is ten times as long."""
    why = f"the mean latency of {mean:g} s is more than a tenth of the horizon of 30 s: times are in s, not ms"
    assert warned(**given) == [(key, why)]
    assert warned(**given, horizon=300.0) == []


def test_no_message_arrives_if_the_latency_reaches_the_horizon():
    assert warned(network=Links(latency=Constant(value=50.0)), motion=Motion(static=True)) == [
        (
            "network.latency",
            "the mean latency of 50 s is not less than the horizon of 30 s: times are in s, not ms",
        )
    ]


def test_a_latency_of_a_tenth_of_the_horizon_and_one_of_a_users_model_are_not_warned_of():
    def late(context, rng):
        return 20.0

    assert warned(network=Links(latency=Constant(value=3.0))) == []
    assert warned(network=Links(latency=late)) == []


@pytest.mark.parametrize(
    ("latencies", "longest"),
    [
        ([0.0, 0.1, 3.1, 29.0], None),
        ([0.1, 30.0], 30.0),
        ([0.0, 5.0, 10.0], 10.0),
        ([1.0, 10.0, 100.0], 100.0),
        ([0.0, 0.0], None),
    ],
)
def test_a_sweep_may_reach_to_long_latencies_unless_all_are_long_or_one_reaches_the_horizon(latencies, longest):
    """From 0.1 to 29 s is a study in seconds; 5 and 10, or 1, 10 and 100 are probably milliseconds."""
    found = list(latency_warnings([Scenario(network=Links(latency=Constant(value=each))) for each in latencies]))
    assert [why.split(" s is")[0] for _, why in found] == (
        [] if longest is None else [f"the mean latency of {longest:g}"]
    )


GEOMETRIC = {"protocol.kind": ["argmin", "voronoi"], "network.latency.value": [0.0, 0.1], "announce.heartbeat": [0.2]}
SENSED = (
    "it probably has no effect: positions are sensed, so nothing is announced (`announce.payload`)"
    " under argmin, voronoi"
)


@pytest.mark.parametrize(
    ("grid", "given", "warned_of"),
    [
        (GEOMETRIC, {}, {"network.latency.value": SENSED, "announce.heartbeat": SENSED}),
        (GEOMETRIC, {"sensing": Sensing(radius=3.0)}, {"announce.heartbeat": SENSED}),
        (GEOMETRIC | {"sensing.radius": [3.0, inf]}, {}, {"announce.heartbeat": SENSED}),
        (GEOMETRIC, {"announce": Announcements(payload="state")}, {}),
        (GEOMETRIC | {"announce.payload": ["action", "state"]}, {}, {}),
        (GEOMETRIC | {"protocol.kind": ["argmin", "sap"]}, {}, {}),
        (GEOMETRIC | {"protocol.kind": ["centralised", "server"]}, {}, {}),
        ({"protocol.kind": ["argmin"], "horizon": [1.0, 2.0]}, {}, {}),
        ({"network.latency.value": [0.01, 3.0]}, {}, {}),
        (
            {"network.latency.value": [10.0, 20.0]},
            {},
            {"network.latency": "the mean latency of 20 s is more than a tenth of the horizon of 30 s: times are in s"},
        ),
        ({"network.loss.p": [0.0, 0.5]}, {"network": Links(latency=Constant(value=20.0))}, {}),
    ],
)
def test_before_a_sweep_latencies_in_ms_and_keys_without_effect_are_warned_of(grid, given, warned_of):
    """The last of these latencies is warned of with the scenario itself, and not again."""
    found = dict(SweepPlan.of(Scenario(**given), grid, 1).warnings())
    assert found.keys() == warned_of.keys()
    assert all(found[key].startswith(why) for key, why in warned_of.items())


def test_each_thing_is_warned_of_in_one_go():
    """Assumptions stand between what concerns the network and what concerns motion."""
    keys = [
        key
        for key, _ in warned(
            team=Team(count=2, speeds=0.5),
            network=Links(reception=QuasiUnitDisk()),
            protocol=SpatialAdaptivePlay(schedule=Rounds()),
            fault=[ClockSkew(offset=1.0)],
            motion=Motion(step=31.0),
        )
    ]
    assert keys == ["team.speeds", "network.reception", "protocol", "protocol.schedule", "motion.step"]


def test_a_protocol_from_a_script_has_nothing_to_be_warned_of():
    assert warned(protocol=lambda me: iter(()), announce=Announcements(trigger="never")) == []


def test_estimates_that_cannot_be_recorded_are_warned_of():
    tracked = Sensing(noise=PositionNoise(), estimator=Kalman())
    asked = Recording(estimates=True)
    assert warned(sensing=tracked, record=asked) == []
    for given, why in (
        ({}, "no estimate has a covariance"),
        ({"sensing": Sensing(noise=PositionNoise(), estimator=AlphaBeta())}, "no estimate has a covariance"),
        ({"sensing": tracked, "protocol": Centralised()}, "no estimate has a covariance"),
        ({"sensing": tracked, "record": Recording(estimates=True, trajectory=0.0)}, "these are not"),
    ):
        assert [key for key, text in warned(**{"record": asked} | given) if why in text] == ["record.estimates"]


def test_a_property_of_positions_lets_the_scenario_record_them():
    usual = Scenario(record=Recording(trajectory=0.0))
    for text, recorded in (
        ("misassigned never longer than 2", SAMPLES),
        ("idle never longer than 2", usual.record.trajectory),
    ):
        made = recording(usual, [property_of(text)])
        assert made.record.trajectory == recorded
    half = usual.with_({"record.trajectory": 0.5})
    assert recording(half, [property_of("misassigned never longer than 2")]).record.trajectory == 0.5


def test_a_warning_about_one_of_several_evaders_names_its_table():
    """Three evaders in two tables: the last is the third evader, and that of the second table."""
    near, far = Evader(position=(9.0, 8.0), count=2), Evader(position=(1e6, 0.0))
    scenario = Scenario(team=Team(count=1, positions=((0.0, 0.0),)), evader=(near, far), horizon=1.0)
    assert [key for key, why in warnings(scenario) if "so far away" in why] == ["evader.1"]


def test_a_slot_that_is_too_short_for_a_token_with_absentees_is_warned_of():
    """6 pursuers: at 8 bit/ms, a token of 16 + 4 x 8 + 6 x 8 + 6 x 24 = 240 bytes takes 0.24 s, an absentee 0.008 s."""
    medium = {"kind": "bitrate", "bitrate": 8000.0, "access": {"kind": "tdma", "slot": 0.26, "guard": 0.001}}
    tables = {
        "team": {"count": 6},
        "protocol": {"kind": "sap", "schedule": "token_ring"},
        "network": {"medium": medium},
    }

    def texts(slot, fault):
        medium["access"]["slot"] = slot
        found = warnings(Scenario(**tables, fault=fault))
        return [why for key, why in found if key == "network.medium.access.slot"]

    crash = [{"kind": "crash", "start": 1.0, "node": 1}]
    assert texts(0.26, crash) == [
        "a message of the schedule lists the pursuers that do not answer: it is never sent if they are more than 2;"
        " with 4 of them it needs a slot of 0.273 s (got 0.26)"
    ]
    assert texts(0.273, crash) == texts(0.26, []) == []

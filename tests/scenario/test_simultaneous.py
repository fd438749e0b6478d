"""What happens at one instant, on every channel: lost by most is warned of, and nothing else is."""

import re
from collections import Counter, defaultdict
from math import erf, exp
from typing import Any

import pytest

from desim import Scenario, run
from desim.kernel.core.events import Broadcast, Lost, Queued
from desim.kernel.models.medium import MEDIA
from desim.kernel.models.presets import PRESETS
from desim.scenario.checks import warnings

FAST = {"kind": "bitrate", "bitrate": 1e6, "header": 50}
RANDOM = {"processing": {"sender": {"kind": "shifted_exponential", "mean": 0.002}}}
CHANNELS: dict[str, dict[str, Any]] = {
    "unlimited": {},
    "own channels": {"medium": FAST},
    "one queue": {"medium": FAST | {"shared": True}},
    "half duplex": {"medium": FAST | {"half_duplex": True}},
    "aloha": {"medium": FAST | {"access": {"kind": "aloha"}}},
    "slotted_aloha": {"medium": FAST | {"access": {"kind": "slotted_aloha", "slot": 0.001}}},
    "slotted_aloha p": {"medium": FAST | {"access": {"kind": "slotted_aloha", "slot": 0.001, "p": 0.05}}},
    "csma": {"medium": FAST | {"access": {"kind": "csma", "backoff": 0.02}}},
    "csma p": {"medium": FAST | {"access": {"kind": "csma", "persistence": "p_persistent", "p": 0.05}}},
    "csma 1": {"medium": FAST | {"access": {"kind": "csma", "persistence": "p_persistent"}}},
    "csma_ca": {"medium": FAST | {"access": {"kind": "csma_ca", "window": 64}}},
    "tdma": {"medium": FAST | {"access": {"kind": "tdma", "slot": 0.002}}},
    "csma_ca, random host": {"medium": FAST | {"access": {"kind": "csma_ca", "window": 64}}} | RANDOM,
    "csma_ca, constant host": {"medium": FAST | {"access": {"kind": "csma_ca"}}, "processing": {"sender": 0.001}},
    "aloha, random host": {"medium": FAST | {"access": {"kind": "aloha"}}} | RANDOM,
    "aloha, slow random host": {
        "medium": FAST | {"access": {"kind": "aloha"}},
        "processing": {"sender": {"kind": "uniform", "low": 0.0, "high": 0.08}},
    },
    **{name: {"preset": name} for name in PRESETS},
}
LOSES = {"half duplex", "aloha", "slotted_aloha", "csma", "csma 1", "csma_ca", "csma_ca, constant host"}
LOSES |= {"aloha, random host", "acoustic", *(f"lora_sf{sf}" for sf in range(7, 13))}
"""The channels on which most frames of one instant are lost."""
QUIET = {"trigger": "change", "jitter": 0.3, "start": "silent"}
CAUSES: dict[str, tuple[str, dict[str, Any]]] = {
    "rounds": (
        "protocol.schedule",
        {"protocol": {"kind": "cbba", "schedule": {"kind": "rounds"}}, "announce": QUIET | {"trigger": "revision"}},
    ),
    "synchronous": (
        "protocol.schedule",
        {
            "protocol": {
                "kind": "sap",
                "schedule": {"kind": "synchronous", "schedule": {"kind": "shared_seed", "slot": 0.1}},
            },
            "announce": QUIET | {"trigger": "revision"},
        },
    ),
    "slots of a geometric rule": (
        "protocol",
        {
            "protocol": {"kind": "argmin", "slot": 0.1},
            "announce": QUIET | {"trigger": "revision", "payload": "state"},
        },
    ),
    "first actions": (
        "announce.start",
        {
            "protocol": {"kind": "sap", "schedule": {"kind": "poisson", "rate": 0.5}},
            "announce": QUIET | {"jitter": 0.0, "start": "announced"},
        },
    ),
    "first reports": ("protocol", {"protocol": {"kind": "server", "period": 2.0}}),
    "recoveries": (
        "fault",
        {
            "protocol": {"kind": "sap", "schedule": {"kind": "poisson", "rate": 20.0}},
            "announce": QUIET | {"trigger": "revision"},
            "fault": [{"kind": "crash", "node": node, "start": 0.01, "end": 0.5} for node in range(8)],
        },
    ),
    "flooding without jitter": (
        "announce.dissemination.jitter",
        {
            "protocol": {"kind": "sap", "schedule": {"kind": "poisson", "rate": 0.5}},
            "announce": QUIET
            | {"trigger": "revision", "dissemination": {"kind": "flooding", "jitter": 0.0, "hops": 2}},
        },
    ),
    "acknowledgements of a broadcast": (
        "announce.dissemination",
        {
            "protocol": {"kind": "sap", "schedule": {"kind": "poisson", "rate": 0.5}},
            "announce": QUIET | {"trigger": "revision", "dissemination": {"kind": "reliable"}},
        },
    ),
}
"""The key of the warning about each cause of simultaneous frames, and its scenario."""


def scenario_of(channel, cause):
    """Return a scenario of eight pursuers that never capture the evader."""
    return Scenario(
        horizon=1.01,
        team={"count": 8, "speeds": 0.5},
        evader={"speed": 0.9, "position": (30.0, 0.0)},
        prune="none",
        network=CHANNELS[channel],
        record={"messages": True},
        **CAUSES[cause][1],
    )


def lost_of_one_instant(scenario):
    """Return the share of lost messages among those that several pursuers create at one instant, and their number."""
    sent, lost, senders = dict[int, tuple[int, int]](), Counter[int](), defaultdict(set)
    for event in run(scenario, seed=3).trace:
        if isinstance(event, Queued | Broadcast):
            when = event.t if isinstance(event, Queued) else event.created
            sent[event.transmission] = min((when, len(event.dst)), sent.get(event.transmission, (when, len(event.dst))))
            senders[when].add(event.src)
        elif isinstance(event, Lost):
            lost[event.transmission] += 1
    chosen = {number: size for number, (when, size) in sent.items() if len(senders[when]) > 1}
    total = sum(chosen.values())
    return sum(lost[number] for number in chosen) / total, total


@pytest.mark.parametrize("cause", CAUSES)
@pytest.mark.parametrize("channel", CHANNELS)
def test_what_is_lost_because_it_is_simultaneous_is_warned_of(channel, cause):
    scenario = scenario_of(channel, cause)
    keys = [key for key, text in warnings(scenario) if "at the same instant, and" in text]
    assert keys == ([CAUSES[cause][0]] if channel in LOSES else [])


@pytest.mark.parametrize("trigger", ["change", "both", "revision", "heartbeat", "never"])
@pytest.mark.parametrize(
    "protocol", [{"kind": "cbba", "schedule": {"kind": "rounds"}}, {"kind": "argmin", "slot": 0.1}]
)
def test_decisions_of_one_instant_are_warned_of_where_they_are_announced(trigger, protocol):
    scenario = scenario_of("csma", "rounds").with_(
        {"protocol": protocol, "announce.trigger": trigger, "announce.payload": "state"}
    )
    texts = [text for _, text in warnings(scenario) if text.startswith("pursuers announce their decisions")]
    assert len(texts) == (trigger in {"change", "both", "revision"})


def test_every_kind_of_channel_is_in_the_table():
    """A kind of access, a medium or a preset that is added later needs a row of its own."""
    media = [Scenario(network=network).network.medium for network in CHANNELS.values()]
    assert {each.kind for each in media} == {*MEDIA.choices()}
    assert {each.access.kind for each in media if hasattr(each, "access")} == {
        "ideal", "aloha", "slotted_aloha", "csma", "csma_ca", "tdma"
    }  # fmt: skip


@pytest.mark.parametrize("channel", CHANNELS)
def test_rounds_lose_most_messages_on_just_those_channels(channel):
    """The 560 messages of ten rounds, some of which are still in flight at the end on the slowest channels."""
    lost, number = lost_of_one_instant(scenario_of(channel, "rounds"))
    assert number == 560
    assert (lost >= 0.5) is (channel in LOSES)


@pytest.mark.slow_cases("slots of a geometric rule", "first reports", "recoveries", "acknowledgements of a broadcast")
@pytest.mark.parametrize("cause", CAUSES)
def test_each_cause_loses_most_messages_where_nothing_separates_them(cause):
    """On nonpersistent CSMA; the control is the same channel with a random delay of the hosts."""
    lost, number = lost_of_one_instant(scenario_of("csma", cause))
    assert lost >= 0.5
    assert number >= 6
    separated = scenario_of("csma", cause).with_({"network": CHANNELS["csma"] | RANDOM})
    assert lost_of_one_instant(separated)[0] < 0.3


@pytest.mark.parametrize(
    ("jitter", "channel", "changes", "is_warned"),
    [
        (0.0, "aloha", {}, True),
        (0.3, "aloha", {}, False),
        (0.0, "aloha, slow random host", {}, False),
        (0.0, "half duplex", {}, True),
        (0.0, "one queue", {}, False),
        (0.0, "csma_ca", {}, False),
        (0.0, "csma_ca", {"range": 10.0}, True),
        (0.3, "csma_ca", {"range": 10.0}, False),
        (0.0, "csma p", {"range": 10.0}, False),
        (0.0, "tdma", {"range": 10.0}, False),
    ],
)
def test_strictly_periodic_heartbeats_are_warned_of_where_two_that_overlap_once_always_do(
    jitter, channel, changes, is_warned
):
    scenario = Scenario(network=CHANNELS[channel] | changes, announce={"jitter": jitter})
    assert ("announce.jitter" in dict(warnings(scenario))) is is_warned


@pytest.mark.parametrize(
    ("skew", "is_warned"),
    [
        ({"offset": 0.001}, False),
        ({"drift": 1e-4}, False),
        ({"offset": 1e-9}, True),
        ({"node": 3, "offset": 0.5}, True),
    ],
)
def test_clocks_that_differ_separate_rounds(skew, is_warned):
    """A clock that is wrong for one pursuer only leaves the others at one instant."""
    scenario = scenario_of("csma_ca", "rounds").with_(
        {
            "network": {"medium": FAST | {"access": {"kind": "csma_ca", "sensing_delay": 4e-6}}},
            "fault": [{"kind": "clock_skew", **skew}],
        }
    )
    assert ("protocol.schedule" in {key for key, text in warnings(scenario) if "overlap" in text}) is is_warned


@pytest.mark.parametrize(
    ("count", "changes", "share"),
    [
        (
            3,
            {"network.processing.sender": {"kind": "shifted_exponential", "mean": 0.001}},
            lambda time: 1.0 - exp(-2.0 * time / 0.001),
        ),
        (
            2,
            {"fault": [{"kind": "clock_skew", "drift": 0.0001}], "horizon": 8.0},
            lambda time: erf(time / (2.0 * 0.0004)),
        ),
    ],
    ids=["random delays", "clocks"],
)
def test_the_share_that_overlaps_is_that_of_its_distribution(count, changes, share):
    """The differences of two delays are a Laplace distribution, and those of two clocks a normal one."""
    scenario = scenario_of("aloha", "rounds").with_({"team.count": count} | changes)
    (why,) = [why for key, why in warnings(scenario) if "of their frames overlap" in why]
    expected = 100.0 * share(scenario.announcement_airtime)
    assert int(re.search(r"up to (\d+) %", why)[1]) == pytest.approx(expected, abs=2.0)

"""Warnings about frames that several pursuers create at one instant on a channel where they then overlap.

In a simulation such frames start on the air at the same nanosecond, unless a random time separates them: the processing
delay of their senders, a jitter, or the errors of their clocks. Carrier sensing cannot: each of the senders finds an
idle channel.
"""

from collections.abc import Iterator
from math import hypot, inf
from typing import Any, NamedTuple

import numpy as np

from desim.config.arrays import Floats
from desim.config.traits import inherits
from desim.kernel.clock_sync import Unsynchronised
from desim.kernel.models.access import CarrierSensing, Channel
from desim.kernel.models.clock_skew import drawn_skews
from desim.kernel.models.faults import Crash
from desim.kernel.models.graphs import Complete
from desim.kernel.models.medium import MANY, channel_of
from desim.kernel.models.traits import LinkTraits
from desim.kernel.models.transport import Reliable
from desim.pursuit.core.traits import DisseminationTraits
from desim.scenario.scenario import Scenario

DRAWS = 4000
"""Number of draws from which the share of frames that overlap is estimated."""


def simultaneous_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the key and the text of a warning for each cause of simultaneous frames on a channel that loses them."""
    channel = channel_of(scenario.network.medium, scenario.announcement_airtime)
    count = scenario.team.count
    if channel is None or count < 2:
        return
    for key, who, size, spread in _instants(scenario):
        overlap = channel.chance * _share_within(scenario, channel.vulnerable, spread)
        lost = 1.0 - (1.0 - overlap) ** (size - 1)
        if size > 1 and lost >= MANY:
            yield (
                key,
                f"{who} at the same instant, and {_as_percent(lost)} of their frames overlap on this channel: a random"
                " delay, such as `network.processing.sender`, should separate them",
            )
    yield from _periodic_warnings(scenario, channel)


class _Spread(NamedTuple):
    """What separates frames, besides the processing at their senders."""

    uniform: float = 0.0
    """Longest uniform delay, s."""
    clocks: bool = False
    """Whether the times are those of the senders' clocks."""
    latency: bool = False
    """Whether frames answer one broadcast, whose latency may differ from receiver to receiver."""


def _instants(scenario: Scenario) -> Iterator[tuple[str, str, int, _Spread]]:
    """Yield the key, the text, the number of senders and the spread of frames that pursuers create at one instant."""
    announce, count, protocol = scenario.announce, scenario.team.count, scenario.protocol_traits
    by_clock = _Spread(clocks=True)
    announces_decisions = scenario.announces and announce.trigger in {"change", "both", "revision"}
    if scenario.schedule_traits.at_once and announces_decisions:
        yield "protocol.schedule", "pursuers announce their decisions", count, by_clock
    elif protocol.at_once and announces_decisions:
        yield "protocol", "pursuers announce their decisions", count, by_clock
    if scenario.announces and announce.start == "announced" and not announce.jitter:
        yield "announce.start", "pursuers announce their first actions", count, _Spread()
    if protocol.host is not None:
        yield "protocol", "pursuers send their first reports", count - 1, by_clock
    acknowledge = "the receivers of a broadcast acknowledge it"
    jitter = DisseminationTraits.of(announce.dissemination).forwarding_jitter
    if scenario.announces and isinstance(announce.dissemination, Reliable):
        yield "announce.dissemination", acknowledge, count - 1, _Spread(latency=True)
    elif scenario.announces and jitter is not None:
        spread = _Spread(jitter, latency=True)
        yield "announce.dissemination.jitter", "the receivers of a broadcast forward it", count - 1, spread
    if isinstance(scenario.network.transport, Reliable) and _broadcasts(scenario):
        yield "network.transport", acknowledge, count - 1, _Spread(latency=True)
    ends: dict[float, set[int]] = {}
    for fault in scenario.fault:
        if isinstance(fault, Crash) and fault.scope == "robot" and fault.end < scenario.horizon:
            ends.setdefault(fault.end, set()).add(fault.node)
    for end, nodes in ends.items():
        if announces_decisions:
            yield "fault", f"pursuers that recover at {end:g} s may announce their decisions", len(nodes), _Spread()


def _broadcasts(scenario: Scenario) -> bool:
    """Return whether pursuers broadcast messages that the transport of the network carries."""
    return not scenario.sight_is_perfect or scenario.protocol_traits.host is not None


def _periodic_warnings(scenario: Scenario, channel: Channel) -> Iterator[tuple[str, str]]:
    """Yield the warnings about strictly periodic messages: if those of two pursuers overlap once, they always do."""
    network, announce = scenario.network, scenario.announce
    all_hear_all = network.range == inf and inherits(network.graph, Complete)
    access: Any = network.medium.access  # type: ignore[attr-defined]  # a channel has one
    senses_carrier = isinstance(access, CarrierSensing)
    if senses_carrier and (all_hear_all or access.sensing_range is not None or channel.chance < 1.0):
        return
    which = "two pursuers out of hearing" if senses_carrier else "two pursuers"
    if channel.chance < MANY or _share_within(scenario, channel.hidden, _Spread()) < MANY:
        return
    has_heartbeats = scenario.announces and announce.has_heartbeats and not announce.jitter
    delay = "give `network.processing.sender` a random delay"
    for key, messages, is_sent, advice in (
        ("announce.jitter", "heartbeats", has_heartbeats, "give it some jitter"),
        ("sensing.period", "reports", not scenario.sight_is_perfect, delay),
        ("announce.trust.period", "accusations", announce.trust.period is not None, delay),
        ("clocks.sync.interval", "requests", scenario.clocks.sync != Unsynchronised(), delay),
    ):
        if is_sent:
            yield (
                key,
                f"without jitter, {messages} of {which} that overlap once on this channel overlap each time: {advice}",
            )


def _share_within(scenario: Scenario, time: float, spread: _Spread) -> float:
    """Return the estimated probability that two frames created at one instant start within a time, s, of each other."""
    rng = np.random.default_rng(0)
    delays = _drawn(scenario.network.processing.sender, rng) + spread.uniform * rng.random(2 * DRAWS)
    if spread.latency:
        delays = delays + _drawn(scenario.network.latency, rng)
    if spread.clocks and scenario.clocks.sync == Unsynchronised():
        delays = delays + _clock_error(scenario) * rng.standard_normal(2 * DRAWS)
    first, second = delays.reshape(2, DRAWS)
    return float(np.mean(np.abs(first - second) <= time))


def _drawn(model: Any, rng: np.random.Generator) -> Floats:
    """Return draws of a delay, s; 0 if its distribution depends on the link."""
    quantile = LinkTraits.of(model).quantile
    return np.zeros(2 * DRAWS) if quantile is None else np.asarray(quantile(rng.random(2 * DRAWS)))


def _clock_error(scenario: Scenario) -> float:
    """Return the standard deviation of the clocks of all pursuers in the middle of a run, s."""
    skews = drawn_skews(scenario.fault)
    return hypot(*(part for skew in skews for part in (skew.offset, skew.drift * scenario.horizon / 2.0)))


def _as_percent(share: float) -> str:
    return "all" if share > 0.995 else f"up to {100 * share:.0f} %"

"""The scenarios that cannot run live: each reason as a sentence."""

from collections.abc import Iterator
from typing import Any

from desim.kernel.clock_sync import TwoWay
from desim.kernel.models.clock_skew import is_skewed
from desim.kernel.models.latency import Constant
from desim.kernel.models.medium import Unlimited
from desim.kernel.models.traits import FaultTraits
from desim.kernel.models.transport import BestEffort
from desim.live.wire import MAX_NODES
from desim.pursuit.byzantine.lies import is_lie
from desim.pursuit.core.traits import DisseminationTraits
from desim.scenario.scenario import Scenario


class NotLiveError(ValueError):
    """A scenario cannot run live."""


def check_live(scenario: Scenario) -> None:
    """Raise NotLiveError, whose message has the key and the reason, if a scenario cannot run live."""
    for key, why in reasons(scenario):
        raise NotLiveError(f"{key} cannot run live: {why}")


def reasons(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the keys of a scenario that cannot run live, each with the reason."""
    yield from _of_protocol(scenario)
    for k, evader in enumerate(scenario.evaders):
        if evader.listens:
            yield f"evader.{k}.strategy", "the evader would overhear transmissions, which reach pursuers only"
    yield from _of_network(scenario)
    for k, fault in enumerate(scenario.fault):
        if is_lie(fault):
            yield f"fault.{k}", "lies know what the network knows, and are told in a simulation only"
        elif not FaultTraits.of(fault).is_scheduled:
            yield f"fault.{k}", "this fault decides in one place what several processes would have to agree on"
        elif not FaultTraits.of(fault).memory and any(transport for _, transport in _transports(scenario)):
            yield f"fault.{k}.memory", "a node without memory would number its messages anew; see network.transport"


def clocks_differ(scenario: Scenario) -> bool:
    """Return whether the clocks of pursuers may differ: by errors, or because their synchronisation corrects them."""
    return is_skewed(scenario.network_faults) or isinstance(scenario.clocks.sync, TwoWay)


def _of_protocol(scenario: Scenario) -> Iterator[tuple[str, str]]:
    traits = scenario.protocol_traits
    if traits.omniscient or not traits.embodied:
        yield "protocol.kind", "an omniscient protocol decides for all pursuers in one place; it is the benchmark"
    if scenario.team.count > MAX_NODES:
        yield "team.count", f"a datagram can name {MAX_NODES} pursuers"
    if not scenario.sight_is_perfect:
        yield "sensing", "the referee moves a pursuer that sees no evader, and does not know where it searches"


def _of_network(scenario: Scenario) -> Iterator[tuple[str, str]]:
    links = scenario.network
    if type(links.medium) is not Unlimited:
        yield "network.medium", "sockets have no airtime, and contend for no channel"
    if type(links.processing.sender) is not Constant:
        yield "network.processing.sender", "a delay before the queue of a sender needs a queue; use a number"
    if DisseminationTraits.of(scenario.announce.dissemination).transport:
        if clocks_differ(scenario):
            yield (
                "announce.dissemination",
                "with clock errors or corrections, a record and its message have two times, and bytes for one",
            )
        if scenario.schedule_traits.spreads_to is not None:
            yield (
                "announce.dissemination",
                "the messages of this schedule carry records, too, so that a record and its message have two numbers,"
                " and bytes for one",
            )
    for key, transport in _transports(scenario):
        if transport.needed > 1:
            yield f"{key}.needed", "the code is ideal, and no bytes are its pieces; with 1, a piece is the message"
        if isinstance(transport, BestEffort):
            yield key, "best_effort counts no bytes for a frame, which tell its qualities; coded with pieces = 1 does"


def _transports(scenario: Scenario) -> Iterator[tuple[str, Any]]:
    """Yield the transports of a scenario that do more than hand messages to the links, by their keys."""
    if not scenario.network.transport.is_plain:
        yield "network.transport", scenario.network.transport
    announced = DisseminationTraits.of(scenario.announce.dissemination).transport
    if announced is not None:
        yield "announce.dissemination", announced

"""What cannot run live: each reason as a sentence."""

from collections.abc import Iterator

from desim.kernel.models.faults import ClockSkew, Crash, Jamming, Partition, RandomCrashes, RandomFaults
from desim.kernel.models.latency import Constant
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Unlimited
from desim.kernel.models.transport import Coded, Reliable
from desim.live.wire import MAX_NODES
from desim.pursuit.byzantine.lies import is_lie
from desim.scenario.scenario import Scenario


class NotLiveError(ValueError):
    """A scenario cannot run live."""


def check_live(scenario: Scenario) -> None:
    """Raise an error if a scenario cannot run live.

    Raises:
        NotLiveError: if it cannot; the message has the key and the reason.
    """
    for key, why in reasons(scenario):
        raise NotLiveError(f"{key} cannot run live: {why}")


def reasons(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the keys of a scenario that cannot run live, each with the reason."""
    yield from _of_protocol(scenario)
    yield from _of_world(scenario)
    yield from _of_network(scenario)
    for k, fault in enumerate(scenario.fault):
        if is_lie(fault):
            yield f"fault.{k}", "lies know what the network knows, and are told in a simulation only"
        elif type(fault) not in {Crash, Partition, Jamming, RandomCrashes, RandomFaults, ClockSkew}:
            yield f"fault.{k}", "this fault decides in one place what several processes would have to agree on"
        elif isinstance(fault, RandomFaults) and not {"crash", "partition", "jamming"}.issuperset(fault.kinds):
            yield f"fault.{k}.kinds", "only crash, partition and jamming can"
        elif _erases_memory(fault) and _has_transport(scenario):
            yield f"fault.{k}.memory", "a node without memory would number its messages anew; see network.transport"


def _of_protocol(scenario: Scenario) -> Iterator[tuple[str, str]]:
    traits = scenario.protocol_traits
    if traits.omniscient or not traits.embodied:
        yield "protocol.kind", "an omniscient protocol decides for all pursuers in one place; it is the benchmark"
    if scenario.team.count > MAX_NODES:
        yield "team.count", f"a datagram can name {MAX_NODES} pursuers"
    if not scenario.sight_is_perfect:
        yield "sensing", "the referee moves a pursuer that sees no evader, and does not know where it searches"


def _of_world(scenario: Scenario) -> Iterator[tuple[str, str]]:
    for k, evader in enumerate(scenario.evaders):
        if evader.listens:
            yield f"evader.{k}.strategy", "the evader would overhear transmissions, which reach pursuers only"


def _of_network(scenario: Scenario) -> Iterator[tuple[str, str]]:
    links = scenario.network
    if type(links.medium) is not Unlimited:
        yield "network.medium", "sockets have no airtime, and contend for no channel"
    if type(links.processing.sender) is not Constant:
        yield "network.processing.sender", "a delay before the queue of a sender needs a queue; use a number"
    if links.duplicate != Bernoulli() and type(links.transport) is Coded:
        yield "network.duplicate", "pieces and copies of a message cannot be told apart"
    transports = [("network.transport", links.transport), ("announce.dissemination", scenario.announce.dissemination)]
    for key, transport in transports:
        if isinstance(transport, Coded) and transport.needed > 1:
            yield f"{key}.needed", "the code is ideal, and no bytes are its pieces; with 1, a piece is the message"


def _erases_memory(fault: object) -> bool:
    return isinstance(fault, RandomFaults) or not getattr(fault, "memory", True)


def _has_transport(scenario: Scenario) -> bool:
    return not scenario.network.transport.is_plain or isinstance(scenario.announce.dissemination, Reliable | Coded)

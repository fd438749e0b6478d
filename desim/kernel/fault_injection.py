"""Fault injection: apply faults to a network at their start and end times."""

from collections.abc import Callable, Iterable
from functools import partial

import simpy

from desim.config.model import MAX_TIME
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Trace
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.faults import Crash, Fault, FaultEnded, FaultStarted, Partition, nodes_of
from desim.kernel.models.traits import FaultTraits
from desim.kernel.network import Network

Hook = Callable[[Crash], object]


def inject(
    faults: Iterable[Fault],
    env: Clock,
    network: Network,
    trace: Trace | None = None,
    *,
    crashed: Hook = lambda _: None,
    recovered: Hook = lambda _: None,
) -> None:
    """Schedule faults for a network that was created with a `FaultState`.

    Args:
        faults: the faults to apply.
        env: the clock of the simulation.
        network: the network to apply them to.
        trace: receives the events `FaultStarted` and `FaultEnded`.
        crashed: called with each crash when it starts.
        recovered: called with each crash when it ends.

    Raises:
        ValueError: if a fault names a node that does not exist, or starts before the current time, or if faults were
            injected before and messages have been sent. The fate of these messages may have been decided already.
    """
    faults, size = list(faults), network.topology.size
    if faults and network.fault_state.is_planned and network.message_counts().sent:
        raise ValueError("faults should be injected before the first message is sent")
    for fault in faults:
        if unknown := [node for node in nodes_of(fault) if node >= size]:
            raise ValueError(f"{fault.kind}: there is no node {unknown[0]}: the nodes are 0 .. {size - 1}")

    def begin(fault: Fault, _: simpy.Event) -> None:
        if trace is not None:
            trace.append(FaultStarted(env.now, fault))
        with network.fault_state.planned_change():
            end = _start(fault, network, crashed, recovered)
            if fault.end <= MAX_TIME:  # no run lasts longer than `MAX_TIME`
                schedule(fault.end, partial(finish, fault, end))

    def finish(fault: Fault, end: Callable[[], object], _: simpy.Event) -> None:
        if trace is not None:
            trace.append(FaultEnded(env.now, fault))
        with network.fault_state.planned_change():
            end()

    def schedule(time: float, change: Callable[[simpy.Event], None]) -> None:
        when = nanoseconds(time)
        network.fault_state.plan(when)
        Instant(env, when, Phase.FAULT).callbacks.append(change)

    for fault in faults:
        schedule(fault.start, partial(begin, fault))


def _start(fault: Fault, network: Network, crashed: Hook, recovered: Hook) -> Callable[[], object]:
    """Start a fault; return a function that ends it."""
    fault_state = network.fault_state
    if isinstance(fault, Crash):
        network.crash(fault.node)
        crashed(fault)

        def recover() -> None:
            network.recover(fault.node, memory=fault.memory)
            recovered(fault)

        return recover
    if isinstance(fault, Partition):
        cut = fault_state.partition(fault.groups, FaultTraits.of(fault).cause or "partition")
        return lambda: fault_state.rejoin(cut)
    disc = (fault.centre, fault.radius)
    cause = FaultTraits.of(fault).cause or "jamming"
    fault_state.jam(disc, cause)
    return lambda: fault_state.clear(disc, cause)

"""Fault injection: apply faults to a network at their start and end times."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import simpy

from desim.config.answers import wrong_answer
from desim.config.arguments import value_text
from desim.config.calls import check_at_once, check_call
from desim.config.model import MAX_TIME
from desim.config.traits import kind_of
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Cause, Trace
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.faults import Crash, Delays, Fault, Jamming, Partition, Undo, cause_of, nodes_of
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted, TracedFault, as_built_in, traced
from desim.kernel.models.traits import FaultTraits
from desim.kernel.network import Network

Hook = Callable[[Crash], object]
"""A function called with a crash when it starts, or when it ends."""
Targets = Callable[[], Sequence[int]]
"""Returns the nodes that matter most now; see `FaultSite.targets`."""


def inject(
    faults: Iterable[Fault],
    env: Clock,
    network: Network,
    trace: Trace | None = None,
    *,
    crashed: Hook = lambda _: None,
    recovered: Hook = lambda _: None,
    targets: Targets = lambda: (),
) -> None:
    """Schedule faults for a network that was created with a `FaultState`.

    Args:
        faults: the faults to apply.
        env: the clock of the simulation.
        network: the network to apply them to.
        trace: receives the events `FaultStarted` and `FaultEnded`.
        crashed: called with each crash when it starts.
        recovered: called with each crash when it ends.
        targets: returns the nodes that matter most now, for faults that look at the run (`FaultSite.targets`).

    Raises:
        ValueError: if a fault names a node that does not exist, or starts before the current time, or if faults were
            injected before and messages have been sent since: their fates may have been decided already.
    """
    faults, size = list(faults), network.topology.size
    if faults and network.fault_state.is_planned and network.message_counts().sent:
        raise ValueError("faults should be injected before the first message is sent")
    sites = [_Site(fault, env, network, trace, crashed, recovered, targets) for fault in faults]
    for fault in faults:
        _require_named_nodes(fault, size)

    def begin(site: _Site, _: simpy.Event) -> None:
        site.record(FaultStarted)
        with network.fault_state.planned_change():
            undo = site.apply()
            # The end is scheduled here, because `undo` does not exist earlier. No run lasts longer than `MAX_TIME`.
            if site.fault.end <= MAX_TIME:
                schedule(site.fault.end, partial(finish, site, undo))

    def finish(site: _Site, undo: Undo, _: simpy.Event) -> None:
        site.record(FaultEnded)
        with network.fault_state.planned_change():
            undo()

    def schedule(time: float, change: Callable[[simpy.Event], None]) -> None:
        when = nanoseconds(time)
        network.fault_state.plan(when)
        Instant(env, when, Phase.FAULT).callbacks.append(change)

    for site in sites:
        schedule(site.fault.start, partial(begin, site))


@dataclass(eq=False)
class _Site:
    """The `desim.kernel.models.faults.FaultSite` of one fault. Fields without a description are as in `inject`."""

    fault: Fault
    _env: Clock
    _network: Network
    _trace: Trace | None
    _crashed: Hook
    _recovered: Hook
    targets: Targets
    _inherited_cause: Cause | None = None
    """The stated cause of the fault of which this one is a part; None: it is no part, or that fault states no cause."""

    def __post_init__(self) -> None:
        self._stated_cause = FaultTraits.of(self.fault).cause or self._inherited_cause
        self._record, self._cause = traced(self.fault), self._stated_cause or cause_of(self.fault)

    @property
    def size(self) -> int:
        return self._network.topology.size

    def record(self, kind: type[FaultStarted | FaultEnded], part: TracedFault | None = None) -> None:
        """Append to the trace that the fault, or a part of it, starts or ends now."""
        if self._trace is not None:
            self._trace.append(kind(self._env.now, part or self._record))

    def apply(self) -> Undo:
        """Let the fault begin; return the function that ends it."""
        answer: Any = self.fault.begin(self)
        if not callable(answer):
            expected = "a function without arguments that ends the fault"
            raise wrong_answer(f"begin(site) of a fault should return {expected}", answer, self.fault)
        check_call(answer, (), answer)
        check_at_once(answer, "the function that ends a fault ")  # it is not a generator
        undo: Undo = answer
        return undo

    def begin(self, fault: Fault) -> Undo:
        _require(isinstance(fault, Fault), "begin(fault)", "a fault, such as Crash(start=1.0, node=0)", fault)
        _require_named_nodes(fault, self.size)
        part = replace(self, fault=fault, _inherited_cause=self._stated_cause)
        part.record(FaultStarted)
        undo = part.apply()

        def end() -> None:
            part.record(FaultEnded)
            undo()

        return end

    def crash(self, crash: Crash) -> Undo:
        _require(isinstance(crash, Crash), "crash(crash)", "a Crash, such as Crash(start=1.0, node=0)", crash)
        _require_nodes([crash.node], self.size, "crash: ")
        # A fault that is recorded as a crash is in the trace already. A crash by any other fault is recorded here:
        # metrics, replays and invariants read from the trace which nodes are down, and which lose their memory.
        record = None if isinstance(self._record, Crash) else cast("Crash", as_built_in(crash, Crash))
        if record is not None:
            self.record(FaultStarted, record)
        outage = self._network.crash(crash.node, self._cause)
        self._crashed(crash)

        def recover() -> None:
            if record is not None:
                self.record(FaultEnded, record)
            self._network.recover(crash.node, outage, memory=crash.memory)
            self._recovered(crash)

        return recover

    def partition(self, groups: Iterable[Iterable[int]]) -> Undo:
        try:
            parts = tuple(map(tuple, groups))
        except TypeError:
            example = "[[0, 1], [2, 3]] for instance"
            raise ValueError(
                f"partition(groups) should be given lists of nodes, {example} (got {value_text(groups)})"
            ) from None
        partition = Partition(start=0.0, groups=parts)  # checks the arguments
        _require_nodes(partition.named()["groups"], self.size, "partition: ")
        return self._network.fault_state.partition(partition.groups, self._cause)

    def block(self, is_blocked: Callable[[int, int], bool]) -> Undo:
        _require(callable(is_blocked), "block(is_blocked)", "a function of two nodes", is_blocked)
        check_call(is_blocked, ("src", "dst"), is_blocked)
        return self._network.fault_state.block(is_blocked, self._cause)

    def intercept(self, delays: Delays) -> Undo:
        _require(callable(delays), "intercept(delays)", "a function of sender, receivers and body", delays)
        check_call(delays, ("src", "receivers", "body"), delays)
        return self._network.fault_state.intercept(delays, self._cause)

    def jam(self, centre: tuple[float, float], radius: float) -> Undo:
        jamming = Jamming(start=0.0, centre=centre, radius=radius)  # checks the arguments
        return self._network.fault_state.jam((jamming.centre, jamming.radius), self._cause)


def _require(is_right: bool, call: str, expected: str, value: object) -> None:
    """Raise ValueError if a fault of a user has called a method of its site with a wrong argument."""
    if not is_right:
        raise ValueError(f"{call} should be given {expected} (got {value_text(value)})")


def _require_named_nodes(fault: Fault, size: int) -> None:
    """Raise ValueError if one of the nodes that a fault names does not exist."""
    for key, nodes in nodes_of(fault).items():
        _require_nodes(nodes, size, f"{kind_of(fault)}.{key}: ")


def _require_nodes(nodes: Iterable[int], size: int, where: str) -> None:
    """Raise ValueError if one of some nodes does not exist."""
    if unknown := [node for node in nodes if not 0 <= node < size]:
        raise ValueError(f"{where}there is no node {unknown[0]}: the nodes are 0 .. {size - 1}")

"""The result of a live run: as that of a simulation, and how the run went."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

from desim.kernel.core.portable_math import portable_sum
from desim.live.link import Drops
from desim.live.wall_clock import Lateness
from desim.simulation.run import Result

LateKind = Literal["timers", "deliveries", "orders"]
"""What can be late; an order is a change of an action."""
REFEREE = "referee"
"""The name of the referee among the processes."""


@dataclass
class Conduct:
    """How a live run went, besides its trace.

    Attributes:
        lateness: by process, the pursuers and "referee", how late its timers were.
        timers: how late each timer of all processes was, ns.
        deliveries: how much later than its time each message was delivered, ns.
        orders: how long after its decision each change of an action has taken effect, ns.
        cpu: by process, the pursuers and "referee", the processor time of the run, s. That of the referee includes all
            runs at the same time, until the trace of this run is merged.
        drops: by pursuer, the datagrams that it has dropped.
        ends: by pursuer whose process was lost, how it ended.
        notes: sentences about what went wrong.
    """

    lateness: dict[int | str, Lateness] = field(default_factory=dict)
    timers: list[int] = field(default_factory=list)
    deliveries: list[int] = field(default_factory=list)
    orders: list[int] = field(default_factory=list)
    cpu: dict[int | str, float] = field(default_factory=dict)
    drops: dict[int, Drops] = field(default_factory=dict)
    ends: dict[int, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def note(self, process: int | str, timers: Sequence[int], deliveries: Sequence[int]) -> None:
        """Note how late the timers and the deliveries of a process were, ns."""
        self.lateness[process] = Lateness.of(timers)
        self.timers += timers
        self.deliveries += deliveries

    @property
    def dropped(self) -> Drops:
        """The datagrams that all pursuers together have dropped."""
        return Drops(*(portable_sum(counts) for counts in zip(*self.drops.values(), strict=True)))

    def document(self) -> dict[str, object]:
        """Return how the run went as JSON types."""
        all_late = {name: Lateness.of(getattr(self, name))._asdict() for name in get_args(LateKind)}
        lateness = {str(name): late._asdict() for name, late in self.lateness.items()}
        drops = {str(pursuer): counts._asdict() for pursuer, counts in self.drops.items()}
        ends = {str(pursuer): end for pursuer, end in self.ends.items()}
        cpu = {str(name): spent for name, spent in self.cpu.items()}
        return {**all_late, "processes": lateness, "cpu": cpu, "drops": drops, "ends": ends, "notes": self.notes}


@dataclass(frozen=True, repr=False)
class LiveResult(Result):
    """The result of a live run.

    Attributes:
        conduct: how the run went.
    """

    conduct: Conduct = field(default_factory=Conduct)


def lateness_of(results: Sequence[LiveResult], name: LateKind) -> Lateness:
    """Return how late timers, deliveries of messages or orders were in several runs."""
    return Lateness.of([late for result in results for late in getattr(result.conduct, name)])

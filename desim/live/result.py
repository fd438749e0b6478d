"""The result of a live run: as that of a simulation, and how the run went."""

from dataclasses import dataclass, field

from desim.live.link import Drops
from desim.live.wall_clock import Lateness
from desim.simulation.run import Result

REFEREE = "referee"
"""The name of the referee among the processes."""


@dataclass
class Conduct:
    """How a live run went, besides its trace.

    Attributes:
        lateness: by process, the pursuers and "referee", how late its timers were.
        delivery_error: how much later than its time each message was delivered.
        cpu: by pursuer, the time that its process has computed during the run, s.
        drops: by pursuer, the datagrams that it has dropped.
        ends: by pursuer whose process was lost, how it ended.
        notes: sentences about what went wrong.
    """

    lateness: dict[int | str, Lateness] = field(default_factory=dict)
    delivery_error: Lateness = field(default_factory=lambda: Lateness.of([]))
    cpu: dict[int, float] = field(default_factory=dict)
    drops: dict[int, Drops] = field(default_factory=dict)
    ends: dict[int, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @property
    def p99(self) -> float:
        """The greatest 99th percentile of the lateness of a process, s."""
        return max((late.p99 for late in self.lateness.values()), default=0.0)

    @property
    def dropped(self) -> Drops:
        """The datagrams that all pursuers together have dropped."""
        return Drops(*(sum(counts) for counts in zip(*self.drops.values(), strict=True)))

    def document(self) -> dict[str, object]:
        """Return it as JSON types."""
        lateness = {str(name): late._asdict() for name, late in self.lateness.items()}
        drops = {str(pursuer): counts._asdict() for pursuer, counts in self.drops.items()}
        ends = {str(pursuer): end for pursuer, end in self.ends.items()}
        cpu = {str(pursuer): spent for pursuer, spent in self.cpu.items()}
        error = self.delivery_error._asdict()
        return {
            **{"lateness": lateness, "delivery_error": error, "cpu": cpu},
            **{"drops": drops, "ends": ends, "notes": self.notes},
        }


@dataclass(frozen=True, repr=False)
class LiveResult(Result):
    """The result of a live run.

    Attributes:
        conduct: how the run went.
    """

    conduct: Conduct = field(default_factory=Conduct)

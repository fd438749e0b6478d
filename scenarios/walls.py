"""What walls cost each protocol, through radio, sight and motion separately: four rooms with doors.

Six pursuers look for an evader in four rooms (`scenarios/rooms.toml`). The walls block nothing, one of radio, sight and
motion, or all three. Where they block radio, pursuers hear each other only within a room and through doors. Where they
block sight, pursuers see the evader only within a room and through doors. Where they block motion, all players walk
around them. Each cost is the difference from walls that block nothing, with the same seeds. All protocols, also
`local_min`, have their default parameters. The players start at the same places in all cases, outside of the walls.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from desim import Scenario, load
from desim.analysis.metrics import active_time, end_time
from desim.analysis.statistics import Estimate, estimate, paired
from desim.analysis.tables import aligned
from scenarios.studies.study import SCENARIOS, Options, metrics_of, study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PROTOCOLS = ("local_min", "best_response", "cbaa", "server", "centralised")
BLOCKED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "nothing": (),
        "radio": ("radio",),
        "sight": ("sight",),
        "motion": ("motion",),
        "all": ("radio", "sight", "motion"),
    }
)
"""The things that the walls block, by name."""
METRICS = MappingProxyType({"active time": active_time, "end time": end_time})


@dataclass(frozen=True)
class Cost:
    """The cost of walls to one protocol in one metric, s."""

    protocol: str
    blocked: str
    metric: str
    mean: float
    """The mean of the metric among these walls, s."""
    difference: Estimate
    """Paired difference of the metric from that among walls that block nothing, s."""


def rooms(protocol: str, blocks: Sequence[str]) -> Scenario:
    """Return the scenario of a protocol among walls that block some of radio, sight and motion."""
    base = load(SCENARIOS / "rooms.toml")
    walls = [wall.model_copy(update={"blocks": (*blocks, "start")}) for wall in base.wall]
    changes: dict[str, Any] = {"wall": walls, "protocol": {"kind": protocol}}
    return base.with_(changes)


def measure(options: Options) -> list[Cost]:
    """Run all protocols among all walls, and compare the runs of equal seeds."""
    cases = [(protocol, blocked) for protocol in PROTOCOLS for blocked in BLOCKED]
    values = options.measure_each(
        cases, lambda protocol, blocked: rooms(protocol, BLOCKED[blocked]), "walls", metrics_of(*METRICS.values())
    )
    costs = []
    for protocol, blocked in cases:
        for k, metric in enumerate(METRICS):
            with_walls = [run[k] for run in values[protocol, blocked]]
            without = [run[k] for run in values[protocol, "nothing"]]
            costs.append(Cost(protocol, blocked, metric, estimate(with_walls).mean, paired(with_walls, without)))
    return costs


def table(costs: Sequence[Cost], runs: int) -> str:
    """Return all results as text."""
    parts = []
    for metric in METRICS:
        rows = [("protocol", "without walls", *(name for name in BLOCKED if name != "nothing"))]
        for protocol in PROTOCOLS:
            line = [cost for cost in costs if (cost.protocol, cost.metric) == (protocol, metric)]
            without = next(cost.mean for cost in line if cost.blocked == "nothing")
            added = [f"{cost.difference:+.2f}" for cost in line if cost.blocked != "nothing"]
            rows.append((protocol, f"{without:.2f}", *added))
        parts.append(f"{metric}, s, and what walls add to it; {runs} runs, 95 % intervals\n{aligned(rows)}")
    return "\n\n".join(parts)


def picture(costs: Sequence[Cost]) -> "Figure":
    """Draw what walls add to each metric, a group of bars for each protocol."""
    from desim.analysis.drawing import palette, plots

    with plots.styled(figsize=(8.0, 3.2)) as figure:
        for axes, metric in zip(figure.subplots(1, len(METRICS)), METRICS, strict=True):
            for k, (blocked, colour) in enumerate(zip([*BLOCKED][1:], palette.SERIES, strict=False)):
                line = [cost for cost in costs if (cost.blocked, cost.metric) == (blocked, metric)]
                x = [group + 0.2 * (k - 1.5) for group in range(len(PROTOCOLS))]
                heights, errors = [cost.difference.mean for cost in line], [cost.difference.half_width for cost in line]
                axes.bar(x, heights, 0.18, yerr=errors, color=colour, label=blocked, error_kw={"elinewidth": 0.7})
            axes.axhline(0.0, color=palette.GREY, lw=0.7)
            axes.set_xticks(range(len(PROTOCOLS)), PROTOCOLS, rotation=20, ha="right")
            axes.set_ylabel(f"added {metric} (s)")
        figure.axes[0].legend(title="walls block", fontsize=8)
    return figure


@study("walls", __doc__, seconds=2, runs=10)
def main(options: Options) -> None:
    """Run the pursuits among walls, and show the results."""
    costs = measure(options)
    options.show({"costs": costs}, table(costs, options.runs), lambda: picture(costs))


if __name__ == "__main__":
    main()

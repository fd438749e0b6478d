"""Measure the cost of latency: the scaling law of excess active time, and the phase diagram over latency and slot.

The law: if all pursuers start active and decide greedily, the excess active time int (n - 1)+ dt is
g_N(L lambda) N^2 delta, with the one-way latency L, the decision rate of a pursuer lambda and delta = 1 / (N lambda).
First g is measured on static games, for several schedules. Then relay time + g N^2 delta predicts, without any fit, the
sum of active times of the moving pursuit over a grid of latencies and slots. Where the prediction exceeds about 30 s,
the evader is captured before the excess has decayed, so the measured sum is lower.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from desim import Scenario
from desim.analysis.metrics import active_time, excess_time
from desim.analysis.statistics import estimate
from desim.analysis.tables import aligned
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.pursuit.announcements import Announcements
from desim.scenario.scenario import Motion, Recording, Team
from protocols.centralised import Centralised
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules import Poisson, Rounds, Schedule, SharedSeed
from protocols.temperature import ConstantTau
from protocols.token import TokenRing
from scenarios.study import Options, study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

N = 20
LAMBDA = 5.0
"""Decision rate lambda of one pursuer in the static games, 1/s."""
DELAYS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 16.0, 64.0)
"""Values of L lambda."""
SCHEDULES: dict[str, Callable[[float], Schedule]] = {
    "poisson": lambda slot: Poisson(rate=1.0 / (N * slot)),
    "shared_seed": lambda slot: SharedSeed(slot=slot),
    "rounds": lambda slot: Rounds(period=N * slot),
    "token_ring": lambda slot: TokenRing(holding_time=slot),
}
SLOTS = (0.001, 0.003, 0.01, 0.03, 0.1)
"""Values of delta in the pursuits, s."""
LATENCIES = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Values of L in the pursuits, s."""
CRITICAL = 3.0
"""L lambda at which the excess is about twice that without latency."""


@dataclass(frozen=True)
class Point:
    """g at one L lambda under one schedule: the excess on static games in units of N^2 delta."""

    schedule: str
    delay: float
    excess: float
    standard_error: float


@dataclass(frozen=True)
class Cell:
    """The mean sum of active times of the pursuit at one latency and slot, and the prediction of the law, s."""

    latency: float
    slot: float
    active_time: float
    standard_error: float
    predicted: float


def static(schedule: Schedule, latency: float) -> Scenario:
    """Return a game without motion, in which all pursuers start active and decide greedily."""
    return Scenario(
        name="static game",
        horizon=60.0 + 10.0 * latency,
        team=Team(count=N),
        motion=Motion(static=True),
        protocol=SpatialAdaptivePlay(tau=ConstantTau(value=1e-9), schedule=schedule),
        announce=Announcements(trigger="change"),
        network=Links(latency=Constant(value=latency)),
        record=Recording(trajectory=0.0),
    )


def pursuit(latency: float, slot: float) -> Scenario:
    """Return the pursuit of the paper under Poisson clocks."""
    return Scenario(
        name="pursuit",
        team=Team(count=N),
        protocol=SpatialAdaptivePlay(schedule=SCHEDULES["poisson"](slot)),
        network=Links(latency=Constant(value=latency)),
        record=Recording(trajectory=0.0),
    )


def measure_law(options: Options) -> list[Point]:
    """Return g for each schedule and delay; for the ring, whose slots grow with the latency, at zero latency only."""
    slot = 1.0 / (N * LAMBDA)
    keys = [(name, delay) for name in SCHEDULES for delay in DELAYS if name != "token_ring" or not delay]
    scenarios = [static(SCHEDULES[name](slot), delay / LAMBDA) for name, delay in keys]
    found = _means(scenarios, options, "static games", excess_time)
    unit = N * N * slot
    return [Point(*key, mean / unit, error / unit) for key, (mean, error) in zip(keys, found, strict=True)]


def law(points: Sequence[Point]) -> Callable[[float], float]:
    """Return g under Poisson clocks as a function of L lambda, interpolated between the measured points."""
    poisson = [(point.delay, point.excess) for point in points if point.schedule == "poisson"]
    delays, excess = zip(*poisson, strict=True)
    return lambda delay: float(np.interp(delay, delays, excess))


def measure_pursuits(options: Options, points: Sequence[Point]) -> list[Cell]:
    """Return the phase diagram, measured and predicted by the law."""
    g = law(points)
    keys = [(latency, slot) for latency in LATENCIES for slot in SLOTS]
    alone = pursuit(0.0, SLOTS[0]).model_copy(update={"protocol": Centralised(slot=SLOTS[0])})
    (relay, _), *found = _means([alone, *(pursuit(*key) for key in keys)], options, "pursuits", active_time)
    return [
        Cell(latency, slot, mean, error, relay + g(latency / (N * slot)) * N * N * slot)
        for (latency, slot), (mean, error) in zip(keys, found, strict=True)
    ]


def _means(
    scenarios: Sequence[Scenario], options: Options, label: str, metric: Callable[..., float]
) -> list[tuple[float, float]]:
    """Return the mean and the standard error of a metric over the runs of each scenario."""
    estimates = [estimate(values) for values in options.measure(scenarios, label, metric)]
    return [(each.mean, each.standard_error) for each in estimates]


def table(points: Sequence[Point], cells: Sequence[Cell], runs: int) -> str:
    """Return the law and the phase diagram as text."""
    at = {(point.schedule, point.delay): point for point in points}
    rows = [("L lambda", *SCHEDULES)]
    for delay in DELAYS:
        found = [at.get((name, delay)) for name in SCHEDULES]
        rows.append((f"{delay:g}", *(f"{p.excess:.3f} +- {p.standard_error:.3f}" if p else "" for p in found)))
    here = {(cell.latency, cell.slot): cell for cell in cells}
    grid = [("L | delta", *(f"{slot:g} s" for slot in SLOTS))]
    for latency in LATENCIES:
        line = [here[latency, slot] for slot in SLOTS]
        grid.append(
            (f"{latency:g} s", *(f"{c.active_time:.1f} +- {c.standard_error:.1f} ({c.predicted:.1f})" for c in line))
        )
    return (
        f"Excess active time on static games in units of N^2 delta, N = {N}, {runs} runs each, +- standard error\n"
        f"{aligned(rows)}\n\n"
        f"Sum of active times of the pursuit, s, Poisson clocks, {runs} runs each (predicted by the law, no fit)\n"
        f"{aligned(grid)}"
    )


def picture(points: Sequence[Point], cells: Sequence[Cell]) -> "Figure":
    """Draw the law for each schedule, and the phase diagram with the prediction of the law."""
    from desim.analysis import plots

    with plots.styled(figsize=(9.0, 3.9)) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
        for colour, name in zip(plots.SERIES, SCHEDULES, strict=False):
            line = [point for point in points if point.schedule == name]
            x = [max(point.delay, DELAYS[1] / 2) for point in line]
            left.errorbar(
                x,
                [point.excess for point in line],
                [point.standard_error for point in line],
                color=colour,
                marker="o",
                ms=4,
                lw=1.2,
                label=name,
            )
        left.loglog()
        ticks = [DELAYS[1] / 2, *DELAYS[1:]]
        left.set_xticks(ticks, [f"{x:g}" for x in DELAYS])
        left.set_yticks([1, 3, 10, 30], ["1", "3", "10", "30"])
        left.minorticks_off()
        left.set(xlabel=r"latency in decisions of one pursuer, $L\lambda$", ylabel=r"excess active time ($N^2\delta$)")
        left.legend(fontsize=8)
        draw_phases(right, cells)
    return figure


def draw_phases(axes: "Axes", cells: Sequence[Cell]) -> None:
    """Draw the measured active time as colours, the law as contour lines, and the line L lambda = `CRITICAL`."""
    from matplotlib.colors import LogNorm

    measured = np.array([cell.active_time for cell in cells]).reshape(len(LATENCIES), len(SLOTS))
    predicted = np.array([cell.predicted for cell in cells]).reshape(measured.shape)
    rows = np.arange(len(LATENCIES))
    columns = np.arange(len(SLOTS))
    image = axes.pcolormesh(columns, rows, measured, norm=LogNorm(), cmap="viridis_r", shading="nearest")
    lines = axes.contour(columns, rows, predicted, levels=[6, 8, 12, 20, 40], colors="black", linewidths=0.9)
    axes.clabel(lines, fontsize=7)
    for row, column in np.ndindex(measured.shape):
        text = f"{measured[row, column]:.0f}\n({predicted[row, column]:.0f})"
        colour = "black" if measured[row, column] < 15 else "white"
        axes.text(column, row, text, ha="center", va="center", fontsize=7, color=colour)
    critical = [np.interp(CRITICAL * N * slot, LATENCIES, rows, right=np.nan) for slot in SLOTS]
    axes.plot(columns, critical, color="#D55E00", lw=1.6, ls="--", label=r"$L = 3 / \lambda$")
    axes.set_xticks(columns, [f"{slot:g}" for slot in SLOTS])
    axes.set_yticks(rows, [f"{latency:g}" for latency in LATENCIES])
    axes.set(xlabel=r"slot $\delta$ (s)", ylabel="one-way latency L (s)")
    axes.set_title("sum of active times: measured (colour), by the law (lines and brackets)", fontsize=9)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.12), fontsize=8)
    scale = axes.figure.colorbar(image, ax=axes, label="s")
    scale.set_ticks([7, 10, 20, 40], labels=["7", "10", "20", "40"])
    scale.minorticks_off()


@study("delay", __doc__, runs=30)
def main(options: Options) -> None:
    """Measure the law and the pursuits, and compare them."""
    points = measure_law(options)
    cells = measure_pursuits(options, points)
    document = {"law": [asdict(point) for point in points], "pursuits": [asdict(cell) for cell in cells]}
    options.show(document, table(points, cells, options.runs), lambda: picture(points, cells))


if __name__ == "__main__":
    main()

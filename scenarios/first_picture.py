"""Draw the picture on the first page of the documentation: one pursuit, and the effect of one-way latency.

Left: the pursuit of scenarios/relay.toml. Right: the mean number of active pursuers over time for several latencies of
the same network. The mean at each time is over the runs that have not yet ended.
"""

from typing import TYPE_CHECKING

import numpy as np

from desim import Result, load, run
from desim.analysis.metrics import activity
from desim.analysis.tables import aligned
from scenarios.studies.study import SCENARIOS, Options, study

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

LATENCIES = (0.0, 0.1, 0.5, 1.0)
"""One-way latencies, s."""
TIMES = np.arange(0.0, 5.0, 0.02)
"""Times, s, at which the active pursuers are counted."""
DASHES = ("-", (0, (6, 1.5)), (0, (3, 1.5)), (0, (1, 1)))
"""Line styles by latency: a longer latency has shorter dashes."""
FILE = SCENARIOS / "relay.toml"


def active_pursuers(result: Result) -> "NDArray[np.float64]":
    """Return the number of active pursuers at `TIMES`, nan after the end of the run."""
    durations, counts = activity(result)
    steps = np.searchsorted(np.cumsum(durations), TIMES, side="right")
    return np.append(counts.astype(float), np.nan)[steps]


def picture(means: dict[float, "NDArray[np.float64]"]) -> "Figure":
    """Draw the trajectories and the mean number of active pursuers."""
    from desim.analysis.drawing import palette, plots
    from desim.analysis.drawing.trajectory import draw_trajectory

    result = run(load(FILE))
    with plots.styled(figsize=(8.4, 4.8)) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
        draw_trajectory(left, result)
        left.set_anchor("N")  # leaves the space below for the legend
        left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=7)
        looks = zip(palette.SERIES, DASHES, strict=False)
        for (colour, dash), (latency, mean) in zip(looks, means.items(), strict=False):
            right.plot(TIMES, mean, color=colour, ls=dash, lw=1.8, label=f"{latency:g} s")
        right.axhline(1.0, color=palette.GREY, lw=0.8, ls=":")
        right.set(xlabel="time (s)", ylabel="active pursuers (mean)", ylim=(0, None), xlim=(0, TIMES[-1]))
        right.set_yticks(range(0, 21, 5))
        right.legend(title="one-way latency", handlelength=3, reverse=True)  # top to bottom as the lines
    return figure


@study("first_picture", __doc__, seconds=0.25, runs=100)
def main(options: Options) -> None:
    """Run, average and draw."""
    scenarios = [load(FILE, [f"network.latency.value={latency}"]) for latency in LATENCIES]
    curves = options.measure(scenarios, "latencies", active_pursuers)
    means = {latency: np.nanmean(curve, axis=0) for latency, curve in zip(LATENCIES, curves, strict=True)}
    rows: list[Sequence[str]] = [("latency, s", "active pursuers at 1 s", "2 s", "4 s")]
    rows += [(f"{x:g}", *(f"{np.interp(t, TIMES, mean):.2f}" for t in (1, 2, 4))) for x, mean in means.items()]
    document = {"time": TIMES.tolist(), "active": {str(x): mean.tolist() for x, mean in means.items()}}
    options.show(document, aligned(rows), lambda: picture(means))


if __name__ == "__main__":
    main()

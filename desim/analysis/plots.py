"""Pictures from results: matplotlib figures that are the same bytes every time."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from desim.analysis.metrics import ending
from desim.kernel.clock import seconds
from desim.pursuit.events import Sampled, Started
from desim.simulation import Result

# Okabe & Ito 2008, distinguishable by the colour-blind.
ORANGE, SKY, GREEN, BLUE = "#E69F00", "#56B4E9", "#009E73", "#0072B2"
VERMILION, PURPLE, GREY = "#D55E00", "#CC79A7", "#999999"
SERIES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
__all__ = ["SERIES", "Axes", "Figure", "save", "styled", "trajectory"]

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "desim",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


@contextmanager
def styled(figsize: tuple[float, float]) -> Iterator[Figure]:
    """Yield an empty figure (size in inches) to draw on in the style of the house."""
    with mpl.rc_context(STYLE):
        yield Figure(figsize=figsize, layout="constrained")


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write a figure as SVG and PNG beside each other, without a date; return their paths."""
    paths = [stem.with_suffix(".svg"), stem.with_suffix(".png")]
    with mpl.rc_context(STYLE):
        figure.savefig(paths[0], metadata={"Date": None})
        figure.savefig(paths[1], dpi=150)
    return paths


def trajectory(result: Result) -> Figure:
    """Draw where everyone went: the evader, who captured it, and who chased for a while.

    Raises:
        ValueError: if the run recorded no positions.
    """
    samples = result.trace.of(Sampled)
    if not samples:
        raise ValueError("no positions were recorded: set record.trajectory to a time greater than 0 s")
    start, end = result.trace.of(Started)[0], ending(result)
    evader = np.array([sample.evader for sample in samples])
    pursuers = np.array([sample.pursuers for sample in samples])  # (samples, N, 2)
    chased = [i for i in range(pursuers.shape[1]) if np.ptp(pursuers[:, i], axis=0).any()]
    with styled(figsize=(5.2, 5.2)) as figure:
        axes = figure.add_subplot(aspect="equal", xlabel="x (m)", ylabel="y (m)")
        axes.plot(*np.array(start.pursuers).T, "o", mfc="white", mec=GREY, ms=5, label="pursuer at the start")
        for i in chased:
            last = i == end.capturer
            style: dict[str, Any] = {"color": BLUE, "lw": 2.0, "zorder": 3} if last else {"color": SKY, "lw": 1.0}
            label = f"pursuer {i}, who captured" if last else "pursuer who chased for a while"
            axes.plot(
                *pursuers[:, i].T, **style, label=label if last or i == min(set(chased) - {end.capturer}) else None
            )
        axes.plot(*evader.T, color=VERMILION, lw=1.6, label="evader", zorder=4)
        axes.plot(*evader[0], "s", color=VERMILION, ms=5, zorder=4)
        if end.reason == "captured":
            axes.plot(*evader[-1], "*", color="black", ms=11, zorder=5, label=f"capture, {seconds(end.t):.2f} s")
        axes.set_title(f"{result.scenario.name}, seed {result.seed}", parse_math=False)
        figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    return figure

"""Figures from results, drawn by matplotlib; files are reproducible byte by byte."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from desim.analysis.trace_index import captures, sampled
from desim.config.file_names import PICTURE_SUFFIXES, files
from desim.config.trust import escaped, without_symlink
from desim.kernel.clock import seconds
from desim.simulation.run import Result

# Okabe & Ito 2008, distinguishable by the colour-blind.
ORANGE, SKY, GREEN, BLUE = "#E69F00", "#56B4E9", "#009E73", "#0072B2"
VERMILION, PURPLE, GREY = "#D55E00", "#CC79A7", "#999999"
SERIES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
__all__ = [
    "COLUMN",
    "EVADER",
    "GREY",
    "SERIES",
    "Axes",
    "Figure",
    "draw_trajectory",
    "save",
    "set_plane",
    "styled",
    "trajectory",
]

COLUMN = 8.5 / 2.54
"""The width of a column of a paper, inches."""
STYLE: dict[Any, Any] = {
    "text.usetex": False,  # a matplotlibrc in the working folder may set it; names would then run as TeX
    "svg.fonttype": "none",
    "svg.hashsalt": "desim",
    "pdf.fonttype": 42,  # TrueType; publishers refuse Type 3
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}
EVADER: Mapping[str, Any] = {
    **{"color": VERMILION, "ls": (0, (3, 1.5)), "gapcolor": "white", "zorder": 4},
    **{"marker": "s", "markevery": [0]},
}
"""Style of an evader's path: a square at its start, and dashes that distinguish it from pursuers in greyscale, too."""
UNDATED: Mapping[str, Mapping[str, None]] = {".svg": {"Date": None}, ".png": {}, ".pdf": {"CreationDate": None}}
"""The metadata to omit from each format."""


@contextmanager
def styled(figsize: tuple[float, float], *, font: float = 9.0) -> Iterator[Figure]:
    """Yield an empty figure in the common style; its layout is computed at the end.

    Args:
        figsize: width and height, inches.
        font: size of text, points.
    """
    small = {} if font >= STYLE["font.size"] else {"axes.titlesize": font, "axes.linewidth": 0.6}
    with mpl.rc_context(STYLE | small | {"font.size": font}):
        figure = Figure(figsize=figsize, layout="constrained")
        yield figure
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # else each save would compute a slightly different layout


def save(figure: Figure, path: Path, *, dpi: int = 150) -> list[Path]:
    """Write a figure, without a date, and return the files written: one, or SVG and PNG if the path has no suffix.

    Args:
        figure: a figure made by `styled`.
        path: the path of the file, with a suffix of `PICTURE_SUFFIXES` or without one.
        dpi: dots per inch of a PNG.

    Raises:
        ValueError: if the suffix is not one of `PICTURE_SUFFIXES`.
    """
    paths = files(path, PICTURE_SUFFIXES, PICTURE_SUFFIXES[:2])
    with mpl.rc_context(STYLE):
        for each in paths:
            kind = each.suffix.lower()
            figure.savefig(without_symlink(each), format=kind[1:], dpi=dpi, metadata=UNDATED[kind])
    return paths


def trajectory(result: Result) -> Figure:
    """Return a figure of the paths of the evaders, their capturers, and all other pursuers that moved.

    Raises:
        ValueError: if the run recorded no positions.
    """
    with styled(figsize=(5.2, 5.2)) as figure:
        axes = figure.add_subplot()
        draw_trajectory(axes, result)
        axes.set_title(escaped(f"{result.scenario.name}, seed {result.seed}"), parse_math=False)
        figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    return figure


def set_plane(axes: Axes) -> None:
    """Set axes to the plane: equal scales, labels in metres, and the same tick spacing on both."""
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 5, 10]))


def draw_trajectory(axes: Axes, result: Result) -> None:
    """Draw the paths of all players on given axes; see `trajectory`."""
    samples = sampled(result)
    evaders = np.array([sample.evaders for sample in samples])  # (samples, M, 2)
    pursuers = np.array([sample.pursuers for sample in samples])  # (samples, N, 2)
    captured = captures(result)
    capturers = list(dict.fromkeys(each.capturer for each in captured))
    others = [i for i in range(pursuers.shape[1]) if np.ptp(pursuers[:, i], axis=0).any() and i not in capturers]
    set_plane(axes)
    axes.plot(*pursuers[0].T, "o", mfc="white", mec=GREY, ms=5, label="pursuer at the start")
    for i in others:
        label = "pursuer that chased for a while" if i == others[0] else None
        axes.plot(*pursuers[:, i].T, color=SKY, lw=1.4, label=label)
    several = len(evaders[0]) > 1
    for capturer in capturers:
        label = None if capturer != capturers[0] else "pursuer that captures"
        label = label if several else f"pursuer {capturer}, which captures"
        axes.plot(*pursuers[:, capturer].T, color=BLUE, lw=2.0, label=label, zorder=3)
    for k, path in enumerate(evaders.transpose(1, 0, 2), start=1):
        axes.plot(*path.T, lw=1.6, ms=5, label="evader" if k == 1 else None, **EVADER)
        if several:
            axes.annotate(str(k), path[0], (4, 4), textcoords="offset points", fontsize=8, zorder=6)
    for capture in captured:
        which = f"capture of {capture.evader} by {capture.capturer}" if several else "capture"
        label = f"{which}, {seconds(capture.t):.2f} s"
        axes.plot(*evaders[-1, capture.evader - 1], "*", color="black", ms=11, zorder=5, label=label)

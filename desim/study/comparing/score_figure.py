"""The figure of a benchmark: the totals of all protocols, and their scores by scenario."""

from collections.abc import Mapping, Sequence

import numpy as np

from desim.analysis.drawing.palette import BLUE, GREY, VERMILION
from desim.analysis.drawing.plots import Axes, Figure, Style, size_of, styled
from desim.analysis.statistics import Estimate
from desim.study.results.figure_labels import literal

ROW, HEAD = 0.22, 1.3
"""The height of the row of a protocol, and of the rest of the figure, inches."""
WIDTH = 8.0
"""The default width, inches."""


def score_figure(
    totals: Mapping[str, tuple[Estimate, Estimate]],
    scores: Mapping[str, Sequence[float]],
    scenarios: Sequence[str],
    *,
    size: str | None = None,
    style: Style = None,
) -> Figure:
    """Draw the totals with 95 % intervals beside a heat map of scores; for size and style see `Benchmark.plot`.

    `totals` holds score and quality of each protocol, from top to bottom, and `scores` its scores in the order of
    `scenarios`.

    Raises:
        ValueError: if the size or the style is invalid.
    """
    width, height = (WIDTH, None) if size is None else size_of(size)
    with styled(figsize=(width, height or HEAD + ROW * len(totals)), font=8.0, style=style) as figure:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.0, 1.3))
        _draw_totals(left, totals)
        _draw_scores(right, [scores[name] for name in totals], scenarios)
    return figure


def _draw_totals(axes: Axes, totals: Mapping[str, tuple[Estimate, Estimate]]) -> None:
    """Draw score and quality of each protocol, joined by a line as long as its loss."""
    for row, (score, quality) in enumerate(totals.values()):
        axes.plot([score.mean, quality.mean], [row, row], color=GREY, lw=1.0, zorder=1)
        for value, colour, face in ((quality, VERMILION, "white"), (score, BLUE, BLUE)):
            axes.errorbar(
                value.mean, row, xerr=value.half_width, fmt="o", ms=4, color=colour, mfc=face, elinewidth=0.8, zorder=2
            )
    axes.axvline(1.0, color="black", lw=0.6, ls=":")
    handles = [
        axes.plot([], [], "o", ms=4, color=VERMILION, mfc="white", label="quality: on a perfect network")[0],
        axes.plot([], [], "o", ms=4, color=BLUE, label="score: on the network as it is")[0],
    ]
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)
    axes.set_yticks(range(len(totals)), list(map(literal, totals)))
    axes.invert_yaxis()
    axes.set_xlabel("mean over the scenarios")


def _draw_scores(axes: Axes, scores: Sequence[Sequence[float]], scenarios: Sequence[str]) -> None:
    """Draw scores as a heat map with printed values; scores below 0 have the colour of 0."""
    values = np.array(scores, dtype=float)
    axes.imshow(values, vmin=0.0, vmax=1.0, cmap="cividis", aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        colour = "black" if value > 0.55 else "white"
        axes.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=6.5, color=colour)
    axes.set_xticks(range(len(scenarios)), list(scenarios), rotation=40, ha="right", rotation_mode="anchor")
    axes.tick_params(length=0)
    axes.tick_params(axis="y", labelleft=False)
    axes.spines[:].set_visible(False)
    axes.set_title("score by scenario", fontsize=8, loc="left")

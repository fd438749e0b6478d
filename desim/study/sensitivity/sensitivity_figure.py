"""The figure of a sensitivity analysis: the effect of each key, and its indices, as bars with intervals."""

from collections.abc import Sequence
from math import isnan
from typing import Any

from desim.analysis.drawing.palette import BLUE, GREY, SKY
from desim.analysis.drawing.plots import Axes, Figure, Style, as_it_is, styled
from desim.analysis.metrics import words
from desim.study.results.figure_labels import axis_label, columns_of, literal
from desim.study.sensitivity.morris import ElementaryEffects
from desim.study.sensitivity.sobol_indices import IndexEstimate, SobolIndices

HEIGHT = 0.36
"""The height of a bar, as a share of the distance between two keys."""


def draw_sensitivity(
    keys: Sequence[str],
    effects: ElementaryEffects | None,
    indices: SobolIndices | None,
    kept: Sequence[int],
    *,
    title: str,
    metric: str,
    unit: str,
    size: str | None = None,
    style: Style = None,
) -> Figure:
    """Draw the effects and the indices, if any, a panel each; keys are in the order of the grid.

    The arguments are the fields of a `SensitivityResult`, whose `plot` says what size and style are.

    Raises:
        ValueError: if the size or the style is invalid.
    """
    panels = [panel for panel in (effects, indices) if panel is not None]
    columns = columns_of(len(panels), size, beside=1.6)
    rows = len(panels) // columns
    default_size = (1.6 + 3.2 * columns, 1.3 * rows + 0.42 * rows * len(keys))
    with styled(default_size, size, style=style) as figure:
        grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for axes, panel in zip(grid.flat, panels, strict=True):
            if panel is effects:
                _draw_bars(axes, effects.mean_absolute, range(len(keys)), 0.0, GREY)
                axes.set_xlabel(axis_label(f"effect on {words(metric)}", unit))
            elif indices is not None:
                _draw_bars(axes, indices.total, kept, HEIGHT / 2, BLUE, "total index")
                _draw_bars(axes, indices.first, kept, -HEIGHT / 2, SKY, "first-order index")
                axes.set_xlabel(f"share of the variance of {words(metric)}")
                if indices.is_varied:
                    figure.legend(loc="outside lower center", ncols=2, fontsize=7)
                else:  # as in the table of the result
                    place: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "va": "center"}
                    axes.text(0.5, 0.5, "no variance beyond chance", fontsize=7, **place)
            axes.axvline(0.0, color=GREY, lw=0.8)
        axes = figure.axes[0]
        axes.set_yticks(range(len(keys)), list(map(literal, keys)))
        axes.set_ylim(len(keys) - 0.5, -0.5)
        if size is None:
            heading = f"{title}: what decides {words(metric)}"
            figure.suptitle(as_it_is(heading), fontsize=9, wrap=True)
    return figure


def _draw_bars(
    axes: Axes,
    estimates: Sequence[IndexEstimate],
    rows: Sequence[int],
    shift: float,
    colour: str,
    label: str | None = None,
) -> None:
    """Draw a bar with its interval in some rows, each moved up by `shift`; an estimate that is undefined has none."""
    defined = [(row, one) for row, one in zip(rows, estimates, strict=True) if not isnan(one.value)]
    if not defined:
        return
    heights = [row - shift for row, _ in defined]
    sizes = [estimate.value for _, estimate in defined]
    axes.barh(heights, sizes, height=HEIGHT, color=colour, label=label)
    less = [max(estimate.value - estimate.low, 0.0) for _, estimate in defined]
    more = [max(estimate.high - estimate.value, 0.0) for _, estimate in defined]
    axes.errorbar(sizes, heights, xerr=[less, more], fmt="none", ecolor="black", elinewidth=0.8, capsize=2)

"""The figure of a sensitivity analysis: the effect of each key, and its indices, as bars with intervals."""

from collections.abc import Sequence
from math import isnan

from desim.analysis.drawing.palette import BLUE, GREY, SKY
from desim.analysis.drawing.plots import NARROW, Axes, Figure, Style, as_it_is, size_of, styled
from desim.analysis.metrics import with_unit, words
from desim.config.trust import escaped
from desim.study.sensitivity.sensitivity_result import SensitivityResult
from desim.study.sensitivity.sobol_indices import IndexEstimate

HEIGHT = 0.36
"""The height of a bar, as a share of the distance of two keys."""


def draw_sensitivity(result: SensitivityResult, *, size: str | None = None, style: Style = None) -> Figure:
    """Draw the effects and the indices that a result has, a panel each; keys are in the order of the grid.

    Raises:
        ValueError: if the size or the style is invalid.
    """
    panels = [
        *(["effects"] if result.effects is not None else []),
        *(["indices"] if result.indices is not None else []),
    ]
    usual = (1.6 + 3.2 * len(panels), 1.3 + 0.42 * len(result.keys))
    width, height = usual if size is None else size_of(size)
    font = 9.0 if width >= NARROW else 8.0
    with styled(figsize=(width, height or width * usual[1] / usual[0]), font=font, style=style) as figure:
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False, sharey=True)[0], panels, strict=True):
            if panel == "effects" and result.effects is not None:
                _draw_bars(axes, result.effects.mean_absolute, range(len(result.keys)), 0.0, GREY)
                axes.set_xlabel(with_unit(f"effect on {words(result.metric)}", result.unit))
            elif result.indices is not None:
                _draw_bars(axes, result.indices.total, result.kept, HEIGHT / 2, BLUE, "total index")
                _draw_bars(axes, result.indices.first, result.kept, -HEIGHT / 2, SKY, "first-order index")
                axes.set_xlabel(f"share of the variance of {words(result.metric)}")
                if result.indices.is_varied:
                    figure.legend(loc="outside lower center", ncols=2, fontsize=7)
            axes.axvline(0.0, color=GREY, lw=0.8)
        axes = figure.axes[0]
        axes.set_yticks(range(len(result.keys)), [escaped(key).replace("$", r"\$") for key in result.keys])
        axes.set_ylim(len(result.keys) - 0.5, -0.5)
        if size is None:
            title = f"{result.name}: what decides {words(result.metric)}"
            figure.suptitle(escaped(title), fontsize=9, **as_it_is(result.name))
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
    drawn = [(row - shift, one) for row, one in zip(rows, estimates, strict=True) if not isnan(one.value)]
    if not drawn:
        return
    at = [row for row, _ in drawn]
    sizes = [one.value for _, one in drawn]
    axes.barh(at, sizes, height=HEIGHT, color=colour, label=label)
    less = [max(one.value - one.low, 0.0) for _, one in drawn]
    more = [max(one.high - one.value, 0.0) for _, one in drawn]
    axes.errorbar(sizes, at, xerr=[less, more], fmt="none", ecolor="black", elinewidth=0.8, capsize=2)

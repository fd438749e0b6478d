"""Legends that would lie on data."""

import pytest
from matplotlib.lines import Line2D

from desim.analysis.drawing.legends import covers_data
from desim.analysis.drawing.plots import styled
from tests.drawn import described
from tests.golden import golden


def lines(axes):
    axes.plot([0.0, 1.0], [0.0, 1.0], label="line")


def markers(axes):
    axes.plot([0.05, 0.95], [0.05, 0.95], "o", label="markers")


def error_bars(axes):
    axes.errorbar([0.05, 0.95], [0.5, 0.5], yerr=0.5, fmt="none", label="bars")


def scattered(axes):
    axes.scatter([0.05, 0.95], [0.05, 0.95], label="dots")


def bars(axes):
    axes.bar([0.1, 0.9], [1.0, 1.0], width=0.3, label="bars")


def area(axes):
    axes.fill_between([0.0, 1.0], [0.0, 0.0], [1.0, 1.0], label="area")


@pytest.mark.parametrize("draw", [lines, markers, error_bars, scattered, bars, area])
@pytest.mark.parametrize("corner", ["upper right", "lower left"])
def test_a_legend_on_data_is_moved_below_the_axes(draw, corner):
    with styled(figsize=(3.0, 2.0)) as figure:
        axes = figure.add_subplot()
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
        draw(axes)
        axes.legend(loc=corner)
    assert axes.get_legend() is None
    (legend,) = figure.legends
    assert not covers_data(figure, legend.get_window_extent())
    assert not legend.get_window_extent().overlaps(axes.get_window_extent())


def test_a_moved_legend_keeps_the_marks_of_lines_with_error_bars():
    with styled(figsize=(3.0, 2.0)) as figure:
        axes = figure.add_subplot()
        for level, mark in ((0.2, "s"), (0.8, "D")):
            axes.errorbar([0.05, 0.95], [level, level], yerr=0.5, marker=mark, label=mark)
        axes.legend(loc="upper right")
    (legend,) = figure.legends
    marks = {line.get_marker() for line in legend.findobj(Line2D)}
    assert {"s", "D"} <= marks


@pytest.mark.slow
def test_a_legend_beside_data_stays():
    with styled(figsize=(3.0, 2.0)) as figure:
        axes = figure.add_subplot()
        lines(axes)
        axes.legend(loc="upper left", title="kind")
    assert axes.get_legend() is not None
    assert not figure.legends


@pytest.mark.slow
@pytest.mark.parametrize("look", [{"ls": "none", "marker": "o"}, {"ls": "", "marker": "s"}, {"marker": ""}])
def test_a_legend_between_marks_and_beside_a_line_stays(look):
    """Marks that are not joined lie on both sides of it; a line without marks passes below."""
    with styled(figsize=(3.0, 2.0)) as figure:
        axes = figure.add_subplot()
        low = 0.9 if look.get("ls") is not None else 0.02
        axes.plot([0.02, 0.98], [low, low], label="x", **look)
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
        axes.legend(loc="upper center")
    assert axes.get_legend() is not None


def test_a_moved_legend_is_golden():
    """It keeps its title, the size of its texts and the looks of its lines, in at most three columns."""
    with styled(figsize=(4.0, 2.0), font=9.0) as figure:
        axes = figure.add_subplot()
        for k in range(4):
            axes.errorbar([0.0, 1.0], [0.5 + k / 10, 0.9], yerr=0.4, marker="os"[k % 2], label=f"line {k}")
        axes.legend(loc="upper right", title="kind", fontsize=6)
    golden("legend.txt", described(figure) + "\n")


@pytest.mark.slow
def test_data_of_axes_with_another_ordinate_count_and_the_title_is_kept():
    with styled(figsize=(3.0, 2.0)) as figure:
        axes = figure.add_subplot()
        axes.plot([0.0, 1.0], [0.0, 0.0], label="one")
        axes.set_ylim(0.0, 1.0)
        axes.legend(loc="upper center", title="kind")
        twin = axes.twinx()
        twin.plot([0.0, 1.0], [0.9, 0.9])
        twin.set_ylim(0.0, 1.0)
    (legend,) = figure.legends
    assert legend.get_title().get_text() == "kind"
    assert [text.get_text() for text in legend.get_texts()] == ["one"]

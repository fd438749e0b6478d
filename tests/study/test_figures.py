"""Pictures of a sweep: what is drawn where."""

from dataclasses import replace
from itertools import pairwise, product
from math import inf, isnan
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from desim.analysis.drawing.plots import as_it_is, save
from desim.analysis.measuring import summary
from desim.analysis.statistics import estimate
from desim.scenario.players import Team
from desim.scenario.scenario import Scenario
from desim.simulation.run import run
from desim.study.results.costs import AS_IT_IS, IDEAL
from desim.study.results.figures import (
    _label_outer,
    _mark_common_value,
    _without_overlap,
    is_wide,
    legend,
    means,
    multiples,
)
from desim.study.results.heat_maps import INK, _cell_format, _cell_text, phase
from desim.study.results.result import SweepResult
from desim.study.results.runs import Group
from desim.study.results.waterfalls import draw_waterfall
from desim.study.store.run_table import Row
from tests.summaries import changed

RUN = summary(run(Scenario(horizon=0.05, team=Team(count=2))))


def result(grid, runs=3, name="a <b> & $c$"):
    """Return a sweep in which the active time of configuration k is k, k + 1, ... s, without captures."""
    groups = []
    for k, values in enumerate(product(*grid.values())):
        rows = [Row(r, r, "ok", changed(RUN, active_time=float(k + r), capture_time=None)) for r in range(runs)]
        groups.append(Group(dict(zip(grid, values, strict=True)), tuple(rows)))
    return SweepResult(name, tuple(grid), tuple(groups))


def drawn(grid, metric="active_time", **options):
    """Return the axes of a picture, and the points and error bars of each line in it."""
    (axes,) = means(result(grid, **options), metric).axes
    return axes, [container.lines[0] for container in axes.containers]


def legend_of(axes):
    (legend,) = axes.figure.legends
    return legend


def ticks(axis):
    return dict(zip([text.get_text() for text in axis.get_ticklabels()], axis.get_ticklocs(), strict=True))


@pytest.mark.slow
def test_one_key_is_a_line_over_its_values():
    axes, (line,) = drawn({"horizon": [1.0, 2.0, 5.0]})
    assert line.get_xdata().tolist() == [1.0, 2.0, 5.0]
    assert line.get_ydata().tolist() == [1.0, 2.0, 3.0]
    assert ticks(axes.xaxis) == {"1": 1.0, "2": 2.0, "5": 5.0}
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("horizon (s)", "active time (s)")
    assert axes.get_title() == r"a <b> & \$c\$, 95 % intervals"
    assert axes.get_legend() is None
    assert not axes.figure.legends


@pytest.mark.slow
def test_the_points_of_a_difference_from_an_end_of_the_axis_stand_within_it():
    """The reference has a tick and no points: the axis reaches beyond it, and beyond the points at its other end."""
    figure = means(result({"horizon": [1.0, 2.0], "prune": ["inf", "none"]}), "active_time", against={"horizon": 1.0})
    (axes,) = figure.axes
    xs = [x for container in axes.containers for x in container.lines[0].get_xdata().tolist()]
    low, high = axes.get_xlim()
    assert low < 0.96
    assert high > 2.04 > max(xs) > 2.0


@pytest.mark.slow
def test_error_bars_are_intervals():
    """Of k, k + 1, k + 2: 4.303 / sqrt(3) = 2.484 to either side."""
    axes, _ = drawn({"horizon": [1.0, 2.0]})
    (bars,) = axes.containers[0].lines[2]
    assert [segment[:, 1].tolist() for segment in bars.get_segments()] == [
        pytest.approx([mean - 2.484, mean + 2.484], abs=1e-3) for mean in (1.0, 2.0)
    ]


@pytest.mark.slow
def test_values_out_of_order_are_drawn_from_left_to_right():
    _, (line,) = drawn({"horizon": [5.0, 1.0, 2.0]})
    assert line.get_xdata().tolist() == [1.0, 2.0, 5.0]
    assert line.get_ydata().tolist() == [2.0, 3.0, 1.0]


@pytest.mark.slow
def test_the_other_key_makes_lines_whose_error_bars_stand_side_by_side():
    axes, lines = drawn({"network.range": [1.0, 2.0], "prune": ["inf", "none", "infeasible"]})
    places = np.array([line.get_xdata() for line in lines])
    assert (np.diff(places, axis=0) > 0.0).all()
    assert places.mean(axis=0) == pytest.approx([1.0, 2.0])
    assert np.ptp(places[:, 0]) < 0.05
    legend = legend_of(axes)
    assert legend.get_title().get_text() == "prune"
    assert [text.get_text() for text in legend.get_texts()] == ["inf", "none", "infeasible"]
    assert len({line.get_color() for line in lines}) == 3


@pytest.mark.slow
def test_lines_over_several_other_keys_are_named_by_all_of_them():
    axes, lines = drawn({"prune": ["inf", "none"], "network.range": [1.0, 2.0], "motion.static": [True, False]})
    assert len(lines) == 4
    assert legend_of(axes).get_texts()[0].get_text() == "prune = inf, motion.static = true"
    assert axes.get_xlabel() == "network.range (m)"


@pytest.mark.slow
def test_many_lines_look_different():
    _, lines = drawn({"network.range": [1.0, 2.0], "prune": [str(k) for k in range(20)]})
    assert len({(line.get_color(), line.get_marker()) for line in lines}) == 20
    assert len({line.get_marker() for line in lines[:5]}) == 5, "in grey, too"


@pytest.mark.slow
def test_infinity_stands_to_the_right_of_all():
    axes, (line,) = drawn({"network.range": [4.0, inf, 8.0]})
    assert ticks(axes.xaxis) == pytest.approx({"4": 4.0, "8": 8.0, "inf": 8.8})
    assert line.get_ydata().tolist() == [1.0, 3.0, 2.0]


@pytest.mark.slow
def test_one_value_and_infinity_are_apart():
    axes, _ = drawn({"network.range": [inf, 4.0]})
    assert ticks(axes.xaxis) == {"4": 4.0, "inf": 5.0}


def test_a_label_is_left_out_where_it_would_touch_the_one_before_or_the_last():
    axes = Figure(figsize=(4.0, 3.0)).add_subplot()
    for values, kept in (
        ([0, 5, 10], [0, 5, 10]),
        ([0, 5, 5.2, 10], [0, 5, 10]),
        ([0, 0.1, 5, 10], [0, 5, 10]),
        ([0, 5, 9.9, 10], [0, 5, 10]),
        ([3], [3]),
    ):
        assert _without_overlap(axes, values, {value: float(value) for value in values}) == kept


@pytest.mark.slow
def test_values_of_several_magnitudes_are_equally_far_apart_with_0_and_infinity_at_the_ends():
    """From 0.01 to 10 three decades: a fifth of them, 0.6, lies before and after."""
    axes, (line,) = drawn({"x": [0.0, 0.01, 0.1, 1.0, 10.0, inf]})
    assert ticks(axes.xaxis) == pytest.approx({"0": -2.6, "0.01": -2.0, "0.1": -1.0, "1": 0.0, "10": 1.0, "inf": 1.6})
    assert line.get_xdata() == pytest.approx([-2.6, -2.0, -1.0, 0.0, 1.0, 1.6])


@pytest.mark.slow
@pytest.mark.parametrize("values", [[float(k) for k in range(30)], [-100.0, 0.1, 1.0, 10.0], [1.0, 25.0], [0.0, 0.5]])
def test_other_values_are_drawn_as_they_are(values):
    _, (line,) = drawn({"x": values})
    assert line.get_xdata().tolist() == values


@pytest.mark.slow
def test_not_every_one_of_many_values_has_a_tick():
    axes, _ = drawn({"x": [float(k) for k in range(30)]})
    assert len(axes.get_xticks()) < 12
    axes, _ = drawn({"x": [*(float(k) for k in range(30)), inf]})
    assert len(axes.get_xticks()) == 8
    assert {"0", "inf"} < ticks(axes.xaxis).keys()


LABELS = {"labels": ["sap", "best_response"], "truths": [True, False], "one number": [3.0], "infinity": [inf]}


@pytest.mark.slow
@pytest.mark.parametrize("values", LABELS.values(), ids=LABELS)
def test_values_that_are_not_numeric_are_rows_with_the_first_on_top(values):
    axes, (line,) = drawn({"x": values, "y": ["a", "b"]})
    assert line.get_xdata().tolist() == [k + 1.0 for k in range(2 * len(values))]
    assert list(ticks(axes.yaxis))[1].endswith(", b")
    assert axes.get_ylim()[0] > axes.get_ylim()[1]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("active time (s)", "x, y")


@pytest.mark.slow
def test_more_rows_make_a_higher_picture():
    heights = [means(result({"x": [str(k) for k in range(n)]}), "active_time").get_size_inches()[1] for n in (1, 10)]
    assert heights[1] > 2.0 * heights[0]


@pytest.mark.parametrize(
    ("values", "wide"),
    [
        ([1.0, 24.0, 30.0, 100.0], True),  # the second of four is below a quarter of the largest
        ([1.0, 26.0, 30.0, 100.0], False),
        ([1.0, 24.0, 30.0, 40.0, 100.0], True),
        ([10.0, 24.0, 30.0, 199.0], False),
        ([0.0, 1.0, 100.0], False),
        ([0.0, 1.0, 2.0, 100.0], True),
        ([-1.0, 1.0, 2.0, 100.0], False),
    ],
)
def test_an_axis_is_logarithmic_if_the_lower_half_is_below_a_quarter_of_the_largest(values, wide):
    assert is_wide(values) == wide


@pytest.mark.slow
def test_a_figure_of_more_lines_is_higher_by_its_legend():
    heights = [
        means(result({"x": [1.0, 2.0], "y": [f"value {k}" for k in range(n)]}), "active_time").get_size_inches()[1]
        for n in (1, 9)
    ]
    assert heights[1] > heights[0]


GRIDS = {
    "numbers": ({"x": [1.0, 2.0], "y": ["$a_$", "b"]}, "active_time"),
    "labels": ({"x": ["<lambda>", "$a$ & b"]}, "capture_time"),
    "infinity": ({"x": [1.0, inf]}, "active_time"),
}


@pytest.mark.slow
@pytest.mark.parametrize(("grid", "metric"), GRIDS.values(), ids=GRIDS)
def test_a_figure_of_single_runs_or_of_unmeasured_metrics_can_be_saved(tmp_path, grid, metric):
    for path in save(means(result(grid, runs=1), metric), tmp_path / "x"):
        assert path.stat().st_size > 1000


@pytest.mark.slow
def test_names_are_drawn_as_they_are():
    """matplotlib hides lines whose name begins with an underscore, and reads $..$ as mathematics."""
    axes, _ = drawn({"x": [1.0, 2.0], "y": ["_own", "$a_$"]})
    assert [each.get_text() for each in legend_of(axes).get_texts()] == [" _own", r"\$a_\$"]


@pytest.mark.slow
def test_unmeasured_values_are_not_drawn():
    _, (line,) = drawn({"x": [1.0, 2.0]}, "capture_time")
    assert len(line.get_ydata()) == 2
    assert all(map(isnan, line.get_ydata()))


@pytest.mark.slow
def test_a_metric_without_a_unit_has_none():
    axes, _ = drawn({"x": [1.0, 2.0]}, "switches")
    assert axes.get_ylabel() == "switches"


# Several metrics.


def test_panels_at_the_left_and_at_the_bottom_have_the_names_of_the_axes():
    """Three panels in two columns: the second has none below it, and the place of the fourth is empty."""
    shared = Figure().subplots(2, 2, squeeze=False)
    _label_outer(shared, 3, "x", "y")
    assert [axes.get_xlabel() for axes in shared.flat] == ["", "x", "x", "x"]
    assert [axes.get_ylabel() for axes in shared.flat] == ["y", "", "y", ""]
    assert [axes.axison for axes in shared.flat] == [True, True, True, False]


@pytest.mark.slow
def test_panels_side_by_side_share_the_names_of_their_axes():
    grid = {"x": [1.0, 2.0], "prune": ["inf", "none"], "motion.static": [True, False]}
    figure = means(result(grid, runs=1), "active_time", x="x", by="prune")
    assert [axes.get_ylabel() for axes in figure.axes] == ["active time (s)", ""]
    assert [axes.get_xlabel() for axes in figure.axes] == ["x", "x"]


@pytest.mark.whole
def test_small_panels_show_what_the_pictures_of_each_metric_show():
    grid, metrics = {"horizon": [1.0, 2.0], "prune": ["inf", "none"]}, ["active_time", "switches", "end_time", "energy"]
    figure = multiples(result(grid), metrics)
    assert len(figure.axes) == 6  # of which two are empty
    assert [axes.axison for axes in figure.axes] == [True] * 4 + [False] * 2
    for axes, metric in zip(figure.axes, metrics, strict=False):
        alone, lines = drawn(grid, metric)
        assert axes.get_title(loc="left") == alone.get_ylabel()
        here = [container.lines[0] for container in axes.containers]
        assert [line.get_xydata().tolist() for line in here] == [line.get_xydata().tolist() for line in lines]
        assert axes.get_legend() is None
    (legend,) = figure.legends
    assert legend.get_title().get_text() == "prune"
    assert [each.get_text() for each in legend.get_texts()] == ["inf", "none"]
    assert [axes.get_xlabel() for axes in figure.axes] == ["", *["horizon (s)"] * 3, "", ""]


@pytest.mark.whole
@pytest.mark.parametrize("size", [1, 9])
def test_the_legend_of_small_panels_is_within_the_picture(size):
    others = {"network.range": [float(k) for k in range(size)], "announce.payload": ["action", "state"]}
    figure = multiples(result({"x": [1.0, 2.0]} | others), ["active_time"])
    box = figure.legends[0].get_window_extent()
    assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
    assert figure.bbox.y0 <= box.y0
    assert box.y1 < figure.axes[0].get_window_extent().y0
    assert figure.axes[0].get_window_extent().height > 60


@pytest.mark.slow
def test_the_legend_of_a_page_is_as_wide_as_its_lines():
    """A page shrinks a picture that is wider than itself, and with it the text."""
    figure = legend(result({"x": [1.0, 2.0], "prune": ["inf", "none"]}))
    figure.draw_without_rendering()
    box = figure.legends[0].get_window_extent()
    assert figure.bbox.width == pytest.approx(box.width, abs=1.0)
    assert figure.get_figwidth() < 2.5
    assert box.x0 == pytest.approx(0.0, abs=1.0)


@pytest.mark.slow
def test_small_panels_over_no_number_have_a_row_per_configuration():
    figure = multiples(result({"prune": ["inf", "none"]}), ["active_time", "switches"])
    assert not figure.legends
    assert [axes.get_ylabel() for axes in figure.axes] == ["prune", ""]
    assert list(ticks(figure.axes[0].yaxis)) == ["inf", "none"]
    assert [each.label2.get_visible() or each.label1.get_visible() for each in figure.axes[1].yaxis.majorTicks] == [
        False
    ] * 2


@pytest.mark.slow
def test_panels_of_rows_have_common_rows_and_panels_over_a_number_have_scales_of_their_own():
    rows = multiples(result({"prune": ["inf", "none"]}), ["active_time", "switches"])
    assert rows.axes[0].get_shared_y_axes().joined(*rows.axes)
    lines = multiples(result({"x": [1.0, 2.0]}), ["active_time", "switches"])
    assert not lines.axes[0].get_shared_y_axes().joined(*lines.axes)


@pytest.mark.parametrize(("value", "limits"), [(2.0, (-0.1, 2.1)), (-2.0, (-2.1, 0.1)), (0.0, (-0.05, 1.05))])
def test_the_only_value_of_a_metric_is_drawn_with_0(value, limits):
    """0 and the value lie within the scale, whatever the sign: with a twentieth beyond at least one of them."""
    axes = Figure().subplots()
    _mark_common_value(axes, value)
    low, high = axes.get_ylim()
    assert low <= min(value, 0.0) <= max(value, 0.0) <= high
    assert (low, high) == pytest.approx((min(value, 0.0) - 0.05, min(value, 0.0) + 1.05 * (abs(value) or 1.0)))
    assert list(ticks(axes.yaxis).values()) == [value]


def test_the_only_value_of_a_metric_may_be_infinite():
    axes = Figure().subplots()
    _mark_common_value(axes, inf)
    assert [text.get_text() for text in axes.texts] == ["inf in every run"]


def test_a_waterfall_has_a_bar_and_a_name_for_each_step_between_both_ends():
    """The steps go from the ideal 2 to 3.5; the last bar stands beside the last step."""
    ideal, loss, near, both, whole = (estimate([v - 0.1, v, v + 0.1]) for v in (2.0, 1.0, 0.25, 0.25, 3.5))
    cost: Any = SimpleNamespace(
        label="idle time",
        unit="s",
        ideal=ideal,
        as_it_is=whole,
        parts={"loss": SimpleNamespace(mean=loss), "range": SimpleNamespace(mean=near)},
        interaction=SimpleNamespace(mean=both),
        bounds=None,
        more_is="worse",
    )
    axes = Figure().subplots()
    draw_waterfall(axes, cost)
    assert [bar.get_x() + bar.get_width() / 2 for bar in axes.patches] == pytest.approx([0.0, 4.0, 1.0, 2.0, 3.0])
    assert [text.get_text() for text in axes.get_xticklabels()] == [IDEAL, "loss", "range", "interaction", AS_IT_IS]
    assert axes.get_xticks().tolist() == [0, 1, 2, 3, 4]
    assert axes.get_ylabel() == "idle time (s)"
    assert [bar.get_y() for bar in axes.patches] == pytest.approx([0.0, 0.0, 2.0, 3.0, 3.25])


def test_there_are_no_panels_of_nothing():
    with pytest.raises(ValueError, match="at least one metric"):
        multiples(result({"x": [1.0, 2.0]}), [])


# Heat maps.


def written(axes):
    """Return the text of each cell of a map, by place."""
    return {tuple(each.get_position()): each.get_text() for each in axes.texts}


@pytest.mark.slow
def test_a_phase_diagram_has_the_mean_of_each_configuration_at_its_place():
    """Of k, k + 1, k + 2, the mean is k + 1; the last key changes fastest, and values are sorted."""
    figure = phase(result({"x": [2.0, 1.0], "prune": ["inf"], "y": [4.0, inf, 3.0]}), "active_time")
    axes, bar = figure.axes
    assert bar.get_ylabel() == "active time (s)"
    figure.draw_without_rendering()
    (solids,) = (part for part in bar.collections if isinstance(part, QuadMesh))
    assert solids.get_edgecolor().tolist() == solids.get_facecolor().tolist()  # no page shows between its parts
    assert ticks(axes.xaxis) == {"1": 0, "2": 1}
    assert ticks(axes.yaxis) == {"3": 0, "4": 1, "inf": 2}
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title()) == ("x", "y", "prune = inf")
    assert written(axes) == {
        place: f"{value}.00"
        for place, value in {(1, 1): 1, (1, 2): 2, (1, 0): 3, (0, 1): 4, (0, 2): 5, (0, 0): 6}.items()
    }


@pytest.mark.slow
def test_a_phase_diagram_has_a_panel_per_combination_of_the_other_keys_in_equal_colours():
    figure = phase(result({"prune": ["inf", "none"], "x": [1.0, 2.0], "y": [1.0, 2.0]}), "active_time")
    one, other, _ = figure.axes
    assert [one.get_title(), other.get_title()] == ["prune = inf", "prune = none"]
    assert written(other)[0, 0] == "5.00"
    configurations = [each for axes in (one, other) for each in zip(axes.texts, axes.patches, strict=True)]
    faces = [patch.get_facecolor() for _, patch in sorted(configurations, key=lambda each: float(each[0].get_text()))]
    light = [0.299 * red + 0.587 * green + 0.114 * blue for red, green, blue, _ in faces]
    assert len(set(light)) == 8
    assert light == sorted(light)


@pytest.mark.slow
def test_contours_leave_out_points_at_infinity():
    axes = result({"x": [0.0, 1.0, inf], "y": [0.0, 2.0]}).plot(kind="contour").axes[0]
    (points,) = axes.lines
    assert sorted(map(tuple, points.get_xydata().tolist())) == [(0.0, 0.0), (0.0, 2.0), (1.0, 0.0), (1.0, 2.0)]


@pytest.mark.slow
def test_text_on_a_dark_cell_is_light():
    axes = phase(result({"x": [1.0, 2.0], "y": [1.0, 2.0]}), "active_time").axes[0]
    for patch, each in zip(axes.patches, axes.texts, strict=True):
        red, green, blue, _ = patch.get_facecolor()
        light = 0.299 * red + 0.587 * green + 0.114 * blue
        assert each.get_color() == ("white" if light < 0.5 else INK)
    assert {each.get_color() for each in axes.texts} == {"white", INK}


@pytest.mark.slow
def test_an_unmeasured_value_is_a_dash_in_a_phase_diagram():
    axes = phase(result({"x": [1.0, 2.0], "y": [1.0, 2.0]}), "capture_time").axes[0]
    assert set(written(axes).values()) == {"-"}
    assert {patch.get_facecolor()[3] for patch in axes.patches} == {0.0}


@pytest.mark.slow
@pytest.mark.parametrize(("panels", "size"), [(1, 3), (3, 8)])
def test_the_text_of_a_cell_fits_into_it(panels, size):
    """Values of up to 20,000, and panels of one width beside each other."""
    grid = {"prune": [str(k) for k in range(panels)], "x": [k + 0.125 for k in range(size)], "y": [1.0, 2.0]}
    found = result(grid)
    many = tuple(
        replace(
            group, rows=tuple(replace(row, summary=changed(row.summary, active_time=1e4 + k)) for row in group.rows)
        )
        for k, group in enumerate(found.groups)
    )
    figure = phase(replace(found, groups=many), "active_time")
    figure.draw_without_rendering()
    assert figure.get_size_inches()[0] <= 9.4
    for axes in figure.axes:
        if not axes.axison:
            continue
        width = axes.get_window_extent().width / size
        assert all(each.get_window_extent().width < 0.95 * width for each in axes.texts)
        ticks = [each.get_window_extent() for each in axes.get_xticklabels() if each.get_visible()]
        assert all(one.x1 < other.x0 for one, other in pairwise(ticks))
    assert {each.get_text() for each in figure.axes[0].texts} >= {"10,000", "10,001"}


def test_a_phase_diagram_needs_two_numbers():
    with pytest.raises(ValueError, match="two keys that take several numbers, there are 1"):
        phase(result({"x": [1.0, 2.0], "prune": ["inf", "none"], "y": [3.0]}), "active_time")


GRID = {"protocol": ["sap", "cbba"], "x": [1.0, 2.0, 4.0], "y": [10.0, 20.0]}


@pytest.mark.slow
def test_a_key_names_the_lines_and_the_others_make_panels_of_the_same_scale():
    figure = means(result(GRID), "active_time", x="x", by="protocol")
    left, right = figure.axes
    assert [axes.get_title() for axes in figure.axes] == ["y = 10", "y = 20"]
    assert left.get_ylim() == right.get_ylim()
    assert (left.get_ylabel(), right.get_ylabel()) == ("active time (s)", "")
    assert [each.lines[0].get_ydata().tolist() for each in left.containers] == [[1.0, 3.0, 5.0], [7.0, 9.0, 11.0]]
    (box,) = figure.legends
    assert [each.get_text() for each in box.get_texts()] == ["sap", "cbba"]
    assert box.get_title().get_text() == "protocol"


@pytest.mark.slow
def test_the_abscissa_may_be_any_key():
    axes, _ = drawn(GRID)
    assert axes.get_xlabel() == "x"
    (axes,) = means(result(GRID), "active_time", x="y").axes
    assert axes.get_xlabel() == "y"
    assert len(axes.containers) == 6
    (axes,) = means(result(GRID), "active_time", x="protocol").axes
    assert ticks(axes.xaxis) == {"sap": 0.0, "cbba": 1.0}
    assert {each.lines[0].get_linestyle() for each in axes.containers} == {"None"}, "there is nothing between them"


@pytest.mark.slow
@pytest.mark.parametrize(("value", "step"), [("sap", 6.0), ("cbba", -6.0)])
def test_differences_are_from_any_value_of_any_key_and_paired(value, step):
    """Run k of cbba is 6 s longer than that of sap with equal x and y, so no difference has a width."""
    (axes,) = means(result(GRID), "active_time", x="x", against={"protocol": value}).axes
    assert axes.get_ylabel() == f"difference in active time from protocol = {value} (s)"
    assert [each.lines[0].get_ydata().tolist() for each in axes.containers] == [[step] * 3] * 2
    other = {"sap": "cbba", "cbba": "sap"}[value]
    assert [each.get_text() for each in legend_of(axes).get_texts()] == [
        f"protocol = {other}, y = {y}" for y in (10, 20)
    ]


@pytest.mark.slow
def test_a_line_has_the_same_colour_with_and_without_a_reference():
    (plain,), (compared,) = (
        means(result(GRID), "active_time", x="x", against=each).axes for each in (None, {"protocol": "sap"})
    )
    assert [each.lines[0].get_color() for each in plain.containers[2:]] == [
        each.lines[0].get_color() for each in compared.containers
    ]


@pytest.mark.slow
def test_differences_may_be_from_one_configuration():
    found = result(GRID)
    reference = {"protocol": "sap", "x": "2", "y": 10.0}
    assert found.references(reference) == [2] * 12
    assert [each.mean for each in found.differences("active_time", reference)] == [k - 2.0 for k in range(12)]
    (axes,) = means(found, "active_time", x="x", against=reference).axes
    assert axes.containers[0].lines[0].get_xdata().tolist() == pytest.approx([1.0, 4.0], abs=0.1), "without itself"


@pytest.mark.slow
def test_texts_of_the_user_are_shown_and_may_be_mathematics():
    options = {"labels": {"sap": "SAP (ours)", "10": "$L_1$"}, "xlabel": "latency $L$", "ylabel": "T_0"}
    (axes,) = means(result(GRID), "active_time", x="x", **options).axes
    assert [each.get_text() for each in legend_of(axes).get_texts()][:2] == [
        "SAP (ours), $L_1$",
        "SAP (ours), y = 20",
    ]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("latency $L$", "T_0")


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"x": "x", "by": "protocol"}, {}, {"against": {"protocol": "sap"}}])
def test_a_figure_made_narrower_keeps_its_labels(options):
    figure = means(result(GRID, name="a sweep with a long name"), "active_time", **options)
    figure.set_size_inches(3.5, 2.5)
    figure.draw_without_rendering()
    width, height = figure.bbox.size
    for axes in figure.axes:
        for text in (axes.xaxis.label, axes.yaxis.label, axes.title):
            box = text.get_window_extent()
            assert 0 <= box.x0 <= box.x1 <= width
            assert 0 <= box.y0 <= box.y1 <= height


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["$\\frac{}$ of a name that is too long for a narrow figure", "costs $5 and more " * 5]
)
def test_a_name_with_dollars_is_shown_as_it_is_at_any_size(name):
    figure = means(result(GRID, name=name), "active_time")
    figure.set_size_inches(3.5, 2.5)
    figure.draw_without_rendering()
    assert figure.axes[0].get_title() == as_it_is(f"{name}, 95 % intervals")


@pytest.mark.slow
def test_a_figure_of_a_given_size_has_it_and_no_title():
    figure = means(result(GRID), "active_time", size="8.5cmx6cm")
    assert (figure.get_size_inches() * 2.54).tolist() == pytest.approx([8.5, 6.0])
    assert figure.axes[0].get_title() == ""


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"x": "protocl"}, "the grid has no key protocl, did you mean protocol"),
        ({"by": "z"}, "the grid has no key z"),
        ({"against": {"protocol": "spa"}}, "protocol does not take the value spa: it takes sap, cbba"),
        ({"labels": {"spa": "SAP"}}, "no key takes the value spa"),
        ({"x": "x", "by": ["x"]}, "`x` and `by` should be different keys"),
        ({"size": "wide"}, "got 'wide'"),
    ],
)
def test_an_option_that_does_not_fit_the_sweep_is_refused(options, why):
    with pytest.raises(ValueError, match=why):
        means(result(GRID), "active_time", **options)


@pytest.mark.slow
def test_a_kind_that_one_value_has_names_it_and_a_key_can_be_renamed():
    slow, fast = (f"sap(slot={each})" for each in (0.2, 0.1))
    alone, both = (result({"protocol": each, "x": [1.0, 2.0]}) for each in ([slow, "cbba", "cbaa"], [slow, fast]))
    figure = means(alone, "active_time", against={"protocol": "sap"}, labels={"protocol": "rule", "sap": "SAP"})
    assert figure.legends[0].get_title().get_text() == "rule"
    for options in ({"against": {"protocol": "sap"}}, {"labels": {"sap": "SAP"}}):
        with pytest.raises(ValueError, match=r"several values .* kind sap.*sap\(slot=0.1\)"):
            means(both, "active_time", **options)
    with pytest.raises(ValueError, match="a reference should be a mapping"):
        both.differences("active_time", "protocol=sap")
    with pytest.raises(ValueError, match="against should be a dict"):
        both.plot(against=["protocol=sap"])
    with pytest.raises(ValueError, match="size should be a width"):
        both.plot(size=(8.5, 6.0))
    with pytest.raises(TypeError, match="unexpected keyword argument 'label'"):
        both.plot(label={"sap": "SAP"})


@pytest.mark.slow
def test_the_label_of_a_value_is_not_that_of_other_values_of_its_kind():
    found = result({"protocol": ["sap", "sap(tau=1)"], "x": [1.0, 2.0]})
    (axes,) = means(found, "active_time", x="x", labels={"sap": "SAP"}).axes
    assert [each.get_text() for each in legend_of(axes).get_texts()] == ["SAP", "sap(tau=1)"]


@pytest.mark.parametrize(
    ("values", "cells"),
    [
        ([8.1, 8.19], ["8.10", "8.19"]),
        ([998.9, 5.04], ["999", "5"]),
        ([-1234.5, 0.0], ["-1,234", "0"]),
        ([100.0, 0.02], ["100.00", "0.02"]),
        ([0.00021, 0.1], ["2.10e-04", "1.00e-01"]),
        ([0.0, inf], ["0", "-"]),
    ],
)
def test_the_cells_of_a_heat_map_have_one_format_in_which_only_0_looks_like_0(values, cells):
    form = _cell_format([value for value in values if value != inf])
    assert [_cell_text(value, form) for value in values] == cells


def test_a_configuration_without_a_reference_is_named():
    found = result({"protocol": ["sap", "cbba"], "x": [1.0, 2.0]})
    with pytest.raises(ValueError, match="protocol = cbba, x = 2: has no reference with protocol = sap"):
        means(replace(found, groups=(found.groups[0], *found.groups[2:])), "active_time", against={"protocol": "sap"})


# What must not mislead.


def boxes_of_data(axes):
    """Return what is drawn on axes, in pixels: the points of each line, and the ends of error bars."""
    yield from (axes.transData.transform(line.get_xydata()) for line in axes.lines)
    for container in axes.containers:
        for bars in container.lines[2]:
            yield from (axes.transData.transform(segment) for segment in bars.get_segments())


SIZES = {"usual": None, "column": "8.5cm", "square": "8.5cmx8.5cm", "wide": "17cmx6cm"}


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, 6, 9])
@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_a_legend_is_not_on_data_and_within_the_figure(size, count):
    grid = {"x": [1.0, 2.0, 5.0], "a_key_with_a_name": [f"value {k}" for k in range(count)]}
    figure = means(result(grid), "active_time", size=size)
    (axes,) = figure.axes
    box = figure.legends[0].get_window_extent()
    for points in boxes_of_data(axes):
        assert not any(box.contains(*point) for point in points)
    assert box.y1 <= axes.get_window_extent().y0
    assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
    assert figure.bbox.y0 <= box.y0


def test_a_line_is_named_also_if_it_is_the_only_one():
    (axes,) = means(
        result({"x": [1.0, 2.0], "protocol": ["sap", "cbaa"]}), "active_time", against={"protocol": "sap"}
    ).axes
    assert [text.get_text() for text in legend_of(axes).get_texts()] == ["cbaa"]
    assert legend_of(axes).get_title().get_text() == "protocol"


@pytest.mark.slow
def test_the_reference_has_its_label_in_the_label_of_the_axis():
    swept = result({"x": [1.0, 2.0], "protocol": ["sap(rate=5)", "cbaa"]})
    options = {"against": {"protocol": "sap"}, "labels": {"sap": "SAP (ours)"}}
    (axes,) = means(swept, "active_time", **options).axes
    assert axes.get_ylabel() == "difference in active time from SAP (ours) (s)"


@pytest.mark.slow
def test_a_reference_of_several_keys_is_named_with_them():
    """A label of a value alone, such as "unlimited, 0", would not say what is 0."""
    swept = result({"x": [0.0, 2.0], "protocol": ["sap", "cbaa"]})
    options = {"against": {"protocol": "sap", "x": 0.0}, "labels": {"sap": "SAP (ours)", "x": "loss"}}
    (axes,) = means(swept, "active_time", x="protocol", **options).axes
    assert axes.get_ylabel() == "difference in active time from protocol = SAP (ours), loss = 0 (s)"


@pytest.mark.slow
def test_a_metric_that_is_equal_in_every_run_has_no_scale_around_it():
    swept = result({"x": [1.0, 2.0], "protocol": ["sap", "cbaa"]})
    zero = [
        replace(group, rows=tuple(replace(row, summary=changed(row.summary, idle_time=0.0)) for row in group.rows))
        for group in swept.groups
    ]
    for figure in (
        means(replace(swept, groups=tuple(zero)), "idle_time"),
        multiples(replace(swept, groups=tuple(zero)), ["idle_time"]),
    ):
        axes = figure.axes[0]
        assert ticks(axes.yaxis) == {"0": 0.0}
        assert axes.get_ylim()[1] >= 1.0
        assert [text.get_text() for text in axes.texts] == ["0 in every run"]
    (axes,) = means(swept, "active_time").axes
    assert not axes.texts
    assert len(axes.get_yticks()) > 2


def test_figures_without_a_legend_share_one():
    swept = result({"x": [1.0, 2.0], "protocol": ["sap", "cbaa"]})
    figure = multiples(swept, ["active_time"], has_legend=False)
    assert not figure.legends
    (shared,) = legend(swept).legends
    assert [text.get_text() for text in shared.get_texts()] == ["sap", "cbaa"]
    assert [handle.get_color() for handle in shared.get_lines()] == [
        container.lines[0].get_color() for container in figure.axes[0].containers
    ]
    assert legend(result({"x": [1.0, 2.0]})) is None
    assert legend(result({"prune": ["inf", "none"]})) is None


@pytest.mark.slow
def test_tick_labels_do_not_touch():
    figure = means(result({"x": [0.0, 0.05, 0.1, 0.2, 0.5, 1.0]}), "active_time", size="8.5cm")
    boxes = [text.get_window_extent() for text in figure.axes[0].get_xticklabels()]
    assert all(before.x1 < after.x0 for before, after in pairwise(boxes))
    assert {"0", "1"} < ticks(figure.axes[0].xaxis).keys()


# Axes of the user.


def two_axes():
    figure = Figure(figsize=(8, 3), layout="constrained")
    return figure, figure.subplots(1, 2)


DRAWN = {
    "means": lambda swept, ax: swept.plot("active_time", ax=ax),
    "differences": lambda swept, ax: swept.plot("active_time", against={"protocol": "sap"}, ax=ax),
    "phase": lambda swept, ax: replace(swept, keys=("x", "y"), groups=swept.groups[:6]).plot(kind="phase", ax=ax),
}


@pytest.mark.slow
@pytest.mark.parametrize("draw", DRAWN.values(), ids=DRAWN)
def test_a_figure_is_drawn_on_given_axes_and_nowhere_else(draw):
    figure, (left, right) = two_axes()
    assert draw(result(GRID), left) is figure
    assert left.has_data()
    assert not right.has_data()
    assert figure.get_size_inches().tolist() == [8, 3]
    assert not figure.legends
    figure.draw_without_rendering()
    if box := left.get_legend():
        assert box.get_window_extent().y0 >= left.get_window_extent().y1


WRONG_AXES = {
    "figure": (lambda: Figure(), TypeError, r"got Figure; ax=figure.add_subplot\(\)"),
    "several": (lambda: two_axes()[1], TypeError, r"got ndarray; give one of them, such as ax=axes\[0\]"),
    "list": (lambda: list(two_axes()[1]), TypeError, "got list; give one of them"),
    "text": (lambda: "left", TypeError, "got str$"),
    "truth": (lambda: True, TypeError, "got bool$"),
    "polar": (lambda: Figure().add_subplot(projection="polar"), ValueError, "plain axes, not polar ones"),
}


@pytest.mark.slow_cases("several")
@pytest.mark.parametrize(("make", "error", "message"), WRONG_AXES.values(), ids=WRONG_AXES)
def test_wrong_axes_are_refused(make, error, message):
    swept = result(GRID)
    for kind in ("means", "phase"):
        with pytest.raises(error, match=message):
            replace(swept, keys=("x", "y"), groups=swept.groups[:6]).plot(kind=kind, ax=make())


def test_what_does_not_fit_into_axes_is_refused():
    swept = result(GRID)
    _, (ax, _) = two_axes()
    with pytest.raises(ValueError, match=r"ax is one panel, and there are 2 \(y = 10; y = 20\)"):
        swept.plot(x="x", by="protocol", ax=ax)
    with pytest.raises(ValueError, match="size is that of a new figure"):
        swept.plot(size="8.5cm", ax=ax)
    assert not ax.has_data()
    with pytest.raises(ValueError, match="phase has no option 'by'"):
        swept.plot(kind="phase", by="protocol")
    with pytest.raises(ValueError, match=r"style: .*seaborn-v9"):
        swept.plot(style="seaborn-v9")


@pytest.mark.slow
def test_a_style_is_on_top_of_that_of_desim():
    (axes,) = result(GRID).plot(style={"axes.spines.top": True, "font.size": 13.0}).axes
    assert axes.spines["top"].get_visible()
    assert not axes.spines["right"].get_visible()
    assert axes.yaxis.label.get_fontsize() == 13.0

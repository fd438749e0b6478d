"""Figures as text, for golden files: all that is drawn, a line each, with its position and its style.

A golden text finds what tests of single parts miss: a colour, a mark, a label or an interval that changed by mistake.
It has no pixels, and nothing that a layout or the metrics of a font decide. The defaults of matplotlib are left out.
"""

from contextlib import contextmanager

import numpy as np
import pytest
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.colors import to_hex, to_rgba
from matplotlib.contour import ContourSet
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.quiver import Quiver
from matplotlib.text import Annotation
from matplotlib.ticker import FixedLocator

from desim.analysis.drawing import plots


@contextmanager
def without_layout():
    """Let figures of desim be made without their layout, which takes most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plots._StyledFigure, "draw_without_rendering", lambda _: None)
        patch.setattr(plots, "uncover_data", lambda _: False)
        yield


def described(figure) -> str:
    """Return what is on a figure of matplotlib in the units of its axes; where layout puts it is left out."""
    told = ["figure {:g} x {:g} in".format(*(round(length, 4) for length in figure.get_size_inches()))]
    told += [f"title {_written(title, 'center', 'top')}" for title in (figure._suptitle, figure._supylabel) if title]
    for axes in figure.axes:
        told += _axes(axes)
        for inset in axes.child_axes:
            told += ["inset", *_axes(inset)]
    told += [line for legend in figure.legends for line in _legend(legend)]
    return "\n".join(line.rstrip() for line in told)


def _axes(axes):
    yield f"axes{_place(axes)}"
    for side, title in (("left ", axes._left_title), ("", axes.title), ("right ", axes._right_title)):
        if title.get_text():
            yield f"title {side}{_written(title, title.get_ha(), 'baseline')}"
    if axes.axison:
        yield f"x {_axis(axes.xaxis)}"
        yield f"y {_axis(axes.yaxis)}"
    if names := axes.get_legend_handles_labels()[1]:
        yield f"names {names}"
    yield from map(line_of, axes.lines)
    yield from map(_collection, axes.collections)
    for image in axes.images:
        values = " ".join(_points([row]) for row in image.get_array())
        yield f"image {image.get_cmap().name} {_points([image.get_clim()])} {axes.get_aspect()}: {values}"
    for patch in axes.patches:
        path = patch.get_path().transformed(patch.get_patch_transform())
        points = path.vertices if isinstance(patch, PathPatch) else [path.get_extents().extents]
        yield f"patch{_name(patch)} {_area(patch)}: {_points(points)}"
    yield from map(text_of, axes.texts)
    if legend := axes.get_legend():
        yield from _legend(legend)


def _place(axes):
    """Return the place of axes among those of the figure, their aspect, and the lines around them, where unusual."""
    told, spec = "", axes.get_subplotspec()
    if spec is not None and spec.get_geometry()[:2] != (1, 1):
        rows, columns, first, _ = spec.get_geometry()
        grid = spec.get_gridspec()
        told += f" {first + 1} of {rows} x {columns}"
        for ratios in (grid.get_width_ratios(), grid.get_height_ratios()):
            told += f" as {_points([ratios])}" if len(set(ratios)) > 1 else ""
    told += f" aspect {axes.get_aspect():g}" if axes.get_aspect() != "auto" else ""
    if hasattr(axes, "_colorbar_info"):
        told += " of colours, fraction {fraction:g} pad {pad:g}".format(**axes._colorbar_info)
    if not axes.axison:
        return f"{told}, hidden"
    lines = [side for side in ("left", "bottom", "right", "top") if axes.spines[side].get_visible()]
    return told if lines == ["left", "bottom"] else f"{told}, lines: {' '.join(lines) or 'none'}"


def _axis(axis):
    """Return the label, the scale and the limits of an axis, and its ticks, with their places if these were chosen."""
    tick = axis.get_major_ticks(1)[0]
    label = tick.label2 if tick.label2.get_visible() else tick.label1
    look = _text_look(label, *(("center", "top") if axis.axis_name == "x" else ("right", "center_baseline")))
    look += "" if tick.tick1line.get_markersize() else " without marks"
    low, high = sorted(axis.get_view_interval())
    ticks = zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=False)  # no labels, if they are hidden
    shown = [(place, text.get_text()) for place, text in ticks if low <= place <= high]
    is_chosen = isinstance(axis.get_major_locator(), FixedLocator)
    shown = [f"{text!r} at {place:g}" if is_chosen else repr(text) for place, text in shown]
    name = f"{axis.label.get_text()!r} {_text_look(axis.label, axis.label.get_ha(), axis.label.get_va())}"
    name = name.replace(" turned 90 anchor", "")
    return f"{name}, {axis.get_scale()} {_points([axis.get_view_interval()])}, {look}: {', '.join(shown) or 'hidden'}"


def line_of(line):
    """Return a line and its marks as text."""
    return f"line{_name(line)} {_look(line)}: {_points(line.get_xydata())}"


def text_of(text):
    """Return a text on a figure as a line."""
    place = _points([text.xy if hasattr(text, "xy") else text.get_position()])
    if isinstance(text, Annotation):
        place += f" and {_points([text.xyann])} {text.anncoords}"
    elif text.axes is not None and text.get_transform() == text.axes.transAxes:
        place += " of the axes"
    return f"text {_written(text)}{' outlined' if text.get_path_effects() else ''}: {place}"


def _collection(many):
    if isinstance(many, Quiver):
        sizes = (
            many.width,
            many.headwidth,
            many.headlength,
            many.headaxislength,
            many.minshaft,
            many.minlength,
            many.scale,
        )
        units, arrows = f"{many.angles} {many.scale_units} {many.units}", np.column_stack([many.XY, many.U, many.V])
        return f"arrows {_colour(many.get_facecolor())} {_points([sizes])} {units} {_layer(many)}: {_points(arrows)}"
    if isinstance(many, LineCollection):
        segments = "; ".join(map(_points, many.get_segments()))
        return (
            f"segments{_name(many)} {_colour(many.get_color())} {many.get_linewidth()[0]:g} {_layer(many)}: {segments}"
        )
    if isinstance(many, QuadMesh | ContourSet):
        edges = many.get_edgecolor()
        edges = "as inside" if np.array_equal(edges, many.get_facecolor()) else _colour(edges)
        drawn = f"{many.get_cmap().name} {_points([many.get_clim()])} edges {edges} {_layer(many)}"
        if isinstance(many, QuadMesh):
            return f"colours {drawn}{' as pixels' if many.get_rasterized() else ''}"
        boxes = [path.get_extents().extents for path in many.get_paths() if len(path.vertices)]
        return f"bands {drawn} {_points([many.levels])}: {_points(boxes)}"
    return f"areas{_name(many)} {_area(many)}: {_points(path.get_extents().extents for path in many.get_paths())}"


def _legend(legend):
    """Yield the place and the title of a legend, and the look of each name in it."""
    texts, title = legend.get_texts(), legend.get_title()
    where = next(name for name, code in legend.codes.items() if code == legend._loc_real)
    look = f"{'outside ' if legend._outside_loc else ''}{where}, {legend._ncols} abreast, {texts[0].get_fontsize():g}"
    if legend._bbox_to_anchor is not None:
        at = legend.get_bbox_to_anchor().transformed(legend.axes.transAxes.inverted())
        look += f" at {_points([at.p0])} of the axes, {legend.borderaxespad:g} off"
    look += f" apart {legend.columnspacing:g}" if legend.columnspacing != 2.0 else ""
    look += " framed" if legend.get_frame_on() else ""
    yield f"legend {f'{_written(title, title.get_ha(), title.get_va())} ' if title.get_text() else ''}{look}"
    for handle, text in zip(legend.legend_handles, texts, strict=True):
        if isinstance(handle, LineCollection):  # of lines with error bars
            yield f"  {text.get_text()!r} {_colour(handle.get_color())}"
        else:
            yield f"  {text.get_text()!r} {_look(handle) if isinstance(handle, Line2D) else _area(handle)}"


def _written(text, ha=None, va=None):
    """Return a text with its look, but not with the alignment that it usually has."""
    return f"{text.get_text()!r} {_text_look(text, ha, va)}"


def _text_look(text, ha=None, va=None):
    """Return the size of a text, and what is unusual about it."""
    look = f"{text.get_fontsize():g}"
    look += "" if _colour(text.get_color()) == "#000000" else f" {_colour(text.get_color())}"
    look += "" if text.get_weight() == "normal" else f" {text.get_weight()}"
    look += f" turned {text.get_rotation():g} {text.get_rotation_mode()}" if text.get_rotation() else ""
    look += "" if (text.get_ha(), text.get_va()) == (ha, va) else f" {text.get_ha()} {text.get_va()}"
    look += " wrapped" if text.get_wrap() else ""
    look += "" if text.get_parse_math() else " literal"
    return look if text.get_zorder() == 3 else f"{look} {_layer(text)}"


def _look(line):
    """Return the look of a line and of its marks."""
    look = _layer(line)
    if line.get_linestyle() != "None":
        dashes = line._unscaled_dash_pattern[1]
        style = line.get_linestyle() if line.get_linestyle() != "--" else f"-- {_points([dashes])}"
        look += f" {_colour(line.get_color())} {style} {line.get_linewidth():g}"
        look += "" if line.get_gapcolor() is None else f" gaps {_colour(line.get_gapcolor())}"
        look += "" if line.get_drawstyle() == "default" else f" {line.get_drawstyle()}"
        look += "" if line.get_solid_capstyle() == "projecting" else f" {line.get_solid_capstyle()}"
    if line.get_marker() not in {"None", "", None}:
        faces = f"{_colour(line.get_markerfacecolor())} {_colour(line.get_markeredgecolor())}"
        look += f" {line.get_marker()} {line.get_markersize():g} {faces} {line.get_markeredgewidth():g}"
        look += "" if line.get_markevery() is None else f" every {line.get_markevery()}"
    return look if line.get_clip_on() else f"{look} unclipped"


def _area(area):
    """Return the colours and the hatch of an area."""
    face, edge = _colour(area.get_facecolor()), _colour(area.get_edgecolor())
    look = face if edge == "none" else f"{face} edge {edge} {np.ravel(area.get_linewidth())[0]:g}"
    return f"{look}{f' {area.get_hatch()}' if area.get_hatch() else ''} {_layer(area)}"


def _layer(artist):
    layer = f"z{artist.get_zorder():g}"
    layer += "" if artist.get_alpha() is None else f" alpha {artist.get_alpha():g}"
    return layer if artist.get_visible() else f"{layer} invisible"


def _colour(colours):
    """Return a colour, or the first of several; "none" if it is transparent."""
    colours = colours if isinstance(colours, str) else next(iter(np.atleast_2d(colours)), "none")
    return "none" if to_rgba(colours)[3] == 0.0 else to_hex(colours, keep_alpha=to_rgba(colours)[3] < 1.0)


def _name(artist):
    label = str(artist.get_label())
    return "" if label.startswith("_") or not label else f" {label!r}"


def _points(rows):
    """Return rows of numbers to the millionth."""
    return " ".join("(" + ", ".join(f"{round(float(x), 6) + 0.0:g}" for x in row) + ")" for row in rows)

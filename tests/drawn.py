"""Figures as text, for golden files: each line, arrow, area and text with its position and style, a line each."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.quiver import Quiver


def described(figure) -> str:
    """Return what is on a figure of matplotlib in the units of its axes; where layout puts it is left out."""
    told = ["figure {:g} x {:g} in".format(*(round(each, 4) for each in figure.get_size_inches()))]
    told += [f"{title.get_text()!r}" for title in (figure._suptitle, figure._supylabel) if title]
    for axes in figure.axes:
        told += _axes(axes)
        for inset in axes.child_axes:
            told += ["inset", *_axes(inset)]
    return "\n".join([*told, *(f"legend {[each.get_text() for each in box.get_texts()]}" for box in figure.legends)])


def _axes(axes):
    x, y = ([each.get_text() for each in ticks] for ticks in (axes.get_xticklabels(), axes.get_yticklabels()))
    yield f"axes {axes.get_title()!r} {axes.get_title('left')!r} {axes.get_aspect()}"
    yield f"x {axes.get_xlabel()!r} {axes.get_xscale()} {_points([axes.get_xlim()])} {x}"
    yield f"y {axes.get_ylabel()!r} {axes.get_yscale()} {_points([axes.get_ylim()])} {y}"
    yield from map(line_of, axes.lines)
    for each in axes.collections:
        if isinstance(each, Quiver):
            look = f"{to_hex(each.get_facecolor()[0])} {each.width:g} {each.headwidth:g} {each.headlength:g}"
            yield f"arrows {look}: {_points(np.column_stack([each.XY, each.U, each.V]))}"
        elif isinstance(each, LineCollection):
            yield f"segments {to_hex(each.get_color()[0])}: {[_points(part) for part in each.get_segments()]}"
        else:
            boxes = [path.get_extents().extents for path in each.get_paths()]
            yield f"areas {_name(each)} {each.get_hatch()} z{each.get_zorder():g}: {_points(boxes)}"
    for patch in axes.patches:
        box = patch.get_path().transformed(patch.get_patch_transform()).get_extents().extents
        yield f"patch {to_hex(patch.get_facecolor(), keep_alpha=True)} z{patch.get_zorder():g}: {_points([box])}"
    yield from map(text_of, axes.texts)


def line_of(line):
    """Return a line and its marks as text."""
    return f"{_name(line)} {_look(line)}: {_points(line.get_xydata())}".rstrip()


def text_of(text):
    """Return a text on a figure as a line."""
    look = f"{to_hex(text.get_color())} {text.get_fontsize():g} {text.get_weight()} {text.get_ha()} {text.get_va()}"
    return f"text {text.get_text()!r} {look}: {_points([text.xy if hasattr(text, 'xy') else text.get_position()])}"


def _name(artist):
    label = str(artist.get_label())
    return repr("" if label.startswith("_") else label)


def _look(line):
    look = f"z{line.get_zorder():g}"
    if line.get_alpha() is not None:
        look += f" alpha {line.get_alpha():g}"
    if line.get_linestyle() != "None":
        look += f" {to_hex(line.get_color())} {line.get_linestyle()} {line.get_linewidth():g}"
    if line.get_marker() not in {"None", None}:
        faces = f"{to_hex(line.get_markerfacecolor())} {to_hex(line.get_markeredgecolor())}"
        look += f" {line.get_marker()} {line.get_markersize():g} {faces} {line.get_markeredgewidth():g}"
        look += f" every {line.get_markevery()}" if line.get_markevery() is not None else ""
    return look


def _points(rows):
    """Return rows of numbers to the millionth."""
    return " ".join("(" + ", ".join(f"{round(float(x), 6) + 0.0:g}" for x in row) + ")" for row in rows)

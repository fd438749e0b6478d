"""Legends that lie on data: they are moved out of the axes."""

from collections.abc import Iterable
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

MAX_COLUMNS = 3
"""The largest number of columns of a legend below the axes."""
NOTHING = {"None", "", " ", None}
"""The markers and the line styles that draw nothing."""


def uncover_data(figure: Figure) -> bool:
    """Move each legend that lies on data below the axes, and return whether there is one; the figure must be drawn.

    A figure may be smaller, or have other data, than its author saw, so that no place within its axes is free.
    """
    legends = [(axes, legend) for axes in figure.axes if (legend := axes.get_legend()) is not None]
    covering = [pair for pair in legends if covers_data(figure, pair[1].get_window_extent())]
    for axes, legend in covering:
        texts, title = [text.get_text() for text in legend.get_texts()], legend.get_title().get_text()
        size = legend.get_texts()[0].get_fontsize()
        by_label = handles_of([axes])  # these lines have marks, which the handles of a legend may lack
        handles: list[Any] = [
            by_label.get(text, handle) for text, handle in zip(texts, legend.legend_handles, strict=True)
        ]
        legend.remove()
        columns = min(len(texts), MAX_COLUMNS)
        figure.legend(handles, texts, title=title, loc="outside lower center", ncols=columns, fontsize=size)
    return bool(covering)


def handles_of(panels: Iterable[Axes]) -> dict[str, Any]:
    """Return the lines of several panels that a legend can show, by label."""
    return {label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}


def covers_data(figure: Figure, box: Bbox) -> bool:
    """Return whether a line, a marker, an error bar or an area of a figure is in a box, in pixels."""
    return any(_is_in(axes, box) for axes in figure.axes)


def _is_in(axes: Axes, box: Bbox) -> bool:
    """Return whether data of axes is in a box, in pixels."""
    for line in axes.lines:
        path = line.get_path().transformed(line.get_transform())
        if line.get_marker() not in NOTHING and box.count_contains(path.vertices):
            return True
        if line.get_linestyle() not in NOTHING and path.intersects_bbox(box, filled=False):
            return True
    for collection in axes.collections:
        if collection.get_offset_transform() == axes.transData:  # the markers of a scatter plot
            if box.count_contains(axes.transData.transform(collection.get_offsets())):
                return True
        elif any(path.transformed(collection.get_transform()).intersects_bbox(box) for path in collection.get_paths()):
            return True
    return any(patch.get_path().transformed(patch.get_transform()).intersects_bbox(box) for patch in axes.patches)

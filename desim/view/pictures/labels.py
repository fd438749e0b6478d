"""Placement of text labels beside points, without overlaps where possible."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text

from desim.analysis.drawing.plots import Axes
from desim.config.arrays import Floats
from desim.kernel.core.portable_math import portable_sum

LabelPosition = tuple[float, float]
SIZE = 6.0
"""Font size, points."""
WIDTH, HEIGHT = 0.66, 0.85
"""Size of a digit with a small margin, in units of the font size."""
MARKER = 2.5
"""Half the width of a marker, points (1/72 in)."""


def label_points(
    axes: Axes,
    places: Sequence[LabelPosition],
    names: Sequence[str],
    *,
    avoid: Sequence[LabelPosition] = (),
    **look: Any,
) -> list[Text]:
    """Write a short label beside each point and return the texts.

    There are eight positions around each point. The label takes the position with the least overlap with points,
    earlier labels and the outside of the axes.

    Args:
        axes: the axes to write on. They must have their final limits, and their figure its final layout
            (`draw_without_rendering`).
        places: the points (x, y), in data coordinates.
        names: the labels of the points.
        avoid: further points that labels should not cover.
        look: further properties of the texts.
    """
    assert isinstance(axes.figure, Figure)
    points = 72.0 / axes.figure.dpi
    everything = axes.transData.transform(np.array([*places, *avoid], dtype=float)) * points
    taken = [np.concatenate([each - MARKER, each + MARKER]) for each in everything]  # left, bottom, right, top
    frame = np.array(axes.bbox.extents) * points
    texts: list[Text] = []
    for name, place, anchor in zip(names, places, everything, strict=False):
        boxes = _beside(anchor, WIDTH * SIZE * len(name), HEIGHT * SIZE)
        costs = [portable_sum(_common(box, each) for each in taken) + _area(box) - _common(box, frame) for box in boxes]
        best = boxes[int(np.argmin(costs))]
        taken.append(best)
        x, y = (best[:2] - anchor).tolist()
        text = axes.annotate(name, place, (x, y), textcoords="offset points", fontsize=SIZE, **look)
        text.set_in_layout(False)
        texts.append(text)
    return texts


def _beside(anchor: Floats, width: float, height: float) -> list[Floats]:
    """Return the eight candidate boxes around a point, starting at the upper right."""
    x, y = anchor
    lefts = (x + MARKER + 0.5, x - width / 2.0, x - width - MARKER - 0.5)
    bottoms = (y + MARKER - 0.5, y - height / 2.0, y - height - MARKER + 0.5)
    corners = list(product(lefts, bottoms))
    return [np.array([left, bottom, left + width, bottom + height]) for left, bottom in corners[:4] + corners[5:]]


def _common(one: Floats, other: Floats) -> float:
    """Return the area of the intersection of two boxes."""
    sides = np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2])
    return float(np.prod(np.maximum(sides, 0.0)))


def _area(box: Floats) -> float:
    return float(np.prod(box[2:] - box[:2]))

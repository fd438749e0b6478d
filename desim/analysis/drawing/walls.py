"""Walls in figures of the plane."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from desim.analysis.drawing.palette import GREY
from desim.config.arrays import Floats
from desim.kernel.walls.crossings import WallShape, are_inside
from desim.kernel.walls.wall import Wall

SOLID = "#333333"
"""A wall that blocks motion."""


def draw_walls(axes: Axes, walls: Sequence[Wall]) -> None:
    """Draw walls: those that let players through are pale, and those through which players see are dashed."""
    label: str | None = "wall"
    for wall in walls:
        colour = SOLID if "motion" in wall.blocks else GREY
        look: dict[str, Any] = {"color": colour, "lw": 1.8, "ls": "-" if "sight" in wall.blocks else (0, (3, 2))}
        for shape in wall.shapes:
            corners = np.vstack([shape.corners, shape.corners[:1]]) if shape.closed else shape.corners
            axes.plot(*corners.T, zorder=2.5, label=label, **look)
            label = None
        rings = [shape for shape in wall.shapes if shape.closed]
        if rings:
            area = Path.make_compound_path(*(_oriented(ring, rings) for ring in rings))
            axes.add_patch(PathPatch(area, fc=colour, ec="none", alpha=0.25, zorder=1.5))


def _oriented(ring: WallShape, rings: Sequence[WallShape]) -> Path:
    """Return a ring that runs to the left, or to the right around a hole, so that holes are not filled."""
    others = [other for other in rings if other is not ring]
    is_hole = bool(others) and bool(are_inside(ring.corners[:1], others)[0])
    is_left = _turn(ring.corners) > 0.0
    corners = ring.corners if is_left != is_hole else ring.corners[::-1]
    return Path(np.vstack([corners, corners[:1]]), closed=True)


def _turn(corners: Floats) -> float:
    """Return a number that is positive if a ring runs to the left: twice its area, m^2."""
    x, y = corners.T
    return float(np.add.reduce(x * np.roll(y, -1) - y * np.roll(x, -1)))

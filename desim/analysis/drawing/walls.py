"""Walls in figures of the plane."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from desim.analysis.drawing.palette import GREY
from desim.kernel.walls.crossings import WallShape
from desim.kernel.walls.wall import Wall
from desim.pursuit.paths.corners import solid_side

SOLID = "#333333"
"""The colour of a wall that blocks motion."""
PASSED = {"motion": "no obstacle", "sight": "seen through"}
"""What the legend says of a wall that does not block motion or sight; the words are those of replays."""


def draw_walls(axes: Axes, walls: Sequence[Wall]) -> None:
    """Draw walls: pale if players can pass through them, and dashed if players can see through them."""
    labelled: set[str] = set()  # only the first line of a kind has a label, for the legend
    for wall in walls:
        colour = SOLID if "motion" in wall.blocks else GREY
        look: dict[str, Any] = {"color": colour, "lw": 1.8, "ls": "-" if "sight" in wall.blocks else (0, (3, 2))}
        passed = [word for kind, word in PASSED.items() if kind not in wall.blocks]
        label = ", ".join(["wall", *passed])
        for shape in wall.shapes:
            corners = np.vstack([shape.corners, shape.corners[:1]]) if shape.closed else shape.corners
            axes.plot(*corners.T, zorder=2.5, label=None if label in labelled else label, **look)
            labelled.add(label)
        rings = [shape for shape in wall.shapes if shape.closed]
        if rings:
            area = Path.make_compound_path(*(_oriented(ring, rings) for ring in rings))
            axes.add_patch(PathPatch(area, fc=colour, ec="none", alpha=0.25, zorder=1.5))


def _oriented(ring: WallShape, rings: Sequence[WallShape]) -> Path:
    """Return a ring with its solid side on the left: holes run in the other direction, so that they are not filled."""
    corners = ring.corners if solid_side(ring, rings) == "left" else ring.corners[::-1]
    return Path(np.vstack([corners, corners[:1]]), closed=True)

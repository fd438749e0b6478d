"""Walls in figures and in the data of replays."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from desim import Scenario, Wall, run
from desim.analysis.drawing.walls import draw_walls
from desim.view.pages.replay_plane import walls_data

RING = "POLYGON ((0 0, 9 0, 9 9, 0 9, 0 0), (3 3, 6 3, 6 6, 3 6, 3 3))"


def test_a_replay_has_the_walls_and_the_factors_of_their_losses():
    walls = [Wall(line=[[1, 2], [3, 4]], loss=30.0), Wall(wkt=RING), Wall(line=[[1, 2], [3, 4]], blocks=("sight",))]
    data = walls_data(run(Scenario(horizon=0.01).with_({"wall": walls, "evader.position": [4.5, 4.5]})))
    assert [wall["factor"] for wall in data] == [pytest.approx(10.0), None, 1.0]
    assert data[0]["shapes"] == [{"closed": False, "corners": [[1.0, 2.0], [3.0, 4.0]]}]
    assert [shape["closed"] for shape in data[1]["shapes"]] == [True, True]
    assert data[2]["blocks"] == ["sight"]
    assert walls_data(run(Scenario(horizon=0.01))) is None


def test_the_hole_of_a_wall_is_not_filled():
    axes = Figure().add_subplot()
    draw_walls(axes, [Wall(wkt=RING), Wall(line=[[0, 0], [1, 1]], blocks=("radio",))])
    (patch,) = axes.patches
    outer, hole = patch.get_path().to_polygons(closed_only=True)
    turns = [np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) for x, y in (outer.T, hole.T)]
    assert turns[0] > 0.0 > turns[1]
    assert len(axes.lines) == 3

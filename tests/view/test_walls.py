"""Walls in figures and in the data of replays."""

from math import inf, log10

import numpy as np
import pytest
from matplotlib.figure import Figure

from desim import Scenario, Wall, run
from desim.analysis.drawing.walls import draw_walls
from desim.kernel.models.links import Links
from desim.kernel.models.reception import LogDistance
from desim.view.pages.replay import replay_page
from desim.view.pages.replay_plane import walls_data
from tests.view.browser import in_chromium

RING = "POLYGON ((0 0, 9 0, 9 9, 0 9, 0 0), (3 3, 6 3, 6 6, 3 6, 3 3))"


def test_a_replay_has_the_walls_and_the_factors_of_their_losses():
    walls = [Wall(line=[[1, 2], [3, 4]], loss=30.0), Wall(wkt=RING), Wall(line=[[1, 2], [3, 4]], blocks=("sight",))]
    data = walls_data(run(Scenario(horizon=0.01).with_({"wall": walls, "evader.position": [4.5, 4.5]})))
    assert [wall["factor"] for wall in data] == [pytest.approx(10.0), None, 1.0]
    assert data[0]["shapes"] == [{"closed": False, "corners": [[1.0, 2.0], [3.0, 4.0]]}]
    assert [shape["closed"] for shape in data[1]["shapes"]] == [True, True]
    assert data[2]["blocks"] == ["sight"]
    assert walls_data(run(Scenario(horizon=0.01))) is None


@pytest.mark.parametrize(
    ("network", "loss", "has_shadows"),
    [
        (Links(range=4.0), 6.0, True),
        (Links(range=4.0), 0.0, False),
        (Links(), 6.0, False),
        (Links(), inf, True),
        (Links(range=4.0, reception=LogDistance(shadowing=4.0), fading="per_link"), 6.0, False),
        (Links(range=4.0, reception=LogDistance(shadowing=4.0), fading="per_link"), inf, True),
    ],
    ids=["range", "lossless", "unlimited", "unlimited, opaque", "range by link", "range by link, opaque"],
)
def test_radio_shadows_are_offered_where_there_may_be_some(network, loss, has_shadows):
    """A loss in dB is a factor of distances: without a limit, or with one for each link, no place is out of reach."""
    wall = Wall(line=[[5, 0], [5, 9]], blocks=("radio",), loss=loss)
    scenario = Scenario(horizon=0.01, network=network, wall=(wall,))
    assert ('id="shadows"' in replay_page(run(scenario))) == has_shadows


@in_chromium
@pytest.mark.slow
def test_a_radio_shadow_is_where_no_message_arrives(browser, tmp_path):
    """Pursuer 0 at (2, 5) reaches 4 m. A wall of 9 dB at x = 3 doubles distances (exponent 3): x = 4 instead of 6."""
    wall = Wall(line=[[3, 0], [3, 10]], blocks=("radio",), loss=30 * log10(2))
    players = {"team.positions": [[2, 5], [9, 5]], "evader.position": [9, 9], "motion.static": True}
    scenario = Scenario(horizon=0.01, network=Links(range=4.0), wall=(wall,)).with_(players)
    path = tmp_path / "replay.html"
    path.write_text(replay_page(run(scenario)), encoding="utf-8")
    browser.open(path)
    browser.until("(replay.draw(), replay.scale > 1)")
    pink = """(() => {
      document.getElementById("shadows").click(); document.getElementById("links").click();
      replay.choose(0); replay.draw();
      const arena = document.getElementById("arena"), ratio = arena.width / arena.clientWidth;
      return [0.8, 3.7, 4.3, 5.7, 6.3].map(x => {
        const [u, v] = replay.pixel(x, 5.13).map(each => Math.round(each * ratio));
        const [r, g] = arena.getContext("2d").getImageData(u, v, 1, 1).data;
        return r - g > 10;
      });
    })()"""
    assert browser.value(pink) == [False, False, True, True, False]


def test_the_hole_of_a_wall_is_not_filled():
    axes = Figure().add_subplot()
    draw_walls(axes, [Wall(wkt=RING), Wall(line=[[0, 0], [1, 1]], blocks=("radio",))])
    (patch,) = axes.patches
    outer, hole = patch.get_path().to_polygons(closed_only=True)
    turns = [np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) for x, y in (outer.T, hole.T)]
    assert turns[0] > 0.0 > turns[1]
    assert len(axes.lines) == 3

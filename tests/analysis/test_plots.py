"""Pictures: their structure and their bytes, not their pixels."""

import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest

from desim.analysis.plots import save, styled, trajectory
from desim.kernel.clock import SECOND
from desim.kernel.events import Trace
from desim.pursuit.events import Captured, Ended, Sampled, Started
from desim.scenario import Scenario
from desim.scenario_file import load
from desim.simulation import Result, run

SCENARIOS = Path(__file__).parents[2] / "scenarios"
START = ((0.0, 0.0), (5.0, 5.0), (9.0, 0.0), (7.0, 7.0))


def chase(reason="captured", capturer=1, name="chase", samples=3) -> Result:
    """Return a result in which pursuers 1 and 3 ran along x for 2 s, the others stayed, and the evader ran along y."""
    trace = Trace()
    trace.append(Started(0, (1.0, 2.0), START, (1.0,) * 4, (True,) * 4))
    for k in range(samples):
        (a, b, c, d) = START
        pursuers = (a, (b[0] + k, b[1]), c, (d[0] + k, d[1]))
        trace.append(Sampled(k * SECOND, (1.0, 2.0 + k), pursuers))
    trace.append(Ended(2 * SECOND, reason, capturer))
    return Result(Scenario(name=name), 3, trace)


def legend(figure) -> list[str]:
    (box,) = figure.legends
    return [text.get_text() for text in box.get_texts()]


def svg(figure, folder):
    """Return a figure as the tree of its SVG."""
    return ElementTree.parse(save(figure, folder / "picture")[0]).getroot()


def texts(root) -> list[str]:
    return ["".join(each.itertext()) for each in root.iter("{http://www.w3.org/2000/svg}text")]


def test_the_axes_have_names_with_units_and_one_scale():
    (axes,) = trajectory(chase()).axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (m)", "y (m)")
    assert axes.get_aspect() == 1.0
    assert axes.get_title() == "chase, seed 3"
    assert np.unique(np.diff(axes.get_xticks())) == np.unique(np.diff(axes.get_yticks()))


def test_the_paths_of_the_evader_and_of_those_who_moved_are_drawn():
    (axes,) = trajectory(chase()).axes
    paths = [line.get_xydata().tolist() for line in axes.lines]
    assert [[1.0, 2.0], [1.0, 3.0], [1.0, 4.0]] in paths
    assert [[5.0, 5.0], [6.0, 5.0], [7.0, 5.0]] in paths
    assert [[7.0, 7.0], [8.0, 7.0], [9.0, 7.0]] in paths
    assert [list(each) for each in START] in paths
    assert all(paths.count(path) == 1 for path in paths)
    assert [path for path in paths if len(path) == 1] == [[[1.0, 4.0]]], "where the evader was captured"
    (evader,) = [line for line in axes.lines if line.get_label() == "evader"]
    assert (evader.get_marker(), evader.get_markevery(), evader.is_dashed()) == ("s", [0], True)


@pytest.mark.parametrize(
    ("reason", "capturer"),
    [("captured", 1), ("captured", 3), ("captured", 0), ("horizon", None), ("stopped", None)],
    ids=["captured by 1", "captured by 3", "captured by one that stood still", "horizon", "stopped"],
)
def test_each_role_is_in_the_legend_once(reason, capturer):
    labels = legend(trajectory(chase(reason, capturer)))
    assert len(set(labels)) == len(labels)
    assert "evader" in labels
    assert ("capture, 2.00 s" in labels) == (reason == "captured")
    numbered = [int(found[1]) for label in labels if (found := re.match(r"pursuer (\d+)", label))]
    assert numbered == ([] if capturer is None else [capturer])
    assert len([label for label in labels if "chased for a while" in label]) == 1


def test_without_helpers_nobody_is_said_to_have_chased_for_a_while():
    assert not [label for label in legend(trajectory(chase(samples=1))) if "for a while" in label]


def test_the_legend_is_outside_of_the_axes_and_inside_of_the_picture():
    figure = trajectory(chase())
    (axes,), (box,) = figure.axes, figure.legends
    taken, around = box.get_window_extent(), figure.bbox
    assert not taken.overlaps(axes.get_tightbbox())
    assert around.x0 <= taken.x0 < taken.x1 <= around.x1
    assert around.y0 <= taken.y0 < taken.y1 <= around.y1


def test_who_captured_is_drawn_in_a_style_of_its_own():
    (axes,) = trajectory(chase()).axes
    path = {str(line.get_xydata().tolist()): (line.get_color(), line.get_linewidth()) for line in axes.lines}
    capturer, helper = path["[[5.0, 5.0], [6.0, 5.0], [7.0, 5.0]]"], path["[[7.0, 7.0], [8.0, 7.0], [9.0, 7.0]]"]
    assert capturer[0] != helper[0]
    assert capturer[1] > helper[1]


def test_without_recorded_positions_there_is_nothing_to_draw():
    with pytest.raises(ValueError, match=r"record\.trajectory"):
        trajectory(chase(samples=0))


def bytes_of(figure, stem) -> list[bytes]:
    return [path.read_bytes() for path in save(figure, stem)]


def test_a_picture_drawn_twice_is_the_same_bytes_and_that_of_another_run_is_not(tmp_path):
    once = bytes_of(trajectory(chase()), tmp_path / "once")
    assert bytes_of(trajectory(chase()), tmp_path / "twice") == once
    for one, other in zip(once, bytes_of(trajectory(chase(capturer=3)), tmp_path / "other"), strict=True):
        assert one != other


def test_a_picture_saved_twice_is_the_same_bytes(tmp_path):
    figure = trajectory(chase())
    vector, raster = bytes_of(figure, tmp_path / "once")
    again = bytes_of(figure, tmp_path / "twice")
    assert again[0] == vector
    assert again[1] == raster


def test_the_svg_has_no_date_and_the_png_no_time(tmp_path):
    vector, raster = save(trajectory(chase()), tmp_path / "picture")
    text = vector.read_text(encoding="utf-8")
    assert "<dc:date" not in text
    assert not re.search(r"\b20\d\d-\d\d-\d\d\b", text)
    assert b"tIME" not in raster.read_bytes()
    assert b"Creation Time" not in raster.read_bytes()


def test_a_picture_takes_the_name_it_is_given_and_says_where_it_is(tmp_path):
    assert save(trajectory(chase()), tmp_path / "run") == [tmp_path / "run.svg", tmp_path / "run.png"]
    assert sorted(tmp_path.iterdir()) == [tmp_path / "run.png", tmp_path / "run.svg"]


def test_a_picture_named_by_its_suffix_is_that_one(tmp_path):
    heads = {".svg": b"<?xml", ".png": b"\x89PNG", ".pdf": b"%PDF", ".PDF": b"%PDF"}
    for kind, head in heads.items():
        path = tmp_path / f"v1.2{kind}"
        assert save(trajectory(chase()), path) == [path]
        assert path.read_bytes().startswith(head)
    assert len([*tmp_path.iterdir()]) == len(heads)
    assert save(trajectory(chase()), tmp_path / "v1.3") == [tmp_path / "v1.3.svg", tmp_path / "v1.3.png"]
    with pytest.raises(ValueError, match=r"should end in \.svg or \.png or \.pdf"):
        save(trajectory(chase()), tmp_path / "x.gif")


PDF = """
import sys
from pathlib import Path
from desim.analysis.plots import save, styled
with styled((2, 2)) as figure:
    figure.add_subplot().set(title="many different letters: \u03c4")
save(figure, Path(sys.argv[1]))
"""


def test_a_pdf_has_no_date_and_no_bitmap_type_and_is_the_same_bytes_in_another_process(tmp_path):
    """Its fonts are TrueType (Type 42), for publishers refuse Type 3."""
    for seed in "12":
        environment = os.environ | {"PYTHONHASHSEED": seed}
        subprocess.run([sys.executable, "-c", PDF, str(tmp_path / f"{seed}.pdf")], env=environment, check=True)
    once, twice = ((tmp_path / f"{seed}.pdf").read_bytes() for seed in "12")
    assert once == twice
    assert b"Date" not in once
    assert b"/CIDFontType2" in once or b"/TrueType" in once
    assert b"/Type3" not in once


@pytest.mark.parametrize(
    "name",
    [
        "<script>alert(1)</script>",
        "costs $5",
        "$x^2$",
        "a & b --> ]]>",
        "\"quoted\" 'twice'",
        "100 % $\\frac{}$",
        "\u03c4 = 1",
    ],
)
def test_a_name_appears_as_the_text_it_is(tmp_path, name):
    root = svg(trajectory(chase(name=name)), tmp_path)
    assert f"{name}, seed 3" in texts(root)
    assert not [each for each in root.iter() if each.tag.endswith("}script")]


def test_the_text_of_an_svg_is_text(tmp_path):
    found = texts(svg(trajectory(chase()), tmp_path))
    assert {"x (m)", "y (m)", "chase, seed 3", "evader", "capture, 2.00 s"} <= set(found)


def test_drawing_leaves_the_style_and_the_luck_of_others_alone(tmp_path):
    luck = np.random.get_state()[1].tolist()  # noqa: NPY002 - the global generator is the subject
    with mpl.rc_context({"svg.fonttype": "path", "font.size": 17.0, "axes.spines.top": True}):
        style = dict(mpl.rcParams)
        save(trajectory(chase()), tmp_path / "picture")
        assert dict(mpl.rcParams) == style
    assert np.random.get_state()[1].tolist() == luck  # noqa: NPY002


def test_a_styled_figure_has_its_size_in_inches():
    with styled((3.0, 2.0)) as figure:
        assert figure.get_size_inches().tolist() == [3.0, 2.0]
        assert mpl.rcParams["svg.fonttype"] == "none"


def test_a_trajectory_numbers_several_evaders_and_says_who_captured_which():
    """A captured evader is where its star is; a pursuer that captures twice is drawn once."""
    result = run(load(SCENARIOS / "many.toml", ["horizon=20.0", "record.messages=false"]), 3)
    captured, last = result.trace.of(Captured), result.trace.of(Sampled)[-1]
    (axes,) = trajectory(result).axes
    assert [text.get_text() for text in axes.texts] == ["1", "2", "3"]
    stars = [line for line in axes.lines if line.get_marker() == "*"]
    assert [line.get_label().split(",")[0] for line in stars] == [
        f"capture of {each.evader} by {each.capturer}" for each in captured
    ]
    places = [(line.get_xdata()[0], line.get_ydata()[0]) for line in stars]
    assert places == [last.evaders[each.evader - 1] for each in captured]
    bold = [line for line in axes.lines if line.get_linewidth() == 2.0]
    assert len(bold) == len({each.capturer for each in captured})

"""Pictures: their structure and their bytes, not their pixels."""

import base64
import os
import re
import struct
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from desim.analysis.drawing.plots import COLUMN, html_image, in_style, save, size_of, styled
from desim.analysis.drawing.trajectory import trajectory
from desim.config.errors import ArgumentError
from desim.kernel.core.events import Trace
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Captured, Ended, Sampled, Started
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result
from tests.view.by_hand import history, pair

START = ((0.0, 0.0), (5.0, 5.0), (9.0, 0.0), (7.0, 7.0))


def chase(reason="captured", capturer=1, name="chase", samples=3) -> Result:
    """Return a result in which pursuers 1 and 3 ran along x for 2 s, the others stayed, and the evader ran along y."""
    trace = Trace()
    trace.append(Started(0, ((1.0, 2.0),), START, (1.0,) * 4, (True,) * 4))
    for k in range(samples):
        (a, b, c, d) = START
        pursuers = (a, (b[0] + k, b[1]), c, (d[0] + k, d[1]))
        trace.append(Sampled(k * SECOND, ((1.0, 2.0 + k),), pursuers))
    if capturer is not None:
        trace.append(Captured(2 * SECOND, 1, capturer))
    trace.append(Ended(2 * SECOND, reason, capturer))
    return Result(Scenario(name=name), 3, trace)


def texts(root) -> list[str]:
    return ["".join(each.itertext()) for each in root.iter("{http://www.w3.org/2000/svg}text")]


@pytest.mark.parametrize(
    ("result", "labels", "ends"),
    [
        (
            history(),
            "pursuer at the start|pursuer that chased for a while|pursuer 2, which captures|evader|capture, 1.00 s",
            [[5.0, 6.0]],
        ),
        (
            pair(),
            "pursuer at the start|pursuer that captures|evader||capture of 1 by 0, 0.40 s|capture of 2 by 0, 1.00 s",
            [[5.0, 5.4], [9.0, 2.0]],
        ),
    ],
    ids=["one evader", "two"],
)
def test_on_given_axes_the_paths_are_named_and_captures_marked(result, labels, ends):
    ax = Figure().add_subplot()
    assert trajectory(result, ax=ax) is ax.figure
    names = [line.get_label() for line in ax.lines]
    assert "|".join("" if name.startswith("_") else name for name in names) == labels
    assert [line.get_xydata()[-1].tolist() for line in ax.lines[-len(ends) :]] == ends
    assert [text.get_text() for text in ax.texts] == ["1", "2"] * (len(ends) > 1)
    assert (ax.get_aspect(), ax.get_xlabel(), ax.get_ylabel()) == (1.0, "x (m)", "y (m)")


@pytest.mark.slow
def test_the_legend_is_outside_of_the_axes_and_inside_of_the_picture():
    figure = trajectory(chase())
    (axes,), (box,) = figure.axes, figure.legends
    taken, around = box.get_window_extent(), figure.bbox
    assert not taken.overlaps(axes.get_tightbbox())
    assert around.x0 <= taken.x0 < taken.x1 <= around.x1
    assert around.y0 <= taken.y0 < taken.y1 <= around.y1


def test_without_recorded_positions_there_is_nothing_to_draw():
    with pytest.raises(ValueError, match=r"record\.trajectory"):
        trajectory(chase(samples=0))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Return a figure and the vector and the raster image of it, saved once."""
    figure, folder = trajectory(chase()), tmp_path_factory.mktemp("saved")
    paths = save(figure, folder / "run")
    assert paths == [folder / "run.svg", folder / "run.png"]
    assert sorted(folder.iterdir()) == sorted(paths)
    return figure, *paths


@pytest.mark.whole
def test_a_picture_drawn_or_saved_twice_is_the_same_bytes_and_that_of_another_run_is_not(saved, tmp_path):
    figure, *paths = saved
    once = [path.read_bytes() for path in paths]
    for each, same in ((figure, True), (trajectory(chase()), True), (trajectory(chase(capturer=3)), False)):
        assert all(
            (path.read_bytes() == then) == same for path, then in zip(save(each, tmp_path / "x"), once, strict=True)
        )


@pytest.mark.slow
def test_the_svg_has_no_date_and_its_text_is_text_and_the_png_has_no_time(saved):
    _, vector, raster = saved
    text = vector.read_text(encoding="utf-8")
    assert "<dc:date" not in text
    assert not re.search(r"\b20\d\d-\d\d-\d\d\b", text)
    assert b"tIME" not in raster.read_bytes()
    assert b"Creation Time" not in raster.read_bytes()
    assert {"x (m)", "y (m)", "chase, seed 3", "evader", "capture, 2.00 s"} <= set(texts(ElementTree.parse(vector)))


@pytest.mark.slow
def test_a_picture_named_by_its_suffix_is_that_one(tmp_path):
    heads = {".svg": b"<?xml", ".png": b"\x89PNG", ".pdf": b"%PDF", ".PDF": b"%PDF"}
    with styled((1.0, 1.0)) as figure:
        figure.suptitle("x")
    for kind, head in heads.items():
        path = tmp_path / f"v1.2{kind}"
        assert save(figure, path) == [path]
        assert path.read_bytes().startswith(head)
    assert len([*tmp_path.iterdir()]) == len(heads)
    assert save(figure, tmp_path / "v1.3") == [tmp_path / "v1.3.svg", tmp_path / "v1.3.png"]
    with pytest.raises(ValueError, match=r"should end in \.svg or \.png or \.pdf"):
        save(figure, tmp_path / "x.gif")


PDF = """
import sys
from pathlib import Path
from pathlib import Path
from desim.analysis.drawing.plots import save, styled
with styled((2, 2)) as figure:
    figure.add_subplot().set(title="many different letters: \u03c4")
save(figure, Path(sys.argv[1]))
"""


@pytest.mark.whole
def test_a_pdf_has_no_date_and_no_bitmap_type_and_is_the_same_bytes_in_another_process(tmp_path):
    """Its fonts are TrueType (Type 42), for publishers refuse Type 3."""
    here, there = tmp_path / "here.pdf", tmp_path / "there.pdf"
    with styled((2, 2)) as figure:
        figure.add_subplot().set(title="many different letters: \u03c4")
    save(figure, here)
    subprocess.run([sys.executable, "-c", PDF, str(there)], env=os.environ | {"PYTHONHASHSEED": "1"}, check=True)
    once, twice = here.read_bytes(), there.read_bytes()
    assert once == twice
    assert b"Date" not in once
    assert b"/CIDFontType2" in once or b"/TrueType" in once
    assert b"/Type3" not in once


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["<script>alert(1)</script> a & b --> ]]>", "$x^2$ costs 100 % $\\frac{}$", "\"quoted\" 'twice' \u03c4 costs $5"],
)
def test_a_name_appears_as_the_text_it_is(tmp_path, name):
    root = ElementTree.parse(save(trajectory(chase(name=name)), tmp_path / "picture.svg")[0]).getroot()
    assert f"{name}, seed 3" in texts(root)
    assert not [each for each in root.iter() if each.tag.endswith("}script")]


@pytest.mark.slow
def test_drawing_leaves_the_global_style_and_random_generators_unchanged(tmp_path):
    luck = np.random.get_state()[1].tolist()  # noqa: NPY002 - the global generator is the subject
    with mpl.rc_context({"svg.fonttype": "path", "font.size": 17.0, "axes.spines.top": True}):
        style = dict(mpl.rcParams)
        save(trajectory(chase()), tmp_path / "picture.svg")
        assert dict(mpl.rcParams) == style
    assert np.random.get_state()[1].tolist() == luck  # noqa: NPY002


def test_a_styled_figure_has_its_size_in_inches():
    with styled((3.0, 2.0)) as figure:
        assert figure.get_size_inches().tolist() == [3.0, 2.0]
        assert mpl.rcParams["svg.fonttype"] == "none"


def test_an_image_of_a_page_has_the_size_of_its_figure_and_twice_the_pixels():
    """72 points of CSS are an inch: 2 in x 1 in are 144 wide on the page, and 288 x 144 pixels in the PNG."""
    with styled(figsize=(2.0, 1.0)) as figure:
        image = html_image(figure, 'a "name"')
    width, png = re.search(r'width="(.*?)"', image)[1], base64.b64decode(re.search(r"base64,([^\"]*)", image)[1])
    assert (width, struct.unpack(">II", png[16:24])) == ("144", (288, 144))
    assert ElementTree.fromstring(image.replace(">", "/>")).get("alt") == 'a "name"'


@pytest.mark.slow
def test_a_figure_keeps_its_labels_when_it_is_resized():
    """Of 9 points in 2.5 in, they are cut unless the layout follows the size; as without one."""
    for is_live in (True, False):
        figure = trajectory(chase())
        if not is_live:
            figure.set_layout_engine("none")
        figure.set_size_inches(3.5, 2.5)
        figure.draw_without_rendering()
        (axes,), (width, height) = figure.axes, figure.bbox.size
        boxes = [each.get_window_extent() for each in (axes.xaxis.label, axes.yaxis.label, axes.title)]
        inside = [0 <= box.x0 < box.x1 <= width and 0 <= box.y0 < box.y1 <= height for box in boxes]
        overlaps = figure.legends[0].get_window_extent().overlaps(boxes[0])
        assert (all(inside) and not overlaps) == is_live


@pytest.mark.parametrize(
    ("text", "size"),
    [("8.5cm", (8.5, None)), ("8.5cmx6cm", (8.5, 6.0)), ("85x60mm", (8.5, 6.0)), ("5 in x 2.54 cm", (12.7, 2.54))],
)
def test_a_size_is_a_width_and_perhaps_a_height_with_a_unit(text, size):
    found = size_of(text)
    assert [each and round(each * 2.54, 9) for each in found] == [*size]


def test_a_column_of_a_paper_is_8_5_cm_wide():
    assert size_of("8.5cm")[0] == pytest.approx(COLUMN)


@pytest.mark.parametrize("text", ["", "8.5", "cm", "8.5cmx", "8.5km", "-8.5cm", "1cm", "infcm", "1e9cm", "3inx0in"])
def test_what_is_no_size_is_refused(text):
    with pytest.raises(ValueError, match=re.escape(f"got {text!r}")):
        size_of(text)


@pytest.mark.parametrize(
    "style", ["f.bin", ["ggplot", "f.bin"], 3, b"x", "none.mplstyle", {"no.such.key": 1}, ["ggplot", 3]]
)
def test_a_style_that_is_none_is_refused_in_a_sentence(style, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("f.bin").write_bytes(bytes(range(256)))
    with pytest.raises(ArgumentError, match="style"), in_style(style):
        pass
    with pytest.raises(OSError, match="of the figure"), in_style("ggplot"):
        raise OSError("of the figure")

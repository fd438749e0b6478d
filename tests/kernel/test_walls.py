"""Walls: their shapes from numbers and texts, their materials, and which lines cross them."""

from fractions import Fraction
from itertools import permutations
from math import exp, inf, nan, pi, sqrt
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.config.errors import KeyedError
from desim.kernel.walls.crossings import (
    Segments,
    WallShape,
    are_inside,
    crossings,
    first_contact,
    gaps,
    segments_of,
)
from desim.kernel.walls.materials import MATERIALS, slab_loss
from desim.kernel.walls.wall import Wall, blocking
from desim.kernel.walls.wall_file import wkt_in

SQUARE = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))


def segments(*walls):
    """Return walls (start, end) as segments."""
    starts, ends = np.array([start for start, _ in walls]), np.array([end for _, end in walls])
    return Segments.of(starts.reshape(-1, 2), ends.reshape(-1, 2))


def crossed(start, end, *walls, margin=0.0):
    """Return how many walls a ray crosses."""
    rays = np.array([start], dtype=float), np.array([end], dtype=float)
    return int(crossings(*rays, segments(*walls), margin).sum())


# Shapes.


@pytest.mark.parametrize(
    "keys",
    [
        {"polygon": [[0, 0], [4, 0], [4, 4], [0, 4]]},
        {"polygon": [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]},
        {"wkt": SimpleNamespace(wkt="POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0))")},
        {"wkt": "POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0))"},
        {"wkt": "polygon((0 0,4 0,4 4,0 4,0 0))"},
        {"wkt": "MULTIPOLYGON (((0 0, 4 0, 4 4, 0 4, 0 0)))"},
        {"wkt": "GEOMETRYCOLLECTION (POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0)))"},
        {"svg": "M 0 0 L 4 0 4 -4 0 -4 Z"},
        {"svg": "M0,0H4V-4H0Z"},
        {"svg": "m0 0h4v-4h-4z"},
        {"svg": "M 0 0 L 4 0 L 4 -4 L 0 -4 L 0 0 Z"},
        {"wkt": "POLYGON ((-10 10, -2 10, -2 18, -10 18, -10 10))", "scale": 0.5, "offset": [5, -5]},
    ],
)
def test_one_polygon_is_the_same_however_it_is_written(keys):
    (shape,) = Wall(**keys).shapes
    assert shape.closed
    assert shape.corners.tolist() == [list(corner) for corner in SQUARE]
    assert len(segments_of([(0, shape)]).starts) == 4


def test_a_text_may_have_several_lines_and_polygons_with_holes():
    wkt = "MULTILINESTRING ((0 0, 1 0), (2 0, 3 0, 3 1))\nPOLYGON ((0 0, 9 0, 9 9, 0 9, 0 0), (3 3, 6 3, 6 6, 3 3))"
    shapes = Wall(wkt=wkt).shapes
    assert [(len(shape.corners), shape.closed) for shape in shapes] == [(2, False), (3, False), (4, True), (3, True)]
    points = np.array([[1.0, 1.0], [5.0, 4.0], [3.1, 5.0], [10.0, 1.0]])
    assert are_inside(points, shapes).tolist() == [True, False, True, False]
    lines = Wall(svg="M 8 -9 z l 1 0 M 1 -1 l 1 0 0 -1 m 5 0 h 2 M 0 0 h 1 v 1 z l 3 3").shapes
    assert [shape.corners.tolist() for shape in lines] == [
        [[8, 9], [9, 9]],
        [[1, 1], [2, 1], [2, 2]],
        [[7, 2], [9, 2]],
        [[0, 0], [1, 0], [1, -1]],
        [[0, 0], [3, -3]],
    ]


@pytest.mark.parametrize(
    ("content", "name", "shapes"),
    [
        (
            "# height < 3\nLINESTRING (0 0, 1 1)\n# a comment\nPOLYGON ((0 0, 1 0, 1 1, 0 0))\n",
            "a.wkt",
            [(2, False), (3, True)],
        ),
        ("# corners\n0 0\n1,0\n1 1\n0 0\n\n\n2 2\n3 3\n", "a.txt", [(3, True), (2, False)]),
        ('"X","Y"\n0,0\n1,0\n', "a.csv", [(2, False)]),
        ('<svg><path id="a" d="M0 0H1"/><path d=\'M0 0H1V1z\' style="x"/></svg>', "a.svg", [(2, False), (3, True)]),
    ],
)
def test_a_file_is_read_once_and_its_shapes_become_part_of_the_wall(tmp_path, content, name, shapes):
    (tmp_path / name).write_text(content)
    wall = Wall.model_validate({"file": name}, context={"folder": tmp_path})
    (tmp_path / name).unlink()
    assert [(len(shape.corners), shape.closed) for shape in wall.shapes] == shapes
    assert wall.file is None
    assert Wall(**wall.plain()) == wall


def test_each_drawn_path_of_a_file_starts_at_the_origin_and_others_are_no_walls(tmp_path):
    """A second path that begins with m, as editors write it, is not displaced by the first."""
    (tmp_path / "a.svg").write_text(
        '<svg><defs id="empty"/><defs><path d="M 9 9 h 1"/></defs><!-- <path d="M 7 7 h 1"/> -->'
        '<path d="m 1,-1 2,0"/>\r\n<path d=" m 10,-10 0,5"/></svg>'
    )
    shapes = Wall(file=str(tmp_path / "a.svg")).shapes
    assert [shape.corners.tolist() for shape in shapes] == [[[1, 1], [3, 1]], [[10, 10], [10, 5]]]


BAD = {
    "no shape": ({}, "exactly one of line, polygon, wkt, svg, file"),
    "two shapes": ({"line": SQUARE, "svg": "M0 0H1"}, "has line and svg"),
    "a point": ({"line": [[0, 0]]}, "at least 2 corners"),
    "a ring of one corner": ({"wkt": "POLYGON ((0 0))"}, "a polygon should have at least 3 corners"),
    "two corners": ({"polygon": SQUARE[:2]}, "at least 3 corners"),
    "a corner twice": ({"line": [[0, 0], [1, 1], [1, 1]]}, r"\[1, 1\] comes twice"),
    "a ring that ends twice": ({"polygon": [*SQUARE, SQUARE[0], SQUARE[0]]}, r"\[0, 0\] comes twice"),
    "crossing itself": ({"polygon": [[0, 0], [4, 4], [4, 0], [0, 4]]}, r"from \[0, 0\] to \[4, 4\] meets that"),
    "touching itself": ({"polygon": [[0, 0], [4, 0], [2, 3], [2, 0], [0, 3]]}, "should not cross or touch itself"),
    "no area": ({"polygon": [[0, 0], [2, 0], [1, 0]]}, "should not cross or touch itself"),
    "rings that cross": (
        {"wkt": "MULTIPOLYGON (((0 0, 2 0, 2 2, 0 0)), ((1 -1, 3 -1, 3 3, 1 -1)))"},
        "polygons 0 and 1 touch each other.*give each a wall of its own",
    ),
    "too far": ({"wkt": "LINESTRING (0 0, 1e10 0)"}, "from -1e\\+09 to 1e\\+09"),
    "nan as x": ({"wkt": "LINESTRING (nan 0, 1 1)"}, "from -1e\\+09 to 1e\\+09"),
    "nan as y": ({"wkt": "POLYGON ((0 0, 4 nan, 4 4, 0 0))"}, "from -1e\\+09 to 1e\\+09"),
    "scaled too far": ({"line": SQUARE, "scale": 1e9}, "scaled and displaced: a coordinate should be from"),
    "displaced to a point": (
        {"line": [[0, 0], [1e-12, 0]], "offset": [1e5, 0]},
        r"scaled and displaced: .*\[100000, 0\] comes twice",
    ),
    "a list of losses": ({"line": SQUARE, "material": "brick", "loss": [3.0]}, "loss.*should be a number"),
    "not finite": ({"line": [[0, 0], [nan, 0]]}, "line"),
    "a misspelt type": ({"wkt": "POLYGN ((0 0))"}, "did you mean 'POLYGON'"),
    "a point in WKT": ({"wkt": "POINT (0 0)"}, "POINT is no line or polygon"),
    "an open ring": ({"wkt": "POLYGON ((0 0, 1 0, 1 1))"}, "a ring should end where it begins"),
    "three coordinates": ({"wkt": "LINESTRING (0 0 0, 1 1 1)"}, r"two numbers, x y \(has 3\)"),
    "Z": ({"wkt": "LINESTRING Z (0 0 0, 1 1 1)"}, "more than two coordinates"),
    "a missing bracket": ({"wkt": "LINESTRING (0 0, 1 1"}, r"'\)' should come here, not the end"),
    "a decimal comma": ({"wkt": "LINESTRING (0 0, 1 a)"}, "'a' is not a number"),
    "empty": ({"wkt": "  "}, "at least one of LINESTRING"),
    "an empty geometry": ({"wkt": "POLYGON EMPTY"}, "at least one of LINESTRING"),
    "a second line": ({"wkt": "LINESTRING (0 0, 1 1)\nLINE (0 0)"}, "WKT, line 2: LINE is no line or polygon"),
    "a curve": ({"svg": "M 0 0 C 1 1 2 2 3 3"}, "C is a curve: in the editor, flatten it"),
    "no M": ({"svg": "L 0 0"}, "should begin with M, not L"),
    "one number": ({"svg": "M 0 0 L 1"}, "L should have 2 numbers"),
    "a letter": ({"svg": "M 0 0 L 1 x"}, "x is no command"),
    "no path": ({"svg": "M 0 0"}, "has no line"),
    "a sign": ({"svg": "M 0 0 L 1 %"}, "is neither a command nor a number"),
    "nested too deeply": ({"wkt": "GEOMETRYCOLLECTION (" * 2000}, "nested too deeply"),
    "numbers first": ({"svg": "1 2 L 3 4"}, "should come before 1"),
    "a missing file": ({"file": "no.wkt"}, "no.wkt cannot be read"),
    "an unknown name": ({"line": SQUARE, "blocks": ["sound"]}, "'motion' or 'start'"),
    "nothing": ({"line": SQUARE, "blocks": []}, "at least 1 item"),
    "a name twice": ({"line": SQUARE, "blocks": ["sight", "sight"]}, "each name once"),
    "a negative loss": ({"line": SQUARE, "loss": -1.0}, "loss: should be"),
    "an unknown material": ({"line": SQUARE, "material": "stone"}, "'concrete', 'brick'"),
    "loss and material": ({"line": SQUARE, "material": "brick", "loss": 3.0}, "a loss or a material, not both"),
    "thickness in cm": (
        {"line": SQUARE, "material": "brick", "thickness": 24.0},
        "thickness: should be less than or equal to 10; Thickness of the slab, m",
    ),
    "no thickness": ({"line": SQUARE, "material": "brick", "thickness": 0.0}, "thickness: should be greater than 0"),
    "too low": ({"line": SQUARE, "material": "glass", "frequency": 50e6}, "glass is known from 0.1 to 100 GHz"),
    "too high": ({"line": SQUARE, "material": "brick", "frequency": 60e9}, r"from 0.4 to 40 GHz .got 6e.10 Hz"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_wall_that_is_none_is_refused_with_what_is_allowed(case):
    keys, why = BAD[case]
    with pytest.raises(KeyedError, match=why):
        Wall(**keys)


@pytest.mark.parametrize(
    ("content", "name", "why"),
    [
        ("0 0\n1\n", "a.txt", "line 2: a corner should have two numbers, x y .has 1"),
        ("0 0\n1 1\n\n2 2\n", "a.txt", "shape 1: a line should have at least 2 corners .has 1"),
        ("# walls\n\nLINESTRING (0 0, 1 1)\nPOINT (1 1)\n", "a.wkt", "WKT, line 4: POINT is no line"),
        ("0 0\n1 1,5x\n", "a.txt", "line 2"),
        ("\n", "a.txt", "has no shape"),
        ('<svg><circle r="4"/></svg>', "a.svg", "<circle> is not read: convert objects to paths"),
        (
            '<svg><path transform="turn(2)" d="M0 0H1"/></svg>',
            "a.svg",
            "turn with 1 number is no transformation of SVG",
        ),
        ('<svg><path transform="scale(2" d="M0 0H1"/></svg>', "a.svg", "'scale.2' is no transformation of SVG"),
        (
            '<svg><path transform="rotate(2rad)" d="M0 0H1"/></svg>',
            "a.svg",
            "'2rad' should be numbers; angles are in deg",
        ),
        (
            '<svg><path style="transform: scale(2)" d="M0 0H1"/></svg>',
            "a.svg",
            "transform in a style is not read",
        ),
        ('<svg><g transform-origin="2 2"><path d="M0 0H1"/></g></svg>', "a.svg", "transform-origin is not read"),
        ('<svg><rect rx="1" width="4" height="2"/></svg>', "a.svg", "round corners: make them straight"),
        ('<svg><rect width="4cm" height="2"/></svg>', "a.svg", "<rect> width: '4cm' should be a number in the unit of"),
        ('<svg><polygon points="0 0 1"/></svg>', "a.svg", "L should have 2 numbers"),
        (
            "<svg><style>g > path {fill: none}</style></svg>",
            "a.svg",
            "the selector 'g > path' of its style sheet is not",
        ),
        ("<svg><path></svg>", "a.svg", "is not a drawing in SVG: mismatched tag: line 1"),
        ("<html><svg/></html>", "a.svg", "is not a drawing in SVG: its first element is <html>"),
        (
            '<svg><g style="fill:none;display:none"><path d="M0 0H1"/></g></svg>',
            "a.svg",
            "'display: none' hides a <path>",
        ),
        ('<svg><path visibility="hidden" d="M0 0H1"/></svg>', "a.svg", "'visibility: hidden' hides a <path>"),
        ('<svg><path style="fill:none; opacity: 0" d="M0 0H1"/></svg>', "a.svg", "'opacity: 0' hides a <path>"),
        ('<svg><path fill="none" display="None" d="M0 0H1"/></svg>', "a.svg", "'display: none' hides a <path>"),
        ('<?xml-stylesheet href="a.css"?><svg><path d="M0 0H1"/></svg>', "a.svg", "in another file is not read"),
        ('<svg><path style="translate: 9px" d="M0 0H1"/></svg>', "a.svg", "translate in a style is not read"),
        ('<svg><path style="fill: var(--room)" d="M0 0H1"/></svg>', "a.svg", "write the value of the variable"),
        ('<svg><path fill="var(--room)" d="M0 0H1"/></svg>', "a.svg", "write the value of the variable"),
        ("<svg><path class='a' fill='none' d='M0 0H1'/></svg>", "a.svg", "neither a fill nor a stroke"),
        ('<svg><path d="M0 0H1"/><svg x="5"><path d="M0 0H1"/></svg></svg>', "a.svg", "a drawing inside the drawing"),
        ('<svg><path style="fill:none;stroke:none" d="M0 0H1"/></svg>', "a.svg", "neither a fill nor a stroke"),
        ('<svg><path fill="none" d="M0 0H1"/></svg>', "a.svg", "neither a fill nor a stroke"),
        ('<svg><g fill="none" stroke="none"><path d="M0 0H1"/></g></svg>', "a.svg", "neither a fill nor a stroke"),
        ('<svg><style>.a{fill:none;stroke:none}</style><path class="a" d="M0 0H1"/></svg>', "a.svg", "neither a fill"),
        ('<svg><path fill="none" stroke="#00000000" d="M0 0H1"/></svg>', "a.svg", "neither a fill nor a stroke"),
        ('<svg><path fill="none" stroke="rgba(1, 2, 3, 0)" d="M0 0H1"/></svg>', "a.svg", "neither a fill nor a stroke"),
        ('<svg><path fill="#ccc0" stroke="rgb(1 2 3 / 0%)" d="M0 0H1"/></svg>', "a.svg", "neither a fill nor a stroke"),
        ('<svg><style>path{transform:none}</style><path d="M0 0H1"/></svg>', "a.svg", "transform in a style is"),
        ('<svg><style>path{fill:none!important}</style><path d="M0 0H1"/></svg>', "a.svg", "leave out !important"),
        ("<svg><style>@media print {path{fill:none}}</style><path d='M0 0H1'/></svg>", "a.svg", "'@media' in its"),
        ('<svg><path d="M0 0 L5 0 L5 5 L0 0"/></svg>', "a.svg", "an open <path> has a fill, and looks solid: close it"),
        ('<svg><polyline points="0 0 5 0 5 5"/></svg>', "a.svg", "an open <polyline> has a fill"),
        ('<svg><path d="M0 0h9v9h-9z M2 2h5v5h-5z"/></svg>', "a.svg", "lies in another one that has a fill"),
        ('<svg><rect width="9" height="9"/><rect x="1" y="1" width="2" height="2"/></svg>', "a.svg", "is no hole in"),
        ('<svg><rect width="-4" height="9"/></svg>', "a.svg", "at least 0 .got -4 and 9"),
        ('<svg><style>rect{width:9px}</style><rect height="9"/></svg>', "a.svg", "width in a style is not read"),
        ('<svg><path d="noneM0 0H1"/></svg>', "a.svg", "n is no command"),
        ('<svg><path style="fill:none;stroke:red;stroke-width:0px" d="M0 0H1"/></svg>', "a.svg", "neither a fill nor"),
        ('<svg><path fill-opacity="0" stroke="red" stroke-opacity="0.0" d="M0 0H1"/></svg>', "a.svg", "neither a fill"),
        ('<svg><switch><path d="M0 0H1"/><g><path d="M0 2H1"/></g></switch></svg>', "a.svg", "one is drawn"),
        ('{"type": "LineString", "coordinates": [[13.4, 52.5], [13.5, 52.5]]}', "a.geojson", "GeoJSON.* in degrees"),
        ("[  WWW ]\n[ W   ]\n", "a.txt", "line 1: a corner should have two numbers(?!.*GeoJSON)"),
        (
            '<svg><path d="M0 0H1" fill="none" stroke="red"/><text>Hall</text></svg>',
            "a.svg",
            "<text> is no wall: delete",
        ),
        ("t,x,y\n0,4,0\n", "a.csv", "line 1: a corner should have two numbers, x y .has 3"),
        ('<svg><path clip-path="url(#c)" d="M0 0H1"/></svg>', "a.svg", "clip-path hides a part, which would be a wall"),
        ('<svg><g style="mask:url(#c)"><path d="M0 0H1"/></g></svg>', "a.svg", "mask hides a part"),
        ("<svg></svg>", "a.svg", "has no shape: paths, lines"),
        ('<svg><rect width="4"/><path d=""/></svg>', "a.svg", "has no shape: paths, lines"),
    ],
)
def test_a_file_that_is_not_read_is_named(tmp_path, content, name, why):
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match=f"{name}.*{why}"):
        Wall.model_validate({"file": name}, context={"folder": tmp_path})


DRAWN = [
    *("opacity:0.5", "opacity:1", "fill-opacity:0;stroke-opacity:1;stroke:red", "fill:none;stroke:red"),
    *("fill:none;stroke:#ff0000;stroke-width:0.5", "fill:#000000;stroke:none", "stroke-width:0", "stroke:none"),
    *("fill:none;stroke:red;stroke-opacity:0.01", "fill:none;stroke:#00ff00", "fill:#aabb00;stroke:none", ""),
    *(
        "fill:rgb(255, 0, 0)",
        "fill:rgba(1, 2, 0, 0.5)",
        "fill:rgb(1 2 0 / 50%)",
        "fill:none;stroke:#0f0",
        "stroke-width:",
    ),
]


def test_what_is_drawn_faintly_or_unfilled_is_a_wall(tmp_path):
    paths = "".join(f'<path style="{style}" d="M0 {k}H1"/>' for k, style in enumerate(DRAWN))
    (tmp_path / "a.svg").write_text(f'<svg pageopacity="0">{paths}</svg>')
    assert len(Wall.model_validate({"file": "a.svg"}, context={"folder": tmp_path}).shapes) == len(DRAWN)


@pytest.mark.parametrize(
    "drawing",
    [
        '<g stroke="black"><path fill="none" d="M0 0H1"/></g>',
        "<style>path{stroke:black}</style><path fill='none' d='M0 0H1'/>",
        "<style>.a{stroke:black}</style><path class='a b' fill='none' d='M0 0H1'/>",
        "<style>g > text{font-size:9px}path{stroke:black}</style><path fill='none' d='M0 0H1'/>",
    ],
)
def test_a_path_may_have_the_stroke_of_a_group_or_of_a_style_sheet(tmp_path, drawing):
    (tmp_path / "a.svg").write_text(f"<svg>{drawing}</svg>")
    assert len(Wall.model_validate({"file": "a.svg"}, context={"folder": tmp_path}).shapes) == 1


UNFILLED = {
    '<path fill="none" stroke="red" DATA/>': False,
    "<path style='fill:none;stroke:red' DATA/>": False,
    "<path style='stroke:red;fill-opacity:0' DATA></path>": False,
    "<path style='stroke:red; /* the hall: free */ fill:none' DATA/>": False,
    "<g fill='None' stroke='red'><path fill='grey' style='fill: UNSET' DATA/></g>": False,
    '<path stroke="red" DATA/>': True,
    '<g fill="none" stroke="red"><path DATA/></g>': False,
    '<g fill="none" stroke="red"><g id="x"></g><g><path fill="grey" DATA/></g></g>': True,
    '<g fill="none" stroke="red"><path d="M8 8H9"/></g><path DATA/>': True,
    "<style>.room, #hall {fill: none; stroke: red}</style><path class='a room' DATA/>": False,
    "<style>.room, #hall {fill: none; stroke: red}</style><path id='hall' fill='grey' DATA/>": False,
    "<style>#hall {fill: none; stroke: red} .room {fill: red}</style><path class='room' id='hall' DATA/>": False,
    "<style>path {fill: none; stroke: red}</style><path style='fill:#ccc' DATA/>": True,
    "<style>.room {fill: none; stroke: red}</style><path class='solid' DATA/>": True,
    "<style>.a {fill: none} .b {fill: none} .a {fill: none} .b {fill: red}</style><path class='b a' DATA/>": True,
}


@pytest.mark.parametrize(("drawing", "is_solid"), UNFILLED.items(), ids=range(len(UNFILLED)))
def test_a_closed_path_without_a_fill_is_a_line_around_a_free_inside(tmp_path, drawing, is_solid):
    """A floor plan: the inside of a room is drawn white, and a player may be in it."""
    data = 'd="m 0 0 h 4 v -3 h -4 z"'
    (tmp_path / "a.svg").write_text(f"<svg>{drawing.replace('DATA', data)}</svg>")
    shape = Wall(file=str(tmp_path / "a.svg")).shapes[-1]
    ring = [[0, 0], [4, 0], [4, 3], [0, 3]]
    assert shape.closed == is_solid
    assert shape.corners.tolist() == (ring if is_solid else [*ring, [0, 0]])


SHAPES = {
    '<line x1="1" y1="2" x2="3" y2="4" stroke="red"/>': ([[1, -2], [3, -4]], False),
    '<polyline points="1,2 3,4 5-6" fill="none" stroke="red"/>': ([[1, -2], [3, -4], [5, 6]], False),
    '<path d="M9 9z"/><path fill="none" d=" M9 9 "/><path d="M1 2v0H3h0"/>': ([[1, -2], [3, -2]], False),
    '<polygon points="1 2 3 4 5 2"/>': ([[1, -2], [3, -4], [5, -2]], True),
    '<polygon fill="none" stroke="red" points="1 2 3 4 5 2"/>': ([[1, -2], [3, -4], [5, -2], [1, -2]], False),
    '<rect x="1" y="2px" width="3" height="4"/>': ([[1, -2], [4, -2], [4, -6], [1, -6]], True),
    '<s:path xmlns:s="http://www.w3.org/2000/svg" d="M1 2H3"/>': ([[1, -2], [3, -2]], False),
    '<g display="none"/><o:path xmlns:o="urn:other" d="M9 9H8"/><path d="M1 2H3"/>': ([[1, -2], [3, -2]], False),
    '<g visibility="hidden"><path visibility="visible" d="M1 2H3"/></g>': ([[1, -2], [3, -2]], False),
    '<g transform="translate(10, -20)"><path transform="scale(2)" d="M1 2H3"/></g>': ([[12, 16], [16, 16]], False),
    '<path transform="translate(5)rotate(90)" d="M1 2H3"/>': ([[3, -1], [3, -3]], False),
    '<path transform="rotate(-90, 1 2)" d="M1 2H3"/>': ([[1, -2], [1, 0]], False),
    '<path transform="matrix(1 0 0 -1 0 7) , scale(2,3)" d="M1 2H3"/>': ([[2, -1], [6, -1]], False),
    '<g transform=" "><path d="M1 2H3"/></g>': ([[1, -2], [3, -2]], False),
    '<!-- <?xml-stylesheet?> --><path style="rotate: none" d="M1 2H3"/>': ([[1, -2], [3, -2]], False),
    '<path transform="matrix(1 2 3 4 5 6) matrix(7 8 9 10 11 12)" d="M1 2H3"/>': ([[161, -238], [223, -330]], False),
    '<path transform="skewX(45)" d="M1 2H3"/>': ([[3, -2], [5, -2]], False),
    '<path transform="skewY(-45)" d="M1 2H3"/>': ([[1, -1], [3, 1]], False),
    "<style>/* x */ @import 'a;b'; @font-face {src: c} .a {stroke: red} path {fill: none; stroke: none}</style>"
    '<path class="a" d="M1 2H3"/>': ([[1, -2], [3, -2]], False),
}


@pytest.mark.parametrize(("drawing", "expected"), SHAPES.items(), ids=range(len(SHAPES)))
def test_a_drawing_is_read_as_it_is_shown(tmp_path, drawing, expected):
    """The y axis of SVG points down: a turn by 90 degrees is clockwise there, from x to y."""
    doctype = '<?xml version="1.0"?><!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" "http://www.w3.org/svg11.dtd">'
    (tmp_path / "a.svg").write_text(f'{doctype}<svg xmlns="http://www.w3.org/2000/svg">{drawing}</svg>')
    (shape,) = Wall(file=str(tmp_path / "a.svg")).shapes
    assert (shape.corners.round(12).tolist(), shape.closed) == expected


HOLLOW = [
    '<path d="M0 0h9v9h-9z M2 2v5h5v-5z"/>',
    '<path fill-rule="evenodd" d="M0 0h9v9h-9z M2 2h5v5h-5z"/>',
    '<g style="fill-rule:evenodd" transform="scale(-1 1)"><path d="M0 0h9v9h-9z M2 2h5v5h-5z"/></g>',
    '<path d="M0 0h9v9h-9z M2 2v5h5v-5z"/><rect x="3" y="3" width="1" height="1"/>',
    '<path d="M20 0h9v9h-9z"/><path d="M0 0h9v9h-9z M2 2v5h5v-5z"/>',
]


@pytest.mark.parametrize("drawing", HOLLOW, ids=range(len(HOLLOW)))
def test_a_hole_of_a_drawing_is_a_hole_by_its_fill_rule(tmp_path, drawing):
    (tmp_path / "a.svg").write_text(f"<svg>{drawing}</svg>")
    x = np.array([0.5, 2.5, 3.5]) * (-1 if "scale" in drawing else 1)
    shapes = Wall(file=str(tmp_path / "a.svg")).shapes
    inside = are_inside(np.column_stack([x, [-0.5, -2.5, -3.5]]), shapes)
    assert inside.tolist() == [True, False, len(shapes) == 3 and "rect" in drawing]


LONG = [
    "<style>" + "a" * 100_000 + "</style>",
    "<style>@import url('data:" + "a" * 100_000 + "'); " + "/*" * 50_000 + "</style>",
    f"<style>{''.join(f'.a{k}{{fill:red}}' for k in range(3000))}</style>" + "<path class='a7' d='M0 0H1'/>" * 2999,
]


@pytest.mark.parametrize(("text", "count"), list(zip(LONG, (1, 1, 3000), strict=True)), ids=range(3))
def test_a_long_style_sheet_is_read_once(tmp_path, text, count):
    """A search that began anew at each sign took minutes."""
    (tmp_path / "a.svg").write_text(f'<svg>{text}<path d="M0 0H1"/></svg>')
    assert wkt_in(tmp_path / "a.svg").count("LINESTRING") == count


def test_a_drawing_of_many_groups_is_read(tmp_path):
    (tmp_path / "a.svg").write_text("<svg>" + "<g>" * 5000 + '<path d="M0 0H1"/>' + "</g>" * 5000 + "</svg>")
    assert len(Wall(file=str(tmp_path / "a.svg")).shapes) == 1


def test_a_file_outside_of_the_folder_needs_trust(tmp_path):
    with pytest.raises(ValueError, match="leads out of the folder"):
        Wall.model_validate({"file": "../a.wkt"}, context={"folder": tmp_path})


def test_keys_of_radio_have_no_effect_without_radio_or_without_a_material():
    assert "thickness" in Wall(line=SQUARE).unused_fields
    assert set(Wall(line=SQUARE, blocks=("sight",)).unused_fields) == {"loss", "material", "thickness", "frequency"}
    assert not Wall(line=SQUARE, material="wood").unused_fields
    assert [Wall(line=SQUARE, blocks=blocks).decibels for blocks in (("motion",), ("radio",))] == [0.0, inf]


def test_the_edges_that_block_something_know_their_wall():
    walls = [Wall(line=SQUARE, blocks=("sight",)), Wall(polygon=SQUARE), Wall(svg="M0 0H1M2 0H3")]
    assert blocking(walls, "sight").owners.tolist() == [0, 0, 0, 1, 1, 1, 1, 2, 2]
    assert blocking(walls, "radio").owners.tolist() == [1, 1, 1, 1, 2, 2]
    assert not blocking(walls[:1], "radio")


# Materials: Recommendation ITU-R P.2040-3.

TABLE = [
    ("concrete", 0.10, 4.84, 8.10),
    ("concrete", 0.20, 7.49, 14.57),
    ("brick", 0.24, 5.55, 6.63),
    ("plasterboard", 0.025, 0.76, 1.24),
    ("wood", 0.04, 0.58, 0.61),
    ("glass", 0.006, 0.37, 1.91),
]
"""Material, thickness, m, and loss at 0.868 and 2.4 GHz, dB, computed outside of desim."""


@pytest.mark.parametrize(("material", "thickness", "low", "high"), TABLE)
def test_the_loss_of_a_slab_is_that_of_the_recommendation(material, thickness, low, high):
    losses = [slab_loss(material, thickness, frequency) for frequency in (0.868e9, 2.4e9)]
    assert losses == pytest.approx([low, high], abs=0.005001)
    assert abs(slab_loss(material, 1.1 * thickness, 2.4e9) - high) > 0.01  # a slab that is a tenth thicker
    wall = Wall(line=SQUARE, material=material, thickness=thickness, frequency=0.868e9)
    assert wall.decibels == losses[0]


def test_a_thick_slab_attenuates_as_its_material_and_a_thin_one_not_at_all():
    """In a thick slab the loss per metre is 1636 c / sqrt(a) f^d / (1 + small), dB; metal is opaque in practice."""
    per_metre = slab_loss("wood", 21.0, 10e9) - slab_loss("wood", 20.0, 10e9)
    sigma, a = 0.0047 * 10**1.0718, 1.99
    assert per_metre == pytest.approx(1636.0 * sigma / sqrt(a), rel=0.01)
    assert all(slab_loss(name, 1e-6, 60e9 if name == "floorboard" else 2e9) >= 0.0 for name in MATERIALS)
    assert slab_loss("glass", 1e-6, 2e9) < 1e-3
    assert slab_loss("metal", 0.01, 2e9) > 1000.0


# Crossings.


def test_a_ray_crosses_a_wall_between_its_ends():
    wall = (0, -1), (0, 1)
    assert crossed((-1, 0), (1, 0), wall) == crossed((1, 0), (-1, 0), wall) == 1
    assert crossed((-1, 0), (-0.5, 0), wall) == crossed((-1, 2), (1, 2), wall) == crossed((0, 2), (0, 3), wall) == 0
    assert crossed((-1, 0), (-1, 0), wall) == 0


def test_a_ray_and_its_reverse_cross_the_same_walls():
    """All rays and all walls between nine points, so that many corners lie exactly on a ray."""
    points = np.array([[x, y] for x in range(3) for y in range(3)], dtype=float)
    starts, ends = (points[[pair[k] for pair in permutations(range(9), 2)]] for k in (0, 1))
    crossed = crossings(starts, ends, Segments.of(starts, ends))
    assert (crossed == crossings(ends, starts, Segments.of(starts, ends))).all()
    assert 500 < crossed.sum() < 4000


@pytest.mark.parametrize("turn", range(8))
def test_no_ray_slips_through_where_walls_meet(turn):
    """A ray through the common corner of two walls on its two sides crosses one of them, and of a V both or none."""
    turned = np.array([[0, 1], [-1, 0]]) if turn % 2 else np.eye(2)
    turned = turned * (-1 if turn % 4 > 1 else 1)
    points = np.array([[-2, 0], [2, 0], [0, 0], [1, 3], [-1, -3], [1, -2]]) @ turned
    start, end, corner, above, below, below_too = points.tolist()
    if turn > 3:
        start, end = end, start
    assert crossed(start, end, (corner, above), (corner, below)) == 1
    assert crossed(start, end, (above, corner), (below, corner)) == 1
    assert crossed(start, end, (below, corner), (corner, below_too)) in {0, 2}


def test_a_path_may_touch_walls_with_a_margin():
    wall = (0, 0), (0, 4)
    assert crossed((-1, 0), (1, 0), wall, margin=1e-9) == 0  # past its end
    assert crossed((-1, 1), (0, 1), wall, margin=1e-9) == 0  # up to it
    assert crossed((0, -1), (0, 5), wall, margin=1e-9) == 0  # along it
    assert crossed((-1, 1), (1, 1), wall, margin=1e-9) == 1
    assert crossed((-1, 1), (1e-3, 1), wall, margin=1e-2) == 0
    assert crossed((-1, 1), (1e-3, 1), wall, margin=1e-4) == 1


GRID = st.tuples(st.integers(-6, 6), st.integers(-6, 6))


def exact(start, end, first, second):
    """Return whether a ray crosses a wall, in exact arithmetic: a point on a line is left of it."""
    start, end = sorted([start, end])

    def left(a, b, point):
        (ax, ay), (bx, by), (x, y) = (tuple(map(Fraction, place)) for place in (a, b, point))
        return (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0

    apart = left(start, end, first) != left(start, end, second)
    return apart and left(first, second, start) != left(first, second, end)


@pytest.mark.slow
@given(GRID, GRID, st.lists(st.tuples(GRID, GRID).filter(lambda wall: wall[0] != wall[1]), min_size=1, max_size=5))
def test_crossings_are_those_of_exact_arithmetic_and_do_not_depend_on_the_direction(start, end, walls):
    rays = np.array([start, end], dtype=float), np.array([end, start], dtype=float)
    answers = crossings(*rays, segments(*walls)).tolist()
    assert answers[0] == answers[1] == [exact(start, end, *wall) for wall in walls]


@given(st.lists(GRID, min_size=3, max_size=7, unique=True), GRID, GRID)
def test_a_ray_that_leaves_a_polygon_crosses_its_edges_an_odd_number_of_times(corners, start, end):
    ring = WallShape(np.array(corners, dtype=float), closed=True)
    edges = segments_of([(0, ring)])
    ends = np.array([start, end]) + np.array([0.31, 0.17])  # not on an edge
    odd = crossings(ends[:1], ends[1:], edges).sum() % 2 == 1
    first, second = are_inside(ends, [ring])
    assert odd == (first != second)


def test_the_gap_is_the_distance_from_the_nearest_wall():
    walls = segments(((0, 0), (4, 0)), ((0, 5), (4, 5)))
    assert gaps(np.array([[2.0, 1.0], [-3.0, 4.0], [7.0, 9.0], [2.0, 0.0]]), walls).tolist() == [
        1.0,
        sqrt(10),
        5.0,
        0.0,
    ]
    assert gaps(np.zeros((1, 2)), segments()).tolist() == [inf]


def test_edges_that_touch_are_found_among_many():
    rng = np.random.default_rng(3)
    places = rng.permutation(144)
    rings = [
        (k, WallShape(np.array(SQUARE) * 0.25 + [3.0 * (place % 12), 3.0 * (place // 12)], closed=True))
        for k, place in enumerate(places.tolist())
    ]
    assert first_contact(rings) is None
    moved = rings[70][1].corners + rings[110][1].corners[0] - rings[70][1].corners[2]
    contact = first_contact([*rings[:70], (70, WallShape(moved, closed=True)), *rings[71:]])
    assert (contact.first, contact.second) == (70, 110)


def test_edges_that_go_back_are_those_of_one_polygon_also_if_several_have_some():
    """The second edge of each triangle of no area goes back on the first."""
    flat = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.0]])
    contact = first_contact([(k, WallShape(flat + np.array([0.0, k]), closed=True)) for k in range(3)])
    assert (contact.first, contact.second) == (0, 0)
    assert contact.ends == [[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [1.0, 0.0]]


def random_fields(fields, density, length, distance, seed):
    """Return how many walls a line of a length crosses in each of many random fields of segments."""
    rng = np.random.default_rng(seed)
    low, high = np.array([-length / 2, -length / 2]), np.array([distance + length / 2, length / 2])
    count = rng.poisson(fields * density * np.prod(high - low))
    centres, angles = rng.uniform(low, high, size=(count, 2)), rng.uniform(0.0, pi, size=count)
    halves = length / 2 * np.column_stack([np.cos(angles), np.sin(angles)])
    walls = Segments.of(centres - halves, centres + halves)
    hit = crossings(np.zeros((1, 2)), np.array([[distance, 0.0]]), walls)[0]
    return np.bincount(rng.integers(fields, size=count)[hit], minlength=fields)


def test_the_number_of_random_walls_on_a_line_is_poisson():
    """The mean is 2 density length d / pi = .636620, and P(0) = .529078; a density 8 % higher is told apart."""
    fields = 40_000
    mean = 2.0 * 0.01 * 5.0 * 20.0 / pi
    error = sqrt(exp(-mean) * (1.0 - exp(-mean)) / fields)
    numbers = random_fields(fields, 0.01, 5.0, 20.0, seed=1)
    assert exp(-mean) == pytest.approx(0.529078, abs=1e-6)
    assert abs((numbers == 0).mean() - exp(-mean)) < 3.0 * error
    assert numbers.var() == pytest.approx(mean, abs=4.0 * sqrt((mean + 2.0 * mean**2) / fields))
    denser = random_fields(fields, 0.0108, 5.0, 20.0, seed=1)
    assert abs((denser == 0).mean() - exp(-mean)) > 3.0 * error

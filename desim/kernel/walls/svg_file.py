"""Drawings in SVG (W3C, SVG 1.1, Second Edition) as walls: the lines and rings that a browser shows.

Paths, lines, polylines, polygons and rectangles are read, with transformations and inherited styles. A closed shape
that has a fill is a ring. One without a fill is a line, and its inside is free, as that of a room in a floor plan. A
shape without a fill needs a stroke. Anything else that would be read otherwise than it looks is refused: hidden parts,
curves, open shapes with a fill, solid shapes in others, and repeated objects (<use>).
"""

import re
from collections.abc import Callable, Iterator, Mapping
from itertools import count
from math import cos, radians, sin, tan
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from desim.config.arrays import Floats
from desim.config.number_files import number_of
from desim.config.number_texts import counted
from desim.kernel.walls.crossings import WallShape, are_inside
from desim.kernel.walls.outlines import SVG_NUMBER, Outline, svg_outlines

NAMESPACES = frozenset({"", "http://www.w3.org/2000/svg"})
GROUPS = frozenset({"svg", "g", "a"})
REFUSED = {
    "switch": "of the parts of a <switch> one is drawn, and all would be walls: delete the others",
    "text": "<text> is no wall: delete it in the editor",
}
REFUSED |= {
    name: f"<{name}> is not read: convert objects to paths in the editor"
    for name in ("circle", "ellipse", "use", "image", "foreignObject")
}
"""The elements that are drawn and not read, and why. Any other element that is no group and no shape draws nothing
where it stands."""
INHERITED = frozenset({"fill", "fill-opacity", "fill-rule", "stroke", "stroke-opacity", "stroke-width", "visibility"})
"""The properties that elements inherit."""
MOVES = frozenset({"translate", "rotate", "scale"})
PLACES = MOVES | {"transform", "transform-origin", "d", "x", "y", "width", "height", "rx", "ry"}
"""The properties that say where an element is drawn; as attributes they are read, or have no effect; only
transform-origin is refused."""
PROPERTIES = INHERITED | PLACES | {"display", "opacity", "clip-path", "mask"}
"""The properties that say what is drawn."""
DEFAULTS = frozenset({"inherit", "unset", "revert"})
"""Values with which a property is as if it were not given."""
COMMENT = re.compile(r"/\*.*?(?:\*/|\Z)", re.DOTALL)
XML_COMMENT = re.compile(r"<!--.*?(?:-->|\Z)", re.DOTALL)
SELECTOR = re.compile(r"(\*|[\w-]+)?(?:([.#])([\w-]+))?")
"""Matches a selector by element, class or id."""
ZERO = r"(?:0+\.?0*|\.0+)(?:[a-zA-Z]+|%)?"
"""Matches an opacity or a width that does not show."""
NO_COLOUR = re.compile(
    rf"none|transparent|\w+\((?:[^,]*,){{3}}\s*{ZERO}\s*\)|\w+\([^/]*/\s*{ZERO}\s*\)|#[\da-f]{{6}}00|#[\da-f]{{3}}0",
    re.IGNORECASE,
)
"""Matches a paint that does not show."""
TRANSFORMATION = re.compile(r"\s*,?\s*(\w+)\s*\(([^()]*)\)\s*")

Transformation = tuple[float, float, float, float, float, float]
"""a, b, c, d, e, f: x and y become a x + c y + e and b x + d y + f."""


class _Inherited(NamedTuple):
    """What an element inherits from the groups that it is in."""

    style: Mapping[str, str]
    """The inherited properties."""
    matrix: Transformation
    hidden: str
    """Why none of its parts show; "" if they do."""


class _Drawn(NamedTuple):
    """An outline as it is drawn."""

    outline: Outline
    element: int
    """The number of the element that it belongs to."""
    is_evenodd: bool
    """Whether `fill-rule` is evenodd, not nonzero."""


def svg_file_outlines(text: str) -> list[Outline]:
    """Return the outlines in a drawing, in the order in which they are drawn; y points up.

    Raises:
        ValueError: if the text is no drawing, or a part of it would be read otherwise than it looks.
    """
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"is not a drawing in SVG: {error}") from error
    if _name(root) != "svg":
        raise ValueError(f"is not a drawing in SVG: its first element is <{root.tag.rpartition('}')[2]}>")
    if "<?xml-stylesheet" in XML_COMMENT.sub("", text):
        raise ValueError("a style sheet in another file is not read: give styles to objects")
    rules = _style_rules(root)
    drawn: list[_Drawn] = []
    pending = [(root, _Inherited({}, (1.0, 0.0, 0.0, 1.0, 0.0, 0.0), ""))]
    while pending:
        element, inherited = pending.pop()
        name = _name(element)
        if name == "svg" and element is not root:
            raise ValueError("a drawing inside the drawing (<svg>) is not read: ungroup it in the editor")
        if name in REFUSED:
            raise ValueError(REFUSED[name])
        if name not in GROUPS and name not in SHAPES:
            continue
        properties = _style(element, name, rules)
        inherited = _within(inherited, properties)
        if name in SHAPES and (outlines := svg_outlines(SHAPES[name](element))):  # a single point draws nothing
            is_evenodd = inherited.style.get("fill-rule") == "evenodd"
            number = drawn[-1].element + 1 if drawn else 0
            drawn += [_Drawn(outline, number, is_evenodd) for outline in _placed(outlines, name, inherited)]
        pending += [(child, inherited) for child in reversed(element)]  # the first child is taken first
    _check_nesting([shape for shape in drawn if shape.outline.closed])
    return [shape.outline for shape in drawn]


def _check_nesting(rings: list[_Drawn]) -> None:
    """Raise ValueError unless nested rings are filled and empty in turns, as those of a wall are."""
    if len(rings) < 2:
        return
    shapes = [WallShape(np.array(ring.outline.corners), closed=True) for ring in rings]
    first_corners = np.array([shape.corners[0] for shape in shapes])
    is_within = np.array([are_inside(first_corners, [shape]) for shape in shapes])  # (outer, inner)
    np.fill_diagonal(is_within, val=True)
    turns = np.array([_turn(shape.corners) for shape in shapes])
    elements = np.array([ring.element for ring in rings])
    solid = np.zeros(len(rings), dtype=bool)
    for element in np.unique(elements):
        of_element = elements == element
        if rings[int(of_element.argmax())].is_evenodd:
            solid |= is_within[of_element].sum(axis=0) % 2 == 1
        else:
            solid |= (turns[of_element, np.newaxis] * is_within[of_element]).sum(axis=0) != 0
    if (solid != (is_within.sum(axis=0) % 2 == 1)).any():
        raise ValueError(
            "a closed shape lies in another one that has a fill, and is no hole in it: delete the inner one, or unite"
            " them in the editor"
        )


def _turn(corners: Floats) -> int:
    """Return the winding number of a ring about its inside: 1 if its corners are anticlockwise, else -1."""
    x, y = (corners - corners[0]).T
    return 1 if (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0.0 else -1


def _name(element: ElementTree.Element) -> str:
    """Return the name of an element; "" if it is none of SVG."""
    space, _, name = element.tag.rpartition("}")
    return name if space.removeprefix("{") in NAMESPACES else ""


# Styles.


class _Rule(NamedTuple):
    """A rule of a style sheet for one selector."""

    weight: tuple[int, int]
    """The sum of 4 for an id, 2 for a class and 1 for an element, and the number of the rule; the greatest wins."""
    element: str
    """"": all."""
    style: Mapping[str, str]


_Rules = dict[str, list[_Rule]]
"""By selector without its element: `.class`, `#id`, or "" for all."""


def _style_rules(root: ElementTree.Element) -> _Rules:
    """Return the rules of all style sheets that say what is drawn."""
    rules: _Rules = {}
    rule_numbers = count()
    for sheet in root.iter():
        if _name(sheet) != "style" or sheet.get("media", "all") not in {"all", "screen"}:
            continue
        for part in COMMENT.sub("", sheet.text or "").split("}"):
            selectors, _, body = part.partition("{")
            selectors = selectors.rpartition(";")[2].strip()  # statements such as @import end with a semicolon
            if selectors.startswith("@") and selectors != "@font-face":
                raise ValueError(f"{selectors.split()[0]!r} in its style sheet is not read: give styles to objects")
            if not (style := _declarations(body)):
                continue
            for selector in map(str.strip, selectors.split(",")):
                match = SELECTOR.fullmatch(selector)
                if match is None:
                    raise ValueError(
                        f"the selector {selector!r} of its style sheet is not read: give styles to objects"
                    )
                element, kind = (match[1] or "").strip("*"), match[2] or ""
                weight = {"": 0, ".": 2, "#": 4}[kind] + bool(element), next(rule_numbers)
                rules.setdefault(kind + (match[3] or ""), []).append(_Rule(weight, element, style))
    return rules


def _declarations(text: str) -> dict[str, str]:
    """Return the properties in a list `name: value; ...` that say what is drawn."""
    pairs = (part.partition(":") for part in COMMENT.sub("", text).split(";"))
    properties = ((name.strip().lower(), value.strip().lower()) for name, sign, value in pairs if sign)
    style = {name: value for name, value in properties if name in PROPERTIES}
    for name, value in style.items():
        if "!" in value:
            raise ValueError(f"'{name}: {value}' is not read: leave out !important")
        if name in PLACES and not (name in MOVES and value == "none"):
            raise ValueError(f"{name} in a style is not read: make it an attribute in the editor")
    return style


def _style(element: ElementTree.Element, name: str, rules: _Rules) -> dict[str, str]:
    """Return the properties of an element: its style overrides the rules of style sheets, and these its attributes."""
    stripped = {key: value.strip() for key, value in element.attrib.items() if key in PROPERTIES}
    attributes = {key: value if key in PLACES else value.lower() for key, value in stripped.items()}
    if "transform-origin" in attributes:
        raise ValueError("transform-origin is not read: apply transformations in the editor")
    keys = ["", *(f".{word}" for word in element.get("class", "").split()), f"#{element.get('id')}"]
    matching = [rule for key in keys for rule in rules.get(key, ()) if rule.element in {"", name}]
    for rule in sorted(matching, key=lambda rule: rule.weight):
        attributes |= rule.style
    attributes |= _declarations(element.get("style", ""))
    if variable := next((key for key, value in attributes.items() if "var(" in value), ""):
        raise ValueError(f"'{variable}: {attributes[variable]}' is not read: write the value of the variable")
    return {key: value for key, value in attributes.items() if value not in DEFAULTS}


def _within(inherited: _Inherited, properties: Mapping[str, str]) -> _Inherited:
    """Return what the children of an element inherit, given what the element inherits and its properties."""
    for key in ("clip-path", "mask"):
        if properties.get(key, "none") != "none":
            raise ValueError(f"{key} hides a part, which would be a wall: release it in the editor")
    hidden = inherited.hidden
    if properties.get("display") == "none":
        hidden = "display: none"
    elif re.fullmatch(ZERO, properties.get("opacity", "1")):
        hidden = f"opacity: {properties['opacity']}"
    style = {**inherited.style, **{key: value for key, value in properties.items() if key in INHERITED}}
    return _Inherited(style, _product(inherited.matrix, _matrix(properties.get("transform", ""))), hidden)


def _placed(outlines: list[Outline], name: str, inherited: _Inherited) -> Iterator[Outline]:
    """Yield the outlines of a shape where they are drawn; raise ValueError if a wall would differ from the drawing."""
    style, (a, b, c, d, e, f) = inherited.style, inherited.matrix
    visibility = style.get("visibility", "visible")
    if hidden := inherited.hidden or (f"visibility: {visibility}" if visibility in {"hidden", "collapse"} else ""):
        raise ValueError(f"{hidden!r} hides a <{name}>, which would be a wall: delete it, or show it")
    has_fill = _shows(style, "fill", "black", "fill-opacity")
    if not has_fill and not _shows(style, "stroke", "none", "stroke-opacity", "stroke-width"):
        raise ValueError(
            f"a <{name}> has neither a fill nor a stroke, and would be a wall: delete it, or give it a stroke"
        )
    for corners, closed in outlines:
        if has_fill and not closed and len(corners) > 2:
            raise ValueError(f"an open <{name}> has a fill, and looks solid: close it, or take away its fill")
        # The outline has y up, the transformation is for y down.
        moved = tuple((a * x - c * y + e, d * y - b * x - f) for x, y in corners)
        is_free = closed and not has_fill  # then it is a line that ends where it begins
        yield Outline((*moved, moved[0]) if is_free else moved, closed and has_fill)


def _shows(style: Mapping[str, str], paint: str, default: str, *sizes: str) -> bool:
    """Return whether a paint shows: it has a colour, and none of its sizes is 0."""
    return not (
        NO_COLOUR.fullmatch(style.get(paint, default))
        or any(re.fullmatch(ZERO, style.get(size, "1")) for size in sizes)
    )


# Transformations.


def _numbers(text: str) -> list[float]:
    """Return the numbers in a list; a comma, white space or a sign begins another."""
    numbers = re.findall(SVG_NUMBER, text)
    if re.sub(r"[\s,]", "", text) != "".join(numbers):
        raise ValueError(f"transform: {text.strip()!r} should be numbers; angles are in degrees")
    return [float(number) for number in numbers]


def _matrix(text: str) -> Transformation:
    """Return the product of the transformations in an attribute."""
    matrix: Transformation = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    at = 0
    while at < len(text):
        match = TRANSFORMATION.match(text, at)
        if match is None:
            raise ValueError(f"transform: {text[at : at + 20]!r} is no transformation of SVG")
        matrix, at = _product(matrix, _transformation(match[1], _numbers(match[2]))), match.end()
    return matrix


def _transformation(kind: str, numbers: list[float]) -> Transformation:
    match kind, numbers:
        case "matrix", [a, b, c, d, e, f]:
            return a, b, c, d, e, f
        case "translate", [x]:
            return 1.0, 0.0, 0.0, 1.0, x, 0.0
        case "translate", [x, y]:
            return 1.0, 0.0, 0.0, 1.0, x, y
        case "scale", [factor]:
            return factor, 0.0, 0.0, factor, 0.0, 0.0
        case "scale", [along_x, along_y]:
            return along_x, 0.0, 0.0, along_y, 0.0, 0.0
        case "rotate", [degrees]:
            quarters, remainder = divmod(degrees, 90.0)  # quarter turns are exact
            c, s = cos(radians(remainder)), sin(radians(remainder))
            for _ in range(int(quarters) % 4):
                c, s = -s, c
            return c, s, -s, c, 0.0, 0.0
        case "rotate", [degrees, x, y]:
            about = _product((1.0, 0.0, 0.0, 1.0, x, y), _transformation("rotate", [degrees]))
            return _product(about, (1.0, 0.0, 0.0, 1.0, -x, -y))
        case "skewX", [degrees]:
            return 1.0, 0.0, tan(radians(degrees)), 1.0, 0.0, 0.0
        case "skewY", [degrees]:
            return 1.0, tan(radians(degrees)), 0.0, 1.0, 0.0, 0.0
    raise ValueError(f"transform: {kind} with {counted(len(numbers), 'number')} is no transformation of SVG")


def _product(first: Transformation, second: Transformation) -> Transformation:
    """Return the transformation that does the second, then the first."""
    a, b, c, d, e, f = first
    p, q, r, s, t, u = second
    return (a * p + c * q, b * p + d * q, a * r + c * s, b * r + d * s, a * t + c * u + e, b * t + d * u + f)


# Shapes.


def _line(element: ElementTree.Element) -> str:
    x, y, u, v = (_length(element, key) for key in ("x1", "y1", "x2", "y2"))
    return f"M {x!r} {y!r} L {u!r} {v!r}"


def _rect(element: ElementTree.Element) -> str:
    x, y, width, height, rx, ry = (_length(element, key) for key in ("x", "y", "width", "height", "rx", "ry"))
    if rx or ry:
        raise ValueError("<rect> has round corners: make them straight in the editor")
    if width < 0.0 or height < 0.0:
        raise ValueError(f"<rect> should have a width and a height of at least 0 (got {width:g} and {height:g})")
    return f"M {x!r} {y!r} h {width!r} v {height!r} h {-width!r} Z" if width and height else ""


def _points(element: ElementTree.Element) -> str:
    points = element.get("points", "").strip()
    return f"M {points}" if points else ""


def _length(element: ElementTree.Element, key: str) -> float:
    """Return a length in the unit of the drawing; 0 if it is absent."""
    text = element.get(key, "0").strip()
    try:
        return number_of(text.removesuffix("px"))
    except ValueError as error:
        raise ValueError(f"<{_name(element)}> {key}: {text!r} should be a number in the unit of the drawing") from error


SHAPES: Mapping[str, Callable[[ElementTree.Element], str]] = {
    "path": lambda element: "" if (data := element.get("d", "").strip()) == "none" else data,
    "line": _line,
    "polyline": _points,
    "polygon": lambda element: f"{points} Z" if (points := _points(element)) else "",
    "rect": _rect,
}
"""The elements that are read: each as the data of a path, "" if nothing is drawn."""

"""Drawings in SVG (W3C, SVG 1.1, Second Edition) as walls: the lines and rings that a browser shows.

Paths, lines, polylines, polygons and rectangles are read, with transformations and inherited styles. A closed shape
that has a fill is a ring. One without a fill is a line, and its inside is free, as that of a room in a floor plan.
What would look otherwise than it is read is refused: hidden parts, curves, and objects that are drawn by others.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from math import cos, radians, sin, tan
from typing import NamedTuple
from xml.etree import ElementTree

from desim.config.number_files import number_of
from desim.kernel.walls.outlines import Outline, svg_outlines

NAMESPACES = frozenset({"", "http://www.w3.org/2000/svg"})
GROUPS = frozenset({"svg", "g", "a"})
REFUSED = frozenset({"circle", "ellipse", "use", "image", "text", "foreignObject"})
"""Elements that are drawn, and not read. All others that are not named here are not drawn where they stand."""
INHERITED = frozenset({"fill", "fill-opacity", "stroke", "stroke-opacity", "stroke-width", "visibility"})
"""The properties that elements have from those around them."""
PROPERTIES = INHERITED | {"display", "opacity", "clip-path", "mask", "transform", "transform-origin"}
"""The properties that say what is drawn."""
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
RULE = re.compile(r"([^{}]+)\{([^{}]*)\}")
"""Matches the selectors and the body of a rule of a style sheet."""
SELECTOR = re.compile(r"(\*|[\w-]+)?(?:([.#])([\w-]+))?")
"""Matches a selector by element, class or id."""
ZERO = r"(?:0+\.?0*|\.0+)(?:[a-zA-Z]+|%)?"
"""Matches an opacity or a width that does not show."""
NO_COLOUR = re.compile(
    rf"none|transparent|\w+\((?:[^,]*,){{3}}\s*{ZERO}\s*\)|\w+\([^/]*/\s*{ZERO}\s*\)|#[\da-f]{{6}}00|#[\da-f]{{3}}0",
    re.IGNORECASE,
)
"""Matches a paint that does not show."""
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
TRANSFORMATION = re.compile(r"\s*,?\s*(\w+)\s*\(([^()]*)\)\s*")

Transformation = tuple[float, float, float, float, float, float]
"""a, b, c, d, e, f: x and y become a x + c y + e and b x + d y + f."""


class _Around(NamedTuple):
    """What an element has from those around it."""

    style: Mapping[str, str]
    """The inherited properties."""
    matrix: Transformation
    hidden: str
    """Why none of its parts show; "" if they do."""


def svg_file_outlines(text: str) -> Iterator[Outline]:
    """Yield the outlines in a drawing, in the order in which they are drawn; y points up.

    Raises:
        ValueError: if the text is no drawing, or has something that would be read otherwise than it looks.
    """
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"is not a drawing in SVG: {error}") from error
    if _name(root) != "svg":
        raise ValueError(f"is not a drawing in SVG: its first element is <{root.tag.rpartition('}')[2]}>")
    rules = _style_rules(root)
    waiting = [(root, _Around({}, (1.0, 0.0, 0.0, 1.0, 0.0, 0.0), ""))]
    while waiting:
        element, around = waiting.pop()
        name = _name(element)
        if name == "svg" and element is not root:
            raise ValueError("a drawing inside the drawing (<svg>) is not read: ungroup it in the editor")
        if name == "switch":
            raise ValueError("of the parts of a <switch> one is drawn, and all would be walls: delete the others")
        if name in REFUSED:
            raise ValueError(f"<{name}> is not read: convert objects to paths in the editor")
        if name not in GROUPS and name not in SHAPES:
            continue
        properties = _style(element, name, rules)
        around = _within(around, properties)
        if name in SHAPES and (data := SHAPES[name](element)):
            yield from _drawn(svg_outlines(data), name, around)
        waiting += [(child, around) for child in reversed(element)]


def _name(element: ElementTree.Element) -> str:
    """Return the name of an element; "" if it is none of SVG."""
    space, _, name = element.tag.rpartition("}")
    return name if space.removeprefix("{") in NAMESPACES else ""


# Styles.


class _Rule(NamedTuple):
    """A rule of a style sheet for one selector."""

    weight: int
    """The greater one counts: 0 for elements, 1 for classes, 2 for ids."""
    element: str
    """"": all."""
    kind: str
    """`.`: a class; `#`: an id; "": neither."""
    called: str
    """The class or the id."""
    style: Mapping[str, str]

    def concerns(self, element: ElementTree.Element, name: str) -> bool:
        """Return whether it is for an element with a name."""
        if self.element and self.element != name:
            return False
        if self.kind == ".":
            return self.called in element.get("class", "").split()
        return not self.kind or element.get("id") == self.called


def _style_rules(root: ElementTree.Element) -> list[_Rule]:
    """Return the rules of all style sheets that say what is drawn, the last of which counts."""
    rules: list[_Rule] = []
    for sheet in root.iter():
        if _name(sheet) != "style":
            continue
        for selectors, body in RULE.findall(COMMENT.sub("", sheet.text or "")):
            if not (style := _declarations(body)):
                continue
            for selector in map(str.strip, selectors.split(",")):
                match = SELECTOR.fullmatch(selector)
                if match is None:
                    raise ValueError(
                        f"the selector {selector!r} of its style sheet is not read: give styles to objects"
                    )
                weight = {".": 1, "#": 2}.get(match[2], 0)
                rules.append(_Rule(weight, (match[1] or "").strip("*"), match[2] or "", match[3] or "", style))
    return sorted(rules, key=lambda rule: rule.weight)


def _declarations(text: str) -> dict[str, str]:
    """Return the properties in a list `name: value; ...` that say what is drawn."""
    pairs = (part.partition(":") for part in text.split(";"))
    named = ((name.strip().lower(), value.replace("!important", "").strip()) for name, _, value in pairs)
    return {name: value for name, value in named if name in PROPERTIES}


def _style(element: ElementTree.Element, name: str, rules: list[_Rule]) -> dict[str, str]:
    """Return what an element says itself: its style before the rules of style sheets, and these before attributes."""
    attributes = {key: value.strip() for key, value in element.attrib.items() if key in PROPERTIES}
    style: dict[str, str] = {}
    for rule in rules:
        if rule.concerns(element, name):
            style |= rule.style
    style |= _declarations(element.get("style", ""))
    if "transform" in style or "transform-origin" in {**attributes, **style}:
        raise ValueError("a transformation in a style is not read: apply transformations in the editor")
    return {key: value for key, value in (attributes | style).items() if value != "inherit"}


def _within(around: _Around, properties: Mapping[str, str]) -> _Around:
    """Return what the parts of an element have from those around them."""
    for key in ("clip-path", "mask"):
        if properties.get(key, "none") != "none":
            raise ValueError(f"{key} hides a part, which would be a wall: release it in the editor")
    hidden = around.hidden
    if properties.get("display") == "none":
        hidden = "display: none"
    elif re.fullmatch(ZERO, properties.get("opacity", "1")):
        hidden = f"opacity: {properties['opacity']}"
    style = {**around.style, **{key: value for key, value in properties.items() if key in INHERITED}}
    return _Around(style, _product(around.matrix, _matrix(properties.get("transform", ""))), hidden)


def _drawn(outlines: list[Outline], name: str, around: _Around) -> Iterator[Outline]:
    """Yield the outlines of a shape as they are drawn; raise ValueError if they do not show."""
    style, (a, b, c, d, e, f) = around.style, around.matrix
    visibility = style.get("visibility", "visible")
    if hidden := around.hidden or (f"visibility: {visibility}" if visibility in {"hidden", "collapse"} else ""):
        raise ValueError(f"{hidden!r} hides a <{name}>, which would be a wall: delete it, or show it")
    has_fill = _shows(style, "fill", "black", "fill-opacity")
    if not has_fill and not _shows(style, "stroke", "none", "stroke-opacity", "stroke-width"):
        raise ValueError(
            f"a <{name}> has neither a fill nor a stroke, and would be a wall: delete it, or give it a stroke"
        )
    for corners, closed in outlines:
        # The outline has y up, the transformation is for y down.
        moved = tuple((a * x - c * y + e, d * y - b * x - f) for x, y in corners)
        is_free = closed and not has_fill
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
    numbers = NUMBER.findall(text)
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
            quarters, rest = divmod(degrees, 90.0)  # quarter turns are exact
            c, s = cos(radians(rest)), sin(radians(rest))
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
    raise ValueError(f"transform: {kind} with {len(numbers)} numbers is no transformation of SVG")


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
    "path": lambda element: element.get("d", "").strip().removeprefix("none"),
    "line": _line,
    "polyline": _points,
    "polygon": lambda element: f"{points} Z" if (points := _points(element)) else "",
    "rect": _rect,
}
"""The elements that are read: each as the data of a path, "" if nothing is drawn."""

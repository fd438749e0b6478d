"""The shapes of walls in texts: WKT, paths of SVG, and files of either, or of numbers.

WKT is the well-known text of OGC 06-103r4: LINESTRING, POLYGON with holes, their MULTI forms, and collections of them.
A path of SVG (W3C, SVG 1.1, Section 8.3) may have straight pieces only: the commands M, L, H, V and Z, absolute or not.
Its y axis points down, and that of desim up, so that y changes its sign.
"""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from desim.config.number_files import check_comments, number_of, text_of_file, words_of
from desim.config.suggestion import did_you_mean

Corners = tuple[tuple[float, float], ...]


class Outline(NamedTuple):
    """A line, or the ring of a polygon, as a text describes it."""

    corners: Corners
    """[x, y] of each corner; a ring does not repeat its first corner."""
    closed: bool
    """Whether it is a ring."""


def without_repeat(corners: Corners) -> Corners:
    """Return the corners of a ring without a last one that is the first again."""
    return corners[:-1] if len(corners) > 1 and corners[0] == corners[-1] else corners


WKT_FORMS = ("LINESTRING", "POLYGON", "MULTILINESTRING", "MULTIPOLYGON", "GEOMETRYCOLLECTION")
"""The types of WKT that are read."""
_WKT_TOKEN = re.compile(r"\s*([A-Za-z]+|[(),]|[^\s(),]+)")
_SVG_TOKEN = re.compile(r"[\s,]*(?:([A-Za-z])|([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?))")


def wkt_outlines(text: str) -> list[Outline]:
    """Return the lines and rings in a WKT text, which may have several geometries one after the other.

    Raises:
        ValueError: if the text is not WKT, or has a geometry that is neither a line nor a polygon.
    """
    reader = _Wkt(text)
    outlines: list[Outline] = []
    while reader.token is not None:
        outlines += reader.geometry()
    if not outlines:
        raise ValueError(f"WKT should have at least one of {', '.join(WKT_FORMS[:4])}")
    return outlines


class _Wkt:
    """A reader of WKT, one token at a time.

    Attributes:
        token: the next token; None at the end.
    """

    def __init__(self, text: str):
        self._text, self._at = text, 0
        self.token: str | None = None
        self._advance()

    def geometry(self) -> Iterator[Outline]:
        """Yield the outlines of the next geometry."""
        name = (self._take() or "").upper()
        if name not in WKT_FORMS:
            raise self._error(f"{name or 'the end'} is no line or polygon{did_you_mean(name, WKT_FORMS)}")
        if self.token is not None and self.token.upper() in {"Z", "M", "ZM"}:
            raise self._error(f"{name} {self.token.upper()} has more than two coordinates: the plane has x and y")
        if self.token is not None and self.token.upper() == "EMPTY":
            self._advance()
            return
        if name == "LINESTRING":
            yield self._line()
        elif name == "GEOMETRYCOLLECTION":
            yield from self._items(lambda: list(self.geometry()))
        elif name == "MULTIPOLYGON":
            yield from self._items(lambda: list(self._items(lambda: [self._ring()])))
        else:
            item = self._ring if name == "POLYGON" else self._line
            yield from self._items(lambda: [item()])

    def _items(self, item: Callable[[], list[Outline]]) -> Iterator[Outline]:
        """Yield the outlines of items in brackets, separated by commas."""
        self._expect("(")
        yield from item()
        while self.token == ",":
            self._advance()
            yield from item()
        self._expect(")")

    def _line(self) -> Outline:
        """Return the line whose corners come next, in brackets."""
        corners: list[tuple[float, float]] = []
        self._expect("(")
        corners.append(self._corner())
        while self.token == ",":
            self._advance()
            corners.append(self._corner())
        self._expect(")")
        return Outline(tuple(corners), closed=False)

    def _ring(self) -> Outline:
        corners = self._line().corners
        if corners[0] != corners[-1] or len(corners) == 1:
            (x, y), (u, v) = corners[0], corners[-1]
            raise self._error(f"a ring should end where it begins, at {x:g} {y:g} (ends at {u:g} {v:g})")
        return Outline(corners[:-1], closed=True)

    def _corner(self) -> tuple[float, float]:
        coordinates: list[float] = []
        while self.token not in {",", ")", "(", None}:
            try:
                coordinates.append(number_of(self._take() or ""))
            except ValueError as error:
                raise self._error(str(error)) from error
        if len(coordinates) != 2:
            raise self._error(f"a corner should have two numbers, x y (has {len(coordinates)})")
        return coordinates[0], coordinates[1]

    def _expect(self, token: str) -> None:
        if self.token != token:
            raise self._error(f"{token!r} should come here, not {self.token or 'the end'}")
        self._advance()

    def _take(self) -> str | None:
        token = self.token
        self._advance()
        return token

    def _advance(self) -> None:
        match = _WKT_TOKEN.match(self._text, self._at)
        self.token = None if match is None else match[1]
        self._at = len(self._text) if match is None else match.end()

    def _error(self, why: str) -> ValueError:
        line = self._text.count("\n", 0, self._at) + 1
        where = f"WKT, line {line}" if "\n" in self._text.strip() else "WKT"
        before = " ".join(self._text[max(self._at - 40, 0) : self._at].split())
        return ValueError(f"{where}: {why}, after {before!r}; for instance POLYGON ((0 0, 4 0, 4 3, 0 0))")


def svg_outlines(text: str) -> list[Outline]:
    """Return the lines and rings of the data of an SVG path, its attribute d; y changes its sign.

    Raises:
        ValueError: if the text is not such data, or has a curve.
    """
    tokens = list(_svg_tokens(text))
    outlines: list[Outline] = []
    corners: list[complex] = []
    begin = place = 0j
    command, at = "", 0
    while at < len(tokens):
        if isinstance(token := tokens[at], str):
            command, at = token, at + 1
        elif command in "Zz":
            raise ValueError(f"SVG path: a command should come before {token:g}: one of M, L, H, V, Z")
        if command in "Zz":
            outlines += _svg_outline(corners, closed=True)
            corners, place = [], begin
            continue
        if not corners and command not in "Mm":
            if not outlines:
                raise ValueError(f"SVG path: should begin with M, not {command}")
            corners = [place]
        numbers, at = _svg_numbers(tokens, at, command)
        place = _moved(place, command, numbers)
        if command in "Mm":
            outlines += _svg_outline(corners, closed=False)
            corners, begin = [], place
            command = "L" if command == "M" else "l"
        corners.append(place)
    outlines += _svg_outline(corners, closed=False)
    if not outlines:
        raise ValueError("SVG path: has no line")
    return outlines


def _svg_tokens(text: str) -> Iterator[str | float]:
    """Yield the commands and the numbers of the data of a path."""
    at, end = 0, len(text.rstrip(" \t\r\n\f,"))
    while at < end:
        match = _SVG_TOKEN.match(text, at)
        if match is None:
            raise ValueError(f"SVG path: {text[at : at + 12].strip()!r} is neither a command nor a number")
        if match[1] and match[1] not in "MmLlHhVvZz":
            curve = (
                "a curve: in the editor, flatten it to straight pieces" if match[1] in "CcSsQqTtAa" else "no command"
            )
            raise ValueError(f"SVG path: {match[1]} is {curve}; allowed are M, L, H, V and Z, large or small")
        yield match[1] or float(match[2])
        at = match.end()


def _svg_numbers(tokens: list[str | float], at: int, command: str) -> tuple[list[float], int]:
    """Return the numbers that a command takes, and the place of the token behind them."""
    count = 1 if command in "HhVv" else 2
    numbers = [token for token in tokens[at : at + count] if isinstance(token, float)]
    if len(numbers) < count:
        raise ValueError(f"SVG path: {command} should have {count} number{'s' if count > 1 else ''}")
    return numbers, at + count


def _moved(place: complex, command: str, numbers: list[float]) -> complex:
    """Return the place, m, after a command; y points up."""
    base = place if command.islower() else 0j
    if command in "Hh":
        return complex(base.real + numbers[0], place.imag)
    if command in "Vv":
        return complex(place.real, base.imag - numbers[0])
    return complex(base.real + numbers[0], base.imag - numbers[1])


def _svg_outline(corners: list[complex], *, closed: bool) -> list[Outline]:
    """Return the outline of a subpath, if it has a line."""
    if closed and len(corners) > 1 and corners[0] == corners[-1]:
        corners = corners[:-1]
    if len(corners) < 2:
        return []
    return [Outline(tuple((corner.real, corner.imag) for corner in corners), closed)]


_PATH = re.compile(r"<\s*path\b[^>]*>", re.IGNORECASE)
_UNDRAWN = re.compile(
    r"<!--.*?-->|<\s*(defs|symbol|marker|pattern|mask|clipPath)\b[^>]*(?<!/)>.*?<\s*/\s*\1\s*>",
    re.IGNORECASE | re.DOTALL,
)
"""Comments, and elements that are not drawn where they stand."""
_DATA = re.compile(r"""\sd\s*=\s*("[^"]*"|'[^']*')""")
_HIDDEN = re.compile(
    r"""\b(display\s*[:=]\s*["']?\s*none\b|visibility\s*[:=]\s*["']?\s*(hidden|collapse)\b"""
    r"""|(?<!-)opacity\s*[:=]\s*["']?\s*0(\.0*)?%?(?![.\d]))""",
    re.IGNORECASE,
)
_NO_COLOUR = r"(none|transparent|rgba\([^)]*,\s*0(\.0*)?\s*\)|\#[0-9a-f]{6}00)"
_ZERO = r"0(\.0*)?(px|mm|cm|pt|%)?(?![.\d\w])"
_NO_FILL = re.compile(
    rf"""\bfill\s*[:=]\s*["']?\s*{_NO_COLOUR}|\bfill-opacity\s*[:=]\s*["']?\s*{_ZERO}""", re.IGNORECASE
)
_NO_STROKE = re.compile(
    rf"""\bstroke\s*[:=]\s*["']?\s*{_NO_COLOUR}|\bstroke-(width|opacity)\s*[:=]\s*["']?\s*{_ZERO}""", re.IGNORECASE
)
_ELEMENT = re.compile(r"<\s*(/?)\s*(path|g|a|svg)\b([^>]*?)(/?)>", re.IGNORECASE)
_ATTRIBUTE = re.compile(r"""([\w-]+)\s*=\s*("[^"]*"|'[^']*')""")
_STYLE = re.compile(r"""\bstyle\s*=\s*("[^"]*"|'[^']*')""", re.IGNORECASE)
_FILL = re.compile(r"\bfill(-opacity)?\s*[:=]", re.IGNORECASE)
_CUT = re.compile(r"""\b(clip-path|mask)\s*[:=]\s*["']?\s*url""", re.IGNORECASE)
_STYLES = re.compile(r"<\s*(?:path|g|a|svg)\b[^>]*>|\{[^}]*\}", re.IGNORECASE)
"""Elements and rules of style sheets that say how paths are drawn."""
_WKT_BEGIN = re.compile(r"[A-Za-z]\w*\s*(Z|M|ZM|EMPTY)?\s*(\(|;|=|$)", re.IGNORECASE)
_OTHERS = re.compile(r"<\s*(rect|circle|ellipse|line|polyline|polygon|use|image|text)\b", re.IGNORECASE)


_COLUMNS = re.compile(r"""["']?x["']?[\s,]+["']?y["']?""", re.IGNORECASE)
"""A line that names the columns of a file of numbers."""


def file_text(file: Path, *, is_scaled: bool = False) -> tuple[str, str]:
    """Return the shapes in a file as a text, and the key whose value it can be: "svg" or "wkt".

    A file of SVG has elements `path`; closed ones without a fill become lines, and the text is WKT. A file of numbers
    has one corner x y in a line, and an empty line before each further shape; a shape whose last corner is its first is
    a polygon, and a first line `x,y` names the columns. Any other file is WKT. Comments may name no other unit than m,
    unless the caller scales the corners.

    Raises:
        ValueError: if the file cannot be read; the message names the file.
    """
    text = text_of_file(file)
    if "<" in text:
        paths = _svg_paths(text, file)
        if not any(is_hollow for _, is_hollow in paths):
            return "svg", " ".join(data for data, _ in paths)
        outlines = ((outline, is_hollow) for data, is_hollow in paths for outline in svg_outlines(data))
        return "wkt", "\n".join(
            _wkt_of([*corners, *corners[:closed]], is_solid=closed and not is_hollow)
            for (corners, closed), is_hollow in outlines
        )
    if not is_scaled:
        check_comments(text, file, "m")
    lines = [line.partition("#")[0] for line in text.split("\n")]
    first = next((line.strip() for line in lines if line.strip()), "")
    if not first:
        raise ValueError(f"{file} has no shape")
    if first[0] in "{[":
        raise ValueError(
            f"{file}: GeoJSON is not read, as its positions are in degrees (RFC 7946): project them to m, and write"
            " them as WKT (in Python, `geometry.wkt` of shapely)"
        )
    if _COLUMNS.fullmatch(first):
        lines[next(k for k, line in enumerate(lines) if line.strip())] = ""
    elif _WKT_BEGIN.match(first):
        return "wkt", "\n".join(lines).strip()
    return "wkt", _wkt_of_numbers(lines, file)


def _svg_paths(text: str, file: Path) -> list[tuple[str, bool]]:
    """Return the data of all paths of an SVG file that are drawn, and whether each is without a fill.

    Each path starts at the origin: a relative `m` at its beginning does not follow the path before it.
    """
    text = _UNDRAWN.sub("", text)
    if "transform" in text:
        raise ValueError(f"{file}: the attribute transform is not read: apply transformations in the editor")
    if hidden := _HIDDEN.search(text):
        raise ValueError(f"{file}: {hidden[0]!r} hides a part, which would be a wall: delete that part, or show it")
    if any(_draws_nothing(style[0], text) for style in _STYLES.finditer(text)):
        raise ValueError(
            f"{file}: a path has neither a fill nor a stroke, and would be a wall: delete it, or give it a stroke"
        )
    if re.search(r"<\s*switch\b", text, re.IGNORECASE):
        raise ValueError(f"{file}: of the parts of a <switch> one is drawn, and all would be walls: delete the others")
    if len(re.findall(r"<\s*svg\b", text, re.IGNORECASE)) > 1:
        raise ValueError(f"{file}: a drawing inside the drawing (<svg>) is not read: ungroup it in the editor")
    if cut := _CUT.search(text):
        raise ValueError(f"{file}: {cut[1]} hides a part, which would be a wall: release it in the editor")
    if other := _OTHERS.search(text):
        raise ValueError(f"{file}: <{other[1]}> is not read: convert objects to paths in the editor")
    data = [(match[1][1:-1], hollow) for path, hollow in _with_fill(text) if (match := _DATA.search(path))]
    if not data:
        raise ValueError(f"{file} has no <path d=...>")
    return [(f"M 0 0 {path}" if path.lstrip().startswith("m") else path, hollow) for path, hollow in data]


def _with_fill(text: str) -> Iterator[tuple[str, bool]]:
    """Yield each element `path`, and whether it is without a fill.

    A style overrides the rules of style sheets, these the attribute `fill`, and this what surrounding elements have.
    """
    rules = {
        name.strip(): body for names, body in re.findall(r"([^{}<>]+)(\{[^}]*\})", text) for name in names.split(",")
    }
    hollow = [False]
    for match in _ELEMENT.finditer(text):
        is_end, name, attributes, is_empty = match.groups()
        if is_end:
            hollow = hollow[:-1] or hollow
            continue
        values = {key: value[1:-1] for key, value in _ATTRIBUTE.findall(attributes)}
        names = [name, *(f".{one}" for one in values.get("class", "").split()), f"#{values.get('id')}"]
        said = [_STYLE.sub("", attributes), *(rules.get(one, "") for one in names), values.get("style", "")]
        own = [_NO_FILL.search(style) is not None for style in said if _FILL.search(style)]
        hollow.append(own[-1] if own else hollow[-1])
        if name.lower() == "path":
            yield match[0], hollow[-1]
        if is_empty:
            hollow.pop()


def _draws_nothing(style: str, text: str) -> bool:
    """Return whether an element, or a rule of a style sheet, has neither a fill nor a stroke.

    A path that says nothing of its stroke may have that of a group or of a rule.
    """
    if not _NO_FILL.search(style):
        return False
    if re.search(r"\bstroke\s*[:=]", style, re.IGNORECASE):
        return bool(_NO_STROKE.search(style))
    is_path = _PATH.fullmatch(style) is not None
    return is_path and not re.search(
        r"\b(stroke\s*[:=]|class\s*=|id\s*=.*<\s*style)", _PATH.sub("", text) + style, re.DOTALL
    )


def _wkt_of_numbers(lines: list[str], file: Path) -> str:
    """Return lines of numbers as WKT."""
    shapes: list[list[tuple[float, float]]] = [[]]
    for number, line in enumerate(lines, 1):
        words = words_of(line.replace(",", " "))
        if not words and shapes[-1]:
            shapes.append([])
        if not words:
            continue
        try:
            x, y = map(number_of, words)
        except ValueError as error:
            why = str(error) if len(words) == 2 else f"a corner should have two numbers, x y (has {len(words)})"
            raise ValueError(f"{file}, line {number}: {why}") from error
        shapes[-1].append((x, y))
    return "\n".join(map(_wkt_of, filter(None, shapes)))


def _wkt_of(corners: list[tuple[float, float]], *, is_solid: bool = True) -> str:
    """Return a line, or a polygon if the last corner is the first and its inside is solid, as WKT."""
    inner = ", ".join(f"{x!r} {y!r}" for x, y in corners)
    is_polygon = is_solid and len(corners) > 2 and corners[0] == corners[-1]
    return f"POLYGON (({inner}))" if is_polygon else f"LINESTRING ({inner})"

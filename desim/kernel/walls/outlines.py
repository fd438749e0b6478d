"""The shapes of walls in texts: WKT, and paths of SVG.

WKT is the well-known text of OGC 06-103r4: LINESTRING, POLYGON with holes, their MULTI forms, and collections of them.
A path of SVG (W3C, SVG 1.1, Section 8.3) may have straight pieces only: the commands M, L, H, V and Z, absolute or not.
Its y axis points down, and that of desim up, so that y changes its sign.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple, TypeVar

from desim.config.model import MAX_COORDINATE
from desim.config.number_files import number_of
from desim.config.suggestion import did_you_mean
from desim.kernel.walls.crossings import repeated_corner

Corners = tuple[tuple[float, float], ...]
_Item = TypeVar("_Item")


class Outline(NamedTuple):
    """A line, or the ring of a polygon, as a text describes it."""

    corners: Corners
    """[x, y] of each corner; a ring does not repeat its first corner."""
    closed: bool
    """Whether it is a ring."""


def without_repeat(corners: Corners) -> Corners:
    """Return the corners of a ring without a last one that is the first again."""
    return corners[:-1] if len(corners) > 1 and corners[0] == corners[-1] else corners


def check_outlines(outlines: Sequence[Outline], where: str = "") -> None:
    """Raise ValueError, beginning with `where`, if an outline has too few corners, equal ones, or one too far away."""
    for number, (corners, closed) in enumerate(outlines):
        place = where + (f"shape {number}: " if len(outlines) > 1 else "")
        form, least = ("polygon", 3) if closed else ("line", 2)
        if len(corners) < least:
            raise ValueError(f"{place}a {form} should have at least {least} corners (has {len(corners)})")
        for x, y in corners:
            if not (abs(x) <= MAX_COORDINATE and abs(y) <= MAX_COORDINATE):  # also if one is nan
                raise ValueError(f"{place}a coordinate should be from {-MAX_COORDINATE:g} to {MAX_COORDINATE:g} m")
        if (k := repeated_corner(corners, closed=closed)) is not None:
            x, y = corners[k % len(corners)]
            raise ValueError(f"{place}an edge should have a length: the corner [{x:g}, {y:g}] comes twice")


WKT_FORMS = ("LINESTRING", "POLYGON", "MULTILINESTRING", "MULTIPOLYGON", "GEOMETRYCOLLECTION")
"""The types of WKT that are read."""
_WKT_TOKEN = re.compile(r"\s*([A-Za-z]+|[(),]|[^\s(),]+)")
SVG_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
"""Matches a number of SVG; a sign begins another one."""
_SVG_TOKEN = re.compile(rf"[\s,]*(?:([A-Za-z])|({SVG_NUMBER}))")


def wkt_outlines(text: str) -> list[Outline]:
    """Return the lines and rings in a WKT text, which may have several geometries one after the other.

    Raises:
        ValueError: if the text is not WKT, or has a geometry that is neither a line nor a polygon.
    """
    reader = _Wkt(text)
    outlines: list[Outline] = []
    try:
        while reader.token is not None:
            outlines += reader.geometry()
    except RecursionError as error:
        raise ValueError("WKT: a geometry is nested too deeply in others") from error
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
            yield from self._items(self.geometry)
        elif name == "MULTIPOLYGON":
            yield from self._items(lambda: self._items(lambda: [self._ring()]))
        else:
            item = self._ring if name == "POLYGON" else self._line
            yield from self._items(lambda: [item()])

    def _items(self, item: Callable[[], Iterable[_Item]]) -> Iterator[_Item]:
        """Yield the items in brackets, separated by commas; `item` reads one of them."""
        self._expect("(")
        yield from item()
        while self.token == ",":
            self._advance()
            yield from item()
        self._expect(")")

    def _line(self) -> Outline:
        """Return the line whose corners come next, in brackets."""
        return Outline(tuple(self._items(lambda: [self._corner()])), closed=False)

    def _ring(self) -> Outline:
        corners = self._line().corners
        if corners[0] != corners[-1]:
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

    Pieces without a length are left out, as nothing is drawn there.

    Raises:
        ValueError: if the text is not such data, or has a curve.
    """
    tokens = list(_svg_tokens(text))
    if tokens and isinstance(tokens[0], str) and tokens[0] not in "Mm":
        raise ValueError(f"SVG path: should begin with M, not {tokens[0]}")
    outlines: list[Outline] = []
    corners: list[complex] = []  # x + y j
    begin = place = 0j
    command, at = "", 0
    while at < len(tokens):
        if isinstance(token := tokens[at], str):
            command, at = token, at + 1
        elif command in {"", "Z", "z"}:
            raise ValueError(f"SVG path: a command should come before {token:g}: one of M, L, H, V, Z")
        if command in "Zz":
            outlines += _svg_outline(corners, closed=True)
            corners, place = [], begin
            continue
        if not corners and command not in "Mm":  # after Z, the next part begins where the last one began
            corners = [place]
        numbers, at = _svg_numbers(tokens, at, command)
        place = _moved(place, command, numbers)
        if command in "Mm":
            outlines += _svg_outline(corners, closed=False)
            corners, begin = [], place
            command = "L" if command == "M" else "l"  # further numbers after M are lines
        if not corners or corners[-1] != place:
            corners.append(place)
    return outlines + _svg_outline(corners, closed=False)


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

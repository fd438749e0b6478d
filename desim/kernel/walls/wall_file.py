"""The shapes of walls in files: WKT, drawings in SVG, and numbers."""

import re
from pathlib import Path

from desim.config.number_files import check_comments, number_of, text_of_file, words_of
from desim.kernel.walls.outlines import Outline, check_outlines, wkt_outlines
from desim.kernel.walls.svg_file import svg_file_outlines

WKT_BEGIN = re.compile(r"[A-Za-z]\w*\s*(Z|M|ZM|EMPTY)?\s*(\(|;|=|$)", re.IGNORECASE)
COLUMNS = re.compile(r"""["']?x["']?[\s,]+["']?y["']?""", re.IGNORECASE)
"""Matches a line that names the columns of a file of numbers."""


def wkt_in(file: Path, *, is_scaled: bool = False) -> str:
    """Return the shapes in a file as WKT.

    A file of numbers has one corner x y in a line, and an empty line before each further shape; a shape whose last
    corner is its first is a polygon, and a first line `x,y` names the columns. Comments may name no other unit than m,
    unless the caller scales the corners. For drawings in SVG see `desim.kernel.walls.svg_file`. Any other file is WKT.

    Raises:
        ValueError: if the file cannot be read; the message names the file.
    """
    text = text_of_file(file)
    if text.lstrip().startswith("<"):
        return _wkt_of_drawing(text, file)
    if not is_scaled:
        check_comments(text, file, "m")
    lines = [line.partition("#")[0] for line in text.split("\n")]
    first = next((line.strip() for line in lines if line.strip()), "")
    if not first:
        raise ValueError(f"{file} has no shape")
    if first[0] in "{[" and '"coordinates"' in text:
        raise ValueError(
            f"{file}: GeoJSON is not read, as its positions are in degrees (RFC 7946): project them to m, and write"
            " them as WKT (in Python, `geometry.wkt` of shapely)"
        )
    if COLUMNS.fullmatch(first):
        lines[next(k for k, line in enumerate(lines) if line.strip())] = ""
    elif WKT_BEGIN.match(first):
        wkt = "\n".join(lines)
        try:
            check_outlines(wkt_outlines(wkt))
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from error
        return wkt.strip()
    return _wkt_of_numbers(lines, file)


def _wkt_of_drawing(text: str, file: Path) -> str:
    try:
        outlines = svg_file_outlines(text)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    if not outlines:
        raise ValueError(f"{file} has no shape: paths, lines, polylines, polygons and rectangles are read")
    return _wkt_of(outlines, file)


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
            reason = str(error) if len(words) == 2 else f"a corner should have two numbers, x y (has {len(words)})"
            raise ValueError(f"{file}, line {number}: {reason}") from error
        shapes[-1].append((x, y))
    return _wkt_of([_outline_of(corners) for corners in shapes if corners], file)


def _outline_of(corners: list[tuple[float, float]]) -> Outline:
    """Return a ring if the last corner is the first one, and else a line."""
    is_ring = len(corners) > 2 and corners[0] == corners[-1]
    return Outline(tuple(corners[:-1] if is_ring else corners), is_ring)


def _wkt_of(outlines: list[Outline], file: Path) -> str:
    """Return the outlines in a file as WKT."""
    check_outlines(outlines, f"{file}: ")
    texts: list[str] = []
    for corners, is_ring in outlines:
        points = ", ".join(f"{x!r} {y!r}" for x, y in ((*corners, corners[0]) if is_ring else corners))
        texts.append(f"POLYGON (({points}))" if is_ring else f"LINESTRING ({points})")
    return "\n".join(texts)

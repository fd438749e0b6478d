"""The names that the columns of tables of positions have: of files, of data frames, and of fields of rows."""

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "t": ("t", "time", "timestamp", "t_s", "time_s", "sec", "seconds", "date", "datetime"),
    "x": ("x", "x_m", "pos_x", "posx", "position_x", "east", "easting"),
    "y": ("y", "y_m", "pos_y", "posy", "position_y", "north", "northing"),
    "z": ("z", "z_m", "pos_z", "posz", "position_z", "height", "altitude", "alt"),
    "node": (
        *("node", "name", "node_id", "nodeid", "id"),
        *(f"{one}{end}" for one in ("vehicle", "agent", "robot", "uav", "drone", "track") for end in ("", "_id", "id")),
    ),
}
"""The names that a column of a table may have, in lower case; the first that a table has is read."""
WHOLE_SECONDS = frozenset({"sec", "seconds", "timestamp"})
FRACTIONS = frozenset({"nanosec", "nanosecs", "nanoseconds", "nsec", "nsecs", "usec", "usecs", "microseconds", "msec"})
"""The names of columns that have the rest of a time whose whole seconds are in one of `WHOLE_SECONDS`, as of ROS."""
LATITUDES, LONGITUDES = frozenset({"lat", "latitude"}), frozenset({"lon", "lng", "long", "longitude"})
DEGREES = LATITUDES | LONGITUDES
UNITS = {"t": "s", "x": "m", "y": "m", "z": "m"}
HEADER_CELL = re.compile(r"\s*(.*?)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?\s*")
"""Matches the name of a column and its unit, for example `x [m]`."""


OTHER_UNITS = {
    "s": "ms|msecs?|milliseconds?|us|[µμ]s|usecs?|microseconds?|ns|nsecs?|nanoseconds?|minutes|hours",
    "m": "(?:m|c|k)m|(?:milli|centi|kilo)met(?:er|re)s?|ft|feet|inch(?:es)?|px|pixels?|deg(?:rees)?",
}
"""Expressions for units that people use instead of a unit."""
SAME_UNIT = {"s": "s|secs?|seconds?", "m": "m|met(?:er|re)s?"}
"""Expressions for the names of a unit."""
NAMES_OF_UNITS = {unit: f"{SAME_UNIT[unit]}|{OTHER_UNITS[unit]}" for unit in SAME_UNIT}
LABEL = re.compile(
    r"(?P<name>.*?)(?:\s*[\[(]\s*(?P<bracketed>[^\])]*?)\s*[\])]"
    rf"|(?:\s*[/,:]\s*|\s+in\s+|_in_|\s+|_)(?P<unit>{'|'.join(NAMES_OF_UNITS.values())}|m|mi|dm|min|h))?\s*",
    re.IGNORECASE,
)
"""Matches the label of a column with its unit, as in `x [cm]`, `x_cm`, `x / cm` or `x in cm`."""
WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?(?:(?![A-Z])[^\W\d_])+|\d+")
"""Matches a word in a label, as in `pose.position.x`, `posX` or `utm_north`."""
AXES = {"x": re.compile(r"[a-z]?x|east|easting"), "y": re.compile(r"[a-z]?y|north|northing")}
"""Match the word that ends the label of a coordinate."""


class Header(NamedTuple):
    """The cells of a header, in lower case without units, and the units."""

    names: list[str]
    units: list[str | None]


def header_of(cells: Iterable[str]) -> Header:
    """Return the names and the units in the cells of a header."""
    parts = [HEADER_CELL.fullmatch(cell.strip().strip('"')) for cell in cells]
    return Header([part[1].lower() if part else "" for part in parts], [part[2] if part else None for part in parts])


def coordinate_columns(labels: Sequence[object]) -> list[int] | None:
    """Return the indices of the columns t, x and y of a table, in this order; t may be absent.

    Return None if the columns have other names, by which they cannot be told.

    Raises:
        ValueError: if they are in degrees, or in another unit than m and s.
    """
    texts = [" ".join(label) if isinstance(label, tuple) and all(map(_is_text, label)) else label for label in labels]
    if not all(map(_is_text, texts)):
        return None
    words = [[word.lower() for word in WORD.findall(str(text))] for text in texts]
    named = frozenset(chain.from_iterable(words))
    if LATITUDES & named and LONGITUDES & named:
        raise ValueError("positions are in degrees: project them to m")
    index: dict[str, int] = {}
    for k, text in enumerate(texts):
        match = LABEL.fullmatch(str(text))
        role = None if match is None else _role(match["name"])
        if match is None or role is None or role in index:
            return None
        unit, right = match["bracketed"] or match["unit"], UNITS[role]
        if unit and not re.fullmatch(SAME_UNIT[right], unit, re.IGNORECASE):
            raise ValueError(f"column {labels[k]!r} is in {unit}, and should be in {right}")
        index[role] = k
    return [index[role] for role in "txy" if role in index] if {"x", "y"} <= index.keys() else None


def _is_text(label: object) -> bool:
    return isinstance(label, str)


def _role(name: str) -> str | None:
    """Return which of t, x and y a column is, given its label without a unit; None if it cannot be told."""
    if (role := next((key for key in "txy" if name.strip().lower() in COLUMNS[key]), None)) is not None:
        return role
    words = [word.lower() for word in WORD.findall(name) if not word.isdecimal()]
    return next((key for key, axis in AXES.items() if words and axis.fullmatch(words[-1])), None)

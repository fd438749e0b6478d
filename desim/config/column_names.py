"""The names that the columns of tables of positions have: of files, of data frames, and of fields of rows."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "t": ("t", "time", "timestamp", "t_s", "time_s", "sec", "seconds", "date", "datetime"),
    "x": ("x", "x_m", "pos_x", "posx", "position_x", "east", "easting"),
    "y": ("y", "y_m", "pos_y", "posy", "position_y", "north", "northing"),
    "z": ("z", "z_m", "pos_z", "posz", "position_z", "height", "altitude", "alt"),
    "node": ("node", "name", "node_id", "nodeid", "id", "vehicle", "vehicle_id", "agent", "robot", "uav"),
}
"""The names that a column of a table may have, in lower case; the first that a table has is read."""
LATITUDES, LONGITUDES = frozenset({"lat", "latitude"}), frozenset({"lon", "lng", "long", "longitude"})
DEGREES = LATITUDES | LONGITUDES
UNITS = {"t": "s", "x": "m", "y": "m", "z": "m"}
OTHER_UNITS = frozenset({"mm", "cm", "dm", "km", "ft", "mi", "px", "deg", "ns", "us", "ms", "min", "h"})
"""Units that may end the name of a column, as in `x_cm`, and are not those of desim."""
HEADER_CELL = re.compile(r"\s*(.*?)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?\s*")
"""Matches the name of a column and its unit, for example `x [m]`."""


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
    if not all(isinstance(label, str) for label in labels):
        return None
    names, units = header_of(map(str, labels))
    if LATITUDES & set(names) and LONGITUDES & set(names):
        raise ValueError("positions are in degrees: project them to m")
    index: dict[str, int] = {}
    for k, name in enumerate(names):
        stem, _, suffix = name.rpartition("_")
        unit = units[k] or (suffix if stem and suffix in OTHER_UNITS else None)
        role = next((key for key in "txy" if name in COLUMNS[key] or (unit == suffix and stem in COLUMNS[key])), None)
        if role is None or role in index:
            return None
        if unit and unit != UNITS[role]:
            raise ValueError(f"column {labels[k]!r} is in {unit}, and should be in {UNITS[role]}")
        index[role] = k
    return [index[role] for role in "txy" if role in index] if {"x", "y"} <= index.keys() else None

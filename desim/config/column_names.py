"""The names of the columns in tables of positions, which may be files, data frames, or rows with named fields."""

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

IDENTIFIED = (
    *("vehicle", "agent", "robot", "uav", "drone", "track", "trajectory", "traj", "pedestrian", "ped", "person"),
    *("object", "obj", "user", "tag", "target", "node", "device", "car", "bus", "taxi", "ship", "vessel", "boat"),
    *("animal", "individual", "player", "entity", "actor", "particle", "subject", "participant"),
)
"""Nouns before `id` in the name of a column, as in `track_id` or `Device ID`."""
COLUMNS: Mapping[str, tuple[str, ...]] = {
    "t": (
        *("t", "time", "timestamp", "sec", "seconds", "date", "datetime"),
        *("time_from_start", "time_since_start", "time_elapsed", "elapsed"),
    ),
    "x": ("x", "pos_x", "posx", "position_x", "east", "easting", "tx"),
    "y": ("y", "pos_y", "posy", "position_y", "north", "northing", "ty"),
    "z": ("z", "pos_z", "posz", "position_z", "height", "altitude", "alt", "tz"),
    "node": (
        *("node", "name", "id", "mac"),
        *("vehicle", "agent", "robot", "uav", "drone", "track", "pedestrian", "person", "device", "car"),
        *(f"{noun}{ending}" for noun in IDENTIFIED for ending in ("_id", "id")),
    ),
}
"""The names that a column of a table may have, in lower case; the first that a table has is read."""
WHOLE_SECONDS = frozenset({"sec", "seconds", "timestamp"})
FRACTIONS = frozenset({"nanosec", "nanosecs", "nanoseconds", "nsec", "nsecs", "usec", "usecs", "microseconds", "msec"})
"""The names of columns with fractions of seconds, beside a column of `WHOLE_SECONDS`, as in messages of ROS."""
LATITUDES, LONGITUDES = frozenset({"lat", "latitude"}), frozenset({"lon", "lng", "long", "longitude"})
DEGREES = LATITUDES | LONGITUDES
UNITS = {"t": "s", "x": "m", "y": "m", "z": "m"}
TIME_UNITS = {
    "s": "s|secs?|seconds?",
    "ms": "ms|msecs?|millis|milliseconds?",
    "us": "us|[µμ]s|usecs?|micros|microseconds?",
    "ns": "ns|nsecs?|nanoseconds?",
}
"""Expressions for the names of the units of times that are read."""
OTHER_UNITS = {
    "s": "|".join([TIME_UNITS["ms"], TIME_UNITS["us"], TIME_UNITS["ns"], "minutes|hours"]),
    "m": "(?:m|c|k)m|(?:milli|centi|kilo)met(?:er|re)s?|ft|feet|inch(?:es)?|px|pixels?|deg(?:rees)?",
}
"""Expressions for the units that people use in place of s or m."""
SAME_UNIT = {"s": TIME_UNITS["s"], "m": "m|met(?:er|re)s?"}
"""Expressions for the names of s and of m."""
NAMES_OF_UNITS = {unit: f"{SAME_UNIT[unit]}|{OTHER_UNITS[unit]}" for unit in SAME_UNIT}
LABEL = re.compile(
    rf"""
    (?P<name>.*?)
    (?:
        \s* [\[(] \s* (?P<bracketed>[^\])]*?) \s* [\])]
    |
        (?:
            \s*[/,:]\s* | \s+in\s+ | _in_ | \s+ | _
        |   (?-i:(?<=[a-zXYZ])(?=[A-Z][a-z])(?!Min))  # posCm, but neither posMin nor posM
        |   (?-i:(?<=^[xyzXYZ])(?=[a-z]?m$|ft|px))  # xcm, but not xM
        |   (?<=^t)(?=[mun]s)  # tms
        )
        (?P<unit>{"|".join(NAMES_OF_UNITS.values())}|m|mi|dm|min|h)
    )?
    \s*
    """,
    re.IGNORECASE | re.VERBOSE,
)
"""Matches the label of a column with its unit, as in `x [cm]`, `x_cm`, `x / cm`, `x in cm`, `xcm` or `posCm`."""
WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?(?:(?![A-Z])[^\W\d_])+|\d+")
"""Matches a word in a label, as in `pose.position.x`, `posX` or `utm_north`."""
AXES = {"x": re.compile(r"[a-z]?x|east|easting"), "y": re.compile(r"[a-z]?y|north|northing")}
"""Match the last word of the label of a coordinate in a data frame or a row; see `_role`."""
ENDS = {
    "t": {"t", "time", "timestamp", "stamp"},
    "x": {"x", "px", "east", "easting"},
    "y": {"y", "py", "north", "northing"},
    "z": {"z", "pz", "height", "altitude"},
}
"""The last words of labels in the header of a file, as in `pose.position.x`; see `Header.columns`."""
LINK_ENDS = (
    *(("u", "v"), ("node1", "node2"), ("node_1", "node_2"), ("node_a", "node_b"), ("i", "j"), ("a", "b")),
    *(("start", "end"), ("node", "target"), ("node", "neighbor"), ("node_id", "neighbor_id")),
    *(("id1", "id2"), ("id_1", "id_2"), ("fromnodeid", "tonodeid")),
)
"""The names of the columns of both ends of links, in lower case."""
LINK_END_WORDS = (
    *(("source", "target"), ("source", "destination"), ("source", "dest"), ("src", "dst"), ("src", "dest")),
    *(("from", "to"), ("sender", "receiver"), ("sending", "receiving"), ("origin", "destination"), ("tx", "rx")),
)
"""Pairs of words: one column has the first in its name, and the other the second, as `source_id` and `target_id`."""
OF_POSITIONS = frozenset(
    {"p", "pos", "pose", "position", "positions", "translation", "location", "point", "coord", "coordinate"}
)
OF_OTHERS = frozenset(
    {
        *("v", "vel", "velocity", "speed", "twist", "linear", "angular", "acc", "acceleration", "orientation"),
        *("q", "quat", "quaternion", "rotation", "rot", "gyro", "cov", "covariance", "std", "error", "goal", "target"),
    }
)
"""Words in the labels of positions, and in those of other vectors."""


class OtherColumnError(ValueError):
    """A column beside x and y is no time: in a table of three columns, it would be taken for one."""


class Header(NamedTuple):
    """The cells of a header."""

    names: list[str]
    """In lower case, without units."""
    units: list[str]
    """Empty where a cell names none."""
    words: list[list[str]]
    """The words of each name, in lower case."""

    def extended(self, *names: str) -> "Header":
        """Return the header with further columns."""
        return Header([*self.names, *names], [*self.units, *("" for _ in names)], [*self.words, *([n] for n in names)])

    def columns(self, key: str) -> list[int]:
        """Return the indices of the columns that may be t, x, y, z or node; several if names do not decide.

        A column whose name is in `COLUMNS` is preferred to those whose last word is in `ENDS`. Among the latter, a
        column with a word of positions is preferred.
        """
        for name in COLUMNS[key]:
            if columns := [k for k, other in enumerate(self.names) if joined(other) == name]:
                return columns
        with_ending = [
            k
            for k, words in enumerate(self.words)
            if words and words[-1] in ENDS.get(key, ()) and OF_OTHERS.isdisjoint(words)
        ]
        return [k for k in with_ending if not OF_POSITIONS.isdisjoint(self.words[k])] or with_ending


def joined(name: str) -> str:
    """Return the name of a column with `_` between its words instead of spaces, hyphens or points."""
    return re.sub(r"[\s.-]+", "_", name)


def header_of(cells: Iterable[str]) -> Header:
    """Return the names and the units in the cells of a header; a sign `%` before a name does not count."""
    parts = [LABEL.fullmatch(cell.strip().strip('"').lstrip("%")) for cell in cells]
    labels = [part["name"].strip() if part else "" for part in parts]
    units = [(part["bracketed"] or part["unit"] or "") if part else "" for part in parts]
    return Header([label.lower() for label in labels], units, [words_of_name(label) for label in labels])


def coordinate_columns(labels: Sequence[object]) -> list[int] | None:
    """Return the indices of the columns t, x and y of a table, in this order; t may be absent.

    Return None if the names do not say which columns are x and y, or if several may be the same coordinate.

    Raises:
        ValueError: if the coordinates are in degrees, or a column is in another unit than m or s.
        OtherColumnError: if a column beside x and y is none of the three.
    """
    texts = [" ".join(label) if isinstance(label, tuple) and all(map(_is_text, label)) else label for label in labels]
    if not all(map(_is_text, texts)):
        return None
    words = frozenset(chain.from_iterable(words_of_name(str(text)) for text in texts))
    if LATITUDES & words and LONGITUDES & words:
        raise ValueError("positions are in degrees: project them to m")
    matches = [LABEL.fullmatch(str(text)) for text in texts]
    names = [match["name"].strip() if match else "" for match in matches]
    index: dict[str, int] = {}
    others: list[object] = []
    for k in sorted(range(len(names)), key=lambda k: names[k].lower() not in UNITS):  # x itself before vx
        match, role = matches[k], _role(names[k])
        if match is None or role is None or (role in index and names[index[role]].lower() == role):
            others.append(labels[k])
            continue
        if role in index:
            return None
        unit, expected_unit = match["bracketed"] or match["unit"], UNITS[role]
        if unit and not re.fullmatch(SAME_UNIT[expected_unit], unit, re.IGNORECASE):
            raise ValueError(f"column {labels[k]!r} is in {unit}, and should be in {expected_unit}")
        index[role] = k
    if not {"x", "y"} <= index.keys():
        return None
    if others:
        raise OtherColumnError(f"column {others[0]!r} is none of t, x and y: leave it out")
    return [index[role] for role in "txy" if role in index]


def unit_in_label(label: str) -> str:
    """Return the unit in the label of a column or a series; an empty text if it has none."""
    return header_of([label]).units[0]


def columns_of_ends(names: Sequence[str]) -> tuple[int, int] | None:
    """Return the columns of both ends of links, given the names of all columns; None if no names are of ends."""
    lower = [name.lower() for name in names]
    words = [words_of_name(name) for name in names]
    for a, b in LINK_END_WORDS:
        for src, src_words in enumerate(words):
            if src_words.count(a) == 1 and (dst_words := [b if word == a else word for word in src_words]) in words:
                return src, words.index(dst_words)
    return next(((lower.index(a), lower.index(b)) for a, b in LINK_ENDS if a in lower and b in lower), None)


def are_out_of_order(labels: Sequence[object]) -> bool:
    """Return whether the columns of a table have numbers as labels, and other places than the numbers say."""
    return all(isinstance(label, int) for label in labels) and labels != sorted(labels)  # type: ignore[type-var]


def _is_text(label: object) -> bool:
    return isinstance(label, str)


def words_of_name(label: str) -> list[str]:
    """Return the words in the name of a column, in lower case."""
    return [word.lower() for word in WORD.findall(label)]


def _role(name: str) -> str | None:
    """Return which of t, x and y a column is, given its label without a unit; None if it cannot be told."""
    if (role := next((key for key in "txy" if name.strip().lower() in COLUMNS[key]), None)) is not None:
        return role
    words = [word for word in words_of_name(name) if not word.isdecimal() and word not in OF_POSITIONS]
    return next((key for key, axis in AXES.items() if words and axis.fullmatch(words[-1])), None)

"""The line number of each key in a TOML file: error messages need it, and `tomllib` does not provide it."""

import re
import tomllib
from collections.abc import Iterator
from typing import Any

from desim.config.errors import KeyPath
from desim.config.tables import nested


def tables_of(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text, see `tomllib.loads`.

    Raises:
        ValueError: if the text is not TOML, or a number is too long to be printed: `tomllib` refuses only decimal ones.
        RecursionError: if tables are nested too deeply.
    """
    tables = tomllib.loads(text)
    repr(tables)  # raises ValueError for such a number
    return tables


def key_lines(text: str) -> dict[KeyPath, int]:
    """Return the line on which each key of a valid TOML text is first set or occurs in a table header.

    A key within a statement of several lines has the first line of the statement.
    """
    lines: dict[KeyPath, int] = {}
    lengths: dict[KeyPath, int] = {}  # number of tables so far, by array of tables
    header: KeyPath = ()
    for first, statement in _statements(text):
        tables = tomllib.loads(statement)
        if statement.startswith("["):
            header = _header(tables, statement.startswith("[["), lengths)
            places = [header[:end] for end in range(1, len(header) + 1)]
        else:
            places = [header + place for place, _ in nested(tables)]
        for place in places:
            lines.setdefault(place, first)
    return lines


def unreadable(text: str) -> int | None:
    """Return the line of the first statement of a TOML text that `tomllib` cannot read; None if there is none."""
    return next((line for line, statement in _statements(text) if not _is_readable(statement)), None)


def _is_readable(statement: str) -> bool:
    try:
        tables_of(statement)
    except (ValueError, RecursionError):
        return False
    return True


MAX_PARTS = 100
"""The largest number of parts of a key.

`tomllib` stores every prefix of a key, so it may run out of memory at a very long one.
"""


def deep_key(text: str) -> int | None:
    """Return the index at which the first key of more than `MAX_PARTS` parts starts in a TOML text; None without one.

    Text within strings and comments is not a key, however many dots it has.
    """
    return next((match.start() for match in _DEEP_KEY.finditer(text) if match["key"]), None)


# The four kinds of strings, and comments. They are matched as a whole, because a dot, a bracket or a line end within
# them has no meaning. A string without an end is matched up to the end of the text, because `tomllib` stops at it:
# otherwise the rest of the text would be searched again from every quotation mark. A '...' never leaves its line.
_QUOTED = (
    r'"""(?:(?:\\.|[^\\])*?"{3,5}(?!")|.*)|\'\'\'(?:.*?\'{3,5}(?!\')|.*)'
    r'|"(?:\\.|[^"\\\n])*(?:"|.*)|\'[^\'\n]*\'|#[^\n]*'
)
_PART = r"""(?:[\w-]+|"(?:\\.|[^"\\\n])*"|'[^'\n]*')[ \t]*\.[ \t]*"""
# A shorter key is matched as a whole, too, so that it is not searched again from each of its parts.
_DEEP_KEY = re.compile(rf"(?<![\w-])(?:(?P<key>(?:{_PART}){{{MAX_PARTS}}})|(?:{_PART})+)|{_QUOTED}", re.DOTALL)
# Tokens: strings, comments, brackets and line ends.
_TOKEN = re.compile(_QUOTED + r"|[\[\]{}\n]", re.DOTALL)


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield the number of the first line and the text of each TOML statement; a statement may span several lines."""
    depth = start = 0
    line = 1
    for token in _TOKEN.finditer(text + "\n"):
        depth += (token[0] in "[{") - (token[0] in "]}") if token[0] in "[]{}" else 0
        if token[0] == "\n" and depth == 0:
            statement = text[start : token.start()].strip()
            if statement and not statement.startswith("#"):
                yield line, statement
            line += text.count("\n", start, token.end())
            start = token.end()


def _header(tables: dict[str, Any], is_array: bool, lengths: dict[KeyPath, int]) -> KeyPath:
    """Return the place that a table header names; `tables` is what `tomllib` makes of the header alone.

    In the place, the key of an array of tables is followed by the index of the last table of the array so far. A header
    [[...]] adds a table to its array and updates `lengths`, the number of tables in each array.
    """
    place: KeyPath = ()
    node: Any = tables
    while node:
        key, node = next(iter(node.items()))
        place += (key,)
        if isinstance(node, list):
            node = node[0]
        if node and place in lengths:
            place += (lengths[place] - 1,)
    if is_array:
        lengths[place] = lengths.get(place, 0) + 1
        place += (lengths[place] - 1,)
    return place

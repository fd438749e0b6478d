"""Tables and pictures as HTML, for notebooks; all texts are escaped."""

import html
from collections.abc import Callable, Mapping, Sequence
from typing import Any

PICTURES: dict[str, Callable[[Any], str]] = {}
"""By kind of object, such as "run", the function that returns an object of this kind as an HTML image.

`desim` fills the dict, because the functions are in packages above those of the objects."""


def picture_of(kind: str, value: Any) -> str:
    """Return a value as an HTML image; "" if `PICTURES` has no function for its kind."""
    return PICTURES[kind](value) if kind in PICTURES else ""


def html_table(title: str, rows: Sequence[Sequence[str]]) -> str:
    """Return rows of text as an HTML table; the first row is the header."""
    head, *body = rows
    lines = "".join([_row(head, "th"), *(_row(row, "td") for row in body)])
    return f"<table><caption>{_text(title)}</caption>{lines}</table>"


def html_properties(properties: Mapping[str, str]) -> str:
    """Return texts by name as an HTML table with a row for each name."""
    rows = (f"<tr><th>{_text(name)}</th><td>{_text(text)}</td></tr>" for name, text in properties.items())
    return f"<table>{''.join(rows)}</table>"


def _row(cells: Sequence[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{_text(cell)}</{tag}>' for cell in cells)}</tr>"


def _text(text: str) -> str:
    return html.escape(text).replace("+-", "&plusmn;")

"""Text of strangers on a terminal and in tables: what cannot be printed is escaped."""

from typing import Any

WITHOUT_BREAKS = {ord(character): None for character in "\n\t"}
"""Removes newlines and tabs by `str.translate`: `str.isprintable` calls them unprintable, but they need no escape."""


def escaped(text: str) -> str:
    """Return a text with unprintable characters, except newline and tab, escaped as in TOML; safe on a terminal."""
    if text.isprintable() or text.translate(WITHOUT_BREAKS).isprintable():
        return text
    return "".join(
        character if character.isprintable() or character in "\n\t" else _escape_sequence(ord(character))
        for character in text
    )


def csv_cell(value: Any) -> Any:
    """Return a value as a cell of a CSV file: a text is escaped, so that it can be encoded."""
    return escaped(value) if isinstance(value, str) else value


def _escape_sequence(number: int) -> str:
    return f"\\u{number:04x}" if number < 2**16 else f"\\U{number:08x}"

"""The name that a misspelt one may mean, for error messages."""

from collections.abc import Iterable
from difflib import get_close_matches

MAX_WORD = 200
"""Maximum length of a word that is compared with the allowed names, characters."""


def close_to(word: str, allowed: Iterable[str], cutoff: float = 0.6) -> list[str]:
    """Return a list with the allowed name most similar to a word; empty if none is similar or the word is too long."""
    return get_close_matches(word, list(allowed), n=1, cutoff=cutoff) if len(word) <= MAX_WORD else []


def did_you_mean(word: str, allowed: Iterable[str]) -> str:
    """Return the end of a message, for example ", did you mean 'sap'?"; empty if no allowed name is similar."""
    close = close_to(word, allowed)
    return f", did you mean {close[0]!r}?" if close else ""

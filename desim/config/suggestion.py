"""The name that a misspelt one may mean, for error messages."""

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(word: str, allowed: Iterable[str]) -> str:
    """Return the end of a message, for example ", did you mean 'sap'?"; empty if no allowed name is similar."""
    close = get_close_matches(word, list(allowed), n=1)
    return f", did you mean {close[0]!r}?" if close else ""

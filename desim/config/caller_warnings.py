"""Warnings that name the line of the user's program, however many functions of desim lie between."""

from inspect import currentframe
from warnings import warn

BETWEEN = frozenset({"desim", "protocols", "pydantic", "contextlib", "functools", "gymnasium", "pettingzoo"})
"""The packages whose lines no user has written."""


def warn_caller(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn of a call of desim, at the innermost line of the program that lies outside of desim and what it uses.

    In a command this is a line of the program that runs commands. If there is no such line, because a thread runs desim
    alone, the warning names no file but `sys`.
    """
    frame, level = currentframe(), 1
    while frame is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in BETWEEN:
        frame, level = frame.f_back, level + 1
    warn(text, category, stacklevel=level)

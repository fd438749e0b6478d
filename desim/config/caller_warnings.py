"""Warnings that name the line of the user's program, however many functions of desim lie between."""

from inspect import currentframe
from typing import TYPE_CHECKING
from warnings import warn

if TYPE_CHECKING:
    from pydantic import ValidationInfo

BETWEEN = frozenset({"desim", "protocols", "pydantic", "contextlib", "functools", "gymnasium", "pettingzoo"})
"""The packages whose lines no user has written."""


def warn_caller(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the innermost line of the program that is not in one of the packages `BETWEEN`.

    In a command, this line is in the library that runs commands. If all lines are in these packages, as in a thread
    that runs desim alone, the warning names `sys` in place of a file.
    """
    frame, level = currentframe(), 1
    while frame is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in BETWEEN:
        frame, level = frame.f_back, level + 1
    warn(text, category, stacklevel=level)


def warn_reader(text: str, info: "ValidationInfo") -> None:
    """Warn of how a file that a program gives to a model is read.

    If a scenario file names it, all commands give this warning, with its key (`desim.scenario.checks`).
    """
    if (info.context or {}).get("is_program", True):
        warn_caller(text)

"""The error about what a model of a user returned: it names the model, and where it is defined."""

import os
from functools import partial
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

import numpy as np

from desim.config.arguments import value_text
from desim.config.errors import AnswerError
from desim.config.traits import OURS, is_ours

MAX_ITEMS = 8
"""Number of items up to which an error shows an array without its shape."""
LONGEST = 300
"""Maximum length of a returned value in an error message, characters."""


def wrong_answer(expected: str, answer: object, model: object) -> AnswerError:
    """Return the error about what a model returned.

    Args:
        expected: what the model should return, as a clause, for example "a heading should be a complex number".
        answer: what was returned.
        model: the model or the function that returned it.
    """
    text = value_text(answer)
    if isinstance(answer, np.ndarray) and answer.size > MAX_ITEMS:
        text = f"an array of shape {answer.shape}, {text}"
    text = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
    return AnswerError(f"{expected}, got {text} from {name_and_place(model)}")


def name_and_place(model: object) -> str:
    """Return the name of a model, with its parameters if its `repr` has them, and with the place of a user's code."""
    while isinstance(model, partial):
        model = model.func
    if isinstance(model, FunctionType | MethodType | type):
        name = model.__qualname__.rpartition("<locals>.")[2]
    else:
        has_text = type(model).__repr__ is not object.__repr__
        name = value_text(model) if has_text else type(model).__qualname__.rpartition("<locals>.")[2]
    place = _place(model)
    return f"{name} ({place})" if place else name


def _place(model: object) -> str:
    """Return the file and the line where the class or function of a user begins; "" if they are not known."""
    if isinstance(model, FunctionType | MethodType):
        code: Any = getattr(model, "__code__", None)
        return "" if code is None or str(model.__module__).partition(".")[0] in OURS else _place_of(code)
    kind = model if isinstance(model, type) else type(model)
    if is_ours(kind):
        return ""
    members = [*vars(kind).values()]  # to look at a part of a pydantic model may complete its class
    methods = (getattr(getattr(member, "__func__", member), "__code__", None) for member in members)
    codes = [code for code in methods if code is not None and code.co_name in vars(kind)]
    codes = [code for code in codes if code.co_filename != "<string>"] or codes  # a dataclass generates methods
    return _place_of(min(codes, key=lambda code: code.co_firstlineno)) if codes else ""


def _place_of(code: Any) -> str:
    """Return the file of a function, relative to the working directory if the file is below that, and the line."""
    file = Path(code.co_filename)
    is_below = file.is_absolute() and file.is_relative_to(Path.cwd())
    return f"{os.path.relpath(file) if is_below else file}, line {code.co_firstlineno}"

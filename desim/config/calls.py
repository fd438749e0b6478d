"""Whether a function or object of a user can be called as a model is, before a run calls it."""

from collections.abc import Callable, Sequence
from functools import partial
from inspect import Signature, getattr_static, isasyncgenfunction, iscoroutinefunction, isgeneratorfunction, signature
from typing import Any

from desim.config.answers import name_and_place
from desim.config.arguments import value_text
from desim.config.errors import AnswerError


def check_method(value: Any, name: str, takes: Sequence[str]) -> None:
    """Raise ValueError if a model has no method of this name that can be called with these arguments."""
    method: Any = getattr(value, name, None)
    if not callable(method):
        shown = f"{value_text(method)} of {name_and_place(value)}"
        raise ValueError(f"{name} should be a method {name}({', '.join(takes)}) (got {shown})")
    check_call(method, takes, value, whose=f"{name} ")


def check_call(function: Callable[..., Any], takes: Sequence[str], value: Any, *first: Any, whose: str = "") -> None:
    """Raise AnswerError if a function cannot be called with the arguments `first`, and then those named in `takes`.

    The message names `value`: the function, object or class that the user gave. It begins with `whose`.
    """
    functions = _called_functions(function)
    if any(map(iscoroutinefunction, functions)) or any(map(isasyncgenfunction, functions)):
        advice = "should have `def` in place of `async def`, and `yield` to wait"
        raise AnswerError(f"{whose}{advice}: {name_and_place(value)}")
    called: Any = function
    if isinstance(getattr_static(type(function), "__call__", None), staticmethod | classmethod):
        called = called.__call__  # otherwise `signature` leaves out the first argument, as if it were self
    try:
        parameters = own_signature(called)
    except (TypeError, ValueError):  # some functions in C have no signature
        return
    try:
        parameters.bind(*first, *takes)
    except TypeError as error:
        call = f"a call with ({', '.join(takes)})" if takes else "a call without arguments"
        raise AnswerError(f"{whose}should accept {call}; {name_and_place(value)} does not: {error}") from error


def own_signature(function: Callable[..., Any]) -> Signature:
    """Return the arguments that a function takes itself; a function that it wraps may take more.

    A function without a signature, such as one of `functools.cache`, takes the arguments of what it wraps.

    Raises:
        TypeError, ValueError: if neither has a signature, as some functions in C.
    """
    try:
        return signature(function, follow_wrapped=False)
    except ValueError:
        return signature(function)


def check_argument(function: Any, takes: Sequence[str], name: str) -> None:
    """Raise ValueError if an argument is no function that can be called with the arguments named in `takes`."""
    if not callable(function):
        raise ValueError(f"{name} should be a function (got {value_text(function)})")
    check_call(function, takes, function, whose=f"{name} ")


def check_action(function: Any, takes: Sequence[str], name: str) -> None:
    """Raise ValueError if an argument is no function that does its work when it is called; see `check_argument`."""
    check_argument(function, takes, name)
    check_at_once(function, f"{name} ")


def check_at_once(function: Callable[..., Any], whose: str = "") -> None:
    """Raise AnswerError if a function would do nothing when it is called, because it is a generator."""
    if any(map(isgeneratorfunction, _called_functions(function))):
        raise AnswerError(f"{whose}should do its work when it is called, without yield: {name_and_place(function)}")


def _called_functions(function: Any) -> tuple[Any, Any]:
    """Return the function inside of partial functions, and the `__call__` of its class; for a class, None instead."""
    while isinstance(function, partial):
        function = function.func
    return function, None if isinstance(function, type) else getattr(type(function), "__call__", None)  # noqa: B004

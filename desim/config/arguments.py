"""Arguments of functions: an object that is not what a function takes is refused with what to write instead."""

from collections.abc import Mapping
from os import PathLike
from types import MappingProxyType
from typing import Any, NamedTuple


class Argument(NamedTuple):
    """What a function takes, and what to write for objects that users give in its place."""

    noun: str
    """What it is, for example "a scenario"."""
    kind: type | tuple[type, ...]
    """The class of the objects, or several."""
    instead: Mapping[str, str]
    """By name of a class of other objects, the code to write; "path" stands for a path or a text. `{function}` and
    `{value}` stand for the name of the function and for the object."""

    def check(self, value: Any, function: str) -> None:
        """Raise TypeError if a value is not what a function takes; the message says what to write instead."""
        if not isinstance(value, self.kind):
            raise TypeError(f"{function} takes {self.noun}, {self._advice(value, function)}")

    def _advice(self, value: Any, function: str) -> str:
        """Return what the value is, and what to write instead."""
        if isinstance(value, type):
            call = f": {function}({value.__name__}(...))" if issubclass(value, self.kind) else ""
            return f"not the class {value.__name__}{call}"
        is_path = isinstance(value, str | PathLike)
        name, shown = type(value).__name__, repr(str(value) if is_path else value)
        code = self.instead.get("path" if is_path else name)
        if code is None:
            return f"not a {name} (got {shown if len(shown) < MAX_SHOWN else shown[: MAX_SHOWN - 3] + '...'})"
        what = "a path" if is_path else f"an {name}" if name[0] in "AEIOU" else f"a {name}"
        return f"not {what}: {code.format(function=function, value=shown)}"


MAX_SHOWN = 60
"""The largest number of characters of a value that a message shows."""


def scenario_argument(kind: type) -> Argument:
    """Return the argument of functions that take a scenario, given its class."""
    instead = {
        "path": "{function}(load({value}))",
        "dict": "{function}(Scenario(**keys))",
        "Result": "{function}(result.scenario)",
        "list": "[{function}(scenario) for scenario in scenarios]",
    }
    return Argument("a scenario", kind, MappingProxyType(instead))


def run_argument(*kinds: type) -> Argument:
    """Return the argument of functions that take the result of a run, given its classes."""
    instead = {
        "path": "{function}(desim.open({value})) for a folder, {function}(run(load({value}))) for a scenario file",
        "Scenario": "{function}(run(scenario))",
        "SweepResult": "print(result), result.table() and result.plot() show a sweep",
        "list": "[{function}(result) for result in results]",
    }
    return Argument("the result of a run", kinds, MappingProxyType(instead))

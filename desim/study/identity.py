"""What tells configurations apart: all that a run depends on but its seed, user's code included."""

import hashlib
import inspect
import json
import re
from functools import partial
from types import CodeType, FunctionType
from typing import Any

from pydantic import BaseModel

from desim.scenario import Scenario
from desim.study.foreign import parts, strangers

UNSWEPT = ("seed", "name", "sweep")
"""What does not tell one configuration from another."""


def identity(scenario: Scenario) -> str:
    """Return what tells configurations apart: a hash of the scenario without its name, seed and sweep.

    What is not installed but comes from a script, a notebook or a file counts with its source, and with what it holds,
    so that nobody takes the results of another version of it for those of this one. What it imports does not count, nor
    do globals that it reads.
    """
    return _hash(json.dumps(resolved(scenario), sort_keys=True))


def resolved(scenario: Scenario) -> dict[str, Any]:
    """Return all that a run of a scenario depends on but its seed, as JSON has it."""
    held = sorted(_hash(text) for each in parts(scenario) if (text := _held(each)))
    tables = json.loads(scenario.model_dump_json(exclude=set(UNSWEPT)))
    return {**tables, "code": code(scenario), "held": held}


def code(scenario: Scenario) -> dict[str, str]:
    """Return a hash of the source of each class and function in a scenario that is not desim's, by its name."""
    sources: dict[str, set[str]] = {}  # several lambdas have one name
    for home in strangers(scenario):
        sources.setdefault(f"{home.__module__}:{home.__qualname__}", set()).add(_source(home))
    return {name: _hash("".join(sorted(texts))) for name, texts in sources.items()}


def _held(value: Any) -> str:
    """Return what a value holds that its model does not tell: of an object or a function."""
    if isinstance(value, BaseModel):
        return ""
    held: Any = vars(value) if hasattr(value, "__dict__") else value
    if isinstance(value, FunctionType):
        held = inspect.getclosurevars(value).nonlocals, value.__defaults__, value.__kwdefaults__
    elif isinstance(value, partial):
        held = value
    return re.sub(r" at 0x\w+", "", repr(held))


def _source(home: Any) -> str:
    """Return the source of a class or function: its own if it is of a script, else that of its module."""
    functions = [home] if isinstance(home, FunctionType) else vars(home).values()
    compiled = "".join(_compiled(each.__code__) for each in functions if isinstance(each, FunctionType))
    try:
        text = inspect.getsource(home if home.__module__ == "__main__" else inspect.getmodule(home) or home)
    except (OSError, TypeError):  # typed at a prompt
        return compiled
    return text + compiled if "<lambda>" in home.__qualname__ else text  # there may be another one in its line


def _compiled(compiled: CodeType) -> str:
    constants = [_compiled(each) if isinstance(each, CodeType) else repr(each) for each in compiled.co_consts]
    return f"{compiled.co_code.hex()} {compiled.co_names} {constants}"


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]

"""What tells configurations apart: all that a run depends on but its seed, user's code included."""

import hashlib
import inspect
import json
from collections.abc import Iterator
from types import FunctionType, MappingProxyType
from typing import Any

from pydantic import BaseModel

from desim.config.choice import import_name
from desim.scenario.overrides import ScenarioError
from desim.scenario.scenario import Scenario
from desim.study.fingerprint import Fingerprint, UnstableHashError, is_user_code, user_code

UNSWEPT = MappingProxyType(
    {
        "seed": "the number of seeds is sweep.reps",
        "name": "a name changes nothing in a run",
        "sweep": "it is the same for all configurations",
    }
)
"""What does not tell one configuration from another, and why."""
ADVICE = "let it hold values, or give the class of what holds it a __getstate__ that leaves it out"
"""What to do about what cannot be told apart."""


def config_hash(scenario: Scenario) -> str:
    """Return what tells configurations apart: a hash of the scenario without its name, seed and sweep.

    What is not installed but comes from a script, a notebook or a file counts with its source, and with what it holds,
    so that nobody takes the results of another version of it for those of this one: see `fingerprint`. What a module
    imports does not count.

    Raises:
        ScenarioError: if it holds what cannot be told apart, and where.
    """
    whole = {**tables(scenario), "code": code(scenario), "held": list(_held(scenario))}
    return _hash(json.dumps(whole, sort_keys=True))


def tables(scenario: Scenario) -> dict[str, Any]:
    """Return what a file can say of all that a run depends on but its seed, as JSON has it."""
    found: dict[str, Any] = json.loads(scenario.model_dump_json(exclude=set(UNSWEPT)))
    return found


def code(scenario: Scenario) -> dict[str, str]:
    """Return a hash of the source of each class and function in a scenario that is not desim's, by its name."""
    sources: dict[str, set[str]] = {}  # several lambdas have one name
    for home in user_code(scenario):
        sources.setdefault(import_name(home), set()).add(_source(home))
    return {name: _hash("".join(sorted(texts))) for name, texts in sources.items()}


def _held(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the dotted key and the fingerprint of each object in a scenario that is not desim's."""
    fingerprint = Fingerprint()
    for key, each in _own(scenario, ""):
        try:
            yield key, fingerprint(each)
        except UnstableHashError as error:
            raise ScenarioError(f"{key}: {error}; {ADVICE}") from error


def _own(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Yield what is called in a value, or in what it is made of, and its tables do not tell, with its dotted key."""
    inner: Any = ()
    if isinstance(value, BaseModel) and not is_user_code(value):
        inner = [(name, getattr(value, name)) for name in type(value).model_fields if key or name not in UNSWEPT]
    elif isinstance(value, tuple | list):
        inner = enumerate(value)
    elif isinstance(value, BaseModel) or callable(value):
        yield key, value
    for name, each in inner:
        yield from _own(each, f"{key}.{name}" if key else str(name))


def _source(home: Any) -> str:
    """Return the source of a class or function: its own if it is of a script, else that of its module."""
    functions = [home] if isinstance(home, FunctionType) else vars(home).values()
    compiled = "".join(Fingerprint()(each.__code__) for each in functions if isinstance(each, FunctionType))
    try:
        text = inspect.getsource(home if home.__module__ == "__main__" else inspect.getmodule(home) or home)
    except (OSError, TypeError):  # typed at a prompt
        return compiled
    return text + compiled if "<lambda>" in home.__qualname__ else text  # there may be another one in its line


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]

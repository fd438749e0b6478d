"""The hash of a configuration: of its parameters and its user code, without the seed."""

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
"""The keys that are no part of a configuration, and why they cannot be swept."""
ADVICE = "store plain values instead, or leave it out in the __getstate__ of the class that holds it"
"""How to give an object a stable hash."""


def config_hash(scenario: Scenario) -> str:
    """Return a hash of 16 hexadecimal digits of a scenario without its name, seed and sweep.

    Classes and functions from a script, a notebook or a file are hashed with their source and the values they hold, so
    that results of different versions are never confused; see `fingerprint`. Modules that they import are not hashed.

    Raises:
        ScenarioError: if the scenario holds an object without a stable hash; the text names its key.
    """
    whole = {**tables(scenario), "code": code(scenario), "held": list(_fingerprints(scenario))}
    return _hash(json.dumps(whole, sort_keys=True))


def tables(scenario: Scenario) -> dict[str, Any]:
    """Return the part of a configuration that a scenario file can express, as JSON-compatible tables."""
    found: dict[str, Any] = json.loads(scenario.model_dump_json(exclude=set(UNSWEPT)))
    return found


def code(scenario: Scenario) -> dict[str, str]:
    """Return a hash of the source of each user-defined class and function in a scenario, by its import name."""
    sources: dict[str, set[str]] = {}  # several lambdas have one name
    for home in user_code(scenario):
        sources.setdefault(import_name(home), set()).add(_source(home))
    return {name: _hash("".join(sorted(texts))) for name, texts in sources.items()}


def _fingerprints(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the dotted key and the fingerprint of each user-defined object in a scenario."""
    fingerprint = Fingerprint()
    for key, each in _user_objects(scenario, ""):
        try:
            yield key, fingerprint(each)
        except UnstableHashError as error:
            raise ScenarioError(f"{key}: {error}; {ADVICE}") from error


def _user_objects(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Yield each callable and each user-defined model inside a value, with its dotted key; `tables` omits code."""
    inner: Any = ()
    if isinstance(value, BaseModel) and not is_user_code(value):
        inner = [(name, getattr(value, name)) for name in type(value).model_fields if key or name not in UNSWEPT]
    elif isinstance(value, tuple | list):
        inner = enumerate(value)
    elif isinstance(value, BaseModel) or callable(value):
        yield key, value
    for name, each in inner:
        yield from _user_objects(each, f"{key}.{name}" if key else str(name))


def _source(home: Any) -> str:
    """Return the source of a class or function: its own if it is defined in a script, else that of its module."""
    functions = [home] if isinstance(home, FunctionType) else vars(home).values()
    compiled = "".join(Fingerprint()(each.__code__) for each in functions if isinstance(each, FunctionType))
    try:
        text = inspect.getsource(home if home.__module__ == "__main__" else inspect.getmodule(home) or home)
    except (OSError, TypeError):  # defined at an interactive prompt
        return compiled
    return text + compiled if "<lambda>" in home.__qualname__ else text  # the line may hold several lambdas


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]

"""The configurations of a sweep: each combination of the values of a grid, and what tells one from another."""

import hashlib
import inspect
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

from pydantic import BaseModel

from desim.scenario import Scenario
from desim.scenario_file import validate
from desim.source import ScenarioError, Source
from desim.study.shipping import strangers

Grid = Mapping[str, Sequence[Any]]
"""Keys of a scenario, dotted, and the values that each takes."""
UNSWEPT = ("seed", "name", "sweep")
"""What does not tell one configuration from another."""
MOST_FAULTS = 20
"""How many faults of a grid are told of."""


@dataclass(frozen=True)
class Cell:
    """A configuration: one combination of the values of a grid."""

    settings: Mapping[str, Any]
    """The value of each key of the grid."""
    scenario: Scenario

    @cached_property
    def key(self) -> str:
        """What tells it from others; see `identity`."""
        return identity(self.scenario)

    @property
    def columns(self) -> dict[str, Any]:
        """The settings as a table has them: numbers, truths and texts as they are, all else as text."""
        plain = (int, float, str)
        return {key: each if isinstance(each, plain) else label(each) for key, each in self.settings.items()}

    def __str__(self) -> str:
        return ", ".join(f"{key} = {label(value)}" for key, value in self.settings.items())


def cells(source: Source, grid: Grid) -> list[Cell]:
    """Return the configurations of a grid over a scenario; the last key changes fastest.

    Raises:
        ScenarioError: with all that is wrong with keys and values; if there are none, or some are the same.
    """
    if not grid:
        raise ScenarioError(
            f"{source.where(('sweep', 'grid'))}: sweep.grid: should have at least one key of the scenario, and a list"
            ' of values for it, "network.latency.value" = [0.0, 0.1] for instance'
        )
    for key, values in grid.items():
        if key.partition(".")[0] in UNSWEPT:
            raise ScenarioError(f"{_where(source, key)}: {key} cannot be swept; the number of seeds is sweep.reps")
        if not isinstance(values, list | tuple) or not values:
            raise ScenarioError(
                f"{_where(source, key)}: {key}: should be a list of at least one value (got {values!r})"
            )
    found: list[Cell] = []
    faults: dict[str, None] = {}  # in order, each once
    for values in product(*grid.values()):
        settings = dict(zip(grid, values, strict=True))
        try:
            found.append(Cell(settings, _set(source, settings)))
        except ScenarioError as error:
            faults |= dict.fromkeys(str(error).splitlines())
    if faults:
        more = [f"... and {len(faults) - MOST_FAULTS} more"] if len(faults) > MOST_FAULTS else []
        raise ScenarioError("\n".join([*list(faults)[:MOST_FAULTS], *more]))
    seen: dict[str, Cell] = {}
    for cell in found:
        if seen.setdefault(cell.key, cell) is not cell:
            raise ScenarioError(
                f"{_where(source, next(iter(grid)))}: '{cell}' is the same configuration as '{seen[cell.key]}'"
            )
    return found


def _where(source: Source, key: str) -> str:
    return f"{source.where(('sweep', 'grid', key))}: sweep.grid"


def _set(source: Source, settings: Mapping[str, Any]) -> Scenario:
    """Return a scenario with some keys set to other values."""
    changed = source.copy()
    try:
        for key, value in settings.items():
            changed.set(key, value, _where(source, key))
    except ScenarioError as error:
        raise ScenarioError(f"{_where(source, key)}: {error}") from error
    try:
        return validate(changed)
    except ScenarioError as error:  # what is wrong elsewhere is so with these values
        given = ", ".join(f"{key} = {label(value)}" for key, value in settings.items())
        lines = str(error).splitlines()
        raise ScenarioError(
            "\n".join(line if ": sweep.grid: " in line else f"{line} (with {given})" for line in lines)
        ) from error


def identity(scenario: Scenario) -> str:
    """Return what tells configurations apart: a hash of the scenario without its name, seed and sweep.

    What is not installed but comes from a script, a notebook or a file counts with its source, so that nobody takes
    the results of another version of it for those of this one.
    """
    text = json.dumps(resolved(scenario), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def resolved(scenario: Scenario) -> dict[str, Any]:
    """Return all that a run of a scenario depends on but its seed, as JSON has it."""
    code = sorted({hashlib.sha256(_code(each).encode()).hexdigest()[:16] for each in strangers(scenario)})
    return {name: each for name, each in scenario.plain().items() if name not in UNSWEPT} | {"code": code}


def _code(home: Any) -> str:
    """Return the source of a class or function: its own if it is of a script, else that of its module."""
    try:
        return inspect.getsource(home if home.__module__ == "__main__" else sys.modules[home.__module__])
    except (OSError, TypeError):  # typed at a prompt
        return repr(getattr(getattr(home, "__code__", None), "co_code", home.__qualname__))


def label(value: Any) -> str:
    """Return a value of a grid as a short text; a model as its kind and what was given of it."""
    if isinstance(value, BaseModel):
        kind = getattr(value, "kind", type(value).__name__)
        value = {"kind": kind} | {k: getattr(value, k) for k in sorted(value.model_fields_set - {"kind"})}
    if isinstance(value, dict):
        inner = ", ".join(f"{key}={label(each)}" for key, each in value.items() if key != "kind")
        kind = str(value.get("kind", ""))
        return f"{kind}({inner})" if inner or not kind else kind
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(label, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float | str):
        return f"{value:g}" if isinstance(value, float) and value == float(f"{value:g}") else str(value)
    return getattr(value, "__name__", type(value).__name__)

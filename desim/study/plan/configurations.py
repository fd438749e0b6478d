"""The configurations of a sweep: all combinations of the values of a grid, all valid and distinct."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations, product
from math import isfinite, prod, ulp
from typing import Any

from pydantic import BaseModel

from desim.config.arguments import scenario_argument, value_text
from desim.config.data_files import content_hash, in_short
from desim.config.errors import Problem
from desim.config.model import Value
from desim.config.parameters import are_equal, as_jsonable, as_key, is_named_only, parameters_of
from desim.config.suggestion import did_you_mean
from desim.config.traits import kind_of
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.scenario import Scenario, without_metrics
from desim.scenario.sweep_table import Design, Sweep
from desim.scenario.toml import validate
from desim.scenario.value_ranges import is_range, values_to_try
from desim.study.plan.config_hash import UNSWEPT, Identity, identify
from desim.study.plan.designs import design_settings, drawn_keys

SweepGrid = Mapping[str, Sequence[Any]]
"""Dotted keys of a scenario, and the values that each takes."""
Settings = Mapping[str, Any]
"""The value of each key of a grid."""
METRICS_UNSWEPT = "every run has the same metrics"
"""Why `record.metrics` cannot be swept."""
MAX_ERRORS = 20
"""The largest number of validation errors of a grid that an error message lists."""
LONGEST = 80
"""The largest length of the content of an object, such as an array, in the name of a configuration, characters."""
MAX_CONFIGURATIONS = 100_000
"""The largest number of configurations of a grid; validating one takes about 1 ms."""


@dataclass(frozen=True)
class Configuration:
    """A configuration: one combination of the values of a grid."""

    settings: Settings
    scenario: Scenario

    @cached_property
    def identity(self) -> Identity:
        """The identity of the runs of the configuration, apart from their seeds."""
        return identify(self.scenario)

    @property
    def key(self) -> str:
        """The hash that identifies the configuration."""
        return self.identity.key

    @property
    def columns(self) -> dict[str, Any]:
        """The settings as table cells: numbers, booleans and texts unchanged, other values as text."""
        plain = (int, float, str)
        return {key: value if isinstance(value, plain) else label(value) for key, value in self.settings.items()}

    def __str__(self) -> str:
        return in_words(self.settings)


def distinct(repeated: Iterable[Configuration]) -> tuple[Configuration, ...]:
    """Return configurations without those that have the same runs as an earlier one."""
    by_key: dict[str, Configuration] = {}
    for configuration in repeated:
        by_key.setdefault(configuration.key, configuration)
    return tuple(by_key.values())


def configurations(
    source: Source, grid: SweepGrid | None = None, design: Design | str | None = None
) -> list[Configuration]:
    """Return all configurations of a grid (by default the scenario's own); the last key changes fastest.

    If the grid has ranges, a design draws points from them, each with all combinations of values of the other keys.

    Raises:
        ScenarioError: if keys or values are invalid (the message lists them), there are no or too many configurations,
            two of them are the same or have the same name, an object has no stable hash, or the grid has ranges without
            a design, or a design without ranges.
    """
    source, sweep = sweep_of(source, grid, design)
    grid = checked_ranges(source, sweep.grid)
    _check_design(source, grid, sweep.design)
    drawn = drawn_keys(grid, sweep.design) if sweep.design else []
    points = sweep.design.size if sweep.design else 1
    size = points * prod(len(values) for key, values in grid.items() if key not in drawn)
    if size > MAX_CONFIGURATIONS:
        most = f"{MAX_CONFIGURATIONS:,} configurations"
        raise ScenarioError(_about_grid(source, f"should have at most {most}, has {size:,}"))
    if sweep.design is not None:
        return valid_configurations(source, grid, design_settings(grid, sweep.design))
    combinations_of_values = (dict(zip(grid, values, strict=True)) for values in product(*grid.values()))
    return valid_configurations(source, grid, combinations_of_values)


def as_source(scenario: Scenario | Source, function: str) -> Source:
    """Return the source of a scenario.

    Raises:
        TypeError: if the scenario has another type; the message says what `function`, a public one, takes.
    """
    if isinstance(scenario, Source):
        return scenario
    scenario_argument(Scenario).check(scenario, function)
    return Source.of(scenario)


def sweep_of(source: Source, grid: SweepGrid | None, design: Design | str | None = None) -> tuple[Source, Sweep]:
    """Return a source with another grid or design (None: its own), and its table `sweep`.

    Raises:
        ScenarioError: if the scenario is invalid, or the grid is empty.
        TypeError: if the grid is not a mapping.
    """
    unchecked: Any = grid
    if not isinstance(unchecked, Mapping | None):
        example = "{'network.latency.value': [0.0, 0.1]}"
        raise TypeError(f"the grid should be lists of values by key, {example} for instance (got {value_text(grid)})")
    if grid is not None or design is not None:
        source = _with_grid(source, grid, design)
    sweep = validate(source).sweep  # validated once only, because a grid from Python may hold generators
    if not sweep.grid:
        reason = (
            "should have at least one key of the scenario, and a list of values for it,"
            ' "network.latency.value" = [0.0, 0.1] for instance'
            " (on the command line --grid network.latency.value=0,0.1,"
            ' in Python the grid {"network.latency.value": [0.0, 0.1]})'
        )
        raise ScenarioError(_about_grid(source, reason))
    return source, sweep


def check_grid(source: Source) -> None:
    """Raise ScenarioError if the grid of a scenario cannot be run.

    Ranges without a design are valid, because a sensitivity analysis takes them.
    """
    sweep = validate(source).sweep
    grid = checked_ranges(source, sweep.grid)
    if sweep.design is None and any(map(is_range, grid.values())):
        # One configuration for each value of each key that has no range, with the first values of the others.
        changes = ({key: value} for key, values in grid.items() if not is_range(values) for value in values)
        first_values = {key: values_to_try(values)[0] for key, values in grid.items()}
        to_try = [first_values | change for change in [{}, *changes]]
        valid_configurations(source, grid, {repr(settings): settings for settings in to_try}.values())
    else:
        configurations(source)


def checked_ranges(source: Source, grid: SweepGrid) -> SweepGrid:
    """Return a grid in which `is_whole` of a range says whether its key takes whole numbers only.

    Raises:
        ScenarioError: if a key does not take an end of its range, or a table comes after a key that it contains.
    """
    for inner, table in combinations(grid, 2):
        if inner.startswith(f"{table}."):
            raise ScenarioError(_about_grid(source, f"would replace {inner}: give {table} first", table))
    first_values = {key: values_to_try(values)[0] for key, values in grid.items()}
    checked, problems = dict(grid), list[Problem]()
    for key, (interval, *_) in ((key, values) for key, values in grid.items() if is_range(values)):
        if interval.low % 1.0 == interval.high % 1.0 == 0.0:
            # A key of whole numbers refuses the number halfway between two of them.
            takes_halves = not _problems_of_key(source, first_values | {key: interval.low + 0.5}, key)
            interval = replace(interval, is_whole=not takes_halves)
            checked[key] = (interval,)
        first_values[key] = interval.at(0.0)
        for end in values_to_try(checked[key]):
            problems += _problems_of_key(source, first_values | {key: end}, key)
    if problems:
        raise ScenarioError(*dict.fromkeys(problems))
    return checked


def _problems_of_key(source: Source, settings: Settings, key: str) -> list[Problem]:
    """Return what is wrong with the value of one key in some settings."""
    changed, unset = _source_with(source, settings)
    problems = unset.get(key, [])
    try:
        validate(changed)
    except ScenarioError as error:
        problems += [problem for problem in error.problems if _swept_above(problem.key, [key])]
    return problems


def _check_design(source: Source, grid: SweepGrid, design: Design | None) -> None:
    """Raise ScenarioError if a grid has ranges and there is no design, or a design has nothing to draw."""
    ranges = [key for key, values in grid.items() if is_range(values)]
    if design is None and ranges:
        reason = (
            f"{grid[ranges[0]][0]} is a range without steps, from which a design chooses:"
            ' give a step, or `sweep.design`, --design or design, "sobol:64" for instance'
        )
        raise ScenarioError(_about_grid(source, reason, ranges[0]))
    if design is None:
        return
    place = ("sweep", "design")
    if missing := [key for key in design.drawn if key not in grid]:
        reason = f"the grid has no key {missing[0]}{did_you_mean(missing[0], grid)}"
        raise ScenarioError(Problem(reason, "sweep.design.drawn", source.where((*place, "drawn")), source.line(place)))
    if not drawn_keys(grid, design):
        reason = (
            'has nothing to choose: the grid should have a range, "network.loss.p" = "0:0.5" for instance, or `drawn`'
            " should name a key"
        )
        raise ScenarioError(Problem(reason, "sweep.design", source.where(place), source.line(place)))


def valid_configurations(source: Source, grid: SweepGrid, all_settings: Iterable[Settings]) -> list[Configuration]:
    """Return the configurations with some settings of the keys of a grid, in order.

    Raises:
        ScenarioError: if settings are invalid (the message lists them), two configurations are the same or have the
            same name, or an object in one has no stable hash.
    """
    valid: list[Configuration] = []
    errors: dict[Problem, list[Settings]] = {}
    for settings in all_settings:
        try:
            valid.append(Configuration(settings, _scenario_with(source, settings)))
        except ScenarioError as error:
            for problem in error.problems:
                errors.setdefault(problem, []).append(settings)
    if errors:
        lines = sorted(
            (_with_cause(problem, affected, source, grid) for problem, affected in errors.items()),
            key=lambda problem: problem.line,
        )
        omitted = [f"... and {len(lines) - MAX_ERRORS} more"] if len(lines) > MAX_ERRORS else []
        raise ScenarioError(*lines[:MAX_ERRORS], *omitted)
    _check_distinct(valid, source, grid)
    return valid


def _check_distinct(listed: Sequence[Configuration], source: Source, grid: SweepGrid) -> None:
    """Raise ScenarioError if two configurations are the same or have the same name, or if one has no stable hash."""
    by_key: dict[str, Configuration] = {}
    by_name: dict[str, Configuration] = {}
    for configuration in listed:
        try:
            same = by_key.setdefault(configuration.key, configuration)
        except ScenarioError as error:
            raise with_place(error, source, configuration.settings) from error
        namesake = by_name.setdefault(json.dumps(configuration.columns), configuration)
        if same is not configuration:
            other, reason = same, f"'{configuration}' is the same configuration as '{same}'"
        elif namesake is not configuration:
            other = namesake
            reason = (
                f"several configurations have the name '{configuration}': give functions distinct names (__name__), and"
                " objects a class with fields: a dataclass, or a desim.config.model.Value"
            )
        else:
            continue
        differing = [key for key, value in configuration.settings.items() if not are_equal(value, other.settings[key])]
        # Without a differing key, some key repeats a value.
        repeated = [key for key, values in grid.items() if any(_count(value, values) > 1 for value in values)]
        raise ScenarioError(_about_grid(source, reason, (differing or repeated)[0]))


def with_place(error: ScenarioError, source: Source, settings: Iterable[str] = ()) -> ScenarioError:
    """Return a copy of an error that says where its key is set or swept, see `Source.where`.

    `settings` holds the keys of the grid.
    """
    (problem,) = error.problems
    if swept := _swept_above(problem.key, settings):
        where = source.where(("sweep", "grid", swept))
        return ScenarioError(problem._replace(key="sweep.grid", reason=str(problem), where=where))
    place = tuple(int(part) if part.isdigit() else part for part in problem.key.split("."))
    return ScenarioError(problem._replace(where=source.where(place)))


def _swept_above(key: str, settings: Iterable[str]) -> str | None:
    """Return the key of a grid that equals a dotted key, or that is a table around it; None if there is none."""
    return next((setting for setting in settings if f"{key}.".startswith(f"{setting}.")), None)


def _with_grid(source: Source, grid: SweepGrid | None, design: Design | str | None) -> Source:
    """Return a copy of a source with another grid or another design; None: the source's own.

    A new grid replaces the whole table `sweep`, whose design belongs to the source's own grid.
    """
    changed = source.copy()
    if grid is not None:
        for key, values in grid.items():
            if isinstance(values, Value):
                raise ScenarioError(
                    Problem(f"{key}: should be a list: [{value_text(values)}]", "sweep.grid", "the grid")
                )
        changed.tables["sweep"] = {"grid": grid}
        changed.origins["sweep", "grid"] = "the grid"
    if design is not None:
        changed.tables["sweep"] = {**changed.tables.get("sweep", {}), "design": design}
        changed.origins["sweep", "design"] = "the design"
    return changed


def _about_grid(source: Source, reason: str, *keys: str) -> Problem:
    """Return a problem with the grid of a sweep, or with one of its keys."""
    place = "sweep", "grid", *keys
    return Problem(": ".join([*keys, reason]), "sweep.grid", source.where(place), source.line(place))


def _scenario_with(source: Source, settings: Settings) -> Scenario:
    """Return the scenario of a source with some keys set to other values, without its sweep and its metrics.

    Raises:
        ScenarioError: with all errors, if a key cannot be swept or the scenario is not valid.
    """
    changed, unset = _source_with(source, settings)
    errors = [problem for problems in unset.values() for problem in problems]
    try:
        scenario = validate(changed)
    except ScenarioError as error:
        errors += error.problems
    if errors:
        raise ScenarioError(*errors)
    return without_metrics(scenario)


def _source_with(source: Source, settings: Settings) -> tuple[Source, dict[str, list[Problem]]]:
    """Return a copy of a source with some keys set and without its sweep, and the problems of keys not set, by key."""
    changed = source.copy()
    changed.tables.pop("sweep", None)
    unset: dict[str, list[Problem]] = {}
    for key, value in settings.items():
        reason = METRICS_UNSWEPT if key.startswith("record.metrics") else UNSWEPT.get(key.partition(".")[0])
        if reason is not None:
            unset[key] = [_about_grid(source, f"cannot be swept; {reason}", key)]
            continue
        try:
            changed.set(key, value, f"{source.where(('sweep', 'grid', key))}: sweep.grid")
        except ScenarioError as error:
            reasons = ((problem.reason if problem.key == key else str(problem)) for problem in error.problems)
            unset[key] = [_about_grid(source, reason, key) for reason in reasons]
    return changed, unset


def _with_cause(problem: Problem, affected: Sequence[Settings], source: Source, grid: SweepGrid) -> Problem:
    """Return a problem whose reason also names the settings that cause it.

    `affected` holds the settings of all configurations with this problem. A setting is a cause if another value of its
    key does not give this problem. If there is no cause, all settings of the first configuration are named. If there
    is at most one cause, a problem with a key of the grid keeps its reason.
    """
    first = affected[0].items()
    causes = {key: value for key, value in first if _is_cause([each[key] for each in affected], grid[key])}
    swept = _swept_above(problem.key, grid)
    if swept is not None:
        problem = problem._replace(line=source.line(("sweep", "grid", swept)))
    if len(causes) < 2 and (problem.key == "sweep.grid" or swept is not None):
        return problem
    return problem._replace(reason=f"{problem.reason} (with {in_words(causes or affected[0])})")


def _is_cause(values: Sequence[Any], all_values: Sequence[Any]) -> bool:
    return any(not _count(value, values) for value in all_values)


def _count(value: Any, values: Sequence[Any]) -> int:
    """Return how many of some values equal a value."""
    return sum(1 for other in values if are_equal(value, other))


def in_words(settings: Settings) -> str:
    """Return settings as one line of text."""
    return ", ".join(f"{key} = {label(value)}" for key, value in settings.items())


def label(value: Any) -> str:
    """Return a value of a grid as a short text; a model as its kind and the fields that were set."""
    if isinstance(value, BaseModel):
        value = {"kind": kind_of(value)} | {k: getattr(value, k) for k in sorted(value.model_fields_set)}
    is_model = callable(value)  # a user's model may be a named tuple, or a dict
    if is_model and isinstance(value, tuple) and hasattr(value, "_asdict"):
        return label({"kind": type(value).__name__} | value._asdict())
    if isinstance(value, dict) and not is_model:
        inner = ", ".join(f"{as_key(key)}={label(member)}" for key, member in value.items() if key != "kind")
        kind = str(value.get("kind", ""))
        return f"{kind}({inner})" if inner or not kind else kind
    if isinstance(value, list | tuple) and not is_model:
        return f"[{', '.join(map(label, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return "none"
    if isinstance(value, int | float | str):
        # 3 * 0.1 is shown as 0.3, from which it differs in the last bit.
        is_short = isinstance(value, float) and isfinite(value) and abs(value - float(f"{value:g}")) <= 2 * ulp(value)
        return f"{value:g}" if is_short else str(in_short(value))
    if isinstance(value, partial):
        arguments = [*map(label, value.args), *(f"{key}={label(argument)}" for key, argument in value.keywords.items())]
        return f"{label(value.func)}({', '.join(arguments)})"
    if (parameters := parameters_of(value)) is not None:
        return label({"kind": type(value).__name__} | parameters)
    if is_model or is_named_only(value):
        return str(getattr(value, "__name__", type(value).__name__))
    text = label(as_jsonable(value))
    return text if len(text) <= LONGEST else f"{type(value).__name__} with the hash {content_hash(text.encode())}"

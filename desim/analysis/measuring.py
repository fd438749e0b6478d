"""Measure a run: the built-in metrics, those that its scenario names, and those of its caller."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from math import isnan
from sys import float_info
from types import MappingProxyType
from typing import Any

from desim.analysis.metrics import METRICS, Metric, Summary
from desim.analysis.trace_index import trace_index
from desim.config.arguments import naming_arguments, run_argument, value_text
from desim.config.calls import check_action
from desim.config.errors import MetricError, NoMetricError
from desim.config.fresh import fresh_copy
from desim.config.python_numbers import as_python
from desim.config.suggestion import did_you_mean
from desim.scenario.named_metrics import NamedMetric, check_metric_name
from desim.scenario.scenario import Scenario, without_metrics
from desim.simulation.run import Result

Metrics = Mapping[str, Metric | Callable[[Result], Any]]
"""Metrics of a user by name: functions of a result that return a number, True, False or None, or `Metric` objects."""
COLUMNS = frozenset({"settings", "replication", "root_seed", "status", "traceback", "error"})
"""The columns that are not metrics, in tables of runs."""
UsersMetrics = tuple[tuple[str, Metric], ...]
"""A user's metrics, each with its name."""


@naming_arguments
def summary(result: Result, metrics: Metrics = MappingProxyType({})) -> Summary:
    """Return all metrics of one run: the built-in ones, those that its scenario names, and those given.

    If you need only one or two metrics, call their functions in `desim.analysis.metrics`.

    Args:
        result: the result of the run.
        metrics: further metrics by name: functions of a result that return a number, True, False or None.

    Raises:
        TypeError: if `result` is not the result of a run; the message says what to write instead.
        ValueError: if a metric is not a function, or if its name is already taken or is not an identifier.
        MetricError: if a user's metric fails, or returns a value of another type.
    """
    run_argument(Result).check(result, "summary")
    return measured(users_metrics(result.scenario.record.metrics, metrics), result)


def measured(added: UsersMetrics, result: Result) -> Summary:
    """Return the built-in metrics of a run and those of a user; see `summary`."""
    with (
        # metrics call models, which may have state; a metric that takes the summary of its result is not measured in it
        fresh_copy(without_metrics(result.scenario), with_collections=True) as scenario,
        fresh_copy(added, is_run=True) as fresh_metrics,  # a user's metric may have state, too
    ):
        index = trace_index(replace(result, scenario=scenario))
        values = {name: metric(index) for name, metric in METRICS.items()}
        values |= {name: _checked(name, metric, index) for name, metric in fresh_metrics}
    return Summary(values, {name: metric.unit for name, metric in added})


def _checked(name: str, metric: Metric, result: Result) -> bool | int | float | None:
    """Return the value of a user's metric for a run; None instead of nan.

    Raises:
        MetricError: if the metric raises an exception, or returns another type or an integer that is too large.
    """
    where = f"metric {name!r} of {result.scenario.name!r} with seed {result.seed}"
    try:
        returned = metric(result)
        value = as_python(returned)
    except (Exception, SystemExit) as error:
        raise MetricError(f"{where}: {type(error).__name__}: {error}") from error
    if value is not None and not isinstance(value, bool | int | float):
        raise MetricError(f"{where}: should return a number, True, False or None, not a {type(returned).__name__}")
    if isinstance(value, int) and abs(value) > float_info.max:  # means are floats
        raise MetricError(f"{where}: should return a number up to 1.8e308, not an integer of {value.bit_length()} bits")
    return None if isinstance(value, float) and isnan(value) else value


def users_metrics(named: Sequence[NamedMetric], more: Metrics = MappingProxyType({})) -> UsersMetrics:
    """Return the metrics that a scenario names (`record.metrics`), then those of `more`, each with its name.

    Raises:
        TypeError: if `more` is not a mapping.
        ValueError: if a metric is not a function, or if its name is already taken or is not an identifier.
    """
    functions: Any = more
    if not isinstance(functions, Mapping):
        form = "{'late': late} for instance; the built-in metrics are always measured"
        raise TypeError(f"metrics should be functions by name, {form} (got {value_text(more)})")
    metrics: dict[str, Metric] = {}
    pairs: list[tuple[Any, Any]] = [*((metric.name, metric.of) for metric in named), *functions.items()]
    for name, of in pairs:
        check_metric_name(name)
        key = name.lower()  # SQL does not tell cases apart
        if key in METRICS or key in COLUMNS or key in Scenario.model_fields:
            taken = "built-in metric" if key in METRICS else "column of tables" if key in COLUMNS else "scenario key"
            raise ValueError(f"metric {name!r} should have another name: there is a {taken} of this name")
        if not callable(of) or isinstance(of, type):
            raise ValueError(f"metric {name!r} should be a function of a result, got {value_text(of)}")
        function = of.of if isinstance(of, Metric) else of
        check_action(function, ("result",), f"metric {name!r}")
        if (other := next((earlier for earlier in metrics if earlier.lower() == key), name)) != name:
            raise ValueError(f"metric {name!r} should have another name: it differs from {other!r} only in case")
        metric = of if isinstance(of, Metric) else Metric(of)
        if metrics.setdefault(name, metric) != metric:
            raise ValueError(f"metric {name!r} should have another name: another metric has it")
    return tuple(metrics.items())


ONE_NAME = "metric should be the name of one metric, 'active_time' for instance"


def check_numeric(metric: str, added: Iterable[str] = ()) -> None:
    """Check that a name is that of a built-in metric with `is_number`, or one of the names in `added`.

    Raises:
        NoMetricError: if there is no such numeric metric.
        ValueError: if the argument is not one name.
    """
    value: Any = metric  # a caller may give a list of names, or a function
    if not isinstance(value, str):
        if isinstance(value, Sequence):
            raise ValueError(f"{ONE_NAME} (got {value_text(metric)})")
        name = getattr(value, "__name__", "mine")
        raise ValueError(
            f'metric should be a name: "{name}", with metrics={{"{name}": ...}} (got {value_text(metric)})'
        )
    if "," in metric:
        raise ValueError(f"{ONE_NAME} (got {metric!r})")
    numeric = [*(name for name, metric in METRICS.items() if metric.is_number), *added]
    if metric not in numeric:
        hint = did_you_mean(metric, numeric)
        raise NoMetricError(metric, f"there is no numeric metric {metric!r}{hint}; there are {', '.join(numeric)}")

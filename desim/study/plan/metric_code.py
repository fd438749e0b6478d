"""The hash of the code of each metric, by which a store detects that a metric has changed since it was computed."""

import hashlib
import inspect
from functools import cache
from types import FunctionType
from typing import Any

from desim.analysis.captures import captured
from desim.analysis.measuring import UsersMetrics
from desim.analysis.metrics import METRICS, Metric
from desim.study.plan.config_hash import globals_read, object_hash


def units_and_codes(user_metrics: UsersMetrics) -> dict[str, tuple[str, str]]:
    """Return the unit and the hash of the code of each metric, by name: the built-in metrics and those of a user.

    Raises:
        ValueError: if a metric holds an object without a stable hash.
    """
    hashes = {name: (metric.unit, _source_hash(metric)) for name, metric in METRICS.items()}
    for name, metric in user_metrics:
        try:
            hashes[name] = metric.unit, object_hash([metric.of, metric.given])
        except Exception as error:  # code of the metric may raise anything
            raise ValueError(f"metric {name!r}: {error}") from error
    return hashes


@cache
def _source_hash(metric: Metric) -> str:
    """Return a hash of the source of a built-in metric: the source of all functions that `_functions` returns.

    A store also records `desim.results.environment.code`, a hash of the other code that a run depends on.
    """
    try:
        source = "".join(map(inspect.getsource, _functions(metric.of)))
    except OSError:  # desim is installed without its source
        source = ""
    return hashlib.sha256(source.encode()).hexdigest()[:16]


def _functions(function_of_metric: Any) -> list[Any]:
    """Return the function of a metric and the functions of `desim.analysis.captures` that it calls, even indirectly."""
    functions = [function_of_metric]
    for function in functions:  # the list grows in the loop
        called = [function.__globals__.get(name) for name in sorted(globals_read(function.__code__))]
        functions += [
            member
            for member in called
            if isinstance(member, FunctionType) and member.__module__ == captured.__module__ and member not in functions
        ]
    return functions

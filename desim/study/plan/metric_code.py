"""The hash of the code of each metric, by which a store detects that a metric has changed since it was computed."""

import hashlib
import inspect
from functools import cache
from types import FunctionType
from typing import Any

from desim.analysis.metrics import METRICS, Metric, UsersMetrics, summary
from desim.study.plan.config_hash import globals_read, object_hash


def units_and_codes(own: UsersMetrics) -> dict[str, tuple[str, str]]:
    """Return the unit and the hash of the code of each metric, by name: the built-in metrics and those of a user.

    Raises:
        ValueError: if a metric holds an object without a stable hash.
    """
    found = {name: (metric.unit, _source_hash(metric)) for name, metric in METRICS.items()}
    for name, metric in own:
        try:
            found[name] = metric.unit, object_hash([metric.of, metric.given])
        except Exception as error:  # code of the metric may raise anything
            raise ValueError(f"metric {name!r}: {error}") from error
    return found


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


def _functions(of: Any) -> list[Any]:
    """Return the function of a metric and the functions of `desim.analysis.metrics` that it calls, even indirectly."""
    found = [of]
    for each in found:
        called = [each.__globals__.get(name) for name in sorted(globals_read(each.__code__))]
        found += [
            one
            for one in called
            if isinstance(one, FunctionType) and one.__module__ == summary.__module__ and one not in found
        ]
    return found

"""The values of a metric that a mean needs: a finite number in every run."""

from math import isfinite

import numpy as np

from desim.analysis.metrics import words
from desim.config.arrays import Floats
from desim.study.plan.configurations import Configuration
from desim.study.results.result import SweepResult
from desim.study.store.run_table import Row
from desim.study.sweeps.sweep_plan import SweepPlan


class NoMeanError(ValueError):
    """Raised if a metric whose mean is needed has no value, or an infinite one, in a run."""


def metric_value(metric: str, configuration: Configuration, row: Row) -> float:
    """Return the value of a metric in a run, as a finite number.

    Raises:
        NoMeanError: if the run has no value, or an infinite one.
    """
    subject, value = f"{words(metric)}: the run of {configuration} with seed {row.seed}", row.value(metric)
    if value is None:
        hint = "; end_time counts the horizon where there is no capture" if "capture_time" in metric else ""
        raise NoMeanError(f"{subject} has no value, and a mean over all seeds needs one in every run{hint}")
    if not isfinite(value):
        raise NoMeanError(f"{subject} is {float(value)}, and a mean needs finite values")
    return float(value)


def metric_values(plan: SweepPlan, result: SweepResult, metric: str) -> Floats:
    """Return the (configurations, reps) values of a metric in the runs of a plan; a store may have further runs.

    Raises:
        NoMeanError: if a run has no value, or an infinite one.
    """
    values = np.empty((len(plan.configurations), plan.reps))
    for row_of_values, configuration, group in zip(values, plan.configurations, result.groups, strict=True):
        for row in group.rows:
            if row.replication < plan.reps:
                row_of_values[row.replication] = metric_value(metric, configuration, row)
    return values

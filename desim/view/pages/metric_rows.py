"""The metrics of a run or of a comparison over seeds as rows of a table, beside those of the pinned run."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from desim.analysis.measuring import users_metrics
from desim.analysis.metrics import METRICS, Metric, Summary, more_is, unit_of, words
from desim.analysis.statistics import mean, paired
from desim.analysis.tables import with_half_width
from desim.scenario.scenario import Scenario
from desim.view.pages.answers import Answer, json_answer

FIRST = (
    "capture_time",
    "active_time",
    "misassigned_time",
    "handovers",
    "messages_sent",
    "messages_lost",
    "age_mean",
    "belief_error",
)
"""The metrics that are shown first, in their order."""
CONFIDENCE = 1.0 - 0.05 / len(FIRST)
"""The confidence of the test of one of these metrics over several seeds: 95 % for all together (Bonferroni)."""
ROUNDING = 1e-9
"""A value of at most this size counts as a rounding error of 0."""
HALF_A_DIGIT = 0.0005
"""A smaller difference is shown only if the two values differ as texts, too."""


def named_metrics_of(scenario: Scenario) -> Mapping[str, Metric]:
    """Return the metrics that a scenario names, by name."""
    return dict(users_metrics(scenario.record.metrics))


def differences_over_seeds(
    pairs: Sequence[tuple[Summary, Summary]], failures: Sequence[str], count: int, named_metrics: Mapping[str, Metric]
) -> Answer:
    """Return the progress of a comparison of `count` pairs, and the mean difference of each metric with its interval.

    The entry `differs` says whether the mean difference of a metric excludes 0 with `CONFIDENCE`. It is false until all
    pairs are complete: of tests after each pair, one would sooner or later be significant by chance. `failures` are the
    reasons why pairs failed, and `named_metrics` the user's metrics by name.
    """
    rows: list[Answer] = []
    done = len(pairs) + len(failures)
    for name in _ordered(pairs[0][0]) if pairs else []:
        complete = [
            (float(now[name]), float(pinned[name]))
            for now, pinned in pairs
            if now.get(name) is not None and pinned.get(name) is not None
        ]
        if complete:
            values, pinned_values = map(list, zip(*complete, strict=True))
            difference = paired(values, pinned_values)
            rows.append(
                _row(name, pairs[0][0], named_metrics)
                | {
                    "now": _formatted(mean(values).mean),
                    "pinned": _formatted(mean(pinned_values).mean),
                    "difference": with_half_width(difference, difference.count, sign="+"),
                    "differs": done == count and difference.excludes_0(CONFIDENCE),
                    "sign": difference.mean,
                    "count": difference.count,
                }
            )
    return json_answer({"done": done, "of": count, "failed": len(failures), "failure": failures[:1], "metrics": rows})


def compared_metrics(now: Summary, pinned: Summary | None, named_metrics: Mapping[str, Metric]) -> Iterator[Answer]:
    """Yield the value of each numeric metric of a run, and its difference from that of the pinned run."""
    for name in _ordered(now):
        value, other = now[name], None if pinned is None else pinned.get(name)
        if value is None and other is None:
            continue
        row = _row(name, now, named_metrics) | {"value": _formatted(value)}
        if value is not None and other is not None and value != other:  # inf - inf is nan
            difference = float(value) - float(other)
            if abs(difference) >= HALF_A_DIGIT or _formatted(value) != _formatted(other):
                row |= {"difference": _formatted(difference, "+"), "sign": difference}
        yield row


def _row(name: str, metrics: Summary, named_metrics: Mapping[str, Metric]) -> Answer:
    """Return the name of a metric, its unit and whether more of it is better or worse."""
    row = {"name": words(name), "unit": unit_of(name, metrics.units), "more_is": more_is(name, named_metrics)}
    return row | {"first": name in FIRST}


def _ordered(metrics: Summary) -> list[str]:
    """Return the names of the metrics that are numbers, beginning with `FIRST`."""
    names = [name for name in metrics if name not in METRICS or METRICS[name].is_number]
    return [*FIRST, *(name for name in names if name not in FIRST)]


def _formatted(value: Any, sign: str = "") -> str:
    """Return a value of a metric as text."""
    if value is None or value != value:
        return "\N{EN DASH}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if float(value).is_integer() and abs(value) < 1e15:
        return f"{int(value):{sign},}"
    if ROUNDING < abs(value) < 0.001:  # 0.000 would be wrong, for example for the delay of a message on a fast link
        return f"{value:{sign}.2g}"
    return f"{value:{sign},.{3 if abs(value) < 100.0 else 1}f}"

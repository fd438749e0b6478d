"""The cost of each imperfection of a scenario, such as latency or loss.

The scenario is run as it is, without each imperfection in turn, and without all of them, on the same seeds. The cost of
an imperfection is the paired difference between the scenario as it is and the scenario without it. If the costs do not
add up to the difference that all imperfections make together, the imperfections interact. For example, if either of two
imperfections is enough to delay a capture, removing one alone saves nothing.

Two more variants bound the effect of the network: a perfect network, and no messages at all; nothing else changes. If
the two are equal in every run, the network does not matter in this scenario.

An interaction is declared only if its 99 % interval, corrected for the number of metrics, excludes 0
(`INTERACTION_RISK` in `desim.study.results.costs`).
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Self

from desim.analysis.measuring import Metrics, UsersMetrics, check_numeric, users_metrics
from desim.analysis.metrics import more_is, unit_of, words
from desim.analysis.statistics import mean_or_share
from desim.config.arguments import naming_arguments, scenario_argument
from desim.config.python_numbers import whole
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.seeds import seed_of
from desim.scenario.scenario import Scenario, without_metrics
from desim.study.ablation.imperfections import IMPERFECTIONS, with_perfect_network, without_messages
from desim.study.plan.configurations import Configuration, distinct
from desim.study.results.costs import AS_IT_IS, IDEAL, INTERACTION_RISK, PERFECT, SILENT, Bounds, Cost, Saving
from desim.study.results.explanation import EXPLAINED, Explanation
from desim.study.store.run_table import Row
from desim.study.store.store import Store
from desim.study.sweeps.sweep import RunError, carry_out
from desim.study.sweeps.sweep_plan import SweepPlan
from desim.study.workers.batch_system import JobExecutor
from desim.study.workers.executors import workers_for
from desim.study.workers.workers import Workers

RUNS = 100
"""The default number of runs of each variant. If the variants differ for a few seeds only, more runs are needed; see
`desim.analysis.statistics.paired`."""


@naming_arguments
def explain(
    scenario: Scenario,
    runs: int = RUNS,
    executor: Executor | JobExecutor | Workers | int | str = 1,
    *,
    seed: int | None = None,
    store: str | Path | None = None,
    metrics: Metrics | None = None,
    shown: Sequence[str] = tuple(EXPLAINED),
    timeout: float | None = None,
    mix_versions: bool = False,
) -> Explanation:
    """Measure the cost of each imperfection of a scenario, in each of the metrics `shown`.

    Use it to learn which imperfection (latency, loss, range, faults, ...) degrades a protocol before you vary this
    imperfection in a sweep. `runs` is the number of runs of each variant, and `shown` names the metrics to compare; the
    other arguments are as in `sweep`.

    Raises:
        TypeError: if `scenario` is no scenario; the message says what to write instead.
        ValueError: if there are fewer than 2 runs, the seed or the number of workers is negative, no metric is shown,
            `timeout` is out of its range, or a metric has a wrong name, does not exist or is not numeric.
        ScenarioError: if an object of the scenario has no stable hash.
        StoreError: if the store cannot be written, belongs to other runs, or has runs of other versions.
        ConnectionError: if a scheduler does not answer.
        RunError: if no seed completes in all variants.
    """
    scenario_argument(Scenario).check(scenario, "explain")
    shown = [shown] if isinstance(shown, str) else list(shown)
    variants = Variants.of(scenario, runs, seed, metrics)
    variants.check_shown(shown)
    with workers_for(executor, variants.plan.runs, timeout) as workers, Store(store) as variants_store:
        variants.plan.register(variants_store, mix_versions=mix_versions)
        return variants.carry_out(variants_store, workers, shown)


@dataclass(frozen=True)
class Variants:
    """The variants of a scenario (as it is, without each imperfection, without all, the bounds) and their plan."""

    plan: SweepPlan
    configurations: Mapping[str, Configuration]
    """The configuration of each variant by name; for an imperfection that the scenario lacks, the scenario as it is."""

    @classmethod
    def of(cls, scenario: Scenario, runs: int = RUNS, seed: int | None = None, metrics: Metrics | None = None) -> Self:
        """Return the variants of a scenario.

        Raises:
            ValueError: if there are fewer than 2 runs, the seed is negative, or a metric has a wrong name.
            ScenarioError: if an object of the scenario has no stable hash.
        """
        if (runs := whole(runs, "runs")) < 2:
            raise ValueError(f"an interval needs at least 2 runs, got {runs}")
        user_metrics = users_metrics(scenario.record.metrics, {} if metrics is None else metrics)
        scenario = without_metrics(scenario)
        ideal = reduce(lambda partly_ideal, remove: remove(partly_ideal), IMPERFECTIONS.values(), scenario)
        removed = {name: remove(scenario) for name, remove in IMPERFECTIONS.items()}
        bounds = {PERFECT: with_perfect_network(scenario), SILENT: without_messages(scenario)}
        by_name = {AS_IT_IS: scenario, **removed, IDEAL: ideal, **bounds}
        variants = {name: Configuration({"without": name}, variant) for name, variant in by_name.items()}
        root = scenario.seed if seed is None else seed_of(seed)
        return cls(SweepPlan(scenario, distinct(variants.values()), runs, root, metrics=user_metrics), variants)

    def check_shown(self, shown: Sequence[str]) -> None:
        """Raise ValueError if there is no metric to be shown, or one does not exist or is not numeric."""
        if not shown:
            raise ValueError("at least one metric should be shown, got none")
        for metric in shown:
            check_numeric(metric, dict(self.plan.metrics))

    def carry_out(self, store: Store, workers: Workers, shown: Sequence[str] = tuple(EXPLAINED)) -> Explanation:
        """Perform the runs that a store lacks, and compare the variants in each of the metrics `shown`.

        Raises:
            RunError: if no seed completes in all variants.
            ValueError: if no metric is shown, or a metric does not exist or is not numeric.
        """
        self.check_shown(shown)
        plan = self.plan
        groups = carry_out(plan, store, workers, metrics=shown).groups
        by_key = {
            configuration.key: {row.replication: row for row in group.rows}
            for configuration, group in zip(plan.configurations, groups, strict=True)
        }
        rows = {name: by_key[configuration.key] for name, configuration in self.configurations.items()}
        complete = [k for k in range(plan.reps) if all(by_replication[k].ok for by_replication in rows.values())]
        if not complete:
            failed = next(row for by_replication in rows.values() for row in by_replication.values() if not row.ok)
            raise RunError(
                f"no seed completed in all variants; first failure, with seed {failed.seed}: {failed.failure}"
            )
        absent = tuple(
            name for name in IMPERFECTIONS if self.configurations[name].key == self.configurations[AS_IT_IS].key
        )
        confidence = 1.0 - INTERACTION_RISK / len(shown)
        costs = {metric: _cost(metric, plan.metrics, rows, complete, absent, confidence) for metric in shown}
        return Explanation(plan.base.name, len(complete), plan.reps - len(complete), absent, costs)


def _cost(
    metric: str,
    user_metrics: UsersMetrics,
    rows: Mapping[str, Mapping[int, Row]],
    complete: list[int],
    absent: tuple[str, ...],
    confidence: float,
) -> Cost:
    """Return the cost of each imperfection in a metric, over the seeds with a value in all variants except the bounds.

    The bounds of the network are over the seeds for which both bounds have a value: without messages there may be no
    capture, and so no capture time. `confidence` is the level of the interval that decides whether the imperfections
    interact.
    """

    def measured(*names: str) -> dict[str, list[float]]:
        """Return a metric of some variants, over the seeds for which all of these have a value."""
        chosen = [rows[name] for name in names]
        shared = [k for k in complete if all(by_replication[k].value(metric) is not None for by_replication in chosen)]
        return {name: [rows[name][k].value(metric) for k in shared] for name in names}

    bounds = Bounds.of(*measured(PERFECT, SILENT).values())
    values = measured(*(name for name in rows if name not in (PERFECT, SILENT)))
    as_it_is = values.pop(AS_IT_IS)
    saved = {
        name: [float(with_it) - float(without) for with_it, without in zip(as_it_is, numbers, strict=True)]
        for name, numbers in values.items()
    }
    parts = {name: saved[name] for name in IMPERFECTIONS if name not in absent}
    interaction = [total - portable_sum(part[k] for part in parts.values()) for k, total in enumerate(saved[IDEAL])]
    return Cost(
        EXPLAINED.get(metric) or words(metric),
        unit_of(metric, {name: metric.unit for name, metric in user_metrics}),
        mean_or_share(as_it_is),
        mean_or_share(values[IDEAL]),
        {name: Saving.of(saving) for name, saving in parts.items()},
        Saving.of(saved[IDEAL]),
        Saving.of(interaction),
        more_is(metric, dict(user_metrics)),
        confidence,
        bounds,
    )

"""A race: runs of several configurations, one after the other, until the best is known with a given confidence.

Run k of all configurations has the same seed, so that effects of chance that they share cancel. The runs that
decide are the same with any number of workers: several workers perform the next runs ahead, and runs that turn out not
to be needed only remain in the store.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from desim.analysis.measuring import Metrics, check_numeric
from desim.analysis.metrics import more_is, unit_of, words
from desim.config.arguments import naming_arguments, value_text
from desim.config.errors import ArgumentError
from desim.scenario.overrides import Source
from desim.scenario.scenario import Scenario
from desim.scenario.sweep_table import Design
from desim.study.plan.configurations import SweepGrid, as_source
from desim.study.selection.kim_nelson import check_confidence, check_first, check_zone, kim_nelson
from desim.study.selection.race_result import RaceResult
from desim.study.store.store import Store
from desim.study.sweeps.metric_values import metric_value
from desim.study.sweeps.sweep import check_ok, job_batches
from desim.study.sweeps.sweep_plan import MAX_RUNS, SweepPlan
from desim.study.workers.executors import workers_for
from desim.study.workers.progress import advance, progress
from desim.study.workers.workers import Workers

if TYPE_CHECKING:
    from tqdm import tqdm

FIRST = 20
"""The default number of first runs of each configuration."""
AHEAD = 2
"""The number of runs per worker that are dispatched at a time, if there are several workers."""


@naming_arguments
def race(
    scenario: Scenario | Source,
    grid: SweepGrid | None = None,
    metric: str = "active_time",
    *,
    zone: float,
    confidence: float = 0.95,
    maximise: bool | None = None,
    first: int = FIRST,
    most: int = MAX_RUNS,
    executor: Executor | int | str = 1,
    seed: int | None = None,
    design: Design | str | None = None,
    store: str | Path | None = None,
    metrics: Metrics | None = None,
    timeout: float | None = None,
    mix_versions: bool = False,
) -> RaceResult:
    """Find the configuration of a grid with the best mean of a metric, with as few runs as that takes.

    Use it instead of a sweep if only the best configuration is of interest. Configurations that have lost take no
    further runs; the procedure is that of Kim & Nelson 2001 (`desim.study.selection.kim_nelson`).

        print(race(load("relay.toml"), {"protocol": ["sap", "cbba", "local_min"]}, zone=0.2))

    Args:
        scenario: the scenario that is varied.
        grid: as in `sweep`; None = the grid of `scenario.sweep`.
        metric: the name of the metric; every run needs a value.
        zone: the indifference zone: the smallest difference of means that matters, in the unit of the metric. The
            number of runs grows with 1 / zone^2, or with 1 / zone where means differ by much more; if in doubt, take a
            tenth of the mean.
        confidence: the probability with which the best is found if it is better than every other by `zone`; in (1/k, 1)
            for k configurations.
        maximise: whether the greatest mean is the best; None = as the metric says (`desim metrics`).
        first: the number of first runs of each configuration, at least 2, from which variances are estimated; if in
            doubt, 20.
        most: the largest number of runs of a configuration; a race that reaches it is not decided, as the result says.
        executor: as in `sweep`; the result does not depend on it.
        seed: the root seed; None = that of the scenario.
        design: as in `sweep`.
        store: the file in which runs are kept, that of a sweep for instance; finished runs in it are not repeated.
        metrics: metrics in addition to the built-in ones, by name.
        timeout: the wall time, s, after which a run counts as failed.
        mix_versions: as in `sweep`.

    Raises:
        TypeError: if `scenario` is no scenario.
        ScenarioError: if the scenario or the grid is invalid.
        ValueError: if there is only one configuration, a number is out of its range, the metric does not exist, is not
            numeric, has no or an infinite value in a run, or does not say whether more of it is better.
        StoreError: if the store cannot be used; see `sweep`.
        RunError: if a run fails.
    """
    plan = SweepPlan.of(as_source(scenario, "race"), grid, most, seed, metrics, design)
    rules = RaceRules.of(plan, metric, zone, confidence, maximise, first)
    with workers_for(executor, timeout=timeout) as workers, Store(store) as race_store:
        plan.register(race_store, mix_versions=mix_versions)
        return carry_out_race(plan, race_store, workers, rules)


@dataclass(frozen=True)
class RaceRules:
    """The question of a race, and when it is decided; see `race`."""

    metric: str
    maximise: bool
    """Whether the greatest mean is the best."""
    zone: float
    confidence: float
    first: int

    @classmethod
    def of(
        cls, plan: SweepPlan, metric: str, zone: float, confidence: float, maximise: bool | None, first: int = FIRST
    ) -> Self:
        """Return the rules of a race between the configurations of a plan, at most `plan.reps` runs of each.

        Raises:
            ValueError: if there is only one configuration, or an argument is invalid; see `race`.
        """
        if len(plan.configurations) < 2:
            raise ValueError(
                f"a race needs at least two configurations, and the grid has one, {plan.configurations[0]}: give a key"
                " several values"
            )
        user_metrics = dict(plan.metrics)
        check_numeric(metric, user_metrics)
        zone = check_zone(zone, unit_of(metric, {name: added.unit for name, added in plan.metrics}))
        confidence = check_confidence(confidence, len(plan.configurations))
        first = check_first(first, plan.reps)
        if maximise is None:
            better = more_is(metric, user_metrics)
            if better is None:
                raise ValueError(f"{words(metric)}: whether more of it is better is not known: give `maximise`")
            maximise = better == "better"
        elif not isinstance(maximise, bool):
            raise ArgumentError("maximise", f"should be True, False or None (got {value_text(maximise)})")
        return cls(metric, maximise, zone, confidence, first)


def carry_out_race(plan: SweepPlan, store: Store, workers: Workers, rules: RaceRules) -> RaceResult:
    """Run a race of the configurations of a plan, at most `plan.reps` runs of each; see `race`.

    Raises:
        NoMeanError: if the metric has no or an infinite value in a run.
        RunError: if a run fails.
    """
    with progress(None, plan.base.name, "run") as bar:
        samples = _Samples(plan, store, workers, rules, bar)
        selection = kim_nelson(
            samples,
            len(plan.configurations),
            zone=rules.zone,
            confidence=rules.confidence,
            first=rules.first,
            maximise=rules.maximise,
            most=plan.reps,
        )
    return RaceResult(
        plan.base.name,
        rules.metric,
        unit_of(rules.metric, {name: added.unit for name, added in plan.metrics}),
        rules.maximise,
        rules.zone,
        rules.confidence,
        rules.first,
        tuple(configuration.columns for configuration in plan.configurations),
        selection,
        plan.common,
        samples.are_truths,
    )


class _Samples:
    """The values of a metric by configuration and replication; runs that the store lacks are performed."""

    def __init__(self, plan: SweepPlan, store: Store, workers: Workers, rules: RaceRules, bar: "tqdm[Any]"):
        self._plan, self._store, self._workers = plan, store, workers
        self._metric, self._first, self._bar = rules.metric, rules.first, bar
        self._positions = {configuration.key: k for k, configuration in enumerate(plan.configurations)}
        self._rows = {(k, row.replication): row for k, row in plan.rows_done(store, {rules.metric})}

    def __call__(self, systems: Sequence[int], replication: int) -> list[float]:
        if any((system, replication) not in self._rows for system in systems):
            self._perform(systems, replication)
        rows = ((self._plan.configurations[system], self._rows[system, replication]) for system in systems)
        return [metric_value(self._metric, configuration, row) for configuration, row in rows]

    @property
    def are_truths(self) -> bool:
        """Whether all values are true or false."""
        return all(isinstance(row.value(self._metric), bool) for row in self._rows.values())

    def _perform(self, systems: Sequence[int], replication: int) -> None:
        """Perform the runs of a replication, and of some that follow.

        If it is one of the first replications, all of these are performed; otherwise, as many as keep the workers busy.
        """
        workers = self._workers.count
        ahead = max(1, AHEAD * workers // len(systems)) if workers > 1 else 1
        end = self._first if replication < self._first else replication + ahead
        jobs = [
            (self._plan.configurations[system], k)
            for k in range(replication, min(end, self._plan.reps))
            for system in systems
            if (system, k) not in self._rows
        ]
        self._bar.set_postfix_str(f"{len(systems)} of {len(self._positions)} left", refresh=False)
        with closing(job_batches(jobs, self._plan, self._store, self._workers)) as batches:
            for batch in batches:
                advance(self._bar, len(batch))
                for configuration, row in batch:
                    check_ok(configuration, row)
                    self._rows[self._positions[configuration.key], row.replication] = row

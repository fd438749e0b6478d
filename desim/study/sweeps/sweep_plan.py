"""The plan of a sweep: its configurations, the seeds of their runs, and whether a store may take them."""

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Self

from desim.analysis.measuring import Metrics, UsersMetrics, users_metrics
from desim.config.python_numbers import whole
from desim.kernel.core.seeds import run_seed, seed_of
from desim.results import environment
from desim.scenario.checks import sweep_warnings
from desim.scenario.overrides import Source
from desim.scenario.scenario import Scenario, without_metrics
from desim.scenario.sweep_table import Design
from desim.scenario.toml import validate
from desim.study.plan.config_hash import tables
from desim.study.plan.configurations import Configuration, SweepGrid, as_source, configurations
from desim.study.plan.metric_code import units_and_codes
from desim.study.results.runs import Group, SweepRuns
from desim.study.store.properties import flat
from desim.study.store.run_table import Row
from desim.study.store.store import Store

Job = tuple[Configuration, int]
"""A configuration and the number (replication) of one of its runs, from 0 on."""
MAX_RUNS = 10_000
"""The maximum number of runs of a configuration if `until` is given without `reps`."""
THIS = "this is"
"""The subject of the error message about other versions, for runs of this process; see `Store.check_versions`."""


@dataclass(frozen=True)
class SweepPlan:
    """The plan of a sweep: its configurations, and the seeds of their runs."""

    base: Scenario
    """The scenario that is varied."""
    configurations: tuple[Configuration, ...]
    reps: int
    """The number of runs of each configuration."""
    root: int
    """The root seed. With common seeds, the seed of run k is 1,000,000 root + k; otherwise the seed of each run is a
    hash of the root seed, the configuration and the number of the run."""
    common: bool = True
    """Whether run k of every configuration has the same seed."""
    metrics: UsersMetrics = ()
    """The metrics of each run in addition to the built-in ones."""

    @classmethod
    def of(
        cls,
        scenario: Scenario | Source,
        grid: SweepGrid | None = None,
        reps: int | None = None,
        seed: int | None = None,
        metrics: Metrics | None = None,
        design: Design | str | None = None,
    ) -> Self:
        """Return the plan given by a scenario's table `sweep` and key `seed`; arguments other than None replace these.

        `metrics` are measured in addition to those that the scenario names (`record.metrics`).

        Raises:
            TypeError: if `scenario` is no scenario, or the grid no mapping; the message says what to write instead.
            ScenarioError: if the scenario or the grid is invalid; the message lists the errors.
            ValueError: if there are no runs, the seed is negative, or a metric has a wrong name or is not a function.
        """
        source = as_source(scenario, "sweep")
        base = validate(source)
        reps = whole(base.sweep.reps if reps is None else reps, "reps")
        root = base.seed if seed is None else seed_of(seed)
        user_metrics = users_metrics(base.record.metrics, {} if metrics is None else metrics)
        all_configurations = tuple(configurations(source, grid, design))
        return cls(without_metrics(base), all_configurations, reps, root, base.sweep.seeds == "common", user_metrics)

    def __post_init__(self) -> None:
        if self.reps < 1:
            raise ValueError(f"there should be at least one run of each configuration, got {self.reps}")
        run_seed(self.root, self.reps - 1)  # refuses more runs than a root seed has seeds

    @property
    def about(self) -> dict[str, Any]:
        """The properties that identify the sweep; a store belongs to one sweep."""
        keys = sorted(self.configurations[0].settings)
        swept_prefixes = tuple(f"{key}." for key in keys)
        sources = {
            name: source
            for configuration in self.configurations
            for name, source in configuration.identity.sources.items()
        }
        return {
            "name": self.base.name,
            "grid": keys,
            "seeds": "common" if self.common else "independent",
            "root seed": self.root,
            "scenario": {
                key: value for key, value in flat(tables(self.base)).items() if not f"{key}.".startswith(swept_prefixes)
            },
            "the code of desim": environment.code(),
            **sources,
        }

    def warnings(self) -> Iterator[tuple[str, str]]:
        """Yield the key and the text of each warning about the grid that needs no results of runs.

        The warnings concern latencies that are probably given in ms, and keys that probably have no effect. For the
        warnings that need results see `SweepResult.warnings`.
        """
        scenarios = [configuration.scenario for configuration in self.configurations]
        yield from sweep_warnings(self.base, tuple(self.configurations[0].settings), scenarios)

    def check_reference(self, against: Mapping[str, Any] | None) -> None:
        """Raise ValueError if a configuration has no reference with some values; see `SweepResult.differences`."""
        if against is None:
            return
        if not self.common:
            raise ValueError("runs with independent seeds cannot be paired")
        groups = tuple(Group(configuration.columns, ()) for configuration in self.configurations)
        SweepRuns(self.base.name, tuple(self.configurations[0].settings), groups, self.common, {}).references(against)

    @property
    def runs(self) -> int:
        """The number of runs, or the largest number with `until`."""
        return len(self.configurations) * self.reps

    def seed(self, configuration: Configuration, replication: int) -> int:
        """Return the seed of a run, see `run_seed`; a hash if the configurations do not share seeds."""
        if self.common:
            return run_seed(self.root, replication)
        text = f"{self.root}/{configuration.key}/{replication}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:7], "big")

    def check(self, store: Store, *, mix_versions: bool) -> None:
        """Raise StoreError if a store belongs to another sweep, or has runs of other versions that may not be mixed."""
        store.check_same(self._properties_as_json())
        store.check_versions([environment.computing_versions()], THIS, mix=mix_versions)

    def register(self, store: Store, *, mix_versions: bool = False) -> None:
        """Record the properties, the versions, the configurations and the metrics of the sweep in a store.

        Raises:
            StoreError: if the store belongs to another sweep, or cannot be written; or if another Python or other
                packages computed its runs, unless `mix_versions` is set.
            ValueError: if a metric holds an object without a stable hash.
        """
        self.check(store, mix_versions=mix_versions)  # before anything is recorded
        store.record_properties(self._properties_as_json())
        store.record_versions([environment.computing_versions()], THIS, mix=mix_versions)
        store.register(self.configurations)
        store.register_metrics(units_and_codes(self.metrics))

    def done(self, store: Store, metrics: Collection[str] = ()) -> set[tuple[str, int]]:
        """Return the runs that are done, as pairs (hash of the configuration, replication); see `rows_done`."""
        return {(self.configurations[k].key, row.replication) for k, row in self.rows_done(store, metrics)}

    def rows_done(self, store: Store, metrics: Collection[str] = ()) -> Iterator[tuple[int, Row]]:
        """Yield the position of the configuration of each run that is done, and the run.

        A run is done if it is in the store, did not fail, and has the given metrics and those of the plan.
        """
        needed = {*metrics, *dict(self.metrics)}
        for k, configuration in enumerate(self.configurations):
            for row in store.runs(configuration.key, self.root):
                if row.summary is not None and needed <= row.summary.keys():
                    yield k, row

    def _properties_as_json(self) -> dict[str, str]:
        return {name: json.dumps(property_) for name, property_ in self.about.items()}

    def shard(self, part: int, parts: int) -> list[Job]:
        """Return the runs of shard `part` of `parts`, counted from 1; each run of the sweep is in exactly one shard.

        If there are several shards, they do not depend on the order of the grid. Together they form the whole sweep
        even if the commands that run them order the grid differently.

        Raises:
            ValueError: if `part` is not in 1 .. `parts`.
        """
        if not 1 <= part <= parts:
            raise ValueError(f"a shard should be 1/{parts} to {parts}/{parts}, got {part}/{parts}")
        ordered = list(self.configurations)
        if parts > 1:
            ordered.sort(key=lambda configuration: configuration.key)
        jobs = [(configuration, k) for configuration in ordered for k in range(self.reps)]
        return jobs[part - 1 :: parts]

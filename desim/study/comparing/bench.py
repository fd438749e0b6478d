"""The benchmark: every protocol in every scenario, on its network and on a perfect one, scored between two bounds."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from desim.config.arguments import naming_arguments
from desim.config.arrays import Floats
from desim.config.errors import ArgumentError
from desim.config.python_numbers import whole
from desim.config.traits import kind_of
from desim.scenario.overrides import ScenarioError
from desim.scenario.scenario import Scenario
from desim.study.ablation.imperfections import with_perfect_network, without_messages
from desim.study.comparing.scores import Benchmark, NoPart
from desim.study.comparing.suite import (
    AS_IT_IS,
    NEWEST,
    PERFECT,
    REFERENCE,
    SILENT,
    CostsByProtocol,
    Suite,
    cost_of_runs,
)
from desim.study.plan.configurations import Configuration, distinct
from desim.study.store.store import Store
from desim.study.sweeps.sweep import carry_out, check_ok
from desim.study.sweeps.sweep_plan import SweepPlan
from desim.study.workers.executors import workers_for
from desim.study.workers.workers import Workers

METRICS = ("active_time", "idle_time")
"""The metrics that make up a cost."""


@naming_arguments
def bench(
    protocols: Any = (),
    runs: int | None = None,
    executor: Executor | int | str = 1,
    *,
    version: str | int = NEWEST,
    again: bool = False,
    folder: str | Path | None = None,
    timeout: float | None = None,
    mix_versions: bool = False,
) -> Benchmark:
    """Compare protocols with all built-in ones in the scenarios of the benchmark.

    Use it to place a protocol of yours beside those of the literature: the built-in protocols do not run again, their
    costs are part of the version. `bench()` returns the table of the version.

        print(desim.bench(MyRule()).table())
        print(desim.bench({"mine": MyRule(), "mine, patient": MyRule(patience=1.0)}).table())

    Args:
        protocols: a protocol, a list of protocols, or protocols by the name in the table.
        runs: the number of runs of each protocol in each scenario, at least 2; None = that of the version, which is the
            largest number. Fewer are for a first look.
        executor: as in `sweep`.
        version: the version of the benchmark.
        again: whether the built-in protocols run, too, instead of their costs being read.
        folder: the folder of a store for each scenario, from which an interrupted benchmark resumes; None = no store.
        timeout: the wall time, s, after which a run counts as failed; None = no limit.
        mix_versions: as in `sweep`.

    Raises:
        ValueError: if there is no such version, too few or too many runs, or a protocol takes part in no scenario.
        RunError: if a run of a protocol fails.
        StoreError: if a store cannot be written, or has runs of other code or versions.
    """
    suite = Suite.of(version)
    count = suite.runs if runs is None else whole(runs, "runs")
    if not 2 <= count <= suite.runs:
        raise ArgumentError("runs", f"should be 2 to {suite.runs}, those of version {version} (got {count})")
    entrants = Entrants(suite, _by_name(protocols, suite), again=again)
    with workers_for(executor, entrants.runs(count), timeout) as workers:
        return entrants.carry_out(
            count, workers, folder=None if folder is None else Path(folder), mix_versions=mix_versions
        )


def _by_name(protocols: Any, suite: Suite) -> dict[str, Any]:
    """Return protocols by their names in the table; a name that a built-in protocol has gets a suffix."""
    if isinstance(protocols, Mapping) and "kind" not in protocols:
        pairs = [(str(name), protocol) for name, protocol in protocols.items()]
    else:
        listed = protocols if isinstance(protocols, list | tuple) else [protocols]
        pairs = [(_name(protocol), protocol) for protocol in listed]
    by_name: dict[str, Any] = {}
    for name, protocol in pairs:
        unique_name, number = name, 1
        while unique_name in suite.protocols or unique_name in by_name:
            number += 1
            unique_name = f"{name} ({number})"
        by_name[unique_name] = protocol
    return by_name


def _name(protocol: Any) -> str:
    if isinstance(protocol, str):
        return protocol
    if isinstance(protocol, Mapping):
        return str(protocol.get("kind", "a table"))
    return protocol.__name__ if isinstance(protocol, type) else kind_of(protocol)


@dataclass(frozen=True)
class Entrants:
    """The protocols that run, beside those whose costs are frozen."""

    suite: Suite
    protocols: Mapping[str, Any]
    """The protocols of the caller by name."""
    again: bool = False
    """Whether the built-in protocols run, too."""

    def runs(self, count: int) -> int:
        """Return an upper bound of the number of runs, with `count` runs of each protocol in each scenario."""
        built_in = len(self.suite.protocols) + 1  # the reference also runs without messages
        entrants = len(self.protocols) + built_in * self.again
        return max(2 * count * entrants * len(self.suite.scenarios), 1)  # each on its network and on a perfect one

    def variants(self, name: str) -> tuple[list[Configuration], list[NoPart]]:
        """Return the configurations of a scenario that run, and the protocols that cannot take part, with reasons."""
        scenario = self.suite.scenarios[name]
        entrants = {**(self.suite.protocols if self.again else {}), **self.protocols}
        variants: list[Configuration] = []
        absent: list[NoPart] = []
        for protocol, value in entrants.items():
            try:
                with_protocol = scenario.with_({"protocol": value})
            except ScenarioError as error:
                reason = "; ".join(str(problem._replace(where="")) for problem in error.problems)
                absent.append(NoPart(protocol, name, reason))
                continue
            variants.append(_variant(name, protocol, AS_IT_IS, with_protocol))
            variants.append(_variant(name, protocol, PERFECT, with_perfect_network(with_protocol)))
        if self.again:
            variants.append(_variant(name, REFERENCE, SILENT, without_messages(scenario)))
        return variants, absent

    def carry_out(
        self,
        count: int,
        workers: Workers,
        *,
        folder: Path | None = None,
        mix_versions: bool = False,
    ) -> Benchmark:
        """Perform the runs that the stores lack, and score all protocols.

        Raises:
            RunError: if a run fails.
            ValueError: if a protocol takes part in no scenario.
        """
        costs: dict[str, dict[str, dict[str, Any]]] = {}
        absences: list[NoPart] = []
        for name in self.suite.scenarios:
            variants, absent = self.variants(name)
            absences += absent
            costs[name] = {} if self.again else _first_runs(self.suite.costs[name], count)
            if not variants:
                continue
            scenario = self.suite.scenarios[name]
            plan = SweepPlan(scenario, distinct(variants), count, scenario.seed)
            with Store(None if folder is None else folder / f"{name}.sqlite") as store:
                plan.register(store, mix_versions=mix_versions)
                new_costs = _costs_of_runs(plan, store, workers)
            for variant in variants:
                by_network = costs[name].setdefault(variant.settings["protocol"], {})
                by_network[variant.settings["network"]] = new_costs[variant.key]
        for protocol in self.protocols:
            reasons = [absence.why for absence in absences if absence.protocol == protocol]
            if len(reasons) == len(self.suite.scenarios):
                raise ValueError(f"{protocol} takes part in no scenario: {reasons[0]}")
        has_more = self.suite.is_frozen and count < self.suite.runs
        frozen = self.suite.costs if has_more else {}
        return Benchmark(self.suite.version, costs, tuple(self.protocols), tuple(absences), frozen)


def _variant(name: str, protocol: str, network: str, scenario: Scenario) -> Configuration:
    return Configuration({"scenario": name, "protocol": protocol, "network": network}, scenario)


def _first_runs(costs: CostsByProtocol, count: int) -> dict[str, dict[str, Any]]:
    """Return the costs of the first runs."""
    return {
        protocol: {network: values[:count] for network, values in by_network.items()}
        for protocol, by_network in costs.items()
    }


def _costs_of_runs(plan: SweepPlan, store: Store, workers: Workers) -> dict[str, Floats]:
    """Perform the runs that a store lacks; return the (n,) costs of each configuration by its hash."""
    costs: dict[str, Floats] = {}
    result = carry_out(plan, store, workers, metrics=METRICS)
    for configuration, group in zip(plan.configurations, result.groups, strict=True):
        for row in group.failed[:1]:
            check_ok(configuration, row)
        active, idle = (group.numbers(metric)[: plan.reps] for metric in METRICS)
        costs[configuration.key] = cost_of_runs(configuration.scenario, active, idle)
    return costs


def frozen_matches(suite: Suite, scenarios: Sequence[str] | None = None) -> bool:
    """Return whether the first run of the reference in each scenario still has its frozen cost."""
    from desim.analysis.measuring import summary
    from desim.simulation.run import run
    from desim.study.workers.batch import seeds_from

    for name in suite.scenarios if scenarios is None else scenarios:
        scenario = suite.scenarios[name]
        metrics = summary(run(scenario, seeds_from(scenario.seed, 1)[0]))
        cost = cost_of_runs(scenario, np.array([metrics.active_time]), np.array([metrics.idle_time]))
        if cost[0] != suite.costs[name][REFERENCE][AS_IT_IS][0]:
            return False
    return True

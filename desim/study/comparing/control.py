"""Sweeps with a control variate: another protocol in the same runs, whose mean is known from many cheap runs.

`desim.analysis.control_variates` has the estimate. A control that knows everything and sends nothing is run on a
perfect network, which changes nothing in its runs. Configurations that differ only in the network share these runs.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from math import isinf
from pathlib import Path
from typing import Any

import numpy as np

from desim.analysis.control_variates import FEW_CONTROLS, MIN_PAIRS, ControlledEstimate, control_variate
from desim.analysis.measuring import Metrics, check_numeric
from desim.analysis.metrics import title, words
from desim.analysis.table_formats import Table, TabularResult
from desim.analysis.tables import as_json, digits_of, percent, with_half_width
from desim.config.arguments import naming_arguments
from desim.config.number_texts import counted
from desim.config.python_numbers import whole
from desim.scenario.overrides import Source
from desim.scenario.scenario import Scenario
from desim.study.ablation.imperfections import with_perfect_network
from desim.study.plan.configurations import Configuration, SweepGrid, as_source
from desim.study.results.result import SweepResult
from desim.study.results.runs import Group, names_of_metrics, text
from desim.study.store.store import Store
from desim.study.sweeps.sweep import carry_out
from desim.study.sweeps.sweep_plan import SweepPlan
from desim.study.workers.executors import workers_for
from desim.study.workers.workers import Workers

CONTROL = "centralised"
"""The default control: it knows everything, needs no messages, and is cheap."""
TIMES = 10
"""The default number of runs of a control, as a multiple of those of a configuration."""
SHOWN = ("active_time", "end_time")
"""The metrics that are corrected by default: every run has them, under every protocol."""


@dataclass(frozen=True)
class ControlPlan:
    """The runs of a control for the configurations of a sweep."""

    plan: SweepPlan
    """The plan of the control: one configuration for all configurations of the sweep with the same control."""
    keys: tuple[str | None, ...]
    """The hash of the control of each configuration of the sweep; None: the configuration is the control itself."""
    name: str

    @classmethod
    def of(cls, swept: SweepPlan, protocol: Any = CONTROL, runs: int | None = None) -> "ControlPlan":
        """Return the plan of a control for the configurations of a sweep.

        The control is a kind, a table, or an object. If `runs` is None, it has `TIMES` times as many runs
        as a configuration.

        Raises:
            ValueError: if seeds are independent, there are too few runs, or all configurations are the control itself.
            ScenarioError: if a configuration cannot run with this protocol.
        """
        if not swept.common:
            raise ValueError("a control needs the seeds of the runs that it controls: sweep.seeds should be common")
        if swept.reps < MIN_PAIRS:
            raise ValueError(f"a control needs at least {MIN_PAIRS} runs of each configuration, got {swept.reps}")
        count = TIMES * swept.reps if runs is None else whole(runs, "the runs of the control")
        if count < (least := swept.reps + FEW_CONTROLS):
            raise ValueError(
                f"a control needs runs beside those that it is paired with, so at least {least}, got {count}"
            )
        controls: dict[str, Configuration] = {}
        keys: list[str | None] = []
        for configuration in swept.configurations:
            control = _controlled_by(configuration.scenario, protocol)
            if control.protocol == configuration.scenario.protocol:
                keys.append(None)
                continue
            of_control = Configuration(configuration.settings, control)
            keys.append(controls.setdefault(of_control.key, of_control).key)
        name = _controlled_by(swept.base, protocol).protocol_name
        if not controls:
            raise ValueError(f"{name} is the protocol of all configurations: a control should be another one")
        base = swept.base.model_copy(update={"protocol": next(iter(controls.values())).scenario.protocol})
        plan = SweepPlan(base, tuple(controls.values()), count, swept.root, swept.common, swept.metrics)
        return cls(plan, tuple(keys), name)

    def carry_out(
        self, result: SweepResult, store: Store, workers: Workers, metrics: Sequence[str] = SHOWN
    ) -> "Controlled":
        """Perform the runs of the control that a store lacks, and correct the means of the result of the sweep."""
        control = carry_out(self.plan, store, workers, metrics=metrics)
        positions = {configuration.key: k for k, configuration in enumerate(self.plan.configurations)}
        groups = tuple(None if key is None else control.groups[positions[key]] for key in self.keys)
        runs = self.plan.reps * len(self.plan.configurations)
        return Controlled(result, groups, self.name, self.plan.reps, runs, tuple(metrics))


def _controlled_by(scenario: Scenario, protocol: Any) -> Scenario:
    """Return a scenario with a control as its protocol; on a perfect network if the control uses no network."""
    control = scenario.with_({"protocol": protocol})
    needs_no_network = control.protocol_traits.omniscient and not control.announces
    return with_perfect_network(control) if needs_no_network else control


@dataclass(frozen=True, repr=False)
class Controlled(TabularResult):
    """The result of a sweep, with means that a control makes more precise."""

    result: SweepResult
    controls: tuple[Group | None, ...]
    """The runs of the control of each configuration; None: the configuration is the control itself."""
    name: str
    """The name of the control."""
    runs: int
    """The number of runs of the control for each configuration."""
    all_runs: int
    """The number of runs of the control for all configurations together."""
    metrics: tuple[str, ...] = SHOWN

    def estimates(self, metric: str) -> list[ControlledEstimate | str]:
        """Return the corrected mean of a metric for each configuration, or the reason why there is none.

        Raises:
            ValueError: if the sweep has no numeric metric of this name.
        """
        self.result.estimates(metric)
        return [self._estimate(*pair, metric) for pair in zip(self.result.groups, self.controls, strict=True)]

    def _estimate(self, group: Group, control: Group | None, metric: str) -> ControlledEstimate | str:
        if control is None:
            return f"is {self.name} itself"
        positions = {row.replication: k for k, row in enumerate(row for row in group.rows if row.ok)}
        numbers, controls = group.numbers(metric), control.numbers(metric)
        control_positions = {row.replication: k for k, row in enumerate(row for row in control.rows if row.ok)}
        paired = [k for k in positions if k in control_positions]
        unpaired = [k for k in control_positions if k not in positions]
        try:
            return control_variate(
                numbers[[positions[k] for k in paired]],
                controls[[control_positions[k] for k in paired]],
                controls[[control_positions[k] for k in unpaired]],
            )
        except ValueError as error:
            return str(error)

    def rows(self, metric: str) -> list[tuple[str, ...]]:
        """Return the means of a metric without and with the control as rows of text; the first row is the header."""
        estimates = self.estimates(metric)
        corrected = [estimate for estimate in estimates if isinstance(estimate, ControlledEstimate)]
        digits = digits_of(corrected)
        head = title(metric, self.result.units)
        rows: list[tuple[str, ...]] = [
            (*self.result.keys, "runs", head, f"with {self.name}", "explained", "worth (runs)")
        ]
        for group, estimate in zip(self.result.groups, estimates, strict=True):
            settings = tuple(map(text, group.settings.values()))
            if isinstance(estimate, str):
                rows.append((*settings, str(len(group.rows)), "-", estimate, "-", "-"))
                continue
            plain = with_half_width(estimate.plain, estimate.count, digits=digits)
            with_control = with_half_width(estimate, estimate.count, digits=digits)
            worth = "inf" if isinf(estimate.worth) else f"{estimate.worth:.0f}"
            rows.append((*settings, str(estimate.count), plain, with_control, percent(estimate.explained, 0), worth))
        return rows

    def tables(self) -> list[Table]:
        """Return a table for each metric as its title and rows of text."""
        about = f"the control {self.name}, {counted(self.runs, 'run')} of equal and further seeds"
        return [(f"{words(metric)} with {about}", self.rows(metric)) for metric in self.metrics]

    def remarks(self) -> Iterator[str]:
        """Yield notes on what the columns mean, and on whether the control is worth its runs."""
        yield (
            "explained: the share of the variance that the control explains; worth: as many runs without it have the"
            f" same interval; the control took {counted(self.all_runs, 'run')} for all configurations"
        )
        failed = sum(len(group.failed) for group in self.controls if group is not None)
        if missing := len(self.result.failed) + failed:
            yield (
                f"warning: {counted(missing, 'run')} failed, {failed} of them of the control: the means are over the"
                " seeds of the others"
            )
        for metric in self.metrics:
            corrected = [estimate for estimate in self.estimates(metric) if isinstance(estimate, ControlledEstimate)]
            useless = sum(not estimate.helps for estimate in corrected)
            if useless:
                yield (
                    f"the control is worth little for {words(metric)} in {useless} of"
                    f" {counted(len(corrected), 'configuration')}: use the plain means there"
                )

    _between_notes = "\n"

    _notes = remarks  # `TabularResult` shows them below the tables

    def _right_from(self) -> int:
        return len(self.result.keys)

    def __repr__(self) -> str:
        configurations = counted(len(self.controls), "configuration")
        return f"<Controlled of {self.result.name}: {configurations}, control {self.name}>"

    def document(self) -> dict[str, Any]:
        """Return the estimates as JSON-compatible values."""

        def plain(estimate: ControlledEstimate | str) -> dict[str, Any]:
            if isinstance(estimate, str):
                return {"why": estimate}
            parts = {"explained": estimate.explained, "slope": estimate.slope, "worth": estimate.worth}
            return as_json(estimate) | {name: value if np.isfinite(value) else None for name, value in parts.items()}

        return {
            "control": self.name,
            "runs": self.runs,
            "all_runs": self.all_runs,
            "metrics": {metric: [plain(estimate) for estimate in self.estimates(metric)] for metric in self.metrics},
        }


@naming_arguments
def controlled(
    scenario: Scenario | Source,
    grid: SweepGrid | None = None,
    reps: int | None = None,
    executor: Executor | int | str = 1,
    *,
    control: Any = CONTROL,
    control_runs: int | None = None,
    seed: int | None = None,
    store: str | Path | None = None,
    control_store: str | Path | None = None,
    timeout: float | None = None,
    metrics: Metrics | None = None,
    shown: Sequence[str] = SHOWN,
    mix_versions: bool = False,
) -> Controlled:
    """Perform a sweep, and make its means more precise by a control variate.

    With the same seed, a run of another protocol has the same initial positions, so its metrics explain a share of the
    variance. Use this function if runs are slow and many configurations share a cheap control, such as `centralised`
    over properties of the network. It does not help paired differences: equal seeds already remove this share.

        print(controlled(scenario, {"network.latency": [0.0, 0.2, 0.5]}, reps=50))

    `control` is the protocol of the control: a kind, a table, or an object. `control_runs` is the number of its runs in
    each of its own configurations (None = ten times `reps`), and `control_store` the file to which they are added
    (None = no file). `shown` names the metrics that are corrected. The other arguments are as in `sweep`; `reps`
    is at least 4.

    Raises:
        TypeError: if `scenario` is no scenario, or the grid is not a mapping.
        ScenarioError: if the scenario, the grid or the control is invalid.
        ValueError: if seeds are independent, there are too few runs, or all configurations are the control itself.
        StoreError: if a store cannot be written, belongs to another sweep, or has runs of other versions.
        ConnectionError: if a scheduler does not answer or has no workers.
    """
    plan = SweepPlan.of(as_source(scenario, "controlled"), grid, reps, seed, metrics)
    control_plan = ControlPlan.of(plan, control, control_runs)
    shown = names_of_metrics(shown)
    for metric in shown:
        check_numeric(metric, dict(plan.metrics))
    with (
        workers_for(executor, plan.runs, timeout) as workers,
        Store(store) as sweep_store,
        Store(control_store) as store_of_control,
    ):
        plan.register(sweep_store, mix_versions=mix_versions)
        control_plan.plan.register(store_of_control, mix_versions=mix_versions)
        result = carry_out(plan, sweep_store, workers, metrics=shown)
        return control_plan.carry_out(result, store_of_control, workers, shown)

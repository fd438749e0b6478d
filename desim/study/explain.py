"""Which imperfection costs what: the same seeds with each imperfection removed, alone and all together.

What an imperfection costs is the paired difference between the scenario as it is and the scenario without it. If the
costs of all do not add up to what removing all together saves, they interact: two may each hide the other, or one may
hurt only where another does.
"""

import html
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import reduce
from operator import index
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

from desim.analysis.metrics import words
from desim.analysis.statistics import Estimate, estimate
from desim.analysis.tables import aligned, as_json, from_json, with_half_width
from desim.scenario import Scenario
from desim.study.cells import Cell
from desim.study.imperfections import IMPERFECTIONS
from desim.study.result import html_table
from desim.study.store import Row, Store
from desim.study.sweep import Plan, RunError, carry_out
from desim.study.workers import Workers, workers_for

EXPLAINED: Mapping[str, str] = MappingProxyType(
    {"active_time": "sum of active times, s", "end_time": "capture time, or horizon, s"}
)
"""The metrics in which costs are counted, and what tables call them."""
RUNS = 100
"""How many runs there are if no number is given; what few seeds decide takes more (see `paired`)."""
NOTHING = 1e-9
"""What is rounding, s."""
AS_IT_IS, IDEAL = "as it is", "ideal"


@dataclass(frozen=True)
class Saving:
    """What it saves to remove something, run by run with the same seed."""

    mean: Estimate
    differing: int
    """Number of runs in which it makes a difference."""

    @classmethod
    def of(cls, differences: list[float]) -> Self:
        """Return the saving that differences between runs amount to, s."""
        return cls(estimate(differences), sum(abs(each) > NOTHING for each in differences))

    def text(self, runs: int) -> str:
        """Return it as a table has it."""
        return with_half_width(self.mean, runs, "+") if self.differing else "0 in every run"

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return as_json(self.mean) | {"differing": self.differing}


@dataclass(frozen=True)
class Cost:
    """What the imperfections of a scenario cost in one metric."""

    as_it_is: Estimate
    ideal: Estimate
    """Without all of them."""
    parts: Mapping[str, Saving]
    """Of each imperfection that the scenario has: the scenario as it is less that without it."""
    together: Saving
    """The scenario as it is less the ideal one."""
    interaction: Saving
    """What is saved together and not by the parts: together less their sum."""

    @classmethod
    def of(cls, made: Mapping[str, Any]) -> Self:
        """Return the costs that a document has, as JSON has them."""

        def saving(part: Mapping[str, Any]) -> Saving:
            return Saving(from_json(part), int(part["differing"]))

        return cls(
            from_json(made["as_it_is"]),
            from_json(made["ideal"]),
            {str(name): saving(part) for name, part in made["parts"].items()},
            saving(made["together"]),
            saving(made["interaction"]),
        )

    @property
    def interacts(self) -> bool:
        """Whether the parts do not add up, beyond the 95 % interval."""
        rest = self.interaction.mean
        return abs(rest.mean) > max(rest.half_width, NOTHING)


@dataclass(frozen=True)
class Explanation:
    """Which imperfection of a scenario costs what."""

    name: str
    runs: int
    """Seeds with which no variant failed."""
    failed: int
    """Seeds with which some variant did, which are left out."""
    absent: tuple[str, ...]
    """The imperfections that the scenario does not have."""
    costs: Mapping[str, Cost]
    """By metric."""

    @classmethod
    def of(cls, made: Mapping[str, Any]) -> Self:
        """Return the costs that a document has, as JSON has them; see `document`.

        Raises:
            ValueError: if it is no such document.
        """
        try:
            costs = {metric: Cost.of(cost) for metric, cost in made["costs"].items() if metric in EXPLAINED}
            found = cls(str(made["name"]), int(made["runs"]), int(made["failed"]), tuple(made["absent"]), costs)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"is not of an explanation: {type(error).__name__}: {error}") from error
        if not costs:
            raise ValueError("is not of an explanation: has no costs")
        return found

    def table(self) -> str:
        """Return the costs as text."""
        return "\n".join([self._head(), aligned(self.rows()), *self.remarks()])

    def _repr_html_(self) -> str:
        """Return the same as a table of a notebook."""
        remarks = "".join(f"<p>{html.escape(each)}</p>" for each in self.remarks())
        return html_table(self._head(), self.rows()) + remarks

    def _head(self) -> str:
        return (
            f"{self.name}: the cost of each imperfection, {self.runs} runs of equal seeds; +- is half a 95 % t interval"
        )

    def rows(self) -> list[tuple[str, ...]]:
        """Return the costs as rows of text, of which the first is the head."""
        rows: list[tuple[str, ...]] = [("", *(EXPLAINED[metric] for metric in self.costs))]
        costs = list(self.costs.values())

        def add(name: str, found: list[Estimate | Saving]) -> None:
            texts = (
                each.text(self.runs) if isinstance(each, Saving) else with_half_width(each, self.runs) for each in found
            )
            rows.append((name, *texts))

        add(AS_IT_IS, [cost.as_it_is for cost in costs])
        for name in costs[0].parts:
            add(f"  {name}", [cost.parts[name] for cost in costs])
        if len(costs[0].parts) > 1:
            add("  interaction", [cost.interaction for cost in costs])
        add("  all together", [cost.together for cost in costs])
        add(IDEAL, [cost.ideal for cost in costs])
        return rows

    def remarks(self) -> list[str]:
        """Return what a reader should notice."""
        remarks = [f"not there: {', '.join(self.absent)}"] if self.absent else []
        for metric, cost in self.costs.items():
            if cost.interacts:
                total = sum(part.mean.mean for part in cost.parts.values())
                remarks.append(
                    f"the effects interact (beyond the 95 % interval): in {words(metric)} the parts add up to"
                    f" {total:+.3f} s, and all together cost {cost.together.mean.mean:+.3f} s"
                )
        return remarks + ([f"{self.failed} seeds are left out, with which a run failed"] if self.failed else [])

    def document(self) -> dict[str, Any]:
        """Return the costs as JSON has them."""
        costs = {
            metric: {
                "as_it_is": as_json(cost.as_it_is),
                "ideal": as_json(cost.ideal),
                "parts": {name: part.document() for name, part in cost.parts.items()},
                "together": cost.together.document(),
                "interaction": cost.interaction.document(),
                "interacts": cost.interacts,
            }
            for metric, cost in self.costs.items()
        }
        return {"name": self.name, "runs": self.runs, "failed": self.failed, "absent": self.absent, "costs": costs}


def explain(
    scenario: Scenario,
    runs: int = RUNS,
    executor: Executor | int | str = 1,
    *,
    seed: int | None = None,
    store: str | Path | None = None,
) -> Explanation:
    """Return which imperfection of a scenario costs what; arguments as of `sweep`.

    Raises:
        ValueError: if there are less than 2 runs, or the seed is negative.
        StoreError: if the store cannot be written, or is of something else.
        ConnectionError: if a scheduler does not answer.
        RunError: if with every seed some variant fails.
    """
    variants = Variants.of(scenario, runs, seed)
    with Store(None if store is None else Path(store)) as kept, workers_for(executor) as workers:
        variants.plan.enter(kept)
        return variants.carry_out(kept, workers)


@dataclass(frozen=True)
class Variants:
    """A scenario as it is, without each imperfection, and without all, and how often each is to be run."""

    plan: Plan
    cells: Mapping[str, Cell]
    """By what they are called; what is without something that is not there is the scenario as it is."""

    @classmethod
    def of(cls, scenario: Scenario, runs: int = RUNS, seed: int | None = None) -> Self:
        """Return the variants of a scenario.

        Raises:
            ValueError: if there are less than 2 runs, or the seed is negative.
        """
        if index(runs) < 2:
            raise ValueError(f"an interval needs at least 2 runs, got {runs}")
        ideal = reduce(lambda so_far, remove: remove(so_far), IMPERFECTIONS.values(), scenario)
        removed = {name: remove(scenario) for name, remove in IMPERFECTIONS.items()}
        named = {AS_IT_IS: scenario, **removed, IDEAL: ideal}
        cells = {name: Cell({"without": name}, each) for name, each in named.items()}
        distinct: dict[str, Cell] = {}
        for cell in cells.values():
            distinct.setdefault(cell.key, cell)
        return cls(
            Plan(scenario, tuple(distinct.values()), runs, scenario.seed if seed is None else index(seed)), cells
        )

    def carry_out(self, store: Store, workers: Workers) -> Explanation:
        """Run all variants that a store does not have yet, and compare.

        Raises:
            RunError: if with every seed some variant fails.
        """
        plan = self.plan
        carry_out(plan, store, workers)
        rows = {
            name: {row.replication: row for row in store.runs(cell.key, plan.root)} for name, cell in self.cells.items()
        }
        whole = [k for k in range(plan.reps) if all(found[k].ok for found in rows.values())]
        if not whole:
            failed = next(row for found in rows.values() for row in found.values() if not row.ok)
            raise RunError(f"with every seed a run failed; the first: {failed.error}\n")
        absent = tuple(name for name in IMPERFECTIONS if self.cells[name].key == self.cells[AS_IT_IS].key)
        costs = {metric: _cost(metric, rows, whole, absent) for metric in EXPLAINED}
        return Explanation(plan.base.name, len(whole), plan.reps - len(whole), absent, costs)


def _cost(metric: str, rows: Mapping[str, Mapping[int, Row]], whole: list[int], absent: tuple[str, ...]) -> Cost:
    values = {name: [getattr(found[k].summary, metric) for k in whole] for name, found in rows.items()}
    as_it_is = values.pop(AS_IT_IS)
    saved = {name: [a - b for a, b in zip(as_it_is, each, strict=True)] for name, each in values.items()}
    parts = {name: saved[name] for name in IMPERFECTIONS if name not in absent}
    rest = [total - sum(part[k] for part in parts.values()) for k, total in enumerate(saved[IDEAL])]
    return Cost(
        estimate(as_it_is),
        estimate(values[IDEAL]),
        {name: Saving.of(each) for name, each in parts.items()},
        Saving.of(saved[IDEAL]),
        Saving.of(rest),
    )

"""Which imperfection costs what: the same seeds with each imperfection removed, alone and all together.

What an imperfection costs is the paired difference between the scenario as it is and the scenario without it. If the
costs of all do not add up to what removing all together saves, they interact: two may each hide the other, or one may
hurt only where another does.
"""

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from types import MappingProxyType
from typing import Any

from desim.analysis.metrics import words
from desim.analysis.statistics import Estimate, estimate
from desim.analysis.tables import aligned, as_json, with_half_width
from desim.scenario import Scenario
from desim.study.cells import Cell, resolved
from desim.study.imperfections import IMPERFECTIONS
from desim.study.store import Row, Store, flat
from desim.study.sweep import Plan, carry_out
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
class Cost:
    """What the imperfections of a scenario cost in one metric."""

    as_it_is: Estimate
    ideal: Estimate
    """Without all of them."""
    parts: Mapping[str, Estimate]
    """Of each imperfection that the scenario has: the scenario as it is less that without it."""
    together: Estimate
    """The scenario as it is less the ideal one."""
    interaction: Estimate
    """What is saved together and not by the parts: together less their sum."""

    @property
    def interact(self) -> bool:
        """Whether the parts do not add up, beyond the 95 % interval."""
        return abs(self.interaction.mean) > max(self.interaction.half_width, NOTHING)


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

    def table(self) -> str:
        """Return the costs as text."""
        head = (
            f"{self.name}: the cost of each imperfection, {self.runs} runs of equal seeds; +- is half a 95 % t interval"
        )
        rows = [("", *(EXPLAINED[metric] for metric in self.costs))]
        costs = list(self.costs.values())

        def add(name: str, found: list[Estimate], sign: str = "+") -> None:
            rows.append((name, *(with_half_width(each, self.runs, sign) for each in found)))

        add(AS_IT_IS, [cost.as_it_is for cost in costs], "")
        for name in costs[0].parts:
            add(f"  {name}", [cost.parts[name] for cost in costs])
        if len(costs[0].parts) > 1:
            add("  interaction", [cost.interaction for cost in costs])
        add("  all together", [cost.together for cost in costs])
        add(IDEAL, [cost.ideal for cost in costs], "")
        return "\n".join([head, aligned(rows), *self._remarks()])

    def _remarks(self) -> list[str]:
        """Return what a reader should notice."""
        remarks = [f"not there: {', '.join(self.absent)}"] if self.absent else []
        for metric, cost in self.costs.items():
            if cost.interact:
                total = sum(part.mean for part in cost.parts.values())
                remarks.append(
                    f"the effects interact: in {words(metric)} the parts add up to {total:+.3f} s, and all together"
                    f" cost {cost.together.mean:+.3f} s"
                )
        return remarks + ([f"{self.failed} seeds are left out, with which a run failed"] if self.failed else [])

    def document(self) -> dict[str, Any]:
        """Return the costs as JSON has them."""
        costs = {
            metric: {
                "as_it_is": as_json(cost.as_it_is),
                "ideal": as_json(cost.ideal),
                "parts": {name: as_json(part) for name, part in cost.parts.items()},
                "together": as_json(cost.together),
                "interaction": as_json(cost.interaction),
                "interact": cost.interact,
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
        ValueError: if there are less than 2 runs, or with every seed some variant fails.
    """
    plan, variants = planned(scenario, runs, scenario.seed if seed is None else seed)
    with Store(None if store is None else Path(store)) as kept, workers_for(executor) as workers:
        plan.enter(kept)
        return carry_out_explanation(plan, variants, kept, workers)


def planned(scenario: Scenario, runs: int, seed: int) -> tuple[Plan, dict[str, Cell]]:
    """Return the plan of an explanation, and its configurations by what they are called; some may be the same."""
    if runs < 2:
        raise ValueError(f"an interval needs at least 2 runs, got {runs}")
    removed = {name: remove(scenario) for name, remove in IMPERFECTIONS.items()}
    ideal = reduce(lambda so_far, remove: remove(so_far), IMPERFECTIONS.values(), scenario)
    variants = {
        name: Cell({"without": name}, each) for name, each in {AS_IT_IS: scenario, **removed, IDEAL: ideal}.items()
    }
    distinct: dict[str, Cell] = {}
    for cell in variants.values():
        distinct.setdefault(cell.key, cell)  # what is not there is removed by doing nothing
    about = {"scenario": flat(resolved(scenario)), "grid": ["without"], "seeds": "common"}
    return Plan(scenario.name, tuple(distinct.values()), runs, seed, about=about), variants


def carry_out_explanation(plan: Plan, variants: Mapping[str, Cell], store: Store, workers: Workers) -> Explanation:
    """Run all variants that a store does not have yet, and compare."""
    carry_out(plan, store, workers)
    rows = {name: {row.replication: row for row in store.runs(cell.key, plan.root)} for name, cell in variants.items()}
    whole = [k for k in range(plan.reps) if all(found[k].ok for found in rows.values())]
    if not whole:
        failed = next(row for found in rows.values() for row in found.values() if not row.ok)
        raise ValueError(f"with every seed a run failed; the first: {failed.error}")
    absent = tuple(name for name in IMPERFECTIONS if variants[name].key == variants[AS_IT_IS].key)
    costs = {metric: _cost(metric, rows, whole, absent) for metric in EXPLAINED}
    return Explanation(plan.name, len(whole), plan.reps - len(whole), absent, costs)


def _cost(metric: str, rows: Mapping[str, Mapping[int, Row]], whole: list[int], absent: tuple[str, ...]) -> Cost:
    values = {name: [getattr(found[k].summary, metric) for k in whole] for name, found in rows.items()}
    as_it_is = values[AS_IT_IS]
    parts = {
        name: [a - b for a, b in zip(as_it_is, values[name], strict=True)]
        for name in IMPERFECTIONS
        if name not in absent
    }
    together = [a - b for a, b in zip(as_it_is, values[IDEAL], strict=True)]
    interaction = [total - sum(part[k] for part in parts.values()) for k, total in enumerate(together)]
    return Cost(
        estimate(as_it_is),
        estimate(values[IDEAL]),
        {name: estimate(each) for name, each in parts.items()},
        estimate(together),
        estimate(interaction),
    )

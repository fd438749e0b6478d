"""The cost of each imperfection of a scenario, as a table and as JSON."""

import html
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Self

from desim.analysis.metrics import with_unit, words
from desim.analysis.statistics import Estimate, mean
from desim.analysis.tables import aligned, as_json, from_json, html_table, with_half_width

EXPLAINED: Mapping[str, str] = MappingProxyType(
    {"active_time": "sum of active times", "end_time": "capture time, or horizon"}
)
"""The metrics in which costs are measured by default, and their titles in tables."""
NOTHING = 1e-9
"""The largest difference that is attributed to rounding."""
AS_IT_IS, IDEAL = "as it is", "ideal"


@dataclass(frozen=True)
class Saving:
    """The decrease of a metric when imperfections are removed: the mean difference of runs paired by seed."""

    mean: Estimate
    differing: int
    """The number of pairs that differ."""

    @classmethod
    def of(cls, differences: list[float]) -> Self:
        """Return the saving, given the difference of each pair of runs."""
        return cls(mean(differences), sum(abs(each) > NOTHING for each in differences))

    def text(self, runs: int) -> str:
        """Return the saving as the text of a table cell."""
        is_0 = self.mean.count and not self.differing
        return "0 in every run" if is_0 else with_half_width(self.mean, runs, "+")

    def document(self) -> dict[str, Any]:
        """Return the saving as JSON-compatible values."""
        return as_json(self.mean) | {"differing": self.differing}


@dataclass(frozen=True)
class Cost:
    """The cost of the imperfections of a scenario in one metric."""

    label: str
    """The label of the metric in tables and figures."""
    unit: str
    as_it_is: Estimate
    ideal: Estimate
    """The scenario without any imperfection."""
    parts: Mapping[str, Saving]
    """For each imperfection of the scenario: the metric with all imperfections minus the metric without this one."""
    together: Saving
    """The metric with all imperfections minus the metric without any."""
    interaction: Saving
    """`together` minus the sum of the parts."""

    @classmethod
    def of(cls, made: Mapping[str, Any]) -> Self:
        """Return the cost in the JSON values of a document."""

        def saving(part: Mapping[str, Any]) -> Saving:
            return Saving(from_json(part), int(part["differing"]))

        return cls(
            str(made["label"]),
            str(made["unit"]),
            from_json(made["as_it_is"]),
            from_json(made["ideal"]),
            {str(name): saving(part) for name, part in made["parts"].items()},
            saving(made["together"]),
            saving(made["interaction"]),
        )

    @property
    def interacts(self) -> bool:
        """Whether the parts do not add up to the whole: the 95 % interval of the interaction excludes 0."""
        rest = self.interaction.mean
        return abs(rest.mean) > max(rest.half_width, NOTHING)


@dataclass(frozen=True)
class Explanation:
    """The cost of each imperfection of a scenario; see `desim.study.explain`."""

    name: str
    runs: int
    """The number of seeds for which no variant failed."""
    failed: int
    """The number of seeds for which some variant failed; these are left out."""
    absent: tuple[str, ...]
    """The imperfections that the scenario does not have."""
    costs: Mapping[str, Cost]
    """By metric."""

    @classmethod
    def of(cls, made: Mapping[str, Any]) -> Self:
        """Return the explanation in a document of JSON values; see `document`.

        Raises:
            ValueError: if the document is not an explanation.
        """
        try:
            costs = {str(metric): Cost.of(cost) for metric, cost in made["costs"].items()}
            found = cls(str(made["name"]), int(made["runs"]), int(made["failed"]), tuple(made["absent"]), costs)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"is not an explanation: {type(error).__name__}: {error}") from error
        if not costs:
            raise ValueError("is not an explanation: has no costs")
        return found

    def table(self) -> str:
        """Return the costs as text."""
        return "\n".join([self._head(), aligned(self.rows()), *self.remarks()])

    def _repr_html_(self) -> str:
        """Return the table as HTML, for notebooks."""
        remarks = "".join(f"<p>{html.escape(each)}</p>" for each in self.remarks())
        return html_table(self._head(), self.rows()) + remarks

    def _head(self) -> str:
        return (
            f"{self.name}: the cost of each imperfection, {self.runs} runs of equal seeds; +- is half a 95 % t interval"
        )

    def rows(self) -> list[tuple[str, ...]]:
        """Return the costs as rows of text; the first row is the header."""
        rows: list[tuple[str, ...]] = [("", *(with_unit(cost.label, cost.unit) for cost in self.costs.values()))]
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
        """Return notes on absent imperfections, interactions and failed seeds."""
        remarks = [f"absent: {', '.join(self.absent)}"] if self.absent else []
        for metric, cost in self.costs.items():
            if cost.interacts:
                total, unit = sum(part.mean.mean for part in cost.parts.values()), f" {cost.unit}".rstrip()
                remarks.append(
                    f"the effects interact (beyond the 95 % interval): in {words(metric)} the parts add up to"
                    f" {total:+.3f}{unit}, and all together cost {cost.together.mean.mean:+.3f}{unit}"
                )
        return remarks + ([f"{self.failed} seeds are left out because a run failed"] if self.failed else [])

    def document(self) -> dict[str, Any]:
        """Return the explanation as JSON-compatible values."""
        costs = {
            metric: {
                "label": cost.label,
                "unit": cost.unit,
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

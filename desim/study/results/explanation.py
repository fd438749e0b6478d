"""The cost of each imperfection of a scenario (such as latency or loss), as a table and as JSON.

Imperfections interact if their costs do not add up to the cost of all of them together; see
`desim.study.ablation.explain`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

from desim.analysis.metrics import with_unit, words
from desim.analysis.statistics import Estimate, Share, wilson
from desim.analysis.table_formats import Table, TableFormat, TabularResult
from desim.analysis.tables import aligned, as_json, digits_in, number, percent, with_half_width
from desim.config.arguments import naming_arguments, without_addresses
from desim.config.extras import naming_extras
from desim.config.number_texts import counted
from desim.kernel.core.portable_math import portable_sum
from desim.study.results.costs import AS_IT_IS, IDEAL, PERFECT, SILENT, Bounds, Cost, Saving
from desim.study.results.runs import CAPTURE_TIMES

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure, Style

EXPLAINED: Mapping[str, str] = MappingProxyType(
    {"active_time": "sum of active times", "end_time": "capture time, or horizon"}
)
"""The metrics in which costs are measured by default, and their titles in tables."""


@dataclass(frozen=True, repr=False)
class Explanation(TabularResult):
    """The cost of each imperfection of a scenario; see `desim.study.ablation.explain`.

    A *variant* is the scenario as it is, without one imperfection, without all of them, with a perfect network, or
    without messages.
    """

    name: str
    runs: int
    """The number of seeds for which no variant failed."""
    failed: int
    """The number of seeds for which some variant failed; these are left out."""
    absent: tuple[str, ...]
    """The imperfections that the scenario does not have."""
    costs: Mapping[str, Cost]
    """The costs by metric."""

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Self:
        """Return the explanation that a document of JSON values describes; see `document`.

        Raises:
            ValueError: if the document is not an explanation.
        """
        try:
            costs = {str(metric): Cost.of(cost) for metric, cost in document["costs"].items()}
            runs, failed = int(document["runs"]), int(document["failed"])
            explanation = cls(str(document["name"]), runs, failed, tuple(document["absent"]), costs)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"is not an explanation: {type(error).__name__}: {error}") from error
        if not costs:
            raise ValueError("is not an explanation: has no costs")
        return explanation

    def tables(self) -> list[Table]:
        """Return the table of costs as its title and rows of text; the first row is the header."""
        return [(self._head(), self.rows())]

    @naming_arguments
    def table(self, *, format: TableFormat = "text") -> str:  # noqa: A002 - the usual word
        """Return the costs as a table: text, latex (booktabs) or markdown.

        Raises:
            ValueError: if there is no such format.
        """
        if format == "text":
            return "\n".join([self._head(), aligned(self.rows()), *self.remarks()])
        return super().table(format=format)

    @naming_extras()
    def plot(
        self,
        metric: str | None = None,
        *,
        size: str | None = None,
        style: "Style" = None,
        ax: "Axes | None" = None,
    ) -> "Figure":
        """Return the costs as a waterfall chart from ideal to as it is; needs matplotlib (the extra `plot`).

        Args:
            metric: the metric to draw; None = all, with a panel each.
            size: the width and perhaps the height, such as "8.5cm" or "8.5cmx6cm"; such a figure has no title.
            style: a style of matplotlib on top of that of desim: rcParams, or the name of a style.
            ax: the axes to draw on, for a figure of several; None = a figure of its own.

        Raises:
            ValueError: if there are no costs in this metric, the size or the style is invalid, or several metrics do
                not fit into `ax`.
            TypeError: if `ax` is not one pair of axes of matplotlib.
        """
        from desim.study.results.waterfalls import waterfall

        if metric is not None and metric not in self.costs:
            name = without_addresses(str(metric))
            raise ValueError(f"there are no costs in {name}: the metrics are {', '.join(self.costs)}")
        chosen = self.costs if metric is None else {metric: self.costs[metric]}
        return waterfall(self.name, self.runs, chosen, size=size, style=style, ax=ax)

    def __repr__(self) -> str:
        return f"<Explanation of {self.name}: {counted(self.runs, 'run')}, {', '.join(map(words, self.costs))}>"

    def _head(self) -> str:
        has_shares = any(isinstance(cost.as_it_is, Share) for cost in self.costs.values())
        shares = ", in brackets a Wilson interval" * has_shares
        return (
            f"{self.name}: the cost of each imperfection, {counted(self.runs, 'run')} of equal seeds; +- is half a"
            f" 95 % t interval{shares}"
        )

    def rows(self) -> list[tuple[str, ...]]:
        """Return the costs as rows of text; the first row is the header."""
        rows: list[tuple[str, ...]] = [("", *(with_unit(cost.label, cost.unit) for cost in self.costs.values()))]
        costs = list(self.costs.values())

        def add(name: str, estimates: list[Estimate | Saving]) -> None:
            texts = (
                part.text(self.runs, cost.digits)
                if isinstance(part, Saving)
                else with_half_width(part, self.runs, digits=cost.digits)
                for part, cost in zip(estimates, costs, strict=True)
            )
            rows.append((name, *texts))

        add(AS_IT_IS, [cost.as_it_is for cost in costs])
        for name in costs[0].parts:
            add(f"  {name}", [cost.parts[name] for cost in costs])
        if len(costs[0].parts) > 1:
            add("  interaction", [cost.interaction for cost in costs])
        add("  all together", [cost.together for cost in costs])
        add(IDEAL, [cost.ideal for cost in costs])
        bounds = [cost.bounds for cost in costs if cost.bounds is not None]
        if len(bounds) == len(costs):
            add(PERFECT, [bound.perfect for bound in bounds])
            add(SILENT, [bound.silent for bound in bounds])
            add("  difference", [bound.difference for bound in bounds])
        return rows

    def remarks(self) -> list[str]:
        """Return notes on signs, absences, bounds, effects not detected or 0, interactions and failed seeds."""
        remarks = [self._signs()]
        remarks += [f"absent: {', '.join(self.absent)}"] if self.absent else []
        for metric, cost in self.costs.items():
            if (count := cost.together.mean.count) < self.runs:
                hint = "; end time counts the horizon" if metric in CAPTURE_TIMES else ""
                remarks.append(
                    f"{words(metric)} has a value in all variants for {count} of {counted(self.runs, 'seed')}, so the"
                    f" costs hold for these only{hint}"
                )
            remarks += [] if cost.bounds is None else _network(words(metric), cost.bounds, cost.unit)
        undetected = [note for metric, cost in self.costs.items() for note in _undetected(words(metric), cost)]
        if undetected:
            undetected.append(
                f"with {self.runs} runs, an effect as large as its +- is found in half of all studies, a smaller effect"
                " less often"
            )
        unchanging = [note for metric, cost in self.costs.items() for note in _unchanging(words(metric), cost)]
        interactions = [note for metric, cost in self.costs.items() for note in self._interaction(words(metric), cost)]
        remarks += undetected + unchanging + interactions
        return remarks + ([f"left out because a run failed: {counted(self.failed, 'seed')}"] if self.failed else [])

    _notes = remarks  # `TabularResult` shows them below the tables

    def _signs(self) -> str:
        """Return a note that says for each metric whether a positive cost is good or bad."""
        kinds = {"worse": "+ is worse", "better": "+ is better", None: "+ may be better or worse"}
        metrics_by_text = {
            text: ", ".join(words(metric) for metric, cost in self.costs.items() if cost.more_is == kind)
            for kind, text in kinds.items()
        }
        return "; ".join(f"{text}: {names}" for text, names in metrics_by_text.items() if names)

    def _interaction(self, metric: str, cost: Cost) -> Iterator[str]:
        """Yield the note on whether the parts of a cost interact, if the interaction is not 0 in every run."""
        unit, metrics = f" {cost.unit}".rstrip(), len(self.costs)
        interval = f"the {100 * cost.confidence:.4g} % interval" + f" (99 % over {metrics} metrics)" * (metrics > 1)
        interaction = cost.interaction.mean
        digits = digits_in(interaction)
        if cost.interacts:
            total = portable_sum(part.mean.mean for part in cost.parts.values())
            yield (
                f"the effects interact, beyond {interval}: in {metric} the parts add up to {total:+.{digits}f}{unit},"
                f" and all together cost {cost.together.mean.mean:+.{digits}f}{unit}"
            )
        elif cost.interaction.differing and interaction.count > 1:
            width = f"+-{number(interaction.half_width_at(cost.confidence), digits)}{unit}"
            mean = f"{interaction.mean:+.{digits}f}{unit}"
            yield f"no interaction is declared in {metric}: {mean} is within {width}, {interval}"

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
                "confidence": cost.confidence,
                "more_is": cost.more_is,
                "bounds": None if cost.bounds is None else cost.bounds.document(),
            }
            for metric, cost in self.costs.items()
        }
        return {"name": self.name, "runs": self.runs, "failed": self.failed, "absent": self.absent, "costs": costs}


def _network(metric: str, bounds: Bounds, unit: str) -> Iterator[str]:
    """Yield a note if the network made no difference in a metric, or its bounds cannot be told apart."""
    difference = bounds.difference
    if not difference.mean.count:
        return
    if not difference.differing:
        yield (
            f"the network made no difference in {metric}: a {PERFECT} and {SILENT} are equal in every run;"
            f" {_share_differing(difference.mean.count)}"
        )
    elif difference.mean.others is not None and not difference.excludes_0():
        yield (
            f"a {PERFECT} and {SILENT} differ in {metric} by {_width(difference.mean, unit)}, which are too few to tell"
            " whether the network matters"
        )
    elif difference.mean.count > 1 and not difference.excludes_0():
        width = _width(difference.mean, unit)
        yield (
            f"whether the network matters in {metric} is not known: a {PERFECT} and {SILENT} cannot be told apart"
            f" ({width})"
        )


def _width(estimate: Estimate, unit: str) -> str:
    """Return the half width of the interval of a mean as text; if all values are equal, their value instead."""
    digits = digits_in(estimate)
    if estimate.others is not None:
        return f"{estimate.mean:+.{digits}f} {unit}".rstrip() + f" in all of {counted(estimate.count, 'run')}"
    return f"+-{number(estimate.half_width, digits)} {unit}".rstrip()


def _undetected(metric: str, cost: Cost) -> Iterator[str]:
    """Yield the note on the parts that differ from 0 in some run but are not significant, with their half widths."""
    parts = ", ".join(f"{name} ({_width(cost.parts[name].mean, cost.unit)})" for name in cost.undetected)
    if parts and cost.together.mean.count > 1:
        yield f"not distinguishable from 0 in {metric}: {parts}"


def _unchanging(metric: str, cost: Cost) -> Iterator[str]:
    """Yield the note on the parts of a cost that are 0 in every run, and on the share of seeds that may differ."""
    if cost.unchanging:
        yield f"0 in every run in {metric}: {', '.join(cost.unchanging)}; {_share_differing(cost.together.mean.count)}"


def _share_differing(count: int) -> str:
    """Return a note on the share of all seeds that may differ although `count` runs are all equal."""
    return f"up to {percent(wilson(0, count)[1]).replace('%', ' %')} of all seeds may differ (95 % Wilson interval)"

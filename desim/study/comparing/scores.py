"""The scores of a benchmark, between the bounds of each scenario, with their intervals.

P and Z are the costs of the reference protocol with a perfect network and without messages. A and Q are the costs of a
protocol on the network of the scenario and on a perfect one. All four have equal seeds. With means over the seeds,

    score = (Z - A) / (Z - P),    quality = (Z - Q) / (Z - P),    loss = quality - score = (A - Q) / (Z - P).

So 1 is what the reference does on an ideal network, and 0 what it does without any message. All protocols share these
bounds. With bounds of its own, a protocol that does badly even on an ideal network would lose little without one, and
look robust. `quality` is what a protocol does on a perfect network, and `loss` what the network of the scenario costs.

The interval of such a ratio r is that of the mean of ((Z_i - A_i) - r (Z_i - P_i)) / (Z - P) over the seeds i, the
linearised ratio of paired values (Cochran 1977, "Sampling Techniques", section 2.11), with Student's t. The interval
needs a denominator far from 0: a scenario is kept only if Z - P is more than `APART` standard errors, over all runs of
the version. The total of several scenarios is the mean of their scores. Its interval is over the means of each seed,
because runs of different scenarios with one seed have equal initial positions.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf, nan, sqrt
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from desim.analysis.statistics import Estimate, estimate
from desim.analysis.table_formats import Table, TabularResult
from desim.analysis.tables import as_json, digits_in
from desim.config.arrays import Floats
from desim.config.extras import naming_extras
from desim.config.json_numbers import json_number
from desim.config.number_texts import counted
from desim.kernel.core.portable_math import portable_sum
from desim.study.comparing.suite import AS_IT_IS, PERFECT, REFERENCE, SILENT, CostsByProtocol

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Figure, Style

APART = 10.0
"""The least distance of the bounds of a scenario in standard errors."""
RISK = 0.05
"""The largest probability, by Bonferroni, that the table calls a protocol behind the best one although it is not.

The best one is chosen by the same runs, so the bound holds for the differences of all pairs. A bound for comparisons
with one protocol that is fixed in advance would give a probability of 0.28 for 14 equal protocols.
"""
OMNISCIENT = "centralised"
"""The protocol that knows everything at once: a bound, and no competitor."""


class NoPart(NamedTuple):
    """A protocol that cannot take part in a scenario."""

    protocol: str
    scenario: str
    why: str


@dataclass(frozen=True)
class Ratio:
    """The ratio of a mean difference of costs to the mean difference of the bounds, with the deviations by seed."""

    value: float
    parts: Floats
    """(n,) linearised deviations of the ratio by seed; their mean is 0."""

    @classmethod
    def of(cls, above: Floats, below: Floats) -> Self:
        """Return the ratio of the means of paired values, (n,) each."""
        mean_below = float(np.mean(below))
        if not mean_below:  # the bounds are equal
            return cls(nan, np.full(len(below), nan))
        value = float(np.mean(above)) / mean_below
        return cls(value, (above - value * below) / mean_below)

    @classmethod
    def mean(cls, ratios: Sequence["Ratio"]) -> Self:
        """Return the mean of ratios of the same seeds."""
        return cls(
            portable_sum(ratio.value for ratio in ratios) / len(ratios),
            np.mean([ratio.parts for ratio in ratios], axis=0),
        )

    def minus(self, other: "Ratio") -> "Ratio":
        """Return the difference of two ratios of the same seeds."""
        return Ratio(self.value - other.value, self.parts - other.parts)

    @property
    def estimate(self) -> Estimate:
        """The ratio with its standard error."""
        count = len(self.parts)
        return Estimate(self.value, float(np.std(self.parts, ddof=1)) / sqrt(count), count)


class Score(NamedTuple):
    """What a protocol reaches between the bounds."""

    score: Ratio
    """On the network of the scenario."""
    quality: Ratio
    """On a perfect network."""

    @property
    def loss(self) -> Ratio:
        """What the network of the scenario costs."""
        return self.quality.minus(self.score)


@dataclass(frozen=True, repr=False)
class Benchmark(TabularResult):
    """The costs of all runs of a benchmark, and the scores that follow from them."""

    version: str
    costs: Mapping[str, CostsByProtocol]
    """The (n,) costs by scenario, protocol and network; costs at equal positions are of equal seeds."""
    own: tuple[str, ...] = ()
    """The names of the protocols of the caller."""
    absent: tuple[NoPart, ...] = ()
    frozen: Mapping[str, CostsByProtocol] = field(default_factory=dict)
    """The costs of all runs of the version, by scenario; empty if it has no costs, or `costs` has all its runs.

    Their bounds decide which scenarios are kept, so that a benchmark of few runs keeps the same scenarios.
    """

    @property
    def runs(self) -> int:
        """The number of runs of each protocol in each scenario."""
        return len(next(iter(self.costs.values()))[REFERENCE][PERFECT])

    def apart(self, scenario: str) -> float:
        """Return the distance of the bounds of a scenario in standard errors; inf if it is above 0 without error."""
        reference = self.frozen.get(scenario, self.costs[scenario])[REFERENCE]
        difference = estimate(reference[SILENT] - reference[PERFECT])
        if not difference.standard_error:
            return inf if difference.mean > 0.0 else 0.0
        return difference.mean / difference.standard_error

    @cached_property
    def kept(self) -> tuple[str, ...]:
        """The scenarios whose bounds are far enough apart; in the others the network does not matter enough."""
        return tuple(name for name in self.costs if self.apart(name) > APART)

    @cached_property
    def scores(self) -> Mapping[str, Mapping[str, Score]]:
        """The scores by protocol and kept scenario."""
        names = dict.fromkeys(name for by_protocol in self.costs.values() for name in by_protocol)
        return {
            name: {scenario: self._score(name, scenario) for scenario in self.kept if name in self.costs[scenario]}
            for name in names
        }

    @cached_property
    def totals(self) -> Mapping[str, Score]:
        """The mean score of each protocol that takes part in all kept scenarios, best first."""
        totals = {
            name: Score(*(Ratio.mean([score[k] for score in scores.values()]) for k in (0, 1)))
            for name, scores in self.scores.items()
            if scores and len(scores) == len(self.kept)
        }
        return dict(sorted(totals.items(), key=lambda item: -item[1].score.value))

    @property
    def best(self) -> str | None:
        """The competitor with the greatest total; None if there is none."""
        return next((name for name in self.totals if name != OMNISCIENT), None)

    def is_behind(self, name: str) -> bool:
        """Return whether a protocol is behind the best one, beyond the Bonferroni interval of the paired difference."""
        best = self.best
        if best is None or name == best:
            return False
        difference = self.totals[best].score.minus(self.totals[name].score).estimate
        rivals = len(self.totals) - (OMNISCIENT in self.totals)
        pairs = max(rivals * (rivals - 1), 1)  # ordered pairs: the better one of two is not known before
        # One-sided: of the two-sided test, only the half of a positive difference counts.
        return difference.mean > 0.0 and difference.excludes_0(1.0 - 2.0 * RISK / pairs)

    def _score(self, name: str, scenario: str) -> Score:
        costs, reference = self.costs[scenario][name], self.costs[scenario][REFERENCE]
        silent, width = reference[SILENT], reference[SILENT] - reference[PERFECT]
        return Score(*(Ratio.of(silent - costs[network], width) for network in (AS_IT_IS, PERFECT)))

    def tables(self) -> list[Table]:
        """Return the tables of totals, of scores by scenario, and of bounds, each as its title and rows of text."""
        scenarios, runs = counted(len(self.kept), "scenario"), counted(self.runs, "run")
        head = f"benchmark, version {self.version}: {scenarios}, {runs} each"
        return [
            (
                f"{head}; 1 = {REFERENCE} on a perfect network, 0 = without messages; +- is half a 95 % t interval",
                [*self._total_rows()],
            ),
            ("score by scenario", [*self._scenario_rows()]),
            (
                f"bounds: mean cost of {REFERENCE}, s; distance in standard errors"
                f"{' of all runs of the version' if self.frozen else ''}",
                [("", "perfect", "as it is", "silent", "distance"), *self._bound_rows()],
            ),
        ]

    def _total_rows(self) -> Iterator[tuple[str, ...]]:
        yield "", "score", "quality", "loss", "behind"
        for name, total in self.totals.items():
            ratios = (total.score, total.quality, total.loss)
            behind = "" if name in (self.best, OMNISCIENT) else "yes" if self.is_behind(name) else "not shown"
            yield self._table_name(name), *(_text(ratio.estimate) for ratio in ratios), behind

    def _scenario_rows(self) -> Iterator[tuple[str, ...]]:
        yield "", *self.kept
        partly = [name for name in self.scores if name not in self.totals]
        for name in (*self.totals, *partly):
            scores = self.scores[name]
            yield (
                self._table_name(name),
                *(_text(scores[scenario].score.estimate) if scenario in scores else "-" for scenario in self.kept),
            )

    def _bound_rows(self) -> Iterator[tuple[str, ...]]:
        for name, by_protocol in self.costs.items():
            costs = [by_protocol[REFERENCE][network] for network in (PERFECT, AS_IT_IS, SILENT)]
            left_out = "" if name in self.kept else " (left out)"
            yield name + left_out, *(f"{np.mean(cost):.2f}" for cost in costs), f"{self.apart(name):.1f}"

    def _table_name(self, name: str) -> str:
        """Return the name of a protocol in tables, which marks those of the caller and the omniscient one."""
        return f"> {name}" if name in self.own else f"({name})" if name == OMNISCIENT else name

    def remarks(self) -> list[str]:
        """Return notes on the bounds, on scenarios that are left out, and on protocols that cannot take part."""
        notes = ["score = quality - loss: quality is the score on a perfect network, loss what the network costs"]
        if self.best is not None:
            notes.append(
                f"behind: behind {self.best} in pairs of equal seeds, at {RISK:.0%} for all protocols together;"
                f" ({OMNISCIENT}) knows everything at once, and is no competitor"
            )
        if left_out := [name for name in self.costs if name not in self.kept]:
            notes.append(
                f"left out: {', '.join(left_out)}: the bounds are not more than {APART:g} standard errors apart, so the"
                " network does not matter enough, or there are too few runs"
            )
        reasons = dict[tuple[str, str], list[str]]()
        for absence in self.absent:
            reasons.setdefault((absence.protocol, absence.why), []).append(absence.scenario)
        notes += [f"{name} takes no part in {', '.join(names)}: {why}" for (name, why), names in reasons.items()]
        return notes

    _between_notes = "\n"

    _notes = remarks  # `TabularResult` shows them below the tables

    def __repr__(self) -> str:
        protocols = counted(len(self.scores), "protocol")
        return f"<Benchmark, version {self.version}: {protocols}, {counted(self.runs, 'run')} in each scenario>"

    @naming_extras()
    def plot(self, *, size: str | None = None, style: "Style" = None) -> "Figure":
        """Return a figure of the totals with their intervals, and of the scores by scenario; needs matplotlib.

        Args:
            size: the width and perhaps the height, such as "17cm" or "17cmx9cm".
            style: a style of matplotlib on top of that of desim: rcParams, or the name of a style.

        Raises:
            ValueError: if no scenario is kept, or the size or the style is invalid.
            ModuleNotFoundError: if matplotlib is not installed.
        """
        from desim.study.comparing.score_figure import score_figure

        if not self.kept:
            raise ValueError("no scenario is kept: there are too few runs for a figure")
        totals = {
            self._table_name(name): (total.score.estimate, total.quality.estimate)
            for name, total in self.totals.items()
        }
        scores = {
            self._table_name(name): [self.scores[name][scenario].score.value for scenario in self.kept]
            for name in self.totals
        }
        return score_figure(totals, scores, list(self.kept), size=size, style=style)

    def document(self) -> dict[str, Any]:
        """Return the scores as JSON-compatible values."""

        def numbers(score: Score) -> dict[str, Any]:
            ratios = {"score": score.score, "quality": score.quality, "loss": score.loss}
            return {name: as_json(ratio.estimate) for name, ratio in ratios.items()}

        return {
            "version": self.version,
            "runs": self.runs,
            "reference": REFERENCE,
            "scenarios": {
                name: {"distance": json_number(self.apart(name)), "kept": name in self.kept} for name in self.costs
            },
            "best": self.best,
            "protocols": {
                name: {
                    "total": numbers(self.totals[name]) if name in self.totals else None,
                    "behind": self.is_behind(name) if name in self.totals else None,
                    "scenarios": {scenario: numbers(score) for scenario, score in scores.items()},
                }
                for name, scores in self.scores.items()
            },
            "absent": [absence._asdict() for absence in self.absent],
        }


def _text(value: Estimate) -> str:
    digits = digits_in(value, 3)
    return f"{value.mean:.{digits}f} +- {value.half_width:.{digits}f}" if value.standard_error else f"{value.mean:.3f}"

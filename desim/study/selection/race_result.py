"""The result of a race: which configuration is best, which were dropped when, and what that saved."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

from desim.analysis.metrics import with_unit, words
from desim.analysis.statistics import Estimate, mean, paired, share
from desim.analysis.table_formats import Table, TabularResult
from desim.analysis.tables import as_json, digits_of, with_half_width
from desim.config.extras import naming_extras
from desim.config.json_numbers import json_number
from desim.config.number_texts import counted
from desim.study.plan.configurations import in_words
from desim.study.results.runs import text
from desim.study.selection.kim_nelson import Selection, independent_variances, two_stage_runs

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure, Style
    from desim.config.arrays import Floats


@dataclass(frozen=True, repr=False)
class RaceResult(TabularResult):
    """A race between configurations; see `desim.race`."""

    name: str
    metric: str
    unit: str
    """The unit of the metric."""
    maximise: bool
    """Whether the greatest mean is the best."""
    zone: float
    """The indifference zone, in the unit of the metric."""
    confidence: float
    first: int
    """The number of first runs of each configuration."""
    settings: tuple[Mapping[str, Any], ...]
    """The settings of each configuration, in the order of the grid."""
    selection: Selection
    """What the procedure decided; a system is the position of a configuration in `settings`."""
    common: bool
    """Whether run k of every configuration had the same seed."""
    is_of_truths: bool = False
    """Whether the metric is true or false in each run, so that its means are shares."""

    @property
    def best(self) -> Mapping[str, Any]:
        """The settings of the configuration with the best mean."""
        return self.settings[self.selection.selected]

    @property
    def is_decided(self) -> bool:
        """Whether the guarantee holds: False if the largest number of runs was reached."""
        return self.selection.is_decided

    @property
    def runs(self) -> int:
        """The number of runs that the race took, of all configurations together."""
        return self.selection.total

    @property
    def plain_runs(self) -> int:
        """The number of runs of a two-stage design with the same seeds and guarantee; see `two_stage_runs`."""
        return two_stage_runs(self.selection.variances, self.first, self.confidence, self.zone)

    @property
    def independent_runs(self) -> int:
        """The number of runs of the same two-stage design if each run had a seed of its own."""
        variances = independent_variances(self.selection.samples, self.first)
        return two_stage_runs(variances, self.first, self.confidence, self.zone)

    @property
    def order(self) -> list[int]:
        """The positions of the configurations: the best, the others that were left, the dropped ones from the last on.

        Configurations that were left, or dropped after equally many runs, are in the order of their means.
        """
        means = [float(numbers.mean()) * (-1.0 if self.maximise else 1.0) for numbers in self.selection.samples]
        best = self.selection.selected
        left = sorted((system for system in self.selection.left if system != best), key=means.__getitem__)
        dropped = sorted(self.selection.dropped, key=lambda loser: (-loser.after, means[loser.system]))
        return [best, *left, *(loser.system for loser in dropped)]

    def mean_of(self, system: int) -> Estimate:
        """Return the mean of the metric over the runs of a configuration, or the share in which it is true."""
        return (share if self.is_of_truths else mean)(self.selection.samples[system])

    def behind(self, system: int) -> Estimate:
        """Return the mean difference of a configuration from the best, over the runs that both have."""
        samples: tuple[Floats, ...] = self.selection.samples
        count = min(len(samples[system]), len(samples[self.selection.selected]))
        return paired(samples[system][:count], samples[self.selection.selected][:count])

    def sentences(self) -> list[str]:
        """Return the result of the race, its guarantee, and its cost."""
        best, side = in_words(self.best), "greatest" if self.maximise else "least"
        amount = f"{self.zone:g} {self.unit}".rstrip()
        count = len(self.settings)
        if len({self.mean_of(system).mean for system in self.selection.left}) == 1 < len(self.selection.left):
            tied = " and ".join(in_words(self.settings[system]) for system in self.order[: len(self.selection.left)])
            runs_of_each = len(self.selection.samples[self.selection.selected])
            verdict = f"{words(self.metric)}: the means of {tied} are equal in {counted(runs_of_each, 'run')}"
        else:
            verdict = f"{best} has the {side} {words(self.metric)} of {count} configurations"
        if self.is_decided:
            guarantee = (
                f"the best of {count} is found with a probability of at least {self.confidence:g} if it is better than"
                f" every other by {amount} or more; of closer ones any may be selected (Kim & Nelson 2001, for normal"
                " values)"
            )
        else:
            left = len(self.selection.left)
            longest = max(map(len, self.selection.samples))
            variances = self.selection.variances
            is_unknown = any(not variances[pair] for pair in combinations(self.selection.left, 2))
            needed = " some of them differ by the same in all runs, and at least" if is_unknown else " at most"
            guarantee = (
                f"not decided: {left} of {count} were left after {counted(longest, 'run')} of each;{needed}"
                f" {self.selection.most:,} of each would decide"
            )
        runs = f"{counted(self.runs, 'run')}; a two-stage design with the same guarantee, which drops none, takes"
        if not self.common:
            return [verdict, guarantee, f"{runs} {self.plain_runs:,} (Clark & Yang 1986)"]
        seeds = f"{self.plain_runs:,} with the same seeds, and {self.independent_runs:,} if each run has its own"
        return [verdict, guarantee, f"{runs} {seeds} (Clark & Yang 1986)"]

    _notes = sentences  # `TabularResult` shows them below the tables

    def tables(self) -> list[Table]:
        """Return the table as its title and rows of text; the first row is the header."""
        keys = list(self.settings[0])
        winners = {dropped.system: dropped.against for dropped in self.selection.dropped}
        means, differences = [self.mean_of(k) for k in self.order], [self.behind(k) for k in self.order[1:]]
        title = with_unit(words(self.metric), self.unit)
        rows = [("", *keys, title, "difference from the best", "runs", "dropped against")]
        for rank, system in enumerate(self.order):
            count = len(self.selection.samples[system])
            behind = (
                "" if not rank else with_half_width(differences[rank - 1], count, "+", digits=digits_of(differences))
            )
            against = in_words(self.settings[winners[system]]) if system in winners else ""
            place = str(rank + 1) if system == self.selection.selected or system in winners else "left"
            cells = (with_half_width(means[rank], count, digits=digits_of(means)), behind, str(count), against)
            rows.append((place, *map(text, self.settings[system].values()), *cells))
        seeds = "the same seeds" if self.common else "independent seeds"
        has_interval = self.is_of_truths and any(estimate.others is None for estimate in means)
        shares = ", in brackets a Wilson interval" * has_interval
        head = (
            f"{self.name}: a race of {len(self.settings)} configurations, {seeds}; +- is half a 95 % t interval{shares}"
        )
        return [(head, rows)]

    def _right_from(self) -> int:
        return 1 + len(self.settings[0])

    @naming_extras()
    def plot(self, *, size: str | None = None, style: "Style" = None, ax: "Axes | None" = None) -> "Figure":
        """Return the running means of all configurations, and how many are left; needs matplotlib (the extra `plot`).

        Args:
            size: the width and perhaps the height, such as "8.5cm"; such a figure has no title.
            style: a style of matplotlib on top of that of desim.
            ax: the axes to draw the running means on, for a figure of several; None = a figure of its own.
        """
        from desim.study.selection.race_figure import draw_race

        names = [in_words(self.settings[system]) for system in self.order]
        return draw_race(
            self.selection,
            self.order,
            names,
            title=self.name,
            metric=self.metric,
            unit=self.unit,
            first=self.first,
            size=size,
            style=style,
            ax=ax,
        )

    def document(self) -> dict[str, Any]:
        """Return the race as JSON-compatible values; None where undefined."""
        losers = {dropped.system: dropped for dropped in self.selection.dropped}
        return {
            "name": self.name,
            "metric": self.metric,
            "unit": self.unit,
            "best": self._json_settings(self.selection.selected),
            "is_decided": self.is_decided,
            "maximise": self.maximise,
            "zone": self.zone,
            "confidence": self.confidence,
            "first": self.first,
            "runs": self.runs,
            "most_runs_of_each": self.selection.most,
            "two_stage_runs": self.plain_runs,
            "two_stage_runs_with_independent_seeds": self.independent_runs,
            "sentences": self.sentences(),
            "configurations": [
                {
                    "settings": self._json_settings(system),
                    "mean": as_json(self.mean_of(system)),
                    "behind": as_json(self.behind(system)),
                    "dropped_after": losers[system].after if system in losers else None,
                    "dropped_against": self._json_settings(losers[system].against) if system in losers else None,
                }
                for system in self.order
            ],
        }

    def _json_settings(self, system: int) -> dict[str, Any]:
        """Return the settings of a configuration as JSON-compatible values, given its position."""
        return {key: json_number(value) for key, value in self.settings[system].items()}

    def __repr__(self) -> str:
        return f"<RaceResult of {self.name}: {in_words(self.best)} of {counted(len(self.settings), 'configuration')}>"

"""Two sweeps side by side: the difference of each metric for each configuration that both have."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from desim.analysis.measuring import check_numeric
from desim.analysis.metrics import title, unit_of, words
from desim.analysis.statistics import Estimate, Share, independent, paired
from desim.analysis.table_formats import Table, TabularResult
from desim.analysis.tables import as_json, digits_of, with_half_width
from desim.config.json_numbers import json_number
from desim.config.number_texts import counted
from desim.study.plan.configurations import in_words, label
from desim.study.results.runs import SHOWN, Group, SweepRuns, names_of_metrics, text


@dataclass(frozen=True)
class MetricDifference:
    """One metric in one configuration of two sweeps."""

    first: Estimate
    """The mean in the first sweep."""
    second: Estimate
    """The mean in the second sweep."""
    difference: Estimate
    """The second minus the first: over pairs of runs with equal seeds, or between independent runs."""

    @property
    def estimates(self) -> tuple[Estimate, Estimate, Estimate]:
        """The two means and their difference."""
        return self.first, self.second, self.difference


@dataclass(frozen=True)
class Compared:
    """A configuration that two sweeps have."""

    settings: Mapping[str, Any]
    pairs: int
    """The number of seeds that both sweeps have; 0 if they share fewer than two: the runs are then independent."""
    runs: tuple[int, int]
    """The number of runs of each sweep that have ended."""
    metrics: Mapping[str, MetricDifference]

    @property
    def counts(self) -> tuple[int, int, int]:
        """The numbers of runs of the first mean, the second mean and the difference, if no run lacks a value.

        With pairs, all three are the number of pairs. A table shows the number of runs only where it differs.
        """
        return (self.pairs,) * 3 if self.pairs else (*self.runs, min(self.runs))


@dataclass(frozen=True, repr=False)
class Comparison(TabularResult):
    """Two sweeps side by side; see `desim.compare`."""

    names: tuple[str, str]
    """The names of the two sweeps, first and second."""
    keys: tuple[str, ...]
    """The keys of the grid that tell the configurations apart."""
    configurations: tuple[Compared, ...]
    unmatched: tuple[int, int]
    """The numbers of configurations that only the first sweep has, and that only the second has."""
    units: Mapping[str, str]
    """The unit of each metric that is not built in."""
    changes: Mapping[str, tuple[str, str]]
    """The two values, as text, of each key that has one value in the first sweep and another one in the second."""

    @classmethod
    def of(
        cls,
        first: SweepRuns,
        second: SweepRuns,
        metrics: Sequence[str] = SHOWN,
        names: tuple[str, str] = ("A", "B"),
        changes: Mapping[str, tuple[str, str]] | None = None,
    ) -> Self:
        """Compare two sweeps.

        Args:
            first: a sweep.
            second: another sweep.
            metrics: the names of the metrics.
            names: the names of the two sweeps.
            changes: further keys in which the scenarios of the two sweeps differ, with both values.

        Raises:
            ValueError: if a sweep has no numeric metric of a name, or the two have no configuration in common.
        """
        metrics = names_of_metrics(metrics)
        for sweep in (first, second):
            for metric in metrics:
                check_numeric(metric, sweep.units)
        keys, fixed = _common_keys(first, second)
        groups_of_second = {_texts_of(group, keys): group for group in second.groups}
        pairs = [(group, groups_of_second.get(_texts_of(group, keys))) for group in first.groups]
        compared = tuple(_compared(group, other, keys, metrics) for group, other in pairs if other is not None)
        if not compared:
            raise ValueError(
                f"no configuration is in both sweeps: {names[0]} has {first.groups[0].in_words()}, ..., {names[1]} has"
                f" {second.groups[0].in_words()}, ..."
            )
        unmatched = len(first.groups) - len(compared), len(second.groups) - len(compared)
        units = {**first.units, **second.units}
        return cls(names, keys, compared, unmatched, units, {**(changes or {}), **fixed})

    @property
    def metrics(self) -> tuple[str, ...]:
        """The names of the metrics."""
        return tuple(self.configurations[0].metrics)

    def sentences(self) -> list[str]:
        """Return a sentence for each metric: where the two sweeps differ, and the greatest difference.

        A difference counts if a t test excludes 0 at a level of 5 % for all differences of the table together
        (Bonferroni). The interval in the table is that of one difference alone.
        """
        return [self._sentence(metric) for metric in self.metrics]

    def _sentence(self, metric: str) -> str:
        first, second = self.names
        differences = [(compared, compared.metrics[metric].difference) for compared in self.configurations]
        testable = [(compared, estimate) for compared, estimate in differences if estimate.count > 1]
        if not testable:
            return f"{words(metric)}: no configuration has two runs of both to compare"
        count = len(self.configurations) * len(self.metrics)
        at_once = f" at a level of 5 % for all {count} comparisons together (Bonferroni)" if count > 1 else ""
        significant = [pair for pair in testable if pair[1].excludes_0(1.0 - 0.05 / count)]
        compared, estimate = max(significant or testable, key=lambda pair: abs(pair[1].mean))
        unit = unit_of(metric, self.units)
        out_of = f" of {compared.pairs}" if estimate.count < compared.pairs else ""
        runs = f"{estimate.count}{out_of} pairs of runs with the same seed" if compared.pairs else "independent runs"
        alone = " of it alone" * (count > 1)
        size = f"{with_half_width(estimate, estimate.count, '+', unit)} (95 % interval{alone}, {runs})"
        where = f", for {in_words(compared.settings)}" if compared.settings else ""
        if not significant:
            return f"{words(metric)}: no difference is distinguishable from 0{at_once}; the greatest is {size}{where}"
        less = all(estimate.mean < 0.0 for _, estimate in significant)
        more = all(estimate.mean > 0.0 for _, estimate in significant)
        relation = "is less than" if less else "is greater than" if more else "differs from"
        share = f" in {len(significant)} of {counted(len(self.configurations), 'configuration')}" if where else ""
        return f"{words(metric)}: {second} {relation} {first}{share}{at_once}; the greatest difference is {size}{where}"

    def notes(self) -> Iterator[str]:
        """Yield the sentences, and what the two sweeps do not share."""
        yield from self.sentences()
        first, second = self.names
        for key, (old, new) in self.changes.items():
            yield f"{key}: {old} in {first}, {new} in {second}"
        if not any(compared.pairs for compared in self.configurations):
            yield "fewer than two seeds in common: the runs are compared as independent ones (Welch's t interval)"
        for name, count in zip(self.names, self.unmatched, strict=True):
            if count:
                yield f"{counted(count, 'configuration')} of {name} left out: the other sweep does not have it"

    _notes = notes  # `TabularResult` shows them below the tables

    def tables(self) -> list[Table]:
        """Return the table as its title and rows of text; the first row is the header."""
        first, second = self.names
        is_paired = any(compared.pairs for compared in self.configurations)
        how = "run by run with the same seed" if is_paired else "independent runs"
        metrics = [metric for compared in self.configurations for metric in compared.metrics.values()]
        shares = ", in brackets a Wilson interval" * any(isinstance(metric.first, Share) for metric in metrics)
        some_lack = any(
            estimate.count not in {0, usual_count}
            for compared in self.configurations
            for cell in compared.metrics.values()
            for estimate, usual_count in zip(cell.estimates, compared.counts, strict=True)
        )
        lacks = "; (n): over n runs, and so perhaps other seeds" if some_lack else ""
        heading = f"A: {first}; B: {second}; B - A: {how}; +- is half a 95 % t interval{shares}{lacks}"
        heads = [f"{title(metric, self.units)}: {part}" for metric in self.metrics for part in ("A", "B", "B - A")]
        rows: list[tuple[str, ...]] = [(*self.keys, "pairs", *heads)]
        columns: list[list[str]] = []
        for metric in self.metrics:
            cells = [compared.metrics[metric].estimates for compared in self.configurations]
            digits = digits_of([estimate for estimates in cells for estimate in estimates])
            columns += [
                [
                    with_half_width(estimates[k], compared.counts[k], sign, digits=digits)
                    for estimates, compared in zip(cells, self.configurations, strict=True)
                ]
                for k, sign in enumerate(("", "", "+"))
            ]
        for compared, *texts in zip(self.configurations, *columns, strict=True):
            rows.append((*map(text, compared.settings.values()), str(compared.pairs or "-"), *texts))
        return [(heading, rows)]

    def _right_from(self) -> int:
        return len(self.keys)

    def document(self) -> dict[str, Any]:
        """Return the comparison as JSON-compatible values; None where undefined."""
        return {
            "names": list(self.names),
            "changes": {key: list(values) for key, values in self.changes.items()},
            "unmatched": list(self.unmatched),
            "units": {metric: unit_of(metric, self.units) for metric in self.metrics},
            "sentences": self.sentences(),
            "configurations": [
                {
                    "settings": {key: json_number(value) for key, value in compared.settings.items()},
                    "pairs": compared.pairs,
                    "runs": list(compared.runs),
                    "metrics": {
                        name: {
                            "first": as_json(cell.first),
                            "second": as_json(cell.second),
                            "difference": as_json(cell.difference),
                        }
                        for name, cell in compared.metrics.items()
                    },
                }
                for compared in self.configurations
            ],
        }

    def __repr__(self) -> str:
        first, second = self.names
        return f"<Comparison of {first} and {second}: {counted(len(self.configurations), 'configuration')}>"


def _common_keys(first: SweepRuns, second: SweepRuns) -> tuple[tuple[str, ...], dict[str, tuple[str, str]]]:
    """Return the keys by which configurations are matched, and the two values of each key that differs between sweeps.

    Raises:
        ValueError: if one sweep varies a key that the other does not have.
    """
    for sweep, other, name in ((first, second, "first"), (second, first, "second")):
        for key in sweep.keys:
            if key not in other.keys and len(sweep.values(key)) > 1:
                raise ValueError(
                    f"the {name} sweep varies {key}, and the other one does not have it in its grid: compare it within"
                    " the sweep, with `plot --against` or SweepResult.differences"
                )
    keys, fixed = [], {}
    for key in first.keys:
        if key not in second.keys:
            continue
        old, new = ([label(value) for value in sweep.values(key)] for sweep in (first, second))
        if len(old) == len(new) == 1 and old != new:
            fixed[key] = old[0], new[0]
        else:
            keys.append(key)
    return tuple(keys), fixed


def _texts_of(group: Group, keys: Sequence[str]) -> tuple[str, ...]:
    """Return the values of some keys as texts; 0.1 + 0.2 and 0.3 have the same text."""
    return tuple(label(group.settings[key]) for key in keys)


def _compared(first: Group, second: Group, keys: Sequence[str], metrics: Sequence[str]) -> Compared:
    """Return a configuration of two sweeps: paired by seed if they share two seeds, else as independent runs."""
    shared = sorted(set(first.seeds) & set(second.seeds))
    is_paired = len(shared) > 1
    differences = {}
    for metric in metrics:
        if is_paired:
            of_second, of_first = (group.by_seed(metric) for group in (second, first))
            difference = paired([of_second[seed] for seed in shared], [of_first[seed] for seed in shared])
        else:
            difference = independent(second.present(metric), first.present(metric))
        differences[metric] = MetricDifference(first.estimate(metric), second.estimate(metric), difference)
    pairs, runs = len(shared) if is_paired else 0, (len(first.seeds), len(second.seeds))
    return Compared({key: first.settings[key] for key in keys}, pairs, runs, differences)

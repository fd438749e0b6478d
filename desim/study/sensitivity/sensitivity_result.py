"""The result of a sensitivity analysis: what decides a metric, as sentences, tables, a figure and JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from typing import TYPE_CHECKING, Any

from desim.analysis.metrics import with_unit, words
from desim.analysis.table_formats import Table, TabularResult
from desim.analysis.tables import percent
from desim.config.extras import naming_extras
from desim.config.json_numbers import json_number
from desim.config.number_texts import counted
from desim.study.sensitivity.morris import ElementaryEffects
from desim.study.sensitivity.sobol_indices import IndexEstimate, SobolIndices

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Figure, Style

DECIDES = 0.05
"""The total index from which on the result says that a key decides."""


@dataclass(frozen=True, repr=False)
class SensitivityResult(TabularResult):
    """How much of the variation of a metric each key causes; see `desim.sensitivity`."""

    name: str
    metric: str
    unit: str
    """The unit of the metric."""
    ranges: Mapping[str, str]
    """The range of each key, or its values, as text."""
    runs_at_point: int
    """The number of runs at each point."""
    runs: int
    """The number of runs at all points. A point that occurs several times is run once, and counts each time."""
    effects: ElementaryEffects | None
    """The effects of all keys; None without screening."""
    kept: tuple[int, ...]
    """The positions in `ranges` of the keys that have indices; the others were screened out."""
    indices: SobolIndices | None
    """The indices of the kept keys, in the order of `kept`; None if there are none."""

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys, in the order of the grid."""
        return tuple(self.ranges)

    @property
    def total(self) -> dict[str, IndexEstimate]:
        """The total index of each key that has one."""
        return {} if self.indices is None else self._by_key(self.indices.total)

    @property
    def first(self) -> dict[str, IndexEstimate]:
        """The first-order index of each key that has one."""
        return {} if self.indices is None else self._by_key(self.indices.first)

    def _by_key(self, indices: Sequence[IndexEstimate]) -> dict[str, IndexEstimate]:
        return {self.keys[k]: index for k, index in zip(self.kept, indices, strict=True)}

    @property
    def chance(self) -> float:
        """The share of chance in the variance of a run at a random point; nan without indices or with one run each."""
        if self.indices is None or isnan(self.indices.variance_of_chance):
            return float("nan")
        variance = max(self.indices.variance, 0.0) + self.indices.variance_of_chance
        return self.indices.variance_of_chance / variance if variance else float("nan")

    def sentences(self) -> list[str]:
        """Return what decides, what does not, how much is interaction, and how much is chance."""
        sentences = [self._what_decides()] if self.indices is not None else [self._what_changes()]
        screened_out = [key for k, key in enumerate(self.keys) if k not in self.kept]
        if screened_out and self.effects is not None and self.kept:
            sentences.append(
                f"screened out, with an effect below a tenth of the greatest: {', '.join(screened_out)}"
                + ("; each keeps the middle of its range" if self.indices is not None else "")
            )
        if self.indices is not None and self.indices.is_varied:
            alone = self.indices.alone
            share, low, high = (round(100 * value) for value in (alone.value, alone.low, alone.high))
            is_rest = alone.high < 1.0
            rest = "the rest is interaction among them" if is_rest else "no interaction among them is told apart from 0"
            sentences.append(f"alone the keys cause {share} % ({low} to {high} %); {rest}")
        if self.effects is not None:
            told_apart = {key for key, total in self.total.items() if total.low > 0.0}  # indices do not count chance
            within = [k for k in self.effects.within_chance() if k in self.kept and self.keys[k] not in told_apart]
            if listed := [f"{self.keys[k]} ({self._effect(self.effects.of_chance[k])})" for k in within]:
                sentences.append(f"effects not told apart from what chance alone makes: {_joined(listed)}")
        if self.runs_at_point == 1:
            sentences.append("one run at each point: chance counts as an effect of the keys; take several")
        elif not isnan(self.chance):
            in_percent = percent(self.chance, 0).replace("%", " %")
            sentences.append(f"of the variance of a single run {in_percent} is chance, which the indices do not count")
        return sentences

    _notes = sentences  # `TabularResult` shows them below the tables

    def _what_decides(self) -> str:
        metric, indices = words(self.metric), self.indices
        if indices is None or not indices.is_varied:
            return (
                f"{metric}: over the ranges its mean varies no more than chance explains, so no key is said to decide;"
                " take more runs at each point, or wider ranges"
            )
        order = sorted(self.total, key=lambda key: -self.total[key].value)
        deciding = [key for key in order if self.total[key].value >= DECIDES and self.total[key].low > 0.0]
        # By chance, all of an interval may be below 0.
        not_told_apart = [key for key in order if self.total[key].low <= 0.0]
        listed = [f"{key} ({_in_percent(self.total[key])})" for key in deciding]
        text = f"{metric} is decided by {_joined(listed)}" if listed else f"{metric}: no key is told apart from chance"
        return f"{text}; not told apart from 0: {', '.join(not_told_apart)}" if not_told_apart else text

    def _what_changes(self) -> str:
        metric = words(self.metric)
        if self.effects is None or not self.kept:
            return f"{metric} is the same at all points: no key has an effect"
        sizes = self.effects.mean_absolute
        order = sorted(self.kept, key=lambda k: -sizes[k].value)
        listed = [f"{self.keys[k]} ({self._effect(sizes[k].value)} over its range)" for k in order]
        return f"{metric} changes most with {_joined(listed)}"

    def _effect(self, size: float) -> str:
        return f"{size:.3g} {self.unit}".rstrip()

    def tables(self) -> list[Table]:
        """Return the table as its title and rows of text; the first row is the header."""
        head = ["key", "range"]
        head += [with_unit("effect", self.unit), "spread"] if self.effects is not None else []
        head += ["first-order index", "total index"] if self.indices is not None else []
        rows = [tuple(head)]
        for k, (key, values) in enumerate(self.ranges.items()):
            cells = [key, values]
            if self.effects is not None:
                cells += [_with_interval(self.effects.mean_absolute[k]), f"{self.effects.deviation[k]:.3g}"]
            if self.indices is not None:
                has_index = k in self.kept
                cells += [_with_interval(self.first[key]), _with_interval(self.total[key])] if has_index else ["-", "-"]
            rows.append(tuple(cells))
        title = (
            f"{self.name}: what decides {words(self.metric)}; {counted(self.runs_at_point, 'run')} with the same seeds"
            " at each point; in brackets 95 % bootstrap intervals"
        )
        return [(title, rows)]

    def _right_from(self) -> int:
        return 2

    @naming_extras()
    def plot(self, *, size: str | None = None, style: "Style" = None) -> "Figure":
        """Return bars of effects and of indices with intervals; needs matplotlib (the extra `plot`).

        Args:
            size: the width and perhaps the height, such as "16cm"; such a figure has no title.
            style: a style of matplotlib on top of that of desim.
        """
        from desim.study.sensitivity.sensitivity_figure import draw_sensitivity

        return draw_sensitivity(
            self.keys,
            self.effects,
            self.indices,
            self.kept,
            title=self.name,
            metric=self.metric,
            unit=self.unit,
            size=size,
            style=style,
        )

    def document(self) -> dict[str, Any]:
        """Return the analysis as JSON-compatible values; None where undefined."""
        keys = []
        for k, (key, values) in enumerate(self.ranges.items()):
            entry: dict[str, Any] = {"key": key, "range": values, "screened_out": k not in self.kept}
            if self.effects is not None:
                entry |= {"effect": _as_json(self.effects.mean_absolute[k]), "mean_effect": self.effects.mean[k]}
                entry |= {"spread": self.effects.deviation[k]}
                entry |= {"effect_of_chance": self.effects.of_chance[k]} if self.effects.of_chance else {}
            if key in self.total:
                entry |= {"first": _as_json(self.first[key]), "total": _as_json(self.total[key])}
            keys.append(entry)
        return {
            "name": self.name,
            "metric": self.metric,
            "unit": self.unit,
            "runs": self.runs,
            "runs_at_point": self.runs_at_point,
            "variance": None if self.indices is None else json_number(self.indices.variance),
            "chance": json_number(self.chance),
            "alone": None if self.indices is None else _as_json(self.indices.alone),
            "sentences": self.sentences(),
            "keys": keys,
        }

    def __repr__(self) -> str:
        return f"<SensitivityResult of {self.name}: {words(self.metric)} over {counted(len(self.keys), 'key')}>"


def _joined(texts: list[str]) -> str:
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def _with_interval(estimate: IndexEstimate) -> str:
    if isnan(estimate.value):
        return "-"
    return f"{estimate.value:.3g} ({estimate.low:.3g} .. {estimate.high:.3g})"


def _in_percent(estimate: IndexEstimate) -> str:
    return f"{100 * estimate.value:.0f} % of its variance, {100 * estimate.low:.0f} to {100 * estimate.high:.0f} %"


def _as_json(estimate: IndexEstimate) -> dict[str, Any]:
    return {"value": json_number(estimate.value), "interval": [json_number(estimate.low), json_number(estimate.high)]}

"""The cost of the imperfections of a scenario in one metric."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self

from desim.analysis.statistics import Estimate, mean, mean_or_share
from desim.analysis.tables import as_json, digits_of, from_json, with_half_width

NOTHING = 1e-9
"""The largest difference that is attributed to rounding."""
INTERACTION_RISK = 0.01
"""The largest probability that an interaction is declared in one metric or more although there is none.

By Bonferroni's inequality, this bound holds if each of m metrics is judged by an interval with confidence 1 - 0.01 / m
and the differences are normal. For skewed differences the probability is greater. For example, for exponential
differences in two metrics it is 1.9 % (s.e. 0.1 %) with 100 runs, and 3.7 % with 30. The 95 % intervals of tables are
too narrow: by them, an interaction would be declared in one of 20 metrics that have none.
"""
AS_IT_IS, IDEAL = "as it is", "ideal"
PERFECT, SILENT = "perfect network", "no messages at all"
"""The bounds of what a network can do: every message arrives at once, or none ever arrives; all else is equal."""


@dataclass(frozen=True)
class Saving:
    """The decrease of a metric when imperfections are removed: the mean difference of runs paired by seed."""

    mean: Estimate
    differing: int
    """The number of pairs that differ."""

    @classmethod
    def of(cls, differences: list[float]) -> Self:
        """Return the saving, given the difference of each pair of runs; differences within `NOTHING` are equal."""
        differing = sum(abs(difference) > NOTHING for difference in differences)
        if differences and max(differences) - min(differences) <= NOTHING:
            differences = [mean(differences).mean] * len(differences)  # rounding is not a scatter of the saving
        return cls(mean(differences), differing)

    def excludes_0(self, confidence: float = 0.95) -> bool:
        """Return whether a test with a given confidence excludes 0, that is, whether the saving is significant.

        A true saving as large as the half width of the interval is detected in half of all studies with as many runs, a
        much smaller one rarely.
        """
        return abs(self.mean.mean) > NOTHING and self.mean.excludes_0(confidence)

    def text(self, runs: int, digits: int | None = None) -> str:
        """Return the saving as the text of a table cell with `digits` decimals; None: as many as its interval needs."""
        is_0 = self.mean.count and not self.differing
        return "0 in every run" if is_0 else with_half_width(self.mean, runs, "+", digits=digits)

    def document(self) -> dict[str, Any]:
        """Return the saving as JSON-compatible values."""
        return as_json(self.mean) | {"differing": self.differing, "excludes_0": self.excludes_0()}


@dataclass(frozen=True)
class Bounds:
    """A metric between the bounds of a network: every message arrives at once, or none ever arrives."""

    perfect: Estimate
    silent: Estimate
    difference: Saving
    """The metric without messages minus the metric with a perfect network, of runs paired by seed."""

    @classmethod
    def of(cls, perfect: list[float], silent: list[float]) -> Self:
        """Return the bounds, given the metric in each run of both, paired by seed."""
        differences = [float(without) - float(with_all) for without, with_all in zip(silent, perfect, strict=True)]
        return cls(mean_or_share(perfect), mean_or_share(silent), Saving.of(differences))

    def document(self) -> dict[str, Any]:
        """Return the bounds as JSON-compatible values."""
        return {
            "perfect_network": as_json(self.perfect),
            "no_messages": as_json(self.silent),
            "difference": self.difference.document(),
        }


@dataclass(frozen=True)
class Cost:
    """The cost of the imperfections of a scenario in one metric."""

    label: str
    """The label of the metric in tables and figures."""
    unit: str
    as_it_is: Estimate
    ideal: Estimate
    """The metric in the scenario without any imperfection."""
    parts: Mapping[str, Saving]
    """For each imperfection of the scenario: the metric with all imperfections minus the metric without this one."""
    together: Saving
    """The metric with all imperfections minus the metric without any."""
    interaction: Saving
    """`together` minus the sum of the parts."""
    more_is: Literal["better", "worse"] | None = None
    """Whether more of the metric is better or worse, and so a positive cost; None if unknown."""
    confidence: float = 1.0 - INTERACTION_RISK
    """The confidence of the interval by which an interaction is judged; see `INTERACTION_RISK`."""
    bounds: Bounds | None = None
    """The metric between the bounds of the network; None if they were not run."""

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Self:
        """Return the cost that a part of a document describes; see `Explanation.document`."""

        def saving(part: Mapping[str, Any]) -> Saving:
            return Saving(from_json(part), int(part["differing"]))

        def bounds_of(part: Mapping[str, Any]) -> Bounds:
            return Bounds(
                from_json(part["perfect_network"]), from_json(part["no_messages"]), saving(part["difference"])
            )

        return cls(
            str(document["label"]),
            str(document["unit"]),
            from_json(document["as_it_is"]),
            from_json(document["ideal"]),
            {str(name): saving(part) for name, part in document["parts"].items()},
            saving(document["together"]),
            saving(document["interaction"]),
            document["more_is"],
            float(document["confidence"]),
            None if (bounds := document.get("bounds")) is None else bounds_of(bounds),
        )

    @property
    def digits(self) -> int:
        """The number of decimals of the cost in a table."""
        savings = (*self.parts.values(), self.together, self.interaction)
        bounds = [] if self.bounds is None else [self.bounds.perfect, self.bounds.silent, self.bounds.difference.mean]
        return digits_of([self.as_it_is, self.ideal, *(saving.mean for saving in savings), *bounds])

    @property
    def interacts(self) -> bool:
        """Whether the parts do not add up to `together`: the Bonferroni interval of the interaction excludes 0."""
        return self.interaction.excludes_0(self.confidence)

    @property
    def undetected(self) -> dict[str, float]:
        """The parts that differ from 0 in some run but are not significant, each with the half width of its t interval.

        This half width is the size of an effect that half of all studies with as many runs would find.
        """
        return {
            name: part.mean.half_width for name, part in self.parts.items() if part.differing and not part.excludes_0()
        }

    @property
    def unchanging(self) -> tuple[str, ...]:
        """The parts that are 0 in every run."""
        return tuple(name for name, part in self.parts.items() if part.mean.count and not part.differing)

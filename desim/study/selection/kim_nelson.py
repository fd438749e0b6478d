"""Which of k systems has the greatest mean: a fully sequential procedure.

It is procedure KN of Kim & Nelson 2001, "A Fully Sequential Procedure for Indifference-Zone Selection in Simulation",
section 3.

After `first` samples of each system, one more of each that is left is taken at a time. A system is dropped as soon as
its mean is below that of another by more than W(r) = max(0, zone / (2 r) (h^2 S^2 / zone^2 - r)), where S^2 is the
variance of the differences of the two in the first samples. The constant c of the paper is 1, its recommendation.

If samples are normal, and independent from one replication to the next, and the best mean is better than every other by
at least `zone`, the best is selected with a probability of at least `confidence`. Samples of one replication may depend
on each other: with common random numbers their differences have smaller variances, and the procedure ends earlier. If
means are closer than `zone`, any of the close ones may be selected, with about the same effort.

Two systems may differ by the same in all first samples, so that S^2 is 0: those of a rule that hardly matters, or truth
values, such as whether there is a capture. Their variance is then not known. They are not compared before a sample in
which they differ otherwise, and S^2 is then that of all samples up to it; after `ENOUGH` samples it is 0. How often
the best is selected of values that are not normal is in docs/explanation/validation.md.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import ceil, floor, inf, isfinite
from typing import NamedTuple

import numpy as np

from desim.analysis.looks import OTHERS
from desim.analysis.statistics import NORMAL_975, paired
from desim.config.arrays import Floats
from desim.config.errors import ArgumentError
from desim.config.python_numbers import real, whole

ENOUGH = ceil(NORMAL_975**2 * (1.0 - OTHERS) / OTHERS)
"""The number of samples after which two systems that differ by the same in all of them have a variance of 0: 73.

By Wilson's interval, at most a share `OTHERS` of all samples then differs otherwise, as in a sequential study.
"""
Sample = Callable[[Sequence[int], int], Sequence[float]]
"""Returns a sample of each of some systems, given their numbers and the number of the replication, from 0 on."""


class Dropped(NamedTuple):
    """When a system was dropped, and which one it lost against."""

    system: int
    after: int
    """The number of samples of each system at that time."""
    against: int
    """The system that it was compared with."""


@dataclass(frozen=True)
class Selection:
    """The result of the procedure."""

    selected: int
    """The system with the best mean among those that were left."""
    left: tuple[int, ...]
    """The systems that were left at the end: only `selected`, unless the means decided at the last sample, or the
    number of samples was limited."""
    dropped: tuple[Dropped, ...]
    """The others, in the order in which they were dropped."""
    is_decided: bool
    """Whether the guarantee holds; False if the largest number of samples was reached."""
    samples: tuple[Floats, ...]
    """The samples of each system, as many as were taken."""
    most: int
    """The number of samples of a system after which the procedure would have ended in any case."""
    variances: Floats
    """The (k, k) variances of the differences in the first samples."""

    @property
    def total(self) -> int:
        """The number of samples of all systems."""
        return sum(len(numbers) for numbers in self.samples)


def check_confidence(confidence: float, systems: int) -> float:
    """Return the probability of a correct selection as a `float`.

    Raises:
        ValueError: if it is not between 1/k, which a guess has, and 1.
    """
    confidence = real(confidence, "confidence")
    if not 1.0 / systems < confidence < 1.0:
        least = f"1/{systems}, which a guess among {systems} has,"
        raise ArgumentError("confidence", f"should be between {least} and 1 (got {confidence:g})")
    return confidence


def check_zone(zone: float, unit: str = "") -> float:
    """Return the indifference zone as a `float`.

    Raises:
        ValueError: if it is not a positive number.
    """
    zone = real(zone, "zone")
    if not 0.0 < zone < inf:
        meaning = f"the smallest difference of means that matters{f', {unit}' if unit else ''}"
        raise ArgumentError("zone", f"should be positive and finite: it is {meaning} (got {zone:g})")
    return zone


def check_first(first: int, most: int | None = None) -> int:
    """Return the number of first samples of a system.

    Raises:
        ValueError: if it is less than 2, or more than the largest number of samples.
    """
    if (first := whole(first, "first")) < 2:
        raise ArgumentError("first", f"should be at least 2, to estimate a variance (got {first})")
    if most is not None and most < first:
        raise ArgumentError("most", f"should be at least `first`, {first} (got {most})")
    return first


def constants(systems: int, first: int, confidence: float) -> tuple[float, float]:
    """Return the constants eta and h^2 = 2 eta (first - 1) of the procedure."""
    error = 2.0 * (1.0 - confidence) / (systems - 1)
    eta = 0.5 * (error ** (-2.0 / (first - 1)) - 1.0)
    return eta, 2.0 * eta * (first - 1)


def kim_nelson(
    sample: Sample,
    systems: int,
    *,
    zone: float,
    confidence: float = 0.95,
    first: int = 20,
    maximise: bool = True,
    most: int | None = None,
) -> Selection:
    """Select the system with the best mean; see the module.

    Args:
        sample: returns samples. It is called with all systems for replications 0 .. first - 1, and then with those that
            are left, one replication after the other.
        systems: the number of systems, k.
        zone: the indifference zone, the smallest difference of means that matters, in the unit of the samples.
        confidence: the probability of a correct selection, in (1/k, 1).
        first: the number of first samples, from which variances are estimated; at least 2; if in doubt, 20: few make
            the procedure cautious, and many are too many for systems that are far behind.
        maximise: whether the greatest mean is the best, instead of the least.
        most: the largest number of samples of a system; None = as many as the guarantee needs.

    Raises:
        ValueError: if there are fewer than two systems, a number is out of its range, or a sample is not finite.
    """
    if (systems := whole(systems, "systems")) < 2:
        raise ValueError(f"a selection needs at least two systems, there is {systems}")
    first = check_first(first, most)
    zone, confidence = check_zone(zone), check_confidence(confidence, systems)
    sign = 1.0 if maximise else -1.0
    kept: list[list[float]] = [[] for _ in range(systems)]

    def take(numbers: Sequence[int], replication: int) -> None:
        for system, number in zip(numbers, sample(numbers, replication), strict=True):
            if not isfinite(number):
                raise ValueError(f"the sample of system {system} in replication {replication} is {number}")
            kept[system].append(float(number))

    left = list(range(systems))
    for replication in range(first):
        take(left, replication)
    start = sign * np.array(kept)
    variances = _variances(start)
    _, square = constants(systems, first, confidence)
    scale = square / zone**2
    limits = scale * variances
    for pair in combinations(left, 2):
        if _are_equal(kept, pair):
            limits[pair] = limits[pair[::-1]] = inf
    last = _last(limits, left, first)
    end = max(int(_last(np.where(np.isinf(limits), 0.0, limits), left, first)), ENOUGH if last == inf else 0)
    sums, dropped, count = start.sum(axis=1), list[Dropped](), first
    while len(left) > 1 and count < last:
        losers = _losers(sums, left, count, limits, zone)
        dropped += [Dropped(loser, count, winner) for loser, winner in losers]
        left = [system for system in left if system not in {loser for loser, _ in losers}]
        last = _last(limits, left, first)
        if len(left) == 1 or count >= last or count == most:
            break
        take(left, count)
        count += 1
        for system in left:
            sums[system] += sign * kept[system][-1]
        for pair in combinations(left, 2):
            if limits[pair] == inf and (count >= ENOUGH or not _are_equal(kept, pair)):
                variances[pair] = variances[pair[::-1]] = _variances(sign * np.array([kept[k] for k in pair]))[0, 1]
                limits[pair] = limits[pair[::-1]] = scale * variances[pair]
                last = _last(limits, left, first)
                end = max(end, int(last)) if last < inf else end
    best = max(left, key=lambda system: (sums[system], -system))
    return Selection(
        best,
        tuple(left),
        tuple(dropped),
        len(left) == 1 or count >= last,
        tuple(np.array(numbers) for numbers in kept),
        end,
        variances,
    )


def _last(limits: Floats, left: Sequence[int], first: int) -> float:
    """Return the number of samples at which all margins between systems that are left are 0: means then decide.

    It is infinite as long as a variance is not known.
    """
    greatest = float(limits[np.ix_(left, left)].max())
    return max(floor(greatest), first - 1) + 1 if isfinite(greatest) else inf


def _are_equal(kept: Sequence[Sequence[float]], pair: tuple[int, int]) -> bool:
    """Return whether two systems differ by the same in all samples, up to rounding: their variance is not known."""
    return paired(*(kept[system] for system in pair)).standard_error == 0.0


def _variances(start: Floats) -> Floats:
    """Return the (k, k) variances of the differences of samples, an array (k, first)."""
    differences = start[:, None, :] - start[None, :, :]
    return np.asarray(differences.var(axis=2, ddof=1))


def _losers(sums: Floats, left: Sequence[int], count: int, limits: Floats, zone: float) -> list[tuple[int, int]]:
    """Return the systems that lose against another one that is left, each with the one that beats it most clearly."""
    at = np.array(left)
    means = sums[at] / count
    margins = np.maximum(0.0, zone / (2.0 * count) * (limits[np.ix_(at, at)] - count))
    behind = means[None, :] - means[:, None] - margins  # above 0: the row loses against the column
    np.fill_diagonal(behind, -inf)
    against = behind.argmax(axis=1)
    return [(left[k], left[against[k]]) for k in range(len(left)) if behind[k, against[k]] > 0.0]


def two_stage_runs(variances: Floats, first: int, confidence: float, zone: float) -> int:
    """Return the number of samples of all systems that a two-stage procedure with the same guarantee takes.

    It is that of Clark & Yang 1986, "A Bonferroni selection procedure when using common random numbers with unknown
    variances": after the same first samples, each system has as many as the most variable difference of two needs,
    max(first, ceil(max (t S / zone)^2)), with the quantile t of Student's distribution at 1 - (1 - confidence)/(k - 1)
    and first - 1 degrees of freedom. No system is dropped. `variances` are the (k, k) ones of differences.
    """
    from scipy.special import stdtrit

    systems = len(variances)
    t = float(stdtrit(first - 1, 1.0 - (1.0 - confidence) / (systems - 1)))
    return systems * max(first, ceil(float(variances.max()) * (t / zone) ** 2))


def independent_variances(samples: Sequence[Floats], first: int) -> Floats:
    """Return the (k, k) variances that differences would have without common random numbers: sums of two variances."""
    alone = np.array([numbers[:first].var(ddof=1) for numbers in samples])
    variances: Floats = alone[:, None] + alone[None, :]
    np.fill_diagonal(variances, 0.0)
    return variances

"""Which of k systems has the greatest mean: a fully sequential procedure.

It is procedure KN of Kim & Nelson 2001, "A Fully Sequential Procedure for Indifference-Zone Selection in Simulation",
section 3.

After `first` samples of each system, the procedure adds one sample of each remaining system at a time. A system is
dropped as soon as, after r samples, its mean is below that of another by more than
W(r) = max(0, zone / (2 r) (h^2 S^2 / zone^2 - r)). S^2 is the variance of the differences of the two in the first
samples. The constant c of the paper is 1, its recommendation.

If samples are normal, and independent from one replication to the next, and the best mean is better than every other by
at least `zone`, the best is selected with a probability of at least `confidence`. Samples of one replication may depend
on each other: with common random numbers their differences have smaller variances, and the procedure ends earlier. If
means are closer than `zone`, any of the close ones may be selected, with about the same effort.

Two systems may have the same difference in all first samples, so that S^2 is 0: if a rule hardly matters, or if samples
are truth values, such as whether there is a capture. Their variance is then unknown. The procedure does not compare
the two before a sample with another difference; S^2 is then the variance of all samples up to this one. Without such a
sample among the first `ENOUGH`, S^2 is 0. docs/explanation/validation.md says how often the best is selected if samples
are not normal.
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

MIN_ZONE, MAX_ZONE = 1e-100, 1e100
"""The indifference zones whose squares, and variances in their unit, a float holds."""
ENOUGH = ceil(NORMAL_975**2 * (1.0 - OTHERS) / OTHERS)
"""The number of samples, 73, after which two systems with the same difference in all samples have a variance of 0.

By Wilson's interval, at most a share `OTHERS` of all samples then has another difference. Equal values end a
sequential study at the same share.
"""
Sample = Callable[[Sequence[int], int], Sequence[float]]
"""Returns a sample of each of some systems, given the numbers of the systems and of the replication, from 0 on."""


class Dropped(NamedTuple):
    """When a system was dropped, and against which other one."""

    system: int
    after: int
    """The number of samples of each system at that time."""
    against: int
    """The system that beat it."""


@dataclass(frozen=True)
class Selection:
    """The result of the procedure."""

    selected: int
    """The system with the best mean among those that were left."""
    left: tuple[int, ...]
    """The systems that were left at the end. There are several if the largest number of samples was reached, or if all
    margins were 0, so that the best mean was selected."""
    dropped: tuple[Dropped, ...]
    """The other systems, in the order in which they were dropped."""
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
        ValueError: if `confidence` is not between 1/k, the probability of a guess, and 1.
    """
    confidence = real(confidence, "confidence")
    if not 1.0 / systems < confidence < 1.0:
        least = f"1/{systems}, which a guess among {systems} has,"
        raise ArgumentError("confidence", f"should be between {least} and 1 (got {confidence:g})")
    return confidence


def check_zone(zone: float, unit: str = "") -> float:
    """Return the indifference zone as a `float`.

    Raises:
        ValueError: if `zone` is not a positive number, or its square is beyond what a float holds.
    """
    zone = real(zone, "zone")
    if not 0.0 < zone < inf:
        meaning = f"the smallest difference of means that matters{f', {unit}' if unit else ''}"
        raise ArgumentError("zone", f"should be positive and finite: it is {meaning} (got {zone:g})")
    if not MIN_ZONE <= zone <= MAX_ZONE:
        raise ArgumentError("zone", f"should be from {MIN_ZONE:g} to {MAX_ZONE:g} (got {zone:g})")
    return zone


def check_first(first: int, most: int | None = None) -> int:
    """Return the number of first samples of a system.

    Raises:
        ValueError: if `first` is less than 2, or more than the largest number of samples.
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
        sample: returns samples. It is called with all systems for replications 0 .. first - 1, and then with the
            systems that are left, one replication after the other.
        systems: the number of systems, k.
        zone: the indifference zone, the smallest difference of means that matters, in the unit of the samples.
        confidence: the probability of a correct selection, in (1/k, 1).
        first: the number of first samples, from which variances are estimated; at least 2; if in doubt, 20. Few samples
            make the procedure cautious, and many are wasted on systems that are far behind.
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
    samples: list[list[float]] = [[] for _ in range(systems)]

    def take(sampled: Sequence[int], replication: int) -> None:
        for system, number in zip(sampled, sample(sampled, replication), strict=True):
            if not isfinite(number):
                raise ValueError(f"the sample of system {system} in replication {replication} is {number}")
            samples[system].append(float(number))

    left = list(range(systems))
    for replication in range(first):
        take(left, replication)
    first_samples = sign * np.array(samples)
    variances = _variances(first_samples)
    _, h_squared = constants(systems, first, confidence)
    scale = h_squared / zone**2
    limits = scale * variances  # (k, k) numbers of samples from which on the margin W is 0; inf: unknown
    for pair in combinations(left, 2):
        if _are_equal(samples, pair):
            limits[pair] = limits[pair[::-1]] = inf
    decided_at = _samples_to_decide(limits, left, first)
    known_limits = np.where(np.isinf(limits), 0.0, limits)
    at_most = max(int(_samples_to_decide(known_limits, left, first)), ENOUGH if decided_at == inf else 0)
    sums, dropped, count = first_samples.sum(axis=1), list[Dropped](), first
    while len(left) > 1 and count < decided_at:
        losers = _losers(sums, left, count, limits, zone)
        dropped += [Dropped(loser, count, winner) for loser, winner in losers]
        left = [system for system in left if system not in {loser for loser, _ in losers}]
        decided_at = _samples_to_decide(limits, left, first)
        if len(left) == 1 or count >= decided_at or count == most:
            break
        take(left, count)
        count += 1
        for system in left:
            sums[system] += sign * samples[system][-1]
        for pair in combinations(left, 2):
            if limits[pair] == inf and (count >= ENOUGH or not _are_equal(samples, pair)):
                variances[pair] = variances[pair[::-1]] = _variances(sign * np.array([samples[k] for k in pair]))[0, 1]
                limits[pair] = limits[pair[::-1]] = scale * variances[pair]
                decided_at = _samples_to_decide(limits, left, first)
                at_most = max(at_most, int(decided_at)) if decided_at < inf else at_most
    best = max(left, key=lambda system: (sums[system], -system))
    return Selection(
        best,
        tuple(left),
        tuple(dropped),
        len(left) == 1 or count >= decided_at,
        tuple(np.array(numbers) for numbers in samples),
        at_most,
        variances,
    )


def _samples_to_decide(limits: Floats, left: Sequence[int], first: int) -> float:
    """Return the number of samples from which on the means decide, because the margins of all systems left are 0.

    It is infinite as long as a variance is unknown.
    """
    greatest = float(limits[np.ix_(left, left)].max())
    return max(floor(greatest), first - 1) + 1 if isfinite(greatest) else inf


def _are_equal(samples: Sequence[Sequence[float]], pair: tuple[int, int]) -> bool:
    """Return whether two systems have the same difference in all samples, up to rounding: its variance is unknown."""
    return paired(*(samples[system] for system in pair)).standard_error == 0.0


def _variances(samples: Floats) -> Floats:
    """Return the (k, k) variances of the differences of samples, an array (k, first)."""
    differences = samples[:, None, :] - samples[None, :, :]
    return np.asarray(differences.var(axis=2, ddof=1))


def _losers(sums: Floats, left: Sequence[int], count: int, limits: Floats, zone: float) -> list[tuple[int, int]]:
    """Return the systems that lose against another one that is left, each with the one that beats it most clearly."""
    indices = np.array(left)
    means = sums[indices] / count
    margins = np.maximum(0.0, zone / (2.0 * count) * (limits[np.ix_(indices, indices)] - count))
    behind = means[None, :] - means[:, None] - margins  # above 0: the row loses against the column
    np.fill_diagonal(behind, -inf)
    winners = behind.argmax(axis=1)
    return [(left[k], left[winners[k]]) for k in range(len(left)) if behind[k, winners[k]] > 0.0]


def two_stage_runs(variances: Floats, first: int, confidence: float, zone: float) -> int:
    """Return the number of samples of all systems that a two-stage procedure with the same guarantee takes.

    It is that of Clark & Yang 1986, "A Bonferroni selection procedure when using common random numbers with unknown
    variances": after the same first samples, each system has as many samples as the most variable difference needs,
    max(first, ceil(max (t S / zone)^2)), with the quantile t of Student's distribution at 1 - (1 - confidence)/(k - 1)
    and first - 1 degrees of freedom. No system is dropped. `variances` are the (k, k) variances of differences.
    """
    from scipy.special import stdtrit

    systems = len(variances)
    t = float(stdtrit(first - 1, 1.0 - (1.0 - confidence) / (systems - 1)))
    return systems * max(first, ceil(float(variances.max()) * (t / zone) ** 2))


def independent_variances(samples: Sequence[Floats], first: int) -> Floats:
    """Return the (k, k) variances of differences without common random numbers: sums of two systems' variances."""
    by_system = np.array([numbers[:first].var(ddof=1) for numbers in samples])
    variances: Floats = by_system[:, None] + by_system[None, :]
    np.fill_diagonal(variances, 0.0)
    return variances

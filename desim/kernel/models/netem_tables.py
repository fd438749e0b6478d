"""Distribution tables of delays, as `tc netem` reads them.

A table is a quantile function at equally spaced probabilities, mostly 4096, scaled by 8192: with a delay mu, a jitter
sigma and a random index U, a packet is delayed by mu + sigma table[U] / 8192 (tabledist, net/sched/sch_netem.c of
Linux). A file NAME.dist holds the numbers as text, with white space between them; `#` begins a comment. tc reads it for
`distribution NAME`.

The tables normal, pareto and paretonormal equal, number by number, those that iproute2 generates at its build
(netem/normal.c, pareto.c and paretonormal.c, from NIST Net by Carson & Santay 2003).
"""

from collections.abc import Callable, Mapping
from functools import cache
from math import ceil, fsum, sqrt
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from desim.config.arrays import Floats, Integers
from desim.config.number_files import converted, integer_of, lines_of, words_of

SIZE = 4096
"""Length of the tables of iproute2, and of fitted ones."""
LONGEST = 16384
"""Length of the longest table that tc reads (tc/q_netem.c) and Linux takes (net/sched/sch_netem.c)."""
SCALE = 8192
"""A number of a table is a quantile of the normalised delay, times SCALE."""
LOWEST, HIGHEST = -(2**15), 2**15 - 1
"""The range of the numbers of a table, which tc stores in 16 bits; in units of sigma, -4 to 4."""
PER_LINE = 8
"""Numbers in a line of a written table."""


class Fit(NamedTuple):
    """A distribution of delays, in the form of tc: delay + jitter table[U] / SCALE."""

    delay: float
    """s"""
    jitter: float
    """s"""
    table: tuple[int, ...]
    """(SIZE,) numbers in LOWEST .. HIGHEST, ascending."""


def fit(quantile: Callable[[Floats], Floats]) -> Fit:
    """Fit a table to a quantile function of delays, s.

    The table holds the quantiles at (k + 1/2) / SIZE. The delay is their mean. The jitter is their standard deviation,
    or more if a quantile differs from the mean by more than the table can express. Both are whole nanoseconds, as in
    tc, and the table is relative to the rounded ones, so each quantile is reproduced within half of jitter / SCALE.
    """
    quantiles = quantile((np.arange(SIZE) + 0.5) / SIZE)
    delay = round(fsum(quantiles) / SIZE, 9)
    deviations = quantiles - delay
    min_jitter = max(float(deviations.max()) / HIGHEST, float(deviations.min()) / LOWEST) * SCALE
    jitter = ceil(max(sqrt(fsum(deviations * deviations) / SIZE), min_jitter) * 1e9) / 1e9
    return Fit(delay, jitter, _as_table(deviations / jitter * SCALE if jitter else deviations))


def table_text(table: tuple[int, ...], name: str) -> str:
    """Return the text of the file NAME.dist."""
    rows = (table[k : k + PER_LINE] for k in range(0, len(table), PER_LINE))
    lines = [" ".join(map(str, row)) for row in rows]
    return "\n".join([f"# This is the distribution table for the {name} distribution.", *lines, ""])


def read_table(file: Path) -> tuple[int, ...]:
    """Return the table in a file.

    Raises:
        ValueError: if the file cannot be read, or does not contain 1 to LONGEST integers in LOWEST .. HIGHEST.
    """
    numbers: list[int] = []
    for line, text in enumerate(lines_of(file), 1):
        for word in words_of(text):
            numbers.append(converted(integer_of, word, f"{file}, line {line}"))
            if not LOWEST <= numbers[-1] <= HIGHEST:
                raise ValueError(f"{file}, line {line}: should be in {LOWEST} .. {HIGHEST} (got {word})")
    if not 1 <= len(numbers) <= LONGEST:
        raise ValueError(f"{file} should contain 1 to {LONGEST} numbers (got {len(numbers)})")
    return tuple(numbers)


@cache
def normal() -> tuple[int, ...]:
    """Return the standard normal distribution, from -4 to 3.5 sigma."""
    return _as_table(_normal())


@cache
def pareto() -> tuple[int, ...]:
    """Return 4/3 (X - 3/2) for a Pareto distributed X >= 1 with exponent a = 3, up to 4 sigma.

    X has the mean 3/2 and the quantiles (1 - u)^(-1/3), here at u = k / SIZE. Its standard deviation times 4/3 is 1.15;
    because it is cut off, that of the table is 0.82.
    """
    quantiles = np.array([(1.0 - k / SIZE) ** (-1.0 / 3.0) for k in range(SIZE)])  # `**` of numpy is not portable
    return _as_table((quantiles - 1.5) * (4.0 / 3.0) * SCALE)


@cache
def paretonormal() -> tuple[int, ...]:
    """Return, for each index, 3/4 of the number of `pareto` plus 1/4 of that of `normal`, rounded towards 0.

    The standard deviation of the table is 0.83.
    """
    return _as_table(np.trunc((_normal() + 3 * np.array(pareto())) / 4))


TABLES: Mapping[str, Callable[[], tuple[int, ...]]] = MappingProxyType(
    {"normal": normal, "pareto": pareto, "paretonormal": paretonormal}
)
"""The functions that return the tables of iproute2, by the name in `distribution NAME`."""


def _normal() -> Integers:
    """Return the normal quantiles at (k + 1/8) / SIZE, rounded down to multiples of 0.00005 as in netem/normal.c."""
    from scipy.special import ndtri

    z = np.asarray(ndtri((np.arange(SIZE) + 0.125) / SIZE))
    return np.rint(np.floor(z * 20_000.0) / 20_000.0 * SCALE).astype(np.int64)


def _as_table(numbers: Floats | Integers) -> tuple[int, ...]:
    """Return numbers, rounded and limited to LOWEST .. HIGHEST, as a table."""
    return tuple(np.clip(np.rint(numbers), LOWEST, HIGHEST).astype(int).tolist())

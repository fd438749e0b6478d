"""Ranges of numbers in a grid: "0:1:0.1" and "log:0.01:1:5" stand for their numbers, "0:1" for all between its ends."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from math import exp, floor, isfinite, isinf, log
from typing import Any

from desim.config.number_texts import exact_text

_NUMBER = r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*"
_RANGE = re.compile(":".join([_NUMBER] * 3), re.IGNORECASE)
"""Matches FIRST:LAST:STEP."""
_END = r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|[+-]?inf(?:inity)?|nan)\s*"
_INTERVAL = re.compile(rf"\s*(log:)?{_END}:{_END}", re.IGNORECASE)
"""Matches LOW:HIGH and log:LOW:HIGH, also with ends that are then refused with a reason: inf and nan."""
_LOG = re.compile(rf"\s*log:{_NUMBER}:{_NUMBER}:\s*(\d+)\s*", re.IGNORECASE)
"""Matches log:FIRST:LAST:COUNT."""
MAX_VALUES = 100_000
"""Maximum number of values of a range."""
DIGITS = 6
"""The significant digits of a number between the ends of a range: a table then shows the number that was run."""


@dataclass(frozen=True)
class KeyRange:
    """All numbers from `low` to `high`; a design or a sensitivity analysis chooses some of them."""

    low: float
    high: float
    is_log: bool = False
    """Whether equal ratios are equally probable, instead of equal differences."""
    is_whole: bool = False
    """Whether only whole numbers are meant."""

    def __post_init__(self) -> None:
        if not isfinite(self.high - self.low):
            raise ValueError(f"the range {self} should have finite ends: all numbers between them are equally probable")
        if self.is_log and not self.low > 0.0:
            raise ValueError(f"the range {self} should begin above 0: it is logarithmic")
        if not self.low < self.high:
            raise ValueError(f"the range {self} should have its lower end first")

    def at(self, share: float) -> float:
        """Return the number below which a share in [0, 1] of the range lies, with `DIGITS` significant digits.

        The ends themselves are exact.
        """
        low, high = (self.low, self.high + 1.0) if self.is_whole else (self.low, self.high)
        number = exp(log(low) + share * (log(high) - log(low))) if self.is_log else low + share * (high - low)
        if self.is_whole:  # each number is as probable as another
            return min(max(floor(number), int(self.low)), int(self.high))  # logarithms are rounded
        if share in (0.0, 1.0):
            return high if share else low
        return min(max(rounded(number), low), high)

    def share_between(self, first: float, second: float) -> float:
        """Return the share of the range that lies between two numbers of it."""
        if self.is_log:
            return abs(log(second) - log(first)) / (log(self.high) - log(self.low))
        return abs(second - first) / (self.high - self.low)

    def __str__(self) -> str:
        return f"{'log:' if self.is_log else ''}{exact_text(self.low, 15)}:{exact_text(self.high, 15)}"


def rounded(number: float) -> float:
    """Return a number with `DIGITS` significant digits."""
    return float(f"{number:.{DIGITS}g}")


def setting_at(values: Sequence[Any], share: float) -> Any:
    """Return the value of a key of a grid at a share in [0, 1]: a number of a range, or an item of a list."""
    (first, *_) = values
    if isinstance(first, KeyRange):
        return first.at(share)
    return values[min(int(share * len(values)), len(values) - 1)]


def is_range(values: Sequence[Any]) -> bool:
    """Return whether the values of a key of a grid are all numbers of a range."""
    return len(values) == 1 and isinstance(values[0], KeyRange)


def values_to_try(values: Sequence[Any]) -> Sequence[Any]:
    """Return the values of a key of a grid that a scenario should take: both ends of a range, all items of a list."""
    return [values[0].at(0.0), values[0].at(1.0)] if is_range(values) else values


def interval_of(text: str) -> KeyRange | None:
    """Return the range "LOW:HIGH" or "log:LOW:HIGH"; None if a text is neither.

    Raises:
        ValueError: if an end is not finite, the higher end is first, or a logarithmic range begins at 0 or below.
    """
    match = _INTERVAL.fullmatch(text)
    return None if match is None else KeyRange(float(match[2]), float(match[3]), bool(match[1]))


def range_of(text: str) -> list[float] | list[int] | None:
    """Return the numbers of a range "FIRST:LAST:STEP" or "log:FIRST:LAST:COUNT"; None if a text is neither.

    The last number belongs to the range if a whole number of steps leads to it. The steps are counted in decimals, so
    that each number is the one that a user would write. The numbers are integers if all three are. A logarithmic range
    has COUNT numbers with equal ratios; those between its ends have `DIGITS` significant digits.

    Raises:
        ValueError: if the step is 0 or leads away from the last number, there are more than `MAX_VALUES` numbers, an
            exponent is too large, or a logarithmic range begins or ends at 0 or below, or has fewer than two numbers.
    """
    if logarithmic := _LOG.fullmatch(text):
        return _in_equal_ratios(text, float(logarithmic[1]), float(logarithmic[2]), int(logarithmic[3]))
    match = _RANGE.fullmatch(text)
    if match is None:
        return None
    try:
        first, last, step = map(Decimal, match.groups())
        steps = (last - first) / step if step else Decimal(-1)
    except ArithmeticError:
        raise _too_large(text) from None
    if steps < 0:
        raise ValueError(f"the range {text} has no end: its step should lead from {match[1]} to {match[2]}")
    _check_count(text, steps + 1)
    if isinf(float(first)) or isinf(float(last)):  # beyond the largest `float`
        raise _too_large(text)
    numbers = [first + k * step for k in range(int(steps) + 1)]
    is_whole = all(part.lstrip("+-").isdecimal() for part in match.groups())
    return [int(number) for number in numbers] if is_whole else [float(number) for number in numbers]


def _in_equal_ratios(text: str, first: float, last: float, count: int) -> list[float]:
    if isinf(first) or isinf(last):
        raise _too_large(text)
    if not (first > 0.0 and last > 0.0):
        raise ValueError(f"the range {text} should begin and end above 0: it is logarithmic")
    if count < 2 or first == last:
        raise ValueError(f"the range {text} should have at least two different numbers")
    _check_count(text, count)
    inner = (rounded(exp(log(first) + k / (count - 1) * (log(last) - log(first)))) for k in range(1, count - 1))
    return [first, *inner, last]


def _too_large(text: str) -> ValueError:
    return ValueError(f"the range {text} has an exponent that is too large")


def _check_count(text: str, count: int | Decimal) -> None:
    if count >= MAX_VALUES + 1:
        raise ValueError(f"the range {text} has more than {MAX_VALUES:,} values")

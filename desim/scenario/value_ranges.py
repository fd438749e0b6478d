"""Ranges of numbers in a grid: "0:1:0.1" stands for 0.0, 0.1, ..., 1.0."""

import re
from decimal import Decimal

_NUMBER = r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*"
_RANGE = re.compile(":".join([_NUMBER] * 3), re.IGNORECASE)
FORM = "FIRST:LAST:STEP, 0:1:0.1 for instance"
MAX_VALUES = 100_000
"""Maximum number of values of a range."""


def range_of(text: str) -> list[float] | list[int] | None:
    """Return the numbers of a range "FIRST:LAST:STEP"; None if a text is no range.

    The last number belongs to the range if a whole number of steps leads to it. The steps are counted in decimals, so
    that each number is the one that a user would write. The numbers are integers if all three are.

    Raises:
        ValueError: if the step is 0 or leads away from the last number, or there are too many numbers.
    """
    match = _RANGE.fullmatch(text)
    if match is None:
        return None
    first, last, step = map(Decimal, match.groups())
    if not step or (last - first) / step < 0:
        raise ValueError(f"the range {text} has no end: its step should lead from {match[1]} to {match[2]}")
    count = int((last - first) / step) + 1
    if count > MAX_VALUES:
        raise ValueError(f"the range {text} has {count:,} values, above {MAX_VALUES:,}")
    numbers = [first + k * step for k in range(count)]
    is_whole = all(part.lstrip("+-").isdecimal() for part in match.groups())
    return [int(number) for number in numbers] if is_whole else [float(number) for number in numbers]

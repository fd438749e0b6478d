"""Numbers as texts: writing them, reading times such as "50 ms", and telling a user which number a text means."""

import re
from collections.abc import Collection
from types import MappingProxyType

NUMBER_AS_TEXT = re.compile(r"\s*([+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:e[+-]?\d+)?)\s*([^\W\d_]*|%)\s*", re.IGNORECASE)
"""Matches a text that is meant as a number, and its unit."""
AMBIGUOUS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
"""Matches a number whose comma may be a decimal sign, or separate thousands."""
UNITS = MappingProxyType(
    {
        "s": ("s", 1.0),
        "sec": ("s", 1.0),
        "ms": ("s", 1e3),
        "us": ("s", 1e6),
        "ns": ("s", 1e9),
        "min": ("s", 1 / 60),
        "m": ("m", 1.0),
        "km": ("m", 1e-3),
        "cm": ("m", 1e2),
        "mm": ("m", 1e3),
        "%": ("1", 100.0),
    }
)
"""By unit in a text: the unit in which desim takes the number, and the factor between both, as in 1 s = 1e3 ms."""


def exact_text(number: float, digits: int) -> str:
    """Return a number as a text from which the same number is read: with `digits` digits if they suffice, else all."""
    short = f"{number:.{digits}g}"
    return short if float(short) == number else repr(number)


def counted(number: int, noun: str) -> str:
    """Return a number of things as text: 1 run, 2 runs."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def number_instead_of(text: str, units: Collection[str] = ("s", "1")) -> str | None:
    """Return what to write instead of a text that is meant as a number; None for any other text, such as a kind.

    Args:
        text: the text.
        units: the units that the number may have; by default, those of a latency and a loss.
    """
    text = str(text)  # the `repr` of a string of numpy is np.str_('50 ms')
    match = NUMBER_AS_TEXT.fullmatch(text)
    if match is None:
        return None
    if AMBIGUOUS.fullmatch(match[1]):
        return f"should be a number: its decimal sign is a point, and thousands have no separator (got {text!r})"
    number, unit = match[1].replace(",", "."), match[2].lower()
    if not unit:
        return f"should be a number: {number} instead of the text {text!r}"
    if unit not in UNITS or UNITS[unit][0] not in units:
        return f"should be a number without a unit (got {text!r})"
    unit_of_key, factor = UNITS[unit]
    what = "a number from 0 to 1" if unit_of_key == "1" else f"a number, in {unit_of_key}"
    return f"should be {what}: {float(number) / factor:.15g} instead of the text {text!r}"


def seconds_in(text: str) -> float | None:
    """Return the time, s, in a text that names its unit, such as "50 ms"; None for any other text.

    A comma is refused, because it may separate thousands.
    """
    match = NUMBER_AS_TEXT.fullmatch(text)
    if match is None or "," in match[1]:
        return None
    unit, factor = UNITS.get(match[2].lower(), ("", 1.0))
    return float(match[1]) / factor if unit == "s" else None

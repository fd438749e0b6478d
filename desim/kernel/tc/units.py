"""Times, shares and bit rates in the form of the commands of `tc`."""

import re
from collections.abc import Callable
from decimal import Decimal

from desim.config.model import MAX_TIME

TIMES = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""The units of time, as powers of 10 ns. tc also accepts sec, secs, msec, ..., and takes a number without a unit for
ns, or, before version 4.16, us."""
RATES = {"tbit": 12, "gbit": 9, "mbit": 6, "kbit": 3, "bit": 0}
"""The units of bit rates, as powers of 10 bit/s."""
OTHER_RATES = {"kibit": 2**10, "mibit": 2**20, "gibit": 2**30, "tibit": 2**40, "bps": 8, "kbps": 8 * 10**3}
OTHER_RATES |= {"mbps": 8 * 10**6, "gbps": 8 * 10**9, "tbps": 8 * 10**12}
OTHER_RATES |= {f"{prefix}ibps": 8 * 2 ** (10 * k) for k, prefix in enumerate("kmgt", 1)}
"""Further units of bit rates, in bit/s; bps are bytes per second."""
_NUMBER = r"((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,3})?)"


def time_word(seconds: float) -> str:
    """Return a time, for instance 12.5ms; it is rounded to nanoseconds, as tc does."""
    nanoseconds = round(seconds * 1e9)
    unit = next(unit for unit, power in TIMES.items() if nanoseconds >= 10**power or not power)
    return f"{_plain(Decimal(nanoseconds).scaleb(-TIMES[unit]))}{unit}"


def duration_of(word: str) -> float:
    """Return the time, s, that a word says.

    Raises:
        ValueError: if it is not a time with a unit, or beyond `MAX_TIME`.
    """
    match = re.fullmatch(f"{_NUMBER}(s|ms|us|ns)(?:ecs?)?", word.lower())
    if match is None and not re.fullmatch("0+", word):
        raise ValueError("should be a time with its unit: s, ms, us or ns")
    nanoseconds = Decimal(match[1]) * 10 ** TIMES[match[2]] if match else Decimal(0)
    if nanoseconds > Decimal(MAX_TIME) * 10**9:
        raise ValueError(f"should be at most {MAX_TIME:.0f}s")
    return round(nanoseconds) / 10**9


def share_word(share: float) -> str:
    """Return a share in [0, 1] in percent: the shortest text that Linux converts to the same number of steps."""
    steps = steps_of(share)
    percent = shortest(100.0 * share, lambda percent: steps_of(percent / 100.0) == steps) if steps else 0.0
    return f"{_plain(Decimal(repr(percent)))}%"


def steps_of(share: float) -> int:
    """Return a share in [0, 1] in the steps of Linux, which are 2.3e-10 wide (set_percent, tc/q_netem.c)."""
    return round(share * (2**32 - 1))


def p_of(share: float, burst: float) -> float:
    """Return the probability of Gilbert & Elliott that a good link becomes bad, from the share and length of bursts."""
    return share / (1.0 - share) / burst


def shortest(number: float, fits: Callable[[float], bool]) -> float:
    """Return a number rounded to the fewest significant digits with which it fits; if it never does, as it is."""
    rounded = (float(f"{number:.{digits}g}") for digits in range(1, 17))
    return next((candidate for candidate in rounded if fits(candidate)), number)


def share_of(word: str) -> float:
    """Return the share in [0, 1] that a word says in percent.

    Raises:
        ValueError: if it is not a percentage in 0 .. 100.
    """
    match = re.fullmatch(f"{_NUMBER}%?", word.lower())
    if match is None or Decimal(match[1]) > 100:
        raise ValueError("should be a percentage in 0% .. 100%")
    return float(Decimal(match[1]) / 100)


def rate_word(bitrate: float) -> str:
    """Return a bit rate >= 1 bit/s, with 12 digits, for instance 6mbit."""
    unit = next(unit for unit, power in RATES.items() if bitrate >= 10**power or not power)
    return f"{_plain(Decimal(f'{bitrate:.12g}').scaleb(-RATES[unit]))}{unit}"


def rate_of(word: str) -> float:
    """Return the bit rate, bit/s, that a word says.

    Raises:
        ValueError: if it is not a bit rate of 1 bit/s or more.
    """
    match = re.fullmatch(f"{_NUMBER}([a-z]*)", word.lower())
    unit = (match[2] or "bit") if match else ""
    scale = 10 ** RATES[unit] if unit in RATES else OTHER_RATES.get(unit)
    if match is None or scale is None or (rate := float(Decimal(match[1]) * scale)) < 1.0:
        raise ValueError(f"should be a bit rate of at least 1bit, in {', '.join(RATES)} or {', '.join(OTHER_RATES)}")
    return rate


def _plain(number: Decimal) -> str:
    """Return a number without exponent and trailing zeros."""
    text = f"{number:f}"
    return text.rstrip("0").rstrip(".") if "." in text else text

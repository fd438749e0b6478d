"""Lines that are no TOML, but would be right in another language, and what to write instead."""

import re
from types import MappingProxyType

from desim.config.number_texts import number_instead_of

_LINE = re.compile(r"\s*([\w.-]+)\s*([=:]?)\s*(.*?)\s*[,;]?\s*(?:#.*)?")
"""Matches a line, and finds its key, the sign after it and its value."""
_PAIR = re.compile(r"[{,]\s*([\w.-]+)\s*=\s*([^,{}\"'\[\]]+?)\s*(?=[,}])")
"""Finds the keys and the values without quotes in a table of one line."""
CONSTANTS = MappingProxyType(
    {
        "False": "false",
        "Infinity": "inf",
        "NaN": "nan",
        "True": "true",
        "infinity": "inf",
        "math.inf": "inf",
        "np.inf": "inf",
    }
)
"""Values of other languages, and how TOML writes them."""
NOTHING = frozenset({"", "None", "nil", "null"})
"""Values that TOML does not have."""
UNITS = ("s", "m", "m/s", "1")
"""The units that are tried for a number, because that of its key is not known here."""


def what_was_meant(line: str) -> str | None:
    """Return what to write instead of a line that is not TOML; None if that is not known."""
    if line.lstrip().startswith(("//", "/*", "--", ";")):
        return "a comment begins with #"
    if line.lstrip().startswith("{"):
        return "this looks like JSON: a key of a scenario file is in a line of its own, horizon = 30.0 for instance"
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    key, sign, value = match.groups()
    if sign == ":":
        return f"between a key and its value is =: {key} = {value or '...'}"
    if sign != "=":
        return None
    pairs = _PAIR.findall(value) if value.startswith("{") else [(key, value)]
    for name, text in pairs:
        if meant := _instead_of(name, text):
            return meant
    if line.split("#")[0].rstrip().endswith((",", ";")):
        return f"nothing follows the value: {key} = {value}"
    return None


def _instead_of(key: str, value: str) -> str | None:
    """Return what to write instead of a value without quotes; None if it is TOML, or not known."""
    if value in CONSTANTS:
        return f"{key} should be {CONSTANTS[value]} instead of {value}"
    if value in NOTHING:
        return f"{key} has no value: give it one, or leave the key out, and its default counts"
    if re.fullmatch(r"[+-]?[\d._]+(?:[eE][+-]?\d+)?", value):
        return None
    for unit in UNITS:
        text = number_instead_of(value, {unit})
        if text and "without a unit" not in text:  # the text says this if the value has another unit
            return f"{key} {text.replace('the text ', '')}"
    if re.fullmatch(r"[A-Za-z][\w:-]*(?: [\w:-]+)*", value) and value not in {"true", "false", "inf", "nan"}:
        return f'a text is in quotes: {key} = "{value}"'
    return None

"""The texts of overrides: KEY=VALUE, and KEY=VALUE,VALUE,... for the grid of a sweep; the values are in TOML."""

import tomllib
from collections.abc import Callable
from typing import Any

from desim.scenario.toml_lines import MAX_PARTS, deep_key, tables_of
from desim.scenario.value_ranges import interval_of, range_of


def key_and_value(text: str) -> tuple[str, Any]:
    """Return the dotted key and the value of "key.key=value".

    Raises:
        ValueError: if the text does not have this form, or the value is not TOML that can be read.
    """
    return _split(text, "KEY=VALUE, for instance network.latency.value=0.05", _parsed)


def key_and_values(text: str) -> tuple[str, list[Any] | str]:
    """Return the dotted key and the values of "key.key=value,value,..."; a value may be a range, see `range_of`.

    A range without steps, "key.key=LOW:HIGH", stays a text.

    Raises:
        ValueError: if the text does not have this form, or a value is empty or not TOML that can be read.
    """
    return _split(
        text,
        "KEY=VALUE,VALUE,..., for instance network.latency.value=0.0,0.1 or network.latency.value=0:1:0.1",
        lambda values: _parsed_list(values) if interval_of(values) is None else values,
    )


def _split(text: str, form: str, parse: Callable[[str], Any]) -> tuple[str, Any]:
    """Return the key and the parsed value of a text of a form.

    Raises:
        ValueError: if the text does not have this form, or `parse` refuses its value.
    """
    name, equals, value = text.partition("=")
    if not equals or not all(name.strip().split(".")):
        raise ValueError(f"should be {form}")
    if name.count(".") >= MAX_PARTS or deep_key(value) is not None:
        raise ValueError(f"is not a TOML value that can be read: a key of more than {MAX_PARTS} parts")
    return name.strip(), parse(value.strip())


def _parsed(text: str) -> Any:
    """Return the value of a TOML text; text that is not TOML is a string, unless it begins with a quote or bracket.

    Raises:
        ValueError: if a text that begins with a quote or bracket is not TOML, or if a text is more than one value or
            cannot be read.
    """
    try:
        tables = tables_of(f"value = {text}")
    except tomllib.TOMLDecodeError as error:
        if text.startswith(('"', "'", "[", "{")):
            raise ValueError(f"{text!r} is not a TOML value") from error
        return text
    except (ValueError, RecursionError) as error:  # a number too long, or lists nested too deeply
        raise ValueError(f"{text[:20]!r}... is not a TOML value that can be read: {error}") from error
    if len(tables) > 1:
        raise ValueError(f"{text!r} is more than one value")
    return tables["value"]


def _parsed_list(text: str) -> list[Any]:
    """Return the values of a text, separated by commas; a comma within a list, a table or a string is no separator.

    Raises:
        ValueError: if one of them is empty, or `_parsed` refuses it.
    """
    values: list[Any] = []
    begun: list[str] = []  # the parts of a value that is not complete yet
    parts = text.split(",")
    for k, part in enumerate(parts):
        begun.append(part)
        value = ",".join(begun).strip()
        if not value:
            raise ValueError(f"{text!r} has an empty value: values are separated by commas, 0,0.1 for instance")
        try:
            numbers = range_of(value)
            values.extend([_parsed(value)] if numbers is None else numbers)
        except ValueError:
            if k == len(parts) - 1:
                raise
            continue
        begun = []
    return values

"""A self-contained HTML page that plays two runs side by side on one clock; equal runs give equal bytes."""

from collections.abc import Callable, Iterator
from importlib.resources import files
from typing import Any, NamedTuple

from desim.config.key_index import unit_of_key
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result
from desim.view.pages.headline import run_name
from desim.view.pages.replay import replay_page

MAX_DIFFERENCES = 6
"""Maximum number of keys that the header names."""
MAX_TEXT = 48
"""Maximum number of characters of a value in the header."""
INFINITY = "Infinity"
"""Infinity as a JSON value; see `desim.config.model.Value.plain`."""
IGNORED = {"name", "seed", "record", "sweep"}
"""Keys of a scenario that are not compared: `seed`, because the seeds of the runs are, and three without an effect."""


class Difference(NamedTuple):
    """A key of a scenario file with different values in two scenarios."""

    key: str
    """The dotted key of the value. If two models differ in kind, only the key of the models is given."""
    first: str
    """The value in the first scenario as text."""
    second: str
    """The value in the second scenario as text."""
    unit: str | None = None
    """The unit of both values; None if they are not numbers, or have no unit."""


def side_by_side(first: Result, second: Result, *, on_part: Callable[[], object] = lambda: None) -> str:
    """Return a self-contained HTML page that plays two runs on one clock; needs jinja2 (the extra `plot`).

    Each run has its replay, the first one on the left or, in a narrow window, above. Both show the same time and play
    at the same speed up to the end of the longer run; the shorter run stays at its end. The header names the runs and
    the keys in which their scenarios differ.

    `on_part` is called after each part of the two replays, see `replay_page`.
    """
    from jinja2 import Environment

    all_differences = differences(first, second)
    template = files("desim.view.pages").joinpath("pair.html").read_text(encoding="utf-8")
    page = Environment(autoescape=True, keep_trailing_newline=True).from_string(template)
    return page.render(
        names=[run_name(first), run_name(second)],
        summary=_summary(all_differences),
        differences=all_differences[:MAX_DIFFERENCES],
        more=max(len(all_differences) - MAX_DIFFERENCES, 0),
        pages=[replay_page(result, on_part=on_part) for result in (first, second)],
    )


def differences(first: Result, second: Result) -> list[Difference]:
    """Compare two runs by seed and scenario, and return the differences in the order of the keys of scenarios.

    Keys that do not change a run (`name`, `record`, `sweep`) do not count. Of two models of different kinds, the kinds
    are compared and not their parameters.
    """
    first_values, other_values = (
        {"seed": result.seed} | {key: value for key, value in result.scenario.plain().items() if key not in IGNORED}
        for result in (first, second)
    )
    return list(_differences("", first_values, other_values))


def _differences(key: str, first: Any, second: Any) -> Iterator[Difference]:
    """Yield the differences between two values of a key."""
    if first == second:
        return
    is_pair_of_lists = isinstance(first, list) and isinstance(second, list)
    if _is_alike(first, second):
        for name in dict.fromkeys([*first, *second]):
            yield from _differences(f"{key}.{name}".lstrip("."), first.get(name), second.get(name))
    elif is_pair_of_lists and len(first) == len(second) and all(map(_is_alike, first, second)):
        for k, (first_entry, other_entry) in enumerate(zip(first, second, strict=True)):
            yield from _differences(f"{key}.{k}", first_entry, other_entry)
    else:
        are_numbers = _is_number(first) and _is_number(second)
        yield Difference(key, _text(first), _text(second), unit_of_key(key, Scenario) if are_numbers else None)


def _is_alike(first: Any, second: Any) -> bool:
    """Return whether two values are tables of the same kind, or without kinds."""
    return isinstance(first, dict) and isinstance(second, dict) and first.get("kind") == second.get("kind")


def _is_number(value: Any) -> bool:
    """Return whether a JSON value is a number; infinity is a string there."""
    return value == INFINITY or (isinstance(value, int | float) and not isinstance(value, bool))


def _text(value: Any) -> str:
    """Return a JSON value as text: a model as its kind, other tables as keys and values; long texts are shortened."""
    if value is None or value == []:
        return "none"
    if isinstance(value, dict):
        text = value.get("kind") or ", ".join(f"{key} {_text(inner)}" for key, inner in value.items())
    elif isinstance(value, list):
        inner = ", ".join(map(_text, value))
        text = inner if isinstance(value[0], dict) else f"[{inner}]"
    elif isinstance(value, bool):
        text = str(value).lower()
    else:
        text = "inf" if value == INFINITY else str(value).removesuffix(".0" if isinstance(value, float) else "")
    return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 1]}…"


def _summary(all_differences: list[Difference]) -> str | None:
    """Return the text for runs of the same scenario; None if their scenarios differ."""
    if not all_differences:
        return "the same scenario and the same seed"
    (key, first, second, _), *further = all_differences
    return f"the same scenario, seeds {first} and {second}" if key == "seed" and not further else None

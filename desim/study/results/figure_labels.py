"""Names in figures of sweeps: of axes, of lines and in legends."""

from collections.abc import Mapping, Sequence
from math import isfinite
from textwrap import fill
from types import MappingProxyType
from typing import Any

from desim.analysis.drawing.legends import handles_of
from desim.analysis.drawing.palette import MARKERS, SERIES
from desim.analysis.drawing.plots import Axes, Figure, as_it_is, size_of
from desim.analysis.metrics import unit_of as unit_of_metric
from desim.analysis.metrics import words
from desim.config.escaping import escaped
from desim.config.key_index import unit_of_key
from desim.scenario.scenario import Scenario
from desim.study.plan.configurations import in_words
from desim.study.results.runs import Group, SweepRuns, check_label, is_number, text

MAX_ABREAST = 3
"""The largest number of panels side by side."""
NARROWEST = 1.3
"""The least width of a panel beside another one, inches: labels as long as "network.latency.value (s)" fit below it."""
LETTER = 0.075
"""The approximate width of a letter of 8 points, inches."""
LEGEND_LETTER = 0.062
"""The approximate width of a letter in a legend, inches."""


def columns_of(panels: int, size: str | None, beside: float = 0.6) -> int:
    """Return the number of panels side by side: at most three, and fewer in a narrow figure.

    Args:
        panels: the number of panels.
        size: the size of the figure that was asked for; see `size_of`.
        beside: the width of what lies beside the panels, inches.

    Raises:
        ValueError: if the size is invalid.
    """
    fitting = MAX_ABREAST if size is None else int((size_of(size)[0] - beside) / NARROWEST)
    return max(1, min(panels, MAX_ABREAST, fitting))


def swept_numbers(result: SweepRuns) -> list[str]:
    """Return the keys of the grid that take several numbers, at least one of them finite."""
    return [key for key in result.keys if is_swept_number(result, key)]


def is_swept_number(result: SweepRuns, key: str) -> bool:
    """Return whether a key takes several numbers, at least one of them finite."""
    values = {group.settings[key] for group in result.groups}
    are_numbers = all(map(is_number, values))
    return are_numbers and len(values) > 1 and any(map(isfinite, values))


def metric_with_unit(
    metric: str,
    result: SweepRuns,
    against: Mapping[str, Any] | None = None,
    labels: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return the label of an axis with a metric, or with its difference from the reference `against`.

    `labels` replace keys and values in the name of the reference.
    """
    unit = f" ({unit_name})" if (unit_name := unit_of_metric(metric, result.units)) else ""
    if against is None:
        return axis_label(words(metric), unit_name)
    reference = {key: text(result.setting(key, value)) for key, value in against.items()}
    if len(reference) > 1:  # several values alone would not name their keys
        names = ", ".join(
            f"{_label_or_text(key, labels)}{literal(' = ')}{_label_or_text(value, labels)}"
            for key, value in reference.items()
        )
    elif any(value in labels for value in reference.values()):
        names = ", ".join(_label_or_text(value, labels) for value in reference.values())
    else:
        names = literal(in_words(reference))
    return f"{literal(f'difference in {words(metric)} from ')}{names}{literal(unit)}"


def _label_or_text(name: str, labels: Mapping[str, str]) -> str:
    return escaped(labels[name]) if name in labels else literal(name)


def axis_label(name: str, unit: str | None) -> str:
    """Return a name and its unit, if it has one, as the label of an axis: "active time (s)"."""
    return literal(f"{name} ({unit})" if unit else name)


def key_with_unit(key: str) -> str:
    """Return a key and its unit as the label of an axis."""
    return axis_label(key, unit_of_key(key, Scenario))


def literal(name: str) -> str:
    """Return a text escaped for matplotlib, which reads "$" as mathematics and hides labels that begin with "_"."""
    return f"{' ' if name.startswith('_') else ''}{as_it_is(name)}"


def label_axes(axes: Axes, xlabel: str | None, ylabel: str | None) -> None:
    """Set the labels that are given, and let all labels wrap where the figure is too small for them.

    Raises:
        ValueError: if a label is no text.
    """
    for name, label in (("the abscissa", xlabel), ("the ordinate", ylabel)):
        if label is not None:
            check_label(name, label)
    if xlabel is not None:
        axes.set_xlabel(escaped(xlabel))
    if ylabel is not None:
        axes.set_ylabel(escaped(ylabel))
    axes.xaxis.label.set_wrap(True)
    axes.yaxis.label.set_wrap(True)


def look_of(k: int) -> dict[str, Any]:
    """Return the colour and the mark of line k of a diagram."""
    return {"color": SERIES[k % len(SERIES)], "marker": MARKERS[k % len(MARKERS)], "ms": 3.5, "lw": 1.2}


def line_name(group: Group, by: Sequence[str], labels: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the name of the line of a configuration: its values of the keys `by`."""
    return ", ".join(setting_name(key, group, labels, len(by) > 1) for key in by)


def setting_name(key: str, group: Group, labels: Mapping[str, str], is_one_of_several: bool) -> str:
    """Return the label of a setting; if it has none, its value, preceded by the key if several keys name a line."""
    value = text(group.settings[key])
    if value in labels:
        return escaped(labels[value])
    return literal(f"{key} = {value}" if is_one_of_several else value)


def title_of_legend(by: Sequence[str]) -> str | None:
    """Return the key whose values name the lines; None if there is no key, or if the names include several keys."""
    return key_with_unit(by[0]) if len(by) == 1 else None


def add_legend(figure: Figure, title: str | None) -> None:
    """Add a legend below all panels, outside of their axes, if the lines have names, even for a single line."""
    width = figure.get_figwidth()
    if handles := handles_of(figure.axes):
        names = [_wrapped(name, width) for name in handles]
        look: dict[str, Any] = {"fontsize": 7, "title": title, "title_fontsize": 7}
        figure.legend(list(handles.values()), names, loc="outside lower center", ncols=_abreast(names, width), **look)


def add_legend_above(axes: Axes, title: str | None) -> None:
    """Add a legend above axes of a figure of the caller, the only place where it covers neither data nor labels."""
    if handles := handles_of([axes]):
        place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.01), "borderaxespad": 0.0}
        columns = _abreast(list(handles), axes.get_window_extent().width / axes.figure.dpi)
        look: dict[str, Any] = {"fontsize": 7, "title": title, "title_fontsize": 7, "frameon": False}
        axes.legend(list(handles.values()), list(handles), ncols=columns, **place, **look)


def _wrapped(name: str, width: float) -> str:
    """Return the name of a line broken to fit into a legend of a width, inches; mathematics is not broken."""
    return name if "$" in name else fill(name, max(12, int((width - 0.6) / LEGEND_LETTER)), break_long_words=False)


def _abreast(names: Sequence[str], width: float) -> int:
    """Return the number of columns of a legend."""
    longest = max((len(line) for name in names for line in name.split("\n")), default=0)
    return max(1, min(len(names), int(width / (0.6 + LEGEND_LETTER * longest))))


def height_of_legend(names: Sequence[str], width: float) -> float:
    """Return the height, inches, of a legend with a title below a figure; 0 without names."""
    shown = [_wrapped(name, width) for name in names if name]
    lines = max((name.count("\n") + 1 for name in shown), default=0)
    return 0.3 + 0.15 * lines * -(-len(shown) // _abreast(shown, width)) if shown else 0.0

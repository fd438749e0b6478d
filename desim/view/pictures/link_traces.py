"""The figure of the measured links of a scenario: latency, probability of loss or signal strength over time."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from desim.analysis.drawing.legends import handles_of
from desim.analysis.drawing.palette import BLUE, GREY, LOST, LOST_MARK, SERIES
from desim.analysis.drawing.plots import Axes, Figure, as_it_is, styled
from desim.config.arrays import Bools, Floats
from desim.kernel.core.units import SECOND
from desim.kernel.measured.base import LinkTrace
from desim.kernel.measured.models import LatencyTrace, LossTrace, SignalTrace
from desim.kernel.measured.playback import Playback
from desim.scenario.scenario import Scenario

SIZE = 6.3, 2.3
"""Width of the figure and height of a panel, inches."""
GRID = 400
"""Number of times at which the quantiles of many links are drawn."""
LEGEND = 0.5
"""Height of the legend, inches."""
SHORT = 10
"""Five labels of at most this many letters fit into a row of the legend."""
Y_LABELS: dict[type[LinkTrace], str] = {
    LatencyTrace: "one-way latency (ms)",
    LossTrace: "probability of loss",
    SignalTrace: "signal (dB or dBm)",
}


class _Link(NamedTuple):
    """The rows of a link; the last is at the end of the trace."""

    label: str
    times: Floats
    """s"""
    values: Floats
    is_missing: Bools


def link_traces(scenario: Scenario) -> Figure:
    """Draw the measurements that the links of a scenario follow, with a panel for each of them.

    Up to six links have a line each. A row without a value, whose messages are lost, is a cross at the value before it.
    Instead of more than six links, the panel shows their median, the middle 90 % and the share without a value.

    A model is left out if its class, by a user, overrides how the table is replayed.

    Raises:
        ValueError: if no link follows measurements.
    """
    traces = dict(_traces(scenario))
    if not traces:
        raise ValueError('no link follows measurements: a latency or loss of the kind "trace" or "signal_trace"')
    with styled((SIZE[0], SIZE[1] * len(traces) + LEGEND)) as figure:
        panels = figure.subplots(len(traces), 1, squeeze=False)[:, 0]
        for axes, (key, trace) in zip(panels, traces.items(), strict=True):
            _draw(axes, trace)
            axes.set_title(as_it_is(f"{key}: {trace.name}, column {trace.value}"), fontsize=9, wrap=True)
            label = next(label for kind, label in Y_LABELS.items() if isinstance(trace, kind))
            axes.set(xlabel="time of the measurements (s)", ylabel=label)
        handles = handles_of(panels)
        columns = 5 if max(map(len, handles)) <= SHORT else 3
        figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns, fontsize=8)
    return figure


def _traces(scenario: Scenario) -> Iterator[tuple[str, LinkTrace]]:
    """Yield the key and the model of each trace."""
    owners: list[tuple[str, Any]] = [("network", scenario.network)]
    owners += [(f"network.link.{k}", link) for k, link in enumerate(scenario.network.link)]
    for key, owner in owners:
        for name in ("latency", "loss"):
            if isinstance(model := getattr(owner, name), LinkTrace) and model.is_replayed:
                yield f"{key}.{name}", model


def _links(trace: LinkTrace) -> list[_Link]:
    """Return the links of a trace; of two directions with the same rows, the one from the lower node."""
    measured, arrow = trace.measurements, "↔" if trace.both_ways else "→"
    factor = 1000.0 if isinstance(trace, LatencyTrace) else 1.0
    links = []
    for src, dst, line in zip(measured.src, measured.dst, Playback(trace).lines(), strict=True):
        if not trace.both_ways or src < dst:
            times, values, is_missing = line
            label = "all links" if trace.src is None else f"{src} {arrow} {dst}"
            links.append(_Link(label, times, values * factor, is_missing))
    return links


def _draw(axes: Axes, trace: LinkTrace) -> None:
    """Draw the panel of one trace."""
    links, is_linear = _links(trace), trace.between == "linear"
    if len(links) > len(SERIES):
        _draw_many(axes, links, is_linear)
    else:
        for link, colour in zip(links, SERIES, strict=False):
            _draw_line(axes, link, colour, is_linear)
    if isinstance(trace, SignalTrace):
        axes.axhline(trace.threshold, color=GREY, lw=1.0, ls="--", label="threshold", zorder=1)
    if trace.start != "random" and trace.start > 0.0:
        axes.axvline(trace.start, color=GREY, lw=1.0, ls=":", label="start of the simulation", zorder=1)
    axes.set_xlim(0.0, trace.measurements.end / SECOND)


def _draw_line(axes: Axes, link: _Link, colour: str, is_linear: bool) -> None:
    """Draw a link; its line ends at the cross of a row without a value, and begins again at the next value."""
    # Two points for each row: a line that leads to a row without a value ends at the time of this row.
    ends = np.where(link.is_missing, np.nan, link.values)
    times, values = np.repeat(link.times, 2), np.column_stack((link.values, ends)).ravel()
    axes.plot(times, values, color=colour, lw=1.0, drawstyle="default" if is_linear else "steps-post", label=link.label)
    crossed = np.append(link.is_missing[:-1], False)  # the last row is the end of the trace
    if crossed.any():
        axes.plot(link.times[crossed], link.values[crossed], LOST_MARK, color=LOST, ms=4, lw=0.0, label="lost")


def _draw_many(axes: Axes, links: list[_Link], is_linear: bool) -> None:
    """Draw the median of the links that have a value and the middle 90 % of them, and the share of the others."""
    grid = np.linspace(0.0, links[0].times[-1], GRID, endpoint=False)
    rows = [link.times.searchsorted(grid, side="right") - 1 for link in links]
    pairs = list(zip(links, rows, strict=True))
    values = np.array(
        [np.interp(grid, link.times, link.values) if is_linear else link.values[row] for link, row in pairs]
    )
    has_value = ~np.array([link.is_missing[row] for link, row in pairs])
    low, median, high = np.full((3, GRID), np.nan)
    for k in range(GRID):
        if has_value[:, k].any():
            low[k], median[k], high[k] = np.quantile(values[has_value[:, k], k], (0.05, 0.5, 0.95))
    axes.fill_between(grid, low, high, color=BLUE, alpha=0.2, lw=0.0, label=f"middle 90 % of {len(links)} links")
    axes.plot(grid, median, color=BLUE, lw=1.2, label="median")
    if not has_value.all():
        right_axes = axes.twinx()
        right_axes.plot(grid, 1.0 - has_value.mean(axis=0), color=LOST, lw=0.8, ls=":")
        axes.plot([], [], color=LOST, lw=0.8, ls=":", label="share without a value")
        right_axes.set(ylim=(0.0, 1.0), ylabel="share without a value")
        right_axes.spines["right"].set_visible(True)

"""The space-time diagram of a run: a line per pursuer, time to the right, an arrow per message.

After Lamport 1978, "Time, Clocks, and the Ordering of Events in a Distributed System", figure 1. The arrow of
a message begins at its transmission and ends at its arrival. A message lost at transmission or in the queue has no
arrival time. It is drawn with the mean latency of the drawn messages that are not lost, and ends just short of the line
of its receiver. A message lost on arrival ends on the line of its receiver, with an asterisk if it collided.
"""

from collections.abc import Iterable, Sequence
from itertools import groupby
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from desim.analysis.activity import changes, changes_with_previous, chases, decisions
from desim.analysis.deliveries import Delivery, Interval, chasing, deliveries, outages
from desim.analysis.drawing.palette import CAPTURE_MARK, COLLISION_MARK, GREY, LOST, LOST_MARK
from desim.analysis.drawing.plots import NARROW, Axes, Figure, Style, as_it_is, figure_of, in_style, size_of, styled
from desim.analysis.trace_index import ended, started
from desim.config.arguments import value_text
from desim.config.errors import ArgumentError
from desim.config.python_numbers import real, whole
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.pursuit.core.events import Captured
from desim.pursuit.team.announcements import action_in_game
from desim.simulation.run import Result
from desim.view.pictures.paths import HALO, EvaderStyle

if TYPE_CHECKING:
    from matplotlib.artist import Artist

MAX_DENSITY = 24
"""Maximum number of messages that can be told apart per centimetre of width; half as many are easy to read."""
ARROWS: dict[str, Any] = {
    **{"angles": "xy", "scale_units": "xy", "scale": 1.0, "units": "inches", "width": 0.008},
    **{"headwidth": 6.0, "headlength": 7.0, "headaxislength": 6.0, "minshaft": 1.0, "minlength": 0.0},
}
"""Style of an arrow between two points in data coordinates; shaft width in inches, size of the head in shaft widths."""
LOSS_GAP = 0.25
"""Distance, in line spacings, between the receiver's line and the end of a message that has no arrival time."""
PALE = "#8c8c8c"
"""Colour of messages that announce inactivity; lighter in greyscale than messages that announce activity."""
MAX_SHOWN = 10
"""Maximum size of a team whose pursuers are all drawn by default."""
BUSIEST = 6
"""Number of pursuers that are drawn by default in a larger team."""
TOP = -0.8
"""The upper end of the vertical axis, in line spacings above the first line, which is at 0."""


def spacetime(
    result: Result,
    begin: float | None = None,
    end: float | None = None,
    pursuers: Sequence[int] | None = None,
    size: str | None = None,
    *,
    style: Style = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the messages among pursuers in a window of time, the decisions of these pursuers, captures and faults.

    The default window and pursuers give a legible number of messages.

    Args:
        result: the result of a run with recorded messages.
        begin: the start of the window, s; None = the start of the run.
        end: the end of the window, s; None = the end of the run, or earlier so that the messages stay legible.
        pursuers: the pursuers to draw, from top to bottom; None = all, or the six with the most changes of action in a
            team of more than ten.
        size: the width and, optionally, the height of the figure; a column of a paper is about 8.5 cm wide.
            None = "17cm".
        style: a style of matplotlib on top of that of desim.
        ax: the axes to draw on; None = a figure of its own.

    Raises:
        TypeError: if `ax` is not one pair of axes of matplotlib.
        ValueError: if the trace lacks messages that were sent, no pursuer is given, a pursuer does not exist or is
            given twice, the size is invalid, the window is empty, or it has too many messages to be told apart.
    """
    figure = None if ax is None else figure_of(ax, size=size)
    width, height = size_of(size or "17cm") if ax is None else (ax.get_window_extent().width / ax.figure.dpi, None)
    begin, end = (None if time is None else real(time, name) for time, name in ((begin, "begin"), (end, "end")))
    value: Any = pursuers  # as the caller gave it
    if value is not None and (isinstance(value, str) or not isinstance(value, Iterable)):
        raise ArgumentError("pursuers", f"should be a list of their numbers (got {value_text(value)})")
    shown = _busiest(result) if pursuers is None else [whole(pursuer, "a pursuer") for pursuer in pursuers]
    _check(result, shown, begin, end)
    window, shown_messages = _window(result, shown, begin, end, round(MAX_DENSITY * width * 2.54))

    def draw(axes: Axes) -> "dict[str, Artist]":
        rows = {pursuer: row for row, pursuer in enumerate(shown)}
        _draw_pursuers(axes, result, rows, window)
        _draw_outages(axes, result, rows, window)
        _draw_captures(axes, result, rows, window)
        _draw_messages(axes, shown_messages, rows, len(started(result).evaders))
        _draw_decisions(axes, result, rows, window)
        axes.set(xlabel="time (s)", ylabel="pursuer", xlim=[t / SECOND for t in window], ylim=(len(shown) - 0.4, TOP))
        axes.set_yticks(range(len(shown)), [str(pursuer) for pursuer in shown])
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        handles, labels = axes.get_legend_handles_labels()
        return dict(zip(labels, handles, strict=True))

    if ax is not None and figure is not None:
        with in_style(style):
            by_label = draw(ax)
            place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.01), "borderaxespad": 0.0}
            ax.legend(list(by_label.values()), list(by_label), fontsize=6, ncols=3, frameon=False, **place)
        return figure
    figsize = width, height or 1.2 + 0.3 * len(shown)
    with styled(figsize, font=7 if width < NARROW else 8, style=style) as figure:
        axes = figure.add_subplot()
        by_label = draw(axes)
        count = len(started(result).active)
        selection = f", {len(shown)} of {count} pursuers" if len(shown) < count else ""
        part = (
            ""
            if window == (0, ended(result).t)
            else f", {seconds(window.begin):.4g} to {seconds(window.end):.4g} s of {seconds(ended(result).t):.4g} s"
        )
        axes.set_title(as_it_is(f"{result.scenario.name}, seed {result.seed}{selection}{part}"), wrap=True)
        figure.legend(
            list(by_label.values()),
            list(by_label),
            loc="outside lower center",
            ncols=3 if width < NARROW else 5,
            columnspacing=1.0,
        )
    return figure


def _busiest(result: Result) -> list[int]:
    """Return the pursuers to draw by default, ascending: all, or those with the most changes of action."""
    size = len(started(result).active)
    if size <= MAX_SHOWN:
        return list(range(size))
    count = np.bincount([change.pursuer for change in changes(result)], minlength=size)
    return sorted(np.argsort(-count, kind="stable")[:BUSIEST].tolist())


def _check(result: Result, shown: Sequence[int], begin: float | None, end: float | None) -> None:
    """Raise ValueError if the pursuers to draw or the window, s, are wrong."""
    size, last = len(started(result).active), seconds(ended(result).t)
    for pursuer in shown:
        if not 0 <= pursuer < size:
            raise ArgumentError("pursuers", f": there is no pursuer {pursuer}: they are 0 .. {size - 1}")
    if len(set(shown)) < len(shown) or not shown:
        raise ArgumentError("pursuers", f"should be given once each, and at least one, got {list(shown)}")
    if begin is None and end is None and not last:
        raise ValueError("a run that lasted 0 s has no time to draw")
    if not 0.0 <= (begin or 0.0) < min(inf if end is None else end, last):
        until = "its end" if end is None else f"{end:g} s"
        window = f"the window from {begin or 0.0:g} s to {until}"
        raise ValueError(f"`begin`, `end`: {window} is empty: the run lasted {last:g} s")


def _window(
    result: Result, shown: Sequence[int], begin: float | None, end: float | None, most: int
) -> tuple[Interval, list[Delivery]]:
    """Return the time window (ns), and the deliveries in flight in it from and to the pursuers shown.

    If no end is given, the window ends with the run or, if it would then have more than `most` / 2 messages, after
    about this number of messages. Messages transmitted at the same time stay together.

    Raises:
        ValueError: if there are more than `most` deliveries; `most` is the number that can be told apart.
    """
    pursuers, first, last = set(shown), nanoseconds(begin or 0.0), ended(result).t
    if end is not None:
        last = min(nanoseconds(min(end, 1e9)), last)  # an `end` of inf has no ns
    messages = [
        message
        for message in deliveries(result)
        if message.src in pursuers and message.dst in pursuers and message.left <= last and message.until >= first
    ]
    if end is None and len(messages) > most // 2:
        last = next((message.left for message in messages[most // 2 :] if message.left > first), last)
        messages = [message for message in messages if message.left <= last]
    if len(messages) > most:
        next_left = messages[most].left
        latest = max((message.left for message in messages[:most] if message.left < next_left), default=first)
        advice = f"end the window at {seconds(latest):.9f} s, or " if latest > first else ""
        raise ValueError(
            f"{len(messages)} messages among {len(shown)} pursuers from {seconds(first):g} s to {seconds(last):g} s are"
            f" more than the {most} that can be told apart: {advice}choose fewer pursuers or a wider figure"
        )
    return Interval(first, last), messages


def _draw_pursuers(axes: Axes, result: Result, rows: dict[int, int], window: Interval) -> None:
    """Draw a line for each pursuer, thick while it is active; label chases by evader if there are several evaders."""
    chases_of, count = chasing(result), len(started(result).evaders)
    several = count > 1
    for row in rows.values():
        axes.plot([t / SECOND for t in window], [row, row], color=GREY, lw=0.6, zorder=1)
    inside = [
        (row, chase)
        for pursuer, row in rows.items()
        for chase in chases_of[pursuer]
        if chase.begin <= window.end and chase.end >= window.begin
    ]
    for row, chase in sorted(inside, key=lambda drawn: drawn[1].evader):  # the order of the legend
        x = [max(chase.begin, window.begin) / SECOND, min(chase.end, window.end) / SECOND]
        colour = EvaderStyle.of(chase.evader, count).alone
        label = f"chases {chase.evader}" if several else "active"
        axes.plot(x, [row, row], color=colour, lw=4.0, alpha=0.55, solid_capstyle="butt", zorder=2, label=label)
        if several:
            offset: dict[str, Any] = {"xytext": (1, 3), "textcoords": "offset points", "path_effects": HALO}
            axes.annotate(str(chase.evader), (x[0], row), **offset, color=colour, fontsize=6, zorder=6)


def _draw_outages(axes: Axes, result: Result, rows: dict[int, int], window: Interval) -> None:
    """Shade the faults: a crash on the line of its pursuer, other faults over the whole height.

    A fault of one pursuer that is not drawn, such as a liar, is left out.
    """
    inside = [outage for outage in outages(result) if outage[1].begin < window.end and outage[1].end > window.begin]
    level = 0
    for fault, (begin, end) in inside:
        x = max(begin, window.begin) / SECOND, min(end, window.end) / SECOND
        node, scope = (fault.sketch().get(key) for key in ("node", "scope"))
        if scope is None and node is not None and node not in rows:
            continue
        if scope is None:
            axes.axvspan(*x, color=GREY, alpha=0.18, lw=0, zorder=0)
            offset, level = (2, -2 - 8 * level), 1 - level  # labels alternate between two heights
            axes.annotate(fault.label, (x[0], TOP), offset, textcoords="offset points", va="top", fontsize=7)
        elif node in rows:
            row = rows[node]
            kind = "robot down" if scope == "robot" else "radio down"
            look: dict[str, Any] = {"hatch": "/////" if scope == "robot" else "xxxx"}
            axes.fill_between(x, row - 0.3, row + 0.3, fc="white", ec=GREY, lw=0.6, zorder=1.5, label=kind, **look)


def _draw_captures(axes: Axes, result: Result, rows: dict[int, int], window: Interval) -> None:
    """Draw the captures: the time, the capturing pursuer and, if there are several evaders, the captured evader."""
    several = len(started(result).evaders) > 1
    for t, evader, capturer in result.trace.of(Captured):
        if window.begin <= t <= window.end:
            axes.axvline(t / SECOND, color="black", lw=0.8, ls=(0, (4, 2)), zorder=1)
            text = f"{evader} captured" if several else "captured"
            axes.annotate(
                text, (t / SECOND, TOP), (-2, -2), textcoords="offset points", va="top", ha="right", fontsize=7
            )
            if capturer in rows:
                look: dict[str, Any] = {"color": "black", "ms": 8, "zorder": 6, "clip_on": False, "ls": ""}
                axes.plot(t / SECOND, rows[capturer], CAPTURE_MARK, label="captures", **look)


def _draw_messages(axes: Axes, messages: Sequence[Delivery], rows: dict[int, int], evaders: int) -> None:
    """Draw lost messages as dotted lines to a cross or, for a collision, an asterisk, and all others as arrows."""

    def kind(message: Delivery) -> tuple[str, str]:
        """Return the colour and the label of a message."""
        announced = action_in_game(message.body, evaders)
        if announced is None:
            return "#555555", "message"
        if not announced:
            return PALE, "message: inactive"
        colour = EvaderStyle.of(announced, evaders).alone
        return colour, f"message: chases {announced}" if evaders > 1 else "message: active"

    arrived = sorted((message for message in messages if message.cause is None), key=kind)
    for (colour, label), group in groupby(arrived, kind):
        t, row = _ends(list(group), rows)
        axes.quiver(*t[0:1], *row[0:1], *(t[1:] - t[:1]), *(row[1:] - row[:1]), color=colour, zorder=3.0, **ARROWS)
        axes.plot([], [], color=colour, marker=">", ms=4, lw=1.0, label=label)
    lost = [message for message in messages if message.cause is not None]
    if not lost:
        return
    flights = [message.until - message.left for message in arrived]
    latency = float(np.mean(flights)) / SECOND if flights else 0.0
    t, row = _ends(lost, rows)
    collided = np.array([message.cause == "collision" for message in lost])
    # An acknowledged message that is given up after collisions also has two equal times, but it ends at its receiver.
    has_no_arrival = (t[1] == t[0]) & ~collided
    share = np.where(has_no_arrival, 1.0 - LOSS_GAP / np.abs(row[1] - row[0]), 1.0)
    t[1] += np.where(has_no_arrival, latency * share, 0.0)
    row[1] = row[0] + share * (row[1] - row[0])
    gaps = np.full(len(lost), np.nan)
    axes.plot(np.stack([*t, gaps], 1).ravel(), np.stack([*row, gaps], 1).ravel(), color=LOST, ls=":", lw=0.8, zorder=3)
    marks: list[tuple[str, Any, float, Any]] = [
        ("lost message", LOST_MARK, 4.0, ~collided),
        ("collision", COLLISION_MARK, 6.5, collided),
    ]
    for label, mark, size, mask in marks:
        if mask.any():
            axes.plot(t[1][mask], row[1][mask], color=LOST, marker=mark, ls="", ms=size, mew=1.0, zorder=4)
            axes.plot([], [], color=LOST, ls=":", marker=mark, ms=size, lw=1.0, label=label)


def _ends(messages: Sequence[Delivery], rows: dict[int, int]) -> tuple[Any, Any]:
    """Return the (2, k) times, s, and the (2, k) rows at which deliveries begin and end."""
    t = np.array([(message.left, message.until) for message in messages], dtype=float).T / SECOND
    return t, np.array([(rows[message.src], rows[message.dst]) for message in messages], dtype=float).T


def _draw_decisions(axes: Axes, result: Result, rows: dict[int, int], window: Interval) -> None:
    """Mark the decisions: a tick if the action is kept, a triangle or a diamond if it changes."""
    changed = {id(change) for change in changes(result)}
    switches = {id(change) for change, before in changes_with_previous(result) if before and chases(change)}
    looks: dict[str, dict[str, Any]] = {
        "keeps action": {"marker": "|", "color": "black", "ms": 5},
        "starts": {"marker": "^", "mfc": "black", "mec": "black", "ms": 5},
        "switches evader": {"marker": "D", "mfc": "black", "mec": "black", "ms": 4},
        "stops": {"marker": "v", "mfc": "white", "mec": "black", "ms": 5},
    }
    marked: dict[str, list[tuple[float, int]]] = {label: [] for label in looks}
    for decision in decisions(result):
        if window.begin <= decision.t <= window.end and decision.pursuer in rows:
            label = "switches evader" if id(decision) in switches else "starts" if chases(decision) else "stops"
            place = decision.t / SECOND, rows[decision.pursuer]
            marked[label if id(decision) in changed else "keeps action"].append(place)
    for label, places in marked.items():
        if places:
            axes.plot(*zip(*places, strict=True), ls="", zorder=5, clip_on=False, label=label, **looks[label])

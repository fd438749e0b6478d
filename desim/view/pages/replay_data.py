"""The data of a replay: a JSON object with what a run recorded, in columns.

The page draws a message as a point that moves at constant speed from the position of its sender at transmission to that
of its receiver at arrival. A lost message ends in a cross, a collision in an asterisk. Both appear at the time of the
loss, whatever its cause, just short of the receiver that did not get the message.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator

import numpy as np

from desim.analysis.activity import Change, Released, action, activity, changes, changes_with_previous
from desim.analysis.deliveries import delivery_table, handover_events, outages
from desim.analysis.knowledge import Pieces, knowledge
from desim.analysis.trace_index import captures, ended, lacks_messages, messages, started
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Distrusted
from desim.simulation.run import Result
from desim.view.pages.headline import outcome, run_name
from desim.view.pages.replay_columns import ReplayData, Ticks, packed_column
from desim.view.pages.replay_plane import (
    arcs_data,
    estimates_data,
    flow_data,
    headings_data,
    path_data,
    reception_data,
    walls_data,
)

MANY_MESSAGES, COARSE_TICK = 1_000_000, 10_000
"""With more than `MANY_MESSAGES`, a tick has at least `COARSE_TICK` ns: latencies then take two bytes, not four.

This tick is shorter than a frame at the slowest speed.
"""
PARTS = 3
"""How often `on_part` is called for a page: after the messages, the beliefs, and the rest."""
DECIDED, BROKE_DOWN, RELEASED = range(3)
"""The cause of a pursuer's action: a decision, a breakdown of the pursuer, or the capture of its evader."""


def replay_data(
    result: Result, ghost: Result | None = None, on_part: Callable[[], object] = lambda: None
) -> ReplayData:
    """Return the data of the page; `on_part` is called after the messages and after the beliefs, the longest parts."""
    start, end, scenario = started(result), ended(result), result.scenario
    shortest = COARSE_TICK if messages(result).sent > MANY_MESSAGES else 1
    ticks = Ticks.fit(end.t, ended(ghost).t if ghost else 0, shortest)
    has_messages = not lacks_messages(result)
    message_columns = _messages(result, ticks) if has_messages else None
    on_part()
    beliefs = _beliefs(knowledge(result), result, ticks) if has_messages else None
    on_part()
    return {
        "tick": ticks.length / SECOND,
        "end": ticks.last,
        "evaders": len(start.evaders),
        "captures": [
            {"t": ticks.nearest(capture.t), "evader": capture.evader, "capturer": capture.capturer}
            for capture in captures(result)
        ],
        "radius": scenario.capture.radius,
        "sensing_range": scenario.sensing.radius if scenario.sensing.limited else None,
        "arcs": arcs_data(result),
        "reception": reception_data(result),
        "speeds": list(start.speeds),
        "active": list(start.active),
        "path": path_data(result, ticks),
        "headings": headings_data(result),
        "estimates": estimates_data(result, ticks),
        "flow": flow_data(result, ticks),
        "walls": walls_data(result),
        "decisions": _decisions(result, ticks),
        "relays": _relays(result, ticks),
        "faults": _faults(result, ticks),
        "messages": message_columns,
        "beliefs": beliefs,
        "distrust": _distrust(result, ticks),
        "ghost": _ghost(ghost, Ticks(ticks.length, ended(ghost).t)) if ghost else None,
    }


def _decisions(result: Result, ticks: Ticks) -> ReplayData:
    """Return as columns the decisions, the breakdowns, and the releases of pursuers by the capture of their evader."""
    events = list(_events_with_action(result))
    causes = {Decided: DECIDED, BrokeDown: BROKE_DOWN, Released: RELEASED}
    return {
        "t": ticks([event.t for event in events]),
        "who": packed_column([event.pursuer for event in events], "<u2"),
        "active": packed_column([action(event) for event in events], _action_dtype(result)),
        "cause": packed_column([causes[type(event)] for event in events], "u1"),
    }


def _events_with_action(result: Result) -> Iterator[Change]:
    """Yield the events that set an action, in order, whether or not they change it."""
    released: defaultdict[int, list[Change]] = defaultdict(list)
    for change, before in changes_with_previous(result):
        if isinstance(change, Released):
            released[before].append(change)
    for event in result.trace:
        if isinstance(event, Decided | BrokeDown):
            yield event
        elif isinstance(event, Captured):
            yield from released[event.evader]


def _action_dtype(result: Result) -> str:
    """Return the dtype of a column of actions, with M evaders: 0 .. M, and M + 1 for unknown."""
    return "u1" if len(started(result).evaders) < 255 else "<u2"


def _relays(result: Result, ticks: Ticks) -> ReplayData:
    """Return the handovers (`desim.analysis.deliveries.Handover`) as columns."""
    handovers = handover_events(result)
    return {
        "t": ticks([handover.t for handover in handovers]),
        "who": packed_column([handover.pursuer for handover in handovers], "<u2"),
        "evader": packed_column([handover.evader for handover in handovers], "<u2"),
    }


def _faults(result: Result, ticks: Ticks) -> list[ReplayData]:
    """Return the faults with their intervals, in order of time."""
    return [
        {"kind": fault.kind, "label": fault.label, "begin": ticks.nearest(begin), "end": ticks.nearest(end)}
        | fault.sketch()
        for fault, (begin, end) in outages(result)
    ]


def _messages(result: Result, ticks: Ticks) -> ReplayData:
    """Return the transmissions as columns in order of time, and their deliveries as columns grouped by transmission.

    The page shows a message from the instant at which it is sent or queued (`begin`) until it arrives or is lost. The
    message leaves its sender at the start of its transmission (`left`).
    """
    table = delivery_table(result)
    first = np.flatnonzero(np.diff(table.transmission, prepend=-1))
    return {
        "begin": ticks(table.created[first]),
        "left": ticks(table.left[first]),
        "src": packed_column(table.src[first], "<u2"),
        "count": packed_column(np.diff(first, append=len(table.dst)), "<u2"),
        "dst": packed_column(table.dst, "<u2"),
        "end": ticks(table.until),
        "fate": packed_column(table.cause + 1, "u1"),
        "causes": [cause.replace("_", " ") for cause in table.causes],
    }


def _beliefs(pieces: Pieces, result: Result, ticks: Ticks) -> ReplayData:
    """Return the changes of beliefs as columns: time, reader, source, and the action of the source as last received.

    The reader is the pursuer that holds the belief; the source is the pursuer that the belief is about. An action is
    0 .. M, or M + 1 if it is unknown: nothing was received since the start or since a loss of memory. With
    `announce.start` = "known", the initial actions are known. Of several changes at one instant, the last one counts.
    """
    unknown = len(started(result).evaders) + 1
    # A row that is superseded at once does not count, such as an initial belief without latency. Columns are read one
    # by one, because it is slow to copy the wide rows of `pieces`.
    lasting = np.flatnonzero(~pieces["superseded"] | (pieces["until"] > pieces["begin"]))
    reader, source, begin = (pieces[name][lasting] for name in ("reader", "source", "begin"))
    is_certain = (result.scenario.announce.start == "known") & (begin == 0)
    value = np.where(pieces["presumed"][lasting] & ~is_certain, unknown, pieces["active"][lasting].astype(int))
    changed = np.ones(len(lasting), bool)
    changed[1:] = (reader[1:] != reader[:-1]) | (source[1:] != source[:-1]) | (value[1:] != value[:-1])
    order = np.flatnonzero(changed)
    order = order[np.argsort(begin[order], kind="stable")]
    return {
        "t": ticks(begin[order]),
        "reader": packed_column(reader[order], "<u2"),
        "source": packed_column(source[order], "<u2"),
        "value": packed_column(value[order], _action_dtype(result)),
    }


def _distrust(result: Result, ticks: Ticks) -> ReplayData | None:
    """Return the changes of trust as columns: time, pursuer, suspect, and whether it begins; None if there are none."""
    events = result.trace.of(Distrusted)
    if not events:
        return None
    return {
        "t": ticks([event.t for event in events]),
        "who": packed_column([event.pursuer for event in events], "<u2"),
        "suspect": packed_column([event.suspect for event in events], "<u2"),
        "begins": packed_column([event.distrusted for event in events], "u1"),
    }


def _ghost(result: Result, ticks: Ticks) -> ReplayData:
    """Return the part of another run that is shown: its positions, walls, and number of active pursuers over time."""
    times = [0, *(change.t for change in changes(result))]
    return {
        "name": f"{run_name(result)}, {outcome(result)}",
        "end": ticks.last,
        "pursuers": len(started(result).active),
        "evaders": len(started(result).evaders),
        "path": path_data(result, ticks),
        "walls": walls_data(result),
        "active": {"t": ticks(times), "count": packed_column(activity(result)[1], "<u4")},
    }

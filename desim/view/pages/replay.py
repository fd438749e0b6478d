"""The replay of a run: one self-contained HTML page; equal runs give equal bytes.

In the data of the page, times are whole ticks (see `_Ticks`). Positions are whole millimetres or, beyond about 1000 km,
multiples of a coarser unit. Columns of numbers are little-endian typed arrays in base64.
"""

from base64 import b64encode
from cmath import phase
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from itertools import groupby
from math import atan2, isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from desim.analysis.activity import Change, Released, action, changes_with_previous, chases
from desim.analysis.drawing import palette
from desim.analysis.knowledge import Pieces, knowledge
from desim.analysis.trace_index import (
    captures,
    ended,
    lacks_messages,
    messages,
    positions_known,
    samples,
    started,
    trace_index,
)
from desim.config.arrays import Floats
from desim.config.model import Value
from desim.config.traits import kind_of, name_of
from desim.config.trust import escaped, write_whole
from desim.kernel.core.units import SECOND, seconds
from desim.kernel.models.faults import TracedFault
from desim.kernel.models.graphs import Complete
from desim.kernel.models.implicit_complete import is_complete
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Unlimited, contends
from desim.kernel.models.reception import Disk
from desim.kernel.topology.topology import Topology
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Distrusted, Estimated
from desim.pursuit.core.state import coordinates
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result
from desim.view.data.deliveries import deliveries, handover_events, outages
from desim.view.data.headings import Headings

MAX_REPLAY_TIME = 2**32 - 1
"""The largest tick that a column can hold."""
DECIDED, BROKE_DOWN, RELEASED = range(3)
"""The cause of a pursuer's action: a decision, a breakdown of the pursuer, or the capture of its evader."""
SAMPLES = 0.05
"""Time between samples of positions, s, in a run for a replay if the scenario does not record positions."""
TURN = 256
"""Number of units of an angle in a full turn."""
MAX_LENGTH = 2**30
"""The greatest position and semi-axis of an estimate that is stored; greater ones are off the plane."""
FLOW_POINTS, FLOW_TIMES = 12, 60
"""Number of intervals along the longer side of the grid on which a flow is shown, and of times at which it is."""
FLOW_MARGIN = 1.0
"""Margin of this grid around all paths, m."""
HEIGHT = 760
"""The height of a replay in a notebook, in pixels of CSS."""
TRIGGERS = {
    "change": "announced on change",
    "revision": "announced at every revision",
    "never": "nothing announced",
}
"""By trigger, the description of the announcements of a run without heartbeats."""
ReplayData = dict[str, Any]
"""A JSON object."""


@dataclass(frozen=True, repr=False)
class Replay:
    """A page that plays a run: `desim.replay(result)` at the end of a cell shows it in a notebook."""

    page: str
    """The page as HTML; see `replay_page`."""
    name: str
    """The name of the run."""

    def write(self, path: str | Path) -> Path:
        """Write the page to a file, and return its path.

        Raises:
            OSError: if the file cannot be written.
        """
        write_whole(Path(path), self.page.encode())
        return Path(path)

    def __repr__(self) -> str:
        return f"<Replay of {escaped(self.name)}>"

    def _repr_html_(self) -> str:
        """Return a frame with the page, whose script has no access to the notebook."""
        look = f"width: 100%; height: {HEIGHT}px; border: 0"
        return f'<iframe srcdoc="{escape(self.page)}" sandbox="allow-scripts allow-downloads" style="{look}"></iframe>'


def replay(result: Result, ghost: Result | None = None) -> Replay:
    """Create the replay of a run, a page to show in a notebook or to save with `write`; needs jinja2 (extra `plot`).

    Args:
        result: the run.
        ghost: another run, drawn faint in the same plane, for example with the same seed and another latency; None = no
            other run.
    """
    return Replay(replay_page(result, ghost), run_name(result))


def replay_page(result: Result, ghost: Result | None = None) -> str:
    """Return a self-contained HTML page that plays a run; needs jinja2 (the extra `plot`); see `replay`.

    Args:
        result: the run.
        ghost: another run to compare it with, perhaps with other players or another duration; None = no other run. The
            players of the ghost and their trails are drawn faint in the same plane, and its number of active pursuers
            is a dashed line on the time axis.
    """
    from jinja2 import Environment

    result, ghost = trace_index(result), ghost and trace_index(ghost)
    template = files("desim.view.pages").joinpath("replay.html").read_text(encoding="utf-8")
    page = Environment(autoescape=True, keep_trailing_newline=True).from_string(template)
    return page.render(
        name=result.scenario.name,
        about=_about(result),
        conditions=conditions(result.scenario),
        palette=palette,
        warnings=list(missing_recordings(result, ghost)),
        run=_document(result, ghost),
    )


def with_recordings(scenario: Scenario) -> Scenario:
    """Return a copy of a scenario that records what a replay needs: messages and positions.

    If the scenario records positions already, the time between samples is kept; otherwise it is `SAMPLES`. Estimates
    are recorded if they have covariances.
    """
    record, has_covariances = scenario.record, scenario.sensing.has_covariances
    update = {"messages": True, "trajectory": record.trajectory or SAMPLES, "estimates": has_covariances}
    return scenario.model_copy(update={"record": record.model_copy(update=update)})


def missing_recordings(result: Result, ghost: Result | None = None) -> Iterator[str]:
    """Yield a warning for each part of the replay of a run, and of its ghost, that cannot be shown."""
    if not positions_known(result):
        yield (
            "Positions were not recorded: players and links are shown at the initial positions throughout. Set "
            "record.trajectory to a time greater than 0 s."
        )
    if not _falls(result.scenario.network):
        yield "Links are not shown: the reception probability does not decrease monotonically with the distance."
    if lacks_messages(result):
        yield (
            f"Messages were not recorded: neither the {messages(result).sent:,} messages sent nor the beliefs are "
            "shown. Set record.messages = true."
        )
    if ghost is not None and not positions_known(ghost):
        yield "Positions of the other run were not recorded: its players are shown at the initial positions throughout."


def run_name(result: Result) -> str:
    """Return the name of a run: the name of its scenario, and its seed."""
    return f"{result.scenario.name}, seed {result.seed}"


def _about(result: Result) -> str:
    """Return a one-line description of a run: players, protocol, seed and outcome."""
    players = f"{len(started(result).active)} pursuers"
    if (count := len(started(result).evaders)) > 1:
        players = f"{players}, {count} evaders"
    return f"{players}, {result.scenario.protocol_name}, seed {result.seed}: {_outcome(result)}"


def _outcome(result: Result) -> str:
    """Return the outcome of a run as text: the captures and the time of its end."""
    end = ended(result)
    if (count := len(started(result).evaders)) > 1:
        how = {
            "captured": f", the last by {end.capturer} after {seconds(end.t):.2f} s",
            "horizon": f" within {seconds(end.t):g} s",
            "stopped": f", stopped after {seconds(end.t):.2f} s",
        }
        return f"captured {len(captures(result))} of {count}{how[end.reason]}"
    return {
        "captured": f"captured by {end.capturer} after {seconds(end.t):.2f} s",
        "horizon": f"not captured within {seconds(end.t):g} s",
        "stopped": f"stopped after {seconds(end.t):.2f} s",
    }[end.reason]


def conditions(scenario: Scenario) -> str:
    """Return a one-line description of the communication: latency, loss, range, announcements, other models."""
    links, announce = scenario.network, scenario.announce
    latency, loss = links.latency, links.loss
    parts = [
        f"latency {_number(latency.value)} s" if type(latency) is Constant else f"latency {_model(latency)}",
        f"loss {_number(100.0 * loss.p)} %" if type(loss) is Bernoulli else f"loss {_model(loss)}",
        f"range {_number(links.range)} m" if isfinite(links.range) else "unlimited range",
        f"heartbeat {_number(announce.heartbeat)} s" if announce.has_heartbeats else TRIGGERS[announce.trigger],
    ]
    if isfinite(links.range) and type(links.reception) is not Disk:
        parts.append(f"reception {_model(links.reception)}")
    if type(links.graph) is not Complete:
        parts.append(f"graph {_model(links.graph)}")
    if type(links.medium) is not Unlimited:
        parts.append(f"medium {_model(links.medium)}")
    if contends(links.medium):
        parts.append(f"access {_model(links.medium.access)}, interference {_model(links.medium.reception)}")
    if links.link:
        parts.append(f"{len(links.link)} link{'s' if len(links.link) > 1 else ''} with other models")
    return ", ".join(parts)


def _model(model: Any) -> str:
    """Return a model as text: its kind and its numbers except 0 and inf; if it is not a `Value`, its name."""
    if not isinstance(model, Value):
        return name_of(model)
    parameters = {name: value for name, value in model if name not in model.unused_fields}
    shown = [
        f"{name.replace('_', ' ')} {_number(number)}"
        for name, number in parameters.items()
        if type(number) in {int, float} and isfinite(number) and number
    ]
    name = kind_of(model).replace("_", " ")
    return f"{name} ({', '.join(shown)})" if shown else name


def _number(number: float) -> str:
    return f"{number:,.0f}" if number == round(number) else f"{number:.4g}"


class _Ticks(NamedTuple):
    """The tick, the unit of time in the page: the shortest one of 1, 10, ... ns with fewer than 2^31 ticks in a run."""

    length: int
    """Duration of a tick, ns."""
    end: int
    """End of the run, ns."""

    @classmethod
    def fit(cls, end: int, other_end: int = 0) -> "_Ticks":
        """Return the ticks of a run, such that another run has fewer than 2^31 of them, too; both ends in ns."""
        length = 1
        while max(end, other_end) // length >= 2**31:
            length *= 10
        return cls(length, end)

    @property
    def last(self) -> int:
        """The tick at which the run ends."""
        return self.nearest(self.end)

    def nearest(self, t: int) -> int:
        """Return the tick nearest to a time (ns)."""
        return (t + self.length // 2) // self.length

    def __call__(self, times: ArrayLike) -> str:
        """Return times (ns) as a column of ticks; times after the end of the run map to ticks after `last`."""
        instants = np.asarray(times, np.int64)
        ticks = (instants + self.length // 2) // self.length
        ticks = np.where(instants > self.end, np.maximum(ticks, self.last + 1), ticks)
        return _column(np.minimum(ticks, MAX_REPLAY_TIME), "<u4")


def _column(values: ArrayLike, kind: str) -> str:
    """Return numbers as a column of a NumPy dtype.

    Raises:
        ValueError: if a number does not fit the dtype.
    """
    numbers = np.asarray(values)
    column = numbers.astype(kind)
    if not np.array_equal(column, numbers):
        raise ValueError(f"a replay cannot store {np.abs(numbers).max()} in a column of {np.dtype(kind).name}")
    return b64encode(column.tobytes()).decode()


def _document(result: Result, ghost: Result | None = None) -> ReplayData:
    """Return the data of the page."""
    start, end, scenario = started(result), ended(result), result.scenario
    ticks = _Ticks.fit(end.t, ended(ghost).t if ghost else 0)
    has_messages = not lacks_messages(result)
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
        "arcs": _arcs(result),
        "reception": _reception(result),
        "speeds": list(start.speeds),
        "active": list(start.active),
        "path": _path(result, ticks),
        "headings": _headings(result),
        "estimates": _estimates(result, ticks),
        "flow": _flow(result, ticks),
        "decisions": _decisions(result, ticks),
        "relays": _relays(result, ticks),
        "faults": _faults(result, ticks),
        "messages": _messages(result, ticks) if has_messages else None,
        "beliefs": _beliefs(knowledge(result), result, ticks) if has_messages else None,
        "distrust": _distrust(result, ticks),
        "ghost": _ghost(ghost, _Ticks(ticks.length, ended(ghost).t)) if ghost else None,
    }


def _arcs(result: Result) -> str | None:
    """Return the edges (sender, receiver) of the communication graph as a column; None if the graph is complete."""
    size = len(started(result).active)
    graph = result.scenario.network.make_graph(size)
    return None if is_complete(graph) else _column(sorted(graph.to_directed().edges), "<u2")


def _reception(result: Result) -> ReplayData:
    """Return the maximum distances, m, of reception between linked pursuers.

    `radius` is common to all pairs of pursuers. If fading is drawn once per link, `radii` has a distance for each pair
    i < j instead. If fading is drawn for each message (`chance` is true), `radius` is the distance at which the
    reception probability is 0.5. If the range is unlimited, both are None. Both are also None, and `known` is false, if
    the reception probability increases with distance anywhere.
    """
    links, size = result.scenario.network, len(started(result).active)
    reception: ReplayData = {"known": True, "chance": False, "radius": None, "radii": None}
    if not isfinite(links.range):
        return reception
    if type(links.reception) is Disk:
        return reception | {"radius": links.range}
    if not _falls(links):
        return reception | {"known": False}
    places = _places(result)
    farthest = 2.0 * float(np.hypot(*np.ptp(places.reshape(-1, 2), axis=0))) + 1.0
    if links.fading == "message":
        return reception | {"chance": True, "radius": _radii(links, 2, result.seed, farthest)[0, 1]}
    return reception | {"radii": _column(_radii(links, size, result.seed, farthest)[np.triu_indices(size, 1)], "<f8")}


def _falls(links: Links) -> bool:
    """Return whether the reception probability never increases along 1000 distances up to 4 times the range.

    If the range is unlimited, the result is true.
    """
    if not isfinite(links.range):
        return True
    chance = links.reception(np.linspace(0.0, 4.0 * links.range, 1001)[1:], links.range)
    return not (np.diff(chance) > 1e-12).any()


def _radii(links: Links, size: int, seed: int, farthest: float) -> Floats:
    """Return the (size, size) maximum distances, m, of reception between nodes, by bisection up to `farthest`."""
    places = np.zeros((size, 2))
    radii = np.zeros((size, size))
    graph = Complete()(size)
    per_link = links.fading == "per_link"
    topology = Topology(graph, links.range, lambda: places, links.reception, per_link=per_link, seed=seed)
    for node in range(size):
        low, high = np.zeros(size), np.full(size, farthest)
        for _ in range(64):
            places[:, 0] = middle = (low + high) / 2.0
            places[node] = 0.0
            heard = np.isin(np.arange(size), topology.neighbours(node))
            low, high = np.where(heard, middle, low), np.where(heard, high, middle)
        radii[node] = low
    return radii


def _places(result: Result) -> Floats:
    """Return the (samples, N + M, 2) positions, m, of all players, pursuers first."""
    return np.array([[*sample.pursuers, *sample.evaders] for sample in samples(result)])


def _per_metre(places: Floats) -> float:
    """Return the units of length per metre: 1000, divided by 10 until positions and their increments fit 32 bits."""
    per_metre = 1000.0
    while np.abs(places).max() * per_metre >= 2**30:
        per_metre /= 10.0
    return per_metre


def _path(result: Result, ticks: _Ticks) -> ReplayData:
    """Return the positions of all players, pursuers first: the initial ones and the increments at each sample."""
    places = _places(result)
    per_metre = _per_metre(places)
    units = np.rint(places * per_metre).astype(np.int64).reshape(len(places), -1)
    shifts = np.diff(units, axis=0)
    kind = "<i2" if np.abs(shifts).max(initial=0) < 2**15 else "<i4"
    return {
        "t": ticks([sample.t for sample in samples(result)]),
        "per_metre": per_metre,
        "start": _column(units[0], "<i4"),
        "bits": 8 * np.dtype(kind).itemsize,
        "shifts": _column(shifts, kind),
    }


def _headings(result: Result) -> ReplayData | None:
    """Return the players with inertia, and their headings at each sample as a column; None without such players.

    The unit is a `TURN`th of a full turn, from the x axis to the left.
    """
    headings = Headings(result.scenario, result.seed)
    if not headings.players:
        return None
    angles = np.array([[*map(phase, headings.at(sample))] for sample in samples(result)])
    turns = np.rint(angles * (TURN / (2.0 * np.pi))).astype(int) % TURN
    return {"players": list(headings.players), "turn": TURN, "values": _column(turns, "u1")}


def _estimates(result: Result, ticks: _Ticks) -> ReplayData | None:
    """Return the recorded estimates of the evaders as columns: the ellipses of one standard deviation; None if none.

    Positions and semi-axes have the unit of the path; the angle of the major axis is that of `_headings`.
    """
    estimates = result.trace.of(Estimated)
    if not estimates:
        return None
    per_metre = _per_metre(_places(result))
    mean, half = (
        np.array([(estimate.xx + sign * estimate.yy) / 2.0 for estimate in estimates]) for sign in (1.0, -1.0)
    )
    offset = np.hypot(
        half, [estimate.xy for estimate in estimates]
    )  # of the two eigenvalues of a covariance from their mean
    variances = np.column_stack([mean + offset, mean - offset])
    semi_axes = np.minimum(np.sqrt(np.maximum(variances, 0.0)) * per_metre, MAX_LENGTH)
    angles = np.array([atan2(estimate.xy, (estimate.xx - estimate.yy) / 2.0) / 2.0 for estimate in estimates])
    centres = np.clip(
        np.array([[estimate.x, estimate.y] for estimate in estimates]) * per_metre, -MAX_LENGTH, MAX_LENGTH
    )
    return {
        "t": ticks([estimate.t for estimate in estimates]),
        "pursuer": _column([estimate.pursuer for estimate in estimates], "<u2"),
        "evader": _column([estimate.evader for estimate in estimates], "<u2"),
        "centres": _column(np.rint(centres), "<i4"),
        "semi_axes": _column(np.rint(semi_axes), "<i4"),
        "turn": TURN,
        "angles": _column(np.rint(angles * (TURN / (2.0 * np.pi))).astype(int) % TURN, "u1"),
    }


def _flow(result: Result, ticks: _Ticks) -> ReplayData | None:
    """Return the velocities of the flow on a square grid over the paths, at some times, as columns; None without flow.

    `velocities` has the x, y (m/s) of each point of the grid, row by row, at each time; `top` is the greatest speed.
    """
    environment = result.scenario.environment
    if environment.is_still:
        return None
    places = _places(result).reshape(-1, 2)
    (left, low), (right, high) = places.min(axis=0) - FLOW_MARGIN, places.max(axis=0) + FLOW_MARGIN
    edge = max(right - left, high - low) / FLOW_POINTS
    x, y = np.arange(left, right + edge, edge), np.arange(low, high + edge, edge)
    grid = (x[None, :] + 1j * y[:, None]).ravel()
    times = np.linspace(0, ended(result).t, FLOW_TIMES).astype(np.int64)
    velocities = np.array([coordinates(environment.velocities(grid, t / SECOND)) for t in times.tolist()])
    if (velocities == velocities[0]).all():
        times, velocities = times[:1], velocities[:1]
    return {
        "on": environment.on,
        "t": ticks(times),
        "start": [float(left), float(low)],
        "edge": float(edge),
        "columns": len(x),
        "top": float(np.hypot(*velocities.reshape(-1, 2).T).max()),
        "velocities": _column(velocities.astype("<f4"), "<f4"),
    }


def _decisions(result: Result, ticks: _Ticks) -> ReplayData:
    """Return as columns the decisions, the breakdowns, and the releases of pursuers by the capture of their evader."""
    events = list(_acts(result))
    why = {Decided: DECIDED, BrokeDown: BROKE_DOWN, Released: RELEASED}
    return {
        "t": ticks([event.t for event in events]),
        "who": _column([event.pursuer for event in events], "<u2"),
        "active": _column([action(event) for event in events], _kind(result)),
        "cause": _column([why[type(event)] for event in events], "u1"),
    }


def _acts(result: Result) -> Iterator[Change]:
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


def _kind(result: Result) -> str:
    """Return the dtype of a column of actions, with M evaders: 0 .. M, and M + 1 for unknown."""
    return "u1" if len(started(result).evaders) < 255 else "<u2"


def _relays(result: Result, ticks: _Ticks) -> ReplayData:
    """Return the handovers (`desim.view.data.deliveries.Handover`) as columns."""
    handovers = handover_events(result)
    return {
        "t": ticks([handover.t for handover in handovers]),
        "who": _column([handover.pursuer for handover in handovers], "<u2"),
        "evader": _column([handover.evader for handover in handovers], "<u2"),
    }


def _faults(result: Result, ticks: _Ticks) -> list[ReplayData]:
    """Return the faults with their intervals, in order of time."""
    return [_fault(fault, interval.begin, interval.end, ticks) for fault, interval in outages(result)]


def _fault(fault: TracedFault, begin: int, until: int, ticks: _Ticks) -> ReplayData:
    """Return the data of a fault that lasted from `begin` to `until` (ns)."""
    when = {"begin": ticks.nearest(begin), "end": ticks.nearest(until)}
    return {"kind": fault.kind, "label": fault.label} | when | fault.sketch()


def _messages(result: Result, ticks: _Ticks) -> ReplayData:
    """Return the transmissions as columns in order of time, and their deliveries as columns grouped by transmission.

    The page shows a message from the instant at which it is sent or queued (`begin`) until it arrives or is lost. The
    message leaves its sender at the start of its transmission (`left`).
    """
    sent = sorted(deliveries(result), key=lambda delivery: (delivery.created, delivery.transmission, delivery.dst))
    rows = [list(row) for _, row in groupby(sent, key=lambda delivery: delivery.transmission)]
    causes = sorted({delivery.cause for delivery in sent if delivery.cause is not None})
    number = {None: 0} | {cause: k for k, cause in enumerate(causes, start=1)}
    return {
        "begin": ticks([row[0].created for row in rows]),
        "left": ticks([row[0].left for row in rows]),
        "src": _column([row[0].src for row in rows], "<u2"),
        "count": _column([len(row) for row in rows], "<u2"),
        "dst": _column([delivery.dst for delivery in sent], "<u2"),
        "end": ticks([delivery.until for delivery in sent]),
        "fate": _column([number[delivery.cause] for delivery in sent], "u1"),
        "causes": [cause.replace("_", " ") for cause in causes],
    }


def _beliefs(pieces: Pieces, result: Result, ticks: _Ticks) -> ReplayData:
    """Return the changes of beliefs as columns: time, reader, source, and the action of the source as last received.

    The reader is the pursuer that holds the belief; the source is the pursuer that the belief is about. An action is
    0 .. M, or M + 1 if it is unknown: nothing was received since the start or since a loss of memory. With
    `announce.start` = "known", the initial actions are known. Of several changes at one instant, the last one counts.
    """
    unheard = len(started(result).evaders) + 1
    pieces = pieces[~pieces["superseded"] | (pieces["until"] > pieces["begin"])]  # as at time 0, without latency
    is_certain = (result.scenario.announce.start == "known") & (pieces["begin"] == 0)
    value = np.where(pieces["presumed"] & ~is_certain, unheard, pieces["active"].astype(int))
    columns = (pieces["reader"], pieces["source"], value)
    changed = np.ones(len(pieces), bool)
    changed[1:] = np.any([column[1:] != column[:-1] for column in columns], axis=0)
    pieces, value = pieces[changed], value[changed]
    order = np.argsort(pieces["begin"], kind="stable")
    return {
        "t": ticks(pieces["begin"][order]),
        "reader": _column(pieces["reader"][order], "<u2"),
        "source": _column(pieces["source"][order], "<u2"),
        "value": _column(value[order], _kind(result)),
    }


def _distrust(result: Result, ticks: _Ticks) -> ReplayData | None:
    """Return the changes of trust as columns: time, pursuer, suspect, and whether it begins; None if there are none."""
    changes = result.trace.of(Distrusted)
    if not changes:
        return None
    return {
        "t": ticks([change.t for change in changes]),
        "who": _column([change.pursuer for change in changes], "<u2"),
        "suspect": _column([change.suspect for change in changes], "<u2"),
        "begins": _column([change.distrusted for change in changes], "u1"),
    }


def _ghost(result: Result, ticks: _Ticks) -> ReplayData:
    """Return the part of another run that is shown: its positions, and its number of active pursuers over time."""
    count = sum(map(bool, started(result).active))
    times, counts = [0], [count]
    for change, before in changes_with_previous(result):
        count += chases(change) - bool(before)
        times.append(change.t)
        counts.append(count)
    return {
        "name": f"{run_name(result)}, {_outcome(result)}",
        "end": ticks.last,
        "pursuers": len(started(result).active),
        "evaders": len(started(result).evaders),
        "path": _path(result, ticks),
        "active": {"t": ticks(times), "count": _column(counts, "<u4")},
    }

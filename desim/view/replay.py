"""The replay of a run: one HTML page with all it needs in it, the same bytes every time.

Times are whole ticks, positions whole millimetres. Columns of numbers are typed arrays in base64, little-endian.
"""

from base64 import b64encode
from collections.abc import Iterator, Sequence
from importlib.resources import files
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from desim.analysis.activity import relays
from desim.analysis.course import positions_known
from desim.analysis.knowledge import Pieces, knowledge
from desim.analysis.reading import ended, messages, reading, started
from desim.kernel.clock import SECOND, seconds
from desim.kernel.events import LOST, Broadcast, Lost, Queued, Sent
from desim.kernel.faults import Crash, Fault, Partition
from desim.pursuit.events import Decided, Halted, Sampled
from desim.simulation import Result
from desim.view.passages import outages

NEVER = 2**32 - 1
"""The tick of what does not happen in the run."""
MILLIMETRES = 1000
STAYS, CHASES, UNHEARD = range(3)
"""What is believed of somebody."""
Document = dict[str, Any]
"""What JSON has."""


def replay(result: Result) -> str:
    """Return a page that plays a run, with nothing in it that lies elsewhere; jinja2 (the extra `plot`) is needed.

    In a notebook, write it to a file and show that in an `IPython.display.IFrame`.
    """
    from jinja2 import Environment

    result = reading(result)
    template = files("desim.view").joinpath("replay.html").read_text(encoding="utf-8")
    page = Environment(autoescape=True, keep_trailing_newline=True).from_string(template)
    return page.render(
        name=result.scenario.name, about=_about(result), warnings=list(lacks(result)), run=_document(result)
    )


def lacks(result: Result) -> Iterator[str]:
    """Yield what cannot be shown because it was not recorded."""
    if not positions_known(result):
        yield "Positions were not recorded, so nobody moves: set record.trajectory to a time greater than 0 s."
    if not _has_messages(result):
        yield (
            f"Messages were not recorded: the {messages(result).sent:,} that were sent are not shown, nor what was "
            "believed. Set record.messages = true."
        )


def _about(result: Result) -> str:
    """Return a run in a line."""
    end, scenario = ended(result), result.scenario
    rule = scenario.protocol
    protocol = getattr(rule, "kind", None) or getattr(rule, "__name__", type(rule).__name__)
    outcome = {
        "captured": f"captured by {end.capturer} after {seconds(end.t):.2f} s",
        "horizon": f"not captured within {seconds(end.t):g} s",
        "stopped": f"stopped after {seconds(end.t):.2f} s",
    }
    return f"{len(started(result).active)} pursuers, {protocol}, seed {result.seed}: {outcome[end.reason]}"


def _has_messages(result: Result) -> bool:
    told = any(isinstance(event, Broadcast | Sent | Lost | Queued) for event in result.trace)
    return told or not messages(result).sent


class _Ticks(NamedTuple):
    """The unit of time: the shortest power of ten of a nanosecond in which the run has less than 2^31 of them."""

    length: int
    """ns"""

    @classmethod
    def fit(cls, end: int) -> "_Ticks":
        length = 1
        while end // length >= 2**31:
            length *= 10
        return cls(length)

    def __call__(self, times: ArrayLike) -> str:
        """Return times (ns, or LOST for never) as a column; what is later than the column can hold is never."""
        given = np.asarray(times, np.int64)
        ticks = np.where(given == LOST, NEVER, np.minimum((given + self.length // 2) // self.length, NEVER))
        return _column(ticks, "<u4")


def _column(values: ArrayLike, kind: str) -> str:
    return b64encode(np.asarray(values, dtype=kind).tobytes()).decode()


def _document(result: Result) -> Document:
    """Return all that the page shows."""
    start, end, scenario = started(result), ended(result), result.scenario
    ticks = _Ticks.fit(end.t)
    told = _has_messages(result)
    handovers = relays(result)
    return {
        "tick": ticks.length / SECOND,
        "end": (end.t + ticks.length // 2) // ticks.length,
        "captured": end.reason == "captured",
        "capturer": end.capturer,
        "radius": scenario.capture.radius,
        "range": scenario.network.range if isfinite(scenario.network.range) else None,
        "links": _links(result),
        "speeds": list(start.speeds),
        "active": [int(active) for active in start.active],
        "path": _path(result, ticks),
        "decisions": _decisions(result, ticks),
        "relays": {"t": ticks([t for t, _ in handovers]), "who": _column([who for _, who in handovers], "<u2")},
        "faults": _faults(result, ticks),
        "messages": _messages(result, ticks) if told else None,
        "beliefs": _beliefs(knowledge(result), result, ticks) if told else None,
    }


def _links(result: Result) -> str | None:
    """Return the pairs of pursuers that the graph links; None if it links everybody."""
    size = len(started(result).active)
    pairs = sorted({(min(pair), max(pair)) for pair in result.scenario.network.graph(size).edges})
    return None if len(pairs) == size * (size - 1) // 2 else _column(pairs, "<u2")


def _path(result: Result, ticks: _Ticks) -> Document:
    """Return where everyone was, pursuers first: at the start, and by how much that changed until each sample."""
    frozen = result.scenario.motion.frozen
    known = [started(result), *(() if frozen else result.trace.of(Sampled))]
    places = np.array([[*each.pursuers, each.evader] for each in known])  # (samples, N + 1, 2)
    millimetres = np.rint(places * MILLIMETRES).astype(np.int64).reshape(len(known), -1)
    shifts = np.diff(millimetres, axis=0)
    kind = "<i2" if np.abs(shifts).max(initial=0) < 2**15 else "<i4"
    return {
        "t": ticks([each.t for each in known]),
        "start": _column(millimetres[0], "<i4"),
        "bits": 8 * np.dtype(kind).itemsize,
        "shifts": _column(shifts, kind),
    }


def _decisions(result: Result, ticks: _Ticks) -> Document:
    """Return who decided what when; who broke down while active decided nothing, and stays."""
    found = [event for event in result.trace if isinstance(event, Decided | Halted)]
    return {
        "t": ticks([event.t for event in found]),
        "who": _column([event.pursuer for event in found], "<u2"),
        "active": _column([isinstance(event, Decided) and event.active for event in found], "u1"),
        "halted": _column([isinstance(event, Halted) for event in found], "u1"),
    }


def _faults(result: Result, ticks: _Ticks) -> list[Document]:
    """Return what was broken when, in order of time."""
    return [_fault(fault, spell.begin, spell.end, ticks) for fault, spell in outages(result)]


def _fault(fault: Fault, begin: int, until: int, ticks: _Ticks) -> Document:
    """Return a fault that was open for a while, ns."""
    said: Document
    if isinstance(fault, Crash):
        said = {"node": fault.node, "scope": fault.scope, "memory": fault.memory}
    elif isinstance(fault, Partition):
        said = {"groups": [list(group) for group in fault.groups]}
    else:
        said = {"centre": list(fault.centre), "radius": fault.radius}
    first, last = ((t + ticks.length // 2) // ticks.length for t in (begin, until))
    return {"kind": fault.kind, "begin": first, "end": last} | said


def _messages(result: Result, ticks: _Ticks) -> Document:
    """Return what was on its way when: rows of transmissions, in order of time, and of each the messages to one.

    A message is in flight from the instant at which it is sent, or begins to wait for its transmitter, until it arrives
    or is lost.
    """
    lost: dict[int, dict[int, Lost]] = {}
    for each in result.trace.of(Lost):
        lost.setdefault(each.flight, {})[each.dst] = each
    causes = sorted({each.cause for losses in lost.values() for each in losses.values()})
    number = {cause: k for k, cause in enumerate(causes, start=1)}
    rows = sorted(_transmissions(result), key=lambda row: row.begin)
    end: list[int] = []
    fate: list[int] = []
    for row in rows:
        losses = lost.get(row.flight)
        if losses is None:
            end += row.arrival
            fate += [0] * len(row.dst)
        else:
            known = [losses.get(dst) for dst in row.dst]
            end += [when if lose is None else lose.t for when, lose in zip(row.arrival, known, strict=True)]
            fate += [0 if lose is None else number[lose.cause] for lose in known]
    return {
        "begin": ticks([row.begin for row in rows]),
        "left": ticks([row.left for row in rows]),
        "src": _column([row.src for row in rows], "<u2"),
        "count": _column([len(row.dst) for row in rows], "<u2"),
        "dst": _column([dst for row in rows for dst in row.dst], "<u2"),
        "end": ticks(end),
        "fate": _column(fate, "u1"),
        "causes": [cause.replace("_", " ") for cause in causes],
    }


class _Transmission(NamedTuple):
    flight: int
    begin: int
    left: int
    src: int
    dst: tuple[int, ...]
    arrival: Sequence[int]


def _transmissions(result: Result) -> Iterator[_Transmission]:
    """Yield what left, and what waited in vain to leave."""
    waiting: dict[int, Queued] = {}
    for event in result.trace:
        if isinstance(event, Queued):
            waiting[event.flight] = event
        elif isinstance(event, Broadcast | Sent):
            waiting.pop(event.flight, None)
            dst = event.dst if isinstance(event, Broadcast) else (event.dst,)
            arrival = event.arrival if isinstance(event, Broadcast) else (event.arrival,)
            arrival = arrival if len(arrival) == len(dst) else arrival * len(dst)
            yield _Transmission(event.flight, event.created, event.t, event.src, dst, arrival)
    for queued in waiting.values():
        yield _Transmission(queued.flight, queued.t, LOST, queued.src, queued.dst, [LOST] * len(queued.dst))


def _beliefs(known: Pieces, result: Result, ticks: _Ticks) -> Document:
    """Return from when on who had last heard of whom that it chases, or stays, or nothing; only what changed.

    Of what was heard at one instant, the last counts.
    """
    warm = result.scenario.announce.warm_start & (known["begin"] == 0)
    value = np.where(known["presumed"] & ~warm, UNHEARD, known["active"].astype(int))
    columns = (known["reader"], known["source"], value)
    changed = np.ones(len(known), bool)
    changed[1:] = np.any([column[1:] != column[:-1] for column in columns], axis=0)
    known, value = known[changed], value[changed]
    order = np.argsort(known["begin"], kind="stable")
    return {
        "t": ticks(known["begin"][order]),
        "reader": _column(known["reader"][order], "<u2"),
        "source": _column(known["source"][order], "<u2"),
        "value": _column(value[order], "u1"),
    }

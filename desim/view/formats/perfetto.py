"""A run as a timeline for the Perfetto UI (https://ui.perfetto.dev): its trace as JSON in the Trace Event Format.

The format is that of Google's document "Trace Event Format", as Perfetto reads it
(https://perfetto.dev/docs/getting-started/other-formats; `src/trace_processor/importers/json` of its source). Times
`ts` and durations `dur` are in microseconds, with decimals. The phases `ph` are "M", which names a process or a thread;
"X", a slice of a thread; "i", an instant; "C", a counter; "b" and "e", the start and end of an asynchronous slice. The
scope `s` of an instant is "t" (its thread) or "g" (global). The two events of an asynchronous slice have the same pid,
cat, id and name. Asynchronous slices may overlap. Asynchronous slices of equal name in one process share a track.

The pursuers are the threads of one process. Each receiver is a process whose tracks are its incoming links.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from math import inf, nextafter
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Literal

from desim.analysis.activity import action, changes, changes_with_previous, chases, decisions
from desim.analysis.deliveries import chasing, deliveries, handover_events, outages
from desim.analysis.trace_index import ended, messages_recorded, started
from desim.config.json_numbers import to_json
from desim.config.model import Value
from desim.config.whole_files import write_whole
from desim.kernel.core.events import DeadlineMissed, Expired, GivenUp, LivelinessLost, Retransmitted
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.trace_file import body_json
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Captured
from desim.simulation.run import Result

PURSUERS = 1
"""The number (pid) of the process whose threads are the pursuers."""
TEAM = 1
"""The number (tid) of the thread of events that concern the whole team."""
FIRST = 2
"""The tid of pursuer 0, and the pid of the messages to pursuer 0; the numbers of later pursuers follow."""
OF_TRANSPORT: Mapping[type, tuple[str, str]] = MappingProxyType(
    {
        Retransmitted: ("src", "repeats message {seq} to {dst}"),
        GivenUp: ("src", "gives up message {seq} to {dst}: {cause}"),
        Expired: ("dst", "drops message {seq} of {src}"),
        DeadlineMissed: ("dst", "misses a message of {src}"),
        LivelinessLost: ("dst", "loses the liveliness of {src}"),
    }
)
"""For each type of an event of a transport: the field with the pursuer of the instant, and the name of the instant."""
Entry = dict[str, Any]
"""One event of the format, a JSON object."""


def trace_events(result: Result) -> list[Entry]:
    """Return a run as trace events: first the names, then all other events in order of time.

    Messages are included if they were recorded.
    """
    message_entries = list(_messages(result)) if messages_recorded(result) else []
    timed = [*_slices(result), *_instants(result), *_counts(result), *message_entries]
    timed.sort(key=lambda entry: entry["ts"])  # stable, so that a slice of zero duration begins before it ends
    return [*_names(len(started(result).active), bool(message_entries)), *timed]


def perfetto(result: Result) -> str:
    """Return the timeline of a run as JSON text, one event per line; see `trace_events`."""
    entries = ",\n".join(json.dumps(to_json(entry), allow_nan=False) for entry in trace_events(result))
    about = {"scenario": result.scenario.name, "seed": result.seed}
    return f'{{"displayTimeUnit": "ms", "otherData": {json.dumps(about)}, "traceEvents": [\n{entries}\n]}}\n'


def write(result: Result, path: Path) -> None:
    """Write the timeline of a run to a file."""
    write_whole(path, perfetto(result).encode())


class Perfetto(Value):
    """A timeline for https://ui.perfetto.dev."""

    kind: Literal["perfetto"] = "perfetto"

    suffix: ClassVar[str] = ".perfetto.json"
    items: ClassVar[str] = "entries"

    def __call__(self, result: Result, file: Path) -> None:
        """Write the timeline."""
        write(result, file)


def _names(size: int, has_messages: bool) -> Iterator[Entry]:
    """Yield the names and the sort order of processes and threads."""

    def name(kind: str, pid: int, tid: int, text: str) -> Iterator[Entry]:
        yield {"ph": "M", "pid": pid, "tid": tid, "name": f"{kind}_name", "args": {"name": text}}
        rank = pid if kind == "process" else tid
        yield {"ph": "M", "pid": pid, "tid": tid, "name": f"{kind}_sort_index", "args": {"sort_index": rank}}

    yield from name("process", PURSUERS, TEAM, "pursuers")
    yield from name("thread", PURSUERS, TEAM, "team")
    for pursuer in range(size):
        yield from name("thread", PURSUERS, FIRST + pursuer, f"pursuer {pursuer}")
    for pursuer in range(size if has_messages else 0):
        # Perfetto identifies threads by tid alone, so the tid of a receiver must differ from the tids of pursuers.
        yield from name("process", FIRST + pursuer, FIRST + size + pursuer, f"messages to {pursuer}")


def _slices(result: Result) -> Iterator[Entry]:
    """Yield the slices: chases and faults."""
    several = len(started(result).evaders) > 1
    for pursuer, chases_of_pursuer in enumerate(chasing(result)):
        for begin, end, evader in chases_of_pursuer:
            name = f"chases {evader}" if several else "active"
            yield _entry("X", name, FIRST + pursuer, begin, cat="chase", dur=_microseconds(end - begin))
    for k, (fault, (begin, end)) in enumerate(outages(result)):
        shared: dict[str, Any] = {"cat": "fault", "id": f"fault {k}"}
        yield _entry("b", fault.label, TEAM, begin, **shared, args={"fault": fault.plain()})
        yield _entry("e", fault.label, TEAM, end, **shared)


def _instants(result: Result) -> Iterator[Entry]:
    """Yield the instants: decisions, handovers, captures, and the end of the run."""
    changed, several = {id(change) for change in changes(result)}, len(started(result).evaders) > 1
    for decision in decisions(result):
        starts = f"switches to {action(decision)}" if several else "starts"
        name = (starts if chases(decision) else "stops") if id(decision) in changed else "keeps action"
        yield _entry(
            "i", name, FIRST + decision.pursuer, decision.t, cat="decision", s="t", args={"active": decision.active}
        )
    for t, pursuer, evader in handover_events(result):
        args: dict[str, int] = {"pursuer": pursuer, "evader": evader} if several else {"pursuer": pursuer}
        name = f"{pursuer} takes over {evader}" if several else f"{pursuer} takes over"
        yield _entry("i", name, TEAM, t, cat="relay", s="t", args=args)
    for capture in result.trace.of(Captured):
        args = {"evader": capture.evader, "capturer": capture.capturer}
        name = f"evader {capture.evader} captured"
        yield _entry("i", name, TEAM, capture.t, cat="capture", s="g", args=args)
    yield from _transport(result)
    end = ended(result)
    yield _entry("i", end.reason, TEAM, end.t, cat="end", s="g", args={"capturer": end.capturer})


def _transport(result: Result) -> Iterator[Entry]:
    """Yield an instant for each event of a transport; see `OF_TRANSPORT`."""
    for event in result.trace:
        if type(event) in OF_TRANSPORT:
            pursuer, name = OF_TRANSPORT[type(event)]
            fields = dict(zip(event._fields[1:], list(event)[1:], strict=True))
            tid = FIRST + fields[pursuer]
            yield _entry("i", name.format_map(fields), tid, event.t, cat="transport", s="t", args=fields)


def _counts(result: Result) -> Iterator[Entry]:
    """Yield the counter of active pursuers, at the start and at each change of action.

    With several evaders, also yield the counter of the pursuers of each evader, at the start and when it changes.
    """
    start = started(result)
    chasers = {evader: sum(action == evader for action in start.active) for evader in range(1, len(start.evaders) + 1)}

    def counters(t: int, evaders: Iterable[int]) -> Iterator[Entry]:
        yield _entry("C", "active pursuers", TEAM, t, args={"number": portable_sum(chasers.values())})
        for evader in evaders if len(chasers) > 1 else ():
            yield _entry("C", f"pursuers on {evader}", TEAM, t, args={"number": chasers[evader]})

    yield from counters(0, chasers)
    for change, before in changes_with_previous(result):
        steps = [(evader, step) for evader, step in ((before, -1), (action(change), 1)) if evader]
        for evader, step in steps:
            chasers[evader] += step
        yield from counters(change.t, [evader for evader, _ in steps])


def _messages(result: Result) -> Iterator[Entry]:
    """Yield the start and end of each delivery.

    The slice of a message in flight at the end of the run lasts until its arrival. For a message that is still queued
    at the end of the run, a slice of zero duration follows the end.
    """
    size, end = len(started(result).active), ended(result).t
    for delivery in deliveries(result):
        link: dict[str, Any] = {
            "pid": FIRST + delivery.dst,
            "cat": "message",
            "id": f"{delivery.transmission}.{delivery.dst}",
        }
        name, tid = f"{delivery.src} to {delivery.dst}", FIRST + size + delivery.dst
        args = {"bytes": delivery.size, "says": json.loads(body_json(delivery.body))}
        if delivery.created < delivery.left:
            args["waited (s)"] = (delivery.left - delivery.created) / SECOND
        fate = f"lost: {delivery.cause}" if delivery.cause else "in flight" if delivery.until > end else "arrived"
        yield _entry("b", name, tid, delivery.left, **link, args=args)
        yield _entry("e", name, tid, delivery.until, **link, args={"fate": fate})


def _entry(ph: str, name: str, tid: int, t: int, *, pid: int = PURSUERS, **fields: Any) -> Entry:
    """Return an entry at a time, ns; the keys are those of the format."""
    return {"ph": ph, "name": name, "pid": pid, "tid": tid, "ts": _microseconds(t)} | fields


def _microseconds(t: int) -> float | int:
    """Convert a time from nanoseconds to microseconds.

    Perfetto converts the result back by int(1000 * result). For times up to 100 days, this gives exactly `t`.
    """
    if t % 1000 == 0:
        return t // 1000
    microseconds = t / 1000
    return microseconds if int(microseconds * 1000.0) == t else nextafter(microseconds, inf)

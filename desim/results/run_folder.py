"""The folder of a run: its trace, its numbers, its scenario, its picture, and where all that comes from."""

import json
from collections.abc import Container, Iterable, Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BeforeValidator, Field

from desim.analysis.metrics import Summary, plain, summary
from desim.config.file_names import OF_A_RUN, TRACE
from desim.config.trust import fresh, regular
from desim.kernel.events import MESSAGES, Broadcast, Event, Lost, MessageCounts, Queued, Sent, Trace
from desim.kernel.faults import Crash, Fault, FaultEnded, FaultStarted, Partition
from desim.kernel.records import Record
from desim.kernel.trace_file import Limits, TraceFile, events_of
from desim.pursuit.events import BrokeDown, Captured, Decided, Ended, Sampled, Started
from desim.results import provenance
from desim.scenario.scenario import Scenario
from desim.scenario.toml import dump, validate
from desim.simulation.run import Result, run

EVENTS = (Started, Decided, BrokeDown, Sampled, Captured, Ended, *MESSAGES, MessageCounts, FaultStarted, FaultEnded)
"""What may be in a trace."""


def simulate(folder: Path, scenario: Scenario, seed: int) -> Result:
    """Return a run; if its messages are to go to a file, its trace is in a folder, which is made, as it happens."""
    if scenario.record.messages != "file":
        return run(scenario, seed)
    folder.mkdir(parents=True, exist_ok=True)
    fresh(folder / f"{TRACE}.part")
    with TraceFile(folder / TRACE) as trace:
        result = run(scenario, seed, trace)
        clear(folder)  # before the trace has its name, or it might be read with the run.json of another run
        return result


def simulate_below(parent: Path, scenario: Scenario, seed: int) -> Result:
    """Return a run, whose trace may be in the folder `seed-S` below another; see `simulate`."""
    return simulate(_below(parent, seed), scenario, seed)


def write(
    result: Result, folder: Path, made: provenance.Document | None = None, *, simulated_there: bool = False
) -> Summary:
    """Write a run to a folder and return its numbers.

    trace.jsonl, summary.json, scenario.toml and run.json; trajectory.svg and .png if positions were recorded and
    matplotlib (the extra `plot`) is installed. What is there of another run is removed: see `clear`. run.json comes
    last: where it is, all is, also if the program was killed.

    Args:
        result: of the run.
        folder: is made, with all above it.
        made: where the run comes from, or the batch that it is of; if None, from the scenario and this program.
        simulated_there: whether it was made by `simulate` with this folder, so that its trace may be there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = summary(result)
    is_there = simulated_there and result.scenario.record.messages == "file"
    clear(folder, {TRACE} if is_there else ())
    if not is_there:
        with TraceFile(folder / TRACE) as file:
            for event in result.trace:
                file(event)
    (folder / "summary.json").write_text(json.dumps(plain(numbers), indent=2) + "\n", encoding="utf-8")
    resolved = result.scenario.model_copy(update={"seed": result.seed})
    (folder / "scenario.toml").write_text(dump(resolved), encoding="utf-8")
    if made is None:
        made = provenance.document(provenance.RUN, resolved, seed=result.seed)
    if can_plot() and result.trace.of(Sampled):
        from desim.analysis.plots import save, trajectory

        save(trajectory(result), folder / "trajectory")
    provenance.write(folder, provenance.of_one(made, result.seed))
    return numbers


def clear(folder: Path, kept: Container[str] = ()) -> None:
    """Remove all of a run from its folder, its pictures too, but for some names; what is below stays, it is of others.

    Raises:
        OSError: if it cannot be removed.
    """
    for name in OF_A_RUN:
        if name not in kept:
            (folder / name).unlink(missing_ok=True)


def write_below(
    parent: Path, result: Result, made: provenance.Document | None = None, *, simulated_there: bool = False
) -> Summary:
    """Write a run to the folder `seed-S` below another; see `write`."""
    return write(result, _below(parent, result.seed), made, simulated_there=simulated_there)


def _below(parent: Path, seed: int) -> Path:
    return fresh(parent / f"seed-{seed}")


def read(folder: str | Path, *, allow_import: bool = False) -> Result:
    """Return the run that was written to a folder, from its run.json and its trace; see `events_of` for bodies.

    Args:
        folder: of the run.
        allow_import: whether it may name code to be run; see `desim.load`.

    Raises:
        ValueError: if one of the two is not what `write` wrote, or names a model that nobody can import, or if the two
            are of different runs.
        OSError: if it cannot be read.
    """
    folder, trace = Path(folder), Trace()
    trace.events += events(folder)
    if [type(event) for event in trace.events[-2:]] != [MessageCounts, Ended]:
        raise ValueError(f"{folder / TRACE}: is not of a whole run: its last events should be Tally and Ended")
    for number, why in _misfits(trace.events):
        raise ValueError(f"{folder / TRACE}: line {number} {why}")
    path = folder / provenance.FILE
    made = provenance.read(path)
    source = provenance.source(path, made, allow_import=allow_import)
    if made["runs"] != 1:
        raise ValueError(f"{path}: is of {made['runs']} runs, and not of that in {TRACE}")
    result = Result(validate(source), made["seed"], trace)
    if not _begins(result):
        raise ValueError(f"{path}: is not of the run in {TRACE}: pursuers or evaders begin elsewhere, or are others")
    return result


def _begins(result: Result) -> bool:
    """Return whether a trace begins as its scenario does with its seed; to 1e-6 m, for platforms may differ."""
    team, evaders, starts = result.scenario.team, result.scenario.evaders, result.trace.of(Started)
    if len(starts) != 1 or starts[0].speeds != tuple(team.all_speeds()):
        return False
    there = *starts[0].pursuers, *starts[0].evaders
    wanted = *team.start(result.seed), *(each.start(result.seed, k) for k, each in enumerate(evaders))
    return len(there) == len(wanted) and np.allclose(there, wanted, rtol=0.0, atol=1e-6)


def events(folder: str | Path) -> Iterator[Event]:
    """Yield the events of the run in a folder, one by one, so that a long trace need not fit in memory; see `read`.

    Raises:
        ValueError: if a line of its trace is not what `write` wrote.
        OSError: if it cannot be read.
    """
    file = Path(folder) / TRACE
    with regular(file).open(encoding="utf-8") as lines:
        try:
            first = list(islice(lines, 1))
            for start in events_of(first, (Started,)):
                yield from events_of(chain(first, lines), EVENTS, _limits(start))
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from error


def _limits(start: Any) -> Limits:
    """Return what holds of the numbers in a trace that begins so."""
    size, evaders = len(start.pursuers), len(start.evaders)
    return {
        "node": Field(lt=size),
        "pursuers": Field(min_length=size, max_length=size),
        "evader": Field(ge=1, le=evaders),
        "action": Field(ge=0, le=evaders),
        "others": Field(min_length=evaders - 1, max_length=evaders - 1),
        "body": BeforeValidator(lambda body: _readable(body, size, evaders)),
    }


def _readable(body: Any, size: int, evaders: int) -> Any:
    """Return the body of a message, as JSON has it, if what it says of actions can be read.

    Raises:
        ValueError: if it names no evader, or relays what is no record.
    """
    if not isinstance(body, dict):
        return body
    if (active := body.get("active")) is not None and not _is_number(active, evaders + 1):
        raise ValueError(f"active should be 0 to {evaders}")
    if (records := body.get("records")) is not None:
        for each in records if isinstance(records, list) else [None]:
            if not isinstance(each, dict) or tuple(each) != Record._fields:
                raise ValueError(f"records should be tables of {', '.join(Record._fields)}")
            if not (_is_number(each["src"], size) and all(_is_number(each[key], 1 << 62) for key in ("seq", "sent"))):
                raise ValueError(f"a record should have a src of 0 to {size - 1}, and seq and sent of at least 0")
            _readable(each["body"], size, evaders)
    return body


def _is_number(value: Any, end: int) -> bool:
    """Return whether it is one of 0 .. end - 1."""
    return isinstance(value, int) and 0 <= value < end


def _misfits(found: Sequence[Event]) -> Iterator[tuple[int, str]]:
    """Yield which lines of a trace do not fit those before, and why."""
    size, t, once = len(found[0].pursuers) if isinstance(found[0], Started) else 0, 0, set[type[Event]]()
    receivers, broken = dict[int, tuple[int, ...]](), list[Fault]()
    for number, event in enumerate(found, start=1):
        if event.t < t:
            yield number, "is earlier than the line before"
        t = event.t
        if isinstance(event, Started | MessageCounts | Ended):
            if type(event) in once:
                yield number, f"is a second {type(event).__name__}"
            once.add(type(event))
        elif isinstance(event, Broadcast | Queued):
            if isinstance(event, Broadcast) and len(event.arrival) not in {1, len(event.dst)}:
                yield number, f"has {len(event.dst)} receivers and {len(event.arrival)} arrivals"
            receivers[event.flight] = receivers.get(event.flight, ()) + event.dst
        elif isinstance(event, Sent):
            receivers[event.flight] = (*receivers.get(event.flight, ()), event.dst)
        elif isinstance(event, Lost):
            if event.dst not in receivers.get(event.flight, ()):
                yield number, f"is of a message that was not sent: {event.flight} to {event.dst}"
        elif isinstance(event, FaultStarted):
            if any(node >= size for node in _nodes(event.fault)):
                yield number, f"is of a node that is not one of 0 to {size - 1}"
            broken.append(event.fault)
        elif isinstance(event, FaultEnded):
            if event.fault not in broken:
                yield number, "ends a fault that did not begin"
            else:
                broken.remove(event.fault)


def _nodes(fault: Fault) -> Iterable[int]:
    """Return the nodes that a fault names."""
    if isinstance(fault, Crash):
        return [fault.node]
    return chain.from_iterable(fault.groups) if isinstance(fault, Partition) else ()


def can_plot() -> bool:
    """Return whether matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True

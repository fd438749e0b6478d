"""Checks that a trace file holds one whole run: format, fields and order of events, and events that need each other."""

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from pydantic import Field

from desim.config.number_texts import counted
from desim.kernel.core.events import LOST, Broadcast, Event, Lost, MessageCounts, Queued, Sent, TransportCounts
from desim.kernel.core.trace_file import Limits
from desim.kernel.models.faults import nodes_of
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted, TracedFault
from desim.pursuit.core.events import FORMAT, Ended, Started
from desim.results import provenance


def whole_trace(trace: Iterable[Event]) -> Iterator[Event]:
    """Yield the events of a trace, and check them one by one.

    Raises:
        ValueError: if an event is earlier than the event before, if a broadcast has neither one arrival for all
            receivers nor one for each, or if the trace does not end as that of a whole run.
    """
    last_but_one, last, t = None, None, 0
    for number, event in enumerate(trace, start=1):
        if event.t < t:
            raise ValueError(f"line {number} is earlier than the line before")
        t = event.t
        if isinstance(event, Broadcast) and len(event.arrival) not in {1, len(event.dst)}:
            raise ValueError(
                f"line {number} has {counted(len(event.dst), 'receiver')} and {counted(len(event.arrival), 'arrival')}"
            )
        last_but_one, last = last, type(event)
        yield event
    if (last_but_one, last) != (MessageCounts, Ended):
        raise ValueError("is not complete: its last events should be MessageCounts and Ended")


def check_trace_format(first: Sequence[str]) -> None:
    """Check the format of a trace, given its first line, if any; `events_of` refuses a line that is not `Started`.

    Raises:
        ValueError: if the line is the start of a run in another format.
    """
    try:
        start = json.loads("".join(first))
    except (ValueError, RecursionError):
        return
    if isinstance(start, dict) and start.get("event") == Started.__name__ and start.get("format") != FORMAT:
        raise ValueError(provenance.other_format(start.get("format"), FORMAT))


def field_limits(start: Any) -> Limits:
    """Return the constraints on the fields of events in a trace, given its first event.

    Message bodies have no constraints: a protocol of a user may give any meaning to their fields.
    """
    size, evaders = len(start.pursuers), len(start.evaders)
    return {
        "node": Field(lt=size),
        "pursuers": Field(min_length=size, max_length=size),
        "evader": Field(ge=1, le=evaders),
        "action": Field(ge=0, le=evaders),
        "evaders": Field(min_length=evaders, max_length=evaders),
    }


def inconsistencies(trace: Sequence[Event]) -> Iterator[tuple[int, str]]:
    """Yield (line, error) for each line of a trace that is inconsistent with the other lines."""
    nodes = len(trace[0].pursuers) if isinstance(trace[0], Started) else 0
    unique_types = set[type[Event]]()
    receivers, active_faults = dict[int, tuple[int, ...]](), list[TracedFault]()
    # By transmission and receiver, the lines of lost messages for which no event Lost has come yet.
    lost = defaultdict[tuple[int, int], list[int]](list)
    for number, event in enumerate(trace, start=1):
        if isinstance(event, Started | MessageCounts | TransportCounts | Ended):
            if type(event) in unique_types:
                yield number, f"is a second {type(event).__name__}"
            unique_types.add(type(event))
        elif isinstance(event, Broadcast | Queued):
            receivers[event.transmission] = receivers.get(event.transmission, ()) + event.dst
            if isinstance(event, Broadcast) and LOST in event.arrival:
                for dst in (node for node, arrival in event.fates() if arrival == LOST):
                    lost[event.transmission, dst].append(number)
        elif isinstance(event, Sent):
            receivers[event.transmission] = (*receivers.get(event.transmission, ()), event.dst)
            if event.arrival == LOST:
                lost[event.transmission, event.dst].append(number)
        elif isinstance(event, Lost):
            if event.dst not in receivers.get(event.transmission, ()):
                yield number, f"loses a message that was not sent: {event.transmission} to {event.dst}"
            elif lost[event.transmission, event.dst]:
                lost[event.transmission, event.dst].pop()
        elif isinstance(event, FaultStarted):
            if any(node >= nodes for named in nodes_of(event.fault).values() for node in named):
                yield number, f"names a node that is not one of 0 to {nodes - 1}"
            active_faults.append(event.fault)
        elif isinstance(event, FaultEnded):
            if event.fault not in active_faults:
                yield number, "ends a fault that did not begin"
            else:
                active_faults.remove(event.fault)
    for (_, dst), numbers in lost.items():
        for number in numbers:
            yield number, f"has no arrival at {dst}, but no event says that this message was lost"

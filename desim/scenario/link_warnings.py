"""Warnings about a network that can be simulated and is probably not meant: its links, transports and channel."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from math import inf
from typing import Any

from desim.config.arrays import array_of
from desim.config.model import RESOLUTION, Value
from desim.config.number_files import is_fill
from desim.config.traits import inherits
from desim.kernel.clock_sync import Unsynchronised
from desim.kernel.core.message_size import size_of
from desim.kernel.core.records import Record
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.graph_files.graph_attributes import unread_attributes
from desim.kernel.measured.base import LinkTrace
from desim.kernel.models.access import SlottedAloha, Tdma
from desim.kernel.models.clock_skew import is_skewed
from desim.kernel.models.faults import Window
from desim.kernel.models.graphs import Complete, Edges, links_with_attributes
from desim.kernel.models.interference import Collision
from desim.kernel.models.links import Links
from desim.kernel.models.medium import LoRa, Radio, airtime_of, contends
from desim.kernel.models.presets import PRESETS
from desim.kernel.models.reception import Disk, QuasiUnitDisk
from desim.kernel.models.traits import InterferenceTraits, ReceptionTraits
from desim.kernel.models.transport import BestEffort, Reliable
from desim.kernel.walls.materials import MATERIALS
from desim.pursuit.core.traits import DisseminationTraits, size_by
from desim.pursuit.sensing.noise import Covariance
from desim.pursuit.sensing.noisy_sensing import Sighted, Tracked
from desim.pursuit.sensing.tracking import Measurement
from desim.pursuit.team.announcements import Forwarded, LocatedAssignment
from desim.scenario.scenario import Scenario
from desim.scenario.telling import announces_start, has_heartbeats, is_built_in, sends_announcements

LARGEST_EXPONENT = 4.0
"""Largest path loss exponent that is usual without walls."""
LEAST_ROWS, ROWS_PER_COUNTED, SPARSE = 10, 10, 5.0
"""The times of a table are probably in ms if it has at least `LEAST_ROWS` rows, at least `ROWS_PER_COUNTED` times the
number of rows before the horizon, and a mean time between two rows of at least `SPARSE` s."""
REPORT = size_of(Forwarded((Record(0, 0, 0, LocatedAssignment(0, 0.0, 0.0, 0.0)),)))
"""Least size of a report to a server (`protocols.server`), bytes."""
SIGHTED = Sighted(1, Measurement(0, 0, 0.0, 0.0, Covariance(0.0, 0.0, 0.0)))
"""What a pursuer reports of an evader that it sees, if sightings are processed by their stamps."""
TRACKED = Tracked(1, 0, (0.0,) * 4, (0.0,) * 10)
"""What a pursuer reports of an evader if tracks are fused."""
ROUNDS_TO_0 = "rounds to 0, because time is counted in nanoseconds"


def network_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about the network, announcements and faults."""
    network, announce = scenario.network, scenario.announce
    yield from _graph_warnings(scenario)
    if network.preset is not None:
        values, preset = dict(network), dict(Links(preset=network.preset))
        for key in PRESETS[network.preset]:
            if values[key] != preset[key]:
                yield f"network.{key}", f"it overrides the value of the preset {network.preset!r}"
    if network.range == inf and network.reception != Disk():
        yield "network.reception", "it has no effect while the range is inf"
    yield from _coherence_warnings(scenario)
    is_mute = announce.trigger == "never" and not announces_start(scenario)
    if is_mute and sends_announcements(scenario) and is_built_in(scenario):
        yield "announce.dissemination", "it has no effect, because nothing is ever announced"
    yield from _transport_warnings(scenario)
    if scenario.clocks.sync != Unsynchronised() and not is_skewed(scenario.fault):
        yield "clocks.sync", "it costs messages, and all clocks are right (`fault.kind` clock_skew makes them wrong)"
    for k, fault in enumerate(scenario.fault):
        if isinstance(fault, Window) and fault.start >= scenario.horizon:
            yield f"fault.{k}.start", "the fault starts after the horizon"
    yield from _trace_warnings(scenario)
    yield from _channel_warnings(scenario)
    yield from _wall_warnings(scenario)
    size, airtime = scenario.announcement_size, scenario.announcement_airtime
    if 0.0 < airtime <= RESOLUTION / 2:
        yield "network.medium", f"the airtime of {size} bytes, {airtime:.1g} s, {ROUNDS_TO_0}"
    if has_heartbeats(scenario):
        yield from _load_warnings(scenario, "announce.heartbeat", "heartbeats", size, announce.heartbeat)
    protocol = scenario.protocol_traits
    if protocol.host is not None and protocol.period is not None and is_built_in(scenario):
        yield from _load_warnings(scenario, "protocol.period", "reports", REPORT, protocol.period, host=1)
    sensing = scenario.sensing
    if sensing.is_noisy and not scenario.sight_is_limited and not protocol.omniscient:  # each pursuer reports all
        size = size_of((SIGHTED if sensing.fusion == "by_stamp" else TRACKED,) * len(scenario.evaders))
        yield from _load_warnings(scenario, "sensing.period", "reports of sightings", size, sensing.period)


def _load_warnings(
    scenario: Scenario, key: str, messages: str, size: int, period: float, *, host: int = 0
) -> Iterator[tuple[str, str]]:
    """Yield the warnings if messages that pursuers send periodically overload the channel.

    Args:
        scenario: the scenario.
        key: the key that the warnings name.
        messages: a noun for the messages.
        size: the size of a message, bytes.
        period: the period, s.
        host: 1 if all pursuers but one send, and that one receives; else 0.
    """
    network, count = scenario.network, scenario.team.count
    medium = network.medium
    radio = medium if contends(medium) else None
    if radio is not None and (radio.duty_cycle is not None or isinstance(radio.access, Tdma)):
        interval = radio.interval(size, count)
        why = "its duty cycle" if radio.duty_cycle is not None else "the slots of the TDMA"
        if interval > period:
            yield (
                key,
                f"a period of {period:g} s is shorter than the time for which {size} bytes keep a pursuer from"
                f" sending again, {interval:.3g} s, because of {why}: {messages} are delayed or dropped",
            )
    all_hear_all = network.range == inf and inherits(network.graph, Complete)
    is_one_channel = medium.shared or (radio is not None and all_hear_all)
    occupancy = airtime_of(medium, size, count) if radio is None else radio.occupancy(size, count, to_one=host > 0)
    load = occupancy / period * (count - host if is_one_channel else 1)  # the frames of all share one channel
    if load > 1.0:
        yield (
            key,
            f"{messages} of {size} bytes alone need {load:.1f} times the capacity of the channel: queues grow without"
            f" bound, or messages {'' if radio is None else 'collide or '}are dropped",
        )


def _coherence_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield a warning if correlated fading has no effect: no power varies, or the channel never changes."""
    network = scenario.network
    if network.fading != "correlated":
        return
    varies = set(ReceptionTraits.of(network.reception).varies) if network.range < inf else set()
    if contends(network.medium):
        varies |= set(InterferenceTraits.of(network.medium.reception).varies)
    if not varies:
        yield "network.fading", "it has no effect: the power of no message varies (`reception`)"
    elif scenario.motion.static and (network.coherence.doppler is None or "fading" not in varies):
        yield "network.fading", "the channel never changes: nobody moves, and nothing around them does (`doppler`)"


def _graph_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about attributes of a graph that are not read, and about shifted numbers of nodes."""
    model, count = scenario.network.graph, scenario.team.count
    notes = model.notes if isinstance(model, Edges) else unread_attributes(scenario.network.make_graph(count))
    yield from (("network.graph", note) for note in notes)


def edge_attributes(scenario: Scenario) -> Iterator[dict[str, Any]]:
    """Yield the attributes of each link of the graph that has some."""
    graph = scenario.network.make_graph(scenario.team.count)
    yield from (attributes for _, _, attributes in links_with_attributes(graph))


def _transport_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about transports without an effect, and windows that are never full."""
    announce, transport = scenario.announce, scenario.network.transport
    for key, model in (("network.transport", transport), ("announce.dissemination", announce.dissemination)):
        if isinstance(model, Reliable) and model.history == "keep_last" and model.depth < model.window:
            yield (
                f"{key}.window",
                f"no more than depth = {model.depth} messages are kept, so a window of {model.window} is never full",
            )
    sends_others = scenario.schedule_traits.spreads_to is not None or not scenario.sight_is_perfect
    sends_others = sends_others or announce.trust.period is not None  # accusations
    if transport != BestEffort() and scenario.announces and not sends_others and is_built_in(scenario):
        if DisseminationTraits.of(announce.dissemination).transport is not None:
            yield "network.transport", "it has no effect: announcements have their own (`announce.dissemination`)"
        elif not sends_announcements(scenario):
            yield (
                "network.transport",
                "it has no effect on announcements, which are published as state; the kinds 'reliable' and 'coded' of"
                " `announce.dissemination` send them as messages",
            )


def late_rows(noun: str, times: Sequence[float], horizon: float, late: float = 1.0) -> str | None:
    """Return the warning that nearly all rows of a table are after the end of a run; None if that is not so.

    Args:
        noun: a row of the table.
        times: the times of the rows since the start of the run, s, ascending.
        horizon: the horizon, s.
        late: the time of the second row, in horizons, beyond which only the first row counts.
    """
    if len(times) > 1 and times[1] > late * horizon:
        which = f"only the first {noun} counts: the second is at {times[1]:g} s"
    else:
        rows = [time for time in times if time >= 0.0]
        count = bisect_right(rows, horizon)
        is_sparse = len(rows) > 1 and (rows[-1] - rows[0]) / (len(rows) - 1) >= SPARSE
        if not is_sparse or len(rows) < LEAST_ROWS or count * ROWS_PER_COUNTED > len(rows):
            return None
        which = f"only {count} of {len(rows)} {noun}s count: the last is at {rows[-1]:g} s"
    return f"{which}, and the horizon is {horizon:g} s; are the times in another unit?"


def _largest(model: Any) -> float:
    """Return the largest finite number in the list or the matrix `values` of a model; 0 if it has none."""
    values = array_of(getattr(model, "values", ()) if isinstance(model, Value) else ())
    return float(values[values < inf].max(initial=0.0)) if values.dtype.kind in "if" else 0.0


def _trace_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about measured links: traces that end before the run, doubtful values, numbers of nodes."""
    owners = [("network", dict(scenario.network)), *(("network.graph", edge) for edge in edge_attributes(scenario))]
    owners += [(f"network.link.{k}", dict(link)) for k, link in enumerate(scenario.network.link)]
    notes: dict[tuple[str, str], None] = {}  # an ordered set: both directions of an edge give one note
    spans: dict[str, float] = {}
    for key, owner in owners:
        for name in ("latency", "loss", "duplicate"):
            model = owner.get(name)
            if is_fill(largest := _largest(model)):
                place = key if key == "network.graph" else f"{key}.{name}.values"
                notes[place, f"{largest:g} may stand for a message without an answer: leave it out"] = None
            if not isinstance(model, LinkTrace):
                continue
            if (named := model.named_nodes) is not None:
                place = key if key == "network.graph" else f"{key}.{name}.nodes"
                notes[place, f"the nodes of {model.name} are numbered in its order: {named}"] = None
            if model.is_replayed and model.doubt is not None:
                field, doubt = model.doubt
                notes[key if key == "network.graph" else f"{key}.{name}.{field}", doubt] = None
            times = model.measurements.times
            if model.is_replayed and len(times) > 1 and model.start != "random":
                since = (times / SECOND - model.start).tolist()
                if (why := late_rows("row", since, scenario.horizon)) is not None:
                    notes[key if key == "network.graph" else f"{key}.{name}.time_unit", why] = None
            if model.is_replayed and model.after == "error" and model.span < scenario.horizon:
                place = key if key == "network.graph" else f"{key}.{name}.after"
                spans[place] = min(model.span, spans.get(place, inf))
    yield from notes
    for place, span in spans.items():
        yield (
            place,
            f"a message that is sent later than {span:g} s ends the run with an error, and the horizon is"
            f" {scenario.horizon:g} s",
        )


def _wall_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about walls that weaken radio, and about path loss exponents that allow for walls."""
    network, exponent = scenario.network, ReceptionTraits.of(scenario.network.reception).exponent
    is_by_power = isinstance(network.medium, Radio) and network.medium.reception.needs_positions
    lossy = [(k, wall) for k, wall in enumerate(scenario.wall) if 0.0 < wall.decibels < inf]
    if isinstance(network.reception, Disk | QuasiUnitDisk) and exponent != Disk().exponent and not lossy:
        yield "network.reception.exponent", "it has no effect: no wall weakens radio without blocking it"
    if lossy and exponent > LARGEST_EXPONENT:
        yield (
            "network.reception.exponent",
            f"an exponent of {exponent:g} probably has walls in it, as those of ITU-R P.1238: with the tables `wall`,"
            " they count twice",
        )
    for k, wall in lossy:
        if network.range == inf and not is_by_power:
            yield f"wall.{k}", "its loss has no effect while network.range is inf: only an opaque wall (loss = inf) has"
        if wall.material is not None and wall.frequency < MATERIALS[wall.material].low:
            low = MATERIALS[wall.material].low / 1e9
            yield (
                f"wall.{k}.frequency",
                f"the properties of {wall.material} are extrapolated: they begin at {low:g} GHz",
            )


def _channel_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about access to a channel and interference."""
    medium = scenario.network.medium
    if not isinstance(medium, Radio):
        return
    if not medium.contends:
        if medium.reception != Collision():
            yield "network.medium.reception", "it has no effect, because no frames overlap with access.kind 'ideal'"
        return
    if isinstance(medium, LoRa) and medium.gateways is not None and not medium.is_tuned:
        yield (
            "network.medium.gateways",
            "it has no effect: without `spreading_factors` and `frequencies` all nodes are tuned to each other",
        )
    if medium.half_duplex:
        yield "network.medium.half_duplex", "it has no effect: nodes that contend never receive while they transmit"
    if isinstance(medium.access, Tdma) and scenario.fault:
        yield from _absentee_warnings(scenario, medium, medium.access)
    access, airtime = medium.access, scenario.announcement_airtime
    if isinstance(access, SlottedAloha) and scenario.announces and nanoseconds(access.slot) < nanoseconds(airtime):
        yield (
            "network.medium.access.slot",
            f"an announcement of {scenario.announcement_size} bytes takes {airtime:g} s on the air, longer than a slot"
            f" of {access.slot:g} s: frames of neighbouring slots overlap",
        )


def _absentee_warnings(scenario: Scenario, medium: Radio, access: Tdma) -> Iterator[tuple[str, str]]:
    """Yield a warning if a slot is too short for a message of the schedule that lists many pursuers without an answer.

    That such a message fits without absentees is checked in `desim.scenario.misfits`.
    """
    traits, count = scenario.schedule_traits, scenario.team.count
    if traits.message_size is None or not traits.absentee_size:
        return
    size = size_by(traits.message_size, count, scenario.announcement_size)
    most, free = count - 2, nanoseconds(access.slot) - nanoseconds(access.guard)  # sender and receiver are present

    def airtime(absentees: int) -> int:
        return nanoseconds(airtime_of(medium, size + absentees * traits.absentee_size, count))

    fitting = bisect_right(range(most + 1), free, key=airtime) - 1
    if 0 <= fitting < most:
        least = -(-(airtime(most) + nanoseconds(access.guard)) // 1000) / 1e6  # s, rounded up to whole microseconds
        yield (
            "network.medium.access.slot",
            f"a message of the schedule lists the pursuers that do not answer: it is never sent if they are more than"
            f" {fitting}; with {most} of them it needs a slot of {least:.10g} s (got {access.slot:g})",
        )

"""Warnings about valid but probably unintended scenarios, for example keys without effect and violated assumptions."""

from collections.abc import Collection, Iterator, Sequence
from math import inf, sqrt
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel

from desim.config.choice import choices_of
from desim.config.model import RESOLUTION, Counted, Recurring, markers_of
from desim.config.traits import inherits
from desim.kernel.clock_sync import Unsynchronised
from desim.kernel.core.units import nanoseconds
from desim.kernel.graph_files.graph_attributes import unread_attributes
from desim.kernel.measured.base import LinkTrace
from desim.kernel.models.access import Csma, SlottedAloha, Tdma
from desim.kernel.models.faults import ClockSkew, Fault
from desim.kernel.models.graphs import Complete, Edges, as_model, links_with_attributes
from desim.kernel.models.interference import Collision, Faded
from desim.kernel.models.latency import mean_latency
from desim.kernel.models.links import Links
from desim.kernel.models.medium import LoRa, Radio
from desim.kernel.models.presets import PRESETS
from desim.kernel.models.reception import Disk
from desim.kernel.models.transport import BestEffort, Coded, Reliable
from desim.pursuit.byzantine.lies import (
    ByzantineFault,
    FalseAnnouncements,
    Liar,
    RandomLies,
    Selective,
    Silent,
    Slander,
)
from desim.pursuit.core.traits import DisseminationTraits
from desim.pursuit.motion.guidance import PurePursuit
from desim.pursuit.sensing.sensing import Sensing
from desim.pursuit.sensing.tracking import Estimator
from desim.pursuit.team.announcements import DISSEMINATIONS
from desim.pursuit.team.trust import INITIAL_REPUTATION, TRUSTS, Credulous, Reputation, Trimmed, tolerated_liars
from desim.scenario.assumptions import initial_graph, is_relayed, violations
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.scenario.simultaneous import simultaneous_warnings

SAMPLE_SIZE = 130
"""The memory that the recorded position of a player takes, bytes."""
LARGE = 1e9
"""The memory for recorded samples beyond which a warning is given, bytes."""
ROUNDS_TO_0 = "rounds to 0, because time is counted in nanoseconds"
LONG_LATENCY = 0.1
"""The share of the horizon above which a mean latency gives a warning.

With a longer latency, a chain of messages, each sent on arrival of the one before, has fewer than ten messages in a
run, so the pursuers can hardly negotiate.
Latencies in seconds are usually far below it: in the files of `scenarios`, outside of grids, at most 1.5 % of the
horizon. Latencies given in milliseconds by mistake are above it: even the 5 ms of a fast radio become 5 s, a sixth of
the default horizon.
"""
RARE_TURNS = 10.0
"""The time between two turns of an evader, s, beyond which a filter that expects it gives a warning.

Turns in random directions at a rate 1 / T change each component of a velocity v as a diffusion v / sqrt(T) does. In
scenarios/noisy.toml with the fusion by_stamp, the mean normalised squared error of positions, 2 if the filter is as
sure as it should be, is 5.3 +- 1.8, 3.2 +- .7, 1.9 +- .2 and 1.5 +- .1 for T = 320, 81, 8 and 0.8 s (8 seeds; the
errors are standard errors).
"""
CSMA_UNUSED = MappingProxyType({"nonpersistent": ("p", "slot"), "p_persistent": ("backoff", "attempts")})
"""The keys of CSMA that have no effect, by persistence."""


def warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the key and the text of each warning about a scenario that is valid but probably unintended."""
    fastest = max(scenario.team.all_speeds())
    evader_speeds = [evader.speed for evader in scenario.evaders]
    if fastest <= max(evader_speeds):
        yield "team.speeds", _all_too_slow(fastest, evader_speeds, scenario.prune != "none")
    yield from _inertia_warnings(scenario)
    yield from _memory_warnings(scenario)
    yield from _record_warnings(scenario)
    yield from _flow_warnings(scenario)
    yield from _estimates_warnings(scenario)
    yield from _sensing_warnings(scenario)
    yield from _network_warnings(scenario)
    yield from latency_warnings([scenario])
    yield from violations(scenario)
    if (warn := scenario.schedule_traits.warnings) is not None:
        yield from ((f"protocol.schedule.{key}", why) for key, why in warn(scenario.motion.step))
    yield from _time_warnings(scenario)
    stride = scenario.motion.step * max(fastest, *evader_speeds)
    if scenario.capture.test == "sample" and stride > 2 * scenario.capture.radius:
        yield (
            "motion.step",
            f"a player may jump across the capture disc between two samples: step x speed = {stride:g} m is more"
            f" than 2 x radius = {2 * scenario.capture.radius:g} m",
        )


def _inertia_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about pursuers with inertia: what has no effect, or is not announced."""
    team = scenario.team
    if team.has_inertia and scenario.motion.static:
        yield "team.dynamics", "capture times follow simple motion, because nothing moves (`motion.static`)"
    if team.has_inertia and scenario.announce.payload == "state" and scenario.announces:
        yield (
            "announce.payload",
            "announcements have no velocity and heading, so the motion of a teammate with inertia is extrapolated as if"
            ' it were simple ("course" contains them)',
        )


def _estimates_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about estimates that are to be recorded and cannot be."""
    if not scenario.record.estimates:
        return
    if not scenario.sensing.has_covariances or scenario.protocol_traits.omniscient:
        yield "record.estimates", "no estimate has a covariance (`sensing.estimator` kalman), so none is recorded"
    elif not scenario.record.trajectory:
        yield "record.estimates", "estimates are recorded with the positions, and these are not (`record.trajectory`)"


def _memory_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield a warning if the recorded samples may fill the memory."""
    if not scenario.record.trajectory:
        return
    pursuers, evaders = scenario.team.count, len(scenario.evaders)
    per_sample = pursuers + evaders + (pursuers * evaders if scenario.record.estimates else 0)
    count = per_sample * scenario.horizon / scenario.record.trajectory
    if (size := count * SAMPLE_SIZE) > LARGE:
        yield (
            "record.trajectory",
            f"up to {count:,.0f} positions are recorded, about {size / 1e9:,.1f} GB of memory: sample less often",
        )


def _record_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about recorded motion whose file has heights."""
    evaders = scenario.evader if isinstance(scenario.evader, tuple) else (scenario.evader,)
    keys = [f"evader.{k}.strategy" if evaders is scenario.evader else "evader.strategy" for k in range(len(evaders))]
    records: list[tuple[str, Any]] = [
        *((key, evader.record) for key, evader in zip(keys, evaders, strict=True)),
        *((f"team.relay.{k}.motion", relay.motion) for k, relay in enumerate(scenario.team.relay)),
        ("team.positions", scenario.team),
    ]
    for key, record in records:
        if getattr(record, "has_heights", False):
            yield key, "the heights in the file are dropped: motion is in the plane, and so are all distances"


def _flow_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about a flow without an effect, and about a guidance that does not allow for it."""
    environment = scenario.environment
    if environment.is_still and environment.on != "all":
        yield "environment.on", "it has no effect without a flow"
    if not environment.is_still and scenario.motion.static:
        yield "environment.flow", "it has no effect, because nothing moves (`motion.static`)"
    elif not environment.is_still and environment.on == "pursuers" and inherits(scenario.team.guidance, PurePursuit):
        yield (
            "team.guidance",
            "the wind carries a pursuer aside that heads for where the evader is, so it comes later than its capture"
            " time says (by 5 to 19 % in examples): constant_bearing allows for the wind",
        )


def _all_too_slow(fastest: float, evader_speeds: Sequence[float], pruned: bool) -> str:
    """Return the warning that no pursuer is faster than some evaders.

    Args:
        fastest: greatest speed of the pursuers, m/s.
        evader_speeds: speeds of the evaders, m/s.
        pruned: whether pursuers are barred from chasing an evader that they cannot capture.
    """
    quick = [speed for speed in evader_speeds if speed >= fastest]
    which, they, whose, whom = (
        ("the evader", "the evader", "", "")
        if len(evader_speeds) == 1
        else (f"{len(quick)} of the {len(evader_speeds)} evaders", "the slowest of these", " of theirs", " them")
    )
    return (
        f"no pursuer is faster than {which}: the fastest moves at {fastest} m/s, {they} at {min(quick)} m/s, so every"
        f" capture time{whose} is inf{f' and no pursuer will chase{whom}' if pruned else ''}"
    )


def latency_warnings(scenarios: Collection[Scenario]) -> Iterator[tuple[str, str]]:
    """Yield the key and the text of a warning for each latency that was probably given in milliseconds by mistake.

    The scenarios are the configurations of a sweep, or a single scenario. A sweep may vary a latency from short to long
    on purpose. With several scenarios, a latency therefore gives a warning only if its mean is long (`LONG_LATENCY`) in
    all scenarios where it is positive, or reaches the horizon in one.
    """
    found: dict[str, list[tuple[float, float]]] = {}
    for scenario in scenarios:
        for key, mean in _mean_latencies(scenario):
            if mean > 0.0:
                found.setdefault(key, []).append((mean, scenario.horizon))
    for key, each in found.items():
        mean, horizon = max(each, key=lambda one: one[0] / one[1])
        share = "not less than" if mean >= horizon else "more than a tenth of"
        if mean >= horizon or all(value > LONG_LATENCY * limit for value, limit in each):
            of_edge = " of an edge" if key == "network.graph" else ""
            yield (
                key,
                f"the mean latency{of_edge} of {mean:g} s is {share} the horizon of {horizon:g} s: times are in s, not"
                " ms",
            )


def sweep_warnings(base: Scenario, keys: Sequence[str], scenarios: Sequence[Scenario]) -> Iterator[tuple[str, str]]:
    """Yield the key and the text of each warning about a sweep that `warnings` does not give for its base.

    Args:
        base: the scenario that is varied.
        keys: the keys of the grid.
        scenarios: the scenario of each configuration.
    """
    known = dict(latency_warnings([base]))
    yield from ((key, why) for key, why in latency_warnings(scenarios) if key not in known)
    reported = any(not scenario.sensing.is_perfect for scenario in scenarios)  # limited sensing: sightings are sent
    tables = ("announce.",) if reported else ("network.", "announce.")
    unread = [key for key in keys if key.startswith(tables) and key != "announce.payload"]
    if unread and all(map(_senses_instead, scenarios)):
        names = ", ".join(dict.fromkeys(scenario.protocol_name for scenario in scenarios))
        silent = f"positions are sensed, so nothing is announced (`announce.payload`) under {names}"
        yield from ((key, f"it probably has no effect: {silent}") for key in unread)


def _senses_instead(scenario: Scenario) -> bool:
    """Return whether pursuers need no announcements, because they sense what they would announce."""
    needs_none = scenario.protocol_traits.announces == "unseen" and _tells_nothing(scenario)
    return needs_none and scenario.clocks.sync == Unsynchronised() and scenario.announce.trust.period is None


def _mean_latencies(scenario: Scenario) -> Iterator[tuple[str, float]]:
    """Yield the key and the mean (s) of each latency of the network whose mean is known; of edges, the longest."""
    network = scenario.network
    models = {"network.latency": network.latency}
    models |= {f"network.link.{k}.latency": link.latency for k, link in enumerate(network.link) if link.latency}
    for key, model in models.items():
        if (mean := mean_latency(model)) is not None:
            yield key, mean
    means = [
        mean_latency(as_model("latency", own["latency"])) for own in _edge_attributes(scenario) if "latency" in own
    ]
    yield "network.graph", max((mean for mean in means if mean is not None), default=0.0)
    if (before := mean_latency(network.processing.sender)) is not None:
        yield "network.processing", before + network.processing.receiver


def _edge_attributes(scenario: Scenario) -> Iterator[dict[str, Any]]:
    """Yield the attributes of each link of the graph that has some."""
    yield from (own for _, _, own in links_with_attributes(scenario.network.make_graph(scenario.team.count)))


def _graph_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about attributes of a graph that are not read, and about shifted numbers of nodes."""
    model, count = scenario.network.graph, scenario.team.count
    notes = model.notes if isinstance(model, Edges) else unread_attributes(scenario.network.make_graph(count))
    yield from (("network.graph", note) for note in notes)


def _time_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about times that round to 0, and about periods that are longer than the horizon."""
    used = {
        "announce.heartbeat": _has_heartbeats(scenario),
        "sensing.period": not scenario.sensing.is_perfect,
        "sensing.interval": scenario.sensing.is_noisy,
    }
    for key, time, markers in _numbers(scenario):
        if Counted in markers and 0.0 < time <= RESOLUTION / 2:
            yield key, f"{time:g} s {ROUNDS_TO_0}"
        if Recurring in markers and time > scenario.horizon and used.get(key, True):
            yield key, f"{time:g} s is longer than the horizon of {scenario.horizon:g} s"


def _numbers(model: BaseModel, above: str = "") -> Iterator[tuple[str, float, list[Any]]]:
    """Yield the key, the value and the markers of every number in a model and its nested models."""
    for name, field in type(model).model_fields.items():
        value, markers = dict(model)[name], markers_of(field)
        for place, each in enumerate(value) if isinstance(value, tuple) else [(None, value)]:
            key = f"{above}{name}" if place is None else f"{above}{name}.{place}"
            if isinstance(each, BaseModel):
                yield from _numbers(each, f"{key}.")
            elif isinstance(each, int | float):
                yield key, each, markers


def _has_heartbeats(scenario: Scenario) -> bool:
    return scenario.announces and scenario.announce.has_heartbeats


def _sensing_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about keys of sensing without effect, and about a sensing radius within the capture radius."""
    sensing = scenario.sensing
    if sensing.is_perfect:
        default = dict(Sensing())
        others = [key for key, value in sensing if value != default[key]]
        yield from ((f"sensing.{key}", "it has no effect while the radius is inf") for key in others)
        return
    if isinstance(sensing.estimator, Estimator):
        diffusion = sensing.estimator.velocity_diffusion
        speed = max((evader.speed for evader in scenario.evaders if evader.turns_at_once), default=0.0)
        if (time := (speed / diffusion) ** 2) > RARE_TURNS:
            yield (
                "sensing.estimator.velocity_diffusion",
                f"an evader that turns at once may change its velocity by 2 v_e = {2 * speed:g} m/s between two"
                f" sightings, where the filter expects {diffusion * sqrt(sensing.interval):.2g} m/s: it suits an evader"
                f" that turns once in {time:.3g} s, and is too sure of itself after each turn"
                f" (v_e / sqrt({RARE_TURNS:g} s) = {speed / sqrt(RARE_TURNS):.2g} suits one that turns more often)",
            )
    if sensing.radius <= scenario.capture.radius:
        yield (
            "sensing.radius",
            f"no pursuer sees an evader before it captures it: the sensing radius of {sensing.radius:g} m is not"
            f" greater than the capture radius of {scenario.capture.radius:g} m",
        )


def _network_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
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
    is_mute = announce.trigger == "never" and not _announces_start(scenario)
    if is_mute and _sends_announcements(scenario) and _is_built_in(scenario):
        yield "announce.dissemination", "it has no effect, because nothing is ever announced"
    yield from _transport_warnings(scenario)
    if scenario.clocks.sync != Unsynchronised() and not any(isinstance(each, ClockSkew) for each in scenario.fault):
        yield "clocks.sync", "it costs messages, and all clocks are right (`fault.kind` clock_skew makes them wrong)"
    for k, fault in enumerate(scenario.fault):
        if isinstance(fault, Fault | ByzantineFault) and fault.start >= scenario.horizon:
            yield f"fault.{k}.start", "the fault starts after the horizon"
    yield from _lie_warnings(scenario)
    yield from _trust_warnings(scenario)
    yield from _trace_warnings(scenario)
    yield from _channel_warnings(scenario)
    yield from simultaneous_warnings(scenario)
    size, airtime = scenario.announcement_size, scenario.announcement_airtime
    if 0.0 < airtime <= RESOLUTION / 2:
        yield "network.medium", f"the airtime of {size} bytes, {airtime:.1g} s, {ROUNDS_TO_0}"
    contend = isinstance(network.medium, Radio) and network.medium.contends
    all_hear_all = network.range == inf and inherits(network.graph, Complete)
    is_one_channel = network.medium.shared or (contend and all_hear_all)
    load = airtime / announce.heartbeat * (scenario.team.count if is_one_channel else 1)
    if _has_heartbeats(scenario) and load > 1.0:
        yield (
            "announce.heartbeat",
            f"heartbeats of {size} bytes alone need {load:.1f} times the capacity of the channel: queues grow without"
            f" bound, or messages {'collide or ' if contend else ''}are dropped",
        )


def _lie_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about Byzantine faults without an effect."""
    payload = None if scenario.protocol_traits.claim_size else scenario.announce.payload
    reports = scenario.protocol_traits.reckons and not scenario.announces
    forwards = DisseminationTraits.of(scenario.announce.dissemination).relays
    token = scenario.schedule_traits.spreads_to is not None
    accuses = scenario.announce.trust.period is not None
    for k, fault in enumerate(scenario.fault):
        if not isinstance(fault, ByzantineFault):
            continue
        acts = fault.acts == "stay"
        if isinstance(fault, Slander) and not (accuses or acts):
            yield f"fault.{k}", "it has no effect, because `announce.trust` reads no accusations"
        elif not (isinstance(fault, Slander | Silent) or acts) and _tells_nothing(scenario):
            yield f"fault.{k}", f"it has no effect, because pursuers announce nothing under {scenario.protocol_name!r}"
        elif isinstance(fault, Selective) and not (forwards or token or acts) and _is_built_in(scenario):
            yield f"fault.{k}", "it has no effect, because pursuers forward nothing"
        elif isinstance(fault, FalseAnnouncements) and _is_built_in(scenario):
            contained = {
                "phi": payload in {"time", None} and not reports,
                "position": payload in {"state", "course"} or reports,
            }
            unused = [key for key, is_said in contained.items() if dict(fault)[key] is not None and not is_said]
            yield from ((f"fault.{k}.{key}", "it has no effect: announcements do not contain it") for key in unused)
        if isinstance(fault, Liar) and (fault.action, fault.phi, fault.position) == ("truth", None, None):
            yield f"fault.{k}.action", "the announcements are true"


def _trust_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about trust without an effect, or with more liars than it can tolerate."""
    trust, count = scenario.announce.trust, scenario.team.count
    if isinstance(trust, Credulous):
        return
    slander = any(isinstance(fault, Slander | RandomLies) for fault in scenario.fault)
    is_accused = slander and trust.period is not None
    if _tells_nothing(scenario) and TRUSTS.holds(trust) and not is_accused:
        yield "announce.trust", "it has no effect, because pursuers announce nothing"
    if isinstance(trust, Trimmed):
        if scenario.protocol_traits.claim_size:
            yield "announce.trust", f"{scenario.protocol_name} compares bids, of which none is ignored"
        if trust.liars > tolerated_liars(count):
            yield (
                "announce.trust.liars",
                f"a complete graph of {count} pursuers is robust against {tolerated_liars(count)} liars",
            )
        elif trust.liars and not is_relayed(scenario) and not _tells_nothing(scenario):
            yield from _sparse_warnings(scenario, trust.liars)
        return
    is_slow_to_trust = isinstance(trust, Reputation) and trust.threshold > INITIAL_REPUTATION
    if scenario.motion.static and TRUSTS.holds(trust) and not (is_accused or is_slow_to_trust):
        yield "announce.trust", "it has no effect: no pursuer moves, so no motion refutes an announcement"


def _sparse_warnings(scenario: Scenario, liars: int) -> Iterator[tuple[str, str]]:
    """Yield a warning if a pursuer has too few neighbours for F liars among them.

    The rule needs a (2F + 1)-robust graph (LeBlanc et al. 2013, theorem 2). Of a single node and all others, one set
    has a node with 2F + 1 neighbours outside of its set. It is the single node, because all others have one neighbour
    there. So each has at least 2F + 1 neighbours. This is necessary and not sufficient; whether a graph is robust takes
    a time that is exponential in its size.
    """
    neighbours = dict(initial_graph(scenario).in_degree())
    pursuer = min(neighbours, key=lambda node: (neighbours[node], node), default=0)
    needed = 2 * liars + 1
    if neighbours.get(pursuer, 0) < needed:
        yield (
            "announce.trust.liars",
            f"to tolerate {liars} among its neighbours, each pursuer needs at least 2 F + 1 = {needed} of them, and"
            f" pursuer {pursuer} hears {neighbours.get(pursuer, 0)} at the start",
        )


def _is_built_in(scenario: Scenario) -> bool:
    """Return whether protocol, schedule and dissemination are built in, so that it is known what they send."""
    protocol: Any = scenario.protocol
    if not (PROTOCOLS.holds(protocol) and DISSEMINATIONS.holds(scenario.announce.dissemination)):
        return False
    fields = type(protocol).model_fields
    return (
        all(kinds.holds(protocol.schedule) for kinds in choices_of(fields["schedule"]))
        if "schedule" in fields
        else True
    )


def _tells_nothing(scenario: Scenario) -> bool:
    """Return whether no message has the action or the state of a pursuer: no announcement, report or token."""
    tells = scenario.announces or scenario.protocol_traits.reckons or scenario.schedule_traits.spreads_to is not None
    return _is_built_in(scenario) and not tells


def _trace_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about traces of links that may end before the run, and how named nodes were numbered."""
    owners = [("network", dict(scenario.network)), *(("network.graph", own) for own in _edge_attributes(scenario))]
    owners += [(f"network.link.{k}", dict(link)) for k, link in enumerate(scenario.network.link)]
    numbers: dict[tuple[str, str], None] = {}  # once for both ways of an edge
    spans: dict[str, float] = {}
    for key, owner in owners:
        for name in ("latency", "loss"):
            model = owner.get(name)
            if not isinstance(model, LinkTrace):
                continue
            if (named := model.named_nodes) is not None:
                place = key if key == "network.graph" else f"{key}.{name}.nodes"
                numbers[place, f"the nodes of {model.name} are numbered in its order: {named}"] = None
            if model.is_replayed and model.after == "error" and model.span < scenario.horizon:
                place = key if key == "network.graph" else f"{key}.{name}.after"
                spans[place] = min(model.span, spans.get(place, inf))
    yield from numbers
    for place, span in spans.items():
        yield (
            place,
            f"a message that is sent later than {span:g} s ends the run with an error, and the horizon is"
            f" {scenario.horizon:g} s",
        )


def _transport_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about transports without an effect, and windows that are never full."""
    announce, transport = scenario.announce, scenario.network.transport
    for key, model in (("network.transport", transport), ("announce.dissemination", announce.dissemination)):
        if isinstance(model, Reliable) and model.history == "keep_last" and model.depth < model.window:
            yield (
                f"{key}.window",
                f"no more than depth = {model.depth} messages are kept, so a window of {model.window} is never full",
            )
    sends = scenario.schedule_traits.spreads_to is not None or not scenario.sensing.is_perfect
    sends = sends or announce.trust.period is not None  # accusations
    if transport != BestEffort() and scenario.announces and not sends and _is_built_in(scenario):
        if isinstance(announce.dissemination, Reliable | Coded):
            yield "network.transport", "it has no effect: announcements have their own (`announce.dissemination`)"
        elif not _sends_announcements(scenario):
            yield (
                "network.transport",
                "it has no effect on announcements, which are published as state; the kinds 'reliable' and 'coded' of"
                " `announce.dissemination` send them as messages",
            )


def _announces_start(scenario: Scenario) -> bool:
    """Return whether several pursuers announce their first actions at the start."""
    return scenario.announces and scenario.announce.start == "announced" and scenario.team.count > 1


def _sends_announcements(scenario: Scenario) -> bool:
    """Return whether announcements are sent as messages, not published."""
    dissemination = scenario.announce.dissemination
    return isinstance(dissemination, Reliable | Coded) or DisseminationTraits.of(dissemination).relays


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
    reception = medium.reception
    if isinstance(reception, Faded):
        usual = dict(type(reception)())
        for key in sorted(reception.unused_fields):
            if dict(reception)[key] != usual[key]:
                yield f"network.medium.reception.{key}", f"it has no effect with fading {reception.fading!r}"
    if medium.half_duplex:
        yield "network.medium.half_duplex", "it has no effect: nodes that contend never receive while they transmit"
    access, airtime = medium.access, scenario.announcement_airtime
    size, heartbeat = scenario.announcement_size, scenario.announce.heartbeat
    is_delayed = medium.duty_cycle is not None or isinstance(access, Tdma)
    interval = medium.interval(size, scenario.team.count)
    if _has_heartbeats(scenario) and is_delayed and interval > heartbeat:
        why = "its duty cycle" if medium.duty_cycle is not None else "the slots of the TDMA"
        yield (
            "announce.heartbeat",
            f"a heartbeat of {heartbeat:g} s is shorter than the time for which {size} bytes keep a pursuer from"
            f" sending again, {interval:.3g} s, because of {why}: heartbeats are delayed or dropped",
        )
    if isinstance(access, Csma):
        default, unused = dict(Csma()), CSMA_UNUSED[access.persistence]
        others = [key for key in unused if dict(access)[key] != default[key]]
        why = f"it has no effect with persistence {access.persistence!r}"
        yield from ((f"network.medium.access.{key}", why) for key in others)
    if isinstance(access, SlottedAloha) and scenario.announces and nanoseconds(access.slot) < nanoseconds(airtime):
        yield (
            "network.medium.access.slot",
            f"an announcement of {scenario.announcement_size} bytes takes {airtime:g} s on the air, longer than a slot"
            f" of {access.slot:g} s: frames of neighbouring slots overlap",
        )

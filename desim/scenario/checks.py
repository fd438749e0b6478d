"""Warnings about scenarios that can be simulated and are probably not meant, such as keys without effect.

Each subject has a module (`motion_warnings`, `link_warnings`, `latency_warnings`, `liar_warnings`, `simultaneous`);
this one collects their warnings, and adds those that concern all keys alike. Kinds of users are checked, too: markers
(`Counted`, `Recurring`) say which of their numbers are times, `unused_fields` names their keys without effect, and a
schedule has a method `warnings`. Violated assumptions of protocols are warnings, too
(`desim.scenario.assumptions`); values that cannot be simulated are errors (`desim.scenario.misfits`).
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

from pydantic import BaseModel

from desim.config.model import RESOLUTION, Counted, Recurring, Value
from desim.config.model_parts import indexed_parts, markers_of, models_within
from desim.kernel.clock_sync import Unsynchronised
from desim.scenario.assumptions import violations
from desim.scenario.latency_warnings import latency_warnings
from desim.scenario.liar_warnings import lie_warnings, trust_warnings
from desim.scenario.link_warnings import ROUNDS_TO_0, network_warnings
from desim.scenario.motion_warnings import motion_warnings
from desim.scenario.properties import CANNOT_FAIL
from desim.scenario.scenario import Scenario
from desim.scenario.simultaneous import simultaneous_warnings
from desim.scenario.telling import has_heartbeats, tells_nothing

SAMPLE_SIZE = 130
"""The memory that the recorded position of a player takes, bytes."""
LARGE = 1e9
"""The memory for recorded samples beyond which a warning is given, bytes."""


def warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the key and the text of each warning about a scenario that is valid but probably unintended."""
    yield from motion_warnings(scenario)
    yield from _memory_warnings(scenario)
    yield from network_warnings(scenario)
    yield from lie_warnings(scenario)
    yield from trust_warnings(scenario)
    yield from simultaneous_warnings(scenario)
    yield from latency_warnings([scenario])
    yield from violations(scenario)
    if (warn := scenario.schedule_traits.warnings) is not None:
        yield from ((f"protocol.schedule.{key}", why) for key, why in warn(scenario.motion.step))
    yield from _time_warnings(scenario)
    for place, model in models_within(scenario):
        yield from _unused_warnings(model, "".join(f"{part}." for part in place))
    for k, prop in enumerate(scenario.properties):
        if not prop.can_fail(scenario):
            yield f"properties.{k}", f"it says nothing: {CANNOT_FAIL}"
    if scenario.sweep.design is not None and not scenario.sweep.design.is_balanced:
        size = scenario.sweep.design.size
        exponent = size.bit_length()  # of the next power of 2
        near = f"{2 ** (exponent - 1)} or {2**exponent}"
        yield "sweep.design.size", f"{size} points of a Sobol sequence are less even than a power of 2, such as {near}"


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


def sweep_warnings(base: Scenario, keys: Sequence[str], scenarios: Sequence[Scenario]) -> Iterator[tuple[str, str]]:
    """Yield the key and the text of each warning about a sweep that `warnings` does not give for its base.

    Args:
        base: the scenario that is varied.
        keys: the keys of the grid.
        scenarios: the scenario of each configuration.
    """
    of_base = dict(latency_warnings([base]))
    yield from ((key, why) for key, why in latency_warnings(scenarios) if key not in of_base)
    sends_sightings = any(not scenario.sight_is_perfect for scenario in scenarios)
    tables = ("announce.",) if sends_sightings else ("network.", "announce.")  # sightings need the network
    unused = [key for key in keys if key.startswith(tables) and key != "announce.payload"]
    if unused and all(map(_senses_instead, scenarios)):
        names = ", ".join(dict.fromkeys(scenario.protocol_name for scenario in scenarios))
        reason = f"positions are sensed, so nothing is announced (`announce.payload`) under {names}"
        yield from ((key, f"it probably has no effect: {reason}") for key in unused)


def _senses_instead(scenario: Scenario) -> bool:
    """Return whether pursuers need no announcements, because they sense what they would announce."""
    needs_none = scenario.protocol_traits.announces == "unseen" and tells_nothing(scenario)
    return needs_none and scenario.clocks.sync == Unsynchronised() and scenario.announce.trust.period is None


def _time_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about times that round to 0, and about periods that are longer than the horizon."""
    has_effect = {
        "announce.heartbeat": has_heartbeats(scenario),
        "sensing.period": not scenario.sight_is_perfect,
        "sensing.interval": scenario.sensing.is_noisy,
    }
    for key, time, markers in _numbers(scenario):
        if Counted in markers and 0.0 < time <= RESOLUTION / 2:
            yield key, f"{time:g} s {ROUNDS_TO_0}"
        if Recurring in markers and time > scenario.horizon and has_effect.get(key, True):
            yield key, f"{time:g} s is longer than the horizon of {scenario.horizon:g} s"


def _unused_warnings(model: BaseModel, above: str) -> Iterator[tuple[str, str]]:
    """Yield a warning for each field that is given, and that another field of its model disables."""
    unused, fields = model.unused_fields if isinstance(model, Value) else {}, dict(model)
    for name, why in sorted(unused.items()):
        if fields[name] != type(model).model_fields[name].get_default(call_default_factory=True):
            yield f"{above}{name}", f"it has no effect with {why}"


def _numbers(scenario: Scenario) -> Iterator[tuple[str, float, Sequence[Any]]]:
    """Yield the key, the value and the markers of every number in a scenario."""
    for place, model in models_within(scenario):
        for name in type(model).model_fields:
            for inner, part in indexed_parts(getattr(model, name)):
                if isinstance(part, int | float):
                    yield ".".join(map(str, (*place, name, *inner))), part, _markers(type(model), name)


@lru_cache(maxsize=1024)
def _markers(model: type[BaseModel], name: str) -> tuple[Any, ...]:
    """Return the markers of a field."""
    return tuple(markers_of(model.model_fields[name]))

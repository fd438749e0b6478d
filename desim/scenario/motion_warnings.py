"""Warnings about players that can be simulated and are probably not meant: their motion, and what they see."""

from collections.abc import Iterable, Iterator, Sequence
from math import floor, hypot, log10, sqrt
from typing import Any

import numpy as np

from desim.config.traits import inherits
from desim.kernel.clock_sync import Unsynchronised
from desim.kernel.models.clock_skew import ClockSkew
from desim.pursuit.core.state import complex_points
from desim.pursuit.evaders.evasion import PureEvasion, Still
from desim.pursuit.evaders.recorded import DROPS_HEIGHTS
from desim.pursuit.motion.flow import RecordedFlow
from desim.pursuit.motion.guidance import ConstantBearing, PurePursuit
from desim.pursuit.sensing.noise import covariance_of
from desim.pursuit.sensing.sensing import Sensing
from desim.pursuit.sensing.tracking import Estimator
from desim.scenario.link_warnings import late_rows
from desim.scenario.players import Evader
from desim.scenario.scenario import Scenario
from desim.scenario.wall_misfits import reach_warnings

SLOW = 10.0
"""If the second row of a record is later than this many horizons, its times probably have another unit."""
SHORT = 10.0
"""The horizon, s, below which a scenario probably only tries something out."""
ROUNDING = 1e-9
"""Share by which a product of decimals may exceed the number that it should equal."""
TINY = 0.5
"""The width and height of all walls together, m, below which their coordinates probably have another unit."""
RARE_TURNS = 10.0
"""A filter that is tuned for a longer time between two turns of an evader, s, gives a warning.

Turns in random directions at a rate 1 / T change each component of a velocity v as a diffusion v / sqrt(T) does. In
scenarios/noisy.toml with the fusion by_stamp, the mean normalised squared error of positions should be 2. It is
5.3 +- 1.8, 3.2 +- .7, 1.9 +- .2 and 1.5 +- .1 for T = 320, 81, 8 and 0.8 s (8 seeds; the errors are standard errors):
for a long T, the filter is too sure.
"""


DISPLACED = 0.5
"""A warning is given if a wrong clock displaces a sighting by more than so many standard deviations of its noise.

In scenarios/noisy.toml with the fusion by_stamp, the error of the range is 0.3 m. If clocks are wrong by 0, 0.1 and
0.3 s, the evader moves 0, 0.09 and 0.27 m in this time. The mean normalised squared error of positions is then 1.9, 2.4
and 5.5.
"""


def motion_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about players: what moves, how fast, and what is seen of it."""
    fastest = max(scenario.team.all_speeds())
    evader_speeds = [evader.speed for evader in scenario.evaders]
    if fastest <= max(evader_speeds):
        yield "team.speeds", _all_too_slow(fastest, evader_speeds, scenario.prune != "none")
    yield from _inertia_warnings(scenario)
    yield from _record_warnings(scenario)
    yield from _flow_warnings(scenario)
    yield from reach_warnings(scenario)
    yield from _place_warnings(scenario)
    yield from _estimates_warnings(scenario)
    yield from _sensing_warnings(scenario)
    yield from _step_warnings(scenario, fastest)


def _all_too_slow(fastest: float, evader_speeds: Sequence[float], pruned: bool) -> str:
    """Return the warning that some evaders are at least as fast as every pursuer.

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


def _step_warnings(scenario: Scenario, fastest: float) -> Iterator[tuple[str, str]]:
    """Yield a warning if pursuers of a greatest speed (m/s) may miss evaders because of the motion step h.

    A pursuer aims at the place of its evader at the start or at the end of a step. If it comes there within the step,
    it is then at most v_e h from the evader. So with v_e h <= eps it captures the evader within the bound phi, whatever
    the evader does (under pure pursuit, without inertia or a flow). With a longer step it may run past the evader, and
    back, for ever. Of 10 zigzagging evaders of amplitude 1.4, with v = 2 m/s, v_e = .9 m/s and v_e h = 2, 4 and 8 eps,
    0, 4 and 7 were never captured, and 4, 10 and 10 if all move at once (`motion.order`).
    """
    step, radius = scenario.motion.step, scenario.capture.radius
    dodging = [evader.speed for evader in scenario.evaders if evader.speed < fastest and _may_dodge(evader, scenario)]
    speed = max(dodging, default=0.0)
    if scenario.capture.test == "sample":
        stride, factor = step * max(fastest, *(evader.speed for evader in scenario.evaders)), "speed"
        if dodging and scenario.motion.order == "simultaneous":  # no player knows where the other will be
            stride, factor = step * (fastest + speed), "sum of both speeds"
        if stride > 2 * radius * (1.0 + ROUNDING):
            yield (
                "motion.step",
                f"a player may jump across the capture disc between two samples: step x {factor} = {stride:g} m is more"
                f" than 2 x radius = {2 * radius:g} m",
            )
        return
    if step * speed > radius * (1.0 + ROUNDING) and not scenario.motion.static:
        limit = radius / speed
        unit = 10.0 ** floor(log10(limit) - 1.0)  # of the second digit
        yield (
            "motion.step",
            "a pursuer aims at one place for a whole step, in which an evader moves by step x speed ="
            f" {step * speed:g} m, more than the capture radius of {radius:g} m: it may run past the evader again and"
            f" again; a step of at most {floor(limit / unit) * unit:g} s excludes this (or a greater `capture.radius`)",
        )


def _may_dodge(evader: Evader, scenario: Scenario) -> bool:
    """Return whether an evader may leave, within a motion step, the line on which its pursuer comes.

    In examples, pursuers captured evaders that fled from the nearest of them, whatever the step.
    """
    strategy, team = evader.strategy, scenario.team
    if inherits(strategy, Still):
        return False
    if scenario.sensing.is_noisy:
        return True
    if inherits(team.guidance, ConstantBearing):
        return scenario.motion.order == "simultaneous" or team.has_inertia
    flees = inherits(strategy, PureEvasion) and not evader.reaction_delay
    return not (flees and inherits(team.guidance, PurePursuit))


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


def _record_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about recorded motion: heights that are dropped, and times that may be in another unit."""
    records: list[tuple[str, Any]] = [
        *((f"{_dotted(place)}.strategy", table.record) for place, table in scenario.evader_tables),
        *((f"team.relay.{k}.motion", relay.motion) for k, relay in enumerate(scenario.team.relay)),
        ("team.positions", scenario.team.record),
    ]
    for key, record in records:
        if getattr(record, "has_heights", False):
            yield key, DROPS_HEIGHTS
        waypoints: Sequence[Any] = getattr(record, "waypoints", ())
        if (why := late_rows("waypoint", [t for t, *_ in waypoints], scenario.horizon, SLOW)) is not None:
            yield f"{key}.waypoints", why


def _flow_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about a flow without an effect, and about a guidance that does not allow for it."""
    environment = scenario.environment
    measured: Sequence[Any] = getattr(environment.flow, "velocities", ())
    if inherits(environment.flow, RecordedFlow):
        why = late_rows("measurement", [t for t, *_ in measured], scenario.horizon, SLOW)
        if why is not None:
            yield "environment.flow.velocities", why
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


def _place_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about walls and evaders that no player can come near: their coordinates may be wrong.

    No player leaves the box around the starts by more than its speed times the horizon, and the line between two
    players stays in the box with this margin. A horizon below `SHORT` probably only tries something out, so
    `SHORT` is used in its place.
    """
    environment, evaders = scenario.environment, scenario.evaders
    pursuers = complex_points(scenario.team.start(scenario.seed, scenario.space))
    starts = [complex(*evader.start(scenario.seed, k, scenario.space)) for k, evader in enumerate(evaders)]
    top_speed = max(scenario.team.top_speed, *(evader.speed for evader in evaders)) + environment.top_speed
    distance = 0.0 if scenario.motion.static else top_speed * max(scenario.horizon, SHORT)
    left, right, bottom, top = _box([*pursuers, *starts], distance)
    hint = "are its coordinates in another unit, in degrees, or from another origin?"
    if scenario.wall:
        walls = _box([complex(*corner) for wall in scenario.wall for shape in wall.shapes for corner in shape.corners])
        size = max(walls[1] - walls[0], walls[3] - walls[2])
        if size < TINY:
            yield "wall", f"it lies within {size:.2g} m: {hint} (`scale`)"
        elif walls[1] < left or walls[0] > right or walls[3] < bottom or walls[2] > top:
            yield "wall", f"it is where no player can come within the horizon: {hint} (`scale`, `offset`)"
    keys = [_dotted(place) for place, table in scenario.evader_tables for _ in range(table.count)]
    for key, start in zip(keys, starts, strict=True):
        if np.abs(pursuers - start).min() > 2.0 * SLOW * distance > 0.0:
            yield key, f"it starts so far away that no pursuer could reach it in {SLOW:g} horizons: {hint}"


def _dotted(place: Sequence[str | int]) -> str:
    return ".".join(map(str, place))


def _box(points: Iterable[complex], margin: float = 0.0) -> tuple[float, float, float, float]:
    """Return the least and greatest x, and the least and greatest y, of some points, m, with a margin around them."""
    coordinates = np.array(list(points))
    x, y = coordinates.real, coordinates.imag
    return x.min() - margin, x.max() + margin, y.min() - margin, y.max() + margin


def _estimates_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about estimates that should be recorded (`record.estimates`) and cannot be."""
    if not scenario.record.estimates:
        return
    if not scenario.sensing.has_covariances or scenario.protocol_traits.omniscient:
        yield "record.estimates", "no estimate has a covariance (`sensing.estimator` kalman), so none is recorded"
    elif not scenario.record.trajectory:
        yield "record.estimates", "estimates are recorded with the positions, and these are not (`record.trajectory`)"


def _sensing_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about keys of sensing without effect, and about a sensing radius within the capture radius."""
    sensing = scenario.sensing
    if scenario.sight_is_perfect:
        default = dict(Sensing())
        changed = [key for key, value in sensing if value != default[key]]
        yield from ((f"sensing.{key}", "it has no effect while the radius is inf") for key in changed)
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
        yield from _stamp_warnings(scenario)
    if sensing.radius <= scenario.capture.radius:
        yield (
            "sensing.radius",
            f"no pursuer sees an evader before it captures it: the sensing radius of {sensing.radius:g} m is not"
            f" greater than the capture radius of {scenario.capture.radius:g} m",
        )


def _stamp_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield a warning if sightings are processed by time stamps that are wrong."""
    t = scenario.horizon
    skews = [fault for fault in scenario.fault if isinstance(fault, ClockSkew)]
    if not skews or scenario.team.count == 1 or scenario.clocks.sync != Unsynchronised():
        return
    error = max(
        hypot(skew.offset, skew.drift * t, skew.offset_walk * sqrt(t), skew.drift_walk * sqrt(t**3 / 3.0))
        for skew in skews
    )
    displacement = error * max(evader.speed for evader in scenario.evaders)
    try:  # the noise along the line of sight of an evader that is close to its capture
        deviation = sqrt(covariance_of(scenario.sensing.noise, complex(scenario.capture.radius)).xx)
    except Exception:  # noise of a user may fail for this vector, which a run may never have
        return
    if displacement > DISPLACED * deviation:
        yield (
            "sensing.estimator",
            f"clocks are wrong by {error:.2g} s at the end, in which an evader moves {displacement:.2g} m, and a"
            f" sighting has an error of {deviation:.2g} m: a filter takes time stamps for exact, and is too sure of"
            " itself (`clocks.sync`)",
        )

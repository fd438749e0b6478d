"""Errors about models and places that do not fit walls that block motion, and the warning that walls enclose an evader.

Some models take straight lines for shortest paths; a place does not fit if it is inside a wall.
"""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from desim.config.traits import inherits, kind_of
from desim.pursuit.core.state import complex_points
from desim.pursuit.core.traits import StrategyTraits
from desim.pursuit.evaders.recorded import RecordedMotion
from desim.pursuit.motion.guidance import PurePursuit
from desim.pursuit.paths.space import Plane
from desim.scenario.conditions import AnyScenario

Misfit = tuple[tuple[str | int, ...], str]
"""The key of a value, in parts, and why it does not fit."""
INSTEAD = "let the walls not block it (`blocks` of each `wall` without motion), or choose"
"""The advice in messages; the name of another kind follows it."""
MAX_COMPARED = 1_000
"""Number of pursuers whose paths to an evader are compared before a run."""


def wall_misfits(scenario: AnyScenario) -> Iterator[Misfit]:
    """Yield the key and the text of each model that does not allow for walls, and of each player inside one."""
    space = scenario.space
    if space.is_open:
        return
    yield from _model_misfits(scenario)
    team = scenario.team
    if team.positions is not None:
        free = space.are_free(complex_points(team.positions))
        for pursuer in (~free).nonzero()[0].tolist():
            if pursuer not in team.relays:
                yield ("team", "positions", pursuer), _inside(*team.positions[pursuer])
    else:
        yield from _box_misfits(("team",), partial(team.start, scenario.seed, space))
    for k, relay in enumerate(team.relay):
        yield from _record_misfits(space, ("team", "relay", k, "motion"), relay.motion)
    for place, evader in scenario.evader_tables:
        if evader.position is not None and not space.are_free(complex_points([evader.position]))[0]:
            yield (*place, "position"), _inside(*evader.position)
        yield from _box_misfits(place, partial(evader.start, scenario.seed, 0, space))
        if evader.record is not None:
            yield from _record_misfits(space, (*place, "strategy"), evader.record)


def _model_misfits(scenario: AnyScenario) -> Iterator[Misfit]:
    """Yield the key and the text of each model that takes straight lines for shortest paths."""
    team, protocol = scenario.team, scenario.protocol_traits
    if team.has_inertia:
        yield ("team", "dynamics"), f"players with inertia cannot keep off walls: {INSTEAD} the kind simple"
    if not scenario.environment.is_still:
        yield ("environment", "flow"), f"a flow would carry players through walls: {INSTEAD} the kind none"
    if not inherits(team.guidance, PurePursuit):
        yield (
            ("team", "guidance"),
            f"among walls, pursuers follow the shortest path to the evader: {INSTEAD} the kind pure_pursuit",
        )
    if scenario.sensing.estimate == "worst_case":
        yield (
            ("sensing", "estimate"),
            f"the bound of worst_case does not allow for walls: {INSTEAD} hold or constant_velocity",
        )
    if protocol.assumes_plane:
        yield (
            ("protocol",),
            f"{kind_of(scenario.protocol)} takes straight lines for shortest paths: {INSTEAD} a protocol of capture"
            ' times, such as local_min, or argmin with `by` "capture_time"',
        )
    for place, evader in scenario.evader_tables:
        if evader.has_inertia:
            yield (*place, "dynamics"), f"players with inertia cannot keep off walls: {INSTEAD} the kind simple"
        if StrategyTraits.of(evader.strategy).assumes_plane:
            yield (
                (*place, "strategy"),
                f"{kind_of(evader.strategy)} takes straight lines for shortest paths: {INSTEAD} max_geodesic or"
                " pure_evasion",
            )


def _box_misfits(place: tuple[str | int, ...], start: Callable[[], object]) -> Iterator[Misfit]:
    """Yield the key and the text of a box in which walls leave no place to start."""
    try:
        start()
    except ValueError as error:
        yield (*place, "box"), str(error)


def _record_misfits(space: Plane, place: tuple[str | int, ...], record: RecordedMotion) -> Iterator[Misfit]:
    """Yield the key and the text of a record that crosses a wall that blocks motion."""
    waypoints = [complex(x, y) for _, x, y in record.waypoints]
    if (k := space.first_blocked(waypoints)) is not None:
        before, after = (f"[{x:g}, {y:g}]" for _, x, y in record.waypoints[k - 1 : k + 1])
        yield (
            (*place, "waypoints"),
            f"from {before} to {after} ({record.places[k]}) the record crosses a wall: {INSTEAD} another record",
        )


def reach_warnings(scenario: AnyScenario) -> Iterator[tuple[str, str]]:
    """Yield a warning for each evader that walls keep from pursuers, at the start with the seed of the scenario."""
    space, seed = scenario.space, scenario.seed
    if space.is_open:
        return
    speeds = np.array(scenario.team.all_speeds()[:MAX_COMPARED])
    pursuers = complex_points(scenario.team.start(seed, space)[:MAX_COMPARED])[speeds > 0.0]
    for index, evader in enumerate(scenario.evaders):
        place = complex(*evader.start(seed, index, space))
        apart = np.isinf(space.distances(pursuers, space.free_place(place)))
        if apart.any():
            number = f"evader {index + 1}" if len(scenario.evaders) > 1 else "the evader"
            who = "no pursuer" if apart.all() else f"{np.count_nonzero(apart)} of {len(pursuers)} pursuers cannot"
            verb = "can reach" if apart.all() else "reach"
            yield (
                "wall",
                f"{who} {verb} {number} with seed {seed}: walls that block motion enclose it or them, so phi is inf",
            )


def _inside(x: float, y: float) -> str:
    return f"[{x:g}, {y:g}] is inside a wall that blocks motion, or on one: a player should start in the open (`wall`)"

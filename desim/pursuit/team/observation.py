"""The observation of a pursuer: what its agent knows now, as named numbers, for rules that are learned.

An observation has three kinds of blocks: one of the pursuer itself (`Own`), one of each evader (`OfEvader`) and one of
each pursuer (`OfPursuer`). The name of a number is that of its block and of its field, as in "own.time_left",
"evader_1.lead" or "pursuer_3.age". Evaders are numbered from 1, pursuers from 0.
"""

from collections.abc import Iterator, Sequence
from itertools import chain
from math import isnan, nan, tanh
from typing import NamedTuple

from desim.kernel.core.units import seconds
from desim.pursuit.team.agent import Agent
from desim.pursuit.team.announcements import Assignment, Located, TimedAssignment, action_in_game

LATE = 5.0
"""The unit of time of `OfEvader.late`, s: a capture that is late by this time gives tanh(1) = 0.76."""


class Own(NamedTuple):
    """The pursuer itself."""

    x: float
    """Its position, m."""
    y: float
    """Its position, m."""
    action: float
    """The evader that it chases, 1 .. M, or 0."""
    speed: float
    """Its speed while it chases, m/s."""
    time_left: float
    """The time r until the horizon by its clock, s."""


class OfEvader(NamedTuple):
    """An evader, and the teammates that chase it, as the pursuer knows them."""

    known: float
    """1 if it is at large and its position is sensed or estimated, else 0: then positions and errors are 0, too."""
    dx: float
    """Its position relative to the pursuer, as sensed or estimated, m."""
    dy: float
    """As `dx`, m."""
    uncertainty: float
    """Upper bound of the error of the position, m; 0 without a bound."""
    xx: float
    """Variance of x, m^2; 0 if the estimate has no covariance."""
    xy: float
    """Covariance of x and y, m^2."""
    yy: float
    """Variance of y, m^2."""
    capture_time: float
    """The pursuer's capture time phi, s, at most the horizon."""
    may_chase: float
    """1 if the pursuer may choose to chase it, else 0."""
    chosen: float
    """1 if the pursuer chases it now, else 0."""
    rivals: float
    """Number of teammates that the pursuer believes to chase it."""
    free: float
    """1 if the pursuer knows no teammate that chases it, else 0."""
    lead: float
    """tanh((phi - least known phi of the teammates that the pursuer believes to chase it) / 1 s); 0 if no such phi is
    known. It is negative for a pursuer that would be first."""
    late: float
    """tanh((phi - r) / 5 s): positive for a pursuer that cannot capture it in time."""


class OfPursuer(NamedTuple):
    """A pursuer, from its newest announcement that has arrived, if any, and its sensed position; unknown numbers are 0.

    The block of the pursuer that observes has its own action and the age 0.
    """

    heard: float
    """1 if an announcement has arrived, else 0. With `announce.start = "known"` the initial action counts as one."""
    age: float
    """Time since the announcement was sent, s, at most the horizon."""
    action: float
    """The announced action, 1 .. M, or 0."""
    located: float
    """1 if the position is sensed or was announced, else 0."""
    dx: float
    """Its position relative to the pursuer that observes, m: sensed or, if it is announced, that at sending."""
    dy: float
    """As `dx`, m."""
    claim: float
    """The announced capture time, s, at most the horizon; 0 if capture times are not announced."""


def own_block(me: Agent) -> Own:
    """Return what a pursuer knows of itself."""
    place = me.position()
    return Own(place.real, place.imag, me.action, me.speed, min(max(me.time_left(), 0.0), me.horizon))


def evader_block(me: Agent, evader: int, *, omniscient: bool = False) -> OfEvader:
    """Return what a pursuer knows of an evader.

    Args:
        me: the agent of the pursuer.
        evader: the number of the evader, 1 .. M.
        omniscient: whether it knows the true position of the evader, and the true actions of its teammates.
    """
    view = me.global_state if omniscient else me
    place = view.evader(evader) if evader in me.evaders() else complex(nan, nan)
    is_known = not isnan(place.real)
    offset = place - me.position() if is_known else 0j
    uncertainty, (xx, xy, yy) = (0.0, (0.0, 0.0, 0.0)) if omniscient or not is_known else me.errors(evader)
    phi = me.global_state.capture_times_of([me.id], evader)[0] if omniscient else me.capture_time(evader)
    rivals = _true_chasers(me, evader) if omniscient else list(me.believed_chasers(evader).values())
    least = min((time for time in rivals if not isnan(time)), default=nan)
    # If both are infinite, neither pursuer is first.
    lead = 0.0 if isnan(least) or phi == least else tanh(phi - least)
    return OfEvader(
        is_known,
        offset.real,
        offset.imag,
        uncertainty,
        xx,
        xy,
        yy,
        min(phi, me.horizon),
        me.may_chase(evader),
        me.action == evader,
        len(rivals),
        not rivals,
        lead,
        tanh((phi - me.time_left()) / LATE),
    )


def _true_chasers(me: Agent, evader: int) -> list[float]:
    """Return the true capture times, s, of the teammates that chase an evader."""
    profile = me.global_state.profile()
    chasing = [j for j, action in enumerate(profile) if action == evader and j != me.id]
    return me.global_state.capture_times_of(chasing, evader) if chasing else []


def pursuer_blocks(me: Agent, *, omniscient: bool = False) -> list[OfPursuer]:
    """Return what a pursuer knows of each of the N pursuers.

    Args:
        me: the agent of the pursuer.
        omniscient: whether it knows their true positions and actions.
    """
    if omniscient:
        offsets = (me.global_state.state.positions() - me.position()).tolist()
        return [
            OfPursuer(1.0, 0.0, action, 1.0, offset.real, offset.imag, 0.0)
            for action, offset in zip(me.global_state.profile(), offsets, strict=True)
        ]
    now, horizon, here, sensed = me.now, me.horizon, me.position(), me.sensed_positions()
    records, blocks = me.latest_records(), []
    for j in range(me.team_size):
        if j == me.id:
            blocks.append(OfPursuer(1.0, 0.0, me.action, 1.0, 0.0, 0.0, 0.0))
            continue
        record, place = records.get(j), None if sensed is None else sensed[j]
        age, action, claim = 0.0, 0, 0.0
        if record is not None:
            body, age = record.body, min(max(now - seconds(record.stamp), 0.0), horizon)  # clocks may differ
            if type(body) is Assignment:  # the usual case; the tests below take a tenth of a parallel step
                action = body.active
            else:
                action = action_in_game(body, me.evader_count) or 0
                if place is None and isinstance(body, Located):
                    place = complex(body.x, body.y)
                if isinstance(body, TimedAssignment):
                    claim = min(body.capture_time, horizon)
        offset = 0j if place is None else place - here
        blocks.append(OfPursuer(record is not None, age, action, place is not None, offset.real, offset.imag, claim))
    return blocks


def observation(me: Agent, *, omniscient: bool = False) -> list[float]:
    """Return all numbers that a pursuer knows, in the order of `observation_names`.

    Args:
        me: the agent of the pursuer.
        omniscient: whether it knows the true positions and actions of all players; for comparison only.
    """
    evaders = [evader_block(me, evader, omniscient=omniscient) for evader in range(1, me.evader_count + 1)]
    return [*own_block(me), *chain(*evaders), *chain(*pursuer_blocks(me, omniscient=omniscient))]


def observation_names(pursuers: int, evaders: int) -> tuple[str, ...]:
    """Return the names of the numbers of an observation, given the numbers of pursuers and of evaders."""
    return tuple(f"{block}.{field}" for block, fields in _blocks(pursuers, evaders) for field in fields)


def observation_bounds(
    pursuers: int, evaders: int, *, horizon: float, extent: float, centre: complex, top_speed: float
) -> tuple[list[float], list[float]]:
    """Return the least and the greatest value of each number of an observation; all are finite.

    Args:
        pursuers: N.
        evaders: M.
        horizon: the latest end of the run, s.
        extent: the greatest distance of a coordinate of any player from `centre`, m.
        centre: a point, m.
        top_speed: the greatest speed of a pursuer while it chases, m/s.
    """
    width, area = 2.0 * extent, 4.0 * extent * extent
    own = {
        "x": (centre.real - extent, centre.real + extent),
        "y": (centre.imag - extent, centre.imag + extent),
        "action": (0.0, float(evaders)),
        "speed": (0.0, max(top_speed, 1.0)),
        "time_left": (0.0, horizon),
    }
    numbers = {
        **dict.fromkeys(("dx", "dy"), (-width, width)),
        **dict.fromkeys(("age", "claim", "capture_time"), (0.0, horizon)),
        **dict.fromkeys(("xx", "yy"), (0.0, area)),
        **dict.fromkeys(("lead", "late"), (-1.0, 1.0)),
        "xy": (-area, area),
        "uncertainty": (0.0, width),
        "rivals": (0.0, float(max(pursuers, 1))),
        "action": (0.0, float(evaders)),
    }
    bounds = [
        own[field] if block == "own" else numbers.get(field, (0.0, 1.0))
        for block, fields in _blocks(pursuers, evaders)
        for field in fields
    ]
    return [low for low, _ in bounds], [high for _, high in bounds]


def _blocks(pursuers: int, evaders: int) -> Iterator[tuple[str, Sequence[str]]]:
    """Yield the name of each block of an observation and the names of its fields, in order."""
    yield "own", Own._fields
    for evader in range(1, evaders + 1):
        yield f"evader_{evader}", OfEvader._fields
    for pursuer in range(pursuers):
        yield f"pursuer_{pursuer}", OfPursuer._fields

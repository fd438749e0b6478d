"""What a replay shows in the plane: who can receive from whom, paths, headings, estimates and the flow.

Positions are whole millimetres or, beyond about 1000 km, multiples of a coarser unit.
"""

from cmath import phase
from math import atan2, isfinite, isinf

import numpy as np

from desim.analysis.trace_index import ended, samples, started
from desim.config.arrays import Floats
from desim.kernel.core.units import SECOND
from desim.kernel.models.graphs import Complete
from desim.kernel.models.implicit_complete import is_complete
from desim.kernel.models.links import Links
from desim.kernel.models.reception import Disk
from desim.kernel.models.traits import ReceptionTraits
from desim.kernel.topology.radio_walls import range_factor
from desim.kernel.topology.topology import Topology
from desim.pursuit.core.events import Estimated
from desim.pursuit.core.state import coordinates
from desim.simulation.run import Result
from desim.view.headings import Headings
from desim.view.pages.replay_columns import ReplayData, Ticks, packed_column, raw

TURN = 256
"""Number of units of an angle in a full turn."""
MAX_LENGTH = 2**30
"""The greatest stored position and semi-axis of an estimate; greater ones are off the plane, and are cut to it."""
FLOW_POINTS, FLOW_TIMES = 12, 60
"""Number of intervals along the longer side of the grid on which a flow is shown, and number of times."""
FLOW_MARGIN = 1.0
"""Margin of this grid around all paths, m."""
FAINT = 1000.0
"""Loss, dB, to which a greater loss of a wall is reduced, so that factors of distances stay finite."""


def arcs_data(result: Result) -> str | None:
    """Return the edges (sender, receiver) of the communication graph as a column; None if the graph is complete."""
    size = len(started(result).active)
    graph = result.scenario.network.make_graph(size)
    return None if is_complete(graph) else packed_column(sorted(graph.to_directed().edges), "<u2")


def reception_data(result: Result) -> ReplayData:
    """Return the maximum distances, m, of reception between linked pursuers.

    `radius` is common to all pairs of pursuers. If fading is drawn once per link, `radii` has a distance for each pair
    i < j instead. If fading changes during the run (`chance` is true), `radius` is the distance at which the reception
    probability is 0.5. If the range is unlimited, both are None. Both are also None, and `known` is false, if
    the reception probability increases with distance anywhere.
    """
    links, size = result.scenario.network, len(started(result).active)
    reception: ReplayData = {"known": True, "chance": False, "radius": None, "radii": None}
    if not isfinite(links.range):
        return reception
    if type(links.reception) is Disk:
        return reception | {"radius": links.range}
    if not is_falling(links):
        return reception | {"known": False}
    places = all_places(result)
    farthest = 2.0 * float(np.hypot(*np.ptp(places.reshape(-1, 2), axis=0))) + 1.0
    if links.fading != "per_link":
        return reception | {"chance": True, "radius": _radii(links, 2, result.seed, farthest)[0, 1]}
    return reception | {"radii": raw(_radii(links, size, result.seed, farthest)[np.triu_indices(size, 1)], "<f8")}


def is_falling(links: Links) -> bool:
    """Return whether the reception probability never increases along 1000 distances up to 4 times the range.

    If the range is unlimited, the result is true.
    """
    if not isfinite(links.range):
        return True
    chance = links.reception(np.linspace(0.0, 4.0 * links.range, 1001)[1:], links.range)
    return not (np.diff(chance) > 1e-12).any()


def _radii(links: Links, size: int, seed: int, farthest: float) -> Floats:
    """Return the (size, size) maximum distances, m, of reception between nodes, by bisection up to `farthest`."""
    places = np.zeros((size, 2))
    radii = np.zeros((size, size))
    graph = Complete()(size)
    per_link = links.fading == "per_link"
    topology = Topology(graph, links.range, lambda: places, links.reception, per_link=per_link, seed=seed)
    for node in range(size):
        low, high = np.zeros(size), np.full(size, farthest)
        for _ in range(64):  # more than the 53 bits of a float
            places[:, 0] = middle = (low + high) / 2.0
            places[node] = 0.0
            is_reached = np.isin(np.arange(size), topology.neighbours(node))
            low, high = np.where(is_reached, middle, low), np.where(is_reached, high, middle)
        radii[node] = low
    return radii


def all_places(result: Result) -> Floats:
    """Return the (samples, N + M, 2) positions, m, of all players, pursuers first."""
    return np.array([[*sample.pursuers, *sample.evaders] for sample in samples(result)])


def _per_metre(places: Floats) -> float:
    """Return the units of length per metre: 1000, divided by 10 until positions and their increments fit 32 bits."""
    per_metre = 1000.0
    while np.abs(places).max() * per_metre >= 2**30:
        per_metre /= 10.0
    return per_metre


def path_data(result: Result, ticks: Ticks) -> ReplayData:
    """Return the positions of all players, pursuers first: the initial ones and the increments at each sample."""
    places = all_places(result)
    per_metre = _per_metre(places)
    units = np.rint(places * per_metre).astype(np.int64).reshape(len(places), -1)
    shifts = np.diff(units, axis=0)
    return {
        "t": ticks([sample.t for sample in samples(result)]),
        "per_metre": per_metre,
        "start": packed_column(units[0], "<i4"),
        "shifts": packed_column(shifts, "<i4"),
    }


def headings_data(result: Result) -> ReplayData | None:
    """Return the players with inertia, and their headings at each sample as a column; None without such players.

    The unit is a `TURN`th of a full turn, counterclockwise from the x axis.
    """
    headings = Headings(result.scenario, result.seed)
    if not headings.players:
        return None
    angles = np.array([[*map(phase, headings.at(sample))] for sample in samples(result)])
    turns = np.rint(angles * (TURN / (2.0 * np.pi))).astype(int) % TURN
    return {"players": list(headings.players), "turn": TURN, "values": packed_column(turns, "u1")}


def estimates_data(result: Result, ticks: Ticks) -> ReplayData | None:
    """Return the recorded estimates of the evaders as columns: the ellipses of one standard deviation; None if none.

    Positions and semi-axes have the unit of the path; the angle of the major axis is that of `headings_data`.
    """
    estimates = result.trace.of(Estimated)
    if not estimates:
        return None
    per_metre = _per_metre(all_places(result))
    x, y, xx, xy, yy = np.array([(event.x, event.y, event.xx, event.xy, event.yy) for event in estimates]).T
    mean, half = (xx + yy) / 2.0, (xx - yy) / 2.0
    offset = np.hypot(half, xy)  # the distance of both eigenvalues of a covariance from their mean
    variances = np.column_stack([mean + offset, mean - offset])
    semi_axes = np.minimum(np.sqrt(np.maximum(variances, 0.0)) * per_metre, MAX_LENGTH)
    angles = np.array([*map(atan2, xy.tolist(), half.tolist())]) / 2.0
    centres = np.clip(np.column_stack([x, y]) * per_metre, -MAX_LENGTH, MAX_LENGTH)
    return {
        "t": ticks([estimate.t for estimate in estimates]),
        "pursuer": packed_column([estimate.pursuer for estimate in estimates], "<u2"),
        "evader": packed_column([estimate.evader for estimate in estimates], "<u2"),
        "centres": packed_column(np.rint(centres), "<i4"),
        "semi_axes": packed_column(np.rint(semi_axes), "<i4"),
        "turn": TURN,
        "angles": packed_column(np.rint(angles * (TURN / (2.0 * np.pi))).astype(int) % TURN, "u1"),
    }


def flow_data(result: Result, ticks: Ticks) -> ReplayData | None:
    """Return the velocities of the flow on a square grid over the paths, at some times, as columns; None without flow.

    `velocities` has the x, y (m/s) of each point of the grid, row by row, at each time; `top` is the greatest speed.
    """
    environment = result.scenario.environment
    if environment.is_still:
        return None
    places = all_places(result).reshape(-1, 2)
    (left, low), (right, high) = places.min(axis=0) - FLOW_MARGIN, places.max(axis=0) + FLOW_MARGIN
    edge = max(right - left, high - low) / FLOW_POINTS
    x, y = np.arange(left, right + edge, edge), np.arange(low, high + edge, edge)
    grid = (x[None, :] + 1j * y[:, None]).ravel()
    times = np.linspace(0, ended(result).t, FLOW_TIMES).astype(np.int64)
    velocities = np.array([coordinates(environment.velocities(grid, t / SECOND)) for t in times.tolist()])
    if (velocities == velocities[0]).all():
        times, velocities = times[:1], velocities[:1]
    return {
        "on": environment.on,
        "t": ticks(times),
        "start": [float(left), float(low)],
        "edge": float(edge),
        "columns": len(x),
        "top": float(np.hypot(*velocities.reshape(-1, 2).T).max()),
        "velocities": raw(velocities, "<f4"),
    }


def walls_data(result: Result) -> list[ReplayData] | None:
    """Return the walls: what each blocks, its offset and shapes (m), and the factor by which it stretches distances.

    The factor is that of radio, or None where radio does not pass. Without walls, the result is None.
    """
    exponent = ReceptionTraits.of(result.scenario.network.reception).exponent
    return [
        {
            "blocks": list(wall.blocks),
            "offset": list(wall.offset),
            "shapes": [{"closed": shape.closed, "corners": shape.corners.tolist()} for shape in wall.shapes],
            "factor": None if isinf(wall.decibels) else 1.0 / range_factor(min(wall.decibels, FAINT), exponent),
        }
        for wall in result.scenario.wall
    ] or None

"""The pictures of the gallery: each shows what its scenario is about, and is legible at the width of a card.

They have no legend: the title says what is drawn, in the colours and marks of all pictures.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from desim.analysis.activity import changes
from desim.analysis.deliveries import chasing, deliveries, outages
from desim.analysis.drawing.palette import ACTIVE, ACTIVE_WITH_OTHERS, COLLISION_MARK, GREY, LOST, LOST_MARK, SERIES
from desim.analysis.drawing.plots import Axes, Figure, styled
from desim.analysis.drawing.trajectory import draw_trajectory
from desim.analysis.trace_index import ended, sampled, started
from desim.config.arrays import Floats
from desim.kernel.core.events import Broadcast, Sent
from desim.kernel.core.units import SECOND
from desim.kernel.models.faults import Jamming
from desim.kernel.topology.radio_walls import RadioWalls
from desim.kernel.walls.crossings import crossings
from desim.kernel.walls.wall import blocking
from desim.pursuit.core.events import Estimated
from desim.pursuit.core.state import coordinates
from desim.pursuit.team.announcements import action_in_game
from desim.simulation.run import Result
from desim.view.pictures.link_traces import link_traces
from desim.view.pictures.spacetime import spacetime

SIZE = 3.4, 2.55
"""Width and height, inches; four to three."""
Draw = Callable[[Axes, Result], None]


def thumbnail(name: str, result: Result) -> Figure:
    """Return the picture of a scenario file, given one run of it with positions and messages."""
    if name in SPACETIME:
        return _spacetime(result, *SPACETIME[name])
    draw, title = PICTURES.get(name, (_plane, "paths"))
    with styled(SIZE, font=9.0) as figure:
        axes = figure.add_subplot()
        draw(axes, result)
        axes.set_title(title, fontsize=9)
    return figure


def _plane(axes: Axes, result: Result, decorate: Draw | None = None) -> None:
    """Draw the paths of the players, and perhaps something else below them."""
    draw_trajectory(axes, result)
    if decorate is not None:
        decorate(axes, result)
    axes.set(xlabel="", ylabel="", aspect="equal")
    axes.set_adjustable("datalim")
    axes.tick_params(labelsize=7)


def _links(axes: Axes, result: Result) -> None:
    """Draw the links over which messages arrived; dotted, those over which all were lost."""
    start = np.array(sampled(result)[0].pursuers)
    received: dict[tuple[int, int], bool] = {}
    for each in deliveries(result):
        if each.left < SECOND and max(each.src, each.dst) < len(start):
            pair = min(each.src, each.dst), max(each.src, each.dst)
            received[pair] = received.get(pair, False) or each.cause is None
    for pair, is_used in received.items():
        style: dict[str, Any] = {"color": GREY, "lw": 1.0} if is_used else {"color": LOST, "lw": 0.8, "ls": ":"}
        axes.plot(*start[list(pair)].T, zorder=1, **style)


def _flow(axes: Axes, result: Result) -> None:
    """Draw the velocities of the flow at the start."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    x, y = np.meshgrid(np.linspace(left, right, 10), np.linspace(low, high, 8))
    velocities = coordinates(result.scenario.environment.velocities((x + 1j * y).ravel(), 0.0))
    axes.quiver(x, y, *velocities.T, color=ACTIVE_WITH_OTHERS, alpha=0.7, zorder=0, width=0.006)


def _sight(axes: Axes, result: Result) -> None:
    """Shade how far the pursuers see, at the end of the run."""
    for place in sampled(result)[-1].pursuers:
        axes.add_patch(Circle(place, result.scenario.sensing.radius, color=ACTIVE_WITH_OTHERS, alpha=0.25, lw=0))


def _jamming(axes: Axes, result: Result) -> None:
    """Shade where the receivers are jammed."""
    for fault in result.scenario.fault:
        if isinstance(fault, Jamming):
            axes.add_patch(Circle(fault.centre, fault.radius, fc="none", ec=LOST, hatch="///", alpha=0.5))


def _cells(axes: Axes, result: Result) -> None:
    """Draw the Voronoi cells of the pursuers at the start."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    x, y = np.meshgrid(np.linspace(left, right, 200), np.linspace(low, high, 200))
    places = np.array(sampled(result)[0].pursuers)
    nearest = np.hypot(x[..., None] - places[:, 0], y[..., None] - places[:, 1]).argmin(axis=-1)
    axes.contour(x, y, nearest, levels=np.arange(len(places)) + 0.5, colors=GREY, linewidths=0.7, zorder=0)


def _unseen(axes: Axes, result: Result) -> None:
    """Shade the places that pursuer 0 did not see at the start, because walls are in the way."""
    segments = blocking(result.scenario.wall, "sight")

    def is_unseen(places: Floats, pursuer: Floats) -> Floats:
        return np.where(crossings(places, pursuer, segments).any(axis=1), 1.0, np.nan)

    _shade(axes, result, is_unseen, ListedColormap([GREY]), alpha=0.35)


def _wall_losses(axes: Axes, result: Result) -> None:
    """Shade how much walls weaken radio between a place and pursuer 0 at the start, up to 30 dB."""
    walls = RadioWalls(result.scenario.wall, 1, 2.0)
    _shade(axes, result, lambda places, pursuer: walls.decibels(pursuer, places), "Reds", vmin=0.0, vmax=30.0)


def _shade(axes: Axes, result: Result, of: Callable[[Floats, Floats], Floats], colours: Any, **options: Any) -> None:
    """Shade the plane by a function of places, (n, 2) m, and of the position of pursuer 0 at the start."""
    pursuers = np.array(sampled(result)[0].pursuers)
    corners = np.vstack([pursuers, *(shape.corners for wall in result.scenario.wall for shape in wall.shapes)])
    (left, low), (right, high) = corners.min(axis=0), corners.max(axis=0)
    x, y = np.meshgrid(np.linspace(left, right, 160), np.linspace(low, high, 120))
    values = of(np.column_stack([x.ravel(), y.ravel()]), pursuers[:1]).reshape(x.shape)
    axes.pcolormesh(x, y, values, cmap=colours, zorder=0, rasterized=True, **options)
    axes.plot(*pursuers[0], "o", color=ACTIVE, ms=6)


def _estimates(axes: Axes, result: Result) -> None:
    """Draw where the pursuers believed the evader to be."""
    places = np.array([(each.x, each.y) for each in result.trace.of(Estimated)])
    axes.plot(*places.T, ".", color=SERIES[4], ms=2, alpha=0.4, zorder=1)


def _spacetime(result: Result, end: float, pursuers: Sequence[int] | None = None) -> Figure:
    """Return the space-time diagram of the first seconds, without its legend."""
    figure = spacetime(result, 0.0, end, pursuers, "{}inx{}in".format(*SIZE))
    for legend in figure.legends:
        legend.remove()
    figure.axes[0].set_title("messages in time", fontsize=9)
    return figure


def _chases(axes: Axes, result: Result) -> None:
    """Draw when each pursuer chases, and what is broken meanwhile."""
    chases = chasing(result)
    for pursuer, intervals in enumerate(chases):
        for chase in intervals:
            axes.plot([chase.begin / SECOND, chase.end / SECOND], [pursuer, pursuer], color=ACTIVE, lw=3.0,
                      solid_capstyle="butt")  # fmt: skip
    for fault, (begin, until) in outages(result):
        rows = [fault.node] if hasattr(fault, "node") else range(len(chases))
        for row in rows:
            axes.plot([begin / SECOND, until / SECOND], [row, row], color=LOST, lw=1.0, alpha=0.7)
    changed = [(each.t / SECOND, each.pursuer) for each in changes(result)]
    if changed:
        axes.plot(*np.array(changed).T, "|", color="black", ms=5)
    _per_pursuer(axes, len(chases), ended(result).t / SECOND)


def _per_pursuer(axes: Axes, count: int, end: float, begin: float = 0.0) -> None:
    axes.set(xlabel="time (s)", ylabel="pursuer", xlim=(begin, end), ylim=(count - 0.4, -0.6))
    axes.set_yticks([0, count - 1])


def _air(axes: Axes, result: Result, end: float) -> None:
    """Draw who transmits when, and which of the frames are lost."""
    medium = result.scenario.network.medium
    count = len(started(result).active)
    lost: dict[int, list[Any]] = {}
    for each in deliveries(result):
        if each.cause is not None:
            lost.setdefault(each.transmission, []).append(each.cause)
    for event in [event for event in result.trace if isinstance(event, Broadcast | Sent) and event.t < end * SECOND]:
        begin, airtime, causes = event.t / SECOND, medium(event.size), lost.get(event.transmission, [])
        colour = LOST if "collision" in causes else ACTIVE
        axes.plot([begin, begin + airtime], [event.src] * 2, color=colour, lw=5.0, solid_capstyle="butt")
        if "collision" in causes:
            axes.plot(begin + airtime, event.src, marker=COLLISION_MARK, color=LOST, ms=6)
    _per_pursuer(axes, count, min(end, ended(result).t / SECOND))


def _fates(axes: Axes, result: Result) -> None:
    """Draw the messages to one pursuer by sender: a point each, and a cross if it is lost."""
    found = [each for each in deliveries(result) if each.dst == 0]
    for mark, colour, is_lost in (("|", ACTIVE, False), (LOST_MARK, LOST, True)):
        chosen = [(each.left / SECOND, each.src) for each in found if (each.cause is not None) == is_lost]
        if chosen:
            axes.plot(*np.array(chosen).T, mark, color=colour, ms=4, ls="")
    axes.set(xlabel="time (s)", ylabel="from pursuer")
    axes.yaxis.set_major_locator(MaxNLocator(nbins=4, integer=True))


def _latencies(axes: Axes, result: Result) -> None:
    """Draw how long messages took, by the time of their transmission; crosses are lost."""
    found = [each for each in deliveries(result) if each.until <= ended(result).t]
    arrived = np.array([(each.left, each.until - each.left) for each in found if each.cause is None]) / SECOND
    lost = [each.left / SECOND for each in found if each.cause is not None]
    axes.plot(arrived[:, 0], arrived[:, 1], ".", color=ACTIVE, ms=2, alpha=0.5)
    axes.plot(lost, np.zeros(len(lost)), LOST_MARK, color=LOST, ms=4, alpha=0.5, clip_on=False)
    axes.set(xlabel="time (s)", ylabel="latency (s)", ylim=(0.0, float(np.quantile(arrived[:, 1], 0.995)) * 1.1))


def _beliefs(axes: Axes, result: Result, t: float) -> None:
    """Draw whom each pursuer believes to chase at a time, s: row by row, in red where this is wrong."""
    count, evaders, now = len(started(result).active), len(started(result).evaders), t * SECOND
    truth = np.array([any(chase.begin <= now < chase.end for chase in own) for own in chasing(result)])
    believed = np.zeros((count, count), dtype=bool)
    for each in sorted((each for each in deliveries(result) if each.cause is None), key=lambda each: each.until):
        if each.until <= now and (action := action_in_game(each.body, evaders)) is not None:
            believed[each.dst, each.src] = bool(action)
    np.fill_diagonal(believed, truth)
    cells = np.where(believed == truth, believed * 1, 2 + believed)
    axes.imshow(cells, cmap=ListedColormap(["#e8e8e8", ACTIVE, "#f2b8b5", LOST]), vmin=0, vmax=3)
    axes.set(xlabel="about pursuer", ylabel="belief of pursuer")
    axes.set_xticks([0, count - 1])
    axes.set_yticks([0, count - 1])


def _measured(axes: Axes, result: Result) -> None:
    """Draw the measurements that the links follow."""
    drawn = link_traces(result.scenario).axes[0]
    for line in drawn.lines[:6]:
        axes.plot(line.get_xdata(), line.get_ydata(), color=line.get_color(), lw=1.2, marker=line.get_marker(), ms=4,
                  ls=line.get_linestyle(), drawstyle=line.get_drawstyle())  # fmt: skip
    axes.set(xlabel="time (s)", ylabel=drawn.get_ylabel())


PICTURES: Mapping[str, tuple[Draw, str]] = MappingProxyType(
    {
        "auction": (partial(_beliefs, t=0.3), "beliefs, red where wrong"),
        "bursts": (_fates, "messages to pursuer 0"),
        "contention": (partial(_air, end=0.25), "who transmits when"),
        "cooling": (_chases, "who chases when"),
        "cornered": (_plane, "paths around walls"),
        "evasive": (_plane, "paths"),
        "fading": (_fates, "messages to pursuer 0"),
        "faults": (partial(_plane, decorate=_jamming), "paths and jammed disc"),
        "flooding": (partial(_plane, decorate=_links), "links"),
        "forest": (partial(_plane, decorate=_links), "links among walls"),
        "hiding": (partial(_plane, decorate=_unseen), "what pursuer 0 does not see"),
        "imperfect": (_latencies, "latency of each message"),
        "learning": (_chases, "who chases when"),
        "liars": (partial(_beliefs, t=1.0), "beliefs, red where wrong"),
        "lora": (partial(_air, end=60.0), "who transmits when"),
        "measured": (_measured, "measured links"),
        "named": (partial(_plane, decorate=_links), "links"),
        "netem": (_latencies, "latency of each message"),
        "noisy": (partial(_plane, decorate=_estimates), "paths and estimates"),
        "office": (partial(_plane, decorate=_wall_losses), "radio loss by walls to pursuer 0"),
        "radio": (partial(_air, end=1.0), "who transmits when"),
        "rooms": (partial(_plane, decorate=_links), "links among walls"),
        "search": (partial(_plane, decorate=_sight), "what pursuers see"),
        "shadowing": (partial(_plane, decorate=_links), "links in the first second"),
        "soak": (_chases, "who chases when, and what is broken"),
        "voronoi": (partial(_plane, decorate=_cells), "Voronoi cells at the start"),
        "wind": (partial(_plane, decorate=_flow), "paths in the wind"),
        "wired": (partial(_plane, decorate=_links), "links"),
    }
)
"""The drawing function and the title of each scenario file; of any other, the paths are drawn."""
SPACETIME: Mapping[str, tuple[float, Sequence[int] | None]] = MappingProxyType(
    {
        "reliable": (0.4, (0, 1, 2, 3)),
        "server": (0.4, (0, 1, 2, 3, 4)),
        "token_ring": (0.5, (0, 1, 2, 3, 4, 5)),
    }
)
"""The scenario files whose messages are drawn in time: the end of the window, s, and the pursuers."""

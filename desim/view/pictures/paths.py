"""A compact plan view of a pursuit: the paths of evaders and active pursuers, handovers and captures.

If there are several evaders, each has a number, a marker and a hue; its pursuers are drawn in the same hue.
"""

from collections.abc import Sequence
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

from desim.analysis.activity import EvaderPursuit, evader_pursuits
from desim.analysis.deliveries import Handover, handover_events
from desim.analysis.drawing.palette import (
    ACTIVE,
    ACTIVE_WITH_OTHERS,
    CAPTURE_MARK,
    EVADER,
    EVADER_MARKS,
    GREY,
    HANDOVER_MARK,
    HUES,
    INACTIVE,
    PURSUER_MARK,
)
from desim.analysis.drawing.plots import Axes
from desim.analysis.drawing.trajectory import EVADER_PATH, set_plane
from desim.analysis.drawing.walls import draw_walls
from desim.analysis.trace_index import captures, sampled
from desim.config.arrays import Floats, Integers
from desim.kernel.core.portable_math import portable_sum
from desim.simulation.run import Result

LabelPosition = tuple[float, float]
"""(x, y) in data coordinates."""
LABEL_SIZE = 6.0
"""Font size of labels, points."""
DIGIT_WIDTH, DIGIT_HEIGHT = 0.66, 0.85
"""Size of a digit with a small margin, in units of the font size."""
HALF_MARKER = 2.5
"""Half the width of a marker, points (1/72 in)."""
HALO = (withStroke(linewidth=1.5, foreground="white"),)
"""A white outline that keeps a label legible over a path."""


class EvaderStyle(NamedTuple):
    """The marker and colours of an evader and of its pursuers."""

    mark: str
    inner: str
    """The fill colour of the evader's marker."""
    alone: str
    """The colour of a pursuer that chases the evader alone."""
    together: str
    """The colour of a pursuer that chases the evader together with others."""

    @classmethod
    def of(cls, evader: int, count: int) -> "EvaderStyle":
        """Return the style of an evader, given its number (1 .. M) and the number of evaders M."""
        if count == 1:
            return cls(EVADER_MARKS[0], EVADER, ACTIVE, ACTIVE_WITH_OTHERS)
        hue = HUES[(evader - 1) % len(HUES)]
        return cls(EVADER_MARKS[(evader - 1) % len(EVADER_MARKS)], hue, hue, hue)


class ActivePeriod(NamedTuple):
    """An interval in which a pursuer chased an evader, either always alone or always with others."""

    pursuer: int
    begin: int
    """ns"""
    end: int
    """ns"""
    alone: bool
    """Whether no other pursuer chased the evader."""
    evader: int
    """1 .. M"""


def active_periods(result: Result) -> list[ActivePeriod]:
    """Return the active periods of all pursuers, ordered by evader and then by end."""
    return [
        period
        for evader, pursuit in enumerate(evader_pursuits(result), start=1)
        for period in _active_periods(evader, pursuit)
    ]


def _active_periods(evader: int, pursuit: EvaderPursuit) -> list[ActivePeriod]:
    """Return the active periods of the pursuers of one evader, ordered by end."""
    begins = {pursuer: 0 for pursuer, chasing in enumerate(pursuit.start) if chasing}  # of present periods, ns
    times = [0, *(t for t, _, _ in pursuit.steps), pursuit.end]
    periods, alone = [], len(begins) == 1
    for step, (t, next_t) in zip([None, *pursuit.steps], pairwise(times), strict=True):
        if step is not None:
            _, pursuer, increment = step
            if increment < 0:
                periods.append(ActivePeriod(pursuer, begins.pop(pursuer), t, alone, evader))
            else:
                begins[pursuer] = t
        if (len(begins) == 1) != alone and t < next_t:  # after the last of several steps at one instant
            periods += [ActivePeriod(pursuer, begin, t, alone, evader) for pursuer, begin in begins.items()]
            begins, alone = dict.fromkeys(begins, t), not alone
    periods += [ActivePeriod(pursuer, begin, pursuit.end, alone, evader) for pursuer, begin in begins.items()]
    return [period for period in periods if period.begin < period.end]


class Paths:
    """The positions of all players at any time, by linear interpolation between the samples.

    Raises:
        ValueError: if no positions were recorded.
    """

    def __init__(self, result: Result):
        samples = sampled(result)
        self.t = np.array([sample.t for sample in samples])
        self.evaders = np.array([sample.evaders for sample in samples])
        """(samples, M, 2) m"""
        self.pursuers = np.array([sample.pursuers for sample in samples])
        """(samples, N, 2) m"""

    @property
    def count(self) -> int:
        """The number of evaders M."""
        return len(self.evaders[0])

    def of(self, pursuer: int, begin: int, end: int) -> Floats:
        """Return the (k, 2) path (m) of a pursuer between two times (ns)."""
        return self._between(self.pursuers[:, pursuer], begin, end)

    def of_evader(self, evader: int, begin: int, end: int) -> Floats:
        """Return the (k, 2) path (m) of an evader (1 .. M) between two times (ns)."""
        return self._between(self.evaders[:, evader - 1], begin, end)

    def at(self, pursuer: int, times: Integers) -> Floats:
        """Return the (k, 2) positions (m) of a pursuer at (k,) times (ns)."""
        return self._interpolated(self.pursuers[:, pursuer], times)

    def position_of(self, handover: Handover) -> tuple[float, float]:
        """Return the position (x, y), m, of the pursuer that takes over."""
        x, y = self.at(handover.pursuer, np.array([handover.t]))[0].tolist()
        return x, y

    def _between(self, positions: Floats, begin: int, end: int) -> Floats:
        inside = self.t[(begin < self.t) & (self.t < end)]
        return self._interpolated(positions, np.concatenate([[begin], inside, [end]]))

    def _interpolated(self, positions: Floats, times: Integers) -> Floats:
        return np.stack([np.interp(times, self.t, positions[:, axis]) for axis in (0, 1)], axis=1)


def draw_pursuit(axes: Axes, result: Result) -> None:
    """Draw the paths of evaders and active pursuers, with a square at each handover and a star at each capture.

    The path of a pursuer is bold while it chases alone and thin while it chases with others. Of a pursuer that was
    never active, only the circle at its initial position is drawn. At a handover, a pursuer begins to chase an evader
    alone. The first square of an evader therefore marks the first pursuer that chases it alone. `label_handovers` adds
    the numbers of the pursuers.

    Raises:
        ValueError: if no positions were recorded.
    """
    paths = Paths(result)
    looks = {evader: EvaderStyle.of(evader, paths.count) for evader in range(1, paths.count + 1)}
    set_plane(axes)
    draw_walls(axes, result.scenario.wall)
    axes.plot(
        *paths.pursuers[0].T, PURSUER_MARK, mfc="white", mec=INACTIVE, mew=0.7, ms=3, label="pursuer at the start"
    )
    _draw_active_periods(axes, result, paths, looks)
    _draw_handovers(axes, result, paths, looks)
    for evader, look in looks.items():
        label = "evader" if paths.count == 1 else f"evader {evader}"
        mark: dict[str, Any] = {"ms": 3} if paths.count == 1 else {"ms": 6, "mfc": look.inner, "mew": 1.2}
        axes.plot(*paths.evaders[:, evader - 1].T, lw=1.2, label=label, **{**EVADER_PATH, "marker": look.mark, **mark})
    places = [paths.evaders[-1, capture.evader - 1] for capture in captures(result)]
    if places:
        axes.plot(*np.transpose(places), CAPTURE_MARK, color="black", ms=7, mew=0, zorder=7, label="capture")


def _draw_active_periods(axes: Axes, result: Result, paths: Paths, looks: dict[int, EvaderStyle]) -> None:
    labels: dict[bool, str | None] = {False: "active with others", True: "active alone"}
    widths: dict[bool, dict[str, Any]] = {False: {"lw": 0.8}, True: {"lw": 2.6, "zorder": 3}}
    if paths.count > 1:  # the hue is that of an evader, so the legend shows the widths in grey
        for alone, label in labels.items():
            axes.plot([], [], color=GREY, label=label, **widths[alone])
        labels = {}
    for period in active_periods(result):
        path, look = paths.of(period.pursuer, period.begin, period.end), looks[period.evader]
        colour = look.alone if period.alone else look.together
        label = labels.pop(period.alone, None)  # only the first line of a kind has a label
        axes.plot(*path.T, color=colour, **widths[period.alone], label=label, solid_capstyle="butt")


def _draw_handovers(axes: Axes, result: Result, paths: Paths, looks: dict[int, EvaderStyle]) -> None:
    label = "takes over"  # for the legend; only the first squares have a label
    for evader, look in looks.items():
        places = [paths.position_of(event) for event in handover_events(result) if event.evader == evader]
        if places:
            style: dict[str, Any] = {"mfc": "white", "mec": look.alone, "mew": 0.9, "ms": 4, "zorder": 5}
            axes.plot(*np.transpose(places), HANDOVER_MARK, ls="", label=label, **style)
            label = ""


def label_handovers(axes: Axes, result: Result) -> None:
    """Label each square of `draw_pursuit` with the number of the pursuer that takes over.

    If there are several evaders, the initial position of each is labelled with its number. See `label_points` for the
    requirements on the axes.
    """
    paths, handovers = Paths(result), handover_events(result)
    players = (*paths.evaders.transpose(1, 0, 2), *paths.pursuers.transpose(1, 0, 2))
    ends = [tuple(path[k].tolist()) for path in players for k in (0, -1)]
    # (position, name, evader, weight) of each label
    labels = [(paths.position_of(handover), str(handover.pursuer), handover.evader, "normal") for handover in handovers]
    if paths.count > 1:
        starts = [(x, y) for x, y in paths.evaders[0].tolist()]
        labels += [(start, str(k), k, "bold") for k, start in enumerate(starts, start=1)]
    texts = label_points(axes, [label[0] for label in labels], [label[1] for label in labels], avoid=ends, zorder=6)
    for text, (_, _, evader, weight) in zip(texts, labels, strict=True):
        text.set(color=EvaderStyle.of(evader, paths.count).alone, weight=weight)
        if paths.count > 1:
            text.set_path_effects(list(HALO))


def label_points(
    axes: Axes,
    places: Sequence[LabelPosition],
    names: Sequence[str],
    *,
    avoid: Sequence[LabelPosition] = (),
    **look: Any,
) -> list[Text]:
    """Write a short label beside each point and return the texts.

    There are eight positions around each point. The label takes the position with the least overlap with points,
    earlier labels and the outside of the axes.

    Args:
        axes: the axes to write on. They must have their final limits, and their figure its final layout
            (`draw_without_rendering`).
        places: the points (x, y), in data coordinates.
        names: the labels of the points.
        avoid: further points that labels should not cover.
        look: further properties of the texts.
    """
    assert isinstance(axes.figure, Figure)
    points_per_pixel = 72.0 / axes.figure.dpi
    anchors = axes.transData.transform(np.array([*places, *avoid], dtype=float)) * points_per_pixel
    # A box is (left, bottom, right, top) in points.
    occupied = [np.concatenate([anchor - HALF_MARKER, anchor + HALF_MARKER]) for anchor in anchors]
    frame = np.array(axes.bbox.extents) * points_per_pixel
    texts: list[Text] = []
    for name, place, anchor in zip(names, places, anchors, strict=False):
        boxes = _boxes_beside(anchor, DIGIT_WIDTH * LABEL_SIZE * len(name), DIGIT_HEIGHT * LABEL_SIZE)
        costs = [
            portable_sum(_overlap(box, other) for other in occupied) + _area(box) - _overlap(box, frame)
            for box in boxes
        ]
        best = boxes[int(np.argmin(costs))]
        occupied.append(best)
        x, y = (best[:2] - anchor).tolist()
        text = axes.annotate(name, place, (x, y), textcoords="offset points", fontsize=LABEL_SIZE, **look)
        text.set_in_layout(False)
        texts.append(text)
    return texts


def _boxes_beside(anchor: Floats, width: float, height: float) -> list[Floats]:
    """Return the eight candidate boxes around a point, starting at the upper right."""
    x, y = anchor
    lefts = (x + HALF_MARKER + 0.5, x - width / 2.0, x - width - HALF_MARKER - 0.5)
    bottoms = (y + HALF_MARKER - 0.5, y - height / 2.0, y - height - HALF_MARKER + 0.5)
    corners = list(product(lefts, bottoms))
    del corners[4]  # the box on the point itself
    return [np.array([left, bottom, left + width, bottom + height]) for left, bottom in corners]


def _overlap(first: Floats, other: Floats) -> float:
    """Return the area of the intersection of two boxes."""
    sides = np.minimum(first[2:], other[2:]) - np.maximum(first[:2], other[:2])
    return float(np.prod(np.maximum(sides, 0.0)))


def _area(box: Floats) -> float:
    return float(np.prod(box[2:] - box[:2]))

"""A pursuit from above, in little room: who chased alone, who chased beside others, and where it was handed over."""

from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from desim.analysis.activity import changes, relays
from desim.analysis.plots import BLUE, EVADER, GREY, SKY, Axes, place
from desim.analysis.reading import ended, started
from desim.pursuit.events import Sampled
from desim.simulation import Result
from desim.view.labels import label_points

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


class Stint(NamedTuple):
    """A time for which a pursuer chased, alone or beside others."""

    pursuer: int
    begin: int
    """ns"""
    end: int
    """ns"""
    alone: bool


def stints(result: Result) -> list[Stint]:
    """Return who chased when, and whether alone, in order of their ends."""
    active = {pursuer: 0 for pursuer, chasing in enumerate(started(result).active) if chasing}
    times = [0, *(change.t for change in changes(result)), ended(result).t]
    found, alone = [], len(active) == 1
    for change, (begin, end) in zip([None, *changes(result)], pairwise(times), strict=True):
        if change is not None:
            if change.pursuer in active:
                found.append(Stint(change.pursuer, active.pop(change.pursuer), begin, alone))
            else:
                active[change.pursuer] = begin
        if (len(active) == 1) != alone and begin < end:
            found += [Stint(pursuer, since, begin, alone) for pursuer, since in active.items() if since < begin]
            active, alone = dict.fromkeys(active, begin), not alone
    found += [Stint(pursuer, since, ended(result).t, alone) for pursuer, since in active.items()]
    return [each for each in found if each.begin < each.end]


class Paths:
    """Where everyone was at any time: on straight lines between the samples.

    Raises:
        ValueError: if no positions were recorded.
    """

    def __init__(self, result: Result):
        samples = result.trace.of(Sampled)
        if not samples:
            raise ValueError("no positions were recorded: set record.trajectory to a time greater than 0 s")
        self.t = np.array([sample.t for sample in samples])
        self.evader = np.array([sample.evader for sample in samples])
        """(samples, 2) m"""
        self.pursuers = np.array([sample.pursuers for sample in samples])
        """(samples, N, 2) m"""

    def of(self, pursuer: int | None, begin: int, end: int) -> "Floats":
        """Return the (k, 2) path of a pursuer, or of the evader (None), between two times, ns."""
        inside = self.t[(begin < self.t) & (self.t < end)]
        return self.at(pursuer, np.concatenate([[begin], inside, [end]]))

    def at(self, pursuer: int | None, times: "NDArray[np.int64]") -> "Floats":
        """Return the (k, 2) places of a pursuer, or of the evader (None), at (k,) times, ns."""
        known = self.evader if pursuer is None else self.pursuers[:, pursuer]
        return np.stack([np.interp(times, self.t, known[:, axis]) for axis in (0, 1)], axis=1)


def draw_pursuit(axes: Axes, result: Result) -> None:
    """Draw a pursuit: bold who chases alone, thin who chases beside others, a diamond where somebody comes to be alone.

    Each diamond but the first is a hand-over; beside it stands the number of the pursuer. Pursuers that never moved
    are where their circles are.

    Raises:
        ValueError: if the run recorded no positions.
    """
    paths, end = Paths(result), ended(result)
    place(axes)
    axes.plot(*paths.pursuers[0].T, "o", mfc="white", mec=GREY, mew=0.7, ms=3, label="pursuer at the start")
    looks: dict[bool, dict[str, Any]] = {
        False: {"color": SKY, "lw": 0.8},
        True: {"color": BLUE, "lw": 2.6, "zorder": 3},
    }
    labels = {False: "active with others", True: "active alone"}
    for stint in stints(result):
        path = paths.of(stint.pursuer, stint.begin, stint.end)
        axes.plot(*path.T, **looks[stint.alone], label=labels.pop(stint.alone, None), solid_capstyle="butt")
    places = [paths.at(pursuer, np.array([t]))[0] for t, pursuer in relays(result)]
    if places:
        axes.plot(*np.transpose(places), "D", ls="", mfc="white", mec=BLUE, mew=0.9, ms=4, zorder=5, label="takes over")
    axes.plot(*paths.evader.T, lw=1.2, ms=3, label="evader", **EVADER)
    if end.reason == "captured":
        axes.plot(*paths.evader[-1], "*", color="black", ms=7, mew=0, zorder=7, label="capture")


def label_takeovers(axes: Axes, result: Result) -> None:
    """Write beside each diamond of `draw_pursuit` who takes over; see `label_points` for the axes."""
    paths, chain = Paths(result), relays(result)
    places = [tuple(paths.at(pursuer, np.array([t]))[0].tolist()) for t, pursuer in chain]
    ends = [tuple(path[k].tolist()) for path in (paths.evader, *paths.pursuers.transpose(1, 0, 2)) for k in (0, -1)]
    label_points(axes, places, [str(pursuer) for _, pursuer in chain], avoid=ends, color=BLUE, zorder=6)

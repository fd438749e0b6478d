"""Clocks with a random error: the phase and the frequency of an oscillator walk randomly.

The model has two states, the error x of the clock (s) and the error y of its rate, with dx = y dt + a dW1 and
dy = b dW2 (Zucca & Tavella 2005, "The Clock Model and Its Relationship with the Allan and Related Variances"). White
noise of the frequency makes the phase walk, with a variance a^2 t. A walk of the frequency adds b^2 t^3 / 3.

The states have their exact distribution at multiples of `TICK`; in between, the error is interpolated linearly.
"""

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from math import sqrt
from typing import ClassVar

import numpy as np

from desim.kernel.core.clock import Clock, NodeClock
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.kernel.models.clock_skew import MIN_DRIFT, clock_errors, clock_skews

TICK = nanoseconds(0.01)
"""Time between two states of a walk, ns."""
BLOCK = 256
"""Number of states that are drawn at once."""


class ClockWalk:
    """The random part of the error of a clock at multiples of `TICK`, drawn as it is needed.

    Kept equal to states drawn one by one by
    `tests/kernel/test_wandering_clock.py::test_a_walk_drawn_ahead_is_that_drawn_state_by_state`.

    Args:
        offset_walk: a, s per sqrt(s).
        drift_walk: b, 1 per sqrt(s).
        rate: the mean rate of the clock; the walk never lets it run slower than at 1 + `MIN_DRIFT`.
        until: time, ns, up to which the clock may be read; after it the error stays constant.
        rng: the random stream.
    """

    def __init__(self, offset_walk: float, drift_walk: float, rate: float, until: int, rng: np.random.Generator):
        self._rate, self._rng, self._last = rate, rng, -(-until // TICK)
        tick = seconds(TICK)
        self._drift_step = drift_walk * sqrt(tick)
        # Given the drift at both ends of a tick, its integral is their mean times t plus that of a Brownian bridge, of
        # variance b^2 t^3 / 12. So two independent draws for each tick are exact.
        self._offset_step = sqrt(offset_walk**2 * tick + drift_walk**2 * tick**3 / 12.0)
        self._drift = 0.0
        self._errors = [0.0]
        self._shown = [0.0]
        """By tick, the time, s, that a clock with this error and without an offset shows."""

    def error(self, true: int) -> float:
        """Return the error, s, at a true time, ns; 0 before the time 0."""
        k, remainder = divmod(max(true, 0), TICK)
        if k >= self._last:
            return self._draw_to(self._last)
        self._draw_to(k + 1)
        return self._errors[k] + remainder / TICK * (self._errors[k + 1] - self._errors[k])

    def when(self, time: float) -> float:
        """Return the true time, s, at which a clock without an offset shows a time, s."""
        while self._shown[-1] < time and len(self._shown) <= self._last:
            self._draw_to(len(self._shown))
        k = bisect_right(self._shown, time)
        if k in (0, len(self._shown)):  # before or after the walk, where the error is constant
            return (time - self._errors[k - 1 if k else 0]) / self._rate
        share = (time - self._shown[k - 1]) / (self._shown[k] - self._shown[k - 1])
        return (k - 1 + share) * seconds(TICK)

    def _draw_to(self, tick: int) -> float:
        """Draw the states up to a tick, unless they are drawn already, and return the error there."""
        length, slowest = seconds(TICK), (1.0 + MIN_DRIFT - self._rate) * seconds(TICK)
        while len(self._errors) <= tick:
            for first, second in self._rng.standard_normal((BLOCK, 2)).tolist():
                if len(self._errors) > self._last:
                    break
                change = self._drift_step * first
                step = length * (self._drift + change / 2.0) + self._offset_step * second
                self._drift += change
                # The step has a lower bound, so that the shown time always increases, and `when` can bisect.
                self._errors.append(self._errors[-1] + max(step, slowest))
                self._shown.append(self._rate * (len(self._errors) - 1) * length + self._errors[-1])
        return self._errors[tick]


class WanderingClock(NodeClock):
    """The local clock of a node whose error also has a random part.

    Args:
        env: the clock of the simulation.
        offset: s.
        rate: the mean rate.
        walk: the random part of the error.
    """

    wanders: ClassVar[bool] = True

    def __init__(self, env: Clock, offset: float, rate: float, walk: ClockWalk):
        super().__init__(env, offset, rate)
        self._walk = walk

    @property
    def now(self) -> float:
        """The local time, s."""
        return self.at(self.true)

    @property
    def stamp(self) -> int:
        """The local time, ns."""
        return round(self.now * SECOND)

    @property
    def uncorrected(self) -> int:
        """The local time without the correction, ns."""
        return round((self.now - self.correction) * SECOND)

    def at(self, true: int) -> float:
        """Return the local time (s) at a true time (ns), with the present correction."""
        return super().at(true) + self._walk.error(true)

    def when(self, time: float) -> int:
        """Return the true time (ns) at a local time (s), with the present correction."""
        return round(self._walk.when(time - self._offset) * SECOND)

    def span(self, duration: float) -> int:
        """Return the true duration (ns) of a local duration (s) from now; a negative one counts at the mean rate."""
        if duration < 0.0:
            return super().span(duration)
        return max(self.when(self.now + duration) - self.true, 0)


def node_clocks(env: Clock, faults: Iterable[object], size: int, seed: int, until: int) -> list[NodeClock]:
    """Return the clocks of all nodes, with the errors of all `ClockSkew` in `faults`; variances of walks are added.

    Args:
        env: the clock of the simulation.
        faults: the faults; those that are no `ClockSkew` are ignored.
        size: the number of nodes.
        seed: the seed of the run.
        until: the time, ns, up to which the clocks may be read.
    """
    errors = clock_errors(faults := list(faults), size, seed)
    return [
        NodeClock(env, offset, 1.0 + drift) if walk is None else WanderingClock(env, offset, 1.0 + drift, walk)
        for (offset, drift), walk in zip(errors, clock_walks(faults, errors, seed, until), strict=True)
    ]


def clock_walks(
    faults: Sequence[object], errors: Sequence[tuple[float, float]], seed: int, until: int
) -> list[ClockWalk | None]:
    """Return for each node the random part of the error of its clock, or None; see `node_clocks`.

    `errors` holds the offset (s) and the drift of each clock, as `clock_errors` returns them.
    """

    def walk_of(node: int, drift: float) -> ClockWalk | None:
        skews = clock_skews(faults, node)
        offset_walk = sqrt(portable_sum(skew.offset_walk * skew.offset_walk for skew in skews))
        drift_walk = sqrt(portable_sum(skew.drift_walk * skew.drift_walk for skew in skews))
        if not (offset_walk or drift_walk):
            return None
        return ClockWalk(offset_walk, drift_walk, 1.0 + drift, until, stream(seed, "clock walk", node))

    return [walk_of(node, drift) for node, (_, drift) in enumerate(errors)]

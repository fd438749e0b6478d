"""Dead reckoning: where a pursuer is by now that was somewhere some time ago and has chased since.

During a motion step all pursuers see the same: an evader that goes on straight from where it was as the step began. A
law of guidance knows nothing else, so whoever has seen the path of the evader can retrace that of a teammate.
"""

from bisect import bisect_left, bisect_right
from operator import itemgetter
from typing import NamedTuple

from desim.kernel.clock import seconds
from desim.pursuit.guidance import Guidance, guided_velocity
from desim.pursuit.kinematics import SMALLEST

MAX_RETRACINGS = 10_000
"""How many teammates' paths are remembered between two times that somebody asks for them."""


class TrackSegment(NamedTuple):
    """What pursuers see of the evader during a motion step."""

    begun: int
    """When the step began, ns."""
    evader: complex
    """Where the evader was by then, m."""
    aim: complex
    """What pursuers aim at, m."""
    flight: complex
    """The velocity of the evader as they see it, m/s."""

    def at(self, t: int) -> complex:
        """Return where the evader is seen at an instant (ns), m."""
        return self.evader + self.flight * seconds(t - self.begun)


class EvaderTrack:
    """What was seen of the path of the evader: the present motion step and, if it remembers, all before it.

    Steps are seen, and places asked for, in the order of time.

    Attributes:
        last: what is seen during the present step.
    """

    last: TrackSegment

    def __init__(self, law: Guidance, *, remembers: bool = True):
        self._law, self._remembers = law, remembers
        self._legs: list[TrackSegment] = []
        self._retracings: dict[tuple[complex, float, int], tuple[int, complex]] = {}

    def see(self, t: int, evader: complex, aim: complex, flight: complex) -> None:
        """See the evader as a step begins; the arguments as in `TrackSegment`."""
        self.last = TrackSegment(t, evader, aim, flight)
        if self._remembers:
            self._legs.append(self.last)

    def place(self, position: complex, speed: float, since: int, now: int) -> complex:
        """Return where a pursuer is now (ns) that was at a position (m) at an instant (ns) and has chased since, m.

        It goes on from where the step began in which it was when last asked for, if it was; cost O(motion steps since
        then). Before 0 nobody moves.
        """
        assert self._remembers
        known = (position, speed, since)
        began, origin = t, place = self._retracings.pop(known, (max(since, 0), position))
        first = bisect_right(self._legs, t, key=itemgetter(0)) - 1
        last = bisect_left(self._legs, now, key=itemgetter(0))  # the evader may have been captured since
        ends = [leg.begun for leg in self._legs[first + 1 : last]] + [now]
        for leg, end in zip(self._legs[first:], ends, strict=False):  # none yet at the start
            began, origin = t, place
            velocity = guided_velocity(self._law, leg.at(t) - place, leg.aim - place, leg.flight, speed)
            place += velocity * seconds(end - t)
            t = end
        self._retracings[known] = (began, origin)
        if len(self._retracings) > MAX_RETRACINGS:
            del self._retracings[next(iter(self._retracings))]  # the one not asked for for longest
        return place


def nearer(position: complex, evader: complex, length: float) -> complex:
    """Return where one is that has gone a length (m) from a position straight towards the evader, at most to it, m."""
    gap = evader - position
    return evader - max(abs(gap) - length, 0.0) * gap / max(abs(gap), SMALLEST)

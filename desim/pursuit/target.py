"""A target: one of the evaders of a run, with all that is particular to it."""

from math import inf

from desim.pursuit.capture import RadialTime
from desim.pursuit.perception import Mind
from desim.pursuit.reckoning import Sightings
from desim.pursuit.state import Floats, State


class Target:
    """An evader that flees, what its speed makes of the pursuers, and what is known of it at this instant.

    Args:
        number: 1 .. M, which is the action of a pursuer that chases it.
        speed: m/s.
        mind: how it chooses its heading.
        seen: its path, as pursuers see it.
        speeds: (N,) of the pursuers, m/s.
        radius: distance at which it is captured, m.

    Attributes:
        radial_time: every pursuer's time of capture as a function of its distance.
        slow: (N,) who can never capture it.
        closing_bound: how fast a distance to it can fall at most, m/s.
        captured: when it was, ns; None if it has not been.
        state: where everyone is now as far as it matters to this target; None if nobody has asked.
        times: every pursuer's time of capture in that state, s; None if nobody has asked.
    """

    def __init__(self, number: int, speed: float, mind: Mind, seen: Sightings, *, speeds: Floats, radius: float):
        self.number, self.speed, self.seen = number, speed, seen
        self._mind = mind
        self.radial_time = RadialTime(speeds, speed, radius)
        self.slow: list[bool] = self.radial_time.slow.tolist()
        self.closing_bound = float(speeds.max()) + speed
        self.captured: int | None = None
        self._never = (inf,) * len(speeds)
        self.state: State | None = None
        self.times: tuple[float, ...] | None = None

    def capture_times(self) -> tuple[float, ...]:
        """Return every pursuer's time of capture in the present state, s; inf once it has been captured."""
        if self.captured is not None:
            return self._never
        assert self.state is not None
        self.times = tuple(self.radial_time(self.state.distances).tolist())
        return self.times

    def flight(self, *, handover: bool) -> complex:
        """Return the velocity it chooses in the present state, m/s; 0 once it has been captured.

        Args:
            handover: whether word of a change of action is in flight.
        """
        if self.captured is not None:
            return 0j
        assert self.state is not None
        return self.speed * self._mind.heading(self.state, handover)

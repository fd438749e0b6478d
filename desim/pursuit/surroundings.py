"""The part of the world that agents sense and act on."""

from typing import Protocol

from desim.pursuit.state import Points


class Surroundings(Protocol):
    """The part of the world that agents sense and act on."""

    @property
    def size(self) -> int:
        """How many pursuers there are."""
        ...

    def active(self, pursuer: int) -> bool:
        """Return what a pursuer is doing."""
        ...

    def capture_times(self) -> tuple[float, ...]:
        """Return every pursuer's time of capture now, s."""
        ...

    def capture_time_from(self, pursuer: int, position: complex) -> float:
        """Return the time of capture of a pursuer if it were at a position (m), s."""
        ...

    def may_chase(self, pursuer: int) -> bool:
        """Return whether a pursuer has the choice to chase."""
        ...

    def place(self, pursuer: int) -> complex:
        """Return the position of a pursuer, m."""
        ...

    def places(self) -> Points:
        """Return the (N,) positions of the pursuers, m."""
        ...

    def evader(self) -> complex:
        """Return the position of the evader, m."""
        ...

    @property
    def radius(self) -> float:
        """The distance at which the evader is captured, m."""
        ...

    def obeys(self, pursuer: int) -> bool:
        """Return whether a pursuer would follow an order."""
        ...

    def reckoned(self, position: complex, speed: float, age: int, *, exact: bool) -> complex:
        """Return where a pursuer is that was at a position (m) an age (ns) ago and has chased since, m."""
        ...

    def speed(self, pursuer: int) -> float:
        """Return how fast a pursuer moves if it does, m/s."""
        ...

    def time_left(self, now: int) -> float:
        """Return the time from an instant (ns) to the horizon, r, s."""
        ...

    def order(self, pursuer: int, active: bool) -> None:
        """Let a pursuer chase or stay from this instant on."""
        ...

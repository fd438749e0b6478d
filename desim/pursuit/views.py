"""The part of the world that agents sense and act on."""

from collections.abc import Collection, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from desim.pursuit.state import Floats, Points


class PursuerView(Protocol):
    """The part of the world that agents sense and act on."""

    @property
    def size(self) -> int:
        """How many pursuers there are."""
        ...

    @property
    def evader_count(self) -> int:
        """How many evaders there were at first, M."""
        ...

    def evaders(self) -> Sequence[int]:
        """Return the evaders that have not been captured, of 1 .. M."""
        ...

    def action(self, pursuer: int) -> int:
        """Return which evader a pursuer chases, or 0."""
        ...

    def capture_times(self, evader: int) -> tuple[float, ...]:
        """Return every pursuer's time of capture of an evader now, s; inf if that has been captured."""
        ...

    def capture_times_of(self, pursuers: Collection[int], evader: int) -> list[float]:
        """Return the times of capture of some pursuers, s; as `capture_times`, and faster for a few."""
        ...

    def capture_time_from(self, pursuer: int, position: complex, evader: int) -> float:
        """Return the time of capture of a pursuer if it were at a position (m), s."""
        ...

    def may_chase(self, pursuer: int, evader: int) -> bool:
        """Return whether a pursuer has the choice to chase an evader."""
        ...

    def options(self, pursuer: int) -> Sequence[int]:
        """Return the actions that a pursuer may choose: 0, and each evader that it may chase."""
        ...

    def place(self, pursuer: int) -> complex:
        """Return the position of a pursuer, m."""
        ...

    def places(self) -> Points:
        """Return the (N,) positions of the pursuers, m."""
        ...

    def evader(self, evader: int) -> complex:
        """Return the position of an evader, m."""
        ...

    @property
    def radius(self) -> float:
        """The distance at which an evader is captured, m."""
        ...

    def reckoned(
        self, position: complex, speed: float, age: int, evader: int, *, exact: bool, ended: int = 0
    ) -> complex:
        """Return the position of a pursuer that set out at a position (m) an age (ns) ago to chase an evader, m.

        It stopped so long ago (`ended`, ns).
        """
        ...

    def speed(self, pursuer: int) -> float:
        """Return how fast a pursuer moves if it does, m/s."""
        ...

    def time_left(self, now: int) -> float:
        """Return the time from an instant (ns) to the horizon, r, s."""
        ...

    def set_action(self, pursuer: int, action: int) -> None:
        """Let a pursuer chase an evader or stay from this instant on."""
        ...


class GlobalState(PursuerView, Protocol):
    """The world as it is, for what makes of it what one pursuer senses."""

    @property
    def static(self) -> bool:
        """Whether nobody moves."""
        ...

    def profile(self) -> Sequence[int]:
        """Return what everybody does."""
        ...

    def broken(self) -> NDArray[np.bool_]:
        """Return (N,) who is broken, and so follows no order."""
        ...

    def distances(self, evader: int) -> Floats:
        """Return the (N,) distances of the pursuers to an evader now, m."""
        ...

    def velocity(self, evader: int) -> complex:
        """Return how an evader moves now, m/s."""
        ...

    def evader_speed(self, evader: int) -> float:
        """Return how fast an evader can move, m/s."""
        ...

    def capture_times_at(self, place: complex, uncertainty: float, evader: int) -> tuple[float, ...]:
        """Return every pursuer's time of capture of an evader were that at a place, and so much farther away (m), s."""
        ...

    def capture_time_over(self, pursuer: int, distance: float, evader: int) -> float:
        """Return the time of capture of a pursuer over a distance (m), s."""
        ...

    def may_chase(self, pursuer: int, evader: int, view: PursuerView | None = None) -> bool:
        """Return whether a pursuer has the choice to chase an evader, by the times of capture of a view if given."""
        ...

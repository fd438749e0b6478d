"""The interfaces of the world to its agents: what a pursuer senses and acts on, and the true state."""

from collections.abc import Collection, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from desim.pursuit.state import Floats, Points


class PursuerView(Protocol):
    """The part of the world that agents sense and act on."""

    @property
    def size(self) -> int:
        """Number of pursuers, N."""
        ...

    @property
    def evader_count(self) -> int:
        """Number of evaders at the start, M."""
        ...

    def evaders(self) -> Sequence[int]:
        """Return the numbers of the evaders that have not been captured, of 1 .. M."""
        ...

    def action(self, pursuer: int) -> int:
        """Return the evader that a pursuer chases, or 0."""
        ...

    def capture_times(self, evader: int) -> tuple[float, ...]:
        """Return the capture time of each pursuer for an evader now, s; inf if the evader has been captured."""
        ...

    def capture_times_of(self, pursuers: Collection[int], evader: int) -> list[float]:
        """Return the capture times of some pursuers, s; like `capture_times`, and faster for a few."""
        ...

    def capture_time_from(self, pursuer: int, position: complex, evader: int) -> float:
        """Return the capture time of a pursuer from a hypothetical position (m), s."""
        ...

    def may_chase(self, pursuer: int, evader: int) -> bool:
        """Return whether a pursuer may choose to chase an evader."""
        ...

    def options(self, pursuer: int) -> Sequence[int]:
        """Return the actions that a pursuer may choose: 0, and each evader that it may chase."""
        ...

    def position(self, pursuer: int) -> complex:
        """Return the position of a pursuer, m."""
        ...

    def positions(self) -> Points:
        """Return the (N,) positions of the pursuers, m."""
        ...

    def evader(self, evader: int) -> complex:
        """Return the position of an evader, m."""
        ...

    @property
    def radius(self) -> float:
        """The capture radius, m."""
        ...

    def reckoned(
        self, position: complex, speed: float, age: int, evader: int, *, exact: bool, ended: int = 0
    ) -> complex:
        """Return the present position of a pursuer that has chased an evader from `position` (m) since `age` ns ago, m.

        The chase ended `ended` ns ago.
        """
        ...

    def speed(self, pursuer: int) -> float:
        """Return the speed of a pursuer while it chases, m/s."""
        ...

    def time_left(self, now: int) -> float:
        """Return the time from an instant (ns) to the horizon, r, s."""
        ...

    def set_action(self, pursuer: int, action: int) -> None:
        """Let a pursuer chase an evader, or stay (0), from this instant on."""
        ...


class GlobalState(PursuerView, Protocol):
    """The true state of the world, for sensor models and omniscient benchmarks."""

    @property
    def static(self) -> bool:
        """Whether all players stand still for the whole run."""
        ...

    def profile(self) -> Sequence[int]:
        """Return the action of each pursuer."""
        ...

    def broken(self) -> NDArray[np.bool_]:
        """Return the (N,) mask of the pursuers that are down and follow no action."""
        ...

    def distances(self, evader: int) -> Floats:
        """Return the (N,) distances of the pursuers to an evader now, m."""
        ...

    def velocity(self, evader: int) -> complex:
        """Return the velocity of an evader now, m/s."""
        ...

    def evader_speed(self, evader: int) -> float:
        """Return the speed of an evader, m/s."""
        ...

    def capture_times_at(self, position: complex, uncertainty: float, evader: int) -> tuple[float, ...]:
        """Return the capture time of each pursuer for an evader at a position (m), each distance increased (m), s."""
        ...

    def capture_time_over(self, pursuer: int, distance: float, evader: int) -> float:
        """Return the capture time of a pursuer at a distance (m), s."""
        ...

    def may_chase(self, pursuer: int, evader: int, view: PursuerView | None = None) -> bool:
        """Return whether a pursuer may choose to chase an evader, by the capture times of a view if given."""
        ...

"""A target: one of the evaders of a run, with all that is particular to it."""

from collections import deque
from collections.abc import Collection, Iterable
from math import inf
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from desim.config.model import MAX_COORDINATE
from desim.kernel.clock import SECOND, nanoseconds, seconds
from desim.kernel.events import Broadcast, Event, Sent
from desim.kernel.records import Record
from desim.pursuit.announcements import records_in
from desim.pursuit.capture import RadialTime
from desim.pursuit.dead_reckoning import EvaderTrack
from desim.pursuit.evasion import PureEvasion, Strategy, away
from desim.pursuit.events import Started
from desim.pursuit.kinematics import Kinematics, first_contact, within
from desim.pursuit.observation import EvaderObservation
from desim.pursuit.state import Floats, Points, State


class EvaderController:
    """One evader's perception and choice in one run.

    Args:
        strategy: how it chooses.
        rng: the stream of its choices, its alone.
        speed: how fast it moves, m/s.
        speeds: (N,) of the pursuers, m/s.
        radius: distance at which it is captured, m.
        sight: how far it sees pursuers, m.
        reaction: how old what it sees is, s.
    """

    def __init__(
        self,
        strategy: Strategy,
        rng: np.random.Generator,
        *,
        speed: float,
        speeds: Floats,
        radius: float,
        sight: float = inf,
        reaction_delay: float = 0.0,
    ):
        self._strategy, self._rng = strategy, rng
        self._speed, self._speeds, self._radius, self._sight = speed, speeds, radius, sight
        self._memory = DelayedState(nanoseconds(reaction_delay)) if nanoseconds(reaction_delay) else None
        flees_all = isinstance(strategy, PureEvasion) and strategy.flees_from == "all"
        self._plain = flees_all and sight == inf and self._memory is None
        self._heading = 0j
        self._since: int | None = None

    def heading(self, state: State, handover: bool = False) -> complex:
        """Return the heading that it chooses in a state, at most 1 long; it is asked in the order of time.

        Args:
            state: as it is.
            handover: whether word of a change of action is in flight.

        Raises:
            ValueError: if its strategy returns a longer one.
        """
        if self._plain:  # the evader of the paper: the same, several times faster
            return away(state)
        outlook = EvaderObservation(
            self._memory(state) if self._memory else state,
            self._speeds,
            self._speed,
            self._radius,
            self._heading,
            0.0 if self._since is None else seconds(state.t - self._since),
            handover,
        )
        if self._sight < inf:
            outlook = outlook.only(outlook.distances <= self._sight)
        heading = self._strategy(outlook, self._rng)
        if not abs(heading) <= 1.0 + 1e-9:
            raise ValueError(f"an evader's heading should be at most 1 long, got {heading} from {self._strategy!r}")
        self._heading, self._since = complex(heading), state.t
        return heading


class Eavesdropper:
    """A watcher of events that listens to the radio: it knows when word of a change of action is in flight.

    What waits to be transmitted is not heard; nor are the orders of a server, only the reports of who obeys them.
    """

    def __init__(self) -> None:
        self._actions: dict[int, int] = {}
        self._changed: dict[int, int] = {}
        self._until = 0

    def __call__(self, event: Event) -> None:
        """Listen to what happens."""
        if isinstance(event, Started):
            self._actions = dict(enumerate(event.active))
        elif isinstance(event, Broadcast | Sent):
            for record in records_in(event):
                self._hear(record, event)

    def hands_over(self, now: int) -> bool:
        """Return whether the word of a pursuer that does something else than it said before is in flight, now (ns)."""
        return now < self._until

    def _hear(self, record: Record, event: Broadcast | Sent) -> None:
        """Take note of a record that is transmitted."""
        action, newer = getattr(record.body, "active", None), record.seq > self._changed.get(record.src, 0)
        if newer and action is not None and action != self._actions.get(record.src, 0):
            self._actions[record.src], self._changed[record.src] = action, record.seq
        if self._changed.get(record.src) == record.seq:
            self._until = max([self._until, *(arrival for _, arrival in event.fates())])


class DelayedState:
    """What was seen lately: `memory(state)` is a state with the pursuers as they were some time (ns) before it.

    Between two states that it has been told of they moved straight, and chased as in the first of the two; before the
    first state they were as in that.
    """

    def __init__(self, delay: int):
        self._delay = delay
        self._seen: deque[State] = deque()

    def __call__(self, state: State) -> State:
        """Take note of a state, none earlier than the last, and return it as it is perceived."""
        seen, then = self._seen, state.t - self._delay
        seen.append(state)
        while len(seen) > 1 and seen[1].t <= then:
            seen.popleft()
        pursuers = seen[0].pursuers
        if seen[0].t < then:
            share = (then - seen[0].t) / (seen[1].t - seen[0].t)
            pursuers = pursuers + share * (seen[1].pursuers - pursuers)
        return State(state.t, pursuers, state.evader, seen[0].active)


SINGLY = 16
"""Up to so many pursuers it is faster to ask for each by itself than for all at once."""


class EvaderBody:
    """An evader that flees, what its speed makes of the pursuers, and what is known of it at this instant.

    Args:
        number: 1 .. M, which is the action of a pursuer that chases it.
        speed: m/s.
        mind: how it chooses its heading.
        path: its path, as pursuers see it.
        players: where everyone is: the N pursuers, then the evaders in order.
        speeds: (N,) of the pursuers, m/s.
        radius: distance at which it is captured, m.

    Attributes:
        slow: (N,) who can never capture it.
        captured: when it was, ns; None if it has not been.
        player: its number among the players.
    """

    def __init__(
        self,
        number: int,
        speed: float,
        mind: EvaderController,
        path: EvaderTrack,
        *,
        players: Kinematics,
        speeds: Floats,
        radius: float,
    ):
        self.number, self.speed, self.path = number, speed, path
        self._size, self._radius = len(speeds), radius
        self.player = self._size + number - 1
        self._mind, self._players = mind, players
        self._radial_time = RadialTime(speeds, speed, radius)
        self.slow: list[bool] = self._radial_time.slow.tolist()
        self._closing_bound = max(float(speeds.max()) + speed, 1e-9)  # at least how fast a distance to it can fall, m/s
        self.captured: int | None = None
        self._chasers: NDArray[np.bool_] = np.zeros(self._size, dtype=bool)
        self._safe_until = -1  # nobody can capture it before, ns
        self._state: State | None = None
        self._read: Points | None = None  # the positions of which that is the state
        self._times: tuple[float, ...] | None = None

    @property
    def place(self) -> complex:
        """Where it is now, m."""
        return self._players.place(self.player)

    def set_chasers(self, chasers: NDArray[np.bool_]) -> None:
        """Take note of (N,) who chases it from now on."""
        chasers.setflags(write=False)
        self._chasers, self._read = chasers, None

    def state(self, now: int) -> State:
        """Return where the pursuers and it are now (ns), and who chases it."""
        places = self._players.places()
        if self._state is None or places is not self._read:
            self._state = State(now, places[: self._size], places.item(self.player), self._chasers)
            self._read, self._times = places, None
        return self._state

    def capture_times(self, now: int) -> tuple[float, ...]:
        """Return every pursuer's time of capture now (ns), s; inf once it has been captured."""
        if self.captured is not None:
            return (inf,) * self._size
        state = self.state(now)
        if self._times is None:
            self._times = tuple(self._radial_time(state.distances).tolist())
        return self._times

    def capture_times_of(self, pursuers: Collection[int], now: int) -> list[float]:
        """Return the times of capture of some pursuers now (ns), s; inf once it has been captured."""
        if len(pursuers) > SINGLY or self.captured is not None:
            times = self.capture_times(now)
            return [times[pursuer] for pursuer in pursuers]
        if self._players.are_known:
            distances: Iterable[float] = map(self.state(now).distances.item, pursuers)
        else:
            distances = self._players.distances(self.player, pursuers)
        return list(map(self._radial_time.of, pursuers, distances))

    def capture_time_over(self, pursuer: int, distance: float) -> float:
        """Return the time of capture of a pursuer over a distance (m), s."""
        return self._radial_time.of(pursuer, distance)

    def capture_times_over(self, distances: Floats) -> tuple[float, ...]:
        """Return every pursuer's time of capture over (N,) distances (m), s."""
        return tuple(self._radial_time(distances).tolist())

    def flight(self, state: State, *, handover: bool) -> complex:
        """Return the velocity it chooses in the present state, m/s; 0 once it has been captured.

        Args:
            state: as `state` returns it.
            handover: whether word of a change of action is in flight.
        """
        if self.captured is not None:
            return 0j
        return self.speed * self._mind.heading(state, handover)

    def contact(
        self, now: int, until: int, broken: NDArray[np.bool_], test: Literal["segment", "sample"]
    ) -> tuple[float, int] | None:
        """Return in how many s, and by whom, it is captured if everybody goes on until an instant; None if it is not.

        Args:
            now: ns.
            until: ns.
            broken: (N,) who captures nobody.
            test: see `desim.scenario.scenario.Capture`.
        """
        if until <= self._safe_until:
            return None
        state, duration = self.state(now), seconds(until - now)
        gap = state.distances.item(state.nearest) - self._radius
        # Whatever all do; a little less, for rounding, and nothing if there is no gap.
        self._safe_until = now - 1 + int(0.999 * gap / self._closing_bound * SECOND)
        if until <= self._safe_until:
            return None
        velocities = self._players.velocities
        approach = velocities[self.player] - velocities[: self._size]
        offsets = np.where(broken, MAX_COORDINATE, state.offsets) if broken.any() else state.offsets
        if test == "segment":
            return first_contact(offsets, approach, self._radius, duration)
        row = within(offsets + approach * duration, self._radius)
        return None if row is None else (duration, row)

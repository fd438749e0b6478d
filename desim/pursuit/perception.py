"""What an evader perceives of the pursuers, how late and how far, and the heading that it chooses of it."""

from collections import deque
from math import inf

import numpy as np

from desim.kernel.clock import nanoseconds, seconds
from desim.kernel.events import Broadcast, Event, Sent
from desim.kernel.records import Record
from desim.pursuit.evasion import PureEvasion, Strategy, away
from desim.pursuit.events import Started
from desim.pursuit.outlook import Outlook
from desim.pursuit.state import Floats, State
from desim.pursuit.word import records_in


class Mind:
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
        reaction: float = 0.0,
    ):
        self._strategy, self._rng = strategy, rng
        self._speed, self._speeds, self._radius, self._sight = speed, speeds, radius, sight
        self._memory = Memory(nanoseconds(reaction)) if nanoseconds(reaction) else None
        flees_all = isinstance(strategy, PureEvasion) and strategy.heeds == "all"
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
        outlook = Outlook(
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


class Memory:
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

"""The agent: all that a pursuer's protocol may know and do.

It senses positions (its own and its teammates', and the evader's), knows the rules of the game, and hears from its
teammates only what the network has brought it.
"""

from collections.abc import Callable, Generator
from math import inf
from typing import Any, NamedTuple, Protocol

import numpy as np
import simpy

from desim.kernel.clock import Clock, Instant, Phase, nanoseconds, seconds
from desim.kernel.inbox import Message
from desim.kernel.network import Network
from desim.kernel.records import Table
from desim.kernel.seeds import stream
from desim.pursuit import game


class Assignment(NamedTuple):
    """What a pursuer announces: its action."""

    active: bool


class Surroundings(Protocol):
    """The part of the world that agents sense and act on."""

    @property
    def size(self) -> int:
        """How many pursuers there are."""
        ...

    def active(self, pursuer: int) -> bool:
        """Return what a pursuer is doing."""
        ...

    def capture_times(self) -> list[float]:
        """Return every pursuer's time of capture now, s."""
        ...

    def time_left(self) -> float:
        """Return the time left to the horizon, r, s."""
        ...

    def order(self, pursuer: int, active: bool) -> None:
        """Let a pursuer chase or stay from this instant on."""
        ...


Process = Generator[simpy.Event, Any, None]
"""What a protocol is when it runs: it yields the events it waits for."""


class Agent:
    """One pursuer, as its protocol sees it. What returns an event ends up behind `yield`; all else returns at once.

    Attributes:
        id: 0 .. team_size - 1.
        rng: the stream of its decisions.
    """

    def __init__(self, pursuer: int, env: Clock, world: Surroundings, network: Network, seed: int):
        self.id = pursuer
        self.rng = stream(seed, "decisions", pursuer)
        self._env, self._world, self._network, self._seed = env, world, network, seed
        self._turn = int(Phase.DECISION) + pursuer  # its priority among the events of one instant

    # What it knows.

    @property
    def now(self) -> float:
        """The time, s."""
        return seconds(self._env.now)

    @property
    def team_size(self) -> int:
        """How many pursuers there are."""
        return self._world.size

    @property
    def action(self) -> bool:
        """Whether it is active."""
        return self._world.active(self.id)

    def capture_time(self) -> float:
        """Return its own time of capture phi_i, s."""
        return self._world.capture_times()[self.id]

    def capture_times(self) -> list[float]:
        """Return everyone's time of capture, from sensed positions, s."""
        return self._world.capture_times()

    def time_left(self) -> float:
        """Return the time left to the horizon, r, s."""
        return self._world.time_left()

    def heard(self) -> Table:
        """Return the newest announcement that has arrived from each teammate."""
        return self._network.heard(self.id)

    def believed_active(self) -> list[int]:
        """Return the teammates whose newest announcement that has arrived says that they are active."""
        return [j for j, (_, record) in self.heard().items() if record.body.active]

    def gain(self) -> float:
        """Return what it gains by being active, given whom it believes active; see `desim.pursuit.game.gain`, s."""
        phi = self._world.capture_times()
        others = [phi[j] for j in self.believed_active() if phi[j] < inf]
        return game.gain(phi[self.id], others, self._world.time_left())

    def stream(self, name: str) -> np.random.Generator:
        """Return a random stream of its own."""
        return stream(self._seed, name, self.id)

    def shared_stream(self, name: str) -> np.random.Generator:
        """Return a random stream that is the same for everyone who asks for it by this name."""
        return stream(self._seed, f"shared {name}")

    # What it does.

    def assign(self, active: bool) -> None:
        """Chase or stay from now on; who cannot capture (phi = inf) stays whatever it wants."""
        self._world.order(self.id, active)

    def command(self, pursuer: int, active: bool) -> None:
        """Let another pursuer chase or stay, at once and past the network: for omniscient benchmarks only."""
        self._world.order(pursuer, active)

    def announce(self) -> None:
        """Tell the neighbours its action, as state: they read it when they next decide."""
        self._network.publish(self.id, Assignment(self.action))

    def send(self, dst: int | None, body: Any) -> None:
        """Send a message to a teammate, or to all neighbours (None)."""
        self._network.send(self.id, dst, body)

    def mail(self) -> list[Message]:
        """Return the messages that have arrived and not been read."""
        return self._network.inbox(self.id).drain()

    # What it waits for.

    def at(self, time: float) -> simpy.Event:
        """Return an event at a time, s."""
        return Instant(self._env, nanoseconds(time), self._turn)

    def sleep(self, duration: float) -> simpy.Event:
        """Return an event a duration from now, s."""
        return Instant(self._env, self._env.now + nanoseconds(duration), self._turn)

    def arrival(self) -> simpy.Event:
        """Return an event that happens as soon as there is mail."""
        return self._network.inbox(self.id).arrival()


Behaviour = Callable[[Agent], Process]
"""A protocol: the process that a pursuer runs."""

"""The knowledge of a pursuer without messages: itself, the evaders that it senses, and the links of the network."""

from collections.abc import Sequence
from operator import attrgetter
from typing import Any

from desim.config.model import MAX_TIME
from desim.config.python_numbers import real, whole
from desim.kernel.core.clock import NodeClock
from desim.kernel.core.units import nanoseconds, seconds
from desim.kernel.network import Network
from desim.pursuit.motion.environment import Environment
from desim.pursuit.sensing.noise import Covariance
from desim.pursuit.sensing.views import NOWHERE, EvaderEstimate, View


class Knowledge:
    """The knowledge of one pursuer without messages; see `desim.pursuit.team.beliefs.Beliefs` for its teammates.

    Evaders are numbered 1 .. M; most methods raise ValueError for any other number.

    Attributes:
        id: its id, 0 .. team_size - 1.

    Args:
        pursuer: its id.
        view: its view of the world.
        network: the network that carries its messages.
        clock: its local clock.
    """

    now: float = property(  # type: ignore[assignment]  # as in `desim.kernel.core.clock.Clock`
        attrgetter("_clock.now"), doc="The time on its local clock, s: offset + (1 + drift) t at the true time t."
    )

    def __init__(self, pursuer: int, view: View, network: Network, clock: NodeClock):
        self.id = pursuer
        self._view, self._state, self._network, self._clock = view, view.state, network, clock

    @property
    def team_size(self) -> int:
        """Number of pursuers, N."""
        return self._state.size

    def evaders(self) -> Sequence[int]:
        """Return the numbers of the evaders that have not been captured."""
        return self._state.at_large

    def options(self) -> Sequence[int]:
        """Return the actions that it may choose: 0, and each evader that it may chase; see `may_chase`."""
        return self._view.options(self.id)

    def has_choice(self) -> bool:
        """Return whether it may choose any action but 0."""
        return len(self._view.options(self.id)) > 1

    @property
    def evader_count(self) -> int:
        """Number of evaders at the start, M."""
        return self._state.evader_count

    def capture_time(self, evader: int = 1) -> float:
        """Return its own capture time phi_i for an evader, s.

        It is inf if the evader is captured, if its position is unknown, or if the pursuer is not faster than the evader
        and not within the capture radius.
        """
        (time,) = self._view.capture_times_of([self.id], evader)
        return time

    def time_left(self, ahead: float = 0.0) -> float:
        """Return the time r, s, that will be left to the horizon `ahead` seconds from now, by its local clock."""
        if type(ahead) is not float:
            ahead = real(ahead, f"pursuer {self.id}: time_left: the time ahead")
        if not abs(ahead) <= MAX_TIME:
            raise ValueError(f"pursuer {self.id}: time_left: the time ahead should be finite, s (got {ahead})")
        return self._state.time_left(self._clock.stamp + nanoseconds(ahead))

    @property
    def horizon(self) -> float:
        """The latest end of the run, s."""
        return seconds(self._state.horizon)

    def may_chase(self, evader: int = 1) -> bool:
        """Return whether it may choose to chase an evader.

        The evader must be at large, with a known or estimated position, and `Scenario.prune` must not exclude the
        pursuer.
        """
        return self._view.may_chase(self.id, evader)

    def position(self) -> complex:
        """Return its own position, m."""
        return self._state.position(self.id)

    @property
    def speed(self) -> float:
        """Its speed while it chases, m/s."""
        return self._state.speed(self.id)

    def evader(self, evader: int = 1) -> complex:
        """Return the position of an evader, m: sensed or, if it is out of range, estimated; nan if unknown."""
        return self._view.evader(evader)

    def errors(self, evader: int = 1) -> tuple[float, Covariance]:
        """Return the errors of the position of an evader: an upper bound, m, and the covariance xx, xy, yy, m^2.

        Both are 0 if the kind of estimate does not give them, or the position is exact or unknown.
        """
        estimate = self._view.estimate(evader) or EvaderEstimate(NOWHERE)
        return estimate.uncertainty, estimate.covariance

    @property
    def radius(self) -> float:
        """The capture radius eps, m."""
        return self._state.radius

    @property
    def environment(self) -> Environment:
        """The medium in which the players move, whose flow all pursuers know."""
        return self._state.environment

    def neighbours(self, of: int | None = None) -> list[int]:
        """Return the nodes that now receive the transmissions of this pursuer, or of a teammate (`of`), ascending."""
        node = self.id if of is None else whole(of, f"pursuer {self.id}: neighbours: a pursuer")
        if not 0 <= node < self._state.size:
            raise ValueError(f"there is no pursuer {node}: they are 0 .. {self._state.size - 1}")
        receivers: list[int] = self._network.topology.neighbours(node).tolist()
        return receivers

    @property
    def mean_degree(self) -> float:
        """Mean number of neighbours of a pursuer, computed at the first access during the run."""
        return self._network.estimates.mean_degree

    @property
    def latency(self) -> float:
        """The nominal mean one-way latency L of the network, s.

        It includes processing at both ends, but neither airtime nor queueing.
        """
        return self._network.estimates.latency

    def airtime(self, body: Any) -> float:
        """Return the airtime of a message with this body, s."""
        return self._network.estimates.airtime(body)

    def interval(self, body: Any) -> float:
        """Return the time, s, for which a message with this body keeps its sender from sending the next one.

        It is longer than the airtime if there is a duty cycle, or if the sender waits for its slots of a TDMA.
        """
        return self._network.estimates.interval(body)

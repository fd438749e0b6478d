"""The knowledge of a pursuer: the positions that it senses, its teammates' announcements, and the network's links."""

from collections.abc import Collection, Sequence
from math import inf
from operator import attrgetter
from typing import Any

import numpy as np

from desim.kernel.core.clock import NodeClock
from desim.kernel.core.records import Record
from desim.kernel.core.units import nanoseconds
from desim.kernel.network import Network
from desim.pursuit.game.utility import Mean, Scope, Utility
from desim.pursuit.motion.flow import Environment
from desim.pursuit.sensing.views import View
from desim.pursuit.team.beliefs import UNORDERED, Belief, Beliefs, Orders, TeamEstimate

PAPER = Mean()
"""The utility of Lee & Bakolas."""


class Knowledge:
    """The knowledge of one pursuer; its decisions and messages are in `desim.pursuit.team.agent.Agent`.

    Evaders are numbered 1 .. M; most methods raise ValueError for any other number.

    Attributes:
        id: its id, 0 .. team_size - 1.

    Args:
        pursuer: its id.
        view: its view of the world.
        network: the network that carries its messages.
        clock: its local clock.
        beliefs: its beliefs about its teammates.
    """

    now: float = property(  # type: ignore[assignment]  # as in `desim.kernel.core.clock.Clock`
        attrgetter("_clock.now"), doc="The time on its local clock, s: offset + (1 + drift) t at the true time t."
    )

    def __init__(self, pursuer: int, view: View, network: Network, clock: NodeClock, beliefs: Beliefs):
        self.id = pursuer
        self._view, self._state, self._network, self._clock, self._beliefs = view, view.state, network, clock, beliefs

    @property
    def team_size(self) -> int:
        """Number of pursuers, N."""
        return self._state.size

    @property
    def action(self) -> int:
        """The evader that it chases, 1 .. M, or 0 if it is inactive."""
        return self._state.profile[self.id]

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
        """Return its own capture time phi_i of an evader, s.

        It is inf if the evader is captured or of unknown position, or if the pursuer is not faster than the evader and
        not within the capture radius.
        """
        (time,) = self._view.capture_times_of([self.id], evader)
        return time

    def time_left(self, ahead: float = 0.0) -> float:
        """Return the time r, s, that will be left to the horizon `ahead` seconds from now, by its local clock."""
        return self._state.time_left(self._clock.stamp + nanoseconds(ahead))

    def may_chase(self, evader: int = 1) -> bool:
        """Return whether it may choose to chase an evader.

        The evader must be at large, of known or estimated position, and not excluded by `Scenario.prune`.
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

    @property
    def radius(self) -> float:
        """The capture radius eps, m."""
        return self._state.radius

    @property
    def environment(self) -> Environment:
        """The medium in which the players move, whose flow all pursuers know."""
        return self._state.environment

    def latest_records(self) -> dict[int, Record]:
        """Return the newest announcement received from each teammate, however old."""
        return self._beliefs.latest_records()

    def believed_chasers(self, evader: int = 1) -> dict[int, float]:
        """Return the believed capture time, s, of each teammate that it believes to chase an evader.

        A teammate whose last announcement arrived more than `belief_timeout` ago is not believed active, nor is one
        that the pursuer does not trust (`announce.trust`). The capture time is nan if neither it nor the position of
        the teammate is announced, and the position is not sensed.
        """
        _, rivals, times = self._beliefs.rivals(evader)
        return dict(zip(rivals, times, strict=True))

    def believed_active(self, evader: int = 1) -> list[int]:
        """Return the teammates that it believes to chase an evader; see `believed_chasers`."""
        return self._beliefs.rivals(evader)[1]

    def beliefs(self, period: float | None = None, evader: int = 1, orders: Orders = UNORDERED) -> dict[int, Belief]:
        """Return the belief about each teammate whose last announcement arrived at most `belief_timeout` ago.

        Args:
            period: time between two announcements of a teammate, s; if None, the heartbeat, or inf without heartbeats.
                It counts only if `belief_timeout` is "auto".
            evader: the evader to which the capture times refer.
            orders: the orders that this pursuer, as a server, has sent to each teammate; see `Orders`. An announced
                position is extrapolated with the announced action until the first order to the teammate takes effect,
                and then with the ordered actions.
        """
        return self._beliefs.about_teammates(period, evader, orders)

    def trusted(self) -> dict[int, Record]:
        """Return the newest announcement of each teammate, if it arrived at most `belief_timeout` ago and is believed.

        Which announcements are believed is determined by `announce.trust`.
        """
        return self._beliefs.trusted()

    def team_estimate(self, evader: int = 1) -> TeamEstimate:
        """Return its estimate of the positions, speeds and capture times of itself and its teammates.

        Positions are sensed, or extrapolated from `trusted` announcements (`announce.reckoning`). Capture times refer
        to the given evader.
        """
        return self._beliefs.team_estimate(evader)

    @property
    def senses_others(self) -> bool:
        """Whether it senses the positions of its teammates, so that announcements need not contain them."""
        return self._beliefs.senses_others

    def gain(self, utility: Utility = PAPER, evader: int = 1) -> float:
        """Return its believed gain, s, from chasing an evader rather than being inactive; see `Utility`.

        Raises:
            ValueError: if a user's utility returns no number, or nan.
        """
        own, rivals, times = self._beliefs.rivals(evader)
        counted = None if utility.scope == "heard" else self.counted_teammates(utility.scope)
        others = [phi for j, phi in zip(rivals, times, strict=True) if phi < inf and (counted is None or j in counted)]
        gain: Any = utility(own, others, self._state.time_left(self._clock.stamp))
        if type(gain) is float and gain == gain:  # the type of built-in utilities; the check below takes longer
            return gain
        if not isinstance(gain, (float, int, np.number)) or gain != gain:
            raise ValueError(f"a utility should return a gain, a number in s, got {gain!r} from {utility!r}")
        return float(gain)

    def neighbours(self, of: int | None = None) -> list[int]:
        """Return the nodes that now receive the transmissions of this pursuer, or of a teammate (`of`), ascending."""
        found: list[int] = self._network.topology.neighbours(self.id if of is None else of).tolist()
        return found

    @property
    def mean_degree(self) -> float:
        """Mean number of neighbours of a pursuer, computed at the first access during the run."""
        return self._network.estimates.mean_degree

    def counted_teammates(self, scope: Scope) -> Collection[int]:
        """Return the pursuers whose actions count in its utility, given the scope of the utility.

        They are all pursuers ("heard"), the pursuers that it now hears directly ("neighbours"), or its component
        ("component"). The component contains all pursuers whose messages can reach it now over any number of hops. If
        this pursuer does not sense the positions of teammates, the scope is ignored and all pursuers count.
        """
        if scope == "heard" or not self.senses_others:
            return range(self.team_size)
        topology = self._network.topology
        return topology.audible(self.id) if scope == "neighbours" else topology.component(self.id)

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

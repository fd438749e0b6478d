"""The agent: the interface through which a protocol controls one pursuer.

The agent senses its own position and those of the evaders, and those of its teammates unless they are announced
(`announce.payload`). It learns the decisions of teammates only from messages that the network has delivered.
"""

from collections.abc import Callable, Collection, Generator, Iterable, Sequence
from itertools import count
from math import inf
from typing import Any

import numpy as np
import simpy

from desim.kernel.clock import Clock, Instant, NodeClock, Phase, nanoseconds
from desim.kernel.inbox import Message
from desim.kernel.network import Network
from desim.kernel.records import Record, Table
from desim.kernel.seeds import stream
from desim.pursuit.announcements import PAYLOADS, Announcements, LocatedAssignment
from desim.pursuit.beliefs import UNORDERED, Belief, Beliefs, Orders, TeamEstimate
from desim.pursuit.utility import Mean, Scope, Utility
from desim.pursuit.views import GlobalState, View

Process = Generator[simpy.Event, Any, None]
"""A running protocol: a generator that yields the SimPy events it waits for."""
PAPER = Mean()
"""The utility of Lee & Bakolas."""
RETURN_HINT = " (a protocol that has nothing left to wait for should return)"
"""Hint in error messages about an infinite waiting time."""


class Agent:
    """One pursuer, as its protocol sees it.

    A protocol yields the events that `at`, `sleep`, `arrival` and `after_decisions` return. No other method waits.

    Attributes:
        id: 0 .. team_size - 1.
        rng: random stream of its decisions.
        restarts: number of restarts without memory after a crash.
        global_state: the true state of the world and the actions of all pursuers, bypassing sensing and network; for
            omniscient benchmarks only.

    Args:
        pursuer: its id.
        env: the clock of the simulation.
        view: its view of the world.
        global_state: see the attribute; it sets the actions of this pursuer, too.
        network: the network that carries its messages.
        seed: seed of its random streams.
        announcements: the content and the times of its announcements.
        clock: its own clock.
    """

    def __init__(
        self,
        pursuer: int,
        env: Clock,
        view: View,
        global_state: GlobalState,
        network: Network,
        seed: int,
        announcements: Announcements,
        clock: NodeClock,
    ):
        self.id = pursuer
        self.rng = stream(seed, "decisions", pursuer)
        self.global_state = global_state
        self.restarts = 0
        self._env, self._view, self._network, self._seed = env, view, network, seed
        self._state, self._announcements, self._clock = view.state, announcements, clock
        # The body that replaces the payload of `announce.payload`, and the value in the last announcement whose change
        # makes the next one due; None: it is due in any case.
        self._payload: Any = None
        self._announced: Any = (self.action,) if announcements.warm_start else None
        self._beliefs = Beliefs(pursuer, clock, view, network, announcements, self.announcement)
        self._streams: dict[str, np.random.Generator] = {}

    def recovered(self, *, restarted: bool) -> None:
        """Register a recovery from a crash. Its last announcement may not have been sent, so the next one is due."""
        self._announced = None
        if restarted:
            self._payload = None
            self.restarts += 1

    # Knowledge.

    @property
    def now(self) -> float:
        """The time on its own clock, s: offset + (1 + drift) t."""
        return self._clock.now

    @property
    def team_size(self) -> int:
        """Number of pursuers, N."""
        return self._state.size

    @property
    def action(self) -> int:
        """The evader that it chases, 1 .. M, or 0 if it stays."""
        return self._state.profile[self.id]

    def evaders(self) -> Sequence[int]:
        """Return the numbers of the evaders that have not been captured."""
        return self._state.at_large

    def options(self) -> Sequence[int]:
        """Return the actions that it may choose: 0, and each evader that it may chase (`Scenario.prune`)."""
        return self._view.options(self.id)

    def has_choice(self) -> bool:
        """Return whether it may choose any action but 0."""
        return len(self._view.options(self.id)) > 1

    @property
    def evader_count(self) -> int:
        """Number of evaders at the start, M."""
        return self._state.evader_count

    def capture_time(self, evader: int = 1) -> float:
        """Return its own capture time phi_i of an evader, s."""
        (time,) = self._view.capture_times_of([self.id], evader)
        return time

    def time_left(self, ahead: float = 0.0) -> float:
        """Return the time r left to the horizon by its own clock, s, as it will be `ahead` s from now."""
        return self._state.time_left(self._clock.stamp + nanoseconds(ahead))

    def may_chase(self, evader: int = 1) -> bool:
        """Return whether it may choose to chase an evader (`Scenario.prune`)."""
        return self._view.may_chase(self.id, evader)

    def position(self) -> complex:
        """Return its own position, m."""
        return self._state.position(self.id)

    @property
    def speed(self) -> float:
        """Its speed while it chases, m/s."""
        return self._state.speed(self.id)

    def evader(self, evader: int = 1) -> complex:
        """Return the position of an evader, m."""
        return self._view.evader(evader)

    @property
    def radius(self) -> float:
        """The capture radius eps, m."""
        return self._state.radius

    def latest_records(self) -> Table:
        """Return the newest announcement received from each teammate, with its time of arrival, however old."""
        return self._beliefs.latest_records()

    def believed_chasers(self, evader: int = 1) -> dict[int, float]:
        """Return the believed capture time, s, of each teammate that it believes to chase an evader.

        A teammate whose last announcement arrived more than `belief_timeout` ago is not believed active. The time is
        nan if the announcement does not contain it.
        """
        _, rivals, times = self._beliefs.rivals(evader)
        return dict(zip(rivals, times, strict=True))

    def believed_active(self, evader: int = 1) -> list[int]:
        """Return the teammates that it believes to chase an evader; see `believed_chasers`."""
        return self._beliefs.rivals(evader)[1]

    def beliefs(self, period: float | None = None, evader: int = 1, orders: Orders = UNORDERED) -> dict[int, Belief]:
        """Return the belief about each teammate whose last announcement arrived at most `belief_timeout` ago.

        Args:
            period: time between two announcements of a teammate, s, if it is not the heartbeat.
            evader: the evader to which the capture times refer.
            orders: orders sent to teammates. Announced positions are extrapolated along these orders instead of the
                announced action.
        """
        return self._beliefs.all(period, evader, orders)

    def trusted(self) -> dict[int, Record]:
        """Return the newest announcement of each teammate that arrived at most `belief_timeout` ago."""
        return self._beliefs.trusted()

    def team_estimate(self, evader: int = 1) -> TeamEstimate:
        """Return its estimate of the positions, speeds and capture times of itself and its teammates.

        Positions are sensed, or extrapolated from trusted announcements (`announce.reckoning`, `trusted`). Capture
        times refer to the given evader.
        """
        return self._beliefs.team_estimate(evader)

    @property
    def senses_others(self) -> bool:
        """Whether it senses the positions of its teammates, so that announcements need not contain them."""
        return self._beliefs.senses_others

    def gain(self, utility: Utility = PAPER, evader: int = 1) -> float:
        """Return the gain of chasing an evader over staying, given its beliefs, s; see `desim.pursuit.game.gain`."""
        own, rivals, times = self._beliefs.rivals(evader)
        counted = None if utility.scope == "heard" else self.counted_teammates(utility.scope)
        others = [phi for j, phi in zip(rivals, times, strict=True) if phi < inf and (counted is None or j in counted)]
        return utility(own, others, self.time_left())

    def neighbours(self, of: int | None = None) -> list[int]:
        """Return the nodes that receive its transmissions now, or those of a teammate (`of`), ascending."""
        return self._network.neighbours(self.id if of is None else of)

    @property
    def mean_degree(self) -> float:
        """Mean number of neighbours of a pursuer, computed at the first access during the run."""
        return self._network.mean_degree

    def counted_teammates(self, scope: Scope) -> Collection[int]:
        """Return the ids whose actions count in its utility: all, those it hears directly, or those of its component.

        If positions are not sensed, the scope is ignored and all count.
        """
        if scope == "heard" or not self.senses_others:
            return range(self.team_size)
        return self._network.audible(self.id) if scope == "neighbours" else self._network.component(self.id)

    @property
    def latency(self) -> float:
        """The nominal mean one-way latency L of the network, s.

        It includes processing at both ends, but neither airtime nor queueing.
        """
        return self._network.typical_latency

    def airtime(self, body: Any) -> float:
        """Return the airtime of a message with this body, s."""
        return self._network.airtime(body)

    def stream(self, name: str) -> np.random.Generator:
        """Return its own random stream of this name; later calls, also after a restart, continue the same stream."""
        if name not in self._streams:
            self._streams[name] = stream(self._seed, name, self.id)
        return self._streams[name]

    def shared_stream(self, name: str) -> np.random.Generator:
        """Return a new random stream that yields the same draws for every pursuer that uses this name."""
        return stream(self._seed, f"shared {name}")

    # Actions and announcements.

    def assign(self, action: int) -> None:
        """Chase an evader (its number) or stay (0) from now on.

        Call it after each decision, then `announce`. A pursuer that may not chase this evader (`Scenario.prune`) stays.
        """
        self.global_state.set_action(self.id, action)

    def announce(self) -> None:
        """Announce its action after a revision, if `announce.trigger` asks for it.

        Call it after every `assign`: it sends only when due. Use `broadcast` to send in any case.
        """
        trigger = self._announcements.trigger
        if trigger == "revision" or (trigger in {"change", "both"} and self._news() != self._announced):
            self.broadcast()

    def broadcast(self) -> None:
        """Announce its action through `announce.dissemination`, whether or not it has changed."""
        self._announced = self._news()
        self._announcements.dissemination.broadcast(self, self.announcement())

    def set_payload(self, body: Any) -> None:
        """Announce this body instead of the standard payload from now on.

        Its attribute `active` is the action. With the trigger "change" or "both", `announce` sends it when
        its attribute `news` has changed.
        """
        self._payload = body

    def set_initial_belief(self) -> None:
        """Give all teammates its current announcement as their initial belief, without a transmission."""
        self._network.set_initial_belief(self.id, self.announcement(), self._clock.stamp)

    def announcement(self) -> Any:
        """Return the body that it would announce now."""
        if self._payload is not None:
            return self._payload
        return PAYLOADS[self._announcements.payload].announced_by(self.id, self._view)

    def located(self) -> LocatedAssignment:
        """Return the body that it would announce now if the payload were "state"."""
        return LocatedAssignment.announced_by(self.id, self._view)

    def record(self, body: Any) -> Record:
        """Return its next record with this body, for a dissemination that does not use `publish`."""
        return self._network.next_record(self.id, body, self._clock.stamp)

    def publish(self, body: Any) -> None:
        """Publish a record to all neighbours; a receiver reads the newest one at its next decision.

        Use it for state, of which only the newest value matters, and `send` for messages that must each be processed.
        The body is shared as in `send`.
        """
        self._network.publish(self.id, body, sent=self._clock.stamp)

    def merge_records(self, records: Iterable[Record]) -> None:
        """Merge records received inside a message into its own table; the newest record of each source is kept."""
        for record in records:
            self._network.insert(self.id, record)

    def send(self, dst: int | None, body: Any, port: str = "") -> None:
        """Send a message to a teammate, or to all neighbours (None), into the inbox of a port.

        Use it for events, each of which wakes a receiver that waits at this port (`arrival`, `mail`). A body
        that contains a list, a dict or an array is copied at sending: changing it afterwards has no effect on the
        message. All receivers get the same object and must not change it.

        Raises:
            ValueError: if the receiver is the sender, or there is no such teammate.
        """
        self._network.send(self.id, dst, body, port=port)

    def mail(self, port: str = "") -> list[Message]:
        """Return and remove the unread messages of a port, without waiting."""
        return self._network.inbox(self.id, port).drain()

    # Events to wait for.

    # The phase of an event is its place among those of one instant; events of one phase happen in the order of ids.

    def at(self, time: float, phase: Phase = Phase.DECISION) -> simpy.Event:
        """Return an event at a time on its own clock, s, rounded to nanoseconds; a time in the past counts as now.

        Raises:
            ValueError: if the time is infinite or nan.
        """
        try:
            return Instant(self._env, max(self._clock.when(time), self._env.now), int(phase) + self.id)
        except (OverflowError, ValueError) as error:
            raise ValueError(f"pursuer {self.id}: at({time}): the time should be finite, s{RETURN_HINT}") from error

    def sleep(self, duration: float, phase: Phase = Phase.DECISION) -> simpy.Event:
        """Return an event that happens after a duration, s, by its own clock.

        Raises:
            ValueError: if the duration is negative, infinite or nan.
        """
        try:
            return Instant(self._env, self._env.now + self._clock.span(duration), int(phase) + self.id)
        except (OverflowError, ValueError) as error:
            text = f"pursuer {self.id}: sleep({duration}): the duration should be finite and at least 0 s{RETURN_HINT}"
            raise ValueError(text) from error

    def after(self, duration: float, act: Callable[[], object], phase: Phase = Phase.DECISION) -> None:
        """Call a function after a duration, s, by its own clock; a restart without memory cancels the call."""
        restarts_before = self.restarts

        def happen(_: simpy.Event) -> None:
            if self.restarts == restarts_before:
                act()

        self.sleep(duration, phase).callbacks.append(happen)

    def after_decisions(self) -> simpy.Event:
        """Return an event at the present instant, after all decisions of this instant."""
        return self.sleep(0.0, Phase.HEARTBEAT)

    def arrival(self, port: str = "", phase: Phase = Phase.DECISION) -> simpy.Event:
        """Return an event that happens as soon as the inbox of a port is not empty; `mail` returns its messages."""
        return self._network.inbox(self.id, port).arrival(int(phase) + self.id)

    def repeat(self, act: Callable[[], object], period: float, name: str) -> Process:
        """Call a function every period (s, by its own clock), after the decisions of an instant.

        The first call is after a random part of the period, drawn from the stream `name`.
        """
        first = self.now + self.stream(name).uniform(0.0, period)
        for k in count():
            yield self.at(first + k * period, Phase.HEARTBEAT)
            act()

    # Internal.

    def _news(self) -> Any:
        """Return the value whose change makes an announcement due."""
        return (self.action,) if self._payload is None else self._payload.news


Behaviour = Callable[[Agent], Process]
"""A protocol: a function that returns the process of a pursuer, given its agent."""

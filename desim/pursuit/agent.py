"""The agent: all that a pursuer's protocol may know and do.

It senses positions (its own and its teammates', and the evader's), knows the rules of the game, and hears from its
teammates only what the network has brought it.
"""

from collections.abc import Callable, Collection, Generator, Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import count
from math import inf
from typing import Any, Self

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
from desim.pursuit.views import GlobalState, PursuerView

Process = Generator[simpy.Event, Any, None]
"""What a protocol is when it runs: it yields the events it waits for."""
PAPER = Mean()
"""The utility of the paper."""
NEVER = " (a protocol that waits for nothing more returns)"
"""What to do instead of waiting for an infinite time."""


@dataclass(slots=True)
class AnnouncementState:
    """What is remembered of a pursuer by all its processes."""

    news: Any
    """What was new about its last announcement; None if the others need not know of any."""
    payload: Any = None
    """What its protocol announces in place of the payload."""
    restarts: int = 0
    """How often it has started anew, without memory."""


class Agent:
    """One pursuer, as its protocol sees it. What returns an event ends up behind `yield`; all else returns at once.

    Attributes:
        id: 0 .. team_size - 1.
        rng: the stream of its decisions.
        whole: the world as it is, past the network: for omniscient benchmarks only.

    Args:
        pursuer: its id.
        env: the clock of the simulation.
        world: what it senses and acts on.
        whole: the same as it is.
        network: by which it talks.
        seed: of its random streams.
        announcements: what it tells the others, and when.
        clock: its own.
    """

    def __init__(
        self,
        pursuer: int,
        env: Clock,
        world: PursuerView,
        whole: GlobalState,
        network: Network,
        seed: int,
        announcements: Announcements,
        clock: NodeClock,
    ):
        self.id = pursuer
        self.rng = stream(seed, "decisions", pursuer)
        self.global_state = whole
        self._env, self._world, self._network, self._seed = env, world, network, seed
        self._announcements = announcements
        self._turn = int(Phase.DECISION) + pursuer  # its priority among the events of one instant
        self._clock = clock
        self._said = AnnouncementState((self.action,) if self._announcements.warm_start else None)
        self._beliefs = Beliefs(pursuer, self._clock, world, network, self._announcements, self.announcement)
        self._streams: dict[str, np.random.Generator] = {}

    def in_phase(self, phase: Phase) -> Self:
        """Return the same pursuer, for a process whose turn comes in another phase of an instant."""
        other = copy(self)
        other._turn = int(phase) + self.id
        return other

    def recovered(self, *, restarted: bool) -> None:
        """Take note that it was broken: what it said last may not have gone out."""
        self._said.news = None
        if restarted:
            self._said.payload = None
            self._said.restarts += 1

    # What it knows.

    @property
    def restarts(self) -> int:
        """How often it has started anew, without memory."""
        return self._said.restarts

    @property
    def now(self) -> float:
        """The time on its own clock, s: offset + (1 + drift) t."""
        return self._clock.now

    @property
    def team_size(self) -> int:
        """How many pursuers there are."""
        return self._world.size

    @property
    def action(self) -> int:
        """Which evader it chases, 1 .. M, or 0 if it stays."""
        return self._world.action(self.id)

    def evaders(self) -> Sequence[int]:
        """Return the evaders that have not been captured."""
        return self._world.evaders()

    def options(self) -> Sequence[int]:
        """Return the actions that it may choose: 0, and each evader that it may chase (`Scenario.prune`)."""
        return self._world.options(self.id)

    def has_choice(self) -> bool:
        """Return whether it has a choice at all."""
        return len(self._world.options(self.id)) > 1

    @property
    def evader_count(self) -> int:
        """How many evaders there were at first, M."""
        return self._world.evader_count

    def capture_time(self, evader: int = 1) -> float:
        """Return its own time of capture phi_i of an evader, s."""
        (time,) = self._world.capture_times_of([self.id], evader)
        return time

    def time_left(self, ahead: float = 0.0) -> float:
        """Return the time left to the horizon by its own clock, r, s; now, or what will be left so much later (s)."""
        return self._world.time_left(self._clock.stamp + nanoseconds(ahead))

    def may_chase(self, evader: int = 1) -> bool:
        """Return whether it has the choice to chase an evader (`Scenario.prune`)."""
        return self._world.may_chase(self.id, evader)

    def place(self) -> complex:
        """Return its own position, m."""
        return self._world.place(self.id)

    @property
    def speed(self) -> float:
        """How fast it moves if it does, m/s."""
        return self._world.speed(self.id)

    def evader(self, evader: int = 1) -> complex:
        """Return the position of an evader, m."""
        return self._world.evader(evader)

    @property
    def radius(self) -> float:
        """The distance eps at which the evader is captured, m."""
        return self._world.radius

    def latest_records(self) -> Table:
        """Return the newest announcement that has arrived from each teammate."""
        return self._beliefs.latest_records()

    def believed_chasers(self, evader: int = 1) -> dict[int, float]:
        """Return the teammates that it believes to chase an evader, and the times of capture it believes them to have.

        Whose last word arrived longer ago than `belief_timeout` is not believed active. Times in s; nan if not told.
        """
        _, rivals, times = self._beliefs.rivals(evader)
        return dict(zip(rivals, times, strict=True))

    def believed_active(self, evader: int = 1) -> list[int]:
        """Return the teammates that it believes to chase an evader; see `believed`."""
        return self._beliefs.rivals(evader)[1]

    def beliefs(self, period: float | None = None, evader: int = 1, orders: Orders = UNORDERED) -> dict[int, Belief]:
        """Return what it believes of each teammate whose last word arrived no longer ago than `belief_timeout`.

        Args:
            period: time between two words of a teammate, if it is not the heartbeat that brings them, s.
            evader: to which times of capture belong.
            orders: what teammates have been ordered to do: who tells its position is reckoned on by these, not as if it
                went on as it said.
        """
        return self._beliefs.all(period, evader, orders)

    def trusted(self) -> dict[int, Record]:
        """Return the newest announcement of each teammate, if it arrived no longer ago than `belief_timeout`."""
        return self._beliefs.trusted()

    def team_estimate(self, evader: int = 1) -> TeamEstimate:
        """Return where it believes itself and its teammates to be: as it senses them, or as far as they have told it.

        Who moves is reckoned on from what it said (`announce.reckoning`); see also `trusted`. Times of capture are of
        the evader that is asked for.
        """
        return self._beliefs.team_estimate(evader)

    @property
    def senses_others(self) -> bool:
        """Whether it senses where its teammates are, so that they need not say it."""
        return self._beliefs.senses_others

    def gain(self, utility: Utility = PAPER, evader: int = 1) -> float:
        """Return what it gains by chasing an evader, given who it believes does, s; see `desim.pursuit.game.gain`."""
        own, rivals, times = self._beliefs.rivals(evader)
        counted_teammates = None if utility.scope == "heard" else self.counted_teammates(utility.scope)
        others = [
            phi
            for j, phi in zip(rivals, times, strict=True)
            if phi < inf and (counted_teammates is None or j in counted_teammates)
        ]
        return utility(own, others, self.time_left())

    def neighbours(self, of: int | None = None) -> list[int]:
        """Return who hears it now, or who hears a teammate, as its radio would find out."""
        return self._network.neighbours(self.id if of is None else of)

    @property
    def mean_degree(self) -> float:
        """How many hear a pursuer, averaged over the team as of the first time that somebody asks."""
        return self._network.mean_degree

    def counted_teammates(self, scope: Scope) -> Collection[int]:
        """Return the teammates whose actions count: all that it hears of, or those it hears at one hop, or at several.

        Who is near is known if positions are sensed; if not, all those count of whom it has word.
        """
        if scope == "heard" or not self.senses_others:
            return range(self.team_size)
        return self._network.audible(self.id) if scope == "neighbours" else self._network.component(self.id)

    @property
    def latency(self) -> float:
        """The mean one-way latency L of the network, s: what its designer would know.

        Processing at both ends is included, airtime and queues are not.
        """
        return self._network.typical_latency

    def airtime(self, body: Any) -> float:
        """Return how long a message keeps the transmitter busy, s."""
        return self._network.airtime(body)

    def stream(self, name: str) -> np.random.Generator:
        """Return a random stream of its own; asked for again, also after a restart, it goes on."""
        if name not in self._streams:
            self._streams[name] = stream(self._seed, name, self.id)
        return self._streams[name]

    def shared_stream(self, name: str) -> np.random.Generator:
        """Return a random stream that is the same for everyone who asks for it by this name."""
        return stream(self._seed, f"shared {name}")

    # What it does.

    def assign(self, action: int) -> None:
        """Chase an evader (its number) or stay (0) from now on.

        Who may not chase it (`Scenario.prune`) stays whatever it wants.
        """
        self._world.set_action(self.id, action)

    def announce(self) -> None:
        """Tell the others its action after a revision, if that is a time to tell it (`announce.trigger`)."""
        trigger = self._announcements.trigger
        if trigger == "revision" or (trigger in {"change", "both"} and self._news() != self._said.news):
            self.broadcast()

    def broadcast(self) -> None:
        """Tell the others its action, whether or not it has changed."""
        self._said.news = self._news()
        self._announcements.dissemination.broadcast(self, self.announcement())

    def set_payload(self, body: Any) -> None:
        """From now on announce this in place of the payload.

        Its attribute `active` is to be the action, its attribute `news` what must change for it to be told at once.
        """
        self._said.payload = body

    def set_initial_belief(self) -> None:
        """Let everyone know its action from the start."""
        self._network.set_initial_belief(self.id, self.announcement(), self._clock.stamp)

    def announcement(self) -> Any:
        """Return what it would announce now."""
        claim = self._said.payload
        return PAYLOADS[self._announcements.payload].said_by(self.id, self._world) if claim is None else claim

    def located(self) -> LocatedAssignment:
        """Return what it would announce now if the payload were "state"."""
        return LocatedAssignment.said_by(self.id, self._world)

    def record(self, body: Any) -> Record:
        """Return the next record of its own, for who spreads it by other means than `publish`."""
        return self._network.next_record(self.id, body, self._clock.stamp)

    def publish(self, body: Any) -> None:
        """Announce something to the neighbours, as state: they read it when they next look.

        They share it as it is now, see `send`.
        """
        self._network.publish(self.id, body, sent=self._clock.stamp)

    def merge_records(self, records: Iterable[Record]) -> None:
        """Take note of records that reached it inside a message; older ones never replace newer ones."""
        for record in records:
            self._network.insert(self.id, record)

    def send(self, dst: int | None, body: Any, port: str = "") -> None:
        """Send a message to a teammate, or to all neighbours (None); ports keep different talks apart.

        The body is sent as it is now: what is done to a list, a dict or an array afterwards changes nothing on the way.
        All receivers get the same object, which they must not change; a tuple or a NamedTuple is never copied.

        Raises:
            ValueError: if it is for itself, or there is no such teammate.
        """
        self._network.send(self.id, dst, body, port=port)

    def mail(self, port: str = "") -> list[Message]:
        """Return the messages that have arrived at a port and not been read."""
        return self._network.inbox(self.id, port).drain()

    # What it waits for.

    def at(self, time: float) -> simpy.Event:
        """Return an event at a time on its own clock, s, to the nearest nanosecond; now, if that has passed.

        Raises:
            ValueError: if it is infinite or no number.
        """
        try:
            return Instant(self._env, max(self._clock.when(time), self._env.now), self._turn)
        except (OverflowError, ValueError) as error:
            raise ValueError(f"pursuer {self.id}: at({time}): the time should be finite, s{NEVER}") from error

    def sleep(self, duration: float) -> simpy.Event:
        """Return an event a duration from now, by its own clock, s.

        Raises:
            ValueError: if it is negative, infinite or no number.
        """
        try:
            return Instant(self._env, self._env.now + self._clock.span(duration), self._turn)
        except (OverflowError, ValueError) as error:
            told = f"pursuer {self.id}: sleep({duration}): the duration should be finite and at least 0 s{NEVER}"
            raise ValueError(told) from error

    def after(self, duration: float, act: Callable[[], object]) -> None:
        """Do something a duration from now, by its own clock, s, without waiting for it, unless it starts anew."""
        life = self.restarts

        def happen(_: simpy.Event) -> None:
            if self.restarts == life:
                act()

        self.sleep(duration).callbacks.append(happen)

    def after_decisions(self) -> simpy.Event:
        """Return an event at this very instant, when everybody has decided who decides at it."""
        return Instant(self._env, self._env.now, int(Phase.HEARTBEAT) + self.id)

    def arrival(self, port: str = "") -> simpy.Event:
        """Return an event that happens as soon as there is mail."""
        return self._network.inbox(self.id, port).arrival(self._turn)

    def repeat(self, act: Callable[[], object], period: float, name: str) -> Process:
        """Do something every period (s) of its own clock, from a random phase on, which the stream of a name gives."""
        first = self.now + self.stream(name).uniform(0.0, period)
        for k in count():
            yield self.at(first + k * period)
            act()

    # How it speaks.

    def _news(self) -> Any:
        """Return what must change for an announcement to be made at once."""
        return (self.action,) if self._said.payload is None else self._said.payload.news


Behaviour = Callable[[Agent], Process]
"""A protocol: the process that a pursuer runs."""

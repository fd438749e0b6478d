"""A live node: the protocol of one pursuer in an asyncio program, with a UDP socket for its network.

```python
node = Node(load("relay.toml"), pursuer=0)
async with node.open(("127.0.0.1", 9000), peers):
    while not node.is_over:
        node.sense(position, evaders=[evader])
        drive(node.velocity())
        await asyncio.sleep(0.05)
```
"""

import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from contextlib import ExitStack, asynccontextmanager, suppress
from functools import partial
from itertools import zip_longest
from math import inf
from typing import Any

import numpy as np

from desim.config.arguments import scenario_argument, value_text
from desim.config.arrays import Floats, Integers, Points, array_of
from desim.config.calls import check_argument
from desim.config.fresh import fresh_copy
from desim.config.model import MAX_COORDINATE
from desim.config.number_texts import counted
from desim.config.python_numbers import whole
from desim.kernel.clock_sync import Synchroniser, TwoWay
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Trace, TransportCounts
from desim.kernel.core.message_body import as_sent
from desim.kernel.core.positions import Nodes
from desim.kernel.core.seeds import seed_of
from desim.kernel.core.units import nanoseconds, seconds
from desim.kernel.fault_injection import inject
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.models.links import Links
from desim.kernel.state.network_state import NetworkState
from desim.live.frames import Mirror, WorldFrame, frame_of, hex_digits, segment_list
from desim.live.link import SocketLinkLayer
from desim.live.refusals import check_live, clocks_differ
from desim.live.sockets import Datagrams, Mailbox, checked_address, family_of, resolved, udp_socket
from desim.live.start import Address
from desim.live.wall_clock import Lateness, WallClock
from desim.live.wire import Wire, is_record
from desim.pursuit.core.traits import DisseminationTraits
from desim.pursuit.motion.dead_reckoning import TrackSegment
from desim.pursuit.sensing.views import GlobalState, View
from desim.pursuit.sensing.world_state import WorldState
from desim.pursuit.team.agent import Agent
from desim.scenario.scenario import Scenario
from desim.simulation.team_processes import TeamProcesses
from desim.simulation.wiring import PursuerPositions, make_agents, make_network
from desim.simulation.world import initial_state, make_steering, possible_action
from protocols.dissemination import PORT as ANNOUNCEMENTS

MAX_UNREAD = 256
"""Largest number of datagrams that wait, during the run, until the clock goes on."""
DRAIN = 0.02
"""Time, s, for which a node reads its socket after the end, so that the fates of the last messages are known."""


class Node:
    """The protocol of one pursuer, live: positions go in, actions and velocities come out.

    The protocol, its schedule, its dissemination and its transport run unchanged, in the time of the wall clock.
    Messages travel as datagrams between the sockets of the nodes. The receiver of a datagram draws its loss and its
    latency from the models of the scenario (`desim.live.link`).

    Args:
        scenario: the experiment. All nodes have the same.
        pursuer: the number of this pursuer.
        seed: seed of the random streams; None: the seed of the scenario. All nodes have the same.
        draws: whether losses and latencies are drawn from the models of the scenario; False: the links between the
            sockets are the real ones.
        on_action: called with each action that the protocol chooses.

    Raises:
        TypeError: if `scenario` is no scenario; the message says what to write instead.
        ValueError: if the scenario cannot run live, has no such pursuer, or `on_action` cannot take an action.

    Attributes:
        pursuer: see above.
        trace: the events of this node, but not its messages.
        link: the link layer of the node, with what it has sent, received and dropped.
    """

    def __init__(
        self,
        scenario: Scenario,
        pursuer: int,
        seed: int | None = None,
        *,
        draws: bool = True,
        on_action: Callable[[int], object] | None = None,
    ):
        scenario_argument(Scenario).check(scenario, "Node")
        check_live(scenario)
        pursuer = whole(pursuer, "pursuer")
        if not 0 <= pursuer < scenario.team.count:
            raise ValueError(f"there is no pursuer {pursuer}: they are 0 .. {scenario.team.count - 1}")
        if not isinstance(draws, bool | np.bool_):  # "no" would count as true
            raise ValueError(f"draws should be True or False (got {value_text(draws)})")
        if on_action is not None:
            check_argument(on_action, ("action",), "on_action")
        self._fresh = ExitStack()
        """Ends the use of a fresh copy of the scenario, whose objects may have state."""
        scenario = self._fresh.enter_context(fresh_copy(scenario))
        self.pursuer, self._on_action = pursuer, on_action
        self._horizon = nanoseconds(scenario.horizon)
        self._env = env = Clock()
        self._seed = seed = scenario.seed if seed is None else seed_of(seed)
        self._scenario, self._state = scenario, (state := initial_state(env, scenario, seed))
        self._mirror, self._steering = Mirror(state, pursuer), make_steering(scenario, state)
        self.trace = Trace()
        self._unread: list[tuple[bytes, int | None, int | None]] = []
        """Datagrams, the pursuers that sent them, and when they arrived, ns.

        The sender is None if its address is that of no pursuer, and the time is None before the start.
        """
        self._datagrams: Datagrams | None = None
        self._family: int = socket.AF_UNSPEC
        """The family of the address of the node's socket."""
        self._mailbox: Mailbox | None = None
        self._peers: list[Address] = []
        self._mailboxes: list[Address] = []
        """The addresses of the sockets at which the pursuers receive records."""
        self._number_of: dict[Address, int] = {}
        self._wire = Wire.of(scenario)
        self._agent = self._make_agent(draws=draws)
        self.clock: WallClock | None = None
        self._over = env.event()
        Instant(env, self._horizon, Phase.SAMPLE + 1).callbacks.append(lambda _: self.stop())

    def _make_agent(self, *, draws: bool) -> Agent:
        """Create the network and the agent of the pursuer, as `desim.simulation.run` does, and start its processes.

        This also sets the link layer, the network, the positions and the view.
        """
        scenario, state, env, seed, me = self._scenario, self._state, self._env, self._seed, self.pursuer

        def link_layer(net: NetworkState, links: Links, sampler: LinkSampler, *rest: Any) -> SocketLinkLayer:
            sampler = sampler.renamed(f"live {me} ")  # each receiver draws from streams of its own
            wire, post = self._wire, self._post
            self.link = SocketLinkLayer(net, links, sampler, *rest, node=me, wire=wire, post=post, draws=draws)
            return self.link

        self._positions = _ToldPositions(state, me)
        built = make_network(env, scenario, state, seed, self.trace, link_layer, positions=self._positions)
        network, clocks, faults = built
        self._network = network
        transport: Any = DisseminationTraits.of(scenario.announce.dissemination).transport
        network.listen({} if transport is None else {ANNOUNCEMENTS: transport})
        self.link.trusts_stamps = not clocks_differ(scenario)
        if isinstance(sync := scenario.clocks.sync, TwoWay):
            synchroniser = Synchroniser(env, network, clocks, sync, seed, self.trace, nodes=[me])
            synchroniser.answered = self._wire.answered  # the datagram of an answer has the time t3, too
        self._view = View(state, scenario.prune)
        global_state = GlobalState(state, scenario.prune, self._set_action)
        agents, judges = make_agents(env, scenario, seed, built, [self._view] * state.size, global_state, self.trace)
        self._team = team = TeamProcesses(env, scenario, _CrashingRobot(self), {me: agents[me]}, judges, None, None)
        inject(faults, env, network, crashed=team.crashed, recovered=team.recovered)
        team.begin()
        # The first use of these attributes imports and computes, which would delay the timers during the run.
        _, _ = agents[me].latency, agents[me].mean_degree
        as_sent(agents[me].announcement())
        return agents[me]

    def _set_action(self, pursuer: int, action: int) -> None:
        """Let the pursuer perform the action that its protocol has chosen."""
        action = possible_action(self._view, pursuer, action)
        self._mirror.orders += 1
        if action != self._state.profile[pursuer]:
            self._mirror.set_action(action)
        if self._on_action is not None:
            self._on_action(action)

    # The sockets and the run.

    @asynccontextmanager
    async def open(
        self, address: Address, peers: Sequence[Address] = (), now: Callable[[], int] | None = None
    ) -> AsyncIterator["Node"]:
        """Listen at an address, and run the protocol until the block ends.

        Args:
            address: the host and the port of this node; port 0: a free one.
            peers: (N,) the addresses of all pursuers, in order; the address of this pursuer is not used.
            now: returns the time since the start of the run, ns, which all nodes should have in common; None: this node
                starts now. See docs/howto/live.md, "Clocks".

        Raises:
            ValueError: if an address is not a host and a port, or `now` does not return an integer; see also `connect`.
            OSError: if the address cannot be used.
            RuntimeError: if the node has been opened before.
            BaseException: any exception of the protocol.
        """
        if self.clock is not None:
            raise RuntimeError("a node runs once: create another one")
        with self._fresh:
            _check_time(now)
            self._family = family_of(checked_address(address))
            if peers:
                self.connect(peers)
            self.bind(udp_socket(checked_address(address)))
            running = asyncio.create_task(self.run(now))
            try:
                yield self
            finally:
                self.stop()
                await running

    def bind(self, bound: socket.socket) -> Address:
        """Listen on a socket; return its address."""
        self._datagrams, self._family = Datagrams(bound, self.arrived), bound.family
        return self._datagrams.address

    def bind_mailbox(self, bound: socket.socket) -> Address | None:
        """Take records at another socket, which does not wake the event loop; return its address.

        Return None, and close the socket, if a process may have to see a record as soon as it arrives, or if the system
        does not stamp datagrams on arrival.
        """
        if self.link.delivery.is_certain:
            with suppress(OSError):
                self._mailbox = Mailbox(bound)
                return self._mailbox.address
        bound.close()
        return None

    def connect(self, peers: Sequence[Address], mailboxes: Sequence[Address | None] = ()) -> None:
        """Name the addresses of all pursuers, in order.

        Args:
            peers: the addresses of their sockets.
            mailboxes: the addresses at which they take records; None, or missing: those of `peers`.

        Raises:
            ValueError: if an address is not a host and a port, two are equal, or there are more or fewer addresses than
                pursuers.
            OSError: if a host is not known, or has no address of the family, IPv4 or IPv6, of the node's socket.
        """
        addresses = [checked_address(peer) for peer in peers]
        if len(peers) != self._state.size:
            raise ValueError(
                f"peers should be the addresses of {counted(self._state.size, 'pursuer')} (got {len(peers)})"
            )
        self._peers = [
            peer if number == self.pursuer else resolved(peer, self._family) for number, peer in enumerate(addresses)
        ]
        self._number_of = {peer: number for number, peer in enumerate(self._peers)}
        if len(self._number_of) < len(self._peers):  # the sender of a datagram would not be known
            raise ValueError(f"peers should be different addresses (got {value_text(peers)})")
        self._mailboxes = [box or peer for box, peer in zip_longest(mailboxes, self._peers)]

    async def run(self, now: Callable[[], int] | None = None) -> None:
        """Run the protocol until `stop` is called, or the horizon is reached.

        Args:
            now: as for `open`.

        Raises:
            BaseException: any exception of the protocol.
        """
        _check_time(now)
        self.clock = WallClock(self._env, self._over, now, self._read)
        try:
            with self._team.closing():
                await self.clock.ended
                await asyncio.sleep(DRAIN)
                self._read()
        finally:
            self.stop()
            for bound in (self._datagrams, self._mailbox):
                if bound is not None:
                    bound.close()

    def stop(self, at: int | None = None) -> None:
        """End the run of this node, now or at a time.

        Args:
            at: end after all events up to this time, ns, also those that are overdue; None: end at once.
        """
        if at is not None:
            at = whole(at, "the time of the end, ns,")
            Instant(self._env, max(at, self._env.now), Phase.SAMPLE + 1).callbacks.append(lambda _: self.stop())
        elif not self._over.triggered:
            self._over.succeed()
        if self.clock is not None:
            self.clock.wake()

    @property
    def is_over(self) -> bool:
        """Whether the node has stopped, or the horizon is reached."""
        return self._over.triggered

    def _post(self, datagram: bytes, nodes: Iterable[int]) -> None:
        """Send a datagram to some nodes; before `bind` and `connect` it is dropped."""
        if self._datagrams is not None and self._peers:
            addresses = self._mailboxes if is_record(datagram) else self._peers
            self._datagrams.send(datagram, [addresses[node] for node in nodes])

    def arrived(self, datagram: bytes, address: Address) -> None:
        """Take a datagram from the socket.

        A record whose arrival is certain (`is_certain`) does not wake the clock. The clock reads such records together
        when it goes on, in a quarter of the time that waking for each one takes.
        """
        clock = self.clock
        self._unread.append((datagram, self._number_of.get(address), None if clock is None else clock.now()))
        can_wait = is_record(datagram) and self.link.delivery.is_certain and len(self._unread) < MAX_UNREAD
        if clock is not None and not can_wait:
            clock.meet()

    def _read(self) -> None:
        """Hand the datagrams that have arrived to the link layer."""
        assert self.clock is not None
        unread, self._unread = self._unread, []
        now, earliest = self.clock.now(), self._env.now  # the wall clock is below 0 until the run starts
        for datagram, sender, when in unread:
            self.link.receive(datagram, sender, max(now if when is None else when, earliest))
        if self._mailbox is not None:
            for datagram, address, age in self._mailbox.read():
                self.link.receive(datagram, self._number_of.get(address), max(now - age, earliest))

    # The robot: positions in, actions and velocities out.

    @property
    def action(self) -> int:
        """The evader that the pursuer chases, 1 .. M, or 0."""
        return self._agent.action

    @property
    def now(self) -> float:
        """The time of the last event, s since the start of the run. Calls such as `sense` are events, too."""
        return seconds(self._env.now)

    def follow(self, frame: WorldFrame) -> None:
        """Set the world to the state in a frame of the referee."""
        self._meet(partial(self._mirror.follow, frame))

    def sense(self, position: Any, evaders: Any, teammates: Any = None, velocities: Any = None) -> None:
        """Tell the node where the pursuer and the evaders are now.

        Between two calls, evaders go on at their velocities, and pursuers stand. Before the first call, all players
        are where a simulation begins. The first call may come before `open`.

        Args:
            position: [x, y] of the pursuer, m.
            evaders: (M, 2) positions of the evaders, m.
            teammates: (N, 2) positions of all pursuers, m, including this one. None: the pursuer senses no teammates,
                so `announce.payload` should be "time", "state" or "course", and no link may depend on positions.
            velocities: (M, 2) velocities of the evaders, m/s; None: they stand still until the next call.

        Raises:
            ValueError: if an argument has another shape, or is not finite; if there are no teammates although
                `announce.payload` is "action"; or if players of the scenario have inertia: their velocities and
                headings would have to be told, too.
        """
        state, scenario = self._state, self._scenario
        for key, players in (("team", [scenario.team]), ("evader", scenario.evaders)):
            if any(player.has_inertia for player in players):
                raise ValueError(
                    f"{key}.dynamics: capture times with inertia follow from how fast a player is, which a node of your"
                    ' own is not told; take "simple"'
                )
        place = _points("position", position, 2).item()
        team = None if teammates is None else _points("teammates", teammates, state.size, 2)
        evader_places = _points("evaders", evaders, state.evader_count, 2)
        evader_velocities = None if velocities is None else _points("velocities", velocities, state.evader_count, 2)
        if team is None and state.size > 1 and self._agent.senses_others:
            raise ValueError(
                "teammates should be the positions of all pursuers: with announce.payload = 'action' a pursuer senses"
                " where its teammates are; a robot that does not needs 'time' or 'state'"
            )
        self._meet(partial(self._sense, place, team, evader_places, evader_velocities))

    def _sense(self, place: complex, team: Points | None, evaders: Points, velocities: Points | None) -> None:
        """Set the positions and velocities of the players; for the arguments see `sense`."""
        state, now = self._state, self._env.now
        places = state.players.positions().copy()
        self._positions.are_told = team is not None or state.size == 1
        commands = np.zeros_like(places)
        if team is not None:
            places[: state.size] = team
        places[self.pursuer], places[state.size :] = place, evaders
        if velocities is not None:
            commands[state.size :] = velocities
        end = min(now + nanoseconds(self._scenario.motion.step), self._horizon)
        pairs = zip(evaders.tolist(), commands[state.size :].tolist(), strict=True)
        segments = [segment_list(TrackSegment(now, evader, evader, velocity, end)) for evader, velocity in pairs]
        frame = frame_of(state, [self._mirror.orders] * state.size)
        self._mirror.follow(frame._replace(places=hex_digits(places), commands=hex_digits(commands), segments=segments))

    def captured(self, evader: int) -> None:
        """Tell the node that an evader has been captured.

        Raises:
            ValueError: if there is no such evader.
        """
        body = self._state.body(evader)
        if body.captured is None:
            self._meet(partial(self._state.capture, body))

    def velocity(self) -> list[float]:
        """Return the velocity that the pursuer should command now, [vx, vy], m/s.

        The guidance of the scenario gives it, along the shortest path among walls and relative to the flow. Call this
        at least once per `motion.step`: otherwise the robot may run past the corner of a wall.
        """
        self._meet()
        state, action = self._state, self.action
        if not action:
            return [0.0, 0.0]
        until = state.now + nanoseconds(self._scenario.motion.step)
        velocity = self._steering.chasing_velocity(self.pursuer, action, state.now, until)
        return [velocity.real, velocity.imag]

    def _meet(self, act: Callable[[], object] = lambda: None) -> None:
        """Call a function as an event of the present; before the start, at time 0."""
        if self.clock is None:
            act()
        else:
            self.clock.meet(act)

    # Counts of the run so far.

    def lateness(self) -> Lateness:
        """Return how late the timers of the node have been so far."""
        return Lateness.of([] if self.clock is None else self.clock.lateness)

    def transport_counts(self) -> TransportCounts | None:
        """Return the counts of transports up to now; None if no message has needed a transport."""
        counts = self._network.transport_counts()
        return counts if counts is not None and counts.submitted + counts.delivered else None


class _CrashingRobot:
    """Takes the robot down and up again in the node's own state of the world, at scheduled crashes.

    `TeamProcesses` gets this object in place of the world. The referee takes down the true robot.
    """

    def __init__(self, node: Node):
        self._node = node

    def crash(self, pursuer: int) -> None:
        if pursuer == self._node.pursuer:
            self._node._state.broken[pursuer] = True
            self._node._mirror.set_action(0)

    def recover(self, pursuer: int) -> None:
        self._node._state.broken[pursuer] = False


class _ToldPositions(PursuerPositions):
    """The positions of pursuers, as frames or robots tell them; a robot need not tell those of its teammates.

    Args:
        state: the state of the world.
        pursuer: the pursuer of this node, whose position is always told.

    Attributes:
        are_told: whether the positions of its teammates are told.
    """

    def __init__(self, state: WorldState, pursuer: int):
        super().__init__(state, inf)
        self.max_speed = inf  # told positions may jump, also in a static game
        self._pursuer, self.are_told = pursuer, True

    def __call__(self) -> Floats:
        """Return the (N, 2) positions now, m."""
        self._check(range(self._state.size))
        return super().__call__()

    def of(self, nodes: Nodes) -> Floats:
        """Return the (k, 2) positions of some pursuers now, m."""
        self._check(nodes)
        return super().of(nodes)

    def distance(self, node: int, other: int) -> float:
        """Return the present distance between two pursuers, m."""
        self._check((node, other))
        return super().distance(node, other)

    def at(self, nodes: Nodes, times: int | Integers) -> Floats:
        """Return the (k, 2) positions of some pursuers, m, at times of the present piece, ns."""
        self._check(nodes)
        return super().at(nodes, times)

    def _check(self, nodes: Iterable[int]) -> None:
        """Raise ValueError if the position of one of these nodes is not told."""
        if not self.are_told and any(node != self._pursuer for node in nodes):
            raise ValueError(
                f"pursuer {self._pursuer}: sense was given no teammates, and the network depends on where they are: by"
                " its range, its walls, jamming, or latencies or losses by distance"
            )


def _check_time(now: Any) -> None:
    """Raise ValueError if `now` is not a function without arguments, or does not return ns as an integer."""
    if now is not None:
        check_argument(now, (), "now")
        whole(now(), "what now returns, the time since the start of the run in ns,")


def _points(name: str, pairs: Any, *shape: int) -> Any:
    """Return positions or velocities of a shape, (2,) or (k, 2), as complex numbers."""
    array = array_of(pairs)
    is_wrong = array.shape != shape or array.dtype.kind not in "iuf"
    if is_wrong or not (np.abs(array) <= MAX_COORDINATE).all():
        allowed = f"numbers of shape {shape}, at most {MAX_COORDINATE:g} from 0"
        raise ValueError(f"{name} should be finite {allowed} (got {value_text(pairs)})")
    return array.astype(float, order="C").view(complex).ravel()

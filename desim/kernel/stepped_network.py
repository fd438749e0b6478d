"""A network that another program steps: the program moves the robots, the network carries their messages.

```python
from desim import Links, SteppedNetwork

network = SteppedNetwork(3, Links(latency=0.05, loss=0.1, range=10.0), seed=7, positions=x)
while simulating:
    for robot in range(3):
        network.send(robot, None, {"x": x[robot]})
    x += 0.02 * v
    for message in network.step(0.02, x):
        robots[message.dst].hear(message.src, message.body)
```

`Network` is for programs that run as processes of the clock of desim. A `SteppedNetwork` has its own clock, which only
`step` advances, and contains a `Network`, with the same links, faults and draws.
"""

from collections.abc import Callable, Hashable, Iterable, Mapping
from copy import deepcopy
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeVar

import numpy as np

from desim.config.arguments import naming_arguments, value_text
from desim.config.arrays import Floats
from desim.config.fresh import fresh_copy
from desim.config.model import MAX_TIME
from desim.config.number_texts import counted
from desim.config.python_numbers import real, whole
from desim.kernel.core.clock import NEVER, RARE_COLLECTION, Clock, Instant, Phase
from desim.kernel.core.events import Cause, MessageCounts, Trace, TransportCounts
from desim.kernel.core.message_body import own_copy
from desim.kernel.core.message_size import HEADER, size_of
from desim.kernel.core.ports import ReservedPort
from desim.kernel.core.seeds import seed_of
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.fault_injection import inject
from desim.kernel.models.clock_skew import is_skewed
from desim.kernel.models.fault_plans import draw_faults
from desim.kernel.models.faults import Crash
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Unlimited
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.kernel.models.transport import Transport
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState, Outage
from desim.kernel.state.message_queue import MessageQueue
from desim.kernel.state.transmission import Transmission
from desim.kernel.stepped_arguments import (
    faults_argument,
    horizon_argument,
    links_argument,
    nodes_argument,
    walls_argument,
)
from desim.kernel.stepped_positions import SteppedPositions
from desim.kernel.wandering_clock import node_clocks

if TYPE_CHECKING:
    import networkx as nx

SHOWN = 10
"""Number of nodes listed in an error message."""
CALLED = "a call is under way: a network belongs to one thread, and its watchers and models cannot call it"
FAILED = "a call has failed: call reset(seed)"
CLOSED = "the network is closed: create another one"
CONFIGURATION = ("_nodes", "_numbers", "_links", "_faults", "_horizon", "_can_leave", "_walls")
"""The attributes that all episodes of a network share."""
_new = tuple.__new__  # creates a named tuple in a third of the time
Result = TypeVar("Result")


class ReceivedMessage(NamedTuple):
    """A message that has arrived at a node."""

    src: Any
    """The node that sent it."""
    dst: Any
    """The node that it reached."""
    body: Any
    sent: float
    """When it was sent, s."""
    arrived: float
    """When it arrived, s; exact, also within a step."""
    port: str = ""


class LostMessage(NamedTuple):
    """A message that has not reached a node."""

    src: Any
    dst: Any
    body: Any
    sent: float
    """When it was sent, s."""
    cause: Cause
    """Why it was lost; see `desim.kernel.core.events.CAUSES`."""
    port: str = ""


class SteppedNetwork:
    """A network of robots for a simulator that has its own loop and moves the robots itself.

    `send` is for events, each of which matters: `step` returns the messages that have arrived. `publish` is for state,
    of which only the newest value matters: `latest` returns it, at half the cost. For the best and the worst network,
    use `Links()`, with which every message arrives at once, and `Links(loss=1.0)`, with which none arrives.

    Nodes are named by the labels of the graph, or 0 .. n - 1; faults name them by number, the index in `nodes`.
    Positions have a row for each node, in the order of `nodes`, or are a dict by node. They are read when they are
    given, and at each step; they may be changed in place. During a step every node moves in a straight line from its
    position at the beginning to that at the end.

    In a `with` block the network is closed at the end, and Python collects garbage less often, as in `desim.run`. This
    saves time if many messages are in flight.

    Equal arguments, calls and seeds give equal arrivals, on any machine. An instance belongs to one thread at a time.
    It can be pickled and copied only before its first message and step, when its arguments are its whole state.

    Args:
        nodes: number of nodes, or a networkx graph: its nodes have any labels, and its edges the attributes of
            `desim.kernel.models.graphs.Edge`.
        links: the models of the links, or a table `[network]` as a dict; an ideal network if None.
        faults: faults of nodes and links (`desim.kernel.models.faults`), plans that draw them (`fault_plans`), clock
            errors (`clock_skew`), or tables `[[fault]]` as dicts.
        seed: the seed of all random draws.
        positions: (n, 2) positions at the start, m, or a dict; needed for models that depend on them, such as a range.
        trace: receives the events of messages and faults, and shows them to its watchers.
        horizon: the time until which plans draw faults, s.
        can_leave: whether nodes may `leave` and `join`. Every arrival is then decided when it is due, which is slower.
        walls: walls, or tables `[[wall]]` as dicts; those that block radio weaken signals.

    Raises:
        ValueError: if an argument is not valid, or arguments do not fit together.
    """

    @naming_arguments
    def __init__(
        self,
        nodes: "int | nx.Graph[Any]",
        links: Links | Mapping[str, Any] | None = None,
        *,
        faults: Iterable[Any] = (),
        seed: int = 0,
        positions: Any = None,
        trace: Trace | None = None,
        horizon: float | None = None,
        can_leave: bool = False,
        walls: Iterable[Any] = (),
    ):
        self._links, self._nodes, self._numbers = nodes_argument(nodes, links_argument(links))
        self._faults, self._can_leave = faults_argument(faults), can_leave
        self._horizon, self._walls = horizon_argument(horizon, self._faults), walls_argument(walls)
        self._start(seed, positions, trace)

    def _start(self, seed: int, positions: Any, trace: Trace | None) -> None:
        """Create the network of an episode, at time 0; if an argument is wrong, nothing changes."""
        if not isinstance(trace, Trace | None):
            raise ValueError(f"trace should be a desim.kernel.core.events.Trace (got {value_text(trace)})")
        if trace is not None and trace.events:
            raise ValueError(f"trace has {counted(len(trace), 'event')} of another episode: give a new Trace()")
        if trace is not None and trace.is_taken:
            raise ValueError("trace belongs to another network, or to another episode of this one: give a new Trace()")
        seed, size, clock = seed_of(seed), len(self._nodes), Clock()
        source = SteppedPositions(clock, self._nodes)
        if positions is not None:
            source.place(positions)
        queue = MessageQueue(clock, size)
        with fresh_copy((self._links, self._faults)) as (links, entries):
            faults = draw_faults(entries, size, self._horizon / SECOND, seed)
            has_faults = bool(faults) or self._can_leave
            network = Network(
                clock,
                links.make_graph(size),
                links,
                seed=seed,
                positions=source,
                trace=trace,
                fault_state=FaultState(source, surprises=self._can_leave) if has_faults else None,
                clocks=node_clocks(clock, entries, size, seed, NEVER) if is_skewed(entries) else (),
                inboxes=lambda *_: queue,
                walls=self._walls,
            )
        inject(faults, clock, network, trace)
        clock.advance(0)  # faults from time 0 also concern messages that are sent before the first step
        network.watch_losses(self._lose)
        self._seed, self._trace, self._clock, self._positions = seed, trace, clock, source
        self._network, self._queue = network, queue
        self._losses: list[tuple[int, int, int, LostMessage]] = []
        """The losses of this step, each with its keys of order: time of sending, ns, transmission and receiver."""
        self._lost: list[LostMessage] = []
        self._away: dict[int, tuple[Crash, Outage]] = {}
        self._is_unused, self._problem = True, ""  # the problem: why no call is possible now, `CALLED` for instance
        self._is_unlimited = self._links.medium == Unlimited()
        self._lacks_positions = positions is None and not network.topology.is_static
        if trace is not None:
            trace.is_taken = True

    # Sending and stepping.

    def send(
        self,
        src: Hashable,
        dst: Hashable | None,
        body: Any,
        port: str = "",
        *,
        size: int | None = None,
        transport: Transport | None = None,
    ) -> None:
        """Send a message now to one node, or to all neighbours (None); a later `step` returns it for each receiver.

        Args:
            src: the sender.
            dst: the receiver; None: all neighbours.
            body: any object that can be copied. Each receiver gets a copy, unless it is immutable.
            port: a name by which the receiver tells kinds of messages apart.
            size: bytes; computed from the body if None, see `desim.kernel.core.message_size`. Over a medium without
                airtime, a body of unknown size, such as a function, counts 0 bytes.
            transport: the transport of the message, see `desim.kernel.models.transport`; None: that of the links.

        Raises:
            ValueError: as `Network.send`, or if a range has no positions; nothing has then changed. An exception of a
                watcher or a model is raised unchanged; the call has then failed: the message may be counted, not sent.
            RuntimeError: if the network is closed, a call is under way, or one has failed.
        """
        self.check_usable()
        if self._lacks_positions:
            self._positions()
        if self._numbers is not None:
            src, dst = self._number(src), None if dst is None else self._number(dst)
        if size is None and self._is_unlimited:
            size = _size_of(body)
        network = self._network
        accepted = network.accepted
        self._problem = CALLED
        try:
            network.send(src, dst, body, port, size=size, transport=transport)  # type: ignore[arg-type]
        except BaseException:
            self._problem = FAILED if network.accepted > accepted else ""
            raise
        self._problem, self._is_unused = "", False

    def publish(self, src: Hashable, body: Any, *, size: int | None = None) -> None:
        """Broadcast the state of a node now: each neighbour has it as `latest` from its arrival on.

        Arguments and errors are as in `send`.
        """
        self.check_usable()
        if self._lacks_positions:
            self._positions()
        if size is None and self._is_unlimited:
            size = _size_of(body)
        number: Any = src if self._numbers is None else self._number(src)
        network = self._network
        accepted = network.accepted
        self._problem = CALLED
        try:
            network.publish(number, body, size)
        except BaseException:
            self._problem = FAILED if network.accepted > accepted else ""
            raise
        self._problem, self._is_unused = "", False

    def step(self, dt: float, positions: Any = None) -> list[ReceivedMessage]:
        """Let time pass, and return the messages of `send` that have arrived, in the order of their arrival.

        Each is returned by the step in which it arrives; the end of a step is part of the step. Messages that arrive at
        one instant are in the order in which they were sent, then in that of their receivers.

        Args:
            dt: the duration, s; it is rounded to nanoseconds.
            positions: (n, 2) the positions at the end, m; None: those that the array given last contains now.

        Raises:
            ValueError: if dt is not a time from 1 ns to 1e9 s, or the positions are not finite numbers, (n, 2);
                the step is then not made.
            RuntimeError: if the network is closed, or a call is under way or has failed.
        """
        self.check_usable()
        clock, end = self._clock, self._end_of_step(dt)
        self._positions.begin_step(end, positions)
        self._lacks_positions &= self._positions.array is None
        self._is_unused = False
        with RARE_COLLECTION:
            arrived = self._call(self._run_until, Instant(clock, end, Phase.DECISION))
        self._lost = [lost for *_, lost in sorted(self._losses, key=itemgetter(0, 1, 2))]
        self._losses.clear()
        return arrived

    def _run_until(self, end: Instant) -> list[ReceivedMessage]:
        """Let time pass until an instant, and return the messages that have arrived."""
        self._clock.run(until=end)
        self._positions.end_step()
        self._network.settle()
        return self._received()

    def _end_of_step(self, dt: Any) -> int:
        """Return the end of the next step, ns; raise ValueError if there is none."""
        duration = real(dt, "dt")
        if not 0 < duration <= MAX_TIME or nanoseconds(duration) < 1:
            raise ValueError(f"dt should be a time from 1 ns to {MAX_TIME:g} s, in s (got {value_text(dt)})")
        if self.now + duration > MAX_TIME:
            raise ValueError(f"the time should be at most {MAX_TIME:g} s (got {self.now:g} s and dt = {duration:g} s)")
        return self._clock.now + nanoseconds(duration)

    def _received(self) -> list[ReceivedMessage]:
        """Remove and return the messages that have arrived."""
        kind, new, labels = ReceivedMessage, _new, self._nodes  # local names are faster
        return [
            new(kind, (labels[src], labels[dst], body, sent / SECOND, when / SECOND, port))
            for when, _, dst, (src, sent, body), port in self._queue.take()
        ]

    # What has arrived, and what has not.

    def latest(self, node: Hashable) -> dict[Any, ReceivedMessage]:
        """Return the newest state that a node has received from each other node, by source."""
        number, kind, new, labels = self._usable(node), ReceivedMessage, _new, self._nodes  # local names are faster
        dst = labels[number]
        return {
            (label := labels[src]): new(kind, (label, dst, body, sent / SECOND, when / SECOND, ""))
            for src, (when, (_, _, sent, body)) in self._call(self._network.latest_records, number).items()
        }

    def ages(self) -> Floats:
        """Return the (receivers, sources) ages of the newest states that have arrived, s.

        An age is the time since the state was published: inf if none has arrived, and 0 for the node's own.
        """
        self.check_usable()
        ages, now = np.full((len(self._nodes),) * 2, np.inf), self._clock.now
        np.fill_diagonal(ages, 0.0)
        for node in range(len(self._nodes)):
            for src, stamp in self._call(self._network.stamps, node).items():
                ages[node, src] = (now - stamp) / SECOND
        return ages

    def lost(self) -> list[LostMessage]:
        """Return the messages and states that were lost in the last step, or between it and the step before.

        They are in the order in which they were sent. The frames of a transport are not listed, because it may make up
        for their loss.
        """
        self.check_usable()
        return [lost._replace(body=own_copy(lost.body)) for lost in self._lost]

    def counts(self) -> MessageCounts:
        """Return the counts of messages up to now: sent = delivered + lost + in flight, per receiver."""
        self.check_usable()
        return self._call(self._network.message_counts)

    def transport_counts(self) -> TransportCounts | None:
        """Return the counts of transports up to now; None if no message has needed one."""
        self.check_usable()
        return self._network.transport_counts()

    def neighbours(self, node: Hashable) -> list[Any]:
        """Return the nodes that receive from a node where they are now."""
        number = self._usable(node)
        return [self._nodes[other] for other in self._network.topology.neighbours(number).tolist()]

    def _lose(self, transmission: Transmission, causes: Mapping[int, Cause]) -> None:
        """Note the losses of a transmission, unless it is a frame of the simulator itself."""
        number, src, created, *_ = transmission
        if isinstance(transmission.port, ReservedPort):
            return
        content, labels = transmission.content, self._nodes
        for dst, cause in causes.items():
            lost = labels[src], labels[dst], content.body, content.stamp / SECOND, cause, transmission.port
            self._losses.append((created, number, dst, LostMessage(*lost)))

    # Nodes.

    @property
    def nodes(self) -> tuple[Any, ...]:
        """The labels of the nodes, in the order of the rows of positions and ages."""
        return self._nodes

    def leave(self, node: Hashable) -> None:
        """Let a node leave now: it neither sends nor receives, and what is in flight to it is lost ("crash").

        Raises:
            ValueError: if it is away already, or the network was created without `can_leave`.
        """
        number = self._member(node)
        if number in self._away:
            raise ValueError(f"node {value_text(node)} is away already")
        crash = Crash(start=self.now, node=number, scope="radio", memory=False)
        self._is_unused = False
        if self._trace is not None:
            self._call(self._trace.append, FaultStarted(self._clock.now, crash))
        self._away[number] = crash, self._call(self._network.crash, number)

    def join(self, node: Hashable) -> None:
        """Let a node that has left join again now; it has received nothing yet.

        Raises:
            ValueError: if it is not away, or the network was created without `can_leave`.
        """
        number = self._member(node)
        if number not in self._away:
            raise ValueError(f"node {value_text(node)} is not away")
        crash, outage = self._away.pop(number)
        if self._trace is not None:
            self._call(self._trace.append, FaultEnded(self._clock.now, crash))
        self._call(partial(self._network.recover, number, outage, memory=False))

    def _member(self, node: Hashable) -> int:
        """Return the number of a node that may leave."""
        number = self._usable(node)
        if not self._can_leave:
            raise ValueError("nodes leave and join only if the network is created with can_leave=True")
        return number

    def _call(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Call a function that calls watchers and models; if it raises, the episode has failed."""
        self._problem = CALLED
        try:
            result = function(*arguments)
        except BaseException:
            self._problem = FAILED
            raise
        self._problem = ""
        return result

    def _usable(self, node: Any) -> int:
        """Return the number of a node; raise RuntimeError if the network is not usable (`check_usable`)."""
        self.check_usable()
        return self._number(node)

    def _number(self, node: Any) -> int:
        """Return the number of a node."""
        if self._numbers is None:
            number = node if type(node) is int else whole(node, "a node")
            if 0 <= number < len(self._nodes):
                return number
        else:
            try:
                return self._numbers[node]
            except (KeyError, TypeError):  # TypeError: the node is not hashable
                pass
        names = ", ".join(map(value_text, self._nodes[:SHOWN])) + (", ..." if len(self._nodes) > SHOWN else "")
        raise ValueError(f"there is no node {value_text(node)}: the nodes are {names}")

    # Time, reset and close.

    def check_usable(self) -> None:
        """Raise RuntimeError if the network is closed, a call is under way, or one has failed."""
        if self._problem:
            raise RuntimeError(self._problem)

    @property
    def now(self) -> float:
        """The time, s."""
        return self._clock.now / SECOND

    @property
    def trace(self) -> Trace | None:
        """The trace of this episode; None if there is none."""
        return self._trace

    def reset(self, seed: int, *, positions: Any = None, trace: Trace | None = None) -> None:
        """Begin anew at time 0, exactly as a new network with this seed would.

        Args:
            seed: the seed of all random draws.
            positions: (n, 2) positions at the start, m; None: those that the array given last contains now.
            trace: receives the events of the new episode; None: nothing is recorded.

        Raises:
            ValueError: if an argument is not valid; the episode then goes on.
            RuntimeError: if the network is closed, or a call is under way.
        """
        if self._problem in {CLOSED, CALLED}:
            raise RuntimeError(self._problem)
        array = self._positions.array if positions is None else positions
        last_episode = None if self._problem else (self._network, self._trace)
        problem, self._problem = self._problem, CALLED
        try:
            self._start(seed, array, trace)
        except BaseException:
            self._problem = problem
            raise
        if last_episode is not None:
            self._call(_finish, *last_episode)

    def close(self) -> None:
        """Append the final counts to the trace, and delete the network; a second call has no effect.

        Raises:
            RuntimeError: if a call is under way.
        """
        if self._problem == CLOSED:
            return
        if self._problem == CALLED:
            raise RuntimeError(CALLED)
        has_failed, self._problem, network = bool(self._problem), CLOSED, self._network
        del self._network, self._queue
        if not has_failed:
            _finish(network, self._trace)

    def __enter__(self) -> Self:
        RARE_COLLECTION.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        RARE_COLLECTION.__exit__()
        self.close()

    def __repr__(self) -> str:
        state = "closed" if self._problem == CLOSED else f"{self.now:g} s"
        return f"<SteppedNetwork of {counted(len(self._nodes), 'node')}, seed {self._seed}, {state}>"

    def __reduce__(self) -> Any:
        if not self._is_unused or self._problem:
            raise TypeError(
                "a SteppedNetwork can be pickled and copied before its first message and step only: its messages in"
                " flight are part of a running simulation. Copy it after reset(seed), or repeat its calls"
            )
        return _restored, (
            {name: getattr(self, name) for name in CONFIGURATION},
            (self._seed, self._positions.array, self._trace),
        )


def _restored(configuration: dict[str, Any], start: tuple[Any, ...]) -> SteppedNetwork:
    """Return a network at time 0, given what `SteppedNetwork.__reduce__` returns."""
    network = SteppedNetwork.__new__(SteppedNetwork)
    vars(network).update(configuration)
    seed, positions, trace = deepcopy(start)  # also for a shallow copy, because each network needs its own trace
    if trace is not None:
        trace.is_taken = False
    network._start(seed, positions, trace)
    return network


def _finish(network: Network, trace: Trace | None) -> None:
    """Append the final counts of an episode to its trace."""
    if trace is not None:
        if (transports := network.transport_counts()) is not None:
            trace.append(transports)
        trace.append(network.message_counts())
        trace.close()


def _size_of(body: Any) -> int:
    """Return the size of a message, bytes; that of its header if the body has none."""
    try:
        return size_of(body)
    except ValueError:
        return HEADER

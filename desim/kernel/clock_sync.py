"""Clock synchronisation: each node exchanges time stamps with a reference node, and corrects its clock.

In a two-way exchange (Mills 1991, "Internet Time Synchronization: The Network Time Protocol") the node sends a request
at t1 by its own clock. The reference receives it at t2 and answers at t3 by its clock, and the answer arrives at t4.

    offset of the reference = ((t2 - t1) + (t3 - t4)) / 2

The error is half the difference of the two latencies. For constant latencies it is constant. For independent latencies
of standard deviation s, the mean error of m exchanges has the standard deviation s / sqrt(2 m).

The messages travel over the links of the network, may be lost, and are never retransmitted, because a repetition would
carry an old stamp. The radio reads t1 and t3 as a transmission begins (hardware time stamps, as in IEEE 1588), so that
waiting for a busy channel or a slot adds no error. Request and answer have the same size, and so the same airtime.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import count
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from desim.config.choice import OneOf
from desim.config.model import Period, Value
from desim.kernel.core.clock import Clock, NodeClock, Phase, Timer
from desim.kernel.core.events import ClockCorrected, Trace
from desim.kernel.core.message_size import HEADER, NUMBER
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.ports import ReservedPort
from desim.kernel.core.records import Record
from desim.kernel.core.seeds import stream
from desim.kernel.models.transport import BEST_EFFORT
from desim.kernel.network import Network
from desim.kernel.state.inbox import Message

PORT = ReservedPort("clock synchronisation", __name__)
"""The port at which requests and answers arrive."""


class Unsynchronised(Value):
    """Clocks are never corrected, and no message is sent."""

    kind: Literal["none"] = "none"


class TwoWay(Value):
    """Each node asks a reference node for the time, and corrects its clock by the mean of several answers.

    The reference must be in range; a node that gets no answer keeps its clock. A correction is a step of the clock, and
    does not remove its drift, which accumulates until the next.
    """

    kind: Literal["two_way"] = "two_way"
    reference: Annotated[int, Field(ge=0, strict=True)] = 0
    """The node whose clock the others adopt."""
    interval: Period = 0.1
    """Time between two requests of a node, s.

    If in doubt, choose it so that `interval` times `exchanges` times the drift is less than the variation of the
    latency: the clock drifts while the answers are collected.
    """
    exchanges: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] = 8
    """Number m of answers that are averaged for a correction.

    If in doubt, 8: the error falls with the square root of m only, and the traffic grows with m.
    """


ClockSync = Unsynchronised | TwoWay
CLOCK_SYNCS = OneOf(Unsynchronised, TwoWay, is_closed=True)


class TimeRequest(NamedTuple):
    """Asks for the time."""

    number: int


class TimeAnswer(NamedTuple):
    """Answers a request."""

    number: int
    """The number of the request."""
    received: int
    """t2, ns, by the clock of the reference; the radio adds t3."""


SIZE = HEADER + 3 * NUMBER
"""Bytes of a request or an answer, t3 included; the request is padded."""
REMEMBERED = 64
"""Number of requests of a node that may await answers."""


class Synchroniser:
    """The synchronisation of all clocks of a network in one run.

    Args:
        env: the clock of the simulation.
        network: the network that carries the messages.
        clocks: the clocks of the nodes.
        model: the parameters.
        seed: the seed of the random phases of the requests.
        trace: receives the corrections; None if they are not needed.
        send: sends the messages; None: the network.
        nodes: the nodes that send and answer in this process; None: all.

    Attributes:
        answered: t3 of each answer on its way, ns, by the clock of the reference; the key is the answer, because a
            request that the network duplicates has two answers.
    """

    def __init__(
        self,
        env: Clock,
        network: Network,
        clocks: Sequence[NodeClock],
        model: TwoWay,
        seed: int,
        trace: Trace | None = None,
        send: Callable[..., None] | None = None,
        nodes: Iterable[int] | None = None,
    ):
        self._send_message = send or network.send
        self._env, self._clocks, self._model, self._trace = env, clocks, model, trace
        self._offsets: list[list[int]] = [[] for _ in clocks]
        """The offsets of the reference, ns, that each node has measured since its last correction."""
        self._numbers = count()
        self._asked: list[dict[int, int]] = [{} for _ in clocks]
        """By node and number of a request that may still be answered: its t1, ns, by the uncorrected clock."""
        self.answered: dict[TimeAnswer, int] = {}
        network.overhear(self._stamp)
        self._timers = [Timer(env, Phase.HEARTBEAT + node, partial(self._ask, node)) for node in range(len(clocks))]
        for node in range(len(clocks)) if nodes is None else nodes:
            clock = clocks[node]
            network.inbox(node, PORT).listen(Phase.DELIVERY + 1 + node, partial(self._receive, node))
            if node != model.reference:
                phase = stream(seed, "clock synchronisation", node).uniform(0.0, model.interval)
                self._timers[node].set(clock.span(phase))

    def _ask(self, node: int) -> None:
        """Send a request, and plan the next."""
        self._send(node, self._model.reference, TimeRequest(next(self._numbers)))
        self._timers[node].set(self._env.now + self._clocks[node].span(self._model.interval))

    def _send(self, src: int, dst: int, body: TimeRequest | TimeAnswer) -> None:
        self._send_message(src, dst, body, port=PORT, size=SIZE, transport=BEST_EFFORT)

    def _stamp(self, content: Record | Message, _: int) -> None:
        """Read the clock of the sender when the transmission of a request or an answer begins: t1 or t3."""
        body = content.body
        if isinstance(body, TimeRequest):
            asked = self._asked[content.src]
            asked[body.number] = self._clocks[content.src].uncorrected
            if len(asked) > REMEMBERED:
                del asked[next(iter(asked))]
        elif isinstance(body, TimeAnswer):
            self.answered[body] = self._clocks[content.src].stamp
            if len(self.answered) > REMEMBERED * len(self._clocks):
                del self.answered[next(iter(self.answered))]

    def _receive(self, node: int, messages: list[Message]) -> None:
        """Answer requests, and use answers."""
        for src, _, body in messages:
            if isinstance(body, TimeRequest):
                self._send(node, src, TimeAnswer(body.number, self._clocks[node].stamp))
            elif body.number in self._asked[node] and body in self.answered:
                self._use(node, self._asked[node].pop(body.number), body.received, self.answered.pop(body))

    def _use(self, node: int, sent: int, received: int, answered: int) -> None:
        """Measure the offset of the reference from t1, t2 and t3; correct the clock by the mean of enough offsets."""
        clock, offsets = self._clocks[node], self._offsets[node]
        # t1 and t4 are read without the correction, because the clock may be corrected between them.
        offsets.append((received - sent + answered - clock.uncorrected) // 2)
        if len(offsets) < self._model.exchanges:
            return
        clock.correct(round(portable_sum(offsets) / len(offsets)))
        offsets.clear()
        if self._trace is not None:
            self._trace.append(ClockCorrected(self._env.now, node, clock.correction))

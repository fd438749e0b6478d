"""Sampling of the losses, duplicates and arrival times of each transmission from the link models.

A model whose draws are independent of the link is sampled in blocks: a broadcast then takes a slice of a list instead
of calling numpy.

Kept equal to draws link by link by
`tests/kernel/test_propagation.py::test_losses_are_those_of_a_plain_model_that_draws_link_by_link`.
"""

from collections.abc import Iterator, Mapping
from itertools import compress
from math import inf
from operator import or_
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from desim.kernel.core.events import Cause
from desim.kernel.core.link_context import CalledModels, LinkContext
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.positions import PositionFunction, PositionSource
from desim.kernel.core.records import Arrival, per_receiver
from desim.kernel.core.seeds import ROOM, stream
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.models.latency import Constant, mean_of
from desim.kernel.models.link_draws import as_booleans, as_nanoseconds, booleans_of, buffered, times_of
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli, Bursts
from desim.kernel.models.own_links import link_misfits, link_overrides, overrides_of_run
from desim.kernel.models.traits import LinkTraits, link_trait, model_of_run

if TYPE_CHECKING:
    import networkx as nx
    from numpy.typing import NDArray

_Model = TypeVar("_Model")
TYPICAL_SIZE = 48
"""Size of a message that `typical_latency` assumes, bytes."""
GOLDEN = 0.6180339887498949
"""The fractional part of the golden ratio. Any number of its first multiples, modulo 1, spreads evenly over [0, 1)."""


class LinkSampler:
    """Sampler of the latencies and losses of one run.

    Args:
        links: the link models.
        graph: the communication graph, whose edges may have their own models.
        seed: the seed of the random streams.
        positions: the current positions of the nodes, for models that depend on distance.
        purpose: a prefix of the names of the random streams.

    Raises:
        ValueError: if `links.link` names a link that is not in the graph, an edge attribute is invalid, or a model does
            not apply to a link.
    """

    def __init__(
        self, links: Links, graph: "nx.Graph[int]", seed: int, positions: PositionFunction | None, purpose: str = ""
    ):
        size = len(graph)
        self._links, self._graph = links, graph
        self._seed, self._positions = seed, positions
        self._called = CalledModels(size)
        sender = links.processing.sender
        at_sender = nanoseconds(sender.value) if type(sender) is Constant and not links.delays_start else 0
        self.processing = at_sender + nanoseconds(links.processing.receiver)
        """Processing delay at the receiver, ns, plus that at the sender unless it delays the start of transmissions."""
        self._latency, self._loss = model_of_run(links.latency, size), model_of_run(links.loss, size)
        names = ("latency", "loss", "latency of own links", "loss of own links")
        streams = [stream(seed, purpose + name) for name in names]
        self._latency_rng, self._loss_rng, self._override_latency_rng, self._override_loss_rng = streams
        self._duplicate, self._duplicate_rng = model_of_run(links.duplicate, size), stream(seed, purpose + "duplicate")
        self.duplicates_messages = not _never_loses(links.duplicate)
        """Whether messages may be transmitted twice."""
        self._latency_buffer = buffered(self._latency, self._latency_rng, as_nanoseconds)
        self._loss_buffer = buffered(self._loss, self._loss_rng, as_booleans)
        self._bursts: Bursts | None = self._loss if type(self._loss) is Bursts else None  # is fast for one receiver
        overrides = link_overrides(links, graph)
        self._latency_overrides = overrides_of_run(overrides["latency"], size)
        self._loss_overrides = overrides_of_run(overrides["loss"], size)
        self._order, self._order_overrides = links.order, overrides["order"]
        for place, reason in link_misfits(links, graph):
            raise ValueError(f"{'.'.join(map(str, place))}: {reason}")
        self._is_lost = link_trait(self._latency, "is_lost")
        self._is_lost_overrides = {
            src: {dst: link_trait(model, "is_lost") for dst, model in by_dst.items()}
            for src, by_dst in self._latency_overrides.items()
        }
        self._nodes = np.arange(size)
        """(n,) all nodes; a slice of this array costs less than a new one."""
        self._nodes.setflags(write=False)
        self._receivers: dict[int, _Receivers] = {}
        """By sender, its last list of receivers as arrays, which have at most `ROOM` entries in all."""
        self._lists_are_kept = links.range == inf or links.range_check == "delivery"
        """Whether the broadcasts of a sender may share a list of receivers: no range is checked at transmission."""
        self._last: dict[tuple[int, int], int] = {}  # latest arrival (ns) on each FIFO link
        self._lossless = _never_loses(links.loss)
        self._cause = LinkTraits.of(links.loss).cause
        self._cause_overrides = {
            src: {dst: LinkTraits.of(model).cause for dst, model in by_dst.items()}
            for src, by_dst in overrides["loss"].items()
        }
        loss_models = (model for by_dst in self._loss_overrides.values() for model in by_dst.values())
        is_lost_of_links = [is_lost for by_dst in self._is_lost_overrides.values() for is_lost in by_dst.values()]
        self._latency_loses = any(is_lost is not None for is_lost in (self._is_lost, *is_lost_of_links))
        """Whether a latency model may lose messages."""
        self.lossless = self._lossless and not self._latency_loses and all(map(_never_loses, loss_models))
        """Whether the link models are known never to lose a message."""
        # With one constant latency, no latency model needs to be sampled, and no message overtakes another.
        self._constant = None
        if type(links.latency) is Constant and not self._latency_overrides:
            self._constant = nanoseconds(links.latency.value)
        self.keeps_order = self._constant is None and (self._order == "fifo" or bool(self._order_overrides))
        """Whether `in_order` may change arrival times: latencies may vary, and all links or some may be FIFO."""

    def renamed(self, purpose: str) -> "LinkSampler":
        """Return a sampler of the same links that draws from streams of its own, whose names have a prefix."""
        return LinkSampler(self._links, self._graph, self._seed, self._positions, purpose)

    def losses(self, src: int, dst: list[int], now: int, size: int) -> list[bool] | None:
        """Draw for each receiver whether the message is lost; None means that no receiver loses it.

        Raises:
            ValueError: if a loss or a latency model returns invalid losses.
        """
        # The model is drawn for all receivers, also for those with an override, which is drawn from another stream. So
        # an override changes the losses of no other link.
        if self._lossless:
            lost = None
        elif self._loss_buffer is not None:
            lost = [self._loss_buffer.one()] if len(dst) == 1 else self._loss_buffer.take(len(dst)).tolist()
        elif self._bursts is not None and len(dst) == 1:
            lost = [self._bursts.to_one(src, dst[0], now / SECOND, self._loss_rng)]
        else:
            lost = booleans_of(self._loss(self._context(src, dst, now, size), self._loss_rng), len(dst), self._loss)
        if src in self._loss_overrides:
            lost = lost or [False] * len(dst)
            for k, model, context in self._own_links(self._loss_overrides[src], src, dst, now, size):
                (lost[k],) = booleans_of(model(context, self._override_loss_rng), 1, model)
        if not self._latency_loses:
            return lost
        lost_by_latency = self._lost_by_latency(src, dst, now, size)
        return lost_by_latency if lost is None else list(map(or_, lost, lost_by_latency))

    def cause(self, src: int, dst: int) -> Cause:
        """Return the cause of the losses that the loss model of a link draws."""
        by_dst = self._cause_overrides.get(src)
        return self._cause if by_dst is None else by_dst.get(dst, self._cause)

    def _lost_by_latency(self, src: int, dst: list[int], now: int, size: int) -> list[bool]:
        """Return for each receiver whether its latency model loses the message."""
        lost = [False] * len(dst)
        if self._is_lost is not None:
            lost = booleans_of(self._is_lost(self._context(src, dst, now, size)), len(dst), self._is_lost)
        for k, is_lost, context in self._own_links(self._is_lost_overrides.get(src, {}), src, dst, now, size):
            lost[k] = is_lost is not None and booleans_of(is_lost(context), 1, is_lost)[0]
        return lost

    def duplicates(self, src: int, dst: list[int], now: int, size: int) -> list[int]:
        """Draw the receivers to which a message is transmitted twice.

        Raises:
            ValueError: if the model returns invalid booleans.
        """
        drawn = self._duplicate(self._context(src, dst, now, size), self._duplicate_rng)
        return list(compress(dst, booleans_of(drawn, len(dst), self._duplicate)))

    def arrivals(self, src: int, dst: list[int], now: int, airtime: int, size: int) -> Arrival:
        """Draw the arrival time (ns) at each receiver of a message whose transmission starts now.

        An arrival time includes the airtime, the latency and the processing delays. If all receivers have the same
        arrival time, one number may stand for all.

        Raises:
            ValueError: if the latency model returns an invalid latency.
        """
        start = now + airtime + self.processing
        if self._constant is not None:
            return start + self._constant
        overrides = self._latency_overrides.get(src)
        if self._latency_buffer is not None:
            if len(dst) == 1 and not overrides:
                return [start + self._latency_buffer.one()]
            delays = self._latency_buffer.take(len(dst))
        else:
            drawn = self._latency(self._context(src, dst, now, size), self._latency_rng)
            delays = times_of(drawn, len(dst), self._latency)
        if overrides:
            # A copy, because a buffer returns a view of its block, and a model may return one number for all receivers.
            delays = np.array(np.broadcast_to(delays, len(dst)))
            for k, model, context in self._own_links(overrides, src, dst, now, size):
                delays[k] = times_of(model(context, self._override_latency_rng), 1, model).item()
        arrivals: Arrival = (delays + start).tolist()  # takes a third less memory than sums of Python integers
        return arrivals

    def typical_latency(self) -> float:
        """Estimate the mean one-way latency, s, with processing delays but without airtime.

        The estimate is the mean of at least 1000 draws from separate random streams, or 0 if the graph has no links.
        Links are sampled in the order of their senders; sampling ends early once there are more than 10 000 draws.
        If latencies depend on time, the draws are spread over their `time_span`.

        Draws that do not depend on the links come from the buffer, one per link. Kept equal to draws link by link by
        `tests/kernel/test_propagation.py::test_the_typical_latency_is_that_of_draws_link_by_link`.
        """
        if not self._graph.number_of_edges():
            return 0.0
        at_sender = mean_of(self._links.processing.sender, self._seed) if self._links.delays_start else 0.0
        if self._constant is not None:
            return (self.processing + self._constant) / SECOND + at_sender
        overtaking = self._links.model_copy(update={"order": "overtaking"})
        sampler = LinkSampler(overtaking, self._graph, self._seed, self._positions, "typical ")
        size, rounds = len(self._graph), 1 + 1000 // max(self._graph.number_of_edges(), 1)
        overrides = (model for by_dst in self._latency_overrides.values() for model in by_dst.values())
        models = (self._latency, *overrides)
        # Of several spans the shortest is used, because a trace of latencies may end there.
        spans = [span for model in models if (span := link_trait(model, "time_span")) is not None]
        buffer = None if sampler._latency_overrides else sampler._latency_buffer
        latencies: list[int] = []
        for k, src in enumerate(list(range(size)) * rounds):
            if buffer is not None:  # the draws do not depend on the links, so only their number matters
                latencies += buffer.take(len(self._graph.adj[src])).tolist()
            else:
                dst, now = sorted(self._graph.adj[src]), nanoseconds(min(spans, default=0.0) * (k * GOLDEN % 1.0))
                arrivals = per_receiver(sampler.arrivals(src, dst, now, 0, TYPICAL_SIZE), len(dst))
                latencies += [time - now - self.processing for time in arrivals]
            if len(latencies) > 10_000:
                break
        total = portable_sum(latencies) + len(latencies) * self.processing
        return total / len(latencies) / SECOND + at_sender if latencies else 0.0

    def in_order(self, src: int, dst: list[int], arrival: Arrival) -> Arrival:
        """Return the arrival times (ns), delayed on FIFO links so that no message overtakes an earlier one."""
        overrides = self._order_overrides.get(src)
        if self._order == "overtaking" and not overrides:
            return arrival
        last, arrivals = self._last, list(per_receiver(arrival, len(dst)))
        for k, node in enumerate(dst):
            if (overrides.get(node, self._order) if overrides else self._order) == "fifo":
                arrivals[k] = last[src, node] = max(arrivals[k], last.get((src, node), 0))
        return arrivals

    def _own_links(
        self, models: Mapping[int, _Model], src: int, dst: list[int], now: int, size: int
    ) -> Iterator[tuple[int, _Model, LinkContext]]:
        """Yield the index, the model and the context of each receiver whose link has a model of its own."""
        for k, node in enumerate(dst):
            if node in models:
                yield k, models[node], self._context(src, [node], now, size)

    def _context(self, src: int, dst: list[int], now: int, size: int) -> LinkContext:
        seed, positions, called = self._seed, self._positions, self._called
        if len(dst) == 1:
            (node,) = dst
            return LinkContext(src, self._nodes[node : node + 1], now / SECOND, size, seed, positions, None, called)
        receivers = self._receivers.get(src)
        if receivers is None or receivers.nodes is not dst:
            receivers = self._arrays(src, dst)
        distances = receivers.distances
        return LinkContext(src, receivers.array, now / SECOND, size, seed, positions, distances, called)

    def _arrays(self, src: int, dst: list[int]) -> "_Receivers":
        """Return the arrays of a list of receivers, and keep them for the sender if the list may be used again.

        The same list object has the same nodes, because lists of receivers are never changed. With 40 nodes,
        `gilbert_elliott` runs 1.6 times as fast as with new arrays, and `by_distance` 2.8 times if no node moves.
        """
        array = np.array(dst, dtype=np.intp)
        if not self._lists_are_kept or (len(self._receivers) + 1) * len(self._graph) > ROOM:
            return _Receivers(dst, array, None)
        distances = None
        if isinstance(self._positions, PositionSource) and self._positions.max_speed == 0.0:
            distances = LinkContext(src, array, positions=self._positions).distances
            distances.setflags(write=False)
        array.setflags(write=False)
        receivers = self._receivers[src] = _Receivers(dst, array, distances)
        return receivers


class _Receivers(NamedTuple):
    """The k receivers of a transmission."""

    nodes: list[int]
    array: "NDArray[np.intp]"
    """(k,) the nodes."""
    distances: "NDArray[np.float64] | None"
    """(k,) their distances from the sender, m; None: they are unknown, or may change."""


def _never_loses(model: object) -> bool:
    return type(model) is Bernoulli and model.p == 0.0

"""What the links do to one transmission: which receivers lose it, and how long it travels to each.

Models that draw independently of the hop are asked for a block of draws at a time, so that a broadcast costs a slice of
a list and not a call of numpy.
"""

from math import inf
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from desim.config.model import MAX_TIME
from desim.kernel.clock import SECOND, nanoseconds
from desim.kernel.graphs import as_model
from desim.kernel.implicit_complete import is_implicit
from desim.kernel.latency import Constant, Independent
from desim.kernel.link_context import LinkContext
from desim.kernel.links import Links
from desim.kernel.loss import Bernoulli
from desim.kernel.positions import PositionSource
from desim.kernel.records import Arrival, per_receiver
from desim.kernel.seeds import stream

if TYPE_CHECKING:
    from collections.abc import Callable

    import networkx as nx
    from numpy.typing import NDArray

TYPICAL_SIZE = 48
"""Of a message whose latency is asked for before it exists, bytes."""
BLOCK = 4096
"""Draws at a time; part of the definition of what a seed gives."""
Each = TypeVar("Each")
Overrides = dict[int, dict[int, Any]]
"""The models of links that are not like the rest, by sender and receiver."""


class LinkSampler:
    """Latencies and losses of one run.

    Args:
        links: the models.
        graph: whose edges may have models of their own.
        seed: of the streams "latency" and "loss".
        positions: where the nodes are now, for models that ask.
        purpose: stands before the names of the streams.

    Raises:
        ValueError: if a link that is not like the rest is not in the graph.
    """

    def __init__(
        self, links: Links, graph: "nx.Graph[int]", seed: int, positions: PositionSource | None, purpose: str = ""
    ):
        size = len(graph)
        self._links, self._graph = links, graph
        self._seed, self._positions = seed, positions
        self.processing = nanoseconds(links.processing.sender) + nanoseconds(links.processing.receiver)
        """Of every message at both ends together, ns."""
        self._latency, self._loss = _started(links.latency, size), _started(links.loss, size)
        names = ("latency", "loss", "latency of own links", "loss of own links")
        streams = [stream(seed, purpose + name) for name in names]
        self._latency_rng, self._loss_rng, self._own_latency_rng, self._own_loss_rng = streams
        self._delays = _buffered(self._latency, self._latency_rng, _checked)
        self._buffers = _buffered(self._loss, self._loss_rng, np.ndarray.tolist)
        own = _overrides(links, graph)
        self._own_latency, self._own_loss = own["latency"], own["loss"]
        self._order, self._own_order = links.order, own["order"]
        self._last: dict[tuple[int, int], int] = {}  # when the last message of each link that keeps its order arrives
        self._lossless = _never_loses(links.loss)
        own_models = (model for to in self._own_loss.values() for model in to.values())
        self.lossless = self._lossless and all(map(_never_loses, own_models))
        """Whether the links never lose anything."""
        # Latencies that are always the same need no models asked, and nothing overtakes.
        self._constant = None
        if isinstance(links.latency, Constant) and not self._own_latency:
            self._constant = nanoseconds(links.latency.value)
        self.keeps_order = self._constant is None and (self._order == "fifo" or bool(self._own_order))
        """Whether some link has messages wait for each other, see `in_order`."""

    def losses(self, src: int, dst: list[int], now: int, size: int) -> list[bool] | None:
        """Return which of the hops lose a message; None if none does."""
        own = self._own_loss.get(src, {})
        if self._lossless:
            lost = None
        elif self._buffers is not None:
            lost = self._buffers.take(len(dst))
        else:
            lost = _truths(self._loss(self._context(src, dst, now, size), self._loss_rng), len(dst))
        for k, node in enumerate(dst if own else ()):
            if node in own:
                lost = lost or [False] * len(dst)
                (lost[k],) = _truths(own[node](self._context(src, [node], now, size), self._own_loss_rng), 1)
        return lost

    def arrivals(self, src: int, dst: list[int], now: int, airtime: int, size: int) -> Arrival:
        """Return when a message that leaves now is readable at each receiver, ns.

        Raises:
            ValueError: if the latency model answers with what is not a time.
        """
        start = now + airtime + self.processing
        if self._constant is not None:
            return start + self._constant
        own = self._own_latency.get(src, {})
        delays: Arrival
        if self._delays is not None:
            delays = self._delays.take(len(dst))
        else:
            delays = _times(self._latency(self._context(src, dst, now, size), self._latency_rng), len(dst))
        if own:
            delays = [delays] * len(dst) if isinstance(delays, int) else delays
            for k, node in enumerate(dst):
                if node in own:
                    delay = _times(own[node](self._context(src, [node], now, size), self._own_latency_rng), 1)
                    delays[k] = delay if isinstance(delay, int) else delay[0]
        return start + delays if isinstance(delays, int) else [start + delay for delay in delays]

    def typical_latency(self) -> float:
        """Return the mean one-way latency over the links of the first senders, processing included but no airtime, s.

        It is measured on at least a thousand draws, if there are links, that the messages of the run do not share.
        """
        free = self._links.model_copy(update={"order": "overtaking"})
        like_this = LinkSampler(free, self._graph, self._seed, self._positions, "typical ")
        size, rounds = len(self._graph), 1 + 1000 // max(self._graph.number_of_edges(), 1)
        found: list[int] = []
        for src in list(range(size)) * rounds:
            dst = sorted(self._graph.adj[src])
            found += per_receiver(like_this.arrivals(src, dst, 0, 0, TYPICAL_SIZE), len(dst))
            if len(found) > 10_000:
                break
        return sum(found) / len(found) / SECOND if found else 0.0

    def in_order(self, src: int, dst: list[int], arrival: Arrival) -> Arrival:
        """Let no message that is not lost arrive before an earlier one of its link, if the link keeps their order."""
        own = self._own_order.get(src)
        if self._order == "overtaking" and not own:
            return arrival
        last, arrivals = self._last, list(per_receiver(arrival, len(dst)))
        for k, node in enumerate(dst):
            if (own.get(node, self._order) if own else self._order) == "fifo":
                arrivals[k] = last[src, node] = max(arrivals[k], last.get((src, node), 0))
        return arrivals

    def _context(self, src: int, dst: list[int], now: int, size: int) -> LinkContext:
        return LinkContext(src, np.array(dst, dtype=np.intp), now / SECOND, size, self._seed, self._positions)


class _Buffer(Generic[Each]):
    """Draws that are independent of the hop, taken from a block."""

    def __init__(self, model: Independent, rng: np.random.Generator, plain: "Callable[[NDArray[Any]], list[Each]]"):
        self._model, self._rng, self._plain = model, rng, plain
        self._block: list[Each] = []
        self._next = 0

    def take(self, count: int) -> list[Each]:
        """Return the next draws."""
        end = self._next + count
        if end > len(self._block):
            fresh = self._plain(self._model.draw(max(BLOCK, count), self._rng))
            self._block = self._block[self._next :] + fresh
            self._next, end = 0, count
        taken = self._block[self._next : end]
        self._next = end
        return taken


def _buffered(
    model: object, rng: np.random.Generator, plain: "Callable[[NDArray[Any]], list[Each]]"
) -> "_Buffer[Each] | None":
    return _Buffer(model, rng, plain) if isinstance(model, Independent) else None


def _started(model: Any, size: int) -> Any:
    """Return what answers for one run: a model with memory begins anew, any other is its own answer."""
    return model.start_run(size) if hasattr(model, "start_run") else model


def _never_loses(model: object) -> bool:
    return isinstance(model, Bernoulli) and model.p == 0.0


def _overrides(links: Links, graph: "nx.Graph[int]") -> dict[str, Overrides]:
    """Return the models of links that are not like the rest: of the edges of the graph, then of `links.link`."""
    found: dict[str, Overrides] = {"latency": {}, "loss": {}, "order": {}}
    for src, dst, attributes in () if is_implicit(graph) else graph.edges(data=True):
        for name in found if attributes else ():
            value = attributes.get(name)
            if value is not None:
                for way in [(src, dst)] if graph.is_directed() else [(src, dst), (dst, src)]:
                    found[name].setdefault(way[0], {})[way[1]] = _started(as_model(name, value), len(graph))
    for link in links.link:
        for src, dst in link.ways():
            if not graph.has_edge(src, dst):
                raise ValueError(f"there is no link from {src} to {dst} in the graph")
            for name, own in found.items():
                model = getattr(link, name)
                if model is not None:
                    own.setdefault(src, {})[dst] = _started(model, len(graph))
    return found


def _checked(delays: Any) -> Any:
    """Return delays in s as whole ns: one number, or a list; none is longer than a run can be.

    Raises:
        ValueError: if one of them is not a time.
    """
    given = np.asarray(delays, dtype=float)
    if not ((given >= 0.0) & (given < inf)).all():
        raise ValueError(f"latencies should be times >= 0 s, got {delays}")
    return np.rint(np.minimum(given, MAX_TIME) * SECOND).astype(np.int64).tolist()


def _times(answer: Any, count: int) -> Arrival:
    """Return what a latency model answers for so many hops in whole ns: one number, or a list of one per hop."""
    shape = np.shape(answer)
    if shape not in {(), (count,)}:
        got = shape[0] if len(shape) == 1 else f"an array of shape {shape}"
        raise ValueError(f"latencies should be one number or one for each of {count} hops, got {got}")
    times: Arrival = _checked(answer)
    return times


def _truths(answer: Any, count: int) -> list[bool]:
    """Return what a loss model answers for so many hops."""
    truths = np.asarray(answer)
    if truths.dtype != bool or truths.shape not in {(), (count,)}:
        raise ValueError(f"losses should be one truth or one for each of {count} hops, got {answer!r}")
    lost: list[bool] = np.broadcast_to(truths, count).tolist()
    return lost

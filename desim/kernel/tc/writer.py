"""The links of a scenario as commands `tc qdisc add ... netem`, which give real links of Linux the same behaviour."""

import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypeGuard

from desim.config.errors import ArgumentError
from desim.config.traits import Model
from desim.kernel.models.graphs import Complete
from desim.kernel.models.latency import Constant, Uniform, mean_of
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli, Correlated, FourState, GilbertElliott
from desim.kernel.models.medium import Bitrate, Medium, Unlimited, contends
from desim.kernel.models.netem import MAX_JITTER, Netem
from desim.kernel.models.netem_tables import TABLES, fit
from desim.kernel.models.own_links import link_overrides
from desim.kernel.models.traits import LinkTraits
from desim.kernel.tc.syntax import HEADERS, LINK, MAX_LIMIT, order_of
from desim.kernel.tc.units import p_of, rate_word, share_word, time_word
from desim.kernel.walls.wall import Wall

DEVICE = re.compile(r"[\w.:@][\w.:@-]{0,14}", re.ASCII)
"""Matches the name of a network device; a shell expands none of its characters."""
Words = list[str]
"""The words of a command."""


class Script(NamedTuple):
    """Commands of tc, and what they need and lack."""

    lines: list[str]
    """Commands and comments."""
    tables: dict[str, tuple[int, ...]]
    """The distribution tables that the commands name, those of iproute2 included."""
    missing: list[tuple[str, str]]
    """The keys of `[network]` that the commands do not express, and why."""


def script(links: Links, size: int, device: str = "eth0", walls: Sequence[Wall] = ()) -> Script:
    """Return the commands for the links of a network of `size` nodes, among walls.

    The first command is for the device of each node. Each link with models of its own has a command for a device of its
    own on the sender, DEVICE-SENDER-RECEIVER.

    Raises:
        ValueError: if `links.link` names a link that is not in the graph, an edge attribute is invalid, or the name of
            a device is invalid.
    """
    writer = _Writer(links)
    lines = ["# on each node", writer.command(device, "network.", links.latency, links.loss, links.order)]
    overrides = link_overrides(links, links.make_graph(size))
    ways = [way for link in links.link for way in link.ways()]
    ways += [(src, dst) for models in overrides.values() for src, receivers in models.items() for dst in receivers]
    for src, dst in dict.fromkeys(ways):
        latency, loss, order = (
            overrides[name].get(src, {}).get(dst, default)
            for name, default in (("latency", links.latency), ("loss", links.loss), ("order", links.order))
        )
        link = LINK.format(src=src, dst=dst)
        lines += ["", f"# {link}", writer.command(f"{device}-{src}-{dst}", f"{link}: ", latency, loss, order)]
    writer.missing += _missing(links)
    if any(wall.decibels for wall in walls):
        writer.missing.append(("wall", "netem does not know positions: no node is behind a wall"))
    return Script(lines, writer.tables, list(dict.fromkeys(writer.missing)))


DRAWING = ("__call__", "draw", "start_run", "quantile", "is_lost", "airtime")
"""The methods of a model of links that say what happens to a message."""


def is_as_built(model: Any, kind: type[Model]) -> TypeGuard[Model]:
    """Return whether a model is of a built-in kind, and no class of a user overrides what happens to a message."""
    return isinstance(model, kind) and all(
        getattr(type(model), name, None) is getattr(kind, name, None) for name in DRAWING
    )


class _Writer:
    """The commands of one script.

    Attributes:
        tables: the tables that the commands name.
        missing: the keys that a command does not express, and why.
    """

    def __init__(self, links: Links):
        self._medium, self._duplicate = links.medium, links.duplicate
        self._processing = mean_of(links.processing.sender, 0) + links.processing.receiver
        self.tables: dict[str, tuple[int, ...]] = {}
        self.missing: list[tuple[str, str]] = []

    def command(self, device: str, place: str, latency: Any, loss: Any, order: str) -> str:
        """Return the command for a device; `place` precedes the keys of the models in `missing`.

        Raises:
            ValueError: if the name of the device is invalid.
        """
        if not DEVICE.fullmatch(device):
            raise ArgumentError(
                "device", f": the name has at most 15 letters, digits and characters . _ : @ - (got {device!r})"
            )
        delay, rate = self._delay(f"{place}latency", latency), _rate(self._medium)
        netem_order = order_of(reorders="reorder" in delay, has_rate=bool(rate))
        # More words than `delay TIME`: delays vary, so that packets may overtake each other.
        if len(delay) > 2 and order != netem_order:
            effect = "keeps the order of packets" if netem_order == "fifo" else "lets packets overtake each other"
            self.missing.append((f"{place}order", f"netem {effect} here, see its rate and reorder"))
        losses = self._words(f"{place}loss", "loss", _loss(loss))
        copies = self._words("network.duplicate", "duplicate", _random(self._duplicate))
        return " ".join(["tc qdisc add dev", device, "root netem", *delay, *losses, *copies, *rate])

    def _delay(self, key: str, latency: Any) -> Words:
        """Return the words of a latency, with the processing delays added."""
        if is_as_built(latency, Constant):
            total = latency.value + self._processing
            return ["delay", time_word(total)] if total else []
        if is_as_built(latency, Uniform):
            middle, half = (latency.low + latency.high) / 2.0, (latency.high - latency.low) / 2.0
            return ["delay", time_word(middle + self._processing), *self._jitter(key, half)]
        if is_as_built(latency, Netem):
            return self._netem(latency)
        traits = LinkTraits.of(latency)
        if traits.quantile is None:
            self.missing.append((key, "netem needs quantiles of the latency that are the same for all links"))
            return []
        fitted = fit(traits.quantile)
        words = ["delay", time_word(fitted.delay + self._processing)]
        jitter = self._jitter(key, fitted.jitter)
        if not jitter:
            return words
        return [*words, *jitter, "distribution", self._name(traits.kind or "latency", fitted.table)]

    def _jitter(self, key: str, jitter: float) -> Words:
        if jitter > MAX_JITTER:
            self.missing.append((key, f"netem varies a delay by at most {MAX_JITTER:.6g} s; here it has the mean only"))
        return [time_word(jitter)] if 0.0 < jitter <= MAX_JITTER else []

    def _netem(self, latency: Netem) -> Words:
        words = ["delay", time_word(latency.delay + self._processing)]
        numbers = latency.numbers()
        if latency.jitter:
            words += [time_word(latency.jitter), *([share_word(latency.correlation)] if latency.correlation else [])]
            words += [] if numbers is None else ["distribution", self._name(latency.distribution, numbers)]
        if latency.reorder:
            words += ["reorder", share_word(latency.reorder)]
            words += [share_word(latency.reorder_correlation)] if latency.reorder_correlation else []
            words += ["gap", str(latency.gap)] if latency.gap > 1 else []
        return words

    def _name(self, kind: str, numbers: tuple[int, ...]) -> str:
        """Return the name of a table; it begins with "desim-" unless it is one of iproute2."""
        stem = f"desim-{re.sub('[^A-Za-z0-9_]+', '-', kind)}"
        is_of_iproute2 = kind in TABLES and TABLES[kind]() == numbers  # a latency of a user may have such a kind, too
        names = [kind] if is_of_iproute2 else [stem, *(f"{stem}-{k}" for k in range(2, len(self.tables) + 2))]
        name = next(name for name in names if self.tables.get(name, numbers) == numbers)
        self.tables[name] = numbers
        return name

    def _words(self, key: str, option: str, values: Words | None) -> Words:
        """Return an option with its values, or no words without values.

        None as the values means that netem has no such model, and adds the key to `missing`.
        """
        if values is None:
            self.missing.append((key, "netem has no such model"))
        return [option, *values] if values else []


def _random(model: Any) -> Words | None:
    """Return the values of netem's `random`, a probability and a correlation; None for a model of another form."""
    if is_as_built(model, Bernoulli):
        return [share_word(model.p)] if model.p else []
    if is_as_built(model, Correlated):
        return [share_word(model.p), share_word(model.correlation)]
    return None


def _loss(loss: Any) -> Words | None:
    """Return the values of the option `loss`; None if netem has no such model."""
    if is_as_built(loss, GilbertElliott) and loss.advance == "message":
        shares = [p_of(loss.share, loss.burst), 1.0 / loss.burst, loss.loss_bad, loss.loss_good]
        are_defaults = loss.loss_bad == 1.0 and loss.loss_good == 0.0  # the model of Gilbert
        return ["gemodel", *map(share_word, shares[:2] if are_defaults else shares)]
    if is_as_built(loss, FourState):
        return ["state", *map(share_word, (loss.p13, loss.p31, loss.p32, loss.p23, loss.p14))]
    values = _random(loss)
    return ["random", *values] if values else values


def _rate(medium: Medium) -> Words:
    if not is_as_built(medium, Bitrate):
        return []
    overhead = [str(medium.header - HEADERS)] if medium.header != HEADERS else []
    limit = ["limit", str(int(medium.queue_limit) + 1)] if medium.queue_limit < MAX_LIMIT else []
    return ["rate", rate_word(medium.bitrate), *overhead, *limit]


def _missing(links: Links) -> Iterator[tuple[str, str]]:
    """Yield the keys of the network that no command expresses, and why."""
    medium = links.medium
    if links.graph != Complete():
        yield "network.graph", "netem does not remove links: connect only the nodes that are linked"
    if links.range != Links().range:
        yield "network.range", "netem does not know positions"
    if not (is_as_built(medium, Bitrate) or is_as_built(medium, Unlimited)):
        yield "network.medium", "netem has only a bit rate"
    if contends(medium):
        yield "network.medium.access", "netem has no contention: each device has a channel of its own"
    if type(links.processing.sender) is not Constant:
        yield "network.processing.sender", "netem has one delay: only the mean of this one is added to it"
    if medium.shared:
        yield "network.medium.shared", "netem has a rate for each device"
    if medium.half_duplex:
        yield "network.medium.half_duplex", "netem does not know what a device receives"
    if is_as_built(medium, Bitrate) and medium.queue_limit < MAX_LIMIT:
        yield "network.medium.queue_limit", "netem also counts packets in their delay, and drops the newest"

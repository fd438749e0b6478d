"""Checks of models of links: `check_latency` and `check_loss`."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from math import inf, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desim.config.arguments import abridged, naming_arguments
from desim.config.arrays import Floats
from desim.config.caller_warnings import warn_caller
from desim.config.python_numbers import real, whole
from desim.kernel.core.link_context import CalledModels, LinkContext
from desim.kernel.models.latency import mean_latency
from desim.kernel.models.latency_by_link import LATENCIES
from desim.kernel.models.links import Links
from desim.kernel.models.loss import LOSSES
from desim.kernel.models.traits import LinkTraits, link_trait, model_of_run
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Team
from desim.scenario.scenario import Recording, Scenario
from desim.testing.judging import Subject, are_apart, are_more, is_off, subject, twice

IMPLAUSIBLE = 10.0
"""The mean latency, s, from which on a warning asks whether the model returns milliseconds."""
RADIUS = 5.0
"""Radius of the circle on which the nodes are, m."""
LIMIT = 60.0
"""Limit of the wall time of the draws, s."""
FEWEST = 20
"""Least number of runs from which a share is estimated: the shares of fewer runs may all be equal by chance."""
TOLERANCE = 1e-6
"""Tolerance of mean latencies: relative and, because nodes cannot be in one place, absolute in s."""


class _Links:
    """Draws of a model of links between `nodes` nodes on a circle; each call of `replies` is one run."""

    def __init__(self, tested: Subject, nodes: int, noun: str, radius: float = RADIUS):
        self.tested, self.nodes, self.noun = tested, nodes, noun
        angles = 2.0 * pi * np.arange(nodes) / nodes
        self._places = radius * np.column_stack((np.cos(angles), np.sin(angles)))

    def targets(self, src: int) -> list[int]:
        """Return the receivers to which the model has a link from a node."""
        receivers = [dst for dst in range(self.nodes) if dst != src]
        check = LinkTraits.of(self.tested.model).check_links
        if check is None:
            return receivers
        linked = []
        for dst in receivers:
            with suppress(ValueError):
                check(self.nodes, [(src, dst)])
                linked.append(dst)
        if not linked:  # so that the error of the model is told
            with self.tested.blaming(f"check_links({self.nodes}, links)"):
                check(self.nodes, [(src, dst) for dst in receivers])
        return linked

    def replies(
        self, calls: Sequence[tuple[int, Sequence[int]]], run: int, now: float = 0.0, step: float = 0.01
    ) -> Iterator[NDArray[Any]]:
        """Yield the checked replies, (k,), to some calls (sender, receivers) in one run.

        Args:
            calls: the calls, in the order of time.
            run: the number of the run, which is also its seed.
            now: the time of the first call, s.
            step: the time between two calls, s.
        """
        with self.tested.fresh() as fresh:
            model = model_of_run(fresh, self.nodes)
            rng, called = np.random.default_rng(run), CalledModels(self.nodes)
            for number, (src, dst) in enumerate(calls):
                time = now + number * step
                yield self._reply(model, LinkContext(src, np.array(dst), time, 100, run, called_models=called), rng)

    def span(self) -> float:
        """Return the time, s, over which the mean latency is typical."""
        with self.tested.fresh() as fresh:
            return LinkTraits.of(model_of_run(fresh, self.nodes)).time_span or 0.0

    def _reply(self, model: Any, context: LinkContext, rng: np.random.Generator) -> NDArray[Any]:
        dst, places = context.dst.tolist(), self._places.copy()
        context.positions = lambda: places
        call = f"{self.noun}(context, rng) with context.dst = {dst}"
        with self.tested.blaming(call):
            reply = model(context, rng)
        if (after := context.dst.tolist()) != dst:
            self.tested.fail(f"{call} changes context.dst to {after}; copy it")
        if places.tobytes() != self._places.tobytes():
            self.tested.fail(f"{call} changes the positions of the nodes; copy them")
        return self.checked(model, context, reply, call)

    def checked(self, model: Any, context: LinkContext, reply: Any, call: str) -> NDArray[Any]:
        """Return a reply as a (k,) array."""
        raise NotImplementedError

    def shaped(self, reply: Any, count: int, call: str, noun: str) -> NDArray[Any]:
        """Return a reply, one value or one for each link, as an array."""
        if np.shape(reply) not in {(), (count,)}:
            form = f"{_form(reply)}, expected one {noun}, or an array of shape ({count},): one per receiver"
            self.tested.fail(f"{call} returns {form}")
        return np.broadcast_to(np.asarray(reply), count)

    def check_repeats(self, calls: Sequence[tuple[int, Sequence[int]]]) -> None:
        """Require that equal generators give equal replies."""
        first, second = ([reply.tolist() for reply in self.replies(calls, 1)] for _ in range(2))
        for (src, dst), before, after in zip(calls, first, second, strict=True):
            self.tested.require(
                np.array_equal(before, after, equal_nan=True),
                f"{self.noun}(context, rng) from {src} to {list(dst)} returns {before} in a first run and {after} in a"
                " second one, though both generators are in the same state: draw from rng only, and let start_run(size)"
                " return a model with fresh state",
            )


class _Latencies(_Links):
    """Draws of a latency; nan where the model loses the message."""

    def checked(self, model: Any, context: LinkContext, reply: Any, call: str) -> Floats:
        array = self.shaped(reply, len(context.dst), call, "number")
        if array.dtype.kind not in "iuf":
            self.tested.fail(f"{call} returns {_form(reply)}, expected latencies in s, as floats")
        lost = self._lost(model, context)
        for node, latency, is_lost in zip(context.dst.tolist(), array.tolist(), lost.tolist(), strict=True):
            if not (is_lost or 0.0 <= latency < inf):
                never = ": a message that never arrives is lost, which is_lost(context) or a loss model says"
                text = f"expected a finite time >= 0 s{never if latency == inf else ''}"
                self.tested.fail(f"{call} returns {latency:g} s to {node}, {text}")
        return np.where(lost, np.nan, array.astype(float))

    def _lost(self, model: Any, context: LinkContext) -> NDArray[np.bool_]:
        is_lost = link_trait(model, "is_lost")
        if is_lost is None:
            return np.zeros(len(context.dst), bool)
        with self.tested.blaming("is_lost(context)"):
            reply = is_lost(context)
        lost = self.shaped(reply, len(context.dst), "is_lost(context)", "boolean")
        if lost.dtype != bool:
            self.tested.fail(f"is_lost(context) returns {_form(reply)}, expected booleans")
        return lost

    def check_batches(self, draws: int) -> Floats:
        """Require that the latencies of a link do not depend on the other links of a call; return those of one link."""
        dst = self.targets(0)[:3]
        together, alone = np.empty((draws, len(dst))), np.empty((draws, len(dst)))
        for run in range(draws):
            (together[run],) = self.replies([(0, dst)], run)
            # The same number of the run, its seed, as above: the latency of a pair may depend on the seed.
            alone[run] = np.concatenate(list(self.replies([(0, [node]) for node in dst], run, step=0.0)))
        for k, node in enumerate(dst):
            both = ~(np.isnan(together[:, k]) | np.isnan(alone[:, k]))
            first, second = together[both, k], alone[both, k]
            self.tested.require(
                not len(first) or not are_apart(first, second),
                f"latency(context, rng) from 0 to {node} has another distribution with context.dst = {dst} (mean"
                f" {first.mean():.4g} s) than with context.dst = [{node}] (mean {second.mean():.4g} s): the latency of"
                " a link should depend on context.dst[k], and not on k or on the number of receivers",
            )
        return together[:, 0]

    def check_draw(self, sample: Floats) -> None:
        """Require that `draw` and `quantile` have the distribution of the calls."""
        traits = LinkTraits.of(self.tested.model)
        draws = len(sample)
        if traits.draw is not None:
            drawn = _drawn(self, traits.draw, draws, "iuf", "latencies, s")
            self.tested.require(
                not are_apart(drawn, sample),
                f"draw({draws}, rng) has another distribution (mean {drawn.mean():.4g} s) than latency(context, rng)"
                f" (mean {sample.mean():.4g} s); the network uses draw if a model has it",
            )
        if traits.quantile is not None:
            u = (np.arange(draws) + 0.5) / draws
            with self.tested.blaming(f"quantile(u) of {draws} numbers in (0, 1)"):
                quantiles = np.asarray(traits.quantile(u.copy()))
            self.tested.require(
                quantiles.shape == u.shape,
                f"quantile(u) of {draws} numbers returns {_form(quantiles)}, expected shape ({draws},)",
            )
            self.tested.require((np.diff(quantiles) >= 0.0).all(), "quantile(u) decreases; it should grow with u")
            self.tested.require(
                not are_apart(quantiles, sample),
                f"quantile(u) has another distribution (median {np.median(quantiles):.4g} s) than latency(context, rng)"
                f" (median {np.median(sample):.4g} s)",
            )

    def check_mean(self, draws: int) -> float:
        """Compare the mean of draws over all links, times and seeds with `mean_latency()`; return it, s."""
        span = self.span()
        calls = [(src, dst) for src in range(self.nodes) if (dst := self.targets(src))]
        means = np.array(
            [
                np.nanmean(np.concatenate(list(self.replies(calls, run, span * (run + 0.5) / draws, 0.0))))
                for run in range(draws)
            ]
        )
        with self.tested.blaming("mean_latency()"):
            expected = mean_latency(self.tested.model)
        drawn = float(means.mean())
        if expected is not None:
            self.tested.require(
                not is_off(means, expected, TOLERANCE * (1.0 + abs(drawn))),
                f"mean_latency() returns {expected:.6g} s, and the mean over {draws} runs of {self.nodes} nodes is"
                f" {drawn:.6g} s: expected equal means within 5 standard errors, or None if the mean is not known",
            )
        return drawn


class _Losses(_Links):
    """Draws of a loss."""

    def checked(self, model: Any, context: LinkContext, reply: Any, call: str) -> NDArray[np.bool_]:
        array = self.shaped(reply, len(context.dst), call, "boolean")
        if array.dtype != bool:
            text = "expected booleans, True where a message is lost: rng.random(len(context.dst)) < p, for instance"
            self.tested.fail(f"{call} returns {_form(reply)}, {text}")
        return array

    def check_batches(self, draws: int) -> NDArray[np.bool_]:
        """Require that the losses of two successive messages of a link do not depend on the other links of a call.

        Returns:
            (draws, k) the losses of the first message on k links, at most three.
        """
        dst = self.targets(0)[:3]
        together, alone = np.empty((2, draws, 2, len(dst)), bool)
        for run in range(draws):
            # The second call reverses the order: this detects state that belongs to an index k instead of a link.
            first, second = self.replies([(0, dst), (0, dst[::-1])], run)
            together[run] = first, second[::-1]
            # The two messages of a link are 0.01 s apart, as above, but each link is asked alone.
            replies = np.concatenate(list(self.replies([(0, [node]) for node in dst * 2], run + draws, step=0.01 / 3)))
            alone[run] = replies.reshape(2, len(dst))
        for k, node in enumerate(dst):
            for messages, rows in (("a first message", (0,)), ("a second message", (1,)), ("both of two", (0, 1))):
                first, second = (np.asarray(sample[:, rows, k].all(axis=1)) for sample in (together, alone))
                self.tested.require(
                    not are_more(first, second),
                    f"loss(context, rng) from 0 to {node} loses {messages} in {first.mean():.3f} of the runs with"
                    f" context.dst = {dst}, and in {second.mean():.3f} with context.dst = [{node}]: the state and the"
                    " probability of a link should belong to (context.src, context.dst[k]), and not to k",
                )
        return together[:, 0]

    def check_draw(self, sample: NDArray[np.bool_]) -> None:
        """Require that `draw` loses the same share as the calls."""
        draw = LinkTraits.of(self.tested.model).draw
        if draw is not None:
            drawn = _drawn(self, draw, len(sample), "b", "booleans")
            self.tested.require(
                not are_more(sample[:, 0], drawn),
                f"draw({len(sample)}, rng) loses a share of {drawn.mean():.3f}, and loss(context, rng) one of"
                f" {sample[:, 0].mean():.3f}; the network uses draw if a model has it",
            )

    def check_share(self, share: float, draws: int) -> None:
        """Compare the share of lost messages with the expected one."""
        dst = self.targets(0)
        shares = np.array([np.mean(list(self.replies([(0, dst)] * 10, run))) for run in range(draws)])
        self.tested.require(
            not is_off(shares, share, 1e-9),
            f"a share of {shares.mean():.4f} of the messages is lost, over {draws} runs of 10 messages on {len(dst)}"
            f" links: expected {share:g} within 5 standard errors",
        )


@naming_arguments
def check_latency(latency: Any, *, nodes: int = 6, draws: int = 200) -> None:
    """Check a model of latency; if you are unsure whether yours is right, run this.

    It checks that the model returns finite times >= 0 of the right shape; that `mean_latency()` is the mean of the
    draws, and `draw` and `quantile` have their distribution; that the latency of a link does not depend on the other
    links of a call; that all draws are from the generator given; that no input is changed; and that two runs of a
    scenario are equal. A mean latency of 10 s or more gives a warning.

    Args:
        latency: an object, a class that needs no parameters, a kind, or "module:name".
        nodes: the number of nodes; for a matrix, the number of its rows.
        draws: the number of runs whose latencies are compared, at least 2. Latencies rarer than 1 in 1000 transmissions
            need more.

    Raises:
        ContractError: an AssertionError; if the model is wrong, with the call, the input and what is expected.
        ValueError: if a number is out of its range.
    """
    nodes, draws = _numbers(nodes, draws)
    tested = subject(latency, LATENCIES, "latency")
    links = _Latencies(tested, nodes, "latency")
    with tested.judged("latency(context, rng)", LIMIT):
        links.check_repeats(_calls(links))
        links.check_draw(links.check_batches(draws))
        # `mean_latency()` does not know distances: it is compared where all distances are almost 0.
        drawn = _Latencies(tested, nodes, "latency", radius=1e-6).check_mean(draws)
    if drawn >= IMPLAUSIBLE:
        text = f"{tested.name}: the mean latency is {drawn:.4g} s. Latencies are in s: is it {drawn:.4g} ms, which are"
        warn_caller(f"{text} {drawn / 1e3:.4g} s?")
    _run(tested, nodes, latency=tested.model)


@naming_arguments
def check_loss(loss: Any, *, nodes: int = 6, draws: int = 1_000, share: float | None = None) -> None:
    """Check a model of loss; if you are unsure whether yours is right, run this.

    It checks that the model returns booleans of the right shape; that the losses of a link do not depend on the other
    links of a call, also for two successive messages; that `draw` loses the same share; that all draws are from the
    generator given; that each run begins with fresh state; that no input is changed; and that two runs of a scenario
    are equal.

    Args:
        loss: an object, a class that needs no parameters, a kind, or "module:name".
        nodes: the number of nodes.
        draws: the number of runs whose losses are compared, at least 2; fewer than 22 runs show no difference.
        share: the expected share of lost messages from node 0 to the others, in [0, 1]; the nodes are on a circle of
            radius 5 m. None: any share.

    Raises:
        ContractError: an AssertionError; if the model is wrong, with the call, the input and what is expected.
        ValueError: if a number is out of its range.
    """
    nodes, draws = _numbers(nodes, draws)
    if share is not None and not 0.0 <= (share := real(share, "share")) <= 1.0:
        raise ValueError(f"share should be a probability, in [0, 1] (got {share:g})")
    tested = subject(loss, LOSSES, "loss")
    links = _Losses(tested, nodes, "loss")
    with tested.judged("loss(context, rng)", LIMIT):
        links.check_repeats(_calls(links))
        links.check_draw(links.check_batches(draws))
        if share is not None:
            links.check_share(share, max(draws // 10, FEWEST))
    _run(tested, nodes, loss=tested.model)


def _numbers(nodes: Any, draws: Any) -> tuple[int, int]:
    """Return the numbers of nodes and of draws; raise ValueError if there are too few."""
    if min(numbers := (whole(nodes, "nodes"), whole(draws, "draws"))) < 2:
        raise ValueError(f"nodes and draws should be at least 2 (got {nodes} and {draws})")
    return numbers


def _calls(links: _Links) -> list[tuple[int, Sequence[int]]]:
    """Return some transmissions: to one, to several, to all, from different senders, repeated."""
    calls: list[tuple[int, Sequence[int]]] = []
    for src in range(links.nodes):
        dst = links.targets(src)
        calls += [(src, dst), (src, dst[-1:]), (src, dst[:2]), (src, dst[::-1])] if dst else []
    return calls * 5


def _drawn(links: _Links, draw: Any, count: int, kinds: str, noun: str) -> NDArray[Any]:
    """Return draws of a model, whose number, type and repetition are checked."""
    call = f"draw({count}, rng)"
    with links.tested.blaming(call):
        first, second = (draw(count, np.random.default_rng(1)) for _ in range(2))
    array = np.asarray(first)
    is_valid = array.shape == (count,) and array.dtype.kind in kinds
    links.tested.require(is_valid, f"{call} returns {_form(first)}, expected {count} {noun}")
    links.tested.require(np.array_equal(array, second), f"{call} returns others for an equal rng; draw from rng only")
    return array


def _form(reply: Any) -> str:
    """Return a short description of what a model returned."""
    if isinstance(reply, np.ndarray):
        return f"an array of shape {reply.shape} of type {reply.dtype}"
    return abridged(repr(reply))


def _run(tested: Subject, nodes: int, **network: Any) -> None:
    """Run a scenario with a model of links twice."""
    parts: dict[str, Any] = {"announce": Announcements(heartbeat=0.1), "record": Recording(messages=True)}
    with tested.judged("a scenario with it"):
        scenario = Scenario(horizon=1.0, team=Team(count=nodes), network=Links(**network), **parts)
    twice(tested, f"a run of {nodes} pursuers", lambda: scenario)

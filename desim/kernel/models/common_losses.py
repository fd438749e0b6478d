"""Losses that are correlated between links: at the receivers of one message, and on links with a node in common."""

import math
from collections import defaultdict
from functools import partial
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from desim.config.arrays import Bools, Floats
from desim.config.model import Probability, Value
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.portable_math import exp
from desim.kernel.models.correlation import LinkMemory

Common = Annotated[float, Field(ge=0, lt=1, strict=True)]
"""A correlation of losses, in [0, 1)."""


class CommonCause(Value):
    """Every message is lost with the same probability; its losses at several receivers are correlated.

    Each message draws one common loss. A receiver takes the common loss with the probability sqrt(common), and draws
    its own otherwise. So the losses at any two receivers have the correlation `common` (the mixture for exchangeable
    binary variables of Lunn & Davies 1998, "A Note on Generating Correlated Binary Variables"). Different messages are
    independent; for links that are bad for a time together use `gilbert_elliott`.
    """

    kind: Literal["common_cause"] = "common_cause"
    p: Probability = 0.1
    """Probability that a message is lost at a receiver, in [0, 1]."""
    common: Common = 0.5
    """Correlation of the losses of one message at two receivers, in [0, 1); 0: they are independent.

    If in doubt, 0.5: where receivers stand close to each other, or interference is at the sender, they lose together.
    """

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Draw the (k,) losses of a message."""
        draws = rng.random(len(context.dst) + 1)
        sharing = math.sqrt(self.common)
        # One draw for each receiver: below `sharing` it takes the common loss; above, the rest of the draw is its own.
        lost: Bools = draws[1:] < sharing + (1.0 - sharing) * self.p
        shares: Bools = draws[1:] < sharing
        return lost if draws[0] < self.p else lost & ~shares


class CommonBursts:
    """Bursts in one run, correlated between two links with a node in common; states advance with time.

    A link is bad while its sender, its receiver or the link itself is bad. These three states alternate independently
    in continuous time, all with the same mean bad period. The state of a node is common to its links.

    Args:
        share: share of the time for which a link is bad, in (0, 1).
        burst: mean duration of a bad period of a link, s.
        common: correlation of the states of two links with a node in common, at most `max_common(share)`.
        losses: probabilities of loss of a link that is good, and of one that is bad.
        size: number of nodes.
    """

    def __init__(self, share: float, burst: float, common: float, losses: tuple[float, float], size: int):
        self._losses = losses
        odds = share / (1.0 - share)
        # Two links with a node in common are both good with the probability (1 - share)^2 / (1 - s), where s is the
        # share of bad time of the node. So their correlation is the odds of the node, s / (1 - s), divided by `odds`.
        node_odds = common * odds
        self._node_share = node_odds / (1.0 + node_odds)
        self._link_share = 1.0 - (1.0 - share) * (1.0 + node_odds) ** 2
        link_odds = self._link_share / (1.0 - self._link_share)
        # A good link turns bad at the sum of the rates of its three states; its share and mean bad period give the sum.
        recovery = odds / burst / (2.0 * node_odds + link_odds)
        self._node_rate, self._link_rate = recovery * (1.0 + node_odds), recovery * (1.0 + link_odds)
        self._nodes = np.full(size, self._node_share), np.full(size, -math.inf)
        """The states of the nodes (1: bad) and their times, s, (n,) each; at first, the share of bad time, at -inf."""
        self._rows: defaultdict[int, LinkMemory] = defaultdict(partial(LinkMemory, self._link_share))

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Advance the states of the nodes and links of a message and return its (k,) losses."""
        row, dst, now = self._rows[context.src], context.dst, context.now
        bad_nodes = self._advance(np.append(dst, context.src), now, rng)  # the receivers, and last the sender
        row.select(dst)
        times = np.broadcast_to(np.asarray(row.since), len(dst))
        bad_links = rng.random(len(dst)) < _chances(row.value, self._link_share, self._link_rate, times, now)
        row.value[:], row.since = bad_links, now
        bad: Bools = bad_links | bad_nodes[:-1] | bad_nodes[-1]
        if self._losses == (0.0, 1.0):
            return bad
        return rng.random(len(bad)) < np.where(bad, self._losses[1], self._losses[0])

    def _advance(self, nodes: "np.typing.NDArray[np.intp]", now: float, rng: np.random.Generator) -> Bools:
        """Advance the states of k nodes, and return which of them are bad now."""
        states, times = self._nodes
        bad: Bools = rng.random(len(nodes)) < _chances(
            states[nodes], self._node_share, self._node_rate, times[nodes], now
        )
        states[nodes], times[nodes] = bad, now
        return bad


def max_common(share: float) -> float:
    """Return the largest correlation of two links with a node in common that are bad for a share of the time.

    It is reached if only nodes have bad periods. It is less than 1/2, because a link has two nodes, and falls with the
    share.
    """
    return (math.sqrt(1.0 - share) - (1.0 - share)) / share if share else 0.5


def _chances(states: Floats, share: float, rate: float, times: Floats, now: float) -> Floats:
    """Return the (k,) probabilities that nodes or links are bad now, given their states at (k,) times, s."""
    return share + (states - share) * exp(rate * (times - now))

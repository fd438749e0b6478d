"""The latency model MyLatency, for scenario files and scripts.

desim run my_latency.toml --allow-import               a run with it
desim sweep my_latency.toml --allow-import             the grid of its parameters
"""

import numpy as np

from desim.config.model import Probability, Time, Value
from desim.kernel.core.link_context import LinkContext


class MyLatency(Value):
    """Most messages are fast; now and then one is slow, for each receiver independently.

    Every field is a key of the table `network.latency`.
    """

    fast: Time = 0.02
    """One-way latency of most messages, s."""
    slow: Time = 0.5
    """One-way latency of a slow message, s."""
    share: Probability = 0.1
    """Probability of a slow message, in [0, 1]."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> np.ndarray:
        """Return the (k,) latencies of one transmission to the k receivers `context.dst`, s.

        `context` also has `src`, `now`, `size` and `distances`. Draw from `rng` only.
        """
        return np.where(rng.random(len(context.dst)) < self.share, self.slow, self.fast)

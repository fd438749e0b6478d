"""The protocol MyProtocol, for scenario files and scripts.

desim run my_protocol.toml --allow-import               a run with it
desim sweep my_protocol.toml --allow-import             a comparison with sap on the same seeds
desim protocols my_protocol:MyProtocol --allow-import        its parameters and traits
"""

from collections.abc import Iterator

from desim.config.model import Probability
from desim.pursuit.team.agent import Agent
from protocols.rule import LearningRule, argmax, current_action


class MyProtocol(LearningRule):
    """Take the best action or, with some probability, keep the present one.

    Every field is a key of the table `protocol`. `schedule` and `utility` are inherited.
    """

    inertia: Probability = 0.3
    """Probability of no change, in [0, 1]."""

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield an action at each turn of a pursuer: 0 to be inactive, j to chase evader j.

        Local variables are the memory of the pursuer. Use only what `Agent` offers: a pursuer knows nothing else. Draw
        from `me.rng` only.
        """
        while True:
            utilities = self.utilities(me)  # of each action that it may choose, s
            keeps = me.rng.random() < self.inertia
            yield current_action(me, utilities) if keeps else argmax(utilities)

"""The centralised benchmark: who would capture an evader first is sent to chase it, and nobody else.

Paper: Lee & Bakolas, "Relay Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential Games",
    Algorithm 3; of several evaders, the best assignment (`desim.pursuit.assignment`).
Parameters: slot (time between two decisions).
Assumes: somebody who knows everything and whose orders are carried out at once. The network is not used, so this is
    what any protocol could at best achieve, whatever the network.
Messages: none.
Robust to loss: yes, for nothing is sent.
"""

from collections.abc import Sequence
from itertools import count
from math import inf
from typing import ClassVar, Literal

import numpy as np

from desim.config.model import Period, Value
from desim.pursuit.agent import Agent, Process
from desim.pursuit.assignment import optimal_assignment
from desim.pursuit.game import relay_pursuer


class Centralised(Value):
    """Pursuer 0 speaks for the omniscient centre: every slot it sees to it that those chase who are best, alone."""

    announces: ClassVar[bool] = False
    """Nobody repeats its action by heartbeats."""
    embodied: ClassVar[bool] = False
    """The centre is in no robot, and does not break down with one."""
    omniscient: ClassVar[bool] = True
    """Whom it leads goes by what the centre knows, however far pursuers see."""
    kind: Literal["centralised"] = "centralised"
    slot: Period = 0.01
    """Time between two decisions delta, s."""

    def __call__(self, me: Agent) -> Process:
        """Assign to each evader one pursuer at most, which can be in time."""
        if me.id != 0:
            return
        for k in count():
            yield me.at(k * self.slot)
            phi = [list(me.global_state.capture_times(evader)) for evader in range(1, me.evader_count + 1)]
            for broken in me.global_state.broken().nonzero()[0]:
                for times in phi:
                    times[broken] = inf
            sent = matching(phi, me.time_left())
            profile = me.global_state.profile()
            wanted = [0] * len(profile)
            for pursuer, action in sent.items():
                wanted[pursuer] = action
            if profile != wanted:
                for pursuer, action in enumerate(wanted):
                    if profile[pursuer] != action:
                        me.global_state.set_action(pursuer, action)


def matching(phi: Sequence[Sequence[float]], reward: float) -> dict[int, int]:
    """Return which evader each pursuer is to chase, 1 .. M; those who are to stay are left out.

    Args:
        phi: (M, N) times of capture, s.
        reward: the time that is left, s.
    """
    if len(phi) == 1:
        first = relay_pursuer(phi[0], reward)
        return {} if first is None else {first: 1}
    return optimal_assignment(np.transpose(phi), reward)

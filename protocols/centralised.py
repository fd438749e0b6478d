"""The centralised benchmark: an omniscient planner assigns at most one pursuer to each evader.

Paper: Lee & Bakolas, "Relay Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential Games",
    Algorithm 3: the pursuer with the least capture time chases the evader. For several evaders, the optimal assignment
    (`desim.pursuit.game.game`).
Parameters: slot (time between two decisions).
Assumes: an omniscient planner whose orders take effect at once. It does not use the network, so it is a benchmark for
    protocols on any network.
Messages: none.
Robust to loss: yes, because nothing is sent.
"""

from collections.abc import Sequence
from itertools import count
from math import inf
from typing import ClassVar, Literal

import numpy as np

from desim.config.model import Period, Value
from desim.pursuit.game.game import optimal_assignment, relay_pursuer
from desim.pursuit.team.agent import Agent, Process


class Centralised(Value):
    """An omniscient planner, run by the process of pursuer 0, assigns pursuers to evaders in every slot."""

    announces: ClassVar[bool] = False
    """Pursuers do not announce their actions."""
    embodied: ClassVar[bool] = False
    """The planner is not part of a robot: it does not crash with pursuer 0, and its clock has no error."""
    omniscient: ClassVar[bool] = True
    """The planner and the pursuers see the evaders at any distance, whatever `sensing.radius` is."""
    kind: Literal["centralised"] = "centralised"
    slot: Period = 0.01
    """Time delta between two decisions, s.

    If in doubt, use the motion step: velocities do not change faster.
    """

    def __call__(self, me: Agent) -> Process:
        """In every slot, assign to each evader at most one pursuer that can capture it before the horizon."""
        if me.id != 0:
            return
        for k in count():
            yield me.at(k * self.slot)
            phi = [list(me.global_state.capture_times(evader)) for evader in range(1, me.evader_count + 1)]
            for broken in me.global_state.broken().nonzero()[0]:
                for times in phi:
                    times[broken] = inf
            assigned = matching(phi, me.time_left())
            for pursuer, present in enumerate(me.global_state.profile()):
                action = assigned.get(pursuer, 0)
                if action != present:
                    me.global_state.set_action(pursuer, action)


def matching(phi: Sequence[Sequence[float]], reward: float) -> dict[int, int]:
    """Return the evader (1 .. M) that each active pursuer is to chase; inactive pursuers are absent.

    Args:
        phi: (M, N) capture times, s.
        reward: the time left to the horizon, s.
    """
    if len(phi) == 1:  # Algorithm 3; ties go to the lowest index
        relay = relay_pursuer(phi[0], reward)
        return {} if relay is None else {relay: 1}
    return optimal_assignment(np.transpose(phi), reward)

"""The centralised benchmark: who would capture the evader first is sent to chase it, and nobody else.

Paper: Lee & Bakolas, "Relay Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential Games",
    Algorithm 3.
Parameters: slot (time between two decisions).
Assumes: somebody who knows everything and whose orders are carried out at once. The network is not used, so this is
    what any protocol could at best achieve, whatever the network.
Messages: none.
Robust to loss: yes, for nothing is sent.
"""

from itertools import count
from math import inf
from typing import ClassVar, Literal

from desim.pursuit.agent import Agent, Process
from desim.pursuit.game import relay_pursuer
from desim.value import Period, Value


class Centralised(Value):
    """Pursuer 0 speaks for the omniscient centre: every slot it sees to it that the relay pursuer chases alone."""

    announces: ClassVar[bool] = False
    """Nobody repeats its action by heartbeats."""
    embodied: ClassVar[bool] = False
    """The centre is in no robot, and does not break down with one."""
    kind: Literal["centralised"] = "centralised"
    slot: Period = 0.01
    """Time between two decisions delta, s."""

    def __call__(self, me: Agent) -> Process:
        """Assign the pursuer of least time of capture, if it can be in time."""
        if me.id != 0:
            return
        everyone = range(me.team_size)
        for k in count():
            yield me.at(k * self.slot)
            phi = [time if me.obeys(j) else inf for j, time in enumerate(me.capture_times())]
            relay = relay_pursuer(phi, me.time_left())
            for pursuer in everyone:
                if me.acts(pursuer) != (pursuer == relay):
                    me.command(pursuer, pursuer == relay)

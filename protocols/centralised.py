"""The centralised benchmark: who would capture the evader first is sent to chase it, and nobody else.

Paper: Lee & Bakolas, "Relay Pursuit of an Evader by a Heterogeneous Group of Pursuers Using Potential Games",
    Algorithm 3.
Parameters: slot (time between two decisions).
Assumes: somebody who knows everything and whose orders are carried out at once. The network is not used, so this is
    what any protocol could at best achieve, whatever the network.
Messages: none.
"""

from itertools import count
from typing import ClassVar, Literal

from desim.pursuit.agent import Agent, Process
from desim.pursuit.game import relay_pursuer
from desim.value import Period, Value


class Centralised(Value):
    """Pursuer 0 speaks for the omniscient centre: every slot it sees to it that the relay pursuer chases alone."""

    announces: ClassVar[bool] = False
    kind: Literal["centralised"] = "centralised"
    slot: Period = 0.01
    """Time between two decisions delta, s."""

    def __call__(self, me: Agent) -> Process:
        """Assign the pursuer of least time of capture, if it can be in time."""
        if me.id != 0:
            return
        chasing = {*me.believed_active(), *([me.id] if me.action else [])}
        for k in count():
            yield me.at(k * self.slot)
            relay = relay_pursuer(me.capture_times(), me.time_left())
            wanted = set() if relay is None else {relay}
            for pursuer in sorted(chasing ^ wanted):
                me.command(pursuer, pursuer == relay)
            chasing = wanted

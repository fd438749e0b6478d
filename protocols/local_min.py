"""Rules without a utility: whoever is first by time of capture, of those whose word counts, chases.

Paper: LocalMin: the greedy maximal independent set, in order of (phi, id), of the graph of who hears whom; found by
    local rounds as in Métivier, Robson, Saheb-Djahromi & Zemmari 2011. ArgminKnown: the obvious rule of thumb.
Parameters: schedule.
Assumes: that neighbours hear each other. LocalMin leaves one pursuer active in every neighbourhood; ArgminKnown one in
    all, if everyone hears everyone (`announce.spread` for more than one hop), else it may leave a neighbourhood
    without any.
Messages: announcements as the scenario's `announce` says.
Robust to loss: yes, with heartbeats. Settles under any schedule.
"""

from collections.abc import Iterator
from typing import ClassVar, Literal

from desim.pursuit.agent import Agent
from protocols.rule import Rule


class LocalMin(Rule):
    """Chase if in time and no active neighbour has a smaller (phi, id)."""

    kind: Literal["local_min"] = "local_min"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield whether it is first of the active."""
        while True:
            near = set(me.circle("neighbours"))
            own = me.capture_time(), me.id
            active = [(phi, j) for j, phi in me.believed().items() if j in near]
            yield own[0] < me.time_left() and all(own < other for other in active)


class ArgminKnown(Rule):
    """Chase if in time and nobody that is heard of, active or not, has a smaller (phi, id)."""

    assumes: ClassVar[tuple[str, ...]] = (*Rule.assumes, "everyone_heard")
    kind: Literal["argmin_known"] = "argmin_known"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield whether it is first of all."""
        while True:
            own = me.capture_time(), me.id
            known = [(each.capture_time, j) for j, each in me.beliefs().items()]
            yield own[0] < me.time_left() and all(own < other for other in known)

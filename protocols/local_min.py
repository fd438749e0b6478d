"""Rules without a utility: whoever is first by time of capture, of those whose word counts, chases.

Paper: LocalMin: the greedy maximal independent set, in order of (phi, id), of the graph of who hears whom; found by
    local rounds as in Métivier, Robson, Saheb-Djahromi & Zemmari 2011. ArgminKnown: the obvious rule of thumb.
Parameters: schedule.
Assumes: that neighbours hear each other. LocalMin leaves one pursuer active in every neighbourhood; ArgminKnown one in
    all, if everyone hears everyone (`announce.dissemination` for more than one hop), else it may leave a neighbourhood
    without any.
Messages: announcements as the scenario's `announce` says.
Robust to loss: yes, with heartbeats. Settles under any schedule.
"""

from collections.abc import Iterator
from typing import ClassVar, Literal

from desim.pursuit.agent import Agent
from desim.pursuit.assignment import greedy_assignment
from protocols.rule import Rule


class LocalMin(Rule):
    """Chase the evader it would capture first, of those in time that no neighbour chases with a smaller (phi, id)."""

    kind: Literal["local_min"] = "local_min"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the evader of which it is first of the active."""
        while True:
            near = set(me.counted_teammates("neighbours"))
            ahead = [evader for evader in me.options()[1:] if self._is_first(me, evader, near)]
            yield min(ahead, key=me.capture_time, default=0)

    def _is_first(self, me: Agent, evader: int, near: set[int]) -> bool:
        """Return whether it would be in time, and no active neighbour before it."""
        own = me.capture_time(evader), me.id
        active = [(phi, j) for j, phi in me.believed_chasers(evader).items() if j in near]
        return own[0] < me.time_left() and all(own < other for other in active)


class ArgminKnown(Rule):
    """Chase if in time and nobody that is heard of, active or not, has a smaller (phi, id).

    Of several evaders each goes to the first that has none yet, in order of (phi, id).
    """

    assumes: ClassVar[tuple[str, ...]] = (*Rule.assumes, "everyone_heard")
    kind: Literal["argmin_known"] = "argmin_known"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the evader of which it is first of all."""
        while True:
            phi = {
                evader: {j: each.capture_time for j, each in me.beliefs(evader=evader).items()}
                | {me.id: me.capture_time(evader)}
                for evader in me.evaders()
            }
            yield greedy_assignment(phi, me.time_left()).get(me.id, 0)

"""Rules without a utility: a pursuer chases if its capture time is less than those of certain teammates.

These teammates are its active neighbours (`LocalMin`) or all whose announcements have not expired (`ArgminKnown`).

Paper: LocalMin: the greedy maximal independent set of the communication graph, in order of (phi, id), where phi is the
    capture time; computed in local rounds as in Métivier, Robson, Saheb-Djahromi & Zemmari 2011. ArgminKnown: none, a
    heuristic.
Parameters: schedule.
Assumes: for LocalMin, symmetric links. Then every pursuer that could capture in time is active or has an active
    neighbour, and no two neighbours chase the same evader. For ArgminKnown, announcements that reach the whole team,
    over several hops if need be (`announce.dissemination`). Then one pursuer of the team stays active for each evader,
    as long as a free pursuer could capture it in time. If announcements do not reach the whole team, ArgminKnown may
    leave a pursuer and all its neighbours inactive.
Messages: announcements, see `announce` in the scenario.
Robust to loss: yes, with heartbeats. Both rules settle under any schedule.
"""

from collections.abc import Iterator
from typing import ClassVar, Literal

from desim.pursuit.game.game import greedy_assignment
from desim.pursuit.team.agent import Agent
from protocols.rule import Rule


class LocalMin(Rule):
    """Chase the evader of least capture time phi among those without a better chaser in the neighbourhood.

    A better chaser is a neighbour that chases the evader with a smaller (phi, id). Evaders that the pursuer cannot
    capture in time are left out. Where positions are not sensed, all teammates whose announcements have not expired
    count as neighbours.
    """

    kind: Literal["local_min"] = "local_min"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the chosen evader, or 0, at each turn."""
        while True:
            neighbours = set(me.counted_teammates("neighbours"))
            open_to_me = [evader for evader in me.options()[1:] if self._is_first(me, evader, neighbours)]
            yield min(open_to_me, key=me.capture_time, default=0)

    def _is_first(self, me: Agent, evader: int, neighbours: set[int]) -> bool:
        """Return whether the pursuer would be in time and comes before all neighbours that chase the evader."""
        phi = me.capture_time(evader)
        rivals = [(rival_phi, j) for j, rival_phi in me.believed_chasers(evader).items() if j in neighbours]
        return phi < me.time_left() and all((phi, me.id) < rival for rival in rivals)


class ArgminKnown(Rule):
    """Chase if a capture in time is possible and no known teammate, active or not, has a smaller (phi, id).

    A teammate is known as long as its last announcement has not expired. Several evaders are assigned greedily, in
    order of (phi, id); each evader gets at most one pursuer, and each pursuer at most one evader.
    """

    assumes: ClassVar[tuple[str, ...]] = (*Rule.assumes, "everyone_heard")
    kind: Literal["argmin_known"] = "argmin_known"

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the evader that the greedy assignment gives to the pursuer, or 0, at each turn."""
        while True:
            phi = {
                evader: {j: belief.capture_time for j, belief in me.beliefs(evader=evader).items()}
                | {me.id: me.capture_time(evader)}
                for evader in me.evaders()
            }
            yield greedy_assignment(phi, me.time_left()).get(me.id, 0)

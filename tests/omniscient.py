"""The centre that `server` cannot be better than: it knows everything, and its orders are late."""

from heapq import merge
from itertools import pairwise
from typing import ClassVar, Literal

from desim.config.model import Period, Time, Value
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import nanoseconds, seconds
from desim.pursuit.team.agent import Agent, Process
from protocols.centralised import matching
from protocols.schedules.periodic import ticks


class RoundTrip(Value):
    """A synchronous round trip: a centre sees everything at each report, and its orders take effect later.

    It decides `up` after each instant at which a follower of `Server` with the same host, period and seed reports, on
    what is true by then, and its orders take effect `down` later; the host's at once. An order that is not the
    present one costs its pursuer the time until it takes effect.
    """

    announces: ClassVar[bool] = False
    embodied: ClassVar[bool] = False
    omniscient: ClassVar[bool] = True
    kind: Literal["round_trip"] = "round_trip"
    host: int = 0
    period: Period = 0.1
    up: Time = 0.0
    down: Time = 0.0

    def __call__(self, me: Agent) -> Process:
        """Decide for the whole team."""
        if me.id != self.host:
            return
        in_flight: list[list[tuple[int, int]]] = [[] for _ in range(me.team_size)]
        told = [None] * me.team_size

        def set_action(pursuer: int, action: int) -> None:
            action = action if action in me.evaders() else 0
            if me.global_state.action(pursuer) != action:
                me.global_state.set_action(pursuer, action)

        def wait(pursuer: int, evader: int) -> float:
            now = nanoseconds(me.now)
            later = [each for each in in_flight[pursuer] if each[0] > now]
            legs = [(now, me.global_state.action(pursuer)), *later, (now + nanoseconds(self.down), 0)]
            return seconds(sum(end - begun for (begun, action), (end, _) in pairwise(legs) if action != evader))

        def decide() -> None:
            phi = [
                [t + (wait(j, e) if j != self.host else 0.0) for j, t in enumerate(me.global_state.capture_times(e))]
                for e in range(1, me.evader_count + 1)
            ]
            sent = matching(phi, me.time_left())
            set_action(self.host, sent.get(self.host, 0))
            for j in range(me.team_size):
                action = sent.get(j, 0)
                if j != self.host and told[j] != action:
                    told[j] = action
                    in_flight[j].append((nanoseconds(me.now) + nanoseconds(self.down), action))
                    me.after(self.down, lambda j=j, action=action: set_action(j, action))

        phases = [stream(me._seed, "reports", j).uniform(0.0, self.period) for j in range(me.team_size)]
        others = [ticks(me, self.period, phase=phase) for j, phase in enumerate(phases) if j != self.host]
        for tick in merge([me.now], *others):
            yield me.at(tick)
            me.after(self.up, decide)

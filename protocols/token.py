"""Schedules with a token: who has it revises, knowing all that was decided before, and passes it on.

Paper: TokenRing: Le Lann 1977; on graphs that are not complete the rule "least recently visited" of Malpani, Chen,
    Vaidya & Welch 2005, "Distributed Token Circulation in Mobile Ad Hoc Networks". TokenWalk: Metropolis et al. 1953.
Parameters: holding_time (time at each pursuer), attempts (before a neighbour is given up).
Assumes: a connected graph; each component of it has a token of its own.
Messages: two per revision, the token and its receipt; what the pursuers announce besides is theirs. The token carries
    what is known of everyone, so it is long.
Robust to loss: yes; see `protocols.token_passing`. Without faults every decision is based on the actions of all others
    as they are, at any latency, as long as word is not forgotten (`belief_timeout`) between two revisions of a pursuer.
"""

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from desim.config.model import Period, Value
from desim.pursuit.agent import Agent, Process
from protocols.token_passing import Token, circulate, hop_time, not_absent


class _WithToken(Value):
    """What both schedules share."""

    spreads_to: ClassVar[Literal["all"]] = "all"
    """The token carries what everyone does."""
    holding_time: Period = 0.01
    """How long a pursuer has the token; it revises at the end of that time, s."""
    attempts: Annotated[int, Field(ge=1, strict=True)] = 5
    """How often the token is sent to a neighbour that does not answer."""

    def mean_slot(self, me: Agent) -> float:
        """Return hold + L + A, s, A the airtime of a token that knows of everyone; to keep it takes hold only."""
        return self.holding_time + hop_time(me)

    def without_turns(self) -> dict[str, Any]:
        """Return a schedule under which all revise whenever the token would be passed on."""
        return {"kind": "synchronous", "schedule": self}


class TokenRing(_WithToken):
    """The token goes to the neighbour that it has not visited for longest: on a complete graph, round by ids."""

    kind: Literal["token_ring"] = "token_ring"

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise with the token in hand."""
        return circulate(me, revise, self.holding_time, self.attempts, least_recent)


class TokenWalk(_WithToken):
    """The token walks at random so that in the long run everybody has it equally often (Metropolis and Hastings)."""

    kind: Literal["token_walk"] = "token_walk"

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise with the token in hand."""
        return circulate(me, revise, self.holding_time, self.attempts, partial(metropolis, me.stream("token walk")))


def least_recent(me: Agent, token: Token) -> int | None:
    """Return the neighbour that was visited least recently; of several the next by id; None if all are absent."""
    candidates = not_absent(token, me.neighbours())
    return min(candidates, key=lambda j: (token.visits[j], (j - me.id) % me.team_size), default=None)


def metropolis(rng: np.random.Generator, me: Agent, token: Token) -> int | None:
    """Return a neighbour j with probability min(1/d_i, 1/d_j), else None; d counts neighbours that are not absent."""
    candidates = not_absent(token, me.neighbours())
    degrees = [len(candidates), *(len(not_absent(token, me.neighbours(j))) for j in candidates)]
    shares = [1.0 / max(degrees[0], degree, 1) for degree in degrees[1:]]
    place = int(np.searchsorted(np.cumsum(shares), rng.random(), side="right"))
    return candidates[place] if place < len(candidates) else None

"""Token schedules: the holder of the token revises, and then forwards the token or, in a random walk, may keep it.

Paper: TokenRing: Le Lann 1977; on graphs that are not complete the rule "least recently visited" of Malpani, Chen,
    Vaidya & Welch 2005, "Distributed Token Circulation in Mobile Ad Hoc Networks". TokenWalk: Metropolis et al. 1953.
Parameters: holding_time (time at each pursuer), attempts (transmissions of the token before a neighbour is given up).
Assumes: a connected graph; otherwise each component has a token of its own. A pursuer knows its present neighbours and
    theirs without messages.
Messages: besides announcements, two each time the token is forwarded: the token and its receipt. The token carries the
    known records of all pursuers, so it is long.
Robust to loss: yes; see `protocols.schedules.token_passing`. Without faults, at any latency, every decision is based on
    the present actions of all pursuers that the token has visited. Records must not time out (`belief_timeout`) between
    two revisions of a pursuer, or the others decide as if it were inactive. Whether the initial actions of the others
    are known depends on `announce.start`.
"""

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from desim.config.model import Period, Value
from desim.kernel.core.message_size import HEADER, NUMBER
from desim.pursuit.team.agent import Agent, Process
from protocols.schedules.token_messages import UNHEARD, Token, not_absent
from protocols.schedules.token_passing import circulate, hop_time


class _WithToken(Value):
    """The common part of the token schedules."""

    spreads_to: ClassVar[Literal["all"]] = "all"
    """The token carries the records of all pursuers."""
    absentee_size: ClassVar[int] = NUMBER
    """The token has the number of each pursuer that did not answer."""
    holding_time: Period = 0.01
    """Time for which a pursuer holds the token before it revises and forwards it, s.

    In a ring of N pursuers, each revises once in N (holding_time + L), where L is the delay of the token on one hop.

    If in doubt, use the motion step: velocities do not change faster.
    """
    attempts: Annotated[int, Field(ge=1, strict=True)] = 5
    """Number of transmissions of the token to a neighbour before the neighbour is given up.

    With few attempts, losses make the token skip neighbours that are up; many delay it at each crashed one.

    If in doubt, use 5, which is enough up to a loss of about 0.1.
    """

    def mean_slot(self, me: Agent) -> float:
        """Return the time from one revision to the next, s, if the token is forwarded: holding_time + L + A.

        L is the one-way latency, and A the airtime of a token with the records of all pursuers. If the token is kept,
        the time is holding_time.
        """
        return self.holding_time + hop_time(me)

    def message_size(self, pursuers: int, announcement: int) -> int:
        """Return the size of a token with the records of all pursuers, bytes; each absentee adds `absentee_size`."""
        numbers = len(UNHEARD) + 1 + pursuers  # epoch, hop and visits
        return HEADER + numbers * NUMBER + pursuers * announcement

    def without_serial_decisions(self) -> dict[str, Any]:
        """Return the table, as in a scenario file, of a schedule in which all pursuers revise every `mean_slot`."""
        return {"kind": "synchronous", "schedule": self}


class TokenRing(_WithToken):
    """The token goes to the least recently visited neighbour; on a complete graph it circulates in order of ids."""

    kind: Literal["token_ring"] = "token_ring"

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise while holding the token."""
        return circulate(me, revise, self.holding_time, self.attempts, least_recent)


class TokenWalk(_WithToken):
    """The token makes a random walk with a uniform stationary distribution (Metropolis and Hastings)."""

    kind: Literal["token_walk"] = "token_walk"

    def __call__(self, me: Agent, revise: Callable[[], None]) -> Process:
        """Revise while holding the token."""
        return circulate(me, revise, self.holding_time, self.attempts, partial(metropolis, me.stream("token walk")))


def least_recent(me: Agent, token: Token) -> int | None:
    """Return the least recently visited neighbour, or None if all are absent; ties go to the next id, cyclically."""
    candidates = not_absent(token, me.neighbours())
    return min(candidates, key=lambda j: (token.visits[j], (j - me.id) % me.team_size), default=None)


def metropolis(rng: np.random.Generator, me: Agent, token: Token) -> int | None:
    """Draw the next holder: neighbour j with probability min(1/d_i, 1/d_j), else None, which keeps the token.

    Pursuer i is the present holder, and d_i the number of its neighbours that are not absent; d_j is read from the
    present topology.
    """
    candidates = not_absent(token, me.neighbours())
    probabilities = [1.0 / max(len(candidates), len(not_absent(token, me.neighbours(j)))) for j in candidates]
    index = int(np.searchsorted(np.cumsum(probabilities), rng.random(), side="right"))
    return candidates[index] if index < len(candidates) else None

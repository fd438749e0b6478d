"""Trust: which announcements of its teammates a pursuer believes.

A `Trust` model creates a judge for each pursuer of a run (`judge`). The judge decides whether the pursuer believes each
record, an announcement that has arrived, and which claims it ignores: the capture times of teammates that it believes.
Beliefs that are not trusted do not reach a protocol (`desim.pursuit.team.beliefs`), so any rule runs with any trust.
What refutes a record is in `desim.pursuit.byzantine.evidence`.
"""

from math import inf
from typing import Annotated, Any, Literal, Protocol

from pydantic import Field

from desim.config.answers import wrong_answer
from desim.config.calls import check_method
from desim.config.choice import OneOf
from desim.config.model import Duration, Limit, Period, Probability, Value
from desim.config.traits import Traits, is_ours
from desim.pursuit.team.judges import JUDGES, AccusingJudge, Checking, Judge, Observer, RatingJudge, TrimmingJudge

INITIAL_REPUTATION = 0.5
"""The reputation of a teammate without evidence."""


class Trust(Protocol):
    """A model of trust."""

    @property
    def period(self) -> float | None:
        """Time between two reports of a judge, s; None: judges do not report."""

    def judge(self, witness: Observer) -> Judge | None:
        """Create the judge of a pursuer, given the observations of the pursuer; None: it believes everything."""


class TrustTraits(Traits):
    """The attribute, besides `judge`, that a model of trust must have; its value must be valid."""

    period: Period | None = None
    """Time between two reports of a judge, s; None: judges do not report."""


def may_distrust(trust: Trust) -> bool:
    """Return whether pursuers with a trust may ignore announcements."""
    return not isinstance(trust, Credulous)


def judge_of(trust: Trust, witness: Observer) -> Judge | None:
    """Return the judge of a pursuer, given the observations of the pursuer; None: it believes everything.

    Raises:
        ValueError: if the trust of a user creates something else.
    """
    judge: Any = trust.judge(witness)
    missing = [name for name in JUDGES if not callable(getattr(judge, name, None))]
    if judge is not None and missing:
        expected = f"None, or an object with the methods {', '.join(JUDGES)} such as a Judge"
        raise wrong_answer(f"judge(witness) of a trust should return {expected}", judge, trust)
    if judge is not None and not is_ours(type(judge)):
        for name, takes in JUDGES.items():
            check_method(judge, name, takes)
    return judge  # type: ignore[no-any-return]


class _WithoutReports(Value):
    """Base of the kinds of trust whose judges do not report."""

    @property
    def period(self) -> float | None:
        """No reports."""
        return None


class Credulous(_WithoutReports):
    """A pursuer believes all announcements."""

    kind: Literal["none"] = "none"

    def judge(self, witness: Observer) -> Judge | None:
        """Return None."""
        return None


class Trimmed(_WithoutReports):
    """A pursuer ignores the F most extreme claims on each side of its own capture time.

    This is the rule of W-MSR (LeBlanc, Zhang, Koutsoukos & Sundaram 2013, "Resilient Asymptotic Consensus in Robust
    Networks"): a pursuer ignores the F least capture times below its own, and the F greatest above it. So F liars that
    claim small capture times cannot stop the fastest pursuer; in return, the F + 1 fastest may all chase, because each
    ignores those before it. In a complete graph F may be up to `tolerated_liars`. The rule needs no observation, and
    does not find out who lies.
    """

    kind: Literal["trimmed"] = "trimmed"
    liars: Annotated[int, Field(ge=0, strict=True)] = 1
    """F: number of liars to tolerate.

    With a small number, liars keep others from the chase; with a large one, honest claims are ignored, and up to F + 1
    pursuers chase.

    If in doubt, use 1, and never more than a quarter of the team.
    """

    def judge(self, witness: Observer) -> Judge | None:
        """Create a judge."""
        return TrimmingJudge(self.liars)


class _Observing(_WithoutReports):
    """Base of the kinds of trust that compare claims with what the pursuer observes."""

    radius: Limit = inf
    """Distance up to which a pursuer observes the position and the motion of a teammate, m."""


class Plausible(_Observing):
    """A pursuer rejects the announcements that physics refutes.

    - The capture time is less than any pursuer could have at this distance from the evader.
    - The action contradicts the motion: for a motion step before the announcement the sender did otherwise, such as
      stand still if it announces a chase.
    - The position is farther away than the sender can have moved since.

    A true announcement is never rejected, however late, if clocks are equal, because the check allows for all that the
    sender can have done since. But an honest sender that does not see the evader announces a capture time from its
    estimate, and a pursuer that sees the evader may refute that. A rejected teammate counts as silent until its next
    announcement that is not refuted.
    """

    kind: Literal["plausible"] = "plausible"

    def judge(self, witness: Observer) -> Judge | None:
        """Create a judge."""
        return Checking(witness, self.radius)


class Accusations(_Observing):
    """A pursuer blocks for good a teammate against which it has evidence, or that several teammates accuse.

    Evidence is as in `plausible`. Accusations are messages of their own, repeated once per period, and reach the
    neighbours only. They let pursuers that do not observe a liar block it. Up to `quorum` - 1 liars cannot get an
    honest pursuer blocked by false accusations; accusations of blocked pursuers do not count. The idea is that of
    Wardega, von Hippel, Tron, Nita-Rotaru & Li 2023, "Byzantine Resilience at Swarm Scale"; their blocklist follows
    from a matching of accusers and accused instead of a quorum.
    """

    kind: Literal["accusations"] = "accusations"
    quorum: Annotated[int, Field(ge=1, strict=True)] = 2
    """Number of accusers that is enough to block a teammate: one more than the liars to tolerate.

    With a small quorum, a few liars get honest pursuers blocked; a large quorum may never be reached.

    If in doubt, use 2.
    """
    interval: Period = 0.2
    """Time between two accusations of a pursuer, s.

    If in doubt, use two heartbeats.
    """

    @property
    def period(self) -> float | None:
        """The interval, s."""
        return self.interval

    def judge(self, witness: Observer) -> Judge | None:
        """Create a judge."""
        return AccusingJudge(witness, self.radius, self.quorum)


class Reputation(_Observing):
    """A pursuer believes a teammate whose reputation is high enough; evidence loses its weight with time.

    Each announcement of a teammate is evidence, good or, if it is refuted as in `plausible`, bad. With the weights g
    and b of both, the reputation is (1 + g) / (2 + g + b), the mean of a beta distribution (Jøsang & Ismail 2002, "The
    Beta Reputation System"). The weight of an announcement decays exponentially.
    """

    kind: Literal["reputation"] = "reputation"
    threshold: Probability = INITIAL_REPUTATION
    """Least reputation that is believed, in [0, 1]; the reputation without evidence is 1/2."""
    decay_time: Duration = 10.0
    """Time in which the weight of an announcement decays to 1/e, s.

    With a short time, a liar is forgiven between two lies; with a long one, a pursuer that was honest for long is
    believed long after its first lie.

    If in doubt, use 100 heartbeats.
    """

    def judge(self, witness: Observer) -> Judge | None:
        """Create a judge."""
        return RatingJudge(witness, self.radius, self.threshold, self.decay_time)


TRUSTS = OneOf(
    *(Credulous, Trimmed, Plausible, Accusations, Reputation),
    needs=("judge", "period"),
    takes=("witness",),
    called="judge",
    traits=TrustTraits,
)


def tolerated_liars(size: int) -> int:
    """Return the greatest number F of liars that W-MSR tolerates in a complete graph of `size` nodes.

    A complete graph of n nodes is ceil(n/2)-robust, and (2F + 1)-robustness suffices (LeBlanc et al. 2013, section 4).
    """
    return (-(-size // 2) - 1) // 2

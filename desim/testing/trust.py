"""The check of trust: `check_trust`."""

from functools import partial
from math import inf, nan
from typing import Any

from desim.config.arguments import naming_arguments
from desim.kernel.core.records import Record
from desim.kernel.core.units import SECOND
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Uniform
from desim.kernel.models.links import Links
from desim.kernel.state.inbox import Message
from desim.pursuit.byzantine.lies import Liar, Slander
from desim.pursuit.team.announcements import Announcements, Assignment, TimedAssignment
from desim.pursuit.team.judges import Accusation, ignored_by, is_believed
from desim.pursuit.team.trust import TRUSTS, judge_of
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Recording, Scenario
from desim.testing.judging import Subject, subject, twice

HORIZON = 1.0
"""Length of a run, s."""
CLAIMS: tuple[dict[int, float], ...] = ({}, {1: 0.5}, {1: nan, 2: 2.0}, {1: 0.1, 2: 0.2, 3: 5.0, 4: inf})
"""Capture times that teammates claim, s, by pursuer."""
SITUATIONS: dict[str, dict[str, Any]] = {
    "a run of an honest team": {},
    "a run of one pursuer": {"team": Team(count=1, speeds=2.0)},
    "a run of two evaders": {"evader": Evader(count=2)},
    "a run with a liar": {"fault": (Liar(node=1, start=0.0, action="chase", phi={"kind": "plausible"}),)},
    "a run with a slanderer": {"fault": (Slander(node=1, start=0.0, accused=(0,)),)},
    "a run in which messages arrive late and out of order": {"network": Links(latency=Uniform(low=0.0, high=1.0))},
    "a run in which a pursuer crashes and loses its memory": {
        "fault": (Crash(node=0, start=0.2, end=0.5, memory=False),)
    },
    "a run in which positions are announced": {"payload": "state"},
}
"""By situation, the changes to the scenario of an honest team of five; "payload" is the key of the announcements."""


class _Observer:
    """What a judge observes when it is called alone: at 3 s, no evidence and an accusation of pursuer 2 by 4."""

    def __init__(self) -> None:
        self.now = 3 * SECOND

    def refutes(self, record: Record, radius: float) -> bool:
        """Return False."""
        return False

    def note(self, suspect: int, *, distrusted: bool) -> None:
        """Do nothing."""

    def mail(self, port: str) -> list[Message]:
        """Return an accusation."""
        return [Message(4, 2 * SECOND, Accusation((2,)))]

    def send(self, body: Any, port: str) -> None:
        """Do nothing."""


@naming_arguments
def check_trust(trust: Any, *, limit: float = 10.0) -> None:
    """Check a trust; if you are unsure whether yours is right, run this.

    It checks that each pursuer gets a judge of its own, with all methods; that a judge answers True or False about a
    record, and ignores nobody but teammates that made a claim; that after forget() it answers as a new judge does; and
    that two runs of scenarios with honest teams, liars, slanderers, crashes and late messages are equal.

    Args:
        trust: an object, a class that needs no parameters, a kind, or "module:name".
        limit: the time that each run may take, s of wall time.

    Raises:
        ContractError: an AssertionError; if the trust is wrong, with the call, the input and what is expected.
    """
    tested = subject(trust, TRUSTS, "trust")
    with tested.judged("judge(witness)", limit), tested.fresh() as model:
        judge, other = judge_of(model, _Observer()), judge_of(model, _Observer())
    if judge is not None and other is not None:
        tested.require(
            judge is not other,
            "judge(witness) returns the same object for two pursuers, which would then know of each other without a"
            " message: create a judge at each call",
        )
        _check_judge(tested, judge, limit)
        _check_forgets(tested, judge, other, limit)
    usual = {"team": Team(count=5, speeds=2.0), "network": Links(latency=0.05), "record": Recording(messages=True)}
    for where, parts in SITUATIONS.items():
        payload, others = parts.get("payload", "time"), {key: part for key, part in parts.items() if key != "payload"}
        announce = Announcements(heartbeat=0.1, payload=payload, trust=tested.model, belief_timeout=inf)
        twice(tested, where, partial(Scenario, horizon=HORIZON, announce=announce, **usual | others), limit=limit)


def _check_judge(tested: Subject, judge: Any, limit: float) -> None:
    """Check the answers of a judge to single calls."""
    bodies = Assignment(0), Assignment(1), TimedAssignment(1, 2.5)
    for number, body in enumerate(bodies):
        record = Record(1, number, 2 * SECOND, body)
        with tested.judged(f"believes(record) with the body {body}", limit):
            is_believed(judge, record)
    for claims in CLAIMS:
        call = f"ignored(1.0, {claims})"
        with tested.judged(call, limit):
            ignored = ignored_by(judge, 1.0, dict(claims))
            strangers = set(ignored) - set(claims)
        tested.require(not strangers, f"{call} returns {ignored}, expected pursuers among {[*claims]}")
    with tested.judged("report()", limit):
        judge.report()


def _check_forgets(tested: Subject, judge: Any, new: Any, limit: float) -> None:
    """Check that a judge that has been called before answers after forget() as a new one.

    The judge meets the teammates in the order of their ids before forget(), and in the reverse order afterwards.
    """

    def believed(judge: Any, order: range) -> dict[int, bool]:
        return {src: is_believed(judge, Record(src, 9, 2 * SECOND, Assignment(1))) for src in order}

    with tested.judged("believes(record) of each teammate", limit):
        believed(judge, range(1, 5))
    with tested.judged("forget()", limit):
        judge.forget()
    with tested.judged("believes(record) after forget()", limit):
        answers, expected = believed(judge, range(4, 0, -1)), believed(new, range(4, 0, -1))
    tested.require(
        answers == expected,
        f"forget() should forget all evidence: believes(record) about teammates then answers {answers}, and that of a"
        f" new judge {expected}",
    )

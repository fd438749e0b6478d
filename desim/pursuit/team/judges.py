"""The judge of a pursuer in a run: which records it believes, whom it ignores, whom it accuses.

A model of trust (`desim.pursuit.team.trust`) creates the judge of each pursuer.
"""

from collections.abc import Collection, Mapping
from math import exp
from typing import Any, NamedTuple, Protocol

import numpy as np

from desim.config.answers import wrong_answer
from desim.kernel.core.ports import ReservedPort
from desim.kernel.core.records import Record
from desim.kernel.core.units import SECOND
from desim.kernel.state.inbox import Message

PORT = ReservedPort("accusations", __name__)
"""The port at which accusations arrive."""


class Accusation(NamedTuple):
    """The teammates that a pursuer has evidence against."""

    accused: tuple[int, ...]


class Observer(Protocol):
    """The interface of a judge to its pursuer; see `desim.pursuit.byzantine.evidence.Witness`."""

    @property
    def now(self) -> int:
        """The local time, ns."""

    def refutes(self, record: Record, radius: float) -> bool:
        """Return whether a record contradicts what the pursuer observes up to a distance, m."""

    def note(self, suspect: int, *, distrusted: bool) -> None:
        """Record that the pursuer begins or stops to distrust a teammate."""

    def mail(self, port: str) -> list[Message]:
        """Remove and return the unread messages of a port."""

    def send(self, body: Any, port: str) -> None:
        """Send a message to all neighbours."""


class Judge:
    """The judgement of one pursuer in one run; this one believes everything."""

    def believes(self, record: Record) -> bool:
        """Return whether the pursuer believes a record, the newest of its source; called at each read."""
        return True

    def ignored(self, own_time: float, claims: Mapping[int, float]) -> Collection[int]:
        """Return the teammates whose claims the pursuer ignores.

        Args:
            own_time: its own capture time, s.
            claims: by teammate, its capture time as announced or sensed, s; nan if unknown.
        """
        return ()

    def report(self) -> None:
        """Send the messages of the judge to the team, if any; called once per `Trust.period`."""

    def forget(self) -> None:
        """Forget all evidence, after a crash without memory."""


JUDGES: Mapping[str, tuple[str, ...]] = {
    "believes": ("record",),
    "ignored": ("own_time", "claims"),
    "report": (),
    "forget": (),
}
"""The methods of a judge, and their arguments."""


def is_believed(judge: Judge, record: Record) -> bool:
    """Return whether a judge believes a record; see `Judge.believes`.

    Raises:
        ValueError: if the judge of a user returns no boolean.
    """
    believed: Any = judge.believes(record)
    if not isinstance(believed, bool | np.bool_):
        raise wrong_answer("believes(record) of a judge should return True or False", believed, judge)
    return bool(believed)


TRUTH = (bool, np.bool_)
"""The types of truth values: a list of them would be read as the pursuers 0 and 1."""


def ignored_by(judge: Judge, own_time: float, claims: Mapping[int, float]) -> Collection[int]:
    """Return the teammates whose claims a judge ignores; see `Judge.ignored`.

    Raises:
        ValueError: if the judge of a user returns anything else.
    """
    ignored: Any = judge.ignored(own_time, claims)
    if not isinstance(ignored, Collection) or isinstance(ignored, str) or any(isinstance(i, TRUTH) for i in ignored):
        raise wrong_answer("ignored(own_time, claims) should return a collection of pursuers", ignored, judge)
    return ignored


class TrimmingJudge(Judge):
    """Ignores the most extreme claims, as W-MSR does; see `Trimmed`.

    Args:
        liars: F, the number of claims that it ignores above, and below, its own capture time.
    """

    def __init__(self, liars: int):
        self._liars = liars

    def ignored(self, own_time: float, claims: Mapping[int, float]) -> Collection[int]:
        """Return the teammates with the F least claims below the own capture time, and the F greatest above it."""
        ranked = sorted((phi, j) for j, phi in claims.items() if phi == phi)
        below = [j for phi, j in ranked if phi < own_time]
        above = [j for phi, j in ranked if phi > own_time]
        return {*below[: self._liars], *above[max(len(above) - self._liars, 0) :]}


class Checking(Judge):
    """Distrusts a teammate if the observations of the pursuer refute its newest record.

    Args:
        witness: what the pursuer observes.
        radius: distance up to which it observes teammates, m.
    """

    def __init__(self, witness: Observer, radius: float):
        self._witness, self._radius = witness, radius
        self._checked: dict[int, int] = {}
        """By teammate, the sequence number of the last record that was checked."""
        self._distrusted: set[int] = set()

    def believes(self, record: Record) -> bool:
        """Return whether the pursuer believes a record; each record is checked once."""
        if self._checked.get(record.src) != record.seq:
            self._checked[record.src] = record.seq
            self._note(record.src, refuted=self._witness.refutes(record, self._radius))
        return record.src not in self._distrusted

    def forget(self) -> None:
        """Forget all evidence."""
        self._checked.clear()
        self._distrusted.clear()

    def _note(self, suspect: int, *, refuted: bool) -> None:
        """Note whether a new record of a teammate is refuted."""
        self._set(suspect, distrusted=refuted)

    def _set(self, suspect: int, *, distrusted: bool) -> None:
        """Begin or stop to distrust a teammate."""
        if distrusted != (suspect in self._distrusted):
            (self._distrusted.add if distrusted else self._distrusted.discard)(suspect)
            self._witness.note(suspect, distrusted=distrusted)


class AccusingJudge(Checking):
    """Blocks for good a teammate against which it has evidence, or that enough teammates accuse; see `Accusations`.

    Args:
        witness, radius: see `Checking`.
        quorum: number of accusers that is enough.
    """

    def __init__(self, witness: Observer, radius: float, quorum: int):
        super().__init__(witness, radius)
        self._quorum = quorum
        self._evidence: set[int] = set()
        self._accusers: dict[int, set[int]] = {}
        """By teammate, the pursuers that accuse it."""

    def believes(self, record: Record) -> bool:
        """Return whether the source of a record is not blocked."""
        for message in self._witness.mail(PORT):
            for accused in message.body.accused:
                self._accusers.setdefault(accused, set()).add(message.src)
        believed = super().believes(record)
        if believed and len(self._accusers.get(record.src, set()) - self._distrusted) >= self._quorum:
            self._set(record.src, distrusted=True)
            return False
        return believed

    def report(self) -> None:
        """Accuse the teammates against which the pursuer has evidence."""
        if self._evidence:
            self._witness.send(Accusation(tuple(sorted(self._evidence))), PORT)

    def forget(self) -> None:
        """Forget all evidence and all accusations."""
        super().forget()
        self._evidence.clear()
        self._accusers.clear()

    def _note(self, suspect: int, *, refuted: bool) -> None:
        if refuted:
            self._evidence.add(suspect)
            self._set(suspect, distrusted=True)


class RatingJudge(Checking):
    """Believes a teammate whose reputation is high enough; see `Reputation`.

    Args:
        witness, radius: see `Checking`.
        threshold: the least reputation that is believed.
        decay_time: time in which the weight of a record decays to 1/e, s.
    """

    def __init__(self, witness: Observer, radius: float, threshold: float, decay_time: float):
        super().__init__(witness, radius)
        self._threshold, self._decay_time = threshold, decay_time
        self._weights: dict[int, tuple[int, float, float]] = {}
        """By teammate: the time of its last record, ns, and the weights of good and bad records then."""

    def forget(self) -> None:
        """Forget all evidence."""
        super().forget()
        self._weights.clear()

    def _note(self, suspect: int, *, refuted: bool) -> None:
        now = self._witness.now
        last, good, bad = self._weights.get(suspect, (now, 0.0, 0.0))
        decay = exp((last - now) / SECOND / self._decay_time)
        good, bad = good * decay + (not refuted), bad * decay + refuted
        self._weights[suspect] = now, good, bad
        # A refuted record is not believed, whatever the reputation.
        self._set(suspect, distrusted=refuted or (1.0 + good) / (2.0 + good + bad) < self._threshold)

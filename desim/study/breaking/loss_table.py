"""What a search among lost, late or repeated messages has found: the fatal choices, and their table."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf
from typing import Any, Literal, NamedTuple, get_args

from desim.analysis.properties import Judgement
from desim.config.json_numbers import to_json
from desim.config.number_texts import counted
from desim.kernel.models.faults import MessageFault
from desim.study.breaking.copies import MessageCopy

MessageFate = Literal["lost", "late", "twice"]
"""What becomes of a message. twice: it arrives as without a fault, and once more later."""
FATES: tuple[MessageFate, ...] = get_args(MessageFate)


class FatalLosses(NamedTuple):
    """Messages whose fates make a protocol violate a property; with fewer of these messages, the property holds."""

    seed: int
    messages: tuple[MessageCopy, ...]
    fates: tuple[MessageFate, ...]
    """What becomes of each message."""
    delay: float
    """The delay of late messages, and of the second arrival of repeated ones, s."""
    verdict: Judgement
    failure: str = ""
    """The exception that the run raises, as text; empty: it ends, and violates the property."""

    @property
    def faults(self) -> tuple[MessageFault, ...]:
        """The faults that give the messages these fates, to be added to the scenario."""
        numbers = [copy.number for copy in self.messages]
        return message_faults(zip(numbers, self.fates, strict=True), self.delay)

    def document(self) -> dict[str, Any]:
        """Return the choice as JSON-compatible values."""
        messages = zip(self.messages, self.fates, strict=True)
        document: dict[str, Any] = to_json(
            {
                "seed": self.seed,
                "messages": [{"fate": fate, **copy._asdict()} for copy, fate in messages],
                "verdict": self.verdict._asdict(),
                "failure": self.failure,
            }
        )
        return document


@dataclass
class LossTable:
    """The result of a search among all choices of at most k lost, late or repeated messages.

    Attributes:
        most: the greatest number of messages, k.
        seeds: the seeds of the runs.
        fates: what may become of a message.
        delay: the delay of late messages, and of the second arrival of repeated ones, s.
        unit: the unit of margins.
        fatal: the choices that violate the property, the smallest first.
        runs: the number of runs.
        skipped: how often a message was not added to a choice, because its fate would change nothing in the run of the
            choice; with most = 1, this is the number of choices that were not run.
        symmetric: the number of choices that were not run, because another choice has the same run.
        messages: by seed, the number of messages in the undisturbed run.
        broken: the seeds with which the property is violated already in the undisturbed run.
    """

    most: int
    seeds: tuple[int, ...]
    fates: tuple[MessageFate, ...] = ("lost",)
    delay: float = inf
    unit: str = "s"
    fatal: list[FatalLosses] = field(default_factory=list)
    runs: int = 0
    skipped: int = 0
    symmetric: int = 0
    messages: dict[int, int] = field(default_factory=dict)
    broken: list[int] = field(default_factory=list)

    def text(self) -> str:
        """Return the table as text."""
        seeds = f"seed{'s' if len(self.seeds) > 1 else ''} {', '.join(map(str, self.seeds))}"
        words = {"lost": "lost", "late": f"late by {self.delay:g} s", "twice": f"repeated after {self.delay:g} s"}
        fates = " or ".join(words[fate] for fate in self.fates)
        runs = counted(self.runs, "run")
        messages = counted(self.most, "lost message") if fates == "lost" else f"{counted(self.most, 'message')} {fates}"
        lines = [f"seed {seed}: violated without any loss" for seed in self.broken]
        for fatal in self.fatal:
            condition = f"if these are {fates}" if len(self.fates) == 1 else "with these"
            outcome = f"fails ({fatal.failure})" if fatal.failure else f"margin {fatal.verdict.margin:.3g} {self.unit}"
            lines.append(f"seed {fatal.seed}: {outcome.rstrip()} {condition}:")
            for copy, fate in zip(fatal.messages, fatal.fates, strict=True):
                lines.append(f"  {'' if len(self.fates) == 1 else f'{words[fate]}: '}{copy}")
        if not lines:
            return f"no violation with at most {messages} ({runs}, {seeds})"
        return "\n".join([*lines, f"at most {messages}: {runs}, {seeds}"])

    def document(self) -> dict[str, Any]:
        """Return the table as JSON-compatible values."""
        document: dict[str, Any] = to_json(
            {
                "most": self.most,
                "fates": self.fates,
                "delay": self.delay,
                "seeds": self.seeds,
                "runs": self.runs,
                "skipped": self.skipped,
                "symmetric": self.symmetric,
                "messages": self.messages,
                "violated_without_losses": self.broken,
                "fatal": [fatal.document() for fatal in self.fatal],
            }
        )
        return document


def message_faults(fates: Iterable[tuple[int, MessageFate]], delay: float) -> tuple[MessageFault, ...]:
    """Return the faults that give messages, by number, their fates."""
    by_fate: dict[MessageFate, list[int]] = {}
    for number, fate in fates:
        by_fate.setdefault(fate, []).append(number)
    return tuple(
        MessageFault(messages=tuple(numbers), delay=inf if fate == "lost" else delay, duplicate=fate == "twice")
        for fate, numbers in by_fate.items()
    )

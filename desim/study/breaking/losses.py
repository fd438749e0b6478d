"""All choices of at most k messages that are lost, late or repeated: which make a protocol violate a property.

A run without chance in its links is a function of what becomes of its messages (`MessageFault`). The choices are tried
by size: each extends a smaller choice by one message that matters in the run of the smaller choice. What becomes of a
message does not matter

- if it is lost anyway;
- if its receiver never looked while it was the newest message of its sender that had arrived;
- if it is a record that would be late, and its receiver did not look before its late arrival;
- if it is a record that arrives twice: the second time, its receiver has this record or a newer one;
- if it would arrive twice, the second time after the end of the run.

Why no choice is left out: let T be any choice. Let S begin empty, and add to it one message of T at a time that
matters in the run of S, until no message in the rest R of T matters. The newest record that has arrived at a look is
then never in R. So the runs of T and S are the same, and S is tried.

Two choices whose messages matter are symmetric if one loses a message that in the other comes too late to be read.
Their runs are the same, and only the one with the loss is made. Choices are sets, so the order of their messages does
not count either. There is no symmetry between pursuers: they differ in their positions and in when they decide.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from math import inf
from typing import Any, NamedTuple

from desim.analysis.properties import Judgement, Stated, judge
from desim.config.arguments import naming_arguments, scenario_argument, value_text
from desim.config.calls import check_action
from desim.config.errors import ArgumentError
from desim.config.python_numbers import real, whole
from desim.config.traits import kind_of
from desim.kernel.core.events import LOST
from desim.kernel.core.seeds import seed_of
from desim.kernel.core.units import nanoseconds
from desim.pursuit.core.traits import StrategyTraits
from desim.pursuit.team.announcements import Announcements
from desim.scenario.properties import Property, recording
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.simulation.run import Result
from desim.study.breaking.case_log import FAILED
from desim.study.breaking.copies import MessageCopy, ReadingTime, copies, looks, readings
from desim.study.breaking.judging import failure_of, judging, outcomes_of, with_messages
from desim.study.breaking.loss_table import FATES, FatalLosses, LossTable, MessageFate, message_faults
from desim.study.breaking.search import GENERATION, checked_property
from desim.study.workers.dispatch import Outcome
from desim.study.workers.executors import workers_for
from desim.study.workers.progress import advance, progress
from desim.study.workers.workers import Workers

LIMIT = 5000
"""The default limit of the number of runs of each seed."""


@naming_arguments
def fatal_losses(
    scenario: Scenario,
    prop: Stated,
    *,
    most: int = 1,
    seeds: Iterable[int] | None = None,
    fates: Sequence[MessageFate] = (),
    delay: float = inf,
    limit: int = LIMIT,
    prune: bool = True,
    jobs: int = 0,
    timeout: float | None = None,
    on_run: Callable[[], object] = lambda: None,
) -> LossTable:
    """Try all choices of at most `most` lost messages, and return those with which a property is violated.

        desim.fatal_losses(scenario, "crowded at most 1 in total", most=2).text()

    Args:
        scenario: the scenario; short runs with few messages are best, as the number of choices grows with the power
            `most` of the number of messages.
        prop: the property, or its text.
        most: the greatest number of messages of a choice; if in doubt, 1, then 2.
        seeds: the seeds; None: that of the scenario.
        fates: what may become of a message, each of "lost", "late" and "twice"; empty: late if there is a delay, else
            lost.
        delay: the delay of late messages, and of the second arrival of repeated ones, s; if in doubt, a little more
            than a time-out of the protocol.
        limit: the greatest number of runs of each seed.
        prune: whether choices with messages that do not matter, and symmetric ones, are left out; the result is the
            same.
        jobs: the number of worker processes; 0 = the number of cores.
        timeout: the longest wall time of a run, s; None: no limit. A longer run has failed.
        on_run: called after each run.

    Raises:
        TypeError: if `scenario` is no scenario.
        ValueError: if the property does not fit the scenario or cannot fail, the protocol is its own reference, a fate
            does not exist or lacks a delay, there are more choices than `limit`, a run fails without any loss, or
            another argument is of a wrong type.
    """
    scenario_argument(Scenario).check(scenario, "fatal_losses")
    check_action(on_run, (), "on_run")
    if (most := whole(most, "most")) < 1:
        raise ArgumentError("most", f"should be at least 1 (got {most})")
    delay, limit = real(delay, "delay"), whole(limit, "limit")
    fates = _checked_fates(fates, delay)
    prop = checked_property(prop, scenario)
    table = LossTable(most, _checked_seeds([scenario.seed] if seeds is None else seeds), fates, delay, prop.unit)
    if not table.seeds:
        raise ArgumentError("seeds", "should not be empty")
    prunes = prune and hides_old_news(scenario, prop)
    recorded = with_messages(scenario, prop)
    with workers_for(jobs, GENERATION, timeout) as workers, progress(0, "losses", "run") as bar:

        def on_runs(count: int) -> None:
            bar.total = max(bar.total or 0, table.runs)
            advance(bar, count)
            for _ in range(count):
                on_run()

        for seed in table.seeds:
            _Choices(recorded, prop, seed, table, workers, on_runs, prune=prunes).try_all(limit)
    return table


def _checked_seeds(seeds: Any) -> tuple[int, ...]:
    """Return the seeds.

    Raises:
        ValueError: if `seeds` is no list, or a seed is no integer of at least 0.
    """
    if isinstance(seeds, str) or not isinstance(seeds, Iterable):
        raise ArgumentError("seeds", f"should be a list of seeds (got {value_text(seeds)})")
    return tuple(map(seed_of, seeds))


def _checked_fates(fates: Sequence[MessageFate], delay: float) -> tuple[MessageFate, ...]:
    """Return the fates, each once; without any, lost or, with a delay, late.

    Raises:
        ValueError: if a fate does not exist, or lacks a delay.
    """
    if not delay > 0.0:
        raise ArgumentError("delay", f"should be positive, s (got {delay:g})")
    if isinstance(fates, str) or not isinstance(fates, Collection):
        raise ArgumentError("fates", f"should be a list of {', '.join(FATES)} (got {value_text(fates)})")
    if unknown := [fate for fate in fates if fate not in FATES]:
        raise ArgumentError("fates", f"should be {', '.join(FATES)} (got {value_text(unknown[0])})")
    if not fates:
        return ("lost",) if delay == inf else ("late",)
    if delay == inf and set(fates) != {"lost"}:
        delayed = next(fate for fate in fates if fate != "lost")
        raise ValueError(f"`delay` is missing: {delayed!r} needs a delay, in s, for instance 0.5")
    return tuple(fate for fate in FATES if fate in fates)


def hides_old_news(scenario: Scenario, prop: Property) -> bool:
    """Return whether a record that nobody reads before a newer one arrives has no effect on the run and the property.

    This holds if pursuers only read their newest records when they decide or send. It does not hold if they forward
    records, judge senders or put records in order, if an evader overhears, if the property is about arrivals, or for
    models of a user, which may read at any time.
    """
    announce, plain = scenario.announce, Announcements()
    about_messages = recording(scenario.with_({"record.messages": False}), [prop]).record.messages
    return (
        PROTOCOLS.holds(scenario.protocol)
        and ":" not in kind_of(scenario.protocol)
        and announce.dissemination == plain.dissemination
        and announce.trust == plain.trust
        and scenario.network.order == "overtaking"
        and not any(StrategyTraits.of(evader.strategy).listens for evader in scenario.evaders)
        and not about_messages
    )


class _Step(NamedTuple):
    """What may become of one more message."""

    copy: MessageCopy
    fate: MessageFate


class _Choice(NamedTuple):
    """What becomes of some messages."""

    steps: tuple[_Step, ...] = ()
    """The fates of the messages, in the order of the numbers of the messages."""
    is_in_order: bool = True
    """Whether the messages were added in this order: an added message then changes none of the messages before."""

    def with_step(self, step: _Step) -> "_Choice":
        """Return the choice with one more message."""
        is_last = not self.steps or step.copy.number > self.steps[-1].copy.number
        steps = sorted([*self.steps, step], key=lambda one: one.copy.number)
        return _Choice(tuple(steps), self.is_in_order and is_last)


_Key = frozenset[tuple[int, MessageFate]]
"""A choice as pairs of the number of a message and its fate."""


class _Report(NamedTuple):
    """The outcome of a run."""

    verdict: Judgement
    steps: list[_Step]
    """The fates of further messages that matter."""
    sent: int
    """The number of messages that were sent."""
    unread_since: dict[int, float]
    """By number of a lost record: when its receiver looked for the last time before a newer one arrived, ns."""
    failure: str = ""
    """The exception that the run raised, as text; then nothing else is known."""


class _Choices:
    """All choices of one seed: the runs that they need, and the entries of the table that follow.

    The scenario records messages, and `on_runs` is called with the number of runs that were made. `prune`: whether
    messages that do not matter, and symmetric choices, are left out.
    """

    def __init__(
        self,
        scenario: Scenario,
        prop: Property,
        seed: int,
        table: LossTable,
        workers: Workers,
        on_runs: Callable[[int], object],
        *,
        prune: bool,
    ):
        self._scenario, self._seed, self._table, self._workers, self._on_runs = scenario, seed, table, workers, on_runs
        self._prune = prune
        self._delay = 0 if table.delay == inf else nanoseconds(table.delay)  # without a delay, no fate needs one
        self._measure = partial(_report, prop, table.fates, self._delay, prune)

    def try_all(self, limit: int) -> None:
        """Run the choices by size, and add their outcomes to the table.

        Raises:
            ValueError: if there are more than `limit` runs to make, or the run fails without any choice.
        """
        table, budget = self._table, self._table.runs + limit
        level: dict[_Key, _Choice] = {frozenset(): _Choice()}
        fatal: list[_Key] = []
        for size in range(table.most + 1):
            # A choice that contains a fatal one says nothing new.
            choices = {key: choice for key, choice in level.items() if not any(part <= key for part in fatal)}
            if table.runs + len(choices) > budget:
                raise ValueError(
                    f"seed {self._seed}: there are {len(choices):,} choices of {size} messages, more than the limit of"
                    f" {limit:,} runs: shorten the horizon, or announce changes only"
                )
            level = {}
            for key, report in self._run(choices).items():
                if not key:
                    table.messages[self._seed] = report.sent
                if not report.verdict.holds:
                    self._add_violation(choices[key], report)
                    fatal.append(key)
                elif size < table.most:
                    self._extend(level, choices[key], report)

    def _add_violation(self, choice: _Choice, report: _Report) -> None:
        if report.failure and not choice.steps:
            raise ValueError(f"seed {self._seed}: the run fails without any loss: {report.failure}")
        if not choice.steps:
            self._table.broken.append(self._seed)
            return
        messages, fates = zip(*choice.steps, strict=True)
        self._table.fatal.append(
            FatalLosses(self._seed, messages, fates, self._table.delay, report.verdict, report.failure)
        )

    def _extend(self, level: dict[_Key, _Choice], choice: _Choice, report: _Report) -> None:
        """Add to the next level the choices with one more message that matters, and count the messages that do not."""
        numbers = {step.copy.number for step in choice.steps}
        steps = [step for step in report.steps if step.copy.number not in numbers]
        self._table.skipped += (report.sent - len(numbers)) * len(self._table.fates) - len(steps)
        for step in steps:
            extended = choice.with_step(step)
            key = frozenset((step.copy.number, step.fate) for step in extended.steps)
            if extended.is_in_order or key not in level:
                level[key] = extended

    def _run(self, choices: Mapping[_Key, _Choice]) -> dict[_Key, _Report]:
        """Return the outcomes of choices of one size; runs with the fewest late messages are made first.

        A choice that is symmetric to one that was run, with a loss instead of a late message, then needs no run.
        """
        reports: dict[_Key, _Report] = {}
        for late_messages in range(self._table.most + 1):
            missing: dict[_Key, _Choice] = {}
            for key, choice in choices.items():
                if sum(step.fate == "late" for step in choice.steps) != late_messages:
                    continue
                if self._prune and (symmetric_report := self._symmetric(key, choice, reports)) is not None:
                    reports[key] = symmetric_report
                    self._table.symmetric += 1
                else:
                    missing[key] = choice
            tasks = [(self._disturbed(choice), self._seed) for choice in missing.values()]
            outcomes = outcomes_of(tasks, self._workers, self._measure)
            reports |= {key: self._report_of(outcome) for key, outcome in zip(missing, outcomes, strict=True)}
            self._table.runs += len(missing)
            self._on_runs(len(missing))
        return {key: reports[key] for key in choices}

    def _report_of(self, outcome: Outcome) -> _Report:
        failure = failure_of(outcome, self._workers.timeout)
        report: _Report = _Report(FAILED, [], 0, {}, failure) if failure else outcome.value
        return report

    def _symmetric(self, key: _Key, choice: _Choice, reports: Mapping[_Key, _Report]) -> _Report | None:
        """Return the outcome of the choice that loses an unread late message instead; None if there is none."""
        for step in choice.steps if choice.is_in_order else ():
            number, arrival = step.copy.number, step.copy.arrival + self._delay
            lost = reports.get(key - {(number, "late")} | {(number, "lost")}) if step.fate == "late" else None
            if lost is None:
                continue
            if arrival > nanoseconds(self._scenario.horizon) or lost.unread_since.get(number, inf) < arrival:
                return lost
        return None

    def _disturbed(self, choice: _Choice) -> Scenario:
        """Return the scenario with the faults of a choice."""
        faults = message_faults(((step.copy.number, step.fate) for step in choice.steps), self._table.delay)
        return self._scenario.with_({"fault": [*self._scenario.fault, *faults]}) if faults else self._scenario


def _report(prop: Property, fates: Sequence[MessageFate], delay: int, prune: bool, result: Result) -> _Report:
    with judging(prop):
        sent = copies(result)
        reading_times = readings(sent, looks(result))
        horizon = nanoseconds(result.scenario.horizon)
        steps = [
            _Step(reading.copy, fate)
            for reading in reading_times
            if reading.copy.arrival != LOST
            for fate in fates
            if not prune or _matters(reading, fate, delay, horizon)
        ]
        lost = [reading for reading in reading_times if reading.copy.arrival == LOST and reading.copy.seq is not None]
        unread_since = {reading.copy.number: reading.last_look() for reading in lost}
        return _Report(judge(prop, result), steps, len(sent), unread_since)


def _matters(reading: ReadingTime, fate: MessageFate, delay: int, horizon: int) -> bool:
    """Return whether the run would differ if a message had a fate; see the top of this module."""
    is_record, late_arrival = reading.copy.seq is not None, reading.copy.arrival + delay
    if fate == "twice":
        return not is_record and late_arrival <= horizon
    return reading.is_read(end=late_arrival if fate == "late" and is_record else inf)

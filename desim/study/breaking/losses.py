"""All choices of at most k lost messages: which of them make a protocol violate a property.

A run without chance in its losses is a function of the set of its lost messages (`MessageFault`). The sets are tried by
size, each as an extension of a smaller one by one message that matters in the run of the smaller one. A message does
not matter if it is lost anyway, or if its receiver never looked while it was the newest of its sender there.

That no set is left out: let R be the messages of a set T that do not matter in the run of the rest S of T, and grow S
within T until there is no other. At each look the newest record that has arrived is not in R, so the run of T is that
of S, and S is tried.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import NamedTuple

from desim.analysis.properties import Judgement, Stated, judge
from desim.config.arguments import naming_arguments, scenario_argument
from desim.config.traits import kind_of
from desim.kernel.models.faults import MessageFault
from desim.pursuit.core.traits import StrategyTraits
from desim.pursuit.team.announcements import Announcements
from desim.scenario.properties import Property, recording
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.simulation.run import Result
from desim.study.breaking.copies import MessageCopy, copies, looks, read_in_time
from desim.study.breaking.search import GENERATION, checked_property, in_order
from desim.study.workers.executors import workers_for
from desim.study.workers.progress import advance, progress
from desim.study.workers.workers import Workers

LIMIT = 5000
"""The greatest number of runs of a table."""


class FatalLosses(NamedTuple):
    """Lost messages with which a protocol violates a property, although it keeps it with any smaller part of them."""

    seed: int
    messages: tuple[MessageCopy, ...]
    verdict: Judgement

    @property
    def fault(self) -> MessageFault:
        """The fault that loses them, to be added to the scenario."""
        return MessageFault(messages=tuple(copy.number for copy in self.messages))


@dataclass
class LossTable:
    """The result of a search among all choices of at most k lost messages.

    Attributes:
        most: k.
        seeds: the seeds.
        delay: the time by which the messages arrived late, s; inf: they were lost.
        fatal: the choices that violate the property, the smallest first.
        runs: the number of runs.
        skipped: the number of choices that were not run, as one of their messages does not matter.
        messages: by seed, the number of messages in the run without losses.
        broken: the seeds with which the property is violated without any loss.
    """

    most: int
    seeds: tuple[int, ...]
    delay: float = inf
    fatal: list[FatalLosses] = field(default_factory=list)
    runs: int = 0
    skipped: int = 0
    messages: dict[int, int] = field(default_factory=dict)
    broken: list[int] = field(default_factory=list)

    def text(self) -> str:
        """Return the table as text."""
        seeds = f"seed{'s' if len(self.seeds) > 1 else ''} {', '.join(map(str, self.seeds))}"
        fate = "lost" if self.delay == inf else f"late by {self.delay:g} s"
        noun = f"message{'s' if self.most > 1 else ''}"
        choices = f"at most {self.most} " + (f"lost {noun}" if self.delay == inf else f"{noun} {fate}")
        lines = [f"seed {seed}: violated without any loss" for seed in self.broken]
        for seed, messages, verdict in self.fatal:
            lines.append(f"seed {seed}: margin {verdict.margin:.3g} if these are {fate}:")
            lines += [f"  {copy}" for copy in messages]
        if not lines:
            lines.append(f"no violation with {choices} ({self.runs:,} runs, {seeds})")
        else:
            lines.append(f"{choices}: {self.runs:,} runs, {seeds}")
        return "\n".join(lines)


class _Told(NamedTuple):
    """What a run tells: its judgement, the messages that matter in it, and the number of all."""

    verdict: Judgement
    matter: list[MessageCopy]
    sent: int


@naming_arguments
def fatal_losses(
    scenario: Scenario,
    prop: Stated,
    *,
    most: int = 1,
    seeds: Iterable[int] | None = None,
    delay: float = inf,
    limit: int = LIMIT,
    prune: bool = True,
    jobs: int = 0,
    on_run: Callable[[], object] = lambda: None,
) -> LossTable:
    """Try all choices of at most `most` lost messages, and return those with which a property is violated.

        desim.fatal_losses(scenario, "crowded at most 1 in total", most=2).text()

    Args:
        scenario: the scenario; short runs with few messages are best, as the number of choices grows with the power
            `most` of their number.
        prop: the property, or its text.
        most: the greatest number of lost messages; if in doubt, 1, then 2.
        seeds: the seeds; None: that of the scenario.
        delay: the time by which the messages arrive late, s; inf: they are lost.
        limit: the greatest number of runs of each seed.
        prune: whether choices with messages that do not matter are left out; the result is the same.
        jobs: the number of worker processes; 0 = the number of cores.
        on_run: called after each run.

    Raises:
        TypeError: if it is not a scenario.
        ValueError: if the property does not fit the scenario or cannot fail, the protocol is its own reference, or
            there are more choices than `limit`.
    """
    scenario_argument(Scenario).check(scenario, "fatal_losses")
    if most < 1:
        raise ValueError(f"most should be at least 1 (got {most})")
    prop = checked_property(prop, scenario)
    table = LossTable(most, (scenario.seed,) if seeds is None else tuple(seeds), delay)
    skips = prune and hides_old_news(scenario, prop)
    observed = recording(scenario, [prop]).with_({"record.messages": True})
    with workers_for(jobs, GENERATION) as workers, progress(0, "losses", "run") as bar:

        def ran() -> None:
            bar.total = max(bar.total or 0, table.runs)
            advance(bar, 1)
            on_run()

        for seed in table.seeds:
            _try_seed(observed, prop, seed, delay, table, limit, skips, workers, ran)
    return table


def hides_old_news(scenario: Scenario, prop: Property) -> bool:
    """Return whether a record that nobody reads before a newer one arrives has no effect on the run and the property.

    This holds if pursuers only read their newest records when they decide or send: not if they forward records, judge
    their senders or put them in order, nor if an evader overhears, or the property is about what has arrived. Models
    of a user may read whenever they want.
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


def _try_seed(
    scenario: Scenario,
    prop: Property,
    seed: int,
    delay: float,
    table: LossTable,
    limit: int,
    prune: bool,
    workers: Workers,
    ran: Callable[[], object],
) -> None:
    """Add to a table what a seed tells; see `fatal_losses`."""
    budget = table.runs + limit
    level: dict[tuple[int, ...], tuple[MessageCopy, ...]] = {(): ()}
    fatal: list[frozenset[int]] = []
    for size in range(table.most + 1):
        choices = [numbers for numbers in level if not any(part <= set(numbers) for part in fatal)]
        if table.runs + len(choices) > budget:
            raise ValueError(
                f"seed {seed}: there are {len(choices):,} choices of {size} messages, more than the limit of"
                f" {limit:,} runs: shorten the horizon, or announce changes only"
            )
        following: dict[tuple[int, ...], tuple[MessageCopy, ...]] = {}
        for numbers, told in zip(choices, _told(scenario, prop, seed, delay, choices, prune, workers), strict=True):
            table.runs += 1
            ran()
            if not numbers:
                table.messages[seed] = told.sent
            if not told.verdict.holds:
                if numbers:
                    fatal.append(frozenset(numbers))
                    table.fatal.append(FatalLosses(seed, level[numbers], told.verdict))
                else:
                    table.broken.append(seed)
                continue
            further = [copy for copy in told.matter if copy.number not in numbers]
            table.skipped += told.sent - len(numbers) - len(further) if size < table.most else 0
            for copy in further:
                extended = sorted([*level[numbers], copy])
                following.setdefault(tuple(one.number for one in extended), tuple(extended))
        level = following


def _told(
    scenario: Scenario,
    prop: Property,
    seed: int,
    delay: float,
    choices: Sequence[tuple[int, ...]],
    prune: bool,
    workers: Workers,
) -> list[_Told]:
    """Return what the run of each choice of messages tells, in order.

    Raises:
        BaseException: what a run raised.
    """
    tasks = [(_losing(scenario, numbers, delay), seed) for numbers in choices]
    return in_order(tasks, workers, partial(_tell, prop, prune))


def _losing(scenario: Scenario, numbers: tuple[int, ...], delay: float) -> Scenario:
    """Return a scenario in which the messages with some numbers are lost, or late."""
    if not numbers:
        return scenario
    return scenario.with_({"fault": [*scenario.fault, MessageFault(messages=numbers, delay=delay)]})


def _tell(prop: Property, prune: bool, result: Result) -> _Told:
    sent = copies(result)
    matter = [
        copy for copy, is_read in read_in_time(sent, looks(result)) if copy.arrival >= 0 and (is_read or not prune)
    ]
    return _Told(judge(prop, result), matter, len(sent))

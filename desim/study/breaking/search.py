"""The search for a scenario in which a protocol violates a property."""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import Any, NamedTuple

from desim.analysis.properties import Judgement, Stated, judge, stated, under_protocol
from desim.config.arguments import naming_arguments, scenario_argument
from desim.kernel.core.seeds import run_seed, stream
from desim.scenario.properties import CANNOT_FAIL, Property, recording
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.simulation.run import Result, run
from desim.study.breaking.case_log import CaseLog
from desim.study.breaking.features import FEATURES, Case, Draw, applied, changed_or_none, drawn, of_grid
from desim.study.breaking.shrinking import SHRINKING, Tried, shrunk
from desim.study.breaking.sightings import SIGHTINGS, seen_in
from desim.study.workers.dispatch import Measurement, Task, drive
from desim.study.workers.executors import workers_for
from desim.study.workers.progress import advance, progress
from desim.study.workers.workers import Workers

GENERATION = 16
"""The number of cases that are run together, whatever the number of workers; of several violations the first counts."""
PARENTS = 4
"""The number of cases with the least margins from which a guided search makes half of the next generation."""
WITHOUT_WEIGHTS = "policy"
"""The protocol that is not compared: it is what its weights make of it."""


@dataclass(frozen=True)
class Violation:
    """A scenario in which a protocol violates a property: the smallest that was found."""

    scenario: Scenario
    """The scenario, with all changes."""
    seed: int
    prop: Property
    verdict: Judgement
    case: Case
    """What was changed, by feature."""
    first: Case
    """The case that was found first, before it was made smaller."""
    searched: int
    """The number of cases that were run until the first violation."""
    shrunk: int
    """The number of cases that were run to make it smaller."""

    @property
    def faults(self) -> int:
        """The number of faults that were added."""
        return sum("fault" in changes for changes in self.case.values())

    def protocols(self) -> dict[str, Judgement | str]:
        """Return what each installed protocol does in this scenario with this seed; a text: why it cannot be run."""
        verdicts: dict[str, Judgement | str] = {}
        for kind in PROTOCOLS.choices():
            if kind in (self.prop.against, WITHOUT_WEIGHTS):
                continue
            try:
                verdicts[kind] = judged(self.prop, under_protocol(self.scenario, kind), self.seed)
            except ValueError as error:
                verdicts[kind] = str(error).splitlines()[0]
        return verdicts


@dataclass
class Search:
    """The result of a search.

    Attributes:
        violation: the smallest violation; None if none was found.
        runs: the number of cases that were run to find it.
        refused: the number of cases that make no valid scenario, and so were not run.
        margins: the margin of each case that was run, in order.
        featured: how many of these cases had each feature.
        seen: in how many of these cases each of `SIGHTINGS` was seen.
        stopped: whether the time was up before all cases were run.
    """

    violation: Violation | None = None
    runs: int = 0
    refused: int = 0
    margins: list[float] = field(default_factory=list)
    featured: Counter[str] = field(default_factory=Counter)
    seen: Counter[str] = field(default_factory=Counter)
    stopped: bool = False

    @property
    def closest(self) -> float:
        """The least margin of all cases; inf without any."""
        return min(self.margins, default=inf)

    def warnings(self, prop: Property) -> list[str]:
        """Return what makes the result of the search say little."""
        texts = [f"never seen: {sentence}" for sentence in SIGHTINGS if self.runs and not self.seen[sentence]]
        if self.runs and self.violation is None and self.closest >= prop.bound > 0.0:
            texts.append(f"no case came near the bound: the least margin is {self.closest:g} s, all of the limit")
        return texts


class Planned(NamedTuple):
    """A case that is to be run."""

    case: Case
    seed: int
    scenario: Scenario


class CaseRun(NamedTuple):
    """What a run of a case tells."""

    verdict: Judgement
    seen: list[str]


def judged(prop: Property, scenario: Scenario, seed: int) -> Judgement:
    """Return the judgement of a run."""
    return judge(prop, run(recording(scenario, [prop]), seed))


def _sighted(prop: Property, result: Result) -> CaseRun:
    return CaseRun(judge(prop, result), seen_in(result))


def checked_property(prop: Stated, scenario: Scenario) -> Property:
    """Return the property that a text states, if a search for its violation makes sense.

    Raises:
        ValueError: if it does not fit the scenario or cannot fail, or the protocol is its own reference.
    """
    made = stated(prop, scenario)
    if not made.can_fail(scenario):
        raise ValueError(f"property {made.text!r} says nothing: {CANNOT_FAIL}")
    if made.against == scenario.protocol_name:
        raise ValueError(f"{made.against} is its own reference: a run never differs from itself")
    return made


@naming_arguments
def find_violation(
    scenario: Scenario,
    prop: Stated,
    *,
    runs: int = 200,
    seed: int | None = None,
    vary: Mapping[str, Sequence[Any]] | None = None,
    features: Sequence[str] | None = None,
    guided: bool = False,
    jobs: int = 0,
    budget: float = inf,
    shrinking: int = SHRINKING,
    log: CaseLog | None = None,
    on_case: Callable[[Tried], object] = lambda _: None,
) -> Search:
    """Search for a scenario in which the protocol of a scenario violates a property, and make it small.

        desim.find_violation(desim.load("relay.toml"), "idle at most 2 in total against centralised").violation

    Case k has the seed of run k. It has each feature with probability 1/2, with values within documented bounds.

    Args:
        scenario: where the search begins.
        prop: the property, or its text. Without `against` the search may find games that no protocol can win; if in
            doubt, compare with "centralised".
        runs: the greatest number of cases; if in doubt, 200.
        seed: the root seed; None: that of the scenario.
        vary: further features: values by dotted key, of which a case takes one.
        features: the names of the built-in features that cases may have; None: all of `FEATURES`.
        guided: whether half of the cases are made from those with the least margins up to now; if in doubt, False, as a
            margin that hardly varies misleads.
        jobs: the number of worker processes; 0 = the number of cores. The result does not depend on it.
        budget: the time, s of wall time, after which no further cases begin; with it, the result depends on the speed
            of the machine.
        shrinking: the greatest number of cases to make a found one smaller.
        log: what was run before, which is not run again; it receives what is run.
        on_case: called with each case, in order.

    Raises:
        TypeError: if it is not a scenario.
        ValueError: if the property does not fit the scenario or cannot fail, a feature does not exist, a run failed,
            or the protocol is its own reference.
    """
    scenario_argument(Scenario).check(scenario, "find_violation")
    prop = checked_property(prop, scenario)
    names = [*FEATURES] if features is None else [*features]
    if unknown := [name for name in names if name not in FEATURES]:
        raise ValueError(f"there is no feature {unknown[0]!r}; there are {', '.join(FEATURES)}")
    kinds = {name: draw for name, draw in FEATURES.items() if name in names} | dict(of_grid(vary or {}, scenario))
    if not kinds:
        raise ValueError("a search needs a feature: give names of `features`, or values by key in `vary`")
    root, search, until = scenario.seed if seed is None else seed, Search(), time.monotonic() + budget
    tried: list[Tried] = []
    with progress(runs, "search", "case") as bar, workers_for(jobs, min(runs, GENERATION)) as workers:
        while search.violation is None and search.runs < runs:
            if time.monotonic() > until:
                search.stopped = True
                break
            number = len(tried) + search.refused
            parents = sorted(tried, key=lambda one: one.verdict.margin)[:PARENTS] if guided else []
            drawn_cases = [
                _planned(scenario, kinds, root, number + k, parents if k % 2 else [])
                for k in range(min(GENERATION, runs - search.runs))
            ]
            generation = [planned for planned in drawn_cases if planned is not None]
            search.refused += len(drawn_cases) - len(generation)
            if search.refused > GENERATION * runs:
                raise ValueError(f"{search.refused} cases made no valid scenario, and {search.runs} did")
            for planned, (verdict, seen) in zip(generation, _run_all(prop, generation, workers, log), strict=True):
                search.runs += 1
                search.margins.append(verdict.margin)
                search.featured.update([*planned.case])
                search.seen.update(seen)
                tried.append(Tried(planned.case, planned.seed, verdict))
                on_case(tried[-1])
                advance(bar, 1)
                if not verdict.holds:
                    search.violation = _smallest(scenario, prop, tried[-1], search.runs, shrinking)
                    break
    return search


def _planned(
    scenario: Scenario, features: Mapping[str, Draw], root: int, number: int, parents: Sequence[Tried]
) -> Planned | None:
    """Return the case with a number; None if it makes no valid scenario."""
    seed = run_seed(root, number)
    rng = stream(seed, "break")
    parent = parents[int(rng.integers(len(parents)))] if parents else None
    case = drawn(features, rng, scenario, None if parent is None else parent.case)
    changed = changed_or_none(scenario, case)
    return None if changed is None else Planned(case, seed if parent is None else parent.seed, changed)


def _run_all(prop: Property, cases: Sequence[Planned], workers: Workers, log: CaseLog | None) -> list[CaseRun]:
    """Return what the run of each case tells, in order; those in the log are not run again.

    Raises:
        BaseException: what a run raised.
    """
    told: dict[int, CaseRun] = {}
    if log is not None:
        for k, planned in enumerate(cases):
            if (entry := log.find(planned.case, planned.seed)) is not None:
                told[k] = CaseRun(*entry)
    missing = [k for k in range(len(cases)) if k not in told]
    tasks = [(recording(cases[k].scenario, [prop]).with_({"record.messages": True}), cases[k].seed) for k in missing]
    told |= dict(zip(missing, in_order(tasks, workers, partial(_sighted, prop)), strict=True))
    if log is not None:
        for k in missing:
            log.add(cases[k].case, cases[k].seed, *told[k])
    return [told[k] for k in range(len(cases))]


def in_order(tasks: Sequence[Task], workers: Workers, measure: Measurement) -> list[Any]:
    """Return the measurement of each run, in the order of the tasks.

    Raises:
        BaseException: what a run raised.
    """
    values: list[Any] = [None] * len(tasks)
    with closing(drive(tasks, workers, measure)) as outcomes:
        for place, outcome in outcomes:
            if outcome.status != "ok":
                raise outcome.error or RuntimeError(outcome.traceback)
            values[place] = outcome.value
    return values


def _smallest(scenario: Scenario, prop: Property, violating: Tried, searched: int, budget: int) -> Violation:
    """Return the smallest violation of the kind of one."""
    best, runs = shrunk(scenario, violating, partial(judged, prop), budget)
    changed = applied(scenario, best.case)
    return Violation(changed, best.seed, prop, best.verdict, best.case, violating.case, searched, runs)

"""The search for a scenario in which a protocol violates a property."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

from desim.analysis.properties import Judgement, Stated, stated, under_protocol
from desim.config.arguments import naming_arguments, scenario_argument, value_text
from desim.config.calls import check_action
from desim.config.errors import ArgumentError
from desim.config.json_numbers import to_json
from desim.config.python_numbers import real, whole
from desim.config.suggestion import did_you_mean
from desim.kernel.core.seeds import run_seed, stream
from desim.scenario.properties import CANNOT_FAIL, Property
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.study.breaking.case_log import CaseLog, CaseRun
from desim.study.breaking.features import FEATURES, Case, Draw, applied, changed_or_none, drawn, of_grid
from desim.study.breaking.judging import CaseJudge, Planned
from desim.study.breaking.shrinking import SHRINKING, Tried, shrunk
from desim.study.breaking.sightings import SIGHTINGS
from desim.study.workers.executors import workers_for
from desim.study.workers.progress import advance, progress

GENERATION = 16
"""The number of cases that are run together, with any number of workers. Of several violations, the first counts."""
PARENTS = 4
"""The number of cases with the least margins from which a guided search makes half of the next generation."""
WITHOUT_WEIGHTS = "policy"
"""The protocol that is not compared with others, because its behaviour depends on its weights."""


@dataclass(frozen=True)
class Violation:
    """A scenario in which a protocol violates a property, or raises an exception: the smallest that was found."""

    scenario: Scenario
    """The scenario, with all changes."""
    seed: int
    prop: Property
    verdict: Judgement
    case: Case
    """What was changed, by feature."""
    first: Case
    """The case in which the violation was found, before it was made smaller."""
    searched: int
    """The number of cases that were run until the first violation."""
    shrunk: int
    """The number of cases that were run to make it smaller."""
    failure: str = ""
    """The exception that the run raises, as text; empty: the run ends, and violates the property."""

    @property
    def faults(self) -> int:
        """The number of faults that were added."""
        return sum("fault" in changes for changes in self.case.values())

    def protocols(
        self, jobs: int = 0, log: CaseLog | None = None, timeout: float | None = None
    ) -> dict[str, Judgement | str]:
        """Return the judgement of each installed protocol in this scenario with this seed, or a text: why it has none.

        A protocol of the user's that violates the property is the first one.

        Args:
            jobs: the number of worker processes; 0 = the number of cores.
            log: the log of earlier runs, which are not made again; new runs are added to it.
            timeout: the longest wall time of a run, s; None: no limit; if in doubt, that of the search.
        """
        name = self.scenario.protocol_name
        verdicts: dict[str, Judgement | str] = (
            {} if name in PROTOCOLS.choices() else {name: self.failure or self.verdict}
        )
        planned: dict[str, Planned] = {}
        for kind in PROTOCOLS.choices():
            if kind in (self.prop.against, WITHOUT_WEIGHTS):
                continue
            try:
                planned[kind] = Planned({}, self.seed, under_protocol(self.scenario, kind))
            except ValueError as error:
                verdicts[kind] = str(error).splitlines()[0]
        with workers_for(jobs, len(planned), timeout) as workers:
            runs = CaseJudge(self.prop, workers, log).judge_all([*planned.values()])
        return verdicts | {
            kind: case_run.failure or case_run.verdict for kind, case_run in zip(planned, runs, strict=True)
        }

    def document(self) -> dict[str, Any]:
        """Return the violation, without its scenario, as JSON-compatible values."""
        document: dict[str, Any] = to_json(
            {
                "seed": self.seed,
                "case": self.case,
                "first": self.first,
                "searched": self.searched,
                "shrunk": self.shrunk,
                "verdict": self.verdict._asdict(),
                "failure": self.failure,
            }
        )
        return document


@dataclass
class Search:
    """The result of a search.

    Attributes:
        violation: the smallest violation; None if none was found.
        runs: the number of cases that were run to find it.
        refused: the number of cases that make no valid scenario, and so were not run.
        tried: each case that was run, in order.
        featured: how many of these cases had each feature.
        seen: in how many of these cases each of `SIGHTINGS` was seen.
        stopped: whether the time was up before all cases were run.
        seconds: the wall time of all runs, s, including those that an interrupted search had made before.
    """

    violation: Violation | None = None
    runs: int = 0
    refused: int = 0
    tried: list[Tried] = field(default_factory=list)
    featured: Counter[str] = field(default_factory=Counter)
    seen: Counter[str] = field(default_factory=Counter)
    stopped: bool = False
    seconds: float = field(default=0.0, compare=False)

    def add(self, planned: Planned, case_run: CaseRun) -> Tried:
        """Count a case that was run, and return it with its judgement."""
        tried = Tried(planned.case, planned.seed, case_run.verdict, case_run.failure)
        self.tried.append(tried)
        self.runs += 1
        self.featured.update([*planned.case])
        self.seen.update(case_run.seen)
        return tried

    @property
    def margins(self) -> list[float]:
        """The margin of each case that was run, in order."""
        return [tried.verdict.margin for tried in self.tried]

    @property
    def closest(self) -> float:
        """The least margin of all cases; inf without any."""
        return min(self.margins, default=inf)

    def warnings(self, prop: Property) -> list[str]:
        """Return the reasons why the result of the search says little."""
        texts = [f"never seen: {sentence}" for sentence in SIGHTINGS if self.runs and not self.seen[sentence]]
        if self.runs and self.violation is None and self.closest >= prop.bound > 0.0:
            margin = f"{self.closest:g} {prop.unit}".rstrip()
            texts.append(f"no case came near the bound: the least margin is {margin}, all of the limit")
        return texts


def checked_property(prop: Stated, scenario: Scenario) -> Property:
    """Return the property that a text states, if a search for its violation makes sense.

    Raises:
        ValueError: if the property does not fit the scenario or cannot fail, or the protocol is its own reference.
    """
    checked = stated(prop, scenario)
    if not checked.can_fail(scenario):
        raise ArgumentError("property", f"{checked.text!r} says nothing: {CANNOT_FAIL}")
    if checked.against == scenario.protocol_name:
        raise ValueError(f"{checked.against} is its own reference: a run never differs from itself")
    return checked


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
    timeout: float | None = None,
    budget: float = inf,
    shrinking: int = SHRINKING,
    log: CaseLog | None = None,
    on_case: Callable[[Tried], object] = lambda _: None,
) -> Search:
    """Search for a scenario in which the protocol of a scenario violates a property or fails, and make it small.

        desim.find_violation(desim.load("relay.toml"), "idle at most 2 in total against centralised").violation

    Case k has the seed of run k, and each feature with probability 1/2, with values within documented bounds. In a
    guided search, a case made from another one has the seed of that one.

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
        timeout: the longest wall time of a run, s; None: no limit. A longer run has failed.
        budget: the time, s of wall time, after which the search ends. The time of the runs in `log` counts, so that a
            search with a greater budget continues an earlier one. With a budget, the result depends on the speed of the
            machine. The budget does not limit the runs that make a violation smaller.
        shrinking: the greatest number of cases that are run to make a violation smaller.
        log: the log of earlier runs, which are not made again; new runs are added to it.
        on_case: called with each case, in order.

    Raises:
        TypeError: if `scenario` is no scenario.
        ValueError: if the property does not fit the scenario or cannot fail, a feature does not exist, the protocol is
            its own reference, the budget or the time-out is not positive, or another argument is of a wrong type.
    """
    scenario_argument(Scenario).check(scenario, "find_violation")
    check_action(on_case, ("case",), "on_case")
    if not real(budget, "budget") > 0.0:
        raise ArgumentError("budget", f"should be positive, s (got {budget:g})")
    if whole(runs, "runs") < 1:
        raise ArgumentError("runs", f"should be at least 1 (got {runs})")
    if (shrinking := whole(shrinking, "shrinking")) < 0:
        raise ArgumentError("shrinking", f"should be at least 0 (got {shrinking})")
    if not isinstance(log, CaseLog | None):
        raise ArgumentError("log", f"should be a CaseLog (got {value_text(log)})")
    prop = checked_property(prop, scenario)
    cases = _Cases(
        scenario,
        features_of(features, {} if vary is None else vary, scenario),
        scenario.seed if seed is None else seed,
        runs,
    )
    search = Search()
    with workers_for(jobs, min(runs, GENERATION), timeout) as workers, progress(runs, "search", "case") as bar:
        judge_run = CaseJudge(prop, workers, log)
        while search.violation is None and search.runs < runs:
            if judge_run.seconds >= budget:
                search.stopped = True
                break
            parents = sorted(search.tried, key=lambda tried: tried.verdict.margin)[:PARENTS] if guided else []
            generation = cases.generation(min(GENERATION, runs - search.runs), parents)
            for planned, case_run in zip(generation, judge_run.judge_all(generation), strict=True):
                tried = search.add(planned, case_run)
                on_case(tried)
                advance(bar, 1)
                if not tried.verdict.holds:
                    search.violation = _smallest(scenario, prop, tried, search.runs, shrinking, judge_run)
                    break
        search.refused, search.seconds = cases.refused, judge_run.seconds
    return search


def features_of(
    names: Sequence[str] | None, vary: Mapping[str, Sequence[Any]], scenario: Scenario
) -> Mapping[str, Draw]:
    """Return the built-in features with some names (None: all), and those of a user, whose values `vary` has by key.

    Raises:
        ValueError: if there is no feature of a name, there are none at all, or the scenario refuses a value of `vary`.
    """
    listed: Any = [*FEATURES] if names is None else [names] if isinstance(names, str) else names
    if not isinstance(listed, Collection) or not all(isinstance(name, str) for name in listed):
        raise ValueError(
            f"features should be a list of names (got {value_text(names)}); there are {', '.join(FEATURES)}"
        )
    names = list(listed)
    if not isinstance(vary, Mapping):
        raise ValueError(
            f"vary should be lists of values by key, {{'team.count': [3, 5]}} for instance (got {value_text(vary)})"
        )
    if unknown := [name for name in names if name not in FEATURES]:
        raise ArgumentError(
            "features",
            f": there is no {unknown[0]!r}{did_you_mean(unknown[0], FEATURES)}; there are {', '.join(FEATURES)}",
        )
    features = {name: draw for name, draw in FEATURES.items() if name in names} | dict(of_grid(vary, scenario))
    if not features:
        raise ValueError("a search needs a feature: give names of `features`, or values by key in `vary`")
    return features


class _Cases:
    """The cases of a search, at most `runs` of which are run, in the order of their numbers.

    Each feature draws changes of the scenario. Case k has the seed of run k of the root seed, or that of its parent.

    Attributes:
        refused: the number of cases up to now that make no valid scenario.
    """

    def __init__(self, scenario: Scenario, features: Mapping[str, Draw], root: int, runs: int):
        self._scenario, self._features, self._root, self._runs = scenario, features, root, runs
        self._number = self.refused = 0

    def generation(self, count: int, parents: Sequence[Tried]) -> list[Planned]:
        """Return those of the next cases that make a valid scenario; every second one is made from a parent, if any.

        Raises:
            ValueError: if hardly any case makes a valid scenario.
        """
        drawn_cases = [self._planned(self._number + k, parents if k % 2 else []) for k in range(count)]
        planned_cases = [planned for planned in drawn_cases if planned is not None]
        self._number += count
        self.refused += count - len(planned_cases)
        if self.refused > GENERATION * self._runs:
            valid = self._number - self.refused
            raise ValueError(f"{self.refused} cases made no valid scenario, and {valid} did")
        return planned_cases

    def _planned(self, number: int, parents: Sequence[Tried]) -> Planned | None:
        """Return the case with a number; None if it makes no valid scenario."""
        seed = run_seed(self._root, number)
        rng = stream(seed, "break")
        parent = parents[int(rng.integers(len(parents)))] if parents else None
        case = drawn(self._features, rng, self._scenario, None if parent is None else parent.case)
        changed = changed_or_none(self._scenario, case)
        return None if changed is None else Planned(case, seed if parent is None else parent.seed, changed)


def _smallest(
    scenario: Scenario, prop: Property, violating: Tried, searched: int, budget: int, judge_run: CaseJudge
) -> Violation:
    """Return the smallest violation that fails as `violating` does; see `shrunk`."""
    best, runs = shrunk(scenario, violating, judge_run, budget)
    changed = applied(scenario, best.case)
    return Violation(changed, best.seed, prop, best.verdict, best.case, violating.case, searched, runs, best.failure)

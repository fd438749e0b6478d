"""The search for a scenario in which a protocol violates a property, and for the smallest one of its kind.

As hypothesis does, it makes what it has found smaller as long as the *same* property stays violated, so that it does
not slip to another failure.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from math import inf
from typing import Any, NamedTuple

from desim.analysis.properties import Judgement, Stated, judge, stated, under_protocol
from desim.config.arguments import scenario_argument
from desim.kernel.core.seeds import run_seed, stream
from desim.scenario.overrides import ScenarioError
from desim.scenario.properties import CANNOT_FAIL, Property, recording
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.simulation.run import Result, run
from desim.study.breaking.features import FEATURES, SIZES, Changes, applied, drawn, of_grid
from desim.study.workers.dispatch import drive
from desim.study.workers.progress import advance, progress
from desim.study.workers.workers import workers_for

GENERATION = 16
"""The number of cases that are run together, whatever the number of workers; of several violations the first counts."""
SHRINKING = 60
"""The greatest number of cases that are tried to make a found one smaller."""
WITHOUT_WEIGHTS = "policy"
"""The protocol that is not compared: it is what its weights make of it."""
Case = dict[str, Changes]
"""The changes of each feature of a case, by name."""


class Tried(NamedTuple):
    """A case that was run."""

    case: Case
    seed: int
    verdict: Judgement


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
                verdicts[kind] = judged(under_protocol(self.scenario, kind), self.seed, self.prop)
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
        seen: how many of these cases had each feature.
    """

    violation: Violation | None = None
    runs: int = 0
    refused: int = 0
    margins: list[float] = field(default_factory=list)
    seen: dict[str, int] = field(default_factory=dict)

    @property
    def closest(self) -> float:
        """The least margin of all cases; inf without any."""
        return min(self.margins, default=inf)


def judged(scenario: Scenario, seed: int, prop: Property) -> Judgement:
    """Return the judgement of a run."""
    return judge(prop, run(recording(scenario, [prop]), seed))


def _verdict(prop: Property, result: Result) -> Judgement:
    return judge(prop, result)


def find_violation(
    scenario: Scenario,
    prop: Stated,
    *,
    runs: int = 200,
    seed: int | None = None,
    vary: Mapping[str, Sequence[Any]] | None = None,
    features: Sequence[str] | None = None,
    jobs: int = 0,
    shrinking: int = SHRINKING,
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
        jobs: the number of worker processes; 0 = the number of cores. The result does not depend on it.
        shrinking: the greatest number of cases to make a found one smaller.
        on_case: called with each case that was run, in order.

    Raises:
        TypeError: if it is not a scenario.
        ValueError: if the property does not fit the scenario or cannot fail, a feature does not exist, a run failed,
            or the protocol is its own reference.
    """
    scenario_argument(Scenario).check(scenario, "find_violation")
    prop = stated(prop, scenario)
    if not prop.can_fail(scenario):
        raise ValueError(f"property {prop.text!r} says nothing: {CANNOT_FAIL}")
    if prop.against == scenario.protocol_name:
        raise ValueError(f"{prop.against} is its own reference: a run never differs from itself")
    names = [*FEATURES] if features is None else [*features]
    if unknown := [name for name in names if name not in FEATURES]:
        raise ValueError(f"there is no feature {unknown[0]!r}; there are {', '.join(FEATURES)}")
    kinds = {name: FEATURES[name] for name in names} | dict(of_grid(vary or {}))
    if not kinds:
        raise ValueError("a search needs a feature: give names of `features`, or values by key in `vary`")
    root, search = scenario.seed if seed is None else seed, Search()
    cases = islice(_cases(scenario, kinds, root, search), runs)
    with progress(runs, "search", "case") as bar, workers_for(jobs, min(runs, GENERATION)) as workers:
        while search.violation is None and (generation := [*islice(cases, GENERATION)]):
            tasks = [(recording(changed, [prop]), case_seed) for _, changed, case_seed in generation]
            verdicts: list[Any] = [None] * len(tasks)
            with closing(drive(tasks, workers, partial(_verdict, prop))) as outcomes:
                for k, outcome in outcomes:
                    if outcome.status != "ok":
                        raise outcome.error or RuntimeError(outcome.traceback)
                    verdicts[k] = outcome.value
            for (case, _, case_seed), verdict in zip(generation, verdicts, strict=True):
                search.runs += 1
                search.margins.append(verdict.margin)
                for name in case:
                    search.seen[name] = search.seen.get(name, 0) + 1
                tried = Tried(case, case_seed, verdict)
                on_case(tried)
                advance(bar, 1)
                if not verdict.holds:
                    search.violation = _shrunk(scenario, prop, tried, search.runs, shrinking)
                    break
    return search


def _cases(
    scenario: Scenario, features: Mapping[str, Any], root: int, search: Search
) -> Iterator[tuple[Case, Scenario, int]]:
    """Yield random cases, each with its scenario and its seed; count those that make no valid scenario."""
    for k in range(run_seed(root, 0), run_seed(root + 1, 0)):
        rng = stream(k, "break")
        sized = scenario
        case: Case = {}
        if "team" in features and rng.random() < 0.5:  # before all features that name pursuers
            case["team"] = features["team"](rng, scenario)
            sized = _valid(scenario, case) or scenario
        case |= drawn({name: draw for name, draw in features.items() if name != "team"}, rng, sized)
        changed = _valid(scenario, case)
        if changed is None:
            search.refused += 1
        else:
            yield case, changed, k


def _valid(scenario: Scenario, case: Case) -> Scenario | None:
    """Return a scenario with the changes of a case; None if it would not be valid."""
    try:
        return applied(scenario, case)
    except ScenarioError:
        return None


def _shrunk(scenario: Scenario, prop: Property, found: Tried, searched: int, budget: int) -> Violation:
    """Return the smallest case that still violates the property, after a number of runs at most.

    Each pass tries to leave out a feature, then fewer pursuers, a shorter horizon, and numbers with fewer digits;
    another pass begins as long as one of them worked.
    """
    best, runs = found, 0
    worked = True
    while worked and runs < budget:
        worked = False
        for smaller in _smaller(scenario, best):
            if runs == budget:
                break
            changed = _valid(scenario, smaller)
            if changed is None:
                continue
            runs += 1
            verdict = judged(changed, best.seed, prop)
            if not verdict.holds:
                best, worked = Tried(smaller, best.seed, verdict), True
                break
    return Violation(applied(scenario, best.case), best.seed, prop, best.verdict, best.case, found.case, searched, runs)


def _smaller(scenario: Scenario, tried: Tried) -> Iterator[Case]:
    """Yield cases that are simpler than one, the simplest first."""
    case = tried.case
    if len(case) > 1:
        for name in case:
            yield {other: changes for other, changes in case.items() if other != name}
    changed = applied(scenario, case)
    for size in SIZES:
        if size < changed.team.count:
            yield case | {"team": {"team.count": size}}
    for share in (0.25, 0.5, 0.75):
        horizon = float(f"{share * changed.horizon:.2g}")
        if horizon > tried.verdict.at:
            yield case | {"horizon": {"horizon": horizon}}
    for name, changes in case.items():
        for digits in (1, 2):
            if (rounded := _rounded(changes, digits)) != changes:
                yield case | {name: rounded}
        if "end" in changes.get("fault", {}):
            yield case | {name: {"fault": {key: value for key, value in changes["fault"].items() if key != "end"}}}


def _rounded(value: Any, digits: int) -> Any:
    """Return a value whose numbers have at most some digits."""
    if isinstance(value, dict):
        return {key: _rounded(entry, digits) for key, entry in value.items()}
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value

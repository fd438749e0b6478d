"""Makes the case of a violation smaller as long as the *same* property stays violated.

A shrinker that accepts any violation may end with a failure other than the one that was found.
"""

from collections.abc import Callable, Collection, Iterator
from functools import partial
from math import inf
from typing import Any, NamedTuple

from desim.analysis.properties import Judgement
from desim.scenario.scenario import Scenario
from desim.study.breaking.case_log import CaseRun
from desim.study.breaking.features import SIZES, Case, applied, changed_or_none

SHRINKING = 60
"""The greatest number of cases that are run to make one smaller."""
SHORTEST = 0.05
"""The least horizon of a case that is made smaller, as a share of the horizon of the scenario."""


class Tried(NamedTuple):
    """A case that was run."""

    case: Case
    seed: int
    verdict: Judgement
    failure: str = ""
    """The exception that its run raised, as text."""

    def is_broken_alike(self, other: "Tried") -> bool:
        """Return whether this case is broken as another one: by the same exception, or both without an exception."""
        return not self.verdict.holds and self.failure.partition(":")[0] == other.failure.partition(":")[0]


def shrunk(
    scenario: Scenario, violating: Tried, judge: Callable[[Scenario, int], CaseRun], budget: int = SHRINKING
) -> tuple[Tried, int]:
    """Return the smallest case that is broken alike, and the number of cases that were run, at most `budget`.

    It leaves out features, then tries fewer pursuers, a shorter horizon, and numbers with fewer digits. Each
    simplification with which the case stays broken is kept, and all are tried again until none helps. No scenario is
    run twice. `judge` runs a scenario with a seed.
    """
    best, runs, run_scenarios = violating, 0, {repr(applied(scenario, violating.case))}
    is_smaller = True
    while is_smaller:
        is_smaller = False
        for simplify in _simplifications(scenario, best):
            case = simplify(best)
            changed = None if case is None else changed_or_none(scenario, case)
            if case is None or changed is None:
                continue
            if repr(changed) == repr(applied(scenario, best.case)):  # what was left out had no effect
                best, is_smaller = best._replace(case=case), True
                continue
            if repr(changed) in run_scenarios:
                continue
            if runs == budget:
                return best, runs
            run_scenarios.add(repr(changed))
            runs += 1
            case_run = judge(changed, best.seed)
            smaller = Tried(case, best.seed, case_run.verdict, case_run.failure)
            if smaller.is_broken_alike(best):
                best, is_smaller = smaller, True
    return best, runs


Simplification = Callable[[Tried], Case | None]
"""Returns a case that is simpler than the given one; None if this simplification does not apply."""


def _simplifications(scenario: Scenario, tried: Tried) -> Iterator[Simplification]:
    """Yield the simplifications of a case, those that save most first; each is given the smallest case so far."""
    names = [name for name in tried.case if name != "horizon"]
    if len(names) > 2:  # half of the features at once
        yield partial(_without, names[::2])
        yield partial(_without, names[1::2])
    yield from (partial(_without, [name]) for name in names)
    yield from (partial(_with_size, scenario, size) for size in SIZES)
    yield from (partial(_shorter, scenario, share) for share in (0.25, 0.5, 0.75))
    yield from (partial(_without_end, name) for name in names)
    yield from (partial(_rounded_in, name, digits) for name in names for digits in (1, 2))


def _without(names: Collection[str], tried: Tried) -> Case | None:
    """Return a case without the features of some names."""
    case = {name: changes for name, changes in tried.case.items() if name not in names}
    return None if len(case) == len(tried.case) else case


def _with_size(scenario: Scenario, size: int, tried: Tried) -> Case | None:
    """Return a case with fewer pursuers."""
    is_smaller = size < applied(scenario, tried.case).team.count
    return tried.case | {"team": {"team.count": size}} if is_smaller else None


def _shorter(scenario: Scenario, share: float, tried: Tried) -> Case | None:
    """Return a case with a share of its horizon, if the violation comes before the new end."""
    horizon = float(f"{share * applied(scenario, tried.case).horizon:.2g}")
    is_enough = horizon > max(tried.verdict.at, SHORTEST * scenario.horizon)
    return tried.case | {"horizon": {"horizon": horizon}} if is_enough else None


def _without_end(name: str, tried: Tried) -> Case | None:
    """Return a case in which the fault of a feature never ends."""
    fault = tried.case.get(name, {}).get("fault", {})
    endless = {key: value for key, value in fault.items() if key != "end"}
    return None if endless == fault else tried.case | {name: {"fault": endless}}


def _rounded_in(name: str, digits: int, tried: Tried) -> Case | None:
    """Return a case in which the numbers of a feature have at most some digits."""
    changes = tried.case.get(name, {})
    rounded = _rounded(changes, digits)
    return None if rounded == changes else tried.case | {name: rounded}


def _rounded(value: Any, digits: int) -> Any:
    """Return a value whose numbers have at most some digits."""
    if isinstance(value, dict):
        return {key: _rounded(entry, digits) for key, entry in value.items()}
    return float(f"{value:.{digits}g}") if isinstance(value, float) and value != inf else value

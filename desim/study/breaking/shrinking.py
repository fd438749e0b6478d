"""The smallest case of its kind: what was found is made smaller as long as the *same* property stays violated.

A shrinker that accepts any violation slips to another failure than the one that was found.
"""

from collections.abc import Callable, Iterator
from math import inf
from typing import Any, NamedTuple

from desim.analysis.properties import Judgement
from desim.scenario.scenario import Scenario
from desim.study.breaking.case_log import CaseRun
from desim.study.breaking.features import SIZES, Case, applied, changed_or_none

SHRINKING = 60
"""The greatest number of cases that are tried to make one smaller."""
SHORTEST = 0.05
"""The least horizon of a case that is made smaller, as a share of that of the scenario."""


class Tried(NamedTuple):
    """A case that was run."""

    case: Case
    seed: int
    verdict: Judgement
    failure: str = ""
    """The exception that its run raised, as text."""

    def is_broken_alike(self, other: "Tried") -> bool:
        """Return whether this case is broken as another one: by the same exception, or without one."""
        return not self.verdict.holds and self.failure.partition(":")[0] == other.failure.partition(":")[0]


def shrunk(
    scenario: Scenario, violating: Tried, judged: Callable[[Scenario, int], CaseRun], budget: int = SHRINKING
) -> tuple[Tried, int]:
    """Return the smallest case that still violates, and the number of cases that were run; at most `budget`.

    It leaves out features, then tries fewer pursuers, a shorter horizon, and numbers with fewer digits. What works is
    kept, and no case is run twice.

    Args:
        scenario: the scenario that the cases change.
        violating: the case that violates.
        judged: judges a scenario and a seed.
        budget: the greatest number of cases to run.
    """
    best, runs, seen = violating, 0, {repr(applied(scenario, violating.case))}
    worked = True
    while worked:
        worked = False
        for smaller in _smaller(scenario, best):
            if runs == budget:
                return best, runs
            changed = changed_or_none(scenario, smaller)
            if changed is None or repr(changed) in seen:
                continue
            seen.add(repr(changed))
            runs += 1
            case_run = judged(changed, best.seed)
            tried = Tried(smaller, best.seed, case_run.verdict, case_run.failure)
            if tried.is_broken_alike(best):
                best, worked = tried, True
                break
    return best, runs


def _smaller(scenario: Scenario, tried: Tried) -> Iterator[Case]:
    """Yield cases that are simpler than one, the simplest first."""
    case = tried.case
    names = [name for name in case if name != "horizon"]
    if len(names) > 2:  # half of the features at once
        for half in (names[::2], names[1::2]):
            yield {name: changes for name, changes in case.items() if name not in half}
    for name in names:
        yield {other: changes for other, changes in case.items() if other != name}
    changed = applied(scenario, case)
    for size in SIZES:
        if size < changed.team.count:
            yield case | {"team": {"team.count": size}}
    for share in (0.25, 0.5, 0.75):
        horizon = float(f"{share * changed.horizon:.2g}")
        if horizon > max(tried.verdict.at, SHORTEST * scenario.horizon):
            yield case | {"horizon": {"horizon": horizon}}
    for name, changes in case.items():
        fault = changes.get("fault", {})
        if "end" in fault:
            yield case | {name: {"fault": {key: value for key, value in fault.items() if key != "end"}}}
        for digits in (1, 2):
            rounded = _rounded(changes, digits)
            if rounded != changes and name != "horizon":  # which might grow
                yield case | {name: rounded}


def _rounded(value: Any, digits: int) -> Any:
    """Return a value whose numbers have at most some digits."""
    if isinstance(value, dict):
        return {key: _rounded(entry, digits) for key, entry in value.items()}
    return float(f"{value:.{digits}g}") if isinstance(value, float) and value != inf else value

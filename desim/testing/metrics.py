"""The check of a metric: `check_metric`."""

from math import isinf
from pathlib import Path
from typing import Any

from desim.analysis.measuring import summary
from desim.config.arguments import naming_arguments
from desim.config.named_code import load_named
from desim.kernel.core.trace_file import line_of
from desim.kernel.models.faults import Crash
from desim.kernel.models.links import Links
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording, Scenario
from desim.simulation.run import Result, run
from desim.testing.judging import SEED, Subject

_CLOSE: dict[str, Any] = {"evader": Evader(position=(9.0, 8.0))}
SITUATIONS: dict[str, dict[str, Any]] = {
    "a run that ends at the horizon": {"horizon": 0.5},
    "a run that ends with a capture": {"horizon": 30.0, "team": Team(count=3, speeds=5.0)},
    "a run that ends at time 0": {"team": Team(count=1, positions=((9.0, 8.0),)), **_CLOSE},
    "a run of two evaders": {"horizon": 0.5, "evader": Evader(count=2)},
    "a run without positions": {"horizon": 0.5, "record": Recording(trajectory=0.0)},
    "a static run with messages": {
        "horizon": 0.5,
        "motion": Motion(static=True),
        "record": Recording(messages=True),
        "network": Links(latency=0.1, loss=0.5),
    },
    "a run with a crash": {"horizon": 0.5, "fault": (Crash(node=0, start=0.1, end=0.2),)},
}
"""Scenarios in which a metric may be undefined, but not fail."""


@naming_arguments
def check_metric(metric: Any, *, limit: float = 10.0) -> None:
    """Check a metric; if you are unsure whether yours is right, run this.

    It computes the metric of runs in which it may be undefined: without a capture, at time 0, without recorded
    positions or messages, with crashes, with two evaders. It checks that the value is a finite number, True, False or
    None; that it is the same if it is computed again; and that the trace is not changed.

    Args:
        metric: a function of the result, a `Metric`, or "module:name".
        limit: the time that each run may take, s of wall time.

    Raises:
        ContractError: an AssertionError; if the metric is wrong, with the run, the value and what is expected.
    """
    function = load_named(metric, Path.cwd()) if isinstance(metric, str) else metric
    tested = Subject(function, metric if isinstance(metric, str) else getattr(metric, "__name__", "the metric"))
    for where, parts in SITUATIONS.items():
        with tested.judged(where, limit):
            _check(tested, function, where, run(Scenario(**{"team": Team(count=3)} | parts), SEED))


def _check(tested: Subject, metric: Any, where: str, result: Result) -> None:
    lines = list(map(line_of, result.trace))
    first, second = (summary(result, {"tested": metric})["tested"] for _ in range(2))
    call = f"metric(result) of {where}"
    tested.require(first == second, f"{call} is {first} and, computed again, {second}: expected equal values")
    tested.require(
        first is None or not isinf(first), f"{call} is {first}, expected a finite number, or nan where it is undefined"
    )
    tested.require(list(map(line_of, result.trace)) == lines, f"{call} changes the trace")

"""The check of strategies of evaders: `check_evader`."""

from cmath import rect
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from desim.config.arguments import naming_arguments, value_text
from desim.config.python_numbers import as_complex
from desim.pursuit.core.state import State
from desim.pursuit.core.traits import StrategyTraits
from desim.pursuit.evaders.evasion import STRATEGIES
from desim.pursuit.evaders.observation import EvaderObservation
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Scenario
from desim.testing.judging import Subject, subject, twice

ROUNDING = 1e-9
"""Tolerance of the length of a heading."""

_SITUATIONS: tuple[tuple[str, dict[str, Any], int, int], ...] = (
    ("a run with one pursuer", {}, 1, 1),
    ("a run with five pursuers", {}, 5, 1),
    ("a run without pursuers in sight", {"sensing_range": 0.0}, 2, 1),
    ("a run in which it reacts 0.2 s late", {"reaction_delay": 0.2}, 2, 1),
    ("a run with two evaders", {}, 3, 2),
)
"""Situations: the description, the keys of the evader, and the numbers of pursuers and evaders."""


class _Case(NamedTuple):
    """What an evader observes."""

    pursuers: int
    heading: complex
    handover: bool
    is_reached: bool
    """Whether a pursuer is where the evader is."""

    def __str__(self) -> str:
        reached = ", one at its own position" if self.is_reached else ""
        return f"strategy(state, rng) with {self.pursuers} pursuers in sight{reached} and heading {self.heading:.3g}"

    def observation(self) -> EvaderObservation:
        """Create the observation."""
        rng = np.random.default_rng(self.pursuers)
        places = rng.uniform(0.0, 20.0, (2, self.pursuers))
        pursuers, evader = places[0] + 1j * places[1], 9.0 + 8.0j
        if self.is_reached and self.pursuers:
            pursuers[-1] = evader
        state = State(300_000_000, pursuers, evader, np.arange(self.pursuers) % 2 == 0)
        speeds, elapsed = np.linspace(1.0, 2.0, self.pursuers), 0.01 if self.heading else 0.0
        return EvaderObservation(state, speeds, 0.9, 0.1, self.heading, elapsed, self.handover)


@naming_arguments
def check_evader(strategy: Any, *, limit: float = 10.0) -> None:
    """Check the strategy of an evader; if you are unsure whether yours is right, run this.

    It checks that the heading is a finite complex number of length at most 1, also without a pursuer in sight and with
    one at the position of the evader; that equal observations and generators give equal headings; that the observation
    is not changed, and `state.handover` has no effect unless the strategy has `listens = True`; and that two runs of
    several scenarios are equal.

    Args:
        strategy: an object, a class that needs no parameters, a kind, or "module:name".
        limit: the time that each part may take, s of wall time.

    Raises:
        ContractError: an AssertionError; if the model is wrong, with the call, the input and what is expected.
    """
    tested = subject(strategy, STRATEGIES, "strategy of an evader")
    with tested.judged("strategy(state, rng)", limit):
        numbers, headings, truths = (0, 1, 2, 5), (0j, rect(1.0, 0.7)), (False, True)
        for case in product(numbers, headings, truths, truths):
            _check(tested, _Case(*case))
    # An evader with a recorded motion begins where its record begins.
    place = {} if hasattr(tested.model, "start") else {"position": (9.0, 8.0)}
    for where, keys, pursuers, evaders in _SITUATIONS:
        players = {"team": Team(count=pursuers), "evader": (Evader(strategy=tested.model, **place, **keys),) * evaders}
        twice(tested, where, partial(Scenario, horizon=1.0, **players), limit=limit)


def _check(tested: Subject, case: _Case) -> None:
    """Check the heading that a strategy chooses in one case."""
    heading = _heading(tested, case)
    again = _heading(tested, case)
    tested.require(
        heading == again,
        f"{case} returns {heading} and, for an equal state and rng, {again}: draw from rng only; the heading before is"
        " state.heading, and the time since then state.elapsed",
    )
    if not StrategyTraits.of(tested.model).listens:
        other = _heading(tested, case._replace(handover=not case.handover))
        text = "state.handover is always False in a run unless the strategy has listens = True"
        tested.require(other == heading, f"{case} depends on state.handover: {text}")


def _heading(tested: Subject, case: _Case) -> complex:
    """Return the heading that a fresh copy of a strategy chooses, and require that it is valid."""
    state, untouched = case.observation(), case.observation()
    with tested.blaming(str(case)), tested.fresh() as strategy:
        answer: Any = strategy(state, np.random.default_rng(1))
    for name, value in vars(untouched).items():
        after: Any = getattr(state, name, None)
        tested.require(np.array_equal(after, value), f"{case} changes state.{name} from {value} to {after}; copy it")
    heading = as_complex(answer)
    if heading != heading:  # nan, which `as_complex` returns if the answer is no number
        expected = "a heading: a finite complex number x + 1j * y of length at most 1"
        tested.fail(f"{case} returns {value_text(answer)}, expected {expected}")
    length = abs(heading)
    tested.require(
        length <= 1.0 + ROUNDING,
        f"{case} returns {heading} of length {length:.4g}, expected at most 1: the velocity is the heading times the"
        " speed",
    )
    return heading

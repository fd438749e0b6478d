"""Temperatures of log-linear learning: the randomness of decisions and its cooling schedule.

A temperature is a function of eta, the number of slots that have passed. A slot lasts delta, the mean time between two
revisions in the team (`Schedule.mean_slot`). The function returns the *inverse* temperature 1/tau in 1/s, which is 0
for an infinite temperature.
"""

from collections.abc import Iterator
from math import exp, isnan, log
from typing import Annotated, Any, Literal, Protocol

from pydantic import Field

from desim.config.answers import wrong_answer
from desim.config.choice import OneOf
from desim.config.model import Positive, Value
from desim.config.python_numbers import as_real
from desim.pursuit.team.agent import Agent


class Temperature(Protocol):
    """A cooling schedule: `temperature(eta)` is 1/tau after eta slots, 1/s."""

    def __call__(self, eta: float) -> float: ...  # noqa: D102


class PaperTau(Value):
    """tau = scale / eta^2 (Lee & Bakolas, Algorithm 1): infinite at first; if scale = 10 s, 0.001 s after 100 slots."""

    kind: Literal["paper"] = "paper"
    scale: Positive = 10.0
    """Temperature after the first slot, s."""

    def __call__(self, eta: float) -> float:
        """Return 1/tau, 1/s."""
        return eta * eta / self.scale


class ConstantTau(Value):
    """A constant temperature. In a static potential game with serial revisions the Gibbs distribution is stationary."""

    kind: Literal["constant"] = "constant"
    value: Positive = 0.1
    """Temperature tau, s.

    Far above the differences of the gains, actions are random; far below, the team keeps the first equilibrium that it
    finds.

    If in doubt, use a tenth of the usual difference between two capture times.
    """

    def __call__(self, eta: float) -> float:
        """Return 1/tau, 1/s."""
        return 1.0 / self.value


class LogarithmicTau(Value):
    """tau = scale / ln(eta + offset). In a static game the probability of the best profile then tends to 1.

    The best profile of actions is the one with the greatest potential. Its probability tends to 1 only if `scale` is
    large enough: Hajek 1988, "Cooling Schedules for Optimal Annealing", gives the least such value.
    """

    kind: Literal["logarithmic"] = "logarithmic"
    scale: Positive = 1.0
    """The constant c in tau = c / ln(eta + k0), s."""
    offset: Annotated[float, Field(gt=1, allow_inf_nan=False, strict=True)] = 2.0
    """The constant k0 in tau = c / ln(eta + k0), slots; greater than 1."""

    def __call__(self, eta: float) -> float:
        """Return 1/tau, 1/s."""
        return log(eta + self.offset) / self.scale


class GeometricTau(Value):
    """tau decreases by a constant factor per slot, down to a floor (Kirkpatrick, Gelatt & Vecchi 1983)."""

    kind: Literal["geometric"] = "geometric"
    first: Positive = 1.0
    """Temperature of slot 0, s."""
    ratio: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.97
    """Factor from one slot to the next, in (0, 1).

    Cooling by a factor e takes about 1 / (1 - ratio) slots. Fast cooling freezes the team before each pursuer has
    revised a few times.

    If in doubt, use 1 - 1/(3 N) for a team of N.
    """
    floor: Positive = 0.001
    """Least temperature, s."""

    def __call__(self, eta: float) -> float:
        """Return 1/tau, 1/s."""
        exponent = min(-eta * log(self.ratio), log(self.first / self.floor))  # the second one is that of the floor
        return exp(exponent) / self.first


ReheatingEvent = Literal["new_teammate", "silence", "order"]


class AdaptiveTau(Value):
    """A wrapper of a cooling schedule: each pursuer restarts it at its own reheating events (`reheat_on`)."""

    kind: Literal["adaptive"] = "adaptive"
    cooling: Annotated[Temperature, OneOf(PaperTau, ConstantTau, LogarithmicTau, GeometricTau, takes=("eta",))] = (
        GeometricTau()
    )
    """Cooling between two reheating events."""
    reheat_on: tuple[ReheatingEvent, ...] = ("new_teammate", "silence", "order")
    """Events that restart the cooling. new_teammate: an announcement of a teammate is received for the first time or
    after a time-out; silence: a teammate times out (`announce.belief_timeout`); order: an evader is captured, or
    another pursuer now has the least capture time for an evader, as far as known."""

    def __call__(self, eta: float) -> float:
        """Return 1/tau, 1/s, at eta slots after the last reheating event."""
        return self.cooling(eta)

    def slots_since(self, me: Agent, slot: float) -> Iterator[float]:
        """Yield at each turn the number of slots (of length `slot`, s) since the last reheating event.

        Before the first event, slots are counted from the start of the run, or from the last restart at which the
        pursuer lost its memory.
        """
        cooling_start = me.now if me.restarts else 0.0
        teammates, earliest = None, [me.id]  # both of the previous turn; no teammates before the first one
        while True:
            beliefs = me.beliefs()
            earliest_now = [_earliest(me, evader) for evader in me.evaders()]
            is_reheated = teammates is not None and (
                ("new_teammate" in self.reheat_on and bool(beliefs.keys() - teammates))
                or ("silence" in self.reheat_on and bool(teammates - beliefs.keys()))
                or ("order" in self.reheat_on and earliest_now != earliest)
            )
            cooling_start = me.now if is_reheated else cooling_start
            teammates, earliest = beliefs.keys(), earliest_now
            yield max(me.now - cooling_start, 0.0) / slot


def _earliest(me: Agent, evader: int) -> int:
    """Return the pursuer with the least known capture time for an evader; unknown capture times (nan) do not count."""
    times = {j: belief.capture_time for j, belief in me.beliefs(evader=evader).items()}
    candidates = [(time, j) for j, time in times.items() if not isnan(time)]
    return min([*candidates, (me.capture_time(evader), me.id)])[1]


TEMPERATURES = OneOf(
    PaperTau, ConstantTau, LogarithmicTau, GeometricTau, AdaptiveTau, takes=("eta",), number=("constant", "value")
)


def slots_seen(tau: Temperature, me: Agent, slot: float) -> Iterator[float]:
    """Yield eta at each turn: the number of slots (of length `slot`, s) since the start or the last reheating event."""
    if isinstance(tau, AdaptiveTau):
        yield from tau.slots_since(me, slot)  # never ends
    while True:
        yield max(me.now, 0.0) / slot


def inverse_temperatures(tau: Temperature, me: Agent, slot: float) -> Iterator[float]:
    """Yield 1/tau at each turn, 1/s; see `slots_seen`.

    Raises:
        ValueError: if a user's temperature returns anything else than a number of at least 0.
    """
    for eta in slots_seen(tau, me, slot):
        answer: Any = tau(eta)
        inverse = answer if type(answer) is float else as_real(answer)
        if not inverse >= 0.0:
            raise wrong_answer("a temperature should return 1/tau, a number >= 0 in 1/s", answer, tau)
        yield inverse

"""Temperatures of log-linear learning: the randomness of decisions and its cooling schedule.

A temperature is called with eta = t / delta, the number of slots that have passed, and returns the *inverse*
temperature 1/tau in 1/s, which is 0 for an infinite temperature.
"""

from collections.abc import Iterator
from math import exp, isnan, log
from typing import Annotated, Literal, Protocol

from pydantic import Field

from desim.config.choice import OneOf
from desim.config.model import Positive, Value
from desim.pursuit.agent import Agent


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
    """A constant temperature; the distribution of profiles is then the Gibbs law."""

    kind: Literal["constant"] = "constant"
    value: Positive = 0.1
    """Temperature tau, s."""

    def __call__(self, eta: float) -> float:
        """Return 1/tau, 1/s."""
        return 1.0 / self.value


class LogarithmicTau(Value):
    """tau = scale / ln(eta + offset): slow enough to find the best profile of a fixed game with probability 1.

    This holds if `scale` is large enough; Hajek 1988, "Cooling Schedules for Optimal Annealing", gives the least value.
    """

    kind: Literal["logarithmic"] = "logarithmic"
    scale: Positive = 1.0
    """The constant c, s."""
    offset: Annotated[float, Field(gt=1, allow_inf_nan=False, strict=True)] = 2.0
    """The constant k0 > 1, slots."""

    def __call__(self, eta: float) -> float:
        """Return 1/tau, 1/s."""
        return log(eta + self.offset) / self.scale


class GeometricTau(Value):
    """tau decreases by a constant factor per slot, down to a floor (Kirkpatrick, Gelatt & Vecchi 1983)."""

    kind: Literal["geometric"] = "geometric"
    first: Positive = 1.0
    """Temperature of slot 0, s."""
    ratio: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.97
    """Factor from one slot to the next, in (0, 1)."""
    floor: Positive = 0.001
    """Least temperature, s."""

    def __call__(self, eta: float) -> float:
        """Return 1/tau, 1/s."""
        coldest = log(self.first / self.floor)
        return exp(min(-eta * log(self.ratio), coldest)) / self.first


Surprise = Literal["neighbour", "silence", "order"]


class AdaptiveTau(Value):
    """Another cooling schedule, restarted in each pursuer separately at each of its surprises (`reheat_on`)."""

    kind: Literal["adaptive"] = "adaptive"
    cooling: Annotated[Temperature, OneOf(PaperTau, ConstantTau, LogarithmicTau, GeometricTau, takes=("eta",))] = (
        GeometricTau()
    )
    """Cooling between two surprises."""
    reheat_on: tuple[Surprise, ...] = ("neighbour", "silence", "order")
    """Events that restart the cooling. neighbour: a teammate is heard for the first time or after a time-out; silence:
    a teammate times out (`announce.belief_timeout`); order: an evader is captured, or the least capture time for an
    evader, among the pursuer and its known teammates, passes to another of them."""

    def __call__(self, eta: float) -> float:
        """Return 1/tau, eta slots after the last surprise, 1/s."""
        return self.cooling(eta)

    def slots_since(self, me: Agent, slot: float) -> Iterator[float]:
        """Yield the number of slots (of length `slot`, s) since the last surprise at each turn."""
        since, heard, first = me.now if me.restarts else 0.0, None, [me.id]
        while True:
            beliefs = me.beliefs()
            ahead = [_first(me, evader) for evader in me.evaders()]
            surprised = heard is not None and (
                ("neighbour" in self.reheat_on and bool(beliefs.keys() - heard))
                or ("silence" in self.reheat_on and bool(heard - beliefs.keys()))
                or ("order" in self.reheat_on and ahead != first)
            )
            since = me.now if surprised else since
            heard, first = beliefs.keys(), ahead
            yield max(me.now - since, 0.0) / slot


def _first(me: Agent, evader: int) -> int:
    """Return the pursuer with the least capture time for an evader, among the agent and teammates of known time."""
    known = [(each.capture_time, j) for j, each in me.beliefs(evader=evader).items() if not isnan(each.capture_time)]
    return min([*known, (me.capture_time(evader), me.id)])[1]


TEMPERATURES = OneOf(
    PaperTau, ConstantTau, LogarithmicTau, GeometricTau, AdaptiveTau, takes=("eta",), number=("constant", "value")
)


def slots_seen(tau: Temperature, me: Agent, slot: float) -> Iterator[float]:
    """Yield eta at each turn: the number of slots (of length `slot`, s) since the start or the last surprise."""
    if isinstance(tau, AdaptiveTau):
        yield from tau.slots_since(me, slot)
    while True:
        yield max(me.now, 0.0) / slot

"""Temperatures of log-linear learning: how much chance there is in a decision, and how it fades.

A temperature is called with eta = t / delta, the number of slots that have passed, and answers with the *inverse*
temperature 1/tau in 1/s: an infinite temperature is then an ordinary number.
"""

from typing import Literal, Protocol

from desim.value import Positive, Value


class Temperature(Protocol):
    """A cooling schedule: `temperature(eta)` is 1/tau after eta slots, 1/s."""

    def __call__(self, eta: float) -> float: ...  # noqa: D102


class PaperTau(Value):
    """tau = scale / eta^2 (Lee & Bakolas, Algorithm 1): infinite at first, 0.001 after a hundred slots."""

    kind: Literal["paper"] = "paper"
    scale: Positive = 10.0
    """Temperature after the first slot, s."""

    def __call__(self, eta: float) -> float:
        """Return 1/tau, 1/s."""
        return eta * eta / self.scale


class ConstantTau(Value):
    """The same temperature for ever; the profile then follows the Gibbs law."""

    kind: Literal["constant"] = "constant"
    value: Positive = 0.1
    """Temperature tau, s."""

    def __call__(self, eta: float) -> float:
        """Return 1/tau, 1/s."""
        return 1.0 / self.value

"""How the evader flees: a strategy maps the state of the pursuit to a heading."""

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from desim.value import Value
from desim.pursuit.state import State


class Strategy(Protocol):
    """An evader's strategy: `strategy(state, rng)` is a (2,) unit heading, or zeros to stand still."""

    def __call__(self, state: State, rng: np.random.Generator) -> NDArray[np.float64]: ...  # noqa: D102


class PureEvasion(Value):
    """Flee straight from the nearest pursuer, active or not (Lee & Bakolas, "Pure evasion")."""

    kind: Literal["pure_evasion"] = "pure_evasion"

    def __call__(self, state: State, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return u_e = (x_e - x_k) / |x_e - x_k| for the nearest pursuer k; zeros if it is right here."""
        distance = state.distances[state.nearest]
        return state.offsets[state.nearest] / (distance or 1.0)

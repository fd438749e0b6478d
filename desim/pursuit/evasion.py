"""How the evader flees: a strategy maps the state of the pursuit to a heading."""

from typing import Literal, Protocol

import numpy as np

from desim.pursuit.state import State
from desim.value import Value


class Strategy(Protocol):
    """An evader's strategy: `strategy(state, rng)` is a unit heading (a complex number), or 0 to stand still."""

    def __call__(self, state: State, rng: np.random.Generator) -> complex: ...  # noqa: D102


class PureEvasion(Value):
    """Flee straight from the nearest pursuer, active or not (Lee & Bakolas, "Pure evasion")."""

    kind: Literal["pure_evasion"] = "pure_evasion"

    def __call__(self, state: State, rng: np.random.Generator) -> complex:
        """Return u_e = (x_e - x_k) / |x_e - x_k| for the nearest pursuer k; 0 if it is right here."""
        away = complex(state.offsets[state.nearest])
        return away / abs(away) if away else 0j

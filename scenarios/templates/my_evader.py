"""The evasion strategy MyEvader, for scenario files and scripts.

desim replay my_evader.toml --allow-import            a page that plays a run with it
desim sweep my_evader.toml --allow-import             the grid of its parameters
"""

from cmath import rect
from math import radians
from typing import Annotated

import numpy as np
from pydantic import Field

from desim.config.model import Value
from desim.pursuit.evaders.observation import EvaderObservation


class MyEvader(Value):
    """Flee from the nearest pursuer at an angle.

    Every field is a key of the table `evader.strategy`.
    """

    angle: Annotated[float, Field(ge=-180, le=180, strict=True)] = 30.0
    """Angle to the left of the straight line away from the nearest pursuer, degrees."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading, a complex number of length at most 1; 0 stands still.

        `state.offsets` are the (n,) vectors, m, to the evader from each of the n pursuers that it senses.
        `state.nearest` is the index of the nearest of them, or -1 if there are none. Draw from `rng` only.
        """
        if state.nearest < 0:
            return 0j
        away = complex(state.offsets[state.nearest])
        return rect(1.0, radians(self.angle)) * away / abs(away) if away else 0j

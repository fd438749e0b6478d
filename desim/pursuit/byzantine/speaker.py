"""A pursuer that speaks: the facts that it can lie about, and the announcements that can be falsified."""

from cmath import isnan
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from desim.pursuit.motion.capture import least_capture_time
from desim.pursuit.sensing.views import View

Said = Literal["truth", "chase", "stay", "opposite"]
"""The action that a liar announces: its action, a chase, no chase, or the contrary of its action."""
CHASE_OR_STAY: tuple[Said, Said] = ("chase", "stay")


@runtime_checkable
class Falsifiable(Protocol):
    """An announcement of a form that a protocol defines, such as a claim in an auction, which a liar can change."""

    def falsified(self, pursuer: int, action: int, phi: float) -> Any:
        """Return the announcement with another action and capture time phi (s) of a pursuer."""

    def phi(self, pursuer: int) -> float:
        """Return the capture time, s, that it states for a pursuer and the evader it chases; inf if it states none."""


@dataclass(frozen=True)
class Speaker:
    """A pursuer that speaks, and the facts that it can lie about.

    Attributes:
        id: the pursuer.
        view: its view of the world.
        seed: the seed of the run.
        rng: the random stream of its lies.
        now: the time, ns.
        history: its honest announcements up to now, oldest first: (time in ns, body).
    """

    id: int
    view: View
    seed: int
    rng: np.random.Generator
    now: int
    history: Sequence[tuple[int, Any]] = ()

    def action(self, says: Said) -> int:
        """Return the action that it announces: an evader, or 0."""
        true_action = self.view.state.profile[self.id]
        if says == "truth" or (says == "chase" and true_action):
            return true_action
        # An inactive pursuer says that it chases the evader that it could capture first.
        return 0 if says == "stay" or true_action else min(self.view.state.at_large, key=self.phi, default=0)

    def phi(self, evader: int) -> float:
        """Return its true capture time for an evader, s; with 0, the least one for any evader at large."""
        evaders = [evader] if evader else self.view.state.at_large
        return min((self.view.capture_times_of([self.id], target)[0] for target in evaders), default=inf)

    def least_phi(self, evader: int) -> float:
        """Return the least capture time for an evader, s, that any pursuer at its position could have; see `phi`.

        Evaders of unknown position do not count.
        """
        state, position = self.view.state, self.view.state.position(self.id)
        targets = [evader] if evader else state.at_large
        places = {target: place for target in targets if not isnan(place := self.view.evader(target))}
        return min(
            (
                least_capture_time(abs(place - position), state.radius, state.top_speed, state.body(target).speed)
                for target, place in places.items()
            ),
            default=inf,
        )

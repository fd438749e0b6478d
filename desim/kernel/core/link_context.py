"""The context of one transmission: the inputs of a latency or loss model."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desim.kernel.core.positions import PositionFunction, as_position_source, distances_from
from desim.kernel.core.seeds import pair_uniform

MOST = 10_000
"""Number of called models that are kept: a model that creates another one for each message calls ever new ones."""


class CalledModels:
    """The models of one run that are not those of a link themselves, but are called by these.

    Args:
        size: number of nodes.
    """

    def __init__(self, size: int):
        self._size = size
        self._started: dict[tuple[int, int], tuple[Any, Any, Any]] = {}
        """By the `id` of a model and of the generator of a use, both objects, and the model in its state of the run."""

    def of_run(self, model: Any, start_run: Callable[[Any, int], Any], rng: np.random.Generator | None) -> Any:
        """Return what `start_run(model, size)` has returned at the first call for this model and this generator."""
        key = id(model), id(rng)
        started = self._started.pop(key, None) or (model, rng, start_run(model, self._size))
        self._started[key] = started  # the last one of those that are kept
        if len(self._started) > MOST:
            del self._started[next(iter(self._started))]
        return started[2]


@dataclass(slots=True)
class LinkContext:
    """The links of one transmission, from `src` to each of the (k,) nodes `dst`."""

    src: int
    dst: NDArray[np.intp]
    now: float = 0.0
    """Time of the transmission, s."""
    size: int = 0
    """Size of the message, bytes."""
    seed: int = 0
    """Seed of the run."""
    positions: PositionFunction | None = None
    """Returns the current positions of all nodes, m; None: the nodes have no positions."""
    known_distances: NDArray[np.float64] | None = None
    """The `distances`, if no node moves: a read-only array, the same object for the same `dst`, so a model may keep
    what it computes from it."""
    called_models: CalledModels | None = None
    """The models that models of links call; None outside of a run."""

    def of_run(self, model: Any, start_run: Callable[[Any, int], Any], rng: np.random.Generator | None) -> Any:
        """Return a model with the state of the run, for a model of a user that calls it; a new one outside of a run.

        Args:
            model: the model.
            start_run: the function `start_run(model, size)` that returns the model with the state of a run.
            rng: the generator of the model of the user; None if nothing is drawn.
        """
        models = self.called_models or CalledModels(1 + max([self.src, *self.dst.tolist()]))
        return models.of_run(model, start_run, rng)

    @property
    def distances(self) -> NDArray[np.float64]:
        """The (k,) current distances, m, between the sender and the receivers.

        Raises:
            ValueError: if the nodes have no positions.
        """
        if self.known_distances is not None:
            return self.known_distances
        if self.positions is None:
            raise ValueError("a latency or loss model that depends on distance needs the positions of the nodes")
        nodes = np.concatenate((self.dst, [self.src]))  # the sender last, so that one call returns all positions
        return distances_from(as_position_source(self.positions).of(nodes), -1)[:-1]

    def uniform(self, name: str, *, symmetric: bool = True) -> NDArray[np.float64]:
        """Return (k,) uniform draws in (0, 1), one per receiver, that stay the same throughout a run.

        Args:
            name: the name of the random quantity; different names have independent draws.
            symmetric: whether both directions of a link have the same draw.
        """
        return pair_uniform(self.seed, name, self.src, self.dst, symmetric=symmetric)

"""The hosts of the nodes: the time that a message spends at its sender before it reaches the queue of the transmitter.

Without this time, messages that several nodes create at one instant, as in rounds, start on the air at the same
nanosecond. Carrier sensing cannot avoid their collision, and no team of robots is that synchronous.

Kept equal to draws of a constant delay by
`tests/kernel/test_hosts.py::test_a_constant_delay_is_that_of_a_model_that_always_draws_it`.
"""

from collections import deque
from collections.abc import Callable, Iterator

import numpy as np

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.link_context import CalledModels, LinkContext
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.models.latency import Constant, Latency
from desim.kernel.models.link_draws import as_nanoseconds, buffered, times_of
from desim.kernel.models.traits import model_of_run
from desim.kernel.state.transmission import Transmission


class Hosts:
    """Passes each transmission on to the queue of its sender after a processing delay, in the order of sending.

    Args:
        env: the clock of the simulation.
        delay: the model of the processing delay at the sender, s.
        size: number of nodes.
        seed: the seed of the delays.
        pass_on: called with each transmission after its delay.
    """

    def __init__(self, env: Clock, delay: Latency, size: int, seed: int, pass_on: Callable[[Transmission], object]):
        self._env, self._pass_on = env, pass_on
        self._draw = _delays(env, delay, size, seed)
        self._pending: list[deque[Transmission]] = [deque() for _ in range(size)]
        """The transmissions of each node that are not passed on yet, in the order sent."""
        self._last = [0] * size
        """The time at which each node passes on its newest transmission, ns."""
        self._restarts = [0] * size
        """Number of times that each node was flushed; events scheduled before the last flush have no effect."""

    def process(self, item: Transmission) -> None:
        """Pass a transmission on after its delay, and not before an earlier one of its sender."""
        src = item.src
        self._last[src] = when = max(self._env.now + self._draw(src), self._last[src])
        self._pending[src].append(item)
        restarts = self._restarts[src]
        Instant(self._env, when, Phase.DELIVERY).callbacks.append(lambda _: self._release(src, restarts))

    def flush(self, src: int) -> list[Transmission]:
        """Remove and return the transmissions of a node that are not passed on yet."""
        flushed = list(self._pending[src])
        self._pending[src].clear()
        self._restarts[src] += 1
        self._last[src] = 0
        return flushed

    def waiting(self) -> Iterator[Transmission]:
        """Yield the transmissions that are not passed on yet."""
        for transmissions in self._pending:
            yield from transmissions

    def _release(self, src: int, restarts: int) -> None:
        if restarts == self._restarts[src]:
            self._pass_on(self._pending[src].popleft())


def _delays(env: Clock, model: Latency, size: int, seed: int) -> Callable[[int], int]:
    """Return a function that draws the next processing delay (ns) of a node."""
    if type(model) is Constant:
        constant = nanoseconds(model.value)
        return lambda _: constant
    rng, run_model, called = stream(seed, "processing"), model_of_run(model, size), CalledModels(size)
    if (buffer := buffered(run_model, rng, as_nanoseconds)) is not None:
        return lambda _: int(buffer.take(1)[0])

    def draw(src: int) -> int:
        context = LinkContext(src, np.array([src]), env.now / SECOND, called_models=called)
        return int(times_of(run_model(context, rng), 1, run_model).item())

    return draw

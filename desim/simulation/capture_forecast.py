"""The next capture, predicted from the present velocities and scheduled at its instant."""

from collections.abc import Callable
from typing import Literal

import simpy

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.units import nanoseconds
from desim.pursuit.evaders.evader import EvaderBody
from desim.pursuit.sensing.world_state import WorldState


class CaptureForecast:
    """The predicted first capture up to the end of the motion step; each `update` replaces the prediction.

    Args:
        env: the clock of the simulation.
        state: the true state of the world.
        test: see `desim.scenario.scenario.Capture`.
        capture: called at the instant of a capture, with the evader and the id of the capturer.
    """

    def __init__(
        self,
        env: Clock,
        state: WorldState,
        test: Literal["segment", "sample"],
        capture: Callable[[EvaderBody, int], None],
    ):
        self._env, self._state, self._test, self._capture = env, state, test, capture
        self._scheduled: simpy.Event | None = None

    def update(self) -> None:
        """Predict the first capture in this motion step from the present velocities, and schedule it.

        The previous prediction is dropped. A static game has no captures.
        """
        self._scheduled = None
        state = self._state
        if state.static:
            return
        now, end = state.now, state.step_end
        first: tuple[float, int] | None = None
        for evader in state.at_large:
            contact = state.body(evader).contact(now, end, state.broken, self._test)
            if contact is not None and (first is None or contact[0] < first[0]):
                first, body = contact, state.body(evader)
        if first is not None:
            after, capturer = first
            self._scheduled = Instant(self._env, min(now + nanoseconds(after), end), Phase.CAPTURE)
            self._scheduled.callbacks.append(lambda event: self._happen(event, body, capturer))

    def _happen(self, event: simpy.Event, body: EvaderBody, capturer: int) -> None:
        """Capture an evader, unless a later prediction has replaced this one."""
        if event is self._scheduled:
            self._capture(body, capturer)

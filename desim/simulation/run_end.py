"""The end of a run: by a capture, at the horizon, or by a watcher."""

from typing import Literal

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.pursuit.core.events import Ended


class RunEnd:
    """The end of one run.

    Args:
        env: the clock of the simulation.

    Attributes:
        over: SimPy event that happens when the run ends.
        outcome: how the run has ended; None while it is running.
    """

    def __init__(self, env: Clock):
        self._env = env
        self.over = env.event()
        self.outcome: Ended | None = None

    def finish(self, reason: Literal["captured", "horizon", "stopped"], capturer: int | None = None) -> None:
        """End the run at this instant; later calls have no effect."""
        if self.outcome is None:
            self.outcome = Ended(self._env.now, reason, capturer)
            self.over.succeed()

    def stop(self) -> None:
        """End the run after the positions of this instant are recorded.

        The call may come at one of several events of the instant, and the others belong to the trace, too.
        """
        Instant(self._env, self._env.now, Phase.SAMPLE + 1).callbacks.append(lambda _: self.finish("stopped"))

"""Evidence: what a pursuer observes of its teammates, and whether it refutes what they announce."""

from math import inf
from typing import Any

from desim.kernel.core.clock import NodeClock
from desim.kernel.core.events import Trace
from desim.kernel.core.records import Record
from desim.kernel.core.units import SECOND
from desim.kernel.network import Network
from desim.kernel.state.inbox import Message
from desim.pursuit.byzantine.speaker import Falsifiable
from desim.pursuit.core.events import Distrusted
from desim.pursuit.motion.capture import least_capture_time
from desim.pursuit.sensing.views import View
from desim.pursuit.team.agent import Voice
from desim.pursuit.team.announcements import Located, TimedAssignment, action_in_game, announced_action

MARGIN = 1e-6
"""Share by which a claim may go beyond a physical bound, for rounding."""


class Witness:
    """The observations of one pursuer.

    It observes positions, and whether a teammate stands still or chases an evader; a motion is evidence after it has
    lasted for a motion step.

    Args:
        pursuer: its id.
        view: its view of the world.
        clock: its local clock.
        network: the network that delivers messages to it.
        voice: sends its messages.
        step: the motion step, ns.
        trace: receives the events `Distrusted`.
    """

    def __init__(
        self, pursuer: int, view: View, clock: NodeClock, network: Network, voice: Voice, step: int, trace: Trace
    ):
        self._id, self._view, self._clock = pursuer, view, clock
        self._network, self._voice, self._step, self._trace = network, voice, step, trace

    @property
    def now(self) -> int:
        """The local time, ns."""
        return self._clock.stamp

    def mail(self, port: str) -> list[Message]:
        """Remove and return the unread messages of a port."""
        return self._network.inbox(self._id, port).drain()

    def send(self, body: Any, port: str) -> None:
        """Send a message to all neighbours."""
        self._voice.send(self._id, None, body, port=port)

    def note(self, suspect: int, *, distrusted: bool) -> None:
        """Record that the pursuer begins or stops to distrust a teammate."""
        self._trace.append(Distrusted(self._clock.true, self._id, suspect, distrusted))

    def refutes(self, record: Record, radius: float) -> bool:
        """Return whether a record contradicts what the pursuer observes now; initial beliefs are never refuted.

        Args:
            record: the record of a teammate.
            radius: distance up to which the pursuer observes teammates, m.
        """
        state, j = self._view.state, record.src
        if record.seq == 0 or state.static or state.speed(j) == 0.0:
            return False
        if abs(state.position(j) - state.position(self._id)) > radius:
            return False
        return self._refutes_action(record) or self._refutes_time(record) or self._refutes_position(record)

    def _refutes_action(self, record: Record) -> bool:
        """Return whether, at its announcement, the sender had taken another action for at least a motion step.

        The chase of a captured evader is not refuted: heartbeats may repeat it until the next decision of the sender.
        """
        state, action = self._view.state, announced_action(record.body)
        evident_from = state.acting_since[record.src] + self._step
        if action is None or evident_from > record.stamp or state.profile[record.src] == action:
            return False
        return not (0 < action <= state.evader_count and state.body(action).captured is not None)

    def _refutes_time(self, record: Record) -> bool:
        """Return whether the announced capture time is less than physics allows.

        Since the announcement the distance has grown by at most (v_max + v_e) times its age.
        """
        state, body = self._view.state, record.body
        action = action_in_game(body, state.evader_count)
        if isinstance(body, TimedAssignment):
            phi = body.capture_time
        elif isinstance(body, Falsifiable) and action:
            phi = body.phi(record.src)
        else:
            return False
        elapsed = max(self._clock.stamp - record.stamp, 0)
        # The announced time of an inactive pursuer may refer to any evader that was at large then, so it is refuted
        # only if it is too short for each of them.
        sent = state.now - elapsed
        evaders = [action] if action else [b.number for b in state.bodies if b.captured is None or b.captured >= sent]
        if not all(self._view.unlimited or self._view.sees(evader) for evader in evaders):
            return False
        age, least = elapsed / SECOND, inf
        for evader in evaders:
            speed = state.body(evader).speed
            grown = (state.top_speed + speed) * age if age else 0.0  # an infinite speed times 0 would be nan
            distance = abs(self._view.evader(evader) - state.position(record.src)) - grown
            least = min(least, least_capture_time(distance, state.radius, state.top_speed, speed))
        return phi < least * (1.0 - MARGIN) - MARGIN

    def _refutes_position(self, record: Record) -> bool:
        """Return whether the sender cannot have come from the announced position to where it is now."""
        body, state = record.body, self._view.state
        if not isinstance(body, Located):
            return False
        age = max(self._clock.stamp - record.stamp, 0) / SECOND
        moved = abs(state.position(record.src) - complex(body.x, body.y))
        speed = state.speed(record.src) + state.environment.top_speed
        return moved > speed * age * (1.0 + MARGIN) + MARGIN

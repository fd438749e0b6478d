"""The frames on the air of a channel for which nodes contend, and the receivers at which they are lost.

All frames that overlap a frame are known at its end. The model of interference then decides which receivers lose it.
"""

import numpy as np

from desim.config.answers import wrong_answer
from desim.config.arrays import Bools, Floats, Integers, array_of
from desim.config.errors import KeyedError, Problem
from desim.kernel.core.clock import Clock
from desim.kernel.core.events import Cause
from desim.kernel.core.positions import PositionSource, distances_from
from desim.kernel.core.seeds import pair_uniform
from desim.kernel.core.units import SECOND
from desim.kernel.models.coherence import ChannelState
from desim.kernel.models.interference import Frame, LoRaSignal, Overlap
from desim.kernel.models.medium import LoRa, Radio
from desim.kernel.models.traits import InterferenceTraits
from desim.kernel.topology.correlated_channel import Ends, uncorrelated
from desim.kernel.topology.topology import Topology

FAR = 1e150
"""Distance, m, that stands for an opaque wall: the power there is 0, but levels in dB are finite."""


class Air:
    """The frames that are on the air.

    Args:
        env: the clock of the simulation.
        medium: the model of the medium, with its model of interference.
        topology: the links of the graph, and which of them are within range.
        positions: the current positions of the nodes; None: unknown.
        seed: the seed of the run.

    Attributes:
        hears: returns which nodes are tuned to the frames of a node; None: all are.

    Raises:
        ValueError: if the model of interference needs positions and there are none, or the nodes do not fit the medium.
    """

    def __init__(self, env: Clock, medium: Radio, topology: Topology, positions: PositionSource | None, seed: int):
        self._env, self._medium, self._topology, self._positions, self._seed = env, medium, topology, positions, seed
        self._interference = medium.reception
        traits = InterferenceTraits.of(medium.reception)
        self._locks, self._has_noise, self._cause = traits.lock, traits.has_noise, traits.cause
        self._walls = None if topology.walls is None else topology.walls.with_exponent(traits.exponent)
        self._all = np.arange(topology.size)
        self.hears = None
        if isinstance(medium, LoRa) and (medium.is_tuned or type(medium).hears is not LoRa.hears):
            self.hears = medium.hears
        self._frames: list[Frame] = []
        self._busy = self._busy_since = 0
        medium.check(topology.size)
        if medium.reception.needs_positions and positions is None:
            raise _no_positions()

    def add(self, frame: Frame) -> None:
        """Put a frame on the air that begins now or, as an acknowledgement, after SIFS."""
        now = self._env.now
        if self._locks:
            frame.locked = np.ones(len(self._all), dtype=bool)
        for other in self._frames:
            if other.end <= frame.begin or frame.end <= other.begin:
                continue
            frame.overlapping.append(other)
            other.overlapping.append(frame)
            if frame.locked is not None and other.locked is not None:
                frame.locked[other.src] = other.locked[frame.src] = False  # a node that transmits locks onto none
                first, second = (other, frame) if other.begin < frame.begin else (frame, other)
                # A receiver that hears the first of two frames is locked on to it, and misses the second.
                if first.begin < second.begin and first.locked is not None and second.locked is not None:
                    second.locked &= ~(first.locked & self._tuned(first) & self._audible(first, self._all))
        if not self._frames:
            self._busy_since = now
        self._frames.append(frame)

    def remove(self, frame: Frame, receivers: list[int]) -> dict[int, Cause]:
        """Remove a frame from the air now; return the causes of its losses, by receiver."""
        self._frames.remove(frame)
        if not self._frames:
            self._busy += self._env.now - self._busy_since
        causes = self._judge(frame, receivers)
        frame.overlapping = []  # frees memory without a garbage collection: the frames refer to each other
        return causes

    def received(self, frame: Frame, nodes: Integers) -> Bools:
        """Return (k,) which of some nodes receive a frame that ends now and is still on the air."""
        is_received = self._audible(frame, nodes)
        lost = self._judge(frame, nodes[is_received].tolist())
        is_received[is_received] = [node not in lost for node in nodes[is_received].tolist()]
        return is_received

    def busy_time(self) -> int:
        """Return the total time, ns, with frames on the air; the SIFS before an acknowledgement counts, too."""
        return self._busy + (self._env.now - self._busy_since if self._frames else 0)

    def _judge(self, frame: Frame, receivers: list[int]) -> dict[int, Cause]:
        """Return the causes of the losses of a frame that ends now, by receiver."""
        if not receivers or not (frame.overlapping or self._has_noise or self.hears is not None):
            return {}
        nodes = np.array(receivers)
        overlap = Overlap(
            frame,
            nodes,
            frame.overlapping,
            lambda other: self._audible(other, nodes),
            lambda other: self._distances(other, nodes),
            lambda other: pair_uniform(self._seed, "interference", other.src, nodes, other.draw, symmetric=False),
            self._signal,
            lambda other: self._channel(other, nodes),
            self._topology.channel is not None,
        )
        answer = self._interference(overlap)
        received = array_of(answer)
        if received.dtype != bool or received.shape != nodes.shape:
            expected = f"a model of interference should return a boolean for each of {len(nodes)} receivers"
            raise wrong_answer(expected, answer, self._interference)
        if frame.locked is not None:
            received = received & frame.locked[nodes]
        cause: Cause = self._cause if frame.overlapping else "loss"
        lost = dict.fromkeys(nodes[~received].tolist(), cause)
        if self.hears is not None:
            lost |= dict.fromkeys(nodes[~self.hears(frame.src, nodes)].tolist(), "tuning")
        transmitting = {other.src for other in frame.overlapping}
        return lost | {node: "half_duplex" for node in receivers if node in transmitting}

    def _tuned(self, frame: Frame) -> Bools:
        """Return (n,) which nodes are tuned to a frame."""
        return np.ones(len(self._all), dtype=bool) if self.hears is None else self.hears(frame.src, self._all)

    def _audible(self, frame: Frame, nodes: Integers) -> Bools:
        """Return (k,) whether nodes are linked to the sender of a frame, and within range."""
        is_audible: Bools = self._topology.links_to(frame.src, nodes) & (nodes != frame.src)
        is_audible[is_audible] = self._topology.reaches(frame.src, nodes[is_audible], frame.draw)
        return is_audible

    def _signal(self, frame: Frame) -> LoRaSignal:
        assert isinstance(self._medium, LoRa)
        return self._medium.signal(frame.src)

    def _channel(self, frame: Frame, nodes: Integers) -> ChannelState:
        """Return the present states of the channels from the sender of a frame to nodes."""
        channel, src = self._topology.channel, frame.src
        if channel is None:
            return uncorrelated(self._seed, src, nodes, frame.draw, per_link=self._topology.per_link)
        if self._positions is None:
            raise _no_positions()
        at = self._positions.of(np.append(src, nodes))
        return channel.between(Ends(src, nodes, at[0], at[1:], self._env.now / SECOND))

    def _distances(self, frame: Frame, nodes: Integers) -> Floats:
        """Return the (k,) distances of nodes from the sender of a frame, m, stretched by walls."""
        if self._positions is None:
            raise _no_positions()
        places = self._positions.of(np.append(frame.src, nodes))
        distances = distances_from(places, 0)[1:]
        if self._walls is None:
            return distances
        return np.asarray(np.minimum(self._walls.stretched(frame.src, nodes, places[:1], places[1:], distances), FAR))


def _no_positions() -> KeyedError:
    return KeyedError(Problem("reception by power needs positions", "medium.reception"))

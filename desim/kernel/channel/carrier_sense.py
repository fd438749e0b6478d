"""Carrier sensing: which nodes sense the frames on the air, and when."""

from collections.abc import Callable

import numpy as np

from desim.config.arrays import Bools, Integers
from desim.config.errors import KeyedError, Problem
from desim.kernel.channel.access_methods import AccessMethod, Contenders
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.positions import PositionSource, distances_from
from desim.kernel.core.seeds import ROOM
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.access import Access, CarrierSensing
from desim.kernel.models.interference import Frame
from desim.kernel.topology.topology import Topology


class CarrierSense:
    """Tells nodes when they begin and cease to sense a busy channel.

    Args:
        env: the clock of the simulation.
        access: the access model.
        method: the access model in this run.
        nodes: the state of the nodes.
        topology: the links of the graph, and which of them are within range.
        positions: the current positions of the nodes; None: unknown.
        hears: returns which nodes are tuned to the frames of a node; None: all are.
        plan: called after nodes have planned actions because the channel has become idle for them.

    Raises:
        ValueError: if there is a carrier-sense range, and no positions.
    """

    def __init__(
        self,
        env: Clock,
        access: Access,
        method: AccessMethod,
        nodes: Contenders,
        topology: Topology,
        positions: PositionSource | None,
        hears: Callable[[int, Integers], Bools] | None,
        plan: Callable[[], None],
    ):
        self._env, self._method, self._nodes, self._plan = env, method, nodes, plan
        self._topology, self._positions, self._hears = topology, positions, hears
        model = access if isinstance(access, CarrierSensing) else CarrierSensing()
        self._range, self._delay = model.sensing_range, nanoseconds(model.sensing_delay)
        self._listeners: dict[int, Integers] = {}
        """The listeners of each node, if no range is checked, so that they are constant; up to `ROOM` numbers."""
        if self._range is not None and positions is None:
            raise KeyedError(Problem("a sensing range needs positions", "medium.access"))

    def listeners(self, node: int) -> Integers:
        """Return the nodes that sense the frames of a node.

        Without a sensing delay the node itself is among them, so that one call of `count` updates all nodes.
        """
        if not self._method.senses:
            return np.empty(0, dtype=np.int64)
        listeners = self._listeners.get(node)
        if listeners is None:
            listeners = self._near(node)
            if self._hears is not None:
                listeners = listeners[self._hears(node, listeners)]
            if not self._delay:
                listeners = np.append(listeners, node)
            if self._range is None and self._topology.is_static and (len(self._listeners) + 1) * len(listeners) <= ROOM:
                self._listeners[node] = listeners
        return listeners

    def _near(self, node: int) -> Integers:
        """Return the nodes that sense the frames of a node, ascending, without itself."""
        if self._range is None:
            return self._topology.neighbours(node)
        assert self._positions is not None
        places = self._positions()
        distances = distances_from(places, node)
        if (walls := self._topology.walls) is not None:
            distances = walls.stretched(node, np.arange(len(places)), places[node : node + 1], places, distances)
        is_near = distances <= self._range
        is_near[node] = False
        return is_near.nonzero()[0]

    def sense(self, frame: Frame, change: int) -> None:
        """Let nodes sense the start (1) or the end (-1) of a frame: its sender now, all others after the delay."""
        if not self._method.senses:
            return
        if self._delay:
            self.count(np.array([frame.src]), change)
            instant = Instant(self._env, self._env.now + self._delay, Phase.DELIVERY)
            instant.callbacks.append(lambda _: self.count(frame.sensed_by, change))
        else:
            self.count(frame.sensed_by, change)

    def count(self, nodes: Integers, change: int) -> None:
        """Change the number of frames that some nodes sense, by 1 or -1.

        A node that must be silent for another reason counts one more frame, as if it sensed one.
        """
        state, now = self._nodes, self._env.now
        old_counts = state.busy[nodes]
        state.busy[nodes] = old_counts + change
        changed = nodes[old_counts == (0 if change > 0 else 1)]  # those that begin or cease to sense a busy channel
        if not len(changed):
            return
        if change > 0:
            self._method.sense_busy(changed, now)
        else:
            state.idle_since[changed] = now
            self._method.sense_idle(changed, now)
            self._plan()

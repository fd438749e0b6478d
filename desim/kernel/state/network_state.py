"""The state of a network that its layers share."""

from collections.abc import Sequence
from dataclasses import dataclass

from desim.kernel.core.clock import Clock, NodeClock
from desim.kernel.core.positions import PositionSource
from desim.kernel.state.fault_state import FaultState
from desim.kernel.state.inbox import Inboxes
from desim.kernel.state.received_records import Records
from desim.kernel.topology.topology import Topology


@dataclass(frozen=True)
class NetworkState:
    """The topology, the faults and the clocks of a network, and what its nodes have received."""

    env: Clock
    """The clock of the simulation."""
    topology: Topology
    """The links of the graph, and which of them are within range."""
    positions: PositionSource | None
    """The current positions of the nodes; None: unknown."""
    fault_state: FaultState | None
    """The active faults; None: the network has no faults."""
    records: Records
    """The records that have arrived."""
    inboxes: Inboxes
    """The inboxes of the nodes."""
    clocks: Sequence[NodeClock]
    """The clocks of the nodes."""

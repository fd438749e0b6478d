"""The ways by name; a way is an implementation that delivers the broadcasts of a workload in this process.

`elsewhere` delivers the broadcasts in other simulators.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from scenarios.benchmarks.peers.bare_heap import BareHeap
from scenarios.benchmarks.peers.desim_ways import Desim, Publish, Send
from scenarios.benchmarks.peers.simpy_ways import (
    Documented,
    PerBroadcast,
    PerMessage,
    PerMessageDrawnAtOnce,
    PlainSimPy,
)
from scenarios.benchmarks.peers.workloads import Workload

Way = Desim | PlainSimPy | BareHeap
WAYS: Mapping[str, Callable[[Workload], Way]] = MappingProxyType(
    {
        "publish": Publish,
        "send": Send,
        "heapq": BareHeap,
        "simpy-broadcast": PerBroadcast,
        "simpy-message": PerMessage,
        "simpy-drawn-at-once": PerMessageDrawnAtOnce,
        "simpy-documented": Documented,
    }
)

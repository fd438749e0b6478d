"""A scenario in real time: one process per pursuer, over UDP, with the unchanged protocol.

The clock follows the wall clock, and the link layer of the network is a socket; nothing else of a run is replaced. A
new message body needs an entry in `wire`.
"""

from typing import TYPE_CHECKING

from desim.config.exports import lazy_exports

if TYPE_CHECKING:
    from desim.live.agreement import Agreement as Agreement
    from desim.live.agreement import compare as compare
    from desim.live.live_runs import run as run
    from desim.live.live_runs import runs as runs
    from desim.live.lobby import LiveError as LiveError
    from desim.live.namespaces import NamespaceError as NamespaceError
    from desim.live.node import Node as Node
    from desim.live.refusals import NotLiveError as NotLiveError
    from desim.live.result import LiveResult as LiveResult

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)

"""A scenario in real time: one process per pursuer, over UDP, with the unchanged protocol.

The clock follows the wall clock, and the link layer of the network is a socket; nothing else of a run is replaced. A
new message body needs an entry in `wire`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from desim.live.agreement import Agreement as Agreement
    from desim.live.agreement import compare as compare
    from desim.live.lobby import LiveError as LiveError
    from desim.live.namespaces import NamespaceError as NamespaceError
    from desim.live.node import Node as Node
    from desim.live.refusals import NotLiveError as NotLiveError
    from desim.live.result import LiveResult as LiveResult
    from desim.live.runs import run as run
    from desim.live.runs import runs as runs

_NAMES = {
    "agreement": ("Agreement", "compare"),
    "lobby": ("LiveError",),
    "namespaces": ("NamespaceError",),
    "node": ("Node",),
    "refusals": ("NotLiveError",),
    "result": ("LiveResult",),
    "runs": ("run", "runs"),
}
"""The public names by module. Each is imported on first access."""
_HOMES = {name: f"{__name__}.{module}" for module, names in _NAMES.items() for name in names}
__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    """Return the object that a public name denotes; its module is imported on first access."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__

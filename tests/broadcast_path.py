"""The path of one broadcast through the source: the functions from an agent's announcement to its reading."""

import sys
from importlib import import_module
from types import FrameType
from typing import Any

from desim import Scenario, run
from desim.kernel.network import ReceivingNodes
from desim.kernel.state.received_records import SharedTable
from desim.pursuit.team.agent import Agent
from desim.pursuit.team.beliefs import Beliefs

PLAIN = Scenario(horizon=3.0)
"""The default scenario, on an ideal network; shorter."""
SHARED = PLAIN.with_({"network.medium": {"kind": "bitrate", "bitrate": 1e6, "shared": True}})
"""All pursuers share one channel, which carries one message at a time."""
PACKAGES = ("desim", "protocols")


def path_of_a_broadcast(scenario: Scenario) -> list[str]:
    """Return the functions that an announcement of a changed action crosses in a run, as "module:Class.method".

    They are those called by `Agent.announce`, and those by which the next teammate reads the record: from
    `Beliefs.gain` to the end of `ReceivingNodes.matching`. Each function is listed once, where it is first called. Of
    all announcements that are read, the last of those with the most calls counts, so that what is computed once in a
    run has been computed before.
    """
    tracer = _Tracer()
    sys.setprofile(tracer)
    try:
        run(scenario, 1)
    finally:
        sys.setprofile(None)
    return list(dict.fromkeys(tracer.longest))


def modules_of(path: list[str]) -> list[str]:
    """Return the modules that a path crosses, in the order of the first call."""
    return list(dict.fromkeys(name.partition(":")[0] for name in path))


def function_named(name: str) -> Any:
    """Return the function or the property with a name "module:Class.method".

    Raises:
        AttributeError, ImportError: if there is none.
    """
    module, _, attribute = name.partition(":")
    found: Any = import_module(module)
    for part in attribute.split("."):
        found = getattr(found, part)
    return found


class _Tracer:
    """A profile function that records the calls of broadcasts."""

    def __init__(self) -> None:
        self.longest: list[str] = []
        self._sent: list[str] = []
        self._most = 0
        self._calls: list[str] = []
        self._outermost: FrameType | None = None

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            if self._outermost is None and frame.f_code in {Agent.announce.__code__, Beliefs.gain.__code__}:
                self._outermost, self._calls = frame, []
            if self._outermost is not None and (name := _name(frame)) is not None:
                self._calls.append(name)
        elif event == "return" and self._outermost is not None:
            self._return(frame)

    def _return(self, frame: FrameType) -> None:
        if frame is self._outermost:  # an announcement, or a gain that needs no reading
            if frame.f_code is Agent.announce.__code__:
                self._sent = self._calls
            self._outermost = None
        elif frame.f_code is ReceivingNodes.matching.__code__:  # what is done with the record is no part of its path
            stored = _name_of(SharedTable.apply_arrived) in self._calls
            if stored and self._sent and len(self._sent) >= self._most:
                self.longest, self._most = self._sent + self._calls, len(self._sent)
            self._outermost = None


def _name(frame: FrameType) -> str | None:
    """Return the name of the function of a frame; None for functions of other packages, and for comprehensions."""
    module, function = frame.f_globals.get("__name__", ""), frame.f_code.co_qualname
    return f"{module}:{function}" if module.partition(".")[0] in PACKAGES and "<" not in function else None


def _name_of(function: Any) -> str:
    return f"{function.__module__}:{function.__qualname__}"

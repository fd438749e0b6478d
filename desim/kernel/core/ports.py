"""Ports, the names of the inboxes of a node; those of the simulator itself are reached by no message of a protocol."""

from typing import Any

from desim.config.arguments import value_text


def check_port(port: Any, name: str) -> None:
    """Raise ValueError if a port is no text, as if the size of a message or a time was given in its place.

    Args:
        port: the port.
        name: the node with the port, or the function that it was given to, for the error message.
    """
    if not isinstance(port, str):
        raise ValueError(f"{name}: a port should be a text, the name of an inbox (got {value_text(port)})")


class ReservedPort(str):
    """A port whose inboxes only the module that defines it can read: it is equal to no other string.

    Traces record its text, so a protocol may use a port of the same text as its own. It is the value of the global
    variable `PORT` of its module, and pickled and copied as that.

    Args:
        text: the text in traces.
        module: the name of the module.
    """

    __hash__ = object.__hash__

    def __new__(cls, text: str, module: str) -> "ReservedPort":
        """Create the port."""
        port = super().__new__(cls, text)
        port.__module__ = module
        return port

    def __eq__(self, other: object) -> bool:
        return self is other

    def __ne__(self, other: object) -> bool:
        return self is not other

    def __reduce__(self) -> str:
        return "PORT"

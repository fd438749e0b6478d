"""Ports, the names of the inboxes of a node; no message of a protocol reaches the ports of the simulator itself."""

from typing import Any

from desim.config.arguments import value_text


def check_port(port: Any, name: str) -> None:
    """Raise ValueError if a port is not a text, for instance a size or a time that was given in its place.

    Args:
        port: the port.
        name: the node with the port, or the function that it was given to, for the error message.
    """
    if not isinstance(port, str):
        raise ValueError(f"{name}: a port should be a text, the name of an inbox (got {value_text(port)})")


class ReservedPort(str):
    """A port whose inboxes only the module that defines it can read: it is equal to no other string.

    A protocol may use a port with the same text, which is another port; traces record only the text. A reserved port is
    the global variable `PORT` of its module, and is pickled and copied by that name.

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

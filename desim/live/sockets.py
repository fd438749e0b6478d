"""The UDP socket of a node."""

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from desim.live.start import Address

RECEIVE_BUFFER = 1 << 21
"""Bytes of the receive buffer of a socket, as far as the system allows it."""


class Receiver(asyncio.DatagramProtocol):
    """Hands datagrams on.

    Args:
        take: called with each datagram and the address from which it came.
    """

    def __init__(self, take: Callable[[bytes, Address], object]):
        self._take = take

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """Take a datagram."""
        self._take(data, (addr[0], addr[1]))

    def error_received(self, exc: Exception) -> None:
        """Ignore that nobody listens at the address of a node that has crashed."""


def udp_socket(address: Address) -> socket.socket:
    """Return a UDP socket that is bound to an address."""
    family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_DGRAM)
    bound.setblocking(False)
    with suppress(OSError):
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    try:
        bound.bind(address)
    except OSError:
        bound.close()
        raise
    return bound

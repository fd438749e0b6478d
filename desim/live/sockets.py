"""The UDP socket of a node."""

import asyncio
import socket
from collections.abc import Callable, Iterable
from contextlib import suppress
from ipaddress import ip_address
from typing import Any

from desim.live.start import Address

RECEIVE_BUFFER = 1 << 21
"""Bytes of the receive buffer of a socket, as far as the system allows it."""
LARGEST = 1 << 16
"""Bytes of the largest datagram."""


def checked_address(value: Any) -> Address:
    """Return an address.

    Raises:
        ValueError: if it is not a host and a port.
    """
    match value:
        case [str(host), int(port)] if 0 <= port < 1 << 16:
            return host, port
    raise ValueError(f"an address should be a host and a port (got {value!r})")


def family_of(address: Address) -> socket.AddressFamily:
    """Return the family of an address: IPv6 if its host has colons."""
    return socket.AF_INET6 if ":" in address[0] else socket.AF_INET


def udp_socket(address: Address) -> socket.socket:
    """Return a UDP socket that is bound to an address."""
    bound = socket.socket(family_of(address), socket.SOCK_DGRAM)
    bound.setblocking(False)
    with suppress(OSError):
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    try:
        bound.bind(address)
    except OSError as error:
        bound.close()
        raise OSError(error.errno, f"{address[0]}, port {address[1]}: {error.strerror or error}") from None
    return bound


def resolved(address: Address) -> Address:
    """Return an address with the number of its host, from which datagrams come, in the place of its name.

    Raises:
        OSError: if the host is not known, or is none of its own.
    """
    host, port = address
    try:
        number, *_ = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0][4]
    except (OSError, UnicodeError) as error:
        raise OSError(f"the host {host!r} is not known: {getattr(error, 'strerror', None) or error}") from None
    if ip_address(str(number).partition("%")[0]).is_unspecified:
        raise OSError(f"{host} stands for all addresses of a machine: should be one of them")
    return str(number), int(port)


class Datagrams:
    """The datagrams that arrive at a socket, and those that leave it, in a loop of asyncio.

    A reader of the loop takes three quarters of the time of a datagram endpoint.

    Args:
        bound: the socket.
        take: called with each datagram and the address from which it came.

    Raises:
        OSError: if the loop cannot watch sockets, as the usual one of Windows.
    """

    def __init__(self, bound: socket.socket, take: Callable[[bytes, Address], object]):
        self._socket, self._take, self._loop = bound, take, asyncio.get_running_loop()
        self.address: Address = bound.getsockname()[:2]
        try:
            self._loop.add_reader(bound, self._read)
        except NotImplementedError:
            bound.close()
            raise OSError("desim.live needs an event loop that watches sockets: asyncio.SelectorEventLoop") from None

    def _read(self) -> None:
        try:
            datagram, sender = self._socket.recvfrom(LARGEST)
        except OSError:  # none after all, or nobody listens at the address of a node that has crashed
            return
        self._take(datagram, sender[:2])

    def send(self, datagram: bytes, addresses: Iterable[Address]) -> None:
        """Send a datagram to some addresses; where it cannot be sent, it is lost."""
        for address in addresses:
            with suppress(OSError):
                self._socket.sendto(datagram, address)

    def close(self) -> None:
        """Close the socket."""
        self._loop.remove_reader(self._socket)
        self._socket.close()

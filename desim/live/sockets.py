"""The UDP sockets of a node."""

import asyncio
import socket
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from ipaddress import ip_address
from struct import Struct
from typing import Any

from desim.config.arguments import value_text
from desim.kernel.core.units import SECOND
from desim.live.start import Address

RECEIVE_BUFFER = 1 << 21
"""Bytes of the receive buffer of a socket, as far as the system allows it."""
LARGEST = 1 << 16
"""Bytes of the largest datagram."""
TIMESTAMP = 35 if sys.platform == "linux" else None
"""The option of a socket whose datagrams the system stamps on arrival, `SO_TIMESTAMPNS`; None: there is none."""
ANCILLARY = 64
"""The largest number of bytes of a time stamp with its header."""
MAX_TAKEN = 4096
"""Number of datagrams that are read at a time at most, lest a flood of them stops everything else."""
_TIMESPEC = Struct("@ll")


def checked_address(value: Any) -> Address:
    """Return an address; raise ValueError if it is not a host and a port."""
    match value:
        case [str(host), int(port)] if 0 <= port < 1 << 16 and port is not True and port is not False:
            return host, port
    raise ValueError(f"an address should be a host and a port (got {value_text(value)})")


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


def resolved(address: Address, family: int = socket.AF_UNSPEC) -> Address:
    """Return an address with the IP address of its host in place of a name, as sockets report senders of datagrams.

    Args:
        address: the address.
        family: the family of the IP address, as of the sending socket; a name may have an address of each family.

    Raises:
        OSError: if the host is not known, has no address of the family, or stands for all addresses of a machine.
    """
    host, port = address
    try:
        ip, *_ = socket.getaddrinfo(host, port, family, socket.SOCK_DGRAM)[0][4]
    except (OSError, UnicodeError) as error:
        raise OSError(f"the host {host!r} is not known: {getattr(error, 'strerror', None) or error}") from None
    if ip_address(str(ip).partition("%")[0]).is_unspecified:
        raise OSError(f"{host} stands for all addresses of a machine: should be one of them")
    return str(ip), int(port)


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
        except OSError:  # no datagram after all, or an earlier one was sent to a node that has crashed
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


class Mailbox:
    """The datagrams that arrive at a socket, and stay there until they are read.

    No process wakes for a datagram: waking is most of what a datagram costs. The system stamps each one on arrival.

    Args:
        bound: the socket.

    Raises:
        OSError: if the system has no time stamps.
    """

    def __init__(self, bound: socket.socket):
        if TIMESTAMP is None:
            raise OSError("this system stamps no datagrams")
        bound.setsockopt(socket.SOL_SOCKET, TIMESTAMP, 1)
        self._socket, self._last_read = bound, time.monotonic_ns()
        self.address: Address = bound.getsockname()[:2]

    def read(self) -> list[tuple[bytes, Address, int]]:
        """Return the datagrams since the last read, the addresses from which they came, and their ages, ns."""
        now, system_time = time.monotonic_ns(), time.time_ns()
        # Stamps are in system time, which may jump: ages are limited to the time since the last read.
        longest, self._last_read = now - self._last_read, now
        taken: list[tuple[bytes, Address, int]] = []
        with suppress(BlockingIOError):  # there are no more
            while len(taken) < MAX_TAKEN:
                datagram, [(_, _, stamp)], _, sender = self._socket.recvmsg(LARGEST, ANCILLARY)
                seconds, nanoseconds = _TIMESPEC.unpack(stamp)
                age = system_time - (seconds * SECOND + nanoseconds)
                taken.append((datagram, sender[:2], min(max(age, 0), longest)))
        return taken

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

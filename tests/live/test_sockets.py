"""Sockets of live nodes, where the system has not what they need, or a datagram cannot be read or sent."""

import asyncio
from socket import AF_INET, AF_INET6, AF_UNSPEC, SOCK_DGRAM
from types import SimpleNamespace

import pytest

from desim.live import lobby, sockets
from desim.live.lobby import LiveError
from desim.live.node import Node
from desim.live.sockets import Datagrams, Mailbox, resolved, udp_socket
from desim.scenario.players import Team
from desim.scenario.scenario import Scenario


class Socket:
    """A socket at an address that notes what is sent; `fails` is what reading raises, `lost` an unreachable address."""

    def __init__(self, fails=None, lost=None):
        self.sent, self.is_closed, self._fails, self._lost = [], False, fails, lost

    def getsockname(self):
        return ("127.0.0.1", 7, 0, 0)

    def recvfrom(self, length):
        if self._fails:
            raise self._fails
        return b"x" * min(length, 70_000), ("127.0.0.1", 9, 0, 0)

    def sendto(self, datagram, address):
        if address == self._lost:
            raise OSError("no way")
        self.sent.append((datagram, address))

    def close(self):
        self.is_closed = True


def watched(monkeypatch, bound, **loop):
    """Return the datagrams of a socket in a loop with some methods, and what they take."""
    taken = []
    monkeypatch.setattr(sockets.asyncio, "get_running_loop", lambda: SimpleNamespace(**loop))
    return Datagrams(bound, lambda *words: taken.append(words)), taken


def test_a_loop_that_watches_no_sockets_is_refused(monkeypatch):
    def add_reader(*_):
        raise NotImplementedError

    bound = Socket()
    with pytest.raises(OSError, match=r"^desim\.live needs an event loop that watches sockets: asyncio\.Selector"):
        watched(monkeypatch, bound, add_reader=add_reader)
    assert bound.is_closed


def test_a_datagram_is_taken_with_the_address_from_which_it_came(monkeypatch):
    readers, bound = {}, Socket()
    datagrams, taken = watched(monkeypatch, bound, add_reader=readers.__setitem__, remove_reader=readers.pop)
    assert datagrams.address == ("127.0.0.1", 7)
    readers[bound]()
    assert taken == [(b"x" * sockets.LARGEST, ("127.0.0.1", 9))]
    datagrams.close()
    assert (readers, bound.is_closed) == ({}, True)


def test_a_datagram_that_cannot_be_read_is_none(monkeypatch):
    readers, bound = {}, Socket(fails=ConnectionRefusedError())
    _, taken = watched(monkeypatch, bound, add_reader=readers.__setitem__)
    readers[bound]()
    assert taken == []


def test_a_datagram_that_cannot_be_sent_to_one_is_sent_to_the_others(monkeypatch):
    bound = Socket(lost=("b", 1))
    datagrams, _ = watched(monkeypatch, bound, add_reader=lambda *_: None)
    datagrams.send(b"x", [("a", 1), ("b", 1), ("c", 1)])
    assert bound.sent == [(b"x", ("a", 1)), (b"x", ("c", 1))]


def test_a_system_without_time_stamps_has_no_mailbox(monkeypatch):
    monkeypatch.setattr(sockets, "TIMESTAMP", None)
    with pytest.raises(OSError, match=r"^this system stamps no datagrams$"):
        Mailbox(Socket())


@pytest.mark.parametrize(
    ("host", "why"),
    [
        ("0.0.0.0", "0.0.0.0 stands for all addresses of a machine: should be one of them"),
        ("::", ":: stands for all addresses of a machine: should be one of them"),
        ("\ud800", "the host '\\ud800' is not known: "),
    ],
)
def test_a_host_that_is_no_address_of_a_machine_is_refused(host, why):
    with pytest.raises(OSError) as caught:
        resolved((host, 1))
    assert str(caught.value).startswith(why)


def test_an_address_is_that_of_its_number():
    assert resolved(("127.0.0.1", 5)) == ("127.0.0.1", 5)


def test_a_name_with_addresses_of_both_families_has_that_of_the_socket(monkeypatch):
    numbers = {AF_INET6: ("::1", 5, 0, 0), AF_INET: ("127.0.0.1", 5)}

    def addresses(host, port, family, kind):
        assert (host, port, kind) == ("both", 5, SOCK_DGRAM)
        return [(kept, kind, 17, "", numbers[kept]) for kept in numbers if family in {AF_UNSPEC, kept}]

    monkeypatch.setattr(sockets.socket, "getaddrinfo", addresses)
    found = [resolved(("both", 5), family)[0] for family in (AF_UNSPEC, AF_INET, AF_INET6)]
    assert found == ["::1", "127.0.0.1", "::1"]

    async def play(opens):
        node = Node(Scenario(team=Team(count=2)), 0)
        peers = [("127.0.0.1", 4), ("both", 5)]
        if opens:
            async with node.open(("127.0.0.1", 0), peers):
                return node._peers
        node.bind(bound := udp_socket(("127.0.0.1", 0)))
        node.connect(peers)
        bound.close()
        return node._peers

    assert [asyncio.run(play(opens)) for opens in (True, False)] == [[("127.0.0.1", 4), ("127.0.0.1", 5)]] * 2


@pytest.mark.parametrize("fails", [True, False])
def test_a_host_is_local_if_a_socket_can_be_bound_there(fails, monkeypatch):
    bound = Socket()

    def udp_socket(address):
        assert address == ("here", 0)
        if fails:
            raise OSError("no way")
        return bound

    monkeypatch.setattr(lobby, "udp_socket", udp_socket)
    assert lobby._is_local("here") is not fails
    assert bound.is_closed is not fails


@pytest.mark.parametrize(
    ("error", "why"),
    [(OSError(101, "Network is unreachable"), "Network is unreachable"), (OSError("nowhere"), "nowhere")],
)
def test_a_host_to_which_no_way_leads_is_told(error, why, monkeypatch):
    def fail(_):
        raise error

    monkeypatch.setattr(lobby, "resolved", fail)
    with pytest.raises(LiveError, match=f"^there: no way leads there: {why}$"):
        lobby._address_towards("there")


def test_the_address_towards_this_machine_is_its_own():
    assert lobby._address_towards("127.0.0.1") == "127.0.0.1"

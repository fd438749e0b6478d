"""The lobby and its lines, without a process or a socket: who is admitted, who is told what, and what is cut off."""

import asyncio
import json
from itertools import product

import pytest

from desim.live import lines as lines_module
from desim.live.lines import Lines, encoded_line
from desim.live.lobby import BACKLOG, LiveError, Lobby
from desim.scenario.scenario import Scenario

SCENARIO = Scenario()


class Transport:
    """Keeps what is written; `unread` bytes of it wait."""

    def __init__(self, unread=0):
        self.written, self.is_closed, self.unread = b"", False, unread

    def write(self, data):
        self.written += data

    def close(self):
        self.is_closed = True

    def get_write_buffer_size(self):
        return self.unread

    def lines(self):
        return [json.loads(line) for line in self.written.splitlines()]


def connected(lines, unread=0):
    """Return the transport of the end of a connection."""
    transport = Transport(unread)
    lines.connection_made(transport)
    return transport


def lobby(count=2):
    """Return a lobby, what it hears, and whom it loses."""
    heard, lost = [], []
    made = Lobby(SCENARIO, ["127.0.0.1"] * count, lambda *words: heard.append(words), lambda *how: lost.append(how))
    made._distant = []
    return made, heard, lost


def hello(made, pursuer, token=None, digest="", places=("here", "mailbox")):
    """Let a process say hello; return its end of the connection at the lobby, and the transport."""
    lines = made._welcome()
    transport = connected(lines)
    lines.data_received(encoded_line("hello", pursuer, made._token if token is None else token, digest, list(places)))
    return lines, transport


def test_lines_are_heard_however_they_are_split():
    words = [["a", 1], ["b", None, "x\ny"], ["c"]]
    data = b"".join(encoded_line(*each) for each in words)

    async def heard(size):
        found = []
        lines = Lines(lambda *each: found.append(list(each)))
        transport = connected(lines)
        for k in range(0, len(data), size):
            lines.data_received(data[k : k + size])
        assert not transport.is_closed
        return found

    for size in range(1, len(data) + 1):
        assert asyncio.run(heard(size)) == words


@pytest.mark.parametrize("data", [b"GET / HTTP/1.1\r\n", b"7\n", b"[]\n", b"\xff\n", b'["a", 1\n', b"null\n"])
def test_a_stranger_who_speaks_otherwise_is_cut_off(data):
    async def cut():
        found = []
        lines = Lines(lambda *each: found.append(each))
        transport = connected(lines)
        lines.data_received(encoded_line("first") + data + encoded_line("last"))
        assert found == [("first",)]
        return transport.is_closed

    assert asyncio.run(cut())


def test_a_line_without_an_end_is_cut_off(monkeypatch):
    monkeypatch.setattr(lines_module, "LONGEST", 9)

    async def closed(size):
        lines = Lines(lambda *_: None)
        transport = connected(lines)
        lines.data_received(b" " * size)
        return transport.is_closed

    assert [asyncio.run(closed(size)) for size in (8, 9, 10)] == [False, False, True]


def test_an_end_that_is_not_connected_has_sent_nothing():
    async def unread():
        lines = Lines(lambda *_: None)
        lines.tell("a")
        lines.close()
        return lines.unread

    assert asyncio.run(unread()) == 0


REFUSED = {
    "another token": ({"pursuer": 0, "token": "guess"}, "the referee does not know this process"),
    "a number beyond the last": ({"pursuer": 2}, "the run has no pursuer 2, or has it already"),
    "a negative number": ({"pursuer": -1}, "the run has no pursuer -1, or has it already"),
    "a number that has joined": ({"pursuer": 1}, "the run has no pursuer 1, or has it already"),
    "another one": ({"pursuer": 0, "digest": "0"}, "the scenario of the run, its code or its data files are others"),
    "one place": ({"pursuer": 0, "places": ("here",)}, "it does not speak as a pursuer does"),
    "no number": ({"pursuer": "0"}, "it does not speak as a pursuer does"),
}


@pytest.mark.parametrize(("said", "why"), REFUSED.values(), ids=REFUSED)
def test_a_process_that_may_not_join_is_told_why(said, why):
    async def refused():
        made, _, _ = lobby()
        _, first = hello(made, 1)
        assert not first.is_closed
        _, transport = hello(made, **said)
        assert transport.lines() == [["refused", why]]
        assert sorted(made._joined) == [1]
        return transport.is_closed

    assert asyncio.run(refused())


@pytest.mark.parametrize(
    ("is_done", "unread", "may_skip"), [*product([False, True], [0, BACKLOG, BACKLOG + 1], [False, True])]
)
def test_a_pursuer_that_has_ended_is_told_nothing_and_one_that_is_behind_may_be_skipped(is_done, unread, may_skip):
    async def told():
        made, heard, _ = lobby()
        lines, transport = hello(made, 0)
        _, other = hello(made, 1)
        transport.unread = unread
        if is_done:
            lines.data_received(encoded_line("done", 7))
            assert heard == [(0, "done", 7)]
        made.tell_all("step", 5, may_skip=may_skip)
        assert other.lines() == [["step", 5]]
        return transport.lines()

    skipped = is_done or (may_skip and unread > BACKLOG)
    assert asyncio.run(told()) == ([] if skipped else [["step", 5]])


def test_the_lines_of_a_pursuer_are_taken_by_their_first_word():
    async def taken():
        made, heard, _ = lobby()
        lines, transport = hello(made, 0)
        for words in (("ready",), ("ping",), ("order", 3), ("error", "no way"), ("done",)):
            lines.data_received(encoded_line(*words))
        ((word, now),) = transport.lines()
        assert (word, type(now)) == ("pong", int)
        assert made._ready == {0}
        assert made.errors == ["pursuer 0: no way"]
        assert heard == [(0, "order", 3), (0, "done")]
        assert await made.reports(0.0) == []

    asyncio.run(taken())


def test_a_pursuer_that_leaves_before_its_end_is_lost_and_one_that_leaves_after_it_is_not():
    async def lost_ones():
        made, _, lost = lobby(3)
        ends = [hello(made, pursuer)[0] for pursuer in range(3)]
        ends[0].data_received(encoded_line("done"))
        made._ended(1, 1)
        ends[0].connection_lost(None)
        ends[1].connection_lost(None)
        await asyncio.sleep(0.02)
        assert [pursuer for pursuer, _ in lost] == [1]
        assert await made.reports(0.0) == [2]
        ends[2].connection_lost(None)  # the run is over
        await asyncio.sleep(0.02)
        return [pursuer for pursuer, _ in lost]

    assert asyncio.run(lost_ones()) == [1]


def test_a_process_that_leaves_once_all_have_reported_or_the_lobby_is_closed_is_not_lost():
    async def lost_after(end):
        made, _, lost = lobby(1)
        lines, _ = hello(made, 0)
        await end(made)
        lines.connection_lost(None)
        await asyncio.sleep(0.0)
        return lost, made._joined[0].loss

    async def closed(made):
        made.close()

    for end in (lambda made: made.reports(0.0), closed):
        assert asyncio.run(lost_after(end)) == ([], None)


def test_who_has_not_joined_in_time_or_has_ended_is_named():
    async def waited(status):
        made, _, _ = lobby(3)
        made._ready = {1}
        if status is not None:
            made._ended(2, status)
        await made._until(lambda: False, 0.01)

    with pytest.raises(LiveError, match=r"^no process of pursuer 0, 2 has joined within 0\.01 s$"):
        asyncio.run(waited(None))
    with pytest.raises(LiveError, match=r"^pursuer 2 .*7"):
        asyncio.run(waited(7))

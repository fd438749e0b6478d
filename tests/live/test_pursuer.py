"""The process of a pursuer, without sockets: what it does for each word of the referee, call by call."""

import asyncio
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from desim import Scenario
from desim.kernel.core.events import TransportCounts
from desim.live import pursuer
from desim.live.frames import WorldFrame
from desim.live.pursuer import ALONE, LOST_REFEREE, RAISED, REPORTS, _Pursuer
from desim.live.start import PursuerStart
from desim.pursuit.core.events import BrokeDown

COUNTS = TransportCounts(1, 2, 3, 1, {}, 4, 2, 1, 0, 0, 9)
ACTION = BrokeDown(7, 1)
START = PursuerStart(("10.0.0.1", 4000), "secret", 1, 9, "10.0.0.2", namespace="here", scenario="digest")
LOCAL = START._replace(scenario="")
PEERS = [[["10.0.0.1", 5], None], [["10.0.0.2", 6], ["10.0.0.2", 7]]]


class Recorder:
    """A node and the lines to the referee, which note their calls.

    `fails` is what a run raises, `drops_out` says whether it loses the referee.
    """

    def __init__(self, fails=None, drops_out=False):
        self.lines, self.ended, self.now = [], asyncio.Future(), 0.25
        self.errors, self.clock = [("bind", "why")], SimpleNamespace(lateness=[5, 6])
        self.departures, self.outcomes, self.drops = [(1, 2, b"\x01")], [(3, 4)], (1, 0, 2)
        self.link, self.trace = self, SimpleNamespace(events=[ACTION])
        self._fails, self.drops_out, self.over = fails, drops_out, asyncio.Event()

    def __getattr__(self, name):
        return lambda *words: self.lines.append((name, *words))

    def bind(self, here):
        self.lines.append(("bind", here))
        return ("10.0.0.2", 6)

    def bind_mailbox(self, here):
        self.lines.append(("bind_mailbox", here))
        return ("10.0.0.2", 7)

    def transport_counts(self):
        return COUNTS

    async def run(self, now):
        self.lines.append(("run", now()))
        if self.drops_out:
            self.ended.set_result(None)
            self.lost()
        if self._fails:
            raise self._fails
        await self.over.wait()

    def stop(self, *words):
        self.lines.append(("stop", *words))
        self.over.set()

    def close(self):
        self.lines.append(("close",))
        if not self.ended.done():
            self.ended.set_result(None)


def played(monkeypatch, words, start=START, fails=None, loses=False, refuses=None, drops_out=False):
    """Return the exit code of a pursuer to which a referee says these words, and the calls that it made."""
    times = iter(range(1000, 100_000, 1000))

    @contextmanager
    def within(namespace):
        recorder.lines.append(("within", namespace))
        yield
        recorder.lines.append(("without", namespace))

    async def connect(protocol, host, port):
        if refuses:
            raise refuses
        lines = protocol()
        assert (host, port) == START.referee
        assert lines is recorder
        for word in words:
            recorder.heard(*word)
        if loses:
            recorder.lost()

    def lines_of(heard, lost):
        recorder.heard, recorder.lost = heard, lost
        return recorder

    async def play():
        nonlocal recorder
        recorder = Recorder(fails, drops_out)
        loop = asyncio.get_running_loop()
        monkeypatch.setattr(loop, "create_connection", connect)
        return await _Pursuer(Scenario(), start).play()

    recorder = None
    monkeypatch.setattr(pursuer, "Node", lambda *_, **__: recorder)
    monkeypatch.setattr(pursuer, "Lines", lines_of)
    monkeypatch.setattr(pursuer, "udp_socket", lambda address: recorder.lines.append(("socket", address)) or address)
    monkeypatch.setattr(pursuer, "within_namespace", within)
    monkeypatch.setattr(pursuer, "told", str)
    monkeypatch.setattr(pursuer, "monotonic_ns", lambda: next(times))
    monkeypatch.setattr(pursuer, "process_time", lambda: 0.5)
    code = asyncio.run(play())
    return code, recorder.lines


SOCKET = ("socket", ("10.0.0.2", 0))
OPEN = [("within", "here"), SOCKET, SOCKET, ("without", "here"), ("bind", SOCKET[1]), ("bind_mailbox", SOCKET[1])]
HELLO = ("tell", "hello", 1, "secret", "digest", (("10.0.0.2", 6), ("10.0.0.2", 7)))
READY = [("connect", [("10.0.0.1", 5), ("10.0.0.2", 6)], [None, ("10.0.0.2", 7)]), ("tell", "ready")]
REPORT = ("tell", "report", [(1, 2, "01")], [(3, 4)], [pursuer.line_of(ACTION)])
EMPTY = ("tell", "report", [], [], [])
DONE = ("tell", "done", [*COUNTS], [1, 0, 2], [5, 6], [("bind", "why")], 0.0)
LEAVES = [REPORT, DONE, ("close",)]
FRAME = ("frame", *range(len(WorldFrame._fields)))
BEGIN = [("start", PEERS, True), ("begin", 400)]
RUN = ("run", 600)
"""Begun at 1000 ns, of a run that began at 400 ns."""
PONGS = [("pong", 1_507 + 2_000 * k) for k in range(pursuer.EXCHANGES)]
"""The clock of the referee is ahead by 7 ns; it is asked at 1000, 3000, ... ns, and has answered 1000 ns later."""
LATER = ("run", 607)
SAID = {
    "refused": ([("refused", "no room")], {}, ALONE, []),
    "lost before it begins": ([], {"loses": True}, LOST_REFEREE, []),
    "something else": ([("frame",)], {}, LOST_REFEREE, []),
    "over": ([*BEGIN, ("over", 5)], {}, 0, [*READY, RUN, ("stop", 5), *LEAVES]),
    "a frame, and over": ([*BEGIN, FRAME, ("over",)], {}, 0, [*READY, RUN, ("follow", FRAME[1:]), ("stop",), *LEAVES]),
    "another word": ([*BEGIN, ("nonsense", 5)], {}, 0, [*READY, RUN, ("stop",), *LEAVES]),
    "lost clocks": ([("start", PEERS, False), *PONGS[:1], ("gone",)], {}, LOST_REFEREE, [("tell", "ping")] * 2),
    "another clock": (
        [("start", PEERS, False), *PONGS, ("begin", 16_400), ("over",)],
        {},
        0,
        [*[("tell", "ping")] * 8, *READY, LATER, ("stop",), *LEAVES],
    ),
    "lost in the run": (BEGIN, {"drops_out": True}, LOST_REFEREE, [*READY, RUN, ("stop",), *LEAVES]),
    "an exception": (
        BEGIN,
        {"fails": ValueError("no way")},
        RAISED,
        [*READY, RUN, ("tell", "error", "no way"), *LEAVES],
    ),
}


@pytest.mark.parametrize("name", SAID)
def test_a_pursuer_does_for_each_word_of_the_referee(name, monkeypatch, capsys):
    words, options, code, calls = SAID[name]
    was, lines = played(monkeypatch, words, **options)
    joined = [*OPEN, HELLO]
    assert lines[: len(joined)] == joined
    rest = lines[len(joined) :]
    for part in (lambda call: call[0] == "run", lambda call: call[0] != "run"):  # a run is a task of its own
        assert [*filter(part, rest)] == [*filter(part, calls)]
    assert was == code
    assert capsys.readouterr().err == ("pursuer 1: no room\n" if name == "refused" else "")


@pytest.mark.parametrize(
    ("start", "error", "told"),
    [
        (
            START,
            ConnectionRefusedError(111, "words"),
            "pursuer 1: no referee at 10.0.0.1, port 4000: Connection refused\n",
        ),
        (START, OSError("no number"), "pursuer 1: no referee at 10.0.0.1, port 4000: no number\n"),
        (LOCAL, ConnectionRefusedError(111, "words"), ""),
    ],
)
def test_a_pursuer_that_finds_no_referee_tells_so_on_another_host(start, error, told, monkeypatch, capsys):
    assert played(monkeypatch, [], start, refuses=error) == (ALONE, [])
    assert capsys.readouterr().err == told


def waiting(monkeypatch):
    """Return a pursuer whose node notes its calls; to be called in a loop."""
    recorder = Recorder()
    monkeypatch.setattr(pursuer, "Node", lambda *_, **__: recorder)
    joined = _Pursuer(Scenario(), START)
    joined._lines = recorder
    return joined, recorder.lines


def test_a_report_is_sent_with_a_frame_at_most_each_quarter_of_a_second(monkeypatch):
    async def play():
        joined, lines = waiting(monkeypatch)
        counts = []
        for now in (0.1, REPORTS, 0.26, 0.5, 0.52):
            monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda now=now: now)
            joined._take(*FRAME)
            assert lines.count(("follow", FRAME[1:])) == len(counts) + 1
            counts.append(sum(line[:2] == ("tell", "report") for line in lines))
        monkeypatch.undo()
        return counts, lines

    counts, lines = asyncio.run(play())
    assert REPORTS == 0.25
    assert counts == [0, 0, 1, 1, 2]
    assert [line for line in lines if line[0] == "tell"] == [REPORT, EMPTY]


def test_a_silence_is_told_again_after_a_frame(monkeypatch, capsys):
    naps = []

    async def nap(time):
        naps.append(time)
        now[0] += 0.6
        if len(naps) == 4:
            joined._take("frame", *FRAME[1:])
        if len(naps) == 7:
            raise asyncio.CancelledError

    async def play():
        nonlocal joined
        joined, _ = waiting(monkeypatch)
        monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: now[0])
        with pytest.raises(asyncio.CancelledError):
            await joined._watch()
        monkeypatch.undo()

    joined, now = None, [0.0]
    monkeypatch.setattr(pursuer.asyncio, "sleep", nap)
    asyncio.run(play())
    assert set(naps) == {pursuer.SILENCE / 4}
    assert capsys.readouterr().err.splitlines() == [
        "pursuer 1: no frame of the referee for 1.2 s",
        "pursuer 1: no frame of the referee for 1.2 s",
    ]


@pytest.mark.parametrize("draws", [True, False])
def test_the_node_of_a_pursuer_is_made_as_it_was_told_and_gives_orders(draws, monkeypatch):
    made, told = [], []
    monkeypatch.setattr(pursuer, "Node", lambda *args, **options: made.append((args, options)))
    joined = _Pursuer(Scenario(), START._replace(draws=draws))
    ((args, options),) = made
    assert args == (Scenario(), 1, 9)
    assert set(options) == {"draws", "on_action"}
    assert options["draws"] is draws
    joined._node, joined._lines = SimpleNamespace(now=0.25), SimpleNamespace(tell=lambda *words: told.append(words))
    options["on_action"](3)
    assert told == [("order", 250_000_000, 3)]

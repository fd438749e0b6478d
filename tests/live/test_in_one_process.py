"""Live runs whose pursuers are tasks of this process: how they join, speak, fail and leave."""

import asyncio
import os
import signal
from types import SimpleNamespace

import pytest

from desim import Bernoulli, Constant, Scenario
from desim.kernel.core.events import MessageCounts
from desim.kernel.core.units import nanoseconds
from desim.kernel.models.faults import Crash
from desim.kernel.models.traced_faults import FaultStarted
from desim.live import live_runs as runs_module
from desim.live import lobby, namespaces, node, pursuer, referee
from desim.live.lines import Lines
from desim.live.live_runs import runs
from desim.live.lobby import LiveError, Lobby, ending
from desim.live.namespaces import NamespaceError
from desim.live.pursuer import ALONE, LOST_REFEREE, RAISED, _Pursuer, told
from desim.live.referee import Referee
from desim.live.start import PursuerStart
from desim.pursuit.core.events import Ended
from desim.study.plan.config_hash import identify
from desim.testing.messages import Conservation

HORIZON = 0.05
"""Of each run, s of real time."""


def talk(me):
    """Chase, and announce each 10 ms."""
    while True:
        me.assign(1)
        me.announce()
        yield me.sleep(0.01)


def fall(me):
    """Raise an exception at pursuer 1."""
    yield me.sleep(0.01)
    if me.id == 1:
        raise ValueError("no way")
    yield me.sleep(1.0)


def scenario(protocol=talk, **changes) -> Scenario:
    """Return two slow pursuers over a latency of 2 ms."""
    parts = {"team": {"count": 2, "speeds": 1.0}, "network": {"latency": 0.002}, "horizon": HORIZON}
    return Scenario(protocol=protocol, record={"messages": True}, **parts | changes)


async def join(experiment, start):
    """Play as the process of a pursuer, at whose end its sockets are closed."""
    joined = _Pursuer(experiment, start)
    try:
        return await joined.play()
    finally:
        close(joined)


def close(joined):
    """Close the connection and the sockets of a pursuer that did not play to the end."""
    joined._lines.close()
    for bound in (joined._node._datagrams, joined._node._mailbox):
        if bound is not None and joined._node.clock is None:
            bound.close()


async def sleep(_experiment, _start):
    """Never join."""
    await asyncio.sleep(60)


class Tasks:
    """A nursery whose processes are tasks of this one; `play` is what each does."""

    def __init__(self, play=join, patience=5.0):
        self.play, self.codes, self._patience, self._tasks = play, {}, patience, []

    async def __aenter__(self):
        return self

    async def __aexit__(self, *_):
        _, late = await asyncio.wait(self._tasks, timeout=self._patience)
        for task in late:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def start(self, scenario, starts, ended):
        async def process(start):
            self.codes[start.pursuer] = await self.play(scenario, start)
            ended(start.pursuer, self.codes[start.pursuer])

        self._tasks += [asyncio.create_task(process(start)) for start in starts]


async def left(room):
    """Wait until both ends of all connections of a lobby are closed."""
    await asyncio.gather(*(lines.ended for lines in room._connections))
    await asyncio.sleep(0.01)


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(referee, "LEAD", 0.005)
    monkeypatch.setattr(node, "DRAIN", 0.005)


def played(experiment, tasks=None, **options):
    """Return the result of a run, what it told, and the exit codes of its pursuers."""
    tasks, lines = tasks or Tasks(), []

    async def play():
        judge = Referee(experiment, 4, tell=lines.append, **options)
        try:
            async with tasks:
                return await judge.play(tasks)
        finally:
            await left(judge._lobby)

    return asyncio.run(play()), lines, tasks.codes


def test_a_run_conserves_its_messages_and_all_leave_when_it_is_over():
    result, lines, codes = played(scenario())
    watcher = Conservation()
    for event in result.trace:
        watcher(event)
    (counts,) = result.trace.of(MessageCounts)
    assert counts.sent > 2
    assert counts.sent == counts.delivered + counts.in_flight
    assert (lines, codes, result.conduct.ends, result.conduct.notes) == ([], {0: 0, 1: 0}, {}, [])
    assert result.conduct.cpu.keys() == {0, 1, "referee"}
    assert result.conduct.dropped == (0, 0, 0)
    assert [event.t for event in result.trace.of(Ended)] == [nanoseconds(HORIZON)]
    assert result.seed == 4


def test_losses_and_a_planned_crash_are_those_of_the_scenario():
    crash = {"kind": "crash", "start": 0.02, "node": 1}
    result, _, codes = played(scenario(network={"loss": 1.0}, fault=[crash], team={"count": 2}))
    (counts,) = result.trace.of(MessageCounts)
    assert counts.delivered == 0
    assert set(counts.lost_by) <= {"loss", "crash"}
    assert counts.lost_by["loss"] > 0
    assert [event.fault.node for event in result.trace.of(FaultStarted)] == [1]
    assert codes == {0: 0, 1: 0}


def test_an_exception_of_a_protocol_ends_the_run_with_its_pursuer():
    tasks = Tasks()
    with pytest.raises(LiveError, match=r"(?s)pursuer 1: .*raise ValueError\(.no way.\).*ValueError: no way"):
        played(scenario(fall, horizon=5.0), tasks)
    assert tasks.codes[1] == RAISED


def test_a_pursuer_whose_process_is_lost_crashes_and_the_others_go_on():
    async def play(experiment, start):
        if start.pursuer == 0:
            return await join(experiment, start)
        running = _Pursuer(experiment, start)
        playing = asyncio.create_task(running.play())
        while not running._begin:
            await asyncio.sleep(0.001)
        await asyncio.sleep(0.02)
        playing.cancel()
        running._lines._transport.abort()
        close(running)
        return -9

    result, lines, codes = played(scenario(horizon=0.15), Tasks(play))
    assert codes[0] == 0
    (fault,) = (event.fault for event in result.trace.of(FaultStarted))
    assert isinstance(fault, Crash)
    assert fault.node == 1
    assert lines == [f"pursuer 1 was ended by SIGKILL at {fault.start:.2f} s"]
    assert result.conduct.ends == {1: "was ended by SIGKILL"}


@pytest.mark.parametrize(
    ("status", "text"), [(None, "was lost"), (-15, "was ended by SIGTERM"), (3, "ended with exit code 3")]
)
def test_the_end_of_a_process_is_told(status, text):
    assert ending(status) == text


def test_a_process_that_ends_before_the_run_is_told_at_once():
    async def play(experiment, start):
        return 3 if start.pursuer == 1 else await sleep(experiment, start)

    with pytest.raises(LiveError, match=r"^pursuer 1 ended with exit code 3$"):
        played(scenario(), Tasks(play, 0.0))


def test_processes_that_do_not_join_in_time_are_named(monkeypatch):
    monkeypatch.setattr(lobby, "JOINING", 0.02)

    async def play(experiment, start):
        return await (join if start.pursuer == 0 else sleep)(experiment, start)

    with pytest.raises(LiveError, match=r"^no process of pursuer 0, 1 has joined within 0\.02 s$"):
        played(scenario(), Tasks(play, 0.0))


def test_a_pursuer_of_another_host_joins_by_its_invitation_and_measures_its_clock(monkeypatch):
    """The host is this one under another name, which the lobby does not take for its own."""
    monkeypatch.setattr(lobby, "_is_local", lambda host: host != "localhost")
    monkeypatch.setattr(lobby, "_address_towards", lambda host: {"localhost": "127.0.0.1"}[host])
    experiment, joined = scenario(), []

    def tell(line):
        start = PursuerStart.invited(line.rpartition(" ")[2], experiment)
        joined.append((line, asyncio.create_task(join(experiment, start))))

    async def play():
        judge = Referee(experiment, 4, hosts=["127.0.0.1", "localhost"], tell=tell)
        async with Tasks() as tasks:
            result, code = await judge.play(tasks), await joined[0][1]
        await left(judge._lobby)
        return result, code, tasks.codes

    result, code, codes = asyncio.run(play())
    assert joined[0][0].startswith("on localhost: desim live FILE --join 127.0.0.1:")
    assert (code, codes) == (0, {0: 0})
    assert result.conduct.ends == {}


def test_strangers_are_refused_with_a_reason(capsys):
    experiment, heard = scenario(), {}

    async def refused(referee_at, *words):
        lines = []
        loop = asyncio.get_running_loop()
        _, stranger = await loop.create_connection(lambda: Lines(lambda *line: lines.append(line)), *referee_at)
        stranger.tell(*words)
        await stranger.ended
        return lines

    async def play():
        room = Lobby(experiment, ["127.0.0.1"] * 2, lambda *_: None, lambda *_: None)
        gathering = asyncio.create_task(room.gather(Tasks(sleep), 4, ["", ""], draws=True, tell=print))
        while not hasattr(room, "_server"):
            await asyncio.sleep(0)
        at, token = room._server.sockets[0].getsockname(), room._token
        here = [["127.0.0.1", 1], None]
        heard["garbage"] = await refused(at, "good day")
        heard["token"] = await refused(at, "hello", 0, "wrong", "", here)
        heard["letter"] = await refused(at, "hello", 0, "\ud800", "", here)
        heard["pursuer"] = await refused(at, "hello", 2, token, "", here)
        heard["scenario"] = await refused(at, "hello", 0, token, "other", here)
        other = PursuerStart(at, token, 0, 4, "127.0.0.1", scenario="other")
        heard["exit code"] = await join(experiment, other)
        gathering.cancel()
        room.close()
        heard["nobody"] = await join(experiment, other)
        heard["same"] = room._refusal(0, token, identify(experiment).key)
        await asyncio.gather(gathering, return_exceptions=True)
        await left(room)

    asyncio.run(play())
    assert heard == {
        "garbage": [("refused", "it does not speak as a pursuer does")],
        "token": [("refused", "the referee does not know this process")],
        "letter": [("refused", "the referee does not know this process")],
        "pursuer": [("refused", "the run has no pursuer 2, or has it already")],
        "scenario": [("refused", "the scenario of the run, its code or its data files are others")],
        "exit code": ALONE,
        "nobody": ALONE,
        "same": "",
    }
    told_lines = capsys.readouterr().err.splitlines()
    assert told_lines[0] == "pursuer 0: the scenario of the run, its code or its data files are others"
    assert told_lines[1].startswith("pursuer 0: no referee at 127.0.0.1, port ")


@pytest.mark.parametrize("data", [b"[" * 100_000 + b"\n", b"7\n", b"[]\n", b"\xff\n"])
def test_what_is_no_line_closes_the_connection(data):
    async def play():
        closed, heard = [], []
        lines = Lines(lambda *words: heard.append(words))
        lines.connection_made(SimpleNamespace(close=lambda: closed.append(True)))
        lines.data_received(b'["ready"]\n' + data)
        return heard, closed

    assert asyncio.run(play()) == ([("ready",)], [True])


def test_the_fastest_exchange_decides_by_how_much_a_clock_is_behind(monkeypatch):
    """Sent and received at these times of the own clock, ns; the third exchange takes 2 ns, and others are slowed."""
    own = [0, 90, 100, 150, 200, 202, 300, 380, 400, 490, 500, 590, 600, 690, 700, 790]
    there = [85, 1140, 1201, 1375, 1485, 1585, 1685, 1785]

    async def play():
        heard, times = asyncio.Queue(), iter(own)
        monkeypatch.setattr(pursuer, "monotonic_ns", lambda: next(times))
        player = object.__new__(_Pursuer)
        player._lines = SimpleNamespace(tell=lambda _: None)
        for time in there:
            heard.put_nowait(("pong", time))
        return await player._measured_offset(heard)

    assert asyncio.run(play()) == 1000


def test_a_pursuer_of_another_host_that_loses_the_referee_while_it_compares_clocks_ends():
    async def play():
        heard, told = asyncio.Queue(), []
        player = object.__new__(_Pursuer)
        player._lines = SimpleNamespace(tell=told.append)
        for answer in (("pong", 5), ("pong", 6), ("gone",)):
            heard.put_nowait(answer)
        with pytest.raises(ConnectionError):
            await player._measured_offset(heard)
        return told

    assert asyncio.run(play()) == ["ping"] * 3


def test_a_pursuer_tells_that_the_referee_is_silent_and_ends(monkeypatch, capsys):
    monkeypatch.setattr(pursuer, "SILENCE", 0.02)
    monkeypatch.setattr(pursuer, "GIVE_UP", 0.04)
    codes = []

    def ended(code):
        codes.append(code)
        raise asyncio.CancelledError

    monkeypatch.setattr(pursuer.os, "_exit", ended)

    async def play():
        start = PursuerStart(("127.0.0.1", 1), "", 0, 4, "127.0.0.1")
        silent = _Pursuer(scenario(), start)
        silent._heard = asyncio.get_running_loop().time()
        with pytest.raises(asyncio.CancelledError):
            await silent._watch()

    asyncio.run(play())
    assert codes == [LOST_REFEREE]
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("pursuer 0: no frame of the referee for 0.0")


def test_runs_are_in_the_order_of_their_seeds_and_told_as_they_end(monkeypatch):
    monkeypatch.setattr(runs_module, "Nursery", Tasks)
    experiment, finished = scenario(horizon=0.02), []
    results = runs(experiment, [3, 1, None], at_once=2, finished=finished.append)
    assert [result.seed for result in results] == [3, 1, experiment.seed]
    assert len(finished) == 3

    async def within_a_loop():
        return runs_module.run(experiment, 6).seed

    assert asyncio.run(within_a_loop()) == 6
    for wrong, why in (
        ({"hosts": ["127.0.0.1"]}, "hosts should be the names or addresses of 2 hosts, one for each"),
        ({"hosts": ["127.0.0.1"] * 2, "links": "netem"}, 'links should be "drawn"'),
    ):
        with pytest.raises(ValueError, match=why):
            runs(experiment, [1], **wrong)


def test_the_exception_of_a_run_within_a_loop_is_raised_there(monkeypatch):
    monkeypatch.setattr(runs_module, "Nursery", Tasks)

    async def within_a_loop():
        runs_module.run(scenario(fall, horizon=5.0), 6)

    with pytest.raises(LiveError, match="no way"):
        asyncio.run(within_a_loop())


def test_a_traceback_has_the_calls_of_the_protocol_only():
    def inner():
        raise KeyError("x")

    try:
        inner()
    except KeyError as error:
        error.add_note("(pursuer 1)")
        text = told(error)
    assert "inner()" in text
    assert text.endswith("KeyError: 'x' (pursuer 1)")
    assert told(ValueError("alone")) == "ValueError: alone"


# Network namespaces, with the commands that would be run.


class Shell:
    """Notes the commands of `subprocess.run`; those that contain `fails` fail."""

    def __init__(self, fails=None, output=""):
        self.lines, self.tables, self._fails, self._output = [], [], fails, output

    def __call__(self, words, *, env=None, **options):
        assert options.items() <= {"check": False, "capture_output": True, "text": True}.items()
        assert options["capture_output"], "what a command says is for a message, and not for the terminal"
        line = " ".join(words)
        self.lines.append(line)
        self.tables.append((env or {}).get("TC_LIB_DIR") is not None)
        return SimpleNamespace(
            returncode=int(self._fails is not None and self._fails in line), stderr=self._output, stdout=""
        )


@pytest.fixture
def shell(monkeypatch):
    monkeypatch.setattr(namespaces.os, "getpid", lambda: 7)

    def use(**options):
        made = Shell(**options)
        monkeypatch.setattr(namespaces.subprocess, "run", made)
        return made

    return use


NETS = """\
ip netns add desim-7
ip netns add desim-7-0
ip netns add desim-7-1
ip -n desim-7 link add bridge type bridge
ip -n desim-7 link set bridge up
ip -n desim-7 link add p0 type veth peer name eth0 netns desim-7-0
ip -n desim-7 link set p0 master bridge up
ip -n desim-7-0 addr add 10.213.0.1/16 dev eth0
ip -n desim-7-0 link set eth0 up
ip netns exec desim-7-0 tc qdisc add dev eth0 root netem delay 2ms loss random 10%
ip -n desim-7 link add p1 type veth peer name eth0 netns desim-7-1
ip -n desim-7 link set p1 master bridge up
ip -n desim-7-1 addr add 10.213.0.2/16 dev eth0
ip -n desim-7-1 link set eth0 up
ip netns exec desim-7-1 tc qdisc add dev eth0 root netem delay 2ms loss random 10%
ip netns del desim-7
ip netns del desim-7-0
ip netns del desim-7-1""".splitlines()


def test_each_pursuer_has_a_namespace_with_netem_which_is_removed(shell):
    commands = shell()
    lossy = scenario(network={"latency": Constant(value=0.002), "loss": Bernoulli(p=0.1)})
    with namespaces.namespaces(lossy, netem=True) as places:
        assert places == (["desim-7-0", "desim-7-1"], ["10.213.0.1", "10.213.0.2"])
        assert commands.lines == NETS[:-3]
    assert commands.lines == NETS
    assert not any(commands.tables)
    plain = shell()
    with namespaces.namespaces(lossy, netem=False):
        pass
    assert plain.lines == [line for line in NETS if " tc " not in line]


def test_tables_of_netem_are_where_tc_looks_for_them(shell):
    commands = shell()
    with namespaces.namespaces(
        scenario(network={"latency": {"kind": "netem", "delay": 0.01, "jitter": 0.002, "table": [-8192, 0, 8192]}}),
        netem=True,
    ):
        pass
    assert sum(commands.tables) == 2


def test_more_than_255_pursuers_have_an_address_each(shell, monkeypatch):
    shell()
    monkeypatch.setattr(namespaces, "_shape", lambda *_: None)
    with namespaces.namespaces(SimpleNamespace(team=SimpleNamespace(count=300)), netem=False) as places:
        assert places.hosts[254:257] == ["10.213.0.255", "10.213.1.0", "10.213.1.1"]
        assert len(set(places.hosts)) == 300


def test_what_fails_is_told_and_what_was_made_is_removed(shell, monkeypatch):
    commands = shell(fails="bridge type", output="not permitted\n")
    with (
        pytest.raises(
            NamespaceError, match=r"cannot be used here: ip -n desim-7 link add bridge type bridge: not permitted$"
        ),
        namespaces.namespaces(scenario(), netem=False),
    ):
        pass
    assert commands.lines[-3:] == NETS[-3:]
    shell(fails="tc", output="no such file")
    with (
        pytest.raises(NamespaceError, match=r"--netem: `tc qdisc .*` failed here: no such file; the kernel may lack"),
        namespaces.namespaces(scenario(), netem=True),
    ):
        pass

    def missing(*_, **__):
        raise FileNotFoundError

    monkeypatch.setattr(namespaces.subprocess, "run", missing)
    with pytest.raises(NamespaceError, match="need the command ip"):
        namespaces._ip("link")


@pytest.mark.parametrize(
    ("network", "why"),
    [
        ({"latency": {"kind": "propagation"}}, "--netem: network.latency: .*; without --netem the receivers draw"),
        ({"link": [{"src": 0, "dst": 1, "latency": 0.1}]}, "--netem: each pursuer has one interface"),
    ],
)
def test_links_that_netem_cannot_have_are_refused(shell, network, why):
    shell()
    with pytest.raises(NamespaceError, match=why), namespaces.namespaces(scenario(network=network), netem=True):
        pass


def test_sockets_are_made_in_the_namespace_and_the_process_returns(monkeypatch, tmp_path):
    entered, codes = [], iter([0, 0, 1])
    (tmp_path / "there").write_text("")
    monkeypatch.setattr(namespaces, "FOLDER", tmp_path)
    opened = {}

    def open_of(path, _flags, real=namespaces.os.open):
        number = real(tmp_path / "there", _flags)
        opened[number] = str(path)
        return number

    monkeypatch.setattr(namespaces.os, "open", open_of)
    library = SimpleNamespace(setns=lambda number, kind: entered.append((opened[number], kind)) or next(codes))
    monkeypatch.setattr(namespaces.ctypes, "CDLL", lambda *_, **__: library)
    there, home = (str(tmp_path / "there"), 0x40000000), ("/proc/self/ns/net", 0x40000000)
    with namespaces.within_namespace("there"):
        assert entered == [there]
    assert entered == [there, home]
    with pytest.raises(OSError, match="the namespace there cannot be entered"), namespaces.within_namespace("there"):
        pass
    with namespaces.within_namespace(""):
        pass
    assert entered == [there, home, there]
    for number in opened:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(number)


def test_an_interrupt_in_a_notebook_ends_the_run_before_it_is_raised():
    """A notebook has a loop already, so the run has a thread of its own. Another signal stands for Ctrl-C."""
    ended = []

    def interrupt(*_):
        raise KeyboardInterrupt

    async def play():
        try:
            os.kill(os.getpid(), signal.SIGUSR1)
            await asyncio.sleep(30.0)
        finally:
            await asyncio.sleep(0.01)
            ended.append(True)

    async def cell():
        with pytest.raises(KeyboardInterrupt):
            runs_module._run(play)
        return [*ended]

    before, loop = signal.signal(signal.SIGUSR1, interrupt), asyncio.new_event_loop()
    try:
        assert loop.run_until_complete(cell()) == [True]
    finally:
        loop.close()
        signal.signal(signal.SIGUSR1, before)


def test_a_run_in_a_notebook_that_is_interrupted_before_it_begins_does_not_begin(monkeypatch):
    begun, late = [], []

    class LateThread(SimpleNamespace):
        def start(self):
            late.append(self.target)
            raise KeyboardInterrupt

    async def play():
        begun.append(True)

    async def cell():
        with pytest.raises(KeyboardInterrupt):
            runs_module._run(play)

    monkeypatch.setattr(runs_module, "Thread", LateThread)
    asyncio.run(cell())
    late[0]()
    assert not begun

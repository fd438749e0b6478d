"""The lobby of a live run: where the processes of the pursuers join, speak and leave."""

import asyncio
import hmac
import secrets
import socket
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from signal import Signals
from time import monotonic_ns
from typing import Any

from desim.live.lines import Lines, encoded_line
from desim.live.nursery import Nursery
from desim.live.sockets import family_of, resolved, udp_socket
from desim.live.start import PursuerStart
from desim.scenario.scenario import Scenario
from desim.study.plan.config_hash import identify

LOCAL = "127.0.0.1"
JOINING = 60.0
"""Time in which the processes of this machine should have joined, s."""
HOSTS = 600.0
"""Time in which processes of other hosts should have joined, s."""
BACKLOG = 1 << 20
"""Largest number of unread bytes with which a pursuer still gets frames."""


class LiveError(RuntimeError):
    """A live run could not begin, or a protocol has raised an exception."""


class Lobby:
    """The connections to the pursuers of one run.

    Args:
        scenario: the experiment.
        hosts: (N,) the host at which each pursuer listens.
        hear: called with a pursuer and a line that it has sent, as a word and values.
        lose: called with a pursuer whose process was lost during the run, and how it ended.

    Attributes:
        errors: the exceptions of protocols, as text.
        is_over: whether the run is over, so that a process may leave.
    """

    def __init__(
        self,
        scenario: Scenario,
        hosts: Sequence[str],
        hear: Callable[..., object],
        lose: Callable[[int, str], object],
    ):
        self._scenario, self._hosts, self._hear, self._lose = scenario, hosts, hear, lose
        self._token = secrets.token_hex(16)
        self._connections: list[Lines] = []
        self._joined: dict[int, _Pursuer] = {}
        self._ready: set[int] = set()
        self._statuses: dict[int, int | None] = {}
        """The exit status of each process that has ended; None: it is not known."""
        self._changed = asyncio.Event()
        self.errors: list[str] = []
        self.is_over = False

    async def gather(
        self,
        nursery: Nursery,
        seed: int,
        namespaces: Sequence[str],
        *,
        draws: bool,
        tell: Callable[[str], object],
    ) -> None:
        """Start the processes of this machine, and wait until all pursuers are ready.

        Args:
            nursery: starts the processes.
            seed: the seed of the run.
            namespaces: (N,) the network namespace of each pursuer; empty: that of the caller.
            draws: whether losses and latencies are drawn by the receivers.
            tell: called with the commands to start on other hosts.

        Raises:
            LiveError: if a process ends, or does not join in time.
        """
        self._distant = [
            pursuer for pursuer, host in enumerate(self._hosts) if not namespaces[pursuer] and not _is_local(host)
        ]
        own_host = _address_towards(self._hosts[self._distant[0]]) if self._distant else LOCAL
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(self._welcome, own_host, 0)
        referee = own_host, int(self._server.sockets[0].getsockname()[1])
        starts = [
            PursuerStart(referee, self._token, pursuer, seed, host, draws, namespaces[pursuer])
            for pursuer, host in enumerate(self._hosts)
        ]
        for pursuer in self._distant:
            tell(f"on {self._hosts[pursuer]}: desim live FILE --join {starts[pursuer].invitation()}")
        local = [start for start in starts if start.pursuer not in self._distant]
        if local:
            await nursery.start(self._scenario, local, self._ended)
        await self._until(lambda: len(self._joined) == len(starts), HOSTS if self._distant else JOINING)
        addresses = [self._joined[pursuer].addresses for pursuer in range(len(starts))]
        for pursuer, joined in self._joined.items():
            joined.lines.tell("start", addresses, pursuer not in self._distant)
        await self._until(lambda: len(self._ready) == len(starts), JOINING)

    def tell_all(self, *words: Any, may_skip: bool = False) -> None:
        """Send a line to all pursuers; with `may_skip`, not to those that are far behind with reading."""
        line = encoded_line(*words)
        for pursuer in self._joined.values():
            if not (pursuer.is_done or (may_skip and pursuer.lines.unread > BACKLOG)):
                pursuer.lines.write(line)

    async def reports(self, limit: float) -> list[int]:
        """Wait for the last report of each pursuer; return the pursuers that have not sent it within a limit, s."""
        with suppress(LiveError):
            await self._until(lambda: not self._missing(), limit, ends_fail=False)
        self.is_over = True
        return self._missing()

    def close(self) -> None:
        """Close all connections, which ends the processes that are still there."""
        self.is_over = True
        if hasattr(self, "_server"):
            self._server.close()
        for lines in self._connections:
            lines.close()

    def _missing(self) -> list[int]:
        return sorted(number for number, pursuer in self._joined.items() if not pursuer.is_done)

    def _ended(self, pursuer: int, status: int | None) -> None:
        """Note how a process has ended."""
        self._statuses[pursuer] = status
        self._changed.set()

    async def _until(self, holds: Callable[[], bool], limit: float, *, ends_fail: bool = True) -> None:
        """Wait until a condition about all pursuers holds.

        Raises:
            LiveError: if the condition does not hold within a limit, s, or, with `ends_fail`, if a process ends before.
        """
        try:
            async with asyncio.timeout(limit):
                while not holds():
                    if ends_fail and (self.errors or self._statuses):
                        ends = [f"pursuer {pursuer} {ending(status)}" for pursuer, status in self._statuses.items()]
                        raise LiveError(self.errors[0] if self.errors else "; ".join(ends))
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            late = sorted(set(range(len(self._hosts))) - self._ready)
            text = ", ".join(map(str, late))
            raise LiveError(f"no process of pursuer {text} has joined within {limit:g} s") from None

    # Connections.

    def _welcome(self) -> Lines:
        """Return this end of the connection of a process that has yet to name its pursuer."""
        lines = Lines(lambda *words: self._admit(lines, *words))
        self._connections.append(lines)
        return lines

    def _admit(self, lines: Lines, word: str, *values: Any) -> None:
        """Let a process join the run, or refuse it."""
        match word, *values:
            case "hello", int(pursuer), str(token), scenario, [address, mailbox]:
                why = self._refusal(pursuer, token, scenario)
            case _:
                why = "it does not speak as a pursuer does"
        if why:
            lines.tell("refused", why)
            lines.close()
            return
        self._joined[pursuer] = _Pursuer(lines, [address, mailbox])
        lines.hear, lines.lost = partial(self._take, pursuer), partial(self._leave, pursuer)
        self._changed.set()

    def _refusal(self, pursuer: int, token: str, scenario: str) -> str:
        """Return why a process cannot join as a pursuer; "" if it can."""
        if not hmac.compare_digest(token.encode(errors="replace"), self._token.encode()):
            return "the referee does not know this process"
        if pursuer not in range(len(self._hosts)) or pursuer in self._joined:
            return f"the run has no pursuer {pursuer}, or has it already"
        is_same = not scenario or scenario == identify(self._scenario).key
        return "" if is_same else "the scenario of the run, its code or its data files are others"

    def _take(self, pursuer: int, word: str, *values: Any) -> None:
        """Take a line of a pursuer."""
        joined = self._joined[pursuer]
        if word == "ping":
            joined.lines.tell("pong", monotonic_ns())
            return
        if word == "ready":
            self._ready.add(pursuer)
        elif word == "error":
            self.errors.append(f"pursuer {pursuer}: {values[0]}")
        else:
            joined.is_done |= word == "done"
            self._hear(pursuer, word, *values)
        self._changed.set()

    def _leave(self, pursuer: int) -> None:
        """Note that the process of a pursuer has closed its connection."""
        joined = self._joined[pursuer]
        if not self.is_over and (self.errors or not joined.is_done):
            joined.is_done = True
            joined.loss = asyncio.create_task(self._tell_loss(pursuer))
        self._changed.set()

    async def _tell_loss(self, pursuer: int) -> None:
        """Tell how the process of a pursuer ended, once the nursery has told its status; wait 0.2 s at most."""
        for _ in range(20):
            if pursuer in self._statuses or pursuer in self._distant:
                break
            await asyncio.sleep(0.01)
        self._lose(pursuer, ending(self._statuses.get(pursuer)))


@dataclass
class _Pursuer:
    """A pursuer that has joined."""

    lines: Lines
    addresses: list[Any]
    """The addresses of its socket and of its mailbox."""
    is_done: bool = False
    """Whether its last report has come, or its process was lost."""
    loss: asyncio.Task[None] | None = None
    """The call of `_tell_loss`; asyncio does not keep a task alive by itself."""


def ending(status: int | None) -> str:
    """Return how a process ended as text, given its status; None: it is not known."""
    if status is None:
        return "was lost"
    return f"was ended by {Signals(-status).name}" if status < 0 else f"ended with exit code {status}"


def _is_local(host: str) -> bool:
    """Return whether a host is this machine."""
    try:
        udp_socket((host, 0)).close()
    except OSError:
        return False
    return True


def _address_towards(host: str) -> str:
    """Return the address of this machine in the network of a host."""
    try:
        target = resolved((host, 9))  # of UDP, `connect` sends nothing: any port will do
        with socket.socket(family_of(target), socket.SOCK_DGRAM) as probe:
            probe.connect(target)
            return str(probe.getsockname()[0])
    except OSError as error:
        raise LiveError(f"{host}: no way leads there: {error.strerror or error}") from error

"""Network namespaces of Linux: each pursuer has an interface of its own, on which netem may make the links."""

import ctypes
import os
import shlex
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from desim.kernel.models.netem_tables import table_text
from desim.kernel.tc.writer import script
from desim.scenario.scenario import Scenario

FOLDER = Path("/var/run/netns")
"""Where `ip netns` puts the names of namespaces."""
CLONE_NEWNET = 0x40000000
"""Says to `setns` that the file is of a network namespace; see `<linux/sched.h>`."""
DEVICE = "eth0"
"""The interface of a pursuer in its namespace."""


class NamespaceError(RuntimeError):
    """Network namespaces, or netem, cannot be used here."""


class Places(NamedTuple):
    """Where the pursuers of a run listen."""

    namespaces: list[str]
    """(N,) names; "": the namespace of the caller."""
    hosts: list[str]
    """(N,) addresses."""


@contextmanager
def within_namespace(namespace: str) -> Iterator[None]:
    """Put the sockets that are created in this context into a network namespace; "" is that of the process.

    A socket stays in its namespace, so that one process can have sockets in two.
    """
    if not namespace:
        yield
        return
    libc: Any = ctypes.CDLL(None, use_errno=True)
    home, target = os.open("/proc/self/ns/net", os.O_RDONLY), os.open(FOLDER / namespace, os.O_RDONLY)
    try:
        if libc.setns(target, CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), f"the namespace {namespace} cannot be entered")
        try:
            yield
        finally:
            libc.setns(home, CLONE_NEWNET)
    finally:
        os.close(home)
        os.close(target)


@contextmanager
def namespaces(scenario: Scenario, *, netem: bool) -> Iterator[Places]:
    """Create a namespace for each pursuer, joined by a bridge, and remove all at the end.

    Args:
        scenario: the experiment.
        netem: whether the interfaces get the commands of `desim netem` for the links of the scenario.

    Raises:
        NamespaceError: if namespaces cannot be created, this system has no netem, or netem cannot express the links.
    """
    size, prefix = scenario.team.count, f"desim-{os.getpid()}"
    names = [f"{prefix}-{pursuer}" for pursuer in range(size)]
    # One network /16 in a private range that few others use: 65,534 addresses, from 10.213.0.1 on.
    hosts = [f"10.213.{(pursuer + 1) >> 8}.{(pursuer + 1) & 0xFF}" for pursuer in range(size)]
    commands, tables = _netem_commands(scenario) if netem else ([], {})
    created: list[str] = []
    try:
        for name in [prefix, *names]:
            _ip("netns", "add", name)
            created.append(name)
        _ip("-n", prefix, "link", "add", "bridge", "type", "bridge")
        _ip("-n", prefix, "link", "set", "bridge", "up")
        for pursuer, (name, host) in enumerate(zip(names, hosts, strict=True)):
            port = f"p{pursuer}"
            _ip("-n", prefix, "link", "add", port, "type", "veth", "peer", "name", DEVICE, "netns", name)
            _ip("-n", prefix, "link", "set", port, "master", "bridge", "up")
            _ip("-n", name, "addr", "add", f"{host}/16", "dev", DEVICE)
            _ip("-n", name, "link", "set", DEVICE, "up")
            _shape(name, commands, tables)
        yield Places(names, hosts)
    finally:
        for name in created:  # the interfaces of a namespace, and the bridge in the first one, are removed with it
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)


def _netem_commands(scenario: Scenario) -> tuple[list[str], Mapping[str, tuple[int, ...]]]:
    """Return the commands of `desim netem`, and the tables that they name.

    Raises:
        NamespaceError: if netem does not express the links, or some links have other models.
    """
    commands = script(scenario.network, scenario.team.count, DEVICE, scenario.wall)
    lines = [line for line in commands.lines if line and not line.startswith("#")]
    for key, why in commands.missing:
        raise NamespaceError(f"--netem: {key}: {why}; without --netem the receivers draw the links")
    if len(lines) > 1:
        raise NamespaceError(
            "--netem: each pursuer has one interface, and network.link has models of its own for some links; without"
            " --netem the receivers draw them"
        )
    return lines, commands.tables


def _shape(name: str, commands: list[str], tables: Mapping[str, tuple[int, ...]]) -> None:
    """Run the commands of tc in a namespace; raise NamespaceError if one of them fails."""
    with TemporaryDirectory() as folder:
        for table, numbers in tables.items():
            (Path(folder) / f"{table}.dist").write_text(table_text(numbers, table), encoding="utf-8")
        environment = {**os.environ, "TC_LIB_DIR": folder} if tables else None  # where tc looks for tables
        for command in commands:
            result = subprocess.run(
                ["ip", "netns", "exec", name, *shlex.split(command)],
                check=False,
                capture_output=True,
                text=True,
                env=environment,
            )
            if result.returncode:
                why = result.stderr.strip() or result.stdout.strip()
                raise NamespaceError(
                    f"--netem: `{command}` failed here: {why}; the kernel may lack CONFIG_NET_SCH_NETEM; without"
                    " --netem the receivers draw the links"
                )


def _ip(*words: str) -> None:
    """Run `ip` with some words as its arguments; raise NamespaceError if it fails."""
    try:
        result = subprocess.run(["ip", *words], check=False, capture_output=True, text=True)
    except FileNotFoundError as error:
        raise NamespaceError("network namespaces need the command ip (iproute2) of Linux") from error
    if result.returncode:
        raise NamespaceError(f"network namespaces cannot be used here: ip {' '.join(words)}: {result.stderr.strip()}")

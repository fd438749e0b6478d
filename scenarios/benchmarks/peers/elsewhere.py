"""Deliver the broadcasts of a workload in other simulators, each in a temporary environment.

The programs for these simulators (peer_*) are standalone and read a workload as text from stdin. The first line has
the number of turns, the time between two turns (s), the mean latency (s), the coefficient of variation of the latency
(0: constant) and a seed. Then a line per node, in order of the ids, lists its neighbours. Each program draws its own
latencies and runs until all messages are delivered. The last line that it prints has the number of deliveries and the
CPU time (s) as JSON.
"""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from desim.kernel.models.latency import Constant
from scenarios.benchmarks.peers.workloads import TICK, Workload

PROGRAMS = Path(__file__).parent
TIMEOUT = 600.0
"""Time-out of a command, s."""


class UnavailableError(Exception):
    """A simulator is not available on this machine or fails; the text is the reason."""


@dataclass(frozen=True)
class Peer:
    """Another simulator."""

    program: str
    packages: tuple[str, ...]
    """Python packages with exact versions; for a program in C++, Debian packages."""
    libraries: tuple[str, ...] = ()
    """Libraries to link a program in C++ with."""
    share: float = 1.0
    """Share of the turns of a workload that the program runs, less than 1 for a slow simulator."""

    def make(self, folder: Path) -> list[str]:
        """Make an environment in a new folder and return the command that runs the program.

        Raises:
            UnavailableError: if the environment cannot be made.
            FileExistsError: if the folder exists.
        """
        folder.mkdir()
        return self._build(folder) if self.program.endswith(".cpp") else self._install(folder)

    def _install(self, folder: Path) -> list[str]:
        _run_command([sys.executable, "-m", "venv", str(folder)])
        python = str(folder / ("Scripts" if sys.platform == "win32" else "bin") / "python")
        _run_command([python, "-m", "pip", "install", "-q", *self.packages])
        return [python, str(PROGRAMS / self.program)]

    def _build(self, folder: Path) -> list[str]:
        _run_command(["apt-get", "download", *self.packages], folder)
        for package in sorted(folder.glob("*.deb")):
            _run_command(["dpkg", "-x", str(package), "."], folder)
        library_folders = sorted((folder / "usr" / "lib").glob("*-linux-gnu"))
        at_build = [f"-I{folder}/usr/include", *(f"-L{library_folder}" for library_folder in library_folders)]
        # RPATH, unlike RUNPATH, is also searched for the dependencies of the libraries.
        at_run = ["-Wl,--disable-new-dtags", *(f"-Wl,-rpath,{library_folder}" for library_folder in library_folders)]
        sources = [str(PROGRAMS / self.program), *(f"-l{library}" for library in self.libraries)]
        _run_command(["g++", "-O3", "-DNDEBUG", "-std=c++17", "-o", "program", *at_build, *at_run, *sources], folder)
        return [str(folder / "program")]

    def run(self, command: Sequence[str], work: Workload) -> tuple[int, float]:
        """Run the program on its share of a workload; return the number of deliveries and the CPU time, s.

        Raises:
            UnavailableError: if the program fails or delivers a wrong number of messages.
        """
        work = replace(work, turns=max(1, round(self.share * work.turns)))
        answer = json.loads(_run_command(command, stdin=text(work)).splitlines()[-1])
        neighbours = work.neighbours()
        due = sum(len(neighbours[number % work.size]) for number in range(work.turns))
        if answer["deliveries"] != due:
            raise UnavailableError(f"{answer['deliveries']} deliveries instead of {due}")
        return due, answer["seconds"]


PEERS: Mapping[str, Peer] = MappingProxyType(
    {
        "ns-3": Peer(
            "peer_ns3.cpp",
            ("libns3-dev", "libns3.37", "libgsl27", "libgslcblas0", "libsqlite3-0"),
            ("ns3-network", "ns3-core"),
        ),
        "simgrid": Peer(
            "peer_simgrid.cpp",
            (
                *("libsimgrid-dev", "libsimgrid3.32", "libboost1.74-dev", "libboost-context1.74.0"),
                *("libboost-stacktrace1.74.0", "libns3.37", "libgsl27", "libgslcblas0", "libsqlite3-0"),
                *("libgfortran5", "libquadmath0"),
            ),
            ("simgrid",),
        ),
        "mesa": Peer("peer_mesa.py", ("mesa==3.3.1",)),
        "gradysim": Peer("peer_gradysim.py", ("gradysim==0.8.2",)),
        "mango": Peer("peer_mango.py", ("mango-agents==2.4.0",), share=0.1),
    }
)


def text(work: Workload) -> str:
    """Return a workload as the text that the programs read."""
    latency = work.latency
    mean, cv = (latency.value, 0.0) if isinstance(latency, Constant) else (latency.mean, latency.cv)
    lines = [
        f"{work.turns} {TICK} {mean} {cv} {work.seed}",
        *(" ".join(map(str, neighbours)) for neighbours in work.neighbours()),
    ]
    return "\n".join(lines) + "\n"


def _run_command(command: Sequence[str], folder: Path | None = None, stdin: str = "") -> str:
    """Run a command, with some text on stdin, and return its output.

    Raises:
        UnavailableError: if the command does not exist, fails or takes too long.
    """
    try:
        ended = subprocess.run(
            command, cwd=folder, input=stdin, capture_output=True, text=True, check=True, timeout=TIMEOUT
        )
    except FileNotFoundError as error:
        raise UnavailableError(f"there is no {command[0]}") from error
    except subprocess.TimeoutExpired as error:
        raise UnavailableError(f"{command[0]} takes more than {TIMEOUT:g} s") from error
    except subprocess.CalledProcessError as error:
        complaint = (error.stderr.strip() or error.stdout.strip()).splitlines() or [f"exit code {error.returncode}"]
        raise UnavailableError(f"{Path(command[0]).name}: {complaint[-1].strip()}") from error
    return ended.stdout

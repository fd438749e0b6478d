"""How far a sweep is: its runs that are done, running and failed, part by part, from its stores and from Slurm."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from desim.analysis.tables import aligned
from desim.config.arguments import RESULTS, naming_arguments
from desim.config.file_names import STORE, STORE_PARTS, STORES
from desim.config.number_texts import counted
from desim.results import provenance
from desim.study.store.store import Store
from desim.study.sweeps.array_job import ArrayJob, states
from desim.study.sweeps.planned import PlannedRuns, Run

HEAD = ("part", "planned", "done", "failed", "state")


@dataclass(frozen=True)
class SweepPart:
    """A part of a sweep, with a store of its own."""

    name: str
    planned: int | None
    """The number of its runs; None if the part claims its runs, or the number was not recorded."""
    done: int
    """The number of runs that succeeded."""
    failed: int
    state: str
    """done; unfinished; not begun; the state in Slurm, in the words of squeue; stored, if it has no plan; or why its
    store cannot be read."""


@dataclass(frozen=True)
class SweepStatus:
    """The progress of a sweep."""

    name: str
    """The name of the scenario; "" if no store can be read."""
    planned: int | None
    """The number of its runs; None if it was not recorded, or the sweep ends when a mean is precise enough."""
    done: int
    """The number of planned runs that succeeded, each counted once."""
    failed: int
    parts: tuple[SweepPart, ...]

    @property
    def is_complete(self) -> bool:
        """Whether all runs succeeded."""
        return self.planned is not None and self.done >= self.planned

    def __str__(self) -> str:
        of_planned = "" if self.planned is None else f" of {self.planned:,}"
        failed = f", {counted(self.failed, 'run')} failed" if self.failed else ""
        running_parts = len([part for part in self.parts if part.state.startswith("RUNNING")])
        running = f", {counted(running_parts, 'part')} running" if running_parts else ""
        runs = "run is" if self.done == 1 and not of_planned else "runs are"
        of_sweep = f"{self.name}: " if self.name else ""  # a store that cannot be read tells no name
        head = f"{of_sweep}{self.done:,}{of_planned} {runs} done{failed}{running}"
        rows = [
            (
                part.name,
                str("-" if part.planned is None else part.planned),
                str(part.done),
                str(part.failed),
                part.state,
            )
            for part in self.parts
        ]
        return f"{head}\n{aligned([HEAD, *rows], right_from=1)}"

    def document(self) -> dict[str, Any]:
        """Return the status as JSON values."""
        return asdict(self)


@naming_arguments
def status(folder: str | Path) -> SweepStatus:
    """Return how far the sweep in a folder is.

    The folder is that of `desim submit`, or any folder with the stores of a sweep. Runs are read from the stores, also
    while a sweep writes to them; the states of parts are those of squeue, if Slurm is there.

    Raises:
        TypeError: if the folder is not given as a path.
        ValueError: if the folder has no sweep.
        OSError: if the folder cannot be read.
    """
    RESULTS.check(folder, "status")
    folder = Path(folder)
    if folder.is_file():
        raise ValueError(f"{folder}: is no folder: give the one of `desim submit`, or of `desim sweep -o`")
    job = ArrayJob.read(folder)
    stores = dict(_stores(folder, job))
    if job is None and not stores:
        raise ValueError(
            f"{folder}: has no sweep: neither {STORE} nor parts of one; `desim sweep FILE -o {folder}` makes one"
        )
    slurm_states = states(job.jobs) if job is not None else {}
    counts = {name: _Counts.of(path) for name, path in stores.items()}
    parts = []
    for name, count in counts.items():
        planned = job.planned(int(name)) if job is not None and name.isdecimal() else None
        state = _state(name, count, planned, slurm_states)
        parts.append(SweepPart(name, planned, len(count.done), len(count.failed), state))
    plan = PlannedRuns(job.runs) if job is not None else _planned(folder)
    done = frozenset().union(*(count.done for count in counts.values()))
    failed = frozenset().union(*(count.failed for count in counts.values())) - done
    includes = plan.includes(count.keys for count in counts.values()) if plan is not None else None
    if includes is not None:  # a store may have runs of other grids
        done, failed = frozenset(filter(includes, done)), frozenset(filter(includes, failed))
    # A plan of fewer runs than are done is that of another sweep.
    has_count = plan is not None and includes is not None and not plan.is_most and len(done) <= plan.count
    name = job.name if job is not None else next((count.name for count in counts.values() if count.name), "")
    return SweepStatus(name, plan.count if plan and has_count else None, len(done), len(failed), tuple(parts))


@dataclass(frozen=True)
class _Counts:
    """The runs in a store."""

    name: str = ""
    done: frozenset[Run] = frozenset()
    failed: frozenset[Run] = frozenset()
    problem: str = ""
    keys: tuple[str, ...] = ()
    """The hashes of its configurations, in order."""

    @classmethod
    def of(cls, path: Path) -> "_Counts":
        """Return the runs in a store; none if it is missing or cannot be read."""
        if not path.exists():
            return cls(problem="not begun")
        try:
            with Store(path, read_only=True) as store:
                done, failed = store.outcomes()
                keys = tuple(store.keys)
                name = store.read_property("name", str) if "name" in store.about else ""
        except (OSError, ValueError) as error:
            return cls(problem=str(error))
        return cls(name, done, failed, keys=keys)


def _stores(folder: Path, job: ArrayJob | None) -> Iterator[tuple[str, Path]]:
    """Yield the name and the store of each part, and "merged" with that of the whole sweep if there is one."""
    if job is not None:
        for part in range(1, job.parts + 1):
            yield str(part), job.store(folder, part)
    else:
        for path in sorted([*folder.glob(STORE_PARTS), *folder.glob(f"*/{STORES}")]):
            yield str(path.relative_to(folder)), path
    if (folder / STORE).exists():
        yield ("merged" if job is not None else STORE), folder / STORE


def _state(name: str, count: _Counts, planned: int | None, slurm_states: Mapping[int, str]) -> str:
    """Return the state of a part."""
    if name.isdecimal() and int(name) in slurm_states:
        return str(slurm_states[int(name)])
    if count.problem:
        return count.problem
    if planned is not None:
        return "done" if len(count.done) >= planned else "unfinished"
    return "stored"


def _planned(folder: Path) -> PlannedRuns | None:
    """Return the runs of the sweep in a folder, from its run.json or that of a part; None if there is none."""
    for path in (folder / provenance.FILE, *sorted(folder.glob(f"*/{provenance.FILE}"))):
        try:
            made = provenance.read(path)
        except (OSError, ValueError):
            continue
        if (plan := PlannedRuns.of(made)) is not None:
            return plan
    return None

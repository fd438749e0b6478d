"""What a folder of results holds: its runs, sweeps and explanations, with scenario, date, number of runs and state."""

import html
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from desim.analysis.tables import aligned
from desim.config.arguments import RESULTS, naming_arguments
from desim.config.escaping import escaped
from desim.config.file_names import STORE, STORE_PARTS, TRACE
from desim.config.html import html_table
from desim.results import provenance
from desim.study.store.store import Store
from desim.study.sweeps.planned import PlannedRuns, Run

HEAD = ("folder", "kind", "scenario", "date", "runs", "state")
UNPLANNED = ("explain", "race", "sensitivity")
"""The kinds of results whose `run.json` does not say how many runs their store should have."""
TAIL = 4096
"""The number of bytes at the end of a trace that are searched for its last event."""


@dataclass(frozen=True)
class Entry:
    """A result in a folder."""

    folder: Path
    """The folder; or the file of a store whose name is not that of `desim sweep`, such as one of `sweep(store=...)`."""
    kind: str
    """run, sweep, explain, merge, or the name of a study."""
    scenario: str
    """The name of the scenario; "" if it is unknown."""
    modified: float
    """The time at which the newest of its files was written, s since 1970."""
    runs: int | None
    """The number of runs that it holds; None if it cannot be read."""
    state: str
    """complete; unfinished, with the number of planned runs; that its store was used for another grid since; the number
    of failed runs; or what cannot be read."""

    @property
    def date(self) -> str:
        """The local date and time at which the newest of its files was written."""
        return f"{datetime.fromtimestamp(self.modified).astimezone():%Y-%m-%d %H:%M}"

    def document(self) -> dict[str, Any]:
        """Return the entry as JSON-compatible values."""
        return {**vars(self), "folder": str(self.folder), "modified": self.date}


class Listing(list[Entry]):
    """The results in a folder and its subfolders, by folder."""

    def rows(self) -> list[tuple[str, ...]]:
        """Return the results as rows of text; the first row is the header."""
        rows: list[tuple[str, ...]] = [HEAD]
        for entry in self:
            runs = "-" if entry.runs is None else f"{entry.runs:,}"
            cells = str(entry.folder), entry.kind, entry.scenario or "-", entry.date, runs, entry.state
            rows.append(tuple(map(escaped, cells)))
        return rows

    def table(self) -> str:
        """Return the results as text."""
        return aligned(self.rows(), right_from=len(HEAD)) if self else "no results"

    def __str__(self) -> str:
        return self.table()

    def _repr_html_(self) -> str:
        """Return the results as HTML, for notebooks."""
        return html_table("results", self.rows()) if self else html.escape(self.table())


@naming_arguments
def ls(folder: str | Path = "out") -> Listing:
    """List the runs, sweeps and explanations in a folder and its subfolders.

    Stores that a script made with `sweep(store=...)` are listed with their file. Hidden folders and links are not
    followed, and no code of a result is run.

    Raises:
        TypeError: if the folder is not given as a path.
        NotADirectoryError: if the path is not that of a folder.
    """
    RESULTS.check(folder, "ls")
    folder = Path(folder)
    if not folder.is_dir():
        raise NotADirectoryError(20, "is not a folder", str(folder))
    return Listing(_entries(folder))


def _entries(folder: Path) -> Iterator[Entry]:
    for path, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        current = Path(path)
        stores = [current / STORE] if STORE in names else sorted(current.glob(STORE_PARTS))
        files = [*stores, *(current / name for name in (TRACE, provenance.FILE) if name in names)]
        if TRACE in names or stores or (provenance.FILE in names and not _is_batch(current, folders)):
            yield _entry(current, stores, TRACE in names, max(map(_modified, files)))
        for store in sorted(current.glob("*.sqlite")):
            if store.name != STORE and not store.match(STORE_PARTS) and (entry := _entry_of_store(store)) is not None:
                yield entry


def _modified(path: Path) -> float:
    """Return the time at which a file, or a link to nothing, was written, s since 1970; 0 if it is gone."""
    for look in (path.stat, path.lstat):
        with suppress(OSError):
            return look().st_mtime
    return 0.0


def _entry_of_store(path: Path) -> Entry | None:
    """Return the entry of a store whose name is not that of `desim sweep`; None if it is no readable store."""
    try:
        name, runs, state = _stored([path], None, None)
    except (OSError, ValueError):
        return None
    return Entry(path, "sweep", name, _modified(path), runs, state) if name is not None else None


def _is_batch(folder: Path, folders: list[str]) -> bool:
    """Return whether the runs of a folder are in its subfolders, each of which has an entry."""
    return any((folder / name / TRACE).exists() for name in folders)


def _entry(folder: Path, stores: list[Path], has_trace: bool, modified: float) -> Entry:
    """Return the entry of a folder that has a result."""
    kind, scenario, planned = ("sweep" if stores else "run" if has_trace else "?"), "", None
    problems, plan = [], None
    try:
        made = provenance.read(folder / provenance.FILE)
        kind, planned, plan = str(made["what"]), int(made["runs"]), PlannedRuns.of(made)
        scenario = str((made["scenario"] or {}).get("name", ""))
    except FileNotFoundError:
        problems.append(f"no {provenance.FILE}")
    except (OSError, ValueError) as error:
        problems.append(_first_line(error))
    runs, state = planned, "no runs recorded"
    try:
        if stores:
            name, runs, state = _stored(stores, None if kind in UNPLANNED else planned, plan)
            scenario = scenario or name or ""
        elif has_trace:
            runs, state = 1, "complete" if b'"event": "Ended"' in _tail(folder / TRACE) else "unfinished"
    except (OSError, ValueError) as error:
        return Entry(folder, kind, scenario, modified, None, _first_line(error))
    return Entry(folder, kind, scenario, modified, runs, "; ".join([*problems, state]))


def _stored(stores: list[Path], planned: int | None, plan: PlannedRuns | None) -> tuple[str | None, int, str]:
    """Return the name of the scenario in stores (None if unknown), the number of their runs, and their state."""
    runs, failed, done, outcomes, keys = 0, 0, 0, set[Run](), list[list[str]]()
    name: str | None = None
    for path in stores:
        with Store(path, read_only=True) as store:
            name = name or (store.read_property("name", str) if "name" in store.about else None)
            runs, failed = runs + len(store), failed + store.failed_runs
            if plan is not None and plan.configurations is not None:
                keys.append(store.keys)
                if len(stores) == 1:
                    done = store.count(plan.configurations, plan.reps)
                else:  # several stores may have runs in common
                    outcomes.update(*store.outcomes())
    was_planned = plan.includes(keys) if plan is not None and keys else None
    # Without a record of the planned configurations, all runs count as done.
    done = done or (len([*filter(was_planned, outcomes)]) if keys else runs)
    notes = ["parts of a sweep: merge them"] if stores[0].match(STORE_PARTS) else []
    if planned is None or not runs:
        notes += [] if runs else ["empty"]
    elif keys and was_planned is None:
        notes.append(f"has runs of another grid than that of {provenance.FILE}")
    elif done < planned:
        notes.append(f"unfinished: {done:,} of {'at most ' * (plan is not None and plan.is_most)}{planned:,}")
    notes += [f"{failed:,} failed"] if failed else []
    return name, runs, "; ".join(notes or ["complete"])


def _tail(path: Path) -> bytes:
    """Return the last bytes of a file."""
    with path.open("rb") as stream:
        stream.seek(max(0, path.stat().st_size - TAIL))
        return stream.read()


def _first_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename:
        return f"{Path(error.filename).name}: {error.strerror}"
    return str(error).splitlines()[0] if str(error) else type(error).__name__

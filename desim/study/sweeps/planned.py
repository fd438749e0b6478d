"""The runs that the last sweep of a folder planned, by its run.json: a store may have runs of other grids, too."""

import hashlib
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Self

from desim.results import provenance

Run = tuple[str, int]
"""The hash of a configuration, and the replication."""


@dataclass(frozen=True)
class PlannedRuns:
    """The runs that a sweep planned."""

    count: int
    """The number of runs."""
    is_most: bool = False
    """Whether `count` is only an upper bound, because the sweep ends when a mean is precise enough."""
    configurations: int | None = None
    """The number of configurations of the sweep; None if it was not recorded."""
    digest: str = ""
    """The digest of the hashes of these configurations."""
    reps: int | None = None
    """The number of runs of each configuration; None if it was not recorded, or differs."""

    @classmethod
    def of(cls, document: provenance.Document) -> Self | None:
        """Return the runs that a run.json plans; None if it is not that of a sweep."""
        if document["what"] != "sweep":
            return None
        grid, reps = document.get("configurations"), document.get("reps")
        count, digest = (grid.get("count"), grid.get("hash")) if isinstance(grid, dict) else (None, None)
        return cls(
            int(document["runs"]),
            "until" in document,
            count if isinstance(count, int) else None,
            str(digest),
            reps if isinstance(reps, int) else None,
        )

    def includes(self, stored: Iterable[Sequence[str]]) -> Callable[[Run], bool] | None:
        """Return a test of whether a run was planned; None if no store begins with the planned configurations.

        `stored` holds the hashes of the configurations in each store, in its order: those of the last sweep come first.
        """
        planned = None
        if self.configurations is not None:
            first = (frozenset(keys[: self.configurations]) for keys in stored)
            planned = next((keys for keys in first if _digest(keys) == self.digest), None)
            if planned is None:
                return None
        return lambda run: (planned is None or run[0] in planned) and (self.reps is None or run[1] < self.reps)


def entries(keys: Collection[str], reps: int | None, until: tuple[str, float] | None) -> dict[str, Any]:
    """Return the entries of a run.json that `PlannedRuns.of` reads, except `runs`.

    A digest stands for the configurations: the hashes of 100,000 would take 6.6 MB.
    """
    document: dict[str, Any] = {"configurations": {"count": len(set(keys)), "hash": _digest(keys)}}
    if until is not None:
        return document | {"until": [*until]}
    return document if reps is None else document | {"reps": reps}


def _digest(keys: Iterable[str]) -> str:
    """Return a digest of the hashes of configurations in any order."""
    return hashlib.sha256("\n".join(sorted(set(keys))).encode()).hexdigest()[:16]

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
    """Their number."""
    is_most: bool = False
    """Whether `count` is a bound only, as the sweep ends when a mean is precise enough."""
    configurations: int | None = None
    """The number of its configurations; None if it was not recorded."""
    digest: str = ""
    """The digest of their hashes."""
    reps: int | None = None
    """The number of runs of each; None if it was not recorded, or differs."""

    @classmethod
    def of(cls, document: provenance.Document) -> Self | None:
        """Return the runs of a run.json; None if it is not that of a sweep."""
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
        """Return whether a run was planned, as a function; None if it cannot be told.

        `stored` holds the hashes of the configurations in each store, in its order: the last sweep has the first ones.
        """
        planned = None
        if self.configurations is not None:
            first = (frozenset(keys[: self.configurations]) for keys in stored)
            planned = next((keys for keys in first if _digest(keys) == self.digest), None)
            if planned is None:
                return None
        return lambda run: (planned is None or run[0] in planned) and (self.reps is None or run[1] < self.reps)


def entries(keys: Collection[str], reps: int | None, until: tuple[str, float] | None) -> dict[str, Any]:
    """Return the entries of a run.json from which `PlannedRuns.of` takes what was planned, `runs` apart.

    A digest stands for the configurations: the hashes of 100,000 would take 6.6 MB.
    """
    document: dict[str, Any] = {"configurations": {"count": len(set(keys)), "hash": _digest(keys)}}
    if until is not None:
        return document | {"until": [*until]}
    return document if reps is None else document | {"reps": reps}


def _digest(keys: Iterable[str]) -> str:
    """Return a digest of the hashes of configurations in any order."""
    return hashlib.sha256("\n".join(sorted(set(keys))).encode()).hexdigest()[:16]

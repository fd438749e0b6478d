"""The runs that the last sweep of a folder planned, by its run.json: a store may have runs of other grids, too."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Self

from desim.results import provenance


@dataclass(frozen=True)
class PlannedRuns:
    """The runs that a sweep planned."""

    count: int
    """Their number."""
    is_most: bool = False
    """Whether `count` is a bound only, as the sweep ends when a mean is precise enough."""
    keys: frozenset[str] | None = None
    """The hashes of its configurations; None if they were not recorded."""
    reps: int | None = None
    """The number of runs of each; None if it was not recorded, or differs."""

    @classmethod
    def of(cls, made: provenance.Document) -> Self | None:
        """Return the runs of a run.json; None if it is not that of a sweep."""
        if made["what"] != "sweep":
            return None
        keys, reps = made.get("configurations"), made.get("reps")
        return cls(
            int(made["runs"]),
            "until" in made,
            frozenset(map(str, keys)) if isinstance(keys, list) else None,
            reps if isinstance(reps, int) else None,
        )

    def among(self, runs: Iterable[tuple[str, int]]) -> frozenset[tuple[str, int]]:
        """Return those of some runs, pairs of configuration and replication, that were planned."""
        return frozenset(
            (key, k)
            for key, k in runs
            if (self.keys is None or key in self.keys) and (self.reps is None or k < self.reps)
        )


def entries(keys: Iterable[str], reps: int | None, until: tuple[str, float] | None) -> dict[str, Any]:
    """Return the entries of a run.json from which `PlannedRuns.of` takes what was planned, `runs` apart."""
    made: dict[str, Any] = {"configurations": [*keys]}
    if until is not None:
        return made | {"until": [*until]}
    return made if reps is None else made | {"reps": reps}

"""A row: one run of a sweep."""

from dataclasses import dataclass
from itertools import takewhile
from typing import Any, Literal

from desim.analysis.metrics import Summary

Status = Literal["ok", "error", "crashed"]


@dataclass(frozen=True, slots=True)
class Row:
    """A run of a sweep."""

    replication: int
    """The number of the run within its configuration, 0, 1, ..."""
    seed: int
    status: Status
    """ok; error: the run raised an exception; crashed: the run ended its worker process."""
    summary: Summary | None = None
    """The metrics, if ok."""
    traceback: str = ""
    """The traceback and the exception, if the run failed."""

    def value(self, metric: str) -> Any:
        """Return a metric of the run; None if it has no value or is missing, or if the run failed."""
        return None if self.summary is None else self.summary.get(metric)

    @property
    def ok(self) -> bool:
        """Whether the run ended and was measured."""
        return self.status == "ok"

    @property
    def error(self) -> str:
        """The exception of the run in one line; "" if it did not fail."""
        whole = self.traceback.strip().splitlines()
        own = takewhile(lambda line: not line.startswith("  +-"), whole)  # not the members of a group
        lines = [line.removeprefix("  | ") for line in own]
        last_call = max((k for k, line in enumerate(lines) if line.startswith('  File "')), default=-1)
        ends = [line for line in lines[last_call + 1 :] if line.strip() and not line.startswith("  ")]
        return (ends or lines[-1:] or [""])[0]

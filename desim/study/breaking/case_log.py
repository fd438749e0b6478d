"""The log of a search: what was run is not run again after an interruption."""

import json
from errno import ELOOP
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

from desim.analysis.properties import Judgement
from desim.config.parameters import as_jsonable
from desim.config.whole_files import open_no_link
from desim.results.environment import computing_versions
from desim.scenario.properties import Property
from desim.scenario.scenario import Scenario
from desim.study.breaking.features import Case
from desim.study.plan.config_hash import identify, object_hash

FILE = "cases.jsonl"
"""The name of the file in the folder of a search."""
FAILED = Judgement(-inf, inf, 0.0)
"""The judgement of a run that raised an exception: the worst margin, because a protocol should not fail."""


class CaseRun(NamedTuple):
    """The outcome of the run of a case."""

    verdict: Judgement
    seen: list[str]
    """The sentences of `SIGHTINGS` that hold in the run."""
    seconds: float = 0.0
    """The wall time, s, since the end of the run before: so the times of several workers add up to the whole."""
    failure: str = ""
    """The exception that the run raised, as text; the judgement is then `FAILED`."""
    limit: float | None = None
    """The limit of wall time that the run exceeded, s; None: it ended by itself."""


FIELDS = {"search", "scenario", "seed", *CaseRun._fields}
"""The keys of a line of the log, without the case."""


class CaseLog:
    """The runs that a search has judged, one line of JSON each.

    A run is identified by its scenario, the user code that it runs, and its seed; two cases may give the same scenario.
    Lines of another property or version are not read, nor is a last line that was cut off. The file need not exist.

    Raises:
        OSError: if the file cannot be read, or is a symbolic link.
    """

    def __init__(self, file: Path, prop: Property):
        functions = [comparison.of for condition in prop.conditions for comparison in condition.comparisons]
        code = [object_hash(function) for function in functions if function is not None]
        self._file = file
        self._search = " ".join([prop.text, *code, json.dumps(computing_versions(), sort_keys=True)])
        self._runs: dict[tuple[str, int], CaseRun] = {}
        if file.is_symlink():
            raise OSError(ELOOP, "is a symbolic link, which is not followed: remove it", str(file))
        text = file.read_text("utf-8") if file.exists() else ""
        self._is_cut_off = bool(text) and not text.endswith("\n")
        for line in text.splitlines():
            entry = _read(line)
            if entry is not None and entry["search"] == self._search:
                fields = {name: entry[name] for name in CaseRun._fields} | {"verdict": Judgement(*entry["verdict"])}
                self._runs[entry["scenario"], entry["seed"]] = CaseRun(**fields)

    def __len__(self) -> int:
        return len(self._runs)

    def find(self, scenario: Scenario, seed: int) -> CaseRun | None:
        """Return the outcome of a run that was judged before; None if there was none."""
        return self._runs.get((identify(scenario).key, seed))

    def add(self, scenario: Scenario, seed: int, case_run: CaseRun, case: Case | None = None) -> None:
        """Append a run; its case, if given, tells a reader of the file what was changed."""
        key = identify(scenario).key
        self._runs[key, seed] = case_run
        fields = {**case_run._asdict(), "case": as_jsonable(case)}  # the values of a case may be models
        entry = {"search": self._search, "scenario": key, "seed": seed, **fields}
        with open(self._file, "a", encoding="utf-8", opener=open_no_link) as lines:
            lines.write(("\n" if self._is_cut_off else "") + json.dumps(entry) + "\n")
        self._is_cut_off = False


def _read(line: str) -> dict[str, Any] | None:
    """Return the entry of a line; None if it was cut off, or if another version wrote it with other fields."""
    try:
        entry: dict[str, Any] = json.loads(line)
    except ValueError:
        return None
    return entry if entry.keys() >= FIELDS else None

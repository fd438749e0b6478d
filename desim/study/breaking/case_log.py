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
"""The judgement of a run that raised an exception: no property of it is known, and a protocol should not fail."""


class CaseRun(NamedTuple):
    """What a run of a case tells."""

    verdict: Judgement
    seen: list[str]
    """What was seen in it; see `SIGHTINGS`."""
    seconds: float = 0.0
    """The wall time, s, from the end of the run before: several workers share the time in which they run."""
    failure: str = ""
    """The exception that it raised, as text; the judgement is then `FAILED`."""
    limit: float | None = None
    """The limit of wall time that it exceeded, s; None: it ended by itself."""


FIELDS = {"search", "scenario", "seed", *CaseRun._fields}
"""The names of what a line has, beside the case."""


class CaseLog:
    """The runs that a search has judged, one line of JSON each.

    A run is known by its scenario, whatever the case from which this was made, by the code of the user that it runs,
    and by its seed. Lines of another property or version are not read. A last line that was cut off is left out. The
    file need not exist.

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
                told = {name: entry[name] for name in CaseRun._fields} | {"verdict": Judgement(*entry["verdict"])}
                self._runs[entry["scenario"], entry["seed"]] = CaseRun(**told)

    def __len__(self) -> int:
        return len(self._runs)

    def find(self, scenario: Scenario, seed: int) -> CaseRun | None:
        """Return what a run told that was judged before; None if there is none."""
        return self._runs.get((identify(scenario).key, seed))

    def add(self, scenario: Scenario, seed: int, case_run: CaseRun, case: Case | None = None) -> None:
        """Append a run; its case, if given, tells a reader of the file what was changed."""
        key = identify(scenario).key
        self._runs[key, seed] = case_run
        told = {**case_run._asdict(), "case": as_jsonable(case)}  # its values may be models
        entry = {"search": self._search, "scenario": key, "seed": seed, **told}
        with open(self._file, "a", encoding="utf-8", opener=open_no_link) as lines:
            lines.write(("\n" if self._is_cut_off else "") + json.dumps(entry) + "\n")
        self._is_cut_off = False


def _read(line: str) -> dict[str, Any] | None:
    """Return the entry of a line; None if it was cut off."""
    try:
        entry: dict[str, Any] = json.loads(line)
    except ValueError:
        return None
    return entry if entry.keys() >= FIELDS else None

"""The log of a search: what was run is not run again after an interruption."""

import json
from pathlib import Path
from typing import Any

from desim.analysis.properties import Judgement, Stated
from desim.results.environment import computing_versions
from desim.scenario.scenario import Scenario
from desim.study.breaking.features import Case
from desim.study.plan.config_hash import identify

FILE = "cases.jsonl"
"""The name of the file in the folder of a search."""


class CaseLog:
    """The cases that were run, one line of JSON each.

    Lines of another scenario, property or version are not read. A last line that was cut off is left out.

    Args:
        file: where the lines are; it need not exist.
        scenario: where the search begins.
        prop: the property, or its text.
    """

    def __init__(self, file: Path, scenario: Scenario, prop: Stated):
        stated = " ".join((prop if isinstance(prop, str) else prop.text).split())
        self._file = file
        self._search = f"{identify(scenario).key} {stated} {json.dumps(computing_versions(), sort_keys=True)}"
        self._entries: dict[str, tuple[Judgement, list[str]]] = {}
        text = file.read_text("utf-8") if file.exists() else ""
        self._is_cut_off = bool(text) and not text.endswith("\n")
        for line in text.splitlines():
            entry = _read(line)
            if entry is not None and entry["search"] == self._search:
                verdict = Judgement(*entry["verdict"])
                self._entries[_key(entry["case"], entry["seed"])] = verdict, entry["seen"]

    def __len__(self) -> int:
        return len(self._entries)

    def find(self, case: Case, seed: int) -> tuple[Judgement, list[str]] | None:
        """Return the judgement of a case that was run before, and what was seen in it; None if it was not run."""
        return self._entries.get(_key(case, seed))

    def add(self, case: Case, seed: int, verdict: Judgement, seen: list[str]) -> None:
        """Append a case that was run."""
        self._entries[_key(case, seed)] = verdict, seen
        entry = {"search": self._search, "case": case, "seed": seed, "verdict": verdict, "seen": seen}
        with self._file.open("a", encoding="utf-8") as lines:
            lines.write(("\n" if self._is_cut_off else "") + json.dumps(entry) + "\n")
        self._is_cut_off = False


def _key(case: Case, seed: int) -> str:
    return json.dumps([case, seed], sort_keys=True)


def _read(line: str) -> dict[str, Any] | None:
    try:
        entry: dict[str, Any] = json.loads(line)
    except ValueError:
        return None
    return entry

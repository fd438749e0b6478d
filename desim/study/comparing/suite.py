"""The scenarios and protocols of the benchmark, and the frozen costs of their runs, by version.

The files of version N are in `scenarios/bench/vN`. A version never changes: a test compares its files with their
`digest`. A change of a scenario or protocol is a new version beside the old one.
"""

import hashlib
import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from desim.config.arguments import without_addresses
from desim.config.arrays import Floats
from desim.config.packages import package_folder
from desim.scenario.scenario import Scenario
from desim.scenario.toml import load

BASE, PROTOCOLS, COSTS = "base", "protocols", "costs.json"
"""The names of the file that all scenarios extend, of the file of protocols, and of the file of costs."""
REFERENCE = "local_min"
"""The protocol that sets both bounds of every scenario, for all protocols.

It knows what other protocols may know: what pursuers sense and hear. On a perfect network it is close to the best, it
has no parameter, and without messages each pursuer decides alone.
"""
RUNS = {"1": 16}
"""The number of runs of each protocol in each scenario, by version."""
NEWEST = "1"
AS_IT_IS, PERFECT, SILENT = "as it is", "perfect network", "no messages"
"""The networks on which protocols run; without messages only `REFERENCE` does."""
DIGITS = 6
"""The number of decimals of a cost, s."""
CostsByProtocol = Mapping[str, Mapping[str, Floats]]
"""The (n,) costs of the runs, by protocol and network."""


@dataclass(frozen=True)
class Suite:
    """A version of the benchmark."""

    version: str

    @classmethod
    def of(cls, version: str | int = NEWEST) -> "Suite":
        """Return a version.

        Raises:
            ValueError: if there is no such version.
        """
        if str(version) not in RUNS:
            name = without_addresses(str(version))
            raise ValueError(f"there is no version {name} of the benchmark; allowed: {', '.join(RUNS)}")
        return cls(str(version))

    @property
    def folder(self) -> Path:
        """The folder of its files."""
        return package_folder("scenarios") / "bench" / f"v{self.version}"

    @property
    def runs(self) -> int:
        """The number of runs of each protocol in each scenario."""
        return RUNS[self.version]

    @cached_property
    def scenarios(self) -> Mapping[str, Scenario]:
        """Its scenarios by name, each with the protocol `REFERENCE`."""
        paths = sorted(path for path in self.folder.glob("*.toml") if path.stem not in (BASE, PROTOCOLS))
        return {path.stem: load(path) for path in paths}

    @cached_property
    def protocols(self) -> Mapping[str, Any]:
        """The protocols that take part, by name, as tables of a scenario file."""
        return tomllib.loads((self.folder / f"{PROTOCOLS}.toml").read_text(encoding="utf-8"))

    @property
    def digest(self) -> str:
        """The SHA-256 hash of its scenarios and protocols: the names and bytes of their files, in order."""
        return _digest(path for path in self.folder.glob("*.toml"))

    @property
    def digest_of_costs(self) -> str:
        """The SHA-256 hash of the frozen costs."""
        return _digest([self.folder / COSTS])

    @property
    def is_frozen(self) -> bool:
        """Whether the version has costs; a version that is being made has none."""
        return (self.folder / COSTS).exists()

    @cached_property
    def costs(self) -> Mapping[str, CostsByProtocol]:
        """The frozen costs by scenario.

        Raises:
            OSError: if the file cannot be read.
        """
        frozen = json.loads((self.folder / COSTS).read_bytes())
        return {
            scenario: {
                name: {network: np.array(costs) for network, costs in by_network.items()}
                for name, by_network in by_protocol.items()
            }
            for scenario, by_protocol in frozen.items()
        }


def cost_of_runs(scenario: Scenario, active_time: Floats, idle_time: Floats) -> Floats:
    """Return the cost of each run, s: the active time plus N times the time for which an evader is left alone.

    N is the number of pursuers: a second without a pursuer costs as much as a second in which all N chase. So neither
    too few nor too many active pursuers are cheap, and a run that ends without a capture has a finite cost.
    """
    return np.round(active_time + scenario.team.count * idle_time, DIGITS)


def frozen_text(costs: Mapping[str, CostsByProtocol]) -> str:
    """Return costs as the text of a JSON file, with a line for each protocol, scenario and network."""

    def nested(table: Mapping[str, Any], indent: str) -> Iterator[str]:
        for k, (name, value) in enumerate(table.items()):
            end = "," if k < len(table) - 1 else ""
            if isinstance(value, Mapping):
                yield f'{indent}"{name}": {{'
                yield from nested(value, indent + " ")
                yield f"{indent}}}{end}"
            else:
                yield f'{indent}"{name}": {json.dumps([*map(float, value)], separators=(",", ":"))}{end}'

    return "\n".join(["{", *nested(costs, " "), "}", ""])


def _digest(paths: Any) -> str:
    # Git may have converted the line ends.
    files = [(path.name, path.read_bytes().replace(b"\r\n", b"\n")) for path in sorted(paths)]
    return hashlib.sha256(b"\0".join(part for name, text in files for part in (name.encode(), text))).hexdigest()

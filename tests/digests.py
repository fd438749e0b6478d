"""Print digests of runs: the trace with all its messages, and the summary.

They are the same under Python 3.11 to 3.14, in any place and process: `nox -s digests` and .ci/run compare them.
There is a run of each scenario file, `LONG`, and `RARE`: what scenario files do not reach.
"""

import json
from functools import cache
from hashlib import sha256

import click

from desim import Scenario, load, run, summary
from desim.analysis.metrics import plain
from desim.kernel.core.trace_file import line_of
from scenarios.studies.study import SCENARIOS
from tests.rare_scenarios import RARE

HORIZON = 1.0
"""Of the run of each scenario file, s."""
LONG = Scenario(
    horizon=2.1,
    team={"count": 2, "speeds": 1.0},
    evader={"speed": 0.5, "position": (40.0, 0.0)},
    motion={"static": True},
    protocol={
        "kind": "sap",
        "schedule": {"kind": "shared_seed", "slot": 1e-4},
        "tau": {"kind": "constant", "value": 1e6},
    },
)
"""A run of more than 10,000 changes: from that length on OpenBLAS divides a vector among its threads."""
NAMES = (*sorted(file.name for file in SCENARIOS.glob("*.toml")), "long", *RARE)
"""Of the runs."""


def digests(seed: int, names: tuple[str, ...] = NAMES) -> list[str]:
    """Return a line for each run: the digests of its trace and of its summary, and its name."""
    return [" ".join([*digests_of(name, seed), name]) for name in names]


@cache
def digests_of(name: str, seed: int) -> tuple[str, str]:
    """Return the digests of the trace and of the summary of a run."""
    given = [f"horizon={HORIZON}", "record.messages=true"]
    built = {"long": LONG} | RARE
    result = run(built[name] if name in built else load(SCENARIOS / name, given), seed)
    trace, numbers = "".join(map(line_of, result.trace)), json.dumps(plain(summary(result)))
    return sha256(trace.encode()).hexdigest(), sha256(numbers.encode()).hexdigest()


@click.command(help=__doc__)
@click.argument("seed", type=int, default=0)
@click.argument("names", nargs=-1, metavar="[NAME]...")
def main(seed: int, names: tuple[str, ...]) -> None:
    """Print the digests, of all runs if none are named."""
    for line in digests(seed, names or NAMES):
        click.echo(line)


if __name__ == "__main__":
    main()

"""Print digests of a run of each scenario file, with all its messages: the same under any Python and in any place."""

from hashlib import sha256

import click

from desim import load, run
from desim.kernel.trace_file import line_of
from scenarios.study import SCENARIOS

HORIZON = 1.0
"""Of each run, s."""


def digests(seed: int) -> dict[str, str]:
    """Return a digest of the trace of each scenario file's run, by the name of the file."""
    found = {}
    for file in sorted(SCENARIOS.glob("*.toml")):
        scenario = load(file, [f"horizon={HORIZON}", "record.messages=true"])
        found[file.name] = sha256("".join(map(line_of, run(scenario, seed).trace)).encode()).hexdigest()
    return found


@click.command(help=__doc__)
@click.argument("seed", type=int, default=0)
def main(seed: int) -> None:
    """Print the digests."""
    for name, digest in digests(seed).items():
        click.echo(f"{digest} {name}")


if __name__ == "__main__":
    main()

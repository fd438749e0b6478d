"""Print a digest of a run of each scenario file, all its messages included: the same under any Python and in any place.

python -m tests.digests [SEED]
"""

import sys
from hashlib import sha256

from desim import load, run
from scenarios.study import SCENARIOS

HORIZON = 1.0
"""Of each run, s."""


def digests(seed: int) -> dict[str, str]:
    """Return a digest of the trace of each scenario file's run, by the name of the file."""
    found = {}
    for file in sorted(SCENARIOS.glob("*.toml")):
        scenario = load(file, [f"horizon={HORIZON}", "record.messages=true"])
        found[file.name] = sha256("".join(run(scenario, seed).trace.lines()).encode()).hexdigest()
    return found


if __name__ == "__main__":
    for name, digest in digests(int(sys.argv[1]) if len(sys.argv) > 1 else 0).items():
        print(digest, name)

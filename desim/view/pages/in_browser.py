"""The function that the front page of the site calls in a browser: it runs an example with some keys changed.

Python in a browser (Pyodide) has no threads, no processes and no sockets; a test performs these runs without them.
"""

import json
from collections.abc import Sequence
from pathlib import Path

from desim.scenario.examples import example
from desim.scenario.toml import read_source
from desim.view.pages.playground import Playground


def answer_as_json(name: str, changes: Sequence[str]) -> str:
    """Return the JSON text of the answer to a change of an example; see `Playground.answer`.

    The run is compared with the run of the unchanged example, which is drawn faint in the replay.

    Args:
        name: the name of the example.
        changes: the changes, each KEY=VALUE as in `--set`.

    Raises:
        ValueError: if there is no such example.
    """
    path = example(name)
    return json.dumps(Playground(read_source(path), Path(path.name)).answer(tuple(changes), ()))

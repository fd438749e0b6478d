"""The results of studies as a person sees them: as text, in a notebook, as tables of all formats, and as documents.

The numbers are those of a metric by hand, so that each table has small and large ones, equal ones and some that are not
known.
"""

import json
import re
from functools import cache

import pytest

from desim import Scenario, compare, controlled, explain, race, sensitivity, sweep
from desim.config.json_numbers import to_json
from tests.golden import golden

GAME = Scenario(
    name="game",
    seed=4,
    horizon=0.02,
    team={"count": 2},
    record={"trajectory": 0},
    network={"loss": 0.1, "latency": 0.001},
)
GRID = {"team.count": [2, 3, 5], "network.loss.p": [0.0, 0.5]}


def size(result):
    """Return a number that the grid and the seed decide."""
    scenario = result.scenario
    return 3.0 * scenario.team.count - 40.0 * scenario.network.loss.p**2 + (7 * result.seed % 5) / 5


def rare(result):
    """Return a number that some runs lack."""
    return size(result) / 1000 if result.seed % 3 else None


METRICS = {"size": size, "rare": rare}


@cache
def swept(runs=4, seed=4):
    """Return a sweep."""
    return sweep(GAME, GRID, runs, metrics=METRICS, seed=seed)


RESULTS = {
    "a sweep": lambda: swept(),
    "a sweep of a design": lambda: sweep(GAME, {"network.loss.p": "0:0.5"}, 3, metrics=METRICS, design="random:3"),
    "a comparison": lambda: compare(swept(), swept(3, 4), ("size", "rare")),
    "a comparison of other seeds": lambda: compare(swept(), swept(3, 9), ("size",)),
    "an explanation": lambda: explain(GAME, 4, metrics=METRICS, shown=("size", "rare", "messages_lost")),
    "a race": lambda: race(GAME, GRID, "size", zone=2.0, maximise=True, first=4, most=50, metrics=METRICS),
    "a race that is not decided": lambda: race(
        GAME, GRID, "size", zone=0.01, maximise=False, first=2, most=2, metrics=METRICS
    ),
    "a screening": lambda: sensitivity(GAME, RANGES, "size", points=0, trajectories=3, runs=1, metrics=METRICS),
    "a screening without effect": lambda: sensitivity(
        GAME, RANGES, "captured", points=0, trajectories=2, runs=1, metrics=METRICS
    ),
    "a control": lambda: controlled(
        GAME,
        {"team.count": [2, 3]},
        4,
        control="local_min",
        control_runs=9,
        metrics=METRICS,
        shown=("size", "active_time"),
    ),
}
RANGES = {"team.count": "2:5", "network.loss.p": "0:0.5", "network.latency.value": "0:0.001"}


def shown(text):
    """Return a text with six digits of each number, without pictures, and each row of an HTML table on a line."""
    text = re.sub(r'src="data:[^"]*"', 'src=""', text)
    text = re.sub(r" object at 0x[0-9a-f]+", "", text)
    text = re.sub(r"-?\d+\.\d{7,}(e-?\d+)?", lambda match: f"{float(match[0]):.6g}", text)
    return "\n".join(line.rstrip() for line in text.replace("</tr>", "</tr>\n").splitlines()[:60])


@pytest.mark.slow_cases(
    "a control",
    "an explanation",
    "a sweep of a design",
    "a comparison of other seeds",
    "a race",
    "a screening",
)
@pytest.mark.parametrize("name", RESULTS)
def test_a_result_is_shown_as_it_was(name):
    result = RESULTS[name]()
    parts = {"text": str(result), "repr": repr(result), "notebook": result._repr_html_()}
    parts |= {"document": json.dumps(to_json(result.document()))}
    if name != "a control":
        parts |= {kind: result.table(format=kind) for kind in ("latex", "markdown")}
    golden(f"shown/{name.replace(' ', '_')}.txt", {title: shown(part) for title, part in parts.items()})

"""All results that desim prints, made by hand: their tables in each format, texts and documents are golden."""

import ast
import json
import re
from dataclasses import replace
from inspect import signature
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

import desim
from desim.analysis.properties import Judgement
from desim.kernel.core.events import LOST
from desim.study.breaking.case_log import FAILED
from desim.study.breaking.copies import MessageCopy
from desim.study.breaking.losses import FatalLosses, LossTable
from desim.study.results.crossover import Crossover
from desim.study.results.threshold import Threshold
from desim.study.sweeps.listing import Entry, Listing
from desim.study.sweeps.status import SweepPart, SweepStatus
from tests.golden import FOLDER, golden
from tests.study import by_hand as made
from tests.study.by_hand import LATENCY, RULES, TIMES
from tests.study.test_crossover import KEY, A, B, X, sweep_of

PARTS = {"Saving", "Bounds", "Conduct", "Property", "Printable", "Entry", "FatalLosses", "Violation"}
"""Classes that are shown only as parts of others, or are none."""


def swept(**options):
    return made.swept({"protocol": RULES, LATENCY: TIMES}, start="known", **options)


def crossings():
    """Return crossovers of all kinds of sentences."""
    base = Crossover(
        "active_time", LATENCY, ("a", "b"), 0.1, 0.075, 0.125, (0.1,), "b", "worse",
        7, (0.05, 0.4), ((0.075, 0.125),), 0.9,
    )  # fmt: skip
    texts = [
        base,
        replace(base, more_is="better", crossings=(0.06, 0.1)),
        replace(base, metric="decisions", more_is=None),
    ]
    ends = [{"high": inf}, {"high": inf, "low": -inf, "crossings": (0.06, 0.1)}, {"low": -inf, "key": "protocol.slot"}]
    none = {"at": None, "crossings": (), "low": nan, "high": nan}
    alone = [none, none | {"undecided": ((0.05, 0.4),)}, none | {"undecided": ()}]
    return texts + [replace(base, **changes) for changes in ends + alone]


def found_crossings():
    """Return crossovers of curves: of lines that cross once, three times, at the last value, and never."""
    runs = np.array([[1.0], [2.0], [4.0]]) + np.zeros(4)
    scatter = np.array([[0.1, 0.0, -0.1, 0.1], [0.0, 0.1, 0.1, -0.1], [-0.1, -0.1, 0.0, 0.0]])
    slope, zigzag = 2.0 * (np.array(X) - 0.15), np.array([1.0, -1.0, 1.0, -3.0])
    curves = [slope, slope + 4.0 * scatter, zigzag, zigzag + scatter, 1.0 + scatter, 0.0 * slope]
    return [sweep_of(runs + each, runs).crossover("active_time", KEY, A, B) for each in curves]


def thresholds():
    """Return thresholds of all kinds of sentences."""
    base = Threshold(
        "active_time", LATENCY, 0.1, 0.05, 0.1, True, 0.075, 0.125, (0.1,), 7, (0.05, 0.4),
        ((-0.05, 0.05), (0.2, 0.4)), (0.0, 0.3), 0.9, ((0.075, 0.125),),
    )  # fmt: skip
    none = {"at": None, "low": nan, "high": nan, "crossings": (), "undecided": ()}
    kinds = [
        {},
        {"undecided": ((0.075, 0.125), (0.2, 0.3))},
        {"over": -0.255, "low": -inf, "high": inf, "is_beyond": False, "key": "protocol.slot", "baseline": "x"},
        {"is_beyond": None},
        none | {"is_beyond": None, "relative": ((-inf, inf), (-inf, inf))},
        none,
        none | {"is_beyond": False},
        none | {"is_beyond": False, "crossings": (0.1, 0.2)},
    ]
    return [replace(base, **changes) for changes in kinds]


def found_thresholds():
    """Return thresholds of curves over 10 %: exceeded from somewhere on, down from somewhere, nowhere, not decided."""
    runs = np.array([[9.0], [10.0], [11.0]]) + np.zeros(4)
    scatter = np.array([[0.1, 0.0, -0.1, 0.1], [0.0, 0.1, 0.1, -0.1], [-0.1, -0.1, 0.0, 0.0]])
    line = np.array(X)
    swept = [runs * each + scatter for each in (1.0 + line, 1.0 + line / 10.0, 1.0 + line / 4.0, 1.0 - line)]
    found = [sweep_of(table, table).threshold("active_time", KEY, 0.1, where=A) for table in swept]
    down = sweep_of(swept[-1], runs).threshold("active_time", KEY, 0.1, baseline=0.4, where=A, confidence=0.5)
    return [*found, down, sweep_of(swept[-1], runs).threshold("active_time", KEY, -0.2, where=A)]


def losses():
    """Return tables of fatal losses: none, one, and several kinds of fates."""
    copies = [MessageCopy(k, k % 3, (k + 1) % 3, k * 10**8, LOST, k, (None, 0, 2)[k % 3]) for k in range(3)]
    violated = FatalLosses(7, (copies[1],), ("lost",), inf, Judgement(-0.123456, 1.0, 0.5))
    failed = FatalLosses(8, tuple(copies), ("late", "twice", "lost"), 0.25, FAILED, "ValueError: no")
    return [
        LossTable(1, (7,), runs=1),
        LossTable(2, (7, 8), runs=1234),
        LossTable(1, (7,), fatal=[violated], runs=5, broken=[9]),
        LossTable(3, (7, 8), ("late", "twice", "lost"), 0.25, fatal=[failed], runs=5),
    ]


RESULTS = {
    "SweepResult": {
        "two keys": swept,
        "independent seeds": lambda: made.swept({LATENCY: TIMES[:2]}, common=False, start="announced"),
        "a key without effect": lambda: made.flat(),
        "a design": lambda: made.scattered(),
        "several magnitudes": lambda: made.swept({"protocol": RULES, LATENCY: TIMES}, time=lambda k: 3.0 * 7.0**k),
        "labels": lambda: swept().table(
            ["active_time", "heat"],
            against={"protocol": "cbba"},
            labels={"sap": "SAP (ours)", "0.10": "short", "heat": "Q", "runs": "n", LATENCY: "L"},
            without=["captured", "failed"],
        ),
    },
    "RaceResult": {
        "decided": made.raced,
        "not decided": lambda: made.raced(4, is_decided=False, unit="", metric="decisions", common=False),
        "several magnitudes": lambda: made.raced(apart=200.0),
        "equal means": lambda: made.raced(2, is_decided=False, apart=0.0, maximise=True),
    },
    "SensitivityResult": {
        "effects and indices": made.sensitivity,
        "effects": lambda: made.sensitivity(indices=False),
        "one run at each point": lambda: made.sensitivity(screened=False, runs_at_point=1),
        "no indices": lambda: made.sensitivity(varied=False),
    },
    "Benchmark": {"two scenarios": made.benchmark},
    "Explanation": {"three metrics": made.explanation, "one metric": lambda: made.explanation(["active_time"], 2)},
    "Comparison": {
        "pairs": made.comparison,
        "other seeds": lambda: made.comparison(seeds=20),
        "several magnitudes": lambda: made.comparison(("active_time",), scale=200.0),
        "one pair": lambda: made.comparison(("active_time",), times=TIMES[:1]),
    },
    "Controlled": {"three rules": made.controlled, "several magnitudes": lambda: made.controlled(500.0)},
    "Agreement": {"agrees": made.agreement, "late": lambda: made.agreement(late=30_000_000)},
    "Crossover": {"sentences": crossings, "curves": found_crossings},
    "Threshold": {"sentences": thresholds, "curves": found_thresholds},
    "Listing": {
        "folders": lambda: Listing(
            [
                Entry(Path("out/a\x07"), "run", "", 0.0, None, "trace cannot be read"),
                Entry(Path("out/b"), "sweep", made.NAME, 86_400.0, 1234, "complete"),
            ]
        ),
        "none": Listing,
    },
    "SweepStatus": {
        "two parts": lambda: SweepStatus(
            "relay", 1200, 1000, 1, (SweepPart("0", 600, 600, 0, "done"), SweepPart("1", None, 400, 1, "RUNNING"))
        ),
        "nobody knows": lambda: SweepStatus("relay", None, 1, 0, ()),
    },
    "LossTable": {"tables": losses},
}


CASES = [(kind, name) for kind, cases in RESULTS.items() for name in cases]


def texts(result):
    """Return all that a result shows, by what it is."""
    if isinstance(result, str):
        return {"text": result}
    told = {"text": result.text() if isinstance(result, LossTable) else str(result), "repr": repr(result)}
    for form in ("latex", "markdown"):
        if hasattr(result, "table") and "format" in signature(result.table).parameters:
            told[form] = result.table(format=form)
    if hasattr(result, "_repr_html_"):
        told["html"] = result._repr_html_().replace("<tr>", "\n<tr>").replace("<p>", "\n<p>")
    if hasattr(result, "document"):
        told["document"] = json.dumps(rounded(result.document()))
    return told if "latex" in told or "html" in told else {name: told[name] for name in told if name != "repr"}


def rounded(value):
    """Return JSON values with numbers of six digits and nine decimals."""
    if isinstance(value, dict):
        return {str(key): rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(entry) for entry in value]
    return float(f"{round(value, 9):.6g}") + 0.0 if isinstance(value, float) else value


@pytest.mark.parametrize(("kind", "name"), CASES, ids=[" ".join(case) for case in CASES])
def test_results_are_golden(kind, name, monkeypatch):
    monkeypatch.setattr(Entry, "date", "2026-01-02 03:04")
    result = RESULTS[kind][name]()
    parts = [texts(each) for each in result] if isinstance(result, list) and name != "folders" else [texts(result)]
    golden(file_of(kind, name), "".join(f"# {title}\n{text}\n\n" for part in parts for title, text in part.items()))


def file_of(kind, name):
    return f"results/{kind}, {name}.txt"


@pytest.mark.slow
def test_each_result_has_an_entry():
    """A class with a table, a text or a document of its own is a result, or a part of one."""
    found = set()
    for path in sorted(Path(desim.__file__).parent.rglob("*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if re.search(r"def (table|text|document|tables)\(self", text) else ():
            if isinstance(node, ast.ClassDef):
                names = {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
                found |= {node.name} if names & {"table", "text", "document", "tables"} else set()
    assert found - {"TabularResult"} == {*RESULTS, *PARTS}


def test_each_golden_result_has_a_case():
    assert {path.name for path in (FOLDER / "results").iterdir()} == {Path(file_of(*case)).name for case in CASES}

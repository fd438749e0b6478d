"""All figures that desim draws, of results made by hand: what is on them is golden.

The layout is left out, which takes most of the time of a figure and depends on fonts; other tests look at it.
"""

import ast
from dataclasses import replace
from math import inf
from pathlib import Path

import pytest
from matplotlib import rcParams
from matplotlib.figure import Figure
from matplotlib.text import Text

import desim
from desim import LatencyTrace, Links, LossTrace, Scenario, SignalTrace, Wall
from desim.kernel.models.faults import Crash
from desim.kernel.models.graphs import Link
from desim.kernel.models.traced_faults import FaultStarted
from desim.live.figure import agreement_figure
from desim.study.results.figures import legend, multiples
from desim.view.pictures.link_traces import link_traces
from tests.analysis.test_link_figures import MANY, ONE
from tests.analysis.test_plots import chase
from tests.drawn import described, without_layout
from tests.golden import FOLDER, golden
from tests.study import by_hand as made
from tests.study.by_hand import LATENCY, LOSS, RULES, TIMES
from tests.view.by_hand import MS, history, pair

LABELS = {"sap": "SAP (ours)", "cbba": "$c_1$", "protocol": "the rule_of $x$"}
RADIO = FaultStarted(550 * MS, Crash(node=1, start=0.55, scope="radio"))


def axes():
    """Return the left one of two axes of a figure of a user."""
    return Figure(figsize=(8, 3)).subplots(1, 2)[0]


def lines():
    return made.swept({"protocol": RULES, LATENCY: TIMES})


def grid(**options):
    return made.swept({"protocol": RULES[:1], LATENCY: TIMES, LOSS: [0.0, 0.25]}, **options)


def several(**options):
    return made.swept({LATENCY: TIMES[:2], "protocol": RULES, "team.count": [2, 3, 4, 5]}, runs=2, **options)


def measured(**links):
    return link_traces(Scenario.model_construct(network=Links(**links)))


def among_walls():
    """Return a run among a ring that blocks all, and a line that lets players through and nothing else."""
    ring = "POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0), (1 1, 2 1, 2 2, 1 2, 1 1))"
    walls = (Wall(wkt=ring), Wall(line=((6.0, 0.0), (6.0, 5.0)), blocks=("radio",)))
    return replace(history(), scenario=history().scenario.model_copy(update={"wall": walls}))


FIGURES = {
    "figures.means": {
        "lines": lambda: lines().plot(),
        "differences": lambda: lines().plot(
            "heat", against={"protocol": "sap"}, labels=LABELS, xlabel="delay $L$", ylabel="more", size="8.5cm"
        ),
        "difference from two": lambda: lines().plot(x="protocol", against={"protocol": "sap", LATENCY: 0.1}),
        "rows": lambda: made.swept({"protocol": RULES, "prune": ["inf", "none"]}).plot(labels={"sap": "SAP"}),
        "differences in rows": lambda: made.swept({"protocol": RULES}).plot(against={"protocol": "sap"}, size="17cm"),
        "panels": lambda: several().plot(x=LATENCY, by="protocol", labels={"protocol": "rule"}, ylabel="time"),
        "narrow panels": lambda: several().plot(x=LATENCY, by="protocol", size="8.5cm"),
        "kinds on the abscissa": lambda: lines().plot(by=LATENCY, x="protocol", size="12cmx6cm"),
        "values of several magnitudes": lambda: made.swept({LOSS: [0.0, 0.001, 0.02, 0.3, inf]}).plot(),
        "many values": lambda: made.swept({"horizon": [float(k) for k in range(1, 13)]}).plot(),
        "one value": lambda: made.flat().plot(size="8.5cmx8cm"),
        "on axes": lambda: lines().plot(x=LATENCY, against={"protocol": "sap"}, labels=LABELS, ylabel="y", ax=axes()),
    },
    "figures.multiples": {
        "lines": lambda: multiples(lines(), ["active_time", "end_time", "heat", "messages_sent"]),
        "rows": lambda: multiples(made.swept({"protocol": RULES}), ["active_time", "heat"]),
        "one value": lambda: multiples(made.flat(), ["active_time"], has_legend=False),
    },
    "figures.legend": {"lines": lambda: legend(lines())},
    "heat_maps.phase": {
        "panels": lambda: made.swept({"protocol": RULES, LATENCY: TIMES, LOSS: [0.0, 0.25]}).plot(kind="phase"),
        "without a value": lambda: grid(runs=1).plot(
            "capture_time", kind="phase", xlabel="delay", ylabel="$p$", size="8.5cm"
        ),
        "narrow panels": lambda: made.swept({"protocol": RULES, LATENCY: TIMES, LOSS: [0.0, 0.25]}).plot(
            kind="phase", size="8.5cm"
        ),
        "on axes": lambda: grid().plot(kind="phase", ax=axes()),
    },
    "design_figures.scatter": {
        "points": lambda: made.scattered().plot(),
        "one key": lambda: made.scattered([LOSS]).plot(kind="scatter", size="8.5cm"),
        "on axes": lambda: made.scattered([LATENCY]).plot(kind="scatter", ax=axes()),
    },
    "design_figures.contour": {
        "points": lambda: made.scattered().plot(kind="contour"),
        "narrow panels": lambda: made.scattered().plot(kind="contour", size="8.5cm"),
        "on axes": lambda: grid().plot(kind="contour", ax=axes()),
    },
    "waterfalls.waterfall": {
        "metrics": lambda: made.explanation().plot(),
        "one metric": lambda: made.explanation().plot("active_time", size="8.5cm"),
        "on axes": lambda: made.explanation().plot("heat", ax=axes()),
    },
    "race_figure.draw_race": {
        "decided": lambda: made.raced().plot(),
        "twelve": lambda: made.raced(12, is_decided=False).plot(size="8.5cm"),
        "on axes": lambda: made.raced().plot(ax=axes()),
    },
    "sensitivity_figure.draw_sensitivity": {
        "effects and indices": lambda: made.sensitivity().plot(),
        "narrow": lambda: made.sensitivity().plot(size="8.5cm"),
        "effects": lambda: made.sensitivity(indices=False).plot(size="8.5cm"),
        "no indices": lambda: made.sensitivity(screened=False, varied=False).plot(),
    },
    "score_figure.score_figure": {
        "scores": lambda: made.benchmark().plot(),
        "sized": lambda: made.benchmark().plot(size="12cmx5cm"),
    },
    "figure.agreement_figure": {"runs": lambda: agreement_figure(made.agreement())},
    "trajectory.trajectory": {
        "captured by 1": lambda: desim.plot(chase()),
        "captured by one that stood still": lambda: desim.plot(chase(capturer=0)),
        "not captured": lambda: desim.plot(chase("horizon", None), size="8.5cm"),
        "nobody moved": lambda: desim.plot(chase(samples=1), size="14cmx9cm"),
        "two evaders": lambda: desim.plot(pair()),
        "on axes": lambda: desim.plot(among_walls(), ax=axes()),
    },
    "spacetime.spacetime": {
        "history": lambda: desim.plot(history(RADIO), "spacetime"),
        "pair": lambda: desim.plot(pair(), "spacetime"),
        "2 above 1": lambda: desim.plot(history(), "spacetime", pursuers=(2, 1)),
        "0.15 s to 0.25 s": lambda: desim.plot(history(), "spacetime", begin=0.15, end=0.25),
        "0.6 s to 0.8 s": lambda: desim.plot(history(), "spacetime", begin=0.6, end=0.8),
        "0.45 s to 0.55 s": lambda: desim.plot(history(), "spacetime", begin=0.45, end=0.55, size="8.5cm"),
        "on axes": lambda: desim.plot(history(), "spacetime", ax=axes()),
    },
    "link_traces.link_traces": {
        "all": lambda: measured(
            loss=LossTrace(table=ONE, between="linear", start=2.0),
            link=(
                Link(
                    src=0, dst=1, latency=LatencyTrace(table=ONE, between="linear", after="hold", read_from="$a$.csv")
                ),
            ),
        ),
        "both ways": lambda: measured(
            latency=LatencyTrace(table="t,src,dst,value\n0,0,1,1\n1,0,1,2\n", both_ways=True)
        ),
        "many": lambda: measured(loss=SignalTrace(table=MANY, threshold=-81.5)),
    },
}
"""How each figure is drawn, by what draws it."""
THROUGH = {
    "result.plot",
    "explanation.plot",
    "race_result.plot",
    "sensitivity_result.plot",
    "scores.plot",
    "run_figure.plot",
}
"""Methods and functions of users that only call what draws."""
ELSEWHERE = {"plots.figure_of", "heat_maps.draw_panels", "animation._drawn"}
"""What draws nothing by itself, and films, whose frames are golden in tests/view/test_animation.py."""
CASES = [(kind, name) for kind, cases in FIGURES.items() for name in cases]


def file_of(kind, name):
    return f"figures/{kind.split('.')[1]}, {name}.txt"


@pytest.mark.parametrize(("kind", "name"), CASES, ids=[f"{kind.split('.')[1]}-{name}" for kind, name in CASES])
def test_figures_are_golden(kind, name, monkeypatch):
    monkeypatch.setattr("desim.view.pictures.link_traces.GRID", 6)
    monkeypatch.setattr("desim.live.figure.GRID", 11)
    with without_layout():
        golden(file_of(kind, name), described(FIGURES[kind][name]()) + "\n")


STYLED = {
    "figures.means": lambda **options: lines().plot(**options),
    "heat_maps.phase": lambda **options: grid().plot(kind="phase", **options),
    "design_figures.scatter": lambda **options: made.scattered([LATENCY]).plot(kind="scatter", **options),
    "design_figures.contour": lambda **options: grid().plot(kind="contour", **options),
    "waterfalls.waterfall": lambda **options: made.explanation().plot("heat", **options),
    "race_figure.draw_race": lambda **options: made.raced().plot(**options),
    "sensitivity_figure.draw_sensitivity": lambda **options: made.sensitivity().plot(**options),
    "score_figure.score_figure": lambda **options: made.benchmark().plot(**options),
    "trajectory.trajectory": lambda **options: desim.plot(chase(), **options),
    "spacetime.spacetime": lambda **options: desim.plot(history(), "spacetime", **options),
}
"""How each figure is drawn with options of a user: the style, and the axes if it takes some."""
WHOLE_FIGURES = {"sensitivity_figure.draw_sensitivity", "score_figure.score_figure"}
WITHOUT_STYLE = {"figures.multiples", "figures.legend", "figure.agreement_figure", "link_traces.link_traces"}


@pytest.mark.parametrize("kind", [*STYLED, *(f"{kind} on axes" for kind in STYLED if kind not in WHOLE_FIGURES)])
def test_all_that_is_drawn_is_in_the_style_of_the_user(kind, monkeypatch):
    kind, on_axes, _ = kind.partition(" on axes")
    options, seen, init = {"ax": axes()} if on_axes else {}, [], Text.__init__

    def noting(*args, **named):
        seen.append(rcParams["hist.bins"])
        init(*args, **named)

    monkeypatch.setattr(Text, "__init__", noting)
    with without_layout():
        STYLED[kind](style={"hist.bins": 17}, **options)
    assert {*seen} == {17}


def test_each_figure_takes_a_style_or_is_known_to_take_none():
    assert {*STYLED} | WITHOUT_STYLE == {*FIGURES}


NARROW = [case for case in CASES if case[1].startswith("narrow")]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "name"), NARROW, ids=[f"{kind.split('.')[1]}" for kind, _ in NARROW])
def test_labels_of_narrow_panels_do_not_touch(kind, name):
    figure = FIGURES[kind][name]()
    labels = [axis.label.get_window_extent() for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
    seen = [box for box in labels if box.width and box.height]
    assert not [1 for k, box in enumerate(seen) for other in seen[k + 1 :] if box.overlaps(other)]


@pytest.mark.slow
def test_each_figure_has_an_entry():
    """What draws a figure returns one, or opens one by `styled`. A new one belongs in `FIGURES`."""
    found = set()
    for path in sorted(Path(desim.__file__).parent.rglob("*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if "Figure" in text or "styled" in text else ():
            if isinstance(node, ast.FunctionDef) and draws(node):
                found.add(f"{path.stem}.{node.name}")
    assert found == {*FIGURES, *THROUGH, *ELSEWHERE}


def draws(function):
    calls = {ast.unparse(node.func) for node in ast.walk(function) if isinstance(node, ast.Call)}
    return "styled" in calls or ast.unparse(function.returns or ast.Constant(None)).strip("'").startswith("Figure")


def test_each_golden_figure_has_a_case():
    assert {path.name for path in (FOLDER / "figures").iterdir()} == {Path(file_of(*case)).name for case in CASES}


@pytest.mark.slow
def test_panels_share_both_axes():
    """So that their curves are compared by eye."""
    first, *others = several().plot(x=LATENCY, by="protocol").axes
    assert others
    for axes in others:
        assert first.get_shared_x_axes().joined(first, axes)
        assert first.get_shared_y_axes().joined(first, axes)

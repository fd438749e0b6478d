"""Calls of functions that are refused: what is said, with all that is allowed, is golden."""

import ast
import re
from inspect import signature
from math import inf, nan

import matplotlib.pyplot as plt
import networkx as nx
import numpy as np
import pytest

import desim
from desim import Scenario, Team
from tests.golden import golden
from tests.study import by_hand as made
from tests.study.by_hand import LATENCY, RULES, TIMES

SHORT = Scenario(horizon=0.01, team=Team(count=2))
GIVEN = {
    "desim": desim,
    "CBBA": {"protocol": "cbba"},
    "GRID": {"network.loss.p": [0.0, 0.5]},
    "LATENCY": LATENCY,
    "RANGES": {"network.loss.p": "0:0.5", "team.count": "2:4"},
    "RULES": RULES,
    "SAP": {"protocol": "sap"},
    "SHORT": SHORT,
    "TIMES": TIMES,
    "inf": inf,
    "made": made,
    "nan": nan,
    "nx": nx,
}
"""What the calls may name, beside the public names and `results()`."""
WIDTH = 240
"""Of a longer line the beginning is shown."""
CALLS = {
    "results": """
        swept.plot(kind="pie")
        swept.plot("nope")
        swept.plot(x="nope")
        swept.plot(by="nope")
        swept.plot(against={"protocol": "nope"})
        swept.plot(labels={"nope": "x"})
        swept.plot(kind="contour")
        rules.plot(kind="scatter")
        rules.plot(kind="contour")
        rules.plot(kind="phase")
        points.plot(kind="phase")
        points.plot("nope", kind="contour")
        made.scattered([LATENCY]).plot(kind="contour")
        swept.plot(size="wide")
        swept.plot(ax=3)
        swept.table(format="html")
        swept.table(["nope"])
        swept.table(without=["nope"])
        swept.table(against={"team.count": 3})
        swept.differences("active_time", {"protocol": "nope"})
        apart.differences("active_time")
        swept.differences("active_time", "sap")
        made.swept({LATENCY: TIMES[:1]}).threshold("active_time", LATENCY, 0.1)
        made.swept({"protocol": RULES, LATENCY: TIMES[:1]}).crossover("active_time", LATENCY, SAP, CBBA)
        swept.setting(LATENCY, 7)
        swept.values("nope")
        swept.write("x.doc")
        one.crossover("active_time", LATENCY, {"protocol": "sap"}, {"protocol": "cbaa"})
        swept.crossover("active_time", LATENCY, {"protocol": "sap"}, {"protocol": "sap"})
        swept.crossover("active_time", LATENCY, {LATENCY: 0.1}, {LATENCY: 0.4})
        swept.crossover("active_time", "protocol", {LATENCY: 0.1}, {LATENCY: 0.4})
        swept.crossover("active_time", LATENCY, {"protocol": "sap"}, {"protocol": "cbba"}, confidence=1.0)
        swept.crossover("nope", LATENCY, {"protocol": "sap"}, {"protocol": "cbba"})
        apart.crossover("active_time", LATENCY, {"protocol": "sap"}, {"protocol": "cbba"})
        swept.threshold("active_time", LATENCY, 0.1)
        swept.threshold("active_time", LATENCY, 0.0)
        swept.threshold("active_time", LATENCY, -1.0)
        swept.threshold("active_time", LATENCY, 0.1, baseline=7)
        swept.threshold("active_time", LATENCY, 0.1, where={"protocol": "nope"})
        swept.threshold("active_time", LATENCY, 0.1, where={LATENCY: 0.1})
        swept.threshold("active_time", "protocol", 0.1)
        swept.threshold("active_time", LATENCY, 0.1, where={"protocol": "sap"}, confidence=0.0)
        made.raced().table(format="html")
        made.explanation().plot("nope")
        made.explanation().table(format="html")
        made.comparison().table(format="html")
        made.sensitivity().table(format="html")
        made.benchmark().table(format="html")
        plot(ran, "spacetime", pursuers=[])
        judge("nope", ran)
        compare(swept, 3)
        compare(swept, made.swept({"protocol": ["sap"]}), ["nope"])
        compare("nowhere", swept)
        export(ran, "x.nope")
        export(ran, "x.csv", "nope")
        export(swept, "x.mcap")
        summary(ran, {"mine": 3})
        summary(ran, {"not a name": len})
        replay(3)
        replay(ran, 3)
        plot(ran, "pie")
        plot(ran, begin=0.1)
        plot(ran, "trajectory", pursuers=[0])
        plot(ran, "spacetime", begin=0.005, end=0.001)
        plot(ran, "spacetime", pursuers=[7])
        made.flat().plot(kind="means", x="nope")
    """,
    "runs": """
        sweep(SHORT, GRID, 0)
        sweep(SHORT, GRID, 2, -1)
        sweep(SHORT, GRID, 2, "nope")
        sweep(SHORT, GRID, 2, seed=-1)
        sweep(SHORT, GRID, 2, design="nope")
        sweep(SHORT, GRID, 2, design=("random", 0))
        sweep(SHORT, GRID, 2, design=("nope", 2))
        sweep(SHORT, GRID, 2, until="active_time")
        sweep(SHORT, GRID, 2, until=("active_time", 0.0))
        sweep(SHORT, GRID, 2, until=("nope", 1.0))
        sweep(SHORT, GRID, 2, timeout=0.0)
        sweep(SHORT, GRID, 2, metrics={"not a name": len})
        sweep(SHORT, GRID, 2, metrics={"captured": len})
        sweep(SHORT, GRID, 2, metrics={"mine": 3})
        sweep(SHORT, GRID, 10**7)
        sweep(SHORT, {"network.loss.p": []}, 2)
        sweep(SHORT, {"nope": [1]}, 2)
        sweep(SHORT, {"network.loss.p": [0.0, 2.0]}, 2)
        controlled(SHORT, GRID, 2)
        controlled(SHORT, GRID, 4, control="nope")
        controlled(SHORT, GRID, 4, control_runs=2)
        explain(SHORT, 1)
        race(SHORT, GRID, zone=0.0)
        race(SHORT, GRID, zone=-1.0)
        race(SHORT, GRID, zone=nan)
        race(SHORT, GRID, zone=0.1, confidence=1.0)
        race(SHORT, GRID, zone=0.1, first=1)
        race(SHORT, GRID, zone=0.1, first=20, most=10)
        race(SHORT, GRID, "nope", zone=0.1)
        race(SHORT, {"network.loss.p": [0.5]}, zone=0.1)
        race(SHORT, GRID, zone=0.1, timeout=0)
        sensitivity(SHORT, RANGES, points=3)
        sensitivity(SHORT, RANGES, points=-1)
        sensitivity(SHORT, RANGES, points=0, trajectories=0)
        sensitivity(SHORT, RANGES, trajectories=1)
        sensitivity(SHORT, RANGES, runs=0)
        sensitivity(SHORT, RANGES, "nope")
        sensitivity(SHORT, RANGES, timeout=0)
        find_violation(SHORT, "nope")
        find_violation(SHORT, "idle at most 0.001 in total", runs=0)
        find_violation(SHORT, "idle at most 0.001 in total", budget=0.0)
        find_violation(SHORT, "idle at most 0.001 in total", features=["nope"])
        find_violation(SHORT, "idle at most 0.001 in total", vary={"nope": [1]})
        find_violation(SHORT, "idle at most 0.001 in total", jobs=-1)
        fatal_losses(SHORT, "idle at most 0.001 in total", most=0)
        fatal_losses(SHORT, "idle at most 0.001 in total", fates=["nope"])
        fatal_losses(SHORT, "idle at most 0.001 in total", fates=["late"])
        fatal_losses(SHORT, "idle at most 0.001 in total", delay=0.0)
        fatal_losses(SHORT, "idle at most 0.001 in total", limit=0)
        env(SHORT, -1)
        env(SHORT, reward="nope")
        env(SHORT, observation="nope")
        env(SHORT, max_cycles=0)
        env(SHORT, render_mode="nope")
        env(SHORT, omniscient=1)
        parallel_env(SHORT, agents_leave=1)
        desim.open("nowhere")
        ls("nowhere")
        status("nowhere")
        bench(["sap"], 1)
        bench(["sap"], 17)
        bench(version="7")
        sensitivity(SHORT, GRID)
        sensitivity(SHORT, {"team.count": "2:3"})
        find_violation(SHORT, "idle at most 0.1 in total")
    """,
    "networks": """
        fates([(0.0, 0, 5, 10)], 2)
        fates([(0.0, 0, None, -1)], 2)
        fates([(1.0, 0, None, 10), (0.0, 0, None, 10)], 2)
        fates([(0.0, 0, None, 10)], 0)
        fates([(0.0, 0, None, 10)], 2, wait=-1.0)
        SteppedNetwork(0)
        SteppedNetwork(nx.Graph())
        SteppedNetwork(2, walls=3)
        SteppedNetwork(2, horizon=0.0)
        SteppedNetwork(2, horizon=inf)
        SteppedNetwork(2).step(-1.0)
        SteppedNetwork(2).send(0, 5, "x")
        SteppedNetwork(2).send(5, 0, "x")
        SteppedNetwork(2).publish(5, "x")
        SteppedNetwork(2).latest(5)
        SteppedNetwork(2).neighbours(-1)
        SteppedNetwork(2).leave(7)
        SteppedNetwork(2).join(0)
        SteppedNetwork(2).reset(-1)
        SteppedNetworks(0, 2)
        SteppedNetworks(2, 2).publish([1.0])
        SteppedNetworks(2, 2).step(0.0)
        wrap(3)
    """,
}
"""Each line is a call. What is refused before anything is run or drawn takes a millisecond."""
PUBLIC = {public: getattr(desim, public) for public in desim.__all__}
ADDRESS = re.compile("0x[0-9a-fA-F]{6,}")
WRONG = {
    "object": object(),
    "list": [object()],
    "key": {object(): 1},
    "value": {"kind": object()},
    "function": lambda: 1,
    "method": [].append,
    "generator": np.random.default_rng(1),
}
"""Objects whose `repr` has an address."""


def calls_of(name):
    """Return the calls of a group as texts."""
    return [*filter(None, map(str.strip, CALLS[name].splitlines()))]


def with_wrong_arguments(call):
    """Yield a call as a text, once for each of its arguments, which is `wrong` there."""

    def arguments(tree):
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and not ast.unparse(node.func).startswith("made."):
                yield from ((node.args, k) for k in range(len(node.args)))
                yield from ((vars(keyword), "value") for keyword in node.keywords)

    for k, _ in enumerate(arguments(ast.parse(call))):
        tree = ast.parse(call, mode="eval")
        holder, place = [*arguments(tree)][k]
        holder[place] = ast.Name("wrong", ast.Load())
        yield ast.unparse(tree)


def results():
    """Return a run, and sweeps: of two keys, of one, with independent seeds, and over the points of a design."""
    return {
        "ran": desim.run(SHORT, 1),
        "swept": made.swept({"protocol": RULES, LATENCY: TIMES}),
        "one": made.swept({LATENCY: TIMES}),
        "rules": made.swept({"protocol": RULES}),
        "apart": made.swept({LATENCY: TIMES}, common=False),
        "points": made.scattered(),
    }


@pytest.mark.parametrize("name", CALLS)
def test_what_a_refused_call_says_is_golden(name, monkeypatch, tmp_path):
    """Each names the argument and what is allowed: review it when it is regenerated."""
    monkeypatch.chdir(tmp_path)
    names = GIVEN | PUBLIC | results()
    lines, drawn = [], plt.get_fignums()
    for call in calls_of(name):
        with pytest.raises((ValueError, TypeError, OSError)) as refused:
            eval(call, names)
        said = [line[:WIDTH] for line in str(refused.value).splitlines()]
        lines += [call, *(f"    {line}" for line in said), ""]
    golden(f"refused_calls/{name}.txt", "\n".join(lines))
    assert plt.get_fignums() == drawn
    assert not list(tmp_path.iterdir())


def said_by(called, *arguments, **named):
    """Return what is said if a call is refused, and "" otherwise."""
    try:
        called(*arguments, **named)
    except Exception as error:
        return " ".join([str(error), *getattr(error, "__notes__", ())])
    return ""


@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
def test_no_message_about_an_argument_shows_the_address_of_an_object(name, monkeypatch, tmp_path):
    """An address differs from process to process and says nothing."""
    monkeypatch.chdir(tmp_path)
    names = GIVEN | PUBLIC | results()
    calls = dict.fromkeys(text for call in calls_of(name) for text in with_wrong_arguments(call))
    refused = 0
    for k, call in enumerate(calls):
        for kind in [*WRONG][k % 4 :: 4]:  # all take four times as long
            message = said_by(eval, call, names | {"wrong": WRONG[kind]})
            refused += bool(message)
            assert not ADDRESS.search(message), f"{call} with wrong = {kind}"
    assert refused > len(calls)


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRONG)
def test_no_message_about_a_key_shows_the_address_of_an_object(kind):
    models = [public for public in PUBLIC.values() if isinstance(public, type) and hasattr(public, "model_fields")]
    for model in models:
        for key in signature(model).parameters:
            assert not ADDRESS.search(said_by(model, **{key: WRONG[kind]})), f"{model.__name__}({key}={kind})"

"""Natural mistakes, in Python, in files and in commands: each is told its place, the reason and a way out."""

import ast
import datetime
import random
import time
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import desim
from desim import Constant, Gamma, Lognormal, Scenario, Team, load
from desim.cli import main
from desim.config.errors import KeyedError
from desim.config.shared_state import StateWarning
from desim.results.run_folder import write
from desim.simulation.run import Result

SHORT = Scenario(horizon=0.01, team=Team(count=2))
NAMES = {name: getattr(desim, name) for name in dir(desim)} | {
    "desim": desim,
    "np": np,
    "Path": Path,
    "datetime": datetime,
    "SHORT": SHORT,
    "SWEPT": desim.sweep(SHORT, {"team.count": [2]}, reps=1),
    "GRID": {"team.count": [2]},
}
"""What a script of a newcomer has imported."""

CALLS: dict[str, tuple[Any, ...]] = {
    # a mistake, and what its message has
    "Team(cout=8)": ("Team: cout", "did you mean 'count'?", "allowed: active_at_start"),
    "Team(8)": ("Team(count=...)", "others: positions"),
    "desim.Lognormal(0.1)": ("Lognormal(offset=..., mean=..., cv=...)",),
    "Team(count='8')": ("count: should be a number: 8 instead of the text '8'", "Number of pursuers"),
    "Team(count='eight')": ("count: should be an integer", "got 'eight'"),
    "Team(count=8.0)": ("count: should be an integer", "got 8.0"),
    "Team(count=0)": ("count: should be greater than or equal to 1", "got 0"),
    "Team(count=True)": ("count: should be an integer", "got True"),
    "Team(positions=5)": ("positions: ", "list"),
    "Team(count=3, speeds=[1.0, 2.0])": ("speeds", "one per pursuer"),
    "Team(box=[5.0, 1.0])": ("box: should be [lower, upper]",),
    "Scenario(netwrk=Links())": ("netwrk: unknown key, did you mean 'network'?",),
    "Scenario(latency=0.1)": ("latency: unknown key, did you mean network.latency?",),
    "Scenario(team=dict(count='x'))": ("team.count: should be an integer", "got 'x'"),
    "Scenario(team=5)": ("team: should be a Team or a table of its keys", "got 5"),
    "Scenario(team=Team)": ("team: should be a Team, not a class: Team()",),
    "Scenario(team=Links())": ("team: should be a Team", "got Links()"),
    "Scenario(protocol='SAP')": ("protocol.kind: there is no 'SAP', did you mean 'sap'?", "allowed: argmin"),
    "Scenario(protocol='auction')": ("did you mean 'cbaa' or 'cbba'?",),
    "Scenario(protocol='spatial_adaptive_play')": ("did you mean 'sap'?",),
    "Scenario(protocol='Consensus-based auction algorithm')": ("did you mean 'cbaa'?",),
    "Scenario(protocol='cbbaa')": ("did you mean 'cbba'?",),
    "Scenario(protocol=5)": ("protocol: should be a kind", "allowed: argmin"),
    "Scenario(protocol=lambda: 3)": ("protocol: should accept a call with (me)",),
    "Scenario(team=dict(count=2, speeds={0: 1.0, 1: 2.0}))": ("team.speeds.0: should be a text, the name of a key",),
    "Team(positions={0.5: (0.0, 1.0), 1: (2.0, 3.0)})": ("positions: the nodes of the positions should be names",),
    "Scenario(horizon='30s')": ("horizon: should be a number, in s: 30 instead of the text '30s'",),
    "Scenario(capture=dict(radius='10 cm'))": ("capture.radius: should be a number, in m: 0.1",),
    "Scenario(capture=dict(radius='10 ms'))": ("capture.radius: should be a number without a unit (got '10 ms')",),
    "Links(latency='3 km')": ("latency: should be a number without a unit (got '3 km')",),
    "Scenario(horizon=-1)": ("horizon: should be greater than", "got -1"),
    "Scenario(seed=1.5)": ("seed: should be an integer", "got 1.5"),
    "Scenario(prune='yes')": ("prune: should be 'none', 'inf' or 'infeasible'", "got 'yes'"),
    "Scenario(horizon=-1, sed=3, team=dict(cout=3))": ("horizon: ", "sed: unknown key", "team.cout: unknown key"),
    "Scenario('relay.toml')": ("load('relay.toml')",),
    "Scenario(**{'team.count': 3})": ("team={'count': ...}", "with_"),
    "Scenario(fault=[dict(kind='crash', node=25, start=1.0)])": ("fault.0.node: there is no pursuer 25", "0 .. 19"),
    "Scenario(fault=[dict(kind='crash')])": ("fault.0.start: is missing",),
    "Scenario(fault=dict(kind='crash', node=1, start=1.0))": ("fault: should be a list",),
    "Links(latency=-1)": ("latency.value: should be greater than or equal to 0", "One-way latency, s", "got -1"),
    "Links(latency='0.1')": ("latency: should be a number: 0.1",),
    "Links(latency='100 ms')": ("latency: should be a number, in s: 0.1",),
    "Links(latency='lognorml')": ("latency.kind: there is no 'lognorml', did you mean 'lognormal'?",),
    "Links(latency=Constant)": ("should be an instance: Constant() instead of Constant",),
    "Links(latency=lambda x: 3)": ("latency: should accept a call with (context, rng)",),
    "Links(loss=5)": ("loss.p: should be less than or equal to 1", "got 5"),
    "Links(loss='5 %')": ("loss: should be a number from 0 to 1: 0.05",),
    "Links(range='10 m')": ("range: should be", "10"),
    "Links(packet_loss=0.1)": ("packet_loss: unknown key, did you mean 'loss'?",),
    "Links(delay=0.1)": ("delay: unknown key, did you mean 'latency'?",),
    "Constant(0.1)": ("Constant(value=...)",),
    "Constant(mean=0.1)": ("mean: unknown key", "Lognormal", "allowed: kind, value"),
    "Lognormal(mean=0.1, std=0.01)": ("std: unknown key, did you mean 'cv'?",),
    "Gamma(scal=0.1)": ("scal: unknown key, did you mean 'scale'?",),
    "SHORT.model_copy(update={'netwrk': Links()})": ("netwrk: unknown key, did you mean 'network'?",),
    "SHORT.model_copy(update={'protocol': 'cba'})": ("protocol.kind: there is no 'cba', did you mean 'cbba'?",),
    "SHORT.with_({'network.latncy': 0.1})": ("network.latncy: unknown key, did you mean 'latency'?",),
    "SHORT.with_({'network.latency': 'x'})": ("network.latency.kind: there is no 'x'", "allowed: constant"),
    "SHORT.with_('team.count=3')": ("with_ takes values by key", "{'network.latency.value': 0.5}"),
    "SHORT.with_({3: 4})": ("a dotted key is for instance network.latency.value",),
    "setattr(SHORT, 'horizon', 3.0)": ("horizon: cannot be set", "with_({'horizon': ...})"),
    "setattr(SHORT, 'horizn', 3.0)": ("did you mean 'horizon'?",),
    "run('relay.toml')": ("run takes a scenario, not a path: run(load('relay.toml'))",),
    "run(Path('relay.toml'))": ("run(load('relay.toml'))",),
    "run(Scenario)": ("not the class Scenario: run(Scenario(...))",),
    "run({'team': 3})": ("run(Scenario(**keys))",),
    "run(run(SHORT))": ("run(result.scenario)",),
    "run([SHORT])": ("[run(scenario) for scenario in scenarios]",),
    "run(None)": ("run takes a scenario", "got None"),
    "run(SHORT, seed='x')": ("the seed should be an integer", "got 'x'"),
    "run(SHORT, 1.5)": ("the seed should be an integer", "got 1.5"),
    "run(SHORT, -1)": ("the seed should be at least 0",),
    "run(SHORT, 1, 'x')": ("a watcher should",),
    "sweep('relay.toml', GRID)": ("sweep(load('relay.toml'))",),
    "sweep(SHORT)": ("sweep.grid", '"network.latency.value" = [0.0, 0.1] for instance'),
    "sweep(SHORT, ['team.count'])": ("the grid should be lists of values by key", "{'network.latency.value'"),
    "sweep(SHORT, {'team.count': 3})": ("team.count: should be a list", "got 3"),
    "sweep(SHORT, {'team.cont': [3]})": ("team.cont: unknown key, did you mean 'count'?",),
    "sweep(SHORT, GRID, metrics=['active_time'])": ("functions by name", "always measured"),
    "sweep(SHORT, GRID, reps=0)": ("at least one run",),
    "sweep(SHORT, GRID, until='active_time')": ("a metric and a half width", "('active_time', 0.1)"),
    "sweep(SHORT, GRID, until=('activetime', 0.1))": ("did you mean 'active_time'?",),
    "sweep(SHORT, GRID, executor='4')": ("the number 4 instead of the text '4'",),
    "sweep(SHORT, {'network.latency.value': '0:1:0'})": ("step",),
    "summary(SHORT)": ("summary(run(scenario))",),
    "summary('out')": ("summary(desim.open('out'))",),
    "plot(SHORT)": ("plot(run(scenario))",),
    "plot(run(SHORT), 'traj')": ("trajectory or spacetime",),
    "replay('out')": ("replay(desim.open('out'))",),
    "replay(SHORT)": ("replay(run(scenario))",),
    "replay(run(SHORT), 'run.html')": ("a ghost is another run, not a file", "replay(result).write('run.html')"),
    "replay(run(SHORT), 'out')": ("replay(desim.open('out'))",),
    "plot(run(SHORT), 'run.png')": ("kind should be", "plot(result).savefig('run.png')"),
    "export(SHORT, 'x.csv')": ("export(run(scenario))",),
    "export(run(SHORT), 'x.foo')": (".csv",),
    "export(run(SHORT), None)": ("export takes the path of a file", "not a NoneType"),
    "plot(run(SHORT), 'spacetime', begin='0.1')": ("begin should be a number (got '0.1')",),
    "plot(run(SHORT), 'spacetime', end=datetime.timedelta(1))": ("end should be a number (got datetime.timedelta",),
    "plot(run(SHORT), 'spacetime', pursuers=0)": ("pursuers should be a list of their numbers (got 0)",),
    "plot(run(SHORT), 'spacetime', pursuers='01')": ("pursuers should be a list of their numbers (got '01')",),
    "plot(run(SHORT), 'spacetime', pursuers=[True])": ("a pursuer should be an integer (got True)",),
    "run(SHORT).trace.of('Decided')": ("`of` takes a class of events", "got 'Decided'"),
    "explain(run(SHORT))": ("explain(result.scenario)",),
    "explain(SHORT, runs=1)": ("at least 2 runs",),
    "explain(SHORT, shown=['activetime'])": ("did you mean 'active_time'?",),
    "load(SHORT)": ("not a Scenario: use it as it is",),
    "load({'team': 3})": ("Scenario(**keys)",),
    "load('relay.toml')": ("load(examples()['relay'])",),
    "desim.open(SHORT)": ("the path of a folder",),
    "run(SHORT, seeds=[1, 2])": ("did you mean 'seed'?", "run(scenario, seed=None, *watchers)", "for seed in range"),
    "run(SHORT).active_time": ("a Result has no 'active_time'", "summary(result).active_time"),
    "run(SHORT).plot()": ("plot(result)",),
    "run(SHORT)['active_time']": ("a Result is no table", "summary(result).active_time"),
    "SHORT.run(seed=7)": ("a Scenario has no 'run'", "run(scenario)"),
    "SHORT.plot()": ("plot(run(scenario))",),
    "SHORT.latency": ("a Scenario has no 'latency': scenario.network.latency",),
    "SHORT.team.cnt": ("a Team has no 'cnt': its keys are count, positions",),
    "SHORT.with_(latency=0.3)": ("scenario.with_({'network.latency.value': 0.5})",),
    "setattr(SHORT.network, 'latency', 0.3)": ("scenario.with_({'...latency': ...})",),
    "sweep(SHORT, GRID, n=5)": ("did you mean 'reps'?",),
    "sweep(SHORT, GRID, n_jobs=5)": ("did you mean 'executor'?",),
    "sweep(SHORT, GRID, executor='parallel')": ("a number of processes", "got 'parallel'"),
    "sweep(SHORT, GRID)['active_time']": ("a SweepResult is no table", "result.to_frame()['active_time']"),
    "sweep(SHORT, GRID).to_pandas()": ("result.to_frame()",),
    "sweep(SHORT, GRID).mean('regret')": ("result.estimates('active_time')",),
    "load(examples()['relay'], {'team.count': 8})": ("with_({'team.count': 8})",),
    "Scenario(evader=PureEvasion())": ("should be an Evader", "Evader(strategy=PureEvasion(...))"),
    "Scenario(network=Lognormal())": ("Links(latency=Lognormal(...))",),
    "Scenario(fault=Crash(node=1, start=1.0))": ("should be a list: [Crash(...)]",),
    "exec('from desim import SpatialAdaptivePlay')": ("from protocols import SpatialAdaptivePlay",),
    "exec('from desim import Simulation')": ("from desim import run",),
    "exec('from protocols import SAP')": ("from protocols import SpatialAdaptivePlay",),
    "exec('from protocols import jsfp')": ("JointStrategyFictitiousPlay, or protocol='jsfp'",),
    "desim.smmary": ("did you mean 'summary'?",),
    "desim.report": ("`desim report` is a command",),
    "exec('from desim import SAP')": ("from protocols import SpatialAdaptivePlay",),
    "exec('from protocols import Sap')": ("from protocols import SpatialAdaptivePlay",),
    "exec('from protocols import Lognormal')": ("from desim import Lognormal",),
    "Scenario(fault=[dict(kind='crash', pursuer=1, start=1.0)])": ("pursuer: unknown key, did you mean 'node'?",),
    "Scenario(horizon=object())": ("horizon: should be a number", "(got object)"),
    "Scenario().with_({object(): 1})": ("network.latency.value (got object)",),
    "run(object())": ("not an object (got object)",),
    "run(Scenario(), object())": ("the seed should be an integer (got object)",),
    "Scenario(fault=(dict(kind='crash', pursuer=1, start=1.0),))": ("pursuer: unknown key, did you mean 'node'?",),
    "sweep(SHORT, {'loss': [0.1]})": ("unknown key, did you mean network.loss?",),
    "sweep(SHORT, {'network.latency': Constant()})": ("network.latency: should be a list: [Constant()]",),
    "sweep(SHORT, GRID, store=3)": ("store should be the path of a file", "got 3"),
    "sweep(SHORT, GRID, store='.')": ("is a folder, and a store is a file (.sqlite)",),
    "sweep(SHORT, GRID, until=('active_time,regret', 1))": ("the name of one metric",),
    "sweep(SHORT, GRID).plot(['regret', 'energy'])": ("the name of one metric, 'active_time' for instance",),
    "sweep(SHORT, GRID).crossover('team.count')": ("it is crossover(metric, key, a, b", "{'protocol': 'sap'}"),
    "summary(run(SHORT)).activetime": ("there is no metric 'activetime', did you mean 'active_time'?",),
    "explain(SHORT, reps=5)": ("did you mean 'runs'?",),
    "race(SHORT, GRID, zone=1, runs=5)": ("did you mean 'most'?",),
    "controlled(SHORT, GRID, reps=4, shown=['activ'])": ("did you mean 'active_time'?",),
    "compare('out', 'out')": ("out: there is no such store; `desim sweep FILE -o DIR` makes one in DIR",),
    "find_violation(SHORT, 'idle at most 2 in total', runs=0)": ("runs should be at least 1 (got 0)",),
    "find_violation(SHORT, 'idle at most 0.001 in total', vary={'team.count': 3})": (
        "team.count: should be a list",
        "[3]",
    ),
    "find_violation(SHORT, 'idle at most 0.001 in total', features='los')": (
        "there is no 'los', did you mean 'loss'?",
    ),
    "find_violation(SHORT, 3)": ("a property should be a text, such as 'idle at most 2 in total' (got 3)",),
    "find_violation(SHORT, 'idle', protocol='cbba')": ("with_({'protocol.kind': 'cbba'})", "on_case=..."),
    "judge(run(SHORT), 'idle at most 2 in total')": ("judge takes the property first",),
    "fates([(0, 0, 1, 9)], 2, latency=0.1)": ("did you mean 'links'?", "it is SteppedNetwork(nodes, links=None"),
    "SteppedNetwork(3, sed=1)": ("did you mean 'seed'?", "it is SteppedNetwork(nodes"),
    "load('.')": ("a scenario is one file", "desim.open"),
    # flags as texts, which would be true, and functions, lists, times and paths of another type
    "load(examples()['relay'], allow_import='no')": ("allow_import should be True or False (got 'no')",),
    "load(examples()['relay'], allow_import=None)": ("allow_import should be True or False (got None)",),
    "desim.open('out', allow_import=0)": ("allow_import should be True or False (got 0)",),
    "sweep(SHORT, GRID, fail_fast='false')": ("fail_fast should be True or False (got 'false')",),
    "sweep(SHORT, GRID, mix_versions='no')": ("mix_versions should be True or False (got 'no')",),
    "find_violation(SHORT, 'idle at most 2 in total', guided='off')": ("guided should be True or False (got 'off')",),
    "SteppedNetwork(3, can_leave='no')": ("can_leave should be True or False (got 'no')",),
    "find_violation(SHORT, 'idle at most 2 in total', on_case=3)": ("on_case should be a function (got 3)",),
    "find_violation(SHORT, 'idle at most 0.001 in total', timeout='1')": ("a time limit, in s, should be a number",),
    "find_violation(SHORT, 'idle at most 0.001 in total', timeout=-1)": ("a time limit should be > 0 s",),
    "find_violation(SHORT, 'idle at most 2 in total', shrinking=-1)": ("shrinking should be at least 0 (got -1)",),
    "find_violation(SHORT, 'idle at most 2 in total', shrinking=None)": ("shrinking should be an integer (got None)",),
    "find_violation(SHORT, 'idle at most 2 in total', log='a')": ("log should be a CaseLog (got 'a')",),
    "find_violation(SHORT, 'idle at most 0.001 in total', vary=3)": ("vary should be lists of values by key", "got 3"),
    "find_violation(SHORT, 'idle at most 0.001 in total', features=3)": ("features should be a list of names (got 3)",),
    "find_violation(SHORT, 'idle at most 0.001 in total', features=[3])": (
        "features should be a list of names (got [3])",
    ),
    "desim.fatal_losses(SHORT, 'idle at most 2 in total', fates=3)": ("fates should be a list of", "got 3"),
    "desim.fatal_losses(SHORT, 'idle at most 0.001 in total', timeout=0)": ("a time limit should be > 0 s",),
    "sweep(SHORT, GRID, until=0.1)": ("a metric and a half width", "got 0.1"),
    "SWEPT.crossover('active_time', 'team.count', 'sap', 'cbba')": ("a should be a dict, {'network.", "got 'sap'"),
    "SWEPT.crossover('active_time', 'team.count', {}, {}, confidence='high')": ("the confidence should be a number",),
    "SWEPT.crossover('active_time', ['team.count'], {}, {})": ("a key of the grid should be a text", "['team.count']"),
    "SWEPT.threshold('active_time', 'team.count', '10 %')": ("over should be a number (got '10 %')",),
    "SWEPT.threshold('active_time', 'team.count', 0.1, where=3)": ("where should be a dict", "got 3"),
    "desim.explain(SHORT, shown=3)": ("shown should be a list of texts (got 3)",),
    "desim.explain(SHORT, shown=['active_time', 3])": ("shown should be a list of texts", "3]"),
    "desim.load('x.toml', 3)": ("overrides should be a list of texts (got 3)",),
    "desim.load('x.toml', [('team.count', 3)])": ("overrides should be a list of texts", "'team.count'"),
    "desim.load('x.toml', b'seed=1')": ("overrides should be a list of texts", "seed=1"),
    "desim.explain(SHORT, metrics=np.array([1, 2]))": ("metrics should be functions by name", "array([1, 2])"),
    "desim.sweep(SHORT, {}, metrics=np.array([1, 2]))": ("metrics should be functions by name", "array([1, 2])"),
    "desim.sweep(SHORT, GRID, until=np.array([1, 2, 3]))": ("until should be a metric and a half width", "array("),
    "desim.compare(SWEPT, SWEPT).table('active_time')": ("it is table(*, format='text')",),
    "desim.compare(SWEPT, SWEPT).table(fmt='latex')": ("argument 'fmt'", "it is table(*, format='text')"),
    "SWEPT.table(3)": ("names of metrics or columns should be a list of texts", "got 3"),
    "SWEPT.table([3])": ("names of metrics or columns should be a list of texts", "got [3]"),
    "SWEPT.table(against='sap')": ("against should be a dict", "got 'sap'"),
    "SWEPT.tables(against=True)": ("against should be a dict", "got True"),
    "SWEPT.table(labels=['a'])": ("labels should be a dict", "got ['a']"),
    "SWEPT.table(labels={'team.count': 2})": ("the label of team.count should be a text (got 2)",),
    "SWEPT.crossover('active_time', 'team.count', None, {})": ("a should be a dict", "got None"),
    "SWEPT.table(without=3)": ("without should be a list of texts (got 3)",),
    "SWEPT.table(without='captred')": ("captred",),
    "SWEPT.setting(3, 2)": ("a key of the grid should be a text", "got 3"),
    "SWEPT.values(None)": ("a key of the grid should be a text", "got None"),
    "SWEPT.differences('active_time', 7)": ("there is no configuration 7: they are 0 .. 0",),
    "SWEPT.differences('active_time', True)": ("a reference should be a mapping", "got True"),
    "desim.ls(3)": ("ls takes the path of a folder with results, not an int (got 3)",),
    "desim.status(None)": ("status takes the path of a folder with results",),
    "desim.open_data(3)": ("open_data takes the path of a file (got 3)",),
    "desim.TraceFile(3)": ("TraceFile takes the path of a file (got 3)",),
    "desim.TraceFile('')": ("TraceFile takes the path of a file (got '')",),
}


@pytest.mark.parametrize("name", ["plot", "run", "export", "nothing_of_it"])
def test_what_takes_a_scenario_is_written_as_python_and_is_in_the_facade(name):
    with pytest.raises(AttributeError, match="functions take it, such as ") as refused:
        getattr(SHORT, name)
    calls = str(refused.value).partition("such as ")[2].partition("; ")[0]
    for call in ast.parse(f"[{calls}]", mode="eval").body.elts:
        assert isinstance(call, ast.Call)
        assert hasattr(desim, call.func.id) if isinstance(call.func, ast.Name) else hasattr(SHORT, call.func.attr)


def test_the_name_of_the_object_itself_is_no_argument_to_suggest():
    with pytest.raises(TypeError, match="unexpected keyword argument 'slf'; it is with_") as refused:
        Scenario().with_(slf={})
    assert "did you mean" not in str(refused.value)


class AtPath:
    """A path of another library: an object that tells its path."""

    def __init__(self, path):
        self._path = str(path)

    def __fspath__(self):
        return self._path


@pytest.mark.slow
def test_a_path_may_be_any_object_that_tells_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.toml").write_text("horizon = 0.1\nteam.count = 2\n")
    (tmp_path / "v.txt").write_text("0.1\n")
    result = desim.run(load(AtPath("s.toml")))
    assert result.scenario.team.count == 2
    desim.export(result, AtPath("t.csv"))
    assert (tmp_path / "t.csv").exists()
    assert desim.Empirical(file=AtPath(tmp_path / "v.txt")).values == (0.1,)
    write(result, tmp_path / "out")
    assert desim.open(AtPath("out")).seed == result.seed


@pytest.mark.parametrize("call", CALLS)
def test_a_wrong_call_says_what_to_write(call, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, TypeError, OSError, AttributeError, ImportError)) as refused:
        eval(call, dict(NAMES))
    message = str(refused.value)
    for part in CALLS[call]:
        assert part in message
    assert "pydantic" not in message
    assert "[type=" not in message
    assert refused.value.__suppress_context__ or refused.value.__context__ is None


LOOKS_AT_CALLER = {"open_data"}
"""Functions that no decorator may stand before."""


@pytest.mark.parametrize("name", [name for name in desim.__all__ if name.islower() and name not in LOOKS_AT_CALLER])
def test_a_call_with_a_wrong_argument_names_those_that_the_function_takes(name):
    function = getattr(desim, name)
    with pytest.raises(TypeError) as refused:
        function(**{"nothing_of_this_name": 1})
    assert f"; it is {name}({next(iter(signature(function).parameters), ')')}" in str(refused.value)


LINES: dict[str, str] = {
    # a line of a protocol, and what its message has
    "me.assign()": "it is me.assign(action): Chase an evader",
    "me.send('hello')": "it is me.send(dst, body",
    "me.broadcast('hello')": "it is me.broadcast()",
    "me.assign(me.position[0] > 3)": "me.position() for instance",
    "me.assign(abs(me.position) > 3)": "me.position() for instance",
    "me.evader.position": "me.position() for instance",
    "me.position()[0]": "its x is .real",
    "x, y = me.position()": "its x is .real",
    "me.x": "write me.position().real",
    "me.receive()": "write me.mail()",
    "me.team_estimate().position": "a TeamEstimate has capture_times, ids, positions, speeds",
    "me.asign(1)": "an Agent has no 'asign': it has action, after()",
    "yield from me.sleep(0.1)": "not `yield from`",
    "await me.sleep(0.1)": "`def` in place of `async def`, and `yield` to wait",
}


@pytest.mark.parametrize("line", LINES)
def test_a_wrong_line_of_a_protocol_says_what_to_write(line):
    names: dict[str, Any] = {}
    waits = "" if "await" in line else "yield me.sleep(0.001)\n    "
    exec(f"{'async ' if 'await' in line else ''}def mine(me):\n    {waits}{line}", names)
    with pytest.raises((TypeError, AttributeError, ValueError)) as refused:
        desim.run(SHORT.with_({"protocol": names["mine"]}))
    assert LINES[line] in " ".join([str(refused.value), *getattr(refused.value, "__notes__", ())])


class Base:
    def __init__(self, value):
        super().__init__(value)


class Slotted:
    def __new__(cls, value):
        return super().__new__(cls, value)


@pytest.mark.parametrize("line", ["Base(3)", "Slotted(3)"])
def test_a_wrong_call_of_a_class_of_the_user_gets_no_advice_about_a_method_of_the_pursuer(line):
    names: dict[str, Any] = {"Base": Base, "Slotted": Slotted}
    exec(f"def mine(me):\n    yield me.sleep(0.001)\n    {line}", names)
    with pytest.raises(TypeError) as refused:
        desim.run(SHORT.with_({"protocol": names["mine"]}))
    assert [note.partition(",")[0] for note in refused.value.__notes__] == ["(pursuer 0"]


class Key:
    """A key of a dict, as people write it."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Key)

    def __hash__(self) -> int:
        return hash(("a", 3))


OUTSIDE: dict[str, Any] = {
    "sleep": time.sleep,
    "clock": time.time,
    "datetime": datetime,
    "np": np,
    "rng": random.Random,
}


@pytest.mark.parametrize(
    "line",
    [
        "import time; time.sleep(0.0)",
        "sleep(0.0)",
        "me.assign(int(clock() > 0))",
        "from time import monotonic as tell; tell()",
        "datetime.datetime.now()",
        "(lambda: datetime.date.today())()",
        "import time; time.localtime().tm_sec",
        "from time import ctime; ctime()",
    ],
)
def test_a_protocol_that_waits_for_the_clock_of_the_computer_is_warned_of(line):
    names = dict(OUTSIDE)
    exec(f"def mine(me):\n    yield me.sleep(0.001)\n    {line}", names)
    with pytest.warns(StateWarning, match="the clock of the computer is not the one of the simulation"):
        desim.run(SHORT.with_({"protocol": names["mine"]}))


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("np.random.default_rng().random()", r"numpy\.random\.default_rng\(\)"),
        ("rng().random()", r"random\.Random\(\)"),
        ("import secrets; secrets.randbelow(3)", r"secrets\.randbelow"),
        ("from uuid import uuid4; uuid4()", r"uuid\.uuid4"),
        ("import os; os.urandom(2)", r"os\.urandom"),
        ("[np.random.default_rng().random() for _ in range(2)]", r"numpy\.random\.default_rng\(\)"),
    ],
)
def test_random_numbers_without_the_seed_are_warned_of(line, name):
    names = dict(OUTSIDE)
    exec(f"def mine(me):\n    yield me.sleep(0.001)\n    {line}", names)
    with pytest.warns(StateWarning, match=f"^{name}: these random numbers do not follow from the seed"):
        desim.run(SHORT.with_({"protocol": names["mine"]}))


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("import os; os.environ.get('SPEED')", r"os\.environ"),
        ("from os import environ; environ['HOME']", r"os\.environ"),
        ("import os; 'A' in os.environ", r"os\.environ"),
        ("from os import getenv as tell; tell('A')", r"os\.getenv"),
        ("import sys; len(sys.argv)", r"sys\.argv"),
        ("import socket; socket.gethostname()", r"socket\.gethostname"),
        ("hash('uav')", r"hash\(\)"),
        ("max(['a', 'b'], key=hash)", r"hash\(\)"),
        ("(lambda: [hash(name) for name in 'ab'])()", r"hash\(\)"),
    ],
)
def test_what_differs_from_process_to_process_is_warned_of(line, name):
    names = dict(OUTSIDE)
    exec(f"def mine(me):\n    yield me.sleep(0.001)\n    {line}", names)
    with pytest.warns(StateWarning, match=f"^{name}: what a process has is no part of the scenario"):
        desim.run(SHORT.with_({"protocol": names["mine"]}))


@pytest.mark.parametrize(
    "line",
    [
        "import os; os.path.join('a', 'b')",
        "import os; os.getpid()",  # for a log
        "import sys; sys.version_info >= (3, 12)",
        "hash = len; hash('uav')",
        "me.hash = 3",
        "{Key(): 1}[Key()]",
        "np.random.default_rng(me.id).random()",
        "rng(7).random()",
        "import time; time.perf_counter()",
        "import time; time.gmtime(me.now)",
        "datetime.datetime(2024, 5, 17)",
        "me.sleep(0.0)",
        "import uuid; uuid.UUID(int=3)",
    ],
)
def test_what_is_the_same_in_each_run_and_measured_durations_are_not_warned_of(line):
    names = OUTSIDE | {"Key": Key}
    exec(f"def mine(me):\n    yield me.sleep(0.001)\n    {line}", names)
    desim.run(SHORT.with_({"protocol": names["mine"]}))


def test_an_attribute_that_fails_inside_is_not_said_to_be_missing():
    class Own(Result):
        @property
        def gain(self) -> float:
            return float(self.trace.no_such)  # type: ignore[attr-defined]

    result = desim.run(SHORT)
    with pytest.raises(AttributeError, match="no_such"):
        Own(result.scenario, result.seed, result.trace).gain  # noqa: B018


FILES: dict[str, tuple[str, ...]] = {
    "[team]\ncout = 3": ("f.toml:2: team.cout: unknown key, did you mean 'count'?",),
    "[netwrok]\nlatency = 0.1": ("f.toml:1: netwrok: unknown key, did you mean 'network'?",),
    "network.latency = '0.1'": ("f.toml:1: network.latency: should be a number: 0.1 instead of the text '0.1'",),
    "network.latency = '100ms'": ("f.toml:1: network.latency: should be a number, in s: 0.1",),
    "network.latency = '100 ms'": ("should be a number, in s: 0.1",),
    "network.loss = 5": ("network.loss.p: should be less than or equal to 1",),
    "protocol.kind = 'SAP'": ("f.toml:1: protocol.kind: there is no 'SAP', did you mean 'sap'?",),
    "protocol = 'Auction'": ("did you mean 'cbaa' or 'cbba'?",),
    "team.count = 8.0": ("team.count: should be an integer", "got 8.0"),
    "network.latency = { kind = 'gamma', mean = 0.1 }": ("mean",),
    "network.latency = { kind = 'lognormal', std = 0.1 }": ("std: unknown key, did you mean 'cv'?",),
    "name = 'x": ("f.toml:1: not TOML: a text is not closed by a quote (opened in column 8)",),
    "seed 3": ("f.toml:1: not TOML: Expected '='", "column 6"),
    "horizon = '30 s'": ("horizon: should be a number, in s: 30",),
    "network.range = 'inf'": ("network.range: should be inf without quotes instead of the text 'inf'",),
    "[sweep]\ngrid = [1, 2]": ("sweep.grid: should be a table",),
    "[sweep.grid]\n'team.count' = 3": ("f.toml:2: sweep.grid.team.count: should be a list",),
    "[sweep.grid]\n'network.latency.value' = '0:1:0'": ("step should lead from 0 to 1",),
    "protocol = 'mine:rule'": ("'mine:rule' names code to be run; ", "--allow-import"),
    "seed = -1": ("f.toml:1: seed: should be greater than or equal to 0",),
    "team.count = true": ("team.count: should be an integer", "got true"),
    "[[fault]]\nkind = 'crash'\nnode = 25\nstart = 1.0": ("fault.0.node: there is no pursuer 25",),
    "team.speeds = [1.0, 2.0]": ("one per pursuer",),
    "horizon = -1\nsed = 3\n[team]\ncout = 3": ("f.toml:1: horizon", "f.toml:2: sed", "f.toml:4: team.cout"),
    "motion = 3": ("f.toml:1: motion: should be a table",),
    "evader.strategy = 'pure-evasion'": ("did you mean 'pure_evasion'?",),
    "[team]\ncount: 12": ("f.toml:2: not TOML: between a key and its value is =: count = 12",),
    "[[team]]\ncount = 3": ("headed by [team] instead of [[team]]",),
    "[fault]\nkind = 'crash'\nnode = 1\nstart = 1.0": ("headed by [[fault]] instead of [fault]",),
    "[team]\ncount = 3\n[team]\nbox = [0.0, 1.0]": ("f.toml:3", "Cannot declare [team] twice: a table has one head"),
    "record.messages = True": ("record.messages should be true instead of True",),
    "network.range = None": ("network.range has no value", "leave the key out"),
    "network.range = Infinity": ("should be inf instead of Infinity",),
    "network.loss = 10%": ("network.loss should be a number from 0 to 1: 0.1 instead of '10%'",),
    "network.latency = 50ms # late": ("network.latency should be a number, in s: 0.05 instead of '50ms'",),
    "network.latency = { kind = 'lognormal', mean = 50 ms }": ("mean should be a number, in s: 0.05",),
    "network.latency = 0,5": ("should be a number: 0.5 instead of '0,5'",),
    "network.loss = 0.1;": ("nothing follows the value: network.loss = 0.1",),
    "network.loss = 0.1; # a share": ("nothing follows the value: network.loss = 0.1",),
    "protocol = sap": ('a text is in quotes: protocol = "sap"',),
    "network.latency = { kind = lognormal }": ('a text is in quotes: kind = "lognormal"',),
    "// late": ("a comment begins with #",),
    "{'horizon': 3}": ("this looks like JSON",),
}


@pytest.mark.parametrize("text", FILES)
def test_a_wrong_file_says_where_and_why(text, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("f.toml").write_text(text)
    done = CliRunner().invoke(main, ["check", "f.toml"])
    assert done.exit_code == 2
    for part in FILES[text]:
        assert part in done.stderr


COMMANDS: dict[str, tuple[str, ...]] = {
    "rnu f.toml": ("Did you mean",),
    "draw f.toml": ("Did you mean 'desim plot'?",),
    "run relay": ("desim examples relay",),
    "run relay.toml": ("desim examples relay",),
    "run .": (": cannot be read: Is a directory; a file in it is f.toml",),
    "run f": ("did you mean f.toml?",),
    "run g.toml": ("did you mean 'f.toml'?",),
    "run x.yaml": ("scenario files are TOML; convert it: python -c",),
    "run x.json": ("scenario files are TOML; convert it: python -c",),
    "run f.toml --seed -1": ("-1",),
    "run f.toml -n 0": ("0",),
    "run f.toml --set latency=0.3": ("did you mean network.latency?",),
    "run f.toml --set network.latency=100ms": (
        "--set network.latency=100ms: network.latency: should be a number, in s: 0.1",
    ),
    "run f.toml --set network.latency.value": ("KEY=VALUE",),
    "run f.toml --metric activetime": ("did you mean 'active_time'?",),
    "sweep f.toml": ("should have at least one key of the scenario",),
    "sweep f.toml -g protocol.kind=sap,cbbba": ("there is no 'cbbba', did you mean 'cbba'?",),
    "sweep f.toml -g team.count=1:5:0 --dry-run": ("the range 1:5:0 has no end",),
    "sweep f.toml -g team.count=2,3 --against team.count=4": (
        "--against: team.count does not take the value 4: it takes 2, 3",
    ),
    "sweep f.toml -g team.count=2,3 --against team.cout=2": ("did you mean team.count?",),
    "sweep f.toml -g team.count=2,3 --against 3": ("'3' should be KEY=VALUE, protocol.kind=sap for instance",),
    "plot f.toml -o foo.jpg": (".svg",),
    "plot f.toml --kind phase": ("desim sweep f.toml -o DIR",),
    "report f.toml": ("is a scenario file", "desim sweep f.toml -o DIR"),
    "protocols sapp": ("did you mean 'sap'?",),
    "protocols SAP": ("did you mean 'sap'?",),
    "keys latency": ("network.latency",),
    "keys network.latncy": ("latency",),
    "examples realy": ("did you mean 'relay'?",),
    "run": ("desim examples relay",),
    "f.toml": ("type: desim run f.toml",),
    "mine.py": ("python mine.py",),
    "run f.py": ("is Python, not a scenario file: python f.py runs it, and the scenario beside it is f.toml",),
    "help run": ("Did you mean 'desim --help'?",),
    "gif f.toml": ("desim plot FILE --kind film",),
    "run f.toml -n ten": ("'ten' should be a whole number from 1 to 1,000,000; Number of runs",),
    "run f.toml -s 1-10": ("'1-10' should be a whole number of at least 0",),
    "sweep f.toml -j all": ("'all' should be a whole number of at least 0", "0 = one per core"),
    "run f.toml --latency 0.2": ("is set by --set network.latency=VALUE",),
    "run f.toml --delay 0.2": ("is set by --set network.latency=VALUE",),
    "run f.toml --protocol cbba": ("is set by --set protocol=VALUE",),
    "sweep f.toml --seeds 5": ("Did you mean '-n'?",),
    "replay f.toml --seeds 5": ("Did you mean '--seed'?",),
    "sweep f.toml -g network.latency.value=0..1": ("a range in a grid is written FIRST:LAST:STEP",),
    "run f.toml --set protocol=mine.py": ("write 'mine:NAME' for what mine.py defines",),
    "run f.toml --workers 5": ("Did you mean '-j'?",),
    "plot f.toml --kind trajectry": ("Did you mean 'trajectory'?",),
    "new protocl mine": ("Did you mean 'protocol'?",),
    "run f.toml -g team.count=2,3": ("No such option '-g'. It is an option of sweep, race",),
    "explain f.toml --against team.count=2": ("It is an option of sweep, plot, report.",),
    "explain f.toml -y regret": ("Did you mean '--metric'?",),
    "compare f.toml f.toml --metric regret": ("Did you mean '-y'?",),
    "play f.toml --port 80": ("There are --no-browser, --timeout",),
    "-s 3 run f.toml": ("Options follow the command: desim run ... -s",),
    "run f.toml --timeout 200ms": ("--timeout': '200ms' should be a number, in s: 0.2.",),
    "run f.toml -help": ("No such option '-help'. Did you mean '--help'?",),
    "run f.toml -seed 3": ("No such option '-seed'. Did you mean '--seed'?",),
    "run f.toml -o ''": ("The value of -o is empty. Is a variable of the shell not set?",),
    "run f.toml --out=": ("The value of --out is empty.",),
    "run f.toml -o": ("-o PATH: Folder for the trace",),
    "run f.toml f.toml": ("(f.toml): ",),
    "schema f.toml": (" takes options only",),
    "run f.toml --set fault=[kind=3 node=4": ('is in quotes: --set \'fault=[{kind = "crash"',),
    "run f.toml --set fault.0.kind=crash": ("the list fault is empty: set it as a whole, 'fault=[{ kind",),
    "run f.toml --set wall=[[0,0],[5,5]]": ("wall.0: should be a table",),
    "run f.toml -o f.toml": ("--out f.toml: cannot be written: is a file, and should be a folder",),
    "sweep f.toml -g team.count=2,3 -o f.toml": ("f.toml: File exists: a file, where --out should name a folder",),
    "sweep f.toml -g team.count= --dry-run": ("values are separated by commas, 0,0.1 for instance",),
    "sweep f.toml -g team.count=2,3 --until regret": ("'regret' should be METRIC:HALFWIDTH, active_time:0.1 for",),
    "check": ("needs FILE: a scenario file; `desim examples relay` writes relay.toml",),
    "compare out": ("needs B: the folder of a sweep",),
    "merge out": ("needs -o PATH: Folder of the merged store.",),
    "race f.toml -g team.count=2,3": ("needs --zone FLOAT: The smallest difference of means that matters",),
    "race f.toml -g team.count=2,3 --zone x": ("'x' should be a number; The smallest difference",),
    "plot f.toml --kind film --fps 0": ("0 should be a whole number from 1 to 50; Frames per second",),
    "plot f.toml --kind spacetime --from 9": ("--from, --to: the window from 9 s to its end is empty",),
    "plot f.toml --kind spacetime --pursuers 99": ("--pursuers: there is no pursuer 99: they are 0 ..",),
    "plot f.toml --label sap": ("'sap' should be VALUE=TEXT, sap=",),
    "crossover out team.count sap cbba": ("'sap' should be KEY=VALUE, protocol.kind=sap for instance",),
    "report nothing": ("there is no such store; `desim sweep FILE -o DIR` makes one",),
    "status f.toml": ("is no folder: give the one of `desim submit`",),
    "run --from f.toml": ("a scenario file is run without --from: desim run f.toml",),
    "fates f.toml f.py": ("the log comes first: desim fates f.py f.toml",),
    "submit f.toml --array 2 --time tomorrow": ("minutes, HOURS:MINUTES:SECONDS or DAYS-HOURS",),
    "submit f.toml --array 2 --memory lots": ("500M or 2G for instance",),
    "keys f.toml": ("is a file: `desim check f.toml` prints it",),
    "plot one/trac.jsonl": ("one/trac.jsonl: cannot be read: No such file or directory, did you mean 'trace.jsonl'?",),
    "play one/trac.jsonl": ("did you mean 'trace.jsonl'?",),
    "run one/run.json": ("their scenario is one/scenario.toml; `desim run --from one/run.json` repeats the run",),
    "plot one/summary.json": ("belongs to the results in the folder one, and is no scenario", "`desim plot one` draws"),
    "check swept/run.json": (
        "swept/run.json: belongs to the results in the folder swept, and is no scenario; `desim plot",
    ),
    "version": ("Did you mean 'desim --version'?",),
    "new protocol class": ("'class' is a word of Python itself", "my_class"),
    "new protocol my-rule": ("my_rule for instance",),
    "metrics activ": ("did you mean 'active_time'?",),
    "compare f.toml f.toml": ("`desim sweep f.toml -o DIR`",),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_wrong_command_says_what_to_type(command, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("f.toml").write_text("horizon = 0.01\n")
    Path("x.yaml").write_text("horizon: 3\n")
    Path("x.json").write_text('{"horizon": 3}')
    Path("f.py").write_text("print(3)\n")
    if "one/" in command:
        Path("one").mkdir()
        for name in ("trace.jsonl", "run.json", "summary.json", "scenario.toml"):
            Path("one", name).write_text("{}")
    if "swept/" in command:
        Path("swept").mkdir()
        for name in ("sweep.sqlite", "run.json"):
            Path("swept", name).write_text("{}")
    done = CliRunner().invoke(main, [word.replace("''", "") for word in command.split()])
    assert done.exit_code == 2
    for part in COMMANDS[command]:
        assert part in done.stderr
    assert {path.name for path in tmp_path.iterdir()} - {"one", "swept"} == {"f.py", "f.toml", "x.yaml", "x.json"}


def test_a_traceback_of_a_wrong_call_is_short():
    with pytest.raises(KeyedError) as refused:
        Team(cout=8)
    assert len(refused.traceback) == 2
    assert refused.value.__cause__ is None


def test_a_model_of_a_user_is_told_as_a_built_in_one_is():
    class Own(Constant):
        gain: float = 1.0

    with pytest.raises(KeyedError, match="Own: gian: unknown key, did you mean 'gain'"):
        Own(gian=2.0)


def test_tab_completion_shows_none_of_the_deprecated_methods_of_pydantic():
    for shown in (dir(SHORT), dir(Scenario), dir(Gamma()), dir(Lognormal)):
        assert not {"copy", "dict", "json", "parse_obj", "from_orm", "schema"} & set(shown)
        assert {"model_copy", "model_dump"} <= set(shown)


def test_a_file_that_is_valid_is_said_to_be(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("f.toml").write_text("horizon = 3.0\n")
    done = CliRunner().invoke(main, ["check", "f.toml"])
    assert done.stderr == "f.toml is valid\n"
    Path("all.toml").write_text(done.stdout)
    assert load("all.toml") == load("f.toml")

"""A warning names the line of the program that called, however deep in desim it is given."""

import inspect
import warnings
from _thread import start_new_thread
from pathlib import Path
from threading import Event

import networkx as nx
import numpy as np
import pytest

import desim
from desim import Links, SteppedNetwork, SteppedNetworks
from desim.config.caller_warnings import warn_caller
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Scenario


def unseeded(state, rng):
    return complex(np.random.default_rng().random())


DRAWING = Scenario(team=Team(count=2), horizon=0.05, evader=Evader(strategy=unseeded))
LATE = {"latency": 20.0}
CALLS = {
    "a latency in ms": lambda: SteppedNetwork(2, Links(**LATE)),
    "a latency in ms of an edge": lambda: SteppedNetwork(nx.Graph([("a", "b", {"latency": 20.0})])),
    "a latency in ms of several networks": lambda: SteppedNetworks(2, 2, Links(**LATE)),
    "an attribute that is not read": lambda: SteppedNetwork(nx.Graph([("a", "b", {"delay": 0.1})])),
    "an attribute of a graph of links": lambda: Links(graph=nx.Graph([(0, 1, {"delay": 0.1})])),
    "a model with its own draws": lambda: desim.run(DRAWING, 1),
    "a model with its own draws, in a sweep": lambda: desim.sweep(DRAWING, {"horizon": [0.05]}, reps=1),
    "a model of a latency": lambda: desim.testing.check_latency(desim.Constant(value=20.0), draws=200),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_warning_is_at_the_line_of_the_program(name):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        CALLS[name]()
    line = inspect.getsourcelines(CALLS[name])[1]
    assert {(warning.filename, warning.lineno) for warning in caught} == {(__file__, line)}


FILES = {
    "edges.csv": ("src,dst,delay\n0,1,0.1\n1,2,0.1\n", lambda file: Links(graph={"kind": "edges", "file": file})),
    "one_way.json": (
        '{"directed": true, "nodes": [{"id": 0}, {"id": 1}, {"id": 2}],'
        ' "links": [{"source": 0, "target": 1}, {"source": 1, "target": 2}]}',
        lambda file: desim.Edges(file=file),
    ),
    "reception.csv": ("t,prr\n0,0.9\n1,0.8\n", lambda file: desim.LossTrace(file=file, value="prr")),
    "signal.csv": ("t,rssi_dbm\n0,-60\n1,99\n", lambda file: desim.SignalTrace(file=file, value="rssi_dbm")),
    "motion.csv": ("t,x,y,z\n0,0,0,5\n1,1,1,5\n", lambda file: desim.RecordedMotion(file=file)),
    "starts.csv": ("x,y,z\n0,0,5\n1,1,5\n", lambda file: Team(count=2, positions={"kind": "recorded", "file": file})),
}
"""Contents of files that are probably not meant as they are read, and how a program gives them to a model."""


@pytest.mark.parametrize("name", FILES)
def test_how_a_file_is_read_is_told_to_the_program_once(name, tmp_path):
    """A scenario file that names the file is told of by all commands; what is made of the model has been told."""
    text, read = FILES[name]
    (tmp_path / name).write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = read(str(tmp_path / name))
        model.model_copy(update={})
    (warning,) = caught
    assert (warning.filename, name in str(warning.message)) == (__file__, True)


def test_a_file_that_a_program_names_by_a_key_is_told_once_and_one_of_a_scenario_file_by_the_commands(tmp_path):
    """The program gives it to `with_` or to the grid of a sweep; later changes of the scenario do not tell it again."""
    (tmp_path / "edges.csv").write_text("src,dst,delay\n0,1,0.1\n")
    (tmp_path / "named.toml").write_text("team.count = 2\nnetwork.graph = {kind = 'edges', file = 'edges.csv'}\n")
    table = {"kind": "edges", "file": str(tmp_path / "edges.csv")}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        desim.load(tmp_path / "named.toml").with_({"horizon": 1.0})
        assert not caught
        made = DRAWING.with_({"network.graph": table, "evader": Evader()})
        assert len(caught) == 1
        made.with_({"horizon": 0.1})
        assert len(caught) == 1
        desim.sweep(DRAWING.with_({"evader": Evader()}), {"network.graph": [{"kind": "complete"}, table]}, reps=1)
    assert [(warning.filename, "delay" in str(warning.message)) for warning in caught] == [(__file__, True)] * 2


def test_a_file_that_is_read_as_it_is_meant_is_not_told_of(tmp_path):
    """Or that is read as the program says."""
    (tmp_path / "prr.csv").write_text("t,prr\n0,0.9\n1,0.8\n")
    assert desim.LossTrace(file=str(tmp_path / "prr.csv"), value="prr", received=True)  # a warning is an error


def test_a_warning_without_a_program_names_no_line_of_desim():
    """All frames of the thread are of desim; the control adds one that is not."""
    code = compile("def give(warn, done):\n    warn('text')\n    done()\n", "inside.py", "exec")
    names: dict[str, object] = {"__name__": "desim.inside"}
    exec(code, names)
    done = Event()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        start_new_thread(names["give"], (warn_caller, done.set))
        assert done.wait(10.0)
        names["give"](warn_caller, done.set)
    alone, called = [Path(warning.filename) for warning in caught]
    assert alone.name.strip("<>") == "sys"
    assert called == Path(__file__)

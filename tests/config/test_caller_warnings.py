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

"""Models of users have parameters of any type, which records, hashes, names and comparisons of scenarios can hold."""

import json
import tomllib
from collections import deque
from dataclasses import dataclass
from datetime import datetime, timedelta
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from functools import partial
from pathlib import PurePosixPath
from types import MappingProxyType
from typing import Any, NamedTuple

import attrs
import networkx as nx
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pydantic import BaseModel

from desim import Links, Lognormal, Scenario, Team
from desim.config.model import Value
from desim.config.parameters import are_equal, in_json, is_named_only, sorted_sets
from desim.results.provenance import document
from desim.scenario.overrides import Source
from desim.scenario.toml import brief, dump
from desim.study.plan.config_hash import identify
from desim.study.plan.configurations import configurations, label


class Mood(Enum):
    CALM = "calm"
    WILD = "wild"


class Opaque:
    def __init__(self, a):
        self.a = a


class Called:
    def __call__(self, context, rng):
        return 0.1


@dataclass
class Of(Called):
    w: Any


@dataclass(frozen=True)
class Frozen(Called):
    w: Any


@attrs.define
class Attrs(Called):
    w: Any


class Named(NamedTuple):
    w: Any

    def __call__(self, context, rng):
        return 0.1


class Model(Value):
    w: Any

    def __call__(self, context, rng):
        return 0.1


class Derived(Lognormal):
    w: Any = None

    def __call__(self, context, rng):
        return 0.1


class Pydantic(BaseModel):
    model_config = {"arbitrary_types_allowed": True}
    w: Any

    def __call__(self, context, rng):
        return 0.1


def first(context, rng):
    return 0.1


def second(context, rng, w=None):
    return 0.2


@dataclass(frozen=True)
class Part:
    w: Any


class Row(NamedTuple):
    w: Any


class Table(BaseModel):
    w: Any


LETTERS = "abcdefghij"


class Group(Enum):
    ALL = frozenset(LETTERS)
    ONE = frozenset("a")


PARAMETERS = {
    "int": (1, 2, 1, "1"),
    "np.float32": (np.float32(0.5), np.float32(0.25), 0.5, "0.5"),
    "np.int64": (np.int64(3), np.int64(4), 3, "3"),
    "array": (np.arange(3), np.arange(3) + 1, [0, 1, 2], "[0, 1, 2]"),
    "array without dimensions": (np.array(3.5), np.array(4.5), 3.5, "3.5"),
    "complex array": (np.array([1j]), np.array([2j]), ["1j"], "[1j]"),
    "list of arrays": ([np.arange(2)], [np.arange(3)], [[0, 1]], "[[0, 1]]"),
    "dict of an array": ({"a": np.arange(2)}, {"a": np.arange(3)}, {"a": [0, 1]}, "(a=[0, 1])"),
    "array of objects": (np.array([1, "a"], object), np.array([1, "b"], object), [1, "a"], "[1, a]"),
    "series": (pd.Series([1.5, 2.5]), pd.Series([1.5, 3.5]), [1.5, 2.5], "[1.5, 2.5]"),
    "table": (pd.DataFrame({"a": [1]}), pd.DataFrame({"a": [2]}), {"a": [1]}, "(a=[1])"),
    "names of columns": (pd.DataFrame({"a": [1]}), pd.DataFrame({"b": [1]}), {"a": [1]}, "(a=[1])"),
    "columns of one name": (
        pd.DataFrame([[1, 2]], columns=["a", "a"]),
        pd.DataFrame([[1, 3]], columns=["a", "a"]),
        [["a", [1]], ["a", [2]]],
        "[[a, [1]], [a, [2]]]",
    ),
    "labels of rows": (
        pd.DataFrame({"a": [1, 2]}, index=["p", "q"]),
        pd.DataFrame({"a": [1, 2]}, index=["p", "r"]),
        {"index": ["p", "q"], "a": [1, 2]},
        "(index=[p, q], a=[1, 2])",
    ),
    "labels of a series": (
        pd.Series([1.5, 2.5], index=[1, 0]),
        pd.Series([1.5, 2.5]),
        {"index": [1, 0], "0": [1.5, 2.5]},
        "(index=[1, 0], 0=[1.5, 2.5])",
    ),
    "table of Arrow": (pa.table({"a": [1]}), pa.table({"b": [1]}), {"a": [1]}, "(a=[1])"),
    "structured array": (np.array([(1,)], [("a", int)]), np.array([(1,)], [("b", int)]), {"a": [1]}, "(a=[1])"),
    "range": (range(2), range(3), [0, 1], "[0, 1]"),
    "deque": (deque([1]), deque([2]), [1], "[1]"),
    "set": ({"b", "a", "c"}, {"b"}, ["a", "b", "c"], "[a, b, c]"),
    "frozen set": (frozenset({"b", "a"}), frozenset({"b"}), ["a", "b"], "[a, b]"),
    "set in a dataclass": (Part({*LETTERS}), Part({"b"}), {"w": [*LETTERS]}, f"Part(w=[{', '.join(LETTERS)}])"),
    "set in a row": ([Row({*LETTERS})], [Row({"b"})], [[[*LETTERS]]], f"[[[{', '.join(LETTERS)}]]]"),
    "set in a model": (
        [Table(w={*LETTERS})],
        [Table(w={"b"})],
        [{"w": [*LETTERS]}],
        f"[Table(w=[{', '.join(LETTERS)}])]",
    ),
    "set in a mapping": (
        MappingProxyType({"a": {*LETTERS}}),
        MappingProxyType({}),
        {"a": [*LETTERS]},
        f"(a=[{', '.join(LETTERS)}])",
    ),
    "sets as keys": (
        {frozenset(LETTERS): 1},
        {frozenset("b"): 1},
        {json.dumps([*LETTERS]): 1},
        f"({json.dumps([*LETTERS])}=1)",
    ),
    "dataclasses as keys": ({Part(1): 1}, {Part(2): 1}, {'{"w": 1}': 1}, '({"w": 1}=1)'),
    "set of dataclasses": ({Part(2), Part(1)}, {Part(2)}, [{"w": 1}, {"w": 2}], "[(w=1), (w=2)]"),
    "set in a key": (
        {(0, frozenset(LETTERS)): 1},
        {},
        {json.dumps([0, [*LETTERS]]): 1},
        f"({json.dumps([0, [*LETTERS]])}=1)",
    ),
    "set in a deque": (deque([{*LETTERS}]), deque([{"b"}]), [[*LETTERS]], f"[[{', '.join(LETTERS)}]]"),
    "set in an array": (
        np.array([{*LETTERS}, 1], object),
        np.array([{"b"}, 1], object),
        [[*LETTERS], 1],
        f"[[{', '.join(LETTERS)}], 1]",
    ),
    "set in a series": (pd.Series([{*LETTERS}]), pd.Series([{"b"}]), [[*LETTERS]], f"[[{', '.join(LETTERS)}]]"),
    "set in an enumeration": (Group.ALL, Group.ONE, [*LETTERS], f"[{', '.join(LETTERS)}]"),
    "mapping": (MappingProxyType({"a": 1}), MappingProxyType({"a": 2}), {"a": 1}, "(a=1)"),
    "keys that are no texts": ({(0, 1): 0.5}, {(0, 1): 1.5}, {"0,1": 0.5}, "((0, 1)=0.5)"),
    "path": (PurePosixPath("a"), PurePosixPath("b"), "a", "a"),
    "date": (datetime(2024, 5, 6), datetime(2025, 5, 6), "2024-05-06T00:00:00", "2024-05-06T00:00:00"),
    "np.datetime64": (np.datetime64("2024-05"), np.datetime64("2024-06"), "2024-05", "2024-05"),
    "duration": (timedelta(seconds=1), timedelta(seconds=2), "PT1S", "PT1S"),
    "decimal": (Decimal("0.5"), Decimal("1.5"), "0.5", "0.5"),
    "fraction": (Fraction(1, 3), Fraction(2, 3), "1/3", "1/3"),
    "enumeration": (Mood.CALM, Mood.WILD, "calm", "calm"),
    "complex": (1j, 2j, "1j", "1j"),
    "bytes": (b"\xff", b"\xfe", "ff", "ff"),
    "model": (Lognormal(mean=0.5), Lognormal(mean=1.5), None, "lognormal(mean=0.5)"),
    "dataclass": (Of(1), Of(2), None, "Of(w=1)"),
}
"""By name: two values of a parameter, and of the first what stands for it in JSON and in a name."""
NAMED = {
    "function": (first, second, "tests.config.test_parameters:first"),
    "function of Python": (len, abs, "builtins:len"),
    "object that is called": (Called(), Of(Called()), "tests.config.test_parameters:Called"),
    "class": (Of, Frozen, "tests.config.test_parameters:Of"),
    "object": (Opaque(1), Opaque(2), "tests.config.test_parameters:Opaque"),
    "graph": (nx.path_graph(2), nx.path_graph(3), "networkx.classes.graph:Graph"),
}
"""By name: two values of a parameter of which JSON has a name only."""
KINDS = [Of, Frozen, Attrs, Named, Model, Derived, Pydantic]


def scenario(latency):
    return Scenario(team=Team(count=2), network=Links(latency=latency))


@pytest.mark.slow_but_one
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("name", [*PARAMETERS, *NAMED])
def test_a_scenario_whose_model_has_a_parameter_of_any_type_is_recorded_hashed_and_compared(kind, name):
    value, other, expected, *_ = {**PARAMETERS, **NAMED}[name]
    one, two = scenario(kind(w=value)), scenario(kind(w=other))
    recorded = json.loads(one.model_dump_json())["network"]["latency"]
    written = tomllib.loads(dump(one))["network"]["latency"]
    brief(one), repr(one)
    assert identify(one).key != identify(two).key
    assert one == scenario(kind(w=value))
    assert one != two
    assert one.with_({"horizon": 2.0}).network == one.network
    if kind is Named:  # its class is no model with fields
        return
    assert document("run", one, seed=0)["unrecorded"] == (["network.latency.w"] if name in NAMED else [])
    if expected is not None:
        assert recorded["w"] == ({"kind": expected} if name in NAMED else expected)
    if name not in {"date", "decimal", "keys that are no texts"}:  # TOML has dates, and other texts for tuples
        assert written["w"] == recorded["w"]


@pytest.mark.parametrize("name", PARAMETERS)
def test_configurations_are_named_by_parameters_of_any_type(name):
    value, other, _, text = PARAMETERS[name]
    models = [Of(value), Of(other), Attrs(value), Attrs(other), partial(second, w=value), partial(second, w=other)]
    assert [label(model) for model in models[::2]] == [f"Of(w={text})", f"Attrs(w={text})", f"second(w={text})"]
    assert len(configurations(Source.of(scenario(0.1)), {"network.latency": models})) == len(models)


def test_long_parameters_are_named_by_their_hash():
    names = {label(Of(np.arange(1000) + k)) for k in (0, 1)}
    assert len(names) == 2
    assert all(name.startswith("Of(w=ndarray with the hash ") for name in names)


def test_a_missing_value_in_a_grid_is_refused_with_its_key():
    with pytest.raises(ValueError, match=r"network.loss: should be a table with a kind"):
        configurations(Source.of(scenario(0.1)), {"network.loss": pd.array([0.1, None], dtype="Float64")})


def test_values_that_cannot_tell_whether_they_are_equal_are_compared_by_their_content():
    assert are_equal(np.arange(2), np.arange(2))
    assert not are_equal(np.arange(2), np.arange(3))
    assert not are_equal(np.arange(2), None)
    assert not are_equal(pd.NA, 1.0)
    assert not are_equal([np.arange(2), Opaque(1)], [np.arange(2), Opaque(1)])
    assert are_equal(3, 3.0)
    assert Derived(w=np.arange(2)) != Model(w=np.arange(2))


def test_what_stands_for_an_object_has_no_address():
    assert in_json(Opaque(1)) == {"kind": "tests.config.test_parameters:Opaque"}
    assert is_named_only([1, {"a": Opaque(1)}])
    assert not is_named_only([1, {"a": np.arange(2)}])
    assert sorted_sets({"a": ({3, 1, 2},)}) == {"a": ([1, 2, 3],)}


def test_an_iterator_is_not_read_to_record_it():
    """A run would find it at its end."""
    for iterator in (iter([1, 2]), (number for number in (1, 2))):
        assert is_named_only(iterator)
        assert sorted_sets({"w": iterator})["w"].keys() == {"kind"}
        assert [*iterator] == [1, 2]


def test_a_missing_date_of_pandas_is_recorded():
    """It is equal to nothing, also not to itself."""
    given, recorded = scenario(Of(pd.NaT)), {"kind": "tests.config.test_parameters:Of", "w": "NaT"}
    assert json.loads(given.model_dump_json())["network"]["latency"] == recorded
    assert tomllib.loads(dump(given))["network"]["latency"] == recorded
    assert identify(given).key != identify(scenario(Of(pd.Timestamp(2024, 5, 6)))).key
    assert label(Of(pd.NaT)) == "Of(w=NaT)"

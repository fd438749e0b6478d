"""Numbers and lists of numpy, pandas and others mean what those of Python mean, in every field of every model."""

import array
import enum
import re
from collections import UserList, deque, namedtuple
from contextlib import suppress
from decimal import Decimal
from fractions import Fraction
from itertools import chain, count, cycle, repeat
from math import inf, isnan
from types import SimpleNamespace, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import networkx as nx
import numpy as np
import pandas as pd
import pytest
from pydantic import ConfigDict, Field
from pydantic.fields import FieldInfo
from scipy import sparse

from desim.config.choice import choices_of
from desim.config.errors import KeyedError
from desim.config.model import Value
from desim.config.python_numbers import as_python, real, whole
from desim.kernel.models.faults import Partition
from desim.kernel.models.latency import Empirical
from desim.kernel.models.latency_by_link import LatencyMatrix
from desim.kernel.models.netem import Netem
from desim.kernel.models.traced_faults import CustomFault
from desim.pursuit.evaders.recorded import RecordedMotion
from desim.pursuit.motion.flow import RecordedFlow
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Scenario
from desim.scenario.sweep_table import Sweep
from protocols.policy import Layer
from tests.models import MODELS, made

COUNTED = (0, 1, 2, 7, 8)
"""Whole numbers that every integer type of numpy represents, and of which each integer field takes one."""
MEASURED = (0.0, 0.5, 1.0, 2.5, 8.0)
"""Numbers that every float type of numpy represents, and of which each number field takes one."""
LISTS: tuple[list[Any], ...] = ([0, 1], [7, 8], [0.5, 2.5], [0.0, 1.0])
ROWS: tuple[list[Any], ...] = ([[0, 1], [2, 3]], [[0.5, 1.0], [1.0, 2.0]], [[0.0, 1.0, 2.0], [1.0, 2.0, 2.5]])
WRONG = (True, "1", "a", [True, False], ["1", "2"], [[True, False]], -1, -0.5, [-1, -2], [])
"""Values that no number field, or not every one, takes: strict types stay strict."""
INTEGERS = (np.int8, np.int16, np.int32, np.int64, np.intp)
UNSIGNED = (np.uint8, np.uint16, np.uint32, np.uint64)
FLOATS = (np.float16, np.float32, np.float64, np.longdouble)


ALONE_WRONG = {
    *(
        "bias",
        "chaser",
        "dimensions",
        "duplicate",
        "duty_cycle",
        "frequencies",
        "frequency",
        "gateways",
        "line",
        "noise",
        "polygon",
        "share",
        "spreading_factors",
        "table",
        "weights",
    )
}
"""Fields that are right with others only, or take none of these values, so that only refusals are compared."""


def forms_of(value: Any) -> list[Any]:
    """Return objects of others that mean the same as a value of Python."""
    if isinstance(value, bool):
        return [np.bool_(value), np.array(value)]
    if isinstance(value, int):
        types = INTEGERS + (UNSIGNED if value >= 0 else ())
        return [*(kind(value) for kind in types), np.array(value), enum.IntEnum("Own", {"one": value}).one]
    if isinstance(value, float):
        return [*(kind(value) for kind in FLOATS), np.array(value), Fraction(value), Decimal(value)]
    if isinstance(value, str):
        return [np.str_(value)]
    views = [dict.fromkeys(value).keys()] if len(value) and not isinstance(value[0], list) else []
    others = [np.array(value), pd.Series(value, dtype=object), tuple(value), iter(value), deque(value), UserList(value)]
    lists = [*others, *views, [form for item in value for form in forms_of(item)[:1]], dict(enumerate(value)).values()]
    if len(value) and isinstance(value[0], list):
        return [
            *lists,
            np.array(value, dtype=np.float16 if isinstance(value[0][0], float) else None),
            zip(*zip(*value, strict=True), strict=True),
        ]
    if len(value) and type(value[0]) is int and value[1:2] == [value[0] + 1]:
        return [*lists, range(value[0], value[0] + len(value)), np.array(value, np.int8), pd.Index(value)]
    if len(value) and type(value[0]) is float:
        return [*lists, array.array("d", value), pd.Series(value), np.array(value, np.longdouble)]
    return lists


def outcome(model: type[Value], changes: dict[str, Any]) -> Any:
    """Return what is made of arguments: the object, its text and its JSON; or the errors, without what was given."""
    try:
        value = made(model, changes)
    except KeyedError as error:
        return [(problem.key, problem.reason.partition(" (got ")[0]) for problem in error.problems]
    except ValueError as error:
        return str(error)
    return value, repr(value), value.model_dump_json(warnings=False), [type(part) for part in parts_of(dict(value))]


def parts_of(value: Any) -> list[Any]:
    """Return the numbers and texts in nested values."""
    if isinstance(value, dict):
        return list(chain.from_iterable(map(parts_of, value.values())))
    if isinstance(value, list | tuple):
        return list(chain.from_iterable(map(parts_of, value)))
    return [value]


def takes_numbers(field: FieldInfo) -> bool:
    """Return whether a field takes numbers or booleans, or lists of them, or a number in place of a table."""
    if any(choice.number is not None for choice in choices_of(field)):
        return True
    return bool({int, float, bool} & {*leaves(field.annotation)})


def leaves(annotation: Any) -> list[Any]:
    """Return the types of the values in an annotation; those of a function are none, nor are those of a table."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return leaves(annotation.__origin__)
    if origin is Literal:
        return [type(value) for value in get_args(annotation)]
    return list(chain.from_iterable(map(leaves, get_args(annotation)))) if origin in CONTAINERS else [annotation]


CONTAINERS = {tuple, list, Union, UnionType}


@pytest.mark.slow_but_one
@pytest.mark.parametrize("model", MODELS, ids=lambda model: f"{model.__module__.rpartition('.')[2]}.{model.__name__}")
def test_numbers_of_others_mean_what_those_of_python_mean_in_every_field(model):
    """The same object, text, JSON and types, or the same errors: so hashes and digests are the same, too.

    A field meets all forms of one right and one wrong value of each type, and of each further value one form.
    """
    differing = []
    for name, field in model.model_fields.items():
        if not takes_numbers(field):
            continue
        taken, met = False, set()
        for turn, value in enumerate((*COUNTED, *MEASURED, *LISTS, *ROWS, *WRONG)):
            expected = outcome(model, {name: value})
            is_right, forms = isinstance(expected, tuple), forms_of(value)
            taken |= is_right
            case = (is_right, *map(type, forms))
            forms = forms[turn % len(forms) :][:1] if case in met else forms
            met.add(case)
            differing += [(name, value, repr(form)) for form in forms if outcome(model, {name: form}) != expected]
        assert taken or name in ALONE_WRONG, f"no value is a right one for {name}"
    assert differing == []


class Unit:
    """A quantity with a unit, as libraries of units have it: without its unit it is no number."""

    def __repr__(self):
        return "Unit()"

    def tolist(self):
        raise NotImplementedError

    def __array__(self):
        raise AssertionError("the unit would be lost")


class Called(list[int]):
    """A list that can be called: a model of a user."""

    def __call__(self):
        return 1


@pytest.mark.parametrize(
    "value",
    [
        *(
            np.timedelta64(5, "ns"),
            np.datetime64("2020-01-01"),
            pd.Timedelta(1, "s"),
        ),
        *(np.ma.masked, pd.NA, Unit(), Called([np.int64(1)]), b"12", Fraction(10**400), Decimal("1e999")),
        np.longdouble("1e4000"),
    ],
    ids=repr,
)
def test_what_is_no_number_and_no_list_is_returned_unchanged(value):
    assert as_python(value) is value


SETS = [
    (Team, {"positions": {(1.0, 2.0), (3.0, 4.0)}}),
    (Team, {"count": 1, "positions": [{1.0, 2.0}]}),
    (Team, {"count": 2, "speeds": {1.0, 2.0}}),
    (Evader, {"position": {1.0, 2.0}}),
    (RecordedMotion, {"waypoints": {(0.0, 1.0, 1.0), (1.0, 2.0, 2.0)}}),
    (RecordedFlow, {"velocities": frozenset({(0.0, 1.0, 1.0)})}),
    (Empirical, {"values": {0.1, 0.2}}),
    (Partition, {"start": 0.0, "groups": {frozenset({0}), frozenset({1})}}),
    (Scenario, {"fault": set()}),
]


@pytest.mark.parametrize(("model", "keys"), SETS, ids=lambda part: str(part))
def test_a_set_is_refused_where_the_order_or_the_number_counts(model, keys):
    with pytest.raises(KeyedError, match=r"should be a (list|number).*got the set"):
        model(**keys)


def test_a_field_that_is_a_set_takes_one():
    class Marked(Value):
        marks: frozenset[int]

    assert Marked(marks={2, 1}).marks == {1, 2}


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (pd.Series([1, 2], dtype="Int64"), [1, 2]),
        (pd.DataFrame({"x": [0.0, 1.0], "y": [2.0, 3.0]}), [[0.0, 2.0], [1.0, 3.0]]),
        (np.ma.array([1.0, 2.0], mask=[False, True]), [1.0, None]),
        (np.array([Fraction(1, 2), Decimal("0.25")]), [0.5, 0.25]),
        ({"a": np.int64(1), "b": [np.float32(0.5), (np.uint8(3),)]}, {"a": 1, "b": [0.5, (3,)]}),
        (np.array([[1, 2], [3, 4]], np.uint8)[:, 1], [2, 4]),
        (np.zeros((0, 2)), []),
        (memoryview(np.array([1.0, 2.0])), [1.0, 2.0]),
    ],
    ids=["masked pandas", "frame", "masked numpy", "objects", "nested", "slice", "empty", "memory"],
)
def test_numbers_inside_are_converted_too(values, expected):
    assert as_python(values) == expected


def test_infinity_and_nan_stay_what_they_are():
    assert as_python(np.float32(inf)) == as_python(Decimal("inf")) == inf
    assert isnan(as_python(np.float16("nan")))
    assert isnan(as_python(Decimal("nan")))


def test_a_list_of_plain_numbers_is_not_copied():
    for values in ([1.0, 2, None], ((1.0, 2.0), (3.0, 4.0)), [[1, 2], (3,)]):
        assert as_python(values) is values


@pytest.mark.parametrize("value", [2.0, np.float64(2.0), "2", True, np.True_, None, [2], Fraction(4, 2), Decimal(2)])
def test_an_integer_is_one_whatever_its_type_and_nothing_else_is(value):
    assert whole(np.uint8(2), "x") == whole(np.array(2), "x") == whole(10**30, "x") // 5 / 10**29
    with pytest.raises(ValueError, match="the number should be an integer"):
        whole(value, "the number")


@pytest.mark.parametrize("value", ["2", True, np.True_, None, [2.0], np.timedelta64(1, "s"), 1j])
def test_a_number_is_one_whatever_its_type_and_nothing_else_is(value):
    assert real(np.float32(0.5), "x") == real(Fraction(1, 2), "x") == real(Decimal("0.5"), "x") == 0.5
    assert type(real(np.int8(2), "x")) is float
    with pytest.raises(ValueError, match="the number should be a number"):
        real(value, "the number")


class Users(Value):
    """A model of a user that computes with an array, and with whatever it is given."""

    model_config = ConfigDict(arbitrary_types_allowed=True)

    weights: np.ndarray
    anything: Any = None
    gain: Annotated[float, Field(ge=0)] = 1.0


def test_a_field_for_arrays_or_for_anything_keeps_what_it_is_given():
    weights = np.array([1.0, 2.0])
    users = Users(weights=weights, anything=weights, gain=np.float32(0.5))
    assert users.weights is weights
    assert users.anything is weights
    assert type(users.gain) is float


def takes_many(annotation: Any) -> bool:
    """Return whether a field takes a list of any number of numbers, or of rows of numbers."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return takes_many(annotation.__origin__)
    if origin in {Union, UnionType}:
        return any(map(takes_many, inner))
    return origin is tuple and inner[-1] is Ellipsis and {*leaves(annotation)} <= {int, float, Ellipsis}


MANY = [
    (model, name)
    for model in MODELS
    if model is not CustomFault  # no user writes one: it is the record of a fault in a trace
    for name, field in model.model_fields.items()
    if takes_many(field.annotation)
]
WRONG_ITEMS = {
    "texts": ["a"] * 4096,
    "complex": np.full(4096, 0.5j),
    "four columns": np.zeros((1024, 4)),
    "three dimensions": np.zeros((64, 32, 2)),
    "dates": np.full(4096, 5, "m8[ms]"),
    "masked": np.ma.masked_all(4096),
}


@pytest.mark.parametrize("values", WRONG_ITEMS)
@pytest.mark.parametrize(("model", "name"), MANY, ids=lambda part: part if isinstance(part, str) else part.__name__)
def test_a_list_of_wrong_numbers_is_one_error(model, name, values):
    if values == "four columns" and (name == "groups" or model in {LatencyMatrix, Layer}):
        pytest.skip("rows of any length are right; that they are as many is no error of a number")
    with pytest.raises(ValueError) as refused:
        made(model, {name: WRONG_ITEMS[values]})
    assert [problem.key.split(".")[0] for problem in refused.value.problems] == [name]


def test_lists_of_numbers_are_found():
    """Without this, the test above would pass for a list of which nobody knows."""
    found = {f"{model.__name__}.{name}" for model, name in MANY}
    assert found >= {"Team.positions", "Team.speeds", "Netem.table", "Empirical.values", "RecordedMotion.waypoints"}


def test_the_number_of_pursuers_is_that_of_their_positions_whatever_holds_them():
    rows = [(1.0, 2.0), (3.0, 4.0)]
    for positions in (np.array(rows), iter(rows), zip([1, 3], [2, 4], strict=True), {2: rows[0], 5: rows[1]}.values()):
        assert Team(positions=positions) == Team(positions=rows, count=2)
    assert Netem(table=np.arange(4096), delay=1.0).table == tuple(range(4096))


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_half_of_a_character_is_refused_wherever_a_text_is(model):
    for name in model.model_fields:
        for value in ("\ud800", ["\udcff"], [[1.0, "\ud800"]], {"a": "\ud800"}, {"\ud800": 1}):
            with suppress(KeyedError):
                made(model, {name: value}).model_dump_json()


@pytest.mark.parametrize("text", ["\ud800", "a\udcff"])
def test_a_name_that_no_file_can_hold_is_refused_with_its_key(text):
    with pytest.raises(KeyedError, match=r"name: should be a text that a file can hold: '.ud...' is half of"):
        Scenario(name=text)
    for value in ([text], {"a": [text]}, {text: 1.0}, np.array([text])):
        with pytest.raises(KeyedError, match=r"grid: should be a text that a file can hold"):
            Sweep(grid={"name": value})
    assert Scenario(name="caf\u00e9 \U0001f600").name == "caf\u00e9 \U0001f600"


class Length:
    """A number with a unit, as those of pint, astropy or unyt."""

    def __init__(self, number, **names):
        self._number = number
        vars(self).update(names)

    def __float__(self):
        return float(self._number)


@pytest.mark.parametrize("value", [Length(200.0, units="ms"), Length(200.0, unit="ms")], ids=["units", "unit"])
def test_a_number_with_a_unit_is_refused(value):
    with pytest.raises(KeyedError, match="horizon: should be a number"):
        Scenario(horizon=value)
    with pytest.raises(KeyedError, match="speeds"):
        Team(count=2, speeds=[value, value])
    assert Scenario(horizon=Length(2.0)).horizon == 2.0


@pytest.mark.parametrize("kind", [complex, np.complex64, np.complex128])
def test_a_complex_number_is_never_a_real_one(kind):
    with pytest.raises(KeyedError, match="horizon: should be a number"):
        Scenario(horizon=kind(0.5))


def test_named_columns_are_taken_by_their_names():
    table = pd.DataFrame({"x": [1.0, 2.0], "t": [0.0, 1.0], "y": [3.0, 4.0]})
    rows = table.to_records(index=False)
    for value in (table, rows):
        assert RecordedMotion(waypoints=value).waypoints == ((0.0, 1.0, 3.0), (1.0, 2.0, 4.0))
    assert Team(positions=table[["y", "x"]]).positions == ((1.0, 3.0), (2.0, 4.0))
    matrix = np.arange(9.0).reshape(3, 3)
    square = pd.DataFrame(matrix, index=list("abc"), columns=list("abc"))
    for order in ("abc", "cab", "bac"):
        assert LatencyMatrix(values=square[list(order)]).values == tuple(map(tuple, matrix.tolist()))


def test_rows_that_are_labelled_with_numbers_are_those_of_the_pursuers_of_these_numbers():
    """pandas keeps the labels of sorted rows, and aligns by them. Rows of other labels, and over time, are in order."""
    table = pd.DataFrame({"x": [3.0, 1.0, 2.0], "y": [0.0, 5.0, 0.0], "speed": [2.0, 3.0, 1.0]})
    expected = Team(positions=[[3.0, 0.0], [1.0, 5.0], [2.0, 0.0]], speeds=[2.0, 3.0, 1.0])
    for other in (table.sort_values("x"), table[::-1], table.sort_values("speed")):
        given = {"positions": other[["x", "y"]], "speeds": other["speed"]}
        assert Team(**given) == expected
        assert Scenario().with_({f"team.{key}": value for key, value in given.items()}).team == expected
    named = table.set_index(pd.Index([5, 3, 4]))["speed"]
    assert Team(count=3, speeds=named).speeds == (2.0, 3.0, 1.0)
    record = pd.DataFrame({"t": [1.0, 0.0], "x": [3.0, 4.0], "y": [5.0, 6.0]}).sort_values("t")
    for rows in (record, record.set_axis([0, 1, 2], axis=1)):
        assert RecordedMotion(waypoints=rows).waypoints == ((0.0, 4.0, 6.0), (1.0, 3.0, 5.0))


@pytest.mark.parametrize("labels", [[0, 1, 2], [1, 2, 3], ["0", "1", "2"]], ids=["from 0", "from 1", "texts"])
def test_a_matrix_that_is_labelled_with_numbers_has_the_links_of_the_pursuers_of_these_numbers(labels):
    """Whether its rows, its columns or both are in another order, as those of a subset or of a pivot table are."""
    square = pd.DataFrame(np.arange(9.0).reshape(3, 3), index=labels, columns=labels)
    expected = LatencyMatrix(values=square.to_numpy()).values
    for rows, columns in ((labels[::-1], labels), (labels, labels[::-1]), (labels[::-1], labels[1:] + labels[:1])):
        matrix = square.loc[rows, columns]
        assert LatencyMatrix(values=matrix).values == expected
        labelled = Labelled(matrix, columns)
        labelled.coords["row"] = pd.Series(rows)
        assert LatencyMatrix(values=labelled).values == expected


@pytest.mark.parametrize("kind", ["pandas", "labels", "rows without names", "arrow", "record"])
def test_the_names_in_a_matrix_are_those_of_the_nodes(kind):
    """The graph numbers the nodes by their names, in another order than the matrix."""
    names, rows = ["c", "a", "b"], np.arange(9.0).reshape(3, 3)
    square = pd.DataFrame(rows, index=names, columns=names)
    table = {
        "pandas": square[["a", "b", "c"]],
        "labels": Labelled(rows, names),
        "rows without names": square.reset_index(drop=True),
        "arrow": OfArrow(**square),
        "record": square.to_records(index=False),
    }[kind]
    if kind == "labels":
        table.coords["row"] = pd.Series(names)
    matrix = LatencyMatrix(values=table)
    assert matrix == LatencyMatrix(values=table, nodes=names) == LatencyMatrix(values=rows, nodes=names)
    graph = nx.Graph([("a", "b"), ("b", "c")])
    latency = Scenario(team={"count": 3}, network={"graph": graph, "latency": matrix}).network.latency
    assert latency.base_latencies.tolist() == [[0.0, 5.0, 3.0], [7.0, 0.0, 6.0], [1.0, 2.0, 0.0]]
    with pytest.raises(KeyedError, match=r"nodes should be left out: the values have the names c, a, b$"):
        LatencyMatrix(values=table, nodes=["a", "b", "c"])
    with pytest.raises(KeyedError, match="nodes: should be a list"):
        LatencyMatrix(values=table, nodes=3)


def test_a_matrix_whose_rows_have_other_names_than_its_columns_is_refused():
    table = pd.DataFrame(np.ones((2, 2)), index=["a", "b"], columns=["a", "c"])
    with pytest.raises(KeyedError, match=r"the rows and the columns should have the same names \(got a, b and a, c\)"):
        LatencyMatrix(values=table)


@pytest.mark.parametrize("labels", [["column_0", "column_1"], ["f0", "f1"], ["1", "0"], [3, 4]])
def test_labels_that_packages_make_are_no_names(labels):
    table = pd.DataFrame([[0.0, 1.0], [2.0, 0.0]], columns=labels)
    assert LatencyMatrix(values=table).nodes is None


@pytest.mark.parametrize("name", ["rtt_ms", "rtt [us]", "delay (ms)", "RTT in ms", "delay / ns", "wait minutes"])
def test_a_series_whose_name_has_another_unit_than_its_key_is_refused(name):
    unit = name.strip("])").split(" ")[-1].split("_")[-1].strip("[(")
    with pytest.raises(KeyedError, match=re.escape(f"values: should be in s: the name {name!r} says {unit}")):
        Empirical(values=pd.Series([0.1, 0.2], name=name))


@pytest.mark.parametrize("name", ["delay", "delay_s", "rtt [s]", "rtt_min", "items", "x_m", None, 3, ("a", "ms")])
def test_a_series_of_another_name_is_read(name):
    assert Empirical(values=pd.Series([0.1, 0.2], name=name)).values == (0.1, 0.2)


def test_a_key_of_a_user_without_a_unit_takes_a_series_of_any_unit():
    class Counts(Value):
        delays: tuple[float, ...]
        """Delays."""

    assert Counts(delays=pd.Series([1.0], name="delay_ms")).delays == (1.0,)


@pytest.mark.parametrize("kind", [sparse.csr_matrix, sparse.coo_array, sparse.dok_matrix, sparse.lil_array])
def test_a_sparse_matrix_is_refused_because_its_gaps_may_mean_no_link(kind):
    with pytest.raises(KeyedError, match=r"values: .*\(got a sparse matrix, whose absent numbers may be 0 or missing"):
        LatencyMatrix(values=kind(np.array([[0.0, 1.0], [2.0, 0.0]])))


def test_an_open_file_is_not_read_as_a_list(tmp_path):
    (tmp_path / "latencies.txt").write_text("0.1\n0.2\n")
    with (tmp_path / "latencies.txt").open() as file:
        for name in ("file", "values"):
            with pytest.raises(KeyedError, match=rf"{name}.*\(got an open file: give its path"):
                Empirical(**{name: file})
        assert len(file.readlines()) == 2


class Labelled:
    """An array with labels along its last dimension, as that of xarray."""

    dims = ("row", "axis")

    def __init__(self, rows, labels):
        self._rows, self._labels = np.array(rows), labels
        self.coords = {"axis": pd.Series(labels)}

    def isel(self, order):
        (name, indices), *more = order.items()
        if name == "row":
            return Labelled(self._rows[indices], self._labels).isel(dict(more or {"axis": range(len(self._labels))}))
        other = Labelled(self._rows[:, indices], [self._labels[k] for k in indices])
        other.coords = self.coords | other.coords
        return other

    def __array__(self, dtype=None, copy=None):
        return self._rows


class OfStructs:
    """A series of structs, as that of polars."""

    dtype = SimpleNamespace(fields=["y", "x"])

    def __init__(self, **columns):
        self.struct = SimpleNamespace(unnest=lambda: pd.DataFrame(columns))

    def __array__(self, dtype=None, copy=None):
        raise AssertionError("its columns have names")


class OfArrow:
    """A table of arrays, as that of Arrow: its columns are no names."""

    def __init__(self, **columns):
        self.columns, self.column_names = [[*column] for column in columns.values()], [*columns]

    def select(self, names):
        return OfArrow(**{name: self.columns[self.column_names.index(name)] for name in names})

    def __array__(self, dtype=None, copy=None):
        return np.array(self.columns).T


class OfUnits(pd.DataFrame):
    """A table whose columns may have units, as that of astropy."""

    colnames = ("x", "y")

    def __getitem__(self, name):
        return SimpleNamespace(unit="km" if name == "y" else None)


ROW = namedtuple("ROW", "y x")


@pytest.mark.parametrize(
    "table",
    [
        pd.DataFrame({"Y": [3.0], "X": [1.0]}),
        pd.DataFrame({"y [m]": [3.0], "x [m]": [1.0]}),
        pd.DataFrame({"pos_y": [3.0], "pos_x": [1.0]}),
        pd.DataFrame({"north": [3.0], "east": [1.0]}),
        np.array([(3.0, 1.0)], dtype=[("Y", float), ("X", float)]),
        [ROW(3.0, 1.0)],
        [ROW(np.float32(3.0), 1.0)],
        Labelled([[3.0, 1.0]], ["y", "x"]),
        OfStructs(y=[3.0], x=[1.0]),
        OfArrow(y=[3.0], x=[1.0]),
        pd.DataFrame([[3.0, 1.0]], columns=pd.MultiIndex.from_tuples([("p", "y"), ("p", "x")])),
    ],
    ids=[
        *("capital", "unit", "prefix", "compass", "record", "named tuple", "of numpy", "labels", "structs", "arrow"),
        "levels",
    ],
)
def test_names_of_coordinates_are_understood_as_in_a_file(table):
    assert Team(positions=table).positions == ((1.0, 3.0),)


@pytest.mark.parametrize(
    ("y", "x"),
    [
        *[("y/m", "x/m"), ("y / m", "x / m"), ("y in m", "x in m"), ("y, m", "x, m"), ("y_meters", "x_meters")],
        *[("pose.position.y", "pose.position.x"), ("/odom/pose/y", "/odom/pose/x"), (".y", ".x"), ("p_y", "p_x")],
        *[("pos y", "pos x"), ("pos-y", "pos-x"), ("py", "px"), ("y1", "x1"), ("y_0", "x_0"), ("centreY", "centreX")],
        *[("ym", "xm"), ("y_pos", "x_pos"), ("YPos", "XPos"), ("y position", "x position")],
        *[("utm_north", "utm_east"), ("Northing (m)", "Easting (m)"), ("world.Y [metre]", "world.X [metre]")],
    ],
)
def test_labels_of_coordinates_may_have_words_before_them_and_units_in_any_form(y, x):
    assert Team(positions=pd.DataFrame({y: [3.0], x: [1.0]})).positions == ((1.0, 3.0),)
    assert Team(positions=pd.DataFrame({x: [1.0], y: [3.0]})).positions == ((1.0, 3.0),)


@pytest.mark.parametrize("labels", ["ycm xcm", "posYCm posXCm", "yft xft", "timeMs x y", "tms x y", "timestampNs x y"])
def test_a_unit_may_be_written_without_a_space_before_it(labels):
    with pytest.raises(ValueError, match=rf"column '{labels.split()[0]}' is in \w+, and should be in"):
        Team(positions=pd.DataFrame([[1.0, 3.0, 5.0][: len(labels.split())]], columns=labels.split()))


@pytest.mark.parametrize(
    "labels", [[2, 0, 1], [3, 1, 2], [2.0, 0.0, 1.0], ["2", "0", "1"], ["3", "1", "2"], np.int8([2, 0, 1])]
)
def test_rows_may_be_labelled_from_0_or_from_1_by_numbers_or_texts(labels):
    rows = [[5.0, 7.0], [1.0, 2.0], [3.0, 4.0]]
    table = pd.DataFrame(rows, columns=["x", "y"], index=labels)
    expected = ((1.0, 2.0), (3.0, 4.0), (5.0, 7.0))
    assert Team(positions=table).positions == expected
    assert Team(count=3, speeds=table["x"]).speeds == (1.0, 3.0, 5.0)
    labelled = Labelled(rows, ["x", "y"])
    labelled.coords["row"] = pd.Series(labels)
    assert Team(positions=labelled).positions == expected


@pytest.mark.parametrize("labels", [[7, 2, 4], [1, 0, 0], [2, 3, 4], ["c", "a", "b"], ["02", "00", "01"], [0.5, 1, 2]])
def test_rows_with_other_labels_stay_in_their_order(labels):
    table = pd.DataFrame([[5.0, 7.0], [1.0, 2.0], [3.0, 4.0]], columns=["x", "y"], index=labels)
    assert Team(positions=table).positions == ((5.0, 7.0), (1.0, 2.0), (3.0, 4.0))


def test_a_time_is_the_first_coordinate_whatever_its_name():
    for name in ("time", "T", "t_s", "Time [s]"):
        table = pd.DataFrame({"x": [1.0, 2.0], "y": [3.0, 4.0], name: [0.0, 1.0]})
        assert RecordedMotion(waypoints=table).waypoints == ((0.0, 1.0, 3.0), (1.0, 2.0, 4.0))


ZONE = "Europe/Berlin"


@pytest.mark.parametrize(
    "times",
    [
        pd.date_range("2024-05-01", periods=2, freq="500ms"),
        pd.date_range("2024-05-01", periods=2, freq="500ms", tz=ZONE),
        pd.to_datetime(["2024-03-31T01:59:59.75+01:00", "2024-03-31T03:00:00.25+02:00"], utc=True),
        pd.to_timedelta([0, 500], unit="ms"),
        pd.Index([0.0, 0.5], name="t"),
        pd.Index([0.0, 0.5], name="Time"),
    ],
    ids=["dates", "in a zone", "summer time", "durations", "t", "Time"],
)
def test_the_times_of_a_table_may_be_its_index_and_dates(times):
    """The clock goes forward by an hour between the two dates of summer time."""
    table = pd.DataFrame({"y": [3.0, 4.0], "x": [1.0, 2.0]}, index=times)
    expected = ((0.0, 1.0, 3.0), (0.5, 2.0, 4.0))
    assert RecordedMotion(waypoints=table).waypoints == expected
    assert RecordedMotion(waypoints=table.reset_index(names="time")).waypoints == expected
    assert RecordedFlow(velocities=table.rename(columns={"x": "vx", "y": "vy"})).velocities == expected


def test_columns_without_such_names_stay_in_their_order():
    for names in (["b", "a"], ["y", "a"], [1, 0], ["x", "X"]):
        assert Team(positions=pd.DataFrame([[3.0, 1.0]], columns=names)).positions == ((3.0, 1.0),)


@pytest.mark.parametrize(
    ("names", "why"),
    [
        (["lat", "lon"], "in degrees"),
        (["Longitude", "Latitude"], "in degrees"),
        (["x_cm", "y_cm"], "column 'x_cm' is in cm, and should be in m"),
        (["x [km]", "y [km]"], r"column .x.* is in km, and should be in m"),
        (["lat_deg", "lon_deg"], "in degrees"),
        (["latitude_deg_e7", "longitude_deg_e7"], "in degrees"),
        (["gps_lat", "gps_lng"], "in degrees"),
        (["y_in_cm", "x_in_cm"], "column 'y_in_cm' is in cm, and should be in m"),
        (["y_inch", "x_inch"], "column 'y_inch' is in inch, and should be in m"),
        (["y_millimeters", "x_millimeters"], "is in millimeters"),
    ],
)
def test_columns_in_another_unit_are_refused(names, why):
    with pytest.raises(KeyedError, match=f"positions: .*a table: .*{why}"):
        Team(positions=pd.DataFrame([[3.0, 1.0]], columns=names))
    with pytest.raises(KeyedError, match=f"positions.0: .*a row: .*{why}"):
        Team(positions=[namedtuple("Row", [name.split(" [")[0] + "_km" * ("[" in name) for name in names])(3.0, 1.0)])


@pytest.mark.parametrize(
    ("table", "why"),
    [
        (pd.DataFrame({"y / cm": [3.0], "x / cm": [1.0]}), "column 'y / cm' is in cm"),
        (pd.DataFrame({"x, km": [1.0], "y, km": [3.0]}), "column 'x, km' is in km"),
        (pd.DataFrame({"GPS.Lat": [3.0], "GPS.Lon": [1.0]}), "positions are in degrees"),
        (OfStructs(y_cm=[3.0], x_cm=[1.0]), "column 'y_cm' is in cm"),
        (OfUnits({"x": [1.0], "y": [3.0]}), "column 'y' is in km"),
        (OfArrow(lat=[3.0], lon=[1.0]), "positions are in degrees"),
        (type("Dataset", (), {"data_vars": {}, "__array__": None})(), "a dataset of xarray"),
    ],
    ids=["slash", "comma", "prefix", "structs", "astropy", "arrow", "dataset"],
)
def test_tables_of_other_packages_in_another_unit_are_refused(table, why):
    with pytest.raises(KeyedError, match=f"positions: .*a table: {why}"):
        Team(positions=table)


@pytest.mark.parametrize("other", ["node", "id", "frame", "speed", "z", "vx", "heading [rad]", "", "x2"])
@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("kind", ["pandas", "record", "named tuple", "labels", "structs", "arrow"])
def test_a_column_beside_x_and_y_that_is_no_time_is_refused(other, place, kind):
    """By their places, three columns would be t, x and y."""
    names = ["x", "y"]
    names.insert(place, other)
    columns = {name: [float(k)] for k, name in enumerate(names)}
    row = [float(k) for k in range(3)]
    table = {
        "pandas": lambda: pd.DataFrame(columns),
        "record": lambda: np.array([tuple(row)], dtype=[(name or "f", float) for name in names]),
        "named tuple": lambda: [namedtuple("Row", [name.split(" ")[0] or "f" for name in names])(*row)],
        "labels": lambda: Labelled([row], names),
        "structs": lambda: OfStructs(**columns),
        "arrow": lambda: OfArrow(**columns),
    }[kind]()
    for make in (lambda: RecordedMotion(waypoints=table), lambda: Team(positions=table)):
        with pytest.raises(KeyedError, match="is none of t, x and y: leave it out"):
            make()


def test_the_nodes_of_a_matrix_may_have_the_names_of_coordinates():
    values = np.arange(9.0).reshape(3, 3)
    for names in (["z", "y", "x"], ["y", "x", "t"], ["x", "a", "y"]):
        matrix = LatencyMatrix(values=pd.DataFrame(values, index=names, columns=names))
        assert (np.array(matrix.values) == values).all()
        assert list(matrix.nodes) == names


@pytest.mark.parametrize("names", ["v u t", "t speed direction", "t vx_kmh vy_kmh", "e n t", "x y", "t a b", "u v"])
@pytest.mark.parametrize("make", [lambda d: RecordedMotion(waypoints=d), lambda d: RecordedFlow(velocities=d)])
def test_a_table_over_time_with_other_names_is_refused(make, names):
    """By their places, v would be the time, and a direction a velocity."""
    columns = names.split()
    table = pd.DataFrame([[0.0, 1.0, 2.0][: len(columns)]], columns=columns)
    for each in (table, table.to_records(index=False), OfArrow(**table)):
        with pytest.raises(KeyedError, match=rf"the columns of \w+ should be t, x and y \(got {', '.join(columns)}\)"):
            make(each)


@pytest.mark.parametrize("names", [("t", "u", "v"), (0, 1, 2), ("f0", "f1", "f2"), ("y", "time", "x")])
def test_a_table_over_time_without_such_names_is_read(names):
    table = pd.DataFrame([[0.0, 1.0, 2.0]], columns=names)
    expected = ((0.0, 1.0, 2.0),) if names[0] != "y" else ((1.0, 2.0, 0.0),)
    assert RecordedFlow(velocities=table).velocities == RecordedMotion(waypoints=table).waypoints == expected


def test_a_named_tuple_that_is_no_row_may_have_any_names():
    class Drone(Value):
        place: tuple[float, float, float]
        places: tuple[tuple[float, float, float], ...] = ()

    place = namedtuple("Place", "x y z")(1.0, 2.0, 3.0)
    assert Drone(place=place).place == (1.0, 2.0, 3.0)
    with pytest.raises(KeyedError, match="a row: column 'z' is none of t, x and y"):
        Drone(place=place, places=[place])
    with pytest.raises(KeyedError, match="a row: column 'x_cm' is in cm"):
        Drone(place=namedtuple("Place", "x_cm y_cm z_cm")(1.0, 2.0, 3.0))


def test_corners_in_one_row_stay_in_their_order():
    class Field(Value):
        edges: tuple[tuple[float, float, float, float], ...]

    names = ["x1", "y1", "x2", "y2"]
    assert Field(edges=pd.DataFrame([[1.0, 2.0, 3.0, 4.0]], columns=names)).edges == ((1.0, 2.0, 3.0, 4.0),)


@pytest.mark.parametrize("attribute", ["unit", "units"])
def test_a_table_whose_attributes_name_a_unit_is_refused(attribute):
    table = pd.DataFrame({"x": [1.0], "y": [3.0]})
    table.attrs[attribute] = "km"
    with pytest.raises(KeyedError, match="its attributes say that it is in km"):
        Team(positions=table)


@pytest.mark.parametrize(
    "endless", [lambda: cycle([1.0, 2.0]), count, lambda: repeat(1.0), lambda: (1.0 for _ in count())]
)
def test_an_iterator_without_an_end_is_refused(endless, monkeypatch):
    monkeypatch.setattr("desim.config.python_numbers.MAX_ITEMS", 1000)
    for model, name in ((Team, "speeds"), (Empirical, "values"), (Team, "positions")):
        with pytest.raises(KeyedError, match=f"{name}.*an iterator without an end: give a list"):
            made(model, {name: endless()})
    assert Team(count=2, speeds=repeat(2.0, 2)).speeds == (2.0, 2.0)


@pytest.mark.parametrize("count", [10**8, 10**12, 2**63, 10**30])
def test_a_range_that_no_memory_holds_is_refused(count):
    with pytest.raises(KeyedError, match="a list of more than 10,000,000 items"):
        Team(speeds=range(count))

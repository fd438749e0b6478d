"""The table of runs: a compact sequence that equals the list of its rows, and columns that equal lists of values."""

from dataclasses import replace
from math import inf, isnan

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from desim.analysis.metrics import METRICS, Summary
from desim.analysis.statistics import estimate, paired
from desim.study.results.runs import Group
from desim.study.store import run_table
from desim.study.store.run_table import EXACT, Column, Measured, Row, RunTable

NUMBERS = st.one_of(
    st.none(),
    st.booleans(),
    st.sampled_from([-EXACT, EXACT, EXACT + 1, -EXACT - 1, 10**400, 0]),
    st.integers(-1000, 1000),
    st.floats(allow_nan=False),
)
TABLES = st.dictionaries(st.sampled_from("ab"), st.one_of(st.integers(), st.floats(allow_nan=False)))
LISTS = st.one_of(
    *(st.lists(each) for each in (st.floats(allow_nan=False), st.integers(-9, 9), st.booleans(), TABLES)),
    st.lists(st.one_of(NUMBERS, TABLES)),
)
SUMMARIES = st.one_of(
    st.fixed_dictionaries({"captured": st.booleans(), "energy": st.floats(allow_nan=False), "capturers": TABLES}),
    st.dictionaries(st.sampled_from(["captured", "energy", "mine", "capturers"]), st.one_of(NUMBERS, TABLES)),
)


@st.composite
def runs(draw, summaries=SUMMARIES):
    """Draw runs in the order of replications, some of which failed, some without a few metrics."""
    found = []
    for k in sorted(draw(st.sets(st.integers(0, 5)))):
        seed = draw(st.sampled_from([k, 2**70 + k]))
        if draw(st.integers(0, 4)):
            found.append(Row(k, seed, "ok", Summary(draw(summaries), {"mine": "m"})))
        else:
            found.append(Row(k, seed, draw(st.sampled_from(["error", "crashed"])), None, f"trace {k}"))
    return found


def typed(value):
    """Return a value with its type, also inside a table; equal numbers of different types then differ."""
    inner = {key: typed(each) for key, each in value.items()} if isinstance(value, dict) else repr(value)
    return type(value), inner


@pytest.mark.slow
@given(st.lists(LISTS, max_size=3))
def test_a_column_returns_each_value_with_its_type(parts):
    column, values = Column(), [value for part in parts for value in part]
    for part in parts:
        column.extend(part)
    assert len(column) == len(values)
    for found in (column.values(), [column[k] for k in range(len(values))]):
        assert list(map(typed, found)) == list(map(typed, values))


@given(st.lists(st.one_of(st.none(), st.booleans(), st.integers(-(2**60), 2**60), st.floats(allow_nan=False))))
def test_the_numbers_of_a_column_are_those_of_numpy(values):
    found = Column(values).numbers()
    assert np.array_equal(found, np.array(values, dtype=float), equal_nan=True)
    assert found.dtype == float


@pytest.mark.slow
@given(runs(), st.integers(1, 4), st.booleans())
def test_a_table_equals_the_list_of_its_rows(rows, chunk, are_measured):
    """Also if the runs that did not fail come as a store reads them."""
    before, run_table.CHUNK = run_table.CHUNK, chunk
    given = [
        Measured(row.replication, row.seed, dict(row.summary)) if are_measured and row.summary is not None else row
        for row in rows
    ]
    try:
        table = RunTable(iter(given), {"mine": "m"})
    finally:
        run_table.CHUNK = before
    assert table == rows
    assert len(table) == len(rows)
    for found in (list(table), [table[k] for k in range(len(rows))], table[:]):
        assert found == rows
        for one, other in zip(found, rows, strict=True):
            assert one.summary is None or {k: typed(v) for k, v in one.summary.items()} == {
                k: typed(v) for k, v in other.summary.items()
            }
            assert one.summary is None or one.summary.units == other.summary.units
    assert table.failed == [row for row in rows if not row.ok]
    for name in ("captured", "energy", "mine", "capturers", "missing"):
        values = [row.value(name) for row in rows if row.ok]
        assert list(map(typed, table.column(name).values())) == list(map(typed, values))
    if rows:
        assert table != rows[:-1]
        assert table != [*rows[:-1], replace(rows[-1], seed=rows[-1].seed + 1)]
        with pytest.raises(IndexError):
            table[len(rows)]


PLAIN = st.fixed_dictionaries(
    {}, optional={"energy": st.one_of(st.none(), st.floats(-1e9, 1e9)), "captured": st.booleans()}
)


SHIFTED = [[Row(k, k, "ok", Summary({"energy": float(k)})) for k in numbers] for numbers in ((0, 1), (1, 2))]


@pytest.mark.slow
@given(runs(PLAIN), runs(PLAIN))
@example(*SHIFTED)
def test_pairs_and_estimates_of_groups_are_those_of_the_rows(rows, others):
    """The model: dictionaries of rows by replication."""
    one, other = Group({}, rows), Group({}, tuple(others))
    there = {row.replication: row for row in others if row.ok}
    expected = [(row, there[row.replication]) for row in rows if row.ok and row.replication in there]
    at, at_other = one.pairs(other)
    assert len(at) == len(at_other) == len(expected)
    assert one.seeds == [row.seed for row in rows if row.ok]
    for name in ("energy", "captured", "missing"):
        pairs = [(a.value(name), b.value(name)) for a, b in expected]
        values, other_values = one.values(name), other.values(name)
        assert [(values[a], other_values[b]) for a, b in zip(at, at_other, strict=True)] == pairs
        present = [value for value in one.values(name) if value is not None]
        assert one.present(name).tolist() == present
        if present:
            assert repr(estimate(one.present(name))) == repr(estimate(present))
        differences = paired(one.numbers(name)[at], other.numbers(name)[at_other])
        plain = [float(a) - float(b) for a, b in pairs if a is not None and b is not None]
        assert differences.count == len(plain)
        assert repr(differences) == repr(estimate(plain)) if plain else isnan(differences.mean)


def test_infinite_minus_infinite_is_no_number_and_no_warning():
    assert isnan(paired([inf], [inf]).mean)
    assert repr(paired([inf, 2.0], [inf, 1.0])) == repr(paired([2.0], [1.0]))


def test_a_table_of_runs_needs_less_than_half_a_kilobyte_each():
    values = {name: 0.1 * k for k, name in enumerate(METRICS)}
    table = RunTable(Row(k, k, "ok", Summary(values | {"energy": 1.0 / (k + 1)})) for k in range(2000))
    columns = [table.column(name) for name in METRICS]
    held = sum(each._numbers.buffer_info()[1] * 8 + len(each._kinds) for each in columns)
    assert held < 500 * len(table)


def test_a_part_of_a_table_is_the_list_of_its_rows():
    rows = [Row(k, k, "ok", Summary({"energy": 1.0 * k})) for k in range(3)]
    rows.insert(1, Row(7, 7, "error", None, "trace"))
    table = RunTable(rows)
    for part in (slice(None), slice(1, 3), slice(None, None, -1), slice(5, 9)):
        assert table[part] == rows[part]

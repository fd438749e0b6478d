"""Ranges in grids: exact decimals, the last number included, and refused if they have no end."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, sweep
from desim.scenario.override_texts import key_and_values
from desim.scenario.sweep_table import Sweep
from desim.scenario.value_ranges import MAX_VALUES, range_of


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("0:1:0.1", [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]),
        ("0:1:0.3", [0.0, 0.3, 0.6, 0.9]),
        ("1:0:-0.5", [1.0, 0.5, 0.0]),
        ("2:8:3", [2, 5, 8]),
        ("3:3:1", [3]),
        ("1e-3:3e-3:1e-3", [0.001, 0.002, 0.003]),
        (" 0 : .5 : .25 ", [0.0, 0.25, 0.5]),
    ],
)
def test_a_range_has_the_numbers_that_one_would_write(text, numbers):
    found = range_of(text)
    assert found == numbers
    assert list(map(type, found)) == list(map(type, numbers))


@given(first=st.integers(-50, 50), count=st.integers(1, 40), step=st.integers(1, 99))
def test_each_number_is_the_float_of_its_decimal(first, count, step):
    last = 100 * first + (count - 1) * step
    found = range_of(f"{first}.00:{last / 100:.2f}:{step / 100:.2f}")
    assert found == [float(f"{(100 * first + k * step) / 100:.2f}") for k in range(count)]


@pytest.mark.parametrize("text", ["module:name", "0:1", "a:b:c", "0:1:0.1:2", "", "1"])
def test_other_texts_are_no_ranges(text):
    assert range_of(text) is None


@pytest.mark.parametrize(
    ("text", "why"),
    [("0:1:0", "no end"), ("0:1:-1", "no end"), (f"0:{MAX_VALUES}:1", "has 100,001 values, above 100,000")],
)
def test_a_range_without_an_end_is_refused(text, why):
    with pytest.raises(ValueError, match=why):
        range_of(text)


def test_a_range_is_one_in_an_option_a_file_and_a_script():
    numbers = [0.0, 0.1, 0.2, 0.3]
    assert key_and_values("network.latency.value=0:0.3:0.1") == ("network.latency.value", numbers)
    assert key_and_values("team.count=2,4:8:2") == ("team.count", [2, 4, 6, 8])
    assert Sweep(grid={"network.latency.value": "0:0.3:0.1"}).grid == {"network.latency.value": tuple(numbers)}
    swept = sweep(Scenario(horizon=0.01), {"team.count": "2:3:1"}, reps=1)
    assert swept.values("team.count") == [2, 3]

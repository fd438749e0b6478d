"""Ranges in grids: exact decimals, the last number included, and refused if they have no end."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, load, sweep
from desim.kernel.models.latency import Uniform
from desim.kernel.models.medium import LoRa
from desim.scenario.override_texts import key_and_values
from desim.scenario.sweep_table import Sweep
from desim.scenario.toml import dump
from desim.scenario.value_ranges import MAX_VALUES, KeyRange, interval_of, range_of


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
    [
        ("0:1:0", "no end"),
        ("0:1:-1", "no end"),
        (f"0:{MAX_VALUES}:1", "more than 100,000 values"),
        ("0:1e900000:1", "more than 100,000 values"),
        ("0:1e9999999:1", "an exponent that is too large"),
        ("0:1:1e-9999999", "an exponent that is too large"),
        ("0:1e99999999999999999999:1", "an exponent that is too large"),
        ("0:1e400:1e399", "an exponent that is too large"),
        ("-1e400:0:1e399", "an exponent that is too large"),
    ],
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


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("log:1e-3:1:7", [0.001, 0.00316228, 0.01, 0.0316228, 0.1, 0.316228, 1.0]),
        ("log:8:1:4", [8.0, 4.0, 2.0, 1.0]),
        ("log:1:3:2", [1.0, 3.0]),
        (" LOG: 1 : 1e2 : 3 ", [1.0, 10.0, 100.0]),
    ],
)
def test_a_logarithmic_range_has_equal_ratios_and_exact_ends(text, numbers):
    assert range_of(text) == numbers


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("log:0:1:5", "begin and end above 0"),
        ("log:1:2:1", "two different numbers"),
        ("log:1:1:3", "two different numbers"),
        ("log:1:2:100001", "more than 100,000 values"),
        ("log:1:1e400:5", "an exponent that is too large"),
    ],
)
def test_a_logarithmic_range_without_ratios_is_refused(text, why):
    with pytest.raises(ValueError, match=why):
        range_of(text)


@pytest.mark.parametrize("text", ["0:1:0.1", "module:name", "log:1", "", "1", "log:a:b"])
def test_other_texts_are_no_ranges_without_steps(text):
    assert interval_of(text) is None


@pytest.mark.parametrize("text", ["1:0", "1:1", "log:0:1", "log:-1:1", "0:inf", "-Infinity:0", "nan:1", "0:1e400"])
def test_a_range_without_steps_that_is_none_is_refused(text):
    with pytest.raises(ValueError, match="the range"):
        interval_of(text)


@given(
    low=st.floats(1e-6, 1e3),
    ratio=st.floats(1.001, 1e6),
    share=st.floats(0.0, 1.0),
    is_log=st.booleans(),
)
def test_a_number_of_a_range_lies_in_it_and_is_the_one_that_is_shown(low, ratio, share, is_log):
    interval = KeyRange(low, low * ratio, is_log)
    number = interval.at(share)
    assert interval.low <= number <= interval.high
    assert number in (interval.low, interval.high) or number == float(f"{number:.6g}")
    assert (interval.at(0.0), interval.at(1.0)) == (interval.low, interval.high)
    middle = (low * low * ratio) ** 0.5 if is_log else low * (1 + ratio) / 2
    assert interval.at(0.5) == pytest.approx(middle, rel=1e-5)


@pytest.mark.parametrize("low", [2, -1, -6])
def test_whole_numbers_of_a_range_are_equally_probable(low):
    whole = KeyRange(low, low + 3.0, is_whole=True)
    numbers = [whole.at((k + 0.5) / 4000) for k in range(4000)]
    assert {number: numbers.count(number) for number in {*numbers}} == dict.fromkeys(range(low, low + 4), 1000)
    assert (whole.at(0.0), whole.at(1.0)) == (low, low + 3)
    assert all(isinstance(number, int) for number in numbers)


def test_a_logarithmic_range_of_whole_numbers_has_its_ends():
    """The exponential of log(5) is less than 5."""
    for low in range(1, 100):
        whole = KeyRange(low, low + 1.0, is_log=True, is_whole=True)
        assert (whole.at(0.0), whole.at(1.0)) == (low, low + 1)


def test_a_range_without_steps_is_one_in_an_option_a_file_and_a_script():
    assert key_and_values("network.loss.p=0:0.5") == ("network.loss.p", "0:0.5")
    for grid in ({"network.loss.p": "log:0.1:0.5"}, {"network.loss.p": KeyRange(0.1, 0.5, True)}):
        sweep_table = Sweep(grid=grid, design="sobol:8")
        assert sweep_table.grid == {"network.loss.p": (KeyRange(0.1, 0.5, True),)}
        written = sweep_table.model_dump(mode="json")
        assert written["grid"] == {"network.loss.p": "log:0.1:0.5"}
        assert Sweep(**written) == sweep_table


@dataclass(frozen=True)
class Slow:
    """A latency of a user, with a parameter that may be absent."""

    mean: float | None = None

    def __call__(self, context, rng):
        return np.full(context.dst.shape, self.mean or 0.0)


def test_models_in_a_grid_are_written_as_tables_from_which_the_same_models_are_made(tmp_path):
    """Also what a user's model was made from; TOML has no None, so what is absent is left out."""
    models = {"network.medium": (LoRa(),), "network.latency": (Slow(0.1), Slow(), Uniform(high=0.3))}
    scenario = Scenario(sweep=Sweep(grid=models))
    file = tmp_path / "swept.toml"
    file.write_text(dump(scenario))
    of_file = load(file, allow_import=True).sweep.grid
    for key, values in models.items():
        for value, table in zip(values, of_file[key], strict=True):
            assert scenario.with_({key: table}) == scenario.with_({key: value})
    assert scenario.sweep.plain()["grid"]["network.latency"][0]["mean"] == 0.1


@given(low=st.floats(1e-9, 1e9), ratio=st.floats(1.001, 1e6), is_log=st.booleans())
def test_a_range_is_written_so_that_it_is_read_again(low, ratio, is_log):
    interval = KeyRange(low, low * ratio, is_log)
    assert interval_of(str(interval)) == interval

"""Units of keys are those of their descriptions."""

import pytest

from desim.config.key_index import unit_of_key
from desim.config.number_texts import number_instead_of
from desim.scenario.scenario import Scenario


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("horizon", "s"),
        ("network.range", "m"),
        ("network.latency.mean", "s"),
        ("network.latency.value", "s"),
        ("protocol.schedule.rate", "1/s"),
        ("team.speeds", "m/s"),
        ("team.speeds.last", "m/s"),
        ("fault.0.start", "s"),
        ("network.reception.shadowing", "dB"),
        ("network.loss.p", None),
        ("team.count", None),
        ("prune", None),
        ("of.no.scenario", None),
    ],
)
def test_a_key_has_the_unit_of_its_description_whatever_the_kind_above_it(key, unit):
    assert unit_of_key(key, Scenario) == unit


@pytest.mark.parametrize(
    ("text", "number"),
    [
        *(("3 s", "3"), ("3 sec", "3"), ("3 ms", "0.003"), ("3 us", "3e-06"), ("3 ns", "3e-09"), ("3 min", "180")),
        *(("3 m", "3"), ("3 km", "3000"), ("3 cm", "0.03"), ("3 mm", "0.003"), ("3 %", "0.03"), ("1,5e1 MS", "0.015")),
        *(("1234567 ms", "1234.567"), ("0,125", "0.125"), ("1,25", "1.25"), ("0.7 ms", "0.0007")),
    ],
)
def test_a_text_that_is_meant_as_a_number_is_told_with_the_number_to_write(text, number):
    assert f": {number} instead of the text" in number_instead_of(text, ("s", "m", "1"))


@pytest.mark.parametrize("text", ["1,000", "12,500 ms", "-1,000"])
def test_a_comma_that_may_separate_thousands_is_not_guessed_at(text):
    assert "thousands have no separator" in number_instead_of(text)

"""Temperatures of log-linear learning."""

import pytest
from pydantic import ValidationError

from protocols.temperature import ConstantTau, PaperTau


def test_the_papers_temperature_is_infinite_at_first_and_a_thousandth_after_a_hundred_slots():
    assert PaperTau()(0.0) == 0.0
    assert 1 / PaperTau()(1.0) == 10.0
    assert 1 / PaperTau()(100.0) == pytest.approx(0.001)


def test_a_constant_temperature_does_not_change():
    assert ConstantTau(value=0.5)(0.0) == ConstantTau(value=0.5)(1e9) == 2.0


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_a_temperature_must_be_positive_and_finite(bad):
    with pytest.raises(ValidationError):
        ConstantTau(value=bad)
    with pytest.raises(ValidationError):
        PaperTau(scale=bad)

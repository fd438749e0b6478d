"""Units of keys are those of their descriptions."""

import pytest

from desim.config.key_index import unit_of_key
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

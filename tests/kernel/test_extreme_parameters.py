"""Any number that a model of links takes can be simulated, also the least and the greatest that there are."""

import sys
from contextlib import suppress

import pytest

from desim.config.choice import OneOf
from desim.kernel.models.faults import MessageFault
from desim.kernel.models.latency_by_link import LATENCIES
from desim.kernel.models.links import Links
from desim.kernel.models.loss import LOSSES
from desim.kernel.models.reception import RECEPTION_MODELS
from desim.kernel.stepped_network import SteppedNetwork

EXTREMES = (5e-324, sys.float_info.max)
POSITIONS = [[0.0, 0.0], [1.0, 0.0], [3.0, 0.0], [3.0, 0.0]]
FAMILIES = {"latency": LATENCIES, "loss": LOSSES, "reception": RECEPTION_MODELS}


def of_extremes(family: OneOf):
    """Yield each model of a family in which one number is the least or the greatest float."""
    for model in family.choices().values():
        for name, field in model.model_fields.items():
            for number in EXTREMES if field.annotation is float else ():
                with suppress(ValueError):  # it is refused
                    yield model(**{name: number})


def delivered(links: Links, **options) -> list[float]:
    """Return when the messages of a few broadcasts arrive."""
    network = SteppedNetwork(4, links, seed=1, positions=POSITIONS, **options)
    for _ in range(3):
        for node in range(4):
            network.send(node, None, "x")
    return [message.arrived for message in network.step(1e9)]  # 30 years, the longest time


@pytest.mark.parametrize("name", FAMILIES)
def test_the_least_and_the_greatest_number_of_a_model_can_be_simulated(name):
    """A warning, such as that of an overflow, is an error in all tests."""
    models = [*of_extremes(FAMILIES[name])]
    assert len({type(model) for model in models}) > 1
    for model in models:
        arrivals = delivered(Links(**{name: model}, range=2.0))
        assert all(0.0 <= arrival <= 1e9 for arrival in arrivals), model


@pytest.mark.parametrize("is_copied", [False, True])
def test_a_message_is_late_by_30_years_at_most(is_copied):
    fault = MessageFault(messages=(1,), delay=sys.float_info.max, duplicate=is_copied)
    assert max(delivered(Links(), faults=[fault])) == 1e9

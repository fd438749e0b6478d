"""Signals that arrive while a library runs Python code."""

import signal
from typing import Annotated

import pytest
from pydantic import BaseModel, Discriminator, Tag

from desim.config.interrupts import deferred
from desim.config.model import Value


def form(value):
    """Interrupt the serialization; return the tag of a number."""
    if isinstance(value, float):
        signal.raise_signal(signal.SIGINT)
    return "number"


class Held(Value):
    """Its field is serialized with the help of a function."""

    value: Annotated[Annotated[float, Tag("number")] | Annotated[str, Tag("text")], Discriminator(form)] = 1.0


@pytest.mark.filterwarnings("ignore:Pydantic serializer warnings")
def test_an_interrupt_of_a_serialization_is_raised_after_it():
    """The controls are the methods of pydantic, which swallow it."""
    for name in ("model_dump", "model_dump_json"):
        with pytest.raises(KeyboardInterrupt):
            getattr(Held(), name)()
        getattr(BaseModel, name)(Held())


def test_the_first_of_several_signals_is_raised_when_the_outermost_block_ends():
    seen = []
    before = signal.signal(signal.SIGTERM, lambda number, _: seen.append(number))
    try:
        with deferred():
            with deferred():
                signal.raise_signal(signal.SIGTERM)
                signal.raise_signal(signal.SIGINT)
            assert seen == []
        assert seen == [signal.SIGTERM]
    finally:
        signal.signal(signal.SIGTERM, before)

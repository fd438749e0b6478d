"""Signals that arrive while a library runs Python code."""

import signal
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated

import pytest
from pydantic import BaseModel, Discriminator, Tag
from pydantic_core import core_schema

from desim.config.interrupts import Terminated, deferred, exit_code, raising
from desim.config.model import Value

pytestmark = pytest.mark.usefixtures("default_signals")


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


def test_an_interrupt_while_the_schema_of_a_model_is_built_is_raised_after_it():
    """Pydantic drops one that is raised while it compiles a pattern, or wraps it in another exception."""
    built = []

    class Interrupting:
        @classmethod
        def __get_pydantic_core_schema__(cls, *_):
            signal.raise_signal(signal.SIGINT)
            built.append(cls)
            return core_schema.any_schema()

    class Model(Value):
        key: Interrupting

    with pytest.raises(KeyboardInterrupt):
        Model(key=1)
    assert built == [Interrupting]
    assert Model(key=1).key == 1


def test_a_schema_is_rebuilt_with_the_names_where_it_is_asked_for():
    def model():
        class Model(Value):
            later: "Later"

        return Model

    class Later(Value):
        pass

    kind = model()
    assert kind.model_rebuild()
    assert kind(later={}).later == Later()


def test_the_first_of_several_signals_is_raised_when_the_outermost_block_ends():
    seen = []
    signal.signal(signal.SIGTERM, lambda number, _: seen.append(number))
    with deferred():
        with deferred():
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGINT)
        assert seen == []
    assert seen == [signal.SIGTERM]


def test_an_ignored_signal_takes_the_place_of_no_other():
    """As SIGHUP under nohup, which comes first when a terminal is closed."""
    seen = []
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, _: seen.append(number))
    with deferred():
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGTERM)
    assert seen == [signal.SIGTERM]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("after", range(6))
def test_a_signal_while_a_block_begins_or_ends_leaves_no_signal_without_effect(monkeypatch, number, after):
    """It is sent after one of the calls that replace the three handlers, or that restore them."""
    calls, set_handler = iter(range(100)), signal.signal

    def interrupted(*arguments):
        set_handler(*arguments)
        if next(calls) == after:
            signal.raise_signal(number)

    def block():
        with deferred():
            pass

    with raising():
        monkeypatch.setattr(signal, "signal", interrupted)
        with pytest.raises(KeyboardInterrupt):
            block()
        for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(each)


@pytest.mark.parametrize("block", [deferred, raising])
def test_a_block_in_another_thread_changes_no_handler(block):
    """Only the main thread may set handlers, so the control is a block in it."""

    def handlers():
        with block():
            return [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]

    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(handlers).result() == before
    assert handlers() != before
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_signal_without_a_handler_raises_while_the_block_runs_and_an_ignored_one_does_not():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with raising():
        signal.raise_signal(signal.SIGHUP)
        with pytest.raises(Terminated, match="by SIGTERM") as ended:
            signal.raise_signal(signal.SIGTERM)
    assert exit_code(ended.value) == 128 + 15
    assert exit_code(KeyboardInterrupt()) == 128 + 2
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL

"""The record of a run: positions and messages."""

import pytest

from desim.analysis.trace_index import (
    lacks_messages,
    messages_recorded,
    places_of,
    positions_known,
    require_messages,
    sampled,
    samples,
    trace_index,
    traced_events,
)
from desim.kernel.core.events import MessageCounts, Trace
from desim.pursuit.core.events import Decided, Ended, Sampled, Started
from desim.scenario.players import Team
from desim.scenario.scenario import Motion, Recording, Scenario
from desim.simulation.run import Result, run
from protocols.centralised import Centralised


def ran(trajectory=0.0, messages=False, **given):
    """Return a short run of two, of which little is recorded."""
    record = Recording(trajectory=trajectory, messages=messages)
    return run(Scenario(team=Team(count=2), horizon=0.2, record=record, **given))


@pytest.mark.parametrize(
    ("trajectory", "frozen", "moments"),
    [(0.1, False, [0, 0, 100_000_000, 200_000_000]), (0.0, False, [0]), (0.1, True, [0]), (0.0, True, [0])],
)
def test_positions_are_known_at_samples_or_always_in_a_static_game(trajectory, frozen, moments):
    """The first sample is of the start, too."""
    result = ran(trajectory, motion=Motion(static=frozen))
    assert [each.t for each in samples(result)] == moments
    assert isinstance(samples(result)[0], Started)
    assert positions_known(result) == (frozen or trajectory > 0.0)


def test_missing_samples_are_an_error_that_explains_how_to_record_them():
    assert sampled(ran(0.1)) == ran(0.1).trace.of(Sampled)
    with pytest.raises(ValueError, match=r"^positions were not recorded: set record\.trajectory to a time greater"):
        sampled(ran())


def test_messages_are_lacking_if_some_were_sent_and_none_is_on_record():
    """A run that sends none lacks none; if recorded, that is all there is."""
    mute = Centralised()
    assert not messages_recorded(ran())
    assert lacks_messages(ran())
    assert messages_recorded(ran(messages=True))
    assert not lacks_messages(ran(messages=True))
    assert not messages_recorded(ran(protocol=mute))
    assert not lacks_messages(ran(protocol=mute))
    assert messages_recorded(ran(messages=True, protocol=mute))


def test_a_run_whose_messages_went_to_a_file_has_them_if_its_trace_was_read_from_there():
    """In memory it has none; only `messages` counts them."""
    result, there = ran(messages="file"), ran(messages=True)
    assert not messages_recorded(result)
    assert result.trace.of(MessageCounts)[0].sent
    read = Trace()
    read.events += there.trace
    assert messages_recorded(Result(result.scenario, result.seed, read))


def test_missing_messages_are_an_error_that_explains_how_to_record_them():
    require_messages(ran(messages=True))
    with pytest.raises(ValueError, match=r"^the trace lacks the messages that were sent: set record\.messages = true"):
        require_messages(ran())


class SpecialSample(Sampled):
    """A type of events that a user derives."""


@pytest.mark.parametrize("derive", [trace_index, lambda result: result], ids=["index", "result"])
def test_events_are_those_of_the_trace_in_order_also_of_a_derived_type(derive):
    result = ran(0.1)
    result.trace.events.insert(2, SpecialSample(*result.trace.of(Sampled)[0]))
    searched, events = derive(result), result.trace.events
    assert traced_events(searched, Sampled) == result.trace.of(Sampled) != []
    assert traced_events(searched, Ended) == result.trace.of(Ended) != []
    places = places_of(searched, Sampled, Decided)
    assert places == [k for k, event in enumerate(events) if isinstance(event, Sampled | Decided)]
    assert 2 in places

"""Time-outs by hand, and waiting that ends with mail or with its time."""

from types import SimpleNamespace

import pytest

from desim import Scenario, run
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from protocols.schedules.retransmission import RetransmissionTimer, arrival_or_timeout


def test_the_first_time_out_is_5_4_of_a_round_trip_and_each_later_one_has_3_2_of_the_sending_time():
    """L = 0.2 s, 0.4 s to send: 0.5 + 0.5, 0.5 + 0.75, 0.5 + 1.125, ..."""
    time_out = RetransmissionTimer(SimpleNamespace(latency=0.2), 0.4, 0.001)
    assert [time_out(), *map(time_out, range(3))] == pytest.approx([1.0, 1.0, 1.25, 1.625])


def test_no_time_out_is_shorter_than_the_floor_however_many_there_were():
    time_out = RetransmissionTimer(SimpleNamespace(latency=0.0), 0.0, 0.1)
    assert {time_out(attempt) for attempt in (0, 1, 10_000)} == {0.1}


@pytest.mark.slow
def test_waiting_ends_with_the_first_message_or_at_its_deadline():
    """Sent at 1 s, it arrives at 1.5 s; then nothing comes until 3 s, and what is past is not waited for."""

    def protocol(me):
        if me.id == 0:
            yield me.at(1.0)
            me.send(1, "word", "port")
        if me.id == 1:
            for until in (2.0, 3.0, 2.5):
                due = yield from arrival_or_timeout(me, "port", until)
                seen.append((me.now, due, [message.body for message in me.mail("port")]))

    seen = []
    run(Scenario(horizon=4.0, protocol=protocol, network=Links(latency=Constant(value=0.5))), 0)
    assert seen == [(1.5, False, ["word"]), (3.0, True, []), (3.0, True, [])]

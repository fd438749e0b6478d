"""The queue of a stepped network is read in the order of arrival, transmission and receiver."""

from hypothesis import given
from hypothesis import strategies as st

from desim.kernel.core.clock import Clock
from desim.kernel.state.inbox import Message
from desim.kernel.state.message_queue import MessageQueue

DELIVERY = st.tuples(st.integers(0, 5), st.lists(st.tuples(st.integers(0, 3), st.integers(0, 4)), max_size=4))
"""The number of a transmission, and receivers with their times of arrival: few, so that many are equal."""


@given(st.lists(st.lists(DELIVERY, max_size=6), max_size=5), st.booleans())
def test_messages_are_taken_in_the_order_of_arrival_transmission_and_receiver(steps, ascend):
    clock, expected, taken, number = Clock(), [], [], 0
    queue = MessageQueue(clock, 4)
    for deliveries in steps:
        for drawn, arrivals in deliveries:
            number = number + 1 if ascend else drawn
            receivers = sorted({dst: clock.now + 1 + wait for dst, wait in arrivals}.items())
            if receivers:
                nodes, times = [dst for dst, _ in receivers], [when for _, when in receivers]
                queue.deliver(Message(0, 0, None), "", nodes, times, number)
                expected += [(when, number, dst) for dst, when in receivers]
        clock.run(until=clock.now + 3)
        due = sorted(entry for entry in expected if entry[0] <= clock.now)
        taken = [entry[:3] for entry in queue.take()]
        assert taken == due
        expected = [entry for entry in expected if entry[0] > clock.now]

"""Inboxes: the order of messages, and the cost of those in flight."""

from hypothesis import given
from hypothesis import strategies as st

from desim.kernel.core.clock import Clock
from desim.kernel.state.inbox import Inboxes, Message


def put(boxes, arrival, number):
    boxes.deliver(Message(0, 0, None), "", [0], arrival, number)


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(1, 3)), max_size=60))
def test_an_inbox_is_drained_in_the_order_of_arrival_however_few_messages_are_new(messages):
    """After each message or few of them what has arrived is drained; the plain way sorts all letters."""
    clock = Clock()
    boxes, letters = Inboxes(clock, 1), []
    (box,) = boxes.at("")
    for number, (delay, advance) in enumerate(messages):
        message = Message(number, 0, None)
        boxes.deliver(message, "", [0], clock.now + delay, number)
        letters.append((clock.now + delay, number, message))
        if advance == 1:
            clock.run(until=clock.now + 1)
            arrived = sorted(letter for letter in letters if letter[0] <= clock.now)
            letters = [letter for letter in letters if letter[0] > clock.now]
            assert box.drain() == [message for *_, message in arrived]
            assert box.in_flight() == len(letters)


class Compared(int):
    """An arrival time that counts how often it is compared."""

    count = 0

    def __lt__(self, other):
        Compared.count += 1
        return int(self) < int(other)

    def __eq__(self, other):
        Compared.count += 1
        return int(self) == int(other)

    __hash__ = int.__hash__


def test_a_message_is_not_compared_with_all_that_are_in_flight():
    """With 4,096 in flight, each of 200 more is compared with some 12; to sort them all would take 4,096 or more."""
    boxes = Inboxes(Clock(), 1)
    (box,) = boxes.at("")
    for k in range(4096):
        put(boxes, Compared(1000 + (k * 2741) % 4096), k)
    assert box.drain() == []
    Compared.count = 0
    for k in range(200):
        put(boxes, Compared(1000 + (k * 1471) % 4096), 4096 + k)
        assert box.drain() == []
    assert Compared.count < 200 * 60

"""Inboxes: the order of messages, and the cost of those in flight."""

from functools import partial
from unittest.mock import patch

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.state import inbox
from desim.kernel.state.inbox import Inboxes, Message


def put(boxes, arrival, number):
    boxes.deliver(Message(0, 0, None), "", [0], arrival, number)


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(0, 30), st.integers(1, 3)), max_size=60))
@example([(1, 2), (1, 1)])  # two that arrive at one instant
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


def test_a_message_that_arrives_at_many_nodes_at_one_time_is_kept_once():
    boxes = Inboxes(Clock(), 3)
    boxes.deliver(Message(0, 0, None), "", [1, 2], 5, 0)
    assert boxes.at("")[1]._letters[0] is boxes.at("")[2]._letters[0]


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


@pytest.mark.slow
@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(0, 5), st.integers(0, 1), st.integers(0, 2)), max_size=20),
    st.integers(0, 9),
)
def test_a_function_that_listens_gets_what_a_process_reads(messages, start):
    """At the same times, together and in the same order; each message is answered, and the answer takes no time."""

    def happenings(listen):
        clock, seen = Clock(), []
        boxes = Inboxes(clock, 2)

        def act(node, arrived):
            seen.append((clock.now, node, [message[:2] for message in arrived]))
            for _, stamp, answers in arrived:
                if answers:
                    boxes.deliver(Message(node, stamp, answers - 1), "", [1 - node], clock.now, 1000 + len(seen))

        def send(number, delay, node, answers):
            boxes.deliver(Message(node, number, answers), "", [node], clock.now + delay, number)

        for number, (when, delay, node, answers) in enumerate(messages):
            event = Instant(clock, when, Phase.DECISION)
            event.callbacks.append(lambda _, row=(number, delay, node, answers): send(*row))
        for node, box in enumerate(boxes.at("")):
            event = Instant(clock, start, Phase.FAULT)
            event.callbacks.append(lambda _, node=node, box=box: listen(clock, box, node, act))
        clock.run()
        return seen

    def by_process(clock, box, node, act):
        def process():
            while True:
                yield box.arrival(Phase.DELIVERY + 1 + node)
                act(node, box.drain())

        clock.process(process())

    def by_function(_, box, node, act):
        box.listen(Phase.DELIVERY + 1 + node, lambda arrived: act(node, arrived))

    assert happenings(by_function) == happenings(by_process)


def greatest_numbers(messages, ignoring):
    """Let two nodes take the messages that are greater than all before, and answer them.

    Return what they take and when, and how many messages are in flight at each time.
    """
    clock, seen, in_flight = Clock(), [], []
    boxes, greatest = Inboxes(clock, 2), [-1, -1]

    def take(node, arrived):
        for message in arrived:
            if message.body > greatest[node]:
                greatest[node] = message.body
                seen.append((clock.now, node, message.body))
                boxes.deliver(Message(node, 0, message.body - 1), "", [1 - node], clock.now + 2, 1000 + len(seen))

    for node, box in enumerate(boxes.at("")):
        ignores = (lambda message, node=node: ignoring(message.body, greatest[node])) if ignoring else None
        box.listen(Phase.DELIVERY + 1 + node, partial(take, node), ignores)
    for number, (when, delays, body) in enumerate(messages):
        times, event = [when + delay for delay in delays], Instant(clock, when, Phase.DECISION)
        arrival = times[0] if len(set(times)) == 1 else times
        put = partial(boxes.deliver, Message(0, 0, body), "", [0, 1][: len(times)], arrival, number)
        event.callbacks.append(lambda _, put=put: put())
    for when in range(20):
        event = Instant(clock, when, Phase.SAMPLE)
        event.callbacks.append(lambda _: in_flight.append(boxes.in_flight()))
    clock.run()
    return seen, in_flight


@given(
    st.lists(
        st.tuples(st.integers(0, 9), st.lists(st.integers(0, 5), min_size=1, max_size=2), st.integers(0, 9)),
        max_size=20,
    )
)
def test_messages_that_are_ignored_have_no_effect(messages):
    plain = greatest_numbers(messages, None)
    assert greatest_numbers(messages, lambda body, greatest: body <= greatest) == plain
    with patch.object(inbox, "MANY_IGNORED", 0):
        assert greatest_numbers(messages, lambda body, greatest: body <= greatest) == plain


def test_the_comparison_detects_a_message_that_is_ignored_although_it_is_new():
    """The control of the test above."""
    messages = [(0, [1], 3), (2, [1], 5), (4, [1], 7)]
    plain = greatest_numbers(messages, None)
    assert plain[0][:1] == [(1, 0, 3)]
    assert greatest_numbers(messages, lambda body, greatest: body <= greatest + 2) != plain


def test_messages_of_an_inbox_that_is_not_listened_to_any_more_wait_for_the_next_reader():
    clock, seen = Clock(), []
    boxes = Inboxes(clock, 1)
    (box,) = boxes.at("")
    box.listen(Phase.DELIVERY + 1, lambda messages: seen.append((clock.now, len(messages))))
    put(boxes, 1, 1)
    put(boxes, 3, 2)
    clock.run(until=2)
    box.stop()
    put(boxes, 4, 3)
    clock.run(until=6)
    assert seen == [(1, 1)]
    box.listen(Phase.DELIVERY + 1, lambda messages: seen.append((clock.now, len(messages))))
    clock.run(until=7)
    assert seen == [(1, 1), (6, 2)]

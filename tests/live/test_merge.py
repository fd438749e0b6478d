"""The trace of a live run, merged from reports made by hand: what is sent, arrives, is lost and in flight is golden."""

import pytest

from desim.kernel.core.events import LOST, TransportCounts
from desim.kernel.core.message_size import size_of
from desim.kernel.core.records import Record
from desim.kernel.core.trace_file import line_of
from desim.kernel.state.inbox import Message
from desim.live.link import DatagramFate, SentDatagram
from desim.live.merge import Logs
from desim.live.own_bodies import OwnBodies
from desim.live.wire import Wire
from desim.pursuit.core.events import Decided, Ended, Sampled
from desim.pursuit.team.announcements import Assignment
from protocols.schedules import mutex
from protocols.schedules.mutex import Request
from tests.golden import golden

MS = 1_000_000
END = 100
"""The end of the run, ms."""


class Run:
    """A live run of four pursuers, whose reports are made by hand; times in ms."""

    def __init__(self, crashed):
        self.wire, self.sent, self.fates, self.lines = Wire(4, 1, OwnBodies(None)), {}, {}, {}
        self.logs, self.count = Logs(self.wire), 0
        self.logs.crashed = {node: t * MS for node, t in crashed.items()}

    def send(self, t, src, dst, *fates, causes=(), to_one=False):
        """Let a message be sent; each fate is of a receiver: its arrival, its cause, and whether it is of a copy."""
        self.count += 1
        body = Request((1, src)) if to_one else Assignment(1)
        content = Message(src, t * MS, body) if to_one else Record(src, self.count, t * MS, body)
        datagram = self.wire.encode(content, mutex.PORT if to_one else "", size_of(body), to_one=to_one)
        number = SentDatagram(t * MS, dst, {}, t * MS, datagram).number
        self.sent.setdefault(src, []).append(
            (t * MS, dst, {str(k): v for k, v in causes}, (t - 1) * MS, datagram.hex())
        )
        for node, arrival, *rest in fates:
            fate = DatagramFate(number, src, node, arrival if arrival == LOST else arrival * MS, *rest)
            self.fates.setdefault(node, []).append(fate)

    def merged(self, **options):
        for pursuer in range(4):
            lines = [line_of(Decided(t * MS, pursuer, 1)) for t in self.lines.get(pursuer, ())]
            self.logs.take(pursuer, self.sent.get(pursuer, ()), self.fates.get(pursuer, ()), lines)
        world = [Sampled(t * MS, ((0.0, 0.0),), ((1.0, 1.0),) * 4) for t in (0, 50, END)]
        return self.logs.merged([*world, Ended(END * MS, "horizon", None)], **options)


def busy():
    run = Run({3: 60})
    run.lines = {1: (50, 20, END, END + 1), 0: (50,)}
    run.send(10, 0, (1, 2), (1, 12), (2, 14))
    run.send(20, 1, (0, 2), (0, 22), (0, 30, "", True), causes=((2, "loss"),))
    run.send(20, 0, (1,), (1, 23), to_one=True)
    run.send(30, 2, (0, 1, 3), (0, LOST, "loss"), (3, 35))
    run.send(40, 2, (0, 3), (0, 45), (3, 70))
    run.send(55, 2, (1,), (1, 58), (1, 58, "crash"))
    run.send(58, 0, (3,), (3, 60), to_one=True)
    run.send(70, 0, (3, 1), (1, 80))
    run.send(90, 1, (0,), to_one=True)
    run.send(95, 1, (0, 2), (2, END))
    run.send(98, 2, (0,), (0, END + 5))
    run.send(END, 0, (1,), (1, LOST, "loss"))
    run.send(END + 1, 0, (1,), (1, END + 2))
    return run


@pytest.mark.parametrize("messages", [True, False])
def test_the_trace_of_a_live_run_is_golden(messages):
    run = busy()
    run.logs.transports = [
        TransportCounts(0, 4, 1, 1, {"repeats": 1, "age": 2}, 5, 1, 2, 1, 1, 100 * MS),
        TransportCounts(0, 3, 2, 0, {"repeats": 1}, 1, 0, 1, 0, 0, 10 * MS),
    ]
    events = run.merged(messages=messages)
    assert [event.t for event in events] == sorted(event.t for event in events)
    golden(f"live/{'with' if messages else 'without'} messages.txt", "".join(map(line_of, events)))


def test_without_transports_none_are_counted():
    assert not [event for event in busy().merged(messages=True) if isinstance(event, TransportCounts)]


@pytest.mark.parametrize(("crashed", "cause"), [({}, None), ({3: 50}, "crash")])
def test_a_message_that_nobody_reports_is_in_flight_unless_its_receiver_has_crashed(crashed, cause):
    run = Run(crashed)
    run.send(10, 0, (3,), to_one=True)
    *_, counts, _ = run.merged(messages=True)
    assert (counts.in_flight, counts.lost) == ((1, 0) if cause is None else (0, 1))


@pytest.mark.parametrize(("t", "in_flight"), [(9, 0), (10, 1), (11, 1)])
def test_a_message_is_lost_at_the_socket_if_a_later_one_was_read(t, in_flight):
    run = Run({})
    run.send(10, 0, (1,), (1, 12))
    run.send(t, 0, (1,), to_one=True)
    *_, counts, _ = run.merged(messages=True)
    assert (counts.in_flight, counts.lost) == (in_flight, 1 - in_flight)

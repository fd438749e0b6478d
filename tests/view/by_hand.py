"""A run of one second in which everything happens that can be drawn, made by hand; times in ms."""

from desim.kernel.events import LOST, Broadcast, Lost, Queued, Sent, Tally, Trace
from desim.kernel.faults import Began, Crash, Jamming, Over
from desim.pursuit.events import Decided, Ended, Halted, Sampled, Started
from desim.pursuit.word import Assignment
from desim.scenario import Scenario
from desim.simulation import Result

MS = 1_000_000
CRASH = Crash(node=0, at=0.4, until=0.6)
JAMMING = Jamming(centre=(1.0, 2.0), radius=3.0, at=0.7)
ACTIVE, INACTIVE = Assignment(True), Assignment(False)


def history(*more, samples=(0, 500, 1000), name="by hand", messages=True) -> Result:
    """Return the run: 0 and 1 are active at first, then 0 alone until it breaks down, nobody, and 2 alone.

    Of its messages, that of 100 ms is lost to 2 as it leaves, that of 250 ms leaves late and is lost as it arrives,
    that of 650 ms is dropped before it leaves, that of 900 ms is in flight at the end, that of 950 ms still waits then.
    Pursuer 0 runs from (0, 0) along x, 1 stays at (10, 0), 2 stays at (0, 10); the evader runs from (5, 5) along y.
    More events are put in by their times (ns).
    """
    word = [
        Broadcast(100 * MS, 0, 0, 1, (1, 2), (200 * MS, LOST), 100 * MS, 24, ACTIVE),
        Lost(100 * MS, 0, 0, 2, "loss"),
        Queued(250 * MS, 1, 2, (0,), 32),
        Sent(300 * MS, 1, 2, 0, 500 * MS, 250 * MS, 32, ("token", float("inf"))),
        Lost(500 * MS, 1, 2, 0, "crash"),
        Queued(650 * MS, 2, 1, (0, 2), 24),
        Lost(750 * MS, 2, 1, 0, "queue"),
        Lost(750 * MS, 2, 1, 2, "queue"),
        Broadcast(900 * MS, 3, 1, 2, (0, 2), (1200 * MS,), 900 * MS, 24, INACTIVE),
        Queued(950 * MS, 4, 0, (1,), 24),
    ]
    own = [
        Started(0, (5.0, 5.0), ((0.0, 0.0), (10.0, 0.0), (0.0, 10.0)), (1.0, 1.0, 2.0), (True, True, False)),
        Decided(150 * MS, 1, False),
        Decided(160 * MS, 1, False),
        Began(400 * MS, CRASH),
        Halted(400 * MS, 0),
        Over(600 * MS, CRASH),
        Began(700 * MS, JAMMING),
        Decided(800 * MS, 2, True),
    ]
    sampled = [
        Sampled(t * MS, (5.0, 5.0 + t / 1000), ((4.0 * min(t / 400, 1.0), 0.0), (10.0, 0.0), (0.0, 10.0)))
        for t in samples
    ]
    end = [
        Tally(1000 * MS, 8, 1, 4, 3, {"crash": 1, "loss": 1, "queue": 2}, 3, 80, 0.0),
        Ended(1000 * MS, "captured", 2),
    ]
    trace = Trace()
    trace.events += sorted([*own, *sampled, *(word if messages else ()), *more], key=lambda event: event.t) + end
    return Result(Scenario(name=name), 3, trace)

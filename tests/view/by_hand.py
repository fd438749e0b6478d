"""Runs of one second in which everything happens that can be drawn, made by hand; times in ms."""

from desim.kernel.core.events import LOST, Broadcast, Lost, MessageCounts, Queued, Sent, Trace
from desim.kernel.models.faults import Crash, Jamming
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Ended, Sampled, Started
from desim.pursuit.team.announcements import Announcements, Assignment
from desim.scenario.players import Evader
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result

MS = 1_000_000
CRASH = Crash(node=0, start=0.4, end=0.6)
JAMMING = Jamming(centre=(1.0, 2.0), radius=3.0, start=0.7)
ACTIVE, INACTIVE = Assignment(1), Assignment(0)
KNOWN = Announcements(start="known")
"""The start of runs without first announcements."""


def history(*more, samples=(0, 500, 1000), name="by hand", messages=True) -> Result:
    """Return the run: 0 and 1 are active at first, then 0 alone until it breaks down, none, and 2 alone.

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
        Started(0, ((5.0, 5.0),), ((0.0, 0.0), (10.0, 0.0), (0.0, 10.0)), (1.0, 1.0, 2.0), (1, 1, 0)),
        Decided(150 * MS, 1, 0),
        Decided(160 * MS, 1, 0),
        FaultStarted(400 * MS, CRASH),
        BrokeDown(400 * MS, 0),
        FaultEnded(600 * MS, CRASH),
        FaultStarted(700 * MS, JAMMING),
        Decided(800 * MS, 2, 1),
    ]
    sampled = [
        Sampled(t * MS, ((5.0, 5.0 + t / 1000),), ((4.0 * min(t / 400, 1.0), 0.0), (10.0, 0.0), (0.0, 10.0)))
        for t in samples
    ]
    end = [
        Captured(1000 * MS, 1, 2),
        MessageCounts(1000 * MS, 8, 1, 4, 3, {"crash": 1, "loss": 1, "queue": 2}, 3, 80, 0.0),
        Ended(1000 * MS, "captured", 2),
    ]
    trace = Trace()
    trace.events += sorted([*own, *sampled, *(word if messages else ()), *more], key=lambda event: event.t) + end
    return Result(Scenario(name=name, announce=KNOWN), 3, trace)


def pair(samples=range(0, 1001, 100)) -> Result:
    """Return a run with two evaders: 1 is captured by 0 at 400 ms, 2 by 0 as the run ends.

    1 is chased by 0 and 1, from 150 ms on by 0 alone; 2 by 2 alone, then 1 and 2, from 300 ms on 1 alone, from the
    instant of the first capture on 0 and 1, from 700 ms on 0 alone. Of its messages that of 160 ms announces that 1
    chases 2, that of 310 ms that 2 stays. Pursuer 0 runs from (0, 0) along x, 1 stays at (10, 0), 2 stays at (0, 10);
    evader 1 runs from (5, 5) along y to its capture, 2 from (8, 2) along x.
    """
    events = [
        Started(0, ((5.0, 5.0), (8.0, 2.0)), ((0.0, 0.0), (10.0, 0.0), (0.0, 10.0)), (1.0, 1.0, 2.0), (1, 1, 2)),
        Decided(150 * MS, 1, 2),
        Broadcast(160 * MS, 0, 1, 1, (0, 2), (200 * MS,), 160 * MS, 24, Assignment(2)),
        Decided(200 * MS, 0, 1),
        Decided(300 * MS, 2, 0),
        Broadcast(310 * MS, 1, 2, 1, (0, 1), (350 * MS,), 310 * MS, 24, Assignment(0)),
        Captured(400 * MS, 1, 0),
        Decided(400 * MS, 0, 2),
        Decided(700 * MS, 1, 0),
    ]
    events += [
        Sampled(
            t * MS,
            ((5.0, 5.0 + min(t, 400) / 1000), (8.0 + t / 1000, 2.0)),
            ((t / 250, 0.0), (10.0, 0.0), (0.0, 10.0)),
        )
        for t in samples
    ]
    end = [
        Captured(1000 * MS, 2, 0),
        MessageCounts(1000 * MS, 4, 4, 0, 0, {}, 2, 48, 0.0),
        Ended(1000 * MS, "captured", 0),
    ]
    trace = Trace()
    trace.events += sorted(events, key=lambda event: event.t) + end
    return Result(Scenario(name="pair", announce=KNOWN, evader=Evader(count=2)), 3, trace)


def chase(pursuers: int, end: int) -> Result:
    """Return a run that ends at `end` (ms), in which all pursuers are active and no message is sent.

    Pursuer k runs from (20 + k, -3) along y at 6 m/s, the evader from (20, 15) along y at 5 m/s.
    """
    moved = 6.0 * end / 1000
    start = tuple((20.0 + k, -3.0) for k in range(pursuers))
    events = [
        Started(0, ((20.0, 15.0),), start, (6.0,) * pursuers, (1,) * pursuers),
        Sampled(end * MS, ((20.0, 15.0 + 5.0 * end / 1000),), tuple((x, y + moved) for x, y in start)),
        MessageCounts(end * MS, 0, 0, 0, 0, {}, 0, 0, 0.0),
        Ended(end * MS, "horizon", None),
    ]
    trace = Trace()
    trace.events += events
    return Result(Scenario(name="chase", announce=KNOWN), 3, trace)

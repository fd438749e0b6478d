"""A simulation of the distributed coordination function in plain loops, outside of desim, as a reference.

Stations are saturated or have one frame each, carrier sensing takes no time, and frames that overlap at a receiver are
lost there. All times are integers in microseconds.
"""

import random
from dataclasses import dataclass


@dataclass
class Timing:
    """The times of the channel, us, and the window of the back-off."""

    airtime: int = 300
    slot: int = 9
    sifs: int = 10
    difs: int = 28
    ack: int = 50
    window: int = 16
    doublings: int = 6
    retries: int = 7
    ack_timeout: int = 60
    eifs: int = 88
    nav: bool = True


class _Air:
    """A frame on the air; `sensed` is when others begin to sense it, which for an acknowledgement is SIFS earlier."""

    def __init__(self, src, dst, begin, end, is_ack):
        self.src, self.dst, self.begin, self.end, self.is_ack = src, dst, begin, end, is_ack
        self.others = []


def saturated(hears, flows, horizon, seed, timing):
    """Return the frames that each flow delivers, all attempts, and the acknowledgements that are lost.

    Args:
        hears: for each station, the set of stations that it hears.
        flows: the destination of each saturated station.
        horizon: the time to simulate, us.
        seed: the seed.
        timing: the times.
    """
    rng, size = random.Random(seed), len(hears)
    left, stage = [0] * size, [0] * size
    idle_since, space = [0] * size, [timing.difs] * size
    held = [0] * size  # the end of the silence because of a frame for another station, or of the wait for an answer
    waiting = [None] * size  # the time-out of each station that waits for an answer
    arrived = [False] * size  # whether the present frame has been delivered already
    air, delivered, attempts, lost_acks = [], dict.fromkeys(flows, 0), 0, 0
    was_busy = [False] * size

    def is_busy(k, now):
        sensed = any(f.src == k or f.src in hears[k] for f in air)
        return sensed or held[k] > now or waiting[k] is not None

    def receives(k, frame):
        return frame.src in hears[k] and not any(f.src == k or f.src in hears[k] for f in frame.others)

    def put(frame):
        for other in air:
            if other.begin < frame.end and frame.begin < other.end:
                other.others.append(frame)
                frame.others.append(other)
        air.append(frame)

    def finish(k, success):
        waiting[k] = None
        if success or stage[k] == timing.retries:
            stage[k], arrived[k] = 0, False
        else:
            stage[k] += 1
        left[k] = rng.randrange(timing.window << min(stage[k], timing.doublings))

    now = 0
    while True:
        starts = {k: idle_since[k] + space[k] + left[k] * timing.slot for k in flows if not was_busy[k]}
        times = [max(t, now) for t in starts.values()] + [f.end for f in air]
        times += [t for t in held if t > now] + [t for t in waiting if t is not None]
        now = min(times)
        if now >= horizon:
            return delivered, attempts, lost_acks
        ended = [f for f in air if f.end == now]
        answers = []
        for frame in ended:
            for k in range(size):
                if frame.src in hears[k]:
                    space[k] = timing.difs if receives(k, frame) else timing.eifs
            space[frame.src] = timing.difs
            if frame.is_ack:
                if receives(frame.dst, frame):
                    finish(frame.dst, success=True)
                else:
                    lost_acks += 1
                continue
            good = receives(frame.dst, frame)
            waiting[frame.src] = now + timing.ack_timeout
            if timing.nav:
                for k in range(size):
                    if k != frame.dst and receives(k, frame):
                        held[k] = max(held[k], now + timing.sifs + timing.ack)
            if good:
                if not arrived[frame.src]:
                    delivered[frame.src] += 1
                    arrived[frame.src] = True
                begin = now + timing.sifs
                answers.append(_Air(frame.dst, frame.src, begin, begin + timing.ack, True))
        for frame in ended:
            air.remove(frame)
        for answer in answers:
            put(answer)
        for k in range(size):
            if waiting[k] == now:
                finish(k, success=False)
        busy = [is_busy(k, now) for k in range(size)]
        for k in range(size):
            if was_busy[k] and not busy[k]:
                idle_since[k] = now
            elif busy[k] and not was_busy[k]:
                _count_down(k, now, left, idle_since, space, timing)
        starting = [k for k in flows if not busy[k] and idle_since[k] + space[k] + left[k] * timing.slot <= now]
        # A station that was idle until now, and whose back-off ends now, starts although another starts as well.
        starting += [
            k for k in flows
            if busy[k] and not was_busy[k] and left[k] == 0 and starts.get(k) == now
            and waiting[k] is None and held[k] <= now and not any(f.src == k for f in air) and k not in starting
        ]  # fmt: skip
        for k in starting:
            attempts += 1
            left[k] = 0
            put(_Air(k, flows[k], now, now + timing.airtime, False))
        after = [is_busy(k, now) for k in range(size)]
        for k in range(size):
            if after[k] and not busy[k] and not was_busy[k] and k not in starting:
                _count_down(k, now, left, idle_since, space, timing)
        was_busy = after


def _count_down(k, now, left, idle_since, space, timing):
    passed = max(0, (now - idle_since[k] - space[k]) // timing.slot)
    left[k] -= min(passed, left[k])


def one_round(arrivals, rng, timing, sensing_delay):
    """Return how many of the broadcasts of stations that all hear each other overlap with none.

    Each station has one frame, which comes to its queue at its time of `arrivals`, us. All waits are real numbers.
    """
    waits = {k: (t, None) for k, t in enumerate(arrivals)}  # the time from which a station waits, and its slots
    idle_since, alone, space = float("-inf"), 0, timing.difs
    while waits:
        starts = {}
        for k, (since, slots) in waits.items():
            if slots is None:  # it found an idle channel, or has not come yet
                starts[k] = max(since, idle_since + space)
            else:
                starts[k] = idle_since + space + slots * timing.slot
        first = min(starts.values())
        sending = [k for k, t in starts.items() if t <= first + sensing_delay]
        end = max(starts[k] for k in sending) + timing.airtime
        alone += len(sending) == 1
        for k in sending:
            del waits[k]
        for k, (since, slots) in list(waits.items()):
            if since >= end + sensing_delay:
                continue
            if slots is None:
                waits[k] = since, rng.randrange(timing.window)
            else:
                passed = max(0, int((first + sensing_delay - idle_since - space) // timing.slot))
                waits[k] = since, max(0, slots - passed)
        idle_since = end + sensing_delay
        space = timing.difs if len(sending) == 1 else timing.eifs
    return alone

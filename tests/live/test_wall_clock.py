"""A clock of SimPy that follows the wall clock, whose time is given by hand."""

import asyncio

import pytest

from desim.kernel.core.clock import Clock
from desim.live import wall_clock
from desim.live.wall_clock import Lateness, WallClock

MS = 1_000_000


class Loop:
    """A loop whose timers ring by hand."""

    def __init__(self):
        self.soon, self.later, self.cancelled = [], [], []

    def create_future(self):
        return asyncio.Future(loop=asyncio.new_event_loop())

    def call_soon(self, call):
        self.soon.append(call)

    def call_later(self, delay, call):
        self.later.append((round(delay, 9), call))
        return self

    def cancel(self):
        self.cancelled.append(len(self.later))


@pytest.fixture
def clock(monkeypatch):
    """Return a wall clock at 0, with processes that note the time each 10 ms; `at` sets the time."""
    loop, env, noted = Loop(), Clock(), []
    monkeypatch.setattr(wall_clock.asyncio, "get_running_loop", lambda: loop)

    def process():
        while True:
            yield env.timeout(10 * MS)
            noted.append(env.now)

    env.process(process())
    made = WallClock(env, env.event(), lambda: made.time, lambda: noted.append("before"))
    made.time, made.env, made.loop, made.noted = 0, env, loop, noted
    yield made
    made.ended.get_loop().close()


def test_a_clock_begins_soon_and_waits_for_the_next_event(clock):
    assert clock.loop.soon == [clock.meet]
    clock.time = 4 * MS
    clock.meet()
    assert clock.loop.later == [(0.006, clock._ring)]
    assert clock.noted == ["before"]
    clock.time = 12 * MS
    clock._ring()
    assert clock.noted == ["before", "before", 10 * MS]
    assert clock.lateness == [2 * MS]
    assert clock.loop.later[1:] == [(0.008, clock._ring)]
    assert clock.env.now == 12 * MS


def test_a_timer_that_is_right_is_kept_and_another_is_set_anew(clock):
    clock.meet()
    clock.time = MS
    clock.meet()
    assert (len(clock.loop.later), clock.loop.cancelled) == (1, [])
    clock.env.timeout(2 * MS)
    clock.meet()
    assert (clock.loop.later[1:], clock.loop.cancelled) == ([(0.002, clock._ring)], [1])


def test_what_happens_meets_the_time_and_what_a_process_meets_happens_at_once(clock):
    met = []

    def act():
        met.append(clock.env.now)
        clock.meet(lambda: met.append("within"))
        met.append("after")

    clock.time = 25 * MS
    clock.meet(act)
    assert met == [25 * MS, "within", "after"]
    assert clock.noted == ["before", 10 * MS, 20 * MS]


def test_what_is_due_after_an_act_happens_with_it(clock):
    clock.meet(lambda: clock.env.timeout(0).callbacks.append(lambda _: clock.noted.append("due")))
    assert clock.noted == ["before", "due"]


def test_a_clock_that_is_over_stops_and_does_no_more(clock):
    clock.meet(clock._over.succeed)
    assert clock.ended.done()
    assert clock.ended.result() is None
    clock.meet(lambda: clock.noted.append("never"))
    clock.time = 100 * MS
    clock.meet()
    assert clock.noted == ["before"]
    assert clock.loop.later == []


def test_an_act_that_is_no_longer_possible_is_left_out(clock):
    clock.env.timeout(5 * MS).callbacks.append(lambda _: clock._over.succeed())
    clock.time = 7 * MS
    clock.meet(lambda: clock.noted.append("never"))
    assert clock.noted == ["before"]
    assert clock.env.now == 5 * MS


def test_an_exception_ends_the_clock(clock):
    def fails():
        raise ValueError("no way")

    clock.meet(fails)
    with pytest.raises(ValueError, match="no way"):
        clock.ended.result()
    clock.meet(lambda: clock.noted.append("never"))
    assert clock.noted == ["before"]


def test_latenesses_are_kept_up_to_a_number(clock, monkeypatch):
    monkeypatch.setattr(wall_clock, "MAX_KEPT", 2)
    clock.time = 60 * MS
    clock.meet()
    assert clock.lateness == [50 * MS, 40 * MS]


def test_the_quantiles_of_latenesses_are_those_of_their_order():
    assert Lateness.of([]) == Lateness(0, 0.0, 0.0, 0.0)
    assert Lateness.of([3 * MS, MS, 2 * MS]) == Lateness(3, 0.002, 0.003, 0.003)
    assert Lateness.of(range(201 * MS, 0, -MS)) == Lateness(201, 0.101, 0.199, 0.201)
    for count, p99 in ((60, 0.06), (99, 0.099), (100, 0.099), (101, 0.1), (200, 0.198)):
        times = range(count * MS, 0, -MS)
        assert Lateness.of(times).p99 == p99  # the least of them that 99 % do not exceed
        assert 0.99 * count <= sum(time <= p99 * 1e9 for time in times) < 0.99 * count + 1
    assert str(Lateness(3, 0.00123, 0.0456, 0.1)) == "1.23, 45.6 and 100.0 ms"

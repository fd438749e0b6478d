"""The pursuit of relay.toml in a loop of its own, with its own motion and decisions: only its messages are desim's.

All that the loop takes from desim is the scenario, the random streams and a `SteppedNetwork`. A pursuer decides by what
it has received, so a message that were early, late or lost elsewhere would change the pursuit from then on.
"""

from math import exp

import pytest

from desim import SteppedNetwork, load, run
from desim.kernel.core.events import Broadcast, Lost, Trace
from desim.kernel.core.seeds import stream
from desim.pursuit.core.events import Captured, Decided, Sampled
from scenarios.studies.study import SCENARIOS

NS = 1_000_000_000
HEARTBEAT, BELIEVED = 0.1, 0.34
"""Period of announcements, and time for which one is believed: three periods and two latencies, s."""


class OwnPursuit:
    """Twenty pursuers that play log-linear learning over a network."""

    def __init__(self, scenario, seed, step):
        self.n, self.h, self.rate = (
            scenario.team.count,
            round(scenario.motion.step * NS),
            scenario.protocol.schedule.rate,
        )
        self.x = [complex(*place) for place in scenario.team.start(seed)]
        self.speeds = [1.0] * (self.n - 1) + [2.0]
        self.e, self.v, self.eps = complex(*scenario.evaders[0].start(seed, 0)), scenario.evaders[0].speed, 0.1
        self.horizon, self.step, self.now = scenario.horizon, step, 0
        self.active, self.announced = [1] * self.n, [1] * self.n
        self.velocity, self.captured, self.places, self.decided = [0j] * self.n, None, [], []
        self.trace = Trace()
        self.network = SteppedNetwork(self.n, scenario.network, seed=seed, positions=self.positions(), trace=self.trace)
        streams = {
            name: [stream(seed, name, i) for i in range(self.n)] for name in ("poisson", "heartbeat", "decisions")
        }
        self.waits, self.rngs = streams["poisson"], streams["decisions"]
        self.first = [rng.uniform(0.0, HEARTBEAT) for rng in streams["heartbeat"]]
        self.beats = [0] * self.n
        self.turn = [round(rng.exponential(1.0 / self.rate) * NS) for rng in self.waits]

    def positions(self):
        return [(place.real, place.imag) for place in self.x]

    def play(self):
        for i in range(self.n):
            self.network.publish(i, ("chases", 1))
        self.steer()
        while self.now < self.horizon * NS:
            beat = [round((self.first[i] + self.beats[i] * HEARTBEAT) * NS) for i in range(self.n)]
            grid = (self.now // self.h + 1) * self.h
            until = min(*self.turn, *beat, grid, (self.now // self.step + 1) * self.step)
            self.move(until)
            if self.captured is not None:
                break
            for i in range(self.n):
                if self.turn[i] == until:
                    self.decide(i)
                    self.turn[i] = until + round(self.waits[i].exponential(1.0 / self.rate) * NS)
            for i in range(self.n):
                if beat[i] == until:
                    self.announce(i)
                    self.beats[i] += 1
            if until == grid:
                self.steer()
            if until % (NS // 20) == 0:
                self.places.append((until, [self.e, *self.x]))
        self.network.close()
        return self

    def move(self, until):
        """Move all on straight lines, and step the network."""
        dt = (until - self.now) / NS
        for i in range(self.n):  # whether i comes within the radius: |gap + t change| = eps
            gap, change = self.x[i] - self.e, self.velocity[i] - self.flight
            a, b, c = abs(change) ** 2, (gap * change.conjugate()).real, abs(gap) ** 2 - self.eps**2
            if b < 0.0 <= b * b - a * c and (when := (-b - (b * b - a * c) ** 0.5) / a) <= dt:
                self.captured = (self.now / NS + when, i)
        self.x = [place + velocity * dt for place, velocity in zip(self.x, self.velocity, strict=True)]
        self.e += self.flight * dt
        self.network.step(dt, self.positions())
        self.now = until

    def steer(self):
        """Let the evader flee from the nearest pursuer, and each active pursuer aim at its place after the step."""
        away = self.e - min(self.x, key=lambda place: abs(place - self.e))
        self.flight = self.v * away / abs(away)
        self.aim = self.e + self.flight * self.h / NS
        for i in range(self.n):
            self.turn_to(i)

    def turn_to(self, i):
        offset = self.aim - self.x[i]
        self.velocity[i] = self.active[i] * self.speeds[i] * offset / abs(offset)

    def capture_time(self, i):
        return max(abs(self.x[i] - self.e) - self.eps, 0.0) / (self.speeds[i] - self.v)

    def decide(self, i):
        """Draw an action from the logit of its gain at the temperature 10 / eta^2 (Lee & Bakolas, Algorithm 1)."""
        now = self.network.now
        heard = [self.network.latest(i)[j] for j in sorted(self.network.latest(i))]
        others = [m.src for m in heard if m.body[1] and m.arrived >= now - BELIEVED]
        own, times = self.capture_time(i), [self.capture_time(j) for j in others]
        gain = (sum(times) / len(times) - own) / (len(times) + 1) if times else self.horizon - now - own
        cold, most = (now * self.n * self.rate) ** 2 / 10.0, max(gain, 0.0)
        chase, rest = exp((gain - most) * cold), exp((0.0 - most) * cold)
        action = int(self.rngs[i].random() < chase / (chase + rest))
        self.decided.append((self.now, i, action))
        if action != self.active[i]:
            self.active[i] = action
            self.turn_to(i)
        if action != self.announced[i]:
            self.announce(i)

    def announce(self, i):
        self.announced[i] = self.active[i]
        self.network.publish(i, ("chases", self.active[i]), size=24)


def arrivals(trace):
    """Return sender, receivers, and times of sending and of arrival of all broadcasts, and all losses."""
    sent = [(event.t, event.src, event.dst, event.arrival) for event in trace.of(Broadcast)]
    return sent, sorted((event.transmission, event.dst, event.cause) for event in trace.of(Lost))


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("step", [NS, NS // 300])
def test_the_pursuit_of_relay_over_a_stepped_network_is_that_of_desim(seed, step):
    """The network is also stepped at multiples of `step`, in between."""
    scenario = load(SCENARIOS / "relay.toml", ["record.messages=true"])
    own, native = OwnPursuit(scenario, seed, step).play(), run(scenario, seed).trace
    assert own.decided == [(event.t, event.pursuer, event.active) for event in native.of(Decided)]
    (captured,) = native.of(Captured)
    assert own.captured == (pytest.approx(captured.t / NS, abs=1e-6), captured.capturer)
    assert arrivals(own.trace) == arrivals(native)
    assert len(native.of(Broadcast)) > 300
    for event, (t, places) in zip(native.of(Sampled)[1:-1], own.places, strict=False):
        there = [complex(*place) for place in (*event.evaders, *event.pursuers)]
        assert (event.t, there) == (t, pytest.approx(places, abs=1e-6))


@pytest.mark.whole
def test_another_latency_or_seed_is_another_pursuit():
    scenario = load(SCENARIOS / "relay.toml", ["record.messages=true"])
    own = OwnPursuit(scenario, 3, NS).play()
    late = OwnPursuit(load(SCENARIOS / "relay.toml", ["network.latency=0.2"]), 3, NS).play()
    assert late.decided != own.decided
    assert arrivals(late.trace) != arrivals(own.trace)
    native = run(scenario, 4).trace
    assert arrivals(native) != arrivals(own.trace)

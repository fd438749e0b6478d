"""One kind of each family as a user writes it: a single module outside of desim, named in files as `own_kinds:Name`."""

from typing import ClassVar, Literal

import networkx as nx
import numpy as np

from desim import Fault
from desim.config.model import Duration, Probability, Value
from desim.pursuit.byzantine.lies import ByzantineFault
from desim.pursuit.motion.dynamics import Course, Piece
from desim.pursuit.team.announcements import Assignment
from desim.pursuit.team.judges import Judge


class Eager(Value):
    """A protocol: chase, and say so."""

    def __call__(self, me):
        while True:
            yield me.sleep(0.2 + 0.1 * me.id)
            me.assign(True)
            me.announce()


class Staggered(Value):
    """A schedule: revise once a period, each pursuer a little later than the one before."""

    wait: Duration = 0.5

    def mean_slot(self, me):
        return self.wait

    def __call__(self, me, revise):
        yield me.sleep(0.01 * (1 + me.id))
        while True:
            revise()
            yield me.sleep(self.wait)


class Sawtooth(Value):
    """A latency that grows with the number of the receiver."""

    step: Duration = 0.01

    def __call__(self, context, rng):
        return self.step * (1 + np.asarray(context.dst))


class Fog(Value):
    """A loss with a cause of its own."""

    p: Probability = 0.5
    cause: ClassVar[str] = "fog"

    def __call__(self, context, rng):
        return rng.random(len(context.dst)) < self.p


class LinkDown(Fault):
    """A fault: one link is down."""

    ends: tuple[int, int]
    cause: ClassVar[str] = "cable"

    def named(self):
        return {"ends": self.ends}

    def sketch(self):
        return {"groups": [[self.ends[0]], [self.ends[1]]]}

    @classmethod
    def random_parameters(cls, draw):
        return {"ends": tuple(map(int, draw.rng.choice(draw.size, 2, replace=False)))}

    def begin(self, site):
        return site.block(lambda src, dst: {src, dst} == {*self.ends})


def storm(size, horizon, rng):
    """Draw own faults at random: a plan."""
    start = float(rng.uniform(0.0, horizon / 2.0))
    yield LinkDown(start=start, end=start + 0.5, ends=(0, size - 1))


class Lag(Value):
    """A body that takes a commanded velocity after a fixed distance: here at once, but with a heading."""

    is_simple: ClassVar[bool] = False

    def __call__(self, position, course, command):
        heading = command / abs(command) if command else course.heading
        return Piece(position, Course(command, heading))

    def headings(self, rng, count):
        return [1.0 + 0j] * count

    def steered(self, command, course, aim, radius):
        return command

    def capture_times(self, offsets, courses, speeds, evader_speed, radius):
        gap, closing = np.maximum(np.abs(offsets) - radius, 0.0), speeds - evader_speed
        return np.where(closing > 0.0, gap / np.where(closing > 0.0, closing, 1.0), np.where(gap > 0.0, np.inf, 0.0))


def feint(state, rng):
    """Flee to the north: an evader's strategy."""
    return 1j


def events_per_second(result):
    """Return the number of events per second: a metric."""
    return len(result.trace) / result.scenario.horizon


class Edges(Value):
    """An exporter: who sent to whom."""

    suffix: ClassVar[str] = ".edges"
    items: ClassVar[str] = "edges"
    directed: bool = True

    def __call__(self, result, file):
        links = [(each.src, dst) for each in result.trace if hasattr(each, "fates") for dst, _ in each.fates()]
        links = sorted(set(links if self.directed else [tuple(sorted(link)) for link in links]))
        file.write_text("".join(f"{src} {dst}\n" for src, dst in links))
        return len(links)


class Sceptic(Value):
    """A trust: believe nobody with a number above a limit."""

    limit: int = 1
    period: ClassVar[float | None] = None

    def judge(self, witness):
        judge = Judge()
        judge.believes = lambda record: record.src <= self.limit
        return judge


class Wind(Value):
    """A flow."""

    speed: float = 0.1
    top_speed: ClassVar[float] = 1.0
    shape: Literal["east", "north"] = "east"

    def __call__(self, places, t):
        return np.full(len(places), self.speed * (1.0 if self.shape == "east" else 1j))


class Sleeper(ByzantineFault):
    """A Byzantine fault: a pursuer announces that it is inactive."""

    def says(self, me, body):
        return me.id, Assignment(0)


class Margin(Value):
    """A utility: the gain over the fastest of the others, and a bonus."""

    scope: ClassVar[str] = "heard"
    bonus: float = 0.0

    def __call__(self, own_time, other_times, reward):
        return min([*other_times, reward]) - own_time + self.bonus


class Warm(Value):
    """A temperature: 1/tau grows with the number of slots."""

    rate: float = 0.1

    def __call__(self, eta):
        return self.rate * eta


def straight(gaps, aims, evader_velocity, speeds):
    """Head for the evader: a guidance."""
    return aims * speeds / np.maximum(np.abs(aims), 1e-9)


class Grain(Value):
    """A noise that is the same in all directions."""

    deviation: float = 0.1

    def __call__(self, offset, first, second):
        return offset + self.deviation * complex(first, second)

    def covariance(self, offset):
        return self.deviation**2, 0.0, self.deviation**2


class Stutter(Value):
    """A dissemination: each announcement is published several times."""

    times: int = 2

    def broadcast(self, me, announcement):
        for _ in range(self.times):
            me.publish(announcement)

    def __call__(self, me):
        yield from ()


def wheel(size):
    """Return a graph: a ring, and its centre."""
    return nx.wheel_graph(size)


class Ramp(Value):
    """A reception that falls with the distance."""

    slope: float = 1.0

    def __call__(self, distances, range):  # noqa: A002
        return np.clip(1.0 - self.slope * distances / range, 0.0, 1.0)


class Morse(Value):
    """A medium: each bit is a dot."""

    dot: Duration = 1e-5
    shared: ClassVar[bool] = False
    half_duplex: ClassVar[bool] = False
    queue_limit: ClassVar[float] = 100

    def __call__(self, size):
        return 8 * size * self.dot


class Lottery(Value):
    """An interference: of the frames that overlap every other one is received."""

    every: int = 2
    needs_positions: ClassVar[bool] = False
    has_noise: ClassVar[bool] = False

    def __call__(self, overlap):
        return np.full(len(overlap.receivers), overlap.frame.number % self.every == 0)

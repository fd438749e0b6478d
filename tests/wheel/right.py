"""A script that uses all that the README shows, with the types that a strict type checker demands."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from desim import (
    Bernoulli,
    Constant,
    Crash,
    Evader,
    Links,
    Lognormal,
    Recording,
    Result,
    Scenario,
    Team,
    run,
    summary,
    sweep,
)
from desim.analysis.metrics import Metric, end_time, handovers
from desim.config.model import Probability, Time, Value
from desim.kernel.core.link_context import LinkContext
from desim.pursuit.evaders.observation import EvaderObservation
from desim.pursuit.team.agent import Agent, Process
from protocols import CBBA, Poisson, SpatialAdaptivePlay
from protocols.rule import LearningRule, argmax


def nearest_only(me: Agent) -> Process:
    """Chase if no known teammate would be faster."""
    while True:
        yield me.sleep(0.1 * me.rng.uniform(0.5, 1.5))
        me.assign(all(me.capture_time() <= phi for phi in me.believed_chasers().values()))
        me.announce()


class Stubborn(LearningRule):
    """The best action or, with a probability, the same as before."""

    assumes: ClassVar[tuple[str, ...]] = ("no_crashes",)
    inertia: Probability = 0.3
    """Probability of no change, in [0, 1]."""

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the chosen action at each turn."""
        while True:
            stubborn = me.rng.random() < self.inertia
            yield me.action if stubborn else argmax(self.utilities(me))


class Spiky(Value):
    """Mostly 20 ms; now and then much longer, for each receiver by itself."""

    share: Probability = 0.05
    """Probability of a slow message, in [0, 1]."""
    slow: Time = 1.0
    """Its one-way latency, s."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> npt.NDArray[np.float64]:
        """Return the latencies, s."""
        return np.where(rng.random(len(context.dst)) < self.share, self.slow, 0.02)


def circling(state: EvaderObservation, rng: np.random.Generator) -> complex:
    """Round the nearest pursuer, anticlockwise."""
    if state.nearest < 0:
        return 0j
    away = complex(state.offsets[state.nearest])
    return 1j * away / abs(away) if away else 0j


def handovers_per_second(result: Result) -> float:
    """Return the rate of hand-overs, 1/s."""
    return handovers(result) / end_time(result)


rate = Metric(handovers_per_second, "1/s", "over the whole run")
scenario = Scenario(
    name="mine",
    horizon=2.0,
    team=Team(count=6),
    protocol=SpatialAdaptivePlay(schedule=Poisson(rate=5.0)),
    network=Links(latency=Lognormal(mean=0.2, cv=0.5), loss=Bernoulli(p=0.1), range=15.0),
    fault=(Crash(node=5, start=1.0, end=2.0),),
    record=Recording(messages=True),
)
active: float = summary(run(scenario, seed=7)).active_time

short = Scenario(horizon=1.0, team=Team(count=4), protocol=nearest_only)
ruled = Scenario(horizon=1.0, team=Team(count=4), protocol=Stubborn(inertia=0.5))
spiky = Scenario(horizon=1.0, network=Links(latency=Spiky(share=0.2)), evader=Evader(strategy=circling))
pair = Scenario(horizon=1.0, protocol=CBBA(), network=Links(latency=Constant(value=0.1)), evader=Evader(count=2))
for each in (short, ruled, spiky, pair):
    result: Result = run(each, 7)
    measured = summary(result, {"rate": rate})
    print(each.name, measured["rate"], measured.captured, len(result.trace))

swept = sweep(
    short, {"network.latency.value": [0.0, 0.1], "team.count": [3, 4]}, reps=2, executor=1, metrics={"rate": rate}
)
print(swept.table(["active_time", "rate"]))
for group, cell in zip(swept.groups, swept.estimates("active_time"), strict=True):
    print(group.settings, cell.mean, cell.half_width)
changed = short.model_copy(update={"horizon": 0.5})
print(summary(run(changed)).end_time)

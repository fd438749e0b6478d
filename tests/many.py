"""Games with several evaders: all at rest, or easily captured."""

import numpy as np

from desim import Scenario
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.core.events import BrokeDown, Decided, Started
from desim.pursuit.motion.capture import capture_time
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording

LOSSY = Links(loss=Bernoulli(p=0.2), latency=Constant(value=0.03))
"""A fifth is lost, and all is late, s."""


def at_rest(protocol, pursuers, evaders, seed=0, **changes):
    """Return a frozen game in a box of 20 m, r = 30 s, on an ideal network: random places and speeds, v_e = 0.5 m/s.

    About a tenth of the pursuers can never capture.
    """
    rng = np.random.default_rng([seed, pursuers, evaders])
    given = {
        "seed": seed,
        "horizon": 30.0,
        "team": Team(count=pursuers, speeds=rng.uniform(0.4, 2.0, pursuers).tolist(), active_at_start=0.5),
        "evader": Evader(count=evaders, box=(0.0, 20.0), speed=0.5),
        "motion": Motion(static=True),
        "protocol": protocol,
        "record": Recording(trajectory=0.0),
    }
    return Scenario(**(given | changes))


def easy(protocol, seed=0, **changes):
    """Return a pursuit of three evaders by six pursuers that are four times as fast, in a box of 4 m."""
    given = {
        "seed": seed,
        "horizon": 20.0,
        "team": Team(count=6, box=(0.0, 4.0), speeds=2.0, active_at_start=0.5),
        "evader": Evader(count=3, box=(0.0, 4.0), speed=0.5),
        "motion": Motion(step=0.05),
        "protocol": protocol,
        "record": Recording(trajectory=0.0, messages=True),
    }
    return Scenario(**(given | changes))


def times(result):
    """Return (N, M) every pursuer's phi of every evader as a run begins, s."""
    start, scenario = result.trace.of(Started)[0], result.scenario
    columns = [
        capture_time(place, start.pursuers, start.speeds, evader.speed, scenario.capture.radius)
        for place, evader in zip(start.evaders, scenario.evaders, strict=True)
    ]
    return np.column_stack(columns)


def by_evader(phi):
    """Return (N, M) times of capture as `greedy_assignment` takes them."""
    return {j: dict(enumerate(column)) for j, column in enumerate(phi.T.tolist(), start=1)}


def chased(result, at=np.inf):
    """Return which evader each pursuer chases right after an instant (s) of a run without captures, if any."""
    actions = dict(enumerate(result.trace.of(Started)[0].active))
    for event in result.trace:
        if isinstance(event, Decided | BrokeDown) and event.t <= at * 1e9 + 1:
            actions[event.pursuer] = getattr(event, "active", 0)
    return {pursuer: action for pursuer, action in actions.items() if action}

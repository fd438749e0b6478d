"""The scenarios and measurements of `python -m scenarios.many`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from desim import Evader, Result, Scenario, Team
from desim.analysis.metrics import end_time
from desim.analysis.statistics import Estimate, estimate, paired, share
from desim.config.arrays import Floats
from desim.pursuit.core.events import Captured, Decided, Started
from desim.pursuit.game.game import optimum, welfare
from desim.pursuit.motion.capture import capture_time
from desim.scenario.scenario import PROTOCOLS, Motion, Recording
from protocols.schedules.periodic import SharedSeed
from protocols.temperature import ConstantTau, GeometricTau, Temperature
from scenarios.studies.study import Options

SIZES = ((3, 3), (6, 6), (6, 3), (3, 6))
"""Numbers of pursuers N and evaders M."""
HARD = (4, 4)
"""N and M of the games for the comparison of temperatures; as M = N, no spare pursuer can correct a poor assignment."""
HORIZON = 15.0
"""Horizon t_f, s. In the static game the reward r, the time left, is always t_f."""
BOX = (0.0, 20.0)
"""Interval of both initial coordinates, m."""
SPEED = 2.0
"""Speed of the pursuers, m/s; evaders have the speed of the paper."""
GAMES_PER_RUN = 3
"""Number of static games of size `HARD` per run requested with --runs."""
BUDGETS = (30, 100, 300, 1000)
"""Numbers of slots for negotiation in a static game."""
BUDGET = 300
"""Number of slots in all static games but those for the comparison of `BUDGETS`."""
TEMPERATURES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Constant temperatures, s."""
HOT, COLD = 5.0, 0.05
"""First and last temperature of cooling, s. `HOT` is about the utility of a chase, `COLD` a typical difference between
utilities."""
SETTLING = 0.1
"""Share of the slots that remains after slow cooling has reached `COLD`."""
COOLING = 100
"""Number of slots for slow cooling and the settling after it, if the players move: together one second."""
SLOT = 0.01
"""Length of a slot if the players move, s."""
FAST = GeometricTau(first=HOT, ratio=0.5, floor=COLD)
"""Fast cooling: the temperature halves in every slot and is `COLD` from slot 7 on."""
CONTENDERS: Mapping[str, tuple[str, str | None]] = MappingProxyType(
    {
        "SAP, slow": ("sap", "slow"),
        "SAP, fast": ("sap", "fast"),
        "Selective SAP, slow": ("selective_sap", "slow"),
        "Selective SAP, fast": ("selective_sap", "fast"),
        "local min": ("local_min", None),
        "CBAA": ("cbaa", None),
        "CBBA": ("cbba", None),
        "centralised": ("centralised", None),
    }
)
"""By name of a contender: the kind of protocol, and its cooling. "slow" stands for `slow` and "fast" for `FAST`; None
for a protocol without a temperature."""
COOLED = tuple(name for name, (_, cooling) in CONTENDERS.items() if cooling)
REFERENCE = "SAP, slow"
Key = tuple[tuple[int, int], str, int, float | None]
"""Identifies a set of static games: (N, M); name in `CONTENDERS` or, if the temperature is constant, kind of protocol;
number of slots; constant temperature, s, or None for a contender."""


@dataclass(frozen=True)
class Outcome:
    """The result of one negotiation."""

    share: float
    """Welfare of the final profile / welfare of the best assignment; 1 if the latter is 0."""

    @property
    def best(self) -> bool:
        """Whether the welfare is that of the best assignment."""
        return self.share > 1.0 - 1e-9


@dataclass(frozen=True)
class NegotiationSummary:
    """The results of the static games of one size, protocol, number of slots and temperature."""

    pursuers: int
    evaders: int
    protocol: str
    slots: int
    temperature: float | None
    """The constant temperature, s; None for a contender of `CONTENDERS`."""
    share: Estimate
    """Mean of welfare / optimum over the games."""
    least: float
    """Least welfare / optimum of a game."""
    best: Estimate
    """Share of the games that end in the best assignment."""


@dataclass(frozen=True)
class Chase:
    """The result of one pursuit of several evaders."""

    captured: float
    """Share of the evaders captured by the horizon."""
    duration: float
    """Time until all evaders were captured, or the horizon if not all were, s."""


@dataclass(frozen=True)
class PursuitSummary:
    """The results of the pursuits of one size under one protocol."""

    pursuers: int
    evaders: int
    protocol: str
    captured: Estimate
    """Mean share of the evaders captured by the horizon."""
    all_captured: float
    """Share of the runs in which all evaders were captured."""
    duration: Estimate
    """Mean time until all evaders were captured, or the horizon if not all were, s."""
    difference: Estimate
    """Paired difference of `duration` from that of `REFERENCE`, slowly cooled Spatial Adaptive Play, s."""


def slow(slots: int) -> GeometricTau:
    """Return a cooling schedule that falls from `HOT` to `COLD` in the first (1 - `SETTLING`) * `slots` slots."""
    ratio = (COLD / HOT) ** (1.0 / ((1.0 - SETTLING) * slots))
    return GeometricTau(first=HOT, ratio=ratio, floor=COLD)


def cooled(name: str, slots: int) -> Temperature | None:
    """Return the cooling schedule of a contender, None if its protocol has none; `slots` is the argument of `slow`."""
    cooling = CONTENDERS[name][1]
    return None if cooling is None else slow(slots) if cooling == "slow" else FAST


def protocol(kind: str, slot: float, tau: Temperature | None = None) -> Any:
    """Return a protocol of a kind with slots of `slot` seconds; if it has a schedule, one pursuer decides per slot.

    If `tau` is None, the protocol has its default temperature, if any.
    """
    fields = PROTOCOLS.choices()[kind].model_fields
    settings: dict[str, Any] = {"slot": slot} if "slot" in fields else {}
    if "schedule" in fields:
        settings["schedule"] = SharedSeed(slot=slot)
    return PROTOCOLS.choices()[kind](**settings if tau is None else settings | {"tau": tau})


def moving_game(pursuers: int, evaders: int, kind: str, tau: Temperature | None = None) -> Scenario:
    """Return a pursuit of several evaders in which all players move."""
    return _game(pursuers, evaders, kind, protocol(kind, SLOT, tau), Motion())


def static_game(pursuers: int, evaders: int, kind: str, slots: int, tau: Temperature | None = None) -> Scenario:
    """Return the game of `moving_game` with all players at rest; the number of slots until the horizon is `slots`."""
    return _game(pursuers, evaders, kind, protocol(kind, HORIZON / slots, tau), Motion(static=True))


def _game(pursuers: int, evaders: int, kind: str, negotiation: Any, motion: Motion) -> Scenario:
    return Scenario(
        name=f"{kind}, {pursuers} to {evaders}",
        horizon=HORIZON,
        team=Team(count=pursuers, box=BOX, speeds=SPEED),
        evader=Evader(count=evaders, box=BOX),
        protocol=negotiation,
        motion=motion,
        record=Recording(trajectory=0.0),
    )


def capture_times(scenario: Scenario, seed: int) -> Floats:
    """Return the (N, M) capture times phi, s, at t = 0."""
    places, speeds = scenario.team.start(seed), scenario.team.all_speeds()
    columns = [
        capture_time(evader.start(seed, index), places, speeds, evader.speed, scenario.capture.radius)
        for index, evader in enumerate(scenario.evaders)
    ]
    return np.column_stack(columns)


def outcome(result: Result) -> Outcome:
    """Return the outcome of the negotiation of a static game."""
    actions = list(result.trace.of(Started)[0].active)
    for decision in result.trace.of(Decided):
        actions[decision.pursuer] = decision.active
    phi, reward = capture_times(result.scenario, result.seed), result.scenario.horizon
    best = optimum(phi, reward)
    return Outcome(welfare(phi, actions, reward) / best if best else 1.0)


def chase(result: Result) -> Chase:
    """Return the share of captured evaders and the duration of a pursuit."""
    captured = len(result.trace.of(Captured))
    return Chase(captured / len(result.scenario.evaders), end_time(result))


def run_static_games(options: Options) -> list[NegotiationSummary]:
    """Run the static games.

    All contenders are run at each size of `SIZES`. Spatial Adaptive Play (SAP) and Selective SAP are also run at the
    size `HARD`, with each cooling and number of slots, and with each constant temperature.
    """
    by_size: list[Key] = [(size, name, BUDGET, None) for size in SIZES for name in CONTENDERS]
    hard: list[Key] = [(HARD, name, slots, None) for slots in BUDGETS for name in COOLED]
    hard += [(HARD, kind, BUDGET, tau) for tau in TEMPERATURES for kind in ("sap", "selective_sap")]
    with_more_runs = replace(options, runs=GAMES_PER_RUN * options.runs)
    return run_negotiations(by_size, options) + run_negotiations(hard, with_more_runs)


def run_negotiations(keys: Sequence[Key], options: Options) -> list[NegotiationSummary]:
    """Run the static games of some keys and return their results."""
    scenarios = [
        static_game(*size, protocol_kind(name), slots, cooled(name, slots) if tau is None else ConstantTau(value=tau))
        for size, name, slots, tau in keys
    ]
    measured = options.measure(scenarios, "negotiations", outcome)
    return [summarize_negotiations(key, outcomes) for key, outcomes in zip(keys, measured, strict=True)]


def protocol_kind(name: str) -> str:
    """Return the protocol kind of a contender, or the name itself if it is a kind."""
    return CONTENDERS.get(name, (name, None))[0]


def summarize_negotiations(key: Key, outcomes: Sequence[Outcome]) -> NegotiationSummary:
    """Return the results of the static games of one key."""
    size, name, slots, tau = key
    shares = [outcome.share for outcome in outcomes]
    best = share([outcome.best for outcome in outcomes])
    return NegotiationSummary(*size, name, slots, tau, estimate(shares), min(shares), best)


def run_pursuits(options: Options) -> list[PursuitSummary]:
    """Run pursuits in which all players move: each contender at each size of `SIZES`."""
    keys = [(size, name) for size in SIZES for name in CONTENDERS]
    scenarios = [moving_game(*size, protocol_kind(name), cooled(name, COOLING)) for size, name in keys]
    runs = dict(zip(keys, options.measure(scenarios, "pursuits", chase), strict=True))
    return [summarize_pursuits(*key, runs[key], runs[key[0], REFERENCE]) for key in keys]


def summarize_pursuits(
    size: tuple[int, int], name: str, candidate: Sequence[Chase], reference: Sequence[Chase]
) -> PursuitSummary:
    """Return the results of pursuits, with the paired difference from reference runs with the same seeds."""
    durations = [run.duration for run in candidate]
    return PursuitSummary(
        *size,
        name,
        estimate([run.captured for run in candidate]),
        sum(run.captured == 1.0 for run in candidate) / len(candidate),
        estimate(durations),
        paired(durations, [run.duration for run in reference]),
    )

"""The scenarios and measurements of `python -m scenarios.start`."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from desim import Constant, Links, Recording, Result, Scenario, Team, summary
from desim.analysis.activity import evader_pursuits
from desim.analysis.metrics import active_time, excess_time
from desim.analysis.statistics import Estimate, mean, paired
from desim.analysis.trace_index import started
from desim.config.arrays import Floats
from desim.kernel.core.units import SECOND
from desim.pursuit.game.utility import Mean, Minimum
from desim.pursuit.motion.capture import capture_time
from desim.pursuit.team.announcements import STARTS, Announcements, Start
from protocols.best_response import BestResponse
from protocols.local_min import LocalMin
from protocols.sap import SpatialAdaptivePlay
from scenarios.studies import rivals_runs
from scenarios.studies.delay_runs import LAMBDA, SCHEDULES, N, static
from scenarios.studies.study import Options

TEAMS: Mapping[str, Team] = MappingProxyType({"few in time": Team(), "all in time": Team(speeds=2.5)})
"""Twenty pursuers: with the speeds of the paper, about three could capture before the horizon."""
RULES = MappingProxyType({"sap": SpatialAdaptivePlay(), "best_response": BestResponse(), "local_min": LocalMin()})
LATENCIES = (0.0, 0.1, 0.5)
"""One-way latencies, s."""
UTILITIES = MappingProxyType({"mean": Mean(), "minimum": Minimum()})
LONG = LATENCIES[-1]
DELAYS = (0.0, 1.0, 4.0, 16.0)
"""Values of L lambda in the static games; see `scenarios.delay`."""
CLOCKS = ("poisson", "shared_seed")


@dataclass(frozen=True)
class Cell:
    """The cost of latency under one rule, in one team, with one start."""

    team: str
    rule: str
    start: Start
    prompt: Estimate
    """Active time without latency, s."""
    costs: tuple[Estimate, ...]
    """Paired differences of the active time at the other `LATENCIES`, s."""


@dataclass(frozen=True)
class Share:
    """Which pursuers cause the cost of the latency `LONG` under best response, where few could capture in time."""

    utility: str
    start: Start
    late: Estimate
    """Increase of the active time of the pursuers that could not capture before the horizon at the start, s."""
    in_time: Estimate
    """Increase of the active time of all other pursuers, s."""


@dataclass(frozen=True)
class Extra:
    """The excess that announcing the first actions adds to that of a game at rest with a known start, in N^2 delta."""

    schedule: str
    delay: float
    """L lambda."""
    difference: Estimate
    expected: float
    """In theory, (1 - 1 / N) L lambda."""


@dataclass(frozen=True)
class Worth:
    """The active time that the messages of a rule save at the latency `SHOWN` of `scenarios.rivals`.

    A team that announces its actions is compared with a team that knows the same at the start and is then silent.
    """

    rule: str
    start: Start
    speaking: Estimate
    """Active time of the team that announces its actions, s."""
    silent: Estimate
    """Active time of the silent team, s."""
    saved: Estimate
    """Paired difference of the two times per transmission of the speaking team, s; a quotient of means."""


def pursuit(team: str, protocol: object, start: Start, latency: float) -> Scenario:
    """Return a pursuit in which all are active at first."""
    return Scenario(
        name="start",
        team=TEAMS[team],
        protocol=protocol,
        announce=Announcements(start=start),
        network=Links(latency=Constant(value=latency)),
        record=Recording(trajectory=0.0),
    )


def measure_costs(options: Options) -> list[Cell]:
    """Measure the cost of latency for each team, rule and start."""
    keys = [(team, rule, start) for team in TEAMS for rule in RULES for start in STARTS]
    scenarios = [pursuit(team, RULES[rule], start, latency) for team, rule, start in keys for latency in LATENCIES]
    active_times = iter(options.measure(scenarios, "latencies", active_time))
    cells = []
    for key in keys:
        prompt, *delayed = (next(active_times) for _ in LATENCIES)
        cells.append(Cell(*key, mean(prompt), tuple(paired(times, prompt) for times in delayed)))
    return cells


def measure_shares(options: Options) -> list[Share]:
    """Measure which pursuers cause the cost of latency, under two utilities."""
    keys = [(utility, start) for utility in UTILITIES for start in STARTS]
    scenarios = [
        pursuit("few in time", BestResponse(utility=UTILITIES[utility]), start, latency)
        for utility, start in keys
        for latency in (0.0, LONG)
    ]
    times = iter(options.measure(scenarios, "who chases", times_by_ability))
    shares = []
    for key in keys:
        prompt, delayed = np.array(next(times)), np.array(next(times))
        late, in_time = (paired(delayed[:, k], prompt[:, k]) for k in range(2))  # the columns of `times_by_ability`
        shares.append(Share(*key, late, in_time))
    return shares


def measure_worth(options: Options) -> list[Worth]:
    """Measure what a message is worth, with equal initial knowledge of the speaking and the silent team."""
    keys = [(rule, start) for rule in ("sap", "local_min") for start in STARTS]
    scenarios = [speaking(*key, trigger=trigger) for key in keys for trigger in ("heartbeat", "never")]
    measured = iter(options.measure(scenarios, "messages", times_and_transmissions))
    worth = []
    for key in keys:
        (times, sent), (silent_times, first) = (np.array(next(measured)).T for _ in range(2))
        worth.append(Worth(*key, mean(times), mean(silent_times), quotient(silent_times - times, sent - first)))
    return worth


def speaking(rule: str, start: Start, *, trigger: str) -> Scenario:
    """Return the scenario "paper" of `scenarios.rivals` with another start and another trigger of announcements."""
    game = rivals_runs.scenario("paper", rule, rivals_runs.SHOWN)
    return game.model_copy(update={"announce": game.announce.model_copy(update={"start": start, "trigger": trigger})})


def times_and_transmissions(result: Result) -> tuple[float, float]:
    """Return the active time, s, and the number of transmissions of a run."""
    return active_time(result), float(summary(result).transmissions)


def quotient(numerators: Floats, denominators: Floats) -> Estimate:
    """Return the quotient of two means over the same runs, with the standard error of the delta method."""
    ratio = numerators.mean() / denominators.mean()
    return mean(ratio + (numerators - ratio * denominators) / denominators.mean())


def measure_law(options: Options) -> list[Extra]:
    """Measure the excess in static games in which all could capture in time, with announced and known first actions."""
    slot = 1.0 / (N * LAMBDA)
    keys = [(schedule, delay) for schedule in CLOCKS for delay in DELAYS]
    scenarios = [
        static(SCHEDULES[name](slot), x / LAMBDA, start) for name, x in keys for start in ("announced", "known")
    ]
    times = iter(options.measure(scenarios, "static games", excess_time))
    unit = N * N * slot
    extras = []
    for name, x in keys:
        announced, at_start = (np.array(next(times)) / unit for _ in range(2))
        extras.append(Extra(name, x, paired(announced, at_start), (1.0 - 1.0 / N) * x))
    return extras


def times_by_ability(result: Result) -> tuple[float, float]:
    """Return the active time, s, of the pursuers with phi >= r at the start, and that of all others."""
    start, scenario = started(result), result.scenario
    (evader,) = scenario.evaders
    phi = capture_time(start.evaders[0], start.pursuers, start.speeds, evader.speed, scenario.capture.radius)
    times = active_times(result)
    are_late = [phi_of_one >= scenario.horizon for phi_of_one in phi.tolist()]
    of_late_ones = sum_of(time for time, is_late in zip(times, are_late, strict=True) if is_late)
    return of_late_ones, sum_of(times) - of_late_ones


def active_times(result: Result) -> list[float]:
    """Return the active time of each pursuer, s, in a pursuit of one evader."""
    (chase,) = evader_pursuits(result)
    times = [chase.end * is_active for is_active in chase.start]
    for t, pursuer, step in chase.steps:  # a step is 1 if the pursuer becomes active, and -1 if inactive
        times[pursuer] += step * (chase.end - t)
    return [time / SECOND for time in times]


def sum_of(times: Iterable[float]) -> float:
    """Return a sum of times, s."""
    return float(np.sum(np.fromiter(times, float)))

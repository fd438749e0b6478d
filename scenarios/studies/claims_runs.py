"""The measurements of the numbers in `scenarios.studies.claims`; each of them is a `Number`, made by a function."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce, wraps
from math import isnan, nan
from types import MappingProxyType
from typing import Any, Concatenate, ParamSpec

import numpy as np

from desim import Constant, Evader, Links, Motion, PureEvasion, Result, Scenario, Team, bench, load, run
from desim.analysis.metrics import active_time, end_time, excess_time, idle_time
from desim.analysis.statistics import Estimate, mean, paired
from desim.analysis.statistics import share as share_of
from desim.pursuit.core.events import Estimated, Sampled
from desim.pursuit.team.announcements import Announcements, Start
from desim.pursuit.team.targeted_faults import ChaserCrash
from desim.study.ablation.imperfections import IMPERFECTIONS, with_perfect_network, without_messages
from desim.study.comparing.suite import AS_IT_IS
from protocols.best_response import BestResponse
from protocols.centralised import Centralised
from protocols.rule import Rule
from scenarios.studies import (
    bodies_runs,
    coherence_runs,
    contention_runs,
    delay_runs,
    evaders_runs,
    learning_runs,
    liars_runs,
    many_runs,
    range_runs,
    start_runs,
    table1_runs,
    transport_runs,
)
from scenarios.studies.coverage_runs import LAWS, coverage
from scenarios.studies.study import SCENARIOS, Options

Measured = tuple[float, float]
"""The mean of a number, and the half width of its 95 % interval."""
Number = Callable[[Options], Measured]
"""Measures a number."""
Parameters = ParamSpec("Parameters")
STUDIES = 50
"""The number of sequential studies for each run of other claims."""
UNIT = delay_runs.LAMBDA / delay_runs.N
"""1 / (N^2 delta), 1/s."""


def number(measure: Callable[Concatenate[Options, Parameters], Measured]) -> Callable[Parameters, Number]:
    """Return a function that binds all arguments of a measurement except the options.

    For example, `share(captured, scenario)` is a number in the table of claims, to be measured with some options.
    """

    @wraps(measure)
    def prepared(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Number:
        return lambda options: measure(options, *args, **kwargs)

    return prepared


def of(estimate: Estimate, scale: float = 1.0) -> Measured:
    """Return the mean and the half width of an estimate, multiplied by a factor."""
    return scale * estimate.mean, abs(scale) * estimate.half_width


def average(metric: Callable[[Any], float], scenario: Scenario, scale: float = 1.0) -> Number:
    """Return the measurement of the mean of a metric over runs."""
    return lambda options: of(mean(options.measure([scenario], "", metric)[0]), scale)


def difference(metric: Callable[[Any], float], minuend: Scenario, subtrahend: Scenario, scale: float = 1.0) -> Number:
    """Return the measurement of the paired difference of a metric between two scenarios."""
    return lambda options: of(paired(*options.measure([minuend, subtrahend], "", metric)), scale)


@number
def share(options: Options, metric: Callable[[Any], bool], scenario: Scenario) -> Measured:
    """Measure the share of runs for which a metric is true, with half of its Wilson interval."""
    return of(share_of(options.measure([scenario], "", metric)[0]))


@number
def covered(options: Options, law: str, size: int, first_look: int) -> Measured:
    """Measure the share of sequential studies whose interval covers the mean; see `scenarios.coverage`."""
    studies = STUDIES * options.runs
    measured = coverage(LAWS[law], size, first_look, studies, options.seed)
    return in_trials(round(measured.share * studies), studies)


def in_trials(count: int, trials: int) -> Measured:
    """Return a share, and half the width of its Wilson interval."""
    return of(share_of([True] * count + [False] * (trials - count)))


def cost(team: str, rule: str, latency: float, start: Start = "announced") -> Number:
    """Return the measurement of how much active time a latency costs in `scenarios.start`."""
    delayed, prompt = (start_runs.pursuit(team, start_runs.RULES[rule], start, delay) for delay in (latency, 0.0))
    return difference(active_time, delayed, prompt)


@number
def worth(options: Options, rule: str, start: Start) -> Measured:
    """Measure the active time that a message of a rule saves, ms."""
    teams = [start_runs.speaking(rule, start, trigger=trigger) for trigger in ("heartbeat", "never")]
    speaking, silent = (np.array(runs).T for runs in options.measure(teams, "", start_runs.times_and_transmissions))
    return of(start_runs.quotient(silent[0] - speaking[0], speaking[1] - silent[1]), 1000.0)


def increase(start: Start, *, whole: bool) -> Number:
    """Return the measurement of the active time that a latency of 0.5 s adds if few pursuers could capture in time.

    With `whole`, all pursuers count, otherwise only those that could not capture in time at the start.
    """
    rule = BestResponse(utility=start_runs.UTILITIES["mean"])
    delayed, prompt = (start_runs.pursuit("few in time", rule, start, delay) for delay in (start_runs.LONG, 0.0))
    return difference(active_time if whole else time_of_late_ones, delayed, prompt)


def time_of_late_ones(result: Result) -> float:
    """Return the active time of the pursuers that could not capture in time at the start, s."""
    return start_runs.times_by_ability(result)[0]


def announcing(schedule: str, delay: float) -> Number:
    """Return the measurement of what announcing first actions adds to the excess of a static game, in N^2 delta."""
    game = delay_runs.SCHEDULES[schedule](1.0 / (delay_runs.N * delay_runs.LAMBDA))
    announced, at_start = (
        delay_runs.static(game, delay / delay_runs.LAMBDA, start) for start in ("announced", "known")
    )
    return difference(excess_time, announced, at_start, UNIT)


def excess(schedule: str) -> Number:
    """Return the measurement of the excess of a static game without latency, in N^2 delta."""
    game = delay_runs.SCHEDULES[schedule](1.0 / (delay_runs.N * delay_runs.LAMBDA))
    return average(excess_time, delay_runs.static(game, 0.0), scale=UNIT)


def of_table1(count: int, slot: float) -> Number:
    """Return the measurement of a decentralised cell of Table I."""
    return average(active_time, table1_runs.decentralised(table1_runs.configuration(count), slot))


def explained(metric: Callable[[Any], float], part: str | None = None, scale: float = 1.0) -> Number:
    """Return the measurement of what an imperfection of `imperfect.toml` costs in a metric; None: all together."""
    game = load(SCENARIOS / "imperfect.toml")
    removed = [IMPERFECTIONS[part]] if part else IMPERFECTIONS.values()
    return difference(metric, game, reduce(lambda so_far, remove: remove(so_far), removed, game), scale)


def bounds_of_imperfect() -> tuple[Number, Number]:
    """Return the measurement of the active time of `imperfect.toml` on a perfect network, and what silence adds."""
    game = load(SCENARIOS / "imperfect.toml")
    perfect, silent = with_perfect_network(game), without_messages(game)
    return average(active_time, perfect), difference(active_time, silent, perfect)


def raced(rate: float) -> Scenario:
    """Return the relay of a race, with pursuers that decide at a rate, 1/s."""
    changes = {"team.count": 8, "network.latency": 0.3, "horizon": 20.0, "protocol.schedule.rate": rate}
    return load(SCENARIOS / "relay.toml").with_(changes)


def late_bench(slot: float) -> Scenario:
    """Return the scenario of the benchmark with a latency of 1 s, under `argmin` with a slot, s."""
    return load(SCENARIOS / "bench/v1/latency.toml", [f'protocol={{ kind = "argmin", slot = {slot} }}'])


@number
def unsettled(options: Options, team: str, distance: float) -> Measured:
    """Measure the share of games without an equilibrium if pursuers count their neighbours only."""
    return of(range_runs.games(team, distance, options).unsettled)


def lost_by(protocol: str, access: str, load: float, start: Start = "announced", scale: float = 1.0) -> Number:
    """Return the measurement of the active time lost by an access model."""
    contended, reference = (
        contention_runs.pursuit(protocol, medium, load) for medium in (access, contention_runs.REFERENCE)
    )
    return difference(active_time, started(contended, start), started(reference, start), scale)


def started(scenario: Scenario, start: Start) -> Scenario:
    """Return a scenario with another way in which first actions become known."""
    return scenario.model_copy(update={"announce": scenario.announce.model_copy(update={"start": start})})


@number
def over_before_the_second(options: Options, spreading_factor: int) -> Measured:
    """Measure the share of pursuits over LoRa that end before a pursuer may announce a second time."""
    pursuits = contention_runs.lora_pursuits(spreading_factor, options)
    return in_trials(round(pursuits.over * options.runs), options.runs)


@number
def transported(options: Options, /, way: str | None, scale: float = 1.0, **setting: Any) -> Measured:
    """Measure the active time of a way to announce minus that of heartbeats; way None: the time of heartbeats."""
    links = transport_runs.Setting(**setting)
    (reliable,) = options.measure(
        [transport_runs.pursuit(links, transport_runs.RELIABLE)], "", transport_runs.run_of_pursuit
    )
    budget = transport_runs.budget_of(reliable)
    ways = [way or transport_runs.HEARTBEATS, transport_runs.HEARTBEATS]
    games = [transport_runs.pursuit(links, way_of_game, budget) for way_of_game in ways]
    values, reference = (
        [run.value for run in runs] for runs in options.measure(games, "", transport_runs.run_of_pursuit)
    )
    return of(mean(reference) if way is None else paired(values, reference), scale)


def retransmitting_saves(channel: str) -> Number:
    """Return the measurement of the active time that retransmitting saves on a channel, against announcing once."""
    once, repeated = (coherence_runs.pursuit(channel, way) for way in (transport_runs.ONCE, transport_runs.RELIABLE))
    return difference(active_time, once, repeated)


@number
def age(options: Options, way: str) -> Measured:
    """Measure the age of information of a way to announce with 30 % loss."""
    setting, metric = transport_runs.Setting(), transport_runs.run_at_rest
    (reliable,) = options.measure([transport_runs.at_rest(setting, transport_runs.RELIABLE)], "", metric)
    game = transport_runs.at_rest(setting, way, transport_runs.budget_of(reliable))
    (runs,) = options.measure([game], "", metric)
    return of(mean([run.value for run in runs]))


def delayed_by(protocol: str, lie: str) -> Number:
    """Return the measurement of the time by which one liar delays the capture."""
    lying, honest = (
        liars_runs.scenario_of("lies", protocol, kind_of_lie, "none", 1.0) for kind_of_lie in (lie, liars_runs.HONEST)
    )
    return difference(end_time, lying, honest)


@number
def price(options: Options, defence: str) -> Measured:
    """Measure the share of active time that a defence costs a team without liars."""
    worst = liars_runs.WORST
    games = [liars_runs.scenario_of("numbers", "local_min", worst, policy, 0.0) for policy in (defence, "none")]
    times, reference = (np.array(runs) for runs in options.measure(games, "", active_time))
    return of(start_runs.quotient(times - reference, reference))


def of_latency(latency: float, motion: str) -> Number:
    """Return the measurement of how much active time a latency costs a body."""
    delayed, prompt = (bodies_runs.pursuit(bodies_runs.ONE, motion, delay) for delay in (latency, 0.0))
    return difference(active_time, delayed, prompt)


@number
def of_inertia(options: Options, latency: float, motion: str) -> Measured:
    """Measure how much more active time a latency costs a body with inertia than a body with simple motion."""
    games = [
        bodies_runs.pursuit(bodies_runs.ONE, kind_of_motion, delay)
        for kind_of_motion in (motion, bodies_runs.SIMPLE)
        for delay in (latency, 0.0)
    ]
    delayed, prompt, simple_delayed, simple_prompt = (
        np.array(times) for times in options.measure(games, "", active_time)
    )
    return of(paired(delayed - prompt, simple_delayed - simple_prompt))


def all_at_once(latency: float, motion: str) -> Number:
    """Return the measurement of how much more active time a body needs if all decide at once."""
    at_once, in_turn = (bodies_runs.pursuit(rule, motion, latency) for rule in (bodies_runs.ALL, bodies_runs.ONE))
    return difference(active_time, at_once, in_turn)


@number
def per_handover(options: Options, motion: str, latency: float) -> Measured:
    """Measure the active time in excess of one pursuer per handover."""
    game = bodies_runs.pursuit(bodies_runs.ONE, motion, latency)
    (runs,) = options.measure([game], "", bodies_runs.handovers)
    return of(bodies_runs.ratio([run.excess for run in runs], [run.number for run in runs]))


def survives(protocol: str) -> Number:
    """Return the measurement of how much longer an evader survives if it flees the active pursuers only."""
    misled, reference = (
        evaders_runs.chase(strategy, protocol) for strategy in (evaders_runs.CLAIMED, evaders_runs.REFERENCE)
    )
    return difference(end_time, misled, reference)


def inferring(interval: float, error: float = 0.0, scale: float = 1.0) -> Number:
    """Return the measurement of how much longer an evader survives if it infers from motion whom to flee."""
    game = Scenario(protocol="local_min", network=Links(latency=Constant(value=0.1)))
    active = Evader(strategy=PureEvasion(flees_from="active"), motion_interval=interval, motion_error=error)
    return difference(end_time, game.model_copy(update={"evader": active}), game, scale)


def watched_saving(kind: str) -> Number:
    """Return the measurement of the active time that a kind of estimate saves, compared with "hold"."""
    return difference(active_time, evaders_runs.watched(2.0, evaders_runs.HELD), evaders_runs.watched(2.0, kind))


def finds_best(name: str) -> Number:
    """Return the measurement of how often four pursuers find the best assignment to four evaders in 1000 slots."""
    kind, tau = many_runs.protocol_kind(name), many_runs.cooled(name, 1000)
    game = many_runs.static_game(*many_runs.HARD, kind, 1000, tau)
    return share(is_best, game)


def is_best(result: Any) -> bool:
    """Return whether a negotiation has found the best assignment."""
    return many_runs.outcome(result).best


def chase_of_many(name: str) -> Scenario:
    """Return a pursuit of six evaders by six pursuers."""
    return many_runs.moving_game(6, 6, many_runs.protocol_kind(name), many_runs.cooled(name, many_runs.COOLING))


def noisy(diffusion: float, fusion: str, offset: float = 0.0) -> Scenario:
    """Return `noisy.toml` with a diffusion of the velocity, m/s per sqrt(s), a fusion, and offsets of clocks, s."""
    faults = [{"kind": "clock_skew", "offset": offset}] if offset else []
    changes = {"sensing.fusion": fusion, "sensing.estimator.velocity_diffusion": diffusion, "fault": faults}
    return load(SCENARIOS / "noisy.toml").with_(changes)


@number
def consistency(options: Options, diffusion: float, fusion: str = "by_stamp", offset: float = 0.0) -> Measured:
    """Measure the normalised squared error of `noisy`, over the runs in which a position is estimated."""
    (errors,) = options.measure([noisy(diffusion, fusion, offset)], "", normalised_error)
    return of(mean([error for error in errors if not isnan(error)]))


def normalised_error(result: Result) -> float:
    """Return the mean normalised squared error of the estimated positions of the evader; nan if none was estimated."""
    positions = {sample.t: sample.evaders[0] for sample in result.trace.of(Sampled)}
    errors = []
    for estimated in result.trace.of(Estimated):
        if estimated.t in positions:
            x, y = estimated.x - positions[estimated.t][0], estimated.y - positions[estimated.t][1]
            square = estimated.yy * x * x - 2.0 * estimated.xy * x * y + estimated.xx * y * y
            errors.append(square / (estimated.xx * estimated.yy - estimated.xy**2))
    return float(np.mean(errors)) if errors else nan


def in_order(order: str) -> Scenario:
    """Return the default pursuit under `centralised`, at steps of 0.1 s in an order of motion."""
    return Scenario(protocol=Centralised(slot=0.1), motion=Motion(step=0.1, order=order))


FIVE_CRASHED = Scenario(
    team=Team(count=5),
    network=Links(latency=Constant(value=0.1)),
    announce=Announcements(heartbeat=0.34),
    fault=(ChaserCrash(start=0.6),),
)
"""Five pursuers with heartbeats each 0.34 s; their chaser crashes."""


def lossy(timeout: str) -> Scenario:
    """Return the same team under `sap`, with a loss of 0.2 and no crash; `timeout`: how long beliefs last."""
    return FIVE_CRASHED.with_({"protocol": "sap", "fault": (), "network.loss": 0.2, "announce.belief_timeout": timeout})


@number
def leaves_alone(options: Options, protocol: str, timeout: str) -> Measured:
    """Measure how often an evader whose chaser crashes is alone for 2 s longer than under `centralised`.

    There are five pursuers, heartbeats each 0.34 s, and `timeout` is how long announcements are believed.
    """
    crashed = FIVE_CRASHED.with_({"protocol": protocol, "announce.belief_timeout": timeout})
    idle, least = options.measure([crashed, FIVE_CRASHED.with_({"protocol": "centralised"})], "", idle_time)
    return in_trials(sum(time > other + 2.0 for time, other in zip(idle, least, strict=True)), len(idle))


def alone_in(scenario: Scenario, seed: int) -> Number:
    """Return the measurement of how long the evader is left alone in one run, s."""
    return lambda _: (idle_time(run(scenario, seed)), 0.0)


def broken(name: str) -> Scenario:
    """Return a scenario of the page on what breaks protocols, with its seed."""
    return load(SCENARIOS.parent / f"docs/_static/broken/{name}.toml")


@number
def alone(options: Options, name: str, changes: Mapping[str, Any] = MappingProxyType({})) -> Measured:
    """Measure how long the evader is left alone in a scenario that breaks a protocol, changed or not."""
    scenario = broken(name).with_(changes)
    return alone_in(scenario, scenario.seed)(options)


def crash_time(name: str) -> Number:
    """Return the time at which a pursuer crashes in a scenario that breaks a protocol, s."""
    return lambda _: (broken(name).fault[0].start, 0.0)


@number
def alone_in_relay(options: Options, protocol: str, *, beyond: bool = False) -> Measured:
    """Measure how long the evader is left alone in the smallest scenario of an example, s.

    With `beyond`, measure instead the margin to what the property allows: 2 s more than under `centralised`.
    """
    changes = {"network.latency": 0.1, "announce.heartbeat": 0.34, "fault": (ChaserCrash(start=4.0),), "horizon": 22.0}
    relay = load(SCENARIOS / "relay.toml").with_(changes)
    idle, least = (
        alone_in(relay.with_({"protocol": rule}), 1_000_018)(options)[0] for rule in (protocol, "centralised")
    )
    return (least + 2.0 - idle if beyond else idle), 0.0


def benchmarked(part: str, protocol: str) -> Number:
    """Return the score, the quality or the loss of a protocol in the newest version of the benchmark."""
    return lambda _: (getattr(bench().totals[protocol], part).value, 0.0)


def least_and_greatest(part: str, protocols: Sequence[str]) -> tuple[Number, Number]:
    """Return the least and the greatest amount by which protocols are behind `local_min` in the benchmark."""

    def number(choose: Callable[[list[float]], float], options: Options) -> Measured:
        reference, *others = (benchmarked(part, protocol)(options)[0] for protocol in ("local_min", *protocols))
        return choose([reference - other for other in others]), 0.0

    return partial(number, min), partial(number, max)


def runs_of_version(_: Options) -> Measured:
    """Return the number of runs of the newest version of the benchmark."""
    return bench().runs, 0.0


def outliers(protocol: str) -> Number:
    """Return the number of benchmark runs with liars that cost more than all eight pursuers chasing for 3 s."""
    return lambda _: (int(np.sum(bench().costs["liars"][protocol][AS_IT_IS] > 3.0 * 8)), 0.0)


def learning_cost(rule: Rule, latency: float) -> Number:
    """Return the measurement of the cost of a rule in the game of `scenarios.learning`, s."""
    return average(learning_runs.cost, learning_runs.scenario(rule, latency))


@number
def cost_of_learned(options: Options, trained_at: float, latency: float) -> Measured:
    """Measure the cost at a latency of the rule that `scenarios.learning` trains at another one, s.

    The training has the root seed 0, as that of the page: another seed gives another rule. Its runs are kept in `out`.
    """
    training = replace(options, name=f"check_pages.trained_{trained_at:g}", runs=1, seed=0)
    generations = learning_runs.train(training, learning_runs.notebook(training), trained_at)
    return learning_cost(learning_runs.linear(generations[-1].mean), latency)(options)


def nearest_only(me: Any) -> Any:
    """Decide as the protocol in README and how-to does."""
    while True:
        yield me.sleep(0.1 * me.rng.uniform(0.5, 1.5))
        me.assign(all(me.capture_time() <= phi for phi in [me.time_left(), *me.believed_chasers().values()]))
        me.announce()


def nearest_at_random(me: Any) -> Any:
    """Decide as the protocol of the tutorial does."""
    while True:
        yield me.sleep(me.rng.exponential(0.2))
        me.assign(all(me.capture_time() <= phi for phi in [me.time_left(), *me.believed_chasers().values()]))
        me.announce()


def fast(protocol: Any, latency: float, count: int = 20) -> Scenario:
    """Return a pursuit in which all could capture in time."""
    team = Team(count=count, speeds=2.5, active_at_start=1.0)
    return Scenario(team=team, protocol=protocol, network=Links(latency=Constant(value=latency)))

"""The numbers in README and docs that are measured, each with its measurement; for `scenarios.check_pages`."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from desim.analysis.deception import false_accusations
from desim.analysis.metrics import active_time, captured, end_time
from desim.analysis.statistics import NORMAL_975
from desim.pursuit.team.announcements import Start
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from scenarios.studies import (
    bodies_runs,
    coherence_runs,
    contention_runs,
    evaders_runs,
    learning_runs,
    liars_runs,
    range_runs,
    start_runs,
    transport_runs,
)
from scenarios.studies.claims_runs import (
    Number,
    age,
    all_at_once,
    alone,
    alone_in_relay,
    announcing,
    average,
    benchmarked,
    bounds_of_imperfect,
    chase_of_many,
    consistency,
    cost,
    cost_of_learned,
    covered,
    crash_time,
    delayed_by,
    difference,
    excess,
    explained,
    fast,
    finds_best,
    in_order,
    increase,
    inferring,
    late_bench,
    learning_cost,
    least_and_greatest,
    leaves_alone,
    lossy,
    lost_by,
    nearest_at_random,
    nearest_only,
    of_inertia,
    of_latency,
    of_table1,
    outliers,
    over_before_the_second,
    per_handover,
    price,
    raced,
    retransmitting_saves,
    runs_of_version,
    share,
    survives,
    transported,
    unsettled,
    watched_saving,
    worth,
)
from scenarios.studies.coverage_runs import FIRST_LOOKS
from scenarios.studies.study import SCENARIOS

MARKED = re.compile(r"\{([^}]*)\}")
"""A measured number in a sentence."""
PARTS = re.compile(r"(?P<mean>[+-]?[\d,]*\.?\d+)(?: %)?(?: \+- (?P<half>\d*\.?\d+))?(?P<percent> %)?")


@dataclass(frozen=True)
class Claim:
    """A sentence, or part of it, with numbers that can be measured."""

    study: str
    """Name of the study that measured it."""
    page: str
    """The path of the page in the repository."""
    sentence: str
    """The text as it is on the page, with braces around each measured number; line breaks count as spaces."""
    numbers: Sequence[Number]
    """The measurements of the numbers in braces, in order."""
    share: float = 1.0
    """Number of runs, relative to that of other claims."""
    sigmas: float = 1.0
    """Half width of a 95 % interval, in units of the number after +-; `NORMAL_975` if this is the standard error."""

    @property
    def text(self) -> str:
        """The sentence as it is on the page."""
        return self.sentence.replace("{", "").replace("}", "")

    def published(self) -> Iterator[tuple[str, float, float | None, float]]:
        """Yield the text, mean, half width (None if absent) and half a unit of the last digit of each number."""
        for text in MARKED.findall(self.sentence):
            parts = PARTS.fullmatch(text)
            if parts is None:
                raise ValueError(f"a number should be like 5, 5.0 %, or 5.0 +- 0.2, got {text!r}")
            scale, digits = 0.01 if "%" in text else 1.0, parts["mean"].replace(",", "")
            half_width = None if parts["half"] is None else scale * self.sigmas * float(parts["half"])
            yield text, scale * float(digits), half_width, scale * 0.5 * 10.0 ** -len(digits.partition(".")[2])

    def is_on_page(self) -> bool:
        """Return whether the page has the sentence."""
        return self.text in words_of(self.page)


def words_of(page: str) -> str:
    """Return the text of a page without line breaks."""
    return " ".join((SCENARIOS.parent / page).read_text(encoding="utf-8").split())


README, FINDINGS, NEGOTIATION = "README.md", "docs/explanation/findings.md", "docs/explanation/negotiation.md"
VALIDATION, GAME, TIME = "docs/explanation/validation.md", "docs/explanation/game.md", "docs/explanation/time.md"
HOWTO, FIRST, OWN = "docs/howto/protocols.md", "docs/tutorials/first_pursuit.md", "docs/tutorials/own_protocol.md"
NOTICED_LATE: dict[str, object] = {
    "seed": 2771,
    "team.count": 3,
    "network.medium": "unlimited",
    "network.latency": {"kind": "shifted_exponential", "mean": 0.8},
    "fault.0.start": 1.0,
}
"""A server with takeover that notices the crash of a chaser too late."""
RACE, BEST, BREAKING = "docs/howto/race.md", "docs/howto/which_is_best.md", "docs/howto/breaking.md"
BENCH = "docs/howto/bench.md"
COMMANDS = MappingProxyType(
    {
        "worth": "--worth",
        "law": "python -m scenarios.start --law --runs 40",
        "explain": "desim explain scenarios/imperfect.toml",
        "inference": 'sweep(Scenario(protocol="local_min")',
        "noisy": "python -m scenarios.check_pages --only noisy --seed 0",
        "affordable": "python -m scenarios.check_pages --only affordable --seed 0 --runs 400",
        "delays": "python -m scenarios.learning --delays",
        "bench": "desim bench",
        "break": "desim break relay.toml",
        "order": "python -m scenarios.check_pages --only order --seed 0 --runs 40",
        "howto": "Team(speeds=2.5), protocol=nearest_only",
        "tutorials": "sweep(",
        "race": "desim race scenarios/relay.toml",
        "decides": "desim sensitivity scenarios/bench/v1/latency.toml",
    }
)
"""For each `Claim.study` that is not the name of a module: the command that the page names beside the number."""
CLOCKS = SpatialAdaptivePlay(schedule=Poisson(rate=5.0))
BEHIND = ("sap", "best_response")
SIMPLE, RELIABLE = bodies_runs.SIMPLE, transport_runs.RELIABLE
Statement = tuple[str, Sequence[Number]]
"""The sentence of a claim, and the measurements of its numbers."""


def claims(study: str, page: str, *statements: Statement, share: float = 1.0, sigmas: float = 1.0) -> list[Claim]:
    """Return several claims of one study on one page."""
    return [Claim(study, page, *statement, share, sigmas) for statement in statements]


def crash(name: str, who: str, crashes_at: str, idle: str) -> Statement:
    """Return the row of a scenario that breaks a protocol: when a pursuer crashes, and how long the evader is alone."""
    files = f'([file](../_static/broken/{name}.toml), <a href="broken/{name}.html#t={crashes_at}">film</a>)'
    return f"{who} crashes at {{{crashes_at}}} s {files} | {{{idle}}} |", (crash_time(name), alone(name))


def row_of_race(rate: float, row: str) -> Claim:
    """Return the claim that is a row of the table of a race: the mean, and the difference from the best."""
    numbers = [average(active_time, raced(rate)), difference(active_time, raced(rate), raced(8.0))]
    return Claim("race", RACE, row, numbers)


def row_of_coverage(law: str, size: int, row: str) -> Claim:
    """Return the claim that is a row of the table of sequential studies: the shares that cover the mean."""
    return Claim("coverage", VALIDATION, row, [covered(law, size, first_look) for first_look in FIRST_LOOKS])


def row_of_start(team: str, start: Start, *cells: str) -> Claim:
    """Return the claim that is a row of the table of starts, with a cell for each of the first rules."""
    numbers = [
        number
        for rule in list(start_runs.RULES)[: len(cells)]
        for number in (
            average(active_time, start_runs.pursuit(team, start_runs.RULES[rule], start, 0.0)),
            *(cost(team, rule, latency, start) for latency in start_runs.LATENCIES[1:]),
        )
    ]
    where = {"few in time": "default speeds, few", "all in time": "`team.speeds = 2.5`, all"}[team]
    return Claim("start", NEGOTIATION, f"| {where} | {start} | {' | '.join(cells)}", numbers)


CLAIMS = (
    Claim(
        "start",
        README,
        "half a second of latency costs `local_min` {7.5 +- 0.7} s, Spatial Adaptive Play {7.2 +- 1.2} s",
        (cost("all in time", "local_min", 0.5), cost("all in time", "sap", 0.5)),
    ),
    Claim(
        "worth",
        README,
        "one of Spatial Adaptive Play saves {26.9 +- 2.0} ms of active time and one of `local_min` nothing; with a"
        " silent start, {3.8 +- 1.3} ms and {5.8 +- 1.2} ms",
        (worth("sap", "announced"), worth("sap", "silent"), worth("local_min", "silent")),
    ),
    Claim("range", README, "{39 % +- 3 %} of the games have none at a range of 8 m", [unsettled("all able", 8.0)]),
    *(
        row_of_start("few in time", *row)
        for row in (
            ("known", "{12.57}; {+1.18 +- 0.23}, {+5.47 +- 0.41}", "{12.42}; {+1.08 +- 0.21}, {+5.56 +- 0.38}"),
            (
                "silent",
                "{12.44}; {+0.19 +- 0.32}, {+1.43 +- 0.44}",
                "{12.40}; {+0.18 +- 0.30}, {+1.48 +- 0.42}",
                "{9.14}; {+0.17 +- 0.07}, {+0.74 +- 0.22}",
            ),
            (
                "announced",
                "{12.57}; {+0.07 +- 0.31}, {+1.39 +- 0.43}",
                "{12.42}; {+0.15 +- 0.28}, {+1.54 +- 0.42}",
                "{9.10}; {+0.13 +- 0.05}, {+0.72 +- 0.21}",
            ),
        )
    ),
    *(
        row_of_start("all in time", *row)
        for row in (
            ("known", "{7.88}; {+0.57 +- 0.19}, {+2.51 +- 0.55}", "{7.51}; {+0.73 +- 0.23}, {+2.78 +- 0.60}"),
            (
                "silent",
                "{7.87}; {+1.60 +- 0.36}, {+7.36 +- 1.21}",
                "{7.59}; {+1.93 +- 0.34}, {+7.66 +- 1.16}",
                "{4.75}; {+1.73 +- 0.16}, {+7.55 +- 0.73}",
            ),
            (
                "announced",
                "{7.88}; {+1.60 +- 0.37}, {+7.25 +- 1.20}",
                "{7.51}; {+1.90 +- 0.32}, {+7.66 +- 1.15}",
                "{4.61}; {+1.63 +- 0.16}, {+7.51 +- 0.71}",
            ),
        )
    ),
    Claim(
        "start",
        NEGOTIATION,
        "{4.37 +- 0.45} s of the increase of {5.56} s after a known start, and {0.50 +- 0.32} s of {1.54} s after",
        [increase(start, whole=whole) for start in ("known", "announced") for whole in (False, True)],
    ),
    Claim(
        "start",
        FINDINGS,
        "half a second of latency costs `local_min` {7.5 +- 0.7} s of active time, and SAP {7.2 +- 1.2} s",
        (cost("all in time", "local_min", 0.5), cost("all in time", "sap", 0.5)),
    ),
    Claim(
        "worth",
        FINDINGS,
        "a message of SAP saves {26.9 +- 2.0} ms of active time, if they are known, {26.5 +- 2.0} ms, and with a"
        " silent start, {3.8 +- 1.3} ms. One of `local_min` saves nothing, nothing, and {5.8 +- 1.2} ms",
        (*(worth("sap", start) for start in ("announced", "known", "silent")), worth("local_min", "silent")),
    ),
    *claims(
        "explain",
        FINDINGS,
        (
            "Waiting for one's turn costs most active time, {4.0 +- 0.5} s. The limited range saves {1.1 +- 0.5} s,"
            " and latency costs {0.5 +- 0.4} s; that the start is not known for free makes no difference beyond its"
            " interval of 0.4 s. All imperfections together cost {7.3 +- 0.6} s of active time. They interact: the"
            " parts add up to 4.0 s. The evader is captured {0.7 +- 0.5} s sooner",
            (
                explained(active_time, "serial decisions"),
                explained(active_time, "range limit", scale=-1.0),
                explained(active_time, "latency"),
                explained(active_time),
                explained(end_time, scale=-1.0),
            ),
        ),
        (
            "On a perfect one, the team needs {15.4 +- 0.9} s of active time, about as much as it does: what the"
            " limited range saves makes up for latency and loss. Without any messages it needs {14.8 +- 1.6} s more",
            bounds_of_imperfect(),
        ),
    ),
    *claims(
        "range",
        FINDINGS,
        ("{39 % +- 3 %} of the games have no equilibrium at R = 8 m", [unsettled("all able", 8.0)]),
        (
            "at R = 4 m the team then saves {4.4 +- 2.6} s of {21} s of active time",
            [
                difference(
                    active_time,
                    range_runs.scenario("all able", 4.0, "local mean"),
                    range_runs.scenario("all able", 4.0, range_runs.REFERENCE),
                ),
                average(active_time, range_runs.scenario("all able", 4.0, "local mean")),
            ],
        ),
    ),
    *claims(
        "contention",
        FINDINGS,
        (
            "At a load of 1 SAP loses {0.6 +- 0.5} s, and at 2, {0.8 +- 0.6} s of {8.3} s; `local_min` then loses {0.7"
            " +- 0.5} s of {6.7} s",
            (
                lost_by("SAP", "CSMA/CA", 1.0),
                lost_by("SAP", "CSMA/CA", 2.0),
                average(active_time, contention_runs.pursuit("SAP", contention_runs.REFERENCE, 2.0)),
                lost_by("local_min", "CSMA/CA", 2.0),
                average(active_time, contention_runs.pursuit("local_min", contention_runs.REFERENCE, 2.0)),
            ),
        ),
        (
            "Under ALOHA, CBBA loses {1.1 +- 0.9} s at a load of 0.05 and {2.7 +- 2.0} s at 2. SAP loses {0.0 +- 0.8} s"
            " at 0.05 and {1.5 +- 1.3} s at 1, `local_min` {0.2 +- 0.2} s at 0.05 and {2.5 +- 1.5} s at 2",
            [
                lost_by(protocol, "ALOHA", load)
                for protocol, load in (
                    *(("CBBA", 0.05), ("CBBA", 2.0), ("SAP", 0.05), ("SAP", 1.0)),
                    *(("local_min", 0.05), ("local_min", 2.0)),
                )
            ],
        ),
        (
            "TDMA costs CBBA {0.5 +- 0.3} s at a load of 1, SAP and `local_min` nothing beyond their intervals. A"
            " token ring, whose slots must hold the long token, loses {6 +- 4} s at 0.5. - Under ALOHA and CSMA/CA a"
            " token ring is active for {7.0 +- 2.5} s less at 0.5",
            (
                lost_by("CBBA", "TDMA", 1.0),
                lost_by("token ring", "TDMA", 0.5),
                lost_by("token ring", "ALOHA", 0.5, scale=-1.0),
            ),
        ),
        (
            "If all know the first actions for free, SAP at a load of 0.05 loses {2.0 +- 0.9} s under ALOHA",
            [lost_by("SAP", "ALOHA", 0.05, "known")],
        ),
    ),
    Claim(
        "contention",
        FINDINGS,
        "{67 %} (60 to 73) of 200 pursuits are over before a pursuer may announce its action a second time; at"
        " spreading factor 8 all 200 are",
        [over_before_the_second(7)],
        share=4.0,
    ),
    *claims(
        "transport",
        FINDINGS,
        (
            "{0.25 +- 0.16} s of {8.1} s at a latency of 0.01 s, {0.30 +- 0.20} s of {20} s for an evader 20 m away. It"
            " costs {1.7 +- 0.5} s at 0.2 s and {3.5 +- 1.0} s at 0.5 s. With bursts of 3 s, in which many of the first"
            " announcements are lost, it saves {1.2 +- 1.1} s",
            (
                transported(RELIABLE, scale=-1.0, latency=0.01),
                transported(None, latency=0.01),
                transported(RELIABLE, scale=-1.0, distance=20.0),
                transported(None, distance=20.0),
                transported(RELIABLE, latency=0.2),
                transported(RELIABLE, latency=0.5),
                transported(RELIABLE, scale=-1.0, burst=3.0),
            ),
        ),
        (
            "if all know the first actions for free, retransmitting costs {1.7 +- 1.0} s with bursts of 3 s",
            [transported(RELIABLE, burst=3.0, start="known")],
        ),
        (
            "costs {1.8 +- 0.9} s at 50 % loss and {2.9 +- 1.2} s at 70 %; coded copies 0.05 s apart, which wait for"
            " no acknowledgement, are nowhere worse than heartbeats beyond their intervals, and {0.7 +- 0.5} s better"
            " at 70 %",
            (
                transported(transport_runs.BACKOFF, loss=0.5),
                transported(transport_runs.BACKOFF, loss=0.7),
                transported(transport_runs.CODED, scale=-1.0, loss=0.7),
            ),
        ),
        ("in every cell, {0.09} s against {0.37} s at 30 % loss", (age(transport_runs.HEARTBEATS), age(RELIABLE))),
    ),
    Claim(
        "coherence",
        FINDINGS,
        "Where each message fades anew, retransmitting a change of action saves {3.6 +- 0.9} s of {16} s; on a channel"
        " of the same loss with a Doppler frequency of 10 Hz, as at 1.25 m/s and 2.4 GHz, it saves {3.3 +- 1.2} s, at"
        " 1 Hz {3.1 +- 0.9} s, and at 0.1 Hz {0.9 +- 0.5} s",
        (
            retransmitting_saves(coherence_runs.NONE),
            average(active_time, coherence_runs.pursuit(coherence_runs.NONE, transport_runs.ONCE)),
            retransmitting_saves("10"),
            retransmitting_saves("1"),
            retransmitting_saves("0.1"),
        ),
    ),
    *claims(
        "liars",
        FINDINGS,
        (
            "delays the capture by {3.1 +- 1.5} s under SAP, {6.1 +- 2.5} s under `local_min` and {9.6 +- 3.2} s under"
            " CBBA, and telling some one thing and others another by {2.3 +- 1.3} s under SAP",
            (*(delayed_by(rule, "spoof") for rule in ("sap", "local_min", "cbba")), delayed_by("sap", "equivocate")),
        ),
        (
            "costs an honest team {58 % +- 16 %} more active time for F = 1 and {107 % +- 22 %} for F = 2",
            (price("trimmed, F = 1"), price("trimmed, F = 2")),
        ),
        (
            "with a deviation of 0.2 s there are {8.1 +- 1.7} false accusations in a run of SAP",
            [average(false_accusations, liars_runs.scenario_of("clocks", "sap", liars_runs.HONEST, "plausible", 0.2))],
        ),
    ),
    *claims(
        "bodies",
        FINDINGS,
        (
            "at 0.5 s it costs {7.7 +- 2.0} s with a radius of 2 m, {4.3 +- 1.1} s with an acceleration of 0.5 m/s²,"
            " and {6.0 +- 1.5} s with simple motion; at 1 s a turning radius of 2 m costs {3.5 +- 2.7} s more",
            (
                *(of_latency(0.5, motion) for motion in ("radius 2 m", "0.5 m/s^2", SIMPLE)),
                of_inertia(1.0, "radius 2 m"),
            ),
        ),
        (
            "from {0.9 +- 0.4} to {8.2 +- 1.3} s with simple motion, and from {1.0 +- 0.5} to {9.1 +- 1.5} s with a"
            " radius of 2 m; an acceleration of at most 0.5 m/s² makes it {5.9 +- 1.3} s at 1 s",
            (
                per_handover(SIMPLE, 0.0),
                per_handover(SIMPLE, 1.0),
                per_handover("radius 2 m", 0.0),
                per_handover("radius 2 m", 1.0),
                per_handover("0.5 m/s^2", 1.0),
            ),
        ),
        (
            "with simple motion they need {2.3 +- 0.7} s more active time without latency, and {4.6 +- 2.1} s more at"
            " 0.5 s; with a radius of 2 m, {2.8 +- 1.3} and {4.3 +- 3.3} s",
            [all_at_once(latency, motion) for motion in (SIMPLE, "radius 2 m") for latency in (0.0, 0.5)],
        ),
        (
            "costs robots with a radius of 0.5 or 2 m {6.6 +- 4.4} and {5.6 +- 5.2} s",
            (all_at_once(1.0, "radius 0.5 m"), all_at_once(1.0, "radius 2 m")),
        ),
    ),
    Claim(
        "evaders",
        FINDINGS,
        "by {1.6 +- 0.6} s of {5.4} s on an ideal network, by {1.1 +- 0.5} s with 0.1 s of latency, and by {1.9 +-"
        " 0.7} s against the centralised benchmark",
        (
            survives(evaders_runs.IDEAL),
            average(end_time, evaders_runs.chase(evaders_runs.REFERENCE, evaders_runs.IDEAL)),
            survives("sap"),
            survives("centralised"),
        ),
    ),
    Claim(
        "inference",
        FINDINGS,
        "by {1.11 +- 0.21} s if it knows, by {0.94 +- 0.22}, {0.63 +- 0.24} and {0.67 +- 0.22} s with exact looks"
        " every 0.1, 0.5 and 1 s, and *shorter* by {0.51 +- 0.19} s with looks every 0.2 s and errors of 0.1 m",
        (*(inferring(interval) for interval in (0.0, 0.1, 0.5, 1.0)), inferring(0.2, 0.1, scale=-1.0)),
        share=2.0,
    ),
    Claim(
        "evaders",
        FINDINGS,
        "{58 % +- 12 %}, {62 % +- 12 %} and {55 % +- 12 %} are captured, instead of 95 %. The worst-case estimate saves"
        " {4.4 +- 2.4} s of {7.3} s",
        (
            *(share(captured, evaders_runs.watched(2.0, kind)) for kind in evaders_runs.ESTIMATES),
            watched_saving("worst_case"),
            average(active_time, evaders_runs.watched(2.0, evaders_runs.HELD)),
        ),
        share=2.0,
    ),
    Claim(
        "many",
        FINDINGS,
        "SAP finds the best assignment in {69 %} of the games (58 to 79) if cooled slowly over 1000 slots, and in {33"
        " %} (24 to 45) if quenched. Selective SAP finds it in {57 %} and {33 %}",
        [finds_best(f"{rule}, {how}") for rule in ("SAP", "Selective SAP") for how in ("slow", "fast")],
        share=2.0,
    ),
    Claim(
        "many",
        FINDINGS,
        "The centralised benchmark did, by {1.25 +- 0.67} s with six pursuers and six evaders",
        [difference(end_time, chase_of_many("SAP, slow"), chase_of_many("centralised"))],
    ),
    *(
        Claim("table1", VALIDATION, row, [of_table1(count, slot)], sigmas=NORMAL_975)
        for count, slot, row in (
            (20, 0.1, "| 20 | 0.1 | 4.600 | 4.600 | {54.37 +- 0.62} |"),
            (20, 0.01, "| 20 | 0.01 | 4.560 | 4.570 | {11.46 +- 0.15} |"),
            (20, 0.001, "| 20 | 0.001 | 4.561 | 4.558 | {5.255 +- 0.015} |"),
            (40, 0.1, "| 40 | 0.1 | 4.800 | 4.800 | {116.94 +- 0.81} |"),
            (40, 0.01, "| 40 | 0.01 | 4.690 | 4.690 | {37.59 +- 0.54} |"),
            (40, 0.001, "| 40 | 0.001 | 4.689 | 4.670 | {7.848 +- 0.046} |"),
        )
    ),
    *(
        Claim("law", VALIDATION, row, [announcing(clock, x) for clock in start_runs.CLOCKS], sigmas=NORMAL_975)
        for x, row in (
            (1.0, "| 1 | 0.95 | {0.99 +- 0.08} | {0.99 +- 0.07} |"),
            (4.0, "| 4 | 3.80 | {3.89 +- 0.12} | {3.87 +- 0.09} |"),
            (16.0, "| 16 | 15.20 | {15.22 +- 0.11} | {15.24 +- 0.10} |"),
        )
    ),
    *(
        row_of_coverage(*row)
        for row in (
            ("normal", 30, "| normal | 30 | {92.2 %}, +0.002, 34 | {94.7 %}, +0.004, 36 | {95.1 %}, +0.011, 100 |"),
            ("normal", 300, "| normal | 300 | {95.1 %}, +0.003, 317 | {95.1 %}, +0.002, 316 | {95.3 %}, +0.001, 318 |"),
            (
                "exponential",
                30,
                "| exponential | 30 | {80.2 %}, -0.306, 29 | {91.9 %}, -0.070, 37 | {94.0 %}, -0.001, 100 |",
            ),
            (
                "exponential",
                300,
                "| exponential | 300 | {92.7 %}, -0.109, 315 | {93.8 %}, -0.063, 316 | {93.5 %}, -0.064, 318 |",
            ),
            (
                "lognormal, sigma = 1",
                30,
                "| lognormal, σ = 1 | 30 | {71.7 %}, -0.421, 20 | {88.0 %}, -0.081, 38 | {91.0 %}, +0.006, 101 |",
            ),
            (
                "lognormal, sigma = 1",
                300,
                "| lognormal, σ = 1 | 300 | {85.8 %}, -0.349, 279 | {88.5 %}, -0.196, 290 | {89.8 %}, -0.165, 293 |",
            ),
        )
    ),
    Claim("start", VALIDATION, "half a second of latency costs {1.4 +- 0.4} s", [cost("few in time", "sap", 0.5)]),
    Claim(
        "delay",
        VALIDATION,
        "{0.83 +- 0.03} for a token ring, {1.75 +- 0.12} for a random order and {1.59 +- 0.03} for rounds",
        [excess(schedule) for schedule in ("token_ring", "shared_seed", "rounds")],
        sigmas=NORMAL_975,
    ),
    *claims(
        "noisy",
        GAME,
        (
            "is {9.0 +- 2.4}, {4.4 +- .8}, {1.94 +- .12} and {1.45 +- .07}",
            [consistency(diffusion) for diffusion in (0.05, 0.1, 0.32, 1.0)],
        ),
        (
            "With covariance intersection and c = .32 it is {1.26 +- .11}",
            [consistency(0.32, "covariance_intersection")],
        ),
        (
            "squared error is {2.38 +- .17} and {5.5 +- .4}, and with covariance intersection {1.54 +- .15} and"
            " {3.9 +- .7}",
            [
                consistency(0.32, fusion, off)
                for fusion in ("by_stamp", "covariance_intersection")
                for off in (0.1, 0.3)
            ],
        ),
        share=2 / 3,
        sigmas=NORMAL_975,
    ),
    *claims(
        "affordable",
        BREAKING,
        (
            '`sap` violates "idle at most 2 in total against centralised" in {7.0 %} without it and in {2.5 %} with it,'
            " `best_response` in {6.8 %} and {2.5 %}, `local_min` in {7.2 %} and {3.0 %}",
            [
                leaves_alone(protocol, timeout)
                for protocol in ("sap", "best_response", "local_min")
                for timeout in ("auto", "affordable")
            ],
        ),
        (
            "violated with either, {14.8 %} and {14.8 %}. A time-out costs nearly nothing: with a loss of 0.2 and no"
            ' crash, `sap` is active for {0.012 +- 0.008} s more with "affordable", of {6.2 +- 0.2} s',
            (
                *(leaves_alone("cbaa", timeout) for timeout in ("auto", "affordable")),
                difference(active_time, lossy("affordable"), lossy("auto")),
                average(active_time, lossy("auto")),
            ),
        ),
    ),
    *claims(
        "break",
        BREAKING,
        (
            "argmin {-15.9} {18} violates argmin_known {-15.9} {18} violates cbaa {-15.9} {18} violates ..."
            " best_response {0.63} {1.46} binary_log_linear {0.63} {1.46} sap {0.63} {1.46}",
            [
                alone_in_relay(protocol, beyond=beyond)
                for protocol in ("argmin", "argmin_known", "cbaa", "best_response", "binary_log_linear", "sap")
                for beyond in (True, False)
            ],
        ),
        ("(it has {18} s, centralised {0.09} s)", [*map(alone_in_relay, ("cbaa", "centralised"))]),
    ),
    *claims(
        "breaking",
        BREAKING,
        crash("argmin", "the chaser", "0.7", "6.8"),
        (
            "| case 34: the same with three pursuers | {6.8} |",
            [alone("argmin", {"protocol": "best_response", "team.count": 3})],
        ),
        (
            "the chaser crashes at {0.7} s, and 6.8 s are left ([file](../_static/broken/jsfp.toml), "
            '<a href="broken/jsfp.html#t=0.7">film</a>) | {6.8} | they take over {0.9} s after the crash, too late for'
            " 7.5 s; with 9 s they are idle for {0.9} s in all. `sap` needs {0.6} s",
            (
                crash_time("jsfp"),
                alone("jsfp"),
                alone("jsfp", {"horizon": 9.0}),
                alone("jsfp", {"horizon": 9.0, "protocol": "regret_matching"}),
                alone("jsfp", {"protocol": "sap"}),
            ),
        ),
        (
            "number 2, the winner, crashes at {0.9} s ([file](../_static/broken/cbaa.toml), <a"
            ' href="broken/cbaa.html#t=0.9">film</a>); without such crashes case 1: four pursuers, the chaser crashes'
            ' at {2} s ([file](../_static/broken/cbaa-2.toml), <a href="broken/cbaa-2.html#t=2">film</a>) | {6.6};'
            " {5.5} |",
            (crash_time("cbaa"), crash_time("cbaa-2"), alone("cbaa"), alone("cbaa-2")),
        ),
        crash("server", "number 0, the server,", "3", "8.0"),
        crash("sap-2", "number 0, the chaser,", "1", "6.5"),
        crash("jsfp-2", "number 1, the chaser,", "0.5", "5.1"),
        crash("selective_sap-2", "number 2, the chaser,", "0.8", "6.7"),
        (
            "at {2.2} s ([file](../_static/broken/server-takeover.toml), "
            '<a href="broken/server-takeover.html#t=9.3">film</a>) | {7.0} | the reports need 1.6 times the capacity',
            (crash_time("server-takeover"), alone("server-takeover")),
        ),
        (
            "the channel carries them, and the evader is alone for {1.7} s",
            [alone("server-takeover", {"protocol.period": 0.2})],
        ),
        crash("generalised_regret_matching-2", "number 2, the chaser,", "0.7", "6.8"),
        ('href="broken/server-2.html#t=2">film</a>) | {5.5} |', [alone("server-2")]),
        ('href="broken/server-3.html#t=0.5">film</a>) | {5.05} |', [alone("server-3")]),
        ('href="broken/server-4.html#t=9.9">film</a>) | {13.7} |', [alone("server-4")]),
        ('href="broken/server-5.html#t=0.6">film</a>) | {6.9} |', [alone("server-5")]),
        (
            "never alone if number 2 is the server, and for {0.2} s if the jamming begins at 1.5 s",
            [alone("server-5", {"fault.0.start": 1.5})],
        ),
        (
            "alone for {0.4} s in the first row, for {0.9} s under `jsfp` on change only, for {0.9} s in case 6,363,"
            " for {1.0} s under `selective_sap`, for {0.5} s under `generalised_regret_matching`, and never under"
            " `local_min` with trust `trimmed`. If `cbba` drops a silent winner after 0.5 s (`winner_timeout`), it is"
            " alone for {0.6} s. With bursts and a server that does not chase (`host = 2`) it is alone for {0.2} s,"
            " and if the jamming begins at 2 s, for {0.6} s",
            (
                *(
                    alone(name, {"announce.belief_timeout": 1.0})
                    for name in ("argmin", "jsfp-2", "sap-2", "selective_sap-2", "generalised_regret_matching-2")
                ),
                alone("cbba", {"protocol.winner_timeout": 0.5}),
                alone("server-2", {"protocol.host": 2}),
                alone("server-3", {"fault.0.start": 2.0}),
            ),
        ),
        (
            "nobody would be in time any more; in 15 s instead of 11 s the evader is alone for {0.7} s",
            [alone("server", {"protocol.takeover": True, "horizon": 15.0})],
        ),
        (
            "is noticed after {2.0} s, too late for 7.5 s; in 10 s the evader is alone for {2.0} s",
            [alone("server-takeover", NOTICED_LATE | {"horizon": 10.0})] * 2,
        ),
        (
            "now only a newer order does, and the evader is alone for {3.1} s",
            [
                alone(
                    "server",
                    {
                        "seed": 2254,
                        "horizon": 7.5,
                        "team.count": 4,
                        "protocol.takeover": True,
                        "network.latency": {"kind": "shifted_exponential", "mean": 0.9},
                        "fault.0.start": 0.8,
                    },
                )
            ],
        ),
        (
            "the evader is left alone for {6.1} s ([file](../_static/broken/sap-affordable-2.toml)",
            [alone("sap-affordable-2")],
        ),
        ('-trimmed.html#t=4">film</a>) | {11.0} |', [alone("local_min-trimmed")]),
        crash("cbba", "number 2", "9", "8.1"),
    ),
    *claims(
        "bench",
        BENCH,
        (
            "The games `sap` and `best_response` are {0.05} to {0.07} behind `local_min` on a perfect network, and"
            " {0.07} to {0.08} on those of the scenarios",
            (*least_and_greatest("quality", BEHIND), *least_and_greatest("score", BEHIND)),
        ),
        (
            "The network costs `argmin` {0.12} and `local_min` {0.12}",
            [benchmarked("loss", protocol) for protocol in ("argmin", "local_min")],
        ),
        (
            "On a perfect network `cbba` is worth {0.93}, and `sap` {0.93}",
            [benchmarked("quality", protocol) for protocol in ("cbba", "sap")],
        ),
        ("`argmin` would score about {1.04}", [benchmarked("quality", "argmin")]),
        ("come from {2} of {16} runs, {3} under `server`", (outliers("cbaa"), runs_of_version, outliers("server"))),
    ),
    Claim(
        "learning",
        FINDINGS,
        "it costs {5.8 +- 0.4} s, `local_min` {5.7 +- 0.4} s, SAP {6.9 +- 0.5} s, and a team in which all chase {20.1"
        " +- 1.6} s",
        (
            cost_of_learned(learning_runs.LATENCY, learning_runs.LATENCY),
            *(learning_cost(rule, learning_runs.LATENCY) for rule in learning_runs.RIVALS.values()),
        ),
        sigmas=NORMAL_975,
    ),
    Claim(
        "delays",
        FINDINGS,
        "costs {5.0 +- 0.4} s without delay and {30.8 +- 5.6} s at a latency of 1 s (+- standard error). Trained with 1"
        " s it costs {5.1 +- 0.4} s and {12.1 +- 0.6} s",
        [
            cost_of_learned(trained_at, latency)
            for trained_at in (learning_runs.NO_DELAY, learning_runs.DELAY)
            for latency in (learning_runs.NO_DELAY, learning_runs.DELAY)
        ],
        sigmas=NORMAL_975,
    ),
    Claim(
        "order",
        TIME,
        "captures then come {0.0018 +- 0.0009} s earlier than if all move at once",
        [difference(end_time, in_order("simultaneous"), in_order("evader_first"))],
    ),
    Claim(
        "howto",
        HOWTO,
        "raises its active time from {2.9 +- 0.3} to {10.6 +- 1.3} s",
        [average(active_time, fast(nearest_only, latency)) for latency in (0.0, 0.5)],
    ),
    Claim(
        "tutorials",
        FIRST,
        "At half a second, the team spends {7.3 +- 1.9} s more effort",
        [difference(active_time, fast(CLOCKS, 0.5), fast(CLOCKS, 0.0))],
    ),
    Claim(
        "tutorials",
        OWN,
        "beat Spatial Adaptive Play, by {1.7 +- 0.5} s of active time without delay and by {2.7 +- 0.9} s at half a"
        " second",
        [
            difference(active_time, fast(CLOCKS, latency, 12), fast(nearest_at_random, latency, 12))
            for latency in (0.0, 0.5)
        ],
    ),
    Claim(
        "decides",
        BEST,
        "once a second costs {12.3 +- 0.6} s of active time here, ten times a second {7.9 +- 0.5} s",
        [average(active_time, late_bench(slot)) for slot in (1.0, 0.1)],
    ),
    Claim("race", RACE, "1 8 {6.859 +- 1.161} 15", [average(active_time, raced(8.0))]),
    row_of_race(1.0, "2 1 {13.320 +- 1.651} {+6.462 +- 1.370} 15"),
    row_of_race(5.0, "3 5 {7.445 +- 1.625} {+0.833 +- 0.351} 10"),
    row_of_race(3.0, "4 3 {8.639 +- 1.611} {+2.027 +- 0.841} 10"),
    row_of_race(2.0, "5 2 {10.207 +- 1.643} {+3.595 +- 1.121} 10"),
)
"""The claims that are checked."""

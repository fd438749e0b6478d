"""The contract of every protocol, under every schedule it accepts: what a new one gets by being installed."""

import random
import re
from importlib import import_module
from inspect import signature
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pytest

import protocols
from desim import Scenario, load, run
from desim.kernel.core.trace_file import line_of
from desim.kernel.core.units import SECOND
from desim.kernel.models.faults import Crash, Partition
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Ended, Started
from desim.pursuit.game.game import relay_profile
from desim.pursuit.motion.capture import capture_time
from desim.pursuit.team.announcements import DISSEMINATIONS, STARTS, Announcements
from desim.scenario.players import Team
from desim.scenario.scenario import PROTOCOLS, Motion, Recording
from protocols.rule import SCHEDULES, Rule
from protocols.schedules.periodic import Poisson
from scenarios.studies.study import SCENARIOS
from tests.many import LOSSY, at_rest, chased, easy, times

KINDS = PROTOCOLS.choices()
SCHEDULED = [kind for kind, model in KINDS.items() if "schedule" in model.model_fields]
FILES = ("faults", "flooding", "many", "radio", "search", "soak", "wired")
"""Of what is imperfect, each is in one of them."""


def covering(*axes):
    """Return some of the triples of three axes, so that each pair of values of any two axes is in one at least.

    Numbered on each axis, they are those whose sum is a multiple of m, the length of the shortest axis: of two values
    that are given, any m that follow one another on the third axis have one. Of the two other axes every pair is in
    just one triple, so that none can be spared.
    """
    shortest = min(map(len, axes))
    numbered = product(*map(enumerate, axes))
    return [tuple(value for _, value in each) for each in numbered if sum(k for k, _ in each) % shortest == 0]


def uncovered(triples, *axes):
    """Return the pairs of values of two of three axes that are in no triple."""
    met = {pair for triple in triples for pair in combinations(enumerate(triple), 2)}
    named = [[(number, value) for value in axis] for number, axis in enumerate(axes)]
    return {pair for one, other in combinations(named, 2) for pair in product(one, other)} - met


AXES = SCHEDULED, list(SCHEDULES.choices()), FILES
CELLS = [
    *covering(*AXES),
    *((kind, None, file) for kind in KINDS if kind not in SCHEDULED for file in FILES),
]
FIRST = {cell[0]: cell for cell in reversed(CELLS)}
"""A cell of each protocol."""
EQUAL_SPEEDS = {"voronoi"}
"""The protocols that assume them."""
AVERAGING = {"fictitious_play", "regret_matching"}
"""Protocols that average over all turns: what they learnt first fades in r / (phi_2 - phi_1) turns, so the two should
differ.
"""
WHOLE_GAME = {*AVERAGING, "jsfp"}
"""Protocols that may need more than half of it, as what they learnt first fades."""
ONE_LEADER = {"centralised", "server", "voronoi", "argmin"}
"""Protocols without guarantees for disconnected teams."""


def lines(scenario, seed, until):
    """Return the trace of a run that is stopped at a time (s): the game is that of the whole horizon."""
    return "".join(map(line_of, run(scenario, seed, lambda event: event.t > until * SECOND).trace))


def first_fault(scenario):
    """Return when the first fault begins whose time is given, s; 0 if there is none."""
    return min((fault.at for fault in scenario.fault if hasattr(fault, "at")), default=0.0)


@pytest.mark.parametrize(
    ("kind", "schedule", "file"),
    [pytest.param(*cell, marks=[pytest.mark.slow] * (cell not in FIRST.values())) for cell in CELLS],
)
def test_a_protocol_keeps_the_contract_in_every_scenario(kind, schedule, file):
    """Same seed, same bytes, whatever ran between; another seed, another run; the global generators stay untouched.

    Just past the first fault, if there is one. That no message goes astray is watched in every test.
    """
    table = f"{{ kind = '{kind}', schedule = {{ kind = '{schedule}' }} }}" if schedule else f"{{ kind = '{kind}' }}"
    scenario = load(SCENARIOS / f"{file}.toml", [f"protocol={table}", "record.messages=true"])
    until = first_fault(scenario) + 0.1
    np.random.seed(1)  # noqa: NPY002
    random.seed(1)
    before = np.random.get_state()[1].tolist(), random.getstate()  # noqa: NPY002
    first, other, again = lines(scenario, 3, until), lines(scenario, 4, 0.1), lines(scenario, 3, until)
    first_part = first if until == 0.1 else lines(scenario, 3, 0.1)
    assert first == again
    if (
        "schedule" in type(scenario.protocol).model_fields or scenario.team.positions is None
    ):  # else nothing is by chance
        assert first_part != other
    assert (np.random.get_state()[1].tolist(), random.getstate()) == before  # noqa: NPY002


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize("kind", KINDS)
def test_in_the_contract_each_protocol_starts_and_stops_pursuers(kind):
    """Or the contract would be about nothing."""
    seen = set()
    for share in (0.0, 1.0):
        scenario = load(SCENARIOS / "relay.toml", [f"protocol={{ kind = '{kind}' }}", f"team.active_at_start={share}"])
        trace = run(scenario, 3, lambda event: event.t > 0.6 * SECOND).trace
        seen |= {event.active for event in trace.of(Decided)}
    assert seen == {True, False}


def settled(kind, seed, **changes):
    """Return a random static game of a protocol on a complete graph: 2 to 12 pursuers, any speeds, any start."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 13))
    speeds = 1.5 if kind in EQUAL_SPEEDS else rng.uniform(0.8, 2.0, count).tolist()
    rate = 30.0 if kind in AVERAGING else 10.0
    settings = {"schedule": {"kind": "poisson", "rate": rate}} if kind in SCHEDULED else {}
    if "slot" in KINDS[kind].model_fields:
        settings["slot"] = 0.1
    fixed = {
        "seed": seed,
        "horizon": 30.0,
        "team": Team(count=count, speeds=speeds, active_at_start=float(rng.choice([0.0, 0.5, 1.0]))),
        "motion": Motion(static=True),
        "protocol": KINDS[kind](**settings),
        "announce": Announcements(heartbeat=0.5, start=STARTS[rng.integers(3)]),
        "record": Recording(trajectory=0.0),
    }
    return Scenario(**(fixed | changes))


def undecided(kind, phi, horizon):
    """Return whether a rule that averages would need more time than there is."""
    least, second = sorted(phi)[:2]
    return kind in AVERAGING and least < horizon and second < 1.2 * least


def outcome(case, kind):
    """Return the profile after half of a game, or at its end if a rule may need that, and the times of capture."""
    result = run(case, None, lambda event: kind not in WHOLE_GAME and event.t > 15 * SECOND)
    start = result.trace.of(Started)[0]
    phi = capture_time(start.evaders[0], start.pursuers, start.speeds, result.scenario.evader.speed, 0.1)
    profile = list(start.active)
    for event in result.trace:
        if isinstance(event, Decided | BrokeDown):
            profile[event.pursuer] = isinstance(event, Decided) and event.active
    return tuple(profile), phi.tolist()


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_on_the_complete_ideal_network_every_protocol_ends_in_the_relay_profile(kind):
    """2 random games each, the undecided left out; the centralised one ends in the same."""
    kept, cases = 0, 2
    for seed in range(cases):
        case = settled(kind, seed)
        profile, phi = outcome(case, kind)
        if not undecided(kind, phi, case.horizon):
            kept += 1
            assert profile == relay_profile(phi, case.horizon), f"{case!r}"
    assert kept == cases or (kind in AVERAGING and kept >= cases / 2)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ONE_LEADER])
def test_in_each_part_of_a_team_that_is_cut_in_two_one_pursuer_chases(kind):
    """2 random games each: the least phi of each part that would be in time."""
    for seed in range(2):
        whole = settled(kind, seed)
        size = whole.team.count
        group = tuple(np.flatnonzero(np.random.default_rng(seed).random(size) < 0.5).tolist()) or (0,)
        cut = Partition(start=0.0, end=1e6, groups=(group,))
        case = whole.model_copy(update={"fault": (cut,), "network": Links(latency=Constant(value=0.02))})
        profile, phi = outcome(case, kind)
        parts = [group, tuple(set(range(size)) - set(group))]
        for part in filter(None, parts):
            inside, own = tuple(profile[i] for i in part), [phi[i] for i in part]
            if len(part) > 1 and undecided(kind, own, case.horizon):
                continue
            assert inside == relay_profile(own, case.horizon), f"{seed}: {case!r}"


def test_the_contract_covers_every_protocol_and_every_schedule():
    """Each two of protocol, schedule and file meet, and every protocol meets every file; no cell could be spared."""
    cells = [cell for cell in CELLS if cell[1] is not None]
    assert uncovered(cells, *AXES) == set()
    assert all(uncovered([other for other in cells if other != cell], *AXES) for cell in cells[:: len(cells) // 20])
    assert {(kind, file) for kind, _, file in CELLS} == set(product(KINDS, FILES))
    assert {"sap", "local_min", "centralised"} <= set(KINDS)
    assert Poisson in SCHEDULES.choices().values()


def test_the_pairs_that_no_triple_covers_are_found():
    """(a, x, 1) and (b, y, 1) have (a, x), (b, y), (a, 1), (b, 1), (x, 1) and (y, 1) of twelve pairs."""
    axes = "ab", "xy", (1, 2)
    lacking = {("a", "y"), ("b", "x"), ("a", 2), ("b", 2), ("x", 2), ("y", 2)}
    found = uncovered([("a", "x", 1), ("b", "y", 1)], *axes)
    assert {(one, other) for (_, one), (_, other) in found} == lacking
    assert uncovered(covering(*axes), *axes) == set()
    assert len(covering(*axes)) == 4


# Several evaders.

OPEN = {*WHOLE_GAME, "generalised_regret_matching", "sap", "binary_log_linear", "selective_sap"}
"""Protocols that may not have settled after some seconds, or keep exploring."""
MANY = {"ideal": Links(), "lossy": LOSSY}


def quick(kind):
    """Return a protocol with ten turns per second, or five."""
    settings = {"schedule": {"kind": "poisson", "rate": 10.0}} if kind in SCHEDULED else {}
    return KINDS[kind](**settings | ({"slot": 0.2} if "slot" in KINDS[kind].model_fields else {}))


@pytest.mark.parametrize("network", ["ideal", pytest.param("lossy", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_every_protocol_has_three_evaders_captured_and_does_the_same_again(kind, network):
    """Six that are four times as fast, in a box of 4 m: in less than 5 s each evader has been captured once."""
    case = easy(quick(kind), seed=2, network=MANY[network])
    result = run(case)
    captures, (end,) = result.trace.of(Captured), result.trace.of(Ended)
    assert sorted(capture.evader for capture in captures) == [1, 2, 3]
    assert (end.reason, end.capturer, end.t) == ("captured", captures[-1].capturer, captures[-1].t)
    assert end.t < 5 * SECOND
    assert {event.active for event in result.trace.of(Decided)} <= {0, 1, 2, 3}
    assert list(map(line_of, run(case).trace)) == list(map(line_of, result.trace))


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("network", MANY)
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in OPEN])
def test_at_rest_no_two_pursuers_are_left_on_one_evader_and_none_without_that_could_be_chased(kind, network):
    """Two games of six after 4 s: every chaser is in time, and every other pursuer would be late for each evader
    without a chaser.
    """
    for seed in range(2):
        case = at_rest(quick(kind), 6, 3, seed, network=MANY[network], announce=Announcements(belief_timeout=np.inf))
        result = run(case, None, lambda event: event.t > 4 * SECOND)
        actions, phi = chased(result), times(result)
        assert len(set(actions.values())) == len(actions)
        assert all(phi[pursuer, evader - 1] < 30.0 for pursuer, evader in actions.items())
        idle, free = (set(range(6)) - set(actions), {1, 2, 3} - set(actions.values()))
        assert not [(i, j) for i in idle for j in free if phi[i, j - 1] < 30.0]


PARTS = [*KINDS.values(), *SCHEDULES.choices().values(), *DISSEMINATIONS.choices().values()]


def test_each_protocol_and_dissemination_of_the_repository_has_an_entry_in_the_table_of_kinds():
    """A protocol is called with (me), and a dissemination has a method `broadcast`."""
    found: dict[str, set[str]] = {"desim.protocols": set(), "desim.disseminations": set()}
    for file in Path(protocols.__file__).parent.glob("[a-z]*.py"):
        module = import_module(f"protocols.{file.stem}")
        for name, model in vars(module).items():
            if (
                isinstance(model, type)
                and model.__module__ == module.__name__
                and "kind" in getattr(model, "model_fields", {})
            ):
                group = "desim.disseminations" if hasattr(model, "broadcast") else "desim.protocols"
                if [*signature(model.__call__).parameters] == ["self", "me"]:
                    found[group].add(f"{module.__name__}:{name}")
    assert {group: set(kinds.values()) for group, kinds in protocols.KINDS.items()} == found


@pytest.mark.parametrize("module", sorted({part.__module__ for part in PARTS}))
def test_the_header_of_a_protocol_lists_its_assumptions(module):
    """Paper, parameters, assumptions, cost in messages, robustness: in this order, each at the head of a line."""
    head = import_module(module).__doc__
    places = [head.find(f"\n{word}: ") for word in ("Paper", "Parameters", "Assumes", "Messages", "Robust to loss")]
    assert -1 not in places
    assert places == sorted(places)


class Broken(Rule):
    """A rule that is written wrongly in one way or another."""

    fault: str

    def actions(self, me):
        if self.fault == "returns":
            return True
        return self._actions(me)

    def _actions(self, me):
        yield 1
        if self.fault == "divides":
            yield me.id // 0


def no_process(me):
    me.sleep(1.0)


def no_event(me):
    yield 0.1


def nothing(me):
    yield me.sleep(0.1)
    yield


@pytest.mark.parametrize(
    ("protocol", "what"),
    [
        (Broken(fault="divides"), "division"),
        (Broken(fault="ends"), r"actions\(me\) of Broken should never end"),
        (Broken(fault="returns"), r"actions\(me\) of Broken should yield actions, not return True"),
        (
            no_process,
            r"a protocol, .*should be a generator .*, got None from no_process \(tests/test_protocols\.py, ",
        ),
        (no_event, r"should yield events such as me\.sleep\(0\.1\), got 0\.1 from no_event"),
        (nothing, r"should yield events .*, got None from nothing"),
    ],
    ids=["divides", "ends", "returns", "no process", "no event", "nothing"],
)
def test_errors_of_a_user_protocol_are_reported_with_pursuer_and_time(protocol, what):
    with pytest.raises((ZeroDivisionError, ValueError, TypeError), match=what) as raised:
        run(Scenario(protocol=protocol), 0)
    (note,) = raised.value.__notes__
    assert re.fullmatch(r"\(pursuer \d+, at [\d.]+ s of its clock\)", note)


def renames_itself(me):
    yield me.sleep(0.1 * (1 + (me.id != 1)))
    me.id = 0
    raise KeyError("planted")


def fails_at_its_end(me):
    try:
        yield me.sleep(9.0)
    finally:
        if me.id == 1:
            raise KeyError("planted")


def goes_on_at_its_end(me):
    try:
        yield me.sleep(9.0)
    except GeneratorExit:
        if me.id == 1:
            yield me.sleep(9.0)


@pytest.mark.parametrize(
    ("protocol", "at"), [(renames_itself, 0.1), (fails_at_its_end, 0.3), (goes_on_at_its_end, 0.3)]
)
def test_an_error_has_the_number_of_its_pursuer_also_if_it_comes_with_a_crash(protocol, at):
    crash = Crash(node=1, start=0.2, end=0.3, memory=False)
    with pytest.raises((KeyError, RuntimeError)) as raised:
        run(Scenario(protocol=protocol, fault=[crash], horizon=1.0), 0)
    assert raised.value.__notes__ == [f"(pursuer 1, at {at} s of its clock)"]

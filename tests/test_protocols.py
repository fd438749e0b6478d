"""The contract of every protocol, under every schedule it accepts: what a new one gets by being installed."""

import random
from importlib import import_module

import numpy as np
import pytest

from desim import Scenario, load, run
from desim.kernel.clock import SECOND
from desim.kernel.faults import Partition
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.pursuit.capture import capture_time
from desim.pursuit.events import Decided, Halted, Started
from desim.pursuit.game import relay_profile
from desim.pursuit.word import DISSEMINATIONS, Announcements
from desim.scenario import PROTOCOLS, Motion, Recording, Team
from protocols.rule import SCHEDULES
from protocols.schedules import Poisson
from scenarios.study import SCENARIOS

KINDS = PROTOCOLS.choices()
SCHEDULED = [kind for kind, model in KINDS.items() if "schedule" in model.model_fields]
TABLES = [
    *(
        f"{{ kind = '{kind}', schedule = {{ kind = '{schedule}' }} }}"
        for kind in SCHEDULED
        for schedule in SCHEDULES.choices()
    ),
    *(f"{{ kind = '{kind}' }}" for kind in KINDS if kind not in SCHEDULED),
]
FILES = sorted(SCENARIOS.glob("*.toml"))
EQUAL_SPEEDS = {"voronoi"}
"""Who assumes them."""
AVERAGING = {"fictitious_play", "regret_matching"}
"""Who averages over all turns: what they learnt first fades in r / (phi_2 - phi_1) turns, so the two should differ."""
ONE_LEADER = {"centralised", "server", "voronoi", "argmin"}
"""Who promises nothing to parts of the team that are cut off."""


def lines(scenario, seed, until):
    """Return the trace of a run that is stopped at a time (s): the game is that of the whole horizon."""
    return "".join(run(scenario, seed, lambda event: event.t > until * SECOND).trace.lines())


def first_fault(scenario):
    """Return when the first fault begins whose time is given, s; 0 if there is none."""
    return min((fault.at for fault in scenario.fault if hasattr(fault, "at")), default=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
@pytest.mark.parametrize("table", TABLES)
def test_a_protocol_keeps_the_contract_in_every_scenario(table, path):
    """Same seed, same bytes, whatever ran between; another seed, another run; the global generators stay untouched.

    Just past the first fault, if there is one. That no message goes astray is watched in every test.
    """
    scenario = load(path, [f"protocol={table}", "record.messages=true"])
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


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_contract_sees_of_a_protocol_is_pursuers_that_are_sent_and_stopped(kind):
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
    given = {
        "seed": seed,
        "horizon": 30.0,
        "team": Team(count=count, speeds=speeds, active_at_start=float(rng.choice([0.0, 0.5, 1.0]))),
        "motion": Motion(frozen=True),
        "protocol": KINDS[kind](**settings),
        "announce": Announcements(heartbeat=0.5, warm_start=bool(rng.random() < 0.5)),
        "record": Recording(trajectory=0.0),
    }
    return Scenario(**(given | changes))


def undecided(kind, phi, horizon):
    """Return whether a rule that averages would need more time than there is."""
    least, second = sorted(phi)[:2]
    return kind in AVERAGING and least < horizon and second < 1.2 * least


def outcome(result):
    """Return the last profile, and the times of capture."""
    start = result.trace.of(Started)[0]
    phi = capture_time(start.evader, start.pursuers, start.speeds, result.scenario.evader.speed, 0.1)
    profile = list(start.active)
    for event in result.trace:
        if isinstance(event, Decided | Halted):
            profile[event.pursuer] = isinstance(event, Decided) and event.active
    return tuple(profile), phi.tolist()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_on_the_complete_ideal_network_every_protocol_ends_in_the_relay_profile(kind):
    """12 random games each, 5 of rules that average, the undecided left out; the centralised one ends in the same."""
    kept, cases = 0, 5 if kind in AVERAGING else 12
    for seed in range(cases):
        case = settled(kind, seed)
        profile, phi = outcome(run(case))
        if not undecided(kind, phi, case.horizon):
            kept += 1
            assert profile == relay_profile(phi, case.horizon), f"{case!r}"
    assert kept == cases or (kind in AVERAGING and kept >= cases / 2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ONE_LEADER])
def test_in_each_part_of_a_team_that_is_cut_in_two_one_pursuer_chases(kind):
    """8 random games each, 4 of rules that average: the least phi of each part that would be in time."""
    for seed in range(4 if kind in AVERAGING else 8):
        whole = settled(kind, seed)
        size = whole.team.count
        group = tuple(np.flatnonzero(np.random.default_rng(seed).random(size) < 0.5).tolist()) or (0,)
        cut = Partition(at=0.0, until=1e6, groups=(group,))
        case = whole.model_copy(update={"fault": (cut,), "network": Links(latency=Constant(value=0.02))})
        profile, phi = outcome(run(case))
        parts = [group, tuple(set(range(size)) - set(group))]
        for part in filter(None, parts):
            inside, own = tuple(profile[i] for i in part), [phi[i] for i in part]
            if len(part) > 1 and undecided(kind, own, case.horizon):
                continue
            assert inside == relay_profile(own, case.horizon), f"{seed}: {case!r}"


def test_the_contract_covers_every_protocol_and_every_schedule():
    assert len(TABLES) == len(SCHEDULED) * len(SCHEDULES.choices()) + len(KINDS) - len(SCHEDULED)
    assert {"sap", "local_min", "centralised"} <= set(KINDS)
    assert Poisson in SCHEDULES.choices().values()


PARTS = [*KINDS.values(), *SCHEDULES.choices().values(), *DISSEMINATIONS.choices().values()]


@pytest.mark.parametrize("module", sorted({part.__module__ for part in PARTS}))
def test_the_header_of_a_protocol_says_what_it_rests_on(module):
    """Paper, parameters, assumptions, cost in messages, robustness: in this order, each at the head of a line."""
    head = import_module(module).__doc__
    places = [head.find(f"\n{word}: ") for word in ("Paper", "Parameters", "Assumes", "Messages", "Robust to loss")]
    assert -1 not in places
    assert places == sorted(places)

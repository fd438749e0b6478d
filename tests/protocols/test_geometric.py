"""Geometric rules: the owner of the evader, its changes, and agreement without announcements."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from desim import Scenario, run, summary
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Constant, Lognormal
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.core.events import Decided, Sampled, Started
from desim.pursuit.game.game import greedy_assignment, relay_profile
from desim.pursuit.motion.capture import capture_time
from desim.pursuit.motion.environment import Environment
from desim.pursuit.team.announcements import STARTS, Announcements
from desim.scenario.assumptions import violations
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording
from protocols.centralised import Centralised
from protocols.geometric import Argmin, VelocityFilter, Voronoi, announced_chasers, first
from protocols.geometric import owners as owners_of
from tests.many import at_rest, by_evader, chased, times

SECOND = 1_000_000_000


def profiles(result):
    """Return {t: chasers} at every instant with a decision, after the last decision of the instant."""
    active, found = list(result.trace.of(Started)[0].active), {}
    for decision in result.trace.of(Decided):
        active[decision.pursuer] = decision.active
        found[decision.t] = tuple(active)
    return found


def owners(result):
    """Return the single chasers in order; fails if at any instant several or none chased."""
    found = []
    for profile in profiles(result).values():
        assert sum(profile) == 1
        found.append(profile.index(True))
    return found


def wavering(state, rng):
    """Run from the nearest pursuer to the second nearest, more or less: the evader stays where cells meet."""
    second = np.argsort(state.distances)[1]
    gap = -complex(state.offsets[second])
    return gap / abs(gap) * complex(np.exp(1j * rng.uniform(-0.3, 0.3)))


STILL = Environment()


def scattered(protocol, seed, *, count=12, horizon=2000.0, speeds=0.91, **changes):
    """Return a pursuit of an evader that crosses many borders of cells."""
    given = {
        "seed": seed,
        "horizon": horizon,
        "team": Team(count=count, speeds=speeds),
        "evader": Evader(speed=0.9, strategy=wavering),
        "motion": Motion(step=0.05),
        "protocol": protocol,
        "record": Recording(trajectory=0.0),
    }
    return Scenario(**(given | changes))


# The owner.


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 3])
def test_the_owner_of_the_voronoi_cell_of_the_evader_chases_from_every_slot_on(seed):
    """Positions as recorded at every slot; the nearest by a k-d tree, and the chaser, compared at all slots."""
    result = run(scattered(Voronoi(slot=0.05), seed, record=Recording(trajectory=0.05)), seed)
    found, chasing, seen = profiles(result), None, set()
    samples = [sample for sample in result.trace.of(Sampled) if sample.t % 50_000_000 == 0]
    end = samples[-1].t
    for sample in samples:
        chasing = found.get(sample.t, chasing)
        if sample.t < end:  # captured there, before any decision
            owner = int(cKDTree(sample.pursuers).query(sample.evaders[0])[1])
            assert chasing == tuple(j == owner for j in range(12))
            seen.add(owner)
    assert len(samples) > 20
    assert len(seen) > 1


@pytest.mark.slow
@pytest.mark.parametrize("slot", [0.05, 0.3])
def test_at_equal_speeds_voronoi_is_the_centralised_benchmark_event_for_event(slot):
    """(d - eps) / (v - v_e) is least for the nearest. The centre commands in the order of ids, as all decide here."""
    total = 0
    for seed in range(4):
        for p0 in (0.0, 1.0):
            team = Team(count=12, speeds=0.91, active_at_start=p0)
            ideal, found = (
                run(scattered(protocol, seed, team=team), seed).trace.of(Decided)
                for protocol in (Centralised(slot=slot), Voronoi(slot=slot))
            )
            assert found == ideal
            total += len(found)
    assert total > 60  # 48 to begin with


@pytest.mark.slow
@pytest.mark.parametrize("prune", ["none", "inf", "infeasible"])
@pytest.mark.parametrize("payload", ["action", "time", "state"])
def test_argmin_by_time_of_capture_is_the_centralised_benchmark_event_for_event(payload, prune):
    """Unequal speeds, some too slow; announced or sensed, which is equivalent at zero latency.

    Announced times are as of the announcement, so they agree only if announced at every slot: in a static game.
    """
    total, frozen = 0, payload == "time"
    for seed in (0, 1, 3):
        rng = np.random.default_rng(seed)
        given = {
            "speeds": [0.8, *rng.uniform(*((0.8, 3.0) if frozen else (0.90999, 0.91001)), 11).tolist()],
            "horizon": 9.0 if frozen else 2000.0,
            "motion": Motion(step=0.05, static=frozen),
            "announce": Announcements(payload=payload, belief_timeout=np.inf),
            "prune": prune,
        }
        ideal, found = (
            run(scattered(protocol, seed, **given), seed).trace.of(Decided)
            for protocol in (Centralised(slot=0.1), Argmin(slot=0.1))
        )
        assert found == ideal
        assert found
        total += sum(decision.t > 0 for decision in found)
    assert frozen or total > 4


@pytest.mark.whole
def test_at_unequal_speeds_the_nearest_pursuer_is_not_the_one_that_would_capture_first():
    """The control: the same pursuits by Voronoi and by time of capture differ."""
    speeds = {"default": 1.0, "last": 2.0}
    by_cell, by_time = (
        [run(scattered(law, seed, speeds=speeds), seed).trace.of(Decided) for seed in range(4)]
        for law in (Voronoi(), Argmin())
    )
    assert by_cell != by_time


@pytest.mark.slow
def test_a_pursuer_that_would_be_late_is_never_the_owner():
    """Nearest is pursuer 0, phi = (1.1 - 0.1) / (1 - 0.9) = 10 s; pursuer 1 needs (3.1 - 0.1) / (2.9 - 0.9) = 1.5 s.

    With 20 s left 0 chases, with 9 s left 1, with 1 s left none; one that is too slow never.
    """
    for horizon, owner in ((20.0, 0), (9.0, 1), (1.0, None)):
        for pursuers, speeds, shift in ((2, [1.0, 2.9], 0), (3, [0.5, 1.0, 2.9], 1)):
            places = [(0.2, 0.0)] * shift + [(1.1, 0.0), (0.0, 3.1)]
            scenario = Scenario(
                horizon=horizon,
                team=Team(positions=places, speeds=speeds),
                evader=Evader(position=(0.0, 0.0)),
                motion=Motion(static=True),
                protocol=Voronoi(),
            )
            expected = tuple(owner is not None and j == owner + shift for j in range(pursuers))
            assert [*profiles(run(scenario)).values()][-1] == expected


@pytest.mark.slow
def test_of_equals_the_lowest_id_is_the_owner():
    team = Team(positions=[(3.0, 0.0), (0.0, 2.0), (2.0, 0.0)], speeds=1.5)
    evader = Evader(position=(0.0, 0.0))
    for protocol in (Voronoi(), Argmin(), Argmin(by="intercept_time")):
        result = run(Scenario(team=team, evader=evader, motion=Motion(static=True), protocol=protocol, horizon=9.0))
        assert owners(result) == [1]


def test_by_intercept_time_the_owner_is_the_first_to_meet_an_evader_on_a_straight_path():
    """The evader runs from (0, 0) in x at 0.9 m/s. 0 is nearest, 1 m behind it; 1 is 2 m ahead; v = 1 m/s.

    0 closes in at 0.1 m/s and needs (1 - 0.1) / 0.1 = 9 s, 1 at 1.9 m/s and needs 1 s. At t = 0 no velocity is known
    yet, and 0 is first; from the next slot on, at 0.05 s, the estimate is exact, for the evader never turned.
    """
    scenario = scattered(
        Argmin(by="intercept_time", slot=0.05),
        0,
        team=Team(positions=[(-1.0, 0.0), (2.0, 0.0)], speeds=1.0, active_at_start=0.0),
        evader=Evader(position=(0.0, 0.0), speed=0.9, strategy=lambda state, rng: 1.0),
    )
    result = run(scenario)
    switch = 50_000_000
    assert result.trace.of(Decided) == [Decided(0, 0, True), Decided(switch, 0, False), Decided(switch, 1, True)]
    # 0 has moved 0.05 m, the evader 0.045 m: then 1 closes 2 - 0.045 - 0.1 at 1.9 m/s.
    assert summary(result).capture_time == pytest.approx(0.05 + 1.855 / 1.9, abs=1e-8)
    by_phi = run(scenario.model_copy(update={"protocol": Argmin(slot=0.05)}))
    assert by_phi.trace.of(Decided)[:2] == [Decided(0, 0, True), *by_phi.trace.of(Decided)[1:2]]
    assert by_phi.trace.of(Decided)[1].t > switch


@pytest.mark.slow
@pytest.mark.parametrize(
    "flow",
    [
        {"kind": "uniform", "velocity": (0.8, -0.3)},
        {"kind": "harmonic", "amplitude": (0.8, -0.5), "period": 2.0},
    ],
    ids=lambda flow: flow["kind"],
)
def test_by_intercept_time_a_flow_that_carries_all_changes_no_decision(flow):
    scenario = scattered(Argmin(by="intercept_time", slot=0.05), 3, evader=Evader(strategy="zigzag"), horizon=5.0)
    still, carried = (
        run(Scenario(**dict(scenario) | {"environment": {"flow": each}})).trace.of(Decided)
        for each in ({"kind": "none"}, flow)
    )
    assert len(still) > 4
    assert carried == still


@pytest.mark.parametrize(("wind", "owner"), [(0.0, 1), (0.5, 0)])
def test_by_intercept_time_pursuers_allow_for_a_wind_that_carries_them_alone(wind, owner):
    """The evader stands at 5 m: with the wind (5 - 0.1) / 2 = 2.45 s from behind, and (3 - 0.1) / 1 s from ahead."""
    scenario = scattered(
        Argmin(by="intercept_time", slot=0.05),
        0,
        team=Team(positions=[(0.0, 0.0), (8.0, 0.0)], speeds=1.5, active_at_start=0.0),
        evader=Evader(position=(5.0, 0.0), speed=0.0, strategy="still"),
        environment={"flow": {"kind": "uniform", "velocity": (wind, 0.0)}, "on": "pursuers"},
    )
    result = run(scenario)
    assert result.trace.of(Decided) == [Decided(0, owner, True)]
    assert summary(result).capture_time == pytest.approx(2.45 if owner == 0 else 2.9 / 1.5, abs=1e-6)


def test_after_a_turn_the_intercept_is_right_once_the_filter_has_settled():
    """The evader runs up for 1 s, then in x: its estimate is 0.9 ((1 - q) + i q), q = exp(-(t - 1) / 0.5), t >= 1.

    0 is below it, 1 to the right; the evader at (x, 0.9), x = 0.9 (t - 1). The first by the closed form with that
    estimate chases at each slot; the pure estimate would have changed over at once.
    """
    places, radius, slot = np.array([0.4 + 2.9j, 3.2 + 0.9j]), 0.1, 0.05

    def run_up_then_right(state, rng):
        return 1j if state.t < 1.0 else 1.0

    result = run(
        scattered(
            Argmin(by="intercept_time", slot=slot, time_constant=0.5),
            0,
            horizon=200.0,
            team=Team(positions=[(z.real, z.imag) for z in places], speeds=1.0, active_at_start=0.0),
            evader=Evader(position=(0.0, 0.0), speed=0.9, strategy=run_up_then_right),
            record=Recording(trajectory=slot),
        )
    )
    found, chasing, changed = profiles(result), None, []
    samples = [sample for sample in result.trace.of(Sampled) if sample.t % 50_000_000 == 0][:-1]
    for k, sample in enumerate(samples):
        before, chasing = chasing, found.get(sample.t, chasing)
        if chasing != before:
            changed.append(k)
        if k < 1:
            continue
        q = 1.0 if k <= 20 else np.exp(-(k - 20) * slot / 0.5)
        w = 0.9 * ((1 - q) + 1j * q)
        gaps = complex(*sample.evaders[0]) - np.array([complex(*p) for p in sample.pursuers])
        assert chasing.index(True) == int(np.argmin([meets(gap, w, 1.0, radius) for gap in gaps]))
    assert changed[0] == 0
    assert 20 < changed[1] < 60  # some slots after the turn


def meets(gap, w, v, radius):
    """Return the least t with |gap + w t| = v t + radius, by the roots of the polynomial."""
    polynomial = [abs(w) ** 2 - v**2, 2 * ((gap * w.conjugate()).real - radius * v), abs(gap) ** 2 - radius**2]
    return min(root.real for root in np.roots(polynomial) if root.real > 0 and abs(root.imag) < 1e-12)


# The filter.


@given(st.floats(0.01, 2.0), st.floats(0.01, 1.0), st.integers(1, 30))
def test_the_filter_answers_a_step_by_an_exponential(time_constant, slot, slots):
    """At rest first, then at 2 + 1j m/s: the estimate lacks exp(-t / T) of it."""
    velocity = VelocityFilter(time_constant, STILL)
    assert velocity(0.0, 5j) == 0j
    assert velocity(slot, 5j) == 0j
    for k in range(1, slots + 1):
        found = velocity((k + 1) * slot, 5j + (2 + 1j) * k * slot)
    assert found == pytest.approx((2 + 1j) * (1 - np.exp(-slots * slot / time_constant)), abs=1e-9)


def test_the_filter_keeps_its_velocity_while_nothing_is_seen():
    """Nor is the way between two sights with a gap between them taken for a velocity."""
    velocity = VelocityFilter(0.0, STILL)
    velocity(1.0, 1 + 0j)
    assert velocity(1.5, 2 + 0j) == 2 + 0j
    assert velocity(2.0, complex(np.nan, np.nan)) == 2 + 0j
    assert velocity(2.5, 9 + 0j) == 2 + 0j
    assert velocity(3.0, 9.5 + 0j) == 1 + 0j


def test_the_filter_keeps_its_velocity_until_a_later_time():
    """As a crash ends in a slot, the rule decides late and in that slot again; a clock can be set back, too."""
    velocity = VelocityFilter(1.0, STILL)
    assert velocity(1.0, 1 + 0j) == velocity(1.0, 2 + 0j) == velocity(0.5, 3 + 0j) == 0j
    assert velocity(1.5, 2 + 0j) == 2 + 0j
    assert velocity(1.5, 5 + 0j) == velocity(1.0, 5 + 0j) == 2 + 0j
    assert velocity(2.0, 3 + 0j) == 2 + 0j


def test_the_filter_begins_with_the_first_velocity_and_without_a_time_constant_follows_at_once():
    assert [VelocityFilter(9.0, STILL)(0.0, 1j), 0j] == [0j, 0j]
    slow, quick = VelocityFilter(9.0, STILL), VelocityFilter(0.0, STILL)
    for velocity in (slow, quick):
        velocity(1.0, 1 + 0j)
        assert velocity(1.5, 2 + 0j) == pytest.approx(2 + 0j)
    assert quick(2.0, 2 + 1j) == pytest.approx(2j)
    assert abs(slow(2.0, 2 + 1j) - 2) < 0.2


# Several evaders.


def test_of_several_evaders_each_has_an_owner_of_its_own_the_nearest_first():
    """Pursuers 0, 1, 4 at 1, 2, 9 of the first evader and 2, 5, inf of the second: 0 has the first, 1 the second."""
    ids, near, far = [0, 1, 4], [1.0, 2.0, 9.0], [2.0, 5.0, np.inf]
    nobody = {1: [], 2: [], 3: []}
    assert owners_of(ids, {1: near, 2: far}, nobody, 0.0) == {1: 0, 2: 1}
    assert owners_of(ids, {1: near, 2: near}, nobody, 0.0) == {1: 0, 2: 1}
    assert owners_of(ids, {1: far, 2: near, 3: far}, nobody, 0.0) == {2: 0, 1: 1}
    assert owners_of(ids, {2: [np.inf] * 3}, nobody, 0.0) == owners_of(ids, {}, nobody, 0.0) == {}
    assert owners_of(ids, {1: near, 2: far}, {1: [1], 2: [0]}, 0.6) == {1: 1, 2: 0}
    assert near == [1.0, 2.0, 9.0]


def test_the_announced_chasers_of_an_evader_include_oneself():
    me = SimpleNamespace(id=3, action=2, believed_active={1: [0], 2: [1, 4], 3: []}.get)
    assert [announced_chasers(me, evader) for evader in (1, 2, 3)] == [[0], [1, 4, 3], []]


@pytest.mark.slow
@pytest.mark.parametrize("payload", ["action", "state"])
@pytest.mark.parametrize("protocol", [Voronoi(slot=0.5), Argmin(slot=0.5), Argmin(slot=0.5, by="intercept_time")])
def test_at_rest_the_owners_are_those_of_the_greedy_assignment(protocol, payload):
    """Three games of six and three evaders. All are equally fast, so that distances order them as times do."""
    for seed in range(3):
        team = Team(count=6, speeds=1.0, active_at_start=0.5)
        case = at_rest(protocol, 6, 3, seed, team=team, announce=Announcements(payload=payload))
        result = run(case, None, lambda event: event.t > 2 * SECOND)
        assert chased(result) == greedy_assignment(by_evader(times(result)), 30.0)
        assert len(chased(result)) == 3


# Hysteresis.


def test_takeovers_with_hysteresis_in_worked_examples():
    """1 is better than 0 by a tenth: at a hysteresis of less than 0.1 it takes over, at 0.1 it does not yet."""
    ids, measures = [0, 1, 4], [10.0, 9.0, 30.0]
    assert [first(ids, measures, [0], h) for h in (0.0, 0.09, 0.1, 0.5)] == [1, 1, 0, 0]
    assert [first(ids, measures, [4], h) for h in (0.0, 0.5, 0.8)] == [1, 1, 4]
    assert first(ids, measures, [0, 4], 0.5) == first(ids, measures, [None, 0], 0.5) == 0
    assert first(ids, measures, [None], 0.5) == first(ids, measures, [], 0.5) == first(ids, measures, [3], 0.5) == 1
    assert first(ids, [np.inf, np.inf, 30.0], [0], 0.5) == 4  # the owner cannot any more
    assert first(ids, [np.inf] * 3, [0], 0.5) is None
    assert first(ids, [7.0, 7.0, 7.0], [1], 0.0) == 0  # without hysteresis there is no memory
    assert first(ids, [7.0, 7.0, 7.0], [1], 1e-9) == 1


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("model", [Voronoi, Argmin])
def test_hysteresis_reduces_handovers_and_exactly_one_pursuer_chases_at_any_time(model):
    """Four pursuits in which the evader runs from cell to cell; without hysteresis it changes hands far more often.

    At every instant with a decision exactly one chases when all have decided.
    """
    counts = {}
    for hysteresis in (0.0, 0.02, 0.1):
        protocol = model(slot=0.05, hysteresis=hysteresis)
        runs = [owners(run(scattered(protocol, seed), seed)) for seed in range(4)]
        counts[hysteresis] = sum(len(each) - 1 for each in runs)
    assert counts[0.0] > counts[0.02] > counts[0.1] > 0
    assert counts[0.0] > 5 * counts[0.1]


@pytest.mark.slow
def test_with_hysteresis_the_owner_is_within_the_band_and_changes_hands_only_beyond_it():
    """At every slot the distance of the owner is at most 1 / (1 - h) of the least; as it changes hands it was more."""
    h, hand_overs = 0.05, 0
    for seed in range(4):
        result = run(scattered(Voronoi(slot=0.05, hysteresis=h), seed, record=Recording(trajectory=0.05)), seed)
        found, owner = profiles(result), None
        samples = [sample for sample in result.trace.of(Sampled) if sample.t % 50_000_000 == 0][:-1]
        for sample in samples:
            distances = np.hypot(*(np.array(sample.pursuers) - sample.evaders[0]).T)
            now = found[sample.t].index(True) if sample.t in found else owner
            assert distances[now] * (1 - h) <= distances.min() * (1 + 1e-9)
            if now != owner and owner is not None:
                assert distances[now] == distances.min() < (1 - h) * distances[owner]
                hand_overs += 1
            owner = now
    assert hand_overs > 0


# Messages.


@pytest.mark.slow
def test_nothing_is_announced_where_positions_are_sensed():
    for protocol in (Voronoi(hysteresis=0.1, slot=0.05), Argmin(slot=0.05), Argmin(by="intercept_time", slot=0.05)):
        for seed in range(2):
            assert summary(run(scattered(protocol, seed, horizon=5.0, speeds=2.0), seed)).messages_sent == 0


@pytest.mark.slow_but_one
@pytest.mark.parametrize("trigger", ["both", "change", "heartbeat", "never"])
def test_without_sensed_positions_pursuers_announce_and_repeat_their_actions(trigger):
    """10 pursuers, 5 s: a heartbeat of 0.5 s from a random phase is 10 announcements each; changes come on top."""
    announce = Announcements(payload="state", trigger=trigger, start="known", heartbeat=0.5)
    scenario = scattered(
        Voronoi(slot=0.05), 0, count=10, speeds=9.0, horizon=5.0, motion=Motion(static=True), announce=announce
    )
    beats, told = 10 * 10 * 9, 9 * 9  # nine stop chasing at once
    expected = {"both": beats + told, "change": told, "heartbeat": beats, "never": 0}[trigger]
    assert summary(run(scenario)).messages_sent == expected


@pytest.mark.slow
def test_of_two_pursuers_that_both_believe_to_be_the_owner_one_stops():
    """0 at 10.5 m and 1 at 10 m are both active, within 20 % of each other: 0 stops, 1 goes on."""
    for payload in ("state", "time"):
        scenario = Scenario(
            horizon=99.0,
            team=Team(positions=[(10.5, 0.0), (10.0, 0.0)], speeds=2.0, active_at_start=1.0),
            evader=Evader(position=(0.0, 0.0)),
            motion=Motion(static=True),
            protocol=Argmin(hysteresis=0.2, slot=0.1),
            announce=Announcements(payload=payload, start="silent", heartbeat=0.5),
            network=Links(latency=Constant(value=0.3)),
        )
        (stops,) = run(scenario).trace.of(Decided)
        assert stops[1:] == (0, False)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("payload", ["action", "time", "state"])
def test_random_static_games_end_in_the_relay_profile(payload):
    """3 games: any speeds by time of capture, equal ones by distance or intercept; announcements are late, or lost."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        count = int(rng.integers(2, 13))
        protocol = [Argmin(slot=0.1), Voronoi(slot=0.1), Argmin(by="intercept_time", slot=0.1)][
            0 if payload == "time" else seed % 3
        ]
        speeds = rng.uniform(0.8, 2.0, count).tolist() if protocol == Argmin(slot=0.1) else 1.5
        scenario = Scenario(
            horizon=30.0,
            team=Team(count=count, speeds=speeds, active_at_start=float(rng.choice([0.0, 0.5, 1.0]))),
            motion=Motion(static=True),
            protocol=protocol,
            announce=Announcements(payload=payload, heartbeat=0.5, belief_timeout=np.inf, start=STARTS[seed % 3]),
            network=Links(latency=Lognormal(mean=0.2, cv=1.0), loss=Bernoulli(p=0.3)),
            record=Recording(trajectory=0.0),
        )
        result = run(scenario, seed)
        start = result.trace.of(Started)[0]
        phi = capture_time(
            start.evaders[0], start.pursuers, start.speeds, scenario.evader.speed, scenario.capture.radius
        )
        final = [start.active, *profiles(result).values()][-1]
        assert final == relay_profile(phi.tolist(), 30.0)


@pytest.mark.slow
def test_delayed_announcements_cause_temporary_disagreement():
    """The control: with the state announced and half a second of latency several or none chase at times."""
    announce = Announcements(payload="state")
    links = Links(latency=Constant(value=0.5))
    sums = set()
    for seed in range(3):
        scenario = scattered(Voronoi(slot=0.05), seed, horizon=15.0, count=5, announce=announce, network=links)
        sums |= {sum(profile) for profile in profiles(run(scenario, seed)).values()}
    assert sums - {1}


# What it assumes.


def test_its_assumptions():
    def why(protocol, **given):
        scenario = Scenario(team=Team(count=5, speeds=given.pop("speeds", 1.0)), protocol=protocol, **given)
        return sorted(reason.split()[2].rstrip(",") for _, reason in violations(scenario))

    crash, skew = (Crash(node=1, start=1.0),), (ClockSkew(offset=0.01),)
    assert why(Voronoi()) == why(Argmin()) == why(Argmin(hysteresis=0.1, by="intercept_time")) == []
    assert why(Voronoi(), speeds={"last": 2.0}) == ["equal_speeds"]
    assert why(Argmin(), speeds={"last": 2.0}) == []
    assert why(Voronoi(), fault=crash) == why(Argmin(), fault=crash) == ["no_crashes"]
    assert why(Voronoi(), fault=skew) == why(Argmin(), fault=skew) == []
    assert why(Voronoi(hysteresis=0.1), fault=skew) == why(Argmin(hysteresis=0.1), fault=skew) == ["equal_clocks"]
    told = Announcements(payload="time")
    assert why(Voronoi(), announce=told) == why(Argmin(by="intercept_time"), announce=told) == ["positions_known"]
    assert why(Argmin(), announce=told) == []
    near = Links(range=1.0)
    assert why(Argmin(), announce=told, network=near) == ["times_known"]
    assert why(Argmin(), network=near) == []
    silent = Announcements(payload="state", trigger="never")
    assert why(Voronoi(), announce=silent) == ["positions_known"]
    assert why(Argmin(), announce=silent) == ["times_known"]


@pytest.mark.parametrize("protocol", [Voronoi(slot=0.1), Argmin(by="intercept_time", slot=0.1)])
def test_a_pursuer_resumes_as_soon_as_it_is_repaired(protocol):
    """Pursuer 0, the owner, is down from 1 to 2.03 s and chases again at once; no other replaced it."""
    team = Team(positions=[(1.1, 0.0), (0.0, 3.1)], speeds=1.0)
    scenario = Scenario(
        horizon=99.0,
        team=team,
        evader=Evader(position=(0.0, 0.0), speed=0.5),
        motion=Motion(static=True),
        protocol=protocol,
        fault=(Crash(node=0, start=1.0, end=2.03),),
        record=Recording(trajectory=0.0),
    )
    decided = run(scenario.model_copy(update={"horizon": 9.0})).trace.of(Decided)
    assert decided == [Decided(0, 1, False), Decided(2_030_000_000, 0, True)]

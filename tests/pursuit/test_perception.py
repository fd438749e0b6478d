"""What an evader perceives: late, near by, and what it did before."""

import weakref
from math import inf

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import ncx2

from desim import Scenario, run, summary
from desim.kernel.models.graphs import Edges, Link
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.core.events import Sampled
from desim.pursuit.core.state import State
from desim.pursuit.evaders.evader import DelayedState, InferredActivity
from desim.pursuit.evaders.evasion import (
    ConstantHeading,
    Diffusion,
    Listener,
    MaxMin,
    PureEvasion,
    Still,
    VoronoiVertex,
    Zigzag,
)
from desim.pursuit.evaders.observation import EvaderObservation
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion
from protocols.dissemination import Flooding, Gossip

MS = 1_000_000
SPEEDS = np.array([1.0, 1.5, 2.0])
TEAM = np.array([-2 + 0j, 3j, 5 + 5j])
DRIFT = np.array([1 + 0j, -0.5j, -1 - 1j])
"""m/s"""


def state(t, *, evader=0j, active=(True, True, False)):
    """Return the state at an instant (ns) at which the team has drifted from where it was at 0."""
    return State(t, TEAM + DRIFT * (t / 1e9), evader, np.array(active))


class Witness:
    """A strategy that keeps its outlooks and answers with one heading after the other."""

    def __init__(self, *headings):
        self.outlooks, self._headings = [], iter(headings)

    def __call__(self, state, rng):
        self.outlooks.append(state)
        return next(self._headings, 1 + 0j)


def controller(strategy, *, seed=0, **settings):
    return Evader(strategy=strategy, **settings).controller(np.random.default_rng(seed), SPEEDS, 0.1)


def observations(states, **settings):
    """Return the outlooks of an evader that is asked in these states."""
    witness = Witness()
    whole = controller(witness, **settings)
    for each in states:
        whole.heading(each)
    return witness.outlooks


# Everything, at once.


@pytest.mark.parametrize(
    "strategy",
    [PureEvasion(), MaxMin(), Zigzag(), Diffusion(), VoronoiVertex(arena=(-9.0, 9.0))],
    ids=lambda strategy: strategy.kind,
)
def test_full_and_immediate_perception_gives_exactly_the_heading_of_the_strategy(strategy):
    whole, rng, heading = controller(strategy, seed=3), np.random.default_rng(3), 0j
    for k in range(40):
        now = state(50 * k * MS, evader=0.1 * k + 0j)
        expected = strategy(EvaderObservation(now, SPEEDS, 0.9, 0.1, heading, 0.05 if k else 0.0), rng)
        heading = whole.heading(now)
        assert heading == expected


def test_an_observation_has_the_state_and_the_evaders_own_data():
    (observation,) = observations([now := state(7 * MS)], speed=0.9)
    for name, value in vars(now).items():
        assert getattr(observation, name) is value
    assert (observation.speed, observation.radius, observation.speeds.tolist()) == (0.9, 0.1, SPEEDS.tolist())


@pytest.mark.parametrize("sight", [inf, 2.5])
def test_an_observation_has_the_last_heading_and_elapsed_time_at_any_sensing_range(sight):
    witness = Witness(1j, 0j, 0.5 + 0j)
    whole = controller(witness, sensing_range=sight)
    chosen = [whole.heading(state(t * MS), handover=t == 40) for t in (0, 10, 40, 45)]
    assert chosen == [1j, 0j, 0.5 + 0j, 1 + 0j]
    assert [each.heading for each in witness.outlooks] == [0j, 1j, 0j, 0.5 + 0j]
    assert [each.elapsed for each in witness.outlooks] == [0.0, 0.01, 0.03, 0.005]
    assert [each.handover for each in witness.outlooks] == [False, False, True, False]
    assert [len(each.pursuers) for each in witness.outlooks] == [3 if sight == inf else 1] * 4


def test_only_listening_strategies_need_handovers():
    assert [Evader(strategy=each).listens for each in (PureEvasion(), Witness(), Listener())] == [False, False, True]
    listening = controller(Listener())
    assert [listening.heading(state(0), handover) for handover in (True, False)] == [1 + 0j, 0j]


@pytest.mark.parametrize("heading", [1.1 + 0j, 1 + 1j, complex("nan")])
def test_a_heading_of_more_than_1_is_refused(heading):
    def wrong(state, rng):
        return heading

    with pytest.raises(
        ValueError, match=r"a heading should be a complex number of length at most 1, got .* from wrong \(tests"
    ):
        controller(wrong).heading(state(0))


# By motion.


def inferred(interval, error, times, *, seed=1, speeds=SPEEDS, moving=DRIFT):
    """Return the inferred activity of pursuers that move at constant velocities from 1 s on, by time, ms."""
    look = InferredActivity(interval * MS, error, speeds, np.random.default_rng(seed))
    team = np.zeros(len(speeds), dtype=complex)
    return {t: look(State(t * MS, team + max(t / 1e3 - 1.0, 0.0) * moving, 9j, speeds > 0)).active for t in times}


def test_activity_is_inferred_from_what_a_pursuer_has_moved_since_the_last_look():
    """At 1, 0.5 and 1.4 m/s of 1, 1.5 and 2: the second is too slow. The change of 1 s is seen at the look of 1.2 s.

    At first all count; at the look of 1 s no pursuer has moved, and one at 1.2 s tells of the whole interval.
    """
    found = inferred(200, 0.0, range(0, 1500, 10))
    still, moving = [False] * 3, [True, False, True]
    assert [found[t].tolist() for t in (0, 190)] == [[True] * 3] * 2
    assert [found[t].tolist() for t in (200, 1000, 1190)] == [still] * 3
    assert [found[t].tolist() for t in (1200, 1400)] == [moving] * 2


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.3, 0.6, 1.2])
def test_a_pursuer_that_stands_still_counts_as_active_as_often_as_the_errors_say(ratio):
    """exp(-(v T / 4 s)^2), by Rayleigh's law; and a chaser by Rice's. Control: errors of deviation s, not sqrt(2) s."""
    n, error = 4000, 0.2 / (4 * ratio)
    speeds = np.full(n, 1.0)
    for moving, share in (
        (0.0, np.exp(-(ratio**2))),
        (1.0, 1.0 - ncx2.cdf(0.01 / (2 * error**2), 2, 0.04 / (2 * error**2))),
    ):
        found = inferred(200, error, (1000, 1200), speeds=speeds, moving=np.full(n, moving + 0j))[1200].mean()
        assert abs(found - share) < 4.0 * np.sqrt(share * (1.0 - share) / n)
        if not moving:
            assert abs(found - np.exp(-2 * ratio**2)) > 4.0 * np.sqrt(share * (1.0 - share) / n)


def test_an_evader_that_flees_who_seems_to_chase_does_so():
    """The nearest stands still, so it is fled only as long as nothing is known."""
    evader = Evader(strategy=PureEvasion(flees_from="active"), motion_interval=0.1)
    made = evader.controller(np.random.default_rng(1), SPEEDS, 0.1)
    team = np.array([-1 + 0j, 3j, 5 + 5j])
    headings = [made.heading(State(t * MS, team - 1j * t / 1e3 * (TEAM == 3j), 0j, SPEEDS > 9)) for t in (0, 50, 100)]
    assert headings == [1 + 0j, 1 + 0j, -1j]
    known = Evader(strategy=PureEvasion(flees_from="active")).controller(np.random.default_rng(1), SPEEDS, 0.1)
    assert known.heading(State(0, team, 0j, SPEEDS > 9)) == 0j


def test_errors_of_looks_change_no_draw_of_the_strategy_and_need_looks():
    rngs = [np.random.default_rng(3) for _ in range(2)]
    for rng, settings_ in zip(rngs, ({}, {"motion_interval": 0.1, "motion_error": 0.5}), strict=True):
        Evader(strategy=Diffusion(), **settings_).controller(rng, SPEEDS, 0.1).heading(state(0))
    assert rngs[0].random() == rngs[1].random()
    with pytest.raises(ValueError, match="has no effect without a motion_interval"):
        Evader(motion_error=0.1)


# Late.


@pytest.mark.parametrize("k", [1, 3, 7])
def test_a_reaction_of_k_steps_shows_the_pursuers_as_they_were_k_steps_before(k):
    """And the evader where it is; in the first k steps, the pursuers as they were at first."""
    states = [state(10 * n * MS, evader=0.3j * n, active=(n % 2 == 0, n % 3 == 0, True)) for n in range(20)]
    late = observations(states, reaction_delay=k * 0.01)
    for n, observation in enumerate(late):
        before = states[max(n - k, 0)]
        assert (observation.t, observation.evader) == (states[n].t, states[n].evader)
        assert observation.pursuers.tolist() == before.pursuers.tolist()
        assert observation.active.tolist() == before.active.tolist()
        assert observation.offsets.tolist() == (states[n].evader - before.pursuers).tolist()


@given(st.lists(st.integers(1, 400), min_size=1, max_size=30), st.integers(1, 10**9))
def test_delayed_positions_on_straight_paths_are_exact_at_any_query_rate(steps, delay):
    memory = DelayedState(delay)
    for t in np.cumsum([0, *steps]) * MS:
        seen = memory(state(int(t))).pursuers
        assert seen == pytest.approx(TEAM + DRIFT * max(int(t) - delay, 0) / 1e9, abs=1e-12)


def test_between_two_steps_the_delayed_actions_are_those_of_the_earlier_step():
    """Orders at 10 ms; what was 1 ms before that is seen 14 ms later, what was at 10 ms 1 ms after that."""
    memory = DelayedState(14 * MS)
    profiles = [(True, True, True), (False, True, True)]
    memory(state(0, active=profiles[0])), memory(state(10 * MS, active=profiles[1]))
    assert memory(state(23 * MS)).active.tolist() == list(profiles[0])
    assert memory(state(24 * MS)).active.tolist() == list(profiles[1])


def test_repeated_queries_at_one_instant_change_nothing():
    once, twice = (
        observations([state(t * MS) for t in times], reaction_delay=0.015)
        for times in ((0, 10, 20), (0, 0, 10, 10, 20))
    )
    assert once[-1].pursuers.tolist() == twice[-1].pursuers.tolist()


def test_old_states_are_dropped():
    memory, living = DelayedState(30 * MS), weakref.WeakSet()
    for k in range(200):
        memory(now := state(10 * k * MS))
        living.add(now)
    del now
    assert len(living) == 4


def test_a_late_evader_flees_from_where_a_pursuer_was():
    """It stands at 0; a pursuer passes it from left to right, 2 s after the start. The heading turns 1 s later."""
    passing = [State(k * 100 * MS, np.array([-2 + 0.1 * k, 90j]), 0j, np.ones(2, bool)) for k in range(45)]
    prompt, late = (
        Evader(reaction_delay=reaction_delay).controller(np.random.default_rng(), np.ones(2), 0.1)
        for reaction_delay in (0.0, 1.0)
    )
    turns = [next(each.t for each in passing if who.heading(each).real < 0.0) for who in (prompt, late)]
    assert turns == pytest.approx([2.1, 3.1])


# Near by.


def test_an_evader_sees_the_pursuers_within_its_sensing_range_in_team_order():
    """At 2, 3 and 7.07 m."""
    for sight, count in ((0.0, 0), (1.99, 0), (2.0, 1), (3.0, 2), (7.0, 2), (7.1, 3), (inf, 3)):
        (observation,) = observations([state(0)], sensing_range=sight)
        assert observation.pursuers.tolist() == TEAM[:count].tolist()
        assert observation.speeds.tolist() == SPEEDS[:count].tolist()
        assert observation.active.tolist() == [True, True, False][:count]
        assert observation.nearest == (0 if count else -1)
    (observation,) = observations([state(0, evader=5 + 4j)], sensing_range=5.5)
    assert (observation.pursuers.tolist(), observation.nearest) == (TEAM[1:].tolist(), 1)


@pytest.mark.parametrize("flees_from", ["all", "active"])
def test_without_pursuers_in_sensing_range_there_is_none_to_flee_from(flees_from):
    whole = controller(PureEvasion(flees_from=flees_from), sensing_range=1.0)
    assert [whole.heading(state(t * MS)) for t in (0, 900, 1000)] == [0j, 0j, 1 + 0j]


def test_the_sensing_range_applies_to_the_delayed_positions():
    """The first is at 1 m after 1 s; it sees it there half a second late."""
    counts = [
        len(each.pursuers)
        for each in observations([state(k * 100 * MS) for k in range(16)], sensing_range=1.0, reaction_delay=0.5)
    ]
    assert counts == [0] * 15 + [1]


# In a run.


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "time"),
    [({}, 5.8), ({"sensing_range": 2.0}, 4.467), ({"sensing_range": 2.0, "reaction_delay": 0.2}, 4.067)],
)
def test_an_evader_with_a_shorter_sensing_range_is_captured_sooner(settings, time):
    """A pursuer of 1.5 m/s at 3 m, radius 0.1 m; the evader flees at 1 m/s: 2.9 / 0.5 s if it sees it from the start.

    It is 2 m away after 1 / 1.5 s, and captures it 1.9 / 0.5 s later; if that is noticed 0.2 s late, it is only 1.7 m
    away by then, and needs 1.6 / 0.5 s.
    """

    def nothing(me):
        yield me.at(0.0)

    scenario = Scenario(
        team=Team(positions=((-3.0, 0.0),), speeds=1.5),
        evader=Evader(position=(0.0, 0.0), speed=1.0, **settings),
        motion=Motion(step=0.001),
        protocol=nothing,
    )
    assert summary(run(scenario)).capture_time == pytest.approx(time, abs=0.003)


# Listening in a run.

LATENCY = 0.5
"""Of every message, s."""
APART = Team(positions=((100.0, 0.0), (110.0, 0.0), (120.0, 0.0)), speeds=2.0, active_at_start=0.0)
CHASING = APART.model_copy(update={"active_at_start": 1.0})


def flight_distance(*changes, dissemination=None, **keys):
    """Return how far an evader goes, m, that moves at 1 m/s while an announcement of a change is in flight, and
    otherwise stands.

    Args:
        changes: (time, pursuer, action), the action of the pursuer from this time on, which it announces then.
        dissemination: how announcements spread; one hop if None.
        keys: of the scenario.
    """

    def behaviour(me):
        for time, who, action in changes:
            if who == me.id:
                yield me.at(time)
                me.assign(action)
                me.broadcast()

    said = {} if dissemination is None else {"dissemination": dissemination}
    settings = {
        "team": APART,
        "evader": Evader(position=(0.0, 0.0), speed=1.0, strategy=Listener(during_handover=ConstantHeading(angle=0.0))),
        "network": Links(latency=Constant(value=LATENCY)),
        "announce": Announcements(trigger="never", **said),
    }
    result = run(Scenario(horizon=5.0, protocol=behaviour, **(settings | keys)))
    return pytest.approx(result.trace.of(Sampled)[-1].evaders[0][0], abs=1e-9)


@pytest.mark.slow
def test_a_listener_moves_exactly_while_an_announcement_of_a_change_is_in_flight():
    assert flight_distance() == 0.0
    assert flight_distance((1.0, 0, 1)) == LATENCY
    assert flight_distance((1.0, 0, 1), (3.0, 0, 0)) == 2 * LATENCY
    assert flight_distance((1.0, 0, 1), (1.3, 1, 1)) == 0.3 + LATENCY


def test_a_repeated_announcement_is_no_change():
    assert flight_distance((1.0, 0, 1), (1.3, 0, 1), (3.0, 0, 1)) == LATENCY
    assert flight_distance((1.0, 0, 1), (1.3, 1, 0)) == LATENCY


def test_an_early_arrival_does_not_end_a_change_still_in_flight():
    """That of pursuer 0 is on its way to pursuer 2 until 1.5 s, that of pursuer 1 until 1.15 s."""
    quick = [Link(src=1, dst=node, latency=Constant(value=0.05)) for node in (0, 2)]
    links = Links(latency=Constant(value=LATENCY), link=quick)
    assert flight_distance((1.0, 0, 1), (1.1, 1, 1), network=links) == LATENCY


def test_the_initial_actions_are_known():
    assert flight_distance((1.0, 0, 1), team=CHASING) == 0.0
    assert flight_distance((1.0, 0, 0), team=CHASING) == LATENCY


@pytest.mark.slow
def test_to_chase_another_evader_is_a_change():
    listens = Evader(position=(0.0, 0.0), speed=1.0, strategy=Listener(during_handover=ConstantHeading(angle=0.0)))
    two = (listens, Evader(position=(0.0, 90.0), speed=1.0, strategy=Still()))
    assert flight_distance((1.0, 0, 1), (2.0, 0, 2), (3.0, 0, 2), evader=two) == 2 * LATENCY


@pytest.mark.parametrize(
    "keys",
    [
        {"team": Team(positions=((100.0, 0.0),), speeds=2.0, active_at_start=0.0)},
        {"network": Links(latency=Constant(value=LATENCY), range=2.0)},
        {"network": Links(latency=Constant(value=LATENCY), loss=Bernoulli(p=1.0))},
    ],
    ids=["nobody there", "nobody near", "all is lost"],
)
@pytest.mark.parametrize("dissemination", [None, Flooding(), Gossip()], ids=["one_hop", "flooding", "gossip"])
def test_an_announcement_without_receivers_is_not_in_flight(dissemination, keys):
    assert flight_distance((1.0, 0, 1), dissemination=dissemination, **keys) == 0.0


@pytest.mark.parametrize(("hops", "flights"), [(1, 1), (2, 2), (5, 3)])
def test_a_forwarded_change_is_in_flight_for_longer(hops, flights):
    """On a line of three: it travels to the next one, to that one's neighbours, and from the last one back."""
    line = Links(graph=Edges.of(nx.path_graph(3)), latency=Constant(value=LATENCY))
    flooding = Flooding(hops=hops, jitter=0.0)
    assert flight_distance((1.0, 0, 1), dissemination=flooding, network=line) == flights * LATENCY
    assert flight_distance((1.0, 0, 0), dissemination=flooding, network=line) == 0.0


def test_only_changes_among_forwarded_records_count():
    """Pursuer 1 stays, and announces it with all its records: at 1.2 s that pursuer 0 stayed at first, at 1.7 s that it
    chases.

    The record of the change is in flight from 1 to 1.5 s and from 1.7 to 2.2 s; what is out of date by 1.2 s is no
    change.
    """
    assert flight_distance((1.0, 0, 1), (1.2, 1, 0), dissemination=Gossip()) == LATENCY
    assert flight_distance((1.0, 0, 1), (1.2, 1, 0), (1.7, 1, 0), dissemination=Gossip()) == 2 * LATENCY


@pytest.mark.parametrize("settings", [{}, {"reaction_delay": 0.1}])
@pytest.mark.parametrize("name", ["offsets", "distances", "pursuers", "active"])
def test_a_strategy_cannot_change_what_it_sees(name, settings):
    """The world reads the same arrays."""

    def meddler(state, rng):
        getattr(state, name)[0] = 0
        return 1 + 0j

    scenario = Scenario(horizon=0.1, team=Team(count=3), evader=Evader(strategy=meddler, **settings))
    with pytest.raises(ValueError, match="read-only"):
        run(scenario)


@pytest.mark.parametrize(
    "who", [[True, False, True], np.array([1, 0, 1]), np.array([0, 2]), 5.0, None, np.array([True])]
)
def test_only_takes_a_mask_and_within_a_space(who):
    """Integers would be the numbers of pursuers, also 1 and 0."""

    def strategy(state, rng):
        with pytest.raises(ValueError, match=r"only\(who\) takes an array of 3 booleans"):
            state.only(who)
        with pytest.raises(ValueError, match=r"within\(space\) takes a space; .* write only\(state.distances <= 5.0\)"):
            state.within(5.0)
        asked.append(len(state.only(np.array([True, False, True])).pursuers))
        return 0j

    asked = []
    run(Scenario(horizon=0.1, team=Team(count=3), evader=Evader(strategy=strategy)))
    assert set(asked) == {2}

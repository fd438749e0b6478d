"""Rules without a utility, and games with neighbours only: maximal independent sets, and what has no equilibrium."""

from math import nan

import networkx as nx
import numpy as np
import pytest

from desim import Scenario, run
from desim.kernel.models.graphs import Edges
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.core.events import Decided, Started
from desim.pursuit.game.game import greedy_maximal_independent_set, relay_profile
from desim.pursuit.game.utility import EdgePenalty, LocalMean
from desim.pursuit.team.announcements import Announcements
from desim.pursuit.team.beliefs import Belief
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording
from protocols.best_response import BestResponse
from protocols.dissemination import Flooding, OneHop
from protocols.local_min import ArgminKnown, LocalMin
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.mutex import LocalMutex
from protocols.schedules.periodic import Periodic, Poisson, Rounds, SharedSeed
from protocols.temperature import ConstantTau


def static_game(protocol, graph, phi, seed=0, horizon=10.0, **changes):
    """Return a static game on a graph, r = 10 s; each is active at first with probability 1/2, known to all."""
    given = {
        "seed": seed,
        "horizon": horizon,
        "team": Team(positions=[(each + 0.1, 0.0) for each in phi], speeds=1.0, active_at_start=0.5),
        "evader": Evader(position=(0.0, 0.0), speed=0.0),
        "motion": Motion(static=True),
        "protocol": protocol,
        "announce": Announcements(trigger="change"),
        "network": Links(graph=Edges.of(graph)),
        "record": Recording(trajectory=0.0),
    }
    return Scenario(**(given | changes))


def changes_of(result):
    """Return the last profile of a run, and the times at which the profile changed, s."""
    profile, times = list(result.trace.of(Started)[0].active), []
    for decision in result.trace.of(Decided):
        if profile[decision.pursuer] != decision.active:
            profile[decision.pursuer] = decision.active
            times.append(decision.t / 1e9)
    return tuple(profile), times


def random_graph(number):
    """Return one of many kinds of graph with 3 to 10 nodes, and distinct times of capture, some of them late."""
    rng = np.random.default_rng(number)
    count = int(rng.integers(3, 11))
    graph = (
        nx.gnp_random_graph(count, float(rng.uniform(0.1, 0.9)), seed=number),
        nx.random_geometric_graph(count, 0.4, seed=number),
        nx.path_graph(count),
        nx.cycle_graph(count),
        nx.star_graph(count - 1),
        nx.complete_graph(count),
    )[number % 6]
    return graph, rng.permutation(np.cumsum(rng.uniform(0.2, 2.0, count))).tolist()


def timely(phi, graph):
    """Return the subgraph of the pursuers in time, phi < 10 s."""
    return graph.subgraph([i for i, each in enumerate(phi) if each < 10.0])


def is_maximal_independent(profile, graph):
    """Return whether no two active nodes of a graph are linked, and every other node is linked to an active one."""
    active = {i for i, a in enumerate(profile) if a}
    independent = active <= set(graph) and graph.subgraph(active).number_of_edges() == 0
    return independent and (not len(graph) or nx.is_dominating_set(graph, active))


def neighbour_lists(graph):
    """Return the neighbours of each pursuer."""
    return [sorted(graph.adj[i]) for i in range(len(graph))]


ANY_CLOCK = {
    "poisson": Poisson(rate=5.0),
    "shared_seed": SharedSeed(slot=0.02),
    "rounds": Rounds(period=0.2),
    "some_of_a_round": Rounds(period=0.2, participation=0.5),
    "periodic": Periodic(period=0.2),
    "local_mutex": LocalMutex(rate=5.0),
}
ONE_AT_A_TIME = {name: ANY_CLOCK[name] for name in ("poisson", "shared_seed", "periodic", "local_mutex")}


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("clock", ANY_CLOCK)
def test_local_min_ends_in_the_greedy_maximal_independent_set(clock):
    """8 random graphs for each schedule (5 for the slowest): settled by the middle of the 10 s, in any order of
    decisions.
    """
    for number in range(5 if clock == "local_mutex" else 8):
        graph, phi = random_graph(number)
        profile, times = changes_of(run(static_game(LocalMin(schedule=ANY_CLOCK[clock]), graph, phi, number)))
        assert profile == greedy_maximal_independent_set(phi, 10.0, neighbour_lists(graph)), f"graph {number}"
        assert is_maximal_independent(profile, timely(phi, graph)), f"graph {number}"
        assert max(times, default=0.0) < 6.0, f"graph {number}"


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("clock", ONE_AT_A_TIME)
def test_best_response_with_a_penalty_on_edges_ends_in_a_maximal_independent_set(clock):
    """30 random graphs for each schedule (15 for the slowest); not always in the greedy one, which is the control."""
    greedy, graphs = 0, 15 if clock == "local_mutex" else 30
    for number in range(graphs):
        graph, phi = random_graph(number)
        protocol = BestResponse(utility=EdgePenalty(), schedule=ONE_AT_A_TIME[clock])
        profile, times = changes_of(run(static_game(protocol, graph, phi, number)))
        assert is_maximal_independent(profile, timely(phi, graph)), f"graph {number}"
        assert max(times, default=0.0) < 6.0, f"graph {number}"
        greedy += profile == greedy_maximal_independent_set(phi, 10.0, neighbour_lists(graph))
    assert graphs / 6 < greedy < 5 * graphs / 6


def test_simultaneous_best_responses_to_a_penalty_cycle():
    """Two neighbours that both stay both chase at the next round, and both stay at the one after that, for ever."""
    protocol = BestResponse(utility=EdgePenalty(), schedule=Rounds(period=0.1))
    team = Team(positions=[(1.1, 0.0), (2.1, 0.0)], speeds=1.0, active_at_start=0.0)
    _, times = changes_of(run(static_game(protocol, nx.path_graph(2), (1.0, 2.0), horizon=5.0, team=team)))
    assert times == pytest.approx([each / 10 for k in range(1, 50) for each in (k, k)])


@pytest.mark.slow
def test_local_min_settles_despite_latency_and_loss_with_heartbeats():
    """8 random graphs, latency of 0.1 s, three tenths of messages lost, heartbeats every 0.1 s: the greedy set after
    20 s.
    """
    for number in range(8):
        graph, phi = random_graph(number)
        scenario = static_game(
            LocalMin(schedule=Poisson(rate=5.0)),
            graph,
            [each / 2 for each in phi],
            number,
            network=Links(graph=Edges.of(graph), latency=Constant(value=0.1), loss=Bernoulli(p=0.3)),
            announce=Announcements(heartbeat=0.1, belief_timeout=float("inf")),
        )
        profile, _ = changes_of(run(scenario))
        assert profile == greedy_maximal_independent_set([p / 2 for p in phi], 10.0, neighbour_lists(graph))


# Three on a path, j - i - k, phi = (1, 2, 4).

PATH, PHI = nx.path_graph(3), (1.0, 2.0, 4.0)
COLD = ConstantTau(value=1e-9)
CLOCK = Poisson(rate=5.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "protocol",
    [
        BestResponse(utility=LocalMean(), schedule=CLOCK),
        SpatialAdaptivePlay(utility=LocalMean(), schedule=CLOCK, tau=COLD),
    ],
    ids=["best_response", "sap"],
)
def test_on_a_path_of_three_the_local_mean_never_settles(protocol):
    """10 seeds of 40 s: j chases for ever, i and k change all the time, never 4 s apart.

    A circle is four changes, each of which waits 1/5 s on the average for the one that makes it: 200 in 40 s.
    """
    counts = []
    for seed in range(10):
        _, times = changes_of(run(static_game(protocol, PATH, PHI, seed, horizon=40.0)))
        assert max(np.diff([0.0, *times, 40.0])) < 4.0
        counts.append(len(times))
    error = np.std(counts, ddof=1) / np.sqrt(len(counts))
    assert np.mean(counts) == pytest.approx(200, abs=4 * error + 2)
    assert error < 7


@pytest.mark.slow
@pytest.mark.parametrize(
    ("protocol", "ends"),
    [
        (LocalMin(schedule=CLOCK), {(True, False, True)}),
        (BestResponse(utility=EdgePenalty(), schedule=CLOCK), {(True, False, True), (False, True, False)}),
        (
            SpatialAdaptivePlay(utility=EdgePenalty(), schedule=CLOCK, tau=COLD),
            {(True, False, True), (False, True, False)},
        ),
    ],
    ids=["local_min", "best_response", "sap"],
)
def test_on_a_path_of_three_local_min_and_the_edge_penalty_settle(protocol, ends):
    """10 seeds: local_min in {j, k} each time, a penalty on edges in {j, k} or {i}, both of which come up."""
    found = set()
    for seed in range(10):
        profile, times = changes_of(run(static_game(protocol, PATH, PHI, seed)))
        found.add(profile)
        assert max(times, default=0.0) < 5.0
    assert found == ends


# By hand.


class Puppet:
    """A pursuer whose beliefs are set by hand: phi = 2 s, number 5, r = 10 s; phi may be of several evaders, a list."""

    def __init__(self, beliefs, near=range(100), phi=2.0, at_large=(1,)):
        self.id, self.phi, self.known, self.near, self.at_large = 5, phi, beliefs, near, at_large

    def evaders(self):
        return self.at_large

    def options(self):
        return [0, *self.at_large]

    def capture_time(self, evader):
        return of(self.phi, evader)

    def time_left(self):
        return 10.0

    def counted_teammates(self, scope):
        return {"neighbours": self.near}[scope]

    def believed_chasers(self, evader):
        return {j: of(phi, evader) for j, (action, phi) in self.known.items() if action == evader}

    def beliefs(self, evader):
        return {j: Belief(action, of(phi, evader)) for j, (action, phi) in self.known.items()}


def of(phi, evader):
    """Return the time of capture of an evader."""
    return phi[evader - 1] if isinstance(phi, list) else phi


@pytest.mark.parametrize(
    ("beliefs", "near", "local_min", "argmin_known"),
    [
        ({}, range(100), True, True),
        ({1: (True, 1.0)}, range(100), False, False),
        ({1: (False, 1.0)}, range(100), True, False),
        ({1: (True, 1.0)}, [2], True, False),
        ({1: (True, 3.0), 2: (False, 4.0)}, range(100), True, True),
        ({1: (True, 3.0), 2: (True, 1.9)}, range(100), False, False),
        ({4: (True, 2.0)}, range(100), False, False),
        ({6: (True, 2.0)}, range(100), True, True),
    ],
)
def test_chasing_depends_on_the_beliefs_about_teammates(beliefs, near, local_min, argmin_known):
    """Behind an active neighbour local_min stays, behind any known pursuer argmin_known does; ties by id.

    A late pursuer stays anyway, also one that arrives just as time is up.
    """
    for rule, chases in ((LocalMin, local_min), (ArgminKnown, argmin_known)):
        assert bool(next(rule().actions(Puppet(beliefs, near)))) is chases
        late = [next(rule().actions(Puppet({}, phi=phi))) for phi in (9.99, 10.0, 11.0)]
        assert [bool(each) for each in late] == [True, False, False]


@pytest.mark.parametrize(
    ("beliefs", "phi", "at_large", "local_min", "argmin_known"),
    [
        ({}, [2.0, 1.0, 3.0], (1, 2, 3), 2, 2),
        ({}, [2.0, 1.0, 3.0], (1, 3), 1, 1),
        ({}, [2.0, 11.0, 10.0], (2, 3), 0, 0),
        ({1: (2, [9.0, 0.5, 9.0])}, [2.0, 1.0, 3.0], (1, 2, 3), 1, 1),
        ({1: (0, [9.0, 0.5, 9.0])}, [2.0, 1.0, 3.0], (1, 2, 3), 2, 1),
        ({1: (1, [9.0, 0.5, 9.0])}, [2.0, 1.0, 3.0], (1, 2, 3), 2, 1),
        ({1: (2, [0.1, 0.5, 9.0])}, [2.0, 1.0, 3.0], (1, 2, 3), 1, 2),
        ({1: (2, [9.0, 0.5, 9.0]), 2: (1, [1.5, 9.0, 9.0])}, [2.0, 1.0, 3.0], (1, 2, 3), 3, 3),
        ({1: (2, [9.0, 0.5, nan]), 2: (1, [1.5, nan, nan])}, [2.0, 1.0, 3.0], (1, 2), 0, 0),
    ],
)
def test_of_several_evaders_it_chases_the_first_of_which_it_is_first(beliefs, phi, at_large, local_min, argmin_known):
    """local_min goes by the chasers of each evader, argmin_known by an assignment in order of phi: also 1, which is
    first of two.
    """
    assert next(LocalMin().actions(Puppet(beliefs, phi=phi, at_large=at_large))) == local_min
    assert next(ArgminKnown().actions(Puppet(beliefs, phi=phi, at_large=at_large))) == argmin_known


# argmin_known.


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize(
    ("graph", "dissemination", "profile"),
    [
        (nx.complete_graph(5), OneHop(), (False, False, True, False, False)),
        (nx.path_graph(5), OneHop(), (False, False, True, False, False)),
        (nx.path_graph(5), Flooding(hops=4), (False, False, True, False, False)),
        (nx.Graph([(0, 1), (1, 3), (3, 4), (4, 2)]), OneHop(), (False, True, True, False, False)),
        (nx.Graph([(0, 1), (1, 3), (3, 4), (4, 2)]), Flooding(hops=3), (False, False, True, False, False)),
        (nx.Graph([(0, 1), (1, 3), (3, 4), (4, 2)]), Flooding(hops=2), (False, True, True, False, False)),
    ],
    ids=["complete", "path", "path flooded", "other path", "other path flooded", "other path flooded too little"],
)
def test_argmin_known_leaves_each_pursuer_that_is_first_among_those_it_has_records_of(graph, dissemination, profile):
    """phi = (4, 2, 1, 3, 5) s. Path 0 - 1 - 3 - 4 - 2: pursuer 1 is three hops from 2, and is first of its neighbours.

    On 0 - 1 - 2 - 3 - 4 phi falls to 1 s and rises again, so each but 2 learns of one that is ahead. No pursuer is
    known at first; at heartbeats all announce.
    """
    scenario = static_game(
        ArgminKnown(schedule=Poisson(rate=5.0)),
        graph,
        (4.0, 2.0, 1.0, 3.0, 5.0),
        announce=Announcements(start="silent", dissemination=dissemination, belief_timeout=float("inf")),
    )
    for seed in range(5):
        assert changes_of(run(scenario, seed))[0] == profile


def test_argmin_known_may_leave_a_neighbourhood_without_a_chaser_unlike_local_min():
    """0 - 1 - 2 - 3, phi = 1, 2, 3, 4 s: 2 waits for 1, which waits for 0, and 3 for 2: three quarters wait in vain."""
    graph, phi = nx.path_graph(4), (1.0, 2.0, 3.0, 4.0)
    for rule, ends in ((ArgminKnown, (True, False, False, False)), (LocalMin, (True, False, True, False))):
        result = run(static_game(rule(schedule=CLOCK), graph, phi, announce=Announcements(start="silent")))
        assert changes_of(result)[0] == ends
        assert is_maximal_independent(ends, graph) == (rule is LocalMin)


@pytest.mark.slow
def test_argmin_known_with_one_hop_or_all_is_the_relay_profile_of_a_complete_graph():
    for number in range(5, 30, 6):
        graph, phi = random_graph(number)
        assert changes_of(run(static_game(ArgminKnown(schedule=CLOCK), graph, phi, number)))[0] == relay_profile(
            phi, 10.0
        )

"""Rules: each step by its formula, driven by hand; and what they do in the running simulator, against theory."""

from collections import Counter
from math import exp, inf
from types import SimpleNamespace
from typing import Any, NamedTuple

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, run
from desim.config.errors import KeyedError
from desim.config.model import MAX_COORDINATE
from desim.kernel.models.faults import Crash
from desim.kernel.models.graphs import Edges
from desim.kernel.models.links import Links
from desim.pursuit.core.events import Decided, Started
from desim.pursuit.game.game import gain, relay_profile
from desim.pursuit.game.utility import Component, EdgePenalty, LocalMean, Mean, Minimum
from desim.pursuit.team.announcements import Announcements, Assignment, TimedAssignment
from desim.pursuit.team.beliefs import Belief
from desim.pursuit.team.trust import Credulous, Trimmed
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import PROTOCOLS, Motion, Recording
from protocols.best_response import BestResponse, BetterReply
from protocols.binary_log_linear import BinaryLogLinear, SelectiveSAP
from protocols.fictitious_play import FictitiousPlay, JointStrategyFictitiousPlay
from protocols.regret_matching import GeneralisedRegretMatching, RegretMatching
from protocols.rule import LearningRule, Rule, argmax, current_action
from protocols.sap import SpatialAdaptivePlay, categorical
from protocols.schedules.periodic import Poisson, Rounds, SharedSeed
from protocols.temperature import ConstantTau, GeometricTau
from tests.protocols.test_local_min import changes_of
from tests.protocols.test_local_min import static_game as game_on

LEARNING_KINDS = {kind for kind, model in PROTOCOLS.choices().items() if issubclass(model, LearningRule)}

# By hand: a pursuer with given gains and scripted random draws.


class ScriptedGenerator:
    """A generator whose draws are known beforehand."""

    def __init__(self, random=(), integers=()):
        self._random, self._integers = iter(random), iter(integers)

    def random(self):
        return next(self._random)

    def integers(self, low, high=None):
        low, high = (0, low) if high is None else (low, high)
        drawn_number = next(self._integers, low)
        assert low <= drawn_number < high
        return drawn_number


class Puppet:
    """A pursuer whose gain, action and beliefs are set by hand; with several evaders gains and phi are {evader: s}."""

    def __init__(self, draws=(), integers=(), action=False, gain=0.0, evaders=1):
        self.rng = ScriptedGenerator(draws, integers)
        self.action, self.worth, self.now, self.team_size = action, gain, 1.0, 4
        self.known, self.phi, self.left, self.near = {}, 2.0, 10.0, range(100)
        self.evader_count, self.free = evaders, list(range(1, evaders + 1))
        self.at_large = self.free

    def evaders(self):
        return self.at_large

    def options(self):
        return [0, *self.free]

    def gain(self, utility, evader):
        return self.worth[evader] if isinstance(self.worth, dict) else self.worth

    def beliefs(self, evader):
        return self.known

    def capture_time(self, evader):
        return self.phi[evader] if isinstance(self.phi, dict) else self.phi

    def time_left(self):
        return self.left

    def counted_teammates(self, scope):
        return self.near


def play(rule, puppet, gains):
    """Return what a rule does at turns at which chasing gains so much; what it chooses is done."""
    turns, chosen = rule.actions(puppet), []
    for worth in gains:
        puppet.worth = worth
        chosen.append(next(turns))
        puppet.action = chosen[-1] if puppet.evader_count > 1 else bool(chosen[-1])
    return chosen


def chance(rule, gain, action, integers=()):
    """Return the probability to the nearest thousandth that a pursuer chases next, by sweeping its random draws."""
    grid = (np.arange(1000) + 0.5) / 1000
    return float(np.mean([play(rule, Puppet([u, u], integers, action), [gain])[0] for u in grid]))


GAINS = [-5.0, -0.3, 0.0, 0.2, 4.0]


@pytest.mark.parametrize("gain", GAINS)
@pytest.mark.parametrize("action", [False, True])
@pytest.mark.parametrize("rule", [SpatialAdaptivePlay, BinaryLogLinear])
def test_sap_and_the_binary_rule_chase_with_the_probability_of_the_logit(rule, action, gain):
    """1/(1 + exp(-gain/tau)), tau = 0.5 s, whatever was done before."""
    found = chance(rule(tau=ConstantTau(value=0.5)), gain, action)
    assert found == pytest.approx(1 / (1 + exp(-gain / 0.5)), abs=6e-4)


@pytest.mark.parametrize("gain", GAINS)
@pytest.mark.parametrize("action", [False, True])
def test_the_selective_rule_is_sap_that_does_nothing_at_every_second_turn(action, gain):
    """It tries each of the two actions with 1/2; the present one leaves all as it was."""
    rule = SelectiveSAP(tau=ConstantTau(value=0.5))
    assert chance(rule, gain, action, integers=[int(action)]) == float(action)
    assert chance(rule, gain, action, integers=[int(not action)]) == pytest.approx(
        chance(SpatialAdaptivePlay(tau=ConstantTau(value=0.5)), gain, action), abs=2e-3
    )


@pytest.mark.parametrize(("rule", "tried"), [(BinaryLogLinear(), {0: [1], 1: [0]}), (SelectiveSAP(), {0: [0, 1]})])
def test_binary_log_linear_tries_another_action_and_selective_sap_any(rule, tried):
    """Of 2, and of 3: the binary rule never tries the present one, the selective one tries all alike.

    6,000 trials, so a count has a standard error of at most 39; a third and a half of them are 1,000 apart.
    """
    rng = np.random.default_rng(0)
    for action in tried:
        one, two = (SimpleNamespace(evader_count=evaders, rng=rng) for evaders in (1, 2))
        assert sorted({rule.trial(one, [0, 1], action) for _ in range(100)}) == tried[action]
        counts = Counter(rule.trial(two, [0, 1, 2], action) for _ in range(6000))
        among = [each for each in range(3) if each != action or isinstance(rule, SelectiveSAP)]
        assert sorted(counts) == among
        assert all(abs(n - 6000 / len(among)) < 4 * 40 for n in counts.values())


@pytest.mark.slow
@given(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=4))
def test_an_action_is_drawn_with_its_probability_by_one_number(weights):
    """The share of 2000 equidistant numbers that each action takes is its chance to 1/2000; without one it has none."""
    chances = [w / sum(weights) for w in weights]
    draws = ((np.arange(2000) + 0.5) / 2000).tolist()
    counts = Counter(categorical(chances, ScriptedGenerator([u])) for u in draws)
    assert [counts[a] / 2000 for a in range(len(chances))] == pytest.approx(chances, abs=1.001 / 2000)
    for certain in (0, 1):
        assert {categorical([1.0 - certain, float(certain)], ScriptedGenerator([u])) for u in (0.0, 1 - 2**-53)} == {
            certain
        }


def test_the_log_linear_rules_count_slots_of_the_whole_team():
    """Four pursuers at rate 5: a slot is 1/20 s, and at 0.5 s ten have passed. There tau = 2^-10 s, at first 1 s."""
    cooling = GeometricTau(first=1.0, ratio=0.5, floor=1e-9)
    rule = SpatialAdaptivePlay(tau=cooling, schedule=Poisson(rate=5.0))
    me = Puppet()
    inverse = rule.inverse_temperatures(me)
    found = []
    for me.now in (0.0, 0.05, 0.5):
        found.append(next(inverse))
    assert found == pytest.approx([1.0, 2.0, 1024.0])


def test_ties_between_actions_go_to_the_first():
    worths = [0.0, 0.0], [0.0, 1e-300], [0.0, -1.0], [1.0, 3.0, 3.0]
    assert [argmax(dict(enumerate(each))) for each in worths] == [0, 1, 0, 1]
    assert argmax({0: -1.0, 2: 5.0, 7: 5.0}) == 2


def test_best_response_chases_if_it_gains_and_stays_if_it_ties():
    assert play(BestResponse(), Puppet(), [1.0, 0.0, -1.0, 1e-12]) == [1, 0, 0, 1]
    assert play(BestResponse(), Puppet(action=True), [0.0]) == [0]


def test_better_reply_only_moves_to_strictly_better_actions():
    """alpha = 0.25: a draw of 0.2 changes, of 0.25 does not; a tie is not better, in either action."""
    rule = BetterReply(alpha=0.25)
    assert play(rule, Puppet([0.2]), [1.0]) == [1]
    assert play(rule, Puppet([0.25]), [1.0]) == [0]
    assert play(rule, Puppet([0.2], action=True), [-1.0]) == [0]
    assert play(rule, Puppet([0.25], action=True), [-1.0]) == [1]
    for action in (False, True):
        assert play(rule, Puppet([0.0], action=action), [0.0]) == [int(action)]
        assert play(rule, Puppet([0.0], action=action), [1.0 if action else -1.0]) == [int(action)]


class FixedUtilities(LearningRule):
    """A rule of three actions, by what they are worth."""

    def utilities(self, me):
        return {0: 1.0, 1: 3.0, 2: 2.0}


@pytest.mark.parametrize(("draw", "chosen"), [(0, 1), (1, 2)])
def test_better_reply_draws_among_all_that_are_better(draw, chosen):
    """At 1, of worths (1, 3, 2), both others are better; each is drawn by its number."""

    class Reply(FixedUtilities, BetterReply):
        pass

    assert next(Reply(alpha=1.0).actions(Puppet([0.5], [draw]))) == chosen


# By hand, with three evaders.


@pytest.mark.parametrize(
    ("free", "weights"), [([1, 2, 3], [1.0, exp(1.0), exp(-1.0), exp(2.0)]), ([1, 3], [1.0, exp(1.0), 0.0, exp(2.0)])]
)
def test_sap_draws_from_the_logit_of_the_allowed_actions(free, weights):
    """Worth (0, 0.5, -0.5, 1) s at tau = 0.5 s, whatever was done before; what it may not chase is left out."""
    grid, rule = (np.arange(2000) + 0.5) / 2000, SpatialAdaptivePlay(tau=ConstantTau(value=0.5))
    for action in (0, 2):
        counts = Counter()
        for draws in grid:
            me = Puppet([draws], action=action, evaders=3, gain={1: 0.5, 2: -0.5, 3: 1.0})
            me.free = free
            counts[next(rule.actions(me))] += 1
        expected = [2000 * weight / sum(weights) for weight in weights]
        assert [counts[each] for each in range(4)] == pytest.approx(expected, abs=1.01)


def test_the_selective_rule_tries_each_action_as_often_however_many_may_still_be_chosen():
    """With probability 1/4 each of 4 actions at first; of 3 that are left, too, and else the present one: 2/4.

    8,000 trials, so a count has a standard error of at most 45. The control is a third each of the 3 that are left.
    """
    rng, rule = np.random.default_rng(0), SelectiveSAP()
    me = SimpleNamespace(evader_count=3, rng=rng)
    counts = Counter(rule.trial(me, [0, 1, 3], 1) for _ in range(8000))
    assert counts[0] + counts[1] + counts[3] == 8000
    assert all(abs(counts[each] - share * 8000) < 4 * 45 for each, share in ((0, 0.25), (1, 0.5), (3, 0.25)))
    assert all(abs(counts[each] - 8000 / 3) > 4 * 45 for each in (0, 1, 3))


def test_the_best_of_several_evaders_is_chased_and_the_next_if_it_may_not_be_chased():
    me = Puppet(evaders=3)
    assert play(BestResponse(), me, [{1: 1.0, 2: 4.0, 3: 2.0}, {1: 1.0, 2: 1.0, 3: -2.0}]) == [2, 1]
    me.free = [1, 3]
    assert play(BestResponse(), me, [{1: 1.0, 2: 4.0, 3: 2.0}, {1: -1.0, 2: 4.0, 3: 0.0}]) == [3, 0]
    me.phi, me.free, me.at_large = {1: 2.0, 2: 1.0}, [1], [1, 2]  # 2 is not captured
    assert next(FictitiousPlay().actions(me)) == 1


def test_a_pursuer_that_must_stop_its_chase_starts_from_staying():
    """At 2, which it may not chase any more: unwilling, or with nothing better than to stay, it stays."""
    for rule, draws in ((BetterReply, 0.9), (JointStrategyFictitiousPlay, 0.9), (RegretMatching, 0.0)):
        me = Puppet([draws], action=2, evaders=3, gain={1: -1.0, 2: 9.0, 3: -1.0})
        me.free = [1, 3]
        assert next(rule().actions(me)) == 0
    assert current_action(Puppet(action=2, evaders=3), [0, 1, 3]) == 0
    assert current_action(Puppet(action=3, evaders=3), [0, 1, 3]) == 3


@pytest.mark.parametrize("name", [name for name in PROTOCOLS.choices() if name in LEARNING_KINDS])
def test_no_rule_chooses_an_action_that_is_not_allowed(name):
    """20 turns with three evaders, of which 2 is worth most, 20 without that, and 20 with the third alone."""
    me, seen = Puppet(evaders=3), []
    me.rng, me.phi = np.random.default_rng(3), {1: 2.0, 2: 1.0, 3: 3.0}
    turns = PROTOCOLS.choices()[name]().actions(me)
    for me.free in ([1, 2, 3], [1, 3], [3]):
        me.at_large, me.action = me.free, 2
        for me.now in range(20):
            me.worth = {j: float(me.rng.normal(2.0 if j == 2 else 0.5)) for j in (1, 2, 3)}
            me.action = next(turns)
            seen.append((len(me.free), me.action))
    assert {(3, 2), (1, 3)} <= set(seen)
    assert set(seen) <= {(3, 0), (3, 1), (3, 2), (3, 3), (2, 0), (2, 1), (2, 3), (1, 0), (1, 3)}


def test_fictitious_play_answers_how_often_each_evader_was_chased():
    """phi = (2, 3) s against one of 1 s to both: if that is always on 1, 2 is best; if as often on both, 1 is.

    (1 - q) 8 - q / 2 for 1 and (1 - q) 7 - q for 2, with q = 1/2 of each: 3.75 and 3 s.
    """
    one, two = ({1: Belief(action, 1.0)} for action in (1, 2))
    for turns, chosen in (([one], 2), ([two], 1), ([{}], 1), ([one, two], 1), ([one, one, one, two], 2)):
        me = Puppet(evaders=2)
        me.phi, actions = {1: 2.0, 2: 3.0}, FictitiousPlay().actions(me)
        for me.known in turns:
            last = next(actions)
        assert last == chosen


def test_jsfp_averages_gains_with_fading_and_keeps_its_action_with_probability_1_minus_alpha():
    """rho = 0: mean gains 1, (1 - 4)/2, (1 - 4 + 3.5)/3 = 1/6, (0.5 - 1)/4; and 1, (1 - 1)/2: a tie is no change.

    rho = 0.5: turns 1 and 2 weigh 1/2 each, then the latest 1/2: after -8, 0, 0, 0 it is -8/8 = -1, then 1.5 wins.
    Unfading, the mean would be (-8 + 1.5)/5 = -1.3. At a draw of alpha = 0.25 it does not change, whichever action it
    is, though it goes on learning.
    """
    gains = [-8.0, 0.0, 0.0, 0.0, 1.5]
    for alpha, rho, draws, action, worths, last in [
        (1.0, 0.0, [0.5] * 4, False, [1.0, -4.0, 3.5, -1.0], [1, 0, 1, 0]),
        (1.0, 0.0, [0.5] * 2, False, [1.0, -1.0], [1, 1]),
        (1.0, 0.0, [0.5], False, [0.0], [0]),
        (1.0, 0.5, [0.5] * 5, False, gains, [1]),
        (1.0, 0.0, [0.5] * 5, False, gains, [0]),
        (1.0, 0.5, [0.5] * 5, False, [*gains[:4], 0.9], [0]),
        (0.25, 0.03, [0.24], False, [1.0], [1]),
        (0.25, 0.03, [0.25], False, [1.0], [0]),
        (0.25, 0.03, [0.25, 0.24], True, [-1.0, 0.5], [1, 0]),
    ]:
        rule = JointStrategyFictitiousPlay(alpha=alpha, rho=rho)
        assert play(rule, Puppet(draws, action=action), worths)[-len(last) :] == last


def test_regret_matching_draws_in_proportion_to_regret():
    """Staying for two turns that chasing would have gained 4 and 2: with regrets (0, 3) it chases for certain.

    Then, chasing, it loses 9: regret of staying (0 + 0 + 9)/3 = 3 and of chasing (4 + 2 + 0)/3 = 2: it chases if its
    draw is below 2/5.
    """
    rule = RegretMatching()
    assert play(rule, Puppet([0.9, 0.999]), [4.0]) == [1]
    for draws, chosen in ((0.39, 1), (0.41, 0)):
        me = Puppet([0.9, 0.9, 0.9, 0.9, 0.9, draws])
        turns = rule.actions(me)
        for me.worth, me.action in ((4.0, False), (2.0, False), (-9.0, True)):
            last = next(turns)
        assert last == chosen


@pytest.mark.parametrize("rule", [RegretMatching, GeneralisedRegretMatching])
@pytest.mark.parametrize("action", [False, True])
def test_without_any_regret_the_present_action_is_kept(rule, action):
    """Also when all are worth the same: no regret is not positive regret; and no number is drawn for it."""
    assert play(rule(alpha=1.0), Puppet([0.0] * 2, action=action), [5.0 if action else -5.0, 0.0]) == [int(action)] * 2


def test_regret_fades_and_is_acted_on_with_inertia():
    """rho = 0.5, alpha = 0.5. Chasing cost 8 once: regret of staying 8, then, chasing for 0, 4.

    Then staying, it misses 2, so that chasing has regret 1 and staying 2: it chases if its draw is below 1/3. Unfading
    regret would be 8/3 and 2/3.
    """
    rule = GeneralisedRegretMatching(rho=0.5, alpha=0.5)
    for draws, rho, chosen in ((0.32, 0.5, 1), (0.34, 0.5, 0), (0.32, 0.0, 0), (0.19, 0.0, 1)):
        me = Puppet([0.5, 0.5, 0.4, draws])
        turns = rule.model_copy(update={"rho": rho}).actions(me)
        for me.worth, me.action in ((-8.0, True), (0.0, True), (2.0, False)):
            last = next(turns)
            assert me.worth == 2.0 or last == 1  # unwilling: it goes on chasing
        assert last == chosen


def answers(turns, phi=2.0, left=10.0, near=range(100), utility=None):
    """Return what fictitious play does, by what it believes at each of its turns."""
    me = Puppet()
    me.phi, me.left, me.near = phi, left, near
    actions, chosen = FictitiousPlay(utility=utility or Mean()).actions(me), []
    for me.known in turns:
        chosen.append(next(actions))
    return chosen


def test_fictitious_play_answers_how_often_each_was_active():
    """phi = 2 against one of 1 s, active at q of the turns: (1 - q)(10 - 2) + q (1 - 2)/2, which is 0 at q = 16/17.

    Active at 40 turns and then not any more: 40/42 is more than that, 40/43 is less. Never seen active, it is as if
    alone.
    """
    on, off = {1: Belief(True, 1.0)}, {1: Belief(False, 1.0)}
    assert answers([on] * 16) == [0] * 16
    assert answers([on] * 40 + [off] * 3) == [0] * 42 + [1]
    assert answers([off, on, off]) == [1, 1, 1]


def test_fictitious_play_counts_teammates_without_a_record_as_inactive():
    """Known as active at the fifth turn only, q = 1/5: (1 - q) 8 - q/2 is positive, with q = 1 it is negative.

    Forgotten, it does not count, but its frequency falls: known again after 20 turns of 40, q = 21/41.
    """
    on = {1: Belief(True, 1.0)}
    assert answers([{}] * 4 + [on]) == [1] * 5
    assert answers([on, *[{}] * 3, on]) == [0, 1, 1, 1, 1]
    assert answers([on] * 20 + [{}] * 20 + [on]) == [0] * 20 + [1] * 21


def test_fictitious_play_ignores_slow_and_uncounted_teammates():
    """An active one of 1 s makes 2 s stay; one of inf, or one that is not in the circle, does not."""
    assert answers([{1: Belief(True, 1.0)}]) == [0]
    assert answers([{1: Belief(True, inf)}]) == [1]
    assert answers([{1: Belief(True, 1.0)}], near=[2, 3]) == [1]
    assert answers([{1: Belief(True, 1.0), 2: Belief(True, 9.0)}], near=[2]) == [1]
    assert answers([{}], phi=11.0) == answers([{}], phi=10.0) == answers([{}], phi=inf) == [0]


def test_fictitious_play_expects_by_its_utility():
    """Under minimum phi = 2 gains nothing from one of 1 s that is always active, and something if it ever was not."""
    on, off = {1: Belief(True, 1.0)}, {1: Belief(False, 1.0)}
    assert answers([on, off], utility=Minimum()) == [0, 1]
    assert answers([on, off], utility=EdgePenalty()) == [0, 1]
    assert answers([on, on, off], utility=EdgePenalty(factor=2.0)) == [0, 0, 0]


def test_fictitious_play_needs_a_utility_that_can_expect():
    class Plain:
        scope = "heard"

        def __call__(self, own, others, reward):
            return 0.0

    with pytest.raises(KeyedError, match="needs a utility with `expected`"):
        FictitiousPlay(utility=Plain())
    assert BestResponse(utility=Plain()).utility.scope == "heard"


def test_an_infinite_loss_of_utility_is_a_finite_number():
    """-inf would make a regret of inf - inf; a billion seconds is enough."""
    me = Puppet(gain=-inf)
    assert LearningRule().utilities(me) == {0: 0.0, 1: -MAX_COORDINATE}
    assert play(RegretMatching(), Puppet([0.5] * 4, action=True), [-inf, -inf]) == [0, 0]


# What a rule may know and do: its agent, three pursuers at 1, 2 and 4 m of an evader that stands still, eps = 0.1 m.


def act(protocol, **changes):
    """Run a protocol for a frozen game of three."""
    given = {
        "horizon": 10.0,
        "team": Team(positions=[(1.0, 0.0), (2.0, 0.0), (4.0, 0.0)], speeds=1.0, active_at_start=0.0),
        "evader": Evader(position=(0.0, 0.0), speed=0.0),
        "motion": Motion(static=True),
        "protocol": protocol,
        "announce": Announcements(trigger="never", start="silent", belief_timeout=1.0),
        "record": Recording(trajectory=0.0),
    }
    return run(Scenario(**(given | changes)))


def test_beliefs_cover_all_known_teammates_and_believed_chasers_only_the_active_ones():
    """Pursuer 1 announces that it stays, pursuer 2 that it chases, at 0.5 s; a second later both are forgotten.

    A record just as old as `belief_timeout` still counts. `trusted` has the records themselves.
    """
    seen = {}

    def protocol(me):
        if me.id:
            yield me.at(0.5)
            me.publish(Assignment(active=me.id == 2))
            return
        for t in (0.25, 0.6, 1.5, 1.500000001):
            yield me.at(t)
            trusted = {j: (r.src, r.body, r.sent) for j, r in me.trusted().items()}
            seen[t] = me.beliefs(), me.believed_chasers(), me.believed_active(), trusted, len(me.latest_records())

    act(protocol)
    records = {j: (j, Assignment(active=j == 2), 0.5) for j in (1, 2)}
    assert seen[0.25] == ({}, {}, [], {}, 0)
    for t, age in ((0.6, 0.1), (1.5, 1.0)):
        phi, age = {1: pytest.approx(1.9), 2: pytest.approx(3.9)}, pytest.approx(age)
        beliefs = {j: Belief(j == 2, phi[j], age) for j in (1, 2)}
        assert seen[t] == (beliefs, {2: phi[2]}, [2], records, 2)
    assert seen[1.500000001] == ({}, {}, [], {}, 2)


@pytest.mark.parametrize(("trust", "believed"), [(Credulous(), {1, 2}), (Trimmed(liars=1), {2})])
def test_a_pursuer_believes_whom_its_judge_does_not_ignore(trust, believed):
    """Pursuer 0 needs 0.9 s. The least and the greatest time are ignored, if they are less and greater than its own."""

    def protocol(me):
        yield me.at(0.25 * (me.id + 1))
        if me.id:
            me.publish(TimedAssignment(True, {1: 0.5, 2: 0.9}[me.id]))
        else:
            yield me.at(0.9)
            seen.append((me.beliefs().keys(), me.believed_chasers().keys()))

    seen = []
    announce = Announcements(trigger="never", start="silent", belief_timeout=1.0, payload="time", trust=trust)
    act(protocol, announce=announce)
    assert seen == [(believed, believed)]


@pytest.mark.parametrize(("payload", "believed"), [("time", 7.0), ("action", 1.9)])
def test_the_capture_time_of_a_teammate_is_announced_or_sensed(payload, believed):
    """With the payload "action" all sense all: a time that a protocol announces all the same is not used."""

    def protocol(me):
        if me.id == 1:
            yield me.at(0.5)
            me.publish(TimedAssignment(True, 7.0) if payload == "time" else Assignment(True))
        if me.id == 2:
            yield me.at(0.75)
            seen.extend([me.beliefs()[1].capture_time, me.believed_chasers()[1]])

    seen = []
    act(protocol, announce=Announcements(payload=payload, trigger="never", start="silent"))
    assert seen == pytest.approx([believed] * 2)


@pytest.mark.parametrize(
    ("utility", "others"),
    [(Mean(), [1, 2, 3]), (Minimum(), [1, 2, 3]), (LocalMean(), [1]), (EdgePenalty(), [1]), (Component(), [1, 2])],
    ids=repr,
)
def test_the_gain_counts_the_teammates_selected_by_the_utility(utility, others):
    """4 - 0 - 1 - 2, and 3 without links; all are known to be active from the start.

    Pursuer 4 cannot capture, and never counts, though it may chase.
    """
    phi = [3.0, 1.0, 2.0, 4.0, 1.0]
    graph = nx.Graph([(0, 1), (1, 2), (0, 4)])
    graph.add_nodes_from(range(5))

    def protocol(me):
        yield me.at(0.0)
        if me.id == 0:
            seen.append((me.gain(utility), sorted(set(me.counted_teammates(utility.scope)) - {0})))

    seen = []
    act(
        protocol,
        team=Team(positions=[(each + 0.1, 0.0) for each in phi], speeds=[1.0, 1.0, 1.0, 1.0, 0.0]),
        network=Links(graph=Edges.of(graph)),
        announce=Announcements(trigger="never", start="known"),
        prune="none",
    )
    assert seen[0][0] == pytest.approx(utility(3.0, [phi[j] for j in others], 10.0))
    assert seen[0][1] == {"heard": [1, 2, 3, 4], "neighbours": [1, 4], "component": [1, 2, 4]}[utility.scope]


class Claim(NamedTuple):
    active: bool
    news: int
    text: str


def test_a_claim_replaces_the_payload_and_is_announced_when_its_key_changes():
    """Of three claims the second has the key of the first, so it is not announced."""

    def protocol(me):
        if me.id == 0:
            for k, news in enumerate([7, 7, 8]):
                me.set_payload(Claim(False, news, f"claim {k}"))
                me.announce()
                said.append(me.announcement().text)
                yield me.sleep(0.25)
            return
        for k in range(3):
            yield me.at(0.1 + 0.25 * k)
            heard.append([r.body.text for r in me.trusted().values()])

    said, heard = [], []
    act(protocol, announce=Announcements(trigger="change", start="silent"))
    assert said == ["claim 0", "claim 1", "claim 2"]
    assert heard == [["claim 0"]] * 4 + [["claim 2"]] * 2


def test_a_delayed_action_does_not_block_its_caller():
    """And not if the pursuer has started anew in between: it broke down without memory at 0.5 s."""
    done = []

    def protocol(me):
        yield me.at(0.25)
        me.after(0.125, lambda: done.append((me.id, "soon", me.now)))
        me.after(0.5, lambda: done.append((me.id, "later", me.now)))
        done.append((me.id, "at once", me.now))
        yield me.at(100.0)

    crashes = [Crash(node=1, start=0.5, end=0.6, memory=False), Crash(node=2, start=0.5, end=0.6, memory=True)]
    act(protocol, fault=crashes, horizon=0.9)
    told = [(i, what, t) for i, what, t in done if t < 0.6]
    assert told == [(i, what, t) for what, t in (("at once", 0.25), ("soon", 0.375)) for i in range(3)]
    assert [(i, t) for i, what, t in done if what == "later"] == [(0, 0.75), (2, 0.75)]
    assert [(t, what) for i, what, t in done if i == 1 and t >= 0.6] == [(0.6, "at once"), (0.725, "soon")]


# What a rule is asked, and when.


class Asked(Rule):
    """Chases whenever it is asked, and tells it."""

    tell: Any

    def actions(self, me):
        while True:
            self.tell((me.id, me.now))
            yield 1


def test_a_rule_is_called_at_each_turn_of_its_schedule_unless_there_is_no_choice():
    """Rounds of 0.25 s; pursuer 0 cannot capture, and is ordered to stay, unasked."""
    asked = []
    rule = Asked(schedule=Rounds(period=0.25), tell=lambda turn: asked.append(turn))
    team = Team(positions=[(1.0, 0.0), (2.0, 0.0)], speeds=[0.0, 1.0], active_at_start=1.0)
    result = act(rule, team=team, horizon=0.6)
    assert asked == [(1, 0.25), (1, 0.5)]
    found = [(d.t / 1e9, d.pursuer, d.active) for d in result.trace.of(Decided)]
    assert found == [(0.25, 0, False), (0.25, 1, True), (0.5, 0, False), (0.5, 1, True)]


def test_a_rule_without_actions_raises_not_implemented():
    with pytest.raises(NotImplementedError):
        Rule().actions(Puppet())


# In the running simulator: static games on a complete graph with an ideal network.


def static_game(protocol, seed, horizon=10.0):
    """Return a static game of 2 to 7 pursuers, r = 10 s, and their times of capture.

    They are 0.5 to 3 s apart, in random order, so that some are late; each is active at first with probability 1/2.
    """
    rng = np.random.default_rng(seed)
    phi = rng.permutation(np.cumsum(rng.uniform(0.5, 3.0, rng.integers(2, 8)))).tolist()
    return game_on(protocol, nx.complete_graph(len(phi)), phi, seed, horizon), phi


def history(result):
    """Return the profile after each instant of decisions, first that of the start, and the instants, s."""
    profile, times, stood = list(result.trace.of(Started)[0].active), [0.0], []
    for decision in result.trace.of(Decided):
        if decision.t / 1e9 != times[-1]:
            stood.append(tuple(profile))
            times.append(decision.t / 1e9)
        profile[decision.pursuer] = decision.active
    return [*stood, tuple(profile)], times


LEARNING = {
    "best_response": BestResponse,
    "better_reply": BetterReply,
    "fictitious_play": FictitiousPlay,
    "jsfp": JointStrategyFictitiousPlay,
    "generalised_regret_matching": GeneralisedRegretMatching,
}
"""What settles in an equilibrium."""
CLOCKS = {"poisson": Poisson(rate=40.0), "rounds": Rounds(period=0.025), "shared_seed": SharedSeed(slot=0.005)}


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNING)
@pytest.mark.parametrize("clock", CLOCKS)
def test_on_static_games_every_learning_rule_ends_in_the_relay_profile(name, clock):
    """2 random games of 2 to 7, one at a time or all at once; all have settled before the last fifth of 400 turns."""
    for seed in range(2):
        scenario, phi = static_game(LEARNING[name](schedule=CLOCKS[clock]), seed)
        profile, times = changes_of(run(scenario))
        assert profile == relay_profile(phi, 10.0), f"seed {seed}"
        assert max(times, default=0.0) < 8.0, f"seed {seed}"


class Uniform(LearningRule):
    """Chases with 1/2, whatever it is worth: the control."""

    def actions(self, me):
        while True:
            yield int(me.rng.integers(2))


def regrets(result, phi, rounds):
    """Return the greatest time-averaged regret of any pursuer after so many rounds, and the share of the relay profile.

    The regret of an action is the mean over rounds of how much more it would have been worth than what was done, with
    the others doing what they did, s: reckoned from the trace, of the profile that stood as each round began.
    """
    stood, _ = history(result)
    r = result.scenario.horizon
    gains = np.array(
        [
            [gain(phi[i], [phi[j] for j in range(len(phi)) if s[j] and j != i], r) for i in range(len(phi))]
            for s in stood
        ]
    )
    chased = np.array(stood)
    found = []
    for count in rounds:
        missed, lost = np.where(chased, 0.0, gains)[:count], np.where(chased, -gains, 0.0)[:count]
        found.append(max(0.0, missed.mean(axis=0).max(), lost.mean(axis=0).max()))
    return found, np.mean([s == relay_profile(phi, r) for s in stood])


ROUNDS = (30, 120, 480, 1920)


def played(rule):
    """Return the regrets (s) after so many rounds of all at once and the share of the relay profile: means of 3."""
    found = []
    for seed in range(3):
        scenario, phi = static_game(rule(schedule=Rounds(period=10.0 / 1930)), seed)
        found.append(regrets(run(scenario), phi, ROUNDS))
    return np.mean([each for each, _ in found], axis=0), np.mean([share for _, share in found])


@pytest.mark.whole
def test_regret_matching_has_no_long_run_regret_and_random_play_has():
    """Hart & Mas-Colell: regret falls like 1/sqrt(T) or faster, so by 2 at least when T is four times as long.

    How often the relay profile was played tends to 1, as it is the only coarse correlated equilibrium. The control: the
    regret of chance does not fall, and the relay profile is one of 2^N.
    """
    regret, share = played(RegretMatching)
    assert (regret[1:] < 0.6 * regret[:-1]).all()
    assert regret[-1] < 1.1 * regret[0] / 8
    assert share > 0.98
    regret, share = played(Uniform)
    assert (regret[1:] > 0.8 * regret[:-1]).all()
    assert share < 0.2


# Pursuers without a choice (`prune`).

EVERY = sorted(PROTOCOLS.choices())


def chase(kind, prune, tau=None, horizon=4.0, count=6, seed=0):
    """Return a moving pursuit in which pursuers 0 and 1 are slower than the evader, and near it."""
    rng = np.random.default_rng(seed)
    model = PROTOCOLS.choices()[kind]
    given = {"schedule": Poisson(rate=20.0)} if "schedule" in model.model_fields else {}
    if tau is not None:
        given["tau"] = tau
    positions = rng.uniform(0.0, 12.0, (count, 2))
    positions[:2] = 6.0 + rng.uniform(1.0, 2.0, (2, 2))
    return Scenario(
        seed=seed,
        horizon=horizon,
        prune=prune,
        team=Team(positions=positions.tolist(), speeds=[0.5, 0.9, *rng.uniform(1.2, 3.0, count - 2).tolist()]),
        evader=Evader(position=(6.0, 6.0)),
        protocol=model(**given),
        record=Recording(trajectory=0.0),
    )


def ever_active(result):
    """Return the pursuers active at the start, and those active at any time."""
    start = {i for i, a in enumerate(result.trace.of(Started)[0].active) if a}
    return start, start | {d.pursuer for d in result.trace.of(Decided) if d.active}


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("kind", EVERY)
def test_a_pursuer_that_cannot_capture_never_chases_unless_pruning_is_off(kind):
    """All are active at first without pruning, and otherwise all but the two that are too slow."""
    for seed in range(2):
        start, ever = ever_active(run(chase(kind, "inf", seed=seed)))
        assert start == {2, 3, 4, 5}
        assert not ever & {0, 1}
        start, _ = ever_active(run(chase(kind, "none", seed=seed)))
        assert start == {0, 1, 2, 3, 4, 5}


class Hot:
    """A temperature that is infinite for ever."""

    def __call__(self, eta):
        return 0.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sap", "binary_log_linear", "selective_sap"])
@pytest.mark.parametrize(("prune", "share"), [("none", 0.5), ("inf", 0.0), ("infeasible", 0.0)])
def test_at_infinite_temperature_an_unpruned_slow_pursuer_chases_at_every_second_turn(kind, prune, share):
    """About 20 turns a second of two pursuers for at most 4 s, 6 seeds: four standard errors of a fair coin.

    The selective rule tosses it at every second turn only, which doubles the variance and more: 3 times.
    """
    actions = []
    for seed in range(6):
        decided = run(chase(kind, prune, tau=Hot(), seed=seed)).trace.of(Decided)
        actions += [d.active for d in decided if d.pursuer < 2]
    error = np.sqrt((3.0 if kind == "selective_sap" else 1.0) * 0.25 / len(actions))
    assert len(actions) > 200
    assert np.mean(actions) == pytest.approx(share, abs=4 * error if share else 0.0)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("kind", [each for each in EVERY if each != "centralised"])
def test_teammates_ignore_a_chasing_pursuer_that_cannot_capture(kind):
    """Pursuer 0 cannot capture and announces all the time that it chases; pursuer 1 chases, pursuer 2 is slower than 1.

    phi = inf, 1.9 and 3.9 s. If pursuer 0 counted, a mean of inf would let all chase or none.
    """
    model = PROTOCOLS.choices()[kind]
    if "schedule" not in model.model_fields:
        pytest.skip("it is no rule")
    rule = model(schedule=Poisson(rate=20.0))

    def protocol(me):
        if me.id:
            yield from rule(me)
            return
        me.assign(True)
        while True:
            me.broadcast()
            yield me.sleep(0.05)

    team = Team(positions=[(1.0, 0.0), (2.0, 0.0), (4.0, 0.0)], speeds=[0.0, 1.0, 1.0])
    result = act(protocol, team=team, prune="none", horizon=10.0, announce=Announcements())
    assert changes_of(result)[0] == (True, True, False)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("kind", EVERY)
def test_with_pruning_of_late_pursuers_no_chase_is_in_vain(kind):
    """At each order to chase phi < r, and of those that are active at the start, too; some would be late: the control.

    Seen by a watcher at the instant of the action, from the true state.
    """
    late = {"none": 0, "inf": 0, "infeasible": 0}
    for prune in late:
        for seed in range(4):
            scenario = chase(kind, prune, horizon=2.0, tau=Hot() if kind == "sap" else None, seed=seed)
            inner, seen = scenario.protocol, []

            def protocol(me, inner=inner, seen=seen):
                seen.append(me)
                yield from inner(me)

            def watch(event, seen=seen, prune=prune):
                if isinstance(event, Decided) and event.active:
                    late[prune] += seen[0].global_state.capture_times(1)[event.pursuer] >= seen[0].time_left()

            protocol.reckons = getattr(inner, "reckons", False)
            watched = scenario.model_copy(update={"protocol": protocol})
            start, _ = ever_active(run(watched, None, watch))
            team, evader = scenario.team, complex(*scenario.evader.position)
            distances = [abs(complex(*p) - evader) for p in team.positions]
            able = [v > 0.9 and (d - 0.1) / (v - 0.9) < 2.0 for d, v in zip(distances, team.speeds, strict=True)]
            if prune == "infeasible":
                assert start == {i for i, a in enumerate(able) if a}
            assert not all(able)
    assert late["infeasible"] == 0
    assert late["none"] > 0 or kind != "sap"

"""The environments for learners: their order, their interface, and what ends an episode."""

import copy
import gc
import pickle
import sys
import threading
import warnings
from decimal import Decimal
from fractions import Fraction
from functools import partial
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import cloudpickle
import numpy as np
import pettingzoo
import pytest
from pettingzoo.test import api_test, max_cycles_test, parallel_api_test, parallel_seed_test, seed_test
from pettingzoo.test.state_test import state_test

import desim
from desim import Crash, Evader, Scenario, Team, load, run
from desim.config.shared_state import StateWarning
from desim.kernel.core.trace_file import line_of
from desim.learning.episode import Episode
from desim.learning.playing import play
from desim.learning.rewards import team as team_reward
from desim.pursuit.core.events import Decided, Ended
from desim.pursuit.game.game import welfare, wonderful_life_utility
from protocols import CBAA, LocalMin, Rounds, Server
from protocols.rule import SCHEDULES

SCHEDULE_KINDS = sorted(SCHEDULES.choices())
RELAY = Path(desim.examples()["relay"])


def small(**keys):
    """A lossy pursuit of five, with heartbeats."""
    scenario = Scenario(horizon=2.0, team=Team(count=5, active_at_start=1.0), protocol=LocalMin())
    changes = {"network.latency": 0.05, "network.loss": 0.1, "announce.trigger": "both", "announce.heartbeat": 0.5}
    return scenario.with_(changes | keys)


def test_the_numbers_of_a_state_are_named_in_its_order():
    """A pursuer that is down and a captured evader are 1 where their names say so."""
    scenario = small(**{"team.count": 2, "evader.count": 2, "horizon": 0.3})
    env = desim.env(scenario.with_({"fault": [Crash(start=0.0, node=1, scope="robot")]}))
    env.reset(seed=1)
    places = [f"pursuer_{k}.{name}" for k in (0, 1) for name in ("x", "y", "down")]
    places += [f"evader_{k}.{name}" for k in (1, 2) for name in ("x", "y", "captured")]
    assert env.state_names == ("time_left", *places, "pursuer_0.action", "pursuer_1.action")
    state = dict(zip(env.state_names, env.state().tolist(), strict=True))
    assert (state["pursuer_0.down"], state["pursuer_1.down"], state["evader_1.captured"]) == (0.0, 1.0, 0.0)


def test_the_places_in_a_state_are_those_of_the_players_that_are_named():
    places = {"pursuer_0": (0.0, 1.0), "pursuer_1": (3.0, 4.0), "evader_1": (10.0, 11.0), "evader_2": (12.0, -13.0)}
    evaders = tuple(Evader(position=places[name]) for name in ("evader_1", "evader_2"))
    team = {"count": 2, "positions": (places["pursuer_0"], places["pursuer_1"])}
    env = desim.env(Scenario(horizon=1.0, team=team, evader=evaders, motion={"static": True}))
    env.reset(seed=1)
    state = dict(zip(env.state_names, env.state().tolist(), strict=True))
    assert {name: (state[f"{name}.x"], state[f"{name}.y"]) for name in places} == places


def lines(result):
    return list(map(line_of, result.trace))


def played_out(env, choose=lambda env, agent: 1):
    """The sum of the rewards of each agent, as its turns show them."""
    sums = dict.fromkeys(env.possible_agents, 0.0)
    for agent in env.agent_iter():
        _, reward, terminated, truncated, _ = env.last(observe=False)
        sums[agent] += reward
        env.step(None if terminated or truncated else choose(env, agent))
    return sums


@pytest.mark.slow_but_one
@pytest.mark.parametrize("schedule", SCHEDULE_KINDS)
@pytest.mark.parametrize("kind", ["sap", "local_min", "cbaa"])
def test_a_rule_played_through_the_environment_leaves_the_native_trace(kind, schedule):
    scenario = small(**{"protocol.kind": kind, "protocol.schedule": {"kind": schedule}, "record.messages": True})
    env = desim.env(scenario, 4)
    assert lines(play(env, scenario.protocol)) == lines(run(scenario, 4))


@pytest.mark.parametrize("changes", [{}, {"fault": (Crash(node=1, start=0.5, end=1.0, memory=False),)}])
def test_a_rule_played_in_parallel_leaves_the_native_trace(changes):
    scenario = small(**{"protocol.schedule": Rounds(period=0.2), "record.messages": True}, **changes)
    env = desim.parallel_env(scenario, 4)
    assert lines(play(env, LocalMin())) == lines(run(scenario, 4))
    other = small(**{"protocol.kind": "sap", "protocol.schedule": Rounds(period=0.2), "record.messages": True})
    assert lines(env.result) != lines(run(other, 4))


@pytest.mark.parametrize("kind", ["binary_log_linear", "sap"])
@pytest.mark.parametrize("memory", [False, True])
@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_a_rule_is_asked_in_parallel_as_a_run_asks_it(kind, memory, offset):
    """The rule draws, so a choice that a run does not ask for would change all later ones.

    A pursuer is not asked while it is down or has no choice. One that remembers its round decides when it is up again,
    between two rounds, and one whose clock is wrong in rounds of its own.
    """
    skew = {"kind": "clock_skew", "node": 0, "offset": offset}
    changes = {"fault": [Crash(node=1, start=0.5, end=0.95, memory=memory), skew], "team.speeds": [2.0, 2.0, 0.5]}
    rule = {"kind": kind, "schedule": Rounds(period=0.2), "tau": {"kind": "constant", "value": 100.0}}
    scenario = small(**{"team.count": 3, "protocol": rule, **changes})
    played = play(desim.parallel_env(scenario, 4), scenario.protocol)
    assert lines(played) == lines(run(scenario, 4))
    assert any(isinstance(event, Decided) and event.pursuer == 1 and event.t > 900_000_000 for event in played.trace)


@pytest.mark.slow
def test_observing_changes_nothing():
    scenario = small(**{"sensing.noise": 0.3, "sensing.radius": 12.0, "sensing.estimator": {"kind": "kalman"}})
    scenario = scenario.with_({"record.messages": True})
    env = desim.env(scenario, 4)
    env.reset()
    rules = {}
    while env.agents and not env.terminations[env.agent_selection]:
        before = {agent: env.observe(agent) for agent in env.agents}
        env.state()
        assert all(np.array_equal(before[agent], env.observe(agent)) for agent in env.agents)
        me = env.pursuer(env.agent_selection)
        env.step(next(rules.setdefault(me.id, LocalMin().actions(me))))
    assert lines(env.result) == lines(run(scenario, 4))


SCENARIOS = {
    "one evader": {},
    "two evaders": {"evader": (Evader(), Evader(speed=0.5))},
    "crashes": {"fault": (Crash(node=1, start=0.3, end=0.8, memory=False), Crash(node=2, start=0.5))},
    "slow": {"team.speeds": 0.5},
    "sensing": {"sensing.noise": 0.3, "sensing.radius": 12.0, "sensing.estimator": {"kind": "kalman"}},
    "rounds": {"protocol.schedule": Rounds()},
}


@pytest.mark.whole_but_one
@pytest.mark.slow_but_one
@pytest.mark.parametrize("options", [{}, {"observation": "dict"}, {"agents_leave": True}, {"omniscient": True}])
@pytest.mark.parametrize("name", SCENARIOS)
def test_pettingzoo_finds_nothing_to_complain_about(name, options):
    scenario = small(**SCENARIOS[name])
    make, parallel = partial(desim.env, scenario, **options), partial(desim.parallel_env, scenario, **options)
    with warnings.catch_warnings():
        if "observation" in options:
            warnings.filterwarnings(
                "ignore", message="Observation space for each agent probably should be|Observation is"
            )
        api_test(make(), num_cycles=50)
    parallel_api_test(parallel(), num_cycles=50)
    seed_test(make, num_cycles=10)
    parallel_seed_test(parallel, num_cycles=10)
    state_test(make(), parallel(), num_cycles=5)


@pytest.mark.parametrize("schedule", ["rounds", "poisson"])
def test_an_episode_ends_after_so_many_turns_of_each(schedule):
    scenario = small(**{"protocol.schedule": {"kind": schedule}, "horizon": 20.0, "evader.position": (100.0, 0.0)})
    max_cycles_test(
        SimpleNamespace(env=partial(desim.env, scenario), parallel_env=partial(desim.parallel_env, scenario))
    )
    env = desim.env(scenario, 1, max_cycles=3)
    env.reset()
    played_out(env)
    assert env.result.trace.of(Ended)[0].reason == "stopped"


def test_a_pursuer_that_leaves_is_stepped_before_all_others():
    """As PettingZoo has it: the next agent is the one that has left, until it has been stepped with None."""
    env = desim.env(small(**{"fault": (Crash(node=1, start=0.3),)}), 4, agents_leave=True)
    env.reset()
    while not env.terminations["pursuer_1"]:
        env.step(1)
    assert env.agent_selection == "pursuer_1"
    env.step(None)
    assert "pursuer_1" not in env.agents
    assert env.agent_selection in env.agents


def test_an_episode_in_which_nobody_decides():
    scenario = small(**{"team.speeds": 0.5})
    env = desim.env(scenario, 1)
    env.reset()
    assert env.infos["pursuer_3"]["action_mask"].tolist() == [1, 0]
    env.step(0)
    assert all(env.terminations.values())
    for _ in env.agent_iter():
        env.step(None)
    assert env.agents == []
    with pytest.raises(RuntimeError, match=r"the episode is over: call reset\(\)"):
        env.step(0)
    parallel = desim.parallel_env(scenario, 1)
    observations, _ = parallel.reset()
    assert set(observations) == set(parallel.agents)
    _, _, terminations, _, _ = parallel.step(dict.fromkeys(parallel.agents, 0))
    assert all(terminations.values())
    assert parallel.agents == []


def test_a_seed_is_that_of_a_run():
    scenario = small()
    env = desim.env(scenario, 7)
    seeds = []
    for seed in (None, None, 7, None):
        env.reset(seed=seed)
        seeds.append(env.result.seed)
    assert seeds == [7, 7_000_001, 7, 7_000_001]
    free = desim.env(scenario)
    free.reset()
    first = free.result.seed
    other = desim.env(scenario)
    other.reset()
    assert first != other.result.seed
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=-1)


@pytest.mark.parametrize("dump", [pickle.dumps, cloudpickle.dumps])
def test_an_environment_is_pickled_before_and_after_reset(dump):
    for env in (desim.env(small(), 3), desim.parallel_env(small(), 3)):
        assert pickle.loads(dump(env)).possible_agents == env.possible_agents
        env.reset()
        again = pickle.loads(dump(env))
        assert np.array_equal(again.state(), env.state())
    env = desim.env(small(horizon=0.5), 3, reward=team_reward)
    env.reset()
    for _ in range(9):
        env.step(1)
    again = pickle.loads(dump(env))
    while env.agents:
        assert again.agent_selection == env.agent_selection
        (seen, *rest, _), (seen_again, *rest_again, _) = env.last(), again.last()
        assert np.array_equal(seen, seen_again)
        assert rest == rest_again
        action = None if rest[1] or rest[2] else 1
        env.step(action)
        again.step(action)
    assert lines(again.result) == lines(env.result)


def test_agents_live_to_the_end_unless_they_may_leave():
    scenario = small(fault=(Crash(node=1, start=0.5, end=1.0),))
    env = desim.env(scenario, 3)
    env.reset()
    while env.pursuer("pursuer_0").now < 0.7:
        env.step(1)
    assert env.infos["pursuer_1"]["action_mask"].tolist() == [1, 1]  # of its last turn
    assert env._info(env.pursuer("pursuer_1"))["action_mask"].tolist() == [1, 0]
    assert len(env.agents) == 5
    leaving = desim.parallel_env(scenario, 3, agents_leave=True)
    leaving.reset()
    while len(leaving.agents) == 5:
        *_, terminations, _, _ = leaving.step(dict.fromkeys(leaving.agents, 1))
    assert [agent for agent, ended in terminations.items() if ended] == ["pursuer_1"]
    assert leaving.pursuer("pursuer_0").now == pytest.approx(0.5, abs=0.11)
    late = desim.parallel_env(scenario, 3, agents_leave=True, max_cycles=int(leaving._rounds))
    late.reset()
    while late.agents:
        *_, terminations, truncations, _ = late.step(dict.fromkeys(late.agents, 1))
    assert [name for name, ended in terminations.items() if ended] == ["pursuer_1"]
    assert [truncated for name, truncated in truncations.items() if name != "pursuer_1"] == [True] * 4
    assert not truncations["pursuer_1"]  # one that has left is not truncated, too


def test_a_pursuer_that_has_left_keeps_its_action_when_its_robot_is_up_again():
    scenario = small(**{"protocol.schedule": Rounds(period=0.2), "fault": (Crash(node=1, start=0.5, end=1.0),)})
    env = desim.parallel_env(scenario, 3, agents_leave=True)
    env.reset()
    while env.agents:
        env.step(dict.fromkeys(env.agents, 1))
    late = {event.pursuer: event.active for event in env.result.trace.of(Decided) if event.t > 1_000_000_000}
    assert late[1] == 0  # as since its crash; nobody asks the learner for it
    assert late[0] == 1


def test_the_bounds_of_places_are_those_that_a_player_can_reach():
    scenario = small()
    env = desim.env(scenario, 3)
    low, high = (bound[env.state_names.index("evader_1.x")] for bound in (env.state_space.low, env.state_space.high))
    boxes = [scenario.team.box, scenario.evaders[0].box]
    path = max(scenario.team.top_speed, scenario.evaders[0].speed) * scenario.horizon
    assert low == pytest.approx(min(map(min, boxes)) - path - 1.0)
    assert high == pytest.approx(max(map(max, boxes)) + path + 1.0)


@pytest.mark.parametrize("schedule", ["shared_seed", "rounds"])
def test_rewards_add_up_between_turns(schedule):
    """In a static game, utilities change with actions only: their integral is a sum over the decisions of the trace."""
    scenario = small(**{"motion.static": True, "capture.radius": 0.01, "protocol.schedule": {"kind": schedule}})
    first = desim.env(scenario, 3)
    turns = count(), count()
    choose = lambda env, agent: (env.pursuer(agent).id + next(turns[env is second])) % 2  # noqa: E731
    second = desim.env(scenario, 3, reward="team")
    first.reset()
    begin = first.pursuer("pursuer_0").now
    sums = played_out(first, choose)
    trace = first.result.trace
    phi = np.array(first.pursuer("pursuer_0").global_state.capture_times(1))
    profile, since, expected = list(trace.events[0].active), begin, np.zeros(5)
    total = 0.0
    for event in [*trace.of(desim.pursuit.core.events.Decided), trace.of(Ended)[0]]:
        duration = event.t / 1e9 - since
        expected += [duration / 2.0 * wonderful_life_utility(phi, profile, 2.0, i) for i in range(5)]
        total += duration / 2.0 * welfare(phi, profile, 2.0)
        since = event.t / 1e9
        if hasattr(event, "pursuer"):
            profile[event.pursuer] = event.active
    assert list(sums.values()) == pytest.approx(expected.tolist(), abs=1e-12)
    second.reset()
    assert list(played_out(second, choose).values()) == pytest.approx([total] * 5, abs=1e-12)


@pytest.mark.parametrize("offset", [0.0, 0.01])
def test_rewards_of_rounds_count_the_actions_of_those_that_are_asked(offset):
    """With wrong clocks each pursuer decides at an instant of its own, and the actions of others do not count yet."""
    skews = [{"kind": "clock_skew", "node": k, "offset": offset * k} for k in range(5)]
    scenario = small(
        **{"motion.static": True, "capture.radius": 0.01, "protocol.schedule": Rounds(period=0.1), "fault": skews}
    )
    rng = np.random.default_rng(4)
    steps = []
    shown = desim.parallel_env(scenario, 3, reward=lambda step: steps.append(step) or 0.0)
    utilities = desim.parallel_env(scenario, 3)
    utilities.reset()
    shown.reset()
    begin, phi = utilities._world.now / 1e9, np.array(utilities.pursuer("pursuer_0").global_state.capture_times(1))
    sums = np.zeros(5)
    while utilities.agents:
        actions = {name: int(rng.integers(2)) for name in utilities.agents}
        sums += [*utilities.step(actions)[1].values()]
        shown.step(actions)
        assert steps[-1].is_last or [*steps[-1].profile] == shown._world.profile
    trace = utilities.result.trace
    profile, since, expected = list(trace.events[0].active), begin, np.zeros(5)
    for event in [*trace.of(desim.pursuit.core.events.Decided), trace.of(Ended)[0]]:
        expected += [(event.t / 1e9 - since) / 2.0 * wonderful_life_utility(phi, profile, 2.0, i) for i in range(5)]
        since = event.t / 1e9
        if hasattr(event, "pursuer"):
            profile[event.pursuer] = event.active
    assert sums == pytest.approx(expected, abs=1e-12)
    assert len({step.start for step in steps}) > (60 if offset else 15)


def test_a_reward_of_a_user_is_a_function_of_a_step():
    steps = []
    env = desim.env(small(), 3, reward=lambda step: steps.append(step) or -step.duration * len(step.profile))
    env.reset()
    begin = env.pursuer("pursuer_0").now
    sums = played_out(env)
    assert [step.is_last for step in steps] == [False] * (len(steps) - 1) + [True]
    assert steps[0].profile == (1, 1, 1, 1, 1)
    assert [step.time_left for step in steps] == pytest.approx([2.0 - step.start for step in steps], abs=1e-9)
    end = env.result.trace.of(Ended)[0].t / 1e9
    assert list(sums.values()) == pytest.approx([-5 * (end - begin)] * 5)
    for wrong in (lambda step: "much", lambda step: [1.0], lambda step: float("nan"), lambda step: np.complex64(1)):
        env = desim.env(small(), 3, reward=wrong)
        env.reset()
        with pytest.raises(ValueError, match=r"a reward should be a finite .* from <lambda> [(]"):
            env.step(1)


@pytest.mark.parametrize(
    ("reward", "why"),
    [
        (lambda: 1.0, r"a reward should accept a call with \(step\); <lambda> "),
        (lambda step: (yield 1.0), "a reward should do its work when it is called, without yield: <lambda>"),
    ],
    ids=["no argument", "generator"],
)
def test_a_reward_that_cannot_be_called_with_a_step_is_refused_at_once(reward, why):
    for make in (desim.env, desim.parallel_env):
        with pytest.raises(ValueError, match=why):
            make(small(), 3, reward=reward)


@pytest.mark.parametrize("kind", [np.float32, np.array, Fraction, Decimal])
def test_a_reward_may_be_a_number_of_any_kind(kind):
    for reward in (lambda step: kind(0.25), lambda step: [kind(0.25)] * 5):
        env = desim.env(small(), 3, reward=reward)
        env.reset()
        env.step(1)
        assert {(value, type(value)) for value in env.rewards.values()} <= {(0.25, float), (0.0, float)}
        assert 0.25 in env.rewards.values()


@pytest.mark.parametrize("make", [desim.env, desim.parallel_env])
def test_a_reward_that_remembers_earlier_episodes_is_warned_of_once(make):
    """It may be meant to learn, so it is not made anew."""
    act = (lambda env: env.step(1)) if make is desim.env else lambda env: env.step(dict.fromkeys(env.agents, 1))
    reported = []
    env = make(small(), 3, reward=lambda step: reported.append(step) or 1.0)
    for _ in range(3):
        env.reset()
        act(env)
    env = make(small(), 3, reward=Counter())
    env.reset()
    act(env)
    with pytest.warns(StateWarning, match="reward: it has changed since the first episode"):
        env.reset(seed=3)
    act(env)
    env.reset()


def test_an_action_that_a_mask_excludes_has_the_effect_of_none():
    scenario = small(**{"team.speeds": [0.5, 2.0, 2.0, 2.0, 2.0], "protocol": CBAA()})
    env = desim.env(scenario, 3)
    env.reset()
    while env.agent_selection != "pursuer_0":
        env.step(1)
    assert env.infos["pursuer_0"]["action_mask"].tolist() == [1, 0]
    env.step(1)
    assert env.pursuer("pursuer_0").action == 0
    steps = []
    parallel = desim.parallel_env(scenario, 3, reward=lambda step: steps.append(step) or 0.0)
    parallel.reset()
    parallel.step(dict.fromkeys(parallel.agents, 1))
    assert steps[0].profile == (0, 1, 1, 1, 1)


def test_a_mask_that_a_learner_changes_is_that_of_no_other():
    env = desim.env(small(), 3)
    env.reset()
    for name in env.agents:
        env.infos[name]["action_mask"][:] = 0
    assert env._info(env.pursuer("pursuer_0"))["action_mask"].tolist() == [1, 1]


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (
            lambda: desim.env(small(), reward="much"),
            ValueError,
            "a reward should be wonderful_life, team or a function",
        ),
        (lambda: desim.env(small(), observation="list"), ValueError, "should be vector or dict"),
        (lambda: desim.env(small(), render_mode="human"), ValueError, "should be rgb_array or replay"),
        (lambda: desim.env(small(), max_cycles=0), ValueError, "at least 1"),
        (lambda: desim.env(small(), max_cycles=2.5), ValueError, r"max_cycles should be an integer \(got 2.5\)"),
        (lambda: desim.env(small(), max_cycles="3"), ValueError, "max_cycles should be an integer"),
        (
            lambda: desim.env(small(), agents_leave="no"),
            ValueError,
            r"agents_leave should be True or False \(got 'no'\)",
        ),
        (lambda: desim.env(small(), omniscient="no"), ValueError, "omniscient should be True or False"),
        (lambda: desim.env(small(), reward=["team"]), ValueError, "a reward should be wonderful_life, team or"),
        (lambda: desim.env(small(), rewards="team"), TypeError, "unexpected keyword argument 'rewards', did you mean"),
        (lambda: desim.env(small(), 1.5), ValueError, r"the seed should be an integer \(got 1.5\)"),
        (lambda: desim.env(small(), -1), ValueError, "seed"),
        (lambda: desim.env({"horizon": 2.0}), TypeError, r"env takes a scenario, not a dict: env\(Scenario"),
        (lambda: desim.env("nowhere.toml"), FileNotFoundError, "No such file"),
        (lambda: desim.env(small(protocol=Server())), TypeError, "has no turns at which an action could be asked for"),
        (lambda: desim.env(small()).step(1), RuntimeError, r"call reset\(\) first"),
        (lambda: desim.env(small()).observe("pursuer_0"), RuntimeError, r"call reset\(\) first"),
        (lambda: desim.env(small()).agent_iter(), RuntimeError, r"call reset\(\) first"),
        (lambda: desim.env(small()).last(), AttributeError, r"call reset\(\) first"),
        (lambda: desim.env(small()).agent_selection, AttributeError, r"call reset\(\) first"),
    ],
)
def test_wrong_arguments_are_refused(make, error, text):
    with pytest.raises(error, match=text):
        make()


class Tensor:
    """A number of another library."""

    def tolist(self):
        return 1


@pytest.mark.parametrize("action", [np.int8(1), np.array(1), Tensor()])
def test_an_action_may_be_an_integer_of_any_kind(action):
    env = desim.env(small(), 1)
    env.reset()
    env.step(action)
    assert env.pursuer("pursuer_0").action == 1


def test_wrong_actions_are_refused():
    env = desim.env(small(), 1)
    env.reset()
    for action in (2, -1, 0.5, None, "1", [1], np.array([1]), float("nan")):
        with pytest.raises(ValueError, match="an action should be an integer from 0 to 1"):
            env.step(action)
    parallel = desim.parallel_env(small(), 1)
    parallel.reset()
    with pytest.raises(ValueError, match="pursuer_1 has no action"):
        parallel.step({"pursuer_0": 1})
    for actions in (None, [1, 1, 1, 1, 1], 1):
        with pytest.raises(TypeError, match="a step takes a dict of the actions of all agents"):
            parallel.step(actions)
    with pytest.raises(KeyError, match="there is no agent 'pursuer_9': they are pursuer_0 to pursuer_4"):
        parallel.observe("pursuer_9")
    for wrong in ("pursuer_9", 0):
        with pytest.raises(KeyError, match=f"there is no agent {wrong!r}"):
            parallel.step(dict.fromkeys([*parallel.agents, wrong], 1))
    with pytest.raises(TypeError, match="a step takes a dict of the actions of all agents, not a list"):
        parallel.step([1] * 5)
    for space in (env.action_space, env.observation_space, env.observe):
        for wrong in (3, ["pursuer_0"]):
            with pytest.raises(KeyError, match=r"there is no agent .*: they are pursuer_0 to pursuer_4"):
                space(wrong)


def test_actions_and_seeds_may_be_those_of_numpy():
    env = desim.env(small(), np.int32(3), max_cycles=np.int64(2), agents_leave=np.False_)
    env.reset(seed=np.int64(4))
    for action in (np.int64(1), np.array(1), np.uint8(0)):
        env.step(action)
    assert (type(env.result.seed), env.result.seed) == (int, 4)


def test_it_is_registered_as_pettingzoo_registers():
    for kind, base in (("aec", pettingzoo.AECEnv), ("parallel", pettingzoo.ParallelEnv)):
        env = pettingzoo.make(kind, "desim/pursuit-v0", scenario=small(), max_cycles=2)
        assert isinstance(env, base)
        assert env.max_cycles == 2


def test_a_scenario_is_an_environment():
    env = small().env(3)
    env.reset()
    assert env.result.seed == 3
    parallel = small().parallel_env(3, max_cycles=2)
    assert parallel.max_cycles == 2
    assert desim.env(str(RELAY)).scenario == load(RELAY)


@pytest.mark.slow
def test_a_picture_of_the_present_and_a_replay_page():
    env = desim.env(small(), 3, render_mode="rgb_array")
    env.reset()
    first = env.render()
    for _ in range(12):
        env.step(1)
    second = env.render()
    assert first.shape == second.shape
    assert second.dtype == np.uint8
    assert (first != second).any()
    page = desim.env(small(), 3, render_mode="replay")
    page.reset()
    page.step(1)
    assert page.render().startswith("<!doctype html>")
    assert desim.env(small()).render() is None


def test_a_picture_without_the_extra_names_it(monkeypatch):
    env = desim.env(small(horizon=0.1), 3, render_mode="rgb_array")
    env.reset()
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'pursuit-desim\[plot\]'"):
        env.render()


@pytest.mark.whole
def test_many_resets_need_neither_memory_nor_threads():
    env = desim.env(small(**{"record.trajectory": 0.0}), 1)

    def objects(resets):
        for _ in range(resets):
            env.reset()
            env.step(1)
        gc.collect()
        return len(gc.get_objects()), sys.getallocatedblocks()

    objects(20)
    before, threads = objects(20), threading.active_count()
    after = objects(1000)
    assert threading.active_count() == threads
    assert after[0] - before[0] < 500
    assert after[1] - before[1] < 2000


@pytest.mark.slow
def test_an_environment_that_is_forgotten_ends_its_run():
    for _ in range(3):
        env = desim.env(small(), 1)
        env.reset()
        env.step(1)
        del env
    gc.collect()
    result = run(small(), 1)
    assert result.trace.of(Ended)


def test_an_episode_belongs_to_the_thread_that_began_it():
    """Another thread may look at it, leave it, and begin one of its own."""
    env, log = desim.env(small(), 1), []
    env.reset()
    env.step(1)

    def use():
        log.append(env.observe("pursuer_0"))
        with pytest.raises(RuntimeError, match=r"another thread began this episode: call reset\(\)"):
            env.step(1)
        env.reset(seed=1)
        env.step(1)
        log.append(env.observe("pursuer_0"))
        env.close()

    thread = threading.Thread(target=use)
    thread.start()
    thread.join()
    assert np.array_equal(*log)
    env.reset()
    env.step(1)


def test_a_run_that_fails_ends_the_episode_and_not_the_environment(monkeypatch):
    def latency(context, rng):
        return 0.01 / (rng.random() > 0.1)

    env = desim.env(small(**{"network.latency": latency}), 1)
    env.reset()
    with pytest.raises(ZeroDivisionError):
        played_out(env)
    with pytest.raises(RuntimeError, match=r"the run of this episode has failed: call reset\(\)"):
        env.step(1)
    env.close()
    env.reset()
    env.step(1)
    monkeypatch.setattr("desim.learning.pursuit.Episode", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        env.reset()
    with pytest.raises(RuntimeError, match=r"there is no episode: call reset\(\) first"):
        env.step(1)


@pytest.mark.parametrize("make", [desim.env, desim.parallel_env])
@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_has_an_episode_of_its_own(make, copied):
    def act(env):
        env.step(1 if make is desim.env else dict.fromkeys(env.agents, 1))

    counter = Counter()
    env = make(small(), 3, reward=counter)
    env.reset()
    act(env)
    twin = copied(env)
    assert counter.steps == 1  # the steps of the past are not rewarded again
    assert np.array_equal(twin.state(), env.state())
    act(twin)
    assert not np.array_equal(twin.state(), env.state())
    act(env)
    assert np.array_equal(twin.state(), env.state())
    env.close()
    assert lines(copied(env).result) == lines(env.result)


@pytest.mark.parametrize("is_closed", [False, True])
def test_an_episode_is_pickled_as_open_or_closed_as_it_is(is_closed):
    episode = Episode(small(), 3)
    episode.act(1)
    if is_closed:
        episode.close()
    again = pickle.loads(pickle.dumps(episode))
    assert (again.turn is None, again.result is None) == (episode.turn is None, episode.result is None)
    assert (again.turn is None) == is_closed


class Counter:
    """A reward that counts the steps."""

    steps = 0

    def __call__(self, step):
        self.steps += 1
        return 0.0


@pytest.mark.slow
def test_several_episodes_may_alternate_with_each_other_and_with_runs():
    scenario, seeds = small(**{"record.messages": True, "horizon": 0.5}), (1, 2)
    envs, rules, other = [desim.env(scenario, seed) for seed in seeds], [{} for _ in seeds], small(horizon=0.02)
    for env in envs:
        env.reset()
    while any(env.agents and not env.terminations[env.agent_selection] for env in envs):
        for env, memory in zip(envs, rules, strict=True):
            if not env.terminations[env.agent_selection]:
                me = env.pursuer(env.agent_selection)
                env.step(next(memory.setdefault(me.id, LocalMin().actions(me))))
        run(other, 9)
    assert [lines(env.result) for env in envs] == [lines(run(scenario, seed)) for seed in seeds]


def test_a_closed_episode_is_over():
    env = desim.env(small(), 1)
    env.close()
    env.reset()
    env.step(1)
    env.close()
    env.close()
    env.step(1)
    assert all(env.terminations.values())
    parallel = desim.parallel_env(small(), 1)
    parallel.reset()
    parallel.close()
    assert all(parallel.step(dict.fromkeys(parallel.agents, 1))[2].values())
    with pytest.raises(RuntimeError, match=r"the episode is over: call reset\(\)"):
        parallel.step({})


@pytest.mark.parametrize("make", [desim.env, desim.parallel_env])
def test_without_a_scenario_an_environment_is_that_of_the_paper(make):
    default, given = make(), make(Scenario())
    assert default.possible_agents == given.possible_agents
    for each in (default, given):
        each.reset(seed=3)
    assert str(default.state().tolist()) == str(given.state().tolist())

"""Agents of PettingZoo that talk over a network: its own tests pass, and each hears what has arrived."""

import copy
import gc
import pickle
import warnings
from decimal import Decimal
from fractions import Fraction

import networkx as nx
import numpy as np
import pandas as pd
import pettingzoo
import pytest
from gymnasium import spaces
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test
from pettingzoo.test.example_envs import (
    generated_agents_env_action_mask_info_v0,
    generated_agents_env_action_mask_obs_v0,
    generated_agents_env_v0,
    generated_agents_parallel_v0,
)
from pettingzoo.utils import aec_to_parallel, parallel_to_aec

import desim
from desim import Crash, Links, Lognormal
from desim.adapters.env_network import EnvNetwork
from desim.adapters.message_spaces import blank
from tests.adapters.environments import NAMES, Counter, Line, Turns

LINKS = Links(latency=Lognormal(mean=0.1, cv=0.5), loss=0.1)
WARNED = "Observation is not a NumPy array|probably should be gymnasium.spaces|all zeros|named in the format"
"""What the tests of PettingZoo say of all environments whose spaces are dicts, and of some without a wrapper."""
PARALLEL = ("sisl/pursuit_v5", "butterfly/knights_archers_zombies_v11")


def checked(test, *arguments, **options):
    """Run a test of PettingZoo, in which each other warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for text in WARNED.split("|"):
            warnings.filterwarnings("ignore", f".*{text}")
        test(*arguments, **options)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["classic/rps_v2", "classic/tictactoe_v3", "classic/connect_four_v3", *PARALLEL])
def test_an_environment_of_pettingzoo_passes_its_tests(name):
    """They need pygame only; three of them have masks of actions in their observations."""
    checked(api_test, desim.wrap(pettingzoo.make("aec", name), LINKS), num_cycles=10)
    checked(seed_test, lambda: desim.wrap(pettingzoo.make("aec", name), LINKS), num_cycles=5)
    if name in PARALLEL:
        checked(parallel_api_test, desim.wrap(pettingzoo.make("parallel", name), LINKS), num_cycles=10)
        checked(parallel_seed_test, lambda: desim.wrap(pettingzoo.make("parallel", name), LINKS), num_cycles=5)


@pytest.mark.slow
def test_small_environments_pass_the_tests_of_pettingzoo():
    checked(parallel_api_test, desim.wrap(Line(), LINKS), num_cycles=40)
    checked(parallel_seed_test, lambda: desim.wrap(Line(), LINKS), num_cycles=20)
    checked(api_test, desim.wrap(parallel_to_aec(Line(["a_0", "a_1"])), LINKS), num_cycles=20)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it has no render method
        api_test(desim.wrap(Turns(), LINKS), num_cycles=20)


GENERATED = {
    "aec": generated_agents_env_v0.env,
    "masked observations": generated_agents_env_action_mask_obs_v0.env,
    "masked infos": generated_agents_env_action_mask_info_v0.env,
    "parallel": generated_agents_parallel_v0.parallel_env,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", GENERATED)
def test_agents_that_are_not_known_in_advance_talk(name):
    api, seeds = (parallel_api_test, parallel_seed_test) if name == "parallel" else (api_test, seed_test)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # such environments are told that they are very uncommon
        api(desim.wrap(GENERATED[name](), LINKS), num_cycles=30)
        seeds(lambda: desim.wrap(GENERATED[name](), LINKS), num_cycles=10)


def test_each_agent_that_appears_has_a_row_up_to_the_capacity():
    def positions(env):
        return {agent: (float(k), 0.0) for k, agent in enumerate(env.agents)}

    def played(steps, **options):
        env = desim.wrap(generated_agents_parallel_v0.parallel_env(), **options, message=NUMBERS)
        env.reset(seed=2)
        for _ in range(steps):
            seen = env.step({agent: {**env.action_space(agent).sample(), "message": [5.0]} for agent in env.agents})[0]
        return env, seen

    env, seen = played(12, positions=positions, links={"range": 50.0})
    assert len(env.rows) > 5  # at the start
    assert sorted(env.rows.values()) == list(range(len(env.rows)))
    env.reset(seed=3)
    assert [*env.rows] == env.agents[:5]  # each episode has rows of its own
    env, seen = played(12, positions=positions, links={"range": 50.0})
    first, *others = env.agents[:5]
    assert all(seen[first]["ages"][env.rows[agent]] == pytest.approx(0.1) for agent in others)
    assert seen[first]["messages"].sum() == 5.0 * sum(seen[first]["ages"] >= 0.0) > 0.0
    assert set(env.network.neighbours(0)) < set(env.rows.values())  # a node without an agent is out of range
    with pytest.raises(ValueError, match="more than 5 agents have appeared in an episode: raise capacity="):
        played(12, capacity=5)
    with pytest.raises(ValueError, match="positions should be a dict by agent"):
        played(1, positions=lambda env: np.zeros((5, 2)))


def test_an_action_that_is_a_dict_with_the_key_action_stays_one():
    class Keyed(Line):
        def action_space(self, agent):
            return spaces.Dict({"action": super().action_space(agent)})

        def step(self, actions):
            return super().step({agent: action["action"] for agent, action in actions.items()})

    env = desim.wrap(Keyed())
    env.reset(seed=3)
    mask = {"action": np.array([0, 0, 1], np.int8)}
    env.step({name: env.action_space(name).sample(mask) for name in env.agents})
    assert [*env.unwrapped.x.values()] == [2.0, 6.0, 10.0]


def talk(env, steps, seed=3):
    """Let each agent say 100 k + its number in step k, and return the observations of each step."""
    observed = [env.reset(seed=seed)[0]]
    for k in range(steps):
        said = {name: {"action": 0, "message": np.array([100.0 * k + NAMES.index(name)])} for name in env.agents}
        observed.append(env.step(said)[0])
    return observed


NUMBERS = spaces.Box(0.0, 1e6, (1,), np.float64)


@pytest.mark.parametrize(("latency", "steps"), [(0.0, 1), (0.1, 1), (0.11, 2), (0.35, 4)])
def test_an_agent_hears_the_newest_message_that_has_arrived_and_its_age(latency, steps):
    """What is said at the beginning of a step of 0.1 s is heard at the end of the first step that ends after it."""
    observed = talk(desim.wrap(Line(), Links(latency=latency), message=NUMBERS), 8)
    for k, observations in enumerate(observed):
        for number, name in enumerate(NAMES):
            newest = k - steps
            others = [other for other in range(3) if other != number]
            messages, ages = observations[name]["messages"], observations[name]["ages"]
            assert (messages[number], ages[number]) == (0.0, -1.0)
            if newest < 0:
                assert (ages[others] == -1.0).all()
                assert (messages[others] == 0.0).all()
            else:
                assert ages[others] == pytest.approx(0.1 * steps)
                assert messages[others, 0].tolist() == [100.0 * newest + other for other in others]


def test_the_environment_itself_is_unchanged():
    plain, wrapped = Line(), desim.wrap(Line(), LINKS)
    plain.reset(seed=1)
    wrapped.reset(seed=1)
    rng = np.random.default_rng(0)
    while plain.agents:
        actions = {name: int(rng.integers(3)) for name in plain.agents}
        expected = plain.step(actions)
        got = wrapped.step({name: {"action": actions[name], "message": None} for name in actions})
        assert {name: seen["observation"].tolist() for name, seen in got[0].items()} == {
            name: seen.tolist() for name, seen in expected[0].items()
        }
        assert got[1:] == expected[1:]
    assert wrapped.network.counts().sent == 0  # None says nothing


def test_agents_out_of_range_are_not_heard_unless_their_places_are_frozen():
    def heard(positions):
        env = desim.wrap(Line(steps=99), {"range": 5.0}, positions=positions, message=NUMBERS)
        env.reset(seed=0)
        for k in range(3):  # eve, 4 m from bob, goes on by 2 m a step
            moves = {"ann": 0, "bob": 0, "eve": 2}
            said = {name: {"action": moves[name], "message": [float(k)]} for name in env.agents}
            observations = env.step(said)[0]
        return observations["bob"]["messages"][:, 0].tolist(), observations["bob"]["ages"].tolist()

    start = Line()
    start.reset()
    frozen = start.places()
    assert heard(lambda env: env.places()) == ([2.0, 0.0, 0.0], pytest.approx([0.1, -1.0, 0.3]))
    assert heard(lambda env: frozen) == ([2.0, 0.0, 2.0], pytest.approx([0.1, -1.0, 0.1]))
    as_rows = lambda env: [(env.x[name], 0.0) for name in env.possible_agents]  # noqa: E731
    assert heard(as_rows) == heard(lambda env: env.places())


@pytest.mark.parametrize(
    "places",
    [
        lambda rows: pd.DataFrame(rows, columns=["x", "y"]),
        lambda rows: pd.DataFrame(rows, columns=["x", "y"], index=list(NAMES)).loc[["eve", "ann", "bob"], ["y", "x"]],
        lambda rows: np.array([row[::-1] for row in rows], dtype=[("y", float), ("x", float)]),
        lambda rows: (row for row in rows),
        lambda rows: [[Fraction(x), Decimal(y)] for x, y in rows],
    ],
)
def test_places_may_be_rows_of_any_kind(places):
    """Tables of pandas count by the names of their columns and agents."""
    rows = [(0.0, 0.0), (3.0, 0.0), (3.0, 40.0)]
    env = desim.wrap(Line(), {"range": 5.0}, positions=lambda env: places(rows), message=NUMBERS)
    assert talk(env, 1)[-1]["ann"]["ages"].tolist() == [-1.0, pytest.approx(0.1), -1.0]


@pytest.mark.parametrize(
    ("space", "said", "heard"),
    [
        (NUMBERS, np.float16([2.0]), [2.0]),
        (NUMBERS, [Fraction(1, 2)], [0.5]),
        (NUMBERS, np.ma.array([2.0]), [2.0]),
        (NUMBERS, np.ma.array([2.0], mask=True), None),
        (NUMBERS, np.array([2.0 + 1j]), None),
        (NUMBERS, np.array([2], "m8[s]"), None),
        (NUMBERS, ["2"], None),
        (spaces.Box(0, 200, (1,), np.uint8), [2.0], [2]),
        (spaces.Box(0, 200, (1,), np.uint8), [0.5], None),
        (spaces.Box(0, 200, (1,), np.uint8), [300], None),
    ],
)
def test_a_message_has_the_numbers_that_were_said_or_is_refused(space, said, heard):
    env = desim.wrap(Line(), message=space)
    env.reset(seed=0)
    actions = {name: {"action": 0, "message": said} for name in NAMES}
    if heard is None:
        with pytest.raises(ValueError, match="the message of 'ann' should be in Box"):
            env.step(actions)
    else:
        assert env.step(actions)[0]["ann"]["messages"][1].tolist() == heard


def test_nobody_speaks_in_a_step_that_is_refused():
    env = desim.wrap(Line(), message=NUMBERS)
    env.reset(seed=0)
    actions = {name: {"action": 0, "message": [1.0]} for name in NAMES}
    with pytest.raises(ValueError, match="the message of 'eve' should be in Box"):
        env.step(actions | {"eve": {"action": 0, "message": [-1.0]}})
    assert env.network.counts().sent == 0
    env.step(actions)
    assert env.network.counts().sent == 6


@pytest.mark.parametrize(
    ("medium", "overlaps"),
    [
        ({"access": "csma"}, True),
        ({"access": "aloha"}, True),
        ({"half_duplex": True}, True),
        ({"access": {"kind": "slotted_aloha", "slot": 0.001, "p": 0.2}}, False),
        ({"access": {"kind": "tdma", "slot": 0.005}}, False),
        ({"shared": True}, False),
    ],
)
def test_a_channel_on_which_agents_that_speak_at_once_are_not_heard_is_warned_of(medium, overlaps):
    """Random delays of their hosts separate them, as turns do."""
    links = {"medium": {"kind": "bitrate", "bitrate": 1e5} | medium}
    separated = links | {"processing": {"sender": {"kind": "uniform", "low": 0.0, "high": 0.09}}}
    told = "all agents speak at the same instant of a step, and 100 % of their frames overlap"
    heard = []
    for one in (links, separated):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            env = desim.wrap(Line(), one, message=NUMBERS)
        assert [told in str(warning.message) for warning in caught] == [True] * (overlaps and one is links)
        talk(env, 20)
        heard.append(env.network.counts().delivered / 120)
    assert (heard[0] == 0.0) == overlaps
    assert heard[1] > 0.5
    desim.wrap(Turns(), links)  # a warning is an error


def test_an_agent_that_is_gone_is_heard_no_more_and_keeps_its_place():
    env = desim.wrap(Line(steps=99), {"range": 50.0}, positions=lambda env: env.places(), message=NUMBERS)
    env.reset(seed=0)
    while "eve" in env.agents:
        env.step({name: {"action": 2 if name == "eve" else 0, "message": [1.0]} for name in env.agents})
    for k in range(1, 4):
        observations = env.step({name: {"action": 0, "message": [2.0]} for name in env.agents})[0]
        assert observations["ann"]["ages"] == pytest.approx([-1.0, 0.1, 0.1 * (k + 1)])


def test_a_turn_takes_a_step_and_what_is_dead_takes_none():
    env = desim.wrap(Turns(), Links(latency=0.25), dt=0.1, message=spaces.Discrete(5, start=5))
    env.reset(seed=0)
    assert env.action_space("ann").keys() == {"move", "push", "message"}
    for turn, agent in enumerate(env.agent_iter()):
        observation, _, dead, _, info = env.last()
        assert env.observe(agent)["ages"].tolist() == observation["ages"].tolist()  # it is asked without effect
        if dead:
            assert env.network.now == pytest.approx(1.2)
            env.step(None)
            continue
        if turn == 3:  # ann spoke 0.3 s ago, and bob 0.2 s ago, which has not arrived
            assert observation["ages"] == pytest.approx([-1.0, -1.0, -1.0])
            assert env.observe("bob")["ages"] == pytest.approx([0.3, -1.0, -1.0])
            assert env.observe("bob")["messages"].tolist() == [9, 5, 5]
        action = env.action_space(agent).sample(info["action_mask"])
        env.step({**action, "message": 9})
    assert turn == 14


def test_seeds_of_reset_give_equal_episodes_and_others_differ():
    def ages(env, seed):
        return [step["ann"]["ages"].tolist() for step in talk(env, 20, seed)]

    env = desim.wrap(Line(), LINKS, message=NUMBERS)
    first = ages(env, 5)
    after = [ages(env, None), ages(env, None)]
    assert first != after[0] != after[1]
    other = desim.wrap(Line(), LINKS, message=NUMBERS, seed=5)
    assert [ages(other, None) for _ in range(3)] == [first, *after]
    assert ages(env, 6) != first == ages(env, 5)
    free = [ages(desim.wrap(Line(), LINKS, message=NUMBERS), None) for _ in range(2)]
    assert free[0] != free[1]


def test_the_order_of_a_dict_of_actions_changes_nothing():
    """What is drawn for a message depends on the messages before it, so all speak in the order of the agents."""

    def ages(names):
        env = desim.wrap(Line(), LINKS)
        env.reset(seed=7)
        heard = []
        for _ in range(7):
            acts = {name: {"action": 1, "message": np.zeros(1, np.float32)} for name in names}
            seen, *_ = env.step(acts)
            heard.append([seen[name]["ages"].tolist() for name in NAMES])
        return heard

    assert ages(NAMES) == ages(NAMES[::-1])


def test_an_episode_of_turns_begins_with_a_network_of_its_seed():
    def ages(env, seed):
        env.reset(seed=seed)
        for _ in range(30):
            env.step({"action": 0, "message": np.zeros(1, np.float32)})
        return [env.observe(name)["ages"].tolist() for name in NAMES]

    env = desim.wrap(parallel_to_aec(Line()), LINKS)
    first = ages(env, 5)
    assert ages(env, 6) != first == ages(env, 5)
    assert max(map(max, first)) < 100.0


@pytest.mark.parametrize(
    "message",
    [
        1,
        3,
        spaces.Box(1.0, 2.0, (2, 2), np.float32),
        spaces.Box(0, 255, (3,), np.uint8),
        spaces.Discrete(4),
        spaces.Discrete(4, start=-9),
        spaces.MultiDiscrete([3, 4]),
        spaces.MultiBinary(3),
        spaces.Dict({"flag": spaces.Discrete(2), "place": spaces.Box(-1.0, 1.0, (2,), np.float64)}),
        spaces.Tuple((spaces.Discrete(2), spaces.Box(-1.0, 1.0, (2,), np.float32))),
    ],
    ids=str,
)
def test_messages_are_of_any_space(message):
    env = desim.wrap(Line(), LINKS, message=message)
    observations, _ = env.reset(seed=0)
    for _ in range(5):
        for name in env.agents:
            assert observations[name] in env.observation_space(name)
        observations = env.step({name: env.action_space(name).sample() for name in env.agents})[0]


@pytest.mark.parametrize(
    ("space", "closest"),
    [
        (spaces.Discrete(3, start=-1), 0),  # left, nothing, right
        (spaces.Discrete(4, start=-9), -6),
        (spaces.Discrete(4, start=2), 2),
        (spaces.MultiDiscrete([3, 3, 3], start=[-1, -9, 2]), [0, -7, 2]),
        (spaces.MultiDiscrete([[3], [2]], start=[[-2], [-5]]), [[0], [-4]]),
        (spaces.Box(np.array([-2, -3, 1]), np.array([2, -1, 4]), dtype=np.int64), [0, -1, 1]),
        (spaces.MultiBinary(2), [0, 0]),
    ],
    ids=str,
)
def test_no_message_is_the_element_closest_to_zero(space, closest):
    element = blank(space)
    assert element in space
    assert np.array_equal(element, closest)
    assert np.array_equal(blank(spaces.Tuple((spaces.Dict({"part": space}),)))[0]["part"], closest)


def test_the_network_has_graphs_of_agents_faults_and_airtime():
    env = desim.wrap(
        Line(),
        {"medium": {"kind": "bitrate", "bitrate": 1e4}},
        graph=nx.path_graph(["ann", "eve", "bob"]),
        faults=[Crash(start=0.25, node=2)],
        size=100,
        message=NUMBERS,
    )
    observations = talk(env, 8)[-1]
    numbers = {node: k for k, node in enumerate(env.network.nodes)}
    assert observations["ann"]["ages"][1] == -1.0  # bob is no neighbour
    last = {"eve": "ann", "ann": "eve"}
    assert all(observations[name]["ages"][NAMES.index(other)] > 0.0 for name, other in last.items())
    assert env.network.counts().lost_by.keys() >= {"crash"}
    assert numbers.keys() == set(NAMES)


def test_a_conversion_of_pettingzoo_goes_over_the_wrapper():
    env = aec_to_parallel(desim.wrap(parallel_to_aec(Line()), Links(), dt=0.1 / 3))
    env.reset(seed=0)
    said = {name: {"action": 0, "message": np.zeros(1, np.float32)} for name in NAMES}
    assert set(env.step(said)[0]["ann"]) == {"observation", "messages", "ages"}


def test_a_wrapped_environment_is_copied_and_pickled_before_and_after_reset():
    env = desim.wrap(Line(), LINKS, message=NUMBERS)
    copies = [pickle.loads(pickle.dumps(env))]
    env.reset(seed=3)
    copies += [pickle.loads(pickle.dumps(env)), copy.deepcopy(env)]
    expected = repr(talk(env, 6))
    assert [repr(talk(other, 6)) for other in copies] == [expected] * 3
    env.close()


@pytest.mark.parametrize("count", [2, np.int64(2), np.array(2)], ids=repr)
def test_the_number_of_floats_of_a_message_is_an_integer_of_any_kind(count):
    assert desim.wrap(Line(), Links(), message=count).action_space("ann")["message"].shape == (2,)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"message": 0}, "message should be a gymnasium space, or a number of floats"),
        ({"message": True}, "message should be a gymnasium space, or a number of floats"),
        ({"message": "text"}, "message should be a gymnasium space"),
        ({"message": spaces.Text(5)}, "the elements of a Text have no zero"),
        ({"dt": 0.0}, "dt should be a time"),
        ({"positions": np.zeros((3, 2))}, "positions should be a function of the environment"),
        ({"positions": lambda: np.zeros((3, 2))}, r"positions should accept a call with \(env\)"),
        ({"graph": 3}, "graph should be a graph of networkx whose nodes are the agents .got 3"),
        ({"graph": [("ann", "bob")]}, "graph should be a graph of networkx"),
        ({"capacity": 0}, "capacity should be at least 1"),
        ({"capacity": "many"}, "capacity should be an integer"),
        ({"graph": nx.path_graph(3)}, "the nodes of the graph should be the agents"),
        ({"seed": -1}, "the seed should be at least 0"),
        ({"idle": 0}, "wrap takes no idle= for an environment of PettingZoo, but message, graph, capacity, dt"),
    ],
)
def test_a_wrong_option_is_refused(options, why):
    with pytest.raises((ValueError, TypeError), match=why):
        desim.wrap(Line(), Links(), **options)


def test_a_wrong_environment_action_message_or_place_is_refused():
    with pytest.raises(TypeError, match=r"wrap takes a pettingzoo\.ParallelEnv.*got builtins\.int"):
        desim.wrap(3)
    with pytest.raises(ValueError, match="has no agents"):
        desim.wrap(Line([]))
    env = Line()
    env._observations = dict.fromkeys(NAMES, spaces.Dict({"messages": spaces.Discrete(2)}))
    with pytest.raises(ValueError, match="has the key 'messages' already"):
        desim.wrap(env)
    env = desim.wrap(Line())
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"the action of 'ann' should be a dict with the keys .*\(got 0\)"):
        env.step(dict.fromkeys(NAMES, 0))
    with pytest.raises(ValueError, match="the message of 'ann' should be in Box"):
        env.step({name: {"action": 0, "message": [float("nan")]} for name in NAMES})
    for places, why in (
        ({"ann": (0.0, 0.0)}, "there is none for 1"),
        (dict.fromkeys([*NAMES, "zoe"], (0.0, 0.0)), "positions has 'zoe', which is no agent: they are"),
        (np.zeros((2, 2)), "3 rows"),
        (np.zeros((3, 3)), r"shape \(3, 2\)"),
    ):
        wrapped = desim.wrap(Line(), {"range": 5.0}, positions=lambda env, places=places: places)
        with pytest.raises(ValueError, match=why):
            wrapped.reset(seed=0)
    wrapped = desim.wrap(Line(), {"range": 5.0})
    wrapped.reset(seed=0)
    with pytest.raises(ValueError, match="depends on the positions"):
        wrapped.step({name: wrapped.action_space(name).sample() for name in NAMES})


def test_no_observation_depends_on_what_has_not_arrived():
    """Eve, out of the range of ann, says something else; the control is bob, who hears her."""

    def seen(word):
        env = desim.wrap(Line(), {"range": 5.0}, positions=lambda env: env.places(), message=NUMBERS)
        env.reset(seed=0)
        for _ in range(3):
            said = {name: {"action": 0, "message": [word if name == "eve" else 1.0]} for name in NAMES}
            observations = env.step(said)[0]
        return [repr(observations[name]) for name in ("ann", "bob")]

    (ann, bob), (same, other) = seen(2.0), seen(3.0)
    assert (ann == same, bob == other) == (True, False)


@pytest.mark.slow
def test_episodes_leave_nothing_behind():
    env = desim.wrap(Line(), LINKS, message=NUMBERS)
    sizes = []
    for _ in range(3):
        for k in range(50):
            talk(env, 2, seed=k)
        gc.collect()
        sizes.append(len(gc.get_objects()))
    assert sizes[2] - sizes[1] < 50


def test_a_place_of_an_earlier_episode_is_none_of_the_next():
    places = {"a": (0.0, 0.0), "b": (1.0, 0.0)}
    network = EnvNetwork(None, ["a", "b"], {"range": 5.0}, positions=lambda _: places)
    network.reset(1)
    del places["b"]
    network.step()  # it stays where it was
    with pytest.raises(ValueError, match="positions"):
        network.reset(2)


@pytest.mark.parametrize("world", [Line, Turns, Counter])
def test_a_reset_passes_its_seed_and_options_on(world, monkeypatch):
    begun, original = [], world.reset

    def reset(self, *, seed=None, options=None):
        begun.append((seed, options))
        return original(self, seed=seed, options=options)

    monkeypatch.setattr(world, "reset", reset)
    env = desim.wrap(world(), Links(), **{} if world is Counter else {"message": NUMBERS})
    begun.clear()
    env.reset(seed=3, options={"level": 2})
    assert begun == [(3, {"level": 2})]

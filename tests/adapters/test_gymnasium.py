"""A robot of Gymnasium that is operated over a network."""

import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env

import desim
from desim import Links, Lognormal
from tests.adapters.environments import Counter

LINKS = Links(latency=Lognormal(mean=0.1, cv=0.5), loss=0.1)


def checked(env):
    """Run the check of Gymnasium, in which a warning is an error, but for those about the environment itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for text in ("different from the unwrapped version", "infinity", "symmetric and normalized"):
            warnings.filterwarnings("ignore", f".*{text}")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize("name", ["CartPole-v1", "Pendulum-v1", "MountainCarContinuous-v0", "FrozenLake-v1"])
def test_an_environment_of_gymnasium_passes_its_check(name):
    checked(desim.wrap(gymnasium.make(name).unwrapped, LINKS))


@pytest.mark.slow_cases("Pendulum-v1")
@pytest.mark.parametrize("name", ["CartPole-v1", "Pendulum-v1", "FrozenLake-v1"])
def test_over_ideal_links_it_is_the_environment_itself(name):
    """The control has a latency."""
    plain = gymnasium.make(name)
    ideal, late = (desim.wrap(gymnasium.make(name), Links(latency=latency)) for latency in (0.0, 0.15))
    first = plain.reset(seed=4)[0]
    assert np.array_equal(ideal.reset(seed=4)[0]["observation"], first)
    late.reset(seed=4)
    plain.action_space.seed(1)
    differ = []
    for _ in range(200):
        action = plain.action_space.sample()
        observation, reward, *ends, _ = plain.step(action)
        got, *rest, _ = ideal.step(action)
        assert np.array_equal(got["observation"], observation)
        assert rest == [reward, *ends]
        assert (got["age"], got["command_age"]) == ([0.0], [0.0])
        seen, _, *late_ends, _ = late.step(action)
        differ.append(not np.array_equal(seen["observation"], observation))
        if any(ends) or any(late_ends):
            break
    assert any(differ)


@pytest.mark.parametrize(("latency", "steps"), [(0.0, 0), (0.1, 1), (0.15, 2), (0.2, 2)])
def test_commands_and_observations_are_late_by_the_latency(latency, steps):
    """The robot adds its commands: a command shows in an observation 2 k steps later."""
    env = desim.wrap(Counter(), Links(latency=latency), idle=np.ones(1, np.float32))
    observations = [env.reset(seed=0)[0], *(env.step(np.array([0.1 * k], np.float32))[0] for k in range(10))]
    done = [0.0]  # the sum after each step of the robot
    for k in range(10):
        done.append(done[-1] + (1.0 if k < steps else float(np.float32(0.1 * (k - steps)))))
    for k, got in enumerate(observations):
        made = max(k - steps, 0)
        assert got["observation"].tolist() == [made, done[made]]
        assert got["age"] == pytest.approx([0.1 * (k - made)])
        assert got["command_age"] == pytest.approx([0.1 * steps if made > steps else -1.0])
        assert got in env.observation_space


def test_a_robot_that_is_never_reached_idles():
    env = desim.wrap(Counter(), Links(loss=1.0))
    first, _ = env.reset(seed=0)
    for k in range(5):
        got = env.step(np.ones(1, np.float32))[0]
        assert got["observation"].tolist() == first["observation"].tolist() == [0.0, 0.0]
        assert got["age"] == pytest.approx([0.1 * (k + 1)])
    assert env.unwrapped.state.tolist() == [5.0, 0.0]


def test_a_robot_out_of_range_goes_on_with_its_last_command():
    """From the third step on it is away, and adds 1 each step, although it is told -1."""
    env = desim.wrap(Counter(), {"range": 5.0}, positions=lambda env: [(env.unwrapped.state[0] * 2.0, 0.0), (0.0, 0.0)])
    env.reset(seed=0)
    for k in range(6):
        got = env.step(np.full(1, 1.0 if k < 3 else -1.0, np.float32))[0]
    assert env.unwrapped.state.tolist() == [6.0, 6.0]
    assert got["observation"].tolist() == [2.0, 2.0]


def test_a_channel_on_which_robot_and_operator_are_deaf_to_each_other_is_warned_of():
    links = {"medium": {"kind": "bitrate", "bitrate": 1e5, "access": "csma_ca"}}
    with pytest.warns(UserWarning, match="100 % of their frames overlap on this channel"):
        env = desim.wrap(Counter(), links)
    env.reset(seed=0)
    assert [env.step(np.ones(1, np.float32))[0]["age"].item() for _ in range(3)] == pytest.approx([0.1, 0.2, 0.3])


def test_a_robot_behind_a_wall_is_never_reached():
    places = {"positions": lambda _: [(0.0, 0.0), (4.0, 0.0)], "walls": [{"line": [[2.0, -1.0], [2.0, 1.0]]}]}
    env = desim.wrap(Counter(), {"range": 50.0}, **places)
    env.reset(seed=0)
    assert env.step(np.ones(1, np.float32))[0]["command_age"].tolist() == [-1.0]


def test_what_a_learner_does_to_an_observation_changes_no_other():
    env = desim.wrap(Counter(), Links(loss=1.0))
    env.reset(seed=0)[0]["observation"] += 7.0
    assert env.step(np.ones(1, np.float32))[0]["observation"].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("links", [Links(latency=1.0), Links(loss=0.7)])
def test_what_a_world_does_to_a_command_changes_no_other(links):
    """A world may scale an action in place: it idles by 1, and acts by -1 once a command has arrived."""

    class Scaling(Counter):
        def step(self, action):
            acted.append(action.item())
            action *= 0.5
            return super().step(action)

    acted = []
    env = desim.wrap(Scaling(), links, idle=np.ones(1, np.float32))
    for _ in range(2):
        env.reset(seed=1)
        for _ in range(8):
            env.step(np.full(1, -1.0, np.float32))
    assert {*acted} <= {1.0, -1.0}
    assert (-1.0 in acted) == (links.latency == Links().latency)


def test_equal_seeds_give_equal_episodes_and_copies():
    def ages(env, seed):
        env.reset(seed=seed)
        return [float(env.step(np.ones(1, np.float32))[0]["age"][0]) for _ in range(30)]

    env = desim.wrap(Counter(), LINKS)
    copied = pickle.loads(pickle.dumps(env))
    assert ages(env, 3) == ages(copied, 3) != ages(env, 4)
    assert ages(env, None) != ages(env, None)


def test_a_wrong_option_is_refused():
    with pytest.raises(ValueError, match="idle should be an action in Box"):
        desim.wrap(Counter(), idle=np.full(1, 9.0, np.float32))
    env = Counter()
    env.action_space = spaces.Text(3)
    with pytest.raises(ValueError, match="the elements of a Text have no zero"):
        desim.wrap(env)
    with pytest.raises(ValueError, match="dt should be"):
        desim.wrap(Counter(), dt=-1.0)
    with pytest.raises(TypeError, match="wrap takes no message= for an environment of Gymnasium, but idle, dt"):
        desim.wrap(Counter(), message=1)
    env = desim.wrap(Counter())
    env.reset(seed=0)
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.step(np.ones(1, np.float32))

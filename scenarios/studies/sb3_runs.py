"""A training with Stable-Baselines3: the pursuers of one team are environments of a vector, and share one policy."""

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

import desim
from desim.learning.environments import ParallelPursuit
from protocols.policy import Policy
from scenarios.studies.library_runs import LATELY, Progress, exported, game, minus_cost


class TeamVecEnv(VecEnv):
    """The N pursuers of a parallel environment as N environments, which begin and end together.

    `MaskablePPO` asks for `action_masks` before each step, so a pursuer never draws an action that it may not take.

    Args:
        env: the environment of the team.
        seed: the seed of the first episode; the next ones follow from it.
        features: the names of the n numbers of an observation that the policy gets.

    Attributes:
        costs: the costs of the last episodes; the reward of each pursuer is minus the cost of a step.
    """

    def __init__(self, env: ParallelPursuit, seed: int, features: Sequence[str]):
        self.env, self._first_seed, self._cost = env, seed, 0.0
        self.costs: deque[float] = deque(maxlen=LATELY)
        self._columns = [env.observation_names.index(name) for name in features]
        bounds: Any = env.observation_space(env.possible_agents[0])
        space = Box(bounds.low[self._columns], bounds.high[self._columns])
        super().__init__(len(env.possible_agents), space, env.action_space(env.possible_agents[0]))

    def reset(self) -> NDArray[np.float32]:
        """Begin an episode, and return the (N, n) observations."""
        observations, self._infos = self.env.reset(seed=self._first_seed)
        return self._stacked(observations)

    def step_async(self, actions: Iterable[Any]) -> None:
        """Take the (N,) actions of the next step."""
        self._actions = dict(zip(self.env.possible_agents, actions, strict=True))

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Let all act; if the episode ends, the observations are the first ones of the next, as SB3 expects."""
        observations, rewards, terminations, truncations, self._infos = self.env.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in observations]
        self._cost -= next(iter(rewards.values()))
        if not self.env.agents:
            self.costs.append(self._cost)
            self._cost = 0.0
            for info, (name, observation) in zip(infos, observations.items(), strict=True):
                info |= {"terminal_observation": observation[self._columns], "TimeLimit.truncated": truncations[name]}
            observations, self._infos = self.env.reset()
        dones = [terminations[name] or truncations[name] for name in rewards]
        return self._stacked(observations), np.array([*rewards.values()], np.float32), np.array(dones), infos

    def _stacked(self, observations: dict[str, Any]) -> NDArray[np.float32]:
        return np.stack([observations[name][self._columns] for name in self.env.possible_agents])

    def close(self) -> None:
        """End the episode."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, the same for all pursuers."""
        value = self.action_masks if attr_name == "action_masks" else getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environment."""
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Return the masks of pursuers; Stable-Baselines3 calls no other method."""
        if method_name != "action_masks":
            raise AttributeError(f"a team has no method {method_name!r}")
        masks = self.action_masks()
        return [masks[k] for k in self._get_indices(indices)]

    def action_masks(self) -> NDArray[np.int8]:
        """Return the (N, M + 1) masks of the actions now."""
        return np.stack([self._infos[name]["action_mask"] for name in self.env.possible_agents])

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for each pursuer: none has wrappers of its own."""
        return [False for _ in self._get_indices(indices)]


class Curve(BaseCallback):
    """Keep the progress of a training, once before each update of the policy."""

    def __init__(self, costs: deque[float]):
        super().__init__()
        self._costs = costs
        self.progress: list[Progress] = []

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self.progress.append(Progress(self.num_timesteps, float(np.mean(self._costs))))


def train(seed: int, steps: int) -> tuple[Policy, Sequence[Progress]]:
    """Return the protocol that MaskablePPO learns, and its progress.

    Args:
        seed: the seed of the training; the episodes have the seeds of the runs of the root seed `seed + 1`.
        steps: the number of steps of pursuers.
    """
    torch.set_num_threads(1)
    team = desim.parallel_env(game(), reward=minus_cost)
    features = [name for name in team.observation_names if name.startswith(("own.", "evader_"))]
    pursuers = TeamVecEnv(team, seed + 1, features)
    envs = VecNormalize(pursuers, gamma=0.99, epsilon=1e-2, clip_obs=100.0)
    network = {"net_arch": [32, 32], "activation_fn": torch.nn.Tanh}
    model = MaskablePPO(
        "MlpPolicy",
        envs,
        learning_rate=lambda remaining: 1e-3 * remaining,
        n_steps=1024,
        batch_size=512,
        ent_coef=0.001,
        seed=seed,
        device="cpu",
        policy_kwargs=network,
    )
    curve = Curve(pursuers.costs)
    model.learn(steps, callback=curve)
    linear = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    layers = [(m.weight.detach().numpy(), m.bias.detach().numpy()) for m in linear if isinstance(m, torch.nn.Linear)]
    of_inputs = envs.obs_rms  # their running mean and variance
    return exported(features, layers, of_inputs.mean, np.sqrt(of_inputs.var + envs.epsilon)), curve.progress

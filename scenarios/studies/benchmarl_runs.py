"""A training with BenchMARL, which takes the environment through the `PettingZooWrapper` of TorchRL."""

from collections import deque
from collections.abc import Callable, Sequence
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import Any

import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.environments.pettingzoo.common import PettingZooClass
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torchrl.envs import EnvBase, ObservationNorm, PettingZooWrapper, Transform

import desim
from protocols.policy import Policy
from scenarios.studies.library_runs import LATELY, Progress, exported, game, minus_cost

GROUP = "pursuer"
"""The group that TorchRL makes of agents whose names begin alike."""
OBSERVATION, STATE = (GROUP, "observation"), "state"
Normal = tuple[torch.Tensor, torch.Tensor]
"""The mean and the deviation of numbers."""


class Relay(PettingZooClass):
    """The game as a task of BenchMARL."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Return the function that makes an environment."""
        return lambda: PettingZooWrapper(
            desim.parallel_env(game(), seed, reward=minus_cost),
            return_state=True,
            categorical_actions=True,
            device=device,
        )

    def supports_continuous_actions(self) -> bool:
        """Return False: actions are the numbers of evaders."""
        return False

    def supports_discrete_actions(self) -> bool:
        """Return True."""
        return True

    def has_state(self) -> bool:
        """Return True: the critic, which is needed in training only, sees the true state."""
        return True

    def max_steps(self, env: EnvBase) -> int:
        """Return the greatest number of rounds of an episode."""
        return int(self.config["rounds"])

    def get_env_transforms(self, env: EnvBase) -> list[Transform]:
        """Return the transforms that normalise observations and states."""
        return [
            ObservationNorm(*self.config[key], in_keys=[key], out_keys=[key], standard_normal=True)
            for key in (OBSERVATION, STATE)
        ]


class Curve(Callback):
    """Keep the progress of a training, once before each update of the policy."""

    def __init__(self) -> None:
        super().__init__()
        self.progress: list[Progress] = []
        self._returns: deque[float] = deque(maxlen=8 * LATELY)  # of each pursuer

    def on_batch_collected(self, batch: Any) -> None:
        """Keep the mean cost of the episodes that ended in a batch."""
        is_over = batch.get(("next", GROUP, "done"))
        self._returns.extend(batch.get(("next", GROUP, "episode_reward"))[is_over].tolist())
        steps = self.experiment.total_frames * is_over.shape[-2]
        self.progress.append(Progress(steps, -fmean(self._returns)))


def normal_of(numbers: torch.Tensor) -> Normal:
    """Return the mean and the deviation of each number of the last dimension; constants have a deviation of 0.1."""
    rows = numbers.reshape(-1, numbers.shape[-1])
    return rows.mean(0), (rows.var(0) + 1e-2).sqrt()


def train(seed: int, steps: int) -> tuple[Policy, Sequence[Progress]]:
    """Return the protocol that MAPPO learns, and its progress.

    Args:
        seed: the seed of the training.
        steps: the number of steps of pursuers.
    """
    torch.set_num_threads(1)
    torch.manual_seed(seed)  # for the random actions before the normalisation; the experiment sets its own seed
    with TemporaryDirectory() as folder:
        task = Relay("relay", {"rounds": 100})
        plain = task.get_env_fun(1, False, seed + 1, "cpu")()
        steps_played = torch.cat([plain.rollout(100) for _ in range(20)])
        task.config |= {key: normal_of(steps_played[key]) for key in (OBSERVATION, STATE)}
        count = len(plain.possible_agents)
        config = ExperimentConfig.get_from_yaml()
        config.loggers, config.create_json, config.evaluation, config.save_folder = [], False, False, folder
        config.lr, config.gamma = 1e-3, 0.99
        config.on_policy_n_envs_per_worker, config.on_policy_collected_frames_per_batch = 4, 512
        config.on_policy_minibatch_size, config.on_policy_n_minibatch_iters = 128, 8
        config.max_n_frames = -(-steps // count)
        algorithm = MappoConfig.get_from_yaml()
        algorithm.entropy_coef, algorithm.lmbda = 0.002, 0.95
        model = MlpConfig(num_cells=[32, 32], layer_class=torch.nn.Linear, activation_class=torch.nn.Tanh)
        curve = Curve()
        experiment = Experiment(task, algorithm, model, seed, config, callbacks=[curve])
        experiment.run()
    weights = [p.detach().squeeze(0).numpy() for p in experiment.group_policies[GROUP].parameters()]
    layers = list(zip(weights[::2], weights[1::2], strict=True))
    mean, deviation = task.config[OBSERVATION]
    rule = exported(plain.observation_names, layers, mean.numpy(), deviation.numpy())
    return rule, curve.progress

"""An environment of Gymnasium whose robot is operated over a network; see `desim.wrap`.

The environment is the robot, node 0, and its world. The learner, which chooses the actions, is its operator, node 1. In
each step the operator transmits its action as a command, the robot acts by the newest command that it has received, and
it transmits its new observation back. With a constant latency of d steps each way, the operator observes the effect of
an action 2 d steps later, with d rounded up. Under ideal links the episodes are those of the environment itself.

An observation becomes a dict:

- `observation`: the newest observation that the operator has received;
- `age`: (1,) the time since it was made, s;
- `command_age`: (1,) the age, s, of the command that the robot executed right before this observation; -1 if none.

The first observation of an episode is known to the operator. Reward and end of an episode are those of the environment,
without delay, because they judge the operator and are not sent to it.
"""

from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from desim.adapters.env_network import EnvNetwork
from desim.adapters.message_spaces import UNHEARD, blank
from desim.config.arguments import value_text
from desim.kernel.stepped_network import SteppedNetwork

ROBOT, OPERATOR = "robot", "operator"


class RemoteControl(gymnasium.Wrapper[dict[str, Any], Any, Any, Any], RecordConstructorArgs):
    """A Gymnasium environment whose actions and observations travel over a network.

    Args:
        env: the environment.
        links: as in `SteppedNetwork`.
        idle: the action of the robot until the first command has arrived; zeros if None.
        size: bytes of a message; computed from its content if None.
        **options: as in `desim.adapters.env_network.EnvNetwork`.

    Raises:
        ValueError: if an argument is not valid.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        links: Any = None,
        *,
        idle: Any = None,
        size: int | None = None,
        **options: Any,
    ):
        RecordConstructorArgs.__init__(self, links=links, idle=idle, size=size, **options)  # for `env.spec`
        gymnasium.Wrapper.__init__(self, env)
        self._env_network = EnvNetwork(env, (ROBOT, OPERATOR), links, **options)
        self._size, self._idle = size, blank(env.action_space) if idle is None else idle
        if self._idle not in env.action_space:
            raise ValueError(f"idle should be an action in {env.action_space} (got {value_text(idle)})")
        age = spaces.Box(UNHEARD, np.inf, (1,), np.float64)
        self.observation_space = spaces.Dict({"observation": env.observation_space, "age": age, "command_age": age})

    @property
    def network(self) -> SteppedNetwork:
        """The network of this episode."""
        return self._env_network.network

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """Begin an episode; see `gymnasium.Env.reset`."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._env_network.reset(seed)
        self._received = (deepcopy(observation), 0.0, UNHEARD)  # a world may change its observation in place
        return self._observed(), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Transmit a command, let the robot act, and return what the operator knows; see `gymnasium.Env.step`."""
        network, robot, operator = self.network, self._env_network.node(ROBOT), self._env_network.node(OPERATOR)
        network.publish(operator, action, size=self._size)
        command = network.latest(robot).get(operator)
        age = UNHEARD if command is None else network.now - command.sent
        observation, *rest = self.env.step(deepcopy(self._idle) if command is None else command.body)
        self._env_network.step()
        network.publish(robot, (observation, network.now, age), size=self._size)
        if (received := network.latest(operator).get(robot)) is not None:
            self._received = received.body
        return self._observed(), *rest  # type: ignore[return-value]  # the type of `rest` does not say its length

    def close(self) -> None:
        """Close the environment and the network."""
        self.env.close()
        self.network.close()

    def _observed(self) -> dict[str, Any]:
        observation, made_at, command_age = self._received
        return {
            "observation": deepcopy(observation),  # a learner may normalise it in place
            "age": np.array([self.network.now - made_at]),
            "command_age": np.array([command_age]),
        }

"""The messages of the agents of an environment: their spaces, and the network that carries them.

An action gains the key `message`, which the agent broadcasts as it acts. An observation gains two keys, with a row for
each of `possible_agents`, or for each agent that appears, in their order:

- `messages`: the newest message that has arrived from each agent;
- `ages`: (n,) the time since it was said, s.

An agent from which nothing has arrived, and the agent itself, have a blank message and the age -1. An action or an
observation that is a dict keeps its keys, so an `action_mask` stays where learners look for it; any other becomes the
key `action` or `observation`. A message of None is not sent.
"""

from collections.abc import Hashable
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array

from desim.adapters.env_network import EnvNetwork
from desim.adapters.message_spaces import UNHEARD, ActionSpace, blank, with_entries
from desim.config.arguments import value_text
from desim.config.arrays import array_of
from desim.config.python_numbers import as_python


class AgentMessages(EnvNetwork):
    """The network of some agents, and their messages as parts of actions and observations.

    Args:
        env: the environment; it has `possible_agents`, `action_space` and `observation_space`.
        links: as in `SteppedNetwork`.
        message: the space of a message, or a number of floats in [-1, 1].
        size: bytes of a message; computed from its content if None.
        **options: as in `EnvNetwork`.

    Raises:
        ValueError: if an argument is not valid, or the environment does not name its agents in advance.
    """

    def __init__(self, env: Any, links: Any, *, message: Any = 1, size: int | None = None, **options: Any):
        agents: list[Hashable] | None = getattr(env, "possible_agents", None)
        if agents is not None and not agents:
            raise ValueError(f"{env} has no agents: its possible_agents are empty")
        super().__init__(env, agents, links, **options)
        number = message if isinstance(message, spaces.Space) else as_python(message)
        if type(number) is int and number > 0:
            message = spaces.Box(-1.0, 1.0, (number,), np.float32)
        if not isinstance(message, spaces.Space):
            raise ValueError(
                f"message should be a gymnasium space, or a number of floats from 1 on (got {value_text(message)})"
            )
        self._message, self._blank, self._size = message, blank(message), size
        ages = spaces.Box(UNHEARD, np.inf, (self.size,), np.float64)
        self._entries = {"messages": batch_space(message, self.size), "ages": ages}
        self._spaces: dict[Any, tuple[ActionSpace, spaces.Dict]] = {}
        for agent in self.row:
            self.spaces_of(agent)

    def spaces_of(self, agent: Hashable) -> tuple[ActionSpace, spaces.Dict]:
        """Return the spaces of the actions and of the observations of an agent, the same objects at each call."""
        if agent not in self._spaces:
            action = ActionSpace(self._env.action_space(agent), self._message)
            observation = with_entries(self._env.observation_space(agent), "observation", self._entries)
            self._spaces[agent] = action, spaces.Dict(observation)
        return self._spaces[agent]

    def reset(self, seed: int | None) -> None:
        """Begin an episode; see `EnvNetwork.reset`."""
        if self._is_open:  # other agents may appear in this episode
            self._spaces.clear()
        super().reset(seed)

    def split(self, agent: Hashable, action: Any) -> tuple[Any, Any]:
        """Return the action of an agent without its message, and the message; None: it says nothing.

        Raises:
            ValueError: if the action has no message, or one that is not in its space.
        """
        space = self.spaces_of(agent)[0]
        if not isinstance(action, dict) or action.keys() != set(space):
            raise ValueError(
                f"the action of {value_text(agent)} should be a dict with the keys {list(space)} (got"
                f" {value_text(action)})"
            )
        entries = {key: value for key, value in action.items() if key != "message"}
        body = message = action["message"]
        if message is not None:
            body = _in_box(message, self._message.dtype) if isinstance(self._message, spaces.Box) else message
            if body is None or body not in self._message:
                raise ValueError(
                    f"the message of {value_text(agent)} should be in {self._message} (got {value_text(message)})"
                )
        return entries if space.keeps_keys else entries["action"], body

    def say(self, agent: Hashable, message: Any) -> None:
        """Broadcast the message of an agent; None: nothing."""
        if message is not None:
            self.network.publish(self.node(agent), message, size=self._size)

    def hear(self, agent: Hashable, observation: Any) -> Any:
        """Return an observation with the newest message of each agent and its age."""
        messages, ages = [self._blank] * self.size, np.full(self.size, UNHEARD)
        for node, received in self.network.latest(self.node(agent)).items():
            row = self.row[node] if self._has_graph else node
            messages[row], ages[row] = received.body, self.network.now - received.sent
        batch: Any = create_empty_array(self._message, len(messages))
        batch = concatenate(self._message, messages, batch)
        return with_entries(observation, "observation", {"messages": batch, "ages": ages})


def _in_box(message: Any, dtype: Any) -> Any:
    """Return a message as an array of the type of a Box; None if its numbers do not fit, as 0.5 in one of integers."""
    numbers = array_of(message)
    if numbers.dtype.kind not in "biuf":
        return None
    converted = numbers.astype(dtype)
    return converted if converted.dtype.kind == "f" or np.array_equal(converted, numbers) else None

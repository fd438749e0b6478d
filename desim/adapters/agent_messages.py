"""What agents of an environment say and hear: the spaces of their messages, and the network that carries them.

An action gains the key `message`, which the agent broadcasts as it acts. An observation gains two keys, with a row for
each of `possible_agents`:

- `messages`: the newest message that has arrived from each agent;
- `ages`: (n,) the time since it was said, s.

An agent from which nothing has arrived, and the agent itself, have a blank message and the age -1. An action or an
observation that is a dict keeps its keys, so an `action_mask` stays where learners look for it; any other becomes the
key `action` or `observation`. A message None says nothing.
"""

from collections.abc import Hashable
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array

from desim.adapters.env_network import EnvNetwork
from desim.adapters.message_spaces import UNHEARD, ActionSpace, blank, joined


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
        if not agents:
            raise ValueError(f"{env} has no possible_agents: a network has a node for each agent that may appear")
        super().__init__(env, agents, links, **options)
        if type(message) is int and message > 0:
            message = spaces.Box(-1.0, 1.0, (message,), np.float32)
        if not isinstance(message, spaces.Space):
            raise ValueError(f"message should be a gymnasium space, or a number of floats from 1 on (got {message!r})")
        self._message, self._blank, self._size, count = message, blank(message), size, len(agents)
        ages = spaces.Box(UNHEARD, np.inf, (count,), np.float64)
        heard = {"messages": batch_space(message, count), "ages": ages}
        self.observation_spaces = {
            agent: spaces.Dict(joined(env.observation_space(agent), "observation", heard)) for agent in agents
        }
        self.action_spaces = {
            agent: ActionSpace(joined(env.action_space(agent), "action", {"message": message})) for agent in agents
        }

    def say(self, agent: Hashable, action: Any) -> Any:
        """Broadcast the message of an agent's action, and return the action without it.

        Raises:
            ValueError: if the action has no message, or one that is not in its space.
        """
        keys = self.action_spaces[agent].keys()
        if not isinstance(action, dict) or action.keys() != set(keys):
            raise ValueError(f"the action of {agent!r} should be a dict with the keys {list(keys)} (got {action!r})")
        rest = {key: value for key, value in action.items() if key != "message"}
        if (message := action["message"]) is not None:
            if isinstance(self._message, spaces.Box):
                message = np.asarray(message, self._message.dtype)
            if message not in self._message:
                raise ValueError(f"the message of {agent!r} should be in {self._message} (got {message!r})")
            self.network.publish(self.node[agent], message, size=self._size)
        return rest["action"] if rest.keys() == {"action"} else rest

    def hear(self, agent: Hashable, observation: Any) -> Any:
        """Return an observation with what the agent has heard."""
        latest = self.network.latest(self.node[agent])
        messages, ages = [self._blank] * len(self._agents), np.full(len(self._agents), UNHEARD)
        for row, other in enumerate(self._agents):
            if (received := latest.get(self.node[other])) is not None:
                messages[row], ages[row] = received.body, self.network.now - received.sent
        rows: Any = create_empty_array(self._message, len(messages))
        return joined(
            observation, "observation", {"messages": concatenate(self._message, messages, rows), "ages": ages}
        )

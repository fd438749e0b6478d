"""Environments of PettingZoo whose agents talk over a network; see `desim.wrap`."""

from collections.abc import Hashable
from typing import Any, ClassVar

from gymnasium.spaces import Space
from pettingzoo.utils.wrappers import BaseParallelWrapper, BaseWrapper

from desim.adapters.agent_messages import AgentMessages
from desim.kernel.stepped_network import SteppedNetwork


class _Talking:
    """The common part of both wrappers: the network, and spaces with messages."""

    env: Any
    _at_once: ClassVar[bool]
    """Whether all agents speak at the same instant of a step."""

    def __init__(self, env: Any, links: Any = None, **options: Any):
        super().__init__(env)  # type: ignore[call-arg]  # this is the wrapper of PettingZoo
        self._messages = AgentMessages(env, links, at_once=self._at_once, **options)

    @property
    def network(self) -> SteppedNetwork:
        """The network of this episode."""
        return self._messages.network

    @property
    def rows(self) -> dict[Any, int]:
        """The row of each agent in the arrays of messages and of ages in an observation."""
        return self._messages.row.copy()

    def action_space(self, agent: Hashable) -> Space[Any]:
        """Return the space of the actions of an agent, with a message."""
        return self._messages.spaces_of(agent)[0]

    def observation_space(self, agent: Hashable) -> Space[Any]:
        """Return the space of the observations of an agent, with messages and their ages."""
        return self._messages.spaces_of(agent)[1]

    def close(self) -> None:
        """Close the environment and the network."""
        self.env.close()
        self.network.close()


class ParallelMessages(_Talking, BaseParallelWrapper):  # type: ignore[misc]  # it has no types
    """A ParallelEnv whose agents talk over a network.

    In each step all agents speak as they act, the environment steps, the network carries the messages for `dt` seconds,
    and the observations contain the messages that have arrived by then.

    Args:
        env: the environment.
        links: as in `SteppedNetwork`.
        **options: as in `desim.adapters.agent_messages.AgentMessages`.
    """

    _at_once = True

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """Begin an episode; see `pettingzoo.ParallelEnv.reset`."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._messages.reset(seed)
        return self._heard(observations), infos

    def step(self, actions: dict[Any, Any]) -> tuple[Any, ...]:
        """Let all agents speak and act; see `pettingzoo.ParallelEnv.step`."""
        parts = {agent: self._messages.split(agent, action) for agent, action in actions.items()}
        # Nothing is sent before all actions are checked. The order is that of the agents, and not of the dict, because
        # the random numbers of a message depend on the messages before it.
        for agent in dict.fromkeys([*self.env.agents, *parts]):
            if agent in parts:
                self._messages.say(agent, parts[agent][1])
        observations, *rest = self.env.step({agent: action for agent, (action, _) in parts.items()})
        self._messages.step()
        return self._heard(observations), *rest

    def _heard(self, observations: dict[Any, Any]) -> dict[Any, Any]:
        return {agent: self._messages.hear(agent, observation) for agent, observation in observations.items()}


class TurnMessages(_Talking, BaseWrapper):  # type: ignore[misc]  # it has no types
    """An AECEnv whose agents talk over a network.

    In its turn an agent speaks as it acts, the environment steps, and the network carries messages for `dt` seconds. An
    observation contains the messages that have arrived when it is read. The step of a dead agent takes no time.

    Args:
        env: the environment.
        links: as in `SteppedNetwork`.
        **options: as in `desim.adapters.agent_messages.AgentMessages`.
    """

    _at_once = False

    def observe(self, agent: Hashable) -> Any:
        """Return the observation of an agent now, with what it has heard."""
        observation = self.env.observe(agent)
        return None if observation is None else self._messages.hear(agent, observation)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Begin an episode; see `pettingzoo.AECEnv.reset`."""
        self.env.reset(seed=seed, options=options)
        self._messages.reset(seed)

    def step(self, action: Any) -> None:
        """Let the agent whose turn it is speak and act; see `pettingzoo.AECEnv.step`."""
        if action is None:  # of a dead agent
            self.env.step(None)
        else:
            agent = self.env.agent_selection
            env_action, message = self._messages.split(agent, action)
            self._messages.say(agent, message)
            self.env.step(env_action)
            self._messages.step()

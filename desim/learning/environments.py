"""The environments: a run as a game for learners, with the interface of PettingZoo (the extra `rl`).

`AECPursuit` asks one pursuer at a time, in the order of any schedule. `ParallelPursuit` asks all in rounds.
"""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.env_registry.registration import aec_registry, parallel_registry, register
from pettingzoo.utils.env import AECIterable

from desim.learning.episode import rule_of, with_protocol
from desim.learning.pursuit import NO_EPISODE, RENDER_MODES, Pursuit
from desim.pursuit.team.agent import Agent
from desim.scenario.scenario import Scenario
from protocols.schedules.periodic import Rounds

NAME = "desim_pursuit_v0"
ENTRY = "desim.learning.make"
ID = "desim/pursuit-v0"
"""The name in the registries of PettingZoo."""


class _SetByReset:
    """An attribute that `reset` sets; before, it is missing, and the error says why."""

    def __get__(self, env: Any, kind: type | None = None) -> Any:
        raise AttributeError(NO_EPISODE)


class AECPursuit(Pursuit, AECEnv[str, Any, Any]):
    """One pursuer at a time decides, at the instants of its schedule: `agent_selection` is the next one.

    A pursuer that has no choice is not asked if the rule of the scenario does not ask it. If no pursuer is ever asked,
    the first one gets a turn without effect, because only a step can tell that the episode is over.
    """

    metadata: ClassVar = {"name": NAME, "render_modes": list(RENDER_MODES), "is_parallelizable": False}

    agent_selection: Any = _SetByReset()
    rewards: Any = _SetByReset()
    terminations: Any = _SetByReset()
    truncations: Any = _SetByReset()
    infos: Any = _SetByReset()

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Begin an episode; with a seed, that of `desim run -s SEED`. `options` has no effect."""
        self._begin(seed)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self.infos = {name: {} for name in self.agents}
        self._skip_agent_selection: str | None = None
        self._turns = dict.fromkeys(self.agents, 0)
        self.agent_selection = self.agents[0]
        if self._running.turn is not None:  # otherwise no pursuer ever decides, and the first step ends the episode
            self._select()
        self.infos |= self._infos()

    def step(self, action: Any) -> None:
        """Let the selected pursuer take an action, or None if its episode is over; continue to the next turn.

        An action that its mask excludes has the effect of 0, as it has in a run.

        Raises:
            ValueError: if there is no such action.
            RuntimeError: if the episode is over, its run has failed, or another thread began it.
        """
        episode = self._ready()
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        number = self._checked(agent, action)
        self._cumulative_rewards[agent] = 0.0
        start, profile = self._step_start(), [*self._world.profile]
        self._turns[agent] += 1
        if (me := episode.turn) is not None:
            profile[me.id] = effect_of(number, me)
            episode.act(number)
        self._select()
        self.rewards = dict.fromkeys(self.agents, 0.0)
        for i, reward in self._rewards(start, profile).items():
            name = self.possible_agents[i]
            if name in self.rewards:
                self.rewards[name] = reward
                self._cumulative_rewards[name] += reward
        if self._agents_leave or episode.turn is None:  # otherwise no agent is dead
            self._deads_step_first()

    def agent_iter(self, max_iter: int = 2**63) -> AECIterable[str, Any, Any]:
        """Return the iterator over the turns: `agent_selection` again and again, until the episode is over.

        Raises:
            RuntimeError: if there is no episode; without `reset`, there would be no turn.
        """
        _ = self._running  # raises the error
        return super().agent_iter(max_iter)

    def _select(self) -> None:
        """Go on to the next turn of a pursuer that is in the episode, or to the end.

        A pursuer that has left, or has had all its turns, keeps its action.
        """
        episode = self._running
        for name in self._leavers():
            self.terminations[name] = True
        while episode.turn is not None:
            agent = self.possible_agents[episode.turn.id]
            is_present = not self.terminations.get(agent, True)  # an agent that left in an earlier turn is missing
            if is_present and not self._is_spent(agent):
                self.agent_selection, self.infos[agent] = agent, self._info(episode.turn)
                return
            if all(self.terminations[name] or self._is_spent(name) for name in self.agents):
                episode.close()
                self.truncations |= {name: not self.terminations[name] for name in self.agents}
                break
            episode.act(episode.turn.action)
        else:  # the run has ended
            self.terminations |= dict.fromkeys(self.agents, True)
        self.infos |= self._infos()

    def _is_spent(self, agent: str) -> bool:
        """Return whether a pursuer has had all its turns."""
        return self.max_cycles is not None and self._turns[agent] >= self.max_cycles


class ParallelPursuit(Pursuit, ParallelEnv[str, Any, Any]):
    """All pursuers decide at the same instants: at the rounds of the schedule of the scenario.

    The schedule is `rounds` with all pursuers in each round, unless all decide at once in the schedule of the scenario.
    """

    metadata: ClassVar = {"name": NAME, "render_modes": list(RENDER_MODES)}

    def __init__(self, scenario: Scenario, seed: int | None, **options: Any):
        super().__init__(in_rounds(scenario), seed, **options)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Begin an episode, and return the observations and infos at the first round.

        With a seed the episode is that of `desim run -s SEED`. `options` has no effect.
        """
        self._begin(seed)
        self._rounds = 0
        return self._observations_and_infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Let all pursuers take their actions, and continue to the next round.

        An action has the effect of 0 if its mask excludes it, or its pursuer is down.

        Returns:
            The observations, rewards, terminations, truncations and infos of the agents of this step.

        Raises:
            KeyError: if there is no such agent.
            TypeError: if the actions are no dict.
            ValueError: if an agent has no action, or one that does not exist.
            RuntimeError: if the episode is over, its run has failed, or another thread began it.
        """
        self._ready()
        if not isinstance(actions, Mapping):
            raise TypeError(f"a step takes a dict of the actions of all agents, not a {type(actions).__name__}")
        for name in actions:
            self._checked_name(name)  # an agent that has left may have an action, which is ignored
        if missing := [name for name in self.agents if name not in actions]:
            raise ValueError(f"{missing[0]} has no action: a step takes the actions of all agents")
        action_of = {self._number_of(name): self._checked(name, actions[name]) for name in self.agents}
        return self.step_by(lambda me: action_of[me.id])

    def step_by(
        self, choose: Callable[[Agent], int]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Let a function choose the action of each pursuer whose turn is in this round; see `step`.

        The function is called at the turn. A pursuer that has left the episode keeps its action.
        """
        episode = self._ready()
        self._rounds += 1
        start, profile = self._step_start(), [*self._world.profile]
        while episode.turn is not None and self._world.now == start.now:
            me = episode.turn
            action = choose(me) if self.possible_agents[me.id] in self.agents else me.action
            profile[me.id] = effect_of(action, me)
            episode.act(action)
        is_truncated = episode.turn is not None and self.max_cycles is not None and self._rounds >= self.max_cycles
        if is_truncated:
            episode.close()
        rewards = self._rewards(start, profile)
        is_over, leavers = episode.turn is None and not is_truncated, self._leavers()
        observations, infos = self._observations_and_infos()
        present = self.agents
        terminations = {name: is_over or name in leavers for name in present}
        truncations = {name: is_truncated and not terminations[name] for name in present}
        self.agents = [name for name in present if not (terminations[name] or truncations[name])]
        return (
            observations,
            {name: rewards.get(self._number_of(name), 0.0) for name in present},
            terminations,
            truncations,
            infos,
        )

    def _observations_and_infos(self) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Return the observations and infos of all agents."""
        return {name: self.observe(name) for name in self.agents}, self._infos()


def effect_of(action: int, me: Agent) -> int:
    """Return the action that a pursuer has after its choice `action`, which becomes 0 if it is not an option."""
    return action if action and action in me.options() else 0


def in_rounds(scenario: Scenario) -> Scenario:
    """Return a scenario whose schedule lets all pursuers decide in each of its rounds.

    Raises:
        TypeError: if its protocol has no schedule.
    """
    rule, for_all = rule_of(scenario), scenario.schedule_traits.for_all
    schedule = Rounds() if for_all is None else for_all()
    return with_protocol(scenario, rule.model_copy(update={"schedule": schedule}))


for _kind, _registry, _function in (("aec", aec_registry, "env"), ("parallel", parallel_registry, "parallel_env")):
    if ID not in _registry:
        register(_kind, ID, f"{ENTRY}:{_function}")

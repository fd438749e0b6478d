"""The environments: a run as a game for learners, with the interface of PettingZoo (the extra `rl`).

`AECPursuit` asks one pursuer at a time, in the order of any schedule. `ParallelPursuit` asks all in rounds.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import inf
from secrets import randbits
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import Box, Discrete, Space
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.env_registry.registration import aec_registry, parallel_registry, register

from desim.kernel.core.events import Trace
from desim.kernel.core.seeds import run_seed, seed_of
from desim.kernel.core.units import seconds
from desim.learning.episode import Episode, rule_of, with_protocol
from desim.learning.rewards import REWARDS, Reward, Step, reward_named, rewards_of
from desim.learning.spaces import Spaces, Vector
from desim.pursuit.core.events import Ended, Sampled
from desim.pursuit.core.state import coordinates
from desim.pursuit.sensing.world_state import WorldState
from desim.pursuit.team.agent import Agent
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result
from desim.view.pages.replay import replay, with_recordings
from protocols.rule import Rule
from protocols.schedules.periodic import Rounds

RENDER_MODES = ("rgb_array", "replay")
FORMS = ("vector", "dict")
"""The forms of observations."""
NAME = "desim_pursuit_v0"
ENTRY = "desim.learning.make"
ID = "desim/pursuit-v0"
"""The name in the registries of PettingZoo."""


class Pursuit:
    """What both environments have in common; the arguments are those of `desim.env`.

    Attributes:
        scenario: the experiment.
        possible_agents: the names of all pursuers, pursuer_0 .. pursuer_(N - 1).
        agents: the names of those that are still in the episode.
        observation_names: the name of each number of an observation.
        state_names: the name of each number of a state.
        state_space: the space of states.
        max_cycles: the greatest number of turns of a pursuer; None: no limit.
        render_mode: what `render` returns.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int | None,
        *,
        reward: str | Reward,
        observation: str,
        omniscient: bool,
        max_cycles: int | None,
        agents_leave: bool,
        render_mode: str | None,
    ):
        if observation not in FORMS:
            raise ValueError(f"an observation should be {' or '.join(FORMS)} (got {observation!r})")
        if render_mode not in {None, *RENDER_MODES}:
            raise ValueError(f"a render mode should be {' or '.join(RENDER_MODES)} (got {render_mode!r})")
        if max_cycles is not None and max_cycles < 1:
            raise ValueError(f"max_cycles should be at least 1 (got {max_cycles})")
        rule_of(scenario)  # it is refused here, and not at the first episode
        self.scenario = scenario
        self._played = scenario if render_mode is None else with_recordings(scenario)
        self._reward, self._agents_leave = reward_named(reward), agents_leave
        self._counts_chasers = reward in REWARDS
        self.max_cycles, self.render_mode = max_cycles, render_mode
        self.possible_agents = [f"pursuer_{i}" for i in range(scenario.team.count)]
        self._ids = {name: i for i, name in enumerate(self.possible_agents)}
        self._actions = range(len(scenario.evaders) + 1)
        self.agents: list[str] = []
        self._spaces = Spaces(scenario, with_masks=observation == "dict", omniscient=omniscient)
        self.observation_spaces = {name: self._spaces.of_observations() for name in self.possible_agents}
        self.action_spaces = {name: self._spaces.of_actions() for name in self.possible_agents}
        self.state_space: Box = self._spaces.state
        self.observation_names, self.state_names = self._spaces.observation_names, self._spaces.state_names
        self._root, self._number = None if seed is None else seed_of(seed), 0
        self._seed: int | None = None
        self._episode: Episode | None = None
        self._taken: list[Any] = []

    def observation_space(self, agent: str) -> Space[Any]:
        """Return the space of observations of a pursuer, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Discrete:
        """Return the space of actions of a pursuer, always the same object: 0 (inactive), or the evader to chase."""
        return self.action_spaces[agent]

    def observe(self, agent: str) -> Any:
        """Return what a pursuer knows now, in the space of its observations; nothing changes by it."""
        return self._spaces.observed(self.pursuer(agent))

    def state(self) -> Vector:
        """Return the true state of all players now, in the order of `state_names`; for centralised critics."""
        return self._spaces.state_of(self._world)

    def pursuer(self, agent: str) -> Agent:
        """Return the agent that knows what a pursuer knows, as a protocol gets it."""
        return self._running.simulation.agents[self._number_of(agent)]

    @property
    def result(self) -> Result:
        """The run, for metrics and pictures; while the episode lasts, that up to now."""
        if self._running.result is not None:
            return self._running.result
        assert self._seed is not None
        trace, world = Trace(), self._world
        trace.events = list(self._running.simulation.trace.events)
        if self._played.record.trajectory:
            places = tuple((x, y) for x, y in coordinates(world.players.positions()).tolist())
            trace.events.append(Sampled(world.now, places[world.size :], places[: world.size]))
        trace.events += self._running.simulation.counts()
        trace.events.append(Ended(world.now, "stopped", None))
        return Result(self._played, self._seed, trace)

    def render(self) -> NDArray[np.uint8] | str | None:
        """Return a picture of the present as an (H, W, 3) array ("rgb_array"), or the replay page as HTML ("replay").

        Both need the extra `plot`. Without a render mode nothing is recorded, and None is returned.
        """
        if self.render_mode is None:
            return None
        if self.render_mode == "replay":
            return replay(self.result).page
        from desim.view.pictures.animation import frames

        (picture,) = frames(self.result, [self._world.now])
        return np.asarray(picture.convert("RGB"), dtype=np.uint8)

    def close(self) -> None:
        """End the episode at this instant."""
        if self._episode is not None:
            self._episode.close()

    @property
    def _running(self) -> Episode:
        """The episode."""
        if self._episode is None:
            raise RuntimeError("there is no episode: call reset() first")
        return self._episode

    @property
    def _world(self) -> WorldState:
        """The true state of the world."""
        return self._running.simulation.state

    def _number_of(self, agent: str) -> int:
        """Return the id of a pursuer, given its name."""
        if agent not in self._ids:
            raise KeyError(
                f"there is no agent {agent!r}: they are {self.possible_agents[0]} to {self.possible_agents[-1]}"
            )
        return self._ids[agent]

    def _begin(self, seed: int | None) -> Episode:
        """Begin the next episode.

        Args:
            seed: its seed; None: that of the constructor, and then those of the runs of the last seed that was given.
                Without any, the first seed is random.
        """
        if seed is not None:
            self._root, self._number = seed_of(seed), 0
        if self._root is None:
            self._root = randbits(32)
        self._seed = run_seed(self._root, self._number) if self._number else self._root
        self._number += 1
        return self._restart()

    def _restart(self) -> Episode:
        """Begin the episode of the present seed."""
        self.close()
        assert self._seed is not None
        self._taken, self.agents = [], self.possible_agents.copy()
        self._episode = Episode(self._played, self._seed)
        return self._episode

    def _checked(self, agent: str, action: Any) -> int:
        """Return an action as an integer; ValueError if it is none of the actions of the game."""
        if type(action) is int and action in self._actions:  # the check of the space takes longer
            return action
        if action is None or not self.action_spaces[agent].contains(action):
            raise ValueError(f"{agent}: an action should be from 0 to {len(self.scenario.evaders)} (got {action!r})")
        return int(action)

    def _first_half(self, actions: Mapping[int, int]) -> Step:
        """Return the step that begins now with some actions, by pursuer; its end is still open."""
        world, agents = self._world, self._running.simulation.agents
        profile = world.profile.copy()
        for i, action in actions.items():
            profile[i] = action if action in agents[i].options() else 0
        times = chasers_times(world, profile) if self._counts_chasers else all_times(world)
        start = seconds(world.now)
        return Step(
            start,
            start,
            tuple(profile),
            times,
            world.time_left(world.now),
            self.scenario.horizon,
            tuple(world.at_large),
            False,
        )

    def _rewards(self, begun: Step) -> list[float]:
        """Return the (N,) rewards of a step that has begun and ends now."""
        world, is_last = self._world, self._running.turn is None
        at_large = begun.captured  # a step that has begun has the evaders that are at large there
        captured = () if len(at_large) == len(world.at_large) else tuple(sorted(set(at_large) - set(world.at_large)))
        step = begun._replace(end=seconds(world.now), captured=captured, is_last=is_last)
        return rewards_of(self._reward, step)

    def _leavers(self) -> list[str]:
        """Return the agents that leave now, because their robots are down."""
        if not self._agents_leave:
            return []
        broken = self._world.broken
        return [name for name in self.agents if broken[self._number_of(name)]]

    def _info(self, agent: str) -> dict[str, Any]:
        """Return the mask of the actions of a pursuer."""
        return {"action_mask": self._spaces.mask(self.pursuer(agent))}

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without the running episode, which `__setstate__` performs again."""
        return self.__dict__ | {"_episode": None, "is_running": self._episode is not None}

    def __setstate__(self, attributes: dict[str, Any]) -> None:
        """Set the attributes, and play the episode again up to the present."""
        is_running = attributes.pop("is_running")
        self.__dict__.update(attributes)
        if is_running:
            self._replay(self._taken)

    def _replay(self, taken: Iterable[Any]) -> None:
        """Begin the episode of the present seed again, and take some steps."""
        raise NotImplementedError


class AECPursuit(Pursuit, AECEnv[str, Any, Any]):
    """One pursuer at a time decides, at the instants of its schedule: `agent_selection` is the next one.

    A pursuer that has no choice is not asked if the rule of the scenario does not ask it. In an episode in which nobody
    is asked, the first pursuer has a turn without effect, so that it can be learned that the episode is over.
    """

    metadata: ClassVar = {"name": NAME, "render_modes": list(RENDER_MODES), "is_parallelizable": False}

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Begin an episode; with a seed, that of `desim run -s SEED`. `options` has no effect."""
        self._begin(seed)
        self._open()

    def _open(self) -> None:
        """Set all that PettingZoo keeps by agent, at the first turn."""
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self.infos: dict[str, dict[str, Any]] = {name: {} for name in self.agents}
        self._skip_agent_selection: str | None = None
        self._turns = dict.fromkeys(self.agents, 0)
        self.agent_selection = self.agents[0]
        if self._running.turn is not None:  # otherwise nobody ever decides: the first step ends the episode
            self._select()
        self.infos |= {name: self._info(name) for name in self.agents}

    def step(self, action: Any) -> None:
        """Let the selected pursuer take an action, or None if its episode is over; continue to the next turn.

        An action that its mask excludes has the effect of 0, as it has in a run.

        Raises:
            ValueError: if there is no such action.
        """
        episode = self._running
        if not self.agents:
            raise RuntimeError("the episode is over: call reset()")
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            self._taken.append(None)
            return
        chosen = self._checked(agent, action)
        self._taken.append(chosen)
        self._cumulative_rewards[agent] = 0.0
        begun = self._first_half({self._number_of(agent): chosen})
        self._turns[agent] += 1
        if episode.turn is not None:
            episode.act(chosen)
        self._select()
        rewards = self._rewards(begun)
        self.rewards = {name: rewards[self._ids[name]] for name in self.agents}
        self._accumulate_rewards()
        self._deads_step_first()

    def _select(self) -> None:
        """Go on to the next turn of a pursuer that is in the episode, or to the end.

        A pursuer that has left, or has had all its turns, keeps its action.
        """
        episode = self._running
        for name in self._leavers():
            self.terminations[name] = True
        while episode.turn is not None:
            agent = self.possible_agents[episode.turn.id]
            if agent in self.agents and not self.terminations[agent] and not self._is_spent(agent):
                self.agent_selection, self.infos[agent] = agent, self._info(agent)
                return
            if all(self.terminations[name] or self._is_spent(name) for name in self.agents):
                episode.close()
                self.truncations |= {name: not self.terminations[name] for name in self.agents}
                break
            episode.act(episode.turn.action)
        else:
            self.terminations |= dict.fromkeys(self.agents, True)
        self.infos |= {name: self._info(name) for name in self.agents}

    def _is_spent(self, agent: str) -> bool:
        """Return whether a pursuer has had all its turns."""
        return self.max_cycles is not None and self._turns[agent] >= self.max_cycles

    def _replay(self, taken: Iterable[Any]) -> None:
        self._restart()
        self._open()
        for action in taken:
            self.step(action)


class ParallelPursuit(Pursuit, ParallelEnv[str, Any, Any]):
    """All pursuers decide at the same instants: at the rounds of the schedule of the scenario.

    The schedule is `rounds`, in which everybody takes part; another one at whose turns all decide at once is kept.
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
        return self._shown()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Let all pursuers take their actions, and continue to the next round.

        An action that a mask excludes has the effect of 0, and so has that of a pursuer that is down.

        Returns:
            The observations, rewards, terminations, truncations and infos of the agents of this step.

        Raises:
            ValueError: if an agent has no action, or one that does not exist.
        """
        episode = self._running
        if missing := [name for name in self.agents if name not in actions]:
            raise ValueError(f"{missing[0]} has no action: a step takes the actions of all agents")
        chosen = {self._number_of(name): self._checked(name, actions[name]) for name in self.agents}
        self._taken.append({name: chosen[self._number_of(name)] for name in self.agents})
        instant = self._world.now
        asked = chosen if episode.turn is not None else {}
        begun = self._first_half(asked)
        while episode.turn is not None and self._world.now == instant:
            me = episode.turn
            episode.act(chosen.get(me.id, me.action))
        is_late = episode.turn is not None and self.max_cycles is not None and len(self._taken) >= self.max_cycles
        if is_late:
            episode.close()
        rewards = self._rewards(begun)
        is_over, leavers = episode.turn is None and not is_late, self._leavers()
        observations, infos = self._shown()
        present = self.agents
        terminations = {name: is_over or name in leavers for name in present}
        truncations = {name: is_late and not terminations[name] for name in present}
        self.agents = [name for name in present if not (terminations[name] or truncations[name])]
        return (
            observations,
            {name: rewards[self._number_of(name)] for name in present},
            terminations,
            truncations,
            infos,
        )

    def _shown(self) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Return the observations and infos of all agents."""
        return {name: self.observe(name) for name in self.agents}, {name: self._info(name) for name in self.agents}

    def _replay(self, taken: Iterable[Any]) -> None:
        self._restart()
        for actions in taken:
            self.step(actions)


def all_times(world: WorldState) -> tuple[tuple[float, ...], ...]:
    """Return the (M, N) capture times now, s."""
    return tuple(body.capture_times(world.now) for body in world.bodies)


def chasers_times(world: WorldState, profile: Sequence[int]) -> tuple[tuple[float, ...], ...]:
    """Return the (M, N) capture times now, s, of those that chase the evader under a profile; inf for the others.

    The utilities of the game depend on no others, and those of few are computed sooner.
    """
    rows = []
    for body in world.bodies:
        chasing = [i for i, action in enumerate(profile) if action == body.number]
        times = [inf] * len(profile)
        for i, time in zip(chasing, body.capture_times_of(chasing, world.now) if chasing else (), strict=True):
            times[i] = time
        rows.append(tuple(times))
    return tuple(rows)


def play(env: AECPursuit | ParallelPursuit, rule: Rule, seed: int | None = None) -> Result:
    """Let a rule decide for all pursuers of an environment, and return the run.

    The rule gets the agents themselves, so the run is that of a scenario with this rule. A pursuer that restarts
    without memory restarts the rule. In a parallel environment the rule decides in each round for all, also for those
    that a run would not ask.

    Args:
        env: the environment; it is reset.
        rule: the rule.
        seed: the seed of the episode; see `reset`.
    """
    memories: dict[tuple[int, int], Iterator[int]] = {}

    def decide(agent: str) -> int:
        me = env.pursuer(agent)
        return next(memories.setdefault((me.id, me.restarts), iter(rule.actions(me))))

    env.reset(seed=seed)
    if isinstance(env, ParallelPursuit):
        while env.agents:
            env.step({agent: decide(agent) for agent in env.agents})
        return env.result
    for agent in env.agent_iter():
        is_over = env.terminations[agent] or env.truncations[agent]
        env.step(None if is_over else decide(agent))
    return env.result


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

"""The common part of the environments: the game of a scenario, its spaces, and the episode that is played."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from secrets import randbits
from typing import Any, NamedTuple, Self

import numpy as np
from gymnasium.spaces import Box, Discrete, Space
from numpy.typing import NDArray

from desim.config.arguments import value_text
from desim.config.caller_warnings import warn_caller
from desim.config.extras import naming_extras
from desim.config.fresh import Remembered
from desim.config.python_numbers import as_python, whole
from desim.config.shared_state import StateWarning
from desim.kernel.core.events import Trace
from desim.kernel.core.seeds import run_seed, seed_of
from desim.kernel.core.units import seconds
from desim.learning.episode import Episode, rule_of
from desim.learning.rewards import Reward, Step, reward_named, rewards_of
from desim.learning.spaces import Spaces, Vector
from desim.pursuit.core.events import Ended, Sampled
from desim.pursuit.core.state import coordinates
from desim.pursuit.sensing.world_state import WorldState
from desim.pursuit.team.agent import Agent
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result
from desim.view.pages.replay import replay, with_recordings

RENDER_MODES = ("rgb_array", "replay")
FORMS = ("vector", "dict")
"""The forms of observations."""
NO_EPISODE = "there is no episode: call reset() first"


class StepStart(NamedTuple):
    """The start of a step that has not ended yet."""

    now: int
    """ns"""
    capture_times: tuple[tuple[float, ...], ...]
    """(M, N) s; see `Step`."""
    at_large: Sequence[int]
    """The evaders that are not captured."""


class Pursuit:
    """The common part of both environments; the arguments are those of `desim.env`.

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
            raise ValueError(f"an observation should be {' or '.join(FORMS)} (got {value_text(observation)})")
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(f"a render mode should be {' or '.join(RENDER_MODES)} (got {value_text(render_mode)})")
        for name, value in (("omniscient", omniscient), ("agents_leave", agents_leave)):
            if not isinstance(value, bool | np.bool_):  # "no" would count as true
                raise ValueError(f"{name} should be True or False (got {value_text(value)})")
        max_cycles = None if max_cycles is None else whole(max_cycles, "max_cycles")
        if max_cycles is not None and max_cycles < 1:
            raise ValueError(f"max_cycles should be at least 1 (got {max_cycles})")
        rule_of(scenario)  # a protocol without turns is refused here, not at the first episode
        self.scenario = scenario
        self._played_scenario = scenario if render_mode is None else with_recordings(scenario)
        self._reward, self._agents_leave = reward_named(reward), agents_leave
        self._has_own_reward, self._remembered = not isinstance(reward, str), Remembered()
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
        self._root_seed, self._episode_number = None if seed is None else seed_of(seed), 0
        self._seed: int | None = None
        self._episode: Episode | None = None
        self._start: StepStart | None = None

    def observation_space(self, agent: str) -> Space[Any]:
        """Return the space of observations of a pursuer, always the same object."""
        return self.observation_spaces[self._checked_name(agent)]

    def action_space(self, agent: str) -> Discrete:
        """Return the space of actions of a pursuer, always the same object: 0 (inactive), or the evader to chase."""
        return self.action_spaces[self._checked_name(agent)]

    def observe(self, agent: str) -> Any:
        """Return what a pursuer knows now, in the space of its observations; the call changes nothing."""
        return self._spaces.observed(self.pursuer(agent))

    def state(self) -> Vector:
        """Return the true state of all players now, in the order of `state_names`; for centralised critics."""
        return self._spaces.state_of(self._world)

    def pursuer(self, agent: str) -> Agent:
        """Return the agent of a pursuer, as a protocol gets it."""
        return self._running.simulation.agents[self._number_of(agent)]

    @property
    def result(self) -> Result:
        """The run, for metrics and pictures; while the episode lasts, the run up to now."""
        if self._running.result is not None:
            return self._running.result
        assert self._seed is not None
        trace, world = Trace(), self._world
        trace.events = list(self._running.simulation.trace.events)
        if self._played_scenario.record.trajectory:
            places = tuple((x, y) for x, y in coordinates(world.players.positions()).tolist())
            trace.events.append(Sampled(world.now, places[world.size :], places[: world.size]))
        trace.events += self._running.simulation.counts()
        trace.events.append(Ended(world.now, "stopped", None))
        return Result(self._played_scenario, self._seed, trace)

    @naming_extras()
    def render(self) -> NDArray[np.uint8] | str | None:
        """Return a picture of the present as an (H, W, 3) array ("rgb_array"), or the replay page as HTML ("replay").

        Both need the extra `plot`. Without a render mode nothing is recorded, and None is returned.

        Raises:
            ModuleNotFoundError: if the extra is not installed; the message names it.
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
            raise RuntimeError(NO_EPISODE)
        return self._episode

    def _ready(self) -> Episode:
        """Return the episode, after the check that it can go on.

        Raises:
            RuntimeError: if there is none, it is over, its run has failed, or another thread began it.
        """
        self._running.check()
        if not self.agents:
            raise RuntimeError("the episode is over: call reset()")
        return self._running

    @property
    def _world(self) -> WorldState:
        """The true state of the world."""
        return self._running.simulation.state

    def _number_of(self, agent: str) -> int:
        """Return the id of a pursuer, given its name."""
        return self._ids[self._checked_name(agent)]

    def _checked_name(self, agent: Any) -> str:
        """Return the name of a pursuer; KeyError if there is none with this name."""
        if not isinstance(agent, str) or agent not in self._ids:
            raise KeyError(
                f"there is no agent {value_text(agent)}: they are {self.possible_agents[0]} to"
                f" {self.possible_agents[-1]}"
            )
        return agent

    def _begin(self, seed: int | None) -> None:
        """Begin the next episode.

        Args:
            seed: its seed. None: the first time the seed of the constructor, or a random one if there is none; later
                the seed of the next run of the last root seed.
        """
        if seed is not None:
            self._root_seed, self._episode_number = seed_of(seed), 0
        if self._root_seed is None:
            self._root_seed = randbits(32)
        self._seed = run_seed(self._root_seed, self._episode_number) if self._episode_number else self._root_seed
        self._episode_number += 1
        self.close()
        self._episode = self._start = None  # if the run fails at once, no old episode is left
        self._episode = Episode(self._played_scenario, self._seed)
        if self._remembered.has_changed(self._reward):
            text = (
                "reward: it has changed since the first episode, so an episode of the same seed may have other rewards;"
                " if it should not learn, let it depend on the step alone"
            )
            warn_caller(text, StateWarning)
        self.agents = self.possible_agents.copy()

    def _checked(self, agent: str, action: Any) -> int:
        """Return an action as an integer; ValueError if it is none of the actions of the game."""
        if type(action) is int and action in self._actions:  # the check of the space takes longer
            return action
        number = as_python(action)
        if number is None or not self.action_spaces[agent].contains(number):
            raise ValueError(
                f"{agent}: an action should be an integer from 0 to {len(self.scenario.evaders)}"
                f" (got {value_text(action)})"
            )
        return int(number)

    def _step_start(self) -> StepStart:
        """Return the start of the step that begins now; steps share it until time passes or an evader is captured."""
        world, start = self._world, self._start
        if start is None or start.now != world.now or start.at_large is not world.at_large:
            times = tuple(body.capture_times(world.now) for body in world.bodies)
            start = self._start = StepStart(world.now, times, world.at_large)
        return start

    def _rewards(self, start: StepStart, profile: Sequence[int]) -> Mapping[int, float]:
        """Return the rewards by pursuer of a step that ends now; a pursuer that is missing gets 0.

        Args:
            start: the start of the step.
            profile: the actions after its decisions.
        """
        (begun, times, at_large), world, is_last = start, self._world, self._running.turn is None
        if not self._has_own_reward and (begun == world.now or not any(profile)):
            return {}  # utilities are integrated over the step, and without a chaser they are 0
        captured = tuple(sorted(set(at_large).difference(world.at_large)))
        time_left, horizon = world.time_left(begun), self.scenario.horizon
        ends = seconds(begun), seconds(world.now)
        return rewards_of(self._reward, Step(*ends, tuple(profile), times, time_left, horizon, captured, is_last))

    def _leavers(self) -> list[str]:
        """Return the agents that leave now, because their robots are down."""
        if not self._agents_leave:
            return []
        broken = self._world.broken
        return [name for name in self.agents if broken[self._number_of(name)]]

    def _info(self, me: Agent) -> dict[str, Any]:
        """Return the mask of the actions of a pursuer."""
        return {"action_mask": self._spaces.mask(me)}

    def _infos(self) -> dict[str, dict[str, Any]]:
        """Return the infos of all agents."""
        return {name: self._info(self.pursuer(name)) for name in self.agents}

    def __copy__(self) -> Self:
        """Return a copy with an episode of its own, at the same instant."""
        return deepcopy(self)

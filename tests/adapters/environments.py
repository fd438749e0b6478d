"""Small environments of PettingZoo and Gymnasium."""

import gymnasium
import numpy as np
from gymnasium import spaces
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import AgentSelector

NAMES = ("ann", "bob", "eve")


class Line(ParallelEnv):
    """Agents on a line; each is told its place, and moves by 0, 1 or 2 m a step. Whoever passes 15 m is out."""

    metadata = {"name": "line_v0", "render_modes": []}  # noqa: RUF012 - as PettingZoo has it
    render_mode = None

    def __init__(self, names=NAMES, steps=30):
        self.possible_agents, self.steps = list(names), steps
        self._actions = {name: spaces.Discrete(3) for name in names}
        self._observations = {name: spaces.Box(-9.0, 99.0, (2,), np.float64) for name in names}

    def action_space(self, agent):
        return self._actions[agent]

    def observation_space(self, agent):
        return self._observations[agent]

    def reset(self, seed=None, options=None):
        self.agents, self.now = self.possible_agents[:], 0
        self.x = {name: 4.0 * k for k, name in enumerate(self.agents)}
        return self._seen(), {name: {} for name in self.agents}

    def step(self, actions):
        self.now += 1
        for name, action in actions.items():
            assert action in self._actions[name]
            self.x[name] += action
        seen, out, late = self._seen(), {n: bool(self.x[n] > 15.0) for n in self.agents}, self.now >= self.steps
        results = seen, dict.fromkeys(seen, 0.0), out, dict.fromkeys(seen, late), {name: {} for name in seen}
        self.agents = [name for name in self.agents if not (out[name] or late)]
        return results

    def _seen(self):
        return {name: np.array([self.x[name], 1.0]) for name in self.agents}

    def places(self):
        return {name: (self.x[name], 0.0) for name in self.agents}


class Turns(AECEnv):
    """Agents that act in turn, with observations and actions that are dicts, and a mask."""

    metadata = {"name": "turns_v0", "render_modes": []}  # noqa: RUF012 - as PettingZoo has it
    render_mode = None

    def __init__(self):
        self.possible_agents = list(NAMES)
        self._actions = dict.fromkeys(NAMES, spaces.Dict({"move": spaces.Discrete(2), "push": spaces.Discrete(2)}))
        self._observations = dict.fromkeys(NAMES, spaces.Dict({"observation": spaces.Box(0.0, 1.0, (2,), np.float32)}))

    def action_space(self, agent):
        return self._actions[agent]

    def observation_space(self, agent):
        return self._observations[agent]

    def observe(self, agent):
        return {"observation": np.ones(2, np.float32)}

    def reset(self, seed=None, options=None):
        self.agents = self.possible_agents[:]
        self.rewards = dict.fromkeys(NAMES, 0.0)
        self._cumulative_rewards = dict.fromkeys(NAMES, 0.0)
        self.terminations, self.truncations = dict.fromkeys(NAMES, False), dict.fromkeys(NAMES, False)
        self.infos = {name: {"action_mask": {"move": np.array([1, 0], np.int8), "push": None}} for name in NAMES}
        self._order = AgentSelector(self.agents)
        self.agent_selection, self.turns = self._order.next(), 0

    def step(self, action):
        if self.terminations[self.agent_selection]:
            self._was_dead_step(action)
            return
        assert action == {"move": 0, "push": action["push"]}
        self.turns += 1
        self._cumulative_rewards[self.agent_selection] = 0.0
        if self.turns == 12:
            self.terminations = dict.fromkeys(self.agents, True)
        self.agent_selection = self._order.next()
        self._deads_step_first()


class Counter(gymnasium.Env):
    """A robot that is told the time of the world and the sum of its actions, in an array that it changes in place."""

    observation_space = spaces.Box(-1e3, 1e3, (2,), np.float64)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = np.zeros(2)
        return self.state, {}

    def step(self, action):
        self.state += (1.0, float(action[0]))
        return self.state, 0.0, False, bool(self.state[0] >= 50), {}

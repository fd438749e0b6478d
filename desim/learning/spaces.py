"""The spaces of an environment: what an observation, an action and a state consist of, and within which bounds."""

from functools import partial
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, Space
from numpy.typing import NDArray

from desim.config.model import MAX_COORDINATE
from desim.pursuit.sensing.world_state import WorldState
from desim.pursuit.team.agent import Agent
from desim.pursuit.team.observation import observation, observation_bounds, observation_names
from desim.scenario.scenario import Scenario

Vector = NDArray[np.float32]
Mask = NDArray[np.int8]
"""(M + 1,) 1 for each action that a pursuer may choose, else 0."""


class Spaces:
    """The spaces of all pursuers of a scenario, and the vectors in them.

    Args:
        scenario: the experiment.
        with_masks: whether an observation is a dict with the mask of the actions, instead of a vector.
        omniscient: whether pursuers observe the true state of all players.

    Attributes:
        observation_names: the name of each number of an observation; see `desim.pursuit.team.observation`.
        state_names: the name of each number of a state.
        state: the space of states.
    """

    def __init__(self, scenario: Scenario, *, with_masks: bool, omniscient: bool):
        self._with_masks, self._omniscient = with_masks, omniscient
        self._masks: dict[tuple[int, ...], Mask] = {}
        self._pursuers, self._evaders = scenario.team.count, len(scenario.evaders)
        self.observation_names = observation_names(self._pursuers, self._evaders)
        centre, extent = reach_of(scenario)
        bounds = partial(observation_bounds, horizon=scenario.horizon, extent=extent, centre=centre)
        low, high = bounds(self._pursuers, self._evaders, top_speed=max(scenario.team.all_speeds(), default=0.0))
        self._vectors = Box(np.array(low, np.float32), np.array(high, np.float32))
        players = [f"pursuer_{i}" for i in range(self._pursuers)], [f"evader_{j + 1}" for j in range(self._evaders)]
        ranges: dict[str, tuple[float, float]] = {"time_left": (0.0, scenario.horizon)}
        for names, flag in zip(players, ("down", "captured"), strict=True):
            for name in names:
                ranges[f"{name}.x"] = centre.real - extent, centre.real + extent
                ranges[f"{name}.y"] = centre.imag - extent, centre.imag + extent
                ranges[f"{name}.{flag}"] = 0.0, 1.0
        ranges |= {f"{name}.action": (0.0, float(self._evaders)) for name in players[0]}
        self.state_names = tuple(ranges)
        low, high = ([bounds_of_number[k] for bounds_of_number in ranges.values()] for k in (0, 1))
        self.state = Box(np.array(low, np.float32), np.array(high, np.float32))

    def of_observations(self) -> Space[Any]:
        """Return a new space of observations of one pursuer."""
        vectors = Box(self._vectors.low, self._vectors.high)
        masks = Box(0, 1, (self._evaders + 1,), np.int8)
        return Dict({"observation": vectors, "action_mask": masks}) if self._with_masks else vectors

    def of_actions(self) -> Discrete:
        """Return a new space of actions of one pursuer: 0, or the evader to chase."""
        return Discrete(self._evaders + 1)

    def observed(self, me: Agent) -> Any:
        """Return the observation of a pursuer now; the call changes nothing."""
        vector = _within(self._vectors, observation(me, omniscient=self._omniscient))
        return {"observation": vector, "action_mask": self.mask(me)} if self._with_masks else vector

    def mask(self, me: Agent) -> Mask:
        """Return the mask of the actions of a pursuer now; a pursuer that is down can only be inactive."""
        options = (0,) if me.global_state.state.broken[me.id] else tuple(me.options())
        if options not in self._masks:
            self._masks[options] = np.isin(np.arange(self._evaders + 1), options).astype(np.int8)
        return self._masks[options].copy()

    def state_of(self, state: WorldState) -> Vector:
        """Return the true state of the world now, in the order of `state_names`."""
        places = [(place.real, place.imag) for place in state.players.positions().tolist()]  # pursuers, then evaders
        pursuers = [(*place, down) for place, down in zip(places, state.broken.tolist(), strict=False)]
        evaders = [(*places[state.size + k], body.captured is not None) for k, body in enumerate(state.bodies)]
        players = [number for numbers in (*pursuers, *evaders) for number in numbers]
        return _within(self.state, [state.time_left(state.now), *players, *state.profile])


def _within(space: Box, numbers: list[float]) -> Vector:
    """Return numbers as a vector in a space, clipped to its bounds."""
    vector: Vector = np.array(numbers, dtype=np.float32)
    return np.minimum(np.maximum(vector, space.low), space.high)  # faster than np.clip


def reach_of(scenario: Scenario) -> tuple[complex, float]:
    """Return the centre and half the side, m, of a square that no player leaves during a run."""
    team, evaders = scenario.team, scenario.evaders
    motions = [*team.relays.values(), *(evader.record for evader in evaders if evader.record is not None)]
    places = [*(team.positions if isinstance(team.positions, tuple) else ())]
    places += [evader.position for evader in evaders if evader.position is not None]
    places += [(motion.start.real, motion.start.imag) for motion in motions]
    box_ends = [*team.box, *(end for evader in evaders for end in evader.box)]  # the same for x and y
    xs, ys = ([*box_ends, *(place[k] for place in places)] for k in (0, 1))
    centre = complex((min(xs) + max(xs)) / 2.0, (min(ys) + max(ys)) / 2.0)
    speeds = [team.top_speed, *(evader.speed for evader in evaders), *(motion.top_speed for motion in motions)]
    path = (max(speeds) + scenario.environment.top_speed) * scenario.horizon
    extent = max(max(xs) - min(xs), max(ys) - min(ys)) / 2.0 + path + 1.0
    return centre, min(extent, MAX_COORDINATE)

"""The functions that make environments; they load PettingZoo (the extra `rl`) at the first call."""

from os import PathLike
from typing import TYPE_CHECKING, Any, Literal

from desim.config.arguments import naming_arguments, scenario_argument
from desim.config.extras import naming_extras
from desim.scenario.scenario import Scenario
from desim.scenario.toml import load

if TYPE_CHECKING:
    from desim.learning.environments import AECPursuit, ParallelPursuit
    from desim.learning.rewards import Reward


@naming_extras()
@naming_arguments
def env(
    scenario: "Scenario | str | PathLike[str] | None" = None,
    seed: int | None = None,
    *,
    reward: "Literal['wonderful_life', 'team'] | Reward" = "wonderful_life",
    observation: Literal["vector", "dict"] = "vector",
    omniscient: bool = False,
    max_cycles: int | None = None,
    agents_leave: bool = False,
    render_mode: Literal["rgb_array", "replay"] | None = None,
) -> "AECPursuit":
    """Return an environment of PettingZoo in which one pursuer at a time decides (AEC).

    Use it to train a rule, or to choose the actions by hand. The run is that of `desim.run`, except that the caller
    chooses the actions. `agent_selection` is the pursuer whose turn comes next under the schedule of the scenario. A
    pursuer observes what its agent knows, and nothing else.

    Args:
        scenario: the experiment, or the path of its file; None = that of Lee & Bakolas. Its protocol has to be a rule,
            of which only the schedule is used: the caller makes the choices.
        seed: the seed of the first episode, as in `desim run -s`; None = a random one. Later episodes have the
            seeds of runs 1, 2, ... of this root seed, unless `reset` gets another.
        reward: "wonderful_life": the marginal contribution of the pursuer to the utility of the team, as mean over the
            horizon, s; "team": the utility of the team, as mean over the horizon, s; or a function of a step
            (`desim.learning.rewards.Step`) that returns a number for all or one for each pursuer.
        observation: a vector of numbers, whose names are `observation_names`, with the mask of the actions in the info;
            or a dict of both ("observation" and "action_mask").
        omniscient: whether pursuers observe the true positions and actions of all players; for comparison only.
        max_cycles: the greatest number of turns of a pursuer; then it keeps its action, and the episode is truncated
            when no pursuer has a turn left. None = no limit.
        agents_leave: whether a pursuer whose robot is down leaves the episode, at the next turn of any pursuer;
            otherwise it stays until the end of the episode, and while its robot is down its mask allows 0 only.
        render_mode: what `render` returns: a picture of the present as an array, or the replay page as HTML.

    Raises:
        ModuleNotFoundError: if PettingZoo or greenlet is not installed; the message names the extra.
        TypeError: if `scenario` is neither a scenario nor a path, or its protocol has no turns of pursuers.
        ValueError: if an option is not valid.
        ScenarioError: if the file of the scenario is not valid.
        OSError: if that file cannot be read.
    """
    from desim.learning.environments import AECPursuit

    return AECPursuit(
        _scenario(scenario, "env"),
        seed,
        reward=reward,
        observation=observation,
        omniscient=omniscient,
        max_cycles=max_cycles,
        agents_leave=agents_leave,
        render_mode=render_mode,
    )


@naming_extras()
@naming_arguments
def parallel_env(
    scenario: "Scenario | str | PathLike[str] | None" = None,
    seed: int | None = None,
    *,
    reward: "Literal['wonderful_life', 'team'] | Reward" = "wonderful_life",
    observation: Literal["vector", "dict"] = "vector",
    omniscient: bool = False,
    max_cycles: int | None = None,
    agents_leave: bool = False,
    render_mode: Literal["rgb_array", "replay"] | None = None,
) -> "ParallelPursuit":
    """Return an environment of PettingZoo in which all pursuers decide at once, in rounds.

    Use it for libraries that expect the parallel interface. If the schedule of the scenario is `rounds`, its period is
    kept, and every pursuer takes part in each round. A schedule in which all pursuers decide at each turn is kept. Any
    other schedule becomes `rounds`. Pursuers whose clocks are wrong decide at other instants, in steps of their own.

    Args:
        scenario: as in `env`, as are the other arguments.
        seed: the seed of the first episode.
        reward: the reward of a step.
        observation: the form of observations.
        omniscient: whether pursuers observe the true state.
        max_cycles: the greatest number of steps; the episode is truncated then. None = no limit.
        agents_leave: whether a pursuer whose robot is down at the end of a step leaves the episode then.
        render_mode: what `render` returns.

    Raises:
        ModuleNotFoundError: if PettingZoo or greenlet is not installed; the message names the extra.
        TypeError: if `scenario` is neither a scenario nor a path, or its protocol has no turns of pursuers.
        ValueError: if an option is not valid.
        ScenarioError: if the file of the scenario is not valid.
        OSError: if that file cannot be read.
    """
    from desim.learning.environments import ParallelPursuit

    return ParallelPursuit(
        _scenario(scenario, "parallel_env"),
        seed,
        reward=reward,
        observation=observation,
        omniscient=omniscient,
        max_cycles=max_cycles,
        agents_leave=agents_leave,
        render_mode=render_mode,
    )


def _scenario(scenario: Any, function: str) -> Scenario:
    """Return a scenario, given the scenario or the path of its file; None: that of Lee & Bakolas."""
    if scenario is None:
        return Scenario()
    if isinstance(scenario, str | PathLike):
        return load(scenario)
    scenario_argument(Scenario).check(scenario, function)
    checked: Scenario = scenario
    return checked

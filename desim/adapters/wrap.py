"""Wrap an environment of PettingZoo or Gymnasium, so that its agents talk over a network."""

from typing import Any

from desim.config.arguments import naming_arguments
from desim.config.extras import naming_extras

COMMON = ("dt", "positions", "seed", "size", "faults", "horizon", "can_leave", "walls")
FOR_PETTINGZOO, FOR_GYMNASIUM = ("message", "graph", "capacity", *COMMON), ("idle", *COMMON)
"""The options for an environment of each library."""


@naming_extras()
@naming_arguments
def wrap(env: Any, links: Any = None, **options: Any) -> Any:
    """Return an environment whose agents talk over a network, for training or for any other use.

    - A **ParallelEnv** or **AECEnv** of PettingZoo: an action gains a `message`, which the agent broadcasts, and an
      observation gains the newest `messages` that have arrived from the others and their `ages`; see
      `desim.adapters.agent_messages`.
    - A **gymnasium.Env**: its agent operates a robot from afar. The observations of the robot and the commands to it
      travel over the network; see `desim.adapters.remote_control`.

    The wrapped environment has the network as `network`, a `SteppedNetwork`, for example for `env.network.counts()`.
    Equal seeds of `reset` give equal episodes, messages included.

    Args:
        env: an environment, which the result wraps.
        links: the models of the links, or a table `[network]` as a dict; an ideal network if None.
        dt: duration of a `step`, s: of all agents in a ParallelEnv, of one turn in an AECEnv; default 0.1.
        message: the gymnasium space of a message, or a number of floats in [-1, 1]; default 1. PettingZoo only.
        idle: the action of the robot until the first command has arrived; default zeros. Gymnasium only.
        positions: function of the environment that returns the positions of its agents, m, as an (n, 2) array in the
            order of `possible_agents`, or as a dict by agent: an agent that is missing has not moved. For Gymnasium,
            the positions of the robot and of its operator, (2, 2). Needed for models of distance, such as a range.
        graph: a networkx graph whose nodes are the agents; all hear each other if None. PettingZoo only.
        capacity: for an environment without `possible_agents`, the greatest number of agents in an episode; default
            100. `env.rows` has the row of each agent that has appeared. PettingZoo only.
        seed: the seed of the network until `reset` gets one; if None, each `reset` draws a new one.
        size: bytes of a message; computed from its content if None.
        **options: those above, and `faults`, `horizon`, `can_leave` and `walls` as in `SteppedNetwork`. Faults name an
            agent by its row; the robot is 0, and its operator 1.

    Raises:
        TypeError: if the environment is of another kind, or there is no such option for it.
        ValueError: if an argument is not valid, or arguments do not fit together.
        ModuleNotFoundError: if pettingzoo or gymnasium is not installed (the extra `rl`).
    """
    import gymnasium
    import pettingzoo

    if isinstance(env, pettingzoo.ParallelEnv):
        from desim.adapters.pettingzoo_wrappers import ParallelMessages

        return ParallelMessages(env, links, **_checked(options, FOR_PETTINGZOO, "environment of PettingZoo"))
    if isinstance(env, pettingzoo.AECEnv):
        from desim.adapters.pettingzoo_wrappers import TurnMessages

        return TurnMessages(env, links, **_checked(options, FOR_PETTINGZOO, "environment of PettingZoo"))
    if isinstance(env, gymnasium.Env):
        from desim.adapters.remote_control import RemoteControl

        return RemoteControl(env, links, **_checked(options, FOR_GYMNASIUM, "environment of Gymnasium"))
    name = f"{type(env).__module__}.{type(env).__qualname__}"
    raise TypeError(
        f"wrap takes a pettingzoo.ParallelEnv, a pettingzoo.AECEnv or a gymnasium.Env, got {name}: a simulator of"
        " another kind steps a SteppedNetwork in its own loop"
    )


def _checked(options: dict[str, Any], names: tuple[str, ...], kind: str) -> dict[str, Any]:
    """Return options; raise TypeError if one is not among `names`."""
    if unknown := next((name for name in options if name not in names), None):
        raise TypeError(f"wrap takes no {unknown}= for an {kind}, but {', '.join(names)}")
    return options

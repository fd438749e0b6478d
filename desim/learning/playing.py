"""A rule that plays in an environment."""

from typing import TYPE_CHECKING

from desim.learning.environments import AECPursuit, ParallelPursuit
from desim.pursuit.team.agent import Agent
from desim.simulation.run import Result
from protocols.rule import Rule

if TYPE_CHECKING:
    from collections.abc import Iterator


def play(env: AECPursuit | ParallelPursuit, rule: Rule, seed: int | None = None) -> Result:
    """Let a rule decide for all pursuers of an environment, and return the run.

    The rule gets the agent of each pursuer, and chooses whenever a run would ask it. The episode is therefore the run
    of the environment's scenario under this rule. A pursuer that restarts without memory restarts the rule.

    Args:
        env: the environment; it is reset.
        rule: the rule.
        seed: the seed of the episode; see `reset`.
    """
    actions_of: dict[tuple[int, int], Iterator[int]] = {}  # by pursuer and number of restarts

    def choose(me: Agent) -> int:
        if me.global_state.broken()[me.id] or not (rule.asks_without_choice or me.has_choice()):
            return 0  # a run does not ask the rule, either
        actions = actions_of.get((me.id, me.restarts))
        if actions is None:
            actions = actions_of[me.id, me.restarts] = iter(rule.actions(me))
        return next(actions)

    env.reset(seed=seed)
    if isinstance(env, ParallelPursuit):
        while env.agents:
            env.step_by(choose)
        return env.result
    for agent in env.agent_iter():
        is_over = env.terminations[agent] or env.truncations[agent]
        env.step(None if is_over else choose(env.pursuer(agent)))
    return env.result

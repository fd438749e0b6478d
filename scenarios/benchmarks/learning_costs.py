"""Costs of a decision in an environment for learners, and in a run in which the rule decides by itself."""

from collections.abc import Sequence
from functools import partial

import desim
from desim import Evader, Recording, Result, Scenario, Team, run
from desim.kernel.core.portable_math import portable_sum
from desim.learning.environments import AECPursuit, ParallelPursuit
from desim.learning.episode import rule_of
from desim.learning.playing import play
from desim.pursuit.core.events import Decided
from protocols.rule import SCHEDULES
from scenarios.benchmarks.measuring import Cost, per_unit
from scenarios.studies.study import Options

RULES = ("sap", "local_min", "cbaa")
TEAMS = (10, 20)
"""Numbers of pursuers."""
SIMULATED = 2.0
"""Simulated time of a run, s."""
RELATIVE_LIMIT = 1 / 0.9
"""Most CPU time of a decision in an environment, relative to one in a run."""
LEARNER_LIMIT = 500.0
"""Most CPU time, us, of a decision of a learner that observes at each turn, under a schedule with many turns."""


def scenario(rule: str, schedule: str, count: int) -> Scenario:
    """Return a lossy pursuit, with heartbeats, of an evader that is too far away to be captured."""
    base = Scenario(
        horizon=SIMULATED,
        team=Team(count=count, active_at_start=1.0),
        evader=Evader(position=(200.0, 0.0)),
        record=Recording(trajectory=0.0),
    )
    network = {"network.latency": 0.05, "network.loss": 0.1, "announce.trigger": "both", "announce.heartbeat": 0.5}
    return base.with_({**network, "protocol.kind": rule, "protocol.schedule": {"kind": schedule}})


def environments(options: Options) -> list[Cost]:
    """Measure the CPU time of a decision in an environment, relative to a run, over rules and schedules."""
    seeds, costs = range(options.seed, options.seed + 3 * options.runs), []
    for schedule in sorted(SCHEDULES.choices()):
        scenarios = [scenario(rule, schedule, max(TEAMS)) for rule in RULES]
        envs = [desim.env(scenario) for scenario in scenarios]
        took = per_unit({"run": partial(_in_runs, scenarios), "played": partial(_in_environments, envs)}, seeds)
        ratio = took["played"] / took["run"]
        costs += [
            Cost(f"a decision in a run, {schedule}", took["run"] * 1e6, "us"),
            Cost(f"a rule plays in an environment / in a run, {schedule}", ratio, "", RELATIVE_LIMIT),
        ]
    for count in TEAMS:
        observed = scenario(RULES[0], "shared_seed", count)
        aec, parallel = desim.env(observed), desim.parallel_env(observed)
        took = per_unit({"aec": partial(_learner, aec), "parallel": partial(_parallel_learner, parallel)}, seeds)
        costs += [
            Cost(f"a decision of a learner that observes, N = {count}, {kind}", spent * 1e6, "us", LEARNER_LIMIT)
            for kind, spent in took.items()
        ]
    return costs


def decisions(result: Result) -> int:
    """Return the number of decisions of a run."""
    return len(result.trace.of(Decided))


def _in_runs(scenarios: Sequence[Scenario], seed: int) -> int:
    """Run scenarios; return the number of decisions."""
    return portable_sum(decisions(run(scenario, seed)) for scenario in scenarios)


def _in_environments(envs: Sequence[AECPursuit], seed: int) -> int:
    """Let the rules of scenarios play in their environments; return the number of decisions."""
    return portable_sum(decisions(play(env, rule_of(env.scenario), seed)) for env in envs)


def _learner(env: AECPursuit, seed: int) -> int:
    """Observe at each turn, and chase whatever the mask allows; return the number of decisions."""
    env.reset(seed)
    for _ in env.agent_iter():
        _, _, terminated, truncated, info = env.last()
        env.step(None if terminated or truncated else int(info["action_mask"][1]))
    return decisions(env.result)


def _parallel_learner(env: ParallelPursuit, seed: int) -> int:
    """Let all observe and chase in each round; return the number of decisions."""
    env.reset(seed)
    while env.agents:
        env.step(dict.fromkeys(env.agents, 1))
    return decisions(env.result)

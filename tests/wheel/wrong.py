"""Mistakes that a type checker finds: each line with a comment has an error of that kind, no other has one."""

from desim import Links, Lognormal, Scenario, Team, run, summary, sweep
from desim.pursuit.team.agent import Agent


def silent(me: Agent) -> None:
    """Forget to be a generator."""


scenario = Scenario(team=Team(count=4), protocol=silent)  # arg-type
scenario = Scenario(team=Team(count="4"))  # arg-type
scenario = Scenario(team=Team(counts=4))  # call-arg
network = Links(latency=Lognormal(mu=0.1))  # call-arg
result = run(scenario, seed="7")  # arg-type
found = summary(result).active_tiem  # attr-defined
text: str = summary(result).active_time  # assignment
swept = sweep(scenario, reps=2, jobs=2)  # call-arg

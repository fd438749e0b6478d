"""The game, the reward and the comparison of the studies that train with external libraries.

The game is that of `scenarios.learning`, in rounds: eight pursuers, all active, that know nothing of each other at the
start. Its schedule is `rounds`, because these libraries let all agents act at once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from types import MappingProxyType

import click
import numpy as np
from numpy.typing import ArrayLike

from desim import Scenario
from desim.analysis.statistics import estimate
from desim.analysis.tables import aligned
from desim.learning.rewards import Step
from protocols.local_min import LocalMin
from protocols.policy import Layer, Policy
from protocols.rule import Rule
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Rounds
from scenarios.studies.learning_runs import (
    ALL_CHASE,
    IDLE,
    LATENCIES,
    LATENCY,
    Cell,
    cost,
    costs_table,
    scenario,
)
from scenarios.studies.study import Options

ROUNDS = Rounds(period=0.2)
RIVALS: Mapping[str, Rule] = MappingProxyType(
    {
        "local_min": LocalMin(schedule=ROUNDS),
        "sap": SpatialAdaptivePlay(schedule=ROUNDS),
        "all chase": ALL_CHASE.model_copy(update={"schedule": ROUNDS}),
    }
)
"""The rules with which a learned one is compared, with the same schedule."""

LATELY = 50
"""The number of episodes over which the cost in training is averaged."""

FRESH = 7
"""Root seed of the comparison minus that of the study; trainings use the root seed of the study, or the next one."""


@dataclass(frozen=True)
class Progress:
    """A training so far."""

    steps: int
    """The steps of pursuers: 8 in each round."""
    cost: float
    """The mean cost of the episodes that ended lately, s, with actions that are drawn, as in training."""


def game() -> Scenario:
    """Return the game of the trainings, at a latency of 0.1 s."""
    return scenario(RIVALS["local_min"], LATENCY)


def team_cost(step: Step) -> float:
    """Return the cost of a step for the team, s: the active time plus `IDLE` times the time in which nobody chases."""
    chasing = sum(map(bool, step.profile))
    return step.duration * (chasing or IDLE)


def minus_cost(step: Step) -> float:
    """Return the reward of a step, the same for all pursuers; that of an episode is minus its cost, s."""
    return -team_cost(step)


def exported(
    names: Sequence[str],
    layers: Sequence[tuple[ArrayLike, ArrayLike]],
    mean: ArrayLike,
    deviation: ArrayLike,
) -> Policy:
    """Return the protocol of a network with tanh between its layers, whose inputs were normalised.

    The normalisation becomes part of the first layer: W ((x - mean) / deviation) + b.

    Args:
        names: the names of the n inputs.
        layers: the weights and the bias of each layer, as those of `torch.nn.Linear`.
        mean: (n,) the numbers that were subtracted from the inputs.
        deviation: (n,) the numbers by which the differences were divided.
    """
    (weights, bias), *others = ((np.asarray(w, dtype=float), np.asarray(b, dtype=float)) for w, b in layers)
    weights = weights / np.asarray(deviation, dtype=float)
    bias = bias - (weights * np.asarray(mean, dtype=float)).sum(axis=1)
    network = [Layer(weights=w.tolist(), bias=b.tolist()) for w, b in ((weights, bias), *others)]
    return Policy(features=tuple(names), layers=tuple(network), activation="tanh", schedule=ROUNDS)


def require(*packages: str) -> None:
    """Raise `click.ClickException` if packages cannot be imported; the message has the command that installs them."""
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        names = " ".join(package.replace("_", "-") for package in packages)
        raise click.ClickException(f"{missing[0]} is missing: pip install {names}")


def show(options: Options, name: str, rule: Policy, curve: Sequence[Progress]) -> None:
    """Write the weights, compare the rule with its rivals on fresh seeds, and print both with the learning curve."""
    options.out.mkdir(parents=True, exist_ok=True)
    rule.write(options.out / f"{options.name}.weights.json")
    grid = [(label, latency) for label in (name, *RIVALS) for latency in LATENCIES]
    rules = {name: rule, **RIVALS}
    fresh = replace(options, seed=options.seed + FRESH)
    costs = fresh.measure([scenario(rules[label], latency) for label, latency in grid], "comparison", cost)
    cells = [
        Cell(*setting, mean.mean, mean.standard_error) for setting, mean in zip(grid, map(estimate, costs), strict=True)
    ]
    rows = [("steps of pursuers", "cost in training"), *((f"{p.steps:,}", f"{p.cost:.2f} s") for p in curve)]
    options.show(
        {"training": curve, "costs": cells},
        f"{aligned(rows)}\n\n{costs_table(cells, options.runs)}",
    )

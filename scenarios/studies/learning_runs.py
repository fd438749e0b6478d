"""The scenarios, the training and the measurements of `python -m scenarios.learning`."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from desim import Announcements, Links, Recording, Result, Scenario, Team, run
from desim.analysis.metrics import active_time, idle_time
from desim.analysis.statistics import estimate
from desim.analysis.tables import aligned
from desim.config.data_files import content_hash
from desim.config.json_numbers import from_json, to_json
from desim.config.whole_files import write_whole
from desim.kernel.core.seeds import run_seed, stream
from desim.study.plan.config_hash import identify
from desim.study.workers.batch import run_many, seeds_from
from protocols.local_min import LocalMin
from protocols.policy import Layer, Policy
from protocols.rule import Rule
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from scenarios.studies.study import Options

N = 8
SCHEDULE = Poisson(rate=5.0)
LATENCY = 0.1
"""The latency in training, s."""
LATENCIES = (0.02, 0.1, 0.3, 1.0)
"""The latencies of the comparison, s."""
NO_DELAY, DELAY = 0.0, 1.0
"""The latencies in training of the second study, s."""
IDLE = 3.0
"""The cost of 1 s in which nobody chases, in seconds of a pursuer that chases."""
FEATURES = ("evader.free", "evader.lead", "evader.late", "evader.rivals", "evader.chosen")
"""The features of the rule, besides the constant 1."""
WORDS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "always": ("chases on principle", "stays on principle"),
        "evader.free": ("chases if it knows of no chaser", "stays if it knows of no chaser"),
        "evader.lead": ("chases behind a nearer chaser", "stays behind a nearer chaser, chases ahead of a farther one"),
        "evader.late": ("chases if it would be late", "stays if it would be late"),
        "evader.rivals": ("chases in a crowd", "stays in a crowd"),
        "evader.chosen": ("keeps chasing", "gives up chasing"),
    }
)
"""By feature, the meaning of a positive and of a negative weight."""
SCALES = (1.0, 1.0, 1.0, 1.0, 0.2, 1.0)
"""The typical size of a useful weight; with it, a feature that counts pursuers matters as much as one in [0, 1]."""
CANDIDATES, ELITE, SEEDS = 24, 4, 4
"""The candidates of a generation, those of them that shape the next one, and the runs of each."""
GENERATIONS = 10
FLOOR = 0.5
"""Deviation, in units of `SCALES`, that is added in the first generation and shrinks to 0 by the last: it keeps the
search from narrowing too early (Szita & Lorincz 2006, "Learning Tetris Using the Noisy Cross-Entropy Method")."""


@dataclass(frozen=True)
class Generation:
    """One generation of a training."""

    mean: tuple[float, ...]
    """(6,) the mean weights of its elite: the constant, then those of `FEATURES`."""
    deviation: tuple[float, ...]
    """(6,) the deviations with which the next candidates are drawn."""
    best: float
    """The least mean cost of a candidate, s: on other seeds this candidate costs more."""
    typical: float
    """The mean cost of all candidates, s."""


@dataclass(frozen=True)
class Cell:
    """The cost of one rule at one latency; all numbers are in s."""

    rule: str
    latency: float
    cost: float
    standard_error: float


def scenario(rule: Any, latency: float) -> Scenario:
    """Return the game: eight pursuers, all active, that know nothing of each other at the start."""
    return Scenario(
        name="learning",
        team=Team(count=N, speeds=2.0, active_at_start=1.0),
        protocol=rule,
        announce=Announcements(start="silent", trigger="both", heartbeat=0.5),
        network=Links(latency=latency, loss=0.1),
        record=Recording(trajectory=0.0),
    )


def cost(result: Result) -> float:
    """Return the active time of the team plus `IDLE` times the time in which nobody chases, s."""
    return active_time(result) + IDLE * idle_time(result)


def linear(weights: Sequence[float]) -> Policy:
    """Return the rule that chases if a weighted sum is positive, given the (6,) weights; the first is the constant."""
    bias, *row = map(float, weights)
    return Policy(features=FEATURES, layers=(Layer(weights=(tuple(row),), bias=(bias,)),), schedule=SCHEDULE)


ALL_CHASE = linear([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
RIVALS: Mapping[str, Rule] = MappingProxyType(
    {
        "local_min": LocalMin(schedule=SCHEDULE),
        "sap": SpatialAdaptivePlay(schedule=SCHEDULE),
        "all chase": ALL_CHASE,
    }
)
"""The rules with which the learned one is compared."""


class Notebook:
    """The results of a study so far, in a file; a result in the file is not computed again.

    Args:
        path: the file.
        identity: a hash of all that the results depend on; results of another identity are dropped.
    """

    def __init__(self, path: Path, identity: str):
        self._path = path
        self._content: dict[str, Any] = {"identity": identity}
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return
        if isinstance(content, dict) and content.get("identity") == identity:
            self._content = content

    def remember(self, key: str, compute: Callable[[], Any]) -> Any:
        """Return the result of a key; compute and write it if the file does not have it."""
        if key not in self._content:
            self._content[key] = to_json(compute())
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self._path, json.dumps(self._content, indent=1).encode())
        return from_json(self._content[key])


def notebook(options: Options) -> Notebook:
    """Return the file of results of a study with some options; an interrupted study goes on from it."""
    game = identify(scenario(ALL_CHASE, LATENCY)).key
    code = Path(__file__).read_bytes()
    identity = content_hash(repr((options.seed, options.runs, game, content_hash(code))).encode())
    return Notebook(options.out / f"{options.name}.progress.json", identity)


def train(options: Options, notes: Notebook, latency: float) -> list[Generation]:
    """Return the generations of a training by the cross-entropy method (Rubinstein 1999) at a latency, s.

    The candidates of a generation are normal draws, at first around 0, then around the mean of the best candidates of
    the generation before. All candidates of a generation are run with the same seeds, which no other generation and no
    comparison uses. Trainings at several latencies have the same draws and seeds.
    """
    scales, generations = np.array(SCALES), list[Generation]()
    mean, deviation = np.zeros(len(SCALES)), scales
    for number in range(GENERATIONS):
        draws = stream(options.seed, "candidates training", number).standard_normal((CANDIDATES, len(SCALES)))
        candidates = mean + deviation * draws
        rules = [linear(weights.tolist()) for weights in candidates]
        first = number * SEEDS
        seeds = [run_seed(options.seed + 1, first + k) for k in range(SEEDS)]
        text = f"training at {latency:g} s, generation {number + 1} of {GENERATIONS}"
        costs = notes.remember(text, partial(_costs, rules, latency, seeds, options.jobs, text))
        by_candidate = np.array(costs).reshape(CANDIDATES, SEEDS).mean(axis=1)
        elite = candidates[np.argsort(by_candidate, kind="stable")[:ELITE]]
        mean = elite.mean(axis=0)
        floor = FLOOR * scales * (1.0 - (number + 1) / GENERATIONS)
        deviation = np.sqrt(elite.var(axis=0) + floor**2)
        typical, best = float(by_candidate.mean()), float(by_candidate.min())
        generations.append(Generation(tuple(mean.tolist()), tuple(deviation.tolist()), best, typical))
    return generations


def _costs(rules: Sequence[Rule], latency: float, seeds: Sequence[int], jobs: int, label: str) -> list[float]:
    """Return the cost of each rule at a latency with each seed, s."""
    tasks = [(scenario(rule, latency), seed) for rule in rules for seed in seeds]
    return run_many(tasks, jobs, label, cost, run)


def compare(options: Options, notes: Notebook, rules: Mapping[str, Rule], latencies: Sequence[float]) -> list[Cell]:
    """Return the cost of each rule at each latency over the runs of the study, with the same seeds for all."""
    cells, seeds = [], seeds_from(options.seed, options.runs)
    for name, rule in rules.items():
        for latency in latencies:
            text = f"{name} at {latency:g} s"
            costs = notes.remember(text, partial(_costs, [rule], latency, seeds, options.jobs, text))
            mean = estimate(costs)
            cells.append(Cell(name, latency, mean.mean, mean.standard_error))
    return cells


def costs_table(cells: Sequence[Cell], runs: int) -> str:
    """Return the costs as text, a row per rule and a column per latency."""
    rules, latencies = list(dict.fromkeys(cell.rule for cell in cells)), sorted({cell.latency for cell in cells})
    rows: list[tuple[str, ...]] = [("rule", *(f"L = {latency:g} s" for latency in latencies))]
    for rule in rules:
        line = sorted((cell for cell in cells if cell.rule == rule), key=lambda cell: cell.latency)
        rows.append((rule, *(f"{cell.cost:.2f} +- {cell.standard_error:.2f}" for cell in line)))
    return f"Active time + 3 x idle time, s, {runs} runs of equal seeds, with standard errors\n{aligned(rows)}"


def in_words(weights: Sequence[float]) -> list[tuple[str, float, str]]:
    """Return for each of the (6,) weights the name of its feature, its value and its meaning, the strongest first."""
    named = zip(("always", *FEATURES), weights, SCALES, strict=True)
    by_strength = sorted(named, key=lambda entry: -abs(entry[1] / entry[2]))
    return [(name, weight, WORDS[name][weight < 0.0]) for name, weight, _ in by_strength]

"""Find initial configurations that fit Table I, since the paper prints none; write table1_20.toml and table1_40.toml.

Configurations are drawn at random from the paper's boxes (all coordinates of the pursuers in [0, 20] m, both of the
evader in [8, 12] m, rounded to mm). A candidate is a configuration for which the active time of the *centralised*
Algorithm 3 is within 0.5 % of the published time for each of the three slots delta. The first candidates, at most
`--most`, are compared by their mean decentralised active times, with all pursuers initially active. The misfit of a
candidate is the sum over delta of (ln(mean active time / published time))^2; the candidate of least misfit is chosen.
The choice takes three rounds, each with fewer candidates and more runs per candidate than the round before. The first
round leaves out delta = 0.001 s. The seeds of these runs differ from the seeds of `scenarios.table1`. Nothing else is
fitted: no parameter of the game, the protocol or the simulator.
"""

import re
from math import ceil, inf, log

import click
import numpy as np
import tomli_w
from numpy.typing import NDArray
from tqdm import tqdm

from desim import Capture, Evader, Recording, Scenario, Team
from desim.analysis.metrics import active_time
from desim.analysis.statistics import estimate
from desim.cli.program import Program
from desim.config.arrays import Points
from desim.kernel.core.portable_math import portable_sum
from desim.study.workers.batch import run_many, seeds_from
from scenarios.studies.study import SCENARIOS
from scenarios.studies.table1_runs import DELTAS, PUBLISHED, decentralised

TOLERANCE = 0.005
"""Largest relative deviation of a candidate's centralised active times from the published ones."""
BATCH = 20_000
"""Configurations per batch; another size gives other draws from the same seed."""
SIZES = sorted({count for _, count, _ in PUBLISHED})
"""Team sizes N of Table I."""
ROOT_SEED = 1
"""Root seed of the runs for the choice; the Table I study has the root seed 0."""


def centralised_times(pursuers: Points, evaders: Points, team: Scenario, delta: float) -> NDArray[np.float64]:
    """Return the (M,) active times, s, of M configurations under the centralised Algorithm 3.

    All configurations are simulated together, in steps of delta. The active time is the time to capture, because one
    pursuer is active at a time. A configuration without capture by the horizon gets inf.

    Args:
        pursuers: (M, N) positions x + iy, m.
        evaders: (M,) positions, m.
        team: scenario that gives the speeds, the capture radius and the horizon.
        delta: slot and motion step, s.
    """
    v, v_e, eps = np.array(team.team.all_speeds()), team.evaders[0].speed, team.capture.radius
    times = np.full(len(evaders), inf)
    left = np.arange(len(evaders))  # indices of the configurations without capture so far; each array has these only
    for k in range(round(team.horizon / delta) + 1):
        gaps = evaders[:, np.newaxis] - pursuers
        distances = np.abs(gaps)
        is_free = distances.min(axis=1) > eps
        times[left[~is_free]] = k * delta
        left, pursuers, evaders, gaps, distances = (
            values[is_free] for values in (left, pursuers, evaders, gaps, distances)
        )
        if not len(left):
            break
        row = np.arange(len(left))
        nearest, relay = distances.argmin(axis=1), ((distances - eps) / (v - v_e)).argmin(axis=1)
        evaders = evaders + v_e * delta * gaps[row, nearest] / distances[row, nearest]
        ahead = evaders - pursuers[row, relay]
        pursuers[row, relay] += v[relay] * delta * ahead / np.abs(ahead)
    return times


def fitting(base: Scenario, published: dict[float, float], draws: int, seed: int) -> list[Scenario]:
    """Draw configurations (`draws`, rounded up to whole batches), and return the candidates among them.

    `published` contains the published centralised active time, s, for each delta (s).
    """
    rng = np.random.default_rng(seed)
    count, candidates = base.team.count, []
    for _ in tqdm(range(0, draws, BATCH), desc=f"drawing, N = {count}", unit_scale=BATCH, unit="draw", disable=None):
        team = rng.uniform(*base.team.box, (BATCH, count, 2)).round(3)
        evader = rng.uniform(*base.evaders[0].box, (BATCH, 2)).round(3)
        for delta, time in sorted(published.items(), reverse=True):  # the fastest test first: it has the fewest steps
            places = team[..., 0] + 1j * team[..., 1], evader[:, 0] + 1j * evader[:, 1]
            does_fit = np.abs(centralised_times(*places, base, delta) / time - 1.0) < TOLERANCE
            team, evader = team[does_fit], evader[does_fit]
        candidates += [_placed(base, *positions) for positions in zip(team.tolist(), evader.tolist(), strict=True)]
    return candidates


def _placed(base: Scenario, team: list[list[float]], evader: list[float]) -> Scenario:
    return base.model_copy(
        update={
            "team": Team(positions=team, speeds=base.team.speeds),
            "evader": base.evaders[0].model_copy(update={"position": tuple(evader)}),
        }
    )


def misfits(candidates: list[Scenario], published: dict[float, float], runs: dict[float, int]) -> list[float]:
    """Run the candidates under the decentralised Algorithm 2 and return the misfit of each; see the top of this module.

    `published` contains the published decentralised active time, s, for each delta (s), and `runs` the number of runs
    for some of them. The misfit is summed over the delta in `runs`.
    """
    cells = [(decentralised(candidate, delta), delta) for candidate in candidates for delta in runs]
    tasks = [(scenario, seed) for scenario, delta in cells for seed in seeds_from(ROOT_SEED, runs[delta])]
    times = iter(run_many(tasks, 0, f"{len(candidates)} candidates", active_time))
    means = [estimate([next(times) for _ in range(runs[delta])]).mean for _, delta in cells]
    squares = [log(mean / published[delta]) ** 2 for mean, (_, delta) in zip(means, cells, strict=True)]
    return [portable_sum(squares[k : k + len(runs)]) for k in range(0, len(squares), len(runs))]


def best(candidates: list[Scenario], published: dict[float, float]) -> Scenario:
    """Find the candidate of least misfit in rounds, each with fewer candidates and more runs of each of them."""
    for keep, runs in (
        (12, {0.1: 100, 0.01: 20}),
        (4, {0.1: 400, 0.01: 100, 0.001: 20}),
        (1, dict.fromkeys(DELTAS, 200)),
    ):
        scores = misfits(candidates, published, runs)
        ranked = sorted(range(len(candidates)), key=scores.__getitem__)
        click.echo(f"  kept {min(keep, len(ranked))} of {len(ranked)}, best misfit {scores[ranked[0]]:.5f}")
        candidates = [candidates[k] for k in ranked[:keep]]
    return candidates[0]


@click.command(help=__doc__, cls=Program)
@click.option(
    "--draws",
    type=click.IntRange(min=1),
    default=1_000_000,
    show_default=True,
    help=f"Configurations per N, in batches of {BATCH}.",
)
@click.option(
    "--most",
    type=click.IntRange(min=1),
    default=100,
    show_default=True,
    help="Number of candidates compared for each N, at most.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the draws.")
@click.option(
    "--team",
    "teams",
    type=click.Choice(SIZES),
    multiple=True,
    default=SIZES,
    show_default=True,
    help="Team sizes N.",
)
def main(draws: int, most: int, seed: int, teams: tuple[int, ...]) -> None:
    """Find and write the configurations."""
    for count in teams:
        base = Scenario(
            name=f"Table I, N = {count}",
            team=Team(count=count),
            evader=Evader(),
            capture=Capture(test="sample"),  # at the ends of steps, as a time-stepped loop does
            record=Recording(trajectory=0.0),
        )
        central, published = (
            {d: PUBLISHED[kind, count, d] for d in DELTAS} for kind in ("centralised", "decentralised")
        )
        candidates = fitting(base, central, draws, seed)
        drawn = ceil(draws / BATCH) * BATCH
        click.echo(
            f"N = {count}: {len(candidates)} of {drawn} configurations fit the published centralised active times"
        )
        if not candidates:
            raise click.ClickException("no configuration fits: increase --draws")
        command = f"python -m scenarios.find_table1 --team {count} --draws {draws} --most {most} --seed {seed}"
        text = as_file(best(candidates[:most], published), command)
        (SCENARIOS / f"table1_{count}.toml").write_text(text, encoding="utf-8")


def as_file(chosen: Scenario, command: str) -> str:
    """Return a configuration as the text of a scenario file, one point per line."""
    text = tomli_w.dumps(chosen.model_dump(exclude_defaults=True))
    head = (
        f"# A configuration of {chosen.team.count} pursuers that fits Table I of Lee & Bakolas.\n"
        f"# Found by: {command}\n"
    )
    return head + re.sub(r"\[\s+([\d.]+),\s+([\d.]+),\s+\]", r"[\1, \2]", text)


if __name__ == "__main__":
    main()

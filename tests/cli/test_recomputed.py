"""What commands print is recomputed from single runs: units, signs, denominators, and which runs are included.

The references are written here with scipy, from the metrics of each run, which have references of their own.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from functools import cache
from html import unescape
from itertools import pairwise, product
from math import isnan, nan
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

from desim import load, run, summary
from desim.analysis.metrics import METRICS, Summary, title
from desim.cli import main
from desim.kernel.core.seeds import stream
from desim.study.sensitivity.morris import morris_points
from desim.study.sensitivity.sobol_indices import saltelli_points
from tests.command import strict_json

SCENARIO = """\
name = "numbers"
seed = 3
horizon = 3.0
team = { count = 4, box = [0.0, 12.0], speeds = 1.3 }
evader = { box = [4.0, 8.0], speed = 0.9 }
protocol = { kind = "sap", schedule = { kind = "poisson", rate = 5.0 } }
network = { latency = 0.1, loss = { kind = "bernoulli", p = 0.1 } }
record = { metrics = ["of_a_run:odd", "of_a_run:flag"] }
"""
CODE = """\
def odd(result):
    return None if result.seed % 2 else float(result.seed % 7)
def flag(result):
    return result.seed % 3 == 0
def fails(me):
    while True:
        yield me.sleep(0.2)
        if me.id == 0 and me.rng.random() < 0.02:
            raise KeyError("missing")
        me.assign(1 if me.id == 1 else 0)
"""
RELAY = 'team.relay=[{pursuer=0, motion={kind="recorded", waypoints=[[0.0, 1.0, 1.0], [5.0, 6.0, 6.0]]}}]'
CASES: Mapping[str, tuple[str, ...]] = {
    "some are captured": (),
    "several evaders": ("evader.count=3", "capture.captures_to_end=2"),
    "captured at once": ("evader.box=[5.0, 5.01]", "team.box=[5.0, 5.02]"),
    "none is captured": ("horizon=1.0", "evader.speed=1.29"),
    "no messages": ("announce.trigger=never", "announce.start=silent", "announce.heartbeat=100.0"),
    "one pursuer": ("team.count=1",),
    "one relays": (RELAY,),
    "some fail": ('protocol={kind="of_a_run:fails"}',),
}
"""Overrides of the scenario."""
SHOWN = ("active_time", "capture_time", "messages_sent", "odd", "flag", "handovers")
GRID = {"network.loss.p": (0.0, 0.5), "team.speeds": (1.2, 1.4)}
RUNS, SEED = 6, 3_000_000
NUMBER = r"[+-]?[\d,]+(?:\.\d+)?"
MEAN = re.compile(rf"({NUMBER}) \+- ({NUMBER}|-)(?: \((\d+)\))?")
EQUAL = re.compile(rf"({NUMBER}) in all, others < ({NUMBER})%(?: \((\d+)\))?")
SHARE = re.compile(rf"({NUMBER})(%?) \(({NUMBER})%? \.\. ({NUMBER})%?\)(?: \((\d+)\))?")
"""The forms of a cell: a mean, the value of all runs, and a share."""


def desim(*words: object, code: int = 0) -> str:
    done = CliRunner().invoke(main, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == code, done.output
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("numbers")
    (made / "numbers.toml").write_text(SCENARIO)
    (made / "of_a_run.py").write_text(CODE)
    return made


@cache
def swept(folder: Path, name: str, *more: str) -> tuple[str, dict, list[dict[str, str]]]:
    """Return the text and the JSON of a sweep, and its exported runs."""
    out = folder / f"{name} {' '.join(more)}".replace(" ", "-")
    command = ["sweep", folder / "numbers.toml", "-n", RUNS, "-o", out, "--allow-import", *more]
    command += [f"--grid={key}={','.join(map(str, values))}" for key, values in GRID.items()]
    command += [*(f"--set={text}" for text in CASES[name]), *(f"--metric={metric}" for metric in SHOWN)]
    code = 3 if name == "some fail" else 0
    text, document = desim(*command, code=code), strict_json(desim(*command, "--json", code=code))
    desim("export", out, out / "runs.csv")
    with (out / "runs.csv").open() as file:
        return text, document, list(csv.DictReader(file))


@cache
def simulated(folder: Path, name: str) -> list[list[Summary | None]]:
    """Return the metrics of each run of each configuration, in the order of the grid; None for one that fails."""
    return [
        [_simulated(folder, name, dict(zip(GRID, values, strict=True)), SEED + k) for k in range(RUNS)]
        for values in product(*GRID.values())
    ]


def _simulated(folder: Path, name: str, settings: Mapping[str, float], seed: int) -> Summary | None:
    overrides = [*CASES[name], *(f"{key}={value}" for key, value in settings.items())]
    scenario = load(folder / "numbers.toml", overrides, allow_import=True)
    try:
        return summary(run(scenario, seed))
    except KeyError:
        return None


def values_of(runs: Sequence[Summary | None], metric: str) -> list[float]:
    """Return the value of a metric in each run, nan if it has none."""
    values = [None if one is None else one[metric] for one in runs]
    return [nan if value is None else float(value) for value in values]


def expected(values: Sequence[float], *, is_share: bool = False) -> tuple[float, ...]:
    """Return the mean, the half width or the ends of the 95 % interval, and the number of the values that are there."""
    there = [value for value in values if not isnan(value)]
    if not there:
        return nan, nan, 0
    if is_share:
        interval = stats.binomtest(int(sum(there)), len(there)).proportion_ci(0.95, "wilson")
        return float(np.mean(there)), interval.low, interval.high, len(there)
    if len(there) == 1:
        return there[0], nan, 1
    return float(np.mean(there)), stats.t.ppf(0.975, len(there) - 1) * stats.sem(there), len(there)


def check_cell(cell: str, values: Sequence[float], runs: int, *, is_share: bool = False) -> None:
    """Check the text of a mean, given the values that it is of and the number of runs that it may be of."""
    mean, *interval, count = expected(values, is_share=is_share)
    if not count:
        assert cell == "-"
        return
    if (found := EQUAL.fullmatch(cell)) is not None:
        assert len({value for value in values if not isnan(value)}) == 1
        bound = 100.0 * stats.norm.ppf(0.975) ** 2 / (count + stats.norm.ppf(0.975) ** 2)
        assert is_rounded(found[2], bound)
    elif is_share:
        found = SHARE.fullmatch(cell)
        assert found is not None
        mean, *interval = (100.0 * part if found[2] else part for part in (mean, *interval))
        assert all(is_rounded(text, end) for text, end in zip((found[3], found[4]), interval, strict=True))
    else:
        found = MEAN.fullmatch(cell)
        assert found is not None
        assert (count > 1) == (found[2] != "-")
        assert count == 1 or (is_rounded(found[2], interval[0]) and float(found[2].replace(",", "")) > 0.0)
    assert is_rounded(found[1], mean)
    given = re.search(r" \((\d+)\)$", cell)
    assert (given is None) == (count == runs)
    assert given is None or int(given[1]) == count


def is_rounded(text: str, value: float) -> bool:
    """Return whether a text is a number, rounded to the decimals that it has."""
    decimals = len(text.partition(".")[2])
    return abs(float(text.replace(",", "")) - value) <= 0.5000001 * 10.0**-decimals + 1e-9 * abs(value)


def rows_of(text: str, head: str) -> list[list[str]]:
    """Return the cells of the rows of a table whose first line begins with a text."""
    lines = text.splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith(head))
    rows = lines[first + 1 :]
    rows = rows[: rows.index("")] if "" in rows else rows
    return [re.split(r" {2,}", row.strip()) for row in rows]


@pytest.mark.whole
@pytest.mark.parametrize("name", CASES)
def test_the_tables_of_a_sweep_are_those_of_its_runs(folder, name):
    text, _, _ = swept(folder, name)
    groups = simulated(folder, name)
    rows = rows_of(text, next(iter(GRID)))
    assert len(rows) == len(groups) == 4
    for row, runs, values in zip(rows, groups, product(*GRID.values()), strict=True):
        ended, (*settings, count) = [one for one in runs if one is not None], row[:3]
        failed = row.pop(3) if name == "some fail" else "0"
        assert (tuple(map(float, settings)), int(count), int(failed)) == (values, RUNS, RUNS - len(ended))
        share = expected(values_of(runs, "captured"), is_share=True)
        found = SHARE.fullmatch(row[3])
        assert found[2] == "%"
        for cell, part in zip((found[1], found[3], found[4]), share[:3], strict=True):
            assert is_rounded(cell, 100.0 * part)
        for metric, cell in zip(SHOWN, row[4:], strict=True):
            check_cell(cell, values_of(runs, metric), len(ended), is_share=metric == "flag")


@pytest.mark.whole
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("against", [None, "team.speeds=1.4"])
def test_the_differences_of_a_sweep_are_those_of_its_runs(folder, name, against):
    """Text and JSON: each configuration minus its reference, over the pairs of runs that both have ended."""
    text, document, _ = swept(folder, name, *([] if against is None else [f"--against={against}"]))
    groups, places = simulated(folder, name), [*product(*GRID.values())]
    reference = [places.index((0.0, speed) if against is None else (loss, 1.4)) for loss, speed in places]
    table = text[text.index("difference from") :]
    words = "network.loss.p = 0" if against is None else "team.speeds = 1.4"
    assert table.startswith(f"difference from {words}, all else equal, run by run with the same seed")
    heads = [title(metric, {}) for metric in SHOWN]
    assert re.split(r" {2,}", table.splitlines()[1].strip()) == [*GRID, "pairs", *heads]
    rows = {tuple(map(float, row[:2])): row[2:] for row in rows_of(table, next(iter(GRID)))}
    assert set(rows) == {place for k, place in enumerate(places) if reference[k] != k}
    for k, (place, runs, other) in enumerate(zip(places, groups, reference, strict=True)):
        entry = document["configurations"][k]
        assert tuple(entry["settings"].values()) == place
        assert tuple(entry["reference"].values()) == places[other]
        pairs = [(a, b) for a, b in zip(runs, groups[other], strict=True) if None not in (a, b)]
        for column, metric in enumerate(SHOWN):
            mine, others = (values_of(side, metric) for side in zip(*pairs, strict=True)) if pairs else ((), ())
            differences = [a - b for a, b in zip(mine, others, strict=True)]
            mean, *interval, count = expected(differences)
            estimate = entry["difference"][metric]
            assert estimate["runs"] == count
            if count:
                assert estimate["mean"] == pytest.approx(mean, rel=1e-9, abs=1e-9)
            if count > 1:
                assert estimate["half_width"] == pytest.approx(interval[0], rel=1e-9, abs=1e-9)
            if other != k:
                assert int(rows[place][0]) == len(pairs)
                check_cell(rows[place][column + 1], differences, len(pairs))


@pytest.mark.whole
@pytest.mark.parametrize("name", CASES)
def test_json_and_exported_runs_are_those_of_the_runs(folder, name):
    _, document, exported = swept(folder, name)
    groups = simulated(folder, name)
    assert document["units"] == {metric: METRICS[metric].unit if metric in METRICS else "" for metric in SHOWN}
    for entry, runs in zip(document["configurations"], groups, strict=True):
        failed = sum(one is None for one in runs)
        assert (entry["runs"], entry["failed"]) == (RUNS, failed)
        for metric in SHOWN:
            values = values_of(runs, metric)
            mean, *interval, count = expected(values, is_share=metric == "flag")
            estimate = entry["metrics"][metric]
            assert estimate["runs"] == count
            if count and interval:
                assert estimate["mean"] == pytest.approx(mean, rel=1e-9)
            if metric == "flag" and count:
                assert estimate["interval"] == pytest.approx(interval, rel=1e-9)
            elif count > 1:
                assert estimate["half_width"] == pytest.approx(interval[0], rel=1e-9, abs=1e-9)
    for row, one in zip(exported, [one for runs in groups for one in runs], strict=True):
        assert row["status"] == ("error" if one is None else "ok")
        for metric in (*SHOWN, "captured", "end_time", "seed") if one is not None else ():
            assert row[metric] == ("" if one[metric] is None else str(one[metric]))


@pytest.mark.whole
@pytest.mark.parametrize(("name", "other"), [("some are captured", "several evaders"), ("some fail", "one relays")])
def test_two_sweeps_are_compared_by_the_pairs_of_their_runs(folder, name, other):
    """Text and JSON: the mean of each over its own runs, and the difference over the seeds that both have ended."""
    for one in (name, other):
        swept(folder, one)
    command = ["compare", *(folder / f"{one} ".replace(" ", "-") for one in (name, other))]
    shown = [metric for metric in SHOWN if metric in METRICS]
    command += [text for metric in shown for text in ("-y", metric)]
    text, document = desim(*command), strict_json(desim(*command, "--json"))
    assert document["units"] == {metric: METRICS[metric].unit for metric in shown}
    rows = rows_of(text, next(iter(GRID)))
    groups = [simulated(folder, one) for one in (name, other)]
    for row, entry, first, second in zip(rows, document["configurations"], *groups, strict=True):
        pairs = [(a, b) for a, b in zip(first, second, strict=True) if None not in (a, b)]
        assert int(row[2]) == entry["pairs"] == len(pairs) > 1
        for column, metric in enumerate(shown):
            sides = [values_of([one for one in runs if one is not None], metric) for runs in (first, second)]
            mine, others = (values_of(side, metric) for side in zip(*pairs, strict=True))
            differences = [b - a for a, b in zip(mine, others, strict=True)]
            for k, (part, values) in enumerate(
                zip(("first", "second", "difference"), (*sides, differences), strict=True)
            ):
                check_cell(row[3 + 3 * column + k], values, len(pairs))
                mean, *interval, count = expected(values)
                found = entry["metrics"][metric][part]
                assert found["runs"] == count
                assert not count or found["mean"] == pytest.approx(mean, rel=1e-9, abs=1e-9)
                assert count < 2 or found["half_width"] == pytest.approx(interval[0], rel=1e-9, abs=1e-9)


def tables_of(page: str) -> list[list[list[str]]]:
    """Return the cells of each table of a page."""

    def text(cell: str) -> str:
        return unescape(re.sub(r"<[^>]+>", "", cell)).strip().replace("±", "+-")

    tables = [
        re.findall(r"<tr.*?</tr>", table, re.DOTALL) for table in re.findall(r"<table.*?</table>", page, re.DOTALL)
    ]
    return [[list(map(text, re.findall(r"<t[hd].*?</t[hd]>", row, re.DOTALL))) for row in rows] for rows in tables]


@pytest.mark.whole
@pytest.mark.parametrize("name", CASES)
def test_all_metrics_of_a_report_are_those_of_the_runs(folder, name):
    """Its last two tables have a row for each metric, and a column for each configuration, or for each difference."""
    swept(folder, name)
    out = folder / f"{name} ".replace(" ", "-")
    desim("report", out, "-o", folder / "page.html")
    means, differences = [
        {row[0]: row[1:] for row in rows if len(row) > 1}
        for rows in tables_of((folder / "page.html").read_text())
        if any(row and row[0] == "end time, s" for row in rows)
    ]
    groups, places = simulated(folder, name), [*product(*GRID.values())]
    numeric = [metric for metric in (*METRICS, "odd", "flag") if metric not in METRICS or METRICS[metric].is_number]
    assert len(means) > 20
    for metric in numeric:
        if (label := title(metric, {})) not in means:
            assert metric == "captured" or all(isnan(value) for runs in groups for value in values_of(runs, metric))
            continue
        for runs, cell in zip(groups, means[label], strict=True):
            ended = [one for one in runs if one is not None]
            is_share = any(isinstance(one[metric], bool) for one in ended)
            check_cell(cell, values_of(runs, metric), len(ended), is_share=is_share)
        if metric == "captured":
            continue
        compared = [k for k, (loss, _) in enumerate(places) if loss]
        for k, cell in zip(compared, differences[label], strict=True):
            other = groups[places.index((0.0, places[k][1]))]
            pairs = [(a, b) for a, b in zip(groups[k], other, strict=True) if None not in (a, b)]
            mine, others = (values_of(side, metric) for side in zip(*pairs, strict=True)) if pairs else ((), ())
            check_cell(cell, [a - b for a, b in zip(mine, others, strict=True)], len(pairs))


@pytest.mark.whole
@pytest.mark.parametrize("name", [name for name in CASES if name != "some fail"])
def test_the_table_of_several_runs_is_that_of_the_runs(folder, name):
    overrides = [f"--set={text}" for text in CASES[name]]
    command = ["run", folder / "numbers.toml", "-n", RUNS, "--allow-import", *overrides]
    text, document = desim(*command), strict_json(desim(*command, "--json"))
    scenario = load(folder / "numbers.toml", CASES[name], allow_import=True)
    runs = [summary(run(scenario, SEED + k)) for k in range(RUNS)]
    assert [[one[metric] for metric in SHOWN] for one in document["runs"]] == [
        [one[metric] for metric in SHOWN] for one in runs
    ]
    captured = [float(one.captured) for one in runs]
    share, low, high, _ = expected(captured, is_share=True)
    assert f"captured in {sum(captured):.0f} of {RUNS} runs" in text
    assert f"capture probability {share:.3f}, 95 % Wilson interval {low:.3f} to {high:.3f}" in text
    horizon = scenario.horizon
    late = sum(one.end_time >= horizon for one in runs)
    assert (f"{late} runs ended at the horizon of {horizon:g} s" in text) == (late > 0 and not any(captured))
    rows = {row[0]: row[1:] for row in rows_of(text.replace("\nwall time", "\n\nwall time"), "   ")}
    for metric in (*SHOWN, "end_time", "messages_lost", "idle_time"):
        there = [value for value in values_of(runs, metric) if not isnan(value)]
        if (label := title(metric, {})) not in rows:
            assert not there
            continue
        mean, half_width, least, most, count = rows[label]
        assert int(count) == len(there)
        for cell, value in zip((mean, least, most), (np.mean(there), min(there), max(there)), strict=True):
            assert is_rounded(cell, float(value))
        if half_width == "all equal":
            assert min(there) == max(there)
        elif metric == "flag":
            _, low, high, _ = expected(there, is_share=True)
            assert is_rounded(half_width, (high - low) / 2.0)
        elif len(there) > 1:
            assert is_rounded(half_width, expected(there)[1])
        else:
            assert half_width == "-"


@pytest.mark.whole
@pytest.mark.parametrize("metric", ["captured", "active_time"])
def test_the_table_of_a_race_is_that_of_its_runs(folder, metric):
    """Means over the runs of each, of truths with Wilson's interval, and differences over the runs that both have."""
    command = ["race", folder / "numbers.toml", "-y", metric, "--zone", 0.3, "--first", 6, "-n", 12, "--allow-import"]
    command += ["-o", folder / f"race-{metric}", "--grid=team.speeds=1.2,1.4,3.0", "--maximise"]
    text, document = desim(*command), strict_json(desim(*command, "--json"))
    rows = rows_of(text, "   ")
    assert document["unit"] == METRICS[metric].unit
    assert ("in brackets a Wilson interval" in text) == (metric == "captured")
    taken = {}
    for row, entry in zip(rows, document["configurations"], strict=True):
        (speed,) = entry["settings"].values()
        runs = [_simulated(folder, "some are captured", {"team.speeds": speed}, SEED + k) for k in range(12)]
        taken[speed] = values_of(runs, metric)[: entry["mean"]["runs"]]
        assert float(row[1]) == speed
        check_cell(row[2], taken[speed], len(taken[speed]), is_share=metric == "captured")
        mean, *interval, count = expected(taken[speed], is_share=metric == "captured")
        assert (entry["mean"]["mean"], entry["mean"]["runs"]) == (pytest.approx(mean), count)
        given = entry["mean"]["interval"] if metric == "captured" else [entry["mean"]["half_width"]]
        assert given == pytest.approx(interval)
        best = taken[document["best"]["team.speeds"]]
        if speed != document["best"]["team.speeds"]:
            behind = [a - b for a, b in zip(taken[speed], best, strict=False)]
            check_cell(row[3], behind, len(taken[speed]))
            assert int(row[4]) == count
    assert document["runs"] == sum(map(len, taken.values()))


RANGES = {"network.loss.p": (0.0, 0.5), "team.speeds": (1.2, 1.6)}


@pytest.mark.whole
def test_the_effects_and_the_indices_of_an_analysis_are_those_of_its_runs(folder):
    """Morris' effects and Saltelli's sums over all pairs of different seeds, from single runs at the same points."""
    trajectories, size, seeds = 4, 8, 2
    command = ["sensitivity", folder / "numbers.toml", "--trajectories", trajectories, "--points", size, "-n", seeds]
    command += [
        "-y",
        "energy",
        "-o",
        folder / "analysis",
        "--allow-import",
        "-g",
        "network.loss.p=0:0.5",
        "-g",
        "team.speeds=1.2:1.6",
    ]
    document = strict_json(desim(*command, "--json"))

    @cache
    def values_at(*shares: float) -> np.ndarray:
        settings = {
            key: float(f"{low + (high - low) * share:.6g}")
            for (key, (low, high)), share in zip(RANGES.items(), shares, strict=True)
        }
        runs = [_simulated(folder, "some are captured", settings, SEED + k) for k in range(seeds)]
        return np.array(values_of(runs, "energy"))

    effects: list[list[float]] = [[], []]
    for trajectory in morris_points(trajectories, 2, stream(0, "morris")).tolist():
        for before, after in pairwise(trajectory):
            (k,) = [k for k in range(2) if before[k] != after[k]]
            change = np.mean(values_at(*after) - values_at(*before))
            effects[k].append(float(change) / (after[k] - before[k]))
    for of_key, changes in zip(document["keys"], effects, strict=True):
        assert of_key["effect"]["value"] == pytest.approx(np.mean(np.abs(changes)))
        assert of_key["mean_effect"] == pytest.approx(np.mean(changes))
        assert of_key["spread"] == pytest.approx(np.std(changes, ddof=1))
    assert not any(of_key["screened_out"] for of_key in document["keys"])
    values = np.array([[values_at(*point) for point in points] for points in saltelli_points(size, 2).tolist()])
    (a, b, *mixed), means = values, values[:2].mean(axis=(0, 1))

    def products(first: np.ndarray, second: np.ndarray) -> float:
        pairs = [(i, j) for i in range(seeds) for j in range(seeds) if i != j]
        return float(np.mean([first[:, i] * second[:, j] for i, j in pairs]))

    variance = (products(a - means, a - means) + products(b - means, b - means)) / 2.0
    chance = float(np.mean([np.var(point, ddof=1) for points in (a, b) for point in points]))
    assert document["variance"] == pytest.approx(variance)
    assert document["chance"] == pytest.approx(chance / (chance + max(variance, 0.0)))
    for of_key, changed in zip(document["keys"], mixed, strict=True):
        assert of_key["first"]["value"] == pytest.approx(products(b - means, changed - a) / variance)
        assert of_key["total"]["value"] == pytest.approx(products(changed - a, changed - a) / variance / 2.0)
    assert document["runs"] == (trajectories * 3 + size * 4) * seeds


CHANGES: Mapping[str, tuple[str, ...]] = {
    "as it is": (),
    "latency": ("network.latency=0.0",),
    "loss": ("network.loss=0.0",),
    "unknown start": ("announce.start=known",),
    "ideal": ("network.latency=0.0", "network.loss=0.0", "announce.start=known"),
    "no messages at all": ("network.loss=1.0", "announce.start=silent"),
}
"""What is removed from the scenario, by the name of the part that it costs."""


@pytest.mark.whole
def test_the_costs_of_imperfections_are_differences_of_runs(folder):
    """A cost is the scenario as it is minus that without the imperfection: text and JSON."""
    command = ["explain", folder / "numbers.toml", "-n", RUNS, "-o", folder / "costs", "--allow-import"]
    text, document = desim(*command), strict_json(desim(*command, "--json"))
    scenarios = {name: load(folder / "numbers.toml", keys, allow_import=True) for name, keys in CHANGES.items()}
    runs = {name: [summary(run(one, SEED + k)) for k in range(RUNS)] for name, one in scenarios.items()}
    rows = {row[0]: row[1:] for row in rows_of(text.replace("\n+ is worse", "\n\n+ is worse"), "   ")}
    for column, metric in enumerate(("active_time", "end_time")):
        values = {name: values_of(one, metric) for name, one in runs.items()}
        cost = document["costs"][metric]
        for name in ("as it is", "ideal"):
            check_cell(rows[name][column], values[name], RUNS)
        parts = {name: np.subtract(values["as it is"], values[name]) for name in ("latency", "loss", "unknown start")}
        together = np.subtract(values["as it is"], values["ideal"])
        silent = np.subtract(values["no messages at all"], values["ideal"])
        costs = parts | {"all together": together, "interaction": together - sum(parts.values()), "difference": silent}
        for name, differences in costs.items():
            cell = rows[name][column]
            if cell == "0 in every run":
                assert not differences.any()
            else:
                check_cell(cell, differences.tolist(), RUNS)
        for name, differences in parts.items():
            mean, half_width, _ = expected(differences.tolist())
            assert cost["parts"][name]["mean"] == pytest.approx(mean, abs=1e-9)
            assert cost["parts"][name]["half_width"] == pytest.approx(half_width, abs=1e-9)
            assert cost["parts"][name]["differing"] == np.count_nonzero(differences)

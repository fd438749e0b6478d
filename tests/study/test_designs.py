"""Designs of sweeps: their points, what they refuse, and their figures."""

from collections import Counter
from itertools import product

import numpy as np
import pytest

from desim import Scenario, load, sweep
from desim.analysis.metrics import Summary
from desim.scenario.checks import warnings
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.sweep_table import Design
from desim.scenario.value_ranges import KeyRange
from desim.study.breaking.features import of_grid
from desim.study.plan.configurations import check_grid
from desim.study.plan.designs import unit_points
from desim.study.results.runs import Group, SweepRuns
from desim.study.store.run_table import Row
from desim.study.store.store import Store
from desim.study.sweeps.sweep_plan import SweepPlan

SHORT = Scenario(horizon=0.01)
RANGES = {"network.latency.value": "log:0.01:1", "network.loss.p": "0:0.5"}


def settings_of(grid, design):
    return [one.settings for one in SweepPlan.of(SHORT, grid, design=design).configurations]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["sobol", "latin_hypercube", "random"])
def test_a_design_has_its_points_within_the_ranges_and_is_repeatable(method):
    design = Design(method=method, size=8)
    points = settings_of(RANGES, design)
    assert len(points) == 8
    assert all(0.01 <= one["network.latency.value"] <= 1.0 and 0.0 <= one["network.loss.p"] <= 0.5 for one in points)
    assert points == settings_of(RANGES, f"{method}:8")
    assert points != settings_of(RANGES, Design(method=method, size=8, seed=1))


@pytest.mark.parametrize("method", ["sobol", "latin_hypercube"])
def test_each_part_of_a_range_has_one_point(method):
    """Random points do not: that is the control."""
    parts = np.sort(unit_points(Design(method=method, size=16), 3) * 16 // 1, axis=0)
    assert (parts == np.arange(16)[:, None]).all()
    random = np.sort(unit_points(Design(method="random", size=16), 3) * 16 // 1, axis=0)
    assert not (random == np.arange(16)[:, None]).all()


@pytest.mark.parametrize("method", ["sobol", "random"])
def test_a_larger_design_continues_a_smaller_one(method):
    few, many = (unit_points(Design(method=method, size=size), 2) for size in (5, 20))
    assert (many[:5] == few).all()


def test_lists_are_combined_with_every_point_and_drawn_ones_are_not():
    grid = RANGES | {"protocol.kind": ["sap", "cbba"]}
    combined, drawn = settings_of(grid, "sobol:4"), settings_of(grid, Design(size=4, drawn=("protocol.kind",)))
    assert (len(combined), len(drawn)) == (8, 4)
    assert Counter(one["network.loss.p"] for one in combined).most_common(1)[0][1] == 2
    assert {one["protocol.kind"] for one in drawn} == {"sap", "cbba"}
    assert list(combined[0]) == [*grid]


def test_a_range_of_whole_numbers_is_one_of_a_key_that_takes_them():
    counts = [one["team.count"] for one in settings_of({"team.count": "2:5", **RANGES}, "sobol:8")]
    assert Counter(counts) == dict.fromkeys((2, 3, 4, 5), 2)
    assert all(isinstance(count, int) for count in counts)
    losses = [one["network.loss.p"] for one in settings_of({"network.loss.p": "0:1"}, "sobol:8")]
    assert len(set(losses)) == 8


def test_equal_points_are_run_once():
    assert len(settings_of({"team.count": [2, 3]}, Design(size=16, drawn=("team.count",)))) == 2


@pytest.mark.slow
def test_a_design_resumes_from_the_store_of_a_smaller_one(tmp_path):
    store = tmp_path / "sweep.sqlite"
    sweep(SHORT, {"network.loss.p": "0:0.5"}, reps=2, design="sobol:2", store=store)
    swept = sweep(SHORT, {"network.loss.p": "0:0.5"}, reps=2, design="sobol:4", store=store)
    assert len(swept.groups) == 4
    with Store(store, read_only=True) as kept:
        assert len(kept) == 8


def test_a_design_of_a_file_is_that_of_a_script(tmp_path):
    path = tmp_path / "s.toml"
    lines = ['"network.latency.value" = "log:0.01:1"', '"network.loss.p" = "0:0.5"']
    path.write_text("\n".join(["horizon = 0.01", "[sweep]", 'design = "sobol:4"', "[sweep.grid]", *lines]) + "\n")
    plan = SweepPlan.of(load(path))
    assert [one.settings for one in plan.configurations] == settings_of(RANGES, "sobol:4")
    path.write_text(path.read_text().replace('"sobol:4"', '{ method = "sobol", size = 4 }'))
    assert [one.settings for one in SweepPlan.of(load(path)).configurations] == settings_of(RANGES, "sobol:4")


@pytest.mark.parametrize(
    ("grid", "design", "why"),
    [
        (RANGES, None, "is a range without steps, from which a design chooses"),
        ({"team.count": [2, 3]}, "sobol:4", "has nothing to choose"),
        ({"network.loss.p": "0:1.5"}, "sobol:4", r"network\.loss\.p: should be less than or equal to 1"),
        ({"team.count": "0:3"}, "sobol:4", r"team\.count: should be greater than or equal to 1"),
        ({"horizn": "1:3"}, "sobol:4", "unknown key, did you mean 'horizon'"),
        ({"seed": "1:3"}, "sobol:4", "seed: cannot be swept"),
        (RANGES, "sobl:4", "should be 'sobol', 'latin_hypercube' or 'random'"),
        (RANGES, "sobol:x", "should be METHOD:SIZE, sobol:64 for instance"),
        (RANGES, "sobol:1", "greater than or equal to 2"),
        (RANGES, Design(drawn=("network.los.p",)), r"has no key network\.los\.p, did you mean 'network\.loss\.p'"),
        (RANGES | {"protocol": ["sap"] * 2000}, "sobol:64", "should have at most 100,000 configurations, has 128,000"),
    ],
)
def test_what_is_no_design_is_refused(grid, design, why):
    with pytest.raises(ScenarioError, match=why):
        SweepPlan.of(SHORT, grid, design=design)


def test_a_sobol_sequence_of_another_size_is_warned_of():
    texts = [why for key, why in warnings(SHORT.with_({"sweep.design": "sobol:100"})) if key == "sweep.design.size"]
    assert texts == ["100 points of a Sobol sequence are less even than a power of 2, such as 64 or 128"]
    assert not [key for key, _ in warnings(SHORT.with_({"sweep.design": "random:100"})) if key == "sweep.design.size"]


def test_ranges_without_a_design_are_valid_for_an_analysis_and_in_a_search():
    source = Source.of(SHORT.with_({"sweep.grid": {"network.loss.p": "0:0.5", "prune": ["inf", "none"]}}))
    check_grid(source)
    with pytest.raises(ScenarioError, match="less than or equal to 1"):
        check_grid(Source.of(SHORT.with_({"sweep.grid": {"network.loss.p": "0:2"}})))
    with pytest.raises(ScenarioError, match="prune: should be 'none'"):
        check_grid(Source.of(SHORT.with_({"sweep.grid": {"network.loss.p": "0:1", "prune": ["inf", "non"]}})))
    grid = {"network.loss.p": (KeyRange(0.0, 0.5),), "team.count": (KeyRange(2.0, 5.0),)}
    draws, rng = of_grid(grid, SHORT), np.random.default_rng(1)
    drawn = [{key: draw(rng, SHORT)[key] for key, draw in draws.items()} for _ in range(50)]
    assert {one["team.count"] for one in drawn} == {2, 3, 4, 5}
    assert all(0.0 <= one["network.loss.p"] <= 0.5 for one in drawn)


def runs_at(points, keys=("x", "y", "kind")):
    """Return a sweep with two runs at each point, whose active time is its first coordinate and a bit."""
    summaries = [[Summary({"captured": False, "active_time": p[0] + k}, {}) for k in (0.0, 0.1)] for p in points]
    groups = [
        Group(dict(zip(keys, point, strict=True)), [Row(k, k, "ok", s) for k, s in enumerate(both)])
        for point, both in zip(points, summaries, strict=True)
    ]
    return SweepRuns("made", keys, tuple(groups))


SCATTERED = [(*point, kind) for point in unit_points(Design(size=16), 2).tolist() for kind in ("a", "b")]
GRID = list(product([1.0, 2.0, 3.0], [1.0, 2.0], "ab"))


def test_the_keys_of_which_a_design_drew_numbers_are_told_from_those_of_a_grid():
    assert runs_at(SCATTERED).drawn_keys == ["x", "y"]
    assert runs_at(GRID).drawn_keys == []
    assert runs_at(GRID[:4]).drawn_keys == []
    cross = {(x, 1.0, "a") for x in (1.0, 2.0, 3.0)} | {(1.0, y, "a") for y in (1.0, 2.0, 3.0)}
    assert runs_at(sorted(cross)).drawn_keys == []


def test_differences_of_a_design_are_along_the_key_that_is_combined():
    runs = runs_at(SCATTERED)
    assert runs.compared_by == "kind"
    assert [runs.groups[k].settings["kind"] for k in runs.references()] == ["a"] * 32
    assert runs_at(SCATTERED[::2]).compared_by is None


@pytest.mark.slow
def test_the_figures_of_a_design_have_its_points():
    from desim.study.results.design_figures import contour, scatter
    from desim.study.results.heat_maps import phase

    runs = runs_at(SCATTERED)
    panels = scatter(runs, "active_time").axes
    assert [axes.get_xlabel() for axes in panels] == ["x", "y"]
    drawn = [sorted(container.lines[0].get_xdata()) for container in panels[1].containers]
    assert drawn == [sorted(point[1] for point in SCATTERED[::2])] * 2
    bands = contour(runs, "active_time").axes[:2]
    assert [axes.get_title() for axes in bands] == ["kind = a", "kind = b"]
    assert sorted(bands[0].lines[0].get_xdata()) == sorted(point[0] for point in SCATTERED[::2])
    with pytest.raises(ValueError, match="a heat map needs a grid"):
        phase(runs, "active_time")
    line = runs_at([(x, x, "a") for x in (1.0, 2.0, 3.0)])
    with pytest.raises(ValueError, match="do not lie on one line"):
        contour(line, "active_time")
    with pytest.raises(ValueError, match="three points"):
        contour(runs_at(SCATTERED[:4]), "active_time")
    with pytest.raises(ValueError, match="two keys"):
        contour(runs_at([(1.0, 1.0, "a"), (2.0, 1.0, "a")]), "active_time")

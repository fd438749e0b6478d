"""Which imperfection costs what: by hand, and where the answer is known."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from desim import Scenario, explain, run
from desim.analysis.metrics import active_time, end_time
from desim.analysis.statistics import estimate
from desim.cli import main
from desim.kernel.faults import Crash
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.kernel.loss import Bernoulli
from desim.pursuit.word import Announcements
from desim.scenario import Motion, Recording, Team
from desim.study.explain import Cost
from desim.study.imperfections import IMPERFECTIONS, without_faults, without_latency
from desim.study.waterfall import waterfall
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules import Poisson, Rounds

AT_ONCE = SpatialAdaptivePlay(schedule=Rounds(period=0.2))
IDEAL = Scenario(
    name="small",
    horizon=8.0,
    team=Team(count=6, speeds=1.6),
    motion=Motion(step=0.05),
    protocol=AT_ONCE,
    record=Recording(trajectory=0.0),
)
LATE = IDEAL.model_copy(update={"network": Links(latency=Constant(value=0.4))})
BAD = IDEAL.model_copy(
    update={
        "network": Links(latency=Constant(value=0.4), loss=Bernoulli(p=0.5), range=12.0),
        "fault": (Crash(node=0, at=0.5, until=3.0), Crash(node=1, at=1.0)),
        "protocol": SpatialAdaptivePlay(schedule=Poisson(rate=1.0)),
        "announce": Announcements(trigger="heartbeat", heartbeat=0.3, warm_start=False),
    }
)


def fails_late(me):
    """Fail where word is late."""
    yield me.sleep(0.1)
    if me.latency > 0.0 and me.rng.random() < 0.2:
        raise RuntimeError("it is late")


@pytest.mark.slow
def test_if_only_latency_is_imperfect_all_is_due_to_latency():
    """Exactly, for the scenario without latency is the ideal one; and it costs something, beyond its interval."""
    found = explain(LATE, 40)
    assert found.absent == tuple(name for name in IMPERFECTIONS if name != "latency")
    for cost in found.costs.values():
        assert cost.parts == {"latency": cost.together}
        assert not cost.interact
    active = found.costs["active_time"]
    assert active.together.mean > active.together.half_width
    assert active.as_it_is.mean - active.ideal.mean == pytest.approx(active.together.mean)


def test_in_an_ideal_scenario_there_is_nothing_to_explain():
    found = explain(IDEAL, 3)
    assert found.absent == tuple(IMPERFECTIONS)
    for cost in found.costs.values():
        assert (cost.parts, cost.together.mean, cost.interact) == ({}, 0.0, False)
        assert cost.as_it_is == cost.ideal
    assert "not there: latency, loss, range limit, faults, serial decisions, stale knowledge" in found.table()


@pytest.mark.slow
def test_costs_are_those_of_runs_done_by_hand_seed_by_seed():
    found = explain(BAD, 5, seed=11)
    assert found.absent == ()
    for metric, of in (("active_time", active_time), ("end_time", end_time)):
        as_it_is = [of(run(BAD, seed)) for seed in range(11, 16)]
        for name, remove in (("latency", without_latency), ("faults", without_faults)):
            without = [of(run(remove(BAD), seed)) for seed in range(11, 16)]
            assert found.costs[metric].parts[name] == estimate(np.subtract(as_it_is, without))
        assert found.costs[metric].as_it_is == estimate(as_it_is)


@pytest.mark.slow
def test_what_the_parts_leave_over_is_the_interaction():
    """Its mean is that of all together less the sum of the parts, and its interval that of the differences."""
    cost = explain(BAD, 5).costs["active_time"]
    rest = cost.together.mean - sum(part.mean for part in cost.parts.values())
    assert cost.interaction.mean == pytest.approx(rest, abs=1e-9)
    assert cost.interaction.half_width > 0.0


@pytest.mark.parametrize(
    ("rest", "interact"),
    [([1.0, 1.1, 0.9], True), ([-1.0, -1.1, -0.9], True), ([1.0, -1.0, 0.5], False), ([1e-12, 1e-12, 1e-12], False)],
)
def test_parts_interact_if_what_they_leave_over_is_not_within_its_interval_of_0(rest, interact):
    """Half widths: 4.303 x 0.1 / sqrt(3) = 0.25; 4.303 x 1.04 / sqrt(3) = 2.6; 0 for what is rounding."""
    zero = estimate([0.0, 0.0])
    assert Cost(zero, zero, {}, zero, estimate(rest)).interact is interact


def test_seeds_with_which_a_run_fails_are_left_out():
    """Some of 12 seeds fail with latency, none without."""
    found = explain(LATE.model_copy(update={"protocol": fails_late}), 12)
    assert found.runs + found.failed == 12
    assert 0 < found.failed < 12
    assert found.costs["active_time"].together.count == found.runs
    assert f"{found.failed} seeds are left out" in found.table()


def test_if_every_seed_fails_the_first_failure_is_told():
    def fails(me):
        raise RuntimeError("for good")
        yield

    with pytest.raises(ValueError, match="RuntimeError: for good"):
        explain(LATE.model_copy(update={"protocol": fails}), 2)


def test_one_run_has_no_interval():
    with pytest.raises(ValueError, match="at least 2 runs, got 1"):
        explain(IDEAL, 1)


@pytest.mark.slow
def test_two_workers_and_a_store_that_was_interrupted_change_nothing(tmp_path):
    whole = explain(BAD, 4)
    explain(BAD, 2, store=tmp_path / "some.sqlite")
    assert explain(BAD, 4, 2, store=tmp_path / "some.sqlite") == whole


FILE = """
name = "late"
horizon = 4.0
team.count = 4
motion.step = 0.1
network.latency = { kind = "constant", value = 0.3 }
fault = [{ kind = "crash", node = 0, at = 0.5 }]
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "late.toml"
    path.write_text(FILE)
    return path


def told(*arguments):
    result = CliRunner().invoke(main, ["explain", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_the_command_prints_the_table_and_writes_it_with_picture_numbers_and_provenance(file, tmp_path):
    table = told(file, "-n", 3)
    folder = tmp_path / "out/late/explain"
    assert {each.name for each in folder.iterdir()} == {
        *(f"explain.{kind}" for kind in ("txt", "json", "svg", "png")),
        "run.json",
        "sweep.sqlite",
    }
    assert (folder / "explain.txt").read_text() == table
    for name in ("as it is", "latency", "faults", "serial decisions", "interaction", "all together", "ideal"):
        assert f"\n{name} " in table.replace("\n  ", "\n")
    document = json.loads((folder / "explain.json").read_text())
    assert document == json.loads(told(file, "-n", 3, "--json"))
    assert set(document["costs"]["active_time"]["parts"]) == {"latency", "faults", "serial decisions"}
    assert json.loads((folder / "run.json").read_text())["what"] == "explain"


@pytest.mark.parametrize(
    ("arguments", "complaint"), [(("-n", 1), "is not in the range x>=2"), (("--set", "team.count=0"), "team.count")]
)
def test_bad_options_are_refused(file, arguments, complaint):
    result = CliRunner().invoke(main, ["explain", str(file), *map(str, arguments)])
    assert result.exit_code == 2
    assert complaint in result.output


def test_the_picture_has_a_bar_per_part_between_the_two_ends():
    figure = waterfall(explain(BAD, 3))
    for axes in figure.axes:
        names = [label.get_text() for label in axes.get_xticklabels()]
        assert names == ["ideal", *IMPERFECTIONS, "interaction", "as it is"]
        ends = [bar.get_y() + bar.get_height() for bar in axes.patches]
        assert ends[-1] == pytest.approx(ends[1])  # the last step ends where the bar of the scenario as it is does

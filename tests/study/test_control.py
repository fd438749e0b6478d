"""Sweeps with a control variate: whose runs are shared, what is corrected, and what is refused."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from desim import Links, Motion, Recording, Scenario, Team, controlled, sweep
from desim.analysis.control_variates import ControlledEstimate, control_variate
from desim.cli import main
from desim.study.comparing.control import ControlPlan
from desim.study.sweeps.sweep_plan import SweepPlan

SCENARIO = Scenario(
    name="small",
    horizon=20.0,
    team=Team(count=3, speeds=3.0),
    motion=Motion(step=0.1),
    protocol={"kind": "local_min", "schedule": {"kind": "poisson", "rate": 5.0}},
    network=Links(latency=0.1),
    record=Recording(trajectory=0.0),
)
GRID = {"network.latency": [0.1, 0.4]}


def test_a_control_that_needs_no_network_is_shared_by_all_networks():
    """And one that uses it is not."""
    swept = SweepPlan.of(SCENARIO, GRID, reps=4)
    plan = ControlPlan.of(swept)
    assert len(set(plan.keys)) == 1
    assert (plan.plan.reps, plan.plan.root, plan.plan.runs) == (40, swept.root, 40)
    assert len(set(ControlPlan.of(swept, "sap").keys)) == 2


@pytest.mark.slow
def test_the_estimate_is_that_of_the_runs_and_their_controls():
    made = controlled(SCENARIO, GRID, reps=4, control_runs=9)
    plain = sweep(SCENARIO, GRID, reps=4)
    control = sweep(SCENARIO.with_({"protocol": "centralised"}), {"network.latency": [0.1]}, reps=9)
    controls = control.groups[0].numbers("active_time")
    for k, estimate in enumerate(made.estimates("active_time")):
        expected = control_variate(plain.groups[k].numbers("active_time"), controls[:4], controls[4:])
        assert estimate == expected
    assert made.result.table() == plain.table()
    (table, _), notes = made.tables()[0], made.table()
    assert table == "active time with the control centralised, 9 runs of equal and further seeds"
    assert "the control took 9 runs for all configurations" in notes
    assert made.document()["metrics"]["active_time"][0]["explained"] == pytest.approx(expected_share(made))


def expected_share(made):
    return made.estimates("active_time")[0].explained


@pytest.mark.slow
def test_what_is_not_corrected_has_a_reason():
    grid = {"protocol": ["centralised", SCENARIO.protocol]}
    shown = ["active_time", "time_to_detect", "messages_sent"]
    made = controlled(SCENARIO, grid, reps=4, control_runs=9, shown=shown)
    itself, other = made.estimates("active_time")
    assert itself == "is centralised itself"
    assert isinstance(other, ControlledEstimate)
    assert made.estimates("messages_sent")[1] == "the control does not vary"
    assert made.estimates("time_to_detect")[1] == "some runs have no value, or no finite one"
    with pytest.raises(ValueError, match="nonsense"):
        made.estimates("nonsense")


def fails_at_times(result):
    if result.seed % 3 == 0:
        raise KeyError(result.seed)
    return float(result.seed)


def test_failed_runs_are_told():
    short = SCENARIO.with_({"horizon": 0.2})
    failing = {"fragile": fails_at_times}
    made = controlled(short, {"network.latency": [0.1]}, reps=4, control_runs=9, metrics=failing, shown=["fragile"])
    failed = len(made.result.failed), sum(len(group.failed) for group in made.controls)
    assert min(failed) > 0
    assert f"warning: {sum(failed)} runs failed, {failed[1]} of them of the control" in made.table()


def test_a_control_that_explains_nothing_is_said_to_be_worth_little():
    rng = np.random.default_rng(0)
    made = control_variate(rng.normal(size=30), rng.normal(size=30), rng.normal(size=300))
    assert not made.helps
    values = rng.normal(size=30)
    assert control_variate(values, values + 0.1 * rng.normal(size=30), rng.normal(size=300)).helps


@pytest.mark.parametrize(
    ("changes", "options", "why"),
    [
        ({"sweep.seeds": "independent"}, {}, "sweep.seeds should be common"),
        ({}, {"reps": 3}, "at least 4 runs of each configuration, got 3"),
        ({}, {"control_runs": 8}, "at least 9, got 8"),
        ({"protocol": "centralised"}, {}, "centralised is the protocol of all configurations"),
        ({}, {"control": "nonsense"}, "nonsense"),
    ],
)
def test_a_control_that_does_not_fit_is_refused(changes, options, why):
    with pytest.raises(ValueError, match=why):
        controlled(SCENARIO.with_(changes), GRID, **{"reps": 4, **options})


FILE = """
name = "small"
horizon = 1.0
team = { count = 3, speeds = 3.0 }
motion.step = 0.1
network.latency = 0.1
"""


def command(folder, *arguments):
    file = folder / "small.toml"
    file.write_text(FILE)
    given = ["sweep", file, "-g", "protocol.kind=local_min", "-n", 4, "-o", folder / "out", *arguments]
    return CliRunner().invoke(main, [*map(str, given)])


@pytest.mark.slow
def test_the_command_prints_the_corrected_means_and_keeps_the_runs_of_the_control(tmp_path):
    arguments = ["--control", "centralised", "--control-runs", 9]
    result = command(tmp_path, *arguments)
    assert result.exit_code == 0, result.output
    assert "active time with the control centralised, 9 runs of equal and further seeds" in result.stdout
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"control-centralised.sqlite", "control.txt"} <= names
    again = command(tmp_path, *arguments, "--json")
    assert again.exit_code == 0, again.output
    assert json.loads(again.stdout)["control"]["runs"] == 9


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--control-runs", 9], "--control-runs is an option of --control"),
        (["--control", "centralised", "--until", "active_time:0.1"], "it excludes --until and --shard"),
        (["--control", "centralised", "--shard", "1/2"], "it excludes --until and --shard"),
        (["--control", "local_min"], "local_min is the protocol of all configurations"),
        (["--control", "centralized"], "centralised"),
        (["--control", "my_rules:Mine"], "allow-import"),
    ],
)
def test_the_command_says_why_a_control_does_not_fit(tmp_path, arguments, why):
    result = command(tmp_path, *arguments)
    assert result.exit_code == 2
    assert why in result.output

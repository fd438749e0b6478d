"""`desim race`, `desim sensitivity` and `desim sweep --design`: what they print, write and refuse."""

import pytest

from desim.scenario.sweep_table import Design
from desim.study.plan.designs import unit_points
from tests.command import accepted, desim, refused, strict_json
from tests.conftest import undraw

GAME = 'horizon = 0.01\nrecord.trajectory = 0\nrecord.metrics = ["scores:size"]\nteam.count = 2\nnetwork.loss = 0.1\n'
SCORES = "def size(result):\n    return result.scenario.team.count + (7 * result.seed % 5) / 10\n"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    (tmp_path / "game.toml").write_text(GAME)
    (tmp_path / "scores.py").write_text(SCORES)
    monkeypatch.chdir(tmp_path)
    return tmp_path


RACE = ("race", "game.toml", "--allow-import", "-g", "team.count=2,3,4", "-y", "size", "--zone", 0.5, "--first", 3)


@pytest.mark.slow
def test_a_race_is_printed_and_written_and_resumes(folder, monkeypatch):
    """Sizes have no scatter, so a race takes 73 runs of each: fewer may all differ by the same by chance."""
    done = accepted(*RACE, "--minimise", "-o", "out")
    assert "team.count = 2 has the least size of 3 configurations" in done.stdout
    assert "219 runs performed, 0 already stored" in done.stderr
    out = folder / "out"
    assert {path.name for path in out.iterdir()} >= {"race.json", "race.txt", "race.svg", "run.json", "sweep.sqlite"}
    assert (out / "race.txt").read_text() == done.stdout
    undraw(monkeypatch)
    again = accepted(*RACE, "--minimise", "-o", "out", "--json")
    assert "0 runs performed, 219 already stored" in again.stderr
    assert strict_json(again.stdout) == strict_json((out / "race.json").read_text())
    assert "complete" in accepted("ls", "out").stdout
    other = accepted("race", *RACE[1:], "--maximise", "-n", 3, "-o", "out")
    assert "team.count = 4 has the greatest size" in other.stdout


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ((), "size: whether more of it is better is not known: give --maximise or --minimise"),
        (("--minimise", "--zone", 0), "--zone should be positive"),
        (("--minimise", "--zone", "inf"), "--zone should be positive and finite"),
        (("--minimise", "--confidence", 0.2), "--confidence should be between 1/3"),
        (("--minimise", "-y", "siz"), "-y siz: there is no numeric metric 'siz', did you mean 'size'?"),
        (("--minimise", "--metric", "siz"), "--metric siz: there is no numeric metric"),
        (("--minimise", "-y", "scores:sizes"), "-y scores:sizes: "),
        (("--minimise", "-g", "team.count=3"), "a race needs at least two configurations, and the grid has one"),
        (("--minimise", "-g", "team.count=0,3"), "--grid team.count=0,3: sweep.grid: team.count: should be greater"),
        (("--minimise", "-g", "network.loss.p=0:1"), "0:1 is a range without steps, from which a design chooses"),
        (("--minimise", "-y", "capture_time"), "has no value, and a mean over all seeds needs one in every run"),
        (("--minimise", "--first", 5, "-n", 4), "-n should be at least --first, 5 (got 4)"),
        (("--minimise", "--first", 5, "-n4"), "-n should be at least --first, 5 (got 4)"),
        (("--minimise", "--runs=2"), "--runs should be at least --first, 3 (got 2)"),
    ],
)
def test_what_is_no_race_is_told(options, why):
    assert why in refused(*RACE, *options)


def test_a_race_needs_its_indifference_zone(folder):
    command = [word for word in RACE if word not in ("--zone", 0.5)]
    assert "needs --zone FLOAT" in refused(*command, "--minimise")


SENSITIVITY = ("sensitivity", "game.toml", "--allow-import", "-y", "size", "--trajectories", 2, "-n", 1, "-o", "found")
RANGES = ("-g", "team.count=2:5", "-g", "network.loss.p=0:0.5")


@pytest.mark.slow
def test_a_sensitivity_analysis_is_printed_and_written_and_resumes(folder, monkeypatch):
    done = accepted(*SENSITIVITY, *RANGES, "--points", 8)
    assert "size is decided by team.count (" in done.stdout
    assert "screened out, with an effect below a tenth of the greatest: network.loss.p" in done.stdout
    assert "one run at each point: chance counts as an effect of the keys" in done.stdout
    found = folder / "found"
    names = {"sensitivity.json", "sensitivity.txt", "sensitivity.svg", "run.json", "sweep.sqlite"}
    assert {path.name for path in found.iterdir()} >= names
    undraw(monkeypatch)
    again = accepted(*SENSITIVITY, *RANGES, "--points", 8, "--json")
    assert "0 runs performed" in again.stderr
    assert strict_json(again.stdout) == strict_json((found / "sensitivity.json").read_text())


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ((), "sweep.grid: should have at least one key of the scenario"),
        (RANGES[:2], "team.count: with one key there is nothing to divide"),
        ((*RANGES, "--points", 10), "--points should be 0 or a power of 2"),
        ((*RANGES, "--trajectories", 1), "--trajectories should be at least 2"),
        ((*RANGES, "-y", "siz"), "-y siz: there is no numeric metric 'siz', did you mean 'size'?"),
        ((*RANGES, "-g", "network.loss.p=0:2"), "network.loss.p: should be less than or equal to 1"),
        ((*RANGES, "-g", "network.loss.p=1:0"), "the range 1:0 should have its lower end first"),
        ((*RANGES, "-g", "network.loss.p=log:0:1"), "the range log:0:1 should begin above 0: it is logarithmic"),
        ((*RANGES, "-y", "capture_time"), "has no value"),
    ],
)
def test_what_is_no_sensitivity_analysis_is_told(options, why):
    assert why in refused(*SENSITIVITY, *options)


@pytest.mark.slow
def test_a_design_of_the_command_line_is_run_in_parts_and_drawn(folder, monkeypatch):
    command = ("sweep", "game.toml", "--allow-import", "-n", 2, "-g", "network.loss.p=0:0.5", "-g", "team.count=2:9")
    sobol = (*command, "--design", "sobol:8")
    for part in ("1/2", "2/2"):
        accepted(*sobol, "-o", "parts", "--shard", part)
    accepted("merge", "parts", "-o", "parts")
    done = accepted(*sobol, "-o", "parts")
    assert "0 runs in" in done.stderr
    assert (folder / "parts/scatter-active_time.svg").exists()
    accepted("plot", "parts", "--kind", "contour", "-y", "size", "-o", "contour.png")
    assert "a heat map needs a grid" in refused("plot", "parts", "--kind", "phase", "-o", "phase.png")
    undraw(monkeypatch)
    report = accepted("report", "parts", "-o", "report.html")
    assert "8 configurations" in report.stdout + report.stderr
    accepted(
        *command,
        "--design",
        "sobol:4",
        "--set",
        'sweep.design.drawn=["protocol"]',
        "-g",
        "protocol=sap,cbba",
        "--dry-run",
    )


def test_the_points_of_the_command_line_are_those_of_the_design():
    done = accepted(
        "sweep", "game.toml", "--allow-import", "-g", "network.loss.p=0:1", "--design", "random:3", "--dry-run"
    )
    shares = unit_points(Design(method="random", size=3), 1)[:, 0]
    assert [float(line.split()[-1]) for line in done.stdout.splitlines()[2:]] == [float(f"{x:.6g}") for x in shares]


WRONG = """
def word(result):
    return "good"

def late(result):
    if result.seed == 2:
        raise RuntimeError("not this one")
    return float(result.seed)

def nan(result):
    return float("nan") if result.seed == 2 else 1.0
"""
RULE = """
def late(me):
    yield me.sleep(0.001)
    raise RuntimeError("no idea, seed and all")
"""


FAILURES = {
    "wrong:late": (3, "with seed 2 failed: MetricError: metric 'late' of 'unnamed' with seed 2: RuntimeError: not", 2),
    "wrong:word": (3, "with seed 0 failed: MetricError: metric 'word' of 'unnamed' with seed 0: should return a", 0),
    "wrong:nan": (2, "with seed 2 has no value, and a mean over all seeds needs one in every run", 3),
    "protocol=wrong_rule:late": (3, "with seed 0 failed: RuntimeError: no idea, seed and all (", 0),
}
"""The exit code, a part of the sentence, and the least number of runs that are kept."""
OPTIONS = {
    "race": ("--zone", 1, "--minimise", "-n", 3, "--first", 3),
    "sensitivity": ("-n", 3, "--points", 8),
    "sweep": ("--fail-fast", "-n", 3),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "setting"),
    [(command, setting) for command in OPTIONS for setting in FAILURES if (command, setting) != ("sweep", "wrong:nan")],
)
def test_a_run_that_fails_ends_the_command_with_a_sentence_and_what_is_kept(folder, command, setting):
    code, why, kept = FAILURES[setting]
    (folder / "wrong.py").write_text(WRONG)
    (folder / "wrong_rule.py").write_text(RULE)
    words = [command, "game.toml", "--allow-import", "-g", "team.count=2,3", "-g", "network.loss.p=0.1,0.2", "-o", "x"]
    words += OPTIONS[command]
    words += ["--set", setting] if "=" in setting else ["--metric", setting]
    result = desim(*words)
    first, last = result.stderr.splitlines()[-2:]
    assert result.exit_code == code
    assert why in first
    assert "the run of team.count = " in first
    assert "Traceback" not in result.output
    assert first.endswith(("wrong.py:7)", "wrong_rule.py:4)")) == (
        setting in {"wrong:late", "protocol=wrong_rule:late"}
    )
    count = int(last.split()[0])
    assert last.startswith(f"{count} finished run")
    assert count >= kept
    assert "in x/sweep.sqlite" in last
    assert ("`desim report x` shows the traceback" in last) == (code == 3)

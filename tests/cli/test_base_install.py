"""Commands without the packages of extras: what is computed is told and written, and what is not drawn has a reason."""

import sys

import pytest

from desim.cli.breaking import VIOLATED
from desim.config.extras import EXTRAS
from tests.command import desim

GAME = (
    "horizon = 1.0\nteam.count = 3\n"
    'sweep = {reps = 2, grid = {"network.latency.value" = [0.0, 0.1]}}\n'
    "record.messages = true\n"
)
IDLE = "idle at most 0.01 in total"
RANGES = ("-g", "network.latency.value=0:0.1", "-g", "evader.speed=0.5:0.9")
COMMANDS = {
    "run": (("run", "game.toml", "-o", "out"), 0, "summary.json"),
    "runs": (("run", "game.toml", "-n", 2, "-o", "out"), 0, "seed-0/summary.json"),
    "sweep": (("sweep", "game.toml", "-o", "out"), 0, "sweep.txt"),
    "explain": (("explain", "game.toml", "-n", 2, "-o", "out"), 0, "sweep.sqlite"),
    "race": (("race", "game.toml", "--zone", 1, "-n", 20, "-o", "out"), 0, "sweep.sqlite"),
    "sensitivity": (("sensitivity", "game.toml", *RANGES, "--points", 8, "-n", 1, "-o", "out"), 0, "sweep.sqlite"),
    "break": (("break", "game.toml", "--property", IDLE, "-n", 2, "-o", "out"), VIOLATED, "break.json"),
    "break by losses": (("break", "game.toml", "--property", IDLE, "--losses", 1, "-o", "out"), VIOLATED, "break.json"),
    "export": (("export", "game.toml", "out/events.csv"), 0, "events.csv"),
    "perfetto": (
        ("plot", "game.toml", "--kind", "perfetto", "-o", "out/trace.perfetto.json"),
        0,
        "trace.perfetto.json",
    ),
}
"""By name: a command with the folder `out`, its exit code, and a file that it leaves."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "game.toml").write_text(GAME)
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path)
    for package in EXTRAS:
        monkeypatch.setitem(sys.modules, package, None)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_needs_no_extra_for_what_it_computes(folder, name):
    command, code, file = COMMANDS[name]
    done = desim(*command)
    assert done.exit_code == code, done.stderr
    assert (folder / "out" / file).is_file()


def test_a_violation_without_a_page_has_a_reason(folder):
    done = desim(*COMMANDS["break"][0])
    assert "\nno replay: jinja2 is missing: pip install 'pursuit-desim[plot]'" in done.stdout
    assert done.stdout.strip() == (folder / "out" / "break.txt").read_text().strip()


@pytest.mark.slow
def test_live_and_simulated_runs_are_compared_without_a_figure(folder):
    done = desim("live", "game.toml", "-n", 2, "--compare", "-o", "out")
    assert done.exit_code == 0, done.stderr
    assert "warning: no picture: matplotlib is missing" in done.stderr
    assert "live and simulated" in done.stdout

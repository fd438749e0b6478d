"""`desim break`: the search from the command line, and what it leaves in its folder."""

import json
import re
from pathlib import Path

import pytest

from desim import judge, load, run
from desim.cli import breaking
from desim.cli.breaking import VIOLATED
from desim.scenario.properties import property_of
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.study.breaking.found import case_text, with_comment
from tests.command import desim, refused, strict_json

GAME = (
    'seed = 1\nhorizon = 12.0\nprotocol = "cbaa"\n'
    'properties = ["covered: idle at most 2 in total against centralised"]\n'
    "[team]\ncount = 4\nspeeds = 1.5\n[network]\nlatency = 0.1\n"
    '[announce]\ntrigger = "change"\n'
)
SHORT = GAME.replace("cbaa", "best_response").replace("12.0", "2.0").replace("speeds = 1.5\n", "")
CROWDED = "crowded at most 1.2 in total"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "game.toml").write_text(GAME)
    (tmp_path / "short.toml").write_text(SHORT.replace("[announce]", '[announce]\nstart = "known"'))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.whole
def test_a_violation_is_a_scenario_that_shows_it(folder):
    command = ("break", "game.toml", "--feature", "chaser crash", "-n", 24, "--keep", "kept", "-o", "found")
    result = desim(*command)
    assert result.exit_code == VIOLATED
    found = folder / "found"
    assert {path.name for path in found.iterdir()} >= {"break.json", "break.txt", "cases.jsonl", "smallest.html"}
    text = (found / "smallest.toml").read_text()
    assert text.startswith('# cbaa violates "idle at most 2 in total against centralised" here: margin -')
    assert '"covered: idle at most 2 in total against centralised",' in text  # the text, as a person writes it
    smallest = load(found / "smallest.toml")
    verdict = judge(smallest.properties[0], run(smallest))
    document = strict_json((found / "break.json").read_text())["violation"]
    assert verdict.margin == document["verdict"]["margin"] < 0.0
    assert document["protocols"]["cbaa"] == document["verdict"]
    assert f"smallest.html#t={verdict.at:g}" in result.stdout
    assert result.stdout.strip() == (found / "break.txt").read_text().strip()
    (kept,) = (folder / "kept").iterdir()
    assert kept.read_text() == text
    again = desim(*command)
    assert again.exit_code == VIOLATED
    assert again.stdout.startswith(f"kept: kept/{kept.name}: violates: margin -")
    other = desim(*command, "--protocol", "local_min", "-n", 1)
    assert "kept:" not in other.stdout


@pytest.mark.slow
@pytest.mark.usefixtures("_undrawn")
def test_a_violation_is_written_and_kept_with_all_that_repeats_it(folder):
    """A game that all lose: two pursuers, of whom one cannot know within the horizon that the other one chases."""
    (folder / "tiny.toml").write_text(
        'seed = 1\nhorizon = 0.2\nprotocol = "cbaa"\nproperties = ["idle at most 0 in total"]\n'
        "[team]\ncount = 2\n[network]\nlatency = 0.1\n"
    )
    command = ("break", "tiny.toml", "--feature", "latency", "-n", 1, "-j", 1, "--keep", "kept", "-o", "found")
    result = desim(*command, "--json")
    made = strict_json(result.stdout)
    assert (result.exit_code, made["property"], made["runs"]) == (VIOLATED, "idle at most 0 in total", 1)
    violation = made["violation"]
    smallest = load(violation["file"])
    assert smallest.seed == violation["seed"]
    assert violation["verdict"] == judge(smallest.properties[0], run(smallest))._asdict()
    assert violation["searched"] == 1
    assert violation["protocols"].keys() == PROTOCOLS.choices().keys() - {"policy"}
    assert violation["protocols"]["cbaa"] == violation["verdict"]
    text = (folder / "found" / "break.txt").read_text()
    assert text.startswith(f"violated in case 1: seed {smallest.seed}, margin -0.01 s (it has 0.01 s)\n")
    assert f"smallest after {violation['shrunk']} more runs: {case_text(violation['case'])}\n" in text
    again = desim(*command)
    assert again.exit_code == VIOLATED
    assert re.match(rf"kept: kept/cbaa-idle_at_most_0_in_total-{smallest.seed}-\w{{8}}\.toml: violates: ", again.stdout)
    assert "cases" not in again.stdout
    shown = {Path("found/smallest.toml"), Path("found/smallest.html")}
    assert {*Path("found").glob("smallest.*")} >= shown  # they are of this case
    Path("found/smallest.toml").write_text("# of another case\n\nhorizon = 1.0\n")
    again = desim(*command, "--json")
    assert not {*Path("found").glob("smallest.*")}
    (kept,) = Path("kept").iterdir()
    expected = {"seed": smallest.seed, "verdict": violation["verdict"], "failure": "", "file": str(kept)}
    document = strict_json(again.stdout)
    assert document == {"property": made["property"], "unit": "s", "runs": 0, "violation": expected}
    assert strict_json((folder / "found" / "break.json").read_text()) == document
    assert f"kept: {kept}: violates: " in again.stderr
    assert (folder / "found" / "break.txt").read_text() in again.stderr


def test_a_kept_case_takes_the_place_of_no_other(tmp_path):
    """A case that is found again, by another command, is kept once."""
    prop = property_of("idle at most 2 in total")
    folders = tmp_path / "found", tmp_path / "kept"
    search = breaking._Search(Scenario(), prop, 1, Path("game.toml"), *folders, 1, None, as_json=False)
    for command, horizon in (("a", 1.0), ("b", 1.0), ("a", 2.0)):
        search._write_smallest(with_comment(Scenario(horizon=horizon), prop, 7, [command]), "cbaa", 7)
    assert sorted(load(path).horizon for path in (tmp_path / "kept").iterdir()) == [1.0, 2.0]


@pytest.mark.slow
def test_without_a_violation_no_earlier_one_stays(folder):
    """Beside "no violation", an earlier one would mislead. The scenario that is searched stays, as do kept cases."""
    Path("found").mkdir()
    names = ["smallest.toml", "smallest.html", "smallest.svg", "smallest.png", "notes.toml"]
    for name in names:
        (folder / "found" / name).write_text(SHORT)
    command = ("--property", "idle at most 1.5 in total", "-n", 1, "-o", "found")
    assert desim("break", "found/smallest.toml", *command).exit_code == 0
    assert desim("break", "found/notes.toml", *command, "--keep", "found").exit_code == 0
    assert (folder / "found" / "smallest.toml").exists()
    assert desim("break", "found/notes.toml", *command).exit_code == 0
    assert sorted(path.name for path in (folder / "found").iterdir()) == [
        *("break.json", "break.txt", "cases.jsonl", "notes.toml")
    ]


@pytest.mark.whole
def test_a_kept_case_that_ends_its_process_does_not_end_the_program(folder):
    (folder / "rules.py").write_text("import os\n\ndef dies(me):\n    yield me.sleep(0.5)\n    os._exit(9)\n")
    (folder / "own.toml").write_text(GAME.replace('"cbaa"', '"rules:dies"'))
    (folder / "kept").mkdir()
    (folder / "kept" / "case.toml").write_text((folder / "own.toml").read_text())
    result = desim("break", "own.toml", "--allow-import", "--keep", "kept", "-j", 2)
    assert result.exit_code == VIOLATED
    assert result.stdout.startswith("kept: kept/case.toml: fails: ")


def runs_in(lines):
    """Return the runs in a log, without how long they took."""
    return sorted((json.loads(line) | {"seconds": 0.0} for line in lines), key=lambda entry: entry["seed"])


@pytest.mark.slow
def test_the_same_command_goes_on_where_it_stopped(folder):
    options = (
        "--feature",
        "loss",
        "--set",
        "horizon=2.5",
        "--set",
        "team.count=4",
        "-o",
        "found",
        "-g",
        "team.count=3,5",
        "--json",
    )
    first = desim("break", "game.toml", *options, "-n", 6)
    lines = (folder / "found" / "cases.jsonl").read_text().splitlines()
    (folder / "found" / "cases.jsonl").write_text("\n".join(lines[:4]))
    again = desim("break", "game.toml", *options, "-n", 6)
    assert (first.exit_code, first.stdout) == (0, again.stdout)
    assert runs_in((folder / "found" / "cases.jsonl").read_text().splitlines()) == runs_in(lines)
    assert json.loads(first.stdout)["runs"] == 6


def test_keys_of_the_grid_are_varied_however_they_are_spelled(folder, monkeypatch):
    varied = []

    def search(*_, vary, **__):
        varied.append(vary)
        raise ValueError("enough")

    monkeypatch.setattr("desim.study.breaking.search.find_violation", search)
    for words in (["-g", " horizon=4,5", "-g", "team.count =2,3"], ["-g", '"horizon"=4,5'], []):
        desim("break", "game.toml", *words, "--set", "sweep.grid.seed=[1,2]")
    assert varied == [{"horizon": (4, 5), "team.count": (2, 3)}, {"horizon": (4, 5)}, {}]


@pytest.mark.whole
def test_losses_are_tried_one_by_one(folder):
    result = desim(
        "break", "short.toml", "--property", CROWDED, "--losses", 1, "--set", "seed=1", "-o", "found", "--keep", "kept"
    )
    assert "if these are lost:\n  message " in result.stdout
    assert result.exit_code == VIOLATED
    smallest = load(folder / "found" / "smallest.toml")
    assert [load(kept) for kept in (folder / "kept").iterdir()] == [smallest]
    document = json.loads((folder / "found" / "break.json").read_text())
    margins = [fatal["verdict"]["margin"] for fatal in document["fatal"]]
    assert judge(smallest.properties[0], run(smallest)).margin == min(margins) < 0.0
    late = desim("break", "short.toml", "--property", CROWDED, "--losses", 1, "--delay", 0.001, "-s", 1, "-o", "late")
    assert late.stdout.startswith("no violation with at most 1 message late by 0.001 s (")


@pytest.mark.whole
def test_messages_are_lost_late_or_repeated(folder):
    options = ("--losses", 2, "--fate", "late", "--fate", "lost", "--delay", 1.5, "--set", "seed=1", "-o", "found")
    result = desim("break", "short.toml", "--property", CROWDED, *options)
    assert "with these:\n  lost: message " in result.stdout
    assert "\n  late by 1.5 s: message " in result.stdout
    assert "at most 2 messages lost or late by 1.5 s: " in result.stdout
    document = strict_json((folder / "found" / "break.json").read_text())
    assert {message["fate"] for fatal in document["fatal"] for message in fatal["messages"]} == {"lost", "late"}
    worst = min(document["fatal"], key=lambda fatal: fatal["verdict"]["margin"])
    smallest = load(folder / "found" / "smallest.toml")
    assert judge(smallest.properties[0], run(smallest)).margin == worst["verdict"]["margin"] < 0.0
    twice = desim("break", "short.toml", "--property", CROWDED, "--losses", 1, "--fate", "twice", "--delay", 0.3)
    assert "no violation with at most 1 message repeated after 0.3 s (1 run," in twice.stdout


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--property", "always active >= 0"], "says nothing"),
        (["--property", "coverd"], "should be"),
        (["--protocol", "centralised"], "its own reference"),
        (["--protocol", "centralized"], "did you mean"),
        (["--feature", "lag"], "--feature: there is no 'lag'"),
        (["--feature", "latenc"], "did you mean 'latency'?"),
        (["--property", "coverd"], "--property 'coverd': should be"),
        (["--protocol", "cbbaa"], "--protocol cbbaa: protocol.kind: there is no 'cbbaa'"),
        (["--protocol", "evil:rule"], "--allow-import"),
        (["-g", "team.count=few"], "-g: team.count: should be an integer"),
        (["--grid", "team.count=few"], "--grid: team.count: should be an integer"),
        (["--budget", "nan"], "--budget should be positive"),
        (["--budget", -1], "'--budget': -1.0 should be a number above 0; Begin no further cases"),
        (["--losses", 1, "--delay", "nan"], "--delay should be positive"),
        (["-n", 5, "--losses", 1], "-n is only used without --losses"),
        (["-g", "network.loss=0.1,1.5"], "network.loss"),
        (["-g", "network.los=0.1"], "network.los"),
        (["--losses", 1, "--budget", 5], "--budget is only used without --losses"),
        (["--losses", 1, "--guided"], "--guided is only used without --losses"),
        (["--delay", 0.5], "--delay is only used with --losses"),
        (["--fate", "late"], "--fate is only used with --losses"),
        (["--losses", 1, "--fate", "late"], "'late' needs a delay, in s"),
        (["--losses", 1, "--fate", "lte"], "lost"),
        (["--losses", 1, "--delay", -1], "--delay"),
        (["--budget", 0], "--budget"),
    ],
)
def test_bad_use_is_told(folder, options, why):
    assert why.lower() in refused("break", "game.toml", *options).lower()


@pytest.mark.slow
def test_a_property_of_a_function_beside_the_file(folder):
    """It is the text of whoever typed the command, so its code is run; a function that fails is no violation."""
    (folder / "quantities.py").write_text(
        "def late(result):\n    return [(0.0, 0.0), (1.0, 2.0)]\n\ndef none(result):\n    return 3\n"
    )
    command = ("break", "game.toml", "-n", 2, "--feature", "latency", "-j", 1, "-o", "found", "--property")
    found = desim(*command, "quantities:late at most 1 in total", "--keep", "kept")
    assert "violated in case 1: seed 1000000, margin -" in found.stdout
    assert [*Path("kept").glob("cbaa-quantities_late_at_most_1_in_total-1000000-*.toml")]
    for text, why in (
        ("quantities:none at most 1 in total", "property 'quantities:none at most 1 in total' cannot be judged: "),
        ("quantities:lat at most 1 in total", "did you mean 'late'"),
        ("quantity:late at most 1 in total", "also searched in the folder of the file"),
    ):
        assert why in refused(*command, text)


@pytest.mark.slow
def test_a_rule_that_raises_is_told_without_a_replay(folder):
    (folder / "rules.py").write_text("def raises(me):\n    yield me.sleep(0.5)\n    raise KeyError('planted')\n")
    (folder / "own.toml").write_text(GAME.replace('"cbaa"', '"rules:raises"'))
    result = desim(
        "break", "own.toml", "--allow-import", "--feature", "latency", "--keep", "kept", "-o", "found", "-n", 2
    )
    assert result.exit_code == VIOLATED
    assert "failed in case 1: seed 1000000, KeyError: 'planted'" in result.stdout
    again = f"PYTHONPATH={folder} desim run found/smallest.toml --allow-import"
    assert f"no replay, as the run fails: {again}" in result.stdout
    text = (folder / "found" / "smallest.toml").read_text()
    assert text.startswith("# raises fails here: KeyError: 'planted'.")
    assert f"# Look: {again}\n" in text
    assert "[network.transport]" not in text, "defaults are left out"
    again = desim("break", "own.toml", "--allow-import", "--keep", "kept", "-o", "found", "-n", 2)
    assert re.match(r"kept: kept/raises-covered-1000000-\w{8}\.toml: fails: KeyError: 'planted'", again.stdout)


def test_a_file_without_properties_needs_one(folder):
    (folder / "bare.toml").write_text("seed = 1\n")
    assert 'give one, for instance --property "idle' in refused("break", "bare.toml")


def test_a_file_that_names_code_runs_none(folder):
    (folder / "code.toml").write_text(GAME.replace('"cbaa"', '"evil:rule"'))
    (folder / "evil.py").write_text("raise SystemExit('it ran')\n")
    assert "--allow-import" in refused("break", "code.toml")

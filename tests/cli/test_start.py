"""`desim examples` and `desim new`: files to start from, which run as they are."""

import re
import runpy

import pytest

from desim.cli import main
from desim.scenario.templates import TEMPLATES
from desim.scenario.toml import load
from scenarios.studies.study import SCENARIOS
from tests.command import accepted, desim, refused


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_examples_lists_every_scenario_file_with_a_sentence_about_it():
    lines = accepted("examples").stdout.splitlines()
    assert [line.partition(": ")[0] for line in lines] == sorted(path.stem for path in SCENARIOS.glob("*.toml"))
    assert "many: Six pursuers and three evaders." in lines
    assert all(line.endswith((".", "?")) for line in lines)


def test_an_example_is_copied_with_the_files_that_it_names(folder):
    said = accepted("examples", "wired").stdout
    assert said == "wrote wired.toml\nwrote wired.json\nrun it: desim run wired.toml\n"
    assert sorted(path.name for path in folder.iterdir()) == ["wired.json", "wired.toml"]
    assert load(folder / "wired.toml") == load(SCENARIOS / "wired.toml")
    assert (folder / "wired.toml").read_bytes() == (SCENARIOS / "wired.toml").read_bytes()


def test_an_example_is_copied_to_a_file_or_into_a_folder_that_need_not_exist(folder):
    accepted("examples", "wired.toml", "a/b")
    accepted("examples", "wired", "a/mine.toml")
    found = sorted(str(path.relative_to(folder)) for path in folder.rglob("*.*"))
    assert found == ["a/b/wired.json", "a/b/wired.toml", "a/mine.toml", "a/wired.json"]
    assert "'my runs/relay.toml'" in accepted("examples", "relay", "my runs").stdout


def test_an_example_overwrites_nothing(folder):
    (folder / "wired.json").write_text("mine")
    said = refused("examples", "wired")
    assert said == "wired.json: cannot be written: exists already and is not overwritten: move it, or write elsewhere\n"
    (folder / "relay.toml").symlink_to(folder / "elsewhere.toml")
    assert refused("examples", "relay").startswith("relay.toml: cannot be written: exists already")
    assert sorted(path.name for path in folder.iterdir()) == ["relay.toml", "wired.json"]
    assert (folder / "wired.json").read_text() == "mine"
    assert refused("examples", "relay", "wired.json").startswith("wired.json: cannot be written: ")


def test_an_example_that_does_not_exist_is_refused_with_those_that_do(folder):
    said = refused("examples", "rely")
    assert said.startswith("there is no example 'rely', did you mean 'relay'?; allowed: auction, bursts, ")


@pytest.mark.parametrize("what", TEMPLATES)
def test_a_new_file_runs_with_the_command_that_is_printed(what, folder):
    wrote = accepted("new", what, f"my_{what}").stdout.splitlines()
    files = [f"my_{what}.toml"]
    if what != "scenario":
        files = [f"my_{what}.py", f"test_my_{what}.py", *files]
        assert wrote.pop() == f"check it: python test_my_{what}.py"
    command = wrote.pop()
    assert wrote == [f"wrote {file}" for file in files]
    words = command.removeprefix("run it: desim ").split()
    assert words == ["run", files[-1], *([] if what == "scenario" else ["--allow-import"])]
    run = accepted(*words, "--set", "horizon=0.5")
    assert run.stdout.startswith(f"my_{what}: 8 pursuers")
    assert run.stderr == ""
    if what == "metric":
        assert "between two decisions of a pursuer" in run.stdout.split("my metric")[1].splitlines()[0]
    elif what != "scenario":
        assert f"my_{what}:My{what.title()}" in accepted("check", *words[1:]).stdout
    planned = accepted("sweep", *words[1:], "--dry-run")
    assert planned.stderr == ""
    text = "".join((folder / file).read_text() for file in files)
    template = "".join((SCENARIOS / "templates" / file).read_text() for file in files)
    assert text == template


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("what", [what for what in TEMPLATES if what != "scenario"])
def test_a_new_file_passes_the_test_that_comes_with_it(what, folder, monkeypatch, capsys):
    accepted("new", what, "mine_own")
    monkeypatch.syspath_prepend(folder)
    runpy.run_path("test_mine_own.py", run_name="__main__")
    assert capsys.readouterr().out == f"{'mine_own' if what == 'metric' else 'MineOwn'} passes check_{what}\n"


def test_a_new_file_overwrites_nothing(folder):
    (folder / "mine.toml").write_text("seed = 1\n")
    for what in TEMPLATES:
        assert (
            refused("new", what, "mine")
            == "mine.toml: cannot be written: exists already and is not overwritten: move it, or write elsewhere\n"
        )
    assert [path.name for path in folder.iterdir()] == ["mine.toml"]


@pytest.mark.parametrize(
    ("what", "name", "why"),
    [
        ("protocol", "my-rule", "'my-rule' should be an identifier: letters, digits and _, my_rule for instance"),
        ("scenario", "../evil", "'../evil' should be an identifier"),
        ("scenario", "", "'' should be an identifier"),
        (
            "metric",
            "lambda",
            "'lambda' is a word of Python itself, which no module can have; choose another, my_lambda",
        ),
        ("evader", "random", "'random' is the name of an installed module, which would hide random.py"),
        ("latency", "protocols", "'protocols' is the name of an installed module, which would hide protocols.py"),
        ("metric", "longest_pause", "'longest_pause' is the name of a function or class that longest_pause.py uses"),
    ],
)
def test_a_name_that_no_module_can_have_is_refused(what, name, why, folder):
    assert refused("new", what, name).startswith(why)
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("what", TEMPLATES)
def test_a_template_with_another_name_keeps_nothing_of_its_own(what, folder):
    accepted("new", what, "aim")
    texts = [path.read_text() for path in folder.iterdir()]
    assert not any(f"my_{what}" in text or f"My{what.title()}" in text for text in texts)


@pytest.mark.slow
def test_a_class_is_named_after_its_module(folder):
    for name, expected in [("none", "none:none"), ("a__b", "a__b:AB"), ("_1", "_1:_1"), ("myRule", "myRule:MyRule")]:
        accepted("new", "protocol", name)
        assert f'kind = "{expected}"' in (folder / f"{name}.toml").read_text()
        accepted("check", f"{name}.toml", "--allow-import")


def test_the_help_has_a_whole_line_for_each_command():
    text = accepted("--help").stdout
    lines = dict(re.findall(r"^  ([a-z]+) {2,}(\S.*)$", text, re.MULTILINE))
    assert set(lines) == set(main.commands)
    assert [name for name, line in lines.items() if not line.endswith(".") or line.endswith("...")] == []
    assert "desim examples relay && " in text
    assert desim().output == text, "also without an argument"

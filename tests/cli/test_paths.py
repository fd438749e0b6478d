"""Paths that name another thing, or nothing: what each command says instead is golden."""

import shutil
from pathlib import Path

import pytest

import desim
from desim.results.run_folder import write
from desim.scenario.examples import examples
from tests.command import desim as command
from tests.command import refused
from tests.golden import golden

SHORT = desim.Scenario(name="short", horizon=0.01, team={"count": 2})
COMMANDS = """
    check plian.toml
    run plain
    run relay
    run .
    run swept
    run one/run.json
    run --from onee/run.json
    sweep plian.toml -g team.count=2,3
    explain plian.toml
    race plian.toml --zone 1 -g team.count=2,3
    break plian.toml
    sensitivity plian.toml
    live plian.toml
    submit plian.toml --array 2
    netem plian.toml
    play plian.toml --no-browser
    fates one/trace.jsonl plian.toml
    fates none.csv plain.toml
    plot swpet
    plot zzzz
    plot swept/swep.sqlite
    plot swept/zzzz.sqlite
    plot one/trac.jsonl
    plot nowhere/trace.jsonl
    plot empty/trace.jsonl
    replay swept/trace.jsonl
    report nowhere/sweep.sqlite
    export one/trace.json x.csv
    plot both
    plot parts
    plot empty
    replay onee
    replay swept
    replay empty
    replay parts
    export swpet x.csv
    export both x.csv
    export empty x.csv
    report swpet
    report one
    report parts
    report empty
    compare swept swpet
    compare one swept
    compare swept both
    compare swept parts
    compare swept empty
    crossover swpet team.count --over 10%
    crossover one team.count --over 10%
    status swpet
    status one
    status empty
    status plain.toml
    ls swpet
    ls plain.toml
    merge swpet -o made
    merge one -o made
    merge empty -o made
    keys plian.toml
    protocols plian:rule --allow-import
"""
"""In a folder with a scenario file, a run, a sweep, a folder of both, one with a part of a sweep, and an empty one."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("paths")
    (made / "plain.toml").write_text("horizon = 0.01\nteam.count = 2\n")
    for name in ("swept", "both", "parts", "empty"):
        (made / name).mkdir()
    desim.sweep(SHORT, {"network.loss.p": [0.0, 0.5]}, 1, store=made / "swept" / "sweep.sqlite")
    write(desim.run(SHORT, 1), made / "one", drawn=False)
    for file in (*(made / "one").iterdir(), made / "swept" / "sweep.sqlite"):
        shutil.copy(file, made / "both")
    shutil.copy(made / "swept" / "sweep.sqlite", made / "parts" / "sweep.1-of-2.sqlite")
    return made


def test_what_commands_say_of_wrong_paths_is_golden(folder, monkeypatch):
    monkeypatch.chdir(folder)
    before = sorted(Path().rglob("*"))
    parts = {}
    for words in filter(None, map(str.strip, COMMANDS.splitlines())):
        result = command(*words.split())
        parts[f"desim {words}"] = result.output.replace(f"{folder}/", "").replace(str(folder), "FOLDER").strip()
        assert (words, result.exit_code) == (words, 2)
    golden("refused_paths.txt", parts)
    assert sorted(Path().rglob("*")) == before


@pytest.mark.parametrize("words", ["run", "plot", "ls", "merge -o x", "run --from", "netem --from"])
def test_a_path_of_which_the_system_says_nothing_is_refused(words):
    """As it does of a path in a folder that is closed to the user."""
    assert "a" * 300 in refused(*words.split(), "a" * 300)


@pytest.mark.parametrize("words", ["LONG", "keys LONG", "keys network.LONG", "run MID", "report PATH", "plot FILE"])
def test_a_word_that_is_too_long_for_a_path_is_refused(words, tmp_path, monkeypatch):
    """FILE exists, and the pictures that are named after it cannot; PATH is as long as a path may be without a file."""
    monkeypatch.chdir(tmp_path)
    long = {"LONG": "a" * 300, "MID": "b" * 252, "PATH": "/".join(["c" * 200] * 20) + "/" + "d" * 72}
    long["FILE"] = "e" * 250 + ".toml"
    Path(long["FILE"]).write_text("horizon = 0.01\nteam.count = 2\n", encoding="utf-8")
    typed = [long.get(word, word.replace("LONG", long["LONG"])) for word in words.split()]
    assert typed[-1].removesuffix(".toml")[-50:] in refused(*typed)


def test_a_folder_that_is_too_deep_for_the_scripts_of_a_sweep_is_refused():
    deep = "/".join(["c" * 200] * 20) + "/" + "d" * 60
    assert "too long" in refused(
        "submit", examples()["relay"], "--array", "1", "-g", "team.count=3", "-n", "1", "-o", deep
    )


def test_a_folder_that_is_closed_to_the_user_is_not_exported(tmp_path, monkeypatch):
    def exists(path):
        if path.parent == tmp_path:
            raise PermissionError(13, "Permission denied", str(path))
        return True

    monkeypatch.setattr(Path, "exists", exists)
    assert refused("export", tmp_path, "x.csv") == f"{tmp_path / 'trace.jsonl'}: Permission denied\n"

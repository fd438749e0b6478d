"""Paths that name another thing, or nothing: what each command says instead is golden."""

import shutil
from pathlib import Path

import pytest

import desim
from desim.results.run_folder import write
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

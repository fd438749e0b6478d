"""The code and the commands of the README and the pages run, and the modules and keys that they name exist.

A block whose first line is `# NAME.py`, `# NAME.toml` or `# NAME.csv` is the content of that file. In a folder that
holds a copy of the scenarios, the files of a page are written first; then its Python runs, block after block; then its
commands.
"""

import ast
import re
import shlex
import shutil
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import get_args
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

from desim import Announcements, Scenario
from tests.command import accepted
from tests.conftest import undraw
from tests.test_architecture import PACKAGES, ROOMS, may_import, package_of

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted(ROOT.glob("docs/howto/*.md")), *sorted(ROOT.glob("docs/explanation/*.md"))]
TEXTS = {path.relative_to(ROOT).with_suffix("").as_posix(): path.read_text(encoding="utf-8") for path in PAGES}
GENERATED = ("docs/gallery/", "docs/reference/", "docs/explanation/packages.svg")
"""Folders of pages, and the picture, that are made from the code before a build."""


def blocks(text, language):
    """Return the content of each fenced block of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def commands(text):
    """Return the words of each command `desim` in the blocks of a shell."""
    lines = [line for block in blocks(text, "sh") for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith("desim ")]


def small(words):
    """Return the words of a command that simulates little: 1.5 s, or two runs of 0.2 s of each, in this process."""
    several = words[0] in {"sweep", "explain"} or "-n" in words
    size = ["-n", "2"] if several else []
    if words[0] != "check" and any(word.endswith(".toml") for word in words):
        size += ["--set", f"horizon={0.2 if several else 1.5}"]
    return [*words, *size, *(["-j", "1"] if "-j" in words else [])]


PROGRAMS = {
    path.relative_to(ROOT).as_posix(): "\n".join(code)
    for path in [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]
    if (code := blocks(path.read_text(encoding="utf-8"), r"(?:python|\{code-cell\}.*)"))
}
"""The Python of each page."""


@pytest.mark.parametrize("page", PROGRAMS)
def test_what_a_page_imports_of_desim_exists(page):
    """The code itself runs in slow tests, and when the site is built."""
    program = ast.parse(PROGRAMS[page])
    for node in ast.walk(program):
        if isinstance(node, ast.Import):
            names = [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [(node.module, alias.name) for alias in node.names]
        else:
            continue
        for module, name in names:
            if module.partition(".")[0] in {"desim", "protocols", "scenarios"}:
                assert name is None or hasattr(import_module(module), name) or find_spec(f"{module}.{name}"), (
                    module,
                    name,
                )


def is_page_with(part):
    return pytest.mark.parametrize("page", [name for name, text in TEXTS.items() if part(text)])


@pytest.fixture
def folder(page, tmp_path, monkeypatch):
    """Go to a folder with the scenarios and the files of a page."""
    shutil.copytree(ROOT / "scenarios", tmp_path / "scenarios", ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    for block in (*blocks(TEXTS[page], "python"), *blocks(TEXTS[page], "toml"), *blocks(TEXTS[page], "text")):
        if name := re.match(r"# (\w+\.(?:py|toml|csv))\n", block):
            (tmp_path / name[1]).write_text(block, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def brief(monkeypatch):
    """Let scenarios that are made in Python last 1.5 s, unless they say how long."""
    begin = Scenario.__init__
    monkeypatch.setattr(Scenario, "__init__", lambda self, **given: begin(self, **{"horizon": 1.5} | given))


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.usefixtures("brief")
@is_page_with(lambda text: blocks(text, "python") or commands(text))
def test_the_python_and_the_commands_of_a_page_run(page, folder, monkeypatch):
    """Python runs as a program of its own would; pictures are drawn where the command is there for them."""
    program = ModuleType("__main__")
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "__main__", program)
        exec("\n".join(blocks(TEXTS[page], "python")), vars(program))
    for words in commands(TEXTS[page]):
        with monkeypatch.context() as patch:
            if words[0] in {"run", "sweep", "explain", "report"}:
                undraw(patch)
            accepted(*small(words))


@pytest.mark.whole
@pytest.mark.parametrize("page", ["docs/howto/cluster"])
def test_the_script_of_a_batch_system_runs_its_part(page, folder, monkeypatch):
    """Part 3 of 20 of one run of each of 12 configurations: the third."""
    (script,) = blocks(TEXTS[page], "bash")
    assert "-n 1000" in script
    (folder / "sweep.sbatch").write_text(script.replace("-n 1000", "-n 1 --set horizon=1.0"))
    (folder / ".venv/bin").mkdir(parents=True)
    (folder / ".venv/bin/activate").touch()
    (folder / "bin").mkdir()
    (folder / "bin/desim").write_text(f'#!/bin/sh\nexec "{sys.executable}" -P -m desim "$@"\n')
    (folder / "bin/desim").chmod(0o755)
    monkeypatch.setenv("PATH", str(folder / "bin"), prepend=":")
    for name, value in {"SUBMIT_DIR": str(folder), "ARRAY_TASK_ID": "3", "CPUS_PER_TASK": "2"}.items():
        monkeypatch.setenv(f"SLURM_{name}", value)
    done = subprocess.run(["bash", "sweep.sbatch"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "1 run in" in done.stderr
    assert (folder / "out/imperfect/part-3/sweep.3-of-20.sqlite").exists()


def test_the_table_of_packages_equals_their_docstrings():
    text = TEXTS["docs/explanation/packages"]
    rows = re.findall(r"^\| `((?:desim|protocols|scenarios)/[\w/]*)` \| (.+) \|$", text, re.MULTILINE)
    inits = [
        *(ROOT / "desim").glob("*/**/__init__.py"),
        *(ROOT / "protocols").rglob("__init__.py"),
        *(ROOT / "scenarios").rglob("__init__.py"),
    ]
    assert sorted(name for name, _ in rows) == sorted(f"{path.parent.relative_to(ROOT)}/" for path in inits)
    for name, said in rows:
        assert said == " ".join(import_module(name.strip("/").replace("/", ".")).__doc__.split())


def test_the_table_of_announcements_has_every_key_and_every_payload():
    _, _, text = TEXTS["docs/explanation/negotiation"].partition("## Announcements")
    keys = re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
    assert keys == [*Announcements.model_fields]
    (payloads,) = (row for row in text.splitlines() if row.startswith("| `payload`"))
    assert re.findall(r"`(\w+)`", payloads)[1:] == [*get_args(Announcements.model_fields["payload"].annotation)]


def test_the_picture_of_the_layers_is_that_of_the_imports():
    (picture,) = blocks(TEXTS["docs/explanation/packages"], "text")
    assert [set(line.split()) for line in reversed(picture.splitlines())] == PACKAGES


@pytest.mark.whole
def test_the_picture_of_the_rooms_has_all_of_them_and_no_arrow_upwards(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    import_picture = import_module("import_picture")
    rooms = import_picture.imports()
    assert set(rooms) == ROOMS
    assert all(may_import(here, there) for here, there in rooms.edges)
    boxes = [room for room in ROOMS if sum(package_of(other) == package_of(room) for other in ROOMS) > 1]
    names = [*(package for floor in PACKAGES for package in floor), *(room.split(".")[-1] for room in boxes)]
    drawn = ElementTree.fromstring(import_picture.picture(rooms))
    assert sorted(text.text for text in drawn.iter() if text.tag.endswith("}text")) == sorted(names)
    ends = [float(rect.get("x")) + float(rect.get("width")) for rect in drawn.iter() if rect.get("class") == "room"]
    assert max(ends) < import_picture.WIDTH - import_picture.MARGIN


@pytest.mark.parametrize("path", PAGES, ids=TEXTS)
def test_every_file_a_page_links_to_exists(path):
    for link in re.findall(r"\]\((?!https?://|#)([^)#]+)", path.read_text(encoding="utf-8")):
        found = (path.parent / link).resolve().relative_to(ROOT)
        assert (ROOT / found).exists() or found.as_posix().startswith(GENERATED), link


@pytest.mark.slow
def test_every_paper_that_the_code_or_a_page_cites_is_in_the_bibliography():
    """A citation is the names of the authors and the year."""
    text = (ROOT / "docs/references.bib").read_text(encoding="utf-8")
    entries = re.split(r"^@", re.sub(r"[{}]", "", text), flags=re.MULTILINE)
    name = r"[A-ZÉ][\w\-]+(?: [A-Z][\w\-]+)?"
    cited = re.compile(rf"({name})(?:(?:, {name})*,? & {name}| et al\.)?,? \(?((?:19|20)\d\d)\b(?!-)")
    files = [*ROOT.glob("protocols/*.py"), *ROOT.glob("desim/**/*.py")]
    texts = [(file.name, re.findall(r'"""(.*?)"""', file.read_text(encoding="utf-8"), re.S)) for file in files]
    texts += [(page, [text]) for page, text in TEXTS.items() if page.startswith("docs/explanation")]
    found = [
        (name, first.split()[-1], year)
        for name, parts in texts
        for part in parts
        for first, year in cited.findall(" ".join(part.split()))
    ]
    assert ("docs/explanation/negotiation", "Metropolis", "1953") in found
    known = {(name, first, year) for name, first, year in found if any(first in e and year in e for e in entries)}
    assert set(found) - known == set()


@pytest.mark.parametrize("page", TEXTS)
def test_every_path_a_page_names_exists(page):
    text = re.sub(r"https?://\S+", "", TEXTS[page])
    for path in re.findall(r"(?:scenarios|desim|protocols|tests)/[\w./]*\w", text):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize("page", TEXTS)
def test_every_module_and_key_of_desim_a_page_names_exists(page):
    for name in set(re.findall(r"`((?:desim|protocols)(?:\.\w+)+)", TEXTS[page])) - {"desim.protocols"}:
        if name in {"desim.disseminations", "desim.exporters", "desim.metrics"}:  # groups of entry points
            continue
        parts = name.split(".")
        for k in range(len(parts), 0, -1):
            try:
                found = import_module(".".join(parts[:k]))
            except ModuleNotFoundError:
                continue
            for part in parts[k:]:
                found = getattr(found, part)
            break


@pytest.mark.parametrize("module", sorted(set(re.findall(r"python -m (scenarios[\w.]+)", "".join(TEXTS.values())))))
def test_every_study_a_page_names_has_help(module):
    program = f"{module}.__main__" if find_spec(module).submodule_search_locations else module
    done = CliRunner().invoke(import_module(program).main, ["--help"], catch_exceptions=False)
    assert done.exit_code == 0
    assert done.stdout.startswith("Usage:")

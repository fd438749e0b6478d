"""What the README says runs."""

import re
import shlex
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner

from desim.scenario.toml import read
from desim.study.configurations import configurations
from tests.command import accepted

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
TABLES = re.findall(r"```toml\n(.*?)```", README, flags=re.DOTALL)
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.slow
def test_the_python_of_the_readme_runs_block_after_block():
    program = "\n".join(BLOCKS)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "s of active time" in done.stdout
    assert "[9, 9, 9, 9, 9, 9, 9, 9]" in done.stdout


@pytest.mark.parametrize(
    "words",
    [
        ["check", "mine.toml", "--allow-import"],
        pytest.param(["run", "{}/mine.toml", "-n", "2", "-j", "2", "--allow-import"], marks=pytest.mark.slow),
    ],
)
def test_the_rule_of_the_readme_runs_from_a_file_beside_its_module(words, tmp_path):
    (rule,) = [block for block in BLOCKS if "class Stubborn" in block]
    (table,) = [each for each in TABLES if "my_rules" in each]
    assert len(rule.splitlines()) < 60
    (tmp_path / "my_rules.py").write_text(rule)
    (tmp_path / "mine.toml").write_text("horizon = 5.0\n" + table)
    words = [word.format(tmp_path) for word in words]
    done = subprocess.run(
        [sys.executable, "-P", "-m", "desim", *words], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert "mine: 20 pursuers" in done.stdout or "inertia = 0.5" in done.stdout


def test_the_metric_of_the_readme_is_measured_from_a_module_beside_the_file(tmp_path):
    (module,) = [block for block in BLOCKS if "handover_rate = Metric" in block]
    (tmp_path / "my_metrics.py").write_text(module)
    (tmp_path / "mine.toml").write_text("horizon = 5.0\n")
    (words,) = re.findall("^`desim (run FILE --metric .*?)` measures it", README, flags=re.MULTILINE)
    shown = accepted(*words.replace("FILE", str(tmp_path / "mine.toml")).split()).stdout
    assert re.search(r"^handover rate +\d\.\d{3} 1/s +over the whole run$", shown, flags=re.MULTILINE)


def test_the_grid_of_the_readme_is_one_of_its_example():
    (table,) = [each for each in TABLES if "sweep.grid" in each]
    base = read(ROOT / "scenarios/imperfect.toml")
    grid = tomllib.loads(table)["sweep"]["grid"]
    assert len(configurations(base, grid)) == 4 * 3 * 2


def test_the_table_of_packages_equals_their_docstrings():
    rows = re.findall(r"^\| `((?:desim|protocols|scenarios)/\w*/?)` \| (.+) \|$", README, re.MULTILINE)
    packages = [path.parent.relative_to(ROOT) for top in ("desim", "protocols", "scenarios") for path in _inits(top)]
    assert sorted(name for name, _ in rows) == sorted(f"{each}/" for each in packages)
    for name, said in rows:
        assert said == " ".join(import_module(name.strip("/").replace("/", ".")).__doc__.split())


def _inits(top):
    return (ROOT / "desim").glob("*/__init__.py") if top == "desim" else [ROOT / top / "__init__.py"]


@pytest.mark.parametrize("path", sorted(set(re.findall(r"(?:scenarios|desim|protocols|tests)/[\w./]*\w", README))))
def test_every_path_the_readme_names_is_there(path):
    assert (ROOT / path).exists() or (ROOT / "desim" / path).exists()


@pytest.mark.parametrize("module", sorted(set(re.findall(r"python -m ([\w.]+)", README))))
def test_every_study_the_readme_names_has_help(module):
    done = CliRunner().invoke(import_module(module).main, ["--help"], catch_exceptions=False)
    assert done.exit_code == 0
    assert done.stdout.startswith("Usage:")


@pytest.mark.slow_but_one
@pytest.mark.parametrize("line", [line[10:] for line in README.splitlines() if line.startswith("    desim ")])
def test_every_command_the_readme_names_runs(line, tmp_path, monkeypatch):
    """Each for 1.5 s of simulated time and, where it makes many runs, for two of each in this process."""
    monkeypatch.chdir(ROOT)
    words = shlex.split(line.split("#")[0].split(">")[0])
    words = [str(tmp_path / word) if word.startswith("out/") else word for word in words]
    if words[0] in {"run", "sweep", "explain", "replay", "plot"} and any(word.endswith(".toml") for word in words):
        words += ["--set", "horizon=1.5"]
    if "-j" in words:
        words += ["-j", "1", "-n", "2"]
    if words[0] in {"sweep", "explain"}:
        words += ["-o", str(tmp_path / "out")]
    accepted(*words)

"""What the shell completes, asked for as a shell does."""

import os
import subprocess
import sys

import pytest
from click.shell_completion import ShellComplete

from desim.cli import completion, main
from desim.scenario.scenario import PROTOCOLS
from scenarios.studies.study import SCENARIOS


def completed(*words: str) -> list[str]:
    """Return the completions of the last word."""
    *before, incomplete = words
    return [each.value for each in ShellComplete(main, {}, "desim", "").get_completions(before, incomplete)]


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """Return the path of the kept keys, in a folder of the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "desim/keys.txt"


def test_the_keys_are_kept_until_the_source_changes(cache, monkeypatch):
    made = []
    monkeypatch.setattr(completion, "all_completions", lambda: made.append(1) or [f"seed{len(made)}="])
    assert completed("run", "f.toml", "--set", "se") == completed("run", "f.toml", "--set", "se") == ["seed1="]
    state = completion._state()
    monkeypatch.setattr(completion, "_state", lambda: state + " newer")
    assert completed("run", "f.toml", "--set", "se") == ["seed2="]
    assert cache.read_text() == f"{state} newer\nseed2="


def test_the_keys_are_completed_without_a_cache(monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    assert completed("run", "f.toml", "--set", "hori") == ["horizon="]


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "check", "sweep", "explain", "replay", "plot"])
def test_a_key_is_completed(command):
    found = completed(command, "f.toml", "--set", "network.latency.")
    assert {"network.latency.value=", "network.latency.kind=lognormal"} <= set(found)
    assert all(each.startswith("network.latency.") for each in found)
    assert "network.range=" in completed(command, "f.toml", "--set", "net")
    assert completed(command, "f.toml", "--set", "horizon=3", "--set", "hori") == ["horizon="]
    assert completed(command, "f.toml", "--set", "protocol.kind=cb") == ["protocol.kind=cbaa", "protocol.kind=cbba"]
    assert completed(command, "f.toml", "--set", "nonsense") == []


def test_a_key_of_the_grid_is_completed():
    assert completed("sweep", "f.toml", "-g", "network.ran") == ["network.range=", "network.range_check="]


@pytest.mark.slow
def test_each_kind_is_completed_with_the_key_that_takes_it():
    """A fault is one of a list, so its kind is that of the first."""
    words = completion.all_completions()
    assert words == sorted(set(words))
    assert {"fault=", "fault.0.kind=crash", "network.loss.kind=bernoulli", "protocol.kind=sap"} <= set(words)
    keyed = [word for word in words if not word.endswith("=")]
    assert not any(word.startswith("fault.kind=") for word in keyed)
    assert {word.partition(".kind=")[0] for word in keyed} - {"fault.0"} <= {word.removesuffix("=") for word in words}


def test_the_kinds_of_protocols_are_completed():
    assert completed("protocols", "s") == ["sap", "selective_sap", "server"]
    assert completed("protocols", "") == sorted(PROTOCOLS.choices())


def test_the_names_of_examples_and_of_starting_files_are_completed():
    assert completed("examples", "rec") == ["reckoning", "recorded"]
    assert completed("examples", "rel") == ["relay", "reliable"]
    assert completed("examples", "") == sorted(path.stem for path in SCENARIOS.glob("*.toml"))
    assert completed("new", "pro") == ["protocol"]
    assert completed("exa") == ["examples"]


@pytest.mark.slow
@pytest.mark.parametrize("words", ["run f.toml --set net", "protocols s", "examples r"])
def test_the_shell_is_answered_without_a_slow_import(words):
    program = (
        "import sys\nfrom desim.cli import main\n"
        "try:\n    main(prog_name='desim')\nexcept SystemExit:\n    pass\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    completion.keys(None, None, "")
    count = len(words.split())
    asked = {"_DESIM_COMPLETE": "bash_complete", "COMP_WORDS": f"desim {words}", "COMP_CWORD": str(count)}
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | asked, capture_output=True, text=True, check=True
    )
    assert len(done.stdout.splitlines()) > 1
    loaded = set(done.stderr.split())
    assert "desim.cli.completion" in loaded
    assert not loaded & {"numpy", "scipy", "simpy", "networkx", "pydantic", "matplotlib"}

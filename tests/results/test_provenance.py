"""run.json: its contents, refusals, and repeating a run from it byte for byte."""

import errno
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from functools import partial
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

from desim.config.model import Value
from desim.config.own_modules import plain_name
from desim.kernel.core.seeds import run_seed
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.results import environment, provenance
from desim.results.provenance import ProvenanceError, differences, document, of_one, read, source, write
from desim.scenario.overrides import ScenarioError
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Scenario
from desim.scenario.sweep_table import Sweep
from desim.scenario.toml import dump, load, validate
from desim.study.plan.configurations import configurations
from tests.command import accepted, refused, strict_json

ROOT = Path(__file__).parents[2]
SCENARIOS = sorted((ROOT / "scenarios").glob("*.toml"))
COMMIT = "0123456789abcdef0123456789abcdef01234567"
SCENARIO = Scenario(name="caf\u00e9", seed=1, horizon=0.2, team=Team(count=3))
KEYS = [
    "format",
    "what",
    "seed",
    "runs",
    "scenario",
    "folder",
    "unrecorded",
    "versions",
    "platform",
    "commit",
    "dirty",
    "code",
    "argv",
]


@pytest.fixture(autouse=True)
def _committed(monkeypatch):
    """Let the source be that of a commit, however it is here."""
    monkeypatch.setattr(environment, "_checkout", lambda: (COMMIT, False))


# Its contents.


def test_a_document_records_command_inputs_and_environment(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["desim", "run", "a b"])
    monkeypatch.chdir(tmp_path)
    made = document("run", SCENARIO, seed=5, runs=3, folder=Path("below"), grid={"horizon": [1.0]})
    assert list(made) == [*KEYS, "grid"]
    assert made["scenario"] == SCENARIO.plain() | {"seed": 5}
    assert (made["what"], made["seed"], made["runs"]) == ("run", 5, 3)
    assert made["folder"] == str(tmp_path / "below")
    assert (made["commit"], made["dirty"]) == (COMMIT, False)
    assert (made["argv"], made["unrecorded"], made["grid"]) == (["desim", "run", "a b"], [], {"horizon": [1.0]})
    assert SCENARIO.seed == 1


def test_a_study_has_no_scenario_of_its_own():
    made = document("table1", seed=0, runs=30)
    assert list(made) == KEYS
    assert document("table1", seed=0)["runs"] == 1
    assert (made["what"], made["scenario"], made["folder"], made["unrecorded"]) == ("table1", None, None, [])


def test_the_document_of_one_of_several_runs_has_its_seed():
    made = document("run", SCENARIO, seed=5, runs=3)
    assert of_one(made, 7) == document("run", SCENARIO, seed=7, runs=1)
    assert (made["seed"], made["runs"], made["scenario"]["seed"]) == (5, 3, 5)


def test_the_same_run_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write(tmp_path / name, document("run", SCENARIO, seed=5))
    assert (tmp_path / "a" / "run.json").read_bytes() == (tmp_path / "b" / "run.json").read_bytes()


def test_a_record_is_strict_json_in_a_created_folder_and_reads_back_unchanged(tmp_path, monkeypatch):
    """An argument may be no UTF-8 text; infinity is none of JSON's numbers."""
    monkeypatch.setattr(sys, "argv", ["desim", "\udcff", "caf\u00e9"])
    made = document("sweep", SCENARIO, seed=5, grid={"network.range": (4.0, inf, -inf, [nan, 1, "x", None])})
    assert made["grid"] == {"network.range": [4.0, "Infinity", "-Infinity", ["NaN", 1, "x", None]]}
    write(tmp_path / "x" / "y", made, "other.json")
    text = (tmp_path / "x" / "y" / "other.json").read_text(encoding="utf-8")
    assert strict_json(text) == made
    assert text.startswith('{\n  "format": 2,\n  "what": "sweep",\n')
    assert text.endswith("}\n")
    assert read(tmp_path / "x" / "y" / "other.json") == made


def test_values_that_json_cannot_represent_are_not_written(tmp_path):
    with pytest.raises(ValueError, match="Out of range"):
        write(tmp_path, document("run", seed=0) | {"more": inf})


@pytest.mark.parametrize("name", ["write_bytes", "replace"])
def test_a_document_that_cannot_be_written_leaves_no_part_of_it(tmp_path, monkeypatch, name):
    """On a full disk the file is opened, and its text fails. The earlier document stays."""
    write(tmp_path, document("run", seed=0))
    before = (tmp_path / "run.json").read_bytes()

    def full(part, *_, **__):
        part.touch()
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, name, full)
    with pytest.raises(OSError, match="No space left") as caught:
        write(tmp_path, document("run", seed=1))
    assert caught.value.filename == str(tmp_path / "run.json")
    assert [each.name for each in tmp_path.iterdir()] == ["run.json"]
    assert (tmp_path / "run.json").read_bytes() == before


@pytest.mark.slow
def test_it_loads_nothing_that_takes_time_to_import():
    program = "import sys, desim.results.provenance; sys.exit(bool({'numpy', 'pydantic', 'simpy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


# Models whose parameters only they know.


@dataclass
class Delay:
    value: float

    def __call__(self, context, rng):
        return self.value


class Slotted:
    __slots__ = ("other",)

    def __init__(self):
        self.other = 1.0

    def __call__(self, context, rng):
        return self.other


class Stateful:
    def __init__(self):
        self.other = 1.0

    def __call__(self, context, rng):
        return self.other

    def delay(self, context, rng):
        return self.other


class Listed(list):
    def __call__(self, context, rng):
        return self[0]


class Stateless:
    def __call__(self, context, rng):
        return 0.5


class Own(Value):
    value: float = 0.5

    def __call__(self, context, rng):
        return self.value


def half_a_second(context, rng):
    return 0.5


def seconds_of(value, context, rng):
    return value


@pytest.mark.parametrize(
    ("latency", "known"),
    [
        (Stateful(), False),
        (Slotted(), False),
        (Listed([0.5]), False),
        (partial(seconds_of, 0.5), False),
        (Stateful().delay, False),
        (Delay(0.5), True),
        (Stateless(), True),
        (Own(), True),
        (half_a_second, True),
    ],
    ids=["stateful", "slots", "list", "partial", "method", "dataclass", "stateless", "value", "function"],
)
def test_a_model_whose_parameters_are_not_recorded_is_named(latency, known):
    links = Links(
        latency=latency, link=[{"src": 0, "dst": 1, "order": "fifo"}, {"src": 0, "dst": 2, "latency": latency}]
    )
    swept = {"grid": {"network.latency": [0.5, latency]}}
    made = document("run", Scenario(team=Team(count=3), network=links, sweep=swept), seed=0)
    unrecorded = ["network.latency", "network.link.1.latency", "sweep.grid.network.latency.1"]
    assert made["unrecorded"] == ([] if known else unrecorded)
    assert differences(made, made) == [f"the parameters of {key} are not recorded" for key in made["unrecorded"]]


# What is refused.


@pytest.fixture
def made():
    return document("run", SCENARIO, seed=5, runs=2)


@pytest.fixture
def kept(tmp_path):
    """Return a function that writes a run.json and returns its path."""

    def keep(content) -> Path:
        path = tmp_path / "run.json"
        path.write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
        return path

    return keep


def errors(path: Path) -> list[str]:
    with pytest.raises(ProvenanceError) as refused:
        read(path)
    return str(refused.value).splitlines()


def test_invalid_json_is_refused_with_its_line(kept):
    path = kept(b'{\n  "what":\n}')
    (said,) = errors(path)
    assert said.startswith(f"{path}:3: not JSON: ")


def test_a_key_that_is_given_twice_is_refused(kept):
    (said,) = errors(kept(b'{"seed": 1, "scenario": {"horizon": 1, "horizon": 2}, "seed": 2}'))
    assert said.endswith("run.json: not JSON: an object has 'horizon' twice")


@pytest.mark.parametrize("content", [b"\xff", b"[" * 200_000, b'{"seed": ' + b"1" * 5000 + b"}", b""])
def test_binary_too_deep_or_too_long_files_are_no_json(kept, content):
    (said,) = errors(kept(content))
    assert ": not JSON: " in said


@pytest.mark.parametrize("content", [3, [], "run", None])
def test_json_that_is_no_object_is_refused(kept, content):
    path = kept(content)
    assert errors(path) == [f"{path}: is not a run.json: should be a JSON object"]


@pytest.mark.parametrize(("number", "found"), [(None, "no format number"), (1, "format 1"), ("2", "format '2'")])
def test_a_document_of_another_format_is_refused_with_what_to_do(kept, number, found):
    made = document("run", SCENARIO, seed=5) | {"format": number}
    path = kept({key: value for key, value in made.items() if value is not None})
    (error,) = errors(path)
    assert error.startswith(f"{path}: has {found}, and this version of desim reads format 2: use the version")


def test_json_that_is_something_else_is_refused_with_all_that_is_missing(kept):
    path = kept({"scenario": {}})
    missing = ", ".join(key for key in KEYS if key != "scenario")
    assert errors(path) == [f"{path}: is not a run.json: missing keys {missing}"]


WRONG = {
    "what": (3, "a string"),
    "seed": (True, "an integer"),
    "runs": ("2", "an integer"),
    "scenario": ([], "an object or null"),
    "folder": (1, "a string or null"),
    "unrecorded": (None, "an array"),
    "versions": ([], "an object"),
    "platform": ("Linux", "an object"),
    "commit": (12, "a string or null"),
    "dirty": (0, "true or false or null"),
    "code": (None, "a string"),
    "argv": ("desim", "an array"),
}


def test_all_values_of_the_wrong_type_are_reported_at_once_with_their_keys(kept, made):
    path = kept(made | {key: value for key, (value, _) in WRONG.items()})
    assert errors(path) == [
        f"{path}: {key}: should be {allowed} (got {json.dumps(value)})" for key, (value, allowed) in WRONG.items()
    ]


def test_a_grid_of_models_is_recorded_as_tables(tmp_path):
    scenario = SCENARIO.model_copy(update={"sweep": Sweep(grid={"network.latency": [Constant(value=0.1), 0.2]})})
    write(tmp_path, document("run", scenario, seed=5))
    grid = read(tmp_path / "run.json")["scenario"]["sweep"]["grid"]
    assert grid == {"network.latency": [{"kind": "constant", "value": 0.1}, 0.2]}
    again = configurations(source(tmp_path / "run.json", read(tmp_path / "run.json")))
    assert [each.scenario.network.latency for each in again] == [Constant(value=0.1), Constant(value=0.2)]


def test_less_than_one_run_is_refused(kept, made):
    path = kept(made | {"runs": 0})
    assert errors(path) == [f"{path}: runs: should be at least 1 (got 0)"]


def test_a_seed_that_is_not_that_of_the_scenario_is_refused(kept, made):
    path = kept(made | {"seed": 6})
    assert errors(path) == [f"{path}: seed: should equal the seed of the scenario, 5 (got 6)"]


def test_a_file_that_is_not_there_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "run.json")


def test_a_document_in_utf_16_is_read_too(kept, made):
    """A shell of Windows writes such files."""
    assert read(kept(json.dumps(made).encode("utf-16"))) == made


# The scenario that was recorded.


def recorded(path: Path, *overrides: str, allow_import: bool = False) -> Scenario:
    return validate(source(path, read(path), overrides, allow_import=allow_import))


def test_a_scenario_of_numbers_that_json_has_not_is_the_one_that_was_given(tmp_path):
    """Its name stays a text."""
    file = tmp_path / "far.toml"
    file.write_text('name = "Infinity"\nsweep.grid = { "network.range" = [4.0, inf], "seed" = [nan, -inf] }\n')
    write(tmp_path, document("run", load(file), seed=0))
    scenario = recorded(tmp_path / "run.json")
    assert (scenario.name, scenario.network.range) == ("Infinity", inf)
    assert scenario.sweep.grid["network.range"] == (4.0, inf)
    assert np.array_equal(scenario.sweep.grid["seed"], (nan, -inf), equal_nan=True)
    assert dump(scenario) == dump(load(file))


def test_an_override_wins_over_the_record(kept, made):
    path = kept(made)
    assert recorded(path, "evader.speed=0.5", "seed=9") == SCENARIO.model_copy(
        update={"seed": 9, "evader": Evader(speed=0.5)}
    )


@pytest.mark.parametrize("before", [[], ["network.preset=wifi"], ["network.preset=lora_sf7"]])
@pytest.mark.parametrize("after", ["network.preset=lora_sf9", "network.medium.queue_limit=1"])
def test_an_override_of_the_network_does_what_it_does_to_the_file(tmp_path, before, after):
    """Else the values of one preset would stand against another, as if they had been given."""
    file = tmp_path / "a.toml"
    file.write_text("network.range = 4.0\n")
    write(tmp_path, document("run", load(file, before), seed=0))
    if after.startswith("network.medium") and "lora_sf7" not in str(before):
        after = "network.latency={ kind = 'constant', value = 0.1 }"
    assert recorded(tmp_path / "run.json", after) == load(file, [*before, after])


def test_values_given_beside_a_preset_are_kept(tmp_path):
    scenario = Scenario(network=Links(preset="lora_sf7", latency={"kind": "constant", "value": 0.3}))
    write(tmp_path, document("run", scenario, seed=0))
    assert recorded(tmp_path / "run.json", "network.preset=lte").network.latency.value == 0.3


def test_a_scenario_that_is_not_valid_is_refused_with_file_and_key(kept, made):
    made["scenario"] |= {"horizn": 1.0, "horizon": -1.0, "network": {"preset": "wify"}}
    made["scenario"]["evader"]["speed"] = "fast"
    path = kept(made)
    with pytest.raises(ScenarioError) as refused:
        recorded(path)
    said = str(refused.value).splitlines()
    assert {each.split(": ")[0] for each in said} == {str(path)}
    assert {each.split(": ")[1] for each in said} == {"horizn", "horizon", "network.preset", "evader.speed"}


@pytest.mark.parametrize("network", [3, [], {"preset": []}, {"preset": 3, "range": "Infinity"}, None])
def test_a_network_that_is_none_is_refused_with_its_key(kept, made, network):
    made["scenario"]["network"] = network
    with pytest.raises(ScenarioError, match=r"run\.json: network"):
        recorded(kept(made))


@pytest.mark.parametrize("kind", [3, [1], None])
def test_a_kind_that_is_no_text_is_refused_with_its_key(kept, made, kind):
    made["scenario"]["protocol"] = {"kind": kind}
    with pytest.raises(ScenarioError, match=r"run\.json: protocol"):
        recorded(kept(made))


def test_an_error_in_an_override_is_reported_with_the_override(kept, made):
    with pytest.raises(ScenarioError, match=r"^--set horizon=-1: horizon: should be greater than 0"):
        recorded(kept(made), "horizon=-1")
    with pytest.raises(ScenarioError, match=r"^--set horizon: should be KEY=VALUE"):
        recorded(kept(made), "horizon")


def test_a_model_of_a_script_that_cannot_be_imported_is_reported_with_its_key(kept):
    def inner(state, rng):
        return 1j

    scenario = Scenario(
        team=Team(count=2), evader=Evader(strategy=inner), network=Links(link=[{"src": 0, "dst": 1, "latency": Own()}])
    )
    made = document("run", scenario, seed=0)
    made["scenario"]["protocol"] = {"kind": "__main__:chase"}
    made["scenario"]["network"]["link"][0]["latency"]["kind"] = "__main__:Own"
    path = kept(made)
    with pytest.raises(ProvenanceError) as refused:
        recorded(path)
    why = "was defined in a script or in a function and cannot be imported; move it to a module"
    local = f"{__name__}:test_a_model_of_a_script_that_cannot_be_imported_is_reported_with_its_key.<locals>.inner"
    assert sorted(str(refused.value).splitlines()) == [
        f"{path}: evader.strategy: {local!r} {why}",
        f"{path}: network.link.0.latency: '__main__:Own' {why}",
        f"{path}: protocol: '__main__:chase' {why}",
    ]


def test_a_model_of_a_script_may_be_replaced(kept, made):
    made["scenario"]["protocol"] = {"kind": "__main__:chase"}
    assert recorded(kept(made), "protocol={ kind = 'argmin' }").protocol.kind == "argmin"


@pytest.mark.parametrize(
    ("what", "origin"),
    [
        *((each, f"was written by desim {each}") for each in ("sweep", "explain", "merge")),
        ("table1", "records the study 'table1'"),
    ],
)
def test_a_record_that_is_not_of_runs_is_refused_with_its_command(kept, made, what, origin):
    path = kept(made | {"what": what, "argv": ["desim", what, "a b.toml"]})
    with pytest.raises(ProvenanceError) as refused:
        recorded(path)
    done = f"which desim run cannot repeat; it was made by: desim {what} 'a b.toml'"
    assert str(refused.value) == f"{path}: {origin}, {done}"


def test_a_run_without_a_scenario_is_refused(kept, made):
    with pytest.raises(ProvenanceError, match="records a run without its scenario, which desim run cannot repeat"):
        recorded(kept(made | {"scenario": None}))


RULES = """
from desim.config.model import Value


class {name}(Value):
    at: float = 0.1
    until: float = 2.0

    def __call__(self, me):
        yield me.at(self.at)
        me.assign(True)
        me.announce()
"""


@pytest.fixture
def beside(tmp_path):
    """Return a function that writes a scenario file and a module of a protocol beside it, imported nowhere else."""

    def put(folder: str, name: str) -> Path:
        home = tmp_path / folder
        home.mkdir(exist_ok=True)
        (home / f"{name}.py").write_text(RULES.format(name="Rule"))
        (home / "own.toml").write_text(
            f'horizon = 1.0\nteam.count = 4\nprotocol = {{ kind = "{name}:Rule", at = 0.2, until = inf }}\n'
        )
        return home / "own.toml"

    return put


def forget(name: str) -> None:
    """Let a module be as if it had never been imported."""
    sys.modules.pop(name, None)
    sys.path[:] = [each for each in sys.path if not (Path(each) / f"{name}.py").exists()]


def test_a_module_beside_the_scenario_file_is_found(beside, tmp_path):
    file = beside("home", "rules_of_home")
    out = tmp_path / "out"
    write(out, document("run", load(file, allow_import=True), seed=0, folder=file.parent))
    assert read(out / "run.json")["scenario"]["protocol"] == {
        "at": 0.2,
        "until": "Infinity",
        "kind": "rules_of_home:Rule",
    }
    forget("rules_of_home")
    protocol = recorded(out / "run.json", allow_import=True).protocol
    assert (protocol.at, protocol.until, plain_name(type(protocol).__module__)) == (0.2, inf, "rules_of_home")


def test_if_the_folder_is_gone_a_module_beside_the_record_is_found(beside, tmp_path):
    file = beside("home", "rules_that_moved")
    write(tmp_path / "out", document("run", load(file, allow_import=True), seed=0, folder=file.parent))
    forget("rules_that_moved")
    (tmp_path / "home").rename(tmp_path / "elsewhere")
    with pytest.raises(ScenarioError, match="cannot be imported"):
        recorded(tmp_path / "out" / "run.json", allow_import=True)
    (tmp_path / "elsewhere" / "rules_that_moved.py").rename(tmp_path / "out" / "rules_that_moved.py")
    assert recorded(tmp_path / "out" / "run.json", allow_import=True).protocol.at == 0.2


def test_a_record_without_a_folder_means_its_own(beside, tmp_path):
    file = beside("home", "rules_of_a_script")
    write(file.parent, document("run", load(file, allow_import=True), seed=0))
    forget("rules_of_a_script")
    assert recorded(file.parent / "run.json", allow_import=True).protocol.at == 0.2


def test_a_file_that_an_override_names_lies_beside_the_scenario_file(beside, tmp_path):
    file = beside("home", "rules_with_a_file")
    (file.parent / "delays.txt").write_text("0.25")
    write(tmp_path / "out", document("run", load(file, allow_import=True), seed=0, folder=file.parent))
    scenario = recorded(
        tmp_path / "out" / "run.json", "network.latency={ kind = 'empirical', file = 'delays.txt' }", allow_import=True
    )
    assert scenario.network.latency.values == (0.25,)
    copy = source(tmp_path / "out" / "run.json", read(tmp_path / "out" / "run.json"), allow_import=True).copy()
    copy.override("network.latency={ kind = 'empirical', file = 'delays.txt' }")
    assert validate(copy) == scenario


# What has changed since.


def test_nothing_has_changed_at_once(made):
    assert differences(made, environment.environment()) == []
    assert differences(made | {"commit": None, "dirty": None}, made | {"commit": None, "dirty": None}) == []


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ({"commit": "a"}, {"commit": "b", "dirty": True}, []),
        ({"code": "1"}, {"code": "2"}, ["the code of desim was c, 1 and is c, 2"]),
        (
            {"code": "1", "commit": None, "dirty": None},
            {"code": "2", "dirty": True},
            ["the code of desim was of no commit, 1 and is c with changes, 2"],
        ),
        (
            {"versions": {"numpy": "1", "a": "2"}},
            {"versions": {"numpy": "2", "a": "2"}},
            ["the package numpy was 1 and is 2"],
        ),
        (
            {"versions": {"numpy": "1"}},
            {"versions": {"simpy": "4", "a": "1"}},
            [
                "the package a was unknown and is 1",
                "the package numpy was 1 and is unknown",
                "the package simpy was unknown and is 4",
            ],
        ),
        ({"platform": {"libc": "x"}}, {"platform": {"libc": "y"}}, ["the C library was x and is y"]),
        ({"argv": ["a"], "seed": 3}, {}, []),
    ],
)
def test_changes_are_named(before, after, said):
    same = {"versions": {}, "platform": {}, "commit": "c", "dirty": False, "code": "0", "unrecorded": []}
    assert differences(same | before, same | after) == said


# `desim run --from`


@pytest.fixture
def _no_pictures(monkeypatch):
    monkeypatch.setattr("desim.results.run_folder.can_plot", lambda: False)


def files(folder: Path) -> dict[str, object]:
    """Return what a folder holds: bytes by name, and of a run.json all but the command line."""
    found: dict[str, object] = {}
    for each in sorted(folder.rglob("*")):
        if each.is_file():
            name = str(each.relative_to(folder))
            found[name] = read(each) | {"argv": []} if each.name == "run.json" else each.read_bytes()
    return found


def repeated(tmp_path: Path, *args: object) -> tuple[dict[str, object], dict[str, object]]:
    """Return what a command printed and wrote, and what its repetition from run.json did."""
    found = []
    for words, out in ((args, "first"), (["--from", tmp_path / "first" / "run.json"], "second")):
        result = accepted("run", *words, "--json", "-o", tmp_path / out)
        found.append(files(tmp_path / out) | {"stdout": strict_json(result.stdout), "text": result.stdout})
    return found[0], found[1]


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.usefixtures("_no_pictures")
@pytest.mark.parametrize("file", SCENARIOS, ids=lambda file: file.stem)
def test_a_run_of_a_scenario_file_is_repeated_byte_for_byte(file, tmp_path):
    first, second = repeated(tmp_path, file, "--set", "horizon=0.3")
    assert first == second
    assert first.keys() == {"trace.jsonl", "summary.json", "scenario.toml", "run.json", "stdout", "text"}
    assert len(first["trace.jsonl"].splitlines()) > 5


FAR = """\
name = "far"
horizon = 1.0
team.count = 4

[protocol]
kind = "sap"

[network]
range = inf
preset = "acoustic"
latency = { kind = "empirical", file = "delays.txt" }

[announce]
belief_timeout = inf

[[fault]]
kind = "crash"
node = 1
start = 0.1
end = inf

[sweep.grid]
"network.range" = [4.0, inf]
"""


@pytest.mark.slow
@pytest.mark.usefixtures("_no_pictures")
@pytest.mark.parametrize(
    "options",
    [
        (),
        ("-s", 11),
        ("-n", 3),
        ("-n", 3, "-s", 5),
        ("--set", "evader.speed=0.123456789012345678", "--set", "seed=8"),
        ("--set", "network.preset=lora_sf8", "--set", "network.medium.queue_limit=inf"),
    ],
    ids=lambda options: " ".join(map(str, options)),
)
def test_infinities_files_seeds_and_overrides_are_repeated_byte_for_byte(tmp_path, options):
    (tmp_path / "delays.txt").write_text("0.01\n0.02\n0.3\n")
    (tmp_path / "far.toml").write_text(FAR)
    first, second = repeated(tmp_path, tmp_path / "far.toml", *options)
    assert first == second
    assert first["stdout"]["scenario"]["network"]["range"] == "Infinity"
    runs, root = first["stdout"]["runs"], first["stdout"]["scenario"]["seed"]
    assert runs[0]["seed"] == (run_seed(root, 0) if "-n" in options else root)
    assert len(runs) == (3 if "-n" in options else 1)
    assert len({name for name in first if name.endswith("trace.jsonl")}) == len(runs)


@pytest.mark.slow
@pytest.mark.usefixtures("_no_pictures")
def test_a_module_beside_the_file_is_repeated_byte_for_byte(beside, tmp_path):
    file = beside("home", "rules_to_repeat")
    first = accepted("run", file, "--allow-import", "-o", tmp_path / "first", "--json")
    forget("rules_to_repeat")
    repeated = ["--from", tmp_path / "first" / "run.json", "--allow-import"]
    again = accepted("run", *repeated, "-o", tmp_path / "second", "--json")
    assert again.stdout == first.stdout
    assert files(tmp_path / "first") == files(tmp_path / "second")
    assert read(tmp_path / "second" / "run.json")["folder"] == str(file.parent)


@pytest.mark.slow
@pytest.mark.usefixtures("_no_pictures")
def test_the_folder_of_each_of_several_runs_repeats_that_run(tmp_path):
    """The one at the top repeats all of them; what was repeated is repeated again."""
    (tmp_path / "far.toml").write_text(FAR.replace('"empirical", file = "delays.txt"', '"lognormal", mean = 0.1'))
    five = [5_000_000, 5_000_001, 5_000_002]
    accepted("run", tmp_path / "far.toml", "-n", 3, "-s", 5, "-o", tmp_path / "all")
    assert sorted(each.name for each in (tmp_path / "all").iterdir()) == ["run.json", *(f"seed-{k}" for k in five)]
    assert read(tmp_path / "all" / "run.json")["runs"] == 3
    assert [read(tmp_path / "all" / f"seed-{k}" / "run.json")["runs"] for k in five] == [1, 1, 1]
    for seed in five:
        accepted("run", "--from", tmp_path / "all" / f"seed-{seed}" / "run.json", "-o", tmp_path / f"{seed}")
        assert files(tmp_path / f"{seed}") == files(tmp_path / "all" / f"seed-{seed}")
    accepted("run", "--from", tmp_path / "5000001" / "run.json", "-o", tmp_path / "again")
    assert files(tmp_path / "again") == files(tmp_path / "5000001")
    assert files(tmp_path / "5000000") != files(tmp_path / "5000001")


@pytest.mark.slow
def test_worker_processes_write_the_same_files_as_one_process(beside, tmp_path):
    """The command line is that of the command, not that of the worker, and the module is found there, too."""
    file = beside("home", "rules_for_workers")
    words = ["--allow-import", "--set", "record.trajectory=0", "-n", 3, "-j", 1]
    accepted("run", file, *words, "-o", tmp_path / "one")
    accepted("run", "--from", tmp_path / "one" / "run.json", "--allow-import", "-j", 2, "-o", tmp_path / "two")
    assert files(tmp_path / "one") == files(tmp_path / "two")
    assert read(tmp_path / "two" / "seed-1" / "run.json")["argv"] == sys.argv


@pytest.mark.whole
def test_a_run_is_repeated_byte_for_byte_by_another_process(tmp_path):
    """From another folder, with another order of sets, and with its pictures."""
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "rules.py").write_text(RULES.format(name="Rule"))
    (tmp_path / "home" / "own.toml").write_text(
        'horizon = 0.3\nteam.count = 4\nprotocol = { kind = "rules:Rule", until = inf }\n'
    )
    printed = []
    for words, folder, hash_seed in (
        (["own.toml", "--allow-import", "-o", "../first", "-s", "3"], "home", "1"),
        (["--from", "first/run.json", "--allow-import", "-o", "second"], ".", "2"),
    ):
        done = subprocess.run(
            [sys.executable, "-P", "-m", "desim", "run", *words, "--json"],
            cwd=tmp_path / folder,
            env=os.environ | {"PYTHONHASHSEED": hash_seed},
            check=True,
            capture_output=True,
        )
        printed.append(done.stdout)
    assert printed[0] == printed[1]
    first, second = files(tmp_path / "first"), files(tmp_path / "second")
    assert first == second
    assert {"trajectory.svg", "trajectory.png"} <= first.keys()
    argv = read(tmp_path / "first" / "run.json")["argv"]
    assert argv[1:] == ["run", "own.toml", "--allow-import", "-o", "../first", "-s", "3", "--json"]


@pytest.fixture
def earlier(kept):
    """Return the run.json of two runs of 0.2 s, seeds 5 and 6."""
    return kept(document("run", SCENARIO, seed=5, runs=2))


def seeds(*args: object) -> list[int]:
    return [run["seed"] for run in strict_json(accepted("run", *args, "--json").stdout)["runs"]]


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), [5_000_000, 5_000_001]),
        (("-n", 1), [5]),
        (("-n", 3), [5_000_000, 5_000_001, 5_000_002]),
        (("-s", 8), [8_000_000, 8_000_001]),
        (("--set", "seed=8"), [8_000_000, 8_000_001]),
        (("--set", "seed=8", "-s", 0, "-n", 1), [0]),
    ],
)
def test_seeds_and_their_number_are_those_of_the_record_unless_an_option_overrides_them(earlier, options, expected):
    assert seeds("--from", earlier, *options) == expected


@pytest.mark.slow
def test_an_override_of_a_repetition_is_recorded_in_turn(earlier, tmp_path):
    accepted("run", "--from", earlier, "--set", "evader.speed=0.5", "-n", 1, "-s", 9, "-o", tmp_path / "out")
    again = read(tmp_path / "out" / "run.json")
    assert (again["seed"], again["runs"], again["scenario"]["evader"]["speed"]) == (9, 1, 0.5)
    assert again["scenario"]["seed"] == 9


@pytest.mark.slow
def test_a_repetition_on_the_same_machine_is_not_warned_of(earlier):
    assert accepted("run", "--from", earlier).stderr == ""


OUTSIDE = """
from pathlib import Path

def follow(me):
    me.assign(int(Path(__file__).with_name("choice").read_text()))
    yield me.sleep(9.0)
"""


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("runs", [1, 2])
def test_a_repetition_that_gives_other_results_is_warned_of(tmp_path, runs):
    """A file, about which the scenario says nothing, determines what the pursuers do."""
    (tmp_path / "outside.py").write_text(OUTSIDE)
    (tmp_path / "s.toml").write_text('horizon = 0.2\nteam.count = 3\nprotocol = "outside:follow"\n')
    (tmp_path / "choice").write_text("0")
    path = tmp_path / "out" / "run.json"
    accepted("run", tmp_path / "s.toml", "--allow-import", "-n", runs, "-j", 1, "-o", path.parent)

    def repeated(*options):
        told = accepted("run", "--from", path, "--allow-import", "-j", 1, *options).stderr
        return told.count("has other results than recorded: active_time was ")

    assert repeated() == 0
    (tmp_path / "choice").write_text("1")
    assert repeated() == runs
    assert repeated("-s", 1) == repeated("--set", "horizon=0.1") == 0
    assert repeated("-o", path.parent) == runs
    assert repeated() == 0
    for file in path.parent.rglob("summary.json"):
        file.write_text("[]")
    assert repeated() == 0


def test_changes_since_the_record_give_a_warning_on_stderr(kept, made):
    path = kept(made | {"commit": "abc", "code": "00", "versions": made["versions"] | {"numpy": "1.0"}})
    result = accepted("run", "--from", path, "--json")
    code = f"the code of desim was abc, 00 and is {COMMIT}, {made['code']}"
    changes = f"the package numpy was 1.0 and is {np.__version__}; {code}; for those packages: pip install numpy==1.0"
    assert result.stderr == f"warning: {path}: results may differ: {changes}\n"
    strict_json(result.stdout)


def test_a_recorded_scenario_that_is_hardly_meant_is_warned_of_as_its_file_was(kept):
    path = kept(document("run", SCENARIO.model_copy(update={"evader": Evader(speed=9.0)}), seed=0))
    assert accepted("run", "--from", path).stderr.startswith(f"warning: {path}: team.speeds: no pursuer is faster")


def test_neither_a_file_nor_a_record_and_both_are_refused(earlier):
    for words in ((), ("-n", "2")):
        assert "Error: needs a FILE, or --from RUN.JSON; `desim examples relay` writes" in refused("run", *words)
    assert "not both" in refused("run", SCENARIOS[0], "--from", earlier)


def test_a_record_that_cannot_be_read_is_refused(tmp_path):
    path = tmp_path / "run.json"
    assert refused("run", "--from", path).startswith(f"{path}: cannot be read: No such file")
    assert refused("run", "--from", tmp_path).startswith(f"{tmp_path}: cannot be read: Is a directory")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"runs": 0}, "{path}: runs: should be at least 1 (got 0)\n"),
        ({"scenario": {"protocol": {"kind": "__main__:x"}}}, "{path}: protocol: '__main__:x' was defined in a script"),
        ({"seed": -1, "scenario": {"seed": -1}}, "{path}: seed: should be greater than or equal to 0"),
    ],
    ids=["no provenance", "script", "negative seed"],
)
def test_a_record_that_is_wrong_is_refused(kept, made, change, said, tmp_path):
    path = kept(made | change)
    assert refused("run", "--from", path, "-o", tmp_path / "out").startswith(said.format(path=path))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_without_an_output_folder_the_provenance_is_not_collected(earlier, monkeypatch):
    """It takes a while to ask git."""
    monkeypatch.setattr(provenance, "document", lambda *_, **__: pytest.fail("it asked"))
    accepted("run", SCENARIOS[0], "--set", "horizon=0.3")


@pytest.mark.slow
def test_a_record_that_cannot_be_written_at_the_top_is_reported(earlier, tmp_path, monkeypatch):
    (tmp_path / "out" / "run.json").mkdir(parents=True)
    monkeypatch.setattr("desim.results.run_folder.can_plot", lambda: True)
    said = refused("run", "--from", earlier, "--set", "record.trajectory=0", "-o", tmp_path / "out")
    assert said.startswith(f"--out {tmp_path / 'out' / 'run.json'}: cannot be written: Is a directory")


# Studies.


def test_a_study_writes_where_it_comes_from_beside_its_numbers(tmp_path, monkeypatch):
    from scenarios.studies.study import Options

    monkeypatch.setattr(sys, "argv", ["scenarios/a.py", "--runs", "4"])
    Options("a", 4, 1, 3, tmp_path, False).show({"cells": []}, "table")
    Options("b", 5, 1, 3, tmp_path, False).show({"cells": []}, "table")
    assert sorted(each.name for each in tmp_path.iterdir()) == [
        f"{name}.{end}" for name in "ab" for end in ("json", "run.json", "txt")
    ]
    assert read(tmp_path / "a.run.json") == document("a", seed=3, runs=4)
    assert read(tmp_path / "b.run.json")["runs"] == 5
    said = refused("run", "--from", tmp_path / "a.run.json")
    assert said.startswith(f"{tmp_path / 'a.run.json'}: records the study 'a', which desim run cannot repeat")


def test_the_parts_of_an_environment_that_have_names_are_in_it():
    here = environment.environment()
    assert {*provenance.PARTS} <= {*here["versions"], *here["platform"]}

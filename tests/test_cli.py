"""The command line: refusals with their messages, output and files."""

import csv
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import click
import pytest

from desim.analysis.looks import FIRST_LOOK
from desim.analysis.measuring import summary
from desim.cli import main
from desim.cli.recorded import labels_of
from desim.config.extras import missing
from desim.config.field_docs import fields_of
from desim.config.model import Value
from desim.config.number_texts import counted
from desim.kernel.models.latency import Gamma
from desim.pursuit.core.traits import ProtocolTraits
from desim.results import provenance
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.scenario.sweep_table import Sweep
from desim.scenario.toml import load
from desim.simulation.run import run
from desim.study.store.store import Store
from desim.study.workers import batch
from desim.study.workers.batch import run_many
from tests import command
from tests.command import accepted, desim, strict_json
from tests.golden import golden

SCENARIOS = sorted((Path(__file__).parents[1] / "scenarios").glob("*.toml"))
pytestmark = pytest.mark.usefixtures("_undrawn")

# The evader flees from pursuer 0 along their line; the centre sends pursuer 1 home at once. The gap of 1 m closes at
# 2 - 1 m/s down to the radius of 0.1 m: capture after 0.9 s.
DUEL = """\
name = "duel"
seed = 7
horizon = 5.0

[team]
positions = [[0.0, 0.0], [-9.0, 0.0]]
speeds = [2.0, 1.5]

[evader]
position = [1.0, 0.0]
speed = 1.0

[protocol]
kind = "centralised"
"""

# One of three pursuers announces at 0.1, ... 0.9 s; the horizon precedes the slot of 1.0 s. 9 broadcasts x 2 receivers.
BROADCASTS = """\
name = "talk"
horizon = 1.0
team.count = 3
motion.static = true
announce = { trigger = "revision", start = "known" }

[protocol]
kind = "sap"
schedule = { kind = "shared_seed", slot = 0.1 }
"""

# Chance in the positions, the revisions, the decisions and the losses.
RANDOM = """\
name = "luck"
seed = 7
horizon = 1.0
team.count = 4

[protocol]
kind = "sap"
schedule = { kind = "poisson", rate = 5.0 }

[network]
latency = { kind = "constant", value = 0.02 }
loss = { kind = "bernoulli", p = 0.1 }

[record]
messages = true
"""


def refused(*args: object) -> list[str]:
    """Return the lines in which the command refuses what it is given."""
    return command.refused(*args).splitlines()


@pytest.fixture
def file(tmp_path):
    """Return a function that writes a scenario file."""

    def write(text: str | bytes, name: str = "scenario.toml") -> Path:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


# What is refused.


def test_all_errors_of_a_file_are_reported_at_once_in_order_of_lines(file):
    """Keys are neither in the order of the model nor of the alphabet, and 10 comes after 9."""
    path = file(
        "seed = -1\nhorizon = 0.0\n\n[team]\ncount = 0\nactive_at_start = 2.0\n\n[evader]\nspeed = 'x'\nsped = 1\n"
        "box = [1.0, 'y']\n\n[capture]\nradius = 0.0\n"
    )
    places = ["1: seed", "2: horizon", "5: team.count", "6: team.active_at_start", "9: evader.speed"]
    places += ["10: evader.sped", "11: evader.box.1", "14: capture.radius"]
    said = refused("check", path)
    assert [each.split(": ")[:2] for each in said] == [f"{path}:{place}".split(": ") for place in places]


def test_an_override_in_two_words_is_refused_before_they_count_as_arguments(file):
    path = file("seed = 1\n")
    for name in ("run", "check", "sweep", "explain", "replay"):
        (said,) = refused(name, path, "--set", "network.range", "5")
        assert said.startswith("--set network.range: should be KEY=VALUE in one word, for instance ")


@pytest.mark.parametrize(
    ("text", "suggestion"),
    [
        ("latency = 0.1", "latency: unknown key, did you mean network.latency?; "),
        ("latncy = 0.1", "latncy: unknown key, did you mean network.latency?; "),
        ("radius = 0.1", "radius: unknown key, did you mean sensing.radius or capture.radius?; "),
        ("sight = 0.1", "sight: unknown key, did you mean evader.sensing_range?; "),
        ("speed = 0.1", "speed: unknown key, did you mean 'seed' or evader.speed?; "),
        ("memory = true", "memory: unknown key, did you mean fault.0.memory?; "),
        ("network.seed = 1", "network.seed: unknown key, did you mean seed at the top?; "),
        (
            "network.latency = { kind = 'constant', low = 1.0 }",
            "network.latency.low: unknown key, it is one of the kind uni",
        ),
        (
            "protocol = { kind = 'sap', schedule = { kind = 'poisson', participation = 0.5 } }",
            "protocol.schedule.participation: unknown key, it is one of the kind rounds; allowed",
        ),
        ("protocol = { kind = 'voronoi', tau = 1.0 }", "protocol.tau: unknown key, it is one of the kind bi"),
        ("zzz = 1", "zzz: unknown key; "),
    ],
)
def test_an_unknown_key_is_reported_with_the_tables_that_have_it(file, text, suggestion):
    path = file(f"{text}\n")
    (said,) = refused("check", path)
    assert said.startswith(f"{path}:1: {suggestion}")


@pytest.mark.parametrize("command", ["run", "sweep", "explain"])
def test_the_number_of_runs_has_the_bound_of_its_key(file, command):
    (most,) = (each.le for each in Sweep.model_fields["reps"].metadata if hasattr(each, "le"))
    assert f" to {most:,}; " in refused(command, file(DUEL), "-n", most + 1)[-1]


def test_the_key_that_is_suggested_for_an_override_can_be_set(file):
    path = file("[network.latency]\nkind = 'gamma'\n")
    (said,) = refused("check", path, "--set", "latency=0.1")
    assert said.startswith("--set latency=0.1: latency: unknown key, did you mean network.latency?; ")
    accepted("check", path, "--set", "network.latency=0.1")


@pytest.mark.slow
def test_a_page_of_the_other_command_is_suggested_for_a_folder(file, tmp_path):
    path, run, runs, sweep = file(DUEL), tmp_path / "a run", tmp_path / "runs", tmp_path / "sweep"
    accepted("run", path, "-o", run)
    accepted("run", path, "-n", 2, "-o", runs)
    accepted("sweep", path, "-n", 1, "-o", sweep, "--set", "sweep.grid={ 'evader.speed' = [1.0] }")
    play = "make a page that plays a run: desim replay"
    assert refused("report", run) == [f"{run}: is the folder of a single run, not of a sweep; {play} '{run}'"]
    assert refused("merge", run, "-o", tmp_path / "merged") == [f"{run}: is the folder of a run, not of a sweep"]
    assert refused("report", runs) == [
        f"{runs}: is the folder of single runs, not of a sweep; {play} {runs}/seed-7000000"
    ]
    (said,) = refused("replay", sweep)
    assert said.startswith(f"{sweep}: is the folder of a sweep or an explanation, which keeps metrics only; ")
    assert f"desim report {sweep};" in said


def test_errors_of_overrides_are_reported_with_those_of_the_file_and_labelled(file):
    path = file("horizn = 1.0\n[evader]\nspeed = 'x'\n")
    said = refused("check", path, "--set", "capture.radius=0", "--set", "evader.sped=1")
    starts = [
        "--set capture.radius=0: capture.radius: should be greater than 0",
        "--set evader.sped=1: evader.sped: unknown key, did you mean 'speed'?",
        f"{path}:1: horizn: unknown key, did you mean 'horizon'?",
        f"{path}:3: evader.speed: should be a number",
    ]
    assert [each[: len(start)] for each, start in zip(said, starts, strict=True)] == starts


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("name = 'x'\nhorizon =\n", 2),
        ("name = 'x'\n\n[team\ncount = 3\n", 3),
        ("name = 'x'\nname = 'y'\n", 2),
        ("name = 'x'\n[team]\n[evader]\n[team]\n", 4),
        ("{}", 1),
        (b"name = 'x'\n\n# \xff\n", 3),
        (b"\xff", 1),
    ],
    ids=["no value", "open bracket", "key twice", "table twice", "JSON", "Latin-1 in line 3", "Latin-1"],
)
@pytest.mark.parametrize("command", ["run", "check"])
def test_a_file_that_is_not_toml_is_refused_with_the_line(file, command, text, line):
    path = file(text)
    (said,) = refused(command, path)
    assert said.startswith(f"{path}:{line}: not TOML: ")


@pytest.mark.parametrize(("name", "why"), [("nowhere.toml", "No such file"), (".", "Is a directory")])
@pytest.mark.parametrize("command", ["run", "check"])
def test_a_file_that_cannot_be_read_is_refused(tmp_path, command, name, why):
    (said,) = refused(command, tmp_path / name)
    assert said.startswith(f"{tmp_path / name}: cannot be read: {why}")


@pytest.mark.parametrize("below", [".", "x", "x/y"])
def test_a_folder_that_cannot_be_written_is_refused_before_anything_runs(file, tmp_path, monkeypatch, below):
    monkeypatch.setattr("desim.simulation.run.World", lambda *_: pytest.fail("it ran"))
    taken = tmp_path / "taken"
    taken.write_text("precious")
    (said,) = refused("run", file(DUEL), "-o", taken / below)
    assert said.startswith(f"--out {taken / below}: cannot be written: ")
    assert taken.read_text() == "precious"


@pytest.mark.parametrize("option", [("-s", -1), ("-n", 0), ("-j", -1), ("--sed", 1)])
def test_an_option_out_of_range_is_refused(file, option):
    assert str(option[0]) in " ".join(refused("run", file(DUEL), *option))


def test_ctrl_c_ends_with_exit_code_130(file, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("desim.simulation.run.World", interrupt)
    assert desim("run", file(DUEL)).exit_code == 130


@pytest.mark.parametrize("into", [(), ("-o", "runs")])
def test_an_interrupted_command_shows_what_has_ended_and_how_to_keep_all(into, tmp_path, monkeypatch):
    """The third run is interrupted; the command that is shown repeats all that decides the runs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "waiting.py").write_text("def waits(me):\n    yield me.sleep(1.0)\n")
    path = tmp_path / "f.toml"
    path.write_text('horizon = 0.2\nteam.count = 1\nprotocol = "waiting:waits"\n')

    def interrupted_in_the_third(scenario, seed):
        if seed == 2_000_002:
            raise KeyboardInterrupt
        return run(scenario, seed)

    monkeypatch.setattr("desim.simulation.run.run", interrupted_in_the_third)
    monkeypatch.setattr("desim.results.run_folder.simulate_below", lambda _, *task: interrupted_in_the_third(*task))
    monkeypatch.setattr("desim.results.run_folder.write_below", lambda _, result, **__: summary(result))
    stopped = desim("run", path, "-n", 5, "-s", 2, "--set", "evader.speed=0.3", "--allow-import", *into)
    assert stopped.exit_code == 130
    head, _, command = stopped.stderr.splitlines()[-1].partition("make a sweep: desim ")
    assert ("runs have ended, in runs/seed-*;" in head) == bool(into)
    ended = int(re.search(r"(\d) of 5 runs have ended", head)[1])  # those that a worker has reported
    assert ended in {1, 2}
    assert f"captured in 0 of {counted(ended, 'run')};" in stopped.stdout
    assert command == f"sweep {path} -g horizon=0.2 -n 5 -s 2 --set evader.speed=0.3 --allow-import"


def test_differences_are_shown_from_the_configuration_that_is_named(file, tmp_path):
    """The text "0.50" says 0.5."""
    swept = ["sweep", file(DUEL), "-g", "horizon=0.5,1.0", "-n", 2, "-o", tmp_path / "s"]
    table = accepted(*swept, "--against", "horizon=0.50").stdout
    assert "difference from horizon = 0.50, all else equal, run by run with the same seed" in table
    (said,) = refused(*swept, "--against", "horizon=0.7")
    assert "horizon does not take the value 0.7: it takes 0.5, 1" in said


# What is accepted with a warning.


@pytest.mark.parametrize("command", ["run", "check"])
def test_a_team_without_a_pursuer_faster_than_the_evader_gives_a_warning(file, command):
    path = file(DUEL)
    result = accepted(command, path, "--set", "evader.speed=2.0")
    assert result.stderr.startswith(f"warning: {path}:7: team.speeds: no pursuer is faster than the evader: ")
    assert "2.0 m/s, the evader at 2.0 m/s" in result.stderr
    assert result.stderr.count("warning: ") == 1


@pytest.mark.parametrize(
    "change", ["evader.speed=1.99", "capture={ test = 'sample' }", "motion.step=0.2"], ids=["fast", "sample", "segment"]
)
def test_a_sound_scenario_gives_no_warning(file, change):
    path = file(DUEL)
    assert accepted("check", path, "--set", change).stderr == f"{path} is valid\n"


# replay


def test_a_replay_that_cannot_be_made_is_reported_in_one_line(file, tmp_path, monkeypatch):
    def fail(result, **options):
        raise ValueError("no positions were recorded")

    monkeypatch.setattr("desim.view.pages.replay.replay_page", fail)
    assert refused("replay", file(DUEL), "-o", tmp_path / "x.html") == ["no positions were recorded"]
    assert not (tmp_path / "x.html").exists()


def test_a_replay_under_another_name_is_refused_before_anything_runs(file, monkeypatch):
    monkeypatch.setattr("desim.simulation.run.World", lambda *_: pytest.fail("it ran"))
    (said,) = refused("replay", file(DUEL), "-o", "x.gif")
    assert said == "--out x.gif: should end in .html, or have no suffix, got .gif"


def test_a_replay_is_reported_in_one_line(file, tmp_path):
    path = tmp_path / "x.html"
    said = accepted("replay", file(BROADCASTS), "-o", path, "--set", "record.messages=true").stdout
    assert said == f"{path}: 3 pursuers, 1.00 s, 18 messages, {path.stat().st_size / 1000:,.0f} kB\n"


# check, schema, protocols, help


def leaves(value: Value, place: tuple[str, ...] = ()):
    """Yield the place of every field of a scenario that has a value, and the value."""
    for name in type(value).model_fields:
        each = getattr(value, name)
        if isinstance(each, Value):
            yield from leaves(each, (*place, name))
        elif each is not None:
            yield (*place, name), each


@pytest.mark.parametrize("text", ["", DUEL, RANDOM], ids=["empty", "duel", "luck"])
def test_check_prints_a_valid_scenario_file_with_every_default_filled_in(file, text):
    path = file(text)
    printed = accepted("check", path).stdout
    tables = tomllib.loads(printed)
    for place, value in leaves(load(path)):
        node = tables
        for key in place:
            node = node[key]
        assert json.dumps(node) == json.dumps(value)
    again = file(printed, "again.toml")
    assert load(again) == load(path)
    assert accepted("check", again).stdout == printed


def test_check_prints_what_an_override_changed(file):
    printed = accepted("check", file(DUEL), "--set", "evader.speed=0.5", "--set", "name=other").stdout
    tables = tomllib.loads(printed)
    assert (tables["evader"]["speed"], tables["name"]) == (0.5, "other")


def test_the_override_in_the_help_works_on_a_file_without_a_network_table(file):
    example = re.search(r"e\.g\.\s+(network\S+=\S+?)\.?\s", accepted("run", "--help").stdout)[1]
    printed = accepted("check", file(DUEL), "--set", example).stdout
    assert tomllib.loads(printed)["network"]["latency"] == {"kind": "constant", "value": 0.05}


def resolved(schema: dict, node: dict, value: object) -> dict:
    """Return the part of a JSON schema that describes a table: behind references, kinds and alternatives."""
    if "$ref" in node:
        return resolved(schema, schema["$defs"][node["$ref"].removeprefix("#/$defs/")], value)
    if "discriminator" in node:
        if not isinstance(value, dict):
            return node
        return resolved(schema, {"$ref": node["discriminator"]["mapping"][value["kind"]]}, value)
    for choice in node.get("anyOf", node.get("oneOf", [])):
        if "properties" in (found := resolved(schema, choice, value)):
            return found
    return node


def unknown_keys(schema: dict, node: dict, tables: dict) -> list[str]:
    """Return the keys that a JSON schema does not allow."""
    if "properties" not in node:  # any keys, such as those of a grid
        return []
    properties = node["properties"]
    unknown = [] if node["additionalProperties"] else [key for key in tables if key not in properties]
    for key, value in tables.items():
        if isinstance(value, dict) and key in properties:
            unknown += unknown_keys(schema, resolved(schema, properties[key], value), value)
    return unknown


@pytest.fixture(scope="module")
def schema() -> dict:
    return json.loads(accepted("schema").stdout)


@pytest.mark.slow
def test_the_schema_is_strict_json():
    assert strict_json(accepted("schema").stdout)["title"] == "Scenario"


@pytest.mark.slow
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_the_schema_has_every_key_of_the_scenarios(schema, path):
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    assert unknown_keys(schema, schema, tables) == []
    tables.setdefault("team", {})["cuont"] = 3
    assert unknown_keys(schema, schema, tables) == ["cuont"]


def test_the_schema_lists_the_protocols_and_describes_every_key(schema):
    protocol = schema["properties"]["protocol"]
    kinds = {resolved(schema, each, {})["properties"]["kind"]["const"] for each in protocol["anyOf"][0]["oneOf"]}
    assert kinds == set(PROTOCOLS.choices())
    for model in [schema, *schema["$defs"].values()]:
        assert model["description"]
    for key in ("name", "seed", "horizon", "protocol"):
        assert schema["properties"][key]["description"]


def test_the_schema_accepts_code_of_a_user_as_a_kind(schema):
    choices = schema["properties"]["protocol"]["anyOf"]
    bare, table = (each for each in choices if "pattern" in str(each))
    assert table == {"type": "object", "properties": {"kind": bare}, "required": ["kind"]}
    assert bare["type"] == "string"
    for kind, is_accepted in [("my_rules:Stubborn", True), ("a.b:C.d", True), ("sap", False), ("sop", False)]:
        assert bool(re.search(bare["pattern"], kind)) == is_accepted


def test_protocols_lists_each_protocol_with_each_of_its_parameters():
    text = accepted("protocols").stdout
    sections = text.strip().split("\n\n")
    assert [section.split(":")[0] for section in sections] == [*PROTOCOLS.choices()]
    for section, protocol in zip(sections, PROTOCOLS.choices().values(), strict=True):
        for name, field in fields_of(protocol).items():
            meaning = re.escape(" ".join((field.description or "").split()))
            described = re.search(rf"^    {name} = .+: {meaning}$", section, re.MULTILINE)
            assert bool(described) == (name != "kind")
    for inner in (
        "paper",
        "scale = 10.0",
        "constant",
        "value = 0.1",
        "shared_seed",
        "slot = 0.01",
        "poisson",
        "rate = 5.0",
    ):
        assert text.count(f"        {inner}") >= 1
    assert text.count("rate = 5.0: Revisions per second of each pursuer") == 1


@pytest.mark.slow
def test_help_loads_nothing_that_takes_time_to_import():
    program = (
        "import sys\nfrom desim.cli import main\n"
        "for args in (['--help'], ['run', '--help'], ['--version']):\n"
        "    try:\n        main(args)\n    except SystemExit as end:\n        assert end.code == 0\n"
        "heavy = {'numpy', 'scipy', 'simpy', 'networkx', 'pydantic', 'matplotlib', 'loky', 'tqdm', 'protocols'}\n"
        "print('loaded:', sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("loaded: []\n")


# run


def rows(table: str) -> dict[str, str]:
    """Return the cells after the first of each row of a table, joined by a space."""
    configurations = (re.split(r"\s{2,}", line.strip()) for line in table.splitlines())
    return {first: " ".join(rest) for first, *rest in configurations}


def test_run_prints_what_happened_as_a_table(file):
    result = accepted("run", file(DUEL))
    assert result.stderr == ""
    assert result.stdout.splitlines()[0] == "duel: 2 pursuers, centralised, seed 7"
    table = rows(result.stdout)
    assert table["captured"] == "after 0.900 s by pursuer 0"
    assert table["active time"].startswith("0.900 s")
    assert table["idle time"].startswith("0.000 s")
    assert table["crowded time"].startswith("0.000 s")
    assert table["decisions"] == "1 1 of them changed an action"
    assert re.fullmatch(r"\d+\.\d{3} s 0 messages/s", table["wall time"])


def test_run_reports_when_the_evader_escaped(file):
    """A capture would take 0.9 s, so for 0.5 s the centre sends no pursuer."""
    table = rows(accepted("run", file(DUEL), "--set", "horizon=0.5").stdout)
    assert table["captured"] == "no, the pursuit ended after 0.500 s the horizon: it may be too short for a capture"
    assert table["idle time"].startswith("0.500 s")
    (run,) = strict_json(accepted("run", file(DUEL), "--json", "--set", "horizon=0.5").stdout)["runs"]
    assert (run["captured"], run["capture_time"], run["capturer"]) == (False, None, None)


@pytest.mark.parametrize(
    ("change", "delivered", "lost", "in_flight"),
    [
        ("network={}", 18, 0, 0),
        ("network={ loss = { kind = 'bernoulli', p = 1.0 } }", 0, 18, 0),
        ("network={ latency = { kind = 'constant', value = 2.0 } }", 0, 0, 18),
        # What is sent at 0.1 ... 0.5 s arrives by 1.0 s (at 0.55 ... 0.95 s), what is sent later does not.
        ("network={ latency = { kind = 'constant', value = 0.45 } }", 10, 0, 8),
    ],
    ids=["ideal", "all lost", "all late", "some late"],
)
def test_run_reports_the_message_counts(file, change, delivered, lost, in_flight):
    path = file(BROADCASTS)
    table = rows(accepted("run", path, "--set", change).stdout)
    names = ("messages sent", "delivered", "lost", "in flight")
    assert [int(table[name].split()[0]) for name in names] == [18, delivered, lost, in_flight]
    assert re.fullmatch(r"\d+\.\d{3} s [\d,]+ messages/s", table["wall time"])
    assert not table["wall time"].endswith(" 0 messages/s")
    (run,) = strict_json(accepted("run", path, "--set", change, "--json").stdout)["runs"]
    assert [run[f"messages_{name}"] for name in ("sent", "delivered", "lost")] == [18, delivered, lost]


def test_json_has_the_numbers_of_a_capture(file):
    document = strict_json(accepted("run", file(DUEL), "--json").stdout)
    assert set(document) == {"scenario", "runs"}
    (run,) = document["runs"]
    expected = {
        "seed": 7,
        "captured": True,
        "capture_time": pytest.approx(0.9, abs=1e-9),
        "capturer": 0,
        "active_time": pytest.approx(0.9, abs=1e-9),
        "idle_time": 0.0,
        "crowded_time": 0.0,
        "switches": 1,
        "messages_sent": 0,
        "messages_delivered": 0,
        "messages_lost": 0,
    }
    assert {key: run[key] for key in expected} == expected


@pytest.mark.parametrize("options", [(), ("-n", 2)], ids=["one run", "two runs"])
def test_json_is_one_document_on_stdout_and_all_else_is_on_stderr(file, tmp_path, options):
    """The evader is too fast, which is warned of, and its range of hearing is infinite, which is no JSON number."""
    path = file(RANDOM)
    overrides = ("evader.speed=9.0", "record.trajectory=0")
    result = accepted("run", path, "--json", *(f"--set={each}" for each in overrides), "-o", tmp_path / "out", *options)
    assert result.stderr.startswith("warning: ")
    scenario = strict_json(result.stdout)["scenario"]
    assert scenario["network"]["range"] == "Infinity"
    assert scenario == load(path, overrides).plain()


@pytest.mark.slow
def test_several_runs_have_seeds_of_their_root_seed_and_each_equals_the_single_run_of_its_seed(file):
    path = file(RANDOM)
    runs = strict_json(accepted("run", path, "-n", 3, "--json").stdout)["runs"]
    seeds = [7_000_000, 7_000_001, 7_000_002]
    assert [run["seed"] for run in runs] == seeds
    alone = [strict_json(accepted("run", path, "-s", seed, "--json").stdout)["runs"] for seed in seeds]
    assert [[run] for run in runs] == alone
    assert len({run["active_time"] for run in runs}) == 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_the_seed_of_the_command_line_replaces_that_of_the_file(file, seed):
    path = file(RANDOM)
    runs = strict_json(accepted("run", path, "-s", seed, "-n", 2, "--json").stdout)["runs"]
    assert [run["seed"] for run in runs] == [1_000_000 * seed, 1_000_000 * seed + 1]
    changed = strict_json(accepted("run", path, "--set", f"seed={seed}", "-n", 2, "--json").stdout)["runs"]
    assert changed == runs


@pytest.mark.slow
def test_the_table_of_several_runs_has_means_with_intervals(file):
    result = accepted("run", file(RANDOM), "-n", 3)
    assert result.stderr == ""
    assert "seeds 7000000 to 7000002" in result.stdout.splitlines()[0]
    table = rows(result.stdout)
    for name in ("active time, s", "idle time, s", "crowded time, s", "messages sent", "messages delivered"):
        assert len(table[name].split()) == 5
    assert "captured in 0 of 3 runs" in result.stdout
    assert re.search(r"^wall time \d+\.\d{3} s, [\d,]+ messages/s$", result.stdout, re.MULTILINE)


@pytest.mark.parametrize(("options", "jobs"), [((), 1), (("-j", 2), 2), (("-j", 0), 0)], ids=["default", "2", "0"])
def test_the_option_sets_the_number_of_workers(file, monkeypatch, options, jobs):
    asked = []
    monkeypatch.setattr(batch, "run_many", lambda tasks, jobs, *_, **__: asked.append(jobs) or run_many(tasks, 1))
    accepted("run", file(RANDOM), "-n", 2, *options)
    assert asked == [jobs]


@pytest.mark.whole
def test_the_number_of_workers_changes_nothing_that_is_printed_or_written(file, tmp_path):
    path = file(RANDOM)
    written = []
    for jobs in (1, 2):
        out, options = tmp_path / f"jobs-{jobs}", ("--set", "record.trajectory=0", "--json")
        printed = accepted("run", path, "-n", 4, "-j", jobs, *options, "-o", out).stdout
        files = sorted(each for each in out.rglob("*") if each.is_file())
        written.append((printed, {str(each.relative_to(out)): each.read_bytes() for each in files}))
    assert written[0] == written[1]
    assert len(written[0][1]) == 4 * len(FILES) + 1


FILES = ["run.json", "scenario.toml", "summary.json", "trace.jsonl"]
PICTURES = ["trajectory.png", "trajectory.svg"]


def names(folder: Path) -> list[str]:
    return sorted(each.name for each in folder.iterdir())


@pytest.mark.slow
def test_the_folder_of_a_run_holds_its_trace_numbers_scenario_and_picture(file, tmp_path, pictures):
    out = tmp_path / "deep" / "out"
    printed = accepted("run", file(RANDOM), "-s", 11, "-o", out, "--json").stdout
    assert names(out) == FILES + PICTURES
    assert strict_json((out / "summary.json").read_text(encoding="utf-8")) == strict_json(printed)["runs"][0]
    events = [strict_json(line) for line in (out / "trace.jsonl").read_text(encoding="utf-8").splitlines()]
    assert {event["event"] for event in events} >= {
        "Started",
        "Decided",
        "Broadcast",
        "Sampled",
        "MessageCounts",
        "Ended",
    }
    assert (out / "trajectory.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (out / "trajectory.svg").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_scenario_that_is_written_repeats_the_run_exactly(file, tmp_path):
    """Its seed is that of the command line, and what was overridden stays so."""
    first, second = tmp_path / "first", tmp_path / "second"
    accepted("run", file(RANDOM), "-s", 11, "--set", "evader.speed=0.5", "-o", first)
    accepted("run", first / "scenario.toml", "-o", second)
    for name in FILES[1:]:
        assert (first / name).read_bytes() == (second / name).read_bytes(), name
    assert load(first / "scenario.toml").seed == 11


@pytest.mark.slow
def test_several_runs_are_written_below_folders_of_their_seeds(file, tmp_path):
    path = file(RANDOM)
    accepted("run", path, "-n", 2, "-o", tmp_path / "both")
    accepted("run", path, "-s", 7000001, "-o", tmp_path / "alone")
    assert names(tmp_path / "both") == ["run.json", "seed-7000000", "seed-7000001"]
    assert names(tmp_path / "both" / "seed-7000000") == FILES
    for name in FILES:
        assert (tmp_path / "both" / "seed-7000001" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes(), (
            name
        )


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_messages_that_go_to_a_file_are_in_the_folders_of_all_runs(file, tmp_path, jobs):
    """The traces are those of runs that keep their messages; repeated from run.json, all is the same."""
    path, out = file(RANDOM.replace("messages = true", "trajectory = 0.0")), tmp_path / "file"
    accepted("run", path, "--set", 'record.messages="file"', "-n", 2, "-j", jobs, "-o", out)
    accepted("run", path, "--set", "record.messages=true", "-n", 2, "-o", tmp_path / "kept")
    for seed in ("seed-7000000", "seed-7000001"):
        assert names(out / seed) == FILES
        assert (out / seed / "trace.jsonl").read_bytes() == (tmp_path / "kept" / seed / "trace.jsonl").read_bytes()
    accepted("run", "--from", out / "seed-7000001" / "run.json", "-o", tmp_path / "again")
    for name in FILES[1:]:
        assert (tmp_path / "again" / name).read_bytes() == (out / "seed-7000001" / name).read_bytes(), name


def test_a_trace_that_cannot_be_written_is_reported(file, tmp_path):
    (tmp_path / "out" / "trace.jsonl.part").mkdir(parents=True)
    (said,) = refused("run", file(RANDOM), "--set", 'record.messages="file"', "-o", tmp_path / "out")
    assert said.startswith(f"--out {tmp_path / 'out' / 'trace.jsonl.part'}: cannot be written")


def test_without_recorded_positions_there_is_no_picture(file, tmp_path, pictures):
    result = accepted("run", file(RANDOM), "--set", "record.trajectory=0", "-o", tmp_path / "out")
    assert names(tmp_path / "out") == FILES
    assert result.stderr == f"wrote {tmp_path / 'out'}\n"


@pytest.mark.slow
def test_without_matplotlib_there_is_a_warning_and_no_picture(file, tmp_path, pictures, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # importing it now raises ImportError
    result = accepted("run", file(RANDOM), "-o", tmp_path / "out")
    assert names(tmp_path / "out") == FILES
    warning = f"warning: no picture: {missing('matplotlib')}"
    assert result.stderr.splitlines() == [warning, f"wrote {tmp_path / 'out'}"]


def test_the_default_scenario_needs_no_key_at_all(file):
    assert load(file("")) == Scenario()


@pytest.mark.slow
def test_a_folder_that_cannot_be_created_for_one_of_several_runs_is_reported(file, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "seed-7000001").touch()
    (said,) = refused("run", file(DUEL), "-n", "2", "-o", tmp_path / "out")
    assert said.startswith(f"--out {tmp_path / 'out' / 'seed-7000001'}: cannot be written")


def test_keys_lists_every_key_of_a_table_with_default_and_unit():
    lines = accepted("keys", "announce").stdout.splitlines()
    assert lines[0].startswith("announce: ")
    assert any(line.startswith("    heartbeat = 0.1: Time between two heartbeats of a pursuer, s.") for line in lines)
    assert any(line.strip().startswith("flooding: ") for line in lines)
    assert not any(line.startswith("network") for line in lines)


def commands_of(group, names=()):
    """Yield the names and the object of each command."""
    for name, made in group.commands.items():
        yield from commands_of(made, (*names, name)) if isinstance(made, click.Group) else [((*names, name), made)]


def test_every_command_and_every_option_has_a_help_text():
    commands = dict(commands_of(main))
    assert len(commands) > 25
    for names, made in commands.items():
        assert made.help, names
        assert not [option.opts for option in made.params if isinstance(option, click.Option) and not option.help], (
            names
        )


def test_every_option_says_what_it_does():
    options = [option for _, made in commands_of(main) for option in made.params if isinstance(option, click.Option)]
    assert len(options) > 100
    assert [option.opts for option in options if not option.help] == []


def test_the_usage_and_the_options_of_every_command_are_golden():
    """The words for values, the bounds and the defaults, as --help shows them, in the order of its lists."""
    lines = []
    for names, made in commands_of(main):
        context = click.Context(made, info_name=" ".join(("desim", *names)))
        lines += ["", " ".join([context.info_name, *made.collect_usage_pieces(context)])]
        for record in (option.get_help_record(context) for option in made.params if isinstance(option, click.Option)):
            words, text = record or ("hidden", "")
            notes = re.search(r"\[[^\]]*\]$", text)
            lines.append(f"    {words}{f'  {notes[0]}' if notes else ''}")
    golden("usage.txt", "\n".join(lines[1:]) + "\n")


def test_a_label_is_split_after_the_shortest_value_of_the_sweep():
    swept = SimpleNamespace(keys=("x",), values=lambda key: ["a", "a=b", "c=d"])
    given = [("a", "b=text"), ("c", "d=text"), ("other", "text=more")]
    assert labels_of(swept, given) == {"a": "b=text", "c=d": "text", "other": "text=more"}


def test_the_key_that_names_another_file_is_listed_alone():
    (line,) = accepted("keys", "base").stdout.splitlines()
    assert line.startswith("base: ")


def test_keys_goes_to_the_given_depth():
    latency = accepted("keys", "network.latency").stdout.splitlines()
    assert latency[0].startswith("latency = { kind = 'constant' }: ")
    gamma = accepted("keys", "network.latency.gamma").stdout.splitlines()
    assert gamma[0].startswith("gamma: ")
    assert [line.split()[0] for line in gamma[1:]] == list(Gamma.model_fields)[1:]
    (shape,) = accepted("keys", "network.latency.gamma.shape").stdout.splitlines()
    assert shape.startswith("shape = ")
    assert accepted("keys", "protocol.sap.tau.paper.scale").stdout.startswith("scale = 10.0: ")
    assert accepted("keys", "wall.0.line").stdout == accepted("keys", "wall.line").stdout


@pytest.mark.parametrize(
    ("key", "why"),
    [
        ("netwrok", "there is no 'netwrok'; allowed: name, seed, "),
        ("network.latnecy", "there is no 'latnecy'; allowed: preset, graph, "),
        ("network.latency.gama", "there is no 'gama' in 'latency'; allowed: constant, "),
        ("network.range.of", "there is no 'of' in 'range'; allowed: nothing"),
        ("protocol.kind", "there is no 'kind' in 'protocol'; allowed: "),
        ("protocol.schedule", "'schedule' in 'protocol' depends on the kind: protocol.argmin_known.schedule, "),
        ("evader.strategy.still.of", "there is no 'of'; allowed: nothing"),
        ("", "there is no ''; allowed: name, "),
        ("0", "there is no '0'; allowed: name, "),
        ("fault.0.kinds", "'kinds' in 'fault' depends on the kind: fault.random.kinds"),
    ],
)
def test_keys_that_do_not_exist_are_refused(key, why):
    (said,) = refused("keys", key)
    assert said.startswith(why)


@pytest.mark.parametrize(
    ("key", "advice"),
    [
        ("packet-loss", "; did you mean network.loss?"),
        ("network.latency.Mean", "; did you mean network.latency.mean?"),
        ("network.delay", "; did you mean network.latency.delay or fault.0.delay?"),
        ("network.loss.kind", ", signal_trace"),
    ],
)
def test_keys_that_are_spelled_in_another_way_are_suggested(key, advice):
    """A kind has no suggestion: the message has those of the key."""
    (said,) = refused("keys", key)
    assert said.endswith(advice)


@pytest.mark.parametrize(
    ("kind", "traits"),
    [
        ("server", ["assumes = ('host_in_range', 'no_crashes')", "announces = False", "reckons = True"]),
        ("voronoi", ["announces = 'unseen'", "assumes = ('no_crashes', 'positions_known', 'equal_speeds')"]),
        ("centralised", ["omniscient = True", "embodied = False", "assumes = ()"]),
        ("cbba", ["claim_size = CBBA.claim_size", "announces = True"]),
    ],
)
def test_protocols_prints_the_traits_of_one_with_what_they_mean(kind, traits):
    _, _, text = accepted("protocols", kind).stdout.partition("\n    traits:\n")
    found = dict(line.strip().split(": ", 1) for line in text.splitlines() if line)
    assert set(traits) <= set(found)
    assert [each.partition(" = ")[0] for each in found] == [*ProtocolTraits.names()]
    assert all(found.values())


def test_protocols_lists_a_single_protocol_on_request():
    text = accepted("protocols", "local_min").stdout
    assert text.startswith("local_min: ")
    assert "\nsap: " not in text
    (said,) = refused("protocols", "loca_min")
    assert said.startswith("there is no protocol 'loca_min', did you mean 'local_min'?; allowed: argmin, ")


OWN_PROTOCOLS = '''
from typing import ClassVar

from protocols.rule import Rule


class Plain:
    """Announces nothing."""

    announces = False

    def __call__(self, me):
        yield me.sleep(1.0)


class Seeing(Rule):
    """Sees all."""

    omniscient: ClassVar[bool] = True
'''


def test_protocols_prints_the_traits_of_a_user_protocol_if_its_code_may_run(tmp_path, monkeypatch):
    (tmp_path / "own_protocols.py").write_text(OWN_PROTOCOLS)
    monkeypatch.chdir(tmp_path)
    plain = accepted("protocols", "own_protocols:Plain", "--allow-import").stdout
    assert plain.startswith("own_protocols:Plain: Announces nothing.\n    traits:\n")
    assert "        announces = False: " in plain
    seeing = accepted("protocols", "own_protocols:Seeing", "--allow-import").stdout
    assert seeing.startswith("own_protocols:Seeing: Sees all.\n    schedule = { kind = 'shared_seed' }: ")
    assert "        omniscient = True: " in seeing
    (said,) = refused("protocols", "own_protocols:Plain")
    assert "'own_protocols:Plain' names code to be run" in said
    (said,) = refused("protocols", "own_protocols:Plane", "--allow-import")
    assert "'own_protocols:Plane' cannot be imported" in said


def test_keys_without_a_table_lists_all_of_them():
    text = accepted("keys").stdout
    assert all(re.search(rf"^    {name}\b", text, re.MULTILINE) for name in Scenario.model_fields)


ODD = """\
name = "odd"
horizon = 5.0
team.count = 4

[motion]
step = 0.05

[protocol]
kind = "sap"
schedule = { kind = "periodic", period = 0.2, jitter = 0.0 }

[announce]
trigger = "never"
start = "known"
dissemination = { kind = "gossip" }

[network]
preset = "wifi"
latency = { kind = "constant", value = 0.1 }
reception = { kind = "log_distance" }

[[fault]]
kind = "crash"
node = 0
start = 1.0

[[fault]]
kind = "crash"
node = 1
start = 6.0
"""


def test_every_warning_is_printed_on_stderr_with_file_line_and_key(file):
    """A preset, a range, an announcement, a timer and a fault with unintended effects; the scenario is valid."""
    path = file(ODD)
    result = accepted("check", path)
    *lines, last = result.stderr.splitlines()
    said = [re.match(r"warning: (.*): ([\w.]+): (.*)", line).groups() for line in lines]
    assert last == f"{path} is valid"
    assert {key: (where, why) for where, key, why in said} == {
        "network.latency": (f"{path}:19", "it overrides the value of the preset 'wifi'"),
        "network.reception": (f"{path}:20", "it has no effect while the range is inf"),
        "announce.dissemination": (f"{path}:15", "it has no effect, because nothing is ever announced"),
        "fault.1.start": (f"{path}:30", "the fault starts after the horizon"),
        "protocol": (f"{path}:8", "sap assumes messages_get_through, but nothing is ever announced"),
        "protocol.schedule.jitter": (
            f"{path}:10",
            "a strictly periodic timer of 4 motion steps, an even number, is synchronous with an evader that chatters"
            " between two pursuers, so possibly no pursuer is active for seconds: give it some jitter",
        ),
    }
    assert len(said) == 6
    assert "warning" not in result.stdout


def test_an_override_of_one_key_of_a_preset_keeps_the_others_and_gives_a_warning():
    """Three may wait, on LoRa at SF 7 and with ALOHA as before."""
    (lora,) = (path for path in SCENARIOS if path.stem == "lora")
    override = "network.medium.queue_limit=3"
    before, after = load(lora).network.medium, load(lora, [override]).network.medium
    assert (before.queue_limit, after) == (1, before.model_copy(update={"queue_limit": 3.0}))
    said, _ = accepted("check", lora, "--set", override).stderr.splitlines()
    assert said.startswith(f"warning: --set {override}: network.medium: it overrides the value of the preset")
    assert accepted("check", lora).stderr == f"{lora} is valid\n"


# Sweeps: options, output, and what is refused.

COINS = """\
name = "coins"
seed = 5
horizon = 0.5
team = { count = 3, box = [9.0, 11.0] }
motion.step = 0.05

[sweep]
reps = 3

[sweep.grid]
"network.range" = [1.0, inf]
protocol.kind = ["sap", "best_response"]
"""


def swept(*args: object) -> dict:
    """Return the document of a sweep."""
    return strict_json(accepted("sweep", *args, "--json").stdout)


@pytest.fixture(scope="module")
def coins(tmp_path_factory):
    """Return a folder with the scenario file COINS, and its sweep in `out`, for reading only; and what was printed."""
    folder = tmp_path_factory.mktemp("coins")
    (folder / "coins.toml").write_text(COINS)
    return folder, accepted("sweep", folder / "coins.toml", "-o", folder / "out")


def seeds_of(table: Path) -> list[tuple[str, ...]]:
    """Return range, kind and seed of each run in a file."""
    with table.open(newline="") as stream:
        return [(row["network.range"], row["protocol.kind"], row["seed"]) for row in csv.DictReader(stream)]


@pytest.mark.slow
def test_a_sweep_prints_means_differences_and_the_location_of_its_runs(coins):
    folder, result = coins
    means, differences, start, captureless = result.stdout.split("\n\n")
    assert captureless.startswith("warning: no run ended by a capture, the longest after 0.5 s, ")
    assert start.startswith('announce.start = "announced": ')
    assert means.startswith("coins: 4 configurations, 12 runs; ")
    assert [line.split()[:3] for line in means.splitlines()[2:]] == [
        ["1", "sap", "3"],
        ["1", "best_response", "3"],
        ["inf", "sap", "3"],
        ["inf", "best_response", "3"],
    ]
    assert differences.startswith("difference from network.range = 1, all else equal, ")
    assert [line.split()[:3] for line in differences.splitlines()[2:]] == [
        ["inf", "sap", "3"],
        ["inf", "best_response", "3"],
    ]
    assert re.fullmatch(
        rf"12 runs in [\d.]+ s \([\d.]+/s\), 0 already stored; store: {folder}/out/sweep.sqlite\n"
        r"wrote sweep.txt, means-active_time.svg, means-active_time.png beside it\n",
        result.stderr,
    )
    assert names(folder / "out") == [
        "means-active_time.png",
        "means-active_time.svg",
        "run.json",
        "sweep.sqlite",
        "sweep.txt",
    ]
    assert (folder / "out" / "sweep.txt").read_text() == result.stdout


@pytest.mark.slow
def test_a_sweep_over_a_key_without_effect_is_warned_of(file, tmp_path):
    """Under local_min only the pursuer of least capture time stays active, however late the others hear of it.

    Under argmin, nothing is announced, which is known before the runs.
    """
    path = file(COINS)
    grid = ("--set", 'sweep.grid={ "network.latency.value" = [0.0, 0.04] }', "--set", "protocol={ kind = 'local_min' }")
    result = accepted("sweep", path, "-o", tmp_path / "out", *grid)
    said = result.stdout.splitlines()[-1]
    assert said.startswith("warning: nothing shown (captured, active time, capture time, messages sent) depends on")
    assert "network.latency.value: equal in 3 pairs of runs that differ in it only" in said
    assert (tmp_path / "out" / "sweep.txt").read_text() == result.stdout
    assert "warning" not in result.stderr
    as_json = accepted("sweep", path, "-o", tmp_path / "out", *grid, "--json")
    assert [f"warning: {each}" for each in strict_json(as_json.stdout)["warnings"]][1:] == [said]
    assert said in as_json.stderr.splitlines()
    accepted("report", tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert f'<p class="bad">Warning: {said.removeprefix("warning: ")}</p>' in page
    silent = accepted("sweep", path, *grid, "--set", "protocol.kind=argmin", "--dry-run").stderr
    assert silent == (
        'warning: --set sweep.grid={ "network.latency.value" = [0.0, 0.04] }: sweep.grid: network.latency.value:'
        " it probably has no effect: positions are sensed, so nothing is announced (`announce.payload`) under argmin\n"
    )


@pytest.mark.slow
def test_a_sweep_goes_by_default_to_a_folder_of_its_name_and_goes_on_there(file, tmp_path, coins, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = file(COINS)
    first = accepted("sweep", path, "-n", 2)
    assert "8 runs in" in first.stderr
    second = accepted("sweep", path)
    assert second.stderr.startswith("4 runs in")
    assert "8 already stored; store: out/coins/sweep.sqlite" in second.stderr
    assert second.stdout == coins[1].stdout


@pytest.mark.slow
def test_exported_tables_have_labels_and_leave_out_columns(coins, tmp_path):
    """A number may be written otherwise, and the kind of a value stands for it; rows of runs have no labels."""
    folder, _ = coins
    words = ("export", folder / "out", tmp_path / "t.tex", "--label", "1.00=near", "--label", "network.range=range")
    assert accepted(*words, "--without", "captured").stderr.startswith("wrote tables of 4 configurations, 12 runs, to ")
    text = (tmp_path / "t.tex").read_text()
    assert "\nrange & protocol.kind & runs & active time, s &" in text
    assert "\nnear & sap & $3$ &" in text
    assert "\n$\\infty$ & sap & $3$ &" in text
    refusal = refused("export", folder / "out", tmp_path / "t.csv", "--label", "1.00=near")
    assert "are of the tables of a sweep (.tex, .md)" in " ".join(refusal)
    assert "no table has a column capture" in " ".join(refused(*words, "--without", "capture"))


@pytest.mark.slow
def test_a_sweep_over_a_part_of_the_grid_leaves_the_table_and_the_figure_of_all(file, tmp_path):
    """The table of the part is printed; that of the whole store, in numeric order, is written."""
    path = file(COINS)
    folder = tmp_path / "out"
    for losses in ("0.3,0.0,0.1", "0.3,0.0"):
        made = accepted(
            "sweep", path, "-o", folder, "-n", 2, "-g", f"network.loss.p={losses}", "-g", "protocol.kind=sap"
        )
    assert "of all 6 configurations of the store; the table above has 4 of them" in made.stderr
    assert ": 4 configurations, 8 runs;" in made.stdout
    means = (folder / "sweep.txt").read_text().split("\n\n")[0].splitlines()
    assert ": 6 configurations, 12 runs;" in means[0]
    losses = [line.split()[means[1].split().index("network.loss.p")] for line in means[2:]]
    assert losses == ["0", "0.1", "0.3"] * 2
    accepted("export", folder, folder / "runs.md")
    head, _, *rows = (
        [cell.strip() for cell in line.split("|")] for line in (folder / "runs.md").read_text().splitlines()[2:10]
    )
    assert [row[head.index("network.loss.p")] for row in rows[:6]] == losses


@pytest.mark.slow
def test_the_runs_of_a_sweep_have_the_seeds_of_the_option(file, tmp_path):
    accepted("sweep", file(COINS), "-o", tmp_path / "out", "-s", 40, "-n", 2)
    accepted("export", tmp_path / "out", tmp_path / "x.csv")
    assert seeds_of(tmp_path / "x.csv") == [
        (reach, kind, seed)
        for reach in ("1.0", "inf")
        for kind in ("sap", "best_response")
        for seed in ("40000000", "40000001")
    ]


@pytest.mark.slow
def test_a_sweep_as_json_is_one_document_on_stdout(file, tmp_path):
    made = swept(file(COINS), "-o", tmp_path / "out", "--metric", "energy", "--metric", "switches")
    assert (made["name"], made["grid"]) == ("coins", ["network.range", "protocol.kind"])
    assert [each["settings"]["network.range"] for each in made["configurations"]] == [1.0, 1.0, "Infinity", "Infinity"]
    assert {tuple(each["metrics"]) for each in made["configurations"]} == {("energy", "switches")}
    (runs,) = {each["metrics"]["energy"]["runs"] for each in made["configurations"]}
    assert runs == 3


@pytest.mark.whole
def test_a_sweep_does_as_many_runs_as_a_precision_takes(file, tmp_path):
    one = ("--set", 'sweep.grid={ "network.range" = [1.0] }')
    made = swept(file(COINS), "-o", tmp_path / "out", "--until", "active_time:0.5", *one)
    assert [each["runs"] for each in made["configurations"]] == [100]
    few = swept(file(COINS), "-o", tmp_path / "few", "--until", "active_time:1e-9", "-n", 5)
    assert [each["runs"] for each in few["configurations"]] == [5] * 4


def test_overrides_reach_the_grid_and_what_is_varied(file, tmp_path):
    options = ("--set", "sweep.reps=2", "--set", "sweep.grid.network.range=[3.0]", "--set", "horizon=0.2")
    made = swept(file(COINS), "-o", tmp_path / "out", *options, "--metric", "end_time")
    assert [each["settings"]["network.range"] for each in made["configurations"]] == [3.0, 3.0]
    assert {each["runs"] for each in made["configurations"]} == {2}
    assert all(each["metrics"]["end_time"]["mean"] <= 0.2 for each in made["configurations"])


def test_the_grid_of_the_command_line_adds_to_that_of_the_file_and_replaces_its_values(file):
    path = file("[sweep]\nreps = 1\n[sweep.grid]\nnetwork.range = [1.0, 2.0]\n'evader.speed' = [0.5]\n")
    values = "protocol=cbba,{ kind = 'sap', tau = { kind = 'constant', value = 0.5 } }"
    shown = accepted("sweep", path, "--dry-run", "-g", "network.range=inf, 3.0,4", "--grid", values).stdout
    head, titles, *configurations = shown.splitlines()
    assert head.startswith("unnamed: 6 configurations, 6 runs; ")
    assert titles.split() == ["runs", "stored", "network.range", "evader.speed", "protocol"]
    found = [line.split()[2:] for line in configurations]
    assert found == [[a, "0.5", b] for a in ("inf", "3", "4") for b in ("cbba", "sap(tau=constant(value=0.5))")]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("horizon", "should be KEY=V1,V2,... in one word, for instance "),
        ("=1,2", "should be KEY=VALUE,VALUE,..., for instance network.latency.value=0.0,0.1"),
        ("horizon=", "'' has an empty value"),
        ("horizon=1,,2", "'1,,2' has an empty value"),
        ("horizon=[1,2", "'[1,2' is not a TOML value"),
        ("horizon=1,x", "sweep.grid: horizon: should be a number; "),
        ("horizn=1,2", "sweep.grid: horizn: unknown key, did you mean 'horizon'?; "),
        ("protocol=sap,sop", "sweep.grid: protocol.kind: there is no 'sop', did you mean 'sap'?; "),
        ("protocol=a:B", "sweep.grid: protocol.kind: 'a:B' names code to be run; "),
        ("name=a,b", "sweep.grid: name: cannot be swept; "),
    ],
)
def test_a_grid_of_the_command_line_that_is_wrong_is_refused(file, text, why):
    (said,) = refused("sweep", file("seed = 1\n"), "--dry-run", "-g", text)
    assert said.startswith(f"--grid {text}: {why}")


def test_a_dry_run_says_at_how_many_runs_a_target_is_first_judged(file):
    result = accepted("sweep", file(COINS), "--dry-run", "--until", "active_time:0.2", "-n", 500)
    rule = f"at most, and at least {FIRST_LOOK} of each, until the half width of active_time is 0.2"
    assert result.stdout.startswith(f"coins: 4 configurations, 2,000 runs {rule}; 0 stored")


@pytest.mark.slow
def test_a_dry_run_prints_the_plan_and_writes_nothing(file, tmp_path):
    out = tmp_path / "out"
    result = accepted("sweep", file(COINS), "-o", out, "--dry-run")
    assert result.stdout.startswith("coins: 4 configurations, 12 runs; 0 stored, 12 to do\n")
    assert not out.exists()
    accepted("sweep", file(COINS), "-o", out, "-n", 1)
    before = {each.name: each.read_bytes() for each in out.iterdir()}
    result = accepted("sweep", file(COINS), "-o", out, "--dry-run")
    assert result.stdout.startswith("coins: 4 configurations, 12 runs; 4 stored, 8 to do\n")
    assert [line.split() for line in result.stdout.splitlines()[2:]] == [
        ["3", "1", "1", "sap"],
        ["3", "1", "1", "best_response"],
        ["3", "1", "inf", "sap"],
        ["3", "1", "inf", "best_response"],
    ]
    assert {each.name: each.read_bytes() for each in out.iterdir()} == before


@pytest.mark.slow
def test_the_parts_of_a_sweep_together_are_the_whole(file, tmp_path, coins):
    """12 runs in parts of 3, 3, 2, 2, 2: five stores, merged, and then nothing is left to be done."""
    path, parts = file(COINS), tmp_path / "parts"
    for k in range(1, 6):
        accepted("sweep", path, "-o", parts, "--shard", f"{k}/5")
    assert names(parts) == ["run.json", *(f"sweep.{k}-of-5.sqlite" for k in range(1, 6))]
    merged = accepted("merge", *sorted(parts.glob("*.sqlite")), "-o", tmp_path / "all")
    assert merged.stdout == f"12 runs are in {tmp_path}/all/sweep.sqlite\n"
    rest = accepted("sweep", path, "-o", tmp_path / "all")
    assert rest.stderr.startswith("0 runs in")
    assert rest.stdout == coins[1].stdout
    accepted("export", tmp_path / "all", tmp_path / "all.csv")
    accepted("export", coins[0] / "out", tmp_path / "whole.csv")
    assert (tmp_path / "all.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def asked(folder, name="sweep.sqlite"):
    """Return the command lines that a store tells of, without the program, the last one last."""
    with Store(folder / name, read_only=True) as store:
        return [argv[1:] for _, argv in store.commands]


@pytest.fixture
def typed(monkeypatch):
    """Return a function that calls the command and puts its arguments in run.json as typed."""

    def call(*words):
        monkeypatch.setattr("sys.argv", ["desim", *map(str, words)])
        accepted(*words)
        return list(map(str, words))

    return call


@pytest.mark.slow
def test_a_smaller_sweep_into_the_same_folder_keeps_the_output_of_the_larger(file, tmp_path, typed):
    out = ("-o", tmp_path / "out")
    typed("sweep", file(COINS), *out)
    whole = (tmp_path / "out" / "run.json").read_bytes()
    typed("sweep", file(COINS), *out, "-n", 1)
    typed("sweep", file(COINS), *out, "--set", "sweep.grid.network.range=[inf]")
    assert (tmp_path / "out" / "run.json").read_bytes() == whole


@pytest.mark.whole
def test_every_command_that_adds_runs_is_kept_once_and_the_last_is_in_run_json(file, tmp_path, typed):
    path, out = file(COINS), ("-o", tmp_path / "out")
    small = typed("sweep", path, *out, "-n", 1)
    wide = typed("sweep", path, *out, "-n", 2)
    typed("sweep", path, *out, "--until", "active_time:1e-9", "-n", 1)
    other = typed("sweep", path, *out, "-n", 1, "--set", "sweep.grid.network.range=[2.0]")
    assert asked(tmp_path / "out") == [small, wide, other]
    assert provenance.read(tmp_path / "out" / "run.json")["argv"][1:] == other
    with Store(tmp_path / "out" / "sweep.sqlite") as store:
        store.database.execute("DELETE FROM runs")
        store.database.commit()
    typed("sweep", path, *out, "-n", 2)
    assert asked(tmp_path / "out") == [small, wide, other]


@pytest.mark.whole
def test_a_merged_store_has_the_command_of_each_part(file, tmp_path, typed):
    path = file(COINS)
    parts = [typed("sweep", path, "-o", tmp_path / "parts", "--shard", f"{k}/3") for k in (1, 2, 3)]
    assert [asked(tmp_path / "parts", f"sweep.{k}-of-3.sqlite") for k in (1, 2, 3)] == [[each] for each in parts]
    together = typed("merge", tmp_path / "parts", "-o", tmp_path / "parts")
    assert asked(tmp_path / "parts") == [*parts, together]


@pytest.mark.slow
def test_a_run_json_that_cannot_be_read_is_written_anew(file, tmp_path, typed):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "run.json").write_text('{"what": "swe')
    words = typed("sweep", file(COINS), "-o", tmp_path / "out", "-n", 1)
    assert asked(tmp_path / "out") == [words]
    assert provenance.read(tmp_path / "out" / "run.json")["argv"][1:] == words


@pytest.mark.slow
def test_runs_are_exported_a_row_each(coins, tmp_path):
    import pandas as pd

    for name in ("x.csv", "x.parquet"):
        result = accepted("export", coins[0] / "out", tmp_path / name)
        assert result.stderr == f"wrote 12 runs to {tmp_path / name}\n"
    with (tmp_path / "x.csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    frame = pd.read_parquet(tmp_path / "x.parquet")
    assert len(table) == len(frame) == 12
    assert list(table[0]) == list(frame)
    for column in ("active_time", "network.range"):
        assert [float(row[column]) for row in table] == frame[column].tolist()


REFUSED_SWEEPS = {
    "metric": (
        ["--metric", "energi"],
        r"--metric energi: there is no numeric metric 'energi', did you mean 'energy'\?; there are captured, .*",
    ),
    "metric that is no number": (
        ["--metric", "capturer"],
        r"--metric capturer: there is no numeric metric 'capturer', .*",
    ),
    "part and precision": (["--until", "energy:1", "--shard", "1/2"], r"--until .* exclude each other"),
    "key": (
        ["--set", "sweep.grid.horizn=[1.0]"],
        r"--set sweep\.grid\.horizn=\[1\.0\]: sweep\.grid: horizn: unknown key, did you mean 'horizon'\?.*",
    ),
    "no grid": (["--set", "sweep.grid={}"], r"--set sweep\.grid=\{\}: sweep\.grid: should have at least one key.*"),
}


@pytest.mark.parametrize(("options", "why"), REFUSED_SWEEPS.values(), ids=REFUSED_SWEEPS)
def test_a_sweep_that_makes_no_sense_is_refused_before_anything_is_written(file, tmp_path, options, why):
    (line,) = refused("sweep", file(COINS), "-o", tmp_path / "out", *options)
    assert re.fullmatch(why, line)
    assert not (tmp_path / "out").exists()


def test_a_file_without_a_grid_is_refused(file, tmp_path):
    (line,) = refused("sweep", file(RANDOM), "-o", tmp_path / "out")
    assert line.startswith(f"{file(RANDOM)}:1: sweep.grid: should have at least one key of the scenario")


@pytest.mark.parametrize(
    "options",
    [
        ["-n", 0],
        ["-s", -1],
        ["-j", -1],
        ["--shard", "0/2"],
        ["--shard", "3/2"],
        ["--shard", "2"],
        ["--until", "energy"],
        ["--until", "energi:1"],
        ["--until", "energy:0"],
        ["--until", "energy:x"],
        ["--until", "capturer:1"],
    ],
)
def test_an_option_of_a_sweep_out_of_range_is_refused(file, options):
    assert any("Invalid value for" in line for line in refused("sweep", file(COINS), *options))


@pytest.mark.slow
def test_the_store_of_another_sweep_is_refused_with_the_differences(file, tmp_path):
    path, out = file(COINS), tmp_path / "out"
    accepted("sweep", path, "-o", out, "-n", 1)
    store, hint = out / "sweep.sqlite", "; remove it, or choose another folder (-o, in Python store=)"
    assert refused("sweep", path, "-o", out, "--set", "horizon=0.6") == [
        f"{store}: was made by another scenario: horizon was 0.5, is 0.6{hint}"
    ]
    seed = f"{store}: was made by another sweep: root seed was 5, is 6{hint}"
    assert refused("sweep", path, "-o", out, "-s", 6) == [seed]
    accepted("sweep", path, "-o", tmp_path / "other", "-n", 1, "-s", 6)
    assert refused("merge", out, tmp_path / "other", "-o", tmp_path / "all") == [seed]
    assert not (tmp_path / "all").exists()


def test_a_file_that_is_not_a_store_is_refused(file, tmp_path):
    (tmp_path / "hello.sqlite").write_text("hello")
    (tmp_path / "empty.sqlite").write_text("")
    (tmp_path / "folder").mkdir()
    target = tmp_path / "x.csv"
    (said,) = refused("export", tmp_path / "none.sqlite", target)
    assert said == f"{tmp_path}/none.sqlite: there is no such store; `desim sweep FILE -o DIR` makes one in DIR"
    (said,) = refused("export", tmp_path / "helo.sqlite", target)
    assert said == f"{tmp_path}/helo.sqlite: there is no such store, did you mean 'hello.sqlite'?"
    nothing = "has no result of desim: neither trace.jsonl nor sweep.sqlite"
    assert refused("export", tmp_path / "folder", target) == [f"{tmp_path}/folder: {nothing}"]
    (tmp_path / "folder" / "delay").mkdir()
    (tmp_path / "folder" / "delay" / "sweep.sqlite").write_text("")
    below = "has no result itself, but its folders have (delay): give one of them"
    assert refused("export", tmp_path / "folder", target) == [f"{tmp_path}/folder: {below}"]
    (said,) = refused("export", tmp_path / "hello.sqlite", target)
    assert said.startswith(f"{tmp_path}/hello.sqlite: file is not a database, and is left as it is")
    assert refused("export", tmp_path / "empty.sqlite", target) == [f"{tmp_path}/empty.sqlite: is empty"]
    assert not target.exists()


def test_a_file_that_cannot_be_exported_to_is_refused(coins, tmp_path):
    (why,) = refused("export", coins[0] / "out", tmp_path / "x.txt")
    assert why == f"{tmp_path}/x.txt: should end in .csv, .parquet, .tex or .md"
    (why,) = refused("export", coins[0] / "out", tmp_path / "none" / "x.csv")
    assert why == f"{tmp_path}/none/x.csv: cannot be written: No such file or directory"


@pytest.mark.slow
def test_without_matplotlib_a_sweep_has_no_picture(file, tmp_path, pictures, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    accepted("sweep", file(COINS), "-o", tmp_path / "out", "-n", 1)
    assert names(tmp_path / "out") == ["run.json", "sweep.sqlite", "sweep.txt"]

"""What strangers send may be read: files, graphs, folders, stores and names run no code and write nothing elsewhere."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import click
import pytest

import desim
from desim import Scenario
from desim.analysis.drawing.plots import save
from desim.analysis.drawing.trajectory import trajectory
from desim.cli import main
from desim.config import named_code
from desim.config.escaping import escaped
from desim.kernel.models.latency import Empirical
from desim.kernel.models.links import Links
from desim.results import run_folder
from desim.scenario.overrides import ScenarioError
from desim.scenario.toml import read_source
from desim.simulation.run import run
from desim.study.ablation.explain import explain
from desim.study.sweeps.sweep import sweep
from tests.command import accepted, refused
from tests.command import desim as call
from tests.test_kinds import defaults

ROOT = Path(__file__).parent.parent
SHORT = "horizon = 0.1\nteam.count = 2\n"
EVIL = """
from pathlib import Path
from typing import Annotated, Any

from desim.kernel.models.latency_by_link import LATENCIES
from desim.config.model import Value

Path({mark!r}).touch()


class Caught:
    def __init__(self, **given):
        Path({mark!r}).touch()


class Twice(Value):
    of: Annotated[Any, LATENCIES]

    def __call__(self, context, rng):
        return 2 * self.of(context, rng)


def late(context, rng):
    return 0.25
"""


@pytest.fixture
def mark(tmp_path):
    """Return a file that is there as soon as the module `evil`, which lies beside scenario files, is imported."""
    (tmp_path / "evil.py").write_text(EVIL.format(mark=str(tmp_path / "mark")))
    return tmp_path / "mark"


@pytest.fixture
def written(tmp_path):
    """Return a function that writes a scenario file."""

    def write(text: str, name: str = "f.toml") -> Path:
        (tmp_path / name).write_text(SHORT + text, encoding="utf-8")
        return tmp_path / name

    return write


@pytest.fixture
def _no_pictures(monkeypatch):
    """They take a second."""
    monkeypatch.setattr(run_folder, "can_plot", lambda: False)


# Code that a file names.

CODE = '{ kind = "evil:late" }'
CAUGHT = '{ kind = "evil:Caught" }'
POPEN = '{ kind = "subprocess:Popen", args = ["touch", "MARK"] }'
PLACES = {
    "protocol": "protocol = {}",
    "protocol.schedule": 'protocol = {{ kind = "sap", schedule = {} }}',
    "protocol.tau": 'protocol = {{ kind = "sap", tau = {} }}',
    "protocol.utility": 'protocol = {{ kind = "sap", utility = {} }}',
    "network.latency": "network.latency = {}",
    "network.latency.base": 'network.latency = {{ kind = "per_pair", base = {} }}',
    "network.loss": "network.loss = {}",
    "network.duplicate": "network.duplicate = {}",
    "network.reception": "network.reception = {}",
    "network.graph": "network.graph = {}",
    "network.medium": "network.medium = {}",
    "network.transport": "network.transport = {}",
    "network.processing.sender": "network.processing.sender = {}",
    "clocks.sync": "clocks.sync = {}",
    "network.link.0.latency": "network.link = [{{ src = 0, dst = 1, latency = {} }}]",
    "network.graph.edges.0.loss": 'network.graph = {{ kind = "edges", edges = [{{ src = 0, dst = 1, loss = {} }}] }}',
    "evader.strategy": "evader.strategy = {}",
    "evader.strategy.during_handover": 'evader.strategy = {{ kind = "listener", during_handover = {} }}',
    "evader.0.strategy": "[[evader]]\nstrategy = {}",
    "team.guidance": "team.guidance = {}",
    "team.relay.0.motion": "team.relay = [{{ pursuer = 0, motion = {} }}]",
    "team.dynamics": "team.dynamics = {}",
    "evader.dynamics": "evader.dynamics = {}",
    "environment.flow": "environment.flow = {}",
    "sensing.noise": "sensing.noise = {}",
    "sensing.estimator": "sensing = {{ noise = 0.1, estimator = {} }}",
    "announce.trust": "announce.trust = {}",
    "announce.dissemination": "announce.dissemination = {}",
    "fault.0": "fault = [{}]",
    "sweep.grid.network.latency": "[sweep.grid]\nnetwork.latency = [{}]",
    "sweep.grid.protocol": '[sweep.grid]\nprotocol = [{{ kind = "sap" }}, {{ kind = "sap", tau = {} }}]',
}


@pytest.mark.parametrize(("key", "table"), [*((key, CODE) for key in PLACES), ("network.latency", POPEN)])
def test_a_file_names_no_code_with_file_line_key_and_what_to_do(mark, written, key, table):
    file = written(PLACES[key].format(table.replace("MARK", str(mark))))
    before = [*sys.path]
    said = refused("check", file)
    kind = "" if key.startswith("sweep.grid") else ".kind"
    assert said.startswith(f"{file}:{4 if '[' in PLACES[key][:2] else 3}: {key}{kind}: ")
    assert "names code to be run" in said
    assert "--allow-import" in said
    assert not mark.exists()
    assert "evil" not in sys.modules
    assert sys.path == before


def test_no_key_of_a_scenario_that_takes_models_is_missing_above():
    """A key of the defaults that holds a model is refused above, or is one that holds the same models."""
    known = {key.split(".")[-1] for key in PLACES}
    found = {key for key, inner in _tables(Scenario().model_dump()) if "kind" in inner}
    assert {key.split(".")[-1] for key in found} <= known | {"cooling"}


def _tables(node, above=""):
    for key, each in node.items():
        if isinstance(each, dict):
            yield f"{above}{key}", each
            yield from _tables(each, f"{above}{key}.")


COMMANDS = [
    *(["run"], ["sweep", "--dry-run"], ["explain", "-n", "2"], ["replay"], ["export"]),
    *(["plot", "--kind", kind] for kind in ("trajectory", "spacetime", "perfetto", "film")),
]


@pytest.mark.parametrize("words", COMMANDS)
def test_no_command_runs_code_named_in_a_file(mark, written, words):
    file = written(f"network.latency = {CODE}")
    to = [file.with_name("x.csv")] if words == ["export"] else []
    assert "f.toml:3: network.latency.kind: 'evil:late' names code" in refused(*words, file, *to)
    assert not mark.exists()


@pytest.mark.slow
def test_code_named_in_an_override_needs_the_option_too(mark, written):
    file = written("")
    said = refused("run", file, "--set", "network.latency.kind=evil:late")
    assert said.startswith("--set network.latency.kind=evil:late: network.latency.kind: 'evil:late' names code")
    assert not mark.exists()
    accepted("run", file, "--set", "network.latency.kind=evil:late", "--allow-import")
    assert mark.exists()


def test_every_command_with_keys_has_the_option():
    def every(group):
        for each in group.commands.values():
            yield from every(each) if isinstance(each, click.Group) else [each]

    found = [{option for param in each.params for option in param.opts} for each in every(main)]
    assert len([each for each in found if "--set" in each]) == 15
    assert not [each for each in found if "--set" in each and "--allow-import" not in each]


@pytest.mark.slow
@pytest.mark.parametrize("grid", ['network.latency.kind = ["evil:late"]', f"network.latency = [{CODE}]"])
def test_a_loaded_grid_does_not_bypass_the_check(mark, written, grid):
    file = written(f"[sweep.grid]\n{grid}")
    with pytest.raises(ScenarioError, match="names code"):
        desim.load(file)
    with pytest.raises(ScenarioError, match="names code"):
        sweep(read_source(file), reps=1)
    assert not mark.exists()
    assert sweep(read_source(file, allow_import=True), reps=1).groups[0].rows[0].ok
    assert sweep(desim.load(file, allow_import=True), reps=1).groups[0].rows[0].ok


def test_from_python_code_is_code(mark):
    """A user who writes Python runs code already."""
    sys.path.append(str(mark.parent))
    scenario = Scenario(network=Links(latency={"kind": "evil:late"}))
    assert scenario.network.latency(None, None) == 0.25


@pytest.mark.whole
@pytest.mark.usefixtures("_no_pictures", "_undrawn")
def test_with_the_option_a_file_names_code_everywhere(mark, written, tmp_path):
    file = written(f'network.latency = {CODE}\n[sweep.grid]\n"network.latency" = [{CODE}, {{ kind = "constant" }}]')
    accepted("check", "--allow-import", file)
    accepted("run", "--allow-import", file, "-n", 2, "-o", tmp_path / "runs")
    one = tmp_path / "runs" / "seed-0"
    for words in (["run", "--from", one / "run.json"], ["replay", one], ["plot", "--kind", "perfetto", one]):
        assert f"{one / 'run.json'}: network.latency.kind: 'evil:late' names code" in refused(*words)
        accepted(*words, "--allow-import")
    for _ in range(2):  # the second goes on with the first
        accepted("sweep", "--allow-import", file, "-n", 1, "-o", tmp_path / "swept")
    accepted("explain", "--allow-import", file, "-n", 2, "-o", tmp_path / "explained")
    accepted("report", tmp_path / "swept")


@pytest.mark.parametrize(("key", "table"), [*((key, CAUGHT) for key in PLACES), ("network.latency", POPEN)])
def test_with_the_option_only_models_are_called(mark, written, key, table):
    """A class whose instances cannot be called is refused before one is made; a module is run, as was asked."""
    file = written(PLACES[key].format(table.replace("MARK", str(mark))))
    sys.modules.pop("evil", None)
    sys.path.append(str(mark.parent))
    __import__("evil")
    mark.unlink()
    said = refused("check", file, "--allow-import")
    assert "is not a model: its instances should" in said or "'evil:Caught' should be derived from " in said
    assert not mark.exists()


def test_with_the_option_a_class_with_another_call_signature_is_not_instantiated(mark, written):
    (mark.parent / "evil.py").write_text(
        EVIL.format(mark=str(mark)) + "\n    ...\n\nclass Other(Caught):\n    def __call__(self, one, two): ...\n"
    )
    file = written('protocol = { kind = "evil:Other" }')
    sys.path.append(str(mark.parent))
    __import__("evil")
    mark.unlink()
    assert "should accept a call with (me)" in refused("check", file, "--allow-import")
    assert not mark.exists()


def test_models_installed_as_entry_points_may_be_named(mark, written, tmp_path, monkeypatch):
    """A distribution says so in a group `desim.*`; its other names need the option."""
    about = tmp_path / "site" / "evil-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[desim.models]\nlate = evil:late\ntwice = evil:Twice\n[others]\ncaught = evil:Caught\n"
    )
    (tmp_path / "evil.py").rename(tmp_path / "site" / "evil.py")
    monkeypatch.syspath_prepend(tmp_path / "site")
    named_code._named_by_entry_points.cache_clear()
    try:
        assert "names code" in refused("check", written('network.latency = { kind = "evil:Caught" }'))
        assert not mark.exists()
        accepted("check", written(f"network.latency = {CODE}"))
        mark.unlink()
        for inner, why in ((CAUGHT, "names code"), ('{ kind = "empirical", file = "../d.txt" }', "leads out")):
            assert why in refused("check", written(f'network.latency = {{ kind = "evil:Twice", of = {inner} }}'))
        assert not mark.exists()
    finally:
        named_code._named_by_entry_points.cache_clear()


def test_files_for_user_models_may_lie_beside_the_scenario_file(mark, written, tmp_path):
    (tmp_path / "d.txt").write_text("0.125")
    inner = '{ kind = "empirical", file = "d.txt" }'
    file = written(f'network.latency = {{ kind = "evil:Twice", of = {inner} }}')
    assert desim.load(file, allow_import=True).network.latency.of.values == (0.125,)
    assert mark.exists()


# Code that a folder, a store or a graph names.


@pytest.fixture
def ran(written, tmp_path, _no_pictures):
    """Return the folder of a run with a crash."""
    words = ["--set", "record.messages=true", "-o", tmp_path / "ran"]
    accepted("run", written('fault = [{ kind = "crash", node = 0, start = 0.02, end = 0.05 }]'), *words)
    return tmp_path / "ran"


def changed(path: Path, change) -> None:
    made = json.loads(path.read_text())
    change(made)
    path.write_text(json.dumps(made))


@pytest.mark.slow
def test_a_run_json_names_no_code(mark, ran):
    (ran / "evil.py").write_text((ran.parent / "evil.py").read_text())
    changed(ran / "run.json", lambda made: made["scenario"]["network"].update(latency={"kind": "evil:late"}))
    for words in (["run", "--from", ran / "run.json"], ["replay", ran], ["plot", "--kind", "spacetime", ran]):
        assert f"{ran / 'run.json'}: network.latency.kind: 'evil:late' names code" in refused(*words)
    with pytest.raises(ScenarioError, match="names code"):
        run_folder.read(ran)
    assert not mark.exists()


@pytest.mark.slow
def test_a_trace_names_no_code(mark, ran, monkeypatch):
    monkeypatch.syspath_prepend(mark.parent)
    text = (ran / "trace.jsonl").read_text()
    lines = [json.loads(line) for line in text.splitlines()]
    for line in lines:
        if line["event"] == "FaultStarted":
            line["fault"] = {"kind": "evil:late"}
    (ran / "trace.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    for words in ("replay", ran), ("replay", "--allow-import", ran):
        assert "line 7 is not an event: fault: there is no 'evil:late'; allowed: crash, partition" in refused(*words)
    with pytest.raises(ValueError, match="there is no 'evil:late'"):
        list(run_folder.events(ran))
    assert not mark.exists()


def test_a_graph_names_no_code(mark, written, tmp_path):
    graph = {"nodes": [{"id": 0}, {"id": 1}], "edges": [{"source": 0, "target": 1, "latency": {"kind": "evil:late"}}]}
    (tmp_path / "g.json").write_text(json.dumps(graph | {"directed": False, "multigraph": False, "graph": {}}))
    file = written('network.graph = { kind = "edges", file = "g.json" }')
    said = refused("check", file)
    assert said.startswith(f"{file}:3: network.graph.edges.0.latency.kind: 'evil:late' names code")
    assert not mark.exists()
    accepted("check", file, "--allow-import")


@pytest.mark.whole
def test_workers_import_nothing_from_the_folder_in_which_a_command_is_given(tmp_path):
    """Python looks there first for `-c` and `-m`, by which workers and their trackers are started."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "command.py").write_text("from desim.cli import main\n\nmain()\n")
    home = tmp_path / "home"
    home.mkdir()
    (home / "f.toml").write_text(SHORT)
    for name in ("cloudpickle", "json", "loky", "multiprocessing", "pickle"):
        (home / f"{name}.py").write_text(f"open({str(tmp_path / 'mark')!r}, 'w')\nraise SystemExit\n")
    done = subprocess.run(
        [sys.executable, tmp_path / "bin" / "command.py", "run", "f.toml", "-n", "2", "-j", "2"],
        cwd=home,
        env={key: each for key, each in os.environ.items() if key != "PYTHONSAFEPATH"} | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "wall time" in done.stdout
    assert not (tmp_path / "mark").exists()


CALLS = {
    *(
        "eval",
        "exec",
        "compile",
        "__import__",
        "import_module",
        "run_path",
        "run_module",
        "system",
        "popen",
        "find_class",
    ),
    *("load", "loads", "Unpickler", "load_module", "exec_module", "open_code", "read_gpickle", "read_pickle", "shelve"),
    *("literal_eval", "frombuffer", "fromfile", "memmap", "unsafe_load", "full_load", "enable_load_extension"),
}
"""Names of what may make code of data."""
ENTRY_POINTS = {"desim/config/choice.py", "desim/config/named_code.py"}
"""The modules that load what an installed distribution lists."""
HARMLESS = {"json.loads", "tomllib.loads", "re.compile", "platform.system"}
ALLOWED = {
    "desim/__init__.py": {"import_module"},  # of its own modules
    "protocols/__init__.py": {"import_module"},  # of its own modules
    "desim/config/exports.py": {"import_module"},  # of the modules that a package itself names
    "desim/config/fresh.py": {"reader.load"},  # what it has just pickled
    "desim/config/named_code.py": {"import_module"},  # what a trusted file names
    "desim/learning/make.py": {"load"},  # of a scenario file
    "desim/live/frames.py": {"np.frombuffer"},  # numbers alone
    "desim/live/nursery.py": {"pickle.loads"},  # what the process that has started it sent over a pipe
    "desim/testing/judging.py": {"cloudpickle.loads"},  # what it has just pickled
    "desim/view/pages/replay_columns.py": {"np.frombuffer"},  # numbers alone
    "desim/study/plan/user_code.py": {"marshal", "marshal.loads"},  # the code that Python has stored, to compare it
    "desim/study/workers/serialization.py": {"pickle.loads", "marshal"},  # what the driver sent to its workers
    "desim/study/plan/assigned_values.py": {"ast.literal_eval"},  # of literals in the source of an imported module
    "desim/study/comparing/suite.py": {"load"},  # of a scenario file
    "desim/study/workers/batch_system.py": {"pickle.loads"},  # what its own jobs returned
    "desim/study/workers/workers.py": {"pickle.loads"},  # what they sent back
    "desim/study/workers/dispatch.py": {"pickle.loads"},  # what it has just pickled
}


def _calls(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name.split(".")[-1] in CALLS and name not in HARMLESS:
                yield name
        if isinstance(node, ast.keyword) and node.arg in {"allow_pickle", "shell"}:
            yield node.arg
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {node.module} if isinstance(node, ast.ImportFrom) else {each.name for each in node.names}
            yield from names & {"shelve", "marshal", "dill", "joblib", "yaml", "dbm"}


def _known(name: str, file: str) -> bool:
    return name in ALLOWED.get(file, set()) or (file in ENTRY_POINTS and name.endswith(".load"))


@pytest.mark.slow
@pytest.mark.parametrize("package", ["desim", "protocols"])
def test_nothing_makes_code_of_what_is_on_a_disk(package):
    """No pickle is read from a file, and nothing evaluated: what may do so is named above, with what it reads."""
    found = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        file = path.relative_to(ROOT).as_posix()
        if names := {name for name in _calls(ast.parse(path.read_text())) if not _known(name, file)}:
            found[file] = names
    assert found == {}


def test_the_search_would_find_some():
    program = "import shelve\npickle.load(f)\nnp.load(f, allow_pickle=True)\neval('1')\nrun(shell=True)\njson.loads(x)"
    assert {*_calls(ast.parse(program))} == {"shelve", "pickle.load", "np.load", "allow_pickle", "eval", "shell"}


# Files that a scenario names.

GRAPHML = """<?xml version="1.0"?>{}
<graphml xmlns="http://graphml.graphdrawing.org/xmlns">
<graph edgedefault="undirected"><node id="0"/><node id="{}"/><edge source="0" target="1"/></graph></graphml>"""
LAUGHS = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 12))
DOCTYPES = {
    "laughs": f'<!DOCTYPE x [<!ENTITY l0 "ha">{LAUGHS}]>',
    "external": '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>',
    "elsewhere": '<!DOCTYPE x SYSTEM "http://192.0.2.1/x.dtd">',
    "defaults": f'<!DOCTYPE x [<!ATTLIST node more CDATA "{"x" * 1000}">]>',
}


@pytest.mark.parametrize("name", DOCTYPES)
def test_a_graph_declares_no_document_type(written, tmp_path, name):
    graph = tmp_path / "g.graphml"
    entity = {"laughs": "&l11;", "external": "&e;"}.get(name, "1")
    graph.write_text(GRAPHML.format(DOCTYPES[name], entity))
    said = refused("check", written('network.graph = { kind = "edges", file = "g.graphml" }'))
    assert "f.toml:3: network.graph: " in said
    assert f"{graph} is not a graph" in said
    assert "it should declare no document type" in said
    assert len(said) < 1000
    graph.write_text(GRAPHML.format("", "1"))
    accepted("check", written('network.graph = { kind = "edges", file = "g.graphml" }'))


@pytest.mark.slow
def test_a_graph_with_too_many_nodes_is_reported_in_one_line(written, tmp_path):
    nodes = [{"id": f"{k}{'x' * 100}"} for k in range(10_000)]
    (tmp_path / "g.json").write_text(json.dumps({"nodes": nodes, "edges": []}))
    said = refused("check", written('network.graph = { kind = "edges", file = "g.json" }'))
    assert "the graph has 10,000 nodes, the network 2" in said
    assert len(said) < 1000


NESTED = {
    "graph": ("g.json", "[" * 100_000, 'network.graph = { kind = "edges", file = "g.json" }', "is not a graph"),
    "scenario": ("g.txt", "", "x = " + "[" * 100_000 + "]" * 100_000, "not TOML"),
    "number": ("g.txt", "", "x = " + "1" * 5_000, "not TOML"),
}


@pytest.mark.parametrize("name", NESTED)
def test_input_that_is_too_deep_or_too_long_is_refused(written, tmp_path, name):
    file, content, text, why = NESTED[name]
    (tmp_path / file).write_text(content)
    said = refused("check", written(text))
    assert "f.toml:" in said
    assert why in said


def test_a_trace_that_is_too_deep_is_refused(ran):
    with (ran / "trace.jsonl").open("a") as lines:
        lines.write("[" * 100_000 + "\n")
    assert f"{ran / 'trace.jsonl'}: line " in refused("replay", ran)


@pytest.mark.parametrize("path", ["../delays.txt", "ABSOLUTE", "in/../../delays.txt", "link.txt", "loop"])
def test_a_file_lies_in_the_folder_of_the_scenario_that_names_it(tmp_path, path):
    home = tmp_path / "home"
    (home / "in").mkdir(parents=True)
    (tmp_path / "delays.txt").write_text("0.125")
    (home / "link.txt").symlink_to(tmp_path / "delays.txt")
    (home / "loop").symlink_to(home / "loop")
    named = path.replace("ABSOLUTE", str(tmp_path / "delays.txt"))
    file = home / "f.toml"
    file.write_text(f'{SHORT}network.latency = {{ kind = "empirical", file = "{named}" }}')
    said = refused("check", file)
    if path == "loop":  # found when the path is resolved or, from Python 3.13 on, when it is opened
        assert said.startswith((f"{file}:3: network.latency: {named} ", f"{file}:3: network.latency: {home / named} "))
        return
    assert said.startswith(f"{file}:3: network.latency: {named} ")
    assert "leads out of the folder" in said
    assert "--allow-import" in said
    assert desim.load(file, allow_import=True).network.latency.values == (0.125,)


def test_a_file_may_lie_deeper_or_beside_and_anywhere_from_python(tmp_path, monkeypatch):
    (tmp_path / "home" / "in").mkdir(parents=True)
    for place in ("home/in/d.txt", "home/d.txt", "d.txt"):
        (tmp_path / place).write_text("0.125")
    file = tmp_path / "home" / "f.toml"
    for named in ("in/d.txt", "d.txt", "in/../d.txt", str(tmp_path / "home" / "d.txt")):
        file.write_text(f'{SHORT}network.latency = {{ kind = "empirical", file = "{named}" }}')
        accepted("check", file)
    monkeypatch.chdir(tmp_path / "home")
    accepted("check", "f.toml")
    assert Empirical(file="../d.txt").values == Empirical(file=str(tmp_path / "d.txt")).values == (0.125,)


def test_a_graph_lies_there_too(tmp_path):
    (tmp_path / "g.graphml").write_text(GRAPHML.format("", "1"))
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "f.toml").write_text(
        'network.graph = { kind = "edges", file = "../g.graphml" }\nteam.count = 2'
    )
    assert "leads out of the folder" in refused("check", tmp_path / "home" / "f.toml")


def test_a_run_json_does_not_choose_the_folder_of_its_files(ran, tmp_path):
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "d.txt").write_text("0.125")

    def point(made):
        made["folder"] = str(tmp_path / "secret")
        made["scenario"]["network"]["latency"] = {"kind": "empirical", "file": "d.txt"}

    changed(ran / "run.json", point)
    assert "d.txt cannot be read" in refused("run", "--from", ran / "run.json")


# Names that strangers give.

GRID = '[sweep.grid]\n"network.latency.value" = [0.0, 0.1]\n'
WORST = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp.exe\r\x00$\\frac{$ </script><svg onload=x> ' \" _a"
TOML = json.dumps(WORST)


def harmless(text: str) -> bool:
    return all(each.isprintable() or each == "\n" for each in text)


def test_unprintable_characters_are_escaped_as_in_toml_and_json():
    assert escaped("a\tb\n\u00e9 \u6f22 \U0001f600") == "a\tb\n\u00e9 \u6f22 \U0001f600"
    assert escaped("\x1b[2J\x9b\u202e\r\x00") == "\\u001b[2J\\u009b\\u202e\\u000d\\u0000"
    assert escaped("\U000e0001") == "\\U000e0001"
    assert json.loads(f'"{escaped(WORST[:20])}"') == WORST[:20]
    assert harmless(escaped(WORST).replace("\t", ""))


@pytest.mark.slow
@pytest.mark.usefixtures("_no_pictures", "_undrawn")
def test_a_terminal_receives_only_plain_text(written, tmp_path):
    file = written(f"name = {TOML}\n{GRID}")
    for words in (
        ["check"],
        ["run"],
        ["run", "-n", 2],
        ["sweep", "-n", 1],
        ["explain", "-n", 2],
        ["sweep", "--dry-run"],
    ):
        out = [] if words[0] in {"check", "run"} or "--dry-run" in words else ["-o", tmp_path / words[0]]
        done = call(*words, file, *out)
        assert done.exit_code == 0, done.output
        assert harmless(done.stdout), words
        assert harmless(done.stderr), words
    again = tmp_path / "again.toml"
    again.write_text(accepted("check", file).stdout, encoding="utf-8")
    assert desim.load(again).name == WORST


BAD = {
    "key": f"{TOML} = 1",
    "table": f"[team.{TOML}]\nx = 1",
    "value": f"prune = {TOML}",
    "kind": f"network.latency = {{ kind = {TOML} }}",
    "code": f"network.latency = {{ kind = {json.dumps('a:' + WORST)} }}",
    "file": f'network.latency = {{ kind = "empirical", file = {json.dumps(WORST.replace(chr(0), ""))} }}',
    "grid": f"[sweep.grid]\n{TOML} = [1, 2]",
}


@pytest.mark.parametrize("name", BAD)
def test_an_error_sends_a_terminal_only_plain_text(written, name):
    said = refused("sweep", written(BAD[name]))
    assert "owned" in said
    assert harmless(said)


def test_a_record_sends_a_terminal_only_plain_text(ran):
    changed(ran / "run.json", lambda made: made["versions"].update({WORST: WORST}))
    done = call("run", "--from", ran / "run.json")
    assert "owned" in done.stderr
    assert harmless(done.stderr)


@pytest.mark.slow
def test_no_command_prints_without_escaping():
    """All output goes through the function that escapes it."""
    for path in (ROOT / "desim" / "cli").glob("*.py"):
        names = [ast.unparse(node.func) for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        allowed = 1 if path.name == "output.py" else 0
        assert names.count("click.echo") == allowed, path
        assert not {"print", "sys.stdout.write", "sys.stderr.write", "click.secho"} & set(names), path


@pytest.mark.whole
def test_pictures_and_pages_show_the_worst_name_as_it_is(written, tmp_path):
    """No mathematics, no markup, and SVG that is XML."""
    file = written(f"name = {TOML}\n{GRID}")
    result = run(desim.load(file))
    for path in save(trajectory(result), tmp_path / "trajectory"):
        assert path.stat().st_size
    lines = ElementTree.parse(tmp_path / "trajectory.svg").getroot().itertext()
    text = " ".join(line.strip() for line in lines if line.strip())  # a long title has several lines
    assert "$\\frac{$ </script><svg onload=x>" in text
    accepted("sweep", file, "-n", 2, "-o", tmp_path / "out")
    ElementTree.parse(tmp_path / "out" / "means-active_time.svg")
    accepted("report", tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<svg onload" not in page
    assert "</script><svg" not in page
    accepted("replay", file, "-o", tmp_path / "replay.html")
    page = (tmp_path / "replay.html").read_text()
    assert "<svg onload" not in page
    assert "</script><svg" not in page


@pytest.mark.whole
def test_the_name_of_a_part_is_drawn_as_it_is(tmp_path):
    found = explain(Scenario(horizon=0.1, network=Links(latency={"kind": "constant", "value": 0.1})), 2)
    document = found.document()
    for cost in document["costs"].values():
        cost["parts"] = {"$\\frac{$\x1b_": next(iter(cost["parts"].values()))}
    for path in save(type(found).of(document | {"name": WORST[:30]}).plot(), tmp_path / "explain"):
        assert path.stat().st_size
    ElementTree.parse(tmp_path / "explain.svg")


def test_no_function_imports_code_of_a_file_unless_it_is_asked_to():
    ((default, functions),) = defaults()["allow_import"].items()
    assert default == "False"
    assert len(functions) > 5

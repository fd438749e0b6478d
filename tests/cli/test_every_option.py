"""Every command with a value for every option: what it calls, prints and writes.

The golden files in `tests/golden/commands` have the calls of a command to the packages below it, with their arguments:
where the value of an option does not arrive, another call is there. What takes long, or needs more than this process,
is replaced, and its calls are there, too.
"""

import ast
import inspect
import re
import shlex
import sys
import textwrap
from collections.abc import Mapping
from functools import cache, partial, wraps
from importlib import import_module
from itertools import count, groupby
from pathlib import Path
from types import FunctionType, ModuleType

import click
import numpy as np
import pytest
from pydantic import BaseModel

import desim as package
from desim import Scenario, run, sweep
from desim.cli import main
from desim.live.agreement import Agreement
from desim.live.result import Conduct, LiveResult
from desim.study.comparing.bench import bench
from desim.study.workers.workers import InProcess
from scenarios.studies.study import SCENARIOS
from tests.command import desim
from tests.golden import golden

CLI = Path(package.__file__).parent / "cli"
UNSEEN = ("desim.config.trust", "desim.config.extras", "desim.config.json_numbers", "desim.config.choice")
"""Modules whose calls are left out: they make texts or write files."""
IGNORED = ("counted", "fields_of", "models_in", "note_command", "plain", "warnings", "where", "with_unit")
"""Functions whose calls say little: what they return is printed or passed on."""
LINES, WIDTH = 50, 240
"""Of a longer output the first lines are shown, and of a longer line its beginning."""

GAME = """\
name = "game"
seed = 4
horizon = 0.02
team.count = 2
record.trajectory = 0
properties = ["lazy: crowded at most 0.01 in total"]
sweep.grid = { "capture.radius" = [0.1, 0.2] }

[protocol]
kind = "cbaa"
schedule = { kind = "rounds", period = 0.01 }

[announce]
trigger = "both"
heartbeat = 0.01
belief_timeout = 1.0

[network]
latency = { kind = "trace", table = "t,value\\n0,0.001\\n0.01,0.002" }
loss = 0.1
"""
PLAIN = """\
name = "plain"
seed = 4
horizon = 0.02
team.count = 2
announce.heartbeat = 0.005
record.trajectory = 0
properties = ["crowded at most 0 in total"]
"""
SCORES = """\
def size(result):
    return result.scenario.team.count + (7 * result.seed % 5) / 10


def only_one(me):
    me.assign(me.id == 0)
    yield me.timeout(1.0)


def stumble(me):
    yield me.sleep(0.01)
    raise ValueError("no way")


def rely(me):
    if me.id == 0:
        yield me.sleep(0.002)
        me.send(1, 1)
        yield me.sleep(1.0)
    yield me.arrival()
    me.assign(1)


def write_length(result, path):
    path.write_text(str(len(result.trace)))
"""
LOG = "t,src,dst,size\n0.0,0,1,100\n0.01,1,,50\n"
COMMON = "-s 9 --timeout 50 --allow-import --set network.loss.p=0.2"
MANY = f"-j 3 --mix-versions {COMMON}"
RELY = (
    "plain.toml --set protocol=scores:rely --set team.active_at_start=0.0 --set announce.trigger=never --allow-import"
    " --property 'idle at most 0.01 in total'"
)
CASES = {
    "bench": (
        "--protocol scores.py:only_one --protocol sap -n 3 --version 1 --again -j 3 --timeout 50 --mix-versions -o b1"
        " --json --allow-import",
        "--protocol sap --cluster tcp://h:1 -o b2",
        "-n 3",
        "--version 7",
    ),
    "break": (
        "plain.toml --property 'idle at most 0.001 in total' --protocol local_min -n 1 --feature latency --guided"
        f" --budget 40 --keep kept -o k1 -g team.count=2,3 -j 3 {COMMON} --json",
        "plain.toml -n 2 --feature latency --keep kept -o k2",
        "plain.toml -n 1 --feature latency --keep kept -o k3 --json",
        "plain.toml --losses 1 --fate late --fate lost --delay 0.2 --seeds 2 -o k4 -s 9 -j 3 --timeout 50",
        f"{RELY} --losses 1 -o k6",
        f"{RELY} --losses 1 --fate late --delay 0.01 --json -o k6",
        "plain.toml --protocol scores:stumble --allow-import -n 1 --feature latency -o k7",
        "plain.toml --set properties=[]",
        "plain.toml --losses 1 --runs 3",
        "plain.toml --fate lost",
    ),
    "check": (
        "game.toml",
        "plain.toml --set team.count=3",
        "game.toml --plot -o links.svg --timeout 50 --allow-import --set network.loss.p=0.2",
        "game.toml --plot",
        "game.toml -o links.svg",
        "game.toml --set 'sweep.grid={ \"team.count\" = [0] }'",
    ),
    "compare": (
        "swept other -y active_time -y messages_sent --format latex",
        "swept other --format markdown",
        "swept other --json",
        "swept nowhere",
    ),
    "crossover": (
        "swept team.count protocol=sap protocol=cbaa --where capture.radius=0.1 -y messages_sent",
        "swept team.count --over 10% --baseline 3 --where capture.radius=0.1 --where protocol=sap --json",
        "swept team.count --over -10% --where capture.radius=0.1 --where protocol=sap",
        "swept team.count --over 10% protocol=sap protocol=cbaa",
        "desim run plain.toml -o one",
        "one team.count --over 10%",
        "swept team.count --over 10",
        "swept team.count protocol=sap",
        "swept team.count protocol=sap protocol=cbaa --baseline 3",
    ),
    "examples": ("", "relay copied.toml", "relay copied.toml", "nope"),
    "explain": (
        f"plain.toml -n 2 {MANY} -o e1 --metric scores:size",
        f"plain.toml -n 2 --cluster tcp://h:1 -o e1 --json {COMMON}",
    ),
    "export": (
        f"game.toml events.csv --event Decided --event Ended {COMMON}",
        "game.toml length.txt --exporter scores:write_length --allow-import",
        "game.toml run.perfetto.json",
        "game.toml run.pcapng",
        "game.toml run.nope",
        "swept tables.md --metric messages_sent --label 'sap=SAP (ours)' --without captured",
        "swept runs.csv",
        "swept runs.csv --event Decided",
        "swept runs.csv --exporter pcapng",
        "swept runs.csv --metric active_time",
        "swept runs.csv --without captured",
        "swept runs.csv --seed 3",
        "desim run plain.toml -o one",
        "one events.csv",
        "desim sweep plain.toml -g team.count=2,3 -n 1 --shard 1/2 -o parts",
        "desim sweep plain.toml -g team.count=2,3 -n 1 --shard 2/2 -o parts",
        "parts runs.csv",
    ),
    "fates": (
        f"log.csv plain.toml {COMMON} -o fates.csv",
        "log.csv plain.toml",
        'log.csv plain.toml --set \'network.graph={ kind = "edges", edges = ["a,b", "b,a"] }\'',
        "far.csv plain.toml",
        "log.csv plain.toml --set 'fault=[{ kind = \"silent\", start = 0.0, node = 0 }]'",
        "plain.toml log.csv",
    ),
    "keys": ("network.latency.gamma", "base", "plain.toml", "protocol.tau"),
    "live": (
        "plain.toml -s 9 -n 2 -o l1 --metric messages_sent --json --allow-import --set network.loss.p=0.2",
        "plain.toml --hosts hosts.txt -o l2 --metric messages_sent",
        "plain.toml -n 2 --netem",
        "plain.toml -s 5",
        "plain.toml --namespaces",
        "plain.toml --compare -n 2 --netem -o l3",
        "plain.toml --compare -n 2 --json -o l3",
        "plain.toml --compare",
        "plain.toml --compare -n 2 --hosts hosts.txt",
        "plain.toml --netem --hosts hosts.txt",
        "plain.toml --namespaces --hosts hosts.txt",
        "plain.toml --hosts hosts.txt --set team.count=3",
        "plain.toml --join 10.0.0.1:99/1/5/10.0.0.2/token",
        "plain.toml --join nonsense",
    ),
    "ls": ("swept", ". --json", "nowhere", "plain.toml"),
    "merge": ("swept other -o merged --mix-versions", "swept -o merged", ". -o merged"),
    "metrics": ("active_time", "", "nope"),
    "netem": (
        "plain.toml --dev wlan0 --table made --allow-import --set network.loss.p=0.2 --set network.latency=0.002",
        "plain.toml --set 'network.latency={ kind = \"gamma\", scale = 0.0005 }' --table made",
        "plain.toml --set 'network.latency={ kind = \"gamma\", scale = 0.0005 }'",
        "--parse 'tc qdisc add dev eth0 root netem delay 10ms loss 1% rate 1mbit limit 7'",
        "--parse 'tc nonsense'",
        "--from links.sh --table tables",
        "--from nowhere.sh",
        "plain.toml --from links.sh",
        "",
    ),
    "new": ("protocol mine", "scenario first", "scenario first", "metric not-a-name"),
    "play": ("game.toml --no-browser --timeout 50 --allow-import --set network.loss.p=0.2", ""),
    "plot": (
        f"game.toml --kind spacetime -o space.svg --size 8cm --from 0.01 --to 0.015 --pursuers 1,0 {COMMON}",
        "game.toml --kind film -o film.gif --speed 0.5 --fps 10 --size 200x100px",
        "game.toml --kind perfetto",
        "game.toml",
        "swept --kind means -y messages_sent -x team.count --by protocol --against protocol=sap"
        " --label 'sap=SAP (ours)' --xlabel size --ylabel sent",
        "swept",
        "swept --kind phase -o phase.pdf",
        "swept --kind phase --speed 2",
        "swept --kind film",
        "game.toml --kind means",
        "game.toml --pursuers 1,x",
        "swept -o picture.txt",
    ),
    "protocols": ("sap", "scores:only_one --allow-import", "scores:only_one", "spa"),
    "race": (
        "plain.toml -g team.count=2:4 --design random:2 -y active_time --zone 0.5 --confidence 0.9 --maximise"
        f" --first 3 -n 7 {MANY} -o r1",
        "plain.toml -g team.count=2,4 -y scores:size --zone 0.5 --minimise --first 3 -n 7 --cluster tcp://h:1 -o r2"
        " --json --allow-import",
        "plain.toml -g team.count=2,4 -y captured --zone 0.5",
    ),
    "replay": (
        "game.toml",
        f"game.toml plain.toml -o pair.html {COMMON}",
        "game.toml -o game.toml",
        "game.toml -o page.txt",
        "game.toml plain.toml swept",
        "swept",
    ),
    "report": (
        "swept -o page.html --against protocol=sap --timeout 50",
        "swept --against protocol=nope",
        "desim run plain.toml -o one",
        "one",
        ".",
        "desim sweep plain.toml -g team.count=2,3 -n 1 --shard 1/2 -o parts",
        "parts",
        "plain.toml",
    ),
    "run": (
        f"game.toml -n 2 -j 3 -o run --metric scores:size --json {COMMON}",
        "plain.toml -n 2 -j 3 -s 9 --metric messages_sent",
        "game.toml -o one --metric messages_sent",
        "--from one/run.json -n 1 --timeout 50 -o once",
        "--from run/run.json --allow-import",
        "plain.toml -o once",
        "game.toml --from one/run.json",
        "--from nowhere.json",
        "",
    ),
    "schema": (),
    "sensitivity": (
        f"plain.toml -g team.count=2:4 -g network.loss.p=0:0.5 -y scores:size --points 8 --trajectories 2 -n 1 {MANY}"
        " -o d1",
        "plain.toml -g team.count=2:4 -g network.loss.p=0:0.5 --points 0 --trajectories 2 -n 2 --cluster tcp://h:1"
        " -o d2 --json",
        "plain.toml -g team.count=2:4 --points 2",
    ),
    "status": ("swept", "swept --json", "nowhere", "desim run plain.toml -o one", "one"),
    "submit": (
        "game.toml --array 2 -g team.count=2,3 -n 3 -s 9 -o job --run --time 01:30:00 --cpus 3 --memory 2G"
        " --sbatch=--partition=short --metric scores:size --mix-versions --timeout 50 --allow-import"
        " --set network.loss.p=0.2",
        "game.toml --array 2 --claim -n 3 -o job2",
        "game.toml --array 3 --claim -n 3 -o job2",
        "game.toml --array 3 -n 3 -o job2",
        "game.toml --array 9 -n 3 -o job3",
        "plain.toml --array 2 -g team.count=2,3 -n 1 -o job4",
        "desim sweep plain.toml -g team.count=2,3 -n 1 --shard 2/2 -o job4/part-2",
        "plain.toml --array 2 -g team.count=2,3 -n 1 -o job4",
        "desim sweep plain.toml -g team.count=2,3 -n 1 --shard 1/2 -o job4/part-1",
        "plain.toml --array 2 -g team.count=2,3 -n 1 -o job4",
        "plain.toml --array 2 -g team.count=2,3 -n 1 -s 7 -o job4",
        "game.toml --array 2 --memory much",
    ),
    "sweep": (
        f"game.toml -g team.count=2,3 -n 1 {MANY} -o s1 --shard 1/2 --fail-fast --against capture.radius=0.1"
        " --metric scores:size",
        f"game.toml -g team.count=2,3 -n 1 {MANY} -o s1 --shard 2/2 --json",
        "plain.toml -g team.count=2:5 --design random:2 -n 2 -o s2",
        "plain.toml -g team.count=2,3 -n 2 --claim lots -o s3",
        "plain.toml -g team.count=2,3 -n 2 --until active_time:0.5 -o s4 --cluster tcp://h:1",
        "plain.toml -g team.count=2,3 -n 2 --until active_time:0.5 -o s4 --dry-run",
        "plain.toml -g team.count=2,3 -n 3 --shard 2/3 -o s4 --dry-run",
        "plain.toml -g team.count=2,3 -n 2 --until active_time:0.5 --shard 1/2",
        "plain.toml -g team.count=2,3 -n 2 --until active_time",
        "plain.toml -g team.count=2,3 -n 2 --claim lots --shard 1/2",
        "plain.toml -g team.count=2,3 -n 2 --claim lots --until active_time:0.5",
        "plain.toml -g team.count=2,3 -n 4 --control local_min --control-runs 9 -o s5 --metric active_time",
        "plain.toml -g team.count=2,3 -n 4 --control local_min --control-runs 9 -o s5 --json",
        "plain.toml -g team.count=2,3 -n 2 --control local_min --shard 1/2",
        "plain.toml -g team.count=2,3 -n 2 --control-runs 4",
        "plain.toml -g team.count=2,3 -n 2 --against team.count=7",
        "plain.toml -g team.count=2,3 -n 2 --until scores:size:0.5 --allow-import -o s6 --dry-run",
        "plain.toml -g capture.radius=0.1,0.2 -n 1 --set protocol=scores:stumble --allow-import -o s7",
        "plain.toml -g team.count=2:5 --design nope:2",
        "swept",
        "nowhere.toml",
        "plain.toml -g team.count=2,3 --shard 3/2",
    ),
}
"""The words after the name of each command; together they set every option and argument of it. Some lines are whole."""


def text_of(value: object) -> str:
    """Return a value as text that is the same in every process."""
    if value is None or isinstance(value, (bool, int, float, str, range)):
        return repr(value)
    if isinstance(value, Path):
        return re.sub(r"\.[0-9a-f]{8}\.part$", ".part", str(value))  # a file that will replace another
    if isinstance(value, Scenario):
        shown = (value.name, value.seed, value.team.count, value.protocol_name, getattr(value.network.loss, "p", None))
        return f"Scenario({', '.join(map(str, shown))})"
    if isinstance(value, Mapping):
        shown = ", ".join(f"{key}: {text_of(each)}" for key, each in value.items())
        return f"{{{shown if len(value) <= 3 else ', '.join([*map(str, value)][:3]) + ', ...'}}}"
    if isinstance(value, (list, tuple)) and not hasattr(value, "_fields"):
        return f"[{', '.join(map(text_of, value))}]"
    return f"<{'function' if isinstance(value, partial) else type(value).__name__}>"


def call_of(name: str, arguments: Mapping[str, object]) -> str:
    """Return a call as text; the arguments that a wrapper passes on are shown as those of the function."""
    shown = []
    for key, value in arguments.items():
        if key in ("named", "kwargs") and isinstance(value, Mapping):
            shown += [f"{word}={text_of(each)}" for word, each in value.items()]
        elif key == "args" and isinstance(value, tuple):
            shown += map(text_of, value)
        else:
            shown.append(f"{key}={text_of(value)}")
    return f"{name}({', '.join(shown)})"


class Calls:
    """The calls from modules of commands to the packages below, as lines of text."""

    def __init__(self):
        self.lines = []

    def replaced(self, name, answer):
        """Return a function that notes its calls, wherever they come from, and returns what a function answers."""

        def instead(*args, **named):
            self.lines.append(f"replaced: {call_of(name, {'args': args, 'named': named})}")
            return answer(*args, **named)

        return instead

    def noted(self, call, name):
        """Return a function, or the method of a class, that notes its calls from modules of commands."""
        function = call.__func__ if isinstance(call, (classmethod, staticmethod)) else call
        signature = inspect.signature(function)

        @wraps(function)
        def noting(*args, **named):
            if Path(sys._getframe(1).f_code.co_filename).parent == CLI:
                bound = signature.bind(*args, **named)
                arguments = {key: value for key, value in bound.arguments.items() if key not in ("self", "cls")}
                self.lines.append(call_of(name, arguments))
            return function(*args, **named)

        return type(call)(noting) if isinstance(call, (classmethod, staticmethod)) else noting

    def note(self, patch):
        """Note the calls of all functions, and of the methods of all classes, that modules of commands import."""
        for module, name in imported():
            value = vars(module)[name]
            if not isinstance(value, type):
                patch.setattr(module, name, self.noted(value, name))
                continue
            for method, call in [*vars(value).items()]:
                if isinstance(call, (FunctionType, classmethod)) and (method == "__init__" or method[0] != "_"):
                    patch.setattr(value, method, self.noted(call, f"{name}.{method}"))


@cache
def imported():
    """Return the functions and classes that modules of commands import from packages below, with their modules."""
    found = {}
    for file in sorted(CLI.glob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if (
                isinstance(node, ast.ImportFrom)
                and node.module.startswith("desim.")
                and not node.module.startswith(("desim.cli", *UNSEEN))
            ):
                module = import_module(node.module)
                for name in (alias.name for alias in node.names):
                    value = getattr(module, name)
                    if isinstance(value, ModuleType):
                        found |= {(value, key): member for key, member in vars(value).items()}
                    else:
                        found[module, name] = value
    return [
        (module, name)
        for (module, name), value in found.items()
        if name not in IGNORED
        and name[0] != "_"
        and (
            isinstance(value, FunctionType)
            or (isinstance(value, type) and not issubclass(value, (BaseModel, Exception)))
        )
        and value.__module__ == module.__name__
    ]


LOST = 5
"""The seed of a live run that loses a process."""


def lived(scenario: Scenario, seed: int) -> LiveResult:
    """Return a run as if it were a live one, in which a timer was late."""
    result, conduct = run(scenario, seed), Conduct()
    conduct.note(0, [1_000_000, 30_000_000], [2_000_000])
    conduct.notes.append("pursuer 1 was late")
    conduct.ends = {1: "was lost"} if seed == LOST else {}
    return LiveResult(scenario, seed, result.trace, conduct)


def agreement(scenario: Scenario, runs: int, **_) -> Agreement:
    """Return what a comparison of live runs with simulated ones returns."""
    return Agreement(scenario, [lived(scenario, k) for k in range(runs)], [run(scenario, k) for k in range(runs)])


def saved(_figure: object, path: Path, **_) -> list[Path]:
    """Write an empty picture."""
    paths = [path] if path.suffix else [path.with_suffix(".svg")]
    for each in paths:
        each.write_bytes(b"")
    return paths


@cache
def frozen():
    """Return the frozen table of the benchmark."""
    return bench([], None)


FIGURES = (
    "analysis.drawing.trajectory.trajectory",
    "live.figure.agreement_figure",
    "study.comparing.scores.Benchmark.plot",
    "study.results.result.SweepResult.plot",
    "study.results.waterfalls.waterfall",
    "study.selection.race_result.RaceResult.plot",
    "study.sensitivity.sensitivity_result.SensitivityResult.plot",
    "view.pictures.link_traces.link_traces",
    "view.pictures.run_figure.plot",
    "view.pictures.spacetime.spacetime",
)
PAGES = ("view.pages.replay.replay_page", "view.pages.pair.side_by_side", "view.pages.report.report")


def replace(patch, calls):
    """Replace what takes long, or needs other machines or a browser."""
    answers = {
        "analysis.drawing.plots.save": saved,
        "live.agreement.compare": agreement,
        "live.pursuer.play": lambda *_: 7,
        "live.live_runs.runs": lambda scenario, seeds, **_: [lived(scenario, seed) for seed in seeds],
        "study.comparing.bench.bench": lambda *_, **__: frozen(),
        "study.comparing.bench.frozen_matches": lambda _: False,
        "study.sensitivity.sobol_indices.unit_points": lambda design, keys: np.linspace(
            0.0, 0.9, design.size * keys
        ).reshape(-1, keys),
        "study.sweeps.array_job.states": lambda _: {},
        "study.sweeps.array_job.submit_scripts": lambda _: "77",
        "study.workers.executors.workers_for": lambda *_, **__: InProcess(),
        "view.formats.perfetto.write": lambda _, path: path.write_bytes(b""),
        "view.pages.play_page.play_page": lambda _: b"",
        "view.pages.play_server.PlayServer.serve_until_closed": lambda _: None,
        "view.pages.session.Session.warm_up": lambda _: None,
        "view.pictures.animation.animate": lambda _, path, **__: path.write_bytes(b""),
    }
    answers |= {name: lambda *_, **__: "a figure" for name in FIGURES}
    answers |= {name: lambda *_, **__: "a page" for name in PAGES}
    for name, answer in answers.items():
        patch.setattr(f"desim.{name}", calls.replaced(name.rpartition(".")[2], answer))
    for module in ("breaking.losses", "breaking.search", "workers.batch"):
        patch.setattr(f"desim.study.{module}.workers_for", calls.replaced("workers_for", lambda *_, **__: InProcess()))
    patch.setattr("webbrowser.open", calls.replaced("webbrowser.open", lambda _: True))
    patch.setattr("os.cpu_count", lambda: 2)


def cleaned(text: str, folder: Path, width: int = WIDTH) -> str:
    """Return an output without what depends on the machine and the time, and with six digits of numbers."""
    text = text.replace(str(folder), "DIR").replace(sys.executable, "python").replace(str(SCENARIOS), "SCENARIOS")
    text = re.sub(r"http://127.0.0.1:\d+/\S+", "http://ADDRESS", text)
    text = re.sub(r"file://\S+?(?='|$)", "file://PAGE", text)
    text = re.sub(r"-?\d+\.\d{7,}(e-?\d+)?", lambda match: f"{float(match[0]):.6g}", text)
    text = re.sub(r"[\d,]+ kB", "N kB", text)
    text = re.sub(r"\b[0-9a-f]{16}\b", "HASH", text)
    text = re.sub(r"\b20\d\d-\d\d-\d\d \d\d:\d\d\b", "DATE", text)
    if text.startswith(("{\n", "[\n")):
        return textwrap.shorten(text, 4 * width, placeholder=" ...")
    lines = text.splitlines()
    more = [f"... of {len(lines)} lines"] if len(lines) > LINES else []
    return "\n".join([*(line[:width] for line in lines[:LINES]), *more])


@pytest.fixture(scope="module")
def calls():
    """Return the calls of commands that are noted while a test of this module runs."""
    noted = Calls()
    with pytest.MonkeyPatch.context() as patch:
        noted.note(patch)
        replace(patch, noted)
        yield noted


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Return a folder with two sweeps."""
    folder = tmp_path_factory.mktemp("swept")
    for name, runs in (("swept", 3), ("other", 2)):
        parts = {"team": {"count": 2}, "record": {"trajectory": 0}, "network": {"loss": 0.1}}
        grid = {"team.count": [2, 3], "capture.radius": [0.1, 0.2], "protocol": ["sap", "cbaa"]}
        sweep(Scenario(name=name, seed=4, horizon=0.02, **parts), grid, runs, store=folder / name / "sweep.sqlite")
    return folder


@pytest.fixture
def folder(swept, tmp_path, monkeypatch):
    """Return the working folder, with the sweeps, scenarios, logs and code."""
    files = {
        "far.csv": "t,src,dst,size\n0.0,0,7,100\n",
        "game.toml": GAME,
        "hosts.txt": "localhost # 0\n\nlocalhost\n",
        "links.sh": "tc qdisc add dev eth0 root netem delay 10ms 2ms distribution mine\n",
        "log.csv": LOG,
        "plain.toml": PLAIN,
        "scores.py": SCORES,
        "tables/mine.dist": "\n".join(map(str, range(-40, 41))),
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    for file in swept.glob("*/*"):
        (tmp_path / file.parent.name).mkdir(exist_ok=True)
        (tmp_path / file.parent.name / file.name).write_bytes(file.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def done(words: list[str], folder: Path, calls: Calls) -> str:
    """Call the command, and return what it calls, prints and writes, as text."""
    before = {path for path in folder.rglob("*") if path.is_file()}
    calls.lines.clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["desim", *words])
        patch.setattr("time.perf_counter", count(100.0, 0.5).__next__)
        result = desim(*words)
    new = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file() and path not in before)
    parts = {"stdout": result.stdout, "stderr": result.stderr, "wrote": "\n".join(new)}
    parts["exit"] = str(result.exit_code) if result.exit_code else ""
    lines = [(cleaned(line, folder, 4 * WIDTH), len([*same])) for line, same in groupby(calls.lines)]
    shown = [line if times == 1 else f"{line}  {times} times" for line, times in lines]
    shown += [f"-- {title}\n{cleaned(part, folder)}" for title, part in parts.items() if part]
    return "\n".join(shown)


def test_every_option_and_argument_of_every_command_has_a_value():
    missing = {name: {param.name for param in command.params} for name, command in main.commands.items()}
    for name, lines in CASES.items():
        for line in (line for line in lines if not line.startswith("desim ")):
            parser = main.commands[name].make_parser(click.Context(main.commands[name]))
            typed, _, params = parser.parse_args(shlex.split(line))
            missing[name] -= {
                param.name for param in params if isinstance(typed.get(param.name), (str, bool, list, tuple))
            }
    assert missing == {name: set() for name in CASES}


@pytest.mark.parametrize("name", [name for name in CASES if CASES[name]])
def test_what_a_command_calls_prints_and_writes_is_golden(name, folder, calls):
    shown = {}
    for line in CASES[name]:
        title = line if line.startswith("desim ") else f"desim {name} {line}".rstrip()
        _, *words = shlex.split(title)
        shown[f"{title} (again)" if title in shown else title] = done(words, folder, calls)
    golden(f"commands/{name}.txt", shown)

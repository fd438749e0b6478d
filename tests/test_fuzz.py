"""Fuzzing: whatever a scenario file says, it runs or is refused with file, line and key, and nothing is half written.

The documents follow from the models themselves, so that a new key or kind is fuzzed without a line here. A few cases
are tried here; as many as one likes with the environment variable FUZZ=10000, new ones each time.
"""

import json
import math
import os
import random
import re
import signal
import sqlite3
import subprocess
import sys
import time
import tomllib
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import pytest
import tomli_w
from click.testing import CliRunner
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from desim.analysis.metrics import METRICS, Summary
from desim.cli import main
from desim.config.choice import OneOf, kind_of
from desim.config.escaping import escaped
from desim.kernel.core.events import Trace
from desim.results import run_folder
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.scenario import Scenario
from desim.scenario.toml import validate
from desim.testing.messages import Conservation
from tests.command import JARGON, strict_json
from tests.conftest import undraw
from tests.study import sweeps

SCENARIOS = sorted((Path(__file__).parents[1] / "scenarios").glob("*.toml"))
CASES = int(os.environ.get("FUZZ", "0"))
LIMIT = 1.0
"""Time after which a run is ended, s."""
WAITING = re.compile(
    r"process(?:es wait| waits)\n  (the world: |pursuer \d+: |[\d,]+ processes wait at )\S+\.py:\d+ \(\S+\): "
)
"""The head of what processes wait for, and its first line, of one process or of several at one line of code."""
SLOW = 100.0
"""Longest time that a command may take whose run is ended after the limit, s: it hangs, however slow the machine."""
OK, OUT_OF_TIME, WRONG_INPUT, FAILED = 0, 1, 2, 3

pytestmark = [
    pytest.mark.filterwarnings("ignore:Glyph:UserWarning"),
    # A time-out that is raised in a callback of the garbage collector is reported, dropped and raised again.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.own_trace,
    pytest.mark.timeout(24 * 3600 if CASES else 600),
]


def fuzz(share: float):
    """Return how many cases of a test there are: a share of all."""
    return settings(
        max_examples=max(int((CASES or 100) * share), 1),
        derandomize=not CASES,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )


# Documents that follow the schema.

EDGES = [0, -1, 1, True, False, 0.0, -0.0, 1e-300, 1e-6, 1e9, 1e308, -1e308]
EDGES += [math.inf, -math.inf, math.nan, 2**31, 2**63]
ODD = [*EDGES, 10**30, 10**400, -(10**18), "", "inf", "nan", "Infinity", "auto", "x" * 300]
ODD += [[], {}, [[]], [0, 0], {"kind": "x"}]
TEXTS = [
    "",
    "x",
    "ü\u202e\u0000\x1b[31m",
    "a\nb",
    "../../../etc/passwd",
    "'\"\\",
    "\ud7ff",
    "%s{0}",
    "no:thing",
    ":",
    "\t",
]
ODD += [*TEXTS, {"kind": ""}, {"kind": 3}, {"kind": "no_such:Thing"}, {"": 1}, [{}], [math.nan]]


def rare(draw, percent: float) -> bool:
    """Draw whether something rare happens; it does not in the simplest case."""
    return draw(st.integers(0, 999)) >= 1000 - 10 * percent


class Wild:
    """How often a document departs from what is usual, in percent of its values."""

    def __init__(self, odd: float, edge: float):
        self.odd, self.edge = odd, edge


TAME, EDGY, ODDER = Wild(0.0, 2.0), Wild(0.0, 20.0), Wild(5.0, 20.0)


def bounds_of(metadata) -> dict[str, Any]:
    """Return the bounds that annotations set, by their names in pydantic."""
    found: dict[str, Any] = {}
    for each in metadata:
        inner = each.metadata if isinstance(each, FieldInfo) else [each]
        for one in inner:
            for name in ("ge", "gt", "le", "lt", "min_length", "max_length", "allow_inf_nan"):
                value = getattr(one, name, None)
                if value is not None:
                    found[name] = value
    return found


def number(draw, whole: bool, metadata, wild: Wild):
    """Draw a number within its bounds: usual, or one of the least and greatest."""
    bounds = bounds_of(metadata)
    low, high = bounds.get("ge", bounds.get("gt", -math.inf)), bounds.get("le", bounds.get("lt", math.inf))
    if rare(draw, wild.edge):
        known = [low, high, *EDGES] + (
            [] if whole else [math.nextafter(low, math.inf), math.nextafter(high, -math.inf)]
        )
        fit = [each for each in known if math.isfinite(each) or not whole]
        return draw(st.sampled_from(fit if whole else [float(each) for each in fit]))
    if whole:
        return draw(st.integers(int(max(low, 0)), int(min(high, max(low, 0) + 4))))
    low, high = max(low, 0.0 if low >= 0.0 or high < 10.0 else -10.0), min(high, max(10.0, low))
    value = draw(st.sampled_from([0.5, 1.0, 0.1, 0.03, 2.0, 5.0, 0.25, 10.0, 0.9]))
    value = value if low <= value <= high else draw(st.floats(low, high))
    return -value if low < 0 and draw(st.booleans()) else value


def value(draw, annotation, metadata, wild: Wild, depth: int):
    """Draw what an annotation asks for, or rarely something else."""
    if rare(draw, wild.odd):
        return draw(st.sampled_from(ODD))
    origin = get_origin(annotation)
    if origin is Annotated:
        return value(draw, get_args(annotation)[0], [*annotation.__metadata__, *metadata], wild, depth)
    choices = next((each for each in metadata if isinstance(each, OneOf)), None)
    if choices is not None and origin not in (tuple, Union, UnionType):
        model = draw(st.sampled_from(list(choices.choices().values())))
        return {"kind": kind_of(model)} | table(draw, model, wild, depth + 1)
    if origin is Literal:
        return draw(st.sampled_from(get_args(annotation)))
    if origin in (Union, UnionType):
        inner = [each for each in get_args(annotation) if each is not NoneType]
        return value(draw, draw(st.sampled_from(inner)), metadata, wild, depth)
    if origin is tuple:
        first, *others = get_args(annotation)
        if others == [...]:
            least = bounds_of(metadata).get("min_length", 0)
            size = draw(st.integers(least, least + 2))
            return [
                value(draw, first, [each for each in metadata if isinstance(each, OneOf)], wild, depth)
                for _ in range(size)
            ]
        found = [value(draw, each, [], wild, depth) for each in (first, *others)]
        numbers = all(isinstance(each, int | float) for each in found)
        return sorted(found) if numbers and draw(st.integers(0, 9)) else found
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return table(draw, annotation, wild, depth + 1)
    if annotation is bool:
        return draw(st.booleans())
    if annotation in (int, float):
        return number(draw, annotation is int, metadata, wild)
    if annotation is str:
        return draw(st.sampled_from(TEXTS))
    if origin is dict:
        return {}
    return draw(st.sampled_from(ODD))


def table(draw, model: type[BaseModel], wild: Wild, depth: int = 0) -> dict[str, Any]:
    """Draw a table of a model: some of its keys, all that it needs, and rarely one that it has not."""
    hints = get_type_hints(model, include_extras=True)
    found = {
        name: value(draw, hints[name], field.metadata, wild, depth)
        for name, field in model.model_fields.items()
        if name != "kind" and (field.is_required() or draw(st.booleans()))
    }
    if rare(draw, wild.odd):
        found[draw(st.sampled_from(["", "kind", "x.y", "ü", "count", "a b"]))] = draw(st.sampled_from(ODD))
    return found


def keys(tables: Any, above: str = ""):
    """Yield the dotted keys of tables, and what they are."""
    for key, each in tables.items() if isinstance(tables, dict) else ():
        yield f"{above}{key}", each
        yield from keys(each, f"{above}{key}.")


def without(tables: Any, place: list[str]) -> None:
    """Remove the key at a place, or that nearest above it."""
    for depth in range(len(place), 0, -1):
        node = tables
        for part in place[: depth - 1]:
            node = node.get(part) if isinstance(node, dict) else None
        if isinstance(node, dict) and place[depth - 1] in node:
            del node[place[depth - 1]]
            return


def recovered(tables: dict[str, Any]) -> dict[str, Any]:
    """Return tables without what the program refuses, so that most documents run."""
    for _ in range(8):
        try:
            validate(Source("f", tables, Scenario))
        except ScenarioError as error:
            for fault in str(error).splitlines():
                _, place, *_ = fault.split(": ")
                without(tables, place.split("."))
        else:
            break
    return tables


@st.composite
def documents(draw) -> dict[str, Any]:
    """Draw the tables of a scenario file; most are valid, small and short, and none of these is for sure."""
    wild = draw(st.sampled_from([TAME, TAME, EDGY, EDGY, EDGY, ODDER]))
    tables = table(draw, Scenario, wild)
    if not rare(draw, 1.0):
        tables["horizon"] = draw(st.sampled_from([0.3, 0.05, 1.0]))
    team = tables.setdefault("team", {})
    if isinstance(team, dict) and not rare(draw, 2.0):
        team["count"] = draw(st.integers(1, 5))
    if wild is not ODDER and not rare(draw, 10.0):
        recovered(tables)
    return tables


def text_of(tables: dict[str, Any]) -> bytes:
    """Return tables as a TOML file; numbers that are too long for Python to print are left to it."""
    return tomli_w.dumps(tables).encode("utf-8", "surrogatepass")


# What must hold of a command.


@pytest.fixture(autouse=True)
def _watched():
    """Let the messages of every run in this process be counted."""
    begin = Trace.__init__
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trace, "__init__", lambda self, watchers=(), **more: begin(self, (*watchers, judge()), **more))
        yield


WATCHERS: list[Conservation] = []


def judge() -> Conservation:
    """Return a watcher that is asked when the command is over."""
    WATCHERS.append(Conservation())
    return WATCHERS[-1]


def call(*args: object) -> tuple[int, str, str]:
    """Call the command in this process; return its exit code and what it prints, if it ends as it may."""
    WATCHERS.clear()
    start = time.monotonic()
    made = CliRunner().invoke(main, [str(each) for each in args], catch_exceptions=False)
    assert time.monotonic() - start < SLOW, "it hangs"
    assert made.exit_code in {OK, OUT_OF_TIME, WRONG_INPUT, FAILED}, made.output
    assert "Traceback" not in made.output
    if made.exit_code == OK:
        for watcher in WATCHERS:
            watcher.judge()
    if made.exit_code == WRONG_INPUT:
        assert made.stdout == ""
    if made.exit_code == OUT_OF_TIME:
        said = (
            rf"^--timeout: took longer than {LIMIT:g} s: (.*\.py:\d+ \(|the limit was reached while|it ended by itself)"
        )
        assert re.search(said, made.stderr, re.MULTILINE), made.stderr
        if "of simulated time" in made.stderr:
            assert WAITING.search(made.stderr)
    return made.exit_code, made.stdout, made.stderr


NO_KEY = "not TOML|should be KEY=VALUE|.* is not a TOML value|.* is more than one value|.* is not a key of a table"
"""The message on a line, or an override, without any key."""


def check_refusal(file: Path, said: str, overrides: tuple[str, ...] = ()) -> None:
    """Check that each line names the file, the line and the key of an error, or the override."""
    faults = [line for line in said.splitlines() if not line.startswith("warning: ")]
    assert faults
    # The middle of a very long line is left out, and so may be the end of an override.
    starts = [re.escape(escaped(f"--set {each}")[:900]) + (".*" if len(each) > 800 else "") for each in overrides]
    starts.append(rf"{re.escape(str(file))}:\d+")
    for line in faults:
        assert re.match(rf"({'|'.join(starts)}): ({NO_KEY}|\S.*: )", line), line
        told = re.sub(r"--set .*?: |\(got .*|'.*?'|\".*?\"", "", line.replace(str(file), ""))
        assert not JARGON.search(told), line


HINTS = get_type_hints(Summary)


def check_numbers(runs: list[dict[str, Any]]) -> None:
    """Check that all is there and finite that a summary promises."""
    for run in runs:
        assert set(METRICS) <= set(run)
        for name, each in run.items():
            assert each is not None or NoneType in get_args(HINTS[name]), name
            assert not isinstance(each, float) or math.isfinite(each), name


def check_run(file: Path, *overrides: str, out: Path | None = None, runs: int = 1) -> int:
    """Run a scenario file and check what comes of it."""
    options = [part for each in overrides for part in ("--set", each)] + (["-o", out] if out else [])
    code, stdout, stderr = call("run", file, "--json", "-n", runs, "--timeout", LIMIT, *options)
    if code == WRONG_INPUT:
        check_refusal(file, stderr, overrides)
    if code == OK:
        check_numbers(strict_json(stdout)["runs"])
    if out is not None:
        check_folders(out, code == OK)
    return code


def check_folders(out: Path, is_whole: bool) -> None:
    """Check that a folder holds a whole run, or several, or nothing that looks like one."""
    homes = [home for home in (out, *out.glob("seed-*")) if (home / "run.json").exists()]
    assert homes or not is_whole
    for home in homes:
        if strict_json((home / "run.json").read_text())["runs"] > 1:
            continue
        result = run_folder.read(home)
        numbers = strict_json((home / "summary.json").read_text())
        check_numbers([numbers])
        assert numbers["seed"] == result.seed
        if result.scenario.record.messages != "file":  # else ages and beliefs, too, can be measured now
            assert numbers == json.loads(json.dumps(run_folder.plain(run_folder.summary(result)))), "of another run"
        tomllib.loads((home / "scenario.toml").read_text())


HOW = st.sampled_from([*[""] * 36, *["out"] * 8, *["two"] * 4, "pictures"])


@contextmanager
def pictures(*, drawn: bool):
    """Let pictures be drawn, which take most of the time of a small run, or not."""
    with pytest.MonkeyPatch.context() as patch:
        if not drawn:
            patch.setattr(run_folder, "can_plot", lambda: False)
        yield


FOUND = [
    {"evader": {"strategy": {"kind": "diffusion", "sigma": -0.0}}},
    {"network": {"latency": {"kind": "shifted_exponential", "mean": -0.0}}},
    {"network": {"latency": {"kind": "shifted_exponential", "offset": 1e9, "mean": 1e9}}},
    {"network": {"latency": {"kind": "gamma", "shape": 1e308, "scale": 1e9}}},
    {
        "protocol": {"kind": "sap", "schedule": {"kind": "token_ring", "attempts": 2**31}},
        "network": {"preset": "lora_sf7"},
    },
    {"fault": [{"kind": "crash", "node": 0, "start": 0.1, "end": 1e308}]},
    {"announce": {"belief_timeout": 1e308}},
    {"team": {"count": 1, "positions": {"file": "a\nb"}}},
    {"network": {"latency": {"kind": "empirical", "file": "../a\nb"}}},
]
"""What was wrong once, of documents that follow the schema."""


@pytest.mark.slow_but_one
@pytest.mark.parametrize("tables", FOUND, ids=lambda tables: ".".join(dict(keys(tables))))
def test_former_failures_run_or_are_refused(tables):
    try_document({"horizon": 0.3, "team": {"count": 3}} | tables, "")


@pytest.mark.slow
@fuzz(0.3)
@given(tables=documents(), more=HOW)
def test_any_document_of_the_schema_runs_or_is_refused_by_line_and_key(tables, more):
    try_document(tables, more)


def try_document(tables, more):
    with TemporaryDirectory() as home, pictures(drawn=more == "pictures"):
        file = Path(home, "fuzz.toml")
        file.write_bytes(text_of(tables))
        check_run(file, out=Path(home, "out") if more in {"out", "pictures"} else None, runs=2 if more == "two" else 1)


# Bytes.

JUNK = [
    b"\x00",
    b"\xff",
    b"\xef\xbb\xbf",
    b"\r\n",
    b"\r",
    b"\xed\xa0\x80",
    b"\xe2\x80\xa8",
    *(bytes([each]) for each in b"[]{'=.#-"),
]
JUNK += [
    b'"""',
    b"inf",
    b"nan",
    b"1e999",
    b"0x",
    b"[[",
    b"\n[team]\n",
    b"9" * 5000,
    b"0x" + b"f" * 5000,
    b"[" * 2000,
    b"a." * 500 + b"b = 1",
]
SHORT = ("horizon=0.2",)


@st.composite
def mutations(draw) -> bytes:
    """Draw the bytes of a scenario file with a few faults in it."""
    content = draw(st.sampled_from(SCENARIOS)).read_bytes()
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(content)))
        how = draw(st.sampled_from(["flip", "insert", "cut", "drop", "double", "swap", "newlines"]))
        if how == "flip" and at < len(content):
            content = content[:at] + bytes([content[at] ^ 1 << draw(st.integers(0, 7))]) + content[at + 1 :]
        elif how == "insert":
            content = content[:at] + draw(st.sampled_from(JUNK)) + content[at:]
        elif how == "cut":
            content = content[:at]
        elif how == "drop":
            content = content[:at] + content[at + draw(st.integers(1, 20)) :]
        elif how == "double":
            content = content[:at] + content[max(at - 40, 0) :]
        elif how == "swap":
            words = re.findall(rb"[\w.]+", content) or [b"x"]
            old, new = draw(st.sampled_from(words)), draw(st.sampled_from([*words, b"-1", b"inf", b"1e-9", b"true"]))
            content = content.replace(old, new, draw(st.integers(1, 2)))
        elif how == "newlines":
            content = content.replace(b"\n", draw(st.sampled_from([b"\r\n", b"\r", b"\n\n"])))
    return content


@pytest.mark.whole
@fuzz(0.08)
@given(content=mutations())
@example(content=b"")
@example(content=b"\xef\xbb\xbfname = 'x'")
@example(content=b"x = " + b"[" * 100_000)
@example(content=b"x = " + b"{a=" * 100_000)
@example(content=b"seed = " + b"9" * 100_000)
@example(content=b"x = " + b"[" * 250 + b"]" * 250)
@example(content=b"sweep.grid.x = " + b"[" * 250 + b"]" * 250)
@example(content=b"[" + b"a." * 100_000 + b"b]")
@example(content=b"x = { a = { " + b"'a' . " * 100_000 + b"b = 1 } }")
@example(content=b"x = " + b"a" * 1_000_000)
@example(content=b"".join(b"x%d = 1\n" % k for k in range(10_000)))
@example(content=b"[team]\npositions = [" + b"[1.0, 'x'], " * 10_000 + b"]")
@example(content=b"name = '" + b"x" * 1_000_000 + b"'")
@example(content=b"\n" * 300_000 + b"x = 1")
def test_a_file_of_any_bytes_runs_or_is_refused_by_line(content):
    try_bytes(content)


def try_bytes(content):
    with TemporaryDirectory() as home:
        file = Path(home, "fuzz.toml")
        file.write_bytes(content)
        (Path(home) / "wired.json").write_bytes((SCENARIOS[0].parent / "wired.json").read_bytes())
        check_run(file, *SHORT)


# Overrides and grids.

VALID = json.loads(Scenario().model_dump_json())
PLACES = sorted({*dict(keys(VALID)), *Scenario.model_fields, "protocol.tau.scale", "fault.0.start", "team.speeds.x"})


@st.composite
def overrides(draw) -> str:
    """Draw an argument of --set: mostly a key that there is, and a value in TOML."""
    if rare(draw, 10):
        return draw(
            st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), min_size=1, max_size=20)
        )
    key = draw(st.sampled_from(PLACES))
    if rare(draw, 10):
        key = draw(st.sampled_from(["{}.", ".{}", "{}.x", "{}.0", "x.{}", "{} ", "'{}'"])).format(key)
    found = draw(
        st.sampled_from(
            ["1", "0.5", "-1", "0", "true", "inf", "nan", "1e308", "'x'", "x", "", "[]", "{}", "[[", "1 2", "9" * 5000]
        )
    )
    if rare(draw, 30):
        found = tomli_w.dumps({"v": draw(st.sampled_from(ODD))}).partition("=")[2].replace("\n", " ").strip()
    return f"{key}={found}".replace("\x00", "")  # no operating system passes it


@pytest.mark.slow
@fuzz(0.12)
@given(changes=st.lists(overrides(), min_size=1, max_size=3))
@example(changes=["seed=" + "9" * 5000])
@example(changes=["seed=0x" + "f" * 5000])
@example(changes=["horizon=" + "[" * 5000])
@example(changes=["a." * 20_000 + "b=1"])
@example(changes=["horizon={ " + "a." * 20_000 + "b = 1 }"])
def test_any_override_runs_or_is_refused_by_its_option(changes):
    try_overrides(changes)


def try_overrides(changes):
    with TemporaryDirectory() as home:
        file = Path(home, "fuzz.toml")
        file.write_text("horizon = 0.3\n[team]\ncount = 3\n[protocol]\nkind = 'sap'\n")
        check_run(file, *changes)


@st.composite
def sweeps_of(draw) -> tuple[dict[str, Any], dict[str, Any]]:
    """Draw tables, and their table `sweep`: keys that there are and values that they may take, or may not."""
    tables = draw(documents())
    usual = [0.5, 1.0, 2, 1, 3, True, "sap"]
    values = st.lists(st.sampled_from([*usual, *ODD]), min_size=0 if rare(draw, 5) else 1, max_size=2)
    grid = (
        {name: draw(values) for name in draw(st.lists(st.sampled_from(PLACES), max_size=2, unique=True))}
        if rare(draw, 20)
        else {}
    )
    numbers = [(key, each) for key, each in keys(tables) if type(each) is float]
    for key, each in draw(st.lists(st.sampled_from(numbers), max_size=2)) if numbers else ():
        grid[key] = [each, each / 2]
    return tables, {
        "reps": draw(st.sampled_from([1, 2])),
        "grid": grid or {"seed" if rare(draw, 5) else "team.count": [1, 2]},
    }


@pytest.mark.slow
@fuzz(0.03)
@given(case=sweeps_of())
def test_any_sweep_runs_or_is_refused_and_its_store_is_intact(case):
    try_sweep(*case)


def try_sweep(tables, sweep):
    with TemporaryDirectory() as home, pictures(drawn=sweep["reps"] == 2 and len(sweep["grid"]) == 2):
        file, out = Path(home, "fuzz.toml"), Path(home, "out")
        file.write_bytes(text_of(tables | {"sweep": sweep}))
        code, stdout, stderr = call("sweep", file, "--json", "-o", out, "--timeout", LIMIT)
        if code == WRONG_INPUT:
            check_refusal(file, stderr)
            assert not out.exists()
            return
        strict_json(stdout)
        _, rows = sweeps.rows(out / "sweep.sqlite")
        assert len(rows) >= sweep["reps"]
        for row in rows:
            status, numbers, traceback = row[4:7]
            assert status == "ok" or "TimedOut" in traceback, traceback
            if status == "ok":
                check_numbers([strict_json(numbers)])
        assert call("export", out, out / "runs.csv")[0] == OK


# Commands that are killed.

KILLED = """\
import os, signal, sys

out, after, *arguments = sys.argv[1:]
left = [int(after)]


def count(event, said):
    if event.split(".")[0] in {"open", "os", "sqlite3", "shutil"} and str(said[0]).startswith(out):
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)


sys.addaudithook(count)
from desim.cli import main

main(arguments)
"""
"""A program that calls the command and is killed as it is about to touch a file of its results once more."""


def killed(after: int, out: Path, *args: object) -> bool:
    """Return whether the command was killed when it had touched its files so often, or ended before."""
    words = [sys.executable, "-c", KILLED, str(out), str(after), *(str(each) for each in args)]
    ended = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    assert ended.returncode in {OK, -signal.SIGKILL}, ended.stderr
    return ended.returncode != OK


COMMANDS: dict[str, list[object]] = {
    "run": ["run", "--set", "record.messages=true"],
    "two": ["run", "--set", 'record.messages="file"', "-n", 2],
    "sweep": ["sweep"],
}


@pytest.mark.whole
@pytest.mark.parametrize("how", COMMANDS)
def test_a_command_that_is_killed_leaves_nothing_half_written(tmp_path, how):
    """At seeded moments, over nothing or over what an earlier command left that was killed, too."""
    file, out = tmp_path / "fuzz.toml", tmp_path / "out"
    file.write_text("horizon = 1.0\nteam.count = 3\nsweep = { reps = 4, grid = { 'team.count' = [2, 3] } }\n")
    moments = random.Random(f"{how} {CASES}")
    kills = 0
    for seed in range(max(CASES // 100, 2)):
        options = [*COMMANDS[how][1:], "-o", out, *(["--seed", seed] if how != "sweep" else [])]
        kills += killed(int(2 ** moments.uniform(0, 5)), out, COMMANDS[how][0], file, *options)
        if how != "sweep":
            check_folders(out, is_whole=False)
            for home in (out, *out.glob("seed-*")):  # the picture, which takes longest, is there where run.json is
                assert (home / "trajectory.png").exists() or how == "two" or not (home / "run.json").exists()
            continue
        if (store := out / "sweep.sqlite").exists():
            with closing(sqlite3.connect(store)) as database:
                assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        with pytest.MonkeyPatch.context() as patch:
            undraw(patch)
            assert call("sweep", file, *options)[0] == OK
        assert len(sweeps.rows(store)[1]) == 8
    assert kills > 0

"""How commands end when they cannot print, are given what cannot be read, or run code that ends the program."""

import ast
import bz2
import errno
import gzip
import lzma
import os
import re
import signal
import subprocess
import sys
import warnings
import weakref
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from runpy import run_module

import pytest
from click.testing import CliRunner

from desim.cli import main
from desim.cli.program import Program, released
from desim.config.errors import MetricError
from desim.config.whole_files import write_whole
from desim.kernel.core.trace_file import TraceFile
from desim.scenario.overrides import ScenarioError
from desim.scenario.toml import load
from tests.command import accepted, desim, refused

SHORT = 'horizon = 0.2\nteam.count = 2\nsweep = { reps = 1, grid = { "evader.speed" = [0.1, 0.2] } }\n'
CODE = """\
import sys

def leave(me):
    yield me.sleep(0.1)
    if me.id == 1:
        sys.exit(0)

class Flee:
    def __call__(self, state, rng):
        sys.exit(0)

def reads(me):
    yield me.sleep(0.1)
    open("no_such_map.csv")
"""
METRICS = """\
def divided(number):
    return number / 0

def fails(result):
    return divided(1)

def returns_text(result):
    return "x"
"""


@pytest.fixture
def file(tmp_path):
    """Return a function that writes a scenario with some lines more, and returns its path."""

    def write(more="", encoding="utf-8"):
        path = tmp_path / "f.toml"
        path.write_text(more + SHORT, encoding=encoding)
        return path

    return write


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
@pytest.mark.parametrize(
    "args",
    [("run",), ("run", "--json"), ("run", "-n", "2"), ("sweep",), ("sweep", "--dry-run"), ("check",), ("--help",)],
)
def test_a_full_stdout_is_reported_in_one_line(file, tmp_path, monkeypatch, capsys, args):
    monkeypatch.chdir(tmp_path)
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        with pytest.raises(SystemExit) as ended:
            main([*args, *([] if args == ("--help",) else [str(file())])])
    assert ended.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1] == "stdout: cannot be written: No space left on device"


@pytest.mark.whole
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
@pytest.mark.parametrize(
    ("args", "code"),
    [(("run", "--set", "horizonn=1"), 2), (("sweep", "-n", "2", "-o", "out"), 0)],
    ids=["run", "sweep"],
)
def test_with_a_full_stderr_results_and_the_exit_code_remain(file, tmp_path, args, code):
    command = [sys.executable, "-m", "desim", *args, str(file())]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(command, cwd=tmp_path, stderr=full, stdout=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == code
    assert (tmp_path / "out" / "sweep.txt").exists() == (args[0] == "sweep")
    assert bool(ended.stdout) == (args[0] == "sweep")


@pytest.mark.parametrize("runs", [(), ("-n", "2")])
@pytest.mark.parametrize(
    ("key", "told"),
    [
        (
            'protocol.kind = "code_that_ends:leave"',
            r"the protocol called exit\(0\) \(pursuer 1, at 0.1 s of its clock\)",
        ),
        ('evader.strategy.kind = "code_that_ends:Flee"', r"code of the scenario called exit\(0\)"),
    ],
)
def test_a_run_whose_code_calls_exit_has_failed(file, tmp_path, monkeypatch, key, told, runs):
    (tmp_path / "code_that_ends.py").write_text(CODE)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(RuntimeError, match=f"^{told}$"):
        desim("run", file(f"{key}\n"), "--allow-import", *runs)


@pytest.mark.parametrize("runs", [(), ("-n", "2")])
@pytest.mark.parametrize("recording", ["", 'record.messages = "file"\n'])
@pytest.mark.parametrize("is_written", [False, True])
def test_a_file_that_the_code_of_a_run_cannot_read_is_not_taken_for_the_output(
    file, tmp_path, monkeypatch, runs, recording, is_written
):
    (tmp_path / "code_that_ends.py").write_text(CODE)
    monkeypatch.syspath_prepend(tmp_path)
    output = ("-o", tmp_path / "out") if is_written else ()
    with pytest.raises(FileNotFoundError, match=r"no_such_map\.csv"):
        desim("run", file(f'protocol.kind = "code_that_ends:reads"\n{recording}'), "--allow-import", *runs, *output)


@pytest.mark.parametrize("runs", [(), ("-n", "2")])
def test_a_disk_that_is_full_during_a_run_is_reported_as_such(file, tmp_path, monkeypatch, runs):
    def write(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(TraceFile, "__call__", write)
    done = desim("run", file('record.messages = "file"\n'), *runs, "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert done.stderr.splitlines()[-1] == f"--out {tmp_path / 'out'}: cannot be written: No space left on device"


@pytest.mark.parametrize("runs", [(), ("-n", "2")])
@pytest.mark.parametrize(
    ("name", "calls", "told"),
    [("fails", ["return divided(1)", "return number / 0"], "ZeroDivisionError: division by zero"),
     ("returns_text", [], "should return a number, True, False or None, not a str")],
)  # fmt: skip
def test_a_metric_that_fails_is_told_with_its_own_calls_only(file, tmp_path, monkeypatch, name, calls, told, runs):
    (tmp_path / "metrics_that_end.py").write_text(METRICS)
    monkeypatch.syspath_prepend(tmp_path)
    done = desim("run", file(), "--allow-import", "--metric", f"metrics_that_end:{name}", *runs)
    *lines, last = done.stderr.splitlines()
    assert done.exit_code == 1
    assert last == f"metric '{name}' of 'unnamed' with seed 0: {told}"
    assert [line.strip() for line in lines if "File" not in line and "^" not in line] == calls
    assert all("metrics_that_end.py" in line for line in lines if "File" in line)


def test_a_metric_that_fails_ends_every_command_with_a_sentence():
    """Such as `desim live`, whose metrics are computed after the runs."""

    def fail():
        raise MetricError("metric 'late' of 'duel' with seed 0: KeyError: 'x'")

    result = CliRunner().invoke(Program("measure", callback=fail))
    assert (result.exit_code, result.stderr) == (1, "metric 'late' of 'duel' with seed 0: KeyError: 'x'\n")


def test_a_module_that_calls_exit_cannot_be_imported(file, tmp_path, monkeypatch):
    (tmp_path / "module_that_ends.py").write_text("import sys\nsys.exit(0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    done = desim("run", file('protocol.kind = "module_that_ends:x"\n'), "--allow-import")
    assert done.exit_code == 2
    assert "cannot be imported: module_that_ends calls exit(0)" in done.stderr


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
@pytest.mark.parametrize(
    ("line", "pipe", "args"),
    [
        ('network.graph = { kind = "edges", file = "pipe.json" }\n', "pipe.json", ("check",)),
        ('network.graph = { kind = "edges", file = "pipe.graphml" }\n', "pipe.graphml", ("check",)),
        ('network.latency = { kind = "empirical", file = "pipe.txt" }\n', "pipe.txt", ("run",)),
        ("", "pipe.toml", ("check", "pipe.toml")),
        ("", "run.json", ("run", "--from", "run.json")),
        ("", "trace.jsonl", ("replay", ".")),
    ],
)
def test_a_pipe_is_refused_at_once(file, tmp_path, monkeypatch, line, pipe, args):
    """Opening one blocks until a writer opens it."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo(pipe)
    done = desim(*args, *([file(line)] if line else []))
    assert done.exit_code == 2
    assert f"{pipe}{'' if line else ':'} cannot be read: not a regular file" in done.stderr
    assert not line or done.stderr.startswith(f"{tmp_path}/f.toml:1: {line.split(' = ')[0]}: ")


@pytest.mark.parametrize("options", [(), ("-n", "2")])
def test_the_end_of_a_trace_is_one_line(file, tmp_path, options):
    (tmp_path / "rtt.csv").write_text("t,value\n0,0.001\n0.05,0.001\n")
    done = desim("run", file('network.latency = { kind = "trace", file = "rtt.csv", after = "error" }\n'), *options)
    assert done.exit_code == 2
    warning, why = done.stderr.splitlines()
    assert warning.startswith(f"warning: {tmp_path}/f.toml:1: network.latency.after: a message that is sent later than")
    assert re.match(r"rtt\.csv ends at 0\.1 s, but a message on the link from \d+ to \d+ is sent at 0\.1\d* s, ", why)


@pytest.mark.parametrize("text", ['"hello"', "[]", "1"])
def test_json_that_is_not_a_graph_is_reported_as_such(file, tmp_path, text):
    (tmp_path / "graph.json").write_text(text)
    done = desim("check", file('network.graph = { kind = "edges", file = "graph.json" }\n'))
    assert done.exit_code == 2
    assert "graph.json is not a graph in JSON: it should be an object" in done.stderr


def test_a_byte_order_mark_is_no_part_of_a_file(file, tmp_path):
    assert load(file(encoding="utf-8-sig")) == load(file())
    done = desim("check", file("horizons = 1.0\n", encoding="utf-8-sig"))
    assert done.stderr.startswith(f"{tmp_path}/f.toml:1: horizons: unknown key")
    (tmp_path / "f.toml").write_bytes(b"\xef\xbb\xbf#\n\xe9")
    assert desim("check", tmp_path / "f.toml").stderr.startswith(f"{tmp_path}/f.toml:2: not TOML: not UTF-8 text")


@pytest.mark.parametrize(
    ("name", "compress"), [("gzip", gzip.compress), ("bzip2", bz2.compress), ("xz", lzma.compress)]
)
def test_a_compressed_scenario_file_is_refused_with_the_program_that_reads_it(name, compress, tmp_path):
    (tmp_path / "f.toml").write_bytes(compress(b"horizon = 1.0\n"))
    with pytest.raises(ScenarioError, match=f"f.toml: not TOML: it is compressed by {name}; decompress it first"):
        load(tmp_path / "f.toml")


@pytest.mark.filterwarnings("always")
def test_a_warning_is_one_line_without_the_source_that_gave_it():
    command = Program("warn", callback=lambda: warnings.warn("the store has a rollback journal", stacklevel=1))
    assert CliRunner().invoke(command).stderr == "warning: the store has a rollback journal\n"


@contextmanager
def small_disk():
    """Let no file grow beyond 500 bytes, as on a disk that is nearly full; that of the output of pytest may have to."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(
    ("args", "name"),
    [
        (("replay",), "a.html"),
        (("plot",), "a.svg"),
        (("plot",), "a.pdf"),
        (("plot", "--kind", "spacetime"), "a.png"),
        (("plot", "--kind", "film"), "a.gif"),
        (("plot", "--kind", "perfetto"), "a.json"),
        (("export",), "a.csv"),
        (("export",), "a.parquet"),
        (("export",), "a.pcapng"),
        (("export",), "a.mcap"),
    ],
)
def test_a_file_that_cannot_be_written_as_a_whole_leaves_the_older_one(file, tmp_path, args, name):
    """What has been shown before stays, and no part of the new file is left beside it."""
    target = tmp_path / name
    scenario = file("record.messages = true\n")
    command = [*args, scenario, *(["-o"] if args[0] != "export" else []), target]
    accepted(*command)
    assert target.stat().st_size > 500
    target.write_text("older\n")
    with small_disk():
        done = desim(*command)
    assert done.exit_code == 2
    assert "cannot be written: File too large" in done.stderr
    assert target.read_text() == "older\n"
    assert not list(tmp_path.glob("*.part"))


def test_a_pipe_is_written_as_it_is(tmp_path):
    """A shell gives /dev/fd/63 for >(gzip): there is no file to replace."""
    pipe = tmp_path / "page.html"
    os.mkfifo(pipe)
    with ThreadPoolExecutor(1) as reader:
        read = reader.submit(pipe.read_bytes)
        write_whole(pipe, b"page")
        assert read.result(30) == b"page"
    assert pipe.is_fifo()


@pytest.mark.parametrize(
    "command", ["replay", "plot", "export", "check", "report", "explain", "run", "sweep", "play", "fates"]
)
def test_every_command_that_runs_takes_a_time_limit(command):
    assert "--timeout" in desim(command, "--help").output


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # raised where Python drops exceptions
@pytest.mark.whole
@pytest.mark.parametrize("args", [("replay",), ("plot",), ("export",)])
def test_a_command_that_takes_too_long_is_ended(file, tmp_path, monkeypatch, args):
    """Heartbeats every microsecond would take hours."""
    monkeypatch.chdir(tmp_path)
    endless = file("announce.heartbeat = 1e-6\n")
    done = desim(*args, endless, *(["a.csv"] if args == ("export",) else []), "--timeout", 1)
    assert done.exit_code == 1
    assert re.match(r"--timeout: took longer than 1 s: at [\d.e-]+ s of simulated time", done.stderr)


def test_too_little_memory_is_told_in_one_line(file, tmp_path, monkeypatch):
    def fill(*_):
        raise MemoryError

    monkeypatch.setattr("desim.simulation.run.World", fill)
    done = desim("run", file())
    assert done.exit_code == 1
    assert done.stderr.startswith("out of memory: ")
    assert len(done.stderr.splitlines()) == 1


def test_the_calls_that_filled_the_memory_hold_nothing_any_more_when_it_is_told(file, monkeypatch):
    error, seen = MemoryError(), []

    def fill(*_):
        raise error

    monkeypatch.setattr("desim.simulation.run.World", fill)
    monkeypatch.setattr("desim.cli.program.echo", lambda *_, **__: seen.append(error.__traceback__))
    assert desim("run", file()).exit_code == 1
    assert seen == [None]


def test_samples_that_fill_the_memory_are_told_before_the_run(tmp_path):
    """500,000 samples of 21 players."""
    scenario = tmp_path / "long.toml"
    scenario.write_text("horizon = 0.5\n")
    told = accepted("check", scenario, "--set", "record.trajectory=1e-6").stderr
    assert "record.trajectory: up to 10,500,000 positions are recorded, about 1.4 GB of memory" in told
    assert accepted("check", scenario, "--set", "record.trajectory=2e-6").stderr == f"{scenario} is valid\n"


@pytest.mark.slow
def test_an_error_repeats_no_name_of_a_hundred_thousand_characters(tmp_path):
    scenario = tmp_path / "long.toml"
    scenario.write_text(f"{'x' * 10**6} = 1\nhorizonn = 1\n")
    first, second = refused("check", scenario).splitlines()
    assert len(first) < 2100
    assert first.startswith(f"{scenario}:1: xxx")
    assert "unknown key" in first
    assert "did you mean 'horizon'" in second


def test_ctrl_c_while_the_command_is_imported_ends_with_one_line(monkeypatch, capsys):
    class Interrupted:
        @staticmethod
        def find_spec(name, *_):
            if name == "desim.cli":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "desim.cli")
    monkeypatch.delitem(sys.modules, "desim.__main__", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupted, *sys.meta_path])
    with pytest.raises(SystemExit) as ended:
        run_module("desim.__main__")
    assert ended.value.code == 130
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("step", "words"), [("check_hyphens", ["keys"]), ("advised", ["keys", "-y"]), ("advised", ["-y"])]
)
def test_a_signal_while_the_words_are_read_ends_as_during_the_command(step, words, number, monkeypatch):
    monkeypatch.setattr(f"desim.cli.program.{step}", lambda *_: signal.raise_signal(number))
    ended = desim(*words)
    assert ended.exit_code == 128 + number
    assert ended.stderr == ("interrupted\n" if number == signal.SIGINT else "interrupted by SIGTERM\n")


def test_a_run_out_of_memory_lets_go_of_what_its_calls_hold_before_it_says_so():
    """Otherwise the message has no memory either. Errors that followed hold the first one."""

    class Large:
        pass

    def simulate():
        large = Large()
        kept.append(weakref.ref(large))
        raise MemoryError

    def clean_up():
        large = Large()
        kept.append(weakref.ref(large))
        try:
            simulate()
        except MemoryError:
            raise MemoryError from None

    kept: list[weakref.ref[Large]] = []
    try:
        clean_up()
    except MemoryError as error:
        assert all(reference() is not None for reference in kept)
        released(error)
        assert all(reference() is None for reference in kept)
    assert len(kept) == 2


def test_interrupted_runs_tell_the_sweep_that_keeps_them(file, monkeypatch, capsys):
    """The sweep has all options of the command that concern it, and none that was not given."""

    def interrupted(*_args):
        raise KeyboardInterrupt

    monkeypatch.setattr("desim.study.workers.batch.run_many", interrupted)
    for options, more in (
        ((), ""),
        (("-s", "0", "--timeout", "9", "--allow-import"), "-s 0 --timeout 9.0 --allow-import"),
    ):
        with pytest.raises(SystemExit):
            main(["run", str(file()), "-n", "3", *options])
        words = ["desim sweep", str(file()), "-g horizon=0.2 -n 3", *([more] if more else [])]
        assert capsys.readouterr().err.rstrip().endswith(f"make a sweep: {' '.join(words)}")


def of_stderr(source):
    """Return the lines of a source at which a warning is printed, and whether each goes to stderr."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call) and node.args]
    printed = [call for call in calls if getattr(call.func, "id", "") == "echo"]
    return [
        any(keyword.arg == "err" and keyword.value.value is True for keyword in call.keywords)
        for call in printed
        if "warning: " in ast.unparse(call.args[0])
    ]


def test_every_warning_of_a_command_goes_to_stderr():
    """The results on stdout can then be read by another program."""
    found = [of_stderr(path.read_text()) for path in (Path(__file__).parents[2] / "desim" / "cli").rglob("*.py")]
    assert sum(map(len, found)) > 10
    assert all(map(all, found))
    assert of_stderr("echo('warning: a')\necho('warning: b', err=True)\necho('c')") == [False, True]

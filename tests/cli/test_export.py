"""`desim export` of a run: the formats, what it says, and what it refuses. That of a sweep is in tests/test_cli.py."""

import sys
import tracemalloc
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from scapy.utils import RawPcapNgReader

from desim import load
from desim.cli.export import KINDS
from desim.kernel.core.events import LOST, Broadcast, MessageCounts
from desim.pursuit.core.events import Ended, Started
from desim.results import run_folder
from desim.view.formats import trace_table
from desim.view.formats.export import export
from scenarios.studies.study import SCENARIOS
from tests.command import accepted, desim, refused

SHORT = ["horizon=0.2", "team.count=4"]


@pytest.fixture(scope="module", autouse=True)
def _no_pictures():
    """They take a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_folder, "can_plot", lambda: False)
        yield


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return the folder of a run."""
    folder = tmp_path_factory.mktemp("run") / "out"
    scenario = load(SCENARIOS / "recorded.toml", SHORT)
    run_folder.write(run_folder.simulate(folder, scenario, 3), folder)
    return folder


def topics_of(file):
    with file.open("rb") as stream:
        return {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}


@pytest.mark.slow
def test_a_run_is_exported_to_each_format(recorded, tmp_path):
    events = list(run_folder.events(recorded))
    table = list(trace_table.rows(events))
    for name, said in [
        ("x.csv", f"{len(table):,} rows"),
        ("x.PARQUET", f"{len(table):,} rows"),
        ("x.pcapng", f"{sum(len(list(each.fates())) for each in events if hasattr(each, 'fates')):,} packets"),
        ("x.mcap", None),
    ]:
        result = accepted("export", recorded, tmp_path / name)
        assert result.stdout == ""
        assert result.stderr.endswith(f" to {tmp_path / name}\n")
        assert said is None or result.stderr == f"wrote {said} to {tmp_path / name}\n"
    assert len(pd.read_csv(tmp_path / "x.csv")) == len(pd.read_parquet(tmp_path / "x.PARQUET")) == len(table)
    with RawPcapNgReader(str(tmp_path / "x.pcapng")) as reader:
        assert len(list(reader)) == events[-2].sent
    assert topics_of(tmp_path / "x.mcap") == {"/tf", "/players", "/in_flight", "/log", "/messages", "/beliefs"}
    assert sorted(each.name for each in tmp_path.iterdir()) == ["x.PARQUET", "x.csv", "x.mcap", "x.pcapng"]


def test_a_scenario_is_run_first_and_gives_what_its_recorded_run_gives(recorded, tmp_path):
    options = [word for each in SHORT for word in ("--set", each)]
    accepted("export", SCENARIOS / "recorded.toml", tmp_path / "a.csv", "-s", 3, *options)
    accepted("export", recorded / "trace.jsonl", tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_the_number_of_rows_is_told(recorded, tmp_path):
    count = len(list(trace_table.rows(list(run_folder.events(recorded)))))
    assert accepted("export", recorded, tmp_path / "x.csv").stderr == f"wrote {count:,} rows to {tmp_path / 'x.csv'}\n"


def test_one_row_is_told_in_the_singular(recorded, tmp_path):
    done = accepted("export", recorded, tmp_path / "x.csv", "--event", "Ended")
    assert done.stderr == f"wrote 1 row to {tmp_path / 'x.csv'}\n"


def test_a_table_may_be_restricted_to_types_of_events(recorded, tmp_path):
    assert KINDS == trace_table.KINDS
    accepted("export", recorded, tmp_path / "x.csv", "--event", "Sampled", "--event", "Captured")
    frame = pd.read_csv(tmp_path / "x.csv")
    assert list(frame) == ["line", "event", "t", "pursuer", "evader", "x", "y", "capturer"]
    assert set(frame["event"]) == {"Sampled"}


@pytest.mark.slow
def test_beliefs_are_left_out_of_a_run_that_was_written_to_disk_as_it_went(tmp_path):
    """Such a trace may be too long for the memory; one without messages has no beliefs, and a warning says so."""
    for messages, warned in (('"file"', ""), ("false", "messages were not recorded, and are left out")):
        folder = tmp_path / messages.strip('"')
        scenario = load(SCENARIOS / "recorded.toml", [*SHORT, f"record.messages={messages}"])
        run_folder.write(run_folder.simulate(folder, scenario, 3), folder, simulated_there=True)
        result = accepted("export", folder, tmp_path / "x.mcap")
        assert warned in result.stderr
        assert "/beliefs" not in topics_of(tmp_path / "x.mcap")
        assert ("/messages" in topics_of(tmp_path / "x.mcap")) == (not warned)


def test_a_trace_without_run_json_is_exported_too(recorded, tmp_path):
    (tmp_path / "trace.jsonl").write_bytes((recorded / "trace.jsonl").read_bytes())
    accepted("export", tmp_path, tmp_path / "x.mcap")
    assert "/beliefs" not in topics_of(tmp_path / "x.mcap")


def test_what_makes_no_sense_is_refused(recorded, tmp_path):
    to = tmp_path / "x.csv"
    suffixes = "should end in .csv, .parquet, .pcapng, .mcap or .perfetto.json"
    assert refused("export", recorded, tmp_path / "x.txt") == f"{tmp_path}/x.txt: {suffixes}\n"
    assert "apply to a scenario FILE only" in refused("export", recorded, to, "-s", 1)
    assert "'Decide' is not one of 'Started', 'Decided'" in refused("export", recorded, to, "--event", "Decide")
    assert "the exporter mcap has no parameter 'events'" in refused(
        "export", recorded, tmp_path / "x.mcap", "--event", "Lost"
    )
    unknown = refused("export", recorded, to, "--exporter", "pcap")
    assert unknown.startswith("there is no exporter pcap, did you mean 'pcapng'?; there are csv, parquet, ")
    assert refused("export", tmp_path / "no.toml", to).startswith(f"{tmp_path}/no.toml: cannot be read")
    missing = tmp_path / "none" / "x.csv"
    for suffix in (".csv", ".parquet", ".pcapng", ".mcap"):
        why = f"{missing.with_suffix(suffix)}: cannot be written: No such file or directory\n"
        assert refused("export", recorded, missing.with_suffix(suffix)) == why
    both = tmp_path / "both"
    both.mkdir()
    for name in ("trace.jsonl", "sweep.sqlite"):
        (both / name).write_text("")
    assert (
        refused("export", both, to)
        == f"{both}: has a run and a sweep: give {both}/trace.jsonl or {both}/sweep.sqlite\n"
    )
    (both / "trace.jsonl").unlink()
    assert "--event chooses events of a run" in refused("export", both, to, "--event", "Lost")
    assert not to.exists()
    with pytest.raises(ValueError, match=rf"x\.txt: {suffixes}"):
        export(SimpleNamespace(trace=None), tmp_path / "x.txt")
    assert not (tmp_path / "x.txt").exists()


def test_after_an_error_the_older_file_is_as_it_was(recorded, tmp_path):
    """The trace is damaged in the last line, when nearly all of the table has been written."""
    lines = (recorded / "trace.jsonl").read_text().splitlines()
    (tmp_path / "trace.jsonl").write_text("\n".join([*lines[:-1], '{"event": "Endde"}']) + "\n")
    to = tmp_path / "x.csv"
    to.write_text("older")
    assert f"{tmp_path}/trace.jsonl: line {len(lines)} is not an event" in refused("export", tmp_path, to)
    assert to.read_text() == "older"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["trace.jsonl", "x.csv"]


@pytest.mark.parametrize("kept", [slice(-2), slice(0)], ids=["some", "none"])
@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".pcapng", ".mcap"])
def test_a_trace_without_its_end_is_refused(recorded, tmp_path, suffix, kept):
    lines = (recorded / "trace.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "trace.jsonl").write_text("".join(lines[kept]))
    (tmp_path / "run.json").write_bytes((recorded / "run.json").read_bytes())
    to = tmp_path / f"x{suffix}"
    assert refused("export", tmp_path, to).startswith(f"{tmp_path}/trace.jsonl: is not complete: ")
    assert not to.exists()


@pytest.mark.parametrize(("suffix", "package", "extra"), [("parquet", "pyarrow", "parquet"), ("mcap", "mcap", "mcap")])
def test_a_package_that_is_missing_is_named_with_its_extra(recorded, tmp_path, monkeypatch, suffix, package, extra):
    for name in [each for each in sys.modules if each.partition(".")[0] == package]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, package, None)
    why = f"{package} is missing: pip install 'pursuit-desim[{extra}]', or in a clone pip install '.[{extra}]'\n"
    assert refused("export", recorded, tmp_path / f"x.{suffix}") == why
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("answer", ["one", Path("x"), 1.5, -1, True])
def test_an_exporter_that_returns_no_number_of_items_is_named_and_leaves_the_file(tmp_path, answer):
    def exporter(result, file):
        file.write_text("new")
        return answer

    (file := tmp_path / "x.text").write_text("old")
    with pytest.raises(
        ValueError, match=r"^an exporter should return the number of items .* from exporter .*test_export"
    ):
        export(SimpleNamespace(trace=[]), file, exporter)
    assert file.read_text() == "old"


def test_an_exporter_may_count_with_numpy(tmp_path):
    assert export(SimpleNamespace(trace=[]), tmp_path / "x", lambda _, file: np.int64(file.write_text("new"))) == 3


def test_the_error_of_an_exporter_that_misses_a_package_is_its_own(recorded, tmp_path):
    def asks(result, file):
        raise ModuleNotFoundError("install frobnicate first")

    with pytest.raises(ModuleNotFoundError, match=r"^install frobnicate first$"):
        export(run_folder.streamed(recorded), tmp_path / "x.asks", asks)


def test_the_help_names_the_formats():
    told = desim("export", "--help").stdout
    for word in ("STORE|DIR|FILE TO", ".csv", ".parquet", ".pcapng", ".mcap", "Wireshark", "Foxglove", "--event"):
        assert word in told


def long_trace(count):
    """Yield the events of a run with a number of broadcasts to three receivers each."""
    yield Started(0, ((9.0, 9.0),), ((0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0)), (1.0,) * 4, (0,) * 4)
    for k in range(count):
        t = k * 1_000_000
        yield Broadcast(t, k, 0, k, (1, 2, 3), (t + k, t + 7, LOST), t, 24, (k, 0.5 * k, str(k)))
    yield MessageCounts(t, 3 * count, 2 * count, count, 0, {"loss": count}, count, 24 * count, 0.0)
    yield Ended(t, "horizon", None)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["csv", "parquet", "pcapng", "mcap"])
def test_a_trace_is_not_held_in_memory(tmp_path, suffix, monkeypatch):
    """Three times the length needs hardly more memory; the same events as a list need what that list is.

    Batches and chunks, which are written as a whole, are made short.
    """
    count = 200
    monkeypatch.setattr("mcap.writer.Writer", partial(Writer, chunk_size=1 << 15))
    monkeypatch.setattr(trace_table, "BATCH", 100)

    def peak(make):
        tracemalloc.start()
        try:
            return make(), tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    def exported(events):
        export(SimpleNamespace(trace=events, scenario=None, seed=None), tmp_path / f"x.{suffix}")

    exported(long_trace(100))  # what is imported and cached does not count
    _, short = peak(lambda: exported(long_trace(count)))
    _, long = peak(lambda: exported(long_trace(3 * count)))
    _, held = peak(lambda: list(long_trace(3 * count)))
    assert long - short < 0.1 * held
    _, both = peak(lambda: exported(list(long_trace(3 * count))))
    assert both - short > 0.5 * held

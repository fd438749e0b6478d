"""Bodies of all kinds, sent in all ways, in all files of a run: each file has their content, in full."""

import csv
import json
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pandas as pd
import pytest
from scapy.utils import PcapNgReader

from desim import Scenario, Team, TraceFile, run, summary
from desim.kernel.core.trace_file import line_of
from desim.kernel.models.transport import Coded, Reliable
from desim.pursuit.team.announcements import Announcements
from desim.results import run_folder
from desim.view.formats.export import export
from desim.view.formats.perfetto import perfetto
from tests.message_bodies import BODIES
from tests.view.test_foxglove import read

WAYS = {
    "send": lambda me, body: me.send(1, body, size=40),
    "publish": lambda me, body: me.publish(body, size=40),
    "reliable": lambda me, body: me.send(1, body, "reliable", size=40, transport=Reliable()),
    "coded": lambda me, body: me.send(1, body, "coded", size=40, transport=Coded(pieces=2, needed=1)),
}


pytestmark = pytest.mark.filterwarnings("ignore::desim.config.shared_state.StateWarning")
"""Some bodies keep what they have computed once, so that the collection of all is another one after the first run."""


def sending(me):
    """Send each body in each way."""
    if me.id == 0:
        for body, *_ in BODIES.values():
            for act in WAYS.values():
                act(me, body)
                yield me.sleep(0.005)
    yield me.sleep(100.0)


SCENARIO = Scenario(
    name="bodies",
    team=Team(count=2),
    protocol=sending,
    horizon=4.0,
    announce=Announcements(trigger="never", start="known"),
    evader={"position": (1000.0, 1000.0)},
    record={"messages": True},
)


def told(texts):
    """Return the bodies in JSON texts, each once and in order; a piece or a segment carries a body."""
    bodies = [json.loads(text) for text in texts]
    contents = [body["body"] if isinstance(body, dict) and "session" in body else body for body in bodies]
    return without_repeats(contents)


def without_repeats(contents):
    return [each for k, each in enumerate(contents) if not k or repr(each) != repr(contents[k - 1])]


EXPECTED = without_repeats([content for _, content, _ in BODIES.values()])


@pytest.fixture(scope="module")
def result():
    return run(SCENARIO, 1)


def check(texts):
    assert [repr(each) for each in told(texts)] == [repr(each) for each in EXPECTED]


def is_data(text):
    """Whether the text is the body of a message, and not an acknowledgement of a transport."""
    content = json.loads(text)
    return not (isinstance(content, dict) and "expected" in content)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_tables(result, tmp_path, suffix):
    export(result, tmp_path / f"t{suffix}", {"kind": suffix[1:], "events": ["Sent", "Broadcast"]})
    if suffix == ".csv":
        csv.field_size_limit(1 << 24)
        with (tmp_path / "t.csv").open(newline="", encoding="utf-8") as file:
            texts = [row["body"].removeprefix("'") for row in csv.DictReader(file)]
    else:
        texts = pd.read_parquet(tmp_path / "t.parquet")["body"]
    check(filter(is_data, texts))


@pytest.mark.slow
def test_captures(result, tmp_path):
    export(result, tmp_path / "t.pcapng")
    with PcapNgReader(str(tmp_path / "t.pcapng")) as reader:
        texts = [b"".join(packet.comments).decode() for packet in reader]
    check(filter(is_data, texts))


@pytest.mark.slow
def test_recordings(result, tmp_path):
    export(result, tmp_path / "t.mcap")
    check(filter(is_data, [message["body"] for _, message in read(tmp_path / "t.mcap")["/messages"]]))


@pytest.mark.slow
def test_timelines(result):
    entries = json.loads(perfetto(result))["traceEvents"]
    texts = [json.dumps(each["args"]["says"]) for each in entries if "says" in each.get("args", {})]
    finite = [json.dumps(each).replace("Infinity", '"Infinity"') for each in EXPECTED]
    assert list(map(json.dumps, told(filter(is_data, texts)))) == finite


@pytest.mark.whole
def test_a_trace_file_has_the_trace_and_is_read_again(result, tmp_path):
    with TraceFile(tmp_path / "t.jsonl") as file:
        run(SCENARIO, 1, file)
    run_folder.write(result, tmp_path / "out")
    lines = (tmp_path / "out" / "trace.jsonl").read_text(encoding="utf-8")
    assert (tmp_path / "t.jsonl").read_text(encoding="utf-8") == lines
    check(json.dumps(json.loads(line)["body"]) for line in lines.splitlines() if '"event": "Delivered"' in line)
    again = run_folder.read(tmp_path / "out", allow_import=True)
    run_folder.write(again, tmp_path / "again")
    assert (tmp_path / "again" / "trace.jsonl").read_text(encoding="utf-8") == lines
    assert repr(summary(again)) == repr(summary(result))


PROGRAM = """
from hashlib import sha256
from desim import run
from desim.kernel.core.trace_file import line_of
from tests.view.test_bodies_in_files import SCENARIO
print(sha256("".join(map(line_of, run(SCENARIO, 1).trace)).encode()).hexdigest())
"""


@pytest.mark.whole
def test_a_trace_is_the_same_under_every_hash_seed():
    """Under that of this process, which is drawn when it starts, as under another."""
    here = sha256("".join(map(line_of, run(SCENARIO, 1).trace)).encode()).hexdigest()
    program, environment = [sys.executable, "-c", PROGRAM], {"PYTHONHASHSEED": "1", "PYTHONPATH": "."}
    cwd = Path(__file__).parents[2]
    done = subprocess.run(program, env=environment, cwd=cwd, check=True, capture_output=True, text=True)
    assert done.stdout.strip() == here

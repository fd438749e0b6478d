"""Timelines for Perfetto: the rules of the Trace Event Format, and that nothing of the run is missing."""

import json
from collections import Counter, defaultdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, run, summary
from desim.analysis.deliveries import chasing, deliveries
from desim.kernel.core.events import DeadlineMissed, Expired, GivenUp, LivelinessLost, Retransmitted, Sent
from desim.pursuit.core.events import Decided
from desim.scenario.scenario import Recording
from desim.view.formats.perfetto import FIRST, PURSUERS, _microseconds, perfetto, trace_events, write
from protocols.centralised import Centralised
from tests.golden import golden
from tests.view.by_hand import INACTIVE, MS, history, pair

SHORT = ("horizon=1.0", "record.messages=true")
RUNS = [("soak.toml", *SHORT), *(pytest.param(each, marks=pytest.mark.slow) for each in (
    ("faults.toml",), ("radio.toml", *SHORT), ("contention.toml", *SHORT), ("token_ring.toml", *SHORT), ("many.toml",),
    ("reliable.toml", *SHORT),
))]  # fmt: skip


def key(event):
    """Return what makes two ends one, as the importer has it."""
    return event["pid"], event["cat"], event["id"], event["name"]


class Imported:
    """A trace as Perfetto has it, after `json_trace_tokenizer.cc` and `json_trace_parser_impl.cc` of its importer.

    An event is dropped, and a failure counted, where an assertion stands here. Microseconds are multiplied by 1000 and
    cut off; events are sorted by that, as they come. A thread has a stack of slices, of which an instant is one that
    takes no time; what overlaps another without lying in it is lost.
    """

    def __init__(self, text):
        document = json.loads(text)
        known = {"traceEvents", "systemTraceEvents", "metadata", "displayTimeUnit", "otherData"}
        assert document.keys() <= known, "the rest of the file is skipped"
        assert next(iter(document)) == "displayTimeUnit", "else it may come too late"
        assert document["displayTimeUnit"] in {"ms", "ns"}
        self.threads, self.counters, self.waits = defaultdict(list), defaultdict(list), []
        self.process_names, self.thread_names, self._begun = {}, {}, {}
        events = document["traceEvents"]
        assert all("ts" in event or event["ph"] == "M" for event in events)
        for event in sorted(events, key=lambda event: self._ns(event.get("ts", 0))):
            assert 0 <= event["pid"] < 2**32
            assert 0 <= event["tid"] < 2**32
            assert isinstance(event["name"], str)
            assert event["name"]
            {"M": self._name, "X": self._slice, "i": self._instant, "C": self._count, "b": self._begin, "e": self._end}[
                event["ph"]
            ](event)
        assert not self._begun, "what never ends is drawn to the end of all"

    @staticmethod
    def _ns(value):
        assert type(value) in {int, float}
        return value * 1000 if isinstance(value, int) else int(value * 1000.0)

    def _name(self, event):
        kind, args = event["name"], event["args"]
        assert kind in {"process_name", "thread_name", "process_sort_index", "thread_sort_index"}
        if kind.endswith("index"):
            assert type(args["sort_index"]) is int
        else:
            names, key = (self.process_names, "pid") if kind == "process_name" else (self.thread_names, "tid")
            assert names.setdefault(event[key], args["name"]) == args["name"] != ""

    def _push(self, event, end):
        begin = self._ns(event["ts"])
        ends = self.threads[event["tid"]]  # of the slices that are open
        while ends and ends[-1] <= begin:
            ends.pop()
        assert all(end <= each for each in ends), f"{event} overlaps"
        ends.append(end)

    def _slice(self, event):
        begin, length = self._ns(event["ts"]), self._ns(event["dur"])
        assert length >= 0
        self._push(event, begin + length)
        self.waits.append((event["name"], begin, begin + length))

    def _instant(self, event):
        assert event["s"] in {"g", "p", "t"}
        if event["s"] == "t":
            self._push(event, self._ns(event["ts"]))

    def _count(self, event):
        for name, value in event["args"].items():
            assert type(value) in {int, float}
            self.counters[event["pid"], f"{event['name']} {name}"].append((self._ns(event["ts"]), value))

    def _begin(self, event):
        assert isinstance(event["id"], str)
        assert event["id"]
        assert key(event) not in self._begun
        self._begun[key(event)] = self._ns(event["ts"])

    def _end(self, event):
        self.waits.append((event["name"], self._begun.pop(key(event)), self._ns(event["ts"])))


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("asked", RUNS, ids=lambda asked: asked[0])
def test_perfetto_loses_nothing_of_a_run(asked, run_of):
    """Chases and messages last as long as in the run, to the nanosecond, and nothing overlaps on a thread.

    Perfetto knows a thread by its tid alone, so that each belongs to one process.
    """
    ran = run_of(*asked)
    text, numbers = perfetto(ran), summary(ran)
    found, events = Imported(text), json.loads(text)["traceEvents"]
    chased = [(begin, end) for own in chasing(ran) for begin, end, _ in own]
    waits = [each for each in found.waits if each[0] == "active" or each[0].startswith("chases ")]
    assert sorted((begin, end) for _, begin, end in waits) == sorted(chased)
    flown = [(f"{each.src} to {each.dst}", each.left, each.until) for each in deliveries(ran)]
    assert sorted(each for each in found.waits if " to " in each[0]) == sorted(flown)
    assert [each["ts"] for each in events if "ts" in each] == sorted(each["ts"] for each in events if "ts" in each)
    assert max(Counter((each["cat"], each["id"]) for each in events if each["ph"] == "b").values()) == 1
    processes = defaultdict(set)
    for each in events:
        processes[each["tid"]].add(each["pid"])
        if each.get("cat") == "message":
            assert found.process_names[each["pid"]] == "messages to " + each["name"].split(" to ")[1]
    assert all(len(pids) == 1 for pids in processes.values())
    assert set(processes) == {each["tid"] for each in events if each["name"] in {"thread_name", "process_name"}}
    fates = Counter(each["args"]["fate"] for each in events if each["ph"] == "e" and each["cat"] == "message")
    lost = {fate.removeprefix("lost: "): number for fate, number in fates.items() if fate.startswith("lost: ")}
    assert lost == numbers.messages_lost_by
    assert fates["arrived"] == numbers.messages_delivered
    assert fates["in flight"] == numbers.messages_in_flight


@pytest.mark.parametrize(
    "harm",
    [
        lambda event: event.pop("ts"),
        lambda event: event.pop("pid"),
        lambda event: event.update(ph="B"),
        lambda event: event.update(s="x", ph="i"),
        lambda event: event.update(ph="X", dur=10**9, ts=100_000),
        lambda event: event.update(ph="C", args={"number": "many"}),
        lambda event: event.update(ph="b", cat="x", id=""),
    ],
    ids=["no time", "no process", "never ends", "no scope", "overlaps", "no number", "no id"],
)
def test_events_that_perfetto_would_drop_are_detected(harm):
    document = json.loads(perfetto(history()))
    harm(next(event for event in document["traceEvents"] if event["ph"] == "i" and event["tid"] == 3))
    with pytest.raises((AssertionError, KeyError)):
        Imported(json.dumps(document))


@pytest.mark.slow
@given(t=st.integers(0, 100 * 86_400 * 10**9))
def test_a_time_is_the_same_nanosecond_where_it_is_read(t):
    assert Imported._ns(json.loads(json.dumps(_microseconds(t)))) == t


def test_timelines_of_runs_by_hand_are_golden(tmp_path):
    """Times in microseconds; pursuer i is thread 2 + i of process 1, its receptions are process 2 + i.

    A message arrives as the run ends, and a decision at 123,000.457 us loses no nanosecond.
    """
    just = Sent(950 * MS, 5, 1, 2, 1000 * MS, 950 * MS, 24, INACTIVE)
    odd = Decided(123 * MS + 457, 2, False)
    write(history(just, odd), tmp_path / "timeline.json")
    text = (tmp_path / "timeline.json").read_bytes().decode()
    Imported(text)
    Imported(perfetto(pair()))
    golden("perfetto.txt", text + perfetto(pair()))


def test_what_a_transport_repeats_and_gives_up_is_an_instant_of_its_pursuer():
    flow = (0, 1, "port")
    events = [
        Retransmitted(10 * MS, *flow, False, 3, 2),
        GivenUp(20 * MS, *flow, False, 3, "repeats"),
        Expired(30 * MS, *flow, True, 4),
        DeadlineMissed(40 * MS, *flow),
        LivelinessLost(50 * MS, *flow),
    ]
    found = [each for each in trace_events(history(*events)) if each.get("cat") == "transport"]
    assert [(each["ts"], each["tid"] - FIRST, each["name"]) for each in found] == [
        (10_000, 0, "repeats message 3 to 1"),
        (20_000, 0, "gives up message 3 to 1: repeats"),
        (30_000, 1, "drops message 4 of 0"),
        (40_000, 1, "misses a message of 0"),
        (50_000, 1, "loses the liveliness of 0"),
    ]


def test_without_messages_there_are_no_network_processes():
    scenario = Scenario(protocol=Centralised(), horizon=0.1, record=Recording(messages=True))
    assert {entry["pid"] for entry in trace_events(run(scenario))} == {PURSUERS}


def test_without_recorded_messages_the_pursuers_remain():
    found = trace_events(history(messages=False))
    assert {each["pid"] for each in found} == {PURSUERS}
    assert [each["ts"] for each in found if each["ph"] == "X"] == [0, 0, 800_000]

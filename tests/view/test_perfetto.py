"""Timelines for Perfetto: the rules of the Trace Event Format, and that nothing of the run is missing."""

import itertools
import json
from collections import Counter, defaultdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, load, run, summary
from desim.kernel.events import Sent
from desim.scenario import Recording
from desim.view.passages import chasing, passages
from desim.view.perfetto import PURSUERS, _microseconds, perfetto, trace_events, write
from protocols.centralised import Centralised
from scenarios.study import SCENARIOS
from tests.view.by_hand import INACTIVE, MS, history, pair

NAMES = ("faults", "radio", "token_ring", "soak", "server", "flooding")


@pytest.fixture(scope="module", params=NAMES)
def ran(request):
    return run(load(SCENARIOS / f"{request.param}.toml", ["record.messages=true", "horizon=2.0"]))


@pytest.fixture(scope="module")
def events(ran):
    return json.loads(perfetto(ran), parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))["traceEvents"]


def key(event):
    """Return what makes two ends one, as the importer has it."""
    return event["pid"], event["cat"], event["id"], event["name"]


def check(events):
    """Assert what the format wants of any trace."""
    timed = [event for event in events if event["ph"] != "M"]
    assert events[len(events) - len(timed) :] == timed, "names come first"
    assert {event["ph"] for event in events} <= set("MXiCbe")
    assert all(isinstance(event["pid"], int) and isinstance(event["tid"], int) for event in events)
    times = [event["ts"] for event in timed]
    assert times == sorted(times)
    assert min(times) >= 0
    begun: dict[tuple[object, ...], int] = {}
    for event in timed:
        if event["ph"] == "b":
            assert key(event) not in begun, "an id is of one message"
            begun[key(event)] = 0
        elif event["ph"] == "e":
            begun[key(event)] += 1  # a KeyError if it ends before it begins
    assert set(begun.values()) <= {1}, "what begins ends, once"


def test_times_ascend_and_every_begin_has_one_end(events):
    check(events)


@pytest.mark.parametrize(
    "harm",
    [
        lambda events: events.pop(next(k for k, event in enumerate(events) if event["ph"] == "e")),
        lambda events: events.append(events[-1] | {"ts": 0}),
        lambda events: events.append(next(event for event in events if event["ph"] == "b") | {"ts": 1e9}),
        lambda events: events.reverse(),
    ],
    ids=["an end is missing", "time runs back", "an id is used twice", "backwards"],
)
def test_the_check_would_notice(harm):
    harmed = trace_events(history())
    harm(harmed)
    with pytest.raises((AssertionError, KeyError)):
        check(harmed)


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


def test_perfetto_loses_nothing_of_it(ran):
    """Chases and messages last as long as in the run, to the nanosecond, and nothing overlaps on a thread."""
    found = Imported(perfetto(ran))
    chased = [(begin, end) for own in chasing(ran) for begin, end, _ in own]
    assert sorted((begin, end) for name, begin, end in found.waits if name == "active") == sorted(chased)
    flown = [(f"{each.src} to {each.dst}", each.left, each.until) for each in passages(ran)]
    assert sorted(each for each in found.waits if " to " in each[0]) == sorted(flown)
    assert len(found.counters) == 1
    assert all(tid in found.thread_names for tid in found.threads)


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
def test_what_perfetto_would_drop_is_found(harm):
    document = json.loads(perfetto(history()))
    harm(next(event for event in document["traceEvents"] if event["ph"] == "i" and event["tid"] == 3))
    with pytest.raises((AssertionError, KeyError)):
        Imported(json.dumps(document))


@given(t=st.integers(0, 100 * 86_400 * 10**9))
def test_a_time_is_the_same_nanosecond_where_it_is_read(t):
    assert Imported._ns(json.loads(json.dumps(_microseconds(t)))) == t


def test_ids_are_unique_among_messages_and_among_faults(events):
    begun = Counter((event["cat"], event["id"]) for event in events if event["ph"] == "b")
    assert max(begun.values()) == 1


def test_every_message_is_there_with_its_fate(ran, events):
    numbers = summary(ran)
    fates = Counter(event["args"]["fate"] for event in events if event["ph"] == "e" and event["cat"] == "message")
    assert sum(fates.values()) == numbers.messages_sent
    assert fates["arrived"] + fates["in flight"] == numbers.messages_sent - numbers.messages_lost
    lost = {fate.removeprefix("lost: "): number for fate, number in fates.items() if fate.startswith("lost: ")}
    assert lost == numbers.messages_lost_by


def test_each_link_is_a_track_of_its_receiver(ran, events):
    names = {event["pid"]: event["args"]["name"] for event in events if event["name"] == "process_name"}
    for event in events:
        if event.get("cat") == "message":
            src, dst = event["name"].split(" to ")
            assert names[event["pid"]] == f"messages to {dst}"
            assert src != dst


def test_every_thread_has_a_name_and_belongs_to_one_process(events):
    """Perfetto knows a thread by its tid alone."""
    named = {event["tid"] for event in events if event["name"] in {"thread_name", "process_name"}}
    processes = defaultdict(set)
    for event in events:
        processes[event["tid"]].add(event["pid"])
    assert set(processes) == named
    assert all(len(pids) == 1 for pids in processes.values())


def test_the_slices_of_a_pursuer_do_not_overlap_and_last_as_long_as_the_active_time(ran, events):
    slices = defaultdict(list)
    for event in events:
        if event["ph"] == "X":
            slices[event["tid"]].append((event["ts"], event["ts"] + event["dur"]))
    for own in slices.values():
        assert all(end <= begin + 1e-6 for (_, end), (begin, _) in itertools.pairwise(own))
    total = sum(end - begin for own in slices.values() for begin, end in own)
    assert total / 1e6 == pytest.approx(summary(ran).active_time, abs=1e-6)


def test_the_counter_ends_at_the_number_of_those_active_last(events, ran):
    last = [event["args"]["number"] for event in events if event["ph"] == "C"][-1]
    end = ran.trace.events[-1].t / 1000
    still = [event for event in events if event["ph"] == "X" and event["ts"] + event["dur"] == pytest.approx(end)]
    assert last == len(still)


def test_a_run_by_hand_reads_line_by_line():
    """Times in microseconds; pursuer i is thread 2 + i of process 1, its receptions are process 2 + i."""
    found = [
        (each["ph"], each["pid"], each["tid"], each["ts"], each["name"], each.get("id"))
        for each in trace_events(history())
        if each["ph"] != "M"
    ]
    assert found == [
        ("X", 1, 2, 0, "active", None),
        ("X", 1, 3, 0, "active", None),
        ("C", 1, 1, 0, "active pursuers", None),
        ("b", 3, 6, 100_000, "0 to 1", "0.1"),
        ("b", 4, 7, 100_000, "0 to 2", "0.2"),
        ("e", 4, 7, 100_000, "0 to 2", "0.2"),
        ("i", 1, 3, 150_000, "stops", None),
        ("i", 1, 1, 150_000, "0 takes over", None),
        ("C", 1, 1, 150_000, "active pursuers", None),
        ("i", 1, 3, 160_000, "decides as before", None),
        ("e", 3, 6, 200_000, "0 to 1", "0.1"),
        ("b", 2, 5, 300_000, "2 to 0", "1.0"),
        ("b", 1, 1, 400_000, "robot of 0 down", "fault 0"),
        ("C", 1, 1, 400_000, "active pursuers", None),
        ("e", 2, 5, 500_000, "2 to 0", "1.0"),
        ("e", 1, 1, 600_000, "robot of 0 down", "fault 0"),
        ("b", 1, 1, 700_000, "jamming", "fault 1"),
        ("b", 2, 5, 750_000, "1 to 0", "2.0"),
        ("e", 2, 5, 750_000, "1 to 0", "2.0"),
        ("b", 4, 7, 750_000, "1 to 2", "2.2"),
        ("e", 4, 7, 750_000, "1 to 2", "2.2"),
        ("X", 1, 4, 800_000, "active", None),
        ("i", 1, 4, 800_000, "starts", None),
        ("i", 1, 1, 800_000, "2 takes over", None),
        ("C", 1, 1, 800_000, "active pursuers", None),
        ("b", 2, 5, 900_000, "1 to 0", "3.0"),
        ("b", 4, 7, 900_000, "1 to 2", "3.2"),
        ("e", 1, 1, 1_000_000, "jamming", "fault 1"),
        ("i", 1, 1, 1_000_000, "captured", None),
        ("b", 3, 6, 1_000_000.001, "0 to 1", "4.1"),
        ("e", 3, 6, 1_000_000.001, "0 to 1", "4.1"),
        ("e", 2, 5, 1_200_000, "1 to 0", "3.0"),
        ("e", 4, 7, 1_200_000, "1 to 2", "3.2"),
    ]


def test_of_two_evaders_it_is_told_who_chases_which_and_how_many_do():
    Imported(perfetto(pair()))
    found = [each for each in trace_events(pair()) if each["ph"] != "M" and each.get("cat") != "message"]
    chases = [(each["tid"] - 2, each["ts"], each["dur"], each["name"]) for each in found if each["ph"] == "X"]
    assert chases == [
        (0, 0, 400_000, "chases 1"),
        (1, 0, 150_000, "chases 1"),
        (2, 0, 300_000, "chases 2"),
        (1, 150_000, 550_000, "chases 2"),
        (0, 400_000, 600_000, "chases 2"),
    ]
    numbers = defaultdict(list)
    for each in found:
        if each["ph"] == "C":
            numbers[each["name"]].append((each["ts"] // 1000, each["args"]["number"]))
    assert dict(numbers) == {
        "active pursuers": [(0, 3), (150, 3), (300, 2), (400, 1), (400, 2), (700, 1), (1000, 0)],
        "pursuers on 1": [(0, 2), (150, 1), (400, 0)],
        "pursuers on 2": [(0, 1), (150, 2), (300, 1), (400, 2), (700, 1), (1000, 0)],
    }
    told = [(each["ts"] // 1000, each["name"]) for each in found if each["ph"] == "i"]
    assert told == [
        (0, "2 takes 2 over"),
        (150, "turns to 2"),
        (150, "0 takes 1 over"),
        (200, "decides as before"),
        (300, "stops"),
        (300, "1 takes 2 over"),
        (400, "turns to 2"),
        (400, "evader 1 captured"),
        (700, "stops"),
        (700, "0 takes 2 over"),
        (1000, "evader 2 captured"),
        (1000, "captured"),
    ]


def test_what_a_message_says_how_long_it_waited_and_what_became_of_it_is_told():
    just = Sent(950 * MS, 5, 1, 2, 1000 * MS, 950 * MS, 24, INACTIVE)  # it arrives as the run ends
    entries = json.loads(perfetto(history(just)))["traceEvents"]
    found = {(each["ph"], each.get("id")): each.get("args") for each in entries}
    assert found["b", "1.0"] == {"bytes": 32, "says": ["token", "Infinity"], "waited (s)": 0.05}
    assert found["b", "0.1"] == {"bytes": 24, "says": {"active": True}}
    assert found["e", "1.0"] == {"fate": "lost: crash"}
    assert found["e", "3.0"] == {"fate": "in flight"}
    assert found["e", "5.2"] == {"fate": "arrived"}
    assert found["b", "fault 1"]["fault"]["radius"] == 3.0


def test_a_nanosecond_is_not_lost():
    from desim.pursuit.events import Decided

    odd = Decided(123 * MS + 457, 2, False)
    assert next(each["ts"] for each in trace_events(history(odd)) if each["name"] == "decides as before") == 123_000.457


def test_where_nobody_sends_a_message_there_are_no_processes_for_them():
    scenario = Scenario(protocol=Centralised(), horizon=0.1, record=Recording(messages=True))
    assert {entry["pid"] for entry in trace_events(run(scenario))} == {PURSUERS}


def test_without_recorded_messages_the_pursuers_remain():
    found = trace_events(history(messages=False))
    check(found)
    assert {each["pid"] for each in found} == {1}
    assert [each["ts"] for each in found if each["ph"] == "X"] == [0, 0, 800_000]


def test_the_file_is_the_same_bytes_every_time_and_without_a_date(tmp_path):
    write(history(), tmp_path / "one.json")
    write(history(), tmp_path / "two.json")
    text = (tmp_path / "one.json").read_text()
    assert text == (tmp_path / "two.json").read_text() == perfetto(history())
    assert json.loads(text)["otherData"] == {"scenario": "by hand", "seed": 3}

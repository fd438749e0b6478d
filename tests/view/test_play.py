"""`desim play`: what a change shows, what the server refuses, and the page in a browser."""

import http.client
import json
import math
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
import tomllib
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from importlib.resources import files
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace
from typing import ClassVar
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

import pytest
from scipy import stats

from desim import Scenario, Team, load, run, summary
from desim.analysis.metrics import Summary
from desim.analysis.statistics import paired
from desim.scenario.checks import warnings
from desim.scenario.overrides import Source
from desim.scenario.toml import read_source, validate
from desim.simulation.watchdog import TimedOut
from desim.study.workers.batch import seeds_from
from desim.study.workers.workers import InProcess, Processes
from desim.view.pages import play_server
from desim.view.pages import playground as play
from desim.view.pages.metric_rows import differences_over_seeds
from desim.view.pages.play_server import PlayServer, _Handler, _or_error
from desim.view.pages.playground import Playground, _new_folder
from desim.view.pages.session import Session
from scenarios.studies.study import SCENARIOS
from tests.command import accepted, refused
from tests.view.browser import Page, in_chromium
from tests.view.by_hand import history

RELAY = SCENARIOS / "relay.toml"
SMALL = ("team.count=6", "horizon=1.0")
SET_SMALL = [word for each in SMALL for word in ("--set", each)]


LATE = [*SMALL, "network.latency.value=0.3"]


@pytest.fixture(scope="module")
def small():
    return Playground(read_source(RELAY), RELAY, SMALL)


@pytest.fixture(scope="module")
def answer(small):
    return small.answer(LATE, SMALL)


def test_an_answer_has_the_metrics_of_the_run_and_their_differences(answer):
    now, pinned = (
        summary(run(load(RELAY, [*SMALL, f"network.latency.value={latency}", "record.trajectory=0.05"])))
        for latency in (0.3, 0.02)
    )
    shown = {row["name"]: row for row in answer["metrics"]}
    assert now.active_time != pinned.active_time
    assert shown["active time"] | {"sign": None} == {
        "name": "active time",
        "unit": "s",
        "more_is": "worse",
        "first": True,
        "value": f"{now.active_time:.3f}",
        "difference": f"{now.active_time - pinned.active_time:+.3f}",
        "sign": None,
    }
    assert shown["active time"]["sign"] == pytest.approx(now.active_time - pinned.active_time)
    assert answer["seeds"] == [3, 3]
    assert "<!doctype html>" in answer["page"]


def test_an_answer_is_json(answer):
    assert json.loads(json.dumps(answer, allow_nan=False)) == answer


def keys_in(document):
    """Yield the keys of the tables in a JSON document, but those that are keys of a scenario."""
    if isinstance(document, dict):
        yield from (key for key in document if "." not in key)
        document = document.values()
    if isinstance(document, (list, type({}.values()))):
        for part in document:
            yield from keys_in(part)


@pytest.mark.slow
def test_the_page_reads_each_key_of_an_answer_and_no_other(small, answer, monkeypatch):
    """Answers to a right change, a wrong one and one that fails, to a comparison, and to a run that is saved."""
    monkeypatch.setattr(play.run_folder, "write", lambda *_: None)
    wrong = small.answer([*SMALL, "team.count=x"], None)
    session = Session(small, InProcess())
    compared = list(session.compare(SMALL, ["seed=4", *SMALL], 1))
    shown = [answer | {"page": ""}, wrong, *compared, session.save(SMALL), {"error": "", "errors": {}}]
    script = (files("desim.view.pages") / "play.js").read_text(encoding="utf-8")
    read = set(re.findall(r"\w+", script))
    of_answers = {key for key in {*keys_in(shown)} - {*small.values} if key.isidentifier()}
    assert of_answers - read == set()
    assert {"controls", "texts", "page", "metrics", "seeds", "warnings", "errors", "folder", "error"} <= of_answers
    asked = set(re.findall(r"\banswer\.(\w+)", script))
    assert asked - of_answers == set()


def test_a_run_of_a_pair_that_takes_too_long_says_so(small, monkeypatch):
    def late(*_):
        raise TimedOut("is not over after 1 s")

    monkeypatch.setattr(play, "run", late)
    assert small.pair(SMALL, SMALL, 3) == "The run is not over after 1 s"


def test_each_worker_is_warmed_up_by_a_run_of_the_start():
    calls = []
    ground = SimpleNamespace(start=("seed=3",), answer=lambda *given: calls.append(given))
    workers = InProcess()
    workers.count = 3
    Session(ground, workers).warm_up()
    assert calls == [(("seed=3",), None)] * 3


def test_a_call_that_cannot_be_submitted_to_workers_that_live_is_an_error(small, monkeypatch):
    def submit(*_):
        raise ValueError("no way")

    monkeypatch.setattr(InProcess, "submit", submit)
    assert Session(small, InProcess()).save(SMALL) == {"error": "ValueError: no way"}
    told = Session(small, InProcess()).run(SMALL, None)
    assert (told["errors"], len(told["controls"]) > 9) == ({"": "ValueError: no way"}, True)


def test_an_answer_has_all_parts_of_a_page(answer):
    assert [*answer] == ["controls", "texts", "page", "metrics", "seeds", "warnings"]
    assert answer["warnings"] == [f"{key}: {why}" for key, why in warnings(load(RELAY, LATE))]


def test_a_run_that_is_its_own_reference_has_no_ghost_and_no_differences(small):
    found = small.answer(SMALL, SMALL)
    assert not any("difference" in row for row in found["metrics"])
    assert '"ghost": null' in found["page"].replace('"ghost":null', '"ghost": null')


@pytest.mark.parametrize(
    ("change", "key", "why"),
    [
        ("network.loss.p=2", "network.loss.p", "less than or equal to 1"),
        ("network.medium.kind=bitrate", "network.medium.bitrate", "is missing"),
        ("network.medium.kind=bitrat", "network.medium.kind", "bitrate"),
        ("team.cout=3", "team.cout", "did you mean"),
        ("team.count=[", "team.count", "is not a TOML value"),
        ("team.count.x=3", "team.count.x", "is not a key of a table"),
        ("protocol.kind=some.module:Rule", "protocol.kind", "--allow-import"),
        ("nonsense", "nonsense", "KEY=VALUE"),
    ],
)
def test_a_wrong_value_is_reported_at_its_key_and_the_controls_stay(small, change, key, why):
    found = small.answer([*SMALL, change], SMALL)
    assert why in found["errors"][key]
    assert "page" not in found
    assert any(each["key"] == "team.count" for each in found["controls"])


NUMBERS = ("network.latency.value", "network.loss.p", "network.range", "team.count", "announce.heartbeat", "seed")


@pytest.mark.parametrize(
    ("typed", "why"),
    [
        ("0,5", "(got 0,5)"),
        ("", "is empty: type a value, or undo the change"),
        ("abc", "(got 'abc')"),
        ("[1, 2]", "(got [1, 2])"),
    ],
)
@pytest.mark.parametrize("key", NUMBERS)
def test_what_is_typed_instead_of_a_number_is_told_without_the_help_of_the_key(small, key, typed, why):
    found = small.answer([*SMALL, f"{key}={typed}"], SMALL)
    (control,) = (each for each in found["controls"] if each["key"] == key)
    assert why in found["errors"][key]
    assert control["help"].rstrip(".") not in found["errors"][key]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ("network.range=0,5", "should be a number with a decimal point: 0.5 (got 0,5)"),
        ("team.count=1,000", "should be an integer without a comma (got 1,000)"),
        ("evader.position=1,5", "should be a list (got '1,5')"),
    ],
)
def test_a_comma_is_a_mistake_of_its_own_for_each_form(small, change, why):
    assert small.answer([*SMALL, change], None)["errors"] == {change.partition("=")[0]: why}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # raised where Python drops exceptions
def test_a_run_that_takes_too_long_is_ended_and_says_where_it_was():
    """The evader is faster than all pursuers, so the run would last to its horizon, which takes a minute."""
    endless = ["team.count=60", "evader.speed=5.0", "horizon=1000.0"]
    assert "errors" not in Playground(read_source(RELAY), RELAY).answer(
        [*endless, "horizon=0.1"], None
    )  # all is imported now
    found = Playground(read_source(RELAY), RELAY, timeout=1.0).answer(endless, None)
    assert found["errors"][""].startswith("The run took longer than 1 s: at ")
    assert "pursuer 0: " in found["errors"][""]
    assert "--set team.count=60" in found["texts"]["command"]


OWN_METRICS = """
from desim.analysis.metrics import Metric

def endless(result):
    return float("inf")

def _first(result):
    return float(result.seed)

gain = Metric(_first, "s", more_is="better")
"""


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """Return a playground whose scenario names metrics of a user."""
    (tmp_path / "metrics_of_play.py").write_text(OWN_METRICS)
    monkeypatch.syspath_prepend(tmp_path)
    file = tmp_path / "measured.toml"
    own = '["metrics_of_play:endless", "metrics_of_play:gain"]'
    file.write_text(f"team.count = 2\nhorizon = 0.2\nrecord.metrics = {own}\n")
    return Playground(read_source(file, allow_import=True), file)


@pytest.mark.slow
def test_a_metric_that_is_infinite_in_both_runs_does_not_differ(measured):
    found = measured.answer(["evader.speed=0.3"], [])
    (shown,) = (row for row in found["metrics"] if row["name"] == "endless")
    assert shown["value"] == "inf"
    assert "difference" not in shown


@pytest.mark.slow
def test_a_users_metric_says_whether_more_of_it_is_better(measured):
    found = measured.answer(["seed=1"], [])
    (shown,) = (row for row in found["metrics"] if row["name"] == "gain")
    assert (shown["more_is"], shown["difference"]) == ("better", "+1")
    one = ['record.metrics=["metrics_of_play:gain"]']
    *_, last = Session(measured, InProcess()).compare([*one, "evader.speed=0.3"], one, 2)
    assert {row["name"]: row["more_is"] for row in last["metrics"]}["gain"] == "better"


def test_an_exception_of_a_users_rule_is_shown_with_its_last_calls(tmp_path):
    (tmp_path / "rule_that_fails.py").write_text(
        "def rule(me):\n    yield me.sleep(0.1)\n    raise ValueError('mine')\n"
    )
    (tmp_path / "fails.toml").write_text('protocol.kind = "rule_that_fails:rule"\n')
    file = tmp_path / "fails.toml"
    found = Playground(read_source(file, allow_import=True), file).answer([], None)
    assert "ValueError: mine" in found["errors"][""]
    assert "rule_that_fails.py" in found["errors"][""]


def test_the_texts_make_the_same_scenario_again(small, answer, tmp_path):
    changes = [*SMALL, "network.latency.value=0.3"]
    own = load(RELAY, changes)
    (tmp_path / "copy.toml").write_text(answer["texts"]["toml"])
    assert load(tmp_path / "copy.toml") == own.model_copy(update={"sweep": type(own.sweep)()})
    assert answer["texts"]["command"] == (
        f"desim run {RELAY} --set team.count=6 --set horizon=1.0 --set network.latency.value=0.3"
    )
    made = {}
    exec(answer["texts"]["python"], made)
    assert made["result"].scenario == own


@pytest.mark.slow
def test_a_scenario_made_in_python_can_be_played_with(tmp_path):
    scenario = Scenario(team=Team(count=4, speeds=1.2), horizon=1.0)
    ground = Playground(Source.of(scenario), None)
    found = ground.answer(["team.count=5"], [])
    assert "errors" not in found
    (tmp_path / "copy.toml").write_text(found["texts"]["toml"])
    assert load(tmp_path / "copy.toml").team.count == 5
    assert tomllib.loads(found["texts"]["toml"])["team"] == {"count": 5, "speeds": 1.2}


def _count(result):
    return 1.0


def _rule(me):
    yield me.sleep(1.0)


@pytest.mark.parametrize(
    "keys",
    [{"properties": ["idle at most 2 in total"]}, {"record.metrics": [_count]}, {"protocol": _rule}],
    ids=lambda keys: next(iter(keys)),
)
def test_any_scenario_made_in_python_has_its_texts(keys):
    scenario = Scenario().with_(keys)
    text = Playground(Source.of(scenario), None).texts([])["toml"]
    assert validate(Source("", tomllib.loads(text), Scenario, allow_import=True)) == scenario


@pytest.mark.whole
def test_a_saved_run_is_repeated_byte_for_byte(small, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    session = Session(small, InProcess())
    assert [session.save(SMALL) for _ in range(2)] == [{"folder": "out/relay-1"}, {"folder": "out/relay-2"}]
    accepted("run", "--from", "out/relay-1/run.json", "-o", "again")
    for name in ("trace.jsonl", "summary.json", "scenario.toml"):
        assert (tmp_path / "out/relay-1" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_runs_are_saved_below_out_and_numbered(small, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written = []
    monkeypatch.setattr(play.run_folder, "write", lambda *told: written.append(told))
    monkeypatch.setattr(Playground, "result", lambda *_: history(name="a b"))
    answers = [small.save((), {"what": "run"}) for _ in range(2)]
    folders = [Path("out/a-b-1"), Path("out/a-b-2")]
    assert answers == [{"folder": str(folder)} for folder in folders]
    assert [(folder, made) for _, folder, made in written] == [(folder, {"what": "run"}) for folder in folders]
    assert all(folder.is_dir() for folder in folders)


def test_a_run_that_fails_leaves_no_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    session = Session(Playground(read_source(RELAY), RELAY), InProcess())
    monkeypatch.setattr(Playground, "result", lambda *_: 1 // 0)
    assert session.save(SMALL)["error"].endswith("ZeroDivisionError: integer division or modulo by zero")
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    assert "team.count" in session.save(["team.count=0"])["error"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("call", ["submit", "result"])
def test_workers_that_died_are_replaced(small, call, monkeypatch):
    """A call that finds them dead is made again; one that they died of has an error, and the next one a result."""

    class Dead(InProcess):
        renewed = 0

        def died(self, error):
            return isinstance(error, OSError)

        def renew(self):
            self.renewed += 1

    def act(self, given):
        if not self.renewed:
            raise OSError("they died")
        return getattr(InProcess, call)(self, given)

    monkeypatch.setattr(Dead, call, act, raising=False)
    monkeypatch.setattr(Playground, "save", lambda *_: {"folder": "out"})
    workers = Dead()
    session = Session(small, workers)
    first = session.save(SMALL)
    assert first == ({"folder": "out"} if call == "submit" else {"error": "OSError: they died"})
    assert workers.renewed == 1
    assert session.save(SMALL) == {"folder": "out"}


@pytest.mark.slow
def test_paired_runs_are_those_of_both_scenarios_with_equal_seeds(small):
    changes = [*SMALL, "network.latency.value=0.3"]
    *earlier, last = Session(small, InProcess()).compare(changes, SMALL, 4)
    assert [each["done"] for each in (*earlier, last)] == [1, 2, 3, 4]
    values = [
        [summary(run(small.scenario(each), seed)).active_time for seed in seeds_from(3, 4)] for each in (changes, SMALL)
    ]
    found = paired(*values)
    assert not any(row["differs"] for answer in earlier for row in answer["metrics"])
    shown = {row["name"]: row for row in last["metrics"]}["active time"]
    assert shown["difference"] == f"{found.mean:+.3f} +- {found.half_width:.3f}"
    assert shown["differs"] == (abs(found.mean) > found.half_width_at(1.0 - 0.05 / 8))
    assert shown["count"] == 4
    assert not math.isnan(found.half_width)


def test_a_comparison_that_is_closed_begins_no_more_runs(small, monkeypatch):
    begun = []
    monkeypatch.setattr(Playground, "pair", lambda self, now, pinned, seed: begun.append(seed) or "no result")
    session = Session(small, InProcess())
    for end in ("close", "cancel", "another"):
        found = session.compare(SMALL, SMALL, 30)
        assert next(found)["failed"] == 1
        if end == "close":
            found.close()
        elif end == "cancel":
            session.cancel()
        else:
            next(session.compare(SMALL, SMALL, 30))
        assert list(found) == []
    assert begun == [3_000_000] * 4


def test_a_comparison_that_is_closed_cancels_the_runs_that_have_not_begun(small):
    class Waiting(InProcess):
        def __init__(self):
            self.count, self.futures = 3, []

        def submit(self, call):
            self.futures.append(Future())
            return self.futures[-1]

        def done(self, pending):
            self.futures[0].set_exception(ValueError("no result"))
            return [self.futures[0]]

    workers = Waiting()
    comparison = Session(small, workers).compare(SMALL, SMALL, 30)
    assert next(comparison)["failed"] == 1
    comparison.close()
    assert [future.cancelled() for future in workers.futures] == [False, True, True]


def test_differences_are_of_the_pairs_in_which_both_have_a_value():
    pairs = [
        ({"active_time": a}, {"active_time": b}) for a, b in [(10.0, 8.0), (None, 100.0), (30.0, None), (20.0, 16.0)]
    ]
    summaries = [(Summary(now), Summary(pinned)) for now, pinned in pairs]
    (row,) = differences_over_seeds(summaries, [], 4, {})["metrics"]
    assert (row["now"], row["pinned"], row["count"]) == ("15", "12", 2)
    assert row["difference"].startswith("+3.000 +- ")


@pytest.mark.parametrize("gap", [0.0, 1.0, 1.3])
def test_a_metric_differs_over_all_seeds_and_for_all_metrics_together(gap):
    """A gap of 1.0: a t test of it alone has p = 0.017, less than 5 % and more than an eighth of them."""
    noise = [0.6, -1.4, 0.9, -0.3, 1.2, -0.8, 0.4, -0.6]
    pairs = [(Summary({"active_time": 5.0 + gap + x}), Summary({"active_time": 5.0})) for x in noise]
    p = stats.ttest_1samp([gap + x for x in noise], 0.0).pvalue
    assert (p < 0.05, p < 0.05 / 8) == {0.0: (False, False), 1.0: (True, False), 1.3: (True, True)}[gap]
    (row,) = differences_over_seeds(pairs, [], 8, {})["metrics"]
    assert row["differs"] == (p < 0.05 / 8)
    (row,) = differences_over_seeds(pairs, [], 9, {})["metrics"]
    assert not row["differs"]


@pytest.mark.whole
def test_a_worker_that_died_is_replaced(small):
    """It dies in one run and, at the same time, in a comparison."""
    workers = Processes(1, kept=True)
    session = Session(small, workers)
    try:
        assert "page" in session.run(SMALL, None)
        dying = Session(Playground(small.base, small.file), workers)
        workers.submit(partial(os._exit, 1))
        time.sleep(0.5)
        answers = [dying.run(SMALL, None) for _ in range(2)]
        assert "page" in answers[-1]
        workers.submit(partial(os._exit, 1))
        time.sleep(0.5)
        assert list(session.compare(SMALL, SMALL, 2))[-1]["done"] == 2
    finally:
        workers.stop()


def test_a_comparison_goes_on_while_another_page_compares_or_cancels(small, monkeypatch):
    monkeypatch.setattr(Playground, "pair", lambda self, now, pinned, seed: "no result")
    session = Session(small, InProcess())
    first = session.compare(SMALL, SMALL, 3, "first")
    assert next(first)["done"] == 1
    assert list(session.compare(SMALL, SMALL, 1, "second"))[-1]["done"] == 1
    session.cancel("second")
    assert [each["done"] for each in first] == [2, 3]


@pytest.mark.parametrize(("pages", "cancelled"), [(("one", "one"), True), (("one", "another"), False)])
def test_an_earlier_request_of_a_page_that_has_not_begun_is_cancelled(small, pages, cancelled):
    class Slow(InProcess):
        def submit(self, call):
            self.futures.append(Future())
            return self.futures[-1]

        futures: ClassVar = []

    Slow.futures = []
    session = Session(small, Slow())
    answers = []
    run_of = lambda page: answers.append(session.run(SMALL, None, page))  # noqa: E731
    threads = [Thread(target=run_of, args=(page,), daemon=True) for page in pages]
    for k, each in enumerate(threads, start=1):
        each.start()
        while len(Slow.futures) < k:
            time.sleep(0.01)
    assert [each.cancelled() for each in Slow.futures] == [cancelled, False]
    for each in Slow.futures:
        if not each.cancelled():
            each.set_result({})
    for thread in threads:
        thread.join(30)
    assert ({"": "a later change came first"} in [answer.get("errors") for answer in answers]) == cancelled
    assert not session._last


def test_a_run_is_saved_with_its_changes_and_its_provenance(small, monkeypatch):
    monkeypatch.setattr(Playground, "save", lambda _, changes, made: {"folder": f"{list(changes)} {made['what']}"})
    assert Session(small, InProcess()).save(SMALL) == {"folder": f"{list(SMALL)} run"}


# The server.


def test_the_server_waits_for_another_page_only_after_the_last_one_was_closed(small):
    with PlayServer(Session(small, InProcess())) as server:
        for change, is_waiting in (("opened", 0), ("opened", 0), ("closed", 0), ("closed", 1), ("opened", 0)):
            getattr(server, f"page_{change}")()
            assert math.isfinite(server._closed_at) == is_waiting


def handler(**parts):
    """Return a handler of requests without a connection, with these parts."""
    made = object.__new__(_Handler)
    vars(made).update(parts)
    return made


def test_an_open_page_gets_signs_of_life_until_its_connection_ends(monkeypatch):
    monkeypatch.setattr(play_server, "BEAT", 0.0)
    told = []

    def write(line):
        told.append(line)
        if len(told) == 3:
            raise BrokenPipeError

    page = SimpleNamespace(page_opened=lambda: told.clear(), page_closed=lambda: told.append("closed"))
    handler(server=page, wfile=SimpleNamespace(write=write), _begin=told.append)._alive()
    assert told == ["text/event-stream", b":\n\n", b":\n\n", "closed"]


def test_each_address_that_the_page_asks_has_its_answer():
    routes, arrived = {}, []
    page = SimpleNamespace(arrived=arrived.append)
    asked_page = handler(server=page, connection="socket", _answer=routes.update)
    asked_page.do_GET()
    asked_page.do_POST()
    assert {name: method.__name__ for name, method in routes.items()} == {
        **{"": "_page", "life.js": "_life", "alive": "_alive"},
        **{name: f"_{name}" for name in ("run", "seeds", "more", "save", "cancel")},
    }
    assert arrived == ["socket"]


def test_an_exception_in_a_comparison_is_its_last_answer():
    def answers():
        yield {"done": 1}
        raise KeyError("x")

    assert list(_or_error(answers())) == [{"done": 1}, {"error": "KeyError: 'x'"}]


@pytest.mark.parametrize("request_of", ["_run", "_seeds", "_more", "_save", "_cancel"])
def test_after_a_request_of_another_form_nothing_is_asked_of_the_session(request_of):
    assert getattr(handler(_body=lambda: None), request_of)() is None


@pytest.fixture
def server(small):
    """Yield a server in this process, which performs runs in this process, too."""
    with PlayServer(Session(small, InProcess())) as made:
        thread = Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def asked(server, method, name, body=None, **headers):
    """Return the status, the headers and the text of the answer to a request."""
    parts = urlsplit(server.address)
    with closing(http.client.HTTPConnection(parts.hostname, parts.port, timeout=30)) as connection:
        connection.putrequest(method, name, skip_host=True)
        content = b"" if body is None else json.dumps(body).encode()
        given = {"Host": parts.netloc, "Content-Length": len(content)} | headers
        for key, value in given.items():
            connection.putheader(key.replace("_", "-"), str(value))
        connection.endheaders(content)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read().decode()


def test_the_page_is_served_at_its_secret_address_only(server):
    path = urlsplit(server.address).path
    status, headers, text = asked(server, "GET", path)
    assert status == 200
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-store"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert "relay" in text
    assert server.socket.getsockname()[0] == "127.0.0.1"
    for wrong in ("/", "/none/", f"{path[:-2]}/", f"{path}none", "/../../etc/passwd"):
        assert asked(server, "GET", wrong)[0] == 404, wrong


def test_other_hosts_and_other_origins_are_refused(server):
    """DNS rebinding gives a foreign host; a page of another site gives its origin, and some requests give none."""
    path, body = urlsplit(server.address).path, {"now": [], "pinned": None}
    own = server.address.removesuffix(path)
    assert asked(server, "POST", f"{path}run", body, Origin=own)[0] == 200
    assert asked(server, "GET", path, Host="evil.example")[0] == 403
    assert asked(server, "GET", path, Host=f"evil.example:{server.server_port}")[0] == 403
    assert asked(server, "GET", f"{path}alive", Origin="http://evil.example")[0] == 403
    for origin in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {}):
        assert asked(server, "POST", f"{path}run", body, **origin)[0] == 403
    assert asked(server, "POST", f"/wrong{path}run", body, Origin=own)[0] == 404


@pytest.mark.parametrize(
    "body",
    [
        None,
        [],
        {},
        {"now": "a"},
        {"now": [1]},
        {"now": [], "pinned": 3},
        {"now": [], "pinned": None},
        {"now": [], "page": 3},
        {"now": [], "count": 10**6},
        {"now": ["x" * 10**6]},
    ],
)
def test_a_request_of_another_form_is_refused(server, body):
    path = urlsplit(server.address).path
    own = server.address.removesuffix(path)
    assert asked(server, "POST", f"{path}seeds", body, Origin=own)[0] == 400


@pytest.mark.parametrize("length", ["", "x", "-1", "1e3", "0x10", "\u00b2", "1000000000", "9" * 40])
def test_a_request_of_a_length_that_no_request_has_is_refused_before_its_body_comes(server, length):
    path = urlsplit(server.address).path
    own = server.address.removesuffix(path)
    assert asked(server, "POST", f"{path}seeds", Origin=own, **{"Content-Length": length})[0] == 400


def test_each_request_is_answered_by_the_session(server, monkeypatch):
    """The answer of the session is that of the server; a comparison has as many answers as the page asks for."""
    path = urlsplit(server.address).path
    ask = partial(asked, server, "POST", Origin=server.address.removesuffix(path))
    said = []

    def answering(name, answer):
        return lambda *words: said.append((name, *words)) or answer

    for name, answer in {
        "run": {"run": 1},
        "compare": iter([{"done": 1}, {"done": 2}]),
        "save": {"folder": "here"},
        "cancel": None,
    }.items():
        monkeypatch.setattr(server.session, name, answering(name, answer))
    body = {"now": ["a=1"], "pinned": ["b=2"], "count": 3, "page": "p"}
    answers = [json.loads(ask(path + name, body)[2]) for name in ("run", "seeds", "more", "more", "save", "cancel")]
    assert answers == [{"run": 1}, {"done": 1}, {"done": 2}, {}, {"folder": "here"}, {}]
    now, pinned = ["a=1"], ["b=2"]
    assert said == [("run", now, pinned, "p"), ("compare", now, pinned, 3, "p"), ("save", now), ("cancel", "p")]
    status, headers, text = asked(server, "GET", f"{path}life.js")
    assert (status, headers["Content-Type"]) == (200, "text/javascript; charset=utf-8")
    assert "alive" in text


def test_a_folder_is_numbered_by_those_that_exist(tmp_path):
    made = [_new_folder(tmp_path / "out", name).name for name in ("a", "a", "b", "a")]
    assert made == ["a-1", "a-2", "b-1", "a-3"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(made)


@pytest.mark.slow
def test_a_comparison_arrives_pair_by_pair(server):
    path = urlsplit(server.address).path
    ask = partial(asked, server, "POST", Origin=server.address.removesuffix(path))
    body = {"now": [*SMALL, "network.latency.value=0.3"], "pinned": list(SMALL), "count": 2, "page": "a"}
    answers = [json.loads(ask(path + name, body)[2]) for name in ("seeds", "more", "more", "more")]
    assert [answer.get("done") for answer in answers] == [1, 2, None, None]
    assert "team.count" in json.loads(ask(f"{path}seeds", body | {"now": ["team.count=0"]})[2])["error"]


def test_requests_at_the_same_time_get_different_answers_of_a_comparison(server):
    """Two changes in a row begin two comparisons, and both requests may ask for the first answer of the second one."""
    release = Event()

    def answers():
        for done in range(1, 9):
            release.wait(10.0)
            yield {"done": done}

    server.begin_comparison("a", answers())
    with ThreadPoolExecutor(9) as pool:
        asked_for = [pool.submit(server.next_of_comparison, "a") for _ in range(9)]
        release.set()
    assert sorted(each.result().get("done", 0) for each in asked_for) == list(range(9))
    assert server.next_of_comparison("a") == {}


def test_many_connections_wait_until_they_are_accepted(small):
    """Those for which there is no room are tried again by the system a second later, or reset."""
    with PlayServer(Session(small, InProcess())) as idle, ExitStack() as connections:
        for _ in range(60):
            connections.enter_context(socket.create_connection(idle.server_address, timeout=0.9))


def test_comparisons_of_pages_that_were_closed_are_dropped(server, monkeypatch):
    monkeypatch.setattr(play_server, "MAX_COMPARISONS", 2)
    for page in ("a", "b", "b", "c"):
        server.begin_comparison(page, iter([{"done": page}]))
    assert [server.next_of_comparison(page) for page in ("a", "b", "c", "c")] == [{}, {"done": "b"}, {"done": "c"}, {}]


@pytest.mark.whole
def test_a_session_keeps_nothing_of_pages_that_are_answered(small):
    session = Session(small, InProcess())
    for page in range(2):
        session.run((f"seed={page}",), None, str(page))
        assert list(session.compare((), ("seed=1",), 1, str(page)))
        closed = session.compare((), ("seed=1",), 2, f"closed {page}")
        next(closed)
        closed.close()
    assert not session._last
    assert not session._comparisons
    assert play._result.cache_info().maxsize == play.KEPT


def test_a_request_that_takes_too_long_to_arrive_is_ended(small, monkeypatch):
    """A byte every 20 ms keeps a time-out of the socket alone from ending it."""
    monkeypatch.setattr(play_server, "PATIENCE", 0.1)
    with PlayServer(Session(small, InProcess())) as made:
        thread = Thread(target=made.serve_until_closed)
        thread.start()
        with socket.create_connection(made.server_address) as connection:
            begun = time.monotonic()
            while not select.select([connection], [], [], 0.02)[0]:  # readable: the server has closed it
                assert time.monotonic() < begun + 30.0
                with suppress(OSError):
                    connection.send(b"x")
        made.shutdown()
        made.page_opened()
        made.page_closed()
        thread.join(30)
        assert not thread.is_alive()
        assert not made._incoming


def test_a_connection_that_is_closed_is_no_longer_awaited(small, monkeypatch):
    closed = []
    monkeypatch.setattr(play_server.ThreadingHTTPServer, "shutdown_request", lambda _, request: closed.append(request))
    with PlayServer(Session(small, InProcess())) as made:
        made._incoming |= {"first": 1.0, "second": 2.0}
        made.shutdown_request("first")
        assert (closed, made._incoming) == (["first"], {"second": 2.0})


@pytest.mark.parametrize(("error", "is_told"), [(ConnectionResetError("gone"), False), (KeyError("rgb"), True)])
def test_an_error_in_a_request_is_told_unless_the_browser_has_closed_the_connection(small, capsys, error, is_told):
    with PlayServer(Session(small, InProcess())) as made:
        try:
            raise error
        except type(error):
            made.handle_error(None, ("127.0.0.1", 1))
    told = capsys.readouterr().err
    assert ("KeyError: 'rgb'" in told) == is_told
    assert ("from ('127.0.0.1', 1)" in told) == is_told


def test_a_wrong_file_is_refused_as_by_run(tmp_path):
    (tmp_path / "wrong.toml").write_text("team.count = 0\n")
    assert refused("play", tmp_path / "wrong.toml", "--no-browser").startswith(f"{tmp_path}/wrong.toml:1: team.count: ")
    assert "cannot be read" in refused("play", tmp_path / "none.toml", "--no-browser")


# The program and its page.


@contextmanager
def program(*options, cwd):
    """Yield the program and the address of its page."""
    command = [sys.executable, "-m", "desim", "play", *map(str, options), "--no-browser"]
    environment = os.environ | {
        "PYTHONUNBUFFERED": "1",
        "PYTHONPATH": str(Path(__file__).parents[2]),
        "TMPDIR": str(cwd),
    }
    process = subprocess.Popen(
        command, cwd=cwd, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


def children(process):
    """Return the processes that a process has started, directly or not, and that still run."""
    found, waiting = [], [process.pid]
    while waiting:
        each = waiting.pop()
        for task in Path(f"/proc/{each}/task").glob("*/children"):
            below = [int(pid) for pid in task.read_text().split()]
            found += below
            waiting += below
    return found


def are_gone(pids):
    until = time.monotonic() + 60.0
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        if time.monotonic() > until:
            return False
        time.sleep(0.05)
    return True


on_linux = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs /proc")


@pytest.mark.whole
@on_linux
def test_no_process_is_left_after_an_interrupt(tmp_path):
    """A page is open, and a comparison is under way."""
    with program(RELAY, *SET_SMALL, cwd=tmp_path) as (process, address), urlopen(f"{address}alive"):
        begun = children(process)
        assert begun
        body = {"now": ["network.latency.value=0.3"], "pinned": [], "count": 200}
        origin = address.removesuffix(urlsplit(address).path)
        request = Request(f"{address}seeds", json.dumps(body).encode(), {"Origin": origin})
        with urlopen(request) as answer:
            assert json.loads(answer.readline())["done"] == 1
            process.send_signal(signal.SIGINT)
        assert process.wait(60) == 128 + signal.SIGINT
        assert are_gone(begun)


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Yield the address of the page of a program that plays with a short run; between tests, no page is open."""
    folder = tmp_path_factory.mktemp("play")
    with program(RELAY, *SET_SMALL, cwd=folder) as (_, found), urlopen(f"{found}alive"):
        yield found


@pytest.fixture
def played(browser, address):
    """Return the page in the browser, after its first run; nothing left this machine, and nothing was logged."""
    browser.visit("about:blank")
    browser.visit(address)
    browser.until("window.play && play.runs === 1")
    yield browser
    assert browser.errors == []
    assert {urlsplit(each).netloc for each in browser.requests if not each.startswith(("data:", "about:"))} <= {
        urlsplit(address).netloc
    }


SLIDE = """(key, position) => {
  const slider = document.querySelector(`[data-key="${key}"] [type=range]`);
  slider.value = position;
  slider.dispatchEvent(new Event("input"));
  slider.dispatchEvent(new Event("change"));
}"""


@pytest.mark.slow
@in_chromium
def test_a_slider_that_is_released_shows_the_new_run_at_the_same_instant(played):
    played.value("play.replay.speed = 0.005")
    played.value("play.replay.seek(0.4)")
    played.value("play.replay.play()")
    played.value(f"({SLIDE})('network.latency.value', 600)")
    played.until("play.runs === 2")
    assert played.value("play.changes") == [*SMALL, "network.latency.value=1"]
    assert 0.4 <= played.value("play.replay.time") < 1.0
    assert played.value("play.replay.playing") is True
    assert played.value("""document.querySelector('[data-key="network.latency.value"] .number').value""") == "1"
    assert "seed 3 and so the same random numbers" in played.value("document.querySelector('.note').textContent")
    assert played.value("document.querySelectorAll('.numbers small').length") > 2


@in_chromium
@pytest.mark.whole
def test_the_pinned_run_stays_as_a_ghost(played):
    assert played.value("play.replay.ghost") is None
    played.value("play.change('network.latency.value', '0.7')")
    played.until("play.runs === 2")
    assert played.value("play.replay.ghost !== null")
    played.value("[...document.querySelectorAll('header button')].find(each => each.textContent === 'Pin').click()")
    played.until("play.runs === 3")
    assert played.value("play.pinned") == [*SMALL, "network.latency.value=0.7"]
    assert played.value("play.replay.ghost") is None


@in_chromium
@pytest.mark.whole
def test_a_bad_value_is_told_beside_its_control_and_the_picture_stays(played):
    before = played.value("document.querySelector('.numbers').textContent")
    played.value("play.change('network.loss.p', '2')")
    played.until("""document.querySelector('[data-key="network.loss.p"] .error').textContent.includes('equal to 1')""")
    assert played.value("document.querySelector('.numbers').textContent") == before
    assert played.value("play.replay.end > 0")
    assert played.value(
        """document.querySelector('[data-key="network.loss.p"] .number').getAttribute('aria-invalid')"""
    )
    played.value("play.change('network.loss.p', '0.1')")
    played.until("play.runs === 2")
    assert played.value("""document.querySelector('[data-key="network.loss.p"] .error').textContent""") == ""


WHY_NOT = "[...document.querySelectorAll('header button')].find(each => each.textContent === '30 seeds').reason"
"""Why the comparison cannot begin; null if it can."""
CLICK = "[...document.querySelectorAll('.play button')].find(each => each.textContent === {!r}).click()"


def type_into(page, key, text):
    page.value(
        f"""(() => {{
          const input = document.querySelector('[data-key="{key}"] input:not([type=range])');
          input.focus();
          input.value = {json.dumps(text)};
          input.dispatchEvent(new Event("change"));
        }})()"""
    )


@in_chromium
@pytest.mark.whole
def test_while_a_value_is_not_valid_the_last_run_is_marked_as_such(played):
    marked = "getComputedStyle(document.querySelector('.{}')).opacity < 1"
    assert not played.value(marked.format("numbers"))
    type_into(played, "network.latency.value", "0,5")
    played.until("document.querySelector('.old').checkVisibility()")
    assert "the last valid run" in played.value("document.querySelector('.old').textContent")
    assert played.value(marked.format("numbers"))
    assert played.value(marked.format("stage"))
    at = """document.querySelector('[data-key="network.latency.value"] {}')"""
    assert played.value(f"{at.format('.number')}.value") == "0,5"
    assert not played.value(f"{at.format('.help')}.checkVisibility()")
    type_into(played, "network.latency.value", "0.5")
    played.until("play.runs === 2")
    assert not played.value("document.querySelector('.old').checkVisibility()")
    assert not played.value(marked.format("numbers"))


WALLS = """
horizon = 1.0
team = { positions = [[1, 1], [9, 1]], speeds = 2.0 }
evader = { position = [5, 8], speed = 0.5 }
[[wall]]
line = [[0, 0], [0, 9]]
[[wall]]
polygon = [[4, 4], [6, 4], [6, 5], [4, 5]]
offset = [0.0, 0.5]
"""


@pytest.fixture
def among_walls(browser, tmp_path):
    """Yield the page of a scenario with walls after its first run; nothing was logged."""
    file = tmp_path / "walls.toml"
    file.write_text(WALLS)
    with PlayServer(Session(Playground(read_source(file), file), InProcess())) as server:
        Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        browser.visit(server.address)
        browser.until("window.play && play.runs === 1")
        yield browser
        assert browser.errors == []
        browser.visit("about:blank")
        server.shutdown()


PIXEL = """(([x, y]) => {{
  const frame = document.querySelector('iframe'), outer = frame.getBoundingClientRect();
  const inner = frame.contentDocument.getElementById('arena').getBoundingClientRect();
  const [u, v] = play.replay.pixel(x, y);
  return [outer.left + inner.left + u, outer.top + inner.top + v];
}})({})"""
"""Where a place, [x, y] m, is on the page, px."""


def drag(page, start, end, *, drops=True):
    """Press the button of the mouse at a place (m), move to another one, and let it go."""
    pixels, before = None, []
    while pixels != before:  # a message that appears moves the plane, a frame later
        time.sleep(0.1)
        pixels, before = [page.value(PIXEL.format(list(place))) for place in (start, end)], pixels
    for kind, (x, y) in [("mousePressed", pixels[0]), *(("mouseMoved", each) for each in pixels)]:
        page.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)
    if drops:
        x, y = pixels[1]
        page.send("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, button="left", clickCount=1)


def offset_of(page):
    """Return the changed offset of the wall that is moved, m; None if it is not changed."""
    changes = dict(each.split("=", 1) for each in page.value("play.changes"))
    assert changes.keys() <= {"wall.1.offset"}
    return json.loads(changes["wall.1.offset"]) if changes else None


FIRST_CORNERS = """JSON.parse(document.querySelector('iframe').contentDocument.getElementById('run').textContent)
.walls.map(each => each.shapes[0].corners[0])"""
"""The first corner of each wall of the replay, m."""


@in_chromium
@pytest.mark.whole
def test_a_wall_is_dragged_and_the_run_follows(among_walls):
    page = among_walls
    assert page.value(FIRST_CORNERS) == [[0, 0], [4, 4.5]]
    drag(page, (5, 5), (7, 3))
    page.until("play.runs === 2")
    assert offset_of(page) == pytest.approx([2.0, -1.5], abs=0.05)
    (x, y) = offset_of(page)
    assert page.value(FIRST_CORNERS)[1] == pytest.approx([4 + x, 4 + y])
    assert page.value("play.replay.chosen") == -1
    drag(page, (2, 6), (3, 6))  # the plane is no wall
    drag(page, (7, 3), (3, 3), drops=False)
    assert page.value("play.replay.wantedWalls[1][0]") == pytest.approx(-2.0, abs=0.05)
    page.press("Escape")
    assert page.value("play.replay.wantedWalls[1]") == [x, y]
    assert page.value("play.runs") == 2
    page.value("history.back()")
    page.until("play.runs === 3")
    assert offset_of(page) is None


@in_chromium
@pytest.mark.whole
def test_a_wall_that_is_dropped_on_a_player_is_refused_and_can_be_dragged_on(among_walls):
    page = among_walls
    drag(page, (5, 5), (8.8, 0.8))
    page.until("document.querySelector('.play').classList.contains('outdated')")
    assert "team.positions.1: [9, 1] is inside a wall" in page.value("document.querySelector('.wrong').textContent")
    assert "those of the last valid run" in page.value("document.querySelector('.old').textContent")
    assert page.value(FIRST_CORNERS) == [[0, 0], [4, 4.5]]
    assert page.value("play.replay.wantedWalls[1]") == offset_of(page)
    drag(page, (8.2, 0.6), (6, 6))
    page.until("play.runs === 2")
    assert not page.value("document.querySelector('.play').classList.contains('outdated')")
    assert page.value("document.querySelector('.wrong').textContent") == ""


@in_chromium
@pytest.mark.whole
def test_a_wall_is_moved_by_the_keyboard_which_keeps_the_focus(among_walls):
    page = among_walls
    for _ in range(60):
        page.press("Tab")
        if page.value("play.replay.markedWall") == 1:
            break
    step = page.value("10 ** Math.ceil(Math.log10(1 / play.replay.scale))")
    for k, (arrow, expected) in enumerate([("ArrowRight", [step, 0.5]), ("ArrowUp", [step, 0.5 + step])], start=2):
        page.press(arrow)
        page.until(f"play.runs === {k}")
        assert offset_of(page) == pytest.approx(expected)
        assert page.value("play.replay.markedWall") == 1
    page.press("ArrowLeft")
    page.press("ArrowDown")
    page.until(f"!play.changes.length && {FIRST_CORNERS}[1].join() === '4,4.5'")


@in_chromium
@pytest.mark.slow
def test_a_kind_that_needs_a_file_cannot_be_chosen_and_says_why(played):
    options = """[...document.querySelector('[data-key="network.latency"] select').options]"""
    shown = played.value(f"{options}.filter(each => each.disabled).map(each => each.textContent)")
    assert "trace (needs a file)" in shown
    assert not any("constant" in each for each in shown)


@in_chromium
@pytest.mark.slow
def test_keys_are_searched_above_all_controls(played):
    place = "(name => document.querySelector(name).getBoundingClientRect().top)('{}')"
    assert played.value(place.format(".search")) < 120
    played.value("document.querySelector('.search').value = 'capture radius'")
    played.value("document.querySelector('.search').dispatchEvent(new Event('input'))")
    assert played.value(place.format('[data-key="capture.radius"]')) < played.value(
        place.format('[data-key="network.latency"]')
    )


@in_chromium
@pytest.mark.whole
def test_all_metrics_show_that_they_scroll(played):
    played.value(CLICK.format("All metrics"))
    box = "document.querySelector('dialog .scroll')"
    count = played.value(f"{box}.querySelectorAll('tr').length")
    assert f"All {count} metrics" in played.value("document.querySelector('dialog strong').textContent")
    assert played.value(f"{box}.scrollHeight > {box}.clientHeight && {box}.clientHeight > 300")
    assert played.value(f"getComputedStyle({box}).overflowY") == "scroll"


@in_chromium
@pytest.mark.whole
@pytest.mark.parametrize("motion", ["reduce", "no-preference"])
def test_a_run_begins_to_play_unless_the_system_wishes_for_little_motion(browser, address, motion):
    browser.visit("about:blank")
    browser.visit(address, motion=motion)
    browser.until("window.play && play.runs === 1")
    assert browser.value("play.replay.playing || play.replay.time === play.replay.end") is (motion == "no-preference")


@in_chromium
@pytest.mark.slow
def test_on_a_phone_only_the_page_scrolls(played):
    played.resize(420, 900)
    fits = "(({ scrollHeight, clientHeight }) => scrollHeight <= clientHeight + 1)"
    played.until(f"{fits}(document.querySelector('iframe').contentDocument.documentElement)")
    for is_open in (False, True):
        assert played.value("document.querySelector('.keys').checkVisibility()") is is_open
        inner = f"[...document.querySelectorAll('.play *')].filter(each => each.clientHeight && !{fits}(each)"
        scrolls = f"{inner} && /auto|scroll/.test(getComputedStyle(each).overflowY)).map(each => each.className)"
        assert played.value(scrolls) == []
        played.value(CLICK.format("Keys"))
    assert played.value("document.documentElement.scrollHeight > innerHeight")


@pytest.mark.whole_but_one
@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 1920])
def test_the_comparison_leaves_the_plane_in_sight(played, width):
    played.resize(width, 800)
    played.value("play.change('network.latency.value', '0.7')")
    played.until("play.runs === 2")
    before = played.value("document.querySelector('.stage').clientHeight")
    played.value(CLICK.format("30 seeds"))
    assert "less than" in played.value("document.querySelector('.seeds h2').textContent")
    played.until("/about .* left/.test(document.querySelector('.seeds h2').textContent)")
    assert played.value("document.querySelector('.stage').clientHeight") == before
    plane = "document.querySelector('iframe').contentDocument.getElementById('stage').getBoundingClientRect()"
    inside = f"document.querySelector('iframe').getBoundingClientRect().left + {plane}.right"
    assert played.value(f"{inside} <= document.querySelector('.seeds').getBoundingClientRect().left")
    played.value(CLICK.format("Cancel"))
    assert "left" not in played.value("document.querySelector('.seeds h2').textContent")


@in_chromium
@pytest.mark.slow
def test_a_comparison_that_cannot_begin_says_why(played):
    played.value(CLICK.format("30 seeds"))
    assert "change a key first" in played.value("document.querySelector('.status').textContent")
    assert not played.value("document.querySelector('.seeds').checkVisibility()")


def test_a_pinned_run_that_is_not_valid_is_told_in_a_sentence(small):
    found = small.answer(SMALL, ["team.count=abc"])
    assert found["errors"][""].startswith(
        "The pinned run is not valid, so unpin it: --set team.count=abc: team.count: "
    )
    assert "Traceback" not in found["errors"][""]


@in_chromium
@pytest.mark.slow
def test_only_a_run_that_is_shown_can_be_pinned(played):
    pinned = played.value("play.pinned")
    played.value("play.change('team.count', 'abc')")
    played.until("document.querySelector('.play').classList.contains('outdated')")
    played.value(CLICK.format("Pin"))
    assert "Correct the values" in played.value("document.querySelector('.status').textContent")
    assert played.value("play.pinned") == pinned
    played.value("play.change('team.count', '5')")
    played.until("play.runs === 2")
    played.value(CLICK.format("Pin"))
    played.until("play.runs === 3")
    assert played.value("play.pinned") == played.value("play.changes") != pinned


@in_chromium
@pytest.mark.slow
def test_a_kind_without_defaults_asks_for_what_it_needs(played):
    played.value("play.change('network.medium', 'bitrate')")
    key = """[data-key="network.medium.bitrate"]"""
    played.until(f"document.querySelector('{key} .error')?.textContent")
    played.value("play.change('network.medium.bitrate', '1e6')")
    played.until("play.runs === 2")
    assert "network.medium.bitrate=1e6" in played.value("play.changes")


@in_chromium
@pytest.mark.whole
def test_thirty_seeds_are_compared_run_by_run_and_can_be_cancelled(played, small):
    played.value("play.change('network.latency.value', '0.7')")
    played.until("play.runs === 2")
    played.value(CLICK.format("30 seeds"))
    played.until("document.querySelector('.seeds progress').value === 30")
    rows = played.value("[...document.querySelectorAll('.seeds tbody tr')].map(each => each.textContent)")
    assert any(each.startswith("active time, s") and " ± " in each for each in rows)
    *_, last = Session(small, InProcess()).compare(played.value("play.changes"), played.value("play.pinned"), 30)
    apart = [row["name"] for row in last["metrics"] if row["first"] and row["differs"]]
    named = "each.firstChild.textContent.split(',')[0]"
    cells = f"[...document.querySelectorAll('.seeds tr:has(.apart)')].map(each => {named})"
    assert played.value(cells) == apart
    assert apart
    played.value(CLICK.format("30 seeds"))
    played.until("document.querySelector('.seeds progress').value > 0")
    played.value(CLICK.format("Cancel"))
    done = played.value("document.querySelector('.seeds progress').value")
    assert done < 30
    assert "cancelled" in played.value("document.querySelector('.seeds h2').textContent")
    played.value("play.change('network.latency.value', '0.5')")
    played.until("play.runs === 3")
    assert played.value("document.querySelector('.seeds progress').value") == done
    assert played.value("document.querySelector('.seeds h2').textContent").startswith("Before the last change: ")


@in_chromium
@pytest.mark.whole
def test_the_address_keeps_the_state_for_reload_and_back(played):
    played.value("play.change('network.latency.value', '0.5')")
    played.until("play.runs === 2")
    played.value("play.change('team.count', '5')")
    played.until("play.runs === 3")
    changed = played.value("play.changes")
    played.value("play.replay.seek(0.3)")
    played.until("location.hash.includes('t=0.3')")
    played.value("location.reload()")
    played.until("window.play && play.runs === 1 && play.replay")
    assert played.value("play.changes") == changed
    assert played.value("play.replay.time") == pytest.approx(0.3)
    played.value("history.back()")
    played.until("play.runs === 2")
    assert played.value("play.changes") == [*SMALL, "network.latency.value=0.5"]


@in_chromium
@pytest.mark.whole
def test_a_key_set_back_to_its_first_value_has_it(played):
    """The first value of the team is that of the command line, not that of the file."""
    for count, changes in [("7", ["team.count=7", SMALL[1]]), ("6", list(SMALL)), ("20", [SMALL[1]])]:
        played.value(f"play.change('team.count', '{count}')")
        played.until(f"play.replay.players.length === {int(count) + 1}")
        assert played.value("play.changes") == changes


@pytest.mark.whole_but_one
@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize("key", ["network.latency.value", "network.range", "team.count", "network.loss.p"])
def test_an_arrow_key_on_a_slider_changes_the_value(played, key):
    """A key at the end of its slider moves back."""
    number = f"""document.querySelector('[data-key="{key}"] .number').value"""
    seen, arrow = [played.value(number)], "ArrowLeft" if key == "network.range" else "ArrowRight"
    for k in range(3):
        played.value(f"""document.querySelector('[data-key="{key}"] [type=range]').focus()""")
        played.press(arrow)
        played.until(f"play.runs === {k + 2}")
        seen.append(played.value(number))
    assert len(set(seen)) == 4, seen
    assert played.value("document.activeElement.type") == "range"


@in_chromium
@pytest.mark.slow
def test_what_is_being_typed_survives_the_answer_to_an_earlier_change(played):
    box = """document.querySelector('[data-key="network.loss.p"] .number')"""
    played.value("play.change('team.count', '5')")
    played.value(f"{box}.focus()")
    played.value(f"{box}.value = '0.07'")
    played.until("play.runs === 2")
    assert played.value(f"{box}.value") == "0.07"
    assert played.value(f"document.activeElement === {box}")


@in_chromium
@pytest.mark.slow
def test_a_suggestion_is_offered_and_a_change_can_be_undone(played):
    played.value("document.querySelector('.search').value = 'belief timeout'")
    played.value("document.querySelector('.search').dispatchEvent(new Event('input'))")
    row = """document.querySelector('[data-key="announce.belief_timeout"]')"""
    assert played.value(f"{row}.querySelector('input').list.options[0].value") == "auto"
    assert played.value(f"{row}.querySelector('.back').hidden") is True
    played.value("play.change('announce.belief_timeout', '0.5')")
    played.until("play.runs === 2")
    played.value(f"{row}.querySelector('.back').click()")
    played.until("play.runs === 3")
    assert played.value("play.changes") == list(SMALL)


IS_OFF = CLICK.format("30 seeds").replace("click()", "disabled")
"""Whether the button for comparisons is off."""


@in_chromium
@pytest.mark.slow
def test_without_a_pinned_run_there_is_no_difference_and_no_comparison(played):
    assert "pinned" in played.value(WHY_NOT)
    played.value("play.change('network.latency.value', '0.4')")
    played.until("play.runs === 2")
    assert played.value(WHY_NOT) is None
    played.value(CLICK.format("Unpin"))
    played.until("play.runs === 3")
    assert played.value("play.pinned") is None
    assert played.value("document.querySelectorAll('.numbers small').length") == 0
    assert "pinned" in played.value(WHY_NOT)


@in_chromium
@pytest.mark.whole
def test_a_run_can_be_saved_and_copied_from_the_page(played):
    played.value(CLICK.format("Save"))
    played.until("document.querySelector('dialog').open")
    assert "desim run --from out/relay-" in played.value("document.querySelector('dialog').textContent")
    played.value("document.querySelector('dialog').close()")
    played.value(CLICK.format("Copy as …"))
    texts = played.value("[...document.querySelectorAll('dialog pre')].map(each => each.textContent)")
    assert any(each.startswith("desim run ") for each in texts)
    assert any("horizon = 1.0" in each for each in texts)


@in_chromium
@pytest.mark.slow
def test_every_control_has_a_name_and_can_be_reached_by_the_keyboard(played):
    tree = played.send("Accessibility.getFullAXTree")["nodes"]
    roles = {"button", "slider", "textbox", "combobox", "checkbox", "searchbox", "spinbutton"}
    unnamed = [
        node
        for node in tree
        if node.get("role", {}).get("value") in roles and not node.get("name", {}).get("value") and not node["ignored"]
    ]
    assert unnamed == []
    assert played.value("document.querySelectorAll('.play [tabindex=\"-1\"]').length") == 0
    played.value("""document.querySelector('[data-key="seed"] input').focus()""")
    played.press("ArrowUp")
    played.until("play.runs === 2")
    assert played.value("play.changes") == [*SMALL, "seed=4"]
    assert played.value("document.activeElement.closest('[data-key]').dataset.key") == "seed"
    assert "differ, so they are also due to chance" in played.value("document.querySelector('.note').textContent")


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize(("width", "height"), [(1280, 800), (1920, 1080), (420, 800)])
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_nothing_is_wider_than_the_window(played, width, height, theme):
    played.resize(width, height, theme)
    played.until("play.replay")
    assert played.value("document.documentElement.scrollWidth <= innerWidth")
    wide = "[...document.querySelectorAll('.play button, .play input, .play select')].filter(each => each.offsetWidth)"
    assert played.value(f"{wide}.filter(each => each.getBoundingClientRect().right > innerWidth + 1).length") == 0
    played.until(f"document.documentElement.dataset.theme === '{theme}'")


@in_chromium
@pytest.mark.whole
def test_seven_pages_of_a_browser_run_and_compare_at_the_same_time(browser, address):
    """A browser opens at most six connections to a host."""
    pages = [browser, *(Page(browser.commands, browser.answers) for _ in range(6))]
    for page in pages:
        page.visit(address)
        page.until("window.play && play.runs === 1")
    for page in pages:
        page.to_front()
        page.value(f"({SLIDE})('network.latency.value', 600)")
        page.until("play.runs === 2")
        page.value("[...document.querySelectorAll('button')].find(each => each.textContent === '30 seeds').click()")
    for page in pages:
        page.until("/^([2-9]|[1-3][0-9]) of 30 seeds/.test(document.querySelector('.seeds h2')?.textContent)")
    for page in pages[1:]:
        page.close()
    browser.to_front()
    browser.value(f"({SLIDE})('network.latency.value', 300)")
    browser.until("play.runs === 3")


@in_chromium
@pytest.mark.whole
@on_linux
def test_all_pages_say_that_the_program_has_ended(browser, tmp_path):
    with program(RELAY, "--set", "horizon=0.5", cwd=tmp_path) as (process, found):
        pages = [browser, Page(browser.commands, browser.answers)]
        for page in pages:
            page.visit(found)
            page.until("window.play && play.runs === 1")
        begun = children(process)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 128 + signal.SIGTERM
        assert are_gone(begun)
        for page in pages:
            page.until("document.querySelector('.status').textContent === 'ended'")
    pages[1].close()


@in_chromium
@pytest.mark.whole
@on_linux
def test_the_program_ends_when_its_page_is_closed(browser, tmp_path):
    with program(RELAY, "--set", "horizon=0.5", cwd=tmp_path) as (process, found):
        browser.visit(found)
        browser.until("window.play && play.runs === 1")
        begun = children(process)
        assert begun
        browser.visit("about:blank")
        assert process.wait(60) == 0
        assert are_gone(begun)


@pytest.mark.whole
def test_a_page_that_is_reloaded_keeps_the_server(small, monkeypatch):
    monkeypatch.setattr(play_server, "LINGER", 0.3)
    with PlayServer(Session(small, InProcess())) as made:
        thread = Thread(target=made.serve_until_closed)
        thread.start()
        made.page_opened()
        made.page_closed()
        made.page_opened()
        thread.join(0.6)
        assert thread.is_alive()
        made.page_closed()
        thread.join(30)
        assert not thread.is_alive()


def test_the_texts_of_a_scenario_name_its_file_or_one_to_save_it_in():
    source = read_source(RELAY)
    for file, name in ((RELAY, str(RELAY)), (None, "relay.toml")):
        texts = Playground(source, file).texts(["team.count=5"])
        command = texts["command"].split()
        assert command[:3] == ["desim", "run", name]
        assert (command[3:] == ["--set", "team.count=5"]) == (file is not None)
        assert f"load({name!r}" in texts["python"]

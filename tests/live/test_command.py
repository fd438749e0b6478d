"""The command `desim live`: what it refuses, and the tables that it prints."""

import csv
import json
import re

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

from desim.analysis.measuring import summary
from desim.analysis.metrics import METRICS, plain
from desim.cli import main
from desim.cli.live import overload
from desim.config.file_names import LIVE
from desim.kernel.core.events import Broadcast, MessageCounts
from desim.kernel.core.units import SECOND
from desim.kernel.fates import LoggedMessage, fates
from desim.live import agreement as agreement_module
from desim.live.agreement import Agreement, compare
from desim.live.figure import agreement_figure
from desim.live.result import Conduct, LiveResult
from desim.live.start import PursuerStart
from desim.results.run_folder import read as read_run
from desim.results.run_folder import write as write_run
from desim.scenario.toml import dump, load
from desim.simulation.run import run
from desim.study.workers.batch import seeds_from
from scenarios.studies.study import SCENARIOS
from tests.live.test_runs import game, scenario

RELAY = str(SCENARIOS / "relay.toml")


def refused(*words):
    done = CliRunner().invoke(main, ["live", *words])
    assert done.exit_code == 2, done.output
    return done.stderr


def test_wrong_input_is_refused_with_a_sentence(tmp_path):
    assert "protocol.kind cannot run live: an omniscient protocol" in refused(RELAY, "--set", "protocol=centralised")
    assert "--compare needs several runs, such as -n 20" in refused(RELAY, "--compare")
    for word in ("x", "127.0.0.1:99999/1/3/127.0.0.1/ab", "127.0.0.1:0/1/3/127.0.0.1/ab"):
        why = f"--join: should be the word that `desim live --hosts` prints (got {word!r})"
        assert why in refused(RELAY, "--join", word)
    hosts = tmp_path / "hosts.txt"
    hosts.write_text("127.0.0.1\n# another\n127.0.0.2  # mine\n")
    count = "hosts.txt: should have a host for each of the 20 pursuers, one a line (got 2)"
    assert count in refused(RELAY, "--hosts", str(hosts))
    assert "hosts.txt" in refused(RELAY, "--hosts", str(tmp_path / "no" / "hosts.txt"))
    hosts.write_text("127.0.0.1\n\nno host\n")
    assert "hosts.txt, line 3: the host 'no host' is not known: " in refused(RELAY, "--hosts", str(hosts))
    hosts.write_text("0.0.0.0\n")
    assert "hosts.txt, line 1: 0.0.0.0 stands for all addresses" in refused(RELAY, "--hosts", str(hosts))
    for option in ("--compare", "--netem", "--namespaces"):
        refusal = refused(RELAY, option, "--hosts", str(hosts))
        assert f"{option} needs all processes on this machine: leave out --hosts" in refusal


def test_an_invitation_is_one_word():
    start = PursuerStart(("192.168.0.2", 41235), "2f6c", 4, 3, "192.168.0.7")
    assert start.invitation() == "192.168.0.2:41235/4/3/192.168.0.7/2f6c"
    invited = PursuerStart.invited(start.invitation(), scenario())
    assert invited == start._replace(scenario=invited.scenario)
    assert invited.scenario != PursuerStart.invited(start.invitation(), scenario(latency=0.2)).scenario


def test_an_invitation_has_the_parameters_of_a_protocol_of_ones_own(tmp_path):
    """They are no keys of the scenario, so that only the hash of its objects tells them apart."""
    (tmp_path / "rules.py").write_text(
        "class Rule:\n    def __init__(self, p):\n        self.p = p\n\n"
        "    def __call__(self, me):\n        yield me.sleep(self.p)\n"
    )
    hashes = []
    for p in (0.3, 0.7, 0.7):
        (tmp_path / "own.toml").write_text(f'protocol = {{ kind = "rules:Rule", p = {p} }}\n')
        experiment = load(tmp_path / "own.toml", allow_import=True)
        hashes.append(PursuerStart.invited("127.0.0.1:4000/0/1/127.0.0.1/2f6c", experiment).scenario)
    assert hashes[0] != hashes[1] == hashes[2]


def performed(*words):
    done = CliRunner().invoke(main, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout + done.stderr


@pytest.mark.slow
def test_what_reads_the_folder_of_a_run_reads_that_of_a_live_run(tmp_path):
    pytest.importorskip("matplotlib")
    pytest.importorskip("pandas")
    file, folder = tmp_path / "calm.toml", tmp_path / "live"
    file.write_text(dump(scenario(team={"speeds": {"default": 0.1, "last": 0.2}})))
    performed("live", file, "-o", folder)
    result = read_run(folder)
    (counts,) = result.trace.of(MessageCounts)
    shown = json.loads((folder / "summary.json").read_text())
    for name in METRICS:  # as `explain` and `sweep` measure them
        assert shown[name] == plain(summary(result))[name]
    assert f"3 pursuers, 1.00 s, {counts.sent} messages" in performed("replay", folder)
    assert f"wrote {counts.sent} packets" in performed("export", folder, tmp_path / "live.pcapng")
    performed("export", folder, tmp_path / "live.perfetto.json")
    performed("export", folder, tmp_path / "live.csv", "--event", "Broadcast")
    rows = list(csv.DictReader((tmp_path / "live.csv").read_text().splitlines()))
    assert len(rows) == counts.sent
    for kind in ("trajectory", "spacetime"):
        performed("plot", folder, "--kind", kind, "-o", tmp_path / f"{kind}.svg")
    log = [LoggedMessage(event.t / SECOND, event.src, None, event.size) for event in result.trace.of(Broadcast)]
    assert len(fates(log, 3, result.scenario.network)) == counts.sent
    assert re.search(r"live +run +relay", performed("ls", tmp_path))
    refusal = CliRunner().invoke(main, ["report", str(folder)])
    assert refusal.exit_code == 2
    assert "is the folder of a single run" in refusal.stderr


MINE = """
from dataclasses import dataclass
from typing import NamedTuple

class Bid(NamedTuple):
    amount: float
    route: tuple[float, ...] = (1.0, 2.0)

@dataclass(frozen=True)
class Load:
    tags: tuple[str, ...]

def protocol(me):
    while True:
        me.send(None, Bid(0.5 * me.id), port="bids")
        me.send((me.id + 1) % 3, Load(("a", "b")))
        assert {type(message.body) for message in me.mail("bids")} <= {Bid}
        assert {type(message.body) for message in me.mail()} <= {Load}
        yield me.sleep(0.1)
"""


@pytest.mark.slow
def test_a_protocol_of_a_file_sends_bodies_of_its_own_between_processes(tmp_path):
    pytest.importorskip("msgspec")
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "own.toml").write_text(dump(scenario()))
    options = tmp_path / "own.toml", "--allow-import", "--set", 'protocol="mine:protocol"', "-o", tmp_path / "out"
    performed("live", *options)
    events = map(json.loads, (tmp_path / "out" / "trace.jsonl").read_text().splitlines())
    bodies = [event["body"] for event in events if event["event"] == "Sent"]
    assert {"amount": 1.0, "route": [1.0, 2.0]} in bodies
    assert {"tags": ["a", "b"]} in bodies


def pretended(result, timers=(1_000_000,)) -> LiveResult:
    conduct = Conduct()
    conduct.note(0, list(timers), [])
    return LiveResult(result.scenario, result.seed, result.trace, conduct)


def test_a_run_with_late_timers_is_warned_of(simulated):
    early, late = pretended(simulated[0]), pretended(simulated[0], [30_000_000] * 100)
    assert overload([early]) == ""
    assert "late: 1 % of the timers by 30 ms or more: results depend on this machine" in overload([late])


def test_the_simulation_of_a_live_run_says_that_it_is_one(tmp_path):
    result = run(scenario(), 3)
    write_run(result, tmp_path)
    repeat = ["run", "--from", str(tmp_path / "run.json")]
    assert "recorded live" not in CliRunner().invoke(main, repeat).stderr
    (tmp_path / LIVE).write_text("{}")
    assert "was recorded live" in CliRunner().invoke(main, repeat).stderr


@pytest.fixture
def simulated():
    return [run(game("sap"), seed) for seed in range(2)]


@pytest.mark.slow
def test_what_is_no_result_is_told_beside_the_results(simulated, tmp_path, monkeypatch):
    live = [pretended(result, [30_000_000] * 100) for result in simulated]
    for result in live:
        result.conduct.notes.append("a note")
    monkeypatch.setattr("desim.live.live_runs.runs", lambda *_, **__: live)
    done = CliRunner().invoke(main, ["live", RELAY, "-n", "2", "--json", "-o", str(tmp_path / "out")])
    assert done.exit_code == 0
    document = json.loads(done.stdout)
    assert document["scenario"] == load(RELAY).plain()
    assert [(entry["seed"], entry["live"]["notes"]) for entry in document["runs"]] == [(0, ["a note"]), (1, ["a note"])]
    assert done.stderr.count("a note") == 2
    assert f"wrote {tmp_path / 'out'}" in done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == {f"seed-{result.seed}" for result in live}
    monkeypatch.setattr("desim.live.live_runs.runs", lambda *_, **__: live[:1])
    assert CliRunner().invoke(main, ["live", RELAY, "-o", str(tmp_path / "one")]).exit_code == 0
    assert (tmp_path / "one" / "run.json").is_file()


def test_runs_that_are_equal_agree_and_late_timers_give_no_verdict(simulated):
    same = Agreement(game("sap"), [pretended(result) for result in simulated], simulated)
    assert same.agrees is True
    assert "live and simulated agree, as far as 2 runs of each tell" in same.table()
    assert same.document()["agrees"] is True
    late = Agreement(game("sap"), [pretended(result, [30_000_000] * 100) for result in simulated], simulated)
    assert late.agrees is None
    assert "no verdict: timers were late by more than 20 ms" in late.table()


@pytest.mark.slow
def test_other_runs_differ_beyond_their_errors_and_the_margin(simulated):
    slow = [pretended(run(game("sap"), seed + 100)) for seed in range(2)]
    rows = {row.metric: row for row in Agreement(game("sap"), slow, simulated).rows}
    assert rows["messages_sent"].difference.mean != 0.0
    row = rows["active_time"]._replace(margin=abs(rows["active_time"].difference.mean))
    assert row.errors == 0.0
    assert row.agrees


@pytest.mark.whole
def test_the_numbers_of_a_comparison_are_those_of_its_runs():
    """Means, paired differences, standard errors, what late actions explain, and the verdict: by scipy."""
    simulated = [run(game("sap"), seed) for seed in range(4)]
    slow = game("sap").with_({"network.latency": 0.3})
    live = [pretended(run(slow, seed)) for seed in range(4)]
    for k, result in enumerate(live):
        result.conduct.orders += [(k + 1) * 1_000_000, 2_000_000]
    agreement = Agreement(game("sap"), live, simulated)
    late = sum(0.001 * (k + 1) + 0.002 for k in range(4)) / 4
    rows = {
        row[0]: row[1:] for line in agreement.table().splitlines() if len(row := re.split(r" {2,}", line.strip())) > 6
    }
    bound = stats.t.ppf(1.0 - 0.05 / 7 / 2, 3)
    assert f"differs by more than {bound:.3g} standard errors" in agreement.table()
    for entry in agreement.document()["rows"]:
        name, is_time = entry["metric"], METRICS[entry["metric"]].unit == "s"
        first, second = ([float(summary(one)[name]) for one in side] for side in (live, simulated))
        differences = np.subtract(first, second)
        error, margin = float(stats.sem(differences)), late * is_time
        beyond = max(abs(differences.mean()) - margin, 0.0)
        numbers = np.mean(first), np.mean(second), differences.mean(), margin, error
        found = [entry[key] for key in ("live", "simulated", "difference", "margin", "standard_error")]
        assert found == pytest.approx(numbers, abs=1e-12)
        cells = rows[f"{name}, s" if is_time else name]
        for cell, number in zip(cells, numbers, strict=False):
            assert float(cell.replace(",", "")) == pytest.approx(number, abs=0.00051)
        if error:
            assert float(cells[5]) == pytest.approx(np.copysign(beyond / error, differences.mean()), abs=0.051)
            assert entry["agrees"] == (beyond <= bound * error)
        assert cells[6] == ("agrees" if entry["agrees"] else "differs")


def test_a_comparison_needs_two_runs_and_hands_on_its_arguments(monkeypatch):
    class ReachedError(Exception):
        pass

    calls = []

    def runs(*args, **named):
        calls.append((args, named))
        raise ReachedError

    monkeypatch.setattr(agreement_module, "runs", runs)
    with pytest.raises(ValueError, match=r"^a comparison needs at least 2 runs of each kind \(got 1\)$"):
        compare(game("sap"), 1)
    with pytest.raises(ReachedError):
        compare(game("sap"), 2, 7, at_once=3, links="real", finished=print)
    assert calls == [
        ((game("sap"), seeds_from(7, 2)), {"at_once": 3, "links": "real", "finished": print}),
    ]


@pytest.mark.slow
def test_a_comparison_simulates_what_it_runs_live_with_the_same_seeds(monkeypatch):
    monkeypatch.setattr(
        agreement_module, "runs", lambda scenario, seeds, **_: [pretended(run(scenario, seed)) for seed in seeds]
    )
    agreement = compare(game("sap"), 3, 2)
    assert [result.seed for result in agreement.simulated] == [2_000_000, 2_000_001, 2_000_002]
    assert agreement.agrees
    pytest.importorskip("matplotlib")
    left, right = agreement_figure(agreement).axes
    assert left.get_ylabel() == "pursuers that chase"
    assert right.get_xlabel() == "active time, simulated (s)"
    assert agreement.live[0].trace.of(MessageCounts)


OWN = """
from dataclasses import dataclass, field

@dataclass(kw_only=True)
class Bid:
    price: float
    rank: int = field(init=False, default=5)

def talk(me):
    me.send(None, Bid(price=me.capture_time()))
    while True:
        yield me.arrival()
        for message in me.mail():
            assert message.body.rank == 5
        me.assign(True)
"""


@pytest.mark.whole
def test_a_protocol_beside_the_file_sends_bodies_of_its_own(tmp_path):
    pytest.importorskip("msgspec")
    (tmp_path / "bids_of_mine.py").write_text(OWN)
    file = tmp_path / "mine.toml"
    file.write_text(
        'name = "mine"\nhorizon = 0.5\nteam.count = 2\nteam.active_at_start = 0.0\nprotocol = "bids_of_mine:talk"\n'
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        done = CliRunner().invoke(main, ["live", str(file), "--allow-import"])
    assert done.exit_code == 0, done.output
    assert "datagrams dropped: 0 malformed" in done.output

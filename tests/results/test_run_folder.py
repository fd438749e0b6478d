"""The folder of a run."""

import json
import random
import sys
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from desim.analysis.knowledge import knowledge
from desim.analysis.measuring import summary
from desim.analysis.metrics import plain
from desim.cli import main
from desim.kernel.core.events import LOST, MESSAGES, Broadcast, Lost, Queued, Sent, Trace
from desim.kernel.core.records import Record
from desim.kernel.core.trace_file import line_of
from desim.pursuit.core.events import Captured
from desim.pursuit.team.announcements import Announcements
from desim.results import provenance
from desim.results.run_folder import (
    WriteError,
    can_plot,
    clear,
    events,
    read,
    simulate,
    simulate_below,
    write,
    write_below,
)
from desim.results.trace_checks import inconsistencies
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Recording, Scenario
from desim.scenario.toml import dump, load
from desim.simulation.run import Result, run
from desim.view.pages.replay import replay_page
from desim.view.pictures.spacetime import spacetime
from tests.command import accepted
from tests.conftest import undraw

DATA = {"trace.jsonl", "summary.json", "scenario.toml", "run.json"}
PICTURES = {"trajectory.svg", "trajectory.png"}
SCENARIO = Scenario(name="caf\u00e9", seed=1, horizon=0.2, team=Team(count=3), record=Recording(trajectory=0.0))


def names(folder) -> set[str]:
    return {each.name for each in folder.iterdir()}


@pytest.fixture(scope="module")
def result():
    return run(SCENARIO, 5)


def test_a_folder_holds_the_trace_the_numbers_the_scenario_and_where_they_come_from(result, tmp_path):
    """It is made with all above it, and the numbers are returned."""
    folder = tmp_path / "a" / "b"
    assert write(result, folder) == summary(result)
    assert names(folder) == DATA
    assert json.loads((folder / "summary.json").read_text(encoding="utf-8")) == plain(summary(result))
    assert (folder / "trace.jsonl").read_bytes() == "".join(map(line_of, result.trace)).encode()
    assert load(folder / "scenario.toml") == SCENARIO.model_copy(update={"seed": 5})
    assert result.scenario.seed == 1
    assert provenance.read(folder / "run.json") == provenance.document("run", SCENARIO, seed=5)


def test_a_folder_may_be_named_by_a_text(result, tmp_path):
    write(result, str(tmp_path / "a"))
    assert len(read(str(tmp_path / "a")).trace) == len(result.trace)


def test_runs_are_written_below_a_folder_by_their_seed(result, tmp_path):
    assert write_below(tmp_path, result) == summary(result)
    assert names(tmp_path) == {"seed-5"}
    assert names(tmp_path / "seed-5") == DATA


def test_the_folder_of_one_of_several_runs_has_the_provenance_of_that_run(result, tmp_path):
    made = provenance.document("run", SCENARIO, seed=4, runs=3, folder=tmp_path) | {"argv": ["desim", "run", "x"]}
    write_below(tmp_path, result, made)
    written = provenance.read(tmp_path / "seed-5" / "run.json")
    assert written == made | {"seed": 5, "runs": 1, "scenario": SCENARIO.plain() | {"seed": 5}}


@pytest.fixture
def seen() -> Scenario:
    return SCENARIO.model_copy(update={"record": Recording(trajectory=0.1)})


@pytest.mark.slow
def test_there_are_pictures_if_positions_were_recorded(seen, tmp_path):
    write(run(seen), tmp_path)
    assert names(tmp_path) == DATA | PICTURES


def test_there_are_no_pictures_without_matplotlib(seen, tmp_path, monkeypatch):
    assert can_plot()
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # importing it now raises ImportError
    assert not can_plot()
    write(run(seen), tmp_path)
    assert names(tmp_path) == DATA


@pytest.mark.slow
def test_a_picture_of_an_earlier_run_does_not_stay_beside_the_trace_of_a_later_one(seen, result, tmp_path):
    write(run(seen), tmp_path)
    write(result, tmp_path)
    assert names(tmp_path) == DATA


@pytest.mark.whole
def test_nothing_that_shows_an_earlier_run_stays_but_the_runs_below(seen, tmp_path):
    """Whatever `replay` and `plot` make; a folder `seed-S` has a scenario of its own."""
    write_below(tmp_path, run(seen, 4))
    write(run(WITH_MESSAGES), tmp_path)
    assert names(tmp_path) == DATA | PICTURES | {"seed-4"}
    for command in ("plot --kind spacetime", "plot --kind perfetto", "plot --kind film", "replay"):
        before = names(tmp_path)
        assert CliRunner().invoke(main, [*command.split(), str(tmp_path)]).exit_code == 0
        assert names(tmp_path) > before
    write(run(SCENARIO), tmp_path)
    assert names(tmp_path) == DATA | {"seed-4"}
    assert names(tmp_path / "seed-4") == DATA | PICTURES


def test_a_folder_of_which_some_files_are_removed_has_no_run_json(tmp_path):
    """It would say that the folder is complete, and is removed first."""
    (tmp_path / "run.json").touch()
    (tmp_path / "trace.jsonl").mkdir()  # which cannot be removed as a file
    with pytest.raises(WriteError, match=r"trace\.jsonl"):
        clear(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["trace.jsonl"]


def test_each_of_several_evaders_begins_where_the_seed_puts_it(tmp_path):
    result = run(SCENARIO.with_({"evader.count": 2}), 3)
    write(result, tmp_path, drawn=False)
    assert read(tmp_path).trace.events == result.trace.events


@pytest.mark.slow
def test_files_of_others_in_the_folder_stay(seen, tmp_path):
    (tmp_path / "trajectory.csv").write_text("precious")
    (tmp_path / "notes.txt").write_text("precious")
    write(run(seen), tmp_path)
    assert names(tmp_path) == DATA | PICTURES | {"trajectory.csv", "notes.txt"}


FILES = ("relay", "faults", "radio", "soak", "auction", "flooding", "token_ring", "server", "reckoning")


PACK = ("evader.count=3", "evader.box=[1, 19]", "team.speeds=4.0")


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize(("name", "pack"), [*((name, ()) for name in FILES), ("reckoning", PACK)])
@pytest.mark.usefixtures("_undrawn")
def test_a_run_that_was_written_is_read_again(run_of, name, pack, tmp_path):
    """The same events, and the same numbers from them: beliefs too, which come from what was relayed."""
    result = run_of(f"{name}.toml", "horizon=1.5" if pack else "horizon=1.0", "record.messages=true", *pack)
    assert bool(result.trace.of(Captured)) == bool(pack)
    numbers = write(result, tmp_path)
    again = read(tmp_path)
    assert again.seed == result.seed
    assert again.trace.events == result.trace.events
    assert [type(event) for event in again.trace] == [type(event) for event in result.trace]
    assert json.dumps(plain(summary(again))) == json.dumps(plain(numbers))
    assert dump(again.scenario) == (tmp_path / "scenario.toml").read_text()


TO_FILE = SCENARIO.model_copy(update={"record": Recording(trajectory=0.1, messages="file")})
WITH_MESSAGES = SCENARIO.model_copy(update={"record": Recording(trajectory=0.1, messages=True)})


@pytest.mark.whole
def test_a_run_with_measured_links_is_repeated_without_the_file(tmp_path, monkeypatch):
    """From run.json and from scenario.toml, and byte by byte; the control is an edited file."""
    file, table = tmp_path / "f.toml", tmp_path / "rtt.csv"
    file.write_text(
        'horizon = 0.5\nteam.count = 3\nprotocol = { kind = "sap", schedule = { kind = "poisson", rate = 5.0 } }\n'
        'network.latency = { kind = "trace", file = "rtt.csv", start = "random" }\nrecord.messages = true\n'
    )
    rows = [f"{k / 10},{0.01 + 0.001 * k if k % 7 else ''},x\n" for k in range(50)]
    table.write_text("".join(["t,value,note\n", *rows]))
    done = accepted("run", file, "-o", tmp_path / "one")
    table.write_text("".join(["t,value\n", *(f"{k / 10},0.02\n" for k in range(50))]))
    accepted("run", file, "-o", tmp_path / "edited")
    table.unlink()
    accepted("run", "--from", tmp_path / "one" / "run.json", "-o", tmp_path / "again")
    accepted("run", tmp_path / "one" / "scenario.toml", "-o", tmp_path / "resolved")
    one, again, resolved, edited = (
        (tmp_path / name / "trace.jsonl").read_bytes() for name in ("one", "again", "resolved", "edited")
    )
    assert one == again == resolved != edited
    assert done.stdout
    assert read(tmp_path / "one").scenario.network.latency.read_from == "rtt.csv"


@pytest.mark.slow
def test_messages_recorded_to_a_file_are_in_the_trace_of_the_folder_and_not_of_the_result(tmp_path):
    result = simulate(tmp_path / "a", TO_FILE, 5)
    assert list(result.trace) == list(run(TO_FILE, 5).trace)
    assert not [event for event in result.trace if isinstance(event, MESSAGES)]
    write(result, tmp_path / "a", simulated_there=True)
    whole = run(WITH_MESSAGES, 5).trace
    assert (tmp_path / "a" / "trace.jsonl").read_bytes() == "".join(map(line_of, whole)).encode()
    assert list(events(tmp_path / "a")) == whole.events
    assert names(tmp_path / "a") == DATA | PICTURES


@pytest.mark.slow
@pytest.mark.usefixtures("_undrawn")
def test_metrics_that_need_messages_are_measured_once_the_message_file_is_read(tmp_path):
    numbers = plain(write(simulate(tmp_path, TO_FILE, 5), tmp_path, simulated_there=True))
    whole = plain(summary(run(WITH_MESSAGES, 5)))
    absent = {name for name in whole if whole[name] is not None and numbers[name] is None}
    assert absent == {"age_mean", "age_peak", "age_at_decision", "belief_error", "believed_leaders"}
    assert {name: each for name, each in numbers.items() if name not in absent} == {
        name: each for name, each in whole.items() if name not in absent
    }
    assert plain(summary(read(tmp_path))) == whole


@pytest.mark.slow
def test_the_file_of_one_of_several_runs_is_below_the_folder(tmp_path):
    write_below(tmp_path, simulate_below(tmp_path, TO_FILE, 5), simulated_there=True)
    assert names(tmp_path) == {"seed-5"}
    assert list(events(tmp_path / "seed-5")) == run(WITH_MESSAGES, 5).trace.events


@pytest.mark.slow
def test_a_run_whose_messages_go_nowhere_else_is_written_as_far_as_it_is_known(tmp_path):
    write(run(TO_FILE, 5), tmp_path)
    assert list(events(tmp_path)) == run(TO_FILE, 5).trace.events


def test_nothing_is_written_before_its_time_of_a_run_that_keeps_its_messages(tmp_path):
    assert simulate(tmp_path, WITH_MESSAGES, 5).trace.events == run(WITH_MESSAGES, 5).trace.events
    assert names(tmp_path) == set()


def test_half_a_trace_is_not_read(result, tmp_path):
    write(result, tmp_path)
    trace = (tmp_path / "trace.jsonl").read_text()
    (tmp_path / "trace.jsonl").write_text(trace[: trace.rindex("{")])
    for given in (read, lambda folder: list(events(folder))):
        with pytest.raises(ValueError, match=r"trace.jsonl: is not complete: .* MessageCounts and Ended"):
            given(tmp_path)


@pytest.fixture
def other_file(tmp_path):
    (tmp_path / "other.toml").write_text(dump(SCENARIO.model_copy(update={"team": Team(count=4)})))
    return tmp_path / "other.toml"


def test_several_runs_in_the_folder_of_one_leave_nothing_of_it(result, other_file, tmp_path):
    write(result, tmp_path / "out")
    done = CliRunner().invoke(main, ["run", str(other_file), "-n", "2", "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert names(tmp_path / "out") == {"run.json", "seed-1000000", "seed-1000001"}
    done = CliRunner().invoke(main, ["replay", str(tmp_path / "out")])
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr.endswith(
        ": has no result itself, but its folders have (seed-1000000, seed-1000001): give one of them\n"
    )


OF_ANOTHER = {
    "several runs": (lambda made: made | {"runs": 2}, "records 2 runs, but the folder of a run needs the record"),
    "another seed": (lambda made: provenance.of_one(made, 6), "does not match trace.jsonl"),
    "a sweep": (lambda made: made | {"what": "sweep"}, "was written by desim sweep, which desim run cannot repeat"),
}


@pytest.mark.parametrize(("change", "why"), OF_ANOTHER.values(), ids=OF_ANOTHER)
def test_a_trace_is_not_read_under_what_is_written_of_other_runs(result, change, why, tmp_path):
    write(result, tmp_path)
    provenance.write(tmp_path, change(provenance.read(tmp_path / "run.json")))
    with pytest.raises(ValueError, match=f"run.json: {why}"):
        read(tmp_path)


def test_a_trace_of_another_format_is_refused_with_what_to_do(result, tmp_path):
    write(result, tmp_path)
    first, *rest = (tmp_path / "trace.jsonl").read_text().splitlines(keepends=True)
    for change, found in (({"format": 99}, "format 99"), ({"format": None}, "no format number")):
        fields = {key: value for key, value in (json.loads(first) | change).items() if value is not None}
        (tmp_path / "trace.jsonl").write_text(json.dumps(fields) + "\n" + "".join(rest))
        with pytest.raises(ValueError, match=f"trace.jsonl: has {found}, .* reads format 2: .* run the scenario again"):
            read(tmp_path)


SCENARIOS = {
    "pursuers": {"team": Team(count=4)},
    "speeds": {"team": Team(count=3, speeds=2.0)},
    "box": {"team": Team(count=3, box=(0.0, 1.0))},
    "evaders": {"evader": {"count": 2}},
    "their place": {"evader": {"position": (1.0, 1.0)}},
}


@pytest.mark.parametrize("changes", SCENARIOS.values(), ids=SCENARIOS)
def test_a_trace_is_not_read_under_another_scenario(result, changes, tmp_path):
    write(result, tmp_path)
    other = Scenario(**{"seed": 1, "horizon": 0.2, "team": Team(count=3)} | changes)
    provenance.write(tmp_path, provenance.document("run", other, seed=5))
    with pytest.raises(ValueError, match=r"run.json: does not match trace.jsonl: number, speeds or starting"):
        read(tmp_path)


def test_a_trace_without_a_beginning_is_not_read(result, tmp_path):
    write(result, tmp_path)
    (tmp_path / "trace.jsonl").write_text((tmp_path / "trace.jsonl").read_text().splitlines()[-1] + "\n")
    with pytest.raises(ValueError, match=r"line 1 is not an event: .* Started"):
        read(tmp_path)


def record(folder, name, *overrides):
    """Write a run of a scenario file of which everything is recorded to a folder, and return that."""
    file = Path(__file__).parents[2] / "scenarios" / f"{name}.toml"
    write(run(load(file, ["record.messages=true", "record.trajectory=0.1", *overrides])), folder)
    return folder


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return the folder of a run in which faults begin and end."""
    return record(tmp_path_factory.mktemp("recorded"), "faults", "horizon=2.5")


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Return the folder of a short run of two pursuers, with a fault that ends, a loss and an arrival."""
    scenario = Scenario(
        horizon=0.05,
        team={"count": 2},
        announce={"heartbeat": 0.005},
        network={"loss": 0.5},
        fault=[{"kind": "crash", "start": 0.01, "end": 0.02, "node": 1}],
        record={"messages": True, "trajectory": 0.02},
    )
    folder = tmp_path_factory.mktemp("small")
    write(run(scenario, 3), folder, drawn=False)
    return folder


def rewritten(recorded, folder, change):
    """Write a copy of a run to a folder, with the events in its trace, as JSON has them, changed."""
    lines = [json.loads(line) for line in (recorded / "trace.jsonl").read_text().splitlines()]
    folder.mkdir()
    (folder / "run.json").write_bytes((recorded / "run.json").read_bytes())
    (folder / "trace.jsonl").write_text("".join(json.dumps(line) + "\n" for line in change(lines)))
    return folder


def first(lines, kind):
    """Return the place of the first event of a kind."""
    return next(k for k, line in enumerate(lines) if line["event"] == kind)


def with_field(kind, **fields):
    """Return what changes fields of the first event of a kind."""

    def change(lines):
        k = first(lines, kind)
        return [*lines[:k], lines[k] | fields, *lines[k + 1 :]]

    return change


def twice(kind):
    """Return what repeats the first event of a kind."""

    def change(lines):
        k = first(lines, kind)
        return [*lines[:k], lines[k], *lines[k:]]

    return change


def without_its_loss(lines):
    """Return the lines without the event that says that a message without an arrival was lost."""
    sent = next(each for each in lines if each["event"] == "Broadcast" and None in each["arrival"])
    node = sent["dst"][sent["arrival"].index(None)] if len(sent["arrival"]) > 1 else sent["dst"][0]
    said = {"event": "Lost", "transmission": sent["transmission"], "dst": node}
    k = next(k for k, each in enumerate(lines) if said.items() <= each.items())
    return [*lines[:k], *lines[k + 1 :]]


MISFITS = {
    "lost": (without_its_loss, "has no arrival at .*, but no event says that this message was lost"),
    "pursuer": (with_field("Decided", pursuer=99), "pursuer: should be less than"),
    "action": (with_field("Decided", active=99), "active: should be less than or equal to"),
    "places": (with_field("Sampled", pursuers=[["x", "y"]]), "pursuers.0.0: should be a number"),
    "too few places": (with_field("Sampled", pursuers=[[0.0, 1.0]]), "pursuers: Tuple should have at least"),
    "evaders": (with_field("Sampled", evaders=[[0.0, 1.0]] * 9), "evaders: Tuple should have at most"),
    "arrivals": (with_field("Broadcast", arrival=[0.1] * 99), "has .* receivers? and 99 arrivals"),
    "transmission": (with_field("Lost", transmission=1 << 40), f"loses a message that was not sent: {1 << 40} to "),
    "order": (with_field("Ended", t=0.0), "is earlier than the line before"),
    "start": (twice("Started"), "is a second Started"),
    "end": (twice("MessageCounts"), "is a second MessageCounts"),
    "broken": (
        with_field("FaultStarted", fault={"kind": "crash", "start": 0.0, "node": 2}),
        "names a node that is not one of",
    ),
    "repaired": (
        with_field("FaultEnded", fault={"kind": "crash", "start": 0.9, "node": 1}),
        "ends a fault that did not begin",
    ),
    "kind of fault": (
        with_field("FaultStarted", fault={"kind": "cats"}),
        "fault: there is no 'cats'; allowed: crash, ",
    ),
    "no fault": (with_field("FaultStarted", fault=7), "fault: "),
}


@pytest.mark.parametrize("name", MISFITS)
def test_an_event_that_does_not_fit_the_others_is_named(name, small, tmp_path):
    change, told = MISFITS[name]
    with pytest.raises(ValueError, match=rf"trace\.jsonl: line \d+ (is not an event: )?{told}"):
        read(rewritten(small, tmp_path / "x", change))


@pytest.mark.parametrize(
    "events",
    [
        (Broadcast(1, 4, 0, 0, (1, 2), (LOST, 9), 0, 8, "a"),),
        (Queued(1, 4, 0, (1,), 8), Sent(1, 4, 0, 1, LOST, 0, 8, "a")),
    ],
)
def test_a_message_without_an_arrival_has_an_event_that_says_that_it_was_lost(events):
    said = [*events, Lost(1, 4, 0, 1, "link")]
    assert [*inconsistencies(said)] == []
    assert [*inconsistencies(events)] == [
        (len(events), "has no arrival at 1, but no event says that this message was lost")
    ]
    assert [*inconsistencies(said[-1:])] == [(1, "loses a message that was not sent: 4 to 1")]


@dataclass(frozen=True)
class Body:
    """A body of a user, whose fields are those of announcements by chance."""

    active: Any = None
    records: Any = None
    news: Any = 0


FIELDS = [
    *({"active": active} for active in (0, 1, 7, -1, 2**80, True, "x", 1.0, [1])),
    *({"records": (Record(src, 5, 0, Body(1)),)} for src in (1, 99, -1, "a", 2**70, None)),
    *({"records": (Record(1, seq, stamp, Body(7)),)} for seq, stamp in ((2**70, 0), (5, 2**70), (-1, 0), ("a", 0))),
    *({"records": records} for records in ((), [], [Record(1, 5, 0, Body(0))], (1, 2), "x", {})),
]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["announced", "sent"])
@pytest.mark.parametrize("make", [dict, Body], ids=["dict", "dataclass"])
def test_a_body_of_a_user_is_read_whatever_its_fields_mean(make, how, tmp_path):
    """The trace that is read gives the same figures and pages, although an object in it has another type."""

    def protocol(me):
        for fields in FIELDS:
            if how == "announced":
                me.set_payload(make(**fields))
                me.broadcast()
            else:
                me.send(None, make(**fields), size=10)
            yield me.sleep(0.02)

    given = Scenario(
        team=Team(count=3, speeds=0.1),
        evader=Evader(position=(100.0, 100.0)),
        protocol=protocol,
        horizon=0.02 * len(FIELDS),
        record=Recording(messages=True),
        announce=Announcements(trigger="never"),
    )
    result = run(given, 1)
    write(result, tmp_path)
    trace = Trace()
    trace.events += events(tmp_path)
    again = Result(given, 1, trace)
    assert repr(summary(again)) == repr(summary(result))
    assert knowledge(again).tolist() == knowledge(result).tolist()
    assert replay_page(again) == replay_page(result)
    spacetime(again, 0.0, 0.3)


WRONG = ("x", "", -1, 0, 1.5, 999, 10**18, 10**400, -1e300, inf, nan, None, True, [], [1], {}, {"a": 1})


def mutated(rng, value):
    """Return a value, or one somewhere in it, as another."""
    if isinstance(value, list) and value and rng.random() < 0.7:
        k = rng.randrange(len(value))
        return [*value[:k], mutated(rng, value[k]), *value[k + 1 :]]
    if isinstance(value, dict) and value and rng.random() < 0.8:
        key = rng.choice(sorted(value))
        return value | {key: mutated(rng, value[key])}
    near = (value + 1, value * 2) if isinstance(value, int | float) else ()
    return rng.choice([*WRONG, *near, *((value[:-1], value * 2) if isinstance(value, list) else ())])


def mutant(seed):
    """Return what changes a field, or the place, of an event: each kind is as likely as any other."""
    rng = random.Random(seed)

    def change(lines):
        kind = rng.choice(sorted({line["event"] for line in lines}))
        k = rng.choice([k for k, line in enumerate(lines) if line["event"] == kind])
        line = dict(lines[k])
        key, way = rng.choice(sorted(line)), rng.random()
        if way < 0.8:
            return [*lines[:k], line | {key: mutated(rng, line[key])}, *lines[k + 1 :]]
        return [*lines[:k], *([line, line] if way < 0.9 else []), *lines[k + 1 :]]

    return change


SHOWN = (["replay"], ["plot", "--kind", "perfetto"], ["plot", "--kind", "spacetime", "-o", "x.svg"])


def shown_or_refused(recorded, folder, seeds):
    """Check that errors in a trace are reported with its file, or harm no reader."""
    outcomes = set()
    for seed in seeds:
        copy = rewritten(recorded, folder / f"{recorded.name} {seed}", mutant(seed))
        for words in SHOWN:
            done = CliRunner().invoke(main, [*words, str(copy)], catch_exceptions=False)
            outcomes.add(done.exit_code)
            assert done.exit_code in {0, 2}, (seed, done.output)
            if done.exit_code:
                assert done.stderr.startswith(str(copy)), (seed, done.stderr)
                break
    assert outcomes == {0, 2}


@pytest.mark.whole
@pytest.mark.parametrize("name", ["faults", "radio", "many", "flooding"])
def test_runs_of_any_kind_with_wrong_lines_are_refused_or_shown(name, tmp_path, monkeypatch):
    few = ["team.count=6"] if name in {"radio", "flooding"} else []
    with pytest.MonkeyPatch.context() as patch:
        undraw(patch)
        short = record(tmp_path / name, name, f"horizon={1.0 if name == 'faults' else 0.5}", *few)
    monkeypatch.chdir(tmp_path)
    shown_or_refused(short, tmp_path, range(1000, 1004))


@pytest.mark.slow
def test_the_traces_of_two_runs_in_one_file_are_refused_event_by_event_too(tmp_path):
    """An exporter reads a trace as a stream: `cat` of two would be rows of both."""
    write(run(Scenario(horizon=0.1, team=Team(count=2)), 1), tmp_path)
    trace = tmp_path / "trace.jsonl"
    content = trace.read_text(encoding="utf-8")
    trace.write_text(content * 2, encoding="utf-8")
    with pytest.raises(ValueError, match=rf"line {len(content.splitlines()) + 1} is earlier than the line before"):
        list(events(tmp_path))

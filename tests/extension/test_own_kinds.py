"""Kinds of users, one of each family, from a single module outside of desim: in files, pages, reports and errors."""

import ast
import json
import re
import shutil
import sys
from pathlib import Path

import pytest

import desim
from desim import Bitrate, Evader, Links, Scenario, Team, run, summary
from desim.cli.output import RAISED
from desim.kernel.core.events import Broadcast, Lost, MessageCounts
from desim.kernel.models.faults import cause_of
from desim.kernel.models.traced_faults import CustomFault, FaultEnded, FaultStarted
from desim.pursuit.byzantine.lies import ByzantineFault
from desim.pursuit.motion.environment import Environment
from desim.pursuit.sensing.sensing import Sensing
from desim.pursuit.team.announcements import Announcements, Assignment
from desim.results import run_folder
from desim.scenario.scenario import Recording
from desim.scenario.toml import dump, load
from desim.testing.messages import Conservation
from desim.view.formats.perfetto import perfetto
from desim.view.pages.replay import replay_page
from protocols import BinaryLogLinear, SpatialAdaptivePlay
from tests.command import accepted, refused
from tests.command import desim as command

MESSAGES = Recording(messages=True)
MODULE = Path(__file__).parent / "own_kinds.py"
ROOT = MODULE.parents[2]
IN_FLOW = """
horizon = 3.0
protocol = "own_kinds:Eager"
team.count = 4
evader.strategy = "own_kinds:feint"
network.latency = { kind = "own_kinds:Sawtooth", step = 0.02 }
network.loss = { kind = "own_kinds:Fog", p = 0.25 }
announce.trust = { kind = "own_kinds:Sceptic", limit = 2 }
environment.flow = { kind = "own_kinds:Wind", speed = 0.2 }
record = { messages = true, trajectory = 0.1, metrics = ["own_kinds:events_per_second"] }

[[fault]]
kind = "own_kinds:LinkDown"
start = 0.5
end = 1.5
ends = [0, 1]

[[fault]]
kind = "own_kinds:storm"
"""
WITH_INERTIA = """
horizon = 2.0
protocol = { kind = "sap", schedule = "own_kinds:Staggered" }
team = { count = 3, dynamics = "own_kinds:Lag" }
record.messages = true
"""

IN_NOISE = """
horizon = 2.0
protocol = { kind = "binary_log_linear", utility = { kind = "own_kinds:Margin", bonus = 0.1 }, tau = "own_kinds:Warm" }
team = { count = 5, guidance = "own_kinds:straight" }
sensing = { estimate = "hold", noise = { kind = "own_kinds:Grain", deviation = 0.2 } }
announce = { heartbeat = 0.2, dissemination = { kind = "own_kinds:Stutter", times = 3 } }
network = { graph = "own_kinds:wheel", range = 15.0, reception = "own_kinds:Ramp", medium = "own_kinds:Morse" }
record.messages = true

[[fault]]
kind = "own_kinds:Sleeper"
start = 0.5
node = 1
"""
ON_A_CHANNEL = """
horizon = 2.0
team.count = 5
announce.heartbeat = 0.2
network.medium = { kind = "bitrate", bitrate = 5e4, access = "aloha", reception = "own_kinds:Lottery" }
record.messages = true
"""
FILES = {"flow": IN_FLOW, "inertia": WITH_INERTIA, "noise": IN_NOISE, "channel": ON_A_CHANNEL}


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """Return the folder of the module and of the scenario files; scripts import the module from there."""
    folder = tmp_path_factory.mktemp("own")
    shutil.copy(MODULE, folder)
    for name, text in FILES.items():
        (folder / f"{name}.toml").write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        yield folder
        sys.modules.pop("own_kinds", None)


@pytest.fixture(scope="module")
def result(own):
    """Return a run of the first file, watched."""
    return run(load(own / "flow.toml", allow_import=True), 1, Conservation())


def in_python():
    """Return the scenarios of the files as a script constructs them."""
    import own_kinds as kinds

    flow = Scenario(
        horizon=3.0,
        protocol=kinds.Eager(),
        team=Team(count=4),
        evader=Evader(strategy=kinds.feint),
        network=Links(latency=kinds.Sawtooth(step=0.02), loss=kinds.Fog(p=0.25)),
        announce=Announcements(trust=kinds.Sceptic(limit=2)),
        environment=Environment(flow=kinds.Wind(speed=0.2)),
        record=Recording(messages=True, trajectory=0.1, metrics=(kinds.events_per_second,)),
        fault=(kinds.LinkDown(start=0.5, end=1.5, ends=(0, 1)), kinds.storm),
    )
    inertia = Scenario(
        horizon=2.0,
        protocol=SpatialAdaptivePlay(schedule=kinds.Staggered()),
        team=Team(count=3, dynamics=kinds.Lag()),
        record=Recording(messages=True),
    )
    noise = Scenario(
        horizon=2.0,
        protocol=BinaryLogLinear(utility=kinds.Margin(bonus=0.1), tau=kinds.Warm()),
        team=Team(count=5, guidance=kinds.straight),
        sensing=Sensing(estimate="hold", noise=kinds.Grain(deviation=0.2)),
        announce=Announcements(heartbeat=0.2, dissemination=kinds.Stutter(times=3)),
        network=Links(graph=kinds.wheel, range=15.0, reception=kinds.Ramp(), medium=kinds.Morse()),
        record=Recording(messages=True),
        fault=(kinds.Sleeper(start=0.5, node=1),),
    )
    channel = Scenario(
        horizon=2.0,
        team=Team(count=5),
        announce=Announcements(heartbeat=0.2),
        network=Links(medium=Bitrate(bitrate=5e4, access="aloha", reception=kinds.Lottery())),
        record=Recording(messages=True),
    )
    return {"flow": flow, "inertia": inertia, "noise": noise, "channel": channel}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:announce")
@pytest.mark.parametrize("name", FILES)
def test_a_file_and_a_script_give_the_same_run(own, name):
    of_file = run(load(own / f"{name}.toml", allow_import=True), 1)
    of_script = run(in_python()[name], 1)
    assert list(map(repr, of_file.trace)) == list(map(repr, of_script.trace))
    assert len(of_file.trace) > 20


def test_a_fault_of_a_user_has_a_cause_a_record_and_a_sketch(result):
    started, ended = result.trace.of(FaultStarted), result.trace.of(FaultEnded)
    assert {type(event.fault) for event in started} == {CustomFault}
    assert {event.fault.model.rpartition(":")[2] for event in started} == {"LinkDown"}
    assert [event.fault.nodes for event in started if event.t == 500_000_000] == [(0, 1)]
    assert len(started) == len(ended) == 2
    assert {event.cause for event in result.trace.of(Lost)} == {"fog", "cable"}
    for event in result.trace.of(Lost):
        if event.cause == "cable":
            assert {event.src, event.dst} in ({0, 1}, {0, 3})


def test_nothing_passes_a_link_that_is_down(result):
    for event in result.trace:
        for dst, arrival in event.fates() if hasattr(event, "transmission") and hasattr(event, "fates") else ():
            if {event.src, dst} == {0, 1} and arrival >= 0:
                assert not 500_000_000 <= event.t < 1_500_000_000


def test_pages_draw_kinds_of_users(result):
    data = re.search(r"<script[^>]*application/json[^>]*>(.*?)</script>", replay_page(result), re.DOTALL)
    page = replay_page(result) if data is None else data[1]
    assert '"label": "LinkDown"' in page or '"label":"LinkDown"' in page
    assert "cable" in page
    assert "LinkDown" in perfetto(result)
    assert "cable" in str(summary(result))


@pytest.mark.whole
def test_a_recorded_run_is_read_and_shown_without_the_code_of_its_faults(own, result, tmp_path):
    run_folder.write(result, tmp_path / "out")
    again = run_folder.read(tmp_path / "out", allow_import=True)
    assert again.trace.of(FaultStarted) == result.trace.of(FaultStarted)
    accepted("export", tmp_path / "out", tmp_path / "x.csv")  # nobody allowed an import
    assert "LinkDown" in (tmp_path / "x.csv").read_text()
    accepted("plot", tmp_path / "out", "--kind", "spacetime", "--allow-import", "-o", tmp_path / "x.svg")


def test_an_exporter_of_a_user_gets_the_result(own, result, tmp_path):
    import own_kinds as kinds

    count = desim.export(result, tmp_path / "a.edges", kinds.Edges())
    assert count == len((tmp_path / "a.edges").read_text().splitlines()) == 12
    assert desim.export(result, tmp_path / "b.edges", {"kind": "own_kinds:Edges", "directed": False}) == 6
    assert desim.export(result, tmp_path / "f", lambda result, file: file.write_text(result.scenario.name)) > 0
    with pytest.raises(ValueError, match=r"x\.dot: should end in \.edges"):
        desim.export(result, tmp_path / "x.dot", kinds.Edges())
    with pytest.raises(ValueError, match="should write the file"):
        desim.export(result, tmp_path / "x.edges", lambda result, file: None)


def test_an_exporter_with_state_writes_each_file_as_its_first(result, tmp_path):
    class Numbered:
        def __init__(self):
            self.files = 0

        def __call__(self, result, file):
            self.files += 1
            file.write_text(str(self.files))

    exporter = Numbered()
    for _ in range(2):
        desim.export(result, tmp_path / "f", exporter)
        assert (tmp_path / "f").read_text() == "1"


@pytest.mark.slow
def test_an_exporter_is_named_on_the_command_line(own, tmp_path):
    options = "--exporter", "own_kinds:Edges"
    said = accepted("export", own / "flow.toml", tmp_path / "x.edges", "--allow-import", *options).stderr
    assert said == f"wrote 12 edges to {tmp_path / 'x.edges'}\n"
    assert "names code to be run" in refused("export", own / "flow.toml", tmp_path / "x.edges", *options)


WRONG = {
    "network.latency.step": '{ kind = "own_kinds:Sawtooth", step = -1.0 }',
    "network.loss.p": '{ kind = "own_kinds:Fog", p = 2.0 }',
    "announce.trust.limit": '{ kind = "own_kinds:Sceptic", limit = "many" }',
    "environment.flow.speed": '{ kind = "own_kinds:Wind", speed = "fast" }',
    "fault.0.ends.1": '{ kind = "own_kinds:LinkDown", start = 0.5, ends = [0] }',
    "fault.0.end": '{ kind = "own_kinds:LinkDown", start = 0.5, end = 0.1, ends = [0, 1] }',
    "protocol.tau": '{ kind = "own_kinds:Eager", tau = 1.0 }',
}


@pytest.mark.parametrize("key", WRONG)
def test_an_error_in_a_field_names_file_line_and_key(own, key):
    table = key.partition(".0")[0] if key.startswith("fault") else key.rpartition(".")[0]
    value = f"[{WRONG[key]}]" if key.startswith("fault") else WRONG[key]
    file = own / "wrong.toml"
    file.write_text(f"team.count = 4\n{table} = {value}\n")
    with pytest.raises(ValueError) as error:
        load(file, allow_import=True)
    (problem,) = error.value.problems
    assert (problem.key, problem.where, problem.line) == (key, f"{file}:2", 2)
    assert str(error.value) == f"{file}:2: {key}: {problem.reason}"


def test_a_node_that_does_not_exist_is_reported_at_the_key_of_the_fault(own):
    import own_kinds as kinds

    with pytest.raises(ValueError, match=r"fault\.0\.ends: there is no pursuer 9"):
        Scenario(team=Team(count=4), fault=(kinds.LinkDown(start=0.0, ends=(0, 9)),))


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (
            {"begin": lambda self, site: None},
            r"begin\(site\) of a fault should return a function without arguments.* from Bad",
        ),
        ({"begin": lambda self, site: lambda late: None}, r"should accept a call without arguments; <lambda> \(tests"),
        (
            {"begin": lambda self, site: site.block(lambda src, dst: "no")},
            r"should return True or False, got 'no' from",
        ),
        ({"begin": lambda self, site: site.block(lambda src: True)}, r"should accept a call with \(src, dst\)"),
        ({"begin": lambda self, site: site.block(3)}, "should be given a function of two nodes"),
        ({"begin": lambda self, site: site.partition([[0, 77]])}, "there is no node 77"),
        ({"begin": lambda self, site: site.partition([0, 1])}, r"partition\(groups\) should be given lists of nodes"),
        ({"begin": lambda self, site: site.partition(None)}, r"partition\(groups\) should be given lists of nodes"),
        ({"begin": lambda self, site: site.begin(desim.Crash)}, r"begin\(fault\) should be given a fault"),
        ({"begin": lambda self, site: site.crash(0)}, r"crash\(crash\) should be given a Crash.*got 0"),
        ({"begin": lambda self, site: site.crash(desim.Crash(start=0.0, node=77))}, "crash: there is no node 77"),
        ({"begin": lambda self, site: site.begin(desim.Crash(start=0.0, node=77))}, "crash.node: there is no node 77"),
        ({"begin": lambda self, site: site.begin({"kind": "crash", "node": 0})}, "should be given a fault"),
        ({"begin": lambda self, site: site.jam((0.0, 0.0), float("nan"))}, "radius: should be a finite number"),
        ({"begin": lambda self, site: print, "sketch": lambda self: 3}, r"sketch\(\) of a fault should return a dict"),
        ({"begin": lambda self, site: print, "sketch": lambda self: {"at": 1j}}, "should return JSON values"),
    ],
)
def test_a_fault_that_is_written_wrongly_is_told_what_is_wrong(body, why):
    wrong = type("Bad", (desim.Fault,), {"__module__": __name__, **body})(start=0.1)
    with pytest.raises(ValueError, match=why):
        run(Scenario(horizon=1.0, fault=(wrong,)), 1)


@pytest.mark.slow
def test_a_fault_may_begin_others(own):
    """They are recorded, too: a crash that is a part of a fault is a crash to all pages and metrics."""

    class Brownout(desim.Fault):
        nodes: tuple[int, ...]

        def named(self):
            return {"nodes": self.nodes}

        def begin(self, site):
            ends = [site.begin(desim.Crash(node=node, start=self.start, end=self.end)) for node in self.nodes]
            return lambda: [end() for end in ends]

    made = run(Scenario(horizon=2.0, fault=(Brownout(start=0.5, end=1.0, nodes=(1, 3)),)), 1, Conservation())
    plain = run(Scenario(horizon=2.0, fault=tuple(desim.Crash(node=k, start=0.5, end=1.0) for k in (1, 3))), 1)
    kinds = [event.fault.kind for event in made.trace.of(FaultStarted)]
    assert kinds == ["custom", "crash", "crash"]
    rest = [event for event in made.trace if getattr(getattr(event, "fault", None), "kind", "") != "custom"]
    assert sorted(map(repr, rest)) == sorted(map(repr, plain.trace))


class Blackout(desim.Fault):
    """Takes node 0 down without asking the site to begin a fault."""

    def begin(self, site):
        return site.crash(desim.Crash(start=self.start, node=0, memory=False))


class Reset(desim.Crash):
    """Begins as a crash does, in a method of its own."""

    def begin(self, site):
        return super().begin(site)


@pytest.mark.slow
@pytest.mark.parametrize("fault", [Blackout(start=0.5, end=2.0), Reset(start=0.5, end=2.0, node=0, memory=False)])
def test_a_crash_by_a_fault_of_a_user_is_a_crash_in_the_trace(fault):
    """Metrics, properties and invariants know from it who is down, and who forgets; its losses have the cause."""
    crash = desim.Crash(start=0.5, end=2.0, node=0, memory=False)
    made, plain = (
        run(Scenario(horizon=3.0, fault=(single,), record=MESSAGES), 1, Conservation()) for single in (fault, crash)
    )
    for kind in FaultStarted, FaultEnded:
        times = [(event.t, event.fault.kind, event.fault.named()) for event in made.trace.of(kind)]
        (event,) = plain.trace.of(kind)
        assert (event.t, "crash", {"node": [0]}) in times
        assert len(times) == 2
    assert desim.judge("down never longer than 1", made).margin == desim.judge("down never longer than 1", plain).margin
    assert desim.summary(made).belief_error == desim.summary(plain).belief_error
    cause = cause_of(fault)
    assert made.trace.of(MessageCounts)[0].lost_by[cause] == plain.trace.of(MessageCounts)[0].lost_by["crash"] > 0


@pytest.mark.whole
def test_a_report_of_a_sweep_names_kinds_of_users(own, tmp_path):
    grid = "-g", "network.loss.p=0.0,0.5", "--set", "horizon=0.6", "-n", 2
    accepted("sweep", own / "flow.toml", "--allow-import", *grid, "-o", tmp_path / "sweep")
    accepted("report", tmp_path / "sweep", "-o", tmp_path / "report.html")
    report = (tmp_path / "report.html").read_text()
    assert all(word in report for word in ("own_kinds:LinkDown", "own_kinds:Eager", "events_per_second"))


@pytest.mark.whole
def test_an_explanation_removes_kinds_of_users(own, tmp_path):
    words = "--set", "horizon=0.6", "-n", 2, "--json", "-o", tmp_path / "e"
    told = json.loads(accepted("explain", own / "flow.toml", "--allow-import", *words).stdout)
    assert told["costs"]["end_time"]["parts"].keys() >= {"latency", "loss", "faults", "flow"}


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ({}, r"should have a method begin\(site\)"),
        ({"begin": lambda self: print}, r"should accept a call with \(site\); Bad"),
        (
            {"begin": lambda self, site: print, "named": lambda self: [0]},
            r"named\(\) of a fault should return the numb",
        ),
        ({"begin": lambda self, site: print, "breaks": frozenset({"no_crash"})}, "breaks of Bad: .*'no_crashes'"),
    ],
)
def test_a_fault_that_cannot_be_one_is_refused_before_the_run(body, why):
    with pytest.raises(ValueError, match=why):
        Scenario(fault=(type("Bad", (desim.Fault,), {"__module__": __name__, **body})(start=0.1),))


def test_a_byzantine_fault_of_a_user_replaces_what_a_pursuer_says(own):
    """It is named by its class, and everything that it does not override is honest."""

    class Boaster(ByzantineFault):
        evader: int = 0

        def says(self, me, body):
            return me.id, Assignment(self.evader)

    silent = Scenario(horizon=1.0, team=Team(count=3, speeds=2.0), protocol=lambda me: iter(()), record=MESSAGES)
    lying = silent.with_({"fault": (Boaster(node=1, start=0.0),), "announce.heartbeat": 0.1})
    said = {event.src: event.body.active for event in run(lying, 1).trace.of(Broadcast)}
    assert said[1] == 0
    assert said[0] == said[2] == 1
    assert {event.fault.label for event in run(lying, 1).trace.of(FaultStarted)} == {"Boaster 1"}


def test_a_parameter_of_a_user_without_a_value_is_written_to_no_file(own):
    """TOML has no null: a scenario with such a kind could be neither printed nor stored."""

    class Perhaps(desim.config.model.Value):
        wavelength: float | None = None

        def __call__(self, context, rng):
            return 0.1

    assert "wavelength" not in dump(Scenario(network=Links(latency=Perhaps())))


def lines_of(definition):
    """Return the number of lines of a class or function, without docstrings and empty lines."""
    text = ast.unparse(definition)
    documented = [node for node in ast.walk(definition) if isinstance(node, ast.ClassDef | ast.FunctionDef)]
    prose = sum(ast.get_docstring(node) is not None for node in documented)
    return sum(1 for line in text.splitlines() if line.strip()) - prose


def test_the_page_counts_the_lines_of_each_kind():
    rows = (ROOT / "docs/howto/own_kinds.md").read_text().partition("|---|")[2].splitlines()[1:]
    counts = [int(row.split("|")[-2]) for row in rows[: rows.index("")]]
    definitions = [
        node for node in ast.parse(MODULE.read_text()).body if isinstance(node, ast.ClassDef | ast.FunctionDef)
    ]
    assert sorted(counts) == sorted(map(lines_of, definitions))


RANDOM = """
horizon = 3.0
team.count = 4

[[fault]]
kind = "random"
rate = 5.0
kinds = ["partition", "own_kinds:LinkDown"]
"""


def test_random_faults_draw_those_of_a_user(own):
    """In a file they are code, which a file that is not trusted cannot name."""
    file = own / "random.toml"
    file.write_text(RANDOM)
    scenario = load(file, allow_import=True)
    kinds = [event.fault.kind for event in run(scenario, 1).trace.of(FaultStarted)]
    assert set(kinds) == {"custom", "partition"}
    assert load_text(dump(scenario), own) == scenario
    with pytest.raises(ValueError, match=r"random\.toml:8: fault\.0\.kinds\.1: .*names code to be run"):
        load(file)
    with pytest.raises(ValueError, match=r"kinds\.0: should be crash, partition, jamming, or .*did you mean .cra"):
        desim.RandomFaults(kinds=("crsh",))


def load_text(text, folder):
    """Return the scenario of a text, as a file in a folder."""
    (folder / "again.toml").write_text(text)
    return load(folder / "again.toml", allow_import=True)


@pytest.mark.parametrize("key", ["network.medium.access", "network.transport", "sensing.estimator", "clocks.sync"])
def test_a_closed_family_says_from_which_kinds_a_class_may_derive(own, key):
    (own / "closed.toml").write_text(
        f'network.medium.kind = "bitrate"\nnetwork.medium.bitrate = 1e6\n{key} = "own_kinds:Eager"\n'
        if "medium" in key
        else f'{key} = "own_kinds:Eager"\n'
    )
    with pytest.raises(ValueError, match="should be derived from"):
        load(own / "closed.toml", allow_import=True)


def test_a_wrong_answer_names_the_model_the_file_and_the_line(own, monkeypatch):
    """The command prints this sentence, and no traceback of desim."""
    (own / "late.py").write_text("def late(context, rng):\n    return -0.1\n")
    (own / "late.toml").write_text('network.latency = "late:late"\n')
    monkeypatch.chdir(own)
    result = command("run", "late.toml", "--allow-import")
    assert result.exit_code == RAISED
    assert result.stderr == "latencies should be finite times >= 0 s, got -0.1 from late (late.py, line 1)\n"

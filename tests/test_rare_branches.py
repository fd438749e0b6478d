"""Branches that runs seldom reach, asked for directly: of each an expression and its value, or what it refuses."""

import os
import pickle
import sys
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from io import BytesIO
from itertools import count, cycle, repeat
from math import inf, isnan
from pathlib import Path
from queue import SimpleQueue
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from click import Context

import desim
from desim import Constant, Crash, Fault, Links, Scenario
from desim.analysis.control_variates import ControlledEstimate
from desim.analysis.drawing.plots import in_style
from desim.analysis.metrics import Summary
from desim.analysis.properties import margin
from desim.analysis.statistics import differences, mean
from desim.cli import main
from desim.cli.usage import _context_of
from desim.config import calls, fresh, packages, stateless, trust
from desim.config.arguments import missing_attribute
from desim.config.code_variables import _modules_of
from desim.config.copier import Describer
from desim.config.errors import KeyedError, NoMetricError, Problem
from desim.config.json_numbers import to_json
from desim.config.key_errors import _with_file
from desim.config.key_suggestions import other_key
from desim.config.model import MAX_TIME
from desim.config.python_numbers import _is_endless, as_real, real
from desim.kernel.channel.transmitter import Transmitter
from desim.kernel.clock_sync import REMEMBERED as ANSWERS
from desim.kernel.clock_sync import Synchroniser, TimeAnswer, TimeRequest
from desim.kernel.core.clock import Clock, Phase
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.message_body import _is_frozen
from desim.kernel.core.message_size import size
from desim.kernel.core.records import Record
from desim.kernel.core.units import SECOND
from desim.kernel.link_layer.arrival_losses import ArrivalLosses
from desim.kernel.measured.models import LatencyTrace, LossTrace
from desim.kernel.models.graphs import Edges
from desim.kernel.models.interference import unknown_channel
from desim.kernel.models.link_draws import as_booleans
from desim.kernel.models.loss import _ByKnownDistance
from desim.kernel.models.reception import Disk
from desim.kernel.models.traced_faults import CustomFault, Misbehaviour
from desim.kernel.state.fault_state import _checked_delays
from desim.kernel.state.inbox import Message
from desim.kernel.state.transmission import Flight
from desim.kernel.topology.correlated_channel import _missing, unknown_fading
from desim.kernel.topology.topology import Topology
from desim.kernel.transport.frames import CodedPiece
from desim.kernel.transport.receiver import REMEMBERED, CodedReceiver
from desim.pursuit.byzantine import lies
from desim.pursuit.byzantine.lies import Liar, Spoof, draw_lies
from desim.pursuit.byzantine.speaker import Speaker
from desim.pursuit.game.game import greedy_maximal_independent_set
from desim.pursuit.mobility.bonnmotion_file import _increase
from desim.pursuit.mobility.mobility_file import has_poses
from desim.pursuit.motion.dynamics import Acceleration
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.flow import NoFlow, RecordedFlow
from desim.pursuit.motion.turning import shortest_path
from desim.pursuit.paths.space import PLANE
from desim.pursuit.sensing.noisy_sensing import TrackingView
from desim.pursuit.sensing.sensing import spiral
from desim.pursuit.team.announcements import MAX_SEQ, MAX_STAMP, _is_record, relayed_records, with_records
from desim.pursuit.team.targeted_faults import NewsFault
from desim.pursuit.team.timing import MAX_AT_ONE_INSTANT, Timing
from desim.scenario.assumptions import times_known
from desim.scenario.overrides import Source
from desim.scenario.simultaneous import _instants
from desim.scenario.toml import looked_up_in
from desim.scenario.toml_lines import unreadable
from desim.simulation.restartable import _start_behaviour
from desim.simulation.world import initial_state
from desim.study.breaking.search import Violation
from desim.study.comparing.scores import Ratio
from desim.study.results.explanation import Explanation
from desim.study.store.file import view_of
from desim.study.sweeps.sweep_plan import SweepPlan
from desim.testing.faults import _check_drawn
from desim.testing.pursuits import _has_known_limit
from desim.view.formats.foxglove import PART, Scene
from desim.view.formats.trace_table import _checked_name
from desim.view.pages.play_server import _Handler
from protocols.schedules.periodic import Rounds
from protocols.schedules.synchronous import Synchronous
from protocols.schedules.token import TokenRing
from tests.test_kinds import families

SHORT = Scenario(horizon=0.01, team={"count": 2})
TURNING = SHORT.with_(
    {
        "team.dynamics": {"kind": "turn_rate", "limit": 1.0},
        "evader": [{"dynamics": {"kind": "turn_rate", "limit": 1.0}} for _ in range(2)],
    }
)
CONTEXT = {"src": 0, "dst": np.array([1, 2]), "now": 0.0}
LINKS = LinkContext(**CONTEXT)


class Mine(Fault):
    """A fault of a user without parameters."""

    kind: str = "mine"


class Indescribable(Mine):
    """A fault whose description is no JSON."""

    def begin(self, site):
        """Return what ends it."""
        return print

    def sketch(self):
        """Return a complex number."""
        return {"at": 1j}


class Lying(Liar):
    """A lie whose plan has something else."""

    def __call__(self, size, horizon, rng):
        """Return a crash."""
        return [Crash(node=0, start=0.1)]


class Infinity(float):
    """A float of a class of its own."""


async def coroutine(_):
    """A behaviour that awaits."""


def is_writeable(kind):
    """Return whether the positions of players with some dynamics can be written, at the start or later."""
    env, dynamics = Clock(), kind if kind == "simple" else {"kind": kind, "limit": 1.0}
    state = initial_state(env, SHORT.with_({"team.dynamics": dynamics}), 1)
    at_first = state.positions().flags.writeable
    env.advance(SECOND, env.event())
    return at_first or state.players.positions().flags.writeable


def first_headings(scenario, seed):
    """Return the headings of all players at the start."""
    state = initial_state(Clock(), scenario, seed)
    return state.players.courses(range(state.size + state.evader_count)).headings.tolist()


@dataclass(frozen=True)
class Lazy:
    """A frozen dataclass with an attribute that is computed when it is first read."""

    side: float = 1.0

    @cached_property
    def area(self):
        """The square of the side."""
        return self.side**2


MISBEHAVIOUR = Misbehaviour(start=0.0, node=1, model="liar", number=0)
TRACE = {"kind": "trace", "table": "t,value\n0,0.5\n"}
RECORD = Record(0, 1, 2, "body")
POSES = ["0 0 0 0 0 0 0 1", "1 0 0 0 0 0 0 1"]


def kept_after(before):
    """Return the beginnings of the transmissions that are kept if arrivals are decided from a time on, ns."""
    transmitter = SimpleNamespace(recent=[(begin, 1, 0) for begin in (0, 4, 5, 9)], _longest_airtime=2, _lag=1)
    Transmitter.forget(transmitter, before)
    return [begin for begin, _, _ in transmitter.recent]


def remembered(body, count):
    """Return the numbers of the requests, or of the answers, of which a synchroniser with two clocks has the times."""
    clock = SimpleNamespace(uncorrected=5, stamp=5)
    memory = SimpleNamespace(_asked=[{}], answered={}, _clocks=[clock, clock])
    for number in range(count):
        Synchroniser._stamp(memory, Message(0, 0, body(number)), 1)
    return [*(memory._asked[0] or memory.answered)]


TRACED = Links(
    graph={"kind": "edges", "nodes": 3, "edges": [{"src": 0, "dst": 1}, {"src": 1, "dst": 2, "latency": TRACE}]},
    latency=TRACE,
    link=[{"src": 0, "dst": 1, "loss": {"kind": "trace", "table": "t,value\n0,1\n"}}],
)


def received_while_transmitting(begin):
    """Yield whether a node that transmits at 0 .. 2 and 5 .. 7 ns does so during a reception of 1 ns."""
    transmitter = SimpleNamespace(during=lambda *_: {3: [(0, 2), (5, 7)]})
    arrivals = SimpleNamespace(_transmitter=transmitter, _processing=0)
    yield [*ArrivalLosses._while_transmitting(arrivals, [3], begin + 1, Flight(None, 1))] == [0]


NOBODY_LEFT = SimpleNamespace(id=0, view=SimpleNamespace(state=SimpleNamespace(at_large=[], position=abs)))


TWO_LINKS = "t,src,dst,value\n0,0,1,0.1\n10,0,1,0.2\n20,0,1,0.2\n0,1,0,0.3\n10,1,0,0.4\n"
RUN = Context(main.commands["run"], info_name="run")
PROGRAM = Context(main, info_name="desim")


def victims(size):
    """Return the pursuers in whose names pursuer 1 announces, of a team of some size."""
    me = SimpleNamespace(id=1, rng=np.random.default_rng(1), view=SimpleNamespace(state=SimpleNamespace(size=size)))
    forger = SimpleNamespace(victim=None, action=0, falsified=lambda other, body, action: body)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lies, "replace", lambda _, **named: SimpleNamespace(action=abs))
        return {Spoof.says(forger, me, None)[0] for _ in range(30)}


def size_of_marks(places):
    """Return the size, m, of the marks of players at some places."""
    scene = SimpleNamespace()
    start = SimpleNamespace(active=(0,), pursuers=places[:1], evaders=places[1:])
    Scene._start(scene, start)
    return scene._size


def waits(count, instant):
    """Return how often a pursuer has waited for the present, which is 0, if it did so already at an instant."""
    timing = SimpleNamespace(id=0, _env=Clock(), _waits=count, _instant=instant, _check_phase=abs)
    timing._standstill = RuntimeError
    Timing._event(timing, 0, Phase.DECISION)
    return timing._waits


def distances_asked_for():
    """Return the distances at which probabilities are computed for two messages of 0, one from elsewhere, and of 1."""
    used = []
    model = _ByKnownDistance(SimpleNamespace(probability=lambda distances: used.append(distances[0]) or distances))
    near, far = np.array([0.5]), np.array([1.0])
    for src, distances in ((0, near), (0, near), (0, far), (1, near)):
        context = LinkContext(src, np.array([2]), 0.0, known_distances=distances)
        model(context, np.random.default_rng(1))
    return used


class Slow(Acceleration):
    """Dynamics with a motion of their own, whose limit is not that of the base."""

    kind: str = "slow"

    def __call__(self, position, course, command):
        """Return a motion."""


class SlowWithLimits(Slow):
    """The same, which say what they limit."""

    limits: ClassVar[str] = "acceleration"


def sent_length(length):
    """Return the length that a server names before it sends."""
    sent = {}
    handler = SimpleNamespace(send_response=abs, send_header=sent.__setitem__, end_headers=dict)
    _Handler._begin(handler, "text/html", length)
    return sent.get("Content-Length")


def phi_of_a_liar(evader):
    """Return the capture time, s, that a pursuer knows for an evader, or for any of two."""
    view = SimpleNamespace(state=SimpleNamespace(at_large=[1, 2]), capture_times_of=lambda _, target: [5.0 / target])
    return Speaker.phi(SimpleNamespace(id=0, view=view), evader)


def raising(act):
    """Return the type and the text of what a call raises."""
    with pytest.raises(Exception, match=r".") as raised:
        act()
    return type(raised.value).__name__, str(raised.value)


VALUES = {
    "distances that are known": lambda: (
        LinkContext(**CONTEXT, known_distances=np.array([2.0, 3.0])).distances.tolist(),
        [2.0, 3.0],
    ),
    "a trace that is asked without a run": lambda: (
        (
            LatencyTrace(table="t,value\n0,0.5\n")(LINKS, None),
            LossTrace(table="t,value\n0,1\n")(LINKS, np.random.default_rng(1)).tolist(),
        ),
        (0.5, [True, True]),
    ),
    "the first headings of all players": lambda: (
        first_headings(TURNING, 7),
        [*TURNING.team.headings(7), *(evader.heading(7, k) for k, evader in enumerate(TURNING.evaders))],
    ),
    "positions that are shared": lambda: ([*map(is_writeable, ("simple", "turn_rate", "acceleration"))], [False] * 3),
    "the independent set of those that are nearest": lambda: (
        [greedy_maximal_independent_set(phi, 3.0, [[1], [0, 2], [1]]) for phi in ([2.0, 1.0, 2.5], [2.0, 2.0, 3.0])],
        [(False, True, False), (True, False, False)],
    ),
    "a source that is looked up elsewhere": lambda: (
        looked_up_in(Source("f.toml", {}, Scenario, folder=Path("a")), Path("b")).folder,
        Path("b"),
    ),
    "the faults of a case": lambda: (
        Violation.faults.fget(SimpleNamespace(case={"latency": {"network.latency": 1}, "crash": {"fault": [1]}})),
        1,
    ),
    "the border of a disk": lambda: (
        Disk().received(np.array([1.0, 2.0, 2.1]), 2.0, None).tolist(),
        [True, True, False],
    ),
    "random parameters of a fault without any": lambda: (Mine.random_parameters(None), {}),
    "the pursuer of a lie": lambda: (Liar(node=1, start=0.0).named(), {"node": [1]}),
    "when a message was sent": lambda: (Message(0, 3 * SECOND // 2, None).sent, 1.5),
    "no flow": lambda: ((Environment().drift(1j, 1j, 0, 1.0), NoFlow().trend(0.0)), (0j, (0j, 0.0))),
    "straight ahead": lambda: (shortest_path(3.0 + 0j, 1.0), (3.0, 1.0)),
    "nearly straight ahead": lambda: (shortest_path(complex(3.0, -1e-17), 1.0)[0], 3.0),
    "a leg in the plane": lambda: (PLANE.leg(1 + 1j, 4 + 5j, 1.0), (3 + 4j, True)),
    "texts that are no times": lambda: (_increase(["a", "b"]), True),
    "late news": lambda: (NewsFault(start=0.0, delay=0.5).label, "news late"),
    "lost news": lambda: (NewsFault(start=0.0).label, "news lost"),
    "a schedule of all": lambda: ((ring := Synchronous(schedule=TokenRing())).for_all(), ring),
    "rounds of all": lambda: (Rounds(period=0.5, participation=0.25).for_all(), Rounds(period=0.5)),
    "an estimate without an error": lambda: (
        ControlledEstimate(1.0, 0.0, 5, mean([1.0, 2.0, 3.0]), 0.5, 0.1, 3, 2.0).worth,
        inf,
    ),
    "no pairs": lambda: (differences(np.array([]), np.array([])).tolist(), []),
    "no reference of independent runs": lambda: (
        replace(SweepPlan.of(SHORT, {"team.count": [2, 3]}, 2), common=False).check_reference(None),
        None,
    ),
    "infinity of another class": lambda: (
        to_json([Infinity("inf"), Infinity(1.5), Infinity("-inf")]),
        ["Infinity", 1.5, "-Infinity"],
    ),
    "the first of several keys": lambda: (KeyedError(Problem("a", "first"), Problem("b", "second")).key, "first"),
    "an error that was sent": lambda: (
        (error := pickle.loads(pickle.dumps(NoMetricError("heat", "no heat"))))
        and (type(error), error.name, str(error)),
        (NoMetricError, "heat", "no heat"),
    ),
    "a queue that cannot be read": lambda: (Describer(BytesIO()).reducer_override(SimpleQueue()), (int, (0,))),
    "a missing attribute that is sent": lambda: (
        [(error := missing_attribute(3, "nope")).name, pickle.loads(pickle.dumps(error)).args],
        ["nope", ("an int has no 'nope'",)],
    ),
    "a file where none is read": lambda: (_with_file("a.csv", ("x",), None, None), ""),
    "a number that is too large": lambda: (isnan(as_real(10**400)), True),
    "iterators without an end": lambda: (
        [*map(_is_endless, (repeat(1), repeat(1, 3), count(), cycle([1]), iter([1])))],
        [False, False, True, True, False],
    ),
    "defaults that are constants": lambda: (
        [*map(stateless._is_constant, ((1, (2,)), (1, [2]), frozenset([1]), [1], lambda: 1))],
        [True, False, True, False, False],
    ),
    "a package that is not installed": lambda: (packages.check_visible("no_such_package"), None),
    "the size of sets": lambda: ([*map(size, ({1, 2}, frozenset([1, 2, 3]), range(3), set()))], [16, 24, 24, 0]),
    "a frozen class that computes later": lambda: (
        [*map(_is_frozen, (Lazy, dataclass(frozen=True)(type("Plain", (), {}))))],
        [False, True],
    ),
    "the node of a misbehaviour": lambda: (
        [MISBEHAVIOUR.named(), MISBEHAVIOUR.sketch()],
        [{"node": [1]}, {"node": 1, "model": "liar"}],
    ),
    "the nodes of a fault of a user in a trace": lambda: (
        CustomFault(start=0.0, model="a:B", nodes=(1, 2), drawn={}).named(),
        {"nodes": (1, 2)},
    ),
    "a lack of a channel": lambda: (_missing("it has none").key, "coherence"),
    "transmissions that are no longer needed": lambda: (
        [*map(kept_after, (0, 5, 6, 9, 10, 14))],
        [[0, 4, 5, 9], [0, 4, 5, 9], [4, 5, 9], [4, 5, 9], [5, 9], [9]],
    ),
    "the times of requests": lambda: (remembered(TimeRequest, ANSWERS + 1), [*range(1, ANSWERS + 1)]),
    "the times of answers": lambda: (
        remembered(lambda number: TimeAnswer(number, 3), 2 * ANSWERS + 1),
        [TimeAnswer(number, 3) for number in range(1, 2 * ANSWERS + 1)],
    ),
    "lines of poses": lambda: (
        [
            *map(
                has_poses,
                (POSES, ["# t", *POSES], POSES[::-1], POSES[:1], ["a b c d e f g h"] * 2, [POSES[0] + "1"] * 2),
            )
        ],
        [True, True, False, False, False, False],
    ),
    "a spiral of one point": lambda: (spiral(3.0, 0.0), 0j),
    "records in a relay": lambda: (
        [*map(relayed_records, ({"records": [RECORD]}, SimpleNamespace(records=(RECORD,)), {"records": [3]}, {}, 3))],
        [[RECORD], (RECORD,), None, None, None],
    ),
    "numbers of a record": lambda: (
        [
            _is_record(RECORD._replace(**{key: number}))
            for key, number in [
                *(("src", 0), ("seq", 0), ("seq", MAX_SEQ), ("stamp", MAX_STAMP), ("stamp", -MAX_STAMP)),
                *(("src", -1), ("seq", -1), ("seq", MAX_SEQ + 1), ("stamp", MAX_STAMP + 1), ("src", 0.5)),
            ]
        ],
        [True] * 5 + [False] * 5,
    ),
    "a relay with other records": lambda: (
        [with_records({"a": 1, "records": []}, [RECORD]), vars(with_records(SimpleNamespace(a=1), [RECORD]))],
        [{"a": 1, "records": (RECORD,)}] * 2,
    ),
    "tables of measurements on links and on edges of a graph": lambda: (
        [place for place, _ in TRACED.measured_tables()],
        [("latency",), ("link", 0, "loss"), ("graph", "edges", 1, "latency")],
    ),
    "frames that are forwarded at random times": lambda: (
        [*_instants(SHORT.with_({"announce": {"dissemination": "flooding", "jitter": 0.1}}))],
        [("announce.dissemination.jitter", "the receivers of a broadcast forward it", 1, (0.005, False, True))],
    ),
    "a reception during one of two transmissions": lambda: (
        [*received_while_transmitting(5), *received_while_transmitting(1), *received_while_transmitting(3)],
        [True, True, False],
    ),
    "a key under another table": lambda: (other_key(("a.horizn",), ["horizon"], Scenario), ", did you mean 'horizon'?"),
    "the least capture time of a liar": lambda: ([phi_of_a_liar(evader) for evader in (0, 1, 2)], [2.5, 5.0, 2.5]),
    "the capture time of a liar if no evader is left": lambda: (Speaker.least_phi(NOBODY_LEFT, 0), inf),
    "the mean of measurements of links with other times": lambda: (
        [LatencyTrace(table=TWO_LINKS, between=between).mean_latency() for between in ("hold", "linear")],
        pytest.approx([16.0 / 60.0, 15.5 / 60.0]),
    ),
    "lines of a TOML text that cannot be read": lambda: (
        [*map(unreadable, ("a = 1\nb = = 2\n", "a = 1\nb = " + "[" * 3000 + "]" * 3000, "a = 1\n"))],
        [2, 2, None],
    ),
    "the context of a command": lambda: (
        [_context_of(words, PROGRAM).info_name for words in (["--nope", "run", "f.toml"], ["nope"], [])],
        ["run", "desim", "desim"],
    ),
    "the context of no group": lambda: (_context_of(["run"], RUN), RUN),
    "the newest stamp of no sighting": lambda: (
        TrackingView._newest_stamp(SimpleNamespace(_newest={}, _tracks={1: {}}), 1),
        -1,
    ),
    "the victims of a forger": lambda: ([victims(size) for size in (1, 2, 3)], [{1}, {0}, {0, 2}]),
    "the size of marks": lambda: (
        [size_of_marks(places) for places in ([(0.0, 0.0), (4.0, 20.0)], [(0.0, 0.0), (20.0, 4.0)], [(1.0, 1.0)] * 2)],
        [PART * 20.0, PART * 20.0, 1.0],
    ),
    "waits for the present": lambda: (
        [waits(MAX_AT_ONE_INSTANT - 1, 0), waits(MAX_AT_ONE_INSTANT, -1)],
        [MAX_AT_ONE_INSTANT, 1],
    ),
    "a start just before the end of measurements": lambda: (
        [LatencyTrace(table="t,value\n0,0.5\n10,0.5\n", after="error", start=start).start for start in (0.0, 19.9)],
        [0.0, 19.9],
    ),
    "losses at distances that are kept, and at others": lambda: (distances_asked_for(), [0.5, 1.0, 0.5]),
    "a message at the last time": lambda: (
        [fate.t for fate in desim.fates([(MAX_TIME, 0, 1, 8)], 2, wait=0.0)],
        [MAX_TIME],
    ),
    "the length of what a server sends": lambda: ([sent_length(5), sent_length(None)], ["5", None]),
    "dynamics whose limit is known": lambda: (
        [*map(_has_known_limit, (Acceleration(), Slow(), SlowWithLimits(), Constant(value=0.1)))],
        [True, False, True, False],
    ),
    "a ratio to nothing": lambda: (isnan(Ratio.of(np.ones(3), np.zeros(3)).value), True),
}


@pytest.mark.parametrize("name", VALUES)
def test_a_branch_that_is_seldom_reached_has_this_value(name):
    value, wanted = VALUES[name]()
    assert value == wanted


def test_a_piece_that_is_too_old_is_dropped():
    receiver = CodedReceiver(0, 1)
    pieces = [CodedPiece("port", True, 0, seq, 1, "body") for seq in (500, 500 - REMEMBERED, 501 - REMEMBERED)]
    assert [len(list(receiver.receive(0, 7, piece))) for piece in pieces] == [1, 0, 1]


def step_of_closed_networks():
    with desim.SteppedNetworks(2, 3) as networks:
        assert [messages for messages in networks.step(0.1) if messages] == []
    networks.step(0.1)


REFUSED = {
    "a delay of no copy": (
        lambda: _checked_delays({1: []}, [1, 2], print),
        "a list of extra delays, in s, should not be empty, got {1: []} from",
    ),
    "a delay to another node": (
        lambda: _checked_delays({3: 0.5}, [1, 2], print),
        "delays(src, receivers, body) should name receivers of the message, got 3 from",
    ),
    "a negative delay": (
        lambda: _checked_delays({1: [0.5, -1.0]}, [1, 2], print),
        "an extra delay, in s, should be at least 0, got -1.0 from",
    ),
    "too few names of nodes": (
        lambda: desim.Edges(nodes=3, edges=[{"src": 0, "dst": 1}], names=("a", "b")),
        "names should be one per node (got 2 names for 3 nodes)",
    ),
    "networks that are closed": (step_of_closed_networks, "closed"),
    "losses that are numbers": (lambda: as_booleans([1, 0], desim.Bernoulli()), "losses should be booleans"),
    "an overlap without channels": (lambda: unknown_channel(None), "shadowing needs the states of the channels"),
    "a fading without processes": (lambda: unknown_fading(3), "the fading has no processes unless network.fading"),
    "lies that are none": (
        lambda: draw_lies([Lying(node=0, start=0.0)], 2, 1.0, 1),
        "a plan of lies should return or yield Byzantine faults",
    ),
    "velocities out of order": (
        lambda: RecordedFlow(velocities=[(1.0, 0.0, 0.0), (1.0, 1.0, 0.0)]),
        "velocities.1: t should increase; after 1 s comes 1 s",
    ),
    "a behaviour that awaits": (lambda: _start_behaviour(coroutine, None), "should have `def` and `yield` in place of"),
    "an unknown property": (
        lambda: margin(desim.run(SHORT, 1), "nope"),
        "the scenario has no property 'nope'; it has none",
    ),
    "a metric of before": (
        lambda: Summary({}).energy,
        "the run has no 'energy': it was stored before this metric existed",
    ),
    "an explanation of nothing": (
        lambda: Explanation.of({"name": "a", "runs": 1, "failed": 0, "absent": [], "costs": {}}),
        "is not an explanation: has no costs",
    ),
    "a metric that is no name": (lambda: view_of(["a", "b c"]), "metrics: name b c: should be a Python identifier"),
    "unknown events": (lambda: _checked_name("Nope"), "there are no events Nope; there are "),
    "pairs of independent runs": (
        lambda: replace(SweepPlan.of(SHORT, {"team.count": [2, 3]}, 2), common=False).check_reference(
            {"team.count": 2}
        ),
        "runs with independent seeds cannot be paired",
    ),
    "one wait too many for the present": (lambda: waits(MAX_AT_ONE_INSTANT, 0), "wait for longer"),
    "a start at the end of measurements": (
        lambda: LatencyTrace(table="t,value\n0,0.5\n10,0.5\n", after="error", start=20.0),
        "start should be before the end of the trace at",
    ),
    "a fault of a plan without a description": (
        lambda: _check_drawn(SimpleNamespace(judged=nullcontext), Indescribable(start=0.0), None, "plan"),
        "sketch() of a fault should return JSON values",
    ),
    "a model without keys": (lambda: desim.Complete(3), "Complete has no keys: Complete()"),
    "a model that cannot be copied": (
        lambda: raise_(fresh._refusal({}, TypeError("of a model"))),
        "cannot be copied: of a model",
    ),
    "no method": (lambda: calls.check_method(print, "begin", ("a", "b")), "begin should be a method begin(a, b) (got"),
    "a number without end": (lambda: real(10**400, "x"), "x should be a number up to 1.8e308 (got one of 401 digits)"),
    "values and a file": (
        lambda: desim.Empirical(values=(0.1,), file="a.txt"),
        "should have values or a file of values, not both",
    ),
    "a node below the first": (lambda: Topology(Edges(nodes=2)(2)).hearers(-1), "there is no node -1"),
    "an estimator of nothing": (
        lambda: desim.Sensing(radius=5.0, estimator="kalman"),
        "there is nothing to estimate without noise",
    ),
    "a velocity of noise": (
        lambda: desim.Sensing(noise=0.1, estimate="constant_velocity"),
        "noisy sightings have no velocity; choose an estimator",
    ),
    "a fusion without tracks": (
        lambda: desim.Sensing(noise=0.1, estimator="alpha_beta", fusion="naive"),
        "tracks have a covariance with the estimator kalman only",
    ),
    "an exception within the usual style": (lambda: fail_in_style(), "of the caller"),
}


def raise_(error):
    raise error


def fail_in_style():
    with in_style(None):
        raise KeyError("of the caller")


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_seldom_wrong_is_refused_with_its_reason(name):
    act, text = REFUSED[name]
    assert text in raising(act)[1]


def test_assumptions_about_what_is_seen_are_told():
    walled = SHORT.with_({"wall": [{"line": [[50.0, 0.0], [50.0, 5.0]], "blocks": ["sight"]}]})
    assert times_known(walled) == "pursuers do not see the evader through walls (`wall`)"
    noisy = SHORT.with_({"sensing.noise": 0.1, "sensing.estimate": "hold"})
    assert times_known(noisy) == "pursuers do not see the evader exactly (`sensing.noise`)"


@pytest.mark.parametrize("before", ["as before", None])
def test_the_environment_of_processes_is_put_back(before, monkeypatch):
    for name in trust.NO_CWD_IMPORT:
        monkeypatch.delenv(name, raising=False) if before is None else monkeypatch.setenv(name, before)
    with trust.no_cwd_import():
        assert os.environ.items() >= trust.NO_CWD_IMPORT.items()
    assert [os.environ.get(name) for name in trust.NO_CWD_IMPORT] == [before for _ in trust.NO_CWD_IMPORT]


@pytest.mark.parametrize(
    ("name", "asked"),
    [("protocols.rule", ["protocols"]), ("protocols", []), ("protocols.nope", []), ("numpy.linalg", [])],
)
def test_a_module_of_a_hidden_package_is_looked_for_in_it(monkeypatch, name, asked):
    seen = []
    monkeypatch.setattr(packages, "check_visible", seen.append)
    assert packages._HiddenModuleFinder().find_spec(name) is None
    assert seen == asked


def test_each_open_family_refuses_what_cannot_be_called():
    refused = [raising(lambda family=family: family.check(3)) for family in families() if not family.is_closed]
    assert len(refused) > 20
    assert {text.partition(", which ")[0] for _, text in refused} == {"should be a model"}


def imported_inside():
    import counter_of_users

    return counter_of_users.calls


def imported_by_text():
    return import_module("counter_of_users").calls


@pytest.mark.parametrize("function", [imported_inside, imported_by_text])
def test_a_module_that_a_function_imports_while_it_runs_is_looked_through(function, monkeypatch):
    module = ModuleType("counter_of_users")
    module.calls, module.others = [], []
    monkeypatch.setitem(sys.modules, module.__name__, module)
    assert {name: set(names) for name, _, names in _modules_of(function)}["counter_of_users"] == {"calls"}

"""Functions of the user: a wrong signature is refused at once, and a wrong return value with what it should be.

Each family that is called is listed once, so that a new one is noticed by `tests.test_overrides`.
"""

from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import partial
from math import inf, nan
from multiprocessing.pool import ThreadPool
from textwrap import dedent
from types import SimpleNamespace
from typing import ClassVar, NamedTuple

import networkx as nx
import numpy as np
import pytest

from desim import (
    Announcements,
    Crash,
    Csma,
    Fault,
    Links,
    Recording,
    Reliable,
    Scenario,
    Sensing,
    Team,
    fatal_losses,
    find_violation,
    load,
    run,
    summary,
    sweep,
)
from desim.config.arguments import value_text
from desim.config.errors import AnswerError
from desim.kernel.core.clock import Clock
from desim.kernel.core.events import Lost, MessageCounts
from desim.kernel.core.units import SECOND
from desim.kernel.models import medium
from desim.kernel.models.fault_plans import draw_faults
from desim.kernel.models.faults import Jamming, Partition
from desim.kernel.models.latency import Lognormal
from desim.kernel.models.latency_by_link import PerPair
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Bitrate
from desim.kernel.models.reception import Disk
from desim.kernel.network import Network
from desim.kernel.topology import range_check
from desim.pursuit.byzantine.lies import ByzantineFault, Liar
from desim.pursuit.core.events import Ended
from desim.pursuit.motion.dynamics import (
    Acceleration,
    Course,
    capture_times_with,
    headings_with,
    piece_with,
    steered_with,
)
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.flow import SteadyFlow, displacement
from desim.pursuit.motion.guidance import guided_velocities
from desim.pursuit.sensing.noise import PositionNoise, covariance_of
from desim.pursuit.team.judges import Accusation, Judge, ignored_by
from desim.pursuit.team.targeted_faults import ChaserCut
from desim.pursuit.team.trust import Accusations, Credulous
from desim.results.run_folder import read, write
from desim.scenario.checks import warnings
from desim.scenario.overrides import ScenarioError
from desim.study.workers.batch import run_many
from desim.testing import watched
from desim.view.pages.replay import replay_page
from protocols.temperature import inverse_temperatures
from tests.config.test_arrays import Quantity
from tests.test_overrides import FAMILIES, chases, events, is_refused, linked, plain, scenario

CASES = [name for name, family in FAMILIES.items() if name not in {"relay", "interference"}]


def first_kind(name):
    return next(kind for kind in FAMILIES[name].choice.choices().values() if not is_refused(kind))


SIGNATURES = {
    **dict.fromkeys(("latency", "jitter", "loss", "duplicate"), "context, rng"),
    **dict.fromkeys(("protocol", "dissemination"), "me"),
    **dict.fromkeys(("temperature", "cooling"), "eta"),
    **dict.fromkeys(("medium", "graph"), "size"),
    "dynamics": "position, course, command",
    "false capture time": "truth, least, rng",
    "false position": "truth, rng",
    "fault": "size, horizon, rng",
    "flow": "places, t",
    "guidance": "gaps, aims, evader_velocity, speeds",
    "noise": "offset, first, second",
    "reception": "distances, range",
    "schedule": "me, revise",
    "strategy": "state, rng",
    "utility": "own_time, other_times, reward",
}
"""The arguments of the function of a user, by the beginning of the name of its family."""


@pytest.mark.parametrize("name", CASES)
def test_a_function_of_a_wrong_signature_is_refused_when_it_is_given(name):
    family = FAMILIES[name]

    class Strange:
        def __call__(self, one, two, three, four, five, six):
            return 0.0

    strange = Strange()
    vars(strange).update(vars(plain(first_kind(name), family.function, family.beside)) if family.beside else {})
    (taken,) = [taken for begin, taken in SIGNATURES.items() if f"{name} ".startswith(f"{begin} ")]
    with pytest.raises(ValueError, match=rf"should accept a call with \({taken}\); Strange .* does not"):
        family.with_model(strange)


WRONG = {
    "latency": ["late", None, True, -1.0, np.nan, np.inf, [0.1], {}],
    "latency of one link": ["late", None, -1.0, np.nan, [0.1, 0.2]],
    "latency of an edge": ["late", None],
    "jitter": [None, -1.0, np.nan],
    "loss": [None, 0.5, "lost", 1, np.ones(7, dtype=bool)],
    "duplicate": [None, 0.5],
    "reception": [None, np.nan, 2.0, -0.1, "near", np.ones(7), 1j],
    "medium": [None, True, -1.0, np.nan, np.inf, "long"],
    "interference": [None, True, np.ones(7, dtype=bool), 0.5],
    "graph": [None, 5, {0: [1]}, nx.path_graph(7), nx.MultiGraph()],
    "fault": [None, 3, [3], [None]],
    "guidance": [
        None,
        0j,
        np.ones(4, dtype=bool),
        np.zeros(7),
        np.zeros((4, 2)),
        "north",
        np.full(4, np.nan),
        np.full(4, 99.0),
    ],
    "strategy": [None, (1.0, 0.0), np.array([1.0, 0.0]), "north", np.nan, 2.0, True, np.True_],
    "dynamics of an evader": [None, 1j],
    "flow": [None, 0.1, np.ones(5, dtype=bool), np.zeros(7), np.zeros((4, 2)), "east", np.full(5, np.nan)],
    "utility": [None, True, "much", np.nan, (1.0,), 1j],
    "schedule": [None, 3, [3]],
    "temperature": [None, True, -1.0, np.nan, "cold"],
    "protocol": [None, 3],
    "noise": [None, True, (1.0, 2.0), np.nan, "far"],
}
"""For each family, what its functions should not return."""
SIZES = {"latency": None, "loss": None, "reception": None, "medium": None, "guidance": 4, "flow": 5}
"""Families that return numbers or booleans, and how many; None: one for all."""
for _name, _size in SIZES.items():
    _ones = np.ones(_size or (), dtype=bool if _name == "loss" else float)
    WRONG[_name] += [_ones.view(Quantity), np.ma.array(_ones, mask=True), _ones.astype("m8[ms]"), np.ma.masked]
for _name in ("latency", "medium", "strategy", "utility", "temperature", "noise"):
    WRONG[_name] += [10**400, np.timedelta64(1, "s"), (number for number in (1.0, 2.0))]
for _name in ("utility", "temperature", "medium", "latency"):
    WRONG[_name] += [np.complex128(0.5), np.complex64(0.5)]
RETURNS = [(name, k) for name, values in WRONG.items() for k in range(len(values))]


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("name", "k"), RETURNS, ids=[f"{name}-{value_text(WRONG[name][k])}"[:40] for name, k in RETURNS]
)
def test_a_wrong_return_value_gives_a_sentence_about_what_it_should_be(name, k):
    family = FAMILIES[name]
    answer = WRONG[name][k]
    if name == "interference":
        model = plain(type(family.function), lambda *_: answer, ("needs_positions", "has_noise"))
    else:
        model = plain(first_kind(name), _answering(family.function, answer), family.beside)
    with pytest.raises((ValueError, TypeError), match="should"):
        run(family.with_model(model), 1)


WRONG_METHODS = {
    "false capture time": [None, "x", nan, 1j, [1.0], True],
    "false position": [None, True, "x", complex(nan, 0.0), complex(inf, 0.0), (1.0, 2.0), np.ones(2)],
    "judge": [3, "x", object()],
    "ignored": [None, 3, "x"],
    "covariance": [
        *(None, 1.0, np.eye(2), (1.0, 2.0, 1.0), (-1.0, 0.0, 1.0), ("a", 0.0, 1.0), (nan, 0.0, 1.0)),
        *(("1", "0", "1"), (True, False, True), (np.complex128(1), 0.0, 1.0), (10**400, 0.0, 1.0)),
    ],
    "capture_times": [
        None,
        np.ones(4, dtype=bool),
        1.0,
        [1.0],
        np.ones(7),
        np.full(4, nan),
        "x",
        np.ones((4, 2)),
        np.ones(4) * 1j,
    ],
    "steered": [None, True, "x", nan, [1.0], 10**400, np.timedelta64(1, "s")],
    "displacement": [None, True, "x", nan, [1.0], 10**400],
    "headings": [None, [True] * 4, [1.0], [0j] * 4, "abcd", [2.0 + 0j] * 4, [nan] * 4],
}
"""For each function of a liar, and each method of a trust, a noise and dynamics, what it should not return."""


def with_method(name, answer):
    """Return a scenario with a class of a user whose method returns an answer."""

    def theirs(kind):
        return type(kind)("Theirs", (kind,), {"__module__": "theirs", name: lambda *_, **__: answer})()

    match name:
        case "false capture time":
            lie = Liar(node=1, start=0.0, phi=lambda truth, least, rng: answer)
            return scenario(fault=(lie,), announce=Announcements(payload="time"))
        case "false position":
            lie = Liar(node=1, start=0.0, position=lambda truth, rng: answer)
            return scenario(fault=(lie,), announce=Announcements(payload="state"))
        case "judge":
            return scenario(announce=Announcements(trust=theirs(Credulous)))
        case "ignored":
            judge = type("Theirs", (Judge,), {name: lambda *_: answer})()
            trust = type(Credulous)("Trusting", (Credulous,), {"__module__": "theirs", "judge": lambda *_: judge})()
            return scenario(protocol="best_response", announce=Announcements(trust=trust, payload="time"))
        case "displacement":
            body = {
                "velocity_at": lambda _, t: 0.1 + 0j,
                "trend": lambda _, begin: (0.1 + 0j, 0.0),
                name: lambda *_: answer,
            }
            body |= {
                "__module__": "theirs",
                "__annotations__": {"top_acceleration": ClassVar[float]},
                "top_acceleration": 0.0,
            }
            theirs = type("Theirs", (SteadyFlow,), body)
            return scenario(environment=Environment(flow=theirs(velocity=(0.1, 0.0))))
        case "covariance":
            return scenario(sensing=Sensing(noise=theirs(PositionNoise), estimator="kalman"))
    protocol = "best_response" if name == "capture_times" else "sap"
    return scenario(protocol=protocol, team=Team(count=4, speeds=3.0, dynamics=theirs(Acceleration)))


def test_times_that_no_run_lasts_are_limited_wherever_they_are_added_up():
    """A delay of 1e300 s is more than fits into ns; metrics and servers derive times from it."""
    for links in ({"latency": lambda context, rng: 1e300}, {"processing": {"sender": lambda context, rng: 1e300}}):
        for protocol in (None, "server"):
            made = linked(**links)
            made = made if protocol is None else made.model_copy(update={"protocol": protocol})
            assert summary(run(made, 1)).messages_delivered == 0


def test_a_protocol_may_return_any_iterator_of_events():
    """As a generator does, also with an event that has a value."""

    def generated(me):
        for event in (me.sleep(0.1), me.arrival(), me.sleep(0.1)):
            yield event
            me.send(None, 1)

    def mapped(me):
        return filter(None, listed(me))

    def listed(me):
        return iter([me.sleep(0.1), me.sleep(0.2)])

    def counted(me):
        yield from listed(me)

    assert run(scenario(protocol=generated), 1).trace.of(MessageCounts)[0].sent > 0
    assert events(scenario(protocol=mapped)) == events(scenario(protocol=counted))


def test_the_arguments_of_an_optional_method_are_checked_with_the_model():
    for kind, name, key in (
        (Bitrate, "airtime", "medium"),
        (Lognormal, "draw", "latency"),
        (Disk, "bound", "reception"),
    ):
        body = {"__module__": "theirs", name: lambda self, a, b, c: 1.0}
        if name == "bound":  # alone it is refused in any case
            body["__call__"] = lambda self, distances, range: np.ones(len(distances))  # noqa: A006
        theirs = type(kind)("Theirs", (kind,), body)
        model = theirs(bitrate=1e6) if kind is Bitrate else theirs()
        with pytest.raises(ValueError, match=f"{key}: {name} should accept a call with"):
            linked(**{key: model, "range": 5.0})


RIGHT = {
    "strategy": 0.3,
    "utility": 0.3,
    "temperature": 0.3,
    "noise": 0.3,
    "latency": 0.03,
    "medium": 0.003,
    "reception": 0.3,
}
RIGHT_METHODS = {"false capture time": 0.3, "false position": 0.3, "steered": 0.3}
RIGHT_ROWS = {"covariance": (0.3, 0.0, 0.3), "capture_times": [0.3, 0.4, 0.5, 0.6], "headings": [1.0, -1.0, 1.0, -1.0]}
"""For each family and each method that returns one number, or several, some that are right."""
KINDS = (np.float32, np.ma.array, Fraction, Decimal)
"""Kinds of numbers: a `float32` of 0.3 differs from 0.3, the others have its value."""


def answered(name, answer):
    """Return a scenario in which a function of a family, or a method, returns an answer."""
    if name not in FAMILIES:
        return with_method(name, answer)
    function = _answering(FAMILIES[name].function, answer)
    return FAMILIES[name].with_model(plain(first_kind(name), function, FAMILIES[name].beside))


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", [*RIGHT, *RIGHT_METHODS, *RIGHT_ROWS])
def test_a_returned_number_may_be_of_any_kind(name):
    """The run is that of the same number as a `float`, to the last digit: no step is computed in 16 or 32 bits."""
    value = (RIGHT | RIGHT_METHODS | RIGHT_ROWS)[name]
    expected = {}
    for kind in KINDS:
        answer = [kind(number) for number in value] if name in RIGHT_ROWS else kind(value)
        plainly = tuple(map(float, answer)) if name in RIGHT_ROWS else float(answer)
        if plainly not in expected:
            expected[plainly] = events(answered(name, plainly))
        assert events(answered(name, answer)) == expected[plainly]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["strategy", "noise", "false position", "steered"])
def test_a_returned_vector_may_be_of_any_precision(name):
    vector = np.complex64(0.3 + 0.4j)
    for value in (vector, np.array(vector), np.clongdouble(vector)):
        assert events(answered(name, value)) == events(answered(name, complex(vector)))


class Turning(Acceleration):
    """Dynamics whose pieces have numbers of some kind."""

    kind_of: type = complex

    def __call__(self, position, course, command):
        made = super().__call__(position, course, command)
        rounded = [np.complex64(number) for number in (made.position, *made.course, made.acceleration)]
        start, velocity, heading, acceleration = map(self.kind_of, rounded)
        return made._replace(position=start, course=Course(velocity, heading), acceleration=acceleration)


class Drifting(SteadyFlow):
    """A flow whose displacement is a number of some kind."""

    kind_of: type = complex
    top_acceleration: ClassVar[float] = 0.0

    def velocity_at(self, t):
        return self.kind_of(np.complex64(complex(*self.velocity)))

    def displacement(self, begin, end):
        return self.kind_of(np.complex64(complex(*self.velocity) * (end - begin)))

    def trend(self, begin):
        return self.velocity_at(begin), 0.0


PRECISE = {
    "guidance": lambda kind: FAMILIES["guidance"].with_model(
        lambda gaps, aims, flight, speeds: np.full(len(gaps), 0.3 + 0.4j, np.complex64).astype(kind)
    ),
    "flow": lambda kind: FAMILIES["flow"].with_model(
        plain(
            first_kind("flow"),
            lambda places, t: np.full(len(places), 0.3 + 0.1j * t, np.complex64).astype(kind),
            FAMILIES["flow"].beside,
        )
    ),
    "dynamics": lambda kind: scenario(team=Team(count=4, speeds=3.0, dynamics=Turning(kind_of=kind))),
    "uniform flow": lambda kind: scenario(
        environment=Environment(flow=Drifting(velocity=(0.3, 0.1), kind_of=kind), on="pursuers")
    ),
}
"""Scenarios with functions of users that return complex numbers of some kind."""


@pytest.mark.parametrize("name", PRECISE)
def test_returned_vectors_may_be_of_any_precision(name):
    assert events(PRECISE[name](np.complex64)) == events(PRECISE[name](complex))


def with_answer(**methods):
    """Return an object of a user whose methods return some answers."""
    return SimpleNamespace(**{name: lambda *_, answer=answer: answer for name, answer in methods.items()})


STILL = Course(0j, 1.0 + 0j)
SPEEDS = np.array([2.0, 3.0, 2.0, 2.0])
CHECKS = {
    "capture_times": lambda answer: capture_times_with(
        with_answer(capture_times=answer), np.ones(4, dtype=complex), None, SPEEDS, 1.0, 0.1
    ),
    "steered": lambda answer: steered_with(with_answer(steered=answer), 1j, STILL, 1j, 0.1),
    "headings": lambda answer: headings_with(with_answer(headings=answer), None, 4),
    "displacement": lambda answer: displacement(with_answer(displacement=answer), 0.0, 1.0),
    "dynamics of an evader": lambda answer: piece_with(lambda *_: answer, 1j, STILL, 1j),
    "guidance": lambda answer: guided_velocities(lambda *_: answer, SPEEDS * 1j, SPEEDS * 1j, None, SPEEDS),
    "reception": lambda answer: range_check._probabilities(answer, 4, print),
    "medium": lambda answer: medium._checked(answer, print),
    "temperature": lambda answer: next(inverse_temperatures(lambda _: answer, SimpleNamespace(now=0.0), 1.0)),
    "fault": lambda answer: draw_faults([lambda *_: answer], 4, 1.0, 1),
    "false capture time": lambda answer: Liar._announced_phi(
        with_answer(phi=answer), SimpleNamespace(least_phi=print, rng=None), 1, 2.0
    ),
    "false position": lambda answer: Liar._announced_place(with_answer(position=answer), 1j, SimpleNamespace(rng=None)),
    "covariance": lambda answer: covariance_of(with_answer(covariance=answer), 1j),
}
"""Functions that take the answer of a user's function, and check it."""
UNUSED = {"curved": 0.0, "turn_rate": 0.0, "acceleration": 0j, "drift": 0j, "position": 1j, "course": STILL}
MORE_WRONG = {
    "dynamics of an evader": [
        SimpleNamespace(**UNUSED | {key: value})
        for key, value in [
            *((key, nan) for key in ("curved", "turn_rate", "acceleration", "drift", "position")),
            *(("curved", -1.0), ("turn_rate", inf), ("course", Course(nan, 1j)), ("course", Course(1j, nan))),
        ]
    ],
    "capture_times": [[1.0, 2.0, -1e-9, 4.0]],
    "covariance": [(1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (inf, 0.0, 1.0), (1.0, 0.0, inf)],
}
RIGHT_ANSWERS = {
    "capture_times": [0.0, inf, 1, 2.5],
    "steered": 1e300j,
    "headings": [1.0, 1j, -1.0, complex(0.6, 0.8)],
    "displacement": -2.0,
    "guidance": [2.0, 3j, 0.0, -2.0],
    "reception": [0.0, 1.0, 0.5, 1],
    "medium": 0.0,
    "temperature": 0,
    "false capture time": inf,
    "false position": 3,
    "covariance": (1.0, -0.5, 1),
}
"""What they may return, up to the bounds of it."""


@pytest.mark.parametrize("name", CHECKS)
def test_each_answer_is_checked_where_it_is_taken(name):
    """As in the runs above, in a hundredth of the time."""
    for wrong in (*WRONG.get(name, ()), *WRONG_METHODS.get(name, ()), *MORE_WRONG.get(name, ())):
        with pytest.raises(ValueError, match="should"):
            CHECKS[name](wrong)
    if name in RIGHT_ANSWERS:
        assert np.asarray(CHECKS[name](RIGHT_ANSWERS[name])).tolist() == np.asarray(RIGHT_ANSWERS[name]).tolist()


METHODS = [(name, k) for name, values in WRONG_METHODS.items() for k in range(len(values))]


@pytest.mark.slow_but_one
@pytest.mark.parametrize(("name", "k"), METHODS, ids=lambda part: str(part))
def test_a_wrong_answer_of_a_method_gives_a_sentence_about_what_it_should_be(name, k):
    with pytest.raises(ValueError, match=f"{name}.*should"):
        run(with_method(name, WRONG_METHODS[name][k]), 1)


def _answering(function, answer):
    """Return a function with as many arguments as another one."""
    count = function.__code__.co_argcount
    names = ", ".join(f"a{k}" for k in range(count))
    return eval(f"lambda {names}: answer", {"answer": answer})


@pytest.mark.parametrize("name", ["latency", "loss"])
@pytest.mark.parametrize("drawn", [None, 0.5, np.zeros(3), "late"])
def test_wrong_draws_give_a_sentence_about_what_they_should_be(name, drawn):
    class Theirs:
        def draw(self, count, rng):
            return drawn

        def __call__(self, context, rng):
            return 0.1 if name == "latency" else True

    with pytest.raises(ValueError, match=r"draw\(\d+, rng\) should return an array of \d+ draws"):
        run(linked(**{name: Theirs()}), 1)


def test_a_quantile_of_another_shape_is_refused():
    class Theirs:
        def quantile(self, u):
            return 0.1

        def __call__(self, context, rng):
            return 0.1

    with pytest.raises(ValueError, match=r"quantile\(u\) should return a latency for each of \d+ u"):
        run(linked(latency=PerPair(base=Theirs())), 1)


def test_a_model_on_an_edge_of_a_graph_is_checked_with_the_scenario():
    def graph(size):
        made = nx.complete_graph(size)
        made.edges[0, 1]["latency"] = lambda: 0.1
        return made

    with pytest.raises(ValueError, match="the latency of the edge from 0 to 1 should accept a call with"):
        linked(graph=graph)
    with pytest.raises(ValueError, match="the latency of the edge from 0 to 1 should accept a call with"):
        Network(Clock(), graph(3))


@pytest.mark.parametrize("answer", [True, np.True_, np.bool_(1)])
def test_a_watcher_ends_the_run_with_any_true_boolean(answer):
    assert run(scenario(), 1, lambda event: answer).trace.of(Ended)[0].t == 0


@pytest.mark.parametrize("answer", [None, False, np.False_, 1, "yes", [1]])
def test_a_watcher_that_returns_anything_else_does_not(answer):
    assert run(scenario(), 1, lambda event: answer).trace.of(Ended)[0].t > 0


@pytest.mark.parametrize("watcher", [3, [print], lambda: True, lambda event, other: True])
def test_what_is_no_function_of_an_event_is_no_watcher(watcher):
    with pytest.raises(ValueError, match="a watcher should"):
        run(scenario(), 1, watcher)


async def asynchronous(event):
    return True


def generating(event):
    yield True


class Asynchronous:
    async def __call__(self, event):
        return True


@pytest.mark.parametrize(
    "watcher",
    [asynchronous, generating, Asynchronous(), partial(generating)],
    ids=["async", "yield", "object", "partial"],
)
def test_a_watcher_that_would_do_nothing_is_refused(watcher):
    with pytest.raises(ValueError, match=r"a watcher should (have `def` in|do its work when)"):
        run(scenario(), 1, watcher)


@pytest.mark.parametrize(
    ("name", "call"),
    {
        "on_run": lambda function: fatal_losses(Scenario(), "idle at most 2 in total", on_run=function),
        "on_case": lambda function: find_violation(Scenario(), "idle at most 2 in total", on_case=function),
        "on_done": lambda function: run_many([(Scenario(), 1)], on_done=function),
        "measure": lambda function: run_many([(Scenario(), 1)], measure=function),
    }.items(),
)
def test_a_function_that_a_study_calls_is_checked_before_any_run(name, call):
    for wrong, why in (
        (lambda one, two, three: None, "should accept a call"),
        (lambda *given, key: None, "should accept a call"),
        (Asynchronous(), "should have `def` in place of `async def`"),
        (lambda *given: (yield), "should do its work when it is called"),
    ):
        with pytest.raises(ValueError, match=f"^{name} {why}"):
            call(wrong)


@pytest.mark.parametrize("name", CASES)
def test_an_asynchronous_function_is_refused_when_it_is_given(name):
    family = FAMILIES[name]

    class Theirs:
        async def __call__(self, *args, **options):
            return None

    theirs = Theirs()
    vars(theirs).update(vars(plain(first_kind(name), family.function, family.beside)) if family.beside else {})
    with pytest.raises(ValueError, match=r"should have `def` in place of `async def`, and `yield` to wait: .*Theirs"):
        family.with_model(theirs)


class Muttering:
    """A dissemination whose announcements would never be sent."""

    def broadcast(self, me, announcement):
        me.publish(announcement)
        yield

    def __call__(self, me):
        yield from ()


class Endless(Fault):
    """A fault that would never end."""

    def begin(self, site):
        def end():
            yield

        return end


def test_a_method_that_would_do_nothing_is_refused():
    with pytest.raises(ValueError, match=r"broadcast should do its work when it is called, without yield: .*broadcast"):
        Announcements(dissemination=Muttering())
    with pytest.raises(ValueError, match="the function that ends a fault should do its work when it is called"):
        run(scenario(fault=(Endless(start=0.0, end=0.1),)), 1)


@pytest.mark.parametrize("executor", [2.0, None, object(), [2]])
def test_what_is_no_executor_is_refused(executor):
    with pytest.raises(ValueError, match="executor should be a number of processes"):
        sweep(Scenario(horizon=0.01), {"team.count": [2]}, reps=1, executor=executor)


def test_a_pool_of_multiprocessing_is_no_executor():
    with ThreadPool(1) as pool, pytest.raises(ValueError, match="such as ProcessPoolExecutor"):
        sweep(Scenario(horizon=0.01), {"team.count": [2]}, reps=1, executor=pool)


def test_a_number_of_processes_may_be_one_of_numpy():
    assert len(sweep(Scenario(horizon=0.01), {"team.count": [2]}, reps=1, executor=np.int64(1)).to_frame()) == 1


@pytest.mark.parametrize("mean", [20.0, np.float64(20.0)])
def test_a_latency_of_a_user_may_say_its_mean(mean):
    class Theirs:
        def mean_latency(self):
            return mean

        def __call__(self, context, rng):
            return 0.0

    assert "times are in s, not ms" in dict(warnings(Scenario(network=Links(latency=Theirs()))))["network.latency"]


def test_a_mean_that_is_no_number_is_refused():
    class Theirs:
        def mean_latency(self):
            return "much"

        def __call__(self, context, rng):
            return 0.0

    with pytest.raises(ValueError, match="should return a number, s, or None"):
        dict(warnings(Scenario(network=Links(latency=Theirs()))))


def test_a_model_of_a_dataclass_is_named_with_the_line_of_its_own_code():
    """Not with that of its `__init__`, which Python generates."""

    @dataclass
    class Theirs:
        late: float = -0.1

        def __call__(self, context, rng):
            return self.late

    with pytest.raises(AnswerError, match=r"from test_.*Theirs\(late=-0.1\) \(.*test_users_functions.py, line \d+\)$"):
        run(linked(latency=Theirs()), 1)


def test_a_class_of_the_wrong_family_is_named_before_it_has_made_a_model(tmp_path):
    """pydantic completes a class when one of its parts is looked at, and so changes its attributes."""
    code = """
        from desim.config.model import Period, Value

        class Attentive(Value):
            active: Period = 0.1

            def __call__(self, me, revise):
                yield me.sleep(self.active)
    """
    (tmp_path / "late_kinds.py").write_text(dedent(code))
    (tmp_path / "late.toml").write_text('protocol.kind = "late_kinds:Attentive"\n')
    with pytest.raises(ScenarioError, match=r"Attentive \(.*late_kinds.py, line 7\) does not: missing .* 'revise'"):
        load(tmp_path / "late.toml", allow_import=True)


def test_a_returned_object_is_named_without_its_address():
    """Addresses differ from run to run."""

    def made():
        yield object()

    values = (made, made(), lambda: 1, (number for number in [1]), Clock(), [object(), iter([1])])
    assert [*map(value_text, values)] == ["made", "made", "<lambda>", "<genexpr>", "Clock", "[object, list_iterator]"]


class Fog(Bernoulli):
    cause: str = "fog"


class Wall(Partition):
    cause: str = "wall"


class Storm(Jamming):
    cause: str = "storm"


def rain(context, rng):
    return True


rain.cause = "rain"


@pytest.mark.parametrize("ignored", [[True, False], np.array([True]), (np.False_,)])
def test_a_mask_in_place_of_pursuers_is_refused(ignored):
    class Masking(Judge):
        def ignored(self, own_time, claims):
            return ignored

    with pytest.raises(ValueError, match="should return a collection of pursuers"):
        ignored_by(Masking(), 1.0, {0: 1.0})


@pytest.mark.parametrize(
    "says",
    [
        lambda me, body: None,
        lambda me, body: body,
        lambda me, body: (me.id, None),
        lambda me, body: (me.id, 5),
        lambda me, body: (str(me.id), body),
        lambda me, body: (me.id, body, 1),
    ],
)
def test_what_a_liar_of_a_user_says_is_a_pursuer_and_a_body_like_the_honest_one(says):
    """Any other body would be read as that of an inactive pursuer."""
    liar = type("Theirs", (ByzantineFault,), {"says": lambda self, me, body: says(me, body)})
    with pytest.raises(ValueError, match=r"says\(me, body\) should return a pursuer and a body of the type"):
        run(scenario(fault=(liar(node=0, start=0.0),), announce=Announcements(heartbeat=0.1)), 1)
    honest = type("Theirs", (ByzantineFault,), {"says": lambda self, me, body: (np.int64(me.id), body)})
    run(scenario(fault=(honest(node=0, start=0.0),), announce=Announcements(heartbeat=0.1)), 1)


FORWARDED = {
    "says_to": {},
    "drops": {"dissemination": "flooding"},
    "accuses": {"trust": Accusations()},
}
"""What a team needs so that a method of a Byzantine fault is called, by the method."""


def lying(method, answer):
    """Return the numbers of messages of a run in which a method of a user's liar returns answer(its arguments)."""
    liar = type("Theirs", (ByzantineFault,), {method: lambda self, *given: answer(*given)})
    announce = Announcements(heartbeat=0.1, **FORWARDED[method])
    numbers = summary(run(scenario(fault=(liar(node=0, start=0.0),), announce=announce), 1))
    return numbers.messages_sent, numbers.messages_delivered


@pytest.mark.parametrize(
    ("method", "answer"),
    [
        ("says_to", lambda me, body, linked: 5),
        ("says_to", lambda me, body, linked: linked),
        ("says_to", lambda me, body, linked: dict.fromkeys(linked, body)),
        ("says_to", lambda me, body, linked: [(node, body) for node in linked]),
        ("says_to", lambda me, body, linked: [(linked, 1)]),
        ("says_to", lambda me, body, linked: [([str(node) for node in linked], body)]),
        ("drops", lambda me: None),
        ("drops", lambda me: 0.3),
        ("drops", lambda me: "no"),
        ("accuses", lambda: (1,)),
        ("accuses", lambda: [1, 2]),
        ("accuses", lambda: 1),
        ("accuses", lambda: Accusation(1)),
        ("accuses", lambda: Accusation("1")),
    ],
)
def test_what_else_a_liar_of_a_user_answers_is_checked_with_a_sentence_that_names_it(method, answer):
    """A probability in place of a truth value would withhold everything, and a pair per neighbour tell nobody."""
    with pytest.raises(ValueError, match=rf"^{method}\(.*\) should return .* from Theirs"):
        lying(method, answer)


@pytest.mark.parametrize(
    ("method", "plain", "others"),
    [
        (
            "says_to",
            lambda me, body, linked: [(linked, body)],
            [
                lambda me, body, linked: [(np.array(linked), body)],
                lambda me, body, linked: [(filter(lambda node: node >= 0, linked), body)],
                lambda me, body, linked: iter([({*linked}, body)]),
            ],
        ),
        ("drops", lambda me: True, [lambda me: np.True_]),
        (
            "accuses",
            lambda: Accusation((1, 2)),
            [lambda: Accusation([1, 2]), lambda: Accusation(np.array([1, 2])), lambda: Accusation(range(1, 3))],
        ),
    ],
)
def test_a_liar_of_a_user_may_answer_with_any_collection_and_any_truth_value(method, plain, others):
    assert {lying(method, other) for other in others} == {lying(method, plain)}


def late(truth, least, rng):
    return "late"


def test_a_wrong_false_capture_time_names_its_function():
    liar = Liar(node=0, start=0.0, phi=late)
    with pytest.raises(ValueError, match=r"should be a number or inf, got 'late' from late \(.*, line \d+\)"):
        run(scenario(fault=(liar,), announce=Announcements(heartbeat=0.1, payload="time")), 1)


def test_losses_of_a_users_model_have_a_cause_of_their_own():
    """In the events, in the counts and in the summary; of a loss model, a function, a partition and jamming."""
    window = {"start": 0.0, "end": 1.0}
    for cause, parts in {
        "fog": {"network": Links(loss=Fog(p=0.5))},
        "rain": {"network": Links(loss=rain)},
        "wall": {"fault": (Wall(groups=((0,),), **window),)},
        "storm": {"fault": (Storm(centre=(0.0, 0.0), radius=1e4, **window),)},
    }.items():
        result = run(scenario(**parts), 1)
        assert {event.cause for event in result.trace.of(Lost)} == {cause}
        assert dict(summary(result).messages_lost_by) == {cause: len(result.trace.of(Lost))}


class Battery(Crash):
    cause: ClassVar[str] = "battery"


class Brownout(Fault):
    """Parts of it are built-in faults, and a crash with a cause of its own."""

    cause: ClassVar[str] = "brownout"

    def begin(self, site):
        window = {"start": self.start, "end": self.end}
        parts = Crash(node=0, **window), Partition(groups=((1,),), **window), Battery(node=2, **window)
        ends = [site.begin(part) for part in parts]
        return lambda: [end() for end in ends]


class Cut(ChaserCut):
    cause: ClassVar[str] = "cable"


@pytest.mark.parametrize("messages", [True, False])
@pytest.mark.parametrize(
    "network",
    [
        {"latency": 0.1},
        {"latency": Lognormal(mean=0.1)},
        {"medium": Bitrate(bitrate=1e4)},
        {"medium": Bitrate(bitrate=2e4, access=Csma())},
        {"latency": 0.1, "transport": Reliable()},
        {"latency": 0.1, "range": 5.0, "range_check": "both"},
    ],
    ids=["constant", "random", "airtime", "contending", "transport", "range"],
)
def test_losses_by_a_crash_have_the_cause_of_its_class(network, messages):
    """As many as have the cause "crash" without it, wherever they are decided."""
    settings = {"network": Links(**network), "record": Recording(messages=messages)}
    faults = [(kind(node=1, start=0.15, end=0.4), Crash(node=2, start=0.1, end=0.2)) for kind in (Battery, Crash)]
    counts = [watched(scenario(fault=fault, **settings), 1).trace.of(MessageCounts)[0] for fault in faults]
    theirs, usual = (dict(count.lost_by) for count in counts)
    assert theirs["battery"] > 0
    assert theirs.pop("battery") + theirs.pop("crash", 0) == usual.pop("crash")
    assert theirs == usual


def test_losses_have_the_cause_of_the_last_crash_that_has_not_ended():
    """The crash of the battery begins last, and ends first."""
    faults = Crash(node=1, start=0.1, end=0.9), Battery(node=1, start=0.3, end=0.5)
    settings = {"network": Links(latency=1e-3), "announce": Announcements(heartbeat=0.05)}
    losses = run(scenario(fault=faults, **settings), 1).trace.of(Lost)
    causes = [
        {loss.cause for loss in losses if start + 0.01 < loss.t / SECOND < start + 0.19} for start in (0.1, 0.3, 0.5)
    ]
    assert causes == [{"crash"}, {"battery"}, {"crash"}]


def test_parts_of_a_fault_have_its_cause_unless_they_have_their_own():
    def causes(*faults):
        return set(
            summary(run(scenario(network=Links(latency=0.1), fault=faults, protocol=chases), 1)).messages_lost_by
        )

    window = {"start": 0.15, "end": 0.5}
    assert causes(Brownout(**window)) == {"brownout", "battery"}
    assert causes(Cut(**window)) == {"cable"}
    assert causes(ChaserCut(**window)) == {"partition"}


@pytest.mark.slow
def test_an_unknown_cause_is_read_from_a_folder_and_drawn(tmp_path):
    """In all pages and exports that name causes."""
    result = run(scenario(network=Links(loss=Fog(p=0.5)), protocol="best_response"), 1)
    write(result, tmp_path / "run")
    again = read(tmp_path / "run", allow_import=True)
    assert again.trace.of(Lost) == result.trace.of(Lost)
    assert {event.cause for event in again.trace.of(Lost)} == {"fog"}
    assert "fog" in str(summary(again))
    assert '"fog"' in replay_page(again)


@pytest.mark.parametrize("started", [None, 0.1, "self", {}])
@pytest.mark.parametrize("key", ["latency", "loss", "duplicate"])
def test_a_start_of_a_run_that_returns_no_model_is_refused(key, started):
    class Forgetful:
        def start_run(self, size):
            self.size = size
            return started

        def __call__(self, context, rng):
            return np.zeros(len(context.dst), dtype=bool if key != "latency" else float)

    with pytest.raises(ValueError, match=r"start_run\(size\) should return the model .*, got .* from .*Forgetful"):
        run(Scenario(horizon=0.1, team=Team(count=2), network=Links(**{key: Forgetful()})))


def test_a_model_that_returns_that_its_links_are_wrong_is_told_to_raise():
    class Polite(Lognormal):
        def __call__(self, context, rng):
            return np.zeros(len(context.dst))

        def check_links(self, size, links):
            return False

    with pytest.raises(ValueError, match="check_links of Polite returned False: it should raise ValueError"):
        Scenario(team=Team(count=2), network=Links(latency=Polite()))


class Tuple(NamedTuple):
    """A latency that is a named tuple."""

    mean: float = 0.1

    def __call__(self, context, rng):
        return np.full(len(context.dst), self.mean)


class Lists(list):
    """A latency that is a list, and so is no table of latencies."""

    def __call__(self, context, rng):
        return np.full(len(context.dst), self[0])


class Table(dict):
    """A latency that is a dict."""

    def __call__(self, context, rng):
        return np.full(len(context.dst), self["mean"])


@pytest.mark.slow_cases("[0.1]", "{'mean': 0.1}")
@pytest.mark.parametrize("model", [Tuple(0.1), Lists([0.1]), Table(mean=0.1)], ids=repr)
def test_a_model_may_be_a_tuple_a_list_or_a_dict_that_can_be_called(model):
    plain = Scenario(team=Team(count=2), horizon=0.25, network=Links(latency=0.1))
    own = plain.model_copy(update={"network": Links(latency=model)})
    expected = [summary(run(plain.with_({"horizon": horizon}), 1)).messages_delivered for horizon in (0.15, 0.25)]
    assert [summary(run(own.with_({"horizon": horizon}), 1)).messages_delivered for horizon in (0.15, 0.25)] == expected
    swept = sweep(own, {"horizon": [0.15, 0.25]}, reps=1)
    assert len(swept.to_frame()) == 2
    if isinstance(model, Tuple):
        compared = sweep(own, {"network.latency": [model, Tuple(0.2)]}, reps=1)
        assert "Tuple(mean=0.2)" in compared.table()

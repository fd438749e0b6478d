"""Wrong protocols, schedules and metrics: each is told what is wrong with it."""

import random
import re
import time
from functools import partial
from math import inf

import numpy as np
import pytest

from desim import Scenario, run
from desim.config.model import Value
from desim.kernel.core.events import MessageCounts
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Ended
from desim.pursuit.team.agent import Agent
from desim.testing import (
    ContractError,
    check_dissemination,
    check_metric,
    check_protocol,
    check_schedule,
    decisions,
    metrics,
)
from desim.testing.judging import SEED
from protocols.rule import Rule


def decides(me, action=None):
    """Chase for as long as nobody else is believed to be nearer, ten times per second."""
    while True:
        yield me.sleep(0.1)
        chases = all(me.capture_time() <= phi for phi in me.believed_chasers().values())
        me.assign(chases if action is None else action)
        me.announce()


def returns(me):
    me.assign(1)


def yields_a_number(me):
    yield 0.1


def spins(me):
    while True:
        me.assign(1)
        me.announce()
    yield me.sleep(0.1)


def stands_still(me):
    while True:
        me.assign(1)
        me.announce()
        yield me.sleep(0.0)


def draws_globally(me):
    while True:
        yield me.sleep(random.expovariate(10.0))
        me.assign(1)
        me.announce()


def draws_from_numpy(me):
    yield me.sleep(np.random.random())  # noqa: NPY002
    yield from decides(me)


def draws_from_entropy(me):
    yield me.sleep(np.random.default_rng().random() / 5)
    yield from decides(me)


def reads_the_clock(me):
    yield me.sleep(time.perf_counter() % 0.2)
    yield from decides(me)


def chases_what_is_not_there(me):
    yield from decides(me, action=2)


def is_silent(me):
    while True:
        yield me.sleep(0.1)
        me.assign(1 - me.action)


def commands(me):
    """Set the actions of all from pursuer 0."""
    while True:
        yield me.sleep(0.1)
        if me.id == 0:
            for pursuer in range(me.team_size):
                me.global_state.set_action(pursuer, 1)


def never_decides(me):
    while True:
        yield me.sleep(0.1)
        me.mail()


def asks_its_neighbour(me):
    me.send((me.id + 1) % me.team_size, "query")
    yield from decides(me)


def waits_for_an_answer(me):
    """Assume that each message arrives once, and soon."""
    me.send(None, "query")
    yield me.sleep(0.05)
    assert len(me.mail()) == me.team_size - 1
    yield from decides(me)


def takes_turns(me, ignores):
    """Stop and call the others every 0.1 s; who is called chases, unless pursuer 0 alone calls."""

    def take(messages):
        if not me.action and any(message.src for message in messages):
            me.assign(1)
            me.announce()

    me.listen(take, "call", ignores=ignores)
    while True:
        yield me.sleep(0.1)
        me.assign(0)
        me.announce()
        me.send(None, "chase", "call")


def ignores_calls_while_it_chases(me):
    """A call that is sent while it chases may arrive when it has stopped."""
    return takes_turns(me, lambda message: me.action)


def believes_that_it_sees(me):
    yield me.sleep(0.1)
    evader = me.evader()
    yield me.sleep(0.1 * abs(evader) / abs(evader))
    yield from decides(me, action=1 if 0 < abs(me.evader() - me.position()) < inf else 5)


def orders_by_hash(me):
    """Choose by the order of a set of texts."""
    while True:
        yield me.sleep(0.1)
        me.assign(next(iter({f"{name}-{me.id}" for name in "abcdefgh"})) > "d")
        me.announce()


class SharedMemory:
    """Count the decisions of all pursuers in the object that they share."""

    def __init__(self):
        self.decisions = 0

    def __call__(self, me):
        while True:
            yield me.sleep(0.1)
            self.decisions += 1
            me.assign(self.decisions % 2)
            me.announce()


class ClassMemory:
    """Count the decisions of all runs in the class."""

    decisions = 0

    def __call__(self, me):
        while True:
            yield me.sleep(0.1)
            type(self).decisions += 1
            me.assign(self.decisions % 3 == 0)
            me.announce()


SEEN = []


def remembers_globally(me):
    yield me.sleep(0.1)
    SEEN.append(me.id)
    yield me.sleep(0.01 * (len(SEEN) % 7))
    yield from decides(me)


class Ends(Rule):
    def actions(self, me):
        yield 1


class Locked:
    """A protocol with what no process can send."""

    def __reduce__(self):
        raise TypeError("a lock")

    def __call__(self, me):
        return decides(me)


PROTOCOLS = {
    "no generator": (
        returns,
        r"five pursuers raises AnswerError: a protocol, .* be a generator .*, got None from returns",
    ),
    "a number": (
        yields_a_number,
        r"yield events such as me\.sleep\(0\.1\), got 0\.1 from yields_a_number .*\(pursuer 0, at 0 s",
    ),
    "no arguments": (lambda: None, r"is not a protocol: should accept a call with \(me\)"),
    "spins": (spins, r"a run of five pursuers does not end, or no simulated time passes"),
    "stands still": (stands_still, r"a run of five pursuers does not end, or no simulated time passes"),
    "random": (draws_globally, r"two runs of one scenario and seed differ|drawn from the global generator"),
    "numpy.random": (draws_from_numpy, r"numpy\.random: the run has drawn from the global generator"),
    "entropy": (
        draws_from_entropy,
        r"numpy\.random\.default_rng\(\): these random numbers do not follow from the seed",
    ),
    "the clock": (reads_the_clock, r"differ, first .* nothing from the clock of the computer"),
    "an invalid action": (chases_what_is_not_there, r"a run of five pursuers raises ValueError: .*2"),
    "silent": (is_silent, r"pursuer \d changes its action at 0\.1 s and again at 0\.2 s, and sends no message between"),
    "commands": (commands, r"pursuer 0 sets the action of pursuer 1 at 0\.1 s: each decides for itself"),
    "never decides": (never_decides, r"no pursuer decides within 1 s: expected me\.assign\(action\)"),
    "one pursuer": (asks_its_neighbour, r"a run of one pursuer raises ValueError: .*\(pursuer 0, at 0 s"),
    "lost messages": (
        waits_for_an_answer,
        r"a run in which no message arrives breaks an invariant|raises AssertionError",
    ),
    "an ignored message that would count": (
        ignores_calls_while_it_chases,
        r"is another one if no message is ignored, first .* and then .*: `ignores` of me\.listen should be true only",
    ),
    "short sight": (believes_that_it_sees, r"a run in which pursuers see 3 m raises"),
    "shared memory": (SharedMemory(), r"changes the attributes of the object, which all pursuers share"),
    "memory of a class": (ClassMemory(), r"two runs of one scenario and seed differ|cannot be repeated"),
    "global memory": (remembers_globally, r"two runs of one scenario and seed differ|cannot be repeated"),
    "ends": (Ends(), r"raises ValueError: actions\(me\) of Ends should never end"),
    "a lock": (Locked(), r"Locked cannot be pickled, which the workers of a sweep need: a lock"),
    "a misspelt trait": (
        type("Misspelt", (), {"anounces": False, "__call__": lambda self, me: decides(me)})(),
        "did you mean 'announces'",
    ),
    "a missing module": ("no_such_module:Protocol", r"cannot be imported: No module named 'no_such_module'"),
}
"""Wrong protocols, and what each is told."""


class Slow(Value):
    """A schedule whose mean slot is not its own."""

    def mean_slot(self, me):
        return 0.001

    def __call__(self, me, revise):
        while True:
            yield me.sleep(0.1)
            revise()
            me.announce()


class Zero(Slow):
    def mean_slot(self, me):
        return 0.0


class Lazy(Slow):
    def __call__(self, me, revise):
        while True:
            yield me.sleep(0.1)
            me.announce()


class Silent(Slow):
    def mean_slot(self, me):
        return 0.1 / me.team_size

    def __call__(self, me, revise):
        while True:
            yield me.sleep(0.1 + 0.01 * me.id)
            revise()


class Returns(Slow):
    def __call__(self, me, revise):
        revise()


class Restless(Slow):
    def __call__(self, me, revise):
        while True:
            yield me.sleep(0.0)
            revise()


SCHEDULES = {
    "a wrong mean slot": (
        Slow(),
        r"mean_slot\(me\) of a team of 5 returns 0\.001 s, and it has \d+ turns at \d+ instants in",
    ),
    "no slot": (Zero(), r"mean_slot\(me\) should return a finite time > 0 s, got 0\.0"),
    "no turns": (Lazy(), r"no pursuer has a turn within 10 s: call revise\(\) and then me\.announce\(\)"),
    "silent": (Silent(), r"sends no message between: call me\.announce\(\)"),
    "no generator": (Returns(), r"raises TypeError"),
    "restless": (Restless(), r"does not end, or no simulated time passes"),
    "no mean slot": (lambda me, revise: None, r"is not a schedule: should have mean_slot"),
}
"""Wrong schedules, and what each is told."""

METRICS = {
    "infinite": (lambda result: inf, r"metric\(result\) of a run that ends at the horizon is inf, expected a finite"),
    "a list": (lambda result: [1.0], r"a run that ends at the horizon raises MetricError"),
    "a division": (
        lambda result: 1.0 / result.trace.of(MessageCounts)[-1].t,
        r"a run that ends at time 0 raises MetricError",
    ),
    "another value": (
        lambda result: time.perf_counter(),
        r"computed again, \d+\.\d+: expected equal values",
    ),
    "other random numbers": (lambda result: np.random.default_rng().random(), "do not follow from the seed"),
    "random": (lambda result: random.random() and 1.0, "random: the run has drawn from the global generator"),
    "no arguments": (lambda: 1.0, r"raises"),
}
"""Wrong metrics, and what each is told."""


@pytest.mark.slow_cases("lost messages", "never decides", "short sight", "stands still")
@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_wrong_protocol_is_told_what_is_wrong_with_it(name):
    model, what = PROTOCOLS[name]
    SEEN.clear()
    with pytest.raises(ContractError, match=what):
        check_protocol(model, limit=0.5 if "does not end" in what else 20.0)


@pytest.mark.slow
def test_a_protocol_may_ignore_messages_that_have_no_effect():
    """The control of the case above."""
    check_protocol(lambda me: takes_turns(me, lambda message: message.src == 0))


@pytest.mark.whole
def test_a_protocol_that_depends_on_the_order_of_a_set_is_told_so(monkeypatch):
    monkeypatch.setattr(decisions, "SITUATIONS", {})
    with pytest.raises(ContractError, match="runs under PYTHONHASHSEED=1 and =2 differ: sort sets"):
        check_protocol(orders_by_hash, hash_seeds=True)


@pytest.mark.slow_cases("silent")
@pytest.mark.parametrize("name", SCHEDULES)
def test_a_wrong_schedule_is_told_what_is_wrong_with_it(name):
    model, what = SCHEDULES[name]
    with pytest.raises(ContractError, match=what):
        check_schedule(model, limit=0.5 if "does not end" in what else 20.0)


class Spread:
    """A dissemination by messages to the neighbours; a receiver merges those that `ignores(me, message)` leaves."""

    ignores = None

    def broadcast(self, me, announcement):
        me.send(None, me.record(announcement), "spread")

    def __call__(self, me):
        def take(messages):
            me.merge_records([message.body for message in messages])

        yield me.listen(take, "spread", ignores=self.ignores and (lambda message: self.ignores(me, message)))


class IgnoresWhileItChases(Spread):
    def ignores(self, me, message):
        return me.action


class SendsNothing(Spread):
    def broadcast(self, me, announcement):
        pass


class Remembers(Spread):
    def __init__(self):
        self.known = set()

    def broadcast(self, me, announcement):
        self.known.add(me.id)
        super().broadcast(me, announcement)


DISSEMINATIONS = {
    "an ignored message that would count": (
        IgnoresWhileItChases,
        r"is another one if no message is ignored, first .* and then .*: `ignores` of me\.listen should be true only",
    ),
    "nothing is sent": (SendsNothing, r"no pursuer has a record of another: expected broadcast\(me, announcement\) to"),
    "memory": (
        Remembers,
        r"a run of 1 s without losses changes the attributes of the object, which all pursuers share",
    ),
}
"""Wrong disseminations, and what each is told."""


@pytest.mark.slow
@pytest.mark.parametrize("name", DISSEMINATIONS)
def test_a_wrong_dissemination_is_told_what_is_wrong_with_it(name):
    model, what = DISSEMINATIONS[name]
    with pytest.raises(ContractError, match=what):
        check_dissemination(model(), limit=20.0)


@pytest.mark.slow
def test_a_dissemination_that_is_right_passes(monkeypatch):
    monkeypatch.setattr(decisions, "SITUATIONS", {})
    check_dissemination(Spread(), limit=20.0)


@pytest.mark.slow
def test_what_one_check_takes_changes_no_other_run_meanwhile(monkeypatch):
    """Another run that begins while a check repeats a run without `ignores` ignores as it is told."""
    asked, repeat = [], decisions.run_observed

    def ignores(me):
        return takes_turns(me, lambda message: asked.append(message) or False)

    def repeated(scenario, seed, watchers, begins):
        def begins_with_another(simulation):
            begins(simulation)
            asked.clear()
            run(Scenario(horizon=0.25, protocol=ignores), 1)
            assert asked

        return repeat(scenario, seed, watchers, begins_with_another)

    monkeypatch.setattr(decisions, "run_observed", repeated)
    monkeypatch.setattr(decisions, "SITUATIONS", {})
    check_protocol(ignores)


@pytest.mark.parametrize("name", metrics.SITUATIONS)
def test_the_runs_for_which_a_metric_is_computed_end_as_their_names_say(name):
    (ended,) = run(Scenario(**metrics.SITUATIONS[name]), SEED).trace.of(Ended)
    assert (ended.reason == "captured") == (name in {"a run that ends with a capture", "a run that ends at time 0"})
    assert (ended.t == 0) == (name == "a run that ends at time 0")
    assert ended.t == 0.5 * SECOND or ended.reason == "captured"


@pytest.mark.parametrize("module", [decisions, metrics])
def test_the_runs_of_a_check_have_as_many_players_as_their_names_say(module):
    said = 0
    for name, keys in module.SITUATIONS.items():
        scenario = Scenario(**keys)
        counts = {"pursuer": scenario.team.count, "evader": len(scenario.evaders)}
        for number, player in re.findall("(one|two) (pursuer|evader)", name):
            assert {"one": 1, "two": 2}[number] == counts[player]
            said += 1
    assert said


@pytest.mark.parametrize("name", METRICS)
def test_a_wrong_metric_is_told_what_is_wrong_with_it(name):
    model, what = METRICS[name]
    with pytest.raises(ContractError, match=what):
        check_metric(model)


def test_the_name_of_a_wrong_metric_is_that_of_its_function():
    def unlucky(_result):
        return "no number"

    with pytest.raises(ContractError, match=r"^unlucky: "):
        check_metric(unlucky)
    with pytest.raises(ContractError, match=r"^the metric: "):
        check_metric(partial(unlucky))


@pytest.mark.whole
def test_the_checks_accept_the_right_models_from_which_the_wrong_ones_differ():
    check_protocol(decides)
    check_metric(lambda result: float("nan"))

    class Right(Slow):
        def mean_slot(self, me: Agent) -> float:
            return 0.1 / me.team_size

    check_schedule(Right())

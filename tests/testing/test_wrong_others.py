"""Wrong faults, trusts, flows and exporters: each is told what is wrong with it."""

import random
import re
from contextlib import nullcontext
from math import nan
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import desim.testing
from desim import Crash, Fault, Scenario
from desim.config.model import Value
from desim.kernel.core.events import Lost
from desim.kernel.core.units import SECOND
from desim.kernel.models.latency_by_link import LATENCIES
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.pursuit.byzantine.lies import PURSUER_FAULTS
from desim.pursuit.motion.flow import SteadyFlow, UniformFlow
from desim.pursuit.team.judges import Judge
from desim.testing import (
    ContractError,
    assert_holds,
    check_body,
    check_evader,
    check_exporter,
    check_fault,
    check_flow,
    check_latency,
    check_loss,
    check_protocol,
    check_trust,
    watched,
)
from desim.testing.faults import _Ends
from desim.testing.judging import subject
from tests.command import JARGON
from tests.golden import golden


def a_kind(base, **methods):
    """Return a user's class derived from a base, with some methods."""
    return type("Mine", (base,), {"__module__": "mine", **methods})


def endless(self, site):
    site.block(lambda src, dst: dst == 0)
    return lambda: None


def half_ended(self, site):
    ends = [site.block(lambda src, dst: dst == 0), site.block(lambda src, dst: dst == 1)]
    return ends[0]


FAULTS = [
    (a_kind(Fault, begin=endless), "a run with it loses a message from . to 0 .* when no fault is active"),
    (a_kind(Fault, begin=half_ended), "should end all that it has begun"),
    (a_kind(Fault, begin=lambda self, site: None), "should return a function without arguments"),
    (a_kind(Fault), r"should have a method begin\(site\)"),
    (a_kind(Fault, begin=lambda self, site: site.block(lambda src, dst: 1)), "should return True or False, got 1"),
    (a_kind(Fault, begin=lambda self, site: print, sketch=lambda self: {"at": 1j}), "should return JSON values"),
    (a_kind(Fault, begin=lambda self, site: 1 / 0), "raises ZeroDivisionError"),
    (lambda size, horizon, rng: [Crash(node=size, start=0.0)], "names node 1: expected nodes 0 .. size - 1"),
    (lambda size, horizon, rng: [Crash(node=0, start=random.random())], "draws from the global generator|for an equal"),
    (lambda size, horizon, rng: [3], "draws 3, expected faults"),
    (lambda size, horizon, rng: None, "returns None, expected faults"),
    (lambda size, horizon: [], r"should accept a call with \(size, horizon, rng\)"),
]


@pytest.mark.parametrize(("fault", "why"), FAULTS)
def test_a_wrong_fault_is_told_what_is_wrong(fault, why):
    with pytest.raises((ContractError, ValueError), match=why):
        check_fault(fault, limit=60.0)


@pytest.mark.parametrize(("late", "is_told"), [(2_000_000, False), (3_000_000, True)])
def test_a_loss_up_to_two_milliseconds_after_the_last_fault_is_of_it(late, is_told):
    """A message that is in flight when a fault ends may be lost by it; its latency is 1 ms."""
    crash = Crash(node=0, start=0.1, end=0.2)
    ends = _Ends(subject(crash, PURSUER_FAULTS, "fault"), "a run")
    ends(FaultStarted(100_000_000, crash))
    ends(Lost(150_000_000, 1, 0, 1, "crash"))
    ends(FaultEnded(200_000_000, crash))
    with pytest.raises(ContractError, match="when no fault is active") if is_told else nullcontext():
        ends(Lost(200_000_000 + late, 2, 0, 1, "crash"))


def test_a_right_fault_of_a_user_passes():
    def deaf(self, site):
        return site.block(lambda src, dst: dst == 0)

    check_fault(a_kind(Fault, begin=deaf), limit=60.0)
    check_fault(lambda size, horizon, rng: [Crash(node=int(rng.integers(size)), start=0.1, end=0.2)], limit=60.0)


def trust(create):
    """Return a user's trust that creates judges."""
    return a_kind(object, judge=lambda self, witness: create(witness), period=None)()


def judge(**methods):
    return a_kind(Judge, **methods)()


SHARED = Judge()


class FirstTwo(Judge):
    """Believes the first two teammates that it hears, for ever."""

    def __init__(self, *_):
        self.known = []

    def believes(self, record):
        self.known += [record.src] * (len(self.known) < 2 and record.src not in self.known)
        return record.src in self.known


class FirstTwoAnew(FirstTwo):
    """Forgets them when it is told to."""

    def forget(self):
        self.known = []


TRUSTS = [
    (trust(lambda witness: SHARED), "returns the same object for two pursuers"),
    (trust(lambda witness: 3), "should return None, or an object with the methods"),
    (trust(lambda witness: judge(believes=lambda self, record: None)), "should return True or False, got None"),
    (
        trust(lambda witness: judge(believes=lambda self, record: 1 // abs(record.stamp - 2 * SECOND) == 0)),
        r"believes\(record\) with the body .* raises ZeroDivisionError",  # no run lasts so long
    ),
    (trust(lambda witness: judge(believes=lambda self: True)), r"believes should accept a call with \(record\)"),
    (trust(lambda witness: judge(ignored=lambda self, own, claims: 3)), "should return a collection of pursuers"),
    (trust(lambda witness: judge(ignored=lambda self, own, claims: [9])), "expected pursuers among"),
    (trust(lambda witness: judge(forget=lambda self: 1 / 0)), r"forget\(\) raises ZeroDivisionError"),
    (trust(FirstTwo), r"answers \{4: False, 3: False, 2: True, 1: True\}, and that of a new judge \{4: True, 3: True"),
    (trust(lambda witness: judge(believes=lambda self, record: random.random() < 0.5)), "global generator"),
    (a_kind(object, judge=lambda self, witness: None, period=-1.0)(), "period"),
    (a_kind(object, judge=lambda self: None, period=None)(), r"should accept a call with \(witness\)"),
]


@pytest.mark.parametrize(("model", "why"), TRUSTS)
def test_a_wrong_trust_is_told_what_is_wrong(model, why):
    with pytest.raises(ContractError, match=why):
        check_trust(model, limit=60.0)


@pytest.mark.whole
def test_a_judge_that_forgets_passes():
    check_trust(trust(FirstTwoAnew), limit=60.0)


class Jet:
    """A flow that is right."""

    top_speed = 1.0

    def __call__(self, places, t):
        return np.exp(-(places.imag**2)) + 0j


def flow(call, **attributes):
    return a_kind(Jet, __call__=call, **attributes)()


class Moving(UniformFlow):
    """A flow whose displacement is not the integral of its velocity."""

    top_speed: ClassVar[float] = 1.0

    def velocity_at(self, t):
        return complex(t / (1.0 + t))

    def displacement(self, begin, end):
        return complex(end - begin)

    def trend(self, begin):
        return 1 + 0j, 1.0


FLOWS = [
    (flow(lambda self, places, t: 0.1), "should return an array of 400 finite velocities"),
    (flow(lambda self, places, t: np.full(len(places), np.nan + 0j)), "finite velocities"),
    (flow(lambda self, places, t: np.zeros((len(places), 2))), "should return an array"),
    (flow(lambda self, places, t: places / 10.0, top_speed=1.0), "expected at most top_speed = 1 m/s"),
    (flow(lambda self, places, t: places * 0 + 1.0 / len(places)), "should depend on the place and the time only"),
    (flow(lambda self, places, t: np.arange(len(places)) + 0j), "should depend on the place and the time only"),
    (flow(lambda self, places, t: np.random.random(len(places)) + 0j), "global generator|returns others"),  # noqa: NPY002
    (flow(lambda self, places, t: places.__imul__(0.0)), "changes the places"),
    (flow(lambda self, places, t: 1 / 0), "raises ZeroDivisionError"),
    (flow(lambda self, places: places), r"should accept a call with \(places, t\)"),
    (Moving(), r"displacement\(0, 1\) is 1\+0j m, and the integral"),
]


@pytest.mark.parametrize(("model", "why"), FLOWS)
def test_a_wrong_flow_is_told_what_is_wrong(model, why):
    with pytest.raises(ContractError, match=why):
        check_flow(model, limit=60.0)


def test_right_flows_of_a_user_pass():
    check_flow(Jet(), limit=60.0)
    check_flow(a_kind(SteadyFlow)(velocity=(0.1, 0.2)), limit=60.0)


def writes(text):
    return lambda result, file: file.write_text(text(result))


def refusing(result, file):
    raise ValueError("a run should have what no run has")


EXPORTERS = [
    (lambda result, file: None, "does not write the file"),
    (lambda result, file: file.write_text("x") and "one", "returns 'one', expected the number of items"),
    (writes(lambda result: str(random.random())), "global generator|writes another file"),
    (lambda result, file: 1 / 0, "raises ZeroDivisionError"),
    (refusing, "refuses every run: a run should have what no run has"),
    (lambda result: None, r"should accept a call with \(result, file\)"),
]


@pytest.mark.parametrize(("exporter", "why"), EXPORTERS)
def test_a_wrong_exporter_is_told_what_is_wrong(exporter, why):
    with pytest.raises(ContractError, match=why):
        check_exporter(exporter, limit=60.0)


@pytest.mark.slow
def test_an_exporter_may_return_an_integer_of_numpy():
    check_exporter(lambda result, file: np.int64(file.write_text("x")), limit=60.0)


@pytest.mark.slow
def test_an_exporter_that_streams_is_given_the_events_of_a_file():
    class Lines(Value):
        streams: ClassVar[bool] = True

        def __call__(self, result, file):
            return file.write_text("".join(f"{event.t} {type(event).__name__}\n" for event in result.trace))

    check_exporter(Lines(), limit=60.0)

    def counts(self, result, file):
        return file.write_text(str(len(result.trace)))

    with pytest.raises(ContractError, match="raises TypeError"):  # what is read from a file has no length
        check_exporter(a_kind(Lines, __call__=counts)(), limit=60.0)


WRONG_ARGUMENTS = [
    (lambda: check_protocol("sapp"), ContractError, "sapp is not a protocol: there is no 'sapp', did you mean 'sap'"),
    (lambda: check_exporter("cvs"), ContractError, "cvs is not an exporter: there is no 'cvs', did you mean 'csv'"),
    (
        lambda: check_evader({}),
        ContractError,
        "is not a strategy of an evader: should be a kind, .*allowed: pure_evasion",
    ),
    (
        lambda: check_latency({"kind": "constant", "value": -1}),
        ContractError,
        "is not a latency: value: should be greater",
    ),
    (lambda: check_latency({"kind": "constant", "valu": 1}), ContractError, "is not a latency: valu: unknown key"),
    (lambda: check_protocol("sap", limit="long"), ValueError, "^a time limit, in s, should be a number"),
    (lambda: check_body("simple", limit=0), ValueError, "^a time limit should be > 0 s"),
    (lambda: check_protocol("sap", hash_seeds="no"), ValueError, "hash_seeds should be True or False"),
    (lambda: check_protocol("sap", hash_seed=True), TypeError, "did you mean 'hash_seeds'"),
    (lambda: check_loss("bernoulli", nodes="six"), ValueError, "nodes should be an integer"),
    (lambda: check_loss("bernoulli", draws=1), ValueError, "nodes and draws should be at least 2"),
    (lambda: check_loss("bernoulli", share=nan), ValueError, "share should be a probability"),
    (lambda: check_latency("constant", draws=2.5), ValueError, "draws should be an integer"),
    (lambda: watched(None), TypeError, "watched takes a scenario"),
    (
        lambda: assert_holds(Scenario(), "idle at most 0.1 in total", 3),
        ValueError,
        "seeds should be a list of integers",
    ),
]


@pytest.mark.parametrize(("call", "kind", "text"), WRONG_ARGUMENTS, ids=[text for _, _, text in WRONG_ARGUMENTS])
def test_a_wrong_call_of_a_check_says_what_to_write_and_blames_no_model(call, kind, text):
    with pytest.raises(kind, match=text) as refused:
        call()
    assert not JARGON.search(str(refused.value))
    assert "Input tag" not in str(refused.value)


class NeedsMore:
    """A class whose objects need a parameter."""

    def __init__(self, parameter):
        self.parameter = parameter


NO_MODELS = {"a number": -1, "a text": "nope", "a class with parameters": NeedsMore, "an object": object()}
CHECKS = [getattr(desim.testing, name) for name in desim.testing.__all__ if name.startswith("check_")]


@pytest.mark.slow
def test_what_each_check_says_of_what_is_no_model_is_golden():
    parts = {}
    for check in CHECKS:
        lines = []
        for what, model in NO_MODELS.items():
            with pytest.raises((ContractError, TypeError, ValueError)) as refused:
                check(model)
            text = re.sub(r" at 0x[0-9a-f]+", "", str(refused.value))
            lines.append(f"{what}: {type(refused.value).__name__}: {text.replace(str(Path.cwd()), 'FOLDER')}")
        parts[check.__name__] = "\n".join(lines)
    assert len(parts) == 12
    golden("checks/no_models.txt", parts)


def test_a_model_is_found_by_its_name_in_the_working_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "theirs.py").write_text("def late(context, rng):\n    return [0.1] * len(context.dst)\n")
    assert subject("theirs:late", LATENCIES, "latency").model.__name__ == "late"

"""Wrong models of links: each is told what is wrong with it."""

import random
import time
import warnings

import numpy as np
import pytest
from scipy.stats import binomtest

from desim import run
from desim.config.model import Time, Value
from desim.kernel.core.events import Broadcast
from desim.kernel.models.latency import Constant, Uniform
from desim.testing import ContractError, check_latency, check_loss, links
from desim.testing.judging import CHANCE, are_more, is_off


class Milliseconds(Value):
    """A latency whose number is meant in ms."""

    def __call__(self, context, rng):
        return rng.uniform(40.0, 60.0, len(context.dst))


class WithMean(Value):
    """A latency of 0.1 s with a wrong mean."""

    spread: Time = 0.05

    def __call__(self, context, rng):
        return 0.1 + self.spread * rng.random(len(context.dst))

    def mean_latency(self):
        return 0.1


class ByNumber:
    """A latency that takes the number of a receiver in the call for its id."""

    table = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])

    def __call__(self, context, rng):
        return self.table[: len(context.dst)] + 0.001 * rng.random(len(context.dst))


class Divided:
    """A latency that is divided among the receivers."""

    def __call__(self, context, rng):
        return rng.random(len(context.dst)) / len(context.dst)


class OtherDraw:
    """A latency whose draws are not its calls."""

    def draw(self, count, rng):
        return rng.random(count)

    def __call__(self, context, rng):
        return 0.5 * rng.random(len(context.dst))


class OtherQuantile(OtherDraw):
    """A latency whose quantiles are not its draws."""

    def draw(self, count, rng):
        return 0.5 * rng.random(count)

    def quantile(self, u):
        return 0.7 * u


class ShortDraw:
    """A latency with a draw too few."""

    def draw(self, count, rng):
        return rng.random(count - 1)

    def __call__(self, context, rng):
        return rng.random(len(context.dst))


class Falling(OtherQuantile):
    def quantile(self, u):
        return 0.5 * (1.0 - u)


class Remembering:
    """A latency whose class remembers the number of calls."""

    calls = 0

    def __call__(self, context, rng):
        type(self).calls += 1
        return 0.001 * self.calls


class OwnGenerator:
    """A latency with a generator of the computer's entropy."""

    def __call__(self, context, rng):
        return np.random.default_rng().random(len(context.dst))


class Overwriting:
    def __call__(self, context, rng):
        context.dst += 1
        return 0.1


class Moving:
    def __call__(self, context, rng):
        context.positions()[0] = 0.0
        return 0.1


class Partly:
    """A model of lost latencies that forgets all but the first receiver."""

    def is_lost(self, context):
        return [False]

    def __call__(self, context, rng):
        return 0.1


LATENCIES = {
    "one number too few": (
        lambda context, rng: rng.random(2),
        r"dst = \[1, 2, 3, 4, 5\] returns an array of shape \(2,\).*, expected one number, or an array of shape \(5,\)",
    ),
    "negative": (
        lambda context, rng: rng.normal(0.0, 1.0, len(context.dst)),
        r"returns -\d.* s to \d, expected a finite",
    ),
    "nan": (lambda context, rng: np.nan, r"returns nan s to 1, expected a finite time >= 0 s"),
    "inf": (lambda context, rng: np.inf, r"returns inf s to 1, .*: a message that never arrives is lost"),
    "text": (lambda context, rng: "0.1", r"returns '0\.1', expected latencies in s, as floats"),
    "nothing": (lambda context, rng: None, r"returns None, expected latencies in s"),
    "truth": (lambda context, rng: True, r"returns True, expected latencies in s"),
    "an error": (
        lambda context, rng: 0.1 / 0,
        r"context\.dst = \[1, 2, 3, 4, 5\] raises ZeroDivisionError: float division",
    ),
    "wrong arguments": (lambda context: 0.1, r"is not a latency: should accept a call with \(context, rng\)"),
    "a wrong mean": (WithMean(), r"mean_latency\(\) returns 0\.1 s, and the mean over 200 runs of 6 nodes is 0\.12"),
    "by number": (
        ByNumber(),
        r"to 1 has another distribution .* or on the number|to 2 has another distribution .*\[2\]",
    ),
    "divided": (Divided(), r"from 0 to 1 has another distribution with context\.dst = \[1, 2, 3\] \(mean 0\.1\d* s\)"),
    "other draws": (
        OtherDraw(),
        r"draw\(200, rng\) has another distribution \(mean 0\.[45]\d* s\).*the network uses draw",
    ),
    "other quantiles": (OtherQuantile(), r"quantile\(u\) has another distribution \(median 0\.35 s\)"),
    "falling quantiles": (Falling(), r"quantile\(u\) decreases; it should grow with u"),
    "few draws": (ShortDraw(), r"draw\(200, rng\) returns an array of shape \(199,\).*, expected 200 latencies, s"),
    "a class that remembers": (Remembering(), r"returns \[0\.001, .* in a first run and \[0\.1\d*, .* in a second one"),
    "a generator of its own": (OwnGenerator(), r"though both generators are in the same state: draw from rng only"),
    "the clock": (lambda context, rng: time.perf_counter(), "draw from rng only"),
    "random": (
        lambda context, rng: random.random() and 0.1,
        "draws from the global generator of random; draw from the one given",
    ),
    "numpy.random": (lambda context, rng: np.random.random() and 0.1, r"global generator of numpy\.random"),  # noqa: NPY002
    "overwrites the receivers": (Overwriting(), r"changes context\.dst to \[2, 3, 4, 5, 6\]; copy it"),
    "overwrites the positions": (Moving(), r"changes the positions of the nodes; copy them"),
    "one truth for all": (Partly(), r"is_lost\(context\) returns \[False\], expected one boolean, or .* shape \(5,\)"),
    "a misspelt trait": (type("Misspelt", (OtherDraw,), {"quantil": lambda self, u: u}), "did you mean 'quantile'"),
    "a lock": (
        type("Locked", (), {"__call__": lambda self, c, r: 0.1, "__reduce__": lambda self: 1 / 0})(),
        "cannot be pickled",
    ),
}
"""Wrong latencies, and what each is told."""


class Lossy(Value):
    """A loss of half of the messages."""

    def __call__(self, context, rng):
        return rng.random(len(context.dst)) < 0.5


class PerPosition:
    """A loss that alternates for each position in the call, and not for each link."""

    def __init__(self):
        self.lost = {}

    def __call__(self, context, rng):
        lost = []
        for k in range(len(context.dst)):
            self.lost[k] = not self.lost.get(k, rng.random() < 0.5)
            lost.append(self.lost[k])
        return np.array(lost)


class AtMostOne:
    """A loss of one of the receivers of a transmission."""

    def __call__(self, context, rng):
        return np.arange(len(context.dst)) == rng.integers(len(context.dst))


class OtherShare:
    """A loss whose draws are not its calls."""

    def draw(self, count, rng):
        return rng.random(count) < 0.3

    def __call__(self, context, rng):
        return rng.random(len(context.dst)) < 0.5


class NumbersDrawn:
    """A loss whose draws are numbers."""

    def draw(self, count, rng):
        return rng.random(count)

    def __call__(self, context, rng):
        return rng.random(len(context.dst)) < 0.5


class Counting:
    """A loss of every seventh message of all runs together."""

    count = [0]  # noqa: RUF012

    def __call__(self, context, rng):
        self.count[0] += 1
        return self.count[0] % 7 == 0


class SecondRun(Lossy):
    """A loss whose runs share their state."""

    def start_run(self, size):
        return SHARED


SHARED = Counting()

LOSSES = {
    "probabilities": (
        lambda context, rng: rng.random(len(context.dst)),
        r"returns an array of shape \(5,\) of type float64, expected booleans",
    ),
    "a number": (lambda context, rng: 0, r"returns 0, expected booleans, True where a message is lost"),
    "one too many": (
        lambda context, rng: rng.random(6) < 0.5,
        r"\(6,\) of type bool, expected one boolean, or an array of shape \(5,\)",
    ),
    "nothing": (lambda context, rng: None, "returns None, expected booleans"),
    "an error": (lambda context, rng: {}[context.src], r"raises KeyError: 0"),
    "per position": (
        PerPosition(),
        r"loses .* with context\.dst = \[1, 2, 3\], and in .* should belong to \(context\.src",
    ),
    "one of all": (AtMostOne(), r"from 0 to 1 loses a first message in 0\.3\d* of the runs .* and in 1\.000"),
    "another share": (
        OtherShare(),
        r"draw\(1000, rng\) loses a share of 0\.[23]\d*, and loss\(context, rng\) one of 0\.[45]",
    ),
    "numbers drawn": (
        NumbersDrawn(),
        r"draw\(1000, rng\) returns an array of shape \(1000,\) of type float64, expected 1000 booleans",
    ),
    "state of a class": (
        Counting(),
        r"in a first run and .* in a second one.*let start_run\(size\) return a model with fresh",
    ),
    "state of all runs": (SecondRun(), r"let start_run\(size\) return a model with fresh state"),
    "the global generator": (lambda context, rng: np.random.random() < 0.5, r"in the same state: draw from rng only"),  # noqa: NPY002
    "overwrites": (
        lambda context, rng: context.dst.sort() or context.dst.fill(0) or False,
        r"changes context\.dst to \[0, 0",
    ),
    "not a model": (3.0, r"is not a loss: .*p: .*less than or equal to 1"),
    "no kind": ("bernouli", r"bernouli is not a loss: .*'bernouli'"),
}


@pytest.mark.slow_cases(
    "a wrong mean",
    "by number",
    "divided",
    "falling quantiles",
    "few draws",
    "numpy.random",
    "other draws",
    "other quantiles",
    "random",
)
@pytest.mark.parametrize("name", LATENCIES)
def test_a_wrong_latency_is_told_what_is_wrong_with_it(name):
    model, what = LATENCIES[name]
    with pytest.raises(ContractError, match=what):
        check_latency(model)


@pytest.mark.whole_but_one
@pytest.mark.slow_cases("another share", "numbers drawn", "one of all", "per position")
@pytest.mark.parametrize("name", LOSSES)
def test_a_wrong_loss_is_told_what_is_wrong_with_it(name):
    model, what = LOSSES[name]
    with pytest.raises(ContractError, match=what):
        check_loss(model)


FEW = {
    "a wrong mean": (WithMean(), 20, r"0\.1 s, and the mean over 20 runs of 6 nodes is 0\.\d+ s: expected equal means"),
    "other draws": (OtherDraw(), 80, r"draw\(80, rng\) has another distribution"),
    "few draws": (ShortDraw(), 20, r"draw\(20, rng\) returns an array of shape \(19,\).*, expected 20 latencies, s"),
    "falling quantiles": (Falling(), 20, r"quantile\(u\) decreases"),
}


@pytest.mark.parametrize("name", FEW)
def test_few_draws_tell_much(name):
    model, draws, what = FEW[name]
    with pytest.raises(ContractError, match=what):
        check_latency(model, draws=draws)


@pytest.mark.parametrize(("draws", "tell"), [(2, False), (8, True), (100, True)])
def test_few_draws_blame_no_model_that_is_right(draws, tell):
    """Of two draws, the means of 12 % of the samples are more than 5 standard errors off."""
    samples = np.random.default_rng(3).normal(1.0, 2.0, (300, draws))
    assert not any(is_off(sample, 1.0, 0.0) for sample in samples)
    assert is_off(samples[0], 40.0, 0.0) == tell


@pytest.mark.parametrize(("draws", "tell"), [(2, False), (20, False), (30, True)])
def test_few_losses_blame_no_model_that_is_right(draws, tell):
    first, second = np.random.default_rng(3).random((2, 300, draws)) < 0.5
    assert not any(map(are_more, first, second))
    all_lost, none = np.ones(draws, bool), np.zeros(draws, bool)
    assert are_more(all_lost, none) == are_more(none, all_lost) == tell
    assert not are_more(all_lost, all_lost)


@pytest.mark.parametrize("differing", [21, 22, 60])
def test_the_probability_of_a_difference_is_that_of_a_binomial_test(differing):
    for fewer in range(differing // 2):
        first = np.arange(100) < fewer
        second = (np.arange(100) >= fewer) & (np.arange(100) < differing)
        assert are_more(first, second) == (binomtest(fewer, differing).pvalue < CHANCE)


@pytest.mark.slow
def test_a_few_losses_tell_a_state_that_all_links_share():
    with pytest.raises(ContractError, match=r"a first message in 0\.[23]\d* of the runs .* and in 1\.000"):
        check_loss(AtMostOne(), draws=40)
    with pytest.raises(ContractError, match=r"draw\(40, rng\) returns an array of shape \(40,\) of type float64"):
        check_loss(NumbersDrawn(), draws=40)


def test_the_run_of_a_check_asks_the_model_often(monkeypatch):
    """Each of six pursuers announces ten times in 1 s, and what is said of it is in the trace."""
    runs = []
    monkeypatch.setattr(links, "twice", lambda tested, where, scenario: runs.append(run(scenario(), 1)))
    check_latency(Constant(value=0.01), draws=2)
    (result,) = runs
    assert len(result.trace.of(Broadcast)) >= 50
    assert {event.src for event in result.trace.of(Broadcast)} == set(range(6))


@pytest.mark.slow
def test_a_share_is_compared_within_five_standard_errors():
    check_loss(Lossy(), nodes=3, draws=40, share=0.5)
    with pytest.raises(ContractError, match=r"over 20 runs of 10 messages on 2 links: expected 0\.9 within 5"):
        check_loss(Lossy(), nodes=3, draws=40, share=0.9)


@pytest.mark.slow
def test_a_latency_in_milliseconds_gives_a_warning():
    """50 s of mean latency; the run of the check is refused no latency, so that only the warning tells."""
    with pytest.warns(UserWarning, match=r"the mean latency is 50\.?\d* s. Latencies are in s: is it 50"):
        check_latency(Milliseconds())


@pytest.mark.slow_but_one
@pytest.mark.parametrize(("latency", "is_told"), [(9.99, False), (10.0, True)])
def test_a_warning_tells_of_a_mean_latency_of_10_s_or_more(latency, is_told, recwarn):
    check_latency(Constant(value=latency), nodes=2, draws=2)
    assert [str(warning.message).split(".")[0] for warning in recwarn] == [
        "Constant: the mean latency is 10 s"
    ] * is_told


class Times(Value):
    """A model of links that keeps the time of each call."""

    reply: float | bool

    def __call__(self, context, rng):
        times.append(round(context.now, 9))
        return self.reply


times = []


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("check", "reply", "steps"), [(check_latency, 0.1, {0.0, 0.01}), (check_loss, False, {0.003333333, 0.01})]
)
def test_the_calls_of_a_check_are_some_milliseconds_apart(check, reply, steps, monkeypatch):
    """The state of a model that depends on the time changes between two messages, and not in each of them."""
    times.clear()
    monkeypatch.setattr(links, "_run", lambda *_, **__: None)
    check(Times(reply=reply), nodes=2, draws=4)
    assert {round(float(step), 9) for step in np.diff(times) if step >= 0.0} == steps


@pytest.mark.whole
def test_the_checks_accept_the_right_models_from_which_the_wrong_ones_differ():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_latency(Uniform(low=0.1, high=0.15), draws=100)
        check_latency(lambda context, rng: 0.1, draws=100)
        check_latency(lambda context, rng: rng.random(), draws=100)
        check_loss(Lossy(), share=0.5)
        check_loss(lambda context, rng: context.dst == 2, share=1 / 5, draws=400)

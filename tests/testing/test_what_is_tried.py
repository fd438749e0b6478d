"""What the checks of users' models try: the situations, their scenarios and limits, and what is required in them.

A situation that is left out, or is another one, lets a wrong model pass; the tests of wrong models meet some of them.
"""

import re
from contextlib import contextmanager

import numpy as np
import pytest

from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Uniform
from desim.kernel.models.latency_by_link import PerPair
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.byzantine.lies import Liar
from desim.pursuit.evaders.evasion import ConstantHeading
from desim.pursuit.motion.dynamics import Acceleration
from desim.pursuit.motion.flow import HarmonicFlow
from desim.pursuit.team.trust import Plausible
from desim.testing import (
    check_body,
    check_dissemination,
    check_evader,
    check_exporter,
    check_fault,
    check_flow,
    check_latency,
    check_loss,
    check_metric,
    check_protocol,
    check_schedule,
    check_trust,
    decisions,
    evaders,
    exporters,
    metrics,
    pursuits,
)
from desim.testing.judging import Subject
from tests.golden import golden


def count(result):
    return len(result.trace)


def write_length(result, path):
    path.write_text(str(len(list(result.trace))))


def early(size, horizon, rng):
    """Draw a crash that ends with the horizon: a plan."""
    yield Crash(node=int(rng.integers(size)), start=0.1, end=horizon)


def chase(me):
    me.assign(me.id == 0)
    me.announce()
    yield me.sleep(0.1)


CHECKS = {
    "loss": lambda: check_loss(Bernoulli(p=0.5), nodes=3, draws=40, share=0.5),
    "latency": lambda: check_latency(Uniform(low=0.01, high=0.02), draws=4),
    "latency of pairs": lambda: check_latency(PerPair(), nodes=3, draws=4),
    "body": lambda: check_body(Acceleration()),
    "evader": lambda: check_evader(ConstantHeading()),
    "flow": lambda: check_flow(HarmonicFlow(amplitude=(0.1, 0.0), period=2.0)),
    "fault": lambda: check_fault(Crash(node=0, start=0.1, end=0.2)),
    "fault plan": lambda: check_fault(early),
    "fault of a pursuer": lambda: check_fault(Liar(node=0, start=0.1)),
    "metric": lambda: check_metric(count),
    "exporter": lambda: check_exporter(write_length),
    "trust": lambda: check_trust(Plausible()),
    "protocol": lambda: check_protocol(chase),
    "schedule": lambda: check_schedule("poisson"),
    "dissemination": lambda: check_dissemination("one_hop"),
}


NUMBER = r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?"
VALUE = rf"\(?{NUMBER}[-+]{NUMBER}j\)?|[-+]?\d+\.\d+(e[-+]?\d+)?j?|\b0j|\bnan\b|True|False|<[\w.]+ object at \w+>"
DRAWN = re.compile(rf"\[({VALUE})(, ({VALUE}))*\]|{VALUE}")
"""Matches the numbers that a check has drawn, or that a model returns."""


class Tried:
    """The situations of a check with their scenarios, and the requirements of each, with how often they are judged."""

    def __init__(self, patch):
        self.situations, self.required = {}, {}
        judged, require = Subject.judged, Subject.require

        @contextmanager
        def judging(subject, where, limit=10.0):
            self.scenarios = self.situations.setdefault(f"{where}, at most {limit:g} s", [])
            with judged(subject, where, limit):
                yield

        def requiring(subject, truth, text):
            sentence = DRAWN.sub("#", text)
            if "draws from the global generator" not in sentence:  # which each situation requires
                self.required[sentence] = self.required.get(sentence, 0) + 1
            require(subject, truth, text)

        patch.setattr(Subject, "judged", judging)
        patch.setattr(Subject, "require", requiring)
        for module in (decisions, exporters, metrics, pursuits):
            patch.setattr(module, "run", self.running(module.run))
        observed = decisions.run_observed
        noted = self.running(lambda scenario, seed, *_: observed(scenario, seed, (), self.begins))

        def observing(scenario, seed, watchers, begins):
            self.begins = begins
            return noted(scenario, seed, *watchers)

        patch.setattr(decisions, "run_observed", observing)

    def running(self, run):
        """Return a function that notes the scenario that it runs, and what watches the run."""

        def noting(scenario, seed, *watchers):
            given = ", ".join(f"{key} = {value}" for key, value in scenario.model_dump(exclude_defaults=True).items())
            watched = [type(watcher).__name__ for watcher in watchers]
            self.scenarios.append(f"{given}, seed {seed}, watched by {', '.join(watched) or 'none'}")
            return run(scenario, seed, *watchers)

        return noting

    def text(self):
        """Return both as text."""
        lines = []
        for where, scenarios in self.situations.items():
            lines += [where, *(f"    {scenario}" for scenario in scenarios)]
        return "\n".join([*lines, "", *(f"{times} x {sentence}" for sentence, times in self.required.items()), ""])


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", CHECKS)
def test_what_a_check_tries_is_golden(name, monkeypatch):
    tried = Tried(monkeypatch)
    CHECKS[name]()
    golden(f"checks/{name}.txt", tried.text())


@pytest.mark.slow
def test_a_body_is_asked_about_pursuers_that_are_slower_as_fast_and_faster_than_the_evader(monkeypatch):
    """The evader has 0.9 m/s."""
    speeds, times = set(), Acceleration.capture_times

    def noting(body, offsets, courses, pursuer_speeds, evader_speed, radius):
        speeds.update((speed, len(offsets)) for speed in pursuer_speeds.tolist())
        return times(body, offsets, courses, pursuer_speeds, evader_speed, radius)

    monkeypatch.setattr(Acceleration, "capture_times", noting)
    check_body(Acceleration())
    assert {speed for speed, count in speeds if count == 8} == {0.5, 0.9, 1.0, 1.5, 2.0, 3.0}


@pytest.mark.slow
def test_a_strategy_is_asked_about_each_number_of_pursuers_heading_and_handover(monkeypatch):
    """The time since the last choice is 0 while there is none; a pursuer may be where the evader is."""
    seen, observation = [], evaders._Case.observation

    def noting(case):
        seen.append(observation(case))
        return seen[-1]

    monkeypatch.setattr(evaders._Case, "observation", noting)
    monkeypatch.setattr(evaders, "_SITUATIONS", ())
    check_evader(ConstantHeading())
    asked = {
        (len(state.pursuers), round(abs(state.heading), 9), state.elapsed, state.handover, 0.0 in state.distances)
        for state in seen
    }
    chosen = ((0.0, 0.0), (1.0, 0.01))
    reached = ((0, False), *((count, is_reached) for count in (1, 2, 5) for is_reached in (False, True)))
    assert asked == {
        (count, *choice, handover, is_reached)
        for count, is_reached in reached
        for choice in chosen
        for handover in (False, True)
    }
    assert all(len(state.speeds) == len(state.active) == len(state.pursuers) for state in seen)
    everywhere = np.concatenate([state.pursuers for state in seen])
    assert np.corrcoef(everywhere.real, everywhere.imag)[0, 1] < 0.9
    assert {(state.stamp, state.speed, state.radius) for state in seen} == {(300_000_000, 0.9, 0.1)}

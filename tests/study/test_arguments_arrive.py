"""Every argument of the functions that make many runs, and what it becomes in the calls below them, is golden."""

import inspect
from contextlib import suppress
from importlib import import_module

import pytest

import desim
from desim import Scenario
from desim.study.workers.workers import InProcess
from tests.cli.test_every_option import call_of
from tests.golden import golden

SMALL = Scenario(name="small", horizon=0.02, team={"count": 2}, seed=4)
GRID, RANGES = {"network.loss.p": [0.0, 0.5]}, {"network.loss.p": "0:0.5", "team.count": "2:4"}
PROPERTY = "idle at most 0.001 in total"


def mine(result):
    return len(result.trace)


def only_one(me):
    me.assign(me.id == 0)
    yield me.sleep(1.0)


COMMON = {"executor": 3, "seed": 9, "timeout": 50.0, "metrics": {"mine": mine}, "mix_versions": True}
FUNCTIONS = {
    "sweep": (
        {"scenario": SMALL, "grid": RANGES, "reps": 7, "design": "random:3", "store": "s.sqlite"}
        | {"until": ("mine", 0.5), "fail_fast": True, **COMMON},
        ["sweeps.sweep.SweepPlan.of", "sweeps.sweep.SweepPlan.register", "sweeps.sweep.carry_out"],
    ),
    "controlled": (
        {"scenario": SMALL, "grid": GRID, "reps": 7, "control": "local_min", "control_runs": 12, "store": "s.sqlite"}
        | {"control_store": "c.sqlite", "shown": ["mine"], **COMMON},
        [
            *(
                "comparing.control.SweepPlan.of",
                "comparing.control.ControlPlan.of",
                "comparing.control.SweepPlan.register",
            ),
            *("comparing.control.carry_out", "comparing.control.ControlPlan.carry_out"),
        ],
    ),
    "explain": (
        {"scenario": SMALL.with_({"network.loss": 0.2}), "runs": 3, "store": "s.sqlite", "shown": ["mine"], **COMMON},
        ["ablation.explain.Variants.of", "sweeps.sweep.SweepPlan.register", "ablation.explain.Variants.carry_out"],
    ),
    "race": (
        {"scenario": SMALL, "grid": RANGES, "metric": "mine", "zone": 0.5, "confidence": 0.9, "maximise": True}
        | {"first": 3, "most": 11, "design": "random:3", "store": "s.sqlite", **COMMON},
        [
            *("selection.race.SweepPlan.of", "selection.race.RaceRules.of", "selection.race.SweepPlan.register"),
            "selection.race.carry_out_race",
        ],
    ),
    "sensitivity": (
        {"scenario": SMALL, "grid": RANGES, "metric": "mine", "points": 8, "trajectories": 3, "runs": 2}
        | {"store": "s.sqlite", **COMMON},
        ["sensitivity.analysis.Analysis.of", "sensitivity.analysis.Analysis.carry_out"],
    ),
    "find_violation": (
        {"scenario": SMALL, "prop": PROPERTY, "runs": 5, "seed": 9, "vary": {"team.count": [3]}, "features": ["loss"]}
        | {"guided": True, "jobs": 3, "timeout": 50.0, "budget": 60.0, "shrinking": 4, "log": None, "on_case": print},
        ["breaking.search.features_of", "breaking.search._Cases", "breaking.search.CaseJudge"],
    ),
    "fatal_losses": (
        {"scenario": SMALL, "prop": PROPERTY, "most": 2, "seeds": [5, 6], "fates": ["late"], "delay": 0.5, "limit": 70}
        | {"prune": False, "jobs": 3, "timeout": 50.0, "on_run": print},
        ["breaking.losses.LossTable", "breaking.losses._Choices", "breaking.losses._Choices.try_all"],
    ),
    "bench": (
        {"protocols": [only_one], "runs": 3, "version": 1, "again": True, "folder": "made", **COMMON},
        ["comparing.bench.Entrants", "comparing.bench.Entrants.carry_out"],
    ),
}
"""The arguments of each function, and what is called below it, of which the last does not return."""


class ArrivedError(Exception):
    """Raised where the last call of a function would begin the runs."""


def note(patch, lines, place, is_last):
    """Let a function, a class, or a method be noted when it is called."""
    names = place.split(".")
    module = import_module(f"desim.study.{'.'.join(names[:2])}")
    owner = getattr(module, names[2]) if len(names) == 4 else module
    is_method = owner is not module and inspect.isfunction(inspect.getattr_static(owner, names[-1]))
    original = getattr(owner, names[-1])

    def noted(*args, **named):
        lines.append(call_of(".".join(names[2:]), {"args": args[is_method:], "named": named}))
        if is_last:
            raise ArrivedError
        return original(*args, **named)

    patch.setattr(owner, names[-1], noted if is_method or owner is module else staticmethod(noted))


@pytest.mark.slow_cases("controlled")
@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_the_arguments_of_a_function_become_is_golden(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, places = FUNCTIONS[name]
    function = getattr(desim, name)
    if name == "bench":
        arguments = {key: value for key, value in arguments.items() if key not in ("seed", "metrics")}
    assert {*arguments} == {*inspect.signature(function).parameters}
    lines = []
    for place in reversed(places):  # a method before its class
        note(monkeypatch, lines, place, place == places[-1])

    def workers_for(*args, **named):
        lines.append(call_of("workers_for", {"args": args, "named": named}))
        return InProcess()

    monkeypatch.setattr(f"{function.__module__}.workers_for", workers_for)
    with suppress(ArrivedError):
        function(**arguments)
        raise AssertionError(f"{places[-1]} is not called")
    lines += [f"wrote {path}" for path in sorted(map(str, tmp_path.glob("*.sqlite")))]
    golden(f"arguments/{name}.txt", "\n".join(lines).replace(f"{tmp_path}/", "") + "\n")


def test_the_runs_of_a_control_have_the_arguments_of_the_sweep(monkeypatch):
    calls = []

    def carry_out(*args, **named):
        calls.append((args, named))
        raise ArrivedError

    monkeypatch.setattr("desim.study.comparing.control.carry_out", carry_out)
    plan = import_module("desim.study.comparing.control").ControlPlan("the plan", (), "local_min")
    with suppress(ArrivedError):
        plan.carry_out("result", "store", "workers", ["mine"])
    assert calls == [(("the plan", "store", "workers"), {"metrics": ["mine"]})]


def test_a_race_is_decided_by_its_rules(monkeypatch):
    module, calls = import_module("desim.study.selection.race"), []

    def kim_nelson(_sample, *args, **named):
        calls.append((args, named))
        raise ArrivedError

    monkeypatch.setattr(module, "kim_nelson", kim_nelson)
    monkeypatch.setattr(module, "_Samples", lambda *_: None)
    plan = module.SweepPlan.of(SMALL, GRID, 11)
    rules = module.RaceRules("active_time", maximise=True, zone=0.5, confidence=0.9, first=7)
    with suppress(ArrivedError):
        module.carry_out_race(plan, None, None, rules)
    wanted = {"zone": 0.5, "confidence": 0.9, "first": 7, "maximise": True, "most": 11}
    assert calls == [((len(plan.configurations),), wanted)]

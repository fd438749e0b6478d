"""Scenario files: each of them runs, keeps its messages, and survives writing and reading."""

import re

import pytest

from desim import Scenario, load, summary
from desim.config.choice import choices_of
from desim.config.field_docs import fields_of
from desim.config.model import Value
from desim.config.model_parts import models_in
from desim.scenario.checks import warnings
from desim.scenario.toml import dump
from desim.study.sweeps.sweep_plan import SweepPlan
from scenarios.studies.study import SCENARIOS

FILES = sorted(path.name for path in SCENARIOS.glob("*.toml"))
SHORT = ("horizon=1.0", "record.messages=true")


@pytest.mark.whole_but_one
@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", FILES)
def test_a_scenario_runs_without_a_warning_and_no_message_goes_astray(name, run_of):
    assert not list(warnings(load(SCENARIOS / name)))
    numbers = summary(run_of(name, *SHORT))
    assert numbers.messages_sent == numbers.messages_delivered + numbers.messages_lost + numbers.messages_in_flight > 0
    assert numbers.messages_lost == sum(numbers.messages_lost_by.values())


@pytest.mark.slow
def test_a_sweep_of_a_scenario_gives_no_warning():
    swept = [scenario for name in FILES if (scenario := load(SCENARIOS / name)).sweep.grid]
    assert swept
    assert [list(SweepPlan.of(scenario).warnings()) for scenario in swept] == [[]] * len(swept)


def kinds_within(model, seen):
    """Yield every class with a kind that a field of a model, or of one within it, may have."""
    for field in () if model in seen else fields_of(model).values():
        choices = [kind for choice in choices_of(field) for kind in choice.choices().values()]
        yield from choices
        for inner in (*choices, *models_in(field.annotation)):
            yield from kinds_within(inner, seen | {model})


def classes_in(value):
    """Yield the class of each model in a value."""
    if isinstance(value, Value):
        yield type(value)
        value = dict(value)
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
        yield from classes_in(inner)


@pytest.mark.slow
def test_every_kind_is_shown_by_a_scenario_file_or_a_study():
    """A scenario shows what its grid varies, too. A study is read as text."""
    scenarios = [load(SCENARIOS / name) for name in FILES]
    swept = [each.scenario for base in scenarios if base.sweep.grid for each in SweepPlan.of(base).configurations]
    shown = {kind for scenario in (*scenarios, *swept) for kind in classes_in(scenario)}
    studies = "".join(path.read_text() for path in [*SCENARIOS.glob("*.py"), *SCENARIOS.glob("studies/*.py")])
    hidden = {kind.__name__ for kind in set(kinds_within(Scenario, frozenset())) - shown}
    assert {name for name in hidden if not re.search(rf"\b{name}\b", studies)} == set()
    assert "MaxMin" not in hidden


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_a_scenario_runs_to_its_end(name, run_of):
    """Or, if nothing breaks down, for 5 s."""
    scenario = load(SCENARIOS / name)
    horizon = scenario.horizon if scenario.fault else min(scenario.horizon, 5.0)
    numbers = summary(run_of(name, *([] if horizon == scenario.horizon else [f"horizon={horizon}"])))
    assert numbers.messages_delivered > 0
    assert numbers.captured or numbers.end_time == horizon


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", FILES)
def test_a_scenario_with_every_default_filled_in_is_the_same_scenario(name, tmp_path):
    scenario = load(SCENARIOS / name)
    (tmp_path / "again.toml").write_text(dump(scenario))
    assert load(tmp_path / "again.toml") == scenario


@pytest.mark.parametrize(
    ("asked", "causes"),
    [
        (("bursts.toml", *SHORT), {"loss"}),
        (("measured.toml",), {"loss"}),
        (("radio.toml", *SHORT), {"out_of_range", "half_duplex"}),
        (("contention.toml", *SHORT), {"collision", "half_duplex"}),
        pytest.param(("faults.toml",), {"crash", "partition", "jamming"}, marks=pytest.mark.slow),
    ],
    ids=lambda each: each[0] if isinstance(each, tuple) else "",
)
def test_messages_are_lost_for_the_reasons_a_scenario_is_about(asked, causes, run_of):
    assert causes <= set(summary(run_of(*asked)).messages_lost_by)

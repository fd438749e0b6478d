"""Scenario files: each of them runs, keeps its messages, and is what it says when written and read again."""

import pytest

from desim import load, run, summary
from desim.kernel.invariants import Conservation
from desim.kernel.trace_file import line_of
from desim.scenario_file import dump
from scenarios.study import SCENARIOS

FILES = sorted(SCENARIOS.glob("*.toml"))
SHORT = ["horizon=1.5"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_scenario_runs_and_no_message_goes_astray(path):
    result = run(load(path, SHORT), 0, Conservation())
    numbers = summary(result)
    assert numbers.messages_delivered > 0
    assert numbers.messages_sent == numbers.messages_delivered + numbers.messages_lost + numbers.messages_in_flight
    assert numbers.messages_lost == sum(numbers.messages_lost_by.values())


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_scenario_with_every_default_filled_in_is_the_same_scenario(path, tmp_path):
    scenario = load(path)
    (tmp_path / "again.toml").write_text(dump(scenario))
    assert load(tmp_path / "again.toml") == scenario


def test_equal_seeds_give_equal_traces_whatever_is_imperfect():
    for name in ("faults", "radio", "flooding", "token_ring", "wired", "soak"):
        scenario = load(SCENARIOS / f"{name}.toml", ["horizon=1.0"])
        first, second = (list(map(line_of, run(scenario, 3).trace)) for _ in range(2))
        assert first == second


@pytest.mark.parametrize(
    ("name", "causes"),
    [
        ("bursts", {"loss"}),
        ("faults", {"crash", "partition", "jamming"}),
        ("radio", {"reach", "half_duplex"}),
    ],
)
def test_messages_are_lost_for_the_reasons_a_scenario_is_about(name, causes, run_of):
    assert causes <= set(summary(run_of(f"{name}.toml", "record.messages=false")).messages_lost_by)

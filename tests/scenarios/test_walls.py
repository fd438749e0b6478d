"""The study of what walls cost."""

import pytest

from scenarios import walls
from scenarios.studies.study import Options
from tests.scenarios.test_studies import STUDIES


def test_walls_block_what_the_name_says():
    for name, blocks in walls.BLOCKED.items():
        scenario = walls.rooms("local_min", blocks)
        assert {what for wall in scenario.wall for what in wall.blocks} == {*blocks, "start"}, name
        assert (scenario.sight_is_perfect, scenario.space.is_open) == ("sight" not in blocks, "motion" not in blocks)
    assert walls in STUDIES


@pytest.mark.slow
def test_the_costs_are_differences_of_runs_of_equal_seeds(monkeypatch, tmp_path):
    class Few(Options):
        def measure(self, scenarios, label, metric):
            assert len(scenarios) == len(walls.BLOCKED)
            return [[(float(k + seed), 1.0) for seed in (3, 8)] for k in range(len(scenarios))]

    monkeypatch.setattr(walls, "PROTOCOLS", ("local_min",))
    costs = walls.measure(Few("walls", 2, 1, 3, tmp_path, as_json=False))
    active = [cost for cost in costs if cost.metric == "active time"]
    assert [(cost.difference.mean, cost.difference.half_width) for cost in active] == [
        (float(k), 0.0) for k in range(len(active))
    ]
    assert "local_min" in walls.table(costs, 2)
    assert len(walls.picture(costs).axes) == 2

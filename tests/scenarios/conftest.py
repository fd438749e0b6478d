"""How studies are cut down to what a test has time for."""

import json

import pytest
from click.testing import CliRunner

from desim.study.workers.batch import run_many


@pytest.fixture
def shortened(monkeypatch):
    """Return what lets the runs of all studies end after a time (s), and a scenario as they then run it."""

    def shorten(horizon):
        def cut(scenario):
            return scenario.model_copy(update={"horizon": min(scenario.horizon, horizon)})

        def run_few(tasks, *rest):
            return run_many([(cut(scenario), seed) for scenario, seed in tasks], *rest)

        monkeypatch.setattr("scenarios.studies.study.run_many", run_few)
        return cut

    return shorten


@pytest.fixture
def study(tmp_path):
    """Return what calls a study, and returns its document, its table and its picture as text."""

    def call(main, *words):
        done = CliRunner().invoke(main, ["--jobs", "1", "--out", str(tmp_path), "--json", *words])
        assert done.exit_code == 0, done.output
        document = json.loads(done.stdout)
        stem = tmp_path / document["study"]
        assert json.loads(stem.with_suffix(".json").read_text()) == document
        picture = stem.with_suffix(".svg")
        return document, stem.with_suffix(".txt").read_text(), picture.read_text() if picture.exists() else ""

    return call

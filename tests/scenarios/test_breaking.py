"""The study of what breaks each protocol."""

import pytest

from desim import judge, load, run
from scenarios import breaking


def test_a_search_begins_for_each_protocol_and_each_kind_of_trust():
    bases = breaking.bases()
    assert {"sap", "cbaa", "server", "local_min-trimmed", "server-takeover"} < {*bases}
    assert not {"centralised", "policy", "local_min-none"} & {*bases}
    assert all(
        base.protocol_name == name.partition("-")[0] == base.name.partition("-")[0] for name, base in bases.items()
    )
    assert len({repr(base.with_({"name": "x"})) for base in bases.values()}) == len(bases)


@pytest.mark.whole
def test_the_smallest_scenario_of_a_protocol_is_a_file_that_shows_it(study, tmp_path, monkeypatch):
    """Case 1 breaks cbaa: the bid of a winner that crashes blocks all others. The search goes on without crashes."""
    monkeypatch.setattr(breaking, "BASE", breaking.BASE.with_({"team.count": 4}))
    monkeypatch.setattr(breaking.PROTOCOLS, "choices", lambda: ["cbaa", "centralised", "voronoi"])
    document, text, picture = study(breaking.main, "--protocol", "cbaa", "--runs", "2")
    (search,) = document["searches"]
    (weakness,) = search["weaknesses"]
    smallest = load(tmp_path / "breaking-cbaa.toml")
    verdict = judge(breaking.PROPERTY, run(smallest))
    assert smallest.seed == weakness["seed"]
    assert not verdict.holds
    assert verdict.measure - verdict.reference == pytest.approx(weakness["idle_beyond"]["cbaa"])
    assert weakness["smallest"].keys() <= {"chaser crash", "horizon", "team"}
    assert 'kind = "chaser_crash"' in text
    assert "cbaa" in picture
    runs = (tmp_path / "breaking" / "cbaa.jsonl").read_text()
    assert study(breaking.main, "--protocol", "cbaa", "--runs", "2")[0] == document
    assert (tmp_path / "breaking" / "cbaa.jsonl").read_text() == runs, "nothing is run again"
    further = study(breaking.main, "--protocol", "cbaa", "--runs", "3")[0]["searches"][0]
    assert (further["cases"], further["weaknesses"]) == (3, search["weaknesses"])


def test_a_protocol_that_is_not_searched_is_told():
    from click.testing import CliRunner

    told = CliRunner().invoke(breaking.main, ["--protocol", "centralised"])
    assert told.exit_code == 2
    assert "there is no 'centralised'; there are argmin" in told.output

"""The study of what breaks each protocol."""

import pytest

from desim import judge, load, run
from scenarios import breaking
from scenarios.studies.study import SCENARIOS

SHOWN = sorted((SCENARIOS.parent / "docs" / "_static" / "broken").glob("*.toml"))
"""The scenarios of the page on what breaks protocols."""


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
    """Case 15 breaks cbaa: the bid of a winner that crashes blocks all others. The search goes on without crashes."""
    monkeypatch.setattr(breaking.PROTOCOLS, "choices", lambda: ["cbaa", "centralised", "voronoi"])
    document, text, picture = study(breaking.main, "--protocol", "cbaa", "--runs", "15")
    (search,) = document["searches"]
    (weakness,) = search["weaknesses"]
    smallest = load(tmp_path / "breaking-cbaa.toml")
    verdict = judge(breaking.PROPERTY, run(smallest))
    assert smallest.seed == weakness["seed"]
    assert not verdict.holds
    assert verdict.measure - verdict.reference == pytest.approx(weakness["idle_beyond"]["cbaa"])
    assert weakness["smallest"].keys() <= {"crash", "horizon", "team"}
    assert 'kind = "crash"' in text
    assert "cbaa" in picture
    runs = (tmp_path / "breaking" / "cbaa.jsonl").read_text()
    assert study(breaking.main, "--protocol", "cbaa", "--runs", "15")[0] == document
    assert (tmp_path / "breaking" / "cbaa.jsonl").read_text() == runs, "nothing is run again"
    further = study(breaking.main, "--protocol", "cbaa", "--runs", "16")[0]["searches"][0]
    assert (further["cases"], further["weaknesses"][0]) == (16, weakness)
    assert {"chaser crash"} <= further["weaknesses"][1]["smallest"].keys() <= {"chaser crash", "horizon", "team"}
    assert load(tmp_path / "breaking-cbaa-2.toml").seed == further["weaknesses"][1]["seed"]


@pytest.mark.whole
def test_a_search_that_finds_nothing_says_how_much_was_run(study):
    document, text, picture = study(breaking.main, "--protocol", "voronoi", "--runs", "3", "--minutes", "60")
    (search,) = document["searches"]
    assert (search["cases"], search["weaknesses"]) == (3, [])
    assert "none in 3 cases, " in text
    assert picture == ""


def test_a_protocol_that_is_not_searched_is_told():
    from click.testing import CliRunner

    told = CliRunner().invoke(breaking.main, ["--protocol", "centralised"])
    assert told.exit_code == 2
    assert "there is no 'centralised'; there are argmin" in told.output


@pytest.mark.whole
@pytest.mark.parametrize("file", SHOWN, ids=lambda file: file.stem)
def test_a_scenario_of_the_page_breaks_its_protocol_with_the_margin_that_it_says(file):
    scenario = load(file)
    verdict = judge(breaking.PROPERTY, run(scenario))
    first = file.read_text().splitlines()[0]
    assert f"margin {verdict.margin:.3g} s (it has {verdict.measure:.3g} s, " in first
    assert not verdict.holds

"""The pages that are made of the docstrings, and the examples in them."""

import networkx as nx
import pytest

import desim
from scenarios.study import SCENARIOS
from tests import documentation


@pytest.mark.slow
def test_every_module_has_a_page_and_all_annotations_can_be_shown(tmp_path, monkeypatch):
    monkeypatch.setattr(nx.Graph, "__class_getitem__", None, raising=False)  # and away with it afterwards
    documentation.build(tmp_path)
    for package in ("desim", "protocols"):
        for module in (SCENARIOS.parent / package).rglob("*.py"):
            name = module.parent if module.stem == "__init__" else module.with_suffix("")
            assert (tmp_path / name.relative_to(SCENARIOS.parent)).with_suffix(".html").is_file(), module
    assert "Return the newest record" in (tmp_path / "desim/kernel/network.html").read_text()
    assert "Simulate a scenario" in (tmp_path / "desim.html").read_text()


def test_an_annotation_that_cannot_be_shown_ends_the_building(tmp_path, monkeypatch):
    monkeypatch.setattr(nx.Graph, "__class_getitem__", None, raising=False)
    (tmp_path / "strange_land.py").write_text('def walk(to: "Nowhere") -> None:\n    """Walk."""\n')
    monkeypatch.setattr(documentation, "specifications", lambda: [str(tmp_path / "strange_land.py")])
    with pytest.raises(UserWarning, match="Nowhere"):
        documentation.build(tmp_path)


def test_the_example_of_the_package_runs(monkeypatch, capsys):
    monkeypatch.chdir(SCENARIOS.parent)
    _, example, _ = (desim.__doc__ or "").split("```")
    exec(example.removeprefix("python"), {})
    assert "active time: " in capsys.readouterr().out

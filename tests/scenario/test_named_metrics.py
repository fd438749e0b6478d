"""Metrics that a scenario file names: what is imported, and what is said of the rest."""

from functools import cache, partial, wraps
from types import SimpleNamespace

import pytest

import desim.scenario.named_metrics as module
from desim.analysis.measuring import users_metrics
from desim.config.calls import own_signature
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.scenario import Recording, Scenario
from desim.scenario.toml import load, validate
from tests.analysis import of_users

MODULE = """\
with open("imported", "w") as file:
    pass


def gap(result):
    return 1.0
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    """Return a function that writes a scenario file beside a module that leaves a trace of its import."""
    monkeypatch.chdir(tmp_path)
    name = f"metrics_of_{tmp_path.name}".replace("-", "_")
    (tmp_path / f"{name}.py").write_text(MODULE)

    def write(*metrics):
        path = tmp_path / "x.toml"
        given = ", ".join(f'"{each}"' for each in metrics).replace("MINE", name)
        path.write_text(f'name = "x"\n[record]\nmetrics = [{given}]\n')
        return path

    return write


def test_a_module_is_imported_only_if_it_is_trusted(file, tmp_path):
    path = file("MINE:gap")
    with pytest.raises(ScenarioError, match=f"^{path}:3: record.metrics.0: '.*:gap' names code to be run; .*--allow-"):
        load(path)
    assert not (tmp_path / "imported").exists()
    (metric,) = load(path, allow_import=True).record.metrics
    assert (metric.name, metric.of(None)) == ("gap", 1.0)
    assert (tmp_path / "imported").exists()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("MINE:none", "cannot be imported: .*has no attribute 'none'"),
        ("no_such_module:gap", "cannot be imported: No module named 'no_such_module'"),
        (
            "tests.analysis.of_users:of_two",
            r"should accept a call with \(result\); of_two \(.*of_users\.py, line \d+\) does not: missing .* 'more'",
        ),
        ("desim:Scenario", r"should be a function of a result \(got <class"),
        (
            "gap",
            'there is no installed metric \'gap\'; allowed: "module:name", "margin:NAME" of a property; the built-in'
            " metrics are in every summary",
        ),
    ],
)
def test_what_is_no_metric_is_told_with_file_line_and_key(file, given, said):
    path = file(given)
    with pytest.raises(ScenarioError, match=f"^{path}:3: record.metrics.0: .*{said}"):
        load(path, allow_import=True)


def test_a_function_in_c_without_a_signature_may_be_a_metric(file):
    assert load(file("builtins:max"), allow_import=True).record.metrics[0].of is max


def test_an_installed_metric_needs_no_trust_and_one_that_is_not_there_suggests_it(file, monkeypatch):
    point = SimpleNamespace(name="gap", module="tests.analysis.of_users", attr="half")
    monkeypatch.setattr(module, "entry_points", lambda group: [point] if group == "desim.metrics" else [])
    (metric,) = load(file("gap")).record.metrics
    assert (metric.name, metric.given, metric.of) == ("gap", "gap", of_users.half)
    with pytest.raises(
        ScenarioError,
        match=r"'gab', did you mean 'gap'\?; allowed: \"module:name\", \"margin:NAME\" of a property, gap",
    ):
        load(file("gab"))


def test_a_scenario_of_a_script_has_functions_and_says_how_a_file_would_name_them():
    recording = Recording(metrics=(of_users.half,))
    assert recording.model_dump()["metrics"] == ("tests.analysis.of_users:half",)
    assert Recording.model_validate_json(recording.model_dump_json()) == recording
    allowed = 'should be a function, "module:name" or the name of an installed metric'
    with pytest.raises(ValueError, match=rf"{allowed} \(got 3\)"):
        Recording(metrics=(3,))
    for unnamed in (of_users.speed, partial(of_users.half)):
        with pytest.raises(ValueError, match=f"{allowed}; `sweep` and `summary` take any callable as metrics="):
            Recording(metrics=(unnamed,))
    with pytest.raises(ValueError, match=r"'of_two' should accept a call with \(result\)"):
        Recording(metrics=(of_users.of_two,))


def test_a_decorator_may_give_a_metric_some_of_its_arguments():
    @wraps(of_users.of_two)
    def bound(result):
        return of_users.of_two(result, 3.0)

    assert [name for name, _ in users_metrics((), {"bound": bound})] == ["bound"]
    assert Recording(metrics=(bound_half,)).metrics[0].of is bound_half


@cache
def cached(result, other):
    return 0.5


@wraps(cached)
def bound_half(result):
    return cached(result, 1)


def test_a_metric_behind_a_cache_takes_the_arguments_of_what_is_cached():
    assert own_signature(cached).parameters.keys() == {"result", "other"}
    with pytest.raises(ValueError, match=r"metric 'cached' should accept a call with \(result\); .*'other'"):
        users_metrics((), {"cached": cached})


def test_metrics_that_a_scenario_names_are_replaced_as_any_other_key():
    source = Source.of(Scenario(record=Recording(metrics=(of_users.half,))))
    source.set("horizon", 2.0, "here")
    assert validate(source).record.metrics[0].name == "half"
    source.set("record.metrics", ["tests.analysis.of_users:wrong"], "here")
    assert validate(source).record.metrics[0].name == "wrong"

"""The controls follow from the models: each key of a scenario has one, and its value can be set as it is."""

from math import inf, pi

import pytest

from desim import Announcements, Links, Scenario, Team, load
from desim.kernel.models.latency import Gamma
from desim.scenario.overrides import Source
from desim.scenario.toml import read_source, validate
from desim.view.pages.controls import FIRST, Slider, _slider, controls
from scenarios.studies.study import SCENARIOS

FILES = sorted(SCENARIOS.glob("*.toml"))


def by_key(given):
    found = controls(given)
    keys = {each.key: each for each in found}
    assert len(keys) == len(found)
    return keys


def test_tables_have_the_controls_of_their_defaults():
    assert controls({}) == controls(Scenario())


FROM_FILES = {
    "wired": tuple(f"network.graph.{each}" for each in ("edges.", "nodes", "directed")),
    "named": ("network.graph.", "team.positions"),
    "recorded": ("evader.strategy.", "team.relay.0.motion."),
}
"""The beginnings of the keys whose values are in a data file of the scenario."""


@pytest.mark.parametrize("file", FILES, ids=lambda path: path.stem)
def test_a_control_set_to_its_own_value_changes_nothing(file):
    scenario, source = load(file), read_source(file)
    source.tables.pop("sweep", None)
    for each in controls(scenario):
        from_file = each.key.startswith(FROM_FILES.get(file.stem, ()))
        if each.value not in {"", "[]"} and not from_file:  # an empty list may exclude another key
            source.override(f"{each.key}{'.kind' if each.form == 'kind' else ''}={each.value}")
    found = validate(source)
    assert found.model_copy(update={"sweep": scenario.sweep}) == scenario


def test_first_come_the_keys_that_people_change_most():
    first = [each.key for each in controls(load(SCENARIOS / "relay.toml")) if each.first is not None]
    assert [key for key in first if key in FIRST] == list(FIRST)
    assert first[:4] == ["network.latency", "network.latency.value", "network.loss", "network.loss.p"]
    several = [each.key for each in controls(load(SCENARIOS / "many.toml")) if each.first is not None]
    assert "evader.0.strategy" in several or "evader.strategy" in several


def test_a_control_has_the_bounds_unit_help_and_kinds_of_its_key():
    found = by_key(load(SCENARIOS / "relay.toml"))
    latency = found["network.latency.value"]
    assert (latency.form, latency.value, latency.unit, latency.low) == ("number", "0.02", "s", 0.0)
    assert latency.help == "One-way latency, s."
    assert latency.slider == Slider(0.001, 10.0, is_log=True, at_low=0.0)
    assert found["network.range"].slider == Slider(0.1, 100.0, is_log=True, at_high=float("inf"))
    assert found["network.loss.p"].slider == Slider(0.0, 1.0)
    assert found["team.count"].slider == Slider(1.0, 60.0)
    assert (found["seed"].form, found["seed"].slider) == ("integer", None)
    assert {"sap", "cbba", "local_min"} <= set(found["protocol"].options)
    assert (found["motion.static"].form, found["motion.static"].value) == ("flag", "false")
    assert (found["capture.test"].form, found["capture.test"].options) == ("choice", ("segment", "sample"))
    assert found["announce.belief_timeout"].options == ("auto", "affordable")
    assert found["prune"].value == '"inf"'
    assert found["fault"].value == "[]"
    assert found["team.box"].value == "[0.0, 20.0]"
    assert by_key(load(SCENARIOS / "voronoi.toml"))["team.speeds"].form == "text"


@pytest.mark.parametrize(
    ("tables", "key", "form", "low", "high"),
    [
        ({}, "capture.captures_to_end", "integer", 1.0, None),
        ({"evader": {"strategy": {"kind": "constant_heading"}}}, "evader.strategy.angle", "number", -2 * pi, 2 * pi),
        ({"network": {"graph": {"kind": "edges"}}}, "network.graph.nodes", "integer", 1.0, None),
    ],
)
def test_an_optional_number_has_its_bounds(tables, key, form, low, high):
    found = by_key(tables)[key]
    assert (found.form, found.low, found.high, found.value, found.options) == (form, low, high, "", ())


def test_a_value_beyond_the_ends_of_its_slider_has_none():
    far = by_key(Scenario(network=Links(range=500.0), announce=Announcements(heartbeat=0.1)))
    assert far["network.range"].slider is None
    assert far["announce.heartbeat"].slider is not None


@pytest.mark.parametrize("value", [1, 60])
def test_a_value_at_an_end_of_its_slider_is_on_it(value):
    assert by_key(Scenario(team=Team(count=value)))["team.count"].slider == Slider(1.0, 60.0)
    beyond = by_key(Scenario(team=Team(count=61)))["team.count"]
    assert beyond.slider is None


def test_tables_that_are_not_valid_have_the_controls_of_their_kinds():
    """A bitrate has no default, so the table is not valid before the key is set."""
    tables = {"network": {"medium": {"kind": "bitrate"}, "latency": 0.1, "loss": "gilbert_elliott"}, "protocol": "cbba"}
    found = by_key(tables)
    assert found["network.medium.bitrate"].value == ""
    assert found["network.latency.value"].value == "0.1"
    assert found["network.loss"].value == "gilbert_elliott"
    assert found["protocol"].value == "cbba"
    assert by_key({"protocol": {"kind": "none"}})["protocol"].value == "none"


def test_a_list_of_tables_and_of_something_else_has_one_control():
    found = by_key({"fault": [{"kind": "crash", "node": 1}, 5]})
    assert found["fault"].value.endswith(", 5]")
    assert not any(key.startswith("fault.") for key in found)


def test_a_table_of_measurements_has_no_control():
    keys = {each.key for each in controls(load(SCENARIOS / "measured.toml"))}
    assert "network.latency.table" not in keys
    assert {"network.latency.start", "network.latency.unit", "network.loss.threshold"} <= keys


def test_models_made_in_python_have_the_controls_of_their_tables():
    scenario = Scenario(team=Team(count=8, speeds=1.2), network=Links(latency=Gamma(shape=2.0, scale=0.05)))
    assert by_key(scenario)["network.latency.shape"].value == "2"
    assert by_key(Source.of(scenario).tables)["network.latency"].value == "gamma"


def closest(result):
    return 1.0


def test_metrics_that_a_scenario_names_have_one_control():
    found = by_key(Scenario(record={"metrics": [closest]}))
    assert found["record.metrics"].value == f'["{__name__}:closest"]'
    assert not any(key.startswith("record.metrics.") for key in found)


@pytest.mark.slow
@pytest.mark.parametrize("typed", ["0,5", "", "abc", "[1, 2]", "{a = 1}", "true"])
def test_a_page_draws_its_controls_whatever_was_typed_into_one(typed):
    """A value that is not valid is one of any TOML type."""
    base = read_source(SCENARIOS / "relay.toml")
    for control in controls(load(SCENARIOS / "relay.toml")):
        if control.form in {"integer", "number", "flag"} and control.first is not None:
            source = base.copy()
            source.override(f"{control.key}={typed}")
            assert control.key in {each.key for each in controls(source.tables)}


def test_kinds_that_need_a_file_are_marked_unless_they_are_in_use():
    found = by_key(load(SCENARIOS / "relay.toml"))
    assert {"trace", "matrix"} <= set(found["network.latency"].needs_file)
    assert {"trace", "signal_trace"} == set(found["network.loss"].needs_file)
    assert found["evader.strategy"].needs_file == ("recorded",)
    assert found["protocol"].needs_file == ()
    assert by_key(load(SCENARIOS / "recorded.toml"))["evader.strategy"].needs_file == ()


def test_a_pair_has_an_example_that_is_valid():
    found = by_key({"evader": {"strategy": {"kind": "voronoi_vertex"}}})
    example = found["evader.strategy.arena"].example
    source = read_source(SCENARIOS / "relay.toml")
    source.override("evader.strategy.kind=voronoi_vertex")
    source.override(f"evader.strategy.arena={example}")
    assert validate(source).evader.strategy.arena == (0.0, 20.0)
    assert found["team.positions"].example == "[[0, 0], [10, 5]]"
    assert found["network.range"].example == found["name"].example == ""


@pytest.mark.parametrize(
    ("unit", "low", "high", "may_be_low", "slider"),
    [
        (None, -500.0, 500.0, True, Slider(-500.0, 500.0)),
        (None, -500.0, 500.5, True, None),
        ("s", 0.0, 1000.0, True, Slider(0.0, 1000.0)),
        ("s", 0.0, 1000.5, True, Slider(0.001, 10.0, is_log=True, at_low=0.0)),
        ("s", 0.0, 1000.5, False, Slider(0.001, 10.0, is_log=True)),
        ("s", 0.0, inf, True, Slider(0.001, 10.0, is_log=True, at_low=0.0, at_high=inf)),
        ("s", 0.5, 1000.0, True, Slider(0.5, 1000.0)),
        ("s", -1.0, inf, True, None),
        ("kg", 0.0, 1000.5, True, None),
    ],
)
def test_a_number_of_a_wide_range_has_the_slider_of_its_unit(unit, low, high, may_be_low, slider):
    assert _slider("key", unit, low, high, 1.0, may_be_low=may_be_low) == slider

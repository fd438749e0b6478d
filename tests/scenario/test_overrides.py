"""Where a scenario comes from: the way from a value to tables and back, keys that are set, and where each was."""

import tomllib
from math import inf
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.config.model import Positive, Value
from desim.kernel.models.fault_plans import RandomCrashes
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Constant, Lognormal
from desim.kernel.models.links import Links
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.players import Team
from desim.scenario.scenario import Scenario
from desim.scenario.sweep_table import Sweep
from desim.scenario.toml import load, validate
from desim.scenario.toml_lines import key_lines
from protocols.best_response import BestResponse
from protocols.rule import Rule
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from protocols.temperature import ConstantTau, PaperTau

SCENARIOS = sorted((Path(__file__).parents[2] / "scenarios").glob("*.toml"))


class Warmth(Value):
    """A temperature that is not installed."""

    kind: Literal["warmth"] = "warmth"
    level: Positive = 0.5

    def __call__(self, eta):
        return self.level


class Own(Rule):
    """A protocol that is not installed, with a part that is not either."""

    kind: Literal["own"] = "own"
    gain: Positive = 1.0
    warmth: Warmth = Warmth()

    def actions(self, me):
        yield True


def changed(scenario: Scenario, **settings) -> Scenario:
    """Return a scenario with some keys set to other values; two underscores stand for a dot."""
    source = Source.of(scenario)
    for key, value in settings.items():
        source.set(key.replace("__", "."), value, "the test")
    return validate(source)


# There and back.


@pytest.mark.slow_cases("office")
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_the_source_of_a_scenario_describes_that_scenario(path):
    scenario = load(path)
    assert validate(Source.of(scenario)) == scenario


PIECES = {
    "horizon": st.floats(0.5, 100.0),
    "prune": st.sampled_from(["none", "inf", "infeasible"]),
    "team": st.builds(
        Team, count=st.integers(1, 5), speeds=st.one_of(st.floats(0.1, 3.0), st.just({"default": 1.0, "last": 3.0}))
    ),
    "network": st.one_of(
        st.builds(Links, range=st.sampled_from([1.0, inf]), latency=st.builds(Constant, value=st.floats(0.0, 1.0))),
        st.builds(Links, preset=st.sampled_from(["wifi", "lora_sf7"]), range=st.sampled_from([2.0, inf])),
        st.builds(Links, preset=st.sampled_from(["wifi", "lora_sf7"])),
    ),
    "protocol": st.sampled_from([SpatialAdaptivePlay(tau=PaperTau(scale=2.0)), BestResponse(), Own(gain=2.0)]),
    "sweep": st.builds(Sweep, grid=st.just({"team.count": [1, 2], "protocol": [{"kind": "sap"}, Own()]})),
}


@pytest.mark.slow
@given(st.fixed_dictionaries({}, optional=PIECES))
def test_a_scenario_of_a_script_is_restored_from_its_source(pieces):
    scenario = Scenario(**pieces)
    assert validate(Source.of(scenario)) == scenario


def test_a_key_that_is_set_in_a_copy_is_not_set_in_the_original():
    source = Source.of(Scenario(team=Team(positions=((0.0, 0.0), (1.0, 1.0)))))
    copy = source.copy()
    copy.set("team.positions.0", [5.0, 5.0], "the test")
    copy.set("network.range", 3.0, "the test")
    assert source.tables["team"]["positions"][0] == [0.0, 0.0]
    assert "network" not in source.tables
    assert not source.origins


# Keys of a scenario of a script.


def test_given_keys_of_a_table_are_kept_when_another_key_is_set():
    scenario = Scenario(protocol=SpatialAdaptivePlay(tau=PaperTau(scale=2.0)))
    assert changed(scenario, protocol__kind="sap").protocol == scenario.protocol
    assert changed(scenario, protocol__tau__scale=3.0).protocol == SpatialAdaptivePlay(tau=PaperTau(scale=3.0))


def test_another_preset_replaces_what_the_first_stood_for_and_keeps_what_was_given():
    """The wifi preset has an access latency; of LoRa nothing of it may stay, but the range of 5 m that was given."""
    after = changed(Scenario(network=Links(preset="wifi", range=5.0)), network__preset="lora_sf7")
    assert after.network == Links(preset="lora_sf7", range=5.0)
    assert after.network != Links(preset="wifi", range=5.0)


def test_a_table_of_another_kind_keeps_what_the_kind_has_and_loses_what_it_has_not():
    scenario = Scenario(protocol=SpatialAdaptivePlay(schedule=Poisson(rate=3.0), tau=ConstantTau(value=2.0)))
    assert changed(scenario, protocol__kind="best_response").protocol == BestResponse(schedule=Poisson(rate=3.0))
    late = Scenario(network=Links(latency=Constant(value=0.3)))
    assert changed(late, network__latency__kind="lognormal").network.latency == Lognormal()
    crashed = Scenario(fault=(Crash(node=1, start=0.5, end=1.0),))
    (fault,) = changed(crashed, fault__0__kind="random_crashes").fault
    assert fault == RandomCrashes()


@pytest.mark.parametrize(
    "first", ["protocol.tau.value=2.0", "protocol.tau.kind=constant", "protocol.tau={kind='paper'}"]
)
@pytest.mark.parametrize("backwards", [False, True])
def test_a_key_that_was_set_is_not_lost_when_another_kind_has_none(first, backwards):
    source = Source.of(Scenario(protocol=SpatialAdaptivePlay(tau=ConstantTau())))
    sets = [first, "protocol.kind=local_min"]
    for text in reversed(sets) if backwards else sets:
        source.override(text)
    with pytest.raises(ScenarioError, match="tau: unknown key"):
        validate(source)


def test_a_kind_that_is_none_takes_nothing_from_the_table():
    source = Source.of(Scenario(protocol=SpatialAdaptivePlay(tau=ConstantTau())))
    for kind in ("nobody", 3, "nowhere:Nobody"):
        source.set("protocol.kind", kind, "the test")
    assert "tau" in source.tables["protocol"]


def test_a_key_of_a_model_that_is_not_installed_is_set_at_any_depth():
    scenario = Scenario(protocol=Own(gain=2.0))
    assert changed(scenario, protocol__gain=3.0).protocol == Own(gain=3.0)
    assert changed(scenario, protocol__warmth__level=0.1).protocol == Own(gain=2.0, warmth=Warmth(level=0.1))


def test_a_key_of_a_model_that_is_not_installed_is_set_where_it_is_part_of_one_that_is():
    scenario = Scenario(protocol=SpatialAdaptivePlay(tau=Warmth()))
    assert changed(scenario, protocol__tau__level=0.2).protocol == SpatialAdaptivePlay(tau=Warmth(level=0.2))


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        (
            "protocol.gian",
            1.0,
            r"protocol\.gian: unknown key, did you mean 'gain'\?; allowed: gain, kind, schedule, warmth",
        ),
        ("protocol.warmth.heat", 1.0, r"protocol\.warmth\.heat: unknown key; allowed: kind, level"),
        ("protocol.gain.more", 1.0, r"protocol\.gain: float has no key 'more'"),
        ("protocol.gain", -1.0, r"protocol\.gain: should be greater than 0 \(got -1\.0\)"),
        ("protocol.warmth.level", "hot", r"protocol\.warmth\.level: should be a number \(got 'hot'\)"),
    ],
)
def test_a_wrong_key_or_value_of_a_model_that_is_not_installed_is_refused(key, value, why):
    with pytest.raises(ScenarioError, match=f"^{why}$"):
        Source.of(Scenario(protocol=Own())).set(key, value, "the test")


def test_a_key_of_a_function_is_refused():
    with pytest.raises(ScenarioError, match=r"protocol: function has no key 'gain': give another one, or make it a d"):
        Source.of(Scenario(protocol=lambda me: iter(()))).set("protocol.gain", 1.0, "the test")


@pytest.mark.parametrize(
    ("text", "override", "same"),
    [
        ("network.latency = 0.1", "network.latency.value=0.2", "network.latency = 0.2"),
        ("network.latency = 0.1", "network.latency.kind=gamma", "network.latency = 'gamma'"),
        ("network.loss = 0.1", "network.loss.p=0", "network.loss = { kind = 'bernoulli', p = 0.0 }"),
        ("network.latency = 'gamma'", "network.latency.scale=2.0", "network.latency = { kind='gamma', scale=2.0 }"),
        (
            "protocol = { kind = 'sap', tau = 3.0 }",
            "protocol.tau.value=2.0",
            "protocol = { kind = 'sap', tau = 2.0 }",
        ),
        (
            "protocol = 'sap'",
            "protocol.schedule.slot=0.5",
            "protocol = { kind = 'sap', schedule = { kind = 'shared_seed', slot = 0.5 } }",
        ),
        (
            "properties = ['idle never longer than 2']",
            "properties.0.limit=3.0",
            "properties = ['idle never longer than 3']",
        ),
        ("sweep.design = 'sobol:64'", "sweep.design.size=32", "sweep.design = { method = 'sobol', size = 32 }"),
    ],
)
def test_a_key_of_what_a_bare_value_stands_for_is_set(text, override, same, tmp_path):
    for name, each in (("short", text), ("long", same)):
        (tmp_path / f"{name}.toml").write_text(f"{each}\n")
    assert load(tmp_path / "short.toml", [override]) == load(tmp_path / "long.toml")


def test_a_wrong_key_of_what_a_bare_value_stands_for_is_refused(tmp_path):
    (tmp_path / "f.toml").write_text("network.latency = 0.1\n")
    with pytest.raises(ScenarioError, match=r"^--set .*: network\.latency\.scale: unknown key"):
        load(tmp_path / "f.toml", ["network.latency.scale=1.0"])


def test_an_item_of_a_list_that_is_empty_is_refused():
    with pytest.raises(ScenarioError, match=r"^fault\.0\.start: the list fault is empty: set it as a whole, "):
        Source.of(Scenario()).set("fault.0.start", 1.0, "the test")


# Where a key was set.


def of_text(text: str) -> Source:
    return Source("f", tomllib.loads(text), Scenario, key_lines(text))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('[sweep.grid]\nhorizon = [1.0]\n"network.range" = [1.0]', 3),
        ("[sweep.grid]\nhorizon = [1.0]\nnetwork.range = [1.0]", 3),
        ("[sweep.grid]\nhorizon = [1.0]\n[sweep.grid.network]\nrange = [1.0]", 4),
        ("sweep.grid.network.range = [1.0]", 1),
        ("\nsweep.grid = { network = { range = [1.0] } }", 2),
    ],
)
def test_a_key_of_a_grid_is_found_however_it_is_written(text, line):
    source = of_text(text)
    assert source.where(("sweep", "grid", "network.range")) == f"f:{line}"
    assert source.where(("sweep", "grid", "network.range", 0)) == f"f:{line}"


@pytest.mark.parametrize("text", ['"network.range" = [1.0]', "network.range = [1.0]", ""])
@pytest.mark.parametrize("key", ["network.range", '"network.range"'])
def test_an_override_of_a_key_of_a_grid_replaces_it_however_it_is_written(text, key):
    """And the order of the keys, by which configurations are numbered, stays."""
    source = of_text(f"[sweep.grid]\n{text}\nhorizon = [1.0]")
    source.override(f"sweep.grid.{key}=[2.0, 3.0]")
    grid = validate(source).sweep.grid
    assert grid == {"network.range": (2.0, 3.0), "horizon": (1.0,)}
    assert next(iter(grid)) == ("network.range" if text else "horizon")
    assert source.where(("sweep", "grid", "network.range")) == f"--set sweep.grid.{key}=[2.0, 3.0]"


@pytest.mark.parametrize("quote", ["", "'", '"'])
@pytest.mark.parametrize("key", ["x.first", "first.x", "_first.last_"])
def test_only_the_quotes_around_a_key_of_a_grid_are_left_out(key, quote):
    source = of_text("")
    source.override(f"sweep.grid.{quote}{key}{quote}=[1.0]")
    assert list(source.tables["sweep"]["grid"]) == [key]


def test_a_key_of_a_grid_that_is_written_twice_is_refused():
    source = of_text('[sweep.grid]\nnetwork.range = [1.0]\n"network.range" = [2.0]')
    with pytest.raises(ScenarioError, match=r"^f:1: sweep\.grid: network\.range is given twice"):
        validate(source)


@pytest.mark.parametrize("key", ["team.count", 'team."count"', "team.'count'", '"team"."count"', '"team.count"'])
def test_a_part_of_a_key_in_quotes_is_what_they_enclose(key):
    """As in TOML, in an override and in the grid."""
    source = Source("s", {}, Scenario)
    source.override(f"{key}=3")
    source.vary(f"{key}=4,5")
    scenario = validate(source)
    assert (scenario.team.count, scenario.sweep.grid) == (3, {"team.count": (4, 5)})


def test_a_quote_without_another_is_a_part_of_the_key():
    source = Source("s", {}, Scenario)
    source.override('team."count=3')
    with pytest.raises(ScenarioError, match=r'team\."count: unknown key'):
        validate(source)

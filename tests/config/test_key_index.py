"""Where each key of a scenario file lives."""

from desim.config.key_index import all_keys, homes_of
from desim.scenario.scenario import Scenario
from tests.test_refusals import TABLES


def test_every_key_of_every_table_is_listed():
    names = {key.place[-1] for key in all_keys(Scenario)}
    assert names == {name for table in TABLES for name in table.model.model_fields} - {"kind"}
    assert [key.dotted for key in all_keys(Scenario) if len(key.place) == 1] == list(Scenario.model_fields)


def test_a_key_has_the_kind_of_its_table_and_those_of_its_value():
    (tau,) = [key for key in all_keys(Scenario) if key.dotted == "protocol.tau" and key.owner == "sap"]
    assert "paper" in tau.kinds
    values = [key for key in all_keys(Scenario) if key.dotted == "network.latency.values"]
    assert {key.owner for key in values} == {"empirical", "matrix"}


def test_the_home_of_a_key_is_its_outermost_table():
    assert [key.dotted for key in homes_of("latency", Scenario)] == ["network.latency"]
    assert {key.dotted for key in homes_of("heartbeet", Scenario)} == {"announce.heartbeat"}
    assert {key.dotted for key in homes_of("groups", Scenario)} == {"fault.0.groups"}
    assert homes_of("nonsense", Scenario) == []

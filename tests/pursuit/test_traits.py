"""What protocols, schedules, strategies and link models may have, and that a misspelt one is refused."""

import ast
import re
from pathlib import Path
from typing import ClassVar

import pytest

import desim
from desim import Scenario
from desim.config.errors import KeyedError
from desim.config.field_docs import fields_of
from desim.kernel.models.access import Aloha
from desim.kernel.models.interference import INTERFERENCES
from desim.kernel.models.latency_by_link import LATENCIES
from desim.kernel.models.links import Links
from desim.kernel.models.loss import LOSSES
from desim.kernel.models.medium import Bitrate
from desim.kernel.models.reception import RECEPTION_MODELS
from desim.kernel.models.traits import InterferenceTraits, LinkTraits, ReceptionTraits
from desim.pursuit.core.traits import DisseminationTraits, ProtocolTraits, ScheduleTraits, StrategyTraits, UtilityTraits
from desim.pursuit.evaders.evasion import STRATEGIES
from desim.pursuit.game.utility import UTILITIES
from desim.pursuit.team.announcements import DISSEMINATIONS, Announcements
from desim.scenario.players import Evader
from desim.scenario.scenario import PROTOCOLS
from protocols.rule import SCHEDULES, LearningRule
from protocols.sap import SpatialAdaptivePlay

FAMILIES = {
    "protocol": (PROTOCOLS, ProtocolTraits),
    "schedule": (SCHEDULES, ScheduleTraits),
    "utility": (UTILITIES, UtilityTraits),
    "dissemination": (DISSEMINATIONS, DisseminationTraits),
    "strategy": (STRATEGIES, StrategyTraits),
    "latency": (LATENCIES, LinkTraits),
    "loss": (LOSSES, LinkTraits),
    "reception": (RECEPTION_MODELS, ReceptionTraits),
    "interference": (INTERFERENCES, InterferenceTraits),
}


@pytest.mark.parametrize("family", FAMILIES)
def test_each_model_that_comes_with_it_has_traits_of_the_right_types_and_names(family):
    choices, traits = FAMILIES[family]
    assert choices.traits is traits
    for model in choices.choices().values():
        traits.check(model.model_construct())


@pytest.mark.parametrize("family", FAMILIES)
def test_each_trait_is_described(family):
    _, traits = FAMILIES[family]
    assert all(field.description for field in fields_of(traits).values())


class Own:
    """A class of a user that inherits nothing; it may be anything."""

    scope = "heard"
    needs_positions = has_noise = False

    def __init__(self):
        self.announced = False

    def broadcast(self, me, announcement):
        me.publish(announcement)

    def mean_slot(self, me):
        return 0.1

    def __call__(self, *given):
        yield from ()


MAKE = {
    "protocol": lambda own: Scenario(protocol=own),
    "schedule": lambda own: SpatialAdaptivePlay(schedule=own),
    "utility": lambda own: SpatialAdaptivePlay(utility=own),
    "dissemination": lambda own: Announcements(dissemination=own),
    "strategy": lambda own: Evader(strategy=own),
    "latency": lambda own: Links(latency=own),
    "loss": lambda own: Links(loss=own),
    "reception": lambda own: Links(reception=own),
    "interference": lambda own: Bitrate(bitrate=1e6, access=Aloha(), reception=own),
}
MISSPELT = {
    "protocol": [
        ("ominscient", True, "omniscient"),
        ("anounces", False, "announces"),
        ("announce", "unseen", "announces"),
        ("embodyed", False, "embodied"),
        ("recons", True, "reckons"),
        ("asumes", ("no_crashes",), "assumes"),
        ("claimsize", len, "claim_size"),
        ("depend_on", ("table.txt",), "depends_on"),
    ],
    "schedule": [
        ("at_onse", True, "at_once"),
        ("spread_to", "all", "spreads_to"),
        ("without_serial_decision", dict, "without_serial_decisions"),
        ("warning", list, "warnings"),
        ("message_sizes", max, "message_size"),
    ],
    "utility": [("expeced", sum, "expected"), ("assume", ("undivided",), "assumes")],
    "dissemination": [("asumes", ["undivided"], "assumes")],
    "strategy": [("listen", True, "listens"), ("listnes", True, "listens")],
    "latency": [("depends_one", list, "depends_on"), ("start_runs", len, "start_run"), ("quantiles", len, "quantile")],
    "loss": [("strat_run", len, "start_run")],
    "reception": [("bonud", len, "bound")],
}


@pytest.mark.parametrize(
    ("family", "name", "value", "meant"), [(family, *each) for family, found in MISSPELT.items() for each in found]
)
def test_an_attribute_one_letter_off_is_refused_as_the_scenario_is_made(family, name, value, meant):
    own = type("Mine", (Own,), {name: value})
    with pytest.raises(KeyedError, match=re.escape(f"Mine has an attribute {name!r}, did you mean {meant!r}?")):
        MAKE[family](own())


UNRELATED = {
    "protocol": {"announce": print, "hosts": 3, "slots": 8, "periods": (0.1, 0.2), "round": 1, "e": 2},
    "schedule": {"at": 0.1, "once": True, "warning": "none", "slot": 0.1, "spreads": True, "mean": 3},
    "utility": {"expect": sum, "unexpected": 0, "assumed": 3.0},
    "dissemination": {"hop": 3, "relays": True, "shops": 1},
    "strategy": {"listen": print, "listener": None, "mood": "bold"},
    "latency": {
        "quantiles": len,
        "quantile": None,
        "drawn": len,
        "draws": 5,
        "raw": True,
        "started": True,
        "quantity": 3,
    },
    "loss": {"drawer": len, "p": 0.1},
    "reception": {"bounds": (0.0, 1.0), "round": 2, "sound": len([]), "ground": True},
}


@pytest.mark.parametrize("family", UNRELATED)
def test_attributes_of_a_user_that_mean_something_else_are_left_alone(family):
    own = type("Mine", (Own,), UNRELATED[family])()
    made = MAKE[family](own)
    assert dict(made)[{"strategy": "strategy", "dissemination": "dissemination"}.get(family, family)] is own


@pytest.mark.parametrize(
    ("family", "attributes", "says"),
    [
        ("protocol", {"announces": "unsen"}, "announces of Mine: should be True, False or 'unseen' (got 'unsen')"),
        ("protocol", {"assumes": "no_crashes"}, "assumes of Mine: should be a list (got 'no_crashes')"),
        (
            "schedule",
            {"spreads_to": "everyone"},
            "spreads_to of Mine: should be 'all' or 'neighbours' (got 'everyone')",
        ),
        ("strategy", {"listens": 1.5}, "listens of Mine: should be true or false (got 1.5)"),
        ("strategy", {"depends_on": "a.txt"}, "depends_on of Mine: should be a list (got 'a.txt')"),
        ("latency", {"draw": 3}, "draw of Mine: should be callable (got 3)"),
    ],
)
def test_a_trait_of_a_wrong_value_is_refused_as_the_scenario_is_made(family, attributes, says):
    with pytest.raises(KeyedError, match=re.escape(says)):
        MAKE[family](type("Mine", (Own,), attributes)())


@pytest.mark.parametrize(
    ("part", "name", "meant"), [("schedule", "at_onse", "at_once"), ("utility", "asumes", "assumes")]
)
def test_the_parts_of_a_protocol_that_is_no_model_are_looked_at_too(part, name, meant):
    misspelt = type("Part", (Own,), {name: ("undivided",) if part == "utility" else True})()
    protocol = type("Mine", (Own,), {part: misspelt})()
    with pytest.raises(KeyedError, match=rf"protocol\.{part}: Part has an attribute '{name}', did you mean '{meant}'"):
        Scenario(protocol=protocol)


def test_a_part_of_a_protocol_may_be_no_schedule_at_all():
    protocol = type("Mine", (Own,), {"schedule": "daily", "utility": 3, "host": "here", "slot": "a", "period": None})()
    scenario = Scenario(protocol=protocol)
    assert scenario.schedule_traits == ScheduleTraits()
    assert scenario.protocol_traits == ProtocolTraits()


def test_a_misspelt_attribute_of_a_subclass_of_a_rule_is_found():
    class Bold(LearningRule):
        asumes: ClassVar[tuple[str, ...]] = ("one_at_a_time",)

    with pytest.raises(KeyedError, match="Bold has an attribute 'asumes', did you mean 'assumes'"):
        Scenario(protocol=Bold())


def test_a_plain_function_has_the_defaults_or_what_it_is_given():
    def mine(me):
        yield from ()

    assert Scenario(protocol=mine).protocol_traits == ProtocolTraits()
    assert Scenario(protocol=mine).announces
    assert Scenario(protocol=mine).protocol_name == "mine"
    mine.announces = False
    assert not Scenario(protocol=mine).announces
    mine.omnisient = True
    with pytest.raises(KeyedError, match="mine has an attribute 'omnisient', did you mean 'omniscient'"):
        Scenario(protocol=mine)


def named_attributes(source):
    """Return the names that a program gives to `getattr` and `hasattr` as literals."""
    calls = [each for each in ast.walk(ast.parse(source)) if isinstance(each, ast.Call) and len(each.args) > 1]
    found = [each.args[1] for each in calls if ast.unparse(each.func) in {"getattr", "hasattr"}]
    return {each.value for each in found if isinstance(each, ast.Constant)}


@pytest.mark.whole
def test_traits_are_read_through_their_classes_only():
    """A `getattr` with a default would take a misspelt name in silence."""
    traits = {name for _, family in FAMILIES.values() for name in family.model_fields}
    assert named_attributes("getattr(a, 'kind', 1), hasattr(a, 'draw'), getattr(a, b)") == {"kind", "draw"} <= traits
    home = Path(desim.__file__).parents[1]
    modules = [path for name in ("desim", "protocols", "scenarios") for path in sorted((home / name).rglob("*.py"))]
    found = {path.stem: named_attributes(path.read_text(encoding="utf-8")) & traits for path in modules}
    assert {name: each for name, each in found.items() if each} == {
        name: {"kind"} for name in ("parameters", "python_numbers")
    }  # that of a dtype
